"""Policies: the oracle leaves nothing, the servo converges, the adaptive policy gets better from pick to pick."""

import gymnasium as gym
import numpy as np
import pytest

import pickenv  # noqa: F401
from pickenv.agents import (
    AdaptiveReach,
    AdaptiveSettings,
    OracleReach,
    RandomReach,
    ScriptedReach,
    ServoReach,
    roll_out,
    run_reaches,
)
from pickenv.agents.evaluation.rollout import PerArm
from pickenv.base import InputError

CAMERA = {"feedback": "camera", "camera_noise_mm": 1.0, "fruit_noise_mm": 0.0}


def errors(make, arms=4, episodes=8, **arguments):
    return roll_out(lambda env, seed: make(env), arms, episodes, 5, **arguments).reaches.position_error_mm


@pytest.mark.parametrize("plant", ["geometry_only", "qiao2026"])
def test_the_oracle_leaves_nothing_of_what_the_joints_decide(plant):
    found = errors(OracleReach, plant=plant, tolerances="coarse", steps=40)
    assert np.percentile(found, 95) < 0.01
    assert found.mean() < 0.1 * errors(ScriptedReach, plant=plant, tolerances="coarse", steps=40).mean()


def test_the_servo_sees_away_what_the_arm_does_wrong():
    scripted = errors(ScriptedReach, plant="orchard", feedback="camera", tolerances="coarse")
    servo = errors(ServoReach, plant="orchard", feedback="camera", tolerances="coarse")
    assert servo.mean() < 0.1 < scripted.mean()


@pytest.mark.parametrize("gain", [0.1, 0.5, 1.0])
def test_a_gain_averages_noise_as_a_first_order_filter_does(gain):
    def make(env, seed):
        return ServoReach(env, gain=gain)

    found = roll_out(make, 4, 64, 5, plant="ideal:qiao2026", tolerances="fine", **CAMERA)
    rms = np.sqrt(np.mean(found.reaches.position_error_mm**2))
    assert rms == pytest.approx(np.sqrt(3 * gain / (2 - gain)), rel=0.15)


@pytest.mark.parametrize("delay", [1, 5, 10])
def test_late_pictures_do_not_upset_the_servo(delay):
    late = errors(lambda env: ServoReach(env, delay=delay), plant="qiao2026", feedback="camera")
    assert late.mean() < 0.1


def test_impossible_settings_are_refused():
    with gym.make("pickenv/Reach-v0") as env:
        for settings, message in (({"gain": 0.0}, "gain is 0.0"), ({"delay": -1}, "delay is -1")):
            with pytest.raises(InputError, match=message):
                ServoReach(env, **settings)


@pytest.mark.parametrize("policy", [ServoReach, AdaptiveReach])
def test_a_camera_is_asked_for(policy):
    with gym.make("pickenv/Reach-v0") as env:
        observation, _ = env.reset(seed=0)
        with pytest.raises(InputError, match="needs a camera; make the environment with feedback='camera'"):
            policy(env).act(observation)


def test_the_adaptive_policy_gets_better_from_pick_to_pick():
    settings = AdaptiveSettings(camera_std=1e-3)
    found = roll_out(
        lambda env, seed: AdaptiveReach(env, settings), 4, 16, 5, sequential=True, plant="geometry_only", steps=30,
        tolerances="coarse", **CAMERA,
    )  # fmt: skip
    by_pick = found.reaches.position_error_mm.reshape(16, 4).mean(axis=1)
    assert by_pick[8:].mean() < 0.5 * by_pick[0]


def test_policies_run_in_single_environments_too():
    with gym.make("pickenv/Reach-v0", plant="geometry_only", feedback="camera") as env:
        rng = np.random.default_rng(0)
        policies = (OracleReach(env), ServoReach(env), AdaptiveReach(env), RandomReach(env, rng))
        oracle, servo, adaptive, random = (
            run_reaches(env, policy, [1, 2]).position_error_mm.max() for policy in policies
        )
    assert oracle < 0.01 and servo < 0.1 and adaptive < 10 < random


def test_a_batch_acts_like_its_single_rows():
    envs = gym.make_vec("pickenv/Reach-v0", num_envs=3, feedback="camera")
    observations, _ = envs.reset(seed=3)
    for policy in (ScriptedReach, ServoReach, OracleReach):
        together = policy(envs).act(observations)
        for i in range(3):
            np.testing.assert_allclose(policy(envs).act(observations[i]), together[i], atol=1e-5)


def test_rows_go_to_the_compensators_of_their_arms():
    per_arm = PerArm((lambda joints: joints + 1.0, lambda joints: joints + 2.0), (1, 0, 1))
    assert per_arm(np.zeros((3, 6)))[:, 0].tolist() == [2.0, 1.0, 2.0]
    with pytest.raises(InputError, match="2 rows of joints were given to compensators of 3 rows"):
        per_arm(np.zeros((2, 6)))
