"""What pose measurements of the hybrid picking arm can and cannot tell, and how far Table 1 is off (Qiao 2026)."""

from dataclasses import replace

import numpy as np
import pytest

from pickenv.arm import (
    Pose,
    forward,
    joint_jacobian,
    noncompensable_error,
    parameter_jacobian,
    pose_error,
    task_directions,
)

MDH = [f"{name}{i + first}" for name, first in (("alpha", 0), ("a", 0), ("theta", 1), ("d", 1)) for i in range(6)]
PAPER_DROPS = ["a2", "a3", "a5", "d3", "d4", "theta2", "d6"]
BASE_SET = [name for name in MDH if name not in {"a2", "a3", "a5", "d2", "d4", "d6", "theta6", "theta2"}]


@pytest.fixture
def q(qiao, draw):
    """60 poses, far more than the parameters need."""
    return draw(qiao.nominal, 60)


@pytest.fixture
def columns(qiao, q):
    """``columns(names)``: those columns of the parameter Jacobian of every pose, ``(60, 6, len(names))``."""

    def choose(names, geometry=qiao.nominal):
        where = [geometry.parameter_names.index(name) for name in names]
        return parameter_jacobian(geometry, q)[..., where]

    return choose


def rank(jacobian):
    return np.linalg.matrix_rank(jacobian.reshape(-1, jacobian.shape[-1]), rtol=1e-9)


@pytest.mark.parametrize(
    ("redundant", "kept"),
    [("a2", "a1"), ("a3", "a1"), ("a5", "a4"), ("d2", "d1"), ("d4", "d1"), ("d6", "d5"), ("theta6", "theta5")],
)
def test_two_parameters_that_no_pose_tells_apart(columns, redundant, kept):
    one, other = np.moveaxis(columns([redundant, kept]), -1, 0)
    np.testing.assert_allclose(one, other, rtol=0, atol=1e-12)


def test_boom_offset_is_the_difference_of_two_angles(columns):
    d3, theta2, theta1 = np.moveaxis(columns(["d3", "theta2", "theta1"]), -1, 0)
    np.testing.assert_allclose(d3, (theta2 - theta1) / 0.138, rtol=0, atol=1e-12)


def test_rank_is_16_from_full_poses(columns):
    assert rank(columns(MDH)) == 16


def test_base_set_is_complete_and_free_of_redundancy(columns):
    assert len(BASE_SET) == 16 == rank(columns(BASE_SET))


def test_either_of_d3_and_theta2_completes_the_base_set(columns):
    assert rank(columns([name if name != "d3" else "theta2" for name in BASE_SET])) == 16


def test_rank_of_the_papers_17_is_15(columns):
    kept = [name for name in MDH if name not in PAPER_DROPS]
    assert len(kept) == 17
    assert rank(columns(kept)) == 15


def test_rank_is_14_from_positions_alone(columns):
    assert rank(columns(MDH)[:, :3]) == 14


def test_rank_of_the_complete_model_is_4R_2P_6(columns, qiao):
    """With Hayati's beta and free base and tool, full poses tell 4 R + 2 P + 6 parameters."""
    slides = sum(qiao.nominal.prismatic)
    assert rank(columns(qiao.nominal.parameter_names)) == 4 * (6 - slides) + 2 * slides + 6 == 24


def with_target_at(geometry, point):
    return replace(geometry, tool=Pose(np.array(point), np.eye(3)))


@pytest.mark.parametrize(
    ("target", "count"), [((0, 0, 0), 19), ((0, 0, 0.05), 19), ((0.05, 0, 0), 21), ((0.05, 0.03, 0.02), 21)]
)
def test_positions_tell_more_of_the_complete_model_off_the_twist_axis(columns, qiao, target, count):
    jacobian = columns(qiao.nominal.parameter_names, with_target_at(qiao.nominal, target))
    assert rank(jacobian[:, :3]) == count


def test_three_reflectors_tell_what_full_poses_tell(columns, qiao, q):
    full = columns(qiao.nominal.parameter_names)
    rotation = forward(qiao.nominal, q).rotation
    rows = []
    for reflector in ([0.05, 0, 0], [-0.025, 0.04, 0], [-0.025, -0.04, 0]):
        lever = rotation @ np.array(reflector)
        rows.append(full[:, :3] + np.cross(full[:, 3:], lever[:, :, None], axis=1))
    assert rank(np.concatenate(rows, axis=1)) == 24


def marked_redundant(jacobian):
    """Eqs (9)-(10): how many diagonal entries of R lie below 0.05 of their mean."""
    diagonal = np.abs(np.diag(np.linalg.qr(jacobian.reshape(-1, 24), mode="r")))
    return np.sum(diagonal < 0.05 * diagonal.mean())


ORDERS = {"by kind": np.arange(24), "by joint": np.arange(24).reshape(4, 6).T.ravel()}


@pytest.mark.parametrize("order", ORDERS.values(), ids=ORDERS)
def test_the_papers_criterion_depends_on_units(columns, qiao, order):
    """In (mm, rad) it marks far too many; with rows and columns scaled, the 8 that are redundant."""
    jacobian = columns(MDH)[:40]
    angle = qiao.nominal.parameter_is_angle[:24]
    in_mm = jacobian * np.array([1e3] * 3 + [1] * 3)[:, None] * np.where(angle, 1, 1e-3)
    assert marked_redundant(in_mm[..., order]) in (14, 15)
    uncertainty = np.array([15e-6] * 3 + [np.radians(0.012)] * 3)
    tolerance = np.where(angle, np.radians(0.03), 0.5e-3)
    assert marked_redundant((jacobian / uncertainty[:, None] * tolerance)[..., order]) == 8


def test_task_rank_is_5_everywhere(qiao, draw):
    q = draw(qiao.nominal, 20_000)
    s = np.linalg.svd(joint_jacobian(qiao.nominal, q), compute_uv=False)
    assert (s[:, 5] < 1e-12 * s[:, 0]).all()
    assert (s[:, 4] > 0.11 * s[:, 0]).all()
    assert (task_directions(qiao.true, q)[1] == 5).all()


def test_the_true_arm_can_hardly_be_inverted(qiao, draw):
    """Eq (15) as printed: condition numbers of thousands, and steps of metres for an error of millimetres."""
    q = draw(qiao.true, 20_000)
    jacobian = joint_jacobian(qiao.true, q)
    condition = np.linalg.cond(jacobian)
    assert 1.2e3 < condition.min() < 1.7e3
    assert 1.7e3 < np.median(condition) < 3e3
    assert 4e4 < condition.max() < 1.5e5
    error = pose_error(forward(qiao.nominal, q), forward(qiao.true, q))
    slides = np.abs(np.linalg.solve(jacobian, error[..., None])[:, [1, 2, 4], 0]).max(axis=-1)
    assert slides.max() > 1.0


def test_the_missing_direction_is_a_turn_about_z1_cross_z5(qiao, draw):
    q = draw(qiao.nominal, 100)
    links_z = joint_jacobian(qiao.nominal, q)[:, 3:, [0, 5]]  # z1, and z6 parallel to z5
    axis = np.cross(links_z[..., 0], links_z[..., 1])
    random = np.random.default_rng(3).normal(size=(100, 6))
    floor = noncompensable_error(qiao.nominal, q, random)
    np.testing.assert_allclose(floor[:, :3], 0, rtol=0, atol=1e-12)
    np.testing.assert_allclose(floor[:, 3:], axis * np.sum(axis * random[:, 3:], axis=-1)[:, None], rtol=0, atol=1e-12)


@pytest.fixture
def raw(qiao, draw):
    """Joints and pose errors of the uncalibrated arm over its ranges, 20 000 poses."""
    q = draw(qiao.nominal, 20_000)
    return q, pose_error(forward(qiao.nominal, q), forward(qiao.true, q))


def test_raw_position_error_of_table_1(raw):
    """Tolerances are four standard errors of 20 000 poses."""
    error = raw[1][:, :3] * 1e3
    size = np.linalg.norm(error, axis=-1)
    assert size.mean() == pytest.approx(2.211, abs=0.03)
    assert np.sqrt(np.mean(size**2)) == pytest.approx(2.446, abs=0.03)
    assert size.std() == pytest.approx(1.046, abs=0.01)
    assert np.percentile(size, 95) == pytest.approx(3.79, abs=0.03)
    assert size.max() == pytest.approx(4.54, abs=0.15)
    np.testing.assert_allclose(np.sqrt(np.mean(error**2, axis=0)), [1.031, 0.424, 2.177], rtol=0, atol=0.03)


def test_raw_attitude_error_of_table_1(raw, qiao):
    error = np.degrees(np.linalg.norm(raw[1][:, 3:], axis=-1))
    assert error.mean() == pytest.approx(0.1745, abs=0.001)
    assert error.max() == pytest.approx(0.1943, abs=0.0005)


def test_no_joint_range_reaches_the_papers_raw_attitude_error(qiao):
    """The deviations of all angles add to 0.309 degrees; the paper reports 3.752, and 0.473 after least squares."""
    bound = np.degrees(np.abs(qiao.nominal.difference(qiao.true)[qiao.nominal.parameter_is_angle]).sum())
    assert bound == pytest.approx(0.309, abs=5e-4)
    anywhere = np.random.default_rng(4).uniform(-np.pi, np.pi, size=(20_000, 6))
    error = pose_error(forward(qiao.nominal, anywhere), forward(qiao.true, anywhere))
    assert np.degrees(np.linalg.norm(error[:, 3:], axis=-1)).max() < bound < 0.473


def test_attitude_floor_that_no_joint_motion_removes(raw, qiao):
    q, error = raw
    floor = np.degrees(np.linalg.norm(noncompensable_error(qiao.true, q, error)[:, 3:], axis=-1))
    assert floor.mean() == pytest.approx(0.049, abs=0.001)
    assert floor.max() == pytest.approx(0.098, abs=0.002)
