"""Plans over priors: few poses are enough, what they promise is what calibrations then state, and chance does worse."""

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings, strategies as st
from typer.testing import CliRunner

import pickenv
from pickenv.arm import Arm, displace_pose, forward, load_arm
from pickenv.base import InputError
from pickenv.calibration import Choices, Measurements, plan_like, plan_poses, prior_model, random_joints
from pickenv.calibration.assessment.quality import workspace_error
from pickenv.calibration.identification.solve import solve
from pickenv.calibration.model.noise_and_priors import PriorModel, stated_noise
from pickenv.calibration.planning.like import first_rows
from pickenv.calibration.planning.plan import PosePlan
from pickenv.cli import app
from tests.calibration.simulated_instruments import KINDS

STD = np.repeat([1e-4, 2e-4], 3)


def expected(arm: Arm, known: bool, **more: Any) -> PriorModel:
    return prior_model(arm.name, arm.nominal, known=known, tolerances=arm.tolerance_class, **more)


def planned(arm: Arm, model: PriorModel, count: int, field: np.ndarray | None, seed: int = 1, **more: Any) -> PosePlan:
    rng = np.random.default_rng(seed)
    return plan_poses(arm, model, count, rng, candidates=300, test_joints=field, position_std=STD[0], **more)


def measured(arm: Arm, model: PriorModel, joints: np.ndarray, rng: np.random.Generator) -> Measurements:
    """An arm drawn from its own priors, frames within a centimetre, measured with noise of the stated size."""
    off = np.zeros(len(arm.nominal.parameter_names))
    off[model.parameters.columns] = np.minimum(model.width, 1e-2) * rng.normal(size=len(model.std))
    pose = displace_pose(forward(arm.nominal.displaced(off), joints), STD * rng.normal(size=(len(joints), 6)))
    return Measurements(joints, *pose, prismatic=arm.nominal.prismatic, position_std=STD[0], attitude_std=STD[3])


@given(
    name=st.sampled_from(["ur5", "qiao2026"]), known=st.booleans(), count=st.integers(3, 30), seed=st.integers(0, 9999)
)
@settings(max_examples=4, deadline=None)
def test_the_predicted_error_is_the_posteriors_over_the_workspace(
    name: str, known: bool, count: int, seed: int
) -> None:
    """Of a fit to rows simulated at the planned poses; within what 400 draws and a linear model leave."""
    arm = load_arm(name)
    model, field = expected(arm, known, scale=1.0), random_joints(arm.nominal, 200, np.random.default_rng(seed))
    plan = planned(arm, model, count, field)
    data = measured(arm, model, plan.joints, np.random.default_rng(seed))
    stated = workspace_error(solve(model, data, stated_noise(data)), arm.nominal, plan.joints, field)
    assert stated is not None and plan.predicted_error is not None
    assert stated.declared.calibrated == pytest.approx(plan.predicted_error, rel=0.1)
    low, high = stated.declared.calibrated_ends
    assert low < plan.predicted_error < high


@pytest.mark.parametrize("known", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_calibrate_states_what_was_planned(known: bool) -> None:
    """Everything as people run it; noise is found from the rows, which few rows tell within tens of per cent."""
    arm = load_arm("ur5")
    model = expected(arm, known, scale=1.0)
    plan = planned(arm, model, 40, None)
    choices = Choices(prior_scale=1.0, terms="none", residual="none", frames="known" if known else "fitted")
    shares = []
    for seed in range(3):
        data = measured(arm, model, plan.joints, np.random.default_rng(seed))
        workspace = pickenv.calibrate(arm, data, split="blocked", choices=choices).quality.workspace
        assert workspace is not None and plan.predicted_error is not None
        shares.append(workspace.declared.calibrated / plan.predicted_error)
    assert np.mean(shares) == pytest.approx(1.0, abs=0.15)


@given(name=st.sampled_from(["ur5", "qiao2026", "wam"]), known=st.booleans(), seed=st.integers(0, 9999))
@example(name="ur5", known=False, seed=854)  # three poses with much information, and none about the workspace
@settings(max_examples=2, deadline=None)
def test_no_plan_is_worse_than_chance(name: str, known: bool, seed: int) -> None:
    """Nor where it is made for the most information, and not for the workspace."""
    arm = load_arm(name)
    model, rng = expected(arm, known), np.random.default_rng(seed)
    count, field = int(rng.integers(2, 25)), random_joints(arm.nominal, 100, rng)
    for criterion in ("d-optimal", "test-poses"):
        for kind in ("pose", "position"):
            plan = planned(arm, model, count, field, seed, criterion=criterion, kind=kind)
            assert plan.predicted_error is not None and plan.random_predicted_error is not None
            assert plan.predicted_error <= plan.random_predicted_error


def test_one_pose_is_a_plan_where_all_is_expected_somewhere() -> None:
    arm = load_arm("ur5")
    plan = planned(arm, expected(arm, False), 1, None, curve=True)
    assert len(plan.joints) == 1 and plan.arm is None and plan.as_dict()["condition"] is None
    assert "over the joint ranges" in plan.report()
    sizes, errors, _ = zip(*plan.curve, strict=True)
    assert sizes == (1, 2, 4, 8) and list(errors) == sorted(errors, reverse=True)
    with pytest.raises(InputError, match="301 poses cannot be chosen from 300 candidates"):
        planned(arm, expected(arm, False), 301, None)


def test_what_is_known_well_beforehand_is_not_worth_a_pose() -> None:
    """With parts made a thousand times better, one pose for the frames says all; with parts made worse it does not."""
    arm = load_arm("ur5")
    errors = [planned(arm, expected(arm, False, scale=scale), 3, None).predicted_error for scale in (1e-3, 1.0, 30.0)]
    assert errors[0] < 1e-2 * errors[1] < 1e-2 * errors[2]  # type: ignore[operator]


@pytest.mark.parametrize("kind", ["wire", "touches", "plane"])
def test_other_instruments_are_planned_for_over_priors_too(kind: str) -> None:
    """Wire and plane from so few first rows, of one equation each, that none could be planned without priors."""
    arm = load_arm("ur5")
    data: Any = KINDS[kind](arm.nominal, 15, np.random.default_rng(0), 1.0)
    few, rng = data.select(np.arange(12)), np.random.default_rng(1)
    plan = plan_like(arm, few, 3, rng, candidates=150, criterion="test-poses", prior=expected(arm, False))
    assert plan.first == 12 and set(data.unknowns()) <= set(plan.parameters)
    assert not any(name.startswith("base_") for name in plan.parameters)
    assert 0.0 < plan.predicted_error < plan.random_predicted_error  # type: ignore[operator]
    if kind == "touches":
        return
    with pytest.raises(InputError, match="too few for"):
        plan_like(arm, few, 3, np.random.default_rng(1), candidates=150)


@pytest.mark.parametrize("kind", sorted(KINDS))
def test_the_error_to_expect_of_other_instruments_is_the_posteriors_too(kind: str) -> None:
    """One pose more than the first rows, of any kind: the plan's error and that of a fit to all these rows."""
    arm = load_arm("ur5")
    near = random_joints(arm.nominal, 100, np.random.default_rng(5))
    data: Any = KINDS[kind](arm.nominal, 26, np.random.default_rng(0), 1.0)
    model, few = expected(arm, False, scale=1.0), data.select(np.arange(25))
    plan = plan_like(
        arm,
        few,
        1,
        np.random.default_rng(1),
        candidates=data.joints,
        criterion="test-poses",
        test_joints=near,
        prior=model,
    )
    all_rows = data.select(np.r_[:25, data_row(data, plan)])
    _, first, _ = first_rows(arm, few)
    solution = solve(replace(model, start=first), all_rows, stated_noise(all_rows))
    stated = workspace_error(solution, first.geometry, all_rows.joints, near)
    assert stated is not None
    assert stated.declared.calibrated == pytest.approx(plan.predicted_error, rel=0.15)


def data_row(data: Any, plan: PosePlan) -> int:
    """The row of the one pose planned."""
    return int(np.argmin(np.linalg.norm(data.joints - plan.joints[0], axis=1)))


def test_the_command_takes_the_class_and_its_factor(tmp_path: Any) -> None:
    def call(*words: object) -> dict[str, Any]:
        out = tmp_path / "plan.json"
        done = CliRunner().invoke(app, [*map(str, ("plan-poses", "--arm", "ur5", *words, "--json", out))])
        assert done.exit_code == 0, done.output
        return json.loads(out.read_text())  # type: ignore[no-any-return]

    few = ("--n", 4, "--candidates", 200)
    fine, cobot, wide = (call(*few, *more) for more in (("--tolerances", "fine"), (), ("--prior-scale", 5)))
    assert cobot["where"] == "over the joint ranges" and len(cobot["parameters"]) > 24
    assert fine["predicted_error_mm"] < cobot["predicted_error_mm"] < wide["predicted_error_mm"]
    assert call(*few, "--prior-scale", 1)["predicted_error_mm"] == cobot["predicted_error_mm"]
    unknown = CliRunner().invoke(app, ["plan-poses", "--arm", "ur5", "--tolerances", "no such class"])
    assert isinstance(unknown.exception, InputError) and "no such class" in str(unknown.exception)
