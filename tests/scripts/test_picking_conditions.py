"""Tables of picking: differences are paired by canopy, and conditions are environments that exist."""

import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "scripts/policies"))

from picking_conditions import CONDITIONS, PARTS, beside, row_of  # noqa: E402

from pickenv.agents.training.policy_search import KNOBS  # noqa: E402
from pickenv.envs.picking.pick_vector import PickVectorEnv  # noqa: E402


def test_a_row_pairs_canopies_and_counts_picks_by_the_hour():
    rng = np.random.default_rng(0)
    script = {"collected": [rng.integers(2, 9, 12).tolist()], "damaged": [[0] * 12], "steps": [[200] * 12]}
    better = [[fruit + 1 + (i == seed) for i, fruit in enumerate(script["collected"][0])] for seed in range(5)]
    learnt = {"collected": better, "damaged": [[1] * 12] * 5, "steps": [[100] * 12] * 5}
    row = row_of("here", "learnt", learnt, script)
    assert row["difference"] == pytest.approx(1.0 + 1.0 / 12.0) and row["trainings"] == 5
    assert row["difference_ci95"][0] < row["difference"] < row["difference_ci95"][1]
    assert row["picks_per_hour"] == pytest.approx(row["collected"] * 360.0)
    assert row_of("here", "scripted", script, script)["difference_ci95"] is None
    rows = [row_of(place, str(i), learnt, script) for place in CONDITIONS for i in range(3)]
    line = beside(rows)[2]
    assert line.count("|") == 7 and "+1.08" in line and "1.00, 1.00, 1.00" in line


def test_conditions_are_environments_and_parts_are_all_of_what_is_learnt():
    for arguments in CONDITIONS.values():
        PickVectorEnv(1, **arguments)
    assert sorted(knob for part in PARTS.values() for knob in part) == sorted(KNOBS)
