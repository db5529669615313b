"""Faces of rooms: a package offers names of its modules, and loads a module when a name of it is first asked for."""

from __future__ import annotations

import ast
import sys
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

from pickenv.extras import extra_of, missing


def offered(package: str) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """The ``__getattr__`` and the ``__dir__`` of a package: it offers what it imports for type checkers alone.

    Args:
        package: Its name; the imports stand under ``if TYPE_CHECKING`` in its own file.
    """
    face = ast.parse(Path(str(sys.modules[package].__file__)).read_text(encoding="utf-8"))
    imports = [node for block in face.body if isinstance(block, ast.If) for node in block.body]
    homes = {a.name: node.module for node in imports if isinstance(node, ast.ImportFrom) for a in node.names}

    def attribute(name: str) -> Any:
        if name not in homes:
            raise AttributeError(f"module '{package}' has no attribute '{name}'")
        try:
            if homes[name] == package:  # a room of the package itself
                return import_module(f"{package}.{name}")
            return getattr(import_module(str(homes[name])), name)
        except ModuleNotFoundError as error:
            if error.name is None or extra_of(error.name) is None:
                raise
            raise missing(error.name) from error

    return attribute, lambda: sorted(homes)
