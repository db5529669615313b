"""The shipped parameters under RL Zoo: every file, every environment, as it lies there."""

import importlib
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from pkgutil import resolve_name

import gymnasium as gym
import numpy as np
import pytest
from sb3_contrib import TQC, RecurrentPPO
from stable_baselines3 import PPO, SAC, HerReplayBuffer
from stable_baselines3.common.env_util import make_vec_env

import pickenv  # noqa: F401
from pickenv.agents import foreign_policy, tuned
from pickenv.envs import ReachVectorEnv
from pickenv.wrappers import make_sb3_vec

ROOT = Path(__file__).parents[2]
ALGORITHMS = {"ppo": PPO, "sac": SAC, "tqc": TQC, "ppo_lstm": RecurrentPPO, "ppo_history": PPO}
FILES = sorted(path.stem for path in (ROOT / "pickenv" / "zoo" / "hyperparams").glob("[a-z]*.py"))
PARAMETERS = {name: importlib.import_module(f"pickenv.zoo.hyperparams.{name}").hyperparams for name in FILES}
ENTRIES = [(name, env_id) for name in FILES for env_id in PARAMETERS[name]]
FEW = {"n_envs": 4, "n_steps": 16, "batch_size": 32, "n_epochs": 1}
SHORT = {"ppo": FEW, "ppo_lstm": FEW, "ppo_history": FEW}
EARLY = {"n_envs": 2, "learning_starts": 130, "batch_size": 16, "gradient_steps": 1}


def test_every_file_has_parameters_for_every_environment_that_it_can_learn() -> None:
    flat = {"pickenv/Reach-v0", "pickenv/ReachIdeal-v0", "pickenv/ReachScaled-v0"}
    found = {name: {env_id for each, env_id in ENTRIES if each == name} for name in FILES}
    goals, run = {*flat, "pickenv/ReachGoal-v0"}, {"pickenv/Reach-v0"}
    picks = {*flat, "pickenv/ReachTool-v0", "pickenv/Pick-v0"}
    assert found == {"ppo": picks, "sac": goals, "tqc": goals, "ppo_lstm": run, "ppo_history": run}


@pytest.mark.parametrize(("name", "env_id"), ENTRIES)
def test_parameters_start_a_training_in_single_environments(name: str, env_id: str) -> None:
    """As RL Zoo makes it: wrapper and policy by name, environments one by one, plain classes of the algorithms."""
    given = tuned(name, env_id) | SHORT.get(name, EARLY)
    wrapper, arguments = given.pop("env_wrapper", None), given.pop("env_kwargs", {})
    given.pop("n_timesteps")
    if "population" in arguments:
        arguments["population"] = 8  # of which each environment draws its own
    ((wrapper, settings),) = wrapper.items() if isinstance(wrapper, dict) else [(wrapper, {})]
    kind = wrapper and resolve_name(wrapper)
    envs = make_vec_env(
        env_id, given.pop("n_envs"), wrapper_class=kind, wrapper_kwargs=settings, env_kwargs=arguments, seed=0
    )
    if "replay_buffer_class" in given:
        assert given["replay_buffer_class"] == "HerReplayBuffer"
        given["replay_buffer_class"] = HerReplayBuffer
    policy = given.pop("policy")
    model = ALGORITHMS[name](resolve_name(policy) if "." in policy else policy, envs, seed=0, device="cpu", **given)
    before = [value.clone() for value in model.policy.parameters()]
    model.learn(140)
    after = [value.detach() for value in model.policy.parameters()]
    assert any(not np.array_equal(one.detach(), other) for one, other in zip(before, after, strict=True))
    numbers = envs.action_space.shape if wrapper else gym.spec(env_id).make().action_space.shape
    action, _ = model.predict(envs.reset(), deterministic=True)
    assert action.shape == (envs.num_envs, *numbers) and np.isfinite(action).all()


@pytest.mark.slow
@pytest.mark.parametrize(("name", "env_id"), [("ppo", "pickenv/Reach-v0"), ("sac", "pickenv/ReachGoal-v0")])
def test_rl_zoo_itself_reads_them(name: str, env_id: str, tmp_path: Path) -> None:
    if find_spec("rl_zoo3") is None:  # not imported here: it changes Gymnasium's time limit for the whole process
        pytest.skip("rl_zoo3 is not installed")
    command = [sys.executable, "-W", "ignore", "-m", "rl_zoo3.train", "--algo", name, "--env", env_id]
    options = ["--gym-packages", "pickenv", "--conf-file", f"pickenv.zoo.hyperparams.{name}", "-f", str(tmp_path)]
    short = ["--n-timesteps", "4000", "--eval-freq", "-1", "--device", "cpu", "--seed", "0"]
    done = subprocess.run([*command, *options, *short], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert list(tmp_path.rglob(f"{env_id.replace('/', '-')}.zip"))


def test_a_saved_model_of_the_scaled_task_acts_outside_as_it_does_inside(tmp_path: Path) -> None:
    """To the bit, from the zip alone, on the environments that policies are compared in."""
    scaled = make_sb3_vec("pickenv/ReachScaled-v0", 3)
    model = PPO("MlpPolicy", scaled, n_steps=8, batch_size=24, n_epochs=1, seed=0, device="cpu")
    model.save(tmp_path / "mine.zip")
    bare = ReachVectorEnv(3)
    policy = foreign_policy(tmp_path / "mine.zip", bare, 0)
    seen, raw = scaled.envs.reset(seed=5)[0], bare.reset(seed=5)[0]
    for _ in range(10):
        action, _ = model.predict(seen, deterministic=True)
        seen, _, _, _, inside = scaled.envs.step(action)
        raw, _, _, _, outside = bare.step(policy.act(raw))
        np.testing.assert_array_equal(inside["position_error_mm"], outside["position_error_mm"])
