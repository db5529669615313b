"""Column descriptions: a small TOML file that says how a foreign measurement file is laid out.

It names separator, decimal sign, units, conventions and uncertainties; which section it has says what was measured:
[position] (with [rotation]: poses), [reflectors], [distance] or [sockets]. Shipped ones lie in `descriptions`.
"""

from __future__ import annotations

import ast
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pickenv.arm import Geometry
from pickenv.arm.files.arm_file import TO_SI
from pickenv.arm.files.plausible import largest
from pickenv.calibration.model.measurements import ATTITUDE_STD, POSITION_STD, joint_columns
from pickenv.calibration.reading.conventions import CONVENTIONS
from pickenv.calibration.reading.csv_table import expression_tree
from pickenv.errors import InputError
from pickenv.texts import is_file, read_toml, shortened

DESCRIPTIONS = Path(__file__).parent / "descriptions"
LENGTHS, ANGLES = ("mm", "m"), ("deg", "rad")
KINDS = ("position", "reflectors", "distance", "sockets")
LOST = ("zeros", "empty")
TOP = {"description", "separator", "decimal", "names", "joints", "rotation", "conditions", *KINDS}


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
        position: Expressions of x, y, z; of all reflectors' x, y, z; of the length; or of the socket's number.
        position_unit: mm or m.
        position_std: Standard uncertainty of a coordinate, of a length, or of a ball's rest, m.
        std_stated: Whether the description says it, or the default is assumed.
        position_std_columns: Columns of the repeat sigma of each coordinate, in the position's unit; may be empty.
        rotation: Expressions of the attitude's columns; empty for positions only.
        convention: Attitude convention, a key of `CONVENTIONS`; None where the description names none.
        rotation_unit: deg or rad.
        attitude_std: Standard uncertainty of an attitude coordinate, rad.
        lost: How lost reflectors are marked, of `LOST`.
        spacing: Known distance of the two sockets of a pair, m; None where it is not known.
        spacing_std: Its standard uncertainty, m.
        conditions: Recorded temperature, payload and torques.
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
    lost: tuple[str, ...] = ()
    spacing: float | None = None
    spacing_std: float = 5e-5
    conditions: Mapping[str, Condition] | None = None


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
    return parse_description(read_toml(path), str(path))


def parse_description(content: Mapping[str, Any], where: str) -> ColumnDescription:
    """Turn the parsed content of a description into a `ColumnDescription`; ``where`` names the file in messages."""
    _known(content, TOP, "", where)
    joints = _section(content, "joints", where)
    _known(joints, {"columns", "unit", "units"}, "joints", where)
    expressions = _strings(joints, "columns", where)
    units = _strings(joints, "units", where) if "units" in joints else (joints.get("unit"),) * len(expressions)
    if len(units) != len(expressions):
        raise InputError(f"{where}: [joints] has {len(expressions)} columns but {len(units)} units; give one per joint")
    for unit in units:
        _unit(unit, LENGTHS + ANGLES, "joints", where)
    separator, decimal = content.get("separator", ","), content.get("decimal", ".")
    fit = isinstance(separator, str) and len(separator) == 1 and (separator == "\t" or separator.isprintable())
    if not fit or separator in '"+-.' or separator.isalnum():
        given = shortened(repr(separator))
        raise InputError(f"{where}: separator is {given}; give one character, such as ',' or ';' or '\\t'")
    if decimal not in (".", ",") or decimal == separator:
        raise InputError(f"{where}: decimal is {shortened(repr(decimal))}; give '.' or ',', and not the separator")
    kinds = [kind for kind in KINDS if kind in content]
    if len(kinds) > 1:
        raise InputError(f"{where}: sections [{kinds[0]}] and [{kinds[1]}] are both given; one file holds one kind")
    kind = kinds[0] if kinds else "position"
    found = ColumnDescription(
        where=where,
        separator=separator,
        decimal=decimal,
        names=_strings(content, "names", where) if "names" in content else None,
        joints=expressions,
        joint_units=tuple(str(unit) for unit in units),
        kind=kind,
        **_measured(kind, _section(content, kind, where), where),
        **_rotation(content, kind, where),
        conditions=_conditions(content, units, where),
    )
    _refuse_repeats(found)
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


def _measured(kind: str, section: Mapping[str, Any], where: str) -> dict[str, Any]:
    """What the section of a kind says."""
    if kind == "sockets":
        _known(section, {"column", "std_mm", "spacing_mm", "spacing_std_mm"}, kind, where)
        column = section.get("column")
        if column is not None and not isinstance(column, str):
            raise InputError(f"{where}: column of [sockets] must name the column that numbers the sockets")
        return {
            "position": () if column is None else (column,),
            "position_unit": "mm",
            "position_std": _uncertainty(section, "std_mm", where) * 1e-3 if "std_mm" in section else 1e-4,
            "spacing": _uncertainty(section, "spacing_mm", where) * 1e-3 if "spacing_mm" in section else None,
            "spacing_std": _uncertainty(section, "spacing_std_mm", where) * 1e-3
            if "spacing_std_mm" in section
            else 5e-5,
        }
    allowed = {"columns", "unit", "std_mm", "std_columns"} | ({"lost"} if kind == "reflectors" else set())
    _known(section, allowed, kind, where)
    columns = _strings(section, "columns", where)
    if kind == "position" and len(columns) != 3:
        raise InputError(f"{where}: [position] needs three columns, x, y and z")
    if kind == "reflectors" and (len(columns) % 3 or len(columns) < 3):
        raise InputError(f"{where}: [reflectors] needs three columns per reflector, x, y and z of each in turn")
    if kind == "distance" and len(columns) != 1:
        raise InputError(f"{where}: [distance] needs one column, the length")
    lost = section.get("lost", [])
    lost = [lost] if isinstance(lost, str) else lost
    if not isinstance(lost, list) or any(mark not in LOST for mark in lost):
        raise InputError(
            f"{where}: lost is {shortened(repr(lost))}; give how lost reflectors are marked, of {', '.join(LOST)}"
        )
    std_columns = _strings(section, "std_columns", where) if "std_columns" in section else ()
    if std_columns and len(std_columns) != len(columns):
        raise InputError(
            f"{where}: [{kind}] has {len(columns)} columns but {len(std_columns)} std_columns; give one each"
        )
    return {
        "position": columns,
        "position_unit": _unit(section.get("unit"), LENGTHS, kind, where),
        "position_std": _uncertainty(section, "std_mm", where) * 1e-3 if "std_mm" in section else POSITION_STD,
        "std_stated": "std_mm" in section,
        "position_std_columns": std_columns,
        "lost": tuple(lost),
    }


def _rotation(content: Mapping[str, Any], kind: str, where: str) -> dict[str, Any]:
    """What [rotation] says; a convention that is not named stays None, and is asked for when the file is read."""
    if "rotation" not in content:
        return {}
    if kind != "position":
        raise InputError(f"{where}: [rotation] belongs to [position], not to [{kind}]")
    rotation = _section(content, "rotation", where)
    _known(rotation, {"columns", "unit", "convention", "std_deg"}, "rotation", where)
    convention = rotation.get("convention")
    if convention is not None and convention not in tuple(CONVENTIONS):
        raise InputError(
            f"{where}: [rotation] has convention {shortened(repr(convention))}; name one of {', '.join(CONVENTIONS)}"
        )
    columns = _strings(rotation, "columns", where)
    if convention is None and len(columns) not in (3, 4):
        raise InputError(f"{where}: [rotation] has {len(columns)} columns; give three angles or four of a quaternion")
    angles = len(columns) == 3 if convention is None else CONVENTIONS[str(convention)][0] == "angle"
    return {
        "rotation": columns,
        "convention": convention,
        "rotation_unit": _unit(rotation.get("unit"), ANGLES, "rotation", where) if angles else "rad",
        "attitude_std": float(np.radians(_uncertainty(rotation, "std_deg", where)))
        if "std_deg" in rotation
        else ATTITUDE_STD,
    }


def _conditions(content: Mapping[str, Any], joint_units: tuple[Any, ...], where: str) -> dict[str, Condition]:
    """[conditions]: temperature, payload and torques, each with its unit."""
    if "conditions" not in content:
        return {}
    section, found = _section(content, "conditions", where), {}
    _known(section, {"temperature", "payload", "torques"}, "conditions", where)
    units = {"temperature": {"degC": 1.0, "K": 1.0}, "payload": {"kg": 1.0, "g": 1e-3}}
    for name, scales in units.items():
        if name in section:
            table = _section(section, name, where)
            _known(table, {"column", "unit", "reference"}, f"conditions.{name}", where)
            column = table.get("column")
            if not isinstance(column, str):
                raise InputError(f"{where}: [conditions.{name}] needs a column")
            unit = _unit(table.get("unit"), tuple(scales), f"conditions.{name}", where)
            reference = table.get("reference", 20.0 if name == "temperature" and unit == "degC" else 0.0)
            if isinstance(reference, bool) or not isinstance(reference, int | float) or not np.isfinite(reference):
                raise InputError(
                    f"{where}: reference of [conditions.{name}] is {shortened(repr(reference))}; give a finite number"
                )
            found[name] = Condition((column,), (scales[unit],), float(reference))
    if "torques" in section:
        table = _section(section, "torques", where)
        _known(table, {"columns", "units"}, "conditions.torques", where)
        columns = _strings(table, "columns", where)
        default = tuple("N" if unit in LENGTHS else "N*m" for unit in joint_units)
        given = _strings(table, "units", where) if "units" in table else default
        if len(columns) != len(joint_units) or len(given) != len(columns):
            raise InputError(f"{where}: [conditions.torques] needs one column, and one unit, per joint")
        known = {"N*m": 1.0, "N": 1.0, "N*mm": 1e-3, "kN": 1e3}
        for unit in given:
            _unit(unit, tuple(known), "conditions.torques", where)
        found["torque"] = Condition(columns, tuple(known[unit] for unit in given))
    return found


def _section(content: Mapping[str, Any], key: str, where: str) -> Mapping[str, Any]:
    section = content.get(key)
    if not isinstance(section, Mapping):
        raise InputError(f"{where}: section [{key}] is missing")
    return section


def _known(table: Mapping[str, Any], allowed: set[str], section: str, where: str) -> None:
    unknown = sorted(set(table) - allowed)
    if unknown:
        place = f" in [{section}]" if section else ""
        raise InputError(f"{where}: unknown key '{shortened(unknown[0])}'{place}; known are {sorted(allowed)}")


def _strings(table: Mapping[str, Any], key: str, where: str) -> tuple[str, ...]:
    value = table.get(key)
    if not isinstance(value, list) or not all(isinstance(item, str) for item in value):
        raise InputError(f"{where}: {key} must be a list of column names or expressions")
    return tuple(value)


def _uncertainty(table: Mapping[str, Any], key: str, where: str) -> float:
    value = table[key]
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value <= largest(key):
        raise InputError(f"{where}: {key} is {shortened(repr(value))}; give one above zero, up to {largest(key):g}")
    return float(value)


def _unit(unit: Any, allowed: tuple[str, ...], section: str, where: str) -> str:
    if unit not in allowed:
        given = "missing" if unit is None else f"unknown: {shortened(repr(unit))}"
        raise InputError(f"{where}: the unit of [{section}] is {given}; give one of {', '.join(allowed)}")
    return str(unit)


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
