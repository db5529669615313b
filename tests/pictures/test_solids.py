"""Meshes are what their numbers say: right size, closed, facing outwards; eyes see what they shall."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

from pickenv.pictures.shapes import (
    all_triangles,
    chequered,
    leaf_mesh,
    mesh_triangles,
    row_of_trees,
    turned,
)
from pickenv.pictures.stage import Eye, Mesh, fitted_eye, rgba


def volume(corners, triangles):
    a, b, c = (corners[triangles[:, k]] for k in range(3))
    return np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6


def edges_shared(triangles):
    edges = [tuple(sorted((t[i], t[(i + 1) % 3]))) for t in triangles.tolist() for i in range(3)]
    return set(Counter(edges).values())


@pytest.mark.parametrize("axis", [[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.6, 0.0, -0.8]])
def test_a_turned_cylinder_has_its_volume_and_faces_outwards(axis):
    axis = np.array(axis)
    outline = [[0.0, 0.0], [2.0, 0.0], [2.0, 0.0], [2.0, 3.0], [2.0, 3.0], [0.0, 3.0]]
    made = turned(outline, np.array([1.0, 1.0, 1.0]), axis, (0, 0, 0), around=96)
    assert volume(made.corners - [1.0, 1.0, 1.0], made.triangles) == pytest.approx(np.pi * 4 * 3, rel=2e-3)
    side = np.linalg.norm(made.corners - 1.0 - ((made.corners - 1.0) @ axis)[:, None] * axis, axis=1)
    assert set(np.round(side, 9)) == {0.0, 2.0}


def test_the_ground_covers_what_was_asked_for_in_two_colours():
    made = chequered((-1.2, 0.3), (1.0, 2.0), 0.7, 0.5, ((10, 10, 10), (20, 20, 20)))
    assert (made.corners[:, 2] == 0.7).all()
    assert made.corners[:, :2].min(axis=0).tolist() <= [-1.2, 0.3]
    assert (made.corners[:, :2].max(axis=0) >= [1.0, 2.0]).all()
    a, b, c = (made.corners[made.triangles[:, k]] for k in range(3))
    assert np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2 == pytest.approx(np.prod([2.5, 2.0]))
    assert set(made.colour[:, 0].tolist()) == {10, 20}
    assert (mesh_triangles(made).normals == [0.0, 0.0, 1.0]).all()


def test_shared_corners_are_smooth_and_others_are_not():
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    triangles = np.array([[0, 1, 2], [0, 3, 1]])
    shared = mesh_triangles(Mesh(corners, triangles, rgba((0, 0, 0), 4)))
    np.testing.assert_allclose(shared.normals[0], np.array([0.0, 1.0, 1.0]) / np.sqrt(2))
    apart = mesh_triangles(Mesh(corners[triangles].reshape(-1, 3), np.arange(6).reshape(2, 3), rgba((0, 0, 0), 6)))
    np.testing.assert_allclose(apart.normals, np.repeat([[0.0, 0, 1], [0, 1, 0]], 3, axis=0))


@pytest.mark.parametrize("seed", range(5))
def test_an_eye_sees_its_target_in_the_middle_and_gives_points_back(seed):
    rng = np.random.default_rng(seed)
    eye, size = Eye(rng.normal(size=3), rng.normal(size=3), rng.uniform(10, 80)), (640, 400)
    np.testing.assert_allclose(eye.axes() @ eye.axes().T, np.eye(3), atol=1e-12)
    column, row, depth = eye.project(eye.target, size)
    assert (column, row) == pytest.approx((320, 200)) and depth == pytest.approx(
        np.linalg.norm(eye.target - eye.position)
    )
    assert eye.project(eye.target + np.array([0.0, 0.0, 0.1]), size)[1] < 200  # up is up
    point = eye.point_at((100.0, 300.0), 2.0, size)
    np.testing.assert_allclose(eye.project(point, size), [100.0, 300.0, 2.0], atol=1e-9)


@pytest.mark.parametrize("seed", range(5))
def test_a_fitted_eye_sees_all_points_and_stands_no_farther_than_needed(seed):
    rng = np.random.default_rng(seed)
    points, size = rng.normal(size=(40, 3)) * rng.uniform(0.2, 3.0, 3), (480, 360)
    eye = fitted_eye(points, np.array([0.7, -0.9, 0.4]), size)
    columns, rows, depth = eye.project(points, size).T
    share = np.maximum(np.abs(columns / 240 - 1), np.abs(rows / 180 - 1)).max()
    assert depth.min() > 0
    assert 0.8 < share < 1.0


def test_a_point_is_seen_at_focal_length_over_depth():
    """From 2 m before the origin with 90 degrees of view: half the height is one metre there."""
    eye = Eye(np.array([0.0, -2.0, 0.0]), np.zeros(3), 90.0)
    np.testing.assert_allclose(eye.axes(), [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]])
    np.testing.assert_allclose(eye.project([0.5, 0.0, 0.25], (640, 400)), [320 + 50, 200 - 25, 2.0])
    np.testing.assert_allclose(eye.project([[0.5, 2.0, -0.25]], (640, 400)), [[320 + 25, 200 + 12.5, 4.0]])
    np.testing.assert_allclose(eye.point_at((370.0, 175.0), 2.0, (640, 400)), [0.5, 0.0, 0.25], atol=1e-12)
    np.testing.assert_allclose(eye.pixels_per_metre([1.0, 4.0, 0.0], (640, 400)), [200.0, 50.0, 2e5])
    assert Eye(np.zeros(3), np.ones(3)).angle_deg == 30.0


@pytest.mark.parametrize("angle", [30.0, 60.0])
def test_a_fitted_eye_stands_six_percent_farther_away_than_it_must(angle):
    points, size = np.random.default_rng(2).normal(size=(60, 3)) * [1.0, 0.4, 0.7], (500, 300)
    eye = fitted_eye(points, np.array([1.0, -2.0, 0.5]), size, angle)
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    np.testing.assert_allclose(eye.target, middle)
    way = (eye.position - middle) / np.linalg.norm(eye.position - middle)
    np.testing.assert_allclose(way, np.array([1.0, -2.0, 0.5]) / np.sqrt(5.25))
    near, far = 2.0, 40.0
    for _ in range(60):
        half = (near + far) / 2
        columns, rows, depth = Eye(middle + half * way, middle, angle).project(points, size).T
        inside = depth.min() > 0 and (np.abs(columns / 250 - 1) <= 1).all() and (np.abs(rows / 150 - 1) <= 1).all()
        near, far = (near, half) if inside else (half, far)
    assert np.linalg.norm(eye.position - middle) == pytest.approx(1.06 * far, rel=1e-9)


def test_a_branch_is_closed_and_parts_are_put_together_in_order():
    leaves, branch = row_of_trees((0.0, 1.0, 0.5), (0.2, 1.1, 0.7), 90.0, 0.0)[::-1][:2]
    assert edges_shared(np.unique(branch.corners.round(9), axis=0, return_inverse=True)[1][branch.triangles]) >= {2}
    assert volume(branch.corners, branch.triangles) == pytest.approx(np.pi * 0.011**2 * np.hypot(0.4, 0.02), rel=0.02)
    parts = [mesh_triangles(part) for part in (branch, leaves, branch)]
    made, first = all_triangles(parts), 0
    for part in parts:
        last = first + len(part.corners)
        rows = made.triangles[(made.triangles >= first).all(axis=1) & (made.triangles < last).all(axis=1)]
        np.testing.assert_array_equal(rows - first, part.triangles)
        for whole, own in ((made.corners, part.corners), (made.normals, part.normals), (made.colour, part.colour)):
            np.testing.assert_array_equal(whole[first:last], own)
        first = last
    assert len(made.corners) == first and len(made.triangles) == sum(len(part.triangles) for part in parts)
    nothing = all_triangles([])
    parts = (nothing.corners, nothing.normals, nothing.colour, nothing.triangles)
    assert [part.shape for part in parts] == [(0, 3), (0, 3), (0, 4), (0, 3)]


def test_squares_of_the_ground_lie_on_round_places_and_change_colour_like_a_chessboard():
    made = chequered((-0.6, 0.2), (0.4, 0.9), 0.0, 0.5, ((10, 0, 0), (20, 0, 0)))
    squares = made.corners.reshape(-1, 4, 3)
    np.testing.assert_allclose(squares[:, 2] - squares[:, 0], [[0.5, 0.5, 0.0]] * len(squares))
    number = np.round(squares[:, 0, :2] / 0.5).astype(int)
    assert sorted(map(tuple, number.tolist())) == [(x, y) for x in (-2, -1, 0) for y in (0, 1)]
    np.testing.assert_array_equal(made.colour[::4, 0], np.where((number - number[0]).sum(axis=1) % 2, 20, 10))
    exact = chequered((0.0, 0.0), (1.0, 0.5), 0.0, 0.5, ((1, 1, 1), (2, 2, 2)))
    assert len(exact.triangles) == 4 and len(chequered((0, 0), (0, 0), 0.0, 1.0, ((1, 1, 1), (2, 2, 2))).triangles) == 2


def test_a_leaf_is_as_long_and_wide_as_it_says_bent_and_of_some_shade():
    places = np.random.default_rng(0).normal(size=(300, 3))
    made = leaf_mesh(places, 0.08, 0.04, (100, 180, 60), np.random.default_rng(1))
    foot, left, tip, right = np.moveaxis(made.corners.reshape(-1, 4, 3), 1, 0)
    np.testing.assert_allclose((foot + tip) / 2, places, atol=1e-12)
    along, across, bent = tip - foot, right - left, (left + right) / 2 - places
    for part, size in ((along, 0.08), (across, 0.04), (bent, 0.04 / 5)):
        np.testing.assert_allclose(np.linalg.norm(part, axis=1), size)
    for one, other in ((along, across), (along, bent), (across, bent)):
        np.testing.assert_allclose(np.sum(one * other, axis=1), 0.0, atol=1e-12)
    assert made.triangles[:4].tolist() == [[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]]
    shade = made.colour[::4, :3] / np.array([100, 180, 60])
    assert (made.colour[:, 3] == 255).all() and 0.73 < shade.min() < 0.8 and 1.2 < shade.max() <= 1.25
    assert shade[:, 1].mean() == pytest.approx(1.0, abs=0.03)


def test_a_mesh_without_area_has_no_normals_and_one_of_two_sizes_leans_to_the_larger():
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 3, 0], [0, 0, 1], [5, 5, 5]])
    found = mesh_triangles(Mesh(corners, np.array([[0, 1, 2], [0, 3, 1]]), rgba((0, 0, 0), 5)))
    np.testing.assert_allclose(found.normals[0], np.array([0.0, 1.0, 3.0]) / np.sqrt(10))
    assert found.normals[4].tolist() == [0.0, 0.0, 0.0]
