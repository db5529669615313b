"""`make claims` in a fresh clone, as docs/claims.md prints it: rows are made again, and page and record count them."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SHARE = re.compile(r"(\d+) of (\d+) numbers held when they were made again")


@pytest.fixture
def clone(tmp_path: Path) -> Path:
    if not (ROOT / ".git").exists():
        pytest.skip("not a checkout")
    subprocess.run(["git", "clone", "--quiet", str(ROOT), str(tmp_path / "pickenv")], check=True)
    return tmp_path / "pickenv"


def terminal(**more: str) -> dict[str, str]:
    """The variables of a terminal, where no make is at work that would speak in between."""
    return {name: value for name, value in os.environ.items() if not name.startswith("MAKE")} | more


def start(clone: Path) -> subprocess.Popen[str]:
    """Type what the page prints, with the environment that runs this test in place of a new .venv; as in a terminal."""
    page = (clone / "docs/claims.md").read_text(encoding="utf-8")
    command = re.findall(r"`(make claims ARGS=[^`]*)`", page)[-1]
    return subprocess.Popen(
        ["sh", "-c", f"exec {command} BIN='{Path(sys.executable).parent}' DEVELOPMENT="],
        cwd=clone,
        env=terminal(PYTHONPATH=str(clone)),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )


def again(clone: Path) -> list[dict[str, object]]:
    return list(json.loads((clone / "docs/_static/claims.json").read_text(encoding="utf-8"))["again"])


def table(clone: Path) -> tuple[int, int]:
    """What the page's table counts, over all experiments: held, and made again."""
    cells = re.findall(r"\| (\d+) \| (\d+) \|$", (clone / "docs/claims.md").read_text(encoding="utf-8"), re.MULTILINE)
    made, held = ([int(row[i]) for row in cells] for i in (0, 1))
    return sum(held), sum(made)


def verdicts(shown: str) -> list[bool]:
    return [line.startswith("held") for line in shown.splitlines() if line.startswith(("held", "MISSED"))]


@pytest.mark.slow
def test_a_new_environment_has_what_the_rows_need(clone: Path) -> None:
    """Rows pick by contact, in other people's tasks, with networks: their packages are installed before the first."""
    plan = subprocess.run(
        ["make", "-n", "claims"], cwd=clone, env=terminal(), capture_output=True, text=True, check=True
    ).stdout
    assert plan.index('-e ".[dev]"') < plan.index("scripts/claims.py check")
    extras = tomllib.loads((clone / "pyproject.toml").read_text(encoding="utf-8"))["project"]["optional-dependencies"]
    brought = " ".join(extras["dev"])
    assert "pickenv[all]" in brought and "gymnasium-robotics" in brought and "scene" in extras["all"][0]


@pytest.mark.slow
def test_a_drawing_that_was_interrupted_is_finished_and_the_last_line_says_how_many_held(clone: Path) -> None:
    """Three rows of a few seconds each: Ctrl-C after the first, and the same once more."""
    before = again(clone)
    typed = start(clone)
    assert typed.stdout is not None
    shown = ""
    while not verdicts(shown) and (line := typed.stdout.readline()):
        shown += line
    os.killpg(typed.pid, signal.SIGINT)
    rest, said = typed.communicate(timeout=60)
    assert typed.returncode in (130, 2, -signal.SIGINT), said  # make's own, or that of the signal
    assert "interrupted; the rows above are in the record, and --seed 7 goes on from there" in said
    assert "Traceback" not in said
    partly = again(clone)
    new = [row["held"] for row in partly[len(before) :]]
    assert partly[: len(before)] == before and len(new) in (1, 2)
    assert verdicts(shown + rest) in (new, new[:-1])  # or it was interrupted before it could print the last
    assert table(clone) == (sum(bool(row["held"]) for row in partly), len(partly))

    typed = start(clone)
    shown, said = typed.communicate(timeout=170)
    assert typed.returncode == 0, said
    assert shown.count("in the record already: findings_constants") == len(new)
    whole = again(clone)
    assert whole[: len(partly)] == partly and len(whole) == len(before) + 3
    assert verdicts(shown) == [row["held"] for row in whole[len(partly) :]]
    last = shown.splitlines()[-1]
    assert last in (clone / "docs/claims.md").read_text(encoding="utf-8")
    counts = [*SHARE.findall(last), *re.findall(r"measured rows (\d+) of (\d+) held", last)]
    held, made = (sum(int(pair[i]) for pair in counts) for i in (0, 1))
    assert (held, made) == table(clone) == (sum(bool(row["held"]) for row in whole), len(whole))
