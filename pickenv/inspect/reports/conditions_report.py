"""Figure and page of a study of payload, temperature and hour of day."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pickenv.inspect.colours import as_sentence, in_words, said
from pickenv.inspect.figures import plot_policies
from pickenv.inspect.figures.run_drawings import Drawings, captioned
from pickenv.inspect.reports.report_page import PageTable, PageVerdict, plain_report
from pickenv.inspect.runs.run_folder import CONDITIONS, Run, TakePicture, load_result

SWEEPS = {"payload": "payload (kg)", "temperature": "weather (K)", "hour": "time since the start of work (h)"}
"""Axis labels of the conditions, which are varied one at a time while the others stay at the reference."""
HELD_OUT = "held-out sessions"
"""Key of the held-out sessions. Their conditions were drawn in the same way as the training sessions' conditions."""


def drawings(run: Run) -> Drawings:
    """Return the figure of a study of conditions."""
    sweeps = load_result(run, CONDITIONS)["sweeps"]
    return [captioned("error_by_condition", plot_policies.error_by_condition, sweeps, SWEEPS)]


def page(run: Run, picture: TakePicture | None = None) -> str:
    """Return the page of a study of conditions as HTML; ``picture`` is not used."""
    result = load_result(run, CONDITIONS)
    headline, text = map(as_sentence, conditions_in_words(result))
    verdict = PageVerdict("note", headline, text)
    tables = [PageTable(*table, look="dense").spelled() for table in condition_tables(result)]
    ranges, settings = result["settings"]["ranges"], result["settings"]
    subtitle = (
        f"Simulated arm {in_words(result['plant'])}; up to {ranges['payload']:g} kg, {ranges['weather']:g} K cooler to "
        f"warmer, {ranges['hours']:g} h of work; {settings['sessions']} sessions of {settings['poses']} poses; growth "
        f"with temperature: {result['growth']}"
    )
    return plain_report(run, "Payload, temperature and hour of day", subtitle, verdict, tables, drawings(run))


def conditions_in_words(result: Mapping[str, Any]) -> tuple[str, str]:
    """Return the verdict in words: a headline, and a text with the mean errors behind it.

    ``result`` is the study's result, as the run folder's `CONDITIONS` has it.
    """
    figures = {name: by_level[0] for name, by_level in result["sweeps"][HELD_OUT]["methods"].items()}
    usual = next(name for name in figures if name != "raw")
    best = min(figures, key=lambda name: float(figures[name]["mean_mm"]))
    least = min(
        figure["mean_mm"] for sweep in result["sweeps"].values() for figure in sweep["methods"][usual]
    )  # what it leaves where it was made
    means = "; ".join(f"{name} {_mean(figure)} mm" for name, figure in figures.items())
    headline = f"{usual}: {figures[usual]['mean_mm']:.2f} mm over a working day, {least:.2f} mm where it was made"
    if best not in ("raw", usual):
        headline = f"best over a working day: {best}, {figures[best]['mean_mm']:.2f} mm; {headline}"
    headline = headline[:1].upper() + headline[1:]
    return headline, f"In sessions that no fit has seen: {means}. Intervals are over {_over(result)}."


def condition_tables(result: Mapping[str, Any]) -> list[tuple[str, list[str], list[list[str]]]]:
    """Return a table for each condition, as title, heads and rows: mean errors with 95 % intervals, mm.

    ``result`` is the study's result, as the run folder's `CONDITIONS` has it.
    """
    tables = []
    for name, sweep in result["sweeps"].items():
        rows = [[method, *(_mean(figure) for figure in by_level)] for method, by_level in sweep["methods"].items()]
        if name == HELD_OUT:
            title, heads = "New sessions as in training; told: given payload, weather and hour", ["mean error (mm)"]
        else:
            title, heads = f"Mean error (mm) by {SWEEPS[name]}", [f"{level:g}" for level in sweep["levels"]]
        tables.append((f"{title}; 95 % intervals over {_over(result)}", ["method", *heads], rows))
    return tables


def _over(result: Mapping[str, Any]) -> str:
    return f"{result['interval_over']}" + (f" ({result['no_interval']})" if result["no_interval"] else "")


def _mean(figure: Mapping[str, Any]) -> str:
    return said(figure["mean_mm"], figure["ci95_mm"], 3)
