"""The site builds without a warning; every public name has an entry, every link between its pages a target."""

from __future__ import annotations

import importlib
import inspect
import re
import subprocess
import sys
from pathlib import Path
from urllib.parse import unquote

import gymnasium
import pytest

import pickenv

pytestmark = pytest.mark.slow
ROOT = Path(__file__).parents[2]
ROOMS = ("base", "arm", "calibration", "envs", "wrappers", "agents", "inspect", "experiments", "orchard", "harvester")
HEAVY = 1_000_000
"""Bytes of a page with all that it loads, but for films."""
FILMS = (".gif", ".mp4")
LOADED = (".css", ".js", ".png", ".webp", ".svg", ".jpg", ".woff2")


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    pytest.importorskip("sphinx", reason="the site needs the extra docs: make docs")
    out = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", "-b", "html", "docs", str(out)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return out


def test_every_public_name_has_an_entry(site: Path) -> None:
    from sphinx.util.inventory import InventoryFile

    with (site / "objects.inv").open("rb") as file:
        entries = {name for kind in InventoryFile.load(file, "", lambda _, path: path).values() for name in kind}
    missing = []
    for room in ("", *ROOMS):
        module = importlib.import_module(f"pickenv.{room}".rstrip("."))
        for name in dir(module):
            thing = getattr(module, name)
            if name.startswith("_") or inspect.ismodule(thing):
                continue
            homes = [f"pickenv.{other}.{name}".replace("..", ".") for other in (room, *ROOMS, "")]
            missing += [f"{module.__name__}.{name}"] if not entries.intersection(homes) else []
    assert missing == []
    assert len(entries) > 200
    faces = {path.parent.name for path in (ROOT / "pickenv").glob("*/__init__.py") if "__all__" in path.read_text()}
    assert faces == set(ROOMS)


def test_every_environment_has_its_card(site: Path) -> None:
    for name in (name for name in gymnasium.registry if name.startswith("pickenv/")):
        card = (site / f"_generated/environments/{name.partition('/')[2]}.html").read_text(encoding="utf-8")
        assert "Action Space" in card or "ReachIdeal" in name
        assert name in card


def test_every_link_between_pages_has_a_target_and_no_page_is_heavy(site: Path) -> None:
    pages = {page: page.read_text(encoding="utf-8") for page in site.rglob("*.html")}
    assert len(pages) > 25
    anchors = {page: set(re.findall(r'\bid="([^"]+)"', text)) for page, text in pages.items()}
    for page, text in pages.items():
        loaded = {page}
        for tag, link in re.findall(r'<(\w+)[^>]*?\s(?:href|src)="([^"]+)"', text):
            if re.match(r"[a-z]+:|#$|//", link):
                continue
            path, _, anchor = unquote(link).partition("#")
            target = (page.parent / path.partition("?")[0]).resolve() if path else page
            assert target.exists(), f"{page.name}: {link}"
            loaded |= {target} if target.suffix in LOADED and tag != "a" else set()  # what is linked waits for a click
            if anchor and target in anchors:
                assert anchor in anchors[target] or page.name in ("search.html", "genindex.html"), (
                    f"{page.name}: {link}"
                )
        weight = sum(file.stat().st_size for file in loaded)
        assert weight < HEAVY, f"{page.relative_to(site)} weighs {weight} bytes"


def test_only_films_are_left_out_of_the_weight(site: Path) -> None:
    shown = {path.suffix for path in (site / "_images").iterdir()}
    assert shown <= {*FILMS, *LOADED} and FILMS[0] in shown


NOTEBOOKS = sorted(
    str(page.relative_to(ROOT / "docs").with_suffix(""))
    for page in (ROOT / "docs").rglob("*.md")
    if "_build" not in page.parts and "```{code-cell}" in page.read_text(encoding="utf-8")
)


def test_every_notebook_was_executed(site: Path) -> None:
    assert len(NOTEBOOKS) >= 6
    for name in NOTEBOOKS:
        source = (ROOT / f"docs/{name}.md").read_text(encoding="utf-8")
        text = (site / f"{name}.html").read_text(encoding="utf-8")
        assert text.count("cell_input") >= source.count("```{code-cell}"), name
        assert "cell_output" in text and "Traceback" not in text, name
        assert text.count("<img") >= source.count("plt.show()") + source.count("%matplotlib inline") > 0, name


def test_everything_shipped_has_a_card(site: Path) -> None:
    cards = site / "_generated/cards"
    assert {page.stem for page in (cards / "policies").glob("*.html")} == set(pickenv.agents.shipped_baselines())
    for kind, shipped in (("arms", pickenv.arm.shipped_arms()), ("plants", pickenv.arm.shipped_plants())):
        text = (cards / f"{kind}.html").read_text(encoding="utf-8")
        assert [name for name in shipped if f">{name}<" not in text] == [], kind


def test_the_version_is_shown(site: Path) -> None:
    assert f"pickenv {pickenv.__version__}" in (site / "index.html").read_text(encoding="utf-8")
