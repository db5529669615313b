"""Beside a learnt residual, what is promised of a pose is what the corrected arm does: printed alike, kept, watched."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pickenv.arm import Plant, draw_plants, load_tolerances, plant_at
from pickenv.calibration import (
    Calibration,
    Choices,
    Measurements,
    Result,
    Targets,
    apply_calibration,
    calibrate,
    export,
    random_joints,
    simulated_tracker,
    twin,
    uncertainty_from,
    verify,
)
from pickenv.calibration.pipeline.calibration import WITHOUT_RESIDUAL

ARMS, JOINT = 4, 2
LEARNT = Choices(terms="none", residual="rbf", force=True)


def sizes(errors: np.ndarray) -> np.ndarray:
    return np.linalg.norm(errors[:, :3], axis=1)


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


@pytest.fixture(scope="module")
def arms(dynamic: Plant) -> list[tuple[Result, Measurements]]:
    """Calibrations of drawn arms with a learnt residual, each with rows that took no part."""
    plants, results = draw_plants(dynamic, load_tolerances("medium"), ARMS, np.random.default_rng(7)), []
    for i in range(ARMS):
        rng = np.random.default_rng(i)
        rows = simulated_tracker(plant_at(plants, i), random_joints(dynamic.arm.nominal, 400, rng), rng)
        train, test, fresh = (rows.select(np.arange(*ends)) for ends in ((0, 150), (150, 250), (250, 400)))
        results.append((calibrate(dynamic.arm, train, test=test, choices=LEARNT), fresh))
    return results


def test_new_errors_are_as_large_as_was_promised_and_95_of_100_within_their_bound(arms) -> None:
    ratios, inside = [], []
    for result, fresh in arms:
        found = result.calibration
        assert found.learnt is not None
        errors = sizes(found.errors(fresh))
        (position, _), (bound, _) = found.uncertainty(fresh.joints)
        assert rms(errors) < 0.6 * rms(sizes(found.without_residual().errors(fresh)))  # else it would show nothing
        ratios.append(rms(errors) / rms(position))
        inside.append(errors <= bound)
    assert 0.8 < np.mean(ratios) < 1.25
    assert 0.92 < np.mean(inside) < 0.98


def test_verify_finds_a_zero_that_drifted_by_a_millimetre_and_nothing_else(arms) -> None:
    for result, fresh in arms:
        found = result.calibration
        before = verify(found, fresh)
        assert before.status == "still good" and 0.6 < before.ratio < 1.5
        command = fresh.joints - 1e-3 * (np.arange(found.nominal.joints) == JOINT)
        assert found.nominal.prismatic[JOINT]
        assert verify(found, replace(fresh, joints=command)).status == "drifted"


def test_apply_says_a_standard_uncertainty_and_a_bound_that_agree(arms, dynamic: Plant) -> None:
    """The bound on 95 of 100 errors is larger than their root mean square; verify and page say the same."""
    result, fresh = arms[0]
    found = result.calibration
    targets = Targets(fresh.joints[:40], None, tuple(range(2, 42)), "targets")
    commands = apply_calibration(found, dynamic.arm, targets)
    sure, within = commands.uncertainty[0], commands.within95[0]
    assert sure is not None and within is not None
    assert ((1.1 * sure < within) & (within < 2.8 * sure)).all()
    again = replace(fresh, joints=commands.joints, position=fresh.position[:40], rotation=None)
    assert verify(found, again).expected == pytest.approx(1e3 * rms(sure))
    there = found.uncertainty(result.test.joints)[1][0]
    assert there is not None
    page = result.as_dict()["within95_by_pose"]["position"]
    assert page == pytest.approx((1e3 * np.percentile(there, [5, 50, 95])).tolist())
    np.testing.assert_array_equal(found.compensator().within95(commands.joints)[0], within)  # type: ignore[misc]


def test_where_nothing_was_measured_the_uncertainty_is_that_without_the_residual(arms) -> None:
    found = arms[0][0].calibration
    q = arms[0][1].joints[:3].copy()
    q[1:, 1] += [0.0, 5.0]  # metres beyond its rail
    with_residual, without = found.uncertainty(q), found.without_residual().uncertainty(q)
    for mine, theirs in zip((*with_residual[0], *with_residual[1]), (*without[0], *without[1]), strict=True):
        assert mine is not None and theirs is not None
        assert mine[2] == theirs[2] and (mine[:2] < 0.7 * theirs[:2]).all()


def test_both_uncertainties_survive_the_file_and_older_files_have_one(arms, tmp_path: Path) -> None:
    result, fresh = arms[0]
    found = result.calibration
    again = Calibration.load(found.save(tmp_path / "a"))
    for name in ("uncertainty", WITHOUT_RESIDUAL):
        kept, mine = uncertainty_from(again.record, name), uncertainty_from(found.record, name)
        assert kept is not None and mine is not None
        np.testing.assert_array_equal(kept.covariance, mine.covariance)
    bare = found.compensator(with_residual=False).within95
    assert bare is not None
    errors = sizes(found.without_residual().errors(fresh))
    assert 0.88 < np.mean(errors <= bare(fresh.joints)[0]) <= 1.0
    record = {key: value for key, value in found.record.items() if key != WITHOUT_RESIDUAL}
    record["uncertainty"] = found.record[WITHOUT_RESIDUAL]
    old = Calibration.load(replace(found, record=record).save(tmp_path / "old"))
    np.testing.assert_array_equal(
        old.uncertainty(fresh.joints)[0][0], found.without_residual().uncertainty(fresh.joints)[0][0]
    )


def test_few_held_out_errors_tell_less_of_their_size(arms) -> None:
    """The standard error of their mean square is added to it, for positions and attitudes."""
    result, _ = arms[0]
    sure = uncertainty_from(result.calibration.record)
    assert sure is not None
    halves = np.split(list(result.errors.values())[-1], 2, axis=1)
    for errors, variance in zip(halves, np.split(sure.scatter, 2), strict=True):
        squares = np.mean(errors**2, axis=1)
        np.testing.assert_allclose(variance, squares.mean() + squares.std() / np.sqrt(len(squares)))


def test_exports_write_the_parameters_own_uncertainty_which_a_residual_does_not_change(arms, tmp_path: Path) -> None:
    """A table of parameters has no residual. Poses beside one are known better than its parameters say."""
    result, fresh = arms[0]
    found, calibration = result.fit.identification, result.calibration
    export(calibration, tmp_path / "table.json", kind="table")
    rows = json.loads((tmp_path / "table.json").read_text(encoding="utf-8"))["rows"]
    written = {row["standard_deviation"] for row in rows}
    names = dict(zip(found.identifiability.kept_names, np.sqrt(np.diag(found.covariance)), strict=True))
    assert {round(names["a2"] * 1e3, 9), round(np.degrees(names["theta3"]), 9)} <= {round(x, 9) for x in written if x}
    poses, bare = (uncertainty_from(calibration.record, name) for name in ("uncertainty", WITHOUT_RESIDUAL))
    assert poses is not None and bare is not None
    mine, theirs = (sure.from_parameters(calibration.model, fresh.joints) for sure in (poses, bare))
    assert (mine < 0.5 * theirs).all()


@pytest.mark.slow
def test_arms_of_the_twin_err_about_the_corrected_arm_as_the_measured_one_does(dynamic: Plant) -> None:
    rng = np.random.default_rng(0)
    rows = simulated_tracker(dynamic, random_joints(dynamic.arm.nominal, 300, rng), rng)
    train, test, fresh = (rows.select(np.arange(*ends)) for ends in ((0, 100), (100, 200), (200, 300)))
    found = calibrate(dynamic.arm, train, test=test, choices=replace(LEARNT, residual="gp")).calibration
    arms = draw_plants(twin(found, dynamic.arm), load_tolerances("medium"), 8, np.random.default_rng(0))
    predicted = found.predict(fresh.joints).position
    missed = np.array([plant_at(arms, i).tool_pose(fresh.joints).position - predicted for i in range(8)])
    measured = rms(sizes(found.errors(fresh)))
    assert 0.5 * measured < rms(np.linalg.norm(missed, axis=-1)) < 1.5 * measured
