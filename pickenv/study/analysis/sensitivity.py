"""Which tolerance matters: shares of the variance between arms, by regression on a study's rows and by Sobol indices.

The squared error of an arm is a quadratic form of its deviations, so it is regressed on each deviation x and on x^2
(standardised; the arm's RMS error over the fruit, squared, in mm^2). For independent deviations the variance of
b x + c x^2 is the parameter's first-order share, c is what its spread adds to the mean square error, and what R^2
leaves is interaction and what no column holds. Sobol indices (Saltelli 2010) need no such model but many more arms.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray
from pyarrow.dataset import Dataset
from scipy.stats import qmc, sobol_indices

from pickenv.arm.kinematics.geometry import Array
from pickenv.bootstrap import interval95, resampled
from pickenv.errors import InputError
from pickenv.study.results.row_table import OK
from pickenv.threads import single_threaded

DEVIATION = re.compile(r"delta_.+_(mm|deg)|size_.+|rise_K")
"""Columns that hold what was drawn for an arm."""
BLOCKS = 100
"""Groups of arms that the bootstrap resamples; an arm's group follows from its number."""
RESAMPLES = 500
ARMS_PER_TERM = 3
"""A regression is refused on fewer arms for each of its terms."""


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


def sensitivities_of(rows: Dataset, setting: int = 0, *, rng: np.random.Generator | None = None) -> pa.Table:
    """Shares of the variance of the arms' squared errors, per parameter and per kind of parameter.

    Args:
        rows: A study's rows, of any number; they are read in batches.
        setting: Number of the setting; failed arms are left out.
        rng: Draws the bootstrap over `BLOCKS` groups of arms; a fixed one when left out.

    Returns:
        One row per parameter and per kind, largest share first: ``parameter`` (or the kind's name), ``kind``, ``level``
        (parameter or kind), ``share`` of the variance with its 95 % interval ``share_low``, ``share_high``,
        ``mean_square_mm2`` (what its spread adds to the mean of the squared error) with its interval,
        ``linear`` (standardised regression coefficient of the deviation; NaN for kinds), and the whole regression's
        ``r2``, ``r2_adjusted`` and ``arms``.

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
    rng = rng or np.random.default_rng(0)
    weights = rng.multinomial(BLOCKS, np.full(BLOCKS, 1.0 / BLOCKS), RESAMPLES)
    whole = moments.sums.sum(axis=0)
    groups = {name: [i] for i, name in enumerate(moments.names)}
    kinds: dict[str, list[int]] = {}
    for i, name in enumerate(moments.names):
        kinds.setdefault(tolerance_kind(name), []).append(i)
    places = [*groups.values(), *kinds.values()]
    with single_threaded():  # small systems: threads would only wait for one another
        found = _shares(whole, places)
        replicates = [_shares(np.tensordot(w, moments.sums, 1), places) for w in weights]
    ends = {key: interval95(np.array([r[key] for r in replicates])) for key in ("share", "mean_square")}
    r2 = float(found["r2"])
    about = {"r2": r2, "r2_adjusted": 1.0 - (1.0 - r2) * (moments.arms - 1) / (moments.arms - terms)}
    table: list[dict[str, Any]] = [
        {
            "parameter": name,
            "kind": name if level == "kind" else tolerance_kind(name),
            "level": level,
            "share": float(found["share"][i]),
            "share_low": float(ends["share"][0, i]),
            "share_high": float(ends["share"][1, i]),
            "mean_square_mm2": float(found["mean_square"][i]),
            "mean_square_low_mm2": float(ends["mean_square"][0, i]),
            "mean_square_high_mm2": float(ends["mean_square"][1, i]),
            "linear": float(found["linear"][i]) if level == "parameter" else float("nan"),
            **about,
            "arms": moments.arms,
        }
        for i, (name, level) in enumerate([*((n, "parameter") for n in groups), *((k, "kind") for k in kinds)])
    ]
    return pa.Table.from_pylist(sorted(table, key=lambda row: -row["share"]))


def tolerance_kind(column: str) -> str:
    """What kind of tolerance a deviation's column belongs to: angles, lengths, or the effect whose size it is."""
    if column.startswith("delta_"):
        return "angles" if column.endswith("_deg") else "lengths"
    if column == "rise_K":
        return "temperature rise"
    return re.sub(r"_\d+$", "", column.removeprefix("size_")).replace("_", " ")


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


def _shares(sums: Array, groups: Sequence[Sequence[int]]) -> dict[str, Array]:
    """Regress, then the share, the mean square and the linear coefficient of each group of deviations."""
    count = sums[0, 0]
    mean = sums[0] / count
    covariance = sums / count - np.outer(mean, mean)
    terms, variance = covariance[1:-1, 1:-1], covariance[-1, -1]
    steadied = terms + np.diag(1e-10 * np.diag(terms))  # two deviations that are one share what they explain
    slopes = np.linalg.solve(steadied, covariance[1:-1, -1])
    k = len(slopes) // 2
    share = []
    for group in groups:
        places = [*group, *(k + i for i in group)]
        share.append(slopes[places] @ terms[np.ix_(places, places)] @ slopes[places] / variance)
    return {
        "share": np.array(share),
        "mean_square": np.array([slopes[k:][list(group)].sum() for group in groups]),
        "linear": np.array([slopes[group[0]] * np.sqrt(terms[group[0], group[0]] / variance) for group in groups]),
        "r2": slopes @ covariance[1:-1, -1] / variance,
    }


def sobol_table(
    model: Callable[[Array], Array], groups: Mapping[str, Sequence[int]], samples: int, rng: np.random.Generator
) -> pa.Table:
    """Sobol indices, first and total, of groups of independent inputs.

    Args:
        model: From even random numbers ``(N, d)`` in 0..1 to one finite number for each row ``(N,)``.
        groups: For each group, which inputs belong to it; together they name every input once.
        samples: A power of two; the model is evaluated (number of groups + 2) times as often.
        rng: Draws the scrambled Sobol sequence and the bootstrap.

    Returns:
        One row per group: ``group``, ``first_order``, ``total``, and 95 % bootstrap intervals ``first_order_low`` and
        so on. Total minus first order is interaction.

    Raises:
        InputError: If the groups do not name every input once, or ``samples`` is no power of two.
    """
    inputs = sorted(i for group in groups.values() for i in group)
    d = len(inputs)
    if inputs != list(range(d)) or not d:
        raise InputError(f"the groups name inputs {inputs}; name each of 0 to {max(inputs, default=0)} once")
    if samples < 2 or samples & (samples - 1):
        raise InputError(f"{samples} samples; give a power of two, such as 1024")
    even = qmc.Sobol(2 * d, rng=rng).random(samples)
    first, second = even[:, :d], even[:, d:]
    mixed = []
    for group in groups.values():
        swapped = first.copy()
        swapped[:, list(group)] = second[:, list(group)]
        mixed.append(model(swapped))
    at_first, at_second, at_mixed = model(first)[None], model(second)[None], np.stack(mixed)[:, None]

    def indices(chosen: Any) -> Array:
        values = {"f_A": at_first[:, chosen], "f_B": at_second[:, chosen], "f_AB": at_mixed[..., chosen]}
        found = sobol_indices(func=values, n=samples)  # type: ignore[arg-type]
        return np.stack([np.ravel(found.first_order), np.ravel(found.total_order)])

    whole = indices(slice(None))
    low, high = interval95(resampled(np.arange(samples)[None], indices, rng, RESAMPLES))
    return pa.Table.from_pylist(
        [
            {"group": name}
            | {
                f"{kind}{end}": float(v[row, i])
                for row, kind in enumerate(("first_order", "total"))
                for end, v in (("", whole), ("_low", low), ("_high", high))
            }
            for i, name in enumerate(groups)
        ]
    )
