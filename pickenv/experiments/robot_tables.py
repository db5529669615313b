"""Format the results of `pickenv bench calibration`: rows for programs (JSON), and tables for people."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from io import StringIO
from typing import Any

import numpy as np

from pickenv.base import count_of, listed
from pickenv.experiments.engine import Rows
from pickenv.experiments.gains import LEARNT, LS
from pickenv.experiments.robots import SETS, SPREAD, BenchSettings
from pickenv.inspect.colours import TEXTS, said

GAIN_HEADS = ("robot", "held out", "calibration", "before (mm)", "left (mm)", "predicted", "measured", "points apart")
GAINS_FILE, ROBOTS_FILE, BLOCKED_FILE = "gains.csv", "measured-robots.csv", "measured_gains.json"
HELD = {"random": "random fifths", "blocks": "blocks", "poses": "its 20 random poses"}

Gains = Sequence[Mapping[str, Any]]
"""Predicted and measured gains, from `gains_of`."""

SPREAD_HEADS = ("robot and rows judged", "nominal (mm)", "geometry (mm)", "best model (mm)", "published (mm)")
NOTE = TEXTS["explained"]["measured_robots"]


def bench_json(settings: BenchSettings, gains: Gains, models: Rows, skipped: Mapping[str, str]) -> dict[str, Any]:
    """Return all results of `run_bench` as a mapping for JSON; None stands for a number that does not exist.

    The ``gains``, ``models`` and ``skipped`` (reasons why rows of the table were not computed) are from `run_bench`.

    "rows" has one entry per data set, split and model. In an entry, "row" is its name in `ROWS`. "split" is "random" or
    "blocks" (contiguous parts). "rows" is the number of readings, each held out once. The RMS position error of these
    readings is "held_out_mm" with the model. With the nominal arm, and base and tool fitted, it is "nominal_mm".
    "measured_reduction" is the fraction by which "held_out_mm" is below the error of the model that "before" names, and
    "ci95" is the interval of this fraction. "predicted_reduction" is the mean of this fraction over arms drawn from
    twins. "predicted_ci95" is the 95 % interval for one more drawn arm.

    "models" is the table of measured robots. In an entry, "value_mm" is the error, and "low_mm" and "high_mm" are
    the ends of its spread. "used" names the parts of the best model.
    """
    return {
        "rows": gains,
        "models": [json for row in models.dicts() if (json := _model_json(row))],
        "agreement": agreement(gains),
        "settings": asdict(settings),
        "skipped": skipped,
    }


def blocked_json(gains: Gains, folds: int, made: str) -> dict[str, Any]:
    """Return the shares of the error that models remove on held-out contiguous rows, in the format of `measured_gains`.

    Args:
        gains: The gains, from `run_bench`.
        folds: Number of folds that the gains were computed from.
        made: The date on which the gains were computed.
    """
    arms: dict[str, dict[str, Any]] = {}
    for gain in (gain for gain in gains if gain["split"] != "random"):
        facts = {"arm": gain["robot"], "rows": gain["rows"], "rows_in_file": gain["rows_in_file"]}
        arm = arms.setdefault(gain["robot"], facts)
        if gain["model"] == LS:
            arm |= {"ls_mm": round(gain["held_out_mm"], 3), "removed": {}}
        else:
            shares = (gain["measured_reduction"], *(gain["ci95"] or ()))
            arm["removed"][gain["model"]] = [round(value, 3) for value in shares]
    return {"made_by": "pickenv bench calibration", "made": made, "folds": folds, "arms": list(arms.values())}


def _model_json(row: dict[str, Any]) -> dict[str, Any]:
    """Return a row of `model_errors` as an entry of "models" in `bench_json`; the ends of a missing interval are None.

    The entry is empty if the model is "best" and only geometry was fitted.
    """
    spread = SPREAD[row["row"]]
    if row["model"] == "best" and spread.terms == "none":
        return {}
    shown = {"best": "best model", LS: "least squares"}.get(row["model"], row["model"])
    about = {"robot": spread.real.robot, "judged": f"{HELD[spread.how]}, {spread.statistic}", "model": shown}
    used = row["used"] if row["model"] == "best" else ""
    ends = dict(zip(("low_mm", "high_mm"), _ends(row), strict=True))
    return row | about | ends | {"used": used, "published_mm": spread.published}


def _ends(model: dict[str, Any]) -> list[float | None]:
    return [None if np.isnan(model[end]) else model[end] for end in ("low_mm", "high_mm")]


def agreement(gains: Gains) -> dict[str, Any]:
    """Compute how far the gains predicted by twins are from the measured gains, and the same for a null prediction.

    Only gains on contiguous held-out rows count. The null prediction is the mean measured gain of all other robots;
    further data sets of the same robot are left out of this mean.

    Args:
        gains: The gains, from `run_bench`.

    Returns:
        A mapping for JSON. "sets" is the number of data sets, and "gains" the number of gains. "models" has one entry
        per model: "robots", the number of data sets, and distances from the measured gains in percentage points.
        "median_points" and "worst_points" are median and maximum for the twins' predictions. "null_median_points" and
        "null_worst_points" are the same for the null prediction, None if there is only one robot. "learnt_on_blocks" is
        the number of gains of learnt residuals. "sign_right" is the share of these gains whose sign the twins predict
        correctly.
    """
    blocks = [gain for gain in gains if gain["split"] != "random"]
    models = []
    arms = {real.robot: real.arm for real in SETS.values()}
    for model in dict.fromkeys(gain["model"] for gain in blocks):
        some = [gain for gain in blocks if gain["model"] == model]
        predicted = np.array([gain["predicted_reduction"] for gain in some])
        measured = np.array([gain["measured_reduction"] for gain in some])
        apart = 100.0 * np.abs(predicted - measured)
        arm = np.array([arms.get(gain["robot"], gain["robot"]) for gain in some])
        others = (arm[:, None] != arm).astype(float)  # series of one robot say too much of one another
        figures: dict[str, float | None] = dict.fromkeys(("null_median_points", "null_worst_points"))
        if others.any(axis=1).all():
            null = 100.0 * np.abs(others @ measured / others.sum(axis=1) - measured)
            figures = {"null_median_points": float(np.median(null)), "null_worst_points": float(null.max())}
        own = {"median_points": float(np.median(apart)), "worst_points": float(apart.max())}
        models.append({"model": model, "robots": len(some)} | own | figures)
    signs = [
        (gain["predicted_reduction"] > 0.0) == (gain["measured_reduction"] > 0.0)
        for gain in blocks
        if gain["model"] in LEARNT
    ]
    return {
        "sets": len({gain["robot"] for gain in blocks}),
        "gains": len(blocks),
        "models": models,
        "learnt_on_blocks": len(signs),
        "sign_right": float(np.mean(signs)) if signs else None,
    }


def agreement_words(gains: Gains, settings: BenchSettings) -> str:
    """Return a few sentences on how well gains were predicted; an empty text if no gains were computed.

    The ``gains`` are from `run_bench`, which was run with ``settings``.
    """
    if not gains:
        return ""
    used = {
        gain["robot"]: f"{gain['rows']}" + f" of {gain['rows_in_file']}" * (gain["rows_in_file"] > gain["rows"])
        for gain in gains
    }
    refused = sum(gain["refused_draws"] for gain in gains if gain["model"] == LS)
    anew = f" ({refused} could not be calibrated, and others were drawn in their place)" if refused else ""
    return (
        f"{points_words(agreement(gains))}{settings.folds} folds, {settings.draws} arms drawn for each{anew}. Rows "
        f"used, equally spaced in the file: {', '.join(f'{robot} {rows}' for robot, rows in used.items())}."
    )


def points_words(found: Mapping[str, Any]) -> str:
    """Return ``found``, the result of `agreement`, as sentences; an empty text if no gains are on contiguous rows."""
    if not found["gains"]:
        return ""
    medians: list[str] = []
    idle: list[str] = []
    for row in found["models"]:
        null = row["null_median_points"]
        beside = "" if null is None else f", the others' mean {null:.1f} (at most {row['null_worst_points']:.1f})"
        medians.append(f"{row['model']} {row['median_points']:.1f} (at most {row['worst_points']:.1f}){beside}")
        if null is not None and row["median_points"] >= null and row["worst_points"] >= row["null_worst_points"]:
            idle.append(row["model"])
    words = (
        f"{count_of(found['gains'], 'gain')} on blocks of {count_of(found['sets'], 'set')} of rows. Percentage points "
        f"between a twin's prediction and what was measured, the median: {'; '.join(medians)}. "
    )
    if idle:
        words += f"Of {listed(idle)} a twin promises nothing: the mean of the other robots is as near. "
    if found["sign_right"] is not None:
        words += f"The sign of what a learnt residual does is right in {100.0 * found['sign_right']:.0f} %. "
    return words


def gain_cells(gains: Gains, folds: int) -> list[tuple[str, ...]]:
    """Return the cells of the table of predicted and measured error reductions, one tuple per line.

    The ``gains`` are from `run_bench`, and ``folds`` is the number of folds that they were computed from.
    """
    cells: list[tuple[str, ...]] = []
    held_out = HELD if folds == 5 else HELD | {"random": f"{folds} random parts"}
    for gain in gains:
        predicted, measured = gain["predicted_reduction"], gain["measured_reduction"]
        names = (gain["robot"], held_out[gain["split"]], gain["model"])
        sizes = (f"{gain['before_mm']:.3f}", f"{gain['held_out_mm']:.3f}")
        pairs = ((predicted, gain["predicted_ci95"]), (measured, gain["ci95"]))
        shares = (said(share, ends, 1, 100.0, unit=" %") for share, ends in pairs)
        cells.append((*names, *sizes, *shares, f"{100.0 * (predicted - measured):+.1f}"))
    return cells


def csv_files(gains: Gains, models: Rows, folds: int) -> dict[str, str]:
    """Return the tables of gains and of measured robots as CSV texts, by file name; an empty table is left out.

    The ``gains`` and ``models`` are from `run_bench`, and ``folds`` is its number of folds.
    """
    tables = {GAINS_FILE: (GAIN_HEADS, gain_cells(gains, folds)), ROBOTS_FILE: (SPREAD_HEADS, spread_cells(models))}
    texts: dict[str, str] = {}
    for name, (heads, rows) in tables.items():
        text = StringIO(newline="")
        csv.writer(text, lineterminator="\n").writerows([heads, *rows])
        texts |= {name: text.getvalue()} if rows else {}
    return texts


def spread_cells(models: Rows) -> list[tuple[str, ...]]:
    """Return the cells of the table of measured robots, one tuple per line, from the numbers of `run_bench`."""
    table: list[tuple[str, ...]] = []
    for (name,) in models.levels("row"):
        nominal, ls, best = models.where(row=name).dicts()
        row = SPREAD[name]
        label = f"{row.real.robot}, {HELD[row.how]}, {'RMS' if row.statistic == 'rms' else 'mean'}"
        remark = f"; {row.remark}" if row.remark else ""
        used = f"{_millimetres(best)}: {best['used']}{remark}" if row.terms != "none" else ""
        published = "" if row.published is None else f"{row.published:g}"
        table.append((label, _millimetres(nominal), _millimetres(ls), used, published))
    return table


def _millimetres(model: dict[str, Any]) -> str:
    """Return the error in a row of `model_errors` as text, mm, with its spread in brackets.

    Errors below 1 mm have three decimals, larger errors two.
    """
    value = model["value_mm"]
    return said(value, None if np.isnan(model["low_mm"]) else _ends(model), 3 if value < 1.0 else 2)
