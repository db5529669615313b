"""Predicted beside measured gain: what a model removes of the step before it, by the twins and by the measured rows.

Intervals are of 95 %: of the measured gain over rows of random folds, or over ten blocks of the file, within which
neighbours are alike; of the predicted one for one more arm drawn. Errors in mm.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from pickenv.arm import Arm, Array, Plant, draw_plants, load_tolerances, plant_at
from pickenv.calibration import Choices, Measurements, Result, calibrate, simulated_tracker
from pickenv.calibration.model.observations import BLOCKS, Rows, contiguous_folds
from pickenv.calibration.pipeline.fitting import fit_remainder
from pickenv.errors import InputError
from pickenv.intervals import Ends, statistic_interval

# One fold of a measured robot: what calibrations leave of its rows, and what they leave of arms drawn from its twin.
# The twin is made of the other folds' rows alone. Its arms are draws from the posterior of geometry, terms and
# remainder, with the arm's own scatter, and are measured with the instrument's; a mean would flatter every model. The
# same calibrations are fitted to the drawn arms at the same joints. SI units.


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


@dataclass(frozen=True)
class Gain:
    """One model on one robot's rows; RMS in mm, reductions as fractions.

    Attributes:
        model: Its name.
        nominal_mm: Left by the nominal arm, base and tool fitted.
        before_mm: Left by the step that the reduction is a share of.
        held_out_mm: Left by the model.
        measured: Reduction on the measured rows.
        measured_ci95: Its interval.
        predicted: Mean reduction on the arms drawn from the twins.
        predicted_ci95: Where one more arm would lie; None of a single draw.
        predicted_mm: Left by the model on the drawn arms.
        refused: Arms drawn that could not be calibrated, in whose place others were drawn.
    """

    model: str
    nominal_mm: float
    before_mm: float
    held_out_mm: float
    measured: float
    measured_ci95: Ends | None
    predicted: float
    predicted_ci95: Ends | None
    predicted_mm: float
    refused: int = 0


def gains_of(folds: Sequence[Fold], split: str) -> list[Gain]:
    """The gain of every model over all folds of one split."""
    order = np.argsort(np.concatenate([fold.held for fold in folds]))
    measured = {name: np.concatenate([fold.measured[name] for fold in folds])[order] for name in folds[0].measured}
    # sums of squares of every fold and arm drawn, by model: (folds, draws)
    drawn = {name: np.array([[arm[name].sum() for arm in fold.predicted] for fold in folds]) for name in measured}
    rms = {name: float(1e3 * np.sqrt(values.mean())) for name, values in measured.items()}
    found = []
    for model, before in BEFORE.items():
        pairs = np.stack([measured[model], measured[before]], axis=-1)
        clusters = pairs
        if split != "random":
            clusters = np.array([part.sum(axis=0) for part in np.array_split(pairs, min(BLOCKS, len(pairs)))])
        predicted, ends = predicted_gain(drawn[model], drawn[before])
        found.append(
            Gain(
                model=model,
                nominal_mm=rms[NOMINAL],
                before_mm=rms[before],
                held_out_mm=rms[model],
                measured=_removed(pairs),
                measured_ci95=_interval(clusters),
                predicted=predicted,
                predicted_ci95=ends,
                predicted_mm=float(1e3 * np.sqrt(drawn[model].sum() / drawn[model].shape[1] / len(order))),
                refused=sum(fold.refused for fold in folds),
            )
        )
    return found


def _removed(pairs: Array) -> float:
    """Share of the RMS that is removed, from squares after and before ``(n, 2)``."""
    after, before = pairs.sum(axis=0)
    return float(1.0 - np.sqrt(after / before))


def _interval(clusters: Array) -> Ends | None:
    """Of that share; as the logarithm of what is left, which is less skewed."""
    ends = statistic_interval(clusters, lambda pairs: np.log1p(-_removed(pairs)))
    return None if ends is None else (float(-np.expm1(ends[1])), float(-np.expm1(ends[0])))


def predicted_gain(after: Array, before: Array) -> tuple[float, Ends | None]:
    """Mean gain of drawn arms, and where one more would lie.

    The twins of the folds differ and their arms are drawn apart, so the gain of one arm varies by the sum of what it
    varies by from arm to arm of each fold's twin (first order in the squares), with folds (draws - 1) degrees of
    freedom.

    Args:
        after: Sums of squared errors that the model leaves ``(folds, draws)``.
        before: Sums that the step before leaves.
    """
    folds, draws = after.shape
    every = 1.0 - np.sqrt(after.sum(axis=0) / before.sum(axis=0))
    gain = float(every.mean())
    if draws < 2:
        return gain, None
    from scipy.special import stdtrit

    slope = 0.5 * (1.0 - gain) * (after / after.sum(axis=0).mean() - before / before.sum(axis=0).mean())
    deviation = float(np.sqrt(slope.var(axis=1, ddof=1).sum() * (1.0 + 1.0 / draws)))
    half = float(stdtrit(folds * (draws - 1), 0.975)) * deviation
    return gain, (gain - half, gain + half)


def agreement(found: Mapping[tuple[str, str], Sequence[Gain]]) -> dict[str, float | int | None]:
    """How well gains were predicted, over all sets, splits and models.

    Args:
        found: Gains by robot and split.
    """
    every = [gain for gains in found.values() for gain in gains]
    learnt = [f"{LS} + {name}" for name in LEARNT]
    blocked = [gain for (_, split), gains in found.items() if split != "random" for gain in gains]
    signs = [(gain.predicted > 0.0) == (gain.measured > 0.0) for gain in blocked if gain.model in learnt]
    apart = partial(_points_apart, every)
    return {
        "sets": len({robot for robot, _ in found}),
        "gains": len(every),
        "median_absolute_difference_points": apart(0.5),
        "ninth_decile_points": apart(0.9),
        "learnt_on_blocks": len(signs),
        "sign_right": float(np.mean(signs)) if signs else None,
    }


def _points_apart(gains: Sequence[Gain], quantile: float) -> float | None:
    """A quantile of the difference of predicted and measured reduction, percentage points."""
    if not gains:
        return None
    return float(100.0 * np.quantile([abs(gain.predicted - gain.measured) for gain in gains], quantile))
