"""Every picture of the pages can be made again, and each card of the gallery holds the few lines that make its own."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "scripts"))

import pictures  # noqa: E402

IMAGES = ROOT / "docs/images"
ELSEWHERE = {"film.gif": "films.md", "inspection-error-fields-arrows-20-light.webp": "inspection.md"}
"""Pictures whose lines stand on another page too: tests walk through the one, and look at the viewer of the other."""
REPORT = "inspection-calibration-light.webp"
QUICK = sorted(pictures.cards().keys() - ELSEWHERE)


@pytest.mark.parametrize("picture", sorted(path.name for path in IMAGES.iterdir()))
def test_a_command_makes_each_picture(picture):
    lines = pictures.lines_of(picture)
    files = [word for line in lines for word in line.split() if re.fullmatch(r"(scripts|\.ci)/\S+", word)]
    assert lines and all((ROOT / file).is_file() for file in files)


def test_each_picture_is_shown():
    pages = [ROOT / "README.md", *(ROOT / "docs").glob("*.md")]
    shown = {name for page in pages for name in re.findall(r"images/([\w.-]+)", page.read_text(encoding="utf-8"))}
    assert {path.name for path in IMAGES.iterdir()} == shown


def test_twelve_cards_open_fifteen_lines_at_most():
    cards = (ROOT / "docs/gallery.md").read_text(encoding="utf-8").split("\n## ")[1:]
    assert len(cards) == len(pictures.cards()) == 12
    for card in cards:
        blocks = "".join(text for _, text in pictures.BLOCK.findall(card))
        assert 1 <= len(blocks.replace("\n\n", "\n").splitlines()) <= 15, card
        (picture,) = re.findall(r"\(images/([^)]+)\)", card)
        assert (IMAGES / picture).is_file()


@pytest.mark.parametrize(("picture", "page"), ELSEWHERE.items())
def test_the_other_page_has_the_same_lines(picture, page):
    text = (ROOT / "docs" / page).read_text(encoding="utf-8")
    assert [
        line for line in pictures.cards()[picture] if line.removeprefix("python -c '").rstrip("'") not in text
    ] == []


@pytest.mark.slow
@pytest.mark.parametrize("picture", QUICK)
def test_its_lines_make_the_picture(picture, tmp_path):
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    environment = os.environ | {"PATH": path, "PYTHONPATH": str(ROOT), "MPLBACKEND": "Agg"}
    for line in pictures.cards()[picture]:
        subprocess.run(line, shell=True, check=True, cwd=tmp_path, env=environment, capture_output=True)
    others = {"conditions-orchard.png": "runs/conditions/figures/error_by_condition.png", REPORT: "report.html"}
    assert (tmp_path / others.get(picture, picture)).stat().st_size > 300
