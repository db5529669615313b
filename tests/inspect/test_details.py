"""Effects, attitude and a day are what the plant itself says, by other ways."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pickenv.arm import effect_shares, forward, joint_jacobian, load_plant, noncompensable_error
from pickenv.inspect import Comparison, RecordedPolicy, record_comparison
from pickenv.inspect.colours import GREY, STEEL, as_sentence, in_words, policy_colours, viridis
from pickenv.inspect.recordings import details as details_module
from pickenv.inspect.recordings.details import (
    CAMERA_STD,
    FLOOR,
    arrow_tabs,
    attitude_fields,
    day_hours,
    day_in_words,
    day_of,
    drifting_plant,
    effect_fields,
    joints_at,
)
from pickenv.inspect.runs.comparison_summary import cell_means
from pickenv.inspect.runs.run_folder import cut_away

COLORMAP = 6
"""Rerun's number of Viridis."""


def removed_field(comparison: Comparison) -> np.ndarray:
    """What the last policy removes of the error that the one before it leaves, as it is drawn at true size."""
    return next(iter(arrow_tabs(comparison).values()))[2]["world/field/removed/vectors"][2] / 1e3


def orchard(comparison: Comparison) -> Comparison:
    return replace(comparison, plant=load_plant("orchard"))


@pytest.fixture(scope="module")
def day(comparison: Comparison) -> dict[str, Any]:
    """The day of the orchard's arm, which no test changes."""
    return dict(day_of(orchard(comparison)))


@pytest.fixture(scope="module")
def firm_day(comparison: Comparison) -> dict[str, Any]:
    """The day of an arm that does not drift, which no test changes."""
    return dict(day_of(firm(comparison)))


def test_effects_agree_with_the_table_of_effects(comparison: Comparison) -> None:
    """`pickenv effects` moves the arm through time; where nothing has a memory both must give the same shares."""
    fields = effect_fields(comparison)
    shares = effect_shares(comparison.plant, comparison.grid.joints)["alone"]
    assert set(fields) == set(shares)
    for name, field in fields.items():
        assert 1e3 * np.linalg.norm(field, axis=-1).mean() == pytest.approx(shares[name]["mean"], rel=1e-6)


def test_effects_sum_to_the_raw_error_to_first_order(comparison: Comparison) -> None:
    raw = comparison.policies[0].field_errors
    together = np.sum(list(effect_fields(comparison).values()), axis=0)
    np.testing.assert_allclose(together, raw, atol=0.02 * np.abs(raw).max())


def test_effects_without_a_settled_field_are_left_out(comparison: Comparison) -> None:
    fields = effect_fields(orchard(comparison))
    assert {"thermal_growth", "base_tilt", "roller_play"} <= set(fields)
    assert not {"settling", "measurement_noise"} & set(fields)
    nothing = replace(comparison.plant.without(("joint_compliance", "boom_bending", "transmission_error")))
    ideal = replace(comparison, plant=replace(nothing, geometry=comparison.nominal))
    assert effect_fields(ideal) == {}
    assert list(arrow_tabs(ideal)) == ["Error fields, arrows ×20", "Attitude"]


def test_the_floor_is_what_no_joint_motion_moves(comparison: Comparison) -> None:
    fields = attitude_fields(comparison)
    assert list(fields) == ["raw", "ls_bpnn", FLOOR]
    last = comparison.policies[-1]
    error = np.concatenate([last.field_errors, last.field_attitude], axis=-1)
    floor = noncompensable_error(comparison.plant.geometry, comparison.grid.joints, error)
    jacobian = joint_jacobian(comparison.plant.geometry, comparison.grid.joints)
    strongest = np.linalg.norm(jacobian, axis=(-2, -1))
    moved = np.linalg.norm(np.einsum("fij,fi->fj", jacobian, floor), axis=-1)
    assert np.all(moved < 5e-3 * strongest * np.linalg.norm(floor, axis=-1) + 1e-15)
    np.testing.assert_array_equal(fields[FLOOR], floor[:, 3:])


def test_what_is_removed_lies_between_two_policies(comparison: Comparison) -> None:
    removed = removed_field(comparison)
    before, last = comparison.policies[-2:]
    np.testing.assert_array_equal(last.field_errors + removed, before.field_errors)
    alone = arrow_tabs(replace(comparison, policies=comparison.policies[:1]))
    assert list(next(iter(alone.values()))[2]) == ["world/field/raw/vectors"]


def test_a_day_without_drift_repeats_the_reaches(comparison: Comparison, firm_day: dict[str, Any]) -> None:
    still = firm(comparison).plant
    for policy in comparison.policies:
        expected = still.tool_pose(policy.ends.joint_command).position - comparison.fruit
        error = 1e3 * np.linalg.norm(expected, axis=-1)
        np.testing.assert_allclose(firm_day[policy.key][1], np.broadcast_to(error, firm_day[policy.key][1].shape))


def test_a_day_of_drift_ends_where_the_warm_sunk_arm_settles(
    comparison: Comparison, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(details_module, "DAY_HOURS", 2000.0)
    plant = load_plant("orchard").without(("settling", "stick_band", "backlash", "servo"))
    day = day_of(replace(comparison, plant=plant))
    raw = comparison.policies[0]
    settled = 1e3 * np.linalg.norm(plant.tool_pose(raw.ends.joint_command).position - comparison.fruit, axis=-1)
    assert day_hours(comparison)[-1] == 2000.0
    np.testing.assert_allclose(day["raw"][1][-1], settled, rtol=1e-6)
    assert day["raw"][1][0].mean() < day["raw"][1][-1].mean()


def test_joints_at_points_are_near_and_leave_nanometres(comparison: Comparison) -> None:
    for policy in comparison.policies:
        joints = joints_at(comparison.nominal, policy.ends.joint_command, comparison.fruit)
        np.testing.assert_allclose(forward(comparison.nominal, joints).position, comparison.fruit, atol=1e-8)
        assert np.abs(joints - policy.ends.joint_command).max() < 0.05


def firm(comparison: Comparison) -> Comparison:
    """The comparison's own arm, neither warm nor late, on ground that never gives way."""
    ground = replace(load_plant("orchard").effect("base_tilt"), stiffness=(1e15, 1e15), settlement=0.0)
    return replace(comparison, plant=comparison.plant.with_effect(ground))


def test_a_filter_learns_the_arm_that_a_policy_left(comparison: Comparison) -> None:
    raw = replace(firm(comparison), policies=comparison.policies[:1])
    day = day_of(raw)
    unseen = np.isclose(day["adapted"][1][0][:, None], day["raw"][1][0]).any(axis=1)
    assert unseen.all()  # the first pick of the day is the policy's own
    half = len(comparison.fruit) // 2
    assert day["adapted"][1][half:].mean() < 0.5 * day["raw"][1][half:].mean()


def test_where_nothing_drifts_a_filter_costs_less_than_its_cameras_noise(
    comparison: Comparison, firm_day: dict[str, Any]
) -> None:
    last = firm_day[comparison.policies[-1].key][1]
    assert last.mean() < firm_day["adapted"][1].mean() < last.mean() + 0.5 * 1e3 * CAMERA_STD


def test_too_few_reaches_have_no_filter(cut_short: Callable[..., RecordedPolicy], comparison: Comparison) -> None:
    few = tuple(cut_short(policy, 9) for policy in comparison.policies)
    assert day_of(replace(comparison, policies=few)).keys() == {policy.key for policy in few}


def test_the_days_words_hold_its_means(comparison: Comparison, day: dict[str, Any]) -> None:
    labels = {policy.key: policy.label for policy in comparison.policies}
    shown = orchard(comparison)
    words = day_in_words(shown, day)
    for key, label in labels.items():
        assert f"| {label} | {day[key][1].mean():.2f} |" in words
    assert f"| LS + BPNN, adapted | {day['adapted'][1].mean():.2f} |" in words
    raw = day["raw"][1]
    worse = {**day, "ls_bpnn": ("LS + BPNN", raw + 1.0)}
    better = {**day, "ls_bpnn": ("LS + BPNN", raw - 0.25)}
    assert "LS + BPNN ends no better than raw" in day_in_words(shown, worse)
    assert "LS + BPNN ends 0.25 mm better than raw" in day_in_words(shown, better)
    assert "ends" not in day_in_words(shown, {"raw": ("raw", raw)})


def test_only_the_same_arm_borrows_the_orchards_drift(comparison: Comparison) -> None:
    borrowed = drifting_plant(comparison.plant)
    assert borrowed.name == "orchard"
    assert borrowed.effect("joint_compliance") is comparison.plant.effect("joint_compliance")
    assert borrowed.effect("backlash") is None
    moved = replace(comparison.nominal, a=comparison.nominal.a + 0.1)
    assert drifting_plant(replace(comparison.plant, arm=replace(comparison.plant.arm, nominal=moved))) is None


def test_cells_hold_the_mean_of_their_points() -> None:
    index = np.array([[1, 0, 0], [0, 2, 1], [1, 0, 0], [0, 0, 3]])
    cells, means = cell_means(index, np.array([1.0, 5.0, 4.0, 7.0]))
    assert cells.tolist() == [[0, 0, 3], [0, 2, 1], [1, 0, 0]]
    assert means.tolist() == [7.0, 5.0, 2.5]


@pytest.fixture(scope="module")
def orchard_reading(
    comparison: Comparison, reader: Callable[[Path], Any], tmp_path_factory: pytest.TempPathFactory
) -> Any:
    return reader(record_comparison(orchard(comparison), tmp_path_factory.mktemp("orchard") / "errors.rrd"))


@pytest.fixture
def without_day(comparison: Comparison) -> Comparison:
    """Of an arm of which no drift is known, so that there is no day to work out."""
    other = replace(comparison.plant.arm.nominal, a=comparison.plant.arm.nominal.a + 1e-6)
    return replace(comparison, plant=replace(comparison.plant, arm=replace(comparison.plant.arm, nominal=other)))


def test_every_detail_is_read_back(orchard_reading: Any, comparison: Comparison, day: dict[str, Any]) -> None:
    shown = orchard(comparison)
    effects, attitude = effect_fields(shown), attitude_fields(shown)
    assert len(effects) > 5
    assert orchard_reading.unmatched_rules() == []
    fields = {f"effect/{name}": field for name, field in effects.items()}
    raw, last = (1e3 * np.linalg.norm(comparison.policies[i].field_errors, axis=1) for i in (0, -1))
    top = np.percentile(raw, 99)
    for name, field in {**fields, "field/removed/vectors": removed_field(shown)}.items():
        length = 1e3 * np.linalg.norm(field, axis=1)
        orchard_reading.holds(
            f"/world/{name}",
            origins=comparison.grid.points,
            vectors=20.0 * field,
            xyz_mm=1e3 * field,
            norm_mm=length,
            colors=viridis(length / top),
            radii=[-1.6],
        )
    turned = np.degrees(np.linalg.norm(attitude["raw"], axis=1))
    top = np.percentile(turned, 99)
    drawn = next(s for s in (0.01, 0.02, 0.025, 0.05, 0.1, 0.2, 0.25, 0.5, 1, 2, 2.5, 5) if s >= 0.055 / top)
    for key, field in attitude.items():
        degrees = np.degrees(field)
        orchard_reading.holds(
            f"/world/attitude/{key}",
            origins=comparison.grid.points,
            vectors=drawn * degrees,
            xyz_deg=degrees,
            norm_deg=np.linalg.norm(degrees, axis=1),
            colors=viridis(np.linalg.norm(degrees, axis=1) / top),
            radii=[-1.6],
        )
    predicted = 1e3 * comparison.field_uncertainty
    kept, low = ~cut_away(comparison), comparison.grid.origin - 0.5 * comparison.grid.step
    for name, values in (("predicted", predicted), ("actual", last)):
        orchard_reading.holds(
            f"/world/uncertainty/{name}",
            values=values[kept],
            voxel_indices=comparison.grid.index[kept],
            voxel_size=[0.055] * 3,
            translation=low,
            value_range=[0.0, np.percentile(np.concatenate([predicted, last]), 99)],
            colormap=[COLORMAP],
        )
    for key, said in (("attitude", "deg"), ("uncertainty", "mm")):
        assert orchard_reading.values(f"/legend/{key}/ticks", "Points2D:labels")[-1].endswith(f" {said}")
    for (key, (label, errors)), colour in zip(day.items(), policy_colours(list(day)), strict=True):
        assert len(errors) == len(shown.fruit) == 100
        ordered = np.sort(errors, axis=1)
        place = 0.95 * (errors.shape[1] - 1)
        below, above = (ordered[:, int(place) + i] for i in (0, 1))
        for name, values, width in (
            ("mean", errors.sum(axis=1) / errors.shape[1], 2.2),
            ("p95", below + (place % 1.0) * (above - below), 1.0),
        ):
            entity = f"/day/{name}_mm/{key}"
            orchard_reading.holds(
                entity, scalars=values, names=[in_words(f"{label}, {name}")], colors=[colour], widths=[width]
            )
            times = orchard_reading.times(entity, "hours")
            np.testing.assert_allclose(times, 3.6e12 * day_hours(shown), rtol=1e-9)
    orchard_reading.holds("/about_the_day", text=[as_sentence(day_in_words(shown, day))], media_type=["text/markdown"])


def test_two_policies_have_a_difference_and_unknown_attitudes_no_field(without_day: Comparison) -> None:
    before, last = without_day.policies[:2]
    removed = removed_field(replace(without_day, policies=(before, last)))
    np.testing.assert_allclose(removed, before.field_errors - last.field_errors)
    for unknown in ((replace(before, field_attitude=None), last), (before, replace(last, field_attitude=None))):
        assert attitude_fields(replace(without_day, policies=unknown)) == {}


def test_the_exported_arms_stand_where_the_reach_puts_them(reading: Any, comparison: Comparison) -> None:
    """The chain of transforms that the viewer walks, from the root to the tool, at each reach."""
    commands = comparison.policies[0].ends.joint_command
    for name, geometry in (("urdf_nominal", comparison.nominal), ("urdf_true", comparison.plant.geometry)):
        rotation, position = np.broadcast_to(np.eye(3), (len(commands), 3, 3)), np.zeros((len(commands), 3))
        for i in range(geometry.joints):
            step = reading.values(f"/{name}/joint{i + 1}", "Transform3D:translation")
            turn = Rotation.from_quat(reading.values(f"/{name}/joint{i + 1}", "Transform3D:quaternion")).as_matrix()
            position = position + np.einsum("rij,rj->ri", rotation, step)
            rotation = rotation @ turn
            frames = [f"{name}/link{k}" if k else f"{name}/base" for k in (i, i + 1)]
            step_frames = [
                set(reading.values(f"/{name}/joint{i + 1}", f"Transform3D:{which}_frame"))
                for which in ("parent", "child")
            ]
            assert step_frames == [{frame} for frame in frames]
        last = reading.values(f"/{name}/tf_static", "Transform3D:translation")[-1]
        tool = position + np.einsum("rij,j->ri", rotation, last)
        np.testing.assert_allclose(tool, forward(geometry, commands).position, atol=5e-6)


def test_the_exported_arms_hang_on_the_world_in_their_own_colours(reading: Any) -> None:
    for name, colour, mode in (("urdf_nominal", GREY, 1), ("urdf_true", STEEL, 3)):
        reading.holds(f"/{name}/base", parent_frame=["tf#/"], child_frame=[f"{name}/base"])
        bodies = [e for e in reading.entities() if e.startswith(f"/{name}/{name}/visual_geometries/")]
        assert len(bodies) == 9
        for entity in bodies:
            packed = int(reading.values(entity, "Cylinders3D:colors")[-1])  # what was sent last is what holds
            assert tuple(packed >> shift & 0xFF for shift in (24, 16, 8)) == colour
            assert reading.values(entity, "Cylinders3D:fill_mode")[-1] == mode
