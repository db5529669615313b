"""Joints that mimic another are moved by it: as many joints as drives; MuJoCo's own reader is the referee."""

import xml.etree.ElementTree as ElementTree
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from pickenv.arm import (
    Pose,
    chain_of,
    forward,
    inverse,
    joint_jacobian,
    load_arm,
    load_urdf,
    parameter_jacobian,
    pose_error,
    pose_of,
    tool_frame,
    urdf_text,
    write_urdf,
)
from pickenv.base import InputError


def robot(*joints: str, extra: str = "") -> str:
    """A URDF of joints one behind the other (name, type, axis, origin, mimic), on links l0, l1, …"""
    links = "".join(f'<link name="l{i}"/>' for i in range(len(joints) + 1))
    parts = [
        joint.replace("<joint ", f'<joint name="j{i + 1}" ').replace(
            "</joint>", f'<parent link="l{i}"/><child link="l{i + 1}"/></joint>'
        )
        for i, joint in enumerate(joints)
    ]
    return f'<robot name="coupled">{links}{"".join(parts)}{extra}</robot>'


def joint(kind, axis, xyz, rpy="0 0 0", mimic="", lower=-1.0, upper=1.0, velocity=0.5):
    limit = f'<limit lower="{lower}" upper="{upper}" velocity="{velocity}" effort="1"/>' if kind != "continuous" else ""
    return (
        f'<joint type="{kind}"><origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="{axis}"/>{limit}'
        f"{f'<mimic {mimic}/>' if mimic else ''}</joint>"
    )


LIFT = robot(
    joint("revolute", "0 0 1", "0.1 0 0.2", "0.1 0 0"),
    joint("prismatic", "0 0 2", "0 0 0.3", lower=0.0, upper=0.5),
    joint(
        "prismatic", "0 0 1", "0.02 0 0.1", "0 0 1", 'joint="j2" multiplier="0.5" offset="0.05"', lower=0.0, upper=0.3
    ),
    joint("revolute", "0 1 0", "0.3 0 0"),
    joint("revolute", "1 0 0", "0.2 0.1 0"),
)
"""A mast turns, two stages lift (the second half as far), two joints follow."""

PARALLELOGRAM = robot(
    joint("revolute", "0 0 1", "0 0 0.4"),
    joint("revolute", "0 1 0", "0.1 0 0"),
    joint("revolute", "0 1 0", "0 0 0.6", "0 0.2 0"),
    joint("revolute", "0 -1 0", "0.5 0 0", mimic='joint="j2" multiplier="-1" offset="0.3"', lower=-2, upper=2),
    joint("continuous", "0 0 1", "0.1 0 -0.05"),
)
"""A palletiser: a hand link that turns back by what joint 2 turns."""

RACK = robot(
    joint("prismatic", "1 0 0", "0 0 0.3", mimic='joint="pinion" multiplier="0.02"', lower=-1, upper=1),
    joint("revolute", "0 1 0", "0 0.2 0"),
    extra='<link name="gear"/><joint name="pinion" type="revolute"><parent link="l0"/><child link="gear"/>'
    '<axis xyz="0 0 1"/><limit lower="-9" upper="9" velocity="3" effort="1"/></joint>',
)
"""A slide that a pinion beside the chain moves."""

CHAINS = {"lift": LIFT, "parallelogram": PARALLELOGRAM, "rack": RACK}


def mujoco_pose(text: str, tip: str, names: tuple[str, ...], q: np.ndarray) -> Pose:
    """Forward kinematics by MuJoCo; joints that mimic are set as the file says, in MuJoCo's own coordinates."""
    mujoco = pytest.importorskip("mujoco")
    root = ElementTree.fromstring(text)
    compiler = ElementTree.SubElement(ElementTree.SubElement(root, "mujoco"), "compiler")
    for key, value in {"fusestatic": "false", "boundmass": "1", "boundinertia": "1", "autolimits": "true"}.items():
        compiler.set(key, value)
    for link in root.iter("link"):
        for visual in link.findall("visual"):
            link.remove(visual)
    mimics = {}
    for each in root.iter("joint"):
        if (mimic := each.find("mimic")) is not None:
            mimics[each.get("name")] = (
                mimic.get("joint"),
                float(mimic.get("multiplier", 1)),
                float(mimic.get("offset", 0)),
            )
            each.remove(mimic)
    model = mujoco.MjModel.from_xml_string(ElementTree.tostring(root, encoding="unicode"))
    data = mujoco.MjData(model)
    body = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, tip)
    positions, rotations = [], []
    for row in q:
        value = dict(zip(names, row, strict=True))
        for name, (followed, multiplier, offset) in mimics.items():
            value[name] = multiplier * value[followed] + offset
        for name, number in value.items():
            data.qpos[model.joint(name).qposadr[0]] = number
        mujoco.mj_kinematics(model, data)
        positions.append(data.xpos[body].copy())
        rotations.append(data.xmat[body].reshape(3, 3).copy())
    return Pose(np.array(positions), np.array(rotations))


@pytest.fixture
def load(tmp_path):
    """``load(text)``: the arm of a URDF text, tip at the last link of its chain."""

    def read(text):
        path = tmp_path / "arm.urdf"
        path.write_text(text)
        return load_arm(path)

    return read


def drawn(geometry, count=40, seed=0):
    return np.random.default_rng(seed).uniform(geometry.lower, geometry.upper, (count, geometry.joints))


@pytest.mark.parametrize("name", CHAINS)
def test_a_coupled_chain_moves_as_in_mujoco(load, name):
    arm = load(CHAINS[name])
    q = drawn(arm.nominal)
    tip = arm.source.rpartition("tip ")[2]
    expected = mujoco_pose(CHAINS[name], tip, arm.nominal.joint_names, q)
    np.testing.assert_allclose(pose_error(forward(arm.nominal, q), expected), 0, atol=1e-9)


def test_two_stages_of_a_lift_are_one_slide_with_the_sum_of_their_strokes(load):
    arm = load(LIFT)
    assert arm.nominal.joint_names == ("j1", "j2", "j4", "j5")
    assert arm.nominal.links == arm.nominal.joints == 4
    assert arm.nominal.coupling.ratio == (1.0, pytest.approx(1.5), 1.0, 1.0)
    # The second stage goes 0.05 .. 0.3 m at half the drive's way: it stops the drive at 0.5 m, and at half its speed.
    np.testing.assert_allclose(arm.nominal.lower[1], 0.0)
    np.testing.assert_allclose(arm.nominal.upper[1], 0.5)
    np.testing.assert_allclose(arm.speed[1], 0.5)


def test_a_link_that_follows_narrows_its_drive(load):
    tight = LIFT.replace('upper="0.3"', 'upper="0.15"').replace('velocity="0.5"', 'velocity="0.1"')
    arm = load(tight)
    np.testing.assert_allclose(arm.nominal.upper[1], (0.15 - 0.05) / 0.5)
    np.testing.assert_allclose(arm.speed[1], 0.1)
    with pytest.raises(InputError, match="joint 'j3' follows 'j2', and their limits leave no motion"):
        load(LIFT.replace('lower="0.0" upper="0.3"', 'lower="-0.5" upper="-0.3"'))


def test_a_drive_beside_the_chain_is_the_joint(load):
    geometry = load(RACK).nominal
    assert geometry.joint_names == ("pinion", "j2") and geometry.prismatic == (False, False)
    assert geometry.slides == (True, False) and geometry.coupling.ratio == (0.02, 1.0)


def test_a_joint_may_mimic_one_that_mimics(load):
    text = PARALLELOGRAM.replace(
        '<joint name="j5" type="continuous">',
        '<joint name="j5" type="continuous"><mimic joint="j4" multiplier="2" offset="0.1"/>',
    )
    arm = load(text)
    assert arm.nominal.joint_names == ("j1", "j2", "j3")
    assert arm.nominal.coupling.joint == (0, 1, 2, 1, 1)
    assert arm.nominal.coupling.ratio == (1.0, 1.0, 1.0, -1.0, -2.0)
    chained = text.replace('joint="j4" multiplier="2" offset="0.1"', 'joint="j2" multiplier="-2" offset="0.7"')
    q = drawn(arm.nominal)
    expected = mujoco_pose(chained, "l5", arm.nominal.joint_names, q)
    np.testing.assert_allclose(pose_error(forward(arm.nominal, q), expected), 0, atol=1e-9)


@pytest.mark.parametrize("name", CHAINS)
def test_the_joint_jacobian_is_the_derivative_of_the_pose(load, name):
    geometry = load(CHAINS[name]).nominal
    q, step = drawn(geometry, 5), 1e-6
    found = joint_jacobian(geometry, q)
    for i in range(geometry.joints):
        move = step * np.eye(geometry.joints)[i]
        slope = pose_error(forward(geometry, q - move), forward(geometry, q + move)) / (2 * step)
        np.testing.assert_allclose(found[..., i], slope, atol=1e-7)


@pytest.mark.parametrize("name", CHAINS)
def test_the_parameter_jacobian_is_the_derivative_of_the_pose(load, name):
    geometry = load(CHAINS[name]).nominal
    q, step = drawn(geometry, 5), 1e-6
    found = parameter_jacobian(geometry, q)
    assert found.shape[-1] == len(geometry.parameter_names) == 5 * geometry.links + 12
    for k in range(found.shape[-1]):
        delta = step * np.eye(found.shape[-1])[k]
        slope = pose_error(forward(geometry.displaced(-delta), q), forward(geometry.displaced(delta), q)) / (2 * step)
        np.testing.assert_allclose(found[..., k], slope, atol=1e-7)


@pytest.mark.parametrize("name", CHAINS)
def test_torch_and_the_inverse_know_the_coupling(load, name):
    torch = pytest.importorskip("torch")
    geometry = load(CHAINS[name]).nominal
    q = drawn(geometry, 8)
    pose = forward(geometry, q)
    tensors = pose_of(tool_frame(torch, chain_of(geometry), torch.tensor(q).unbind(-1)))
    np.testing.assert_allclose(tensors.position, pose.position, atol=1e-12)
    found = inverse(geometry, pose)
    assert found.reached.all()
    np.testing.assert_allclose(forward(geometry, found.joints).position, pose.position, atol=1e-6)


@pytest.mark.parametrize("name", CHAINS)
def test_a_coupled_chain_survives_a_trip_through_urdf_and_mujoco_reads_it(load, tmp_path, name):
    arm = load(CHAINS[name])
    there = arm.nominal
    text = urdf_text(there, "coupled", arm.speed)
    back = load_urdf(write_urdf(there, tmp_path / "back.urdf", "coupled", arm.speed), "tool")
    assert back.nominal.joint_names == there.joint_names and back.nominal.prismatic == there.prismatic
    assert back.nominal.slides == there.slides
    np.testing.assert_allclose(back.nominal.lower, there.lower)
    np.testing.assert_allclose(back.nominal.upper, there.upper)
    np.testing.assert_allclose(back.speed, arm.speed)
    q = drawn(there)
    np.testing.assert_allclose(pose_error(forward(there, q), forward(back.nominal, q)), 0, atol=1e-12)
    np.testing.assert_allclose(
        pose_error(mujoco_pose(text, "tool", there.joint_names, q), forward(there, q)), 0, atol=1e-9
    )


@given(seed=st.integers(0, 2**32 - 1), kinds=st.lists(st.booleans(), min_size=2, max_size=6))
@settings(max_examples=40, deadline=None)
def test_any_coupled_chain_moves_as_its_links_set_one_by_one(tmp_path_factory, seed, kinds):
    """The same file without its mimic elements, each joint set to what it would mimic, is the referee."""
    rng = np.random.default_rng(seed)
    parts, coupled, values = [], [], []
    drives = rng.uniform(-0.5, 0.5, len(kinds))
    for i, slides in enumerate(kinds):
        axis, xyz = (" ".join(f"{v:.3f}" for v in rng.uniform(0.1, 1, 3)) for _ in range(2))
        rpy = " ".join(f"{v:.3f}" for v in rng.uniform(-1, 1, 3))
        kind = "prismatic" if slides else "revolute"
        followed, ratio, offset = (
            int(rng.integers(0, i + 1)),
            round(rng.uniform(0.2, 2), 3),
            round(rng.uniform(-1, 1), 3),
        )
        free = f'joint="j{followed + 1}" multiplier="{ratio}" offset="{offset}"'
        leads = followed == i
        values.append(drives[i] if leads else ratio * values[followed] + offset)
        parts.append(joint(kind, axis, xyz, rpy, lower=-9, upper=9))
        coupled.append(joint(kind, axis, xyz, rpy, "" if leads else free, lower=-9, upper=9))
    folder = tmp_path_factory.mktemp("chains")
    (folder / "free.urdf").write_text(robot(*parts))
    (folder / "coupled.urdf").write_text(robot(*coupled))
    free, together = load_arm(folder / "free.urdf").nominal, load_arm(folder / "coupled.urdf").nominal
    q = [drives[int(name[1:]) - 1] for name in together.joint_names]
    np.testing.assert_allclose(pose_error(forward(free, values), forward(together, q)), 0, atol=1e-9)


def test_a_coupled_arm_is_another_arm_than_the_free_one(load):
    arm = load(PARALLELOGRAM)
    other = replace(arm.nominal, coupling=replace(arm.nominal.coupling, ratio=(1.0, 1.0, 1.0, -0.5, 1.0)))
    assert replace(arm, nominal=other).fingerprint() != arm.fingerprint()


BAD = {
    "itself": (PARALLELOGRAM.replace('joint="j2"', 'joint="j4"'), "joint 'j4' mimics itself"),
    "nobody": (PARALLELOGRAM.replace('joint="j2"', 'joint="j9"'), "joint 'j4' mimics 'j9', which is no joint"),
    "no number": (PARALLELOGRAM.replace('multiplier="-1"', 'multiplier="-one"'), "multiplier of joint 'j4' is '-one'"),
    "a fixed one": (
        PARALLELOGRAM.replace('joint="j2"', 'joint="weld"').replace(
            "</robot>",
            '<link name="x"/><joint name="weld" type="fixed"><parent link="l0"/><child link="x"/></joint></robot>',
        ),
        "joint 'j4' mimics 'weld', which does not move",
    ),
    "cancelling slides": (
        LIFT.replace('multiplier="0.5" offset="0.05"', 'multiplier="-1" offset="0.3"'),
        "joint 'j2' moves two slides that cancel each other",
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_a_coupling_that_cannot_be_gets_one_sentence(load, case):
    text, said = BAD[case]
    with pytest.raises(InputError, match=said) as caught:
        load(text)
    assert "\n" not in str(caught.value)


def test_a_multiplier_of_zero_holds_the_link_still(load):
    arm = load(PARALLELOGRAM.replace('multiplier="-1"', 'multiplier="0"'))
    assert arm.nominal.coupling is None and arm.nominal.links == 4


def test_a_follower_that_turns_for_ever_narrows_nothing(load):
    """Even where it states a speed; one with limits narrows both its driver's range and its speed."""
    endless = joint("continuous", "0 0 1", "0.1 0 0", mimic='joint="j1" multiplier="2"').replace(
        "<mimic", '<limit velocity="0.1" effort="1"/><mimic'
    )
    driver = joint("revolute", "0 0 1", "0 0 0.3", lower=-5.0, upper=4.0, velocity=0.5)
    arm = load(robot(driver, endless))
    assert (arm.nominal.lower[0], arm.nominal.upper[0], arm.speed[0]) == (-5.0, 4.0, 0.5)
    held = joint("revolute", "0 0 1", "0.1 0 0", mimic='joint="j1" multiplier="-2" offset="1"', lower=-3, upper=2)
    arm = load(robot(driver, held))
    assert (arm.nominal.lower[0], arm.nominal.upper[0], arm.speed[0]) == (-0.5, 2.0, 0.25)


def test_a_urdf_declares_that_it_is_xml(qiao):
    assert urdf_text(qiao.nominal, "arm").startswith("<?xml version=")
