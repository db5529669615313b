"""Wrappers that rescale observations and actions; `pickenv.envs.shared.spaces` has the formulas."""

from __future__ import annotations

from typing import Any, SupportsFloat, cast

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.utils import RecordConstructorArgs
from gymnasium.vector import AutoresetMode, VectorEnv, VectorWrapper

from pickenv.base import InputError
from pickenv.envs.shared.arm_env import Options
from pickenv.envs.shared.native_vector import Seeds, set_spaces
from pickenv.envs.shared.spaces import (
    Rescaling,
    Scaling as Scaling,
    joined_observation as joined_observation,
    scaling_of,
)
from pickenv.envs.shared.task import Task


class ScaledEnv(gym.Wrapper[Any, Any, Any, Any]):
    """Wrapper that rescales an environment's observations and actions.

    Args:
        env: The environment.
        scaling: The formulas that rescale observations and actions and give the potential (how near the goal is).
        shaping: Discount of the learner, or None for no reward shaping. With shaping, the discounted potential after
            a step, minus the potential before the step, is added to the step's reward.

    Attributes:
        raw: The latest observation, before rescaling.
    """

    def __init__(self, env: gym.Env[Any, Any], scaling: Rescaling, shaping: float | None = None) -> None:
        gym.Wrapper.__init__(self, env)
        self.scaling, self._most, self._shaping = scaling, env.get_wrapper_attr("task").most_action, shaping
        self.observation_space = scaling.space
        self.action_space = scaling.answers or env.action_space
        self.raw: Any = np.zeros(scaling.inputs, dtype=np.float32)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin an episode, and return the rescaled observation and the info."""
        self.raw, info = self.env.reset(seed=seed, options=options)
        return self.scaling.shown(self.raw), info

    def step(self, action: Any) -> tuple[Any, SupportsFloat, bool, bool, dict[str, Any]]:
        """Step with a policy's action, and return the rescaled observation."""
        before = self.raw
        self.raw, reward, terminated, truncated, info = self.env.step(self.scaling.act(before, action, self._most))
        if self._shaping is not None:
            after = 0.0 if terminated else float(self.scaling.potential(self.raw))
            reward = float(reward) + self._shaping * after - float(self.scaling.potential(before))
        return self.scaling.shown(self.raw), reward, terminated, truncated, info


class ScaledVector(VectorWrapper[Any, Any, Any, Any, Any]):
    """Wrapper that rescales observations and actions of native vector environments; arguments as for `ScaledEnv`.

    Attributes:
        raw: The latest observations, before rescaling.
    """

    def __init__(self, env: VectorEnv[Any, Any, Any], scaling: Rescaling, shaping: float | None = None) -> None:
        VectorWrapper.__init__(self, env)
        inner: Any = env.unwrapped
        self.scaling, self._most, self._shaping = scaling, inner.task.most_action, shaping
        set_spaces(self, scaling.space, scaling.answers or env.single_action_space)
        self.raw: Any = np.zeros((self.num_envs, scaling.inputs), dtype=np.float32)
        self._idle = np.zeros(self.num_envs, dtype=np.bool_)

    @property
    def autoreset_mode(self) -> AutoresetMode:
        """The environments' autoreset mode, which torchrl reads from the outermost wrapper."""
        return cast(AutoresetMode, self.metadata["autoreset_mode"])

    def reset(self, *, seed: Seeds = None, options: Options = None) -> tuple[Any, dict[str, Any]]:
        """Begin episodes, and return the rescaled observations and the infos."""
        self.raw, infos = self.env.reset(seed=seed, options=options)  # type: ignore[arg-type]
        begun = (options or {}).get("reset_mask")
        self._idle[slice(None) if begun is None else begun] = False
        return self.scaling.shown(self.raw), infos

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Step with a policy's actions, and return the rescaled observations."""
        before = self.raw
        commands = self.scaling.act(before, actions, self._most)
        self.raw, rewards, terminations, truncations, infos = self.env.step(commands)
        last = self.raw
        if "final_obs" in infos:
            final, last = infos["final_obs"].copy(), np.array(self.raw)
            for i in np.flatnonzero(infos["_final_obs"]):
                last[i], final[i] = final[i], self.scaling.shown(final[i])
            infos = infos | {"final_obs": final}
        if self._shaping is not None:
            after = np.where(terminations, 0.0, self.scaling.potential(last))
            rewards = rewards + np.where(self._idle, 0.0, self._shaping * after - self.scaling.potential(before))
            if self.env.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP:
                self._idle = terminations | truncations  # the next step begins an episode
        return self.scaling.shown(self.raw), rewards, terminations, truncations, infos


class GapScaling(ScaledEnv, RecordConstructorArgs):
    """Show the gap to the fruit as direction and logarithm, and multiply actions by the gap's size, so that PPO learns.

    `pickenv/ReachScaled-v0` does the same without a wrapper, also as a native vector environment. With n joints the
    observation is `Box(float32)` of n + 7 numbers. The size of the gap is the larger of two ratios: its position / 100
    mm and its attitude / 0.2 rad. It is at least 1e-6.

    | Num          | Observation                                                  | Min | Max | Unit         |
    |--------------|--------------------------------------------------------------|-----|-----|--------------|
    | 0 to n-1     | joint readings, scaled to the limits                         | -1  | 1   | 1            |
    | n to n+2     | position gap, divided by the size                            | -1  | 1   | 100 mm       |
    | n+3 to n+5   | attitude gap (rotation vector), divided by the size          | -1  | 1   | 0.2 rad      |
    | n+6          | half the size's logarithm                                    | -3  | 3   | two decades  |

    The gap is the pose of the fruit relative to the believed tool. With ``feedback="camera"`` the camera measures
    the gap's position. Actions are clipped to -1 to 1 and, if the size is below one, multiplied by the size.

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
        """Wrap ``env``; ``actions`` says whether actions are scaled too.

        Raises:
            InputError: If the observations are not the flat observations of a reach task.
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
        """Wrap ``env``; ``actions`` says whether actions are scaled too.

        Raises:
            InputError: If the observations are not the flat observations of a reach task, as NumPy arrays.
        """
        RecordConstructorArgs.__init__(self, actions=actions)
        if env.metadata.get("torch"):
            raise InputError("GapScalingVector works on NumPy; make the environments with executor='numpy'")
        ScaledVector.__init__(self, env, _scaling_of(env, env.single_observation_space, actions))


def _scaling_of(env: Any, space: spaces.Space[Any], actions: bool) -> Scaling:
    """Return the scaling of a reach task's flat observations; raise an `InputError` if ``env`` has other observations.

    Args:
        env: The environment, or environments.
        space: Observation space of a single environment.
        actions: Whether actions are scaled too.
    """
    task = getattr(env.unwrapped, "task", None)
    if not isinstance(task, Task) or space.shape != (scaling_of(task).inputs,):
        raise InputError("GapScaling reads flat observations; wrap a pickenv/Reach-v0 environment")
    return scaling_of(task, actions)
