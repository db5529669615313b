"""What a plan prints beside its poses, recomputed: chance's sets, travel, errors to expect; and its smallest sets."""

import time
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from pickenv.arm import parameter_jacobian
from pickenv.base import InputError
from pickenv.calibration import complete_model, link_model, plan_poses, random_joints
from pickenv.calibration.model.measurements import ATTITUDE_STD, POSITION_STD
from pickenv.calibration.planning.plan import (
    candidate_joints,
    design_of,
    exchange,
    gains,
    move_seconds,
    short_tour,
    travel_seconds,
)

COUNT = 15


@pytest.fixture(scope="module")
def drawn(qiao):
    """A plan, and all that was drawn for it: candidates, order of exchanges, chance's sets, orders of measuring."""
    near = random_joints(qiao.nominal, 30, np.random.default_rng(7))
    plan = plan_poses(
        qiao,
        complete_model(qiao.nominal),
        COUNT,
        np.random.default_rng(3),
        candidates=60,
        criterion="d-optimal",
        test_joints=near,
    )
    rng = np.random.default_rng(3)
    joints = candidate_joints(qiao.nominal, 60, rng)
    chosen, passes = exchange(plan.design.rows, COUNT, rng)
    chosen = chosen[short_tour(joints[chosen], qiao.speed)]
    sets = random_joints(qiao.nominal, 20 * COUNT, rng).reshape(20, COUNT, -1)
    orders = [rng.permutation(chosen) for _ in range(20)]
    assert passes == plan.passes
    np.testing.assert_array_equal(plan.joints, joints[chosen])
    np.testing.assert_array_equal(plan.chosen, chosen)
    return plan, joints, sets, orders, near


def seen_by(nominal, joints, names):
    """Weighted, scaled rows of the named parameters ``(6 N, p)``."""
    model = complete_model(nominal)
    columns = [model.names.index(name) for name in names]
    jacobian = parameter_jacobian(nominal, joints)[..., model.columns[columns]] * model.tolerance[columns]
    weight = np.repeat([1 / POSITION_STD, 1 / ATTITUDE_STD], 3)
    return (jacobian * weight[:, None]).reshape(-1, len(columns))


@pytest.mark.parametrize("of", ["model", "arm"])
def test_chance_is_the_median_condition_and_the_mean_o1_of_twenty_sets(qiao, drawn, of):
    plan, _, sets, _, _ = drawn
    told = plan.as_dict()[of]
    parameters, planned = told["parameters"], told["observability"]
    every = [np.linalg.svd(seen_by(qiao.nominal, s, parameters), compute_uv=False) for s in sets]
    conditions = sorted(s[0] / s[-1] for s in every)
    o1 = [np.exp(np.log(s).mean()) / np.sqrt(COUNT) for s in every]
    assert told["random_observability"]["condition"] == pytest.approx(conditions[10], rel=1e-6)
    assert planned["o1"] / told["o1_ratio"] == pytest.approx(np.mean(o1), rel=1e-6)
    own = np.linalg.svd(seen_by(qiao.nominal, plan.joints, parameters), compute_uv=False)
    assert planned["condition"] == pytest.approx(own[0] / own[-1], rel=1e-6) and planned["poses"] == COUNT
    ratio = np.exp(np.log(own).mean()) / np.sqrt(COUNT) / np.mean(o1)
    assert told["o1_ratio"] == pytest.approx(ratio, rel=1e-6)
    drawn_condition = told["random_observability"]["condition"]
    assert (told["condition"], told["random_condition"]) == (planned["condition"], drawn_condition)
    assert parameters == list(getattr(plan, of)["parameters"])
    assert f"({len(parameters)}): condition {own[0] / own[-1]:.1f} (poses drawn at random: {conditions[10]:.1f})" in (
        plan.report()
    )
    assert f"O1 {ratio:.2f} times theirs" in plan.report()


def test_travel_is_that_of_the_slowest_joint_and_beside_it_the_mean_of_random_orders(qiao, drawn):
    plan, joints, _, orders, _ = drawn
    times = [
        sum(np.max(np.abs(b - a) / qiao.speed) for a, b in pairwise(j))
        for j in ([plan.joints] + [joints[order] for order in orders])
    ]
    assert plan.travel_seconds == pytest.approx(times[0])
    assert plan.random_travel_seconds == pytest.approx(np.mean(times[1:]))
    assert f"moves take {times[0]:.0f} s in this order, {np.mean(times[1:]):.0f} s in another" in plan.report()


def test_the_error_to_expect_is_the_parameters_covariance_carried_to_the_test_poses(qiao, drawn):
    """Of each set of chance's likewise, and their median."""
    plan, _, sets, _, near = drawn

    def expected(joints):
        rows = seen_by(qiao.nominal, joints, plan.model["parameters"])
        there = seen_by(qiao.nominal, near, plan.model["parameters"]).reshape(len(near), 6, -1)[:, :3] * POSITION_STD
        spread = there @ np.linalg.inv(rows.T @ rows) @ np.swapaxes(there, 1, 2)
        return np.sqrt(np.trace(spread, axis1=1, axis2=2).mean())

    assert plan.predicted_error == pytest.approx(expected(plan.joints), rel=1e-4)
    chance = np.median([expected(joints) for joints in sets])
    assert plan.random_predicted_error == pytest.approx(chance, rel=1e-4)
    told = plan.as_dict()
    assert told["predicted_error_mm"] == plan.predicted_error * 1e3
    assert told["random_predicted_error_mm"] == plan.random_predicted_error * 1e3
    assert f"{plan.predicted_error * 1e3:.4f} mm RMS (poses drawn at random: {chance * 1e3:.4f} mm)" in plan.report()
    assert (told["poses"], told["candidates"], told["kind"]) == (COUNT, 60, "pose")
    assert (told["criterion"], told["passes"]) == ("d-optimal", plan.passes)


def test_without_test_poses_nothing_is_said_of_an_error(qiao):
    begin = time.perf_counter()
    plan = plan_poses(qiao, link_model(qiao.nominal), 8, np.random.default_rng(0), candidates=40, kind="position")
    assert 0.0 < plan.seconds < time.perf_counter() - begin
    assert plan.predicted_error is None and plan.random_predicted_error is None
    assert "predicted_error_mm" not in plan.as_dict() and "error to expect" not in plan.report()
    assert plan.design.rows.shape[:2] == (40, 3) and len(plan.design.weight) == 3


@pytest.mark.parametrize(("kind", "parameters", "least"), [("pose", 16, 4), ("position", 14, 6)])
def test_one_pose_more_than_the_equations_need_is_the_least(qiao, kind, parameters, least):
    rng, model = np.random.default_rng(0), link_model(qiao.nominal)
    plan_poses(qiao, model, least, rng, candidates=40, kind=kind)
    wanted = rf"^{least - 1} poses are too few for {parameters} parameters; plan at least {least}, better {2 * least}$"
    with pytest.raises(InputError, match=wanted):
        plan_poses(qiao, model, least - 1, rng, candidates=40, kind=kind)
    assert len(plan_poses(qiao, model, 10, rng, candidates=10, kind=kind).joints) == 10


def test_stated_uncertainties_weigh_positions_against_attitudes(qiao):
    joints = random_joints(qiao.nominal, 30, np.random.default_rng(0))
    plain, other = (
        design_of(qiao.nominal, link_model(qiao.nominal), joints, "pose", **std)
        for std in ({}, {"position_std": 3 * POSITION_STD})
    )
    assert plain.weight == pytest.approx([1 / POSITION_STD] * 3 + [1 / ATTITUDE_STD] * 3)
    assert other.weight == pytest.approx([1 / (3 * POSITION_STD)] * 3 + [1 / ATTITUDE_STD] * 3)
    shared = [name for name in plain.model.names if name in other.model.names]
    for name in shared:
        a, b = (d.rows[..., d.model.names.index(name)] for d in (plain, other))
        np.testing.assert_allclose(b, a * np.repeat([1 / 3, 1.0], 3), rtol=1e-9, atol=1e-12)
    planned = plan_poses(
        qiao, link_model(qiao.nominal), 6, np.random.default_rng(0), candidates=30,
        position_std=3 * POSITION_STD,
    )  # fmt: skip
    np.testing.assert_allclose(planned.design.weight, other.weight)


def test_the_base_set_spans_all_that_the_poses_tell_and_no_more(qiao):
    """Rank by singular values of all 24 columns; the parameter with the largest effect of all is in it."""
    names = link_model(qiao.nominal).names
    joints = random_joints(qiao.nominal, 40, np.random.default_rng(0))
    design = design_of(qiao.nominal, link_model(qiao.nominal), joints, "pose")
    rows = seen_by(qiao.nominal, joints, names)
    assert np.linalg.matrix_rank(rows, tol=1e-6 * np.linalg.norm(rows)) == len(design.model.names) == 16
    own = np.linalg.svd(design.rows.reshape(-1, 16), compute_uv=False)
    assert own[-1] > 1e-3 * own[0]
    assert names[int(np.argmax(np.linalg.norm(rows, axis=0)))] in design.model.names
    np.testing.assert_allclose(design.rows.reshape(-1, 16), seen_by(qiao.nominal, joints, design.model.names))


def test_half_the_candidates_stand_on_the_border_two_joints_in_three(qiao):
    joints = candidate_joints(qiao.nominal, 4001, np.random.default_rng(0))
    low, high = qiao.nominal.lower, qiao.nominal.upper
    share = (joints - low) / (high - low)
    lower, upper = np.isclose(share, 0.02, rtol=0, atol=1e-9), np.isclose(share, 0.98, rtol=0, atol=1e-9)
    assert not (lower | upper)[:2000].any() and share[:2000].min() > 0.02 and share[:2000].max() < 0.98
    assert share[:2000].mean() == pytest.approx(0.5, abs=0.01)
    assert lower[2000:].mean() == pytest.approx(1 / 3, abs=0.02) and upper[2000:].mean() == pytest.approx(
        1 / 3, abs=0.02
    )


def test_the_way_begins_and_ends_where_that_saves_most():
    """On a line the best way is from one end to the other, and each move counts once."""
    joints, speed = np.array([[3.0], [0.0], [2.0], [5.0], [1.0]]), np.array([0.5])
    tour = short_tour(joints, speed)
    assert np.abs(np.diff(joints[tour, 0])).sum() == 5.0
    assert travel_seconds(joints[tour], speed) == pytest.approx(10.0)
    assert travel_seconds(joints[:1], speed) == 0.0 and short_tour(joints[:1], speed).tolist() == [0]
    seconds = move_seconds(np.array([[0.0, 0.0], [1.0, 4.0], [2.0, 1.0]]), np.array([1.0, 2.0]))
    np.testing.assert_array_equal(seconds, [[0, 2, 2], [2, 0, 1.5], [2, 1.5, 0]])


@pytest.mark.parametrize("speed", [[1.0, 0.0], [1.0, -1.0], [1.0, np.nan], [1.0, np.inf]])
def test_a_joint_that_never_arrives_is_named(speed):
    with pytest.raises(InputError, match="speed of joint 2 is"):
        travel_seconds(np.zeros((3, 2)), np.array(speed))


def test_the_information_given_from_the_start_is_a_billionth_of_a_candidates(monkeypatch):
    """What `gains` is first asked about: (1e-9 times the mean candidate's trace over p) on the diagonal."""
    rows = np.random.default_rng(0).normal(size=(12, 3, 4))
    asked = []

    def listening(candidates, information, weight):
        asked.append(information)
        return gains(candidates, information, weight)

    monkeypatch.setattr("pickenv.calibration.planning.plan.gains", listening)
    chosen, passes = exchange(rows, 3, np.random.default_rng(0))
    traces = [np.trace(one.T @ one) for one in rows]
    np.testing.assert_allclose(asked[0], 1e-9 * np.mean(traces) / 4 * np.eye(4))
    first = int(np.argmax(gains(rows, asked[0], None)))
    np.testing.assert_allclose(asked[1], asked[0] + rows[first].T @ rows[first])
    assert len(set(chosen.tolist())) == 3 and 1 <= passes <= 20


def test_exchanges_end_after_twenty_rounds(monkeypatch):
    """Gains that never settle."""
    rng = np.random.default_rng(1)
    monkeypatch.setattr("pickenv.calibration.planning.plan.gains", lambda rows, *_: rng.random(len(rows)))
    assert exchange(np.ones((50, 3, 2)), 4, np.random.default_rng(0))[1] == 20


def test_tables_are_written_in_mm_and_degrees(qiao, drawn, tmp_path):
    plan = drawn[0]
    path = plan.write_csv(tmp_path / "plan.csv", qiao.nominal.prismatic)
    scale = np.where(qiao.nominal.prismatic, 1e3, 180 / np.pi)
    np.testing.assert_allclose(np.loadtxt(path, delimiter=",", skiprows=1), plan.joints * scale, rtol=1e-9, atol=1e-9)
    halved = replace(plan, joints=plan.joints[:4])
    assert halved.as_dict()["poses"] == 4


def test_a_curve_is_told_in_mm(drawn):
    plan = replace(drawn[0], curve=((20, 0.5, 2.0), (40, 0.25, 1.0)))
    assert plan.as_dict()["curve"] == [
        {"poses": 20, "error_mm": 500.0, "random_error_mm": 2000.0},
        {"poses": 40, "error_mm": 250.0, "random_error_mm": 1000.0},
    ]
    assert "   20 poses: 500.0000 mm (2000.0000 mm)" in plan.report()
