"""What it takes to pick a fruit: pull or twist, whichever limit is met first, log-normal over fruit.

One strength per fruit scales both limits: a fruit that holds against pulling holds against twisting. Units: N, N·m, m.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from pickenv.orchard import checks, preset_files
from pickenv.orchard.checks import MM, Array, Flags
from pickenv.toml_tables import NEWTON, NEWTON_METRE, NUMBER, toml_table

QUANTILE_95 = 1.6448536269514722  # of the standard normal


@toml_table
class Detachment(checks.Preset):
    """Distribution of what holds the fruit.

    Attributes:
        pull_95: Pull that detaches 95 % of fruit, N.
        twist_95: Twist about the stem that detaches 95 % of fruit, N·m.
        spread: Standard deviation of the logarithm of both.
        stem: Length of the stem, m.
        source: Where its numbers come from.
    """

    pull_95: Annotated[float, NEWTON.positive]
    twist_95: Annotated[float, NEWTON_METRE.positive]
    spread: Annotated[float, NUMBER.positive]
    stem: Annotated[float, MM.not_negative]
    source: str = ""


@dataclass(frozen=True, eq=False)
class Strength:
    """Limits of single fruit: pull in N and twist in N·m, each of shape (...)."""

    pull: Array
    twist: Array


def load_detachment(name: str | Path) -> Detachment:
    """Read detachment limits by name (`shipped("detachment")`) or from a path to a TOML file."""
    return preset_files.load("detachment", name, Detachment)


def sample_strength(detachment: Detachment, shape: int | tuple[int, ...], rng: np.random.Generator) -> Strength:
    """Draw the limits of fruit: one normal number each."""
    scale = np.exp(detachment.spread * (rng.normal(size=shape) - QUANTILE_95))
    return Strength(np.asarray(detachment.pull_95 * scale), np.asarray(detachment.twist_95 * scale))


def detached(strength: Strength, pull: ArrayLike = 0.0, twist: ArrayLike = 0.0) -> Flags:
    """Whether fruit comes off under a pull (N) or a twist (N·m), shapes (...)."""
    pulled = np.abs(checks.numbers("the pull (N)", pull)) >= strength.pull
    return np.asarray(pulled | (np.abs(checks.numbers("the twist (N·m)", twist)) >= strength.twist))


def detachment_probability(detachment: Detachment, pull: ArrayLike = 0.0, twist: ArrayLike = 0.0) -> Array:
    """Share of fruit that comes off under a pull (N) and a twist (N·m)."""
    from scipy.special import ndtr

    load = np.maximum(
        np.abs(checks.numbers("the pull (N)", pull)) / detachment.pull_95,
        np.abs(checks.numbers("the twist (N·m)", twist)) / detachment.twist_95,
    )
    with np.errstate(divide="ignore"):
        return np.asarray(ndtr(QUANTILE_95 + np.log(load) / detachment.spread))


def stem_ends(detachment: Detachment, positions: ArrayLike, diameters: ArrayLike) -> Array:
    """Where the stems of hanging fruit meet the wood, m, shape (n, 3): straight above the fruit."""
    positions, diameters = checks.fruit_arrays(positions, diameters)
    ends = positions.copy()
    ends[:, 2] += diameters / 2 + detachment.stem
    return ends
