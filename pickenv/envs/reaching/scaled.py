"""`pickenv/ReachScaled-v0` and `pickenv/ReachTool-v0`: reaching with observations and actions scaled for learning."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pickenv.base import InputError
from pickenv.envs.reaching.reach import ReachEnv
from pickenv.envs.reaching.vector import ReachVectorEnv
from pickenv.envs.shared.arm_env import Information
from pickenv.envs.shared.native_vector import set_spaces
from pickenv.envs.shared.simulation import View
from pickenv.envs.shared.spaces import scaling_of
from pickenv.envs.shared.task import make_tool_task


class ReachScaledEnv(ReachEnv):
    """`pickenv/Reach-v0` with the gap given by direction and logarithm, and actions that shrink with the gap.

    ## Description

    Arm, plant (the true arm with its errors), fruit, reward, information and arguments are as in `pickenv/Reach-v0`.
    The gap is the fruit's pose minus the tool's pose. A network that reads the gap in metres hardly notices
    millimetres, and the noise of its exploration hides them: PPO stays at some 20 mm in `pickenv/Reach-v0`. Here the
    network sees the gap by direction and logarithm, and its actions shrink with the gap. It then becomes so accurate
    that the arm's calibration limits it ("Training a policy" in the documentation has the results).

    ## Action Space

    `Box(-1, 1, (6,), float32)`: joint increments as in `pickenv/Reach-v0`, multiplied by the size of the gap (see
    below) if this size is below one.

    ## Observation Space

    `Box(float32)`, 13 numbers. The size of the gap is the larger of two ratios: the gap's position over 100 mm and
    the gap's attitude over 0.2 rad. The size is at least 1e-6.

    | Num   | Observation                                                         | Min | Max | Unit         |
    |-------|---------------------------------------------------------------------|-----|-----|--------------|
    | 0-5   | joint readings, scaled to the limits                                | -1  | 1   | 1            |
    | 6-8   | gap in position, believed or measured by the camera, over size      | -1  | 1   | 100 mm       |
    | 9-11  | rotation vector from believed to wanted attitude, over size         | -1  | 1   | 0.2 rad      |
    | 12    | half the decimal logarithm of the size                              | -3  | 3   | 1            |

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

    The arguments of `pickenv/Reach-v0`.

    ## Version History

    * v0: First version.
    """

    def __init__(self, **arguments: Any) -> None:
        """See the class for the arguments; raises `InputError` for values that are not allowed."""
        super().__init__(**arguments)
        self.scaling = scaling_of(self.task)
        self.observation_space = self.scaling.space
        self.raw: Any = np.zeros(self.scaling.inputs, dtype=np.float32)  # as `pickenv/Reach-v0` gives it

    def step(self, action: ArrayLike) -> tuple[Any, float, bool, bool, Information]:
        """Scale the action by the size of the gap, and act as `pickenv/Reach-v0` does.

        Raises:
            InputError: As in `pickenv/Reach-v0`.
        """
        return super().step(self.scaling.act(self.raw, action, self.task.most_action))

    def _observe(self, scene: View) -> tuple[Any, float]:
        self.raw, reward = super()._observe(scene)
        return self.scaling.shown(self.raw), reward


class ReachScaledVectorEnv(ReachVectorEnv):
    """N `pickenv/ReachScaled-v0` in one vector environment, on NumPy; see `pickenv.envs.ReachVectorEnv`.

    Attributes:
        raw: The latest observations, as `pickenv/Reach-v0` gives them.
    """

    def __init__(self, num_envs: int = 1, **arguments: Any) -> None:
        super().__init__(num_envs, **arguments)
        if self.metadata["torch"]:
            raise InputError("scaled observations are made on NumPy; give executor='numpy'")
        self.scaling = scaling_of(self.task)
        set_spaces(self, self.scaling.space, self.single_action_space)
        self.raw: Any = np.zeros((self.num_envs, self.scaling.inputs), dtype=np.float32)

    def state_arrays(self) -> dict[str, NDArray[Any]]:
        """Return all arrays that the next step depends on; see `ReachVectorEnv.state_arrays`."""
        return super().state_arrays() | {"raw": np.array(self.raw)}

    def take_state_arrays(self, state: dict[str, NDArray[Any]]) -> None:
        """Restore the arrays that `state_arrays` of an environment with the same arguments returned."""
        super().take_state_arrays(state)
        self.raw = state["raw"].copy()

    def _checked(self, actions: ArrayLike) -> Any:
        return super()._checked(self.scaling.act(self.raw, actions, self.task.most_action))

    def _observation(self) -> Any:
        self.raw = super()._observation()
        return self.scaling.shown(self.raw)


class ReachToolEnv(ReachScaledEnv):
    """Bring the tool to a fruit by increments of the tool's pose: a task that PPO learns on any arm.

    ## Description

    Plant (the true arm with its errors), fruit, information and score are as in `pickenv/Reach-v0`. But an action is
    a motion of the tool, which the nominal arm's Jacobian turns into joint increments. Observations and actions are the
    same for every arm, so that a policy trained on one arm can act on another.

    ## Action Space

    `Box(-1, 1, (6,), float32)`: increments of the believed tool per period. Increments and gap are in the base frame.
    If the size of the gap (see below) is below one, the increments are multiplied by this size. Then an action equal to
    the gap in the observation closes the gap.

    | Num | Action                         | Control Min | Control Max | Largest increment | Unit |
    |-----|--------------------------------|-------------|-------------|-------------------|------|
    | 0-2 | tool along x, y, z             | -1          | 1           | 25                | mm   |
    | 3-5 | tool about x, y, z             | -1          | 1           | 10                | deg  |

    With `actions="position"` an action has only the first three numbers, for arms of three joints and more. Damped
    least squares with the nominal Jacobian turn an action into joint increments (Wampler 1986). If a joint would exceed
    its largest increment, all joints are slowed by one factor. Joints stay within their limits.

    ## Observation Space

    `Box(float32)`, 7 numbers. The size of the gap is the larger of two ratios: the gap's position over 25 mm and the
    gap's attitude over 10 deg. The size is at least 1e-6. With `actions="position"` there are 4 numbers, because the
    attitude is left out.

    | Num | Observation                                                         | Min | Max | Unit         |
    |-----|---------------------------------------------------------------------|-----|-----|--------------|
    | 0-2 | gap in position, believed or measured by the camera, over size      | -1  | 1   | 25 mm        |
    | 3-5 | rotation vector from believed to wanted attitude, over size         | -1  | 1   | 10 deg       |
    | 6   | half the decimal logarithm of the size                              | -3  | 3   | 1            |

    ## Rewards

    As in `pickenv/Reach-v0`. With `actions="position"` the goal has no attitude. Then attitude counts neither in the
    reward nor in `is_success`.

    ## Starting State

    Starts and goals lie in a box of joint positions. Its middle is an upright pose from which the tool moves freely in
    every direction, and `goal_spread` sets its width. The arm starts in the middle, or with `start_spread` at random in
    that share of the box. Wanted poses are drawn as joints in the box, such that the tool points upwards as in
    `pickenv/Reach-v0`. So the arm can reach each pose, and no joint has to turn by more than half a circle.
    `reset(options=...)` takes the options of `pickenv/Reach-v0`.

    ## Episode End

    As in `pickenv/Reach-v0`: truncation after 60 steps.

    ## Arguments

    ```python
    >>> import gymnasium as gym
    >>> import pickenv
    >>> env = gym.make("pickenv/ReachTool-v0", plant="ideal:ur5e")
    >>> observation, info = env.reset(seed=1)
    >>> for _ in range(30):
    ...     observation, _, _, _, info = env.step(observation[:6])
    >>> info["position_error_mm"] < 0.01
    True

    ```

    The arguments of `pickenv/Reach-v0`, and

    - `actions` ("pose" or "position"): whether an action moves the tool in position and attitude, or in position alone.
    - `tool_step_mm` (float, default 25) and `tool_turn_deg` (float, default 10): the largest increments per period.
    - `goal_spread` (above 0, at most 1, default 0.25): edges of the box, as shares of the joints' ranges. A range of
      more than a whole turn counts as a whole turn.

    ## Version History

    * v0: First version.
    """

    task_of = staticmethod(make_tool_task)


class ReachToolVectorEnv(ReachScaledVectorEnv):
    """N `pickenv/ReachTool-v0` in one vector environment, on NumPy; see `pickenv.envs.ReachVectorEnv`."""

    task_of = staticmethod(make_tool_task)
