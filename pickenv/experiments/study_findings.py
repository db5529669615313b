"""The findings of a finished study: its worst, median and best arms, the verdict in words, and figures.

Each figure is drawn from rows of yields, quantiles or sensitivities; mm, degrees, percent. `study_drawings` lists the
figures that a study allows, with captions, and gives the reason for each other figure.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from textwrap import wrap
from typing import Any

import numpy as np
import pyarrow.compute as pc
from matplotlib.figure import Figure
from pyarrow.dataset import Dataset

from pickenv.arm import Array
from pickenv.base import InputError, count_of, share_interval
from pickenv.experiments import study
from pickenv.experiments.study_rows import Row, held, quantiles_of, read_rows, study_of, yields_of
from pickenv.experiments.study_variance import sensitivities_of
from pickenv.inspect.colours import GREEN, OTHERS, RED, in_words, percent, policy_colours, policy_label
from pickenv.inspect.figures import style
from pickenv.inspect.figures.run_drawings import Drawing, Drawings
from pickenv.inspect.figures.style import alike, headline
from pickenv.inspect.reports.report_page import PageVerdict

DENSE = tuple(float(p) for p in np.linspace(0.01, 0.99, 99))
"""Probabilities of the quantiles from which distributions are drawn."""


@dataclass(frozen=True, eq=False)
class Findings:
    """The findings of a study, computed once for figures and report.

    Attributes:
        protocol: The study, ready to run.
        rows: All rows of the study's folder, verified.
        yields: Rows of `yields_of`.
        quantiles: Rows of `quantiles_of`.
        dense: Quantiles of the mean position error at the probabilities `DENSE`.
        sensitivities: For each analysed setting, by its number (from 0), the rows of `sensitivities_of`, or the reason
            why there are none. One setting of each method is analysed. In it, all varied columns except the method have
            their middle values.
    """

    protocol: study.Protocol
    rows: Dataset
    yields: list[dict[str, Any]]
    quantiles: list[dict[str, Any]]
    dense: list[dict[str, Any]]
    sensitivities: dict[int, list[dict[str, Any]] | str]

    def label(self, setting: int) -> str:
        """Return a description of the setting with the number ``setting``, from 0, in a few words, with units."""
        return setting_label(self.yields[setting])


def gather(folder: str | Path) -> Findings:
    """Analyse the rows of a study's folder, and return the findings.

    Raises:
        InputError: If the folder holds no study or no rows.
    """
    protocol, rows = study.prepared_study(study_of(folder)), read_rows(folder)
    yields = yields_of(rows, protocol.config.share).to_pylist()
    quantiles, dense = quantiles_of(rows).to_pylist(), quantiles_of(rows, [study.ERROR], DENSE).to_pylist()
    sensitivities = {row["setting"]: _sensitivities(rows, row["setting"]) for row in held(yields, ("method",))}
    return Findings(protocol, rows, yields, quantiles, dense, sensitivities)


def _sensitivities(rows: Dataset, setting: int) -> list[dict[str, Any]] | str:
    try:
        return list(sensitivities_of(rows, setting).to_pylist())
    except InputError as error:
        return str(error)


# Single arms.


def ranked(rows: Dataset, setting: int) -> dict[str, tuple[int, float]]:
    """Return the arms of a setting (by its number, from 0) with the largest, median and smallest mean position error.

    Returns:
        For each of "worst", "median" and "best", the number of the arm, from 0, and its mean position error, mm.

    Raises:
        InputError: If no arm of the setting has a result.
    """
    selection = (pc.field("setting") == setting) & (pc.field("status") == study.OK)
    table = rows.to_table(columns=["arm", study.ERROR], filter=selection, use_threads=False)
    numbers, errors = table["arm"].to_numpy(), table[study.ERROR].to_numpy()
    if not len(numbers):
        raise InputError(f"no arm of setting {setting} has a result; give another setting")
    order = np.lexsort((numbers, -errors))
    places = {"worst": order[0], "median": order[len(order) // 2], "best": order[-1]}
    return {name: (int(numbers[i]), float(errors[i])) for name, i in places.items()}


# The verdict: which way of making and calibrating arms is enough, at which payload, and how surely.

REQUIRED_YIELD = 0.95
"""Smallest yield at which a way of making and calibrating arms counts as sufficient."""
CHOICES = ("tolerances", "it_grade", "method", "poses", "noise_mm", "noise_deg")
"""Columns that a manufacturer of arms can choose; the payload is not among them."""
FEW = 200
"""Number of arms below which the verdict says how uncertain the yields are."""


def study_verdict(config: study.StudyConfig, rows: Sequence[Row]) -> PageVerdict:
    """Return the verdict: which way to make and calibrate arms reaches `REQUIRED_YIELD` with the least effort.

    A way is a tolerance class and grade, with a method, number of poses and tracker. Its yield is the lowest yield over
    all payloads. If no way reaches the required yield, the verdict names the way with the highest yield.

    Args:
        config: The study.
        rows: The yields of its settings, from `yields_of`.
    """
    ways: dict[tuple[Any, ...], Row] = {}
    for row in rows:
        key = tuple(row[name] for name in CHOICES)
        if key not in ways or row["yield"] < ways[key]["yield"]:
            ways[key] = row  # the payload at which this way yields least
    enough = [row for row in ways.values() if row["yield_low"] >= REQUIRED_YIELD]
    perhaps = [row for row in ways.values() if row["yield_high"] >= REQUIRED_YIELD]
    loads = sorted({row["payload_kg"] for row in rows})
    goal = f"a yield of {100 * REQUIRED_YIELD:g} %"
    if enough:
        tone, best = "good", max(enough, key=_ease)
        headline = f"{_way(best)} is enough for {goal}" + (" at every payload" if len(loads) > 1 else "")
    elif perhaps:
        tone, best = "care", max(perhaps, key=lambda row: row["yield"])
        headline = f"{_way(best)} may be enough for {goal}{_at(best, loads)}: too few arms to tell"
    else:
        tone, best = "bad", max(ways.values(), key=lambda row: row["yield"])
        headline = f"Nothing that was tried gives {goal}{_at(best, loads)}"
    text = [f"With {_way(best)}, {_share(best)} of arms pick {specified(config)}{_at(best, loads)}."]
    if not enough:
        text += [_best_at(rows, load) for load in loads if load != best["payload_kg"]]
    else:
        others = [r for r in rows if all(r[k] == best[k] for k in CHOICES) and r["setting"] != best["setting"]]
        text += [f"{_capital(_at(row, loads))} it is {_share(row)}." for row in others]
    alike = [row for row in rows if all(row[k] == best[k] for k in ("tolerances", "it_grade", "payload_kg"))]
    uncalibrated = [row for row in alike if row["method"] == study.RAW]
    if best["method"] != study.RAW and uncalibrated:
        text.append(f"Of the same arms without calibration it is {_share(uncalibrated[0])}.")
    if config.arms < FEW:
        low, high = share_interval(config.arms / 2, config.arms)
        text.append(
            f"{count_of(config.arms, 'arm')} can tell a yield to within about ± {50 * (high - low):.0f} points only: "
            "this is a trial run, and another seed gives other figures within that."
        )
    return PageVerdict(tone, _capital(headline), " ".join(text))


def specified(config: study.StudyConfig) -> str:
    """Return the specification in words, such as: at least 90 % of the fruit within 5 mm."""
    return f"at least {100 * config.share:g} % of the fruit within {config.radius_mm:g} mm"


def setting_label(row: Row) -> str:
    """Return a description of a setting in a few words, with units, from ``row``, one of the setting's rows."""
    calibration = policy_label(row["method"])
    if row["method"] != study.RAW:
        calibration += f", {row['poses']} poses, noise {row['noise_mm']:g} mm"
    load = f", payload {row['payload_kg']:g} kg" if row["payload_kg"] else ""
    return f"{row['tolerances']}, IT{row['it_grade']}, {calibration}{load}"


def _ease(row: Row) -> tuple[Any, ...]:
    """Return a sort key that is larger for less effort: coarse grade first, then few poses, then a noisy tracker.

    The ``row`` is one of `yields_of`. With all else equal, no calibration is less effort than calibration.
    """
    return row["it_grade"], -row["poses"], row["noise_mm"], row["method"] == study.RAW


def _way(row: Row) -> str:
    how = "no calibration"
    if row["method"] != study.RAW:
        how = f"{row['poses']} poses by a tracker of {row['noise_mm']:g} mm noise, {policy_label(row['method'])}"
    return f"IT{row['it_grade']} ({row['tolerances']}) and {how}"


def _at(row: Row, loads: Sequence[float]) -> str:
    """Return words for a row's payload, such as ", carrying 2 kg"; empty if no arm of the study carries a payload.

    The ``loads`` are the payloads of the study, kg.
    """
    if row["payload_kg"]:
        return f", carrying {row['payload_kg']:g} kg"
    return ", without payload" if len(loads) > 1 else ""


def _best_at(rows: Sequence[Row], load: float) -> str:
    """Return a sentence on the best way to make and calibrate arms for the payload ``load``, kg.

    The ``rows`` come from `yields_of`.
    """
    best = max((row for row in rows if row["payload_kg"] == load), key=lambda row: row["yield"])
    return f"{_capital(_at(best, (load, load)))} the best is {_way(best)}: {_share(best)}."


def _capital(text: str) -> str:
    text = text.removeprefix(", ")
    return text[:1].upper() + text[1:]


def _share(row: Row) -> str:
    """Return the yield in a row of `yields_of`, with its 95 % interval, as text, percent."""
    return percent(row["yield"], row["yield_low"], row["yield_high"], 1)


# Figures: yields and errors against what was varied, distributions, sensitivities, one arm among many.


AXES: Mapping[str, tuple[str, str, str]] = {
    "it_grade": ("the grade of the machined lengths", "IT grade of the lengths (ISO 286-1)", "IT{}"),
    "poses": ("the number of calibration poses", "calibration poses (number)", "{} poses"),
    "noise_mm": ("the tracker's noise", "tracker noise, standard deviation per axis (mm)", "noise {:g} mm"),
    "payload_kg": ("the payload", "payload (kg)", "payload {:g} kg"),
}
"""Columns for the x axis of a figure; for each its name in words, the axis label and the format of a value."""
ERROR_LABEL = "arm's mean position error (mm)"
NOTE = 7.5
"""Font size of the line below a figure that says how to read it, points."""
NOTE_LETTER, LEGEND = 0.062, 1.8
"""Width of a letter of the note below a figure, and width of a legend beside the panels, inches."""
NEAREST, ALIKE = 0.015, 0.015
"""Largest distance between curves that are drawn as one, about a line's width. The first is a share of the range shown.
The second is for a logarithmic axis, and is a share of the values."""
LONGEST = 16
"""Largest number of parameters in a tornado figure; the others explain almost nothing."""


def study_drawings(findings: Findings) -> Drawings:
    """Return the figures of a study with captions; a figure that its rows do not allow has the reason instead."""
    rows, specification = findings.yields, specified(findings.protocol.config)
    has_results = any(row["failed"] < row["arms"] for row in rows)
    drawings: list[Drawing] = []
    for along, (words, *_) in AXES.items():
        if along not in varied(rows):
            drawings.append(Drawing(f"yield_by_{along}", f"the study does not vary {words}"))
            continue
        caption = f"Share of arms that pick {specification}, against {words}, with Wilson 95 % bands."
        drawings.append(Drawing(f"yield_by_{along}", caption, partial(yield_curves, rows, along, specification)))
        if has_results:
            caption = f"Mean position error of the median arm against {words}; bands hold the middle 90 % of arms."
            drawings.append(Drawing(f"error_by_{along}", caption, partial(error_curves, findings.quantiles, along)))
    if has_results:
        caption, radius_mm = "How the arms' mean position errors are distributed.", findings.protocol.config.radius_mm
        drawings.append(Drawing("error_distribution", caption, partial(distributions, findings.dense, radius_mm)))
    for setting, shares in findings.sensitivities.items():
        name, label = f"sensitivity_{rows[setting]['method'].replace('+', '_')}", findings.label(setting)
        if isinstance(shares, str):
            drawings.append(Drawing(name, shares))
        else:
            caption = "What each tolerance explains of the variance between arms, each at its own fruit: "
            drawings.append(Drawing(name, f"{caption}{in_words(label)}.", partial(tornado, shares, label)))
    return drawings


def varied(rows: Sequence[Row]) -> list[str]:
    """Return the names of the columns in `AXES` that have several values in ``rows``.

    For poses and noise only the rows of calibrated settings count, since raw arms have neither.
    """
    calibrated = [row for row in rows if row["method"] != study.RAW]
    return [
        name for name in AXES if len({row[name] for row in (calibrated if name in ("poses", "noise_mm") else rows)}) > 1
    ]


def yield_curves(yields: Sequence[Row], along: str, specification: str) -> Figure:
    """Draw the share of arms within specification against one of `AXES`, with Wilson's 95 % bands.

    Args:
        yields: Rows of `yields_of`.
        along: Column on the x axis, a key of `AXES` that the study varied. Colour and line style show the method, and
            poses or grade. All further varied columns are held at their middle values, which the legend names.
        specification: The text of `specified`: when an arm is within specification.
    """
    keys = ("yield", "yield_low", "yield_high")
    note = f"yield of {_arms(yields)} with 95 % bands; within specification: {specification}"
    return _curves(yields, along, keys, "arms within specification (%)", note)


def error_curves(quantiles: Sequence[Row], along: str) -> Figure:
    """Draw the median of the arms' errors against one of `AXES`; the band contains the middle 90 % of the arms.

    Args:
        quantiles: Rows of `quantiles_of`, with probabilities 0.05, 0.5 and 0.95.
        along: Column on the x axis, a key of `AXES` that the study varied.
    """
    merged: dict[int, dict[str, Any]] = {}
    for row in _judged(quantiles):
        merged.setdefault(row["setting"], dict(row))[f"q{row['probability']:g}"] = row["value"]
    rows = list(merged.values())
    keys, note = ("q0.5", "q0.05", "q0.95"), f"lines: median arm; bands: the middle 90 % of {_arms(rows)}"
    return _curves(rows, along, keys, ERROR_LABEL, note)


def distributions(quantiles: Sequence[Row], radius_mm: float) -> Figure:
    """Draw the cumulative distribution of the arms' errors, one curve per grade and method.

    Args:
        quantiles: Rows of `quantiles_of` with many probabilities, such as 0.01 to 0.99.
        radius_mm: The specified radius, mm, drawn as a line.
    """
    rows = held(_judged(quantiles), ("it_grade", "method"))
    settings = {row["setting"]: row for row in rows}
    with style.new_figure(style.WIDTH, 3.7) as figure:
        axes = figure.add_subplot(xlabel=ERROR_LABEL, ylabel="arms at or below it (%)")
        look, curves, row_of = _looks(rows, "it_grade"), dict[str, Array](), dict[str, Row]()
        for setting, row in sorted(settings.items(), key=lambda item: item[1]["method"] != study.RAW):
            label = f"{policy_label(row['method'])}, {_valued('it_grade', row)}"
            points = [(r["value"], 100.0 * r["probability"]) for r in rows if r["setting"] == setting]
            curves[label], row_of[label] = np.array(sorted(points, key=lambda point: point[1])).T, row
        for group in alike({name: np.log(curve[0]) for name, curve in curves.items()}, ALIKE):
            axes.plot(*curves[group[0]], label=_together(group), **look(row_of[group[0]]) | {"marker": ""})
        medians = {name: float(np.median(curve[0])) for name, curve in curves.items()}
        least = min(medians, key=lambda name: medians[name])
        headline(axes, f"Least: {least}, half of the arms below {style.short(medians[least])} mm", beside=LEGEND)
        label = f"radius {radius_mm:g} mm, which\nsingle fruit must meet"
        axes.axvline(radius_mm, color=style.rgb([RED])[0], linewidth=1.0, label=label)
        axes.set(xscale="log", ylim=(0.0, 100.0), xlim=(0.8 * min(row["value"] for row in rows), None))
        style.plain_decades(axes.xaxis)
        figure.legend(loc="outside right upper", title=_held_words(rows, ("it_grade", "method")))
    return figure


def tornado(sensitivities: Sequence[Row], setting: str) -> Figure:
    """Draw the share of the variance between arms that each parameter, and each kind of parameter, explains.

    Shares have 95 % intervals.

    Args:
        sensitivities: Rows of `sensitivities_of`.
        setting: Description of the setting, from `setting_label`.
    """
    single = [row for row in sensitivities if row["level"] == "parameter"][:LONGEST]
    kinds = [row for row in sensitivities if row["level"] == "kind"]
    order = [row["kind"] for row in kinds]
    palette = style.rgb([*policy_colours(["ls", "raw"]), GREEN, *OTHERS])
    with style.new_figure(style.WIDTH, 1.3 + 0.2 * max(len(single), 6)) as figure:
        by_parameter, by_kind = figure.subplots(1, 2, width_ratios=(3, 2))
        for axes, bars, title in ((by_parameter, single, "by parameter"), (by_kind, kinds, "by kind")):
            for place, row in enumerate(bars):
                share, low, high = (100.0 * row[key] for key in ("share", "share_low", "share_high"))
                axes.barh(place, share, color=palette[order.index(row["kind"]) % len(palette)], height=0.7)
                axes.plot([low, high], [place, place], color=style.SOFT, linewidth=1.2)
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


def _judged(quantiles: Sequence[Row]) -> list[Row]:
    """Return the rows of the mean position error, of settings in which at least one arm has a result."""
    return [row for row in quantiles if row["quantity"] == study.ERROR and row["arms"]]


def _arms(rows: Sequence[Row]) -> str:
    """Return words for the largest number of arms in any of ``rows``; fewer than `FEW` are called a trial run."""
    arms = max((int(row["arms"]) for row in rows), default=0)
    return count_of(arms, "arm") + f" (a trial run: fewer than {FEW})" * (arms < FEW)


def _curves(rows: Sequence[Row], along: str, keys: tuple[str, str, str], ylabel: str, note: str) -> Figure:
    """Draw curves with bands against the column ``along``, in a panel per tolerance class.

    Colour and line style show what varies besides ``along``. Curves that cannot be told apart are drawn once, with one
    label. The title gives the values of the best curve at both ends of the axis. The best curve has the largest mean
    yield, or the smallest mean error.

    Args:
        rows: Rows of `yields_of` or `quantiles_of`.
        along: Column on the x axis, a key of `AXES`.
        keys: Columns of the curve, of the lower end of its band and of the upper end.
        ylabel: Label of the y axis.
        note: Line below the figure.
    """
    of_yields = "yield" in keys
    factor = 100.0 if of_yields else 1.0
    beside = ("method", "poses") if along == "it_grade" else ("method", "it_grade")
    free = ("tolerances", along, *beside)
    classes = list(dict.fromkeys(row["tolerances"] for row in rows))
    lines = [r for r in held(rows, free) if along not in ("poses", "noise_mm") or r["method"] != study.RAW]
    look = _looks(lines, beside[1])
    middles: dict[tuple[str, str], Array] = {}
    with style.new_figure(style.WIDTH, 3.7) as figure:
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
                pen = look(curve[0])
                axes.fill_between(x, low, high, color=pen["color"], alpha=0.18, linewidth=0.0)
                axes.plot(x, middle, label=label, markersize=4.0, **pen)
            if along in ("it_grade", "poses"):
                axes.set_xticks(sorted({row[along] for row in lines}))
            else:
                axes.set_xlim(left=0.0)
            axes.set_xlabel(AXES[along][1])
            axes.set_title(f"Tolerance class {name}" if len(classes) > 1 else "")
        panels[0].set(ylabel=ylabel, ylim=(-3.0, 103.0) if of_yields else (0.0, None))
        better: Callable[..., Any] = max if of_yields else min
        (name, label), best = better(middles.items(), key=lambda item: float(np.nanmean(item[1])))
        unit, ends = "%" if of_yields else "mm", [_valued(along, {along: end}) for end in (min(x), max(x))]
        title = f"{label}: {style.short(best[0])} {unit} with {ends[0]}, {style.short(best[-1])} {unit} with {ends[1]}"
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
        _note(figure, note)
    return figure


def _together(labels: Sequence[str]) -> str:
    """Return one label for curves that look alike, given their labels, such as "LS, IT6 to IT16 (alike)"."""
    first, last = labels[0], labels[-1]
    if first == last:
        return first
    same_method = first.partition(", ")[0] == last.partition(", ")[0]
    return f"{first} to {last.rpartition(', ')[2] if same_method else last} (alike)"


def _held_words(rows: Sequence[Row], shown: Sequence[str]) -> str | None:
    """Return the legend's title: the values of the columns of `AXES` that are not in ``shown``.

    The ``rows`` of calibrated arms have a single value in each of these columns. The result is None if all columns are
    shown, or all arms are raw.
    """
    calibrated = [row for row in rows if row["method"] != study.RAW]
    words = [_valued(name, calibrated[0]) for name in AXES if name not in shown] if calibrated else []
    return "\n".join(words) or None


def _series(rows: Sequence[Row], along: str, beside: tuple[str, str]) -> Iterator[tuple[str, list[Row]]]:
    """Yield the label and the rows of each curve, with the rows sorted by the column ``along``.

    All rows of a curve have the same values in the two columns ``beside``. The first of these columns is the method.
    """
    keys = sorted({(row[beside[0]], row[beside[1]]) for row in rows}, key=lambda key: (key[0] != study.RAW, *key))
    for key in keys:
        curve = sorted((r for r in rows if (r[beside[0]], r[beside[1]]) == key), key=lambda row: row[along])
        detail = "" if beside[1] == "poses" and key[0] == study.RAW else f", {_valued(beside[1], curve[0])}"
        yield policy_label(key[0]) + detail, curve


def _valued(name: str, row: Row) -> str:
    """Return a row's value in the column ``name`` of `AXES`, in words."""
    return AXES[name][2].format(row[name])


def _looks(rows: Sequence[Row], beside: str) -> Callable[[Row], dict[str, Any]]:
    """Return a function from row to line style: colour by method, line pattern and mark by the column ``beside``."""
    methods = list(dict.fromkeys(row["method"] for row in rows))
    colours = dict(zip(methods, style.rgb(policy_colours(methods)), strict=True))
    values = sorted({row[beside] for row in rows if beside != "poses" or row["method"] != study.RAW})

    def look(row: Row) -> dict[str, Any]:
        place = values.index(row[beside]) if row[beside] in values else 0
        pattern, mark = style.LINES[place % len(style.LINES)], style.MARKS[place % len(style.MARKS)]
        return {"color": colours[row["method"]], "linestyle": pattern, "marker": mark}

    return look


def _note(figure: Figure, text: str) -> None:
    """Write a note below a figure: a line that says how to read the figure."""
    lines = wrap(text, int(figure.get_figwidth() / NOTE_LETTER))
    figure.supxlabel("\n".join(lines), fontsize=NOTE, color=style.INK)


def _parameter_label(name: str) -> str:
    """Return a parameter's name for readers: a2 for delta_a2_mm, joint stiffness 1 for size_joint_stiffness_1."""
    for end in ("_mm", "_deg"):
        name = name.removesuffix(end)
    return name.removeprefix("delta_").removeprefix("size_").removesuffix("_K").replace("_", " ")
