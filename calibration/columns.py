"""Reading measured CSV files: our own columns, or any foreign file through a small TOML description of its columns.

A description names separator, decimal sign, units and conventions; a column may be computed from others
(position = target + deviation). Shipped descriptions lie in `calibration/descriptions`.
"""

from __future__ import annotations

import ast
import csv
import operator
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from calibration.measurements import ATTITUDE_STD, POSITION_STD, Measurements, joint_columns
from pickenv.arm import Geometry
from pickenv.arm.arm_file import TO_SI, read_toml
from pickenv.arm.geometry import Array
from pickenv.errors import InputError

DESCRIPTIONS = Path(__file__).parent / "descriptions"
LENGTHS, ANGLES = ("mm", "m"), ("deg", "rad")

CONVENTIONS: dict[str, tuple[str, Callable[[Array], Rotation]]] = {
    "rotation_vector": ("angle", Rotation.from_rotvec),
    "quaternion_wxyz": ("none", lambda v: Rotation.from_quat(v, scalar_first=True)),
    "quaternion_xyzw": ("none", Rotation.from_quat),
    "euler_xyz_extrinsic": ("angle", lambda v: Rotation.from_euler("xyz", v)),
    "euler_xyz_intrinsic": ("angle", lambda v: Rotation.from_euler("XYZ", v)),
    "euler_zyx_intrinsic": ("angle", lambda v: Rotation.from_euler("ZYX", v)),
    "kuka_abc": ("angle", lambda v: Rotation.from_euler("ZYX", v)),
    "fanuc_wpr": ("angle", lambda v: Rotation.from_euler("xyz", v)),
    "abb_quaternion": ("none", lambda v: Rotation.from_quat(v, scalar_first=True)),
    "ur_rotation_vector": ("angle", Rotation.from_rotvec),
}
"""Attitude conventions by name: the kind of their unit, and how values (N, 3 or 4), in rad, become rotations."""


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
        position: Expressions of x, y, z.
        position_unit: mm or m.
        rotation: Expressions of the attitude's columns; empty for positions only.
        convention: Attitude convention, a key of `CONVENTIONS`.
        rotation_unit: deg or rad.
        position_std: Standard uncertainty of a coordinate, m.
        attitude_std: Standard uncertainty of an attitude coordinate, rad.
    """

    where: str
    separator: str
    decimal: str
    names: tuple[str, ...] | None
    joints: tuple[str, ...]
    joint_units: tuple[str, ...]
    position: tuple[str, ...]
    position_unit: str
    rotation: tuple[str, ...]
    convention: str
    rotation_unit: str
    position_std: float
    attitude_std: float


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
    if not path.is_file():
        raise InputError(f"unknown column description '{name}'; give one of {shipped_descriptions()} or a path (.toml)")
    return parse_description(read_toml(path), str(path))


def parse_description(content: Mapping[str, Any], where: str) -> ColumnDescription:
    """Turn the parsed content of a description into a `ColumnDescription`; ``where`` names the file in messages."""
    _known(content, {"description", "separator", "decimal", "names", "joints", "position", "rotation"}, "", where)
    joints, position = _section(content, "joints", where), _section(content, "position", where)
    _known(joints, {"columns", "unit", "units"}, "joints", where)
    _known(position, {"columns", "unit", "std_mm"}, "position", where)
    expressions = _strings(joints, "columns", where)
    units = _strings(joints, "units", where) if "units" in joints else (joints.get("unit"),) * len(expressions)
    if len(units) != len(expressions):
        raise InputError(f"{where}: [joints] has {len(expressions)} columns but {len(units)} units; give one per joint")
    for unit in units:
        _unit(unit, LENGTHS + ANGLES, "joints", where)
    rotation: Mapping[str, Any] = _section(content, "rotation", where) if "rotation" in content else {}
    if rotation:
        _known(rotation, {"columns", "unit", "convention", "std_deg"}, "rotation", where)
        if rotation.get("convention") not in CONVENTIONS:
            given = rotation.get("convention")
            raise InputError(f"{where}: [rotation] has convention {given!r}; name one of {', '.join(CONVENTIONS)}")
    convention = str(rotation.get("convention", "rotation_vector"))
    is_angle = CONVENTIONS[convention][0] == "angle"
    if len(_strings(position, "columns", where)) != 3:
        raise InputError(f"{where}: [position] needs three columns, x, y and z")
    separator, decimal = content.get("separator", ","), content.get("decimal", ".")
    if not isinstance(separator, str) or len(separator) != 1 or separator in '\r\n"':
        raise InputError(f"{where}: separator is {separator!r}; give one character, such as ',' or ';' or '\\t'")
    if decimal not in (".", ",") or decimal == separator:
        raise InputError(f"{where}: decimal is {decimal!r}; give '.' or ',', and not the separator")
    return ColumnDescription(
        where=where,
        separator=separator,
        decimal=decimal,
        names=_strings(content, "names", where) if "names" in content else None,
        joints=expressions,
        joint_units=tuple(str(unit) for unit in units),
        position=_strings(position, "columns", where),
        position_unit=_unit(position.get("unit"), LENGTHS, "position", where),
        rotation=_strings(rotation, "columns", where) if rotation else (),
        convention=convention,
        rotation_unit=_unit(rotation.get("unit"), ANGLES, "rotation", where) if rotation and is_angle else "rad",
        position_std=_uncertainty(position, "std_mm", where) * 1e-3 if "std_mm" in position else POSITION_STD,
        attitude_std=float(np.radians(_uncertainty(rotation, "std_deg", where)))
        if "std_deg" in rotation
        else ATTITUDE_STD,
    )


def _section(content: Mapping[str, Any], key: str, where: str) -> Mapping[str, Any]:
    section = content.get(key)
    if not isinstance(section, Mapping):
        raise InputError(f"{where}: section [{key}] is missing")
    return section


def _known(table: Mapping[str, Any], allowed: set[str], section: str, where: str) -> None:
    unknown = sorted(set(table) - allowed)
    if unknown:
        place = f" in [{section}]" if section else ""
        raise InputError(f"{where}: unknown key '{unknown[0]}'{place}; known are {sorted(allowed)}")


def _strings(table: Mapping[str, Any], key: str, where: str) -> tuple[str, ...]:
    value = table.get(key)
    if not isinstance(value, list) or not all(isinstance(item, str) for item in value):
        raise InputError(f"{where}: {key} must be a list of column names or expressions")
    return tuple(value)


def _uncertainty(table: Mapping[str, Any], key: str, where: str) -> float:
    value = table[key]
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value < np.inf:
        raise InputError(f"{where}: {key} is {value!r}; give a standard uncertainty above zero")
    return float(value)


def _unit(unit: Any, allowed: tuple[str, ...], section: str, where: str) -> str:
    if unit not in allowed:
        given = "missing" if unit is None else f"unknown: {unit!r}"
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
    position = tuple(f"{axis}_{position_unit}" for axis in "xyz")
    has_rotation = any(column.startswith(("rx_", "ry_", "rz_")) for column in header)
    rotation_unit = "rad" if "rx_rad" in header else "deg"
    return ColumnDescription(
        where=where,
        separator=",",
        decimal=".",
        names=None,
        joints=tuple(joints),
        joint_units=tuple(units),
        position=position,
        position_unit=position_unit,
        rotation=tuple(f"r{axis}_{rotation_unit}" for axis in "xyz") if has_rotation else (),
        convention="rotation_vector",
        rotation_unit=rotation_unit,
        position_std=POSITION_STD,
        attitude_std=ATTITUDE_STD,
    )


def read_measurements(path: str | Path, geometry: Geometry, columns: str | Path | None = None) -> Measurements:
    """Read a CSV file of measurements.

    Args:
        path: The file.
        geometry: The arm's nominal geometry, for joint count and types.
        columns: Name or path of a column description; None for our own format.

    Raises:
        InputError: Names the file, row, column or unit at fault.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"measurement file {path} does not exist; give a path to a CSV file")
    description = None if columns is None else load_description(columns)
    separator = description.separator if description else ","
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            reader = csv.reader(file, delimiter=separator)
            rows, lines = [], []
            for row in reader:
                if any(cell.strip() for cell in row):
                    rows.append(row)
                    lines.append(reader.line_num)
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"cannot read {path}: {error}; give a CSV text file in UTF-8") from error
    if not rows:
        raise InputError(f"{path} is empty; give a CSV file with a header and one row per pose")
    if description is not None and description.names is not None:
        header = list(description.names)
    else:
        header, rows, lines = [cell.strip() for cell in rows[0]], rows[1:], lines[1:]
    if not rows:
        raise InputError(f"{path} has a header but no rows; give one row per pose")
    description = description or own_description(geometry, header, str(path))
    return _assemble(_Table(str(path), header, rows, lines, description.decimal), description, geometry)


class _Table:
    """The text of a CSV file; turns columns and expressions into numbers and names the cell at fault."""

    def __init__(self, where: str, header: list[str], rows: list[list[str]], lines: list[int], decimal: str) -> None:
        self.where, self.header, self.rows, self.lines, self.decimal = where, header, rows, lines, decimal
        self.cache: dict[str, Array] = {}
        for row, line in zip(rows, lines, strict=True):
            if any(cell.strip() for cell in row[len(header) :]):
                raise InputError(
                    f"{where}: row {line} has {len(row)} cells, but there are {len(header)} columns; check the "
                    "separator and the decimal sign, and name them in a column description"
                )

    def column(self, name: str) -> Array:
        if name not in self.header:
            raise InputError(f"{self.where}: column '{name}' is missing; the file has {', '.join(self.header)}")
        if name not in self.cache:
            if self.header.count(name) > 1:
                raise InputError(
                    f"{self.where}: column '{name}' occurs {self.header.count(name)} times; rename all but one"
                )
            index, pairs = self.header.index(name), zip(self.rows, self.lines, strict=True)
            self.cache[name] = np.array([self._cell(row, index, name, line) for row, line in pairs])
        return self.cache[name]

    def _cell(self, row: list[str], index: int, name: str, line: int) -> float:
        text = row[index].strip() if index < len(row) else ""
        try:
            # A point beside a decimal comma groups thousands, and Python's 1_000 is no number of an instrument's.
            foreign = "_" in text or (self.decimal == "," and "." in text)
            value = float("" if foreign else text.replace(self.decimal, "."))
        except ValueError:
            said = "is empty" if not text else f"holds '{text}', which is not a number"
            raise InputError(f"{self.where}: row {line}, column '{name}' {said}; correct or remove the row") from None
        if not np.isfinite(value):
            raise InputError(f"{self.where}: row {line}, column '{name}' is {text}; correct or remove the row")
        return value

    def value(self, expression: str) -> Array:
        """A column by its name, or an expression of columns with + - * / and numbers; `odd names` in backticks."""
        if expression in self.header:
            return self.column(expression)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            values = self._computed(expression)
        if not np.isfinite(values).all():
            line = self.lines[int(np.argmin(np.isfinite(values)))]
            raise InputError(f"{self.where}: row {line}, '{expression}' divides by zero or overflows; correct it")
        return values

    def _computed(self, expression: str) -> Array:
        quoted = re.findall(r"`([^`]+)`", expression)
        text = expression
        for i, name in enumerate(quoted):
            text = text.replace(f"`{name}`", f"__quoted_{i}")
        try:
            tree = ast.parse(text, mode="eval").body
        except SyntaxError:
            raise InputError(
                f"{self.where}: column '{expression}' is missing; the file has {', '.join(self.header)}"
            ) from None
        return np.broadcast_to(self._evaluate(tree, expression, quoted), len(self.rows)).astype(float)

    def _evaluate(self, node: ast.AST, expression: str, quoted: list[str]) -> Any:
        operators: dict[type[ast.AST], Callable[..., Any]] = {
            ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul, ast.Div: operator.truediv,
            ast.USub: operator.neg, ast.UAdd: operator.pos,
        }  # fmt: skip
        match node:
            case ast.Constant(value=int() | float() as value):
                return np.float64(value)
            case ast.Name(id=name):
                match_ = re.fullmatch(r"__quoted_(\d+)", name)
                return self.column(quoted[int(match_[1])] if match_ else name)
            case ast.BinOp(left=left, op=op, right=right) if type(op) in operators:
                return operators[type(op)](
                    self._evaluate(left, expression, quoted), self._evaluate(right, expression, quoted)
                )
            case ast.UnaryOp(op=op, operand=operand) if type(op) in operators:
                return operators[type(op)](self._evaluate(operand, expression, quoted))
        raise InputError(f"{self.where}: cannot compute '{expression}'; use column names, numbers and + - * / only")


def _assemble(table: _Table, description: ColumnDescription, geometry: Geometry) -> Measurements:
    n = geometry.joints
    if len(description.joints) != n:
        raise InputError(
            f"{description.where}: {len(description.joints)} joint columns are named, but the arm has {n} joints"
        )
    joints = []
    for i, (expression, unit) in enumerate(zip(description.joints, description.joint_units, strict=True)):
        wanted = LENGTHS if geometry.prismatic[i] else ANGLES
        if unit not in wanted:
            kind = "prismatic" if geometry.prismatic[i] else "revolute"
            raise InputError(
                f"{description.where}: joint {i + 1} is {kind}, but its unit is '{unit}'; give {' or '.join(wanted)}"
            )
        joints.append(table.value(expression) * TO_SI[unit])
        _plausible_joint(table, geometry, i, joints[-1], expression, unit)
    position = np.stack([table.value(e) for e in description.position], -1) * TO_SI[description.position_unit]
    rotation = None
    if description.rotation:
        values = np.stack([table.value(e) for e in description.rotation], -1) * TO_SI[description.rotation_unit]
        kind, convert = CONVENTIONS[description.convention]
        wanted_columns = 4 if kind == "none" else 3
        if values.shape[1] != wanted_columns:
            raise InputError(
                f"{description.where}: convention '{description.convention}' needs {wanted_columns} columns"
            )
        if kind == "none" and np.any(np.abs(np.linalg.norm(values, axis=1) - 1.0) > 0.01):
            bad = int(np.argmax(np.abs(np.linalg.norm(values, axis=1) - 1.0)))
            raise InputError(f"{table.where}: row {table.lines[bad]} holds a quaternion that is not of unit length")
        if kind == "angle" and np.abs(values).max() > 4 * np.pi:
            bad, column = divmod(int(np.argmax(np.abs(values))), values.shape[1])
            hint = "its unit is probably deg" if description.rotation_unit == "rad" else "correct or remove the row"
            raise InputError(
                f"{table.where}: row {table.lines[bad]}, column '{description.rotation[column]}' is "
                f"{np.abs(values[bad, column]):.0f} rad, which no rotation needs; {hint}"
            )
        rotation = convert(values).as_matrix()
    return Measurements(
        joints=np.stack(joints, -1),
        position=position,
        rotation=rotation,
        prismatic=geometry.prismatic,
        position_std=description.position_std,
        attitude_std=description.attitude_std,
        source=table.where,
    )


def _plausible_joint(table: _Table, geometry: Geometry, i: int, values: Array, column: str, unit: str) -> None:
    """Refuse joints that no such arm can take: almost always degrees read as radians, or millimetres as metres."""
    span = geometry.upper[i] - geometry.lower[i]
    room = span if geometry.prismatic[i] else max(span, 2 * np.pi)
    outside = (values < geometry.lower[i] - room) | (values > geometry.upper[i] + room)
    if outside.any():
        row = int(np.argmax(outside))
        other = {"rad": "deg", "deg": "rad", "m": "mm", "mm": "m"}[unit]
        limits = f"{geometry.lower[i] / TO_SI[unit]:.4g} to {geometry.upper[i] / TO_SI[unit]:.4g} {unit}"
        raise InputError(
            f"{table.where}: row {table.lines[row]}, column '{column}' is {values[row] / TO_SI[unit]:.6g} {unit}, "
            f"but joint {i + 1} ({geometry.joint_names[i]}) moves over {limits}; its unit is probably {other}"
        )
