"""FetchReach with arms of 3 mm: its own rule does not see them, millimetres do. Needs gymnasium-robotics."""

import sys
from pathlib import Path

import numpy as np
import pytest

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
    plants = fetch_arms.arms_of(nominal, start, 3.0, 2)
    rng = np.random.default_rng(1)
    for plant in plants:
        poses = fetch_arms.around(nominal, start, rng)
        error = np.linalg.norm(plant.tool_pose(poses).position - fetch_arms.forward(nominal, poses).position, axis=1)
        assert error.mean() == pytest.approx(3e-3, rel=0.25)
    raw = fetch_arms.reaches(env, plants[0], None, 4)
    mended = fetch_arms.reaches(env, plants[0], fetch_arms.calibrated(plants[0], start, rng), 4)
    assert np.all(raw < fetch_arms.OWN_MM) and np.median(raw) > 1.5 and np.median(mended) < 1.0
