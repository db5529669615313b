"""Jacobians of the picking arm: finite differences, and Qiao 2026 eqs (7)-(8) as printed."""

import math

import numpy as np
import pytest

from pickenv.arm import (
    chain_of,
    damped_step,
    forward,
    frames,
    joint_jacobian,
    load_arm,
    parameter_jacobian,
    pose_error,
    pose_of,
)

STEP = 1e-5


def central_differences(pose_at, size):
    slopes = [pose_error(pose_at(-h), pose_at(h)) / (2 * STEP) for h in STEP * np.eye(size)]
    return np.stack(slopes, axis=-1)


@pytest.mark.parametrize("name", ["qiao2026", "ur5", "wam"])
def test_joint_jacobian_is_the_slope_of_the_pose(name, draw):
    geometry = load_arm(name).nominal
    q = draw(geometry, 30)
    expected = central_differences(lambda h: forward(geometry, q + h), geometry.joints)
    np.testing.assert_allclose(joint_jacobian(geometry, q), expected, rtol=0, atol=1e-7)


@pytest.mark.parametrize("name", ["qiao2026", "ur5", "wam"])
def test_parameter_jacobian_is_the_slope_of_the_pose(name, draw):
    """All columns at once, those of beta, base and tool included."""
    geometry = load_arm(name).nominal
    q = draw(geometry, 30)
    expected = central_differences(lambda h: forward(geometry.displaced(h), q), len(geometry.parameter_names))
    np.testing.assert_allclose(parameter_jacobian(geometry, q), expected, rtol=0, atol=1e-7)


def test_parameter_jacobian_in_general_position(general_chain, draw):
    q = draw(general_chain, 10)
    expected = central_differences(lambda h: forward(general_chain.displaced(h), q), 47)
    np.testing.assert_allclose(parameter_jacobian(general_chain, q), expected, rtol=0, atol=1e-7)


def skew(v):
    x, y, z = v
    return np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])


def differential_error_of_link(theta, d):
    """V_i of eq (7): the error e_i of link frame i, in that frame, per [alpha, a, theta, d]."""
    c, s = np.cos(theta), np.sin(theta)
    return np.array(
        [
            [-d * s, c, 0, 0],
            [-d * c, -s, 0, 0],
            [0, 0, 0, 1],
            [c, 0, 0, 0],
            [-s, 0, 0, 0],
            [0, 0, 1, 0],
        ]
    )


def adjoint_of_inverse(rotation, position):
    """J_i^6 of eq (8): carries an error of frame i into the tool frame, for T(i,6) = (rotation, position)."""
    carried = np.zeros((6, 6))
    carried[:3, :3] = carried[3:, 3:] = rotation.T
    carried[:3, 3:] = -rotation.T @ skew(position)
    return carried


def test_equation_8_is_the_concatenation_of_the_links(qiao, draw):
    """The paper prints a sum over J_i^6 V_i; concatenated it is our Jacobian in the tool frame."""
    g = qiao.true
    for q in draw(g, 20):
        links = [pose_of(frame) for frame in frames(np, chain_of(g), q)]
        tool = links[-1]
        blocks = []
        for i, slides in enumerate(g.prismatic):
            theta, d = (g.theta[i], g.d[i] + q[i]) if slides else (g.theta[i] + q[i], g.d[i])
            link = links[i + 1]
            to_tool = link.rotation.T @ tool.rotation, link.rotation.T @ (tool.position - link.position)
            blocks.append(adjoint_of_inverse(*to_tool) @ differential_error_of_link(theta, d))
        into_world = np.kron(np.eye(2), tool.rotation)
        per_link = np.hstack([into_world @ block for block in blocks])
        per_kind = per_link.reshape(6, 6, 4).swapaxes(1, 2).reshape(6, 24)  # alpha0..5, a0..5, theta1..6, d1..6
        np.testing.assert_allclose(parameter_jacobian(g, q)[:, :24], per_kind, rtol=0, atol=1e-12)


def test_moving_a_joint_is_moving_its_table_entry(qiao, draw):
    q = draw(qiao.true, 10)
    names = qiao.true.parameter_names
    moved = [names.index(f"{'d' if slides else 'theta'}{i + 1}") for i, slides in enumerate(qiao.true.prismatic)]
    np.testing.assert_allclose(
        joint_jacobian(qiao.true, q), parameter_jacobian(qiao.true, q)[..., moved], rtol=0, atol=1e-15
    )


@pytest.mark.parametrize(("rows", "joints"), [(3, 3), (3, 5), (6, 6), (6, 8)])
@pytest.mark.parametrize("damping", [1e-12, 1e-5, 0.1])
def test_a_damped_step_is_the_least_squares_solution_with_a_price_on_joint_motion(rows, joints, damping):
    """Also where a direction is lost; and of an arm alone, on floats."""
    rng = np.random.default_rng(rows * joints)
    jacobians, twists = rng.normal(size=(4, rows, joints)), rng.normal(size=(4, rows))
    if damping > 1e-9:
        jacobians[1, -1] = jacobians[1, 0]
    columns = [tuple(np.ascontiguousarray(jacobians[:, i, j]) for i in range(rows)) for j in range(joints)]
    steps = np.stack(damped_step(np, columns, list(twists.T.copy()), damping), axis=-1)
    for jacobian, twist, step in zip(jacobians, twists, steps, strict=True):
        price = math.sqrt(damping * (jacobian**2).sum()) * np.eye(joints)
        expected = np.linalg.lstsq(np.vstack([jacobian, price]), np.concatenate([twist, np.zeros(joints)]))[0]
        np.testing.assert_allclose(step, expected, rtol=1e-6, atol=1e-9)
        alone = damped_step(math, list(map(tuple, jacobian.T.tolist())), twist.tolist(), damping)
        np.testing.assert_allclose(alone, step, rtol=1e-9, atol=1e-12)
