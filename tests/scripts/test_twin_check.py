"""UR5's twin predicts what corrections gain on measured rows that it never saw; the page prints what is found."""

import re
import sys
from pathlib import Path

import numpy as np
import pytest

from pickenv.errors import InputError

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "scripts"))

import twin_check  # noqa: E402

PAGE = (ROOT / "docs/twin.md").read_text(encoding="utf-8")
ASKED = 0.25
"""Predicted and measured gains agree within this share of the measured one."""


@pytest.mark.parametrize("split", ["random", "blocked"])
def test_every_row_is_held_out_once(split):
    folds = twin_check.folds_of(23, split)
    assert sorted(np.concatenate([held for _, held in folds]).tolist()) == list(range(23))
    for fitted, held in folds:
        assert sorted([*fitted.tolist(), *held.tolist()]) == list(range(23))
        assert split == "random" or np.ptp(held) == len(held) - 1


def test_gains_are_shares_of_what_was_left_before():
    squares = {"nominal": [16.0, 16.0], "LS": [4.0, 4.0], "LS + terms": [1.0, 1.0], "LS + GP": [0.0, 8.0]}
    found = twin_check.gains({name: np.array(values) for name, values in squares.items()})
    assert found == pytest.approx({"LS": 0.5, "LS + terms": 0.5, "LS + GP": 0.0})


def test_the_page_s_ratios_are_those_of_its_gains_and_as_near_as_asked():
    rows = re.findall(
        r"^\|[^|]*\| (LS[^|]*) \| ([\d.]+) % \(([\d.]+) to ([\d.]+)\) \| ([\d.]+) %[^|]*\| ([\d.]+) \|$", PAGE, re.M
    )
    assert [row[0] for row in rows] == 2 * list(twin_check.STEPS)
    for _, predicted, low, high, measured, ratio in rows:
        assert float(low) < float(predicted) < float(high)
        assert float(ratio) == pytest.approx(float(predicted) / float(measured), abs=0.011)
        assert abs(float(ratio) - 1.0) < ASKED


def test_without_the_data_one_sentence_says_so(tmp_path):
    with pytest.raises(InputError, match="name the folder of the data sets in PICKENV_DATA"):
        twin_check.checked(tmp_path, "random", 2)


@pytest.mark.slow
def test_the_twin_of_ur5_predicts_the_gains_of_its_calibrations(data_folder: Path):
    found = twin_check.checked(data_folder, "random", 2)["gains"]
    for name, row in found.items():
        assert row["predicted"] == pytest.approx(row["measured"], rel=ASKED), name
