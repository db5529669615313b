"""`pickenv/ReachIdeal-v0`: the reach task with an arm that is exactly what its controller believes."""

from __future__ import annotations

from typing import Any

from pickenv.arm.plant.named_plants import IDEAL
from pickenv.envs.reaching.reach import ReachEnv


class ReachIdealEnv(ReachEnv):
    """Bring the tool to a fruit with a perfect arm: the oracle for integrators.

    ## Description

    `pickenv/Reach-v0` with `plant="ideal"`: the true arm is the nominal one, nothing bends, nothing drifts. A policy
    that ends where it believes to be ends on the fruit, so whatever error remains is the policy's or the integration's
    own; a test of one's own code can ask for exactly zero.

    ## Action Space

    `Box(-1, 1, (6,), float32)`: joint increments, as in `pickenv/Reach-v0`.

    ## Observation Space

    `Box(float32)`, 18 or 21 numbers, as in `pickenv/Reach-v0`.

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
    >>> env = gym.make("pickenv/ReachIdeal-v0")
    >>> goal = [0.1, 0.2, 0.3, 0.1, 0.05, 0.2]
    >>> observation, info = env.reset(seed=1, options={"goal_joints": goal, "start_joints": goal})
    >>> info["position_error_mm"], info["is_success"]
    (0.0, True)

    ```

    Those of `pickenv/Reach-v0` without `plant` and `without`.

    ## Version History

    * v0: First version.
    """

    def __init__(self, **arguments: Any) -> None:
        """See the class for the arguments; raises `InputError` for impossible ones."""
        super().__init__(**{"plant": IDEAL, **arguments})
