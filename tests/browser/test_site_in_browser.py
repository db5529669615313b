"""The built site in Chromium: no rule of accessibility is broken, no page reaches beyond the screen, light and dark."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytestmark = pytest.mark.browser
ROOT = Path(__file__).parents[2]
SITE, FIELDS = ROOT / "docs/_build/html", ROOT / "docs/_static/explorer-fields.js"
SCREENS = {"light": {"width": 390, "height": 844}, "dark": {"width": 1440, "height": 900}}
PAGES = (
    "index.html",
    "environments.html",
    "tutorials/train-and-compare.html",
    "_generated/reference/pickenv.calibration.html",
    "leaderboard.html",
    "gallery.html",
)
"""One of each kind."""


@pytest.mark.parametrize("theme", list(SCREENS))
def test_the_site_can_be_read_by_ear_by_keyboard_and_on_a_phone(theme: str, browser: Any) -> None:
    if not SITE.exists():
        pytest.skip("the site is not built: make docs")
    from axe_playwright_python.sync_playwright import Axe

    page = browser.new_page(viewport=SCREENS[theme], color_scheme=theme)
    for name in PAGES:
        page.goto((SITE / name).as_uri())
        found = Axe().run(page).response["violations"]
        assert [(each["id"], each["nodes"][0]["html"][:160]) for each in found] == [], name
        assert page.evaluate("document.documentElement.scrollWidth - document.documentElement.clientWidth") == 0, name
    page.close()


@pytest.mark.parametrize("theme", list(SCREENS))
@pytest.mark.parametrize("width", [390, 1440])
def test_an_arms_error_turns_by_keyboard_and_reads_as_the_library_computed_it(
    theme: str, width: int, browser: Any, screenshots: Path
) -> None:
    if not SITE.exists():
        pytest.skip("the site is not built: make docs")
    from axe_playwright_python.sync_playwright import Axe

    fields = json.loads(FIELDS.read_text(encoding="utf-8").partition(" = ")[2].rstrip(";\n"))
    stages = next(field["stages"] for field in fields["plants"] if field["plant"] == "qiao2026")
    page = browser.new_page(viewport={"width": width, "height": 900}, color_scheme=theme, reduced_motion="reduce")
    complaints: list[str] = []
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.goto((SITE / "explorer.html").as_uri())
    explorer, canvas = page.locator("#explorer"), page.locator("#explorer canvas")
    if (width, theme) == (1440, "light"):
        canvas.screenshot(path=screenshots / "explorer-light.png")
    pixels = [canvas.evaluate("canvas => canvas.toDataURL()")]
    explorer.locator("select").focus()
    for stage in stages:
        page.keyboard.press("Tab")
        page.keyboard.press("Enter")
        said = explorer.get_by_role("status").first.inner_text()
        assert f"{stage['label']}: mean {stage['mean_mm']:.2f} mm, largest {stage['largest_mm']:.2f} mm" in said
    for key in ("ArrowLeft", "ArrowUp", "Home"):
        canvas.focus()
        page.keyboard.press(key)
        pixels.append(canvas.evaluate("canvas => canvas.toDataURL()"))
    assert len(set(pixels)) == 4
    slider = explorer.get_by_role("slider")
    slider.focus()
    page.keyboard.press("Home")
    length = np.linalg.norm(stages[-1]["errors_um"][0]) / 1e3
    assert explorer.get_by_role("status").last.inner_text().endswith(f"{length:.2f} mm")
    assert [(each["id"], each["nodes"][0]["html"][:160]) for each in Axe().run(page).response["violations"]] == []
    assert page.evaluate("document.documentElement.scrollWidth - document.documentElement.clientWidth") == 0
    assert complaints == []
    page.close()
