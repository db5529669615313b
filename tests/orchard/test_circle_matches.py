"""Votes for circles and their matches in the right picture, written out edge by edge and pixel by pixel."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, map_coordinates

from pickenv.orchard import load_circle_search, load_stereo_camera
from pickenv.orchard.vision import _Edges, _matched, _taken, _voted, _window

CAMERA, SEARCH = load_stereo_camera("li2016"), load_circle_search("li2016")
REACH = CAMERA.focal_length * CAMERA.baseline
MIDDLE, RADIUS = (60.3, 50.8), 14.0


def rim(share=1.0, radius=RADIUS, middle=MIDDLE):
    """Two edges to each pixel of a part of a circle's rim, with slopes towards its middle."""
    angle = np.linspace(0.0, 2.0 * np.pi * share, round(2 * 2 * np.pi * radius * share), endpoint=False)
    out = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    return _Edges(np.array(middle) + radius * out, -out)


@pytest.mark.parametrize("radius", [8.0, 14.0, 24.0])
def test_a_whole_rim_is_voted_for_at_its_middle_with_its_radius(radius):
    ((column, row, voted),) = _voted(SEARCH, rim(radius=radius), (110, 120))
    assert (column, row, voted) == (round(MIDDLE[0]), round(MIDDLE[1]), radius)


@pytest.mark.parametrize("radius", [8.0, 10.0, 20.0, 24.0])
def test_votes_are_shares_of_the_rim_whatever_the_radius(radius):
    """Somewhat less, for edges are rounded to pixels and votes shared with the next radii; no end counts for more."""

    def voted(share, least_arc):
        return len(_voted(replace(SEARCH, least_arc=least_arc), rim(share, radius), (110, 120)))

    assert voted(1.0, 0.8) == 1 and voted(1.0, 0.9) == 0
    assert voted(0.5, 0.4) == 1 and voted(0.5, 0.5) == 0


def test_edges_whose_votes_fall_beside_the_picture_count_for_nothing():
    """A middle beyond each border in turn; the picture is otherwise empty. One in its corner is found."""
    for middle in ((-5.0, 50.0), (125.0, 50.0), (60.0, -5.0), (60.0, 115.0)):
        assert _voted(SEARCH, rim(middle=middle), (110, 120)) == []
    assert len(_voted(SEARCH, rim(middle=(3.0, 3.0)), (110, 120))) == 1


def test_middles_nearer_than_four_fifths_of_the_larger_radius_are_one_fruit():
    found = [(50.0, 40.0, 10.0), (90.0, 40.0, 20.0)]
    assert _taken(found, 50.0, 47.9, 10.0) and not _taken(found, 50.0, 48.1, 10.0)
    assert _taken(found, 50.0, 49.5, 12.0) and not _taken(found, 50.0, 49.7, 12.0)
    assert _taken(found, 90.0, 55.9, 5.0) and not _taken([], 50.0, 40.0, 10.0)


@pytest.mark.parametrize("place", [(20.4, 15.6), (0.2, 0.3), (39.0, 29.0), (20.0, 15.0)])
def test_a_window_holds_every_pixel_within_reach_and_its_distance(place):
    (column, row), reach = place, 6.3
    down, across, distance = _window((30, 40), column, row, reach)
    inside = {(r, c) for r in range(30) for c in range(40) if math.hypot(c - column, r - row) <= reach}
    pairs = list(zip(down.ravel().tolist(), across.ravel().tolist(), strict=True))
    assert inside <= set(pairs)
    assert {r for r, _ in pairs} == {r for r in range(30) if abs(r - row) <= reach}
    assert {c for _, c in pairs} == {c for c in range(40) if abs(c - column) <= reach}
    assert distance.ravel().tolist() == pytest.approx([math.hypot(c - column, r - row) for r, c in pairs])


def pictures(disparity, shape=(70, 200)):
    """The same smooth pattern in both, ``disparity`` px apart."""
    first = 150.0 * gaussian_filter(np.random.default_rng(0).normal(size=shape), 2.0)
    rows, columns = np.mgrid[: shape[0], : shape[1]].astype(float)
    return first, map_coordinates(first, [rows, columns + disparity], order=3, mode="nearest")


def by_pixel(first, second, mask, circle):
    """Fruit, and up to two steps around it, from a pixel within its rim to three px without; each disparity in turn."""
    column, row, radius = circle
    near = [
        (r, c, math.hypot(c - column, r - row))
        for r in range(mask.shape[0])
        for c in range(mask.shape[1])
        if math.hypot(c - column, r - row) < radius + SEARCH.surroundings
    ]
    fruit = {(r, c) for r, c, distance in near if distance < radius and mask[r, c]}
    steps = [(i, j) for i in range(-2, 3) for j in range(-2, 3) if abs(i) + abs(j) <= 2]
    chosen = fruit | {
        (r, c) for r, c, distance in near if distance > radius - 1 and any((r + i, c + j) in fruit for i, j in steps)
    }
    cost = {}
    for shift in range(int(REACH / CAMERA.farthest), math.ceil(REACH / CAMERA.nearest) + 1):
        if shift <= min(c for _, c in chosen):
            apart = [min(abs(first[r, c] - second[r, c - shift]) / SEARCH.contrast, 1.0) ** 2 for r, c in chosen]
            cost[shift] = sum(apart) / len(apart)
    best = min(cost, key=cost.get)
    before, at, after = (cost[best + k] for k in (-1, 0, 1))
    return best + 0.5 * (before - after) / (before - 2 * at + after), 1.0 - at


@pytest.mark.parametrize("disparity", [45.0, 50.3, 60.7])
@pytest.mark.parametrize("circle", [(120.4, 35.2, 12.0), (90.0, 5.5, 9.3), (150.6, 62.0, 14.8)])
def test_a_match_is_the_disparity_at_which_fruit_and_its_edge_differ_least(circle, disparity):
    """A pattern that a leaf covers in the right picture, and a mask with holes: as every disparity tried in turn."""
    first, second = pictures(disparity)
    second[int(circle[1]) :, int(circle[0] - disparity) + 3 :] = 200.0
    mask = np.random.default_rng(1).random(first.shape) < 0.7
    found = _matched(CAMERA, SEARCH, first, second, mask, circle)
    assert found == pytest.approx(by_pixel(first, second, mask, circle), abs=1e-9)
    assert abs(found[0] - disparity) < 1.0 and 0.4 < found[1] < 0.9


def test_what_is_nearer_or_farther_than_is_matched_or_beside_the_right_picture_has_no_match():
    low, high = int(REACH / CAMERA.farthest), math.ceil(REACH / CAMERA.nearest)
    mask = np.ones((70, 200), dtype=bool)
    for disparity, matched in ((low, False), (low + 1, True), (high - 1, True), (high, False)):
        found = _matched(CAMERA, SEARCH, *pictures(float(disparity)), mask, (130.0, 35.0, 10.0))
        assert (found[1] > 0.99) == matched and (matched or found == (1.0, -1.0))
    for spare in (0, 1, 2, 3):  # columns by which the leftmost pixel of the patch lies within the right picture
        column = low + spare + 11.0  # fruit 9 px to its left, and its edge 2 more
        first, second = pictures(low + 1.0)
        found = _matched(CAMERA, SEARCH, first, second, mask, (column, 35.0, 10.0))
        assert (found[1] > 0.99) == (spare >= 2), spare
