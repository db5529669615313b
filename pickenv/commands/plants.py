"""Commands about arms and the simulated true arm: `pickenv arms`, `effects`, `iso9283` and `conditions`."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated, Any

from typer import Option

import pickenv
from pickenv.base import command_line, obey, separate, write_json, write_text
from pickenv.commands import showing


def arms(
    details: Annotated[bool, Option("--details")] = False,
    json_file: Annotated[Path | None, Option("--json")] = None,
) -> None:
    """List the arms that come with pickenv: name, joints (R turns, P slides), reach and where the numbers come from.

    Args:
        details: Print where the numbers come from as well.
        json_file: Write the figures to this file.

    Examples:
        pickenv arms

    More: commands.md
    """
    from pickenv.arm.kinematics.inverse import farthest

    separate({}, {"--json": json_file})
    table: list[dict[str, Any]] = []
    for name in pickenv.arm.shipped_arms():
        arm = pickenv.load_arm(name)
        kinds = "".join("P" if slides else "R" for slides in arm.nominal.prismatic)
        reach = round(1e3 * farthest(arm.nominal), 1)
        table.append({"name": name, "joints": kinds, "reach_mm": reach, "source": arm.source})
    heads = ("name", "joints", "reach (mm)", "source")[: 4 if details else 3]
    rows = [[str(cell) for cell in row.values()][: len(heads)] for row in table]
    caption, more = "reach: the farthest that the tool gets from the arm's base", "where the numbers come from"
    words = ("name", "joints", "source")
    show = partial(showing.print_table, "arms that come with pickenv", heads, rows, words=words, caption=caption)
    showing.deliver([(json_file, {"arms": table})], show, more="" if details else more)


def effects(
    plant: str = "orchard",
    reaches: Annotated[int, Option(min=2, callback=showing.limited("reaches"))] = 300,
    dwell: Annotated[float, Option(min=0.0, callback=showing.limited("dwell_s"))] = 0.5,
    hours: Annotated[float, Option(min=0.0, callback=showing.limited("hours"))] = 2.0,
    seed: Annotated[int, Option(min=0)] = 0,
    json_file: Annotated[Path | None, Option("--json")] = None,
) -> None:
    """Each effect's share of the tip error of a simulated arm, in mm: alone, what is left without it, and all.

    Args:
        plant: Plant preset or plant file (.toml).
        reaches: Reaches to average over.
        dwell: Waiting time after arrival, s.
        hours: Time since the machine was switched on, h.
        seed: Seed of the reaches.
        json_file: Write the figures to this file.

    Examples:
        pickenv effects --plant orchard

    More: commands.md
    """
    import numpy as np

    from pickenv.arm.plant.campaign import Pace, draw_reaches, effect_shares, shares_report

    separate({"--plant": plant}, {"--json": json_file})
    machine = pickenv.load_plant(plant)
    joints = draw_reaches(machine, reaches, np.random.default_rng(seed))
    shares = effect_shares(machine, joints, running_time=3600.0 * hours, pace=Pace(dwell=dwell))
    next_step = f"what a calibration leaves: {command_line('pickenv', 'conditions', plant)}"
    showing.deliver([(json_file, shares)], shares_report(shares), next_step)


def iso9283(
    plant: str = "orchard",
    calibration: Path | None = None,
    allow: list[str] | None = None,
    cycles: Annotated[int, Option(min=2, callback=showing.limited("cycles"))] = 30,
    speed: Annotated[float, Option(min=0.01, max=1.0)] = 1.0,
    dwell: Annotated[float, Option(min=0.0, callback=showing.limited("dwell_s"))] = 2.0,
    seed: Annotated[int, Option(min=0)] = 0,
    json_file: Annotated[Path | None, Option("--json")] = None,
    out: Path | None = None,
) -> None:
    """Accuracy AP, repeatability RP, vAP and drift dAP of the simulated arm by ISO 9283, raw and calibrated.

    Args:
        plant: Plant preset or plant file (.toml).
        calibration: Fitted calibration (.npz) to test as well.
        allow: Test the calibration in spite of this: fitted-frames, do-not-use.
        cycles: Measurements per pose; 30 by the standard.
        speed: Share of the largest speed.
        dwell: Waiting time before each measurement, s.
        seed: Seed of friction and instrument noise.
        json_file: Write the figures to this file.
        out: Run folder for `pickenv figures` and `pickenv report`.

    Examples:
        pickenv iso9283 --plant qiao2026 --out runs/iso

    More: commands.md
    """
    typed = dict(locals())
    import numpy as np

    from pickenv.arm.plant.campaign import Pace
    from pickenv.arm.plant.iso9283 import Iso9283Settings, iso9283 as test
    from pickenv.inspect.runs.run_folder import ISO9283, RECORD, recorded_run

    separate(
        {"--plant": plant, "--calibration": [] if calibration is None else [calibration, f"{calibration}.npz"]},
        {"--out": [] if out is None else [out / RECORD, out / ISO9283], "--json": json_file},
    )
    machine = pickenv.load_plant(plant)
    fitted = pickenv.Calibration.load(calibration, machine.arm) if calibration is not None else None
    if fitted is not None:
        obey(fitted.reservations(), allow or ())
    result = test(
        machine,
        fitted.compensator() if fitted is not None else None,
        rng=np.random.default_rng(seed),
        settings=Iso9283Settings(cycles=cycles, pace=Pace(speed=speed, dwell=dwell)),
        reference=fitted.nominal if fitted is not None else None,
    )

    def write_run(folder: Path) -> Path:
        with recorded_run(folder, "iso9283", showing.command_of(iso9283, typed), seed):
            return write_json(folder / ISO9283, result.as_dict())

    showing.deliver([(json_file, result.as_dict()), (out, write_run)], result.report())


WIDE = 170
"""Characters of a table of five levels with their intervals."""


def conditions(
    subject: str,
    plant: str = "orchard",
    payload: Annotated[float, Option(min=0.0, callback=showing.limited("payload_kg"))] = 0.5,
    weather: Annotated[float, Option(min=0.0, callback=showing.limited("weather_K"))] = 10.0,
    hours: Annotated[float, Option(min=0.0, callback=showing.limited("hours"))] = 8.0,
    arms: Annotated[int, Option(min=1, callback=showing.limited("arms"))] = 10,
    tolerances: str = "medium",
    sessions: Annotated[int, Option(min=2, callback=showing.limited("poses"))] = 12,
    poses: Annotated[int, Option(min=5, callback=showing.limited("poses"))] = 25,
    residual: str = "rbf",
    allow: list[str] | None = None,
    seed: Annotated[int, Option(min=0, callback=showing.limited("seed"))] = 0,
    details: Annotated[bool, Option("--details")] = False,
    json_file: Annotated[Path | None, Option("--json")] = None,
    out: Path | None = None,
) -> None:
    """How accuracy changes with payload, temperature and hour, and what a calibration that is told them leaves.

    Args:
        subject: Plant preset or plant file (.toml), or fitted calibration (.npz).
        plant: The simulated arm that a calibration is judged on.
        payload: Largest payload, kg.
        weather: How much cooler or warmer a day may be, K.
        hours: Length of a working day, h.
        arms: Drawn arms; fewer than 10 have no intervals.
        tolerances: Tolerance class that arms are drawn from.
        sessions: Training sessions, each under other conditions.
        poses: Poses of a session.
        residual: What learns the rest: {residual}.
        allow: Judge the calibration in spite of this: fitted-frames, do-not-use.
        seed: Seed of everything random.
        details: Print the errors by payload, weather and hour as well.
        json_file: Write the figures to this file.
        out: Run folder with figure and page.

    Examples:
        pickenv conditions orchard --out runs/conditions

    More: conditions.md
    """
    typed = dict(locals())
    from pickenv.experiments.conditions_study import ConditionRanges, ConditionsSettings, conditions_study
    from pickenv.inspect.runs.run_folder import CONDITIONS, RECORD, REPORT, recorded_run

    is_calibration = subject.endswith(".npz")
    folder = [] if out is None else [out / RECORD, out / CONDITIONS]
    separate({"SUBJECT": subject, "--plant": plant}, {"--out": folder, "--json": json_file})
    machine = pickenv.load_plant(plant if is_calibration else subject)
    fitted = pickenv.Calibration.load(subject, machine.arm) if is_calibration else None
    if fitted is not None:
        obey(fitted.reservations(), allow or ())
    ranges = ConditionRanges(payload, weather, hours)
    settings = ConditionsSettings(ranges, arms, tolerances, sessions, poses, residual, seed)
    with showing.progress_bars() as report:
        result = conditions_study(machine, settings, fitted, report)

    def write_run(folder: Path) -> list[Path]:
        from pickenv.inspect.reports.conditions_report import drawings, page

        with recorded_run(folder, "conditions", showing.command_of(conditions, typed), seed) as run:
            written = [write_json(folder / CONDITIONS, result)]
            written += pickenv.inspect.write_drawings(drawings(run), folder / "figures")
            return [*written, write_text(folder / REPORT, page(run))]

    def show() -> None:
        from pickenv.inspect.reports.conditions_report import condition_tables, conditions_in_words

        headline, means = conditions_in_words(result)
        showing.print_verdict(headline)
        if details:
            print(showing.with_options(means))
        tables = condition_tables(result)
        for title, heads, rows in tables if details else tables[-1:]:
            showing.print_table(title, heads, rows, words=("method",), width=WIDE)

    next_step = "draw it: the same command with --out RUN" if out is None else f"look at it: {out / REPORT}"
    more = "" if details else "errors by payload, weather and hour"
    showing.deliver([(json_file, result), (out, write_run)], show, next_step, more)
