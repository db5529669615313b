"""Inverse kinematics of arms whose Jacobian has no inverse."""

from dataclasses import replace

import numpy as np
import pytest

from pickenv.arm import Pose, forward, inverse, joint_jacobian, load_arm, pose_error


def within_limits(geometry, q):
    return np.all((q >= geometry.lower) & (q <= geometry.upper))


def mid_range_cost(geometry, q):
    middle, half = (geometry.lower + geometry.upper) / 2, (geometry.upper - geometry.lower) / 2
    return np.sum(((q - middle) / half) ** 2, axis=-1)


@pytest.mark.parametrize("name", ["qiao2026", "ur5", "wam"])
def test_reached_targets_are_reproduced(name, draw):
    """Targets well inside the ranges; redundant (qiao2026, wam) and non-redundant (ur5) arms alike."""
    geometry = load_arm(name).nominal
    target = forward(geometry, 0.6 * draw(geometry, 100))
    solution = inverse(geometry, target)
    assert solution.reached.mean() > 0.97
    error = pose_error(forward(geometry, solution.joints), target)[solution.reached]
    assert np.abs(error).max() < 1e-5
    assert within_limits(geometry, solution.joints)


def test_every_target_of_the_picking_arm_is_reached_at_less_cost_than_the_joints_that_made_it(qiao, draw):
    q = draw(qiao.nominal, 200)
    solution = inverse(qiao.nominal, forward(qiao.nominal, q), q)
    assert solution.reached.all()
    cost = mid_range_cost(qiao.nominal, solution.joints)
    assert (cost <= mid_range_cost(qiao.nominal, q) + 1e-6).all()
    assert cost.mean() < 0.9 * mid_range_cost(qiao.nominal, q).mean()


def test_nominal_targets_are_reached_by_the_true_arm_up_to_its_attitude_floor(qiao, draw):
    """Position to a hundredth of a millimetre, attitude but for 0.05 degrees that no joint motion removes."""
    true = replace(qiao.true, lower=qiao.true.lower - 0.05, upper=qiao.true.upper + 0.05)
    q = draw(qiao.nominal, 300)
    solution = inverse(true, forward(qiao.nominal, q), q)
    assert solution.reached.all()
    assert solution.position_error.max() < 1e-5
    np.testing.assert_allclose(solution.attitude_error, solution.noncompensable_attitude, rtol=0, atol=1e-6)
    floor = np.degrees(solution.noncompensable_attitude)
    assert 0.03 < floor.mean() < 0.06
    assert 0.08 < floor.max() < 0.1


def test_targets_beside_a_singular_pose_are_reached():
    """Near the UR5's wrist singularity directions are weak, not lost."""
    ur5 = load_arm("ur5").nominal
    q = np.array([0.3, -1.2, 1.5, -0.4, 0.0, 0.2]) + np.linspace(-0.02, 0.02, 21)[:, None] * np.eye(6)[4]
    solution = inverse(ur5, forward(ur5, q), q + 0.03)
    assert solution.reached.all()


def test_what_cannot_be_reached_is_said_with_the_error_that_remains(qiao):
    home = forward(qiao.nominal, np.zeros(6))
    far = Pose(home.position + np.array([[5.0, 0, 0], [0, 5.0, 0], [0, 0, 0]]), home.rotation)
    solution = inverse(qiao.nominal, far)
    assert solution.reached.tolist() == [False, False, True]
    assert within_limits(qiao.nominal, solution.joints)
    error = pose_error(forward(qiao.nominal, solution.joints), far)
    np.testing.assert_allclose(solution.position_error, np.linalg.norm(error[:, :3], axis=-1), rtol=0, atol=1e-12)
    np.testing.assert_allclose(solution.attitude_error, np.linalg.norm(error[:, 3:], axis=-1), rtol=0, atol=1e-12)
    assert (solution.position_error[:2] > 3.0).all()


def test_restarts_bring_the_tool_closer_to_what_cannot_be_reached(draw):
    """Fully stretched is the best that any joints can do; a bad start folds the arm instead."""
    ur5 = load_arm("ur5").nominal
    home = forward(ur5, draw(ur5, 20))
    far = Pose(home.position + np.array([2.5, 0, 0]), home.rotation)
    start = draw(ur5, 20)
    alone, helped = (inverse(ur5, far, start, restarts=count, max_iterations=30) for count in (0, 6))
    cost = [s.position_error + s.attitude_error - s.noncompensable_attitude for s in (alone, helped)]
    assert not helped.reached.any()
    assert (cost[1] <= cost[0]).all()
    assert np.median(cost[1]) < 0.9 * np.median(cost[0])


def test_the_last_resort_near_singular_poses_counts_only_where_it_reaches(draw):
    """It turns joints far for little; with any error allowed, the plain descent is all there is."""
    ur5 = load_arm("ur5").nominal
    start = draw(ur5, 100)
    home = forward(ur5, start)
    away = Pose(home.position + np.array([0.3, 0, 0]), home.rotation)
    plain = inverse(ur5, away, start, restarts=0, position_tolerance=np.inf, attitude_tolerance=np.inf)
    found = inverse(ur5, away, start, restarts=0)
    assert 10 < (~found.reached).sum() < 90
    np.testing.assert_array_equal(found.joints[~found.reached], plain.joints[~found.reached])


@pytest.mark.parametrize("held", [0, 2, 4])
def test_a_joint_held_at_its_limit_leaves_the_whole_step_to_the_others(held):
    """One step of six joints with one of them stuck is the least-squares step of the five others."""
    ur5, q = load_arm("ur5").nominal, np.array([0.3, -1.2, 1.5, -0.4, 0.7, 0.2])
    ur5 = replace(ur5, upper=np.where(np.arange(6) == held, q, ur5.upper))
    target = forward(ur5, q + 0.02)
    found = inverse(ur5, target, q, restarts=0, max_iterations=1, position_tolerance=np.inf, attitude_tolerance=np.inf)
    others = [i for i in range(6) if i != held]
    expected = np.linalg.pinv(joint_jacobian(ur5, q)[:, others]) @ pose_error(forward(ur5, q), target)
    assert 0.005 < np.abs(expected).max() < 0.4
    np.testing.assert_allclose(found.joints[others], q[others] + expected, atol=1e-9)
    assert found.joints[held] == ur5.upper[held]


def test_an_attitude_outside_the_task_is_said_to_be_out_of_reach_of_the_joints(qiao):
    """The picking arm cannot roll its tool about the boom; position is met, the roll remains and is reported apart."""
    home = forward(qiao.nominal, np.full(6, 0.1))
    lean = np.array([[1, 0, 0], [0, np.cos(0.02), -np.sin(0.02)], [0, np.sin(0.02), np.cos(0.02)]])
    solution = inverse(qiao.nominal, Pose(home.position, lean @ home.rotation))
    assert solution.position_error < 1e-5
    assert 0.015 < solution.noncompensable_attitude <= 0.02 + 1e-9


def test_limits_hold_from_any_start(qiao, draw):
    target = forward(qiao.nominal, draw(qiao.nominal, 30))
    start = draw(qiao.nominal, 30) * 5 + 2
    assert within_limits(qiao.nominal, inverse(qiao.nominal, target, start, restarts=0, max_iterations=3).joints)


@pytest.mark.parametrize("name", ["qiao2026", "ur5e", "so101", "positioner"])
def test_a_few_targets_get_the_joints_that_they_get_among_many(name, draw):
    """Within 1e-12: the last bits of linear algebra may depend on how many matrices there are."""
    geometry = load_arm(name).nominal
    targets = forward(geometry, draw(geometry, 30))
    many = inverse(geometry, targets, restarts=0)
    for rows in (slice(0, 1), slice(1, 4), slice(4, 12), slice(12, 21)):
        few = inverse(geometry, Pose(targets.position[rows], targets.rotation[rows]), restarts=0)
        np.testing.assert_allclose(few.joints, many.joints[rows], rtol=0, atol=1e-12)


@pytest.mark.parametrize("shape", [(), (0,), (2, 3)])
def test_the_answer_has_the_shape_of_the_question(qiao, draw, shape):
    solution = inverse(qiao.nominal, forward(qiao.nominal, draw(qiao.nominal, *shape)))
    assert solution.joints.shape == (*shape, 6)
    assert solution.reached.shape == solution.position_error.shape == solution.noncompensable_attitude.shape == shape


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_target_or_start_that_is_not_finite_is_refused(qiao, bad):
    home = forward(qiao.nominal, np.zeros(6))
    with pytest.raises(ValueError, match="target pose is not finite"):
        inverse(qiao.nominal, Pose(np.array([0, bad, 0]), home.rotation))
    with pytest.raises(ValueError, match="target pose is not finite"):
        inverse(qiao.nominal, Pose(home.position, np.full((3, 3), bad)))
    with pytest.raises(ValueError, match="start is not finite"):
        inverse(qiao.nominal, home, np.full(6, bad))
