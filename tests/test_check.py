"""`pickenv check` says of every file whether it is what was written, and its exit code says it of all of them."""

import json
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from pickenv.agents import BASELINES
from pickenv.arm import load_plant
from pickenv.base import write_container, write_text
from pickenv.calibration import Calibration, fit, random_joints, simulated_tracker
from pickenv.cli import app
from pickenv.experiments import CalibrationPlan, PolicySettings, compensators, load_study, run_policies, run_study
from pickenv.inspect import CalibrationTrace, recorded_run, save_part, trace_of
from pickenv.inspect.runs.run_folder import listed_files
from tests.conftest import Ended

NAMES = ("calibration.npz", "calibration_trace.npz", "figures.json")


@pytest.fixture(scope="module")
def fitted() -> tuple[Calibration, CalibrationTrace]:
    plant, rng = load_plant("qiao2026"), np.random.default_rng(0)
    data = simulated_tracker(plant, random_joints(plant.arm.nominal, 40, rng), rng)
    found = fit(plant.arm, data, known_frames=True)
    return found.calibration, trace_of(found, {"identification": data, "test": data}, {"raw": rng.normal(size=(40, 6))})


@pytest.fixture
def folder(tmp_path: Path, fitted: tuple[Calibration, CalibrationTrace]) -> Path:
    """A run folder as `pickenv calibrate --run` leaves it, without its page."""
    calibration, trace = fitted
    with recorded_run(tmp_path / "run", "calibration", "pickenv calibrate x.csv", 0) as run:
        calibration.save(run.folder / "calibration")
        save_part(run.folder, trace, 0)
        write_text(run.folder / "figures.json", "{}\n")
    return run.folder


def checked(*paths: object) -> tuple[int, list[str]]:
    """Exit code and lines."""
    done = CliRunner().invoke(app, ["check", *map(str, paths)])
    assert done.exception is None or isinstance(done.exception, SystemExit), done.exception
    return done.exit_code, done.output.splitlines()


def flip(path: Path, rng: np.random.Generator) -> None:
    content = bytearray(path.read_bytes())
    content[rng.integers(len(content))] ^= 1 << rng.integers(8)
    path.write_bytes(content)


def test_a_sound_run_is_named_file_by_file(folder: Path) -> None:
    code, lines = checked(folder)
    assert code == 0
    assert (
        lines[0]
        == f"sound    {folder}/run.json: record of a run (calibration), format 2, made by `pickenv calibrate x.csv`"
    )
    assert lines[1].startswith(f"sound    {folder}/calibration.npz: calibration, format 3, arm 'qiao2026', geometry ")
    assert (
        lines[2] == f"sound    {folder}/calibration_trace.npz: CalibrationTrace, format 3, the numbers behind figures"
    )
    assert lines[3] == f"sound    {folder}/figures.json: file of the run"
    assert lines[4:] == ["4 checked, 0 refused"]


def test_archives_are_known_by_their_content(folder: Path, tmp_path: Path) -> None:
    renamed = tmp_path / "policy.npz"
    renamed.write_bytes((folder / "calibration.npz").read_bytes())
    code, lines = checked(renamed, BASELINES / "ppo_camera.npz")
    assert code == 0
    assert "policy.npz: calibration, format 3" in lines[0]
    assert "ppo_camera.npz: policy, format 2, ppo on arm 'qiao2026'" in lines[1]


@pytest.mark.parametrize("name", [*NAMES, "run.json"])
@pytest.mark.parametrize("count", [3, pytest.param(50, marks=pytest.mark.thorough)])
def test_one_flipped_bit_anywhere_in_a_run_is_refused_by_file(folder: Path, name: str, count: int) -> None:
    whole = (folder / name).read_bytes()
    for number in range(count):
        (folder / name).write_bytes(whole)
        flip(folder / name, np.random.default_rng([5, number]))
        start = time.process_time()
        code, lines = checked(folder)
        assert time.process_time() - start < 5
        assert code == 3
        assert [name in line for line in lines if line.startswith("REFUSED")] == [True]


@pytest.mark.thorough
@pytest.mark.parametrize("name", ["calibration.npz", "calibration_trace.npz", "policy.npz"])
def test_one_flipped_bit_anywhere_in_a_file_is_refused_200_times(folder: Path, name: str) -> None:
    path = folder / name
    whole = path.read_bytes() if path.exists() else (BASELINES / "ppo_camera.npz").read_bytes()
    for number in range(200):
        path.write_bytes(whole)
        flip(path, np.random.default_rng([6, number]))
        code, lines = checked(path)
        assert (code, lines[-1]) == (3, "1 checked, 1 refused")


def test_missing_edited_exchanged_and_stray_files_are_named(folder: Path, fitted) -> None:
    (folder / "figures.json").unlink()
    fitted[0].without_residual().save(folder / "other")
    (folder / "calibration_trace.npz").write_bytes((folder / "calibration.npz").read_bytes())
    code, lines = checked(folder)
    assert code == 3
    refused = [line for line in lines if line.startswith("REFUSED")]
    assert refused == [
        f"REFUSED  {folder}/calibration_trace.npz: was edited since the run wrote it",
        f"REFUSED  {folder}/figures.json: is missing; the run wrote it",
        f"REFUSED  {folder}/other.npz: is stray: this run did not write it",
    ]


@pytest.mark.slow
def test_figures_drawn_and_reports_written_later_are_of_the_run(folder: Path) -> None:
    done = CliRunner().invoke(app, ["figures", str(folder), "--format", "svg"])
    assert done.exit_code == 0, done.output
    code, lines = checked(folder)
    assert code == 0
    assert any("figures/" in line for line in lines)


def test_what_carries_no_seal_is_foreign(tmp_path: Path, folder: Path) -> None:
    (tmp_path / "x.csv").write_text("1,2\n")
    np.savez(tmp_path / "numbers.npz", x=np.zeros(3))
    write_container(tmp_path / "moon.npz", "moon", {}, {})
    for name in ("empty.npz", "empty.pt", "empty.parquet", "empty"):
        (tmp_path / name).touch()
    paths = sorted(path for path in tmp_path.iterdir() if path.is_file())
    code, lines = checked(*paths)
    assert code == 3
    assert [line.startswith("REFUSED") and str(path) in line for path, line in zip(paths, lines, strict=False)] == [
        True
    ] * 7
    assert "moon.npz holds a moon, which this program does not know" in "\n".join(lines)


def test_a_folder_without_a_run_is_searched_for_sealed_files(tmp_path: Path, fitted) -> None:
    (tmp_path / "empty").mkdir()
    assert checked(tmp_path / "empty")[0] == 3
    fitted[0].save(tmp_path / "cache" / "a")
    fitted[0].save(tmp_path / "cache" / "b")
    assert checked(tmp_path / "cache")[0] == 0
    flip(tmp_path / "cache" / "b.npz", np.random.default_rng(0))
    code, lines = checked(tmp_path / "cache")
    assert code == 3
    assert [line[:7] for line in lines] == ["sound  ", "REFUSED", "2 check"]


def test_json_says_the_same(folder: Path, tmp_path: Path) -> None:
    flip(folder / "figures.json", np.random.default_rng(0))
    code, lines = checked(folder, "--json", tmp_path / "found.json")
    found = json.loads((tmp_path / "found.json").read_text())
    assert (code, found["sound"]) == (3, False)
    assert [file["path"] for file in found["files"] if file["reason"]] == [f"{folder}/figures.json"]
    assert len(found["files"]) == len(lines) - 2 == 4


@pytest.mark.parametrize("name", ["nothing", "x" * 300])
def test_a_path_that_does_not_exist_is_one_sentence(tmp_path: Path, name: str, typed: Callable[..., Ended]) -> None:
    done = typed("check", tmp_path / name)
    assert done.returncode == 2
    assert done.stderr.startswith("error: ") and done.stderr.count("\n") == 1


def test_the_exit_code_reaches_the_shell(folder: Path) -> None:
    command = [sys.executable, "-m", "pickenv.cli", "check", str(folder)]
    flip(folder / "calibration.npz", np.random.default_rng(0))
    assert subprocess.run(command, capture_output=True, check=False).returncode == 3


STUDY = """
plant = "qiao2026"
seed = 3
arms = 4
chunk = 2
[picking]
fruit = 8
[specification]
radius_mm = 1.0
share = 0.75
[tolerances]
classes = ["medium"]
it_grades = [8]
[calibration]
methods = ["raw", "ls"]
poses = [12]
"""


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two studies that differ in their seed alone."""
    path = tmp_path_factory.mktemp("studies")
    write_text(path / "config.toml", STUDY)
    config = load_study(path / "config.toml")
    run_study(config, path / "one", executor="batched")
    run_study(replace(config, seed=4), path / "other", executor="batched")
    return path


@pytest.fixture
def study(finished: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(finished / "one", tmp_path / "study"))


def refused_lines(study: Path) -> str:
    code, lines = checked(study)
    assert code == 3
    return "\n".join(line for line in lines if line.startswith("REFUSED"))


def test_a_sound_study_passes_and_an_exchanged_or_stray_chunk_is_named(study: Path, finished: Path) -> None:
    assert checked(study)[0] == 0
    chunks = sorted((study / "rows").glob("*.parquet"))
    assert checked(*chunks)[0] == 0
    shutil.copy(chunks[0], study / "rows" / "chunk-00007.parquet")
    assert "chunk-00007.parquet" in refused_lines(study)
    (study / "rows" / "chunk-00007.parquet").unlink()
    shutil.copy(min((finished / "other" / "rows").glob("*.parquet")), chunks[0])
    assert chunks[0].name in refused_lines(study)
    assert checked(chunks[0])[0] == 0  # it is sound by itself


def test_an_edited_study_is_refused(study: Path) -> None:
    text = (study / "study.toml").read_text()
    write_text(study / "study.toml", text.replace("radius_mm = 1.0", "radius_mm = 5.0"))
    assert "study.toml" in refused_lines(study)


@pytest.mark.parametrize("count", [5, pytest.param(200, marks=pytest.mark.thorough)])
def test_one_flipped_bit_anywhere_in_a_chunk_is_refused(study: Path, count: int) -> None:
    chunk = min((study / "rows").glob("*.parquet"))
    whole = chunk.read_bytes()
    for number in range(count):
        chunk.write_bytes(whole)
        flip(chunk, np.random.default_rng([7, number]))
        assert checked(chunk)[0] == 3
        code, lines = checked(study)
        assert code == 3
        assert any(chunk.name in line for line in lines if line.startswith("REFUSED"))


def test_calibrations_that_changed_places_in_a_cache_are_refused(tmp_path: Path) -> None:
    protocol = CalibrationPlan(identification_poses=30)
    for name in ("qiao2026", "geometry_only"):
        compensators(load_plant(name), "ls", protocol, tmp_path)
    one, other = sorted(tmp_path.glob("*.npz"))
    assert checked(tmp_path)[0] == 0
    first, second = one.read_bytes(), other.read_bytes()
    one.write_bytes(second)
    other.write_bytes(first)
    code, lines = checked(tmp_path)
    assert code == 3
    assert all("is the calibration of another arm or protocol than its name says" in line for line in lines[:2])


def test_a_calibration_that_was_taken_out_of_a_cache_is_noticed(tmp_path: Path) -> None:
    settings = PolicySettings(("scripted",), ("ls",), plants=("qiao2026",), arms=2, episodes=2)
    run_policies(settings, tmp_path / "rows", cache=tmp_path / "cache")
    assert checked(tmp_path)[0] == checked(tmp_path / "cache")[0] == 0
    calibration, piece = next((tmp_path / "cache").glob("*.npz")), next(tmp_path.glob("rows/reaching/*.parquet"))
    calibration.unlink()
    assert calibration.name in refused_lines(tmp_path / "cache") and calibration.name in refused_lines(tmp_path)
    run_policies(settings, cache=tmp_path / "cache")
    assert checked(tmp_path)[0] == 0
    piece.unlink()
    assert piece.name in refused_lines(tmp_path)


DAMAGES: dict[str, Callable[[Path], object]] = {
    "removed": Path.unlink,
    "emptied": lambda path: path.write_bytes(b""),
    "one byte more": lambda path: path.write_bytes(path.read_bytes() + b" "),
    "one byte changed": lambda path: flip(path, np.random.default_rng(0)),
    "made a folder": lambda path: (path.unlink(), path.mkdir()),
}


@pytest.mark.parametrize("damage", DAMAGES)
@pytest.mark.parametrize("name", [*NAMES, "run.json"])
def test_damage_in_a_folder_of_runs_is_noticed(damage: str, name: str, folder: Path) -> None:
    """Of somebody's own making: runs, calibrations beside them, and notes."""
    board = folder.parent / "board"
    shutil.copytree(folder, board / "first" / "run")
    shutil.copytree(folder, board / "second")
    write_text(board / "notes.md", "kept")
    shutil.copy(folder / "calibration.npz", board / "calibration.npz")
    code, lines = checked(board)
    assert code == 0 and len(lines) == 2 * (1 + len(NAMES)) + 2
    DAMAGES[damage](board / "second" / name)
    code, lines = checked(board)
    assert code == 3 and any(line.startswith("REFUSED") and "second" in line for line in lines), lines
    assert sum(line.startswith("sound") and "first" in line for line in lines) == 1 + len(NAMES)


@pytest.fixture
def bench_folder(folder: Path) -> Path:
    """A folder as `pickenv bench` leaves it: a run, a calibration kept beside it, rows and a page."""
    out = folder.parent / "bench"
    out.mkdir()
    with listed_files(out):
        shutil.copytree(folder, out / "scripted-0-abc")
        (out / "calibrations").mkdir()
        shutil.copy(folder / "calibration.npz", out / "calibrations" / "one.npz")
        write_text(out / "picking-0-abc.json", "{}\n")
        write_text(out / "leaderboard.md", "| a |\n")
    return out


def test_a_bench_folder_is_sound_as_it_was_left(bench_folder: Path) -> None:
    code, lines = checked(bench_folder)
    assert code == 0 and lines[0] == f"sound    {bench_folder}/files.json: list of 7 files"
    assert lines[-1] == "8 checked, 0 refused"


@pytest.mark.parametrize("damage", ["removed", "edited", "swapped", "stray"])
def test_no_damage_to_a_bench_folder_passes(bench_folder: Path, damage: str) -> None:
    """Of any file in it, its own list of files among them."""
    whole = bench_folder.parent / "whole"
    shutil.copytree(bench_folder, whole)
    files = sorted(path.relative_to(whole) for path in whole.rglob("*") if path.is_file())
    assert len(files) == 8
    for number, name in enumerate(files):
        shutil.rmtree(bench_folder)
        shutil.copytree(whole, bench_folder)
        path = bench_folder / name
        if damage == "removed":
            path.unlink()
        elif damage == "edited":
            flip(path, np.random.default_rng(number))
        elif damage == "swapped":
            shutil.copy(whole / files[(number + 1) % len(files)], path)
            if path.read_bytes() == (whole / name).read_bytes():
                continue
        else:
            write_text(path.with_name(f"other_{path.name}"), "{}\n")
        assert checked(bench_folder)[0] == 3, name
