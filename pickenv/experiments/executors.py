"""Backends that compute the pieces of an experiment: this process, or several processes of this machine."""

from __future__ import annotations

import math
import os
import threading
import time
import traceback
import warnings
from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache
from typing import Any

from pickenv.base import InputError, check_known, require

BACKENDS = ("serial", "loky")
"""Names of the backends: this process, and several processes of this machine."""

ATTEMPTS = 4
"""Number of attempts to compute the remaining pieces when worker processes die."""


def spread(
    work: Callable[[int], Any], numbers: Sequence[int], backend: str = "serial", workers: int | None = None
) -> Iterator[tuple[int, Any]]:
    """Call ``work`` with each number, and yield (number, result) as the calls end, in any order.

    When a call raises an exception, no further call is started. The calls in progress end, and their results are
    yielded. Then the exception is raised. If the exception were raised at once, loky would kill all workers.

    Args:
        work: Function to call; a module-level function if other processes are to call it.
        numbers: The numbers that ``work`` is called with.
        backend: "serial" (this process) or "loky" (processes of this machine), as in `BACKENDS`.
        workers: Number of processes; None for one per core.

    Raises:
        InputError: If the backend is unknown or not installed, or its processes keep dying.
    """
    check_known("backend", backend, BACKENDS)
    if backend == "serial" or not numbers:
        for number in numbers:
            yield number, work(number)
        return
    require("joblib")
    from joblib import Parallel, delayed
    from joblib.externals.loky.process_executor import TerminatedWorkerError

    todo, failures = list(numbers), list[Exception]()

    def begun(left: Sequence[int]) -> Iterator[Any]:
        for number in left:
            if failures:
                return
            yield delayed(_numbered)(work, number, os.getpid())

    for _ in range(ATTEMPTS):
        parallel = Parallel(
            n_jobs=workers or -1, backend="loky", return_as="generator_unordered", batch_size=1, pre_dispatch="n_jobs"
        )
        results = parallel(begun(tuple(todo)))
        try:
            for number, result, failure in results:
                todo.remove(number)
                if failure is None:
                    yield number, result
                else:
                    failures.append(failure)
            if failures:
                raise failures[0]
            return
        except TerminatedWorkerError:
            continue
        finally:
            with warnings.catch_warnings():  # nobody takes the other results, as after an interrupt
                warnings.filterwarnings("ignore", ".*tasks", UserWarning, "joblib")
                results.close()
    raise InputError(
        f"the processes that worked on piece {todo[0]} died {ATTEMPTS} times ({len(todo)} are left); give fewer "
        "workers or smaller pieces if memory ran out, and run it again to go on"
    )


def _numbered(work: Callable[[int], Any], number: int, driver: int) -> tuple[int, Any, Exception | None]:
    """Call ``work`` in a worker process; return the number, the result, and the exception or None.

    If ``work`` raises an exception, the result is None. The worker ends when the process with the id ``driver`` dies.
    """
    from joblib.externals.loky import process_executor

    _end_with(driver)
    # A process that loads torch after its first piece has no leak; one that is ended for it is waited for.
    process_executor._MAX_MEMORY_LEAK_SIZE = math.inf
    try:
        return number, work(number), None
    except Exception as error:
        if not isinstance(error, InputError):
            error.add_note(traceback.format_exc())  # where in the worker; a traceback itself cannot be sent
        return number, None, error


@lru_cache(maxsize=1)
def _end_with(driver: int) -> None:
    """Make this worker process end soon after its parent, the process with the id ``driver``, has ended.

    A worker without a parent would wait for ever for someone to fetch its results.
    """

    def watch() -> None:
        while os.getppid() == driver:
            time.sleep(1.0)
        os._exit(1)

    if os.getppid() == driver:  # a single worker is the driver itself
        threading.Thread(target=watch, daemon=True).start()
