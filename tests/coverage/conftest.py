"""How often an interval holds the truth, on data whose truth is known.

Each test runs twice: quickly in every run, where only gross faults show, and in full by ``make coverage-of-intervals``,
where the measured coverage must lie between 93 and 97 %. An open end holds everything on its side.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import pytest

Ends = Sequence[float | None] | None


@dataclass(frozen=True)
class Repeats:
    """How often a case is drawn anew.

    Attributes:
        times: The number of times.
        full: Whether the measured coverage itself is held to 93 to 97 %, not only what chance allows.
    """

    times: int
    full: bool

    def check(
        self,
        draw: Callable[[np.random.Generator], Ends],
        truth: float,
        most: float = 0.97,
        share: float = 1.0,
        least: float = 0.93,
    ) -> None:
        """Hold the coverage of an interval to 93 to 97 %.

        Args:
            draw: Draws data and gives the interval.
            truth: What it should hold.
            most: Another upper bound, where an interval is known to be on the safe side: discrete data, open ends.
            share: Of ``times`` that is drawn, where one draw is long.
            least: Another lower bound, where the data are harder than arms are: clusters as unlike as trees.
        """
        times = max(int(self.times * share), 100)
        rng = np.random.default_rng(20261122)
        held = 0
        for _ in range(times):
            found = draw(rng)
            assert found is not None, "no interval at all"
            low, high = found
            held += (low is None or low <= truth) and (high is None or truth <= high)
        chance = 0.0 if self.full else 3.0 * np.sqrt(0.05 * 0.95 / times)
        assert least - chance <= held / times <= most + chance, f"holds the truth in {held} of {times}"


@pytest.fixture(params=["quick", pytest.param("full", marks=pytest.mark.coverage)])
def repeats(request: pytest.FixtureRequest) -> Repeats:
    """Few draws, or as many as tell 93 from 94 %."""
    return Repeats(20_000, True) if request.param == "full" else Repeats(300, False)
