"""A demo run to look at, and where pictures of it are kept. `make test-browser` prepares both."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.browser.layout import Blueprint

ROOT = Path(__file__).parents[2]
GAIN = 20.0
"""How much longer than true size `pickenv demo` draws errors."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    here = f"{Path(__file__).parent}{os.sep}"
    for item in items:
        if str(item.path).startswith(here):
            item.add_marker("browser")


@pytest.fixture(scope="session")
def run_folder() -> Path:
    """The folder of a demo run: PICKENV_RUN, or runs/browser."""
    folder = Path(os.environ.get("PICKENV_RUN") or ROOT / "runs/browser")
    if not (folder / "summary.json").is_file():
        pytest.fail(f"no demo run in {folder}; `make test-browser` makes one")
    return folder


@pytest.fixture(scope="session")
def recording(run_folder: Path) -> Path:
    return run_folder / "errors.rrd"


@pytest.fixture(scope="session")
def screenshots(run_folder: Path) -> Path:
    folder = run_folder / "screenshots"
    folder.mkdir(exist_ok=True)
    return folder


@pytest.fixture(scope="session")
def blueprint(recording: Path) -> Blueprint:
    """The recording's own layout, as a viewer understands it."""
    from tests.browser.native_viewer import look

    return look(recording, lambda viewer: viewer.blueprint)


@pytest.fixture(scope="session")
def arrows(run_folder: Path) -> dict[str, Any]:
    """The raw arm's error field, from the run's numbers and not from its recording: metres, errors in mm."""
    from pickenv.inspect import Comparison, load_part, read_run

    comparison = load_part(read_run(run_folder), Comparison)
    raw = comparison.policies[0]
    return {
        "path": f"world/field/{raw.key}/vectors",
        "origin": comparison.grid.points,
        "vector": GAIN * raw.field_errors,
        "error_mm": 1e3 * raw.field_errors,
    }


@pytest.fixture(scope="session")
def browser() -> Iterator[Any]:
    from tests.browser.chromium import chromium

    with chromium() as opened:
        yield opened


@pytest.fixture(scope="session")
def measured(run_folder: Path) -> Iterator[dict[str, Any]]:
    """Figures that the tests measure, written to `measured.json` of the screenshots."""
    figures: dict[str, Any] = {"cores": os.cpu_count(), "load": os.getloadavg()[0]}
    yield figures
    (run_folder / "screenshots/measured.json").write_text(json.dumps(figures, indent=2) + "\n", encoding="utf-8")
