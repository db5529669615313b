"""Figures of the harvester: Gantt, pick map, funnel, throughput by arms, workspace (Fig. 8), joint curves (Fig. 9)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import numpy as np
from matplotlib.figure import Figure

from pickenv.files import write_whole
from pickenv.harvester.harvest import Harvest
from pickenv.harvester.machine import Machine
from pickenv.harvester.motion import joint_curves, workspace
from pickenv.harvester.summary import STAGES, Measure, funnel
from pickenv.harvester.true_machine import TrueMachine

COLOURS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#F0E442")
RED = "#D02026"
GREY = "#96969E"


def draw_figures(
    folder: Path,
    true: TrueMachine,
    trees: Mapping[str, Sequence[Harvest]],
    throughput: Mapping[str, Mapping[int, Measure]],
    targets_mm: Mapping[str, tuple[int, int, int]],
    pick_point_mm: tuple[int, int, int],
) -> list[Path]:
    """Draw all figures into ``folder``."""
    machine = true.machine
    figures = {
        "gantt": gantt(
            machine, {name: harvests[0] for name, harvests in trees.items() if name in ("raw", "optimised")}
        ),
        "pick_map": pick_map({name: h[0] for name, h in trees.items() if name in ("raw", "optimised")}),
        "funnel": funnel_bars(trees),
        "throughput": throughput_by_arms(throughput),
        "workspace": workspace_cloud(machine),
        "joint_curves": curves(machine, targets_mm, pick_point_mm),
    }
    return [
        write_whole(folder / f"{name}.png", lambda path, f=figure: f.savefig(path, dpi=120))
        for name, figure in figures.items()
    ]


def gantt(machine: Machine, harvests: Mapping[str, Harvest]) -> Figure:
    """A lane per arm over the clock of one tree; hollow bars are empty cups."""
    figure = Figure(figsize=(12, 2 + 1.6 * len(harvests)), layout="constrained")
    axes = figure.subplots(len(harvests), 1, sharex=True, squeeze=False)[:, 0]
    for axis, (name, h) in zip(axes, harvests.items(), strict=True):
        for r in h.rounds:
            axis.barh(machine.arms, r.times.makespan, left=r.begin, height=0.7, color=GREY)
            for arm, start, end, held, got in zip(
                r.times.arm, r.times.start, r.times.end, r.times.held, r.outcome.collected, strict=True
            ):
                colour = COLOURS[arm % len(COLOURS)]
                axis.barh(
                    arm,
                    end - start,
                    left=r.begin + start,
                    height=0.7,
                    edgecolor=colour,
                    color=colour if got else "none",
                )
                if held > 0:
                    axis.barh(arm, held, left=r.begin + start - held, height=0.15, color=RED)
        axis.set_yticks(range(machine.arms + 1), [*(f"slave {i + 1}" for i in range(machine.arms)), "master stands"])
        axis.set_title(f"{name}: {int(h.collected.sum())} fruit in {h.seconds:.0f} s (hollow: empty cup, red: held)")
    axes[-1].set_xlim(left=0.0)
    axes[-1].set_xlabel("time on one tree, s")
    return figure


def pick_map(harvests: Mapping[str, Harvest]) -> Figure:
    """The tree's side with its fruit by the arm that collected it, and frame 3 at each pick point."""
    figure = Figure(figsize=(11, 5), layout="constrained")
    axes = figure.subplots(1, len(harvests), sharey=True, squeeze=False)[0]
    for axis, (name, h) in zip(axes, harvests.items(), strict=True):
        fruit = h.tree.fruit * 1e3
        for arm in range(int(h.by_arm.max(initial=0)) + 1):
            mine = h.collected & (h.by_arm == arm)
            axis.scatter(fruit[mine, 0], fruit[mine, 2], s=60, color=COLOURS[arm], label=f"slave {arm + 1}")
        left = ~h.collected
        axis.scatter(fruit[left, 0], fruit[left, 2], s=60, marker="x", color=RED, label="not collected")
        for r in h.rounds:
            zone = np.array([r.zone.left, r.zone.right, r.zone.right, r.zone.left, r.zone.left])
            high = np.array([r.zone.bottom, r.zone.bottom, r.zone.top, r.zone.top, r.zone.bottom])
            axis.plot(zone * 1e3, high * 1e3, color=GREY, lw=0.6)
        axis.set(title=name, xlabel="x along the row, mm", aspect="equal")
        axis.invert_xaxis()
    axes[0].set_ylabel("z above the base, mm")
    axes[-1].legend(loc="center left", bbox_to_anchor=(1, 0.5), frameon=False)
    return figure


def funnel_bars(trees: Mapping[str, Sequence[Harvest]]) -> Figure:
    """Share of present fruit that gets to each stage, by strategy."""
    figure = Figure(figsize=(9, 4), layout="constrained")
    axis = figure.subplots()
    for i, (name, harvests) in enumerate(trees.items()):
        counts = funnel(harvests)
        share = [100 * counts[stage] / max(counts["present"], 1) for stage in STAGES]
        axis.bar(np.arange(len(STAGES)) + 0.17 * i, share, 0.16, color=COLOURS[i], label=name)
    axis.set_xticks(np.arange(len(STAGES)) + 0.34, STAGES)
    axis.set(ylabel="% of fruit present", ylim=(50, 101))
    axis.legend(frameon=False, ncols=5, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    return figure


def throughput_by_arms(throughput: Mapping[str, Mapping[int, Measure]]) -> Figure:
    """Picks per hour against the number of slave arms, for each density of fruit."""
    figure = Figure(figsize=(6, 4), layout="constrained")
    axis = figure.subplots()
    for i, (label, measures) in enumerate(throughput.items()):
        arms = list(measures)
        values = np.array([measures[n].value for n in arms])
        spread = np.abs(np.array([[measures[n].low, measures[n].high] for n in arms]).T - values)
        axis.errorbar(arms, values, spread, marker="o", capsize=3, color=COLOURS[i], label=label)
    axis.set(xlabel="slave arms", ylabel="picks per hour (optimised, machine as drawn)")
    axis.set_ylim(bottom=0.0)
    axis.legend(frameon=False)
    return figure


def workspace_cloud(machine: Machine) -> Figure:
    """Fig. 8: Monte-Carlo cloud of the cups, from above and from the side; the paper's ranges dashed."""
    cloud = workspace(machine, 4000, np.random.default_rng(0)) * 1e3
    figure = Figure(figsize=(11, 5), layout="constrained")
    axes = figure.subplots(1, 2)
    for axis, (a, b), (x, y) in zip(
        axes, ((0, 1), (0, 2)), (((-1500, 1500), (-1700, -500)), ((-1500, 1500), (400, 2600))), strict=True
    ):
        for arm in range(machine.arms):
            axis.scatter(cloud[:, arm, a], cloud[:, arm, b], s=1, color=COLOURS[arm], label=f"slave {arm + 1}")
        axis.plot(
            [x[0], x[1], x[1], x[0], x[0]], [y[0], y[0], y[1], y[1], y[0]], color=RED, ls="--", label="paper: dense"
        )
        axis.set(xlabel=f"{'xyz'[a]}, mm", ylabel=f"{'xyz'[b]}, mm", aspect="equal")
    axes[1].legend(markerscale=8, frameon=False, loc="center left", bbox_to_anchor=(1, 0.5))
    return figure


def curves(
    machine: Machine, targets_mm: Mapping[str, tuple[int, int, int]], pick_point_mm: tuple[int, int, int]
) -> Figure:
    """Fig. 9: joint displacements of section 4.2 over time, with the machine's own spacing."""
    master = machine.master_inverse(np.array(pick_point_mm) * 1e-3)
    joints = machine.slave_inverse(master, np.array(list(targets_mm.values())) * 1e-3)
    goal = np.array([joints[i, i].clip(machine.slave.lower, machine.slave.upper) for i in range(machine.arms)])
    start = np.concatenate([machine.master_start, *[machine.slave_home] * machine.arms])
    time, moved = joint_curves(machine, start, np.concatenate([master, goal.ravel()]))
    figure = Figure(figsize=(11, 4), layout="constrained")
    slides, turns = figure.subplots(1, 2)
    for i in range(machine.joints):
        arm, joint = (i - 3) // 3, i % 3
        turn = i == 0 or (i >= 3 and joint == 1)
        name = (
            f"master {('theta1', 'd2', 'd3')[joint]}"
            if i < 3
            else f"{list(targets_mm)[arm]} {('d4', 'theta5', 'd6')[joint]}"
        )
        style = {"color": "black" if i < 3 else COLOURS[arm], "ls": ("-", "--", ":")[joint], "label": name}
        (turns if turn else slides).plot(time, moved[:, i] * (1 if turn else 1e3), **style)
    slides.set(xlabel="time, s", ylabel="displacement, mm", title="sliding joints")
    turns.set(xlabel="time, s", ylabel="displacement, rad", title="turning joints")
    slides.legend(frameon=False, fontsize=8)
    turns.legend(frameon=False, fontsize=8)
    return figure
