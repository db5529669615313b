"""Errors that models leave on rows that no fit saw, mostly of simulated arms, and the share that they remove.

A network interpolates between neighbours, so poses beside those it learnt from flatter it. On held-out blocks of a grid
it removes little or nothing of a measured arm's errors, but most of a smooth simulated arm's. Units: m, rad; mm where
names say so.
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
    """Errors on held-out rows of the nominal arm, of least squares, and of models added to these; no model is gated.

    Args:
        arm: The arm.
        train: Rows that everything is fitted to.
        test: Rows held out.
        rng: Seeds what learns.
        terms: Names of the least-squares fits, and the terms of each as `Choices` has them.
        learnt: Names of the learnt models, and the residual model that each adds to least squares.
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
    """Sets of random poses, one for each of ``counts``, as an instrument sees them (`simulated_tracker`)."""
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
"""Largest random move of turning joints at each point of the grid, rad; slides stay."""

FIELD = "field"
"""Name of the plant whose remainder is made like the remainder of measured arms."""


def grid_joints(nominal: Geometry, rows: int, rng: np.random.Generator) -> Array:
    """Joints ``(rows, n)`` of a grid of tool positions, line by line as a measuring run visits it, turned at each.

    Raises:
        InputError: If the grid has fewer than ``rows`` points.
    """
    joints = field_grid(nominal, STEP, SEED).joints
    first = (len(joints) - rows) // 2
    if first < 0:
        raise InputError(f"the grid has {len(joints)} points that the arm reaches; ask for no more than that")
    joints = joints[first : first + rows]
    turned = rng.uniform(-WRIST, WRIST, joints.shape) * ~np.array(nominal.prismatic)
    return np.asarray(np.clip(joints + turned, nominal.lower, nominal.upper))


def blocks_apart(rows: Measurements, pair: tuple[int, int]) -> tuple[Measurements, Measurements]:
    """Rows to fit, and held-out rows: those in two of ten contiguous blocks."""
    judging = np.isin(np.arange(len(rows)) * BLOCKS // len(rows), pair)
    return rows.select(np.flatnonzero(~judging)), rows.select(np.flatnonzero(judging))


def left_of_blocks(
    arm: Arm, rows: Measurements, number: int, apart: int, rng: np.random.Generator, **models: Any
) -> dict[str, float]:
    """RMS position errors that models leave on two held-out blocks of a set, mm, by model.

    Args:
        arm: The arm.
        rows: The set.
        number: Number of the set: every one has another pair of blocks.
        apart: Distance between the two blocks, in tenths of the set.
        rng: Seeds what learns.
        models: Which models, as `left_by_models` takes them.
    """
    train, test = blocks_apart(rows, (number % BLOCKS, (number + apart) % BLOCKS))
    squares, _ = left_by_models(arm, train, test, rng, **models)
    return {name: float(1e3 * np.sqrt(values.mean())) for name, values in squares.items()}


# What a network removes, as the demonstration shows it.

ARMS = 5
"""Number of arms drawn from a design; several, since the gain of a network differs much between arms."""

NETWORK: dict[str, Any] = {
    "terms": {LS: "none"},
    "learnt": {"LS + BPNN": "bpnn"},
    "epochs": 50,  # with 200 it removes the same to within two points of per cent
    "attitudes": True,
    "fit": "full",
    "frames": "fitted",
}
"""Models to compare: the paper's calibration and its network, with base and tool fitted."""


@dataclass(frozen=True)
class BlockedGain:
    """The error of least squares on rows far from those fitted, and the share of it that a model removes.

    Attributes:
        arm: Name of the arms.
        ls_mm: Error that least squares leaves, mm RMS, mean over arms.
        removed: Share of this error that a model removes, mean over arms, or over all rows of a measured arm.
        lowest: The least share of any arm, or the lower 95 % end over ten blocks of a measured arm; None without one.
        highest: The largest share, or the upper end.
    """

    arm: str
    ls_mm: float
    removed: float
    lowest: float | None = None
    highest: float | None = None


MEASURED = Path(__file__).with_name("measured_gains.json")
"""File of results that `pickenv bench calibration` writes: gains with arms, rows, folds and date."""


def measured_gains(model: str = "LS + BPNN") -> tuple[BlockedGain, ...]:
    """Shares of measured arms' errors that a model removes; each contiguous fifth of a file is held out in turn.

    UR5 and WAM: Jacobi 2025; UR10: Landgraf et al. 2021. The models are not gated.

    Args:
        model: "LS + BPNN", "LS + GP" or "LS + terms".
    """
    arms = json.loads(MEASURED.read_text(encoding="utf-8"))["arms"]
    return tuple(BlockedGain(arm["arm"], arm["ls_mm"], *arm["removed"][model]) for arm in arms)


def blocked_gains(
    designs: Mapping[str, np.random.SeedSequence],
    joints: Array,
    arms: int = ARMS,
    progress: Callable[[str, int, int], None] | None = None,
) -> list[BlockedGain]:
    """Shares of the errors on held-out blocks that a network removes, on arms drawn from each design.

    Args:
        designs: Names of plants, each with the seed of its arms, noise and networks.
        joints: Joint commands in the order in which they are measured ``(N, n)``, as from `grid_joints`.
        arms: Number of arms drawn from each design.
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
    """RMS errors that models leave on each of ``arms`` arms, one stream of random numbers after the other."""
    plant, rng = load_plant(design), np.random.default_rng(designs[design])
    population = draw_plants(plant, load_tolerances("medium"), arms, rng)
    sets = ((number, simulated_tracker(plant_at(population, number), joints, rng)) for number in range(arms))
    return [left_of_blocks(plant.arm, rows, number, BLOCKS // 2, rng, **NETWORK) for number, rows in sets]
