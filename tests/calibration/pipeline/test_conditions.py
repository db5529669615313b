"""Payload and temperature (future work of Qiao 2026): a residual of joints alone fails, one that is told does not."""

import numpy as np
import pytest

from pickenv.arm import load_plant, pose_error
from pickenv.calibration import random_joints
from pickenv.calibration.pipeline.conditions_study import ConditionsSettings, conditions_study, measured_under, under
from pickenv.errors import InputError

BLIND, TOLD, TERMS = "joints only", "residual with conditions", "terms"
COLD, BOTH = "joints only, learnt at the reference", "terms and residual with conditions"


@pytest.fixture(scope="module", params=[0, 1])
def study(request, dynamic):
    return conditions_study(dynamic, ConditionsSettings(residual="rbf", seed=request.param))


def test_the_plant_moves_with_payload_and_heat_as_physics_says(dynamic):
    """0.5 kg on 1.2 m bends and yields by tenths of a millimetre; 20 K grow the lengths by 0.46 per mille."""
    joints = random_joints(dynamic.arm.nominal, 200, np.random.default_rng(0))
    zero = np.zeros(200)
    still = under(dynamic, zero, zero).tool_pose(joints)
    unmoved = pose_error(dynamic.tool_pose(joints), still)
    np.testing.assert_allclose(unmoved, 0, atol=1e-12)
    loaded = pose_error(still, under(dynamic, zero + 0.5, zero).tool_pose(joints))[:, :3]
    assert 0.2e-3 < np.linalg.norm(loaded, axis=1).mean() < 2e-3 and loaded[:, 2].mean() < 0
    warm = np.linalg.norm(pose_error(still, under(dynamic, zero, zero + 20.0).tool_pose(joints))[:, :3], axis=1)
    reach = np.linalg.norm(still.position, axis=1)
    np.testing.assert_allclose(warm.mean(), 20 * 23e-6 * reach.mean(), rtol=0.25)


def test_conditions_are_recorded_and_each_pose_has_its_own(dynamic):
    joints = random_joints(dynamic.arm.nominal, 3, np.random.default_rng(0))[[0, 0, 0]]
    payload, heat = np.array([0.0, 0.5, 0.0]), np.array([0.0, 0.0, 20.0])
    data = measured_under(
        dynamic.without(["measurement_noise"]), joints, payload, heat, np.random.default_rng(0), 23e-6
    )
    np.testing.assert_array_equal(data.conditions.inputs(), np.stack([payload, heat], -1))
    moved = np.linalg.norm(data.position - data.position[0], axis=1)
    assert moved[1] > 1e-4 and moved[2] > 1e-4


def test_a_residual_learnt_at_the_reference_fails_when_conditions_change(study):
    """It has at least doubled, with the intervals apart; conditions as inputs or terms stay where they were."""
    assert study.statistics("both", COLD).mean_ci95[0] > 2 * study.statistics("reference", COLD).mean_ci95[1]
    for method in (TERMS, BOTH):
        changed, before = study.statistics("both", method), study.statistics("reference", method)
        assert changed.mean < 1.15 * before.mean


@pytest.mark.parametrize("case", ["payload", "heat", "both"])
def test_being_told_the_conditions_wins(study, case):
    """Paired by pose, 95 % interval above zero; also against a joints-only residual that learnt from all conditions."""
    for method, over in ((TOLD, COLD), (TOLD, BLIND), (TERMS, BLIND), (BOTH, BLIND), (BOTH, TOLD)):
        gain, low, _ = study.gain(case, method, over)
        assert gain > 0 and low > 0, (method, over)
    assert study.statistics(case, BOTH).mean < 0.15 < 0.3 < study.statistics(case, COLD).mean


def test_the_expansion_coefficient_is_found(study):
    """To a tenth: periodic drive errors, which no term here explains, pull at it."""
    assert study.coefficients["thermal"] == pytest.approx(study.true_expansion, rel=0.12)
    assert 1 / study.coefficients["compliance1"] == pytest.approx(1.4e4, rel=0.25)


def test_the_report_names_every_case_and_method(study):
    text, found = study.report(), study.as_dict()["cases"]
    assert set(found) == {"reference", "payload", "heat", "both"}
    for method in found["both"]:
        assert method in text
        low, high = found["both"][method]["mean_ci95"]
        assert low < found["both"][method]["mean"] < high


def test_a_plant_without_masses_is_refused():
    with pytest.raises(InputError, match="no \\[load\\]"):
        under(load_plant("geometry_only"), np.zeros(1), np.zeros(1))
