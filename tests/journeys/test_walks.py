"""Four newcomers: what each of them types stands in the README, is few, and is what the commands take.

`python .ci/walks.py` walks in fresh environments and makes the table of docs/installation.md; the README's blocks
are run by tests/test_readme.py.
"""

from __future__ import annotations

import re
import shlex
import sys
from pathlib import Path

import pytest
import typer

from pickenv.base import EXTRAS
from pickenv.cli import app

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / ".ci"))

import walks  # noqa: E402

README = (ROOT / "README.md").read_text(encoding="utf-8")
INSTALLATION = (ROOT / "docs/installation.md").read_text(encoding="utf-8")
COMMANDS = typer.main.get_command(app).commands  # type: ignore[attr-defined]
ROW = r"^\| ([^|]+) \| (\d+) \| [\d.]+ \| ([\d.]+) \| (\d+) \|$"
MOST_COMMANDS, MOST_MINUTES, CORE_MB = 12, 10.0, 300


@pytest.mark.parametrize("who", list(walks.NEWCOMERS))
def test_a_walk_is_short_and_its_commands_are_taken(who: str) -> None:
    lines = walks.typed(README, walks.NEWCOMERS[who])
    assert 5 <= len(lines) <= MOST_COMMANDS
    said = [text for _, text in lines]
    assert set(walks.NEWCOMERS[who].install) <= set(README.splitlines())
    assert said.index(walks.NEWCOMERS[who].install[-1]) < next(
        i for i, (_, text) in enumerate(lines) if text.startswith("pickenv demo")
    )
    for words in (shlex.split(text) for language, text in lines if language == "sh" and text.startswith("pickenv ")):
        command = COMMANDS[words[1]]
        with command.context_class(command, info_name=words[1]) as context:
            assert command.make_parser(context).parse_args(words[2:])[1] == []


def test_the_table_of_walks_is_within_its_bounds() -> None:
    """By processor time: what else ran on the computer lengthens the time on the clock."""
    rows = {row[0]: row[1:] for row in re.findall(ROW, INSTALLATION, re.M)}
    assert rows and set(rows) <= set(walks.NEWCOMERS)
    for who, (commands, minutes, size) in rows.items():
        assert int(commands) == len(walks.typed(README, walks.NEWCOMERS[who]))
        assert float(minutes) <= MOST_MINUTES
        assert walks.NEWCOMERS[who].install != walks.CORE or int(size) <= CORE_MB


def test_the_page_on_installation_has_a_row_for_every_extra() -> None:
    rows = re.findall(r"^\| `(\w+)` \|", INSTALLATION, re.M)
    assert sorted(rows) == sorted([*EXTRAS, "all"])


def test_an_extra_is_asked_for_in_one_of_two_ways_everywhere() -> None:
    """Of a checkout, or of the pickenv that is installed; no page lets pip look for one that is on no index."""
    pages = [ROOT / "README.md", *(ROOT / "docs").glob("*.md"), *(ROOT / "docs/tutorials").glob("*.md")]
    told = {
        (page.name, line)
        for page in pages
        for line in re.findall(
            r"pip install [^`\n]*?pickenv[^`\n]*|pip install [\"']?\.[^`\n]*", page.read_text("utf-8")
        )
    }
    assert len(told) > 6
    wrong = [
        each
        for each in told
        if not re.fullmatch(r"""pip install (?:-c constraints\.txt )?(?:\.|"(?:\.|pickenv)\[[\w,]+\]")""", each[1])
    ]
    assert wrong == []
