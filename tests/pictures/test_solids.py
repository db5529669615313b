"""Rods, balls and meshes are what their numbers say: right size, closed, facing outwards; eyes see what they shall."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

from pickenv.pictures.solids import ball_triangles, chequered, mesh_triangles, rod_triangles, turned
from pickenv.pictures.stage import Balls, Eye, Mesh, Rods, fitted_eye, rgba


def volume(corners, triangles):
    a, b, c = (corners[triangles[:, k]] for k in range(3))
    return np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6


def edges_shared(triangles):
    edges = [tuple(sorted((t[i], t[(i + 1) % 3]))) for t in triangles.tolist() for i in range(3)]
    return set(Counter(edges).values())


@pytest.mark.parametrize("seed", range(5))
def test_a_rod_is_as_thick_as_it_says_all_along_and_closed(seed):
    rng = np.random.default_rng(seed)
    start, end, radius = rng.normal(size=3), rng.normal(size=3), rng.uniform(0.01, 0.3)
    rods = Rods(start[None], end[None], np.array([radius]), rgba((1, 2, 3), 1))
    found = rod_triangles(rods)
    along = end - start
    share = np.clip((found.corners - start) @ along / (along @ along), 0.0, 1.0)
    away = found.corners - (start + share[:, None] * along)
    np.testing.assert_allclose(np.linalg.norm(away, axis=1), radius, rtol=1e-9)
    np.testing.assert_allclose(found.normals, away / radius, atol=1e-9)
    assert edges_shared(found.triangles) == {2}
    whole = np.pi * radius**2 * np.linalg.norm(along) + 4 / 3 * np.pi * radius**3
    assert 0.9 * whole < volume(found.corners - start, found.triangles) < whole


def test_a_rod_without_length_is_a_ball():
    place, radius, colour = np.array([[1.0, 2.0, 3.0]]), np.array([0.2]), rgba((9, 9, 9), 1)
    rod, ball = rod_triangles(Rods(place, place, radius, colour)), ball_triangles(Balls(place, radius, colour))
    for made in (rod, ball):
        np.testing.assert_allclose(made.corners, place + 0.2 * made.normals, atol=1e-12)
        np.testing.assert_allclose(np.linalg.norm(made.normals, axis=1), 1.0)


def test_several_rods_keep_their_own_corners_and_colours():
    start = np.array([[0.0, 0.0, 0.0], [5.0, 0.0, 0.0]])
    colour = np.array([[1, 2, 3, 255], [4, 5, 6, 100]], dtype=np.uint8)
    found = rod_triangles(Rods(start, start + np.array([0.0, 0.0, 1.0]), np.array([0.1, 0.2]), colour))
    for triangle in found.triangles:
        assert np.ptp(found.corners[triangle, 0]) < 1.0
        assert (found.colour[triangle] == colour[int(found.corners[triangle[0], 0] > 2.0)]).all()


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
