"""`pickenv bench`: benchmarks of calibrations on measured robots, and of policies on simulated arms."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

import typer
from typer import Option

from pickenv.base import locked, require, separate
from pickenv.commands.showing import CommandOfNames, check_workers, deliver, print_table, progress_bars

bench = typer.Typer(
    name="bench", help="Benchmarks: calibrations on measured robots, policies on simulated ones.", no_args_is_help=True
)


@bench.command(cls=CommandOfNames)
def calibration(
    json_file: Annotated[Path | None, Option("--json")] = None,
    out: Path = Path("runs/bench"),
    only: list[str] | None = None,
    quick: Annotated[bool, Option("--quick")] = False,
    data: Annotated[Path, Option(envvar="PICKENV_DATA")] = Path("../shared/data"),
    draws: Annotated[int | None, Option(min=1)] = None,
    seed: Annotated[int, Option(min=0)] = 0,
    workers: Annotated[int, Option(min=1)] = 1,
) -> None:
    """Calibrate measured robots, and compare errors on held-out rows with predictions by twins of the fitted rows.

    Args:
        json_file: Write the rows to this file.
        out: Folder for tables and finished work; an interrupted run continues.
        only: Compute only these rows; an unknown name prints all names.
        quick: The UR5 alone, on few rows: a minute.
        data: Folder of the measured data sets.
        draws: Number of arms drawn from each twin; 2 if left out.
        seed: Seed of all random numbers.
        workers: Number of processes; it does not change the results.
    """
    from datetime import date

    from pickenv.experiments import robot_tables as tables
    from pickenv.experiments.robots import QUICK, ROWS, BenchSettings, run_bench
    from pickenv.inspect.runs.run_folder import listed_files

    blocked = out / tables.BLOCKED_FILE
    shown = [out / name for name in (tables.GAINS_FILE, tables.ROBOTS_FILE)]
    separate({}, {"--out": [blocked, *shown], "--json": json_file})
    require("torch", "pyarrow", *(["joblib"] if workers > 1 else []))
    settings = BenchSettings.quick() if quick else BenchSettings()
    settings = replace(settings, draws=draws or settings.draws, seed=seed)
    names = list(dict.fromkeys(only or (QUICK if quick else ROWS)))

    def show() -> None:
        if gains:
            cells, words = tables.gain_cells(gains, settings.folds), tables.GAIN_HEADS[:3]
            print_table("Gains predicted and measured", tables.GAIN_HEADS, cells, words=words)
            print(tables.agreement_words(gains, settings))
        if len(models):
            cells, heads = tables.spread_cells(models), tables.SPREAD_HEADS
            print_table("Geometry and the best model", heads, cells, words=heads, caption=tables.NOTE)
        for name, reason in skipped.items():
            print(f"not made: {name}: {reason}")

    with locked(out), listed_files(out):
        with progress_bars() as report:
            gains, models, skipped = run_bench(names, settings, data, out, workers=workers, progress=report)
        measured_gains = tables.blocked_json(gains, settings.folds, date.today().isoformat())
        files = [(out / name, text) for name, text in tables.csv_files(gains, models, settings.folds).items()]
        content = tables.bench_json(settings, gains, models, skipped)
        deliver([*files, (blocked, measured_gains), (json_file, content)], show)


@bench.command(cls=CommandOfNames)
def policies(
    policy: list[str] | None = None,
    json_file: Annotated[Path | None, Option("--json")] = None,
    out: Path = Path("runs/policies"),
    plant: list[str] | None = None,
    rung: list[str] | None = None,
    arms: Annotated[int | None, Option(min=1)] = None,
    episodes: Annotated[int | None, Option(min=1)] = None,
    canopies: Annotated[int | None, Option(min=0)] = None,
    split: Literal["test", "train"] | None = None,
    seed: Annotated[int, Option(min=0)] = 0,
    seeds: int = 5,
    trainings: Annotated[int | None, Option(min=0)] = None,
    learned: list[str] | None = None,
    quick: Annotated[bool, Option("--quick")] = False,
    executor: Literal["serial", "joblib"] = "serial",
    workers: Annotated[int | None, Option(min=1)] = None,
) -> None:
    """Compare policies, raw and calibrated, at fixed difficulties (rungs), with other arms per seed; count picks too.

    Args:
        policy: Further policy: a file of `pickenv train` (.npz), or of SB3 (.zip) or Python, whose code is executed.
        json_file: Write the rows to this file.
        out: Folder for the table and finished work; an interrupted run continues.
        plant: Plant preset in place of the rungs; may be repeated.
        rung: Rung (difficulty) with its own arms for judging; all if left out; may be repeated.
        arms: Number of arms drawn for each seed.
        episodes: Number of fruit per arm.
        canopies: Number of canopies for each arm of the picking task; 0 leaves the task out.
        split: A rung's arms to judge on: test, or train for tuning and for checking these results; test if left out.
        seed: The first seed.
        seeds: Number of seeds; at least 5.
        trainings: Number of trainings of each learned policy, made first; 5 if left out. Their seeds begin at --seed.
        learned: Learned policy of the leaderboard to train, and to compare with the oracle alone; may be repeated.
        quick: Three policies on one arm per seed: a minute.
        executor: serial: in this process; joblib: in several processes, with the same results.
        workers: Number of processes; one per core if left out.
    """
    from pickenv.experiments import policy_tables
    from pickenv.inspect.colours import policy_label
    from pickenv.inspect.runs.run_folder import listed_files

    check_workers(workers, executor != "serial", "joblib")
    page = out / "leaderboard.md"
    separate({"--policy": policy}, {"--out": [page], "--json": json_file})
    require("torch", "pyarrow", *(["joblib"] if executor == "joblib" else []))
    plants = (*(plant or ()), *policy_tables.rungs(rung or ()))
    usual = policy_tables.QUICK if quick else policy_tables.LEADERBOARD
    settings = replace(
        usual,
        policies=(*(("oracle",) if learned else usual.policies), *dict.fromkeys(policy or [])),
        plants=plants or usual.plants,
        seeds=tuple(range(seed, seed + seeds)),
        split=split,
        arms=arms or usual.arms,
        episodes=episodes or usual.episodes,
        canopies=usual.canopies if canopies is None else canopies,
    )

    def show() -> None:
        heads, cells = policy_tables.leaderboard_summary(board)
        behind = policy_label(settings.compensations[-1])
        print_table(f"Mean error (mm), raw / behind {behind}", heads, cells, words=heads[:2])

    with locked(out), listed_files(out):
        with progress_bars() as report:
            backend = "loky" if executor == "joblib" else executor
            count = (0 if quick else 5) if trainings is None else trainings
            how: dict[str, Any] = {"backend": backend, "workers": workers, "progress": report}
            board = policy_tables.run_leaderboard(settings, out, count, learned or (), **how)
        own = "put a policy of yours beside them: the same command with --policy FILE"
        deliver([(page, policy_tables.leaderboard_page(board)), (json_file, board)], show, own)
