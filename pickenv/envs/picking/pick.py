"""`pickenv/Pick-v0`: pick a canopy's fruit one after the other, under a time budget, with an arm that is not exact."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pickenv.arm import Array, Frame, Geometry
from pickenv.base import InputError
from pickenv.envs.picking.pick_arm import PickSight, act_arm, apart_mm, look_at_arm, reach_of
from pickenv.envs.picking.pick_scene import (
    LONGEST,
    MOST_LEFT,
    PICK_OPTIONS,
    STILL,
    PickScene,
    PickSetting,
    draw_starts,
    make_pick,
    pick_reward,
    pick_spaces,
    to_base,
)
from pickenv.envs.shared.arm_env import GHOST_WORDS, ArmEnv, Information, arm_at_work, standing, tool_dial
from pickenv.envs.shared.backends import Scalar
from pickenv.envs.shared.difficulty import on_ladder
from pickenv.envs.shared.simulation import begin
from pickenv.envs.shared.spaces import given_options
from pickenv.envs.shared.task import checked_action
from pickenv.pictures.arm_shapes import Solids, cup_solids, frustum_solids, hand_solids, joined_solids
from pickenv.pictures.stage import SIZE, Eye, Mesh, Stage, Words
from pickenv.pictures.tree_shapes import GREEN, MISSED_FRUIT, crate, fruit_colours, fruit_solids, row_of_trees


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
    fruit's one attempt. Around a fruit, a positive command twists, by up to 0.5 N m at 1. Below -0.5 it opens: what
    hangs swings back, what is off falls and is damaged. A detached fruit is collected once the believed tool has gone
    80 mm down.

    ## Observation Space

    `Box(float32)`, 23 numbers. The first 18 are laid out as in `pickenv/Reach-v0`, so that a reach policy can be used
    again. Nothing depends on the true arm but the gripper's two sensors. Base frame.

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

    R is an upper bound of the arm's reach plus 1 m.

    ## Rewards

    Per step: 1 x (fruit collected undamaged) - 0.25 x (fruit newly damaged) - 0.002. Fruit is damaged by a tool that
    hits it faster than 0.4 m/s, by being pulled off instead of twisted, and by falling. The reward is never part of an
    observation.

    So haste costs more than the time it saves. Of the scripted policy with a calibrated arm on 60 canopies of some
    seven fruit in reach, relative to the same policy with gentle moves and half a second of waiting (simulated; mean
    and 95 % interval per canopy, tests/envs/picking/test_pick.py):

    | What is left out                 | Fruit collected        | Reward                 |
    |----------------------------------|------------------------|------------------------|
    | waiting for the arm to settle    | -0.27 (-0.40 to -0.13) | -0.18 (-0.31 to -0.05) |
    | waiting and gentle moves         | -0.72 (-0.94 to -0.49) | -0.81 (-1.07 to -0.54) |
    | calibration                      | -0.45 (-0.67 to -0.24) | -0.45 (-0.66 to -0.23) |

    ## Starting State

    All joints at mid-range, the arm at rest, cold and not yet sunk. Fruit is drawn until at least one is in reach: seen
    by the camera, reachable with the tool upright there and 100 mm below, with no fruit in the way from below.
    `reset(options=...)` takes `"fruit"`, positions (n, 3) in the base frame in m, `"start_joints"` (rad and m) and,
    where `arms` is not "fixed", `"arm"`, the number of the arm in the population. Every draw comes from `np_random` in
    `reset`: what happens then depends on the actions alone, and one seed gives the same fruit to every arm.

    ## Episode End

    - Termination: no fruit is left to try and the gripper is empty.
    - Truncation: after 400 steps of 0.1 s (`max_episode_steps`).

    ## Information

    `info` has the same keys after `reset` and `step`. The first seven are the funnel so far, each at most the one
    before. Where all fruit has been tried, those of the present fruit are of the last one.

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
    | `position_error_mm` | true tool to true position of the present fruit                     | mm   |
    | `grasp_lateral_mm`  | last grasp: fruit from true tool, across the tool axis (0 before)   | mm   |
    | `grasp_axial_mm`    | the same along the axis, positive beyond the tool                   | mm   |
    | `tilt_deg`          | angle between true tool axis and the vertical                       | deg  |
    | `joint_command`     | what the drives got                                                 | rad, m |
    | `tool_position`     | true tool position                                                  | m    |
    | `fruit_position`    | true position of the present fruit                                  | m    |
    | `fruit_number`      | its number                                                          |      |

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
    - `arms` ("fixed", "per_env" or "per_episode"), `tolerances`, `population` and `population_seed`: the plant's own
      true arm, or one of a population, as in `pickenv/Reach-v0`.
    - `out_of_range` ("clip" or "refuse"): as in `pickenv/Reach-v0`.
    - `control_period_s`, `latency` (of joint readings), `action_delay` (of the gripper too), `joint_noise`, `hours_on`
      and `start_spread`, numbers or ranges: as in `pickenv/Reach-v0`.
    - `difficulty` and `split`: as in `pickenv/Reach-v0`.
    - `executor` ("floats" or "numpy"): as in `pickenv/Reach-v0`.
    - `render_mode` (None, "human" or "rgb_array").

    `gym.make_vec("pickenv/Pick-v0", num_envs=64)` makes the native vector environment,
    `pickenv.envs.picking.pick_vector.PickVectorEnv`, which takes the same arguments and more.

    ## Version History

    * v0: First version.
    """

    def __init__(
        self,
        *,
        difficulty: str | None = None,
        split: str = "train",
        executor: str = "floats",
        render_mode: str | None = None,
        **arguments: Any,
    ) -> None:
        """See the class for the arguments; raises `InputError` for impossible ones."""
        task, self.orchard = make_pick(**on_ladder("Pick", difficulty, split, arguments))
        super().__init__(task, render_mode, executor)
        self._reach = reach_of(task.plant.arm.nominal, self.orchard.station.approach)
        space, self.action_space = pick_spaces(task)
        self.observation_space, self._bounds = space, (space.low, space.high)
        self.scene: PickScene | None = None
        self._sight: PickSight | None = None

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
        (start,) = draw_starts(
            task, self.orchard, self._reach, [self.np_random], [before], [options.get("fruit")], [arm]
        )
        self.scene, self._key = start.scene, self._word(start.key)
        if start.arm is not None and (task.arms != "fixed" or arm is not None):
            self._use_arm(start.arm)
        target = self._start(joints)
        self._step, self._still = 0, STILL
        self._state = begin(self._x, task, self.plant, self._key, target, (), self._command(target), gripper=1)
        pose, _ = self._look(0.0)
        self._number = 0
        self._choose(pose)
        if self.render_mode == "human":
            self.render()
        return self._observation(), self._information()

    def step(self, action: ArrayLike) -> tuple[NDArray[np.float32], float, bool, bool, Information]:
        """Move the joint target by `action`, then work the gripper.

        Raises:
            InputError: If the action has another shape or impossible numbers, or before the first reset.
        """
        values = checked_action(action, (self.task.joints + 1,), self.task.most_action)
        if self.scene is None or self._state is None or self._sight is None:
            raise InputError("step was called before reset; call reset first")
        scene, x, task = self.scene, self._x, self.task
        collected, damaged = scene.tally()
        numbers = self._numbers(values.tolist())
        self._state, command, stirred, period = act_arm(x, task, self._state, numbers)
        gripper, dt = self._plain((command, period))
        self._still = 0.0 if stirred else min(STILL, self._still + dt)
        self._step += 1
        before = tuple(self._plain(self._sight.tool))
        pose, tool = self._look(period)
        scene.advance(before, tool, self._number, dt)
        scene.work_gripper(gripper, self._number, pose, tool)
        if scene.held is None and not scene.waiting[self._number]:
            self._choose(pose)
        now_collected, now_damaged = scene.tally()
        reward = pick_reward(now_collected - collected, now_damaged - damaged)
        terminated = scene.held is None and not scene.waiting.any()
        if self.render_mode == "human":
            self.render()
        return self._observation(), reward, terminated, False, self._information()

    def _stage(self) -> Stage | None:
        if self.scene is None or self._state is None or self._sight is None:
            return None
        command = np.array(self._plain(self._command(self._state.target)))
        tool, pose = tuple(self._plain(self._sight.tool)), tuple(self._plain(self._sight.believed))
        return draw_pick(self.task.plant.arm.nominal, command, tool, pose, self.scene, self._number, self.dark)

    def _look(self, dt: Scalar) -> tuple[Frame, Frame]:
        """Let time pass at the present joint target; frames of the believed and the true tool."""
        assert self._state is not None
        command, moment = self._command(self._state.target), self._word(self._step)
        self._state, self._sight = look_at_arm(
            self._x, self.task, self.plant, self._state, command, self._key, moment, dt
        )
        self._sent_command = np.array(self._plain(command))
        return tuple(self._plain(self._sight.believed)), tuple(self._plain(self._sight.tool))

    def _choose(self, believed: Sequence[float]) -> None:
        """Go after the waiting fruit that comes next, or stay with the last one."""
        assert self.scene is not None
        number = self.scene.following(believed[9:])
        self._number = self._number if number is None else number

    def _observation(self) -> NDArray[np.float32]:
        scene, sight = self.scene, self._sight
        assert scene is not None and sight is not None
        fruit, tool = scene.seen[self._number], np.array(self._plain(sight.believed)[9:])
        parts = [
            self._plain(sight.readings),
            tool,
            fruit,
            fruit - tool,
            self._plain(sight.turn),
            [
                self._still,
                1.0 - self._step / LONGEST,
                scene.holds_hanging,
                scene.holds_detached,
                scene.waiting.sum() / MOST_LEFT,
            ],
        ]
        low, high = self._bounds
        return np.asarray(np.concatenate(parts).clip(low, high), dtype=np.float32)

    def _information(self) -> Information:
        scene, sight = self.scene, self._sight
        assert scene is not None and sight is not None
        fruit, funnel = scene.positions[self._number], scene.funnel()
        away = apart_mm(self._x, self._numbers(fruit.tolist()), sight.tool[9:])
        away_mm, tilt = self._plain((away, sight.tilt))
        return {
            **funnel,
            "damaged": scene.tally()[1],
            "is_success": funnel["collected"] == funnel["reachable"],
            "position_error_mm": away_mm,
            "grasp_lateral_mm": 1e3 * scene.miss[0],
            "grasp_axial_mm": 1e3 * scene.miss[1],
            "tilt_deg": tilt,
            "joint_command": self._sent_command,
            "tool_position": np.array(self._plain(sight.tool)[9:]),
            "fruit_position": fruit.copy(),
            "fruit_number": self._number,
        }


# A canopy and the arm that picks in it as a stage to draw. Units: m; mm in words.


CAMERA = (110, 96, 160)


def draw_pick(
    nominal: Geometry, command: Array, tool: Frame, believed: Frame, scene: PickScene, number: int, dark: bool
) -> Stage:
    """The arm, its ghost, its gripper, the camera and the trees.

    Args:
        nominal: The arm as its controller believes it to be.
        command: What the drives got ``(n,)``, rad or m.
        tool: Frame of the true tool.
        believed: Frame of the tool as the controller believes it to be.
        scene: The fruit.
        number: The fruit that the arm is after.
        dark: Whether the background is dark.
    """
    orchard, funnel = scene.orchard, scene.funnel()
    point, axis = np.array(tool[9:]), np.array(tool[6:9])
    offset = point - scene.positions[number]
    solids = joined_solids(
        arm_at_work(nominal, command, point, axis, np.array(believed[9:])),
        gripper_solids(orchard, point, axis, scene.held is not None),
        canopy_fruit(scene),
        crate(pick_eye(orchard), SIZE, funnel["collected"], float(np.mean(scene.diameters)), ground_of(orchard)),
        camera_solids(orchard),
    )
    missed = scene.attempted & ~scene.attached
    words = (
        Words(f"picked {funnel['collected']} of {funnel['reachable']}", "top left", large=True),
        Words(f"missed {int(missed.sum())}", "top left"),
        Words(f"{1e3 * float(np.linalg.norm(offset)):.1f} mm from the fruit", "top right"),
        Words(GHOST_WORDS, "bottom left"),
    )
    still = (*standing(nominal, ground_of(orchard), dark), *trees_of(orchard))
    dial = tool_dial(axis, offset, 1e3 * orchard.gripper.tolerance)
    return Stage(pick_eye(orchard), *solids, still=still, words=words, dial=dial, dark=dark)


def gripper_solids(orchard: PickSetting, point: Array, axis: Array, closed: bool) -> Solids:
    """The cup, as wide as its opening; or the hand, around a usual fruit."""
    if orchard.gripper.kind == "cup":
        return cup_solids(point, axis, orchard.station.tool_radius)
    return hand_solids(point, axis, orchard.station.tool_radius, closed)


def canopy_fruit(scene: PickScene) -> Solids:
    """Fruit that hangs or is in the gripper: ripe where it can still be tried, another colour where it was missed."""
    present = ~scene.collected & ~(scene.damaged & scene.detached)
    if scene.held is not None:
        present[scene.held] = True
    colours = fruit_colours(len(scene.rest))
    colours[~scene.reachable] = GREEN
    colours[scene.attempted & ~scene.attached] = MISSED_FRUIT
    gripped = present & scene.detached
    hanging = present & ~gripped
    places, sizes = scene.positions, scene.diameters
    return joined_solids(
        fruit_solids(places[hanging], sizes[hanging], colours[hanging]),
        fruit_solids(places[gripped], sizes[gripped], colours[gripped], stems=False),
    )


def camera_solids(orchard: PickSetting) -> Solids:
    """The camera that looks at the canopy, and what it sees."""
    canopy, camera = orchard.canopy, orchard.camera
    middle = (canopy.bottom + canopy.top) / 2
    eye = to_base(orchard, np.array([0.0, -canopy.standoff, middle]))
    ahead = to_base(orchard, np.array([0.0, 0.0, middle])) - eye
    half_angles = [side / 2 / camera.focal_length for side in camera.image]
    return frustum_solids(eye, ahead / np.linalg.norm(ahead), half_angles, 0.3 * float(np.linalg.norm(ahead)), CAMERA)


def trees_of(orchard: PickSetting) -> tuple[Mesh, ...]:
    """The section of canopy before the arm."""
    canopy = orchard.canopy
    ends = np.array([[-canopy.width / 2, 0.0, canopy.bottom], [canopy.width / 2, canopy.depth, canopy.top]])
    corners = to_base(orchard, ends)
    low, high = (tuple(float(value) for value in end) for end in (corners.min(axis=0), corners.max(axis=0)))
    return row_of_trees(low, high, canopy.leaf_area_per_volume, ground_of(orchard))


def ground_of(orchard: PickSetting) -> float:
    """Height of the ground in the arm's base frame, m."""
    return float(to_base(orchard, np.zeros(3))[2])


def pick_eye(orchard: PickSetting) -> Eye:
    """From behind the arm, to its side and above it."""
    canopy = orchard.canopy
    face = to_base(orchard, np.array([0.0, 0.0, (canopy.bottom + canopy.top) / 2]))
    target = face * [0.62, 0.62, 0.62]
    return Eye(target + np.array([1.35, 2.15, 0.75]), target)
