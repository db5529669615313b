"""Where each link stands in the one before it with all joints at zero, as formats without DH parameters have it."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from pickenv.arm.kinematics.geometry import Geometry, Pose, behind, identity_pose


def link_origins(geometry: Geometry) -> list[Pose]:
    """Pose of each link in the link before it, its joint at zero; the base is part of the first.

    A joint then moves about, or along, its link's z: Rx(alpha) Tx(a) Ry(beta) Rz(theta) Tz(d) is all that is before it.
    """
    found, pending = [], geometry.base
    for i in range(geometry.links):
        twist = Rotation.from_euler("x", geometry.alpha[i])
        turn = twist * Rotation.from_euler("y", geometry.beta[i]) * Rotation.from_euler("z", geometry.theta[i])
        local = np.array([geometry.a[i], 0.0, 0.0]) + turn.as_matrix() @ np.array([0.0, 0.0, geometry.d[i]])
        found.append(behind(pending, Pose(local, turn.as_matrix())))
        pending = identity_pose()
    return found
