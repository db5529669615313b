"""One fold of a measured robot: what calibrations leave of its rows, and what they leave of arms drawn from its twin.

The twin is made of the other folds' rows alone. Its arms are draws from the posterior of geometry, terms and remainder,
with the arm's own scatter, and are measured with the instrument's; a mean would flatter every model. The same
calibrations are fitted to the drawn arms at the same joints. SI units.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from pickenv.arm import Arm, Array, Plant, draw_plants, load_tolerances, plant_at
from pickenv.calibration import Choices, Measurements, Result, calibrate, simulated_tracker
from pickenv.calibration.model.observations import Rows, contiguous_folds
from pickenv.calibration.pipeline.fitting import fit_remainder
from pickenv.errors import InputError

SPLITS = ("random", "blocks")
BATCHES = 4
"""So many times as many arms as are wanted are drawn at most, where some cannot be calibrated."""

LEARNT = {"BPNN": "bpnn", "GP": "gp"}
NOMINAL, LS, TERMS = "nominal", "LS", "LS + terms"

BEFORE = {LS: NOMINAL, TERMS: LS, **{f"LS + {name}": LS for name in LEARNT}}
"""The models, and what each one's reduction is a share of."""

Squares = dict[str, Array]
"""Squared position errors of the rows held out ``(M,)``, by model, m^2."""


@dataclass(frozen=True)
class Fold:
    """Where rows are judged.

    Attributes:
        held: Rows held out, in file order.
        measured: Squared errors on them.
        predicted: Squared errors on arms drawn from the twin, one by one.
        refused: Arms drawn beside them that no calibration could be found for, as nobody would use it of a real arm.
    """

    held: Rows
    measured: Squares
    predicted: tuple[Squares, ...]
    refused: int = 0

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        listed = [{name: values.tolist() for name, values in each.items()} for each in (self.measured, *self.predicted)]
        return {"held": self.held.tolist(), "measured": listed[0], "predicted": listed[1:], "refused": self.refused}

    @staticmethod
    def from_dict(content: Mapping[str, Any]) -> Fold:
        """The inverse of `as_dict`."""
        measured, *predicted = (
            {name: np.array(values) for name, values in each.items()}
            for each in (content["measured"], *content["predicted"])
        )
        return Fold(np.array(content["held"], dtype=np.int64), measured, tuple(predicted), content["refused"])


def folds_of(poses: Rows, split: str, folds: int, rng: np.random.Generator) -> list[tuple[Rows, Rows]]:
    """Rows to fit and rows held out: of a file whose poses are shuffled, or contiguous parts of it."""
    count = int(poses.max()) + 1
    place = np.argsort(rng.permutation(count)) if split == "random" else np.arange(count)
    return contiguous_folds(np.zeros_like(poses), place[poses], folds)


def judged_fold(
    arm: Arm, data: Measurements, rows: tuple[Rows, Rows], draws: int, seed: np.random.SeedSequence
) -> Fold:
    """Measured rows and arms drawn, calibrated on ``rows[0]`` and judged on ``rows[1]``.

    Raises:
        InputError: If the measured rows cannot be calibrated, or too many of the arms drawn.
    """
    fitted, held = rows
    first, drawing, *others = seed.spawn(2 + draws)
    measured, result = left_by_models(arm, data.select(fitted), data.select(held), np.random.default_rng(first))
    plant, refused = result.plant(), 0
    predicted: list[Squares] = []
    for _ in range(BATCHES):
        arms = draw_plants(plant, load_tolerances("medium"), draws, np.random.default_rng(drawing))
        for number, other in enumerate(others[: draws - len(predicted)]):
            rng = np.random.default_rng(other)
            train, test = (seen_of(plant_at(arms, number), data.select(part), rng) for part in rows)
            try:
                predicted.append(left_by_models(arm, train, test, rng)[0])
            except InputError:
                refused += 1
        if len(predicted) == draws:
            return Fold(held, measured, tuple(predicted), refused)
        drawing, *others = seed.spawn(1 + draws)
    raise InputError(f"{data.source}: {refused} arms drawn from the twin could not be calibrated")


def left_by_models(
    arm: Arm, train: Measurements, test: Measurements, rng: np.random.Generator
) -> tuple[Squares, Result]:
    """Squared errors of the rows held out, and the calibration with terms; residuals are learnt of positions."""
    result = calibrate(arm, train, test=test, choices=Choices(residual="none", robust=False))
    errors = {NOMINAL: result.errors["nominal"], LS: result.errors["geometric"]}
    errors[TERMS] = result.fit.calibration.errors(test)
    for name, kind in LEARNT.items():
        learnt = fit_remainder(result.geometric, kind, train.positions_only(), rng).calibration
        errors[f"LS + {name}"] = learnt.errors(test.positions_only())
    return {name: np.sum(left[:, :3] ** 2, axis=1) for name, left in errors.items()}, result


def seen_of(plant: Plant, rows: Measurements, rng: np.random.Generator) -> Measurements:
    """What the instrument sees of an arm at the joints of these rows."""
    seen = simulated_tracker(plant, rows.joints, rng)
    return replace(rows, position=seen.position, rotation=None if rows.rotation is None else seen.rotation)
