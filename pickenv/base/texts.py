"""Read text files, and report a wrong kind of file, a wrong encoding or a parser's error in one clear sentence.

Readers of CSV, TOML, YAML, URDF and MJCF call `read_text` and `parsed`. Each error is an `InputError` that names the
file. `shortened` cuts quotations in messages to one line. `decimal_number` decides which text is a number.
"""

from __future__ import annotations

import codecs
import difflib
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
Progress = Callable[[str, int, int], None]
"""A function that is called with the name of a stage, its number of finished parts, and its number of all parts."""

PIECE = 1 << 20
"""Number of bytes read at once."""

LARGEST = 1 << 30
"""Largest size of a text file that is read, bytes. The files of pickenv are much smaller."""

MARKS = {"UTF-32": (codecs.BOM_UTF32_LE, codecs.BOM_UTF32_BE), "UTF-16": (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)}
"""Byte order marks of encodings that are refused, by encoding, the longest first."""


def read_text(path: str | Path, kind: str) -> str:
    """Return the text of a UTF-8 file, a pipe, or /dev/stdin.

    A byte order mark is removed. Line ends are kept as they are.

    Args:
        path: The file.
        kind: What the file should be, for messages: "a CSV file".

    Raises:
        InputError: If the file is missing, a folder, a device, too large, or not UTF-8 text. The message says which.
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
    """Return the result of ``parse()``, and turn every exception into an `InputError`.

    Args:
        parse: Function that parses the file's text.
        path: The file, for the message.
        kind: Format of the file, for the message: "TOML".

    Raises:
        InputError: If ``parse`` raises. The message says that ``path`` is not valid ``kind``, and why.
    """
    try:
        return parse()
    except RecursionError as error:
        raise InputError(f"{path} is not valid {kind}: it is nested too deeply; give tables of a few levels") from error
    except Exception as error:
        raise InputError(f"{path} is not valid {kind}: {reason_of(error)}") from error


@contextmanager
def in_file(path: str | Path) -> Iterator[None]:
    """Return a context that puts the file's name before the message of every `InputError`.

    Raises:
        InputError: For every `InputError` in the context.
    """
    try:
        yield
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def yaml_content(text: str, path: str | Path) -> Any:
    """Return the content of a YAML text as plain mappings, lists, numbers and strings.

    Aliases and Python tags are refused.

    Args:
        text: The YAML text.
        path: The file that has the text, for messages.

    Raises:
        InputError: If the text is not valid YAML, or has an alias or a Python tag.
    """
    import yaml  # late: most files are none

    class Plain(yaml.SafeLoader):
        """A YAML loader that refuses aliases, with which a few lines can expand without limit."""

        def compose_node(self, parent: Any, index: Any) -> Any:
            if self.check_event(yaml.AliasEvent):
                raise ValueError("it uses an alias (*name); write the values out")
            return super().compose_node(parent, index)

    return parsed(lambda: yaml.load(text, Plain), path, "YAML")  # a safe loader


def decimal_number(text: str) -> float | None:
    """Return the number that ``text`` spells in ASCII, possibly nan or infinite; None if it is not a number."""
    try:
        return float(text) if text.isascii() and "_" not in text else None  # no 1_000, and no digits of any script
    except ValueError:
        return None


def one_line(text: str) -> str:
    """Return ``text`` with every unprintable character, such as a line end, replaced by a space."""
    return "".join(c if c.isprintable() else " " for c in text)


def shortened(value: object, length: int = 60) -> str:
    """Return ``value`` as text on one line, cut to at most ``length`` characters, to be quoted in a message."""
    try:
        text = str(value) if not isinstance(value, str) else value
    except ValueError:  # an integer of more than 4300 digits
        return "a number of thousands of digits"
    text = one_line(text[: 4 * length])
    return text if len(text) <= length else f"{text[: length - 2].rstrip()} …"


UNBOUNDED = 100_000
"""Line width used where the output is not a terminal, characters."""


def screen_width(otherwise: int = UNBOUNDED) -> int:
    """Return the width of a line in characters.

    It is the environment variable COLUMNS if set, else the terminal's width, or ``otherwise`` without a terminal.
    """
    return shutil.get_terminal_size((otherwise, 24)).columns


def folded(text: str, width: int) -> list[str]:
    """Return a text's lines, wrapped at ``width`` characters; all lines but the first are indented by four spaces."""
    return wrap(text, width, subsequent_indent="    ", break_long_words=False, break_on_hyphens=False) or [""]


def side_by_side(sizes: Sequence[int], repeated: int, width: int) -> list[list[int]]:
    """Split a wide table into several tables that fit ``width``, and return the column indices (from 0) of each table.

    Args:
        sizes: Width of each column, including the space between columns, characters.
        repeated: Number of leading columns that every table repeats.
        width: Width of a line, characters.
    """
    tables = [list(range(repeated))]
    for column in range(repeated, len(sizes)):
        if len(tables[-1]) > repeated and sum(sizes[i] for i in (*tables[-1], column)) > width:
            tables.append(list(range(repeated)))
        tables[-1].append(column)
    return tables


def listed(names: Iterable[str], length: int = 600) -> str:
    """Return names joined with commas for a message, each shortened, in at most ``length`` characters."""
    return shortened(", ".join(shortened(name) for name in names), length)


def unknown(what: str, name: str, known: Sequence[str], where: str = "") -> str:
    """Return a message on a name that is not known, with the known name that is most like it, and all of them.

    Args:
        what: What is named: "key".
        name: The name.
        known: The known names.
        where: Words after the name, such as " in [load]".
    """
    near = difflib.get_close_matches(name, known, 1, 0.5)
    perhaps = f"perhaps {near[0]} is meant: " if near else ""
    return f"unknown {what} '{shortened(name)}'{where}; {perhaps}known are {listed(known)}"


def is_file(path: str | Path) -> bool:
    """Return whether ``path`` is a file; False for a path that no file can have (too long, with a zero byte)."""
    with suppress(OSError, ValueError):
        return Path(path).is_file()
    return False


def _name(path: str | Path) -> str:
    return shortened(path, 300)


def reason_of(error: Exception) -> str:
    """Return an exception's message on one line, without Python's hint about ``sys.set_int_max_str_digits``."""
    text = getattr(error, "strerror", None) or str(error) or type(error).__name__
    return shortened(re.sub(r"\s+", " ", re.sub(r"; use sys\.set_int_max_str_digits\(\).*", "", text)), 200)
