"""`pickenv inspect`: which recordings a run has, what cannot be shown and why, and the ways to show it."""

from __future__ import annotations

import os
import re
import signal
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rerun.chunk import RrdReader
from typer.testing import CliRunner

from pickenv.base import InputError
from pickenv.cli import app
from pickenv.commands.comparing import inspect, recordings_of
from pickenv.experiments import PolicySettings, run_policies
from pickenv.experiments.policy_tables import write_evaluation
from pickenv.inspect import Comparison, record_comparison, recorded_run, save_part
from pickenv.inspect.recordings import viewing
from pickenv.inspect.recordings.viewing import check_recording, open_live

RERUN = Path(sys.executable).with_name("rerun")
ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def run(without_reaches: Comparison, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A demo's run folder without its recording."""
    folder = tmp_path_factory.mktemp("demo")
    with recorded_run(folder, "demo", "pickenv demo", 7):
        save_part(folder, without_reaches, without_reaches.seed)
    return folder


@pytest.fixture(scope="module")
def recording(without_reaches: Comparison, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record_comparison(without_reaches, tmp_path_factory.mktemp("one") / "errors.rrd")


def test_a_run_without_recording_gets_one_from_its_numbers(run: Path, recording: Path) -> None:
    (path,) = recordings_of(run)
    check_recording(path)
    compared = subprocess.run(
        [RERUN, "rrd", "compare", "--unordered", path, recording], capture_output=True, check=False
    )
    assert compared.returncode == 0
    stamp = path.stat().st_mtime_ns
    assert recordings_of(run) == [path]
    assert path.stat().st_mtime_ns == stamp


def test_every_recording_of_a_folder_is_opened_at_once(recording: Path, tmp_path: Path) -> None:
    for name in ("b", "a"):
        (tmp_path / f"{name}.rrd").write_bytes(recording.read_bytes())
    assert [path.name for path in recordings_of(tmp_path)] == ["a.rrd", "b.rrd"]
    assert recordings_of(tmp_path / "a.rrd") == [tmp_path / "a.rrd"]


def test_a_folder_that_is_no_run_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"holds no run\.json"):
        recordings_of(tmp_path)
    with pytest.raises(InputError, match="is no folder"):
        recordings_of(tmp_path / "nowhere")


def test_runs_without_a_recording_point_to_their_report(tmp_path: Path) -> None:
    with recorded_run(tmp_path, "iso9283", "pickenv iso9283", 0):
        pass
    with pytest.raises(InputError, match=r"kind 'iso9283' has no recording; .*pickenv report"):
        recordings_of(tmp_path)


def test_a_policy_is_asked_only_of_evaluations(run: Path) -> None:
    with pytest.raises(InputError, match="no --policy ppo"):
        recordings_of(run, "ppo")


def test_an_evaluation_shows_one_policy_with_all_its_compensations(
    reader: Callable[[Path], Any], tmp_path: Path
) -> None:
    settings = PolicySettings(
        policies=("scripted", "oracle"), compensations=("raw",), plants=("qiao2026",), arms=2, episodes=3, seeds=(4,)
    )
    rows = run_policies(settings)
    write_evaluation(settings, rows, tmp_path)
    (path,) = recordings_of(tmp_path, "oracle")
    assert path.name == "oracle.rrd"
    errors = reader(path).values("/metrics/error_mm/1_raw", "Scalars:scalars")
    np.testing.assert_allclose(errors, rows.where(policy="oracle")["error_mm"], rtol=6e-4)
    with pytest.raises(InputError, match="holds no policy 'ppo'; it holds scripted, oracle"):
        recordings_of(tmp_path, "ppo")


def of_version(recording: Path, path: Path, major: int, minor: int) -> Path:
    content = bytearray(recording.read_bytes())
    content[4:6] = bytes([major, minor])
    path.write_bytes(content)
    return path


def test_the_version_in_the_header_is_the_writers(recording: Path) -> None:
    import rerun as rr

    head = recording.read_bytes()[:8]
    assert head[:3] == b"RRF"
    assert f"{head[4]}.{head[5]}.{head[6]}" == rr.__version__


@pytest.mark.parametrize("minor", [30, 39, 42, 99])
def test_a_recording_of_another_rerun_is_named_with_both_versions(minor: int, recording: Path, tmp_path: Path) -> None:
    path = of_version(recording, tmp_path / "old.rrd", 0, minor)
    with pytest.raises(InputError, match=rf"old\.rrd was written by rerun 0\.{minor}, and 0\.41 is installed"):
        check_recording(path)


@pytest.mark.parametrize("minor", [40, 41])
def test_a_recording_of_the_version_before_is_shown(minor: int, recording: Path, tmp_path: Path) -> None:
    check_recording(of_version(recording, tmp_path / "old.rrd", 0, minor))


def test_missing_foreign_and_damaged_files_are_named(recording: Path, tmp_path: Path) -> None:
    content = recording.read_bytes()
    for name, text, complaint in (
        ("missing.rrd", None, r"cannot read .*missing\.rrd: No such file"),
        ("empty.rrd", b"", r"empty\.rrd is not a Rerun recording"),
        ("foreign.rrd", b"PK\x03\x04 a zip archive", r"foreign\.rrd is not a Rerun recording"),
        ("head.rrd", content[:8], r"head\.rrd is damaged"),
        ("noise.rrd", content[:64] + os.urandom(5000), r"noise\.rrd is damaged"),
    ):
        if text is not None:
            (tmp_path / name).write_bytes(text)
        with pytest.raises(InputError, match=complaint):
            check_recording(tmp_path / name)


def test_without_a_screen_there_is_one_sentence(recording: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(InputError, match=r"no screen to open a viewer on .* `pickenv inspect RUN --web`"):
        inspect(recording)


def test_the_viewer_is_this_pythons_and_keeps_to_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    """A package that is seen from another folder has no program beside this Python; and telemetry is off."""
    monkeypatch.delenv("CI", raising=False)
    monkeypatch.delenv("FORCE_RERUN_ANALYTICS", raising=False)
    said = subprocess.run(viewing.rerun_command(version=True), capture_output=True, text=True, check=True).stdout
    assert "0.41" in said and viewing.rerun_command()[:2] == [sys.executable, "-m"]
    assert viewing.viewer_environment() == {**os.environ, "CI": "1"}
    monkeypatch.setenv("FORCE_RERUN_ANALYTICS", "1")
    assert viewing.viewer_environment() == dict(os.environ)


def test_one_way_of_showing_at_a_time(recording: Path) -> None:
    with pytest.raises(InputError, match="exclude each other"):
        inspect(recording, web=True, serve=9999)


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@contextmanager
def pickenv_inspect(*arguments: str) -> Iterator[subprocess.Popen[str]]:
    """The command as a user starts it, interrupted as a user does."""
    command = [sys.executable, "-c", "from pickenv.cli import main; main()", "inspect", *arguments]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    process = subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        yield process
    finally:
        process.send_signal(signal.SIGINT)
        assert process.communicate(timeout=600)[1] == "ended: the recording is no longer served\n"


def taken_elsewhere(port: int) -> bool:
    """Whether ``port`` also takes connections that were not made to 127.0.0.1, as one bound to every address does."""
    try:
        socket.create_connection(("127.0.0.2", port), timeout=5.0).close()  # this machine too, by another address
    except OSError:
        return False
    return True


def listening(port: int) -> None:
    """Wait until somebody listens."""
    deadline = time.monotonic() + 600.0
    while True:
        try:
            socket.create_connection(("127.0.0.1", port), timeout=5.0).close()
            return
        except OSError:
            if time.monotonic() > deadline:
                raise
            time.sleep(0.1)


def answers(url: str) -> bytes:
    """What a server says, waiting for it to begin."""
    deadline = time.monotonic() + 600.0
    while True:
        try:
            with urllib.request.urlopen(url, timeout=5.0) as reply:
                return bytes(reply.read())
        except (urllib.error.URLError, ConnectionError):
            if time.monotonic() > deadline:
                raise
            time.sleep(0.2)


def test_web_serves_a_page_on_this_machine_alone_and_ends_with_ctrl_c(recording: Path) -> None:
    with pickenv_inspect(str(recording), "--web") as process:
        assert process.stdout is not None
        line = process.stdout.readline()
        address = next(word for word in line.split() if word.startswith("http://127.0.0.1:"))
        assert b"<html" in answers(address.partition("?")[0]).lower()
        ports = [int(port) for port in re.findall(r"127\.0\.0\.1(?::|%3A)(\d+)", address)]
        assert len(ports) == 2  # the page's and the recording's
        for port in ports:
            listening(port)
            assert not taken_elsewhere(port)
        foreign = urllib.request.Request(f"http://127.0.0.1:{ports[0]}/", headers={"Host": "pickenv.example"})
        with pytest.raises(urllib.error.HTTPError, match="403"):
            urllib.request.urlopen(foreign, timeout=60.0)
        with urllib.request.urlopen(address.partition("?")[0], timeout=60.0) as reply:
            policy = reply.headers["Content-Security-Policy"]
        assert re.findall(r"https?://\S+", policy) == [f"http://127.0.0.1:{ports[1]}"]  # and nobody else is asked
    assert process.returncode == 130
    with pytest.raises(urllib.error.URLError):
        urllib.request.urlopen(address.partition("?")[0], timeout=60.0)


@pytest.mark.slow
def test_a_recording_is_served_to_this_machine_alone(recording: Path) -> None:
    port = free_port()
    with pickenv_inspect(str(recording), "--serve", str(port)) as process:
        assert process.stdout is not None
        assert f"rerun+http://127.0.0.1:{port}/proxy" in process.stdout.readline()
        listening(port)
        assert not taken_elsewhere(port)
        allowed = {origin: allows(port, origin) for origin in ("https://pickenv.example", "http://127.0.0.1:8000")}
        assert allowed == {"https://pickenv.example": None, "http://127.0.0.1:8000": "http://127.0.0.1:8000"}
    assert process.returncode == 130


def allows(port: int, origin: str) -> str | None:
    """Which site a browser may let read the recording, when a page of ``origin`` asks for it."""
    address = f"http://127.0.0.1:{port}/rerun.sdk_comms.v1alpha1.MessageProxyService/ReadMessages"
    headers = {"Origin": origin, "Access-Control-Request-Method": "POST"}
    with urllib.request.urlopen(
        urllib.request.Request(address, method="OPTIONS", headers=headers), timeout=60.0
    ) as reply:
        return reply.headers["Access-Control-Allow-Origin"]


def test_what_is_served_while_it_grows_is_served_to_this_machine_alone() -> None:
    import rerun.blueprint as rrb

    port = free_port()
    stream = open_live("test-served", rrb.Blueprint(), serve=port)
    try:
        listening(port)
        assert not taken_elsewhere(port)
    finally:
        stream.disconnect()


def test_connect_sends_everything_to_a_viewer_that_runs(
    recording: Path, awaited: Callable[..., list[Any]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from rerun.chunk import RrdReader

    port, copy = free_port(), tmp_path / "copy.rrd"
    command = [RERUN, "--save", copy, "--port", str(port), "--bind", "127.0.0.1"]
    taker = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True)
    url = f"rerun+http://127.0.0.1:{port}/proxy"
    try:
        deadline = time.monotonic() + 600.0
        while time.monotonic() < deadline:
            try:
                viewing.check_answers(url)
                break
            except InputError:
                time.sleep(0.2)
        monkeypatch.setattr(viewing, "PATIENCE", 600.0)
        inspect(recording, connect=url)
        wanted = len(RrdReader(recording).stream().to_chunks())
        chunks = awaited(copy, lambda chunks: len(chunks) >= wanted)
        assert len(chunks) == wanted
    finally:
        os.killpg(taker.pid, signal.SIGTERM)
        taker.wait()


def test_connect_to_nobody_is_one_sentence(recording: Path) -> None:
    with pytest.raises(InputError, match="no viewer answers"):
        inspect(recording, connect=f"rerun+http://127.0.0.1:{free_port()}/proxy")


def test_a_recording_of_another_run_is_not_shown(tmp_path: Path) -> None:
    few = ["--compensation", "raw", "--feedback", "encoders", "--plant", "qiao2026", "--arms", 1, "--episodes", 3]
    few += ["--policy", "scripted", "--policy", "random", "--workers", 1, "--out", tmp_path]
    assert CliRunner().invoke(app, ["evaluate", *map(str, few)]).exit_code == 0
    assert [path.name for path in recordings_of(tmp_path, "random")] == ["random.rrd"]
    assert [path.name for path in recordings_of(tmp_path)] == ["scripted.rrd"]
    assert CliRunner().invoke(app, ["evaluate", *map(str, few), "--seed", "7"]).exit_code == 0
    (path,) = recordings_of(tmp_path)
    assert RrdReader(path).recordings()[0].recording_id == "qiao2026:seed7"
    with pytest.raises(InputError, match="leave --policy out"):
        recordings_of(path, "random")
