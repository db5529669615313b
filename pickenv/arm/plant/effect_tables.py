"""The tables of a plant file whose effects are not laid out as the file is: entries by joint, in the joint's unit.

The other effects say the keys and units of their tables themselves.
"""

from __future__ import annotations

from typing import Annotated, Any

from pickenv.arm.effects.drives import Encoder
from pickenv.arm.effects.hysteresis import Backlash, StickBand
from pickenv.arm.files.joint_keys import ByJoint, arm_in
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
    return Backlash(_per_joint(table, "width", context), _per_joint(table, "preload", context))


def stick_band_of(table: StickBandTable, context: Any) -> StickBand:
    """The effect of an arm."""
    forward, backward = (_per_joint(table, side, context) for side in ("forward", "backward"))
    return StickBand(forward, backward, table.scatter)


def encoder_of(table: EncoderTable, context: Any) -> Encoder:
    """The effect of an arm."""
    resolution = _per_joint(table, "resolution", context)
    if 0.0 in resolution:
        raise InputError(f"joints of [encoder] does not name joint {resolution.index(0.0) + 1}; give each joint")
    return Encoder(resolution)


def _per_joint(table: Any, key: str, context: Any) -> tuple[float, ...]:
    """One number per joint from the entries of a table, zero for joints that none names."""
    found: dict[int, float] = {}
    for entry in table.joints:
        if entry.joint in found:
            raise InputError(f"joint {entry.joint + 1} has two entries in one table; give each joint once")
        found[entry.joint] = getattr(entry, key)
    arm = arm_in(context)
    return () if arm is None else tuple(found.get(joint, 0.0) for joint in range(arm.nominal.joints))


BY_JOINT = {
    "backlash": Annotated[Any, Then(backlash_of, BacklashTable)],
    "stick_band": Annotated[Any, Then(stick_band_of, StickBandTable)],
    "encoder": Annotated[Any, Then(encoder_of, EncoderTable)],
}
"""By effect: what a plant file holds, and what is made of it."""
