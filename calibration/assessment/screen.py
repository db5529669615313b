"""Error statistics with confidence intervals, and results formatted for people: four significant digits, units, tables.

The statistics are mean, RMS of the norm, per-axis RMS, standard deviation, 95th percentile, maximum and held-out R^2.
Both mean and RMS are printed, because an "RMSE" in a paper need not be the RMS of the norm. An "RMSE" below
the mean cannot be the RMS of the norm.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import zip_longest
from textwrap import wrap
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from pickenv.arm import Array
from pickenv.base import LEAST, Ends, folded, mean_interval, screen_width, side_by_side, statistic_interval
from pickenv.calibration.identification.least_squares import Identification, is_angle, rms_of
from pickenv.calibration.identification.term_choice import harmonics_of
from pickenv.calibration.model.measurements import screen_unit
from pickenv.calibration.model.observations import BLOCKS, Observations, Rows, same_poses
from pickenv.calibration.model.pixels import LENS_NAMES
from pickenv.calibration.model.terms import ComplianceTerm

LEAST_ROWS = 20
"""Smallest number of single errors for a 95 % interval of their mean; with ten, it covers the mean in only 92 %."""

MOST_APART = 0.4
"""Largest spread between blocks for which an interval of the root mean square is computed. The spread is the standard
deviation of the logarithms of the blocks' root mean squares. Above this spread one block outweighs the others, and an
interval from ten blocks covers the root mean square in less than 93 %. For the errors that calibrations of measured
robots leave, the spread is 0.03 to 0.23."""


@dataclass(frozen=True)
class ErrorStatistics:
    """Statistics of the norms of N error vectors, in the unit of the errors.

    Attributes:
        mean: Mean norm.
        mean_ci95: 95 % interval of the mean, not below 0, from single errors or from blocks of errors. None if there
            are too few errors or blocks.
        rms: Root mean square of the norm.
        rms_ci95: 95 % interval of the root mean square, from blocks; None without blocks, with too few blocks, or if
            blocks differ by more than `MOST_APART`.
        std: Standard deviation of the norm.
        p95: 95th percentile of the norm.
        max: Largest norm.
        axis_rms: Root mean square of each component.
        count: Number of errors N.
    """

    mean: float
    mean_ci95: Ends | None
    rms: float
    rms_ci95: Ends | None
    std: float
    p95: float
    max: float
    axis_rms: tuple[float, ...]
    count: int

    def as_dict(self) -> dict[str, Any]:
        """Return the statistics by name, as values for JSON."""
        return asdict(self)


def error_statistics(errors: ArrayLike, blocks: ArrayLike | None = None) -> ErrorStatistics:
    """Compute statistics of error vectors, or of their norms.

    Args:
        errors: Error vectors ``(N, k)``, or norms ``(N,)``; for norms, ``axis_rms`` is empty.
        blocks: For each error, an integer that is the same for all errors of one block of rows ``(N,)``; None if errors
            are independent. Errors of one block are correlated, so intervals come from differences between blocks.

    Raises:
        ValueError: If there are no errors or some are not finite.
    """
    errors = np.asarray(errors, dtype=float)
    if errors.size == 0 or not np.isfinite(errors).all():
        raise ValueError("error statistics need at least one error, all finite")
    norms = np.abs(errors) if errors.ndim == 1 else np.linalg.norm(errors, axis=1)
    ends = mean_interval(norms, LEAST_ROWS) if blocks is None else block_interval(norms, blocks)
    return ErrorStatistics(
        mean=float(norms.mean()),
        mean_ci95=None if ends is None else (max(ends[0], 0.0), ends[1]),  # no mean norm is below 0
        rms=float(np.sqrt(np.mean(norms**2))),
        rms_ci95=None if blocks is None else block_interval(norms, blocks, rms=True),
        std=float(norms.std()),
        p95=float(np.percentile(norms, 95)),
        max=float(norms.max()),
        axis_rms=() if errors.ndim == 1 else tuple(float(v) for v in np.sqrt(np.mean(errors**2, axis=0))),
        count=len(norms),
    )


def block_interval(values: ArrayLike, blocks: ArrayLike, *, rms: bool = False) -> Ends | None:
    """Compute the 95 % interval of the mean of values from the differences between blocks.

    The result is None with fewer than ten blocks. Neighbouring blocks may be correlated. For blocks of equal size the
    interval is the `ordered_interval` of the blocks' means.

    Args:
        values: The values ``(N,)``.
        blocks: For each value, an integer that is the same for all values of one block ``(N,)``.
        rms: Whether to compute the interval of the root mean square. It is then computed from logarithms, which are
            less skewed. The result is None if blocks differ by more than `MOST_APART`.
    """
    which = np.unique(np.asarray(blocks), return_inverse=True)[1]
    summed = np.asarray(values, dtype=float) ** (2 if rms else 1)
    sums = np.stack([np.bincount(which, summed), np.bincount(which)], axis=1)
    if len(sums) < LEAST:
        return None
    if not rms:
        return statistic_interval(sums, lambda rows: rows[:, 0].sum() / rows[:, 1].sum(), ordered=True)
    if not (sums[:, 0] > 0.0).all() or np.std(0.5 * np.log(sums[:, 0] / sums[:, 1]), ddof=1) > MOST_APART:
        return None
    ends = statistic_interval(sums, lambda rows: 0.5 * np.log(rows[:, 0].sum() / rows[:, 1].sum()), ordered=True)
    return None if ends is None else (float(np.exp(ends[0])), float(np.exp(ends[1])))


def held_out_r2(truth: ArrayLike, predicted: ArrayLike) -> Array:
    """Compute the coefficient of determination R^2 ``(k,)`` of each column of held-out rows.

    1 is a perfect prediction. 0 is as good as the mean of the true values.

    Args:
        truth: True values ``(N, k)``.
        predicted: Predicted values ``(N, k)``.
    """
    truth, predicted = np.asarray(truth, dtype=float), np.asarray(predicted, dtype=float)
    unexplained = np.sum((truth - predicted) ** 2, axis=0)
    return np.asarray(1.0 - unexplained / np.sum((truth - truth.mean(axis=0)) ** 2, axis=0))


NARROW = 10
"""Smallest width of a column of words, in characters."""

LENGTHS_OF_KINDS = ("reflector", "anchor", "socket", "point", "tip", "plane_offset", "zero")
NUMBERS_OF_KINDS = ("scale", "normal", "axis", "down")
"""Prefixes of the unknowns that kinds of measurement add: lengths; directions and scales, which have no unit."""


def figure(value: float | None) -> str:
    """Format a number with four significant digits; None and NaN become "unknown"."""
    if value is None or np.isnan(value):
        return "unknown"
    if value == 0 or 1e-3 <= abs(value) < 1e4:
        return f"{value:#.4g}".rstrip(".")
    return f"{value:.0f}" if 1e4 <= abs(value) < 1e9 else f"{value:.3e}"


def error_cells(errors: ErrorStatistics) -> tuple[str, ...]:
    """Format error statistics as cells of a table: RMS, mean, its 95 % interval, 95th percentile and maximum."""
    interval = "none" if errors.mean_ci95 is None else " to ".join(map(figure, errors.mean_ci95))
    return figure(errors.rms), figure(errors.mean), interval, figure(errors.p95), figure(errors.max)


def is_number(cell: str) -> bool:
    """Return whether a table's cell begins like a number; such cells are aligned to the right."""
    return cell[:1] in tuple("+-0123456789")


@dataclass(frozen=True)
class Block:
    """A table of text with a title, for terminal and HTML page.

    Attributes:
        title: The table's title.
        header: Column titles with units; empty for plain lines.
        rows: The cells of each row.
        note: A remark on the table, which may be empty.
        key: Name of the table for programs.
    """

    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    note: str = ""
    key: str = ""

    def text(self) -> str:
        """Return the table as text for the terminal.

        To fit the terminal's width, column titles and words are broken over lines. A table that is still too wide is
        split into several.
        """
        width = screen_width()
        return "\n".join(folded(self.title + (f": {self.note}" if self.note else ""), width) + self._lines(width))

    def _lines(self, width: int) -> list[str]:
        """Return the lines of header and cells, at most ``width`` characters wide if words can be broken to fit."""
        columns = list(zip(*self.rows, strict=True))
        heads = self.header or ("",) * len(columns)
        numeric = [bool(self.header) and is_number(cells[0]) for cells in columns]
        sizes = [max(map(len, (head, *cells))) for head, cells in zip(heads, columns, strict=True)]
        if over(sizes, width) > 0:
            sizes = [max(map(len, (*head.split(), *cells))) for head, cells in zip(heads, columns, strict=True)]
            for i in reversed([i for i, number in enumerate(numeric) if not number]):
                sizes[i] = max(min(sizes[i], NARROW), sizes[i] - max(over(sizes, width), 0))
        lines = []
        for table in side_by_side([size + 2 for size in sizes], 1, width):
            for row in ([self.header] if self.header else []) + list(self.rows):
                cells = [wrap(row[i], sizes[i], break_on_hyphens=False) or [""] for i in table]
                for parts in zip_longest(*cells, fillvalue=""):
                    set_out = zip(parts, table, strict=True)
                    padded = [f"{part:{'>' if numeric[i] else '<'}{sizes[i]}}" for part, i in set_out]
                    lines.append("  " + "  ".join(padded).rstrip())
        return lines


def over(sizes: Sequence[int], width: int) -> int:
    """Return the number of characters by which a row of columns is wider than a line; two spaces precede each column.

    Args:
        sizes: Width of each column, in characters.
        width: Width of the line, in characters.
    """
    return sum(sizes) + 2 * len(sizes) - width


def unit_of(name: str, geometric: tuple[str, ...]) -> tuple[str, float]:
    """Return the unit in which a parameter is shown, and the factor from SI to this unit.

    Coefficients of terms are shown in SI units.

    Args:
        name: Name of the parameter.
        geometric: Names of all geometric parameters of the arm.
    """
    if name in geometric or name.startswith(("base", "tool")):
        return screen_unit(not is_angle(name))
    if name.startswith(LENGTHS_OF_KINDS):
        return "mm", 1e3
    if name.startswith(NUMBERS_OF_KINDS):
        return "1", 1.0
    if name in LENS_NAMES:
        return ("px", 1.0) if name in LENS_NAMES[:4] else ("1", 1.0)
    return "SI", 1.0


# The drives' harmonics as terminal, page, JSON and saved file show them: orders and amplitudes with uncertainties.


OWN = (
    "they belong to this unit and this session: another robot of the same model, or this one after a repair or in "
    "another set-up, needs its own"
)
"""Note below a table of harmonics. On a measured arm, harmonics of one session increased the errors of another one."""


def harmonic_rows(found: Identification) -> list[dict[str, Any]]:
    """Return the identified harmonics of the drives as values for JSON, the largest first.

    Joints are numbered from 1. Orders, in cycles per turn, and amplitudes, in deg or mm, come with their standard
    deviations.
    """
    geometry, rows = found.geometry, []
    for joint, order, order_std, amplitude, amplitude_std in harmonics_of(found):
        unit, scale = screen_unit(geometry.prismatic[joint])
        row = {"joint": joint + 1, "name": geometry.joint_names[joint], "order": order, "order_std": order_std}
        rows.append(row | {"unit": unit, "amplitude": amplitude * scale, "amplitude_std": amplitude_std * scale})
    return rows


def harmonic_block(rows: Sequence[Mapping[str, Any]]) -> Block:
    """Return the rows of `harmonic_rows` as a table."""
    header = ("joint", "order (cycles per turn)", "± 1 sigma", "amplitude", "± 1 sigma", "unit")
    cells = []
    for row in rows:
        order_std = "given" if row["order_std"] is None else f"{row['order_std']:.2f}"
        sizes = (f"{row['amplitude']:.5f}", f"{row['amplitude_std']:.5f}")
        cells.append((f"{row['joint']} ({row['name']})", f"{row['order']:.2f}", order_std, *sizes, str(row["unit"])))
    return Block("Harmonics of the drives", header, tuple(cells), OWN, "harmonics")


# Joint stiffnesses as terminal, page, JSON and saved file show them: k = 1/c of the compliance c that was found.


TOLD = 2.0
"""Ratio of a compliance to its standard uncertainty up to which only a lower bound on the stiffness is shown."""

NOTE = (
    "from torques; where none are known, as at a target, those of the arm's own weight are taken, which were fitted to "
    "the measured ones and leave of them what the last column says"
)


def stiffness_rows(found: Identification, data: Observations) -> list[dict[str, Any]]:
    """Return the identified stiffness of each joint as values for JSON, with its standard deviation.

    Joints are numbered from 1. Stiffnesses are in N*m/rad for revolute joints, in N/m for prismatic ones. If torques
    were measured, each joint has two more values, N*m or N: the RMS of the measured torque, and the RMS of the part of
    the torque that the arm's weight does not explain.

    Args:
        found: The identification.
        data: The rows that it was fitted to.
    """
    model, rows = found.arm_model, []
    geometry = model.geometry
    value = dict(zip(model.parameter_names[len(geometry.parameter_names) :], model.coefficients, strict=True))
    spread = dict(zip(found.identifiability.kept_names, np.sqrt(np.diag(found.covariance)), strict=True))
    measured, bare = data.conditions.torque, replace(data.conditions, torque=None)
    for term in (term for term in model.terms if isinstance(term, ComplianceTerm)):
        expected = None if measured is None else term.torques(geometry, data.joints, bare)
        for joint, name in zip(term.joints, term.names(geometry), strict=True):
            c, std = float(value[name]), float(spread.get(name, np.inf))
            stiffness, stiffness_std = (1.0 / c, std / c**2) if c > TOLD * std else (None, None)
            unit, least = "N/m" if geometry.prismatic[joint] else "N*m/rad", 1.0 / (max(c, 0.0) + TOLD * std)
            row = {"joint": joint + 1, "name": geometry.joint_names[joint], "unit": unit}
            row |= {"stiffness": stiffness, "stiffness_std": stiffness_std, "at_least": least}
            if measured is not None and expected is not None:
                row["torque_rms"] = rms_of(measured[:, joint])
                row["torque_left_rms"] = rms_of(measured[:, joint] - expected[:, joint])
            rows.append(row)
    return rows


def stiffness_block(rows: Sequence[Mapping[str, Any]]) -> Block:
    """Return the rows of `stiffness_rows` as a table."""
    header = ("joint", "stiffness", "± 1 sigma", "unit", "torques, RMS", "of these left")
    cells = []
    for row in rows:
        known_stiffness = row["stiffness"] is not None
        sizes = (figure(row["stiffness"]), figure(row["stiffness_std"])) if known_stiffness else ("", "")
        least = f", at least {figure(row['at_least'])}" if row["at_least"] else ""
        unit = row["unit"] if known_stiffness else f"{row['unit']}; not told{least}"
        torques = [figure(row[key]) if key in row else "" for key in ("torque_rms", "torque_left_rms")]
        cells.append((f"{row['joint']} ({row['name']})", *sizes, unit, *torques))
    note = NOTE if any("torque_rms" in row for row in rows) else "from the weight of the masses in the arm's file"
    return Block("Stiffnesses of the joints", header, tuple(cells), note, "stiffnesses")


def within95(joints: Array, squares: Array, variance: Array, blocks: Rows | None) -> dict[str, float] | None:
    """Compute the factor such that 95 of 100 errors are smaller than the factor times their expected RMS size.

    Args:
        joints: Joints of each error's row ``(R, n)``, rad or m.
        squares: Squared norms of the errors ``(R,)``, m^2 or rad^2.
        variance: Part of each expected square that the parameters cause ``(R,)``, in the unit of ``squares``.
        blocks: For each error, an integer that is the same for all errors of one block of rows ``(R,)``; if None,
            blocks are contiguous tenths of the poses.

    Returns:
        The entry "factor", and the entry "covered": the share of errors that are smaller than a factor times their
        expected size. For "covered", each block has its own factor, computed from the errors of all other blocks. None
        if there are too few errors or blocks.
    """
    count = len(squares)
    if count < 2 * BLOCKS:
        return None
    if blocks is None:
        poses = same_poses(joints)
        blocks = poses * BLOCKS // (int(poses.max()) + 1)
    numbers = np.unique(blocks)
    if len(numbers) < 2:
        return None
    ratio = np.zeros(count)
    for number in numbers:
        rows = blocks == number
        ratio[rows] = np.sqrt(squares[rows]) / np.sqrt(squares[~rows].mean() + variance[rows])
    inside = [ratio[blocks == number] <= _quantile(ratio[blocks != number]) for number in numbers]
    return {"factor": _quantile(ratio), "covered": float(np.concatenate(inside).mean())}


def _quantile(ratio: Array) -> float:
    """Return the 95 % conformal quantile of n ratios: the ratio of rank 0.95 (n + 1), rounded up, and at most n."""
    rank = int(np.ceil(0.95 * (len(ratio) + 1)))
    return float(np.sort(ratio)[min(rank, len(ratio)) - 1])
