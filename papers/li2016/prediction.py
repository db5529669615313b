"""46 of 56: what the constants that Li et al. 2016 leave open let one predict.

Each session draws every open constant from a range with a reason, then eight images of seven apples, and counts what is
recovered. No constant is chosen so that the paper's number comes out; the interval is over constants and sessions.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.stats import spearmanr

from papers.li2016.lab import work_images
from papers.pages import judged
from pickenv.arm import Array
from pickenv.base.intervals import quantile_interval
from pickenv.harvester import Picking, Strategy, TrueMachine, funnel, load_lab, load_picking


@dataclass(frozen=True)
class Open:
    """A constant that the paper leaves open.

    Attributes:
        low: Least value.
        high: Largest value.
        unit: Their unit.
        why: Where the range comes from.
        even_in_log: Whether sizes, not values, are evenly likely.
    """

    low: float
    high: float
    unit: str
    why: str
    even_in_log: bool = False

    def at(self, share: Array) -> Array:
        """Values at shares ``(N,)`` of the range, 0 to 1."""
        if self.even_in_log:
            return np.asarray(self.low * (self.high / self.low) ** share)
        return np.asarray(self.low + (self.high - self.low) * share)


OPEN: Mapping[str, Open] = {
    "sideways": Open(
        0.3,
        4.0,
        "mm",
        "what our own stereo eyes miss by, from a bare fruit to one in leaves: which hung in the lab is not said",
        True,
    ),
    "depth": Open(1.6, 12.0, "mm", "the same, 0.1 to 0.75 px of disparity; a pixel is 16 mm at 1 m", True),
    "gather": Open(0.0, 10.0, "mm", "'nearly 10 mm' with or without the cup's 5 mm of clearance, or more"),
    "push": Open(2.0, 32.0, "mm", "from a twig to 'severely displaced' by half a fruit, section 5.2", True),
    "push_spread": Open(0.25, 0.75, "1", "log-normal; nothing is said"),
    "lasting": Open(0.0, 0.7, "1", "from branches that swing back to leaves that hook"),
    "cut": Open(0.95, 1.0, "1", "no failed cut is reported"),
    "undamaged": Open(0.98, 1.0, "1", "no damage is reported"),
}
"""The open constants. The arms' own errors are those of Table 3; every one of the 56 apples was located."""

HALF = 28
"""Fruit; a wider 95 % interval excludes less than half of the possible counts, and says nothing."""


def machine_with(true: TrueMachine, value: Mapping[str, float]) -> TrueMachine:
    """The machine whose cups stand where a camera of these errors sends them: a fruit seen aside is a cup aside."""
    seen = np.array([value["sideways"], value["depth"], value["sideways"]]) * 1e-3
    stops = np.sqrt(true.repeatability**2 + seen**2 / 2)  # a cup stops by two arms' errors, master's and slave's
    return replace(true, repeatability=stops)


def picking_with(value: Mapping[str, float]) -> Picking:
    """The picking model with these constants; all fruit is seen, and where it is: `machine_with` errs."""
    return replace(
        load_picking(),
        gather=max(value["gather"], 1e-3) * 1e-3,
        push=value["push"] * 1e-3,
        push_spread=value["push_spread"],
        lasting=value["lasting"],
        cut_success=value["cut"],
        undamaged=value["undamaged"],
    )


@dataclass(frozen=True, eq=False)
class Sessions:
    """Simulated sessions.

    Attributes:
        recovered: Apples recovered in each ``(S,)``.
        located: Apples located in each.
        constants: What each drew, by name ``(S,)``.
    """

    recovered: Array
    located: int
    constants: Mapping[str, Array]


def sessions(
    true: TrueMachine, way: Strategy, count: int, seed: np.random.SeedSequence, progress: Callable[[], object]
) -> Sessions:
    """Simulate sessions of the paper's experiment, each with constants of its own."""
    drawn, *worked = seed.spawn(1 + count)
    lab, shares = load_lab(), np.random.default_rng(drawn).random((len(OPEN), count))
    constants = {name: each.at(share) for (name, each), share in zip(OPEN.items(), shares, strict=True)}
    recovered = np.zeros(count)
    for i, own in enumerate(worked):
        value = {name: float(values[i]) for name, values in constants.items()}
        number, machine = int(own.generate_state(1, np.uint64)[0]), machine_with(true, value)
        done = work_images(machine, way, picking_with(value), count=lab.runs, seed=number, vision="ideal")
        recovered[i] = funnel(done)["collected"]
        progress()
    return Sessions(recovered, lab.runs * lab.fruit, constants)


def prediction(paper: Mapping[str, Any], found: Sessions) -> dict[str, Any]:
    """The predictive distribution of recovered apples, and whether the paper's number lies within."""
    shares = (0.025, 0.25, 0.5, 0.75, 0.975)
    low, quarter, median, three, high = ends = np.quantile(found.recovered, shares, method="inverted_cdf").tolist()
    own, located = int(paper["fruits_recovered"]), int(paper["fruits_located"])
    within, says = low <= own <= high, high - low <= HALF
    telling = {name: float(spearmanr(values, found.recovered).statistic) for name, values in found.constants.items()}
    first, second, *_ = sorted(telling, key=lambda name: -abs(telling[name]))
    reason = (
        f"over the constants that the paper leaves open a session recovers {low:.0f} to {high:.0f} of {located} (95 %; "
        f"median {median:.0f}); the paper's {own} lies {'within' if within else 'outside'}"
        + ("" if says else f", but an interval wider than {HALF} says nothing")
        + f"; {first} and {second} decide most of it"
    )
    counts = np.bincount(found.recovered.astype(int), minlength=located + 1)
    row = {
        "paper": [own, located],
        "median": median,
        "half": [quarter, three],
        "prediction_95_percent": [low, high],
        "share_at_most_paper": float(np.mean(found.recovered <= own)),
        "sessions": len(found.recovered),
    }
    constants = [
        {"constant": name, "low": each.low, "high": each.high, "unit": each.unit, "rank_correlation": telling[name]}
        | {"why": each.why}
        for name, each in OPEN.items()
    ]
    quantiles = [
        {"share": share, "apples": apples, "ci95": list(quantile_interval(found.recovered, share))}
        for share, apples in zip(shares, ends, strict=True)
    ]
    return judged(
        within and says, reason, [row], constants=constants, counts=[int(n) for n in counts], quantiles=quantiles
    )
