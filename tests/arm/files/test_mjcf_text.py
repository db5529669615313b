"""What is written for MuJoCo: it loads, stands where the arm stands, and is read back as the same arm."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from pickenv.arm import Coupling, forward, load_arm, mjcf_text, shipped_arms
from pickenv.base import InputError


def posed(model, data, geometry, q):
    """Every link's displacement set, those that follow another too."""
    moved = q if geometry.coupling is None else geometry.coupling.displacements(list(q))
    data.qpos[:] = moved
    mujoco.mj_kinematics(model, data)
    return data.site("tool")


@pytest.mark.parametrize("name", shipped_arms())
def test_mujoco_stands_where_the_arm_stands(name, draw):
    geometry = load_arm(name).nominal
    model = mujoco.MjModel.from_xml_string(mjcf_text(geometry, name))
    data, joints = mujoco.MjData(model), draw(geometry, 200)
    pose = forward(geometry, joints)
    for i, q in enumerate(joints):
        site = posed(model, data, geometry, q)
        np.testing.assert_allclose(site.xpos, pose.position[i], rtol=0, atol=1e-8)
        np.testing.assert_allclose(site.xmat.reshape(3, 3), pose.rotation[i], rtol=0, atol=1e-8)
    assert model.nu == geometry.joints and np.all(model.body_mass[1:] > 0)
    inertia = np.sort(model.body_inertia[1:], axis=1)
    assert np.all(inertia[:, 0] > 0) and np.all(inertia[:, 0] + inertia[:, 1] >= inertia[:, 2])


@pytest.mark.parametrize("name", shipped_arms())
def test_it_is_read_back_as_the_same_arm(name, draw, tmp_path):
    geometry = load_arm(name).nominal
    (tmp_path / "arm.xml").write_text(mjcf_text(geometry, name), encoding="utf-8")
    back = load_arm(f"{tmp_path / 'arm.xml'}#tool").nominal
    joints = draw(geometry, 50)
    one, other = forward(geometry, joints), forward(back, joints)
    np.testing.assert_allclose(other.position, one.position, rtol=0, atol=1e-9)
    np.testing.assert_allclose(other.rotation, one.rotation, rtol=0, atol=1e-9)
    assert back.prismatic == geometry.prismatic
    np.testing.assert_allclose(back.lower, geometry.lower, rtol=0, atol=1e-12)
    np.testing.assert_allclose(back.upper, geometry.upper, rtol=0, atol=1e-12)


def test_any_chain_of_both_types_and_every_beta(general_chain, draw):
    model = mujoco.MjModel.from_xml_string(mjcf_text(general_chain, "chain <&> -- é", "a -- comment"))
    data = mujoco.MjData(model)
    for q in draw(general_chain, 20):
        pose = forward(general_chain, q)
        np.testing.assert_allclose(posed(model, data, general_chain, q).xpos, pose.position, rtol=0, atol=1e-8)


def test_a_comment_of_many_hyphens_is_xml(tmp_path):
    geometry = load_arm("ur5").nominal
    (tmp_path / "arm.xml").write_text(mjcf_text(geometry, "ur5", "a ---- b"), encoding="utf-8")
    assert load_arm(f"{tmp_path / 'arm.xml'}#tool").nominal.joints == 6


def test_links_that_follow_a_joint_are_tied_to_it(draw):
    six = load_arm("ur5").nominal
    tied = Coupling((0, 1, 2, 3, 4, 4), (1.0, 1.0, 1.0, 1.0, 1.0, -0.5), six.prismatic)
    parts = {name: getattr(six, name)[:5] for name in ("joint_names", "prismatic", "lower", "upper")}
    geometry = replace(six, **parts, coupling=tied)
    model = mujoco.MjModel.from_xml_string(mjcf_text(geometry, "tied"))
    assert (model.nq, model.nu, model.neq) == (6, 5, 1)
    np.testing.assert_array_equal(model.eq_data[0, :5], [0.0, -0.5, 0.0, 0.0, 0.0])
    data = mujoco.MjData(model)
    for q in draw(geometry, 10):
        site = posed(model, data, geometry, q)
        np.testing.assert_allclose(site.xpos, forward(geometry, q).position, rtol=0, atol=1e-8)


def test_drives_hold_the_arm_at_its_target():
    geometry = load_arm("ur5").nominal
    model = mujoco.MjModel.from_xml_string(mjcf_text(geometry, "ur5"))
    data = mujoco.MjData(model)
    target = np.array([0.3, -1.0, 1.2, 0.2, 0.4, -0.3])
    data.qpos[:], data.ctrl[:] = target, target
    model.opt.gravity[:] = 0.0
    mujoco.mj_step(model, data, 500)
    np.testing.assert_allclose(data.qpos, target, rtol=0, atol=1e-6)


def test_mjx_stands_where_the_arm_stands(draw):
    mjx = pytest.importorskip("mujoco.mjx", reason="MJX is not installed; pip install mujoco-mjx")
    geometry = load_arm("qiao2026").nominal
    model = mujoco.MjModel.from_xml_string(mjcf_text(geometry, "qiao2026"))
    device, joints = mjx.put_model(model), draw(geometry, 5)
    for q in joints:
        data = mjx.kinematics(device, mjx.make_data(device).replace(qpos=np.asarray(q)))
        # MJX computes in single precision unless told otherwise
        np.testing.assert_allclose(np.asarray(data.site_xpos)[-1], forward(geometry, q).position, rtol=0, atol=2e-6)


def test_warp_stands_where_the_arm_stands(draw):
    reason = "MuJoCo Warp of this MuJoCo's version is not installed; pip install mujoco-warp"
    mjw = pytest.importorskip("mujoco_warp", reason=reason)
    geometry = load_arm("qiao2026").nominal
    model = mujoco.MjModel.from_xml_string(mjcf_text(geometry, "qiao2026"))
    host = mujoco.MjData(model)
    for q in draw(geometry, 3):
        host.qpos[:] = q
        mujoco.mj_forward(model, host)
        device, data = mjw.put_model(model), mjw.put_data(model, host)
        data.site_xpos.zero_()
        mjw.kinematics(device, data)
        seen = data.site_xpos.numpy()[0, -1]  # single precision
        np.testing.assert_allclose(seen, forward(geometry, q).position, rtol=0, atol=2e-6)


def test_a_joint_without_a_link_of_its_own_is_refused():
    geometry = load_arm("positioner").nominal
    coupled = replace(geometry, coupling=Coupling((0, 1), (2.0, 1.0), (False, False)))
    with pytest.raises(InputError, match="moves no link as it moves itself; write URDF instead"):
        mjcf_text(coupled, "arm")
