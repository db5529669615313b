"""Measurements of an arm: joint displacements and what an instrument saw of the tool, with units and uncertainty.

Our own CSV files name every column with its unit: q1_deg, q2_mm, …, x_mm, y_mm, z_mm and, for full poses, the rotation
vector rx_deg, ry_deg, rz_deg. Foreign files are read through a column description (`pickenv.calibration.reading.read`).
"""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pickenv.arm import Geometry, Plant, Pose, pose_error, rotation_vector
from pickenv.arm.kinematics.geometry import Array
from pickenv.arm.plant.campaign import TRACKER, Instrument, NormalDraws, load_instrument, measured_poses, normal_draws
from pickenv.calibration.model.arm_model import ArmModel, Conditions
from pickenv.calibration.model.observations import OneGroup, Origins, Rows, hash_of
from pickenv.errors import InputError
from pickenv.files import write_whole

POSITION_STD = 15e-6
"""Standard uncertainty of a position when a file states none, m: a laser tracker at a few metres."""

ATTITUDE_STD = 2e-4
"""Standard uncertainty of an attitude when a file states none, rad: a 100 mm reflector triad."""


Frames = Literal["known", "fitted"]
"""Whether an instrument measures the arm's own tool in its own base frame, or base and tool must be fitted."""

FRAMES: tuple[Frames, ...] = get_args(Frames)

FRAMES_COLUMN = "frames"
"""Column of our own CSV format that says so, in every row."""


@dataclass(frozen=True, eq=False)
class Measurements(OneGroup):
    """A data set: N poses of an arm with n joints; the commonest of `Observations`.

    Attributes:
        joints: Commanded joint displacements ``(N, n)``, rad or m.
        position: Measured tool positions ``(N, 3)``, m, in the instrument's frame.
        rotation: Measured tool rotations ``(N, 3, 3)``, or None where only positions were measured.
        prismatic: Joint types, which fix the unit of each joint column.
        position_std: Standard uncertainty of one position coordinate, m.
        attitude_std: Standard uncertainty of one attitude coordinate, rad.
        source: Where the data come from, as messages name it.
        conditions: Payload, temperature and torques of each pose, where known.
        origins: File and line of each row; None where they come from no file.
        frames: "known" if these are poses of the arm's own tool in its own base frame; "fitted" if the instrument
            stood anywhere and saw a target anywhere on the tool.
        std_stated: Whether somebody stated the uncertainties, or the defaults are assumed.
    """

    joints: Array
    position: Array
    rotation: Array | None
    prismatic: tuple[bool, ...]
    position_std: float = POSITION_STD
    attitude_std: float = ATTITUDE_STD
    source: str = "measurements"
    conditions: Conditions = field(default_factory=Conditions)
    origins: Origins | None = None
    frames: Frames = "fitted"
    std_stated: bool = False
    framed = True
    per_row = ("position", "rotation")

    def __len__(self) -> int:
        """Number of poses."""
        return len(self.joints)

    @property
    def kind(self) -> str:
        """What was measured: "pose" or "position"."""
        return "position" if self.rotation is None else "pose"

    @property
    def rows_per_pose(self) -> int:
        """Number of scalar observations per pose: 6 for poses, 3 for positions."""
        return 3 if self.rotation is None else 6

    @property
    def row_weights(self) -> Array:
        """One over the standard uncertainty of each row of a pose."""
        return np.asarray(1.0 / np.repeat([self.position_std, self.attitude_std], 3)[: self.rows_per_pose])

    def difference(self, model: Geometry | ArmModel) -> Array:
        """Measured minus predicted pose ``(N, rows_per_pose)``: m, and rad (rotation vector), the instrument's axes."""
        predicted = ArmModel.of(model).pose(self.joints, self.conditions)
        if self.rotation is None:
            return np.asarray(self.position - predicted.position)
        return pose_error(predicted, Pose(self.position, self.rotation))

    def residual(self, model: ArmModel, unknowns: Array) -> Array:
        """Measured minus predicted pose, in standard uncertainties."""
        return np.asarray((self.difference(model) * self.row_weights).ravel())

    def jacobian(self, model: ArmModel, unknowns: Array) -> tuple[Array, Array]:
        """Eq (8), stacked and weighted."""
        jacobian = model.jacobian(self.joints, self.conditions)[:, : self.rows_per_pose] * self.row_weights[:, None]
        flat = jacobian.reshape(-1, jacobian.shape[-1])
        return flat, np.zeros((len(flat), 0))

    def misses(self, model: ArmModel, unknowns: Array) -> Array:
        """Measured minus predicted positions."""
        return self.difference(model)[:, :3]

    def equations(self) -> tuple[Rows, Rows]:
        """Positions are one channel, attitudes another."""
        channels = np.repeat([0, 1], 3)[: self.rows_per_pose]
        return np.repeat(np.arange(len(self)), self.rows_per_pose), np.tile(channels, len(self))

    def readings(self) -> Array:
        """The measured positions."""
        return self.position

    def imagined(self, joints: Array) -> Measurements:
        """What such an instrument would be asked at other joints ``(M, n)``; only kind and uncertainties are real."""
        rotation = None if self.rotation is None else np.broadcast_to(np.eye(3), (len(joints), 3, 3))
        blank = np.zeros((len(joints), 3))
        return replace(self, joints=joints, position=blank, rotation=rotation, conditions=Conditions(), origins=None)

    def positions_only(self) -> Measurements:
        """The same data set without attitudes."""
        return replace(self, rotation=None)

    def fingerprint(self) -> str:
        """Of joints, positions and attitudes."""
        return hash_of(self.joints, self.position, *([] if self.rotation is None else [self.rotation]))

    def table(self) -> tuple[list[str], Array]:
        """Column names with units, and the values in those units, one row per pose."""
        names = joint_columns(self.prismatic)
        scale = np.where(self.prismatic, 1e3, np.degrees(1.0))
        columns = [self.joints * scale, self.position * 1e3]
        names += ["x_mm", "y_mm", "z_mm"]
        if self.rotation is not None:
            names += ["rx_deg", "ry_deg", "rz_deg"]
            columns.append(np.degrees(rotation_vector(self.rotation)))
        return names, np.concatenate(columns, axis=1)

    def write_csv(self, path: str | Path) -> Path:
        """Write our own CSV format, whole or not at all; `reading.read.read_measurements` reads it back.

        Where the frames are known, a last column says so in every row.
        """
        names, values = self.table()
        if self.frames == "fitted":
            return write_table(path, names, values)
        known = np.full((len(self), 1), self.frames, dtype=object)
        return write_table(path, [*names, FRAMES_COLUMN], np.concatenate([values.astype(object), known], axis=1))


def joint_columns(prismatic: Sequence[bool]) -> list[str]:
    """Names of the joint columns of our own CSV format."""
    return [f"q{i + 1}_{'mm' if slides else 'deg'}" for i, slides in enumerate(prismatic)]


def write_table(path: str | Path, names: list[str], values: Array | NDArray[np.object_]) -> Path:
    """Write a CSV file with a header; numbers keep all their digits."""

    def write(temporary: Path) -> None:
        with temporary.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow(names)
            writer.writerows(values.tolist())

    return write_whole(path, write)


def write_joints(path: str | Path, joints: Array, prismatic: tuple[bool, ...]) -> Path:
    """Write joints ``(N, n)`` as our own CSV columns (q1_deg, q2_mm, …)."""
    return write_table(path, joint_columns(prismatic), joints * np.where(prismatic, 1e3, np.degrees(1.0)))


def random_joints(geometry: Geometry, count: int, rng: np.random.Generator) -> Array:
    """Joints ``(count, n)`` drawn evenly from the whole joint ranges, as in the paper's protocol."""
    return rng.uniform(geometry.lower, geometry.upper, (count, geometry.joints))


def simulated_tracker(
    plant: Plant, joints: ArrayLike, rng: np.random.Generator, instrument: Instrument | str = TRACKER
) -> Measurements:
    """What an instrument, registered to base and tool, sees of the arm that visits ``joints`` one after another.

    One call is one campaign: the machine is switched on, warms up, drives from pose to pose and waits before each
    reading; the target is mounted once. "ideal" waits for ever at each pose.

    Args:
        plant: The arm.
        joints: Joint commands ``(N, n)`` in their order, rad or m.
        rng: Draws the readings' errors, and by a child the friction of each stop and the target's mounting.
        instrument: One of `pickenv.arm.shipped_instruments`, a path to a file, or an `Instrument`.

    Raises:
        InputError: If joints have another shape or are not finite, or the instrument is unknown.
    """
    joints = np.asarray(joints, dtype=float)
    if joints.ndim != 2 or joints.shape[1] != plant.geometry.joints:
        raise InputError(f"joints have shape {joints.shape}; give (N, {plant.geometry.joints}), one row per pose")
    if not np.isfinite(joints).all():
        row = int(np.argmin(np.isfinite(joints).all(axis=1)))
        raise InputError(f"the joints of pose {row} are {joints[row].tolist()}; give finite ones, rad or m")
    chosen = instrument if isinstance(instrument, Instrument) else load_instrument(instrument)
    return tracked(plant, chosen, joints, normal_draws(plant, len(joints), rng))


def tracked(plant: Plant, instrument: Instrument, joints: Array, draws: NormalDraws) -> Measurements:
    """What an instrument sees of the arm that visits ``joints`` ``(N, n)``, with these draws."""
    pose, noise = measured_poses(plant, joints, instrument, draws), instrument.noise_on(plant)
    std = attitude_std = 0.0
    if noise is not None:
        ranges = np.linalg.norm(pose.position - instrument.stand, axis=-1)
        std, attitude_std = noise.position_std_at(float(ranges.mean()) if len(joints) else 0.0), noise.attitude_std
    return Measurements(
        joints=joints,
        position=pose.position,
        rotation=pose.rotation,
        prismatic=plant.geometry.prismatic,
        position_std=std or POSITION_STD,
        attitude_std=attitude_std or ATTITUDE_STD,
        source=f"simulated {instrument.name.replace('_', ' ')} on plant {plant.name}",
        frames="known",
        std_stated=noise is not None,
    )
