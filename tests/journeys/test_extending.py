"""docs/extending.md in an empty folder: what it shows of each kind of extension works as printed."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

PAGE = (Path(__file__).parents[2] / "docs/extending.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```(\w+)(?: +(\S+))?\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)


def test_every_block_is_a_named_file_or_python() -> None:
    assert {(kind, bool(name)) for kind, name, _ in BLOCKS} == {("toml", True), ("python", False)}
    assert len(re.findall(r"^In pickenv: ", PAGE, re.MULTILINE)) == len(re.findall(r"^## ", PAGE, re.MULTILINE)) == 11


@pytest.mark.slow
def test_what_is_added_works(tmp_path: Path) -> None:
    said = []
    for kind, name, text in BLOCKS:
        if kind == "toml":
            (tmp_path / name).write_text(text, encoding="utf-8")
            continue
        done = subprocess.run([sys.executable, "-c", text], cwd=tmp_path, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        said.append(done.stdout)
    door, _, dh, missed, effect, calibrated, kind, height, _, residual, policies, chance, table, page, steps = said
    assert door.splitlines()[0] == "bpnn rbf gp" and door.splitlines()[1].startswith("the package pickenv ")
    assert (dh, effect, kind) == ("('J1', 'J2', 'J3', 'J4')\n", "soft_ground\n", "laser\n")
    assert (residual, policies, chance, page, steps) == ("neighbours\n", "scripted patient\n", "0.75\n", "1\n", "4\n")
    assert height.startswith("verdict: ")
    assert float(missed.split()[0]) > 10.0
    before, after = (float(number) for number in re.findall(r"([\d.]+) to ([\d.]+) mm", calibrated)[0])
    assert after < 0.25 * before  # the plant's springs are among the terms that are sought
    designed, identified = (float(cell) for cell in table.splitlines()[0].strip("|").split("|")[1:])
    assert abs(designed - identified) < 0.01  # only the springs differ: the rows leave the geometry as it is drawn
