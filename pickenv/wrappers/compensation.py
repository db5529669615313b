"""Wrappers that put a calibration between policy and arm: its compensator corrects joint targets for the drives."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Any, SupportsFloat, TypeVar

import gymnasium as gym
import numpy as np
from gymnasium.utils import RecordConstructorArgs
from gymnasium.vector import VectorEnv, VectorWrapper
from numpy.typing import NDArray

from pickenv.base import InputError, obey
from pickenv.envs.shared.task import Compensate as Compensate

Observation = TypeVar("Observation")
Action = TypeVar("Action")


class CompensationWrapper(gym.Wrapper[Observation, Action, Observation, Action], RecordConstructorArgs):
    """Correct joint targets before they reach the drives; the policy sees the same spaces and nominal joints.

    Spaces, seeds, episodes and observations stay as they are. Joint readings are mapped back to nominal joints, so that
    a policy that servos on its believed tool position does not cancel the compensation. Readings still change slightly
    if the plant (true arm) has motors that move in whole encoder counts and lag behind their commands
    (`plant="orchard"`). They change by less than a count, plus a few thousandths of the compensator's change of the
    step. The compensator is stored in the innermost environment, so wrappers may be stacked in any order. Closing the
    wrapper removes the compensator.

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
            env: The environment, whose fruit positions are in the arm's base frame.
            compensator: Function from the nominal arm's joint targets to joint commands of the true arm, such as a
                calibration's ``compensator()``.
            allow: Reservations (reasons against the calibration's use) to accept, by name: "fitted-frames",
                "do-not-use".

        Raises:
            InputError: If the environment takes no compensator, or already has one, or if the calibration is of another
                arm or has a reservation that ``allow`` does not name.
        """
        RecordConstructorArgs.__init__(self, compensator=compensator, allow=allow)
        gym.Wrapper.__init__(self, env)
        _install([env.unwrapped], compensator, allow)
        self._compensator = compensator

    def step(self, action: Action) -> tuple[Observation, SupportsFloat, bool, bool, dict[str, Any]]:
        """Step the environment; at the end of an episode, add bounds of the calibrated arm's error to `info`.

        The entries are `within95_mm` and `within95_deg`, if the calibration has these bounds. The calibrated arm's
        errors stay below them in 95 of 100 reaches, as measured on data that the calibration was not fitted to.
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
    """`CompensationWrapper` for vector environments: native vector environments, and `SyncVectorEnv`.

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
            env: The environments, whose fruit positions are in the arm's base frame.
            compensator: Function from the nominal arm's joint targets to joint commands of the true arm, such as a
                calibration's ``compensator()``.
            allow: Reservations (reasons against the calibration's use) to accept, by name: "fitted-frames",
                "do-not-use".

        Raises:
            InputError: If an environment takes no compensator, or already has one, or if the calibration is of another
                arm or has a reservation that ``allow`` does not name.
        """
        RecordConstructorArgs.__init__(self, compensator=compensator, allow=allow)
        VectorWrapper.__init__(self, env)
        _install(_seams(env), compensator, allow)
        self._compensator = compensator

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Step the environments; where episodes end, add to `infos` the bounds that `CompensationWrapper.step` adds.

        If episodes begin within the same step, the entries are in `final_info`, like all infos of the ended episodes.
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
        """Close the environments, passing on ``arguments``, and remove the compensator."""
        _remove(_seams(self.env))
        super().close(**arguments)


def _within95(compensator: Compensate, commands: NDArray[Any]) -> dict[str, NDArray[Any]]:
    """Return the bounds that 95 % of the calibrated arm's errors stay below, by their names in `info`.

    The bounds hold at the joint commands ``(..., n)``, rad or m. The result is empty if the calibration has no bounds.
    """
    quantile = getattr(compensator, "within95", None)
    position, attitude = (None, None) if quantile is None else quantile(commands.astype(float))
    within = {} if position is None else {"within95_mm": np.asarray(position) * 1e3}
    return within | ({} if attitude is None else {"within95_deg": np.degrees(attitude)})


def _numpy(values: Any) -> NDArray[Any]:
    """Convert an array, or a tensor on any device, to a NumPy array."""
    return np.asarray(values.cpu() if hasattr(values, "cpu") else values)


def _seams(env: VectorEnv[Any, Any, Any]) -> list[Any]:
    """Return the objects that store a vector environment's compensator (its seams).

    They are the innermost vector environment itself if it is native, else each of its single environments.
    """
    inner: Any = env.unwrapped
    return [single.unwrapped for single in inner.envs] if hasattr(inner, "envs") else [inner]


def _install(seams: Sequence[Any], compensator: Compensate, allow: Collection[str]) -> None:
    if not callable(compensator):
        raise InputError(
            f"the compensator is a {type(compensator).__name__}; give one for all environments, or set the attribute "
            "compensator of the environments to a list with one for each"
        )
    obey(getattr(compensator, "reservations", {}), allow)
    if (caution := getattr(compensator, "caution", None)) is not None:
        gym.logger.warn("%s", caution)  # a "%" in it is no format
    for seam in seams:
        if not hasattr(seam, "compensator"):
            raise InputError(f"{type(seam).__name__} has no compensation seam; wrap a pickenv environment")
        if seam.compensator is not None:
            raise InputError(f"{type(seam).__name__} already has a compensator; wrap it once")
        arm, check = getattr(getattr(seam, "plant", None), "arm", None), getattr(compensator, "refuse_another", None)
        if arm is not None and check is not None:
            check(arm)
    for seam in seams:
        seam.compensator = compensator


def _remove(seams: Sequence[Any]) -> None:
    for seam in seams:
        seam.compensator = None
