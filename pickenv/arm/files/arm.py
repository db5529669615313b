"""An arm: what its controller believes of it, how fast it may move, and, where it is simulated, how it was built."""

from __future__ import annotations

from dataclasses import dataclass

from pickenv.arm.kinematics.geometry import Array, Geometry, geometry_fingerprint

MOST_RATIO = 1e3
"""No link moves further than this times the joint that it follows."""


@dataclass(frozen=True, eq=False)
class Arm:
    """A named arm.

    Attributes:
        name: As in its file.
        source: Where its numbers come from.
        nominal: The geometry that the controller believes in.
        true: The geometry as built, where the file gives one (simulated arms), else None.
        speed: Largest joint speeds, rad/s or m/s, shape (n,).
        tolerance_class: Name of the tolerance class that its parts are made to, where the file says one.
    """

    name: str
    source: str
    nominal: Geometry
    true: Geometry | None
    speed: Array
    tolerance_class: str | None = None

    def fingerprint(self) -> str:
        """Hash of the nominal geometry: a calibration fitted to one arm is refused on another."""
        return geometry_fingerprint(self.nominal)
