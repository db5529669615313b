"""Pictures of a canopy: the arm as in `drawing`, and which fruit are picked, missed and left. Units: m."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from pickenv.arm import Array, Plant
from pickenv.envs.picking.pick_scene import PickScene
from pickenv.envs.shared.drawing import DPI, FRUIT, SIZE, TRUE, draw_arm

LEFT_OUT, MISSED, COLLECTED = "#d5d8dc", "#e59866", "#27ae60"


def draw_pick(plant: Plant, target: Array, command: Array, tool: Array, scene: PickScene, number: int) -> Figure:
    """Draw the arm on the left and the canopy, as the arm faces it, on the right.

    Args:
        plant: The true arm, on single numbers.
        target: Nominal joint target ``(n,)``, rad or m.
        command: What the drives got ``(n,)``.
        tool: True tool position ``(3,)``, m.
        scene: The fruit.
        number: The fruit that the arm is after.
    """
    figure = Figure(figsize=SIZE, dpi=DPI, layout="constrained")
    fruit = scene.positions
    colours = np.full(len(fruit), LEFT_OUT, dtype=object)
    colours[scene.reachable] = FRUIT
    colours[scene.attempted] = MISSED
    colours[scene.attached] = COLLECTED
    draw_arm(figure, plant, target, command, tool, fruit, colours.tolist())
    canopy = figure.add_subplot(1, 2, 2)
    for place, diameter, colour, gone in zip(fruit, scene.diameters, colours, scene.collected, strict=True):
        face = "none" if gone else colour
        canopy.add_patch(Circle((place[0], place[2]), diameter / 2, facecolor=face, edgecolor=colour))
    canopy.plot(*scene.seen[number, [0, 2]], "+", color="black", markersize=9, label="where the camera saw it")
    canopy.plot(tool[0], tool[2], "x", color=TRUE, markersize=9, label="true tool")
    for colour, meaning in (
        (FRUIT, "to pick"),
        (COLLECTED, "taken"),
        (MISSED, "missed"),
        (LEFT_OUT, "not seen or not in reach"),
    ):
        canopy.plot([], [], "o", color=colour, label=meaning)
    points = np.vstack([fruit, tool])[:, [0, 2]]
    middle, half = (points.max(axis=0) + points.min(axis=0)) / 2, np.ptp(points, axis=0).max() / 2 + 0.15
    canopy.set(xlim=(middle[0] + half, middle[0] - half), ylim=(middle[1] - half, middle[1] + half), aspect="equal")
    canopy.set(xlabel="x (m), as the arm faces the trees", ylabel="z (m)")
    funnel = scene.funnel()
    canopy.set_title(f"{funnel['collected']} collected whole of {funnel['reachable']} in reach")
    figure.legend(*canopy.get_legend_handles_labels(), loc="outside lower center", ncols=6, fontsize=7)
    return figure
