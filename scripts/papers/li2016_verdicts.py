"""What of Li et al. 2016 comes out again: a verdict for each table, equation and figure, by the numbers beside it.

What the verdicts are called stands in `papers.verdicts`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from papers.verdicts import FITTED, NOT, REPRODUCED, judged

from pickenv.arm.kinematics.geometry import Array

DIGITS = 2e-3
"""Joint displacements agree within this share, which is the last digit that Table 2 prints of its smallest."""
BOX_MM = ((-1500.0, 1500.0), (-1700.0, -500.0), (400.0, 2600.0))
"""The workspace as the text of Fig. 8 has it: x, y, z."""
NEAR_MM = 10.0
"""A pick point is the paper's within this."""


def table_1(heights_mm: tuple[float, float], literal_mm: tuple[float, float]) -> dict[str, Any]:
    """The ranges of Table 1 by the work height that they give, read in two ways; the text says 800 to 2900 mm."""
    printed = (800.0, 2900.0)
    rows = [
        {"reading": "d2 is the height of frame 3, d4 a displacement", "paper_mm": printed, "ours_mm": heights_mm},
        {"reading": "as printed", "paper_mm": printed, "ours_mm": literal_mm},
    ]
    same = np.allclose(heights_mm, printed, atol=1.0)
    reason = (
        f"with d2 read as the height of frame 3 and d4 as a displacement the machine works at {heights_mm[0]:.0f} to "
        f"{heights_mm[1]:.0f} mm, which the text says; as printed it would be {literal_mm[0]:.0f} to "
        f"{literal_mm[1]:.0f} mm"
    )
    return judged(REPRODUCED if same else NOT, reason, rows)


def agrees(paper: Sequence[float], ours: Sequence[float]) -> bool:
    """Whether displacements are those printed."""
    return bool(np.allclose(ours, paper, rtol=DIGITS, atol=0.0))


def table_2(paper: Mapping[str, Sequence[float]], by_spacing: Mapping[int, Mapping[str, Array]]) -> dict[str, Any]:
    """Joint displacements of section 4.2, for each slave spacing, mm."""
    rows = [
        {"arm": name, "paper": list(printed)}
        | {f"spacing_{spacing}": list(map(float, found[name])) for spacing, found in by_spacing.items()}
        for name, printed in paper.items()
    ]
    exact = [s for s, found in by_spacing.items() if all(agrees(paper[name], found[name]) for name in paper)]
    apart = max(abs(by_spacing[350][name][2] - paper[name][2]) for name in paper if name != "master")
    reason = (
        f"exact for a slave spacing of {', '.join(map(str, exact))} mm" if exact else "exact for no spacing tried"
    ) + f"; text and Table 1 say 350 mm, with which d6 is up to {apart:.0f} mm off"
    return judged(REPRODUCED if exact else NOT, reason, rows, exact_for_spacing_mm=exact)


def table_3(
    paper: Mapping[str, Sequence[float]], errors: Mapping[str, Array], columns: Sequence[str]
) -> dict[str, Any]:
    """Position errors of eight runs, mm."""
    rows = [
        {"arm": name, "paper_mm": list(paper[name])}
        | {way: [float(values[:, i].min()), float(values[:, i].max())] for way, values in errors.items()}
        for i, name in enumerate(columns)
    ]
    inside = all(row["raw"][0] < row["paper_mm"][1] and row["raw"][1] > row["paper_mm"][0] for row in rows)
    reason = (
        "the plant's deviations were sized so that the spans overlap; nothing in the paper says where the errors come "
        "from, so this is no result"
    )
    return judged(FITTED if inside else NOT, reason, rows)


def pick_points(paper_mm: Sequence[float], found_mm: Array, reach: Mapping[str, float]) -> dict[str, Any]:
    """Equations (7)-(12) on the three targets of section 4.2, and what share of fruit each reading of them reaches."""
    apart = float(np.linalg.norm(np.asarray(found_mm) - np.asarray(paper_mm)))
    rows = [{"method": name, "reached": share} for name, share in reach.items()]
    reason = (
        f"they give ({', '.join(f'{v:.0f}' for v in found_mm)}) mm where the paper prints "
        f"({', '.join(f'{v:.0f}' for v in paper_mm)}) mm: three targets stand for the fruit of its image, which it "
        f"does not list; of twelve fruit a zone {reach['as_printed']:.1%} are reached with the misprint of eq (7), "
        f"{reach['equations']:.1%} without it, {reach['corrected']:.1%} with theta2 as heading, {reach['search']:.1%} "
        "with a search around that"
    )
    return judged(REPRODUCED if apart < NEAR_MM else NOT, reason, rows, apart_mm=apart)


def figure_8(cloud_mm: Array) -> dict[str, Any]:
    """The workspace ``(N, 3)``, and how much of it lies in the box that the text names."""
    inside = np.all(
        [(cloud_mm[:, i] >= low) & (cloud_mm[:, i] <= high) for i, (low, high) in enumerate(BOX_MM)], axis=0
    )
    rows = [
        {"axis": axis, "paper_mm": list(BOX_MM[i])}
        | {"ours_5_to_95_mm": np.percentile(cloud_mm[:, i], [5, 95]).tolist()}
        | {"ours_mm": [float(cloud_mm[:, i].min()), float(cloud_mm[:, i].max())]}
        for i, axis in enumerate("xyz")
    ]
    share = float(inside.mean())
    reason = f"{share:.0%} of the reachable points lie in the box of the text, which leaves out those near the machine"
    return judged(REPRODUCED if share > 0.9 else NOT, reason, rows, share_in_box=share, file="workspace")


def figure_9(paper: Mapping[str, Sequence[float]], ends: Mapping[str, Sequence[float]], spacing: int) -> dict[str, Any]:
    """Joint curves of section 4.2: they have to end at Table 2."""
    rows = [{"arm": name, "paper": list(paper[name]), "ours": list(ends[name])} for name in paper]
    same = all(agrees(paper[name], ends[name]) for name in paper)
    reason = f"with {spacing} mm between slaves the curves end {'at' if same else 'beside'} what Table 2 prints"
    return judged(REPRODUCED if same else NOT, reason, rows, file="joint_curves")


def recovery(paper: Sequence[int], first: Sequence[int], rate: float, ends: Sequence[float | None]) -> dict[str, Any]:
    """46 of 56 apples: what the simulation gives with the constants that it was given."""
    row = {"paper": list(paper), "first_images": list(first), "rate": rate, "ci95": list(ends)}
    reason = (
        f"{first[0]} of {first[1]} on the first images and {rate:.1%} of all; how far a push moves a fruit, how well a "
        "camera sees it and how fruit cluster are constants of ours, and any rate of this size could be had with them"
    )
    return judged(FITTED, reason, [row])
