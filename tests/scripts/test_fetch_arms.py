"""Fetch's tasks with arms that err: their own rule does not see it, millimetres do. Needs gymnasium-robotics."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pickenv.arm import forward
from pickenv.base import InputError

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "scripts"))

import fetch_arms  # noqa: E402


def test_without_the_package_one_sentence_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "gymnasium_robotics", None)
    with pytest.raises(InputError, match=r"^Fetch needs Gymnasium-Robotics; pip install gymnasium-robotics$"):
        fetch_arms.fetch()


@pytest.mark.slow
def test_arms_of_three_millimetres_err_by_three_and_calibrated_by_less():
    pytest.importorskip("gymnasium_robotics", reason="pip install gymnasium-robotics")
    env = fetch_arms.fetch()
    nominal, start = fetch_arms.started(env)
    plants = fetch_arms.arms_of(nominal, start, 3.0, 2, 0)
    rng = np.random.default_rng(1)
    for plant in plants:
        poses = fetch_arms.around(nominal, start, rng)
        error = np.linalg.norm(plant.tool_pose(poses).position - forward(nominal, poses).position, axis=1)
        assert error.mean() == pytest.approx(3e-3, rel=0.25)
    raw = fetch_arms.reaches(env, plants[0], None, range(4))
    mended = fetch_arms.reaches(env, plants[0], fetch_arms.calibrated(plants[0], start, rng), range(4))
    assert np.all(raw < fetch_arms.OWN_MM) and np.median(raw) > 1.5 and np.median(mended) < 1.0


@pytest.mark.slow
def test_picks_of_a_perfect_arm_end_near_and_a_calibration_brings_those_of_20_mm_back():
    pytest.importorskip("gymnasium_robotics", reason="pip install gymnasium-robotics")
    env = fetch_arms.fetch("PickAndPlace")
    nominal, start = fetch_arms.started(env)
    plant = fetch_arms.arms_of(nominal, start, 20.0, 1, 0)[0]
    bare = fetch_arms.episodes(env, fetch_arms.picking, range(4))
    assert all(info["is_success"] for _, info in bare)
    perfect = fetch_arms.picks(env, replace(plant, geometry=nominal), None, range(4))
    own = [end["achieved_goal"] - end["desired_goal"] for end, _ in bare]
    np.testing.assert_array_equal(perfect, np.linalg.norm(own, axis=1) * 1e3)
    raw = fetch_arms.picks(env, plant, None, range(4))
    mended = fetch_arms.picks(env, plant, fetch_arms.calibrated(plant, start, np.random.default_rng(1)), range(4))
    assert np.all(perfect < fetch_arms.NEAR_MM) and np.all(raw > fetch_arms.NEAR_MM)
    assert np.all(mended < fetch_arms.NEAR_MM)
    np.testing.assert_array_equal(fetch_arms.picks(env, plant, None, range(4)), raw)


def test_a_share_has_its_interval_over_arms():
    distances = np.repeat([[1.0, 2.0, 30.0, 60.0]], 12, axis=0)
    row = fetch_arms.share(distances, 50.0)
    assert row["share"] == 0.75 and row["ci95"][0] < 0.75 < row["ci95"][1]
    assert fetch_arms.share(distances[:2], 20.0) == {"share": 0.5, "ci95": None}
