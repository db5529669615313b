"""Circles find what Li's regions cannot: touching fruit, and the middle of a fruit behind a leaf."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, gaussian_filter1d, map_coordinates

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
    triangulate,
    vision,
)
from pickenv.orchard.vision import _edges, _filled, _fitted, _matched, _taken, _voted, _window, summit

CAMERA, LOOK, SEARCH = load_stereo_camera("li2016"), load_look("red_apples"), load_circle_search("li2016")
NONE = np.zeros((0, 3))


def picture(fruit, seed=0, leaves=NONE):
    return render_stereo(CAMERA, np.atleast_2d(fruit), 0.06, leaves, LOOK, np.random.default_rng(seed))


@pytest.mark.parametrize("place", [[0.0, 0.0, 1.0], [0.313, -0.207, 1.17], [-0.29, 0.21, 1.4]])
def test_a_fruit_is_a_circle_of_its_place_and_size_to_a_fraction_of_a_pixel(place):
    ((*centre, radius),), _ = fruit_circles(SEARCH, picture(place).left)
    assert centre == pytest.approx(project(CAMERA, place)[:2], abs=0.35)
    assert radius == pytest.approx(CAMERA.focal_length * 0.03 / place[2], abs=0.7)


def test_depth_is_told_to_a_fifth_of_a_pixel_of_disparity():
    rng, miss = np.random.default_rng(1), []
    for seed in range(4):
        place = [rng.uniform(-0.3, 0.3), rng.uniform(-0.2, 0.2), rng.uniform(1.0, 1.4)]
        pair = picture(place, seed)
        (found,) = project(CAMERA, locate_circles(CAMERA, SEARCH, pair.left, pair.right)[0])
        miss.append(found[2] - project(CAMERA, place)[2])
    assert np.abs(miss).max() < 0.35 and np.sqrt(np.mean(np.square(miss))) < 0.2


def test_touching_fruit_are_two_circles_where_they_are_one_region():
    pair = picture([[-0.03, 0.0, 1.1], [0.03, 0.0, 1.1]])
    assert len(fruit_regions(CAMERA, pair.left)[0]) == 1
    found = fruit_circles(SEARCH, pair.left)[0][:, :2]
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
    found, _ = fruit_circles(SEARCH, pair.left)
    assert found[0, :2] == pytest.approx([column, row], abs=0.8)
    assert fruit_regions(CAMERA, pair.left)[0][0, 0] - column > 0.25 * radius * share * 2
    (seen,) = locate_circles(CAMERA, SEARCH, pair.left, pair.right)[0]
    assert seen == pytest.approx([0.0, 0.0, 1.1], abs=8e-3)


@pytest.mark.slow
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
        for i, (places, _) in enumerate(seen):
            matched = match_detections(places, fruit, 0.06)
            true = matched >= 0
            miss[i, matched[true]] = places[true] - fruit[matched[true]]
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
    assert len(locate_circles(CAMERA, SEARCH, pair.left, pair.right)[0]) == 0
    black = np.zeros_like(pair.left)
    assert len(fruit_circles(SEARCH, black)[0]) == 0


def test_a_fruit_of_another_size_is_looked_for_where_the_search_says():
    pair = picture([0.0, 0.0, 1.0])  # 15.4 px
    assert len(fruit_circles(replace(SEARCH, largest=12), pair.left)[0]) == 0
    assert len(fruit_circles(replace(SEARCH, smallest=12, largest=18), pair.left)[0]) == 1


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
        places, slopes = edges[0][:, axis], edges[1][:, axis]
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
    column, row, radius = _fitted(SEARCH, ([40.0, 30.0] + length[:, None] * out, slopes), 40.5, 29.4, 14.0)
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


# Edges, votes and fits of circles, each worked out once more edge by edge, and what becomes of a found circle.
PLACES = np.array([[-0.2, 0.0, 1.1], [0.2, 0.1, 1.2]])
PAIR = render_stereo(CAMERA, PLACES, 0.06, np.zeros((0, 3)), load_look("red_apples"), np.random.default_rng(0))


def steepest(picture, blur, row, column):
    """Place and slope of one edge: the largest of eleven values half a pixel apart along the slope, and a parabola."""
    down, right = (gaussian_filter1d(picture, blur, axis=a, order=1) for a in (0, 1))
    down, right = gaussian_filter1d(down, blur, axis=1), gaussian_filter1d(right, blur, axis=0)
    steep = np.sqrt(down**2 + right**2)
    slope = np.array([right[row, column], down[row, column]]) / steep[row, column]

    def height(offset):
        x, y = np.clip([column, row] + offset * slope, 0, np.array(steep.shape[::-1]) - 1)
        c, r = min(int(x), steep.shape[1] - 2), min(int(y), steep.shape[0] - 2)
        (a, b), (d, e) = steep[r : r + 2, c : c + 2]
        return (a * (1 - x + c) + b * (x - c)) * (1 - y + r) + (d * (1 - x + c) + e * (x - c)) * (y - r)

    offsets = [-2.5 + 0.5 * k for k in range(11)]
    heights = [height(o) for o in offsets]
    top = min(max(int(np.argmax(heights)), 1), 9)
    before, at, after = heights[top - 1 : top + 2]
    share = 0.5 * (before - after) / (before - 2 * at + after)
    return [column, row] + (offsets[top] + 0.5 * min(max(share, -1.0), 1.0)) * slope, slope


def test_every_pixel_beside_the_masks_rim_has_its_edge_where_the_slope_is_steepest():
    """Also at the picture's border, where the mask goes on and no edge is."""
    picture = gaussian_filter(np.random.default_rng(0).normal(size=(24, 30)), 2.0) * 100.0
    mask = picture > 3.0
    mask[0, 3:9], mask[5:9, -1] = True, True
    edges = _edges(SEARCH, picture, mask)
    rows, columns = mask.shape
    rim = [
        (r, c)
        for r in range(rows)
        for c in range(columns)
        if len({mask[i, j] for i, j in ((r, c), (r - 1, c), (r + 1, c), (r, c - 1), (r, c + 1))
                if 0 <= i < rows and 0 <= j < columns}) == 2
    ]  # fmt: skip
    assert len(edges[0]) == len(rim) > 100
    for place, slope, at in zip(edges[0], edges[1], rim, strict=True):
        expected = steepest(picture, SEARCH.blur, *at)
        np.testing.assert_allclose([place, slope], expected, atol=1e-9)


def test_where_the_colour_is_the_same_all_around_there_is_no_edge_but_a_faint_step_is_one():
    step = np.where(np.arange(60) < 30, 0.0, 2.0) * np.ones((20, 1))
    for begins, count in ((30, 40), (50, 0)):
        edges = _edges(SEARCH, step, np.broadcast_to(np.arange(60) >= begins, step.shape))
        assert len(edges[0]) == count and np.isfinite(edges[0]).all()


def test_a_summit_is_between_its_neighbours_and_a_slight_bend_is_one():
    assert summit(0.0, 1.0, 1.9) == 1.0 and summit(1.9, 1.0, 0.0) == -1.0
    assert summit(*(0.1 * (np.array([-1.0, 0.0, 1.0]) - 0.4) ** 2)) == pytest.approx(0.4)
    assert summit(1e-12, 0.0, 0.0) == 0.5 and summit(5e-13, 0.0, 0.0) == 0.0


def kernel(sigma, reach):
    weights = np.exp(-(np.arange(-reach, reach + 1) ** 2) / (2 * sigma**2))
    return weights / weights.sum()


def by_votes(search, edges, shape):
    """Each vote spread by hand, mirrored at the borders; then each pixel against its square, and its share."""
    radii = list(range(search.smallest, search.largest + 1, 2))
    votes, spread = np.zeros((len(radii), *shape)), np.outer(kernel(1.5, 6), kernel(1.5, 6))
    for k, radius in enumerate(radii):
        for place, slope in zip(edges[0], edges[1], strict=True):
            column, row = (round(v) for v in place + radius * slope)
            if 0 <= column < shape[1] and 0 <= row < shape[0]:
                for (i, j), weight in np.ndenumerate(spread):
                    r, c = row + i - 6, column + j - 6
                    r, c = (min(max(v, -1 - v), 2 * n - 1 - v) for v, n in ((r, shape[0]), (c, shape[1])))
                    votes[k, r, c] += weight * 2 * math.pi * 1.5**2 / (2 * 2 * math.pi * radius)
    across, near = np.zeros_like(votes), kernel(0.5, 2)
    for k in range(len(radii)):
        for step in range(-2, 3):
            if 0 <= k + step < len(radii):
                across[k] += near[step + 2] * votes[k + step]
    most, found = across.max(axis=0), []
    for r in range(3, shape[0] - 3):
        for c in range(3, shape[1] - 3):
            if 0 < most[r, c] == most[r - 3 : r + 4, c - 3 : c + 4].max():
                found.append((float(most[r, c]), (float(c), float(r), float(radii[int(across[:, r, c].argmax())]))))
    return sorted(found, reverse=True)


@pytest.mark.parametrize(("smallest", "largest", "shape"), [(8, 12, (36, 34)), (9, 12, (30, 36)), (8, 8, (33, 33))])
def test_votes_are_those_of_every_edge_along_its_slope_for_every_radius(smallest, largest, shape):
    """Most of them beside the picture's borders, within and without; the share of each circle to a millionth."""
    rng = np.random.default_rng(smallest + largest)
    search = replace(SEARCH, smallest=smallest, largest=largest)
    height, width = shape
    middles = [[x, 9.0 + 8 * k] for k, x in enumerate((0, -1, 1))] + [[width - x, 9.0 + 8 * x] for x in range(3)]
    middles += [[9.0 + 8 * k, y] for k, y in enumerate((0, -1, 1))] + [[9.0 + 8 * y, height - y] for y in range(3)]
    middles += [[4.0, 9.0], [width - 5.0, 8.0], [10.0, 4.0], [9.0, height - 5.0], [15.0, 16.0]]
    angle = rng.uniform(0.0, 2 * np.pi, 12 * len(middles))
    slopes = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    lengths = rng.choice([8.0, 9.0, 10.0, 11.0, 12.0], len(angle))
    edges = (np.repeat(middles, 12, axis=0) - lengths[:, None] * slopes, slopes)
    expected = by_votes(search, edges, shape)
    assert len(expected) >= 3
    for k, (share, _) in enumerate(expected):
        for least, count in ((share * (1 + 1e-6), k), (share * (1 - 1e-6), k + 1)):
            found = _voted(replace(search, least_arc=least), edges, shape)
            assert found == [circle for _, circle in expected[:count]]


def by_rounds(edges, column, row, voted):
    """Gauss-Newton on distances, six rounds at most, from the edges within two rims of the voted circle."""
    x, y, radius = column, row, voted
    near = [
        (p, s) for p, s in zip(edges[0], edges[1], strict=True) if math.hypot(*(p - [column, row])) < voted + 2 * 2.5
    ]
    for _ in range(6):
        rows, weights, misses = [], [], []
        for place, slope in near:
            out = place - [x, y]
            distance = math.hypot(*out)
            if abs(distance - radius) < 2.5 and -(slope @ out) > 0.8 * distance:
                rows.append([*(out / distance), 1.0])
                misses.append(distance - radius)
                weights.append(1.0 / (1.0 + (misses[-1] / 0.7) ** 2))
        if len(rows) < 8:
            break
        rows.append([0.0, 0.0, 1.0])  # three edges' wish for the voted radius
        misses.append(voted - radius)
        root = np.sqrt([*weights, 3.0])
        step = np.linalg.lstsq(root[:, None] * np.array(rows), root * misses)[0]
        x, y, radius = x + step[0], y + step[1], radius + step[2]
        if np.abs(step).max() < 1e-3:
            break
    return x, y, radius


def around(middle, angle, length, towards=None):
    """Edges at angles and distances, their slopes to the middle or turned off by an angle."""
    out = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    turned = angle if towards is None else angle + towards
    return (middle + length[:, None] * out, -np.stack([np.cos(turned), np.sin(turned)], axis=-1))


@pytest.mark.parametrize("seed", range(12))
def test_a_fit_makes_the_steps_that_are_written_out(seed):
    """Some settle early, some are cut off after six rounds, some run out of edges."""
    rng = np.random.default_rng(seed)
    n = (6, 14, 60)[seed % 3]
    edges = around([30.0, 20.0], rng.uniform(0.0, 4.5, n), 9.0 + rng.exponential(1.5, n), rng.normal(0.0, 0.4, n))
    expected = by_rounds(edges, 30.7, 19.4, 9.5)
    assert _fitted(SEARCH, edges, 30.7, 19.4, 9.5) == pytest.approx(expected, abs=1e-7)


def test_edges_at_the_limits_of_a_fit():
    """Eight make a rim, seven none; on a limit they are out: of the rim, of the angle, of what is near at first."""
    angle = np.arange(8) * np.pi / 4
    start = (30.0, 20.0, 10.0)

    def moved(length, towards=None, angle=angle):
        edges = around([30.0, 20.0], angle, length, towards)
        return max(abs(a - b) for a, b in zip(_fitted(SEARCH, edges, *start), start, strict=True)) > 1e-6

    assert moved(np.full(8, 10.5)) and not moved(np.full(7, 10.5), angle=angle[:7])
    exact = np.full(8, 10.5)
    exact[0] = 12.5  # at angle 0, the rim's limit to the last digit
    assert not moved(exact) and moved(exact - 1e-9 * (np.arange(8) == 0))
    edges = around([30.0, 20.0], angle, np.full(8, 10.0) + 0.5 * (angle > 0))
    edges[1][0] = [-0.8, 0.6]
    assert _fitted(SEARCH, edges, *start) == start
    edges[1][0] = [-0.81, 0.586]
    assert _fitted(SEARCH, edges, *start) != start
    for last, moved_by in ((14.99, True), (15.0, False), (16.0, False)):  # they come near as the circle grows
        apart = [np.arange(n) * 2 * np.pi / n for n in (20, 200, 4 if last == 15.0 else 300)]
        length = np.concatenate([np.full(len(a), size) for a, size in zip(apart, (12.4, 14.0, last), strict=True)])
        edges = around([30.0, 20.0], np.concatenate(apart), length)
        if last == 15.0:
            edges[0][-4:] = [[45.0, 20.0], [15.0, 20.0], [30.0, 35.0], [30.0, 5.0]]  # to the last digit
        found = _fitted(SEARCH, edges, *start)
        fewer = _fitted(SEARCH, [part[:220] for part in edges], *start)
        assert found == pytest.approx(by_rounds(edges, *start), abs=1e-7)
        assert (abs(found[2] - fewer[2]) > 0.1) == moved_by and (moved_by or found == fewer)
    small = around([30.0, 20.0], np.linspace(0.0, 5.0, 9), np.full(9, 0.6))
    assert _fitted(SEARCH, small, 30.1, 20.0, 1.0) == pytest.approx(by_rounds(small, 30.1, 20.0, 1.0), abs=1e-7)


def test_what_is_at_four_fifths_of_a_radius_is_another_fruit():
    assert not _taken([(50.0, 40.0, 10.0)], 50.0, 48.0, 10.0)


def circles_of(monkeypatch, voted, fitted=None, filled=1.0, search=SEARCH):
    """Circles of a picture where the votes, and the fits to them, are these."""
    if fitted is not None:
        monkeypatch.setattr(vision, "_fitted", lambda search, edges, *circle: fitted[voted.index(circle)])
    monkeypatch.setattr(vision, "_voted", lambda *given: voted)
    monkeypatch.setattr(vision, "_filled", lambda *given: filled)
    return [tuple(circle) for circle in fruit_circles(search, PAIR.left)[0].tolist()]


def test_each_vote_is_looked_at_and_no_fruit_is_taken_twice(monkeypatch):
    voted = [(100.0, 90.0, 10.0), (102.0, 90.0, 10.0), (200.0, 90.0, 10.0), (300.0, 90.0, 10.0)]
    fitted = [(100.5, 90.0, 10.0), (99.0, 0.0, 9.0), (105.0, 92.0, 10.0), (301.0, 89.0, 11.0)]
    assert circles_of(monkeypatch, voted, fitted) == [fitted[0], fitted[3]]


@pytest.mark.parametrize(("radius", "sound"), [(6.0, False), (6.01, True), (25.99, True), (26.0, False)])
def test_a_circle_is_a_step_smaller_or_larger_than_is_looked_for_at_most(monkeypatch, radius, sound):
    fitted = [(100.0, 90.0, radius)]
    assert circles_of(monkeypatch, [(100.0, 90.0, 10.0)], fitted) == (fitted if sound else [])


@pytest.mark.parametrize(("filled", "sound"), [(0.3, True), (0.299, False)])
def test_a_circle_is_fruit_from_a_share_of_fruit_colour(monkeypatch, filled, sound):
    voted = [(100.0, 90.0, 10.0)]
    assert circles_of(monkeypatch, voted, voted, filled) == (voted if sound else [])


def test_pictures_without_red_or_with_nothing_else_hold_no_circles():
    """Grey is not fruit, however green the rest is; one dark pixel in red is blurred away."""
    image = np.full((60, 80, 3), 100, dtype=np.uint8)
    image[:, :40] = [60, 160, 40]
    grey, mask = fruit_circles(SEARCH, image)
    assert len(grey) == 0 and not mask.any()
    image[:] = [200, 40, 40]
    image[30, 40] = [40, 40, 40]
    red, mask = fruit_circles(SEARCH, image)
    assert red.shape == (0, 3) and mask.all()


def test_detections_are_the_circles_that_match_well_enough(monkeypatch):
    least = CAMERA.least_correlation
    matches = [(60.0, least), (70.0, least - 1e-9), (80.0, 1.0), (50.0, 0.9)]
    centres = np.array([[100.0, 90.0], [150.0, 90.0], [300.0, 120.0], [310.5, 30.25]])
    found, mask = np.column_stack([centres, np.full(4, 10.0)]), np.zeros((2, 2), dtype=bool)
    monkeypatch.setattr(vision, "fruit_circles", lambda search, image: (found, mask))
    monkeypatch.setattr(vision, "_matched", lambda *given: matches[centres[:, 0].tolist().index(given[5][0])])
    places, agreement = locate_circles(CAMERA, SEARCH, PAIR.left, PAIR.right)
    expected = [[*centres[k], matches[k][0]] for k in (0, 2, 3)]
    np.testing.assert_array_equal(places, triangulate(CAMERA, expected))
    assert agreement.tolist() == [least, 1.0, 0.9]
    monkeypatch.setattr(vision, "fruit_circles", lambda search, image: (found[:0], mask))
    assert len(locate_circles(CAMERA, SEARCH, PAIR.left, PAIR.right)[0]) == 0


# Votes for circles and their matches in the right picture, written out edge by edge and pixel by pixel.
REACH = CAMERA.focal_length * CAMERA.baseline
MIDDLE, RADIUS = (60.3, 50.8), 14.0


def rim(share=1.0, radius=RADIUS, middle=MIDDLE):
    """Two edges to each pixel of a part of a circle's rim, with slopes towards its middle."""
    angle = np.linspace(0.0, 2.0 * np.pi * share, round(2 * 2 * np.pi * radius * share), endpoint=False)
    out = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    return (np.array(middle) + radius * out, -out)


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
