"""Can a policy with a memory learn to calibrate its arm while it picks, and how does it compare with a Kalman filter?

The task is `pickenv.wrappers.SameArm`: runs of 20 picks on an arm that is not told, with a camera of 1 mm per axis and
ten looks at each fruit. A recurrent policy (RecurrentPPO) and one over a window (PPO) learnt it on 4096 arms of
`qiao2026`, class coarse; they are the shipped baselines and their other seeds, and are trained here where they are not
there yet. The filter has the same looks and the same action; its two settings are the best of a few on arms of its own.
All are judged on the same fresh arms and fruit, of the population that was learnt on and of others, pick by pick.
Seeds are stated beforehand: trainings 0 to 4, arms and fruit of stream 0. Simulated throughout.

Run: python scripts/policies/calibrating_while_picking.py [--arms 24] [--runs 2] [--out runs/baselines]
"""

from __future__ import annotations

import json
from collections.abc import Callable
from itertools import product
from pathlib import Path
from typing import Annotated, Any

import gymnasium as gym
import numpy as np
import typer
from train_baselines import SEEDS, training_of

import pickenv  # noqa: F401
from pickenv.agents.policies.adaptive import AdaptiveReach, AdaptiveSettings
from pickenv.agents.policies.remembering import RememberingPolicy, load_remembering
from pickenv.agents.training.training import train
from pickenv.arm import Array, forward
from pickenv.arm.effects.drives import MeasurementNoise
from pickenv.calibration.compensation.compensator import aimed, taught
from pickenv.experiments.policy_tables import with_interval
from pickenv.files import write_json
from pickenv.inspect.figures.style import WIDTH, new_figure, save_figure
from pickenv.intervals import Estimate, mean_estimate
from pickenv.seeds import seed_words, stream
from pickenv.wrappers import SameArmVector
from pickenv.wrappers.same_arm import SEEN_MM

ROOT = Path(__file__).parents[2]
LEARNT = {"recurrent_camera": "recurrent (RecurrentPPO)", "history_camera": "window (PPO)"}
FILTER, NOMINAL = "Kalman filter", "no memory (nominal arm)"
PICKS, LOOKS, CAMERA_MM = 20, 10, 1.0
PLACES: dict[str, dict[str, Any]] = {
    "qiao2026, coarse": {"plant": "qiao2026", "tolerances": "coarse"},
    "field, coarse": {"plant": "field", "tolerances": "coarse"},
}
"""Arms that are judged on; the first are of the kind that was learnt on."""

TRIED = {"unmodelled_std": (0.1e-3, 0.2e-3, 0.5e-3, 1e-3), "prior": (0.5, 1.0, 2.0)}
"""Settings of the filter that are tried on arms of its own."""

SHOWN = {"first pick": slice(0, 1), "picks 2 to 5": slice(1, 5), "picks 11 to 20": slice(10, 20)}
Chooser = Callable[[SameArmVector, Any], Any]
"""Gives actions for the present observations of an environment, from its first pick on."""


def task(place: str, arms: int, number: int) -> SameArmVector:
    """Fresh arms of a place, all at once; ``number`` 0 to be judged on, 1 to choose settings by."""
    seed = seed_words(stream(0, "arms", 1 + number), 1)[0]
    envs = gym.make_vec(
        "pickenv/Reach-v0",
        num_envs=arms,
        feedback="camera",
        camera_noise_mm=CAMERA_MM,
        fruit_noise_mm=0.0,
        arms="per_episode",
        population=arms,
        population_seed=seed,
        **PLACES[place],
    )
    return SameArmVector(envs, picks=PICKS, window=PICKS, looks=LOOKS)


def picked(envs: SameArmVector, make: Callable[[], Chooser], runs: int) -> Array:
    """Errors ``(arms, runs, picks)`` in mm; the same fruit for everybody."""
    arms = np.arange(envs.num_envs)
    errors = np.zeros((envs.num_envs, runs, PICKS))
    for run in range(runs):
        seeds = seed_words(stream(0, "picks", run), envs.num_envs)
        seen, _ = envs.reset(seed=seeds, options={"arm": arms})
        choose = make()
        for pick in range(PICKS):
            seen, _, _, _, infos = envs.step(choose(envs, seen))
            errors[:, run, pick] = infos.get("final_info", infos)["position_error_mm"]
    return errors


def nominal() -> Chooser:
    """Aims at the fruit."""
    return lambda envs, seen: np.zeros((envs.num_envs, 3))


class Remembering:
    """Aims as a policy with a memory says; it sees as many past picks as it was trained with."""

    def __init__(self, policy: RememberingPolicy) -> None:
        self.policy, self.state = policy, policy.begin(0)

    def __call__(self, envs: SameArmVector, seen: Any) -> Any:
        """The next actions."""
        if not envs.run.pick:
            self.state = self.policy.begin(len(seen))
        actions, self.state = self.policy.aim(seen[:, : self.policy.memory.inputs], self.state)
        return actions


class Filtering:
    """Aims as one Kalman filter per arm says."""

    def __init__(self, settings: AdaptiveSettings) -> None:
        self.settings = settings
        std = float(np.hypot(settings.camera_std / np.sqrt(LOOKS), settings.unmodelled_std))
        self.noise = MeasurementNoise(std, 0.0)
        self.filters: list[Any] = []
        self.stood: Array = np.zeros(0)

    def __call__(self, envs: SameArmVector, seen: Any) -> Any:
        """The next actions."""
        run, n = envs.run, envs.run.task.joints
        if not run.pick:
            self.filters = [AdaptiveReach(envs, self.settings).start] * len(seen)
        else:
            error = seen[:, 2 * n : 2 * n + 3].astype(float) * SEEN_MM * 1e-3
            tools = forward(run.geometry, self.stood).position + error
            self.filters = taught(self.filters, self.stood, tools, self.noise, 0.0, 0.0)
        away = forward(run.geometry, aimed(run.geometry, self.filters, run.joints)).position
        actions = (away - forward(run.geometry, run.joints).position) / (run.memory.reach_mm * 1e-3)
        self.stood = run.memory.aim(run.geometry, run.joints, actions)
        return actions


def tuned_filter(arms: int, out: Path) -> AdaptiveSettings:
    """The settings of the filter that leave least in the second half of a run, on arms that nothing is judged on."""
    path = out / "judged" / f"filter-{arms}.json"
    if not path.is_file():
        envs, left = task(next(iter(PLACES)), arms, 1), []
        for unmodelled, prior in product(*TRIED.values()):
            settings = AdaptiveSettings(camera_std=CAMERA_MM * 1e-3, unmodelled_std=unmodelled, prior=prior)
            errors = picked(envs, lambda settings=settings: Filtering(settings), 1)[..., PICKS // 2 :]
            left.append({"mean_mm": float(errors.mean()), "unmodelled_std": unmodelled, "prior": prior})
        write_json(path, {"tried": left})
    best = min(json.loads(path.read_text(encoding="utf-8"))["tried"], key=lambda each: each["mean_mm"])
    return AdaptiveSettings(CAMERA_MM * 1e-3, best["unmodelled_std"], best["prior"])


def trainings(out: Path) -> dict[str, list[RememberingPolicy]]:
    """The trained policies, five seeds each; what is there is not trained again."""
    found: dict[str, list[RememberingPolicy]] = {}
    for name in LEARNT:
        for seed in range(SEEDS):
            folder = out / name / str(seed)
            training = training_of(name, seed, out / "calibration.npz")
            if not (folder / "policy.npz").is_file():
                train(training, folder, resume=(folder / "checkpoint.pt").is_file(), progress=True)
            found.setdefault(name, []).append(load_remembering(folder / "policy.npz"))
    return found


def judged(
    place: str, arms: int, runs: int, policies: dict[str, list[RememberingPolicy]], best: AdaptiveSettings, out: Path
) -> dict[str, Array]:
    """Errors ``(arms, trainings, runs, picks)`` of everybody on one place; what was judged before is read again."""
    envs = task(place, arms, 0)

    def kept(name: str, make: Callable[[], Chooser]) -> Array:
        path = out / "judged" / f"{place.replace(', ', '-')}-{arms}-{runs}-{name}.json"
        if not path.is_file():
            write_json(path, {"errors_mm": picked(envs, make, runs).tolist()})
        return np.array(json.loads(path.read_text(encoding="utf-8"))["errors_mm"])

    found = {NOMINAL: kept("nominal", nominal)[:, None], FILTER: kept("filter", lambda: Filtering(best))[:, None]}
    for name, label in LEARNT.items():
        each = [
            kept(f"{name}-{seed}", lambda policy=policy: Remembering(policy))
            for seed, policy in enumerate(policies[name])
        ]
        found[label] = np.stack(each, axis=1)
    return found


def over(errors: Array, picks: slice) -> Estimate:
    """Mean over some picks, with its interval over arms, and over trainings where there are several."""
    return mean_estimate(errors[..., picks].mean(axis=-1))


def figure_of(found: dict[str, dict[str, Array]]) -> Any:
    """Error against the number of the pick, one panel per place."""
    with new_figure(WIDTH, 2.9) as figure:
        panels = figure.subplots(1, len(found), sharey=True)
        for axes, (place, each) in zip(panels, found.items(), strict=True):
            axes.set(title=place, xlabel="pick on the same arm")
            for number, (name, errors) in enumerate(each.items()):
                points = [over(errors, slice(k, k + 1)) for k in range(PICKS)]
                x, colour = np.arange(1, PICKS + 1), f"C{number}"
                axes.plot(x, [point.value for point in points], color=colour, label=name, linewidth=1.3)
                ends = [point.ci95 or (point.value, point.value) for point in points]
                axes.fill_between(x, *np.array(ends, dtype=float).T, color=colour, alpha=0.2, linewidth=0)
        panels[0].set_ylim(bottom=0.0)
        panels[0].set_ylabel("mean error (mm), 95 % interval")
        handles, labels = panels[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=2)
    return figure


def main(
    arms: Annotated[int, typer.Option(help="Fresh arms of each place.", min=10)] = 24,
    runs: Annotated[int, typer.Option(help="Runs of 20 picks of each arm.", min=1)] = 2,
    out: Annotated[Path, typer.Option(help="Folder of the trainings, tables and figures.")] = ROOT / "runs/baselines",
    docs: Annotated[bool, typer.Option("--docs", help="Write the figure of the documentation as well.")] = False,
) -> None:
    """Train what is missing, judge, print."""
    policies, best = trainings(out), tuned_filter(12, out)
    print(f"Kalman filter: unmodelled {1e3 * best.unmodelled_std:g} mm, prior {best.prior:g} tolerances")
    print(f"| arms | policy | {' | '.join(SHOWN)} |\n|{'---|' * (2 + len(SHOWN))}")
    found, rows = {}, []
    for place in PLACES:
        found[place] = judged(place, arms, runs, policies, best, out)
        for name, errors in found[place].items():
            cells = {label: over(errors, picks) for label, picks in SHOWN.items()}
            print(f"| {place} | {name} | {' | '.join(with_interval(c.value, c.ci95, 2) for c in cells.values())} |")
            curve = [over(errors, slice(k, k + 1)) for k in range(PICKS)]
            rows.append({"arms": place, "policy": name, "trainings": errors.shape[1]})
            rows[-1] |= {label: {"mean_mm": c.value, "ci95": c.ci95} for label, c in cells.items()}
            rows[-1] |= {"mm_by_pick": [c.value for c in curve], "ci95_by_pick": [c.ci95 for c in curve]}
        for label in LEARNT.values():
            less = {name: over(found[place][label] - found[place][FILTER], picks) for name, picks in SHOWN.items()}
            changes = " | ".join(with_interval(c.value, c.ci95, 2) for c in less.values())
            print(f"| {place} | {label} less filter | {changes} |")
            rows.append({"arms": place, "policy": f"{label} less {FILTER}"})
            rows[-1] |= {name: {"mean_mm": c.value, "ci95": c.ci95} for name, c in less.items()}
    settings = {"unmodelled_mm": 1e3 * best.unmodelled_std, "prior": best.prior}
    write_json(out / "calibrating_while_picking.json", {"arms": arms, "runs": runs, "filter": settings, "rows": rows})
    save_figure(figure_of(found), out / "calibrating_while_picking.png")
    if docs:
        save_figure(figure_of(found), ROOT / "docs/images/findings-remembering.png")


if __name__ == "__main__":
    typer.run(main)
