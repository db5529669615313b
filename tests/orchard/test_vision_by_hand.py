"""Masks, regions and matches of pictures made pixel by pixel, against SciPy's morphology and plain correlations."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

from pickenv.base import InputError
from pickenv.orchard import (
    StereoCamera,
    fruit_mask,
    fruit_regions,
    load_stereo_camera,
    locate,
    project,
    red_minus_green,
    triangulate,
)

CAMERA = load_stereo_camera("li2016")
SQUARE = np.ones((3, 3))


def picture(difference):
    """An image whose R - G is as given, -255 to 255."""
    difference = np.asarray(difference)
    image = np.zeros((*difference.shape, 3), dtype=np.uint8)
    image[..., 0], image[..., 1] = np.maximum(difference, 0), np.maximum(-difference, 0)
    return image


def blobs(rng, shape=(120, 160)):
    """Smooth blobs, some touching at corners only, and specks."""
    smooth = ndimage.gaussian_filter(rng.normal(size=shape), 5.0)
    fruit = (smooth > 1.2 * smooth.std()) | (rng.random(shape) < 0.01)
    return fruit


@pytest.mark.parametrize("changes", [{}, {"erosions": 1}, {"dilations": 3}, {"least_area_share": 0.5}, {"erosions": 0}])
def test_the_mask_is_erosions_then_large_regions_then_dilations(changes):
    camera = replace(CAMERA, **changes)
    for seed in range(4):
        fruit = blobs(np.random.default_rng(seed))
        mask = ndimage.binary_erosion(fruit, SQUARE, camera.erosions, border_value=1) if camera.erosions else fruit
        labels, count = ndimage.label(mask, SQUARE)
        areas = ndimage.sum_labels(mask, labels, np.arange(count + 1))
        kept = areas >= camera.least_area_share * areas.max()
        wanted = ndimage.binary_dilation((kept & (areas > 0))[labels], SQUARE, camera.dilations)
        assert 1 < kept.sum() <= count
        np.testing.assert_array_equal(fruit_mask(camera, picture(np.where(fruit, 120, -90))), wanted)


def test_what_is_not_redder_than_green_is_no_fruit_whatever_otsu_says():
    """Grey stands out from green, but its R - G is zero."""
    grey = np.full((60, 60), -100)
    grey[20:40, 20:40] = 0
    assert not fruit_mask(CAMERA, picture(grey)).any()
    assert fruit_mask(CAMERA, picture(np.where(grey == 0, 1, -100))).any()
    np.testing.assert_array_equal(red_minus_green(picture(grey)), grey)
    flat = fruit_mask(CAMERA, picture(np.full((60, 60), 7)))
    assert flat.dtype == bool and flat.shape == (60, 60) and not flat.any()


def test_regions_are_counted_where_they_lie():
    difference = np.full((60, 90), -50)
    difference[10:30, 40:70] = 100  # 20 rows, 30 columns
    difference[40:54, 5:24] = 100  # 14 rows, 19 columns
    centroids, boxes = fruit_regions(CAMERA, picture(difference))
    assert centroids.tolist() == [[54.5, 19.5], [14.0, 46.5]]
    assert boxes.tolist() == [[10, 40, 30, 70], [40, 5, 54, 24]] and boxes.dtype == np.int64
    assert fruit_mask(CAMERA, picture(difference)).sum() == 600 + 266


def pair(disparity, rng, row=200, column=300, size=(30, 40), noise=12.0):
    """Two pictures of one textured fruit on a noisy ground, ``disparity`` columns further left in the right one."""
    height, width = CAMERA.image[1], CAMERA.image[0]
    texture = 120 + rng.normal(0.0, noise, size)
    sides = []
    for first in (column, column - disparity):
        ground = -60 + rng.normal(0.0, noise, (height, width))
        ground[row : row + size[0], first : first + size[1]] = texture + rng.normal(0.0, noise, size)
        sides.append(np.rint(ground).clip(-255, 255).astype(int))
    return sides


def referee(left, right, row, column, size, disparity):
    """Confidence and sub-pixel disparity of the fruit's patch with its 3 px around, by plain correlations."""
    rows = slice(max(row - 3, 0), min(row + size[0] + 3, len(left)))
    columns = slice(column - 3, min(column + size[1] + 3, len(left[0])))
    patch = left[rows, columns].ravel()
    shifts = np.arange(disparity - 1, disparity + 2)
    score = [np.corrcoef(patch, right[rows, columns.start - d : columns.stop - d].ravel())[0, 1] for d in shifts]
    square, linear, _ = np.polyfit([-1.0, 0.0, 1.0], score, 2)
    return score[1], disparity - linear / (2 * square)


@pytest.mark.parametrize(
    ("disparity", "row", "column"),
    [(25, 200, 300), (61, 200, 300), (102, 200, 300), (61, 0, 300), (61, 450, 300), (61, 200, 600)],
)
def test_depth_is_base_line_and_focal_length_over_the_disparity_of_the_best_match(disparity, row, column):
    """The match reads the fruit and 3 px around it, as far as there are any, to a fraction of a pixel by a parabola."""
    left, right = pair(disparity, np.random.default_rng(disparity), row=row, column=column)
    places, agreement = locate(CAMERA, picture(left), picture(right))
    confidence, exact = referee(left, right, row, column, (30, 40), disparity)
    assert len(places) == len(fruit_regions(CAMERA, picture(left))[0]) == 1
    assert agreement[0] == pytest.approx(confidence, abs=1e-9)
    assert places[0, 2] == pytest.approx(CAMERA.focal_length * CAMERA.baseline / exact, rel=1e-9)


@pytest.mark.parametrize(("disparity", "found"), [(24, True), (103, True), (22, False), (105, False)])
def test_matches_are_looked_for_between_the_nearest_and_the_farthest_distance(disparity, found):
    """513.5 x 0.12/0.6 = 102.7, rounded up, to 61.62/2.5 = 24.6, rounded down."""
    left, right = pair(disparity, np.random.default_rng(disparity), noise=3.0)
    depths = locate(CAMERA, picture(left), picture(right))[0][:, 2]
    wanted = CAMERA.focal_length * CAMERA.baseline / disparity
    assert bool(np.any(np.abs(depths - wanted) < 0.01 * wanted)) == found


def test_a_fruit_whose_match_would_lie_outside_the_right_picture_is_left_out():
    left, right = pair(5, np.random.default_rng(0), column=10)
    assert len(fruit_regions(CAMERA, picture(left))[0]) == 1
    assert len(locate(CAMERA, picture(left), picture(right))[0]) == 0


def test_a_match_may_begin_with_the_right_pictures_first_column():
    """The patch begins 3 px before the fruit, at column 61 of the left picture, and at 0 of the right one."""
    left, right = pair(61, np.random.default_rng(4), column=64, noise=3.0)
    places, _ = locate(CAMERA, picture(left), picture(right))
    assert places[:, 2] == pytest.approx([513.5 * 0.12 / 61])


def test_a_match_counts_from_the_correlation_that_the_camera_asks_for():
    left, right = pair(61, np.random.default_rng(2))
    confidence = float(locate(CAMERA, picture(left), picture(right))[1][0])
    for share, count in ((confidence - 1e-6, 1), (confidence, 1), (confidence + 1e-6, 0)):
        assert len(locate(replace(CAMERA, least_correlation=share), picture(left), picture(right))[0]) == count


def test_projection_has_its_centre_in_the_middle_of_the_picture():
    """At 1 m ahead, 0.1 m right and 0.2 m down: 51.35 and 102.7 px from (319.5, 239.5), and a disparity of 61.62."""
    assert project(CAMERA, [0.1, 0.2, 1.0]) == pytest.approx([319.5 + 51.35, 239.5 + 102.7, 61.62])
    assert triangulate(CAMERA, [319.5, 239.5, 0.5]) == pytest.approx([0.0, 0.0, 61.62 / 0.5])
    assert project(CAMERA, [0.0, 0.0, 1e-3])[2] == pytest.approx(61_620.0)
    for nothing in ([0.0, 0.0, 0.0], [0.0, 0.0, -1.0]):
        with pytest.raises(InputError, match="behind the camera"):
            project(CAMERA, nothing)
        with pytest.raises(InputError, match="not above zero"):
            triangulate(CAMERA, nothing)


def test_a_stereo_camera_takes_3_px_around_a_region_unless_told_otherwise():
    given = {name: getattr(CAMERA, name) for name in CAMERA.__dataclass_fields__ if name != "margin"}
    assert StereoCamera(**given).margin == 3
    with pytest.raises(InputError, match="raise nearest"):
        StereoCamera(**(given | {"nearest": 513.5 * 0.12 / 640}))
    StereoCamera(**(given | {"nearest": 513.5 * 0.12 / 639.9}))
