"""What of Li et al. 2016 comes out again: a verdict for each table, equation and figure, by the numbers beside it.

`papers.pages` says what the verdicts are called.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from papers.pages import FITTED, NOT, judged
from pickenv.arm import Array
from pickenv.base import share_interval
from pickenv.harvester import Measure

DIGITS = 2e-3
"""Joint displacements agree within this share, which is the last digit that Table 2 prints of its smallest."""
BOX_MM = ((-1500.0, 1500.0), (-1700.0, -500.0), (400.0, 2600.0))
"""The workspace as the text of Fig. 8 has it: x, y, z."""
NEAR_MM = 10.0
"""A pick point is the paper's within this."""
TELLING = 0.05
"""An interval of a recovery that is wider says nothing."""


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
    return judged(same, reason, rows)


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
    return judged(bool(exact), reason, rows, exact_for_spacing_mm=exact)


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


def pick_points(
    paper_mm: Sequence[float], points: Sequence[Mapping[str, Any]], reach: Mapping[str, float]
) -> dict[str, Any]:
    """Equations (7)-(12) on the three targets of section 4.2, and what share of fruit each reading of them reaches.

    Args:
        paper_mm: The printed pick point.
        points: For the paper's own point and for each reading, where it is and how many of the targets are reached.
        reach: Share of fruit in drawn zones by reading.
    """
    rows = [dict(row) | {"share_of_drawn_fruit": reach.get(row["method"])} for row in points]
    apart = min((row["apart_mm"] for row in rows[1:] if row["apart_mm"] is not None), default=np.inf)
    given = next(row for row in rows if row["method"] == "equations")["pick_point_mm"]
    reason = (
        f"they give {point(given)} mm where the paper prints {point(paper_mm)} mm: three targets stand for the fruit "
        f"of its image, which it does not list; of twelve fruit a zone {reach['as_printed']:.1%} are reached with the "
        f"misprint of eq (7), {reach['equations']:.1%} without it, {reach['corrected']:.1%} with theta2 as heading, "
        f"{reach['search']:.1%} with a search around that"
    )
    return judged(apart < NEAR_MM, reason, rows, apart_mm=apart)


def point(place_mm: Sequence[float] | None) -> str:
    """A place in words."""
    return "no point" if place_mm is None else f"({', '.join(f'{v:.0f}' for v in place_mm)})"


def figure_2(
    paper: Mapping[str, Any], length_mm: float, heights_mm: tuple[float, float], reached: Array
) -> dict[str, Any]:
    """The area that the machine is made for: from its size follow the turn, the reach and the heights.

    Args:
        paper: The paper's numbers.
        length_mm: What the machine's slides give together.
        heights_mm: Lowest and highest cup above the ground.
        reached: How many cups reach each point of the area ``(n,)``.
    """
    orchard, figure = paper["orchard"], paper["figure2"]
    half, near, deep = orchard["work_width"] / 2, orchard["distance_to_tree"], orchard["depth"][1]
    theta, reach = float(np.degrees(np.arctan2(half, near))), float(1e3 * np.hypot(half, near + deep))
    heights = [1e3 * height for height in orchard["work_height"]]
    rows = [
        {"quantity": "turn to either side, deg", "paper": figure["theta_deg"], "ours": theta},
        {"quantity": "least length to the far corner, mm", "paper": figure["reach_mm"], "ours": reach},
        {"quantity": "length of both slides, mm", "paper": figure["length_mm"], "ours": length_mm},
        {"quantity": "lowest cup, mm", "paper": heights[0], "ours": heights_mm[0]},
        {"quantity": "highest cup, mm", "paper": heights[1], "ours": heights_mm[1]},
    ]
    same = abs(theta - figure["theta_deg"]) < 0.005 and all(abs(row["paper"] - row["ours"]) < 0.5 for row in rows[1:])
    some, every = float(np.mean(reached > 0)), float(np.mean(reached == reached.max()))
    reason = (
        f"width {1e3 * orchard['work_width']:.0f} mm at {1e3 * near:.0f} mm is {theta:.2f} deg to either side, the far "
        f"corner {reach:.0f} mm from the axis, and the slides give {length_mm:.0f} mm; with the arms' offsets, which "
        f"the figure leaves out, at least one cup reaches {some:.0%} of the area, and all of them {every:.0%}"
    )
    return judged(same, reason, rows, share_reached=some, files=["work_area"])


def figure_8(cloud_mm: Array, headings_deg: Array, theta_deg: float) -> dict[str, Any]:
    """The workspace ``(N, 3)``, and how much of it lies in the box that the text names.

    Args:
        cloud_mm: Cups at joints drawn evenly.
        headings_deg: The master's turn from straight ahead for each ``(N,)``.
        theta_deg: The largest that Fig. 2 uses.
    """
    inside = np.all(
        [(cloud_mm[:, i] >= low) & (cloud_mm[:, i] <= high) for i, (low, high) in enumerate(BOX_MM)], axis=0
    )
    used = np.abs(headings_deg) <= theta_deg
    rows = [
        {"axis": axis, "paper_mm": list(BOX_MM[i])}
        | {"ours_5_to_95_mm": np.percentile(cloud_mm[:, i], [5, 95]).tolist()}
        | {"ours_mm": [float(cloud_mm[:, i].min()), float(cloud_mm[:, i].max())]}
        | {"ours_within_fig_2_mm": np.percentile(cloud_mm[used, i], [5, 95]).tolist()}
        for i, axis in enumerate("xyz")
    ]
    share, ahead = float(inside.mean()), float(inside[used].mean())
    reason = (
        f"{share:.0%} of the reachable points lie in the box of the text: Table 1 lets the master turn by 90 deg to "
        f"either side, and turned sideways the cups stand at y near 0; of those within the {theta_deg:g} deg of Fig. 2 "
        f"{ahead:.0%} do"
    )
    more = {"share_in_box": share, "share_in_box_within_fig_2": ahead, "files": ["workspace"]}
    return judged(share > 0.9, reason, rows, **more)


def figure_9(paper: Mapping[str, Sequence[float]], ends: Mapping[str, Sequence[float]], spacing: int) -> dict[str, Any]:
    """Joint curves of section 4.2: they have to end at Table 2."""
    rows = [{"arm": name, "paper": list(paper[name]), "ours": list(ends[name])} for name in paper]
    same = all(agrees(paper[name], ends[name]) for name in paper)
    reason = f"with {spacing} mm between slaves the curves end {'at' if same else 'beside'} what Table 2 prints"
    return judged(same, reason, rows, files=["joint_curves"])


def own_eyes(
    paper: Mapping[str, Any], recovery: Mapping[str, Measure], canopy: str, vision: str, images: int
) -> dict[str, Any]:
    """Recovery in the lab where the machine sees for itself: how many apples it finds, and how far off, is an output.

    Args:
        paper: The paper's numbers of its experiment.
        recovery: Recovered share of the fruit in reach by strategy, with its interval over images.
        canopy: What hangs in the lab, which is assumed.
        vision: How fruit is seen.
        images: How many were worked.
    """
    taken, located = int(paper["fruits_recovered"]), int(paper["fruits_located"])
    own, raw = taken / located, recovery["raw"]
    rows = [
        {"strategy": name, "paper_percent": 100 * own if name == "raw" else None, "ours_percent": 100 * each.value}
        | {"ci95_percent": None if each.low is None or each.high is None else [100 * each.low, 100 * each.high]}
        for name, each in recovery.items()
    ]
    low, high = (raw.value, raw.value) if raw.low is None or raw.high is None else (raw.low, raw.high)
    says = 0.0 < high - low <= TELLING
    within = low <= own <= high
    first, last = share_interval(taken, located)
    reason = (
        f"in {images} images (canopy {canopy}, vision {vision}) raw arms recover {raw.value:.1%} ({low:.1%} to "
        f"{high:.1%}) of the apples in reach; the paper's {own:.1%} lies {'within' if within else 'outside'}"
        + ("" if says else f", but an interval wider than {100 * TELLING:.0f} points says nothing")
        + f"; {taken} of {located} by themselves are {first:.0%} to {last:.0%}. Recall and errors of the eyes are "
        "outputs; which leaves hung in the lab is not said, and how far a push moves a fruit is ours"
    )
    return judged(within and says, reason, rows, canopy=canopy, vision=vision, images=images)
