"""MuJoCo, built from the same link table, referees forward kinematics and gravity torques."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pickenv.arm import (
    Geometry,
    Load,
    Pose,
    chain_of,
    forward,
    frames,
    gravity_torques,
    load_arm,
    load_plant,
    rotation_matrix,
)
from pickenv.base import GRAVITY


def place(body, position, rotation):
    x, y, z, w = Rotation.from_matrix(rotation).as_quat()
    body.pos, body.quat = position, [w, x, y, z]


def referee(geometry: Geometry, load: Load) -> mujoco.MjModel:
    """One body per link, its frame at zero displacement, its joint along z."""
    spec = mujoco.MjSpec()
    spec.option.gravity = [0, 0, -GRAVITY]
    spec.compiler.degree = False
    body = spec.worldbody.add_body()
    place(body, *geometry.base)
    for i, slides in enumerate(geometry.prismatic):
        body = body.add_body()
        twist = Rotation.from_euler("X", geometry.alpha[i])
        turned = twist * Rotation.from_euler("YZ", [geometry.beta[i], geometry.theta[i]])
        rotation = turned.as_matrix()
        place(body, np.array([geometry.a[i], 0, 0]) + geometry.d[i] * rotation[:, 2], rotation)
        kind = mujoco.mjtJoint.mjJNT_SLIDE if slides else mujoco.mjtJoint.mjJNT_HINGE
        body.add_joint(type=kind, axis=[0, 0, 1])
        body.mass, body.ipos, body.inertia = load.mass[i], load.centre[i], [0.01, 0.01, 0.01]
        body.explicitinertial = True
    tool = body.add_body(name="tool")
    place(tool, *geometry.tool)
    tool.mass, tool.ipos, tool.inertia = max(load.payload, 1e-12), [0, 0, 0], [1e-9, 1e-9, 1e-9]
    tool.explicitinertial = True
    return spec.compile()


CASES = {
    "qiao2026 plant": (load_plant("qiao2026").geometry, load_plant("qiao2026").load),
    "qiao2026 plant with an apple": (
        load_plant("qiao2026").geometry,
        replace(load_plant("qiao2026").load, payload=0.25),
    ),
    "qiao2026 on a leaning base with a tool": (
        replace(
            load_arm("qiao2026").true,
            base=Pose(np.array([0.2, -0.1, 0.9]), rotation_matrix([0.1, -0.3, 0.5])),
            tool=Pose(np.array([0.03, 0.02, 0.15]), rotation_matrix([0.5, 0.2, -0.4])),
        ),
        replace(load_plant("qiao2026").load, payload=0.25),
    ),
    "ur5": (load_arm("ur5").nominal, Load((3.7, 8.4, 2.3, 1.2, 1.2, 0.2), ((0.1, 0.02, -0.05),) * 6, 3.0)),
}


@pytest.fixture(params=CASES.values(), ids=CASES)
def case(request):
    geometry, load = request.param
    model = referee(geometry, load)
    return geometry, load, model, mujoco.MjData(model)


def test_forward_kinematics_agree(case, draw):
    geometry, _, model, data = case
    tool = model.body("tool").id
    for q in draw(geometry, 30):
        data.qpos[:] = q
        mujoco.mj_forward(model, data)
        pose = forward(geometry, q)
        np.testing.assert_allclose(pose.position, data.xpos[tool], rtol=0, atol=1e-9)
        np.testing.assert_allclose(pose.rotation, data.xmat[tool].reshape(3, 3), rtol=0, atol=1e-9)


def test_gravity_torques_agree(case, draw):
    geometry, load, model, data = case
    chain = chain_of(geometry)
    for q in draw(geometry, 30):
        data.qpos[:] = q
        mujoco.mj_forward(model, data)
        np.testing.assert_allclose(
            gravity_torques(chain, frames(np, chain, q), load), -data.qfrc_bias, rtol=0, atol=1e-9
        )


def test_gravity_torques_agree_in_general_position(general_chain, draw):
    """Every beta away from zero, both joint types mixed."""
    load = Load((3.0, 2.0, 1.5, 1.0, 0.8, 0.5, 0.3), tuple((0.1 * i, -0.05, 0.03 * i) for i in range(7)), 0.4)
    model = referee(general_chain, load)
    data, chain = mujoco.MjData(model), chain_of(general_chain)
    for q in draw(general_chain, 10):
        data.qpos[:] = q
        mujoco.mj_forward(model, data)
        np.testing.assert_allclose(
            forward(general_chain, q).position, data.xpos[model.body("tool").id], rtol=0, atol=1e-9
        )
        np.testing.assert_allclose(
            gravity_torques(chain, frames(np, chain, q), load), -data.qfrc_bias, rtol=0, atol=1e-9
        )
