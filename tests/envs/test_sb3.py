"""The native environments under Stable-Baselines3."""

import gymnasium as gym
import numpy as np
import pytest
from stable_baselines3 import PPO, SAC, HerReplayBuffer
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.vec_env import VecMonitor

from pickenv import InputError
from pickenv.wrappers import CompensationVectorWrapper
from pickenv.wrappers.sb3 import Sb3Vec, make_sb3_vec

EARLY = {"end_on_success": True, "tolerance_mm": 400.0, "angle_tolerance_deg": 100.0, "max_episode_steps": 9}


@pytest.mark.parametrize("name", ["Reach", "ReachGoal"])
def test_both_autoreset_modes_give_the_same_stream(name):
    one, other = (
        make_sb3_vec(f"pickenv/{name}-v0", 5, autoreset_mode=mode, **EARLY) for mode in ("SameStep", "Disabled")
    )
    for envs in (one, other):
        envs.seed(3)
    np.testing.assert_equal(one.reset(), other.reset())
    one.action_space.seed(0)
    ends = 0
    for _ in range(30):
        actions = np.stack([one.action_space.sample() for _ in range(5)])
        a, b = one.step(actions), other.step(actions)
        np.testing.assert_equal(a, b)
        ends += a[2].sum()
        for i in np.flatnonzero(a[2]):
            assert "terminal_observation" in a[3][i]
    assert ends > 5


def test_the_last_step_tells_how_it_ended():
    envs = make_sb3_vec("pickenv/Reach-v0", 2, max_episode_steps=2)
    envs.reset()
    envs.step(np.zeros((2, 6)))
    _, rewards, dones, infos = envs.step(np.zeros((2, 6)))
    assert rewards.dtype == np.float32 and dones.all()
    assert infos[0]["TimeLimit.truncated"] and infos[0]["position_error_mm"] > 0


def test_rewards_are_computed_anew_for_exchanged_goals():
    envs = make_sb3_vec("pickenv/ReachGoal-v0", 2)
    envs.reset()
    goals = np.zeros((4, 3), np.float32)
    (rewards,) = envs.env_method("compute_reward", goals, goals + 1, [{}] * 4, indices=[0])
    assert rewards.tolist() == [-1.0] * 4
    assert envs.get_attr("num_envs", 1) == [2]


def test_ppo_trains_and_is_watched():
    envs = VecMonitor(make_sb3_vec("pickenv/Reach-v0", 8))
    model = PPO("MlpPolicy", envs, n_steps=32, batch_size=64, n_epochs=1, seed=0).learn(1024)
    assert len(model.ep_info_buffer) > 0
    mean, _ = evaluate_policy(model, envs, 8)
    assert np.isfinite(mean)


def test_two_runs_train_the_same_policy():
    def weights():
        envs = make_sb3_vec("pickenv/Reach-v0", 4)
        model = PPO("MlpPolicy", envs, n_steps=16, batch_size=32, n_epochs=1, seed=7).learn(128)
        return np.concatenate([p.detach().numpy().ravel() for p in model.policy.parameters()])

    np.testing.assert_array_equal(weights(), weights())


def test_sac_with_hindsight_trains():
    envs = VecMonitor(make_sb3_vec("pickenv/ReachGoal-v0", 4, tolerance_mm=50.0, max_episode_steps=10))
    model = SAC(
        "MultiInputPolicy", envs, replay_buffer_class=HerReplayBuffer, learning_starts=60, batch_size=32, seed=0
    )
    model.learn(120)
    assert model.num_timesteps >= 120


def test_a_compensator_is_put_between(compensator):
    envs = make_sb3_vec("pickenv/Reach-v0", 2, compensator=compensator)
    assert envs.env_is_wrapped(CompensationVectorWrapper) == [True, True]


def test_next_step_mode_is_refused():
    with pytest.raises(InputError, match="SameStep"):
        Sb3Vec(gym.make_vec("pickenv/Reach-v0", num_envs=2))
