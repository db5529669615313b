"""Frozen dataclasses of numbers and arrays as one file each, read back to the bit; nothing in a file is executed.

A NumPy archive: a header in JSON, in which arrays are named, and the arrays. What may be rebuilt is what the type hints
of the asked-for class lead to, and nothing else.
"""

from __future__ import annotations

import json
import platform
import typing
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

import pickenv
from calibration.calibration import DAMAGE
from pickenv.errors import InputError
from pickenv.files import write_whole

FORMAT = 1
"""Version of the file format; newer files are refused by older programs."""

Saved = TypeVar("Saved")


def versions() -> dict[str, str]:
    """Versions of what computed the numbers."""
    return {"pickenv": pickenv.__version__, "numpy": np.__version__, "python": platform.python_version()}


def save(path: str | Path, value: Any, *, seed: int | None = None) -> Path:
    """Write a frozen dataclass to ``path`` (.npz), whole or not at all; equal values give equal bytes.

    Args:
        path: The file.
        value: The object: dataclasses, named tuples, tuples, mappings, arrays, numbers, text and None, nested.
        seed: Seed of the run that found it, for the record.

    Raises:
        InputError: If the file cannot be written.
    """
    arrays: dict[str, np.ndarray] = {}
    header = {"format": FORMAT, "kind": type(value).__name__, "seed": seed, "versions": versions()}
    text = json.dumps(header | {"content": _pack(value, arrays)})

    def write(temporary: Path) -> None:
        with temporary.open("wb") as file:
            np.savez_compressed(file, allow_pickle=False, header=np.array(text), **arrays)

    return write_whole(path, write)


def load(path: str | Path, kind: type[Saved], made_by: str) -> Saved:
    """Read what `save` wrote.

    Args:
        path: The file.
        kind: The class that it must hold.
        made_by: The command that makes such a file, for error messages.

    Raises:
        InputError: If the file is missing, damaged, of another kind, or newer than this program.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path} does not exist; `{made_by}` makes it")
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
            arrays = {key: archive[key] for key in archive.files}
        header = json.loads(str(arrays.pop("header")))
        file_format, found = int(header["format"]), str(header["kind"])
    except DAMAGE as error:
        raise _damaged(path, made_by, error) from error
    if file_format > FORMAT:
        raise InputError(f"{path} has format {file_format}, this program reads up to {FORMAT}; update pickenv")
    if found != kind.__name__:
        raise InputError(f"{path} holds a {found}, not a {kind.__name__}; `{made_by}` makes the right one")
    try:
        content: Saved = _unpack(header["content"], arrays, _classes(kind))
    except DAMAGE as error:
        raise _damaged(path, made_by, error) from error
    return content


def _damaged(path: Path, made_by: str, error: Exception) -> InputError:
    return InputError(f"{path} is damaged or of another version ({error}); `{made_by}` makes it anew")


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
