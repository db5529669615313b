"""The verdict on a calibration, and what it rests on: chi^2, correlations, combinations, uncertainty."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from pickenv.arm import displace_pose, forward, parameter_jacobian, pose_error
from pickenv.calibration import (
    Measurements,
    assess,
    fit,
    identify,
    link_model,
    random_joints,
    simulated_tracker,
    uncertainty_from,
)
from pickenv.calibration.assessment.quality import (
    axis_errors,
    completeness,
    grade_quality,
)
from pickenv.calibration.pipeline.calibration import PoseUncertainty


@pytest.fixture(scope="module")
def noisy(table_1):
    """Table 1's arm seen by the tracker of the dynamic plant; ``noisy(count, seed)``."""

    def measure(count, seed, scale=1.0):
        rng = np.random.default_rng(seed)
        joints = random_joints(table_1.arm.nominal, count, rng)
        pose = table_1.tool_pose(joints)
        pose = displace_pose(pose, scale * rng.normal(size=(count, 6)) * np.repeat([15e-6, 2e-4], 3))
        return Measurements(joints, *pose, prismatic=table_1.geometry.prismatic)

    return measure


@pytest.fixture(scope="module")
def calibrated(dynamic):
    rng = np.random.default_rng(0)
    train, test = (simulated_tracker(dynamic, random_joints(dynamic.arm.nominal, n, rng), rng) for n in (80, 200))
    return fit(dynamic.arm, train), train, test


def test_p_values_are_even_when_the_model_is_complete(qiao, noisy):
    """60 data sets with noise as stated: the p-values of a true hypothesis spread evenly over 0 to 1."""
    model = link_model(qiao.nominal)
    values = [completeness(identify(model, qiao.nominal, noisy(20, seed))).p_value for seed in range(60)]
    assert stats.kstest(values, "uniform").pvalue > 0.01
    assert np.mean([v < 0.05 for v in values]) < 0.15


def test_p_is_scipys_and_small_where_effects_are_left(qiao, noisy, calibrated):
    found = identify(link_model(qiao.nominal), qiao.nominal, noisy(20, 1))
    test = completeness(found)
    assert test.degrees_of_freedom == 6 * 20 - 16
    assert test.p_value == pytest.approx(stats.chi2.sf(found.chi_square, 104))
    assert test.complete and "complete" in test.sentence()
    left = completeness(calibrated[0].identification)
    assert not left.complete and left.p_value < 1e-12 and left.reduced > 50
    assert "effects beyond the model" in left.sentence()


def test_noise_stated_too_large_is_noticed(qiao, noisy):
    found = completeness(identify(link_model(qiao.nominal), qiao.nominal, noisy(40, 1, scale=0.5)))
    assert found.complete and found.reduced == pytest.approx(0.25, abs=0.06) and "too large" in found.sentence()


@pytest.mark.slow
def test_correlations_are_those_of_repeated_identification(qiao, noisy):
    model = link_model(qiao.nominal)
    found = [identify(model, qiao.nominal, noisy(12, 5))]
    joints = noisy(12, 5).joints
    rng = np.random.default_rng(0)
    pose = forward(found[0].geometry, joints)
    deltas = []
    for _ in range(300):
        data = Measurements(
            joints,
            *displace_pose(pose, rng.normal(size=(12, 6)) * np.repeat([15e-6, 2e-4], 3)),
            prismatic=qiao.nominal.prismatic,
        )
        deltas.append(identify(model, qiao.nominal, data).delta[found[0].identifiability.kept])
    empirical = np.corrcoef(np.array(deltas).T)
    std = np.sqrt(np.diag(found[0].covariance))
    stated = found[0].covariance / np.outer(std, std)
    pairs = np.triu(np.abs(stated) > 0.5, 1)
    assert pairs.sum() >= 1
    np.testing.assert_allclose(empirical[pairs], stated[pairs], atol=0.12)


def test_combinations_are_what_is_identified(qiao, exact):
    """The digest's base values of Table 1: a1* = 1.390, a4* = 1.010, d1* = 0.512, d5* = 0.700 mm."""
    found = identify(link_model(qiao.nominal), qiao.nominal, exact(qiao.true))
    change = dict(zip(found.identifiability.names, found.delta * 1e3, strict=True))
    assert [change[n] for n in ("a1", "a4", "d1", "d5")] == pytest.approx([1.390, 1.010, 0.512, 0.700], abs=1e-3)


def test_statistics_per_degree_of_freedom():
    errors = np.array([[1e-3, 0, 0, np.radians(2), 0, 0], [-3e-3, 0, 0, np.radians(2), 0, 0]])
    axes = axis_errors(errors)
    assert list(axes) == ["x (mm)", "y (mm)", "z (mm)", "rx (deg)", "ry (deg)", "rz (deg)"]
    assert axes["x (mm)"] == pytest.approx((-1, 2, np.sqrt(5), 3)) and axes["y (mm)"][2:] == (0, 0)
    assert axes["rx (deg)"][:2] == pytest.approx((2, 0), abs=1e-12)
    assert len(axis_errors(errors[:, :3])) == 3


def test_verdicts(calibrated):
    found, train, test = calibrated
    trained = train.difference(found.calibration.identified)
    before, after = (test.difference(g) for g in (found.calibration.nominal, found.calibration.identified))
    good = grade_quality(found.identification, trained, before, after)
    assert good.grade == "good" and good.reason.startswith("on 200 held-out rows the error falls from")
    assert axis_errors(after)["z (mm)"][2] < axis_errors(before)["z (mm)"][2]
    worse = grade_quality(found.identification, trained, after, before)
    assert worse.grade == "do not use" and worse.findings[0][0] == "fail" and "no better" in worse.reason
    assert worse.findings[0] not in worse.others
    few = grade_quality(found.identification, trained, before[:2], after[:2])
    assert few.grade == "do not use" and "only 2 rows were held out" in few.reason
    noisy = np.random.default_rng(0).normal(size=(2, 30, 6)) * 20e-3
    chance = grade_quality(found.identification, trained, noisy[0], 0.99 * noisy[1])
    assert chance.grade == "do not use" and ("cannot be told from" in chance.reason or "no better" in chance.reason)
    unsettled = grade_quality(replace(found.identification, converged=False), trained, before, after)
    assert unsettled.grade == "do not use"
    flattered = grade_quality(found.identification, trained / 3, before, after)
    assert flattered.grade == "with care" and "held-out errors" in flattered.findings[0][1]


def test_predicted_uncertainty_is_what_repeated_calibration_shows(qiao, noisy, table_1):
    """Pose errors of 150 calibrations against J C J^T, at poses that none has seen."""
    model = link_model(qiao.nominal)
    there = random_joints(qiao.nominal, 40, np.random.default_rng(99))
    truth = table_1.tool_pose(there)
    runs = [identify(model, qiao.nominal, noisy(20, seed)) for seed in range(150)]
    errors = np.array([pose_error(truth, forward(run.geometry, there)) for run in runs])
    predicted = np.zeros((40, 6, 6))
    for run in runs[:20]:
        sure = PoseUncertainty.of(run, np.zeros((2, 6)))
        predicted += sure.pose_covariance(run.arm_model, there) / 20
    seen = np.sqrt(np.mean(errors**2, axis=(0, 1)))
    np.testing.assert_allclose(seen, np.sqrt(np.mean(np.diagonal(predicted, axis1=1, axis2=2), axis=0)), rtol=0.12)


def test_uncertainty_adds_what_one_reach_scatters_by_and_survives_the_file(calibrated, dynamic, tmp_path):
    found, train, test = calibrated
    sure = PoseUncertainty.of(found.identification, found.calibration.errors(test))
    joints = test.joints[:7].reshape(7, 1, 6)
    covariance = sure.pose_covariance(found.calibration.model, joints)
    assert covariance.shape == (7, 1, 6, 6) and (np.linalg.eigvalsh(covariance) > 0).all()
    position, attitude = sure.standard(found.calibration.model, joints)
    assert (position > np.sqrt(3) * sure.position_repeat).all() and (attitude > np.sqrt(3) * sure.attitude_repeat).all()
    bare = replace(sure, position_repeat=0.0, attitude_repeat=0.0).standard(found.calibration.model, joints)[0]
    np.testing.assert_allclose(position**2, bare**2 + 3 * sure.position_repeat**2)
    np.testing.assert_allclose(sure.from_parameters(found.calibration.model, joints), bare)
    saved = assess(dynamic.arm, found, train, test).calibration
    again = type(saved).load(saved.save(tmp_path / "c")).record
    kept = uncertainty_from(again)
    np.testing.assert_array_equal(kept.covariance, sure.covariance)
    assert kept.names == sure.names and kept.position_repeat == sure.position_repeat
    assert uncertainty_from(found.calibration.record) is None


def test_most_held_out_errors_lie_within_two_standard_uncertainties(calibrated):
    found, _, test = calibrated
    errors = found.calibration.errors(test)
    half = np.arange(len(test)) % 2 == 0
    sure = PoseUncertainty.of(found.identification, errors[half])
    spread = np.sqrt(np.diagonal(sure.pose_covariance(found.calibration.model, test.joints[~half]), axis1=1, axis2=2))
    assert 0.9 < np.mean(np.abs(errors[~half]) < 2 * spread) < 1.0


def test_only_the_jacobians_columns_of_kept_parameters_count(calibrated):
    found, _, test = calibrated
    sure = PoseUncertainty.of(found.identification, np.zeros((1, 6)))
    geometry = found.calibration.identified
    columns = [geometry.parameter_names.index(name) for name in sure.names]
    jacobian = parameter_jacobian(geometry, test.joints[0])[:, columns]
    np.testing.assert_allclose(
        sure.pose_covariance(found.calibration.model, test.joints[0]),
        jacobian @ sure.covariance @ jacobian.T,
        atol=1e-18,
    )
