"""Identification by least squares (Qiao 2026 eqs (11)-(12)): exact without noise, honest about its uncertainty."""

import time
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from hypothesis import given, settings, strategies as st

from pickenv.arm import forward, load_arm, parameter_jacobian, rotation_matrix
from pickenv.base import InputError
from pickenv.calibration import (
    ArmModel,
    DistanceObservations,
    ErrorModel,
    Measurements,
    complete_model,
    identifiability,
    identify,
    identify_converged,
    link_model,
    random_joints,
)
from pickenv.calibration.identification import least_squares
from pickenv.calibration.identification.least_squares import (
    REDUNDANCY_TOLERANCE,
    is_angle,
    judged_step,
)

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


# The steps of least squares and their stop rule: each bound from both sides, ridge and covariance written out.
FAR = np.full(3, 1e-2)
"""A step of a hundredth of a tolerance, which counts."""


def judged(step=FAR, explained=10.0, weighted=1.0, before=1.0, after=0.5, rows=23, of=np.asarray):
    """The judgement of a step of three parameters; ``explained`` and ``weighted`` are root mean squares over rows."""
    judgement = judged_step(
        of(np.asarray(step)),
        of(np.full(rows, float(explained))),
        of(np.full(rows, float(weighted))),
        of(before),
        of(after),
    )
    return SimpleNamespace(**dict(zip(("offset", "negligible", "better", "finished"), judgement, strict=True)))


@pytest.mark.parametrize("of", [np.asarray, torch.as_tensor], ids=["NumPy", "torch"])
def test_a_step_that_moves_nothing_by_a_hundred_thousandth_of_a_tolerance_is_negligible(of):
    assert not judged(of=of).negligible
    assert judged([9.9e-6, -9.9e-6, 9.9e-6], of=of).negligible
    assert not judged([9.9e-6, -1e-5, 9.9e-6], of=of).negligible


@pytest.mark.parametrize(("share", "negligible"), [(0.999e-3, True), (1.001e-3, False)])
def test_so_is_one_that_explains_less_than_a_thousandth_of_the_uncertainty(share, negligible):
    """Explained per parameter against the scatter per degree of freedom: 23 rows and 3 parameters."""
    scatter = 23 * 2.0**2 / (23 - 3)
    explained = share * np.sqrt(scatter * 3 / 23)
    found = judged(explained=explained, weighted=2.0)
    assert found.offset == pytest.approx(share**2) and found.negligible == negligible


def test_with_no_more_rows_than_parameters_the_scatter_is_that_of_one_degree_of_freedom():
    assert judged(explained=1.0, weighted=2.0, rows=3).offset == pytest.approx(3 / (3 * 3 * 4.0))
    assert judged(explained=1.0, weighted=2.0, rows=2).offset == pytest.approx(2 / (3 * 2 * 4.0))
    assert judged(np.empty(0), explained=0.0, weighted=0.0, rows=4).negligible


@pytest.mark.parametrize("parameters", [1, 2, 5])
def test_what_a_step_explains_is_counted_for_each_of_its_parameters(parameters):
    found = judged(np.full(parameters, 1e-2), explained=3.0, weighted=2.0, rows=23)
    assert found.offset == pytest.approx(23 * 9.0 / parameters / (23 * 4.0 / (23 - parameters)))


def test_without_any_scatter_whatever_a_step_explains_counts():
    assert judged(explained=1e-3, weighted=0.0).offset > 1.0 and not judged(explained=1e-3, weighted=0.0).negligible


@pytest.mark.parametrize(
    ("after", "better"), [(1.0, True), (1.0 + 9e-10, True), (1.0 + 2e-9, False), (2.0, False), (np.nan, False)]
)
def test_a_step_is_better_unless_the_residual_grows_by_more_than_rounding(after, better):
    assert judged(after=after).better == better


def test_where_nothing_is_left_no_step_makes_it_worse_and_none_is_needed():
    found = judged(before=0.0, after=0.0)
    assert found.better and found.finished


@pytest.mark.parametrize("size", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize(("after", "finished"), [(1.0 - 0.9e-7, True), (1.0 - 1.1e-7, False), (0.5, False)])
def test_the_search_is_finished_where_a_step_gains_less_than_a_ten_millionth(after, finished, size):
    assert judged(before=size, after=after * size).finished == finished
    assert judged(FAR * 1e-4, before=size, after=0.5 * size).finished


@pytest.mark.parametrize("damping", [0.0, 1e-3, 10.0])
def test_a_step_is_that_of_ridge_regression(damping):
    """Ridge relative to the mean squared column norm; without damping plain least squares."""
    rng = np.random.default_rng(0)
    matrix, right = rng.normal(size=(30, 4)) * [1.0, 5.0, 0.2, 1.0], rng.normal(size=30)
    ridge = damping * np.sum(matrix**2) / 4
    expected = np.linalg.solve(matrix.T @ matrix + ridge * np.eye(4), matrix.T @ right)
    np.testing.assert_allclose(least_squares._solve(matrix, right, damping), expected, rtol=1e-9)


def test_covariance_is_the_scatter_times_the_inverse_of_the_normal_matrix(qiao, exact):
    data = exact(qiao.true, 30)
    data = replace(data, position=data.position + 1e-4 * np.random.default_rng(0).normal(size=(30, 3)))
    found = identify(link_model(qiao.nominal), qiao.nominal, data)
    arm, model = found.arm_model, link_model(qiao.nominal)
    columns = model.columns[found.identifiability.kept]
    weights = np.repeat([1 / data.position_std, 1 / data.attitude_std], 3)
    rows = (arm.jacobian(data.joints, None)[..., columns] * weights[:, None]).reshape(-1, len(columns))
    left = (data.difference(arm) * weights).ravel()
    expected = left @ left / (180 - 16) * np.linalg.inv(rows.T @ rows)
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    np.testing.assert_allclose(found.covariance / scale, expected / scale, atol=1e-4)
    assert found.chi_square == pytest.approx(left @ left, rel=1e-6)
    assert found.residual_rms[-1] == pytest.approx(np.sqrt(np.mean(left**2)), rel=1e-6)
    assert found.poses == 30 and found.kind == "pose"


def test_a_row_with_a_factor_of_root_two_is_that_row_twice(qiao, exact):
    """As the sums of squares say, and so for their least."""
    data = exact(qiao.true, 40)
    data = replace(data, position=data.position + 1e-3 * np.random.default_rng(0).normal(size=(40, 3)))
    twice = np.arange(40) < 15
    factors = np.repeat(np.where(twice, np.sqrt(2.0), 1.0), data.rows_per_pose)
    model = link_model(qiao.nominal)
    found = identify(model, qiao.nominal, data, whiten=lambda rows: (rows.T * factors).T)
    repeated = identify(model, qiao.nominal, (data, data.select(twice)))
    plain = identify(model, qiao.nominal, data)
    scale = model.tolerance
    np.testing.assert_allclose(found.delta / scale, repeated.delta / scale, atol=1e-4)
    assert np.abs((found.delta - plain.delta) / scale).max() > 0.01
    assert found.chi_square == pytest.approx(repeated.chi_square, rel=1e-9)
    assert found.residual_rms[0] == pytest.approx(repeated.residual_rms[0] * np.sqrt(55 / 40), rel=1e-9)


def test_what_wanders_is_tried_with_fewer_parameters_sixty_steps_each(qiao, exact, monkeypatch):
    asked, real = [], least_squares.identify

    def identified(*given, **options):
        asked.append(options)
        return replace(
            real(*given, max_iterations=1, rank_tolerance=options["rank_tolerance"]), converged=len(asked) == most
        )

    monkeypatch.setattr(least_squares, "identify", identified)
    data, model = exact(qiao.true, 20), link_model(qiao.nominal)
    for most in (1, 3):
        asked.clear()
        assert least_squares.identify_converged(model, qiao.nominal, data).converged and len(asked) == most
    assert [options["max_iterations"] for options in asked] == [60, 60, 60]
    np.testing.assert_allclose([options["rank_tolerance"] / REDUNDANCY_TOLERANCE for options in asked], [1, 3, 10])
    most = 0
    asked.clear()
    with pytest.raises(InputError, match="did not converge"):
        least_squares.identify_converged(model, qiao.nominal, data)
    assert len(asked) == 3


def dampings(qiao, exact, monkeypatch, script, steps=20):
    """The damping of each step where the judgement of steps is scripted."""
    asked, real = [], least_squares._solve
    judgements = iter(script)

    def solve(matrix, right, damping):
        asked.append(damping)
        return real(matrix, right, damping)

    monkeypatch.setattr(least_squares, "_solve", solve)
    monkeypatch.setattr(least_squares, "judged_step", lambda *_: next(judgements))
    found = identify(link_model(qiao.nominal), qiao.nominal, exact(qiao.true, 20), max_iterations=steps)
    return asked, found


def told(better, negligible=False, finished=False, offset=1.0):
    return offset, negligible, better, finished


def test_damping_grows_tenfold_from_a_thousandth_and_falls_as_it_grew(qiao, exact, monkeypatch):
    script = [told(False), told(False), told(True), told(True, finished=True), told(True), told(True, negligible=True)]
    asked, found = dampings(qiao, exact, monkeypatch, script)
    shortened = [damping for damping in asked if damping]
    np.testing.assert_allclose(shortened, [1e-3, 1e-2, 1e-3, 1e-4, 1e-5])
    assert asked.count(0.0) == 6 and found.converged  # the whole step is looked at each time
    assert len(found.iterates) == len(found.residual_rms) == 1 + 4


def test_small_damping_ends(qiao, exact, monkeypatch):
    script = [told(False), *[told(True)] * 5, told(True, finished=True)]
    asked, found = dampings(qiao, exact, monkeypatch, script)
    np.testing.assert_allclose([d for d in asked if d], [1e-3, 1e-4, 1e-5, 1e-6, 1e-7], rtol=1e-6, atol=1e-12)
    assert found.converged


def test_where_short_steps_do_not_help_either_what_is_left_to_explain_decides(qiao, exact, monkeypatch):
    for offset, steps in ((0.029**2, [1e-3]), (0.031**2, 10.0 ** np.arange(-3, 10))):
        asked, found = dampings(qiao, exact, monkeypatch, [told(False, offset=offset)] * 40, steps=40)
        np.testing.assert_allclose([damping for damping in asked if damping], steps)
        assert found.converged == (offset < 0.03**2) and len(found.iterates) == 1


def test_worse_by_rounding_alone_is_the_minimum(qiao, exact, monkeypatch):
    asked, found = dampings(qiao, exact, monkeypatch, [told(False, negligible=True)])
    assert asked == [0.0] and found.converged and len(found.iterates) == 1


def test_too_few_iterations_leave_it_unconverged(qiao, exact, monkeypatch):
    _, found = dampings(qiao, exact, monkeypatch, [told(True)] * 20)
    assert not found.converged and len(found.iterates) == 21


@pytest.mark.parametrize(
    ("name", "angle"),
    [
        ("alpha1", True),
        ("theta6", True),
        ("beta2", True),
        ("a1", False),
        ("d3", False),
        ("base_rx", True),
        ("tool_x", False),
    ],
)
def test_angles_are_told_by_their_names(name, angle):
    assert is_angle(name) == angle


def test_base_and_tool_are_parameters_where_they_are_not_known(qiao):
    """And betas only between parallel axes: of the picking arm J1 and J2, J5 and J6."""
    known, fitted = (model(qiao.nominal).names for model in (link_model, complete_model))
    assert len(known) == 24 and not any(name.startswith(("base", "tool", "beta")) for name in known)
    assert set(fitted) - set(known) == {
        *(f"{part}_{axis}" for part in ("base", "tool") for axis in ("x", "y", "z", "rx", "ry", "rz")),
        *(f"beta{i}" for i in range(1, 6) if qiao.nominal.alpha[i] == 0.0),
    }


def test_a_solution_takes_no_longer_than_the_call(qiao, exact):
    data, begin = exact(qiao.true, 20), time.perf_counter()
    found = identify(link_model(qiao.nominal), qiao.nominal, data)
    assert 0.0 < found.solve_seconds < time.perf_counter() - begin


@pytest.mark.parametrize("rows", [40, 5])
def test_the_base_set_is_that_of_a_qr_in_the_models_order(rows):
    """Columns 2 and 4 are combinations of those before; the rest of each column beside them is |R_kk|."""
    rng = np.random.default_rng(0)
    matrix = rng.normal(size=(rows, 6)) * [1.0, 3.0, 1.0, 0.5, 1.0, 2.0]
    matrix[:, 2] = 2.0 * matrix[:, 0] - 0.5 * matrix[:, 1]
    matrix[:, 4] = matrix[:, 3] + 0.25 * matrix[:, 1]
    tolerance = np.array([1.0, 2.0, 4.0, 1.0, 0.5, 1.0])
    names = ("p", "q", "r", "s", "t", "u")
    found = identifiability(matrix, names, tolerance, 4)
    assert found.kept_names == ("p", "q", "s", "u") and found.rank == 4
    assert list(found.dropped) == ["r", "t"]
    # in units of the parameters: column k is the Jacobian times the k-th tolerance
    assert found.dropped["r"] == {"p": pytest.approx(2.0 * 1 / 4), "q": pytest.approx(-0.5 * 2 / 4)}
    assert found.dropped["t"] == {"q": pytest.approx(0.25 * 2 / 0.5), "s": pytest.approx(1 / 0.5)}
    kept = matrix[:, [0, 1, 3, 5]]
    diagonal = np.abs(np.diag(np.linalg.qr(kept, mode="r")))
    np.testing.assert_allclose(found.r_diagonal[[0, 1, 3, 5]], diagonal)
    np.testing.assert_allclose(found.r_diagonal[[2, 4]], 0.0, atol=1e-12)
    values = np.linalg.svd(kept, compute_uv=False) / 2.0  # per root of four poses
    np.testing.assert_allclose(found.singular_values, values)


@pytest.mark.parametrize(("share", "rank"), [(0.9e-3, 1), (1.1e-3, 2)])
def test_what_adds_less_than_a_thousandth_of_the_largest_is_redundant(share, rank):
    matrix = np.zeros((9, 2))
    matrix[0, 0], matrix[1, 1] = 5.0, 5.0 * share
    assert identifiability(matrix, ("a", "b"), np.ones(2), 1).rank == rank
    assert identifiability(matrix, ("a", "b"), np.ones(2), 1, 10e-3).rank == 1


@pytest.mark.parametrize(("share", "rank"), [(0.9e-3, 2), (1.1e-3, 3)])
def test_the_largest_is_the_longest_column_whatever_stands_in_the_rows(share, rank):
    matrix = np.zeros((7, 3))
    matrix[0, 0], matrix[:2, 1], matrix[2, 2] = 5.0, (4.0, 3.0), 5.0 * share
    assert identifiability(matrix, ("a", "b", "c"), np.ones(3), 1).rank == rank


@pytest.mark.parametrize("tolerance", [[1.0, 1.0, 1.0], [1.0, 1.0, 50.0], [1.0, 20.0, 1.0]])
@pytest.mark.parametrize(("share", "named"), [(0.9e-3, False), (1.1e-3, True)])
def test_shares_below_a_thousandth_of_a_tolerance_are_not_named(share, named, tolerance):
    """Of the tolerances that the matrix is scaled by, whatever they are."""
    matrix = np.array([[1.0, 0.0, 1.0], [0.0, 1.0, share], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    (absorbed,) = identifiability(matrix, ("a", "b", "c"), np.array(tolerance), 1).dropped.values()
    assert ("b" in absorbed) == named and "a" in absorbed


def test_a_covariance_is_the_inverse_information_in_the_units_of_the_parameters():
    rng = np.random.default_rng(0)
    matrix, tolerance = rng.normal(size=(5, 3)), np.array([1.0, 2.0, 0.5])
    rows = matrix / tolerance
    covariance = least_squares._covariance(matrix, tolerance, 0.3)
    np.testing.assert_allclose(covariance, 0.3 * np.linalg.inv(rows.T @ rows), rtol=1e-8)


def test_the_scatter_of_the_rows_is_the_variance_and_dropped_parameters_have_none(qiao):
    joints = random_joints(qiao.nominal, 30, np.random.default_rng(0))
    pose = forward(qiao.nominal, joints)
    position = pose.position + 1e-4 * np.random.default_rng(1).normal(size=(30, 3))
    data = Measurements(joints, position, None, qiao.nominal.prismatic)
    found = identify(link_model(qiao.nominal), qiao.nominal, data)
    std, kept = found.standard_deviation, found.identifiability.kept
    np.testing.assert_array_equal(np.flatnonzero(~np.isnan(std)), kept)
    np.testing.assert_array_equal(std[kept], np.sqrt(np.diag(found.covariance)))
    columns = link_model(qiao.nominal).columns[kept]
    rows = data.jacobian(found.arm_model, np.zeros(0))[0][:, columns]
    expected = found.chi_square / (90 - len(kept)) * np.linalg.inv(rows.T @ rows)
    np.testing.assert_allclose(np.diag(found.covariance), np.diag(expected), rtol=1e-3)


# Data with unknowns of their own: their rank is judged again where the unknowns end.


@pytest.fixture(scope="module")
def wire():
    """A draw wire at a UR5 that is its nominal one but for two link lengths."""
    nominal = load_arm("ur5").nominal
    joints = random_joints(nominal, 120, np.random.default_rng(0))
    delta = np.zeros(len(nominal.parameter_names))
    delta[[nominal.parameter_names.index(name) for name in ("a2", "d4")]] = 1e-3, -5e-4
    there = forward(nominal.displaced(delta), joints).position
    return nominal, DistanceObservations(joints, np.linalg.norm(there - np.array([1.5, -2.0, 0.3]), axis=1), 2e-5)


@pytest.fixture
def ranks(monkeypatch):
    """What each judgement of the rank was asked and said; ``hidden`` names are dropped by the first."""
    asked, real = [], least_squares.identifiable_parameters

    def judge(model, sets, arm, unknowns, matrix, names, tolerance, *rest):
        seen = matrix.copy()
        seen[:, [name in judge.hidden[len(asked)] for name in names]] = 0.0
        asked.append(
            (arm, [part.copy() for part in unknowns], real(model, sets, arm, unknowns, seen, names, tolerance))
        )
        return asked[-1][-1]

    judge.hidden, judge.asked = [(), ()], asked
    monkeypatch.setattr(least_squares, "identifiable_parameters", judge)
    return judge


def test_a_parameter_that_only_the_unknowns_found_show_is_taken_in(wire, ranks):
    """Judged the second time of the arm as it started, with the anchor where it was found."""
    nominal, data = wire
    ranks.hidden = [("d4", "a2"), ()]
    found = identify(complete_model(nominal), nominal, [data])
    (_, _, first), (arm, unknowns, second) = ranks.asked
    assert arm.geometry is nominal and first.rank < second.rank
    np.testing.assert_allclose(unknowns[0], [1.5, -2.0, 0.3], atol=0.1)
    assert np.abs(unknowns[0] - data.start(ArmModel.of(nominal))).max() > 1e-4
    assert found.identifiability is second and found.converged
    assert found.chi_square < 1e-6 * found.degrees_of_freedom
    assert found.degrees_of_freedom == 120 - second.rank and len(found.covariance) == second.rank


@pytest.mark.parametrize("hidden", [[(), ()], [(), ("d4", "a2")]], ids=["as much", "less"])
def test_what_shows_no_more_the_second_time_stays_as_it_was_judged_first(wire, ranks, hidden):
    nominal, data = wire
    ranks.hidden = hidden
    found = identify(complete_model(nominal), nominal, [data])
    assert len(ranks.asked) == 2 and found.converged and found.identifiability is ranks.asked[0][-1]


def test_what_has_no_unknowns_is_judged_once(qiao, exact, ranks):
    assert identify(link_model(qiao.nominal), qiao.nominal, exact(qiao.true, 20)).converged and len(ranks.asked) == 1


@pytest.mark.parametrize("most", [1, 4])
def test_until_it_is_judged_again_and_after_it_there_are_as_many_steps(wire, qiao, exact, monkeypatch, most):
    monkeypatch.setattr(least_squares, "judged_step", lambda *_: (1.0, False, True, False))
    nominal, data = wire
    found = identify(complete_model(nominal), nominal, [data], max_iterations=most)
    assert len(found.iterates) == 1 + 2 * most and not found.converged
    found = identify(link_model(qiao.nominal), qiao.nominal, exact(qiao.true, 20), max_iterations=most)
    assert len(found.iterates) == 1 + most and not found.converged
