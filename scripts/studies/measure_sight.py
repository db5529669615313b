"""How far off the stereo pair's fruit is, and how much it misses: rendered pictures of trees, read by each detector.

    python scripts/studies/measure_sight.py --out pickenv/orchard/presets/sight.toml

Prints recall and errors beside stereo theory and published sensors, and writes the tables from which
``vision="measured_errors"`` draws. Every tree is cut into zones as the machine cuts it; a picture of each of some zones
is read, and the fruit of that zone counts. Intervals are over trees.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pickenv.base import write_text
from pickenv.harvester import load_grid, load_machine, load_orchard
from pickenv.harvester.trees import sample_tree, tree_leaves
from pickenv.harvester.zones import cut
from pickenv.orchard import DETECTORS, Eyes, load_eyes, load_stereo_camera
from pickenv.orchard.sight import errors_name, sightings
from pickenv.orchard.sight_errors import (
    Sightings,
    error_measure,
    root_mean_square,
    share_of,
    tabulated,
    together,
)

SEED = 2016
ZONES = 5
"""Pictures of each tree."""
RANGES, PARTS = 3, 10
"""Rows of a table, by distance, and parts of each, by the size of the error."""
FRUIT_MAPS = {"li2016": "li2016_lab", "li2016_bare": "li2016_lab"}
"""What hangs in each canopy."""
PUBLISHED = "Azure Kinect in the sun at 1.5 m: bias 17 mm, RMSE 6 mm (Neupane et al. 2021, Agronomy 11:1780)"
HEAD = """# What the stereo pair of vision.toml makes of fruit: errors and recall (sight_errors.py). Made, not typed, by
#   {command}
# from rendered pictures (simulated, not measured on trees). Three ranges; x right, y down, z ahead; low and high are
# 95 % intervals over trees. Parts are tenths of the located fruit of a range, from the least to the largest error.
"""


@dataclass(frozen=True)
class Measured:
    """Sightings of one canopy by one detector."""

    eyes: Eyes
    seen: Sightings


def measured(canopy: str, trees: int) -> list[Measured]:
    """Pictures of ``trees`` trees of a canopy, read by every detector."""
    machine, grid = load_machine(), load_grid()
    orchard = load_orchard(canopy=canopy, fruit_map=FRUIT_MAPS[canopy])
    eyes = [load_eyes("rendered", orchard.canopy, name) for name in DETECTORS]
    parts: list[list[Sightings]] = [[] for _ in eyes]
    for number, seed in enumerate(np.random.SeedSequence(SEED).spawn(trees)):
        rng = np.random.default_rng(seed)
        tree = sample_tree(machine, orchard, rng)
        leaves = tree_leaves(machine, eyes[0], rng)
        zones = cut(grid, *tree.side)
        for i in rng.permutation(len(zones))[:ZONES].tolist():
            wanted = zones[i].holds(tree.fruit)
            found = sightings(eyes, zones[i].view, tree.fruit, tree.diameters, wanted, leaves, rng, number)
            for part, one in zip(parts, found, strict=True):
                part.append(one)
    return [Measured(each, together(part)) for each, part in zip(eyes, parts, strict=True)]


def figures(found: Measured) -> dict[str, Any]:
    """Recall and errors over all fruit: value and 95 % interval; errors in mm."""
    seen = found.seen
    hit = np.flatnonzero(seen.found)
    error = seen.error[hit] * 1e3
    table: dict[str, Any] = {
        "canopy": found.eyes.canopy.name,
        "detector": found.eyes.detector,
        "fruit": len(seen.tree),
        "in_sight": share_of(seen.tree, seen.visible > 0),
        "recall": share_of(seen.tree, seen.found),
        "false_per_picture": seen.false / seen.pictures,
    }
    for i, axis in enumerate(("x", "y", "z")):
        table[f"bias_{axis}_mm"] = error_measure(
            seen.tree[hit], error[:, i], lambda s: float(s[:, 1].sum() / s[:, 0].sum())
        )
        table[f"rmse_{axis}_mm"] = error_measure(seen.tree[hit], error[:, i], root_mean_square)
        table[f"median_{axis}_mm"] = float(np.median(np.abs(error[:, i])))
    return table


def shown(value: Any) -> str:
    """A number, or one with its interval."""
    if isinstance(value, tuple):
        number, ends = value
        return f"{number:.3g}" + (f" [{ends[0]:.3g}, {ends[1]:.3g}]" if ends else "")
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def text_of(found: Sequence[Measured], command: str) -> str:
    """The file of tables."""
    lines = [HEAD.format(command=command)]
    for one in found:
        canopy = one.eyes.canopy
        lines += [
            f"[{errors_name(canopy.name, one.eyes.detector)}]",
            f'source = "{command}: canopy {canopy.name}, fruit map {FRUIT_MAPS[canopy.name]}, fruit of 60 mm"',
            f'canopy = "{canopy.name}"',
            f'detector = "{one.eyes.detector}"',
            f"leaf_area_per_volume = {canopy.leaf_area_per_volume}",
        ]
        for key, value in tabulated(one.seen, RANGES, PARTS).items():
            rows = isinstance(value, list) and value and isinstance(value[0], list)
            inner = ",\n".join(f"    {json.dumps(row)}" for row in value) if rows else ""
            lines.append(f"{key} = [\n{inner},\n]" if rows else f"{key} = {json.dumps(value)}")
        lines.append("")
    return "\n".join(lines)


def main() -> None:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trees", type=int, default=120, help="rendered trees of each canopy (default 120)")
    parser.add_argument(
        "--canopy", action="append", choices=FRUIT_MAPS, help="a canopy, again for another (default all)"
    )
    parser.add_argument("--out", type=Path, help="write the tables here")
    parser.add_argument("--json", type=Path, help="write recall and errors here")
    given = parser.parse_args()
    found = [one for canopy in given.canopy or FRUIT_MAPS for one in measured(canopy, given.trees)]
    camera = load_stereo_camera("li2016")
    pixel = 1e3 / (camera.focal_length * camera.baseline)
    print(f"Stereo theory: {pixel:.1f} mm of depth a pixel of disparity at 1 m, {pixel * 1.2**2:.1f} mm at 1.2 m; "
          f"across {1e3 / camera.focal_length:.2f} mm a pixel at 1 m. Published: {PUBLISHED}.")  # fmt: skip
    rows = [figures(one) for one in found]
    for row in rows:
        print("; ".join(f"{key} {shown(value)}" for key, value in row.items()))
    if given.json:
        write_text(given.json, json.dumps({"depth_mm_per_px_at_1m": pixel, "rows": rows}, indent=2) + "\n")
    if given.out:
        trees = "" if given.trees == 120 else f" --trees {given.trees}"
        names = "".join(f" --canopy {name}" for name in given.canopy or ())
        write_text(given.out, text_of(found, f"python scripts/studies/measure_sight.py{trees}{names} --out FILE"))


if __name__ == "__main__":
    main()
