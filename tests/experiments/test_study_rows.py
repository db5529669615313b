"""Rows of a study: what an arm's figures are, and what they do not depend on."""

from dataclasses import replace

import numpy as np
import pytest

from pickenv.arm import TOLERANCES, forward, it_tolerance, load_plant, plant_at, pose_error
from pickenv.base import InputError
from pickenv.experiments import Noise, load_study, prepared_study
from pickenv.experiments.study import (
    FIGURES,
    NOT_FINITE,
    OK,
    carrying,
    evaluate_arm,
    evaluate_chunk,
    figures,
    outcomes_of,
    reach_status,
)
from pickenv.experiments.study_rows import held


def rows(config):
    """All rows of a study, as columns."""
    protocol = prepared_study(config)
    tables = [evaluate_chunk(protocol, chunk).arrow() for chunk in config.chunks()]
    return {name: np.concatenate([table[name].to_numpy() for table in tables]) for name in tables[0].column_names}


@pytest.fixture
def config(study_file):
    return load_study(study_file())


def test_there_is_a_row_for_every_arm_and_setting(config):
    config = replace(config, arms=4, chunk=3)
    found = rows(config)
    settings = config.settings()
    assert len(found["arm"]) == config.arms * len(settings)
    np.testing.assert_array_equal(found["arm"], np.repeat(np.arange(config.arms), len(settings)))
    np.testing.assert_array_equal(found["setting"], np.tile(np.arange(len(settings)), config.arms))
    assert set(found["status"]) == {OK}
    for setting in settings:
        here = found["setting"] == setting.number
        assert set(found["it_grade"][here]) == {setting.it_grade} and set(found["method"][here]) == {setting.method}
        assert set(found["payload_kg"][here]) == {setting.payload_kg} and set(found["poses"][here]) == {setting.poses}


def test_a_row_is_what_the_arm_does_at_the_fruit(config):
    config = replace(config, methods=("raw",))
    protocol = prepared_study(config)
    found = rows(config)
    for setting in protocol.settings:
        plants = protocol.draw(setting, range(config.arms))
        for arm in (0, 7):
            fruit = protocol.circumstances(arm).fruit
            tool = carrying(plant_at(plants, arm), setting.payload_kg).tool_pose(fruit)
            error = pose_error(forward(protocol.nominal, fruit), tool)
            position = 1e3 * np.linalg.norm(error[:, :3], axis=1)
            row = (found["arm"] == arm) & (found["setting"] == setting.number)
            expected = (
                position.mean(),
                np.sqrt(np.mean(position**2)),
                np.median(position),
                np.quantile(position, 0.95),
                position.max(),
                np.degrees(np.linalg.norm(error[:, 3:], axis=1)).mean(),
            )
            np.testing.assert_allclose([found[name][row][0] for name in FIGURES], expected, rtol=1e-12)
            assert found["share_within"][row][0] == np.mean(position <= config.radius_mm)


def test_the_tool_is_upright_at_the_fruit_and_joints_keep_off_their_limits(config):
    protocol = prepared_study(replace(config, fruit=200))
    nominal, fruit = protocol.nominal, protocol.circumstances(3).fruit
    assert fruit.shape == (200, 6)
    assert np.all(forward(nominal, fruit).rotation[:, 2, 2] >= np.cos(np.radians(30.0)))
    share = (fruit - nominal.lower) / (nominal.upper - nominal.lower)
    assert share.min() >= 0.05 and share.max() <= 0.95


def test_no_two_arms_share_fruit_poses_or_tracker(config):
    """Neither among arms, nor one thing with another: streams of their own."""
    protocol = prepared_study(config)
    for of in (lambda one: one.fruit, lambda one: one.poses, lambda one: one.tracker.reading):
        values = np.stack([of(protocol.circumstances(arm)) for arm in range(6)])
        assert len(np.unique(values)) == values.size
    assert protocol.circumstances(0).poses.shape == (max(config.poses), 6)
    again, other = prepared_study(config), prepared_study(replace(config, seed=config.seed + 1))
    np.testing.assert_array_equal(protocol.circumstances(5).fruit, again.circumstances(5).fruit)
    assert not np.array_equal(protocol.circumstances(5).poses, other.circumstances(5).poses)


def test_the_fruit_of_many_arms_spread_as_upright_joints_do(config):
    """Against rejection sampling of its own: the same mean and spread in every joint."""
    protocol = prepared_study(replace(config, fruit=50))
    found = np.concatenate([protocol.circumstances(arm).fruit for arm in range(100)])
    lower, upper = protocol.nominal.lower, protocol.nominal.upper
    inner = lower + 0.05 * (upper - lower), upper - 0.05 * (upper - lower)
    drawn = np.random.default_rng(0).uniform(*inner, (20_000, 6))
    upright = drawn[forward(protocol.nominal, drawn).rotation[:, 2, 2] >= np.cos(np.radians(30.0))]
    error = upright.std(axis=0) * np.sqrt(1 / len(found) + 1 / len(upright))
    assert np.all(np.abs(found.mean(axis=0) - upright.mean(axis=0)) < 4.5 * error)
    np.testing.assert_allclose(found.std(axis=0), upright.std(axis=0), rtol=0.05)


@pytest.mark.parametrize("poses", [8, 15, 30])
def test_every_first_part_of_an_arms_poses_is_spread_over_the_joint_ranges(config, poses):
    """Each half of each joint's range holds about half of them: a scrambled Halton sequence cannot clump."""
    protocol = prepared_study(replace(config, poses=(30,)))
    middle = 0.5 * (protocol.nominal.lower + protocol.nominal.upper)
    for arm in range(5):
        lower = np.sum(protocol.circumstances(arm).poses[:poses] < middle, axis=0)
        assert np.all(np.abs(lower - poses / 2) <= 0.5 + 3.0 * np.log2(poses) / 2)
        assert abs(lower[0] - poses / 2) <= 0.5  # base two


def test_rows_depend_neither_on_chunks_nor_on_the_number_of_arms(config):
    config = replace(config, arms=5, chunk=2, it_grades=(12,), poses=(20,))
    whole = rows(config)
    for other in (replace(config, chunk=5), replace(config, chunk=1), replace(config, arms=3)):
        found = rows(other)
        for name, values in found.items():
            np.testing.assert_array_equal(values, whole[name][: len(values)], err_msg=name)


def test_rows_do_not_depend_on_the_other_settings(config):
    config = replace(config, arms=3, chunk=3)
    whole = rows(config)
    for part in (
        replace(config, it_grades=(14,)),
        replace(config, methods=("ls",)),
        replace(config, payload_kg=(0.5,)),
    ):
        found = rows(part)
        for number, setting in enumerate(part.settings()):
            (same,) = [s.number for s in config.settings() if replace(s, number=0) == replace(setting, number=0)]
            for name in (*FIGURES, "delta_a2_mm", "iterations"):
                np.testing.assert_array_equal(
                    found[name][found["setting"] == number], whole[name][whole["setting"] == same]
                )


def test_an_arm_deviates_in_the_same_direction_in_every_grade(config):
    found = rows(replace(config, methods=("raw",), payload_kg=(0.0,)))
    fine, coarse = (found["it_grade"] == grade for grade in (8, 14))
    for name in ("delta_a2_mm", "delta_d4_mm"):
        ratio = it_tolerance(14, 0.1) / it_tolerance(8, 0.1)
        np.testing.assert_allclose(found[name][coarse], ratio * found[name][fine], rtol=1e-9)
    np.testing.assert_array_equal(found["delta_alpha1_deg"][coarse], found["delta_alpha1_deg"][fine])
    np.testing.assert_array_equal(found["size_joint_stiffness_1"][coarse], found["size_joint_stiffness_1"][fine])
    np.testing.assert_array_equal(found["sine_transmission_error_2"][coarse], found["sine_transmission_error_2"][fine])


def test_deviations_are_those_of_the_drawn_arms(config):
    config = replace(config, methods=("raw",))
    found = rows(config)
    protocol = prepared_study(config)
    setting = protocol.settings[0]
    plants = protocol.draw(setting, range(config.arms))
    here = found["setting"] == setting.number
    design = load_plant("qiao2026")
    names = design.arm.nominal.parameter_names
    for name in names[: 4 * 6]:
        kind, joint = name.rstrip("0123456789"), names.index(name) % 6
        angle = kind in ("alpha", "theta")
        delta = getattr(plants.geometry, kind)[:, joint] - getattr(design.arm.nominal, kind)[joint]
        column = found[f"delta_{name}_{'deg' if angle else 'mm'}"][here]
        np.testing.assert_allclose(column, np.degrees(delta) if angle else 1e3 * delta, rtol=1e-12)
    stiffness = design.effect("joint_compliance").stiffness
    np.testing.assert_allclose(
        found["size_joint_stiffness_4"][here] * stiffness[3], plants.effect("joint_compliance").stiffness[3]
    )
    term, own = plants.effect("transmission_error").harmonics[2], design.effect("transmission_error").harmonics[2]
    wave = term.amplitude / own.amplitude * np.exp(1j * term.phase)
    np.testing.assert_allclose(found["cosine_transmission_error_3"][here], wave.real, rtol=1e-12)
    np.testing.assert_allclose(found["sine_transmission_error_3"][here], wave.imag, rtol=1e-12)
    assert "size_lead_1" not in found and "size_lead_2" in found  # the design's first joint has no lead error
    for name, values in found.items():
        if name.startswith(("delta", "size", "sine", "cosine")):
            assert np.ptp(values) > 0, name


def test_every_effect_of_the_orchard_plant_has_its_columns(study_file):
    config = load_study(study_file(('"qiao2026"', '"orchard"'), ('"raw", "ls"', '"raw"'), ("arms = 12", "arms = 3")))
    found = rows(config)
    for name in (
        "size_backlash_1",
        "size_friction_forward_1",
        "size_roller_clearance",
        "size_ground_stiffness_2",
        "rise_K",
    ):
        assert np.ptp(found[name]) > 0, name


def test_calibration_helps_more_poses_help_more_and_a_payload_costs_accuracy(study_file):
    config = load_study(study_file(("[12, 20]", "[10, 60]"), ("arms = 12", "arms = 15"), ("fruit = 8", "fruit = 40")))
    found = rows(replace(config, it_grades=(12,)))

    def mean(method, poses, payload):
        here = (found["method"] == method) & (found["poses"] == poses) & (found["payload_kg"] == payload)
        return found["error_mean_mm"][here].mean()

    assert mean("ls", 60, 0.0) < mean("ls", 10, 0.0) < mean("raw", 0, 0.0)
    assert mean("ls", 60, 0.0) < mean("ls", 60, 0.5)


def test_without_dynamic_errors_and_noise_calibration_leaves_nothing(study_file):
    config = load_study(study_file(('"qiao2026"', '"geometry_only"'), ("[0.0, 0.5]", "[0.0]"), ("[12, 20]", "[20]")))
    found = rows(replace(config, noise=(Noise(0.0, 0.0),)))
    calibrated = found["method"] == "ls"
    assert found["error_max_mm"][calibrated].max() < 1e-3 < found["error_mean_mm"][~calibrated].min()


def test_noise_is_the_same_draw_in_every_setting(study_file):
    """Ten times the noise moves the identified arm ten times as far, to first order: nothing else differs."""
    config = load_study(study_file(('"qiao2026"', '"geometry_only"'), ("[0.0, 0.5]", "[0.0]"), ("[12, 20]", "[20]")))
    found = rows(replace(config, methods=("ls",), noise=(Noise(0.01, 0.01), Noise(0.1, 0.1))))
    small, large = (found["error_mean_mm"][found["noise_mm"] == noise] for noise in (0.01, 0.1))
    np.testing.assert_allclose(large / small, 10.0, rtol=0.05)


@pytest.mark.parametrize("kind", ["rbf", pytest.param("gp", marks=pytest.mark.slow)])
def test_a_learnt_residual_is_a_method_too(study_file, kind):
    config = load_study(
        study_file(
            ("[8, 14]", "[12]"), ("[12, 20]", "[20]"), ('"raw", "ls"', f'"ls", "ls+{kind}"'), ("[0.0, 0.5]", "[0.0]")
        )
    )
    found = rows(replace(config, arms=4, residual_poses=150))
    plain, learnt = (found["error_mean_mm"][found["method"] == method] for method in ("ls", f"ls+{kind}"))
    assert np.all(found["status"] == OK) and learnt.mean() < 0.8 * plain.mean()


@pytest.mark.parametrize(("degrees", "reason"), [(2.0, "out of this arm's reach"), (90.0, "did not converge")])
def test_an_arm_that_cannot_reach_or_be_calibrated_is_a_row_with_its_reason(study_file, tmp_path, degrees, reason):
    path = tmp_path / "crooked.toml"
    text = (TOLERANCES / "medium.toml").read_text(encoding="utf-8")
    path.write_text(text.replace("half_width_deg = 0.03", f"half_width_deg = {degrees}"), encoding="utf-8")
    config = load_study(study_file(('"medium"', f'"{path}"'), ("[8, 14]", "[12]"), ("[12, 20]", "[20]")))
    found = rows(config)
    assert len(found["arm"]) == config.arms * len(config.settings())
    raw, judged = found["method"] == "raw", found["status"] == OK
    assert judged[raw].all() and not judged[~raw].all()
    assert any(reason in status for status in found["status"][~judged])
    for name in (*FIGURES, "share_within"):
        np.testing.assert_array_equal(np.isfinite(found[name]), judged, err_msg=name)
    assert all(np.isfinite(values).all() for name, values in found.items() if name.startswith(("delta", "size")))


def test_too_few_poses_are_refused_before_anything_is_computed(study_file):
    with pytest.raises(InputError, match=r"2 poses give 12 equations, too few"):
        prepared_study(load_study(study_file(("[12, 20]", "[2, 20]"))))


def test_the_design_itself_can_be_judged_by_the_same_protocol(config):
    """The paper's arm, Table 1, against its population: its own geometry, the settings' calibration and fruit."""
    protocol = prepared_study(config)
    outcomes = evaluate_arm(protocol, protocol.settings, protocol.design, protocol.circumstances(config.arms))
    assert [outcome["setting"].tolist() for outcome in outcomes] == [[setting.number] for setting in protocol.settings]
    raw, calibrated = outcomes[0]["position"].mean(), outcomes[4]["position"].mean()
    assert outcomes[4]["method"].tolist() == ["ls"] and calibrated < raw < 5e-3


def test_the_figures_are_those_of_a_hundred_and_one_fruit_known_by_heart():
    millimetres = np.random.default_rng(0).permutation(np.arange(101.0))
    found = figures(millimetres[None] * 1e-3, np.radians(millimetres[None] / 100), radius_mm=75.0)
    assert {name: float(values[0]) for name, values in found.items()} == pytest.approx(
        {
            "error_mean_mm": 50.0,
            "error_rms_mm": np.sqrt(3350.0),
            "error_p50_mm": 50.0,
            "error_p95_mm": 95.0,
            "error_max_mm": 100.0,
            "attitude_mean_deg": 0.5,
            "share_within": 76 / 101,
        }
    )


def test_an_arm_without_a_finite_pose_is_not_judged_and_an_earlier_reason_stays(config):
    protocol = prepared_study(replace(config, arms=3, chunk=3))
    setting = protocol.settings[0]
    position = np.full((3, config.fruit), 5e-4)
    position[1:, 0] = np.nan
    outcomes = outcomes_of(setting, (OK, OK, "lost"), (4, 4, 4), position, np.zeros_like(position))
    table = evaluate_chunk(replace(protocol, settings=(setting,)), 0, judge=lambda *batch: [outcomes]).arrow()
    assert table["status"].to_pylist() == [OK, NOT_FINITE, "lost"]
    np.testing.assert_allclose(table["error_mean_mm"].to_numpy(), [0.5, np.nan, np.nan])
    np.testing.assert_allclose(table["share_within"].to_numpy(), [1.0, np.nan, np.nan])


def test_an_arm_may_miss_as_many_fruit_as_the_required_share_leaves(config):
    assert (config.fruit, config.share) == (8, 0.75)
    assert reach_status(2, config) == OK
    assert reach_status(3, config).startswith("3 of 8 fruit are out of this arm's reach")


TRACKERS = ", ".join(f"{{ position_mm = 0.015, attitude_deg = {deg} }}" for deg in (0.01, 0.02, 0.03))


@pytest.mark.parametrize(
    ("changes", "middle"),
    [
        # Cobots and coarse arms share a grade, so that the middle grade is not that of the middle class.
        ([('"medium"', '"cobot", "medium", "coarse"'), ("it_grades = [8, 14]\n", "")], ("medium", 12, 12, 0.012)),
        ([("poses = [12, 20]", "poses = [60, 15, 30]")], ("medium", 8, 30, 0.012)),
        ([("{ position_mm = 0.015, attitude_deg = 0.012 }", TRACKERS)], ("medium", 8, 12, 0.02)),
    ],
)
def test_one_setting_of_each_method_has_the_middle_values(study_file, changes, middle):
    settings = [setting.columns() for setting in load_study(study_file(*changes)).settings()]
    raw, ls = held(settings, ("method",))
    assert (raw["method"], ls["method"]) == ("raw", "ls")
    assert tuple(ls[name] for name in ("tolerances", "it_grade", "poses", "noise_deg")) == middle
    assert tuple(raw[name] for name in ("tolerances", "it_grade")) == middle[:2]


def test_lines_along_the_trackers_noise_have_one_setting_at_each_noise(study_file):
    trackers = TRACKERS + ", { position_mm = 0.1, attitude_deg = 0.05 }"
    config = load_study(study_file(("{ position_mm = 0.015, attitude_deg = 0.012 }", trackers)))
    shown = held([setting.columns() for setting in config.settings()], ("method", "noise_mm"))
    calibrated = [(row["noise_mm"], row["noise_deg"]) for row in shown if row["method"] == "ls"]
    assert calibrated == [(0.015, 0.02), (0.1, 0.05)]
