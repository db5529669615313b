"""The harvester of Li 2016: one master arm (R, P, P) that carries one to six slave arms (P, R, P).

The kinematics are the closed forms of eqs (4), (5) and (6); eqs (5) and (6) use the two-argument arctangent. The base
frame has z up and the trees at negative y. The slaves stand side by side across the master's heading, numbered from
left to right. Joints of the master are theta1, d2, d3; joints of a slave are d4, theta5 (counted from -pi/2) and d6.
Moves have trapezoidal speed profiles within limits of speed and acceleration (Fig. 9). Units: m, rad, s.
"""

from __future__ import annotations

from dataclasses import astuple, dataclass, replace
from functools import cached_property
from numbers import Real
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pickenv.arm import Arm, Array, Geometry, behind, forward, load_arm
from pickenv.base import DEG, MM, SECONDS, WHOLE, Check, InputError, Key, Unit, read_toml, toml_table

SHIPPED = Path(__file__).parent / "li2016.toml"
MOST_SLAVES = 6
ROUNDING = 1e-9

Flags = NDArray[np.bool_]


@toml_table
class Body:
    """A slave arm as an obstacle: a capsule around the line from its pivot to its cup.

    Attributes:
        radius: Radius of the capsule, m.
        margin: Least allowed distance between the surfaces of two arms, m.
        guard: Distance between surfaces, m: a side arm (even index, from 0 on the left) waits while its ultrasonic
            ranger measures less.
    """

    radius: Annotated[float, MM.positive]
    margin: Annotated[float, MM.not_negative]
    guard: Annotated[float, MM.not_negative]

    @property
    def clearance(self) -> float:
        """Least allowed distance between the centre lines of two arms, m."""
        return 2 * self.radius + self.margin


@toml_table
class Ranger:
    """Ultrasonic rangers of a side arm (even index, from 0 on the left): one on each flank of its cup.

    They measure sideways, towards the neighbouring arms, which are middle arms (odd index).

    Attributes:
        farthest: Longest distance from which an echo returns, m.
        beam: Half angle of the cone in which a ranger measures, rad.
        noise: Standard deviation of a measured distance, m.
        period: Time between two measurements of a ranger, s.
    """

    farthest: Annotated[float, Key("range_mm"), MM.positive]
    beam: Annotated[float, Key("half_beam_deg"), DEG.within(0.0, 89.0, "a cone")]
    noise: Annotated[float, MM.not_negative]
    period: Annotated[float, SECONDS.positive]


@toml_table
class Cycle:
    """Times and lengths of a pick.

    Attributes:
        approach: Distance below the fruit at which the cup starts to rise, m.
        sense: Time that the sensor takes to detect the fruit in the cup, s.
        cut: Time that the blade takes, s.
        image: Time to take and analyse a picture, s.
        unload: Time to empty the tubes, s.
        tube_fruit: Number of fruit at which the tube of one arm is full.
    """

    approach: Annotated[float, MM.not_negative]
    sense: Annotated[float, SECONDS.not_negative]
    cut: Annotated[float, SECONDS.not_negative]
    image: Annotated[float, SECONDS.not_negative]
    unload: Annotated[float, SECONDS.not_negative]
    tube_fruit: Annotated[int, WHOLE.positive]


@dataclass(frozen=True, eq=False)
class Machine:
    """A master arm and its slaves as designed; without a calibration, a controller knows only this machine.

    Attributes:
        master: The master arm, from the base frame to frame 3, on which the slaves are mounted.
        slaves: The slave arms from left to right, each from frame 3 to its cup. They differ only in a3 (see `offsets`).
        spacing: Distance between neighbouring slaves, m.
        master_start: Joints of the master where it starts and unloads, rad and m, (3,).
        slave_home: Joints of a slave at rest, m and rad, (3,): lowest, straight ahead, shortest.
        master_acceleration: Largest acceleration of each joint of the master, rad/s² and m/s², (3,).
        slave_acceleration: Largest acceleration of each joint of a slave, m/s² and rad/s², (3,).
        base_height: Height of the base frame above the ground, m.
        body: The slave arms as obstacles.
        cycle: Times and lengths of a pick.
        ranger: Ultrasonic rangers of the side arms.
    """

    master: Arm
    slaves: tuple[Arm, ...]
    spacing: float
    master_start: Array
    slave_home: Array
    master_acceleration: Array
    slave_acceleration: Array
    base_height: float
    body: Body
    cycle: Cycle
    ranger: Ranger

    @property
    def arms(self) -> int:
        """Number of slave arms."""
        return len(self.slaves)

    @cached_property
    def offsets(self) -> Array:
        """Offset of each slave across the master's heading (a3), m, (arms,); negative on the left."""
        return np.array([slave.nominal.a[0] for slave in self.slaves])

    @cached_property
    def slave(self) -> Geometry:
        """Nominal geometry of the left-most slave; the other slaves differ in a3 only."""
        return self.slaves[0].nominal

    @property
    def d1(self) -> float:
        """Height of the master's shoulder above the base frame, m: 290 mm in the paper."""
        return float(self.master.nominal.d[0])

    @property
    def a2(self) -> float:
        """Offset of frame 3, which carries the slaves, from the master's vertical axis, m: 155 mm in the paper."""
        return float(self.master.nominal.a[2])

    @property
    def a4(self) -> float:
        """Distance of the slaves' pivots from frame 3 along the master's heading, m: 52 mm in the paper."""
        return float(self.slave.a[1])

    @property
    def joints(self) -> int:
        """Number of joints of the whole machine."""
        return 3 + 3 * self.arms

    @cached_property
    def lower(self) -> Array:
        """Lower limits of all joints, (3 + 3 arms,), rad and m."""
        return np.concatenate([arm.nominal.lower for arm in (self.master, *self.slaves)])

    @cached_property
    def upper(self) -> Array:
        """Upper limits of all joints, (3 + 3 arms,), rad and m."""
        return np.concatenate([arm.nominal.upper for arm in (self.master, *self.slaves)])

    @cached_property
    def speed(self) -> Array:
        """Largest speeds of all joints, (3 + 3 arms,), rad/s and m/s."""
        return np.concatenate([arm.speed for arm in (self.master, *self.slaves)])

    def parted(self, joints: Array) -> tuple[Array, Array]:
        """Split joints of the machine (..., 3 + 3 arms) into the master's (..., 3) and the slaves' (..., arms, 3)."""
        return joints[..., :3], joints[..., 3:].reshape(*joints.shape[:-1], self.arms, 3)

    def frame3(self, master: ArrayLike) -> Array:
        """Return the origin of frame 3, which carries the slaves, in the base frame, m, (..., 3), by eq (2).

        ``master`` has the master's joints theta1, d2, d3 (..., 3), rad and m.
        """
        master = np.asarray(master, dtype=float)
        theta1, d2, d3 = (master[..., i] for i in range(3))
        sin, cos = np.sin(theta1), np.cos(theta1)
        position = np.empty(master.shape)
        position[..., 0], position[..., 1] = d3 * cos + self.a2 * sin, d3 * sin - self.a2 * cos
        position[..., 2] = d2 + self.d1
        return position

    def master_inverse(self, position: ArrayLike) -> Array:
        """Compute the master joints (..., 3) that bring the origin of frame 3 to a position, by eq (5).

        Frame 3 carries the slaves. The equation is corrected for y > 0.

        Args:
            position: Positions in the base frame, m, (..., 3).

        Returns:
            Joints, rad and m, not clipped to the limits; `master_within_limits` checks them. NaN for positions nearer
            to the master's axis than `a2`.
        """
        x, y, z = np.moveaxis(np.asarray(position, dtype=float), -1, 0)
        square = x * x + y * y - self.a2**2
        d3 = np.sqrt(np.where(square >= 0, square, np.nan))
        return np.stack([_wrapped(np.arctan2(y, x) + np.arctan2(self.a2, d3)), z - self.d1, d3], axis=-1)

    def tips(self, master: ArrayLike, slaves: ArrayLike) -> Array:
        """Compute the positions of all slaves' cups by eq (4).

        Args:
            master: Joints theta1, d2, d3 of the master, rad and m, (..., 3).
            slaves: Joints d4, theta5 + pi/2, d6 of the slaves, m and rad, (..., arms, 3).

        Returns:
            Positions in the base frame, m, (..., arms, 3).
        """
        master, slaves = np.asarray(master, dtype=float), np.asarray(slaves, dtype=float)
        theta1, d2, d3 = (master[..., None, i] for i in range(3))
        d4, swing, d6 = (slaves[..., i] for i in range(3))
        side, ahead = self.a2 + self.offsets, self.a4 + d3
        sin, cos, turn = np.sin(theta1), np.cos(theta1), theta1 + swing
        x = d6 * np.cos(turn) + ahead * cos + side * sin
        positions = np.empty((*x.shape, 3))
        positions[..., 0], positions[..., 1] = x, d6 * np.sin(turn) + ahead * sin - side * cos
        positions[..., 2] = d4 + d2 + self.d1
        return positions

    def slave_inverse(self, master: ArrayLike, targets: ArrayLike) -> Array:
        """Compute the joints of every slave for every target by eq (6).

        In eq (6), theta5 = -theta1 - atan2(A, B). The returned joint is theta5 + pi/2, wrapped to [-pi, pi).

        Args:
            master: Joints theta1, d2, d3 of the master, rad and m, (..., 3).
            targets: Target positions of the cups in the base frame, m, (..., n, 3).

        Returns:
            Slave joints (..., arms, n, 3), m and rad, not clipped to the limits; `within_limits` checks them.
        """
        master, targets = np.asarray(master, dtype=float), np.asarray(targets, dtype=float)[..., None, :, :]
        theta1, d2, d3 = (master[..., None, None, i] for i in range(3))
        side, ahead = (self.a2 + self.offsets)[:, None], self.a4 + d3
        sin, cos = np.sin(theta1), np.cos(theta1)
        a = targets[..., 0] - ahead * cos - side * sin
        b = targets[..., 1] - ahead * sin + side * cos
        swing = _wrapped(-theta1 - np.arctan2(a, b) + np.pi / 2)
        d4 = np.broadcast_to(targets[..., 2] - d2 - self.d1, swing.shape)
        return np.stack([d4, swing, np.hypot(a, b)], axis=-1)

    def within_limits(self, slave_joints: ArrayLike) -> Flags:
        """Return flags (...): whether slave joints (..., 3) are within the limits; False for NaN."""
        return _inside(self.slave, slave_joints)

    def master_within_limits(self, master_joints: ArrayLike) -> Flags:
        """Return flags (...): whether master joints (..., 3) are within the limits; False for NaN."""
        return _inside(self.master.nominal, master_joints)

    def reach(self, master: ArrayLike, targets: ArrayLike) -> Flags:
        """Return flags (..., arms, n): whether each slave's cup reaches each target while the master stands still.

        ``master`` has the master's joints (..., 3), rad and m. Targets (..., n, 3) are in the base frame, m.
        """
        return self.within_limits(self.slave_inverse(master, targets))


def _inside(geometry: Geometry, joints: ArrayLike) -> Flags:
    """Return flags (...): whether joints (..., 3) are within the limits; False for NaN."""
    q = np.asarray(joints, dtype=float)
    return np.asarray(((q >= geometry.lower - ROUNDING) & (q <= geometry.upper + ROUNDING)).all(axis=-1))


ARM = Check(lambda value: isinstance(value, str), "the name of an arm or the path of an arm file")
PLANT = Check(lambda value: isinstance(value, str), "the name of a plant or the path of a plant file")
Seats = tuple[float, float, float, float, float, float]
MM_PER_S2, DEG_PER_S2 = Unit("mm_per_s2", 1e-3).positive, Unit("deg_per_s2", np.pi / 180.0).positive


@toml_table
class MachineTable:
    """Table [machine] of a machine file: the arms by name, and how they are mounted; see `Machine`."""

    master: Annotated[str, ARM]
    slave: Annotated[str, ARM]
    slaves: Annotated[int, WHOLE]
    spacing: Annotated[float, MM.positive]
    base_height: Annotated[float, MM.not_negative]
    master_start: Annotated[tuple[float, float, float], MM]
    slave_home: Annotated[float, MM]


@toml_table
class AccelerationTable:
    """Table [acceleration] of a machine file: largest accelerations of the turning and sliding joints."""

    master_turn: Annotated[float, DEG_PER_S2, Key("master_deg_per_s2")]
    master_slides: Annotated[tuple[float, float], MM_PER_S2, Key("master_mm_per_s2")]
    slave_slides: Annotated[tuple[float, float], MM_PER_S2, Key("slave_mm_per_s2")]
    slave_turn: Annotated[float, DEG_PER_S2, Key("slave_deg_per_s2")]


@toml_table
class TrueTable:
    """Table [true] of a machine file: how the machine as built differs from its design.

    It names the plants (true arms with their errors) of master and slaves. It gives the position errors of each slave's
    seat on the frame, and the repeatability. See `pickenv.harvester.true_machine.TrueMachine`.
    """

    master: Annotated[str, PLANT]
    slave: Annotated[str, PLANT]
    seat_right: Annotated[Seats, MM]
    seat_ahead: Annotated[Seats, MM]
    seat_up: Annotated[Seats, MM]
    repeatability: Annotated[float, MM.not_negative]


@toml_table
class WorkspaceTable:
    """Table [workspace] of a machine file: ranges in the base frame, m, where the points that cups reach lie densely.

    The workspace of a calibration is something else: the space in which an arm will work.
    """

    dense_x: Annotated[tuple[float, float], MM]
    dense_y: Annotated[tuple[float, float], MM]
    dense_z: Annotated[tuple[float, float], MM]


@toml_table
class MachineFile:
    """All tables of a machine file."""

    machine: MachineTable
    body: Body
    acceleration: AccelerationTable
    cycle: Cycle
    ranger: Ranger
    workspace: WorkspaceTable | None = None
    true: TrueTable | None = None


def load_machine(path: str | Path = SHIPPED, *, slaves: int | None = None, spacing: float | None = None) -> Machine:
    """Read a machine from its TOML file.

    Args:
        path: The file; Li's machine by default.
        slaves: Number of slave arms, 1 to 6; the file's by default.
        spacing: Distance between neighbouring slaves, m; the file's by default. The paper also implies 0.3 and 0.45 m.

    Raises:
        InputError: If a number is outside its limits, if the joints of the master's start or of a slave at rest are
            outside the joint limits, or if a swinging slave could touch a neighbour at rest.
    """
    file = read_toml(MachineFile, path)
    head, accelerations = file.machine, file.acceleration
    count: Any = head.slaves if slaves is None else slaves
    is_number = isinstance(count, Real) and not isinstance(count, bool)
    if not is_number or not 1 <= count <= MOST_SLAVES or count != int(count):
        raise InputError(f"a machine cannot have {count} slave arms; give a whole number from 1 to {MOST_SLAVES}")
    between = head.spacing if spacing is None else float(spacing)
    if not (np.isfinite(between) and between > 0):
        raise InputError(f"a slave spacing of {between} m is impossible; give a number above zero")
    slide, telescope = accelerations.slave_slides
    slave = load_arm(head.slave)
    machine = Machine(
        master=load_arm(head.master),
        slaves=tuple(
            replace(slave, nominal=shifted(slave.nominal, shift), true=slave.true and shifted(slave.true, shift))
            for shift in ((np.arange(int(count)) - (int(count) - 1) / 2) * between).tolist()
        ),
        spacing=between,
        master_start=np.zeros(3),
        slave_home=np.array([head.slave_home, 0.0, float(slave.nominal.lower[2])]),
        master_acceleration=np.array([accelerations.master_turn, *accelerations.master_slides]),
        slave_acceleration=np.array([slide, accelerations.slave_turn, telescope]),
        base_height=head.base_height,
        body=file.body,
        cycle=file.cycle,
        ranger=file.ranger,
    )
    start = machine.master_inverse(np.array(head.master_start))
    if not machine.master_within_limits(start):
        point = [round(value * 1e3, 6) for value in head.master_start]
        raise InputError(f"{path}: master_start_mm of [machine] is {point}; give a point that the master reaches")
    low, high = float(slave.nominal.lower[0]), float(slave.nominal.upper[0])
    if not low - ROUNDING <= head.slave_home <= high + ROUNDING:
        height = f"slave_home_mm of [machine] is {1e3 * head.slave_home:g}"
        raise InputError(f"{path}: {height}; give a height in the slave's range, {1e3 * low:g} to {1e3 * high:g}")
    refuse_touching_arms(machine)
    refuse_other_tables(machine, path)
    return replace(machine, master_start=start)


def refuse_other_tables(machine: Machine, path: str | Path) -> None:
    """Raise an error if the closed forms of eqs (2) and (4) do not describe the link tables of the machine's arms.

    ``path`` is the machine's file, for the message.

    Raises:
        InputError: If master or slave does not have three joints, or its link table differs from Li's link table in any
            parameter besides d1, a2, a3 and a4.
    """
    share = np.array([0.2, 0.5, 0.8])
    master, slave = machine.master.nominal, machine.slaves[0].nominal
    if master.joints == slave.joints == 3:
        q, s = (arm.lower + share * (arm.upper - arm.lower) for arm in (master, slave))
        base = forward(master, q)
        cup = behind(base, forward(slave, s)).position
        near = np.allclose(base.position, machine.frame3(q), rtol=0.0, atol=1e-6)
        if near and np.allclose(cup, machine.tips(q, np.tile(s, (machine.arms, 1)))[0], rtol=0.0, atol=1e-6):
            return
    fault = "master or slave is no arm of eqs (2) and (4)"
    raise InputError(f"{path}: {fault}; only d1, a2, a3, a4, limits and speeds may differ")


def refuse_touching_arms(machine: Machine) -> None:
    """Raise an error if a swinging slave can come too near a neighbouring slave at rest.

    An arm at rest points straight ahead and has its shortest length d6. If the neighbour swings towards it by t rad,
    the resting cup is spacing*cos(t) - d6*sin(t) away from the neighbour's centre line.

    Raises:
        InputError: If that distance can be less than two radii of the arms plus the margin (`Body`).
    """
    swing = float(max(-machine.slave.lower[1], machine.slave.upper[1]))
    distance = machine.spacing * np.cos(swing) - machine.slave_home[2] * np.sin(swing)
    if machine.arms > 1 and distance < machine.body.clearance:
        least = (machine.body.clearance + machine.slave_home[2] * np.sin(swing)) / np.cos(swing)
        raise InputError(
            f"slave arms {machine.spacing * 1e3:g} mm apart meet at rest: a swinging neighbour comes within "
            f"{max(distance, 0.0) * 1e3:.0f} mm and {machine.body.clearance * 1e3:.0f} mm are needed; "
            f"give a spacing of at least {np.ceil(least * 1e3):g} mm"
        )


def shifted(slave: Geometry, offset: float) -> Geometry:
    """Return the geometry of a slave mounted ``offset`` m farther to the right, as seen along the master's heading.

    Its a3 is larger by this offset.
    """
    return replace(slave, a=np.concatenate([slave.a[:1] + offset, slave.a[1:]]))


def _wrapped(angle: Array) -> Array:
    """Return angles wrapped to [-pi, pi)."""
    return np.asarray((angle + np.pi) % (2 * np.pi) - np.pi)


def travel_time(distance: ArrayLike, speed: ArrayLike, acceleration: ArrayLike) -> Array:
    """Return the time of a move from rest to rest, s: 2 sqrt(s/a) if the largest speed is not reached, else s/v + v/a.

    Args:
        distance: Lengths s of the moves, m or rad; the sign does not matter. Shapes broadcast.
        speed: Largest speeds v, m/s or rad/s.
        acceleration: Largest accelerations a, m/s² or rad/s².
    """
    s, v, a = (np.asarray(value, dtype=float) for value in (np.abs(distance), speed, acceleration))
    return np.asarray(np.where(s * a < v * v, 2 * np.sqrt(s / a), s / v + v / a))


def profile(time: ArrayLike, distance: ArrayLike, speed: ArrayLike, acceleration: ArrayLike) -> Array:
    """Return the displacement after a time in a move from rest to rest with a trapezoidal speed profile.

    Args:
        time: Time since the start of the move, s; before the start and after the end the arm stands still. Shapes
            broadcast.
        distance: Displacement at the end, m or rad; the result has the same sign.
        speed: Largest speed, m/s or rad/s.
        acceleration: Largest acceleration, m/s² or rad/s².
    """
    t, s, v, a = np.broadcast_arrays(*(np.asarray(x, dtype=float) for x in (time, distance, speed, acceleration)))
    sign, s = np.sign(s), np.abs(s)
    peak = np.minimum(v, np.sqrt(s * a))  # speed reached
    ramp = peak / a
    total = np.where(s > 0, s / np.maximum(peak, 1e-12) + ramp, 0.0)
    t = np.clip(t, 0.0, total)
    up = a * np.minimum(t, ramp) ** 2 / 2
    flat = peak * np.clip(t - ramp, 0.0, np.maximum(total - 2 * ramp, 0.0))
    late = np.clip(t - (total - ramp), 0.0, ramp)
    return np.asarray(sign * np.minimum(up + flat + peak * late - a * late**2 / 2, s))


def master_time(machine: Machine, start: ArrayLike, end: ArrayLike) -> Array:
    """Return the time of a move of the master, s, (...), from the common start until the slowest joint arrives.

    Args:
        machine: The machine.
        start: Joints at the start, (..., 3).
        end: Joints at the end, (..., 3).
    """
    distance = np.asarray(end, dtype=float) - np.asarray(start, dtype=float)
    return np.asarray(travel_time(distance, machine.master.speed, machine.master_acceleration).max(axis=-1))


def dense_workspace() -> tuple[tuple[float, ...], ...]:
    """Return the ranges of x, y and z, base frame, m, where points that cups reach lie densely (Li 2016, Fig. 8)."""
    return astuple(read_toml(WorkspaceTable, SHIPPED, section="workspace"))
