"""Series in the place of functions: the same up to roundings, and up to none where both are compiled and not."""

import math

import numpy as np
import pytest

from pickenv.arm.kinematics.pose_error import SMALL_SINE, rotation_between, rotation_matrix, small_rotation
from pickenv.arm.kinematics.series import Series
from pickenv.arm.kinematics.tracing import SYMBOLS, Outputs, Trace


@pytest.mark.parametrize("most", [1e-8, 0.8, 7.0, 1000.0])
def test_sines_and_cosines_are_right_to_roundings(most):
    angles = np.random.default_rng(0).uniform(-most, most, 20_000)
    angles[:9] = np.arange(-4, 5) * math.pi / 2
    wide = angles.astype(np.longdouble)
    for found, expected in ((Series(np).sin(angles), np.sin(wide)), (Series(np).cos(angles), np.cos(wide))):
        assert np.abs(found - expected).max() < 4.5e-16
    small = angles[np.abs(angles) < 1e-3]
    np.testing.assert_allclose(Series(np).sin(small), np.sin(small), rtol=1e-15, atol=1e-19)


def test_compiled_series_have_the_bits_of_numpy():
    pytest.importorskip("llvmlite")
    from pickenv.arm.kinematics.machine_code import Compiled

    def both(m, angle):
        return [Series(m).sin(angle), Series(m).cos(angle)]

    angles, found, trace = np.random.default_rng(1).uniform(-7, 7, (1, 3001)), np.empty((2, 3001)), Trace()
    Compiled(trace, [Outputs("found", both(SYMBOLS, *trace.inputs("angles", 1)))], 3001).run(
        {"angles": angles, "found": found}, 3001
    )
    np.testing.assert_array_equal(found, both(np, angles[0]))


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
    from pickenv.arm.kinematics.machine_code import Compiled

    before, after = turned(np.array([0.01, angle]))
    trace = Trace()
    numbers = trace.inputs("frames", 18)
    vector = small_rotation(SYMBOLS, numbers[:9], numbers[9:])
    (large,) = trace.exceptions
    arrays = {"frames": np.array([*before, *after]), "vector": np.empty((3, 2)), "large": np.empty((1, 2))}
    outputs = [Outputs("vector", vector), Outputs("large", [SYMBOLS.where(large, 1.0, 0.0)])]
    Compiled(trace, outputs, 2).run(arrays, 2)
    np.testing.assert_array_equal(arrays["large"], [[0.0, 1.0]])
    expected = np.stack(small_rotation(np, before, after))
    np.testing.assert_array_equal(arrays["vector"][:, 0], expected[:, 0])
