"""Priors of an arm's parameters, before anything was measured: mean, standard deviation, and source.

Every parameter has a prior, whose width (standard deviation) limits how far a fit moves it. Lengths and angles of parts
have the widths of their tolerance class. Base and tool have a width of metres if the places of instrument and target
are unknown. Coefficients of terms have widths near their tolerances. A parameter that the measurements do not determine
stays at its prior's mean. The choices of a fit (`FIT_WORDS`) are widths, too. With "offsets", lengths and angles of
parts have no width. With "full", all parameters have infinite width, as in the papers. SI units.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from pickenv.arm import Array, Geometry, Tolerances, load_tolerances, standard_deviations
from pickenv.calibration.model import arm_model
from pickenv.calibration.model.arm_model import ArmModel, ErrorModel, Term, frames_model
from pickenv.calibration.model.observations import Observations, worked_out
from pickenv.calibration.model.terms import ComplianceTerm

FitWord = Literal["auto", "offsets", "full"]
FIT_WORDS: tuple[FitWord, ...] = get_args(FitWord)
"""Choices of the parameters that a fit may move: "auto" for all within their priors, "offsets" for joint zeros and an
unknown base and tool, "full" for all without priors."""

TOLERANCE_CLASS = "cobot"
"""Default tolerance class of an arm's parts."""

FRAME_STD = 10.0
"""Standard deviation of a frame's coordinates about its aligned pose, m and rad: too wide to carry information."""

TOLD = 0.1
"""Limit up to which the rows determine a parameter of base or tool, as a share of `FRAME_STD`."""

COEFFICIENT = 1.0
"""Prior standard deviation of a term's coefficient, as a multiple of its tolerance (1 mm or 1 mrad at the tool)."""

ANY_STIFFNESS = 100.0
"""Prior standard deviation of a compliance, as a multiple of its tolerance: every stiffness above 100 N*m/rad or 1 kN/m
is plausible."""

FRAMES, ZEROS, LENGTHS, ANGLES, TERMS = "frames", "zeros", "lengths", "angles", "terms"
"""Groups of parameters: base and tool of unknown pose, joint zeros, lengths and angles of parts, terms'
coefficients."""

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

        Factors in ``scales`` that were estimated without the terms are dropped. In such an estimate the rows seem
        noisier than they are, and the parts more accurate.
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
    zeros = arm_model.joint_zeros_model(geometry)
    parameters = arm_model.complete_model(geometry)
    if fit == "offsets":
        parameters = zeros if known else frames_model(geometry).joined(zeros)
    group = _groups(parameters, geometry, known)
    std = np.where(group == FRAMES, FRAME_STD, standard_deviations(expected, geometry)[parameters.columns])
    scales = {} if scale is None else dict.fromkeys(MADE, scale)
    return PriorModel(parameters, start, std, group, f"tolerance class {expected.name}", scales, tuple(scales))


def expected_sizes(model: ArmModel) -> Array:
    """Return prior standard deviations of the terms' coefficients ``(k,)``, as multiples of their tolerances."""
    counts = [len(term.names(model.geometry)) for term in model.terms]
    sizes = [ANY_STIFFNESS if isinstance(term, ComplianceTerm) else COEFFICIENT for term in model.terms]
    return np.repeat(sizes, counts)


def never_told(names: Sequence[str], covariance: Array) -> list[str]:
    """Return the names of base and tool parameters that the rows of a fit do not determine.

    An example is the tool's attitude if only positions were measured. The posterior of such a parameter is as wide as
    its prior: metres, or turns. It is narrower where an unknown of the data shares the prior, as a wire's hook does.

    Args:
        names: Names of the identified parameters, p of them.
        covariance: Their posterior covariance ``(p, p)``, m and rad.
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
