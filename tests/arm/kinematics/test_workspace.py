"""The largest cube in the workspace, and the test poses of ISO 9283 in it."""

from dataclasses import replace

import numpy as np
import pytest

from pickenv.arm import Cube, Geometry, Pose, farthest, forward, inverse, largest_cube, load_arm, shipped_arms
from pickenv.base import InputError


def gantry(*travel):
    """Three slides along x, y and z: the workspace is a box."""
    quarter = np.pi / 2
    still = Pose(np.zeros(3), np.eye(3))
    zero = np.zeros(3)
    return Geometry(
        ("X", "Y", "Z"),
        (True, True, True),
        alpha=np.array([0.0, quarter, quarter]),
        a=zero,
        theta=np.array([0.0, quarter, 0.0]),
        d=zero,
        beta=zero,
        lower=zero,
        upper=np.array(travel),
        base=still,
        tool=still,
    )


def test_in_a_box_the_cube_is_as_large_as_the_shortest_side():
    cube = largest_cube(gantry(0.5, 1.0, 0.8))
    assert 0.5 - 2 * 1.0 / 20 <= cube.edge <= 0.5 + 1e-9


@pytest.mark.parametrize("name", ["qiao2026", "ur5"])
def test_the_whole_cube_is_within_reach(name):
    geometry = load_arm(name).nominal
    cube = largest_cube(geometry, steps=12)
    side = np.linspace(-0.5, 0.5, 4) * cube.edge
    inside = cube.centre + np.stack(np.meshgrid(side, side, side), axis=-1).reshape(-1, 3)
    targets = Pose(inside, np.broadcast_to(cube.rotation, (len(inside), 3, 3)))
    assert inverse(geometry, targets).reached.mean() > 0.98  # reached on its grid; between the points by continuity


def test_the_poses_lie_on_the_diagonals_of_an_inclined_plane():
    cube = Cube(np.array([1.0, 2.0, 3.0]), 0.5, np.eye(3))
    poses = cube.inclined_plane()
    offset = poses.position - cube.centre
    assert not offset[0].any()
    np.testing.assert_allclose(offset.sum(axis=0), 0, atol=1e-15)
    np.testing.assert_allclose(np.linalg.norm(offset[1:], axis=-1), 0.4 * np.sqrt(3) * 0.5)
    np.testing.assert_allclose(offset @ [1, 0, 1], 0, atol=1e-15)
    assert poses.rotation.shape == (5, 3, 3)


def test_an_arm_that_reaches_no_cube_is_refused():
    flat = gantry(0.5, 1.0, 0.8)
    with pytest.raises(InputError, match="reaches no cube"):
        largest_cube(replace(flat, upper=np.array([1e-6, 1.0, 0.8])))


def test_a_gantry_gets_as_far_as_the_corner_of_its_box():
    assert farthest(gantry(0.5, 1.0, 0.8)) == pytest.approx(np.sqrt(0.5**2 + 1.0**2 + 0.8**2), abs=1e-9)


@pytest.mark.parametrize("name", shipped_arms())
def test_no_pose_is_farther_than_the_farthest(name):
    geometry = load_arm(name).nominal
    q = np.random.default_rng(3).uniform(geometry.lower, geometry.upper, (20_000, geometry.joints))
    away = np.linalg.norm(forward(geometry, q).position - geometry.base.position, axis=-1)
    assert 0.9 * farthest(geometry) < away.max() <= farthest(geometry) + 1e-9
