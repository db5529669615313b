"""Random streams for comparisons and training: no two seeds, arms or purposes share a stream.

Streams are not numbered ``seed + i``, because environment 1 of seed 0 would then equal environment 0 of seed 1.
Neighbouring seeds are safe with NumPy's `SeedSequence`.

The module also limits linear algebra and torch to one thread. For small matrices, several threads cost more time than
they save, most of all on a busy machine.
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
