"""Where the chunks of a study are worked on: in this process, in processes of this machine, or on a Ray cluster.

An executor takes chunk numbers and the work on one chunk, and yields (chunk, rows) in any order. It adds no numbers of
its own, so that the rows are the same to the bit on every one of them.
"""

from __future__ import annotations

import ipaddress
import logging
import os
import secrets
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from importlib import import_module
from importlib.util import find_spec
from typing import Any, TypeVar

import pyarrow as pa

from pickenv.errors import InputError
from pickenv.extras import require

Rows = TypeVar("Rows")
Work = Callable[[int], Rows]
"""Rows of a chunk; it can be sent to another process."""

ATTEMPTS = 4
"""How often a chunk is tried when the processes that work on it die."""


@dataclass(frozen=True)
class Crew:
    """Who works.

    Attributes:
        workers: Processes; as many as the machine has cores when None.
        address: Of a Ray cluster, ``host:port`` or ``ray://host:port``; a local one is started when None.
    """

    workers: int | None = None
    address: str | None = None

    def for_executor(self, name: str) -> Crew:
        """This crew, refused where the executor of that name would pass over its address.

        Raises:
            InputError: If there is an address, and the executor has no cluster.
        """
        if self.address is not None and name != "ray":
            raise InputError(
                f"address {self.address} is of a Ray cluster, and executor '{name}' works on this machine; give "
                "executor ray, or leave the address out"
            )
        return self

    def count(self) -> int:
        """Number of processes on this machine."""
        from joblib import cpu_count

        return self.workers or int(cpu_count())


Executor = Callable[[Sequence[int], Work[Any], Crew], Iterator[tuple[int, Any]]]

EXECUTORS: Mapping[str, tuple[str, str]] = {
    "serial": ("pickenv.study.running.runners", "run_serial"),
    "joblib": ("pickenv.study.running.runners", "run_joblib"),
    "ray": ("pickenv.study.running.runners", "run_ray"),
}
"""Module and function of each executor; Ray's is an extra, loaded when it is asked for."""


def load_executor(name: str) -> Executor:
    """The executor of that name.

    Raises:
        InputError: If there is none, or the extra that it needs is not installed.
    """
    if name not in EXECUTORS:
        raise InputError(f"unknown executor '{name}'; give one of {', '.join(EXECUTORS)} or batched")
    module, function = EXECUTORS[name]
    if name == "ray":
        require("ray")
    executor: Executor = getattr(import_module(module), function)
    return executor


def run_serial(chunks: Sequence[int], work: Work[Rows], crew: Crew) -> Iterator[tuple[int, Rows]]:
    """One chunk after the other, in this process."""
    for chunk in chunks:
        yield chunk, work(chunk)


def run_joblib(chunks: Sequence[int], work: Work[Rows], crew: Crew) -> Iterator[tuple[int, Rows]]:
    """Chunks in processes of this machine; those of a process that dies are tried again.

    Raises:
        InputError: If processes keep dying.
    """
    from joblib import Parallel, delayed
    from joblib.externals.loky.process_executor import TerminatedWorkerError

    left = list(chunks)
    for _ in range(ATTEMPTS):
        parallel = Parallel(n_jobs=crew.count(), return_as="generator_unordered", pre_dispatch="2*n_jobs", batch_size=1)
        try:
            for chunk, rows in parallel(delayed(_numbered)(chunk, work, os.getpid()) for chunk in left.copy()):
                left.remove(chunk)
                yield chunk, rows
        except TerminatedWorkerError:
            continue
        return
    raise given_up(left)


def given_up(left: Sequence[int]) -> InputError:
    """Said when chunks could not be computed because the processes that worked on them died each time."""
    return InputError(
        f"the processes that worked on chunk {left[0]} died {ATTEMPTS} times ({len(left)} chunks are left); give fewer "
        "workers or a smaller chunk if memory ran out, and run the study again to go on"
    )


def _numbered(chunk: int, work: Work[Rows], driver: int) -> tuple[int, Rows]:
    _end_with(driver)
    return chunk, work(chunk)


@lru_cache(maxsize=1)
def _end_with(driver: int) -> None:
    """Let this worker end when its driver is killed; it would wait for ever for somebody to take its rows."""

    def watch() -> None:
        while os.getppid() == driver:
            time.sleep(1.0)
        os._exit(1)

    if os.getppid() == driver:  # a single worker is the driver itself
        threading.Thread(target=watch, daemon=True).start()


# Chunks of a study on Ray: a cluster on this machine that listens on loopback only, or one that is already there.
# Needs the extra ``pickenv[ray]``; machines of a cluster need pickenv and Ray at the versions of this one.


if find_spec("ray") is None:  # said now; imported later, because Ray reads its environment when it is imported
    raise ModuleNotFoundError("No module named 'ray'", name="ray")

LOOPBACK = "127.0.0.1"
ALONE = {
    "RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0",  # works on Linux too; without it Ray takes the machine's outer address
    "RAY_AUTH_MODE": "token",
    "RAY_AUTH_TOKEN": secrets.token_hex(32),  # other users of this machine cannot send work; no token file is written
}
"""Environment of a local cluster."""
UNCOUNTED = {"RAY_USAGE_STATS_ENABLED": "0"}
"""No report to Ray's makers."""
ANSWER_SECONDS = 5.0
"""Time that an address has to take a connection."""
STARTS = 3
"""How often a local cluster is started before the study gives up."""
STORE_BYTES = 2**28
"""Of a local cluster's shared memory: finished chunks wait there until they are written."""


def run_ray(chunks: Sequence[int], work: Work[pa.Table], crew: Crew) -> Iterator[tuple[int, pa.Table]]:
    """Chunks in Ray's processes; those of a process or a machine that dies are tried again.

    Raises:
        InputError: If no Ray cluster answers at the crew's address, or processes keep dying.
    """
    with _cluster(crew) as (ray, cores):
        remote = ray.remote(max_retries=ATTEMPTS - 1, num_cpus=1)(_rows)
        shared, left, waiting = ray.put(work), list(chunks), {}
        try:
            for chunk in chunks:
                waiting[remote.remote(shared, chunk)] = chunk
                if len(waiting) >= 2 * cores:
                    yield from _finished(ray, waiting, left)
            while waiting:
                yield from _finished(ray, waiting, left)
        except ray.exceptions.RayTaskError as error:
            raise (error.cause if isinstance(error.cause, Exception) else error) from None
        except (ray.exceptions.WorkerCrashedError, ray.exceptions.RaySystemError, ray.exceptions.ObjectLostError):
            raise given_up(left) from None


def _rows(work: Work[pa.Table], chunk: int) -> pa.Table:
    return work(chunk)


def _finished(ray: Any, waiting: dict[Any, int], left: list[int]) -> Iterator[tuple[int, pa.Table]]:
    """Wait for one chunk."""
    (done,), _ = ray.wait(list(waiting), num_returns=1)
    rows = ray.get(done)
    chunk = waiting.pop(done)
    left.remove(chunk)
    yield chunk, rows


@contextmanager
def _cluster(crew: Crew) -> Iterator[tuple[Any, int]]:
    """Ray, connected, and its number of cores; on leaving, disconnected, and a local cluster ended."""
    if crew.address is not None:
        _check_answers(crew.address)
    os.environ.update(UNCOUNTED | (ALONE if crew.address is None else {}))
    loaded_before = "ray" in sys.modules
    ray: Any = import_module("ray")
    options: dict[str, Any] = {"log_to_driver": False, "logging_level": logging.ERROR}
    if crew.address is None:
        options |= {"num_cpus": crew.count(), "include_dashboard": False, "object_store_memory": STORE_BYTES}
        options |= {"_node_ip_address": LOOPBACK, "address": "local"}  # never one that another program started
    else:
        options |= {"address": crew.address}
    start(ray, options, crew)
    try:
        if crew.address is None and not ipaddress.ip_address(ray.util.get_node_ip_address()).is_loopback:
            hint = "import ray later" if loaded_before else "name a cluster of yours with --address"
            raise InputError(f"Ray would listen beyond this machine; {hint}")
        yield ray, max(int(ray.cluster_resources().get("CPU", 1)), 1)
    finally:
        ray.shutdown()


def start(ray: Any, options: dict[str, Any], crew: Crew) -> None:
    """Join a cluster, or start one: again where Ray gave up after its 30 s, which a busy machine may need."""
    for left in reversed(range(STARTS if crew.address is None else 1)):
        try:
            ray.init(**options)
            return
        except Exception as error:  # Ray raises many kinds here, the bare one among them
            ray.shutdown()
            if not left:
                raise InputError(
                    f"Ray cannot be used at {crew.address or LOOPBACK}: {_first_sentence(error)}; Ray's and Python's "
                    "versions and RAY_AUTH_MODE must be those of the cluster, and the machine not too busy"
                ) from error


def _check_answers(address: str) -> None:
    """Refuse an address that is none, or where no such server answers; Ray itself would try for minutes."""
    grpc = import_module("grpc")
    host, _, port = address.removeprefix("ray://").rpartition(":")
    if not host or not port.isdigit() or not 0 < int(port) < 65536:
        raise InputError(f"address '{address}' names no Ray cluster; give host:port or ray://host:port")
    hint = "start one with `ray start --head`, or leave --address out for one on this machine"
    try:
        socket.create_connection((host.strip("[]"), int(port)), ANSWER_SECONDS).close()
    except OSError as error:
        raise InputError(f"no Ray cluster answers at {address}: {error.strerror or error}; {hint}") from error
    if os.environ.get("RAY_USE_TLS", "0") != "0":
        return
    with grpc.insecure_channel(f"{host}:{port}") as channel:
        try:
            grpc.channel_ready_future(channel).result(ANSWER_SECONDS)
        except grpc.FutureTimeoutError as error:
            raise InputError(f"what answers at {address} is no Ray cluster; {hint}") from error


def _first_sentence(error: Exception) -> str:
    """The first sentence of what Ray says, which is often a page."""
    text = (str(error).strip().splitlines() or [type(error).__name__])[0]
    return text.partition(". ")[0].rstrip(".")
