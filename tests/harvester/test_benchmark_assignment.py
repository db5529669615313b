"""How long it takes to plan a zone; run with --benchmark-enable. Nothing is asserted about time."""

import numpy as np
import pytest

from papers.li2016.cp_sat import cp_sat
from pickenv.harvester import assign, pick_point, zone_work


@pytest.mark.parametrize("method", ["search", "cp-sat"])
def test_a_plan_for_20_fruit(benchmark, machine, method):
    if method == "cp-sat":
        pytest.importorskip("ortools")
    fruit = np.array([-0.2, -1.4, 1.0]) + np.array([0.7, 0.4, 0.55]) * np.random.default_rng(20).random((20, 3))
    work = zone_work(machine, pick_point(machine, fruit), fruit)
    plan = benchmark(cp_sat, work) if method == "cp-sat" else benchmark(assign, work, method)
    assert sum(map(len, plan)) == work.reachable.sum()
