"""Commands of a calibration: a board and poses before it, `calibrate`, and verify, apply, export, twin after it."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import typer
from typer import Option

import pickenv
from pickenv.base import DO_NOT_USE, InputError, command_line, npz_path, obey, require, separate, write_json
from pickenv.commands.showing import arguments_for, command_of, deliver, limited, progress_bars

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
    from pickenv.inspect.runs.run_folder import REPORT, recorded_run, save_part
    from pickenv.inspect.runs.traces import trace_of, views_of

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


def board(file: str, out: Path = Path("board.pdf")) -> None:
    """Print a calibration board to true scale, with a ruler to check the printer by.

    Args:
        file: Board file (.toml, or a description with [board]), or charuco_a4, chessboard_a4, apriltags_a4.
        out: Write the page to this file (.pdf, .svg).

    Examples:
        pickenv board charuco_a4 --out board.pdf

    More: so101.md
    """
    from pickenv.calibration.camera.boards import load_board, write_board

    separate({"FILE": file}, {"--out": out})
    page = load_board(file)
    width, height = page.size
    text = f"{page.title}: {1e3 * width:g} x {1e3 * height:g} mm. Print at 100 %, glue it onto something flat, and "
    deliver([(out, lambda path: write_board(page, path))], f"{text}measure the rule below it")


def plan_poses(
    arm: Annotated[str, Option()],
    n: Annotated[int, Option("--n", min=1)] = 30,
    kind: Literal["pose", "position"] | None = None,
    criterion: Literal["d-optimal", "test-poses"] | None = None,
    at: Path | None = None,
    frames: Literal["fitted", "known"] = "fitted",
    candidates: Annotated[int | None, Option(min=10)] = None,
    pool: Annotated[Path | None, Option("--from")] = None,
    like: Path | None = None,
    columns: str | None = None,
    noise_mm: Annotated[float | None, Option(callback=limited("scatter_mm"))] = None,
    fit: Literal["auto", "offsets", "full"] = "auto",
    tolerances: str | None = None,
    prior_scale: Annotated[float, Option(min=1e-3, max=1e3)] = 1.0,
    curve: Annotated[bool, Option("--curve")] = False,
    seed: Annotated[int, Option(min=0)] = 0,
    out: Path | None = None,
    json_file: Annotated[Path | None, Option("--json")] = None,
) -> None:
    """Choose the most informative poses to measure an arm at, within its joint limits, ordered for short travel.

    Args:
        arm: Arm name or file ({arm_format}).
        n: Number of poses to measure.
        kind: What will be measured: pose if left out.
        criterion: test-poses: be accurate at the poses of --at, which is the default with --at.
        at: CSV of joints or tool poses where accuracy matters.
        frames: fitted: base and tool will be fitted too; known: the arm's own parameters alone.
        candidates: Number of random poses to choose from; 2000 if left out.
        pool: Choose from the poses of this file (CSV of joints or tool poses) instead.
        like: Plan more poses like those of this first measurement, of any kind (touches, wire, pictures, …).
        columns: Column description of the file of --like or --from; pickenv's own if left out.
        noise_mm: Expected standard deviation of one measured position coordinate, mm.
        fit: What will be fitted, with the values of `pickenv calibrate`.
        tolerances: Tolerance class of the arm's parts, by name or file.
        prior_scale: Factor on the class's tolerances: below 1 for parts that are made better.
        curve: Print the expected result of half to eight times --n poses.
        seed: Seed of candidates and exchange.
        out: Write the joints in measuring order (.csv).
        json_file: Write the results to this file.

    Examples:
        pickenv plan-poses --arm ur5e --n 40 --out poses.csv

    More: calibrating-a-robot.md
    """
    from pickenv.calibration.model.measurements import POSITION_STD
    from pickenv.calibration.model.noise_and_priors import prior_model
    from pickenv.calibration.planning.like import plan_like
    from pickenv.calibration.reading.read import joints_of

    separate({"--at": at, "--arm": arm, "--from": pool, "--like": like}, {"--out": out, "--json": json_file})
    robot = pickenv.load_arm(arm)
    if columns is not None and pool is None and like is None:
        raise InputError("--columns describes the file of --like or --from; give that too")
    if candidates is not None and pool is not None:
        raise InputError("--candidates are drawn at random, but --from gives the poses to choose from; leave one out")
    if fit == "full" and (tolerances is not None or prior_scale != 1.0):
        raise InputError("--fit full expects nothing of the parts; leave out --tolerances and --prior-scale")
    test_joints = None if at is None else joints_of(pickenv.calibration.read_targets(at, robot.nominal), robot.nominal)
    rng = np.random.default_rng(seed)
    registered, parts = frames == "known", tolerances or robot.tolerance_class
    prior = prior_model(robot.name, robot.nominal, known=registered, fit=fit, tolerances=parts, scale=prior_scale)
    how: dict[str, Any] = {"criterion": criterion, "test_joints": test_joints, "curve": curve}
    how["candidates"], lines = candidates or 2000, None
    if pool is not None:
        how["candidates"], lines = pickenv.calibration.pool_of(pool, robot.nominal, columns if like is None else None)
    if like is not None:
        if kind is not None or noise_mm is not None or registered:
            raise InputError("--like says what is measured and how well; leave out --kind, --noise-mm and --frames")
        first = pickenv.calibration.given_rows(pickenv.calibration.given_arm(robot, columns), like, columns)
        planned = plan_like(robot, first, n, rng, lines=lines, prior=prior if prior.proper else None, **how)
    else:
        how |= {"kind": kind or "pose", "position_std": POSITION_STD if noise_mm is None else noise_mm * 1e-3}
        planned = pickenv.calibration.plan_poses(robot, prior if prior.proper else prior.parameters, n, rng, **how)
        if lines is not None:
            planned = replace(planned, lines=lines[planned.chosen])
    table = partial(planned.write_csv, prismatic=robot.nominal.prismatic)
    deliver([(out, table), (json_file, planned.as_dict())], planned.report())


def verify(
    calibration: Path,
    files: list[Path],
    columns: str | None = None,
    refit: str | None = None,
    refit_rows: Annotated[int | None, Option(min=3)] = None,
    json_file: Annotated[Path | None, Option("--json")] = None,
) -> None:
    """Judge an old calibration on new rows: is it better than nominal, as good as promised, and used within its data?

    Verdicts: still good, no better than nominal, worse than nominal, drifted, outside what was measured, another
    station, another arm.

    The verdict comes first; unless it is "still good" the exit code is 3. It is 3 too if the calibration's own verdict
    is "do not use".

    Args:
        calibration: Calibration file (.npz).
        files: New poses or positions of the same robot.
        columns: Column description, by name or path; pickenv's own if left out.
        refit: Fit base, tool or base,tool again before judging, because the instrument or its target was moved. Both
            are always fitted again for a whole robot.
        refit_rows: Number of new rows to fit base and tool from; all other rows judge. 6 if left out.
        json_file: Write the results to this file.

    Examples:
        pickenv verify my_arm.npz new_poses.csv --refit base

    More: calibrating-a-robot.md
    """
    from pickenv.calibration.pipeline.verification import frames_and_rows, verify as verified

    separate({"CALIBRATION": calibration, "FILES": files, "--columns": columns}, {"--json": json_file})
    old = pickenv.Calibration.load(calibration, whole=True)
    data = pickenv.calibration.read_observations(files, old.arm, columns)
    verdict = verified(old, data, *frames_and_rows(refit, refit_rows))
    good = verdict.status == "still good" and verdict.reservation is None
    shipped = old.arm_name in pickenv.arm.shipped_arms()
    same = shipped and pickenv.load_arm(old.arm_name).fingerprint() == old.arm_fingerprint
    arm = old.arm_name if same else "ARM"
    if old.arm.tree is not None:
        arm = f"ROBOT.urdf#{','.join(old.arm.tree.names)}"
    step = next_step(arm, calibration, not good)
    if verdict.status == "another station":
        rows: list[Any] = files if verdict.since is None else ["THOSE_ROWS"]
        again = command_line("pickenv", "verify", calibration, *rows, columns=columns, refit="base,tool")
        step = f"find base and tool anew: {again}"
    deliver([(json_file, verdict.as_dict())], verdict.text(), step)
    if not good:
        raise typer.Exit(NOT_GOOD)


def apply(
    calibration: Path,
    targets: Path,
    arm: Annotated[str, Option()],
    out: Path = Path("commands.csv"),
    frame: Literal["controller", "instrument"] = "controller",
    payload_kg: Annotated[float | None, Option(callback=limited("payload_kg"))] = None,
    temperature_k: Annotated[float | None, Option(callback=limited("temperature_K"))] = None,
    unit: str | None = None,
    allow: list[str] | None = None,
) -> None:
    """Convert nominal joint or pose targets to corrected joint commands, with the expected error and its uncertainty.

    If a target cannot be reached, its command stays empty, and the exit code is 3.

    Args:
        calibration: Calibration file (.npz).
        targets: CSV of joint targets (q1_deg, …) or tool poses (x_mm … rz_deg).
        arm: Arm name or file ({arm_format}).
        out: Write the corrected commands (.csv).
        frame: Frame of targets that are tool poses; instrument: the frame in which the calibration was measured.
        payload_kg: Mass held at the tool, kg, if the calibration needs it.
        temperature_k: Temperature rise above the reference, K, if the calibration needs it.
        unit: Serial number of the robot, which must be the calibration's.
        allow: Use the calibration in spite of this reservation: do-not-use.

    Examples:
        pickenv apply my_arm.npz targets.csv --arm ur5e --out commands.csv

    More: applying-a-calibration.md
    """
    from pickenv.calibration.model.arm_model import Conditions

    separate({"CALIBRATION": calibration, "TARGETS": targets, "--arm": arm}, {"--out": out})
    robot = pickenv.load_arm(arm)
    loaded = pickenv.Calibration.load(calibration, robot, unit)
    obey(loaded.reservations(), allow or (), (DO_NOT_USE,))
    conditions = Conditions(*(None if value is None else np.array(value) for value in (payload_kg, temperature_k)))
    goals = pickenv.calibration.read_targets(targets, robot.nominal)
    commands = pickenv.calibration.apply_calibration(loaded, robot, goals, frame=frame, conditions=conditions)
    deliver([(out, commands.write_csv)], commands.report())
    if not commands.reached.all():
        raise typer.Exit(NOT_GOOD)


def export(
    calibration: Path,
    out: Annotated[Path, Option()],
    kind: Annotated[str | None, Option("--as")] = None,
    onto: str | None = None,
    arm: str | None = None,
    counts_per_turn: Annotated[int | None, Option(min=1)] = None,
    sample: Annotated[int, Option(min=0, max=10000)] = 0,
    seed: Annotated[int, Option(min=0)] = 0,
    json_file: Annotated[Path | None, Option("--json")] = None,
    unit: str | None = None,
    allow: list[str] | None = None,
) -> None:
    """Write the calibration into the robot's own files, for its controller, or for other programs.

    Args:
        calibration: Calibration file (.npz).
        out: File to write.
        kind: {exporter}; inferred from the file's name if left out.
        onto: The robot's own file (URDF, kinematics YAML, LeRobot JSON, …), corrected in place and written to --out;
            robot.urdf#link names the tip.
        arm: Arm name or arm file, if it is not a shipped arm.
        counts_per_turn: Encoder counts per turn, for --as offsets.
        sample: With --as mjcf: number of further files (…_1, …_2 and so on) with arms drawn from the posterior.
        seed: Seed of --sample.
        json_file: Write the names of the files written, and the notes about them, to this file.
        unit: Serial number of the robot, which must be the calibration's.
        allow: Use the calibration in spite of this reservation: do-not-use.

    Examples:
        pickenv export my_arm.npz --onto robot.urdf --out robot_calibrated.urdf

    More: applying-a-calibration.md
    """
    from pickenv.calibration.delivery.onto_files import mjcf_files

    new_mjcf = onto is None and (kind == "mjcf" or (out.suffix == ".xml" and kind is None))
    files = mjcf_files(out, sample) if new_mjcf else out
    separate({"CALIBRATION": calibration, "--arm": arm, "--onto": onto}, {"--out": files, "--json": json_file})
    robot = None if arm is None else pickenv.load_arm(arm, whole=True)
    loaded = pickenv.Calibration.load(calibration, robot, unit, whole=True)
    obey(loaded.reservations(), allow or (), (DO_NOT_USE,))
    done = pickenv.calibration.export(
        loaded, out, kind=kind, onto=onto, arm=robot, counts_per_turn=counts_per_turn, sample=sample, seed=seed
    )
    written = [done.path, *done.beside]
    content = {"files": list(map(str, written)), "notes": list(done.notes)}
    deliver([(out, lambda _: written), (json_file, content)], "\n".join(done.notes))


def twin(
    calibration: Path,
    out: Path = Path("my_arm.npz"),
    arm: str | None = None,
    rows: list[Path] | None = None,
    columns: str | None = None,
    seed: Annotated[int, Option(min=0)] = 0,
    json_file: Annotated[Path | None, Option("--json")] = None,
    unit: str | None = None,
    allow: list[str] | None = None,
) -> None:
    """Make a plant (a simulated true arm) from a calibration; further arms can be drawn from the fit's posterior.

    Environments take the file as plant="my_arm.npz"; with arms="per_episode" each episode draws another arm.

    Args:
        calibration: Calibration file (.npz).
        out: Write the plant (.npz).
        arm: Arm name or arm file; the arm named in the calibration if left out.
        rows: Poses or positions that the calibration was fitted to. They are needed if its learnt residual is not a
            Gaussian process, and not used if it is one.
        columns: Column description of --rows; pickenv's own if left out.
        seed: Seed of the random waves that represent the residual.
        json_file: Write the plant's summary and notes to this file.
        unit: Serial number of the robot, which must be the calibration's.
        allow: Use the calibration in spite of this reservation: do-not-use.

    Examples:
        pickenv twin my_arm.npz --out twin.npz

    More: twin.md
    """
    if columns is not None and rows is None:
        raise InputError("--columns describes the files of --rows; give those too")
    path = npz_path(out)
    separate({"CALIBRATION": calibration, "--arm": arm, "--rows": rows or []}, {"--out": path, "--json": json_file})
    loaded = pickenv.Calibration.load(calibration, None, unit)
    robot = pickenv.load_arm(arm or loaded.arm_name)
    obey(loaded.reservations(), allow or (), (DO_NOT_USE,))
    if seed and not rows and loaded.learnt is None:
        raise InputError("without a residual --seed draws no waves; give --rows too, or leave --seed out")
    data = None if not rows else pickenv.calibration.read_observations(rows, robot.nominal, columns)
    if data is not None and not isinstance(data, pickenv.calibration.Measurements):
        raise InputError(f"--rows holds {data.kind}, not poses or positions; leave it out")
    plant = pickenv.calibration.twin(loaded, robot, data, name=path.stem, seed=seed)
    assert plant.posterior is not None
    posterior = plant.posterior
    count, unseen, notes = posterior.factor.shape[1], len(posterior.unseen), list(posterior.notes)
    content = {"name": plant.name, "arm": robot.name, "parameters": count, "not_identified": unseen, "notes": notes}
    head = f"{plant.name}: {count} parameters of arm '{robot.name}' as found, {unseen} that were not identified"
    lines = [head, *(f"  {note}" for note in notes)]
    deliver([(path, lambda file: pickenv.arm.write_twin(plant, file)), (json_file, content)], "\n".join(lines))
