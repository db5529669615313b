"""What models leave of rows that no fit saw, of simulated arms above all, and how much of it they remove.

A network interpolates between neighbours, so poses beside those it learnt from flatter it. Of blocks of a grid that are
held out it removes little or nothing on measured arms; on a smooth simulated arm most. Units: m, rad; mm where names
say so.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from pickenv.arm import Arm, Array, Geometry, Plant, draw_plants, load_plant, load_tolerances, plant_at
from pickenv.arm.plant.campaign import TRACKER
from pickenv.base import InputError
from pickenv.calibration import BpnnSettings, Choices, Measurements, Result, calibrate, random_joints, simulated_tracker
from pickenv.calibration.model.observations import BLOCKS
from pickenv.calibration.pipeline.fitting import fit_remainder
from pickenv.experiments.engine import Experiment, run
from pickenv.inspect.runs.recorded_episodes import field_grid

NOMINAL, LS, TERMS = "nominal", "LS", "LS + terms"
LEARNT = {"LS + BPNN": "bpnn", "LS + GP": "gp"}
"""Residual models by name."""

Squares = dict[str, Array]
"""Squared position errors of the rows held out ``(M,)``, by model, m^2."""


def left_by_models(
    arm: Arm,
    train: Measurements,
    test: Measurements,
    rng: np.random.Generator,
    *,
    terms: Mapping[str, str] = {TERMS: "auto"},
    learnt: Mapping[str, str] = LEARNT,
    epochs: int | None = None,
    attitudes: bool = False,
    **choices: Any,
) -> tuple[Squares, Result]:
    """Errors on held-out rows of the nominal arm, of least squares, and of models upon them; no model is gated.

    Args:
        arm: The arm.
        train: Rows that everything is fitted to.
        test: Rows held out.
        rng: Seeds what learns.
        terms: Names, and the terms of each as `Choices` has them.
        learnt: Names, and the residual model that each learns upon least squares.
        epochs: Passes of the paper's network; None for a network as `fit_remainder` has it by itself.
        attitudes: Whether residuals are learnt of attitudes too.
        choices: Further fields of `Choices`.

    Returns:
        Squared errors by model, and the calibration with the last of the terms.

    Raises:
        InputError: If the rows cannot be calibrated.
    """
    errors: dict[str, Array] = {}
    for name, kinds in terms.items():
        result = calibrate(arm, train, test=test, choices=Choices(kinds, "none", robust=False, **choices))
        errors |= {NOMINAL: result.errors["nominal"], LS: result.errors["geometric"]}
        errors[name] = result.fit.calibration.errors(test)
    learning, judging = (rows if attitudes else rows.positions_only() for rows in (train, test))
    for name, kind in learnt.items():
        settings = BpnnSettings(epochs=epochs) if epochs and kind == "bpnn" else None
        errors[name] = fit_remainder(result.geometric, kind, learning, rng, settings).calibration.errors(judging)
    return {name: np.sum(rows[:, :3] ** 2, axis=1) for name, rows in errors.items()}, result


def random_sets(
    plant: Plant, counts: Sequence[int], rng: np.random.Generator, instrument: str = TRACKER
) -> list[Measurements]:
    """Sets of so many random poses each, as an instrument sees them (`simulated_tracker`)."""
    nominal = plant.arm.nominal
    return [simulated_tracker(plant, random_joints(nominal, count, rng), rng, instrument) for count in counts]


def as_measured(plant: Plant, rows: Measurements, rng: np.random.Generator) -> Measurements:
    """Readings of an arm by the instrument at the joints of these rows, with attitudes where the rows have them."""
    reading = simulated_tracker(plant, rows.joints, rng)
    return replace(rows, position=reading.position, rotation=None if rows.rotation is None else reading.rotation)


# Blocks of a grid of poses.

ROWS, STEP, SEED = 400, 0.093, 20260
"""Points of the grid, their distance in m, and the seed of the joints that find the workspace's extent."""

WRIST = 0.3
"""At each point of the grid, joints that turn are moved by up to this, rad, and slides stay."""

FIELD = "field"
"""The plant whose remainder is made as that of measured arms is."""


def grid_joints(nominal: Geometry, rows: int, rng: np.random.Generator) -> Array:
    """Joints ``(rows, n)`` of a grid of tool positions, line by line as a measuring run visits it, turned at each.

    Raises:
        InputError: If the grid has fewer points.
    """
    joints = field_grid(nominal, STEP, SEED).joints
    first = (len(joints) - rows) // 2
    if first < 0:
        raise InputError(f"the grid has {len(joints)} points that the arm reaches; ask for no more than that")
    joints = joints[first : first + rows]
    turned = rng.uniform(-WRIST, WRIST, joints.shape) * ~np.array(nominal.prismatic)
    return np.asarray(np.clip(joints + turned, nominal.lower, nominal.upper))


def blocks_apart(rows: Measurements, pair: tuple[int, int]) -> tuple[Measurements, Measurements]:
    """Rows to fit and rows of two of ten contiguous blocks, which are held out."""
    judging = np.isin(np.arange(len(rows)) * BLOCKS // len(rows), pair)
    return rows.select(np.flatnonzero(~judging)), rows.select(np.flatnonzero(judging))


def left_of_blocks(
    arm: Arm, rows: Measurements, number: int, apart: int, rng: np.random.Generator, **models: Any
) -> dict[str, float]:
    """RMS position errors that models leave of two blocks held out of a set, mm.

    Args:
        arm: The arm.
        rows: The set.
        number: Number of the set: every one has another pair of blocks.
        apart: So many tenths the blocks lie apart.
        rng: Seeds what learns.
        models: Which models, as `left_by_models` takes them.
    """
    train, test = blocks_apart(rows, (number % BLOCKS, (number + apart) % BLOCKS))
    squares, _ = left_by_models(arm, train, test, rng, **models)
    return {name: float(1e3 * np.sqrt(values.mean())) for name, values in squares.items()}


# What a network removes, as the demonstration shows it.

ARMS = 5
"""Arms of a design: they differ much in what a network gains on them."""

NETWORK: dict[str, Any] = {
    "terms": {LS: "none"},
    "learnt": {"LS + BPNN": "bpnn"},
    "epochs": 50,  # with 200 it removes the same to within two points of per cent
    "attitudes": True,
    "fit": "full",
    "frames": "fitted",
}
"""The paper's calibration and its network, base and tool fitted."""


@dataclass(frozen=True)
class BlockedGain:
    """What is left of rows far from those fitted, and how much of it a network removes.

    Attributes:
        arm: Name of the arms.
        ls_mm: What least squares leaves, mm RMS, mean.
        removed: Share of it that a model removes, mean over arms, or over all rows of a measured one.
        lowest: The least of any arm, or the lower 95 % end over ten blocks of a measured one; None where there is none.
        highest: The largest, or the upper end.
    """

    arm: str
    ls_mm: float
    removed: float
    lowest: float | None = None
    highest: float | None = None


MEASURED = Path(__file__).with_name("measured_gains.json")
"""What `pickenv bench calibration` found, as it writes it: arms, rows, folds and date."""


def measured_gains(model: str = "LS + BPNN") -> tuple[BlockedGain, ...]:
    """How much of measured arms' errors a model removes, each contiguous fifth of a file held out of all fits in turn.

    UR5 and WAM: Jacobi 2025; UR10: Landgraf et al. 2021. The models are not gated.

    Args:
        model: Also "LS + GP" or "LS + terms".
    """
    arms = json.loads(MEASURED.read_text(encoding="utf-8"))["arms"]
    return tuple(BlockedGain(arm["arm"], arm["ls_mm"], *arm["removed"][model]) for arm in arms)


def blocked_gains(
    designs: Mapping[str, np.random.SeedSequence],
    joints: Array,
    arms: int = ARMS,
    progress: Callable[[str, int, int], None] | None = None,
) -> list[BlockedGain]:
    """How much of the errors on held-out blocks a network removes, on arms drawn from each design.

    Args:
        designs: Plants by name, and the seed of arms, noise and networks of each.
        joints: Joint commands in the order in which they are measured ``(N, n)``, as from `grid_joints`.
        arms: How many of each.
        progress: Told how many designs are done.
    """
    measure = partial(_left_on_design, designs=designs, joints=joints, arms=arms)
    rows = run(Experiment("gains on blocks held out", {"design": list(designs)}, {}, measure), progress=progress)
    gains = []
    for name in designs:
        design = rows.where(design=name)
        removed = 1.0 - design["LS + BPNN"] / design[LS]
        gains.append(BlockedGain(name, *map(float, (design[LS].mean(), removed.mean(), removed.min(), removed.max()))))
    return gains


def _left_on_design(
    rng: np.random.Generator, design: str, designs: Mapping[str, np.random.SeedSequence], joints: Array, arms: int
) -> list[dict[str, float]]:
    """What is left on each of some arms, one stream of random numbers after the other."""
    plant, rng = load_plant(design), np.random.default_rng(designs[design])
    population = draw_plants(plant, load_tolerances("medium"), arms, rng)
    sets = ((number, simulated_tracker(plant_at(population, number), joints, rng)) for number in range(arms))
    return [left_of_blocks(plant.arm, rows, number, BLOCKS // 2, rng, **NETWORK) for number, rows in sets]
