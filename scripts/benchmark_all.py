"""All benchmarks in one run, ratios first: environments, training, calibration and studies, with their peers.

Each part runs in processes of its own, one after the other, so that none slows or warms another. Environments, training
and calibration are those of benchmark_envs.py and benchmark_calibration.py; studies are measured here: cost per arm as
the population grows, executors against arms one by one. What does not fit is extrapolated on paper and marked so.

Run: python scripts/benchmark_all.py [--json FILE] [--markdown FILE] [--no-peers] [--quick]
"""

from __future__ import annotations

import json
import multiprocessing
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import typer
from measuring import JsonFile, NoPeers, figure, last_words, machine, machine_words, markdown_table

from pickenv.base import write_json, write_text
from pickenv.experiments import load_study, run_study

SCRIPTS = Path(__file__).parent
POSES, FRUIT = 30, 100
LARGEST = 1_000_000
"""Arms to which costs are extrapolated where they were not measured."""


@dataclass(frozen=True)
class Case:
    """One study to be timed: qiao2026, one setting, 100 fruit.

    Attributes:
        method: ``raw`` (forward evaluation alone) or ``ls`` (30 poses of least squares, then compensation).
        executor: As `pickenv study --executor`.
        arms: N.
        workers: Processes.
    """

    method: str
    executor: str
    arms: int
    workers: int


def cases(quick: bool) -> list[Case]:
    """What is timed; every executor on the same population, the batched one also on larger ones."""
    few = 100 if quick else 400
    compared = [Case("ls", "serial", few, 1), Case("ls", "joblib", few, 2)]
    grown = [100, 1000] if quick else [100, 1000, 10_000]
    forward = [1000, 10_000] if quick else [1000, 10_000, 100_000, LARGEST]
    return [
        *compared,
        *(Case("ls", "batched", arms, 2 if arms > 1000 else 1) for arms in grown),
        *(Case("raw", "batched", arms, 1) for arms in forward),
    ]


def time_case(case: Case) -> dict[str, Any]:
    """Run one study after a tiny one that is not counted, as other benchmarks warm up.

    Seconds are those of the chunks; processor seconds, of this process alone, include reading the rows again.
    """
    config = replace(
        load_study(SCRIPTS / "tolerance_study.toml"),
        arms=case.arms,
        chunk=min(1000, -(-case.arms // 4)),
        fruit=FRUIT,
        payload_kg=(0.0,),
        it_grades=(12,),
        methods=(case.method,),
        poses=(POSES,),
    )
    config, workers = replace(config, noise=config.noise[:1]), case.workers
    with tempfile.TemporaryDirectory() as folder:
        run_study(replace(config, arms=4, chunk=2), Path(folder) / "warm", executor=case.executor, workers=workers)
        cpu = time.process_time()
        summary = run_study(config, Path(folder) / "study", executor=case.executor, workers=workers)
        cpu = time.process_time() - cpu
    kib = max(resource.getrusage(who).ru_maxrss for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return asdict(case) | {
        "seconds": summary["seconds"],
        "cpu_seconds": cpu if case.workers == 1 else None,
        "ms_per_arm": 1e3 * summary["seconds"] / case.arms,
        "peak_mib": kib / 1024 if sys.platform == "linux" else None,  # elsewhere in other units
        "extrapolated": False,
    }


def time_studies(quick: bool) -> list[dict[str, Any]]:
    """Every case in a fresh process; then the largest population at the cost per arm of the largest measured one."""
    found = []
    for case in cases(quick):
        print(f"study: {case.method}, {case.executor}, {case.arms} arms …", file=sys.stderr)
        with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as fresh:
            found.append(fresh.submit(time_case, case).result())
    for method in ("ls", "raw"):
        last = max((row for row in found if row["method"] == method), key=lambda row: row["arms"])
        if last["arms"] < LARGEST:
            seconds = 1e-3 * last["ms_per_arm"] * LARGEST
            unknown = {"cpu_seconds": None, "peak_mib": None, "extrapolated": True}
            found.append(last | {"arms": LARGEST, "seconds": seconds} | unknown)
    return found


def study_ratios(rows: list[dict[str, Any]]) -> dict[str, float]:
    """How many times as long an arm takes one by one, in one process, as on each other executor."""
    measured = [row for row in rows if row["method"] == "ls" and not row["extrapolated"]]
    (serial,) = (row for row in measured if row["executor"] == "serial")
    best: dict[str, float] = {}
    for row in measured:
        if row["executor"] != "serial":
            best[row["executor"]] = min(row["ms_per_arm"], best.get(row["executor"], float("inf")))
    return {f"study_serial_vs_{executor}": serial["ms_per_arm"] / cost for executor, cost in best.items()}


def run_script(name: str, *arguments: str) -> dict[str, Any]:
    """The JSON of another benchmark, or a note on why there is none."""
    print(f"{name} …", file=sys.stderr)
    with tempfile.TemporaryDirectory() as folder:
        answer = Path(folder) / "result.json"
        command = [sys.executable, str(SCRIPTS / name), "--json", str(answer), *arguments]
        ended = subprocess.run(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
        if ended.returncode or not answer.is_file():
            return {"note": f"no figures: {last_words(ended.stderr)}", "ratios": {}}
        result: dict[str, Any] = json.loads(answer.read_text(encoding="utf-8"))
    return result


def gathered(
    environments: Mapping[str, Any], calibration: Mapping[str, Any], study: list[dict[str, Any]], on: Mapping[str, Any]
) -> dict[str, Any]:
    """All parts as one result, ratios first; training is told apart from stepping."""
    envs = environments.get("envs", {})
    training = {name: row for name, row in envs.items() if "training" in row.get("note", "")}
    ratios = {**environments["ratios"], **calibration["ratios"], **study_ratios(study)}
    return {
        "ratios": {name: value for name, value in ratios.items() if value is not None},
        "machine": dict(on),
        "environments": {**environments, "envs": {name: row for name, row in envs.items() if name not in training}},
        "training": training,
        "calibration": dict(calibration),
        "study": study,
    }


def markdown(result: Mapping[str, Any]) -> str:
    """The result as Markdown, ratios first."""
    ratios = [(name, f"{value:.3g}") for name, value in result["ratios"].items()]
    parts = [machine_words(result["machine"]) + ".", markdown_table(("ratio", "times"), ratios, ("ratio",))]
    steps = [
        (name, f"{row['num_envs']:,}", figure(row["steps_per_s"], ",.0f"), row["note"])
        for name, row in (result["environments"]["envs"] | result["training"]).items()
    ]
    if steps:
        parts.append(markdown_table(("environment", "at once", "steps/s", ""), steps, ("environment", "")))
    systems = [
        [
            name if row["seconds"] is not None else f"{name}: {row['note']}",
            str(row.get("poses", "-")),
            *(figure(row[key], ".4f") for key in ("seconds", "held_out_rms_mm")),
        ]
        for name, row in result["calibration"].get("systems", {}).items()
    ]
    if systems:
        heads = ("calibration", "poses", "seconds", "held-out RMS (mm)")
        parts.append(markdown_table(heads, systems, ("calibration",)))
    parts += [f"{part}: {result[part]['note']}" for part in ("environments", "calibration") if "note" in result[part]]
    studies = [
        [
            *(str(row[key]) for key in ("method", "executor", "workers")),
            f"{row['arms']:,}",
            f"{row['seconds']:.1f}" + " (extrapolated)" * row["extrapolated"],
            figure(row["cpu_seconds"], ".3g"),
            f"{row['ms_per_arm']:.3f}",
            figure(row["peak_mib"], ".3g"),
        ]
        for row in result["study"]
    ]
    heads = ("method", "executor", "processes", "arms", "seconds", "CPU s", "ms per arm", "peak of a process (MiB)")
    parts.append(f"Studies: qiao2026, one setting, {FRUIT} fruit; ls with {POSES} calibration poses.")
    parts.append(markdown_table(heads, studies, ("method", "executor")))
    return "\n\n".join(parts) + "\n"


def main(
    json_file: JsonFile = None,
    markdown_file: Annotated[Path | None, typer.Option("--markdown", help="Write the tables to this file.")] = None,
    no_peers: NoPeers = False,
    quick: Annotated[bool, typer.Option("--quick", help="Short rounds and small populations.")] = False,
) -> None:
    """Run every benchmark and print the tables."""
    on = machine()
    alone = ["--no-peers"] if no_peers else []
    environments = run_script("benchmark_envs.py", *alone, *(["--quick"] if quick else []))
    calibration = run_script("benchmark_calibration.py", *alone, *(["--runs", "3"] if quick else []))
    result = gathered(environments, calibration, time_studies(quick), on)
    print(markdown(result))
    if json_file is not None:
        print(f"wrote {write_json(json_file, result)}")
    if markdown_file is not None:
        print(f"wrote {write_text(markdown_file, markdown(result))}")


if __name__ == "__main__":
    typer.run(main)
