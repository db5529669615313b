"""`pickenv calibrate`: from measured files of any kind to a calibrated arm, judged on rows it never saw."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from pickenv.errors import InputError


def calibrate(
    files: Annotated[
        list[Path], typer.Argument(help="Files of measurements (CSV or YAML), all of one layout.", show_default=False)
    ],
    arm: Annotated[str, typer.Option(help="Arm name, arm file (.toml) or URDF (file.urdf#tip).", show_default=False)],
    columns: Annotated[str | None, typer.Option(help="Column description, by name or path; ours if left out.")] = None,
    test_rows: Annotated[int | None, typer.Option(help="Rows to hold out; a fifth if left out.", min=1)] = None,
    split: Annotated[str, typer.Option(help="How rows are held out: random or blocked.")] = "random",
    seed: Annotated[int, typer.Option(help="Seed of everything random.", min=0)] = 0,
    test: Annotated[list[Path] | None, typer.Option(help="Held-out rows from other files instead.")] = None,
    terms: Annotated[
        str, typer.Option(help="Parametric terms: auto, none, or gravity, periodic, thermal joined by +.")
    ] = "auto",
    residual: Annotated[str, typer.Option(help="Residual model: auto, none, bpnn, rbf, gp, trees or blend.")] = "auto",
    force: Annotated[
        bool, typer.Option("--force", help="Use the named residual model even if it does not win.")
    ] = False,
    robust: Annotated[bool, typer.Option("--robust", help="Leave gross outliers out and list them.")] = False,
    json_file: Annotated[Path | None, typer.Option("--json", help="Write the figures to this file.")] = None,
    out: Annotated[Path | None, typer.Option(help="Write the fitted calibration to this file (.npz).")] = None,
    report: Annotated[Path | None, typer.Option(help="Write a one-page report (.html).")] = None,
    run: Annotated[
        Path | None,
        typer.Option(help="Run folder: calibration, report, and what `pickenv figures` draws."),
    ] = None,
) -> None:
    """Identify a real arm from measurements of any kind, base and tool included, and judge it on held-out rows."""
    import numpy as np

    from calibration.columns import read_observations
    from calibration.held_out import Choices, judge
    from calibration.observations import PoseObservations
    from calibration.rows import choose, select
    from calibration.uncertainty import with_uncertainty
    from pickenv.arm import load_arm
    from pickenv.commands.calibrations import write_run
    from pickenv.files import write_text
    from pickenv.inspect.calibration_report import gather, write_calibration_report

    chosen = load_arm(arm)
    reading = read_observations(files, chosen.nominal, columns)
    train = reading.observations
    if test:
        held_out = read_observations(test, chosen.nominal, columns).observations
    else:
        train_rows, held_rows = choose(train, split, test_rows, np.random.default_rng(seed))
        train, held_out = select(train, np.sort(train_rows)), select(train, np.sort(held_rows))
    poses = train.measurements if isinstance(train, PoseObservations) else None
    held_poses = held_out.measurements if isinstance(held_out, PoseObservations) else None
    for option, path in (("--report", report), ("--run", run)):
        if path is not None and (poses is None or held_poses is None):
            raise InputError(f"{option} shows poses and positions, but {train.source} holds {train.kind}; leave it out")
    choices = Choices(terms=terms, residual=residual, force=force, robust=robust, seed=seed)
    judged = replace(judge(chosen, train, held_out, choices), floor=reading.floor)
    print(judged.report())
    if out is not None:
        found = judged.fit
        calibration = found.calibration
        if held_poses is not None:
            calibration = with_uncertainty(calibration, found.identification, held_poses)
        print(f"wrote {calibration.save(out)}")
    if (report is not None or run is not None) and poses is not None and held_poses is not None:
        gate = None if judged.gate is None else judged.gate.as_dict()
        seeds = {"split": split, "seed": seed, "held-out rows": len(held_poses)}
        evidence = gather(chosen, judged.fit, poses, held_poses, gate)
        if report is not None:
            print(f"wrote {write_calibration_report(report, evidence, seeds)}")
        if run is not None:
            options = {"columns": columns, "test-rows": test_rows, "split": split, "seed": seed, "terms": terms}
            options |= {"residual": residual, "force": force or None, "robust": robust or None}
            for path in write_run(run, _command(files, arm, test or [], options), seed, evidence, judged, seeds):
                print(f"wrote {path}")
    if json_file is not None:
        print(f"wrote {write_text(json_file, json.dumps(judged.as_dict(), indent=2) + chr(10))}")


def _command(files: list[Path], arm: str, test: list[Path], options: dict[str, Any]) -> str:
    """The command line that makes the same calibration; options that are None were not given."""
    words = ["pickenv calibrate", *map(str, files), "--arm", arm, *(f"--test {path}" for path in test)]
    words += [
        f"--{key}" if value is True else f"--{key} {value}" for key, value in options.items() if value is not None
    ]
    return " ".join(words)
