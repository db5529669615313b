"""Statements that hold for every serial chain of revolute and prismatic joints, on chains drawn at random."""

from functools import reduce

import numpy as np
from hypothesis import given, settings, strategies as st
from hypothesis.extra.numpy import arrays

from pickenv.arm import (
    Geometry,
    Pose,
    displace_pose,
    forward,
    from_standard_dh,
    joint_jacobian,
    parameter_jacobian,
    pose_error,
    rotation_matrix,
    rotation_vector,
)

TABLE = ("alpha", "a", "theta", "d", "beta")
quick = settings(max_examples=60, deadline=None, derandomize=True)


def numbers(count: int, largest: float = 3.0) -> st.SearchStrategy[np.ndarray]:
    return arrays(float, count, elements=st.floats(-largest, largest, allow_subnormal=False))


# Below half a turn's length per axis, so that a rotation has one rotation vector only.
twists = numbers(6, 1.7)
poses = twists.map(lambda v: Pose(v[:3], rotation_matrix(v[3:])))


@st.composite
def chains(draw: st.DrawFn) -> tuple[Geometry, np.ndarray]:
    """A chain of one to seven joints, and joint displacements for it."""
    prismatic = tuple(draw(st.lists(st.booleans(), min_size=1, max_size=7)))
    n = len(prismatic)
    table = {name: draw(numbers(n)) for name in TABLE}
    names = tuple(f"J{i + 1}" for i in range(n))
    limits = {"lower": np.full(n, -3.0), "upper": np.full(n, 3.0)}
    return Geometry(names, prismatic, **table, **limits, base=draw(poses), tool=draw(poses)), draw(numbers(n))


def homogeneous(pose: Pose) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = pose.rotation, pose.position
    return matrix


def turn(axis: int, angle: float) -> np.ndarray:
    return homogeneous(Pose(np.zeros(3), rotation_matrix(angle * np.eye(3)[axis])))


def shift(axis: int, length: float) -> np.ndarray:
    return homogeneous(Pose(length * np.eye(3)[axis], np.eye(3)))


def product(factors: list[np.ndarray]) -> np.ndarray:
    return reduce(np.matmul, factors, np.eye(4))


def same_pose(pose: Pose, matrix: np.ndarray) -> None:
    np.testing.assert_allclose(homogeneous(pose), matrix, rtol=0, atol=1e-12)


@quick
@given(chains())
def test_forward_is_the_matrix_product_of_equation_1(drawn):
    g, q = drawn
    links = []
    for i, slides in enumerate(g.prismatic):
        theta, d = (g.theta[i], g.d[i] + q[i]) if slides else (g.theta[i] + q[i], g.d[i])
        links += [turn(0, g.alpha[i]), shift(0, g.a[i]), turn(1, g.beta[i]), turn(2, theta), shift(2, d)]
    same_pose(forward(g, q), product([homogeneous(g.base), *links, homogeneous(g.tool)]))


@quick
@given(chains())
def test_standard_dh_is_regrouped_without_approximation(drawn):
    g, q = drawn
    table = {name: getattr(g, name) for name in ("theta", "d", "a", "alpha", "lower", "upper")}
    ours = from_standard_dh(g.joint_names, g.prismatic, **table, base=g.base, tool=g.tool)
    links = []
    for i, slides in enumerate(g.prismatic):
        theta, d = (g.theta[i], g.d[i] + q[i]) if slides else (g.theta[i] + q[i], g.d[i])
        links += [turn(2, theta), shift(2, d), shift(0, g.a[i]), turn(0, g.alpha[i])]
    same_pose(forward(ours, q), product([homogeneous(g.base), *links, homogeneous(g.tool)]))


@quick
@given(chains(), st.data())
def test_displaced_and_difference_undo_each_other(drawn, data):
    g, _ = drawn
    delta = data.draw(numbers(len(g.parameter_names), 1.7))
    np.testing.assert_allclose(g.difference(g.displaced(delta)), delta, rtol=0, atol=1e-12)


@quick
@given(poses, twists)
def test_pose_error_and_displace_pose_undo_each_other(pose, error):
    np.testing.assert_allclose(pose_error(pose, displace_pose(pose, error)), error, rtol=0, atol=1e-12)


@quick
@given(numbers(3, 1.7))
def test_rotation_vector_and_matrix_undo_each_other(vector):
    np.testing.assert_allclose(rotation_vector(rotation_matrix(vector)), vector, rtol=0, atol=1e-12)


@quick
@given(chains())
def test_jacobians_are_the_derivatives_of_the_pose(drawn):
    g, q = drawn
    step = 1e-5

    def slope(before: Pose, after: Pose) -> np.ndarray:
        return pose_error(before, after) / (2 * step)

    by_joint = [slope(forward(g, q - h), forward(g, q + h)) for h in step * np.eye(g.joints)]
    by_parameter = [
        slope(forward(g.displaced(-h), q), forward(g.displaced(h), q)) for h in step * np.eye(5 * g.joints + 12)
    ]
    np.testing.assert_allclose(joint_jacobian(g, q), np.transpose(by_joint), rtol=0, atol=1e-7)
    np.testing.assert_allclose(parameter_jacobian(g, q), np.transpose(by_parameter), rtol=0, atol=1e-7)
