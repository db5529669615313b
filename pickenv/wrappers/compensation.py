"""A calibration between policy and arm: the joint target goes through a compensator before it reaches the drives."""

from __future__ import annotations

from typing import Any, Protocol, TypeVar

import gymnasium as gym
import numpy as np
from gymnasium.utils import RecordConstructorArgs
from numpy.typing import NDArray

from pickenv.errors import InputError

Observation = TypeVar("Observation")
Action = TypeVar("Action")


class Compensator(Protocol):
    """Maps joint targets ``(..., n)`` for the nominal arm to joint commands ``(..., n)`` for the real one (rad, m)."""

    def __call__(self, joints: NDArray[np.float64], /) -> NDArray[np.float64]:
        """The joint commands."""
        ...


class CompensationWrapper(gym.Wrapper[Observation, Action, Observation, Action], RecordConstructorArgs):
    """Correct the joint target on its way to the drives, invisibly to the policy.

    Spaces, seeds, episode flow and observations stay as they are: joint readings are mapped back to nominal joints, so
    a policy that servoes on its believed tool position does not cancel the compensation. The compensator sits at the
    environment's one seam, so the wrapper's place in a stack of wrappers does not matter; closing removes it.

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

    def __init__(self, env: gym.Env[Observation, Action], compensator: Compensator) -> None:
        """Install ``compensator`` in ``env``.

        Raises:
            InputError: If the environment has no compensation seam, or already holds a compensator.
        """
        RecordConstructorArgs.__init__(self, compensator=compensator)
        gym.Wrapper.__init__(self, env)
        inner: Any = env.unwrapped
        if not hasattr(inner, "compensator"):
            raise InputError(f"{type(inner).__name__} has no compensation seam; wrap a pickenv environment")
        if inner.compensator is not None:
            raise InputError(f"{type(inner).__name__} already has a compensator; wrap it once")
        inner.compensator = compensator

    def close(self) -> None:
        """Close the environment and remove the compensator."""
        inner: Any = self.env.unwrapped
        inner.compensator = None
        super().close()
