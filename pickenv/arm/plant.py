"""The true arm: what a joint command really does to the tool.

command -> drives -> joint deflection -> chain with true geometry -> boom bending -> base -> tool pose. Each effect is
None when switched off; with all of them off the plant is exactly the true geometry. Effects depend on the joints alone.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from pickenv.arm.arm_file import Arm
from pickenv.arm.effects import (
    BoomBending,
    JointCompliance,
    Load,
    TransmissionError,
    boom_flexure,
    driven_joints,
    gravity_torques,
    yielded_joints,
)
from pickenv.arm.geometry import Geometry, Pose
from pickenv.arm.kinematics import Chain, Frame, Scalar, chain_of, frames, pose_of, split_joints, tool_frame
from pickenv.arm.pose_error import displace_pose

EFFECTS = ("joint_compliance", "boom_bending", "transmission_error", "measurement_noise")


@dataclass(frozen=True)
class MeasurementNoise:
    """Normal noise of the measuring instrument, per axis: position in m, attitude in rad."""

    position_std: float
    attitude_std: float


@dataclass(frozen=True, eq=False)
class Plant:
    """An arm as its controller knows it, and everything that makes the real one differ.

    Attributes:
        name: Name of the preset.
        arm: The arm; its nominal geometry is what the controller believes in.
        geometry: True geometry.
        load: Masses for gravity, needed by compliance.
        joint_compliance: Joint deflection under gravity, or None.
        boom_bending: Bending of the telescopic boom, or None.
        transmission_error: Errors of the drives, or None.
        measurement_noise: Noise of the instrument that measures the tool, or None; it never moves the arm.
    """

    name: str
    arm: Arm
    geometry: Geometry
    load: Load | None = None
    joint_compliance: JointCompliance | None = None
    boom_bending: BoomBending | None = None
    transmission_error: TransmissionError | None = None
    measurement_noise: MeasurementNoise | None = None

    @cached_property
    def _chain(self) -> Chain:
        return chain_of(self.geometry)

    def without(self, effects: Iterable[str]) -> Plant:
        """This plant with the named effects (of `EFFECTS`) switched off."""
        effects = tuple(effects)
        for name in effects:
            if name not in EFFECTS:
                raise ValueError(f"unknown effect '{name}'; a plant has {', '.join(EFFECTS)}")
        off: dict[str, Any] = dict.fromkeys(effects)
        return replace(self, **off)

    def tool_frame(self, m: ModuleType, q: Sequence[Scalar]) -> Frame:
        """True tool frame in components, for the joint command ``q``; ``m`` is math, numpy or torch."""
        if self.transmission_error is not None:
            q = driven_joints(m, self.transmission_error, q)
        if self.joint_compliance is not None and self.load is not None:
            # One evaluation at the undeflected joints: feeding the deflection back changes it by its own size squared.
            torques = gravity_torques(self._chain, frames(m, self._chain, q), self.load)
            q = yielded_joints(self.joint_compliance, torques, q)
        flexure = None
        if self.boom_bending is not None:
            flexure = boom_flexure(self.boom_bending, self.load.payload if self.load else 0.0, q)
        return tool_frame(m, self._chain, q, flexure)

    def tool_pose(self, q: ArrayLike) -> Pose:
        """True tool pose, free of measurement noise, for joint commands ``(..., n)`` in rad and m."""
        return pose_of(self.tool_frame(np, split_joints(self.geometry.joints, q)))

    def tool_frame_floats(self, q: Sequence[float]) -> Frame:
        """True tool frame for one joint command, on Python floats: the fast path of a single environment."""
        return self.tool_frame(math, q)

    def measured_pose(self, q: ArrayLike, rng: np.random.Generator) -> Pose:
        """Tool pose as an instrument with this plant's measurement noise reports it."""
        pose = self.tool_pose(q)
        noise = self.measurement_noise
        if noise is None:
            return pose
        scale = np.repeat([noise.position_std, noise.attitude_std], 3)
        return displace_pose(pose, rng.normal(size=(*pose.position.shape[:-1], 6)) * scale)
