"""A geometry's parameters: their names, their order, and moving along them."""

from dataclasses import replace

import numpy as np
import pytest

from pickenv.arm import Pose, forward, rotation_matrix, rotation_vector


def test_parameters_carry_the_papers_indices(qiao):
    names = qiao.nominal.parameter_names
    assert len(names) == len(set(names)) == 42
    assert names[0] == "alpha0" and names[11] == "a5" and names[12] == "theta1" and names[23] == "d6"
    assert names[30:36] == ("base_x", "base_y", "base_z", "base_rx", "base_ry", "base_rz")


def test_lengths_and_angles_are_told_apart(qiao):
    angles = {
        name for name, angle in zip(qiao.nominal.parameter_names, qiao.nominal.parameter_is_angle, strict=True) if angle
    }
    assert {"alpha0", "theta6", "beta3", "base_rx", "tool_rz"} <= angles
    assert not {"a0", "d6", "base_x", "tool_z"} & angles


def test_each_parameter_moves_its_own_entry(general_chain):
    for i, name in enumerate(general_chain.parameter_names):
        delta = np.zeros(47)
        delta[i] = 0.25
        moved = general_chain.displaced(delta)
        if name.startswith(("base", "tool")):
            frame, axis = name.split("_")
            pose = getattr(general_chain, frame)
            turn = np.zeros(3)
            shift = np.zeros(3)
            (turn if axis.startswith("r") else shift)["xyz".index(axis[-1])] = 0.25
            np.testing.assert_allclose(getattr(moved, frame).position, pose.position + shift, rtol=0, atol=1e-15)
            np.testing.assert_allclose(
                getattr(moved, frame).rotation, rotation_matrix(turn) @ pose.rotation, rtol=0, atol=1e-15
            )
        else:
            group = name.rstrip("0123456789")
            changed = getattr(moved, group) - getattr(general_chain, group)
            assert np.flatnonzero(changed).tolist() == [i % 7]


def test_table_1_differs_by_the_papers_deviations(qiao):
    delta = dict(zip(qiao.nominal.parameter_names, qiao.nominal.difference(qiao.true), strict=True))
    assert np.degrees(delta["alpha2"]) == pytest.approx(0.040)
    assert delta["a0"] * 1e3 == pytest.approx(0.500)
    assert np.degrees(delta["theta4"]) == pytest.approx(0.046)
    assert delta["d4"] * 1e3 == pytest.approx(0.012)
    assert all(value == 0 for name, value in delta.items() if name.startswith(("beta", "base", "tool")))


def test_a_displacement_of_the_wrong_length_is_refused(qiao):
    with pytest.raises(ValueError, match="42 parameters"):
        qiao.nominal.displaced(np.zeros(24))


def test_base_and_tool_frame_the_chain(qiao, draw):
    q = draw(qiao.nominal, 20)
    inner = forward(qiao.nominal, q)
    base = Pose(np.array([0.3, -0.2, 1.1]), rotation_matrix([0.4, -1.0, 0.2]))
    tool = Pose(np.array([0.05, 0.01, 0.12]), rotation_matrix([-0.3, 0.1, 2.0]))
    framed = forward(replace(qiao.nominal, base=base, tool=tool), q)
    reach = inner.position + inner.rotation @ tool.position
    np.testing.assert_allclose(framed.position, base.position + reach @ base.rotation.T, rtol=0, atol=1e-14)
    np.testing.assert_allclose(framed.rotation, base.rotation @ inner.rotation @ tool.rotation, rtol=0, atol=1e-14)


def test_a_batch_of_rotations_is_the_rotations_one_by_one_and_back():
    vectors = np.random.default_rng(4).uniform(-1.5, 1.5, (2, 4, 3))
    batch = rotation_matrix(vectors)
    assert batch.shape == (2, 4, 3, 3)
    for index in np.ndindex(2, 4):
        np.testing.assert_allclose(batch[index], rotation_matrix(vectors[index]), atol=1e-15)
    np.testing.assert_allclose(rotation_vector(batch), vectors, atol=1e-14)
