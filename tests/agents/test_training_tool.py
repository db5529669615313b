"""Moving the tool is learnt by the command line too: `pickenv train` on `pickenv/ReachTool-v0`, then `evaluate`."""

import json
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from typer.testing import CliRunner

from pickenv.agents import Training, episode_seeds, load_policy, make_model, maker_of, roll_out, train
from pickenv.base import InputError
from pickenv.cli import app
from pickenv.envs import ReachToolVectorEnv, ReachVectorEnv

NAME, UR5E = "pickenv/ReachTool-v0", {"plant": "ideal:ur5e"}


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a training of UR5e by the command line, too short to come near."""
    folder = tmp_path_factory.mktemp("tool") / "ur5e"
    words = ["train", "--env", NAME, "--plant", "ideal:ur5e", "--steps", "3840", "--out", str(folder)]
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 0 and done.output.startswith(f"ppo on {NAME}: "), done.output
    return folder


def test_evaluate_judges_it_on_the_task_that_it_was_trained_on(out: Path, tmp_path: Path) -> None:
    file, figures = str(out / "policy.npz"), tmp_path / "rows.json"
    few = ["--plant", "ideal:ur5e", "--compensation", "raw", "--compensation", "ls", "--arms", "2", "--episodes", "3"]
    done = CliRunner().invoke(app, ["evaluate", "--policy", file, *few, "--json", str(figures)])
    assert done.exit_code == 0, done.output
    rows = json.loads(figures.read_text(encoding="utf-8"))["rows"]
    assert {(row["compensation"], row["feedback"]) for row in rows} == {("raw", "encoders"), ("ls", "encoders")}
    world = UR5E | {"tolerances": "coarse", "population_seed": 5}
    ended = roll_out(maker_of(file), 2, 3, 7, **world)
    envs = ReachToolVectorEnv(6, autoreset_mode="Disabled", arms="per_episode", population=2, **world)
    observations, infos = envs.reset(seed=list(episode_seeds(7, 6)), options={"arm": np.tile([0, 1], 3)})
    policy = load_policy(file)
    for _ in range(60):
        observations, _, _, _, infos = envs.step(policy.act(observations))
    np.testing.assert_array_equal(ended.reaches.position_error_mm, infos["position_error_mm"])
    mixed = CliRunner().invoke(app, ["evaluate", "--policy", file, "--policy", "scripted", *few])
    assert isinstance(mixed.exception, InputError) and "compare them by themselves" in str(mixed.exception)


def test_its_file_acts_as_the_model_does_and_in_no_other_environment(tmp_path: Path) -> None:
    training = Training("ppo", NAME, 480, arguments=UR5E, parameters={"n_envs": 8})
    policy = train(training, tmp_path).policy
    model, _ = make_model(training)
    model.learn(480)
    observations = np.random.default_rng(0).uniform(-1.0, 1.0, (5, 7)).astype(np.float32)
    acted = load_policy(tmp_path / "policy.npz").act(observations)
    np.testing.assert_allclose(acted, model.predict(observations, deterministic=True)[0], atol=1e-6)
    np.testing.assert_array_equal(acted, policy.act(observations))
    with pytest.raises(InputError, match="observations of 7 numbers, but the environment gives 18"):
        policy.act(ReachVectorEnv(2, **UR5E).reset(seed=0)[0])
    with pytest.raises(InputError, match=r"trained for arm 'ur5e', not for 'ur5'"):
        maker_of(str(tmp_path / "policy.npz"))(gym.make(NAME, plant="ideal:ur5"), 0)


def test_a_training_that_was_cut_off_ends_with_the_same_weights(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    training = Training("ppo", NAME, 960, arguments=UR5E, parameters={"n_envs": 8}, checkpoint_every=480)
    whole = train(training, tmp_path / "whole").policy
    with monkeypatch.context() as patch:
        patch.setattr("pickenv.agents.training.training_setup.judge", lambda *_: pytest.fail("cut"))
        with pytest.raises(pytest.fail.Exception):
            train(training, tmp_path / "cut")
    again = train(training, tmp_path / "cut", resume=True).policy
    for one, other in zip((*whole.weights, *whole.biases), (*again.weights, *again.biases), strict=True):
        np.testing.assert_array_equal(one, other)


def test_what_its_actions_were_is_what_they_are_when_it_is_judged(tmp_path: Path) -> None:
    arguments = {"plant": "ideal:so101", "actions": "position", "tool_step_mm": 10.0, "goal_spread": 0.1}
    train(Training("ppo", NAME, 480, arguments=arguments, parameters={"n_envs": 8}), tmp_path / "so101")
    file = str(tmp_path / "so101" / "policy.npz")
    ended = roll_out(maker_of(file), 1, 4, 0, plant="ideal:so101")
    envs = ReachToolVectorEnv(4, autoreset_mode="Disabled", arms="per_episode", population=1, **arguments)
    observations, infos = envs.reset(seed=list(episode_seeds(0, 4)), options={"arm": np.zeros(4, dtype=int)})
    for _ in range(60):
        observations, _, _, _, infos = envs.step(load_policy(file).act(observations))
    np.testing.assert_array_equal(ended.reaches.position_error_mm, infos["position_error_mm"])
