"""`pickenv calibrate`: calibrate an arm from measured files of any kind, and judge it on rows that no fit has seen."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import typer
from typer import Option

import pickenv
from pickenv.base import command_line, npz_path, require, separate, write_json
from pickenv.commands.showing import arguments_for, command_of, deliver, progress_bars

NOT_GOOD = 3
"""Exit code of a verdict "do not use", of unreachable targets, and of an old calibration that is no longer good."""


def calibrate(
    files: list[Path],
    arm: str | None = None,
    columns: list[str] | None = None,
    stations: Literal["none", "base", "tool", "base,tool"] | None = None,
    frames: Literal["known", "fitted"] | None = None,
    test_rows: Annotated[int | None, Option(min=1)] = None,
    split: Literal["random", "blocked"] = "random",
    seed: Annotated[int, Option(min=0)] = 0,
    test: list[Path] | None = None,
    fit: Literal["auto", "offsets", "full"] = "auto",
    tolerances: str | None = None,
    prior_scale: Annotated[float | None, Option(min=1e-3, max=1e3)] = None,
    workspace: str | None = None,
    terms: str = "auto",
    payload: Annotated[tuple[float, float, float, float] | None, Option(metavar="KG X Y Z")] = None,
    residual: Annotated[str, Option(metavar="NAME")] = "auto",
    force: Annotated[bool, Option("--force")] = False,
    robust: Annotated[bool, Option("--robust/--no-robust")] = True,
    lens_out: Path | None = None,
    unit: str | None = None,
    details: Annotated[bool, Option("--details")] = False,
    json_file: Annotated[Path | None, Option("--json")] = None,
    out: Path | None = None,
    report: Path | None = None,
    run: Path | None = None,
) -> None:
    """Identify a real arm from measurements of any kind, and judge the result on held-out rows.

    The verdict comes first: good, with care, or do not use. The exit code is 3 for "do not use".

    Args:
        files: Files of measurements (CSV, YAML, Parquet, ROS 2 bags) of one layout, or a folder of pictures.
        arm: Arm name, or file ({arm_format}; .urdf#link, .xml#body; .urdf#link,link for a whole robot); not for
            tool poses given in place of joint values.
        columns: Column description, by name or path; pickenv's own if left out. Repeat it to give one per file.
        stations: Frames that differ between the files; if left out, found from rows of poses or positions, else both.
        frames: known: the instrument measures the arm's own tool in its own base frame; fitted: base and tool are
            fitted too. If left out, the files' column 'frames' decides; without this column, fitted.
        test_rows: Number of rows to hold out at random; a fifth if left out.
        split: random: some random rows are held out; blocked: each contiguous tenth of the rows in turn, and the
            calibration is fitted to all rows.
        seed: Seed of all random numbers.
        test: Held-out rows from other files instead.
        fit: auto: all parameters, each with its tolerance class as prior; offsets: the joints' zeros alone; full: all
            parameters without prior, as in the papers.
        tolerances: Tolerance class of the arm's parts, by name or file; if left out the one in the arm's file, or a
            cobot's.
        prior_scale: Factor on the class's tolerances; estimated from the rows if left out.
        workspace: Where the arm will work: a file of targets, or ranges such as q1=-90:90,x=300:900 (deg, mm); the
            joint limits if left out.
        terms: Parametric terms: auto, none, or compliance (under measured torques, or the masses in the arm's file),
            bending (across the joints, under these masses), gravity (the arm's own weight, masses unknown), periodic
            (harmonics of the drives, of orders that the data show), thermal; join several by +.
        payload: Mass at the tool in all rows, kg, and its centre in the tool's frame, mm; it adds to the masses in the
            arm's file, for compliance and bending.
        residual: Residual model: auto (the best of ours, if it wins in cross-validation), none, {residual}.
        force: Use the named residual model also if it does not win in cross-validation.
        robust: List outliers, held out or not, and leave them out (--robust) or keep them (--no-robust).
        lens_out: Write the camera's lens as ROS camera_info (.yaml).
        unit: Serial number of the robot, kept in the calibration.
        details: Print parameters, terms, harmonics, notes and evidence as well.
        json_file: Write the results to this file.
        out: Write the fitted calibration to this file (.npz).
        report: Write a one-page report (.html).
        run: Run folder: calibration, report, and what `pickenv figures` draws.

    Examples:
        pickenv calibrate tracker.csv --arm ur5e --out my_arm.npz --report my_arm.html
        pickenv calibrate views.csv --arm so101 --columns webcam.toml --out so101.npz

    More: calibrating-a-robot.md
    """
    typed = dict(locals())
    from pickenv.calibration.camera.boards import write_lens
    from pickenv.calibration.pipeline.fitting import lens_of
    from pickenv.calibration.reading.description import load_description
    from pickenv.inspect.runs.run_folder import RECORD

    separate(
        {"FILES": files, "--test": test, "--columns": columns, "--arm": arm},
        {
            "--json": json_file,
            "--out": None if out is None else npz_path(out),
            "--report": report,
            "--run": None if run is None else run / RECORD,
            "--lens-out": lens_out,
        },
    )
    if report is not None or run is not None:
        require("jinja2", "matplotlib", "plotly")  # said now, and not after the work
    if lens_out is not None and (len(columns or []) != 1 or load_description((columns or [""])[0]).pixels is None):
        raise pickenv.InputError("--lens-out is for one camera's pictures; give their --columns, or leave it out")
    choices = pickenv.Choices(**arguments_for(pickenv.Choices, typed))
    robot: str | pickenv.arm.Arm | None = arm
    if payload is not None:
        if arm is None or not {"auto", "compliance", "bending"} & set(terms.split("+")):
            raise pickenv.InputError("--payload is for an arm whose joints yield; give --arm, and --terms compliance")
        robot = pickenv.load_arm(arm, whole=True).holding(payload[0], [1e-3 * length for length in payload[1:]])
    how: dict[str, Any] = arguments_for(pickenv.calibrate, typed) | {"arm": robot, "choices": choices}
    with progress_bars() as progress:
        result = pickenv.calibrate(data=files, progress=progress, **how)
    refused = result.quality.grade == "do not use"
    seeds = {"split": split, "seed": seed, "held-out rows": len(result.test.joints)}
    command = command_of(calibrate, typed)
    deliver(
        [
            (out, result.calibration.save),
            (lens_out, lambda path: write_lens(lens_of(result.geometric, result.train), path)),
            (report, lambda path: result.write_page(path, seeds)),
            (run, lambda folder: write_run(folder, command, seed, result, seeds)),
            (json_file, result.as_dict()),
        ],
        result.report() if details else result.summary(),
        next_step(arm, out, refused),
        "" if details else "parameters, terms, notes and evidence",
    )
    if refused:
        raise typer.Exit(NOT_GOOD)


def next_step(arm: str | None, out: Path | None, refused: bool) -> str:
    """Return what to do with the calibration next, with a command to copy; empty if there is no arm.

    Args:
        arm: Arm name or file; None for tool poses in place of joint values, which have no arm.
        out: File of the calibration; None if it was not written.
        refused: Whether the verdict is "do not use".
    """
    if arm is None:
        return ""
    path, _, links = arm.partition("#")
    whole = "," in links
    if refused:
        plan = "" if whole else f": {command_line('pickenv', 'plan-poses', arm=arm, out='poses.csv')}"
        return f"measure more poses, or others{plan}"
    if out is None:
        return "keep it: the same command with --out my_arm.npz"
    if whole:
        new = f"robot_calibrated{Path(path).suffix}"
        return "correct the robot's own file: " + command_line("pickenv", "export", npz_path(out), onto=path, out=new)
    targets = command_line("pickenv", "apply", npz_path(out), "targets.csv", arm=arm, out="commands.csv")
    return f"correct targets: {targets}"


def write_run(folder: Path, command: str, seed: int, result: pickenv.Result, seeds: dict[str, Any]) -> list[Path]:
    """Write the run folder of `pickenv calibrate --run`: calibration, results, report, and the data of figures.

    Args:
        folder: The run folder.
        command: The command line, for the record of the run.
        seed: The seed of the run.
        result: The result of the calibration.
        seeds: Seeds by name, for the record of the run.

    Returns:
        The paths of the files written.
    """
    from pickenv.inspect.runs.calibration_trace import trace_of, views_of
    from pickenv.inspect.runs.run_folder import REPORT, recorded_run, save_part

    stages = list(result.errors.values())
    errors = {"nominal": stages[0], "calibrated": stages[1]}
    if len(stages) > 2:
        errors[result.best_model] = stages[-1]
    trace = trace_of(result.fit, {"identification": result.train, "test": result.test}, errors, views_of(result))
    with recorded_run(folder, "calibration", command, seed):
        return [
            result.calibration.save(folder / "calibration"),
            save_part(folder, trace, seed),
            write_json(folder / "figures.json", result.as_dict()),
            pickenv.inspect.write_calibration_report(folder / REPORT, result, seeds),
        ]
