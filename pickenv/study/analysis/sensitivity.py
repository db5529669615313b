"""Which tolerance matters: shares of the variance between arms, by regression on a study's rows.

The squared error of an arm is a quadratic form of its deviations, so it is regressed on each deviation x and on x^2
(standardised; the arm's RMS error over its own fruit, squared, in mm^2). For independent deviations the variance of
b x + c x^2 is the parameter's first-order share, c is what its spread adds to the mean square error, and what R^2
leaves is interaction, the arm's own fruit and poses, the tracker, and what no column holds.

A regression finds a share even where there is none: what scatter alone would give is taken off, so that a tolerance
without effect has a share of zero on average. Intervals come from the jackknife over groups of arms (`_interval`).
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray
from pyarrow.dataset import Dataset
from scipy.special import chndtr, chndtrinc, ndtri, stdtrit

from pickenv.arm.kinematics.geometry import Array
from pickenv.errors import InputError
from pickenv.intervals import mean_interval
from pickenv.study.results.row_table import OK
from pickenv.threads import single_threaded

DEVIATION = re.compile(r"delta_.+_(mm|deg)|size_.+|(sine|cosine)_.+|rise_K")
"""Columns that hold what was drawn for an arm."""
BLOCKS = 100
"""Groups of arms that the jackknife leaves out in turn; an arm's group follows from its number."""
ARMS_PER_TERM = 5
"""A regression is refused on fewer arms for each of its terms."""
TAILS = (0.975, 0.025)


@dataclass(frozen=True, eq=False)
class Moments:
    """Sums that a regression needs, one set per block of arms.

    Attributes:
        names: Deviations that vary, k of them.
        sums: Sums of products ``(BLOCKS, 2 k + 2, 2 k + 2)`` of 1, x, x^2 and the squared error in mm^2, where x is the
            deviation minus its mean, over its standard deviation.
    """

    names: tuple[str, ...]
    sums: Array

    @property
    def arms(self) -> int:
        """Number of arms with a result."""
        return int(self.sums[:, 0, 0].sum())


def sensitivities_of(rows: Dataset, setting: int = 0) -> pa.Table:
    """Shares of the variance of the arms' squared errors, per parameter and per kind of parameter.

    Args:
        rows: A study's rows, of any number; they are read in batches.
        setting: Number of the setting; failed arms are left out.

    Returns:
        One row per parameter and per kind, largest share first: ``parameter`` (or the kind's name), ``kind``, ``level``
        (parameter or kind), ``share`` of the variance (by chance also below zero, where there is none) with its 95 %
        interval ``share_low``, ``share_high``, ``mean_square_mm2`` (what its spread adds to the mean of the squared
        error) with its interval, ``linear`` (standardised regression coefficient of the deviation; NaN for several),
        and the whole regression's ``r2``, ``r2_adjusted`` and ``arms``.

    Raises:
        InputError: If nothing varies, or there are too few arms for the number of deviations.
    """
    moments = _moments(rows, setting)
    terms = 2 * len(moments.names) + 1
    if not moments.names:
        raise InputError(f"nothing varies between the arms of setting {setting}; give its tolerances a spread")
    if moments.arms < ARMS_PER_TERM * terms:
        raise InputError(
            f"setting {setting} has {moments.arms} arms with a result; its {len(moments.names)} deviations need "
            f"{ARMS_PER_TERM * terms}"
        )
    groups: dict[str, list[int]] = {}
    kinds: dict[str, list[int]] = {}
    for i, name in enumerate(moments.names):
        groups.setdefault(parameter_of(name), []).append(i)
        kinds.setdefault(tolerance_kind(name), []).append(i)
    places = [*groups.values(), *kinds.values()]
    whole = moments.sums.sum(axis=0)
    with single_threaded():  # small systems: threads would only wait for one another
        found = _regressed(whole, places)
        left_out = [_regressed(whole - block, places) for block in moments.sums if block[0, 0]]
    chance = _share_by_chance(found, left_out, places, moments.arms)
    r2 = found.r2
    about = {"r2": r2, "r2_adjusted": 1.0 - (1.0 - r2) * (moments.arms - 1) / (moments.arms - terms)}
    spread = _jackknifed(np.array([part.mean_square for part in left_out]))
    half = float(stdtrit(len(left_out) - 1, TAILS[0])) * spread
    roots, blocks = np.sqrt(np.maximum(found.share, 0.0)), len(left_out)
    pseudo = blocks * roots - (blocks - 1) * np.sqrt(np.maximum([part.share for part in left_out], 0.0))
    table: list[dict[str, Any]] = []
    for i, (name, level) in enumerate([*((n, "parameter") for n in groups), *((k, "kind") for k in kinds)]):
        low, high = _interval(found.share[i], chance[i], pseudo[:, i])
        table.append(
            {
                "parameter": name,
                "kind": name if level == "kind" else tolerance_kind(moments.names[places[i][0]]),
                "level": level,
                "share": float(found.share[i] - chance[i]),
                "share_low": low,
                "share_high": high,
                "mean_square_mm2": float(found.mean_square[i]),
                "mean_square_low_mm2": float(found.mean_square[i] - half[i]),
                "mean_square_high_mm2": float(found.mean_square[i] + half[i]),
                "linear": float(found.linear[i]) if level == "parameter" and len(places[i]) == 1 else float("nan"),
                **about,
                "arms": moments.arms,
            }
        )
    return pa.Table.from_pylist(sorted(table, key=lambda row: -row["share"]))


def parameter_of(column: str) -> str:
    """The parameter that a column belongs to: its own name, or that of the error whose sine or cosine it is."""
    return re.sub(r"^(sine|cosine)_", "size_", column)


def tolerance_kind(column: str) -> str:
    """What kind of tolerance a deviation's column belongs to: angles, lengths, or the effect whose size it is."""
    if column.startswith("delta_"):
        return "angles" if column.endswith("_deg") else "lengths"
    if column == "rise_K":
        return "temperature rise"
    return re.sub(r"_\d+$", "", parameter_of(column).removeprefix("size_")).replace("_", " ")


def _moments(rows: Dataset, setting: int) -> Moments:
    """Read a setting's rows twice: for means and spreads, and for the products."""
    names = [name for name in rows.schema.names if DEVIATION.fullmatch(name)]
    chosen = (pc.field("setting") == setting) & (pc.field("status") == OK)

    def batches(columns: Sequence[str]) -> Any:
        for batch in rows.to_batches(columns=list(columns), filter=chosen, use_threads=False):
            if batch.num_rows:
                yield [batch[name].to_numpy(zero_copy_only=False) for name in columns]

    count, total, squares = 0, np.zeros(len(names)), np.zeros(len(names))
    for columns in batches(names):
        values = np.stack(columns, axis=1) if columns else np.zeros((0, 0))
        count, total, squares = count + len(values), total + values.sum(axis=0), squares + (values**2).sum(axis=0)
    mean = total / max(count, 1)
    deviation = np.sqrt(np.maximum(squares / max(count, 1) - mean**2, 0.0))
    varies = deviation > 1e-9 * np.maximum(np.abs(mean), 1e-3)
    kept = [name for name, used in zip(names, varies, strict=True) if used]
    size = 2 * len(kept) + 2
    sums = np.zeros((BLOCKS, size, size))
    for arm, error, *columns in batches(["arm", "error_rms_mm", *kept]):
        x = (np.stack(columns, axis=1) - mean[varies]) / deviation[varies] if columns else np.zeros((len(arm), 0))
        z = np.column_stack([np.ones(len(arm)), x, x**2, error**2])
        sums += _products(z, arm % BLOCKS)
    return Moments(tuple(kept), sums)


def _products(z: Array, block: NDArray[np.int64]) -> Array:
    """Sums of products of the rows ``(n, q)`` of each block ``(BLOCKS, q, q)``."""
    order = np.argsort(block, kind="stable")
    count = np.bincount(block, minlength=BLOCKS)
    place = np.arange(len(block)) - np.repeat(np.cumsum(count) - count, count)
    padded = np.zeros((BLOCKS, max(int(count.max()), 1), z.shape[1]))  # a row of zeros adds nothing
    padded[block[order], place] = z[order]
    return np.asarray(np.swapaxes(padded, 1, 2) @ padded)


@dataclass(frozen=True, eq=False)
class _Regression:
    """A regression on 2 k terms, x and x^2 of k deviations, and what it says of G groups of them.

    Attributes:
        slopes: ``(2 k,)``, mm^2.
        terms: Covariance of the terms ``(2 k, 2 k)``.
        variance: Of the squared error, mm^4.
        share: Of the variance ``(G,)``, with what scatter alone gives.
        mean_square: What the groups' spread adds to the mean of the squared error ``(G,)``, mm^2.
        linear: Standardised coefficient of each group's first deviation ``(G,)``.
        r2: Share of the variance that all of them explain.
    """

    slopes: Array
    terms: Array
    variance: float
    share: Array
    mean_square: Array
    linear: Array
    r2: float


def _regressed(sums: Array, groups: Sequence[Sequence[int]]) -> _Regression:
    """Regress on what `Moments` sums up."""
    count = sums[0, 0]
    mean = sums[0] / count
    covariance = sums / count - np.outer(mean, mean)
    terms, variance = covariance[1:-1, 1:-1], covariance[-1, -1]
    steadied = terms + np.diag(1e-10 * np.diag(terms))  # two deviations that are one share what they explain
    slopes = np.linalg.solve(steadied, covariance[1:-1, -1])
    k = len(slopes) // 2
    every = [_terms_of(group, k) for group in groups]
    return _Regression(
        slopes=slopes,
        terms=terms,
        variance=float(variance),
        share=np.array([slopes[p] @ terms[np.ix_(p, p)] @ slopes[p] / variance for p in every]),
        mean_square=np.array([slopes[k:][list(group)].sum() for group in groups]),
        linear=np.array([slopes[group[0]] * np.sqrt(terms[group[0], group[0]] / variance) for group in groups]),
        r2=float(slopes @ covariance[1:-1, -1] / variance),
    )


def _terms_of(group: Sequence[int], deviations: int) -> list[int]:
    """Places of x and x^2 of a group among the terms."""
    return [*group, *(deviations + i for i in group)]


def _share_by_chance(
    found: _Regression, left_out: Sequence[_Regression], groups: Sequence[Sequence[int]], arms: int
) -> Array:
    """What the scatter of the slopes alone adds to each group's share ``(G,)``.

    The scatter is the jackknife's, which holds for errors of any distribution; it is too large by as much as few arms
    leave the regression (the leverage), and put right for that.
    """
    k = len(found.slopes) // 2
    slopes = np.array([part.slopes for part in left_out])
    scatter = np.sqrt((len(slopes) - 1) / len(slopes) * (1.0 - (2 * k + 1) / arms)) * (slopes - slopes.mean(axis=0))
    added = []
    for group in groups:
        p = _terms_of(group, k)
        added.append(np.sum((scatter[:, p] @ found.terms[np.ix_(p, p)]) * scatter[:, p]) / found.variance)
    return np.array(added)


def _jackknifed(left_out: Array) -> Array:
    """Standard error ``(G,)`` of what was found with each of B blocks left out ``(B, G)``."""
    blocks = len(left_out)
    return np.asarray(np.sqrt((blocks - 1) / blocks * np.sum((left_out - left_out.mean(axis=0)) ** 2, axis=0)))


def _interval(share: float, chance: float, pseudo: Array) -> tuple[float, float]:
    """95 % interval of a share without what chance adds.

    The root of a share is a length in the space of slopes, and its standard error the same everywhere, so that the
    share over that error squared is noncentral chi-square, as if of ``chance / error**2`` degrees of freedom. The
    interval holds the noncentralities that such a share does not contradict. It begins at zero where zero is one of
    them, and holds the estimate where that is below zero.

    Args:
        share: With what chance adds.
        chance: What that is.
        pseudo: The jackknife's pseudo-values of the share's root; their skewness gives each side an error of its own.
    """
    estimate, ends = share - chance, mean_interval(pseudo)
    if ends is None:
        return estimate, estimate
    found = []
    for end, tail in zip(ends, TAILS, strict=True):
        scale = ((end - pseudo.mean()) / float(ndtri(TAILS[0]))) ** 2
        freedom = max(chance / scale, 1e-6)
        possible = chndtr(share / scale, freedom, 0.0) > tail  # else no share at all is too much already
        found.append(scale * float(chndtrinc(share / scale, freedom, tail)) if possible else 0.0)
    return min(found[0], estimate), max(found[1], estimate)
