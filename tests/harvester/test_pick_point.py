"""Pick points by eqs (7)-(12) and by search, and the zones they serve."""

import sys
from itertools import pairwise

import numpy as np
import pytest

from pickenv.base import InputError
from pickenv.harvester import Grid, cut, load_grid, pick_point
from pickenv.harvester.pick_points import METHODS, Search, border_indices, searched

TARGETS = np.array([[420, -1400, 1000], [96, -1450, 1280], [-500, -1386, 1500]]) * 1e-3


def count(machine, fruit, method="search"):
    """Number of fruit that an arm reaches from the pick point."""
    return machine.reach(pick_point(machine, fruit, method), fruit).any(axis=0).sum()


def test_equations_7_to_12_give_another_pick_point_than_the_paper(machine):
    point = machine.frame3(pick_point(machine, TARGETS, "equations")) * 1e3
    assert point == pytest.approx([-26, -933, 1300], abs=0.6)
    assert np.linalg.norm(point - [-80, -660, 1220]) > 250


def test_equation_7_picks_the_opposite_border_fruit_at_negative_y():
    assert border_indices(TARGETS) == (0, 2)
    assert border_indices(TARGETS, printed=True) == (2, 0)


def test_shares_in_reach_are_82_85_and_over_97_percent(machine):
    rng, zones = np.random.default_rng(2016), 250
    found = dict.fromkeys(METHODS, 0.0)
    for _ in range(zones):
        corner = np.array([rng.uniform(-0.5, 0.5) - 0.42, -1.4, rng.uniform(0.42, 1.82)])
        fruit = corner + np.array([0.84, 0.4, 0.6]) * rng.random((12, 3))
        for method in ("equations", "corrected", "search"):
            found[method] += count(machine, fruit, method) / 12 / zones
    assert found["equations"] == pytest.approx(0.817, abs=0.03)
    assert found["corrected"] == pytest.approx(0.849, abs=0.03)
    assert found["search"] >= 0.972


def test_the_search_never_reaches_less_than_the_equations_do(machine):
    rng = np.random.default_rng(5)
    better = 0
    for _ in range(60):
        x, z = rng.uniform(-0.8, 0.8), rng.uniform(0.42, 1.8)
        fruit = np.array([x - 0.4, -1.4, z]) + np.array([0.8, 0.4, 0.6]) * rng.random((8, 3))
        better += count(machine, fruit) >= count(machine, fruit, "corrected")
    assert better >= 58


@pytest.mark.parametrize("fruit", [np.zeros((0, 3)), np.zeros((2, 2)), np.full((1, 3), np.nan)])
def test_a_zone_without_fruit_has_no_pick_point(machine, fruit):
    with pytest.raises(InputError, match="at least one fruit"):
        pick_point(machine, fruit)


def test_an_unknown_method_is_refused(machine):
    with pytest.raises(InputError, match="unknown pick point method"):
        pick_point(machine, TARGETS, "guess")


def test_fruit_at_the_axis_gives_an_unreachable_pick_point(machine):
    with pytest.raises(InputError, match="axis"):
        pick_point(machine, np.array([[0.0, -0.3, 1.0], [0.1, -0.31, 1.0]]), "corrected")


def test_zones_cover_the_side_and_overlap():
    zones = cut(load_grid(), -1.25, 1.25, 0.42, 2.42)
    points = np.random.default_rng(0).uniform([-1.25, -1.4, 0.42], [1.25, -1.0, 2.42], (500, 3))
    shown = np.sum([zone.holds(points) for zone in zones], axis=0)
    assert (shown > 0).all() and 0.1 < (shown > 1).mean() < 0.6
    steps = [abs(a.bottom - b.bottom) + abs(a.left - b.left) for a, b in pairwise(zones)]
    assert max(steps) < 0.7  # each zone is next to the one before


@pytest.mark.parametrize("side", [(1.0, -1.0, 0.0, 1.0), (0.0, 1.0, 1.0, 1.0), (1.0, 1.0, 0.0, 1.0)])
def test_an_empty_side_is_refused(side):
    with pytest.raises(InputError, match="empty"):
        cut(Grid(2, 2, 0.1), *side)


def test_zones_smaller_than_their_overlap_are_refused():
    with pytest.raises(InputError, match="overlap"):
        cut(Grid(50, 1, 0.1), -1.0, 1.0, 0.0, 1.0)


def test_a_zone_of_fruit_below_every_reach_has_a_pick_point_that_reaches_nothing(machine):
    assert count(machine, np.array([[0.0, -1.2, 0.40]])) == 0
    assert count(machine, np.array([[0.0, -1.2, 0.40], [0.1, -1.2, 0.5]])) == 1


@pytest.mark.parametrize("x", [-1.2, 0.8, 1.0])
def test_fruit_above_every_reach_does_not_pull_the_pick_point_away(machine, x):
    """Two fruit on one side, and five on the other that no height of the master brings near."""
    near = [[x, -0.9, 1.0], [0.95 * x, -1.0, 1.1]]
    high = [[-x + 0.1 * k, -0.9, 4.0] for k in range(5)]
    assert count(machine, np.array(near + high)) == 2


def test_the_search_starts_with_the_fruits_middle_before_the_arms_at_half_their_reach(machine, monkeypatch):
    """A search of one point and no width is where it starts: turned by a2, a4 and half a reach off."""
    monkeypatch.setattr(sys.modules[searched.__module__], "_search", lambda: Search(0.0, 0.0, 1, 1.0))
    low, high = machine.master.nominal.lower, machine.master.nominal.upper
    half = (machine.slave.lower[2] + machine.slave.upper[2]) / 2
    for x, y in ((0.3, -1.3), (-0.4, -1.5), (0.0, -1.4)):
        fruit = np.array([[x - 0.1, y + 0.05, 1.2], [x + 0.1, y - 0.05, 1.3]])
        away = np.hypot(x, y)
        heading, _, reach = searched(machine, fruit)
        assert low[2] < reach < high[2]
        assert reach == pytest.approx(away - machine.a4 - half)
        assert heading == pytest.approx(np.arctan2(y, x) + np.arcsin(machine.a2 / away))
