"""Compensation (Qiao 2026 eqs (13)-(16), Fig. 3): the true tool goes where the nominal one was meant to go."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings, strategies as st

from pickenv.arm import chain_of, displace_pose, forward, load_arm, noncompensable_error, pose_error
from pickenv.base import InputError
from pickenv.calibration import Compensator, random_joints
from pickenv.calibration.compensation.compensator import NEGLIGIBLE, _expected, _learnt, _nearer, corrected
from tests.calibration.compensation.networks import fast_network


def interior(geometry, count, seed=0):
    """Joints far enough from the limits that corrections have room."""
    span = geometry.upper - geometry.lower
    return np.random.default_rng(seed).uniform(
        geometry.lower + 0.1 * span, geometry.upper - 0.1 * span, (count, len(span))
    )


def shrunk(arm, share):
    """The arm with a share of Table 1's deviations."""
    return arm.nominal.displaced(share * arm.nominal.difference(arm.true))


def missed(compensator, truth, joints):
    """Largest position error, m, and compensable attitude error, rad, of the true tool."""
    command = compensator(joints)
    error = pose_error(forward(compensator.nominal, joints), forward(truth, command))
    error = error - noncompensable_error(truth, command, error)
    return np.linalg.norm(error[:, :3], axis=1).max(), np.linalg.norm(error[:, 3:], axis=1).max()


def test_one_correction_is_right_to_second_order(qiao):
    joints = interior(qiao.nominal, 300)
    whole, half = (
        np.array(missed(Compensator(qiao.nominal, shrunk(qiao, s), iterations=1), shrunk(qiao, s), joints))
        for s in (1, 0.5)
    )
    assert whole[0] < 2e-5 and whole[1] < 2e-5  # of 4.5 mm and 3.4 mrad
    assert (whole / half > 3).all()


def test_two_corrections_leave_nanometres(qiao):
    position, attitude = missed(Compensator(qiao.nominal, qiao.true), qiao.true, interior(qiao.nominal, 300))
    assert position < 2e-7 and attitude < 1e-6


@given(seed=st.integers(0, 2**32 - 1), scale=st.floats(0, 20))
@settings(max_examples=30, deadline=None)
def test_joint_limits_are_kept(qiao, seed, scale):
    """However wrong the arm, and at the very limits."""
    rng = np.random.default_rng(seed)
    joints = random_joints(qiao.nominal, 20, rng)
    joints[:10] = np.where(rng.random((10, 6)) < 0.5, qiao.nominal.lower, qiao.nominal.upper)
    command = Compensator(qiao.nominal, shrunk(qiao, scale))(joints)
    assert (command >= qiao.nominal.lower).all() and (command <= qiao.nominal.upper).all()


def test_corrections_are_small_where_the_literal_inverse_commands_metres(qiao):
    joints = random_joints(qiao.nominal, 2000, np.random.default_rng(0))
    assert np.abs(Compensator(qiao.nominal, qiao.true)(joints) - joints).max() < 0.02


def expected_off(compensator, joints, commands):
    """Size of the pose error that the model expects at commands, a radian as a metre."""
    return np.linalg.norm(pose_error(compensator.predict(commands), forward(compensator.nominal, joints)), axis=-1)


def on_torch(compensator, joints):
    """What the study's batches command."""
    chains = chain_of(compensator.nominal), chain_of(compensator.identified)
    rows = list(torch.from_numpy(joints.T.copy()))
    return torch.stack(corrected(torch, compensator.nominal, chains, rows, compensator.iterations), -1).numpy()


@given(
    arm=st.sampled_from(["qiao2026", "ur5", "wam"]),
    size=st.sampled_from([1e-3, 1e-2, 1e-1, 1.0]),
    iterations=st.integers(1, 3),
    seed=st.integers(0, 2**32 - 1),
)
@settings(max_examples=20, deadline=None)
def test_the_model_never_expects_the_command_farther_off_than_the_target(arm, size, iterations, seed):
    """However wrong the model, at singular poses and at joint limits, on every executor."""
    nominal, rng = load_arm(arm).nominal, np.random.default_rng(seed)
    identified = nominal.displaced(size * rng.standard_normal(nominal.difference(nominal).shape))
    joints = random_joints(nominal, 200, rng)
    joints[:50] = np.where(rng.random((50, nominal.joints)) < 0.5, nominal.lower, nominal.upper)
    plain, drifting = (Compensator(nominal, identified, residual, iterations) for residual in (None, Drift().predict))
    for compensator, command in (
        (plain, plain),
        (drifting, drifting),
        (plain, lambda q: np.array([plain(row) for row in q])),
        (plain, lambda q: on_torch(plain, q)),
    ):
        before, after = (expected_off(compensator, joints, q) for q in (joints, command(joints)))
        assert (after < before + iterations * NEGLIGIBLE + 1e-9).all()


def test_corrections_that_lead_away_are_not_commanded():
    """Near singular poses one in ten of these had been led decimetres away."""
    nominal, rng = load_arm("ur5").nominal, np.random.default_rng(0)
    identified = nominal.displaced(3e-3 * rng.standard_normal(nominal.difference(nominal).shape))
    joints = random_joints(nominal, 2000, rng)
    compensator = Compensator(nominal, identified)
    before, after = (expected_off(compensator, joints, q) for q in (joints, compensator(joints)))
    assert after.max() <= before.max() and np.median(after) < 0.05 * np.median(before)


def test_unless_told_otherwise_two_corrections_are_made(qiao):
    """An arm so far off that one more would still be seen."""
    joints, identified = interior(qiao.nominal, 5), shrunk(qiao, 20)
    one, two, three = (Compensator(qiao.nominal, identified, iterations=count)(joints) for count in (1, 2, 3))
    assert np.array_equal(Compensator(qiao.nominal, identified)(joints), two)
    assert (one != two).any() and (two != three).any()


@pytest.mark.parametrize("error", [[3.0, -4.0, 12.0, 84.0, 0.0, 0.0], [0.0, 0.0, 0.0, -8.0, 9.0, 12.0]])
def test_the_error_expected_is_the_length_of_all_six_components(error):
    assert _expected(math, [0.5], error) == ([0.5], np.sqrt(np.sum(np.square(error))))


def test_the_second_of_two_is_taken_unless_it_is_farther_off_by_more_than_is_negligible():
    """One pose or many, and none before the first."""
    farther = NEGLIGIBLE * np.array([-100.0, 0.0, 0.9, 1.1, 100.0])
    one, other = ([np.zeros(5)], np.full(5, 1e-3)), ([np.ones(5)], 1e-3 + farther)
    taken = np.array([1.0, 1.0, 1.0, 0.0, 0.0])
    joints, errors = _nearer(np, one, other)
    np.testing.assert_array_equal(joints[0], taken)
    np.testing.assert_array_equal(errors, np.where(taken == 1.0, other[1], one[1]))
    for i in range(5):
        joints, _ = _nearer(math, ([0.0], 1e-3), ([1.0], 1e-3 + farther[i]))
        assert joints == [taken[i]]
    assert _nearer(np, None, other) is other


def test_no_iterations_correct_nothing(qiao):
    joints = interior(qiao.nominal, 5)
    assert np.array_equal(Compensator(qiao.nominal, qiao.true, iterations=0)(joints), joints)


@pytest.mark.parametrize("arm", ["qiao2026", "ur5", "wam"])
def test_a_perfect_arm_is_left_alone(arm):
    nominal = load_arm(arm).nominal
    joints = random_joints(nominal, 100, np.random.default_rng(0))
    np.testing.assert_allclose(Compensator(nominal, nominal)(joints), joints, atol=1e-12)


def test_a_batch_is_its_poses_one_by_one(protocol):
    compensator = protocol[0].calibration.compensator()
    joints = random_joints(compensator.nominal, 12, np.random.default_rng(0))
    batch = compensator(joints.reshape(3, 4, 6))
    assert batch.shape == (3, 4, 6)
    np.testing.assert_allclose(batch.reshape(12, 6), [compensator(q) for q in joints], atol=1e-12)


DRIFT = np.array([1e-3, -2e-3, 5e-4, 0, 0, 0])


class Drift:
    """A residual that is the same everywhere."""

    def predict(self, joints):
        return np.zeros((*np.shape(joints)[:-1], 6)) + DRIFT


def test_a_residual_is_expected_and_countered(qiao):
    joints = interior(qiao.nominal, 100)
    compensator = Compensator(qiao.nominal, qiao.nominal, Drift().predict)
    there = forward(qiao.nominal, compensator(joints)).position + DRIFT[:3]
    np.testing.assert_allclose(there, forward(qiao.nominal, joints).position, atol=1e-7)
    expected = compensator.predict(joints).position - forward(qiao.nominal, joints).position
    np.testing.assert_allclose(expected, Drift().predict(joints)[:, :3], atol=1e-15)


@pytest.mark.parametrize("row, where", [((), ""), ((1,), " of row 1"), ((1, 2), " of row 1, 2")])
def test_a_target_that_is_not_finite_is_refused(qiao, row, where):
    joints = interior(qiao.nominal, 1)[0] + np.zeros((*(3 for _ in row), 6))
    joints[(*row, 2)] = np.nan
    with pytest.raises(InputError, match=f"the target of {qiao.nominal.joint_names[2]}{where} is nan; give finite"):
        Compensator(qiao.nominal, qiao.true)(joints)


def test_the_joints_asked_for_are_not_written_over(qiao):
    joints = interior(qiao.nominal, 5)
    before = joints.copy()
    Compensator(qiao.nominal, qiao.true)(joints)
    assert np.array_equal(joints, before)


class Learnt:
    """A residual that is as good as a network."""

    def predict(self, joints):
        return 1e-4 * np.sin(3.0 * np.asarray(joints)[..., :6])


@pytest.mark.parametrize("off", [1e-3, 0.3], ids=["an arm nearly right", "an arm far off"])
@pytest.mark.parametrize("residual", [None, Learnt().predict, "network"], ids=["geometry", "learnt", "network"])
@pytest.mark.parametrize("arm", ["qiao2026", "ur5e"])
def test_the_compiled_compensator_is_numpys_up_to_roundings(arm, residual, off):
    """The picking arm has one lost direction; of UR5e's poses some need the singular value decomposition."""
    pytest.importorskip("llvmlite")
    g = load_arm(arm).nominal
    residual = fast_network(g.joints).predict if residual == "network" else residual
    plain = Compensator(g, replace(g, a=g.a + 2e-4, theta=g.theta + off), residual)
    joints = random_joints(g, 900, np.random.default_rng(0))
    joints[:20] = np.where(np.arange(20)[:, None] % 2, g.lower, g.upper)
    np.testing.assert_allclose(plain.compiled(900)(joints), plain(joints), rtol=0, atol=1e-12)
    np.testing.assert_array_equal(plain(joints[7:8]), plain(joints)[7:8])


def moved(compensator, one, other):
    """How far apart the tool is expected at two sets of commands, m."""
    return np.linalg.norm(compensator.predict(one).position - compensator.predict(other).position, axis=1)


def test_many_poses_in_single_precision_are_where_double_puts_them(protocol):
    calibration = protocol[0].calibration
    double = calibration.compensator(fast=False)
    compensator = replace(double, single_precision=True)
    joints = interior(compensator.nominal, 3000)
    apart = moved(compensator, compensator(joints), double(joints))
    assert 0 < apart.max() < 1e-6 and apart.mean() < 2e-7
    assert np.array_equal(calibration.compensate(joints), calibration.compensator()(joints))


def test_what_nobody_waits_for_is_predicted_and_corrected_in_double_precision(protocol):
    calibration, joints = protocol[0].calibration, interior(protocol[0].calibration.nominal, 50)
    exact = displace_pose(forward(calibration.identified, joints), calibration.learnt.predict(joints))
    np.testing.assert_array_equal(calibration.predict(joints).position, exact.position)
    fast = calibration.compensator().predict(joints).position
    assert 0 < np.abs(fast - exact.position).max() < 2e-5


def test_without_a_residual_too_single_precision_is_a_rounding_and_only_where_it_is_asked_for(qiao):
    joints = interior(qiao.nominal, 300)
    double, single = (Compensator(qiao.nominal, qiao.true, single_precision=one)(joints) for one in (False, True))
    assert 1e-9 < np.abs(single - double).max() < 1e-6
    np.testing.assert_array_equal(Compensator(qiao.nominal, qiao.true)(joints), double)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_what_is_learnt_has_the_precision_that_it_is_asked_in(qiao, dtype):
    found = _learnt(np, Drift().predict, list(interior(qiao.nominal, 5).T.astype(dtype)))
    assert len(found) == 6 and {part.dtype for part in found} == {np.dtype(dtype)}
    np.testing.assert_allclose(np.stack(found, -1), np.tile(DRIFT, (5, 1)), rtol=1e-6)


@pytest.mark.parametrize("shape", [(0, 6), (3, 0, 6)])
def test_no_targets_are_no_commands(qiao, shape):
    assert Compensator(qiao.nominal, qiao.true)(np.empty(shape)).shape == shape


def test_an_environment_gets_the_same_whatever_shares_its_batch(protocol):
    """Blocks are cut at fixed places, and within them each pose is on its own, up to roundings of the network."""
    compensator = protocol[0].calibration.compensator()
    joints = interior(compensator.nominal, 2500)
    np.testing.assert_allclose(compensator(joints)[::7], compensator(joints[::7]), rtol=0, atol=1e-9)
    np.testing.assert_allclose(compensator(joints)[0], compensator(joints[0]), rtol=0, atol=1e-9)


def converged(compensator, joints):
    """Commands at which the expected tool is where it is wanted, the residual evaluated at each iteration."""
    commands = joints
    for _ in range(4):
        frozen = compensator.residual(commands)
        commands = replace(compensator, residual=lambda _, values=frozen: values, iterations=4)(joints)
    return commands


@pytest.mark.parametrize("iterations, mean, most", [(1, 3e-6, 20e-6), (2, 2e-6, 15e-6)])
def test_a_network_evaluated_once_and_in_single_precision_is_enough(protocol, iterations, mean, most):
    """Of hundreds of micrometres that the network predicts, its change on the way and its steps leave one or two."""
    compensator = replace(protocol[0].calibration.compensator(), iterations=iterations)
    exact = protocol[0].calibration.compensator(iterations=iterations, fast=False)
    joints = interior(compensator.nominal, 900)
    apart = moved(exact, compensator(joints), converged(exact, joints))
    assert apart.mean() < mean and apart.max() < most


def test_the_residual_is_asked_once(qiao):
    class Counted(Drift):
        asked = 0

        def predict(self, joints):
            self.asked += 1
            return super().predict(joints)

    joints = interior(qiao.nominal, 4)
    for targets in (joints, joints[0]):
        residual = Counted()
        Compensator(qiao.nominal, qiao.true, residual.predict)(targets)
        assert residual.asked == 1


@pytest.mark.parametrize("many", [False, True], ids=["one pose", "many poses"])
def test_an_arm_of_five_joints_is_brought_to_the_position_and_gives_up_attitude(many):
    """Its links are off in every direction; a radian that counted a metre would leave millimetres."""
    nominal = load_arm("so101").nominal
    rng = np.random.default_rng(0)
    sizes = np.concatenate([np.repeat([np.radians(0.6), 0.3e-3, np.radians(0.6), 0.3e-3, 0.0], 5), np.zeros(12)])
    true = nominal.displaced(sizes * rng.normal(size=len(sizes)))
    joints = interior(nominal, 200)
    compensator = Compensator(nominal, true, iterations=4)
    commands = compensator(joints) if many else np.array([compensator(row) for row in joints])
    wanted = forward(nominal, joints)
    raw, left = (pose_error(wanted, forward(true, q)) for q in (joints, commands))
    near, far = (np.median(np.linalg.norm(error[:, :3], axis=1)) for error in (left, raw))
    assert far > 2e-3 and near < 0.05 * far
    turns = [np.median(np.linalg.norm(error[:, 3:], axis=1)) for error in (left, raw)]
    assert turns[0] < 2 * turns[1]  # it is not given away for nothing


def test_a_target_beyond_a_limit_is_held_at_it_alone_as_among_many(qiao):
    """Where the target itself would be the nearest of all candidates."""
    compensator, middle = Compensator(qiao.nominal, qiao.true), (qiao.nominal.lower + qiao.nominal.upper) / 2
    for joint in range(6):
        target = np.where(np.arange(6) == joint, qiao.nominal.upper + 0.05, middle)
        assert (compensator(target) <= qiao.nominal.upper).all()
        np.testing.assert_allclose(compensator(target), compensator(target[None])[0], rtol=0, atol=1e-12)
