"""Edges, votes and fits of circles, each worked out once more edge by edge, and what becomes of a found circle."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, gaussian_filter1d

from pickenv.orchard import (
    fruit_circles,
    load_circle_search,
    load_look,
    load_stereo_camera,
    locate_circles,
    render_stereo,
    triangulate,
    vision,
)
from pickenv.orchard.vision import _Edges, _edges, _fitted, _taken, _voted, summit

CAMERA, SEARCH = load_stereo_camera("li2016"), load_circle_search("li2016")
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
    assert len(edges.places) == len(rim) > 100
    for place, slope, at in zip(edges.places, edges.slopes, rim, strict=True):
        expected = steepest(picture, SEARCH.blur, *at)
        np.testing.assert_allclose([place, slope], expected, atol=1e-9)


def test_where_the_colour_is_the_same_all_around_there_is_no_edge_but_a_faint_step_is_one():
    step = np.where(np.arange(60) < 30, 0.0, 2.0) * np.ones((20, 1))
    for begins, count in ((30, 40), (50, 0)):
        edges = _edges(SEARCH, step, np.broadcast_to(np.arange(60) >= begins, step.shape))
        assert len(edges.places) == count and np.isfinite(edges.places).all()


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
        for place, slope in zip(edges.places, edges.slopes, strict=True):
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
    edges = _Edges(np.repeat(middles, 12, axis=0) - lengths[:, None] * slopes, slopes)
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
        (p, s)
        for p, s in zip(edges.places, edges.slopes, strict=True)
        if math.hypot(*(p - [column, row])) < voted + 2 * 2.5
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
    return _Edges(middle + length[:, None] * out, -np.stack([np.cos(turned), np.sin(turned)], axis=-1))


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
    edges.slopes[0] = [-0.8, 0.6]
    assert _fitted(SEARCH, edges, *start) == start
    edges.slopes[0] = [-0.81, 0.586]
    assert _fitted(SEARCH, edges, *start) != start
    for last, moved_by in ((14.99, True), (15.0, False), (16.0, False)):  # they come near as the circle grows
        apart = [np.arange(n) * 2 * np.pi / n for n in (20, 200, 4 if last == 15.0 else 300)]
        length = np.concatenate([np.full(len(a), size) for a, size in zip(apart, (12.4, 14.0, last), strict=True)])
        edges = around([30.0, 20.0], np.concatenate(apart), length)
        if last == 15.0:
            edges.places[-4:] = [[45.0, 20.0], [15.0, 20.0], [30.0, 35.0], [30.0, 5.0]]  # to the last digit
        found = _fitted(SEARCH, edges, *start)
        fewer = _fitted(SEARCH, _Edges(edges.places[:220], edges.slopes[:220]), *start)
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
    found = fruit_circles(search, PAIR.left)
    return [(*centre, radius) for centre, radius in zip(found.centres.tolist(), found.radii.tolist(), strict=True)]


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
    grey = fruit_circles(SEARCH, image)
    assert len(grey.radii) == 0 and not grey.mask.any()
    image[:] = [200, 40, 40]
    image[30, 40] = [40, 40, 40]
    red = fruit_circles(SEARCH, image)
    assert red.centres.shape == (0, 2) and red.radii.shape == (0,) and red.mask.all()


def test_detections_are_the_circles_that_match_well_enough(monkeypatch):
    least = CAMERA.least_correlation
    matches = [(60.0, least), (70.0, least - 1e-9), (80.0, 1.0), (50.0, 0.9)]
    centres = np.array([[100.0, 90.0], [150.0, 90.0], [300.0, 120.0], [310.5, 30.25]])
    found = vision.Circles(centres, np.full(4, 10.0), np.zeros((2, 2), dtype=bool))
    monkeypatch.setattr(vision, "fruit_circles", lambda search, image: found)
    monkeypatch.setattr(vision, "_matched", lambda *given: matches[centres[:, 0].tolist().index(given[5][0])])
    seen = locate_circles(CAMERA, SEARCH, PAIR.left, PAIR.right)
    expected = [[*centres[k], matches[k][0]] for k in (0, 2, 3)]
    np.testing.assert_array_equal(seen.positions, triangulate(CAMERA, expected))
    assert seen.confidence.tolist() == [least, 1.0, 0.9] and seen.fruit.tolist() == [-1, -1, -1]
    monkeypatch.setattr(
        vision, "fruit_circles", lambda search, image: replace(found, centres=centres[:0], radii=np.zeros(0))
    )
    assert len(locate_circles(CAMERA, SEARCH, PAIR.left, PAIR.right)) == 0
