"""What docs/inspection.md says is there: its pictures, commands, options, and a picture of every tab and report."""

import re
import shlex
from pathlib import Path
from typing import Any

from PIL import Image
from typer.main import get_command

from pickenv.cli import app

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs/inspection.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```sh\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)
LINES = [line for block in BLOCKS for line in block.splitlines()]
PICTURES = sorted((ROOT / "docs/images").glob("inspection-*.webp"))
CONTAINER = "ContainerBlueprint:display_name"


def test_every_link_and_script_exists() -> None:
    links = re.findall(r"\]\(([^)\s#]+)\)", PAGE)
    assert [link for link in links if not (ROOT / "docs" / link).exists()] == []
    assert [name for name in re.findall(r"(?:scripts|\.ci)/\w+\.py", PAGE) if not (ROOT / name).is_file()] == []


def test_every_picture_is_shown_and_small() -> None:
    assert {path.name for path in PICTURES} == set(re.findall(r"images/(inspection-[^)]+)\)", PAGE))
    assert max(path.stat().st_size for path in PICTURES) <= 110_000
    assert sum(path.stat().st_size for path in PICTURES) < 2_500_000
    for path in PICTURES:
        with Image.open(path) as picture:
            assert picture.size == (1600, 900), path


def test_every_command_and_option_exists() -> None:
    commands = get_command(app).commands  # type: ignore[attr-defined]
    for program, *words in map(shlex.split, LINES):
        if program == "make":
            assert re.search(rf"^{words[0]}:", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
            continue
        known = {option for parameter in commands[words[0]].params for option in parameter.opts}
        assert program == "pickenv" and {word for word in words if word.startswith("--")} <= known
    for option in set(re.findall(r"`(--[a-z]+)`", PAGE)):
        assert option in {o for name in ("inspect", "calibrate") for p in commands[name].params for o in p.opts}


def test_every_tab_and_no_other_has_its_pictures(reading: Any) -> None:
    """The recording of the tests has the tabs of a demo run's."""
    batches = [chunk.to_record_batch() for chunk in reading.blueprint.stream()]
    named = [b.column(CONTAINER).to_pylist() for b in batches if CONTAINER in b.schema.names]
    tabs = {row[0] for rows in named for row in rows if row} | {"Reaches as a table"}
    shown = {re.sub(r"^inspection-|-(light|dark)$", "", path.stem) for path in PICTURES}
    assert shown - {"arrow-selected", "report", "calibration"} == {
        re.sub(r"[^a-z0-9]+", "-", tab.lower()).strip("-") for tab in tabs
    }
