"""One physics, three executors: Python floats, NumPy arrays and torch tensors give the same pose."""

import math
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import torch

from pickenv.arm import (
    LINK_PARAMETERS,
    chain_of,
    forward,
    joint_jacobian,
    load_arm,
    load_plant,
    parameter_jacobian,
    pose_of,
    tool_frame,
)

MODELS = [("qiao2026", "nominal"), ("qiao2026", "true"), ("ur5", "nominal"), ("wam", "nominal")]


def same(pose, other):
    for mine, theirs in zip(pose, other, strict=True):
        np.testing.assert_allclose(np.asarray(mine), np.asarray(theirs), rtol=0, atol=1e-12)


def stacked_floats(frame_of_one, joints):
    frames = [frame_of_one([float(value) for value in q]) for q in joints]
    assert all(type(value) is float for frame in frames for value in frame)
    return pose_of(tuple(np.array(frames).T))


@pytest.mark.parametrize(("name", "model"), MODELS)
def test_executors_agree_on_every_arm(name, model, draw):
    geometry = getattr(load_arm(name), model)
    q = draw(geometry, 50)
    arrays = forward(geometry, q)
    same(stacked_floats(lambda one: tool_frame(math, chain_of(geometry), one), q), arrays)
    same(pose_of(tool_frame(torch, chain_of(geometry), torch.from_numpy(q).unbind(-1))), arrays)


@pytest.mark.parametrize("name", ["geometry_only", "qiao2026"])
def test_executors_agree_on_the_plant(name, draw):
    plant = load_plant(name)
    q = draw(plant.geometry, 50)
    arrays = plant.tool_pose(q)
    same(stacked_floats(partial(plant.tool_frame, math), q), arrays)
    same(pose_of(plant.tool_frame(torch, torch.from_numpy(q).unbind(-1))), arrays)


def test_executors_agree_on_hayatis_beta_and_on_frames(general_chain, draw):
    q = draw(general_chain, 50)
    arrays = forward(general_chain, q)
    same(stacked_floats(lambda one: tool_frame(math, chain_of(general_chain), one), q), arrays)
    same(pose_of(tool_frame(torch, chain_of(general_chain), torch.from_numpy(q).unbind(-1))), arrays)


def test_torch_differentiates_the_plant(draw):
    plant = load_plant("geometry_only")
    q = torch.from_numpy(draw(plant.geometry)).requires_grad_()
    position = plant.tool_frame(torch, q.unbind(-1))[9:]
    slope = np.stack([torch.autograd.grad(value, q, retain_graph=True)[0].numpy() for value in position])
    np.testing.assert_allclose(slope, joint_jacobian(plant.geometry, q.detach().numpy())[:3], rtol=0, atol=1e-12)


def test_many_arms_at_once_are_the_arms_one_by_one(general_chain, draw):
    """Link parameters may carry leading dimensions: one table per arm, against several poses each."""
    rng = np.random.default_rng(1)
    spread = {name: getattr(general_chain, name) + 0.1 * rng.normal(size=(3, 1, 7)) for name in LINK_PARAMETERS}
    many, q = replace(general_chain, **spread), draw(general_chain, 3, 4)
    pose, by_joint, by_parameter = forward(many, q), joint_jacobian(many, q), parameter_jacobian(many, q)
    for i, j in np.ndindex(3, 4):
        one = replace(general_chain, **{name: value[i, 0] for name, value in spread.items()})
        same((pose.position[i, j], pose.rotation[i, j]), forward(one, q[i, j]))
        np.testing.assert_allclose(by_joint[i, j], joint_jacobian(one, q[i, j]), rtol=0, atol=1e-12)
        np.testing.assert_allclose(by_parameter[i, j], parameter_jacobian(one, q[i, j]), rtol=0, atol=1e-12)


def test_many_arms_share_one_pose(general_chain):
    spread = general_chain.a + np.linspace(0, 0.1, 5)[:, None]
    many = forward(
        replace(
            general_chain,
            **{name: np.broadcast_to(getattr(general_chain, name), (5, 7)) for name in LINK_PARAMETERS} | {"a": spread},
        ),
        np.zeros(7),
    )
    assert many.position.shape == (5, 3)
    same((many.position[3], many.rotation[3]), forward(replace(general_chain, a=spread[3]), np.zeros(7)))
