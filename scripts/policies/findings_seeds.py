"""Do other seeds agree? `python scripts/policies/findings_seeds.py` holds the intervals against five fresh seeds.

The scripted policy on every plant, raw, with least squares and with a Gaussian process, on as many arms as in
`findings.py`. Every 95 % interval (mean, median and 95th percentile over arms, success by gripper, paired differences)
of each of six seeds is asked whether it holds the other seeds' numbers. Two estimates of a true 95 % interval differ by
sqrt(2) of their spread, so about 83 % should be held. Options: `--compensations`, `--arms`, `--runs`.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections import defaultdict
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[2]))
sys.path.insert(0, str(Path(__file__).parent))

from findings import PLANTS, Sizes, settings_of

from pickenv.agents.evaluation.grid import PolicyGrid, run_grid

SEEDS = range(6)
"""The first is that of docs/findings.md."""
NUMBERS = {
    "ci95": "mean_mm",
    "median_arm_ci95": "median_arm_mm",
    "p95_arm_ci95": "p95_arm_mm",
    "success_ci95": "success_rate",
}

Claim = tuple[str, ...]
Found = tuple[float, list[float | None] | None]


def claims_of(grid: PolicyGrid) -> dict[Claim, Found]:
    """Every number with an interval that a comparison prints."""
    found: dict[Claim, Found] = {}
    for row in grid.rows():
        where = row["plant"], row["compensation"]
        for interval, number in NUMBERS.items():
            gripper = (row["gripper"],) if number == "success_rate" else ()
            found[(number, *where, *gripper)] = row[number], row[interval]
    for line in grid.comparisons():
        found["difference", line["plant"], line["from"], line["to"]] = line["difference_mm"], line["ci95"]
    return found


def holds(interval: list[float | None] | None, value: float) -> bool:
    """Whether an interval holds a number; open ends hold all on their side."""
    if interval is None:
        return False
    low, high = interval
    return (low is None or low <= value) and (high is None or value <= high)


def main() -> None:
    """Run six seeds and count."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=Path, default=Path("runs/findings"))
    parser.add_argument("--compensations", nargs="+", default=["raw", "ls", "best"])
    parser.add_argument("--arms", type=int, default=Sizes().arms)
    options = parser.parse_args()
    sizes, runs = Sizes(arms=options.arms), options.runs / "calibrations"
    by_seed: list[dict[Claim, Found]] = []
    for seed in SEEDS:
        what: dict[str, Any] = {"policies": ("scripted",), "feedback": ("encoders",), "plants": tuple(PLANTS)}
        settings = settings_of(sizes, seed, compensations=tuple(options.compensations), **what)
        by_seed.append(claims_of(run_grid(settings, runs, workers=os.cpu_count() or 1)))
        print(f"seed {seed} done", flush=True)
    counts: defaultdict[str, list[bool]] = defaultdict(list)
    first: list[bool] = []
    for one, claims in enumerate(by_seed):
        for other, values in enumerate(by_seed):
            if one != other:
                held = {claim: holds(claims[claim][1], values[claim][0]) for claim in claims}
                for claim, each in held.items():
                    counts[claim[0]].append(each)
                first += list(held.values()) if one == 0 else []
    for kind, each in counts.items():
        print(f"{kind}: {sum(each)} of {len(each)} ({sum(each) / len(each):.0%})")
    every = [held for each in counts.values() for held in each]
    print(f"all: {sum(every)} of {len(every)} ({sum(every) / len(every):.0%}); about 83 % are due")
    print(f"intervals of seed 0 against the other seeds: {sum(first)} of {len(first)} ({sum(first) / len(first):.0%})")


if __name__ == "__main__":
    main()
