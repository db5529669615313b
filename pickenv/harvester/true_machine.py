"""The harvester as built, with a plant (true arm) for each arm, and the controller that corrects known errors.

A belief is a model that predicts the pose of an arm's last frame from joint commands. The nominal geometry is the
simplest belief; the compensator of a calibration is another. In the true machine, the true slaves are mounted on
frame 3 of the true master. Units: m, rad.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pickenv.arm import Array, Frame, Geometry, Plant, Pose, Scalars, attach, behind, forward, load_plant, split_joints
from pickenv.arm.kinematics.forward import ONE
from pickenv.base import InputError, read_toml
from pickenv.harvester.machine import SHIPPED, Machine, TrueTable, shifted

Rows = NDArray[np.intp]

ROUNDS = 3
"""Number of iterations of a correction; each reduces the error about a hundredfold."""


class Belief(Protocol):
    """Model of one arm that predicts poses from joint commands, such as the compensator of a calibration."""

    def predict(self, joints: ArrayLike, /) -> Pose:
        """Return the pose of the arm's last frame in the arm's base frame, at joint commands (..., 3)."""


@dataclass(frozen=True, eq=False)
class TrueMachine:
    """A machine as built, with a plant (the true arm with its errors) for each arm.

    Attributes:
        machine: The machine as designed.
        master: Plant of the master arm.
        slaves: Plants of the slaves, left to right.
        repeatability: Standard deviation per axis of the position at which an arm stops, m.
    """

    machine: Machine
    master: Plant
    slaves: tuple[Plant, ...]
    repeatability: float

    def ideal(self) -> TrueMachine:
        """Return the same machine without any errors: nominal geometry, no effects, exact stops."""
        plants = [replace(plant, geometry=plant.arm.nominal, effects=()) for plant in (self.master, *self.slaves)]
        return replace(self, master=plants[0], slaves=tuple(plants[1:]), repeatability=0.0)

    def frame3(self, master: ArrayLike) -> Pose:
        """Return the true pose of frame 3 (the slaves' mounting) in the base frame, for master commands (..., 3)."""
        return self.master.tool_pose(master)

    def tips(self, master: ArrayLike, slaves: ArrayLike) -> Array:
        """Compute the true cup positions of all slaves in the base frame, m, (..., arms, 3).

        The positions leave out the random error of each stop (`repeatability`).

        Args:
            master: Commands of the master, (..., 3).
            slaves: Commands of the slaves, (..., arms, 3).
        """
        master, slaves = np.asarray(master, dtype=float), np.asarray(slaves, dtype=float)
        if master.size == 3:
            cups = self.cups(ONE, master.ravel().tolist(), slaves.reshape(-1, 3).tolist())
            return np.array(cups).reshape(slaves.shape)
        arms = [split_joints(3, slaves[..., i, :]) for i in range(len(self.slaves))]
        cups = self.cups(np, split_joints(3, master), arms)
        return np.stack([np.stack(np.broadcast_arrays(*cup), axis=-1) for cup in cups], axis=-2)

    def cups(self, m: Any, master: Scalars, slaves: Sequence[Scalars]) -> list[Frame]:
        """Compute the true positions of all slaves' cups in the base frame, each as components x, y, z in metres.

        Args:
            m: NumPy, or `ONE` for single numbers.
            master: The three commands of the master.
            slaves: The three commands of each slave.
        """
        base = self.master.tool_frame(m, master)
        plants = zip(self.slaves, slaves, strict=True)
        return [attach(base, plant.tool_frame(m, joints))[9:] for plant, joints in plants]

    def picking_tips(self, master: Array, arm: Array, joints: Array) -> Array:
        """Compute the true cup position of each pick in the base frame, m, (picks, 3).

        The positions leave out the random error of each stop (`repeatability`).

        Args:
            master: Commands of the master at each pick, (picks, 3).
            arm: Index, from 0 on the left, of the slave of each pick, (picks,).
            joints: Commands of this slave, m and rad, (picks, 3).
        """
        plants, base = self.slaves, self.frame3(master)
        return _arm_by_arm(base, arm, lambda i, here, mine: behind(here, plants[i].tool_pose(joints[mine])).position)


@dataclass(frozen=True, eq=False)
class Controller:
    """Converter of nominal joints of the whole machine into commands, with a belief about each arm.

    A belief is a model that predicts the pose of an arm from its commands; see `Belief`.

    Attributes:
        machine: The machine as designed.
        master: Belief about the master, or None for its nominal geometry.
        slaves: Belief about each slave; empty for their nominal geometries.
    """

    machine: Machine
    master: Belief | None = None
    slaves: tuple[Belief, ...] = ()

    def __post_init__(self) -> None:
        if self.slaves and len(self.slaves) != self.machine.arms:
            raise InputError(f"{len(self.slaves)} beliefs were given for {self.machine.arms} slave arms; give one each")

    def __call__(self, joints: ArrayLike) -> Array:
        """Return the commands (..., 3 + 3 arms) for nominal joints of the same shape, corrected by the beliefs."""
        joints = np.array(joints, dtype=float)
        if self.master is None and not self.slaves:
            return joints
        master = self.master_command(joints[..., :3])
        base, targets = self._frame3(master), self.machine.tips(*self.machine.parted(joints))
        slaves = [self._slave_command(i, base, targets[..., i, :]) for i in range(self.machine.arms)]
        return np.concatenate([master, *slaves], axis=-1)

    def master_command(self, master: ArrayLike) -> Array:
        """Return the master's commands (..., 3) for nominal joints (..., 3), corrected by the belief about the master.

        Frame 3 carries the slaves. At the commands, the belief puts the origin of frame 3 where the nominal geometry
        puts it at the nominal joints.
        """
        machine, nominal = self.machine, np.asarray(master, dtype=float)
        if self.master is None:
            return nominal
        target = aim = machine.frame3(nominal)
        command = nominal
        for _ in range(ROUNDS):
            aim = aim + target - self.master.predict(command).position
            command = machine.master_inverse(aim).clip(machine.master.nominal.lower, machine.master.nominal.upper)
        return np.asarray(command)

    def pick_commands(self, master: Array, arm: Array, targets: Array) -> Array:
        """Return the slave commands (picks, 3) that bring each pick's cup, as believed, to its target.

        Args:
            master: Commands of the master at each pick, (picks, 3).
            arm: Index, from 0 on the left, of the slave of each pick, (picks,).
            targets: Target positions of the cups in the base frame, m, (picks, 3).
        """
        return _arm_by_arm(self._frame3(master), arm, lambda i, here, mine: self._slave_command(i, here, targets[mine]))

    def _frame3(self, master: Array) -> Pose:
        """Return the pose of frame 3 (the slaves' mounting) that the belief predicts for master commands (..., 3)."""
        return forward(self.machine.master.nominal, master) if self.master is None else self.master.predict(master)

    def _slave_command(self, i: int, base: Pose, targets: Array) -> Array:
        """Return the commands (..., 3) of a slave that, as believed, bring the slave's cup to target positions.

        Args:
            i: Index of the slave, from 0 on the left.
            base: Pose of frame 3, on which the slave is mounted, in the base frame.
            targets: Target positions in the base frame, m, (..., 3).
        """
        geometry = self.machine.slaves[i].nominal
        local = np.einsum("...ji,...j->...i", base.rotation, targets - base.position)
        aim, command = local, _local_inverse(geometry, local)
        for _ in range(ROUNDS if self.slaves else 0):
            aim = aim + local - self.slaves[i].predict(command).position
            command = _local_inverse(geometry, aim)
        return command


def _arm_by_arm(base: Pose, arm: Array, each: Callable[[int, Pose, Rows], Array]) -> Array:
    """Return an array (picks, 3), computed by ``each`` for the picks of one slave at a time.

    Args:
        base: Poses of frame 3, which carries the slaves, at all picks.
        arm: Index, from 0, of the slave of each pick, (picks,).
        each: Function of a slave's index, the poses of frame 3 at its picks, and the indices of these picks, from 0. It
            returns three numbers for each of these picks.
    """
    rows = np.empty((len(arm), 3))
    for i in np.unique(arm).tolist():
        mine = np.flatnonzero(arm == i)
        rows[mine] = each(i, Pose(base.position[mine], base.rotation[mine]), mine)
    return rows


def _local_inverse(slave: Geometry, local: Array) -> Array:
    """Return a slave's joints (..., 3), clipped to the limits, that bring its nominal cup to positions in frame 3.

    ``local`` has these positions (..., 3), m. Frame 3 carries the slaves; it has x right, y down and z ahead.
    """
    right, down, ahead = local[..., 0] - slave.a[0], local[..., 1], local[..., 2] - slave.a[1]
    joints = np.stack([-down, np.arctan2(-right, ahead), np.hypot(right, ahead)], axis=-1)
    return np.asarray(joints.clip(slave.lower, slave.upper))


def load_true_machine(machine: Machine, path: str | Path = SHIPPED) -> TrueMachine:
    """Read the machine as built from the machine's file.

    Args:
        machine: The machine as designed.
        path: The file; Li's machine by default.

    Raises:
        InputError: If the table [true] is missing, a number is outside its limits, or a plant's arm is not an arm of
            the machine.
    """
    table = read_toml(TrueTable, path, section="true")
    master, slave = load_plant(table.master), load_plant(table.slave)
    if master.arm.fingerprint() != machine.master.fingerprint():
        raise InputError(f"{path}: plant '{master.name}' is not one of arm '{machine.master.name}'")
    if shifted(slave.arm.nominal, float(machine.offsets[0])).fingerprint() != machine.slave.fingerprint():
        raise InputError(f"{path}: plant '{slave.name}' is not one of arm '{machine.slaves[0].name}'")
    seats = zip(machine.offsets.tolist(), table.seat_right, table.seat_ahead, table.seat_up, strict=False)
    return TrueMachine(machine, master, tuple(_seated(slave, *seat) for seat in seats), table.repeatability)


def _seated(plant: Plant, offset: float, right: float, ahead: float, up: float) -> Plant:
    """Return a slave's plant as mounted on the frame, with the position errors of the slave's seat.

    Args:
        plant: The slave's plant (the true arm with its errors).
        offset: Distance by which the slave is mounted farther to the right, m.
        right: Error of the seat's position to the right, m.
        ahead: Error of the seat's position ahead, m.
        up: Error of the seat's position upwards, m.
    """
    delta = np.zeros(5 * plant.geometry.joints + 12)
    delta[-12:-9] = right, -up, ahead
    geometry = shifted(plant.geometry, offset).displaced(delta)
    arm = replace(plant.arm, nominal=shifted(plant.arm.nominal, offset), true=geometry)
    return replace(plant, arm=arm, geometry=geometry)
