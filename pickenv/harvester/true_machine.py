"""The harvester as built: a plant for the master and one for each slave, and the correction of what is known of them.

A belief predicts where an arm's frame stands for joint commands; the nominal geometry is the simplest, a calibration's
compensator another. Frame 3 of the true master carries the true slaves. Units: m, rad.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pickenv.arm import Array, Frame, Geometry, Plant, Pose, forward, load_plant
from pickenv.arm.kinematics.backend import ONE
from pickenv.arm.kinematics.forward import Scalar, attach, split_joints
from pickenv.base import InputError, read_toml
from pickenv.harvester.machine import SHIPPED, Machine, MachineFile, composed, shifted

Rows = NDArray[np.intp]

ROUNDS = 3
"""Corrections; each leaves a hundredth of what was before."""


class Belief(Protocol):
    """A controller's knowledge of one arm; a calibration's compensator is one."""

    def predict(self, joints: ArrayLike, /) -> Pose:
        """Pose of the arm's last frame at joint commands (..., 3)."""
        ...


@dataclass(frozen=True, eq=False)
class TrueMachine:
    """A machine as built.

    Attributes:
        machine: The machine as drawn.
        master: Plant of the master.
        slaves: Plant of each slave.
        repeatability: Standard deviation per axis of each arm's stop, m.
    """

    machine: Machine
    master: Plant
    slaves: tuple[Plant, ...]
    repeatability: float

    def ideal(self) -> TrueMachine:
        """The machine if it were as drawn: no errors at all."""
        plants = [replace(plant, geometry=plant.arm.nominal, effects=()) for plant in (self.master, *self.slaves)]
        return replace(self, master=plants[0], slaves=tuple(plants[1:]), repeatability=0.0)

    def frame3(self, master: ArrayLike) -> Pose:
        """True pose of frame 3 for master commands (..., 3)."""
        return self.master.tool_pose(master)

    def tips(self, master: ArrayLike, slaves: ArrayLike) -> Array:
        """True cups (..., arms, 3) for commands (..., 3) and (..., arms, 3), without the spread of repeated stops."""
        master, slaves = np.asarray(master, dtype=float), np.asarray(slaves, dtype=float)
        if master.size == 3:
            cups = self.cups(ONE, master.ravel().tolist(), slaves.reshape(-1, 3).tolist())
            return np.array(cups).reshape(slaves.shape)
        arms = [split_joints(3, slaves[..., i, :]) for i in range(len(self.slaves))]
        cups = self.cups(np, split_joints(3, master), arms)
        return np.stack([np.stack(np.broadcast_arrays(*cup), axis=-1) for cup in cups], axis=-2)

    def cups(self, m: Any, master: Sequence[Scalar], slaves: Sequence[Sequence[Scalar]]) -> list[Frame]:
        """True cups, component by component."""
        base = self.master.tool_frame(m, master)
        plants = zip(self.slaves, slaves, strict=True)
        return [attach(base, plant.tool_frame(m, joints))[9:] for plant, joints in plants]

    def picking_tips(self, master: Array, arm: Array, joints: Array) -> Array:
        """True cups of picks (picks, 3), without the spread of repeated stops.

        Args:
            master: Master commands at each pick, (picks, 3).
            arm: Slave of each pick, (picks,).
            joints: Its command, (picks, 3).
        """

        def cups(i: int, base: Pose, mine: Rows) -> Array:
            return composed(base, self.slaves[i].tool_pose(joints[mine])).position

        return _arm_by_arm(self.frame3(master), arm, cups)


@dataclass(frozen=True, eq=False)
class Controller:
    """Turns nominal joints of the whole machine into commands, arm by arm, with what is believed of each.

    Attributes:
        machine: The machine as drawn.
        master: Belief about the master, or None for the nominal one.
        slaves: Belief about each slave; empty for the nominal ones.
    """

    machine: Machine
    master: Belief | None = None
    slaves: tuple[Belief, ...] = ()

    def __post_init__(self) -> None:
        if self.slaves and len(self.slaves) != self.machine.arms:
            raise InputError(f"{len(self.slaves)} beliefs were given for {self.machine.arms} slave arms; give one each")

    def __call__(self, joints: ArrayLike) -> Array:
        """Commands (..., 3 + 3 arms) for nominal joints of the same shape: the compensator of a whole machine."""
        joints = np.array(joints, dtype=float)
        if self.master is None and not self.slaves:
            return joints
        master = self.master_command(joints[..., :3])
        base, targets = self._frame3(master), self.machine.tips(*self.machine.parted(joints))
        slaves = [self._slave_command(i, base, targets[..., i, :]) for i in range(self.machine.arms)]
        return np.concatenate([master, *slaves], axis=-1)

    def master_command(self, master: ArrayLike) -> Array:
        """Master commands (..., 3) that bring the believed frame 3 where the nominal one would be."""
        machine, nominal = self.machine, np.asarray(master, dtype=float)
        if self.master is None:
            return nominal
        target, aim = machine.frame3(nominal), machine.frame3(nominal)
        command = nominal
        for _ in range(ROUNDS):
            aim = aim + target - self.master.predict(command).position
            command = machine.master_inverse(aim).clip(machine.master.nominal.lower, machine.master.nominal.upper)
        return np.asarray(command)

    def pick_commands(self, master: Array, arm: Array, targets: Array) -> Array:
        """Slave commands (picks, 3) for targets (picks, 3), with the master at the commands ``master``."""
        base = self._frame3(master)
        return _arm_by_arm(base, arm, lambda i, here, mine: self._slave_command(i, here, targets[mine]))

    def _frame3(self, master: Array) -> Pose:
        """Believed pose of frame 3 for master commands (..., 3)."""
        return forward(self.machine.master.nominal, master) if self.master is None else self.master.predict(master)

    def _slave_command(self, i: int, base: Pose, targets: Array) -> Array:
        """Joints that bring the believed cup of slave ``i`` to targets in the base frame, frame 3 at ``base``."""
        geometry = self.machine.slaves[i].nominal
        local = np.einsum("...ji,...j->...i", base.rotation, targets - base.position)
        aim = local
        command = _local_inverse(geometry, aim)
        if self.slaves:
            for _ in range(ROUNDS):
                command = command.clip(geometry.lower, geometry.upper)
                aim = aim + local - self.slaves[i].predict(command).position
                command = _local_inverse(geometry, aim)
        return np.asarray(command.clip(geometry.lower, geometry.upper))


def _arm_by_arm(base: Pose, arm: Array, each: Callable[[int, Pose, Rows], Array]) -> Array:
    """The rows (picks, 3) that ``each`` gives for the picks of every slave, frame 3 at ``base``."""
    rows = np.empty((len(arm), 3))
    for i in np.unique(arm).tolist():
        mine = np.flatnonzero(arm == i)
        rows[mine] = each(i, Pose(base.position[mine], base.rotation[mine]), mine)
    return rows


def _local_inverse(slave: Geometry, local: Array) -> Array:
    """Eq (6) in frame 3 (x right, y down, z ahead)."""
    right, down, ahead = local[..., 0] - slave.a[0], local[..., 1], local[..., 2] - slave.a[1]
    return np.stack([-down, np.arctan2(-right, ahead), np.hypot(right, ahead)], axis=-1)


def load_true_machine(machine: Machine, path: str | Path = SHIPPED) -> TrueMachine:
    """The machine as built, from the same file as the machine.

    Raises:
        InputError: If a number is impossible or a plant is not that of the machine's arm.
    """
    table = read_toml(MachineFile, path).true
    if table is None:
        raise InputError(f"{path}: section [true] is missing; name the plants of master and slave there")
    master, slave = load_plant(table.master), load_plant(table.slave)
    if master.arm.fingerprint() != machine.master.fingerprint():
        raise InputError(f"{path}: plant '{master.name}' is not one of arm '{machine.master.name}'")
    return TrueMachine(
        machine=machine,
        master=master,
        slaves=tuple(
            _seated(slave, float(machine.offsets[i]), table.seat_right[i], table.seat_ahead[i], table.seat_up[i])
            for i in range(machine.arms)
        ),
        repeatability=table.repeatability,
    )


def _seated(plant: Plant, offset: float, right: float, ahead: float, up: float) -> Plant:
    """A slave's plant at its offset, its true chain displaced by the error of its seat."""
    arm = shifted(replace(plant.arm, true=plant.geometry), offset)  # a calibrated arm's file has no other truth
    assert arm.true is not None
    delta = np.zeros(5 * arm.true.joints + 12)
    delta[-12:-9] = right, -up, ahead
    arm = replace(arm, true=arm.true.displaced(delta))
    assert arm.true is not None
    return replace(plant, arm=arm, geometry=arm.true)
