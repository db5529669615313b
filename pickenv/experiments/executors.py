"""Who computes the pieces of an experiment: this process, others of this machine, a cluster of Ray or of Dask."""

from __future__ import annotations

import logging
import math
import os
import secrets
import socket
import sys
import threading
import time
import traceback
import warnings
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager
from functools import lru_cache
from typing import Any

from pickenv.base import InputError, command_line, require

ATTEMPTS = 4
"""Number of times a piece is tried when the processes that work on it die."""


def spread(
    work: Callable[[int], Any], numbers: Sequence[int], backend: str = "serial", workers: int | None = None
) -> Iterator[tuple[int, Any]]:
    """Do some work for each number, and yield (number, result) in any order.

    After a piece that fails none is begun any more; those that are being done are still yielded, and then its error is
    raised. (loky's own way is to kill the other workers, in which its managing thread may die with a KeyError.)

    Args:
        work: What is done; a function of a module where other processes are to do it.
        numbers: The numbers that ``work`` is called with.
        backend: As `run` takes it.
        workers: Processes; as many as there are cores, or as the cluster has, when None.

    Raises:
        InputError: If the backend is unknown or not installed, or the processes of this machine keep dying.
    """
    if backend == "serial" or not numbers:
        for number in numbers:
            yield number, work(number)
        return
    require("joblib")
    from joblib import Parallel, delayed
    from joblib.parallel import get_active_backend

    todo, failures = list(numbers), list[Exception]()

    def begun(together: int) -> Iterator[Any]:
        for number in todo[:together]:
            if failures:
                return
            yield delayed(_numbered)(work, number, os.getpid())

    with _working_on(backend, workers) as deaths:
        for _ in range(ATTEMPTS):
            streams = get_active_backend()[0].supports_return_generator
            parallel = Parallel(
                n_jobs=workers or -1, return_as="generator_unordered" if streams else "list", batch_size=1,
                pre_dispatch="n_jobs" if streams else "2 * n_jobs",
            )  # fmt: skip
            together = len(todo) if streams else 4 * (workers or parallel._effective_n_jobs())
            try:
                while todo and not failures:
                    some = parallel(begun(together))
                    with _quietly_closed(some):
                        for number, result, failure in some:
                            todo.remove(number)
                            if failure is None:
                                yield number, result
                            else:
                                failures.append(failure)
                if failures:
                    raise failures[0]
                return
            except deaths:
                continue
    raise InputError(
        f"the processes that worked on piece {todo[0]} died {ATTEMPTS} times ({len(todo)} are left); give fewer "
        "workers or smaller pieces if memory ran out, and run it again to go on"
    )


@contextmanager
def _quietly_closed(results: Any) -> Iterator[None]:
    """Drop results that nobody takes any more, as after an interrupt, without the warning that joblib would show."""
    try:
        yield
    finally:
        if isinstance(results, Generator):
            with warnings.catch_warnings():
                warnings.filterwarnings("ignore", ".*tasks", UserWarning, "joblib")
                results.close()


@contextmanager
def _working_on(backend: str, workers: int | None) -> Iterator[tuple[type[Exception], ...]]:
    """A context in which joblib works on a backend; its value is the errors which mean that a process died."""
    from joblib import parallel_config
    from joblib.externals.loky.process_executor import TerminatedWorkerError

    deaths: tuple[type[Exception], ...] = (TerminatedWorkerError,)
    if backend == "ray":
        deaths += (_joined_ray(workers).exceptions.RayError,)
    try:
        context = parallel_config(backend=backend)
    except (ValueError, ImportError) as error:
        raise InputError(
            f"backend '{backend}' is not known or not installed: {error}; give serial, loky, ray or another of joblib's"
        ) from error
    try:
        with context:
            yield deaths
    finally:
        if backend == "ray":
            import ray

            ray.shutdown()


STARTS = 3
"""How often a local cluster is started before the work is given up: Ray waits 30 s, which a busy machine may pass."""
ALONE = {"RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0", "RAY_AUTH_MODE": "token"}
"""Environment of a private Ray cluster: on loopback (with it, Ray does so on Linux, too), and with a token for work."""


def _joined_ray(workers: int | None) -> Any:
    """Ray, connected to the cluster at RAY_ADDRESS, or to one of this machine that takes work from nobody else."""
    require("ray")
    address, options = os.environ.get("RAY_ADDRESS"), dict[str, Any]()
    os.environ["RAY_USAGE_STATS_ENABLED"] = "0"
    if address is not None and ":" in address:
        _check_answers(address)
    if address is None:
        token = os.environ.get("RAY_AUTH_TOKEN") or secrets.token_hex(32)  # read as Ray is imported, and never again
        os.environ.update(ALONE | {"RAY_AUTH_TOKEN": token})
        options = {"address": "local", "num_cpus": workers}  # not one that somebody else has started here
        options |= {"include_dashboard": False, "_node_ip_address": "127.0.0.1"}
    import ray
    from ray.util.joblib import register_ray

    register_ray()  # type: ignore[no-untyped-call]
    for again in reversed(range(STARTS if address is None else 1)):
        try:
            if not ray.is_initialized():
                ray.init(log_to_driver=False, logging_level=logging.ERROR, **options)
            break
        except Exception as error:  # Ray raises many kinds here, the bare one among them
            ray.shutdown()
            if again:
                continue
            reason = (str(error).strip().splitlines() or [type(error).__name__])[0].partition(". ")[0].rstrip(".")
            raise InputError(
                f"Ray cannot be used at {address or 'this machine'}: {reason}; RAY_ADDRESS must name a cluster of this "
                "version of Ray and Python, RAY_AUTH_MODE must be as on it, and the machine not too busy"
            ) from error
    return ray


def _check_answers(address: str) -> None:
    """Refuse an address where nothing answers; Ray itself would try for minutes."""
    host, _, port = address.removeprefix("ray://").rpartition(":")
    try:
        socket.create_connection((host.strip("[]"), int(port)), 5.0).close()
    except (OSError, ValueError, OverflowError) as error:
        raise InputError(
            f"no Ray cluster answers at {address}: {error}; start one with "
            f"`{command_line('ray', 'start', head=True)}`, or leave RAY_ADDRESS out for one on this machine"
        ) from error


def _numbered(work: Callable[[int], Any], number: int, driver: int) -> tuple[int, Any, Exception | None]:
    """One piece's number, its result, and the error that it failed with, if it did."""
    _end_with(driver)
    loky = sys.modules.get("joblib.externals.loky.process_executor")
    if loky is not None:
        # A process that loads torch after its first piece has no leak; one that is ended for it is waited for.
        loky._MAX_MEMORY_LEAK_SIZE = math.inf  # type: ignore[attr-defined]
    try:
        return number, work(number), None
    except Exception as error:
        if not isinstance(error, InputError):
            error.add_note(traceback.format_exc())  # where in the worker; a traceback itself cannot be sent
        return number, None, error


@lru_cache(maxsize=1)
def _end_with(driver: int) -> None:
    """Make this worker end when its driver is killed; else it would wait for ever for somebody to take its rows."""

    def watch() -> None:
        while os.getppid() == driver:
            time.sleep(1.0)
        os._exit(1)

    if os.getppid() == driver:  # a worker of another kind has another parent
        threading.Thread(target=watch, daemon=True).start()
