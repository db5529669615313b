"""What changes when the simulation is as hard as reality. Part of `findings.py`.

Arms of `field` have a remainder as measured ones have it; a tracker in time measures the moving arm.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from findings_transfer import whisker

from pickenv.agents.evaluation.calibrated import COMPENSATIONS
from pickenv.agents.evaluation.grid import PolicyGrid
from pickenv.agents.evaluation.grid_tables import interval_words, with_interval
from pickenv.arm.kinematics.geometry import Array
from pickenv.inspect.colours import policy_colours, policy_label
from pickenv.inspect.figures.style import WIDTH, new_figure, rgb
from pickenv.intervals import Estimate, mean_estimate, quantile_estimate, statistic_interval

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SMOOTH, HARD = "qiao2026", "field"
MODELS = ("ls_bpnn", "best")
"""What is added to least squares."""
IDEAL_ON = ("orchard", "field")
"""Plants that are measured by both instruments; on `qiao2026` they differ by their noise alone."""


def errors_of(grid: PolicyGrid, key: str, plant: str) -> Array:
    """Final errors ``(arms, 1, fruit)`` of the scripted policy, blind, mm."""
    return grid.cell("scripted", key, "encoders", plant).errors_mm


def removed(grid: PolicyGrid, key: str, plant: str, of: str = "ls") -> Estimate:
    """Share of the mean error behind one compensation that another removes."""
    table = np.column_stack([errors_of(grid, each, plant).mean(axis=(1, 2)) for each in (of, key)])
    return Estimate(_share_removed(table), statistic_interval(table, _share_removed), "needs more arms")


def _share_removed(table: Array) -> float:
    """Of rows (error before, error after), one per arm."""
    before, after = table.mean(axis=0)
    return float(1.0 - after / before)


def changed(grid: PolicyGrid, ideal: PolicyGrid, plant: str) -> Estimate:
    """Error behind least squares from the instrument in time less that from the ideal one; same arms, poses, fruit."""
    return mean_estimate(errors_of(grid, "ls", plant) - errors_of(ideal, "ls", plant))


def reality_figure(grid: PolicyGrid, ideal: PolicyGrid) -> Figure:
    """Left what models add to least squares, by plant; right the two instruments."""
    colours = dict(zip(COMPENSATIONS, rgb(policy_colours(COMPENSATIONS)), strict=True))
    with new_figure(WIDTH, 2.9) as figure:
        left, right = figure.subplots(1, 2)
        _draw_models(left, grid, colours)
        _draw_instruments(right, grid, ideal, colours)
        shown = ("raw", "ls", *MODELS)
        handles = [left.plot([], [], color=colours[key], linewidth=3.0, label=policy_label(key))[0] for key in shown]
        figure.legend(handles=handles, loc="outside lower center", ncols=len(handles))
    return figure


def _draw_models(axes: Any, grid: PolicyGrid, colours: dict[str, Any]) -> None:
    """Share of LS's error that each model removes."""
    plants = (SMOOTH, HARD)
    for y, plant in enumerate(plants):
        for place, key in zip((-0.15, 0.15), MODELS, strict=True):
            whisker(axes, y + place, removed(grid, key, plant), colours[key], 100.0)
    axes.axvline(0.0, color="0.8", zorder=0)
    axes.set_yticks(range(len(plants)), plants)
    axes.set(ylim=(len(plants) - 0.5, -0.5), xlim=(None, 100.0), xlabel="removed of LS's error (%)")
    axes.set_title("What models add to LS")


def _draw_instruments(axes: Any, grid: PolicyGrid, ideal: PolicyGrid, colours: dict[str, Any]) -> None:
    """Errors raw, and behind LS from each instrument."""
    rows = [
        (f"{plant}, {name}", mean_estimate(errors_of(of, key, plant)), colours[key])
        for plant in IDEAL_ON
        for name, of, key in (
            ("raw", grid, "raw"),
            ("LS, ideal instrument", ideal, "ls"),
            ("LS, instrument in time", grid, "ls"),
        )
    ]
    for y, (_, found, colour) in enumerate(rows):
        whisker(axes, y, found, colour)
    axes.set_yticks(range(len(rows)), [name for name, _, _ in rows])
    axes.set(ylim=(len(rows) - 0.5, -0.5), xlim=(0.0, None), xlabel="mean position error (mm)")
    axes.set_title("What the instrument changes")


def reality_sentence(grid: PolicyGrid, ideal: PolicyGrid) -> str:
    """What the figure says."""
    shares = {key: [_percent(removed(grid, key, plant)) for plant in (SMOOTH, HARD)] for key in MODELS}
    (first, added), (second, both) = ((policy_label(key), shares[key]) for key in MODELS)
    changes = [f"{_change(changed(grid, ideal, plant))} mm on `{plant}`" for plant in IDEAL_ON]
    return (
        f"Of what LS leaves the scripted policy, {first} removes {added[0]} on the smooth `{SMOOTH}` and {added[1]} on "
        f"`{HARD}`, {second} {both[0]} and {both[1]}; an instrument that measures arms in time, rather than when arm "
        f"and ground have come to rest, changes the error behind LS by {' and '.join(changes)}. Poses and fruit come "
        "from the same ranges here; [Results](results.md) has blocks that are held out."
    )


def reality_tables(grid: PolicyGrid, ideal: PolicyGrid) -> list[str]:
    """What models remove, and the instruments."""
    lines = [
        "Share of the scripted policy's mean error that a calibration removes, 95 % interval over arms.",
        "",
        f"| plant | LS of raw | {' | '.join(f'{policy_label(key)} of LS' for key in MODELS)} |",
        "|---|---|" + "---|" * len(MODELS),
    ]
    for plant in (SMOOTH, HARD):
        found = [removed(grid, "ls", plant, of="raw"), *(removed(grid, key, plant) for key in MODELS)]
        lines.append(f"| {plant} | {' | '.join(map(_percent, found))} |")
    lines += [
        "",
        "The same arms, poses and fruit behind LS from each instrument (mm), 95 % interval over arms; the median arm "
        "beside the mean, since single reaches on `orchard` can be lost.",
        "",
        "| plant | instrument | mean | median arm | largest reach | change of the mean | significant |",
        "|---|---|---|---|---|---|---|",
    ]
    for plant in IDEAL_ON:
        change = changed(grid, ideal, plant)
        said = f"{_change(change)} | {'yes' if change.significant else 'no'}"
        for name, of, last in (("ideal", ideal, " | "), ("in time", grid, said)):
            errors = errors_of(of, "ls", plant)
            middle = quantile_estimate(errors, 0.5)
            numbers = f"{_mm(errors)} | {with_interval(middle.value, middle.ci95, 2)} | {errors.max():.1f}"
            lines.append(f"| {plant} | {name} | {numbers} | {last} |")
    return [*lines, ""]


def _percent(found: Estimate) -> str:
    return with_interval(found.value, found.ci95, 0, 100.0, " %")


def _mm(errors: Array) -> str:
    found = mean_estimate(errors)
    return with_interval(found.value, found.ci95, 2)


def _change(found: Estimate) -> str:
    ends = interval_words(found.ci95, 3, sign="+") or found.missing
    return f"{found.value:+.3f} ({ends})"
