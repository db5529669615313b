"""Plants are TOML files: which arm, and the size and source of each effect. The presets lie in `plants`."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from pickenv.arm.files.arm_file import Arm, load_arm, refuse_unknown, shipped_arms, word
from pickenv.arm.files.tables import Table
from pickenv.arm.plant.effect_tables import READERS
from pickenv.arm.plant.plant import EFFECTS, MeasurementNoise, Plant
from pickenv.errors import InputError
from pickenv.texts import is_file, read_toml, shortened

PLANTS = Path(__file__).parent / "plants"

NEED_LOAD = ("joint_compliance", "base_tilt")


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
    if not is_file(path):
        raise InputError(
            f"unknown plant '{shortened(name)}'; give one of {shipped_plants()} or a path to a plant file (.toml)"
        )
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
    if arm.nominal.coupling is not None:
        raise InputError(
            f"{where}: a joint of arm '{arm.name}' moves several links, which no effect of a plant knows yet"
        )
    if arm.true is None:
        raise InputError(f"{where}: arm '{arm.name}' has no true_… values, so there is no true arm to simulate")
    readers = {**READERS, "measurement_noise": (_noise, ("position_std_mm", "attitude_std_deg"))}
    parts = {
        key: read(Table(content[key], key, where, keys), arm) for key, (read, keys) in readers.items() if key in content
    }
    for effect in NEED_LOAD:
        if effect in parts and "load" not in parts:
            raise InputError(f"{where}: {effect} needs [load], the masses that gravity pulls at")
    return Plant(name=word(content, "name", Path(where).stem, where), arm=arm, geometry=arm.true, **parts)


def _noise(table: Table, _arm: Arm) -> MeasurementNoise:
    return MeasurementNoise(table.number("position_std_mm") * 1e-3, math.radians(table.number("attitude_std_deg")))
