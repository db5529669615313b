"""The true arm: what a joint command really does to the tool.

command -> drives -> joint deflection -> chain with true geometry -> boom bending -> base -> tool pose. Each effect is
None when switched off; with all of them off the plant is exactly the true geometry. Some effects depend on the joints
alone; the others have a state (`pickenv.arm.plant.dynamics`). Numbers may be arrays: one entry per arm, many arms at once.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from pickenv.arm.effects.drives import Encoder, Servo
from pickenv.arm.effects.ground import BaseTilt
from pickenv.arm.effects.hysteresis import Backlash, StickBand
from pickenv.arm.effects.settling import Settling
from pickenv.arm.effects.structure import (
    BoomBending,
    JointCompliance,
    Load,
    RollerPlay,
    TransmissionError,
    boom_flexure,
    driven_joints,
    gravity_torques,
    yielded_joints,
)
from pickenv.arm.effects.thermal import ThermalGrowth, grown_chain
from pickenv.arm.files.arm_file import Arm
from pickenv.arm.kinematics.forward import Chain, Frame, Scalar, chain_of, frames, pose_of, split_joints, tool_frame
from pickenv.arm.kinematics.geometry import Geometry, Pose
from pickenv.arm.kinematics.pose_error import displace_pose
from pickenv.arm.plant import dynamics
from pickenv.arm.plant.dynamics import PlantState

EFFECTS = (
    "joint_compliance",
    "boom_bending",
    "transmission_error",
    "measurement_noise",
    "roller_play",
    "backlash",
    "stick_band",
    "thermal_growth",
    "base_tilt",
    "settling",
    "encoder",
    "servo",
)
WITH_STATE = ("backlash", "stick_band", "thermal_growth", "base_tilt", "settling", "servo")
BEYOND_BASIC = ("roller_play", "encoder", *WITH_STATE)


@dataclass(frozen=True)
class MeasurementNoise:
    """Normal noise of the measuring instrument, per axis: position in m, attitude in rad."""

    position_std: float
    attitude_std: float


class Ready(NamedTuple):
    """A chain, and the geometry that it belongs to."""

    geometry: Geometry
    chain: Chain


@dataclass(frozen=True, eq=False)
class Plant:
    """An arm as its controller knows it, and everything that makes the real one differ.

    Attributes:
        name: Name of the preset.
        arm: The arm; its nominal geometry is what the controller believes in.
        geometry: True geometry.
        load: Masses for gravity, needed by compliance and base tilt, and by backlash for its preload.
        joint_compliance: Joint deflection under gravity, or None.
        boom_bending: Bending of the telescopic boom, or None.
        transmission_error: Errors of the drives, or None.
        measurement_noise: Noise of the instrument that measures the tool, or None; it never moves the arm.
        roller_play: Play in the boom's rollers, or None.
        backlash: Gaps in the joints' gears, or None.
        stick_band: Friction that stops joints short of their command, or None.
        thermal_growth: Growth and warm-up of the links, or None.
        base_tilt: Ground that gives way under the machine, or None.
        settling: Vibration after moves, or None.
        encoder: Resolution of the motor encoders, or None.
        servo: Following error of the drives, or None.
        ready: The geometry's chain where its numbers were moved or picked (`batch.plants_on`), or None to compute it.
    """

    name: str
    arm: Arm
    geometry: Geometry
    load: Load | None = None
    joint_compliance: JointCompliance | None = None
    boom_bending: BoomBending | None = None
    transmission_error: TransmissionError | None = None
    measurement_noise: MeasurementNoise | None = None
    roller_play: RollerPlay | None = None
    backlash: Backlash | None = None
    stick_band: StickBand | None = None
    thermal_growth: ThermalGrowth | None = None
    base_tilt: BaseTilt | None = None
    settling: Settling | None = None
    encoder: Encoder | None = None
    servo: Servo | None = None
    ready: Ready | None = None

    @cached_property
    def chain(self) -> Chain:
        """The true geometry made ready for the executors, at the temperature at which it holds."""
        if self.ready is not None and self.ready.geometry is self.geometry:
            return self.ready.chain
        return chain_of(self.geometry, math if self.geometry.alpha.ndim == 1 else np)

    @cached_property
    def warm_chain(self) -> Chain:
        """The true geometry of the warm arm."""
        thermal = self.thermal_growth
        return self.chain if thermal is None else grown_chain(thermal, self.chain, thermal.final_rise)

    @cached_property
    def has_state(self) -> bool:
        """Whether where the tool stands depends on more than the present command."""
        return any(getattr(self, name) is not None for name in WITH_STATE)

    @cached_property
    def _beyond_basic(self) -> bool:
        return any(getattr(self, name) is not None for name in BEYOND_BASIC)

    def without(self, effects: Iterable[str]) -> Plant:
        """This plant with the named effects (of `EFFECTS`) switched off."""
        effects = tuple(effects)
        for name in effects:
            if name not in EFFECTS:
                raise ValueError(f"unknown effect '{name}'; a plant has {', '.join(EFFECTS)}")
        off: dict[str, Any] = dict.fromkeys(effects)
        return replace(self, **off)

    def tool_frame(self, m: ModuleType, q: Sequence[Scalar]) -> Frame:
        """True tool frame in components, for the joint command ``q``; ``m`` is math, numpy or torch.

        It is the settled, history-free pose: where the tool ends when ``q`` is held for ever. Gaps that gravity does
        not close, and the friction band, are in their middle.
        """
        if self._beyond_basic:
            return dynamics.settled_frame(self, m, q)
        if self.transmission_error is not None:
            q = driven_joints(m, self.transmission_error, q)
        if self.joint_compliance is not None and self.load is not None:
            # One evaluation at the undeflected joints: feeding the deflection back changes it by its own size squared.
            torques = gravity_torques(self.chain, frames(m, self.chain, q), self.load)
            q = yielded_joints(self.joint_compliance, torques, q)
        flexure = None
        if self.boom_bending is not None:
            flexure = boom_flexure(self.boom_bending, self.load.payload if self.load else 0.0, q)
        return tool_frame(m, self.chain, q, flexure)

    def initial_state(self, m: ModuleType, q: Sequence[Scalar]) -> PlantState:
        """State at rest at the command ``q``, just switched on: cold, and not yet sunk. See `advance`."""
        return dynamics.initial_state(self, m, q) if self.has_state else PlantState()

    def advance(self, m: ModuleType, state: PlantState, q: Sequence[Scalar], dt: Scalar) -> tuple[PlantState, Frame]:
        """Hold the joint command ``q`` for ``dt`` seconds.

        Args:
            m: ``math``, ``numpy`` or ``torch``.
            state: From `initial_state` or an earlier call.
            q: Joint command, n components, rad or m.
            dt: s, one number or one per arm.

        Returns:
            The new state, and the true tool frame at the end; with no effect that has a state, that is `tool_frame`.
        """
        if not self.has_state:
            return state, self.tool_frame(m, q)
        return dynamics.advance(self, m, state, q, dt)

    def readings(self, m: ModuleType, state: PlantState, q: Sequence[Scalar]) -> list[Scalar]:
        """What the motor encoders report after `advance` to ``state`` at the command ``q``, rad or m."""
        return dynamics.readings(self, m, state, q)

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
