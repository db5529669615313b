"""How a command hands over its results: saved first, then printed, so that a screen that fails costs nothing."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TypeAlias

Save: TypeAlias = tuple[Path | None, Callable[[Path], Path | Iterable[Path]]]
"""A file or folder, None where it was not asked for, and what writes it and returns what it wrote."""


def deliver(saves: Iterable[Save], show: Callable[[], object]) -> None:
    """Save results, then print them; where saving fails they are printed all the same, before the error is raised.

    Args:
        saves: What is written, and where.
        show: Prints the results; "wrote …" follows for every file.
    """
    written: list[Path] = []
    try:
        for path, write in saves:
            found = () if path is None else write(path)
            written += [found] if isinstance(found, Path) else found
    finally:
        show()
        for path in written:
            print(f"wrote {path}")
