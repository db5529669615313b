"""How well the calibrated arm's tool pose is known, anywhere: u^2 = J C J^T + u_repeat^2 (GUM, JCGM 100:2008, 5.1.2).

C is the covariance of the identified parameters; u_repeat is what one reach scatters by that the parameters do not say:
repeatability, and what the model leaves out, which differs from pose to pose (`local_scatter`). How many u hold 95 of
100 errors is not assumed but counted. A calibration keeps all of it in its record, so that a command can be given with
its uncertainty later. SI units.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import KDTree

from pickenv.arm.kinematics.geometry import Array
from pickenv.calibration.assessment.screen import Block, figure
from pickenv.calibration.identification.least_squares import Identification
from pickenv.calibration.model.arm_model import ArmModel, Conditions
from pickenv.calibration.model.observations import Observations
from pickenv.calibration.model.splits import Rows, equally_spaced
from pickenv.calibration.pipeline.local_scatter import (
    ANCHORS,
    LocalScatter,
    Within95,
    joint_features,
    local_scatter,
    within95,
)

ALIKE, SPACING = 0.3, 1.5
"""Poses whose joints lie so far apart, rad or m, are alike in what a model leaves out; or so many times farther than
those measured lie from their neighbours."""

VAGUE = 2.0
"""Where parameters tell the pose so many times worse than at 95 of 100 rows fitted, nothing like it was measured."""

MEASURED_REGION = "measured_region"
"""Entry of a calibration's record that holds `region_of`."""

LOCAL, WITHIN = ("position_local", "attitude_local"), ("position_within95", "attitude_within95")
"""What differs from pose to pose, and what holds 95 of 100 errors: positions first."""


@dataclass(frozen=True, eq=False)
class PoseUncertainty:
    """Uncertainty of predicted poses of one calibrated arm.

    Attributes:
        names: Identified parameters of the arm.
        covariance: Of their errors ``(p, p)``, m and rad.
        position_repeat: Standard deviation of one position coordinate that the parameters do not explain, m.
        attitude_repeat: The same of one attitude coordinate, rad; None where only positions were measured.
        position_local: How the position's scatter differs from pose to pose; None where it is taken as the same.
        attitude_local: The attitude's.
        position_within95: What holds 95 of 100 position errors; None where too few errors show it.
        attitude_within95: The same of attitudes.
    """

    names: tuple[str, ...]
    covariance: Array
    position_repeat: float
    attitude_repeat: float | None
    position_local: LocalScatter | None = None
    attitude_local: LocalScatter | None = None
    position_within95: Within95 | None = None
    attitude_within95: Within95 | None = None

    def pose_covariance(self, model: ArmModel, joints: ArrayLike, conditions: Conditions | None = None) -> Array:
        """Covariance ``(..., 6, 6)`` of the tool pose, m and rad, world axes, at joints ``(..., n)``.

        Attitude rows of an arm of which only positions were measured hold the parameters' part alone.
        """
        columns = [model.parameter_names.index(name) for name in self.names]
        found = model.pose_covariance(columns, self.covariance, joints, conditions)
        repeats = ((self.position_local, self.position_repeat), (self.attitude_local, self.attitude_repeat or 0.0))
        for first, (local, repeat) in zip((0, 3), repeats, strict=True):
            own = np.broadcast_to(repeat**2 if local is None else local.at(joints) / 3.0, found.shape[:-2])
            found[..., range(first, first + 3), range(first, first + 3)] += own[..., None]
        return found

    def standard(
        self, model: ArmModel, joints: ArrayLike, conditions: Conditions | None = None
    ) -> tuple[Array, Array | None]:
        """Standard uncertainties of position ``(...)``, m, and attitude ``(...)``, rad: root of the three variances.

        That of the attitude is None where only positions were measured.
        """
        variance = np.diagonal(self.pose_covariance(model, joints, conditions), axis1=-2, axis2=-1)
        position, attitude = np.sqrt(variance[..., :3].sum(-1)), np.sqrt(variance[..., 3:].sum(-1))
        return position, None if self.attitude_repeat is None else attitude

    def from_parameters(self, model: ArmModel, joints: ArrayLike, conditions: Conditions | None = None) -> Array:
        """Standard uncertainty of position ``(...)``, m, by the parameters alone: large where nobody measured."""
        columns = [model.parameter_names.index(name) for name in self.names]
        found = model.pose_covariance(columns, self.covariance, joints, conditions)
        return np.asarray(np.sqrt(np.trace(found[..., :3, :3], axis1=-2, axis2=-1)))

    def within95(
        self, model: ArmModel, joints: ArrayLike, conditions: Conditions | None = None
    ) -> tuple[Array | None, Array | None]:
        """What holds 95 of 100 errors of position ``(...)``, m, and attitude ``(...)``, rad, at joints ``(..., n)``.

        None where too few held-out errors show it.
        """
        position, attitude = self.standard(model, joints, conditions)
        near, turned = self.position_within95, self.attitude_within95
        return (
            None if near is None else near.factor * position,
            None if turned is None or attitude is None else turned.factor * attitude,
        )

    def block(self, model: ArmModel, joints: Array, conditions: Conditions) -> Block:
        """How far errors go at these poses, and whether held-out ones did, for screens."""
        radii, rows = self.within95(model, joints, conditions), []
        for what, radius, known, scale, unit in (
            ("position", radii[0], self.position_within95, 1e3, "mm"),
            ("attitude", radii[1], self.attitude_within95, float(np.degrees(1.0)), "deg"),
        ):
            if radius is not None and known is not None:
                low, middle, high = np.percentile(radius * scale, [5, 50, 95])
                said = f"{figure(middle)} {unit} ({figure(low)} to {figure(high)})"
                rows.append((what, said, f"{100 * known.covered:.1f} %", f"{known.rank_correlation:.2f}"))
        heads = ("of", "95 of 100 are within (5 to 95 of 100 poses)", "held so", "told where (rank correlation)")
        note = "by pose; held and told: of held-out rows, each judged by what was found without its block"
        return Block("How far errors go", heads, tuple(rows), note)

    def within95_record(self) -> dict[str, Any]:
        """Factors and what they cover (JSON), of position and attitude; None where too few errors show it."""
        found = {"position": self.position_within95, "attitude": self.attitude_within95}
        return {name: None if part is None else dict(vars(part)) for name, part in found.items()}

    def as_record(self) -> dict[str, Any]:
        """For a calibration's record (JSON)."""
        return {
            "parameters": list(self.names),
            "covariance": self.covariance.tolist(),
            "position_repeat_m": self.position_repeat,
            "attitude_repeat_rad": self.attitude_repeat,
            **{name: part.as_record() for name in LOCAL if (part := getattr(self, name)) is not None},
            **{name: vars(part) for name in WITHIN if (part := getattr(self, name)) is not None},
        }


def pose_uncertainty(
    found: Identification,
    errors: Array,
    joints: Array | None = None,
    blocks: Rows | None = None,
    conditions: Conditions | None = None,
    unit: str = "mm",
) -> PoseUncertainty:
    """Uncertainty from an identification and the errors that it leaves.

    Args:
        found: The identification.
        errors: Measured minus predicted poses, best held-out ones, ``(N, 6)`` or positions ``(N, 3)``, m and rad; their
            RMS per coordinate is taken as u_repeat, so it includes the instrument's noise and errs on the large side.
        joints: Where each error was found ``(N, n)``; then its size may differ from pose to pose.
        blocks: The block of each error, where errors of one block are alike.
        conditions: Payload and temperature of each, where known.
        unit: "deg" where the errors are misses of directions ``(N, k)``, rad: of positions no more is known then than
            what the parameters say.
    """
    positions, attitudes = (np.zeros((0, 3)), errors) if unit == "deg" else (errors[:, :3], errors[:, 3:])
    own = set(found.arm_model.parameter_names)
    places = [i for i, name in enumerate(found.identifiability.kept_names) if name in own]
    sure = PoseUncertainty(
        names=tuple(found.identifiability.kept_names[i] for i in places),
        covariance=found.covariance[np.ix_(places, places)],
        position_repeat=float(np.sqrt(np.mean(positions**2))) if positions.size else 0.0,
        attitude_repeat=float(np.sqrt(np.mean(attitudes**2))) if attitudes.size else None,
    )
    if joints is None or not np.isfinite(sure.covariance).all():
        return sure
    model, slides = found.arm_model, found.geometry.prismatic
    columns = [model.parameter_names.index(name) for name in sure.names]
    variance = np.diagonal(model.pose_covariance(columns, sure.covariance, joints, conditions), axis1=1, axis2=2)
    parts: dict[str, Any] = {}
    for first, local, within in zip((0, 3), LOCAL, WITHIN, strict=True):
        part = positions if first == 0 else attitudes
        if not part.size:
            continue
        squares = np.sum(part**2, axis=1)
        parts[local] = local_scatter(joints, squares, slides)
        parts[within] = within95(joints, squares, variance[:, first : first + 3].sum(axis=1), slides, blocks)
    return replace(sure, **parts)


def region_of(sure: PoseUncertainty, model: ArmModel, data: Observations) -> dict[str, Any]:
    """Where an arm was measured, for a calibration's record: some rows' joints, how far apart, how well told there.

    Args:
        sure: Uncertainty of the arm.
        model: The arm.
        data: The rows fitted.
    """
    told = sure.from_parameters(model, data.joints, data.conditions)
    joints = data.joints[equally_spaced(len(data.joints), ANCHORS)]
    places = joint_features(joints, model.geometry.prismatic)
    apart = np.asarray(KDTree(places).query(places, k=2)[0])[:, 1]
    return {
        "joints": np.round(joints, 4).tolist(),
        "near": max(ALIKE, SPACING * float(np.percentile(apart, 95))),
        "position_p95_m": float(np.percentile(told, 95)),
    }


def measured_there(
    record: Mapping[str, Any], sure: PoseUncertainty, model: ArmModel, joints: Array, conditions: Conditions
) -> NDArray[np.bool_]:
    """Which joints ``(N, n)`` lie where an arm was measured: rows were near, and the parameters tell the pose.

    Args:
        record: What `region_of` gave.
        sure: Uncertainty of the arm.
        model: The arm.
        joints: Joints, rad or m.
        conditions: Payload and temperature there.
    """
    slides = model.geometry.prismatic
    known = KDTree(joint_features(np.array(record["joints"]), slides))
    near = known.query(joint_features(joints, slides))[0] <= record["near"]
    told = sure.from_parameters(model, joints, conditions) <= VAGUE * record["position_p95_m"]
    return np.asarray(near & told)


def uncertainty_from(record: Mapping[str, Any]) -> PoseUncertainty | None:
    """The uncertainty that a calibration's record holds, or None if it holds none or no spare equations gave one."""
    kept = record.get("uncertainty")
    if not isinstance(kept, Mapping):
        return None
    covariance = np.array(kept["covariance"], dtype=float)
    if not np.isfinite(covariance).all():
        return None
    parts: dict[str, Any] = {name: LocalScatter.from_record(kept[name]) for name in LOCAL if name in kept}
    parts |= {name: Within95(**kept[name]) for name in WITHIN if name in kept}
    return PoseUncertainty(
        tuple(kept["parameters"]), covariance, float(kept["position_repeat_m"]), kept["attitude_repeat_rad"], **parts
    )
