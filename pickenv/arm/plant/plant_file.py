"""Plants are TOML files: which arm, and the size and source of each effect. The presets lie in `plants`.

A calibrated arm's plant is a file of its own kind (`pickenv.arm.plant.twin_file`).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import make_dataclass
from pathlib import Path
from typing import Annotated, Any, get_type_hints

from pickenv.arm.files.arm import Arm
from pickenv.arm.files.load import load_arm
from pickenv.arm.plant.effect_tables import BY_JOINT
from pickenv.arm.plant.plant import EFFECTS, Plant
from pickenv.arm.plant.twin_file import read_twin
from pickenv.errors import InputError
from pickenv.toml_tables import LINE, Check, Then, file_named, read, shipped_in, toml_table

PLANTS = Path(__file__).parent / "plants"

NAMED = Check(lambda value: isinstance(value, str), "the name of a shipped arm or a path to an arm file")


def _arm(name: Any, context: Any) -> Arm:
    """The arm that a file names; what is read after it finds it in the context."""
    arm = load_arm(name)
    if arm.nominal.coupling is not None:
        raise InputError(f"a joint of arm '{arm.name}' moves several links, which no effect of a plant knows yet")
    if arm.true is None:
        raise InputError(f"arm '{arm.name}' has no true_… values, so there is no true arm to simulate")
    context["arm"] = arm
    return arm


PlantFile: Any = toml_table(
    make_dataclass(
        "PlantFile",
        [
            ("arm", Annotated[Arm, Then(_arm, Annotated[str, NAMED])]),
            ("name", Annotated[str, LINE]),
            ("source", str),
            *((effect, BY_JOINT.get(effect, get_type_hints(Plant)[effect]), None) for effect in ("load", *EFFECTS)),
        ],
        frozen=True,
    )
)
"""What a plant file holds."""


def shipped_plants() -> list[str]:
    """Names of the plant presets that come with pickenv."""
    return shipped_in(PLANTS)


def load_plant(name: str | Path, *, without: Iterable[str] = ()) -> Plant:
    """Read a plant by name (a preset) or from a path to a TOML file, or to that of a calibrated arm.

    Args:
        name: A preset's name or a path ending in .toml or .npz.
        without: Effects to switch off.

    Raises:
        InputError: If the plant or an effect is unknown or a number is impossible; names the file and the key.
    """
    if Path(name).suffix == ".npz":
        return _without(read_twin(name), without)
    path = file_named("plant", name, PLANTS, ".toml, .npz")
    parts = dict(vars(read(PlantFile, path, context={})))
    del parts["source"]
    plant = Plant(geometry=parts["arm"].true, **parts)
    for effect in ("joint_compliance", "base_tilt"):
        if parts[effect] is not None and plant.load is None:
            raise InputError(f"{path}: {effect} needs [load], the masses that gravity pulls at")
    if (play := plant.roller_play) is not None and play.overlap <= (limit := plant.arm.nominal.upper[play.joint]):
        raise InputError(
            f"{path}: overlap_mm of [roller_play] is {play.overlap * 1e3:g}; give more than the {limit * 1e3:g} mm "
            f"that joint {play.joint + 1} runs out"
        )
    return _without(plant, without)


def _without(plant: Plant, without: Iterable[str]) -> Plant:
    try:
        return plant.without(without)
    except ValueError as error:
        raise InputError(str(error)) from error
