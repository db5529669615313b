"""Commands about arms and plants (simulated true arms): `pickenv arms`, `effects`, `iso9283` and `conditions`."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

from typer import Option

import pickenv
from pickenv.base import LEAST, InputError, command_line, folded, obey, screen_width, separate, write_json, write_text
from pickenv.commands import showing


def arms(
    details: Annotated[bool, Option("--details")] = False,
    json_file: Annotated[Path | None, Option("--json")] = None,
) -> None:
    """List the arms that come with pickenv: name, joints (R revolute, P prismatic), reach and source of the numbers.

    Args:
        details: Print the source of the numbers as well.
        json_file: Write the numbers to this file.

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
    """Compute each effect's share of the tip error of a simulated arm, mm.

    Three errors are compared: with the effect alone, with all effects but this one, and with all effects.

    Args:
        plant: Plant preset or plant file (.toml).
        reaches: Number of reaches to average over.
        dwell: Waiting time after arrival, s.
        hours: Time since the machine was switched on, h.
        seed: Seed of the reaches.
        json_file: Write the numbers to this file.

    Examples:
        pickenv effects --plant orchard

    More: commands.md
    """
    import numpy as np

    from pickenv.arm.plant.campaign import Pace, effect_shares, shares_report
    from pickenv.calibration import random_joints

    separate({"--plant": plant}, {"--json": json_file})
    machine = pickenv.load_plant(plant)
    joints = random_joints(machine.arm.nominal, reaches, np.random.default_rng(seed))
    shares = effect_shares(machine, joints, running_time=3600.0 * hours, pace=Pace(dwell=dwell))
    next_step = f"what a calibration leaves: {command_line('pickenv', 'conditions', plant)}"
    showing.deliver([(json_file, shares)], shares_report(shares), next_step)


def iso9283(
    plant: str = "orchard",
    rows: Path | None = None,
    arm: str | None = None,
    columns: str | None = None,
    frames: Literal["known", "fitted"] | None = None,
    calibration: Path | None = None,
    allow: list[str] | None = None,
    cycles: Annotated[int, Option(min=2, callback=showing.limited("cycles"))] = 30,
    speed: Annotated[float, Option(min=0.01, max=1.0)] = 1.0,
    dwell: Annotated[float, Option(min=0.0, callback=showing.limited("dwell_s"))] = 2.0,
    seed: Annotated[int, Option(min=0)] = 0,
    details: Annotated[bool, Option("--details")] = False,
    json_file: Annotated[Path | None, Option("--json")] = None,
    out: Path | None = None,
) -> None:
    """Compute accuracy AP, repeatability RP and drift by ISO 9283, of a simulated arm or of measured rows.

    A simulated arm is tested raw, and with --calibration calibrated as well.

    Args:
        plant: Plant preset or plant file (.toml).
        rows: File of measured poses or positions instead, in which each commanded pose is visited several times. Rows
            whose joints differ by 2e-4 rad or m at most are of one pose. Of the options below, --arm, --columns,
            --frames, --details and --json go with it.
        arm: Arm of the rows: its name, or file ({arm_format}).
        columns: Column description of the rows, by name or path; pickenv's own if left out.
        frames: known: the instrument measures the arm's own tool in its own base frame; fitted: base and tool are
            fitted to the rows. As the file says if left out.
        calibration: Fitted calibration (.npz) to test as well.
        allow: Test the calibration in spite of this reservation: fitted-frames, do-not-use.
        cycles: Number of measurements per pose; 30 by the standard.
        speed: Share of the largest speed.
        dwell: Waiting time before each measurement, s.
        seed: Seed of friction and instrument noise.
        details: Print every pose of the rows, and its drift.
        json_file: Write the results to this file.
        out: Run folder for `pickenv figures` and `pickenv report`.

    Examples:
        pickenv iso9283 --plant qiao2026 --out runs/iso
        pickenv iso9283 --rows tracker.csv --arm ur10e

    More: commands.md
    """
    typed = dict(locals())
    of_rows = {"arm", "columns", "frames", "details"}
    if rows is None:
        showing.refuse_stray(iso9283, typed, of_rows, "`rows` only; leave it out")
    else:
        of_plants = typed.keys() - of_rows - {"rows", "json_file"}
        showing.refuse_stray(iso9283, typed, of_plants, "a simulated arm only; leave it out, or `rows`")
        deliver_measured(rows, arm, columns, frames, details, json_file)
        return
    if allow and calibration is None:
        raise InputError("`allow` goes with `calibration` only; leave it out, or give that too")
    import numpy as np

    from pickenv.arm.plant.campaign import Pace
    from pickenv.arm.plant.iso9283 import Iso9283Settings, iso9283 as test
    from pickenv.inspect.runs.run_folder import ISO9283, RECORD, recorded_run

    separate(
        {"--plant": plant, "--calibration": [] if calibration is None else [calibration, f"{calibration}.npz"]},
        {"--out": [] if out is None else [out / RECORD, out / ISO9283], "--json": json_file},
    )
    machine = pickenv.load_plant(plant)
    settings = Iso9283Settings(cycles=cycles, pace=Pace(speed=speed, dwell=dwell))
    corrected: dict[str, Any] = {}
    if calibration is not None:
        fitted = pickenv.Calibration.load(calibration, machine.arm)
        obey(fitted.reservations(), allow or ())
        corrected = {"compensate": fitted.compensator(), "reference": fitted.nominal}
    result = test(machine, rng=np.random.default_rng(seed), settings=settings, **corrected)

    def write_run(folder: Path) -> Path:
        with recorded_run(folder, "iso9283", showing.command_of(iso9283, typed), seed):
            return write_json(folder / ISO9283, result.as_dict())

    showing.deliver([(json_file, result.as_dict()), (out, write_run)], result.report())


def deliver_measured(
    rows: Path,
    arm: str | None,
    columns: str | None,
    frames: Literal["known", "fitted"] | None,
    details: bool,
    json_file: Path | None,
) -> None:
    """Compute, write and print AP, RP and drift of measured rows; the arguments are those of `iso9283`."""
    from pickenv.calibration import measured_iso9283, read_measurements

    separate({"--rows": rows, "--arm": arm, "--columns": columns}, {"--json": json_file})
    if arm is None:
        raise InputError("no arm is named for these `rows`; give its name, or its file, as `arm`")
    robot = pickenv.load_arm(arm)
    measured = read_measurements(rows, robot.nominal, columns, repeats=True)
    result = measured_iso9283(robot, measured if frames is None else replace(measured, frames=frames))
    more = "" if details else "every pose, and its drift"
    plan = command_line("pickenv", "plan-poses", arm=arm, out="poses.csv")
    next_step = f"for a smaller AP, poses to calibrate from: {plan}"
    showing.deliver([(json_file, result)], partial(show_measured, result, details), next_step, more)


def show_measured(result: dict[str, Any], details: bool) -> None:
    """Print AP (accuracy), RP (repeatability) and drift of measured rows, with reservations and a table of the poses.

    ``result`` is what `iso9283` writes to its JSON file. With ``details`` all poses, and a table of their drift, are
    printed.
    """
    from pickenv.inspect.colours import said

    poses = result["poses"]
    drifts = [{"name": pose["name"], **pose["drift"]} for pose in poses if pose["drift"] is not None]

    def cell(item: dict[str, Any], figure: str) -> str:
        return said(item[f"{figure}_mm"], item.get(f"{figure}_ci95_mm"), 3)

    def worst(figure: str) -> str:
        item = max(poses, key=lambda item: item[f"{figure}_mm"])
        return f"{cell(item, figure)} mm at {item['name']}"

    counts = [pose["cycles"] for pose in poses]
    cycles = f"{min(counts)}" if min(counts) == max(counts) else f"{min(counts)} to {max(counts)}"
    accuracy = f"AP up to {worst('accuracy')}" if poses[0]["accuracy_mm"] is not None else "AP unknown"
    showing.print_verdict(f"Measured {accuracy}; RP up to {worst('repeatability')}", width=NARROW)
    about = f"{result['rows']}: {len(poses)} poses of {result['arm']}, {cycles} cycles each; brackets: 95 % over cycles"
    for sentence in (about, *_reservations(result, min(counts))):
        print(*folded(sentence, screen_width(NARROW)), sep="\n")
    heads, words = ["pose", "cycles", "AP (mm)", "RP (mm)"], ("pose",)
    lines = [[pose["name"], str(pose["cycles"]), cell(pose, "accuracy"), cell(pose, "repeatability")] for pose in poses]
    if "accuracy_deg" in poses[0]:
        heads += ["AP (deg)", "RP (deg)"]
        for line, pose in zip(lines, poses, strict=True):
            line += [said(pose["accuracy_deg"], None, 4), said(max(pose["repeatability_deg"]), None, 4)]
    most = None if details else showing.MOST
    showing.print_table("accuracy and repeatability", heads, lines, words=words, width=NARROW, most=most)
    if not drifts:
        return
    intervals = [ends for drift in drifts if (ends := drift["wander_ci95_mm"]) is not None]
    beyond = f"beyond chance at {sum(low > 0 for low, _ in intervals)} of {len(intervals)} poses"
    chance = beyond if intervals else f"which needs {3 * LEAST} cycles to tell"
    largest = max(drift["wander_mm"] for drift in drifts)
    print(f"first to last third of the cycles: means moved by up to {largest:.3f} mm, {chance}")
    if details:
        heads = ["pose", "cycles", "moved (mm)", "dAP (mm)", "dRP (mm)"]
        changes = ("wander", "accuracy_change", "repeatability_change")
        lines = [[d["name"], f"2 × {d['cycles']}", *(cell(d, change) for change in changes)] for d in drifts]
        showing.print_table("drift", heads, lines, words=words, width=NARROW)


def _reservations(result: dict[str, Any], cycles: int) -> Iterator[str]:
    """Yield sentences that a reader of AP and RP must know about the rows, such as that there are too few cycles.

    ``result`` is what `iso9283` writes to its JSON file, and ``cycles`` the least number of measurements of a pose.
    """
    if result["fitted"]:
        frames, count, numbers = " and ".join(result["fitted"]), result["fitted_numbers"], result["of_numbers"]
        if count < numbers:
            yield f"{frames} fitted to these poses, {count} of their {numbers} numbers: AP in its own base is larger"
        else:
            yield "too few poses to fit the base: AP needs three, or an instrument registered to the base"
    if cycles < result["cycles_of_the_standard"]:
        least = result["cycles_of_the_standard"]
        yield f"the standard has {least} cycles; with fewer RP has no interval, and with fewer than {LEAST} AP has none"
    if result["still"]:
        yield (
            f"{result['still']} rows follow one of the same pose: "
            "unless the arm left it between, RP is the instrument's alone"
        )


NARROW = 100
"""Number of characters in a line of output about measured rows."""

WIDE = 170
"""Number of characters in a line of a table of five levels with their intervals."""


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
    """Compute how accuracy changes with payload, temperature and hour, for calibrations with and without these inputs.

    Args:
        subject: Plant preset or plant file (.toml), or fitted calibration (.npz).
        plant: The simulated arm that a calibration is judged on; it goes with a calibration only.
        payload: Largest payload, kg.
        weather: Largest deviation of a day's temperature from the usual one, K.
        hours: Length of a working day, h.
        arms: Number of drawn arms; fewer than 10 have no intervals. --arms, --tolerances and --residual go with a
            plant only.
        tolerances: Tolerance class that arms are drawn from.
        sessions: Number of training sessions, each under other conditions.
        poses: Number of poses of a session.
        residual: Residual model: {residual}.
        allow: Judge the calibration in spite of this reservation: fitted-frames, do-not-use.
        seed: Seed of all random numbers.
        details: Print the errors by payload, weather and hour as well.
        json_file: Write the results to this file.
        out: Run folder with figure and page.

    Examples:
        pickenv conditions orchard --out runs/conditions

    More: conditions.md
    """
    typed = dict(locals())
    from pickenv.experiments.conditions_study import ConditionsSettings, conditions_study
    from pickenv.inspect.runs.run_folder import CONDITIONS, RECORD, REPORT, recorded_run

    is_calibration = subject.endswith(".npz")
    of_other = {"arms", "tolerances", "residual"} if is_calibration else {"plant", "allow"}
    kind = "a plant" if is_calibration else "a calibration (.npz)"
    showing.refuse_stray(conditions, typed, of_other, f"{kind} as SUBJECT only; leave it out")
    folder = [] if out is None else [out / RECORD, out / CONDITIONS]
    separate({"SUBJECT": subject, "--plant": plant}, {"--out": folder, "--json": json_file})
    machine = pickenv.load_plant(plant if is_calibration else subject)
    fitted = pickenv.Calibration.load(subject, machine.arm) if is_calibration else None
    if fitted is not None:
        obey(fitted.reservations(), allow or ())
    settings = ConditionsSettings(**showing.arguments_for(ConditionsSettings, typed))
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
