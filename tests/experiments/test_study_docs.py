"""What docs/tolerance-studies.md says works: its commands run in order, its files and options exist."""

import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from typer.main import get_command

from pickenv.cli import app
from pickenv.experiments import study_rows

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs/tolerance-studies.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```sh\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)
LINES = [line for block in BLOCKS for line in block.splitlines()]


def test_every_file_that_is_named_exists():
    links = re.findall(r"\]\(([^)\s#]+)\)", PAGE)
    assert links and [link for link in links if not (ROOT / "docs" / link).exists()] == []
    scripts = set(re.findall(r"scripts/\w+\.\w+", PAGE))
    assert scripts and [name for name in scripts if not (ROOT / name).is_file()] == []


def test_every_executor_and_option_is_named_and_exists():
    named = set(re.findall(r"^\| `(\w+)`(?: \(default\))? \|", PAGE, re.MULTILINE))
    assert named == set(study_rows.EXECUTORS)
    options = {option for parameter in get_command(app).commands["study"].params for option in parameter.opts}
    used = set(re.findall(r"(?<![\w-])--[a-z]+", PAGE))
    assert used <= options and {"--sobol", "--device"} <= used


@pytest.mark.slow
def test_every_command_runs_in_order(tmp_path):
    (tmp_path / "scripts").symlink_to(ROOT / "scripts")
    for line in LINES:
        program, command, *arguments = shlex.split(line)
        assert program == "pickenv"
        quick = ["--quick"] if command == "study" and "--quick" not in arguments else []
        words = [sys.executable, "-c", "from pickenv.cli import main; main()", command, *arguments, *quick]
        alone = {"PYTHONPATH": str(ROOT), "MPLBACKEND": "Agg"}
        ended = subprocess.run(words, cwd=tmp_path, env=alone, text=True, capture_output=True)
        assert ended.returncode == 0, f"{line}\n{ended.stdout}\n{ended.stderr}"
    for name in ("runs/study/report.html", "runs/study/arms.rrd", "runs/grades/sobol.json", "grades.html"):
        assert (tmp_path / name).stat().st_size > 500
