"""The fruit of many canopies in one set of arrays, of which each `PickScene` holds its own part.

What happens to all fruit in every period goes through the arrays at once; what happens to one canopy now and then, a
grasp or a push, goes through its scene. Both write the same numbers. Units: m, s.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pickenv import orchard as trees
from pickenv.arm import Array
from pickenv.envs.picking.pick_scene import FATES, Contact, PickScene, PickSetting, contact
from pickenv.envs.shared.arm_batch import Flags, Rows

FAR = 1e6
"""Where fruit hangs that is not there: an array has room for the fullest canopy."""

NUMBERS = {"rest": 3, "seen": 3, "diameters": 0, "masses": 0, "displacement": 3, "velocity": 3}
EMPTY = {"rest": FAR, "masses": 1.0}
LOOSE = ("displacement", "velocity", *FATES)
"""What changes during an episode."""
EACH = (*NUMBERS, "chance", "pull", "twist", "visible", "reachable", *FATES)
STAGES = ("visible", "reachable", "attempted", "attached", "detached")


class FruitTable:
    """The fruit before N arms, leading axes (N, most fruit of a canopy).

    Attributes:
        scenes: The canopies one by one; what changes in them are views of the arrays.
        held: Number of the fruit in each gripper, or -1.
        miss: How far each last grasp was from its fruit, across and along the tool's axis, (N, 2).
        off: Whether the fruit in the gripper is off its stem.
        tally: Fruit collected undamaged, and damaged, (N, 2).
    """

    rest: Array
    seen: Array
    diameters: Array
    masses: Array
    displacement: Array
    velocity: Array
    visible: Flags
    reachable: Flags
    attempted: Flags
    attached: Flags
    detached: Flags
    collected: Flags
    damaged: Flags

    def __init__(self, orchard: PickSetting, count: int) -> None:
        self.orchard, self.count = orchard, count
        self.scenes: list[Any] = [None] * count
        self.present = np.zeros(count, dtype=np.int64)
        self.held = np.full(count, -1)
        self.off = np.zeros(count, dtype=np.bool_)
        self.miss = np.zeros((count, 2))
        self.tally = np.zeros((count, 2), dtype=np.int64)
        self._make_room(1)

    def adopt(self, row: int, scene: PickScene) -> None:
        """Put a canopy into row ``row``."""
        n = len(scene.rest)
        if n > self.rest.shape[1]:
            self._make_room(n)
        for name in (*NUMBERS, "visible", "reachable", *FATES):
            array = getattr(self, name)
            array[row] = EMPTY.get(name, 0)
            array[row, :n] = getattr(scene, name)
        self.scenes[row], self.present[row] = scene, n
        self._lend(row)
        self.note(row)

    def note(self, row: int) -> None:
        """Write down what a grasp, a push or a twist has changed in a scene."""
        scene = self.scenes[row]
        self.held[row] = -1 if scene.held is None else scene.held
        self.off[row], self.miss[row] = scene.holds_detached, scene.miss
        self.tally[row] = scene.tally()

    def waiting(self) -> Flags:
        """Fruit that can still be tried."""
        return self.reachable & ~self.attempted

    def swing(self, going: Flags, dt: Array) -> None:
        """Let fruit swing for ``dt`` seconds, (N,), where it does."""
        moving = going & (self.displacement.any(axis=(1, 2)) | self.velocity.any(axis=(1, 2)))
        rows = np.flatnonzero(moving)
        if rows.size:
            self.displacement[rows], self.velocity[rows] = trees.swing(
                self.orchard.branch,
                self.displacement[rows],
                self.velocity[rows],
                self.masses[rows],
                dt[rows, None],
            )

    def meet(self, going: Flags, targets: Rows, point: Array, moved: Array, axis: Array, dt: Array) -> None:
        """Let each tool take along what it holds, and push what is in its way; arguments (N, ...)."""
        for row in np.flatnonzero(going & (self.held >= 0) & ~self.off):
            self.scenes[row].carry(point[row], moved[row])
        found = contact(self.orchard.station, self.rest + self.displacement, self.diameters, point, axis)
        for row in np.flatnonzero(going & found.touched.any(axis=1)).tolist():
            n = self.present[row]
            across, gap, overlap, touched = found
            mine = Contact(across[row, :n], gap[row, :n], overlap[row, :n], touched[row, :n])
            self.scenes[row].meet(mine, int(targets[row]), moved[row], float(dt[row]))
            self.note(row)

    def funnel(self) -> dict[str, NDArray[np.int64]]:
        """Fruit that got through each stage; none has more than the one before."""
        passed = {stage: getattr(self, stage).sum(axis=1) for stage in STAGES}
        return {"present": self.present.copy(), **passed, "collected": self.tally[:, 0].copy()}

    def state_arrays(self) -> dict[str, NDArray[Any]]:
        """All canopies, fruit by fruit, and what their grippers do."""
        each = [np.column_stack([_part(scene, name) for name in EACH]) for scene in self.scenes]
        grips = [
            [-1.0 if scene.held is None else scene.held, *scene.miss, *scene.grip, scene.detached_at]
            for scene in self.scenes
        ]
        return {"present": self.present, "each": np.concatenate(each), "grips": np.array(grips)}

    def take_state_arrays(self, state: dict[str, NDArray[Any]]) -> None:
        """The inverse of `state_arrays`."""
        ends = np.cumsum(state["present"])[:-1]
        for row, (fruit, grip) in enumerate(zip(np.split(state["each"], ends), state["grips"], strict=True)):
            parts: dict[str, Any] = {}
            first = 0
            for name in EACH:
                width = NUMBERS.get(name, 0) or 1
                parts[name] = fruit[:, first : first + width].copy() if width > 1 else fruit[:, first].copy()
                first += width
            given: dict[str, Any] = {name: parts[name] for name in ("rest", "diameters", "masses", "chance", "seen")}
            given |= {name: parts[name].astype(np.bool_) for name in ("visible", "reachable")}
            strength = trees.Strength(parts["pull"], parts["twist"])
            scene = PickScene(orchard=self.orchard, strength=strength, **given)
            for name in LOOSE:
                getattr(scene, name)[:] = parts[name]
            held, across, along, *rest = grip.tolist()
            scene.held, scene.miss = None if held < 0 else int(held), (across, along)
            scene.grip, scene.detached_at = np.array(rest[:3]), rest[3]
            self.adopt(row, scene)

    def _make_room(self, most: int) -> None:
        for name, width in NUMBERS.items():
            fresh = np.full((self.count, most, width) if width else (self.count, most), EMPTY.get(name, 0.0))
            self._replace(name, fresh)
        for name in ("visible", "reachable", *FATES):
            self._replace(name, np.zeros((self.count, most), dtype=np.bool_))
        for row, scene in enumerate(self.scenes):
            if scene is not None:
                self._lend(row)

    def _replace(self, name: str, fresh: NDArray[Any]) -> None:
        old = getattr(self, name, None)
        if old is not None:
            fresh[:, : old.shape[1]] = old
        setattr(self, name, fresh)

    def _lend(self, row: int) -> None:
        n = self.present[row]
        for name in LOOSE:
            setattr(self.scenes[row], name, getattr(self, name)[row, :n])


def _part(scene: PickScene, name: str) -> Array:
    return np.asarray(getattr(scene.strength if name in ("pull", "twist") else scene, name), dtype=float)
