"""Where a number comes from: the versions and the code that computed it, and the hash of a file."""

from __future__ import annotations

import hashlib
import platform
from functools import cache
from importlib.metadata import version
from pathlib import Path

import numpy as np

import pickenv

PACKAGES = ("pickenv", "calibration", "agents")
"""The packages whose code makes numbers; they are installed side by side."""


def versions(*packages: str) -> dict[str, str]:
    """Versions of what computed the numbers: pickenv, NumPy, Python and the named packages."""
    found = {"pickenv": pickenv.__version__, "numpy": np.__version__, "python": platform.python_version()}
    return found | {name: version(name) for name in packages}


@cache
def code_fingerprint() -> str:
    """SHA-256 over the code and the tables (.py, .toml) of the installed packages, read once a process."""
    root, total = Path(__file__).parents[1], hashlib.sha256()
    for path in sorted(path for package in PACKAGES for path in (root / package).rglob("*")):
        if path.suffix in (".py", ".toml"):
            total.update(f"{path.relative_to(root).as_posix()} {file_sha256(path)}\n".encode())
    return total.hexdigest()


def file_sha256(path: Path) -> str:
    """SHA-256 of a file's bytes, in hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
