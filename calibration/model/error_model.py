"""The error model: which parameters of a geometry are identified, and on what scale.

Complete for any serial chain: four modified DH parameters per joint, Hayati's beta where consecutive axes are parallel,
base and tool pose. Rows are weighted by the measurement's uncertainty and columns by a parameter's tolerance, because
rank and redundancy are meaningless in mixed units (Qiao 2026 digest, fact 2).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pickenv.arm import Geometry
from pickenv.arm.kinematics.geometry import Array
from pickenv.calibration.model.arm_model import ArmModel

LENGTH_TOLERANCE = 1e-3
"""Scale of a length's deviation, m."""

ANGLE_TOLERANCE = 1e-3
"""Scale of an angle's deviation, rad (0.057 deg)."""

PARALLEL = 1e-6
"""Consecutive axes count as parallel below this sine of the angle between them."""


@dataclass(frozen=True, eq=False)
class ErrorModel:
    """The parameters to identify.

    Attributes:
        columns: Indices into the geometry's ``parameter_names``, shape (P,), in order of preference: where parameters
            are redundant the earlier one is kept.
        names: Their names.
        tolerance: Scale of each parameter's deviation, m or rad, shape (P,).
    """

    columns: NDArray[np.int64]
    names: tuple[str, ...]
    tolerance: Array

    def some(self, kept: NDArray[np.bool_]) -> ErrorModel:
        """Those of these parameters ``(P,)`` that are marked."""
        names = tuple(name for name, keep in zip(self.names, kept, strict=True) if keep)
        return ErrorModel(self.columns[kept], names, self.tolerance[kept])

    def joined(self, other: ErrorModel) -> ErrorModel:
        """These parameters, then those of another model."""
        columns, tolerance = np.r_[self.columns, other.columns], np.r_[self.tolerance, other.tolerance]
        return ErrorModel(columns, self.names + other.names, tolerance)


def link_model(geometry: Geometry) -> ErrorModel:
    """The paper's model: the four MDH parameters of every joint; base and tool are taken as known (eqs (7)-(8))."""
    return _model(geometry, _link_names(geometry))


def complete_model(geometry: Geometry) -> ErrorModel:
    """Base and tool pose, MDH parameters, and Hayati's beta between parallel axes: complete for any serial chain."""
    names = geometry.parameter_names
    frames = [name for name in names if name.startswith(("base_", "tool_"))]
    links = _link_names(geometry)
    betas = [f"beta{i}" for i in range(1, geometry.links) if abs(np.sin(geometry.alpha[i])) < PARALLEL]
    return _model(geometry, frames + links + betas)


def geometric_model(geometry: Geometry, known_frames: bool) -> ErrorModel:
    """What is identified: the links alone where base and tool are known, else base and tool with them."""
    return link_model(geometry) if known_frames else complete_model(geometry)


def frames_model(geometry: Geometry) -> ErrorModel:
    """Base and tool pose only: what must be fitted before a nominal error can be stated honestly."""
    return _model(geometry, [name for name in geometry.parameter_names if name.startswith(("base_", "tool_"))])


def joint_zeros_model(geometry: Geometry) -> ErrorModel:
    """The zero of every joint: theta where its link turns, d where it slides."""
    return _model(geometry, [f"{'d' if slides else 'theta'}{i + 1}" for i, slides in enumerate(geometry.slides)])


def with_terms(model: ErrorModel, arm: ArmModel) -> ErrorModel:
    """The model's parameters and the coefficients of the arm's terms."""
    count = len(arm.geometry.parameter_names)
    columns = np.arange(count, len(arm.parameter_names))
    return model.joined(ErrorModel(columns, arm.parameter_names[count:], arm.term_tolerances))


def _link_names(geometry: Geometry) -> list[str]:
    """The MDH parameters by kind, lengths before joint angles.

    Where an offset and angles are tied (d3 = (theta2 - theta1) / a1 of the picking arm), the offset is kept: a length
    expresses a finite deviation exactly, angles only to first order.
    """
    kinds = ("alpha", "a", "d", "theta")
    return [name for kind in kinds for name in geometry.parameter_names if name.rstrip("0123456789") == kind]


def _model(geometry: Geometry, names: list[str]) -> ErrorModel:
    index = {name: i for i, name in enumerate(geometry.parameter_names)}
    columns = np.array([index[name] for name in names])
    tolerance = np.where(geometry.parameter_is_angle[columns], ANGLE_TOLERANCE, LENGTH_TOLERANCE)
    return ErrorModel(columns, tuple(names), tolerance)
