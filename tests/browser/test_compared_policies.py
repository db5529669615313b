"""Recording and page of two PPO policies, raw and calibrated: a beginner's is not hidden, names are the table's."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pickenv.inspect import RecordedEpisodes, load_part, read_run
from pickenv.inspect.colours import in_words, policy_colours
from pickenv.inspect.runs import comparison_summary
from tests.browser.chromium import SIZE
from tests.browser.pictures import crop, save
from tests.browser.web_viewer import PATIENCE_MS, WebViewer, serve

LABELS = ("raw", "calibrated")
STEPS = {"raw": 36_000, "calibrated": 60_000}
"""Of training: the first is a beginner's, which ends some 50 mm from the fruit."""


@pytest.fixture(scope="module")
def compared(run_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder, calibration = tmp_path_factory.mktemp("policies"), run_folder / "calibration.npz"

    def pickenv(*words: object) -> None:
        subprocess.run([sys.executable, "-m", "pickenv.cli", *map(str, words)], check=True, capture_output=True)

    for label, steps in STEPS.items():
        behind = ("--compensate", calibration) if label == "calibrated" else ()
        pickenv("train", "--steps", steps, "--out", folder / label, *behind)
    policies = [folder / label for label in LABELS]
    behind = ("--compensate", "none", calibration, "--label", *LABELS)
    pickenv("compare", *policies, *behind, "--out", folder / "compared")
    return folder / "compared"


@pytest.fixture(scope="module")
def content(compared: Path) -> Any:
    return json.loads((compared / "comparison.json").read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def cells(compared: Path) -> list[list[str]]:
    """The rows of the table of policies, as every screen shows them."""
    return comparison_summary.policy_cells(load_part(read_run(compared), RecordedEpisodes))


@pytest.fixture(scope="module", params=["dark", "light"])
def viewer(request: pytest.FixtureRequest, browser: Any, compared: Path) -> Iterator[WebViewer]:
    with serve(compared) as address:
        context = browser.new_context(viewport=SIZE, color_scheme=request.param)
        shown = WebViewer.within(context)
        shown.open(address, request.param, ["Who is better"])
        yield shown
        context.close()


def test_the_first_screen_says_who_is_better_in_the_tables_names_and_numbers(
    viewer: WebViewer, content: Any, cells: list[list[str]], screenshots: Path
) -> None:
    end = time.monotonic() + PATIENCE_MS / 1e3
    while content["headline"] not in {widget.text for widget in viewer.widgets()}:
        assert time.monotonic() < end, "the verdict did not come"
    picture = viewer.settle()
    said = {widget.text for widget in viewer.widgets()}
    assert all(set(row) <= said for row in cells)
    names = sorted((w.box[1], w.text) for w in viewer.widgets() if w.role == "label" and w.text in LABELS)
    assert [text for _, text in names][:2] == list(LABELS)
    beginner, trained = content["rows"]
    assert beginner["mean_mm"] > 25.0 > trained["median_mm"]  # it would not be seen on an axis to 25 mm
    plot = next(w for w in viewer.widgets() if w.role == "pane" and w.text.startswith("Distance to the fruit"))
    pixels = np.asarray(crop(picture, plot.box)).reshape(-1, 3).astype(int)
    for colour in policy_colours(list(LABELS)):
        assert (np.abs(pixels - np.array(colour)).max(axis=1) < 30).sum() > 200, colour
    theme = "light" if np.median(pixels) > 128 else "dark"
    save(picture, screenshots / f"compared-{theme}.png")
    assert viewer.complaints() == []


def test_no_tab_is_empty(viewer: WebViewer) -> None:
    buttons = viewer.tab_buttons()
    assert len(buttons) == 3
    for place in range(len(buttons)):
        picture = viewer.front(place)
        assert len(np.unique(np.asarray(picture).reshape(-1, 3), axis=0)) > 100
    viewer.front(0)
    assert viewer.complaints() == []


@pytest.mark.parametrize("theme", ["dark", "light"])
def test_the_page_holds_the_same_numbers(
    theme: str, browser: Any, compared: Path, content: Any, cells: list[list[str]]
) -> None:
    page = browser.new_context(viewport=SIZE, color_scheme=theme).new_page()
    said: list[str] = []
    page.on("console", lambda message: said.append(message.text))
    page.goto((compared / "report.html").resolve().as_uri())
    text = page.inner_text("body")
    assert all(cell in text for row in cells for cell in row)
    assert in_words(content["headline"]) in text and in_words(content["explanation"]) in text
    assert said == []
    page.context.close()
