"""Identification by least squares (Qiao 2026 eqs (11)-(12)): exact without noise, honest about its uncertainty."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from pickenv.arm import forward, load_arm, parameter_jacobian, rotation_matrix
from pickenv.base import InputError
from pickenv.calibration import (
    ArmModel,
    ErrorModel,
    Measurements,
    complete_model,
    identify,
    identify_converged,
    link_model,
    random_joints,
)
from pickenv.calibration.identification import least_squares
from pickenv.calibration.identification.least_squares import REDUNDANCY_TOLERANCE, is_angle

PAPER_DROPS = {"a2", "a3", "a5", "d3", "d4", "theta2", "d6"}
BASE_16 = {f"alpha{i}" for i in range(6)} | {"a0", "a1", "a4", "theta1", "theta3", "theta4", "theta5", "d1", "d3", "d5"}


def some_of(model, names):
    rows = [i for i, name in enumerate(model.names) if name in names]
    return ErrorModel(model.columns[rows], tuple(model.names[i] for i in rows), model.tolerance[rows])


def moved(model, geometry, change, rows=slice(None)):
    delta = np.zeros(len(geometry.parameter_names))
    delta[model.columns[rows]] = change
    return geometry.displaced(delta)


def position_mm(geometry, data):
    return np.linalg.norm(data.difference(geometry)[:, :3], axis=1) * 1e3


@given(arm=st.sampled_from(["qiao2026", "ur5", "wam"]), positions=st.booleans(), seed=st.integers(0, 2**32 - 1))
@settings(max_examples=25, deadline=None)
def test_base_parameters_are_recovered_exactly_without_noise(exact, arm, positions, seed):
    nominal = load_arm(arm).nominal
    model = complete_model(nominal)
    blank = exact(nominal, 80, seed).positions_only() if positions else exact(nominal, 80, seed)
    kept = identify(model, nominal, blank).identifiability.kept
    change = np.random.default_rng(seed).normal(size=len(kept)) * model.tolerance[kept]
    truth = moved(model, nominal, change, kept)
    pose = forward(truth, blank.joints)
    data = replace(blank, position=pose.position, rotation=None if positions else pose.rotation)
    found = identify(model, nominal, data)
    assert found.converged and found.kind == ("position" if positions else "pose")
    np.testing.assert_allclose(found.delta[kept], change, atol=1e-9)
    assert np.delete(found.delta, kept) == pytest.approx(0)


def test_table_1_is_explained_by_the_base_set(qiao, exact):
    """Fact 3: the base 16 leave less than 1e-4 mm, and their values are the sums that the null relations tell."""
    model = some_of(link_model(qiao.nominal), BASE_16)
    found = identify(model, qiao.nominal, exact(qiao.true, 100))
    assert found.converged and found.identifiability.rank == 16
    assert position_mm(found.geometry, exact(qiao.true, 2000, seed=1)).max() < 1.2e-4
    value = dict(zip(found.identifiability.names, found.delta, strict=True))
    assert value["a1"] * 1e3 == pytest.approx(1.390, abs=1e-3)
    assert value["a4"] * 1e3 == pytest.approx(1.010, abs=1e-3)
    assert value["d1"] * 1e3 == pytest.approx(0.512, abs=1e-3)
    assert value["d5"] * 1e3 == pytest.approx(0.700, abs=1e-3)
    assert np.degrees(value["theta5"]) == pytest.approx(0.074, abs=1e-4)


def test_keeping_theta2_instead_of_d3_leaves_a_third_of_a_micrometre(qiao, exact):
    """The reason for the model's order: of a tied offset and angle only the offset is exact to second order."""
    found = identify(link_model(qiao.nominal), qiao.nominal, exact(qiao.true, 100))
    assert set(found.identifiability.kept_names) == set(BASE_16)
    angle_kept = some_of(link_model(qiao.nominal), (set(BASE_16) - {"d3"}) | {"theta2"})
    other = identify(angle_kept, qiao.nominal, exact(qiao.true, 100))
    left = [position_mm(g.geometry, exact(qiao.true, 2000, seed=1)).max() for g in (found, other)]
    assert left[0] < 1.2e-4 < 2e-4 < left[1] < 1e-3


def test_table_1_is_explained_by_all_24_with_truncation(qiao, exact):
    """Fact 3: with singular values cut off, 24 parameters do as well as 16: "17 beats 24" is the solver's doing."""
    data, model, geometry = exact(qiao.true, 100), link_model(qiao.nominal), qiao.nominal
    for _ in range(6):
        arm = ArmModel.of(geometry)
        matrix = data.jacobian(arm, np.zeros(0))[0][:, model.columns] * model.tolerance
        right = data.residual(arm, np.zeros(0))
        geometry = moved(model, geometry, np.linalg.lstsq(matrix, right, rcond=1e-3)[0] * model.tolerance)
    assert position_mm(geometry, exact(qiao.true, 2000, seed=1)).max() < 1e-4


@pytest.mark.parametrize("millimetres", [False, True])
def test_the_papers_17_explode_in_normal_equations_and_not_here(qiao, exact, millimetres):
    """Eq (11) as printed is singular: J'J has condition 1e16 and worse (rank 15 of 17).

    NumPy either refuses it or steps by 1e16 m (measured: d1 = -3.9e19 mm, d2 = +3.9e19 mm). Ours drops d2 and theta6
    and leaves 0.13-0.14 mm.
    """
    data, whole = exact(qiao.true, 100), link_model(qiao.nominal)
    model = some_of(whole, set(whole.names) - PAPER_DROPS)
    rows = np.repeat([1e3 if millimetres else 1.0, 1.0], 3)
    columns = np.where([is_angle(name) for name in model.names], 1.0, 1e-3 if millimetres else 1.0)
    jacobian = parameter_jacobian(qiao.nominal, data.joints)[..., model.columns] * columns * rows[:, None]
    jacobian, right = jacobian.reshape(-1, 17), (data.difference(qiao.nominal) * rows).ravel()
    normal = jacobian.T @ jacobian
    assert np.linalg.cond(normal) > 1e15
    try:
        step = np.linalg.solve(normal, jacobian.T @ right) * columns
    except np.linalg.LinAlgError:
        step = np.full(17, np.inf)
    assert np.abs(step).max() > 0.1  # m or rad, for deviations of 0.6 mm and 0.05 deg

    found = identify(model, qiao.nominal, data)
    assert found.converged and found.identifiability.rank == 15
    assert np.abs(found.delta).max() < 2e-3
    assert 0.12 < position_mm(found.geometry, exact(qiao.true, 2000, seed=1)).mean() < 0.18


def test_measurements_of_the_start_itself_converge_at_once(exact):
    """Residuals of rounding size are a minimum, not a failure."""
    for arm in ("qiao2026", "ur5"):
        nominal = load_arm(arm).nominal
        data = exact(nominal, 60)
        for jitter in (0.0, 1e-16, 1e-15, 1e-14):
            noise = np.random.default_rng(1).normal(size=data.position.shape) * jitter
            found = identify(complete_model(nominal), nominal, replace(data, position=data.position + noise))
            assert found.converged and np.abs(found.delta).max() < 1e-9


def test_too_few_iterations_are_not_called_converged(qiao, exact):
    data = exact(qiao.true, 60)
    assert not identify(link_model(qiao.nominal), qiao.nominal, data, max_iterations=1).converged
    found = identify(link_model(qiao.nominal), qiao.nominal, data)
    assert found.converged
    assert (np.diff(found.residual_rms) <= 1e-9).all()


@pytest.mark.parametrize("positions", [False, True])
def test_stated_uncertainty_is_the_scatter_of_repeated_identifications(qiao, positions):
    model, rng = link_model(qiao.nominal), np.random.default_rng(3)
    joints = random_joints(qiao.nominal, 40, rng)
    pose = forward(qiao.nominal, joints)
    deltas, stated = [], []
    for _ in range(200):
        position = pose.position + rng.normal(size=(40, 3)) * 15e-6
        turn = np.eye(3) + 2e-4 * np.cross(np.eye(3), rng.normal(size=(40, 1, 3)))
        rotation = None if positions else turn @ pose.rotation
        data = Measurements(joints, position, rotation, qiao.nominal.prismatic)
        found = identify(model, qiao.nominal, data)
        deltas.append(found.delta)
        stated.append(found.standard_deviation)
    kept = found.identifiability.kept
    ratio = np.std(deltas, axis=0)[kept] / np.sqrt(np.mean(np.square(stated), axis=0))[kept]
    assert np.isnan(np.delete(found.standard_deviation, kept)).all()
    assert ratio == pytest.approx(1.0, abs=0.2)  # four standard errors of 200 repetitions
    assert ratio.mean() == pytest.approx(1.0, abs=0.06)


def test_stated_uncertainty_comes_from_the_data_not_from_the_claim(dynamic, exact):
    nominal = dynamic.arm.nominal
    data = exact(dynamic.geometry, 50)
    noisy = replace(data, position=data.position + np.random.default_rng(0).normal(size=(50, 3)) * 1e-4)
    claimed = replace(noisy, position_std=noisy.position_std / 10, attitude_std=noisy.attitude_std / 10)
    honest, boastful = (identify(link_model(nominal), nominal, m) for m in (noisy, claimed))
    np.testing.assert_allclose(boastful.standard_deviation, honest.standard_deviation, rtol=1e-6)


@pytest.mark.parametrize(("positions", "poses"), [(False, 2), (True, 4)])
def test_too_few_poses_are_refused_with_the_number_needed(qiao, exact, positions, poses):
    data = exact(qiao.true, poses)
    with pytest.raises(InputError, match=rf"{poses} poses give .* too few .* at least \d+ poses"):
        identify(link_model(qiao.nominal), qiao.nominal, data.positions_only() if positions else data)


@pytest.mark.parametrize(("positions", "rows"), [(False, 240), (True, 120)])
def test_degrees_of_freedom_are_equations_less_identified_parameters(qiao, exact, positions, rows):
    data = exact(qiao.true, 40)
    found = identify(link_model(qiao.nominal), qiao.nominal, data.positions_only() if positions else data)
    assert found.degrees_of_freedom == rows - found.identifiability.rank
    assert 10 < found.identifiability.rank <= 16


@pytest.mark.parametrize("arm", ["qiao2026", "ur5"])
def test_a_step_that_makes_it_worse_is_never_kept(exact, arm):
    """From a start a hundred tolerances off, positions alone: whole steps jump, and would end in another arm."""
    nominal = load_arm(arm).nominal
    model, data = complete_model(nominal), exact(nominal).positions_only()
    for seed in range(3):
        change = 100 * model.tolerance * np.random.default_rng(seed).normal(size=len(model.tolerance))
        found = identify(model, moved(model, nominal, change), data)
        assert (np.diff(found.residual_rms) <= 0).all()
        assert not found.converged or found.residual_rms[-1] < 1e-3 * found.residual_rms[0]


@pytest.mark.parametrize("positions", [False, True])
def test_chi_square_counts_residuals_in_their_stated_uncertainties(qiao, exact, positions):
    rng, data = np.random.default_rng(6), exact(qiao.true, 300)
    data = replace(data, position_std=5e-5, attitude_std=2e-4)
    turn = rotation_matrix(rng.normal(size=(300, 3)) * data.attitude_std)
    data = replace(
        data, position=data.position + rng.normal(size=(300, 3)) * data.position_std, rotation=turn @ data.rotation
    )
    found = identify(link_model(qiao.nominal), qiao.nominal, data.positions_only() if positions else data)
    assert found.chi_square / found.degrees_of_freedom == pytest.approx(1.0, abs=0.15)


def test_what_wanders_is_identified_again_with_fewer_and_fewer_parameters(qiao, exact, monkeypatch):
    data, asked = exact(qiao.true, 60), []
    found = identify(link_model(qiao.nominal), qiao.nominal, data)

    def wandering(*_, rank_tolerance, **__):
        asked.append(rank_tolerance / REDUNDANCY_TOLERANCE)
        return replace(found, converged=len(asked) > settles)

    monkeypatch.setattr(least_squares, "identify", wandering)
    settles = 2
    assert identify_converged(link_model(qiao.nominal), qiao.nominal, data).converged
    assert asked == [1.0, 3.0, 10.0]
    asked, settles = [], 3
    with pytest.raises(InputError, match="the identification did not converge"):
        identify_converged(link_model(qiao.nominal), qiao.nominal, data)
