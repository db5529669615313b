"""`pickenv/Reach-v0`: bring the tool to a fruit with an arm that differs slightly from its controller's model."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike

from pickenv.arm import IDEAL, Array, Frame, Scalar, forward
from pickenv.base import InputError
from pickenv.envs.shared import simulation
from pickenv.envs.shared.arm_env import GHOST_WORDS, ArmEnv, Information, begun, standing, tool_dial
from pickenv.envs.shared.backends import GOAL, NUMPY, episode_key, fresh_seed, seed_word, stream_key
from pickenv.envs.shared.difficulty import on_ladder
from pickenv.envs.shared.simulation import ArmState
from pickenv.envs.shared.spaces import action_space, flat_space, given_goals, given_options, goal_space
from pickenv.envs.shared.task import GOAL_ATTEMPTS, OF_TASKS, Task, checked_action, make_task, refuse_unknown
from pickenv.pictures import shapes
from pickenv.pictures.stage import SIZE, Stage, Words, fitted_eye

# A reach as a stage to draw. Units: m; mm and degrees in words.


FRUIT = 0.06
"""Diameter of the drawn fruit. The reach task itself has only the fruit's position."""


def draw_reach(task: Task, scene: simulation.View, dark: bool) -> Stage:
    """Return the stage to draw for a reach task: the true arm, a ghost of the believed arm, and the fruit.

    The picture shows all that the arm can reach, and its base. The ground is drawn so low that the arm cannot reach it.

    Args:
        task: The task.
        scene: All that is measured and true in the environment now, as floats.
        dark: Whether the background is dark.
    """
    nominal, tolerance_mm = task.plant.arm.nominal, task.tolerance_mm
    look, base = shapes.arm_look(nominal), nominal.base.position
    command, tool, fruit = np.array(scene.command), np.array(scene.tool), np.array(scene.fruit)
    axis = forward(nominal, command).rotation[:, 2]
    distance_mm, angle_deg, *_ = scene.numbers
    solids = shapes.joined_solids(
        shapes.arm_at_work(nominal, command, tool, axis, np.array(scene.believed)),
        shapes.cup_solids(tool, axis, shapes.CUP_RADIUS),
        shapes.fruit_solids(fruit[None], FRUIT, shapes.fruit_colours(1)),
        shapes.sprig(fruit, FRUIT),
    )
    words = (
        Words(f"{distance_mm:.2f} mm, {angle_deg:.2f}° from the fruit", large=True),
        Words(f"green ring: {tolerance_mm:g} mm", "bottom left"),
        Words(GHOST_WORDS, "bottom left"),
    )
    still = standing(nominal, float(min(look.low[2] - 0.1, base[2] - 0.35)), dark)
    box = np.stack([np.minimum(look.low, base), np.maximum(look.high, base)], axis=-1)
    eye = fitted_eye(np.array(np.meshgrid(*box)).reshape(3, -1).T, VIEW, SIZE)
    dial = tool_dial(axis, tool - fruit, tolerance_mm)
    return Stage(eye, *solids, still=still, words=words, dial=dial, dark=dark)


VIEW: Array = np.array([0.8, 1.0, 0.45])
"""Direction from the arm to the viewpoint, base frame."""


class ReachEnv(ArmEnv):
    """Bring the tool to a fruit, in the wanted attitude, with an arm that differs from its controller's model.

    ## Description

    A six-joint picking arm (Qiao 2026: pitch, horizontal rail, telescopic boom, end rotation, end slide, twist) must
    bring its tool to a fruit, in the wanted attitude. The policy commands the *nominal* arm, that is the model that the
    controller believes in. But the *true* arm moves. Its parts are off by tenths of millimetres, and its joints and
    boom bend. The score is the distance of the true tool from the fruit, which the policy never sees.

    ## Action Space

    `Box(-1, 1, (6,), float32)`: joint increments, as shares of the largest increment per control period of 0.1 s.

    | Num | Action            | Control Min | Control Max | Largest increment | Unit |
    |-----|-------------------|-------------|-------------|-------------------|------|
    | 0   | J1 pitch          | -1          | 1           | 6                 | deg  |
    | 1   | J2 horizontal rail| -1          | 1           | 50                | mm   |
    | 2   | J3 telescopic boom| -1          | 1           | 50                | mm   |
    | 3   | J4 end rotation   | -1          | 1           | 6                 | deg  |
    | 4   | J5 end slide      | -1          | 1           | 50                | mm   |
    | 5   | J6 twist          | -1          | 1           | 18                | deg  |

    The environment adds the increments to a nominal joint target, keeps the target inside the joint limits, and hands
    it to the drives. If `pickenv.wrappers.CompensationWrapper` has installed a compensator, the compensator corrects
    the target first.

    ## Observation Space

    `Box(float32)`, 18 numbers, or 21 with `feedback="camera"`. Of these numbers, only the camera's offset depends on
    the true arm. Positions and attitudes are in the base frame.

    | Num   | Observation                                                          | Min  | Max  | Unit |
    |-------|----------------------------------------------------------------------|------|------|------|
    | 0-5   | joint readings (motor side, as nominal joints), scaled to the limits | -1   | 1    | 1    |
    | 6-8   | believed tool position (nominal forward kinematics of the readings)  | -R   | R    | m    |
    | 9-11  | fruit position as the camera saw it                                  | -R   | R    | m    |
    | 12-14 | fruit minus believed tool position                                   | -2R  | 2R   | m    |
    | 15-17 | rotation vector from believed to wanted attitude                     | -pi  | pi   | rad  |
    | 18-20 | fruit minus true tool position as the camera measures it (camera)    | -2R  | 2R   | m    |

    R is an upper bound of the arm's reach plus 1 m. "Believed" means computed with the nominal arm.

    ## Rewards

    Let e be the distance between true tool and fruit in mm, and t the angle between true and wanted attitude in
    degrees.

    - dense (default): -log10(1 + e) - 0.5 log10(1 + t). Outside the capture region (e above `tolerance_mm`, or t above
      `angle_tolerance_deg`), 1.30 (the cost at both default tolerances) is subtracted as well, so that every failure
      scores below every success. The reward goes from about -5.7 (far away) to 0 (perfect). Well above a millimetre,
      reducing e tenfold adds about 1, whatever e is.
    - sparse: 0 while the fruit is inside the capture region, else -1.

    ## Starting State

    All joints start at mid-range, or at random with `start_spread`. Wanted poses are drawn from the nominal arm's joint
    ranges, 5 % away from the limits. The tool then points upwards within `max_tilt_deg`, since the arm picks from
    below. A plant, that is a model of the true arm, may have memory (backlash, vibration, warm-up). It starts at rest,
    cold and not yet sunk into the ground, or as it is after `hours_on`. `reset(options=...)` takes

    - `"start_joints"` (rad and m);
    - the goal as one of `"goal_joints"` (rad and m), `"goal_position"` (x, y, z in m; the attitude is the one with
      which the arm gets there, within `max_tilt_deg`) and `"goal_pose"` (x, y, z and a rotation vector, m and rad; the
      part of the rotation that the arm cannot reach counts as `noncompensable_deg`), in the base frame;
    - if `arms` is not "fixed", `"arm"`, the index of the arm in the population, from 0.

    Every random number is a hash of the seed and the episode's index (`pickenv.envs.shared.backends`). A reset without
    a seed begins the next episode of the last seed. An environment gives the same episodes alone, in a `SyncVectorEnv`
    and in the native vector environment.

    ## Episode End

    - Termination: never, unless `end_on_success` is True. The task is about final accuracy, so reaching the fruit does
      not end the episode by default.
    - Truncation: after 60 steps (`max_episode_steps` of `gym.make`).

    ## Information

    `info` has the same keys after `reset` and `step`:

    | Key                   | Meaning                                                               | Unit   |
    |-----------------------|-----------------------------------------------------------------------|--------|
    | `position_error_mm`   | distance between true tool and fruit; joints can remove all of it     | mm     |
    | `attitude_error_deg`  | angle between true and wanted attitude                                | deg    |
    | `noncompensable_deg`  | the part of that angle which no joint motion removes                  | deg    |
    | `compensable_deg`     | the other part: sqrt(attitude_error^2 - noncompensable^2)             | deg    |
    | `is_success`          | whether the fruit is inside the capture region                        | bool   |
    | `pose_error`          | true tool minus fruit: position, and rotation vector                  | m, rad |
    | `joint_command`       | joint command that the drives got                                     | rad, m |
    | `tool_position`       | true tool position                                                    | m      |
    | `fruit_position`      | true fruit position                                                   | m      |

    ## Arguments

    ```python
    >>> import gymnasium as gym
    >>> import pickenv
    >>> env = gym.make("pickenv/Reach-v0", plant="geometry_only", tolerance_mm=2.0)
    >>> observation, info = env.reset(seed=1)
    >>> observation.shape
    (18,)

    ```

    - `plant` (str, default "qiao2026"): preset or path of a plant file, which describes the true arm. "geometry_only"
      has only the geometric errors of Table 1, "ideal" no error at all. "ideal:ur5e" is another arm without error: one
      that ships with pickenv (`pickenv arms`) or one from a file ("ideal:my.urdf#flange"). "coarse:ur5e" is an arm with
      errors of a tolerance class (geometry, compliance, backlash and heat), drawn with `population_seed`.
    - `without` (sequence of str): effects of the plant to switch off.
    - `feedback` ("encoders" or "camera"): whether the camera's tool-to-fruit offset is part of the observation.
    - `camera_noise_mm` (float, 0 to 100, default 0): standard deviation per axis of the tool-to-fruit offset that the
      camera measures in every step, and of the fruit's position unless `fruit_noise_mm` is given.
    - `fruit_noise_mm` (float, 0 to 100, default None): standard deviation per axis of the fruit's position as the
      camera saw it, which is drawn once per episode.
    - `tolerance_mm` (float, default 5): radius of the gripper's capture region; 5 mm is the clearance of Li's cup.
    - `angle_tolerance_deg` (float, default 10): attitude tolerance of the capture region.
    - `reward` ("dense" or "sparse").
    - `max_tilt_deg` (float, default None): largest angle between the wanted tool axis and the vertical. None means 30,
      or 60, 90, … for an arm that cannot point its tool up so far.
    - `end_on_success` (bool, default False): whether the first step inside the capture region ends the episode.
    - `arms` ("fixed", "per_env" or "per_episode"): the plant's own true arm, or one of a population, chosen once per
      environment or anew in every episode. Three arguments define the population: `tolerances` (class or file, default
      "medium"; a class that `plant` names takes precedence), `population` (int, default 256: its size) and
      `population_seed` (int, default 0). Judge a policy on a population that it never saw.
    - `out_of_range` ("clip" or "refuse"): whether actions beyond -1 to 1, as networks without bounds give them, are
      clipped to this range or raise an error. Numbers that are not finite always raise an error.
    - `goal_region` (two corners [[x, y, z], [x, y, z]] of a box, m, base frame, default None): where goals are drawn.
    - `control_period_s` (s, 0.001 to 10, default 0.1): time between two actions. The largest increment is proportional
      to it.
    - `latency` (whole periods, 0 to 20, default 0): how late readings of joints and camera arrive.
    - `action_delay` (whole periods, 0 to 20, default 0): how late actions take effect.
    - `joint_noise` (mrad of joints that turn, mm of slides; 0 to 100, default 0): standard deviation of each
      joint reading.
    - `hours_on` (h, 0 to 1000, default 0): how long the arm has been switched on, at rest, when an episode begins.
    - `start_spread` (0 to 1, default 0): share of each joint's range, about mid-range, from which starts are drawn.

    Instead of a number, `control_period_s`, `latency`, `action_delay`, `joint_noise` and `hours_on` may be a range,
    [least, largest], from which every episode draws a number.

    - `difficulty` (None, "ideal", "fine", "coarse", "orchard", "day" or "own_eyes"): a named difficulty
      (`pickenv.envs.shared.difficulty`), which fixes the arguments of plant, arms, camera, delays, noise and start.
    - `split` ("train" or "test"): which of the difficulty's two disjoint populations of arms is used.
    - `executor` ("auto", "compiled", "floats" or "numpy"): how steps are computed. "compiled" uses machine code, which
      needs llvmlite of the extra `pickenv[compiled]`. "floats" uses Python's floats, with the same results up to
      rounding (1e-12). "auto" (default) is "compiled" if llvmlite is installed, `arms` is "fixed" and the plant has
      no effects from other packages, else "floats". "numpy" gives the same bits as the native vector environment on
      NumPy.
    - `render_mode` (None, "human" or "rgb_array").

    `gym.make_vec("pickenv/Reach-v0", num_envs=4096)` makes the native vector environment,
    `pickenv.envs.reaching.vector.ReachVectorEnv`, which takes the same arguments and more.

    ## Version History

    * v0: First version.
    """

    task_of: Callable[..., Task] = staticmethod(make_task)  # from the environment's arguments

    def __init__(self, *, executor: str = "auto", render_mode: str | None = None, **arguments: Any) -> None:
        """See the class for the arguments; raises `InputError` for values that are not allowed."""
        refuse_unknown(self, arguments, on_ladder, self.task_of, *OF_TASKS)
        super().__init__(self.task_of(**on_ladder("Reach", **arguments)), render_mode, executor)
        self.observation_space: spaces.Space[Any] = flat_space(self.task)
        self.action_space: Any = action_space(self.task)
        self._stream: int | None = None
        self._episode = 0
        self._scene: simulation.View | None = None

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, Information]:
        """Start an episode; see the class for `options`."""
        super().reset(seed=seed)
        options = given_options(options)
        if seed is not None or self._stream is None:
            number = self.np_random_seed
            self._stream = seed_word(number if number is not None and number >= 0 else fresh_seed(self.np_random))
            self._episode = 0
        else:
            self._episode += 1
        x, task = self._x, self.task
        self._key = episode_key(x, self._word(self._stream), self._word(self._episode))
        arm = options.get("arm")
        if arm is None and task.arms != "fixed":
            (arm,) = self._plain((simulation.drawn_arm(x, task, self._word(self._stream), self._key),))
            arm = int(arm)
        if arm is not None:
            self._use_arm(task.given_arm(arm))
        start = self._start(options.get("start_joints"))
        goal = self._wanted(options)
        state = simulation.begin(x, task, self.plant, self._key, start, goal, self._command(start))
        self._step = 0
        observation, _, information = self._look(state, 0.0)
        return observation, information

    def step(self, action: ArrayLike) -> tuple[Any, float, bool, bool, Information]:
        """Move the joint target by `action`, and measure the tool's true pose after one period.

        Raises:
            InputError: If the action has another shape or numbers that are not finite, if its numbers are beyond -1 to
                1 with `out_of_range="refuse"`, or if `reset` was not called before.
        """
        values = checked_action(action, (self.task.actions,), self.task.most_action)
        state = simulation.act(self._x, self.task, begun(self._state, "step"), self._numbers(values.tolist()))
        self._step += 1
        observation, reward, information = self._look(state, self.task.situation.value("period", state.drawn))
        return observation, reward, self.task.end_on_success and information["is_success"], False, information

    def _stage(self) -> Stage | None:
        if self._scene is None:
            return None
        parts = [self._plain(part) if isinstance(part, tuple) else self._plain((part,))[0] for part in self._scene]
        scene = simulation.View(*parts)  # type: ignore[arg-type]
        return draw_reach(self.task, scene, self.dark)

    def _observe(self, scene: simulation.View) -> tuple[Any, float]:
        """Return the observation and the reward from ``scene``, which has all that is measured and true now.

        Subclasses with other observations override this method.
        """
        reward: Scalar = simulation.true_reward(self._x, self.task, scene)
        return np.array(self._plain(simulation.flat_observation(scene)), dtype=np.float32), self._plain((reward,))[0]

    def _look(self, state: ArmState, dt: Scalar) -> tuple[Any, float, Information]:
        """Hold the joint target of ``state`` for ``dt`` seconds, and return observation, reward and `info`."""
        plain, (scene, _) = self._plain, self._looked(state, self._step, dt)
        self._scene = scene
        if self.render_mode == "human":
            self.render()
        observation, reward = self._observe(scene)
        information: Information = {
            **dict(zip(simulation.NUMBER_KEYS, plain(scene.numbers), strict=True)),
            "is_success": bool(scene.success),
            "pose_error": np.array(plain(scene.error)),
            "joint_command": np.array(plain(scene.command)),
            "tool_position": np.array(plain(scene.tool)),
            "fruit_position": np.array(plain(scene.fruit)),
        }
        return observation, reward, information

    def _wanted(self, options: dict[str, Any]) -> Frame:
        """Return the frame of the wanted pose: from the options, or else the first drawn pose that fits the task."""
        x, task = self._x, self.task
        joints, frame = given_goals(task, options)
        if frame is not None:
            return tuple(self._numbers(frame.tolist()))
        if joints is not None:
            return simulation.nominal_frames(x, task, self._numbers(joints.tolist()))[1]
        stream = stream_key(x, self._key, GOAL)
        for attempt in range(GOAL_ATTEMPTS):
            pose, fits = simulation.goal_attempt(x, task, stream, attempt)
            if fits:
                return simulation.nominal_frames(x, task, pose)[1]
        raise task.no_goal()


# `pickenv/ReachGoal-v0`: the reach task with a goal dictionary, for hindsight experience replay (HER).


# `pickenv/ReachIdeal-v0`: the reach task with an arm that is exactly what its controller believes.


class ReachIdealEnv(ReachEnv):
    """Bring the tool to a fruit with an arm without error: a reference to test other code against.

    ## Description

    `pickenv/Reach-v0` with `plant="ideal"`: the true arm equals the nominal arm, nothing bends, nothing drifts. The
    believed tool is always the true tool. So any error that remains comes from the policy or from the code around it.
    A test can require an error of exactly zero.

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

    The arguments of `pickenv/Reach-v0`. But `plant` may only be "ideal" or "ideal:ARM", and there are no populations.

    ## Version History

    * v0: First version.
    """

    def __init__(self, **arguments: Any) -> None:
        """See the class for the arguments; raises `InputError` for values that are not allowed."""
        super().__init__(**{"plant": IDEAL, **arguments})
        check_ideal(self.task)


def check_ideal(task: Task) -> None:
    """Raise an `InputError` unless the true arm of ``task`` equals the nominal arm."""
    plant = task.plant
    if task.arms != "fixed" or plant.effects or plant.load or plant.geometry is not plant.arm.nominal:
        raise InputError(f"the arms of '{plant.name}' have errors; take pickenv/Reach-v0, or the plant 'ideal:ARM'")


GOAL_KEYS = ("observation", "achieved_goal", "desired_goal")


class ReachGoalEnv(ReachEnv):
    """Bring the tool to a fruit, with goals that hindsight experience replay (HER) can exchange.

    ## Description

    Arm, fruit and plant (the true arm with its errors) are as in `pickenv/Reach-v0`; observation and reward differ.
    The reward is computed from what a controller can measure, so that a goal can be exchanged afterwards. It compares
    the tool's position and attitude, as the chosen feedback measures them, with the fruit as the camera saw it and the
    wanted attitude. The errors of the true tool are in `info`.

    ## Action Space

    `Box(-1, 1, (6,), float32)`: joint increments, as in `pickenv/Reach-v0`.

    ## Observation Space

    `Dict` of three float32 boxes; positions and axes are in the base frame, R is as in `pickenv/Reach-v0`. The entry
    `observation` does not depend on the goal, so that hindsight may exchange goals.

    `observation`:

    | Num  | Observation                                                           | Min | Max | Unit |
    |------|-----------------------------------------------------------------------|-----|-----|------|
    | 0-5  | joint readings (motor side, as nominal joints), scaled to the limits  | -1  | 1   | 1    |
    | 6-8  | believed tool position (nominal forward kinematics of the readings)   | -R  | R   | m    |

    `achieved_goal`:

    | Num  | Observation                                                           | Min | Max | Unit |
    |------|-----------------------------------------------------------------------|-----|-----|------|
    | 0-2  | tool position as measured by the chosen feedback                      | -R  | R   | m    |
    | 3-5  | believed tool's z axis, in which it points                            | -1  | 1   | 1    |
    | 6-8  | believed tool's x axis                                                | -1  | 1   | 1    |

    With `feedback="encoders"` the position is the believed one; with "camera" it is the fruit as seen minus the
    tool-to-fruit offset that the camera measures (bounds 3R).

    `desired_goal`:

    | Num  | Observation                                                           | Min | Max | Unit |
    |------|-----------------------------------------------------------------------|-----|-----|------|
    | 0-2  | fruit position as the camera saw it                                   | -R  | R   | m    |
    | 3-5  | wanted z axis of the tool                                             | -1  | 1   | 1    |
    | 6-8  | wanted x axis of the tool                                             | -1  | 1   | 1    |

    ## Rewards

    `compute_reward(achieved_goal, desired_goal, info)` computes rewards for single goals or batches, and ignores
    `info`. Let e be the distance between achieved and desired goal in mm, and t the angle between their attitudes in
    degrees.

    - sparse (default): 0 while e is within `tolerance_mm` and t within `angle_tolerance_deg`, else -1.
    - dense: as in `pickenv/Reach-v0`.

    ## Starting State

    As in `pickenv/Reach-v0`; the same seed gives the same fruit.

    ## Episode End

    As in `pickenv/Reach-v0`: truncation after 60 steps. `info["is_success"]` judges the true tool and its attitude.

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

    The arguments of `pickenv/Reach-v0`; `reward` is "sparse" by default.

    ## Version History

    * v0: First version.
    """

    def __init__(self, *, reward: str = "sparse", **arguments: Any) -> None:
        """See the class for the arguments; raises `InputError` for values that are not allowed."""
        super().__init__(reward=reward, **arguments)
        self.observation_space = goal_space(self.task)

    def compute_reward(self, achieved_goal: ArrayLike, desired_goal: ArrayLike, info: Any) -> Any:
        """Compute the reward from the gap between achieved and desired goals.

        Args:
            achieved_goal: Achieved goals ``(9,)`` or ``(N, 9)``, as in observations.
            desired_goal: Desired goals ``(9,)`` or ``(N, 9)``.
            info: Ignored.

        Returns:
            A float for single goals, else an array ``(N,)``.
        """
        return rewards_of_goals(self.task, achieved_goal, desired_goal)

    def _observe(self, scene: simulation.View) -> tuple[Any, float]:
        parts = (np.array(self._plain(part), dtype=np.float32) for part in simulation.goal_observation(scene))
        observation = dict(zip(GOAL_KEYS, parts, strict=True))
        return observation, self.compute_reward(observation["achieved_goal"], observation["desired_goal"], {})


def rewards_of_goals(task: Task, achieved: ArrayLike, desired: ArrayLike) -> Any:
    """Compute rewards, in float64, from achieved and desired goals ``(..., 9)`` of observations.

    The reward of a goal has the same bits whatever batch the goal is in.
    """
    pair = [np.asarray(goals, dtype=np.float64) for goals in (achieved, desired)]
    shape = np.broadcast_shapes(*(goals.shape for goals in pair))
    have, want = (np.broadcast_to(goals, shape).reshape(-1, simulation.GOAL_NUMBERS).T.copy() for goals in pair)
    reward = simulation.goal_reward(NUMPY, task, list(have), list(want)).reshape(shape[:-1])
    return reward if reward.ndim else float(reward)
