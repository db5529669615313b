"""Parts of the reach task written out: the bounds of a move, the turn no joint makes, goals as seen, their rewards."""

from dataclasses import replace
from types import SimpleNamespace

import gymnasium as gym
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import pickenv  # noqa: F401  (registers the environments)
from pickenv.arm import load_arm, rotation_matrix
from pickenv.base import InputError
from pickenv.envs import make_task
from pickenv.envs.shared import simulation
from pickenv.envs.shared.backends import ARM, CAMERA, FLOATS, FRUIT, NUMPY, episode_key, normal, stream_key, uniform
from pickenv.envs.shared.task import lost_axes


def test_a_move_is_a_share_of_the_largest_increment_of_at_most_one_and_ends_at_the_limits():
    task = make_task()
    lower, upper, most = (np.array(part) for part in (task.lower, task.upper, task.increment))
    rng = np.random.default_rng(0)
    for _ in range(200):
        target, action = rng.uniform(lower, upper), rng.uniform(-2.5, 2.5, 6)
        expected = np.clip(target + np.clip(action, -1.0, 1.0) * most, lower, upper)
        np.testing.assert_allclose(simulation.move(FLOATS, task, target.tolist(), action.tolist()), expected)


def test_the_turn_that_no_joint_makes_is_along_the_normal_of_both_axes():
    """Whichever way the axes point; those of the picking arm have zeros."""
    task, rng = replace(make_task(), lost_axes=(1, 3)), np.random.default_rng(0)
    for _ in range(50):
        frames = [tuple(rng.normal(size=12).tolist()) for _ in range(6)]
        turn = rng.normal(size=3)
        normal = np.cross(frames[2][6:9], frames[4][6:9])
        expected = abs(turn @ normal) / np.linalg.norm(normal)
        assert simulation._lost_angle(FLOATS, task, frames, turn.tolist()) == pytest.approx(expected)


def test_an_arm_that_turns_its_tool_any_way_loses_nothing():
    env = gym.make("pickenv/Reach-v0", plant="ideal:ur5")
    env.reset(seed=0)
    info = env.step(env.action_space.sample())[-1]
    env.close()
    assert info["attitude_error_deg"] > 1.0 and info["noncompensable_deg"] == 0.0
    assert info["compensable_deg"] == pytest.approx(info["attitude_error_deg"])


@pytest.mark.parametrize(("feedback", "near"), [("camera", 1e-6), ("encoders", None)])
def test_the_goal_that_counts_as_achieved_is_the_tool_as_it_is_measured(feedback, near):
    """By a camera without noise that is the true tool, by encoders the one that the controller believes in."""
    env = gym.make("pickenv/ReachGoal-v0", feedback=feedback, reward="dense")
    env.reset(seed=3)
    rng = np.random.default_rng(3)
    for _ in range(5):
        observation, reward, *_, info = env.step(rng.uniform(-1, 1, 6))
        achieved, desired = observation["achieved_goal"].astype(float), observation["desired_goal"].astype(float)
        apart = np.linalg.norm(achieved[:3] - info["tool_position"])
        assert apart < near if near else 1e-4 < apart < 2e-2
        np.testing.assert_allclose(desired[:3], info["fruit_position"], atol=1e-6)
        have, want = attitude_of(achieved), attitude_of(desired)
        np.testing.assert_allclose(want.T @ want, np.eye(3), atol=1e-6)
        true = rotation_matrix(info["pose_error"][3:]) @ want
        assert Rotation.from_matrix(have.T @ true).magnitude() < 2e-2  # as it is believed, whatever the feedback
        score, _ = scored(achieved[None], desired[None])
        assert reward == pytest.approx(score.item(), abs=1e-4)
    env.close()


def attitude_of(goal):
    """The rotation matrix of a goal."""
    z, x = goal[3:6], goal[6:9]
    return np.stack([x, np.cross(z, x), z], axis=1)


def scored(achieved, desired, tolerance_mm=5.0, tolerance_deg=10.0):
    """Dense rewards of goals as the card says, and where they succeed."""
    mm = 1e3 * np.linalg.norm(achieved[:, :3] - desired[:, :3], axis=1)
    turns = [attitude_of(one) @ attitude_of(other).T for one, other in zip(achieved, desired, strict=True)]
    deg = np.degrees(Rotation.from_matrix(turns).magnitude())
    success = (mm <= tolerance_mm) & (deg <= tolerance_deg)
    outside = np.log10(1 + tolerance_mm) + 0.5 * np.log10(1 + tolerance_deg)
    return -np.log10(1 + mm) - 0.5 * np.log10(1 + deg) - np.where(success, 0.0, outside), success


@pytest.mark.parametrize("sparse", [True, False])
def test_rewards_of_goals_count_millimetres_and_degrees(sparse):
    env = gym.make("pickenv/ReachGoal-v0", reward="sparse" if sparse else "dense", tolerance_mm=5.0)
    rng = np.random.default_rng(0)
    here = rng.uniform(-1, 1, (400, 3))
    turned = Rotation.random(400, rng=rng)
    away, about = (each / np.linalg.norm(each, axis=1)[:, None] for each in rng.normal(size=(2, 400, 3)))
    there = here + 1e-3 * rng.permutation(np.geomspace(1e-2, 2e3, 400))[:, None] * away
    wanted = Rotation.from_rotvec(np.geomspace(1e-4, np.pi, 400)[:, None] * about) * turned

    def goals(positions, attitudes):
        axes = attitudes.as_matrix()
        return np.concatenate([positions, axes[:, :, 2], axes[:, :, 0]], axis=1)

    achieved, desired = goals(here, turned), goals(there, wanted)
    found = env.unwrapped.compute_reward(achieved, desired, {})
    env.close()
    score, success = scored(achieved, desired)
    assert 20 < success.sum() < 380
    np.testing.assert_allclose(found, np.where(success, 0.0, -1.0) if sparse else score, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("tolerances", [(5.0, 10.0), (0.3, 10.0), (20.0, 1.0), (1e-3, 90.0), (200.0, 0.1)])
def test_no_failure_is_ranked_above_a_success(tolerances):
    """The dense reward over position and attitude errors, from nothing to all that an arm can be off by."""
    millimetres, degrees = tolerances
    task = make_task(tolerance_mm=millimetres, angle_tolerance_deg=degrees)
    edges = [[0.0, limit * (1 - 1e-12), limit, limit * (1 + 1e-12)] for limit in tolerances]
    mm = np.concatenate([edges[0], np.geomspace(1e-4, 4e3, 150)])
    deg = np.concatenate([edges[1], np.geomspace(1e-4, 180.0, 150)])
    mm, deg = (each.ravel() for each in np.meshgrid(mm, deg))
    success = simulation.in_capture_region(task, mm, deg)
    assert np.array_equal(success, (mm <= millimetres) & (deg <= degrees)) and 0 < success.sum() < len(mm)
    scene = SimpleNamespace(numbers=(mm, deg, 0.0, deg), success=success)
    reward = simulation.true_reward(NUMPY, task, scene)
    assert reward[~success].max() < reward[success].min() and reward.max() == 0.0
    for better, other in ((mm, deg), (deg, mm)):  # nearer is better, whatever else stays
        order = np.lexsort((better, other))
        same = np.diff(other[order]) == 0
        assert (np.diff(reward[order])[same] <= 0).all()


def test_one_environment_asks_for_one_row_of_joints_and_several_for_one_or_as_many():
    task = make_task()
    with pytest.raises(InputError, match=r"goal_joints must be \(6,\) joints"):
        task.given_joints("goal_joints", np.zeros((2, 6)))
    with pytest.raises(InputError, match=r"goal_joints must be \(6,\) or \(3, 6\) joints"):
        task.given_joints("goal_joints", np.zeros((2, 6)), 3)
    middle = np.array(task.middle)
    np.testing.assert_array_equal(task.given_joints("goal_joints", middle, 3), np.tile(middle, (3, 1)))
    np.testing.assert_array_equal(task.given_joints("goal_joints", np.tile(middle, (3, 1)), 3), np.tile(middle, (3, 1)))


def test_joints_at_the_limits_are_inside_the_workspace():
    task = make_task()
    for limit in (task.lower, task.upper):
        np.testing.assert_array_equal(task.given_joints("goal_joints", limit), limit)
    for joint in range(6):
        for limit, beyond in ((task.lower, -1e-9), (task.upper, 1e-9)):
            joints = np.array(limit)
            joints[joint] += beyond
            with pytest.raises(InputError, match="inside the arm's workspace"):
                task.given_joints("goal_joints", joints)


@pytest.mark.parametrize(
    ("distance_mm", "angle_deg", "inside"),
    [(5.0, 10.0, True), (5.000001, 10.0, False), (5.0, 10.000001, False), (0.0, 0.0, True)],
)
def test_the_border_of_the_capture_region_belongs_to_it(distance_mm, angle_deg, inside):
    assert simulation.in_capture_region(make_task(), distance_mm, angle_deg) is inside


def test_a_goal_as_far_off_as_the_tolerance_is_reached():
    task = make_task(reward="sparse", tolerance_mm=5.0)
    axes = (0.0, 0.0, 1.0, 1.0, 0.0, 0.0)
    for metres, reward in ((0.005, 0.0), (0.0050001, -1.0)):
        assert simulation.goal_reward(FLOATS, task, (0.0, 0.0, 0.0, *axes), (0.0, metres, 0.0, *axes)) == reward


@pytest.mark.parametrize(("arm", "axes"), [("qiao2026", (0, 5)), ("ur5", None), ("wam", None), ("li2016_slave", None)])
def test_a_turn_is_lost_where_all_turning_axes_have_one_of_two_directions(arm, axes):
    """J1 and J6 on the picking arm, whose J5 slides; an arm that only slides has none, others have more."""
    assert lost_axes(load_arm(arm).nominal) == axes


def test_without_lost_axes_no_turn_is_lost_however_it_stands():
    task = replace(make_task(), lost_axes=None)
    for turn in ([0.0, 0.0, 0.0], [0.1, -0.2, 0.4], [0.0, 0.3, 0.0]):
        assert simulation._lost_angle(FLOATS, task, [], turn) == 0.0


def test_readings_are_scaled_to_the_limits_and_cut_off_beyond():
    task = make_task()
    lower, upper = np.array(task.lower), np.array(task.upper)
    for share in (-1.5, -1.0, -0.3, 0.0, 0.9, 1.0, 1.2):
        joints = (lower + upper) / 2 + share * (upper - lower) / 2
        np.testing.assert_allclose(simulation.scaled(FLOATS, task, joints.tolist()), np.clip(share, -1, 1), atol=1e-12)


def test_no_number_of_the_goals_stream_is_used_twice_and_none_is_left_out(monkeypatch):
    task, used = make_task(), []
    monkeypatch.setattr(simulation, "uniform", lambda x, key, draw: used.append(draw) or 0.5)
    for attempt in range(4):
        joints, _ = simulation.goal_attempt(FLOATS, task, 1, attempt)
        np.testing.assert_allclose(joints, task.middle)
    assert used == list(range(4 * 6))


def test_what_the_camera_sees_is_off_by_the_numbers_of_its_own_streams():
    """The fruit's place by one stream, once; each moment's offset by the next three numbers of another."""
    task = make_task(feedback="camera", camera_noise_mm=2.0, fruit_noise_mm=3.0)
    key, joints = episode_key(FLOATS, 5, 0), list(task.middle)
    wanted = simulation.nominal_frames(FLOATS, task, joints)[1]
    state = simulation.begin(FLOATS, task, task.plant, key, joints, wanted, joints)
    fruit, camera = (stream_key(FLOATS, key, stream) for stream in (FRUIT, CAMERA))
    np.testing.assert_allclose(
        np.array(state.seen) - state.goal[9:], [3e-3 * normal(FLOATS, fruit, i) for i in range(3)], rtol=1e-9
    )
    for moment in range(3):
        _, view = simulation.look(FLOATS, task, task.plant, state, joints, key, moment, 0.1)
        off = np.array(view.camera) - (np.array(view.fruit) - view.tool)
        expected = [2e-3 * normal(FLOATS, camera, 3 * moment + i) for i in range(3)]
        np.testing.assert_allclose(off, expected, rtol=1e-9)


def test_an_environment_that_keeps_its_arm_has_the_one_of_its_first_episode():
    """Drawn by the first number of the episode's stream of arms, a share of the population."""
    kept, changing = (make_task(arms=arms, population=50) for arms in ("per_env", "per_episode"))
    for seed in range(20):
        first, later = (episode_key(FLOATS, seed, episode) for episode in (0, 7))
        expected = uniform(FLOATS, stream_key(FLOATS, first, ARM), 0) * 50
        assert simulation.drawn_arm(FLOATS, changing, seed, first) == expected
        assert {simulation.drawn_arm(FLOATS, kept, seed, key) for key in (first, later)} == {expected}
        assert simulation.drawn_arm(FLOATS, changing, seed, later) != expected


def test_arms_of_a_population_are_counted_from_0():
    task = make_task(arms="per_episode", population=3)
    assert [task.given_arm(number) for number in (0, 2, np.int64(1))] == [0, 2, 1]
    for number in (-1, 3, 1.0):
        with pytest.raises(InputError, match="the population has arms 0 to 2"):
            task.given_arm(number)
    with pytest.raises(InputError, match="option arm needs a population"):
        make_task().given_arm(0)
    assert make_task(arms="per_episode", population=1).population == 1
    with pytest.raises(InputError, match="population is 0; give a whole number of at least 1"):
        make_task(arms="per_episode", population=0)
    with pytest.raises(InputError, match="population_seed is -1; give a whole number of at least 0"):
        make_task(arms="per_episode", population_seed=-1)
    with pytest.raises(InputError, match=r"population is 2\.5"):
        make_task(arms="per_episode", population=2.5)
    with pytest.raises(InputError, match="population is True"):
        make_task(arms="per_episode", population=True)


def test_the_bounds_of_a_tasks_numbers_can_be_asked_for():
    assert make_task(camera_noise_mm=100.0).camera_noise == 0.1
    with pytest.raises(InputError, match=r"camera_noise_mm is 100\.5; give at most 100"):
        make_task(camera_noise_mm=100.5)
    with pytest.raises(InputError, match=r"tolerance_mm is 1000000\.5"):
        make_task(tolerance_mm=1e6 + 0.5)
    assert make_task(tolerance_mm=0.25, angle_tolerance_deg=1.0).tolerance_mm == 0.25
    for name in ("tolerance_mm", "angle_tolerance_deg", "max_tilt_deg"):
        with pytest.raises(InputError, match=f"{name} is 0; give a finite number above zero"):
            make_task(**{name: 0})
        with pytest.raises(InputError, match=f"{name} is True"):
            make_task(**{name: True})
    for tilt in (180.0, 200.0, 1e5):
        assert make_task(max_tilt_deg=tilt).min_upright == -1.0


@pytest.mark.parametrize(("size", "taken"), [(1.0, True), (1.0 + 0.9e-6, True), (1.0 + 1.1e-6, False), (1.5, False)])
def test_actions_end_at_one_and_a_rounding(size, taken):
    env = gym.make("pickenv/Reach-v0", out_of_range="refuse", disable_env_checker=True).unwrapped
    env.reset(seed=0)
    for sign in (-1.0, 1.0):
        action = np.array([0.0, 0.0, sign * size, 0.0, 0.0, 0.0])
        if taken:
            env.step(action)
        else:
            with pytest.raises(InputError, match="finite numbers between -1 and 1"):
                env.step(action)
    env.close()
