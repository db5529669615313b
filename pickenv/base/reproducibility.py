"""Reproducible results: random streams, one thread, and a record of versions, code and command lines.

No two seeds, arms or purposes share a random stream. Streams are not numbered ``seed + i``, because environment 1 of
seed 0 would then equal environment 0 of seed 1. Neighbouring seeds are safe with NumPy's `SeedSequence`.

The module also limits linear algebra and torch to one thread. For small matrices, several threads cost more time than
they save, most of all on a busy machine.
"""

from __future__ import annotations

import hashlib
import os
import platform
import shlex
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Literal, get_args

import numpy as np
from threadpoolctl import ThreadpoolController  # type: ignore[import-untyped]

import pickenv
from pickenv.base import registry
from pickenv.base.errors import InputError

Purpose = Literal[
    "arms", "fruit", "policy", "calibration", "training", "camera", "picks", "day", "grasps", "leaderboard", "datasets",
    "constants",
]  # fmt: skip
"""Purposes of random streams. The position of a purpose in this list seeds its streams, so the order must not
change."""


def stream(seed: int, purpose: Purpose, *numbers: int) -> np.random.SeedSequence:
    """Return the seed sequence for one purpose of a run, or for one numbered item within the purpose.

    Args:
        seed: The seed of the run.
        purpose: What the random numbers are used for: "arms", "fruit" or another word of `Purpose`.
        numbers: Indices within the purpose, from 0, such as the index of an arm.
    """
    return np.random.SeedSequence(seed, spawn_key=(get_args(Purpose).index(purpose), *numbers))


def seed_words(sequence: np.random.SeedSequence, count: int) -> list[int]:
    """Return ``count`` integer seeds below 2^62, made from a seed sequence, for generators that take integers.

    A larger ``count`` only adds seeds at the end of the list.
    """
    return [int(word) >> 2 for word in sequence.generate_state(count, np.uint64)]


RUN = 2**16
"""Number of seeds that `run_seed` reserves for each run, one per environment. It is also the number of runs."""


def run_seed(run: int) -> int:
    """Return the first seed of a run, for a client such as Gymnasium that gives environment i this seed plus i.

    The first seeds of runs 0, 1, 2 … are 65,536 apart, so that environments of different runs never share an episode.
    All seeds are below 2^32, as NumPy's legacy generators and most clients require.

    Args:
        run: Number of the run, from 0 to 65,535.

    Raises:
        InputError: If there is no such run.
    """
    if isinstance(run, bool) or not isinstance(run, int | np.integer) or not 0 <= run < RUN:
        raise InputError(f"run is {run!r}; give a whole number from 0 to {RUN - 1}")
    return int(run) * RUN


_controller = cache(ThreadpoolController)  # looking the libraries up takes milliseconds, so once


@contextmanager
def single_threaded() -> Iterator[None]:
    """Return a context, also usable as a decorator, in which NumPy's linear algebra (BLAS) uses one thread."""
    with _controller().limit(limits=1, user_api="blas"):
        yield


@contextmanager
def torch_on_one_thread() -> Iterator[None]:
    """Return a context in which torch uses one thread.

    One thread is faster for small networks, and always adds numbers in the same order.
    """
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


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
    """Return a command line with shell quoting; `command_words` explains the arguments."""
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
