"""Outliers are found, named, and pull no longer."""

from dataclasses import replace

import numpy as np
import pytest

from pickenv.arm import Geometry, Plant, rotation_matrix
from pickenv.base import InputError
from pickenv.calibration import (
    Measurements,
    align,
    complete_model,
    frames_model,
    identify,
    link_model,
    random_joints,
    simulated_tracker,
)
from pickenv.calibration.identification.robust import (
    OUTLIER_SIGMA,
    Sizes,
    misses_of,
    robust_align,
    robust_identify,
    sigma_of,
)


def rms(geometry: Geometry, data: Measurements) -> float:
    return float(np.sqrt(np.mean(np.sum(data.difference(geometry)[:, :3] ** 2, axis=1))))


def spoiled(data: Measurements, rows: np.ndarray, size: float, rng: np.random.Generator) -> Measurements:
    """``data`` with the positions of some rows moved by ``size`` m in random directions."""
    away = rng.normal(size=(len(rows), 3))
    position = data.position.copy()
    position[rows] += size * away / np.linalg.norm(away, axis=1, keepdims=True)
    return replace(data, position=position)


def tracked(plant: Plant, poses: int, seed: int) -> Measurements:
    rng = np.random.default_rng(seed)
    return simulated_tracker(plant, random_joints(plant.arm.nominal, poses, rng), rng)


def outliers(sizes: Sizes) -> list[int]:
    return np.flatnonzero(sizes[0] > OUTLIER_SIGMA).tolist()


@pytest.mark.parametrize("seed", range(3))
def test_outliers_of_100_mm_are_found_and_named(dynamic: Plant, seed: int) -> None:
    rng = np.random.default_rng(seed)
    nominal, data, held_out = dynamic.arm.nominal, tracked(dynamic, 100, seed), tracked(dynamic, 1000, 50 + seed)
    rows = rng.choice(100, 8, replace=False)
    model = link_model(nominal)
    bad = spoiled(data, rows, 0.1, rng)
    found, (sigma, weights, scales) = robust_identify(model, nominal, bad)
    assert outliers((sigma, weights, scales)) == sorted(rows)
    assert misses_of(found, bad)[rows] == pytest.approx(0.1, rel=0.05)
    assert np.all(sigma[rows] > 100)
    assert np.all(weights[rows] < 0.02)
    clean, pulled = identify(model, nominal, data).geometry, identify(model, nominal, bad).geometry
    assert rms(found.geometry, held_out) < 1.05 * rms(clean, held_out) < 0.2 * rms(pulled, held_out)


def test_a_wrong_attitude_is_found_too(dynamic: Plant) -> None:
    nominal, data = dynamic.arm.nominal, tracked(dynamic, 100, 0)
    assert data.rotation is not None
    rotation = data.rotation.copy()
    rotation[7] = rotation_matrix([0.0, 0.05, 0.0]) @ rotation[7]
    _, sizes = robust_identify(link_model(nominal), nominal, replace(data, rotation=rotation))
    assert outliers(sizes) == [7]
    assert sizes[0][7] * sizes[2][1] * data.attitude_std == pytest.approx(0.05, rel=0.1)


def test_clean_data_have_no_outliers_and_lose_nothing(dynamic: Plant) -> None:
    nominal, data, held_out = dynamic.arm.nominal, tracked(dynamic, 100, 1), tracked(dynamic, 1000, 2)
    found, sizes = robust_identify(link_model(nominal), nominal, data)
    assert not outliers(sizes)
    plain = identify(link_model(nominal), nominal, data)
    assert rms(found.geometry, held_out) < 1.05 * rms(plain.geometry, held_out)


@pytest.mark.parametrize(("share", "fault"), [(0.05, "100 mm"), (0.3, "100 mm"), (0.2, "zeros")])
def test_a_measured_arm_is_calibrated_through_gross_errors(
    measured_ur5: tuple[Geometry, Measurements], share: float, fault: str
) -> None:
    """Lost reflectors that were written as zeros, and jumps of the tracker: held-out RMS stays within 2 %."""
    geometry, data = measured_ur5
    rng = np.random.default_rng(3)
    order = rng.permutation(len(data))
    train, test = data.select(order[:800]), data.select(order[800:])
    rows = rng.choice(800, int(800 * share), replace=False)
    bad = spoiled(train, rows, 0.1, rng)
    if fault == "zeros":
        bad.position[rows] = 0.0
    frames, model = frames_model(geometry), complete_model(geometry)
    start = robust_align(geometry, bad, frames, rng)
    assert set(rows) <= set(np.flatnonzero(sigma_of(start, bad) > OUTLIER_SIGMA))
    found, sizes = robust_identify(model, start.geometry, bad)
    assert set(outliers(sizes)) == set(rows)
    clean = identify(model, align(geometry, train, frames).geometry, train)
    assert rms(found.geometry, test) < 1.02 * rms(clean.geometry, test)


def test_robust_alignment_agrees_with_alignment_on_clean_data(measured_ur5: tuple[Geometry, Measurements]) -> None:
    geometry, data = measured_ur5
    frames = frames_model(geometry)
    robust = robust_align(geometry, data, frames, np.random.default_rng(0))
    assert not np.any(sigma_of(robust, data) > OUTLIER_SIGMA)
    np.testing.assert_allclose(robust.geometry.base.position, align(geometry, data, frames).geometry.base.position)


def test_few_poses_are_refused(dynamic: Plant) -> None:
    nominal, data = dynamic.arm.nominal, tracked(dynamic, 100, 0)
    with pytest.raises(InputError, match="too few to tell outliers"):
        robust_align(nominal, data.select(np.arange(5)), frames_model(nominal), np.random.default_rng(0))
