"""A day in the orchard: the arm warms up and the machine sinks; what online adaptation saves. Part of `findings.py`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from pickenv.agents.evaluation.calibrated import compensators
from pickenv.agents.evaluation.grid import GridSettings, population
from pickenv.agents.evaluation.grid_tables import interval_words, with_interval
from pickenv.arm import forward
from pickenv.arm.kinematics.geometry import Array
from pickenv.arm.plant.plant import Plant
from pickenv.calibration import complete_model, random_joints, start_filter
from pickenv.calibration.compensation.compensator import aimed, taught
from pickenv.inspect.colours import policy_colours
from pickenv.inspect.figures.style import LINES, WIDTH, new_figure, rgb
from pickenv.inspect.recordings.field_day import CAMERA_STD, DAY_HOURS, DRIFTS, LOOK, PRIOR, WALK
from pickenv.intervals import Estimate, mean_estimate
from pickenv.seeds import stream

if TYPE_CHECKING:
    from matplotlib.figure import Figure

METHODS = ("raw", "calibrated in the workshop", "and adapted online")


@dataclass(frozen=True, eq=False)
class Day:
    """Errors of a day.

    Attributes:
        hours: Time of each pick ``(K,)``.
        errors_mm: By method, ``(arms, K)``.
    """

    hours: Array
    errors_mm: dict[str, Array]


def run_day(settings: GridSettings, picks: int) -> Day:
    """Let each arm of the plant orchard pick all day, three times."""
    plants: Plant = population(settings, "orchard")
    arms = settings.arms
    nominal = plants.arm.nominal
    rng = np.random.default_rng(stream(settings.seed, "picks"))
    goals = random_joints(nominal, picks * arms, rng).reshape(picks, arms, -1)
    noise = rng.normal(size=(picks, arms, 3)) * CAMERA_STD
    dt = DAY_HOURS * 3600.0 / picks
    # The workshop: firm ground, and the temperature at which the arm was built.
    fitted = compensators(plants.without(DRIFTS), "ls", settings.protocol) or []
    errors: dict[str, Any] = {}
    for method in METHODS:
        state = plants.initial_state(np, list(goals[0].T))
        filters = None
        if method == METHODS[2]:
            start = start_filter(
                complete_model(nominal), nominal, goals.reshape(-1, nominal.joints)[:300], full_pose=False, prior=PRIOR
            )
            filters = [start] * arms
        rows = []
        for k in range(picks):
            target = goals[k]
            wanted = forward(nominal, target).position
            if filters is not None:
                target = aimed(nominal, filters, target)
            command = target
            if method != METHODS[0]:
                command = np.stack([f(q) for f, q in zip(fitted, target, strict=True)])
            state, frame = plants.advance(np, state, list(command.T), dt)
            tool = np.stack(np.broadcast_arrays(*frame[9:12]), axis=-1)
            rows.append(np.linalg.norm(tool - wanted, axis=-1) * 1e3)
            if filters is not None:
                filters = taught(filters, target, tool + noise[k], LOOK, WALK, dt)
        errors[method] = np.array(rows).T
    return Day((np.arange(picks) + 1.0) * dt / 3600.0, errors)


def day_figure(day: Day) -> Figure:
    """Mean error over the day."""
    with new_figure(WIDTH, 3.2) as figure:
        axis: Any = figure.subplots()
        width = max(1, len(day.hours) // 16)
        raw, fixed, _, adapted = rgb(policy_colours(["raw", "ls", "best", "adapted"]))
        lines = zip((raw, fixed, adapted), LINES, strict=False)
        for (name, values), (colour, line) in zip(day.errors_mm.items(), lines, strict=True):
            smooth = np.convolve(values.mean(axis=0), np.ones(width) / width, mode="valid")
            axis.plot(day.hours[width - 1 :], smooth, linestyle=line, color=colour, label=name)
        axis.set_xlabel("time since the machine was switched on (h)")
        axis.set_ylabel("mean position error (mm)")
        axis.set_ylim(bottom=0.0)
        figure.legend(loc="outside lower center", ncols=len(METHODS))
    return figure


def day_changes(day: Day) -> tuple[Estimate, Estimate]:
    """What the workshop changes, and what the filter changes after it, mm."""
    raw, fixed, adapted = (day.errors_mm[name][:, None] for name in METHODS)
    return mean_estimate(fixed - raw), mean_estimate(adapted - fixed)


def day_sentence(day: Day) -> str:
    """What the figure says."""
    gained, saved = day_changes(day)
    return (
        f"Over {DAY_HOURS:g} h in which the arms of `orchard` warm up and the machine tilts and sinks, a calibration "
        f"in the workshop changes the mean error by {_change(gained)} mm, and a filter that sees the tool once per "
        f"pick changes it by a further {_change(saved)} mm."
    )


def day_tables(day: Day) -> list[str]:
    """Parts of the day."""
    parts = {
        "whole day": np.ones(len(day.hours), dtype=bool),
        "first hour": day.hours <= DAY_HOURS / 8,
        "last two hours": day.hours > DAY_HOURS * 3 / 4,
    }
    lines = [
        f"A day of {DAY_HOURS:g} h on `orchard`, {len(next(iter(day.errors_mm.values())))} arms, {len(day.hours)} "
        "picks each; calibrated by least squares on firm ground; the filter on geometry, base and tool takes one "
        f"picture of the tool per pick ({CAMERA_STD * 1e3:g} mm per axis). Mean error (mm), 95 % interval over arms.",
        "",
        "| | " + " | ".join(parts) + " | largest |",
        "|---|" + "---|" * (len(parts) + 1),
    ]
    for name, values in day.errors_mm.items():
        found = [mean_estimate(values[:, None, part]) for part in parts.values()]
        cells = " | ".join(with_interval(each.value, each.ci95, 2) for each in found)
        lines.append(f"| {name} | {cells} | {values.max():.0f} |")
    return [*lines, ""]


def _change(found: Estimate) -> str:
    ends = interval_words(found.ci95, 2, sign="+")
    return f"{found.value:+.2f}" + (f" ({ends})" if ends else "")
