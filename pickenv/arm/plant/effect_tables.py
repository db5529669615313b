"""The tables of a plant file whose effects are not laid out as the file is: entries by joint, in the joint's unit.

The other effects say the keys and units of their tables themselves.
"""

from __future__ import annotations

from typing import Annotated, Any

from pickenv.arm.effects.drives import Encoder
from pickenv.arm.effects.hysteresis import Backlash, StickBand
from pickenv.arm.files.joint_keys import ByJoint, number_per_joint
from pickenv.errors import InputError
from pickenv.toml_tables import ARCMIN, ARCSEC, MM, NEWTON, NEWTON_METRE, NUMBER, UM, Then, toml_table

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
