"""The true arm: what a joint command really does to the tool.

Motor (counts, lag) -> drive error -> friction -> backlash -> compliance -> swing -> warm chain -> slides and boom ->
ground -> local structure -> what a calibration found beside them. Each effect is None when switched off; with all of
them off the plant is exactly the true geometry. Some effects depend on the joints alone; the others have a state, a
tuple of components that runs on floats, arrays and tensors. Numbers may be arrays: one
entry per arm, many arms at once.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property, reduce
from types import ModuleType
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from pickenv.arm.effects import hysteresis, structure
from pickenv.arm.effects.drives import (
    Encoder,
    GravityYield,
    MeasurementNoise,
    Servo,
    ThermalGrowth,
    followed,
    grown_chain,
    grown_joints,
    quantised,
    warmed,
    weighed_down,
)
from pickenv.arm.effects.ground import (
    BaseTilt,
    Settling,
    Swing,
    at_rest,
    immediate_tilt,
    long_run,
    sunk,
    swung,
    tilted_frame,
)
from pickenv.arm.effects.residual_field import DriveHarmonics, LocalStructure, ResidualField, strayed
from pickenv.arm.files.arm import Arm
from pickenv.arm.kinematics.forward import (
    Chain,
    Flexure,
    Frame,
    Scalar,
    chain_of,
    frames,
    pose_of,
    split_joints,
    tool_frame,
)
from pickenv.arm.kinematics.geometry import Geometry, Pose
from pickenv.arm.plant.posterior import Posterior

# What the true arm remembers from one moment to the next; `pickenv.arm.plant.plant` moves it on.


Components = tuple[Scalar, ...]


class PlantState(NamedTuple):
    """What a plant remembers; every part is empty while its effect is off, and each component has the joints' shape.

    Attributes:
        motor: Motor positions, n of them, rad or m (servo).
        friction: Joint displacements behind the friction, n (stick band).
        backlash: Joint displacements behind the gaps, n (backlash).
        profile: Motion profiles, n (settling).
        vibration: Displacements of the swinging modes, n (settling).
        rate: Velocities of what swings, n, rad/s or m/s (settling).
        rise: Temperature rise, one, K (thermal growth).
        sinkage: Creep about x and y in rad, settlement in m (base tilt).
    """

    motor: Components = ()
    friction: Components = ()
    backlash: Components = ()
    profile: Components = ()
    vibration: Components = ()
    rate: Components = ()
    rise: Components = ()
    sinkage: Components = ()


WITH_STATE = ("backlash", "stick_band", "thermal_growth", "base_tilt", "settling", "servo")


NEED_LOAD = ("joint_compliance", "boom_couple", "boom_torsion", "slide_compliance", "base_tilt")
"""Effects that are nothing without masses."""

WITH_LOAD = (*NEED_LOAD, "backlash")
"""Effects that gravity's loads act on."""


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
        load: Masses for gravity, needed by `NEED_LOAD`, and by backlash for its preload.
        joint_compliance: Joint deflection under gravity, or None.
        boom_bending: Bending of the telescopic boom, or None.
        transmission_error: Errors of the drives, or None.
        drive_harmonics: Waves of the drives that the arm has for itself, or None.
        local_structure: Finer displacement of the tool that the arm has for itself, or None.
        measurement_noise: Errors of the instrument that stands beside it, unless a campaign brings another
            (`pickenv.arm.plant.campaign`), or None; they never move the arm.
        boom_couple: Bending of the boom by what hangs beside its tip, or None.
        boom_torsion: Its twist, or None.
        slide_compliance: Bearings of slides that yield, or None.
        roller_play: Play in the boom's rollers, or None.
        backlash: Gaps in the joints' gears, or None.
        stick_band: Friction that stops joints short of their command, or None.
        thermal_growth: Growth and warm-up of the links, or None.
        base_tilt: Ground that gives way under the machine, or None.
        settling: Vibration after moves, or None.
        encoder: Resolution of the motor encoders, or None.
        servo: Following error of the drives, or None.
        gravity_yield: Joints that yield under weights that a calibration found, or None.
        residual: What a calibration found that no table of links holds, or None.
        posterior: How surely a calibration knows all this, where the plant was made of one; else None.
        ready: The geometry's chain where its numbers were moved or picked (`batch.plants_on`), or None to compute it.
    """

    name: str
    arm: Arm
    geometry: Geometry
    load: structure.Load | None = None
    joint_compliance: structure.JointCompliance | None = None
    boom_bending: structure.BoomBending | None = None
    transmission_error: structure.TransmissionError | None = None
    drive_harmonics: DriveHarmonics | None = None
    local_structure: LocalStructure | None = None
    measurement_noise: MeasurementNoise | None = None
    boom_couple: hysteresis.BoomCouple | None = None
    boom_torsion: hysteresis.BoomTorsion | None = None
    slide_compliance: hysteresis.SlideCompliance | None = None
    roller_play: structure.RollerPlay | None = None
    backlash: hysteresis.Backlash | None = None
    stick_band: hysteresis.StickBand | None = None
    thermal_growth: ThermalGrowth | None = None
    base_tilt: BaseTilt | None = None
    settling: Settling | None = None
    encoder: Encoder | None = None
    servo: Servo | None = None
    gravity_yield: GravityYield | None = None
    residual: ResidualField | None = None
    posterior: Posterior | None = None
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

    def without(self, effects: Iterable[str]) -> Plant:
        """This plant with the named effects (of `EFFECTS` and `FOUND`) switched off."""
        effects = tuple(effects)
        for name in effects:
            if name not in (*EFFECTS, *FOUND):
                raise ValueError(f"unknown effect '{name}'; a plant has {', '.join((*EFFECTS, *FOUND))}")
        off: dict[str, Any] = dict.fromkeys(effects)
        return replace(self, **off)

    def tool_frame(self, m: ModuleType, q: Sequence[Scalar]) -> Frame:
        """True tool frame in components, for the joint command ``q``; ``m`` is math, numpy or torch.

        It is the settled, history-free pose: where the tool ends when ``q`` is held for ever. Gaps that gravity does
        not close, and the friction band, are in their middle.
        """
        motor = self._target(m, q)
        gear = _gear(self, m, motor, None)
        rise = (self.thermal_growth.final_rise,) if self.thermal_growth is not None else ()
        sinkage: Components = ()
        if self.base_tilt is not None and gear.tilt is not None:
            sinkage = long_run(self.base_tilt, gear.tilt)
        return _tool(self, m, self.warm_chain, motor, gear, (), rise, sinkage)

    def initial_state(self, m: ModuleType, q: Sequence[Scalar]) -> PlantState:
        """State at rest at the command ``q``, just switched on: cold, and not yet sunk. See `advance`."""
        if not self.has_state:
            return PlantState()
        zero = q[0] * 0.0
        motor = self._target(m, q)
        gear = _gear(self, m, motor, None)
        rise = (zero + self.thermal_growth.initial_rise,) if self.thermal_growth is not None else ()
        sinkage = (zero, zero, zero) if self.base_tilt is not None else ()
        return _state(self, motor, gear, at_rest(q) if self.settling is not None else (), rise, sinkage)

    def advance(self, m: ModuleType, state: PlantState, q: Sequence[Scalar], dt: Scalar) -> tuple[PlantState, Frame]:
        """Hold the joint command ``q`` for ``dt`` seconds.

        Friction and backlash see the motor's way from where it was to where it is in the end, which is right as long as
        it does not turn back within ``dt``; all else is exact for a held command.

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
        new, (chain, motor, gear, swings) = self._moved_on(m, state, q, dt)
        return new, _tool(self, m, chain, motor, gear, swings, new.rise, new.sinkage)

    def carried(self, m: ModuleType, state: PlantState, q: Sequence[Scalar], dt: Scalar) -> PlantState:
        """The state of `advance`, where nobody asks for the tool."""
        return self._moved_on(m, state, q, dt)[0] if self.has_state else state

    def _moved_on(
        self, m: ModuleType, state: PlantState, q: Sequence[Scalar], dt: Scalar
    ) -> tuple[PlantState, _Driven]:
        """The new state, and what stands between motor and tool then."""
        motor = self._target(m, q)
        if self.servo is not None:
            motor = followed(m, self.servo, state.motor, motor, dt)
        gear = _gear(self, m, motor, state)
        swings = [Swing(*parts) for parts in zip(state.profile, state.vibration, state.rate, strict=True)]
        if self.settling is not None:
            swings = swung(m, self.settling, swings, q, dt)
        chain, rise, sinkage = self.chain, state.rise, state.sinkage
        if self.thermal_growth is not None:
            rise = (warmed(m, self.thermal_growth, rise[0], dt),)
            chain = grown_chain(self.thermal_growth, chain, rise[0])
        if self.base_tilt is not None and gear.tilt is not None:
            sinkage = sunk(m, self.base_tilt, sinkage, gear.tilt, dt)
        return _state(self, motor, gear, swings, rise, sinkage), (chain, motor, gear, swings)

    def readings(self, m: ModuleType, state: PlantState, q: Sequence[Scalar]) -> list[Scalar]:
        """What the motor encoders report after `advance` to ``state`` at the command ``q``, rad or m.

        The motor in whole counts, with its following error: they see neither drive errors nor friction, backlash,
        deflection or swing.
        """
        return self._target(m, state.motor if self.servo is not None else q)

    def _target(self, m: ModuleType, q: Sequence[Scalar]) -> list[Scalar]:
        """Joints in whole counts of the motor encoders."""
        return list(q) if self.encoder is None else quantised(m, self.encoder, q)

    def tool_pose(self, q: ArrayLike) -> Pose:
        """True tool pose, free of measurement noise, for joint commands ``(..., n)`` in rad and m."""
        return pose_of(self.tool_frame(np, split_joints(self.geometry.joints, q)))


FOUND = ("gravity_yield", "residual")
"""Effects of which only a calibration knows the numbers: no plant file holds them."""

_OTHERS = ("name", "arm", "geometry", "load", "posterior", "ready", *FOUND)

EFFECTS = tuple(part.name for part in fields(Plant) if part.name not in _OTHERS)
"""Effects that plant files hold."""


class _Gear(NamedTuple):
    """Where the drives hold the joints, and what gravity does there; None is what no effect asks for.

    Attributes:
        friction: Joint displacements behind friction.
        backlash: Joint displacements behind backlash.
        weights: What hangs on each link.
        torques: Gravity's torques and forces on the joints.
        tilt: The base's immediate tilt.
    """

    friction: Sequence[Scalar]
    backlash: Sequence[Scalar]
    weights: list[structure.Weight] | None
    torques: list[Scalar] | None
    tilt: tuple[Scalar, Scalar] | None


_Driven: TypeAlias = tuple[Chain, Sequence[Scalar], _Gear, Sequence[Swing]]
"""The chain at its temperature, the motors, what stands behind the gears, and the swing."""


def _state(
    plant: Plant, motor: Sequence[Scalar], gear: _Gear, swings: Sequence[Swing], rise: Components, sinkage: Components
) -> PlantState:
    return PlantState(
        motor=tuple(motor) if plant.servo is not None else (),
        friction=tuple(gear.friction) if plant.stick_band is not None else (),
        backlash=tuple(gear.backlash) if plant.backlash is not None else (),
        profile=tuple(swing.profile for swing in swings),
        vibration=tuple(swing.vibration for swing in swings),
        rate=tuple(swing.rate for swing in swings),
        rise=rise,
        sinkage=sinkage,
    )


def _gear(plant: Plant, m: ModuleType, motor: Sequence[Scalar], state: PlantState | None) -> _Gear:
    """From motor positions to displacements behind the gears; without a state, the history-free ones."""
    driven = motor
    if plant.transmission_error is not None:
        driven = structure.driven_joints(m, plant.transmission_error, driven)
    if plant.drive_harmonics is not None:
        driven = structure.with_waves(m, plant.drive_harmonics.harmonics, motor, driven)
    weights, torques, tilt = None, None, None
    if plant.load is not None and any(getattr(plant, name) is not None for name in WITH_LOAD):
        # Loads are taken at the driven joints of the straight, cold arm: what is left out is of second order.
        straight = frames(m, plant.chain, driven)
        weights = structure.weights_behind(plant.chain, straight, plant.load)
        if plant.joint_compliance is not None or plant.backlash is not None:
            torques = structure.weights_torques(plant.chain, straight, weights)
        if plant.base_tilt is not None:
            tilt = immediate_tilt(plant.base_tilt, weights)
    friction = driven
    if plant.stick_band is not None:
        if state is None:
            friction = hysteresis.joints_amid_friction(plant.stick_band, driven)
        else:
            friction = hysteresis.joints_behind_friction(m, plant.stick_band, driven, state.friction)
    backlash = friction
    if plant.backlash is not None:
        before = friction if state is None else state.backlash
        backlash = hysteresis.joints_behind_backlash(m, plant.backlash, torques, friction, before)
    return _Gear(friction, backlash, weights, torques, tilt)


def _tool(
    plant: Plant,
    m: ModuleType,
    chain: Chain,
    motor: Sequence[Scalar],
    gear: _Gear,
    swings: Sequence[Swing],
    rise: Components,
    sinkage: Components,
) -> Frame:
    """From displacements behind the gears to the tool."""
    joints, torques, tilt = gear.backlash, gear.torques, gear.tilt
    if plant.joint_compliance is not None and torques is not None:
        joints = structure.yielded_joints(plant.joint_compliance, torques, joints)
    if plant.gravity_yield is not None:
        joints = weighed_down(m, plant.gravity_yield, plant.chain, joints)
    if swings:
        joints = [value + swing.vibration for value, swing in zip(joints, swings, strict=True)]
    if plant.thermal_growth is not None:
        joints = grown_joints(plant.thermal_growth, chain, joints, rise[0])
    frame = tool_frame(m, chain, joints, _flexure(plant, m, joints, gear.weights))
    if plant.base_tilt is not None and tilt is not None:
        frame = tilted_frame(plant.base_tilt, tilt, sinkage, frame)
    if plant.local_structure is not None:
        frame = strayed(m, plant.local_structure.field, motor, frame)
    return frame if plant.residual is None else strayed(m, plant.residual, motor, frame)


def _flexure(
    plant: Plant, m: ModuleType, joints: Sequence[Scalar], weights: Sequence[structure.Weight] | None
) -> Flexure | None:
    """What slides and boom do, one after the other: bearings, bending, couple, twist, play in the rollers."""
    bends: list[Flexure] = []
    if plant.slide_compliance is not None and weights is not None:
        bends.append(hysteresis.slide_flexure(m, plant.slide_compliance, weights, joints))
    if plant.boom_bending is not None:
        bends.append(structure.boom_flexure(plant.boom_bending, plant.load.payload if plant.load else 0.0, joints))
    if plant.boom_couple is not None and weights is not None:
        bends.append(hysteresis.couple_flexure(m, plant.boom_couple, weights, joints))
    if plant.boom_torsion is not None and weights is not None:
        bends.append(hysteresis.torsion_flexure(m, plant.boom_torsion, weights, joints))
    if plant.roller_play is not None:
        bends.append(structure.roller_flexure(plant.roller_play, joints))
    if len(bends) < 2:
        return bends[0] if bends else None
    return lambda i, frame: reduce(lambda bent, bend: bend(i, bent), bends, frame)
