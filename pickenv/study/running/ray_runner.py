"""Chunks of a study on Ray: a cluster on this machine that listens on loopback only, or one that is already there.

Needs the extra ``pickenv[ray]``; machines of a cluster need pickenv and Ray at the versions of this one.
"""

from __future__ import annotations

import ipaddress
import logging
import os
import secrets
import socket
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from importlib.util import find_spec
from typing import Any

import pyarrow as pa

from pickenv.errors import InputError
from pickenv.study.running.runners import ATTEMPTS, Crew, Work, given_up

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
