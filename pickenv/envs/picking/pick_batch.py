"""Many picking arms before their canopies, side by side on NumPy. Units: m, rad, s."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pickenv.arm import Array, Plant
from pickenv.envs.picking.fruit_table import FruitTable
from pickenv.envs.picking.pick_arm import PickMotion, act_arm, apart_mm, begin_arm, look_at_arm
from pickenv.envs.picking.pick_scene import CLOSE, LONGEST, MOST_LEFT, STILL, PickSetting, PickStart, pick_reward
from pickenv.envs.shared.arm_batch import Columns, Flags, NumpyArms, Rows
from pickenv.envs.shared.backends import Scalar
from pickenv.envs.shared.situation import drawn_start
from pickenv.envs.shared.task import Compensate, Task

BELIEVED, TOOL, TURN, TILT, SIGHT = slice(0, 12), slice(12, 24), slice(24, 27), 27, 28
"""Rows of what is seen of the arms; readings and commands follow."""

OWN = ("sight", "number", "still", "moments")


class PickBatch(NumpyArms):
    """The state of N picking arms.

    Attributes:
        fruit: What hangs before them.
        sight: What was seen of the arms last, component by component.
        number: Of the fruit that each is after.
        still: Time since each joint target moved, s.
        moments: Steps of each episode.
    """

    def __init__(self, task: Task, orchard: PickSetting, count: int) -> None:
        super().__init__(task, count, task.joints + 1)
        n = task.joints
        self.make_plants()
        self.make_room(n, *task.situation.widths(n + 1, n))
        self.fruit = FruitTable(orchard, count)
        self.sight = np.zeros((SIGHT + 2 * n, count))
        self.number: Rows = np.zeros(count, dtype=np.int64)
        self.still, self.moments = np.full(count, STILL), np.zeros(count, dtype=np.uint64)

    def motion_of(self, columns: Columns) -> PickMotion:
        """The motion that columns hold."""
        target, drawn, sent, sensed, *memory = self.parts_of(columns)
        return PickMotion(target, drawn, sent, sensed, tuple(memory))

    def restart(
        self, rows: Rows, starts: Sequence[PickStart], joints: Array | None, compensate: Compensate | None
    ) -> None:
        """Begin an episode in the environments ``rows``, from joint targets ``(rows, n)`` if they are given."""
        x, task = self.x, self.task
        self.keys[rows] = keys = np.array([each.key for each in starts], dtype=np.uint64)
        if task.arms != "fixed":
            self.take_arms(rows, np.array([each.arm for each in starts], dtype=np.intp))
        self.still[rows], self.moments[rows] = STILL, 0
        for a, b in self.blocks(len(rows)):
            some = rows[a:b]
            if joints is not None:
                start: Any = list(self.numbers(joints[a:b].T))
            elif task.situation.spread:
                start = drawn_start(x, task.situation, keys[a:b], task.lower, task.upper)
            else:
                start = list(np.repeat(np.array([task.middle]), b - a, axis=0).T.copy())
            plant = self.plant_of(some)
            motion = begin_arm(x, task, plant, keys[a:b], start, self.commands(compensate, start))
            self._look(some, motion, plant, compensate, 0.0)
        for row, each in zip(rows.tolist(), starts, strict=True):
            self.fruit.adopt(row, each.scene)
            self._choose(row)

    def advance(self, actions: Array, going: Flags, compensate: Compensate | None) -> Array:
        """Act in all environments; what happens to the fruit, and rewards, only in those that are ``going``."""
        point, before = self.sight[TOOL][9:], self.sight[TOOL][9:].T.copy()
        gripper, period = np.empty(self.count), np.empty(self.count)
        self.moments += np.uint64(1)
        for block, plant in zip(self._blocks, self._plants, strict=True):
            motion = self.motion_of([column[block] for column in self.columns])
            motion, gripper[block], moved, dt = act_arm(self.x, self.task, motion, list(actions[:, block]))
            period[block] = dt
            self.still[block] = np.where(moved, 0.0, np.minimum(STILL, self.still[block] + dt))
            self._look(block, motion, plant, compensate, dt)
        fruit, tally = self.fruit, self.fruit.tally.copy()
        after, axis = point.T.copy(), self.sight[TOOL][6:9].T.copy()
        fruit.swing(going, period)
        fruit.meet(going, self.number, after, after - before, axis, period)
        self._work_grippers(np.flatnonzero(going & ((fruit.held >= 0) | (gripper > CLOSE))), gripper)
        collected, damaged = (fruit.tally - tally).T
        return np.where(going, pick_reward(collected, damaged), 0.0)

    def _work_grippers(self, rows: Rows, gripper: Array) -> None:
        believed, tool = (self.sight[part][:, rows].T.tolist() for part in (BELIEVED, TOOL))
        for i, row in enumerate(rows.tolist()):
            scene, number = self.fruit.scenes[row], int(self.number[row])
            scene.work_gripper(float(gripper[row]), number, believed[i], tool[i])
            self.fruit.note(row)
            if scene.held is None and not scene.waiting[number]:
                self._choose(row)

    def finished(self) -> Flags:
        """Where no fruit is left to try and the gripper is empty."""
        return (self.fruit.held < 0) & ~self.fruit.waiting().any(axis=1)

    def observations(self, low: NDArray[np.float32], high: NDArray[np.float32]) -> NDArray[np.float32]:
        """What the controllers know, ``(N, n + 17)``."""
        n, fruit = self.task.joints, self.fruit
        seen = fruit.seen[np.arange(self.count), self.number]
        out = np.empty((self.count, n + 17))
        out[:, :n] = self.sight[SIGHT : SIGHT + n].T
        out[:, n : n + 3] = believed = self.sight[BELIEVED][9:].T
        out[:, n + 3 : n + 6], out[:, n + 6 : n + 9] = seen, seen - believed
        out[:, n + 9 : n + 12] = self.sight[TURN].T
        out[:, n + 12], out[:, n + 13] = self.still, 1.0 - self.moments / LONGEST
        out[:, n + 14], out[:, n + 15] = (fruit.held >= 0) & ~fruit.off, fruit.off
        out[:, n + 16] = fruit.waiting().sum(axis=1) / MOST_LEFT
        return np.asarray(out.clip(low, high), dtype=np.float32)

    def information(self) -> dict[str, NDArray[Any]]:
        """The truth, as `pickenv/Pick-v0` explains it."""
        n, fruit, each = self.task.joints, self.fruit, np.arange(self.count)
        tool, funnel = self.sight[TOOL][9:], fruit.funnel()
        there = fruit.rest[each, self.number] + fruit.displacement[each, self.number]
        return {
            **funnel,
            "damaged": fruit.tally[:, 1].copy(),
            "is_success": funnel["collected"] == funnel["reachable"],
            "position_error_mm": apart_mm(self.x, list(there.T.copy()), list(tool)),
            "grasp_lateral_mm": 1e3 * fruit.miss[:, 0],
            "grasp_axial_mm": 1e3 * fruit.miss[:, 1],
            "tilt_deg": self.sight[TILT].copy(),
            "joint_command": self.sight[SIGHT + n :].T.copy(),
            "tool_position": tool.T.copy(),
            "fruit_position": there,
            "fruit_number": self.number.copy(),
        }

    def state_arrays(self) -> dict[str, NDArray[Any]]:
        """Everything that the next step depends on."""
        own = {name: getattr(self, name) for name in OWN}
        return super().state_arrays() | own | self.fruit.state_arrays()

    def take_state_arrays(self, state: dict[str, NDArray[Any]]) -> None:
        """The inverse of `state_arrays`."""
        super().take_state_arrays(state)
        for name in OWN:
            getattr(self, name)[:] = state[name]
        self.fruit.take_state_arrays(state)

    def _choose(self, row: int) -> None:
        """Go after the waiting fruit that comes next, or stay with the last one."""
        number = self.fruit.scenes[row].following(self.sight[BELIEVED][9:, row])
        self.number[row] = self.number[row] if number is None else number

    def _look(self, where: Any, motion: PickMotion, plant: Plant, compensate: Compensate | None, dt: Scalar) -> None:
        x, task = self.x, self.task
        command = self.commands(compensate, list(motion.target))
        motion, sight = look_at_arm(x, task, plant, motion, command, self.keys[where], self.moments[where], dt)
        self.write(self.columns, where, motion.columns)
        shown = [*sight.believed, *sight.tool, *sight.turn, sight.tilt, *sight.readings, *command]
        self.write(list(self.sight), where, shown)
