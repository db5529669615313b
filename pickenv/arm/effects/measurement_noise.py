"""How an instrument that looks at a target on the tool errs: reading by reading, with the range, and by its mounting.

Every number is used as a standard deviation, makers' limits too. Runs on floats, arrays and tensors. Units: m, rad.
"""

from __future__ import annotations

from collections.abc import Sequence
from types import ModuleType
from typing import Annotated, Any

from pickenv.arm.kinematics.forward import Frame, Scalar
from pickenv.arm.kinematics.pose_error import displaced_frame
from pickenv.toml_tables import DEG, MM, Unit, toml_table


@toml_table
class MeasurementNoise:
    """Normal errors of a measuring instrument, per axis.

    Attributes:
        position_std: Of a position at zero range, m.
        attitude_std: Of an attitude, rad.
        range_std: What each metre of range adds to a position's, m/m.
        centring_std: How far the target's centre lies beside the point that is meant, m; it stays as long as the
            target is mounted.
    """

    position_std: Annotated[float, MM.not_negative]
    attitude_std: Annotated[float, DEG.not_negative]
    range_std: Annotated[float, Unit("um_per_m", 1e-6, most=1e6).not_negative] = 0.0
    centring_std: Annotated[float, MM.not_negative] = 0.0

    def position_std_at(self, distance: Any) -> Any:
        """Of a position seen from ``distance`` metres, m."""
        return self.position_std + self.range_std * distance


def distance_between(m: ModuleType, point: Sequence[Scalar], other: Sequence[Scalar]) -> Scalar:
    """Distance of two points, m."""
    x, y, z = (a - b for a, b in zip(point, other, strict=True))
    return m.sqrt(x * x + y * y + z * z)


def read_frame(
    m: ModuleType,
    noise: MeasurementNoise,
    stand: tuple[float, float, float],
    frame: Frame,
    reading: Sequence[Scalar],
    mounting: Sequence[Scalar],
) -> Frame:
    """The tool frame that an instrument reports.

    Args:
        m: ``math``, ``numpy`` or ``torch``.
        noise: How it errs.
        stand: Where it stands, in the frame's world, m.
        frame: The true tool frame.
        reading: Six standard normal numbers for each reading.
        mounting: Three for the mounting of the target.
    """
    if noise.centring_std:
        aside = [noise.centring_std * value for value in mounting]
        axes = zip(frame[0:3], frame[3:6], frame[6:9], frame[9:], strict=True)
        seen = (aside[0] * x + aside[1] * y + aside[2] * z + p for x, y, z, p in axes)
        frame = (*frame[:9], *seen)
    std: Any = noise.position_std
    if noise.range_std:
        std = noise.position_std_at(distance_between(m, frame[9:], stand))
    scales = (std,) * 3 + (noise.attitude_std,) * 3
    return displaced_frame(m, frame, [scale * value for scale, value in zip(scales, reading, strict=True)])
