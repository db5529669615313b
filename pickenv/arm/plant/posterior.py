"""What a calibration knows of one arm, and how surely: numbers from which `pickenv.arm.plant.twin_arms` makes plants.

The arm's numbers are linear in standard normal ones, plus what was not identified: a parameter that the data cannot
tell from others may lie anywhere in its tolerance, as long as the others give way so that what was measured stays. SI
units.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pickenv.arm.effects.residual_field import ResidualField
from pickenv.arm.kinematics.geometry import Array, Geometry, Pose


@dataclass(frozen=True)
class Layout:
    """What each coefficient beside the geometry is, in order: leads, harmonics, moments, then the boom's two.

    Attributes:
        leads: The joint of each lead error, from 0.
        harmonics: Joint and order (1/rad, 1/m) of each periodic error, which has a sine and a cosine coefficient.
        moments: As `pickenv.arm.effects.drives.GravityYield` has them.
        up: Direction against gravity in the axes of frame 0.
        boom: Joint of a boom that bends and its free length in m, or None; tip load and own weight over EI.
    """

    leads: tuple[int, ...] = ()
    harmonics: tuple[tuple[int, float], ...] = ()
    moments: tuple[tuple[int, int, str], ...] = ()
    up: tuple[float, float, float] = (0.0, 0.0, 1.0)
    boom: tuple[int, float] | None = None

    @property
    def sizes(self) -> tuple[int, int, int, int]:
        """Number of coefficients of each kind."""
        return len(self.leads), 2 * len(self.harmonics), len(self.moments), 2 * (self.boom is not None)


@dataclass(frozen=True, eq=False)
class Posterior:
    """An arm as it was found; P = 5L + 12 + k parameters: the geometry's, then the coefficients.

    Attributes:
        identified: Geometry found, base and tool in the instrument's frame.
        aligned: Base and tool of the nominal arm in that frame.
        layout: What the coefficients are.
        coefficients: The coefficients found ``(k,)``.
        factor: Parameters per standard normal number ``(P, p)``.
        unseen: Places of the parameters that were not identified ``(d,)``.
        traces: Parameters per unit of each of them ``(P, d)``: itself, and what gives way.
        field: The residual's mean, or None.
        field_factor: Weights of each output's smooth waves, cosines then sines, per standard normal number
            ``(O, 2 K, 2 K)``.
        rough: Standard deviation of each output's rough waves together ``(O,)``, m and rad.
        notes: What was told apart and how, one sentence each.
    """

    identified: Geometry
    aligned: tuple[Pose, Pose]
    layout: Layout
    coefficients: Array
    factor: Array
    unseen: NDArray[np.int64]
    traces: Array
    field: ResidualField | None
    field_factor: Array
    rough: Array
    notes: tuple[str, ...] = ()
