"""A measuring campaign on the simulated arm, in time: warm up, drive from pose to pose, wait, read.

The arm stops where friction and gaps let it, by the way that it came, while its links warm up and the ground gives
way. ISO 9283 and calibration data come from the same stops. One arm runs on floats, many on arrays or tensors. SI.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Annotated, NamedTuple

import numpy as np

from pickenv.arm.effects.measurement_noise import MeasurementNoise, read_frame
from pickenv.arm.kinematics.forward import Frame, pose_of, split_joints
from pickenv.arm.kinematics.geometry import Array, Pose
from pickenv.arm.plant.dynamics import PlantState
from pickenv.arm.plant.motion import Pace, Place, in_components, stopped
from pickenv.arm.plant.plant import Plant, Ready
from pickenv.toml_tables import HOURS, MILLISECONDS, MM, SECONDS, file_named, read, shipped_in, toml_table

INSTRUMENTS = Path(__file__).parent / "instruments"

TRACKER = "laser_tracker"
"""The instrument of calibrations that name none."""


@toml_table
class Instrument:
    """What measures the arm, and how.

    Attributes:
        name: Its name.
        stand: Where it stands, in the arm's world, m.
        source: Where the numbers come from.
        dwell: Waiting time between arrival and reading, s; None where it waits until nothing changes any more: the
            arm is then warm, the ground at rest, and friction and gaps in their middle.
        warm_up: Time on before the first pose, s, in the middle of the joints' ranges.
        period: Control period of the drives from pose to pose, s, at full speed.
        noise: How it errs; None for the errors that the plant states of the instrument beside it.
    """

    name: str
    stand: Annotated[tuple[float, float, float], MM]
    source: str = ""
    dwell: Annotated[float, SECONDS.not_negative] | None = None
    warm_up: Annotated[float, HOURS.not_negative] = 0.0
    period: Annotated[float, MILLISECONDS.positive] = Pace.period
    noise: MeasurementNoise | None = None

    def noise_on(self, plant: Plant) -> MeasurementNoise | None:
        """How it errs at this plant: by its own numbers, else by those that the plant states."""
        return plant.measurement_noise if self.noise is None else self.noise


class NormalDraws(NamedTuple):
    """Standard normal numbers that decide what a campaign of P poses meets; axes of further arms follow.

    Attributes:
        reading: For each reading ``(P, 6)``.
        mounting: For the one mounting of the target ``(3,)``.
        stops: For the friction of each stop: forward and backward of each joint ``(P, 2, n)``; zeros where it does
            not scatter.
    """

    reading: Array
    mounting: Array
    stops: Array

    def first(self, poses: int) -> NormalDraws:
        """Those of the first poses."""
        return NormalDraws(self.reading[:poses], self.mounting, self.stops[:poses])


def shipped_instruments() -> list[str]:
    """Names of the instruments that come with pickenv."""
    return shipped_in(INSTRUMENTS)


def load_instrument(name: str | Path) -> Instrument:
    """Read an instrument by name or from a path to a TOML file.

    Raises:
        InputError: If it is unknown or a number is impossible; the message names the file and the key.
    """
    return read(Instrument, file_named("instrument", name, INSTRUMENTS))


def normal_draws(plant: Plant, poses: int, rng: np.random.Generator) -> NormalDraws:
    """Draw for one campaign; readings come from ``rng``, what the arm and its target do from a child of it."""
    (child,) = rng.spawn(1)
    band, shape = plant.stick_band, (poses, 2, plant.geometry.joints)
    scatters = band is not None and band.scatter
    return NormalDraws(
        reading=rng.normal(size=(poses, 6)),
        mounting=child.normal(size=3),
        stops=child.normal(size=shape) if scatters else np.broadcast_to(0.0, shape),
    )


def switched_on(plant: Plant, m: ModuleType, joints: Array, warm_up: float, place: Place | None = None) -> PlantState:
    """The state of an arm that has stood at the command ``joints`` ``(..., n)`` for ``warm_up`` seconds."""
    q = in_components(m, joints, place)
    return plant.carried(m, plant.initial_state(m, q), q, warm_up)


def visited(
    plant: Plant, m: ModuleType, joints: Array, instrument: Instrument, stops: Array, place: Place | None = None
) -> Frame:
    """True tool frames when an instrument reads them, one pose after another.

    Args:
        plant: One arm, or many.
        m: ``numpy`` for one arm; ``numpy`` or ``torch`` for many.
        joints: Joint commands ``(P, n)`` of one arm, ``(P, N, n)`` of many, in the order in which they are visited.
        instrument: How long is waited.
        stops: As `NormalDraws` has them.
        place: Makes components of arrays where ``m`` wants others.

    Returns:
        Components ``(P,)`` or ``(P, N)``.
    """
    if instrument.dwell is None or not plant.has_state or not len(joints):
        return plant.tool_frame(m, in_components(m, joints, place))
    alone = joints.ndim == 2
    one = math if alone else m
    plant = replace(plant, ready=Ready(plant.geometry, plant.chain))  # each stop has its friction, and the same chain
    here = np.broadcast_to((plant.arm.nominal.lower + plant.arm.nominal.upper) / 2.0, joints.shape[1:])
    state = switched_on(plant, one, here, instrument.warm_up, place)
    pace, frames = Pace(period=instrument.period, dwell=instrument.dwell), []
    for target, normal in zip(joints, stops, strict=True):
        state, frame = stopped(plant, one, state, here, target, pace, normal, place)
        here = target
        frames.append(frame)
    if alone:
        return tuple(np.array(column) for column in zip(*frames, strict=True))
    zero = in_components(m, here, place)[0] * 0.0  # of many arms a component may be the same number for all
    return tuple(m.stack([value + zero for value in column]) for column in zip(*frames, strict=True))


def measured_poses(plant: Plant, joints: Array, instrument: Instrument, draws: NormalDraws) -> Pose:
    """The poses of one arm as an instrument reports them, at joint commands ``(P, n)`` in their order."""
    frame = visited(plant, np, joints, instrument, draws.stops)
    noise = instrument.noise_on(plant)
    if noise is None:
        return pose_of(frame)
    reading = split_joints(6, draws.reading)
    return pose_of(read_frame(np, noise, instrument.stand, frame, reading, draws.mounting.tolist()))
