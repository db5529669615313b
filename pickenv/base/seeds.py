"""Random streams for all that a comparison or a training draws; no two seeds, arms or purposes share a stream.

Streams are not numbered ``seed + i``: environment 1 of seed 0 would be environment 0 of seed 1. Neighbouring seeds
themselves are safe with NumPy's `SeedSequence`. The module also limits linear algebra to one thread: for small
matrices, several threads cost more than they save, most of all on a busy machine.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Literal, get_args

import numpy as np
from threadpoolctl import ThreadpoolController  # type: ignore[import-untyped]

from pickenv.base.errors import InputError

Purpose = Literal[
    "arms", "fruit", "policy", "calibration", "training", "camera", "picks", "day", "grasps", "leaderboard", "datasets",
    "constants",
]  # fmt: skip
"""What the numbers of a random stream are for; the order of the names is part of the streams."""


def stream(seed: int, purpose: Purpose, *numbers: int) -> np.random.SeedSequence:
    """The random stream of a seed for one purpose, or for one numbered arm or block within it.

    Args:
        seed: The seed of the run.
        purpose: What is drawn from it.
        numbers: Numbers within the purpose, such as the number of the arm.
    """
    return np.random.SeedSequence(seed, spawn_key=(get_args(Purpose).index(purpose), *numbers))


def seed_words(sequence: np.random.SeedSequence, count: int) -> list[int]:
    """Seeds below 2^62 for generators that take whole numbers; a longer list begins with the shorter one."""
    return [int(word) >> 2 for word in sequence.generate_state(count, np.uint64)]


RUN = 2**16
"""Number of seeds, one per environment, that `run_seed` sets aside for each run, and the number of runs."""


def run_seed(run: int) -> int:
    """A seed for a client that takes one number and counts on from it, as Gymnasium does: environment i gets seed + i.

    Runs 0, 1, 2 … begin 65,536 apart, so that none of their environments share an episode. Seeds are below 2^32, as
    NumPy's old generators and most clients need.

    Args:
        run: Number of the run, below 65,536.

    Raises:
        InputError: If there is no such run.
    """
    if isinstance(run, bool) or not isinstance(run, int | np.integer) or not 0 <= run < RUN:
        raise InputError(f"run is {run!r}; give a whole number from 0 to {RUN - 1}")
    return int(run) * RUN


_controller = cache(ThreadpoolController)  # looking the libraries up takes milliseconds, so once


@contextmanager
def single_threaded() -> Iterator[None]:
    """A context, or a decorator of functions, in which NumPy's linear algebra runs on one thread."""
    with _controller().limit(limits=1, user_api="blas"):
        yield


@contextmanager
def torch_on_one_thread() -> Iterator[None]:
    """A context with torch on one thread, which is faster for small networks and always adds in the same order."""
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)
