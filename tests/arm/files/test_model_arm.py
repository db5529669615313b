"""The arm of a MuJoCo model is found, and becomes the true arm: MuJoCo's own kinematics are the referee."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from numpy.testing import assert_allclose

from pickenv.arm import (
    Pose,
    arm_in_mujoco,
    chain_of,
    displace_pose,
    draw_plants,
    forward,
    frame_of,
    load_arm,
    load_plant,
    load_tolerances,
    mjcf_text,
    plant_at,
)
from pickenv.base import InputError

ARMS = ("ur5e", "panda", "qiao2026", "tiago")


def loaded(name, tolerances="coarse"):
    """A model, its data, its arm, and the geometry of a true arm drawn about it."""
    plants = draw_plants(load_plant(f"ideal:{name}"), load_tolerances(tolerances), 1, np.random.default_rng(3))
    nominal = load_arm(name).nominal
    model = mujoco.MjModel.from_xml_string(mjcf_text(nominal, name))
    return model, mujoco.MjData(model), arm_in_mujoco(model, nominal), plant_at(plants, 0).geometry


def shown(model, data, arm, joints):
    """The tool's pose by MuJoCo."""
    data.qpos[arm.places] = joints
    mujoco.mj_kinematics(model, data)
    site = data.site("tool")
    return Pose(site.xpos.copy(), site.xmat.reshape(3, 3).copy())


def drawn(nominal, count=40):
    return np.random.default_rng(0).uniform(nominal.lower, nominal.upper, (count, nominal.joints))


@pytest.mark.parametrize("name", ARMS)
def test_the_model_moves_as_the_true_arm_does(name):
    model, data, arm, true = loaded(name)
    joints = drawn(arm.nominal)
    apart = np.linalg.norm(forward(true, joints).position - forward(arm.nominal, joints).position, axis=1)
    assert apart.min() > 5e-5
    arm.take(true)
    for q in joints:
        here, there = shown(model, data, arm, q), forward(true, q)
        assert_allclose(here.position, there.position, rtol=0, atol=1e-12)
        assert_allclose(here.rotation, there.rotation, rtol=0, atol=1e-12)
    arm.take(arm.nominal)
    assert_allclose(shown(model, data, arm, joints[0]).position, forward(arm.nominal, joints[0]).position, atol=1e-12)


@pytest.mark.parametrize("name", ARMS)
def test_the_tool_is_put_where_it_is_said_to_be_and_turns_about_the_same_axis(name):
    model, data, arm, true = loaded(name)
    arm.take(true)
    joints, shift = drawn(arm.nominal), np.array([2e-3, -1e-3, 3e-3, 0.02, 0.01, -0.03])
    chain = chain_of(true)
    for q in joints[:5]:
        arm.put_tool(chain, q.tolist(), frame_of(displace_pose(forward(true, q), shift)))
        for turn in (0.0, 0.4):  # the last joint still moves about the true arm's axis
            moved = q + np.eye(len(q))[-1] * turn
            rigid = replace(true, tool=seen_from_last(true, q, displace_pose(forward(true, q), shift)))
            here, there = shown(model, data, arm, moved), forward(rigid, moved)
            assert_allclose(here.position, there.position, rtol=0, atol=1e-12)
            assert_allclose(here.rotation, there.rotation, rtol=0, atol=1e-12)


def seen_from_last(true, joints, pose):
    """The tool that a pose is, in the last link's frame."""
    last = forward(replace(true, tool=Pose(np.zeros(3), np.eye(3))), joints)
    return Pose(last.rotation.T @ (pose.position - last.position), last.rotation.T @ pose.rotation)


def test_a_model_of_another_arm_is_refused_by_the_joint_where_it_differs():
    nominal = load_arm("ur5e").nominal
    longer = replace(nominal, a=nominal.a + 1e-3 * (np.arange(6) == 3))
    model = mujoco.MjModel.from_xml_string(mjcf_text(longer, "longer"))
    with pytest.raises(InputError, match=f"joint '{nominal.joint_names[3]}'"):
        arm_in_mujoco(model, nominal)
    with pytest.raises(InputError, match="no joint 'J1"):
        arm_in_mujoco(model, load_arm("qiao2026").nominal)
