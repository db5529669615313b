"""Does learning beat scripted picking? Five trainings against two scripts, on the same 60 canopies.

PPO learns to pick with steps of the tool (`pickenv train --env pickenv/Pick-v0`), once per training seed; all streams
come from SeedSequence. Every policy then picks the same canopies, which no training saw: in the environment of the
training, and where arms, readings and clocks are those of the rung "orchard" that are kept for judging. Differences are
paired by canopy, and their 95 % intervals cross trainings and canopies. What is done is kept in the folder, so that a
run that was cut off goes on.

Run: python scripts/policies/findings_picking.py [--steps 90000] [--brief] [--out runs/findings_picking]
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer
from rich.progress import track

from pickenv.agents.policies.learned import load_policy
from pickenv.agents.policies.pick_policy import HASTY, ScriptedPick
from pickenv.agents.training.training import CHECKPOINT, train
from pickenv.agents.training.training_setup import Training
from pickenv.arm import Array
from pickenv.envs.picking.pick_vector import PickVectorEnv
from pickenv.files import write_json
from pickenv.inspect.colours import policy_colours
from pickenv.inspect.figures.style import WIDTH, headline, new_figure, rgb, save_figure
from pickenv.intervals import crossed_interval, mean_interval
from pickenv.seeds import seed_words, stream

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SEEDS = range(5)
"""Of the trainings."""

PLACES: dict[str, dict[str, Any]] = {
    "as trained": {},
    "rung orchard, arms for judging": {"difficulty": "orchard", "split": "test"},
}
SCRIPTS: dict[str, dict[str, Any]] = {"scripted": {}, "scripted, hasty": HASTY}
LEARNT = "PPO"
NUMBERS = ("collected", "damaged", "attempted", "reachable", "seconds")
HEADS = ("policy", "collected", "of scripted", "damaged", "attempts", "picks/h")
PERIOD = 0.1
"""Time between two actions, s."""

GRIPPER, PLANT = "li_cup", "orchard"


class EachAlone:
    """One scripted policy for each environment of a vector."""

    def __init__(self, envs: PickVectorEnv, **arguments: Any) -> None:
        self.each = [ScriptedPick(envs, **arguments) for _ in range(envs.num_envs)]

    def act(self, observations: Any) -> Any:
        """An action for each observation."""
        return np.array([one.act(seen) for one, seen in zip(self.each, observations, strict=True)])


def picked(policy: Any, envs: PickVectorEnv, seeds: list[int]) -> dict[str, list[float]]:
    """What becomes of each canopy's fruit, and after how long, s."""
    observations, _ = envs.reset(seed=seeds)
    over, steps = np.zeros(envs.num_envs, dtype=np.bool_), 0
    found = {name: np.zeros(envs.num_envs) for name in NUMBERS}
    while not over.all():
        observations, _, terminated, truncated, infos = envs.step(policy.act(observations))
        steps += 1
        ended = (terminated | truncated) & ~over
        for name in NUMBERS[:-1]:
            found[name][ended] = infos[name][ended]
        found["seconds"][ended] = steps * PERIOD
        over |= ended
    return {name: values.tolist() for name, values in found.items()}


def kept(path: Path, make: Any) -> Any:
    """What a file holds, made if it is not there."""
    if not path.is_file():
        write_json(path, make())
    return json.loads(path.read_text(encoding="utf-8"))


def training(out: Path, seed: int, steps: int) -> Path:
    """The folder of a finished training."""
    folder = out / f"seed{seed}"
    every = max(steps // 3, 1)
    what = Training("ppo", "pickenv/Pick-v0", steps, seed, checkpoint_every=every, evaluate_every=every)
    if not (folder / "policy.npz").is_file():
        train(what, folder, resume=(folder / CHECKPOINT).exists())
    return folder


def judged(out: Path, steps: int, canopies: int, brief: bool) -> dict[str, dict[str, Any]]:
    """By place and policy, `NUMBERS` of each canopy; of several trainings, one row each."""
    policies: list[tuple[str, Any]] = [*list(SCRIPTS.items())[: 1 if brief else None], *((LEARNT, s) for s in SEEDS)]
    found: dict[str, dict[str, Any]] = {place: {} for place in PLACES}
    for name, given in track(policies, "policies"):
        folder = training(out, given, steps) if name == LEARNT else out
        for number, (place, arguments) in enumerate(PLACES.items()):

            def run(given: Any = given, arguments: Any = arguments, name: str = name, folder: Path = folder) -> Any:
                envs = PickVectorEnv(canopies, **arguments)
                policy = load_policy(folder / "policy.npz") if name == LEARNT else EachAlone(envs, **given)
                return picked(policy, envs, seed_words(stream(0, "fruit"), canopies))

            rows = kept(folder / f"{name.replace(', ', '_')}_{number}_{canopies}.json", run)
            for key in NUMBERS:
                found[place].setdefault(name, {}).setdefault(key, []).append(rows[key])
    return found


def table(found: dict[str, dict[str, Any]]) -> list[dict[str, Any]]:
    """One row per place and policy; differences to the gentle script are paired by canopy."""
    rows = []
    for place, by_policy in found.items():
        reference = np.array(by_policy["scripted"]["collected"])
        for name, numbers in by_policy.items():
            values = {key: np.array(rows_) for key, rows_ in numbers.items()}
            apart = values["collected"] - reference
            rows.append(
                {
                    "place": place,
                    "policy": name,
                    "trainings": len(apart) if name == LEARNT else 0,
                    "canopies": apart.shape[1],
                    "gripper": GRIPPER,
                    "plant": PLANT,
                    **{key: float(values[key].mean()) for key in NUMBERS},
                    "collected_ci95": ends_of(values["collected"]),
                    "difference": float(apart.mean()),
                    "difference_ci95": None if name == "scripted" else ends_of(apart),
                    "picks_per_hour": 3600.0 * float(values["collected"].sum() / values["seconds"].sum()),
                }
            )
    return rows


def ends_of(values: Array) -> list[float] | None:
    """95 % interval of the mean of values (trainings, canopies), over both where there are several trainings."""
    ends = mean_interval(values[0]) if len(values) == 1 else crossed_interval(values.T)
    return None if ends is None else list(ends)


def lines_of(rows: list[dict[str, Any]]) -> list[str]:
    """The table in Markdown, a place at a time."""
    lines = []
    for place in dict.fromkeys(row["place"] for row in rows):
        lines += [f"**{place}**", "", f"| {' | '.join(HEADS)} |", "|" + "---|" * len(HEADS)]
        for row in (row for row in rows if row["place"] == place):
            apart = "" if row["policy"] == "scripted" else _with(row["difference"], row["difference_ci95"], "+.2f")
            cells = (row["policy"], _with(row["collected"], row["collected_ci95"], ".2f"), apart)
            rest = (f"{row['damaged']:.2f}", f"{row['attempted']:.2f}", f"{row['picks_per_hour']:.0f}")
            lines.append(f"| {' | '.join((*cells, *rest))} |")
        lines.append("")
    return lines


def curve(out: Path, scripted: float) -> Figure:
    """Fruit per held-out canopy during each training."""
    folders = [out / f"seed{seed}" / "evaluations.json" for seed in SEEDS]
    runs = [json.loads(path.read_text(encoding="utf-8")) for path in folders]
    steps = np.array([row["steps"] for row in runs[0]]) / 1e3
    values = np.array([[row["collected"] for row in rows] for rows in runs])
    with new_figure(WIDTH, 3.0) as figure:
        axis: Any = figure.subplots()
        learnt, script = rgb(policy_colours(["ppo", "scripted"]))
        axis.plot(steps, values.T, color=learnt, linewidth=0.8, alpha=0.5)
        axis.plot(steps, values.mean(axis=0), color=learnt, label=f"PPO, mean of {len(runs)} trainings")
        axis.axhline(scripted, color=script, linestyle="--", label="scripted")
        axis.set_xlabel("steps of training (thousands)")
        axis.set_ylabel("fruit per canopy")
        axis.set_ylim(bottom=0.0)
        headline(axis, f"PPO ends at {values[:, -1].mean():.1f} fruit per canopy, the script at {scripted:.1f}")
        figure.legend(loc="outside lower center", ncols=2)
    return figure


def _with(value: float, ends: list[float] | None, form: str) -> str:
    return f"{value:{form}}" + ("" if ends is None else f" ({ends[0]:{form}} to {ends[1]:{form}})")


def main(
    steps: Annotated[int, typer.Option(help="Steps of each training.", min=2048)] = 90_000,
    canopies: Annotated[int, typer.Option(help="Canopies to judge by.", min=8)] = 60,
    out: Annotated[Path, typer.Option(help="Folder for trainings, canopies, table and figure.")] = Path(
        "runs/findings_picking"
    ),
    brief: Annotated[bool, typer.Option("--brief", help="Leave the hasty script out.")] = False,
    figure: Annotated[Path | None, typer.Option(help="Learning curve, in place of one in the folder.")] = None,
) -> None:
    """Train, judge, print; with a table in picking.json."""
    rows = table(judged(out, steps, canopies, brief))
    print("\n".join(lines_of(rows)))
    write_json(out / "picking.json", {"steps": steps, "simulated": True, "rows": rows})
    train_rows = [row for row in rows if row["place"] == "as trained"]
    path = save_figure(curve(out, train_rows[0]["collected"]), figure or out / "picking-curve.png")
    print(f"wrote {out / 'picking.json'} and {path}")


if __name__ == "__main__":
    typer.run(main)
