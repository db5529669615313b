"""Read presets: TOML tables in the folder `presets`, one file per kind (such as cameras) and one table per preset.

Files are in degrees and millimetres, as their keys say. Objects made from them are in radians and metres.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeVar

from pickenv.base import InputError, in_file, is_file, shortened, toml_of
from pickenv.base.toml_tables import made

FOLDER = Path(__file__).parent / "presets"
Thing = TypeVar("Thing")


@lru_cache(maxsize=32)
def _tables(path: Path, _modified: int) -> tuple[dict[str, Any], str]:
    return toml_of(path)


def shipped(kind: str) -> list[str]:
    """Return the names of the presets of a kind, such as "camera", that come with pickenv."""
    path = FOLDER / f"{kind}.toml"
    return sorted(_tables(path, path.stat().st_mtime_ns)[0])


def load(kind: str, name: str | Path, thing: type[Thing] | Callable[[Mapping[str, Any]], type[Thing]]) -> Thing:
    """Read a shipped preset by its name, or the preset in a TOML file by its path.

    Args:
        kind: Kind of preset, such as "camera": the name of the presets' file, used in error messages too.
        name: Name of a shipped preset, or a path that ends in .toml. That file has the keys of one preset.
        thing: Class of the result, made by `pickenv.base.toml_tables.toml_table`; or a function that returns the class
            for a table.

    Raises:
        InputError: If the preset is unknown, or a number is missing or outside its limits. The message names the file
            and the key.
    """
    own = isinstance(name, str | Path) and Path(name).suffix == ".toml"
    path = Path(name) if own else FOLDER / f"{kind}.toml"
    if own and not is_file(path):
        raise InputError(f"{kind} file {shortened(path, 300)} does not exist; give its path or one of {shipped(kind)}")
    tables, text = _tables(path, path.stat().st_mtime_ns)
    if not own and str(name) not in tables:
        raise InputError(
            f"unknown {kind} '{shortened(name)}'; give one of {shipped(kind)} or a path to a {kind} file (.toml)"
        )
    table, label = (tables, path.stem) if own else (tables[str(name)], str(name))
    with in_file(path.name):
        kind_of_thing = thing if isinstance(thing, type) else thing(table)
    return made(kind_of_thing, table, path.name, name=label, text=text if own else "")


def loader(kind: str, thing: type[Thing]) -> Callable[[str | Path], Thing]:
    """Return a function that reads presets of one kind by name or path, as `load` does with ``kind`` and ``thing``."""

    def load_preset(name: str | Path) -> Thing:
        return load(kind, name, thing)

    load_preset.__doc__ = f"Read a {kind} by its name, one of `shipped({kind!r})`, or from a TOML file by its path."
    return load_preset
