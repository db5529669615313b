"""Errors on rows that no fit saw: of rows held out once, or of all blocks of a file, each judged without itself.

Rows of a block are alike, and so are their errors. What a calibration leaves on one block says little of the next, so
an interval over rows of few blocks is far too narrow; between ten blocks it holds. SI units.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pickenv.arm.kinematics.geometry import Array
from pickenv.calibration.assessment.metrics import LEAST_ROWS
from pickenv.calibration.identification.least_squares import Identification
from pickenv.calibration.identification.rows import unknowns_of
from pickenv.calibration.model.arm_model import ArmModel
from pickenv.calibration.model.measurements import Measurements
from pickenv.calibration.model.observations import Observations
from pickenv.calibration.model.pixels import PixelObservations
from pickenv.calibration.model.splits import Rows
from pickenv.calibration.model.stacked import Stacked
from pickenv.calibration.pipeline.calibration import Calibration
from pickenv.calibration.pipeline.fitting import Fit
from pickenv.calibration.pipeline.restation import errors_there, restationed
from pickenv.intervals import LEAST

NOMINAL = "nominal"
GEOMETRIC = "geometric"
AS_CHOSEN = "as chosen without each block"


@dataclass(frozen=True, eq=False)
class HeldOut:
    """Errors ``(M, 6)``, ``(M, 3)`` or ``(M, 1)``, m and rad, of rows that no fit saw.

    Attributes:
        errors: By model: "nominal", "geometric", then what was added; the last is what is used.
        parametric: Of the model used, without its learnt residual.
        used: Name of the model that each part of the rows was judged by: one, or one per block.
        blocks: The block of each error ``(M,)``; None where rows were held out once.
        refit: How frames were found anew for these rows, in words; empty where they are those of the fit.
        pixels: Of pictures the geometry's errors in px too, view by view; empty for other kinds.
    """

    errors: dict[str, Array]
    parametric: Array
    used: tuple[str, ...]
    blocks: Rows | None = None
    refit: str = ""
    pixels: tuple[Array, ...] = ()

    def text(self, rows: int, fitted: int) -> str:
        """How these rows were held out, in words.

        Args:
            rows: Number of rows judged.
            fitted: Number of rows that the calibration was fitted to.
        """
        if self.blocks is None:
            counted = f"{rows} {self.rows} held out, {fitted} fitted{self.refit}"
            return f"{counted}; interval over rows{self._reason()}"
        counts = Counter(self.used).most_common()
        chosen = ", ".join(name if len(counts) == 1 else f"{name} ({count})" for name, count in counts)
        return (
            f"{rows} {self.rows}, each judged without its block: mean over {self._values} contiguous blocks, "
            f"between-block interval{self._reason()}; fitted without each block, and chosen on others: {chosen}; the "
            f"calibration is fitted to all {fitted}"
        )

    @property
    def rows(self) -> str:
        """What rows are called: "views" of pictures."""
        return "views" if self.pixels else "rows"

    @property
    def no_interval(self) -> str:
        """Why there is no interval, in words; empty where there is one."""
        least, what = (LEAST_ROWS, "rows") if self.blocks is None else (LEAST, "blocks")
        return "" if self._values >= least else f"no interval: {self._values} {what} are fewer than {least}"

    @property
    def _values(self) -> int:
        """How many independent values an interval has."""
        return len(self.parametric) if self.blocks is None else len(np.unique(self.blocks))

    def _reason(self) -> str:
        return f" ({self.no_interval})" if self.no_interval else ""


def held_out_of(fits: Mapping[str, Fit], train: Observations, test: Observations) -> HeldOut:
    """Errors on rows held out once.

    Args:
        fits: The calibration of the geometry alone and what was added to it, step by step, by name.
        train: Rows that they were fitted to.
        test: Rows held out.
    """
    bare, (used, best) = next(iter(fits.values())), list(fits.items())[-1]
    if isinstance(test, Measurements):
        before = test.difference(ArmModel.of(bare.calibration.nominal))
    else:
        assert bare.aligned is not None
        before = missed_by(bare.aligned, test)
    names = (GEOMETRIC, *list(fits)[1:])
    errors = {name: what_is_left(fit, test) for name, fit in zip(names, fits.values(), strict=True)}
    pixels: tuple[Array, ...] = ()
    if isinstance(test, PixelObservations):
        found, views = bare.identification, [test.select(np.array([view])) for view in range(len(test.joints))]
        pixels = tuple(view.pixel_errors(found.arm_model, unknowns_of(found, view)) for view in views)
    return HeldOut({NOMINAL: before, **errors}, what_is_left(without_residual(best), test), (used,), pixels=pixels)


def held_out_elsewhere(
    fits: Mapping[str, Fit], test: Measurements, own: Sequence[str], count: int
) -> tuple[HeldOut, Rows]:
    """Errors on rows of another station, whose frames are found from a few of them, for each model by itself.

    Args:
        fits: The calibration of the geometry alone and what was added to it, step by step, by name.
        test: Rows of the other station.
        own: Which of "base" and "tool" it has of its own.
        count: Rows to find them from.

    Returns:
        The errors, and the rows that they are of.

    Raises:
        InputError: If there are too few rows.
    """
    bare, (used, best) = next(iter(fits.values())), list(fits.items())[-1]
    at = restationed(best.calibration, test, own, count)

    def left(calibration: Calibration) -> Array:
        return errors_there(restationed(calibration, test, own, count, at.used), calibration, test)

    nominal = replace(bare.calibration, model=ArmModel.of(bare.calibration.nominal))
    names = (GEOMETRIC, *list(fits)[1:])
    errors = {name: left(fit.calibration) for name, fit in zip(names, fits.values(), strict=True)}
    refit = f", {' and '.join(own)} found from {count} others of the same station"
    parametric = left(best.calibration.without_residual())
    return HeldOut({NOMINAL: left(nominal), **errors}, parametric, (used,), refit=refit), at.rest


def by_station(held_out: HeldOut, train: Stacked, folds: Sequence[tuple[Rows, Rows]]) -> HeldOut:
    """Errors of all blocks of several stations in the order of the stations' rows, as the rows stand.

    Args:
        held_out: Errors block by block.
        train: The rows.
        folds: For each block the rows fitted, and those held out.
    """
    rows = np.concatenate([held[train.select(held).rows_of_misses] for _, held in folds])
    order = np.argsort(train.places[rows], kind="stable")
    errors = {name: values[order] for name, values in held_out.errors.items()}
    blocks = None if held_out.blocks is None else held_out.blocks[order]
    return replace(held_out, errors=errors, parametric=held_out.parametric[order], blocks=blocks)


def pooled(names: Sequence[str], parts: Sequence[HeldOut]) -> HeldOut:
    """Errors of all blocks, one after the other.

    What is used was chosen anew without each block, so its steps may differ from block to block: the last row holds
    the last step of each, a row between the step before a residual was learnt.

    Args:
        names: Names of the steps of the calibration of all rows, in order.
        parts: One per block.
    """
    added = list(names[1:])
    if not added and any(len(part.errors) > 2 for part in parts):
        added = [AS_CHOSEN]
    errors = {name: np.concatenate([part.errors[name] for part in parts]) for name in (NOMINAL, GEOMETRIC)}
    parametric = np.concatenate([part.parametric for part in parts])
    errors |= dict.fromkeys(added[:-1], parametric)
    if added:
        errors[added[-1]] = np.concatenate([list(part.errors.values())[-1] for part in parts])
    blocks = np.repeat(np.arange(len(parts)), [len(part.parametric) for part in parts])
    used = tuple(name for part in parts for name in part.used)
    return HeldOut(errors, parametric, used, blocks, pixels=tuple(view for part in parts for view in part.pixels))


def without_residual(fit: Fit) -> Fit:
    """The fit without what was learnt."""
    return Fit(fit.calibration.without_residual(), fit.identification, fit.aligned)


def what_is_left(fit: Fit, data: Observations) -> Array:
    """A calibration's errors ``(N, 6)``, ``(N, 3)`` or ``(N, 1)``, m and rad, of stations in the first's axes."""
    tracked = tracked_rows(fit.identification, data)
    return missed_by(fit.identification, data) if tracked is None else fit.calibration.errors(tracked)


def missed_by(found: Identification, data: Observations) -> Array:
    """What an identified arm leaves of data, likewise."""
    tracked = tracked_rows(found, data)
    return (
        data.misses(found.arm_model, unknowns_of(found, data))
        if tracked is None
        else tracked.difference(found.arm_model)
    )


def tracked_rows(found: Identification, data: Observations) -> Measurements | None:
    """Poses or positions as they are, of stations as the first one would have measured them; None of other kinds."""
    if isinstance(data, Stacked):
        return data.from_the_first(found.arm_model, unknowns_of(found, data))
    return data if isinstance(data, Measurements) else None
