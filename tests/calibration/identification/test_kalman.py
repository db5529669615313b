"""The Kalman filter ends where least squares ends, keeps an honest covariance, and follows an arm that warms up."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from pickenv.arm import Geometry, MeasurementNoise, Plant, displace_pose, forward
from pickenv.base import InputError
from pickenv.calibration import (
    Measurements,
    align,
    complete_model,
    continue_filter,
    filter_measurements,
    frames_model,
    identify,
    link_model,
    offset_walk,
    random_joints,
    random_walk,
    simulated_tracker,
    start_filter,
    thermal_walk,
)
from pickenv.calibration.identification.extended_kalman_filter import FilterState, predict, update

CAMERA = MeasurementNoise(3e-3, float(np.radians(0.5)))


def mean_error(geometry: Geometry, data: Measurements) -> float:
    return float(np.linalg.norm(data.difference(geometry)[:, :3], axis=1).mean())


def tracked(plant: Plant, poses: int, seed: int) -> Measurements:
    rng = np.random.default_rng(seed)
    return simulated_tracker(plant, random_joints(plant.arm.nominal, poses, rng), rng)


@pytest.mark.parametrize("seed", range(4))
def test_one_pass_ends_within_5_percent_of_least_squares(dynamic: Plant, seed: int) -> None:
    nominal, data, held_out = dynamic.arm.nominal, tracked(dynamic, 100, seed), tracked(dynamic, 1000, 100 + seed)
    model = link_model(nominal)
    squares, filtered = identify(model, nominal, data), filter_measurements(model, nominal, data)
    assert filtered.identifiability.kept_names == squares.identifiability.kept_names
    assert mean_error(filtered.geometry, held_out) == pytest.approx(mean_error(squares.geometry, held_out), rel=0.05)


def test_positions_alone_do_as_well(dynamic: Plant) -> None:
    nominal, data = dynamic.arm.nominal, tracked(dynamic, 100, 0).positions_only()
    held_out = tracked(dynamic, 1000, 9)
    model = link_model(nominal)
    squares, filtered = identify(model, nominal, data), filter_measurements(model, nominal, data)
    assert len(filtered.state.columns) == 14
    assert mean_error(filtered.geometry, held_out) == pytest.approx(mean_error(squares.geometry, held_out), rel=0.05)


def test_a_measured_arm_ends_near_least_squares(measured_ur5: tuple[Geometry, Measurements]) -> None:
    geometry, data = measured_ur5
    order = np.random.default_rng(0).permutation(len(data))
    train, test = data.select(order[:800]), data.select(order[800:])
    start = align(geometry, train, frames_model(geometry)).geometry
    model = complete_model(geometry)
    squares, filtered = identify(model, start, train), filter_measurements(model, start, train)
    assert mean_error(filtered.geometry, test) == pytest.approx(mean_error(squares.geometry, test), rel=0.05)


def test_the_covariance_tells_the_truth(table_1: Plant) -> None:
    """Over many data sets the error of the parameters, in its own covariance, is as large as chi squared says."""
    nominal = table_1.arm.nominal
    model, noise = link_model(nominal), MeasurementNoise(1e-4, 1e-4)
    noisy = table_1.with_effect(noise)
    sizes, nis = [], []
    for seed in range(20):
        filtered = filter_measurements(model, nominal, tracked(noisy, 60, seed), noise=noise)
        probe = random_joints(nominal, 5, np.random.default_rng(seed))
        miss = forward(filtered.geometry, probe).position - forward(table_1.geometry, probe).position
        spread = filtered.state.pose_covariance(probe)[:, :3, :3]
        sizes += np.einsum("ni,nij,nj->n", miss, np.linalg.inv(spread), miss).tolist()
        nis.append(filtered.consistency)
    assert 2.0 < np.mean(sizes) < 4.5  # three coordinates
    assert 0.8 < np.mean(nis) < 1.2


def test_the_covariance_stays_positive_from_a_vague_prior_and_an_exact_instrument(table_1: Plant) -> None:
    nominal, noise = table_1.arm.nominal, MeasurementNoise(1e-9, 1e-9)
    filtered = filter_measurements(link_model(nominal), nominal, tracked(table_1, 60, 0), noise=noise, prior=1e3)
    covariance = filtered.state.covariance
    np.testing.assert_array_equal(covariance, covariance.T)
    assert np.linalg.eigvalsh(covariance).min() >= -1e-12 * np.linalg.eigvalsh(covariance).max()


def test_an_update_changes_nothing_but_what_it_returns(table_1: Plant) -> None:
    nominal, data = table_1.arm.nominal, tracked(table_1, 30, 0)
    state = start_filter(link_model(nominal), nominal, data.joints)
    before = state.covariance.copy()
    after = update(state, data.joints[0], forward(table_1.geometry, data.joints[0]), CAMERA)
    np.testing.assert_array_equal(state.covariance, before)
    assert (state.updates, after.updates) == (0, 1)
    assert np.all(after.standard_deviation <= state.standard_deviation * (1 + 1e-12))
    assert state.geometry is nominal


def test_the_gate_refuses_outliers_and_names_them(table_1: Plant) -> None:
    nominal, data = table_1.arm.nominal, tracked(table_1.with_effect(CAMERA), 200, 3)
    position = data.position.copy()
    position[[50, 120]] += [0.1, 0.0, 0.0]
    spoiled = replace(data, position=position)
    model = link_model(nominal)
    gated = filter_measurements(model, nominal, spoiled, noise=CAMERA, gate=1 - 1e-6)
    assert gated.rejected == (50, 120)
    held_out = tracked(table_1, 500, 4)
    clean, open_ = (filter_measurements(model, nominal, d, noise=CAMERA).geometry for d in (data, spoiled))
    assert mean_error(gated.geometry, held_out) < 1.1 * mean_error(clean, held_out) < mean_error(open_, held_out)


def test_going_on_from_least_squares_keeps_its_estimate_and_covariance(dynamic: Plant) -> None:
    nominal, model = dynamic.arm.nominal, link_model(dynamic.arm.nominal)
    squares = identify(model, nominal, tracked(dynamic, 100, 0))
    state = continue_filter(model, squares, inflation=2.0)
    assert state.names == squares.identifiability.kept_names
    np.testing.assert_allclose(state.covariance, 4.0 * squares.covariance)


def warmed(geometry: Geometry, kelvin: float, turn: float = 1e-3, shift: float = 0.5e-3) -> Geometry:
    """The geometry ``kelvin`` warmer: links grow as aluminium, and joint zeros drift by so much per 20 K."""
    grown, share = 1.0 + 23e-6 * kelvin, kelvin / 20.0
    turns, shifts = np.array([1, 0, 0, -1, 0, 1]), np.array([0, 1, -1, 0, 1, 0])
    return replace(
        geometry,
        a=geometry.a * grown,
        d=geometry.d * grown + share * shift * shifts,
        theta=geometry.theta + share * turn * turns,
    )


def followed(
    plant: Plant,
    drifted: Callable[[float], Geometry],
    noise_of: Callable[[FilterState, np.ndarray], np.ndarray],
    seed: int,
) -> tuple[float, float]:
    """Mean position error over three hours without and with the filter, one camera observation every 6 s, m."""
    rng = np.random.default_rng(seed)
    nominal = plant.arm.nominal
    model = link_model(nominal)
    identified = identify(model, nominal, simulated_tracker(plant, random_joints(nominal, 100, rng), rng))
    state, probe = continue_filter(model, identified), random_joints(nominal, 100, rng)
    process_noise, period = noise_of(state, probe), 6.0
    before = forward(identified.geometry, probe).position
    left, kept = [], []
    for i in range(1800):
        true = drifted(20.0 * (1.0 - np.exp(-(i + 1) * period / 3600.0)))
        joints = rng.uniform(nominal.lower, nominal.upper)
        seen = displace_pose(
            forward(true, joints), rng.normal(size=6) * np.repeat([CAMERA.position_std, CAMERA.attitude_std], 3)
        )
        state = update(predict(state, process_noise, period), joints, seen, CAMERA)
        if i % 30 == 29:
            there = forward(true, probe).position
            left.append(np.linalg.norm(before - there, axis=1).mean())
            kept.append(np.linalg.norm(forward(state.geometry, probe).position - there, axis=1).mean())
    return float(np.mean(left)), float(np.mean(kept))


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_a_camera_follows_a_warm_up_of_20_kelvin(table_1: Plant, seed: int) -> None:
    drift, error = followed(
        table_1,
        lambda kelvin: warmed(table_1.geometry, kelvin),
        lambda state, probe: thermal_walk(state, probe, 10.0) + offset_walk(state, probe, 0.4e-3, 0.4e-3),
        seed,
    )
    assert 0.8e-3 < drift < 1.1e-3
    assert error < 0.5 * drift


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
def test_it_follows_without_knowing_the_cause(table_1: Plant, seed: int) -> None:
    drift, error = followed(
        table_1, lambda kelvin: warmed(table_1.geometry, kelvin), lambda state, _: random_walk(state, 0.3), seed
    )
    assert error < 0.5 * drift


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
def test_growth_alone_is_followed_below_a_tenth_of_a_millimetre(table_1: Plant, seed: int) -> None:
    drift, error = followed(
        table_1,
        lambda kelvin: warmed(table_1.geometry, kelvin, 0.0, 0.0),
        lambda state, probe: thermal_walk(state, probe, 10.0),
        seed,
    )
    assert error < 0.5 * drift
    assert error < 1e-4


def test_thermal_walk_is_one_direction_and_reproduces_the_growth(table_1: Plant) -> None:
    nominal = table_1.arm.nominal
    probe = random_joints(nominal, 100, np.random.default_rng(0))
    state = start_filter(link_model(nominal), nominal, probe)
    walk = thermal_walk(state, probe, 20.0) * 3600.0  # what an hour adds
    assert np.linalg.matrix_rank(walk, tol=1e-6 * np.linalg.norm(walk)) == 1
    spread = replace(state, covariance=walk).pose_covariance(probe)[:, :3, :3]
    grown = forward(warmed(nominal, 20.0, 0.0, 0.0), probe).position - forward(nominal, probe).position
    np.testing.assert_allclose(np.trace(spread, axis1=1, axis2=2), np.sum(grown**2, axis=1), rtol=1e-2)


def test_bad_observations_are_refused(table_1: Plant) -> None:
    nominal, data = table_1.arm.nominal, tracked(table_1, 30, 0)
    state = start_filter(link_model(nominal), nominal, data.joints)
    with pytest.raises(InputError, match="not finite"):
        update(state, data.joints[0], [np.nan, 0.0, 0.0], CAMERA)
    with pytest.raises(InputError, match="cannot decide"):
        start_filter(link_model(nominal), nominal, data.joints[:2])
