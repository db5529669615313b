"""The Kalman filter ends where least squares ends, keeps an honest covariance, and follows an arm that warms up."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from pickenv.arm import (
    Geometry,
    MeasurementNoise,
    Plant,
    Pose,
    displace_pose,
    forward,
    joint_jacobian,
    load_arm,
    parameter_jacobian,
    pose_error,
)
from pickenv.base import InputError
from pickenv.calibration import (
    ArmModel,
    Conditions,
    Measurements,
    ThermalTerm,
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
    with_terms,
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


def seen(state, q, innovation):
    """The pose whose innovation is the one given ``(6,)``."""
    return displace_pose(state.arm_model.pose(q), innovation)


def test_a_new_filter_knows_nothing_within_ten_tolerances(qiao, state):
    found = identify(link_model(qiao.nominal), qiao.nominal, exact_poses(qiao, 40)).identifiability
    assert state.names == found.kept_names and len(state.names) == 16
    tolerance = dict(zip(link_model(qiao.nominal).names, link_model(qiao.nominal).tolerance, strict=True))
    np.testing.assert_allclose(state.standard_deviation, [10.0 * tolerance[name] for name in state.names])
    assert (state.updates, state.rejected, state.nis, len(state.innovation)) == (0, 0, 0.0, 0)
    joints = exact_poses(qiao, 40).joints
    wide = start_filter(link_model(qiao.nominal), qiao.nominal, joints, prior=3.0, full_pose=False)
    assert len(wide.names) == 14  # positions alone tell two fewer apart
    np.testing.assert_allclose(wide.standard_deviation, [3.0 * tolerance[name] for name in wide.names])


def exact_poses(qiao, count):
    joints = random_joints(qiao.nominal, count, np.random.default_rng(2))
    return Measurements(joints, *forward(qiao.true, joints), prismatic=qiao.nominal.prismatic)


@pytest.mark.parametrize("rows", [6, 3])
def test_an_update_is_the_textbooks(qiao, learned, rows):
    """Gain P H^T S^-1, covariance (I - K H) P, NIS v^T S^-1 v, in matrices written out."""
    q = random_joints(qiao.nominal, 1, np.random.default_rng(3))[0]
    target = forward(qiao.true, q)
    after = update(learned, q, target if rows == 6 else target.position, NOISE)
    h = parameter_jacobian(learned.geometry, q)[:rows][:, learned.columns]
    p, r = learned.covariance, np.diag([4e-8] * 3 + [25e-8] * 3)[:rows, :rows]
    s = h @ p @ h.T + r
    gain = p @ h.T @ np.linalg.inv(s)
    v = pose_error(forward(learned.geometry, q), target)[:rows]
    np.testing.assert_allclose(after.innovation, v, atol=1e-12)
    assert after.nis == pytest.approx(v @ np.linalg.inv(s) @ v, rel=1e-6)
    expected = (np.eye(len(p)) - gain @ h) @ p
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    np.testing.assert_allclose(after.covariance / scale, expected / scale, atol=1e-6)
    moved = learned.arm_model.difference(after.arm_model)
    np.testing.assert_allclose(moved[learned.columns], gain @ v, atol=1e-9)
    assert np.delete(moved, learned.columns) == pytest.approx(0.0, abs=1e-15)
    assert (after.updates, after.rejected) == (learned.updates + 1, 0)


@pytest.mark.parametrize("rows", [6, 3])
@pytest.mark.parametrize("chance", [0.9, 0.9999])
def test_the_gate_stands_at_the_quantile_of_chi_squared(qiao, learned, rows, chance):
    """From both sides: an innovation along one axis, sized for a hair more and a hair less."""
    q = random_joints(qiao.nominal, 1, np.random.default_rng(4))[0]
    direction = np.zeros(6)
    direction[1] = 1e-4
    pose = seen(learned, q, direction)
    unit = update(learned, q, pose if rows == 6 else pose.position, NOISE).nis
    edge = np.sqrt(stats.chi2.ppf(chance, rows) / unit)
    told = []
    for share in (1 - 1e-5, 1 + 1e-5):
        pose = seen(learned, q, edge * share * direction)
        after = update(learned, q, pose if rows == 6 else pose.position, NOISE, gate=chance)
        told.append((after.updates - learned.updates, after.rejected))
        assert after.nis == pytest.approx(stats.chi2.ppf(chance, rows), rel=1e-3)
    assert told == [(1, 0), (0, 1)]


def test_the_gate_refuses_as_many_honest_poses_as_it_says(qiao, learned):
    """Innovations drawn from the filter's own covariance: 400 draws at 90 %, so 40 of them, give or take 6."""
    rng, refused = np.random.default_rng(5), 0
    q = random_joints(qiao.nominal, 1, rng)[0]
    spread = learned.pose_covariance(q) + np.diag([4e-8] * 3 + [25e-8] * 3)
    for innovation in rng.multivariate_normal(np.zeros(6), spread, size=400):
        refused += update(learned, q, seen(learned, q, innovation), NOISE, gate=0.9).rejected
    assert 22 <= refused <= 58  # three standard deviations


def test_a_refused_pose_changes_nothing_but_the_counts(qiao, learned):
    q = random_joints(qiao.nominal, 1, np.random.default_rng(6))[0]
    after = update(learned, q, seen(learned, q, np.full(6, 0.2)), NOISE, gate=0.99)
    assert after.rejected == 1 and after.updates == learned.updates and after.arm_model is learned.arm_model
    np.testing.assert_array_equal(after.covariance, learned.covariance)
    assert np.abs(after.innovation).max() > 0.1
    again = update(after, q, seen(learned, q, np.full(6, 0.2)), NOISE, gate=0.99)
    assert again.rejected == 2


def test_a_random_walk_adds_its_tolerances_in_an_hour(learned):
    noise = random_walk(learned, 0.3)
    for seconds in (3600.0, 900.0):
        later = predict(learned, noise, seconds)
        gained = later.covariance - learned.covariance
        np.testing.assert_allclose(np.diag(gained), seconds / 3600 * (0.3 * learned.tolerance) ** 2, rtol=1e-6)
        np.testing.assert_allclose(gained, np.diag(np.diag(gained)), atol=1e-18)
        assert later.arm_model is learned.arm_model and later.updates == learned.updates


def test_links_that_grow_move_the_tool_as_the_forward_kinematics_say(qiao, state):
    """One hour at 5 K per root hour: the tool's variance is the square of what 5 K move it, aluminium or steel."""
    probe = random_joints(qiao.nominal, 60, np.random.default_rng(7))
    for expansion, more in ((23e-6, {}), (12e-6, {"expansion": 12e-6})):
        walk = thermal_walk(state, probe, 5.0, **more)
        spread = replace(state, covariance=walk * 3600.0).pose_covariance(probe)[:, :3, :3]
        grown = 1.0 + expansion * 5.0
        warm = replace(qiao.nominal, a=qiao.nominal.a * grown, d=qiao.nominal.d * grown)
        moved = forward(warm, probe).position - forward(qiao.nominal, probe).position
        np.testing.assert_allclose(np.trace(spread, axis1=1, axis2=2), np.sum(moved**2, axis=1), rtol=1e-2)


@pytest.mark.parametrize("name", ["qiao2026", "ur5"])
def test_joint_zeros_that_wander_move_the_tool_as_the_joints_do(name):
    """One hour: the sum over joints of (drift times the joint's Jacobian column), each joint on its own."""
    nominal = load_arm(name).nominal
    probe = random_joints(nominal, 60, np.random.default_rng(8))
    state = start_filter(link_model(nominal), nominal, probe)
    walk = offset_walk(state, probe, 2e-4, 3e-4)
    spread = replace(state, covariance=walk * 3600.0).pose_covariance(probe)
    columns = joint_jacobian(nominal, probe) * np.where(nominal.prismatic, 2e-4, 3e-4)
    np.testing.assert_allclose(spread, columns @ np.swapaxes(columns, 1, 2), atol=1e-3 * np.abs(spread).max())


def test_a_filter_goes_on_with_the_scatter_of_least_squares(qiao):
    nominal, model = qiao.nominal, complete_model(qiao.nominal)
    data = exact_poses(qiao, 40)
    noisy = replace(data, position=data.position + 1e-4 * np.random.default_rng(9).normal(size=(40, 3)))
    found = identify(model, nominal, noisy)
    state = continue_filter(model, found)
    np.testing.assert_allclose(state.covariance, found.covariance)
    assert state.names == found.identifiability.kept_names and state.geometry is found.geometry
    tolerance = dict(zip(model.names, model.tolerance, strict=True))
    np.testing.assert_array_equal(state.tolerance, [tolerance[name] for name in state.names])
    np.testing.assert_allclose(continue_filter(model, found, inflation=3.0).covariance, 9.0 * found.covariance)
    with pytest.raises(InputError, match="no covariance to go on from"):
        continue_filter(model, replace(found, covariance=np.full_like(found.covariance, np.nan)))


@pytest.mark.parametrize("positions", [False, True])
def test_one_pass_is_row_after_row(qiao, positions):
    """The same states as updates by hand; innovations, NIS, refusals and change of parameters as they were."""
    nominal, model = qiao.nominal, link_model(qiao.nominal)
    data = exact_poses(qiao, 25)
    position = data.position.copy()
    position[[9, 17]] += 0.2
    data = replace(data, position=position, position_std=2e-4, attitude_std=5e-4)
    data = data.positions_only() if positions else data
    found = filter_measurements(model, nominal, data, gate=0.99999)
    state = start_filter(model, nominal, data.joints, full_pose=not positions)
    nis = []
    for i in range(25):
        observed = data.position[i] if positions else Pose(data.position[i], data.rotation[i])
        state = update(state, data.joints[i], observed, NOISE, gate=0.99999)
        np.testing.assert_allclose(found.innovations[i], state.innovation, atol=1e-15)
        nis.append(state.nis)
    np.testing.assert_allclose(found.nis, nis)
    np.testing.assert_allclose(found.state.covariance, state.covariance)
    assert found.rejected == (9, 17) and found.state.rejected == 2 and found.state.updates == 23
    kept = np.delete(nis, [9, 17])
    coordinates = 3 if positions else 6
    assert found.consistency == pytest.approx(kept.mean() / coordinates)
    for k, name in enumerate(model.names):
        kind, joint = name.rstrip("0123456789"), int(name.lstrip("abcdefghijklmnopqrstuvwxyz"))
        joint -= kind in ("theta", "d")  # Craig's alpha and a count from 0
        assert found.delta[k] == pytest.approx(
            getattr(found.geometry, kind)[joint] - getattr(nominal, kind)[joint], abs=1e-12
        )
        known = name in found.identifiability.kept_names
        assert np.isfinite(found.standard_deviation[k]) == known and (known or found.delta[k] == 0.0)


def test_each_pose_is_predicted_at_its_own_temperature(qiao):
    """Links grow with the temperature of each row; the filter learns by how much, and each innovation shrinks."""
    start = ArmModel.of(qiao.nominal, (ThermalTerm(),))
    data = exact_poses(qiao, 40)
    conditions = Conditions(temperature=np.random.default_rng(1).uniform(-20.0, 20.0, 40))
    change = np.zeros(len(start.parameter_names))
    change[start.parameter_names.index("thermal")] = 23e-6
    pose = start.displaced(change).pose(data.joints, conditions)
    data = replace(data, position=pose.position, rotation=pose.rotation, conditions=conditions)
    model = with_terms(link_model(qiao.nominal), start)
    noise = MeasurementNoise(1e-5, 1e-5)
    found = filter_measurements(model, start, data, noise=noise)
    state = start_filter(link_model(qiao.nominal), qiao.nominal, data.joints)
    blind = filter_measurements(link_model(qiao.nominal), qiao.nominal, data, noise=noise)
    assert "thermal" in " ".join(found.state.names) and "thermal" not in " ".join(state.names)
    late = [np.abs(each.innovations[-10:]).max() for each in (found, blind)]
    assert late[0] < 0.1 * late[1]


def test_where_every_pose_is_refused_nothing_can_be_said_of_the_noise(qiao):
    data = exact_poses(qiao, 8)
    found = filter_measurements(
        link_model(qiao.nominal), qiao.nominal, replace(data, position=data.position + 5.0), gate=0.9
    )
    assert found.rejected == tuple(range(8)) and np.isnan(found.consistency)


def test_as_many_coordinates_as_parameters_are_enough_to_choose_from(qiao):
    joints = random_joints(qiao.nominal, 8, np.random.default_rng(0))
    model = link_model(qiao.nominal)  # 24 parameters
    start_filter(model, qiao.nominal, joints[:4])
    start_filter(model, qiao.nominal, joints, full_pose=False)
    with pytest.raises(InputError, match=r"^3 poses cannot decide which of 24 .* at least 4 poses"):
        start_filter(model, qiao.nominal, joints[:3])
    with pytest.raises(InputError, match=r"^7 poses cannot decide which of 24 .* at least 8 poses"):
        start_filter(model, qiao.nominal, joints[:7], full_pose=False)
