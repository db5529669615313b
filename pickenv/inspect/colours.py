"""Colours with a fixed meaning: one per policy everywhere, Viridis for error magnitude, red for tolerance and miss.

Policy colours are Okabe and Ito's, which people with colour vision deficiency can tell apart. RGB in 0..255.
"""

from __future__ import annotations

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
}
OTHERS: tuple[Rgb, ...] = ((204, 121, 167), (86, 180, 233), (150, 140, 20), (150, 150, 150))

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


def policy_colours(names: list[str]) -> list[Rgb]:
    """One colour per policy, given keys or labels: fixed ones for raw, LS and LS + BPNN, further ones in turn."""
    colours, spare = [], 0
    for name in names:
        known = BY_KEY.get(policy_key(name))
        if known is None:
            known, spare = OTHERS[spare % len(OTHERS)], spare + 1
        colours.append(known)
    return colours


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
    t = np.linspace(0.0, 1.0, TABLE)[:, None]
    colour = np.zeros((TABLE, 3))
    for coefficients in _VIRIDIS[::-1]:
        colour = colour * t + coefficients
    return np.asarray(np.round(np.clip(colour, 0.0, 1.0) * 255.0), dtype=np.uint8)
