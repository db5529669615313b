"""The ledger: what pages print stands in it, what is drawn is made again, and about as many hold as are due."""

import importlib
import json
import re
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture
def claims(monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "scripts")
    return importlib.import_module("claims")


def number(rng, units):
    """A mean of so many units, with its interval."""
    half = 1.96 / np.sqrt(units)
    value = float(rng.normal() / np.sqrt(units))
    return {"value": value, "ci95": [value - half, value + half]}


@pytest.mark.parametrize("cheap", [64, 16, 4])
def test_as_many_hold_as_are_due_whatever_the_sizes(claims, cheap):
    rng = np.random.default_rng(3)
    held = np.mean([claims.holds(number(rng, 64), number(rng, cheap)) for _ in range(4000)])
    assert held == pytest.approx(claims.DUE, abs=0.02)


def test_pages_print_the_ledger(claims):
    """Every table between marks, and every number with an interval in a section that has one."""
    rows, tables = claims.record()["rows"], 0
    shown = {claims.shown(row) for row in rows}
    for path in sorted((ROOT / "docs").glob("*.md")):
        text = path.read_text(encoding="utf-8")
        for mark, asked, end in claims.MARK.findall(text):
            start = text.index(mark) + len(mark)
            assert text[start : text.index(end, start)] == claims.table_of(rows, json.loads(asked))
            tables += 1
    assert tables > 0
    text = (ROOT / "docs/findings.md").read_text(encoding="utf-8")
    section = text[text.index("## One look and") : text.index("## Calibrating while picking\n")]
    said = re.findall(r"-?\d+\.\d\d \(-?\d+\.\d\d to -?\d+\.\d\d\)", section)
    assert said and set(said) <= shown


def test_the_page_says_what_the_record_holds(claims):
    kept, known = claims.record(), claims.entries()
    assert (ROOT / "docs/claims.md").read_text(encoding="utf-8") == claims.page_of(kept, known)
    keys = [claims.key_of(row) for row in kept["rows"]]
    assert len(keys) == len(set(keys)) and {row["claim"] for row in kept["again"]} <= set(keys)
    assert {row["experiment"] for row in kept["rows"]} == set(known)
    assert all(row["seconds"] < 300.0 for row in kept["again"])


def test_every_row_can_be_made_again(claims):
    """Its experiment makes the table that it is of, and takes the cheap size."""
    for name, entry in claims.entries().items():
        rows = [row for row in claims.record()["rows"] if row["experiment"] == name]
        file = claims.load_experiment(ROOT / entry["file"], changes=entry["cheap"])
        assert rows and {row["title"] for row in rows} <= {number.title for number in file.numbers}
        assert (ROOT / "docs" / entry["page"]).is_file()


MADE = """
title = "toy"
measure = "claimed_toy.py:measure"
[units]
arm = 40
[factors]
method = ["raw", "ls"]
[settings]
load = [0.0, 1.0]
[[estimate]]
title = "Error (mm)"
value = "error_mm"
by = ["method", "load"]
over = ["arm"]
"""
CODE = """
def measure(rng, arm, method, load):
    return [{"load": each, "error_mm": rng.normal(3.0 if method == "raw" else 1.0)} for each in load]
"""


def test_a_row_is_made_again_from_its_levels_alone_at_another_seed(claims, tmp_path, monkeypatch):
    (tmp_path / "claimed_toy.toml").write_text(MADE, encoding="utf-8")
    (tmp_path / "claimed_toy.py").write_text(CODE, encoding="utf-8")
    monkeypatch.setattr(claims, "ROOT", tmp_path)
    row = {"experiment": "claimed_toy", "title": "Error (mm)", "levels": {"method": "ls", "load": 1.0}}
    again = claims.made_again(row, {"file": "claimed_toy.toml", "cheap": {"arm": 20}}, 5)
    other = claims.made_again(row, {"file": "claimed_toy.toml", "cheap": {"arm": 20}}, 6)
    assert again["levels"] == row["levels"] and 0.0 < again["value"] < 2.0 and again["value"] != other["value"]
    assert again["ci95"][0] < again["value"] < again["ci95"][1]
