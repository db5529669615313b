"""Column descriptions: a small TOML file that says how a foreign measurement file is laid out.

It names separator, decimal sign, units, conventions and uncertainties; which section it has says what was measured:
[position] (with [rotation]: poses), [reflectors], [wire], [touches] and so on. Shipped ones lie in `descriptions`.
"""

from __future__ import annotations

import ast
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pickenv.arm import Geometry
from pickenv.calibration.model.measurements import ATTITUDE_STD, POSITION_STD, joint_columns
from pickenv.calibration.reading import description_file
from pickenv.calibration.reading.csv_table import expression_tree
from pickenv.calibration.reading.kind_tables import ANGLES, LENGTHS
from pickenv.errors import InputError
from pickenv.texts import is_file, shortened
from pickenv.toml_tables import TO_SI, read

DESCRIPTIONS = Path(__file__).parent / "descriptions"


MEASURED = ("position_unit", "position_std", "position_std_columns")
"""What a section says in words of its own for any kind."""


@dataclass(frozen=True)
class Condition:
    """A recorded condition: its columns, what turns them into SI, and what is subtracted first."""

    columns: tuple[str, ...]
    scales: tuple[float, ...]
    reference: float = 0.0


@dataclass(frozen=True)
class ColumnDescription:
    """How a foreign file is laid out.

    Attributes:
        where: The description's own file, for messages.
        separator: Character between columns.
        decimal: Decimal sign, "." or ",".
        names: Column names of a file without a header, or None.
        joints: Expressions of the joint columns, in joint order.
        joint_units: Their units.
        kind: What was measured, one of `KINDS`.
        position: Expressions of x, y, z; of all reflectors' x, y, z; of a length or a tilt; or of the socket's number.
        position_unit: mm or m; of a tilt deg, rad or g.
        position_std: Standard uncertainty of a coordinate, of a length, or of a ball's rest, m; of a tilt, rad.
        section: The file's whole section of that kind.
        std_stated: Whether the description says it, or the default is assumed.
        position_std_columns: Columns of the repeat sigma of each coordinate, in the position's unit; may be empty.
        rotation: Expressions of the attitude's columns; empty for positions only.
        convention: Attitude convention, a key of `CONVENTIONS`; None where the description names none.
        rotation_unit: deg or rad.
        attitude_std: Standard uncertainty of an attitude coordinate, rad.
        conditions: Recorded temperature, payload and torques.
        views: The whole file where it is about views of a board.
    """

    where: str
    separator: str
    decimal: str
    names: tuple[str, ...] | None
    joints: tuple[str, ...]
    joint_units: tuple[str, ...]
    kind: str
    position: tuple[str, ...]
    position_unit: str
    position_std: float
    std_stated: bool = False
    position_std_columns: tuple[str, ...] = ()
    rotation: tuple[str, ...] = ()
    convention: str | None = "rotation_vector"
    rotation_unit: str = "rad"
    attitude_std: float = ATTITUDE_STD
    conditions: Mapping[str, Condition] | None = None
    views: description_file.DescriptionFile | None = None
    section: description_file.Section | None = None


def shipped_descriptions() -> list[str]:
    """Names of the column descriptions that come with pickenv."""
    return sorted(path.stem for path in DESCRIPTIONS.glob("*.toml"))


def load_description(name: str | Path) -> ColumnDescription:
    """Read a column description by name (a shipped one) or from a path to a TOML file.

    Raises:
        InputError: If it is unknown or malformed; the message names the file and key.
    """
    path = Path(name)
    if path.suffix != ".toml":
        path = DESCRIPTIONS / f"{name}.toml"
    if not is_file(path):
        given = shortened(name)
        raise InputError(
            f"unknown column description '{given}'; give one of {shipped_descriptions()} or a path (.toml)"
        )
    file = read(description_file.DescriptionFile, path)
    section = file.measured
    own: dict[str, Any] = {key: value for key, value in vars(section).items() if key in MEASURED}
    std = own.pop("position_std", None)
    found = ColumnDescription(
        where=str(path),
        separator=file.separator,
        decimal=file.decimal,
        names=file.names,
        joints=() if file.joints is None else file.joints.columns,
        joint_units=() if file.joints is None else file.joints.each,
        kind=file.kind,
        views=None if file.pixels is None else file,
        **{"position_unit": "mm", **own, "position": section.position},
        position_std=std or POSITION_STD,
        std_stated=std is not None,
        section=section,
        **({} if file.rotation is None else {**vars(file.rotation), "rotation_unit": file.rotation.unit()}),
        conditions=_conditions(file.conditions, () if file.joints is None else file.joints.each),
    )
    _refuse_repeats(found)
    return found


def _conditions(table: description_file.ConditionsTable, joint_units: tuple[str, ...]) -> dict[str, Condition]:
    """Recorded conditions, each with what turns it into SI."""
    found = {}
    if (warmth := table.temperature) is not None:
        usual = 20.0 if warmth.unit == "degC" else 0.0
        found["temperature"] = Condition(
            (warmth.column,), (1.0,), usual if warmth.reference is None else warmth.reference
        )
    if (mass := table.payload) is not None:
        found["payload"] = Condition((mass.column,), (description_file.MASSES[mass.unit],), mass.reference)
    if (torques := table.torques) is not None:
        units = torques.each or tuple("N" if unit in LENGTHS else "N*m" for unit in joint_units)
        found["torque"] = Condition(torques.columns, tuple(description_file.TORQUES[unit] for unit in units))
    return found


def _refuse_repeats(description: ColumnDescription) -> None:
    """A column that stands for two things is a slip: one of them is lost, and the fit need not show it."""
    roles = [(f"joint {i + 1}", text) for i, text in enumerate(description.joints)]
    for section, columns in ((description.kind, description.position), ("rotation", description.rotation)):
        roles += [(f"column {i + 1} of [{section}]", text) for i, text in enumerate(columns)]
    for name, condition in (description.conditions or {}).items():
        roles += [(f"column {i + 1} of [conditions.{name}]", text) for i, text in enumerate(condition.columns)]
    seen: dict[str, str] = {}
    for role, text in roles:
        tree, quoted = expression_tree(text)
        plain = text.strip() if tree is None else ast.dump(tree)
        for i, name in enumerate(quoted):
            plain = plain.replace(f"'__quoted_{i}'", repr(name))
        if plain in seen:
            raise InputError(
                f"{description.where}: '{shortened(text)}' is given for {seen[plain]} and for {role}; "
                "name each column once"
            )
        seen[plain] = role


OWN_CONDITIONS = ("temperature_degC", "payload_kg")
"""Columns of our own CSV format beside joints and poses."""


def own_description(geometry: Geometry, header: list[str], where: str) -> ColumnDescription:
    """The description of our own CSV format, for an arm and a file's header."""
    expected = joint_columns(geometry.prismatic)
    joints, units = [], []
    for name in expected:
        stem = name.rpartition("_")[0]
        found = [column for column in header if column.rpartition("_")[0] == stem]
        if len(found) != 1 or found[0].rpartition("_")[2] not in LENGTHS + ANGLES:
            unit = found[0].rpartition("_")[2] if found else ""
            fault = "is given twice" if len(found) > 1 else f"has the unknown unit '{unit}'" if found else "is missing"
            raise InputError(
                f"{where}: joint column '{name}' {fault}; our format has {', '.join(expected)}, x_mm, y_mm, z_mm"
            )
        joints.append(found[0])
        units.append(found[0].rpartition("_")[2])
    position_unit = "m" if "x_m" in header else "mm"
    has_rotation = any(column.startswith(("rx_", "ry_", "rz_")) for column in header)
    rotation_unit = "rad" if "rx_rad" in header else "deg"
    for column in header:
        if column.lower().startswith(("temp", "payload", "torque")) and column not in OWN_CONDITIONS:
            raise InputError(
                f"{where}: column '{shortened(column)}' is none of our format's, which records "
                f"{' and '.join(OWN_CONDITIONS)}; rename it, describe it in [conditions] (--columns), or remove it"
            )
    conditions = {}
    if "temperature_degC" in header:
        conditions["temperature"] = Condition(("temperature_degC",), (1.0,), 20.0)
    if "payload_kg" in header:
        conditions["payload"] = Condition(("payload_kg",), (1.0,))
    return ColumnDescription(
        where=where,
        separator=",",
        decimal=".",
        names=None,
        joints=tuple(joints),
        joint_units=tuple(units),
        kind="position",
        position=tuple(f"{axis}_{position_unit}" for axis in "xyz"),
        position_unit=position_unit,
        position_std=POSITION_STD,
        rotation=tuple(f"r{axis}_{rotation_unit}" for axis in "xyz") if has_rotation else (),
        rotation_unit=rotation_unit,
        conditions=conditions,
    )


def joint_scales(description: ColumnDescription, geometry: Geometry) -> tuple[float, ...]:
    """Factors that turn the joint columns into rad and m.

    Raises:
        InputError: If the number or the units of the joints are not the arm's.
    """
    n = geometry.joints
    if len(description.joints) != n:
        raise InputError(
            f"{description.where}: {len(description.joints)} joint columns are named, but the arm has {n} joints"
        )
    for i, unit in enumerate(description.joint_units):
        wanted = LENGTHS if geometry.prismatic[i] else ANGLES
        if unit not in wanted:
            kind = "prismatic" if geometry.prismatic[i] else "revolute"
            raise InputError(
                f"{description.where}: joint {i + 1} is {kind}, but its unit is '{unit}'; give {' or '.join(wanted)}"
            )
    return tuple(TO_SI[unit] for unit in description.joint_units)
