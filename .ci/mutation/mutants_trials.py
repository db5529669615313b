"""Trying a mutant of `mutants`: pytest in copies of the project, in new processes, and which tests run which lines."""

from __future__ import annotations

import compileall
import contextlib
import json
import multiprocessing
import os
import shutil
import signal
import sys
import time
from collections.abc import Iterable, Iterator, Mapping, Set
from dataclasses import dataclass
from pathlib import Path
from py_compile import PycInvalidationMode
from typing import Any

ROOT = Path(__file__).parents[2]
PACKAGES = ("pickenv", "calibration", "agents")
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


def copied_project(folder: Path, name: str = "project") -> Path:
    """A copy of the project in ``folder``, compiled, without what was made in it."""
    patterns = shutil.ignore_patterns(*LEFT_BEHIND)

    def ignored(where: str, names: list[str]) -> set[str]:
        return patterns(where, names) | (MADE & set(names) if Path(where) == ROOT else set())

    copy = folder / name
    shutil.copytree(ROOT, copy, symlinks=True, ignore=ignored)
    for package in PACKAGES:
        compileall.compile_dir(copy / package, quiet=2, invalidation_mode=PycInvalidationMode.CHECKED_HASH)
    return copy


def ask_pytest(copy: str, tests: list[str], begun: str, notes: str | None) -> None:
    """End this process, which has nothing of ours loaded, as pytest ends in the copy.

    The file ``begun`` holds the test that began last. With ``notes``, all tests run, whatever becomes of them, and
    `Notes` are kept in files whose names begin so.
    """
    os.setsid()
    if sys.platform == "linux" and notes is None:
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

    watch = None
    if notes is not None:
        import coverage

        watch = coverage.Coverage(data_file=f"{notes}.coverage", source=[f"{copy}/{name}" for name in PACKAGES])
        watch.start()
    import pickenv

    assert Path(pickenv.__file__).is_relative_to(copy)
    plugin = watcher(begun, watch)
    options = ["-q", "--tb=no", "-p", "no:cacheprovider", "-W", "ignore::pytest.PytestAssertRewriteWarning"]
    status = pytest.main([*options, *(() if watch else ["-x"]), *tests], plugins=[plugin])
    if watch is not None:  # the warning: hypothesis is among the libraries loaded already
        watch.stop()
        watch.save()
        passed = {test: seconds for test, seconds in plugin.seconds.items() if test not in plugin.failed}
        Path(f"{notes}.json").write_text(json.dumps({"seconds": passed, "fixtures": plugin.fixtures}), encoding="utf-8")
    os._exit(status)


def watcher(begun: str, watch: Any) -> Any:
    """A plugin that notes the test that began last and, with ``watch``, which code each test runs."""
    import pytest

    def place(fixture: pytest.FixtureDef[Any]) -> str:
        return f"{fixture.baseid} {fixture.argname}"

    class Watcher:
        """Coverage's context is the test that runs, or the fixture shared by tests that is set up."""

        def __init__(self) -> None:
            self.seconds, self.fixtures, self.failed = dict[str, float](), dict[str, list[str]](), set[str]()

        def pytest_runtest_logstart(self, nodeid: str) -> None:
            Path(begun).write_text(nodeid, encoding="utf-8")

        def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
            self.seconds[report.nodeid] = self.seconds.get(report.nodeid, 0.0) + report.duration
            if report.outcome != "passed":
                self.failed.add(report.nodeid)

        @pytest.hookimpl(wrapper=True)
        def pytest_runtest_protocol(self, item: pytest.Function) -> Iterator[None]:
            if watch:
                defined = [fixtures[-1] for fixtures in item._fixtureinfo.name2fixturedefs.values()]
                self.fixtures[item.nodeid] = [place(fixture) for fixture in defined if fixture.scope != "function"]
                watch.switch_context(item.nodeid)
            return (yield)

        @pytest.hookimpl(wrapper=True)
        def pytest_fixture_setup(self, fixturedef: pytest.FixtureDef[Any], request: Any) -> Iterator[None]:
            if not watch or fixturedef.scope == "function":
                return (yield)
            watch.switch_context(place(fixturedef))
            try:
                return (yield)
            finally:
                watch.switch_context(request._pyfuncitem.nodeid)

    return Watcher()


@dataclass(frozen=True)
class Notes:
    """Which tests run which lines, and how long each takes.

    Attributes:
        seconds: Of every test that passes.
        tests: Of every file and line, the tests that run it, also in a fixture that they share.
    """

    seconds: Mapping[str, float]
    tests: Mapping[tuple[str, int], Set[str]]

    @classmethod
    def read(cls, noted: Mapping[Path, Path]) -> Notes:
        """Read what `ask_pytest` has noted, given by copy of the project how the files' names begin."""
        from coverage import CoverageData

        seconds, users = dict[str, float](), dict[str, set[str]]()
        for path in noted.values():
            content = json.loads(Path(f"{path}.json").read_text(encoding="utf-8"))
            seconds |= content["seconds"]
            for test, fixtures in content["fixtures"].items():
                for name in (test, *fixtures):
                    users.setdefault(name, set()).add(test)
        tests: dict[tuple[str, int], set[str]] = {}
        for copy, path in noted.items():
            data = CoverageData(f"{path}.coverage")
            data.read()
            for file in data.measured_files():
                for line, contexts in data.contexts_by_lineno(file).items():
                    runs = set().union(*(users.get(context, ()) for context in contexts)) & seconds.keys()
                    if runs:
                        tests.setdefault((Path(file).relative_to(copy).as_posix(), line), set()).update(runs)
        return cls(seconds, tests)


@dataclass(frozen=True)
class Trial:
    """A run of tests in a copy of the project, in a new process.

    Attributes:
        process: The process.
        begun: The file with the test that began last.
        end: When it has taken too long, by `time.monotonic`.
    """

    process: Any
    begun: Path
    end: float

    @classmethod
    def start(cls, copy: Path, tests: Iterable[str], seconds: float, notes: Path | None = None) -> Trial:
        """Start a run that may take so many ``seconds``."""
        begun = copy.with_name(f"{copy.name}.begun")
        begun.unlink(missing_ok=True)
        process = WARM.Process(
            target=ask_pytest, args=(str(copy), list(tests), str(begun), None if notes is None else str(notes))
        )
        process.start()
        return cls(process, begun, time.monotonic() + seconds)

    def ended(self) -> bool:
        """Whether it is over, or has taken too long."""
        return not self.process.is_alive() or time.monotonic() > self.end

    def verdict(self) -> tuple[int | None, str]:
        """The exit code, None if it took too long, and the test that began last. Nothing of it runs any more."""
        code = self.process.exitcode
        if self.process.is_alive() and self.process.pid is not None:  # with whatever the tests had started
            with contextlib.suppress(ProcessLookupError):  # it has no group of its own yet
                os.killpg(self.process.pid, signal.SIGKILL)
            self.process.kill()
        self.process.join()
        return code, self.begun.read_text(encoding="utf-8") if self.begun.exists() else "nothing: no test began"
