"""Li's recognition finds rendered fruit to millimetres, and fails where the paper says it does: clusters and leaves."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from pickenv.orchard import (
    StereoPair,
    foliage_transmission,
    fruit_mask,
    fruit_regions,
    load_canopy,
    load_look,
    load_stereo_camera,
    locate,
    match_detections,
    project,
    render_stereo,
    sample_leaves,
    triangulate,
)

quick = settings(deadline=None, derandomize=True)

CAMERA, LOOK = load_stereo_camera("li2016"), load_look("red_apples")
GRID = np.stack(np.meshgrid(np.linspace(-0.45, 0.45, 4), np.linspace(-0.3, 0.3, 3)), axis=-1).reshape(-1, 2)
Scene = tuple[np.ndarray, StereoPair, np.ndarray, np.ndarray]


def scene(seed: int, leaf_area_per_volume: float) -> Scene:
    """Nine apples apart from one another a metre away, behind and among leaves; places, images, what is found."""
    rng = np.random.default_rng(seed)
    across = GRID[rng.permutation(12)[:9]] + rng.uniform(-0.04, 0.04, (9, 2))
    positions = np.column_stack([across, rng.uniform(1.0, 1.4, 9)])
    leaves = sample_leaves([-0.8, -0.6, 1.0], [0.8, 0.6, 1.4], leaf_area_per_volume, LOOK, rng)
    pair = render_stereo(CAMERA, positions, 0.075, leaves, LOOK, rng)
    seen, _ = locate(CAMERA, pair.left, pair.right)
    return positions, pair, seen, match_detections(seen, positions, within=0.08)


def errors(scenes: list[Scene]) -> np.ndarray:
    return np.concatenate([seen[fruit >= 0] - p[fruit[fruit >= 0]] for p, _, seen, fruit in scenes])


@pytest.fixture(scope="module")
def bare() -> list[Scene]:
    return [scene(seed, 0.0) for seed in range(5)]


@pytest.fixture(scope="module")
def leafy() -> list[Scene]:
    return [scene(seed, 2.7) for seed in range(5)]


def test_the_camera_is_the_papers() -> None:
    assert (CAMERA.baseline, CAMERA.image) == (0.12, (640, 480))
    assert CAMERA.focal_length * 7.4e-6 == pytest.approx(3.8e-3, rel=1e-3)
    assert (CAMERA.erosions, CAMERA.dilations, CAMERA.least_area_share) == (2, 2, 0.2)


@quick
@given(st.floats(-1, 1), st.floats(-1, 1), st.floats(0.3, 5))
def test_triangulation_undoes_projection(x: float, y: float, z: float) -> None:
    assert triangulate(CAMERA, project(CAMERA, [x, y, z])) == pytest.approx([x, y, z], abs=1e-9)


def test_bare_fruit_is_found_to_millimetres(bare: list[Scene]) -> None:
    found = [(fruit >= 0).sum() for *_, fruit in bare]
    rms = np.sqrt(np.mean(errors(bare) ** 2, axis=0))
    assert sum(found) >= 0.95 * 45
    assert (rms[:2] < 1.5e-3).all() and rms[2] < 5e-3


def test_nothing_else_is_taken_for_bare_fruit(bare: list[Scene]) -> None:
    assert all((fruit >= 0).all() for *_, fruit in bare)


def test_leaves_cost_fruit_and_accuracy(bare: list[Scene], leafy: list[Scene]) -> None:
    assert sum(len(seen) for _, _, seen, _ in leafy) < sum(len(seen) for _, _, seen, _ in bare)
    assert (np.sqrt(np.mean(errors(leafy) ** 2, axis=0)) > 2 * np.sqrt(np.mean(errors(bare) ** 2, axis=0))).all()
    assert np.mean([p.visible.mean() for _, p, *_ in leafy]) < 0.9 < np.mean([p.visible.mean() for _, p, *_ in bare])


@pytest.mark.parametrize("leaf_area_per_volume", [1.25, pytest.param(2.7, marks=pytest.mark.slow)])
def test_rendered_leaves_hide_as_much_as_beer_and_lambert_say(leaf_area_per_volume: float) -> None:
    """Two models of the same foliage: leaf by leaf in pictures, and as a medium that dims with depth."""
    rng, shares, expected = np.random.default_rng(0), [], []
    canopy = replace(load_canopy("li2016"), leaf_area_per_volume=leaf_area_per_volume)
    for _ in range(8):
        positions = np.column_stack([GRID, rng.uniform(1.05, 1.4, len(GRID))])
        leaves = sample_leaves([-0.9, -0.7, 1.0], [0.9, 0.7, 1.4], leaf_area_per_volume, LOOK, rng)
        shares.append(render_stereo(CAMERA, positions, 0.06, leaves, LOOK, rng).visible)
        behind = np.stack([0.0 * positions[:, 2], positions[:, 2] - 1.0 - 0.02, 0.0 * positions[:, 2] + 1.6], axis=-1)
        expected.append(foliage_transmission(canopy, [0.0, -1.0, 1.6], behind))  # 20 mm: mean depth of its near side
    error = np.std(shares) / np.sqrt(np.size(shares))
    assert error < 0.03
    assert np.mean(shares) == pytest.approx(np.mean(expected), abs=3 * error)


def test_leaves_pull_the_centroid_to_the_visible_side_by_less_than_a_radius(leafy: list[Scene]) -> None:
    lateral = np.linalg.norm(errors(leafy)[:, :2], axis=-1)
    assert np.quantile(lateral, 0.9) < 0.0375 / 2


def test_matches_of_bare_fruit_agree(bare: list[Scene]) -> None:
    _, pair, *_ = bare[0]
    _, agreement = locate(CAMERA, pair.left, pair.right)
    assert ((agreement > 0.5) & (agreement <= 1)).all()


def test_two_touching_apples_are_one_region() -> None:
    """The paper leaves clusters aside."""
    rng = np.random.default_rng(0)
    pair = render_stereo(CAMERA, [[-0.037, 0, 1.2], [0.037, 0, 1.2]], 0.075, np.zeros((0, 3)), LOOK, rng)
    assert len(fruit_regions(CAMERA, pair.left)[0]) == 1


def test_regions_under_a_fifth_of_the_largest_are_dropped() -> None:
    rng = np.random.default_rng(0)
    scene_ = [[-0.2, 0, 1.0], [0.2, 0, 1.0]]
    areas = [
        len(fruit_regions(CAMERA, render_stereo(CAMERA, scene_, [0.08, d], np.zeros((0, 3)), LOOK, rng).left)[0])
        for d in (0.045, 0.03)
    ]
    assert areas == [2, 1]


def test_leaves_alone_are_no_fruit() -> None:
    rng = np.random.default_rng(2)
    leaves = sample_leaves([-0.8, -0.6, 1.0], [0.8, 0.6, 1.4], 2.0, LOOK, rng)
    pair = render_stereo(CAMERA, np.zeros((0, 3)), 0.075, leaves, LOOK, rng)
    assert len(locate(CAMERA, pair.left, pair.right)[0]) == 0
    black = np.zeros_like(pair.left)
    assert len(locate(CAMERA, black, black)[0]) == 0


def test_what_a_pixel_shows_agrees_with_its_colour(bare: list[Scene]) -> None:
    _, pair, *_ = bare[0]
    mask = fruit_mask(CAMERA, pair.left)
    assert ((pair.shows >= 0) == mask).mean() > 0.995


def test_one_seed_gives_one_picture() -> None:
    (_, a, *_), (_, b, *_) = scene(4, 1.0), scene(4, 1.0)
    np.testing.assert_array_equal(a.left, b.left)
    np.testing.assert_array_equal(a.right, b.right)
