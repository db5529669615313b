"""Whole robots: a pose between any two links, its derivatives, and what is refused."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pickenv.arm import (
    Array,
    Geometry,
    Pose,
    forward,
    identity_pose,
    joint_jacobian,
    load_arm,
    parameter_jacobian,
    pose_error,
    write_urdf,
)
from pickenv.base import InputError
from tests.calibration.whole_robots import Robot, apart, drawn_robot, matrix

TIPS = ("left_tip", "right_tip", "head_tip", "torso1")
STEP = 1e-6


@pytest.fixture(scope="module")
def robot() -> Robot:
    return drawn_robot(np.random.default_rng(5))


@pytest.fixture(scope="module")
def tree(robot: Robot, tmp_path_factory: pytest.TempPathFactory) -> Geometry:
    path = tmp_path_factory.mktemp("robot") / "robot.urdf"
    path.write_text(robot.urdf(), encoding="utf-8")
    return load_arm(f"{path}#{','.join(TIPS)}", whole=True).nominal


def motion(geometry: Geometry, joints: Array) -> Array:
    """Poses ``(N, 4, 4)`` of the target's link against the sensor's."""
    bare = replace(geometry, base=identity_pose(), tool=identity_pose())
    return np.stack([matrix(*pose) for pose in zip(*forward(bare, joints), strict=True)])


def ends(tree: Geometry) -> list[tuple[int, int, str, str]]:
    assert tree.tree is not None
    places = [(-1, "base"), *zip(tree.tree.carriers, TIPS, strict=True)]
    return [(i, j, one, other) for i, one in places for j, other in places if i != j]


def test_a_pose_between_any_two_links_is_that_of_the_urdf(robot: Robot, tree: Geometry) -> None:
    joints = np.random.default_rng(1).uniform(-1.2, 1.2, (8, tree.joints))
    poses = [robot.poses(dict(zip(tree.joint_names, row, strict=True))) for row in joints]
    for sensor, target, one, other in ends(tree):
        expected = np.stack([np.linalg.inv(pose[one]) @ pose[other] for pose in poses])
        assert apart(motion(tree.between(sensor, target), joints), expected) < 1e-12, (one, other)


def test_mujoco_moves_the_links_alike(robot: Robot, tree: Geometry) -> None:
    mujoco = pytest.importorskip("mujoco")
    text = robot.urdf().replace(
        '<link name="base"/>', '<mujoco><compiler fusestatic="false"/></mujoco><link name="base"/>', 1
    )
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    joints = np.random.default_rng(2).uniform(-1.2, 1.2, (8, tree.joints))
    seen: dict[str, list[Array]] = {tip: [] for tip in TIPS}
    for row in joints:
        for name, value in zip(tree.joint_names, row, strict=True):
            data.joint(name).qpos = value
        mujoco.mj_kinematics(model, data)
        for tip in TIPS:
            seen[tip].append(matrix(data.body(tip).xpos, data.body(tip).xmat.reshape(3, 3)))
    for sensor, target, one, other in ends(tree):
        if "base" in (one, other):
            continue
        expected = np.linalg.inv(np.stack(seen[one])) @ np.stack(seen[other])
        assert apart(motion(tree.between(sensor, target), joints), expected) < 1e-9, (one, other)


def test_derivatives_are_the_slopes_of_the_pose(tree: Geometry) -> None:
    rng = np.random.default_rng(3)
    joints = rng.uniform(-1.2, 1.2, tree.joints)
    for sensor, target, *names in ends(tree):
        base, tool = (Pose(rng.normal(size=3), Rotation.random(random_state=rng).as_matrix()) for _ in range(2))
        geometry = replace(tree.between(sensor, target), base=base, tool=tool)

        def slope(step: Array, of: Geometry = geometry) -> Array:
            before, after = (of.displaced(sign * STEP * step) for sign in (-1.0, 1.0))
            return pose_error(forward(before, joints), forward(after, joints)) / (2 * STEP)

        expected = np.stack([slope(step) for step in np.eye(len(geometry.parameter_names))], axis=1)
        assert np.allclose(parameter_jacobian(geometry, joints), expected, atol=2e-8), names
        moved = [
            pose_error(forward(geometry, joints - STEP * step), forward(geometry, joints + STEP * step)) / (2 * STEP)
            for step in np.eye(tree.joints)
        ]
        assert np.allclose(joint_jacobian(geometry, joints), np.stack(moved, axis=1), atol=2e-8), names


def test_a_robot_of_one_branch_is_its_chain(tree: Geometry, tmp_path: Path) -> None:
    arm = load_arm("ur5e")
    path = write_urdf(arm.nominal, tmp_path / "arm.urdf")
    joints = np.random.default_rng(4).uniform(-2.0, 2.0, (6, 6))
    whole = load_arm(f"{path}#tool,link2", whole=True).nominal
    assert whole.tree is not None
    assert whole.tree.carriers == (5, 1)
    one, other = forward(whole.between(-1, 5), joints), forward(load_arm(f"{path}#tool").nominal, joints)
    np.testing.assert_array_equal(one.position, other.position)
    np.testing.assert_array_equal(one.rotation, other.rotation)


def test_a_whole_robot_is_refused_where_one_arm_is_meant(tmp_path: Path) -> None:
    path = tmp_path / "robot.urdf"
    path.write_text(drawn_robot(np.random.default_rng(0)).urdf(), encoding="utf-8")
    with pytest.raises(InputError, match="names several links, as `calibrate` takes a whole robot; name one here"):
        load_arm(f"{path}#left_tip,right_tip")
    with pytest.raises(InputError, match="no chain of joints leads from link 'root' to link 'tail'"):
        load_arm(f"{path}#left_tip,tail", whole=True)
    with pytest.raises(InputError, match="names no 'a,b'"):
        load_arm(f"{tmp_path / 'robot.yaml'}#a,b", whole=True)
