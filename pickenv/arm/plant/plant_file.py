"""Plants are TOML files: which arm, and the size and source of each effect. The presets lie in `plants`.

A calibrated arm's plant is a file of its own kind (`pickenv.arm.plant.twin_file`).
"""

from __future__ import annotations

from dataclasses import make_dataclass
from functools import cache
from pathlib import Path
from typing import Annotated, Any

from pickenv.arm.effects.effect import Load, table_of
from pickenv.arm.files.arm import Arm
from pickenv.arm.files.load import load_arm
from pickenv.arm.plant.plant import Plant
from pickenv.arm.plant.twin_file import read_twin
from pickenv.base import LINE, Check, InputError, Then, file_named, read_toml, registry, shipped_in, toml_of, toml_table

PLANTS = Path(__file__).parent / "plants"

NAMED = Check(lambda value: isinstance(value, str), "the name of a shipped arm or a path to an arm file")


def _arm(name: Any, context: Any) -> Arm:
    """The arm that a file names; what is read after it finds it in the context."""
    context["arm"] = arm = one_link_per_joint(load_arm(name))
    return arm


def one_link_per_joint(arm: Arm) -> Arm:
    """The arm, if each of its joints moves one link.

    Raises:
        InputError: If one moves several.
    """
    if arm.nominal.coupling is not None:
        raise InputError(f"a joint of arm '{arm.name}' moves several links, which no effect of a plant knows yet")
    return arm


@cache
def plant_file(effects: tuple[str, ...]) -> Any:
    """What a plant file holds that may have tables of these effects.

    Raises:
        InputError: If one of them is not registered, or cannot be loaded.
    """
    tables = {name: table_of(name) for name in effects}
    optional = {"load": Load} | {name: table for name, table in tables.items() if table is not None}
    members: list[Any] = [
        ("arm", Annotated[Arm, Then(_arm, Annotated[str, NAMED])]),
        ("name", Annotated[str, LINE]),
        ("source", str),
        *((key, table | None if isinstance(table, type) else table, None) for key, table in optional.items()),
    ]
    return toml_table(make_dataclass("PlantFile", members, frozen=True))


def shipped_effects() -> tuple[str, ...]:
    """The names of the effects that come with pickenv."""
    return tuple(name for name in registry.names("effect") if registry.origin("effect", name).package == "pickenv")


def shipped_plants() -> list[str]:
    """Names of the plant presets that come with pickenv."""
    return shipped_in(PLANTS)


def read_plant(name: str | Path) -> Plant:
    """Read a plant by name (a preset) or from a path to a TOML file, or to that of a calibrated arm (.npz).

    The true arm of a TOML file is its arm file's, or the nominal one where that gives none.

    Raises:
        InputError: If the plant is unknown or a number is impossible; names the file and the key.
    """
    if Path(name).suffix == ".npz":
        return read_twin(name)
    path = file_named("plant", name, PLANTS, ".toml, .npz")
    others = tuple(name for name in registry.names("effect") if name in toml_of(path)[0])
    parts = dict(vars(read_toml(plant_file(tuple(dict.fromkeys((*shipped_effects(), *others)))), path, context={})))
    del parts["source"]
    arm, called, load = (parts.pop(key) for key in ("arm", "name", "load"))
    effects = tuple(effect for effect in parts.values() if effect is not None)
    for effect in effects:
        if effect.needs_load and load is None:
            raise InputError(f"{path}: {effect.name} needs [load], the masses that gravity pulls at")
        if fault := effect.fault(arm):
            raise InputError(f"{path}: {fault}")
    return Plant(called, arm, arm.nominal if arm.true is None else arm.true, load, effects)
