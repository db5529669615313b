"""How far off a stereo pair's fruit is, and how much it misses: tables that were made by reading rendered pictures.

One table for each canopy and detector, by range. Errors are far from normal: most are small, and behind a leaf they are
large; so the located fruit of each range is cut into equal parts from the least to the largest error, normal in itself
each. Made by
`python scripts/studies/measure_sight.py`. Camera frame: x right, y down, z ahead. Units: m.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pickenv.base import NUMBER, SHARE, WHOLE, InputError, clustered_share_interval, statistic_interval, toml_table
from pickenv.orchard import checks, preset_files
from pickenv.orchard.checks import MM, Array, Flags, Integers

PAIRS = ((0, 1), (0, 2), (1, 2))
"""Axes of the three correlations of an error."""

Lengths = tuple[tuple[float, float, float], ...]


@toml_table
class SightErrors(checks.Preset):
    """Errors of one detector in one canopy, one entry for each range; see sight.toml.

    Attributes:
        name: Canopy and detector.
        canopy: Preset of the canopy.
        detector: Name of the detector.
        leaf_area_per_volume: Of the canopy, m²/m³.
        trees: Rendered trees.
        pictures: Rendered pictures.
        fruit: Fruit in them.
        edges: Distances ahead between which the table is cut, m.
        visible: Mean share of a fruit's disc in sight.
        in_sight: Share of fruit of which anything is in sight.
        recall: Share of fruit that is located.
        recall_low: Lower end of its 95 % interval over trees.
        recall_high: Upper end.
        bias: Mean error along x, y, z, m.
        bias_low: Lower end of its 95 % interval.
        bias_high: Upper end.
        spread: Standard deviation along x, y, z, m.
        spread_low: Lower end of its 95 % interval.
        spread_high: Upper end.
        correlation: Of the errors along x and y, x and z, y and z.
        part_bias: Mean error of each of some equal parts of the fruit, from the least to the largest error, m.
        part_spread: Standard deviations of these parts, m.
        part_correlation: Correlations in these parts.
        false_per_picture: Detections where there is no fruit.
        lasting: Correlation of what two pictures of the same fruit miss by.
        source: How it was made.
    """

    name: str
    canopy: str
    detector: str
    leaf_area_per_volume: Annotated[float, NUMBER.not_negative]
    trees: Annotated[int, WHOLE.positive]
    pictures: Annotated[int, WHOLE.positive]
    fruit: Annotated[int, WHOLE.positive]
    edges: Annotated[tuple[float, ...], MM.positive]
    visible: Annotated[tuple[float, ...], SHARE]
    in_sight: Annotated[tuple[float, ...], SHARE]
    recall: Annotated[tuple[float, ...], SHARE]
    recall_low: Annotated[tuple[float, ...], SHARE]
    recall_high: Annotated[tuple[float, ...], SHARE]
    bias: Annotated[Lengths, MM]
    bias_low: Annotated[Lengths, MM]
    bias_high: Annotated[Lengths, MM]
    spread: Annotated[Lengths, MM.not_negative]
    spread_low: Annotated[Lengths, MM.not_negative]
    spread_high: Annotated[Lengths, MM.not_negative]
    correlation: Annotated[Lengths, NUMBER.within(-1.0, 1.0)]
    part_bias: Annotated[tuple[Lengths, ...], MM]
    part_spread: Annotated[tuple[Lengths, ...], MM.not_negative]
    part_correlation: Annotated[tuple[Lengths, ...], NUMBER.within(-1.0, 1.0)]
    false_per_picture: Annotated[float, NUMBER.not_negative]
    lasting: Annotated[float, SHARE]
    source: str = ""

    def __post_init__(self) -> None:
        ranges, parts = len(self.edges) + 1, len(self.part_bias[0]) if self.part_bias else 0
        tables = [getattr(self, name) for name in ("part_bias", "part_spread", "part_correlation")]
        rows = (self.in_sight, self.recall, self.bias, self.spread, *tables)
        if not parts or any(len(row) != ranges for row in rows) or {len(r) for t in tables for r in t} != {parts}:
            raise InputError(
                f"sight errors '{self.name}' have not one entry for each of {ranges} ranges and their parts"
            )
        super().__post_init__()


def load_sight_errors(name: str | Path) -> SightErrors:
    """Read errors by name (`shipped("sight")`) or from a path to a TOML file."""
    return preset_files.load("sight", name, SightErrors)


@dataclass(frozen=True, eq=False)
class Chances:
    """What chance decides about fruit before a camera.

    Attributes:
        place: Uniform: how well it is seen, among located fruit of its range, (n,).
        normal: Standard normal: three of the error, one of whether it is found, (n, 4).
    """

    place: Array
    normal: Array


def draw_chances(rng: np.random.Generator, count: int) -> Chances:
    """Five numbers for each of ``count`` fruit."""
    return Chances(rng.random(count), rng.normal(size=(count, 4)))


def next_picture(errors: SightErrors, before: Chances, rng: np.random.Generator) -> Chances:
    """The same fruit from the same place once more: the leaves still hang there."""
    fresh = rng.normal(size=before.normal.shape)
    kept = errors.lasting
    return Chances(before.place, kept * before.normal + np.sqrt(1.0 - kept**2) * fresh)


def sighted(errors: SightErrors, depth: ArrayLike, chances: Chances, looks: int = 1) -> tuple[Flags, Flags, Array]:
    """What a table says of fruit.

    Args:
        errors: The table.
        depth: Distance ahead of the camera, m, (n,).
        chances: What chance decides.
        looks: Pictures that are averaged: what does not last falls.

    Returns:
        Whether anything of each fruit is in sight (n,), whether it is located (n,), and its error in the camera frame,
        m, (n, 3).
    """
    from scipy.special import ndtr

    row = np.searchsorted(np.array(errors.edges), np.asarray(depth, dtype=float))
    parts = len(errors.part_bias[0])
    cell = row, np.minimum((chances.place * parts).astype(np.int64), parts - 1)
    level, recall = ndtr(chances.normal[:, 3]), np.array(errors.recall)
    located = level < recall[row]
    in_sight = level < np.maximum(np.array(errors.in_sight), recall)[row]
    steady = np.sqrt(errors.lasting + (1.0 - errors.lasting) / looks)
    miss = (_roots(errors)[cell] * (steady * chances.normal[:, None, :3])).sum(axis=-1)
    return in_sight, located, np.asarray(np.array(errors.part_bias)[cell] + miss)


def _roots(errors: SightErrors) -> Array:
    """Cholesky factors of the parts' covariances, (ranges, parts, 3, 3)."""
    spread, correlation = np.array(errors.part_spread), np.array(errors.part_correlation)
    whole = np.broadcast_to(np.eye(3), (*spread.shape, 3)).copy()
    for i, (a, b) in enumerate(PAIRS):
        whole[..., a, b] = whole[..., b, a] = 0.999 * correlation[..., i]  # rounded numbers may be singular
    return np.asarray(spread[..., :, None] * np.linalg.cholesky(whole))


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

    tree: Integers
    depth: Array
    visible: Array
    found: Flags
    error: Array
    again: Array
    pictures: int
    false: int


def together(parts: Sequence[Sightings]) -> Sightings:
    """Sightings of several pictures as one."""
    rows = {
        name: np.concatenate([getattr(part, name) for part in parts])
        for name in ("tree", "depth", "visible", "found", "error", "again")
    }
    return Sightings(**rows, pictures=sum(p.pictures for p in parts), false=sum(p.false for p in parts))


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


def share_of(tree: Integers, flags: Flags) -> Ended:
    """A share of fruit, and its interval over trees."""
    _, at = np.unique(tree, return_inverse=True)
    taken, tried = (np.bincount(at, weights=w) for w in (flags.astype(np.float64), np.ones(len(at))))
    return float(taken.sum() / max(float(tried.sum()), 1.0)), clustered_share_interval(taken, tried)


def error_measure(tree: Integers, error: Array, measure: Callable[[Array], float]) -> Ended:
    """A mean or a root of squares of errors (n,), and its interval over trees; ``measure`` reads n, Σe and Σe²."""
    _, at = np.unique(tree, return_inverse=True)
    parts = [np.bincount(at, weights=w) for w in (np.ones(len(at)), error, error**2)]
    sums = np.stack(parts, axis=1).astype(np.float64)
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
