"""Figures of compared policies: aggregates with intervals, success against error, accuracy against cycle time."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from pickenv.agents.evaluation.grid import PolicyGrid
from pickenv.arm.kinematics.geometry import Array
from pickenv.envs.shared.situation import CONTROL_PERIOD
from pickenv.inspect.colours import policy_label
from pickenv.inspect.figures import plot_policies
from pickenv.inspect.figures.plot_errors import error_by_method, error_cumulative
from pickenv.inspect.figures.run_drawings import Drawing
from pickenv.inspect.runs.matters import gripper_curves
from pickenv.intervals import Estimate, mean_estimate, quantile_estimate, share_estimate

STATISTICS: Mapping[str, Callable[[Array], Estimate]] = {
    "mean": mean_estimate,
    "median arm": lambda values: quantile_estimate(values, 0.5),
    "95th percentile arm": lambda values: quantile_estimate(values, 0.95),
}


def aggregate_figure(grid: PolicyGrid) -> Figure:
    """Mean, median and 95th percentile over arms of every cell with 95 % intervals, one panel row per plant."""
    panels: dict[str, dict[str, dict[str, dict[str, plot_policies.Estimated]]]] = {}
    for cell in grid.cells:
        for title, statistic in STATISTICS.items():
            found = statistic(cell.errors_mm)
            policies = panels.setdefault(cell.plant, {}).setdefault(title, {})
            policies.setdefault(f"{cell.policy}\n{cell.feedback}", {})[policy_label(cell.compensation)] = (
                found.value,
                found.ci95,
            )
    return plot_policies.aggregates(panels)


def success_curves(grid: PolicyGrid, plant: str) -> Figure:
    """Success against lateral error for each gripper, and where the scripted policy lies on it, with its interval."""
    points: dict[str, dict[str, tuple[float, plot_policies.Estimated]]] = {}
    for cell in grid.cells:
        if cell.policy == "scripted" and cell.plant == plant:
            for name, gripper in grid.grippers.items():
                success = share_estimate(cell.chances(gripper))
                place = (float(cell.errors_mm.mean()), (success.value, success.ci95))
                points.setdefault(policy_label(cell.compensation), {})[name] = place
    return plot_policies.success_against_misalignment(gripper_curves(tuple(grid.grippers)), points)


def cycle_figure(grid: PolicyGrid, period: float, plant: str) -> Figure:
    """Accuracy against cycle time: mean error if the pick were made after each step, and the Pareto front of all.

    Policies with a camera are shown on raw arms only.
    """
    curves = [
        plot_policies.CycleCurve(
            cell.policy,
            policy_label(cell.compensation),
            np.mean([rollout.error_mm.mean(axis=1) for rollout in cell.rollouts], axis=0),
        )
        for cell in grid.cells
        if cell.plant == plant
        and cell.policy != "random"
        and not (cell.feedback == "camera" and cell.compensation != "raw")  # then all compensations look alike
    ]
    return plot_policies.accuracy_against_cycle_time(curves, period, title=plant)


def grid_drawings(grid: PolicyGrid) -> Sequence[Drawing]:
    """Every figure of a comparison."""
    found = [
        Drawing(
            "aggregates",
            "Final position errors of every policy over arms, with 95 % intervals; an arrow is an open end.",
            lambda: aggregate_figure(grid),
        )
    ]
    for plant in dict.fromkeys(cell.plant for cell in grid.cells):
        scripted = {
            policy_label(cell.compensation): cell.errors_mm.ravel()
            for cell in grid.cells
            if cell.plant == plant and cell.policy == "scripted"
        }
        found.append(
            Drawing(
                f"accuracy_against_cycle_time_{Path(plant).stem}",
                f"Mean position error on {plant} if the pick were made after each step.",
                lambda plant=plant: cycle_figure(grid, CONTROL_PERIOD, plant),  # type: ignore[misc]
            )
        )
        if scripted:
            found += [
                Drawing(
                    f"success_against_misalignment_{Path(plant).stem}",
                    f"What each gripper forgives, and where the scripted policy on {plant} lies on its curve.",
                    lambda plant=plant: success_curves(grid, plant),  # type: ignore[misc]
                ),
                Drawing(
                    f"error_by_compensation_{Path(plant).stem}",
                    f"Final position errors of the scripted policy on {plant}.",
                    lambda e=scripted: error_by_method(e, counted="reaches"),  # type: ignore[misc]
                ),
                Drawing(
                    f"error_cumulative_{Path(plant).stem}",
                    f"Share of the scripted policy's reaches on {plant} whose error is at most x.",
                    lambda e=scripted: error_cumulative(e, counted="reaches"),  # type: ignore[misc]
                ),
            ]
    return found
