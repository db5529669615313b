"""Types of the joint entries in plant files: joint numbers from 1, lists with one number per joint, sizes by joint.

A size by joint has one unit for revolute joints and another for prismatic joints. While a plant file is read, a mapping
called the context is passed on; it holds the arm under the key ``arm``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import make_dataclass
from typing import Annotated, Any, cast

from pickenv.arm.files.arm import arm_in
from pickenv.base import ARCMIN, DEG, MM, WHOLE, InputError, Kinds, Then, Unit, fault, toml_table


def joint_index(number: int, context: Any) -> int:
    """Convert a joint number (from 1) to an index (from 0); refuse a number that the arm in ``context`` lacks.

    ``context`` is the mapping that is passed on while a plant file is read; it holds the arm under the key ``arm``.
    """
    if (arm := arm_in(context)) is not None and not 1 <= number <= arm.nominal.joints:
        raise fault(f"a joint number from 1 to {arm.nominal.joints}")
    return number - 1


def _boom(number: int, context: Any) -> int:
    index, arm = joint_index(number, context), arm_in(context)
    if arm is not None and not arm.nominal.prismatic[index]:
        raise fault(f"a prismatic joint: joint {number} of {arm.name} is revolute")
    return index


BOOM = Then(_boom)
"""Annotation of the number, from 1, of a prismatic joint; reading converts it to an index from 0."""


TRAVEL = (ARCMIN.not_negative, MM.not_negative)
"""Units of backlash, lag or error of a revolute joint, and of a prismatic joint."""

LENGTH = (DEG.positive, MM.positive)
"""Units of a period or a length scale of a revolute joint, and of a prismatic joint."""


def numbers_per_joint(table: Any, context: Any, *keys: str) -> tuple[tuple[float, ...], ...]:
    """Return for each key a tuple with one number per joint.

    Args:
        table: A table whose attribute ``joints`` is a list of entries, each for one joint with the index ``joint``.
        context: Context of the plant file that is being read; it holds the arm.
        keys: Names of the sizes in the entries. The number of a joint without an entry is 0.

    Raises:
        InputError: If a joint has two entries.
    """
    entries: dict[int, Any] = {}
    for entry in table.joints:
        if entry.joint in entries:
            raise InputError(f"joint {entry.joint + 1} has two entries in one table; give each joint once")
        entries[entry.joint] = entry
    joints = () if (arm := arm_in(context)) is None else range(arm.nominal.joints)
    return tuple(tuple(getattr(entries.get(joint), key, 0.0) for joint in joints) for key in keys)


class Entry(dict[str, Any]):
    """One table of a list that has a table per joint; ``slides`` says whether the table's joint is prismatic."""

    slides = False


class ByJoint:
    """Annotation of a list of tables, each with a ``joint`` number and sizes.

    The arguments are the sizes by name, each with two units: that of revolute joints and that of prismatic joints.
    """

    def __init__(self, **units: tuple[Unit, Unit]) -> None:
        self.units = units

    def __get_pydantic_core_schema__(self, _source: Any, handler: Any) -> Any:
        """Return the pydantic schema of the list.

        The type of an entry's joint decides the entry's units. If the joint is unknown, the units in the keys decide.
        """
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
    """Return the type of an effect's table with sizes by joint and with single numbers; missing values are zero.

    Args:
        make: Function that returns the effect. It takes one tuple of n numbers, one per joint, for each size by joint.
            The single numbers are its last arguments.
        sizes: Units by name: a pair (revolute, prismatic) for a size by joint, one unit for a single number.
    """
    pairs = {name: unit for name, unit in sizes.items() if isinstance(unit, tuple)}
    singles = {name: unit for name, unit in sizes.items() if isinstance(unit, Unit)}
    members: list[Any] = [("joints", Annotated[tuple[Any, ...], ByJoint(**pairs)], ())]
    members += [(name, Annotated[float, unit], 0.0) for name, unit in singles.items()]

    def effect(table: Any, context: Any) -> Any:
        return make(*numbers_per_joint(table, context, *pairs), *(getattr(table, name) for name in singles))

    return Annotated[Any, Then(effect, toml_table(make_dataclass("JointTable", members, frozen=True)))]
