"""`pickenv bench calibration`: its rows, what it says where data are missing, and that it goes on."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from pickenv.base import InputError, write_json
from pickenv.commands.check import findings_of
from pickenv.experiments import BenchSettings, check_experiment, kept_rows, robots, run_bench
from pickenv.experiments.gains import MEASURED, NOMINAL
from pickenv.experiments.robot_tables import BLOCKED_FILE, bench_json, blocked_json
from pickenv.experiments.robots import (
    BEFORE,
    GAINS,
    QUICK,
    ROWS,
)
from pickenv.inspect.runs.run_folder import listed_files

KEYS = {
    *("robot", "split", "model", "nominal_mm", "held_out_mm"),
    *("measured_reduction", "predicted_reduction", "ci95"),
}


def command(*words: object) -> subprocess.CompletedProcess[str]:
    line = [sys.executable, "-c", "from pickenv.cli import main; main()", "bench", "calibration", *map(str, words)]
    return subprocess.run(line, capture_output=True, text=True)


def test_without_the_data_one_sentence_says_what_to_give(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="name the folder of the data sets in PICKENV_DATA"):
        run_bench(QUICK, BenchSettings.quick(), tmp_path, tmp_path / "bench")
    assert not (tmp_path / "bench").exists()


def test_an_unknown_row_is_answered_with_all_of_them(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="unknown row 'ur6'; give some of gain_ur5_random, ") as found:
        run_bench(["ur6"], BenchSettings(), tmp_path, tmp_path)
    assert all(name in str(found.value) for name in ROWS)


def made_fold(fold: int) -> dict[str, np.ndarray]:
    """Rows of a fold that nobody measured."""
    rng = np.random.default_rng(fold)
    sizes = dict(zip((NOMINAL, *BEFORE), (9.0, 4.0, 1.0, 3.0, 2.0), strict=True))
    counts = {"refused": 1, "rows": 60, "rows_in_file": 100}
    at = np.arange(12 * fold, 12 * fold + 12)
    return (
        {"drawn": np.repeat(np.arange(3), 12), "at": np.tile(at, 3)}
        | {name: size * 1e-6 * rng.chisquare(3, 36) for name, size in sizes.items()}
        | {name: np.full(36, value) for name, value in counts.items()}
    )


@pytest.fixture
def worked(monkeypatch, tmp_path):
    """The bench without its calibrations, on one file; what it worked on is listed."""
    seen: list[tuple[str, int]] = []

    def fold_errors(rng, row, fold, settings, data):
        seen.append((row, fold))
        return made_fold(fold)

    def model_errors(rng, row, settings, data):
        seen.append((row, 0))
        raise InputError("it cannot be calibrated")

    monkeypatch.setattr(robots, "fold_errors", fold_errors)
    monkeypatch.setattr(robots, "model_errors", model_errors)
    for kind in ("grid", "random"):
        file = tmp_path / f"data/ur5_wam_jacobi2025/UR5/3D_UR5_uncalibrated_{kind}_cleaned.csv"
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(kind)
    return seen, lambda rows, settings=None: run_bench(
        rows, settings or BenchSettings(), tmp_path / "data", tmp_path / "out"
    )


def test_what_is_done_is_kept_until_settings_or_data_change(worked, tmp_path: Path) -> None:
    seen, run = worked
    first = bench_json(BenchSettings(), *run(["gain_ur5_blocks"]))
    assert [fold for _, fold in seen] == [0, 1, 2, 3, 4]
    next(iter((tmp_path / "out/gains").glob("*-3_*.parquet"))).unlink()
    assert bench_json(BenchSettings(), *run(["gain_ur5_blocks"])) == first
    assert [fold for _, fold in seen[5:]] == [3]
    run(["gain_ur5_blocks"], BenchSettings(seed=1))
    assert len(seen) == 11
    (tmp_path / "data/ur5_wam_jacobi2025/UR5/3D_UR5_uncalibrated_grid_cleaned.csv").write_text("other")
    run(["gain_ur5_blocks"])
    assert len(seen) == 16
    assert all(reason is None for _, reason in check_experiment(tmp_path / "out/gains"))


def test_what_cannot_be_made_is_said_and_tried_again(worked) -> None:
    seen, run = worked
    for _ in range(2):
        gains, _, skipped = run(["gain_ur5_random", "ur5_random", "gain_wam_random"])
        assert skipped["ur5_random"] == "it cannot be calibrated"
        assert "name the folder of the data sets" in skipped["gain_wam_random"]
        assert {(gain["robot"], gain["split"]) for gain in gains} == {("UR5", "random")}
    assert [row for row, _ in seen].count("ur5_random") == 2


@pytest.mark.parametrize("complete", [True, False])
def test_every_damage_to_a_folder_is_noticed(complete: bool, worked, tmp_path: Path) -> None:
    """Of a run that ended, by the folder's list; of one that was cut off, by the records of its experiments."""
    out = tmp_path / "out"
    with listed_files(out):
        gains, *_ = worked[1](["gain_ur5_random", "ur5_random"])
        write_json(out / BLOCKED_FILE, blocked_json(gains, 5, "2026-01-01"))

    def faults() -> list[str]:
        if complete:
            return [finding.reason for finding in findings_of(out) if finding.reason is not None]
        kept = [check_experiment(out / name) for name in ("gains", "models")]
        return [reason for checked in kept for _, reason in checked if reason is not None]

    assert faults() == []
    files = [path for path in out.rglob("*") if path.is_file() and not path.name.startswith(".")]
    files = files if complete else [path for path in files if path.parent != out]
    assert len(files) == (5 + 2 + 2 if complete else 5 + 2)
    for path in files:
        content = path.read_bytes()
        changed = (
            content[: len(content) // 2] + bytes([content[len(content) // 2] ^ 1]) + content[len(content) // 2 + 1 :]
        )
        for damage in (b"", content[:-1], changed, None):
            path.unlink() if damage is None else path.write_bytes(damage)
            assert faults(), (path, damage)
            path.write_bytes(content)
    first, second = sorted((out / "gains").glob("*.parquet"))[:2]
    first.write_bytes(second.read_bytes())
    assert faults()


def test_every_row_has_the_keys_that_programs_read(worked) -> None:
    result = worked[1](["gain_ur5_random", "gain_ur5_blocks"])
    content = json.loads(json.dumps(bench_json(BenchSettings(), *result)))
    assert [(row["split"], row["model"]) for row in content["rows"]] == [
        (split, model) for split in ("random", "blocks") for model in BEFORE
    ]
    for row in content["rows"]:
        assert row.keys() >= KEYS
        assert row["measured_reduction"] == pytest.approx(1.0 - row["held_out_mm"] / row["before_mm"])
        assert row["ci95"][0] < row["measured_reduction"] < row["ci95"][1]


def test_the_demonstrations_file_is_what_the_command_writes_of_blocks(worked) -> None:
    gains, *_ = worked[1](["gain_ur5_random", "gain_ur5_blocks"])
    made, shipped = blocked_json(gains, 5, "2026-01-01"), json.loads(MEASURED.read_text(encoding="utf-8"))
    assert made.keys() == shipped.keys() and made["made"] == "2026-01-01" and made["folds"] == 5
    (arm,) = made["arms"]
    assert all(
        arm.keys() == other.keys() and arm["removed"].keys() == other["removed"].keys() for other in shipped["arms"]
    )
    blocks = {row["model"]: row for row in gains if row["split"] == "blocks"}
    assert arm["ls_mm"] == pytest.approx(blocks["LS"]["held_out_mm"], abs=5e-4)
    for model, (removed, low, high) in arm["removed"].items():
        told = blocks[model]
        assert [removed, low, high] == pytest.approx([told["measured_reduction"], *told["ci95"]], abs=5e-4)


@pytest.mark.slow
def test_the_quick_form_ends_and_two_processes_change_no_figure(data_folder: Path, tmp_path: Path) -> None:
    if not (data_folder / "ur5_wam_jacobi2025").is_dir():
        pytest.skip(f"no data set ur5_wam_jacobi2025 in {data_folder}")
    file = tmp_path / "bench.json"
    ended = command("--quick", "--workers", 2, "--data", data_folder, "--out", tmp_path / "one", "--json", file)
    assert ended.returncode == 0, ended.stderr
    content = json.loads(file.read_text(encoding="utf-8"))
    assert {row["robot"] for row in content["rows"]} == {"UR5"} and content["skipped"] == {}
    gains = content["rows"]
    assert len(gains) == 2 * len(BEFORE)
    assert content["agreement"]["gains"] == sum(gain["split"] == "blocks" for gain in gains) == len(gains) // 2
    assert len((tmp_path / "one/gains.csv").read_text(encoding="utf-8").splitlines()) == 1 + len(gains)
    there = kept_rows(tmp_path / "one/gains").where(row="gain_ur5_blocks", fold=1)
    here = robots.fold_errors(np.random.default_rng(), "gain_ur5_blocks", 1, BenchSettings.quick(), data_folder)
    for name, values in here.items():
        np.testing.assert_array_equal(there[name], values, err_msg=name)


def test_the_gains_are_of_at_least_five_robots_and_three_models() -> None:
    assert len({name for name, _ in GAINS.values()}) >= 5 and len(BEFORE) >= 3
