"""How plant files speak of joints: by number from 1, one number per joint in lists, sizes in the unit of the joint.

What is checked against the arm finds it in the context that a plant file is read with: a mapping with ``arm``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import make_dataclass
from typing import Annotated, Any

from pickenv.arm.files.arm import Arm
from pickenv.toml_tables import WHOLE, Kinds, Then, Unit, fault, table


def arm_in(context: Mapping[str, Any] | None) -> Arm | None:
    """The arm of the plant file that is being read; None outside of one, and where the file names none."""
    return (context or {}).get("arm")


def _per_joint(values: Any, context: Any) -> Any:
    arm = arm_in(context)
    if arm is not None and len(values) != arm.nominal.joints:
        raise fault(f"{arm.nominal.joints} entries, one per joint")
    return values


PER_JOINT = Then(_per_joint)
"""As many entries as the arm has joints."""


def joint_number(slides: bool | None = None, instead: str = "") -> Then:
    """A joint's number, which becomes its index from 0; ``slides`` asks for prismatic joints, or for revolute ones."""

    def index(number: int, context: Any) -> int:
        arm = arm_in(context)
        if arm is not None and not 1 <= number <= arm.nominal.joints:
            raise fault(f"a joint number from 1 to {arm.nominal.joints}")
        if arm is not None and slides is not None and arm.nominal.prismatic[number - 1] != slides:
            asked, found = ("prismatic", "revolute") if slides else ("revolute", "prismatic")
            raise fault(f"a {asked} joint{instead}: joint {number} of {arm.name} is {found}")
        return number - 1

    return Then(index)


BOOM = joint_number(slides=True)
"""The number of a prismatic joint."""


class ByJoint:
    """A list of tables with ``joint`` and sizes, each in a unit for revolute and in another for prismatic joints."""

    def __init__(self, **units: tuple[Unit, Unit]) -> None:
        self.units = units

    def __get_pydantic_core_schema__(self, _source: Any, handler: Any) -> Any:
        """A list of two kinds of tables, told apart by their keys."""
        keys = [[f"{size}_{pair[slides].name}" for size, pair in self.units.items()] for slides in (False, True)]
        kinds: Any = [
            table(
                make_dataclass(
                    "Sliding" if slides else "Turning",
                    [
                        ("joint", Annotated[int, WHOLE, joint_number(slides, f", or {', '.join(keys[not slides])}")]),
                        *((size, Annotated[float, pair[slides]]) for size, pair in self.units.items()),
                    ],
                    frozen=True,
                )
            )
            for slides in (False, True)
        ]

        def tell(entry: Mapping[str, Any]) -> type:
            return kinds[len(entry.keys() & set(keys[1])) > len(entry.keys() & set(keys[0]))]  # type: ignore[no-any-return]

        return handler.generate_schema(tuple[Annotated[kinds[0] | kinds[1], Kinds(tell)], ...])
