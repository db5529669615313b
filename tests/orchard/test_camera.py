"""Cameras err as their sources say: bias, noise with the square of distance, light, dropout, pull of occlusion."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from pickenv.orchard import (
    DRAWS,
    Camera,
    camera_frame,
    depth_bias,
    depth_noise,
    detection_probability,
    load_camera,
    match_detections,
    measured_positions,
    orchard_frame,
    shipped,
)

quick = settings(deadline=None, derandomize=True)

ORIGIN, AHEAD = np.zeros(3), np.array([0.0, 1.0, 0.0])
units = st.floats(-1.0, 1.0)


def depth_errors(camera: Camera, distance: float, light: float) -> np.ndarray:
    draws = np.random.default_rng(0).normal(size=(20_000, DRAWS))
    camera = replace(camera, light=light)
    return measured_positions(camera, [0.0, distance, 0.0], ORIGIN, draws)[:, 1] - distance


def test_azure_kinect_in_sun_at_one_and_a_half_metres() -> None:
    error = depth_errors(load_camera("azure_kinect"), 1.5, 100_000)
    assert error.mean() == pytest.approx(0.017, abs=2e-4)
    assert error.std() == pytest.approx(0.006, abs=1e-4)


def test_the_bias_grows_by_what_it_is_said_to_grow_with_distance_and_light() -> None:
    """Written out at four corners; no shipped camera errs with light, one of a user may."""
    camera = replace(
        load_camera("perfect"), bias=0.01, bias_distance=1.0, bias_light=40_000.0, bias_per_distance=0.02,
        bias_per_light=5e-7,
    )  # fmt: skip
    cases = zip([1.0, 2.0, 1.0, 2.0], [40_000.0, 40_000.0, 100_000.0, 0.0], strict=True)
    found = [float(depth_bias(replace(camera, light=light), distance)) for distance, light in cases]
    assert found == pytest.approx([0.01, 0.03, 0.04, 0.01])
    assert depth_errors(camera, 1.0, 100_000).mean() == pytest.approx(0.04)


@pytest.mark.parametrize(("light", "rmse"), [(53_800, 0.0391), (106_150, 0.0836)])
def test_d455f_outdoors_errs_39_to_84_mm(light: float, rmse: float) -> None:
    assert np.sqrt(np.mean(depth_errors(load_camera("d455f"), 1.5, light) ** 2)) == pytest.approx(rmse, rel=0.02)


@pytest.mark.parametrize(("distance", "error"), [(1.0, 0.0069), (1.6, 0.0112)])
def test_the_laser_line_is_good_to_millimetres(distance: float, error: float) -> None:
    assert depth_noise(load_camera("laser_line"), distance) == pytest.approx(error, rel=0.01)


@quick
@given(units, st.floats(0.6, 3.0), units, st.integers(0, 2**32))
def test_the_perfect_camera_does_not_err(x: float, y: float, z: float, seed: int) -> None:
    draws = np.random.default_rng(seed).normal(size=DRAWS)
    seen = measured_positions(load_camera("perfect"), [x, y, z], ORIGIN, draws, visible=0.3, diameters=0.08)
    assert seen == pytest.approx([x, y, z], abs=1e-12)


def test_stereo_noise_grows_with_the_square_of_distance() -> None:
    camera = load_camera("bumblebee2")
    assert camera.depth_noise == 0.5 / (513.5 * 0.120)
    assert depth_noise(camera, 2.0) == pytest.approx(4 * depth_noise(camera, 1.0))
    assert depth_noise(camera, 1.0) == pytest.approx(0.0081, abs=1e-4)


@quick
@given(st.floats(0.0, 1.0), st.integers(0, 2**32))
def test_occlusion_pulls_to_the_visible_side_by_at_most_half_a_radius(visible: float, seed: int) -> None:
    camera, side = load_camera("azure_kinect"), np.array([1.0, 0.0, 0.0])
    draws = np.random.default_rng(seed).normal(size=DRAWS)
    seen = [
        measured_positions(camera, [0.2, 1.2, 0.1], ORIGIN, draws, visible=v, diameters=0.08, visible_side=side)
        for v in (1.0, visible)
    ]
    pull = seen[1] - seen[0]
    assert pull == pytest.approx([0.5 * 0.04 * (1 - visible), 0.0, 0.0], abs=1e-12)


def test_where_leaves_hide_it_the_pull_goes_anywhere_across_the_line_of_sight() -> None:
    camera = load_camera("azure_kinect")
    draws = np.zeros((4000, DRAWS))
    draws[:, 3:] = np.random.default_rng(1).normal(size=(4000, 2))
    seen = measured_positions(camera, [0.0, 1.0, 0.0], ORIGIN, draws, visible=0.4, diameters=0.08)
    pull = seen - [0.0, 1.017, 0.0]
    assert np.linalg.norm(pull, axis=-1) == pytest.approx(0.012)
    assert pull[:, 1] == pytest.approx(0.0, abs=1e-12)
    assert np.abs(pull.mean(axis=0)).max() < 5e-4


@quick
@given(st.floats(0.0, 1.0), st.floats(0.0, 1.0))
def test_the_more_is_visible_the_likelier_it_is_found(a: float, b: float) -> None:
    for name in shipped("camera"):
        camera = load_camera(name)
        low, high = detection_probability(camera, 1.0, sorted((a, b)))
        assert 0.0 <= low <= high <= 1.0


@quick
@given(st.tuples(units, units, units), st.tuples(units, units, units))
def test_the_camera_frame_and_back(position: tuple, looking: tuple) -> None:
    looking = np.add(looking, [0.0, 2.5, 0.0])
    there = camera_frame(position, [0.1, -1.0, 1.5], looking)
    assert orchard_frame(there, [0.1, -1.0, 1.5], looking) == pytest.approx(position, abs=1e-9)
    assert np.linalg.norm(there) == pytest.approx(np.linalg.norm(np.subtract(position, [0.1, -1.0, 1.5])))


def test_a_level_camera_sees_right_to_the_right_and_up_above() -> None:
    right, down, ahead = camera_frame([0.3, 2.0, 0.2], ORIGIN, AHEAD)
    assert (right, down, ahead) == pytest.approx((0.3, -0.2, 2.0))


def test_detections_are_named_by_the_nearest_fruit_one_to_one() -> None:
    named = match_detections(
        [[0.0, 0, 1], [0.02, 0, 1], [5.0, 0, 1]], [[0.03, 0, 1], [0.001, 0, 1], [2.0, 0, 1]], within=0.05
    )
    assert named.tolist() == [1, 0, -1]


@pytest.mark.parametrize("looking", [[0.0, 0.0, 1.0], [0.0, 0.0, -2.0], [1.0, 1.0, 0.3], [0.0, -1.0, 1e-12]])
def test_a_camera_has_right_handed_axes_wherever_it_looks(looking: list[float]) -> None:
    axes = camera_frame(np.eye(3), ORIGIN, looking).T  # rows: right, down, ahead
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(axes) == pytest.approx(1.0)


def test_a_batch_errs_as_single_measurements_do() -> None:
    rng, camera = np.random.default_rng(2), load_camera("d455f")
    fruit, draws = rng.uniform([-1, 1, 0], [1, 2, 1], (4, 6, 3)), rng.normal(size=(4, 6, DRAWS))
    view, visible = rng.uniform(-0.5, 0.5, (4, 6, 3)), rng.random((4, 6))
    side = rng.normal(size=(4, 6, 3)) * (rng.random((4, 6, 1)) > 0.5)
    arguments = {"visible": visible, "visible_side": side}
    many = measured_positions(camera, fruit, view, draws, diameters=0.07, **arguments)
    at = (2, 3)
    single = {name: value[at] for name, value in arguments.items()}
    one = measured_positions(camera, fruit[at], view[at], draws[at], diameters=0.07, **single)
    np.testing.assert_array_equal(many[at], one)
