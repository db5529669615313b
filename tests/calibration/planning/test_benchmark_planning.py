"""How long it takes to plan poses; run with --benchmark-enable. Nothing is asserted about time."""

import numpy as np
import pytest

from pickenv.calibration import link_model, plan_poses, random_joints


@pytest.mark.parametrize("criterion", ["d-optimal", "test-poses"])
def test_thirty_of_two_thousand(benchmark, qiao, criterion):
    there = random_joints(qiao.nominal, 50, np.random.default_rng(1))

    def plan():
        rng = np.random.default_rng(0)
        return plan_poses(qiao, link_model(qiao.nominal), 30, rng, criterion=criterion, test_joints=there)

    assert len(benchmark(plan).joints) == 30
