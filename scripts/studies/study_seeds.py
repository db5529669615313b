"""Does a tolerance study say the same at other seeds? Run it at several, and count the intervals that hold.

    python scripts/studies/study_seeds.py scripts/tolerance_study.toml scripts/tolerance_grades.toml --out runs/seeds

For every yield of every seed: does its interval hold the mean of the other seeds? For every two settings that differ in
grade or number of poses alone: do two seeds ever order them differently, and if so, both with an interval of the
difference (same arms, so paired) that leaves zero out? Studies go on where they were stopped.

The settings of a seed share its arms, so that one unusual draw of arms misses in most settings at once: of six seeds
two such leave 76 % of the intervals of tolerance_grades.toml. Whether intervals are too narrow is told by how much
yields vary between seeds, against independent arms, by more groups of six seeds (--group 6 --seeds 60), and by
more seeds of fewer arms (--arms 250).
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import typer
from scipy import stats

from pickenv.base import mean_interval
from pickenv.experiments import StudyConfig, load_study, read_rows, run_study

ENDS = ("", "_low", "_high")
SETTING = ("tolerances", "it_grade", "method", "poses", "noise_mm", "payload_kg")


@dataclass(frozen=True)
class Agreement:
    """What several seeds of a study say of one another.

    Attributes:
        held: Intervals that hold the mean of the other seeds' yields.
        intervals: Of how many.
        reordered: Pairs of settings that two seeds order differently.
        contradicted: Those of them where both seeds' intervals of the difference leave zero out.
        pairs: Pairs of settings that differ in grade or number of poses alone.
        dispersion: Variance of a yield between seeds over that of as many independent arms, the mean over settings: 1
            but for chance where intervals are as wide as they should be; None where no yield is between 0 and 1.
    """

    held: int
    intervals: int
    reordered: int
    contradicted: int
    pairs: int
    dispersion: float | None


def seeds_agree(yields: Sequence[Sequence[dict[str, Any]]], within: Sequence[np.ndarray]) -> Agreement:
    """Compare seeds.

    Args:
        yields: For each seed, the yields of its settings.
        within: For each seed, whether each arm is within specification in each setting ``(settings, arms)``.
    """
    shares, low, high = (np.array([[row[f"yield{end}"] for row in rows] for rows in yields]) for end in ENDS)
    others = np.stack([np.delete(shares, seed, axis=0).mean(axis=0) for seed in range(len(shares))])
    reordered = contradicted = pairs = 0
    for (i, one), (j, other) in combinations(enumerate(yields[0]), 2):
        if [name for name in SETTING if one[name] != other[name]] not in (["it_grade"], ["poses"]):
            continue
        gains = [seed[i].astype(float) - seed[j] for seed in within]
        ends = [interval for gain in gains if (interval := mean_interval(gain)) is not None]
        pairs += 1
        reordered += {-1.0, 1.0} <= {float(np.sign(gain.mean())) for gain in gains}
        contradicted += any(end[0] > 0.0 for end in ends) and any(end[1] < 0.0 for end in ends)
    mean = shares.mean(axis=0)
    some = (mean > 0.0) & (mean < 1.0)
    ratios = shares[:, some].var(axis=0, ddof=1) / (mean * (1.0 - mean) / within[0].shape[1])[some]
    holding = int(np.sum((low <= others) & (others <= high)))
    dispersion = float(np.mean(ratios)) if some.any() else None
    return Agreement(holding, shares.size, reordered, contradicted, pairs, dispersion)


def dispersion_by_chance(seeds: int) -> tuple[float, float]:
    """Within which 95 of 100 dispersions of independent arms lie, if all settings share them."""
    return tuple((stats.chi2.ppf([0.025, 0.975], seeds - 1) / (seeds - 1)).tolist())


def agreement(config: StudyConfig, seeds: Sequence[int], out: Path) -> Agreement:
    """Run a study at several seeds, each in a folder of its own, and compare them."""
    yields, within = [], []
    for seed in seeds:
        print(f"{out.name}, seed {seed} …", file=sys.stderr, flush=True)
        yields.append(run_study(replace(config, seed=seed), out / f"seed-{seed}", executor="batched")["yield"])
        table = read_rows(out / f"seed-{seed}").to_table(columns=["setting", "arm", "share_within"])
        rows = table.sort_by([("setting", "ascending"), ("arm", "ascending")])
        within.append((rows["share_within"].to_numpy() >= config.share).reshape(len(yields[0]), -1))
    return seeds_agree(yields, within)


def in_groups(config: StudyConfig, seeds: Sequence[int], size: int, out: Path) -> list[Agreement]:
    """The seeds in groups of so many, one after the other, each compared within itself."""
    return [agreement(config, seeds[first : first + size], out) for first in range(0, len(seeds), size)]


def sentence(name: str, seeds: Sequence[int], counts: Agreement) -> str:
    """What was counted, in words."""
    low, high = dispersion_by_chance(len(seeds))
    times = f"{counts.dispersion or 0.0:.2f} times as much as of independent arms ({low:.2f} to {high:.2f} by chance)"
    varied = "" if counts.dispersion is None else f"; yields vary {times}"
    share = f"{counts.held} of {counts.intervals} yield intervals ({100 * counts.held / counts.intervals:.0f} %)"
    return (
        f"{name}, {len(seeds)} seeds: {share} hold the mean of the other seeds; of {counts.pairs} pairs of grades or "
        f"numbers of poses {counts.reordered} change their order between seeds, {counts.contradicted} of them with "
        f"intervals that exclude one another{varied}"
    )


def sentence_of_groups(name: str, size: int, groups: Sequence[Agreement]) -> str:
    """How many intervals hold in groups of seeds, in words."""
    shares = np.array([100 * group.held / group.intervals for group in groups])
    pairs, contradicted = sum(group.pairs for group in groups), sum(group.contradicted for group in groups)
    ends = mean_interval(shares)
    spread = f"95 % interval over groups {ends[0]:.0f} to {min(ends[1], 100.0):.0f}; " if ends else ""
    return (
        f"{name}, {len(groups)} groups of {size} seeds: {shares.mean():.0f} % of yield intervals ({spread}least "
        f"{shares.min():.0f}, most {shares.max():.0f}) hold the mean of their group's other seeds; of {pairs} pairs of "
        f"grades or numbers of poses {contradicted} change their order with intervals that exclude one another"
    )


def main(configs: list[Path], seeds: int = 6, arms: int = 0, group: int = 0, out: Path = Path("runs/seeds")) -> None:
    """Run studies at so many seeds, from 0, and count; of fewer arms, or in groups of so many seeds."""
    for path in configs:
        config = load_study(path)
        groups = in_groups(replace(config, arms=arms or config.arms), range(seeds), group or seeds, out / path.stem)
        print(sentence_of_groups(path.stem, group, groups) if group else sentence(path.stem, range(seeds), groups[0]))


if __name__ == "__main__":
    typer.run(main)
