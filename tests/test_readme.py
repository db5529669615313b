"""What the README prints is true: its blocks run in order, its make targets and its files exist."""

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
LINK = re.compile(r"\]\(([^)\s]+)\)")

ELSEWHERE = {"make test": "it runs this very test"}
COMMANDS = ("make", "pickenv")
SHORTER = {"learn(100_000)": "learn(2_048)"}  # what a reader waits for and a test need not

ENVIRONMENT = {name: value for name, value in os.environ.items() if not name.startswith(("MAKE", "MFLAGS"))} | {
    "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
    "MPLBACKEND": "Agg",
}


def blocks() -> list[tuple[str, str]]:
    """Language and text of every fenced block, in the README's order."""
    return BLOCK.findall(README)


def shell_lines() -> Iterator[str]:
    for language, text in blocks():
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
    assert {language for language, _ in blocks()} == {"sh", "python"}
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


@pytest.mark.slow
def test_every_block_runs_in_order(tmp_path: Path) -> None:
    for language, text in blocks():
        if language == "python":
            for long, short in SHORTER.items():
                text = text.replace(long, short)
            run([sys.executable, "-c", text], tmp_path)
            continue
        for line in text.splitlines():
            if line in ELSEWHERE:
                continue
            words = shlex.split(line)
            run(shlex.split(recipe(words[1])) if words[0] == "make" else words, tmp_path)
