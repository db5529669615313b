"""A scripted policy for the harvester: plan the zone once, pick by the plan, plan anew for what was missed.

It uses the observation alone, and works for the Gymnasium environment and for PettingZoo's.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pickenv.arm import Array
from pickenv.harvester import assign, zone_work
from pickenv.harvester.work import Work

ARRIVED = 1e-3
"""A joint within this of its goal is there, m or rad."""
PATIENCE = 3
"""Periods that a risen cup waits for its sensor before it gives up."""


@dataclass(eq=False)
class _Arm:
    """State of one slave: its fruit still to pick, and the phase of the present pick."""

    queue: list[int] = field(default_factory=list)
    fruit: int | None = None
    phase: str = "travel"
    waited: int = 0


class ScriptedHarvest:
    """Drives every slave through its planned picks; an arm goes out only where no arm that is out would be met."""

    def __init__(self, env: Any, assignment: str = "search") -> None:
        """Read the machine from ``env``, a `pickenv/Harvest-v0` of Gymnasium or PettingZoo, wrapped or not."""
        self.task = env.unwrapped.task
        self.machine = self.task.machine
        self.assignment = assignment
        self.reset()

    def reset(self) -> None:
        """Forget the last zone."""
        self._arms = [_Arm() for _ in range(self.machine.arms)]
        self._work: Work | None = None

    def act(self, observation: NDArray[np.float32]) -> NDArray[np.float32]:
        """The next joint action of the whole machine."""
        machine = self.machine
        joints, busy, fruit, hangs = self._decoded(np.asarray(observation, dtype=float))
        idle = all(arm.fruit is None and not arm.queue for arm in self._arms)
        if idle and hangs.any():
            self._plan(joints[:3], fruit, hangs)
        goals = joints.copy()
        for i, arm in enumerate(self._arms):
            mine = slice(3 + 3 * i, 6 + 3 * i)
            goals[mine] = self._goal(i, arm, joints[mine], bool(busy[i] > 0), hangs)
        share = (goals - joints) / self.task.increment
        for i in range(machine.arms):  # swing and stretch keep step, as the plan's clearances suppose
            both = slice(4 + 3 * i, 6 + 3 * i)
            share[both] /= max(1.0, float(np.abs(share[both]).max()))
        return np.asarray(share.clip(-1.0, 1.0), dtype=np.float32)

    def act_together(self, observations: dict[str, NDArray[np.float32]]) -> dict[str, NDArray[np.float32]]:
        """The next actions of PettingZoo's agents."""
        shared = next(iter(observations.values()))[: len(self.task.bounds[0])]
        parts = self.act(shared).reshape(-1, 3)
        return dict(zip(observations, parts, strict=True))

    def _decoded(self, values: Array) -> tuple[Array, Array, Array, NDArray[np.bool_]]:
        """Joints, time left of each blade, fruit in the base frame, and whether each hangs in reach."""
        machine, n = self.machine, self.machine.joints
        joints = machine.lower + (values[:n] + 1) / 2 * (machine.upper - machine.lower)
        slots = values[n + machine.arms :].reshape(-1, 4)
        sin, cos = np.sin(joints[0]), np.cos(joints[0])
        right, ahead, up = slots[:, 0], slots[:, 1], slots[:, 2]
        away = np.stack([right * sin + ahead * cos, -right * cos + ahead * sin, up], axis=-1)
        return joints, values[n : n + machine.arms], machine.frame3(joints[:3]) + away, slots[:, 3] > 0.5

    def _plan(self, master: Array, fruit: Array, hangs: NDArray[np.bool_]) -> None:
        work = zone_work(self.machine, master, fruit)
        work.reached[:, ~hangs] = False
        self._work = work
        for arm, queue in zip(self._arms, assign(work, self.assignment), strict=True):
            arm.queue, arm.fruit = list(queue), None

    def _goal(self, i: int, arm: _Arm, here: Array, cutting: bool, hangs: NDArray[np.bool_]) -> Array:
        """The next goal of slave ``i``; moves its phase on."""
        home, work = self.machine.slave_home, self._work
        if arm.fruit is None:
            if not arm.queue or work is None:
                return here
            arm.fruit, arm.phase, arm.waited = arm.queue.pop(0), "travel", 0
        assert work is not None
        at, low = work.joints[i, arm.fruit], float(work.approach[arm.fruit])
        below = np.array([at[0] - low, *home[1:]])
        if arm.phase == "travel" and np.abs(here - below).max() < ARRIVED and self._clear(i, arm.fruit):
            arm.phase = "out"
        out = np.array([at[0] - low, *at[1:]])
        if arm.phase == "out" and np.abs(here - out).max() < ARRIVED:
            arm.phase = "rise"
        if arm.phase == "rise":
            risen = abs(here[0] - at[0]) < ARRIVED
            arm.waited += risen or cutting
            if not cutting and (arm.waited > PATIENCE or not hangs[arm.fruit]):
                arm.phase = "back"
        if arm.phase == "back":
            drawn_in = np.array([here[0], *home[1:]])
            if np.abs(here - drawn_in).max() < ARRIVED:
                arm.fruit = None
            return drawn_in
        return {"travel": below, "out": out, "rise": np.asarray(at)}[arm.phase]

    def _clear(self, i: int, fruit: int) -> bool:
        """Whether no arm that is out would be met on the way to ``fruit``."""
        assert self._work is not None
        return not any(
            arm.fruit is not None and arm.phase != "travel" and self._work.conflict[i, fruit, k, arm.fruit]
            for k, arm in enumerate(self._arms)
            if k != i
        )
