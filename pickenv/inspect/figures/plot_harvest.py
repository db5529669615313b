"""Figures of a harvester: Gantt chart of the arms, pick map, funnel, throughput, workspace cloud, joint curves.

Each function returns a matplotlib figure.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from pickenv.base import InputError
from pickenv.harvester import Measure
from pickenv.inspect import colours
from pickenv.inspect.figures import style
from pickenv.inspect.runs.traces import PickedTree

(RED,) = style.rgb([colours.RED])


def gantt(trees: Mapping[str, PickedTree], arms: int) -> Figure:
    """Draw a Gantt chart of the picks on one tree: a panel per strategy, and a lane per arm over time.

    Hollow bars are picks from which the suction cup came back empty. Thin red bars are times in which an arm waited for
    a neighbour.

    Args:
        trees: One tree of each strategy, by the strategy's name.
        arms: Number of arms.
    """
    _something(trees)
    with style.new_figure(style.WIDTH, 0.6 + (0.55 + 0.22 * (arms + 1)) * len(trees)) as figure:
        panels: Any = figure.subplots(len(trees), 1, sharex=True, squeeze=False)[:, 0]
        for axes, (name, tree) in zip(panels, trees.items(), strict=True):
            axes.barh([arms] * len(tree.stands), np.diff(tree.stands)[:, 0], 0.7, tree.stands[:, 0], color=style.SOFT)
            for arm in range(arms):
                for got in (True, False):
                    mine = (tree.arm == arm) & (tree.got == got)
                    length = (tree.end - tree.start)[mine]
                    face = _colour(arm) if got else "none"
                    axes.barh([arm] * len(length), length, 0.7, tree.start[mine], color=face, edgecolor=_colour(arm))
            waited = tree.held > 0.0
            axes.barh(tree.arm[waited], tree.held[waited], 0.18, (tree.start - tree.held)[waited], color=RED)
            axes.set_yticks(range(arms + 1), [*(f"arm {i + 1}" for i in range(arms)), "master stands"])
            count = f"{int(tree.collected.sum())} of {len(tree.fruit)} fruit"
            style.headline(axes, f"{name}: {count} in {tree.seconds:.0f} s")
            axes.grid(axis="y", visible=False)
        panels[-1].set_xlim(left=0.0)
        panels[-1].set_xlabel("time on one tree (s); hollow: the cup came back empty, red: held back by a neighbour")
    return figure


def pick_map(trees: Mapping[str, PickedTree]) -> Figure:
    """Draw one tree's fruit from the side, each coloured by the arm that collected it, in a panel per strategy.

    Boxes are the zones of the tree that the machine pictured and picked, one after the other. Red crosses are fruit
    that no arm collected.

    Args:
        trees: One tree of each strategy, by the strategy's name.
    """
    _something(trees)
    with style.new_figure(style.WIDTH, 3.2, **{"axes.grid": False}) as figure:
        panels: Any = figure.subplots(1, len(trees), sharey=True, squeeze=False)[0]
        arms = max(int(tree.by_arm.max(initial=-1)) for tree in trees.values()) + 1
        for axes, (name, tree) in zip(panels, trees.items(), strict=True):
            for zone in tree.zones:
                _box(axes, *zone, color=style.RULE, linewidth=0.8, zorder=0)
            for arm in range(arms):
                mine = tree.collected & (tree.by_arm == arm)
                axes.scatter(*tree.fruit[mine][:, (0, 2)].T, s=18, color=_colour(arm))
            axes.scatter(*tree.fruit[~tree.collected][:, (0, 2)].T, s=16, marker="x", color=RED, linewidths=1.0)
            style.headline(axes, f"{name}: {int(tree.collected.sum())} of {len(tree.fruit)} collected")
            axes.set(xlabel="x along the row (m)", aspect="equal")
            axes.invert_xaxis()
        panels[0].set_ylabel("z above the base (m)")
        handles = _arm_marks(panels[0], arms)
        handles.append(panels[0].scatter([], [], marker="x", color=RED, label="not collected"))
        figure.legend(handles=handles, loc="outside lower center", ncols=len(handles))
    return figure


def funnel_bars(funnels: Mapping[str, Mapping[str, int]]) -> Figure:
    """Draw the share of all fruit that reaches each stage, by strategy.

    Args:
        funnels: For each strategy, the number of fruit at each stage, from present to collected; shares are of the
            number at the first stage.
    """
    _something(funnels)
    stages = list(next(iter(funnels.values())))
    width = 0.84 / len(funnels)
    with style.new_panel(style.WIDTH, 3.0, "", "share of fruit present (%)", legend=3) as (figure, axes):
        counts = {name: np.array([numbers[stage] for stage in stages]) for name, numbers in funnels.items()}
        shares = {name: 100.0 * numbers / max(numbers[0], 1) for name, numbers in counts.items()}
        ends = {name: float(share[-1]) for name, share in shares.items()}
        style.headline(axes, f"Of the fruit {stages[0]}, {stages[-1]}: {style.change(ends, '%')}")
        for i, (name, share, colour) in enumerate(style.coloured(shares)):
            place = np.arange(len(stages)) + width * (i - (len(funnels) - 1) / 2.0)
            axes.bar(place, share, 0.92 * width, color=colour, label=f"{name}: {share[-1]:.1f} %")
        axes.set_xticks(range(len(stages)), stages)
        axes.set_ylim(0.0, 101.0)
        axes.grid(axis="x", visible=False)
    return figure


def throughput_by_arms(throughput: Mapping[str, Mapping[int, Measure]]) -> Figure:
    """Draw picks per hour against the number of arms, with 95 % intervals and a curve for each density of fruit.

    Args:
        throughput: For each density of fruit, by label: the picks per hour, with interval, for each number of arms.
    """
    _something(throughput)
    with style.new_panel(style.COLUMN, 2.9, "arms (number)", "picks per hour (1/h)", legend=1) as (figure, axes):
        label, measures = list(throughput.items())[-1]  # the growth of the last density's with the arms
        ends = [f"{measures[n].value:.0f}/h with {n}" for n in dict.fromkeys((min(measures), max(measures)))]
        style.headline(axes, f"{label}: {', '.join(ends)} arm{'s' * (max(measures) > 1)}")
        for i, (label, measures) in enumerate(throughput.items()):
            arms = list(measures)
            values = np.array([measures[n].value for n in arms])
            bars = np.abs(np.array([[measures[n].low, measures[n].high] for n in arms], dtype=float).T - values)
            axes.errorbar(arms, values, bars, marker="o", markersize=4, capsize=2.5, color=_colour(i), label=label)
        axes.set_xticks(arms)
        axes.set_ylim(bottom=0.0)
    return figure


def workspace_cloud(cloud: ArrayLike, boxes: Sequence[Sequence[Sequence[float]]] = ()) -> Figure:
    """Draw the workspace of the suction cups, from above and from the side.

    Args:
        cloud: Positions of the cups ``(N, arms, 3)``, m, for joint values drawn uniformly within the limits.
        boxes: Boxes to be drawn dashed, such as a paper's: the ranges of x, y and z of each ``(3, 2)``, m.
    """
    cloud = np.asarray(cloud, dtype=float)
    if cloud.ndim != 3 or not len(cloud):
        raise InputError("a workspace cloud needs points (N, arms, 3); give at least one")
    with style.new_figure(style.WIDTH, 3.4) as figure:
        panels: Any = figure.subplots(1, 2)
        for axes, (a, b) in zip(panels, ((0, 1), (0, 2)), strict=True):
            for arm in range(cloud.shape[1]):
                x, y = cloud[:, arm, a], cloud[:, arm, b]
                axes.scatter(x, y, s=1.0, color=_colour(arm), linewidths=0.0, alpha=0.6, rasterized=True)
            for box in boxes:
                _box(axes, *box[a], *box[b], color=RED, linestyle="--", linewidth=1.2)
            axes.set(xlabel=f"{'xyz'[a]} (m)", ylabel=f"{'xyz'[b]} (m)", aspect="equal")
        wide, deep, high = np.ptp(cloud.reshape(-1, 3), axis=0)
        style.headline(panels[0], f"From above: {wide:.2f} by {deep:.2f} m")
        style.headline(panels[1], f"From the side: {wide:.2f} by {high:.2f} m")
        handles = _arm_marks(panels[0], cloud.shape[1])
        if boxes:
            handles += panels[0].plot([], [], color=RED, linestyle="--", label="dense region of the paper")
        figure.legend(handles=handles, loc="outside lower center", ncols=len(handles))
    return figure


def joint_displacements(time: ArrayLike, moved: Mapping[str, ArrayLike], turning: Sequence[str] = ()) -> Figure:
    """Draw the displacement of each joint over time, sliding joints on the left and turning joints on the right.

    Colours distinguish the parts of the machine, and line patterns the joints of a part.

    Args:
        time: Times ``(T,)``, s.
        moved: Displacement of each joint ``(T,)``, m or rad, by the joint's name.
        turning: Names of the joints that turn, whose displacements are in rad.
    """
    parts: dict[str, list[str]] = {}
    for name in moved:
        parts.setdefault(name.rpartition(" ")[0], []).append(name)
    shades = {part: style.INK if i == 0 else _colour(i - 1) for i, part in enumerate(parts)}
    with style.new_figure(style.WIDTH, 3.2) as figure:
        slides, turns = figure.subplots(1, 2)
        for part, names in parts.items():
            for name, line in zip(names, ("-", "--", ":", "-."), strict=False):
                axes, scale = (turns, np.degrees(1.0)) if name in turning else (slides, 1e3)
                axes.plot(time, np.asarray(moved[name]) * scale, color=shades[part], linestyle=line, label=name)
        for axes, kind, unit in ((slides, "Sliding", "mm"), (turns, "Turning", "deg")):
            most = max((float(np.ptp(np.asarray(line.get_ydata()))) for line in axes.get_lines()), default=0.0)
            title = f"{kind} joints: up to {most:.0f} {unit}" if axes.lines else f"No {kind.lower()} joint"
            style.headline(axes, title)
            axes.set(xlabel="time (s)", ylabel=f"displacement ({unit})")
        figure.legend(loc="outside lower center", ncols=6, fontsize=7.0)
    return figure


def _colour(arm: int) -> tuple[float, float, float]:
    return style.rgb([colours.arm_colour(arm)])[0]


def _arm_marks(axes: Any, arms: int) -> list[Any]:
    """Return one mark per arm in the arm's colour, for the legend of ``axes``; ``arms`` is the number of arms."""
    return [axes.scatter([], [], color=_colour(i), label=f"arm {i + 1}") for i in range(arms)]


def _box(axes: Any, left: float, right: float, bottom: float, top: float, **look: Any) -> None:
    axes.plot([left, right, right, left, left], [bottom, bottom, top, top, bottom], **look)


def _something(data: Mapping[str, Any]) -> None:
    if not data:
        raise InputError("there is nothing to draw; give at least one strategy")
