"""Trees of numbers: tuples, named tuples and dataclasses, nested, whose leaves are arrays of NumPy or torch.

An array with at least one axis is a leaf; numbers, words and None stay as they are, and so does a dataclass whose class
says ``shared = True``: its arrays belong to all arms together, not one entry to each.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, is_dataclass, replace
from typing import Any


def tree_map(change: Callable[[Any], Any], tree: Any) -> Any:
    """The tree with ``change`` applied to each of its arrays."""
    if getattr(tree, "ndim", 0):
        return change(tree)
    if isinstance(tree, tuple):
        parts = (tree_map(change, part) for part in tree)
        return type(tree)(*parts) if hasattr(tree, "_fields") else tuple(parts)
    if _opens(tree):
        return replace(tree, **{field.name: tree_map(change, getattr(tree, field.name)) for field in fields(tree)})
    return tree


def leaves(tree: Any) -> list[Any]:
    """All arrays of the tree, in the order of its entries and fields; each is the tree's own, not a copy."""
    if getattr(tree, "ndim", 0):
        return [tree]
    if _opens(tree):
        tree = tuple(getattr(tree, field.name) for field in fields(tree))
    return [leaf for part in tree for leaf in leaves(part)] if isinstance(tree, tuple) else []


def _opens(tree: Any) -> bool:
    """Whether it is a dataclass to go through."""
    return is_dataclass(tree) and not isinstance(tree, type) and not getattr(tree, "shared", False)
