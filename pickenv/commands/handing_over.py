"""How a command hands over its results: saved first, then printed, so that a screen that fails costs nothing."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path


def deliver(save: Iterable[Callable[[], Path | Iterable[Path]]], show: Callable[[], object]) -> None:
    """Save results, then print them; where saving fails they are printed all the same, before the error is raised.

    Args:
        save: One call per file, or per group of files; each returns what it wrote.
        show: Prints the results; "wrote …" follows for every file.
    """
    written: list[Path] = []
    try:
        for write in save:
            found = write()
            written += [found] if isinstance(found, Path) else found
    finally:
        show()
        for path in written:
            print(f"wrote {path}")
