"""Commands from a calibration: the true error falls, limits hold, what cannot be reached is named."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from pickenv.arm import (
    Pose,
    forward,
    inverse,
    joint_jacobian,
    load_arm,
    load_plant,
    pose_error,
    rotation_matrix,
    rotation_vector,
)
from pickenv.base import InputError
from pickenv.calibration import (
    ArmModel,
    Calibration,
    Conditions,
    Targets,
    ThermalTerm,
    apply_calibration,
    assess,
    fit,
    joints_of,
    random_joints,
    read_targets,
    simulated_tracker,
    uncertainty_from,
)


@pytest.fixture(scope="module")
def calibration(dynamic):
    """Base and tool known, so that the true arm can be asked in the same frame."""
    rng = np.random.default_rng(0)
    train, test = (simulated_tracker(dynamic, random_joints(dynamic.arm.nominal, n, rng), rng) for n in (100, 200))
    found = fit(dynamic.arm, train, known_frames=True)
    return assess(dynamic.arm, found, train, test).calibration


@pytest.fixture(scope="module")
def elsewhere(dynamic):
    """The same, measured by an instrument that stands metres away and sees a target beside the tool."""
    rng = np.random.default_rng(1)
    data = simulated_tracker(dynamic, random_joints(dynamic.arm.nominal, 100, rng), rng)
    turn, target = rotation_matrix([0.3, 0.2, 1.0]), rotation_matrix([0.0, 0.4, 0.1])
    seen = data.position + data.rotation @ [0.03, 0.01, 0.05]
    data = replace(data, position=seen @ turn.T + [1.0, 2.0, 3.0], rotation=turn @ data.rotation @ target)
    found = fit(dynamic.arm, data)
    return assess(dynamic.arm, found, data, data).calibration


def joint_targets(joints):
    return Targets(np.asarray(joints, dtype=float), None, tuple(range(2, 2 + len(joints))), "targets.csv")


def pose_targets(pose):
    return Targets(None, pose, tuple(range(2, 2 + len(pose.position))), "targets.csv")


def inner_joints(geometry, count, seed):
    middle, half = (geometry.lower + geometry.upper) / 2, (geometry.upper - geometry.lower) / 2
    return middle + half * np.random.default_rng(seed).uniform(-0.9, 0.9, (count, geometry.joints))


def test_the_true_error_falls_and_is_predicted(calibration, dynamic):
    nominal = dynamic.arm.nominal
    joints = inner_joints(nominal, 200, 3)
    found = apply_calibration(calibration, dynamic.arm, joint_targets(joints))
    wanted = forward(nominal, joints)
    before, after = (pose_error(wanted, dynamic.tool_pose(q)) for q in (joints, found.joints))
    assert found.reached.all() and found.reasons == {}
    assert np.linalg.norm(after[:, :3], axis=1).mean() < 0.4 * np.linalg.norm(before[:, :3], axis=1).mean()
    # What it says of the uncorrected arm is as true as it says it is, and rather truer well inside the joint ranges.
    missed = np.linalg.norm(found.before[:, :3] - before[:, :3], axis=1)
    assert 0.7 < np.sqrt(np.mean(missed**2) / np.mean(found.uncertainty[0] ** 2)) < 1.1
    assert np.mean(np.linalg.norm(after[:, :3], axis=1) < 2 * found.uncertainty[0]) > 0.9
    assert np.linalg.norm(found.remaining[:, :3], axis=1).max() < 1e-5


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=15, deadline=None)
def test_commands_stay_within_limits_and_reach_is_honest(calibration, dynamic, seed):
    """Targets on the very border of the joint ranges."""
    nominal = dynamic.arm.nominal
    joints = random_joints(nominal, 20, np.random.default_rng(seed))
    joints[::2] = np.where(joints[::2] > (nominal.lower + nominal.upper) / 2, nominal.upper, nominal.lower)
    found = apply_calibration(calibration, dynamic.arm, joint_targets(joints))
    assert (found.joints >= nominal.lower).all() and (found.joints <= nominal.upper).all()
    removable = np.linalg.norm((found.remaining - found.impossible)[:, :3], axis=1)
    assert ((removable <= 1e-5) | ~found.reached).all()
    assert set(found.reasons) == set(np.flatnonzero(~found.reached).tolist())


def test_the_turn_that_remains_is_the_one_that_no_joint_makes(calibration, dynamic):
    """Digest, fact 4: rotation about z1 x z5; its axis lies across every column of the joint Jacobian."""
    found = apply_calibration(calibration, dynamic.arm, joint_targets(inner_joints(dynamic.arm.nominal, 30, 4)))
    jacobian = joint_jacobian(dynamic.arm.nominal, found.joints)
    axis = np.cross(jacobian[:, 3:, 0], jacobian[:, 3:, 5])
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    turn = found.impossible[:, 3:]
    along = np.abs(np.einsum("ni,ni->n", turn, axis))
    np.testing.assert_allclose(along, np.linalg.norm(turn, axis=1), rtol=0.02, atol=1e-6)
    assert 0.01 < np.degrees(along).mean() < 0.1


@pytest.fixture(scope="module")
def cut_off(calibration, dynamic):
    """Targets of which some joints, from none to all, stand at a limit: what becomes of them."""
    nominal, rng = dynamic.arm.nominal, np.random.default_rng(1)
    joints, side, share = random_joints(nominal, 300, rng), rng.random((300, 6)), rng.random((300, 1)) / 2
    joints = np.where(side < share, nominal.lower, np.where(side > 1 - share, nominal.upper, joints))
    return apply_calibration(calibration, dynamic.arm, joint_targets(joints))


def left_over(found):
    """What free joints could still remove: mm and deg."""
    left = found.remaining - found.impossible
    return 1e3 * np.hypot(left[:, 0], np.hypot(left[:, 1], left[:, 2])), np.rad2deg(np.sqrt((left[:, 3:] ** 2).sum(1)))


def test_a_target_is_reached_where_position_and_attitude_both_are(cut_off):
    """To 0.01 mm and 0.02 mrad: one, the other or both may be missed."""
    missed_mm, missed_deg = left_over(cut_off)
    far, turned = missed_mm > 0.01, missed_deg > np.rad2deg(2e-5)
    np.testing.assert_array_equal(cut_off.reached, ~far & ~turned)
    assert min((far & ~turned).sum(), (turned & ~far).sum(), (far & turned).sum(), cut_off.reached.sum()) > 10


def test_what_cuts_a_correction_off_is_named_with_what_it_leaves(cut_off, dynamic):
    nominal = dynamic.arm.nominal
    limits = (cut_off.joints == nominal.lower) | (cut_off.joints == nominal.upper)
    for i, mm, deg in zip(range(300), *left_over(cut_off), strict=True):
        held = ", ".join(name for name, at in zip(nominal.joint_names, limits[i], strict=True) if at)
        said = f"the correction is cut off by a joint limit ({held}); {mm:.3g} mm and {deg:.3g} deg remain that"
        assert cut_off.reached[i] or cut_off.reasons[i] == f"{said} a free joint could remove"


def test_where_nothing_is_reached_no_command_stands_in_the_table(cut_off):
    table = dict(zip(cut_off.table()[0], cut_off.table()[1].T, strict=True))
    np.testing.assert_array_equal(table["reached"] == "yes", cut_off.reached)
    np.testing.assert_array_equal(table["q1_deg"] == "", ~cut_off.reached)
    assert table["note"].tolist() == [cut_off.reasons.get(i, "") for i in range(300)]


def test_the_report_speaks_of_the_targets_that_are_reached(cut_off):
    shown = cut_off.reached
    mm, deg = (
        [np.mean(scale * np.sqrt((e[shown][:, part] ** 2).sum(axis=1))) for e in (cut_off.before, cut_off.remaining)]
        for scale, part in ((1e3, slice(3)), (180 / np.pi, slice(3, 6)))
    )
    lost = np.mean(np.rad2deg(np.sqrt((cut_off.impossible[shown, 3:] ** 2).sum(axis=1))))
    lines = cut_off.report().splitlines()
    assert lines[0] == f"{shown.sum()} of 300 targets can be reached"
    assert f"would miss by {mm[0]:.3f} mm and {deg[0]:.4f} deg" in lines[1]
    assert f"{mm[1]:.4f} mm and {deg[1]:.4f} deg remain, of which {lost:.4f} deg" in lines[2]
    sure, within = 1e3 * cut_off.uncertainty[0][shown], 1e3 * cut_off.within95[0][shown]
    assert f"reached: {np.median(sure):.3f} mm (median), {sure.max():.3f} mm at most" in lines[3]
    assert f"within {np.median(within):.3f} mm (median of targets; {within.max():.3f} mm at most)" in lines[4]


def test_a_target_a_hair_outside_its_limits_is_outside_and_one_off_by_rounding_is_not(calibration, dynamic):
    nominal = dynamic.arm.nominal
    middle = (nominal.lower + nominal.upper) / 2
    joints = np.tile(middle, (4, 1))
    joints[:, 2] = nominal.lower[2] - 1e-6, nominal.upper[2] + 1e-6, nominal.lower[2] - 5e-10, nominal.upper[2] + 5e-10
    found = apply_calibration(calibration, dynamic.arm, joint_targets(joints))
    told = [found.reasons.get(i, "") == "target of J3 telescopic boom is outside its limits" for i in range(4)]
    assert told == [True, True, False, False] and not found.reached[:2].any()


@pytest.fixture(scope="module")
def warm(qiao):
    """An arm that grows with temperature, calibrated at temperatures of all kinds."""
    rng = np.random.default_rng(0)
    truth = ArmModel(qiao.true, (ThermalTerm(),), np.array([23e-6]))
    joints, warmth = random_joints(qiao.nominal, 100, rng), Conditions(temperature=rng.uniform(-20, 20, 100))
    pose = truth.pose(joints, warmth)
    data = simulated_tracker(load_plant("geometry_only"), joints, rng)
    data = replace(data, position=pose.position + 2e-5 * rng.normal(size=(100, 3)), rotation=pose.rotation)
    data = replace(data, conditions=warmth)
    found = fit(qiao, data, known_frames=True, terms=(ThermalTerm(),))
    return truth, assess(qiao, found, data, data).calibration


def test_the_temperature_given_counts_for_commands_and_for_how_sure_they_are(warm, qiao):
    truth, calibration = warm
    targets = joint_targets(inner_joints(qiao.nominal, 30, 2))
    wanted, sure = forward(qiao.nominal, targets.joints), {}
    for degrees in (-20.0, 20.0):
        given = Conditions(temperature=np.array(degrees))
        found = apply_calibration(calibration, qiao, targets, conditions=given)
        there = truth.pose(found.joints, Conditions(temperature=np.full(30, degrees)))
        assert np.linalg.norm(there.position - wanted.position, axis=1).max() < 1e-4
        sure[degrees] = found.uncertainty[0]
        expected = uncertainty_from(calibration.record).standard(
            calibration.model, found.joints, Conditions(temperature=np.full(30, degrees))
        )
        np.testing.assert_allclose(found.uncertainty, expected)
    assert np.abs(sure[-20.0] / sure[20.0] - 1.0).max() > 1e-4


def test_a_single_command_is_bounded_as_one_of_many(warm, qiao):
    """Also where payload or temperature count."""
    _, calibration = warm
    compensator = calibration.compensator(conditions=Conditions(temperature=np.array(12.0)))
    joints = inner_joints(qiao.nominal, 5, 3)
    for many, *single in zip(compensator.within95(joints), *map(compensator.within95, joints), strict=True):
        assert all(np.shape(bound) == () for bound in single)
        np.testing.assert_allclose(single, many)


def test_a_target_outside_the_limits_is_named_with_its_row_and_joint(calibration, dynamic):
    joints = inner_joints(dynamic.arm.nominal, 3, 0)
    joints[1, 2] = 2.0
    found = apply_calibration(calibration, dynamic.arm, joint_targets(joints))
    assert found.reached.tolist() == [True, False, True]
    assert "J3 telescopic boom is outside its limits" in found.reasons[1]
    assert "row 3: target of J3" in found.report()


def test_poses_are_reached_like_the_joints_that_make_them(calibration, dynamic):
    nominal = dynamic.arm.nominal
    joints = inner_joints(nominal, 20, 5)
    pose = forward(nominal, joints)
    found = apply_calibration(calibration, dynamic.arm, pose_targets(pose))
    assert found.reached.all()
    missed = np.linalg.norm(pose_error(pose, dynamic.tool_pose(found.joints))[:, :3], axis=1)
    assert missed.mean() < 1e-3 < np.linalg.norm(pose_error(pose, dynamic.tool_pose(joints))[:, :3], axis=1).mean()


def test_a_pose_out_of_reach_is_named(calibration, dynamic):
    pose = forward(dynamic.arm.nominal, inner_joints(dynamic.arm.nominal, 2, 6))
    turned = rotation_matrix([0.4, -0.3, 0.2]) @ pose.rotation[:1]
    far = Pose(np.vstack([pose.position, [[5.0, 0.0, 0.0]]]), np.concatenate([pose.rotation, turned]))
    found = apply_calibration(calibration, dynamic.arm, pose_targets(far))
    assert found.reached.tolist() == [True, True, False] and "no joints within the limits" in found.reasons[2]
    nearest = inverse(dynamic.arm.nominal, far)
    deg = np.degrees(nearest.attitude_error[2])  # all of it: what is free at other joints is none at these
    assert nearest.noncompensable_attitude[2] > 1e-2
    assert found.reasons[2].endswith(f"miss it by {1e3 * nearest.position_error[2]:.3g} mm and {deg:.3g} deg")
    assert "2 of 3 targets" in found.report()


def test_frames_of_controller_and_instrument_are_one_and_the_same_pose(elsewhere, dynamic):
    """A pose given in either frame asks for the same command, where base and tool are only known by fitting."""
    nominal = dynamic.arm.nominal
    joints = inner_joints(nominal, 10, 7)
    by_controller = apply_calibration(elsewhere, dynamic.arm, pose_targets(forward(nominal, joints)))
    there = pose_targets(forward(elsewhere.nominal, joints))
    by_instrument = apply_calibration(elsewhere, dynamic.arm, there, frame="instrument")
    seen = [forward(elsewhere.identified, found.joints).position for found in (by_controller, by_instrument)]
    np.testing.assert_allclose(seen[0], seen[1], atol=1e-5)
    as_joints = apply_calibration(elsewhere, dynamic.arm, joint_targets(joints))
    np.testing.assert_allclose(forward(elsewhere.identified, as_joints.joints).position, seen[0], atol=1e-5)


def test_a_pose_is_carried_to_where_the_same_joints_bring_it_with_another_base_and_tool(qiao):
    """Also where the believed tool and base stand off, as on an arm with a gripper."""
    rng = np.random.default_rng(0)
    believed, fitted = (qiao.nominal.displaced(np.r_[np.zeros(30), rng.normal(size=12)]) for _ in range(2))
    joints = inner_joints(qiao.nominal, 20, 1)
    arm = replace(qiao, nominal=believed)
    known = Calibration(arm.name, believed, fitted, ArmModel.of(fitted), None, {})
    found = apply_calibration(known, arm, pose_targets(forward(believed, joints)))
    assert found.reached.all()
    np.testing.assert_allclose(found.before, 0.0, atol=1e-9)
    np.testing.assert_allclose(found.joints, found.targets, atol=1e-9)


def test_a_learnt_residual_takes_part(dynamic):
    rng = np.random.default_rng(0)
    sets = [simulated_tracker(dynamic, random_joints(dynamic.arm.nominal, n, rng), rng) for n in (100, 200)]
    found = fit(dynamic.arm, *sets, known_frames=True, residual="rbf", rng=rng).calibration
    targets = joint_targets(inner_joints(dynamic.arm.nominal, 100, 8))
    wanted = forward(dynamic.arm.nominal, targets.joints)
    learnt, plain = (
        np.linalg.norm(
            pose_error(wanted, dynamic.tool_pose(apply_calibration(c, dynamic.arm, targets).joints))[:, :3], axis=1
        ).mean()
        for c in (found, found.without_residual())
    )
    assert learnt < 0.6 * plain


def test_the_table_reads_back(calibration, dynamic, tmp_path):
    joints = inner_joints(dynamic.arm.nominal, 4, 9)
    found = apply_calibration(calibration, dynamic.arm, joint_targets(joints))
    path = found.write_csv(tmp_path / "commands.csv")
    again = read_targets(path, dynamic.arm.nominal)
    np.testing.assert_allclose(again.joints, found.joints, atol=1e-12)
    names, rows = found.table()
    assert rows.shape == (4, len(names)) and set(rows[:, names.index("reached")]) == {"yes"}
    assert float(rows[0, names.index("uncertainty_mm")]) == pytest.approx(found.uncertainty[0][0] * 1e3)


def test_without_uncertainty_in_the_file_it_says_so(calibration, dynamic):
    bare = replace(calibration, record={k: v for k, v in calibration.record.items() if k != "uncertainty"})
    found = apply_calibration(bare, dynamic.arm, joint_targets(inner_joints(dynamic.arm.nominal, 2, 0)))
    assert found.uncertainty[0] is None and "uncertainty unknown" in found.report()
    assert "uncertainty_mm" not in found.table()[0]


def test_another_arms_calibration_and_unknown_frames_are_refused(calibration):
    with pytest.raises(InputError, match="belongs to arm 'qiao2026'"):
        apply_calibration(calibration, load_arm("ur5"), joint_targets(np.zeros((1, 6))))
    with pytest.raises(InputError, match="frame is 'moon'"):
        apply_calibration(calibration, load_arm("qiao2026"), joint_targets(np.zeros((1, 6))), frame="moon")


def test_pose_targets_are_read_in_mm_and_degrees(qiao, tmp_path):
    path = tmp_path / "t.csv"
    path.write_text("x_mm,y_mm,z_mm,rx_deg,ry_deg,rz_deg,note\n700,-750,400,0,0,30,a\n\n800,-700,350,0,0,0,b\n")
    found = read_targets(path, qiao.nominal)
    assert found.joints is None and found.lines == (2, 4)
    np.testing.assert_allclose(found.pose.position[0], [0.7, -0.75, 0.4])
    np.testing.assert_allclose(rotation_vector(found.pose.rotation[0]), [0, 0, np.pi / 6], atol=1e-12)
    joints = joints_of(found, qiao.nominal)
    np.testing.assert_allclose(forward(qiao.nominal, joints).position, found.pose.position, atol=2e-5)


HEADER = "q1_deg,q2_mm,q3_mm,q4_deg,q5_mm,q6_deg"


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("", "is empty"),
        (HEADER + "\n", "has a header but no rows"),
        (HEADER + "\n1,2,3,4,5\n", "row 2, column 'q6_deg' is empty"),
        (HEADER + "\n1,2,3,4,5,6\n1,2,x,4,5,6\n", "row 3, column 'q3_mm' holds 'x'"),
        (HEADER + "\n1,2,3,4,5,nan\n", "row 2, column 'q6_deg' is nan"),
        (HEADER + "\n1,2,3,4,5,1_0\n", "row 2, column 'q6_deg'"),
        (HEADER + ",q1_deg\n1,2,3,4,5,6,7\n", "column 'q1_deg' occurs 2 times"),
        ("q1_rad,x_mm\n1,2\n", "neither all joint columns"),
    ],
)
def test_faults_of_target_files_are_named(qiao, tmp_path, text, complaint):
    path = tmp_path / "t.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=complaint):
        read_targets(path, qiao.nominal)
    with pytest.raises(InputError, match="does not exist"):
        read_targets(tmp_path / "missing.csv", qiao.nominal)


def test_a_test_pose_out_of_reach_is_named_by_row(qiao, tmp_path):
    path = tmp_path / "t.csv"
    path.write_text("x_mm,y_mm,z_mm,rx_deg,ry_deg,rz_deg\n700,-750,400,0,0,0\n9000,0,0,0,0,0\n")
    with pytest.raises(InputError, match="row 3 is a pose that the arm cannot reach"):
        joints_of(read_targets(path, qiao.nominal), qiao.nominal)


@pytest.mark.parametrize("joint", [0, 3, 4])
def test_other_joints_take_over_from_one_at_its_limit(calibration, dynamic, joint):
    """Six joints for five directions: J1, J4 and J5 can be spared, so a target at their limits is still reached."""
    nominal = dynamic.arm.nominal
    joints = inner_joints(nominal, 60, 5)
    joints[:30, joint], joints[30:, joint] = nominal.lower[joint], nominal.upper[joint]
    found = apply_calibration(calibration, dynamic.arm, joint_targets(joints))
    assert found.reached.all() and (found.joints <= nominal.upper).all() and (found.joints >= nominal.lower).all()


def test_a_joint_at_its_limit_that_has_to_go_inwards_goes():
    """Encoders that are off: the corrected command is the target less what each joint is off by."""
    arm, rng = load_arm("ur5"), np.random.default_rng(0)
    nominal = arm.nominal
    off = rng.choice([-1, 1], 6) * rng.uniform(2e-3, 1e-2, 6)
    identified = replace(nominal, theta=nominal.theta + off)
    joints = inner_joints(nominal, 400, 2)
    joint = np.arange(400) % 6
    joints[np.arange(400), joint] = np.where(off > 0, nominal.upper, nominal.lower)[joint]
    strengths = np.linalg.svd(joint_jacobian(nominal, joints), compute_uv=False)
    joints = joints[strengths[:, -1] > 0.03 * strengths[:, 0]]
    known = Calibration(arm.name, nominal, nominal, ArmModel.of(identified), None, {})
    found = apply_calibration(known, arm, joint_targets(joints))
    assert len(joints) > 100
    np.testing.assert_allclose(found.joints, joints - off, atol=1e-6)


def test_the_table_says_errors_and_uncertainties_in_mm_and_degrees(calibration, dynamic):
    found = apply_calibration(calibration, dynamic.arm, joint_targets(inner_joints(dynamic.arm.nominal, 15, 4)))
    table = dict(zip(found.table()[0], found.table()[1].T, strict=True))
    parts = {"uncorrected": found.before, "predicted": found.remaining, "noncompensable": found.impossible}
    for name, error in parts.items():
        for unit, factor, columns in (("mm", 1e3, [0, 1, 2]), ("deg", 180 / np.pi, [3, 4, 5])):
            expected = factor * np.sqrt((error[:, columns] ** 2).sum(axis=1))
            np.testing.assert_allclose(table[f"{name}_error_{unit}"].astype(float), expected, rtol=1e-9)
    np.testing.assert_allclose(table["uncertainty_mm"].astype(float), 1e3 * found.uncertainty[0])
    np.testing.assert_allclose(table["uncertainty_deg"].astype(float), np.rad2deg(found.uncertainty[1]))
    position, attitude = found.within95
    np.testing.assert_allclose(table["within95_mm"].astype(float), 1e3 * position)
    np.testing.assert_allclose(table["within95_deg"].astype(float), np.rad2deg(attitude))


def test_what_the_learnt_residual_explains_is_no_uncertainty(dynamic):
    rng = np.random.default_rng(0)
    sets = [simulated_tracker(dynamic, random_joints(dynamic.arm.nominal, n, rng), rng) for n in (100, 200, 60)]
    found = fit(dynamic.arm, *sets[:2], known_frames=True, residual="rbf", rng=rng)
    learnt, plain = (c.errors(sets[2]) for c in (found.calibration, found.calibration.without_residual()))
    np.testing.assert_allclose(plain - learnt, found.calibration.learnt.predict(sets[2].joints), atol=1e-15)
    kept = assess(dynamic.arm, found, sets[0], sets[2]).calibration.record["uncertainty"]
    assert kept["position_repeat_m"] == pytest.approx(np.sqrt(np.mean(learnt[:, :3] ** 2)))
    assert kept["position_repeat_m"] < 0.6 * np.sqrt(np.mean(plain[:, :3] ** 2))


def test_targets_of_an_arm_of_five_joints_are_met_in_position_first():
    """Links off in every direction: the attitude cannot be had too, and what is left of it counts as reached."""
    arm, rng = load_arm("so101"), np.random.default_rng(3)
    nominal = arm.nominal
    sizes = np.concatenate([np.repeat([np.radians(0.6), 0.3e-3, np.radians(0.6), 0.3e-3, 0.0], 5), np.zeros(12)])
    identified = nominal.displaced(sizes * rng.normal(size=len(sizes)))
    span = nominal.upper - nominal.lower
    joints = rng.uniform(nominal.lower + 0.2 * span, nominal.upper - 0.2 * span, (50, 5))
    wanted = forward(nominal, joints)
    known = Calibration(arm.name, nominal, nominal, ArmModel.of(identified), None, {})
    commands = apply_calibration(known, arm, joint_targets(joints)).joints
    error = pose_error(wanted, forward(identified, commands))
    before = pose_error(wanted, forward(identified, joints))
    left, raw = (np.median(np.linalg.norm(part[:, :3], axis=1)) for part in (error, before))
    assert left < 0.1 * raw


@pytest.mark.parametrize("interval", [[0.4, 2.75], None])
def test_a_fitted_base_is_said_to_leave_the_controllers_frame_open(elsewhere, calibration, dynamic, interval):
    """The uncertainty of some micrometres holds from the fitted base; that of the robot is not known so well."""
    joints = inner_joints(dynamic.arm.nominal, 2, 0)
    record = elsewhere.record | {"base_frame": {"mean_ci95_mm": interval}}
    found = apply_calibration(replace(elsewhere, record=record), dynamic.arm, joint_targets(joints))
    size = "unknown" if interval is None else "0.400 to 2.75 mm"
    assert f"in the robot's own base frame the mean error is {size}" in found.report()
    poses = pose_targets(forward(elsewhere.nominal, joints))
    seen = apply_calibration(elsewhere, dynamic.arm, poses, frame="instrument")
    known = apply_calibration(calibration, dynamic.arm, joint_targets(joints))
    assert "base frame" not in seen.report() + known.report()
