"""What a calibration with fitted base and tool leaves open: the error in the robot's own base frame.

An instrument that stood anywhere cannot tell a base that lies elsewhere from links that shift or turn everything alike.
The commands then put the tool where the *fitted* base and tool want it. How far that is from where the robot's own base
frame wants it depends on how far both lie from where the controller has them, which these data do not show; an interval
follows from an assumption that is printed with it. SI units.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from pickenv.arm import Geometry, forward, parameter_jacobian
from pickenv.arm.kinematics.geometry import Array
from pickenv.calibration.model.error_model import ANGLE_TOLERANCE, LENGTH_TOLERANCE, frames_model

DRAWS = 400
"""Bases and tools drawn."""

SCALES = (0.2, 1.0)
"""How far base and tool may lie from where the controller has them, one standard deviation per axis, in units of 1 mm
and 1 mrad: nobody knows it better, so every size between counts alike (on a logarithmic scale)."""

NEAR = 0.05
"""A fitted base and tool that move the tool by less than this, m, suggest an instrument registered to the base."""


@dataclass(frozen=True)
class BaseFrameError:
    """Mean position error in the robot's own base frame, over the poses judged.

    Attributes:
        low: Lower end of its 95 % interval, m; NaN where no position was measured.
        high: Upper end, m.
        moved: Mean distance, over the same poses, between the nominal tool with the fitted base and tool and with the
            controller's own, m. Small where the instrument was registered to the base; then it is the error itself.
        tracked: Whether the instrument states positions in its own frame, which may be the base's.
    """

    low: float
    high: float
    moved: float
    tracked: bool

    def as_dict(self) -> dict[str, Any]:
        """For JSON and a calibration's record."""
        return {
            "mean_ci95_mm": None if np.isnan(self.low) else [self.low * 1e3, self.high * 1e3],
            "assumed_std_mm": [scale * LENGTH_TOLERANCE * 1e3 for scale in SCALES],
            "assumed_std_mrad": [scale * ANGLE_TOLERANCE * 1e3 for scale in SCALES],
            "frames_moved_mm": self.moved * 1e3,
        }

    def sentences(self) -> str:
        """For people."""
        unseen = "base and tool were fitted, so the instrument cannot tell where the robot's base stands"
        if np.isnan(self.low):
            return f"{unseen}, nor where its tool is, for it sees directions and no positions"
        text = (
            f"{unseen}; in the robot's own base frame the mean error is {self.low * 1e3:#.3g} to "
            f"{self.high * 1e3:#.3g} mm (95 % interval, if base and tool lie {SCALES[0]:g} to {SCALES[1]:g} mm and "
            "mrad, one standard deviation per axis, from where the controller has them)"
        )
        if self.tracked and self.moved < NEAR:
            text += (
                f"; the fitted frames move the tool by {self.moved * 1e3:#.3g} mm: if the instrument is registered to "
                "the base and sees the controller's own tool, calibrate with --frames known"
            )
        return text


def base_frame_error(
    nominal: Geometry, fitted: Geometry, joints: ArrayLike, left: Array, tracked: bool = True
) -> BaseFrameError:
    """The interval of the mean error in the robot's own base frame; the same every time.

    Args:
        nominal: The arm as its controller has it.
        fitted: The same with the fitted base and tool.
        joints: Poses ``(N, n)``.
        left: What the calibration leaves at them in the instrument's frame ``(N, 3 or more)``, m.
        tracked: Whether the instrument states positions in its own frame.
    """
    joints = np.asarray(joints, dtype=float)
    model = frames_model(nominal)
    jacobian = parameter_jacobian(nominal, joints)[:, :3][..., model.columns]
    rng = np.random.default_rng(0)
    sizes = np.exp(rng.uniform(np.log(SCALES[0]), np.log(SCALES[1]), (DRAWS, 1)))
    draws = sizes * rng.normal(size=(DRAWS, len(model.columns))) * model.tolerance
    missed = np.einsum("nip,dp->dni", jacobian, draws) + left[:, :3]
    low, high = np.percentile(np.linalg.norm(missed, axis=2).mean(axis=1), [2.5, 97.5])
    moved = np.linalg.norm(forward(nominal, joints).position - forward(fitted, joints).position, axis=1).mean()
    return BaseFrameError(float(low), float(high), float(moved), tracked)
