"""Foliage dims, fruit hides fruit, and the tool comes from below."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from pickenv.orchard import (
    approach_clear,
    depth_behind_face,
    foliage_path,
    foliage_transmission,
    load_canopy,
    occlusion,
    shipped,
)
from pickenv.orchard.canopy import disc_cover

quick = settings(deadline=None, derandomize=True)

AISLE = [0.0, -1.0, 1.6]
coordinates = st.floats(-3.0, 3.0)
point = st.tuples(coordinates, coordinates, st.floats(0.0, 4.0))


def test_lis_canopy_has_the_papers_dimensions() -> None:
    canopy = load_canopy("li2016")
    assert (canopy.bottom, canopy.top, canopy.depth, canopy.width, canopy.standoff) == (0.8, 2.8, 0.4, 2.5, 1.0)


def test_a_v_trellis_hangs_over_the_aisle() -> None:
    canopy = load_canopy("v_trellis")
    low, high = [0.0, 0.1, canopy.bottom], [0.0, 0.1, canopy.top]
    assert depth_behind_face(canopy, high) > depth_behind_face(canopy, low)


@quick
@given(point, point)
def test_the_way_through_foliage_is_the_same_both_ways_and_no_longer_than_the_way(a: tuple, b: tuple) -> None:
    for name in shipped("canopy"):
        canopy = load_canopy(name)
        through = foliage_path(canopy, a, b)
        assert through == pytest.approx(foliage_path(canopy, b, a), abs=1e-9)
        assert -1e-12 <= through <= np.linalg.norm(np.subtract(a, b)) + 1e-9


@quick
@given(point, point)
def test_the_way_through_foliage_is_what_small_steps_measure(a: tuple, b: tuple) -> None:
    canopy = load_canopy("v_trellis")
    along = np.linspace(a, b, 2001)
    along[:, 0] = 0.0  # foliage goes on along the row
    middles = (along[1:] + along[:-1]) / 2
    behind = depth_behind_face(canopy, middles)
    inside = (behind >= 0.0) & (behind <= canopy.depth)
    inside &= (middles[:, 2] >= canopy.bottom) & (middles[:, 2] <= canopy.top)
    steps = inside.mean() * np.linalg.norm(np.subtract(a, b))
    assert foliage_path(canopy, a, b) == pytest.approx(steps, abs=0.01)


def test_foliage_dims_as_beer_and_lambert_have_it() -> None:
    canopy = load_canopy("li2016")
    seen = foliage_transmission(canopy, AISLE, [[0.0, d, 1.6] for d in (0.0, 0.1, 0.2, 0.4)])
    extinction = canopy.leaf_projection * canopy.leaf_area_per_volume
    assert seen == pytest.approx(np.exp(-extinction * np.array([0.0, 0.1, 0.2, 0.4])))


@quick
@given(st.floats(0.01, 1.0), st.floats(0.01, 1.0), st.floats(0.0, 2.0))
def test_a_covered_area_is_the_same_from_either_disc(r: float, s: float, apart: float) -> None:
    assert disc_cover(r, s, apart) * r**2 == pytest.approx(disc_cover(s, r, apart) * s**2, abs=1e-9)


def test_two_equal_discs_half_a_diameter_apart_share_39_percent() -> None:
    assert disc_cover(1.0, 1.0, 1.0) == pytest.approx((2 * np.pi / 3 - np.sqrt(3) / 2) / np.pi)
    assert disc_cover(1.0, 1.0, 2.0) == pytest.approx(0.0, abs=1e-12)
    assert disc_cover(1.0, 2.0, 0.5) == 1.0


def test_a_fruit_behind_another_is_hidden_and_the_one_before_is_not() -> None:
    canopy = load_canopy("li2016")
    fruit = [[0.0, 0.05, 1.6], [0.0, 0.3, 1.6]]
    visible, _ = occlusion(canopy, fruit, 0.075, AISLE)
    through_leaves = foliage_transmission(canopy, AISLE, fruit)
    assert visible[0] == through_leaves[0]
    assert visible[1] / through_leaves[1] == pytest.approx(0.0, abs=1e-9)


def test_a_fruit_half_behind_another_shows_its_far_side() -> None:
    canopy = load_canopy("li2016")
    fruit = [[0.0, 0.05, 1.6], [0.05, 0.3, 1.6]]
    visible, visible_side = occlusion(canopy, fruit, 0.075, AISLE)
    assert 0.2 < visible[1] / foliage_transmission(canopy, AISLE, fruit)[1] < 0.8
    assert visible_side[1] @ [1.0, 0.0, 0.0] > 0.99  # to the right, where nothing stands before it
    assert not visible_side[0].any()


def test_viewpoints_come_in_batches() -> None:
    canopy, rng = load_canopy("v_trellis"), np.random.default_rng(0)
    positions = rng.uniform([-1, 0, 1], [1, 0.4, 2], size=(7, 3))
    views = rng.uniform([-1, -1.5, 1], [1, -1, 2], size=(2, 5, 3))
    many = occlusion(canopy, positions, 0.07, views)
    assert many[0].shape == (2, 5, 7) and many[1].shape == (2, 5, 7, 3)
    one = occlusion(canopy, positions, 0.07, views[1, 3])
    np.testing.assert_allclose(many[0][1, 3], one[0], atol=1e-12)


def test_deeper_fruit_is_seen_less() -> None:
    canopy = load_canopy("v_trellis")
    row = [[x, 0.1 * i - 0.1, 1.5] for i, x in enumerate((-0.6, -0.2, 0.2, 0.6))]
    assert (np.diff(occlusion(canopy, row, 0.07, [0.0, -30.0, 1.5])[0]) < 0).all()


def test_a_fruit_right_below_blocks_the_cup_and_one_above_does_not() -> None:
    stacked = [[0.0, 0.2, 1.5], [0.0, 0.2, 1.42], [0.5, 0.2, 1.5]]
    clear = approach_clear(stacked, 0.075, [0.0, 0.0, 1.0], tool_radius=0.037)
    assert clear.tolist() == [False, True, True]
