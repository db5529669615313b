"""The Kalman filter ends where least squares ends, keeps an honest covariance, and follows an arm that warms up."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from pickenv.arm import (
    Geometry,
    MeasurementNoise,
    Plant,
    Pose,
    displace_pose,
    forward,
    parameter_jacobian,
    pose_error,
)
from pickenv.base import InputError
from pickenv.calibration import (
    Measurements,
    align,
    complete_model,
    frames_model,
    identify,
    link_model,
    random_joints,
    random_walk,
    simulated_tracker,
    start_filter,
)
from pickenv.calibration.identification.solve import FilterState, predict, update
from pickenv.calibration.pipeline.calibration import PoseUncertainty

CAMERA = MeasurementNoise(3e-3, float(np.radians(0.5)))


def names_of(state: FilterState) -> tuple[str, ...]:
    """Names of the estimated parameters."""
    return tuple(state.arm_model.parameter_names[k] for k in state.columns)


def mean_error(geometry: Geometry, data: Measurements) -> float:
    return float(np.linalg.norm(data.difference(geometry)[:, :3], axis=1).mean())


def tracked(plant: Plant, poses: int, seed: int) -> Measurements:
    rng = np.random.default_rng(seed)
    return simulated_tracker(plant, random_joints(plant.arm.nominal, poses, rng), rng)


def filtered_over(model, start, data: Measurements) -> FilterState:
    """One pass over a data set, with its stated noise."""
    state = start_filter(model, start, data.joints, full_pose=data.rotation is not None)
    noise = MeasurementNoise(data.position_std, data.attitude_std)
    for i in range(len(data)):
        observed = data.position[i] if data.rotation is None else Pose(data.position[i], data.rotation[i])
        state = update(state, data.joints[i], observed, noise)
    return state


@pytest.mark.parametrize("seed", range(4))
def test_one_pass_ends_within_5_percent_of_least_squares(dynamic: Plant, seed: int) -> None:
    nominal, data, held_out = dynamic.arm.nominal, tracked(dynamic, 100, seed), tracked(dynamic, 1000, 100 + seed)
    model = link_model(nominal)
    squares, filtered = identify(model, nominal, data), filtered_over(model, nominal, data)
    assert names_of(filtered) == squares.identifiability.kept_names
    assert mean_error(filtered.geometry, held_out) == pytest.approx(mean_error(squares.geometry, held_out), rel=0.05)


def test_positions_alone_do_as_well(dynamic: Plant) -> None:
    nominal, data = dynamic.arm.nominal, tracked(dynamic, 100, 0).positions_only()
    held_out = tracked(dynamic, 1000, 9)
    model = link_model(nominal)
    squares, filtered = identify(model, nominal, data), filtered_over(model, nominal, data)
    assert len(filtered.columns) == 14
    assert mean_error(filtered.geometry, held_out) == pytest.approx(mean_error(squares.geometry, held_out), rel=0.05)


def test_a_measured_arm_ends_near_least_squares(measured_ur5: tuple[Geometry, Measurements]) -> None:
    geometry, data = measured_ur5
    order = np.random.default_rng(0).permutation(len(data))
    train, test = data.select(order[:800]), data.select(order[800:])
    start = align(geometry, train, frames_model(geometry)).geometry
    model = complete_model(geometry)
    squares, filtered = identify(model, start, train), filtered_over(model, start, train)
    assert mean_error(filtered.geometry, test) == pytest.approx(mean_error(squares.geometry, test), rel=0.05)


@pytest.mark.slow
def test_the_covariance_tells_the_truth(table_1: Plant) -> None:
    """Over many data sets the error of the parameters, in its own covariance, is as large as chi squared says."""
    nominal = table_1.arm.nominal
    model, noise = link_model(nominal), MeasurementNoise(1e-4, 1e-4)
    noisy = table_1.with_effect(noise)
    sizes = []
    for seed in range(20):
        filtered = filtered_over(model, nominal, tracked(noisy, 60, seed))
        probe = random_joints(nominal, 5, np.random.default_rng(seed))
        miss = forward(filtered.geometry, probe).position - forward(table_1.geometry, probe).position
        known = PoseUncertainty(names_of(filtered), filtered.covariance, 0.0, 0.0)
        spread = known.pose_covariance(filtered.arm_model, probe)[:, :3, :3]
        sizes += np.einsum("ni,nij,nj->n", miss, np.linalg.inv(spread), miss).tolist()
    assert 2.0 < np.mean(sizes) < 4.5  # three coordinates


def test_the_covariance_stays_positive_from_a_vague_prior_and_an_exact_instrument(table_1: Plant) -> None:
    nominal, noise = table_1.arm.nominal, MeasurementNoise(1e-9, 1e-9)
    joints = random_joints(nominal, 60, np.random.default_rng(0))
    state = start_filter(link_model(nominal), nominal, joints, prior=1e3)
    for q in joints:
        state = update(state, q, forward(table_1.geometry, q), noise)
    covariance = state.covariance
    np.testing.assert_array_equal(covariance, covariance.T)
    assert np.linalg.eigvalsh(covariance).min() >= -1e-12 * np.linalg.eigvalsh(covariance).max()


def test_an_update_changes_nothing_but_what_it_returns(table_1: Plant) -> None:
    nominal, data = table_1.arm.nominal, tracked(table_1, 30, 0)
    state = start_filter(link_model(nominal), nominal, data.joints)
    before = state.covariance.copy()
    after = update(state, data.joints[0], forward(table_1.geometry, data.joints[0]), CAMERA)
    np.testing.assert_array_equal(state.covariance, before)
    assert np.all(np.sqrt(np.diag(after.covariance)) <= np.sqrt(np.diag(state.covariance)) * (1 + 1e-12))
    assert state.geometry is nominal


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
    state = filtered_over(model, nominal, simulated_tracker(plant, random_joints(nominal, 100, rng), rng))
    probe = random_joints(nominal, 100, rng)
    process_noise, period = noise_of(state, probe), 6.0
    before = forward(state.geometry, probe).position
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


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
def test_it_follows_without_knowing_the_cause(table_1: Plant, seed: int) -> None:
    drift, error = followed(
        table_1, lambda kelvin: warmed(table_1.geometry, kelvin), lambda state, _: random_walk(state, 0.3), seed
    )
    assert error < 0.5 * drift


def test_bad_observations_are_refused(table_1: Plant) -> None:
    nominal, data = table_1.arm.nominal, tracked(table_1, 30, 0)
    state = start_filter(link_model(nominal), nominal, data.joints)
    with pytest.raises(InputError, match="not finite"):
        update(state, data.joints[0], [np.nan, 0.0, 0.0], CAMERA)
    with pytest.raises(InputError, match="cannot decide"):
        start_filter(link_model(nominal), nominal, data.joints[:2])


# Each step of the Kalman filter against its textbook formula, and what an hour of drift adds.
NOISE = MeasurementNoise(2e-4, 5e-4)


@pytest.fixture(scope="module")
def state(qiao):
    joints = random_joints(qiao.nominal, 40, np.random.default_rng(0))
    return start_filter(link_model(qiao.nominal), qiao.nominal, joints)


@pytest.fixture(scope="module")
def learned(qiao, state):
    """A state that correlates: after six poses of the true arm."""
    for q in random_joints(qiao.nominal, 6, np.random.default_rng(1)):
        state = update(state, q, forward(qiao.true, q), NOISE)
    return state


def test_a_new_filter_knows_nothing_within_ten_tolerances(qiao, state):
    found = identify(link_model(qiao.nominal), qiao.nominal, exact_poses(qiao, 40)).identifiability
    assert names_of(state) == found.kept_names and len(names_of(state)) == 16
    tolerance = dict(zip(link_model(qiao.nominal).names, link_model(qiao.nominal).tolerance, strict=True))
    np.testing.assert_allclose(np.sqrt(np.diag(state.covariance)), [10.0 * tolerance[name] for name in names_of(state)])
    joints = exact_poses(qiao, 40).joints
    wide = start_filter(link_model(qiao.nominal), qiao.nominal, joints, prior=3.0, full_pose=False)
    assert len(names_of(wide)) == 14  # positions alone tell two fewer apart
    np.testing.assert_allclose(np.sqrt(np.diag(wide.covariance)), [3.0 * tolerance[name] for name in names_of(wide)])


def exact_poses(qiao, count):
    joints = random_joints(qiao.nominal, count, np.random.default_rng(2))
    return Measurements(joints, *forward(qiao.true, joints), prismatic=qiao.nominal.prismatic)


@pytest.mark.parametrize("rows", [6, 3])
def test_an_update_is_the_textbooks(qiao, learned, rows):
    """Gain P H^T S^-1, covariance (I - K H) P, in matrices written out."""
    q = random_joints(qiao.nominal, 1, np.random.default_rng(3))[0]
    target = forward(qiao.true, q)
    after = update(learned, q, target if rows == 6 else target.position, NOISE)
    h = parameter_jacobian(learned.geometry, q)[:rows][:, learned.columns]
    p, r = learned.covariance, np.diag([4e-8] * 3 + [25e-8] * 3)[:rows, :rows]
    s = h @ p @ h.T + r
    gain = p @ h.T @ np.linalg.inv(s)
    v = pose_error(forward(learned.geometry, q), target)[:rows]
    expected = (np.eye(len(p)) - gain @ h) @ p
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    np.testing.assert_allclose(after.covariance / scale, expected / scale, atol=1e-6)
    moved = learned.arm_model.difference(after.arm_model)
    np.testing.assert_allclose(moved[learned.columns], gain @ v, atol=1e-9)
    assert np.delete(moved, learned.columns) == pytest.approx(0.0, abs=1e-15)


def test_a_random_walk_adds_its_tolerances_in_an_hour(learned):
    noise = random_walk(learned, 0.3)
    for seconds in (3600.0, 900.0):
        later = predict(learned, noise, seconds)
        gained = later.covariance - learned.covariance
        np.testing.assert_allclose(np.diag(gained), seconds / 3600 * (0.3 * learned.tolerance) ** 2, rtol=1e-6)
        np.testing.assert_allclose(gained, np.diag(np.diag(gained)), atol=1e-18)
        assert later.arm_model is learned.arm_model


def test_as_many_coordinates_as_parameters_are_enough_to_choose_from(qiao):
    joints = random_joints(qiao.nominal, 8, np.random.default_rng(0))
    model = link_model(qiao.nominal)  # 24 parameters
    start_filter(model, qiao.nominal, joints[:4])
    start_filter(model, qiao.nominal, joints, full_pose=False)
    with pytest.raises(InputError, match=r"^3 poses cannot decide which of 24 .* at least 4 poses"):
        start_filter(model, qiao.nominal, joints[:3])
    with pytest.raises(InputError, match=r"^7 poses cannot decide which of 24 .* at least 8 poses"):
        start_filter(model, qiao.nominal, joints[:7], full_pose=False)
