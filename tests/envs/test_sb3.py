"""The native environments under Stable-Baselines3."""

import gymnasium as gym
import numpy as np
import pytest
from stable_baselines3 import PPO, SAC, HerReplayBuffer
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.vec_env import VecMonitor

from pickenv import InputError
from pickenv.base import seed_words, stream
from pickenv.wrappers import (
    CompensationVectorWrapper,
    GapScaling,
    GapScalingVector,
    SameArmVector,
    Sb3Vec,
    Scaling,
    make_sb3_vec,
)

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


def test_seeds_of_environments_are_those_of_the_trainings_stream_and_else_fresh_ones():
    """So that no training meets an episode of an evaluation, whose stream of the same seed is another."""
    envs = make_sb3_vec("pickenv/Reach-v0", 3)
    assert envs.seed(4) == seed_words(stream(4, "training"), 3)
    drawn = [*envs.seed(), *envs.seed()]
    assert len(set(drawn)) == 6 and not set(drawn) & set(envs.seed(4))


@pytest.mark.parametrize("tolerance_mm", [1e5, 1e-3])
def test_an_episode_that_reached_its_end_in_its_last_step_was_not_cut(tolerance_mm):
    """Its value goes on being bootstrapped only where the time limit alone ended it."""
    limits = {"end_on_success": True, "angle_tolerance_deg": 200.0, "tolerance_mm": tolerance_mm}
    envs = make_sb3_vec("pickenv/Reach-v0", 2, max_episode_steps=1, **limits)
    envs.reset()
    _, _, dones, infos = envs.step(np.zeros((2, 6)))
    reached = tolerance_mm > 1
    assert dones.all() and [info["TimeLimit.truncated"] for info in infos] == [not reached] * 2
    assert [info["is_success"] for info in infos] == [reached] * 2


def test_the_last_step_tells_every_number_of_the_bare_environments_last_info():
    """And nothing else than these, the last observation, whether it was cut, and the sums of the episode."""
    options = {"max_episode_steps": 2, "autoreset_mode": "SameStep"}
    envs, bare = make_sb3_vec("pickenv/Reach-v0", 3, **options), gym.make_vec("pickenv/Reach-v0", num_envs=3, **options)
    envs.seed(1)
    bare.reset(seed=envs.seed(1))
    envs.reset()
    action = np.full((3, 6), 0.2, dtype=np.float32)
    for _ in range(2):
        infos, given = envs.step(action)[3], bare.step(action)[4]
    final = given["final_info"]
    numbers = {key for key in final if not key.startswith("_") and np.ndim(final[key]) == 1}
    assert "is_success" in numbers and "joint_command" not in numbers
    for i, info in enumerate(infos):
        assert set(info) == numbers | {"terminal_observation", "TimeLimit.truncated", "episode"}
        np.testing.assert_equal({key: info[key] for key in numbers}, {key: final[key][i] for key in numbers})
        np.testing.assert_array_equal(info["terminal_observation"], given["final_obs"][i])
        assert type(info["episode"]["l"]) is int and type(info["episode"]["r"]) is float


def test_a_single_environment_takes_options_too():
    envs = make_sb3_vec("pickenv/Reach-v0", 1)
    envs.set_options({"start_joints": envs.envs.unwrapped.task.lower})
    assert envs.reset()[:, :6] == pytest.approx(-1.0)


def test_a_reset_forgets_the_sums_of_what_it_breaks_off():
    envs = make_sb3_vec("pickenv/Reach-v0", 2, max_episode_steps=2)
    envs.reset()
    envs.step(np.zeros((2, 6)))
    envs.reset()
    first = envs.step(np.zeros((2, 6)))[1]
    _, second, _, infos = envs.step(np.zeros((2, 6)))
    assert [info["episode"]["l"] for info in infos] == [2, 2]
    assert [info["episode"]["r"] for info in infos] == pytest.approx(first + second, abs=1e-5)


def test_options_are_passed_on_once_and_must_be_the_same_for_all():
    envs = make_sb3_vec("pickenv/Reach-v0", 2)
    middle = envs.reset()[:, :6]
    start = envs.envs.unwrapped.task.lower
    envs.set_options({"start_joints": start})
    assert envs.reset()[:, :6] == pytest.approx(-1.0)
    np.testing.assert_array_equal(envs.reset()[:, :6], middle)
    envs.set_options([{"start_joints": start}, {}])
    with pytest.raises(InputError, match="give all the same"):
        envs.reset()


def test_what_belongs_to_all_environments_is_read_and_set_for_all():
    envs = make_sb3_vec("pickenv/Reach-v0", 3, max_episode_steps=7)
    assert envs.get_attr("max_episode_steps") == [7, 7, 7] and envs.get_attr("max_episode_steps", [0, 2]) == [7, 7]
    envs.set_attr("max_episode_steps", 1)
    envs.reset()
    assert envs.step(np.zeros((3, 6)))[2].all()
    with pytest.raises(InputError, match="set it for all"):
        envs.set_attr("max_episode_steps", 2, [0, 1])
    assert envs.env_is_wrapped(CompensationVectorWrapper, [1]) == [False]
    assert envs.get_images() == [None, None, None]
    drawn = make_sb3_vec("pickenv/Reach-v0", 2, render_mode="rgb_array")
    drawn.reset()
    assert [picture.shape[-1] for picture in drawn.get_images()] == [3, 3]


def test_the_last_step_sums_up_its_episode():
    envs = make_sb3_vec("pickenv/Reach-v0", 3, **EARLY)
    envs.seed(3)
    envs.reset()
    envs.action_space.seed(0)
    sums, lengths, ends = np.zeros(3), np.zeros(3), 0
    for _ in range(40):
        _, rewards, dones, infos = envs.step(np.stack([envs.action_space.sample() for _ in range(3)]))
        sums, lengths = sums + rewards, lengths + 1
        for i in range(3):
            assert ("episode" in infos[i]) == dones[i]
            if dones[i]:
                assert set(infos[i]["episode"]) == {"r", "l", "t"} and infos[i]["episode"]["t"] == 0.0
                assert infos[i]["episode"]["r"] == pytest.approx(sums[i], abs=1e-5)
                assert infos[i]["episode"]["l"] == lengths[i]
        ends += dones.sum()
        sums, lengths = np.where(dones, 0.0, sums), np.where(dones, 0.0, lengths)
    assert ends > 5


def remembering():
    """A wrapper with a memory of its own, whose runs of picks begin anew in the step that ends them."""
    envs = gym.make_vec("pickenv/Reach-v0", num_envs=4, feedback="camera", arms="per_episode", population=20)
    return Sb3Vec(SameArmVector(envs, picks=5, window=2, looks=1))


@pytest.mark.parametrize("name", ["Reach", "ReachGoal", "ReachScaled", "ReachTool", None])
def test_a_stream_goes_on_from_its_state(name):
    def made():
        return remembering() if name is None else make_sb3_vec(f"pickenv/{name}-v0", 4, **EARLY)

    one, other = made(), made()
    one.seed(1)
    one.reset()
    actions = np.random.default_rng(0).uniform(-1, 1, (30, 4, *one.action_space.shape)).astype(np.float32)
    for action in actions[:7]:
        one.step(action)
    state = one.state()
    assert all(value.dtype.kind in "bfiu" for value in state.values())  # a file of plain arrays can hold it
    other.take_state(state)
    np.testing.assert_equal(other.seen, one.seen)
    for action in actions:
        np.testing.assert_equal(one.step(action), other.step(action))


def test_a_scaling_stands_between_policy_and_environments():
    """What is shown, done and given back at the end of episodes is what the formulas make of the bare environments."""
    bare = gym.make_vec("pickenv/Reach-v0", num_envs=2, autoreset_mode="SameStep", **EARLY)
    one, other = Sb3Vec(bare), make_sb3_vec("pickenv/ReachScaled-v0", 2, **EARLY)
    scaling = Scaling(6)
    for envs in (one, other):
        envs.seed(0)
    raw = one.reset()
    np.testing.assert_array_equal(scaling.shown(raw), other.reset())
    action, ends = np.full((2, 6), 0.4), 0
    for turn in range(12):
        beyond = [1.0, 3.0, -7.0][turn % 3]  # as a network without bounds may act
        a, b = one.step(scaling.act(raw, beyond * action)), other.step(beyond * action)
        raw = a[0]
        np.testing.assert_array_equal(scaling.shown(raw), b[0])
        np.testing.assert_array_equal(a[1], b[1])
        for plain, shown in zip(a[3], b[3], strict=True):
            if plain:
                np.testing.assert_array_equal(
                    scaling.shown(plain["terminal_observation"]), shown["terminal_observation"]
                )
                ends += 1
    assert ends > 0


def test_scaled_environments_are_the_same_alone_and_together():
    """To the bit, whatever is done: alone, wrapped by hand, one after the other and native."""
    alone = gym.make("pickenv/ReachScaled-v0", executor="numpy", feedback="camera", camera_noise_mm=1.0)
    wrapped = GapScaling(gym.make("pickenv/Reach-v0", executor="numpy", feedback="camera", camera_noise_mm=1.0))
    native = gym.make_vec("pickenv/ReachScaled-v0", num_envs=3, feedback="camera", camera_noise_mm=1.0)
    seen = [alone.reset(seed=4)[0], wrapped.reset(seed=4)[0], native.reset(seed=4)[0][0]]
    rng = np.random.default_rng(0)
    for _ in range(20):
        assert alone.observation_space.contains(seen[0])
        assert np.array_equal(seen[0], seen[1]) and np.array_equal(seen[0], seen[2])
        action = rng.normal(size=6).astype(np.float32)
        seen = [alone.step(action)[0], wrapped.step(action)[0], native.step(np.stack([action] * 3))[0][0]]
    with pytest.raises(InputError, match="executor='numpy'"):
        GapScalingVector(gym.make_vec("pickenv/Reach-v0", num_envs=2, executor="torch", compiled=False))


def test_rewards_are_computed_anew_for_exchanged_goals():
    envs = make_sb3_vec("pickenv/ReachGoal-v0", 2)
    envs.reset()
    goals = np.zeros((4, 9), np.float32)
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
    model.learn(80)
    assert model.num_timesteps >= 80


def test_a_compensator_is_put_between(compensator):
    envs = make_sb3_vec("pickenv/Reach-v0", 2, compensator=compensator)
    assert envs.env_is_wrapped(CompensationVectorWrapper) == [True, True]


def test_next_step_mode_is_refused():
    with pytest.raises(InputError, match="SameStep"):
        Sb3Vec(gym.make_vec("pickenv/Reach-v0", num_envs=2))


@pytest.mark.parametrize("mode", ["SameStep", "Disabled"])
def test_an_environment_without_a_native_vector_works_too(mode):
    pytest.importorskip("mujoco")
    envs = make_sb3_vec("pickenv/PickScene-v0", 2, autoreset_mode=mode, max_episode_steps=1)
    envs.reset()
    *_, dones, infos = envs.step(np.zeros((2, 7)))
    assert dones.all() and infos[0]["terminal_observation"].shape == (20,)
