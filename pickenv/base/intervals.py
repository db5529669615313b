"""95 % confidence intervals of means, ratios, shares, quantiles, and means over two crossed factors.

`estimate` computes estimates and their intervals from the rows of a table. Errors at several fruit of one arm are
correlated, so an arm counts once, with its mean. If a policy was trained several times, arms and training seeds are
two crossed random factors: another arm would give another estimate, and so would another training.

The other functions take arrays. Values of one arm are correlated, and so are values of one tree, or of one block of
contiguous poses of a file. So compute one statistic per arm first, and pass one value per arm. A function returns None
if the sample is too small or its values do not vary, because an interval that is too narrow would be worse than none.
Equal data give equal intervals.

How often each interval covers the true value is measured in tests/coverage, for errors like the errors of arms.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import scipy  # loads its parts when they are first used
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Statistic = Callable[[Array], Any]
"""A number computed from a table with one row per value: an arm, a tree, a block."""

Ends = tuple[float, float]
"""Lower and upper end of a 95 % interval."""

LEAST = 10
"""Smallest number of values (arms, trees, blocks) for an interval of a mean. With fewer, the coverage is too low for
skewed errors."""

LEAST_RUNS = 5
"""Smallest number of runs (training seeds, repeated calibrations) for an interval. Means of runs are nearly normal."""

EQUAL = "all arms are equal"
"""Reason why there is no interval though there are enough arms and runs."""

MOST_SKEWNESS = 3.0
"""Largest skewness that is corrected for. A larger sample skewness comes mostly from the single largest value."""

MOST_ALIKE = 0.6
"""Largest correlation of neighbouring values in a series for which `ordered_interval` is valid."""

MOST_WAVES = 12
"""`ordered_interval` uses fewer cosines than this number. With up to a hundred values, more would widen the
interval."""

_TAILS = (0.025, 0.975)


def mean_interval(values: ArrayLike, least: int = LEAST) -> Ends | None:
    """Return the 95 % interval of the mean of independent values ``(n,)``: Student's t, corrected for skewness.

    Errors of arms are skewed: an arm that is three times as bad as the others is not rare. The plain t interval covers
    the mean of such errors too seldom, and misses on the upper side. The correction is Hall's (1992, J. R. Stat. Soc.
    B).

    Args:
        values: One value per arm, fruit, tree, or block of contiguous poses of a file.
        least: Smallest number of values for which there is an interval.

    Returns:
        Lower and upper end, or None if there are fewer values than ``least`` or all are equal.

    Raises:
        ValueError: If the values are not one-dimensional.
    """
    x = np.asarray(values, dtype=float)
    if x.ndim != 1:
        raise ValueError(f"an interval is of values in one row, one per arm or fruit; got the shape {x.shape}")
    if len(x) < least or _equal(x):
        return None
    n, mean, deviation = len(x), float(x.mean()), float(x.std(ddof=1))
    skewness = float(np.clip(np.mean(((x - mean) / deviation) ** 3), -MOST_SKEWNESS, MOST_SKEWNESS))
    low, high = (mean - deviation * _unskewed(_t(n - 1, tail) / np.sqrt(n), skewness, n) for tail in _TAILS[::-1])
    return float(low), float(high)


def _t(freedom: float, tail: float) -> float:
    """Return the quantile at probability ``tail`` of Student's t distribution with ``freedom`` degrees of freedom."""
    return float(scipy.special.stdtrit(freedom, tail))


def ordered_interval(values: ArrayLike, least: int = LEAST) -> Ends | None:
    """Return the 95 % interval of the mean of a series of values ``(n,)`` in which neighbours are correlated.

    The standard error of the mean is estimated from the first few cosine coefficients of the series. Standard error and
    coefficients both grow with the correlation of neighbours (Mueller and Watson 2008, Econometrica 76). The critical
    value is computed as by Mueller and Watson (2022, Econometrica 90), for the largest correlation, `MOST_ALIKE`. With
    this correlation, the interval of `mean_interval` is a little more than half as wide as this one, and covers the
    mean in only 69 % of samples.

    Args:
        values: The values in the order of time, such as one per block of contiguous poses of a file.
        least: Smallest number of values for which there is an interval.

    Returns:
        Lower and upper end, or None if there are fewer values than ``least`` or all are equal.
    """
    x = np.asarray(values, dtype=float)
    if len(x) < least or _equal(x):
        return None
    waves, critical = _slow_waves(len(x))
    half = critical * float(np.sqrt(np.mean((waves @ x) ** 2)))
    return float(x.mean()) - half, float(x.mean()) + half


@cache
def _slow_waves(count: int) -> tuple[Array, float]:
    """Return the cosines ``(waves, count)`` that give the narrowest interval, and this interval's critical value.

    ``count`` is the number of values in the series. The critical value is the ``critical`` of `_beyond`.
    """
    place = (np.arange(count) + 0.5) / count
    alike = MOST_ALIKE ** np.abs(np.subtract.outer(np.arange(count), np.arange(count)))
    narrowest = np.inf
    for number in range(1, min(MOST_WAVES, count)):
        waves = np.sqrt(2.0) * np.cos(np.pi * np.arange(1, number + 1)[:, None] * place) / count
        both = np.concatenate([np.full((1, count), 1.0 / count), waves])
        covariance = both @ alike @ both.T
        critical = scipy.optimize.brentq(lambda value, c: _beyond(value, c) - 0.05, 1.0, 1e3, args=(covariance,))
        width = critical * np.sqrt(2.0 / number) * scipy.special.poch(0.5 * number, 0.5)
        if width < narrowest:
            narrowest, best = width, (waves, critical)
    return best


def _beyond(critical: float, covariance: Array) -> float:
    """Return the probability that the interval around a normal mean does not cover the true mean.

    Args:
        critical: Half of the interval's width, as a multiple of the root mean square of the cosine coefficients.
        covariance: The covariance matrix of the mean and the coefficients ``(1 + waves, 1 + waves)``.

    Returns:
        The probability that, in a weighted sum of squared normals, the one positive term outweighs the negative ones.
        It is computed as an integral over an angle (Bakirov and Szekely 2006, J. Math. Sci. 139).
    """
    waves = len(covariance) - 1
    eigenvalues = np.sort(np.linalg.eigvals(covariance * np.r_[1.0, np.full(waves, -(critical**2) / waves)]).real)
    angles = (np.arange(400) + 0.5) * np.pi / 800.0
    root = np.prod(np.sqrt(np.sin(angles)[:, None] ** 2 - eigenvalues[:-1] / eigenvalues[-1]), axis=1)
    return float(np.mean(np.sin(angles) ** waves / root))


def statistic_interval(
    table: ArrayLike, statistic: Statistic, least: int = LEAST, *, ordered: bool = False
) -> Ends | None:
    """Return the 95 % interval of a smooth statistic of a table's rows, such as a ratio of sums, by the jackknife.

    The interval of the mean of the jackknife pseudo-values is computed. It is then shifted by the difference between
    the statistic of all rows and this mean. Quantiles are not smooth; use `quantile_interval` for them.

    Args:
        table: One row per tree, arm or other independent unit, ``(n, ...)``.
        statistic: Function that computes one number from rows.
        least: Smallest number of rows for which there is an interval.
        ordered: Whether neighbouring rows are correlated. If so, `ordered_interval` is used instead of `mean_interval`.

    Returns:
        Lower and upper end, or None if there are fewer rows than ``least`` or all pseudo-values are equal.
    """
    rows = np.asarray(table, dtype=float)
    if len(rows) < least:
        return None  # a statistic of fewer may not even exist
    pseudo = pseudo_values(rows, statistic)
    if (ends := ordered_interval(pseudo, least) if ordered else mean_interval(pseudo, least)) is None:
        return None
    shift = float(statistic(rows)) - float(pseudo.mean())
    return ends[0] + shift, ends[1] + shift


def norm_interval(vectors: ArrayLike) -> Ends | None:
    """Return the 95 % interval of the norm of the mean of independent vectors ``(n, k)``, such as a pose's accuracy.

    The ends come from the jackknife (`statistic_interval`). The norm of a sample mean is above zero although the
    true mean may be zero. So the lower end is zero if Hotelling's T^2 test (1931, Ann. Math. Stat. 2) does not reject a
    zero mean.

    Args:
        vectors: One vector per cycle, fruit or arm, in any unit.

    Returns:
        Lower and upper end, in the unit of the vectors. None if there are fewer vectors than `LEAST`, or all
        pseudo-values of the jackknife are equal.
    """
    x = np.asarray(vectors, dtype=float)
    if (ends := statistic_interval(x, lambda some: np.linalg.norm(some.mean(axis=0)))) is None:
        return None
    (n, k), mean = x.shape, x.mean(axis=0)
    t_squared = n * mean @ np.linalg.pinv(np.atleast_2d(np.cov(x.T))) @ mean
    zero = t_squared * (n - k) / (k * (n - 1)) <= scipy.special.fdtri(k, n - k, 1.0 - 2.0 * _TAILS[0])
    return (0.0 if zero else max(ends[0], 0.0)), ends[1]


def ratio_interval(over: ArrayLike, under: ArrayLike, least: int = LEAST) -> Ends | None:
    """Return the 95 % interval of a ratio of sums over clusters of any sizes, such as fruit per hour over trees.

    The interval is Student's t with two corrections. The variance is corrected for large clusters, which pull the ratio
    towards themselves and have too small residuals (HC2; MacKinnon and White 1985). The degrees of freedom are
    corrected for a small number of clusters (Bell and McCaffrey 2002, Surv. Methodol.).

    Args:
        over: Term of the numerator for each cluster ``(n,)``.
        under: Term of the denominator for each cluster ``(n,)``, none below zero.
        least: Smallest number of clusters for which there is an interval.

    Returns:
        Lower and upper end. None if there are fewer clusters than ``least``, the sum of ``under`` is zero, or all
        clusters have the same ratio.
    """
    above, below = np.asarray(over, dtype=float), np.asarray(under, dtype=float)
    if len(above) < least or not below.sum() > 0.0:
        return None
    ratio = float(above.sum() / below.sum())
    variance, freedom = _ratio_spread(above, below)
    if not variance > (1e-12 * ratio) ** 2:
        return None
    half = _t(freedom, _TAILS[1]) * float(np.sqrt(variance))
    return ratio - half, ratio + half


def _ratio_spread(above: Array, below: Array) -> tuple[float, float]:
    """Return the variance of a ratio of sums over n > 1 clusters, and the variance's degrees of freedom.

    ``above`` has the term of the numerator for each cluster ``(n,)``, ``below`` the term of the denominator. Equally
    large clusters give n - 1 degrees of freedom.
    """
    weight = below / below.sum()
    residual = (above - above.sum() / below.sum() * below) / below.sum()
    rest = np.maximum(1.0 - weight, 1e-12)
    count = weight**2 / rest
    # The residuals' quadratic form is diag(count) seen through I - 1 weight', as the ratio is taken from them.
    total, met, square = count.sum(), count @ weight, weight @ weight
    left = count - total * weight
    trace = total - 2.0 * met + total * square
    squares = count @ count - 4.0 * (count**2 @ weight) + 2.0 * total * (count @ weight**2)
    squares += met**2 + 2.0 * square * (left @ count) + (left @ weight) ** 2
    return float(np.sum(residual**2 / rest)), max(float(trace**2 / squares), 1.0)


def pseudo_values(table: Array, statistic: Statistic) -> Array:
    """Return Tukey's jackknife pseudo-values of a statistic ``(n,)``, one per row of a table ``(n, ...)``.

    For the mean of a column, the pseudo-values are the column's values.
    """
    n = len(table)
    value = float(statistic(table))
    return np.array([n * value - (n - 1) * float(statistic(np.delete(table, i, axis=0))) for i in range(n)])


def share_interval(successes: float, trials: int) -> Ends:
    """Return the 95 % interval of the share of successes in independent trials: Wilson's score interval (1927).

    Args:
        successes: The number of successes, or the sum of their probabilities.
        trials: The number of trials.

    Raises:
        ValueError: If there are no trials, or more successes than trials.
    """
    if not 0 <= successes <= trials or trials < 1:
        raise ValueError(f"{successes:g} successes of {trials} trials make no share")
    return _wilson(successes / trials, float(trials))


def paired_share_interval(successes: ArrayLike, others: ArrayLike) -> Ends:
    """Return the 95 % interval of the difference between two shares of successes in the same trials.

    The difference is the first share minus the second. Wilson's intervals of both shares are combined with the
    correlation that the pairs show (Newcombe 1998, method 10).

    Args:
        successes: Whether each trial succeeded under the first condition ``(n,)``.
        others: Whether each trial succeeded under the second condition ``(n,)``.

    Raises:
        ValueError: If there are no trials, or the two arrays are not equally long.
    """
    first_way, second_way = np.asarray(successes, dtype=bool), np.asarray(others, dtype=bool)
    if first_way.shape != second_way.shape or first_way.ndim != 1 or not len(first_way):
        raise ValueError(f"shares are compared trial by trial; got the shapes {first_way.shape} and {second_way.shape}")
    n = len(first_way)
    both, neither = int(np.sum(first_way & second_way)), int(np.sum(~first_way & ~second_way))
    first, second = int(first_way.sum()), int(second_way.sum())
    product = first * (n - first) * second * (n - second)
    cross = float(both * neither) - int(np.sum(first_way & ~second_way)) * int(np.sum(~first_way & second_way))
    cross = max(cross - n / 2.0, 0.0) if cross > 0 else cross
    correlation = cross / np.sqrt(product) if product else 0.0
    (low_1, high_1), (low_2, high_2) = share_interval(first, n), share_interval(second, n)
    p, q = first / n, second / n

    def reach(a: float, b: float) -> float:
        return float(np.sqrt(max(a * a - 2.0 * correlation * a * b + b * b, 0.0)))

    return p - q - reach(p - low_1, high_2 - q), p - q + reach(high_1 - p, q - low_2)


def clustered_share_interval(successes: ArrayLike, trials: ArrayLike, least: int = LEAST) -> Ends | None:
    """Return the 95 % interval of the share of successes over clusters of trials, such as the fruit of many arms.

    It is Wilson's interval for an effective number of trials. This number follows from the variance of the
    share between clusters (the design effect; Korn and Graubard 1998). The degrees of freedom of this variance count
    the clusters with a failure, or the clusters with a success if there are fewer of them. If all clusters have the
    same share, the effective number is the number of clusters, or less if their sizes differ.

    Args:
        successes: The number of successes in each of n clusters ``(n,)``, or the sum of their probabilities.
        trials: The number of trials in each cluster ``(n,)``, or one number for all.
        least: Smallest number of clusters for which there is an interval.

    Returns:
        Lower and upper end, or None if there are fewer clusters than ``least`` or no trials.
    """
    taken = np.asarray(successes, dtype=float)
    tried = np.broadcast_to(np.asarray(trials, dtype=float), taken.shape)
    n, total = len(taken), float(tried.sum())
    if n < least or not total:
        return None
    share = float(taken.sum()) / total
    spread, freedom = _ratio_spread(taken, tried)
    counted = fewest = float(total**2 / (tried @ tried))  # as many clusters of one size would say as much
    if 0.0 < share < 1.0 and spread > 0.0:
        telling = max(min(int(np.sum(taken > 0.0)) - 1, int(np.sum(taken < tried)) - 1, freedom), 1)
        counted = share * (1.0 - share) / spread * (_t(total - 1.0, _TAILS[1]) / _t(telling, _TAILS[1])) ** 2
    return _wilson(share, float(np.clip(counted, min(fewest, total), total)))


def crossed_interval(values: ArrayLike, least: int = LEAST) -> Ends | None:
    """Return the 95 % interval of the mean of values ``(A, B)`` over A arms and B training seeds (crossed factors).

    A two-way analysis of variance gives the mean squares MS of arms, of seeds and of their interaction. The variance of
    the mean is (MS_A + MS_B - MS_AB) / (A B). It is at least the larger of MS_A / (A B) and MS_B / (A B). The degrees
    of freedom are Satterthwaite's (1946).

    Args:
        values: One value for each arm with each training seed ``(A, B)``.
        least: Smallest number of arms for which there is an interval.

    Returns:
        Lower and upper end, or None if A is below ``least``, B is below `LEAST_RUNS`, or all values are equal.
    """
    x = np.asarray(values, dtype=float)
    a, b = x.shape
    if a < least or b < LEAST_RUNS or _equal(x):
        return None
    mean, arms, seeds = float(x.mean()), x.mean(axis=1), x.mean(axis=0)
    squares = (b * arms.var(ddof=1), a * seeds.var(ddof=1))
    both = float(np.sum((x - arms[:, None] - seeds[None] + mean) ** 2)) / ((a - 1) * (b - 1))
    total = max(squares[0] + squares[1] - both, *squares)
    freedom = total**2 / (squares[0] ** 2 / (a - 1) + squares[1] ** 2 / (b - 1))
    half = _t(freedom, _TAILS[1]) * float(np.sqrt(total / (a * b)))
    return mean - half, mean + half


def quantile_interval(values: ArrayLike, probability: float) -> tuple[float | None, float | None]:
    """Return the 95 % interval of a quantile of independent values ``(n,)``, whatever their distribution.

    It is computed from fractional order statistics (Hutson 1999, J. Appl. Stat.).

    Args:
        values: One value per arm, fruit or tree.
        probability: Probability of the quantile, 0..1.

    Returns:
        Lower and upper end. An end that the sample cannot bound is None.
    """
    x = np.asarray(values, dtype=float)
    levels = quantile_levels(len(x), probability)
    low, high = (None if level is None else float(np.quantile(x, level, method="hazen")) for level in levels)
    return low, high


@cache
def quantile_levels(count: int, probability: float) -> tuple[float | None, float | None]:
    """Return the two ends of `quantile_interval` as quantile levels of a sample of ``count`` values.

    A level is a plotting position by Hazen's rule, 0..1. It is None for an open end.

    Args:
        count: Size n of the sample.
        probability: Probability of the quantile, 0..1.
    """

    def beyond(rank: float, tail: float) -> float:
        """Return the probability, minus ``tail``, that the value of this rank (from 1) lies below the quantile."""
        return float(scipy.special.betainc(rank, count + 1.0 - rank, probability)) - tail

    def end(tail: float, side: float, innermost: float, outermost: float) -> float | None:
        if side * beyond(outermost, tail) < 0.0:
            return None
        enough = side * beyond(innermost, tail) >= 0.0
        rank = innermost if enough else float(scipy.optimize.brentq(beyond, 1.0, float(count), args=(tail,)))
        return (rank - 0.5) / count

    if count < 1:
        return None, None
    return end(_TAILS[1], 1.0, float(count), 1.0), end(_TAILS[0], -1.0, 1.0, float(count))


def _equal(values: Array) -> bool:
    """Return whether values differ only by rounding, or by so little that the difference squared would be zero."""
    return not np.ptp(values) > max(1e-12 * np.abs(values).max(), 1e-150)


def _unskewed(standardised: float, skewness: float, n: int) -> float:
    """Return the standardised mean of ``n`` skewed values that Hall's transformation turns into ``standardised``."""
    if abs(skewness) < 1e-6:
        return standardised
    a = skewness / 3.0
    return float((np.cbrt(1.0 + 3.0 * a * (standardised - skewness / (6.0 * n))) - 1.0) / a)


def _wilson(share: float, trials: float) -> Ends:
    z2 = float(scipy.special.ndtri(_TAILS[1])) ** 2
    middle = (share + z2 / (2.0 * trials)) / (1.0 + z2 / trials)
    half = float(np.sqrt(z2 * share * (1.0 - share) / trials + z2**2 / (4.0 * trials**2))) / (1.0 + z2 / trials)
    return (0.0 if share == 0.0 else middle - half), (1.0 if share == 1.0 else middle + half)


# Numbers with their intervals, of arrays and of rows.

MANY = 30
"""Smallest number of arms for `mean_interval` of the arms' shares, which are skewed. With 10 arms this interval covers
the true mean in only 92 to 96 % of samples."""

MARGIN_MM = 0.05
"""Difference of mean errors that does not matter for picking, mm: a twentieth of the best gripper's tolerance."""


@dataclass(frozen=True)
class Estimate:
    """An estimate and its 95 % interval.

    Attributes:
        value: The estimate.
        ci95: Lower and upper end of the interval, None for an open end. None as a whole if there is no interval.
        missing: Why there is no interval; empty if there is one.
    """

    value: float
    ci95: tuple[float | None, float | None] | None
    missing: str = ""

    @property
    def significant(self) -> bool | None:
        """Whether the interval excludes zero; None without an interval."""
        if self.ci95 is None:
            return None
        low, high = self.ci95
        return (low is not None and low > 0.0) or (high is not None and high < 0.0)

    @property
    def ends(self) -> list[float | None] | None:
        """Both ends of the interval as a list, for JSON; None without an interval."""
        return None if self.ci95 is None else list(self.ci95)

    def verdict(self, margin: float = MARGIN_MM) -> str:
        """Return a verdict in words on the estimate of a difference.

        Args:
            margin: Difference that does not matter, in the unit of the estimate.

        Returns:
            "carries over" if the whole interval is within plus or minus ``margin``. Else "differs" if the interval
            excludes zero. Else "not settled".
        """
        low, high = self.ci95 or (None, None)
        if low is not None and high is not None and -margin <= low and high <= margin:
            return "carries over"
        return "differs" if self.significant else "not settled"


def estimate(
    columns: Mapping[str, ArrayLike],
    value: str | Sequence[str],
    by: Sequence[str] = (),
    over: Sequence[str] = ("arm",),
    of: str | float | Statistic = "mean",
    against: Mapping[str, Any] | None = None,
    least: int = LEAST,
    lost: float | None = None,
) -> list[dict[str, Any]]:
    """Compute estimates and their 95 % intervals from the rows of a table.

    Args:
        columns: The table's columns by name, such as the columns of `pickenv.experiments.Rows`.
        value: The column to estimate; several columns for a statistic of them.
        by: Grouping columns. Each combination of their values has one estimate, in the order of the rows.
        over: One or two columns that name the random units (such as arms, and training seeds) over which estimates
            vary. Within a combination, table rows of the same units are averaged. Over two columns, only means and
            shares of one column, and ratios, have intervals.
        of: The statistic, which is one of the following. "mean": the mean. "share": the share of successes, from one
            column of successes or their probabilities, or from two columns, successes and trials. "ratio": the ratio of
            the sums of two columns. "removed": the relative reduction of the mean, from the rows at ``against``, or
            from the first of two columns to the second. A probability, such as 0.95: that quantile over units. A
            function: it is applied to the units' means ``(units, values)``.
        against: Values of some ``by`` columns that mark the reference, such as {"compensation": "raw"}. If given, an
            estimate is the paired difference: combination minus its reference, which has the same values of all other
            ``by`` columns. References, and combinations without a reference, get no estimate.
        least: Smallest number of units for an interval of a mean.
        lost: Limit above which a value counts as lost. The mean leaves lost values out, and their share is estimated
            separately. Otherwise a few values ten times as large as the others would change the mean much, and a sample
            of few units might contain no such value.

    Returns:
        For each combination, a dictionary of the ``by`` columns, "estimate", "units", "runs" and perhaps "lost".
        "estimate" is an `Estimate`. "units" has the mean of each unit of the first ``over`` column ``(units,)``. "runs"
        has the mean of each unit of the second ``over`` column ``(runs,)``, or is None without a second column. "lost"
        is an `Estimate` of the lost share, if ``lost`` is given. "units" and "runs" are None for "removed" and a
        statistic of several columns.

    Raises:
        ValueError: If the units of a combination do not have equally many rows, or both sides of a difference do not
            have the same units. Also if a value is not finite, or the arguments do not go together.
    """
    names = [value] if isinstance(value, str) else list(value)
    _check_asked(names, by, over, of, against)
    if lost is not None and (of != "mean" or len(names) > 1 or len(over) > 1 or against is not None):
        raise ValueError("what is lost is told apart from a mean of one column, over one column; leave the rest out")
    arrays = {name: np.asarray(columns[name]) for name in (*by, *over, *names)}
    for name in names:
        if absent := int(np.sum(~np.isfinite(np.asarray(arrays[name], dtype=float)))):
            raise ValueError(f"{absent} of {len(arrays[name])} values of {name} are no numbers; leave these rows out")
    keys = list(zip(*(arrays[name].tolist() for name in by), strict=True)) or [()] * len(arrays[over[0]])
    places: dict[tuple[Any, ...], list[int]] = {}
    for number, key in enumerate(keys):
        places.setdefault(key, []).append(number)
    cubes = {key: _cubes({n: v[rows] for n, v in arrays.items()}, names, over) for key, rows in places.items()}
    units_of = {key: [np.unique(arrays[name][rows]) for name in over] for key, rows in places.items()}
    numbers = []
    for key, cube in cubes.items():
        base = key if against is None else tuple(against.get(n, level) for n, level in zip(by, key, strict=True))
        if against is not None and (base == key or base not in cubes):
            continue
        if against is not None:  # unit by unit, whatever the number of rows of each
            cube, base_cube = (pair_cube.mean(axis=3, keepdims=True) for pair_cube in (cube, cubes[base]))
            once = base_cube.shape[2] == 1  # what was not trained is the same for every training
            pairs = list(zip(over, units_of[key], units_of[base], strict=True))[: 1 if once else None]
            if apart := [name for name, first, two in pairs if not np.array_equal(first, two)]:
                raise ValueError(f"{key} and {base} were not measured on the same {apart[0]}")
            both = [np.broadcast_to(base_cube, cube.shape), cube]
            cube = np.concatenate(both) if of == "removed" else cube - base_cube
        levels = dict(zip(by, key, strict=True))
        if lost is not None:
            numbers.append(levels | _without_lost(cube[0, :, 0], lost, least))
            continue
        units = cube[0].mean(axis=(1, 2)) if len(cube) == 1 else None
        runs = cube[0].mean(axis=(0, 2)) if len(cube) == 1 and len(over) == 2 else None
        numbers.append(levels | {"estimate": _estimated(cube, of, least), "units": units, "runs": runs})
    return numbers


def _without_lost(values: Array, lost: float, least: int) -> dict[str, Any]:
    """Return the entries that `estimate` returns if its ``lost`` is given, from values ``(units, repeats)``."""
    gone = values > lost
    kept = (~gone).sum(axis=1)
    means = np.where(gone, 0.0, values).sum(axis=1)[kept > 0] / kept[kept > 0]
    ends = clustered_share_interval(gone.sum(axis=1), values.shape[1], least)
    share = _with_reason(float(gone.mean()), ends, values[:, :1], least)
    number = mean_estimate(means[:, None, None], least) if len(means) else Estimate(float("nan"), None, "all are lost")
    return {"estimate": number, "units": means, "runs": None, "lost": share}


def unseen_share(runs: int) -> float:
    """Return the 95 % upper limit of the share of failing runs if none of ``runs`` runs failed: 0.45 for five runs."""
    return float(1.0 - 0.05 ** (1.0 / runs))


def _check_asked(
    names: Sequence[str], by: Sequence[str], over: Sequence[str], of: Any, against: Mapping[str, Any] | None
) -> None:
    """Raise an error if arguments of `estimate` do not go together; ``names`` are the columns to estimate."""
    if not 1 <= len(over) <= 2:
        raise ValueError(f"an interval is over one or two columns, not over {list(over)}")
    if unknown := [name for name in against or () if name not in by]:
        raise ValueError(f"against names {unknown[0]}, which is none of the columns of by, {list(by)}")
    if callable(of):
        return
    if len(names) != 1 and not (len(names) == 2 and of in ("share", "ratio", "removed")):
        raise ValueError(f"'{of}' is of one column, not of {names}; give share, ratio or removed of two, or a function")
    if of == "ratio" and len(names) != 2:
        raise ValueError(f"'ratio' is of two columns, not of {names}")
    if of in ("share", "ratio") and len(names) > 1 and against is not None:
        raise ValueError(f"a {of} of two columns has no paired differences; give the mean of one column of {of}s")
    if of == "removed" and (against is None) == (len(names) == 1):
        raise ValueError("'removed' wants against, levels of which a share is gone, or two columns: before and after")


def _cubes(rows: Mapping[str, NDArray[Any]], names: Sequence[str], over: Sequence[str]) -> Array:
    """Arrange the columns ``names`` of a table as values ``(len(names), units, runs, repeats)``.

    The first column that ``over`` names gives the units, the second gives the runs; without a second, ``runs`` is 1.
    """
    places = [np.unique(rows[name], return_inverse=True)[1] for name in over]
    if len(places) == 1:
        places.append(np.zeros_like(places[0]))
    units, runs = (int(place.max()) + 1 for place in places)
    order = np.lexsort((np.arange(len(places[0])), places[1], places[0]))
    counts = np.bincount(places[0] * runs + places[1], minlength=units * runs)
    if len(set(counts.tolist())) != 1:
        raise ValueError(f"not every combination of {' and '.join(over)} has as many rows: {sorted(set(counts))}")
    return np.stack([np.asarray(rows[name], dtype=float)[order].reshape(units, runs, -1) for name in names])


def _estimated(cube: Array, of: str | float | Statistic, least: int) -> Estimate:
    if callable(of) or len(cube) > 1:
        table = cube.mean(axis=(2, 3)).T
        if of in ("share", "ratio"):  # a share of what was tried, with other numbers tried of each unit
            ends = clustered_share_interval(*cube.sum(axis=(2, 3))) if of == "share" else ratio_interval(*table.T)
            over, under = table.sum(axis=0)
            value = float(over / max(under, 1e-12))
        else:
            function = of if callable(of) else _removed
            value, ends = float(function(table)), statistic_interval(table, function)
        if of == "ratio" and cube.shape[2] > 1:  # linear in small differences: the mean of remainders of mean zero
            up, down = cube.mean(axis=3)
            return _with_reason(value, crossed_interval(value + (up - value * down) / down.mean(), least), up, least)
        if cube.shape[2] > 1:
            return Estimate(value, None, "no interval of this statistic counts trainings")
        return _with_reason(value, ends, table[:, :1])
    (values,) = cube
    if of == "share":
        return share_estimate(values)
    return mean_estimate(values, least) if of == "mean" else quantile_estimate(values, float(of))


def _removed(table: Array) -> float:
    """Return the relative reduction of the mean from the first column of a table ``(units, 2)`` to the second."""
    before, after = table.mean(axis=0)
    return float(1.0 - after / before)


def mean_estimate(values: Array, least: int = LEAST) -> Estimate:
    """Estimate the mean of values ``(arms, trainings, fruit)``; with fewer arms than ``least`` there is no interval.

    Trainings are repeated trainings of a policy with other seeds.
    """
    means = values.mean(axis=2)
    ends = mean_interval(means[:, 0], least) if means.shape[1] == 1 else crossed_interval(means, least)
    return _with_reason(float(means.mean()), ends, means, least)


def quantile_estimate(values: Array, probability: float) -> Estimate:
    """Estimate a quantile of the arms' means of values ``(arms, trainings, fruit)``.

    There is no interval for several trainings.

    Args:
        values: The values ``(arms, trainings, fruit)``; trainings are of one policy, with different seeds.
        probability: Probability of the quantile, 0..1.
    """
    means = values.mean(axis=2)
    value = float(np.quantile(means.mean(axis=1), probability, method="hazen"))
    if means.shape[1] > 1:
        return Estimate(value, None, "no interval of a quantile counts trainings")
    ends = quantile_interval(means[:, 0], probability)
    return Estimate(value, None, "needs more arms") if ends == (None, None) else Estimate(value, ends)


def share_estimate(chances: Array) -> Estimate:
    """Estimate the share of successes from probabilities of success ``(arms, trainings, fruit)``.

    For several trainings, the interval is `crossed_interval` of the means over fruit. For one training and at least
    `MANY` arms, it is `mean_interval` of the arms' means, if all of them are above 0 and below 1. Otherwise each
    probability counts as one trial (`clustered_share_interval`). That interval is conservative, because probabilities
    vary less than successes drawn from them.
    """
    arms, trainings, fruit = chances.shape
    means = chances.mean(axis=2)
    if trainings == 1 and arms >= MANY and means.min() > 0.0 and means.max() < 1.0:
        ends = mean_interval(means[:, 0])
    else:
        ends = crossed_interval(means) if trainings > 1 else clustered_share_interval(chances.sum(axis=(1, 2)), fruit)
    return _with_reason(float(means.mean()), ends and (max(ends[0], 0.0), min(ends[1], 1.0)), means)


def _with_reason(value: float, ends: Ends | None, each: Array, least: int = LEAST) -> Estimate:
    arms, trainings = each.shape
    few = f"needs {least} arms" if arms < least else f"needs {LEAST_RUNS} trainings" * (1 < trainings < LEAST_RUNS)
    return Estimate(value, ends, "" if ends else few or EQUAL)
