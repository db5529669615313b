"""What every test may ask for."""

import gc
import os
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import NamedTuple

import pytest
from hypothesis import HealthCheck, settings

from pickenv import cli
from pickenv.commands.guard import guarded

# A busy machine is slow, and nothing that a test says is about time.
settings.register_profile("pickenv", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("pickenv")

# A terminal so wide that sentences and tables stand on one line; what narrow ones do is asked where it matters.
os.environ["COLUMNS"] = "400"

# MKL sums in another order on another processor, and a network's training then ends elsewhere.
os.environ["MKL_CBWR"] = "COMPATIBLE"

ROOT = Path(__file__).parents[1]


class Ended(NamedTuple):
    """How a command ended, in the words of `subprocess`."""

    returncode: int
    stdout: str
    stderr: str


@pytest.fixture(scope="session")
def data_folder() -> Path:
    """The folder of measured data sets: PICKENV_DATA, or ../shared/data beside the checkout."""
    folder = Path(os.environ.get("PICKENV_DATA") or ROOT / "../shared/data").resolve()
    if not folder.is_dir():
        pytest.skip(f"no measured data in {folder}; set PICKENV_DATA to the folder that holds the data sets")
    return folder


@pytest.fixture
def typed(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Callable[..., Ended]:
    """Runs a command as if it had been typed, in this process: its exit code and what it said."""

    def run(*words: object) -> Ended:
        monkeypatch.setattr("sys.argv", ["pickenv", *map(str, words)])
        try:
            code = guarded(cli._run)
        except SystemExit as error:
            code = int(error.code or 0)
        return Ended(code, *capsys.readouterr())

    return run


@contextmanager
def unwritten_figures() -> Iterator[None]:
    """A context in which figures are drawn, and pages have empty pictures in their places."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("pickenv.inspect.reports.report_page.inline_svg", lambda figure, name: ("", 1.0, 1.0))
        yield


@pytest.fixture(scope="session")
def unwritten() -> Callable[[], AbstractContextManager[None]]:
    """`unwritten_figures` itself, for tests that ask about a page's words alone."""
    return unwritten_figures


def pytest_collection_finish() -> None:
    """What is loaded now stays: no collection need look through it again, and few objects come in rings."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(50_000, 20, 20)
