"""Presets are TOML tables beside the code, one file per kind of thing, one table per preset, each with its source.

Files give degrees and millimetres and say so in every key; what leaves this module is in radians and metres.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from pickenv.errors import InputError
from pickenv.texts import is_file, read_toml, shortened

FOLDER = Path(__file__).parent
PER_SI = {"mm": 1000.0, "deg": 180.0 / float(np.pi)}  # of the unit in one metre, one radian
Thing = TypeVar("Thing")


class Preset:
    """One table that reads numbers in SI units, says which one is wrong, and refuses keys that nobody read."""

    def __init__(self, table: dict[str, Any], name: str, where: str) -> None:
        self.table, self.name, self.where, self._read = table, name, where, {"source"}

    @property
    def source(self) -> str:
        """Where the numbers come from."""
        return str(self.table.get("source", ""))

    def __contains__(self, key: str) -> bool:
        return key in self.table

    def number(self, key: str, default: float | None = None) -> float:
        """The number under ``key``; a key that ends in _mm or _deg comes back in m or rad."""
        self._read.add(key)
        return self._si(key, self.table.get(key, default))

    def numbers(self, key: str) -> tuple[float, ...]:
        """The list of numbers under ``key``, in SI units."""
        self._read.add(key)
        values = self.table.get(key)
        if not isinstance(values, list) or not values:
            raise InputError(f"{self.where}: {key} of '{self.name}' must be a list of numbers")
        return tuple(self._si(key, value) for value in values)

    def whole(self, key: str, default: int | None = None) -> int:
        """The whole number under ``key``."""
        value = self.number(key, default)
        if value != int(value):
            raise InputError(f"{self.where}: {key} of '{self.name}' is {value}; give a whole number")
        return int(value)

    def text(self, key: str, default: str = "") -> str:
        """The word under ``key``."""
        self._read.add(key)
        return str(self.table.get(key, default))

    def _si(self, key: str, value: Any) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
            given = "is missing" if value is None else f"is {value!r}"
            raise InputError(f"{self.where}: {key} of '{self.name}' {given}; give a finite number")
        return float(value) / PER_SI.get(key.rpartition("_")[2], 1.0)

    def refuse_unread(self) -> None:
        """A key that nobody reads is a misspelt one."""
        unknown = sorted(set(self.table) - self._read)
        if unknown:
            known = ", ".join(sorted(self._read))
            raise InputError(f"{self.where}: unknown key '{unknown[0]}' of '{self.name}'; it has {known}")


@lru_cache(maxsize=32)
def _tables(path: Path, _modified: int) -> dict[str, Any]:
    return read_toml(path)


def shipped(kind: str) -> list[str]:
    """Names of the presets of a kind that come with pickenv."""
    path = FOLDER / f"{kind}.toml"
    return sorted(_tables(path, path.stat().st_mtime_ns))


def load(kind: str, name: str | Path, build: Callable[[Preset], Thing]) -> Thing:
    """Read a preset by name, or the one preset of a TOML file given by its path.

    Args:
        kind: Name of the file beside this module, such as "camera"; also the word in error messages.
        name: A shipped preset, or a path that ends in .toml whose keys are those of one preset.
        build: Turns the table into the thing; it may raise `InputError` about impossible numbers.

    Raises:
        InputError: If the preset is unknown or a number is missing or impossible; names the file and the key.
    """
    path = Path(name)
    if path.suffix == ".toml":
        if not is_file(path):
            raise InputError(
                f"{kind} file {shortened(path, 300)} does not exist; give its path or one of {shipped(kind)}"
            )
        table, label = _tables(path, path.stat().st_mtime_ns), path.stem
    else:
        path = FOLDER / f"{kind}.toml"
        tables = _tables(path, path.stat().st_mtime_ns)
        if str(name) not in tables:
            raise InputError(
                f"unknown {kind} '{shortened(name)}'; give one of {shipped(kind)} or a path to a {kind} file (.toml)"
            )
        table, label = tables[str(name)], str(name)
    preset = Preset(dict(table), label, path.name)
    thing = build(preset)
    preset.refuse_unread()
    return thing
