"""The noise of measurements about a fitted model: the variance of each channel, and the error that neighbours share.

A channel is the readings of one instrument in one unit. Its scatter is estimated, whatever uncertainty was stated.
Errors that a model cannot express are alike at neighbouring joints. Their length scale and share of the variance
maximise the marginal likelihood of a Gaussian process on the residuals (Rasmussen and Williams 2006, eq 5.8). A number
n of rows with equal errors carries as much information as one row of variance (1 - share + share n) / n. So rows of a
cluster weigh less than isolated rows, and the common error widens the posterior (a sandwich covariance: White 1982).
Equations of one picture share the error of its pose; the size of that error is estimated by expectation maximisation
(Laird and Ware 1982). SI units.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.spatial.distance import cdist

from pickenv.arm import Array
from pickenv.calibration.model.arm_model import ArmModel
from pickenv.calibration.model.observations import Observations, Rows, equally_spaced

POSE = 6
"""Number of independent equations that one pose can give; the errors of a row with more equations are dependent."""

LENGTHS = (0.05, 0.1, 0.2, 0.4, 0.8, 1.6)
"""Candidate length scales over which errors are alike, as distances between joint vectors, rad or m."""

ALIKE = 0.2
"""Default length scale: rows whose joints differ by about this much are assumed to have like errors, rad or m."""

SHARES = (0.2, 0.4, 0.6, 0.8, 0.95)
"""Candidate shares of the variance that neighbouring rows have in common."""

STATED = 3.0
"""Weight of a channel's stated uncertainty in its estimated scatter, as a number of equations."""

USUAL = 0.75
"""Quantile of the neighbour counts that is taken as the usual count; a cluster of rows counts as one row in it."""

FREE = 0.25
"""Share of the rows that keep full weight when rows are weighed by their neighbour counts; a cluster counts as one
row."""

WORTH = 3.0
"""Log-likelihood ratio above which neighbours count as having like errors."""

PROCESS_ROWS, NEIGHBOUR_ROWS = 300, 1500
"""Largest numbers of equally spaced rows: those that length and share are fitted to, and those searched for
neighbours."""

LEAST_SPARE = 0.05
"""Least share of an equation that counts as a degree of freedom of the scatter, however large its leverage is."""

ROUNDS = 40
"""Number of iterations of expectation maximisation."""


@dataclass(frozen=True, eq=False)
class RowNoise:
    """The estimated noise of E equations, in units of their stated standard uncertainties.

    Attributes:
        scatter: Standard deviation of each equation ``(E,)``, larger where rows lie closer together than usual.
        channels: Standard deviation of each channel ``(C,)``, that is of the readings of one instrument in one unit.
        share: Share of the variance that neighbouring rows have in common.
        length: Distance of joints over which rows have that share in common, rad or m.
        common: Factor on variances of rows with the usual number of neighbours, which carry less information than
            independent ones.
        shared: One entry per row whose m equations share the error of one pose. It has the indices, from 0, of these
            equations, orthonormal directions of that error in their space ``(m, 6)``, and the share of each direction
            that whitening removes ``(6,)``.
        pose_std: Standard deviation of that shared error per axis: position, m, and attitude, rad.
    """

    scatter: Array
    channels: Array
    share: float = 0.0
    length: float = 0.0
    common: float = 1.0
    shared: tuple[tuple[Rows, Array, Array], ...] = ()
    pose_std: tuple[float, float] = (0.0, 0.0)

    def whiten(self, rows: Array) -> Array:
        """Return equations ``(E + k, ...)``, whitened by this noise.

        Args:
            rows: Equations in units of their stated standard uncertainties. The last k, such as priors, belong to no
                instrument and stay unchanged.
        """
        count = len(self.scatter)
        white = np.array(rows, dtype=float)
        white[:count] /= self.scatter if white.ndim == 1 else self.scatter[:, None]
        for at, basis, shrink in self.shared:
            white[at] -= basis @ ((basis.T @ white[at]).T * shrink).T
        return white


def stated_noise(data: Observations) -> RowNoise:
    """Return the noise by the standard uncertainties that the data state, without errors shared between rows."""
    rows, channels = data.equations()
    return RowNoise(np.ones(len(rows)), np.ones(int(channels.max(initial=0)) + 1))


def noise_of(data: Observations, model: ArmModel, unknowns: Array, leverage: Array) -> RowNoise:
    """Estimate the noise of rows about a model that was fitted to them.

    Args:
        data: The rows.
        model: The fitted model.
        unknowns: Values of the data's own unknowns, such as places of reflectors ``(u,)``.
        leverage: Leverage of each equation ``(E,)``, 0 to 1: the share of the equation that the fit used to determine
            parameters.
    """
    residual = data.residual(model, unknowns)
    rows, channels = data.equations()
    read = rows >= 0
    many = read & (np.bincount(rows[read], minlength=len(data.joints))[rows] > POSE)
    sizes = np.ones(int(channels.max(initial=0)) + 1)
    spare = np.clip(1.0 - leverage, LEAST_SPARE, 1.0)
    for channel in range(len(sizes)):
        member = read & (channels == channel)
        if member.any():
            sizes[channel] = np.sqrt((STATED + np.sum(residual[member] ** 2)) / (STATED + np.sum(spare[member])))
    scatter = np.where(read, sizes[channels], 1.0)
    if many.any():
        tool = data.by_tool(model, unknowns)
        return _of_pictures(tool, residual, rows, channels, many, leverage, scatter, sizes)
    share, length = _alike(data.joints, residual / scatter, rows)
    if not share:
        return RowNoise(scatter, sizes)
    like = neighbours(data.joints, length)
    usual = _usual(like, USUAL)
    common = 1.0 - share + share * usual
    closer = np.maximum((1.0 - share + share * like) / common, 1.0)
    return RowNoise(np.where(read, scatter * np.sqrt(closer)[rows], 1.0), sizes, share, length, common)


def neighbours(joints: Array, length: float) -> Array:
    """Compute the effective number of neighbours of each row ``(N,)``, itself included: the sum of exp(-d^2 / 2 l^2).

    Args:
        joints: Joints ``(N, n)``, rad or m, between which d is the distance.
        length: Length scale l, rad or m.
    """
    some = equally_spaced(len(joints), NEIGHBOUR_ROWS)
    like = np.empty(len(joints))
    for part in np.array_split(np.arange(len(joints)), max(1, len(joints) // 100)):  # as much as stays near
        kernel = cdist(joints[part], joints[some], "sqeuclidean")
        kernel *= -0.5 / length**2
        np.exp(kernel, out=kernel)
        kernel[part[:, None] == some] = 0.0
        like[part] = 1.0 + kernel.sum(axis=1) * (len(joints) - 1) / max(len(some) - 1, 1)
    return like


def counted(joints: Array) -> Array:
    """Return the weight of each row ``(N,)``: 1, or less for rows with more neighbours than usual (similar errors)."""
    like = neighbours(joints, ALIKE)
    return np.asarray(np.minimum(_usual(like, FREE) / like, 1.0))


def _usual(like: Array, share: float) -> float:
    """Return the quantile ``share`` (0 to 1) of the rows' neighbour counts; a cluster of rows counts as one row.

    Args:
        like: Effective number of neighbours of each row ``(N,)``, from `neighbours`.
        share: The quantile.
    """
    order = np.argsort(like)
    facts = np.cumsum(1.0 / like[order])
    return float(like[order][np.searchsorted(facts, share * facts[-1])])


def _alike(joints: Array, white: Array, rows: Rows) -> tuple[float, float]:
    """Fit the share of the variance that neighbours have in common, and its length scale; both 0 without such a share.

    Args:
        joints: Joints ``(N, n)``, rad or m.
        white: Residuals of the equations ``(E,)``, divided by their scatter.
        rows: Index, from 0, of each equation's row ``(E,)``; -1 for an equation without a row.
    """
    if len(joints) < 4 * POSE or (rows < 0).any() or len(white) % len(joints):
        return 0.0, 0.0
    columns = white.reshape(len(joints), -1)
    some = equally_spaced(len(joints), PROCESS_ROWS)
    joints, columns = joints[some], columns[some]
    apart = cdist(joints, joints, "sqeuclidean")
    best, choice = _log_likelihood(np.eye(len(some)), columns) + WORTH, (0.0, 0.0)
    for length in LENGTHS:
        kernel = np.exp(-0.5 * apart / length**2)
        for share in SHARES:
            value = _log_likelihood(share * kernel + (1.0 - share) * np.eye(len(some)), columns)
            if value > best:
                best, choice = value, (share, length)
    return choice


def _log_likelihood(covariance: Array, columns: Array) -> float:
    """Compute the log-likelihood, up to a constant, of columns ``(N, k)``, each scaled by its most likely variance."""
    factor = cho_factor(covariance, lower=True, check_finite=False)
    squares = np.maximum(np.sum(columns * cho_solve(factor, columns, check_finite=False), axis=0), 1e-300)
    return float(-0.5 * len(columns) * np.log(squares).sum() - columns.shape[1] * np.log(np.diag(factor[0])).sum())


def _of_pictures(
    tool: Array,
    residual: Array,
    rows: Rows,
    channels: Rows,
    many: NDArray[np.bool_],
    leverage: Array,
    scatter: Array,
    sizes: Array,
) -> RowNoise:
    """Estimate the noise of each channel, and the pose error common to a row's equations, of rows with many equations.

    For each of the E equations, ``tool`` has the derivatives with respect to the tool's pose ``(E, 6)``, ``residual``
    the whitened residual, ``rows`` and ``channels`` the indices of row and channel, ``leverage`` the leverage, and
    ``many`` whether the row has more than `POSE` equations. The standard deviations of equations, ``scatter`` ``(E,)``,
    and of channels, ``sizes`` ``(C,)``, are changed in place.
    """
    places = [np.flatnonzero(many & (rows == row)) for row in np.unique(rows[many])]
    channel = np.array([channels[at[0]] for at in places])
    gram = np.stack([tool[at].T @ tool[at] for at in places])
    right = np.stack([tool[at].T @ residual[at] for at in places])
    square = np.array([residual[at] @ residual[at] for at in places])
    count = np.array([len(at) for at in places], dtype=float)
    spare = max(1.0 - leverage[many].sum() / (POSE * len(places)), LEAST_SPARE)
    white = sizes[channel] ** 2
    bound = np.sqrt(np.trace(gram, axis1=1, axis2=2).mean() / POSE)
    pose = (np.ones(POSE) / max(bound, 1e-300)) ** 2
    for _ in range(ROUNDS):
        covariance = np.linalg.inv(gram / white[:, None, None] + np.diag(1.0 / pose))
        mean = (covariance @ (right / white[:, None])[..., None])[..., 0]
        second = covariance + mean[:, :, None] * mean[:, None, :]
        sums = np.diagonal(second, axis1=1, axis2=2).mean(axis=0) / spare
        pose = np.repeat([sums[:3].mean(), sums[3:].mean()], 3)
        remains = square - 2.0 * np.sum(mean * right, axis=1) + np.einsum("nij,nji->n", gram, second)
        for k in np.unique(channel):
            views = channel == k
            sizes[k] = np.sqrt((STATED + remains[views].sum()) / (STATED + count[views].sum()))
        white = sizes[channel] ** 2
    shared = []
    for at, size in zip(places, sizes[channel], strict=True):
        scatter[at] = size
        basis, strength, _ = np.linalg.svd(tool[at] * np.sqrt(pose) / size, full_matrices=False)
        shared.append((at, basis, 1.0 - 1.0 / np.sqrt(1.0 + strength**2)))
    std = float(np.sqrt(pose[0])), float(np.sqrt(pose[3]))
    return RowNoise(scatter, sizes, shared=tuple(shared), pose_std=std)
