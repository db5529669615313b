"""Episodes of policies on the same fruit, and their error fields: the data behind tables, films, recordings and pages.

`RecordedEpisodes` hold every moment of the episodes, or only their final states. A `Comparison` of policies on a
simulated arm holds error fields as well. Units: m, rad; mm and degrees if the name says so.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pickenv.arm import Array, Geometry, Plant, Pose, forward, inverse, noncompensable_error
from pickenv.base import InputError
from pickenv.calibration import random_joints
from pickenv.inspect.colours import Rgb, policy_colours, policy_key


@dataclass(frozen=True, eq=False)
class Reaches:
    """The final states of R episodes; vectors are in world axes.

    Attributes:
        seeds: Seed of each episode.
        pose_error: Error of the tool's true pose against the wanted pose at the fruit ``(R, 6)``, m and rad.
        noncompensable: The part of the pose error that no joint motion removes ``(R, 6)``, m and rad.
        success: Whether the fruit was inside the capture region ``(R,)``.
        joint_command: Joint command that the drives got at the end ``(R, n)``, rad or m.
        tool_position: The tool's true positions ``(R, 3)``, m.
        fruit_position: Fruit positions ``(R, 3)``, m.
    """

    seeds: tuple[int, ...]
    pose_error: Array
    noncompensable: Array
    success: NDArray[np.bool_]
    joint_command: Array
    tool_position: Array
    fruit_position: Array

    @property
    def position_error_mm(self) -> Array:
        """Final distances between tool and fruit ``(R,)``, mm."""
        return np.asarray(np.linalg.norm(self.pose_error[:, :3], axis=1) * 1e3)

    @property
    def attitude_error_deg(self) -> Array:
        """Final attitude errors ``(R,)``, degrees."""
        return np.asarray(np.degrees(np.linalg.norm(self.pose_error[:, 3:], axis=1)))


def reaches_of(geometry: Geometry, seeds: Sequence[int], infos: Mapping[str, Any]) -> Reaches:
    """Return the final states of R episodes from the `info` of their last steps.

    Args:
        geometry: The arm's true geometry.
        seeds: Seed of each episode.
        infos: The entries of `info` by name, each stacked over the episodes ``(R, ...)``.
    """
    names = ("pose_error", "joint_command", "tool_position", "fruit_position")
    columns = {name: np.array(infos[name], order="C") for name in names}
    return Reaches(
        seeds=tuple(seeds),
        noncompensable=noncompensable_error(geometry, columns["joint_command"], columns["pose_error"]),
        success=np.array(infos["is_success"]),
        **columns,
    )


MOMENTS = (
    *("joint_target", "joint_command", "tool_position", "tool_rotation", "fruit_position", "position_error_mm"),
    *("attitude_error_deg", "success", "picked", "miss_mm", "reward"),
)
"""Attributes of a `RecordedPolicy` with a value for each moment."""


@dataclass(frozen=True, eq=False)
class RecordedPolicy:
    """One policy's E episodes of at most T moments (recorded steps). The first moment is the reset.

    A shorter episode repeats its last moment. If only the final states of episodes are kept (`ended`), each episode has
    one moment.

    Attributes:
        label: Name for readers: raw, LS, LS+BPNN.
        key: Short name, which is used in entity paths and JSON and determines the policy's colour (`policy_colours`).
        moments: Number of moments of each episode ``(E,)``, T at most.
        joint_target: Joint values at which the controller believes the arm to be ``(E, T, n)``, rad or m. The nominal
            arm is drawn at these values. If the environment does not give them, they equal ``joint_command``. n is 0
            without an arm.
        joint_command: Joint command that the drives got ``(E, T, n)``, rad or m: ``joint_target`` after compensation.
        tool_position: The tool's true positions ``(E, T, 3)``, m.
        tool_rotation: The tool's true attitudes ``(E, T, 3, 3)``, rotation matrices; nan if unknown.
        fruit_position: Fruit positions ``(E, T, 3)``, m; of several fruit, the one that the tool aims for.
        position_error_mm: Distance between the tool's true position and the fruit ``(E, T)``.
        attitude_error_deg: Angle between the tool's true and wanted attitude ``(E, T)``; nan if unknown.
        success: Whether the environment reports success ``(E, T)``.
        picked: Number of fruit taken in the episode so far ``(E, T)``; a reach takes its fruit at the last moment.
        miss_mm: Distance between tool and fruit at moments when the gripper closes ``(E, T)``; nan at all others. In a
            reach the gripper closes at the last moment.
        reward: Reward of each step ``(E, T)``; 0 at the reset and after the end.
        field_errors: True minus wanted tool position at the points of a comparison's grid ``(F, 3)``, m, world axes.
        field_attitude: Attitude error, true against wanted, at the points of the grid ``(F, 3)``, as rotation vectors
            in world axes, rad; None if only positions are known.
    """

    label: str
    key: str
    moments: NDArray[np.int64]
    joint_target: Array
    joint_command: Array
    tool_position: Array
    tool_rotation: Array
    fruit_position: Array
    position_error_mm: Array
    attitude_error_deg: Array
    success: NDArray[np.bool_]
    picked: NDArray[np.int64]
    miss_mm: Array
    reward: Array
    field_errors: Array = field(default_factory=lambda: np.empty((0, 3)))
    field_attitude: Array | None = None

    @property
    def ends(self) -> RecordedPolicy:
        """Copy with only each episode's last moment: attributes in `MOMENTS` are ``(E, ...)``, not ``(E, T, ...)``."""
        rows = np.arange(len(self.moments)), self.moments - 1
        return replace(self, **{name: getattr(self, name)[rows] for name in MOMENTS})

    def with_field(self, errors: Array) -> RecordedPolicy:
        """Return this policy with an error field.

        Args:
            errors: Errors of true against wanted poses ``(F, 6)``, m and rad, or of positions alone ``(F, 3)``, m.
        """
        return replace(self, field_errors=errors[:, :3], field_attitude=errors[:, 3:] if errors.shape[1] == 6 else None)


def ended(label: str, reaches: Reaches, key: str | None = None) -> RecordedPolicy:
    """Return a recorded policy made from the final states of its episodes alone.

    Args:
        label: Name of the policy for readers.
        reaches: The final states of its episodes.
        key: Short name of the policy; made from the label when left out.
    """
    count = len(reaches.success)
    names = ("joint_command", "tool_position", "fruit_position", "position_error_mm", "attitude_error_deg", "success")
    ends: dict[str, Any] = {name: getattr(reaches, name) for name in names} | {
        "joint_target": reaches.joint_command,
        "tool_rotation": np.full((count, 3, 3), np.nan),
        "picked": reaches.success.astype(np.int64),
        "miss_mm": reaches.position_error_mm,
        "reward": np.zeros(count),
    }
    moments = {name: values[:, None] for name, values in ends.items()}
    return RecordedPolicy(label, key or policy_key(label), np.ones(count, dtype=np.int64), **moments)


@dataclass(frozen=True, eq=False, kw_only=True)
class RecordedEpisodes:
    """The episodes of several policies, with the same seeds and fruit.

    Attributes:
        policies: One entry per policy, in this order: without calibration (raw), with least squares (LS), with a neural
            network in addition (LS+BPNN), then all others.
        plant: The true arm that was simulated; None if the environment has no plant. Pictures show the arm by
            `joint_command` and `tool_position` (`pickenv.arm.true_points`).
        tolerance_mm: Tolerance of the gripper. For a suction cup, it is the lateral distance from the tool up to which
            the fruit is always taken. For another gripper, it is the distance at which the fruit is taken one time in
            two.
        seed: Seed of the comparison.
        seeds: Seed of each episode, the same for all policies.
        env_id: The environment's id for `gymnasium.make`; empty if only final states are kept.
        gripper: Name of the gripper by which picks are judged; empty if only final states are kept.
        period: Time between two moments, s; 0 if only final states are kept.
    """

    policies: tuple[RecordedPolicy, ...]
    plant: Plant | None
    tolerance_mm: float
    seed: int
    seeds: tuple[int, ...] = ()
    env_id: str = ""
    gripper: str = ""
    period: float = 0.0

    @property
    def plant_name(self) -> str:
        """Name of the plant; empty if the environment has none."""
        return "" if self.plant is None else self.plant.name

    @property
    def nominal(self) -> Geometry | None:
        """Nominal geometry of the arm, which its controller uses; None if the environment has no arm."""
        return None if self.plant is None else self.plant.arm.nominal

    @property
    def colours(self) -> list[Rgb]:
        """The colour of each policy, in the order of `policies`."""
        return policy_colours([policy.key for policy in self.policies])

    @property
    def largest_mm(self) -> float:
        """The largest distance between tool and fruit at the end of an episode, mm."""
        return max(float(policy.ends.position_error_mm.max()) for policy in self.policies)

    @property
    def fruit(self) -> Array:
        """Fruit positions at the episodes' ends ``(E, 3)``, m."""
        return self.policies[0].ends.fruit_position


UPRIGHT = np.radians(30.0)
"""Largest angle from the vertical of the tool poses that set the extent of a grid, rad."""


@dataclass(frozen=True, eq=False)
class FieldGrid:
    """A regular grid of upright tool poses, and the cells of the grid that the nominal arm reaches.

    Attributes:
        shape: Number of cells (nx, ny, nz).
        origin: Centre of the first cell, m, ``(3,)``.
        step: Cell size, m.
        index: Indices, from 0 along x, y and z, of each reached cell ``(F, 3)``.
        points: Centres of the reached cells ``(F, 3)``, m.
        joints: Joint values that bring the nominal arm's tool upright to each centre ``(F, n)``, rad or m.
    """

    shape: tuple[int, ...]
    origin: Array
    step: float
    index: NDArray[np.int64]
    points: Array
    joints: Array

    @property
    def corner(self) -> Array:
        """Lowest corner of the first cell ``(3,)``, m."""
        return self.origin - self.step / 2.0

    @property
    def size(self) -> Array:
        """Size of the whole grid ``(3,)``, m."""
        return np.asarray(self.shape) * self.step


@dataclass(frozen=True, eq=False, kw_only=True)
class Comparison(RecordedEpisodes):
    """Several policies on the same simulated arm, with their errors over a field of poses.

    The first policy has no calibration (raw).

    Attributes:
        plant: The true arm that was simulated.
        grid: The grid of the field's points.
        field_uncertainty: Standard uncertainty of the calibrated tool position ``(F,)``, m, as the calibration predicts
            it; None if the calibration predicts none.
    """

    plant: Plant
    grid: FieldGrid
    field_uncertainty: Array | None = None

    @property
    def nominal(self) -> Geometry:
        """Nominal geometry of the arm, which its controller uses."""
        return self.plant.arm.nominal


def field_grid(nominal: Geometry, step: float, seed: int) -> FieldGrid:
    """Return a grid of upright tool poses over the workspace of an arm.

    Args:
        nominal: Nominal geometry of the arm.
        step: Cell size, m.
        seed: Seed of the random joint values from which the workspace's extent is estimated.
    """
    probe = forward(nominal, random_joints(nominal, 4000, np.random.default_rng(seed)))
    upright = probe.rotation[:, 2, 2] > np.cos(UPRIGHT)
    low, high = np.percentile(probe.position[upright], [1, 99], axis=0)
    shape = np.maximum(((high - low) / step).astype(int), 1)
    index = np.stack(np.meshgrid(*(np.arange(count) for count in shape), indexing="ij"), -1).reshape(-1, 3)
    origin = (low + high) / 2 - (shape - 1) / 2 * step
    points = origin + index * step
    solution = inverse(nominal, Pose(points, np.eye(3)), restarts=1)
    inside = solution.reached
    return FieldGrid(tuple(shape.tolist()), origin, step, index[inside], points[inside], solution.joints[inside])


POSITIONS = ("tool_position", "fruit_position")
"""Entries of `info` needed to draw and compare an environment: three finite numbers each, m, in one frame."""


def missing_positions(info: Mapping[str, Any]) -> str:
    """Return a sentence that says which `POSITIONS` `info` lacks and what to do; empty if it has both.

    Raises:
        InputError: If an entry is there but is not three finite numbers.
    """
    for name in POSITIONS:
        if name in info:
            value = np.asarray(info[name])
            if value.shape != (3,) or value.dtype.kind not in "fiu" or not np.isfinite(value).all():
                raise InputError(f"info['{name}'] is {info[name]!r}; give three finite numbers in m")
    absent = [f"'{name}'" for name in POSITIONS if name not in info]
    if not absent:
        return ""
    return f"its info lacks {' and '.join(absent)}; let the environment give both, three numbers in m, at every step"


def believed_joints(env: Any) -> Array | None:
    """Return a copy of the joint values ``(n,)`` at which an environment's controller believes the arm to be, rad or m.

    Return None if the environment does not have them.
    """
    target = getattr(env.unwrapped, "joint_target", None)
    return None if target is None else np.array(target, dtype=float)
