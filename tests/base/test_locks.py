"""A run folder belongs to one process at a time, and to nobody once that process is gone."""

import errno
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Timer

import pytest

from pickenv.base import InputError, locked
from pickenv.inspect import recorded_run

RECORD = "run.json"

ROOT = Path(__file__).parents[2]
ENVIRONMENT = os.environ | {"PYTHONPATH": str(ROOT)}
HOLD = """
import sys
from pickenv.base import locked
with locked(sys.argv[1]):
    print("locked", flush=True)
    sys.stdin.read()
"""


@contextmanager
def elsewhere(folder: Path) -> Iterator[subprocess.Popen[str]]:
    """Another process that has ``folder`` locked."""
    pipe = subprocess.PIPE
    with subprocess.Popen(
        [sys.executable, "-c", HOLD, str(folder)], env=ENVIRONMENT, stdin=pipe, stdout=pipe, text=True
    ) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == "locked\n"
        try:
            yield other
        finally:
            other.kill()


def test_the_second_process_is_told_the_folder_and_who_is_in_it(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    folder.mkdir()
    with elsewhere(folder) as other:
        said = rf"another run \(process {other.pid}\) is at work in .*run; wait for its end, or give another folder"
        with pytest.raises(InputError, match=said), locked(folder):
            pytest.fail("two processes in one folder")
        other.communicate()
        with locked(folder):
            assert (folder / ".lock").read_text() == str(os.getpid())
    assert list(folder.iterdir()) == []


def test_a_process_that_waits_comes_in_when_the_other_one_is_gone(tmp_path: Path) -> None:
    with elsewhere(tmp_path) as other:
        Timer(0.5, other.communicate).start()
        with locked(tmp_path, wait=True):
            assert other.wait(10) == 0 and (tmp_path / ".lock").read_text() == str(os.getpid())


def test_a_folder_made_for_nothing_is_taken_away_and_no_other(tmp_path: Path) -> None:
    with locked(tmp_path / "new" / "run"):
        pass
    assert not (tmp_path / "new").exists()
    with locked(tmp_path / "new"):
        (tmp_path / "new" / "result.csv").touch()
    assert [path.name for path in (tmp_path / "new").iterdir()] == ["result.csv"]
    (tmp_path / "old").mkdir()
    with locked(tmp_path / "old"):
        pass
    assert (tmp_path / "old").is_dir()


def test_a_link_to_the_folder_is_the_folder(tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to(tmp_path / "run", target_is_directory=True)
    with elsewhere(tmp_path / "run"), pytest.raises(InputError, match="at work in"), locked(tmp_path / "link"):
        pytest.fail("two processes in one folder")


@pytest.mark.skipif(os.name == "nt", reason="POSIX signals")
def test_a_killed_process_leaves_the_folder_free(tmp_path: Path) -> None:
    with elsewhere(tmp_path) as other:
        other.send_signal(signal.SIGKILL)
        other.wait()
        assert (tmp_path / ".lock").exists()
        with locked(tmp_path):
            assert (tmp_path / ".lock").read_text() == str(os.getpid())
    assert list(tmp_path.iterdir()) == []


def test_what_the_owner_calls_may_lock_again_and_does_not_unlock(tmp_path: Path) -> None:
    with locked(tmp_path):
        with locked(tmp_path / ".." / tmp_path.name):
            pass
        code = f"from pickenv.base import locked\nwith locked({str(tmp_path)!r}): pass"
        done = subprocess.run([sys.executable, "-c", code], env=ENVIRONMENT, capture_output=True, text=True)
        assert f"process {os.getpid()}" in done.stderr


@pytest.mark.skipif(os.name == "nt", reason="POSIX locks")
@pytest.mark.parametrize("fault", [errno.ENOSYS, errno.ENOLCK, errno.ENOTSUP])
def test_on_a_file_system_without_locks_runs_go_on(fault: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def flock(handle: int, operation: int) -> None:
        raise OSError(fault, os.strerror(fault))

    monkeypatch.setattr("fcntl.flock", flock)
    with locked(tmp_path):
        (tmp_path / "result.csv").touch()
    assert [path.name for path in tmp_path.iterdir()] == ["result.csv"]


def test_an_error_unlocks(tmp_path: Path) -> None:
    with pytest.raises(RuntimeError, match="broken"), locked(tmp_path):
        raise RuntimeError("broken")
    with elsewhere(tmp_path):
        pass


def test_a_folder_that_cannot_be_made_is_named(tmp_path: Path) -> None:
    (tmp_path / "taken").write_text("a file, not a folder")
    with (
        pytest.raises(InputError, match=r"cannot write .*run: .*folder that can be written"),
        locked(tmp_path / "taken" / "run"),
    ):
        pytest.fail("locked a folder that is none")


def recording(folder: Path) -> None:
    with recorded_run(folder, "iso9283", "pickenv iso9283", 0):
        pytest.fail("two processes in one folder")


def studying(folder: Path) -> None:
    from pickenv.experiments import load_study, run_study

    run_study(load_study(ROOT / "scripts" / "tolerance_study.toml").quick(), folder, executor="serial")


def training(folder: Path) -> None:
    from pickenv.agents import Training, train

    train(Training("ppo", steps=1, arguments={"plant": "ideal"}), folder)


@pytest.mark.parametrize("run", [recording, studying, training])
def test_no_run_writes_into_a_folder_in_which_another_is_at_work(run: Callable[[Path], None], tmp_path: Path) -> None:
    (tmp_path / RECORD).write_text("the first run's")
    with elsewhere(tmp_path) as other:
        with pytest.raises(InputError, match=f"process {other.pid}"):
            run(tmp_path)
        assert sorted(path.name for path in tmp_path.iterdir()) == [".lock", RECORD]
        assert (tmp_path / RECORD).read_text() == "the first run's"


def test_a_demonstration_is_refused_before_it_computes(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "pickenv.cli", "demo", "--out", str(tmp_path)]
    with elsewhere(tmp_path) as other:
        done = subprocess.run(command, env=ENVIRONMENT, capture_output=True, text=True)
    assert done.returncode == 2
    assert f"process {other.pid}" in done.stderr and "Traceback" not in done.stderr
    assert "measuring" not in done.stderr
