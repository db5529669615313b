"""Does learning beat scripted picking? Five trainings against two scripts, on the same 60 canopies.

PPO learns to pick with steps of the tool (`pickenv train --env pickenv/Pick-v0`), once per training seed; all streams
come from SeedSequence. Every policy then picks the same canopies, which no training saw: in the environment of the
training, and where arms, readings and clocks are those of the rung "orchard" that are kept for judging. Differences are
paired by canopy, and their 95 % intervals cross trainings and canopies. What is done is kept in the folder, so that a
run that was cut off goes on.

Run: python scripts/policies/findings_picking.py [--steps 250000] [--brief] [--out runs/findings_picking]
"""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer
from picking_conditions import SCRIPTS, SEEDS, kept, lines_of, picked, row_of
from rich.progress import track

from pickenv.agents.evaluation.reaches import pick_canopies
from pickenv.agents.policies.learned import load_policy
from pickenv.agents.training.training import CHECKPOINT, train
from pickenv.agents.training.training_setup import Training
from pickenv.envs.picking.pick_vector import PickVectorEnv
from pickenv.files import write_json
from pickenv.inspect.colours import policy_colours
from pickenv.inspect.figures.style import WIDTH, headline, new_figure, rgb, save_figure
from pickenv.seeds import seed_words, stream

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PLACES: dict[str, dict[str, Any]] = {
    "as trained": {},
    "rung orchard, arms for judging": {"difficulty": "orchard", "split": "test"},
}
LEARNT = "PPO"


def training(out: Path, seed: int, steps: int) -> Path:
    """The folder of a finished training."""
    folder = out / f"seed{seed}"
    every = max(steps // 6, 1)
    what = Training("ppo", "pickenv/Pick-v0", steps, seed, checkpoint_every=every, evaluate_every=every)
    if not (folder / "policy.npz").is_file():
        train(what, folder, resume=(folder / CHECKPOINT).exists())
    return folder


def learnt(folder: Path, arguments: dict[str, Any], canopies: int) -> dict[str, Any]:
    """What a training's policy makes of each canopy, ``(1, canopies)``."""
    envs = PickVectorEnv(canopies, **arguments)
    found = pick_canopies(load_policy(folder / "policy.npz"), envs, seed_words(stream(0, "fruit"), canopies))
    return {name: [values.tolist()] for name, values in found.items()}


def judged(out: Path, steps: int, canopies: int, brief: bool) -> list[dict[str, Any]]:
    """One row per place and policy; differences to the gentle script are paired by canopy."""
    folders = [training(out, seed, steps) for seed in track(SEEDS, "trainings")]
    rows = []
    for number, (place, arguments) in enumerate(PLACES.items()):
        given = {key: value for key, value in arguments.items() if key != "split"}
        each = {
            name: kept(
                out / f"{name.replace(', ', '_')}_{number}_{canopies}.json", partial(picked, given, canopies, how)
            )
            for name, how in list(SCRIPTS.items())[: 1 if brief else None]
        }
        runs = [
            kept(folder / f"{number}_{canopies}.json", partial(learnt, folder, arguments, canopies))
            for folder in folders
        ]
        each[LEARNT] = {name: [run[name][0] for run in runs] for name in runs[0]}
        rows += [row_of(place, name, values, each["scripted"]) for name, values in each.items()]
    return rows


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
        axis.set_xlabel("training (thousands of steps)")
        axis.set_ylabel("collected (fruit per canopy)")
        axis.set_ylim(bottom=0.0)
        headline(axis, f"PPO ends at {values[:, -1].mean():.1f} fruit per canopy, the script at {scripted:.1f}")
        figure.legend(loc="outside lower center", ncols=2)
    return figure


def main(
    steps: Annotated[int, typer.Option(help="Steps of each training.", min=2048)] = 250_000,
    canopies: Annotated[int, typer.Option(help="Canopies to judge by.", min=8)] = 60,
    out: Annotated[Path, typer.Option(help="Folder for trainings, canopies, table and figure.")] = Path(
        "runs/findings_picking"
    ),
    brief: Annotated[bool, typer.Option("--brief", help="Leave the hasty script out.")] = False,
    figure: Annotated[Path | None, typer.Option(help="Learning curve, in place of one in the folder.")] = None,
) -> None:
    """Train, judge, print; with a table in picking.json."""
    rows = judged(out, steps, canopies, brief)
    print("\n".join(lines_of(rows)))
    write_json(out / "picking.json", {"steps": steps, "simulated": True, "rows": rows})
    train_rows = [row for row in rows if row["place"] == "as trained"]
    path = save_figure(curve(out, train_rows[0]["collected"]), figure or out / "picking-curve.png")
    print(f"wrote {out / 'picking.json'} and {path}")


if __name__ == "__main__":
    typer.run(main)
