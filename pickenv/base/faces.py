"""Lazy imports: a package exports the names in its stub, and imports a module when a name of it is first used."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import lazy_loader

from pickenv.base.extras import extra_of, missing


def offered(package: str, file: str) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """Return ``__getattr__``, ``__dir__`` and ``__all__`` for a package that lazily exports what its stub imports.

    Using a name raises `MissingExtra` if its module needs an extra (optional package) that is not installed.

    Args:
        package: Name of the package.
        file: Path of the package's ``__init__.py``. The stub, ``__init__.pyi``, is in the same folder.
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
