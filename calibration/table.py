"""The text of a measurement file as columns of numbers: CSV, or YAML with nested entries named by dotted paths.

Columns may be computed from others (+ - * / and numbers; odd names in backticks). Whatever is no number is refused
with the file, row and column named.
"""

from __future__ import annotations

import ast
import csv
import operator
import re
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from pickenv.arm.geometry import Array
from pickenv.errors import InputError


class Table:
    """Turns columns and expressions into numbers and names the cell at fault.

    Attributes:
        where: The file.
        header: Column names.
        lines: Line (or entry) of each row, as messages name it.
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

    def column(self, name: str) -> Array:
        """A column of finite numbers."""
        if name not in self.cache:
            index = self.index(name)
            pairs = zip(self.rows, self.lines, strict=True)
            self.cache[name] = np.array([self._cell(row, index, name, line) for row, line in pairs])
        return self.cache[name]

    def index(self, name: str) -> int:
        """Where a column stands."""
        if name not in self.header:
            raise InputError(f"{self.where}: column '{name}' is missing; the file has {', '.join(self.header)}")
        if self.header.count(name) > 1:
            raise InputError(
                f"{self.where}: column '{name}' occurs {self.header.count(name)} times; rename all but one"
            )
        return self.header.index(name)

    def blank(self, name: str) -> Array:
        """Whether each cell of a column is empty or says NaN."""
        index = self.index(name)
        texts = [row[index].strip().lower() if index < len(row) else "" for row in self.rows]
        return np.array([text in ("", "nan", "null", "none", "na", "-") for text in texts])

    def fill_blanks(self, name: str) -> None:
        """Read empty and NaN cells of a column as zero: what a lost reflector leaves."""
        index = self.index(name)
        for row, lost in zip(self.rows, self.blank(name), strict=True):
            if lost and index < len(row):
                row[index] = "0"

    def resolution(self, names: tuple[str, ...]) -> float:
        """Size of the last digit that most numbers in plain columns carry; 0 where columns are computed."""
        if any(name not in self.header for name in names):
            return 0.0
        digits = []
        for index in map(self.index, names):
            for row in self.rows[:200]:
                mantissa, _, exponent = (row[index] if index < len(row) else "").strip().lower().partition("e")
                shift = int(exponent) if exponent.lstrip("+-").isdigit() else 0
                digits.append(len(mantissa.replace(self.decimal, ".").partition(".")[2]) - shift)
        return float(10.0 ** -np.median(digits))

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

    def values(self, expressions: tuple[str, ...]) -> Array:
        """Several columns or expressions ``(N, k)``."""
        return np.stack([self.value(expression) for expression in expressions], -1)

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


def read_table(
    path: str | Path, separator: str = ",", decimal: str = ".", names: tuple[str, ...] | None = None
) -> Table:
    """Read a CSV file, or a YAML file of entries (.yaml, .yml).

    Args:
        path: The file.
        separator: Character between columns.
        decimal: Decimal sign.
        names: Column names of a file without a header, or None.

    Raises:
        InputError: If it is missing, unreadable or without rows.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"measurement file {path} does not exist; give a path to a CSV file")
    try:
        if path.suffix in (".yaml", ".yml"):
            return _yaml_table(path)
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
    if names is not None:
        header = list(names)
    else:
        header, rows, lines = [cell.strip() for cell in rows[0]], rows[1:], lines[1:]
    if not rows:
        raise InputError(f"{path} has a header but no rows; give one row per pose")
    return Table(str(path), header, rows, lines, decimal)


def _yaml_table(path: Path) -> Table:
    """Entries of a list or mapping, flattened: pose.x, target_joints.0."""
    import yaml

    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except yaml.YAMLError as error:
        raise InputError(f"{path} is not valid YAML: {' '.join(str(error).split())}") from error
    entries = list(content.values()) if isinstance(content, Mapping) else content
    if not isinstance(entries, list) or not entries or not all(isinstance(entry, Mapping) for entry in entries):
        raise InputError(f"{path} holds no list of entries; give one entry with joints and a pose per measurement")
    flat = [dict(_flattened(entry, "")) for entry in entries]
    header = list(dict.fromkeys(name for entry in flat for name in entry))
    rows = [[entry.get(name, "") for name in header] for entry in flat]
    return Table(str(path), header, rows, list(range(1, len(rows) + 1)), ".")


def _flattened(value: Any, name: str) -> Iterator[tuple[str, str]]:
    if isinstance(value, Mapping):
        for key, part in value.items():
            yield from _flattened(part, f"{name}.{key}" if name else str(key))
    elif isinstance(value, list):
        for i, part in enumerate(value):
            yield from _flattened(part, f"{name}.{i}")
    else:
        yield name, "" if value is None else repr(value) if isinstance(value, float) else str(value)
