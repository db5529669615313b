"""Can a policy with a memory learn to calibrate its arm while it picks, and how does it compare with a Kalman filter?

The task is `pickenv.wrappers.SameArm`: runs of 20 picks on an arm that is not told, with a camera of 1 mm per axis and
ten looks at each fruit. A recurrent policy (RecurrentPPO) and one over a window (PPO) learnt it on 4096 arms of
`qiao2026`, class coarse; they are the shipped baselines and their other seeds, and are trained here where they are not
there yet. "Two kinds" are the same trainings with half of their runs on 4096 arms of `orchard`. The filter has the same
looks and the same action; its two settings are the best of a few on arms of its own. All are judged on the same fresh
arms and fruit.

`picks` asks the same of whole canopies: `pickenv/Pick-v0` on one unknown arm in the course of a day, where only the
gripper tells how far it was off. The filter's settings there are the better of two tried on arms of the split "train".

Simulated throughout.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from itertools import product
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from train_baselines import training_of

import pickenv  # noqa: F401
from pickenv.agents import (
    AdaptiveReach,
    FeelingPick,
    RememberingPolicy,
    RememberingReach,
    ScriptedPick,
    load_remembering,
    pick_canopies,
    train,
)
from pickenv.arm import Array, forward
from pickenv.arm.effects.drives import MeasurementNoise
from pickenv.base import locked, run_seed, seed_words, stream
from pickenv.calibration.compensation.compensator import aimed, taught
from pickenv.envs import PickVectorEnv
from pickenv.experiments import Rows, estimate
from pickenv.inspect.figures.style import WIDTH, new_figure
from pickenv.wrappers import SEEN_MM, SameArmVector

LEARNT = {"recurrent": "recurrent_camera", "window": "history_camera"}
TWO: dict[str, Any] = {"arguments": {"plant": ["qiao2026", "orchard"]}}
CHANGES = {"": {}, "two kinds": TWO, "two kinds, four times the steps": TWO | {"steps": 409_600}}
"""What a training changes in its recipe, by the last words of a policy's name."""

FILTER = "Kalman filter"
PICKS, LOOKS, CAMERA_MM = 20, 10, 1.0
TRIED = {"unmodelled_std": (0.1e-3, 0.2e-3, 0.5e-3, 1e-3), "prior": (0.5, 1.0, 2.0)}
"""Settings of the filter that are tried on arms of its own."""

SHOWN = {"first pick": range(1), "picks 2 to 5": range(1, 5), "picks 11 to 20": range(10, 20)}


def task(plant: str, arms: int, number: int, seed: int) -> SameArmVector:
    """A seed's fresh arms, all at once; ``number`` 0 to be judged on, 1 to choose settings by."""
    seed = seed_words(stream(seed, "arms", 1 + number), 1)[0]
    camera: dict[str, Any] = {"feedback": "camera", "camera_noise_mm": CAMERA_MM, "fruit_noise_mm": 0.0}
    drawn = {"arms": "per_episode", "population": arms, "population_seed": seed, "tolerances": "coarse"}
    envs = gym.make_vec("pickenv/Reach-v0", num_envs=arms, plant=plant, **camera, **drawn)
    return SameArmVector(envs, picks=PICKS, window=PICKS, looks=LOOKS)


def picked(envs: SameArmVector, make: Any, runs: int, seed: int) -> Array:
    """Errors ``(arms, runs, picks)`` in mm; the same fruit for everybody."""
    errors = np.zeros((envs.num_envs, runs, PICKS))
    for run in range(runs):
        seeds = seed_words(stream(seed, "picks", run), envs.num_envs)
        seen, _ = envs.reset(seed=seeds, options={"arm": np.arange(envs.num_envs)})
        choose = make()
        for pick in range(PICKS):
            seen, _, _, _, infos = envs.step(choose(envs, seen))
            errors[:, run, pick] = infos.get("final_info", infos)["position_error_mm"]
    return errors


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

    def __init__(self, unmodelled_std: float, prior: float) -> None:
        std = float(np.hypot(CAMERA_MM * 1e-3 / np.sqrt(LOOKS), unmodelled_std))
        self.prior, self.noise = prior, MeasurementNoise(std, 0.0)
        self.filters: list[Any] = []
        self.stood: Array = np.zeros(0)

    def __call__(self, envs: SameArmVector, seen: Any) -> Any:
        """The next actions."""
        run, n = envs.run, envs.run.task.joints
        if not run.pick:
            self.filters = [AdaptiveReach(envs, prior=self.prior).start] * len(seen)
        else:
            error = seen[:, 2 * n : 2 * n + 3].astype(float) * SEEN_MM * 1e-3
            tools = forward(run.geometry, self.stood).position + error
            self.filters = taught(self.filters, self.stood, tools, self.noise, 0.0, 0.0)
        away = forward(run.geometry, aimed(run.geometry, self.filters, run.joints)).position
        actions = (away - forward(run.geometry, run.joints).position) / (run.memory.reach_mm * 1e-3)
        self.stood = run.memory.aim(run.geometry, run.joints, actions)
        return actions


@cache
def tuned_filter(arms: int = 12) -> tuple[float, float]:
    """The settings of the filter that leave least in the second half of a run, on arms that nothing is judged on."""
    envs = task("qiao2026", arms, 1, 0)
    tried = product(*TRIED.values())
    return min(tried, key=lambda pair: picked(envs, partial(Filtering, *pair), 1, 0)[..., PICKS // 2 :].mean())


def trained(policy: str, seed: int, folder: Path) -> RememberingPolicy:
    """A training of a learnt policy; what is there is not trained again, nor what another process is training."""
    name, _, last = policy.partition(", ")
    training = replace(training_of(LEARNT[name], seed, folder / "calibration.npz"), **CHANGES[last])
    out = folder / "_".join([LEARNT[name], *last.replace(",", "").split()]) / str(seed)
    with locked(out, wait=True):
        if not (out / "policy.npz").is_file():
            train(training, out, resume=(out / "checkpoint.pt").is_file())
    return load_remembering(out / "policy.npz")


def fits(training: int, plant: str, policy: str) -> bool:
    """What learns nothing beforehand is judged once."""
    return training == 0 or learns(policy)


def learns(policy: str) -> bool:
    """Whether a policy is learnt beforehand."""
    return policy.partition(", ")[0] in LEARNT


def measure(
    rng: np.random.Generator, training: int, plant: str, policy: str, arms: int, runs: int, folder: str, seed: int
) -> Any:
    """Errors of one policy, a row for each arm, run and pick."""
    make: Any = partial(Filtering, *tuned_filter()) if policy == FILTER else lambda: aims_at_the_fruit
    if learns(policy):
        make = partial(Remembering, trained(policy, run_seed(seed % 2**16) + training, Path(folder)))
    errors = picked(task(plant, arms, 0, seed), make, runs, seed)
    arm, run, pick = (index.ravel() for index in np.indices(errors.shape))
    when = np.array([next((name for name, some in SHOWN.items() if k in some), "") for k in pick])
    return {"arm": arm, "run": run, "pick": pick + 1, "when": when, "error_mm": errors.ravel()}


def aims_at_the_fruit(envs: SameArmVector, seen: Any) -> Array:
    """The nominal arm's actions."""
    return np.zeros((envs.num_envs, 3))


MEMORIES: dict[str, Callable[[Any], Any]] = {
    "Kalman filter": lambda envs: AdaptiveReach(envs, camera_std=2e-3, prior=2.0),
    "window": lambda envs: RememberingReach(envs, load_remembering(LEARNT["window"])),
    "recurrent": lambda envs: RememberingReach(envs, load_remembering(LEARNT["recurrent"])),
}
"""What aims a picking policy by past picks."""

DAY_H = 8.0
"""Length of the day through which an arm picks."""

MESSAGES = {"day": "day: the script misses more by the hour", "own_eyes": "own_eyes: the camera's errors remain"}

PARTS = {"first canopy": range(1), "canopies 2 to 5": range(1, 5), "canopies 11 to 20": range(10, 20)}


def picks(rng: np.random.Generator, rung: str, policy: str, arms: int, canopies: int, seed: int) -> Any:
    """Grasps of one policy through a day, a row for each arm and canopy; the same arms and fruit for everybody."""
    envs = PickVectorEnv(arms, difficulty=rung, split="test", feedback="gripper")
    numbers = np.random.default_rng(stream(seed, "arms", 0)).permutation(envs.task.population)[:arms]
    picker = FeelingPick(envs, MEMORIES[policy](envs)) if policy in MEMORIES else ScriptedPick(envs)
    totals = [
        pick_canopies(picker, envs, seed_words(stream(seed, "picks", canopy), arms), {"arm": numbers, "hours": hours})
        for canopy, hours in enumerate(np.linspace(0.0, DAY_H, canopies))
    ]
    canopy, arm = (index.ravel() for index in np.indices((canopies, arms)))
    when = np.array([next((name for name, some in PARTS.items() if k in some), "") for k in canopy])
    grasps = {n: np.concatenate([each[n] for each in totals]) for n in ("attempted", "collected", "error_sum_mm")}
    grasps["success"] = grasps["collected"] / np.maximum(grasps["attempted"], 1.0)
    return {"arm": arm, "canopy": canopy + 1, "when": when, **grasps}


def day(rows: Rows) -> Any:
    """Share of grasps that succeed against the number of the canopy, one panel per rung."""

    def share(axes: Any, some: Rows, **look: Any) -> None:
        canopies = [some.where(canopy=k) for (k,) in some.levels("canopy")]
        shares = [100.0 * canopy["collected"].sum() / canopy["attempted"].sum() for canopy in canopies]
        axes.plot(np.arange(1, len(shares) + 1), shares, linewidth=1.3, **look)

    panels = {level: (MESSAGES[level], "canopy of the day") for (level,) in rows.levels("rung")}
    return drawn(rows, "rung", panels, share, {"ylabel": "grasps that succeed (%)"}, 4)


def curves(rows: Rows) -> Any:
    """Error against the number of the pick, one panel per kind of arm."""

    def error(axes: Any, some: Rows, color: str, label: str) -> None:
        points = [row["estimate"] for row in estimate(some.columns, "error_mm", ("pick",), ("arm", "training"))]
        x, ends = np.arange(1, PICKS + 1), [point.ci95 or (point.value,) * 2 for point in points]
        axes.plot(x, [point.value for point in points], color=color, label=label, linewidth=1.3)
        axes.fill_between(x, *np.array(ends, dtype=float).T, color=color, alpha=0.2, linewidth=0)
        axes.set(xticks=range(5, PICKS + 1, 5))

    panels = {level: (f"{level}, coarse", "pick on the same arm") for (level,) in rows.levels("plant")}
    return drawn(rows, "plant", panels, error, {"ylim": (0.0, None), "ylabel": "mean error (mm), 95 % interval"}, 2)


def drawn(
    rows: Rows, factor: str, panels: dict[str, tuple[str, str]], line: Any, left: dict[str, Any], columns: int
) -> Any:
    """A panel for each level of a factor, with its title and x label, and in it a line of each policy."""
    with new_figure(WIDTH, 2.9) as figure:
        places = figure.subplots(1, len(panels), sharey=True, squeeze=False)[0]
        for axes, (level, (title, xlabel)) in zip(places, panels.items(), strict=True):
            axes.set(title=title, xlabel=xlabel)
            for number, (policy,) in enumerate(rows.levels("policy")):
                line(axes, rows.where(**{factor: level, "policy": policy}), color=f"C{number}", label=policy)
        places[0].set(**left)
        figure.legend(*places[0].get_legend_handles_labels(), loc="outside lower center", ncols=columns)
    return figure
