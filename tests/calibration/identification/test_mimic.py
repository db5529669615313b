"""An arm with a two-stage lift and a parallelogram is calibrated by its drives, from URDF to commands."""

from dataclasses import replace

import numpy as np
import pytest

from pickenv.arm import (
    Load,
    chain_of,
    forward,
    frames,
    gravity_torques,
    joint_jacobian,
    load_arm,
    nominal_points,
    parameter_jacobian,
    pose_error,
    split_joints,
)
from pickenv.calibration import (
    Calibration,
    Compensator,
    Conditions,
    GravityTerm,
    Measurements,
    ThermalTerm,
    export,
    fit,
    random_joints,
    read_measurements,
)
from tests.calibration.loads import LoadedCompliance

URDF = """<robot name="lift_arm">
  <link name="floor"/><link name="mast"/><link name="stage1"/><link name="stage2"/><link name="upper"/>
  <link name="fore"/><link name="hand"/><link name="flange"/>
  <joint name="mast" type="revolute"><parent link="floor"/><child link="mast"/><origin xyz="0.1 0.2 0.3"/>
    <axis xyz="0 0 1"/><limit lower="-2.5" upper="2.5" velocity="1" effort="1"/></joint>
  <joint name="lift" type="prismatic"><parent link="mast"/><child link="stage1"/><origin xyz="0.05 0 0.2"/>
    <axis xyz="0 0 1"/><limit lower="0" upper="0.4" velocity="0.2" effort="1"/></joint>
  <joint name="lift_upper_stage" type="prismatic"><parent link="stage1"/><child link="stage2"/>
    <origin xyz="0.02 0 0.1"/><axis xyz="0 0 1"/><limit lower="0" upper="0.4" velocity="0.2" effort="1"/>
    <mimic joint="lift"/></joint>
  <joint name="shoulder" type="revolute"><parent link="stage2"/><child link="upper"/><origin xyz="0.1 0 0.1"/>
    <axis xyz="0 1 0"/><limit lower="-1.2" upper="1.2" velocity="1" effort="1"/></joint>
  <joint name="elbow" type="revolute"><parent link="upper"/><child link="fore"/><origin xyz="0.6 0.03 0"/>
    <axis xyz="0 1 0"/><limit lower="-2" upper="2" velocity="1" effort="1"/></joint>
  <joint name="level" type="revolute"><parent link="fore"/><child link="hand"/><origin xyz="0.5 0 0.02"/>
    <axis xyz="0 1 0"/><limit lower="-2" upper="2" velocity="1" effort="1"/>
    <mimic joint="shoulder" multiplier="-1" offset="0.2"/></joint>
  <joint name="roll" type="revolute"><parent link="hand"/><child link="flange"/><origin xyz="0.1 0 -0.1"/>
    <axis xyz="0 0 1"/><limit lower="-3" upper="3" velocity="1" effort="1"/></joint>
</robot>
"""
NOISE = 1e-5
"""m and rad."""


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    path = tmp_path_factory.mktemp("arm") / "lift_arm.urdf"
    path.write_text(URDF)
    return load_arm(path)


@pytest.fixture(scope="module")
def true(arm):
    """The arm as built: millimetres and milliradians off in every link."""
    size = np.where(arm.nominal.parameter_is_angle, 2e-3, 1e-3)
    return arm.nominal.displaced(np.random.default_rng(7).normal(size=len(size)) * size)


@pytest.fixture(scope="module")
def measure(true):
    def poses(count, seed):
        rng = np.random.default_rng(seed)
        joints = random_joints(true, count, rng)
        pose = forward(true, joints)
        return Measurements(
            joints, pose.position + rng.normal(size=(count, 3)) * NOISE, pose.rotation, prismatic=true.prismatic
        )

    return poses


@pytest.fixture(scope="module")
def calibrated(arm, measure, tmp_path_factory) -> Calibration:
    path = tmp_path_factory.mktemp("data") / "tracker.csv"
    measure(60, 0).write_csv(path)
    assert path.read_text().splitlines()[0].startswith("q1_deg,q2_mm,q3_deg,q4_deg,q5_deg,x_mm")
    return fit(arm, read_measurements(path, arm.nominal)).calibration


def test_seven_moving_links_are_five_joints(arm):
    assert arm.nominal.joint_names == ("mast", "lift", "shoulder", "elbow", "roll")
    assert arm.nominal.links == 6 and arm.nominal.coupling.ratio == (1.0, 2.0, 1.0, 1.0, -1.0, 1.0)
    assert arm.nominal.link_names[2] == "shoulder (1 of 2)" and arm.nominal.link_names[4] == "shoulder (2 of 2)"


def test_a_calibration_by_the_drives_leaves_noise_on_new_poses(calibrated, measure):
    fresh = measure(200, 1)
    nominal = forward(calibrated.nominal, fresh.joints).position - fresh.position
    left = forward(calibrated.identified, fresh.joints).position - fresh.position
    assert np.sqrt(np.mean(left**2)) < 1.5 * NOISE < 0.1 * np.sqrt(np.mean(nominal**2))


def test_its_file_commands_and_urdf_keep_the_coupling(calibrated, arm, true, measure, tmp_path):
    loaded = Calibration.load(calibrated.save(tmp_path / "arm.npz"), arm)
    assert loaded.identified.coupling == arm.nominal.coupling
    targets = random_joints(arm.nominal, 30, np.random.default_rng(2)) * 0.9
    compensate = Compensator(loaded.nominal, loaded.identified)
    wanted, jacobian = forward(loaded.nominal, targets), joint_jacobian(loaded.nominal, targets)
    removable = []  # the part of the true pose error that some joint motion would still remove, joint by joint
    weight = np.repeat([1.0, 0.05], 3) ** 2  # with five joints position goes first: a radian counts 50 mm
    for commands in (targets, compensate(targets)):
        error = pose_error(wanted, forward(true, commands))
        removable.append(np.linalg.norm(np.einsum("nij,i,ni->nj", jacobian, weight, error)))
    assert removable[1] < 0.03 * removable[0]
    np.testing.assert_allclose(compensate(targets[0]), compensate(targets)[0], atol=1e-9)
    fresh = random_joints(arm.nominal, 20, np.random.default_rng(3))
    files = (
        f"{export(loaded, tmp_path / 'back.urdf', arm=arm).path}#tool",
        export(loaded, tmp_path / "b.toml", arm=arm).path,
    )
    standing = replace(
        loaded.identified, base=arm.nominal.base, tool=arm.nominal.tool
    )  # frames were fitted: no robot's
    for back, same in zip(map(load_arm, files), (standing, loaded.identified), strict=True):
        assert back.nominal.joint_names == arm.nominal.joint_names and back.nominal.links == arm.nominal.links
        np.testing.assert_allclose(back.nominal.lower, arm.nominal.lower)
        np.testing.assert_allclose(back.speed, arm.speed)
        np.testing.assert_allclose(pose_error(forward(back.nominal, fresh), forward(same, fresh)), 0, atol=1e-9)


def test_weight_bends_a_coupled_arm_as_its_drives_feel_it(arm):
    """The gravity term's columns hold what masses and stiffnesses of the drives do, exactly."""
    geometry, rng = arm.nominal, np.random.default_rng(4)
    joints = random_joints(geometry, 300, rng)
    load = Load(tuple(rng.uniform(1, 5, 6)), tuple(map(tuple, rng.uniform(-0.2, 0.2, (6, 3)))), 0.0)
    compliance = LoadedCompliance(tuple(range(5)), load=load)
    chain = chain_of(geometry)
    by_link = gravity_torques(chain, frames(np, chain, split_joints(5, joints)), load)
    by_link = np.stack(np.broadcast_arrays(*by_link, joints[:, 0])[:-1], -1)
    torque = compliance.torques(geometry, joints, Conditions())
    np.testing.assert_allclose(torque[:, 1], 2.0 * by_link[:, 1])
    np.testing.assert_allclose(torque[:, 2], by_link[:, 2] - by_link[:, 4])
    yielded = np.einsum("nij,nj->ni", joint_jacobian(geometry, joints), torque * rng.uniform(1e-6, 1e-5, 5))
    up = tuple(geometry.base.rotation.T @ np.array([0.0, 0.0, 1.0]))
    columns = GravityTerm(tuple(range(5)), up).columns(geometry, joints, Conditions())
    columns = columns.reshape(-1, columns.shape[-1])
    found = np.linalg.lstsq(columns, yielded.ravel(), rcond=None)[0]
    np.testing.assert_allclose(columns @ found, yielded.ravel(), atol=1e-9 * np.abs(yielded).max())


def test_heat_knows_the_links(arm):
    geometry = arm.nominal
    joints = random_joints(geometry, 20, np.random.default_rng(5))
    grown = ThermalTerm().columns(geometry, joints, Conditions(temperature=np.full(20, 10.0)))[..., 0]
    step, n = 1e-7, geometry.links
    for row, q in enumerate(joints):
        delta = np.zeros(5 * n + 12)
        moved = np.array(geometry.coupling.displacements(q)) * np.array(geometry.slides)
        delta[n : 2 * n], delta[3 * n : 4 * n] = geometry.a, geometry.d + moved
        shift = forward(geometry.displaced(10.0 * step * delta), q).position - forward(geometry, q).position
        np.testing.assert_allclose(grown[row, :3], shift / step, rtol=1e-5, atol=1e-6)


def test_a_wandering_zero_moves_every_link_of_its_joint(arm):
    geometry = arm.nominal
    joints = random_joints(geometry, 60, np.random.default_rng(6))
    shift = np.zeros(len(geometry.parameter_names))
    for link, ratio in geometry.links_of(2):
        shift[2 * geometry.links + link] = ratio
    by_parameters = parameter_jacobian(geometry, joints) @ shift
    np.testing.assert_allclose(by_parameters, joint_jacobian(geometry, joints)[..., 2], atol=1e-12)


def test_a_drawn_arm_ends_at_its_tool(arm):
    joints = random_joints(arm.nominal, 5, np.random.default_rng(8))
    points = nominal_points(arm.nominal, joints)
    assert points.shape == (5, 2 * arm.nominal.links + 2, 3)
    np.testing.assert_allclose(points[:, -1], forward(arm.nominal, joints).position, atol=1e-12)
