"""Errors of calibration models on held-out rows, mostly of simulated arms, and the share of the error that they remove.

A network interpolates between neighbouring poses, so test poses close to training poses make it look too good. On
held-out blocks of a grid, a network removes little or nothing of a measured arm's errors, but most of a smooth
simulated arm's errors. Units: m, rad; mm where names say so.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from pickenv.arm import Arm, Array, Geometry, Plant, plant_at
from pickenv.arm.plant.campaign import TRACKER
from pickenv.arm.plant.plant_file import draw_arms
from pickenv.base import InputError, single_threaded
from pickenv.calibration import BpnnSettings, Choices, Measurements, Result, calibrate, random_joints, simulated_tracker
from pickenv.calibration.model.observations import BLOCKS
from pickenv.calibration.pipeline.fitting import fit_remainder
from pickenv.inspect.runs.recorded_episodes import field_grid

NOMINAL, LS, TERMS = "nominal", "LS", "LS + terms"
LEARNT = {"LS + BPNN": "bpnn", "LS + GP": "gp"}
"""For each learnt model, the name of the residual model that it adds to least squares."""

Squares = dict[str, Array]
"""Squared position errors of the held-out rows ``(M,)``, m^2, by model."""


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
    """Fit several models, and return their squared position errors on held-out rows.

    The models are the nominal arm, least squares, and least squares with parametric terms or a learnt residual. A model
    is kept even if it is worse than least squares alone.

    Args:
        arm: The arm.
        train: Rows that every model is fitted to.
        test: Held-out rows.
        rng: Random numbers for the learnt models.
        terms: Parametric terms of each least-squares fit, such as "auto", by the name of the fit; values as for
            `Choices`.
        learnt: Residual model ("bpnn", "gp" and so on) that each learnt model adds to least squares, by the model's
            name.
        epochs: Training epochs of the network of Qiao 2026; None trains the default network of `fit_remainder`.
        attitudes: Whether attitude residuals are learnt too.
        choices: Further fields of `Choices`, the settings of a calibration.

    Returns:
        Two values. The first is the squared position errors of the held-out rows, m^2, by model. The second is the
        result of the fit with the last entry of ``terms``.

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
    """Simulate measurements of a plant (the true arm with its errors) at random poses, one set for each of ``counts``.

    Args:
        plant: The plant.
        counts: Number of poses of each set.
        rng: Random numbers for poses and instrument.
        instrument: Instrument that measures: a name of `pickenv.arm.load_instrument`, or a path.
    """
    nominal = plant.arm.nominal
    return [simulated_tracker(plant, random_joints(nominal, count, rng), rng, instrument) for count in counts]


def as_measured(plant: Plant, rows: Measurements, rng: np.random.Generator) -> Measurements:
    """Simulate tracker readings of a plant (the true arm) at the joints of ``rows``.

    The result has attitudes only if ``rows`` has attitudes.
    """
    reading = simulated_tracker(plant, rows.joints, rng)
    return replace(rows, position=reading.position, rotation=None if rows.rotation is None else reading.rotation)


# Blocks of a grid of poses.

ROWS, STEP, SEED = 400, 0.093, 20260
"""Number of points of the grid, distance between them, m, and seed of the joints that give the workspace's extent."""

WRIST = 0.3
"""Largest random offset of each revolute joint at a point of the grid, rad; prismatic joints get none."""

FIELD = "field"
"""Name of the simulated plant whose errors after least squares resemble measured arms' errors."""


def grid_joints(nominal: Geometry, rows: int, rng: np.random.Generator) -> Array:
    """Return joints ``(rows, n)`` that bring the tool to the points of a grid, rad or m.

    The points are in the order of a measuring run, line by line. A random angle of at most `WRIST` is added to each
    revolute joint.

    Args:
        nominal: Nominal geometry of the arm.
        rows: Number of points, which are taken from the middle of the grid.
        rng: Random numbers for the offsets.

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
    """Hold out two blocks, each an unbroken tenth of the rows; return the rows to fit, and the held-out rows.

    Args:
        rows: The rows, in the order in which they were measured.
        pair: Indices of the two held-out tenths, from 0 to 9.
    """
    judging = np.isin(np.arange(len(rows)) * BLOCKS // len(rows), pair)
    return rows.select(np.flatnonzero(~judging)), rows.select(np.flatnonzero(judging))


def left_of_blocks(
    arm: Arm, rows: Measurements, number: int, apart: int, rng: np.random.Generator, **models: Any
) -> dict[str, float]:
    """Return each model's RMS position error, mm, on two held-out blocks, each an unbroken tenth of the rows.

    Args:
        arm: The arm.
        rows: The rows, in the order in which they were measured.
        number: Index of this set of rows, from 0; modulo 10 it is the index of the first held-out tenth.
        apart: Number of tenths from the first held-out tenth to the second; counting goes on at 0 after the last tenth.
        rng: Random numbers for the learnt models.
        models: Arguments of `left_by_models` that select the models.
    """
    train, test = blocks_apart(rows, (number % BLOCKS, (number + apart) % BLOCKS))
    squares, _ = left_by_models(arm, train, test, rng, **models)
    return {name: float(1e3 * np.sqrt(values.mean())) for name, values in squares.items()}


# What a network removes, as the demonstration shows it.

ARMS = 5
"""Number of arms drawn from each design. The share of the error that a network removes differs much between arms."""

NETWORK: dict[str, Any] = {"terms": {LS: "none"}, "learnt": {"LS + BPNN": "bpnn"}, "epochs": 50, "attitudes": True}
NETWORK |= {"fit": "full", "frames": "fitted"}
"""Arguments of `left_by_models` for the calibration and the network of Qiao 2026, with base and tool fitted. With 200
instead of 50 epochs, the share of the error that the network removes changes by at most two percentage points."""


@dataclass(frozen=True)
class BlockedGain:
    """Error of least squares on held-out contiguous rows, and the share of this error that a further model removes.

    Attributes:
        arm: Name of the plant that arms were drawn from, or of the measured arm.
        ls_mm: RMS position error of least squares, mm: the mean over drawn arms, or the RMS over all rows of a measured
            arm.
        removed: Share of ``ls_mm`` that the model removes: the mean over drawn arms, or the share of a measured arm.
        lowest: Smallest share of any drawn arm. For a measured arm, the lower end of the share's 95 % interval over ten
            contiguous parts of the file; None without an interval.
        highest: Largest share of any drawn arm. For a measured arm, the upper end of the same interval.
    """

    arm: str
    ls_mm: float
    removed: float
    lowest: float | None = None
    highest: float | None = None


MEASURED = Path(__file__).with_name("measured_gains.json")
"""File of results that `pickenv bench calibration` writes: gains with arms, rows, folds and date."""


def measured_gains(model: str = "LS + BPNN") -> tuple[BlockedGain, ...]:
    """Return the share of each measured arm's least-squares error that a model removes, as stored in `MEASURED`.

    Each contiguous fifth of an arm's rows is held out in turn. A model that increases the error is included, with a
    negative share. Data of UR5 and WAM: Jacobi 2025; of UR10: Landgraf et al. 2021.

    Args:
        model: "LS + BPNN", "LS + GP" or "LS + terms".
    """
    arms = json.loads(MEASURED.read_text(encoding="utf-8"))["arms"]
    return tuple(BlockedGain(arm["arm"], arm["ls_mm"], *arm["removed"][model]) for arm in arms)


def blocked_gains(
    designs: Mapping[str, np.random.SeedSequence],
    joints: Array,
    progress: Callable[[str, int, int], None] | None = None,
) -> list[BlockedGain]:
    """Return the share of the least-squares error that a network removes, for `ARMS` arms drawn from each plant.

    Two contiguous tenths of the poses are held out, and the errors are computed there.

    Args:
        designs: Seed of the arms, noise and networks of each plant, by the name of the plant.
        joints: Joint commands in the order in which they are measured ``(N, n)``, rad or m, such as `grid_joints`.
        progress: Called with (what is computed, plants done, number of plants).
    """
    gains = []
    for name, seed in designs.items():
        rng = np.random.default_rng(seed)
        with single_threaded():
            plants = draw_arms(name, "medium", ARMS, rng)
            sets = ((number, simulated_tracker(plant_at(plants, number), joints, rng)) for number in range(ARMS))
            left = [left_of_blocks(plants.arm, rows, number, BLOCKS // 2, rng, **NETWORK) for number, rows in sets]
        ls, both = (np.array([errors[model] for errors in left]) for model in (LS, "LS + BPNN"))
        removed = 1.0 - both / ls
        gains.append(BlockedGain(name, *map(float, (ls.mean(), removed.mean(), removed.min(), removed.max()))))
        if progress is not None:
            progress("gains on blocks held out", len(gains), len(designs))
    return gains
