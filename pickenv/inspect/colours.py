"""Colours with a fixed meaning: one per policy everywhere, Viridis for error magnitude, red for tolerance and miss.

Policy colours are Okabe and Ito's, which people with colour vision deficiency can tell apart. RGB in 0..255.
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from functools import cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

if TYPE_CHECKING:
    from matplotlib.colors import ListedColormap

Rgb = tuple[int, int, int]

ORANGE: Rgb = (230, 159, 0)
BLUE: Rgb = (0, 114, 178)
GREEN: Rgb = (0, 158, 115)
PURPLE: Rgb = (204, 121, 167)
RED: Rgb = (208, 32, 38)
"""Reserved for the tolerance and for misses."""
GREY: Rgb = (150, 150, 158)
STEEL: Rgb = (190, 194, 204)
WHITE: Rgb = (255, 255, 255)
"""Of words in space: the viewer sets them on dark plates in its dark theme, on light grey ones in the light."""
FRUIT: Rgb = (222, 202, 160)

BY_KEY: dict[str, Rgb] = {
    "raw": ORANGE,
    "nominal": ORANGE,
    "ls": BLUE,
    "calibrated": BLUE,
    "calibrated_geometry": BLUE,
    "ls_bpnn": GREEN,
    "with_residual": GREEN,
    "model_used": GREEN,
    "ls_gp": PURPLE,
    "best": PURPLE,
}
OTHERS: tuple[Rgb, ...] = (PURPLE, (86, 180, 233), (150, 140, 20), (150, 150, 150))
NAMES = {"ls": "LS", "ls_bpnn": "LS+BPNN", "ls_gp": "LS+GP", "best": "LS+GP"}
ORDER = (("raw", "nominal"), ("ls", "calibrated", "calibrated_geometry"), ("ls_bpnn", "with_residual", "model_used"))
"""Policies stand in this order everywhere; others follow."""

ARMS: tuple[Rgb, ...] = (BLUE, ORANGE, GREEN, *OTHERS)
"""Of a harvester's arms, in turn."""

TABLE = 2048

# Sixth-degree polynomial fit to Viridis by Matt Zucker (public domain), constant term first. The Rerun viewer's own
# Viridis is this polynomial, so arrows (coloured here) and voxels (coloured there) agree.
_VIRIDIS = np.array(
    [
        [0.2777273272234177, 0.005407344544966578, 0.3340998053353061],
        [0.1050930431085774, 1.404613529898575, 1.384590162594685],
        [-0.3308618287255563, 0.214847559468213, 0.09509516302823659],
        [-4.634230498983486, -5.799100973351585, -19.33244095627987],
        [6.228269936347081, 14.17993336680509, 56.69055260068105],
        [4.776384997670288, -13.74514537774601, -65.35303263337234],
        [-5.435455855934631, 4.645852612178535, 26.3124352495832],
    ]
)


def policy_key(name: str) -> str:
    """The key of a policy, given its key or its label: ``LS + BPNN`` and ``ls_bpnn`` both give ``ls_bpnn``."""
    words = "".join(c if c.isalnum() else " " for c in name.lower()).split()
    return "_".join(words)


def policy_colours(names: Sequence[str]) -> list[Rgb]:
    """One colour per policy, given keys or labels, by its name alone wherever that tells them apart.

    raw, LS and LS+BPNN have fixed ones, and so has a name that ends in one of these (``ppo_raw``); others have one of
    `OTHERS`. Where a policy before it has that colour already, it takes the next that is free.
    """
    keys = [policy_key(name) for name in names]
    taken = {BY_KEY[key] for key in keys if key in BY_KEY}
    colours: list[Rgb] = []
    for key in keys:
        colour = _own_colour(key)
        if key not in BY_KEY:
            colour = next((free for free in (colour, *OTHERS, *BY_KEY.values()) if free not in taken), colour)
            taken.add(colour)
        colours.append(colour)
    return colours


def _own_colour(key: str) -> Rgb:
    words = key.split("_")
    ends = ("_".join(words[i:]) for i in range(len(words)))
    other = OTHERS[zlib.crc32(key.encode()) % len(OTHERS)]
    return next((BY_KEY[end] for end in ends if end in BY_KEY), other)


def policy_rank(name: str) -> int:
    """The rank of a policy among others, given its key or label: 1 for raw, 2 for LS, 3 for LS+BPNN, 4 for others."""
    key = policy_key(name)
    return next((i for i, keys in enumerate(ORDER, start=1) if key in keys), len(ORDER) + 1)


def policy_label(key: str) -> str:
    """The name that people use for a policy's key: LS+BPNN for ls_bpnn, ``my policy``."""
    return NAMES.get(key, key.replace("_", " "))


def lane(name: str) -> str:
    """A policy's part of an entity path where the viewer sorts by path: ``1_raw``, ``2_ls``, ``3_ls_bpnn``, ``4_ppo``.

    What follows a slash, such as an environment's number, stays.
    """
    policy, *further = name.partition("/")
    return f"{policy_rank(policy)}_{policy_key(policy)}{''.join(further)}"


def arm_colour(arm: int) -> Rgb:
    """The colour of a harvester's arm, by its number from 0."""
    return ARMS[arm % len(ARMS)]


def viridis(fraction: ArrayLike) -> NDArray[np.uint8]:
    """Viridis colours ``(..., 3)`` in 0..255 for fractions ``(...)``, which are clipped to 0..1."""
    t = np.clip(np.asarray(fraction, dtype=float), 0.0, 1.0)
    return _viridis_table()[np.asarray(np.round(t * (TABLE - 1)), dtype=np.intp)]


def viridis_map() -> ListedColormap:
    """Viridis for matplotlib."""
    from matplotlib.colors import ListedColormap

    return ListedColormap(viridis(np.linspace(0.0, 1.0, 256)) / 255.0)


@cache
def _viridis_table() -> NDArray[np.uint8]:
    """The polynomial at `TABLE` fractions: finer than 8 bits can show, and quick for large fields."""
    colour = np.polynomial.polynomial.polyval(np.linspace(0.0, 1.0, TABLE), _VIRIDIS).T
    return np.asarray(np.round(np.clip(colour, 0.0, 1.0) * 255.0), dtype=np.uint8)
