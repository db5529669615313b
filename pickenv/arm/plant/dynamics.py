"""The true arm in time: what it remembers, how a held command moves it on, and where it settles in the end.

Motor (counts, lag) -> drive error -> friction -> backlash -> compliance -> swing -> warm chain -> boom -> ground. Every
effect that is off is skipped. States are tuples of components, so they run on every executor.
"""

from __future__ import annotations

from collections.abc import Sequence
from types import ModuleType
from typing import TYPE_CHECKING, NamedTuple

from pickenv.arm.effects.drives import followed, quantised
from pickenv.arm.effects.ground import immediate_tilt, long_run, sunk, tilted_frame
from pickenv.arm.effects.hysteresis import joints_amid_friction, joints_behind_backlash, joints_behind_friction
from pickenv.arm.effects.settling import Swing, at_rest, swung
from pickenv.arm.effects.structure import boom_flexure, driven_joints, gravity_torques, roller_flexure, yielded_joints
from pickenv.arm.effects.thermal import grown_chain, grown_joints, warmed
from pickenv.arm.kinematics.backend import chosen
from pickenv.arm.kinematics.forward import Chain, Flexure, Frame, Scalar, frames, tool_frame

if TYPE_CHECKING:
    from pickenv.arm.plant.plant import Plant

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


def select_state(m: ModuleType, condition: Scalar, yes: PlantState, no: PlantState) -> PlantState:
    """The state ``yes`` where ``condition`` holds (one truth value per arm), else ``no``: resets some arms of many."""
    parts = zip(yes, no, strict=True)
    return PlantState(*(tuple(chosen(m, condition, a, b) for a, b in zip(*part, strict=True)) for part in parts))


class _Gear(NamedTuple):
    """Joint displacements on their way from motor to link, and the loads on them."""

    friction: list[Scalar]
    backlash: list[Scalar]
    torques: list[Scalar] | None
    tilt: tuple[Scalar, Scalar] | None


def initial_state(plant: Plant, m: ModuleType, q: Sequence[Scalar]) -> PlantState:
    """State of a plant that stands still at the command ``q`` and has just been switched on: cold, and not yet sunk."""
    zero = q[0] * 0.0
    motor = _target(plant, m, q)
    gear = _gear(plant, m, motor, None)
    swings = at_rest(q) if plant.settling is not None else []
    return PlantState(
        motor=tuple(motor) if plant.servo is not None else (),
        friction=tuple(gear.friction) if plant.stick_band is not None else (),
        backlash=tuple(gear.backlash) if plant.backlash is not None else (),
        profile=tuple(swing.profile for swing in swings),
        vibration=tuple(swing.vibration for swing in swings),
        rate=tuple(swing.rate for swing in swings),
        rise=(zero + plant.thermal_growth.initial_rise,) if plant.thermal_growth is not None else (),
        sinkage=(zero, zero, zero) if plant.base_tilt is not None else (),
    )


def advance(
    plant: Plant, m: ModuleType, state: PlantState, q: Sequence[Scalar], dt: Scalar
) -> tuple[PlantState, Frame]:
    """Hold the command ``q`` for ``dt`` seconds: the new state, and the true tool frame at the end.

    Friction and backlash see the motor's way from where it was to where it is in the end, which is right as long as it
    does not turn back within ``dt``; all else is exact for a held command.
    """
    motor = _target(plant, m, q)
    if plant.servo is not None:
        motor = followed(m, plant.servo, state.motor, motor, dt)
    gear = _gear(plant, m, motor, state)
    swings = [Swing(*parts) for parts in zip(state.profile, state.vibration, state.rate, strict=True)]
    if plant.settling is not None:
        swings = swung(m, plant.settling, swings, q, dt)
    rise, sinkage = state.rise, state.sinkage
    if plant.thermal_growth is not None:
        rise = (warmed(m, plant.thermal_growth, rise[0], dt),)
    if plant.base_tilt is not None and gear.tilt is not None:
        sinkage = sunk(m, plant.base_tilt, sinkage, gear.tilt, dt)
    new = PlantState(
        motor=tuple(motor) if plant.servo is not None else (),
        friction=tuple(gear.friction) if plant.stick_band is not None else (),
        backlash=tuple(gear.backlash) if plant.backlash is not None else (),
        profile=tuple(swing.profile for swing in swings),
        vibration=tuple(swing.vibration for swing in swings),
        rate=tuple(swing.rate for swing in swings),
        rise=rise,
        sinkage=sinkage,
    )
    chain = plant.chain
    if plant.thermal_growth is not None:
        chain = grown_chain(plant.thermal_growth, chain, rise[0])
    return new, _tool(plant, m, chain, gear, swings, rise, sinkage)


def settled_frame(plant: Plant, m: ModuleType, q: Sequence[Scalar]) -> Frame:
    """True tool frame when ``q`` has been held for ever: warm, sunk, at rest, friction and free gaps in the middle."""
    gear = _gear(plant, m, _target(plant, m, q), None)
    rise = (plant.thermal_growth.final_rise,) if plant.thermal_growth is not None else ()
    sinkage: Components = ()
    if plant.base_tilt is not None and gear.tilt is not None:
        sinkage = long_run(plant.base_tilt, gear.tilt)
    return _tool(plant, m, plant.warm_chain, gear, [], rise, sinkage)


def readings(plant: Plant, m: ModuleType, state: PlantState, q: Sequence[Scalar]) -> list[Scalar]:
    """What the motor encoders report, rad or m: the motor in whole counts, with its following error.

    They see neither drive errors nor friction, backlash, deflection or swing.
    """
    motor = list(state.motor) if plant.servo is not None else list(q)
    return motor if plant.encoder is None else quantised(m, plant.encoder, motor)


def _target(plant: Plant, m: ModuleType, q: Sequence[Scalar]) -> list[Scalar]:
    return list(q) if plant.encoder is None else quantised(m, plant.encoder, q)


def _gear(plant: Plant, m: ModuleType, motor: Sequence[Scalar], state: PlantState | None) -> _Gear:
    """From motor positions to displacements behind the gears; without a state, the history-free ones."""
    driven = list(motor)
    if plant.transmission_error is not None:
        driven = driven_joints(m, plant.transmission_error, driven)
    torques, tilt = None, None
    if plant.load is not None and (plant.joint_compliance or plant.backlash or plant.base_tilt):
        # Loads are taken at the driven joints of the straight, cold arm: what is left out is of second order.
        straight = frames(m, plant.chain, driven)
        if plant.joint_compliance is not None or plant.backlash is not None:
            torques = gravity_torques(plant.chain, straight, plant.load)
        if plant.base_tilt is not None:
            tilt = immediate_tilt(plant.base_tilt, plant.chain, straight, plant.load)
    friction = driven
    if plant.stick_band is not None:
        if state is None:
            friction = joints_amid_friction(plant.stick_band, driven)
        else:
            friction = joints_behind_friction(m, plant.stick_band, driven, state.friction)
    backlash = friction
    if plant.backlash is not None:
        before = friction if state is None else state.backlash
        backlash = joints_behind_backlash(m, plant.backlash, torques, friction, before)
    return _Gear(friction, backlash, torques, tilt)


def _tool(
    plant: Plant,
    m: ModuleType,
    chain: Chain,
    gear: _Gear,
    swings: Sequence[Swing],
    rise: Components,
    sinkage: Components,
) -> Frame:
    """From displacements behind the gears to the tool."""
    joints = gear.backlash
    if plant.joint_compliance is not None and gear.torques is not None:
        joints = yielded_joints(plant.joint_compliance, gear.torques, joints)
    if swings:
        joints = [value + swing.vibration for value, swing in zip(joints, swings, strict=True)]
    if plant.thermal_growth is not None:
        joints = grown_joints(plant.thermal_growth, chain, joints, rise[0])
    frame = tool_frame(m, chain, joints, _flexure(plant, joints))
    if plant.base_tilt is not None and gear.tilt is not None:
        frame = tilted_frame(plant.base_tilt, gear.tilt, sinkage, frame)
    return frame


def _flexure(plant: Plant, joints: Sequence[Scalar]) -> Flexure | None:
    """Bending of the boom and play in its rollers, one after the other."""
    bend = slack = None
    if plant.boom_bending is not None:
        bend = boom_flexure(plant.boom_bending, plant.load.payload if plant.load else 0.0, joints)
    if plant.roller_play is not None:
        slack = roller_flexure(plant.roller_play, joints)
    if bend is None or slack is None:
        return bend or slack
    return lambda i, frame: slack(i, bend(i, frame))
