"""What `pickenv bench calibration` hands over: rows for programs (JSON), tables for people (Markdown)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from pickenv.bench.gains import LS, Gain, agreement
from pickenv.bench.real_sets import SETS
from pickenv.bench.run_bench import OURS, PEER_SET, Bench
from pickenv.bench.spread_rows import NOTE, SPREAD, Figures, spread_table, used_words
from pickenv.intervals import Ends

GAIN_HEADS = ("robot", "held out", "calibration", "before (mm)", "left (mm)", "predicted", "measured", "points apart")
HELD = {"random": "random fifths", "blocks": "blocks"}
BEFORE_LS = "nominal"


def bench_json(found: Bench) -> dict[str, Any]:
    """Every row in one format; reductions are fractions, None where there is no such figure.

    Keys of a row: "table" ("gains", "best" or "peers"), "robot", "split" ("random", "blocks" or "poses"), "model",
    "nominal_mm" (base and tool fitted), "held_out_mm", "published_mm" (a mean, of others), "measured_reduction" (of
    what "before" names), "ci95" of it, "predicted_reduction" (by twins of other rows) and "predicted_ci95" (where one
    more arm would lie), "statistic" ("rms" or "mean") and "rows" judged.
    """
    rows = [
        _row("gains", robot, split, gain.model, gain.nominal_mm, gain.held_out_mm, gain.measured)
        | {
            "before": BEFORE_LS if gain.model == "LS" else "LS",
            "before_mm": gain.before_mm,
            "ci95": gain.measured_ci95,
            "predicted_reduction": gain.predicted,
            "predicted_ci95": gain.predicted_ci95,
            "predicted_mm": gain.predicted_mm,
            "refused_draws": gain.refused,
            "statistic": "rms",
            "rows": found.used[robot][1],
            "rows_in_file": found.used[robot][0],
        }
        for (robot, split), gains in found.gains.items()
        for gain in gains
    ]
    for name, figures in found.spread.items():
        rows += _spread_rows(name, figures)
    for name, errors in found.peers.items():
        rows += _peer_rows(name, errors)
    return {
        "rows": rows,
        "agreement": agreement(found.gains),
        "settings": asdict(found.settings),
        "skipped": dict(found.skipped),
    }


def blocked_json(found: Bench, made: str) -> dict[str, Any]:
    """What models remove of rows in blocks, for the demonstration's table: its `measured_gains.json`.

    Args:
        found: What was found.
        made: The date.
    """
    arms = [
        {
            "arm": robot,
            "rows": found.used[robot][1],
            "rows_in_file": found.used[robot][0],
            "ls_mm": round(next(gain.held_out_mm for gain in gains if gain.model == LS), 3),
            "removed": {
                gain.model: [round(value, 3) for value in (gain.measured, *(gain.measured_ci95 or ()))]
                for gain in gains
                if gain.model != LS
            },
        }
        for (robot, split), gains in found.gains.items()
        if split != "random"
    ]
    return {"made_by": "pickenv bench calibration", "made": made, "folds": found.settings.folds, "arms": arms}


def _row(
    table: str, robot: str, split: str, model: str, nominal: float, left: float, measured: float
) -> dict[str, Any]:
    """The keys that every row has."""
    return {
        "table": table,
        "robot": robot,
        "split": split,
        "model": model,
        "nominal_mm": nominal,
        "held_out_mm": left,
        "published_mm": None,
        "measured_reduction": measured,
        "predicted_reduction": None,
        "ci95": None,
    }


def _spread_rows(name: str, figures: Figures) -> list[dict[str, Any]]:
    """LS and the best model of one row of the table of measured robots."""
    row, models = SPREAD[name], figures["models"]
    nominal, ls = models["nominal"][0], models["geometry"]
    named = {"LS": (nominal, ls)}
    if row.terms != "none":
        named[f"best: {used_words(figures)}"] = (ls[0], models["best"])
    return [
        _row("best", row.real.robot, row.how, model, nominal, left[0], 1.0 - left[0] / before)
        | {
            "before": BEFORE_LS if model == "LS" else "LS",
            "before_mm": before,
            "held_out_spread_mm": left[1:],
            "published_mm": row.published,
            "statistic": row.statistic,
            "rows": figures["rows"],
        }
        for model, (before, left) in named.items()
    ]


def _peer_rows(name: str, errors: Mapping[str, Any]) -> list[dict[str, Any]]:
    """A peer on the held-out rows, and on the other poses."""
    rows, real = [], SETS[PEER_SET]
    kinds = (("random", "held_out_rms_mm", "rms", None), ("poses", "random_poses_mean_mm", "mean", real.published))
    for split, key, statistic, published in kinds:
        nominal, left = errors["nominal"][key], errors[key]
        rows.append(
            _row(
                "peers", real.robot, split, name if name != OURS else f"{OURS}: LS", nominal, left, 1.0 - left / nominal
            )
            | {"before": BEFORE_LS, "before_mm": nominal, "published_mm": published, "statistic": statistic}
            | {"note": errors["note"]}
        )
    return rows


def gain_table(found: Bench) -> str:
    """Predicted beside measured reductions, in Markdown."""
    lines = [f"| {' | '.join(GAIN_HEADS)} |", "|" + "---|" * len(GAIN_HEADS)]
    lines += [f"| {' | '.join(cells)} |" for cells in gain_cells(found)]
    return "\n".join(lines) + "\n"


def gain_cells(found: Bench) -> list[tuple[str, ...]]:
    """The rows of that table."""
    return [
        (robot, HELD[split], gain.model, f"{gain.before_mm:.3f}", f"{gain.held_out_mm:.3f}", *_reductions(gain))
        for (robot, split), gains in found.gains.items()
        for gain in gains
    ]


def _reductions(gain: Gain) -> tuple[str, str, str]:
    return (
        _percent(gain.predicted, gain.predicted_ci95),
        _percent(gain.measured, gain.measured_ci95),
        f"{100.0 * (gain.predicted - gain.measured):+.1f}",
    )


def _percent(value: float, ends: Ends | None) -> str:
    said = f"{100.0 * value:.1f} %"
    return said if ends is None else f"{said} ({100.0 * ends[0]:.1f} to {100.0 * ends[1]:.1f})"


def agreement_words(found: Bench) -> str:
    """How well gains were predicted, in a sentence or two; empty where none was asked for."""
    said = agreement(found.gains)
    if not found.gains:
        return ""
    used = ", ".join(
        f"{robot} {rows}" + (f" of {total}" if total > rows else "") for robot, (total, rows) in found.used.items()
    )
    signs, refused = said["sign_right"], sum(gains[0].refused for gains in found.gains.values())
    sign = "The sign of what a learnt residual does on blocks is right in"
    right = "" if signs is None else f" {sign} {100.0 * signs:.0f} %."
    sets = "set" if said["sets"] == 1 else "sets"
    anew = f" ({refused} could not be calibrated, and others were drawn in their place)" if refused else ""
    return (
        f"{said['gains']} gains on {said['sets']} {sets} of rows: predicted and measured are "
        f"{said['median_absolute_difference_points']:.1f} percentage points apart in the median, "
        f"{said['ninth_decile_points']:.1f} in the worst tenth.{right} {found.settings.folds} folds, "
        f"{found.settings.draws} arms drawn for each{anew}. Rows used, equally spaced in the file: {used}."
    )


def peer_table(found: Bench) -> str:
    """What peers leave on the UR5's rows, in Markdown."""
    heads = ("calibration of the UR5", "200 of its rows, RMS (mm)", "its 20 random poses, mean (mm)", "what it does")
    lines = [f"| {' | '.join(heads)} |", "|" + "---|" * len(heads)]
    for name, errors in found.peers.items():
        cells = (name, f"{errors['held_out_rms_mm']:.4f}", f"{errors['random_poses_mean_mm']:.4f}", errors["note"])
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def bench_page(found: Bench) -> str:
    """All tables as one Markdown page."""
    parts = ["# Calibrations of measured robots\n"]
    if found.gains:
        parts += ["## Gains predicted by twins, and measured\n", gain_table(found), agreement_words(found) + "\n"]
    if found.spread:
        parts += ["## Geometry and the best model\n", spread_table(found.spread), NOTE + "\n"]
    if found.peers:
        parts += ["## Peers on the UR5's rows\n", peer_table(found)]
    if found.skipped:
        parts += ["## Not made\n", *(f"- {name}: {reason}" for name, reason in found.skipped.items()), ""]
    return "\n".join(parts)
