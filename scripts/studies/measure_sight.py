"""How far off the stereo pair's fruit is, and how much it misses: rendered pictures of trees, read by each detector.

    python scripts/studies/measure_sight.py --out pickenv/orchard/presets/sight.toml

Prints recall and errors beside stereo theory and published sensors, and writes the tables from which
``vision="measured_errors"`` draws. Every tree is cut into zones as the machine cuts it; a picture of each of some zones
is read, and the fruit of that zone counts. Intervals are over trees.
"""

import json
from collections.abc import Callable, Sequence
from dataclasses import astuple, dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from numpy.typing import ArrayLike, NDArray

from pickenv.arm import Array
from pickenv.base import InputError, clustered_share_interval, statistic_interval, write_json, write_text
from pickenv.harvester import cut, load_grid, load_machine, load_orchard, sample_tree, tree_leaves
from pickenv.orchard import DETECTORS, Eyes, Leaves, Viewpoint, camera_frame, left_eye, load_eyes, load_stereo_camera
from pickenv.orchard.sight import PAIRS, located_fruit, picture, read_picture

SEED, TREES = 2016, 120
ZONES = 5
"""Pictures of each tree."""
RANGES, PARTS = 3, 10
"""Rows of a table, by distance, and parts of each, by the size of the error."""
FRUIT_MAPS = {"li2016": "li2016_lab", "li2016_bare": "li2016_lab"}
"""What hangs in each canopy."""
CANOPIES = list(FRUIT_MAPS)
PUBLISHED = "Azure Kinect in the sun at 1.5 m: bias 17 mm, RMSE 6 mm (Neupane et al. 2021, Agronomy 11:1780)"
HEAD = """# What the stereo pair of vision.toml makes of fruit: errors and recall (sight.py). Made, not typed, by
#   {command}
# from rendered pictures (simulated, not measured on trees). Three ranges; x right, y down, z ahead; low and high are
# 95 % intervals over trees. Parts are tenths of the located fruit of a range, from the least to the largest error.
"""


@dataclass(frozen=True, eq=False)
class Sightings:
    """What became of fruit before the camera; one row per fruit and picture, (n,), the pictures of all trees.

    Attributes:
        tree: Number of the tree.
        depth: True distance ahead, m.
        visible: Share of its disc in sight.
        found: Whether it was located.
        error: Where it was located less where it is, camera frame, m, (n, 3); NaN where it was not.
        again: The same in a second picture from the same place.
        pictures: Pictures in which these fruit hung.
        false: Detections in them that are no fruit.
    """

    tree: NDArray[np.int64]
    depth: Array
    visible: Array
    found: NDArray[np.bool_]
    error: Array
    again: Array
    pictures: int
    false: int


def together(parts: Sequence[Sightings]) -> Sightings:
    """Sightings of several pictures as one."""
    *columns, pictures, false = zip(*map(astuple, parts), strict=True)
    return Sightings(*map(np.concatenate, columns), pictures=sum(pictures), false=sum(false))


def sightings(
    eyes: Sequence[Eyes],
    view: Viewpoint,
    fruit: ArrayLike,
    diameters: ArrayLike,
    wanted: NDArray[np.bool_],
    leaves: Leaves | None,
    rng: np.random.Generator,
    tree: int,
) -> list[Sightings]:
    """Draw two pictures from one place, let each detector read both, and say what became of the ``wanted`` fruit (n,).

    Args:
        eyes: They share canopy, camera and look.
        view: From where.
        fruit: True centres in the view's frame, m, (n, 3).
        diameters: m, (n,).
        wanted: Which fruit counts.
        leaves: In the view's frame.
        rng: Source of every draw.
        tree: Number of the tree.
    """
    places = camera_frame(fruit, left_eye(eyes[0].camera, view), view[1])
    pairs = [picture(eyes[0], view, fruit, diameters, leaves, rng) for _ in range(2)]
    number, depth, visible = np.full(int(wanted.sum()), tree), places[wanted, 2], pairs[0].visible[wanted]
    parts = []
    for reader in eyes:
        both = [located_fruit(pair, read_picture(reader, pair), places, diameters) for pair in pairs]
        errors = [np.where(flags[:, None], where - places, np.nan)[wanted] for flags, where, _ in both]
        located, _, false = both[0]
        parts.append(Sightings(number, depth, visible, located[wanted], *errors, pictures=1, false=len(false)))
    return parts


def tabulated(seen: Sightings, ranges: int, parts: int) -> dict[str, Any]:
    """The numbers of a table as its file gives them, with 95 % intervals over trees.

    Args:
        seen: Of many trees.
        ranges: Equal parts of the fruit by distance.
        parts: Equal parts of the located fruit of each range, by the size of its error.

    Raises:
        InputError: If a part holds fewer than three fruit.
    """
    edges = np.quantile(seen.depth, np.arange(1, ranges) / ranges)
    row = np.searchsorted(edges, seen.depth)
    both = np.isfinite(seen.error).all(axis=1) & np.isfinite(seen.again).all(axis=1)
    pair = [max(float(np.corrcoef(seen.error[both, i], seen.again[both, i])[0, 1]), 0.0) for i in range(3)]
    table: dict[str, Any] = {
        "trees": len(np.unique(seen.tree)),
        "pictures": seen.pictures,
        "fruit": len(seen.tree),
        "edges_mm": _rounded(edges * 1e3, 1),
        "false_per_picture": _rounded(seen.false / max(seen.pictures, 1), 4),
        "lasting": _rounded(np.mean(pair), 3),
    }
    for r in range(ranges):
        for name, value in _range_numbers(seen, np.flatnonzero(row == r), parts).items():
            table.setdefault(name, []).append(value)
    return table


def _range_numbers(seen: Sightings, some: NDArray[np.intp], parts: int) -> dict[str, Any]:
    """Numbers of the fruit of one range."""
    found = some[seen.found[some]]
    if len(found) < 3 * parts:
        raise InputError(f"only {len(found)} fruit were located in one range of the table; render more trees")
    error = 1e3 * seen.error[found]
    recall = _ends(share_of(seen.tree[some], seen.found[some]))
    bias = [_ends(error_measure(seen.tree[found], error[:, i], mean_error)) for i in range(3)]
    spread = [_ends(error_measure(seen.tree[found], error[:, i], _deviation)) for i in range(3)]
    cells = [error[rows] for rows in np.array_split(np.argsort(np.linalg.norm(error, axis=1), kind="stable"), parts)]
    ends = tuple(enumerate(("", "_low", "_high")))
    return {
        "visible": _rounded(seen.visible[some].mean(), 3),
        "in_sight": _rounded((seen.visible[some] > 0).mean(), 4),
        **{f"recall{end}": _rounded(recall[i], 4) for i, end in ends},
        **{f"bias{end}_mm": _rounded([b[i] for b in bias], 2) for i, end in ends},
        **{f"spread{end}_mm": _rounded([max(w[i], 0.0) for w in spread], 2) for i, end in ends},
        "correlation": _correlations(error),
        "part_bias_mm": [_rounded(cell.mean(axis=0), 2) for cell in cells],
        "part_spread_mm": [_rounded(cell.std(axis=0), 2) for cell in cells],
        "part_correlation": [_correlations(cell) for cell in cells],
    }


def _correlations(error: Array) -> list[float]:
    whole: Array = np.asarray(np.corrcoef(error.T))
    return [float(np.round(whole[a, b], 3)) for a, b in PAIRS]


Ended = tuple[float, tuple[float, float] | None]
"""A number and its 95 % interval, where there is one."""


def _ends(measured: Ended) -> tuple[float, float, float]:
    """A number and the ends of its interval, both the number itself where it has none."""
    value, interval = measured
    return value, *(interval or (value, value))


def tree_sums(tree: NDArray[np.int64], *columns: Array) -> list[Array]:
    """Number of fruit of each tree, and sums of columns over it."""
    _, at = np.unique(tree, return_inverse=True)
    return [np.bincount(at, weights=column).astype(np.float64) for column in (np.ones(len(at)), *columns)]


def share_of(tree: NDArray[np.int64], flags: NDArray[np.bool_]) -> Ended:
    """A share of fruit, and its interval over trees."""
    tried, taken = tree_sums(tree, flags.astype(np.float64))
    return float(taken.sum() / max(float(tried.sum()), 1.0)), clustered_share_interval(taken, tried)


def error_measure(tree: NDArray[np.int64], error: Array, measure: Callable[[Array], float]) -> Ended:
    """A mean or a root of squares of errors (n,), and its interval over trees; ``measure`` reads n, Σe and Σe²."""
    sums = np.stack(tree_sums(tree, error, error**2), axis=1)
    return measure(sums), statistic_interval(sums, measure)


def mean_error(sums: Array) -> float:
    """For `error_measure`."""
    count, first, _ = sums.sum(axis=0)
    return float(first / count)


def _deviation(sums: Array) -> float:
    count, first, second = sums.sum(axis=0)
    return float(np.sqrt(max(second / count - (first / count) ** 2, 0.0)))


def root_mean_square(sums: Array) -> float:
    """For `error_measure`."""
    count, _, second = sums.sum(axis=0)
    return float(np.sqrt(second / count))


def _rounded(value: Any, digits: int) -> Any:
    return np.round(np.asarray(value, dtype=float), digits).tolist()


Measured = tuple[Eyes, Sightings]
"""Sightings of one canopy by one detector."""


def measured(canopy: str, trees: int, seed: int) -> list[Measured]:
    """Pictures of ``trees`` trees of a canopy, read by every detector."""
    machine, grid = load_machine(), load_grid()
    orchard = load_orchard(canopy=canopy, fruit_map=FRUIT_MAPS[canopy])
    eyes = [load_eyes("rendered", orchard.canopy, name) for name in DETECTORS]
    parts: list[list[Sightings]] = [[] for _ in eyes]
    for number, own in enumerate(np.random.SeedSequence(seed).spawn(trees)):
        rng = np.random.default_rng(own)
        tree = sample_tree(machine, orchard, rng)
        leaves = tree_leaves(machine, eyes[0], rng)
        zones = cut(grid, *tree.side)
        for i in rng.permutation(len(zones))[:ZONES].tolist():
            wanted = zones[i].holds(tree.fruit)
            read = sightings(eyes, zones[i].view, tree.fruit, tree.diameters, wanted, leaves, rng, number)
            for part, seen in zip(parts, read, strict=True):
                part.append(seen)
    return list(zip(eyes, map(together, parts), strict=True))


def figures(eyes: Eyes, seen: Sightings) -> dict[str, Any]:
    """Recall and errors over all fruit: value and 95 % interval; errors in mm."""
    tree = seen.tree[seen.found]
    table: dict[str, Any] = {
        "canopy": eyes.canopy.name,
        "detector": eyes.detector,
        "fruit": len(seen.tree),
        "false_per_picture": seen.false / seen.pictures,
    }
    ended = {"in_sight": share_of(seen.tree, seen.visible > 0), "recall": share_of(seen.tree, seen.found)}
    for axis, error in zip("xyz", seen.error[seen.found].T * 1e3, strict=True):
        ended[f"bias_{axis}_mm"] = error_measure(tree, error, mean_error)
        ended[f"rmse_{axis}_mm"] = error_measure(tree, error, root_mean_square)
        table[f"median_{axis}_mm"] = float(np.median(np.abs(error)))
    for name, (value, ends) in ended.items():
        table |= {name: value, f"{name}_ci95": ends}
    return table


def shown(value: Any) -> str:
    """A number, or both ends of an interval."""
    if isinstance(value, tuple):
        return f"[{value[0]:.3g}, {value[1]:.3g}]"
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def text_of(tables: Sequence[Measured], command: str) -> str:
    """The file of tables."""
    lines = [HEAD.format(command=command)]
    for eyes, seen in tables:
        canopy, area = eyes.canopy.name, eyes.canopy.leaf_area_per_volume
        source = f"{command}: canopy {canopy}, fruit map {FRUIT_MAPS[canopy]}, fruit of 60 mm"
        about = {"source": source, "canopy": canopy, "detector": eyes.detector, "leaf_area_per_volume": area}
        lines.append(f"[{canopy}-{eyes.detector}]")
        for key, value in (about | tabulated(seen, RANGES, PARTS)).items():
            rows = isinstance(value, list) and value and isinstance(value[0], list)
            inner = ",\n".join(f"    {json.dumps(row)}" for row in value) if rows else ""
            lines.append(f"{key} = [\n{inner},\n]" if rows else f"{key} = {json.dumps(value)}")
        lines.append("")
    return "\n".join(lines)


def main(
    trees: Annotated[int, typer.Option(help="Rendered trees of each canopy.", min=1)] = TREES,
    canopy: Annotated[list[str], typer.Option(help="A canopy, again for another.")] = CANOPIES,
    seed: Annotated[int, typer.Option(help="Of trees, leaves and pictures.", min=0)] = SEED,
    out: Annotated[Path | None, typer.Option(help="Write the tables here.")] = None,
    json_file: Annotated[Path | None, typer.Option("--json", help="Write recall and errors here.")] = None,
) -> None:
    """Measure, print, write."""
    if unknown := set(canopy) - set(CANOPIES):
        raise typer.BadParameter(f"there is no canopy '{min(unknown)}'; give {' or '.join(CANOPIES)}")
    tables = [table for name in canopy for table in measured(name, trees, seed)]
    camera = load_stereo_camera("li2016")
    pixel = 1e3 / (camera.focal_length * camera.baseline)
    print(f"Stereo theory: {pixel:.1f} mm of depth a pixel of disparity at 1 m, {pixel * 1.2**2:.1f} mm at 1.2 m; "
          f"across {1e3 / camera.focal_length:.2f} mm a pixel at 1 m. Published: {PUBLISHED}.")  # fmt: skip
    rows = [figures(*table) for table in tables]
    for row in rows:
        print("; ".join(f"{key} {shown(value)}" for key, value in row.items()))
    if json_file is not None:
        write_json(json_file, {"depth_mm_per_px_at_1m": pixel, "seed": seed, "rows": rows})
    if out is not None:
        options = "" if trees == TREES else f" --trees {trees}"
        options += "" if seed == SEED else f" --seed {seed}"
        options += "" if canopy == CANOPIES else "".join(f" --canopy {name}" for name in canopy)
        write_text(out, text_of(tables, f"python scripts/studies/measure_sight.py{options} --out FILE"))


if __name__ == "__main__":
    typer.run(main)
