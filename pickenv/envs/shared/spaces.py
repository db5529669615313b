"""Observation and action spaces of the reach environments, their scaling, and the options of `reset`.

With the scaling a policy learns to reach within a millimetre. The gap is the fruit's pose minus the tool's pose. A
network that reads the gap in metres hardly notices millimetres, and the noise of its actions hides them. Here the
network sees the gap as a direction of about unit length and the logarithm of its size. Near the fruit, actions are
multiplied by the size of the gap. So a behaviour learnt at decimetres also works at micrometres. The formulas run on
NumPy and on torch.
"""

from __future__ import annotations

import copy
import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import PurePath
from typing import Any, ClassVar

import numpy as np
from gymnasium import spaces
from gymnasium.envs.registration import EnvSpec
from numpy.typing import NDArray

from pickenv.arm import Array, Geometry, Pose, forward, frame_of, inverse, rotation_matrix
from pickenv.arm.kinematics.inverse import halton_joints
from pickenv.base import InputError, shown
from pickenv.envs.shared.simulation import GOAL_NUMBERS, goal_gap
from pickenv.envs.shared.task import MOST_ACTION, Task, as_numbers

# A specification that can be written down: paths among an environment's arguments stand in it as text.


class PlainSpec:
    """Base class of environments whose `spec.to_json()` works with path objects among the arguments."""

    _spec: EnvSpec | None = None

    @property
    def spec(self) -> EnvSpec | None:
        """The specification that the environment was made from, with paths as strings."""
        return self._spec

    @spec.setter
    def spec(self, spec: EnvSpec | None) -> None:
        if spec is not None:
            spec = copy.copy(spec)
            spec.kwargs = spec.kwargs | {key: str(p) for key, p in spec.kwargs.items() if isinstance(p, PurePath)}
        self._spec = spec


GOAL_ROWS = {"goal_position": (3, "x, y, z in m"), "goal_pose": (6, "x, y, z in m and a rotation vector in rad")}
GOALS = ("goal_joints", *GOAL_ROWS)
OPTIONS = ("start_joints", *GOALS, "arm")


def flat_space(task: Task) -> spaces.Box:
    """Return the space of the flat observation of `pickenv/Reach-v0`."""
    reach, camera = task.reach, [2 * task.reach] * 3 if task.camera else []
    return box([1.0] * task.joints + [reach] * 6 + [2 * reach] * 3 + [math.pi] * 3 + camera)


def goal_space(task: Task) -> spaces.Dict:
    """Return the space of the goal observation of `pickenv/ReachGoal-v0`."""
    reach = task.reach
    return spaces.Dict(
        {
            "observation": box([1.0] * task.joints + [reach] * 3),
            "achieved_goal": box([3 * reach if task.camera else reach] * 3 + [1.0] * 6),
            "desired_goal": box([reach] * 3 + [1.0] * 6),
        }
    )


def action_space(task: Task) -> spaces.Box:
    """Return the space of actions: increments of the joints or of the tool, then the gripper's command, if any."""
    return spaces.Box(-1.0, 1.0, (task.actions,), dtype=np.float32)


def box(high: Sequence[float]) -> spaces.Box:
    """Return the float32 box from -``high`` to ``high``, rounded outwards, so that the bounds themselves are inside."""
    bound = np.array(high, dtype=np.float32)
    bound = np.where(bound < np.array(high), np.nextafter(bound, np.float32(np.inf)), bound)
    return spaces.Box(-bound, bound, dtype=np.float32)


def given_options(options: Any, allowed: tuple[str, ...] = OPTIONS) -> dict[str, Any]:
    """Check the options of `reset`, and return them as a dict, which is empty if ``options`` is None.

    Raises:
        InputError: If ``options`` is no mapping, or has a name that is not in ``allowed``.
    """
    names = ", ".join(allowed)
    if options is None:
        return {}
    if not isinstance(options, Mapping):
        raise InputError(f"options is {options!r}; give a dict{f' of {names}' if names else ', an empty one'}")
    unknown = sorted(str(option) for option in set(options) - set(allowed))
    if unknown:
        raise InputError(f"unknown reset option '{unknown[0]}'; {f'give {names}' if names else 'there is none'}")
    return dict(options)


# Goals that `reset` is asked for: by joints, by position, or by pose. Base frame, m and rad.


POOL, NEAREST = 2**14, 16


def given_goals(task: Task, options: Mapping[str, Any], count: int | None = None) -> tuple[Array | None, Array | None]:
    """Return the goals that the options of `reset` give.

    Args:
        task: The task.
        options: The options; of `GOALS` at most one may be given.
        count: Number of environments, or None for a single one.

    Returns:
        Joints of the nominal arm at the goal ``(..., n)``, and frames of the goal ``(..., 12)``, axes and origin. One
        of the two is None, or both if no goal is given.

    Raises:
        InputError: If more than one option gives a goal, a shape is wrong, or the nominal arm cannot get to a position.
    """
    names = [name for name in GOALS if options.get(name) is not None]
    if len(names) > 1:
        raise InputError(f"options {' and '.join(names)} both say where the goal is; give one of them")
    if not names:
        return None, None
    (name,) = names
    if name == "goal_joints":
        return task.given_joints(name, options[name], count), None
    width, columns = GOAL_ROWS[name]
    rows = as_numbers(f"option {name}", options[name])
    shapes = [(width,)] if count is None else [(width,), (count, width)]
    if rows.shape not in shapes:
        raise InputError(f"option {name} has shape {rows.shape}; give {' or '.join(map(str, shapes))}: {columns}")
    if not np.isfinite(rows).all():
        raise InputError(f"option {name} is {shown(rows.tolist())}; give finite numbers: {columns}")
    goals = np.array([_reached(task, row) if width == 3 else _framed(task, row) for row in np.atleast_2d(rows)])
    goals = goals[0] if count is None else np.broadcast_to(goals, (count, goals.shape[1]))
    return (goals, None) if width == 3 else (None, goals)


def _reached(task: Task, position: Array) -> Array:
    """Find joints ``(n,)``, rad or m, that bring the nominal tool to a position ``(3,)``, m.

    The tool's axis is at most the task's largest tilt away from the vertical. Inverse kinematics starts from the
    `NEAREST` sampled poses nearest to the position.
    """
    geometry = task.plant.arm.nominal
    joints, poses = spread_poses(geometry)
    upright = np.flatnonzero(poses.rotation[:, 2, 2] >= task.min_upright)
    away = np.linalg.norm(poses.position[upright] - position, axis=1)
    near = upright[np.argsort(away, kind="stable")[:NEAREST]]
    targets = Pose(np.broadcast_to(position, (len(near), 3)), poses.rotation[near])
    solution = inverse(geometry, targets, joints[near], position_tolerance=1e-9, attitude_tolerance=np.inf, restarts=0)
    fits = solution.reached & (forward(geometry, solution.joints).rotation[:, 2, 2] >= task.min_upright)
    if not fits.any():
        tilt = np.degrees(np.arccos(task.min_upright))
        raise _far("goal_position", task, position, f" with its tool within {tilt:.0f} deg of the vertical")
    return np.asarray(solution.joints[np.argmax(fits)])


def _framed(task: Task, pose: Array) -> Array:
    """Return the frame ``(12,)`` of a pose ``(6,)``: position, m, and rotation vector, rad.

    The nominal arm must reach the position, but not the attitude.
    """
    position, rotation = pose[:3], rotation_matrix(pose[3:])
    solution = inverse(task.plant.arm.nominal, Pose(position, rotation), position_tolerance=1e-6, position_only=True)
    if not solution.reached:
        raise _far("goal_pose", task, position)
    return np.array(frame_of(Pose(position, rotation)))


def _far(name: str, task: Task, position: Array, how: str = "") -> InputError:
    place = np.round(position, 4).tolist()
    return InputError(f"option {name}: arm '{task.plant.arm.name}' does not reach {place} m{how}; move the goal")


@lru_cache(maxsize=4)
def spread_poses(geometry: Geometry) -> tuple[Array, Pose]:
    """Return joints ``(POOL, n)`` from a Halton sequence over their ranges, and the nominal tool's poses there."""
    joints = halton_joints(geometry, POOL)
    return joints, forward(geometry, joints)


class Rescaling(ABC):
    """Formulas that turn an environment's observations into a policy's, and a policy's actions into the environment's.

    Attributes:
        inputs: Count of numbers in the environment's observation.
        features: Count of numbers that the policy sees.
        space: Space of the observations that the policy sees.
        answers: Space of the policy's actions; None if it is the environment's action space.
        home: Part of an error message: what must be the same as in the policy's training, such as "the feedback and
            the arm".
    """

    inputs: Any
    features: Any
    space: Any
    answers: Any = None
    home: ClassVar[str]

    def check(self, width: int, scaled: bool = False) -> None:
        """Check the length of observations.

        Args:
            width: Count of numbers in an observation.
            scaled: Whether the observations are results of `observe`, and must have `features` numbers instead of
                `inputs`.

        Raises:
            InputError: If ``width`` differs from `inputs`, or from `features` if ``scaled``.
        """
        trained, home = (self.features, "the environment") if scaled else (self.inputs, self.home)
        if width != trained:
            raise InputError(
                f"the policy was trained on observations of {trained} numbers, but the environment gives {width}; "
                f"use {home} of its training"
            )

    def shown(self, values: NDArray[Any]) -> NDArray[np.float32]:
        """Return the result of `observe` as a NumPy array of float32, as environments do."""
        return np.asarray(self.observe(values, np), dtype=np.float32)

    @abstractmethod
    def observe(self, values: Any, xp: Any) -> Any:
        """Compute the policy's observations ``(..., features)``.

        Args:
            values: The environment's observations ``(..., inputs)``.
            xp: The module numpy or torch.
        """

    @abstractmethod
    def act(self, values: NDArray[Any], actions: Any, most: float = MOST_ACTION["clip"]) -> NDArray[Any]:
        """Compute the environment's actions from a policy's actions.

        Invalid actions are passed on, so that the environment raises the error.

        Args:
            values: The environment's observations ``(..., inputs)``.
            actions: The policy's actions.
            most: Largest magnitude of a number that the environment accepts.
        """

    @abstractmethod
    def potential(self, values: NDArray[Any]) -> Any:
        """Compute a potential ``(...)`` for reward shaping, which grows towards the task's goal.

        ``values`` are the environment's observations ``(..., inputs)``.
        """


@dataclass(frozen=True)
class Scaling(Rescaling):
    """The scaling of the gap in a reach task. It holds the layout of observations and the gaps that count as near.

    Attributes:
        joints: Number of joints n.
        camera: Whether the flat observation ends with the position gap that the camera measures.
        goal: Whether observations are joined goal observations, see `joined_observation`.
        actions: Whether actions shrink with the gap; if not, only the observation changes.
        near: Position gap below which actions shrink in proportion to it, m.
        near_turn: Attitude gap below which actions shrink in proportion to it, rad.
        tool: Count of the numbers of an action that moves the tool: 6, or 3 without attitude. It is 0 if actions
            move joints. A network that moves the tool does not see the joints.
        SMALLEST: Smallest size of a gap, as a share of `near` and `near_turn`; smaller gaps count as this size.
        ROUNDING: Margin for rounding in the bounds of observed numbers whose magnitude is at most one.
    """

    SMALLEST, ROUNDING = 1e-6, 1e-3

    joints: int
    camera: bool = False
    goal: bool = False
    actions: bool = True
    near: float = 0.1
    near_turn: float = 0.2
    tool: int = 0
    home = "the feedback and the arm"

    @property
    def inputs(self) -> int:
        """Count of numbers in the environment's observation."""
        return self.joints + (3 + 2 * GOAL_NUMBERS if self.goal else 15 if self.camera else 12)

    @property
    def features(self) -> int:
        """Count of numbers in a network's observation."""
        return (self.tool or self.joints + 6) + 1

    @property
    def space(self) -> spaces.Box:
        """Space of the observations that the networks see."""
        joints, gaps = ([], self.tool) if self.tool else ([1.0] * self.joints, 6)
        high = [*joints, *[1.0 + self.ROUNDING] * gaps, -math.log10(self.SMALLEST) / 2.0]
        return spaces.Box(-np.array(high, np.float32), np.array(high, np.float32), dtype=np.float32)

    @property
    def outputs(self) -> int:
        """Count of numbers in a network's action."""
        return self.tool or self.joints

    def gap(self, values: Any, xp: Any) -> tuple[Any, Any]:
        """Return the position gap (m) and the attitude gap (rotation vector, rad), ``(..., 3)`` each.

        ``values`` are the environment's observations ``(..., inputs)``, and ``xp`` is the module numpy or torch. The
        methods below take the same arguments.
        """
        n = self.joints
        if self.goal:
            numbers = [values[..., i] for i in range(n + 3, self.inputs)]
            gap = goal_gap(xp, numbers[:GOAL_NUMBERS], numbers[GOAL_NUMBERS:])
            return xp.stack(gap[:3], -1), xp.stack(gap[3:], -1)
        return values[..., n + 12 :] if self.camera else values[..., n + 6 : n + 9], values[..., n + 9 : n + 12]

    def size(self, values: Any, xp: Any) -> Any:
        """Compute the size ``(..., 1)`` of the gap in observations ``values``: the larger of two ratios.

        These are the position gap over `near` and the attitude gap over `near_turn`; see `gap` for the arguments.
        """
        gap, turn = self.gap(values, xp)
        far, turned = vector_length(gap) / self.near, vector_length(turn) / self.near_turn
        return xp.clip(far if self.tool == 3 else xp.maximum(far, turned), self.SMALLEST, None)

    def share(self, values: Any, xp: Any) -> Any:
        """Compute the factor ``(..., 1)``, at most 1, by which a network's actions are multiplied.

        `gap` explains the arguments.
        """
        size = self.size(values, xp)
        return xp.clip(size, None, 1.0) if self.actions else 0.0 * size + 1.0

    def observe(self, values: Any, xp: Any) -> Any:
        """Compute the observations ``(..., features)`` that networks see, with the arguments of `Rescaling.observe`."""
        gap, turn = self.gap(values, xp)
        size = self.size(values, xp)
        parts = (values[..., : self.joints], gap / (self.near * size), turn / (self.near_turn * size))
        if self.tool:
            parts = parts[1 : 1 + self.tool // 3]
        return xp.concatenate((*parts, xp.log10(size) / 2.0), -1)

    def commands(self, values: Any, actions: Any) -> Any:
        """Compute the environment's actions from a network's ``actions`` (-1 to 1) at the observations ``values``."""
        return actions * self.share(values, np)

    def potential(self, values: NDArray[Any]) -> Any:
        """Compute the negative decimal logarithm ``(...)`` of the gap's size from observations, for reward shaping."""
        return -np.log10(self.size(values, np))[..., 0]

    def act(self, values: NDArray[Any], actions: Any, most: float = MOST_ACTION["clip"]) -> NDArray[Any]:
        """Compute the environment's actions from a policy's ``actions`` at the observations ``values``.

        Actions of another shape, and numbers that are larger than ``most`` or not finite, are passed on unchanged, so
        that the environment raises the error.
        """
        numbers = as_numbers("actions", actions)
        if numbers.shape != (*values.shape[:-1], self.outputs):
            return numbers
        scaled = self.commands(values, np.clip(numbers, -1.0, 1.0))
        return np.where(np.abs(numbers) <= most, scaled, numbers).astype(np.float32)


def scaling_of(task: Task, actions: bool = True) -> Scaling:
    """Return the scaling for a task's flat observations (arrays, not goal dictionaries).

    ``actions`` says whether actions shrink with the gap. If actions move the tool, a gap that one action can close
    counts as near.
    """
    near = dict(zip(("near", "near_turn"), task.tool[::3], strict=False))
    return Scaling(task.joints, task.camera, actions=actions, tool=len(task.tool), **near)


def vector_length(vector: Any) -> Any:
    """Compute the lengths ``(..., 1)`` of vectors ``(..., k)``."""
    return ((vector * vector).sum(-1)[..., None]) ** 0.5


def joined_observation(observation: Any, xp: Any = np) -> Any:
    """Concatenate the parts of a goal observation: observation, achieved goal, desired goal.

    A flat observation is returned as it is. ``xp`` is the module numpy or torch.
    """
    if not isinstance(observation, dict):
        return observation
    return xp.concatenate([observation[key] for key in ("observation", "achieved_goal", "desired_goal")], -1)
