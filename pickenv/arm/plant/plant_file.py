"""Plants are TOML files: which arm, and the size and source of each effect. The presets lie in `pickenv/arm/plant/plants`."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import fields
from pathlib import Path
from typing import Annotated, Any

from pickenv.arm.effects.drives import Encoder, Servo
from pickenv.arm.effects.ground import BaseTilt
from pickenv.arm.effects.hysteresis import Backlash, StickBand
from pickenv.arm.effects.settling import Settling
from pickenv.arm.effects.structure import BoomBending, JointCompliance, Load, RollerPlay, TransmissionError
from pickenv.arm.effects.thermal import ThermalGrowth
from pickenv.arm.files.arm import Arm
from pickenv.arm.files.load import load_arm
from pickenv.arm.plant.effect_tables import (
    BacklashTable,
    EncoderTable,
    StickBandTable,
    backlash_of,
    encoder_of,
    stick_band_of,
)
from pickenv.arm.plant.plant import MeasurementNoise, Plant
from pickenv.errors import InputError
from pickenv.texts import is_file, shortened
from pickenv.toml_tables import LINE, Check, Then, read, table

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


@table
class PlantFile:
    """What a plant file holds; see `pickenv.arm.plant.plant.Plant`."""

    arm: Annotated[Arm, Then(_arm, Annotated[str, NAMED])]
    name: Annotated[str, LINE] = ""
    source: str = ""
    load: Load | None = None
    joint_compliance: JointCompliance | None = None
    boom_bending: BoomBending | None = None
    transmission_error: TransmissionError | None = None
    measurement_noise: MeasurementNoise | None = None
    roller_play: RollerPlay | None = None
    backlash: Annotated[Backlash, Then(backlash_of, BacklashTable)] | None = None
    stick_band: Annotated[StickBand, Then(stick_band_of, StickBandTable)] | None = None
    thermal_growth: ThermalGrowth | None = None
    base_tilt: BaseTilt | None = None
    settling: Settling | None = None
    encoder: Annotated[Encoder, Then(encoder_of, EncoderTable)] | None = None
    servo: Servo | None = None

    def __post_init__(self) -> None:
        for effect in ("joint_compliance", "base_tilt"):
            if getattr(self, effect) is not None and self.load is None:
                raise InputError(f"{effect} needs [load], the masses that gravity pulls at")
        if (play := self.roller_play) is not None:
            furthest = float(self.arm.nominal.upper[play.joint])
            if play.overlap <= furthest:
                raise InputError(
                    f"overlap_mm of [roller_play] is {play.overlap * 1e3:g}; give more than the {furthest * 1e3:g} mm "
                    f"that joint {play.joint + 1} runs out"
                )


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
    file = read(PlantFile, path, context={})
    assert file.arm.true is not None, "the reader refuses arms without"
    parts = {field.name: getattr(file, field.name) for field in fields(file) if field.name != "source"}
    try:
        return Plant(geometry=file.arm.true, **parts).without(without)
    except ValueError as error:
        raise InputError(str(error)) from error
