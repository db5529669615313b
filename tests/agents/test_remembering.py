"""Policies with a memory: the task they learn on, their files, and what they do outside of it."""

import json

import gymnasium as gym
import numpy as np
import pytest
from sb3_contrib import RecurrentPPO

from pickenv.agents import (
    RememberingReach,
    Training,
    actor_of,
    foreign_policy,
    load_policy,
    load_remembering,
    make_model,
    train,
)
from pickenv.agents.evaluation.contenders import kind_of, maker_of
from pickenv.agents.policies.adaptive import remembers
from pickenv.agents.training.training import read_checkpoint
from pickenv.arm import load_arm
from pickenv.base import InputError
from pickenv.envs import ReachVectorEnv
from pickenv.wrappers import MOST_SEEN, SEEN_MM, PickMemory, SameArm, SameArmVector, make_sb3_vec

ARMS = {"feedback": "camera", "camera_noise_mm": 0.5, "fruit_noise_mm": 0.0, "arms": "per_episode", "population": 6}
FEW = {"n_envs": 4, "n_steps": 20, "batch_size": 40, "n_epochs": 1}


def vector(rows: int, **wrapped) -> SameArmVector:
    return SameArmVector(gym.make_vec("pickenv/Reach-v0", num_envs=rows, executor="numpy", **ARMS), **wrapped)


def small(algorithm: str, **changes) -> Training:
    return Training(algorithm, seed=1, parameters=FEW, arguments={"population": 6}, **changes)


def test_a_memory_of_several_layers_is_refused_as_a_file_holds_one() -> None:
    kwargs = {"n_lstm_layers": 2, "shared_lstm": True, "enable_critic_lstm": False}
    with pytest.raises(InputError, match="n_lstm_layers is 2; give 1"):
        make_model(Training("ppo_lstm", parameters=FEW | {"policy_kwargs": kwargs}))


@pytest.mark.parametrize("window", [1, 3])
def test_a_run_is_the_same_alone_and_beside_others(window: int) -> None:
    envs, rng = vector(3, picks=4, window=window, looks=2), np.random.default_rng(0)
    alone = SameArm(gym.make("pickenv/Reach-v0", executor="numpy", **ARMS), picks=4, window=window, looks=2)
    seen, infos = envs.reset(seed=5)
    one, info = alone.reset(seed=7)  # the third one's
    assert envs.observation_space.contains(seen) and alone.observation_space.contains(one)
    for _ in range(2):
        for pick in range(4):
            np.testing.assert_array_equal(seen[2], one)
            assert infos["arm"][2] == info["arm"] and infos["pick"][2] == info["pick"] == pick
            actions = rng.uniform(-1, 1, (3, 3))
            seen, rewards, _, ended, infos = envs.step(actions)
            one, reward, _, cut, info = alone.step(actions[2])
            last = infos["final_info"] if ended.all() else infos
            assert rewards[2] == reward and type(reward) is float and ended[2] == cut == (pick == 3)
            assert last["position_error_mm"][2] == info["position_error_mm"]
        np.testing.assert_array_equal(infos["final_obs"][2], one)
        one, info = alone.reset()


def test_what_was_seen_is_the_arms_own_error_wherever_it_aims() -> None:
    envs = vector(4, looks=10)
    errors = []
    for aim in (0.0, 1.0):
        envs.reset(seed=3)
        seen, *_, infos = envs.step(np.full((4, 3), aim))
        errors.append(np.linalg.norm(seen[:, 12:15], axis=1) * SEEN_MM)
        missed = infos["position_error_mm"]
    np.testing.assert_allclose(errors[0], errors[1], atol=0.1)
    assert (missed > 8.0).all() and (errors[0] < 8.0).all()  # aimed 14 mm beside the fruit
    envs.reset(seed=3)
    *_, infos = envs.step(np.zeros((4, 3)))
    np.testing.assert_allclose(errors[0], infos["position_error_mm"], atol=0.6)
    aims = -seen[:, 12:15] * SEEN_MM / envs.run.memory.reach_mm
    envs.reset(seed=3)
    *_, infos = envs.step(aims)  # back by what was seen: noise is left, and what a step of the Jacobian leaves
    assert (infos["position_error_mm"] < 0.6).all()


def test_the_reward_is_of_what_the_camera_measured_and_probing_it_finds_no_more() -> None:
    """Two true tools that look alike are paid alike; the true reward would tell them apart to the micrometre."""
    paid: dict[str, list[np.ndarray]] = {"measured": [], "true": []}
    for reward, rewards in paid.items():
        envs = vector(64, looks=1, reward=reward)
        for seed in (3, 400):  # other pictures; arm, fruit and aim are the same
            envs.reset(seed=seed, options={"arm": np.zeros(64, dtype=int)})
            envs.run.joints[:] = envs.run.geometry.lower + 0.4 * (envs.run.geometry.upper - envs.run.geometry.lower)
            seen, reward_now, *_ = envs.step(np.zeros((64, 3)))
            rewards.append(reward_now)
            if reward == "measured":
                gap = np.linalg.norm(seen[:, 12:15], axis=1) * SEEN_MM  # aimed at the fruit: error and gap are alike
                turn = reward_now + np.log10(1.0 + gap)
                assert np.ptp(turn) < 1e-3, "nothing but the picture tells the rewards apart"
    assert np.std(paid["measured"][0]) > 0.05 and np.std(paid["true"]) < 1e-3


def test_impossible_runs_end_with_one_sentence() -> None:
    blind = gym.make("pickenv/Reach-v0")
    for env, given, said in (
        (blind, {}, "needs a camera"),
        (gym.make("pickenv/ReachGoal-v0"), {}, "works on flat reach environments"),
        (gym.make("pickenv/ReachTool-v0", feedback="camera"), {}, "works on flat reach environments"),
        (gym.make("pickenv/Reach-v0", feedback="camera"), {"looks": 60}, "looks is 60; give at most 59"),
        (gym.make("pickenv/Reach-v0", feedback="camera"), {"picks": 0}, "picks is 0"),
        (gym.make("pickenv/Reach-v0", feedback="camera"), {"reward": "x"}, "reward is 'x'; give one of measured, true"),
    ):
        with pytest.raises(InputError, match=said):
            SameArm(env, **given)
    with pytest.raises(InputError, match="native"):
        SameArmVector(gym.make_vec("pickenv/Reach-v0", num_envs=1, vectorization_mode="sync"))
    with pytest.raises(InputError, match="native"):
        SameArmVector(gym.make_vec("pickenv/ReachScaled-v0", num_envs=1, feedback="camera"))
    short = gym.make_vec("pickenv/Reach-v0", num_envs=2, max_episode_steps=10, feedback="camera")
    with pytest.raises(InputError, match="looks is 10, but episodes end after 10 steps"):
        SameArmVector(short, looks=10)
    envs = vector(2)
    envs.reset(seed=0)
    with pytest.raises(InputError, match="give 2 times 3 finite numbers"):
        envs.step(np.zeros((2, 6)))


@pytest.mark.parametrize("algorithm", ["ppo_lstm", "ppo_history"])
def test_a_file_acts_as_the_model_did_and_is_refused_when_it_does_not_fit(algorithm: str, tmp_path) -> None:
    model, env = make_model(small(algorithm))
    path = actor_of(model, small(algorithm), env).save(tmp_path / "policy")
    policy = load_remembering(path, env.envs.unwrapped.task.plant.arm)
    seen, state, kept, begun = env.reset(), policy.begin(4), None, np.ones(4, dtype=bool)
    for _ in range(22):
        if begun.all():
            state = policy.begin(4)
        expected, kept = model.predict(seen, kept, begun, deterministic=True)
        actions, state = policy.aim(seen, state)
        np.testing.assert_allclose(actions, expected, atol=1e-5)
        seen, _, begun, _ = env.step(expected)
    assert remembers(path) and not remembers("ppo_camera")
    assert kind_of(str(path)).sequential and kind_of(str(path)).feedback == ("camera",)
    assert json.dumps(dict(policy.record))
    with pytest.raises(InputError, match="not for 'ur5'"):
        load_remembering(path, load_arm("ur5"))
    with pytest.raises(InputError, match="holds a policy with a memory, not a policy"):
        load_policy(path)
    with pytest.raises(InputError, match="but was given 5"):
        policy.aim(np.zeros((1, 5)), policy.begin(1))


def test_outside_it_sees_what_it_saw_on_the_task(tmp_path) -> None:
    """Reaching through `pickenv/Reach-v0` itself, tokens fill with each arm's own errors."""
    training = small("ppo_history")
    model, made = make_model(training)
    path = actor_of(model, training, made).save(tmp_path / "policy")
    env = ReachVectorEnv(3, max_episode_steps=None, autoreset_mode="Disabled", **ARMS)
    policy = maker_of(str(path))(env, 0)
    assert isinstance(policy, RememberingReach)
    arms = np.arange(3)
    for fruit in range(2):
        seen, _ = env.reset(seed=10 * fruit, options={"arm": arms})
        policy.reset()
        for _ in range(30):
            seen, *_ = env.step(policy.act(seen))
    policy.reset()
    tokens = policy._tokens
    assert (tokens[:, :2, -1] == 1).all() and (tokens[:, 2:] == 0).all()
    geometry = env.task.plant.arm.nominal
    for row in range(3):
        joints = geometry.lower + (tokens[row, 0, :6] + 1) / 2 * (geometry.upper - geometry.lower)
        alone = ReachVectorEnv(1, max_episode_steps=None, **ARMS)
        _, last = alone.reset(options={"arm": [row], "start_joints": joints, "goal_joints": joints})
        error = np.linalg.norm(tokens[row, 0, 6:9]) * SEEN_MM
        assert error == pytest.approx(last["position_error_mm"][0], abs=0.5)
    assert np.abs(tokens).max() < MOST_SEEN


@pytest.mark.slow
@pytest.mark.parametrize("algorithm", ["ppo_lstm", "ppo_history"])
def test_a_training_goes_on_as_if_it_had_never_stopped(algorithm: str, tmp_path) -> None:
    whole = train(small(algorithm, steps=240, checkpoint_every=80), tmp_path / "whole")
    half = small(algorithm, steps=240, checkpoint_every=80)
    train(small(algorithm, steps=160, checkpoint_every=80), tmp_path / "half")
    *_, state = read_checkpoint(tmp_path / "half" / "checkpoint.pt")
    assert bool(state["memory"]) == (algorithm == "ppo_lstm")
    with pytest.raises(InputError, match="another training"):
        train(half, tmp_path / "half", resume=True)
    assert whole.evaluations[-1].keys() == {"steps", "mean_mm", "p95_mm", "success_rate"}


def test_a_strangers_recurrent_model_remembers_within_an_episode(tmp_path) -> None:
    scaled = make_sb3_vec("pickenv/ReachScaled-v0", 2)
    model = RecurrentPPO("MlpLstmPolicy", scaled, n_steps=8, batch_size=16, n_epochs=1, seed=0, device="cpu")
    model.save(tmp_path / "mine.zip")
    bare = ReachVectorEnv(2)
    policy = foreign_policy(tmp_path / "mine.zip", bare, 0)
    for seed in (5, 6):
        seen, raw = scaled.envs.reset(seed=seed)[0], bare.reset(seed=seed)[0]
        policy.reset()
        state, begun = None, np.ones(2, dtype=bool)
        for _ in range(5):
            action, state = model.predict(seen, state, begun, deterministic=True)
            begun[:] = False
            seen, *_, inside = scaled.envs.step(action)
            raw, *_, outside = bare.step(policy.act(raw))
            np.testing.assert_array_equal(inside["position_error_mm"], outside["position_error_mm"])


def test_an_observation_is_bounded_as_what_it_holds_is():
    """Joints are scaled to their ranges, seen errors are clipped, and the mark of a pick is 0 or 1."""
    memory = PickMemory(joints=2, window=2)
    seen = memory.after(memory.empty(1), np.array([[1.0, -1.0]]), np.array([[1.0, -1.0, 1.0]]))
    shown = memory.shown(np.array([[-1.0, 1.0]]), seen)[0]
    assert memory.space().contains(shown)
    assert memory.space().high.tolist() == [1, 1] + 2 * [1, 1, MOST_SEEN, MOST_SEEN, MOST_SEEN, 1]
    assert not memory.space().contains(1.01 * shown)
