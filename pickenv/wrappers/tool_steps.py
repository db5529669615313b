"""Wrappers for picking by steps of the tool instead of joint increments, with the gap by size and direction.

A policy that moves joints must learn the arm's kinematics before it can learn to pick. Here the nominal Jacobian turns
a step of the believed tool, which is kept upright, into joint increments. Near the fruit, steps are multiplied by the
size of the gap, as in `pickenv.wrappers.GapScaling`. All formulas use observations and the nominal arm only. Units: m,
rad.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.utils import RecordConstructorArgs
from gymnasium.vector import VectorEnv
from numpy.typing import NDArray

from pickenv.arm import Array, Geometry, joint_jacobian
from pickenv.base import InputError
from pickenv.envs.picking.pick_scene import CLOSE, PickSetting
from pickenv.envs.shared.spaces import Rescaling, vector_length
from pickenv.envs.shared.task import MOST_ACTION, as_numbers
from pickenv.wrappers.gap import ScaledEnv, ScaledVector


@dataclass(frozen=True, eq=False)
class ToolSteps(Rescaling):
    """Formulas between `pickenv/Pick-v0` and a policy whose actions are steps of the tool.

    Attributes:
        geometry: The nominal arm.
        increment: Largest increments of the arm's joints in one step (n,), rad or m.
        LARGEST: Length that an action of 1 adds to the tool's step in one period, m; with periods of 0.1 s this is 0.3
            m/s.
        NEAR: Gap below which steps shrink in proportion to the gap, m.
        SERVO: Step towards the fruit if the action is zero, as a share of the step that an action of 1 adds.
        ARRIVED: Gap below which the arm does not move, m.
        CLOSING: Gap above which the gripper does not close, m: about the largest gap at which it can take a fruit.
        UPRIGHT: Error of the tool's position that has the same weight as a tilt of one radian, m.
        DAMPING: Damping of the Jacobian's inverse, as a share of the mean squared norm of the Jacobian's rows.
        CENTRING: Share of each joint's distance from mid-range that a full step removes in the Jacobian's null space.
        COLLECTING: Distance by which the tool must go down to collect a detached fruit, m.
        MOVES: Number of values in a policy's action that move the tool; the gripper's value follows them.
    """

    LARGEST, NEAR, SERVO = 0.03, 0.05, 0.5
    ARRIVED, CLOSING, COLLECTING = 2e-4, 0.015, 0.08
    UPRIGHT, DAMPING, CENTRING, MOVES = 0.1, 1e-4, 0.1, 2

    geometry: Geometry
    increment: Array
    home = "it in pickenv/Pick-v0, with the arm"
    outputs = MOVES + 1  # of the policy: its steps and the gripper

    @property
    def joints(self) -> int:
        """Number of joints."""
        return self.geometry.joints

    @property
    def header(self) -> dict[str, list[float]]:
        """The entries of a policy's file that describe these formulas (``increment``), apart from the arm's name."""
        return {"increment": self.increment.tolist()}

    @property
    def inputs(self) -> int:
        """Number of values in the environment's observation."""
        return self.joints + 17

    @property
    def features(self) -> int:
        """Number of values in the policy's observation."""
        return self.joints + 12

    @property
    def space(self) -> spaces.Box:
        """Space of the policy's observations."""
        n = self.joints
        high = np.array([1.0] * n + [1.001] * 4 + [2.0] * 2 + [1.0] * 6, dtype=np.float32)
        low = np.array([-1.0] * n + [-1.001] * 4 + [-2.0] * 2 + [0.0] * 6, dtype=np.float32)
        return spaces.Box(low, high, dtype=np.float32)

    @property
    def answers(self) -> spaces.Box:
        """Space of the policy's actions."""
        return spaces.Box(-1.0, 1.0, (self.outputs,), dtype=np.float32)

    def observe(self, values: Any, xp: Any = np) -> Any:
        """Compute the policy's observations ``(..., features)`` from the environment's ``values`` ``(..., n + 17)``.

        ``xp`` is the namespace of the arrays: ``numpy`` or ``torch``.
        """
        n = self.joints
        gap, turn, others = values[..., n + 6 : n + 9], values[..., n + 9 : n + 12], values[..., n + 12 :]
        far, aside, up = vector_length(gap), vector_length(gap[..., :2]), gap[..., 2:]
        both = xp.concatenate((aside, up), -1)
        decades = (xp.log10(xp.maximum(size, self.ARRIVED) / self.NEAR) / 2.0 for size in (far, aside))
        shares = (both / xp.maximum(far, self.ARRIVED), both / (both * both + self.NEAR**2) ** 0.5, *decades)
        return xp.concatenate((values[..., :n], *shares, xp.clip(vector_length(turn) ** 2, 0.0, 1.0), others), -1)

    def act(self, values: NDArray[Any], actions: Any, most: float = MOST_ACTION["clip"]) -> NDArray[Any]:
        """Compute the environment's actions ``(..., n + 1)`` from a policy's ``actions (..., 3)``.

        Actions of another shape are returned unchanged, so that the environment raises the error. If an action has a
        number that is not finite, or of a magnitude above ``most``, the result has numbers that the environment
        refuses.

        Args:
            values: The environment's observations ``(..., n + 17)``.
            actions: The policy's actions.
            most: Largest magnitude of a number that the environment accepts.
        """
        numbers = as_numbers("actions", actions)
        if numbers.shape != (*values.shape[:-1], self.outputs):
            return numbers
        commands = self.commands(values, np.clip(np.nan_to_num(numbers), -1.0, 1.0))
        wrong = ~(np.abs(numbers) <= most).all(axis=-1, keepdims=True)
        return np.where(wrong, np.inf if most == MOST_ACTION["clip"] else 2.0, commands).astype(np.float32)

    def commands(self, values: NDArray[Any], actions: Any) -> Any:
        """Compute joint increments and gripper command ``(..., n + 1)`` from a policy's ``actions (..., 3)``.

        All are from -1 to 1. ``values`` are the environment's observations ``(..., n + 17)``.
        """
        n = self.joints
        holding = (values[..., n + 14 : n + 16] > 0.5).any(axis=-1, keepdims=True)
        away = ~holding & (vector_length(values[..., n + 6 : n + 9]) > self.CLOSING)
        gripper = np.clip(CLOSE + actions[..., self.MOVES :], -1.0, 1.0)
        steps = self.joint_steps(np.asarray(values, dtype=float), actions[..., : self.MOVES])
        return np.concatenate([steps, np.where(away, np.minimum(gripper, 0.0), gripper)], axis=-1)

    def joint_steps(self, values: Array, steps: Array) -> Array:
        """Compute the joint steps ``(..., n)`` for steps of the tool, as shares of the largest joint steps.

        Args:
            values: The environment's observations ``(..., n + 17)``.
            steps: Steps of the tool ``(..., 2)``, two numbers from -1 to 1. The first is sideways, towards the vertical
                line through the fruit. The second is upwards.
        """
        n, low, high = self.joints, self.geometry.lower, self.geometry.upper
        q = low + (values[..., :n] + 1.0) / 2.0 * (high - low)
        gap = values[..., n + 6 : n + 9]
        far, aside = vector_length(gap), vector_length(gap[..., :2])
        holding = (values[..., n + 14 : n + 16] > 0.5).any(axis=-1, keepdims=True)
        share = np.where(holding, 1.0, np.where(far < self.ARRIVED, 0.0, np.minimum(far / self.NEAR, 1.0)))
        aim = np.where(holding | (share == 0.0), 0.0, gap[..., :2] / np.maximum(aside, self.NEAR))
        sideways = aim * (self.SERVO + steps[..., :1])
        climb = self.SERVO * gap[..., 2:] / np.maximum(far, self.ARRIVED)
        upwards = share * (np.where(holding, 0.0, climb) + steps[..., 1:])
        tilt = np.clip(values[..., n + 9 : n + 11], -0.2, 0.2)
        moves = self.LARGEST * np.concatenate([sideways, upwards], -1)
        task_step = np.concatenate([moves, self.UPRIGHT * tilt * (share > 0)], -1)
        jacobian = joint_jacobian(self.geometry, q)[..., :5, :] * self.increment
        jacobian = jacobian * np.array([1.0, 1.0, 1.0, self.UPRIGHT, self.UPRIGHT])[:, None]
        centring = self.CENTRING * share * ((low + high) / 2.0 - q) / self.increment
        remainder = task_step - np.einsum("...ij,...j->...i", jacobian, centring)
        square = np.einsum("...ij,...kj->...ik", jacobian, jacobian)
        damping = self.DAMPING * np.einsum("...ii->...", square)[..., None, None] / 5.0
        solved = np.linalg.solve(square + damping * np.eye(5), remainder[..., None])[..., 0]
        joint_step = centring + np.einsum("...ij,...i->...j", jacobian, solved)
        return np.asarray(joint_step / np.maximum(1.0, np.abs(joint_step).max(axis=-1, keepdims=True)))

    def potential(self, values: NDArray[Any]) -> Any:
        """Compute the progress of the pick, ``(...)`` from 0 to 0.8, for reward shaping.

        Before the grasp it is at most 0.35, and grows as the logarithm of the gap falls. It is 0.5 with a fruit in the
        gripper and 0.6 once the fruit is detached. It then grows up to 0.8 as the fruit is brought down. ``values`` are
        the environment's observations ``(..., n + 17)``.
        """
        n = self.joints
        gap = np.asarray(values[..., n + 6 : n + 9], dtype=float)
        seeking = 0.35 * np.clip(1.0 - np.log10(1.0 + 1e3 * vector_length(gap)[..., 0]) / 3.0, 0.0, 1.0)
        down = np.clip(gap[..., 2] / self.COLLECTING, 0.0, 1.0)
        hanging, off = values[..., n + 14] > 0.5, values[..., n + 15] > 0.5
        return np.where(off, 0.6 + 0.2 * down, np.where(hanging, 0.5, seeking))


class ToolStepping(ScaledEnv, RecordConstructorArgs):
    """Pick with steps of the tool, so that PPO learns to pick.

    An action of zero only moves the believed tool towards the fruit. The policy has to learn how to approach from
    below, how fast, and when to grasp, twist and retreat (a residual policy; Silver et al. 2018). An action has three
    numbers from -1 to 1. The first adds to the sideways step, the second to the upward step. An action of zero moves at
    most 15 mm in each of the two directions, and 1 adds at most 30 mm. Sideways steps shrink with the sideways gap
    below 50 mm, upward steps with the whole gap below 50 mm. With a fruit in the gripper the first number has no
    effect, and the second moves the tool up or down by up to 30 mm. The third number commands the gripper. An empty
    gripper closes if the number is above zero and the gap at most 15 mm. A gripper with a fruit twists: it
    gets the third number plus 0.5, at most 1, as the gripper command of `pickenv/Pick-v0`. The gripper never opens
    again. The tool is kept upright, and the arm does not move once the gap is below 0.2 mm. With n joints the
    observation is `Box(float32)` of n + 12 numbers:

    | Num          | Observation                                                        | Min | Max | Unit         |
    |--------------|--------------------------------------------------------------------|-----|-----|--------------|
    | 0 to n-1     | joint readings, scaled to the limits                               | -1  | 1   | 1            |
    | n, n+1       | gap sideways and up, divided by the gap's length (at least 0.2 mm) | -1  | 1   | 1            |
    | n+2, n+3     | gap sideways and up, each c mm as c / sqrt(c^2 + 50^2)             | -1  | 1   | 1            |
    | n+4, n+5     | half the logarithm of gap / 50 mm, and of sideways gap / 50 mm     | -2  | 2   | two decades  |
    | n+6          | square of the tilt, at most 1                                      | 0   | 1   | rad^2        |
    | n+7 to n+11  | the last five numbers of `pickenv/Pick-v0`                         | 0   | 1   |              |

    Args:
        env: A `pickenv/Pick-v0`.
        shaping: A discount g, above 0 and at most 1, or None. With g, each reward gets g P' - P added, where P and P'
            are the potentials before and after the step. Before the grasp the potential is 0.35 (1 - log10(1 + gap in
            mm) / 3), at least 0. It is 0.5 with a fruit in the gripper, 0.6 once the fruit is detached, and up to 0.8
            as it is brought down. It is 0 once no fruit is left. Shaping does not change which policy has the largest
            return discounted with g (Ng, Harada and Russell 1999); g = 1 is for the undiscounted return. None, the
            default, leaves rewards as they are.

    Example:
        >>> import gymnasium as gym
        >>> import pickenv
        >>> from pickenv.wrappers import ToolStepping
        >>> env = ToolStepping(gym.make("pickenv/Pick-v0"))
        >>> env.reset(seed=0)[0].shape, env.action_space.shape
        ((18,), (3,))

    Change log:
     * v0.3.0 - Added.
    """

    def __init__(self, env: gym.Env[Any, Any], shaping: float | None = None) -> None:
        """Wrap ``env``.

        Raises:
            InputError: If ``env`` is no picking environment or has `feedback="gripper"`, or if ``shaping`` is not above
                0 and at most 1.
        """
        RecordConstructorArgs.__init__(self, shaping=shaping)
        ScaledEnv.__init__(self, env, _steps_of(env, env.observation_space, shaping), shaping)


class ToolSteppingVector(ScaledVector, RecordConstructorArgs):
    """`ToolStepping` for the native vector environment.

    Example:
        >>> import gymnasium as gym
        >>> import pickenv
        >>> from pickenv.wrappers import ToolSteppingVector
        >>> envs = ToolSteppingVector(gym.make_vec("pickenv/Pick-v0", num_envs=2))
        >>> envs.reset(seed=0)[0].shape
        (2, 18)

    Change log:
     * v0.3.0 - Added.
    """

    def __init__(self, env: VectorEnv[Any, Any, Any], shaping: float | None = None) -> None:
        """Wrap ``env``; `ToolStepping` explains ``shaping``.

        Raises:
            InputError: If ``env`` is no picking environment or has `feedback="gripper"`, or if ``shaping`` is not above
                0 and at most 1.
        """
        RecordConstructorArgs.__init__(self, shaping=shaping)
        ScaledVector.__init__(self, env, _steps_of(env, env.single_observation_space, shaping), shaping)


def tool_steps_of(env: Any) -> ToolSteps:
    """Return the formulas for the arm of a picking environment, which may be single or a native vector environment.

    Raises:
        InputError: If ``env`` is no picking environment, or has `feedback="gripper"`.
    """
    inner = env.unwrapped
    if (task := getattr(inner, "task", None)) is None or not isinstance(getattr(inner, "orchard", None), PickSetting):
        raise InputError("ToolStepping moves a picking arm's tool; wrap a pickenv/Pick-v0 environment")
    if inner.orchard.felt is not None:
        raise InputError("ToolStepping has no place for what the gripper feels; make the environment without feedback")
    return ToolSteps(task.plant.arm.nominal, np.array(task.increment))


def _steps_of(env: Any, space: spaces.Space[Any], shaping: float | None) -> ToolSteps:
    scaling = tool_steps_of(env)
    scaling.check((space.shape or (0,))[0])
    if shaping is not None and not 0.0 < shaping <= 1.0:
        raise InputError(f"shaping is {shaping}; give a discount above 0 and at most 1, or None")
    return scaling
