"""How long the kinematics take; run with --benchmark-enable. Nothing is asserted about time."""

import math

import pytest

from pickenv.arm import chain_of, forward, inverse, joint_jacobian, load_plant, tool_frame


def test_forward_of_one_pose_on_floats(benchmark, qiao, draw):
    chain, q = chain_of(qiao.nominal), draw(qiao.nominal).tolist()
    frame = benchmark(tool_frame, math, chain, q)
    assert frame[9:] == pytest.approx(forward(qiao.nominal, q).position)


def test_plant_with_all_effects_for_one_pose_on_floats(benchmark, draw):
    plant = load_plant("qiao2026")
    q = draw(plant.geometry).tolist()
    frame = benchmark(plant.tool_frame, math, q)
    assert frame[9:] == pytest.approx(plant.tool_pose(q).position)


def test_forward_of_10_000_poses_on_arrays(benchmark, qiao, draw):
    pose = benchmark(forward, qiao.nominal, draw(qiao.nominal, 10_000))
    assert pose.position.shape == (10_000, 3)


def test_joint_jacobian_of_10_000_poses(benchmark, qiao, draw):
    jacobian = benchmark(joint_jacobian, qiao.nominal, draw(qiao.nominal, 10_000))
    assert jacobian.shape == (10_000, 6, 6)


def test_inverse_of_1_000_targets(benchmark, qiao, draw):
    solution = benchmark(inverse, qiao.nominal, forward(qiao.nominal, draw(qiao.nominal, 1_000)))
    assert solution.reached.all()
