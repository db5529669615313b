"""Arms whose joints yield under masses that are known: a truth for tests of compliance."""

from dataclasses import dataclass

import numpy as np

from pickenv.arm import Load, chain_of, frames, gravity_torques
from pickenv.calibration import ComplianceTerm


@dataclass(frozen=True)
class LoadedCompliance(ComplianceTerm):
    """Compliance under the weight of these masses."""

    load: Load | None = None

    def torques(self, geometry, joints, conditions):
        """Gravity's torques ``(N, n)``, with the recorded payload if there is one."""
        payload = self.load.payload if conditions.payload is None else conditions.payload
        chain = chain_of(geometry)
        load = Load(self.load.mass, self.load.centre, payload)
        parts = gravity_torques(chain, frames(np, chain, list(joints.T)), load)
        torque = np.stack([np.broadcast_to(part, len(joints)) for part in parts]).T
        if geometry.coupling is None:
            return torque
        columns = [dict(geometry.links_of(joint)) for joint in range(geometry.joints)]
        return torque @ np.array([[column.get(link, 0.0) for column in columns] for link in range(geometry.links)])
