"""Ray adds no numbers: one process's table to the bit, on one node and on two, and in spite of killed processes."""

import json
import os
import signal
import socket
import subprocess
import sys
import time
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace
from unittest import mock

import pytest

from pickenv.base import InputError
from pickenv.experiments import executors, load_study, read_rows, run_study

ROOT = Path(__file__).parents[2]
ENVIRONMENT = {name: value for name, value in os.environ.items() if name != "RAY_ADDRESS"} | {"PYTHONPATH": str(ROOT)}
COMMAND = [sys.executable, "-c", "from pickenv.cli import main; main()", "study"]
pytestmark = pytest.mark.skipif(find_spec("ray") is None, reason="the extra pickenv[ray] is not installed")

LOCAL = """
import json, sys, threading
from pathlib import Path
import psutil
from pickenv.experiments import load_study, run_study

found = {"killed": None, "listens": []}

def watch():  # as soon as a process works on a chunk: who listens where, and kill it
    me = psutil.Process()
    while found["killed"] is None:
        family = [me, *me.children(recursive=True)]
        for process in family[1:]:
            try:
                if " ".join(process.cmdline()).startswith("ray::PoolActor.run_batch"):
                    found["listens"] = [c.laddr.ip for p in family for c in p.net_connections() if c.status == "LISTEN"]
                    process.kill()
                    found["killed"] = process.pid
                    break
            except psutil.Error:
                continue

threading.Thread(target=watch, daemon=True).start()
summary = run_study(load_study(sys.argv[1]), Path(sys.argv[2]), executor="ray", workers=2)
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
    there = os.environ | {"RAY_ADDRESS": cluster.address}
    subprocess.run([*command, "--out", sys.argv[2], "--json", sys.argv[3]], check=True, env=there)
finally:
    cluster.shutdown()
"""

HOPELESS = """
import os, signal
from pickenv.base import InputError
from pickenv.experiments import spread

def dies(number):
    os.kill(os.getpid(), signal.SIGKILL)

def refuses(number):
    raise InputError(f"piece {number} is impossible")

for work in (dies, refuses):
    try:
        list(spread(work, [7], "ray", 2))
    except InputError as error:
        print(error)
"""


@pytest.fixture
def study(study_file):
    """A study of 100 arms in twenty chunks."""
    return study_file(("arms = 12", "arms = 100"))


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
    with subprocess.Popen(
        [*COMMAND, str(study), "--executor", "ray", "--workers", "2", "--out", str(folder)],
        stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, env=ENVIRONMENT, start_new_session=True,
    ) as driver:  # fmt: skip
        while driver.poll() is None and len(list((folder / "rows").glob("study-*.parquet"))) < 3:
            time.sleep(0.01)
        assert driver.poll() is None, driver.stderr.read()
        assert ray_processes(driver.pid)
        os.kill(driver.pid, signal.SIGKILL)
    gone = time.monotonic() + 600.0
    while ray_processes(driver.pid) and time.monotonic() < gone:
        time.sleep(0.2)
    assert not ray_processes(driver.pid)
    done = len(list((folder / "rows").glob("study-*.parquet")))
    assert 0 < done < len(config.chunks())
    again = json.loads(run_script(LOCAL, study, folder).splitlines()[-1])
    assert again["table_sha256"] == expected(study, tmp_path / "serial")
    rows = read_rows(folder).to_table(columns=["arm", "setting"]).to_pylist()
    assert len(rows) == config.arms * len(config.settings()) == len({tuple(row.values()) for row in rows})


@pytest.mark.slow
def test_a_piece_that_always_kills_its_process_and_one_that_is_refused_are_told_apart():
    died, refused = run_script(HOPELESS).splitlines()[-2:]  # above them Ray tells of each death
    assert died.startswith("the processes that worked on piece 7 died 4 times")
    assert refused == "piece 7 is impossible"


class Listening:
    """In Ray's place: it notes how it is started, and gives up a number of times, in Ray's words."""

    def __init__(self, failures: int = 0) -> None:
        self.failures, self.starts, self.environment, self.options = failures, 0, {}, {}
        self.util = SimpleNamespace(joblib=SimpleNamespace(register_ray=lambda: None))

    def is_initialized(self) -> bool:
        return False

    def init(self, **options) -> None:
        self.starts, self.environment, self.options = self.starts + 1, dict(os.environ), options
        if self.starts <= self.failures:
            raise Exception("The current node timed out during startup. This could happen because of much.")

    def shutdown(self) -> None:
        """Nothing was started."""


@pytest.fixture
def joined(monkeypatch):
    """Starts work on what stands in Ray's place, in this environment."""

    def start(ray: Listening, **environment: str) -> Listening:
        for name, module in (("ray", ray), ("ray.util", ray.util), ("ray.util.joblib", ray.util.joblib)):
            monkeypatch.setitem(sys.modules, name, module)
        with mock.patch.dict(os.environ, ENVIRONMENT | environment, clear=True):
            executors._joined_ray(2)
        return ray

    return start


@pytest.fixture
def address():
    """Where something listens."""
    with socket.socket() as there:
        there.bind(("127.0.0.1", 0))
        there.listen()
        yield f"127.0.0.1:{there.getsockname()[1]}"


def test_a_cluster_of_ones_own_listens_to_this_machine_alone_and_asks_for_a_token(joined):
    ray = joined(Listening(), RAY_AUTH_MODE="disabled", RAY_AUTH_TOKEN="")
    assert ray.environment["RAY_AUTH_MODE"] == "token"
    assert len(ray.environment["RAY_AUTH_TOKEN"]) >= 32
    assert ray.environment["RAY_USAGE_STATS_ENABLED"] == "0"
    assert ray.options["_node_ip_address"] == "127.0.0.1" and ray.options["num_cpus"] == 2
    assert ray.options["include_dashboard"] is False and ray.options["address"] == "local"


def test_a_cluster_that_is_already_there_is_taken_as_it_is(joined, address):
    ray = joined(Listening(), RAY_ADDRESS=address, RAY_AUTH_MODE="disabled")
    assert ray.environment["RAY_ADDRESS"] == address and ray.environment["RAY_AUTH_MODE"] == "disabled"
    assert not {"_node_ip_address", "num_cpus"} & set(ray.options)


def test_a_slow_start_is_tried_again_and_a_cluster_that_refuses_is_not(joined, address):
    assert joined(Listening(executors.STARTS - 1)).starts == executors.STARTS
    for failures, environment, starts in ((executors.STARTS, {}, executors.STARTS), (1, {"RAY_ADDRESS": address}, 1)):
        ray = Listening(failures)
        with pytest.raises(InputError, match=r"cannot be used at .*: The current node timed out during startup;"):
            joined(ray, **environment)
        assert ray.starts == starts


@pytest.mark.parametrize("scheme", ["", "ray://"])
def test_an_address_where_nothing_answers_is_refused_at_once(joined, scheme):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        address = f"{scheme}127.0.0.1:{taken.getsockname()[1]}"  # bound and not listening: refused
        with pytest.raises(InputError, match=f"no Ray cluster answers at {address}: .*start one with"):
            joined(Listening(), RAY_ADDRESS=address)


@pytest.mark.parametrize("address", ["localhost:0", "localhost:99999", "ray://:", "localhost:six"])
def test_what_is_no_address_is_refused(joined, address):
    with pytest.raises(InputError, match=f"no Ray cluster answers at {address}: "):
        joined(Listening(), RAY_ADDRESS=address)
