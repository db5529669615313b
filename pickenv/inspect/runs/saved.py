"""Frozen dataclasses of numbers and arrays as one file each, read back to the bit; nothing in a file is executed.

A container (`pickenv.container`): a header in JSON, in which arrays are named, and the arrays. What may be rebuilt is
what the type hints of the asked-for class lead to, and nothing else.
"""

from __future__ import annotations

import typing
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from pickenv.container import read_container, refusing_damage, write_container

FORMAT = 3
"""Version of the files' content."""

Saved = TypeVar("Saved")


def save_numbers(path: str | Path, value: Any, *, seed: int | None = None) -> Path:
    """Write a frozen dataclass to ``path`` (.npz), whole or not at all; equal values give equal bytes.

    Args:
        path: The file.
        value: The object: dataclasses, named tuples, tuples, mappings, arrays, numbers, text and None, nested.
        seed: Seed of the run that found it, for the record.

    Raises:
        InputError: If the file cannot be written.
    """
    arrays: dict[str, np.ndarray] = {}
    header = {"seed": seed, "content": _pack(value, arrays)}
    return write_container(path, type(value).__name__, header, arrays, version=FORMAT, compressed=True)


def load_numbers(path: str | Path, kind: type[Saved], made_by: str) -> Saved:
    """Read what `save_numbers` wrote.

    Args:
        path: The file.
        kind: The class that it must hold.
        made_by: The command that makes such a file, for error messages.

    Raises:
        InputError: If the file is missing, damaged in any byte, of another kind, or of another version.
    """
    remake = f"`{made_by}` makes it anew"
    found = read_container(path, kind.__name__, remake=remake, version=FORMAT)
    with refusing_damage(path, f"a {kind.__name__} file", remake):
        content = _unpack(found.header["content"], found.arrays, _classes(kind))
        if not isinstance(content, kind):
            raise TypeError(f"it holds a {type(content).__name__}")
    return content


def _pack(value: Any, arrays: dict[str, np.ndarray]) -> Any:
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, np.ndarray):
        name = f"array{len(arrays)}"
        arrays[name] = value
        return {"array": name}
    names = [field.name for field in fields(value)] if is_dataclass(value) else getattr(value, "_fields", None)
    if names is not None:
        return {"class": type(value).__name__, "fields": {n: _pack(getattr(value, n), arrays) for n in names}}
    if isinstance(value, tuple | list):
        return {"tuple": [_pack(item, arrays) for item in value]}
    if isinstance(value, Mapping):
        return {"mapping": [[_pack(key, arrays), _pack(item, arrays)] for key, item in value.items()]}
    raise TypeError(f"a {type(value).__name__} cannot be saved; give arrays, numbers, text, or dataclasses of them")


def _unpack(packed: Any, arrays: Mapping[str, np.ndarray], classes: Mapping[str, type]) -> Any:
    if not isinstance(packed, dict):
        return packed
    if "array" in packed:
        return arrays[packed["array"]]
    if "tuple" in packed:
        return tuple(_unpack(item, arrays, classes) for item in packed["tuple"])
    if "mapping" in packed:
        pairs = packed["mapping"]
        return {_unpack(key, arrays, classes): _unpack(item, arrays, classes) for key, item in pairs}
    given = {name: _unpack(item, arrays, classes) for name, item in packed["fields"].items()}
    return classes[packed["class"]](**given)


def _classes(root: Any) -> dict[str, type]:
    """The dataclasses and named tuples that type hints lead to from ``root``, itself included, by name."""
    found: dict[str, type] = {}
    waiting = [root]
    while waiting:
        hint = waiting.pop()
        waiting += typing.get_args(hint)
        is_one = isinstance(hint, type) and (is_dataclass(hint) or hasattr(hint, "_fields"))
        if is_one and hint.__name__ not in found:
            found[hint.__name__] = hint
            waiting += typing.get_type_hints(hint).values()
    return found
