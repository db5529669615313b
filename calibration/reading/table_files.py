"""Read measurement files as tables of columns: CSV, Parquet, YAML, and topics of ROS 2 bags.

A YAML file's nested entries are named by dotted paths. A column can be computed from others by an expression with
+ - * / and numbers. Names that are no identifiers are written in backticks. A cell that is no number is refused, and
the message names the file, row and column. If a file has another separator, decimal sign or encoding than expected, the
message says which it has.

A bag is a rosbag2 folder or an .mcap file; each message is one row. Messages are decoded by the definitions of ROS 2.
Definitions within a bag are not used, because rosbags would run code that it generates from them.
"""

from __future__ import annotations

import ast
import csv
import io
import json
import operator
import re
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from pickenv.arm import Array, Geometry
from pickenv.base import InputError, decimal_number, is_file, listed, read_text, require, shortened, yaml_content
from pickenv.base.files import parsed
from pickenv.calibration.identification.robust import align
from pickenv.calibration.model.arm_model import frames_model
from pickenv.calibration.model.measurements import Measurements

# Attitude conventions by name, and, where a file names none, what each of them would leave after base and tool. Euler
# angles are the commonest silent error in tracker files: six readings of the same three numbers all look plausible. A
# convention is therefore never guessed; the table shows which one fits.

GENERAL: dict[str, tuple[str, Callable[[Array], Rotation]]] = {
    "rotation_vector": ("angle", Rotation.from_rotvec),
    "quaternion_wxyz": ("none", lambda v: Rotation.from_quat(v, scalar_first=True)),
    "quaternion_xyzw": ("none", Rotation.from_quat),
    "euler_xyz_extrinsic": ("angle", lambda v: Rotation.from_euler("xyz", v)),
    "euler_xyz_intrinsic": ("angle", lambda v: Rotation.from_euler("XYZ", v)),
    "euler_zyx_extrinsic": ("angle", lambda v: Rotation.from_euler("zyx", v)),
    "euler_zyx_intrinsic": ("angle", lambda v: Rotation.from_euler("ZYX", v)),
    "euler_zyz_intrinsic": ("angle", lambda v: Rotation.from_euler("ZYZ", v)),
}

SAME_AS = {
    "kuka_abc": "euler_zyx_intrinsic",
    "fanuc_wpr": "euler_xyz_extrinsic",
    "abb_quaternion": "quaternion_wxyz",
    "ur_rotation_vector": "rotation_vector",
}
"""For each attitude convention of a robot maker, the name of the equal convention in `GENERAL`."""

CONVENTIONS = GENERAL | {maker: GENERAL[general] for maker, general in SAME_AS.items()}
"""Attitude conventions by name. Each has a kind of unit, "angle" or "none", and a function from values ``(N, 3 or 4)``
to rotations. Angles are in rad."""


def columns_of(convention: str) -> int:
    """Return the number of columns of an attitude convention: 4 for quaternions, else 3."""
    return 4 if CONVENTIONS[convention][0] == "none" else 3


def rotations(convention: str, values: Array) -> Array:
    """Compute the rotation matrices ``(N, 3, 3)`` of attitude values.

    Args:
        convention: Name of the attitude convention, a key of `CONVENTIONS`.
        values: Angles ``(N, 3)``, rad, or quaternions ``(N, 4)``.
    """
    return np.asarray(CONVENTIONS[convention][1](values).as_matrix())


def convention_table(geometry: Geometry, joints: Array, position: Array, values: Array, where: str) -> str:
    """Compare attitude conventions by the errors that they leave, as a text with one line for each, the best first.

    A line gives the mean position error, mm, and attitude error, deg, that remain after base and tool were fitted.

    Args:
        geometry: The arm's nominal geometry.
        joints: Joints ``(N, n)``, rad or m.
        position: Measured positions ``(N, 3)``, m.
        values: Values of the attitude columns: angles ``(N, 3)``, rad, or quaternions ``(N, 4)``.
        where: The file, for messages.
    """
    ranking: list[tuple[float, str]] = []
    for name in GENERAL:
        if columns_of(name) != values.shape[1]:
            continue
        data = Measurements(joints, position, rotations(name, values), geometry.prismatic, source=where)
        try:
            errors = data.difference(align(geometry, data, frames_model(geometry), judge=False).geometry)
        except (InputError, np.linalg.LinAlgError):
            errors = np.full((1, 6), np.inf)
        length, angle = (float(np.linalg.norm(part, axis=1).mean()) for part in (errors[:, :3], errors[:, 3:]))
        makers = ", ".join(maker for maker, general in SAME_AS.items() if general == name)
        label = f"{name} ({makers})" if makers else name
        ranking.append((angle, f"  {label:<42} {length * 1e3:9.2f} mm  {np.degrees(angle):7.2f} deg"))
    return "\n".join(line for _, line in sorted(ranking))


SEPARATORS = {";": "';'", "\t": "a tab", "|": "'|'", ",": "','", " ": "a space"}
"""Column separators and their names in messages, in the order in which a file is searched for them."""

LONGEST_EXPRESSION = 1000
"""Largest length of an expression that is parsed, in characters, because the depth of a parser is limited."""


OPERATORS: dict[type[ast.AST], Callable[..., Any]] = {
    **{ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul, ast.Div: operator.truediv},
    **{ast.USub: operator.neg, ast.UAdd: operator.pos},
}
"""Operators and signs that are allowed in expressions of columns, each with the function that computes it."""


class Table:
    """The cells of a file as text, which are converted to numbers column by column.

    A cell that is no finite number is refused, and the message names its file, row and column.

    Attributes:
        where: The file, for messages.
        header: Column names.
        rows: The cells of each row, as text.
        lines: Line (or entry) in the file of each row, from 1, for messages.
        decimal: Decimal sign.
        cache: Columns that are already converted, by name.
    """

    def __init__(self, where: str, header: list[str], rows: list[list[str]], lines: list[int], decimal: str) -> None:
        self.where, self.header, self.rows, self.lines, self.decimal = where, header, rows, lines, decimal
        self.cache: dict[str, Array] = {}
        for row, line in zip(rows, lines, strict=True):
            if any(cell.strip() for cell in row[len(header) :]):
                raise InputError(
                    f"{where}: row {line} has {len(row)} cells, but there are {len(header)} columns; check the "
                    "separator and the decimal sign, and name them in a column description"
                )

    def select(self, rows: Sequence[int], where: str = "") -> Table:
        """Return a table of the rows with these indices (from 0).

        Args:
            rows: The indices.
            where: Name of the new table for messages; empty for the name of this table.
        """
        cells, lines = [self.rows[row] for row in rows], [self.lines[row] for row in rows]
        return Table(where or self.where, self.header, cells, lines, self.decimal)

    def texts(self, name: str) -> list[str]:
        """Return the cells of a column as text without surrounding spaces; a cell is empty if its row is too short."""
        index = self.index(name)
        return [row[index].strip() if index < len(row) else "" for row in self.rows]

    def column(self, name: str) -> Array:
        """Return a column as finite numbers ``(N,)``."""
        if name not in self.cache:
            self.cache[name] = np.array([self._number(text, name, row) for row, text in enumerate(self.texts(name))])
        return self.cache[name]

    def index(self, name: str) -> int:
        """Return the index, from 0, of a column in the header; refuse a name that is missing or occurs twice."""
        if name not in self.header:
            raise InputError(f"{self.where}: column '{shortened(name)}' is missing; the file has {listed(self.header)}")
        if (count := self.header.count(name)) > 1:
            raise InputError(f"{self.where}: column '{shortened(name)}' occurs {count} times; rename all but one")
        return self.header.index(name)

    def cell(self, row: int, name: object) -> str:
        """Return text for messages that names a cell's file, line and column.

        Args:
            row: Index of the row, from 0.
            name: Name of the column.
        """
        return f"{self.where}: row {self.lines[row]}, column '{name}'"

    def fill_blanks(self, name: str) -> Array:
        """Set a column's empty or NaN cells to 0, and return a mask ``(N,)`` of the rows with such cells.

        Trackers write such cells for a lost reflector.
        """
        texts = self.texts(name)
        blank = [text.lower() in ("", "nan", "null", "none", "na", "-") for text in texts]
        numbers = [0.0 if blank[row] else self._number(text, name, row) for row, text in enumerate(texts)]
        self.cache[name] = np.array(numbers)
        return np.array(blank)

    def _number(self, text: str, name: str, row: int) -> float:
        """Return the finite number that the text of a cell spells, with this file's decimal sign.

        Args:
            text: Text of the cell.
            name: The cell's column, for messages.
            row: Index of the cell's row, from 0, for messages.
        """
        grouped = self.decimal == "," and "." in text  # a point beside a decimal comma groups thousands
        value = decimal_number("" if grouped else text.replace(self.decimal, "."))
        if value is not None and np.isfinite(value):
            return value
        fault = f"holds '{shortened(text)}', which is not a number" if text else "is empty"
        predicate = fault if value is None else f"is {shortened(text)}"
        raise InputError(f"{self.cell(row, shortened(name))} {predicate}; correct or remove the row")

    def value(self, expression: str) -> Array:
        """Return the values ``(N,)`` of a column, or of an expression of columns with + - * / and numbers.

        In an expression, column names that are no identifiers are written in backticks.
        """
        tree = expression_tree(expression)
        if expression in self.header or tree is None:
            return self.column(expression)  # refused if the file has no such column
        try:
            with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
                values = np.broadcast_to(self._evaluate(tree, expression), len(self.rows)).astype(float)
        except (OverflowError, RecursionError) as error:  # a constant of 400 digits, brackets in brackets
            raise InputError(
                f"{self.where}: cannot compute '{shortened(expression)}'; give numbers and brackets of ordinary size"
            ) from error
        for row in np.flatnonzero(~np.isfinite(values))[:1]:
            place = f"{self.where}: row {self.lines[row]}, '{shortened(expression)}'"
            raise InputError(f"{place} divides by zero or overflows; correct it")
        return values

    def values(self, expressions: tuple[str, ...]) -> Array:
        """Return the values ``(N, k)`` of k columns or expressions."""
        return np.stack([self.value(expression) for expression in expressions], -1)

    def _evaluate(self, node: ast.AST, expression: str) -> Any:
        """Return the value of a syntax tree: a number, or an array ``(N,)`` if it uses columns.

        Args:
            node: The tree, from `expression_tree`.
            expression: The whole expression, for messages.
        """
        match node:
            case ast.Constant(value=int() | float() as value) if not isinstance(value, bool):
                return np.float64(value)
            case ast.Name(id=name):
                return self.column(name)
            case ast.BinOp(left=left, op=op, right=right) if function := OPERATORS.get(type(op)):
                return function(self._evaluate(left, expression), self._evaluate(right, expression))
            case ast.UnaryOp(op=op, operand=operand) if sign := OPERATORS.get(type(op)):
                return sign(self._evaluate(operand, expression))
        fault = f"{self.where}: cannot compute '{shortened(expression)}'"
        if isinstance(node, ast.Attribute):  # a column of another file, such as pose.x
            raise InputError(f"{fault}: there is no column '{shortened(ast.unparse(node))}', but {listed(self.header)}")
        raise InputError(f"{fault}; use names, numbers and + - * / only")


def expression_tree(expression: str) -> ast.expr | None:
    """Parse an expression of columns: return its syntax tree, in which names in backticks are names as any other.

    The result is None if the expression cannot be parsed.
    """
    text, quoted = expression, {f"__quoted_{i}": name for i, name in enumerate(re.findall(r"`([^`]+)`", expression))}
    for mark, name in quoted.items():
        text = text.replace(f"`{name}`", mark)
    if len(text) > LONGEST_EXPRESSION:
        return None
    with suppress(SyntaxError, ValueError, RecursionError, MemoryError):
        tree = ast.parse(text.strip(), mode="eval").body
        for node in ast.walk(tree):
            if isinstance(node, ast.Name):
                node.id = quoted.get(node.id, node.id)
        return tree
    return None


def refuse_repeated(paths: Sequence[str | Path]) -> None:
    """Refuse a list of files that names the same file twice, by the same path or by different ones.

    Raises:
        InputError: If a file is named twice; the message says which.
    """
    marks: set[object] = set()
    for path in paths:
        try:
            stat = Path(path).stat()
        except (OSError, ValueError):
            continue  # whoever reads it says what is wrong
        mark = (stat.st_dev, stat.st_ino)
        if mark in marks:
            raise InputError(f"{path} is given twice; name each file once")
        marks.add(mark)


def read_table(
    path: str | Path, separator: str = ",", decimal: str = ".", names: tuple[str, ...] | None = None
) -> Table:
    """Read a CSV file, a YAML file of entries (.yaml, .yml), or a Parquet file (.parquet), which needs pyarrow.

    Args:
        path: The file.
        separator: Character between columns.
        decimal: Decimal sign, "." or ",".
        names: Column names of a file without a header, or None.

    Raises:
        InputError: If the file is missing, unreadable or without rows.
    """
    path = Path(path)
    if path.suffix == ".parquet":
        return _parquet_table(path)
    text = read_text(path, "a CSV file")
    if path.suffix in (".yaml", ".yml"):
        return _yaml_table(path, text)
    rows, lines = csv_rows(text, path, separator)
    if not rows:
        raise InputError(f"{path} is empty; give a CSV file with a header and one row per pose")
    _refuse_other_separator(rows, path, separator, decimal)
    if names is not None:
        header = list(names)
    else:
        header, rows, lines = [cell.strip() for cell in rows[0]], rows[1:], lines[1:]
    if not rows:
        raise InputError(f"{path} has a header but no rows; give one row per pose")
    return Table(str(path), header, rows, lines, decimal)


def csv_rows(text: str, path: str | Path, separator: str = ",") -> tuple[list[list[str]], list[int]]:
    """Split a CSV text into rows: return the cells and the line number (from 1) of each row that is not blank.

    Args:
        text: The text.
        path: The file, for messages.
        separator: Character between columns.

    Raises:
        InputError: If a cell is too long or a quote is not closed; the message names the line.
    """
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=separator)
    rows, lines, before, unclosed = [], [], 0, text.count('"') % 2 == 1
    try:
        for row in reader:
            if unclosed and any("\n" in cell for cell in row):
                raise InputError(f"{path}: line {before + 1} opens a quote that is never closed; close or remove it")
            if any(cell.strip() for cell in row):
                rows.append(row)
                lines.append(reader.line_num)
            before = reader.line_num
    except csv.Error as error:
        place = f"cannot read {path}: line {before + 1}"
        raise InputError(f"{place}: {shortened(error)}; is a quote not closed, or is it no CSV file?") from error
    return rows, lines


def _refuse_other_separator(rows: list[list[str]], path: Path, separator: str, decimal: str) -> None:
    """Refuse a file whose first row is a single cell with another separator in it, if later rows hold it too.

    The message says which separator it is, and how a column description names it.

    Args:
        rows: The cells of each row.
        path: The file, for messages.
        separator: The expected separator.
        decimal: The expected decimal sign.
    """
    first = rows[0][0].strip() if len(rows[0]) == 1 else ""
    better = next((character for character in SEPARATORS if character != separator and character in first), None)
    if better is None or not any(better in cell for row in rows[1:] for cell in row):
        return
    comma = better != "," and decimal == "." and any(re.search(r"\d,\d", ",".join(row)) for row in rows[1:])
    keys = f"separator = {json.dumps(better)}" + (' and decimal = ","' if comma else "")
    raise InputError(
        f"{path} is separated by {SEPARATORS[better]}, not by {SEPARATORS.get(separator, repr(separator))}; separate "
        f"its columns so, or, if it holds measurements, give `columns` a description with {keys}"
    )


def _parquet_table(path: Path) -> Table:
    """Read the table of a Parquet file, whose numbers keep all their digits; missing values are empty cells."""
    require("pyarrow")
    import pyarrow.lib
    import pyarrow.parquet

    try:
        rows = pyarrow.parquet.ParquetFile(path).read(use_threads=False).to_pylist()
    except (OSError, pyarrow.lib.ArrowException) as error:
        raise InputError(f"cannot read {path}: {shortened(error)}; give a Parquet file") from error
    if not rows:
        raise InputError(f"{path} has no rows; give one row per pose")
    return table_of_entries(str(path), [dict(_flattened(row, "")) for row in rows])


def _yaml_table(path: Path, text: str) -> Table:
    """Read a YAML list or mapping of entries as a table; nested values become columns such as pose.x or joints.0."""
    content = yaml_content(text, path)
    entries = list(content.values()) if isinstance(content, Mapping) else content
    plain = isinstance(entries, list) and all(isinstance(entry, Mapping) for entry in entries)
    flat = parsed(lambda: [dict(_flattened(entry, "")) for entry in entries], path, "YAML") if plain else []
    if not flat:
        raise InputError(f"{path} holds no list of entries; give one entry with joints and a pose per measurement")
    return table_of_entries(str(path), flat)


def table_of_entries(where: str, entries: Sequence[Mapping[str, str]]) -> Table:
    """Make a table of entries, one row for each.

    Args:
        where: The file, for messages.
        entries: The cells of each entry by column name; cells that an entry lacks become empty.
    """
    header = list(dict.fromkeys(name for entry in entries for name in entry))
    rows = [[entry.get(name, "") for name in header] for entry in entries]
    return Table(where, header, rows, list(range(1, len(rows) + 1)), ".")


def _flattened(value: Any, name: str) -> Iterator[tuple[str, str]]:
    """Yield the name, such as pose.x or joints.0, and the text of every single value within ``value``.

    Names begin with ``name``, which is empty at the top.
    """
    if isinstance(value, Mapping):
        for key, part in value.items():
            yield from _flattened(part, f"{name}.{key}" if name else str(key))
    elif isinstance(value, list):
        for i, part in enumerate(value):
            yield from _flattened(part, f"{name}.{i}")
    else:
        yield name, "" if value is None else repr(value) if isinstance(value, float) else str(value)


JOINTS = "sensor_msgs/msg/JointState"
FIELDS: dict[str, tuple[str, ...]] = {
    JOINTS: (),
    "geometry_msgs/msg/PointStamped": ("point.x", "point.y", "point.z"),
    "geometry_msgs/msg/PoseStamped": (
        *("pose.position.x", "pose.position.y", "pose.position.z"),
        *("pose.orientation.x", "pose.orientation.y", "pose.orientation.z", "pose.orientation.w"),
    ),
    "geometry_msgs/msg/TransformStamped": (
        *("transform.translation.x", "transform.translation.y", "transform.translation.z"),
        *("transform.rotation.x", "transform.rotation.y", "transform.rotation.z", "transform.rotation.w"),
    ),
}
"""For each type of message that is read, the fields that become columns. All types have a stamp in their header. The
columns of a JointState are named after its joints."""


def read_log(
    path: Path, topic: str | None, separator: str = ",", decimal: str = ".", names: tuple[str, ...] | None = None
) -> Table:
    """Read a topic of a ROS 2 bag as a table; without a topic, read a file as `read_table` does.

    Columns of a topic are ``time`` and ``log_time``, s, and the fields of its messages. A JointState gives one column
    per joint with the joint's name, and its efforts as ``effort.NAME``.

    Args:
        path: The bag or the file.
        topic: Name of the topic; None for a file.
        separator: Character between columns of a file.
        decimal: Decimal sign of a file, "." or ",".
        names: Column names of a file without a header, or None.

    Raises:
        InputError: If the file or topic is missing, unreadable or empty, or if its type is not read.
    """
    is_bag = is_file(path / "metadata.yaml") or (path.suffix in (".mcap", ".db3") and is_file(path))
    if topic is not None and not is_bag:
        raise InputError(f"{path} is no rosbag2 folder and no .mcap file; give one, or do not name its topic")
    if topic is None and is_bag:
        raise InputError(f"{path} is a ROS bag; name its topic in [recording] of `columns`: topic, or joints_topic")
    return read_table(path, separator, decimal, names) if topic is None else _bag_table(path, topic)


def _bag_table(path: Path, topic: str) -> Table:
    """Read one topic as a table; if its messages have no stamps, the times at which they were logged are taken."""
    require("rosbags")
    kinds, messages = parsed(lambda: _messages(path, topic), path, "rosbag2 or MCAP of ROS 2")
    if topic not in kinds:
        topics = (f"{name} ({kind})" for name, kind in sorted(kinds.items()))
        raise InputError(f"{path} has no topic '{topic}'; it has {listed(topics) or 'none'}")
    where, kind = f"topic {topic} of {path}", kinds[topic]
    if kind not in FIELDS:
        raise InputError(f"{where} holds messages of {kind}; give one of {', '.join(FIELDS)}")
    if not messages:
        raise InputError(f"{where} has no messages; record it again")
    logged, found = zip(*messages, strict=True)
    stamps = tuple(message.header.stamp.sec * 10**9 + message.header.stamp.nanosec for message in found)
    if not any(stamps):
        warnings.warn(f"{where} has no stamps; the times at which it was logged are taken", stacklevel=2)
        stamps = logged
    entries = []
    for stamp, time, message in zip(stamps, logged, found, strict=True):
        cells = {field: attrgetter(field)(message) for field in FIELDS[kind]}
        if kind == JOINTS:
            cells |= zip(message.name, message.position.tolist(), strict=False)
            cells |= {f"effort.{name}": part for name, part in zip(message.name, message.effort.tolist(), strict=False)}
        texts = {name: repr(cell) for name, cell in cells.items()}
        entries.append({"time": _seconds(stamp), "log_time": _seconds(time)} | texts)
    return table_of_entries(where, entries)


def _messages(path: Path, topic: str) -> tuple[dict[str, str], list[tuple[int, Any]]]:
    """Return the message type of each topic of a bag, and the messages of ``topic`` with their log times, ns.

    There are no messages if the topic's type is not one of `FIELDS`.
    """
    from rosbags.rosbag2 import Reader
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    with Reader(path) as bag:
        kinds = {connection.topic: connection.msgtype for connection in bag.connections}
        publishers = [item for item in bag.connections if item.topic == topic and item.msgtype in FIELDS]
        found = bag.messages(publishers) if publishers else ()
        return kinds, [(time, store.deserialize_cdr(data, kinds[topic])) for _, time, data in found]


def _seconds(time: int) -> str:
    """Return a time in ns as decimal text in s, with all its digits."""
    return f"{time // 10**9}.{time % 10**9:09d}"
