"""Commands around a calibration: a board and poses before it; verify, apply, export and twin after it."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import typer
from typer import Argument, Option

from pickenv.base import DO_NOT_USE, InputError, check_limit, npz_path, obey, separate
from pickenv.commands.showing import deliver

ARM = Option(help="Arm name or file ({arm_format}).")
UNIT = Option(help="Serial number of the robot, which must be the calibration's.")
ALLOW = Option(help="Use the calibration in spite of this reservation: do-not-use.")
NOT_GOOD = 3
"""Exit code where targets cannot be reached, and where an old calibration is not what it was."""

CALIBRATION = Argument(help="Calibration file (.npz).")


def board(
    file: Annotated[
        str,
        Argument(help="Board file (.toml, or a description with [board]), or charuco_a4, chessboard_a4, apriltags_a4."),
    ],
    out: Annotated[Path, Option(help="Write the page to this file (.pdf, .svg).")] = Path("board.pdf"),
) -> None:
    """Print a calibration board to true scale, with a rule to check the printer by."""
    from pickenv.calibration.camera.boards import load_board, write_board

    separate({"FILE": file}, {"--out": out})
    page = load_board(file)
    width, height = page.size
    text = f"{page.title}: {1e3 * width:g} x {1e3 * height:g} mm. Print at 100 %, glue it onto something flat, and "
    deliver([(out, lambda path: write_board(page, path))], f"{text}measure the rule below it")


def plan_poses(
    arm: Annotated[str, ARM],
    n: Annotated[int, Option("--n", help="Poses to measure.", min=1)] = 30,
    kind: Annotated[Literal["pose", "position"] | None, Option(help="What will be measured: pose if left out.")] = None,
    criterion: Annotated[
        Literal["d-optimal", "test-poses"] | None,
        Option(help="test-poses: to be accurate at the poses of --at, as is the default with --at."),
    ] = None,
    at: Annotated[Path | None, Option(help="CSV of joints or tool poses where accuracy matters.")] = None,
    frames: Annotated[
        Literal["fitted", "known"],
        Option(help="fitted: base and tool will be fitted too; known: the arm's own parameters alone."),
    ] = "fitted",
    candidates: Annotated[int, Option(help="Poses to choose from.", min=10)] = 2000,
    pool: Annotated[
        Path | None, Option("--from", help="Choose from the poses of this file (CSV of joints or tool poses) instead.")
    ] = None,
    like: Annotated[
        Path | None,
        Option(help="Plan more poses like those of this first measurement, of any kind (touches, wire, pictures, …)."),
    ] = None,
    columns: Annotated[
        str | None, Option(help="Column description of the file of --like or --from; ours if left out.")
    ] = None,
    noise_mm: Annotated[float | None, Option(help="What one position coordinate will scatter by.")] = None,
    fit: Annotated[
        Literal["auto", "offsets", "full"], Option(help="What will be fitted, as `pickenv calibrate` says it.")
    ] = "auto",
    tolerances: Annotated[str | None, Option(help="Tolerance class that parts are made to, by name or file.")] = None,
    prior_scale: Annotated[
        float, Option(help="Factor on the class: how much better or worse parts are made.", min=1e-3, max=1e3)
    ] = 1.0,
    curve: Annotated[bool, Option("--curve", help="Say what half to eight times --n would bring.")] = False,
    seed: Annotated[int, Option(help="Seed of candidates and exchange.", min=0)] = 0,
    out: Annotated[Path | None, Option(help="Write the joints in measuring order (.csv).")] = None,
    json_file: Annotated[Path | None, Option("--json", help="Write the figures to this file.")] = None,
) -> None:
    """Choose poses to measure that tell the most about an arm, within its joint limits, ordered for short travel."""
    from pickenv.arm import load_arm
    from pickenv.calibration import given_arm, given_rows, plan_poses as plan, pool_of, read_targets
    from pickenv.calibration.model.measurements import POSITION_STD
    from pickenv.calibration.model.prior import prior_model
    from pickenv.calibration.planning.like import plan_like
    from pickenv.calibration.reading.read import joints_of

    separate({"--at": at, "--arm": arm, "--from": pool, "--like": like}, {"--out": out, "--json": json_file})
    robot = load_arm(arm)
    if columns is not None and pool is None and like is None:
        raise InputError("--columns describes the file of --like or --from; give that too")
    if noise_mm is not None:
        check_limit("--noise-mm", noise_mm, "scatter_mm")
    test_joints = None if at is None else joints_of(read_targets(at, robot.nominal), robot.nominal)
    rng = np.random.default_rng(seed)
    prior = prior_model(
        robot.name,
        robot.nominal,
        known=frames == "known",
        fit=fit,
        tolerances=tolerances or robot.tolerance_class,
        scale=prior_scale,
    )
    if like is not None:
        if kind is not None or noise_mm is not None or frames == "known":
            raise InputError("--like says what is measured and how well; leave out --kind, --noise-mm and --frames")
        first, _ = given_rows(given_arm(robot, columns), like, columns)
        joints, lines = (candidates, None) if pool is None else pool_of(pool, robot.nominal)
        planned = plan_like(
            robot,
            first,
            n,
            rng,
            candidates=joints,
            lines=lines,
            criterion=criterion,
            test_joints=test_joints,
            curve=curve,
            prior=prior if prior.proper else None,
        )
    else:
        joints, lines = (candidates, None) if pool is None else pool_of(pool, robot.nominal, columns)
        planned = plan(
            robot,
            prior if prior.proper else prior.parameters,
            n,
            rng,
            candidates=joints,
            kind=kind or "pose",
            criterion=criterion,
            test_joints=test_joints,
            position_std=POSITION_STD if noise_mm is None else noise_mm * 1e-3,
            curve=curve,
        )
        if lines is not None:
            planned = replace(planned, lines=lines[planned.chosen])
    table = partial(planned.write_csv, prismatic=robot.nominal.prismatic)
    deliver([(out, table), (json_file, planned.as_dict())], planned.report())


def verify(
    calibration: Annotated[Path, Argument(help="Calibration file (.npz).")],
    files: Annotated[list[Path], Argument(help="New poses or positions of the same robot.")],
    columns: Annotated[str | None, Option(help="Column description, by name or path; ours if left out.")] = None,
    refit: Annotated[
        str | None, Option(help="Find base, tool or base,tool anew first: the instrument or its target was moved.")
    ] = None,
    refit_rows: Annotated[
        int | None, Option(help="Rows to find them from; the others judge. 6 if left out.", min=3)
    ] = None,
    json_file: Annotated[Path | None, Option("--json", help="Write the figures to this file.")] = None,
) -> None:
    """Judge an old calibration on new rows: does it beat the nominal arm, is it as good as promised, was this measured?

    Still good, worse than nominal, drifted, outside what was measured, another station or another arm.

    The verdict comes first; unless it is "still good" the exit code is 3.
    """
    from pickenv.calibration import Calibration, read_observations
    from pickenv.calibration.pipeline.verification import frames_and_rows, verify as verified

    separate({"CALIBRATION": calibration, "FILES": files, "--columns": columns}, {"--json": json_file})
    old = Calibration.load(calibration)
    data = read_observations(files, old.arm, columns).observations
    verdict = verified(old, data, *frames_and_rows(refit, refit_rows))
    deliver([(json_file, verdict.as_dict())], verdict.text())
    if verdict.status != "still good":
        raise typer.Exit(NOT_GOOD)


def apply(
    calibration: Annotated[Path, CALIBRATION],
    targets: Annotated[Path, Argument(help="CSV of joint targets (q1_deg, …) or tool poses (x_mm … rz_deg).")],
    arm: Annotated[str, ARM],
    out: Annotated[Path, Option(help="Write the corrected commands (.csv).")] = Path("commands.csv"),
    frame: Annotated[
        Literal["controller", "instrument"],
        Option(help="Frame of pose targets; instrument: where the calibration was measured."),
    ] = "controller",
    payload_kg: Annotated[float | None, Option(help="Mass held, where the calibration asks for it.")] = None,
    temperature_k: Annotated[float | None, Option(help="Temperature rise above the reference, likewise.")] = None,
    unit: Annotated[str | None, UNIT] = None,
    allow: Annotated[list[str] | None, ALLOW] = None,
) -> None:
    """Turn nominal joint or pose targets into corrected joint commands, with the error and uncertainty to expect.

    Where a target cannot be reached its command stays empty, and the exit code is 3.
    """
    from pickenv.arm import load_arm
    from pickenv.calibration import Calibration, apply_calibration, read_targets
    from pickenv.calibration.model.arm_model import Conditions

    separate({"CALIBRATION": calibration, "TARGETS": targets, "--arm": arm}, {"--out": out})
    limits = {"--payload-kg": (payload_kg, "payload_kg"), "--temperature-k": (temperature_k, "temperature_K")}
    for option, (value, quantity) in limits.items():
        if value is not None:
            check_limit(option, value, quantity)
    robot = load_arm(arm)
    loaded = Calibration.load(calibration, robot, unit)
    obey(loaded.reservations(), allow or (), (DO_NOT_USE,))
    conditions = Conditions(
        payload=None if payload_kg is None else np.array(payload_kg),
        temperature=None if temperature_k is None else np.array(temperature_k),
    )
    commands = apply_calibration(
        loaded, robot, read_targets(targets, robot.nominal), frame=frame, conditions=conditions
    )
    deliver([(out, commands.write_csv)], commands.report())
    if not commands.reached.all():
        raise typer.Exit(NOT_GOOD)


def export(
    calibration: Annotated[Path, CALIBRATION],
    out: Annotated[Path, Option(help="File to write.")],
    kind: Annotated[str | None, Option("--as", help="{exporter}; told by the file's name if left out.")] = None,
    onto: Annotated[
        str | None,
        Option(
            help="The robot's own file (URDF, kinematics YAML, LeRobot JSON, …), corrected in place and written to "
            "--out; robot.urdf#link names the tip."
        ),
    ] = None,
    arm: Annotated[str | None, Option(help="Arm name or arm file, if no shipped one.")] = None,
    counts_per_turn: Annotated[int | None, Option(help="Encoder counts per turn, for --as offsets.", min=1)] = None,
    sample: Annotated[
        int, Option(help="With --as mjcf: so many arms that the data allow, …_1 and on.", min=0, max=10_000)
    ] = 0,
    seed: Annotated[int, Option(help="Seed of --sample.", min=0)] = 0,
    json_file: Annotated[Path | None, Option("--json", help="Write what was said of the file to this one.")] = None,
    unit: Annotated[str | None, UNIT] = None,
    allow: Annotated[list[str] | None, ALLOW] = None,
) -> None:
    """Hand the calibration over to the robot's own files, its controller, or other programs."""
    from pickenv.arm import load_arm
    from pickenv.calibration import Calibration, export as exported
    from pickenv.calibration.delivery.onto_files import mjcf_files

    files = (
        mjcf_files(out, sample) if onto is None and (kind == "mjcf" or (out.suffix == ".xml" and kind is None)) else out
    )
    separate({"CALIBRATION": calibration, "--arm": arm, "--onto": onto}, {"--out": files, "--json": json_file})
    robot = None if arm is None else load_arm(arm)
    loaded = Calibration.load(calibration, robot, unit)
    obey(loaded.reservations(), allow or (), (DO_NOT_USE,))
    done = exported(
        loaded, out, kind=kind, onto=onto, arm=robot, counts_per_turn=counts_per_turn, sample=sample, seed=seed
    )
    written = [str(path) for path in (done.path, *done.beside)]
    lines = [*done.notes, *(f"wrote {path}" for path in written)]
    deliver([(json_file, {"files": written, "notes": list(done.notes)})], "\n".join(lines))


def twin(
    calibration: Annotated[Path, CALIBRATION],
    out: Annotated[Path, Option(help="Write the plant (.npz).")] = Path("my_arm.npz"),
    arm: Annotated[str | None, Option(help="Arm name or arm file; by its name in the calibration if left out.")] = None,
    rows: Annotated[
        list[Path] | None, Option(help="Poses or positions that it was fitted to, where it has no Gaussian process.")
    ] = None,
    columns: Annotated[str | None, Option(help="Column description of --rows; ours if left out.")] = None,
    seed: Annotated[int, Option(help="Seed of the residual's waves.", min=0)] = 0,
    json_file: Annotated[Path | None, Option("--json", help="Write what was said of the plant to this file.")] = None,
    unit: Annotated[str | None, UNIT] = None,
    allow: Annotated[list[str] | None, ALLOW] = None,
) -> None:
    """Make a plant from a calibration: its truth is the arm found, and its arms are drawn from what the data allow.

    Environments take it as plant="my_arm.npz"; with arms="per_episode" each episode has another of its arms.
    """
    from pickenv.arm import load_arm, write_twin
    from pickenv.calibration import Calibration, Measurements, read_observations, twin as as_plant

    if columns is not None and rows is None:
        raise InputError("--columns describes the files of --rows; give those too")
    path = npz_path(out)
    separate({"CALIBRATION": calibration, "--arm": arm, "--rows": rows or []}, {"--out": path, "--json": json_file})
    loaded = Calibration.load(calibration, None, unit)
    robot = load_arm(arm or loaded.arm_name)
    obey(loaded.reservations(), allow or (), (DO_NOT_USE,))
    data = None if not rows else read_observations(rows, robot.nominal, columns).observations
    if data is not None and not isinstance(data, Measurements):
        raise InputError(f"--rows holds {data.kind}, not poses or positions; leave it out")
    plant = as_plant(loaded, robot, data, name=path.stem, seed=seed)
    assert plant.posterior is not None
    posterior = plant.posterior
    content: dict[str, Any] = {
        "name": plant.name,
        "arm": robot.name,
        "parameters": posterior.factor.shape[1],
        "not_identified": len(posterior.unseen),
        "notes": list(posterior.notes),
    }
    head = f"{plant.name}: {content['parameters']} parameters of arm '{robot.name}' as found, "
    lines = [f"{head}{content['not_identified']} that were not identified", *(f"  {note}" for note in posterior.notes)]
    deliver([(path, lambda file: write_twin(plant, file)), (json_file, content)], "\n".join(lines))
