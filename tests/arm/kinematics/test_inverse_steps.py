"""Each step of the inverse kinematics against its formula, its restarts, and the search for the largest cube."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from scipy.stats import qmc

from pickenv.arm import (
    forward,
    inverse,
    joint_jacobian,
    load_arm,
    noncompensable_error,
    pose_error,
    task_directions,
    truncated_inverse,
)
from pickenv.arm.kinematics import inverse as inverse_module

ALWAYS = {"position_tolerance": np.inf, "attitude_tolerance": np.inf}


def middle_and_half(geometry):
    return (geometry.lower + geometry.upper) / 2, (geometry.upper - geometry.lower) / 2


def expected_step(geometry, q, target):
    """Gauss-Newton, then the pull to mid-range along the null space as far as it still helps, then the limit."""
    middle, half = middle_and_half(geometry)
    jacobian = joint_jacobian(geometry, q)
    u, s, vt = np.linalg.svd(jacobian, full_matrices=False)
    kept = s > 5e-3 * s[0]
    back = vt.T[:, kept] / s[kept] @ u.T[kept]
    step = back @ pose_error(forward(geometry, q), target)
    gradient = (middle - q) / half**2
    along = gradient - back @ (jacobian @ gradient)
    if np.abs(along).max() > 1e-9:
        # least of sum(((q + t along - middle) / half)^2) over t
        step = step + along * ((along @ gradient) / np.sum((along / half) ** 2))
    return step * min(1.0, 0.4 / np.max(np.abs(step) / np.minimum(half, 1.0)))


@pytest.mark.parametrize("name", ["qiao2026", "ur5", "wam"])
@pytest.mark.parametrize("way", [0.01, 1.0], ids=["near", "far"])
def test_one_step_is_gauss_newton_with_a_pull_to_mid_range_and_a_limit(name, way):
    geometry = load_arm(name).nominal
    middle, half = middle_and_half(geometry)
    rng = np.random.default_rng(5)
    q = middle + 0.4 * half * rng.uniform(-1, 1, geometry.joints)
    target = forward(geometry, q + 0.4 * way * half * rng.uniform(-1, 1, geometry.joints))
    found = inverse(geometry, target, q, restarts=0, max_iterations=1, **ALWAYS)
    expected = expected_step(geometry, q, target)
    np.testing.assert_allclose(found.joints, q + expected, atol=1e-9)
    if name == "ur5":  # the others' pull to mid-range reaches the limit from anywhere
        assert (np.max(np.abs(expected) / np.minimum(half, 1.0)) == pytest.approx(0.4)) == (way == 1.0)


@pytest.mark.parametrize("side", ["lower", "upper"])
def test_a_joint_at_its_limit_is_held_and_the_pull_lets_it_be(side):
    """Seven joints for six directions; the fourth stands at its limit and would go further out."""
    wam = load_arm("wam").nominal
    middle, half = middle_and_half(wam)
    rng = np.random.default_rng(2)
    q = middle + 0.3 * half * rng.uniform(-1, 1, 7)
    outward = 0.01 if side == "upper" else -0.01
    edge = {side: np.where(np.arange(7) == 3, q, getattr(wam, side))}
    held = replace(wam, **edge)
    target = forward(wam, q + outward * np.array([1, -1, 1, 30, 1, -1, 1]))
    found = inverse(held, target, q, restarts=0, max_iterations=1, **ALWAYS)
    others = np.delete(np.arange(7), 3)
    middle, half = middle_and_half(held)
    jacobian = joint_jacobian(held, q)[:, others]
    back = np.linalg.pinv(jacobian, rcond=5e-3)
    step = back @ pose_error(forward(held, q), target)
    gradient = ((middle - q) / half**2)[others]
    along = gradient - back @ (jacobian @ gradient)
    if np.abs(along).max() > 1e-9:
        step = step + along * ((along @ gradient) / np.sum((along / half[others]) ** 2))
    step = step * min(1.0, 0.4 / np.max(np.abs(step) / np.minimum(half[others], 1.0)))
    np.testing.assert_allclose(found.joints[others], q[others] + step, atol=1e-8)
    assert found.joints[3] == q[3]


def starts_of(monkeypatch, geometry, target, start, **more):
    """Where each descent begins, and with which rank tolerance, for one target that is never reached."""
    seen = []

    def standing(geometry, goals, q, rank_tolerance, max_iterations, parts):
        seen.append((q.copy(), rank_tolerance, max_iterations))
        return q

    monkeypatch.setattr(inverse_module, "_descend", standing)
    inverse(geometry, target, start, **more)
    return seen


@pytest.mark.parametrize(("options", "restarts"), [({}, 4), ({"restarts": 2}, 2), ({"restarts": 0}, 0)])
def test_restarts_are_spread_evenly_over_nine_tenths_of_the_ranges(monkeypatch, options, restarts):
    geometry = load_arm("ur5").nominal
    middle, half = middle_and_half(geometry)
    far = forward(geometry, middle)
    far = replace_position(far, far.position + 50.0)
    seen = starts_of(monkeypatch, geometry, far, None, **options)
    spread = qmc.Halton(6, scramble=False).random(9)[1:] * 2 - 1
    assert len(seen) == restarts + 3
    np.testing.assert_allclose(seen[0][0], middle[None])
    for (begin, tolerance, _), offset in zip(seen[2 : 2 + restarts], spread, strict=False):
        np.testing.assert_allclose(begin, (middle + 0.9 * half * offset)[None])
        assert tolerance == 5e-3
    assert [seen[i][1] for i in (0, 1, -1)] == [5e-3, 1e-6, 1e-6]
    assert {count for _, _, count in seen} == {100}
    assert {t for _, t, _ in starts_of(monkeypatch, geometry, far, None, rank_tolerance=1e-9)} == {1e-9}


def replace_position(pose, position):
    return type(pose)(position, pose.rotation)


def test_a_start_beyond_the_limits_is_brought_to_them(monkeypatch):
    geometry = load_arm("qiao2026").nominal
    seen = starts_of(monkeypatch, geometry, forward(geometry, np.zeros((3, 6))), np.full(6, 9.0))
    np.testing.assert_array_equal(seen[0][0], np.broadcast_to(geometry.upper, (3, 6)))


@pytest.mark.parametrize("part", ["position", "attitude"])
def test_a_target_counts_as_reached_up_to_the_tolerance_itself(part):
    geometry = load_arm("ur5").nominal
    q = np.array([0.3, -1.2, 1.5, -0.4, 0.7, 0.2])
    target = forward(geometry, q + 0.01)
    stand = {"restarts": 0, "max_iterations": 1}
    left = inverse(geometry, target, q, **stand, **ALWAYS)
    size = left.position_error if part == "position" else left.attitude_error - 0.0
    for tolerance, reached in ((size * (1 + 1e-9), True), (size * (1 - 1e-9), False)):
        tolerances = ALWAYS | {f"{part}_tolerance": tolerance}
        found = inverse(geometry, target, left.joints, restarts=0, max_iterations=0, **tolerances)
        assert bool(found.reached) == reached
    error = pose_error(forward(geometry, left.joints), target)
    assert left.position_error == pytest.approx(np.linalg.norm(error[:3]))
    assert left.attitude_error == pytest.approx(np.linalg.norm(error[3:]))


@pytest.mark.parametrize("name", ["qiao2026", "ur5", "wam"])
def test_what_no_joint_removes_is_what_stands_across_the_jacobians_columns(name):
    geometry = load_arm(name).nominal
    middle, half = middle_and_half(geometry)
    rng = np.random.default_rng(0)
    q = middle + 0.5 * half * rng.uniform(-1, 1, (8, geometry.joints))
    error = rng.normal(size=(8, 6))
    found = noncompensable_error(geometry, q, error)
    ranks = [np.linalg.matrix_rank(j, rtol=5e-3) for j in joint_jacobian(geometry, q)]
    assert task_directions(geometry, q)[1].tolist() == ranks and 5 in ranks and (name == "qiao2026") == (6 not in ranks)
    for jacobian, e, left in zip(joint_jacobian(geometry, q), error, found, strict=True):
        back = np.linalg.pinv(jacobian, rcond=5e-3)
        np.testing.assert_allclose(left, e - jacobian @ (back @ e), atol=1e-12)
        np.testing.assert_allclose(truncated_inverse(jacobian), back, atol=1e-10)
    np.testing.assert_allclose(
        truncated_inverse(joint_jacobian(geometry, q)), np.linalg.pinv(joint_jacobian(geometry, q), rcond=5e-3)
    )
    loose = task_directions(geometry, q, 0.999)[1]
    assert (loose <= 2).all()


@pytest.mark.parametrize("columns", [3, 6, 8])
def test_singular_values_are_cut_off_below_the_tolerance(columns):
    """From both sides, for one matrix and for several."""
    rng = np.random.default_rng(1)
    u, _ = np.linalg.qr(rng.normal(size=(6, 6)))
    v, _ = np.linalg.qr(rng.normal(size=(columns, columns)))
    least = min(6, columns)
    for share, kept in ((4.9e-3, False), (5.1e-3, True)):
        values = np.linspace(2.0, 1.0, least)
        values[-1] = 2.0 * share
        matrix = u[:, :least] * values @ v[:, :least].T
        inverted = np.where(np.arange(least) < least - (not kept), 1 / values, 0.0)
        expected = v[:, :least] * inverted @ u[:, :least].T
        np.testing.assert_allclose(truncated_inverse(matrix), expected, atol=1e-9)
        np.testing.assert_allclose(
            truncated_inverse(np.stack([matrix, 3 * matrix])), [expected, expected / 3], atol=1e-9
        )


def largest_by_search(filled):
    """Edge, in steps, of the largest cube of grid points that are all filled, tried one by one; None without any."""
    best = None
    for corner in np.argwhere(filled):
        for size in range(min(filled.shape - corner)):
            cut = tuple(slice(c, c + size + 1) for c in corner)
            if filled[cut].all() and (best is None or size > best):
                best = size
    return best


@pytest.mark.parametrize("seed", range(8))
def test_the_largest_filled_cube_is_found(seed):
    rng = np.random.default_rng(seed)
    filled = rng.random((5, 6, 7)) < 0.3
    corner = rng.integers(0, 3, 3)
    filled[tuple(slice(c, c + 1 + seed % 4) for c in corner)] = True
    found, size = inverse_module._largest_filled(filled)
    assert size == largest_by_search(filled)
    assert filled[tuple(slice(c, c + size + 1) for c in found)].all()


def test_a_full_and_an_empty_grid_are_told_apart():
    assert inverse_module._largest_filled(np.ones((3, 4, 5), dtype=bool))[1] == 2
    assert inverse_module._largest_filled(np.zeros((3, 4, 5), dtype=bool)) == ((0, 0, 0), 0)
    assert inverse_module._largest_filled(np.ones((1, 4, 5), dtype=bool))[1] == 0


def test_of_several_cubes_the_middle_one_is_taken():
    filled = np.zeros((2, 2, 8), dtype=bool)
    filled[:] = True
    assert inverse_module._largest_filled(filled) == ((0, 0, 3), 1)


def test_the_cube_stands_on_the_grid_of_the_samples(qiao):
    """Step, grid and edge recomputed from the same evenly spread joints."""
    geometry = qiao.nominal
    steps = 8
    cube = inverse_module.largest_cube(geometry, steps=steps)
    spread = qmc.Halton(6, scramble=False).random(2**14)
    points = forward(geometry, geometry.lower + (geometry.upper - geometry.lower) * spread).position
    step = np.ptp(points, axis=0).max() / steps
    size = cube.edge / step
    assert size == pytest.approx(round(size)) and size >= 1
    corner = (cube.centre - cube.edge / 2 - points.min(axis=0)) / step
    np.testing.assert_allclose(corner, np.round(corner), atol=1e-6)
    middle, _ = middle_and_half(geometry)
    np.testing.assert_allclose(cube.rotation, forward(geometry, middle).rotation)
    corners = cube.centre + cube.edge / 2 * np.array(list(product((-1, 1), repeat=3)))
    assert (corners >= points.min(axis=0) - 1e-9).all() and (corners <= points.max(axis=0) + step).all()
    turned = forward(geometry, middle + 0.2).rotation
    np.testing.assert_array_equal(inverse_module.largest_cube(geometry, turned, steps=steps).rotation, turned)


def test_the_five_poses_are_those_of_the_standard():
    """C1, C2, C7, C8 of ISO 9283's figure: the upper edge at -x, the lower one at +x; a tenth from the corners."""
    poses = inverse_module.Cube(np.array([1.0, 2.0, 3.0]), 0.5, np.eye(3)).inclined_plane()
    corners = 0.25 * np.array([[0, 0, 0], [-1, -1, 1], [-1, 1, 1], [1, 1, -1], [1, -1, -1]])
    np.testing.assert_allclose(poses.position, [1.0, 2.0, 3.0] + 0.8 * corners)
    np.testing.assert_array_equal(poses.rotation, np.broadcast_to(np.eye(3), (5, 3, 3)))


def test_each_grid_point_near_a_sample_is_sought_once_from_the_nearest_one(qiao, monkeypatch):
    """Ten steps, no restarts; points farther than a grid step from every sample are not asked about."""
    asked = []

    def listening(geometry, goals, start, **options):
        asked.append((goals, start, options))
        return inverse(geometry, goals, start, **options)

    monkeypatch.setattr(inverse_module, "inverse", listening)
    inverse_module.largest_cube(qiao.nominal, steps=6)
    ((goals, start, options),) = asked
    assert options == {"max_iterations": 10, "restarts": 0, "position_only": False}
    joints = qiao.nominal.lower + np.ptp([qiao.nominal.lower, qiao.nominal.upper], axis=0) * qmc.Halton(
        6, scramble=False
    ).random(2**14)
    points = forward(qiao.nominal, joints).position
    step = np.ptp(points, axis=0).max() / 6
    for goal, begin in zip(goals.position, start, strict=True):
        distance = np.linalg.norm(points - goal, axis=1)
        assert distance.min() < step
        np.testing.assert_allclose(begin, joints[np.argmin(distance)])
    assert 20 < len(start) < 7**3
