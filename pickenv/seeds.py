"""Seeds of everything that a comparison or a training draws: streams that no two seeds, arms or purposes share.

Neighbouring seeds are no trouble to NumPy's `SeedSequence`, but ``seed + i`` is: environment 1 of seed 0 would be
environment 0 of seed 1.
"""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np

Purpose = Literal[
    "arms", "fruit", "policy", "calibration", "training", "camera", "picks", "day", "grasps", "leaderboard"
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
