"""Rotations, pose errors and displaced poses are right at every angle, and the same on floats, arrays and tensors."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pickenv.arm import Pose, displace_pose, frame_error, frame_of, pose_error, rotation_between, rotation_matrix
from pickenv.arm.kinematics.task_space import SMALL_SINE, displaced_frame, small_rotation

RNG = np.random.default_rng(6)
AXES = [*np.eye(3), [1, 1, 0], [0, 1, -1], [-1, 0, 1], [1, 2, 3], [3, -1, 2], [-2, 3, 1], *RNG.normal(size=(10, 3))]
ANGLES = [0.0, 1e-12, 9e-8, 1e-6, 1e-3, 1.0, 2.9, 3.0, 3.1, *(math.pi - np.array([1e-3, 1e-5, 1e-7, 1e-9, 1e-12, 0]))]


def poses(angle):
    """Single poses, others turned from them by ``angle`` about many axes, and the rotation vectors, by SciPy."""
    axes = np.array(AXES, dtype=float)
    vectors = angle * axes / np.linalg.norm(axes, axis=1, keepdims=True)
    reference = Pose(RNG.normal(size=(len(axes), 3)), Rotation.random(len(axes), rng=RNG).as_matrix())
    turned = Rotation.from_rotvec(vectors).as_matrix() @ reference.rotation
    return reference, Pose(reference.position + np.array([1e-3, -2e-3, 0.5]), turned), vectors


def frames(pose):
    """Components of many poses."""
    return [frame_of(Pose(*one)) for one in zip(*pose, strict=True)]


@pytest.mark.parametrize("angle", ANGLES)
def test_pose_errors_are_those_of_scipy_near_nothing_and_near_half_a_turn(angle):
    reference, actual, vectors = poses(angle)
    error = pose_error(reference, actual)
    np.testing.assert_allclose(error[:, :3], actual.position - reference.position, rtol=0, atol=0)
    found = error[:, 3:]
    if angle > math.pi - 1e-11:  # either way round is half a turn, to rounding
        found = found * np.sign(np.sum(found * vectors, axis=1, keepdims=True))
    np.testing.assert_allclose(found, vectors, rtol=0, atol=4e-15 * max(angle, 1.0))
    np.testing.assert_allclose(
        np.linalg.norm(error[:, 3:], axis=1),
        (Rotation.from_matrix(actual.rotation) * Rotation.from_matrix(reference.rotation).inv()).magnitude(),
        rtol=0,
        atol=4e-15,
    )


def test_exactly_half_a_turn_has_its_axis():
    for axis in AXES[:9]:
        vector = math.pi * np.array(axis) / np.linalg.norm(axis)
        turn = np.round(rotation_matrix(vector), 15)
        error = pose_error(Pose(np.zeros(3), np.eye(3)), Pose(np.zeros(3), turn))[3:]
        np.testing.assert_allclose(error * np.sign(error @ vector), vector, atol=1e-14)


@pytest.mark.parametrize("angle", ANGLES)
def test_floats_arrays_and_tensors_give_the_same_error(angle):
    torch = pytest.importorskip("torch")
    reference, actual, _ = poses(angle)
    many = pose_error(reference, actual)
    columns = [list(zip(*frames(pose), strict=True)) for pose in (reference, actual)]
    tensors = torch.stack(frame_error(torch, *([torch.tensor(v, dtype=torch.float64) for v in c] for c in columns)), -1)
    for i, (one, other) in enumerate(zip(frames(reference), frames(actual), strict=True)):
        single = frame_error(math, one, other)
        assert single[3:] == rotation_between(math, one[:9], other[:9])
        np.testing.assert_array_equal(
            pose_error(*(Pose(p.position[i], p.rotation[i]) for p in (reference, actual))), single
        )
        for found in (many[i], tensors[i].numpy()):
            np.testing.assert_allclose(found, single, rtol=0, atol=2e-15)


@pytest.mark.parametrize("angle", ANGLES)
def test_a_displaced_pose_has_that_error_on_every_backend(angle):
    reference, _, vectors = poses(angle)
    error = np.concatenate([RNG.normal(size=vectors.shape), vectors], axis=1)
    moved = displace_pose(reference, error)
    np.testing.assert_allclose(moved.rotation, rotation_matrix(vectors) @ reference.rotation, rtol=0, atol=2e-15)
    np.testing.assert_array_equal(moved.position, reference.position + error[:, :3])
    for i, frame in enumerate(frames(reference)):
        single = displaced_frame(math, frame, error[i].tolist())
        np.testing.assert_allclose(single, frame_of(Pose(moved.position[i], moved.rotation[i])), rtol=0, atol=1e-15)


def test_single_poses_and_batches_broadcast():
    reference, actual, _ = poses(1.0)
    one = Pose(reference.position[0], reference.rotation[0])
    np.testing.assert_allclose(
        pose_error(one, actual)[0], pose_error(one, Pose(actual.position[0], actual.rotation[0]))
    )
    moved = displace_pose(one, np.zeros((2, 3, 6)))
    assert moved.position.shape == (2, 3, 3) and moved.rotation.shape == (2, 3, 3, 3)
    assert pose_error(one, moved).shape == (2, 3, 6)


def turned(angles, seed=0):
    """Axes of frames, and of the same frames turned by angles ``(N,)``: nine components each."""
    rng = np.random.default_rng(seed)
    axes = rng.normal(size=(len(angles), 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    before = rotation_matrix(rng.normal(size=(len(angles), 3)))
    after = rotation_matrix(axes * angles[:, None]) @ before
    return [list(np.ascontiguousarray(np.moveaxis(r, (-1, -2), (0, 1)).reshape(9, -1))) for r in (before, after)]


def test_small_rotations_are_the_same_and_large_ones_too():
    edge = math.asin(SMALL_SINE)
    angles = np.array([0.0, 1e-9, 1e-4, 0.03, 0.99 * edge, 1.01 * edge, 0.5, math.pi / 2, 2.0, 3.1, math.pi - 1e-9])
    before, after = turned(angles)
    expected = np.stack(rotation_between(np, before, after))
    np.testing.assert_allclose(np.stack(small_rotation(np, before, after)), expected, rtol=1e-12, atol=1e-15)
    for i in range(len(angles)):
        alone = small_rotation(math, *([float(part[i]) for part in frame] for frame in (before, after)))
        np.testing.assert_allclose(alone, expected[:, i], rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize("angle", [0.3, 3.0])
def test_whoever_runs_what_is_traced_is_told_of_large_rotations(angle):
    pytest.importorskip("llvmlite")
    from pickenv.arm.kinematics.machine_code import SYMBOLS, Compiled, Trace

    before, after = turned(np.array([0.01, angle]))
    trace = Trace()
    numbers = trace.inputs("frames", 18)
    vector = small_rotation(SYMBOLS, numbers[:9], numbers[9:])
    (large,) = trace.exceptions
    arrays = {"frames": np.array([*before, *after]), "vector": np.empty((3, 2)), "large": np.empty((1, 2))}
    outputs = trace.outputs("vector", vector) + trace.outputs("large", [SYMBOLS.where(large, 1.0, 0.0)])
    Compiled(trace, outputs, 2).bound(arrays, 2)()
    np.testing.assert_array_equal(arrays["large"], [[0.0, 1.0]])
    expected = np.stack(small_rotation(np, before, after))
    np.testing.assert_array_equal(arrays["vector"][:, 0], expected[:, 0])
