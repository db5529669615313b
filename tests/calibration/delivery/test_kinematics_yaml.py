"""Universal Robots' kinematics file: out, in place, and back in; the xacro that reads it needs no change."""

import math
from dataclasses import replace

import numpy as np
import pytest
import yaml
from hypothesis import given, settings, strategies as st
from scipy.spatial.transform import Rotation

from pickenv.arm import forward, load_arm
from pickenv.base import InputError
from pickenv.calibration import export, random_joints

LINKS = ("shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3")
DEFAULT = """# of a UR5, as the controller has it
kinematics:
  shoulder:
    x: 0
    y: 0
    z: 0.089159   # d1
    roll: -0
    pitch: 0
    yaw: -0
  upper_arm: {x: 0, y: 0, z: 0, roll: 1.570796327, pitch: 0, yaw: 0}
  forearm:
    x: -0.425
    y: 0
    z: 0
    roll: -0
    pitch: 0
    yaw: -0
  wrist_1:
    x: -0.39225
    y: 0
    z: 0.10915
    roll: -0
    pitch: 0
    yaw: -0
  wrist_2:
    x: 0
    y: -0.09465
    z: -1.9413039500811915e-11
    roll: 1.570796327
    pitch: 0
    yaw: -0
  wrist_3:
    x: 0
    y: 0.0823
    z: -1.688001216681175e-11
    roll: 1.5707963265897931
    pitch: 3.1415926535897931
    yaw: 3.1415926535897931
  hash: calib_12788084448423163542
"""
XACRO = """<robot name="ur" xmlns:xacro="http://www.ros.org/wiki/xacro">
  <xacro:arg name="file" default=""/>
  <xacro:property name="all" value="${xacro.load_yaml('$(arg file)')['kinematics']}"/>
  <link name="base"/>
  <xacro:macro name="step" params="parent link name">
    <xacro:property name="k" value="${all[link]}"/>
    <link name="${link}"/>
    <joint name="${name}" type="revolute"><parent link="${parent}"/><child link="${link}"/>
      <origin xyz="${k['x']} ${k['y']} ${k['z']}" rpy="${k['roll']} ${k['pitch']} ${k['yaw']}"/>
      <axis xyz="0 0 1"/><limit lower="-3" upper="3" velocity="1" effort="1"/></joint>
  </xacro:macro>
  <xacro:step parent="base" link="shoulder" name="J1"/>
  <xacro:step parent="shoulder" link="upper_arm" name="J2"/>
  <xacro:step parent="upper_arm" link="forearm" name="J3"/>
  <xacro:step parent="forearm" link="wrist_1" name="J4"/>
  <xacro:step parent="wrist_1" link="wrist_2" name="J5"/>
  <xacro:step parent="wrist_2" link="wrist_3" name="J6"/>
</robot>
"""


@pytest.fixture
def default(tmp_path):
    path = tmp_path / "default_kinematics.yaml"
    path.write_text(DEFAULT)
    return path


def last_frames(path, joints: np.ndarray) -> np.ndarray:
    """Frames of the last link by the file's own numbers, as 4 x 4 matrices: each origin, then a turn about z."""
    content = yaml.safe_load(path.read_text())["kinematics"]
    frames = np.broadcast_to(np.eye(4), (len(joints), 4, 4)).copy()
    for i, link in enumerate(LINKS):
        step, turn = np.eye(4), np.broadcast_to(np.eye(4), frames.shape).copy()
        numbers = content[link]
        step[:3, 3] = [numbers[key] for key in "xyz"]
        step[:3, :3] = Rotation.from_euler("xyz", [numbers[key] for key in ("roll", "pitch", "yaw")]).as_matrix()
        turn[:, :3, :3] = Rotation.from_euler("z", joints[:, i : i + 1]).as_matrix()
        frames = frames @ step @ turn
    return frames


def hand_of(frames: np.ndarray, geometry, joints: np.ndarray) -> np.ndarray:
    """The tool in those frames; constant where they are the arm's own."""
    pose, tool = forward(replace(geometry, base=load_arm("ur5").nominal.base), joints), np.zeros(frames.shape)
    tool[:, :3, :3], tool[:, :3, 3], tool[:, 3, 3] = pose.rotation, pose.position, 1.0
    return np.linalg.solve(frames, tool)


@given(seed=st.integers(0, 2**32 - 1), name=st.sampled_from(["ur5", "ur10", "ur5e", "ur10e"]))
@settings(max_examples=20)
def test_a_new_file_holds_the_corrected_links_and_is_read_back(tmp_path_factory, made, seed, name):
    folder, rng, arm = tmp_path_factory.mktemp("ur"), np.random.default_rng(seed), load_arm(name)
    calibration = made(arm, rng)
    out = export(calibration, folder / "ur.yaml", kind="kinematics-yaml").path
    joints = random_joints(arm.nominal, 20, rng)
    wanted = forward(calibration.identified, joints)
    hands = hand_of(last_frames(out, joints), calibration.identified, joints)
    np.testing.assert_allclose(hands, np.broadcast_to(hands[0], hands.shape), atol=1e-9)
    again = forward(load_arm(out).nominal, joints)
    rotation = np.einsum("nji,njk->nik", again.rotation, wanted.rotation)
    np.testing.assert_allclose(rotation, np.broadcast_to(rotation[0], rotation.shape), atol=1e-9)
    content = yaml.safe_load(out.read_text())["kinematics"]
    assert all(isinstance(number, float) for link in LINKS for number in content[link].values())


def test_the_robots_own_file_keeps_its_other_lines_and_its_hash(default, made, tmp_path):
    rng, arm = np.random.default_rng(40), load_arm("ur5")
    calibration = made(arm, rng, "fitted")
    done = export(calibration, tmp_path / "mine.yaml", onto=default)
    old, new = DEFAULT.splitlines(), done.path.read_text().splitlines()
    assert len(old) == len(new)
    for before, after in zip(old, new, strict=True):
        assert before == after or (before.split(":")[0] == after.split(":")[0] and before.strip()[0] in "xyzrpu")
    assert new[0] == old[0] and new[-1] == old[-1] and new[5].endswith("   # d1")
    assert any("hash is the robot's own" in note for note in done.notes)
    joints = random_joints(arm.nominal, 200, rng)
    hands = hand_of(last_frames(done.path, joints), calibration.identified, joints)
    np.testing.assert_allclose(hands, np.broadcast_to(hands[0], hands.shape), atol=1e-9)
    told = hand_of(last_frames(default, joints), calibration.identified, joints)
    assert np.abs(told - told[0]).max() > 1e-3


def test_a_xacro_makes_the_corrected_arm_of_it(default, made, tmp_path):
    xacro = pytest.importorskip("xacro", reason="xacro is the referee: pip install xacro")
    rng, arm = np.random.default_rng(41), load_arm("ur5")
    calibration = made(arm, rng)
    out = export(calibration, tmp_path / "mine.yaml", onto=default).path
    source = tmp_path / "ur.urdf.xacro"
    source.write_text(XACRO)
    made_of_it = tmp_path / "ur.urdf"
    made_of_it.write_text(xacro.process_file(str(source), mappings={"file": str(out)}).toxml())
    joints = random_joints(arm.nominal, 50, rng)
    told = forward(load_arm(f"{made_of_it}#wrist_3").nominal, joints)
    frames = last_frames(out, joints)
    np.testing.assert_allclose(told.position, frames[:, :3, 3], atol=1e-12)
    np.testing.assert_allclose(told.rotation, frames[:, :3, :3], atol=1e-12)


def test_the_file_of_another_type_is_refused(default, made, tmp_path):
    for name in ("ur10", "ur5e"):
        with pytest.raises(InputError, match=f"default_kinematics.yaml is of another arm than '{name}': .* lies .* mm"):
            export(made(load_arm(name), np.random.default_rng(0)), tmp_path / "out.yaml", onto=default)
    ur5 = load_arm("ur5")
    moved, turned = ur5.nominal.a.copy(), ur5.nominal.alpha.copy()
    moved[1], turned[1] = 1e-3, 1.6
    others = [replace(ur5, nominal=replace(ur5.nominal, **part)) for part in ({"a": moved}, {"alpha": turned})]
    for other in (load_arm("panda"), load_arm("so101"), *others):
        with pytest.raises(InputError, match="has not the frames of a UR"):
            export(made(other, np.random.default_rng(0)), tmp_path / "out.yaml", kind="kinematics-yaml")


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("kinematics:", "dynamics:", "has no 'kinematics'"),
        ("    z: 0.089159   # d1\n", "", "'shoulder' of kinematics lacks"),
    ],
)
def test_a_broken_file_is_one_sentence(default, made, tmp_path, old, new, said):
    default.write_text(DEFAULT.replace(old, new))
    with pytest.raises(InputError, match=said):
        export(made(load_arm("ur5"), np.random.default_rng(0)), tmp_path / "out.yaml", onto=default)


def test_a_xacro_itself_is_told_where_its_numbers_come_from(made, tmp_path):
    (tmp_path / "ur.urdf.xacro").write_text(XACRO)
    with pytest.raises(InputError, match="is a xacro, which takes its numbers from elsewhere"):
        export(made(load_arm("ur5"), np.random.default_rng(0)), tmp_path / "o", onto=tmp_path / "ur.urdf.xacro")


@given(st.floats(-1e3, 1e3, allow_nan=False))
def test_every_number_is_a_number_to_yaml_1_1(value):
    from pickenv.calibration.delivery.onto_files import yaml_number

    text = yaml_number(value)
    assert yaml.safe_load(text) == value and math.copysign(1, float(text)) == math.copysign(1, value)
