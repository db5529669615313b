"""All benchmarks in one run, with their ratios: environments, training, calibration and studies, with their peers.

Each part runs in processes of its own, one after the other, so that none slows or warms another. Environments, training
and calibration are those of benchmark_envs.py and benchmark_calibration.py; studies are measured here: cost per arm as
the population grows, executors against arms one by one.

Run: python scripts/benchmark_all.py [--json FILE] [--no-peers] [--quick]
"""

import json
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer
from measuring import JsonFile, NoPeers, figure, in_fresh_process, last_words, machine, markdown_table

from pickenv.base import write_json
from pickenv.experiments import load_study, run_study

SCRIPTS = Path(__file__).parent
POSES, FRUIT = 30, 100
COSTS = {"seconds": ".1f", "cpu_seconds": ".3g", "ms_per_arm": ".3f", "peak_mib": ".3g"}
"""What is printed of a study, and how."""


def cases(quick: bool) -> list[tuple[str, str, int, int]]:
    """What is timed, as arguments of `time_case`.

    Every executor works on the same population, the batched one also on larger ones.
    """
    few = 100 if quick else 400
    compared = [("ls", "serial", few, 1), ("ls", "joblib", few, 2)]
    grown = [100, 1000] if quick else [100, 1000, 10_000]
    forward = [1000, 10_000] if quick else [1000, 10_000, 100_000, 1_000_000]
    calibrated = [("ls", "batched", arms, 2 if arms > 1000 else 1) for arms in grown]
    return [*compared, *calibrated, *(("raw", "batched", arms, 1) for arms in forward)]


def time_case(method: str, executor: str, arms: int, workers: int) -> dict[str, Any]:
    """Run one study of qiao2026, one setting, after a tiny one that is not counted, as other benchmarks warm up.

    Seconds are those of the chunks; processor seconds, of this process alone, include reading the rows again.

    Args:
        method: ``raw`` (forward evaluation alone) or ``ls`` (30 poses of least squares, then compensation).
        executor: As `pickenv study --executor`.
        arms: N, each with 100 fruit.
        workers: Processes.
    """
    print(f"study: {method}, {executor}, {arms} arms …", file=sys.stderr)
    study = load_study(SCRIPTS / "tolerance_study.toml")
    sizes: dict[str, Any] = {"arms": arms, "chunk": min(1000, -(-arms // 4)), "fruit": FRUIT}
    setting: dict[str, Any] = {"methods": (method,), "it_grades": (12,), "payload_kg": (0.0,), "poses": (POSES,)}
    config = replace(study, **sizes, **setting, noise=study.noise[:1])
    with tempfile.TemporaryDirectory() as folder:
        run_study(replace(config, arms=4, chunk=2), Path(folder) / "warm", executor=executor, workers=workers)
        cpu = time.process_time()
        summary = run_study(config, Path(folder) / "study", executor=executor, workers=workers)
        cpu = time.process_time() - cpu
    kib = max(resource.getrusage(who).ru_maxrss for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return {"method": method, "executor": executor, "arms": arms, "workers": workers} | {
        "seconds": summary["seconds"],
        "cpu_seconds": cpu if workers == 1 else None,
        "ms_per_arm": 1e3 * summary["seconds"] / arms,
        "peak_mib": kib / 1024 if sys.platform == "linux" else None,  # elsewhere in other units
    }


def study_ratios(rows: list[dict[str, Any]]) -> dict[str, float]:
    """How many times as long an arm takes one by one, in one process, as on each other executor."""
    costs: dict[str, list[float]] = {}
    for row in rows:
        if row["method"] == "ls":
            costs.setdefault(row["executor"], []).append(row["ms_per_arm"])
    (serial,) = costs.pop("serial")
    return {f"study_serial_vs_{executor}": serial / min(several) for executor, several in costs.items()}


def run_script(name: str, *arguments: str) -> dict[str, Any]:
    """The JSON of another benchmark, which prints its own tables; or a note on why there is none."""
    print(f"{name} …", file=sys.stderr, flush=True)
    with tempfile.TemporaryDirectory() as folder:
        answer = Path(folder) / "result.json"
        command = [sys.executable, str(SCRIPTS / name), "--json", str(answer), *arguments]
        ended = subprocess.run(command, stderr=subprocess.PIPE, text=True)
        if ended.returncode or not answer.is_file():
            note = f"no figures: {last_words(ended.stderr)}"
            print(f"{name}: {note}")
            return {"note": note, "ratios": {}}
        return dict(json.loads(answer.read_text(encoding="utf-8")))


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


def study_table(study: Sequence[Mapping[str, Any]]) -> str:
    """The studies' costs; a dash stands for what was not measured."""
    words = ("method", "executor")
    rows = [
        [*(str(row[name]) for name in (*words, "workers", "arms")), *(figure(row[key], COSTS[key]) for key in COSTS)]
        for row in study
    ]
    return markdown_table((*words, "processes", "arms", *(name.replace("_", " ") for name in COSTS)), rows, words)


def main(
    json_file: JsonFile = None,
    no_peers: NoPeers = False,
    quick: Annotated[bool, typer.Option("--quick", help="Short rounds and small populations.")] = False,
) -> None:
    """Run every benchmark, which print their tables, then the studies; print their costs and all ratios."""
    on = machine()
    alone = ["--no-peers"] if no_peers else []
    environments = run_script("benchmark_envs.py", *alone, *(["--quick"] if quick else []))
    calibration = run_script("benchmark_calibration.py", *alone, *(["--runs", "3"] if quick else []))
    result = gathered(environments, calibration, [in_fresh_process(time_case, *case) for case in cases(quick)], on)
    print(f"Studies: qiao2026, one setting, {FRUIT} fruit; ls with {POSES} calibration poses.\n")
    print(study_table(result["study"]), "", sep="\n")
    print(markdown_table(("ratio", "times"), [(n, f"{v:.3g}") for n, v in result["ratios"].items()], ("ratio",)))
    if json_file is not None:
        print(f"wrote {write_json(json_file, result)}")


if __name__ == "__main__":
    typer.run(main)
