"""`pickenv/Pick-v0`: pick a canopy's fruit one after the other, under a time budget, with an arm that is not exact."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pickenv.base import InputError
from pickenv.envs.picking.canopies import Canopies, draw_pick
from pickenv.envs.picking.pick_arm import TOOL, act_arm, look_at_arm, reach_of
from pickenv.envs.picking.pick_scene import PICK_OPTIONS, PickScene, draw_starts, given_hours, make_pick, pick_spaces
from pickenv.envs.shared.arm_env import ArmEnv, Information
from pickenv.envs.shared.backends import Scalar
from pickenv.envs.shared.difficulty import on_ladder
from pickenv.envs.shared.simulation import ArmState, begin
from pickenv.envs.shared.spaces import given_options
from pickenv.envs.shared.task import checked_action
from pickenv.pictures.stage import Stage


class PickEnv(ArmEnv):
    """Pick the fruit in front of the arm: come from below, settle, grasp, twist, retreat, and on to the next.

    ## Description

    A six-joint picking arm (Qiao 2026) stands before a section of canopy, 0.9 m wide and 0.8 m high, that holds some
    ten fruit. The environment names the next fruit: the nearest to the believed tool that the camera found within reach
    and that was not yet tried (or as `order` says). Each fruit can be tried once. The policy commands the *nominal*
    arm; what moves is the *true* one, which also swings after every move, so that haste costs accuracy. The gripper
    takes a fruit if the true tool is near enough to it; a failed grasp, and any fruit that the tool meets on its way,
    pushes neighbours aside, and they swing for a while.

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

    Above 0.5 an empty gripper closes at the end of the period, if the fruit is believed to be within 60 mm: that is the
    fruit's one attempt. With a fruit in the gripper, a positive command twists, by up to 0.5 N m at 1. Below -0.5 the
    gripper opens: a fruit on its stem swings back, a detached fruit falls and is damaged. A detached fruit is collected
    once the believed tool has gone 80 mm down.

    ## Observation Space

    `Box(float32)`, 23 numbers, or 26 with `feedback="gripper"`. The first 18 are laid out as in `pickenv/Reach-v0`, so
    that a reach policy can be used again. Nothing depends on the true arm but the gripper's sensors. Base frame.

    | Num   | Observation                                                          | Min  | Max  | Unit |
    |-------|----------------------------------------------------------------------|------|------|------|
    | 0-5   | joint readings (motor side, as nominal joints), scaled to the limits | -1   | 1    | 1    |
    | 6-8   | believed tool position (nominal forward kinematics of the readings)  | -R   | R    | m    |
    | 9-11  | position of the present fruit as the camera saw it                   | -R   | R    | m    |
    | 12-14 | that position minus believed tool position                           | -2R  | 2R   | m    |
    | 15-17 | upright against believed attitude, shortest rotation vector          | -pi  | pi   | rad  |
    | 18    | time since the joint target moved, at most 1 s                       | 0    | 1    | s    |
    | 19    | share of 400 steps that is left                                      | 0    | 1    | 1    |
    | 20    | a fruit is in the gripper and on its stem                            | 0    | 1    | 1    |
    | 21    | a fruit is in the gripper and off its stem                           | 0    | 1    | 1    |
    | 22    | fruit still to try, in fifties                                       | 0    | 1    | 1    |
    | 23-25 | where the fruit in the gripper lies from the tool, as it feels it    | -0.1 | 0.1  | m    |

    R is an upper bound of the arm's reach plus 1 m.

    ## Rewards

    Per step: 1 x (fruit collected undamaged) - 0.25 x (fruit newly damaged) - 0.002. Fruit is damaged by a tool that
    hits it faster than 0.4 m/s, by being pulled off instead of twisted, and by falling. The reward is never part of an
    observation.

    So haste costs more than the time it saves. The table shows what the scripted policy loses, with a calibrated arm on
    60 canopies of some seven fruit in reach, compared with the same policy with gentle moves and half a second of
    waiting (simulated; mean and 95 % interval per canopy, tests/envs/picking/test_pick.py):

    | What is left out                 | Fruit collected        | Reward                 |
    |----------------------------------|------------------------|------------------------|
    | waiting for the arm to settle    | -0.27 (-0.40 to -0.13) | -0.18 (-0.31 to -0.05) |
    | waiting and gentle moves         | -0.72 (-0.94 to -0.49) | -0.81 (-1.07 to -0.54) |
    | calibration                      | -0.45 (-0.67 to -0.24) | -0.45 (-0.66 to -0.23) |

    ## Starting State

    All joints at mid-range, the arm at rest, cold and not yet sunk. Fruit is drawn until at least one is in reach: seen
    by the camera, reachable with the tool upright there and 100 mm below, with no fruit in the way from below.
    `reset(options=...)` takes `"fruit"`, positions (n, 3) in the base frame in m, `"start_joints"` (rad and m),
    `"hours"`, for which the arm has been on, in place of `hours_on`, and, where `arms` is not "fixed", `"arm"`, the
    number of the arm in the population. Every draw comes from `np_random` in
    `reset`: what happens then depends on the actions alone, and one seed gives the same fruit to every arm.

    ## Episode End

    - Termination: no fruit is left to try and the gripper is empty.
    - Truncation: after 400 steps of 0.1 s (`max_episode_steps`).

    ## Information

    `info` has the same keys after `reset` and `step`. The first seven count the fruit that has got so far, each at most
    as many as the key before. Once all fruit has been tried, the present fruit is the last one that was tried.

    | Key                 | Meaning                                                             | Unit |
    |---------------------|---------------------------------------------------------------------|------|
    | `present`           | fruit in the section of canopy                                      |      |
    | `visible`           | fruit that the camera found                                         |      |
    | `reachable`         | fruit within reach, with a free way from below                      |      |
    | `attempted`         | fruit that the gripper closed on                                    |      |
    | `attached`          | fruit that it took                                                  |      |
    | `detached`          | fruit that came off its stem in the gripper                         |      |
    | `collected`         | fruit collected undamaged                                           |      |
    | `damaged`           | fruit damaged, collected or not                                     |      |
    | `is_success`        | whether all reachable fruit is collected undamaged                  | bool |
    | `duration_s`        | time so far, with what is counted and not simulated (see below)     | s    |
    | `position_error_mm` | true tool to true position of the present fruit                     | mm   |
    | `grasp_lateral_mm`  | last grasp: fruit from true tool, across the tool axis (0 before)   | mm   |
    | `grasp_axial_mm`    | the same along the axis, positive beyond the tool                   | mm   |
    | `tilt_deg`          | angle between true tool axis and the vertical                       | deg  |
    | `joint_command`     | what the drives got                                                 | rad, m |
    | `tool_position`     | true tool position                                                  | m    |
    | `fruit_position`    | true position of the present fruit                                  | m    |
    | `fruit_number`      | its number                                                          |      |

    The way to a fruit, settling, twisting and the retreat are simulated. `duration_s` counts three things beside them:
    1.0 s for each grasp, in which the gripper takes hold, 2.0 s for each fruit's way to the bin and back, and 0.5 s for
    its release (`station.toml` of `pickenv/orchard/presets` has the sources). Picks per hour are by `duration_s`, and
    leave out pictures and the ways from canopy to canopy. Observations, rewards and the time budget do not count it.

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

    - `plant` (str, default "orchard"): preset or path of a plant file; "ideal" has no error. Fruit is
      placed for the arm qiao2026, upright tool 0.5 to 0.9 m beside its base; other arms reach less of it.
    - `without` (sequence of str): effects of the plant to switch off.
    - `gripper` (default "li_cup"; "compliant_hand"), `camera` (default "laser_line"), `canopy` (default "li2016"),
      `fruit_map` (default "li2016_lab", singly hung; "v_trellis" is clumped), `fruit_size` (default "li2016", 60 mm):
      presets of `pickenv.orchard.shipped` or paths of TOML files. False detections are left out.
    - `fruit` (float, default 10): mean number of fruit in the section.
    - `looks` (int, default 16): images that the camera averages; noise falls, bias and occlusion's pull stay.
    - `vision`: "published" (default) goes by what is published of `camera`; the others see with Li's stereo pair
      instead: "rendered" draws its two pictures and reads them (a tenth of a second and more; needs the extra
      `harvest`), "measured_errors" draws recall and errors from the table made that way in this canopy, "ideal" shows
      all fruit where it is. `detector`: what reads the pictures, "li2016" (default) or "circles".
    - `order` ("nearest" to the believed tool, the default, "lowest", "highest" or "foremost"): the fruit named next.
    - `feedback` ("encoders", the default, or "gripper"): with "gripper" the gripper feels where a fruit that it took
      lies in it, with noise of `grip_noise_mm` per axis (default 1). A fruit that it missed tells nothing.
    - `arms` ("fixed", "per_env" or "per_episode"), `tolerances`, `population` and `population_seed`: the plant's own
      true arm, or one of a population, as in `pickenv/Reach-v0`.
    - `out_of_range` ("clip" or "refuse"): as in `pickenv/Reach-v0`.
    - `control_period_s`, `latency` (of joint readings), `action_delay` (of the gripper too), `joint_noise`, `hours_on`
      and `start_spread`, numbers or ranges: as in `pickenv/Reach-v0`.
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
        """See the class for the arguments; raises `InputError` for impossible ones."""
        task, self.orchard = make_pick(**on_ladder("Pick", **arguments))
        super().__init__(task, render_mode, executor)
        self._reach = reach_of(task.plant.arm.nominal, self.orchard.station.approach)
        space, self.action_space = pick_spaces(task, self.orchard)
        self.observation_space, self._bounds = space, (space.low, space.high)
        self.canopies: Canopies | None = None
        self.scene: PickScene

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], Information]:
        """Start before another section of canopy; see the class for `options`."""
        super().reset(seed=seed)
        options = given_options(options, PICK_OPTIONS)
        task, joints, arm = self.task, options.get("start_joints"), options.get("arm")
        if joints is not None:
            task.given_joints("start_joints", joints)  # refused before anything is drawn
        before = None if seed is not None else self._arm
        ((self.scene, number, key),) = draw_starts(
            task, self.orchard, self._reach, [self.np_random], [before], [options.get("fruit")], [arm]
        )
        self._key = self._word(key)
        if number is not None and (task.arms != "fixed" or arm is not None):
            self._use_arm(number)
        target = self._start(joints)
        hours = None if options.get("hours") is None else float(given_hours(options["hours"]))
        command = self._command(target)
        self._state = begin(self._x, task, self.plant, self._key, target, (), command, gripper=1, hours=hours)
        self.canopies = Canopies(task, self.orchard, 1)
        self._look(self.canopies, self._state, 0.0)
        self.canopies.adopt(0, self.scene)
        self.canopies.choose(0)
        return self._shown(self.canopies)

    def step(self, action: ArrayLike) -> tuple[NDArray[np.float32], float, bool, bool, Information]:
        """Move the joint target by `action`, then work the gripper.

        Raises:
            InputError: If the action has another shape or impossible numbers, or before the first reset.
        """
        values, canopies = checked_action(action, (self.task.joints + 1,), self.task.most_action), self.canopies
        if canopies is None or self._state is None:
            raise InputError("step was called before reset; call reset first")
        numbers, before = self._numbers(values.tolist()), canopies.sight[TOOL][9:].T.copy()
        state, gripper, stirred, period = act_arm(self._x, self.task, self._state, numbers)
        canopies.moments += np.uint64(1)
        self._look(canopies, state, period)
        moved = (np.ravel(part) for part in (gripper, stirred, period))
        (reward,) = canopies.happen(np.ones(1, dtype=np.bool_), before, *moved)
        observation, information = self._shown(canopies)
        return observation, float(reward), bool(canopies.finished()[0]), False, information

    def _stage(self) -> Stage | None:
        return None if self.canopies is None else draw_pick(self.canopies, dark=self.dark)

    def _look(self, canopies: Canopies, state: ArmState, dt: Scalar) -> None:
        """Let ``dt`` seconds pass at the joint target of ``state``, and store in ``canopies`` how the arm is seen."""
        sight, command = self._looked(state, int(canopies.moments[0]), dt)
        canopies.sight[:, 0] = self._plain([*sight, *command])

    def _shown(self, canopies: Canopies) -> tuple[NDArray[np.float32], Information]:
        if self.render_mode == "human":
            self.render()
        infos = canopies.information()
        information = {key: values[0] if values.ndim > 1 else values.item() for key, values in infos.items()}
        return canopies.observations(*self._bounds)[0], information
