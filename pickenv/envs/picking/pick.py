"""`pickenv/Pick-v0`: pick a canopy's fruit one after the other, in limited time, with an arm that is not exact."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pickenv.arm import Scalar
from pickenv.envs.picking.canopies import Canopies, draw_pick
from pickenv.envs.picking.pick_arm import TOOL, act_arm, look_at_arm, reach_of
from pickenv.envs.picking.pick_scene import PICK_OPTIONS, PickScene, draw_starts, given_hours, make_pick, pick_spaces
from pickenv.envs.shared.arm_env import ArmEnv, Information, Options, begun
from pickenv.envs.shared.difficulty import on_ladder
from pickenv.envs.shared.simulation import ArmState, begin
from pickenv.envs.shared.spaces import given_options
from pickenv.envs.shared.task import OF_TASKS, checked_action, refuse_unknown
from pickenv.pictures.stage import Stage


class PickEnv(ArmEnv):
    """Pick the fruit in front of the arm one by one: approach from below, settle, grasp, twist and retreat.

    ## Description

    A six-joint picking arm (Qiao 2026) stands in front of a section of canopy, 0.9 m wide and 0.8 m high, that holds
    some ten fruit. The environment chooses the present fruit, which is to be picked next, among the fruit that the
    camera found within reach and that was not tried yet. By default it is the fruit nearest to the believed tool (see
    `order`). Each fruit can be tried once. The policy commands the *nominal* arm, that is the model that its controller
    believes in. But the *true* arm moves. It also vibrates after every move, so that haste costs accuracy. The gripper
    takes a fruit if the true tool is near enough to it. A failed grasp pushes neighbouring fruit aside. A touch by the
    tool on its way pushes fruit aside too. The pushed fruit swings for a while.

    ## Action Space

    `Box(-1, 1, (7,), float32)`: joint increments as in `pickenv/Reach-v0`, and the gripper.

    | Num | Action            | Control Min | Control Max | Largest increment | Unit |
    |-----|-------------------|-------------|-------------|-------------------|------|
    | 0   | J1 pitch          | -1          | 1           | 6                 | deg  |
    | 1   | J2 horizontal rail| -1          | 1           | 50                | mm   |
    | 2   | J3 telescopic boom| -1          | 1           | 50                | mm   |
    | 3   | J4 end rotation   | -1          | 1           | 6                 | deg  |
    | 4   | J5 end slide      | -1          | 1           | 50                | mm   |
    | 5   | J6 twist          | -1          | 1           | 18                | deg  |
    | 6   | gripper           | -1          | 1           | see below         | 1    |

    Above 0.5 an empty gripper closes at the end of the period, if the believed tool is within 60 mm of the fruit as
    seen. This is the fruit's only attempt. With a fruit in the gripper, a positive command twists, by up to 0.5 N m at
    1. Below -0.5 the gripper opens. A fruit on its stem then swings back; a detached fruit falls and is damaged. A
    detached fruit is collected once the believed tool has gone 80 mm down.

    ## Observation Space

    `Box(float32)`, 23 numbers, or 26 with `feedback="gripper"`. The first 18 are laid out as in `pickenv/Reach-v0`, so
    that a reach policy can be reused. Only the gripper's sensors (20-25) depend on where the true tool is. All vectors
    are in the base frame.

    | Num   | Observation                                                          | Min  | Max  | Unit |
    |-------|----------------------------------------------------------------------|------|------|------|
    | 0-5   | joint readings (motor side, as nominal joints), scaled to the limits | -1   | 1    | 1    |
    | 6-8   | believed tool position (nominal forward kinematics of the readings)  | -R   | R    | m    |
    | 9-11  | position of the present fruit as the camera saw it                   | -R   | R    | m    |
    | 12-14 | that position minus believed tool position                           | -2R  | 2R   | m    |
    | 15-17 | shortest rotation vector from believed attitude to upright           | -pi  | pi   | rad  |
    | 18    | time since the joint target moved, at most 1 s                       | 0    | 1    | s    |
    | 19    | share of 400 steps that is left                                      | 0    | 1    | 1    |
    | 20    | a fruit is in the gripper and on its stem                            | 0    | 1    | 1    |
    | 21    | a fruit is in the gripper and off its stem                           | 0    | 1    | 1    |
    | 22    | number of fruit still to try, divided by 50                          | 0    | 1    | 1    |
    | 23-25 | held fruit minus tool position, as the gripper measures it           | -0.1 | 0.1  | m    |

    R is an upper bound of the arm's reach plus 1 m. A tool is upright if it points straight up.

    ## Rewards

    Per step: 1 x (fruit collected undamaged) - 0.25 x (fruit newly damaged) - 0.002. Fruit is damaged by a tool that
    hits it faster than 0.4 m/s, by being pulled off instead of twisted, and by falling. The reward is never part of an
    observation.

    So haste costs more than the time it saves. The scripted policy moves gently, waits half a second before each grasp,
    and has a calibrated arm. The table shows what the policy loses without these, on 60 canopies of some seven fruit in
    reach (simulated; mean and 95 % interval per canopy, tests/envs/picking/test_pick.py):

    | What is left out                 | Fruit collected        | Reward                 |
    |----------------------------------|------------------------|------------------------|
    | waiting for the arm to settle    | -0.27 (-0.40 to -0.13) | -0.18 (-0.31 to -0.05) |
    | waiting and gentle moves         | -0.72 (-0.94 to -0.49) | -0.81 (-1.07 to -0.54) |
    | calibration                      | -0.45 (-0.67 to -0.24) | -0.45 (-0.66 to -0.23) |

    ## Starting State

    All joints start at mid-range, with the arm at rest, cold and not yet sunk into the ground. Fruit is drawn until at
    least one is in reach. Fruit is in reach if the camera sees it, the upright tool can be there and 100 mm below it,
    and no other fruit is in the way. `reset(options=...)` takes

    - `"fruit"`, positions (n, 3) in the base frame in m;
    - `"start_joints"` (rad and m);
    - `"hours"` (h), for which the arm has been switched on, in place of `hours_on`;
    - if `arms` is not "fixed", `"arm"`, the index of the arm in the population, from 0.

    All random numbers are drawn from `np_random` in `reset`. What happens afterwards depends only on the actions, and a
    seed gives the same fruit to every arm.

    ## Episode End

    - Termination: no fruit is left to be tried, and the gripper is empty.
    - Truncation: after 400 steps of 0.1 s (`max_episode_steps`).

    ## Information

    `info` has the same keys after `reset` and `step`. The first seven count the fruit that has reached each stage, so
    each is at most as large as the one before. Once all fruit has been tried, the present fruit is the last one that
    was tried.

    | Key                 | Meaning                                                             | Unit |
    |---------------------|---------------------------------------------------------------------|------|
    | `present`           | fruit in the section of canopy                                      |      |
    | `visible`           | fruit that the camera found                                         |      |
    | `reachable`         | fruit within reach, with a free way from below                      |      |
    | `attempted`         | fruit that the gripper closed on                                    |      |
    | `attached`          | fruit that the gripper took                                         |      |
    | `detached`          | fruit that came off its stem in the gripper                         |      |
    | `collected`         | fruit collected undamaged                                           |      |
    | `damaged`           | fruit damaged, collected or not                                     |      |
    | `is_success`        | whether all reachable fruit is collected undamaged                  | bool |
    | `duration_s`        | time so far, including times not simulated (see below)              | s    |
    | `position_error_mm` | distance from true tool to true position of present fruit           | mm   |
    | `grasp_lateral_mm`  | last grasp: fruit from true tool, across the tool axis (0 before)   | mm   |
    | `grasp_axial_mm`    | last grasp: the same along the axis, positive beyond the tool       | mm   |
    | `tilt_deg`          | angle between true tool axis and the vertical                       | deg  |
    | `joint_command`     | joint command that the drives got                                   | rad, m |
    | `tool_position`     | true tool position                                                  | m    |
    | `fruit_position`    | true position of the present fruit                                  | m    |
    | `fruit_number`      | index of the present fruit, from 0                                  |      |

    The way to a fruit, settling, twisting and the retreat are simulated. `duration_s` adds three times that are not
    simulated: 1.0 s for each grasp, in which the gripper takes hold, 2.0 s for each fruit's way to the bin and back,
    and 0.5 s for its release. `station.toml` of `pickenv/orchard/presets` has the sources. Picks per hour are computed
    from `duration_s`. They leave out taking pictures and the ways from canopy to canopy. Observations, rewards and the
    time budget do not use `duration_s`.

    ## Arguments

    ```python
    >>> import gymnasium as gym
    >>> import pickenv
    >>> env = gym.make("pickenv/Pick-v0", gripper="compliant_hand")
    >>> observation, info = env.reset(seed=1)
    >>> observation.shape
    (23,)
    >>> info["present"] >= info["visible"] >= info["reachable"] > 0
    True

    ```

    - `plant` (str, default "orchard"): preset or path of a plant file, which describes the true arm; "ideal" has no
      error. Fruit is placed for the arm qiao2026, 0.5 to 0.9 m beside its base; other arms reach less of it.
    - `without` (sequence of str): effects of the plant to switch off.
    - `gripper` (default "li_cup"; or "compliant_hand"), `camera` (default "laser_line"), `canopy` (default "li2016"),
      `fruit_map` (default "li2016_lab", with single fruit; "v_trellis" has clusters), `fruit_size` (default "li2016",
      60 mm): presets of `pickenv.orchard.shipped` or paths of TOML files. False detections are not simulated.
    - `fruit` (float, default 10): mean number of fruit in the section.
    - `looks` (int, default 16): number of images that the camera averages. This reduces its noise, but neither its bias
      nor the error from partly hidden fruit.
    - `vision`: how the camera's errors are made. "published" (default) uses the published errors of `camera`. The
      others use Li's stereo pair instead. "rendered" renders its two pictures and detects the fruit in them (a tenth of
      a second and more; needs the extra `harvest`). "measured_errors" draws detections and errors from a table,
      which was made by detecting fruit in rendered pictures of this canopy. "ideal" shows all fruit at its true
      position.
    - `detector` ("li2016", the default, or "circles"): what detects fruit in the pictures.
    - `order` ("nearest" to the believed tool, the default, "lowest", "highest" or "foremost"): which fruit is next.
    - `feedback` ("encoders", the default, or "gripper"): with "gripper" the gripper measures where a fruit that it took
      lies in it, with noise of `grip_noise_mm` per axis (default 1). After a failed grasp it measures nothing.
    - `arms` ("fixed", "per_env" or "per_episode"), `tolerances`, `population` and `population_seed`: whether the true
      arm is the plant's own or one of a population, as in `pickenv/Reach-v0`.
    - `out_of_range` ("clip" or "refuse"): as in `pickenv/Reach-v0`.
    - `control_period_s`, `latency` (of joint readings), `action_delay` (of arm and gripper), `joint_noise`, `hours_on`
      and `start_spread`: as in `pickenv/Reach-v0`.
    - `difficulty` and `split`: as in `pickenv/Reach-v0`.
    - `executor` ("auto", "compiled", "floats" or "numpy"): as in `pickenv/Reach-v0`.
    - `render_mode` (None, "human" or "rgb_array").

    `gym.make_vec("pickenv/Pick-v0", num_envs=64)` makes the native vector environment,
    `pickenv.envs.picking.pick_vector.PickVectorEnv`, which takes the same arguments and more.

    ## Version History

    * v0: First version.
    """

    look = staticmethod(look_at_arm)

    def __init__(self, *, executor: str = "auto", render_mode: str | None = None, **arguments: Any) -> None:
        """See the class for the arguments; raises `InputError` for values that are not allowed."""
        refuse_unknown(self, arguments, on_ladder, make_pick, *OF_TASKS)
        task, self.orchard = make_pick(**on_ladder("Pick", **arguments))
        super().__init__(task, render_mode, executor)
        self._reach = reach_of(task.plant.arm.nominal, self.orchard.station.approach)
        self.observation_space, self.action_space = pick_spaces(task, self.orchard)
        self.canopies: Canopies | None = None
        self.scene: PickScene

    def reset(self, *, seed: int | None = None, options: Options = None) -> tuple[NDArray[np.float32], Information]:
        """Start an episode at a new section of canopy; see the class for `options`."""
        super().reset(seed=seed)
        options = given_options(options, PICK_OPTIONS)
        task, joints, arm = self.task, options.get("start_joints"), options.get("arm")
        if joints is not None:
            task.given_joints("start_joints", joints)  # refused before anything is drawn
        episode = self.np_random, None if seed is not None else self._arm, options.get("fruit"), arm
        ((self.scene, number, key),) = draw_starts(task, self.orchard, self._reach, [episode])
        self._key = self._word(key)
        if number is not None and (task.arms != "fixed" or arm is not None):
            self._use_arm(number)
        target = self._start(joints)
        hours = None if options.get("hours") is None else float(given_hours(options["hours"]))
        self._state = begin(self._x, task, self.plant, self._key, target, (), self._command(target), hours)
        self.canopies = Canopies(task, self.orchard, 1)
        self._look(self.canopies, self._state, 0.0)
        self.canopies.adopt(0, self.scene)
        self.canopies.choose(0)
        return self._shown(self.canopies)

    def step(self, action: ArrayLike) -> tuple[NDArray[np.float32], float, bool, bool, Information]:
        """Move the joint target by `action` for one period, then operate the gripper.

        Raises:
            InputError: If the action has another shape or invalid numbers, or if `reset` was not called before.
        """
        values = checked_action(action, (self.task.actions,), self.task.most_action)
        canopies, state = begun(self.canopies, "step"), begun(self._state, "step")
        numbers, before = self._numbers(values.tolist()), canopies.sight[TOOL][9:].T.copy()
        state, gripper, stirred, period = act_arm(self._x, self.task, state, numbers)
        canopies.moments += np.uint64(1)
        self._look(canopies, state, period)
        moved = (np.ravel(part) for part in (gripper, stirred, period))
        (reward,) = canopies.happen(np.ones(1, dtype=np.bool_), before, *moved)
        observation, information = self._shown(canopies)
        return observation, float(reward), bool(canopies.finished()[0]), False, information

    def _stage(self) -> Stage | None:
        return None if self.canopies is None else draw_pick(self.canopies, dark=self.dark)

    def _look(self, canopies: Canopies, state: ArmState, dt: Scalar) -> None:
        """Simulate ``dt`` seconds at the joint target of ``state``, and store the result in ``canopies.sight``."""
        sight, command = self._looked(state, int(canopies.moments[0]), dt)
        canopies.sight[:, 0] = self._plain([*sight, *command])

    def _shown(self, canopies: Canopies) -> tuple[NDArray[np.float32], Information]:
        if self.render_mode == "human":
            self.render()
        infos = canopies.information()
        information = {key: values[0] if values.ndim > 1 else values.item() for key, values in infos.items()}
        return canopies.observations(self.observation_space)[0], information
