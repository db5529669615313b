"""What the harvester's own eyes cost, and what a better detector buys: one crop, bare and leafy, seen in each way.

    python scripts/studies/harvest_sight.py --trees 60 --rendered 16 --json runs/harvest_sight.json

The paper's way and the best way of `papers.li2016`, with each detector and vision: share of the fruit present at
each stage, picks per hour, and trips to where no fruit is; 95 % intervals over trees (of one machine; simulated).
"""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2]))

from papers.li2016.comparison import SEED, calibrated_controller, strategies
from pickenv.files import write_text
from pickenv.harvester.harvest_summary import funnel_shares, summary
from pickenv.harvester.machine import load_machine
from pickenv.harvester.picking import load_picking
from pickenv.harvester.strategies import work_trees
from pickenv.harvester.trees import load_orchard
from pickenv.harvester.true_machine import Controller, load_true_machine
from pickenv.harvester.zones import load_grid
from pickenv.orchard import DETECTORS

CANOPIES = ("li2016_bare", "li2016")
WAYS = ("raw", "optimised")


def main() -> None:
    """Work the trees, print, write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trees", type=int, default=60, help="trees with measured errors and ideal eyes (default 60)")
    parser.add_argument(
        "--rendered", type=int, default=16, help="trees with rendered pictures (default 16; 0 for none)"
    )
    parser.add_argument(
        "--canopy", action="append", choices=CANOPIES, help="a canopy, again for another (default both)"
    )
    parser.add_argument("--workers", type=int, default=1, help="processes (default 1)")
    parser.add_argument("--json", type=Path, help="write the numbers here")
    given = parser.parse_args()
    true, model, grid = load_true_machine(load_machine()), load_picking(), load_grid()
    known = calibrated_controller(true, np.random.default_rng(SEED))
    ways = {way.name: way for way in strategies(Controller(true.machine), known)}
    counts = {"ideal": given.trees, "measured_errors": given.trees, "rendered": given.rendered}
    rows: list[dict[str, Any]] = []
    for canopy in given.canopy or CANOPIES:
        orchard = load_orchard(canopy=canopy)
        for vision, count in counts.items():
            for name in WAYS:
                for detector in DETECTORS[: 1 if vision == "ideal" else None] if count else ():
                    way = replace(ways[name], detector=detector)
                    shown = {"count": count, "seed": SEED, "workers": given.workers, "vision": vision}
                    done = work_trees(true, way, model, orchard, grid, **shown)
                    measures = summary(true.machine, done)
                    found = {**funnel_shares(done)}
                    found |= {key: measures[key] for key in ("picks_per_hour", "misled_per_tree", "held_per_pick")}
                    head = {"canopy": canopy, "vision": vision, "way": name, "detector": detector, "trees": count}
                    print("; ".join([*map(str, head.values()), *(f"{k} {m}" for k, m in found.items())]), flush=True)
                    rows.append(head | {key: [m.value, m.low, m.high] for key, m in found.items()})
    if given.json:
        write_text(given.json, json.dumps({"rows": rows}, indent=2) + "\n")


if __name__ == "__main__":
    main()
