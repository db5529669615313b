"""Tables and figures of the page: paper and ours side by side, each table and figure with its verdict."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle

from papers.li2016.equations import EXACT, PAPER
from papers.li2016.segmentation import Segmentation
from papers.pages import Columns, said, table, titled
from pickenv.arm import Array
from pickenv.harvester import Machine
from pickenv.inspect import Drawing, colours, new_figure
from pickenv.inspect.figures.style import COLUMN, INK, RULE, SOFT, WIDTH, rgb
from pickenv.inspect.reports.report_page import PageTable, Section

NOTES = (
    "An apple machine: a master arm that carries three slave arms with cups. All of ours is simulated.",
    "Table 2 is exact for a slave spacing of 450 mm, while text and Table 1 say 350 and the start points imply 300.",
    "Table 1's d2 is the height of frame 3, and its d4 a displacement; read so, the work height is that of the text.",
    "The machine sees with stereo eyes of its own: what it misses and how far off it is are outputs, read off rendered "
    "pictures. Which leaves hung in the lab is not said; ours has none (canopy li2016_bare), which is assumed.",
    "The comparison of strategies (report.html) starts from the paper's rules with their misprints mended: as printed, "
    "eqs (7) to (12) leave most fruit out of reach.",
)
TITLES = {
    "tables": {"1": "work height (mm)", "2": "joint displacements (rad, mm)", "3": "tip errors (mm)"},
    "figures": {
        "2": "the area that the machine is made for",
        "5": "segmentation, step by step",
        "8": "workspace (mm)",
        "9": "ends of the joint curves (rad, mm)",
    },
}
"""What tables and figures show."""
EQUATIONS: Columns = {
    "equation": "equation",
    "as printed it misses by (mm)": "as_printed_misses_mm",
    "corrected (mm)": "corrected_misses_mm",
    "misprint, or what it holds for": "misprint",
    "verdict": "verdict",
}
RED, BLUE = rgb([colours.RED, colours.BLUE])


def sections(result: Mapping[str, Any]) -> list[Section]:
    """The page's sections: every table, equation, figure and the experiment with its rows and verdict."""

    def stated(title: str, part: Mapping[str, Any]) -> PageTable:
        return table(said(title, part), part["rows"])

    tables, figures = (
        Section(
            kind.capitalize(),
            [stated(f"{kind[:-1].capitalize()} {n}, {title}", result[kind][n]) for n, title in titles.items()],
        )
        for kind, titles in TITLES.items()
    )
    points = result["equations"]["pick points"]
    held = [part["rows"][0] | part for part in result["equations"].values() if part is not points]
    experiment, eyes = result["experiments"]["46 of 56"], result["experiments"]["own eyes"]
    equations = [
        table("Equations (1) to (12) against the machine's own kinematics", held, EQUATIONS),
        stated("Pick points by eqs (7)-(12), as printed and corrected", points),
    ]
    recovery = [
        stated("Apples recovered of 56", experiment),
        table("The open constants, drawn anew for every session", experiment["constants"]),
        stated("Apples recovered with the machine's own eyes", eyes),
    ]
    return [tables, Section("Equations", equations), Section("The experiment", recovery), figures]


def drawings(
    machine: Machine, picture: Segmentation, result: Mapping[str, Any], cloud: Drawing, curves: Drawing
) -> list[Drawing]:
    """Figures 2, 5, 8 and 9 with their verdicts, and the prediction of the experiment.

    Args:
        machine: The machine as the text has it.
        picture: A rendered picture with the steps of its segmentation.
        result: What was found.
        cloud: The workspace.
        curves: The joint curves.
    """
    experiment = result["experiments"]["46 of 56"]
    area = titled(result, "2", "the area that the machine is made for.")
    steps = titled(result, "5", "from a picture to centroids, on a rendered picture.")
    sessions = f"The experiment ({experiment['verdict']}): what sessions recover over the open constants."
    return [
        Drawing("work_area", area, lambda: work_area(machine)),
        Drawing("segmentation", steps, lambda: segmentation_steps(picture)),
        replace(cloud, caption=titled(result, "8", cloud.caption)),
        replace(curves, caption=titled(result, "9", f"{curves.caption} Slaves {1e3 * EXACT:.0f} mm apart.")),
        Drawing("prediction", sessions, lambda: recovered(experiment)),
    ]


def target_area() -> tuple[Array, Array, Array]:
    """Columns, depths and reachable grid of the area of Fig. 2: x ``(26,)``, y ``(9,)`` and points ``(234, 3)``, m."""
    orchard = PAPER["orchard"]
    half, near = orchard["work_width"] / 2, orchard["distance_to_tree"]
    x, y = np.linspace(-half, half, 26), -np.linspace(near, near + orchard["depth"][1], 9)
    across, deep = np.meshgrid(x, y)
    return x, y, np.stack([across.ravel(), deep.ravel(), np.full(across.size, 1.2)], -1)


def reached_in_area(machine: Machine, points: Array, theta_deg: float) -> Array:
    """How many slaves reach each point ``(n,)``, the master turned within ``theta_deg`` to either side."""
    heading = np.radians(np.linspace(-90.0 - theta_deg, -90.0 + theta_deg, 61))
    reach = np.linspace(machine.master.nominal.lower[2], machine.master.nominal.upper[2], 25)
    turned, out = np.meshgrid(heading, reach)
    height = float(points[0, 2]) - machine.d1
    masters = np.stack([turned.ravel(), np.full(turned.size, height), out.ravel()], -1)
    return np.asarray(machine.reach(masters, points).any(0).sum(0))


def work_area(machine: Machine) -> Figure:
    """Fig. 2b: the target area from above, the headings, the length that its far corner asks for, what cups reach."""
    theta, reach = PAPER["figure2"]["theta_deg"], PAPER["figure2"]["reach_mm"] * 1e-3
    x, y, points = target_area()
    count = reached_in_area(machine, points, theta)
    with new_figure(WIDTH, 3.6) as figure:
        axes = figure.add_subplot(xlabel="x (m)", ylabel="y (m)", aspect="equal")
        axes.set_title(f"Cups that reach each point of the area of Fig. 2 (from above, {theta:g}° to either side)")
        depth = float(y[0] - y[-1])
        axes.add_patch(Rectangle((x[0], y[-1]), x[-1] - x[0], depth, fill=False, color=INK))
        for arms in sorted({int(n) for n in count}):
            face = RULE if arms == 0 else rgb([colours.arm_colour(arms - 1)])[0]
            axes.scatter(*points[count == arms, :2].T, s=9.0, color=face, label=f"{arms} of {machine.arms} cups")
        for side in (-1, 1):
            angle = np.radians(-90.0 + side * theta)
            axes.plot([0, reach * np.cos(angle)], [0, reach * np.sin(angle)], color=SOFT, linestyle="--")
        arc = np.radians(np.linspace(-90 - theta, -90 + theta, 100))
        axes.plot(reach * np.cos(arc), reach * np.sin(arc), color=RED, label=f"{1e3 * reach:.0f} mm from the axis")
        axes.plot(0, 0, marker="o", color=INK, linestyle="none", label="master's axis")
        figure.legend(loc="outside lower center", ncols=6)
    return figure


def segmentation_steps(found: Segmentation) -> Figure:
    """Fig. 5: the picture, R - G, the mask after each step, and the centroids."""
    panels: Sequence[tuple[str, Any]] = [
        ("a  picture (rendered)", found.picture),
        ("   R − G", found.difference),
        *((f"{'b' if i == 0 else ' '}  {name}", mask) for i, (name, mask) in enumerate(found.masks.items())),
    ]
    panels = [(title.replace("   two dilations", "c  two dilations"), shown) for title, shown in panels]
    with new_figure(WIDTH, 3.2, **{"axes.grid": False, "axes.titlesize": 8.0}) as figure:
        places = figure.subplots(2, 4).ravel()
        for axes, (title, shown) in zip(places, panels, strict=False):
            axes.imshow(shown, cmap="gray", interpolation="nearest")
            axes.set_title(title)
        axes = places[len(panels)]
        axes.imshow(found.picture)
        axes.set_title("d  centroids (+) and true fruit")
        axes.plot(found.centroids[:, 0], found.centroids[:, 1], "+", color="white", markersize=7)
        for column, row, disparity in found.fruit:
            axes.add_patch(Circle((column, row), 0.25 * disparity, fill=False, color="yellow", linewidth=0.8))
        for axes in places:
            axes.set_axis_off()
    return figure


def recovered(part: Mapping[str, Any]) -> Figure:
    """How many apples sessions recover over the open constants, and what the paper did."""
    counts, (row,) = np.array(part["counts"], dtype=float), part["rows"]
    low, high = row["prediction_95_percent"]
    with new_figure(COLUMN, 2.6) as figure:
        axes = figure.add_subplot(xlabel=f"apples recovered of {row['paper'][1]}", ylabel="share of sessions (%)")
        axes.set_title("Predicted recovery over open constants")
        axes.axvspan(low - 0.5, high + 0.5, color=RULE, zorder=0, label=f"95 %: {low:.0f} to {high:.0f}")
        axes.bar(np.arange(len(counts)), 100 * counts / counts.sum(), 0.9, color=BLUE)
        axes.axvline(row["paper"][0], color=RED, label=f"paper: {row['paper'][0]}")
        first = int(np.flatnonzero(counts)[0])
        axes.set_xlim(min(first, row["paper"][0]) - 2, len(counts))
        axes.grid(axis="x", visible=False)
        figure.legend(loc="outside lower center", ncols=2)
    return figure
