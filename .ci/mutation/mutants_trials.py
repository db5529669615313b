"""Trying a mutant of `mutants`: a copy of the project, and pytest there in a new process that has nothing of ours."""

from __future__ import annotations

import compileall
import contextlib
import multiprocessing
import os
import shutil
import signal
import sys
from collections.abc import Iterable
from pathlib import Path
from py_compile import PycInvalidationMode

ROOT = Path(__file__).parents[2]
LEFT_BEHIND = ("__pycache__", ".git", ".venv*", "_build", ".*_cache", ".hypothesis", ".benchmarks")
"""Anywhere in the project; `MADE` is left behind in its root alone, for a package of it may have such a name."""
MADE = {"runs", "dist"}
MOST_BYTES = 8 * 2**30
"""Of memory, for a mutant that never stops growing."""
WARM = multiprocessing.get_context("forkserver")
"""Every mutant has a new process, into which the libraries, and nothing of ours, are loaded already."""
LIBRARIES = [
    "pytest",
    "hypothesis.strategies",
    "gymnasium",
    "scipy.optimize",
    "scipy.stats",
    "torch",
    "pyarrow.dataset",
]


def copied_project(folder: Path) -> Path:
    """A copy of the project in ``folder``, compiled, without what was made in it."""
    patterns = shutil.ignore_patterns(*LEFT_BEHIND)

    def ignored(where: str, names: list[str]) -> set[str]:
        return patterns(where, names) | (MADE & set(names) if Path(where) == ROOT else set())

    copy = folder / "project"
    shutil.copytree(ROOT, copy, symlinks=True, ignore=ignored)
    for package in ("pickenv", "calibration", "agents"):
        compileall.compile_dir(copy / package, quiet=2, invalidation_mode=PycInvalidationMode.CHECKED_HASH)
    return copy


def ask_pytest(copy: str, tests: list[str]) -> None:
    """End this process, which has nothing of ours loaded, as pytest ends in the copy."""
    os.setsid()
    if sys.platform == "linux":
        import resource

        resource.setrlimit(resource.RLIMIT_DATA, (MOST_BYTES, MOST_BYTES))
    nowhere = os.open(os.devnull, os.O_RDWR)
    for stream in range(3):
        os.dup2(nowhere, stream)
    os.chdir(copy)
    os.environ["PYTHONPATH"] = copy
    sys.path.insert(0, copy)
    sys.dont_write_bytecode = True
    import pytest

    import pickenv

    assert Path(pickenv.__file__).is_relative_to(copy)
    options = ["-x", "-q", "--tb=no", "-p", "no:cacheprovider", "-W", "ignore::pytest.PytestAssertRewriteWarning"]
    os._exit(pytest.main([*options, *tests]))  # the warning: hypothesis is among the libraries loaded already


def run_tests(copy: Path, tests: Iterable[str], seconds: float | None) -> str:
    """What pytest says of the copy: "passed", "failed" (also: cannot even be imported) or "took too long"."""
    process = WARM.Process(target=ask_pytest, args=(str(copy), list(tests)))
    process.start()
    try:
        process.join(seconds)
        return {0: "passed", None: "took too long"}.get(process.exitcode, "failed")
    finally:  # with whatever the tests had started, also when we are interrupted
        if process.is_alive() and process.pid is not None:
            with contextlib.suppress(ProcessLookupError):  # it has no group of its own yet
                os.killpg(process.pid, signal.SIGKILL)
            process.kill()
        process.join()
