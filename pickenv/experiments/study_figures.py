"""Figures of a study: yields and errors against what was varied, distributions, sensitivities, one arm among many.

Each takes rows of yields, quantiles or sensitivities and returns a matplotlib figure; mm, degrees, percent.
`study_drawings` says which of them a study allows, with their captions, and why others are left out.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from textwrap import wrap
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from pickenv.arm import Array
from pickenv.base import InputError
from pickenv.experiments.study import RAW
from pickenv.experiments.study_arms import ERROR
from pickenv.experiments.study_findings import FEW, Findings, Placement, method_label, setting_label, specified
from pickenv.experiments.study_rows import Row, held
from pickenv.inspect.colours import GREEN, OTHERS, RED, policy_colours
from pickenv.inspect.figures.run_drawings import Drawing, Drawings, NotDrawn
from pickenv.inspect.figures.style import (
    INK,
    LINES,
    MARKS,
    SOFT,
    WIDTH,
    alike,
    headline,
    new_figure,
    plain_decades,
    rgb,
    short,
)

AXES: Mapping[str, tuple[str, str, str]] = {
    "it_grade": ("the grade of the machined lengths", "IT grade of the lengths (ISO 286-1)", "IT{}"),
    "poses": ("the number of calibration poses", "calibration poses (number)", "{} poses"),
    "noise_mm": ("the tracker's noise", "tracker noise, standard deviation per axis (mm)", "noise {:g} mm"),
    "payload_kg": ("the payload", "payload (kg)", "payload {:g} kg"),
}
"""What a study may vary along an axis: in words, as the axis's label, and a value of it."""
ERROR_LABEL = "arm's mean position error (mm)"
NOTE = 7.5
"""Size of the line below a figure that says how to read it, points."""
NOTE_LETTER, LEGEND = 0.062, 1.8
"""Inches: a letter of that line, and what a legend beside the panels takes."""
NEAREST, ALIKE = 0.015, 0.015
"""Curves that are nowhere farther apart, as a share of what is shown, or of their values on a logarithmic axis, are
drawn once: about what a line is wide."""
LONGEST = 16
"""Parameters in a tornado; the rest are as good as zero."""


def study_drawings(findings: Findings) -> Drawings:
    """The figures of a study."""
    rows, specification = findings.yields, specified(findings.protocol.config)
    has_results = any(row["failed"] < row["arms"] for row in rows)
    drawings: list[Drawing | NotDrawn] = []

    def add(name: str, caption: str, figure: Callable[..., Figure], *arguments: Any) -> None:
        drawings.append(Drawing(name, caption, partial(figure, *arguments)))

    for along, (words, *_) in AXES.items():
        if along not in varied(rows):
            drawings.append(NotDrawn(f"yield_by_{along}", f"the study does not vary {words}"))
            continue
        caption = f"Share of arms that pick {specification}, against {words}, with Wilson 95 % bands."
        add(f"yield_by_{along}", caption, yield_curves, rows, along, specification)
        if has_results:
            caption = f"Mean position error of the median arm against {words}; bands hold the middle 90 % of arms."
            add(f"error_by_{along}", caption, error_curves, findings.quantiles, along)
    if has_results:
        caption, radius_mm = "How the arms' mean position errors are distributed.", findings.protocol.config.radius_mm
        add("error_distribution", caption, distributions, findings.dense, radius_mm)
    for setting, shares in findings.sensitivities.items():
        name, label = f"sensitivity_{_word(rows[setting])}", findings.label(setting)
        if isinstance(shares, str):
            drawings.append(NotDrawn(name, shares))
        else:
            caption = f"What each tolerance explains of the variance between arms, each at its own fruit: {label}."
            add(name, caption, tornado, shares, label)
    for setting, placement in findings.placements.items():
        name = f"placement_{_word(rows[setting])}"
        if isinstance(placement, str):
            drawings.append(NotDrawn(name, placement))
        else:
            caption = f"Where {placement.arm} stands in its population: {findings.label(setting)}."
            add(name, caption, arm_among_population, findings.dense, setting, placement)
    return drawings


def _word(row: Row) -> str:
    """A setting's method as part of a file name."""
    return str(row["method"]).replace("+", "_")


def varied(rows: Sequence[Row]) -> list[str]:
    """Which of `AXES` take several values among calibrated settings (payload and grade among all)."""
    calibrated = [row for row in rows if row["method"] != RAW]
    return [
        name for name in AXES if len({row[name] for row in (calibrated if name in ("poses", "noise_mm") else rows)}) > 1
    ]


def yield_curves(yields: Sequence[Row], along: str, specification: str) -> Figure:
    """Share of arms within specification against one of `AXES`, with Wilson's 95 % bands.

    Args:
        yields: Rows of `yields_of`.
        along: The axis; what else varies is shown by colour and line, or held at its middle value, which is named.
        specification: When an arm is good enough, in words.

    Raises:
        InputError: If the study did not vary ``along``.
    """
    keys = ("yield", "yield_low", "yield_high")
    figure = _curves(yields, along, keys, "arms within specification (%)", 100.0, max)
    _note(figure, f"yield of {_arms(yields)} with 95 % bands; within specification: {specification}")
    for axes in figure.axes:
        axes.set_ylim(-3.0, 103.0)
    return figure


def error_curves(quantiles: Sequence[Row], along: str) -> Figure:
    """Median of the arms' errors against one of `AXES`; the band holds 90 % of the arms.

    Args:
        quantiles: Rows of `quantiles_of`, with probabilities 0.05, 0.5 and 0.95.
        along: The axis.

    Raises:
        InputError: If the study did not vary ``along``.
    """
    merged: dict[int, dict[str, Any]] = {}
    for row in _judged(quantiles):
        merged.setdefault(row["setting"], dict(row))[f"q{row['probability']:g}"] = row["value"]
    rows = list(merged.values())
    figure = _curves(rows, along, ("q0.5", "q0.05", "q0.95"), ERROR_LABEL, 1.0, min)
    _note(figure, f"lines: median arm; bands: the middle 90 % of {_arms(rows)}")
    for axes in figure.axes:
        axes.set_ylim(bottom=0.0)
    return figure


def distributions(quantiles: Sequence[Row], radius_mm: float | None = None) -> Figure:
    """Cumulative distribution of the arms' errors, one curve per grade and method.

    Args:
        quantiles: With many probabilities, such as 0.01 to 0.99.
        radius_mm: The specified radius, drawn as a line when given.
    """
    rows = held(_judged(quantiles), ("it_grade", "method"))
    if not rows:
        raise InputError("no arm has a result; there is no distribution to draw")
    settings = {row["setting"]: row for row in rows}
    with new_figure(WIDTH, 3.7) as figure:
        axes = figure.add_subplot(xlabel=ERROR_LABEL, ylabel="arms at or below it (%)")
        look, curves, row_of = _looks(rows, "it_grade"), dict[str, Array](), dict[str, Row]()
        for setting, row in sorted(settings.items(), key=lambda item: item[1]["method"] != RAW):
            label = f"{method_label(row['method'])}, {_valued('it_grade', row)}"
            points = [(r["value"], 100.0 * r["probability"]) for r in rows if r["setting"] == setting]
            curves[label], row_of[label] = np.array(sorted(points, key=lambda point: point[1])).T, row
        for group in alike({name: np.log(curve[0]) for name, curve in curves.items()}, ALIKE):
            axes.plot(*curves[group[0]], label=_together(group), **look(row_of[group[0]]) | {"marker": ""})
        medians = {name: float(np.median(curve[0])) for name, curve in curves.items()}
        least = min(medians, key=lambda name: medians[name])
        headline(axes, f"Least: {least}, half of the arms below {short(medians[least])} mm", beside=LEGEND)
        if radius_mm is not None:
            label = f"radius {radius_mm:g} mm, which\nsingle fruit must meet"
            axes.axvline(radius_mm, color=rgb([RED])[0], linewidth=1.0, label=label)
        axes.set(xscale="log", ylim=(0.0, 100.0), xlim=(0.8 * min(row["value"] for row in rows), None))
        plain_decades(axes.xaxis)
        figure.legend(loc="outside right upper", title=_held_words(rows, ("it_grade", "method")))
    return figure


def tornado(sensitivities: Sequence[Row], setting: str) -> Figure:
    """Which tolerance matters: share of the variance between arms, per parameter and per kind, with intervals.

    Args:
        sensitivities: Rows of `sensitivities_of`.
        setting: The setting in words.
    """
    single = [row for row in sensitivities if row["level"] == "parameter"][:LONGEST]
    kinds = [row for row in sensitivities if row["level"] == "kind"]
    order = [row["kind"] for row in kinds]
    palette = rgb([*policy_colours(["ls", "raw"]), GREEN, *OTHERS])
    with new_figure(WIDTH, 1.3 + 0.2 * max(len(single), 6)) as figure:
        by_parameter, by_kind = figure.subplots(1, 2, width_ratios=(3, 2))
        for axes, bars, title in ((by_parameter, single, "by parameter"), (by_kind, kinds, "by kind")):
            for place, row in enumerate(bars):
                share, low, high = (100.0 * row[key] for key in ("share", "share_low", "share_high"))
                axes.barh(place, share, color=palette[order.index(row["kind"]) % len(palette)], height=0.7)
                axes.plot([low, high], [place, place], color=SOFT, linewidth=1.2)
            axes.set_yticks(range(len(bars)), [_parameter_label(row["parameter"]) for row in bars], fontsize=8)
            least = min(0.0, *(100.0 * row["share_low"] for row in bars))
            axes.set(ylim=(max(len(bars), len(single)) - 0.4, -0.6), xlim=(least, None), xlabel="share of variance (%)")
            axes.set_title(title)
            axes.grid(axis="y", visible=False)
        most = f"{_parameter_label(single[0]['parameter'])} makes {100.0 * single[0]['share']:.0f} % of the variance"
        figure.suptitle(f"{setting}: {most}", x=0.01, ha="left", fontsize=9, fontweight="bold")
        first = sensitivities[0]
        _note(figure, f"squared error regressed on {first['arms']} arms, R² = {first['r2']:.2f}; lines: 95 % intervals")
    return figure


def arm_among_population(quantiles: Sequence[Row], setting: int, placement: Placement) -> Figure:
    """Where one arm stands in the population of a setting.

    Args:
        quantiles: With many probabilities.
        setting: Number of the setting.
        placement: The arm's error, and its share of the population below it in equal circumstances.
    """
    rows = sorted((r for r in _judged(quantiles) if r["setting"] == setting), key=lambda row: row["probability"])
    if not rows:
        raise InputError(f"the quantiles have no arm of setting {setting}; give another setting")
    value, low, high = (np.array([row[key] for row in rows], dtype=float) for key in ("value", "low", "high"))
    level = 100.0 * np.array([row["probability"] for row in rows])
    blue, red = rgb([*policy_colours(["ls"]), RED])
    share, least, most = (100.0 * p for p in (placement.percentile, *placement.interval))
    errs = f"{placement.error_mm:.2f} mm, better than {100.0 - share:.0f} %"
    with new_figure(WIDTH * 0.7, 3.4) as figure:
        axes = figure.add_subplot(xlabel=ERROR_LABEL, ylabel="arms at or below it (%)")
        axes.fill_betweenx(
            level, low, high, color=blue, alpha=0.25, linewidth=0.0, label="95 % band, as far as so many arms bound it"
        )
        axes.plot(value, level, color=blue, label=f"population of {rows[0]['arms']} arms")
        label = f"{placement.arm}: {errs} ({100 - most:.0f} to {100 - least:.0f})"
        axes.plot([placement.error_mm], [share], "D", color=red, markersize=6, label=label, clip_on=False)
        headline(axes, f"{setting_label(rows[0])}: {placement.arm} errs {errs} of arms")
        axes.set(ylim=(0.0, 100.0), xlim=(0.0, None))
        figure.legend(loc="outside lower center", fontsize=8)
    return figure


def _judged(quantiles: Sequence[Row]) -> list[Row]:
    """The rows of the mean position error, of settings that have any arm with a result."""
    return [row for row in quantiles if row["quantity"] == ERROR and row["arms"]]


def _arms(rows: Sequence[Row]) -> str:
    """How many arms figures rest on; few are called a trial run."""
    arms = max((int(row["arms"]) for row in rows), default=0)
    return f"{arms} arms" + f" (a trial run: fewer than {FEW})" * (arms < FEW)


def _curves(
    rows: Sequence[Row], along: str, keys: tuple[str, str, str], ylabel: str, factor: float, better: Callable[..., Any]
) -> Figure:
    """Curves with bands: a panel per tolerance class; colour and line style for what varies beside the axis.

    Curves that cannot be told apart are drawn once and named together; the title says what the axis does to the best
    one, which ``better`` picks (max or min) by its mean.
    """
    if along not in AXES or along not in varied(rows):
        raise InputError(f"the study does not vary '{along}'; draw one of {varied(rows) or 'none'}")
    beside = ("method", "poses") if along == "it_grade" else ("method", "it_grade")
    free = ("tolerances", along, *beside)
    classes = list(dict.fromkeys(row["tolerances"] for row in rows))
    lines = [r for r in held(rows, free) if along not in ("poses", "noise_mm") or r["method"] != RAW]
    look = _looks(lines, beside[1])
    middles: dict[tuple[str, str], Array] = {}
    with new_figure(WIDTH, 3.7) as figure:
        panels: Any = figure.subplots(1, len(classes), squeeze=False, sharey=True)[0]
        for axes, name in zip(panels, classes, strict=True):
            curves = dict(_series([r for r in lines if r["tolerances"] == name], along, beside))
            values = {
                label: factor * np.array([[row[key] for row in curve] for key in keys], dtype=float)
                for label, curve in curves.items()
            }
            span = np.ptp(np.concatenate([np.zeros(1), *(v.ravel() for v in values.values())]))
            for group in alike({label: v[0] for label, v in values.items()}, NEAREST * span):
                curve, label = curves[group[0]], _together(group)
                x = [row[along] for row in curve]
                middle, low, high = values[group[0]]
                low, high = (end([values[k][i] for k in group], axis=0) for i, end in ((1, np.min), (2, np.max)))
                middles[name, label] = middle
                style = look(curve[0])
                axes.fill_between(x, low, high, color=style["color"], alpha=0.18, linewidth=0.0)
                axes.plot(x, middle, label=label, markersize=4.0, **style)
            if along in ("it_grade", "poses"):
                axes.set_xticks(sorted({row[along] for row in lines}))
            else:
                axes.set_xlim(left=0.0)
            axes.set_xlabel(AXES[along][1])
            axes.set_title(f"Tolerance class {name}" if len(classes) > 1 else "")
        panels[0].set_ylabel(ylabel)
        (name, label), best = better(middles.items(), key=lambda item: float(np.nanmean(item[1])))
        unit, ends = "%" if factor > 1.0 else "mm", [_valued(along, {along: end}) for end in (min(x), max(x))]
        title = f"{label}: {short(best[0])} {unit} with {ends[0]}, {short(best[-1])} {unit} with {ends[1]}"
        if len(classes) > 1:
            figure.suptitle(f"{name}: {title}", x=0.01, ha="left", fontsize=9, fontweight="bold")
        else:
            headline(panels[0], title, beside=LEGEND)
        handles: dict[str, Any] = {}
        for axes in panels:
            for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
                handles.setdefault(label, handle)
        legend = _held_words(lines, free)
        figure.legend(handles.values(), handles, loc="outside right upper", fontsize=8, title=legend)
    return figure


def _together(labels: Sequence[str]) -> str:
    """One label for curves that are alike: LS, IT6 to IT16 (alike)."""
    if len(labels) == 1:
        return labels[0]
    last = (
        labels[-1].rpartition(", ")[2] if labels[0].partition(", ")[0] == labels[-1].partition(", ")[0] else labels[-1]
    )
    return f"{labels[0]} to {last} (alike)"


def _held_words(rows: Sequence[Row], shown: Sequence[str]) -> str | None:
    """What was held, for the legend's title."""
    calibrated = [row for row in rows if row["method"] != RAW]
    words = [_valued(name, calibrated[0]) for name in AXES if name not in shown] if calibrated else []
    return "\n".join(words) or None


def _series(rows: Sequence[Row], along: str, beside: tuple[str, str]) -> Iterator[tuple[str, list[Row]]]:
    """Rows of one curve each, with its label, ordered along the axis."""
    keys = sorted({(row[beside[0]], row[beside[1]]) for row in rows}, key=lambda key: (key[0] != RAW, *key))
    for key in keys:
        curve = sorted((r for r in rows if (r[beside[0]], r[beside[1]]) == key), key=lambda row: row[along])
        detail = "" if beside[1] == "poses" and key[0] == RAW else f", {_valued(beside[1], curve[0])}"
        yield method_label(key[0]) + detail, curve


def _valued(name: str, row: Row) -> str:
    """What a row has on one of `AXES`, in words."""
    return AXES[name][2].format(row[name])


def _looks(rows: Sequence[Row], beside: str) -> Callable[[Row], dict[str, Any]]:
    """How a curve is drawn: in its method's colour; pattern and mark tell values of ``beside`` apart."""
    methods = list(dict.fromkeys(row["method"] for row in rows))
    colours = dict(zip(methods, rgb(policy_colours(methods)), strict=True))
    values = sorted({row[beside] for row in rows if beside != "poses" or row["method"] != RAW})

    def look(row: Row) -> dict[str, Any]:
        place = values.index(row[beside]) if row[beside] in values else 0
        pattern, mark = LINES[place % len(LINES)], MARKS[place % len(MARKS)]
        return {"color": colours[row["method"]], "linestyle": pattern, "marker": mark}

    return look


def _note(figure: Figure, text: str) -> None:
    """A line below a figure that says how to read it."""
    lines = wrap(text, int(figure.get_figwidth() / NOTE_LETTER))
    figure.supxlabel("\n".join(lines), fontsize=NOTE, color=INK)


def _parameter_label(name: str) -> str:
    """delta_a2_mm as a2; size_joint_stiffness_1 as joint stiffness 1."""
    for end in ("_mm", "_deg"):
        name = name.removesuffix(end)
    return name.removeprefix("delta_").removeprefix("size_").removesuffix("_K").replace("_", " ")
