"""What a finished study says: its findings, where single arms stand, and the verdict in words.

The design's own true arm (for `qiao2026` the true values of the paper's Table 1) is placed in the population that its
tolerance class would make: it meets what the population's arms meet, and is compared with each of them at that arm's
own fruit, poses and tracker. Errors are means over an arm's fruit, mm.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.compute as pc
from pyarrow.dataset import Dataset

from pickenv.arm import Plant
from pickenv.base import InputError, share_interval
from pickenv.experiments.study import LS, RAW, Protocol, Setting, StudyConfig, prepared_study
from pickenv.experiments.study_arms import ERROR, OK, evaluate_arm, figures, gathered
from pickenv.experiments.study_rows import Row, held, quantiles_of, read_rows, study_of, yields_of
from pickenv.experiments.study_variance import sensitivities_of
from pickenv.inspect.reports.report_page import PageVerdict
from pickenv.inspect.reports.report_words import percent

DENSE = tuple(float(p) for p in np.linspace(0.01, 0.99, 99))
"""Probabilities of the distributions that are drawn."""


@dataclass(frozen=True, eq=False)
class Findings:
    """What a study found, computed once for figures and report.

    Attributes:
        protocol: The study made ready.
        rows: Its rows, verified.
        yields: Rows of `yields_of`.
        quantiles: Rows of `quantiles_of`.
        dense: Quantiles of the mean position error at `DENSE`.
        sensitivities: For one setting of each method, all else in the middle of what was varied, the rows of
            `sensitivities_of`, by number; or why there are none.
        placements: For the same settings, where the design's own true arm stands, or why nowhere; empty where the
            design has no true arm of its own.
    """

    protocol: Protocol
    rows: Dataset
    yields: list[dict[str, Any]]
    quantiles: list[dict[str, Any]]
    dense: list[dict[str, Any]]
    sensitivities: dict[int, list[dict[str, Any]] | str]
    placements: dict[int, Placement | str]

    def label(self, setting: int) -> str:
        """A setting in a few words, with units."""
        return setting_label(self.yields[setting])


def gather(folder: str | Path) -> Findings:
    """Analyse a study's rows.

    Raises:
        InputError: If the folder holds no study or no rows.
    """
    protocol, rows = prepared_study(study_of(folder)), read_rows(folder)
    design, yields = protocol.design, yields_of(rows, protocol.config.share).to_pylist()
    settings = [row["setting"] for row in held(yields, ("method",))]
    off = any((getattr(design.geometry, name) != getattr(protocol.nominal, name)).any() for name in ("alpha", "a"))
    name = f"{design.name} itself"
    return Findings(
        protocol,
        rows,
        yields,
        quantiles_of(rows).to_pylist(),
        quantiles_of(rows, [ERROR], DENSE).to_pylist(),
        {number: _or_why_not(lambda n: sensitivities_of(rows, n).to_pylist(), number) for number in settings},
        {
            number: _or_why_not(lambda n: place(protocol, rows, protocol.settings[n], design, name), number)
            for number in (settings if off else ())
        },
    )


def _or_why_not(finding: Callable[[int], Any], setting: int) -> Any:
    try:
        return finding(setting)
    except InputError as error:
        return str(error)


# Single arms.

MOST = {RAW: 1000, LS: 1000}
"""Arms that an arm is compared with at most, by method."""
MOST_LEARNT = 20
"""The same for methods that learn, which take seconds for each."""


@dataclass(frozen=True)
class Placement:
    """Where an arm stands in the population of a setting.

    Attributes:
        arm: The arm's name.
        error_mm: Its mean position error under the same calibration, over all fruit and poses that it met.
        arms: Number of arms of the population that it was compared with.
        percentile: Share of them with a smaller error in the same circumstances, 0..1.
        interval: Wilson's 95 % interval of that share.
    """

    arm: str
    error_mm: float
    arms: int
    percentile: float
    interval: tuple[float, float]


def place(protocol: Protocol, rows: Dataset, setting: Setting, arm: Plant, name: str) -> Placement:
    """Calibrate and judge ``arm`` as the setting says, and find its place among the setting's arms.

    Args:
        protocol: The study.
        rows: Its rows.
        setting: One of its settings.
        arm: A single true arm; it need not be of the setting's population.
        name: What it is called.

    Raises:
        InputError: If the arm has no result in this setting, or no other arm has.
    """
    count = min(protocol.config.arms, MOST.get(setting.method, MOST_LEARNT))
    around = (protocol.circumstances(number) for number in range(count))
    outcomes = gathered([evaluate_arm(protocol, [setting], arm, met)[0] for met in around])
    is_ok = np.array([text == OK for text in outcomes.status])
    if not is_ok.any():
        raise InputError(f"{name} has no place in setting {setting.number}: {outcomes.status[0]}")
    error_mm = np.where(is_ok, figures(outcomes.position, outcomes.attitude, protocol.config.radius_mm)[ERROR], np.nan)
    numbers, errors = _errors(rows, setting.number)
    errors, own_there = errors[numbers < count], error_mm[numbers[numbers < count]]
    compared = np.isfinite(own_there)
    if not compared.any():
        raise InputError(f"no arm of setting {setting.number} has a result; give another setting")
    below, arms = int(np.sum((errors < own_there)[compared])), int(compared.sum())
    return Placement(name, float(np.mean(error_mm[is_ok])), arms, below / arms, share_interval(below, arms))


def ranked(rows: Dataset, setting: int) -> dict[str, tuple[int, float]]:
    """Number and mean error in mm of the worst, the median and the best arm of a setting.

    Raises:
        InputError: If no arm of the setting has a result.
    """
    numbers, errors = _errors(rows, setting)
    if not len(numbers):
        raise InputError(f"no arm of setting {setting} has a result; give another setting")
    order = np.lexsort((numbers, -errors))
    places = {"worst": order[0], "median": order[len(order) // 2], "best": order[-1]}
    return {name: (int(numbers[i]), float(errors[i])) for name, i in places.items()}


def _errors(rows: Dataset, setting: int) -> tuple[Any, Any]:
    """Numbers and mean errors, mm, of a setting's arms that have a result."""
    selection = (pc.field("setting") == setting) & (pc.field("status") == OK)
    table = rows.to_table(columns=["arm", ERROR], filter=selection, use_threads=False)
    return table["arm"].to_numpy(), table[ERROR].to_numpy()


# The verdict: which way of making and calibrating arms is enough, at which payload, and how surely.

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
    uncalibrated = [row for row in alike if row["method"] == RAW]
    if best["method"] != RAW and uncalibrated:
        text.append(f"Of the same arms without calibration it is {_share(uncalibrated[0])}.")
    if config.arms < FEW:
        low, high = share_interval(config.arms / 2, config.arms)
        text.append(
            f"{config.arms} arms tell a yield to within about ± {50 * (high - low):.0f} points only: this is a trial "
            "run, and another seed gives other figures within that."
        )
    return PageVerdict(tone, _capital(headline), " ".join(text))


def specified(config: StudyConfig) -> str:
    """When an arm is good enough, in words."""
    return f"at least {100 * config.share:g} % of the fruit within {config.radius_mm:g} mm"


def method_label(method: str) -> str:
    """A method's name for people: LS for ls, LS+BPNN for ls+bpnn; raw stays."""
    return method if method == RAW else method.upper()


def setting_label(row: Row) -> str:
    """A setting in a few words, with units."""
    calibration = (
        "raw"
        if row["method"] == RAW
        else f"{method_label(row['method'])}, {row['poses']} poses, noise {row['noise_mm']:g} mm"
    )
    load = f", payload {row['payload_kg']:g} kg" if row["payload_kg"] else ""
    return f"{row['tolerances']}, IT{row['it_grade']}, {calibration}{load}"


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
