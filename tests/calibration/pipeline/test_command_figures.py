"""The figures of corrected commands, of their uncertainty and of a calibration's result, recomputed from raw arrays."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

from pickenv.arm import load_arm, load_plant, parameter_jacobian
from pickenv.calibration import (
    GEOMETRIC,
    NOMINAL,
    Calibration,
    Choices,
    GateVerdict,
    Measurements,
    assess,
    calibrate,
    fit,
    random_joints,
    simulated_tracker,
    uncertainty_from,
)
from pickenv.calibration.assessment.screen import figure, within95
from pickenv.calibration.pipeline.apply import CorrectedCommands
from pickenv.calibration.pipeline.calibration import PoseUncertainty
from pickenv.wrappers import CompensationWrapper

PRISMATIC = (False, True)


def commands(reached, **more):
    """Four commands of a turning and a sliding joint, with errors of every size."""
    rng = np.random.default_rng(0)
    before, remaining, impossible = (size * rng.normal(size=(4, 6)) for size in (1e-3, 1e-4, 1e-5))
    values = {
        "targets": rng.normal(size=(4, 2)),
        "joints": rng.normal(size=(4, 2)),
        "reached": np.array(reached),
        "before": before,
        "remaining": remaining,
        "impossible": impossible,
        "uncertainty": (np.array([1e-4, 2e-4, 4e-4, 9e-4]), np.array([1e-3, 2e-3, 4e-3, 9e-3])),
        "within95": (np.array([2e-4, 4e-4, 8e-4, 18e-4]), np.array([2e-3, 4e-3, 8e-3, 18e-3])),
        "reasons": {},
        "lines": (2, 3, 5, 8),
        "prismatic": PRISMATIC,
    }
    return CorrectedCommands(**(values | more))


@pytest.mark.parametrize(
    ("reached", "counted"),
    [([True, False, True, False], [0, 2]), ([True] * 4, [0, 1, 2, 3])],
    ids=["some", "all"],
)
def test_means_are_those_of_the_targets_that_can_be_reached(reached, counted):
    found = commands(reached)
    mm = [1e3 * np.mean(np.linalg.norm(e[counted, :3], axis=1)) for e in (found.before, found.remaining)]
    deg = [
        np.degrees(np.mean(np.linalg.norm(e[counted, 3:], axis=1)))
        for e in (found.before, found.remaining, found.impossible)
    ]
    text = found.report()
    assert text.startswith(f"{sum(reached)} of 4 targets can be reached\n")
    assert f"would miss by {mm[0]:.3f} mm and {deg[0]:.4f} deg" in text
    assert f"commands {mm[1]:.4f} mm and {deg[1]:.4f} deg remain, of which {deg[2]:.4f} deg is a rotation" in text
    sure = 1e3 * found.uncertainty[0][counted]
    assert f"position reached: {np.median(sure):.3f} mm (median), {sure.max():.3f} mm at most" in text


def test_where_no_target_is_reached_nothing_is_promised_of_commands():
    found = commands([False] * 4, reasons={0: "too far"}, caution="few rows")
    assert found.report() == "0 of 4 targets can be reached\n  caution: few rows\n  row 2: too far"


def test_the_table_holds_each_number_in_its_unit_and_no_command_where_none_should_be_driven():
    found = commands([True, False, True, True], reasons={1: "too far"})
    names, rows = found.table()
    column = {name: rows[:, i] for i, name in enumerate(names)}
    assert names[:3] == ["q1_deg", "q2_mm", "reached"]
    np.testing.assert_allclose(column["q1_deg"][[0, 2, 3]].astype(float), np.degrees(found.joints[[0, 2, 3], 0]))
    np.testing.assert_allclose(column["q2_mm"][[0, 2, 3]].astype(float), 1e3 * found.joints[[0, 2, 3], 1])
    assert list(rows[1, :2]) == ["", ""] and column["reached"].tolist() == ["yes", "no", "yes", "yes"]
    for label, error in (
        ("uncorrected", found.before),
        ("predicted", found.remaining),
        ("noncompensable", found.impossible),
    ):
        size = np.sqrt(np.sum(error.reshape(4, 2, 3) ** 2, axis=2))
        np.testing.assert_allclose(column[f"{label}_error_mm"].astype(float), 1e3 * size[:, 0])
        np.testing.assert_allclose(column[f"{label}_error_deg"].astype(float), np.degrees(size[:, 1]))
    np.testing.assert_allclose(column["uncertainty_mm"].astype(float), 1e3 * found.uncertainty[0])
    np.testing.assert_allclose(column["uncertainty_deg"].astype(float), np.degrees(found.uncertainty[1]))
    np.testing.assert_allclose(column["within95_mm"].astype(float), [0.2, 0.4, 0.8, 1.8])
    np.testing.assert_allclose(column["within95_deg"].astype(float), np.degrees([2e-3, 4e-3, 8e-3, 18e-3]))
    assert column["note"].tolist() == ["", "too far", "", ""]
    assert "row 3: too far" in found.report()
    assert "95 of 100 such commands end within 0.800 mm (median of targets; 1.800 mm at most)" in found.report()
    bare = commands([True] * 4, uncertainty=(found.uncertainty[0], None))
    assert "uncertainty_deg" not in bare.table()[0] and "uncertainty_mm" in bare.table()[0]


@pytest.fixture(scope="module")
def sets(dynamic):
    rng = np.random.default_rng(4)
    return [simulated_tracker(dynamic, random_joints(dynamic.arm.nominal, n, rng), rng) for n in (60, 30)]


@pytest.fixture(scope="module", params=["poses", "positions"])
def judged(request, dynamic, sets):
    train, test = sets if request.param == "poses" else [part.positions_only() for part in sets]
    verdict = GateVerdict("gp", 2e-4, 4e-4, None, None, 5e-5, 6e-5, True, "cuts")
    return replace(assess(dynamic.arm, fit(dynamic.arm, train, known_frames=True), train, test), gate=(verdict,))


def test_a_results_figures_are_those_of_its_errors(judged, sets):
    """Rows of the table on the screen and numbers of the JSON, per model."""
    train, test = judged.train, judged.test
    errors = {NOMINAL: test.difference(judged.arm.nominal), GEOMETRIC: test.difference(judged.fit.calibration.model)}
    told = judged.as_dict()["held_out"]
    block = next(block for block in judged.blocks() if block.title == "Errors on held-out rows")
    assert "30 rows held out, 60 fitted" in block.note and block.note.endswith("; used: geometry")
    for (name, error), cells in zip(errors.items(), block.rows, strict=True):
        size = 1e3 * np.linalg.norm(error[:, :3], axis=1)
        expected = [np.sqrt(np.mean(size**2)), size.mean(), np.percentile(size, 95), size.max()]
        assert [cells[i] for i in (1, 2, 4, 5)] == [figure(value) for value in expected]
        assert told[f"{name}_mm"]["p95"] == pytest.approx(expected[2])
        low, high = judged.position[name].mean_ci95
        assert cells[3] == f"{figure(low)} to {figure(high)}"
        if error.shape[1] == 6:
            turned = np.degrees(np.linalg.norm(error[:, 3:], axis=1))
            assert cells[6] == figure(turned.mean())
            assert told[f"{name}_deg"]["max"] == pytest.approx(turned.max())
        else:
            assert len(cells) == 6 and f"{name}_deg" not in told
    nominal, best = (1e3 * np.linalg.norm(errors[name][:, :3], axis=1) for name in (NOMINAL, GEOMETRIC))
    assert told["nominal_rms_mm"] == pytest.approx(np.sqrt(np.mean(nominal**2)))
    for name in ("geometric", "best"):
        assert told[f"{name}_rms_mm"] == pytest.approx(np.sqrt(np.mean(best**2)))
        assert told[f"{name}_mean_mm"] == pytest.approx(best.mean())
    low, high = told["best_mean_ci95_mm"]
    noise = 3 * (1e3 * test.position_std) ** 2
    own = low * np.sqrt(1 - noise / np.mean(best**2)), high
    assert told["own_mean_ci95_mm"] == pytest.approx(own) and own[0] < low < best.mean() < high
    assert f"is {figure(own[0])} to {figure(own[1])} mm (95 % interval" in judged.frames_text
    assert judged.as_dict()["rows"] == {"train": len(train.joints), "test": len(test.joints)}


def test_an_error_of_noise_alone_may_be_none_of_the_arms(judged):
    drowned = replace(judged, test=replace(judged.test, position_std=1.0))
    assert drowned.own_mean_ci95 == (0.0, judged.best.mean_ci95[1])


def test_a_results_parameters_are_the_change_of_the_geometry_in_mm_and_degrees(judged):
    found, fitted = judged.fit.identification, judged.fit.calibration
    change = dict(zip(found.identifiability.names, found.delta, strict=True))
    std = dict(zip(found.identifiability.kept_names, np.sqrt(np.diag(found.covariance)), strict=True))
    rows = {row["name"]: row for row in judged.parameters()}
    assert set(rows) == set(found.identifiability.kept_names)
    for name, row in rows.items():
        unit, scale = ("deg", 180 / np.pi) if name.startswith(("alpha", "theta")) else ("mm", 1e3)
        assert row["unit"] == unit and row["std"] == pytest.approx(std[name] * scale)
        assert row["change"] == pytest.approx(change[name] * scale, rel=1e-6, abs=1e-9)
    assert fitted.identified is not fitted.nominal
    facts = dict(next(block for block in judged.blocks() if block.title == "Evidence").rows)
    values = found.identifiability.singular_values
    assert facts["condition number of the geometry"] == figure(values[0] / values[-1])
    assert facts["least squares"].startswith(f"{len(found.residual_rms) - 1} iterations, ")
    told = judged.as_dict()
    assert (told["rank"], told["parameters"]) == (len(rows), 24)
    assert told["condition"] == pytest.approx(values[0] / values[-1])


def test_the_gates_table_is_in_mm(judged):
    block = next(block for block in judged.blocks() if block.title == "Learnt residual models")
    assert block.rows == (("without", "0.4000", ""), ("gp", "0.2000", "cuts"))
    assert block.note == "'gp' is used; judged within the training rows"
    off = replace(judged, gate=(replace(judged.gate[0], accepted=False),))
    assert any(block.note.startswith("none is used;") for block in off.blocks())


def test_the_uncertainty_of_a_reach_is_that_of_parameters_and_of_what_they_do_not_say(judged):
    """u^2 = J C J^T + u_repeat^2 for each coordinate; a position's is the root of the sum of three."""
    found, model = judged.fit.identification, judged.fit.calibration.model
    errors = np.random.default_rng(0).normal(size=(50, 6)) * [1e-4, 2e-4, 3e-4, 1e-3, 2e-3, 3e-3]
    sure = PoseUncertainty.of(found, errors)
    assert sure.position_repeat == pytest.approx(np.sqrt(np.mean(errors[:, :3] ** 2)))
    assert sure.attitude_repeat == pytest.approx(np.sqrt(np.mean(errors[:, 3:] ** 2)))
    q = random_joints(judged.arm.nominal, 5, np.random.default_rng(1))
    names = model.geometry.parameter_names
    jacobian = parameter_jacobian(model.geometry, q)[..., [names.index(n) for n in found.identifiability.kept_names]]
    spread = jacobian @ found.covariance @ np.swapaxes(jacobian, 1, 2)
    variance = np.diagonal(spread, axis1=1, axis2=2)
    position, attitude = sure.standard(model, q)
    np.testing.assert_allclose(position, np.sqrt(variance[:, :3].sum(1) + 3 * sure.position_repeat**2))
    np.testing.assert_allclose(attitude, np.sqrt(variance[:, 3:].sum(1) + 3 * sure.attitude_repeat**2))
    flat = PoseUncertainty.of(found, errors[:, :3])
    assert flat.attitude_repeat is None and flat.standard(model, q)[1] is None
    np.testing.assert_allclose(flat.standard(model, q)[0], position)
    np.testing.assert_allclose(flat.pose_covariance(model, q)[:, 3:, 3:], spread[:, 3:, 3:], rtol=1e-9)


def test_how_far_errors_go_is_the_median_with_the_5th_and_95th_of_100_poses(judged):
    sure, model, q = judged.uncertainty, judged.fit.calibration.model, judged.test.joints
    factors = {"position": {"factor": 2.0, "covered": 0.93}, "attitude": {"factor": 3.0, "covered": 0.96}}
    sure = replace(sure, factors=factors)
    block = sure.block(sure.within95(sure.standard(model, q, judged.test.conditions)))
    parts = zip(block.rows, sure.standard(model, q), (2e3, np.degrees(3.0)), ("mm", "deg"), strict=False)
    for (_, said, held), size, scale, unit in parts:
        if size is not None:
            low, middle, high = (figure(np.percentile(scale * size, share)) for share in (5, 50, 95))
            assert said == f"{middle} {unit} ({low} to {high})"
            assert held == ("93.0 %" if unit == "mm" else "96.0 %")
    assert [row[0] for row in block.rows] == ["position", "attitude"][: len(block.rows)]


def test_an_uncertainty_survives_its_record_and_one_that_is_no_number_is_none(judged):
    sure = PoseUncertainty(("a1", "d1"), np.array([[2.0, 0.1], [0.1, 3.0]]), 1e-4, None)
    record = {"uncertainty": sure.as_record()}
    again = uncertainty_from(record)
    np.testing.assert_array_equal(again.covariance, sure.covariance)
    assert (again.names, again.position_repeat, again.attitude_repeat) == (("a1", "d1"), 1e-4, None)
    record["uncertainty"]["covariance"][0][1] = float("nan")
    assert uncertainty_from(record) is uncertainty_from({}) is uncertainty_from({"uncertainty": None}) is None
    kept = judged.calibration.record["uncertainty"]
    held = judged.test.difference(judged.fit.calibration.model)
    assert kept["position_repeat_m"] == pytest.approx(np.sqrt(np.mean(held[:, :3] ** 2)))


def test_an_arm_of_which_nothing_is_learnt_is_corrected_in_single_precision_too(dynamic, sets):
    calibration = fit(dynamic.arm, sets[0], known_frames=True).calibration
    assert calibration.learnt is None
    joints = random_joints(calibration.nominal, 50, np.random.default_rng(5))
    fast, exact = (calibration.compensator(single_precision=single)(joints) for single in (True, False))
    assert 0.0 < np.abs(fast - exact).max() < 1e-5 < np.abs(exact - joints).max()


# What holds 95 of 100 errors: as often as it says, on rows that took no part.
def errors(rng: np.random.Generator, count: int, contrast: float) -> tuple[np.ndarray, np.ndarray]:
    """Joints and squared errors, larger where the first joint is."""
    joints = rng.uniform([-2.0, -2.0, 0.0], [2.0, 2.0, 0.8], (count, 3))
    mean = 1e-8 * np.exp(contrast * np.sin(joints[:, 0]) + contrast * joints[:, 2])
    return joints, np.sum(rng.normal(size=(count, 3)) ** 2, axis=1) / 3 * mean


@pytest.mark.parametrize("contrast", [0.0, 1.5])
def test_95_of_100_new_errors_lie_within(contrast: float) -> None:
    """Over many data sets, of those that took no part."""
    share, said = [], []
    for seed in range(40):
        rng = np.random.default_rng(100 + seed)
        joints, squares = errors(rng, 150, contrast)
        known = within95(joints, squares, np.zeros(150), None)
        assert known is not None
        _, new = errors(rng, 400, contrast)
        share.append(np.mean(np.sqrt(new) <= known["factor"] * np.sqrt(squares.mean())))
        said.append(known["covered"])
    assert 0.945 < np.mean(share) < 0.97  # ranks are rounded up, and the factor is of fits to nine tenths
    assert np.mean(said) == pytest.approx(0.95, abs=0.015)


def test_what_parameters_add_counts() -> None:
    rng = np.random.default_rng(3)
    joints, squares = errors(rng, 40, 0.0)
    plain = within95(joints, squares, np.zeros(40), None)
    wide = within95(joints, squares, np.full(40, 3e-8), None)
    assert plain is not None and wide is not None
    sizes = [np.sqrt(squares[np.arange(40) // 4 != b].mean() + extra) for b in range(10) for extra in (0.0, 3e-8)]
    ratios = [np.sqrt(squares) / np.repeat(sizes[i::2], 4) for i in range(2)]
    for found, ratio in ((plain, ratios[0]), (wide, ratios[1])):
        assert found["factor"] == np.sort(ratio)[int(np.ceil(0.95 * 41)) - 1]
    assert within95(joints[:19], squares[:19], np.zeros(19), None) is None


@pytest.mark.slow
def test_new_reaches_of_an_arm_that_errs_more_where_it_is_stretched_lie_within() -> None:
    """The report, the file and the figures say the same."""
    rng, arm = np.random.default_rng(5), load_arm("ur5")
    geometry = arm.nominal

    def seen(count: int) -> Measurements:
        from pickenv.arm import forward

        joints = random_joints(geometry, count, rng)
        position = forward(geometry, joints).position
        size = 2e-4 * np.exp(1.5 * np.cos(joints[:, 2:3]))
        return Measurements(joints, position + size * rng.normal(size=(count, 3)), None, geometry.prismatic)

    found = calibrate(arm, seen(500), split="blocked", choices=Choices(terms="none", residual="none"))
    known = found.uncertainty.factors["position"]
    assert 0.92 < known["covered"] < 0.98
    new = seen(2000)
    missed = np.linalg.norm(new.difference(found.calibration.model), axis=1)
    radius, _ = found.uncertainty.within95(found.uncertainty.standard(found.calibration.model, new.joints))
    assert radius is not None and np.mean(missed <= radius) == pytest.approx(0.95, abs=0.025)
    assert found.as_dict()["within95"]["position"] == known and f"{100 * known['covered']:.1f} %" in found.report()
    kept = uncertainty_from(found.calibration.record)
    assert kept is not None
    again, _ = kept.within95(kept.standard(found.calibration.model, new.joints))
    np.testing.assert_allclose(again, radius, rtol=1e-3)


@pytest.mark.slow
def test_95_of_100_errors_of_wam_lie_within(data_folder: Path) -> None:
    """In 3-D; blocks held out of fit, size and factor alike. UR5 and UR10 stand with their harmonics."""
    files = sorted(data_folder.glob("ur5_wam_jacobi2025/WAM/*grid*cleaned.csv"))
    if not files:
        pytest.skip(f"no grid of WAM in {data_folder}")
    found = calibrate("wam", files, columns="wam_jacobi2025", split="blocked", choices=Choices(residual="none"))
    assert 0.93 <= found.uncertainty.factors["position"]["covered"] <= 0.97


@pytest.mark.parametrize("older", ["position", "attitude"])
def test_a_factor_for_a_scatter_that_differed_from_pose_to_pose_is_not_taken(older: str) -> None:
    """Taken with one scatter it covered 85 of 100 where it says 95."""
    one = {"factor": 1.6, "covered": 0.95, "rank_correlation": 0.5}
    kept = {"parameters": ["tool_x"], "covariance": [[1e-8]], "position_repeat_m": 1e-4, "attitude_repeat_rad": 1e-4}
    kept |= {"position_within95": one, "attitude_within95": one}
    sure, old = (uncertainty_from({"uncertainty": kept | more}) for more in ({}, {f"{older}_local": {"counts": [1]}}))
    assert sure is not None and old is not None
    taken = {"factor": 1.6, "covered": 0.95}
    assert sure.factors == {"position": taken, "attitude": taken}
    for name in ("position", "attitude"):
        assert old.factors.get(name) == (None if name == older else taken)


def test_an_episode_ends_with_the_radius_of_its_command(tmp_path: Path) -> None:
    """In `info`, as `apply` gives it; and most of the calibrated arm's reaches end within it."""
    plant, rng = load_plant("qiao2026"), np.random.default_rng(6)
    data = simulated_tracker(plant, random_joints(plant.geometry, 200, rng), rng)
    choices = Choices(terms="none", residual="none", frames="known")
    calibration = calibrate(plant.arm, data, split="blocked", choices=choices).calibration
    saved = Calibration.load(calibration.save(tmp_path / "arm"))
    env = CompensationWrapper(gym.make("pickenv/Reach-v0"), saved.compensator())
    inside = []
    for seed in range(40):
        _, info = env.reset(seed=seed)
        assert "within95_mm" not in info
        done = False
        while not done:
            _, _, terminated, truncated, info = env.step(np.zeros(6))
            done = terminated or truncated
        command = np.asarray(info["joint_command"])
        radius, turned = calibration.compensator().within95(command)  # type: ignore[misc]
        assert info["within95_mm"] == pytest.approx(float(radius) * 1e3, rel=1e-3)
        assert info["within95_deg"] == pytest.approx(float(np.degrees(turned)), rel=1e-3)
        missed = saved.model.pose(command).position - plant.tool_pose(command).position
        inside.append(np.linalg.norm(missed) * 1e3 <= info["within95_mm"])
    assert np.mean(inside) > 0.8
