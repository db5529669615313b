"""Reach-v0: what the policy is told, what it is not, and what is scored."""

import math

import gymnasium as gym
import numpy as np
import pytest

from pickenv.arm import forward, load_plant, pose_error, rotation_matrix
from pickenv.base import InputError
from pickenv.envs import make_task
from pickenv.envs.shared.backends import FLOATS, seed_word
from pickenv.envs.shared.simulation import goal_attempt

MIDDLE = [math.radians(7.5), 0.3, 0.4, 0.0, 0.1, 0.0]


def random_actions(count=40, seed=0):
    return np.random.default_rng(seed).uniform(-1, 1, (count, 6)).astype(np.float32)


def observed(env, seed, actions):
    return np.array([env.reset(seed=seed)[0], *(env.step(action)[0] for action in actions)])


@pytest.mark.parametrize("seed", range(3))
def test_encoders_see_nothing_of_the_true_arm(make, seed):
    """The same observations whatever the plant, and whichever of its effects are on."""
    actions = random_actions(seed=seed)
    reference = observed(make(plant="geometry_only"), seed, actions)
    for arguments in ({"plant": "qiao2026"}, {"plant": "qiao2026", "without": ["joint_compliance"]}):
        env = make(**arguments)
        assert np.array_equal(observed(env, seed, actions), reference)
        assert env.observation_space == make(plant="geometry_only").observation_space


def test_plants_differ_in_what_is_scored(make):
    rewards, errors = [], []
    for plant in ("geometry_only", "qiao2026"):
        env = make(plant=plant)
        env.reset(seed=0)
        _, reward, *_, info = env.step(np.zeros(6, dtype=np.float32))
        rewards.append(reward)
        errors.append(info["pose_error"])
    assert rewards[0] != rewards[1]
    assert 1e-5 < np.linalg.norm((errors[0] - errors[1])[:3]) < 5e-3


def test_the_observation_is_what_the_controller_believes(make):
    env = make()
    geometry = env.unwrapped.plant.arm.nominal
    goal = np.array([0.2, 0.45, 0.2, -0.3, 0.05, 1.0])
    observation, _ = env.reset(seed=0, options={"goal_joints": goal})
    wanted = forward(geometry, goal)
    for action in [None, *random_actions(20)]:
        if action is not None:
            observation = env.step(action)[0]
        joints = env.unwrapped.joint_target
        believed = forward(geometry, joints)
        share = (joints - geometry.lower) / (geometry.upper - geometry.lower)
        error = pose_error(believed, wanted)
        expected = np.concatenate([2 * share - 1, believed.position, wanted.position, error])
        np.testing.assert_allclose(observation, expected, atol=3e-7)


def test_actions_add_up_to_the_joint_target_within_the_limits(make):
    env = make()
    env.reset(seed=0)
    np.testing.assert_allclose(env.unwrapped.joint_target, MIDDLE, atol=1e-15)
    env.step(np.array([1, -1, 0.5, 0.25, 0, -0.5], dtype=np.float32))
    increments = np.array([math.radians(6), -0.05, 0.025, math.radians(1.5), 0, -math.radians(9)])
    np.testing.assert_allclose(env.unwrapped.joint_target, np.add(MIDDLE, increments), atol=1e-9)
    geometry = env.unwrapped.plant.arm.nominal
    for direction, limit in ((1, geometry.upper), (-1, geometry.lower)):
        env.reset(seed=0)
        for _ in range(25):
            observation = env.step(np.full(6, direction, dtype=np.float32))[0]
        np.testing.assert_array_equal(env.unwrapped.joint_target, limit)
        np.testing.assert_array_equal(observation[:6], direction)


def test_the_error_is_the_true_tool_against_the_fruit(make):
    env = make()
    plant = load_plant("qiao2026")
    goal = np.array([0.2, 0.45, 0.2, -0.3, 0.05, 1.0])
    env.reset(seed=0, options={"goal_joints": goal})
    fruit = forward(plant.arm.nominal, goal)
    for action in random_actions(10):
        _, reward, _, _, info = env.step(action)
        true = plant.tool_pose(env.unwrapped.joint_target)
        error = pose_error(fruit, true)
        np.testing.assert_allclose(info["pose_error"], error, atol=1e-12)
        np.testing.assert_allclose(info["tool_position"], true.position, atol=1e-12)
        np.testing.assert_allclose(info["fruit_position"], fruit.position, atol=1e-12)
        np.testing.assert_array_equal(info["joint_command"], env.unwrapped.joint_target)
        mm, deg = np.linalg.norm(error[:3]) * 1e3, np.degrees(np.linalg.norm(error[3:]))
        assert info["position_error_mm"] == pytest.approx(mm)
        assert info["attitude_error_deg"] == pytest.approx(deg)
        assert not info["is_success"]
        edge = math.log10(1 + 5.0) + 0.5 * math.log10(1 + 10.0)
        assert reward == pytest.approx(-math.log10(1 + mm) - 0.5 * math.log10(1 + deg) - edge)


def test_dense_rewards_run_from_far_away_to_perfect(make):
    env = make(plant="geometry_only")
    still = np.zeros(6, dtype=np.float32)
    env.reset(seed=1, options={"start_joints": MIDDLE, "goal_joints": MIDDLE})
    at_goal = env.step(still)[1]
    env.reset(seed=1)
    far = env.step(still)[1]
    assert -0.9 < at_goal < 0 and far < -2
    assert far > -5.7


def test_sparse_rewards_are_zero_inside_the_capture_region_alone(make):
    goal = {"start_joints": MIDDLE, "goal_joints": MIDDLE}
    still = np.zeros(6, dtype=np.float32)
    for arguments, reward, success in (
        ({"tolerance_mm": 5.0}, 0.0, True),
        ({"tolerance_mm": 0.01}, -1.0, False),
        ({"angle_tolerance_deg": 0.001}, -1.0, False),
    ):
        env = make(reward="sparse", **arguments)
        env.reset(seed=0, options=goal)
        _, found, terminated, _, info = env.step(still)
        assert (found, info["is_success"], terminated) == (reward, success, False)
        assert type(info["is_success"]) is bool


def test_an_episode_lasts_sixty_steps(make):
    env = make()
    env.reset(seed=0)
    flags = [env.step(action)[2:4] for action in random_actions(60)]
    assert flags == [(False, False)] * 59 + [(False, True)]


def test_seeds_differ_in_every_randomised_field(make):
    env = make(feedback="camera", camera_noise_mm=2.0)
    drawn = np.array([env.reset(seed=seed)[0] for seed in range(20)])
    random = drawn[:, [*range(9, 21)]]  # fruit as seen, offset, attitude, the camera's own offset
    assert all(len(np.unique(column)) == 20 for column in random.T)
    assert (np.ptp(drawn[:, :9], axis=0) == 0).all()  # the start is the same


def test_goals_are_inside_the_ranges_and_picked_from_below(make):
    env = make(max_tilt_deg=10.0)
    geometry = env.unwrapped.plant.arm.nominal
    for seed in range(50):
        observation, _ = env.reset(seed=seed)
        believed = forward(geometry, MIDDLE)
        wanted = rotation_matrix(observation[15:18].astype(float)) @ believed.rotation
        assert np.degrees(np.arccos(min(1.0, wanted[2, 2]))) < 10.01


def test_start_and_goal_can_be_given(make):
    env = make()
    start, goal = [0.1, 0.2, 0.3, 0.4, 0.1, 0.6], [0.2, 0.1, 0.5, -0.2, 0.15, -2.0]
    observation, info = env.reset(seed=0, options={"start_joints": start, "goal_joints": goal})
    np.testing.assert_allclose(env.unwrapped.joint_target, start)
    nominal = env.unwrapped.plant.arm.nominal
    np.testing.assert_allclose(info["fruit_position"], forward(nominal, goal).position, atol=1e-12)
    assert observation[:6] == pytest.approx(2 * (start - nominal.lower) / (nominal.upper - nominal.lower) - 1, abs=1e-6)


def test_the_camera_sees_the_true_offset(make):
    env = make(feedback="camera")
    observation, info = env.reset(seed=0)
    np.testing.assert_allclose(observation[18:], info["fruit_position"] - info["tool_position"], atol=2e-7)
    assert not np.allclose(observation[18:], observation[12:15], atol=1e-5)


def test_camera_noise_has_the_size_asked_for(make):
    env = make(feedback="camera", camera_noise_mm=2.0)
    fruit, offset = [], []
    for seed in range(150):
        observation, info = env.reset(seed=seed)
        fruit.append(observation[9:12] - info["fruit_position"])
        offset.append(observation[18:] - (info["fruit_position"] - info["tool_position"]))
    for errors in (fruit, offset):
        assert np.std(errors) == pytest.approx(2e-3, rel=0.15)
        assert abs(np.mean(errors)) < 4e-4
    assert abs(np.corrcoef(np.ravel(fruit), np.ravel(offset))[0, 1]) < 0.2


BAD_ARGUMENTS = {
    "unknown plant": ({"plant": "qiao"}, r"unknown plant 'qiao'; give one of"),
    "unknown effect": ({"without": ["backlas"]}, r"unknown effect 'backlas'"),
    "unknown feedback": ({"feedback": "laser"}, r"feedback is 'laser'; give one of encoders, camera"),
    "unknown reward": ({"reward": "shaped"}, r"reward is 'shaped'; give one of dense, sparse"),
    "no tolerance": ({"tolerance_mm": 0.0}, r"tolerance_mm is 0\.0; give a finite number above zero"),
    "negative tolerance": ({"tolerance_mm": -1}, r"tolerance_mm is -1"),
    "tolerance that is no number": ({"tolerance_mm": math.nan}, r"tolerance_mm is nan"),
    "infinite angle": ({"angle_tolerance_deg": math.inf}, r"angle_tolerance_deg is inf"),
    "negative noise": ({"camera_noise_mm": -0.1}, r"camera_noise_mm is -0\.1; give a finite number not below zero"),
    "noise beyond the observation's bounds": ({"camera_noise_mm": 200.0}, r"camera_noise_mm is 200.*at most 100"),
    "no tilt": ({"max_tilt_deg": 0.0}, r"max_tilt_deg is 0\.0"),
    "one effect not in a list": ({"without": "boom_bending"}, r"without is 'boom_bending'; give a list"),
    "an effect that is no name": ({"without": ["boom_bending", 3]}, r"without is \['boom_bending', 3\]; give a list"),
    "effects that are no list": ({"without": 3}, r"without is 3; give a list"),
    "more than any number": ({"tolerance_mm": 1e6 + 1}, r"tolerance_mm is 1000001.*at most 1000000"),
}


def test_a_task_of_which_nothing_is_said_is_the_one_of_the_class_and_the_largest_numbers_are_possible():
    task = make_task()
    assert (task.tolerance_mm, task.angle_tolerance_deg, task.arms, task.population) == (5.0, 10.0, "fixed", 1)
    assert task.min_upright == pytest.approx(math.cos(math.radians(30.0)))
    assert not (task.camera or task.camera_noise or task.fruit_noise or task.sparse or task.end_on_success)
    assert make_task(arms="per_episode").population == 256
    assert make_task(tolerance_mm=1e6).tolerance_mm == 1e6


@pytest.mark.parametrize("case", BAD_ARGUMENTS)
def test_impossible_arguments_are_refused_in_one_sentence(case):
    arguments, said = BAD_ARGUMENTS[case]
    with pytest.raises(InputError, match=said) as caught:
        gym.make("pickenv/Reach-v0", **arguments)
    assert "\n" not in str(caught.value)


BAD_OPTIONS = {
    "unknown option": ({"goal": MIDDLE}, r"unknown reset option 'goal'; give start_joints, goal_joints"),
    "goal beyond the limits": (
        {"goal_joints": [0, 0.7, 0, 0, 0, 0]},
        r"goal_joints must be .* joint limits",
    ),
    "start beyond the limits": (
        {"start_joints": [-1.0, 0, 0, 0, 0, 0]},
        r"start_joints must be .* joints .* joint limits",
    ),
    "five joints": ({"goal_joints": [0.0] * 5}, r"goal_joints must be .* joints .* joint limits"),
    "a joint that is no number": (
        {"goal_joints": [math.nan, 0, 0, 0, 0, 0]},
        r"goal_joints must be .* joints .* joint limits",
    ),
}


@pytest.mark.parametrize("case", BAD_OPTIONS)
def test_impossible_options_are_refused(make, case):
    options, said = BAD_OPTIONS[case]
    with pytest.raises(InputError, match=said):
        make().reset(seed=0, options=options)


@pytest.mark.parametrize("action", [np.full(6, np.nan), [0, 0, 0, 0, 0, np.inf], [np.inf, -np.inf, 0, 0, 0, 0]])
@pytest.mark.parametrize("shape", ["numbers", "shape"])
def test_impossible_actions_are_refused_and_move_nothing(make, action, shape):
    env = make().unwrapped
    env.reset(seed=0)
    with pytest.raises(InputError, match="is not 6 finite numbers"):
        env.step(action if shape == "numbers" else np.zeros(5))
    np.testing.assert_allclose(env.joint_target, MIDDLE, atol=1e-15)


def test_a_tilt_that_the_arm_cannot_take_is_said_so(make):
    with pytest.raises(InputError, match=r"found no pose .* raise max_tilt_deg"):
        make(max_tilt_deg=1e-4).reset(seed=0)


@pytest.mark.parametrize(("camera", "fruit"), [(0.0, 3.0), (3.0, 0.0), (1.0, 4.0)])
def test_the_noise_of_the_fruits_place_is_not_that_of_the_camera(make, camera, fruit):
    env = make(feedback="camera", camera_noise_mm=camera, fruit_noise_mm=fruit)
    place, offset = [], []
    for seed in range(150):
        observation, info = env.reset(seed=seed)
        place.append(observation[9:12] - info["fruit_position"])
        offset.append(observation[18:] - (info["fruit_position"] - info["tool_position"]))
    for errors, millimetres in ((place, fruit), (offset, camera)):
        assert np.std(errors) == pytest.approx(1e-3 * millimetres, rel=0.15, abs=1e-6)


def test_goals_keep_a_twentieth_of_each_range_away_from_both_limits_and_use_the_rest():
    """As `GOAL_MARGIN` says; a study places its fruit by the same constant."""
    task = gym.make("pickenv/Reach-v0").unwrapped.task
    joints = np.array([goal_attempt(FLOATS, task, seed_word(5), attempt)[0] for attempt in range(400)])
    share = (joints - task.lower) / (np.array(task.upper) - task.lower)
    assert share.min() >= 0.05 - 1e-12 and share.max() <= 0.95 + 1e-12
    assert share.min(axis=0).max() < 0.07 and share.max(axis=0).min() > 0.93


def test_an_arm_without_error_at_its_goal_has_no_error_of_any_kind_and_the_highest_reward(make):
    goal = {"start_joints": MIDDLE, "goal_joints": MIDDLE}
    one, many = make(plant="ideal"), gym.make_vec("pickenv/Reach-v0", num_envs=2, plant="ideal")
    for env, still in ((one, np.zeros(6, dtype=np.float32)), (many, np.zeros((2, 6), dtype=np.float32))):
        env.reset(seed=0, options=goal)
        _, reward, _, _, info = env.step(still)
        names = ("position_error_mm", "attitude_error_deg", "noncompensable_deg", "compensable_deg")
        assert max(np.max(np.abs(info[name])) for name in names) < 1e-12
        assert np.max(np.abs(reward)) < 1e-12
    many.close()
