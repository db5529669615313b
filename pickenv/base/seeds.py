"""Seeds of everything that a comparison or a training draws: streams that no two seeds, arms or purposes share.

Neighbouring seeds are no trouble to NumPy's `SeedSequence`, but ``seed + i`` is: environment 1 of seed 0 would be
environment 0 of seed 1.
"""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np

from pickenv.base.errors import InputError

Purpose = Literal[
    "arms", "fruit", "policy", "calibration", "training", "camera", "picks", "day", "grasps", "leaderboard", "datasets"
]
"""What a stream is drawn for."""


def stream(seed: int, purpose: Purpose, *numbers: int) -> np.random.SeedSequence:
    """The stream of a seed for one purpose, and there for one arm or block, if numbered.

    Args:
        seed: The seed of the run.
        purpose: What is drawn from it.
        numbers: Such as the number of the arm.
    """
    return np.random.SeedSequence(seed, spawn_key=(get_args(Purpose).index(purpose), *numbers))


def seed_words(sequence: np.random.SeedSequence, count: int) -> list[int]:
    """Seeds for what takes whole numbers, below 2^62; a longer list begins with the shorter."""
    return [int(word) >> 2 for word in sequence.generate_state(count, np.uint64)]


RUN = 2**16
"""Environments that a run of `run_seed` has to itself, and number of such runs."""


def run_seed(run: int) -> int:
    """A seed for a client that takes one number and counts on from it, as Gymnasium does: environment i gets seed + i.

    Runs 0, 1, 2 … begin 65,536 apart, so that none of their environments share an episode. Below 2^32, as NumPy's old
    generators and most clients want it.

    Args:
        run: Number of the run, below 65,536.

    Raises:
        InputError: If there is no such run.
    """
    if isinstance(run, bool) or not isinstance(run, int | np.integer) or not 0 <= run < RUN:
        raise InputError(f"run is {run!r}; give a whole number from 0 to {RUN - 1}")
    return int(run) * RUN
