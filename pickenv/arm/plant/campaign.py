"""Simulation of a measuring campaign over time: the arm warms up, moves from pose to pose, waits and is measured.

The position in which the arm stops depends on friction and backlash, and thus on its path. Meanwhile its links warm up
and the ground settles. The ISO 9283 test and calibration data use the same simulation. A single arm is computed with
floats, many arms with arrays or tensors. SI units.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from types import ModuleType
from typing import Annotated, Any, NamedTuple, TypeAlias, cast

import numpy as np
from numpy.typing import ArrayLike

from pickenv.arm.effects.drives import MeasurementNoise, read_frame
from pickenv.arm.effects.effect import BESIDE
from pickenv.arm.effects.structure import one_stop
from pickenv.arm.kinematics.forward import Frame, Scalar, forward, pose_of, split_joints
from pickenv.arm.kinematics.geometry import Array, Pose
from pickenv.arm.plant.plant import Plant, PlantState
from pickenv.base import HOURS, MILLISECONDS, MM, SECONDS, file_named, read_toml, toml_table

# Point-to-point motion of the true arm: joint commands in steps of a control period, no joint above its speed. All
# joints of a move start and arrive together; the arm then waits. The command is a staircase of held values, as a
# controller gives it. Runs on floats (one arm), arrays and tensors (many moves side by side). Units: s, rad or m.


Place: TypeAlias = Callable[[Array], Scalar]
"""A function that converts an array to another type, for example to a tensor on a GPU."""


@dataclass(frozen=True)
class Pace:
    """Settings of the arm's point-to-point motion.

    Attributes:
        speed: Speed as a share of the joints' largest speeds, above 0.
        period: Control period, s.
        dwell: Waiting time between arrival and measurement, s.

    Raises:
        ValueError: If a number is out of range.
    """

    speed: float = 1.0
    period: float = 0.05
    dwell: float = 0.5

    def __post_init__(self) -> None:
        if not (0 < self.speed < math.inf and 0 < self.period < math.inf and 0 <= self.dwell < math.inf):
            raise ValueError(f"{self} is impossible; speed and period must be above zero, and dwell not below it")


def move_time(plant: Plant, start: ArrayLike, target: ArrayLike, pace: Pace) -> Array:
    """Return the duration ``(...)``, s, of moves between joints ``(..., n)``, which the slowest joint determines.

    Args:
        plant: The arm, which has the largest joint speeds.
        start: Joints at the start ``(..., n)``, rad or m.
        target: Joints at the end ``(..., n)``, rad or m.
        pace: Settings of the motion; only ``speed``, the share of the largest speeds, is used.
    """
    way = np.abs(np.asarray(target, dtype=float) - np.asarray(start, dtype=float))
    return np.asarray(np.max(way / (plant.arm.speed * pace.speed), axis=-1))


def commands(plant: Plant, start: ArrayLike, target: ArrayLike, pace: Pace) -> Iterator[tuple[Array, Array | float]]:
    """Yield the joint commands ``(..., n)`` of moves, each with its hold time, s.

    The last command is held for the waiting time. Several moves begin together, and each takes its own time. A move
    that ends early repeats its target with hold times of zero until the longest move ends. It thus has the same result
    as if it were computed alone.

    Args:
        plant: The arm, which has the largest joint speeds.
        start: Joints at the start ``(..., n)``, rad or m.
        target: Joints at the end ``(..., n)``, rad or m.
        pace: Speed, control period and waiting time.
    """
    start, target = np.asarray(start, dtype=float), np.asarray(target, dtype=float)
    duration = move_time(plant, start, target, pace)
    steps = np.ceil(duration / pace.period - 1e-9)
    for step in range(1, int(steps.max(initial=0.0)) + 1):
        share = np.clip((steps - step) * pace.period / np.maximum(duration, pace.period), 0.0, 1.0)  # still to go
        time = np.where(step <= steps, pace.period, 0.0)
        yield target + (start - target) * share[..., None], time if time.ndim else pace.period
    if pace.dwell or not steps.any():
        yield np.broadcast_to(target, np.broadcast_shapes(start.shape, target.shape)), pace.dwell


def in_components(m: ModuleType, joints: Array, place: Place | None = None) -> list[Scalar]:
    """Return joints ``(..., n)`` as n components ``(...)``.

    Args:
        m: ``math`` for floats; otherwise the components are arrays.
        joints: Joints ``(..., n)``, rad or m; ``(n,)`` for ``math``.
        place: Function that converts each component to another type, for example to a tensor; None for arrays.
    """
    if m is math:
        return list(joints.tolist())
    return [column if place is None else place(column) for column in np.ascontiguousarray(np.moveaxis(joints, -1, 0))]


def moved(
    plant: Plant,
    m: ModuleType,
    state: PlantState,
    start: ArrayLike,
    target: ArrayLike,
    pace: Pace,
    place: Place | None = None,
    normal: Array | None = None,
) -> tuple[PlantState, Frame]:
    """Simulate a move from ``start`` to ``target`` and a wait; return the new state and the true tool frame.

    Args:
        plant: The simulated true arm, or a batch of arms.
        m: The namespace of the functions: ``math`` for one arm, ``numpy`` or ``torch`` for many.
        state: The plant's state at ``start``.
        start: Joints at the start ``(..., n)``, rad or m.
        target: Joints at the end ``(..., n)``, rad or m.
        pace: Speed, control period and waiting time.
        place: Function that converts arrays to the type of ``m``, such as tensors; None for arrays and floats.
        normal: Standard normal numbers that scatter the friction of this stop ``(2, n, ...)``: for forward motion of
            the n joints, then for backward motion. None for the mean friction, with which an arm repeats exactly.
    """
    band = plant.effect("stick_band")
    if normal is not None and band is not None and band.scatter:
        rows = [in_components(m, np.moveaxis(row, 0, -1), place) for row in normal]
        plant = plant.with_effect(one_stop(m, band, rows))
    *before, last = (
        (in_components(m, command, place), time if place is None or isinstance(time, float) else place(time))
        for command, time in commands(plant, start, target, pace)
    )
    for q, time in before:
        state = plant.carried(m, state, q, time)
    return plant.advance(m, state, *last)


INSTRUMENTS = Path(__file__).parent / "instruments"

TRACKER = "laser_tracker"
"""Name of the instrument that calibrations use by default."""


@toml_table
class Instrument:
    """An instrument that measures the arm.

    Attributes:
        name: Name of the instrument.
        stand: Position of the instrument in the arm's world frame, m.
        source: Source of the numbers.
        dwell: Waiting time between arrival and reading, s. None to read settled poses (`Plant.tool_frame`) instead of
            simulating moves: the arm is warm, the ground at rest, friction and backlash in the middle of their bands.
        warm_up: Time for which the arm rests in the middle of the joints' ranges before the first move, s.
        period: Control period of the moves from pose to pose, s. Moves are at full speed.
        noise: The instrument's errors. None for the errors in the effect "measurement_noise" of the plant (the
            simulated true arm).
    """

    name: str
    stand: Annotated[tuple[float, float, float], MM]
    source: str = ""
    dwell: Annotated[float, SECONDS.not_negative] | None = None
    warm_up: Annotated[float, HOURS.not_negative] = 0.0
    period: Annotated[float, MILLISECONDS.positive] = Pace.period
    noise: MeasurementNoise | None = None

    def noise_on(self, plant: Plant) -> MeasurementNoise | None:
        """Return the instrument's ``noise``, or else the plant's effect "measurement_noise"; None without either."""
        return self.noise or cast(MeasurementNoise | None, plant.effect("measurement_noise"))


class NormalDraws(NamedTuple):
    """Standard normal numbers from which the random errors of a campaign of P poses are computed.

    For a batch of arms, each array has further axes at its end.

    Attributes:
        reading: Numbers for the noise of each reading ``(P, 6)``: three of position, three of attitude.
        mounting: Numbers for the centring error of the target, which is mounted once ``(3,)``.
        stops: Numbers for the friction of each stop ``(P, 2, n)``: for forward motion of the n joints, then for
            backward motion. Zeros if the friction does not scatter.
    """

    reading: Array
    mounting: Array
    stops: Array

    def first(self, poses: int) -> NormalDraws:
        """Return the draws for the first ``poses`` poses; the numbers for the target's mounting stay the same."""
        return NormalDraws(self.reading[:poses], self.mounting, self.stops[:poses])


def load_instrument(name: str | Path) -> Instrument:
    """Read an instrument by its name ("laser_tracker", "ideal"), or from a TOML file by its path.

    Raises:
        InputError: If the instrument is unknown or a number is outside its limits; the message names file and key.
    """
    return read_toml(Instrument, file_named("instrument", name, INSTRUMENTS))


def normal_draws(plant: Plant, poses: int, rng: np.random.Generator) -> NormalDraws:
    """Draw the random numbers of one campaign of a single arm.

    Args:
        plant: The simulated true arm.
        poses: Number of poses P.
        rng: Random generator of the numbers for readings. A child spawned from it gives the numbers for mounting and
            stops.
    """
    (child,) = rng.spawn(1)
    band, shape = plant.effect("stick_band"), (poses, 2, plant.geometry.joints)
    scatters = band is not None and band.scatter
    reading, mounting = rng.normal(size=(poses, 6)), child.normal(size=3)
    return NormalDraws(reading, mounting, child.normal(size=shape) if scatters else np.broadcast_to(0.0, shape))


def switched_on(plant: Plant, m: ModuleType, joints: Array, warm_up: float, place: Place | None = None) -> PlantState:
    """Return the state of an arm that was switched on and then held a command.

    Args:
        plant: The simulated true arm, or a batch of arms.
        m: The namespace of the functions: ``math``, ``numpy`` or ``torch``.
        joints: The command ``(..., n)``, rad or m.
        warm_up: Time for which the command is held, s.
        place: Function that converts arrays to the type of ``m``, such as tensors; None for arrays and floats.
    """
    q = in_components(m, joints, place)
    return plant.carried(m, plant.initial_state(m, q), q, warm_up)


def visited(
    plant: Plant, m: ModuleType, joints: Array, instrument: Instrument, stops: Array, place: Place | None = None
) -> Frame:
    """Simulate the moves of a campaign and return the true tool frame at each reading, without measurement noise.

    Args:
        plant: The simulated true arm, or a batch of N arms.
        m: The namespace of the functions: ``numpy`` for one arm; ``numpy`` or ``torch`` for many.
        joints: Joint commands ``(P, n)`` of one arm, ``(P, N, n)`` of many, rad or m, in the order of the poses.
        instrument: The instrument, which has the warm-up and waiting times.
        stops: Standard normal numbers for the friction of each stop, in the form of `NormalDraws.stops`.
        place: Function that converts arrays to the type of ``m``, such as tensors; None for arrays.

    Returns:
        A frame whose components have the shape ``(P,)`` or ``(P, N)``.
    """
    if instrument.dwell is None or not plant.has_state or not len(joints):
        return plant.tool_frame(m, in_components(m, joints, place))
    single = joints.ndim == 2
    space = math if single else m
    plant = replace(plant, ready=(plant.geometry, plant.chain))  # each stop has its friction, and the same chain
    start = np.broadcast_to((plant.arm.nominal.lower + plant.arm.nominal.upper) / 2.0, joints.shape[1:])
    state = switched_on(plant, space, start, instrument.warm_up, place)
    pace, frames = Pace(period=instrument.period, dwell=instrument.dwell), []
    for target, normal in zip(joints, stops, strict=True):
        state, frame = moved(plant, space, state, start, target, pace, place, normal)
        start = target
        frames.append(frame)
    if single:
        return tuple(np.array(column) for column in zip(*frames, strict=True))
    zero = in_components(m, start, place)[0] * 0.0  # of many arms a component may be the same number for all
    return tuple(m.stack([value + zero for value in column]) for column in zip(*frames, strict=True))


def measured_poses(plant: Plant, joints: Array, instrument: Instrument, draws: NormalDraws) -> Pose:
    """Simulate a campaign on one arm and return the tool poses ``(P,)`` that the instrument reports, in world axes.

    Args:
        plant: The simulated true arm.
        joints: Joint commands ``(P, n)``, rad or m, in the order of the poses.
        instrument: The instrument.
        draws: Random numbers of the campaign, from `normal_draws`.
    """
    frame = visited(plant, np, joints, instrument, draws.stops)
    if (noise := instrument.noise_on(plant)) is None:
        return pose_of(frame)
    reading = split_joints(6, draws.reading)
    return pose_of(read_frame(np, noise, instrument.stand, frame, reading, draws.mounting.tolist()))


# Which effect costs how many millimetres at the tip: one at a time, all but one, and all together. Every figure is
# the distance between two tool positions at the same joint command: after a reach at full speed and a short wait, on
# a machine that has been running for some time.


GEOMETRY = "geometry"


def causes_of(plant: Plant) -> tuple[str, ...]:
    """Return the names of the causes of a true arm's error: "geometry", and all effects that move the arm."""
    return (GEOMETRY, *(name for name in plant.names if plant.effect(name).place < BESIDE))


def alone(plant: Plant, *names: str) -> Plant:
    """Return the plant (the true arm with its errors) with only some causes of its error switched on.

    ``names`` names these causes, as `causes_of` does. Without "geometry", the true geometry is the nominal one.
    """
    geometry = plant.geometry if GEOMETRY in names else plant.arm.nominal
    return replace(plant, geometry=geometry, effects=tuple(effect for effect in plant.effects if effect.name in names))


def effect_shares(
    plant: Plant, joints: ArrayLike, *, running_time: float = 7200.0, pace: Pace | None = None
) -> dict[str, Any]:
    """Compute how much each cause (the true geometry, and each effect) contributes to the tool's position error.

    Args:
        plant: The simulated true arm, a single one.
        joints: Joint commands ``(P, n)`` to reach, rad or m. The arm moves to each from the previous command, and to
            the first from the last.
        running_time: Time since the machine was switched on, s.
        pace: Speed, control period and waiting time; by default full speed and 0.5 s of waiting.

    Returns:
        A mapping for JSON. ``plant``, ``reaches``, ``running_hours`` and ``dwell`` (s) describe the run, and ``unit``
        is "mm". ``alone``: for each cause, the error with only this cause on. ``without``: for each cause, the error
        with all other causes on. ``all``: the error with all causes on. ``sum_of_means``: the sum of the means in
        ``alone``, which is the worst case (all errors in one direction). ``root_sum_square``: the root of the sum of
        the squares of these means, for random directions. Each error is a mapping of statistics of the distance between
        the tool's true and nominal position over all commands: ``mean``, the 95th percentile ``p95``, and ``max``.
        Another entry, ``varying``, is the mean distance after each axis's mean error is subtracted.

    Raises:
        ValueError: If there are fewer than two commands.
    """
    pace = pace or Pace()
    joints = np.asarray(joints, dtype=float)
    if joints.ndim != 2 or len(joints) < 2:
        raise ValueError(f"joints have shape {joints.shape}; give at least two rows of joint commands")
    causes, nominal = causes_of(plant), forward(plant.arm.nominal, joints).position
    start = np.roll(joints, 1, axis=0)

    def share(*names: str) -> dict[str, float]:
        """Return statistics of the distance between true and nominal tool, mm, with only these causes on."""
        some = alone(plant, *names)
        _, frame = moved(some, np, switched_on(some, np, start, running_time), start, joints, pace)
        error = np.stack(np.broadcast_arrays(*frame[9:]), -1) - nominal
        millimetres, varying = (1e3 * np.linalg.norm(part, axis=-1) for part in (error, error - error.mean(axis=0)))
        p95 = np.quantile(millimetres, 0.95)
        numbers = {"mean": millimetres.mean(), "p95": p95, "max": millimetres.max(), "varying": varying.mean()}
        return {name: float(number) for name, number in numbers.items()}

    shares = {name: share(name) for name in causes}
    means = [single["mean"] for single in shares.values()]
    run = {"plant": plant.name, "reaches": len(joints), "running_hours": running_time / 3600.0, "dwell": pace.dwell}
    return {
        **{"unit": "mm", **run, "alone": shares},
        "without": {name: share(*(cause for cause in causes if cause != name)) for name in causes},
        "all": share(*causes),
        "sum_of_means": float(np.sum(means)),
        "root_sum_square": float(np.sqrt(np.sum(np.square(means)))),
    }


def shares_report(shares: dict[str, Any]) -> str:
    """Return the result of `effect_shares` as a text table."""

    def row(name: str, share: dict[str, float], left: float) -> str:
        figures = f"{share['mean']:13.3f}{share['varying']:10.3f}{share['p95']:9.3f}{share['max']:9.3f}"
        return f"{name.replace('_', ' '):<20}{figures}{left:17.3f}"

    largest = max(shares["alone"], key=lambda name: float(shares["alone"][name]["mean"]))
    lines = [
        f"{shares['plant']} ends {shares['all']['mean']:.2f} mm from where it is sent; {largest.replace('_', ' ')} "
        f"alone would make {shares['alone'][largest]['mean']:.2f} mm",
        f"Tip error in mm: {shares['reaches']} reaches, {shares['dwell']:g} s after arrival, "
        f"{shares['running_hours']:g} h after start",
        f"{'effect':<20}{'alone: mean':>13}{'varying':>10}{'p95':>9}{'max':>9}{'without: mean':>17}",
        *(row(name, share, shares["without"][name]["mean"]) for name, share in shares["alone"].items()),
        row("all", shares["all"], 0.0),
        "alone: the only effect that is on; without: what all the others leave",
        f"sum of the means {shares['sum_of_means']:.3f}, root of the sum of squares {shares['root_sum_square']:.3f}",
    ]
    return "\n".join(lines)
