"""`make claims` in a fresh clone, as docs/claims.md prints it: rows are made again, record and page say how many held."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
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


def start(clone: Path) -> subprocess.Popen[str]:
    """Type what the page prints, with the environment that runs this test in place of a new .venv; as in a terminal."""
    page = (clone / "docs/claims.md").read_text(encoding="utf-8")
    command = re.findall(r"`(make claims ARGS=[^`]*)`", page)[-1]
    return subprocess.Popen(
        ["sh", "-c", f"exec {command} BIN='{Path(sys.executable).parent}' RUNTIME="],
        cwd=clone,
        env=os.environ | {"PYTHONPATH": str(clone)},
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


@pytest.mark.slow
def test_a_drawing_that_was_interrupted_is_finished_and_the_last_line_says_how_many_held(clone: Path) -> None:
    """Three rows of the ladder, of a few seconds each: Ctrl-C after the first, and once more."""
    before = again(clone)
    typed = start(clone)
    assert typed.stdout is not None and typed.stderr is not None
    line = next((line for line in typed.stdout if line.startswith(("held", "MISSED"))), "")
    os.killpg(typed.pid, signal.SIGINT)
    _, said = typed.communicate(timeout=60)
    assert typed.returncode in (130, 2, -signal.SIGINT) and line, said
    assert "interrupted; the rows above are in the record, and --seed 7 goes on from there" in said
    assert "Traceback" not in said
    partly = again(clone)
    assert len(partly) == len(before) + 1 and str(partly[-1]["claim"]) in line
    assert table(clone) == (sum(bool(row["held"]) for row in partly), len(partly))

    typed = start(clone)
    shown, said = typed.communicate(timeout=170)
    assert typed.returncode == 0, said
    lines = [line for line in shown.splitlines() if not line.startswith("PYTHON")]
    assert [line.split()[0] for line in lines].count("in") == 1  # the record already
    whole = again(clone)
    assert whole[: len(partly)] == partly and len(whole) == len(before) + 3
    verdicts = [row["held"] for row in whole[len(before) :]]
    assert [line.startswith("held") for line in lines[1:-1]] == verdicts[1:] and line.startswith("held") == verdicts[0]
    total, made = (int(number) for number in SHARE.findall(lines[-1])[0])
    same = [int(number) for number in (re.findall(r"measured rows (\d+) of (\d+) held", lines[-1]) or [(0, 0)])[0]]
    assert table(clone) == (total + same[0], made + same[1]) == (sum(bool(r["held"]) for r in whole), len(whole))
    assert lines[-1] in (clone / "docs/claims.md").read_text(encoding="utf-8")
