"""How much of what least squares leaves do terms, harmonics and learnt models remove, on rows far from those learnt?

Arms drawn from a plant's design (class medium), two calibration sets each, in two protocols: a grid of tool positions,
visited line by line with another attitude at each (as the UR5 of Jacobi 2025 was measured), and random poses. Two
tenths of a file are held out, another pair for each arm, and all else learns. Base and tool are fitted, as on measured
arms. No model is gated: each is used as it is fitted. Gains are over RMS position errors, with 95 % intervals over
arms.

Rows that are done are kept in the folder, so a run that was cut off goes on where it was; after a change of the code or
a plant start with an empty folder. About half a minute for each of the 32 sets.

Run: python scripts/studies/residual_gains.py --plant field [--plant qiao2026] [--arms 8] [--out runs/residual_gains]
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from pickenv.agents.evaluation.blocked_gain import ROWS, blocks_apart, grid_joints, measured_gains

from pickenv.arm import Array, Plant, draw_plants, load_plant, load_tolerances, plant_at
from pickenv.calibration import BpnnSettings, Choices, Measurements, calibrate, random_joints, simulated_tracker
from pickenv.calibration.model.observations import BLOCKS
from pickenv.calibration.pipeline.fitting import fit_remainder
from pickenv.files import write_json
from pickenv.intervals import mean_interval

ROOT = Path(__file__).parents[2]
SEED = 20260
PROTOCOLS = ("grid", "random")
SETS = 2
APART = 4
"""Blocks held out lie so many tenths apart."""
TERMS = {"gravity": "gravity", "harmonics": "periodic", "terms": "auto"}
LEARNT = {"BPNN": "bpnn", "GP": "gp"}
LEAST_ARMS = 8
"""Fewer arms have no interval."""
MODELS = (*TERMS, *LEARNT)
MEASURED = ("terms", "BPNN", "GP")
"""What `pickenv bench calibration` found of measured arms, blocks held out."""


def measured_set(plant: Plant, protocol: str, rng: np.random.Generator) -> Measurements:
    """One calibration set of an arm."""
    nominal = plant.arm.nominal
    joints = grid_joints(nominal, ROWS, rng) if protocol == "grid" else random_joints(nominal, ROWS, rng)
    return simulated_tracker(plant, joints, rng)


def rms(errors: Array) -> float:
    """Root mean square of position errors, mm."""
    return float(1e3 * np.sqrt(np.mean(np.sum(errors[:, :3] ** 2, axis=1))))


def left(plant: Plant, rows: Measurements, pair: tuple[int, int], rng: np.random.Generator, epochs: int) -> Any:
    """What each model leaves of two blocks that it did not see, mm RMS."""
    train, test = blocks_apart(rows, pair)
    found: dict[str, float] = {}
    for name, terms in TERMS.items():
        choices = Choices(terms=terms, residual="none", robust=False, frames="fitted")
        result = calibrate(plant.arm, train, test=test, choices=choices)
        found["nominal"], found["LS"] = rms(result.errors["nominal"]), rms(result.errors["geometric"])
        found[name] = rms(result.fit.calibration.errors(test))
    for name, kind in LEARNT.items():
        settings = BpnnSettings(epochs=epochs) if kind == "bpnn" else None
        found[name] = rms(fit_remainder(result.geometric, kind, train, rng, settings).calibration.errors(test))
    return found


def gains(sets: Mapping[str, Mapping[str, float]]) -> dict[str, Any]:
    """Means over arms, each with its 95 % interval; keys of the sets are "arm/set"."""
    arms = sorted({int(key.split("/")[0]) for key in sets})
    found: dict[str, Any] = {}
    for name in ("LS", *MODELS):
        values = [
            np.mean(
                [
                    one[name] if name == "LS" else 1.0 - one[name] / one["LS"]
                    for key, one in sets.items()
                    if int(key.split("/")[0]) == arm
                ]
            )
            for arm in arms
        ]
        found[name] = {
            "mean": float(np.mean(values)),
            "ci95": mean_interval(values, least=LEAST_ARMS),
            "each": [float(v) for v in values],
        }
    return found


def table_of(found: Mapping[str, Mapping[str, Any]]) -> str:
    """Markdown: one row per plant and protocol, and the measured arms below."""
    lines = [f"| arms, blocks held out | LS leaves (mm) | {' | '.join(f'{name} (%)' for name in MODELS)} |"]
    lines.append("|---" * (2 + len(MODELS)) + "|")
    for name, one in found.items():
        cells = [f"{one['LS']['mean']:.2f}"]
        for model in MODELS:
            ends = one[model]["ci95"]
            said = "" if ends is None else f" ({100 * ends[0]:.0f} to {100 * ends[1]:.0f})"
            cells.append(f"{100 * one[model]['mean']:.0f}{said}")
        lines.append(f"| {name}, simulated | {' | '.join(cells)} |")
    left = [arm.ls_mm for arm in measured_gains()]
    cells = [f"{min(left):.2f} to {max(left):.2f}", *(_measured_range(model) for model in MODELS)]
    lines.append(f"| {len(left)} sets, measured | {' | '.join(cells)} |")
    return "\n".join(lines)


def _measured_range(model: str) -> str:
    """From the least to the largest of the measured arms, %."""
    removed = [100 * arm.removed for arm in measured_gains(f"LS + {model}")] if model in MEASURED else []
    return f"{min(removed):.0f} to {max(removed):.0f}" if removed else ""


def main(
    plant: Annotated[list[str] | None, typer.Option(help="Designs that arms are drawn from.")] = None,
    arms: Annotated[int, typer.Option(help="Arms of each.", min=2)] = 8,
    protocol: Annotated[list[str] | None, typer.Option(help=f"Some of {', '.join(PROTOCOLS)}.")] = None,
    epochs: Annotated[int, typer.Option(help="Passes of the network's training; the paper's by default.")] = 500,
    out: Annotated[Path, typer.Option(help="Folder for the figures.")] = ROOT / "runs/residual_gains",
) -> None:
    """Measure and print the table."""
    found: dict[str, Any] = {}
    for name in plant or ["field", "qiao2026"]:
        population = np.random.SeedSequence(SEED).spawn(1 + len(PROTOCOLS))
        drawn = draw_plants(load_plant(name), load_tolerances("medium"), arms, np.random.default_rng(population[0]))
        for how, seed in zip(PROTOCOLS, population[1:], strict=True):
            sets: dict[str, Any] = {}
            for k, own in enumerate(seed.spawn(arms * SETS)):
                arm, each = divmod(k, SETS)
                kept = out / f"{name}_{how}_{arm}_{each}_{epochs}.json"
                if how not in (protocol or PROTOCOLS):
                    continue
                if not kept.is_file():
                    rng = np.random.default_rng(own)
                    rows = measured_set(plant_at(drawn, arm), how, rng)
                    pair = (k % BLOCKS, (k + APART) % BLOCKS)
                    write_json(kept, left(plant_at(drawn, arm), rows, pair, rng, epochs))
                sets[f"{arm}/{each}"] = json.loads(kept.read_text(encoding="utf-8"))
            if sets:
                found[f"{name}, {how}"] = gains(sets)
    print(table_of(found))
    write_json(out / "residual_gains.json", {"seed": SEED, "sets": SETS, "gains": found})


if __name__ == "__main__":
    typer.run(main)
