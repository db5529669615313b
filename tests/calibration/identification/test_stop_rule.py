"""The steps of least squares and their stop rule: each bound from both sides, ridge and covariance written out."""

import time
from dataclasses import replace

import numpy as np
import pytest
import torch

from pickenv.arm import forward, load_arm
from pickenv.base import InputError
from pickenv.calibration import (
    ArmModel,
    DistanceObservations,
    complete_model,
    geometric_model,
    identifiability,
    identify,
    link_model,
    random_joints,
)
from pickenv.calibration.identification import least_squares
from pickenv.calibration.identification.least_squares import (
    REDUNDANCY_TOLERANCE,
    is_angle,
    judged_step,
)

FAR = np.full(3, 1e-2)
"""A step of a hundredth of a tolerance, which counts."""


def judged(step=FAR, explained=10.0, weighted=1.0, before=1.0, after=0.5, rows=23, of=np.asarray):
    """The judgement of a step of three parameters; ``explained`` and ``weighted`` are root mean squares over rows."""
    return judged_step(
        of(np.asarray(step)),
        of(np.full(rows, float(explained))),
        of(np.full(rows, float(weighted))),
        of(before),
        of(after),
    )


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
    return least_squares.Progress(offset, negligible, better, finished)


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
    known, fitted = (geometric_model(qiao.nominal, known).names for known in (True, False))
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
    assert [item.name for item in found.dropped] == ["r", "t"]
    # in units of the parameters: column k is the Jacobian times the k-th tolerance
    assert found.dropped[0].absorbed_by == {"p": pytest.approx(2.0 * 1 / 4), "q": pytest.approx(-0.5 * 2 / 4)}
    assert found.dropped[1].absorbed_by == {"q": pytest.approx(0.25 * 2 / 0.5), "s": pytest.approx(1 / 0.5)}
    kept = matrix[:, [0, 1, 3, 5]]
    diagonal = np.abs(np.diag(np.linalg.qr(kept, mode="r")))
    np.testing.assert_allclose(found.r_diagonal[[0, 1, 3, 5]], diagonal)
    np.testing.assert_allclose(found.r_diagonal[[2, 4]], 0.0, atol=1e-12)
    np.testing.assert_allclose(found.phi, found.r_diagonal / (diagonal.sum() / 6))
    values = np.linalg.svd(kept, compute_uv=False) / 2.0  # per root of four poses
    np.testing.assert_allclose(found.singular_values, values)
    assert found.condition == pytest.approx(values[0] / values[-1])
    spread = found.of_all(np.array([1.0, 2.0, 3.0, 4.0]))
    np.testing.assert_array_equal(spread, [1.0, 2.0, np.nan, 3.0, np.nan, 4.0])


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
    (dropped,) = identifiability(matrix, ("a", "b", "c"), np.array(tolerance), 1).dropped
    assert ("b" in dropped.absorbed_by) == named and "a" in dropped.absorbed_by


@pytest.mark.parametrize("spare", [0, 1, 2])
def test_a_covariance_needs_one_equation_more_than_parameters(spare):
    rng = np.random.default_rng(spare)
    matrix, weighted = rng.normal(size=(3 + spare, 3)), rng.normal(size=3 + spare)
    tolerance = np.array([1.0, 2.0, 0.5])
    found = identifiability(matrix, ("a", "b", "c"), tolerance, 1)
    covariance = least_squares._covariance(matrix, weighted, found, tolerance)
    if spare == 0:
        assert covariance.shape == (3, 3) and np.isnan(covariance).all()
    else:
        rows = matrix / tolerance
        np.testing.assert_allclose(covariance, weighted @ weighted / spare * np.linalg.inv(rows.T @ rows), rtol=1e-8)


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
    monkeypatch.setattr(least_squares, "judged_step", lambda *_: least_squares.Progress(1.0, False, True, False))
    nominal, data = wire
    found = identify(complete_model(nominal), nominal, [data], max_iterations=most)
    assert len(found.iterates) == 1 + 2 * most and not found.converged
    found = identify(link_model(qiao.nominal), qiao.nominal, exact(qiao.true, 20), max_iterations=most)
    assert len(found.iterates) == 1 + most and not found.converged
