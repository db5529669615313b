"""What README and the pages behind it print is true: blocks run in order, files exist, numbers are those of Results."""

import csv
import json
import os
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")

BLOCK = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
RUN = ("README.md", "docs/commands.md")
"""Pages whose blocks are run, one after the other in one folder; other pages have tests of their own."""
LINK = re.compile(r"\]\(([^)\s]+)\)")

ELSEWHERE = {
    "make test": "it runs this very test",
    "make demo": "`pickenv demo --quick` stands above it; .ci/run types it",
    "python3 -m venv .venv": ".ci/walks.py types it",
    ". .venv/bin/activate": ".ci/walks.py types it",
    'pip install ".[rl,inspect]"': "what runs this has it; tests/journeys/test_core_install.py installs",
    "pip install .": "likewise",
    "python scripts/install_torch.py": "likewise",
}
COMMANDS = ("make", "pickenv", "pip", "python", "python3", ".")

ENVIRONMENT = {name: value for name, value in os.environ.items() if not name.startswith(("MAKE", "MFLAGS"))} | {
    "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
    "MPLBACKEND": "Agg",
}


def page(name: str) -> str:
    return (ROOT / name).read_text(encoding="utf-8")


def blocks(name: str) -> list[tuple[str, str]]:
    """Language and text of every fenced block of a page, in its order."""
    return BLOCK.findall(page(name))


def shell_lines() -> Iterator[str]:
    for language, text in blocks("README.md"):
        if language == "sh":
            yield from text.splitlines()


def run(command: list[str], folder: Path) -> str:
    done = subprocess.run(command, cwd=folder, env=ENVIRONMENT, capture_output=True, text=True)
    assert done.returncode == 0, f"{shlex.join(command)}\n{done.stdout}\n{done.stderr}"
    return done.stdout


def recipe(target: str) -> str:
    """The command that `make TARGET` ends with, in its quick form, as it reads with .venv activated."""
    printed = run(["make", "--no-print-directory", "--dry-run", target, "ARGS=--quick"], ROOT)
    return printed.strip().splitlines()[-1].replace(".venv/bin/", "")


def makefile_targets() -> set[str]:
    return set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))


def test_every_block_is_of_a_kind_that_is_run() -> None:
    assert {language for name in RUN for language, _ in blocks(name)} == {"sh", "python"}
    assert {shlex.split(line)[0] for line in shell_lines()} <= set(COMMANDS)


def test_every_make_target_exists() -> None:
    named = set(re.findall(r"`make ([a-z-]+)", README)) | {
        shlex.split(line)[1] for line in shell_lines() if line.startswith("make ")
    }
    assert {"demo", "test"} <= named <= makefile_targets()


def test_make_demo_is_the_command_of_the_same_name() -> None:
    assert recipe("demo") == "pickenv demo --out runs/demo --quick"


def test_every_file_shown_or_linked_exists() -> None:
    local = [link for link in LINK.findall(README) if "://" not in link]
    assert [link for link in local if not (ROOT / link).exists()] == []


def test_continuous_integration_calls_the_readmes_test_command() -> None:
    assert "make test" in (ROOT / ".ci/run").read_text(encoding="utf-8").splitlines()


def table(text: str, head: str) -> list[list[str]]:
    """Cells of the rows of the first table whose head begins so."""
    lines = text[text.index(f"\n| {head}") + 1 :].split("\n\n")[0].splitlines()[2:]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]


def test_the_readmes_rows_are_those_of_the_results() -> None:
    """Each number is the ledger's; those of measured robots stand in the table of the results too."""
    (simulated, *marked) = table(README, "arm | nominal")
    assert len(marked) == 4 and sum("demo_spread" in cell for cell in simulated) == 3
    assert all("<!-- claim:" in cell for row in marked for cell in row[1:4])
    measured = [[re.sub(r"<!--.*?-->", "", cell) for cell in row] for row in marked]
    with (ROOT / "docs/_static/measured-robots.csv").open(newline="", encoding="utf-8") as file:
        blocks = {row[0]: row for row in csv.reader(file)}
    for arm, nominal, geometry, best, _ in measured:
        name, statistic = re.fullmatch(r"(.+), measured, (\w+)", arm).groups()
        assert [nominal, geometry, best] == [
            cell.partition(":")[0] for cell in blocks[f"{name}, blocks, {statistic}"][1:4]
        ]


def test_the_home_page_says_what_the_readme_says() -> None:
    home, readme = page("docs/index.md"), README.splitlines()
    shown = [text.strip() for language, text in blocks("docs/index.md") if language == "sh"]
    assert len(shown) == 3 and set(shown) <= set(readme)
    rows = [line for line in home.splitlines() if line.startswith("| ")]
    assert len(rows) == 4 and set(rows) <= set(readme)


@pytest.mark.slow
def test_every_block_runs_in_order(tmp_path: Path) -> None:
    """And each door of the README ends with a number that says what calibration is worth."""
    said = {}
    for language, text in (block for name in RUN for block in blocks(name)):
        if language == "python":
            said[text] = run([sys.executable, "-c", text], tmp_path)
            continue
        for line in text.splitlines():
            if line not in ELSEWHERE:
                said[line] = run(shlex.split(line), tmp_path)
    ten_lines, robot, orchard = (
        " ".join(said[next(line for line in said if line.startswith(start))].split())
        for start in ("import gymnasium", "pickenv verify", "pickenv evaluate")
    )
    raw, corrected = (float(value) for value in re.findall(r": ([\d.]+) mm", ten_lines))
    assert 1.5 < raw < 2.5 and corrected < 0.2 * raw
    (learnt,) = json.loads((tmp_path / "runs/compared/comparison.json").read_text(encoding="utf-8"))["differences"]
    assert learnt["significant"] and -2.5 < learnt["difference_mm"] < -1.0
    assert "STILL GOOD" in robot
    gain, above = re.search(r"nearest, .*?; (-?[\d.]+) mm \(\S+ to (\S+)\) against raw", orchard).groups()
    assert float(gain) < -2.0 and float(above) < 0.0


def test_the_papers_numbers_and_references_are_there() -> None:
    paper, references = page("paper/paper.md"), page("paper/paper.bib")
    assert set(re.findall(r"@(\w+)", paper)) == set(re.findall(r"^@\w+\{(\w+),", references, re.M))
    intervals = re.findall(r"\(-?[\d.]+ to [\d.]+\)", paper.replace("95 % interval ", ""))
    assert len(intervals) >= 3
    shown = page("docs/results.md") + page("docs/_static/measured-robots.csv")
    assert [each for each in intervals if each not in shown] == []
