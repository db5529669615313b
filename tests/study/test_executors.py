"""Executors add no numbers of their own: the same rows to the bit, whoever works, and in spite of dying processes."""

import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pyarrow as pa
import pytest
from pickenv.study.design.config import load_study
from pickenv.study.results.row_table import chunk_path
from pickenv.study.results.study_folder import table_sha256
from pickenv.study.running.run_study import run_study
from pickenv.study.running.runners import Crew, load_executor, run_joblib, run_serial

from pickenv.errors import InputError

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("run", [run_serial, run_joblib])
def test_every_chunk_comes_back_once(run):
    work = lambda chunk: pa.table({"chunk": [chunk]})  # noqa: E731
    found = dict(run([4, 1, 7, 2, 9], work, Crew(2)))
    assert sorted(found) == [1, 2, 4, 7, 9]
    assert all(rows["chunk"].to_pylist() == [chunk] for chunk, rows in found.items())


def test_joblib_gives_the_table_of_one_process_to_the_bit(study_file, tmp_path):
    config = replace(load_study(study_file()), it_grades=(12,), poses=(20,), chunk=3)
    serial = run_study(config, tmp_path / "serial", executor="serial")
    for workers in (1, 2):
        folder = tmp_path / f"joblib{workers}"
        summary = run_study(config, folder, executor="joblib", crew=Crew(workers))
        assert summary["table_sha256"] == serial["table_sha256"]
        assert summary["yield"] == serial["yield"] and summary["quantiles_mm"] == serial["quantiles_mm"]
        for chunk in config.chunks():
            assert chunk_path(folder, chunk).read_bytes() == chunk_path(tmp_path / "serial", chunk).read_bytes()
    assert table_sha256(tmp_path / "serial") == serial["table_sha256"]


def test_the_chunks_of_a_killed_worker_are_tried_again(tmp_path):
    mark = tmp_path / "killed"

    def work(chunk: int) -> pa.Table:
        if chunk == 2 and not mark.exists():
            mark.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return pa.table({"chunk": [chunk]})

    found = list(run_joblib(range(5), work, Crew(2)))
    assert mark.exists()
    assert sorted(chunk for chunk, _ in found) == [0, 1, 2, 3, 4]


def test_a_chunk_that_always_kills_its_worker_ends_the_study_with_one_sentence():
    def work(chunk: int) -> pa.Table:
        if chunk == 1:
            os.kill(os.getpid(), signal.SIGKILL)
        return pa.table({"chunk": [chunk]})

    with pytest.raises(InputError, match=r"died 4 times.*run the study again"):
        list(run_joblib([0, 1], work, Crew(2)))


ORPHANS = """
import os, sys, time
from pathlib import Path
from pickenv.study.running.runners import Crew, run_joblib

def work(chunk):
    Path(sys.argv[1], str(os.getpid())).touch()
    time.sleep(3600.0)

list(run_joblib([0, 1], work, Crew(2)))
"""


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
    def work(chunk: int) -> pa.Table:
        raise InputError(f"chunk {chunk} is impossible")

    with pytest.raises(InputError, match="chunk 0 is impossible"):
        list(run_joblib([0], work, Crew(1)))


def test_an_unknown_executor_is_answered_with_the_known_ones(study_file, tmp_path):
    with pytest.raises(InputError, match="unknown executor 'dask'; give one of serial, joblib, ray or batched"):
        run_study(load_study(study_file()), tmp_path / "out", executor="dask")
    assert not (tmp_path / "out").exists()


def test_an_executor_whose_extra_is_missing_names_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(InputError, match=r"this needs ray, .*pip install 'pickenv\[ray\]'"):
        load_executor("ray")
