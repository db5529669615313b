"""Circles find what Li's regions cannot: touching fruit, and the middle of a fruit behind a leaf."""

from dataclasses import replace

import numpy as np
import pytest

from pickenv.orchard import (
    fruit_circles,
    fruit_regions,
    load_circle_search,
    load_look,
    load_stereo_camera,
    locate,
    locate_circles,
    match_detections,
    project,
    render_stereo,
    sample_leaves,
)
from pickenv.orchard.vision import _Edges, _edges, _filled, _fitted, summit

CAMERA, LOOK, SEARCH = load_stereo_camera("li2016"), load_look("red_apples"), load_circle_search("li2016")
NONE = np.zeros((0, 3))


def picture(fruit, seed=0, leaves=NONE):
    return render_stereo(CAMERA, np.atleast_2d(fruit), 0.06, leaves, LOOK, np.random.default_rng(seed))


@pytest.mark.parametrize("place", [[0.0, 0.0, 1.0], [0.313, -0.207, 1.17], [-0.29, 0.21, 1.4]])
def test_a_fruit_is_a_circle_of_its_place_and_size_to_a_fraction_of_a_pixel(place):
    found = fruit_circles(SEARCH, picture(place).left)
    assert found.centres.shape == (1, 2)
    assert found.centres[0] == pytest.approx(project(CAMERA, place)[:2], abs=0.35)
    assert found.radii[0] == pytest.approx(CAMERA.focal_length * 0.03 / place[2], abs=0.7)


def test_depth_is_told_to_a_fifth_of_a_pixel_of_disparity():
    rng, miss = np.random.default_rng(1), []
    for seed in range(4):
        place = [rng.uniform(-0.3, 0.3), rng.uniform(-0.2, 0.2), rng.uniform(1.0, 1.4)]
        pair = picture(place, seed)
        (found,) = project(CAMERA, locate_circles(CAMERA, SEARCH, pair.left, pair.right).positions)
        miss.append(found[2] - project(CAMERA, place)[2])
    assert np.abs(miss).max() < 0.35 and np.sqrt(np.mean(np.square(miss))) < 0.2


def test_touching_fruit_are_two_circles_where_they_are_one_region():
    pair = picture([[-0.03, 0.0, 1.1], [0.03, 0.0, 1.1]])
    assert len(fruit_regions(CAMERA, pair.left).areas) == 1
    found = fruit_circles(SEARCH, pair.left).centres
    wanted = project(CAMERA, [[-0.03, 0.0, 1.1], [0.03, 0.0, 1.1]])[:, :2]
    assert found[np.argsort(found[:, 0])] == pytest.approx(wanted, abs=1.0)


@pytest.mark.parametrize("share", [0.3, 0.5])
def test_what_covers_a_part_of_a_fruit_does_not_move_its_middle(share):
    """A green edge over one side: the region's centroid moves away from it by millimetres, the circle stays."""
    pair = picture([0.0, 0.0, 1.1])
    column, row, disparity = project(CAMERA, [0.0, 0.0, 1.1])
    radius = CAMERA.focal_length * 0.03 / 1.1
    for image, shift in ((pair.left, 0.0), (pair.right, disparity)):
        edge = round(column - shift - radius + 2 * radius * share)
        image[int(row - 20) : int(row + 20), edge - 30 : edge] = np.uint8([70, 120, 50])
    found = fruit_circles(SEARCH, pair.left)
    assert found.centres[0] == pytest.approx([column, row], abs=0.8)
    assert fruit_regions(CAMERA, pair.left).centroids[0][0] - column > 0.25 * radius * share * 2
    (seen,) = locate_circles(CAMERA, SEARCH, pair.left, pair.right).positions
    assert seen == pytest.approx([0.0, 0.0, 1.1], abs=8e-3)


def test_in_leaves_circles_find_more_and_miss_the_same_fruit_by_less():
    rng = np.random.default_rng(3)
    count, both = np.zeros(2, dtype=int), []
    grid = np.stack(np.meshgrid(np.linspace(-0.4, 0.4, 4), np.linspace(-0.25, 0.25, 3)), axis=-1).reshape(-1, 2)
    for _ in range(4):
        fruit = np.column_stack([grid + rng.uniform(-0.04, 0.04, grid.shape), rng.uniform(1.0, 1.4, 12)])
        leaves = sample_leaves([-0.8, -0.6, 1.0], [0.8, 0.6, 1.4], 1.25, LOOK, rng)
        pair = render_stereo(CAMERA, fruit, 0.06, leaves, LOOK, rng)
        miss = np.full((2, 12, 3), np.nan)
        seen = locate(CAMERA, pair.left, pair.right), locate_circles(CAMERA, SEARCH, pair.left, pair.right)
        for i, found in enumerate(seen):
            matched = match_detections(found, fruit, 0.06)
            true = matched.fruit >= 0
            miss[i, matched.fruit[true]] = matched.positions[true] - fruit[matched.fruit[true]]
        found = np.isfinite(miss).all(axis=-1)
        count += found.sum(axis=1)
        both.append(miss[:, found.all(axis=0)])
    rms = np.sqrt((np.concatenate(both, axis=1) ** 2).mean(axis=1))
    assert count[1] > count[0] > 20
    assert (rms[1] < rms[0]).all()


def test_leaves_alone_and_pictures_of_one_colour_hold_no_circles():
    rng = np.random.default_rng(2)
    leaves = sample_leaves([-0.8, -0.6, 1.0], [0.8, 0.6, 1.4], 2.0, LOOK, rng)
    pair = render_stereo(CAMERA, NONE, 0.06, leaves, LOOK, rng)
    assert len(locate_circles(CAMERA, SEARCH, pair.left, pair.right)) == 0
    black = np.zeros_like(pair.left)
    assert len(fruit_circles(SEARCH, black).radii) == 0


def test_a_fruit_of_another_size_is_looked_for_where_the_search_says():
    pair = picture([0.0, 0.0, 1.0])  # 15.4 px
    assert len(fruit_circles(replace(SEARCH, largest=12), pair.left).radii) == 0
    assert len(fruit_circles(replace(SEARCH, smallest=12, largest=18), pair.left).radii) == 1


def test_the_summit_of_a_parabola():
    x = np.array([-1.0, 0.0, 1.0])
    for top in (-0.7, 0.0, 0.4):
        assert summit(*(3.0 - 2.0 * (x - top) ** 2)) == pytest.approx(top)
    assert summit(1.0, 1.0, 1.0) == 0.0


@pytest.mark.parametrize("shift", [-5, -2, -1, 0, 1, 2, 5])
def test_an_edge_is_where_the_colour_changes_most_up_to_two_and_a_half_pixels_from_the_masks(shift):
    """A step between columns 29 and 30, right and left, and a mask that begins before or after it."""
    step = np.where(np.arange(60) < 30, 0.0, 100.0) * np.ones((40, 1))
    mask = np.broadcast_to(np.arange(60) >= 30 + shift, step.shape)
    for turned in (lambda part: part, lambda part: part[:, ::-1].copy(), lambda part: part.T.copy()):
        edges = _edges(replace(SEARCH, blur=2.0), turned(step), turned(mask))
        axis = 1 if turned(mask).shape == (60, 40) else 0
        places, slopes = edges.places[:, axis], edges.slopes[:, axis]
        if turned(step)[0, 0] > 0:
            places, slopes = 59 - places, -slopes
        assert len(places) == 80 and slopes == pytest.approx(np.ones(80))
        if abs(shift) < 2:
            assert places == pytest.approx(np.full(80, 29.5), abs=0.26)
        rim = np.sort(np.repeat([29 + shift, 30 + shift], 40))
        assert np.abs(np.sort(places) - rim).max() <= 2.5


def test_a_fitted_circle_balances_its_edges_each_the_less_the_farther_and_the_radius_voted_for():
    """At the end the weighted misses and three edges' wish for the voted radius pull nowhere; far edges are out."""
    rng = np.random.default_rng(2)
    angle = np.concatenate([rng.uniform(0.0, 4.0, 50), rng.uniform(4.0, 5.0, 15), rng.uniform(0.0, 6.0, 20)])
    out = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    length = 13.0 + np.concatenate(
        [0.1 * rng.normal(size=50), 0.7 * SEARCH.rim + np.zeros(15), 3 * SEARCH.rim + np.zeros(20)]
    )
    slopes = -out.copy()
    slopes[::7] = out[::7]  # towards less red: the rim of something else
    column, row, radius = _fitted(SEARCH, _Edges([40.0, 30.0] + length[:, None] * out, slopes), 40.5, 29.4, 14.0)
    away = [40.0, 30.0] + length[:, None] * out - [column, row]
    distance = np.linalg.norm(away, axis=1)
    miss = distance - radius
    rim = (np.abs(miss) < SEARCH.rim) & (-(slopes * away).sum(axis=1) > 0.8 * distance)
    assert 40 < rim.sum() < 65
    pull = (miss / (1.0 + (miss / SEARCH.tight) ** 2))[rim]
    left = np.append(pull @ (away / distance[:, None])[rim], pull.sum() + 3.0 * (14.0 - radius))
    assert np.abs(left).max() < 0.05 < np.abs(pull).sum()


def test_a_disc_is_filled_by_its_pixels_of_fruit_colour_also_over_the_pictures_border():
    rng = np.random.default_rng(4)
    mask = rng.random((30, 40)) < 0.6
    rows, columns = np.mgrid[:30, :40]
    for column, row, radius in ((20.3, 11.8, 6.0), (1.2, 28.5, 5.5), (39.0, 0.0, 4.0), (-9.0, 5.0, 3.0)):
        inside = mask[np.hypot(columns - column, rows - row) < radius]
        assert _filled(mask, column, row, radius) == (inside.mean() if inside.size else 0.0)
