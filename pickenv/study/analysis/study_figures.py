"""Figures of a study: yields and errors against what was varied, distributions, sensitivities, one arm among many.

Each takes the tables of `yields`, `quantiles` and `sensitivity` and returns a matplotlib figure; mm, degrees, percent.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import pyarrow as pa
from matplotlib.figure import Figure

from pickenv.errors import InputError
from pickenv.inspect.colours import GREEN, OTHERS, RED, policy_colours, viridis
from pickenv.inspect.figures.style import LINES, MARKS, SOFT, WIDTH, new_figure, plain_decades, rgb
from pickenv.study.analysis.study_verdict import method_label
from pickenv.study.design.config import RAW
from pickenv.study.results.held_rows import Row, held

AXES = {
    "it_grade": "IT grade of the lengths (ISO 286-1)",
    "poses": "calibration poses (number)",
    "noise_mm": "tracker noise, standard deviation per axis (mm)",
    "payload_kg": "payload (kg)",
}
"""What a study may vary along an axis, and the axis's label."""
WORDS = {"it_grade": "IT{}", "poses": "{} poses", "noise_mm": "noise {:g} mm", "payload_kg": "payload {:g} kg"}
ERROR, ERROR_LABEL = "error_mean_mm", "arm's mean position error (mm)"
NOTE = 7.5
"""Size of the line below a figure that says how to read it, points."""
LONGEST = 16
"""Parameters in a tornado; the rest are as good as zero."""


def setting_label(row: Row) -> str:
    """A setting in a few words, with units."""
    calibration = (
        "raw"
        if row["method"] == RAW
        else f"{method_label(row['method'])}, {row['poses']} poses, noise {row['noise_mm']:g} mm"
    )
    load = f", payload {row['payload_kg']:g} kg" if row["payload_kg"] else ""
    return f"{row['tolerances']}, IT{row['it_grade']}, {calibration}{load}"


def varied(rows: Sequence[Row]) -> list[str]:
    """Which of `AXES` take several values among calibrated settings (payload and grade among all)."""
    calibrated = [row for row in rows if row["method"] != RAW]
    return [
        name for name in AXES if len({row[name] for row in (calibrated if name in ("poses", "noise_mm") else rows)}) > 1
    ]


def yield_curves(yields: pa.Table, along: str, specification: str) -> Figure:
    """Share of arms within specification against one of `AXES`, with Wilson's 95 % bands.

    Args:
        yields: From `yields.yields_of`.
        along: The axis; what else varies is shown by colour and line, or held at its middle value, which is named.
        specification: When an arm is good enough, in words.

    Raises:
        InputError: If the study did not vary ``along``.
    """
    keys = ("yield", "yield_low", "yield_high")
    figure = _curves(yields.to_pylist(), along, keys, "arms within specification (%)", 100.0)
    figure.supxlabel(f"yield with 95 % bands; within specification: {specification}", fontsize=NOTE)
    for axes in figure.axes:
        axes.set_ylim(-3.0, 103.0)
    return figure


def error_curves(quantiles: pa.Table, along: str) -> Figure:
    """Median of the arms' errors against one of `AXES`; the band holds 90 % of the arms.

    Args:
        quantiles: From `quantiles.quantiles_of`, with probabilities 0.05, 0.5 and 0.95.
        along: The axis.

    Raises:
        InputError: If the study did not vary ``along``.
    """
    merged: dict[int, dict[str, Any]] = {}
    for row in _quantiles(quantiles):
        merged.setdefault(row["setting"], dict(row))[f"q{row['probability']:g}"] = row["value"]
    figure = _curves(list(merged.values()), along, ("q0.5", "q0.05", "q0.95"), ERROR_LABEL, 1.0)
    figure.supxlabel("lines: median arm; bands: the middle 90 % of arms", fontsize=NOTE)
    for axes in figure.axes:
        axes.set_ylim(bottom=0.0)
    return figure


def distributions(quantiles: pa.Table, radius_mm: float | None = None) -> Figure:
    """Cumulative distribution of the arms' errors, one curve per grade and method.

    Args:
        quantiles: With many probabilities, such as 0.01 to 0.99.
        radius_mm: The specified radius, drawn as a line when given.
    """
    rows = _quantiles(quantiles)
    if not rows:
        raise InputError("no arm has a result; there is no distribution to draw")
    chosen = held(rows, ("it_grade", "method"))
    settings = {row["setting"]: row for row in chosen}
    grades = sorted({row["it_grade"] for row in settings.values()})
    methods = list(dict.fromkeys(row["method"] for row in settings.values()))
    with new_figure(WIDTH * 0.75, 3.7) as figure:
        axes = figure.add_subplot(xlabel=ERROR_LABEL, ylabel="arms at or below it (%)")
        axes.set_title("Errors over the population of arms")
        for setting, row in settings.items():
            points = [(r["value"], 100.0 * r["probability"]) for r in chosen if r["setting"] == setting]
            x, y = np.array(sorted(points, key=lambda point: point[1])).T
            line = LINES[methods.index(row["method"]) % len(LINES)]
            axes.plot(x, y, linestyle=line, color=_ordered(grades, row["it_grade"]))
        if radius_mm is not None:
            axes.axvline(radius_mm, color=rgb([RED])[0], linewidth=1.0)
            axes.annotate(
                f"specified radius {radius_mm:g} mm", (radius_mm, 3.0), (3, 0), textcoords="offset points", fontsize=8
            )
        for grade in grades:
            axes.plot([], [], color=_ordered(grades, grade), linewidth=3.0, label=f"IT{grade}")
        for i, method in enumerate(methods):
            axes.plot([], [], linestyle=LINES[i % len(LINES)], color=SOFT, label=method_label(method))
        low = min(row["value"] for row in chosen)
        axes.set(xscale="log", ylim=(0.0, 100.0), xlim=(0.8 * low, None))
        plain_decades(axes.xaxis)
        figure.legend(loc="outside right upper", title=_held_words(chosen, ("it_grade", "method")))
    return figure


def tornado(sensitivities: pa.Table, setting: str) -> Figure:
    """Which tolerance matters: share of the variance between arms, per parameter and per kind, with intervals.

    Args:
        sensitivities: From `sensitivity.sensitivities_of`.
        setting: The setting in words.
    """
    rows = sensitivities.to_pylist()
    single = [row for row in rows if row["level"] == "parameter"][:LONGEST]
    kinds = [row for row in rows if row["level"] == "kind"]
    order = [row["kind"] for row in kinds]
    palette = rgb([*policy_colours(["ls", "raw"]), GREEN, *OTHERS])
    with new_figure(WIDTH, 1.3 + 0.2 * max(len(single), 6)) as figure:
        left, right = figure.subplots(1, 2, width_ratios=(3, 2))
        for axes, bars, title in ((left, single, "by parameter"), (right, kinds, "by kind")):
            for place, row in enumerate(bars):
                share, low, high = (100.0 * row[key] for key in ("share", "share_low", "share_high"))
                axes.barh(place, share, color=palette[order.index(row["kind"]) % len(palette)], height=0.7)
                axes.plot([low, high], [place, place], color=SOFT, linewidth=1.2)
            axes.set_yticks(range(len(bars)), [_parameter_label(row["parameter"]) for row in bars], fontsize=8)
            least = min(0.0, *(100.0 * row["share_low"] for row in bars))
            axes.set(ylim=(max(len(bars), len(single)) - 0.4, -0.6), xlim=(least, None), xlabel="share of variance (%)")
            axes.set_title(title)
            axes.grid(axis="y", visible=False)
        figure.suptitle(f"Which tolerance matters: {setting}", x=0.01, ha="left", fontsize=9, fontweight="bold")
        note = f"squared error regressed on {rows[0]['arms']} arms, R² = {rows[0]['r2']:.2f}; lines: 95 % intervals"
        figure.supxlabel(note, fontsize=NOTE)
    return figure


def arm_among_population(
    quantiles: pa.Table, setting: int, error_mm: float, name: str, percentile: tuple[float, float, float]
) -> Figure:
    """Where one arm stands in the population of a setting.

    Args:
        quantiles: With many probabilities.
        setting: Number of the setting.
        error_mm: The arm's mean position error, mm.
        name: The arm, for the label.
        percentile: Share of the population below it in equal circumstances, with its 95 % interval, 0..1.
    """
    rows = [row for row in _quantiles(quantiles) if row["setting"] == setting]
    if not rows:
        raise InputError(f"the quantiles have no arm of setting {setting}; give another setting")
    rows.sort(key=lambda row: row["probability"])
    value, low, high = (np.array([row[key] for row in rows], dtype=float) for key in ("value", "low", "high"))
    level = 100.0 * np.array([row["probability"] for row in rows])
    blue, red = rgb([*policy_colours(["ls"]), RED])
    share, least, most = (100.0 * p for p in percentile)
    with new_figure(WIDTH * 0.7, 3.4) as figure:
        axes = figure.add_subplot(xlabel=ERROR_LABEL, ylabel="arms at or below it (%)")
        axes.fill_betweenx(
            level, low, high, color=blue, alpha=0.25, linewidth=0.0, label="95 % band, as far as so many arms bound it"
        )
        axes.plot(value, level, color=blue, label=f"population of {rows[0]['arms']} arms")
        label = f"{name}: {error_mm:.2f} mm, better than {100.0 - share:.0f} % ({100 - most:.0f} to {100 - least:.0f})"
        axes.plot([error_mm], [share], "D", color=red, markersize=6, label=label, clip_on=False)
        axes.set_title(setting_label(rows[0]))
        axes.set(ylim=(0.0, 100.0), xlim=(0.0, None))
        figure.legend(loc="outside lower center", fontsize=8)
    return figure


def _quantiles(table: pa.Table) -> list[dict[str, Any]]:
    """The rows of the mean position error, of settings that have any arm with a result."""
    return [row for row in table.to_pylist() if row["quantity"] == ERROR and row["arms"]]


def _curves(rows: Sequence[Row], along: str, keys: tuple[str, str, str], ylabel: str, factor: float) -> Figure:
    """Curves with bands: a panel per tolerance class; colour and line style for what varies beside the axis."""
    if along not in AXES or along not in varied(rows):
        raise InputError(f"the study does not vary '{along}'; draw one of {varied(rows) or 'none'}")
    beside = ("method", "poses") if along == "it_grade" else ("method", "it_grade")
    shown = ("tolerances", along, *beside)
    classes = list(dict.fromkeys(row["tolerances"] for row in rows))
    chosen = [r for r in held(rows, shown) if along not in ("poses", "noise_mm") or r["method"] != RAW]
    colours, lines = _looks(chosen, along)
    with new_figure(WIDTH * (0.75 if len(classes) == 1 else 1.0), 3.7) as figure:
        panels: Any = figure.subplots(1, len(classes), squeeze=False, sharey=True)[0]
        for axes, name in zip(panels, classes, strict=True):
            for label, curve in _series([r for r in chosen if r["tolerances"] == name], along, beside):
                x = [row[along] for row in curve]
                middle, low, high = (factor * np.array([row[key] for row in curve], dtype=float) for key in keys)
                colour, (line, mark) = colours(curve[0]), lines(curve[0])
                axes.fill_between(x, low, high, color=colour, alpha=0.18, linewidth=0.0)
                axes.plot(x, middle, linestyle=line, marker=mark, color=colour, label=label, markersize=4.0)
            if along in ("it_grade", "poses"):
                axes.set_xticks(sorted({row[along] for row in chosen}))
            else:
                axes.set_xlim(left=0.0)
            axes.set_xlabel(AXES[along])
            axes.set_title(f"Tolerance class {name}")
        panels[0].set_ylabel(ylabel)
        handles, labels = panels[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside right upper", fontsize=8, title=_held_words(chosen, shown))
    return figure


def _held_words(rows: Sequence[Row], shown: Sequence[str]) -> str | None:
    """What was held, for the legend's title."""
    calibrated = [row for row in rows if row["method"] != RAW]
    words = [WORDS[name].format(calibrated[0][name]) for name in AXES if name not in shown] if calibrated else []
    return "\n".join(words) or None


def _series(rows: Sequence[Row], along: str, beside: tuple[str, str]) -> Iterator[tuple[str, list[Row]]]:
    """Rows of one curve each, with its label, ordered along the axis."""
    keys = sorted({(row[beside[0]], row[beside[1]]) for row in rows}, key=lambda key: (key[0] != RAW, *key))
    for key in keys:
        curve = sorted((r for r in rows if (r[beside[0]], r[beside[1]]) == key), key=lambda row: row[along])
        detail = "" if beside[1] == "poses" and key[0] == RAW else ", " + WORDS[beside[1]].format(key[1])
        yield method_label(key[0]) + detail, curve


def _looks(rows: Sequence[Row], along: str) -> tuple[Any, Any]:
    """Colour and (line, mark) of a curve: against the grade the method has the colour, else the grade has it."""
    methods = list(dict.fromkeys(row["method"] for row in rows))
    if along == "it_grade":
        colours = dict(zip(methods, rgb(policy_colours(methods)), strict=True))
        poses = sorted({row["poses"] for row in rows if row["method"] != RAW})

        def line(row: Row) -> tuple[Any, str]:
            place = poses.index(row["poses"]) if row["poses"] in poses else 0
            return LINES[place % len(LINES)], MARKS[place % len(MARKS)]

        return lambda row: colours[row["method"]], line
    grades = sorted({row["it_grade"] for row in rows})

    def by_method(row: Row) -> tuple[Any, str]:
        place = methods.index(row["method"])
        return LINES[place % len(LINES)], MARKS[place % len(MARKS)]

    return lambda row: _ordered(grades, row["it_grade"]), by_method


def _ordered(values: Sequence[Any], value: Any) -> tuple[float, ...]:
    """A colour of Viridis by rank, short of its ends, which a dark or a light page swallows."""
    fraction = 0.3 + 0.55 * values.index(value) / max(len(values) - 1, 1)
    return tuple(float(c) / 255.0 for c in viridis(fraction))


def _parameter_label(name: str) -> str:
    """delta_a2_mm as a2; size_joint_stiffness_1 as joint stiffness 1."""
    for end in ("_mm", "_deg"):
        name = name.removesuffix(end)
    return name.removeprefix("delta_").removeprefix("size_").removesuffix("_K").replace("_", " ")
