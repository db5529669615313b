"""What a comparison records of episodes that are written down here, moment by moment."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pickenv.agents.evaluation.compare import _capture, _recorded_policy
from pickenv.agents.evaluation.contenders import Moment
from pickenv.arm import Pose, load_plant
from pickenv.orchard import capture_probability, load_gripper

CUP, HAND = load_gripper("li_cup"), load_gripper("compliant_hand")
FRUIT = np.array([0.3, -0.2, 0.5])


def told(moments: Sequence[dict[str, Any]]) -> list[Moment]:
    """An episode; the reward of each step is its number."""
    usual = {"fruit_position": FRUIT}
    return [Moment(float(t), usual | info) for t, info in enumerate(moments)]


def away(millimetres: float) -> dict[str, Any]:
    return {"tool_position": np.add(FRUIT, [0.0, 1e-3 * millimetres, 0.0])}


def test_fruit_after_fruit_is_missed_where_an_attempt_is_told_and_picked_as_told():
    plain = {"attempted": 0, "collected": 0, "grasp_lateral_mm": np.nan, "grasp_axial_mm": np.nan}
    grasp = {"attempted": 1, "collected": 1, "grasp_lateral_mm": 3.0, "grasp_axial_mm": -4.0}
    late = {"attempted": 2, "collected": 1, "grasp_lateral_mm": 5.0, "grasp_axial_mm": 12.0}
    ways = [
        told([away(9) | plain, away(8) | grasp, away(7) | grasp, away(6) | late]),
        told([away(5) | grasp, away(4) | grasp]),  # it begins with what an earlier episode attempted
    ]
    found = _recorded_policy("LS", ways, 4, None, CUP, np.zeros(2))
    assert (found.label, found.key) == ("LS", "ls")
    np.testing.assert_array_equal(found.moments, [4, 2])
    np.testing.assert_allclose(found.position_error_mm, [[9, 8, 7, 6], [5, 4, 4, 4]])
    np.testing.assert_allclose(found.miss_mm, [[np.nan, 5.0, np.nan, 13.0], [np.nan] * 4])
    np.testing.assert_array_equal(found.picked, [[0, 1, 1, 1], [1, 1, 1, 1]])
    np.testing.assert_array_equal(found.reward, [[0, 1, 2, 3], [0, 1, 0, 0]])
    assert not found.success.any() and np.isnan(found.tool_rotation).all() and found.joint_target.shape == (2, 4, 0)
    assert np.isnan(found.attitude_error_deg).all()


def test_a_reach_closes_at_its_last_moment_and_takes_what_success_or_tolerance_says():
    judged = [told([away(9) | {"is_success": s} for s in some]) for some in ([True, False, True], [True, False])]
    found = _recorded_policy("raw", judged, 3, None, CUP, np.zeros(2))
    np.testing.assert_array_equal(found.success, [[True, False, True], [True, False, False]])
    np.testing.assert_array_equal(found.picked, [[0, 0, 1], [0, 0, 0]])
    np.testing.assert_allclose(found.miss_mm, [[np.nan, np.nan, 9.0], [np.nan, 9.0, np.nan]])
    near = [told([away(1), away(mm)]) for mm in (4.99, 5.01)] + [told([away(1)] * 3)]
    found = _recorded_policy("raw", near, 3, None, CUP, np.zeros(3))
    np.testing.assert_array_equal(found.picked, [[0, 1, 1], [0, 0, 0], [0, 0, 1]])
    assert not found.success.any()


@pytest.mark.parametrize(("millimetres", "chance", "taken"), [(0.0, 0.5, True), (90.0, 0.5, False), (0.0, 1.0, False)])
def test_a_reach_of_an_arm_is_judged_by_the_gripper_and_a_drawn_number(millimetres, chance, taken):
    plant = load_plant("ideal")
    joints = (plant.arm.nominal.lower + plant.arm.nominal.upper) / 2
    pose = plant.tool_pose(joints)
    info = {
        "tool_position": pose.position,
        "fruit_position": pose.position + 1e-3 * millimetres * pose.rotation[:, 0],
        "joint_command": joints,
        "pose_error": np.zeros(6),
        "is_success": not taken,
        "attitude_error_deg": 3.0,
    }
    ways = [[Moment(0.0, info, joints + 0.1), Moment(-1.0, info)]]
    found = _recorded_policy("raw", ways, 2, plant, CUP, np.array([chance]))
    np.testing.assert_array_equal(found.picked, [[0, taken]])
    np.testing.assert_allclose(found.tool_rotation, np.broadcast_to(pose.rotation, (1, 2, 3, 3)))
    np.testing.assert_allclose(found.joint_target, [[joints + 0.1, joints]])
    np.testing.assert_allclose(found.joint_command, [[joints, joints]])
    assert (found.attitude_error_deg == 3.0).all() and found.miss_mm[0, 1] == pytest.approx(millimetres, abs=1e-9)


@pytest.mark.parametrize("gripper", [CUP, HAND], ids=["cup", "hand"])
def test_a_gripper_takes_by_offsets_along_and_across_the_tool_and_by_the_angle_to_what_was_wanted(gripper):
    rng = np.random.default_rng(0)
    wanted = Rotation.random(6, random_state=1)
    turn, miss = rng.normal(scale=0.15, size=(6, 3)), rng.normal(scale=0.004, size=(6, 3))
    true = Rotation.from_rotvec(turn) * wanted
    at = rng.normal(size=(6, 3))
    error = np.concatenate([rng.normal(size=(6, 3)), turn], axis=1)
    found = _capture(gripper, Pose(at, true.as_matrix()), at + miss, error)
    axis, aim = true.as_matrix()[..., 2], wanted.as_matrix()[..., 2]
    axial = np.sum(miss * axis, axis=1)
    lateral = np.sqrt(np.sum(miss**2, axis=1) - axial**2)
    angle = np.arccos(np.sum(axis * aim, axis=1))
    np.testing.assert_allclose(found, capture_probability(gripper, lateral, axial, angle), atol=1e-9)


def test_shorter_episodes_stay_at_their_last_moment_and_earn_and_miss_nothing_more() -> None:
    ways = [told([away(mm) | {"is_success": mm < 2} for mm in (2, 1)])]
    longer = _recorded_policy("raw", ways, 5, None, CUP, np.zeros(1))
    np.testing.assert_allclose(longer.position_error_mm, [[2, 1, 1, 1, 1]])
    np.testing.assert_array_equal(longer.picked, [[0, 1, 1, 1, 1]])
    np.testing.assert_array_equal(longer.reward, [[0, 1, 0, 0, 0]])
    np.testing.assert_allclose(longer.miss_mm, [[np.nan, 1, np.nan, np.nan, np.nan]])
    np.testing.assert_allclose(longer.tool_position[0, 1:], [longer.tool_position[0, 1]] * 4)
    np.testing.assert_array_equal(longer.moments, [2])
