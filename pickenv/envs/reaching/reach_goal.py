"""`pickenv/ReachGoal-v0`: the reach task with a goal dictionary, for hindsight experience replay (HER)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from pickenv.arm.plant.plant_file import IDEAL
from pickenv.envs.reaching.reach import ReachEnv
from pickenv.envs.shared.backends import NUMPY
from pickenv.envs.shared.simulation import GOAL_NUMBERS, View, goal_observation, goal_reward
from pickenv.envs.shared.spaces import goal_space
from pickenv.envs.shared.task import Task

# `pickenv/ReachIdeal-v0`: the reach task with an arm that is exactly what its controller believes.


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


GOAL_KEYS = ("observation", "achieved_goal", "desired_goal")


class ReachGoalEnv(ReachEnv):
    """Bring the tool to a fruit, and learn from the fruit that it would have reached.

    ## Description

    The arm, the fruit and the plant are those of `pickenv/Reach-v0`; observation and reward differ. The reward is made
    of what a controller can measure, so that a goal can be exchanged afterwards: position and attitude of the tool as
    the chosen feedback measures it, against the fruit as the camera saw it and the attitude that it is to be picked in.
    The truth stays in `info`.

    ## Action Space

    `Box(-1, 1, (6,), float32)`: joint increments, as in `pickenv/Reach-v0`.

    ## Observation Space

    `Dict` of three float32 boxes; positions and axes in the base frame, R as in `pickenv/Reach-v0`. Whatever depends on
    the goal stands in the goals alone, so that hindsight may exchange them.

    `observation`:

    | Num  | Observation                                                           | Min | Max | Unit |
    |------|-----------------------------------------------------------------------|-----|-----|------|
    | 0-5  | joint readings (motor side, as nominal joints), scaled to the limits  | -1  | 1   | 1    |
    | 6-8  | believed tool position (nominal forward kinematics of the readings)   | -R  | R   | m    |

    `achieved_goal`:

    | Num  | Observation                                                           | Min | Max | Unit |
    |------|-----------------------------------------------------------------------|-----|-----|------|
    | 0-2  | tool position as measured by the chosen feedback                      | -R  | R   | m    |
    | 3-5  | believed tool's z axis, the way it points                             | -1  | 1   | 1    |
    | 6-8  | its x axis                                                            | -1  | 1   | 1    |

    With `feedback="encoders"` the position is the believed one; with "camera" it is the fruit as seen, less the
    tool-to-fruit offset that the camera measures (bounds 3R).

    `desired_goal`:

    | Num  | Observation                                                           | Min | Max | Unit |
    |------|-----------------------------------------------------------------------|-----|-----|------|
    | 0-2  | fruit position as the camera saw it                                   | -R  | R   | m    |
    | 3-5  | wanted z axis of the tool                                             | -1  | 1   | 1    |
    | 6-8  | wanted x axis                                                         | -1  | 1   | 1    |

    ## Rewards

    With e the distance between achieved and desired goal in mm and t the angle between their attitudes in degrees, by
    `compute_reward(achieved_goal, desired_goal, info)`, which takes single goals or batches and does not look at
    `info`:

    - sparse (default): 0 while e is within `tolerance_mm` and t within `angle_tolerance_deg`, else -1.
    - dense: as in `pickenv/Reach-v0`.

    ## Starting State

    As in `pickenv/Reach-v0`; the same seed gives the same fruit.

    ## Episode End

    As in `pickenv/Reach-v0`: truncation after 60 steps. `info["is_success"]` judges true tool and true attitude.

    ## Arguments

    ```python
    >>> import gymnasium as gym
    >>> import pickenv
    >>> env = gym.make("pickenv/ReachGoal-v0", feedback="camera", tolerance_mm=20.0)
    >>> observation, info = env.reset(seed=1)
    >>> sorted(observation)
    ['achieved_goal', 'desired_goal', 'observation']
    >>> float(env.unwrapped.compute_reward(observation["achieved_goal"], observation["desired_goal"], info))
    -1.0

    ```

    Those of `pickenv/Reach-v0`; `reward` is "sparse" by default.

    ## Version History

    * v0: First version.
    """

    def __init__(self, *, reward: str = "sparse", **arguments: Any) -> None:
        """See the class for the arguments; raises `InputError` for impossible ones."""
        super().__init__(reward=reward, **arguments)
        self.observation_space = goal_space(self.task)

    def compute_reward(self, achieved_goal: ArrayLike, desired_goal: ArrayLike, info: Any) -> Any:
        """Reward of achieved against desired goals, ``(9,)`` or ``(N, 9)``; a number, or an array ``(N,)``."""
        return rewards_of_goals(self.task, achieved_goal, desired_goal)

    def _observe(self, scene: View) -> tuple[Any, float]:
        parts = (np.array(self._plain(part), dtype=np.float32) for part in goal_observation(scene))
        observation = dict(zip(GOAL_KEYS, parts, strict=True))
        return observation, self.compute_reward(observation["achieved_goal"], observation["desired_goal"], {})


def rewards_of_goals(task: Task, achieved: ArrayLike, desired: ArrayLike) -> Any:
    """Rewards of goals ``(..., 9)`` as they were returned, in float64; every batch gives each row the same bits."""
    one, other = np.asarray(achieved, dtype=np.float64), np.asarray(desired, dtype=np.float64)
    shape = np.broadcast_shapes(one.shape, other.shape)
    have, want = (np.broadcast_to(goals, shape).reshape(-1, GOAL_NUMBERS).T.copy() for goals in (one, other))
    reward = goal_reward(NUMPY, task, list(have), list(want)).reshape(shape[:-1])
    return reward if reward.ndim else float(reward)
