"""Forward kinematics against poses and models that others computed."""

import json
from pathlib import Path

import numpy as np
import pytest

from pickenv.arm import Pose, forward, load_arm, pose_error, pose_of

GOLDEN = {
    key: np.array(value)
    for key, value in json.loads((Path(__file__).parent / "golden" / "qiao2026.json").read_text()).items()
    if key != "what"
}
IN_METRES = np.array([1, 1e-3, 1e-3, 1, 1e-3, 1])


@pytest.mark.parametrize("model", ["nominal", "true"])
def test_ten_independent_poses(qiao, model):
    pose, expected = forward(getattr(qiao, model), GOLDEN["q"] * IN_METRES), GOLDEN[f"T_{model}"]
    np.testing.assert_allclose(pose.position * 1e3, expected[:, :3, 3], rtol=0, atol=1e-9)
    np.testing.assert_allclose(pose.rotation, expected[:, :3, :3], rtol=0, atol=1e-12)


def test_ten_independent_pose_errors(qiao):
    q = GOLDEN["q"] * IN_METRES
    error = pose_error(forward(qiao.nominal, q), forward(qiao.true, q))
    np.testing.assert_allclose(error[:, :3] * 1e3, GOLDEN["position_error_mm"], rtol=0, atol=1e-9)
    np.testing.assert_allclose(error[:, 3:], GOLDEN["attitude_error_rad"], rtol=0, atol=1e-12)


def test_at_zero_the_arm_picks_from_below(qiao):
    pose = forward(qiao.nominal, np.zeros(6))
    np.testing.assert_allclose(pose.position * 1e3, [222.02, -466.67, 367.75], rtol=0, atol=1e-9)
    np.testing.assert_allclose(pose.rotation[:, 2], [0, 0, 1], rtol=0, atol=1e-15)


def test_boom_slides_forward_and_rail_sideways(qiao):
    home = forward(qiao.nominal, np.zeros(6)).position
    rail, boom = forward(qiao.nominal, 0.1 * np.eye(6)[[1, 2]]).position - home
    np.testing.assert_allclose(rail, [0, -0.1, 0], rtol=0, atol=1e-15)
    np.testing.assert_allclose(boom, [0.1, 0, 0], rtol=0, atol=1e-15)


def test_ur5_stretched_out_as_in_its_data_sheet():
    flange = forward(load_arm("ur5").nominal, np.zeros(6)).position * 1e3
    np.testing.assert_allclose(flange, [-425 - 392.25, -109.15 - 82.3 - 31, 89.159 - 94.65], rtol=0, atol=1e-9)


@pytest.mark.parametrize("shape", [(), (1,), (0,), (3, 4)])
def test_a_batch_of_poses_is_the_poses_one_by_one(qiao, draw, shape):
    q = draw(qiao.true, *shape)
    batch = forward(qiao.true, q)
    assert batch.position.shape == (*shape, 3) and batch.rotation.shape == (*shape, 3, 3)
    for index in np.ndindex(shape):
        one = forward(qiao.true, q[index])
        np.testing.assert_allclose(batch.position[index], one.position, rtol=0, atol=1e-15)
        np.testing.assert_allclose(batch.rotation[index], one.rotation, rtol=0, atol=1e-15)


@pytest.mark.parametrize("joints", [0.3, np.zeros(5), np.zeros((2, 7))])
def test_a_wrong_number_of_joints_is_refused(qiao, joints):
    with pytest.raises(ValueError, match="6 joints"):
        forward(qiao.nominal, joints)


def test_pose_error_is_in_world_axes():
    quarter = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])  # about z
    tilted = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]) @ quarter  # then about the world's x
    error = pose_error(Pose(np.zeros(3), quarter), Pose(np.array([0.0, 0, 1e-3]), tilted))
    np.testing.assert_allclose(error, [0, 0, 1e-3, np.pi / 2, 0, 0], rtol=0, atol=1e-15)


@pytest.mark.parametrize("varies", range(12))
def test_the_components_of_a_frame_may_have_any_shapes_that_fit(varies):
    """Only some of them vary over a batch where joints are held; constants may be plain floats."""
    frame = [np.array(float(i)) for i in range(12)]
    frame[varies], frame[(varies + 1) % 12] = np.arange(3.0), 0.5
    pose = pose_of(tuple(frame))
    full = np.stack(np.broadcast_arrays(*frame))
    np.testing.assert_array_equal(pose.position, full[9:].T)
    np.testing.assert_array_equal(pose.rotation, np.moveaxis(full[:9].reshape(3, 3, 3), (0, 1), (2, 1)))
