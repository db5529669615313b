"""URDF and joint axes: any serial chain in, the same kinematics out, refereed by MuJoCo's own reader."""

import re
import xml.etree.ElementTree as ElementTree
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from pickenv.arm import (
    Geometry,
    Pose,
    forward,
    geometry_from_axes,
    load_arm,
    load_urdf,
    pose_error,
    rotation_matrix,
    urdf_text,
    write_urdf,
)
from pickenv.base import InputError
from pickenv.calibration import complete_model

FOREIGN = """<?xml version="1.0"?>
<robot name="foreign">
  <link name="floor"/><link name="pillar"/><link name="l1"/><link name="l2"/><link name="l3"/><link name="l4"/>
  <link name="flange"/><link name="camera"/>
  <joint name="mount" type="fixed"><parent link="floor"/><child link="pillar"/>
    <origin xyz="0.1 -0.2 0.7" rpy="0.1 0.2 -0.4"/></joint>
  <joint name="turn" type="continuous"><parent link="pillar"/><child link="l1"/><axis xyz="0 1 0"/></joint>
  <joint name="lift" type="prismatic"><parent link="l1"/><child link="l2"/><origin xyz="0.3 0 0" rpy="0 0.5 0"/>
    <axis xyz="0 0 2"/><limit lower="-0.1" upper="0.4" velocity="0.2" effort="1"/></joint>
  <joint name="swing" type="revolute"><parent link="l2"/><child link="l3"/><origin xyz="0 0 0.25" rpy="1.57 0 0.3"/>
    <axis xyz="-1 0 0"/><limit lower="-2" upper="2" velocity="1" effort="1"/></joint>
  <joint name="roll" type="revolute"><parent link="l3"/><child link="l4"/><origin xyz="0.05 0.4 0"/>
    <axis xyz="0.6 0 0.8"/><limit lower="-3" upper="3" velocity="1" effort="1"/></joint>
  <joint name="wrist" type="fixed"><parent link="l4"/><child link="flange"/>
    <origin xyz="0 0.02 0.1" rpy="0 0 1"/></joint>
  <joint name="bracket" type="fixed"><parent link="pillar"/><child link="camera"/><origin xyz="1 1 1"/></joint>
</robot>
"""


def same(geometry: Geometry, other: Geometry, count: int = 200) -> None:
    q = np.random.default_rng(0).uniform(-1.5, 1.5, (count, geometry.joints))
    np.testing.assert_allclose(pose_error(forward(geometry, q), forward(other, q)), 0, atol=1e-12)


def mujoco_pose(text: str, tip: str, names: tuple[str, ...], q: np.ndarray) -> Pose:
    """Forward kinematics of a URDF's link by MuJoCo, with meshes stripped and masses made up."""
    mujoco = pytest.importorskip("mujoco")
    root = ElementTree.fromstring(text)
    for link in root.iter("link"):
        for child in list(link):
            link.remove(child)
    compiler = ElementTree.SubElement(ElementTree.SubElement(root, "mujoco"), "compiler")
    for key, value in {"fusestatic": "false", "boundmass": "1", "boundinertia": "1", "autolimits": "true"}.items():
        compiler.set(key, value)
    model = mujoco.MjModel.from_xml_string(ElementTree.tostring(root, encoding="unicode"))
    data = mujoco.MjData(model)
    body = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, tip)
    addresses = [model.joint(name).qposadr[0] for name in names]
    positions, rotations = [], []
    for row in q:
        data.qpos[:] = 0
        data.qpos[addresses] = row
        mujoco.mj_kinematics(model, data)
        positions.append(data.xpos[body].copy())
        rotations.append(data.xmat[body].reshape(3, 3).copy())
    return Pose(np.array(positions), np.array(rotations))


def test_a_foreign_chain_moves_as_in_mujoco(tmp_path):
    """Fixed, continuous, prismatic and revolute joints, axes not along z and not of unit length."""
    path = tmp_path / "foreign.urdf"
    path.write_text(FOREIGN)
    arm = load_arm(f"{path}#flange")
    assert arm.name == "foreign" and arm.nominal.joint_names == ("turn", "lift", "swing", "roll")
    assert arm.nominal.prismatic == (False, True, False, False)
    np.testing.assert_allclose(arm.nominal.lower, [-np.pi, -0.1, -2, -3])
    q = np.random.default_rng(1).uniform(arm.nominal.lower, arm.nominal.upper, (50, 4))
    expected = mujoco_pose(FOREIGN.replace("0 0 2", "0 0 1"), "flange", arm.nominal.joint_names, q)
    np.testing.assert_allclose(pose_error(forward(arm.nominal, q), expected), 0, atol=1e-9)


@pytest.mark.parametrize("name", ["panda", "iiwa14", "gen3lite", "vx300s"])
def test_real_arms_move_as_in_mujoco(data_folder, name):
    path = data_folder / "mukca_sockets" / "urdf" / f"{name}.urdf"
    if not path.is_file():
        pytest.skip(f"no {path}")
    arm = load_urdf(path)
    q = np.random.default_rng(2).uniform(arm.nominal.lower, arm.nominal.upper, (50, arm.nominal.joints))
    tip = arm.source.rpartition("tip ")[2]
    expected = mujoco_pose(path.read_text(), tip, arm.nominal.joint_names, q)
    np.testing.assert_allclose(pose_error(forward(arm.nominal, q), expected), 0, atol=1e-6)


@pytest.mark.parametrize("name", ["qiao2026", "ur5", "wam"])
def test_our_arms_survive_a_trip_through_urdf(tmp_path, name):
    nominal = load_arm(name).nominal
    there = replace(nominal, base=Pose(np.array([0.4, 2.0, -1.0]), rotation_matrix(np.array([0.3, -0.2, 1.0]))))
    back = load_urdf(write_urdf(there, tmp_path / "arm.urdf", name, load_arm(name).speed))
    same(there, back.nominal)
    assert back.name == name and back.nominal.joint_names == nominal.joint_names
    assert back.nominal.prismatic == nominal.prismatic
    np.testing.assert_allclose(back.nominal.lower, nominal.lower)
    np.testing.assert_allclose(back.speed, load_arm(name).speed)


def test_a_general_chain_survives_a_trip_through_urdf(tmp_path, general_chain):
    """Hayati's beta and all: URDF holds any chain, and its axes give a table without beta that moves the same."""
    back = load_urdf(write_urdf(general_chain, tmp_path / "arm.urdf")).nominal
    assert not back.beta.any()
    same(general_chain, back)


def test_mujoco_reads_what_we_write(general_chain):
    q = np.random.default_rng(3).uniform(-1, 1, (30, general_chain.joints))
    expected = mujoco_pose(urdf_text(general_chain, "arm"), "tool", general_chain.joint_names, q)
    np.testing.assert_allclose(pose_error(forward(general_chain, q), expected), 0, atol=1e-9)


axis = st.sampled_from([(1, 0, 0), (0, 1, 0), (0, 0, 1), (0, 0, -1), (0.6, 0.8, 0), (1e-4, 0, 1), (0.3, -0.5, 0.7)])


@given(
    axes=st.lists(st.tuples(axis, st.booleans()), min_size=1, max_size=7),
    coincident=st.booleans(),
    seed=st.integers(0, 2**32 - 1),
)
@settings(max_examples=80, deadline=None)
def test_axes_in_any_position_give_the_motion_they_define(axes, coincident, seed):
    """Parallel, coincident, crossing and nearly parallel axes: the product of exponentials is the referee."""
    rng = np.random.default_rng(seed)
    n = len(axes)
    directions = np.array([a for a, _ in axes], dtype=float)
    prismatic = tuple(slides for _, slides in axes)
    points = np.zeros((n, 3)) if coincident else rng.uniform(-1, 1, (n, 3))
    tool = Pose(rng.uniform(-1, 1, 3), rotation_matrix(rng.normal(size=3)))
    names = tuple(f"J{i}" for i in range(n))
    geometry = geometry_from_axes(names, prismatic, points, directions, tool, -np.ones(n), np.ones(n))
    q = rng.uniform(-1, 1, n)
    position, rotation = tool
    for i in reversed(range(n)):
        z = directions[i] / np.linalg.norm(directions[i])
        if prismatic[i]:
            position = position + z * q[i]
        else:
            turn = rotation_matrix(z * q[i])
            position, rotation = points[i] + turn @ (position - points[i]), turn @ rotation
    found = forward(geometry, q)
    size = 1 + np.abs(np.concatenate([geometry.a, geometry.d])).max()
    assert size < 20.0, "no common normal far from the arm"
    np.testing.assert_allclose(found.position, position, atol=1e-11 * size)
    np.testing.assert_allclose(found.rotation, rotation, atol=1e-11)


BAD = {
    "no file": (None, r"does not exist"),
    "not XML": ("<robot", r"is not valid XML"),
    "no such link": (FOREIGN, r"no chain of joints leads from link 'root' to link 'nowhere'"),
    "a ball joint": (FOREIGN.replace('"continuous"', '"floating"'), r"joint 'turn' has type 'floating'"),
    "a word": (
        FOREIGN.replace("0.1 -0.2 0.7", "0.1 up 0.7"),
        r"'0.1 up 0.7' is not three numbers \(xyz of joint '\w+'\)",
    ),
    "a limit in words": (FOREIGN.replace('lower="-0.1"', 'lower="low"'), r"the lower limit of joint 'lift' is 'low'"),
    "an axis of length zero": (FOREIGN.replace("0.6 0 0.8", "0 0 0"), r"axis of joint 'roll' has no direction"),
    "no moving joint": (FOREIGN, r"has no moving joint"),
    "a link that stands on itself": (
        FOREIGN.replace('<parent link="l3"/>', '<parent link="l4"/>'),
        r"joint 'roll' closes a loop: link 'l4' stands on itself",
    ),
    "a root that stands on the tip": (
        FOREIGN.replace("</robot>", '<joint name="back"><parent link="flange"/><child link="floor"/></joint></robot>'),
        r"joint '\w+' closes a loop: link '\w+' stands on itself",
    ),
    "a loop elsewhere in the file": (
        FOREIGN.replace("</robot>", '<joint name="knot"><parent link="x"/><child link="x"/></joint></robot>'),
        r"joint 'knot' closes a loop",
    ),
    "a link with two joints before it": (
        FOREIGN.replace("</robot>", '<joint name="again"><parent link="l1"/><child link="l3"/></joint></robot>'),
        r"link 'l3' is the child of joints 'swing' and 'again'",
    ),
    "a joint twice": (FOREIGN.replace('name="swing"', 'name="lift"'), r"joint 'lift' is given twice"),
    "limits swapped": (
        FOREIGN.replace('lower="-0.1" upper="0.4"', 'lower="0.4" upper="-0.1"'),
        r"'lift' has a lower limit of 0.4 m, not below its upper limit of -0.1 m",
    ),
    "equal limits": (
        FOREIGN.replace('lower="-2" upper="2"', 'lower="2" upper="2"'),
        r"'swing' has a lower limit of 2 rad",
    ),
    "limits left out": (FOREIGN.replace('lower="-2" upper="2"', ""), r"'swing' has a lower limit of 0 rad"),
    "a slide without limits": (
        re.sub('<limit lower="-0.1"[^>]*/>', "", FOREIGN),
        r"prismatic joint 'lift' has no <limit>; give lower and upper in m",
    ),
    "a turn without limits": (
        re.sub('<limit lower="-2"[^>]*/>', "", FOREIGN),
        r"revolute joint 'swing' has no <limit>",
    ),
    "no speed": (
        FOREIGN.replace('velocity="0.2"', 'velocity="0"'),
        r"velocity limit of joint 'lift' is 0; .* above zero",
    ),
    "a speed backwards": (FOREIGN.replace('velocity="0.2"', 'velocity="-1"'), r"velocity limit of joint 'lift' is -1"),
    "a slide of a thousand kilometres": (
        FOREIGN.replace('upper="0.4"', 'upper="1e6"'),
        r"no arm has more than 100 there",
    ),
    "a link of a thousand kilometres": (FOREIGN.replace("0.05 0.4 0", "0.05 1e6 0"), r"has a number above 100"),
    "foreign digits": (FOREIGN.replace("0.05 0.4 0", "0.05 \u0664 0"), r"is not three numbers"),
    "an unknown encoding": (
        FOREIGN.replace('"1.0"', '"1.0" encoding="foo"'),
        r"is not valid XML: unknown encoding: foo",
    ),
    "another encoding": (
        FOREIGN.replace('"1.0"', '"1.0" encoding="latin-1"').replace("foreign", "größe"),
        r"its encoding is 'latin-1', but it is UTF-8",
    ),
    "entities": (FOREIGN.replace("<robot", '<!DOCTYPE r [<!ENTITY a "b">]><robot', 1), r"declares XML entities"),
    "depth": ("<a>" * 200_000, r"is not valid XML"),
    "an empty file": ("", r"is not valid XML"),
}


@pytest.mark.parametrize("case", BAD)
def test_unusable_files_get_one_sentence(tmp_path, case):
    text, said = BAD[case]
    path = tmp_path / "arm.urdf"
    if text is not None:
        path.write_text(text, encoding="utf-8")
    tip = {"no such link": "nowhere", "no moving joint": "camera"}.get(case, "flange")
    with pytest.raises(InputError, match=said) as caught:
        load_arm(f"{path}#{tip}")
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 400


def test_a_chain_of_ten_thousand_fixed_joints_is_read(tmp_path):
    """Depths are counted once each, so that a long chain is no trap."""
    count = 10_000
    parts = [
        f'<joint name="f{i}" type="fixed"><parent link="x{i}"/><child link="x{i + 1}"/></joint>' for i in range(count)
    ]
    path = tmp_path / "long.urdf"
    path.write_text(FOREIGN.replace("</robot>", "".join(parts) + "</robot>").replace('"flange"', '"x0"'))
    assert load_arm(path).source.endswith(f"tip x{count}")


def test_control_characters_in_names_are_left_out_of_what_is_written(tmp_path, general_chain):
    """XML cannot hold them, and we would refuse to read the file."""
    odd = replace(general_chain, joint_names=("a\x00b", "c\n\x1bd", *general_chain.joint_names[2:]))
    back = load_urdf(write_urdf(odd, tmp_path / "arm.urdf", "arm\x07")).nominal
    assert back.joint_names == ("a b", "c  d", *general_chain.joint_names[2:])
    same(odd, back)


@pytest.mark.parametrize("name", ["qiao2026", "ur5"])
def test_links_are_drawn_as_rods_from_joint_to_joint(name: str) -> None:
    geometry = load_arm(name).nominal
    root = ElementTree.fromstring(urdf_text(geometry, "arm"))
    origins = {joint.find("parent").get("link"): joint.find("origin") for joint in root.iter("joint")}
    drawn = 0
    for link in root.iter("link"):
        for visual in link.iter("visual"):
            place, shape = visual.find("origin"), visual.find("geometry/cylinder")
            roll, pitch, yaw = map(float, place.get("rpy").split())
            along = np.array([np.sin(pitch) * np.cos(yaw), np.sin(pitch) * np.sin(yaw), np.cos(pitch)])
            middle = np.array(list(map(float, place.get("xyz").split())))
            half = 0.5 * float(shape.get("length")) * along
            np.testing.assert_allclose(middle, half, atol=1e-12)
            ends = np.array(list(map(float, origins[link.get("name")].get("xyz").split())))
            slides_back = np.allclose(along, [0, 0, -1])
            assert roll == 0.0
            assert slides_back or np.allclose(middle + half, ends, atol=1e-12)
            drawn += 1
    assert drawn >= geometry.joints // 2


def test_half_turns_that_a_file_rounds_put_no_joint_kilometres_away(data_folder):
    """Kinova's Gen3 lite says -3.1416 between parallel axes: their common normal lies 38 km off."""
    geometry = load_urdf(data_folder / "mukca_sockets/urdf/gen3lite.urdf").nominal
    assert np.abs(np.concatenate([geometry.a, geometry.d])).max() < 0.5
    assert "beta2" in complete_model(geometry).names
    rng = np.random.default_rng(0)
    apart = geometry.displaced(rng.normal(0.0, 1e-3, len(geometry.parameter_names)))
    q = rng.uniform(-1, 1, (50, geometry.joints))
    moved = np.linalg.norm(forward(apart, q).position - forward(geometry, q).position, axis=1)
    assert moved.max() < 0.02  # milliradians and millimetres move the tool by millimetres


@pytest.mark.parametrize("name", ["arm.urdf", "arm.urdf.xacro"])
@pytest.mark.parametrize("text", ['<xacro:property name="L" value="0.3"/>', '<link name="${prefix}spare"/>'])
def test_a_xacro_that_was_not_expanded_is_named_as_such(tmp_path, name, text):
    own = tmp_path / name
    plain = urdf_text(load_arm("ur5").nominal, "ur5")
    own.write_text(plain)
    assert load_arm(own).nominal.joints == 6  # what xacro prints may keep its ending
    head = '<robot xmlns:xacro="http://www.ros.org/wiki/xacro" '
    own.write_text(plain.replace("<robot ", head, 1).replace("</robot>", f"{text}</robot>"))
    with pytest.raises(
        InputError, match=rf"is a xacro that was not expanded; give the URDF that `xacro .*{name}` prints"
    ):
        load_arm(own)
