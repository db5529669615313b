"""The verdict of a study: which way of making and calibrating arms is enough, at which payload, and how surely."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from pickenv.inspect.reports.report_page import PageVerdict
from pickenv.inspect.reports.report_words import percent
from pickenv.intervals import share_interval
from pickenv.study.design.config import RAW, StudyConfig
from pickenv.study.results.row_table import Row

REQUIRED_YIELD = 0.95
"""Share of arms for which a way of making and calibrating arms counts as sufficient."""
CHOICES = ("tolerances", "it_grade", "method", "poses", "noise_mm", "noise_deg")
"""What a maker chooses; the payload is what the arms then meet."""
FEW = 200
"""Below so many arms the verdict says how little they tell."""


def study_verdict(config: StudyConfig, rows: Sequence[Row]) -> PageVerdict:
    """Whether some way suffices at the payload that is hardest for it, and which is the least demanding.

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
    wanted = f"a yield of {100 * REQUIRED_YIELD:g} %"
    if enough:
        tone, chosen = "good", max(enough, key=_ease)
        headline = f"{_way(chosen)} is enough for {wanted}" + (" at every payload" if len(loads) > 1 else "")
    elif perhaps:
        tone, chosen = "care", max(perhaps, key=lambda row: row["yield"])
        headline = f"{_way(chosen)} may be enough for {wanted}{_at(chosen, loads)}: too few arms to tell"
    else:
        tone, chosen = "bad", max(ways.values(), key=lambda row: row["yield"])
        headline = f"Nothing that was tried gives {wanted}{_at(chosen, loads)}"
    where = _at(chosen, loads)
    said = [f"With {_way(chosen)}, {_share(chosen)} of arms pick {specified(config)}{where}."]
    if not enough:
        said += [_best_at(rows, load) for load in loads if load != chosen["payload_kg"]]
    else:
        others = [r for r in rows if all(r[k] == chosen[k] for k in CHOICES) and r["setting"] != chosen["setting"]]
        said += [f"{_capital(_at(row, loads))} it is {_share(row)}." for row in others]
    uncalibrated = [
        row for row in rows
        if row["method"] == RAW and all(row[k] == chosen[k] for k in ("tolerances", "it_grade", "payload_kg"))
    ]  # fmt: skip
    if chosen["method"] != RAW and uncalibrated:
        said.append(f"Of the same arms without calibration it is {_share(uncalibrated[0])}.")
    if config.arms < FEW:
        said.append(few_arms(config.arms))
    return PageVerdict(tone, _capital(headline), " ".join(said))


def few_arms(arms: int) -> str:
    """What so few arms can tell, as a sentence."""
    low, high = share_interval(arms / 2, arms)
    return (
        f"{arms} arms tell a yield to within about ± {50 * (high - low):.0f} points only: this is a trial run, and "
        "another seed gives other figures within that."
    )


def specified(config: StudyConfig) -> str:
    """When an arm is good enough, in words."""
    return f"at least {100 * config.share:g} % of the fruit within {config.radius_mm:g} mm"


def method_label(method: str) -> str:
    """A method's name for people: LS for ls, LS+BPNN for ls+bpnn; raw stays."""
    return method if method == RAW else method.upper()


def _ease(row: Row) -> tuple[Any, ...]:
    """Larger for what asks less of a maker: coarse grades first, then few poses, then a noisy tracker."""
    return row["it_grade"], -row["poses"], row["noise_mm"], row["method"] == RAW


def _way(row: Row) -> str:
    how = (
        "no calibration" if row["method"] == RAW
        else f"{row['poses']} poses by a tracker of {row['noise_mm']:g} mm noise, {method_label(row['method'])}"
    )  # fmt: skip
    return f"IT{row['it_grade']} ({row['tolerances']}) and {how}"


def _at(row: Row, loads: Sequence[float]) -> str:
    """The payload, where there is one or several were tried."""
    if row["payload_kg"]:
        return f", carrying {row['payload_kg']:g} kg"
    return ", without payload" if len(loads) > 1 else ""


def _best_at(rows: Sequence[Row], load: float) -> str:
    """The best way at one payload alone."""
    best = max((row for row in rows if row["payload_kg"] == load), key=lambda row: row["yield"])
    return f"{_capital(_at(best, (load, load)))} the best is {_way(best)}: {_share(best)}."


def _capital(text: str) -> str:
    text = text.removeprefix(", ")
    return text[:1].upper() + text[1:]


def _share(row: Row) -> str:
    """Yield with its interval, percent."""
    return percent(row["yield"], row["yield_low"], row["yield_high"], 1)
