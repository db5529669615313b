"""Planned poses tell more than poses drawn at random, stay within the joint limits and travel little."""

import json
from dataclasses import replace
from itertools import pairwise, permutations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from typer.testing import CliRunner

from pickenv.arm import Plant, Pose, displace_pose, draw_plants, forward, load_arm, load_tolerances, plant_at
from pickenv.base import InputError
from pickenv.calibration import (
    ErrorModel,
    Measurements,
    complete_model,
    identify,
    link_model,
    plan_poses,
    prior_model,
    random_joints,
    simulated_tracker,
)
from pickenv.calibration.assessment.quality import workspace_error
from pickenv.calibration.identification.least_squares import observability
from pickenv.calibration.identification.solve import solve
from pickenv.calibration.model.noise_and_priors import MADE, stated_noise
from pickenv.calibration.planning.plan import (
    candidate_joints,
    design_of,
    error_weight,
    exchange,
    gains,
    move_seconds,
    predicted_error,
    short_tour,
    travel_seconds,
)
from pickenv.cli import app


def information(rows):
    stacked = rows.reshape(-1, rows.shape[-1])
    return stacked.T @ stacked


def test_indices_of_a_known_spectrum():
    found = observability(np.array([8.0, 2.0, 4.0]), 4)
    assert found["o1"] == pytest.approx(4.0 / 2.0)
    assert [found[name] for name in ("o2", "o3", "o4", "condition")] == pytest.approx([0.25, 2.0, 0.5, 4.0])
    assert found["o5"] == pytest.approx(1 / (1 / 8 + 1 / 4 + 1 / 2))


@given(poses=st.integers(1, 5), seed=st.integers(0, 2**32 - 1))
def test_o1_is_the_root_of_the_determinant_and_does_not_grow_with_repetition(poses, seed):
    rows = np.random.default_rng(seed).normal(size=(30, 5))
    once = observability(np.linalg.svd(rows, compute_uv=False), 30)
    again = observability(np.linalg.svd(np.tile(rows, (poses, 1)), compute_uv=False), 30 * poses)
    assert once["o1"] == pytest.approx(np.linalg.det(rows.T @ rows) ** (1 / 10) / np.sqrt(30))
    assert again["o1"] == pytest.approx(once["o1"]) and again["condition"] == pytest.approx(once["condition"])


def test_parameters_that_are_not_seen_have_no_indices():
    with pytest.raises(ValueError, match="above zero"):
        observability(np.array([1.0, 0.0]), 3)


def test_the_indices_of_an_identification_are_those_of_its_jacobian(qiao, exact):
    found = identify(link_model(qiao.nominal), qiao.nominal, exact(qiao.nominal, 40)).identifiability
    seen = observability(found.singular_values * np.sqrt(40), 40)
    assert seen["condition"] == pytest.approx(found.singular_values[0] / found.singular_values[-1])
    assert seen["o3"] == pytest.approx(found.singular_values.min() * np.sqrt(40))


@given(seed=st.integers(0, 2**32 - 1), rows=st.sampled_from([3, 6]))
@settings(max_examples=30, deadline=None)
def test_gains_are_those_of_the_enlarged_matrix(seed, rows):
    """Determinant lemma and Woodbury against determinants and inverses computed anew."""
    rng = np.random.default_rng(seed)
    candidates, start = rng.normal(size=(5, rows, 4)), rng.normal(size=(20, 4))
    before, weight = start.T @ start, np.diag([1.0, 2.0, 0.5, 0.1])
    volume, error = gains(candidates, before, None), gains(candidates, before, weight)
    for one, added, fallen in zip(candidates, volume, error, strict=True):
        after = before + one.T @ one
        assert added == pytest.approx(np.linalg.slogdet(after)[1] - np.linalg.slogdet(before)[1])
        fall = np.trace(weight @ np.linalg.inv(before)) - np.trace(weight @ np.linalg.inv(after))
        assert fallen == pytest.approx(fall)


@pytest.mark.parametrize("aimed", [False, True])
def test_no_single_exchange_betters_the_result(qiao, aimed):
    rng = np.random.default_rng(3)
    design = design_of(qiao.nominal, link_model(qiao.nominal), random_joints(qiao.nominal, 60, rng), "pose")
    weight = error_weight(qiao.nominal, design, random_joints(qiao.nominal, 20, rng)) if aimed else None
    chosen, _ = exchange(design.rows, 8, rng, weight)

    def cost(rows):
        matrix = information(design.rows[rows])
        return -np.linalg.slogdet(matrix)[1] if weight is None else np.trace(np.linalg.solve(matrix, weight))

    assert len(set(chosen.tolist())) == 8
    best = cost(chosen)
    for place in range(8):
        for other in sorted(set(range(60)) - set(chosen.tolist())):
            tried = chosen.copy()
            tried[place] = other
            assert cost(tried) >= best - 1e-6 * abs(best)


@pytest.mark.parametrize("seed", range(3))
def test_twenty_planned_poses_are_well_conditioned(qiao, seed):
    """Base 16: condition at most 37 where random poses have 54 or so; O1 1.29 times theirs from even draws."""
    model = link_model(qiao.nominal)
    planned = plan_poses(qiao, model, 20, np.random.default_rng(seed))
    assert len(planned.arm["parameters"]) == 16
    assert planned.arm["condition"] <= 37.0
    assert 45.0 < planned.arm["random_condition"] < 70.0
    even = random_joints(qiao.nominal, 2000, np.random.default_rng(seed))
    drawn = plan_poses(qiao, model, 20, np.random.default_rng(seed), candidates=even)
    assert drawn.arm["o1_ratio"] == pytest.approx(1.29, abs=0.03)
    planned_o1, drawn_o1 = (plan.arm["observability"]["o1"] for plan in (planned, drawn))
    assert planned_o1 > drawn_o1  # the border of the joint ranges tells more


def test_the_arm_is_well_conditioned_when_base_and_tool_are_planned_for(qiao):
    planned = plan_poses(qiao, complete_model(qiao.nominal), 20, np.random.default_rng(0))
    assert len(planned.model["parameters"]) == 24 and planned.arm["condition"] <= 37.0
    found = planned.as_dict()
    assert found["condition"] == planned.arm["condition"] and found["o1_ratio"] > 1.25
    assert "condition" in planned.report()


@pytest.mark.parametrize(("arm", "kind"), [("qiao2026", "position"), ("ur5", "pose"), ("wam", "position")])
def test_plans_stay_within_limits_and_are_the_same_for_one_seed(arm, kind, tmp_path):
    chosen = load_arm(arm)
    first, again = (
        plan_poses(chosen, complete_model(chosen.nominal), 25, np.random.default_rng(5), kind=kind, candidates=400)
        for _ in range(2)
    )
    np.testing.assert_array_equal(first.joints, again.joints)
    assert (first.joints >= chosen.nominal.lower).all() and (first.joints <= chosen.nominal.upper).all()
    assert first.model["o1_ratio"] > 1.0
    path = first.write_csv(tmp_path / "poses.csv", chosen.nominal.prismatic)
    scale = np.where(chosen.nominal.prismatic, 1e-3, np.pi / 180)
    np.testing.assert_allclose(np.loadtxt(path, delimiter=",", skiprows=1) * scale, first.joints, atol=1e-12)


def test_planning_for_test_poses_is_better_there_than_planning_for_all(qiao):
    near = random_joints(qiao.nominal, 100, np.random.default_rng(7)) * [0.2, 0.3, 1.0, 0.2, 0.5, 0.1]
    model = complete_model(qiao.nominal)
    there, everywhere = (
        plan_poses(qiao, model, 30, np.random.default_rng(0), criterion=c, test_joints=near, candidates=600)
        for c in ("test-poses", "d-optimal")
    )
    assert there.predicted_error < 0.97 * everywhere.predicted_error < 0.97 * there.random_predicted_error
    assert there.model["observability"]["o1"] < everywhere.model["observability"]["o1"]


def test_the_predicted_error_is_what_repeated_identification_shows(qiao):
    """Noise of the stated size, 100 calibrations at the planned poses, errors at the test poses."""
    rng = np.random.default_rng(2)
    nominal, model = qiao.nominal, link_model(qiao.nominal)
    near = random_joints(nominal, 50, rng)
    planned = plan_poses(qiao, model, 20, rng, candidates=300, test_joints=near)
    base = planned.design.model
    columns = [model.columns.tolist().index(c) for c in base.columns]
    kept = ErrorModel(model.columns[columns], base.names, base.tolerance)
    pose, there = forward(nominal, planned.joints), forward(nominal, near).position
    squares = []
    for _ in range(100):
        noisy: Pose = displace_pose(pose, rng.normal(size=(20, 6)) * np.repeat([15e-6, 2e-4], 3))
        data = Measurements(planned.joints, *noisy, prismatic=nominal.prismatic)
        found = identify(kept, nominal, data).geometry
        squares.append(np.mean(np.sum((forward(found, near).position - there) ** 2, axis=1)))
    assert np.sqrt(np.mean(squares)) == pytest.approx(planned.predicted_error, rel=0.1)


def test_candidates_reach_the_border_but_not_the_limits(qiao):
    geometry = qiao.nominal
    joints = candidate_joints(geometry, 1000, np.random.default_rng(0))
    share = (joints - geometry.lower) / (geometry.upper - geometry.lower)
    assert share.min() == pytest.approx(0.02) and share.max() == pytest.approx(0.98)
    border = (share < 0.0201) | (share > 0.9799)
    assert 0.25 < np.mean(border) < 0.42 and not border[:500].any()
    few = np.array([candidate_joints(geometry, 2, np.random.default_rng(seed)) for seed in range(40)])
    near = (few - geometry.lower) / (geometry.upper - geometry.lower)
    assert np.isclose(near, 0.02).any(), "of two, one may touch it"


def test_faults_are_named(qiao):
    model, rng = link_model(qiao.nominal), np.random.default_rng(0)
    with pytest.raises(InputError, match="3 poses are too few for 16 parameters; plan at least 4"):
        plan_poses(qiao, model, 3, rng)
    with pytest.raises(InputError, match="from 10 candidates"):
        plan_poses(qiao, model, 11, rng, candidates=10)
    with pytest.raises(InputError, match="needs test poses"):
        plan_poses(qiao, model, 20, rng, criterion="test-poses")
    with pytest.raises(InputError, match="kind is 'photo'"):
        plan_poses(qiao, model, 20, rng, kind="photo")
    with pytest.raises(InputError, match="criterion is 'luck'"):
        plan_poses(qiao, model, 20, rng, criterion="luck")


@given(count=st.integers(1, 7), seed=st.integers(0, 2**32 - 1))
@settings(max_examples=30, deadline=None)
def test_tours_visit_all_and_are_near_the_shortest(count, seed):
    joints = np.random.default_rng(seed).uniform(-1, 1, (count, 6))
    speed = np.array([1.0, 0.5, 0.5, 1.0, 0.5, 3.0])
    tour = short_tour(joints, speed)
    assert sorted(tour.tolist()) == list(range(count))
    cost = move_seconds(joints, speed)
    shortest = min(sum(cost[a, b] for a, b in pairwise(w)) for w in permutations(range(count)))
    assert shortest - 1e-12 <= travel_seconds(joints[tour], speed) <= 1.15 * shortest + 1e-12


def test_the_slowest_joint_sets_the_time_of_a_move():
    assert travel_seconds(np.array([[0.0, 0.0], [1.0, 0.3], [1.0, 0.0]]), np.array([2.0, 0.1])) == pytest.approx(6.0)


def test_thirty_poses_travel_much_less_than_in_random_order(qiao):
    planned = plan_poses(qiao, link_model(qiao.nominal), 30, np.random.default_rng(1))
    assert planned.travel_seconds < 0.75 * planned.random_travel_seconds
    assert planned.travel_seconds == pytest.approx(travel_seconds(planned.joints, qiao.speed))


def test_a_base_set_spans_what_the_model_spans(qiao, exact):
    design = design_of(
        qiao.nominal, complete_model(qiao.nominal), random_joints(qiao.nominal, 50, np.random.default_rng(0)), "pose"
    )
    assert len(design.model.names) == 24
    error = predicted_error(design.rows, error_weight(qiao.nominal, design, design.joints))
    halved = replace(design, rows=design.rows * 2)
    assert predicted_error(halved.rows, error_weight(qiao.nominal, halved, design.joints)) == pytest.approx(error / 2)


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=10, deadline=None)
def test_no_reversal_of_a_stretch_shortens_a_tour(seed):
    joints, speed = np.random.default_rng(seed).uniform(-1, 1, (25, 4)), np.array([1.0, 0.5, 2.0, 1.0])
    joints = joints[short_tour(joints, speed)]
    shortest = travel_seconds(joints, speed)
    for i, j in np.argwhere(np.triu(np.ones((25, 25)), 1)):
        turned = np.concatenate([joints[:i], joints[i : j + 1][::-1], joints[j + 1 :]])
        assert travel_seconds(turned, speed) >= shortest - 1e-9


def test_poses_are_chosen_from_a_file_and_named_by_its_lines(qiao, tmp_path):
    rng = np.random.default_rng(8)
    joints = random_joints(qiao.nominal, 80, rng)
    pool = Measurements(joints, *forward(qiao.nominal, joints), prismatic=qiao.nominal.prismatic)
    figures, out = tmp_path / "plan.json", tmp_path / "plan.csv"
    words = ["plan-poses", "--arm", "qiao2026", "--n", "20", "--from", str(pool.write_csv(tmp_path / "pool.csv"))]
    said = CliRunner().invoke(app, [*words, "--curve", "--json", str(figures), "--out", str(out)])
    assert said.exit_code == 0, said.output
    found = json.loads(figures.read_text(encoding="utf-8"))
    assert len(set(found["lines"])) == 20
    assert f"lines of the file, in measuring order: {found['lines'][0]}, " in said.output
    scale = np.where(qiao.nominal.prismatic, 1e3, np.degrees(1.0))
    written = np.loadtxt(out, delimiter=",", skiprows=1)
    np.testing.assert_allclose(written, joints[np.array(found["lines"]) - 2] * scale, rtol=1e-9)
    assert found["condition"] < found["random_condition"]  # of sets drawn from the same file
    assert [point["poses"] for point in found["curve"]] == [10, 20, 40, 80]
    refused = CliRunner().invoke(app, ["plan-poses", "--arm", "qiao2026", "--columns", "ur5_jacobi2025"])
    assert "describes the file of --like or --from" in str(refused.exception)
    refused = CliRunner().invoke(app, ["plan-poses", "--arm", "qiao2026", "--noise-mm", "0"])
    assert "--noise-mm is 0.0; give 1e-06 to 100" in str(refused.exception)


@pytest.mark.parametrize("near_them", [False, True], ids=["field", "test poses"])
def test_the_curve_is_the_error_that_calibrations_show(qiao, near_them):
    """Of arms identified from as many planned poses: RMS error over the joint ranges, or over the poses given."""
    rng = np.random.default_rng(2)
    near = random_joints(qiao.nominal, 40, rng) * 0.5 if near_them else None
    plan = plan_poses(
        qiao, link_model(qiao.nominal), 12, rng, candidates=300, kind="position", test_joints=near,
        position_std=1e-4, curve=True,
    )  # fmt: skip
    assert plan.criterion == ("test-poses" if near_them else "d-optimal")
    sizes, errors, by_chance = zip(*plan.curve, strict=True)
    assert sizes[1] == 12 and list(sizes) == sorted(sizes) and sizes[-1] <= 300
    assert all(a > b for a, b in pairwise(errors))
    assert all(a < b for a, b in zip(errors[:3], by_chance, strict=False))
    there = random_joints(qiao.nominal, 300, rng) if near is None else near
    truth, left = forward(qiao.true, there).position, []
    for _ in range(40):
        position = forward(qiao.true, plan.joints).position + 1e-4 * rng.normal(size=(12, 3))
        data = Measurements(plan.joints, position, None, qiao.nominal.prismatic, position_std=1e-4)
        found = identify(link_model(qiao.nominal), qiao.nominal, data).geometry
        left.append(np.sum((forward(found, there).position - truth) ** 2, axis=1).mean())
    assert np.sqrt(np.mean(left)) == pytest.approx(errors[1], rel=0.15)


@pytest.mark.parametrize("known", [True, False])
def test_with_priors_the_predicted_error_is_the_one_that_a_calibration_states(known):
    """Six poses, fewer equations than parameters: what the plan says is what the posterior of such rows says."""
    ur5, rng = load_arm("ur5"), np.random.default_rng(3)
    near = random_joints(ur5.nominal, 60, rng)
    model = prior_model("ur5", ur5.nominal, known=known, scale=1.0)
    planned = plan_poses(ur5, model, 6, rng, candidates=300, test_joints=near)
    assert len(model.std) > 6 * 6
    arms = draw_plants(Plant("ur5", ur5, ur5.nominal), load_tolerances("cobot"), 1, rng)
    rows = simulated_tracker(plant_at(arms, 0), planned.joints, rng)
    rows = replace(rows, std_stated=True)
    solution = solve(model, rows, stated_noise(rows))
    workspace = workspace_error(solution, ur5.nominal, rows.joints, near)
    assert workspace.declared.calibrated == pytest.approx(planned.predicted_error, rel=0.1)
    assert planned.predicted_error < planned.random_predicted_error < workspace.declared.expected


def test_wide_priors_plan_as_none_and_narrow_ones_leave_nothing_to_tell():
    ur5 = load_arm("ur5")
    near = random_joints(ur5.nominal, 60, np.random.default_rng(3))

    def error(model):
        rng = np.random.default_rng(0)
        return plan_poses(ur5, model, 30, rng, candidates=300, test_joints=near).predicted_error

    model = prior_model("ur5", ur5.nominal, known=True)
    wide, expected, narrow = (error(replace(model, scales=dict.fromkeys(MADE, s))) for s in (1e4, 1.0, 1e-6))
    assert wide == pytest.approx(error(model.parameters), rel=0.02)
    assert narrow < 1e-3 * expected and expected < 1.01 * wide


def test_the_command_plans_fewer_poses_than_parameters_where_priors_say_the_rest(tmp_path):
    out = ["--out", str(tmp_path / "few.csv"), "--json", str(tmp_path / "few.json")]
    done = CliRunner().invoke(app, ["plan-poses", "--arm", "ur5", "--n", "3", "--candidates", "100", *out])
    assert done.exit_code == 0 and json.loads((tmp_path / "few.json").read_text())["poses"] == 3
    with pytest.raises(InputError, match="3 poses are too few for 30 parameters"):
        plan = ["plan-poses", "--arm", "ur5", "--n", "3", "--candidates", "100", "--fit", "full"]
        CliRunner().invoke(app, plan, catch_exceptions=False, standalone_mode=False)


def test_a_place_of_few_poses_is_refused_where_fitted_frames_alone_explain_them(tmp_path):
    """Base and tool have 12 numbers: an error of 0.0000 mm was promised at up to four poses."""
    arm, rng = load_arm("ur5e"), np.random.default_rng(3)
    near, fitted = random_joints(arm.nominal, 8, rng), prior_model(arm.name, arm.nominal, known=False)
    with pytest.raises(InputError, match=r"7 test poses tell no error .*give 8 poses or more around the place"):
        plan_poses(arm, fitted, 12, rng, candidates=100, test_joints=near[:7])
    assert plan_poses(arm, fitted, 12, rng, candidates=100, test_joints=near).predicted_error > 0.0
    assert plan_poses(arm, link_model(arm.nominal), 12, rng, candidates=100, test_joints=near[:1]).predicted_error > 0.0
