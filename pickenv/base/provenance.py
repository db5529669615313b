"""Provenance of results: package versions, a fingerprint of the code, command lines, and hashes of files."""

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
    """Return, by name, the versions of pickenv, NumPy, Python, packages that extend pickenv, and ``packages``.

    Packages that are not installed are left out.
    """
    numbers = {"pickenv": pickenv.__version__, "numpy": np.__version__, "python": platform.python_version()}
    numbers |= registry.packages()
    for name in packages:
        with suppress(PackageNotFoundError):
            numbers[name] = version(name)
    return numbers


def command_line(*words: object, **options: object) -> str:
    """Return a command line with shell quoting; the arguments are those of `command_words`."""
    return shlex.join(command_words(*words, **options))


def command_words(*words: object, **options: object) -> list[str]:
    """Return the words of a command line.

    Args:
        words: Command and positional arguments.
        options: Values of options, by name with underscores. True makes a flag; None and False leave the option out.
            For a list, the option is repeated with each entry. A tuple in a list gives one option several words.
    """
    line = [str(word) for word in words]
    for name, value in options.items():
        option = f"--{name.replace('_', '-')}"
        for part in value if isinstance(value, list | tuple) else [value]:
            if part is not None and part is not False:
                line += [option] if part is True else [option, *map(str, part if isinstance(part, tuple) else (part,))]
    return line


SHOWS = ("cli.py", "commands/", "pictures/", *(f"inspect/{shelf}/" for shelf in ("figures", "films", "recordings")))
"""Paths of code that only displays results. A change in it does not change `code_fingerprint`, so stored results stay
valid."""


def code_fingerprint() -> str:
    """Return one SHA-256 over all that affects results: code and tables of pickenv (.py, .toml), and its extensions.

    Folders that symbolic links lead to are included. The files are read once per process. Packages that extend pickenv
    enter with the names and versions that `registry.packages` returns at the time of the call.
    """
    others = "".join(f"{package} {number}\n" for package, number in registry.packages().items())
    return hashlib.sha256(f"{_own_code()}{others}".encode()).hexdigest()


@cache
def _own_code() -> str:
    """Return a text with one line for each file of pickenv's code: the file's path and SHA-256."""
    root = Path(__file__).parents[1]
    files = (Path(folder) / name for folder, _, names in os.walk(root, followlinks=True) for name in names)
    code = {path.relative_to(root).as_posix(): path for path in files if path.suffix in (".py", ".toml")}
    return "".join(f"{place} {file_sha256(code[place])}\n" for place in sorted(code) if not place.startswith(SHOWS))


def made_with() -> dict[str, str]:
    """Return the package versions to record in a file, and the fingerprint of the code under the key "code"."""
    return versions() | {"code": code_fingerprint()}


def file_sha256(path: Path) -> str:
    """Return the SHA-256 of a file's bytes, in hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
