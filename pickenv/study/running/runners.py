"""Where the chunks of a study are worked on: in this process, in processes of this machine, or on a Ray cluster.

An executor takes chunk numbers and the work on one chunk, and yields (chunk, rows) in any order. It adds no numbers of
its own, so that the rows are the same to the bit on every one of them.
"""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from importlib import import_module
from typing import Any, TypeVar

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
    "ray": ("pickenv.study.running.ray_runner", "run_ray"),
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
