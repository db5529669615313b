"""The built site in Chromium: no rule of accessibility is broken, no page reaches beyond the screen, light and dark."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

pytestmark = pytest.mark.browser
SITE = Path(__file__).parents[2] / "docs/_build/html"
SCREENS = {"light": {"width": 390, "height": 844}, "dark": {"width": 1440, "height": 900}}
PAGES = (
    "index.html",
    "environments.html",
    "tutorials/train-and-compare.html",
    "_generated/reference/pickenv.calibration.html",
    "leaderboard.html",
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
