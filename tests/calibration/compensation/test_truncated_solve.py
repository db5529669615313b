"""The truncated solve of many Jacobians gives what the truncated pseudo-inverse gives of each."""

import numpy as np
import pytest

from pickenv.arm import joint_jacobian, load_arm, truncated_inverse
from pickenv.arm.kinematics.task_space import DIRECTION_TOLERANCE
from pickenv.calibration import random_joints
from pickenv.calibration.compensation.compensator import START, TruncatedSolver, _factorised, _inverse_trace


def components(jacobian, dtype):
    """Columns of ``(N, 6, n)``, component by component."""
    return [[np.ascontiguousarray(jacobian[:, i, j], dtype=dtype) for i in range(6)] for j in range(jacobian.shape[2])]


def solved(jacobian, error, dtype=np.float64):
    solver = TruncatedSolver(components(jacobian, dtype), np)
    return solver, np.stack(solver.solve([np.ascontiguousarray(part, dtype=dtype) for part in error.T]), axis=-1)


@pytest.mark.parametrize("dtype, bound", [(np.float64, 1e-4), (np.float32, 0.1)])
@pytest.mark.parametrize("name", ["qiao2026", "ur5", "wam", "li2016_slave"])
def test_it_is_the_truncated_pseudo_inverse(name, dtype, bound):
    """Rank 5 of 6, singular poses of a six-joint arm, seven joints, three joints; never far, and mostly very close."""
    arm = load_arm(name).nominal
    rng = np.random.default_rng(0)
    jacobian = joint_jacobian(arm, random_joints(arm, 2000, rng))
    error = rng.normal(size=(2000, 6))
    expected = np.einsum("kij,kj->ki", truncated_inverse(jacobian), error)
    found = solved(jacobian, error, dtype)[1]
    wrong = np.linalg.norm(found - expected, axis=1) / np.linalg.norm(expected, axis=1)
    assert wrong.max() < bound
    assert np.median(wrong) < (1e-10 if dtype is np.float64 else 2e-3)


def test_the_picking_arm_never_needs_the_singular_value_decomposition(qiao):
    rng = np.random.default_rng(1)
    jacobian = joint_jacobian(qiao.true, random_joints(qiao.nominal, 2000, rng))
    for dtype in (np.float64, np.float32):
        solver, _ = solved(jacobian, rng.normal(size=(2000, 6)), dtype)
        assert solver.lost.all() and not len(solver.doubtful[0])


def test_well_conditioned_poses_are_told_from_their_determinant():
    """Poses of a six-joint arm are not handed to the singular value decomposition unless they are near-singular."""
    arm = load_arm("ur5").nominal
    jacobian = joint_jacobian(arm, random_joints(arm, 2000, np.random.default_rng(2)))
    solver, _ = solved(jacobian, np.ones((2000, 6)))
    singular = np.linalg.svd(jacobian, compute_uv=False)
    assert (singular[solver.doubtful[0], -1] < 0.05 * singular[solver.doubtful[0], 0]).all()
    assert len(solver.doubtful[0]) < 500


@pytest.mark.parametrize("lost", [1, 2, 3])
def test_exactly_lost_directions_are_cut_off(lost):
    rng = np.random.default_rng(lost)
    left, right = (np.linalg.qr(rng.normal(size=(50, 6, 6)))[0] for _ in range(2))
    values = np.where(np.arange(6) < 6 - lost, 1.0 + np.arange(6), 0.0)
    jacobian, error = (left * values) @ right, rng.normal(size=(50, 6))
    expected = np.einsum("kij,kj->ki", np.linalg.pinv(jacobian, rcond=5e-3), error)
    np.testing.assert_allclose(solved(jacobian, error)[1], expected, atol=1e-7)


@pytest.mark.parametrize("along", [0.0, 1e-9, 1e-7, 1e-5])
def test_a_direction_that_the_search_starts_across_is_found_or_left_to_the_decomposition(along):
    """Two steps of inverse iteration do not turn a start to a direction of which it has next to nothing."""
    rng = np.random.default_rng(0)
    start = np.array(START[:6])
    jacobian = np.empty((40, 6, 6))
    for one in jacobian:
        across = rng.normal(size=6)
        across -= across @ start / (start @ start) * start
        lost = across / np.linalg.norm(across) + along * start
        right = np.linalg.qr(np.column_stack([lost, rng.normal(size=(6, 5))]))[0]
        left = np.linalg.qr(rng.normal(size=(6, 6)))[0]
        one[:] = left * [1e-4, 0.2, 0.5, 1.0, 1.0, 1.0] @ right.T
    error = rng.normal(size=(40, 6))
    expected = np.einsum("kij,kj->ki", truncated_inverse(jacobian), error)
    np.testing.assert_allclose(solved(jacobian, error)[1], expected, rtol=1e-6, atol=1e-6)


def test_plain_numbers_among_the_components_are_what_they_say():
    """As the constant axes of an arm are; those of two slides may have nothing in common."""
    rng = np.random.default_rng(0)
    jacobian, error = rng.normal(size=(30, 6, 6)), rng.normal(size=(30, 6))
    plain = {(2, 0): 1.0, (3, 0): 0.0, (5, 1): -1.0, (0, 4): 2.0, (1, 4): 0.0}
    plain |= {(row, column): 0.0 for row in range(6) for column in (2, 3) if row != column}
    for (row, column), value in plain.items():
        jacobian[:, row, column] = value
    jacobian[:3, 2, 2] = 0.0  # poses in which a joint moves nothing
    columns = components(jacobian, np.float64)
    for (row, column), value in plain.items():
        columns[column][row] = value
    found = np.stack(TruncatedSolver(columns, np).solve(list(error.T)), axis=-1)
    expected = np.einsum("kij,kj->ki", truncated_inverse(jacobian), error)
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-6)


def test_what_is_cut_off_is_judged_against_the_largest_of_all_columns():
    """Whichever of them it is, and however much shorter the others are."""
    rng = np.random.default_rng(0)
    jacobian = rng.normal(size=(400, 6, 6)) * 10.0 ** rng.uniform(-4, 0, (400, 1, 6))
    values = np.linalg.svd(jacobian, compute_uv=False)
    clear = (np.abs(np.log(values / values[:, :1] / 5e-3)) > 0.05).all(axis=1)
    jacobian, error = jacobian[clear], rng.normal(size=(clear.sum(), 6))
    expected = np.einsum("kij,kj->ki", truncated_inverse(jacobian), error)
    found = solved(jacobian, error)[1]
    assert (np.linalg.norm(found - expected, axis=1) < 1e-4 * np.linalg.norm(expected, axis=1)).all()


def with_singular_values(values, count, seed):
    """Jacobians ``(count, 6, n)`` with these singular values, turned anyhow."""
    rng, n = np.random.default_rng(seed), len(values)
    left = np.linalg.qr(rng.normal(size=(count, 6, 6)))[0][:, :, :n]
    return (left * values) @ np.linalg.qr(rng.normal(size=(count, n, n)))[0]


def test_one_scale_on_all_lengths_scales_the_solution_and_changes_no_choice():
    """Powers of two, which round nothing."""
    jacobian, error = np.random.default_rng(0).normal(size=(200, 6, 6)), np.ones((200, 6))
    jacobian[:100] = with_singular_values(np.array([1e-4, 0.01, 0.1, 0.5, 1.0, 1.0]), 100, 1)
    plain, expected = solved(jacobian, error)
    assert 20 < plain.lost.sum() < 180 and 0 < len(plain.doubtful[0]) < 200
    for scale in (2.0**-30, 2.0**30):
        solver, found = solved(jacobian * scale, error)
        np.testing.assert_array_equal(solver.lost, plain.lost)
        np.testing.assert_array_equal(solver.doubtful[0], plain.doubtful[0])
        clear = np.delete(np.arange(200), plain.doubtful[0])
        np.testing.assert_array_equal(found[clear] * scale, expected[clear])
        np.testing.assert_allclose(found * scale, expected, rtol=1e-9)


@pytest.mark.parametrize("n", [3, 6])
@pytest.mark.parametrize("least", [1e-4, 0.9, 1.1, 2.0])
@pytest.mark.parametrize("second", [0.9, 1.1, 1.5, 3.0, None])
def test_no_direction_is_cut_off_or_kept_against_the_tolerance(n, least, second):
    """One or two directions close to it, the others all alike: singular values as multiples of it."""
    values = np.ones(n)
    values[0] = DIRECTION_TOLERANCE * least
    if second is not None:
        values[1] = DIRECTION_TOLERANCE * second
    jacobian, error = with_singular_values(values, 40, 0), np.random.default_rng(1).normal(size=(40, 6))
    expected = np.einsum("kij,kj->ki", truncated_inverse(jacobian), error)
    np.testing.assert_allclose(solved(jacobian, error)[1], expected, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize(("n", "losing"), [(3, True), (6, True), (7, True), (3, False), (6, False)])
def test_poses_are_left_to_the_decomposition_where_bounds_on_their_eigenvalues_leave_doubt(n, losing):
    """A lost direction's follower is at least the others' product over their mean's power; else 1 / sum(1 / each)."""
    rng = np.random.default_rng(n)
    left, values, right = np.linalg.svd(rng.normal(size=(2000, 6, n)), full_matrices=False)
    values = rng.uniform(0.3, 1.0, values.shape)
    values[:, 1 if losing and n < 7 else 0] = 10.0 ** rng.uniform(-3.0, -1.0, 2000)
    if losing and n < 7:
        values[:, 0] = 1e-7
    jacobian = (left * values[:, None]) @ right
    eigenvalues = np.linalg.eigvalsh(np.swapaxes(jacobian, 1, 2) @ jacobian)
    trace = eigenvalues.sum(axis=1)
    cut = DIRECTION_TOLERANCE**2 * trace
    others = eigenvalues[:, 1:].prod(axis=1) / (trace / (n - 2)) ** (n - 2)
    bound = others if losing else 1 / (1 / eigenvalues).sum(axis=1)
    solver, _ = solved(jacobian, np.ones((2000, 6)))
    judged = (solver.lost == losing) & (np.abs(np.log(bound / cut)) > 0.01)
    doubtful = np.isin(np.arange(2000), solver.doubtful[0])
    np.testing.assert_array_equal(doubtful[judged], bound[judged] <= cut[judged])
    near = judged & (np.abs(np.log(bound / cut)) < 0.2)
    assert judged.mean() > 0.5 and 20 < doubtful[near].sum() < near.sum() - 20


def test_the_inverses_trace_comes_from_its_factors():
    rng = np.random.default_rng(0)
    square = rng.normal(size=(20, 5, 5))
    gram = square @ np.swapaxes(square, 1, 2) + np.eye(5)
    factors = _factorised([[gram[:, i, j] for j in range(i + 1)] for i in range(5)])
    np.testing.assert_allclose(_inverse_trace(*factors), np.trace(np.linalg.inv(gram), axis1=1, axis2=2))
