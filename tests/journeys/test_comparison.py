"""Two policies → `pickenv compare` → who is better, where and by how much, as docs/comparing-policies.md prints it."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

from tests.journeys.pages import commands, walked


@pytest.mark.slow
def test_the_page_told_from_an_empty_folder_ends_with_a_calibrated_policy_far_nearer(tmp_path: Path) -> None:
    said = walked("comparing-policies.md", tmp_path)
    compared = json.loads((tmp_path / "compared.json").read_text(encoding="utf-8"))
    raw, calibrated = compared["rows"]
    assert [raw["policy"], calibrated["policy"]] == ["raw", "LS"]
    assert 1.5 < raw["mean_mm"] < 2.6 and calibrated["mean_mm"] < 0.4 * raw["mean_mm"]
    (line,) = compared["differences"]
    assert line["ci95_mm"][1] < 0.0 and line["significant"]
    table, tables = said[1], re.compile(r"^ *raw +([\d.]+) ", re.MULTILINE)
    assert float(tables.search(table)[1]) == round(raw["mean_mm"], 3)
    assert compared["explanation"] in " ".join(table.split())
    ppo = json.loads((tmp_path / "ppo.json").read_text(encoding="utf-8"))
    beginner, trained = ppo["rows"]
    assert beginner["mean_mm"] > 10.0 > trained["median_mm"]  # his error is far beyond what plots to 25 mm show
    assert trained["picked"] > beginner["picked"]
    still = dict(re.findall(r"^(\w+) ([\d.]+) mm$", said[-1], re.MULTILINE))
    assert float(still["Still"]) > 100.0 > float(still["scripted"])
    for name in ("comparison.rrd", "report.html", "figures/difference_map.png", "episodes.npz"):
        assert (tmp_path / "runs/ppo" / name).stat().st_size > 1000


def test_every_command_of_the_page_is_told() -> None:
    assert sum(command[3] == "compare" for command in commands("comparing-policies.md") if command[1] == "-m") == 2
    assert np.all([len(command) > 2 for command in commands("comparing-policies.md")])
