"""The judge of a calibration against a true arm: what it forgives, what it counts, and what it holds to be stated."""

import json
import re
import subprocess
import sys
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pickenv.arm import Pose, forward, load_arm
from pickenv.calibration import ArmModel, Calibration, random_joints

ROOT = Path(__file__).parents[2]
SCRIPT = ROOT / "scripts/benchmark_never_worse.py"
sys.path.insert(0, str(ROOT / "scripts"))

from never_worse.cases import Row, dh_geometry, least_squares  # noqa: E402
from never_worse.judge import (  # noqa: E402
    POINTS,
    aligned_errors,
    alignment_columns,
    calibrated_flange,
    chain_of_origins,
    covered,
    flange_of,
    regions,
    rms,
    stated_radii,
)

UR10E = load_arm("ur10e")
JOINTS = random_joints(UR10E.nominal, 60, np.random.default_rng(0))
DEFAULT_KINEMATICS = """
kinematics:
  shoulder: {x: 0, y: 0, z: 0.1807, roll: 0, pitch: 0, yaw: 0}
  upper_arm: {x: 0, y: 0, z: 0, roll: 1.570796326794897, pitch: 0, yaw: 0}
  forearm: {x: -0.6127, y: 0, z: 0, roll: 0, pitch: 0, yaw: 0}
  wrist_1: {x: -0.57155, y: 0, z: 0.17415, roll: 0, pitch: 0, yaw: 0}
  wrist_2: {x: 0, y: -0.11985, z: 0, roll: 1.570796326794897, pitch: 0, yaw: 0}
  wrist_3: {x: 0, y: 0.11655, z: 0, roll: 1.570796326794897, pitch: 3.141592653589793, yaw: 3.141592653589793}
"""
"""config/ur10e/default_kinematics.yaml of ur_description."""


def displaced(**changes: float) -> np.ndarray:
    """Errors of the UR10e's parameters, of which some are not zero."""
    delta = np.zeros(len(UR10E.nominal.parameter_names))
    for name, change in changes.items():
        delta[UR10E.nominal.parameter_names.index(name)] = change
    return delta


def calibration_of(geometry, names=(), covariance=()) -> Calibration:
    """A calibration with a covariance of its parameters."""
    uncertainty = {
        "parameters": list(names),
        "covariance": np.asarray(covariance).tolist(),
        "position_repeat_m": 0.0,
        "attitude_repeat_rad": None,
    }
    record = {"uncertainty": uncertainty} if names else {}
    return Calibration("ur10e", UR10E.nominal, UR10E.nominal, ArmModel(geometry), None, record)


def test_the_makers_default_file_is_the_drawing(tmp_path):
    (tmp_path / "default_kinematics.yaml").write_text(DEFAULT_KINEMATICS)
    truth, drawing = chain_of_origins(tmp_path / "default_kinematics.yaml")(JOINTS), forward(UR10E.nominal, JOINTS)
    np.testing.assert_allclose(truth.position, drawing.position, atol=1e-9)
    np.testing.assert_allclose(truth.rotation, drawing.rotation, atol=1e-9)


def test_a_perfect_arm_misses_by_nothing():
    flange = flange_of(UR10E.nominal)
    assert rms(aligned_errors(flange, flange, JOINTS)) == 0.0


def test_twelve_freedoms_are_nobodys_error():
    """Base and tool anywhere, and with them the zeros of the first and the last joint: nothing is left."""
    assert np.linalg.matrix_rank(alignment_columns(flange_of(UR10E.nominal)(JOINTS))) == 12
    other = UR10E.nominal.displaced(displaced(theta1=0.3, theta6=-0.2, d1=0.1, d6=-0.05, alpha0=0.4, a0=0.2))
    errors = aligned_errors(flange_of(UR10E.nominal), flange_of(other), JOINTS)
    assert rms(errors) < 1e-12


def test_what_base_and_tool_cannot_say_is_counted_whole():
    """The same joints twice, 1 mm to one side and 1 mm to the other: no base and no tool helps, and 1 mm is left."""
    twice = np.concatenate([JOINTS, JOINTS])
    aside = np.repeat([1e-3, -1e-3], len(JOINTS))[:, None] * [0.0, 0.6, 0.8]

    def truth(joints):
        pose = forward(UR10E.nominal, joints)
        return Pose(pose.position + aside, pose.rotation)

    assert rms(aligned_errors(forward_of(UR10E.nominal), truth, twice)) == pytest.approx(1e-3, rel=1e-9)


def forward_of(geometry):
    return lambda joints: forward(geometry, joints)


def test_alignment_is_the_least_that_least_squares_can_leave():
    """Against all of scipy's freedom: twelve numbers, the same points, a numerical Jacobian."""
    from scipy.optimize import least_squares as solve

    truth, flange = UR10E.nominal.displaced(displaced(a2=1e-3, alpha2=3e-3, d5=-1e-3)), flange_of(UR10E.nominal)
    target, pose = flange_of(truth)(JOINTS), flange(JOINTS)
    points = target.position[:, None] + POINTS @ np.swapaxes(target.rotation, 1, 2)

    def left(x):
        base, tool = Rotation.from_rotvec(x[3:6]).as_matrix(), Rotation.from_rotvec(x[9:]).as_matrix()
        placed = pose.position[:, None] + (POINTS @ tool.T + x[6:9]) @ np.swapaxes(pose.rotation, 1, 2)
        return (placed @ base.T + x[:3] - points).ravel()

    best = np.sqrt(2.0 * solve(left, np.zeros(12), xtol=1e-14, ftol=1e-14, gtol=1e-14).cost / (3 * len(JOINTS)))
    assert rms(aligned_errors(flange, flange_of(truth), JOINTS)) == pytest.approx(best, rel=1e-6)
    assert best > 3e-4


def test_base_and_tool_that_a_calibration_found_are_taken_off():
    moved = UR10E.nominal.displaced(displaced(base_x=1.0, base_rz=2.0, tool_y=0.3, tool_rx=-1.0))
    flange, bare = calibrated_flange(calibration_of(moved))(JOINTS), flange_of(UR10E.nominal)(JOINTS)
    np.testing.assert_allclose(flange.position, bare.position, atol=1e-12)
    np.testing.assert_allclose(flange.rotation, bare.rotation, atol=1e-12)


def test_errors_drawn_from_the_stated_covariance_are_within_its_95_percent():
    """200 true arms of one covariance, base and tool in it and with frames anywhere: 93 to 97 of 100 are covered."""
    rng = np.random.default_rng(1)
    names = ("a2", "a3", "alpha2", "alpha3", "theta3", "theta5", "base_x", "tool_rx", "d4")
    columns = [UR10E.nominal.parameter_names.index(name) for name in names]
    root = rng.normal(size=(9, 9)) * np.where(UR10E.nominal.parameter_is_angle[columns], 5e-4, 5e-4)[:, None]
    start = UR10E.nominal.displaced(displaced(base_y=0.4, base_rx=0.7, tool_z=0.2, tool_ry=0.5))
    calibration = calibration_of(start, names, root @ root.T)
    shares = []
    for _ in range(200):
        delta = displaced()
        delta[columns] = root @ rng.normal(size=9)
        shares.append(covered(calibration, flange_of(start.displaced(delta)), JOINTS))
    assert np.mean(shares) == pytest.approx(0.95, abs=0.02)


def test_what_frames_alone_may_be_off_by_counts_for_nothing():
    names, covariance = ("base_x", "base_rz", "tool_y"), np.diag([1e-4, 1e-4, 1e-4])
    assert np.max(stated_radii(calibration_of(UR10E.nominal, names, covariance), JOINTS)) < 1e-9
    assert stated_radii(calibration_of(UR10E.nominal), JOINTS) is None


def test_regions_grow_from_the_measured_poses_outwards():
    lower, upper = np.full(6, -np.pi), np.full(6, np.pi)
    measured = np.random.default_rng(0).uniform(-0.5, 0.5, (23, 6))
    where = regions(measured, lower, upper, seed=3)
    assert [len(joints) for joints in where.values()] == [23, 400, 400, 400]
    assert np.abs(where["box of ranges"]).max() <= 0.5 < np.abs(where["all joints"]).max() <= np.pi
    again = regions(measured, lower, upper, seed=3)
    assert all((where[name] == again[name]).all() for name in where)


def test_least_squares_finds_the_arm_where_rows_suffice():
    from pickenv.calibration import Measurements

    true = UR10E.nominal.displaced(displaced(a2=1e-3, alpha3=2e-3, theta2=3e-3, base_x=2e-3, tool_z=1e-3))
    pose = forward(true, JOINTS)
    rows = Measurements(JOINTS, pose.position, None, UR10E.nominal.prismatic)
    assert rms(rows.difference(least_squares(UR10E.nominal, rows))) < 1e-9


def test_the_generators_table_is_our_geometry():
    kinematics = pytest.importorskip("kinhec.kinematics", reason="pip install kinhec")
    from kinhec.robots import get_robot

    for name in ("ur5e", "iiwa7"):
        robot = get_robot(name)
        true = replace(robot, a=list(np.array(robot.a) + 1e-3), theta_offset=list(np.full(robot.dof, 0.01)))
        geometry = dh_geometry(robot, a=true.a, theta_offset=true.theta_offset)
        joints = np.random.default_rng(0).uniform(-1.0, 1.0, (5, robot.dof))
        theirs, ours = kinematics.forward_kinematics_batch(true, joints), forward(geometry, joints)
        np.testing.assert_allclose(ours.position, theirs[:, :3, 3], atol=1e-12)
        np.testing.assert_allclose(ours.rotation, theirs[:, :3, :3], atol=1e-12)


def test_a_row_says_whether_it_meets_its_bound():
    row = Row("arm", "here", 0.9, 1.0, at_most=0.8)
    assert (row.meets, row.worse) == (False, False)
    assert replace(row, calibrated=0.8).meets and replace(row, calibrated=1.1).worse
    assert replace(row, at_most=None).meets is None
    assert not replace(row, calibrated=float("nan")).meets
    sure = replace(row, at_most=1.0, within95=0.95, share=(0.9, 0.98))
    assert sure.meets and not replace(sure, within95=1.0).meets and not replace(sure, within95=None).meets
    assert json.loads(json.dumps(asdict(row) | {"meets": row.meets}))["meets"] is False


def test_a_case_that_is_none_is_refused_by_name():
    done = subprocess.run([sys.executable, SCRIPT, "--only", "ur11"], capture_output=True, text=True)
    assert done.returncode == 2
    assert "there is no case 'ur11'; give ur10e, kinhec" in done.stderr


def test_both_pages_print_the_same_of_the_real_camera():
    """One command makes both numbers."""
    results, board = (
        (ROOT / f"docs/{page}.md").read_text(encoding="utf-8")
        for page in ("results", "tutorials/calibrate-with-a-printed-board")
    )
    (row,) = re.findall(r"^\| `ur10e`: 23 pictures \| all joints \| ([^|]+) \| +\| ([^|]+) \|$", results, re.M)
    assert row == tuple(re.findall(r"^\| (?:nominal|calibrated) \| .* \| ([^|]+) \|$", board, re.M))
