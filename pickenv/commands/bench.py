"""`pickenv bench`: measured robots, beside what was predicted; policies, by their errors."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

import typer
from typer import Option

from pickenv.base import locked, require, separate
from pickenv.commands.showing import CommandOfNames, deliver, print_table, progress_bars

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
    seed: Annotated[int, Option(min=0)] = 0,
    workers: Annotated[int, Option(min=1)] = 1,
) -> None:
    """What calibrations leave of every measured robot, and what twins of other rows predicted.

    Args:
        json_file: Write the rows to this file.
        out: Folder for tables and what is done; a run that was cut off goes on.
        only: Only these rows; a wrong name lists them all.
        quick: The UR5 alone, on few rows: a minute.
        data: Folder of the measured data sets.
        seed: Seed of everything random.
        workers: Processes; they do not change the figures.
    """
    from datetime import date

    from pickenv.experiments import robot_tables as tables
    from pickenv.experiments.robots import QUICK, ROWS, BenchSettings, run_bench
    from pickenv.inspect.runs.run_folder import listed_files

    blocked = out / tables.BLOCKED_FILE
    shown = [out / name for name in (tables.GAINS_FILE, tables.ROBOTS_FILE)]
    separate({}, {"--out": [blocked, *shown], "--json": json_file})
    require("torch", "pyarrow", *(["joblib"] if workers > 1 else []))
    settings = replace(BenchSettings.quick() if quick else BenchSettings(), seed=seed)
    names = list(dict.fromkeys(only or (QUICK if quick else ROWS)))

    def show() -> None:
        if result.gains:
            words = tables.GAIN_HEADS[:3]
            print_table("Gains predicted and measured", tables.GAIN_HEADS, tables.gain_cells(result), words=words)
            print(tables.agreement_words(result))
        if len(result.models):
            cells, heads = tables.spread_cells(result.models), tables.SPREAD_HEADS
            print_table("Geometry and the best model", heads, cells, words=heads, caption=tables.NOTE)
        for name, reason in result.skipped.items():
            print(f"not made: {name}: {reason}")

    with locked(out), listed_files(out):
        with progress_bars() as report:
            result = run_bench(names, settings, data, out, workers=workers, progress=report)
        measured_gains = tables.blocked_json(result, date.today().isoformat())
        files = [(out / name, text) for name, text in tables.csv_files(result).items()]
        deliver([*files, (blocked, measured_gains), (json_file, tables.bench_json(result))], show)


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
    split: Literal["test", "train"] = "test",
    seed: Annotated[int, Option(min=0)] = 0,
    seeds: int = 5,
    trainings: Annotated[int | None, Option(min=0)] = None,
    quick: Annotated[bool, Option("--quick")] = False,
    executor: Literal["serial", "joblib"] = "serial",
    workers: Annotated[int | None, Option(min=1)] = None,
) -> None:
    """Policies raw and calibrated on every rung of the ladder, on arms that no two seeds share; picks per hour too.

    Args:
        policy: A policy to judge as well: a file of `pickenv train` (.npz), a zip of SB3 or Python, both executed.
        json_file: Write the rows to this file.
        out: Folder for the table and what is done; what was cut off goes on.
        plant: Plant preset in place of the ladder; may be repeated.
        rung: Rung of the ladder with its arms to be judged on; all if left out; may be repeated.
        arms: Arms drawn for each seed.
        episodes: Fruits per arm.
        canopies: Canopies for each arm of the picking task; 0 leaves it out.
        split: Arms of a rung to be judged on; those of train are for tuning, and to check these figures.
        seed: The first seed.
        seeds: How many seeds; at least 5.
        trainings: Trainings of each learned policy, made first; 5 if left out.
        quick: Three policies on one arm a seed: a minute.
        executor: What computes; it does not change the figures.
        workers: Processes; one per core if left out.
    """
    from pickenv.experiments import policy_tables
    from pickenv.inspect.colours import policy_label
    from pickenv.inspect.runs.run_folder import listed_files

    page = out / "leaderboard.md"
    separate({"--policy": policy}, {"--out": [page], "--json": json_file})
    require("torch", "pyarrow", *(["joblib"] if executor == "joblib" else []))
    usual = policy_tables.QUICK if quick else policy_tables.LEADERBOARD
    settings = replace(
        usual,
        policies=(*usual.policies, *dict.fromkeys(policy or [])),
        plants=(*(plant or ()), *policy_tables.rungs(rung or ())) or usual.plants,
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
            board = policy_tables.run_leaderboard(settings, out, count, **how)
        own = "put a policy of yours beside them: the same command with --policy FILE"
        deliver([(page, policy_tables.leaderboard_page(board)), (json_file, board)], show, own)
