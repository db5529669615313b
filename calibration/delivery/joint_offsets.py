"""The part of a calibration that joint offsets can hold, and what they leave out.

Controllers and servos often take one number per joint: what its reading is off by. The offsets that bring the nominal
arm nearest to the calibrated one, over the region where it was measured, are found by least squares: pose differences
in m and rad weigh alike, and where positions alone were measured, positions alone count. What offsets cannot do is
stated in mm. With fitted base and tool, what a base or tool can do as well is left to them (of a turning first joint,
all of it), as these data cannot tell them apart. SI units.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

from pickenv.arm import forward, joint_jacobian, parameter_jacobian, pose_error
from pickenv.arm.kinematics.geometry import Array
from pickenv.calibration.model.error_model import frames_model
from pickenv.calibration.pipeline.calibration import Calibration
from pickenv.calibration.pipeline.uncertainty import uncertainty_from
from pickenv.errors import InputError

STEPS = 6
"""Gauss-Newton steps; offsets of a few degrees need three."""

LOST = 1e-6
"""Offsets whose effect is this much smaller than the largest are not told by any pose."""

SPREAD = 256
"""Poses compared where none are given."""


@dataclass(frozen=True, eq=False)
class JointOffsets:
    """What each joint's reading lacks: the arm stands at reading plus offset.

    Attributes:
        names: Of the joints.
        slides: Whether each slides.
        offsets: rad or m (n,).
        told: Whether the data tell the offset; else it is zero (n,).
        deviation: Standard deviations of the offsets (n,), NaN where the calibration knows none.
        without: Mean position difference between nominal and calibrated arm over the poses, m.
        left: The same with the offsets, m: what a file of offsets leaves out.
        left_turn: Mean attitude difference that they leave, rad; None where only positions were measured.
        poses: Poses compared.
        region: Which poses they are, for people.
    """

    names: tuple[str, ...]
    slides: tuple[bool, ...]
    offsets: Array
    told: NDArray[np.bool_]
    deviation: Array
    without: float
    left: float
    left_turn: float | None
    poses: int
    region: str

    def note(self) -> str:
        """What offsets do and what they leave out, for people."""
        turn = "" if self.left_turn is None else f" and {np.degrees(self.left_turn):.3g} deg"
        free = [name for name, told in zip(self.names, self.told, strict=True) if not told]
        untold = f"; of {', '.join(free)} these data tell none" if free else ""
        return (
            f"joint offsets alone: over {self.poses} {self.region} the nominal arm lies {self.without * 1e3:.3g} mm "
            f"from the calibrated one, with these offsets {self.left * 1e3:.3g} mm{turn} (means); the rest of the "
            f"calibration is left out{untold}"
        )


def joint_offsets(calibration: Calibration, joints: Array | None = None) -> JointOffsets:
    """The joint offsets nearest to a calibration.

    Args:
        calibration: Of any arm.
        joints: Poses to be near at ``(N, n)``; when left out, poses that fill the joint ranges measured, or the joint
            limits where the calibration keeps no ranges.

    Raises:
        InputError: If its terms need payloads, temperatures or torques, which no offset depends on.
    """
    region = "poses given"
    if joints is None:
        joints, region = _filling(calibration)
    try:
        target = calibration.predict(joints)
    except InputError as error:
        raise InputError(
            f"offsets cannot follow this calibration's terms: {error}; calibrate with --terms none"
        ) from error
    model = frames_model(calibration.arm)
    fitted = calibration.record.get("frames") == "fitted"
    rows = slice(0, 3 if calibration.record.get("kind") == "position" else 6)
    nominal = calibration.nominal
    offsets = np.zeros(nominal.joints)
    without = np.linalg.norm(pose_error(forward(nominal, joints), target)[:, :3], axis=1).mean()
    for _ in range(STEPS):
        missed = pose_error(forward(nominal, joints + offsets), target)[:, rows].ravel()
        effect = _flat(joint_jacobian(nominal, joints + offsets)[:, rows])
        frames = _flat(parameter_jacobian(nominal, joints + offsets)[:, rows, model.columns]) if fitted else None
        way = _told(effect, frames)
        step = way @ missed
        offsets = offsets + step
        if frames is not None:
            moved = np.zeros(len(nominal.parameter_names))
            moved[model.columns] = np.linalg.lstsq(frames, missed - effect @ step, rcond=LOST)[0]
            nominal = nominal.displaced(moved)
    left = pose_error(forward(nominal, joints + offsets), target)
    return JointOffsets(
        calibration.arm.joint_names,
        calibration.arm.prismatic,
        offsets,
        np.asarray(way.any(axis=1)),
        _deviation(calibration, joints, rows, fitted),
        float(without),
        float(np.linalg.norm(left[:, :3], axis=1).mean()),
        None if rows.stop == 3 else float(np.linalg.norm(left[:, 3:], axis=1).mean()),
        len(joints),
        region,
    )


def _flat(jacobian: Array) -> Array:
    return jacobian.reshape(-1, jacobian.shape[-1])


def _told(effect: Array, frames: Array | None) -> Array:
    """The matrix from pose differences to offsets: what frames can do as well is theirs."""
    if frames is not None:
        whole = np.linalg.svd(frames, full_matrices=False)
        basis = whole.U[:, np.flatnonzero(LOST * whole.S[0] < whole.S)]
        effect = effect - basis @ (basis.T @ effect)
    size = np.linalg.norm(effect, axis=0)
    told = size > LOST * size.max()
    found = np.zeros(effect.T.shape)
    found[told] = np.linalg.pinv(effect[:, told], rcond=LOST)
    return found


def _deviation(calibration: Calibration, joints: Array, rows: slice, fitted: bool) -> Array:
    """Standard deviations of the offsets, from those of the identified parameters."""
    sure = uncertainty_from(calibration.record)
    if sure is None:
        return np.full(calibration.arm.joints, np.nan)
    nominal, model = calibration.nominal, frames_model(calibration.arm)
    whole = parameter_jacobian(nominal, joints)[:, rows]
    columns = [nominal.parameter_names.index(name) for name in sure.names if name in nominal.parameter_names]
    kept = [i for i, name in enumerate(sure.names) if name in nominal.parameter_names]
    frames = _flat(whole[..., model.columns]) if fitted else None
    way = _told(_flat(joint_jacobian(nominal, joints)[:, rows]), frames) @ _flat(whole[..., columns])
    covariance = sure.covariance[np.ix_(kept, kept)]
    variance = np.einsum("ij,jk,ik->i", way, covariance, way)
    return np.where(way.any(axis=1), np.sqrt(variance), np.nan)


def _filling(calibration: Calibration) -> tuple[Array, str]:
    """Poses that fill what was measured evenly, always the same ones, and what they fill."""
    arm = calibration.arm
    kept = calibration.record.get("joint_ranges")
    low, high = (arm.lower, arm.upper) if kept is None else np.array(kept, dtype=float)
    half = (high - low) / 2
    half = np.where(arm.prismatic, half, np.minimum(half, np.pi))  # a turn at most
    unit = qmc.Halton(arm.joints, scramble=False).random(SPREAD + 1)[1:]
    joints = (low + high) / 2 + half * (2.0 * unit - 1.0)
    return np.asarray(joints), "poses within the joint limits" if kept is None else "poses within the ranges measured"
