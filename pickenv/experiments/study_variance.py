"""Causes of differences between arms' errors: by drawing each cause anew, by Sobol indices, and by regression on rows.

Components (`components_of`) are the shares of four causes: the arm, its fruit, its poses and the tracker's errors. One
cause is drawn again while the other three are held constant, for new arms that are not in the study. The quantity is
the logarithm of the radius that contains the required share of an arm's fruit. This radius decides whether the arm is
within specification. With the logarithm, the shares are for relative errors, and a few bad arms do not dominate.

Sobol indices (`sobol_of`, Saltelli 2010) divide the variance of the squared RMS error, mm^2, among groups of
tolerances. They include interactions and assume no model, but need further arms. The tracker has no errors here. Each
point of the sample has fruit and poses of its own, and all arms of a point share them. The indices are thus averages
over fruit and poses.

Sensitivities (`sensitivities_of`) come from a regression on a study's rows. The squared error of an arm is a quadratic
form of its deviations. The squared RMS error of an arm over its own fruit, mm^2, is therefore regressed on each
standardised deviation x and on x^2. For independent deviations the variance of b x + c x^2 is the parameter's
first-order share. The remaining share, 1 - R^2, is due to interactions, fruit and poses, the tracker, and deviations
without a column. A regression gives a positive share to a tolerance without effect. The share that scatter alone would
give is subtracted, so that the share of such a tolerance is zero on average. Intervals come from the jackknife over
groups of arms (`_interval`).
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray
from pyarrow.dataset import Dataset
from scipy.special import chndtr, chndtrinc, ndtri
from scipy.stats import qmc

from pickenv.arm import Array, Plant
from pickenv.arm.plant.populations import plants_from, random_columns
from pickenv.base import InputError, mean_interval, single_threaded, statistic_interval
from pickenv.experiments.study import LS, OK, RAW, Circumstances, Protocol, Setting, figures

# Which share of a variance each of several independent causes makes: first-order and total indices (Saltelli 2010).
# Row by row the figure is computed with all causes drawn once (A), all drawn again (B), and for each cause with that
# one taken from B and the others from A. Anything else that a row's figures share is averaged over and makes no
# variance.


def variance_indices(first: Array, second: Array, mixed: Array, names: Sequence[str]) -> list[dict[str, Any]]:
    """Compute the first-order and total share of each cause in the variance of a quantity, from samples A and B.

    Each sample consists of R independent parts of n draws.

    Args:
        first: Values of the quantity with all causes from sample A ``(R, n)``.
        second: Values with all causes from sample B ``(R, n)``.
        mixed: For each of G causes, values with this cause from B and the other causes from A ``(G, R, n)``.
        names: Names of the causes.

    Returns:
        One row per cause. ``group`` is the cause's name, ``first_order`` its share alone, and ``total`` its share with
        all its interactions, which is never smaller than the share alone. The ends of the 95 % intervals, over the R
        parts, are ``first_order_low``, ``first_order_high``, ``total_low`` and ``total_high``. They are None if R is
        too small.

    Raises:
        InputError: If all values of ``first`` and ``second`` are equal.
    """
    variance = 0.5 * np.mean((first - second) ** 2, axis=1)
    if not variance.any():
        raise InputError("the figure is the same whatever is drawn; there is no variance to divide")
    # Jansen 1999: differences within a row alone, so that what the row shares drops out
    alone, every = variance - 0.5 * np.mean((second - mixed) ** 2, axis=2), 0.5 * np.mean((first - mixed) ** 2, axis=2)
    indices = []
    for name, by_itself, all_ in zip(names, alone, every, strict=True):
        if by_itself.mean() > all_.mean():  # by chance: both then estimate the share of a cause without interactions
            by_itself = all_ = 0.5 * (by_itself + all_)
        row: dict[str, Any] = {"group": name}
        for key, part in (("first_order", by_itself), ("total", all_)):
            value = float(part.mean() / variance.mean())
            low, high = _ends(part, variance, value)
            row |= {key: value, f"{key}_low": low, f"{key}_high": high}
        indices.append(row)
    return indices


def _ends(part: Array, whole: Array, value: float) -> tuple[float | None, float | None]:
    """Return the 95 % interval of a cause's share in a variance; both ends are None if there are too few samples.

    The share is the mean of ``part`` divided by the mean of ``whole``. The ends are clipped to 0 to 1, and moved if
    necessary so that the interval contains ``value``.

    Args:
        part: The cause's part of the variance in each of R independent samples ``(R,)``.
        whole: The whole variance in each sample ``(R,)``.
        value: Estimate of the share.
    """
    if not part.any():
        return 0.0, 0.0  # the cause changes nothing
    ends = statistic_interval(np.stack([part, whole], axis=1), lambda rows: rows[:, 0].mean() / rows[:, 1].mean())
    return (None, None) if ends is None else (min(max(ends[0], 0.0), value), max(min(ends[1], 1.0), value))


# Components.

MOST_ARMS, LEAST_ARMS = 256, 30
"""Largest and smallest number of arms for `components_of`. With 20 arms, only 92 % of the 95 % intervals of total
shares would contain the true value."""


def components_of(protocol: Protocol, setting: Setting) -> list[dict[str, Any]]:
    """Compute the shares of arms, fruit, poses and tracker in the variance of the arms' logarithmic errors.

    Args:
        protocol: The study. As many arms are computed as the study has, at most `MOST_ARMS`. Each arm is judged once
            per cause, and twice more.
        setting: A setting of the study with the method raw or least squares.

    Returns:
        One row per cause, with first-order and total share as in the rows of `variance_indices`, and the number of
        ``arms``. The causes are "arms" and "fruit", and with least squares also "poses" and "tracker".

    Raises:
        InputError: If the setting has another method, or fewer than `LEAST_ARMS` arms exist or can be judged.
    """
    if setting.method not in (RAW, LS):
        raise InputError("components of variance would take too long behind a residual model")
    count = min(MOST_ARMS, protocol.config.arms)
    if count < LEAST_ARMS:
        raise InputError(f"{count} arms are too few to divide their variance; give {LEAST_ARMS}")
    begin = protocol.config.arms  # arms that the study has not
    numbers = range(begin, begin + count), range(begin + count, begin + 2 * count)
    arms, arms_anew = (protocol.draw(setting, part) for part in numbers)
    around, around_anew = ([protocol.circumstances(number) for number in part] for part in numbers)
    pairs = list(zip(around, around_anew, strict=True))
    causes: dict[str, tuple[Plant, list[Circumstances]]] = {
        "arms": (arms_anew, around),
        "fruit": (arms, [replace(met, fruit=new.fruit) for met, new in pairs]),
    }
    if setting.poses:
        causes["poses"] = arms, [replace(met, poses=new.poses) for met, new in pairs]
        causes["tracker"] = arms, [replace(met, tracker=new.tracker) for met, new in pairs]
    every = np.stack([_log_errors(protocol, setting, *case) for case in ((arms, around), (arms_anew, around_anew))])
    mixed = np.stack([_log_errors(protocol, setting, *case) for case in causes.values()])
    finite = np.isfinite(every).all(axis=0) & np.isfinite(mixed).all(axis=0)
    if finite.sum() < LEAST_ARMS:
        raise InputError(f"only {finite.sum()} of {count} arms can be judged, too few to divide their variance")
    first, second = every[:, finite, None]
    rows = variance_indices(first, second, mixed[:, finite, None], list(causes))
    return [row | {"arms": int(finite.sum())} for row in rows]


def _log_errors(protocol: Protocol, setting: Setting, arms: Plant, around: Sequence[Circumstances]) -> Array:
    """Return the logarithm of each arm's radius ``(N,)``; this radius, m, contains the required share of the fruit.

    An arm that was not judged has NaN. ``around`` has fruit, poses and tracker errors of each arm.
    """
    from pickenv.experiments.study_batched import judge_batch

    (outcomes,) = judge_batch(protocol, [setting], arms, around)
    radius = np.quantile(outcomes["position"], protocol.config.share, axis=1)
    return np.log(np.where(outcomes["status"] == OK, radius, np.nan))


# Sobol's indices.

GROUPS: Mapping[str, tuple[str, tuple[str, ...]]] = {
    "joint stiffness": ("joint_compliance", ("joint_stiffness",)),
    "flexural rigidity": ("boom_bending", ("flexural_rigidity",)),
    "bearing stiffness": ("slide_compliance", ("bearing_stiffness",)),
    "transmission error": ("transmission_error", ("lead", "transmission_error", "phase")),
    "drive harmonics": ("drive_harmonics", ("drive_harmonics",)),
    "local structure": ("local_structure", ("local_structure",)),
    "roller clearance": ("roller_play", ("roller_clearance",)),
    "backlash": ("backlash", ("backlash",)),
    "friction": ("stick_band", ("friction",)),
    "temperature": ("thermal_growth", ("temperature_rise",)),
    "ground": ("base_tilt", ("ground_stiffness", "sinkage")),
}
"""For each group of effects, the effect and the random numbers (`random_columns`) that determine it."""
SOBOL_STREAM = 7
"""Spawn key of the random numbers for Sobol indices. No random numbers of the study's rows have this key."""
SCRAMBLES = 32
"""Number of independent Sobol sequences in a sample; the intervals are over them."""
LEAST_SAMPLES = 8 * SCRAMBLES
"""Smallest number of rows of a sample; with fewer, the intervals contain the true value too seldom."""
SAMPLES = 2048
"""Default number of rows of a sample."""


def tolerance_groups(design: Plant) -> dict[str, list[int]]:
    """Return, for each group of tolerances, by name, the indices (from 0) of the random numbers that determine it.

    A group whose effect the design lacks is left out.
    """
    columns, n = random_columns(design), design.arm.nominal.joints
    alpha, a, theta, d = (list(columns["geometry"][k * n : (k + 1) * n]) for k in range(4))
    foreign = {name.replace("_", " "): (name, (f"own {name}",)) for name in design.names if f"own {name}" in columns}
    effects = {
        group: [i for key in keys for i in columns[key]]
        for group, (name, keys) in ({**GROUPS, **foreign}).items()
        if design.effect(name) is not None
    }
    return {"angles": alpha + theta, "lengths": a + d, **effects}


def sobol_of(protocol: Protocol, setting: Setting, samples: int) -> list[dict[str, Any]]:
    """Compute the Sobol indices of groups of tolerances in a setting: shares in the variance of squared RMS errors.

    Args:
        protocol: The study.
        setting: A setting of the study with the method raw or least squares.
        samples: Size of the sample, a power of two. Each of its points needs one arm per group of tolerances, and two
            more.

    Returns:
        One row per group, with first-order and total share as in the rows of `variance_indices`, and the number of
        ``arms``.

    Raises:
        InputError: If the setting has another method, an arm cannot be judged, or ``samples`` is no power of two or too
            few.
    """
    from pickenv.experiments.study_batched import judge_batch

    if setting.method not in (RAW, LS):
        raise InputError(
            f"Sobol indices of method '{setting.method}' would take too long; choose a setting of raw or ls"
        )
    groups = tolerance_groups(protocol.design)
    tolerances = replace(protocol.tolerances[setting.tolerances], it_grade=setting.it_grade)
    active = [i for columns in groups.values() for i in columns]
    every = max(columns.stop for columns in random_columns(protocol.design).values())

    @cache
    def around(row: int) -> Circumstances:
        return protocol.circumstances(protocol.config.arms + row).perfect

    def squared_error(even: Array, rows: NDArray[np.int64]) -> Array:
        numbers = np.full((len(even), every), 0.5)
        numbers[:, active] = even
        plants = plants_from(protocol.design, tolerances, numbers)
        (outcomes,) = judge_batch(protocol, [setting], plants, [around(row) for row in rows.tolist()])
        for status in outcomes["status"]:
            if status != OK:
                raise InputError(f"Sobol indices of setting {setting.number} need every arm's error: {status}")
        return figures(outcomes["position"], outcomes["attitude"], protocol.config.radius_mm)["error_rms_mm"] ** 2

    places = np.cumsum([0, *(len(columns) for columns in groups.values())]).tolist()
    numbered = {name: range(a, b) for name, a, b in zip(groups, places, places[1:], strict=False)}
    rng = np.random.default_rng(np.random.SeedSequence(protocol.config.seed, spawn_key=(SOBOL_STREAM,)))
    rows = sobol_indices(squared_error, numbered, samples, rng)
    return [row | {"arms": samples * (len(groups) + 2)} for row in rows]


def sobol_indices(
    model: Callable[[Array, NDArray[np.int64]], Array],
    groups: Mapping[str, Sequence[int]],
    samples: int,
    rng: np.random.Generator,
) -> list[dict[str, Any]]:
    """Compute first-order and total Sobol indices of groups of independent inputs.

    Args:
        model: Function that returns one finite number for each of N points ``(N,)``. Its arguments are uniform random
            numbers ``(N, d)`` in 0..1, and the indices of the points in the sample ``(N,)``, from 0. Quantities
            besides the inputs may depend on a point's index; the Sobol indices are averages over these quantities.
        groups: For each group, the indices, from 0, of its inputs among the d columns; each input belongs to one group.
        samples: Size of the sample, a power of two. The model is evaluated at each point once per group, and twice
            more.
        rng: Random numbers for the `SCRAMBLES` scrambled Sobol sequences.

    Returns:
        One row per group, with first-order and total share as in the rows of `variance_indices`. The total minus the
        first-order share is due to interactions.

    Raises:
        InputError: If ``samples`` is no power of two or below `LEAST_SAMPLES`, or the model's values are all equal.
    """
    d = sum(map(len, groups.values()))
    if samples < LEAST_SAMPLES or samples & (samples - 1):
        raise InputError(f"{samples} samples; give a power of two from {LEAST_SAMPLES}, such as {SAMPLES}")
    even = np.concatenate([qmc.Sobol(2 * d, rng=rng).random(samples // SCRAMBLES) for _ in range(SCRAMBLES)])
    first, second = even[:, :d], even[:, d:]

    def figure(numbers: Array) -> Array:
        return model(numbers, np.arange(samples)).reshape(SCRAMBLES, -1)

    mixed = [figure(np.where(np.isin(np.arange(d), list(group)), second, first)) for group in groups.values()]
    return variance_indices(figure(first), figure(second), np.stack(mixed), list(groups))


# Sensitivities.

DEVIATION = re.compile(r"delta_.+_(mm|deg)|size_.+|(sine|cosine)_.+|rise_K")
"""Pattern of the names of columns that hold deviations drawn for an arm."""
BLOCKS = 100
"""Number of groups of arms that the jackknife leaves out in turn. An arm's number determines its group."""
ARMS_PER_TERM = 5
"""Smallest number of arms for each term of a regression; a regression with fewer is refused."""
TAILS = (0.975, 0.025)


def sensitivities_of(rows: Dataset, setting: int = 0) -> pa.Table:
    """Compute the share of each parameter, and of each kind of parameter, in the variance of the arms' squared errors.

    Args:
        rows: Any number of a study's rows; they are read in batches.
        setting: Number of the setting, from 0; failed arms are left out.

    Returns:
        One row per parameter and one per kind, sorted by share, largest first. ``level`` is "parameter" or "kind",
        ``parameter`` the name of the parameter or kind, and ``kind`` the kind. ``share`` is the share of the variance;
        an estimate of a share near zero may be negative. The ends of its 95 % interval are ``share_low`` and
        ``share_high``. ``r2``, ``r2_adjusted`` and the number of ``arms`` are for the whole regression.

    Raises:
        InputError: If no parameter varies between the arms, or there are too few arms for the number of deviations.
    """
    names, sums = _moments(rows, setting)
    arms, terms = int(sums[:, 0, 0].sum()), 2 * len(names) + 1
    if not names:
        raise InputError(f"nothing varies between the arms of setting {setting}; give its tolerances a spread")
    if arms < ARMS_PER_TERM * terms:
        raise InputError(
            f"setting {setting} has {arms} arms with a result; its {len(names)} deviations need {ARMS_PER_TERM * terms}"
        )
    groups: dict[tuple[str, str], list[int]] = {}
    for level, group_of in (("parameter", parameter_of), ("kind", tolerance_kind)):
        for i, name in enumerate(names):
            groups.setdefault((level, group_of(name)), []).append(i)
    total = sums.sum(axis=0)
    with single_threaded():  # small systems: threads would only wait for one another
        every = np.stack([total, *(total - block for block in sums if block[0, 0])])  # all arms, and without each block
        slopes, covariance, variance, (r2, *_) = _regressed(every)
        blocks = len(slopes) - 1
        # The jackknife's scatter holds for errors of any distribution; it is too large by as much as few arms leave the
        # regression (the leverage), and put right for that.
        scatter = slopes[1:] - slopes[1:].mean(axis=0)
        scatter *= np.sqrt((blocks - 1) / blocks * (1.0 - terms / arms))
        about = {"r2": float(r2), "r2_adjusted": float(1.0 - (1.0 - r2) * (arms - 1) / (arms - terms)), "arms": arms}
        table: list[dict[str, Any]] = []
        for (level, name), group in groups.items():
            share = _explained(slopes, covariance, group) / variance
            chance = float(_explained(scatter, covariance[:1], group).sum() / variance[0])
            roots = np.sqrt(np.maximum(share, 0.0))
            low, high = _interval(float(share[0]), chance, blocks * roots[0] - (blocks - 1) * roots[1:])
            row = {"parameter": name, "kind": tolerance_kind(names[group[0]]), "level": level}
            table.append(row | {"share": float(share[0] - chance), "share_low": low, "share_high": high} | about)
    return pa.Table.from_pylist(sorted(table, key=lambda row: -row["share"]))


def parameter_of(column: str) -> str:
    """Return the parameter that a column of deviations belongs to.

    The parameter has the name of the column, except that "sine_x" and "cosine_x" of a periodic error x give "size_x".
    """
    return re.sub(r"^(sine|cosine)_", "size_", column)


def tolerance_kind(column: str) -> str:
    """Return the kind of a column of deviations: "angles", "lengths", or for example "joint stiffness"."""
    if column.startswith("delta_"):
        return "angles" if column.endswith("_deg") else "lengths"
    if column == "rise_K":
        return "temperature rise"
    return re.sub(r"_\d+$", "", parameter_of(column).removeprefix("size_")).replace("_", " ")


def _moments(rows: Dataset, setting: int) -> tuple[list[str], Array]:
    """Compute the sums that a regression needs, for the arms of the setting with the number ``setting``, from 0.

    Returns:
        Two values. The first is the names of the k deviations that vary. The second has one matrix for each of `BLOCKS`
        groups of arms ``(BLOCKS, 2 k + 2, 2 k + 2)``. An entry is a sum over the arms of the product of two quantities.
        The quantities are 1, the k values of x, the k values of x^2, and the squared RMS error, mm^2. x is a deviation
        minus its mean, divided by its standard deviation.
    """
    names = [name for name in rows.schema.names if DEVIATION.fullmatch(name)]
    selection = (pc.field("setting") == setting) & (pc.field("status") == OK)

    def batches(columns: Sequence[str]) -> Any:
        for batch in rows.to_batches(columns=list(columns), filter=selection, use_threads=False):
            if batch.num_rows:
                yield [batch[name].to_numpy(zero_copy_only=False) for name in columns]

    count, total, squares = 0, np.zeros(len(names)), np.zeros(len(names))
    for columns in batches(names):
        values = np.stack(columns, axis=1) if columns else np.zeros((0, 0))
        count, total, squares = count + len(values), total + values.sum(axis=0), squares + (values**2).sum(axis=0)
    mean = total / max(count, 1)
    deviation = np.sqrt(np.maximum(squares / max(count, 1) - mean**2, 0.0))
    varies = deviation > 1e-9 * np.maximum(np.abs(mean), 1e-3)
    varied = [name for name, used in zip(names, varies, strict=True) if used]
    size = 2 * len(varied) + 2
    sums = np.zeros((BLOCKS, size, size))
    for arm, error, *columns in batches(["arm", "error_rms_mm", *varied]):
        x = (np.stack(columns, axis=1) - mean[varies]) / deviation[varies] if columns else np.zeros((len(arm), 0))
        sums += _products(np.column_stack([np.ones(len(arm)), x, x**2, error**2]), arm % BLOCKS)
    return varied, sums


def _products(z: Array, block: NDArray[np.int64]) -> Array:
    """Return, for each of `BLOCKS` groups of rows, the sum of the rows' outer products ``(BLOCKS, q, q)``.

    The rows are ``z`` ``(n, q)``, and ``block`` ``(n,)`` is the index of each row's group, from 0.
    """
    order = np.argsort(block, kind="stable")
    count = np.bincount(block, minlength=BLOCKS)
    place = np.arange(len(block)) - np.repeat(np.cumsum(count) - count, count)
    padded = np.zeros((BLOCKS, max(int(count.max()), 1), z.shape[1]))  # a row of zeros adds nothing
    padded[block[order], place] = z[order]
    return np.asarray(np.swapaxes(padded, 1, 2) @ padded)


def _regressed(sums: Array) -> tuple[Array, Array, Array, Array]:
    """Compute a regression on 2 k terms, x and x^2 of k deviations, for each of S sets of arms.

    ``sums`` ``(S, q, q)`` are sums of products as in `_moments`, with q = 2 k + 2.

    Returns:
        Four arrays: the slopes of the terms ``(S, 2 k)``, mm^2; the covariances of the terms ``(S, 2 k, 2 k)``; the
        variance of the squared error ``(S,)``, mm^4; and the share R^2 of this variance that all terms explain
        ``(S,)``.
    """
    count, mean = sums[:, :1, :1], sums[:, :1] / sums[:, :1, :1]
    covariance = sums / count - mean.mT * mean
    terms, with_error, variance = covariance[:, 1:-1, 1:-1], covariance[:, 1:-1, -1], covariance[:, -1, -1]
    steadied = terms * (1.0 + 1e-10 * np.eye(terms.shape[1]))  # two deviations that are one share what they explain
    slopes = np.asarray(np.linalg.solve(steadied, with_error[..., None])[..., 0], dtype=np.float64)
    return slopes, terms, variance, np.sum(slopes * with_error, axis=1) / variance


def _explained(slopes: Array, covariance: Array, group: Sequence[int]) -> Array:
    """Return the variance of the squared error ``(S,)``, mm^4, that a group of deviations explains.

    Args:
        slopes: Slopes of the terms ``(S, 2 k)``, from `_regressed`.
        covariance: Covariances of the terms ``(S, 2 k, 2 k)``, from `_regressed`.
        group: Indices of the group's deviations, from 0 to k - 1.
    """
    both = [*group, *(slopes.shape[1] // 2 + i for i in group)]  # x and x^2
    part = slopes[:, None, both]
    return np.asarray((part @ covariance[:, both][:, :, both] @ part.mT)[:, 0, 0])


def _interval(share: float, chance: float, pseudo: Array) -> tuple[float, float]:
    """Return the 95 % interval of a share in the variance, from which the part that chance adds is subtracted.

    The square root of a share is a length in the space of slopes, and its standard error does not depend on the share.
    The share divided by the square of this error therefore has a noncentral chi-square distribution. Its degrees of
    freedom are taken to be ``chance / error**2``. The interval contains all noncentralities that are plausible for this
    share. The interval begins at zero if zero is plausible. If the estimate is below zero, the interval is extended
    down to the estimate.

    Args:
        share: The share, including what chance adds.
        chance: The part that chance adds, which is subtracted.
        pseudo: The jackknife's pseudo-values of the share's square root. From their skewness, the two sides of the
            interval get different errors.
    """
    estimate, ends = share - chance, mean_interval(pseudo)
    if ends is None:
        return estimate, estimate
    bounds = []
    for end, tail in zip(ends, TAILS, strict=True):
        scale = ((end - pseudo.mean()) / float(ndtri(TAILS[0]))) ** 2
        freedom = max(chance / scale, 1e-6)
        possible = chndtr(share / scale, freedom, 0.0) > tail  # else no share at all is too much already
        bounds.append(scale * float(chndtrinc(share / scale, freedom, tail)) if possible else 0.0)
    return min(bounds[0], estimate), max(bounds[1], estimate)
