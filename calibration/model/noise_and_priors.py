"""What a fit weighs: the noise of measurements about a fitted model, and the priors of an arm's parameters.

A channel is the readings of one instrument in one unit. The scatter of each channel is estimated, whatever uncertainty
was stated. Errors that a model cannot express are alike at neighbouring joints. Their length scale and share of the
variance maximise the marginal likelihood of a Gaussian process on the residuals (Rasmussen and Williams 2006, eq 5.8).
A group of n rows with equal errors carries as much information as one row of variance (1 - share + share n) / n. So
rows of a cluster weigh less than isolated rows, and the common error widens the posterior (a sandwich covariance: White
1982). Equations of one picture share the error of the picture's pose; the size of this error is estimated by
expectation maximisation (Laird and Ware 1982).

A prior is the knowledge of a parameter before anything was measured: mean, standard deviation, and source. Every
parameter has a prior. The prior's width (standard deviation) limits how far a fit moves the parameter. Lengths and
angles of parts have the widths of their tolerance class. Base and tool have a width of metres if the places of
instrument and target are unknown. Coefficients of terms have widths near their tolerances. A parameter that the
measurements do not determine stays at its prior's mean. The choices of a fit (`FIT_WORDS`) are widths, too. With
"offsets", lengths and angles of parts have no width. With "full", all parameters have infinite width, as in the papers.
SI units.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.spatial.distance import cdist

from pickenv.arm import Array, Geometry, Tolerances, load_tolerances, standard_deviations
from pickenv.calibration.model import arm_model
from pickenv.calibration.model.arm_model import ArmModel, ErrorModel, Term, frames_model
from pickenv.calibration.model.observations import Observations, Rows, equally_spaced, worked_out
from pickenv.calibration.model.terms import ComplianceTerm

POSE = 6
"""Number of independent equations that one pose can give; the errors of a row with more equations are dependent."""

SCALES_OF_LIKENESS = (0.05, 0.1, 0.2, 0.4, 0.8, 1.6)
"""Candidate length scales over which errors are alike, as distances between joint vectors, rad or m."""

ALIKE = 0.2
"""Default length scale: rows whose joints differ by about this much are assumed to have like errors, rad or m."""

SHARES = (0.2, 0.4, 0.6, 0.8, 0.95)
"""Candidate shares of the variance that neighbouring rows have in common."""

STATED = 3.0
"""Weight of a channel's stated uncertainty in its estimated scatter, as a number of equations."""

USUAL = 0.75
"""Quantile of the neighbour counts that is taken as the usual count; a cluster of rows counts as one row."""

FREE = 0.25
"""Share of the rows that keep full weight when rows are weighed by their neighbours; a cluster counts as one row."""

WORTH = 3.0
"""Log-likelihood ratio above which neighbours count as having like errors."""

PROCESS_ROWS, NEIGHBOUR_ROWS = 300, 1500
"""Largest number of equally spaced rows: to fit the share in common and its length scale, and to count neighbours."""

LEAST_SPARE = 0.05
"""Least share of an equation that counts as a degree of freedom of the scatter, however large its leverage is."""


@dataclass(frozen=True, eq=False)
class RowNoise:
    """The estimated noise of E equations, in units of their stated standard uncertainties.

    Attributes:
        scatter: Standard deviation of each equation ``(E,)``, larger where rows lie closer together than usual.
        channels: Standard deviation of each channel ``(C,)``, that is of the readings of one instrument in one unit.
        share: Share of the variance that neighbouring rows have in common.
        length: Distance of joints over which rows have this share in common, rad or m.
        common: Factor on variances of rows with the usual number of neighbours, which carry less information than
            independent ones.
        shared: One entry per row whose m equations share the error of one pose. An entry has the indices, from 0, of
            these equations, orthonormal directions of the shared error in the equations' space ``(m, 6)``, and the
            share of each direction that whitening removes ``(6,)``.
        pose_std: Standard deviation of the shared pose error per axis: position, m, and attitude, rad.
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
    """Return the noise that the data state by their standard uncertainties; rows share no errors."""
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
        sizes[channel] = np.sqrt((STATED + np.sum(residual[member] ** 2)) / (STATED + np.sum(spare[member])))
    scatter = np.where(read, sizes[channels], 1.0)
    if many.any():
        tool = data.by_tool(model, unknowns)
        return _of_pictures(tool, residual, rows, channels, many, leverage, scatter, sizes)
    share, length = _alike(data.joints, residual / scatter, rows)
    if not share:
        return RowNoise(scatter, sizes)
    like = neighbours(data.joints, length)
    common = 1.0 - share + share * _usual(like, USUAL)
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
    """Return the weight of each row ``(N,)``: 1, or less for rows with more neighbours than usual, as in a cluster."""
    like = neighbours(joints, ALIKE)
    return np.asarray(np.minimum(_usual(like, FREE) / like, 1.0))


def _usual(like: Array, share: float) -> float:
    """Return the quantile ``share`` (0 to 1) of the rows' neighbour counts; a cluster of rows counts as one row.

    Args:
        like: Effective number of neighbours of each row ``(N,)``, from `neighbours`.
        share: The quantile.
    """
    like = np.sort(like)
    facts = np.cumsum(1.0 / like)
    return float(like[np.searchsorted(facts, share * facts[-1])])


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
    columns, apart = columns[some], cdist(joints[some], joints[some], "sqeuclidean")
    alone = np.eye(len(some))
    values = {(0.0, 0.0): _log_likelihood(alone, columns) + WORTH}
    for length in SCALES_OF_LIKENESS:
        like = np.exp(-0.5 * apart / length**2)
        values |= {(share, length): _log_likelihood(share * like + (1.0 - share) * alone, columns) for share in SHARES}
    return max(values, key=values.__getitem__)


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
    """Estimate the noise of each channel, and the pose error common to a row's equations, if rows have many equations.

    The function changes ``scatter`` and ``sizes`` in place.

    Args:
        tool: Whitened derivatives of each equation with respect to the tool's pose ``(E, 6)``.
        residual: Whitened residual of each equation ``(E,)``.
        rows: Index, from 0, of each equation's row ``(E,)``; -1 for an equation without a row.
        channels: Index, from 0, of each equation's channel ``(E,)``.
        many: Whether each equation's row has more than `POSE` equations ``(E,)``.
        leverage: Leverage of each equation ``(E,)``, 0 to 1.
        scatter: Standard deviation of each equation ``(E,)``, in stated standard uncertainties.
        sizes: Standard deviation of each channel ``(C,)``, in stated standard uncertainties.
    """
    places = [np.flatnonzero(many & (rows == row)) for row in np.unique(rows[many])]
    channel = np.array([channels[at[0]] for at in places])
    gram = np.stack([tool[at].T @ tool[at] for at in places])
    right = np.stack([tool[at].T @ residual[at] for at in places])
    square = np.array([residual[at] @ residual[at] for at in places])
    count = np.array([len(at) for at in places], dtype=float)
    spare = max(1.0 - leverage[many].sum() / (POSE * len(places)), LEAST_SPARE)
    bound = np.sqrt(np.trace(gram, axis1=1, axis2=2).mean() / POSE)
    pose = (np.ones(POSE) / max(bound, 1e-300)) ** 2
    for _ in range(40):  # rounds of expectation maximisation
        white = sizes[channel] ** 2
        covariance = np.linalg.inv(gram / white[:, None, None] + np.diag(1.0 / pose))
        mean = (covariance @ (right / white[:, None])[..., None])[..., 0]
        second = covariance + mean[:, :, None] * mean[:, None, :]
        sums = np.diagonal(second, axis1=1, axis2=2).mean(axis=0) / spare
        pose = np.repeat([sums[:3].mean(), sums[3:].mean()], 3)
        remains = square - 2.0 * np.sum(mean * right, axis=1) + np.einsum("nij,nji->n", gram, second)
        for k in np.unique(channel):
            views = channel == k
            sizes[k] = np.sqrt((STATED + remains[views].sum()) / (STATED + count[views].sum()))
    shared = []
    for at, size in zip(places, sizes[channel], strict=True):
        scatter[at] = size
        basis, strength, _ = np.linalg.svd(tool[at] * np.sqrt(pose) / size, full_matrices=False)
        shared.append((at, basis, 1.0 - 1.0 / np.sqrt(1.0 + strength**2)))
    return RowNoise(scatter, sizes, shared=tuple(shared), pose_std=(float(np.sqrt(pose[0])), float(np.sqrt(pose[3]))))


FitWord = Literal["auto", "offsets", "full"]
FIT_WORDS: tuple[FitWord, ...] = get_args(FitWord)
"""Choices of the parameters that a fit may move. "auto": all parameters, with priors. "offsets": joint zeros, and base
and tool if these are unknown. "full": all parameters, without priors."""

TOLERANCE_CLASS = "cobot"
"""Default tolerance class of an arm's parts."""

FRAME_STD = 10.0
"""Standard deviation of a frame's coordinates about its aligned pose, m and rad: too wide to carry information."""

TOLD = 0.1
"""Largest standard deviation of a base or tool parameter that the rows determine, as a share of `FRAME_STD`."""

ANY_STIFFNESS = 100.0
"""Prior standard deviation of a compliance, in tolerances: any stiffness above 100 N*m/rad or 1 kN/m is plausible."""

FRAMES, ZEROS, LENGTHS, ANGLES, TERMS = "frames", "zeros", "lengths", "angles", "terms"
"""Groups of parameters: base and tool if unknown, joint zeros, lengths and angles of parts, terms' coefficients."""

MADE = (ZEROS, LENGTHS, ANGLES)
"""Groups whose prior widths come from a tolerance class; a factor on each group's widths is estimated from the rows."""


@dataclass(frozen=True, eq=False)
class Prior(Observations):
    """The prior of parameters as one more data set: each parameter is expected near its value in a reference model.

    Attributes:
        reference: The arm whose parameters have the expected values.
        columns: Indices of the k parameters with this prior in the arm's ``parameter_names`` ``(k,)``.
        std: Standard deviations ``(k,)``, in the parameters' units.
    """

    reference: ArmModel
    columns: NDArray[np.int64]
    std: Array
    source: str = "prior"
    kind: str = "prior"
    framed: bool = False
    sized: bool = False

    @worked_out
    def joints(self) -> Array:
        """An empty array ``(0, n)``: a prior has no poses."""
        return np.zeros((0, self.reference.geometry.joints))

    def residual(self, model: ArmModel, unknowns: Array) -> Array:
        """Return expected minus current parameters ``(k,)``, in the priors' standard deviations."""
        return model.difference(self.reference)[self.columns] / self.std

    def jacobian(self, model: ArmModel, unknowns: Array) -> tuple[Array, Array]:
        """Return the whitened derivatives of the k parameters with respect to all parameters of the arm.

        The second array, the derivatives with respect to unknowns, has no columns.
        """
        rows = np.zeros((len(self.columns), len(model.parameter_names)))
        rows[np.arange(len(self.columns)), self.columns] = 1.0 / self.std
        return rows, np.zeros((len(rows), 0))


@dataclass(frozen=True, eq=False)
class PriorModel:
    """The parameters that a fit may move, each with its prior.

    Attributes:
        parameters: The parameters ``(P,)``.
        start: The arm with the expected values of the parameters; a fit starts from them.
        std: The priors' standard deviations ``(P,)``, m, rad or a coefficient's unit; infinite without a prior.
        group: The group of each parameter: `FRAMES`, one of `MADE`, or `TERMS`.
        source: Origin, in words, of the prior widths of joint zeros, lengths and angles.
        scales: Known factors on the widths, by group; missing factors are estimated from the rows.
        stated: The groups whose factors were stated, so that a fit with further terms does not estimate them again.
    """

    parameters: ErrorModel
    start: ArmModel
    std: Array
    group: NDArray[np.str_]
    source: str
    scales: Mapping[str, float] = field(default_factory=dict)
    stated: tuple[str, ...] = ()

    @property
    def proper(self) -> bool:
        """Whether every parameter has a prior of finite width."""
        return bool(np.isfinite(self.std).all())

    @property
    def width(self) -> Array:
        """Standard deviations of the priors ``(P,)``, times their groups' scales."""
        return np.asarray(self.std * np.array([self.scales.get(name, 1.0) for name in self.group]))

    def prior(self, weight: float = 1.0) -> Prior:
        """Return the priors of finite width as a data set; ``weight`` divides the widths, so 2 halves them."""
        some = np.isfinite(self.std)
        return Prior(self.start, self.parameters.columns[some], self.width[some] / weight)

    def without_base(self) -> PriorModel:
        """Return this model without the base's parameters, which instruments without a frame cannot determine."""
        further = np.array([not name.startswith("base_") for name in self.parameters.names])
        return replace(self, parameters=self.parameters.some(further), std=self.std[further], group=self.group[further])

    def with_terms(self, terms: tuple[Term, ...]) -> PriorModel:
        """Return this model with further terms, whose coefficients are expected at zero.

        Factors in ``scales`` that were estimated without the terms are dropped. Without the terms, the noise of the
        rows is estimated too large, and the tolerances of the arm's parts too small.
        """
        if not terms:
            return self
        scales = {name: scale for name, scale in self.scales.items() if name in self.stated}
        start = ArmModel.of(self.start.geometry, terms)
        parameters = arm_model.with_terms(self.parameters, start)
        std = np.r_[self.std, expected_sizes(start) * start.term_tolerances]
        group = np.r_[self.group, np.full(len(std) - len(self.std), TERMS)]
        return replace(self, parameters=parameters, start=start, std=std, group=group, scales=scales)


def prior_model(
    arm: str,
    geometry: Geometry,
    *,
    known: bool,
    fit: str = "auto",
    tolerances: Tolerances | str | None = None,
    scale: float | None = None,
) -> PriorModel:
    """Return the parameters of an arm with their priors.

    Args:
        arm: The arm's name; for tool poses given in place of joint values (`arm_model.CARRIER`), only base and tool are
            fitted.
        geometry: The arm's nominal geometry, with aligned base and tool.
        known: Whether the measurements are poses of the arm's own tool in the arm's own base frame. The mounting of
            joint 1 on the base, and of the flange on the last link, then have priors of the tolerance class.
        fit: One of `FIT_WORDS`.
        tolerances: The tolerance class of zeros and parts, or its name; `TOLERANCE_CLASS` when left out.
        scale: Factor on the class's widths; estimated from the rows when left out.

    Raises:
        InputError: If the class is unknown.
    """
    start = ArmModel.of(geometry)
    if arm == arm_model.CARRIER or fit == "full":
        parameters = arm_model.fitted_model(arm, geometry, known)
        std = np.full(len(parameters.names), np.inf)
        return PriorModel(parameters, start, std, _groups(parameters, geometry, known), "none: any value is as likely")
    expected = tolerances if isinstance(tolerances, Tolerances) else load_tolerances(tolerances or TOLERANCE_CLASS)
    parameters = arm_model.complete_model(geometry)
    if fit == "offsets":
        zeros = arm_model.joint_zeros_model(geometry)
        parameters = zeros if known else frames_model(geometry).joined(zeros)
    group = _groups(parameters, geometry, known)
    std = np.where(group == FRAMES, FRAME_STD, standard_deviations(expected, geometry)[parameters.columns])
    scales = {} if scale is None else dict.fromkeys(MADE, scale)
    return PriorModel(parameters, start, std, group, f"tolerance class {expected.name}", scales, tuple(scales))


def expected_sizes(model: ArmModel) -> Array:
    """Return prior standard deviations of the terms' coefficients ``(k,)``, as multiples of their tolerances.

    The multiple is `ANY_STIFFNESS` for compliances. For all other coefficients it is 1, which moves the tool by about
    1 mm or turns it by about 1 mrad.
    """
    sizes = [ANY_STIFFNESS if isinstance(term, ComplianceTerm) else 1.0 for term in model.terms]
    return np.repeat(sizes, [len(term.names(model.geometry)) for term in model.terms])


def never_told(names: Sequence[str], covariance: Array) -> list[str]:
    """Return the names of base and tool parameters that the rows of a fit do not determine.

    An example is the tool's attitude if only positions were measured. The posterior of such a parameter is as wide as
    its prior: metres, or turns. The posterior is somewhat narrower than the prior if an unknown of the data, such as a
    wire's hook, has the same effect as the parameter.

    Args:
        names: Names of the identified parameters, p of them.
        covariance: Posterior covariance of these parameters ``(p, p)``, m and rad.
    """
    wide = np.diag(covariance) > (TOLD * FRAME_STD) ** 2
    return [name for name, free in zip(names, wide, strict=True) if free and name.startswith(("base_", "tool_"))]


def _groups(parameters: ErrorModel, geometry: Geometry, known: bool) -> NDArray[np.str_]:
    """Return the group of each parameter ``(P,)``: `FRAMES`, `ZEROS`, `LENGTHS` or `ANGLES`.

    If ``known``, that is if base and tool are known, their parameters count as lengths and angles of parts.
    """
    frame = np.array([name.startswith(("base_", "tool_")) for name in parameters.names])
    zero = np.isin(parameters.columns, arm_model.joint_zeros_model(geometry).columns)
    part = np.where(geometry.parameter_is_angle[parameters.columns], ANGLES, LENGTHS)
    return np.where(frame & (not known), FRAMES, np.where(zero, ZEROS, part))
