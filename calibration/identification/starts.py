"""Where the identification of a data set of any kind starts: what of an arm is fitted, and base and tool from anywhere.

Poses and positions have closed forms; boards' poses in pictures and the reflector seen most often are poses and
positions of their own; wires and contacts start where the arm is said to stand. SI units.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from pickenv.arm import Arm, Geometry, Pose
from pickenv.calibration.identification.alignment import align, refuse_another_arm
from pickenv.calibration.identification.board_poses import board_poses
from pickenv.calibration.identification.robust import robust_align, robust_identify
from pickenv.calibration.model.arm_model import ArmModel
from pickenv.calibration.model.error_model import ErrorModel, frames_model, geometric_model
from pickenv.calibration.model.finished_poses import CARRIER
from pickenv.calibration.model.kinds.reflectors import ReflectorObservations
from pickenv.calibration.model.measurements import Measurements
from pickenv.calibration.model.observations import Observations, nearest_rotation
from pickenv.calibration.model.pixels import PixelObservations
from pickenv.calibration.model.stacked import InstrumentStation, Stacked


def fitted_model(arm: str, nominal: Geometry, known_frames: bool) -> ErrorModel:
    """What of an arm is identified: all of it, base and tool among it unless known; of finished poses these alone."""
    return frames_model(nominal) if arm == CARRIER else geometric_model(nominal, known_frames)


def rough_start(nominal: Geometry, data: Observations) -> Geometry:
    """Base and tool near those of the data: boards' poses give all, the reflector seen most often the base.

    Raises:
        InputError: If the reflector's positions do not fit the arm.
    """
    if isinstance(data, Stacked):
        return rough_start(nominal, data.parts[0])
    if isinstance(data, Measurements):
        return align(nominal, data, frames_model(nominal), judge=False).geometry
    if isinstance(data, PixelObservations):
        seen = board_poses(data)
        if data.mount == "hand":
            back = np.swapaxes(seen.rotation, 1, 2)
            seen = Pose(-(back @ seen.position[..., None])[..., 0], back)
        rough = Measurements(data.joints, seen.position, seen.rotation, nominal.prismatic, source=data.source)
        return align(nominal, rough, frames_model(nominal), judge=False).geometry
    if not isinstance(data, ReflectorObservations):
        return nominal
    which = int(np.argmax(data.seen.sum(axis=0)))
    rows = data.seen[:, which]
    one = Measurements(data.joints[rows], data.points[rows, which], None, nominal.prismatic, source=data.source)
    aligned = align(nominal, one, frames_model(nominal), judge=False).geometry
    refuse_another_arm(aligned, one, f"after fitting base and reflector {which + 1}", nominal)
    if data.places is None or len(data.places) < 3:
        return aligned
    local = data.seen_from(ArmModel.of(aligned))  # known places turn and shift the tool to where they are seen
    middle, centre = data.places.mean(axis=0), local.mean(axis=0)
    turn = nearest_rotation((local - centre).T @ (data.places - middle))
    tool, shift = aligned.tool, centre - turn @ middle
    return replace(aligned, tool=Pose(tool.position + tool.rotation @ shift, tool.rotation @ turn))


def robust_frames(arm: Arm, data: Observations) -> Geometry:
    """Base and tool from the rows that agree with each other; the same every time.

    Raises:
        InputError: If there are too few rows, or they do not fit the arm.
    """
    frames = frames_model(arm.nominal)
    if isinstance(data, Measurements):
        return robust_align(arm.nominal, data, frames, np.random.default_rng(0)).geometry
    return robust_identify(frames, rough_start(arm.nominal, data), data).geometry


def stations_of(arm: Arm, data: Sequence[Observations], own: Collection[str]) -> Stacked:
    """Data sets as stations of one arm, those with an instrument's frame first.

    Args:
        arm: The arm.
        data: The data sets.
        own: Which of "base" and "tool" each but the first has of its own; a set without a frame sees no base.

    Raises:
        InputError: If a set does not fit the arm.
    """
    first, *others = sorted(data, key=lambda part: not part.framed)
    stations = [InstrumentStation(first)]
    for number, part in enumerate(others, start=2):
        start = robust_frames(arm, part) if part.framed else arm.nominal
        base = start.base if "base" in own and part.framed else None
        stations.append(InstrumentStation(part, number, base, start.tool if "tool" in own else None))
    return Stacked(tuple(stations))
