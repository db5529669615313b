"""What the tests of the agents share."""

import warnings
from pathlib import Path

import pytest

from pickenv.agents import Training, train


@pytest.fixture
def short():
    """``short(algorithm, **changes)``: a training of seconds."""

    def build(algorithm: str = "ppo", **changes) -> Training:
        goal = algorithm != "ppo"
        parameters = {"n_envs": 4, "learning_starts": 90, "gradient_steps": 1} if goal else {"n_envs": 8}
        arguments = {"plant": "geometry_only", "feedback": "camera"} | ({"max_episode_steps": 20} if goal else {})
        options = {"steps": 160 if goal else 960, "arguments": arguments, "parameters": parameters}
        options |= {"env_id": "pickenv/ReachGoal-v0" if goal else "pickenv/Reach-v0"}
        return Training(algorithm, **(options | changes))

    return build


@pytest.fixture(scope="session")
def trained(tmp_path_factory) -> Path:
    """The folder of a short training of PPO without a camera."""
    out = tmp_path_factory.mktemp("trained")
    arguments = {"plant": "geometry_only"}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        train(Training("ppo", steps=480, arguments=arguments, parameters={"n_envs": 8}), out)
    return out


@pytest.fixture(autouse=True)
def _quiet():
    """stable-baselines3 warns of things that we mean."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", module="stable_baselines3")
        warnings.filterwarnings("ignore", module="torch.utils.tensorboard")
        yield
