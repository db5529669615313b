"""Timing, sensing and starts of episodes: each argument does what its name says, alone and drawn, and nothing else."""

import math
import re

import gymnasium as gym
import numpy as np
import pytest

import pickenv  # noqa: F401, registers the environments
from pickenv.arm import forward, rotation_matrix
from pickenv.base import InputError
from pickenv.envs import PickEnv, ReachEnv, ReachVectorEnv

STEPS = 12


def trial(seed=3, **arguments):
    """Observations (STEPS + 1, k) and infos of an episode with the same random actions."""
    env = ReachEnv(**arguments)
    rng = np.random.default_rng(0)
    observation, info = env.reset(seed=seed)
    seen, infos = [observation], [info]
    for _ in range(STEPS):
        observation, _, _, _, info = env.step(rng.uniform(-1, 1, 6))
        seen.append(observation), infos.append(info)
    return np.array(seen), infos


def commands(infos):
    return np.array([info["joint_command"] for info in infos])


def among(lags, now, late):
    """Which lag explains a series that is late, with its first entry for what was not yet there."""
    index = np.arange(len(now))
    return [lag for lag in lags if np.array_equal(late, now[np.maximum(index - lag, 0)])]


@pytest.mark.parametrize("latency", [1, 3, [1, 4]], ids=str)
def test_readings_arrive_late_and_the_truth_does_not(latency):
    camera = {"feedback": "camera", "camera_noise_mm": 2.0, "plant": "orchard"}
    now, truth = trial(**camera)
    late, same = trial(latency=latency, **camera)
    lags = [latency] if isinstance(latency, int) else range(latency[0], latency[1] + 1)
    (lag,) = among(lags, now[:, :9], late[:, :9])
    assert among(range(5), now[:, 18:], late[:, 18:]) == [lag]
    for one, other in zip(truth, same, strict=True):
        np.testing.assert_array_equal(one["pose_error"], other["pose_error"])
        assert one["noncompensable_deg"] == other["noncompensable_deg"]


def test_every_lag_of_a_range_is_as_late_as_it_says():
    lags = [among(range(4), trial(seed)[0][:, :9], trial(seed, latency=[0, 2])[0][:, :9]) for seed in range(8)]
    assert {lag for (lag,) in lags} == {0, 1, 2}


@pytest.mark.parametrize("delay", [1, 4, [2, 3]], ids=str)
def test_actions_take_effect_late(delay):
    _, now = trial()
    _, late = trial(action_delay=delay)
    lags = [delay] if isinstance(delay, int) else delay
    assert among(lags, commands(now), commands(late))


def test_what_is_drawn_differs_between_episodes_and_covers_its_range():
    envs = gym.make_vec(
        "pickenv/Reach-v0",
        num_envs=400,
        latency=[0, 2],
        control_period_s=[0.05, 0.15],
        start_spread=1.0,
        hours_on=[1.0, 9.0],
    ).unwrapped
    envs.reset(seed=0)
    task, state = envs.task, envs.batch.state_of(envs.batch.columns)
    period, latency, hours = state.drawn
    counts = np.bincount(latency.astype(int), minlength=3)
    assert (counts > 90).all() and len(counts) == 3
    for values, low, high in ((period, 0.05, 0.15), (hours, 1.0, 9.0)):
        assert low <= values.min() < low + 0.03 * (high - low) and high - 0.03 * (high - low) < values.max() <= high
    shares = (np.array(state.target).T - task.lower) / (np.array(task.upper) - task.lower)
    assert 0 <= shares.min() < 0.02 and 0.98 < shares.max() <= 1
    assert np.abs(np.corrcoef(np.column_stack([period, latency, hours, shares]).T) - np.eye(9)).max() < 0.2


def test_an_increment_is_the_joints_speed_for_one_period():
    env = ReachEnv(control_period_s=[0.02, 0.4])
    for seed in range(4):
        _, before = env.reset(seed=seed)
        after = env.step(0.5 * np.ones(6))[4]
        moved = (after["joint_command"] - before["joint_command"]) / (0.5 * env.plant.arm.speed)
        np.testing.assert_allclose(moved, env._state.drawn[0], rtol=1e-9)
    np.testing.assert_allclose(env.increment, 0.4 * env.plant.arm.speed)


def test_joint_noise_is_as_large_as_asked_and_moves_nothing():
    found, rng = [], np.random.default_rng(0)
    both = [ReachVectorEnv(100, plant="ideal", joint_noise=size) for size in (2.0, 0.0)]
    for envs in both:
        envs.reset(seed=0)
    for _ in range(20):
        actions = rng.uniform(-1, 1, (100, 6))
        (noisy, *_, same), (quiet, *_, truth) = (envs.step(actions) for envs in both)
        np.testing.assert_array_equal(truth["joint_command"], same["joint_command"])
        free = np.abs(quiet[:, :6]).max(axis=1) < 0.9  # none is cut off at a limit
        found.append((noisy - quiet)[free, :6])
    task = both[0].task
    errors = np.concatenate(found) * (np.array(task.upper) - task.lower) / 2
    spread = 2e-3 / np.sqrt(len(errors))
    np.testing.assert_allclose(errors.std(axis=0), 2e-3, atol=4 * spread / np.sqrt(2))
    assert np.abs(errors.mean(axis=0)).max() < 4 * spread


def test_an_arm_that_has_been_on_is_where_hours_of_standing_bring_it():
    waited = ReachEnv(plant="orchard")
    waited.reset(seed=5)
    remembering = [effect.name for effect in waited.plant.effects if effect.remembers]
    state = waited.plant.carried(math, waited._state.plant, waited._state.target, 4 * 3600.0)
    env = ReachEnv(plant="orchard", hours_on=4.0)
    env.reset(seed=5)
    there, here, before = (
        dict(zip(remembering, memory, strict=True)) for memory in (env._state.plant, state, waited._state.plant)
    )
    for name in ("thermal_growth", "base_tilt"):
        np.testing.assert_allclose(there[name], here[name])
    assert abs(there["thermal_growth"][0] - before["thermal_growth"][0]) > 1.0


def test_goals_lie_in_their_region():
    anywhere = gym.make_vec("pickenv/Reach-v0", num_envs=200).reset(seed=0)[1]["fruit_position"]
    low, high = np.quantile(anywhere, [0.2, 0.7], axis=0).tolist()
    envs = gym.make_vec("pickenv/Reach-v0", num_envs=200, goal_region=[low, high])
    fruit = envs.reset(seed=0)[1]["fruit_position"]
    assert ((fruit >= low) & (fruit <= high)).all()
    assert (np.ptp(fruit, axis=0) > 0.9 * np.subtract(high, low)).all()


def test_a_goal_can_be_given_by_position_or_pose():
    env, several = ReachEnv(plant="ideal"), gym.make_vec("pickenv/Reach-v0", num_envs=3, plant="ideal")
    geometry = env.plant.arm.nominal
    joints = np.array(env.task.middle) + 0.1
    pose = forward(geometry, joints)
    _, info = env.reset(seed=0, options={"goal_position": pose.position})
    np.testing.assert_allclose(info["fruit_position"], pose.position, atol=1e-8)
    assert env._state.goal[8] >= np.cos(np.radians(30.0))
    places = pose.position + np.array([[0, 0, 0], [0.02, 0, 0], [0, 0.01, -0.02]])
    _, infos = several.reset(seed=0, options={"goal_position": places})
    np.testing.assert_allclose(infos["fruit_position"], places, atol=1e-8)
    turn = np.array([0.3, -0.2, 1.0])
    env.reset(seed=0, options={"goal_pose": [*pose.position, *turn]})
    np.testing.assert_allclose(np.reshape(env._state.goal[:9], (3, 3)).T, rotation_matrix(turn), atol=1e-12)
    np.testing.assert_array_equal(env._state.goal[9:], pose.position)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"goal_position": [9, 9, 9]}, "does not reach [9.0, 9.0, 9.0] m with its tool within 30 deg"),
        ({"goal_pose": [9, 9, 9, 0, 0, 0]}, "does not reach"),
        ({"goal_pose": [0, 0, 0]}, "has shape (3,); give (6,)"),
        ({"goal_position": "tree"}, "goal_position is 'tree'; give numbers"),
        ({"goal_position": [0, 0, np.nan]}, "is [0.0, 0.0, nan]; give finite numbers: x, y, z in m"),
        ({"goal_position": [0, 0, 1], "goal_joints": [0] * 6}, "both say where the goal is"),
    ],
)
def test_goals_that_cannot_be_are_refused(options, said):
    with pytest.raises(InputError, match=re.escape(said)) as refused:
        ReachEnv().reset(seed=0, options=options)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("name", "wrong"),
    [
        *(("control_period_s", wrong) for wrong in (0, -1, "fast", None, [0.1], [0.2, 0.1], [0.1, 0.2, 0.3], np.nan)),
        *(("latency", wrong) for wrong in (-1, 1.5, 21, [0.0, 1.0], True, [2, 1])),
        *(("action_delay", wrong) for wrong in (-1, 0.5, "late")),
        *(("joint_noise", wrong) for wrong in (-1, 1e9, [1, None])),
        *(("hours_on", wrong) for wrong in (-1, np.inf)),
        *(("start_spread", wrong) for wrong in (-0.1, 1.1, [0, 1], np.array([0.1, 0.5]))),
        *(("goal_region", wrong) for wrong in (3, [[0, 0, 0]], [[1, 1, 1], [0, 0, 0]], [["a"] * 3] * 2)),
    ],
    ids=str,
)
def test_impossible_situation_are_named(name, wrong):
    with pytest.raises(InputError, match=f"^{name} is .*; give ") as refused:
        ReachEnv(**{name: wrong})
    assert "\n" not in str(refused.value)


def test_a_region_that_no_goal_lies_in_is_refused():
    with pytest.raises(InputError, match=r"no pose in goal_region .* or move goal_region"):
        ReachEnv(goal_region=[[5, 5, 5], [6, 6, 6]]).reset(seed=0)


def test_fruit_is_picked_in_the_same_situations():
    """The true arm of Pick goes where that of a plain one goes, later; its readings come later still."""

    def picks(**arguments):
        env = gym.make("pickenv/Pick-v0", **arguments).unwrapped
        rng = np.random.default_rng(0)
        taken = [env.reset(seed=2)]
        taken += [env.step(rng.uniform(-1, 1, 7))[::4] for _ in range(8)]
        return np.array([seen[:9] for seen, _ in taken]), commands([info for _, info in taken]), env

    seen, sent, env = picks()
    later, as_sent, _ = picks(latency=2)
    assert among(range(4), seen, later) == [2] and np.array_equal(sent, as_sent)
    assert among(range(4), sent, picks(action_delay=3)[1]) == [3]
    noisy, as_sent, _ = picks(joint_noise=1.0)
    assert np.array_equal(sent, as_sent) and not np.array_equal(seen, noisy)
    _, _, warm = picks(hours_on=4.0, start_spread=0.5, control_period_s=[0.05, 0.2])
    rise = [effect.name for effect in env.plant.effects if effect.remembers].index("thermal_growth")
    assert warm._state.plant[rise][0] > env._state.plant[rise][0] + 1.0
    np.testing.assert_array_equal(warm.scene.rest, env.scene.rest)


@pytest.mark.parametrize(("given", "rate"), [(0.1, 10.0), (0.05, 20.0), ([0.05, 0.2], 5.0)])
def test_films_go_by_the_control_period_the_longest_of_a_range(given, rate):
    assert ReachEnv(control_period_s=given).metadata["render_fps"] == rate
    assert PickEnv(control_period_s=given).metadata["render_fps"] == rate
    several = ReachVectorEnv(2, control_period_s=given)
    assert several.metadata["render_fps"] == rate and several.metadata["render_modes"] == ["rgb_array"]
