"""One reader per table of a plant file: file units in, an effect in SI units out."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from pickenv.arm.effects.drives import Encoder, Servo
from pickenv.arm.effects.ground import BaseTilt
from pickenv.arm.effects.hysteresis import Backlash, StickBand
from pickenv.arm.effects.settling import Settling
from pickenv.arm.effects.structure import BoomBending, Harmonic, JointCompliance, Load, RollerPlay, TransmissionError
from pickenv.arm.effects.thermal import ThermalGrowth
from pickenv.arm.files.arm_file import Arm
from pickenv.arm.files.tables import METRES, RADIANS, Table
from pickenv.errors import InputError

HARMONIC_KEYS = ("joint", "phase_deg", "amplitude_mm", "period_mm", "amplitude_arcmin", "period_deg")


def load(table: Table, arm: Arm) -> Load:
    """Masses: kg and mm."""
    n = arm.nominal.joints
    centres = table.table.get("centre_mm")
    if not isinstance(centres, list) or len(centres) != n:
        raise table.fail("centre_mm", f"{n} points of three numbers")
    points = [
        Table({"centre_mm": c}, "load", table.where, ("centre_mm",)).numbers("centre_mm", 3, signed=True)
        for c in centres
    ]
    return Load(
        mass=table.numbers("mass_kg", n),
        centre=tuple((x * 1e-3, y * 1e-3, z * 1e-3) for x, y, z in points),
        payload=table.number("payload_kg", default=0.0),
    )


def joint_compliance(table: Table, arm: Arm) -> JointCompliance:
    """Stiffness per joint: N*m/rad or N/m."""
    return JointCompliance(table.numbers("stiffness", arm.nominal.joints, positive=True))


def boom_bending(table: Table, arm: Arm) -> BoomBending:
    """A boom: mm, N*m^2, kg."""
    return BoomBending(
        joint=table.slide_index(arm),
        length=table.number("length_mm") * 1e-3,
        flexural_rigidity=table.number("flexural_rigidity_N_m2", positive=True),
        end_mass=table.number("end_mass_kg"),
        mass_per_length=table.number("mass_per_length_kg_per_m"),
    )


def transmission_error(table: Table, arm: Arm) -> TransmissionError:
    """Lead errors (relative) and harmonics: arcmin and deg, or mm."""
    harmonics = []
    for term in table.entries("harmonics", HARMONIC_KEYS):
        joint = term.joint_index(arm)
        if arm.nominal.prismatic[joint]:
            amplitude, period = term.number("amplitude_mm") * 1e-3, term.number("period_mm", positive=True) * 1e-3
        else:
            amplitude = math.radians(term.number("amplitude_arcmin") / 60.0)
            period = math.radians(term.number("period_deg", positive=True))
        harmonics.append(Harmonic(joint, amplitude, period, math.radians(term.number("phase_deg", signed=True))))
    lead = table.numbers("lead", arm.nominal.joints, signed=True)
    return TransmissionError(lead, tuple(harmonics))


def roller_play(table: Table, arm: Arm) -> RollerPlay:
    """Play of a boom in its rollers: mm."""
    joint = table.slide_index(arm)
    overlap = table.number("overlap_mm", positive=True) * 1e-3
    furthest = float(arm.nominal.upper[joint])
    if overlap <= furthest:
        raise table.fail("overlap_mm", f"more than the {furthest * 1e3:g} mm that joint {joint + 1} runs out")
    return RollerPlay(joint, table.number("length_mm") * 1e-3, table.number("clearance_mm") * 1e-3, overlap)


def backlash(table: Table, arm: Arm) -> Backlash:
    """Gaps: arcmin and N*m, or mm and N; joints left out have none."""
    width, preload = [0.0] * arm.nominal.joints, [0.0] * arm.nominal.joints
    for joint, entry in table.by_joint(arm, ("width_arcmin", "width_mm", "preload_N_m", "preload_N")).items():
        width[joint] = _travel(entry, "width", arm, joint)
        preload[joint] = entry.number("preload_N" if arm.nominal.prismatic[joint] else "preload_N_m")
    return Backlash(tuple(width), tuple(preload))


def stick_band(table: Table, arm: Arm) -> StickBand:
    """Friction bands: arcmin or mm; joints left out have none. Their scatter from stop to stop is a share of them."""
    bands = {"forward": [0.0] * arm.nominal.joints, "backward": [0.0] * arm.nominal.joints}
    keys = [f"{side}_{unit}" for side in bands for unit in ("arcmin", "mm")]
    for joint, entry in table.by_joint(arm, keys).items():
        for side, band in bands.items():
            band[joint] = _travel(entry, side, arm, joint)
    scatter = table.number("scatter", default=0.0)
    return StickBand(tuple(bands["forward"]), tuple(bands["backward"]), scatter)


def thermal_growth(table: Table, arm: Arm) -> ThermalGrowth:
    """Growth: 1e-6/K, K and hours."""
    return ThermalGrowth(
        expansion=tuple(value * 1e-6 for value in table.numbers("expansion_um_per_m_K", arm.nominal.joints)),
        initial_rise=table.number("initial_rise_K", signed=True),
        final_rise=table.number("final_rise_K", signed=True),
        time_constant=table.number("time_constant_h", positive=True) * 3600.0,
    )


def base_tilt(table: Table, _arm: Arm) -> BaseTilt:
    """The ground: N*m/rad, mm and hours."""
    about_x, about_y = table.numbers("stiffness_N_m_per_rad", 2, positive=True)
    x, y, z = table.numbers("pivot_mm", 3, signed=True)
    return BaseTilt(
        stiffness=(about_x, about_y),
        pivot=(x * 1e-3, y * 1e-3, z * 1e-3),
        creep=table.number("creep"),
        settlement=table.number("settlement_mm") * 1e-3,
        time_constant=table.number("time_constant_h", positive=True) * 3600.0,
    )


def settling(table: Table, arm: Arm) -> Settling:
    """Modes: Hz, ratios and ms."""
    n = arm.nominal.joints
    damping = table.numbers("damping", n)
    if any(value >= 1 for value in damping):
        raise table.fail("damping", "damping ratios from 0 to below 1")
    return Settling(
        frequency=table.numbers("frequency_Hz", n, positive=True),
        damping=damping,
        participation=table.numbers("participation", n),
        rise_time=table.number("rise_time_ms", positive=True) * 1e-3,
    )


def encoder(table: Table, arm: Arm) -> Encoder:
    """Counts: arcsec or um."""
    entries = table.by_joint(arm, ("resolution_arcsec", "resolution_um"))
    resolution = []
    for joint in range(arm.nominal.joints):
        if joint not in entries:
            raise InputError(
                f"{table.where}: joints of [{table.name}] does not name joint {joint + 1}; give each joint"
            )
        resolution.append(_travel(entries[joint], "resolution", arm, joint, ("arcsec", "um"), positive=True))
    return Encoder(tuple(resolution))


def servo(table: Table, arm: Arm) -> Servo:
    """Lags: ms."""
    milliseconds = table.numbers("time_constant_ms", arm.nominal.joints, positive=True)
    return Servo(tuple(value * 1e-3 for value in milliseconds))


def _travel(
    entry: Table,
    quantity: str,
    arm: Arm,
    joint: int,
    units: tuple[str, str] = ("arcmin", "mm"),
    *,
    positive: bool = False,
) -> float:
    """A displacement of ``joint`` in rad or m, from the key whose unit suits the joint."""
    turn, slide = units
    if arm.nominal.prismatic[joint]:
        return entry.number(f"{quantity}_{slide}", positive=positive) * METRES[slide]
    return entry.number(f"{quantity}_{turn}", positive=positive) * RADIANS[turn]


READERS: Mapping[str, tuple[Callable[[Table, Arm], Any], tuple[str, ...]]] = {
    "load": (load, ("mass_kg", "centre_mm", "payload_kg")),
    "joint_compliance": (joint_compliance, ("stiffness",)),
    "boom_bending": (
        boom_bending,
        ("joint", "length_mm", "flexural_rigidity_N_m2", "end_mass_kg", "mass_per_length_kg_per_m"),
    ),
    "transmission_error": (transmission_error, ("lead", "harmonics")),
    "roller_play": (roller_play, ("joint", "length_mm", "clearance_mm", "overlap_mm")),
    "backlash": (backlash, ("joints",)),
    "stick_band": (stick_band, ("joints", "scatter")),
    "thermal_growth": (
        thermal_growth,
        ("expansion_um_per_m_K", "initial_rise_K", "final_rise_K", "time_constant_h"),
    ),
    "base_tilt": (base_tilt, ("stiffness_N_m_per_rad", "pivot_mm", "creep", "settlement_mm", "time_constant_h")),
    "settling": (settling, ("frequency_Hz", "damping", "participation", "rise_time_ms")),
    "encoder": (encoder, ("joints",)),
    "servo": (servo, ("time_constant_ms",)),
}
"""Reader and keys of each table."""
