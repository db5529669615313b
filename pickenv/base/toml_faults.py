"""What is wrong in a TOML file, in one sentence: file, line, key, table, value and what to give."""

from __future__ import annotations

import difflib
import tomllib
from collections.abc import Mapping
from typing import Any

from pickenv.base.texts import listed, shortened


def lacks(error: Any) -> bool:
    """Whether an error is pydantic's own about a missing key, which we tell better."""
    return error["type"] == "missing" and "ctx" not in error


WORDS = {"literal_error": "give {expected}", "string_type": "give a text", "tuple_type": "give a list"}
"""What to do about pydantic's own errors."""


def sentence(error: Mapping[str, Any], content: Any, where: str, text: str, owner: str) -> str:
    """The sentence for one of pydantic's errors.

    Args:
        error: As pydantic gives it; parts of its place in angle brackets are tags of unions.
        content: The content of the file.
        where: The file.
        text: Its text, where lines are to be named.
        owner: What the file as a whole is called; empty for nothing.
    """
    place = [part for part in error["loc"] if not str(part).startswith("<")]
    key = error.get("ctx", {}).get("key") if error["type"] == "unknown" else None
    line = line_of(text, place if key is None else [*place, key])
    return f"{where}{f', line {line}' if line else ''}: {_fault(error, place, content, owner)}"


def _fault(error: Mapping[str, Any], place: list[Any], content: Any, owner: str) -> str:
    """Key, table, value and what to give."""
    said, kind = error.get("ctx", {}), error["type"]
    inside = _table_at(place, content) or owner
    match kind:
        case "value_error":  # a dataclass or a reader said it in a sentence of its own
            return str(said["error"])
        case "no table":
            return f"{inside or shortened(place[-1])} must be a table"
        case "unknown":
            near = difflib.get_close_matches(said["key"], said["known"], 1, 0.5)
            perhaps = f"perhaps {near[0]} is meant: " if near else ""
            given = f"'{shortened(said['key'])}'{f' in {inside}' if inside else ''}"
            return f"unknown key {given}; {perhaps}known are {listed(said['known'])}"
        case "missing":
            return f"{said['key']}{f' of {inside}' if inside else ''} is missing; {said['wanted']}"
    depth = max(i for i, part in enumerate(place) if isinstance(part, str))
    key = str(place[depth]) + "".join(f"[{part}]" for part in place[depth + 1 :])
    inside, value = _table_at(place[:depth], content) or owner, error["input"]
    brief = f"{value:g}" if isinstance(value, float) and float(f"{value:g}") == value else repr(value)
    told = WORDS[kind].format(**said) if kind in WORDS else error["msg"]
    return f"{key}{f' of {inside}' if inside else ''} is {shortened(brief)}; {told}"


def _table_at(place: list[Any], content: Any) -> str:
    """What a message calls a table: [load], joint 3, entry 2 of [backlash.joints]; empty for the file itself."""
    names = ".".join(part for part in place if isinstance(part, str))
    if not place or isinstance(place[-1], str):
        return f"[{names}]" * bool(place)
    number = _at(content, place).get("number") if isinstance(_at(content, place), Mapping) else None
    if isinstance(number, int) and len(place) == 2:
        return f"{names.removesuffix('s')} {number}"
    return f"entry {place[-1] + 1} of [{names}]"


def _at(content: Any, place: list[Any]) -> Any:
    """What stands at a place; None where nothing does."""
    for part in place:
        try:
            content = content[part]
        except (LookupError, TypeError):
            return None
    return content


CLOSING = ("", "]", "]]", "]]]", '"""', "'''")
"""What may close a value that a file's first lines leave open."""

MOST_READ = 1_000_000
"""Characters read at most to find a line; a file that would need more has its key named without one."""


def line_of(text: str, place: list[Any]) -> int | None:
    """The line, from 1, in which the value at ``place`` of a valid TOML file begins, or the table around it.

    The file is read up to each line that names the key, what is open there being closed, until it has the place, or
    `MOST_READ` is reached.
    """
    while place and _at(tomllib.loads(text), place) is None:
        place = place[:-1]
    depth = max((i for i, part in enumerate(place) if isinstance(part, str)), default=-1)
    lines, reached, left = text.split("\n") if place else [], False, MOST_READ
    for number, line in enumerate(lines, 1):
        named = place[depth] in line and not line.lstrip().startswith("#")
        reached = reached or named
        if named or (reached and depth < len(place) - 1):
            for closing in CLOSING:
                read = "\n".join([*lines[:number], closing])
                left -= len(read)
                if left < 0:
                    return None
                if _at(_parsed(read), place) is not None:
                    return number
    return None


def _parsed(text: str) -> Any:
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        return None
