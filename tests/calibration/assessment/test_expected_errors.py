"""Errors expected where the arm will work: what the rows tell there, what they do not, and what is said of it."""

from dataclasses import replace

import numpy as np
import pytest

from pickenv.arm import Plant, draw_plants, forward, load_arm, load_tolerances, plant_at, rotation_matrix
from pickenv.base import InputError
from pickenv.calibration import prior_model, random_joints, simulated_tracker, workspace_joints
from pickenv.calibration.assessment.quality import workspace_error
from pickenv.calibration.identification.solve import solve

ARM = load_arm("ur5")
UR5 = ARM.nominal


def judged(seed, span, count=40, where=None):
    """An arm measured in the middle of its joint ranges, over this share of them, and judged all over them."""
    plant = plant_at(draw_plants(Plant("ur5", ARM, UR5), load_tolerances("cobot"), 1, np.random.default_rng(seed)), 0)
    rng = np.random.default_rng(seed + 1)
    joints = (UR5.lower + UR5.upper) / 2 + span * (rng.random((count, 6)) - 0.5) * (UR5.upper - UR5.lower)
    rows = simulated_tracker(plant, joints, rng)
    turn = rotation_matrix(rows.attitude_std * rng.standard_normal((count, 3)))
    place = rows.position + rows.position_std * rng.standard_normal((count, 3))
    rows = replace(rows, position=place, rotation=turn @ rows.rotation)
    solution = solve(prior_model("ur5", UR5, known=True, scale=1.0), rows)
    region, there = workspace_joints(where, UR5)
    return plant, solution, there, workspace_error(solution, UR5, joints, there, region)


def test_expected_errors_are_those_of_the_arms():
    """Over fifteen arms the mean squares expected, of calibrated and of nominal arms, are what these have."""
    squares = np.zeros((2, 2))
    for seed in range(15):
        plant, solution, there, workspace = judged(10 * seed, 0.1, count=10)
        truth = forward(plant.geometry, there).position
        for i, geometry in enumerate((solution.geometry, UR5)):
            squares[0, i] += np.mean(np.sum((forward(geometry, there).position - truth) ** 2, axis=1))
        squares[1] += [workspace.declared.calibrated**2, workspace.declared.nominal**2]
    assert squares[1] == pytest.approx(squares[0], rel=0.35)


def test_rows_all_over_tell_all_and_rows_in_a_corner_say_so():
    *_, wide = judged(1, 1.0)
    *_, narrow = judged(1, 0.01)
    assert wide.reservation is None and wide.declared.narrowed > 0.95 and wide.thin == ()
    assert narrow.measured.narrowed > narrow.declared.narrowed
    assert narrow.declared.calibrated > 5 * wide.declared.calibrated
    assert set(narrow.thin) == set(UR5.joint_names)


def test_little_told_is_a_reservation_with_a_remedy():
    *_, workspace = judged(2, 0.001, count=2)
    assert "over the joint limits" in workspace.reservation and "`workspace`" in workspace.reservation
    assert UR5.joint_names[0] in workspace.reservation


def test_a_smaller_workspace_is_told_better():
    """The same rows, judged where they lie: no reservation is left."""
    middle, half = (UR5.lower + UR5.upper) / 2, 0.06 * (UR5.upper - UR5.lower)
    ends = np.degrees(np.stack([middle - half, middle + half], axis=1))
    text = ",".join(f"q{i}={low:.0f}:{high:.0f}" for i, (low, high) in enumerate(ends, start=1))
    *_, whole = judged(3, 0.1)
    *_, near = judged(3, 0.1, where=text)
    assert near.declared.calibrated < 0.5 * whole.declared.calibrated and near.thin == ()


def test_fits_without_priors_have_none():
    rng = np.random.default_rng(4)
    rows = simulated_tracker(Plant("ur5", ARM, UR5), random_joints(UR5, 60, rng), rng)
    solution = solve(prior_model("ur5", UR5, known=True, fit="full"), rows)
    assert workspace_error(solution, UR5, rows.joints, rows.joints) is None


def test_ranges_of_joints_and_of_places_are_kept():
    region, joints = workspace_joints("q1=-90:90, q3=0:45", UR5)
    assert region == "workspace q1=-90:90, q3=0:45"
    assert np.abs(np.degrees(joints[:, 0])).max() <= 90 and np.degrees(joints[:, 2]).min() >= 0
    _, joints = workspace_joints("x=300:700,z=0:500", UR5)
    place = forward(UR5, joints).position * 1e3
    assert (place[:, 0] >= 300).all() and (place[:, 0] <= 700).all() and (place[:, 2] >= 0).all() and len(joints) == 400
    assert np.array_equal(workspace_joints(None, UR5)[1], workspace_joints(None, UR5)[1])


def test_targets_of_a_file_are_a_workspace_unless_a_fitted_base_and_tool_alone_explain_them(tmp_path):
    path = tmp_path / "targets.csv"
    rows = ["q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg", *(f"{i},-90,90,0,10,0" for i in range(8))]
    path.write_text("\n".join(rows))
    region, joints = workspace_joints(path, UR5)
    assert len(joints) == 8 and np.degrees(joints[:, 0]) == pytest.approx(range(8)) and str(path) in region
    path.write_text("\n".join(rows[:-1]))
    with pytest.raises(InputError, match="7 targets are no workspace; give 8 or more"):
        workspace_joints(path, UR5)
    assert len(workspace_joints(path, UR5, "known")[1]) == 7


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("q1=1", "'q1=1' is no range; write q1=-90:90"),
        ("q1=a:b", "is no range"),
        ("q1=20:10", "is empty; give the lower end first"),
        ("q9=0:1", "names no joint or axis; give some of q1, q2"),
        ("q1=400:500", "lies outside the limits of"),
        ("x=5000:6000", "reaches hardly anything"),
    ],
)
def test_ranges_that_mean_nothing_are_named(text, said):
    with pytest.raises(InputError, match=said):
        workspace_joints(text, UR5)


def test_what_hardly_matters_beside_the_scatter_of_one_reach_is_no_reservation():
    """Geometry known to a tenth of what a reach errs by anyway needs no further poses."""
    *_, workspace = judged(2, 0.001, count=2)
    size = workspace.declared.calibrated
    assert replace(workspace, remains=1.99 * size).reservation is not None
    assert replace(workspace, remains=2.01 * size).reservation is None
