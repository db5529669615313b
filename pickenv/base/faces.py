"""Packages that load lazily: each offers the names of its stub, and loads a module when its name is first used."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import lazy_loader

from pickenv.base.extras import extra_of, missing


def offered(package: str, file: str) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """The ``__getattr__``, ``__dir__`` and ``__all__`` of a package: it offers what its stub imports.

    Args:
        package: Name of the package.
        file: The package's ``__init__.py``; the stub, ``__init__.pyi``, stands beside it.
    """
    load, directory, names = lazy_loader.attach_stub(package, file)

    def attribute(name: str) -> Any:
        try:
            return load(name)
        except ModuleNotFoundError as error:
            if error.name is None or extra_of(error.name) is None:
                raise
            raise missing(error.name) from error

    return attribute, directory, names
