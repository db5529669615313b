"""Each term of a camera's error, worked out by hand; a camera of round numbers looks ahead from the origin."""

import math
from dataclasses import replace

import numpy as np
import pytest

from pickenv.orchard import (
    DRAWS,
    Camera,
    camera_frame,
    depth_bias,
    depth_noise,
    detection_probability,
    in_image,
    measured_positions,
)

ORIGIN, AHEAD = np.zeros(3), np.array([0.0, 1.0, 0.0])
PLAIN = Camera("plain", "by hand", focal_length=500.0, image=(800, 600), nearest=0.5, farthest=3.0, depth_noise=0.0,
               pixel_noise=0.0)  # fmt: skip


def seen(camera, position, draws, **more):
    return measured_positions(camera, position, ORIGIN, np.array(draws, dtype=float), **more)


def test_a_camera_of_which_nothing_else_is_said_does_not_err():
    draws = np.random.default_rng(0).normal(size=(20, DRAWS))
    fruit = np.random.default_rng(1).uniform([-1, 1, -1], [1, 2, 1], (20, 3))
    found = measured_positions(PLAIN, fruit, ORIGIN, draws, visible=0.1, diameters=0.08)
    np.testing.assert_allclose(found, fruit, atol=1e-15)
    assert detection_probability(PLAIN, 1.0, 1e-9) == 1.0


def test_depth_noise_is_floor_and_square_law_and_grows_with_light():
    """At 2 m: sqrt(3^2 + (1 x 2^2)^2) = 5 mm, and exp(1e-5 x 50 000) times as much in 50 000 lx more."""
    camera = replace(PLAIN, depth_noise_floor=0.003, depth_noise=0.001, noise_growth=1e-5, noise_light=20_000.0)
    assert depth_noise(replace(camera, light=20_000.0), 2.0) == pytest.approx(0.005)
    assert depth_noise(replace(camera, light=0.0), 2.0) == pytest.approx(0.005 * math.exp(-0.2))  # at night
    corners = depth_bias(replace(camera, bias=0.01, bias_distance=1.0, bias_per_distance=0.02), [1.0, 3.0])
    assert corners == pytest.approx([0.01, 0.05])
    assert depth_noise(replace(camera, light=70_000.0), 2.0) == pytest.approx(0.005 * math.exp(0.5))
    assert depth_noise(camera, 2.0) == pytest.approx(0.005 * math.exp(0.8))  # a clear day, 100 000 lx
    assert depth_bias(replace(camera, bias_per_light=1e-7), 2.0) == pytest.approx(0.01)


def test_noise_lies_across_and_along_the_line_of_sight():
    """2 px at 1.5 m and a focal length of 500 px are 6 mm; 4 mm/m^2 are 9 mm there; bias 10 mm beyond."""
    camera = replace(PLAIN, pixel_noise=2.0, depth_noise=0.004, bias=0.010)
    found = seen(camera, [0.0, 1.5, 0.0], [1.0, -2.0, 3.0, 9.0, 9.0])
    assert found == pytest.approx([0.006, 1.5 + 0.010 + 3 * 0.009, -0.012])
    sideways = seen(camera, [1.5, 0.0, 0.0], [1.0, -2.0, 3.0, 9.0, 9.0])  # right of that ray is towards -y
    assert sideways == pytest.approx([1.537, -0.006, -0.012])


def test_leaves_pull_to_a_random_side_and_fruit_to_the_known_one():
    """Hidden by 3/4, half a radius of 40 mm at the most: 15 mm; draws 3 and 4 give a side of 3/5 and 4/5."""
    camera = replace(PLAIN, occlusion_pull=0.5)
    hidden = {"visible": 0.25, "diameters": 0.08}
    draws = [0.0, 0.0, 0.0, 0.3, 0.4]
    assert seen(camera, [0.0, 1.0, 0.0], draws, **hidden) == pytest.approx([0.009, 1.0, 0.012])
    for side in ([0.0, 0.0, 2.0], [0.0, 0.0, 0.5]):
        known = seen(camera, [0.0, 1.0, 0.0], draws, **hidden, visible_side=side)
        assert known == pytest.approx([0.0, 1.0, 0.015])
    unknown = seen(camera, [0.0, 1.0, 0.0], draws, **hidden, visible_side=[0.0, 0.0, 0.0])
    assert unknown == pytest.approx([0.009, 1.0, 0.012])
    assert seen(camera, [0.0, 1.0, 0.0], draws, visible=7.0, diameters=0.08) == pytest.approx([0.0, 1.0, 0.0])


@pytest.mark.parametrize(
    ("distance", "visible", "wanted"),
    [(1.0, 0.19, 0.0), (1.0, 0.3, 0.2), (1.0, 0.4, 0.4), (1.0, 0.6, 0.8), (1.0, 0.9, 0.8),
     (0.49, 1.0, 0.0), (0.5, 1.0, 0.8), (3.0, 1.0, 0.8), (3.01, 1.0, 0.0)],
)  # fmt: skip
def test_what_is_reported_rises_from_the_share_where_all_is_lost_to_where_dropout_alone_loses(
    distance, visible, wanted
):
    camera = replace(PLAIN, dropout=0.2, lost_below=0.2, found_above=0.6)
    assert detection_probability(camera, distance, visible) == pytest.approx(wanted)


def test_the_picture_ends_at_half_its_size_over_the_focal_length():
    """400 px of 500 sideways and 300 upwards: 0.8 and 0.6 m at 1 m, twice that at 2 m; behind there is nothing."""
    inside = [[0.8, 1, 0.6], [0.79, 1, 0], [-0.79, 1, 0], [0, 1, 0.59], [0, 1, -0.59], [1.59, 2, -1.19]]
    outside = [[0.81, 1, 0], [-0.81, 1, 0], [0, 1, 0.61], [0, 1, -0.61], [0, -1, 0], [0, 0, 0], [1.59, 1, 0]]
    assert in_image(PLAIN, inside, ORIGIN, AHEAD).all() and not in_image(PLAIN, outside, ORIGIN, AHEAD).any()


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_camera_that_looks_straight_up_or_down_has_its_rows_along_x(sign):
    """And its axes are right-handed: x right, y down, z ahead."""
    axes = camera_frame(np.eye(3), ORIGIN, [0.0, 0.0, sign]).T
    np.testing.assert_allclose(axes, [[1, 0, 0], [0, sign, 0], [0, 0, sign]], atol=1e-12)
