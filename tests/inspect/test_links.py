from __future__ import annotations

import numpy as np
import pytest

from pickenv.arm import forward, load_arm, load_plant, nominal_points, shipped_arms, shipped_plants, true_points
from pickenv.inspect.runs.run_folder import capsules


@pytest.mark.parametrize("name", shipped_plants())
def test_the_true_arm_is_drawn_from_its_base_to_where_its_tool_stood(name: str) -> None:
    plant = load_plant(name)
    q = np.random.default_rng(1).uniform(plant.geometry.lower, plant.geometry.upper, size=(50, plant.geometry.joints))
    tool = plant.tool_pose(q).position
    points = true_points(plant.geometry, q, tool)
    np.testing.assert_allclose(points[:, -1], tool, atol=1e-12)
    np.testing.assert_allclose(points[:, 0], np.broadcast_to(plant.geometry.base.position, (50, 3)), atol=1e-12)
    moved = np.linalg.norm(points - nominal_points(plant.geometry, q), axis=-1)
    assert np.all(np.diff(moved, axis=-1) >= -1e-12)


@pytest.mark.parametrize("name", shipped_arms())
def test_any_arm_is_drawn_from_its_base_to_its_tool(name: str) -> None:
    geometry = load_arm(name).nominal
    q = np.random.default_rng(2).uniform(geometry.lower, geometry.upper, size=(4, 5, geometry.joints))
    points = nominal_points(geometry, q)
    assert points.shape == (4, 5, 2 * geometry.joints + 2, 3)
    np.testing.assert_allclose(points[..., 0, :], np.broadcast_to(geometry.base.position, (4, 5, 3)), atol=1e-15)
    np.testing.assert_allclose(points[..., -1, :], forward(geometry, q).position, atol=1e-12)


def test_capsules_lie_along_the_links_in_every_direction() -> None:
    ends = np.array([[0, 0, 2], [0, 0, -2], [1, 0, 0], [0, -3, 0], [1, 2, 3], [0, 0, 0]], dtype=float)
    points = np.stack([np.zeros_like(ends), ends], axis=1)
    start, length, quaternion = capsules(points, [0])
    x, y, z, w = quaternion[:, 0].T
    direction = np.stack([2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y)], axis=-1)
    np.testing.assert_allclose(np.linalg.norm(quaternion, axis=-1), 1.0)
    np.testing.assert_allclose(start[:, 0] + length * direction, ends, atol=1e-12)
