"""Plants are TOML files: which arm, and the size and source of each effect. The presets lie in `plants`.

A calibrated arm's plant is a file of its own kind (`pickenv.arm.plant.twin_file`).
"""

from __future__ import annotations

from dataclasses import make_dataclass
from pathlib import Path
from typing import Annotated, Any, get_type_hints

from pickenv.arm.effects.drives import Encoder
from pickenv.arm.effects.hysteresis import Backlash, StickBand
from pickenv.arm.effects.residual_field import OWN_WAVES
from pickenv.arm.files.arm import Arm
from pickenv.arm.files.joint_keys import ByJoint, number_per_joint
from pickenv.arm.files.load import load_arm
from pickenv.arm.plant.plant import EFFECTS, NEED_LOAD, Plant
from pickenv.arm.plant.twin_file import read_twin
from pickenv.errors import InputError
from pickenv.toml_tables import (
    ARCMIN,
    ARCSEC,
    LINE,
    MM,
    NEWTON,
    NEWTON_METRE,
    NUMBER,
    UM,
    Check,
    Then,
    file_named,
    read,
    shipped_in,
    toml_table,
)

# The tables of a plant file whose effects are not laid out as the file is: entries by joint, in the joint's unit. The
# other effects say the keys and units of their tables themselves.


TRAVEL = (ARCMIN.not_negative, MM.not_negative)


@toml_table
class BacklashTable:
    """Gaps; joints left out have none."""

    joints: Annotated[
        tuple[Any, ...], ByJoint(width=TRAVEL, preload=(NEWTON_METRE.not_negative, NEWTON.not_negative))
    ] = ()


@toml_table
class StickBandTable:
    """Friction bands; joints left out have none."""

    joints: Annotated[tuple[Any, ...], ByJoint(forward=TRAVEL, backward=TRAVEL)] = ()
    scatter: Annotated[float, NUMBER.not_negative] = 0.0


@toml_table
class EncoderTable:
    """Counts; every joint has an encoder."""

    joints: Annotated[tuple[Any, ...], ByJoint(resolution=(ARCSEC.positive, UM.positive))]


def backlash_of(table: BacklashTable, context: Any) -> Backlash:
    """The effect of an arm."""
    return Backlash(number_per_joint(table, "width", context), number_per_joint(table, "preload", context))


def stick_band_of(table: StickBandTable, context: Any) -> StickBand:
    """The effect of an arm."""
    forward, backward = (number_per_joint(table, side, context) for side in ("forward", "backward"))
    return StickBand(forward, backward, table.scatter)


def encoder_of(table: EncoderTable, context: Any) -> Encoder:
    """The effect of an arm."""
    resolution = number_per_joint(table, "resolution", context)
    if 0.0 in resolution:
        raise InputError(f"joints of [encoder] does not name joint {resolution.index(0.0) + 1}; give each joint")
    return Encoder(resolution)


BY_JOINT = {
    "backlash": Annotated[Any, Then(backlash_of, BacklashTable)],
    "stick_band": Annotated[Any, Then(stick_band_of, StickBandTable)],
    "encoder": Annotated[Any, Then(encoder_of, EncoderTable)],
}
"""By effect: what a plant file holds, and what is made of it."""


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
