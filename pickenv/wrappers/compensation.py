"""Wrappers that put a calibration between policy and arm: a compensator corrects joint targets before the drives."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from typing import Any, SupportsFloat, TypeAlias, TypeVar

import gymnasium as gym
import numpy as np
from gymnasium.utils import RecordConstructorArgs
from gymnasium.vector import VectorEnv, VectorWrapper
from numpy.typing import NDArray

from pickenv.base import InputError, obey

Observation = TypeVar("Observation")
Action = TypeVar("Action")


Compensate: TypeAlias = Callable[[NDArray[np.float64]], NDArray[np.float64]]
"""A function from the nominal arm's joint targets to the real arm's joint commands, ``(..., n)`` each (rad, m)."""


class CompensationWrapper(gym.Wrapper[Observation, Action, Observation, Action], RecordConstructorArgs):
    """Correct the joint target on its way to the drives, invisibly to the policy.

    Spaces, seeds, episode flow and observations stay as they are: joint readings are mapped back to nominal joints, so
    a policy that servoes on its believed tool position does not cancel the compensation. If the plant's motors move in
    whole counts and lag behind their commands (`plant="orchard"`), the readings still change slightly, because counts
    and lag depend on the command: by less than a count, and by a few thousandths of the difference in step. The
    compensator sits at the environment's one seam, so the wrapper's place in a stack of wrappers does not matter;
    closing the wrapper removes the compensator.

    Example:
        >>> import gymnasium as gym
        >>> import pickenv
        >>> from pickenv.wrappers import CompensationWrapper
        >>> env = gym.make("pickenv/Reach-v0")
        >>> env = CompensationWrapper(env, lambda joints: joints)  # a calibration's compensator() in earnest
        >>> observation, info = env.reset(seed=0)

    Change log:
     * v0.1.0 - Added.
    """

    def __init__(self, env: gym.Env[Observation, Action], compensator: Compensate, allow: Collection[str] = ()) -> None:
        """Install ``compensator`` in ``env``.

        Args:
            env: The environment; its fruit stand in the arm's own base frame.
            compensator: The compensator.
            allow: Reservations of the calibration to accept, by name: "fitted-frames", "do-not-use".

        Raises:
            InputError: If the environment has no compensation seam, or already holds a compensator; or if something
                stands against the calibration that ``allow`` does not name.
        """
        RecordConstructorArgs.__init__(self, compensator=compensator, allow=allow)
        gym.Wrapper.__init__(self, env)
        _install([env.unwrapped], compensator, allow)
        self._compensator = compensator

    def step(self, action: Action) -> tuple[Observation, SupportsFloat, bool, bool, dict[str, Any]]:
        """Step the environment; at an episode's end, add the calibrated arm's expected error to `info`.

        The entries are `within95_mm` and `within95_deg`, if the calibration knows them: 95 of 100 reaches of the
        calibrated arm end nearer to their target than that, as counted on rows that the calibration never saw.
        """
        observation, reward, terminated, truncated, info = self.env.step(action)
        if (terminated or truncated) and "joint_command" in info:
            within = _within95(self._compensator, np.asarray(info["joint_command"], dtype=float))
            info |= {name: float(value) for name, value in within.items()}
        return observation, reward, terminated, truncated, info

    def close(self) -> None:
        """Close the environment and remove the compensator."""
        _remove([self.env.unwrapped])
        super().close()


class CompensationVectorWrapper(VectorWrapper[Any, Any, Any, Any, Any], RecordConstructorArgs):
    """`CompensationWrapper` for vector environments: the native ones, and `SyncVectorEnv` of single ones.

    Example:
        >>> import gymnasium as gym
        >>> import pickenv
        >>> from pickenv.wrappers import CompensationVectorWrapper
        >>> envs = gym.make_vec("pickenv/Reach-v0", num_envs=4)
        >>> envs = CompensationVectorWrapper(envs, lambda joints: joints)
        >>> observations, infos = envs.reset(seed=0)

    Change log:
     * v0.1.0 - Added.
    """

    def __init__(self, env: VectorEnv[Any, Any, Any], compensator: Compensate, allow: Collection[str] = ()) -> None:
        """Install ``compensator`` in every environment of ``env``.

        Args:
            env: The environments; their fruit stand in the arm's own base frame.
            compensator: The compensator.
            allow: Reservations of the calibration to accept, by name: "fitted-frames", "do-not-use".

        Raises:
            InputError: If an environment has no compensation seam, or already holds a compensator; or if something
                stands against the calibration that ``allow`` does not name.
        """
        RecordConstructorArgs.__init__(self, compensator=compensator, allow=allow)
        VectorWrapper.__init__(self, env)
        _install(_seams(env), compensator, allow)
        self._compensator = compensator

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Step the environments; where episodes end, add to `infos` what `CompensationWrapper.step` adds to `info`.

        If environments start anew within the step, the entries are in `final_info`, like all else of the ended episode.
        """
        observations, rewards, terminations, truncations, infos = self.env.step(actions)
        ended = np.flatnonzero(_numpy(terminations) | _numpy(truncations))
        last = infos.get("final_info", infos)
        if len(ended) and "joint_command" in last:
            for name, values in _within95(self._compensator, _numpy(last["joint_command"])[ended]).items():
                last[name], last[f"_{name}"] = np.zeros(self.num_envs), np.zeros(self.num_envs, dtype=np.bool_)
                last[name][ended], last[f"_{name}"][ended] = values, True
        return observations, rewards, terminations, truncations, infos

    def close(self, **arguments: Any) -> None:
        """Close the environments and remove the compensator."""
        _remove(_seams(self.env))
        super().close(**arguments)


def _within95(compensator: Compensate, commands: NDArray[Any]) -> dict[str, NDArray[Any]]:
    """Errors that 95 of 100 reaches at commands ``(..., n)`` keep within, by name in `info`; empty if unknown."""
    quantile = getattr(compensator, "within95", None)
    position, attitude = (None, None) if quantile is None else quantile(commands.astype(float))
    within = {} if position is None else {"within95_mm": np.asarray(position) * 1e3}
    return within | ({} if attitude is None else {"within95_deg": np.degrees(attitude)})


def _numpy(values: Any) -> NDArray[Any]:
    """A NumPy array of the values of an array, or of a tensor on any device."""
    return np.asarray(values.cpu() if hasattr(values, "cpu") else values)


def _seams(env: VectorEnv[Any, Any, Any]) -> list[Any]:
    """The objects that hold a vector environment's compensators: itself, or each of its single environments."""
    inner: Any = env.unwrapped
    return [single.unwrapped for single in inner.envs] if hasattr(inner, "envs") else [inner]


def _install(seams: Sequence[Any], compensator: Compensate, allow: Collection[str]) -> None:
    obey(getattr(compensator, "reservations", {}), allow)
    if (caution := getattr(compensator, "caution", None)) is not None:
        gym.logger.warn("%s", caution)  # a "%" in it is no format
    for seam in seams:
        if not hasattr(seam, "compensator"):
            raise InputError(f"{type(seam).__name__} has no compensation seam; wrap a pickenv environment")
        if seam.compensator is not None:
            raise InputError(f"{type(seam).__name__} already has a compensator; wrap it once")
    for seam in seams:
        seam.compensator = compensator


def _remove(seams: Sequence[Any]) -> None:
    for seam in seams:
        seam.compensator = None
