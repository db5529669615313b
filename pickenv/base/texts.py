"""Read text files, and report a wrong kind of file, a wrong encoding or a parser's error in one clear sentence.

Readers of CSV, TOML, YAML, URDF and MJCF call `read_text` and `parsed`; each error is an `InputError` that names the
file. `shortened` keeps a message's quotations to one line, and `decimal_number` decides what is a number.
"""

from __future__ import annotations

import codecs
import re
import shutil
import stat
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from textwrap import wrap
from typing import Any, TypeVar

from pickenv.base.errors import InputError

Thing = TypeVar("Thing")

PIECE = 1 << 20
"""Number of bytes read at once."""

LARGEST = 1 << 30
"""Largest size of a text file, bytes; no file of ours comes near it."""

MARKS = {"UTF-32": (codecs.BOM_UTF32_LE, codecs.BOM_UTF32_BE), "UTF-16": (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)}
"""First bytes of files that are not UTF-8: byte order marks, longest first."""


def read_text(path: str | Path, kind: str) -> str:
    """The text of a UTF-8 file, a pipe, or /dev/stdin; a byte order mark is left out, line ends stay as they are.

    Args:
        path: The file.
        kind: What it should be, for messages: "a CSV file".

    Raises:
        InputError: If the file is missing, a folder or a device, too large, or no UTF-8 text; the message says which.
    """
    other, data = "", b""
    try:
        mode = Path(path).stat().st_mode
        other = "" if stat.S_ISREG(mode) or stat.S_ISFIFO(mode) else "a folder" if stat.S_ISDIR(mode) else "a device"
        if not other:
            with Path(path).open("rb") as file:
                while len(data) <= LARGEST and (more := file.read(PIECE)):
                    data += more
    except FileNotFoundError as error:
        raise InputError(f"{_name(path)} does not exist; give a path to {kind}") from error
    except (OSError, ValueError) as error:  # a path of 300 characters, or with a zero byte in it
        raise InputError(f"cannot read {_name(path)}: {reason_of(error)}; give a path to {kind}") from error
    if other:
        raise InputError(f"{_name(path)} is {other}, not a file; give a path to {kind}")
    if len(data) > LARGEST:
        raise InputError(f"{path} holds more than {LARGEST >> 20} MiB; give a path to {kind}")
    return _decoded(data, path, kind)


def _decoded(data: bytes, path: str | Path, kind: str) -> str:
    if data.startswith(b"PK\x03\x04"):
        raise InputError(f"{path} is a zip archive, such as a spreadsheet; export it as {kind}")
    for encoding, marks in MARKS.items():
        if data.startswith(marks):
            raise InputError(f"{path} is written in {encoding}; save it as UTF-8")
    if b"\0" in data:
        raise InputError(f"cannot read {path}: it holds zero bytes, so it is UTF-16 or no text; give {kind} in UTF-8")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        place = f"byte 0x{data[error.start]:02x} in line {line}"
        raise InputError(f"cannot read {path}: {place} is Latin-1 (cp1252) or no text; give {kind} in UTF-8") from error


def parsed(parse: Callable[[], Thing], path: str | Path, kind: str) -> Thing:
    """The result of ``parse()``; any error becomes an `InputError`: ``path`` is not valid ``kind`` ("TOML"), why."""
    try:
        return parse()
    except RecursionError as error:
        raise InputError(f"{path} is not valid {kind}: it is nested too deeply; give tables of a few levels") from error
    except Exception as error:
        raise InputError(f"{path} is not valid {kind}: {reason_of(error)}") from error


@contextmanager
def in_file(path: str | Path) -> Iterator[None]:
    """A context whose errors begin with the file's name.

    Raises:
        InputError: For every `InputError` in the context.
    """
    try:
        yield
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def yaml_content(text: str, path: str | Path) -> Any:
    """The content of a YAML text: mappings, lists, numbers and words; aliases and tags of Python are refused.

    Raises:
        InputError: If the text is no YAML; the message names ``path``.
    """
    import yaml  # late: most files are none

    class Plain(yaml.SafeLoader):
        """A YAML loader that refuses aliases, because with them a few lines can stand for endlessly many."""

        def compose_node(self, parent: Any, index: Any) -> Any:
            if self.check_event(yaml.AliasEvent):
                raise ValueError("it uses an alias (*name); write the values out")
            return super().compose_node(parent, index)

    return parsed(lambda: yaml.load(text, Plain), path, "YAML")  # a safe loader


def decimal_number(text: str) -> float | None:
    """The number that ``text`` spells in ASCII digits, which may be nan or infinite; None if it spells no number."""
    try:
        return float(text) if text.isascii() and "_" not in text else None  # no 1_000, and no digits of any script
    except ValueError:
        return None


def one_line(text: str) -> str:
    """A text without line ends and other characters that names and comments cannot hold."""
    return "".join(c if c.isprintable() else " " for c in text)


def shortened(value: object, length: int = 60) -> str:
    """``value`` as a message quotes it: on one line, and no longer than ``length``."""
    try:
        text = str(value) if not isinstance(value, str) else value
    except ValueError:  # an integer of more than 4300 digits
        return "a number of thousands of digits"
    text = one_line(text[: 4 * length])
    return text if len(text) <= length else f"{text[: length - 2].rstrip()} …"


UNBOUNDED = 100_000
"""Width, in characters, of a line that is not written to a terminal."""


def screen_width(otherwise: int = UNBOUNDED) -> int:
    """The width of the terminal in characters, or what COLUMNS says; ``otherwise`` where neither is known."""
    return shutil.get_terminal_size((otherwise, 24)).columns


def folded(text: str, width: int) -> list[str]:
    """The lines of a sentence folded to ``width`` characters; the second and later lines are indented."""
    return wrap(text, width, subsequent_indent="    ", break_long_words=False, break_on_hyphens=False) or [""]


def side_by_side(sizes: Sequence[int], repeated: int, width: int) -> list[list[int]]:
    """Split a table's columns into tables that fit ``width``; return the indices of the columns of each table.

    Args:
        sizes: Width of each column in characters, with the space between columns.
        repeated: Number of first columns, which every table repeats.
        width: Characters of a line.
    """
    tables = [list(range(repeated))]
    for column in range(repeated, len(sizes)):
        if len(tables[-1]) > repeated and sum(sizes[i] for i in (*tables[-1], column)) > width:
            tables.append(list(range(repeated)))
        tables[-1].append(column)
    return tables


def listed(names: Iterable[str], length: int = 600) -> str:
    """Names joined with commas for a message, each shortened, and the whole no longer than ``length`` characters."""
    return shortened(", ".join(shortened(name) for name in names), length)


def is_file(path: str | Path) -> bool:
    """Whether ``path`` is a file; False for a path that no file can have (too long, a zero byte)."""
    with suppress(OSError, ValueError):
        return Path(path).is_file()
    return False


def _name(path: str | Path) -> str:
    return shortened(path, 300)


def reason_of(error: Exception) -> str:
    """An error's own words on one line, without Python's advice to programmers."""
    text = getattr(error, "strerror", None) or str(error) or type(error).__name__
    return shortened(re.sub(r"\s+", " ", re.sub(r"; use sys\.set_int_max_str_digits\(\).*", "", text)), 200)
