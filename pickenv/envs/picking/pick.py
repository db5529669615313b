"""`pickenv/Pick-v0`: pick a canopy's fruit one after the other, under a time budget, with an arm that is not exact."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np
from numpy.typing import ArrayLike, NDArray

from pickenv.arm import Array, Frame, PlantState, plant_at
from pickenv.envs.picking.pick_reach import reach_of
from pickenv.envs.picking.pick_scene import PickScene, draw_scene, upright_turn
from pickenv.envs.picking.pick_task import make_pick
from pickenv.envs.shared.arm_env import ArmEnv, Information
from pickenv.envs.shared.backends import FLOATS
from pickenv.envs.shared.difficulty import on_ladder
from pickenv.envs.shared.simulation import move, nominal_frames, nominal_readings, scaled
from pickenv.envs.shared.situation import (
    Components,
    acted,
    drawn_start,
    drawn_values,
    in_period,
    sensed,
    warmed_up,
    with_joint_noise,
)
from pickenv.envs.shared.spaces import box, given_options
from pickenv.envs.shared.task import checked_action
from pickenv.errors import InputError

if TYPE_CHECKING:
    from pickenv.pictures.stage import Stage

LONGEST = 400
"""Steps of the time budget, whatever `max_episode_steps` says: the environment is not told of that."""
STILL = 1.0
"""Time without a command after which the observation says that the arm stands still, s."""
MOST_LEFT = 50
COLLECTED, DAMAGED, STEP = 1.0, -0.25, -0.002


class PickEnv(ArmEnv):
    """Pick the fruit in front of the arm: come from below, settle, grasp, twist, retreat, and on to the next.

    ## Description

    A six-joint picking arm (Qiao 2026) stands before a section of canopy, 0.9 m wide and 0.8 m high, that holds some
    ten fruit. The environment names the next fruit: the nearest to the believed tool that the camera found within
    reach and that was not yet tried. Each fruit can be tried once. The policy commands the *nominal* arm; what moves is
    the *true* one, which also swings after every move, so that haste costs accuracy. The gripper takes a fruit if the
    true tool is near enough to it; a failed grasp, and any fruit that the tool meets on its way, pushes neighbours
    aside, and they swing for a while.

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
    and 95 % interval per canopy, tests/envs/test_pick.py):

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
    - `arms` ("fixed", "per_env" or "per_episode"), `tolerances`, `population` and `population_seed`: the plant's own
      true arm, or one of a population, as in `pickenv/Reach-v0`.
    - `out_of_range` ("clip" or "refuse"): as in `pickenv/Reach-v0`.
    - `control_period_s`, `latency` (of joint readings), `action_delay` (of the gripper too), `joint_noise`, `hours_on`
      and `start_spread`, numbers or ranges: as in `pickenv/Reach-v0`.
    - `difficulty` and `split`: as in `pickenv/Reach-v0`.
    - `render_mode` (None, "human" or "rgb_array").

    There is no native vector version: it would gain little, since drawing a canopy takes as long as some seventy steps.
    `gym.make_vec("pickenv/Pick-v0", num_envs=8)` makes a `SyncVectorEnv`; environment i is seeded with `seed + i` and
    gives there what it gives alone.

    ## Version History

    * v0: First version.
    """

    def __init__(
        self, *, difficulty: str | None = None, split: str = "train", render_mode: str | None = None, **arguments: Any
    ) -> None:
        """See the class for the arguments; raises `InputError` for impossible ones."""
        task, self.orchard = make_pick(**on_ladder("Pick", difficulty, split, arguments))
        super().__init__(task, render_mode)
        self._reach = reach_of(self.plant.arm.nominal, self.orchard.station.approach)
        bounds = box([1.0] * self.task.joints + [self.task.reach] * 6 + [2 * self.task.reach] * 3 + [math.pi] * 3)
        self._low = np.concatenate([bounds.low, np.zeros(5, np.float32)])
        self._high = np.concatenate([bounds.high, np.ones(5, np.float32)])
        self.observation_space = gym.spaces.Box(self._low, self._high, dtype=np.float32)
        self.action_space = gym.spaces.Box(-1.0, 1.0, (self.task.joints + 1,), np.float32)
        self.scene: PickScene | None = None
        self._target: Sequence[float] = self.task.middle
        self._state = PlantState()
        self._tool: Frame = ()
        self._sensed: Components = ()
        self._arm: int | None = None

    @property
    def joint_target(self) -> Array:
        """The nominal joint target that the actions have built up, rad or m."""
        return np.array(self._target)

    @property
    def arm(self) -> int:
        """Number of the true arm in its population; 0 for a fixed one."""
        return self._arm or 0

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], Information]:
        """Start before another section of canopy; see the class for `options`."""
        super().reset(seed=seed)
        options = given_options(options, ("fruit", "start_joints", "arm"))
        task, given, start = self.task, self.task.situation, options.get("start_joints")
        start = None if start is None else task.given_joints("start_joints", start).tolist()
        self.scene = draw_scene(self.orchard, self._reach, self.np_random, options.get("fruit"))
        self._take_arm(options.get("arm"), again=seed is not None)
        self._key = 0 if given.plain else int(self.np_random.integers(2**63))
        self._drawn = drawn_values(FLOATS, given, self._key)
        self._sent: Components = (0.0,) * (given.widths(task.joints + 1, 0)[1])
        if start is None:
            start = drawn_start(FLOATS, given, self._key, task.lower, task.upper) if given.spread else task.middle
        self._target, self._step, self._still = start, 0, STILL
        command = self._command()
        memory = self.plant.initial_state(math, command)
        memory = warmed_up(FLOATS, given, self._drawn, self.plant, memory, command)
        self._state, self._tool = self.plant.advance(math, memory, command, 0.0)
        shown = self._shown(command)
        believed = nominal_frames(FLOATS, self.task, shown)[1]
        self._number = self._next(believed)
        if self.render_mode == "human":
            self.render()
        return self._observation(shown, believed), self._information(command)

    def step(self, action: ArrayLike) -> tuple[NDArray[np.float32], float, bool, bool, Information]:
        """Move the joint target by `action`, then work the gripper.

        Raises:
            InputError: If the action has another shape or impossible numbers, or before the first reset.
        """
        values = checked_action(action, (self.task.joints + 1,), self.task.most_action)
        if self.scene is None:
            raise InputError("step was called before reset; call reset first")
        scene = self.scene
        task, given = self.task, self.task.situation
        arrived, self._sent = acted(FLOATS, given, self._drawn, self._sent, values.tolist())
        *moves, gripper = arrived
        period = given.value("period", self._drawn)
        collected, damaged = scene.funnel()["collected"], int(scene.damaged.sum())
        target = move(FLOATS, task, self._target, in_period(FLOATS, given, self._drawn, moves))
        moved = any(abs(a - b) > 1e-9 for a, b in zip(target, self._target, strict=True))
        self._still = 0.0 if moved else min(STILL, self._still + period)
        self._target, self._step, before = target, self._step + 1, self._tool
        command = self._command()
        self._state, self._tool = self.plant.advance(math, self._state, command, period)
        shown = self._shown(command)
        believed = nominal_frames(FLOATS, self.task, shown)[1]
        scene.advance(before, self._tool, self._number, period)
        scene.work_gripper(gripper, self._number, believed, self._tool)
        if scene.held is None and not scene.waiting[self._number]:
            self._number = self._next(believed)
        funnel = scene.funnel()
        reward = COLLECTED * (funnel["collected"] - collected) + DAMAGED * (int(scene.damaged.sum()) - damaged) + STEP
        terminated = scene.held is None and not scene.waiting.any()
        if self.render_mode == "human":
            self.render()
        return self._observation(shown, believed), reward, terminated, False, self._information(command)

    def _stage(self) -> Stage | None:
        from pickenv.envs.picking.pick_drawing import draw_pick

        if self.scene is None:
            return None
        command = self._command()
        believed = nominal_frames(FLOATS, self.task, self._shown(command))[1]
        nominal = self.task.plant.arm.nominal
        return draw_pick(nominal, np.array(command), self._tool, believed, self.scene, self._number, self.dark)

    def _take_arm(self, asked: int | None, *, again: bool) -> None:
        """Choose the true arm: anew in every episode, or once per environment and seed."""
        task = self.task
        if task.arms == "fixed" and asked is None:
            return
        if again or self._arm is None or task.arms == "per_episode":
            self._arm = int(self.np_random.integers(task.population))
        if asked is not None:
            self._arm = task.given_arm(asked)
        self.plant = plant_at(task.plant, self._arm)

    def _next(self, believed: Frame) -> int:
        """Number of the next fruit, or of the last one where none waits."""
        assert self.scene is not None
        number = self.scene.nearest(believed[9:])
        return self._number if number is None else number

    def _command(self) -> Sequence[float]:
        """What the drives get for the joint target."""
        if self.compensator is None:
            return self._target
        command: list[float] = self.compensator(np.array(self._target)).tolist()
        return command

    def _shown(self, command: Sequence[float]) -> list[float]:
        """Joints as their readings arrive, late and noisy where the situation says so."""
        given, first = self.task.situation, self._step == 0
        read = nominal_readings(FLOATS, self.plant, self._state, self._target, command)
        read = with_joint_noise(FLOATS, given, self._drawn, self._key, self._step, read)
        arrived, self._sensed = sensed(FLOATS, given, self._drawn, self._sensed, read, first)
        return list(arrived)

    def _observation(self, shown: Sequence[float], believed: Frame) -> NDArray[np.float32]:
        scene = self.scene
        assert scene is not None
        seen, tool = scene.seen[self._number], np.array(believed[9:])
        held = scene.held is not None
        parts = [
            scaled(FLOATS, self.task, shown),
            tool,
            seen,
            seen - tool,
            upright_turn(np.array(believed[6:9])),
            [
                self._still,
                1.0 - self._step / LONGEST,
                held and not scene.holds_detached,
                scene.holds_detached,
                scene.waiting.sum() / MOST_LEFT,
            ],
        ]
        return np.asarray(np.concatenate(parts).clip(self._low, self._high), dtype=np.float32)

    def _information(self, command: Sequence[float]) -> Information:
        scene = self.scene
        assert scene is not None
        tool, fruit = np.array(self._tool[9:]), scene.positions[self._number]
        funnel = scene.funnel()
        return {
            **funnel,
            "damaged": int(scene.damaged.sum()),
            "is_success": funnel["collected"] == funnel["reachable"],
            "position_error_mm": 1e3 * float(np.linalg.norm(fruit - tool)),
            "grasp_lateral_mm": 1e3 * scene.miss[0],
            "grasp_axial_mm": 1e3 * scene.miss[1],
            "tilt_deg": math.degrees(math.acos(max(-1.0, min(1.0, self._tool[8])))),
            "joint_command": np.array(command),
            "tool_position": tool,
            "fruit_position": fruit.copy(),
            "fruit_number": self._number,
        }
