"""Plants are TOML files: which arm, and the size and source of each effect. The presets lie in `plants`.

A calibrated arm's plant is a file of its own kind (`pickenv.arm.plant.twin_file`).
"""

from __future__ import annotations

from dataclasses import make_dataclass
from pathlib import Path
from typing import Annotated, Any, get_type_hints

from pickenv.arm.effects.own_waves import OWN_WAVES
from pickenv.arm.files.arm import Arm
from pickenv.arm.files.load import load_arm
from pickenv.arm.plant.effect_tables import BY_JOINT
from pickenv.arm.plant.plant import EFFECTS, NEED_LOAD, Plant
from pickenv.arm.plant.twin_file import read_twin
from pickenv.errors import InputError
from pickenv.toml_tables import LINE, Check, Then, file_named, read, shipped_in, toml_table

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


LAID_OUT = BY_JOINT | OWN_WAVES

PlantFile: Any = toml_table(
    make_dataclass(
        "PlantFile",
        [
            ("arm", Annotated[Arm, Then(_arm, Annotated[str, NAMED])]),
            ("name", Annotated[str, LINE]),
            ("source", str),
            *((effect, LAID_OUT.get(effect, get_type_hints(Plant)[effect]), None) for effect in ("load", *EFFECTS)),
        ],
        frozen=True,
    )
)
"""What a plant file holds."""


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
    parts = dict(vars(read(PlantFile, path, context={})))
    del parts["source"]
    arm = parts["arm"]
    plant = Plant(geometry=arm.nominal if arm.true is None else arm.true, **parts)
    for effect in NEED_LOAD:
        if parts[effect] is not None and plant.load is None:
            raise InputError(f"{path}: {effect} needs [load], the masses that gravity pulls at")
    if (play := plant.roller_play) is not None and play.overlap <= (limit := plant.arm.nominal.upper[play.joint]):
        raise InputError(
            f"{path}: overlap_mm of [roller_play] is {play.overlap * 1e3:g}; give more than the {limit * 1e3:g} mm "
            f"that joint {play.joint + 1} runs out"
        )
    if plant.slide_compliance is not None:
        for bearing in plant.slide_compliance.bearings:
            limit = plant.arm.nominal.upper[bearing.joint]
            if bearing.overhang is not None and bearing.span <= limit:
                raise InputError(
                    f"{path}: span_mm of joint {bearing.joint + 1} in [slide_compliance] is {bearing.span * 1e3:g}; "
                    f"give more than the {limit * 1e3:g} mm that it runs out"
                )
    return plant
