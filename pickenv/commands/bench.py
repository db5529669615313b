"""`pickenv bench`: measured robots, beside what was predicted and what others reach; policies, by their errors."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer
from typer import Option

from pickenv.base import locked, separate
from pickenv.commands.showing import CommandOfNames, deliver, print_table, progress_bars

bench = typer.Typer(
    name="bench", help="Benchmarks: calibrations on measured robots, policies on simulated ones.", no_args_is_help=True
)


@bench.callback()
def _benchmarks() -> None:
    """Benchmarks: calibrations on measured robots, policies on simulated ones."""


@bench.command(cls=CommandOfNames)
def calibration(
    json_file: Annotated[Path | None, Option("--json", help="Write the rows to this file.")] = None,
    out: Annotated[Path, Option(help="Folder for tables and what is done; a run that was cut off goes on.")] = (
        Path("runs/bench")
    ),
    only: Annotated[list[str] | None, Option(help="Only these rows; a wrong name lists them all.")] = None,
    quick: Annotated[bool, Option("--quick", help="The UR5 alone, on few rows: a minute.")] = False,
    data: Annotated[Path, Option(envvar="PICKENV_DATA", help="Folder of the measured data sets.")] = (
        Path("../shared/data")
    ),
    peers: Annotated[Path, Option(help="Folder of the peers' environments.")] = Path("runs/peers"),
    seed: Annotated[int, Option(help="Seed of everything random.", min=0)] = 0,
    workers: Annotated[int, Option(help="Processes; they do not change the figures.", min=1)] = 1,
) -> None:
    """What calibrations leave of every measured robot, what twins of other rows predicted, and what peers leave."""
    from dataclasses import replace
    from datetime import date

    from pickenv.base import require
    from pickenv.experiments import robot_tables as tables
    from pickenv.experiments.robots import QUICK, ROWS, BenchSettings, run_bench
    from pickenv.inspect.runs.run_folder import listed_files

    page, blocked = out / "bench.md", out / "measured_gains.json"
    shown = [out / name for name in (tables.GAINS_FILE, tables.ROBOTS_FILE)]
    separate({}, {"--out": [page, blocked, *shown], "--json": json_file})
    require("torch", "pyarrow", *(["joblib"] if workers > 1 else []))
    settings = replace(BenchSettings.quick() if quick else BenchSettings(), seed=seed)
    names = list(dict.fromkeys(only or (QUICK if quick else ROWS)))

    def show() -> None:
        if result.gains:
            words = tables.GAIN_HEADS[:3]
            print_table("Gains predicted and measured", tables.GAIN_HEADS, tables.gain_cells(result), words=words)
            print(tables.agreement_words(result))
        if len(result.models):
            print(tables.spread_table(result.models))
        for name, held_out, poses, _ in tables.peer_cells(result):
            print(f"{name}: {held_out} mm RMS on 200 rows of the UR5, {poses} mm on its 20 random poses")
        for name, reason in result.skipped.items():
            print(f"not made: {name}: {reason}")

    with locked(out), listed_files(out):
        with progress_bars() as report:
            result = run_bench(names, settings, data, out, peers, workers=workers, progress=report)
        measured_gains = tables.blocked_json(result, date.today().isoformat())
        files = [(out / name, text) for name, text in tables.csv_files(result).items()]
        deliver(
            [
                (page, tables.bench_page(result)),
                *files,
                (blocked, measured_gains),
                (json_file, tables.bench_json(result)),
            ],
            show,
        )


@bench.command(cls=CommandOfNames)
def policies(
    policy: Annotated[
        list[str] | None,
        Option(
            help="A policy to judge as well: a file of `pickenv train` (.npz), a zip of SB3 or Python, both executed."
        ),
    ] = None,
    json_file: Annotated[Path | None, Option("--json", help="Write the rows to this file.")] = None,
    out: Annotated[Path, Option(help="Folder for the table and what is done; what was cut off goes on.")] = (
        Path("runs/policies")
    ),
    plant: Annotated[list[str] | None, Option(help="Plant preset, a task each; may be repeated.")] = None,
    rung: Annotated[
        list[str] | None, Option(help="Rung of the ladder with its arms to be judged on, or all; may be repeated.")
    ] = None,
    arms: Annotated[int | None, Option(help="Arms drawn for each seed.", min=1)] = None,
    episodes: Annotated[int | None, Option(help="Fruits per arm.", min=1)] = None,
    canopies: Annotated[
        int | None, Option(help="Canopies for each arm of the picking task; 0 leaves it out.", min=0)
    ] = None,
    seeds: Annotated[int, Option(help="How many seeds, from 0; at least 5.")] = 5,
    quick: Annotated[bool, Option("--quick", help="Three policies on one arm a seed: a minute.")] = False,
    executor: Annotated[
        Literal["serial", "joblib", "ray"], Option(help="What computes; it does not change the figures.")
    ] = "serial",
    workers: Annotated[int | None, Option(help="Processes; one per core if left out.", min=1)] = None,
) -> None:
    """Policies raw and calibrated, with interquartile means over arms that no two seeds share; picks per hour too."""
    from dataclasses import replace
    from itertools import groupby

    from pickenv.base import require
    from pickenv.experiments import policy_tables
    from pickenv.inspect.runs.run_folder import listed_files

    page = out / "leaderboard.md"
    separate({"--policy": policy}, {"--out": [page], "--json": json_file})
    require("torch", "pyarrow", *({"joblib": ["joblib"], "ray": ["ray"]}.get(executor, [])))
    usual = policy_tables.QUICK if quick else policy_tables.LEADERBOARD
    settings = replace(
        usual,
        policies=(*usual.policies, *dict.fromkeys(policy or [])),
        plants=(*(plant or ()), *policy_tables.rungs(rung or ())) or usual.plants,
        seeds=tuple(range(seeds)),
        arms=arms or (usual.arms if quick or not rung else policy_tables.ARMS_OF_RUNGS),
        episodes=episodes or usual.episodes,
        canopies=usual.canopies if canopies is None else canopies,
    )

    def show() -> None:
        for task, group in groupby(rows, lambda row: row["task"]):
            table = list(group)
            print_table(
                task,
                policy_tables.leaderboard_heads(table[0]),
                map(policy_tables.leaderboard_cells, table),
                words=policy_tables.WORDS,
            )

    with locked(out), listed_files(out):
        with progress_bars() as report:
            backend = "loky" if executor == "joblib" else executor
            rows = policy_tables.run_leaderboard(settings, out, backend=backend, workers=workers, progress=report)
        deliver([(page, policy_tables.leaderboard_tables(rows)), (json_file, {"rows": rows})], show)
