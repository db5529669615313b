"""Save frozen dataclasses of numbers and arrays as files, and read them back exactly without executing anything.

A file is a container (`pickenv.base`): a header in JSON, which names arrays, and the arrays. Reading creates only
objects of these classes: the class that the caller names, its subclasses, registered effects, and all classes in the
type hints of these classes.
"""

from __future__ import annotations

import typing
from collections.abc import Callable, Mapping
from dataclasses import asdict, fields, is_dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from pickenv.arm import Array
from pickenv.arm.plant.plant_file import shipped_effects
from pickenv.base import InputError, read_container, refusing_damage, registry, write_container
from pickenv.inspect.runs.recorded_episodes import Comparison


def capsules(points: Array, parts: list[int]) -> tuple[Array, Array, Array]:
    """Return capsules (rods with round ends) along some segments of polylines.

    Args:
        points: Points of the polylines ``(..., K, 3)``, m.
        parts: Indices, from 0, of the first points of the P segments, from `drawn_parts`.

    Returns:
        Centres of the capsules' first ends ``(..., P, 3)``, m; distances between the centres of their two ends ``(...,
        P)``, m; quaternions that turn the z axis into their directions ``(..., P, 4)``, order x, y, z, w.
    """
    start, end = points[..., parts, :], points[..., [i + 1 for i in parts], :]
    along = end - start
    length = np.linalg.norm(along, axis=-1)
    safe = np.where(length > 1e-9, length, 1.0)[..., None]
    direction = np.where(length[..., None] > 1e-9, along / safe, [0.0, 0.0, 1.0])
    # Half-way quaternion from z to the direction; straight down is turned about x.
    w = 1.0 + direction[..., 2]
    down = w < 1e-9
    quaternion = np.stack([-direction[..., 1], direction[..., 0], np.zeros_like(w), w], axis=-1)
    quaternion[down] = [1.0, 0.0, 0.0, 0.0]
    quaternion /= np.linalg.norm(quaternion, axis=-1, keepdims=True)
    return start, length, quaternion


# Where the eye stands: at one point for every picture of a comparison, on screen and on paper. Metres, radians.


EYE_TURN, EYE_LIFT = 0.5, 0.45
"""Angles of the camera beside and above the normal of the field's widest upright face, rad."""


def shown_box(comparison: Comparison) -> tuple[Array, float]:
    """Return the centre ``(3,)`` and the radius of the box of the field's grid, m; the camera looks at the centre."""
    size = comparison.grid.size
    return comparison.grid.corner + size / 2.0, float(np.linalg.norm(size) / 2.0)


def eye_direction(comparison: Comparison) -> Array:
    """Return the unit vector ``(3,)`` from the field to the camera.

    The camera looks obliquely at the widest upright face of the field's box, from the side away from the arm's base. In
    an oblique view, front cells hide fewer of the cells behind.
    """
    width_x, width_y, _ = comparison.grid.shape
    x, y, _ = shown_box(comparison)[0] - comparison.nominal.base.position
    outward = float(np.arctan2(y, x))
    along_x = width_y > width_x or (width_y == width_x and abs(x) > abs(y))
    normal = float(np.arctan2(0.0, x) if along_x else np.arctan2(y, 0.0))
    side = 1.0 if np.sin(outward - normal) >= 0.0 else -1.0
    turn = normal + side * EYE_TURN
    return np.array([np.cos(turn) * np.cos(EYE_LIFT), np.sin(turn) * np.cos(EYE_LIFT), np.sin(EYE_LIFT)])


def cut_away(comparison: Comparison) -> NDArray[np.bool_]:
    """Return whether each point of the field ``(F,)`` is in the corner that is nearest to the camera.

    Voxels in that corner would hide all others.
    """
    offset = comparison.grid.points - shown_box(comparison)[0]
    return np.asarray(np.all(offset * np.sign(eye_direction(comparison)) > 0.0, axis=-1))


LARGEST = 1 << 34
"""Largest size of a file, and of its unpacked content, bytes; it is large because recorded episodes are."""
FORMAT, FORMATS = 3, {"Comparison": 4, "RecordedEpisodes": 4, "HarvestTrace": 4}
"""Format version of the files of most classes, and the format versions of the classes with another one, by name."""

Saved = TypeVar("Saved")


def save_numbers(path: str | Path, value: Any, *, seed: int | None = None, kind: type | None = None) -> Path:
    """Write a frozen dataclass to ``path`` (.npz) atomically, and return the path; equal values give equal bytes.

    Args:
        path: The file.
        value: The object: dataclasses, named tuples, tuples, mappings, arrays, numbers, text and None, nested.
        seed: Seed of the run that made the object, for the record.
        kind: Class that is named in the file: the object's class (when left out) or one of its base classes.

    Raises:
        InputError: If the file cannot be written.
    """
    arrays: dict[str, np.ndarray] = {}
    sources: dict[str, Any] = {}
    header = {"seed": seed, "content": _pack(value, arrays, sources)} | ({"others": sources} if sources else {})
    name = (kind or type(value)).__name__
    return write_container(path, name, header, arrays, version=FORMATS.get(name, FORMAT), compressed=True)


def load_numbers(path: str | Path, kind: type[Saved], made_by: str) -> Saved:
    """Read the object in a file that `save_numbers` wrote.

    Args:
        path: The file.
        kind: The class that the file must hold.
        made_by: The command that makes the file, for error messages.

    Raises:
        InputError: If the file is missing, damaged in any byte, of another kind, or of another version. Also if it
            needs the effect of a package that is not installed; the message names the package.
    """
    remake = f"`{made_by}` makes it anew"
    version = FORMATS.get(kind.__name__, FORMAT)
    container = read_container(path, kind.__name__, remake=remake, version=version, limit=LARGEST)
    effects = [registry.get("effect", name) for name in shipped_effects()]
    try:
        others = {key: registry.get(*key.split(" "), **by) for key, by in container.header.get("others", {}).items()}
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    classes = _classes(kind, *kind.__subclasses__(), *effects, *others.values()) | others
    with refusing_damage(path, f"a {kind.__name__} file", remake):
        content = _unpack(container.header["content"], container.arrays, classes)
        if not isinstance(content, kind):
            raise TypeError(f"it holds a {type(content).__name__}")
    return content


def _pack(value: Any, arrays: dict[str, np.ndarray], sources: dict[str, Any]) -> Any:
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
        kind = type(value).__name__
        registered = registry.registered_as(type(value))
        if registered is not None and (source := registry.origin(*registered)).package != "pickenv":
            kind = " ".join(registered)
            sources[kind] = asdict(source)
        return {"class": kind, "fields": {name: _pack(getattr(value, name), arrays, sources) for name in names}}
    if isinstance(value, tuple | list):
        return {"tuple": [_pack(item, arrays, sources) for item in value]}
    if isinstance(value, Mapping):
        return {"mapping": [[_pack(part, arrays, sources) for part in pair] for pair in value.items()]}
    raise TypeError(f"a {type(value).__name__} cannot be saved; give arrays, numbers, text, or dataclasses of them")


def _unpack(packed: Any, arrays: Mapping[str, np.ndarray], classes: Mapping[str, Callable[..., Any]]) -> Any:
    if not isinstance(packed, dict):
        return packed
    if "array" in packed:
        return arrays[packed["array"]]
    if "tuple" in packed:
        return tuple(_unpack(item, arrays, classes) for item in packed["tuple"])
    if "mapping" in packed:
        pairs = packed["mapping"]
        return {_unpack(key, arrays, classes): _unpack(item, arrays, classes) for key, item in pairs}
    return classes[packed["class"]](**{name: _unpack(item, arrays, classes) for name, item in packed["fields"].items()})


def _classes(*roots: Any) -> dict[str, Any]:
    """Return the dataclasses and named tuples in ``roots`` and in their type hints, recursively, by name."""
    classes: dict[str, Any] = {}
    hints = [*roots]
    while hints:
        hint = hints.pop()
        hints += typing.get_args(hint)
        is_record = isinstance(hint, type) and (is_dataclass(hint) or hasattr(hint, "_fields"))
        if is_record and hint.__name__ not in classes:
            classes[hint.__name__] = hint
            hints += typing.get_type_hints(hint).values()
    return classes
