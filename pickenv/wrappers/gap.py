"""Observations and actions scaled so that a policy learns to the last millimetre.

A network that reads a gap in metres is blind to millimetres, and the noise of its actions hides them. Here the network
sees the gap to the fruit as a direction of about unit length and the logarithm of its size, and near the fruit an
action is a share of the gap that remains: what a policy learns about decimetres then holds for micrometres. The
formulas run on NumPy and on torch; the wrappers put them around environments.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, SupportsFloat

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.utils import RecordConstructorArgs
from gymnasium.vector import AutoresetMode, VectorEnv, VectorWrapper
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from pickenv.base import InputError
from pickenv.envs import ReachEnv, ReachVectorEnv
from pickenv.envs.shared.simulation import GOAL_NUMBERS, goal_gap
from pickenv.envs.shared.task import MOST_ACTION, as_numbers

SMALLEST = 1e-6
"""Smallest size of a gap, as a share of the near gap: smaller gaps count as this, 0.1 um in position."""

ROUNDING = 1e-3
"""Margin for rounding in the bounds of numbers that are at most one."""


class Rescaling(ABC):
    """Formulas from an environment's observations ``(..., inputs)`` to a policy's, and from its actions to commands.

    Attributes:
        inputs: Count of numbers in the environment's observation.
        space: Space of the observations that the policy sees.
        answers: Space of the policy's actions, if it differs from the environment's action space; else None.
        home: Words for an error message: what the policy has to be used with ("use ... of its training").
    """

    inputs: Any
    space: Any
    answers: Any = None
    home: ClassVar[str]

    def check(self, width: int) -> None:
        """Refuse observations that are not `inputs` numbers long.

        Raises:
            InputError: If ``width`` is not `inputs`.
        """
        if width != self.inputs:
            raise InputError(
                f"the policy was trained on observations of {self.inputs} numbers, but the environment gives {width}; "
                f"use {self.home} of its training"
            )

    def shown(self, values: NDArray[Any]) -> NDArray[np.float32]:
        """The result of `observe` as an environment returns it: a float32 array of NumPy."""
        return np.asarray(self.observe(values, np), dtype=np.float32)

    @abstractmethod
    def observe(self, values: Any, xp: Any) -> Any:
        """The numbers ``(..., features)`` that the policy sees; ``xp`` is numpy or torch."""

    @abstractmethod
    def act(self, values: NDArray[Any], actions: Any, most: float = MOST_ACTION["clip"]) -> NDArray[Any]:
        """Commands to the environment for a policy's ``actions``.

        Actions that the environment refuses stay as they are, for the environment to refuse.
        """

    @abstractmethod
    def potential(self, values: NDArray[Any]) -> Any:
        """A number that grows as an observation gets nearer to the task's goal, for reward shaping."""


class ScaledEnv(gym.Wrapper[Any, Any, Any, Any]):
    """An environment whose observations and actions are rescaled.

    Args:
        env: The environment.
        scaling: The formulas.
        shaping: The learner's discount, with which differences of the potential are added to the rewards; None for
            rewards as they are.
    """

    def __init__(self, env: gym.Env[Any, Any], scaling: Rescaling, shaping: float | None = None) -> None:
        gym.Wrapper.__init__(self, env)
        inner: Any = env.unwrapped
        self.scaling, self._most, self._shaping = scaling, inner.task.most_action, shaping
        self.observation_space = scaling.space
        self.action_space = scaling.answers or env.action_space
        self.raw: Any = np.zeros(scaling.inputs, dtype=np.float32)
        """The latest observation, as the environment gave it."""

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin an episode; the observation is the rescaled one."""
        self.raw, info = self.env.reset(seed=seed, options=options)
        return self.scaling.shown(self.raw), info

    def step(self, action: Any) -> tuple[Any, SupportsFloat, bool, bool, dict[str, Any]]:
        """Step with actions in the policy's scale, and return rescaled observations."""
        before = self.raw
        self.raw, reward, terminated, truncated, info = self.env.step(self.scaling.act(before, action, self._most))
        if self._shaping is not None:
            after = 0.0 if terminated else float(self.scaling.potential(self.raw))
            reward = float(reward) + self._shaping * after - float(self.scaling.potential(before))
        return self.scaling.shown(self.raw), reward, terminated, truncated, info


class ScaledVector(VectorWrapper[Any, Any, Any, Any, Any]):
    """Native vector environments whose observations and actions are rescaled; arguments as for `ScaledEnv`."""

    def __init__(self, env: VectorEnv[Any, Any, Any], scaling: Rescaling, shaping: float | None = None) -> None:
        VectorWrapper.__init__(self, env)
        inner: Any = env.unwrapped
        self.scaling, self._most, self._shaping = scaling, inner.task.most_action, shaping
        self.single_observation_space = scaling.space
        self.observation_space = batch_space(scaling.space, self.num_envs)
        if scaling.answers is not None:
            self.single_action_space = scaling.answers
            self.action_space = batch_space(scaling.answers, self.num_envs)
        self.raw: Any = np.zeros((self.num_envs, scaling.inputs), dtype=np.float32)
        """The latest observations, as the environments gave them."""
        self._idle = np.zeros(self.num_envs, dtype=np.bool_)

    @property
    def autoreset_mode(self) -> AutoresetMode:
        """The environments' autoreset mode; torchrl asks the outermost wrapper for it."""
        mode: AutoresetMode = self.metadata["autoreset_mode"]
        return mode

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Begin episodes; the observations are the rescaled ones."""
        self.raw, infos = self.env.reset(seed=seed, options=options)  # type: ignore[arg-type]
        self._idle[:] = False
        return self.scaling.shown(self.raw), infos

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Step with actions in the policy's scale, and return rescaled observations."""
        before = self.raw
        commands = self.scaling.act(before, actions, self._most)
        self.raw, rewards, terminations, truncations, infos = self.env.step(commands)
        last = self.raw
        if "final_obs" in infos:
            final, last = infos["final_obs"].copy(), np.array(self.raw)
            for i in np.flatnonzero(infos["_final_obs"]):
                last[i] = final[i]
                final[i] = self.scaling.shown(final[i])
            infos = infos | {"final_obs": final}
        if self._shaping is not None:
            after = np.where(terminations, 0.0, self.scaling.potential(last))
            gained = self._shaping * after - self.scaling.potential(before)
            rewards = rewards + np.where(self._idle, 0.0, gained)
            if self.env.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP:
                self._idle = terminations | truncations  # the next step begins an episode
        return self.scaling.shown(self.raw), rewards, terminations, truncations, infos


@dataclass(frozen=True)
class Scaling(Rescaling):
    """The scaling of the gap in a reach task: the layout of its observations, and which gap counts as near.

    Attributes:
        joints: Number of joints n.
        camera: Whether the flat observation ends with the camera's gap.
        goal: Whether observations are goal observations: observation, achieved and desired goal, one after the other.
        actions: Whether actions shrink with the gap; if not, only the observation changes.
        near: Position gap below which actions shrink in proportion to it, m.
        near_turn: Attitude gap below which actions shrink in proportion to it, rad.
    """

    joints: int
    camera: bool = False
    goal: bool = False
    actions: bool = True
    near: float = 0.1
    near_turn: float = 0.2
    home = "the feedback and the arm"

    @property
    def inputs(self) -> int:
        """Count of numbers in the environment's observation."""
        if self.goal:
            return self.joints + 3 + 2 * GOAL_NUMBERS
        return self.joints + (15 if self.camera else 12)

    @property
    def features(self) -> int:
        """Count of numbers that the networks see."""
        return self.joints + 7

    @property
    def space(self) -> spaces.Box:
        """Space of the observations that the networks see."""
        high = [1.0] * self.joints + [1.0 + ROUNDING] * 6 + [-math.log10(SMALLEST) / 2.0]
        return spaces.Box(-np.array(high, np.float32), np.array(high, np.float32), dtype=np.float32)

    @property
    def outputs(self) -> int:
        """Count of numbers in a network's action: one per joint."""
        return self.joints

    def gap(self, values: Any, xp: Any) -> tuple[Any, Any]:
        """The position gap between tool and fruit (m) and the gap between their attitudes (rad), ``(..., 3)`` each."""
        n = self.joints
        if self.goal:
            numbers = [values[..., i] for i in range(n + 3, self.inputs)]
            gap = goal_gap(xp, numbers[:GOAL_NUMBERS], numbers[GOAL_NUMBERS:])
            return xp.stack(gap[:3], -1), xp.stack(gap[3:], -1)
        return values[..., n + 12 :] if self.camera else values[..., n + 6 : n + 9], values[..., n + 9 : n + 12]

    def size(self, values: Any, xp: Any) -> Any:
        """Size of the gap ``(..., 1)``: the larger of position over `near` and attitude over `near_turn`."""
        gap, turn = self.gap(values, xp)
        far, turned = (
            ((part * part).sum(-1)[..., None]) ** 0.5 / near
            for part, near in ((gap, self.near), (turn, self.near_turn))
        )
        return xp.clip(xp.maximum(far, turned), SMALLEST, None)

    def share(self, values: Any, xp: Any) -> Any:
        """The factor ``(..., 1)`` by which a network's actions are multiplied."""
        size = self.size(values, xp)
        return xp.clip(size, None, 1.0) if self.actions else 0.0 * size + 1.0

    def observe(self, values: Any, xp: Any) -> Any:
        """The numbers ``(..., features)`` that the networks see; ``xp`` is numpy or torch."""
        gap, turn = self.gap(values, xp)
        size = self.size(values, xp)
        parts = (values[..., : self.joints], gap / (self.near * size), turn / (self.near_turn * size))
        return xp.concatenate((*parts, xp.log10(size) / 2.0), -1)

    def commands(self, values: Any, actions: Any) -> Any:
        """Commands to the environment for a network's ``actions``, which lie between -1 and 1."""
        return actions * self.share(values, np)

    def potential(self, values: NDArray[Any]) -> Any:
        """The negative decimal logarithm of the gap's size; rewards of reaching are as dense already."""
        return -np.log10(self.size(values, np))[..., 0]

    def act(self, values: NDArray[Any], actions: Any, most: float = MOST_ACTION["clip"]) -> NDArray[Any]:
        """Commands to the environment for a policy's ``actions`` at the observations ``values``.

        Actions of another shape, and numbers larger than ``most`` or not finite, stay as they are, for the environment
        to refuse.
        """
        numbers = as_numbers("actions", actions)
        if numbers.shape != (*values.shape[:-1], self.joints):
            return numbers
        scaled = self.commands(values, np.clip(numbers, -1.0, 1.0))
        return np.where(np.abs(numbers) <= most, scaled, numbers).astype(np.float32)


def joined_observation(observation: Any, xp: Any = np) -> Any:
    """A goal observation joined into one array; a flat observation stays as it is."""
    if not isinstance(observation, dict):
        return observation
    return xp.concatenate([observation[key] for key in ("observation", "achieved_goal", "desired_goal")], -1)


class GapScaling(ScaledEnv, RecordConstructorArgs):
    """Show the gap to the fruit by direction and logarithm, and take actions as shares of it, so that plain PPO learns.

    `pickenv/ReachScaled-v0` is `pickenv/Reach-v0` in this wrapper, single and native. With n joints the observation is
    `Box(float32)` of n + 7 numbers, and the size of the gap is the larger of position over 100 mm and attitude over
    0.2 rad, at least 1e-6:

    | Num          | Observation                                                  | Min | Max | Unit         |
    |--------------|--------------------------------------------------------------|-----|-----|--------------|
    | 0 to n-1     | joint readings, scaled to the limits                         | -1  | 1   | 1            |
    | n to n+2     | position gap, divided by the size                            | -1  | 1   | 100 mm       |
    | n+3 to n+5   | attitude gap (rotation vector), divided by the size          | -1  | 1   | 0.2 rad      |
    | n+6          | half the size's logarithm                                    | -3  | 3   | two decimals |

    The gap is that between fruit and believed tool, or with ``feedback="camera"`` the one that the camera measures.
    Actions are cut to -1 to 1 and, if the size is below one, multiplied by it.

    Args:
        env: A `pickenv/Reach-v0` or `pickenv/ReachIdeal-v0`.
        actions: Whether actions are scaled; if not, only the observation changes.

    Example:
        >>> import gymnasium as gym
        >>> import pickenv
        >>> from pickenv.wrappers import GapScaling
        >>> env = GapScaling(gym.make("pickenv/Reach-v0"))
        >>> env.reset(seed=0)[0].shape
        (13,)

    Change log:
     * v0.1.0 - Added.
    """

    def __init__(self, env: gym.Env[Any, Any], actions: bool = True) -> None:
        """Wrap ``env``.

        Raises:
            InputError: If the environment's observations are not the flat ones of a reach task.
        """
        RecordConstructorArgs.__init__(self, actions=actions)
        ScaledEnv.__init__(self, env, _scaling_of(env, env.observation_space, actions))


class GapScalingVector(ScaledVector, RecordConstructorArgs):
    """`GapScaling` for the native vector environments, on NumPy.

    Example:
        >>> import gymnasium as gym
        >>> import pickenv
        >>> from pickenv.wrappers import GapScalingVector
        >>> envs = GapScalingVector(gym.make_vec("pickenv/Reach-v0", num_envs=4))
        >>> envs.reset(seed=0)[0].shape
        (4, 13)

    Change log:
     * v0.2.0 - Added.
    """

    def __init__(self, env: VectorEnv[Any, Any, Any], actions: bool = True) -> None:
        """Wrap ``env``; ``actions`` as in `GapScaling`.

        Raises:
            InputError: If the environments' observations are not the flat ones of a reach task, in NumPy's arrays.
        """
        RecordConstructorArgs.__init__(self, actions=actions)
        if env.metadata.get("torch"):
            raise InputError("GapScalingVector works on NumPy; make the environments with executor='numpy'")
        ScaledVector.__init__(self, env, _scaling_of(env, env.single_observation_space, actions))


def scaled_reach(**arguments: Any) -> GapScaling:
    """`pickenv/Reach-v0` as a policy learns it: in `pickenv.wrappers.GapScaling`.

    ## Description

    Arm, fruit, plant, reward, information and arguments are those of `pickenv/Reach-v0`. A network that reads a gap in
    metres is blind to millimetres, and the noise of its exploration hides them: plain PPO stays at some 20 mm there.
    Here it sees the gap by direction and logarithm and acts in shares of what is left, and comes to where its
    calibration is what counts ("Training a policy" in the documentation has the figures).

    ## Action Space

    `Box(-1, 1, (6,), float32)`: joint increments as in `pickenv/Reach-v0`, multiplied by the size of the gap where
    that is below one.

    ## Observation Space

    `Box(float32)`, 13 numbers. The size of the gap is the larger of position over 100 mm and attitude over 0.2 rad, at
    least 1e-6.

    | Num   | Observation                                                         | Min | Max | Unit         |
    |-------|---------------------------------------------------------------------|-----|-----|--------------|
    | 0-5   | joint readings, scaled to the limits                                | -1  | 1   | 1            |
    | 6-8   | fruit minus believed tool (with a camera: as it sees it), over size | -1  | 1   | 100 mm       |
    | 9-11  | wanted against believed attitude, rotation vector, over size        | -1  | 1   | 0.2 rad      |
    | 12    | half the size's logarithm                                           | -3  | 3   | two decimals |

    ## Rewards

    As in `pickenv/Reach-v0`.

    ## Starting State

    As in `pickenv/Reach-v0`; the same seed gives the same fruit.

    ## Episode End

    As in `pickenv/Reach-v0`: truncation after 60 steps.

    ## Arguments

    ```python
    >>> import gymnasium as gym
    >>> import pickenv
    >>> env = gym.make("pickenv/ReachScaled-v0", feedback="camera", camera_noise_mm=1.0)
    >>> env.reset(seed=1)[0].shape
    (13,)
    >>> gym.make_vec("pickenv/ReachScaled-v0", num_envs=64).reset(seed=1)[0].shape
    (64, 13)

    ```

    Those of `pickenv/Reach-v0`.

    ## Version History

    * v0: First version.
    """
    return GapScaling(ReachEnv(**arguments))


def scaled_reach_vector(**arguments: Any) -> GapScalingVector:
    """N `pickenv/ReachScaled-v0` in one vector environment: `pickenv.envs.ReachVectorEnv` in `GapScalingVector`."""
    return GapScalingVector(ReachVectorEnv(**arguments))


def _scaling_of(env: Any, space: spaces.Space[Any], actions: bool) -> Scaling:
    """The scaling for an environment's observations; an `InputError` if they are not the flat ones of a reach task."""
    task = getattr(env.unwrapped, "task", None)
    if task is None or space.shape != (Scaling(task.joints, task.camera).inputs,):
        raise InputError("GapScaling reads flat observations; wrap a pickenv/Reach-v0 environment")
    return Scaling(task.joints, task.camera, actions=actions)
