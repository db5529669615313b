"""Executors add no numbers of their own: the same rows to the bit, whoever works, and in spite of dying processes."""

import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest

from pickenv.base import InputError
from pickenv.experiments import load_study, run_study, spread, table_sha256

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("backend", ["serial", "loky"])
def test_every_piece_comes_back_once(backend):
    assert dict(spread(abs, [4, 1, 7, 2, 9], backend, 2)) == {number: number for number in (4, 1, 7, 2, 9)}


def test_joblib_gives_the_table_of_one_process_to_the_bit(study_file, tmp_path, chunk_file):
    config = replace(load_study(study_file()), it_grades=(12,), poses=(20,), arms=5, chunk=2)
    serial = run_study(config, tmp_path / "serial", executor="serial")
    folder = tmp_path / "joblib"
    summary = run_study(config, folder, executor="joblib", workers=2)
    assert summary["table_sha256"] == serial["table_sha256"]
    assert summary["yield"] == serial["yield"] and summary["quantiles_mm"] == serial["quantiles_mm"]
    for chunk in config.chunks():
        one, other = (chunk_file(place, chunk) for place in (folder, tmp_path / "serial"))
        assert one.name == other.name and one.read_bytes() == other.read_bytes()
    assert table_sha256(tmp_path / "serial") == serial["table_sha256"]


def test_the_pieces_of_a_killed_worker_are_tried_again(tmp_path):
    mark = tmp_path / "killed"

    def work(number: int) -> int:
        if number == 2 and not mark.exists():
            mark.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return -number

    assert sorted(spread(work, range(5), "loky", 2)) == [(number, -number) for number in range(5)]
    assert mark.exists()


@pytest.mark.slow
def test_a_piece_that_always_kills_its_worker_ends_the_work_with_one_sentence():
    def work(number: int) -> None:
        if number == 1:
            os.kill(os.getpid(), signal.SIGKILL)

    with pytest.raises(InputError, match=r"died 4 times.*run it again to go on"):
        list(spread(work, [0, 1], "loky", 2))


ORPHANS = """
import os, sys, time
from pathlib import Path
from pickenv.experiments import spread

def work(number):
    Path(sys.argv[1], str(os.getpid())).touch()
    time.sleep(3600.0)

list(spread(work, [0, 1], "loky", 2))
"""


@pytest.mark.slow
@pytest.mark.skipif(
    not Path("/proc/self/stat").exists(), reason="needs /proc to tell a running process from an ended one"
)
def test_workers_end_with_a_killed_driver(tmp_path):
    command = [sys.executable, "-c", ORPHANS, str(tmp_path)]
    with subprocess.Popen(command, env=os.environ | {"PYTHONPATH": str(ROOT)}) as driver:
        while driver.poll() is None and len(list(tmp_path.iterdir())) < 2:
            time.sleep(0.05)
        driver.kill()
    workers = [int(path.name) for path in tmp_path.iterdir()]
    assert len(workers) == 2
    patience = time.monotonic() + 600.0
    while any(map(running, workers)) and time.monotonic() < patience:
        time.sleep(0.1)
    assert not any(map(running, workers))


def running(process: int) -> bool:
    try:
        state = Path(f"/proc/{process}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()[0]
    except (FileNotFoundError, ProcessLookupError):
        return False
    return state != "Z"


def test_an_error_of_the_work_is_not_taken_for_a_death():
    def work(number: int) -> None:
        raise InputError(f"piece {number} is impossible")

    with pytest.raises(InputError, match="piece 0 is impossible"):
        list(spread(work, [0], "loky", 1))


def test_after_a_piece_that_fails_none_is_begun_and_those_begun_are_still_yielded(tmp_path):
    def work(number: int) -> int:
        (tmp_path / str(number)).touch()
        while not (tmp_path / "0").exists() or not (tmp_path / "1").exists():
            time.sleep(0.01)
        if number == 0:
            raise ZeroDivisionError("piece 0 divides by nothing")
        time.sleep(0.5)
        return number

    done = []
    with pytest.raises(ZeroDivisionError, match="piece 0 divides by nothing") as caught:
        for number, _ in spread(work, range(50), "loky", 2):
            done.append(number)
    assert sorted(done) == sorted(int(path.name) for path in tmp_path.iterdir() if path.name != "0")
    assert 1 in done and len(done) < 5
    assert "in work" in caught.value.__notes__[0]  # the line of the worker at fault


def test_an_unknown_executor_is_answered_with_the_known_ones(study_file, tmp_path):
    with pytest.raises(InputError, match="unknown executor 'ray'; give one of serial, joblib, batched"):
        run_study(load_study(study_file()), tmp_path / "out", executor="ray")
    assert not (tmp_path / "out").exists()


def test_an_executor_whose_extra_is_missing_names_it(study_file, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "joblib", None)
    with pytest.raises(InputError, match=r"this needs joblib, .*pip install 'pickenv\[study\]'"):
        run_study(load_study(study_file()), tmp_path / "out", executor="joblib")
