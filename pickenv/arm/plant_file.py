"""Plants are TOML files: which arm, and the size and source of each effect. The presets lie in `pickenv/arm/plants`."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from pickenv.arm.arm_file import Arm, load_arm, read_toml, refuse_unknown, shipped_arms
from pickenv.arm.effects import BoomBending, Harmonic, JointCompliance, Load, TransmissionError
from pickenv.arm.plant import EFFECTS, MeasurementNoise, Plant
from pickenv.errors import InputError

PLANTS = Path(__file__).parent / "plants"

KEYS = {
    "load": ("mass_kg", "centre_mm", "payload_kg"),
    "joint_compliance": ("stiffness",),
    "boom_bending": ("joint", "length_mm", "flexural_rigidity_N_m2", "end_mass_kg", "mass_per_length_kg_per_m"),
    "transmission_error": ("lead", "harmonics"),
    "measurement_noise": ("position_std_mm", "attitude_std_deg"),
}
HARMONIC_KEYS = ("joint", "phase_deg", "amplitude_mm", "period_mm", "amplitude_arcmin", "period_deg")


def shipped_plants() -> list[str]:
    """Names of the plant presets that come with pickenv."""
    return sorted(path.stem for path in PLANTS.glob("*.toml"))


def load_plant(name: str | Path, *, without: Iterable[str] = ()) -> Plant:
    """Read a plant by name (a preset) or from a path to a TOML file.

    Args:
        name: A preset's name or a path ending in .toml.
        without: Effects to switch off.

    Raises:
        InputError: If the plant or an effect is unknown or a number is impossible; names the file and the key.
    """
    path = Path(name)
    if path.suffix != ".toml":
        path = PLANTS / f"{name}.toml"
    if not path.is_file():
        raise InputError(f"unknown plant '{name}'; give one of {shipped_plants()} or a path to a plant file (.toml)")
    plant = parse_plant(read_toml(path), str(path))
    try:
        return plant.without(without)
    except ValueError as error:
        raise InputError(str(error)) from error


def parse_plant(content: Mapping[str, Any], where: str) -> Plant:
    """Turn the parsed content of a plant file into a `Plant`; ``where`` names the file in error messages."""
    refuse_unknown(content, ("name", "arm", "source", "load", *EFFECTS), where, "a plant file")
    if not isinstance(content.get("arm"), str):
        raise InputError(f"{where}: arm is missing; name the arm, one of {shipped_arms()} or a path to an arm file")
    try:
        arm = load_arm(content["arm"])
    except InputError as error:
        raise InputError(f"{where}: {error}") from error
    if arm.true is None:
        raise InputError(f"{where}: arm '{arm.name}' has no true_… values, so there is no true arm to simulate")
    readers: dict[str, Callable[[_Table], Any]] = {
        "load": lambda t: _load(t, arm),
        "joint_compliance": lambda t: JointCompliance(t.numbers("stiffness", arm.nominal.joints, positive=True)),
        "boom_bending": lambda t: _boom(t, arm),
        "transmission_error": lambda t: _transmission(t, arm),
        "measurement_noise": lambda t: MeasurementNoise(
            t.number("position_std_mm") * 1e-3, float(np.radians(t.number("attitude_std_deg")))
        ),
    }
    parts = {key: read(_Table(content[key], key, where, KEYS[key])) for key, read in readers.items() if key in content}
    if "joint_compliance" in parts and "load" not in parts:
        raise InputError(f"{where}: joint_compliance needs [load], the masses that gravity pulls at")
    return Plant(name=str(content.get("name", Path(where).stem)), arm=arm, geometry=arm.true, **parts)


class _Table:
    """A TOML table that reads non-negative finite numbers and says which one is wrong."""

    def __init__(self, table: Any, name: str, where: str, keys: Iterable[str]) -> None:
        if not isinstance(table, Mapping):
            raise InputError(f"{where}: [{name}] must be a table")
        refuse_unknown(table, keys, where, f"[{name}]")
        self.table, self.name, self.where = table, name, where

    def fail(self, key: str, wanted: str) -> InputError:
        given = repr(self.table[key]) if key in self.table else "missing"
        return InputError(f"{self.where}: {key} of [{self.name}] is {given}; give {wanted}")

    def number(self, key: str, *, positive: bool = False, signed: bool = False, default: float | None = None) -> float:
        value = self.table.get(key, default)
        if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
            raise self.fail(key, "a finite number")
        if not signed and (value < 0 or (positive and value == 0)):
            raise self.fail(key, "a number above zero" if positive else "a number that is not negative")
        return float(value)

    def numbers(self, key: str, count: int, *, positive: bool = False, signed: bool = False) -> tuple[float, ...]:
        values = self.table.get(key)
        if not isinstance(values, list) or len(values) != count:
            raise self.fail(key, f"{count} numbers")
        for value in values:
            _Table({key: value}, self.name, self.where, (key,)).number(key, positive=positive, signed=signed)
        return tuple(float(value) for value in values)


def _load(table: _Table, arm: Arm) -> Load:
    n = arm.nominal.joints
    centres = table.table.get("centre_mm")
    if not isinstance(centres, list) or len(centres) != n:
        raise table.fail("centre_mm", f"{n} points of three numbers")
    points = [
        _Table({"centre_mm": c}, "load", table.where, ("centre_mm",)).numbers("centre_mm", 3, signed=True)
        for c in centres
    ]
    return Load(
        mass=table.numbers("mass_kg", n),
        centre=tuple((x * 1e-3, y * 1e-3, z * 1e-3) for x, y, z in points),
        payload=table.number("payload_kg", default=0.0),
    )


def _joint_index(table: _Table, arm: Arm) -> int:
    value = table.number("joint", positive=True)
    if value != int(value) or value > arm.nominal.joints:
        raise table.fail("joint", f"a joint number from 1 to {arm.nominal.joints}")
    return int(value) - 1


def _boom(table: _Table, arm: Arm) -> BoomBending:
    joint = _joint_index(table, arm)
    if not arm.nominal.prismatic[joint]:
        raise table.fail("joint", f"a prismatic joint: joint {joint + 1} of {arm.name} is revolute")
    return BoomBending(
        joint=joint,
        length=table.number("length_mm") * 1e-3,
        flexural_rigidity=table.number("flexural_rigidity_N_m2", positive=True),
        end_mass=table.number("end_mass_kg"),
        mass_per_length=table.number("mass_per_length_kg_per_m"),
    )


def _transmission(table: _Table, arm: Arm) -> TransmissionError:
    harmonics = []
    entries = table.table.get("harmonics", [])
    if not isinstance(entries, list):
        raise table.fail("harmonics", "a list of tables")
    for entry in entries:
        term = _Table(entry, "transmission_error.harmonics", table.where, HARMONIC_KEYS)
        joint = _joint_index(term, arm)
        if arm.nominal.prismatic[joint]:
            amplitude, period = term.number("amplitude_mm") * 1e-3, term.number("period_mm", positive=True) * 1e-3
        else:
            amplitude = float(np.radians(term.number("amplitude_arcmin") / 60.0))
            period = float(np.radians(term.number("period_deg", positive=True)))
        harmonics.append(Harmonic(joint, amplitude, period, float(np.radians(term.number("phase_deg", signed=True)))))
    lead = table.numbers("lead", arm.nominal.joints, signed=True)
    return TransmissionError(lead, tuple(harmonics))
