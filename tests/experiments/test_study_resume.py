"""A study that was killed goes on: only what is missing is computed, and the table is that of an uninterrupted run."""

import os
import signal
import struct
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from pickenv.base import InputError
from pickenv.experiments import check_experiment, check_folder, load_study, read_rows, run_study, study_of, table_sha256

ROOT = Path(__file__).parents[2]
COMMAND = [sys.executable, "-c", "from pickenv.cli import main; main()", "study"]


@pytest.fixture
def config(study_file):
    return replace(load_study(study_file()), it_grades=(12,), payload_kg=(0.0,), poses=(20,), arms=5, chunk=2)


@pytest.fixture
def folder(tmp_path):
    return tmp_path / "out"


def test_a_study_stopped_half_way_ends_with_the_same_table(config, folder, tmp_path):
    """A kill, which nothing can answer, is asked for below."""

    def stop(done: int, arms: int) -> None:
        if done >= 4:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_study(config, folder, executor="serial", progress=stop)
    kept = chunks_of(folder)
    assert 0 < len(kept) < len(config.chunks())
    assert not (folder / "summary.json").exists()
    resumed = run_study(config, folder, executor="serial")
    assert resumed["chunks_reused"] == len(kept)
    whole = run_study(config, tmp_path / "whole", executor="serial")
    assert resumed["table_sha256"] == whole["table_sha256"]
    rows = read_rows(folder).to_table(columns=["arm", "setting"]).to_pylist()
    assert len(rows) == config.arms * len(config.settings()) == len({tuple(row.values()) for row in rows})


@pytest.mark.slow
@pytest.mark.parametrize("executor", ["serial", "joblib"])
def test_a_study_killed_again_and_again_at_any_moment_ends_with_the_same_table(study_file, tmp_path, executor):
    """Ends of any kind, each some moments later than the last: what is on disk is sound, and nothing of it is lost."""
    path = study_file(("arms = 12", "arms = 40"), ("chunk = 5", "chunk = 1"))
    config, folder, kept = load_study(path), tmp_path / "killed", set()
    workers = ["--workers", "2"] if executor == "joblib" else []
    command = [*COMMAND, str(path), "--executor", executor, *workers, "--no-report", "--out", str(folder)]
    rng, patience = np.random.default_rng(0), 0.0
    for how in (signal.SIGKILL, signal.SIGTERM, signal.SIGKILL, signal.SIGINT, signal.SIGKILL, signal.SIGTERM):
        with subprocess.Popen(
            command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=os.environ | {"PYTHONPATH": str(ROOT)}
        ) as study:
            wanted = len(kept) + rng.integers(3)
            while study.poll() is None and len(chunks_of(folder)) <= wanted:
                time.sleep(0.01)
            patience += rng.uniform(0.0, 0.05)
            time.sleep(patience)
            study.send_signal(how)
        now = chunks_of(folder)
        assert now >= kept
        kept = now
        faults = {path.name: reason for path, reason in check_experiment(folder / "rows")}
        assert all(faults[name] is None for name in kept)
    resumed = run_study(config, folder, executor="serial")
    assert resumed["chunks_reused"] >= len(kept)
    assert resumed["table_sha256"] == run_study(config, tmp_path / "whole", executor="serial")["table_sha256"]
    assert all(reason is None or path.name.startswith(".") for path, reason in check_folder(folder))


def chunks_of(folder: Path) -> set[str]:
    return {path.name for path in (folder / "rows").glob("study-*.parquet")}


def test_a_finished_study_is_not_computed_again(config, folder):
    first = run_study(config, folder, executor="serial")
    times = {path: path.stat().st_mtime_ns for path in (folder / "rows").glob("*.parquet")}
    done = []
    again = run_study(config, folder, executor="serial", progress=lambda *arms: done.append(arms))
    assert again["table_sha256"] == first["table_sha256"] and done == [(5, 5)]
    assert {path: path.stat().st_mtime_ns for path in times} == times
    assert study_of(folder) == config


def truncated(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-100])


def emptied(path: Path) -> None:
    path.write_bytes(b"")


def altered(path: Path) -> None:
    """One number is another one; nothing but a checksum tells."""
    content = path.read_bytes()
    numbers = (struct.pack("<d", value) for value in pq.read_table(path)["error_mean_mm"].to_pylist())
    place = next(at for at in map(content.find, numbers) if at >= 0)
    path.write_bytes(content[:place] + bytes([content[place] ^ 1]) + content[place + 1 :])


def shortened(path: Path) -> None:
    """A sound file of fewer rows."""
    table = pq.read_table(path)
    pq.write_table(table.slice(0, table.num_rows - 1), path)


@pytest.mark.parametrize("damage", [truncated, emptied, altered, shortened])
def test_a_damaged_chunk_is_named_and_computed_again(config, folder, damage, chunk_file):
    first = run_study(config, folder, executor="serial")
    path = chunk_file(folder, 1)
    damage(path)
    with pytest.warns(UserWarning) as said:
        again = run_study(config, folder, executor="serial")
    assert len(said) == 1 and f"{path} is damaged" in str(said[0].message)
    assert again["chunks_reused"] == len(config.chunks()) - 1
    assert again["table_sha256"] == first["table_sha256"]


def test_a_folder_of_another_configuration_is_refused(config, folder):
    run_study(replace(config, arms=2), folder, executor="serial")
    before = table_sha256(folder)
    with pytest.raises(InputError, match=r"results of another configuration .*give another `folder`"):
        run_study(config, folder, executor="serial")
    assert table_sha256(folder) == before


def test_rows_of_two_arithmetics_are_not_mixed(config, folder):
    run_study(replace(config, arms=2), folder, executor="serial")
    with pytest.raises(InputError, match=r"computed arm by arm.*computed batched on cpu"):
        run_study(replace(config, arms=2), folder, executor="batched")
    run_study(replace(config, arms=2), folder, executor="joblib")


def test_rows_of_an_unknown_configuration_are_refused(config, folder):
    run_study(replace(config, arms=2), folder, executor="serial")
    (folder / "study.toml").unlink()
    with pytest.raises(InputError, match=r"no study\.toml"):
        run_study(replace(config, arms=2), folder, executor="serial")


def test_a_folder_without_results_says_so(tmp_path):
    with pytest.raises(InputError, match="holds no results"):
        read_rows(tmp_path)


def test_a_folder_with_a_configuration_of_its_own_is_left_alone(study_file):
    path = study_file()
    with pytest.raises(InputError, match=r"study\.toml is not the record of a results folder"):
        run_study(load_study(path), path.parent, executor="serial")
