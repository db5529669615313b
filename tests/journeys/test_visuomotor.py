"""The way *visuomotor*: from an empty folder to the curve of a policy that sees, raw and calibrated.

The blocks of docs/visuomotor.md run as they are printed; they print what the page shows.
"""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

from tests.journeys.pages import ROOT, commands, ran

PRINTED = re.findall(r"^```text\n(.*?)^```", (ROOT / "docs/visuomotor.md").read_text("utf-8"), re.MULTILINE | re.DOTALL)
_, RECORD, CLONE, CURVE = commands("visuomotor.md")


@pytest.mark.slow
def test_from_an_empty_folder_to_the_curve_of_a_policy_that_sees(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    said = ran(CURVE, tmp_path)
    rows = [line.split() for line in said.splitlines() if line.startswith(("blind", "sees"))]
    picked = {(row[0], row[1]): int(row[3]) for row in rows}
    assert set(picked) == {(name, f"{error}") for name in ("blind", "sees") for error in (0, 5, 10)}
    for name in ("blind", "sees"):
        assert picked[name, "0"] >= 5
        assert picked[name, "0"] >= picked[name, "5"] >= picked[name, "10"]
    assert picked["sees", "10"] > picked["blind", "10"]
    assert PRINTED[1] == said
    written = json.loads((tmp_path / "curve.json").read_text("utf-8"))
    assert {(row["policy"], f"{row['error_mm']}"): row["picked"] for row in written} == picked


@pytest.mark.slow
def test_from_an_empty_folder_to_a_network_that_takes_fruit_by_pictures_with_arms_that_err(tmp_path: Path) -> None:
    for package in ("mujoco", "torch", "minari"):
        pytest.importorskip(package)
    for command in (RECORD, CLONE):
        said = ran(command, tmp_path)
    assert sum(file.stat().st_size for file in (tmp_path / "demonstrations").rglob("*.*")) < 5e6
    assert (tmp_path / "clone.npz").is_file()
    made, page = (np.array(re.findall(r"mm: (\d+) of 20", text), dtype=int) for text in (said, PRINTED[0]))
    assert np.abs(made - page).max() <= 4  # another processor trains another network
    assert made[3] <= made[0] - 6
