"""From a wanted nominal pose to corrected joints: Qiao 2026 eqs (13)-(16) and Fig. 3 through the rank-aware inverse.

q_command = q + J+ (F_nominal(q) - F_identified(q) - residual(q)), repeated once or twice at the corrected joints, J+
truncated to the task's rank (the paper's J^-1 does not exist for this arm), joint limits kept.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from pickenv.arm import Geometry, displace_pose, forward, joint_jacobian, pose_error
from pickenv.arm.geometry import Array, Pose
from pickenv.arm.task import truncated_inverse


class ResidualModel(Protocol):
    """What a learnt residual must offer."""

    def predict(self, joints: ArrayLike) -> Array:
        """Pose residual ``(..., 6)`` (m, rad, world axes) at joints ``(..., n)``."""
        ...


@dataclass(frozen=True, eq=False)
class Compensator:
    """Maps joint targets, meant for the nominal arm, to joint commands for the real one.

    Attributes:
        nominal: What the controller believes.
        identified: The calibrated geometry.
        residual: Learnt residual, or None.
        iterations: Corrections applied, each from the joints of the one before.
    """

    nominal: Geometry
    identified: Geometry
    residual: ResidualModel | None = None
    iterations: int = 2

    def __call__(self, joints: ArrayLike) -> Array:
        """Joint commands ``(..., n)`` for joint targets ``(..., n)``, rad or m, within the joint limits."""
        joints = np.asarray(joints, dtype=float)
        wanted = forward(self.nominal, joints)
        command = joints
        for _ in range(self.iterations):
            error = pose_error(self.predict(command), wanted)
            back = truncated_inverse(joint_jacobian(self.identified, command))
            correction = np.einsum("...ij,...j->...i", back, error)
            command = (command + correction).clip(self.nominal.lower, self.nominal.upper)
        return np.asarray(command)

    def predict(self, joints: ArrayLike) -> Pose:
        """Where the real tool is expected at joint commands ``(..., n)``: identified pose plus residual."""
        pose = forward(self.identified, joints)
        return pose if self.residual is None else displace_pose(pose, self.residual.predict(joints))
