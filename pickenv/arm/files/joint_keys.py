"""Joints in plant files: numbered from 1, lists with one number per joint, and sizes in the joint's own unit.

Checks find the arm under the key ``arm`` of the context, a mapping, with which a plant file is read.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import make_dataclass
from typing import Annotated, Any, cast

from pickenv.arm.files.arm import Arm
from pickenv.base import ARCMIN, DEG, MM, WHOLE, InputError, Kinds, Then, Unit, fault, toml_table


def arm_in(context: Mapping[str, Any] | None) -> Arm | None:
    """The arm of the plant file that is being read; None where no plant file is read or it names no arm."""
    return (context or {}).get("arm")


def _per_joint(values: Any, context: Any) -> Any:
    if (arm := arm_in(context)) is not None and len(values) != arm.nominal.joints:
        raise fault(f"{arm.nominal.joints} entries, one per joint")
    return values


PER_JOINT = Then(_per_joint)
"""Annotates a list that must have as many entries as the arm has joints."""


def joint_index(number: int, context: Any) -> int:
    """The index, from 0, of the arm's joint with this number, from 1."""
    if (arm := arm_in(context)) is not None and not 1 <= number <= arm.nominal.joints:
        raise fault(f"a joint number from 1 to {arm.nominal.joints}")
    return number - 1


def _boom(number: int, context: Any) -> int:
    index, arm = joint_index(number, context), arm_in(context)
    if arm is not None and not arm.nominal.prismatic[index]:
        raise fault(f"a prismatic joint: joint {number} of {arm.name} is revolute")
    return index


BOOM = Then(_boom)
"""Annotates the number of a prismatic joint, which becomes its index from 0."""


TRAVEL = (ARCMIN.not_negative, MM.not_negative)
"""Units of lost motion or error of a joint that turns, and of one that slides."""

LENGTH = (DEG.positive, MM.positive)
"""Units of a period or a length scale of a joint that turns, and of one that slides."""


def numbers_per_joint(table: Any, context: Any, *keys: str) -> tuple[tuple[float, ...], ...]:
    """One number per joint for each key, from the entries of a table; zero for joints that no entry names."""
    entries: dict[int, Any] = {}
    for entry in table.joints:
        if entry.joint in entries:
            raise InputError(f"joint {entry.joint + 1} has two entries in one table; give each joint once")
        entries[entry.joint] = entry
    joints = () if (arm := arm_in(context)) is None else range(arm.nominal.joints)
    return tuple(tuple(getattr(entries.get(joint), key, 0.0) for joint in joints) for key in keys)


class Entry(dict[str, Any]):
    """An entry of a list of tables, which knows whether the joint that it names slides."""

    slides = False


class ByJoint:
    """Annotates a list of tables of ``joint`` and sizes; a size has one unit for revolute, one for prismatic joints."""

    def __init__(self, **units: tuple[Unit, Unit]) -> None:
        self.units = units

    def __get_pydantic_core_schema__(self, _source: Any, handler: Any) -> Any:
        """The schema of a list of two kinds of tables; the joint tells them apart, or the keys where it is unknown."""
        from pydantic_core import core_schema as core

        kinds = []
        for slides, name in enumerate(("Turning", "Sliding")):
            sizes = [(size, Annotated[float, pair[slides]]) for size, pair in self.units.items()]
            members = [("joint", Annotated[int, WHOLE, Then(joint_index)]), *sizes]
            kinds.append(toml_table(make_dataclass(name, members, frozen=True)))
        sliding = {f"{size}_{slide.name}" for size, (turn, slide) in self.units.items() if turn.name != slide.name}

        def placed(value: Any, info: Any) -> Any:
            if not isinstance(value, Mapping):
                return value
            entry, arm, number = Entry(value), arm_in(info.context), value.get("joint")
            entry.slides = bool(entry.keys() & sliding)
            if arm is not None and isinstance(number, int) and 1 <= number <= arm.nominal.joints:
                entry.slides = arm.nominal.prismatic[number - 1]
            return entry

        union: Any = cast(Any, kinds[0]) | kinds[1]
        schema = handler.generate_schema(Annotated[union, Kinds(lambda entry: kinds[getattr(entry, "slides", 0)])])
        return core.tuple_variable_schema(core.with_info_before_validator_function(placed, schema))


def joint_table(make: Callable[..., Any], **sizes: tuple[Unit, Unit] | Unit) -> Any:
    """The type of a table of sizes by joint and of single numbers; whatever is left out is zero.

    Args:
        make: Makes the effect; it gets a tuple with one number per joint for each size by joint, then each single
            number.
        sizes: Units by name: two for a size by joint (revolute, prismatic), one for a single number.
    """
    pairs = {name: unit for name, unit in sizes.items() if isinstance(unit, tuple)}
    singles = {name: unit for name, unit in sizes.items() if isinstance(unit, Unit)}
    members: list[Any] = [("joints", Annotated[tuple[Any, ...], ByJoint(**pairs)], ())]
    members += [(name, Annotated[float, unit], 0.0) for name, unit in singles.items()]

    def effect(table: Any, context: Any) -> Any:
        return make(*numbers_per_joint(table, context, *pairs), *(getattr(table, name) for name in singles))

    return Annotated[Any, Then(effect, toml_table(make_dataclass("JointTable", members, frozen=True)))]
