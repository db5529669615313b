"""Batches of arms: one `Plant` whose numbers may be arrays with one entry per arm.

The functions select an arm, or convert the arrays. In a batch of N arms, link parameters of the geometry are ``(N, n)``
and other numbers ``(N,)``. A number that all arms share stays a plain number. Base and tool are shared, or have one
entry per arm too.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, is_dataclass, replace
from typing import Any

from pickenv.arm.kinematics.forward import Scalar
from pickenv.arm.kinematics.geometry import LINK_PARAMETERS, Array, Geometry, Pose
from pickenv.arm.plant.plant import Plant


def plant_count(plants: Plant) -> int | None:
    """Return the number of arms in a batch, or None for a single arm."""
    return None if plants.geometry.alpha.ndim == 1 else len(plants.geometry.alpha)


def plant_at(plants: Plant, i: int) -> Plant:
    """Return the plant of arm ``i`` (from 0) of a batch, with plain numbers.

    Raises:
        IndexError: If there is no such arm.
    """
    count = plant_count(plants)
    if count is None or not -count <= i < count:
        raise IndexError(f"there is no arm {i} in this plant of {count or 1} arms")

    def own(values: Array) -> Any:
        return values[i] if values.ndim > 1 else float(values[i])

    load, effects = tree_map(own, (plants.load, plants.effects))
    geometry = with_links(plants.geometry, lambda values: values[i])
    return replace(plants, geometry=geometry, load=load, effects=effects, ready=None)


def plants_on(plants: Plant, change: Callable[[Array], Scalar]) -> Plant:
    """Return a batch of arms with a function applied to each of its arrays, for example to move it to a GPU.

    The sines and cosines of the link parameters are converted too, instead of being computed anew. Therefore an arm has
    the same numbers, bit by bit, in a batch of any size. A single arm is returned unchanged.

    Args:
        plants: A batch of arms.
        change: Function from an array to the new array, for example
            ``lambda values: torch.as_tensor(values, dtype=torch.float32, device="cuda")`` or, to select some arms,
            ``lambda values: values[rows]``.
    """
    if plant_count(plants) is None:
        return plants
    geometry = with_links(plants.geometry, change)
    load, effects, chain = tree_map(change, (plants.load, plants.effects, plants.chain))  # in `arrays_of`'s order
    return replace(plants, geometry=geometry, load=load, effects=effects, ready=(geometry, chain))


def arrays_of(plants: Plant) -> list[Any]:
    """Return all arrays of a batch of arms in a fixed order, so that other arms can be written into them.

    The list is empty for a single arm.
    """
    if plant_count(plants) is None:
        return []
    links = tuple(getattr(plants.geometry, name) for name in LINK_PARAMETERS)
    return leaves((links, plants.load, plants.effects, plants.chain))


def with_links(geometry: Geometry, change: Callable[..., Any], *others: Geometry) -> Geometry:
    """Return the geometry with a function applied to each of its link parameters.

    If the bases or tools of a batch of arms differ, the function is applied to bases or tools too.

    Args:
        geometry: The geometry.
        change: Function that returns the new array. Its arguments are the array of ``geometry`` and those of
            ``others``.
        others: Geometries whose arrays the function needs too.
    """
    tables = (geometry, *others)
    values: dict[str, Any] = {name: change(*(getattr(table, name) for table in tables)) for name in LINK_PARAMETERS}
    for name in ("base", "tool"):
        if getattr(geometry, name).position.ndim > 1:
            values[name] = Pose(*map(change, *(getattr(table, name) for table in tables)))
    return replace(geometry, **values)


# Trees of numbers: tuples, named tuples and dataclasses, nested, whose leaves are arrays of NumPy or torch. An array
# with at least one axis is a leaf; numbers, words and None stay as they are, and so does a dataclass whose class says
# ``shared = True``: its arrays belong to all arms together, not one entry to each.


def tree_map(change: Callable[[Any], Any], tree: Any) -> Any:
    """Return a tree with ``change`` applied to each of its arrays.

    Args:
        change: Function from an array to the new array.
        tree: Nested tuples, named tuples and dataclasses, whose leaves are arrays or tensors. Other values, and
            dataclasses with the class attribute ``shared = True``, are unchanged.
    """
    if getattr(tree, "ndim", 0):
        return change(tree)
    if isinstance(tree, tuple):
        parts = (tree_map(change, part) for part in tree)
        return type(tree)(*parts) if hasattr(tree, "_fields") else tuple(parts)
    if _opens(tree):
        return replace(tree, **{field.name: tree_map(change, getattr(tree, field.name)) for field in fields(tree)})
    return tree


def leaves(tree: Any) -> list[Any]:
    """Return the arrays of a tree (see `tree_map`), in the order of its entries and fields, without copying them."""
    if getattr(tree, "ndim", 0):
        return [tree]
    if _opens(tree):
        tree = tuple(getattr(tree, field.name) for field in fields(tree))
    return [leaf for part in tree for leaf in leaves(part)] if isinstance(tree, tuple) else []


def _opens(tree: Any) -> bool:
    """Return whether ``tree`` is a dataclass whose fields may hold leaves; False if its class is marked as shared."""
    return is_dataclass(tree) and not isinstance(tree, type) and not getattr(tree, "shared", False)
