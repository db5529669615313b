"""Where a number comes from: the versions and the code that computed it, and the hash of a file."""

from __future__ import annotations

import hashlib
import os
import platform
import shlex
from contextlib import suppress
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np

import pickenv
from pickenv.base import registry


def versions(*packages: str) -> dict[str, str]:
    """Versions of what computed numbers: pickenv, NumPy, Python, packages that extend it, and named ones if there."""
    numbers = {"pickenv": pickenv.__version__, "numpy": np.__version__, "python": platform.python_version()}
    numbers |= registry.packages()
    for name in packages:
        with suppress(PackageNotFoundError):
            numbers[name] = version(name)
    return numbers


def command_line(*words: object, **options: object) -> str:
    """A command as a shell reads it; arguments as `command_words` has them."""
    return shlex.join(command_words(*words, **options))


def command_words(*words: object, **options: object) -> list[str]:
    """A command word by word.

    Args:
        words: Command and arguments.
        options: Values of options; True is a flag, a list repeats its option, None and False leave it out.
    """
    line = [str(word) for word in words]
    for name, value in options.items():
        option = f"--{name.replace('_', '-')}"
        for part in value if isinstance(value, list | tuple) else [value]:
            if part is not None and part is not False:
                line += [option] if part is True else [option, str(part)]
    return line


SHOWS = ("cli.py", "commands/", "pictures/", *(f"inspect/{shelf}/" for shelf in ("figures", "films", "recordings")))
"""What shows numbers and makes none: a change of it leaves kept work as it is."""


def code_fingerprint() -> str:
    """SHA-256 over the code and tables (.py, .toml) that make numbers, links of a checkout included.

    Our own are read once. Packages of others that extend pickenv count by name and version, as they are in use now.
    """
    others = "".join(f"{package} {number}\n" for package, number in registry.packages().items())
    return hashlib.sha256(f"{_own_code()}{others}".encode()).hexdigest()


@cache
def _own_code() -> str:
    """A line for each file: its place and its hash."""
    root = Path(__file__).parents[1]
    files = (Path(folder) / name for folder, _, names in os.walk(root, followlinks=True) for name in names)
    code = {path.relative_to(root).as_posix(): path for path in files if path.suffix in (".py", ".toml")}
    return "".join(f"{place} {file_sha256(code[place])}\n" for place in sorted(code) if not place.startswith(SHOWS))


def made_with() -> dict[str, str]:
    """What makes files: versions, and the fingerprint of the code ("code")."""
    return versions() | {"code": code_fingerprint()}


def file_sha256(path: Path) -> str:
    """SHA-256 of a file's bytes, in hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
