"""Ray adds no numbers: one process's table to the bit, on one node and on two, and in spite of killed processes."""

import json
import os
import signal
import socket
import subprocess
import sys
import time
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace
from unittest import mock

import pytest
from pickenv.study.design.config import load_study
from pickenv.study.results.row_table import chunk_path
from pickenv.study.results.study_folder import read_rows
from pickenv.study.running.run_study import run_study
from pickenv.study.running.runners import Crew, load_executor

from pickenv.errors import InputError

ROOT = Path(__file__).parents[2]
ENVIRONMENT = os.environ | {"PYTHONPATH": str(ROOT), "RAY_ADDRESS": "127.0.0.1:1"}  # nothing answers there
pytestmark = pytest.mark.skipif(find_spec("ray") is None, reason="the extra pickenv[ray] is not installed")

LOCAL = """
import json, sys, threading
from pathlib import Path
import psutil
from pickenv.study.design.config import load_study
from pickenv.study.running.runners import Crew
from pickenv.study.running.run_study import run_study

found = {"killed": None, "listens": []}

def watch():  # as soon as a process works on a chunk: who listens where, and kill it
    me = psutil.Process()
    while found["killed"] is None:
        family = [me, *me.children(recursive=True)]
        for process in family[1:]:
            try:
                if " ".join(process.cmdline()).startswith("ray::_rows"):  # no child that is still this script
                    found["listens"] = [c.laddr.ip for p in family for c in p.net_connections() if c.status == "LISTEN"]
                    process.kill()
                    found["killed"] = process.pid
                    break
            except psutil.Error:
                continue

threading.Thread(target=watch, daemon=True).start()
summary = run_study(load_study(sys.argv[1]), Path(sys.argv[2]), executor="ray", crew=Crew(2))
print(json.dumps(found | {"table_sha256": summary["table_sha256"]}))
"""

TWO_NODES = """
import json, os, secrets, sys
os.environ |= {"RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0", "RAY_USAGE_STATS_ENABLED": "0"}
os.environ |= {"RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN": secrets.token_hex(32)}
import subprocess
from ray.cluster_utils import Cluster

node = {"num_cpus": 1, "object_store_memory": 2**27}
cluster = Cluster(initialize_head=True, head_node_args={"include_dashboard": False, **node})
cluster.add_node(**node)
try:
    command = [sys.executable, "-c", "from pickenv.cli import main; main()", "study", sys.argv[1], "--executor", "ray"]
    subprocess.run([*command, "--address", cluster.address, "--out", sys.argv[2], "--json", sys.argv[3]], check=True)
finally:
    cluster.shutdown()
"""

HOPELESS = """
import os, signal
from pickenv.errors import InputError
from pickenv.study.running.runners import Crew
from pickenv.study.running.ray_runner import run_ray

def dies(chunk):
    os.kill(os.getpid(), signal.SIGKILL)

def refuses(chunk):
    raise InputError(f"chunk {chunk} is impossible")

for work in (dies, refuses):
    try:
        list(run_ray([7], work, Crew(1)))
    except InputError as error:
        print(error)
"""


@pytest.fixture
def study(study_file):
    """A study of twenty chunks of about a third of a second."""
    return study_file(("arms = 12", "arms = 40"), ("chunk = 5", "chunk = 2"))


def expected(path, folder):
    return run_study(load_study(path), folder, executor="serial")["table_sha256"]


def run_script(script, *arguments):
    ended = subprocess.run(
        [sys.executable, "-c", script, *map(str, arguments)], capture_output=True, text=True, env=ENVIRONMENT
    )
    assert ended.returncode == 0, ended.stderr
    return ended.stdout


def ray_processes(session: int) -> list[int]:
    """Ray's processes of a session of processes."""
    import psutil

    found = []
    for process in psutil.process_iter(["cmdline"]):
        words = " ".join(process.info["cmdline"] or ())
        if ("raylet" in words or "gcs_server" in words) and os.getsid(process.pid) == session:
            found.append(process.pid)
    return found


@pytest.mark.slow
def test_a_local_cluster_gives_the_table_of_one_process_listens_on_loopback_and_outlives_a_worker(study, tmp_path):
    found = json.loads(run_script(LOCAL, study, tmp_path / "ray").splitlines()[-1])
    assert found["killed"] is not None
    assert found["listens"] and all(ip.removeprefix("::ffff:").startswith("127.") for ip in found["listens"])
    assert found["table_sha256"] == expected(study, tmp_path / "serial")


@pytest.mark.slow
def test_two_nodes_give_the_table_of_one_process(study, tmp_path):
    run_script(TWO_NODES, study, tmp_path / "ray", tmp_path / "ray.json")
    summary = json.loads((tmp_path / "ray.json").read_text(encoding="utf-8"))
    assert summary["executor"] == "ray" and summary["chunks_reused"] == 0
    assert summary["table_sha256"] == expected(study, tmp_path / "serial")


@pytest.mark.slow
def test_a_killed_driver_leaves_no_process_and_its_study_goes_on(study, tmp_path):
    config, folder = load_study(study), tmp_path / "ray"
    command = [sys.executable, "-c", "from pickenv.cli import main; main()", "study", str(study), "--executor", "ray"]
    with subprocess.Popen(
        [*command, "--workers", "2", "--out", str(folder)],
        stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, env=ENVIRONMENT, start_new_session=True,
    ) as driver:  # fmt: skip
        while driver.poll() is None and not chunk_path(folder, 3).exists():
            time.sleep(0.01)
        assert driver.poll() is None, driver.stderr.read()
        assert ray_processes(driver.pid)
        os.kill(driver.pid, signal.SIGKILL)
    gone = time.monotonic() + 600.0
    while ray_processes(driver.pid) and time.monotonic() < gone:
        time.sleep(0.2)
    assert not ray_processes(driver.pid)
    done = len(list((folder / "rows").glob("chunk-*.parquet")))
    assert 0 < done < len(config.chunks())
    again = json.loads(run_script(LOCAL, study, folder).splitlines()[-1])
    assert again["table_sha256"] == expected(study, tmp_path / "serial")
    rows = read_rows(folder).to_table(columns=["arm", "setting"]).to_pylist()
    assert len(rows) == config.arms * len(config.settings()) == len({tuple(row.values()) for row in rows})


@pytest.mark.slow
def test_a_chunk_that_always_kills_its_process_and_one_that_is_refused_are_told_apart():
    died, refused = run_script(HOPELESS).splitlines()[-2:]  # above them Ray tells of each death
    assert died.startswith("the processes that worked on chunk 7 died 4 times")
    assert refused == "chunk 7 is impossible"


class SlowToStart:
    """In Ray's place: it gives up a number of times, in Ray's words, as on a busy machine."""

    def __init__(self, failures: int) -> None:
        self.failures, self.starts = failures, 0

    def init(self) -> None:
        self.starts += 1
        if self.starts <= self.failures:
            raise Exception(
                "The current node timed out during startup. This could happen because of much."
            )  # as Ray does

    def shutdown(self) -> None:
        """Nothing was started."""


def test_a_slow_start_is_tried_again_and_a_cluster_that_refuses_is_not():
    from pickenv.study.running.ray_runner import STARTS, start

    slow, hopeless, refusing = SlowToStart(STARTS - 1), SlowToStart(STARTS), SlowToStart(1)
    start(slow, {}, Crew(1))
    assert slow.starts == STARTS
    for ray, crew, starts in ((hopeless, Crew(1), STARTS), (refusing, Crew(1, "host:1"), 1)):
        with pytest.raises(InputError, match=r"cannot be used at .*: The current node timed out during startup; Ray's"):
            start(ray, {}, crew)
        assert ray.starts == starts


class Listening:
    """In Ray's place: it notes how it is started, and has nothing to do."""

    def __init__(self) -> None:
        self.environment, self.options = {}, {}
        self.util = SimpleNamespace(get_node_ip_address=lambda: "127.0.0.1")
        self.exceptions = SimpleNamespace(RayTaskError=KeyError)

    def init(self, **options) -> None:
        self.environment, self.options = dict(os.environ), options

    def remote(self, **_):
        return lambda work: work

    def put(self, work):
        return work

    def cluster_resources(self):
        return {"CPU": 1.0}

    def shutdown(self) -> None:
        """Nothing was started."""


def test_a_cluster_of_ones_own_listens_to_this_machine_alone_and_asks_for_a_token(monkeypatch):
    ray = Listening()
    monkeypatch.setitem(sys.modules, "ray", ray)
    with mock.patch.dict(os.environ, {"RAY_AUTH_MODE": "disabled", "RAY_AUTH_TOKEN": ""}):
        assert list(load_executor("ray")([], len, Crew(1))) == []
    assert ray.environment["RAY_AUTH_MODE"] == "token"
    assert len(ray.environment["RAY_AUTH_TOKEN"]) >= 32
    assert ray.environment["RAY_USAGE_STATS_ENABLED"] == "0"
    assert ray.options["_node_ip_address"] == "127.0.0.1" and ray.options["address"] == "local"
    assert ray.options["include_dashboard"] is False


@pytest.mark.parametrize("address", ["here", "host:0", "host:99999", "ray://", "host:six", ":6379"])
def test_what_is_no_address_is_refused(address):
    run = load_executor("ray")
    with pytest.raises(InputError, match="names no Ray cluster; give host:port or ray://host:port"):
        next(run([0], len, Crew(1, address)))


@pytest.mark.parametrize("scheme", ["", "ray://"])
def test_an_address_where_nothing_answers_is_refused_at_once(study_file, tmp_path, scheme):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        address = f"{scheme}127.0.0.1:{taken.getsockname()[1]}"  # bound and not listening: refused
        config = replace(load_study(study_file()), arms=1)
        with pytest.raises(InputError, match=f"no Ray cluster answers at {address}: .*start one with"):
            run_study(config, tmp_path / "out", executor="ray", crew=Crew(1, address))


def test_an_address_where_something_else_answers_is_refused_in_seconds():
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        address = f"127.0.0.1:{other.getsockname()[1]}"
        with pytest.raises(InputError, match=f"what answers at {address} is no Ray cluster"):
            next(load_executor("ray")([0], len, Crew(1, address)))
