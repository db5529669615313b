"""Every arm that is shipped, or comes as a file, is an environment with default arguments."""

import warnings
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import pickenv  # noqa: F401  # registers the environments
from pickenv.arm import shipped_arms
from pickenv.envs import make_task

KINDS = ("ideal", "coarse")


@pytest.mark.parametrize("arm", shipped_arms())
@pytest.mark.parametrize("kind", KINDS)
def test_every_shipped_arm_runs_with_default_arguments(kind: str, arm: str) -> None:
    env = gym.make("pickenv/Reach-v0", plant=f"{kind}:{arm}")
    with warnings.catch_warnings():
        warnings.filterwarnings("error")
        check_env(env.unwrapped, skip_render_check=True)
    for seed in range(5):
        observation, info = env.reset(seed=seed)
        assert env.observation_space.contains(observation)
        assert gym.make(env.spec).reset(seed=seed)[1]["position_error_mm"] == info["position_error_mm"]


@pytest.mark.parametrize("plant", ["ideal:panda", "coarse:ur5e", "medium:li2016_master"])
def test_native_and_single_environments_are_equal_to_the_bit(plant: str) -> None:
    many = gym.make_vec("pickenv/Reach-v0", num_envs=3, plant=plant, executor="numpy")
    singles = [gym.make("pickenv/Reach-v0", plant=plant, executor="numpy") for _ in range(3)]
    seen = many.reset(seed=4)[0]
    for i, env in enumerate(singles):
        np.testing.assert_array_equal(env.reset(seed=4 + i)[0], seen[i])
    many.action_space.seed(0)
    for _ in range(10):
        actions = many.action_space.sample()
        found = many.step(actions)
        for i, env in enumerate(singles):
            observation, reward, *_ = env.step(actions[i])
            np.testing.assert_array_equal(observation, found[0][i])
            assert reward == found[1][i]
    many.close()


def true_arm(**arguments: object) -> np.ndarray:
    plant = gym.make("pickenv/Reach-v0", **arguments).unwrapped.task.plant
    return np.concatenate([np.ravel(plant.geometry.alpha), np.ravel(plant.effect("joint_compliance").stiffness)])


def test_the_seed_of_the_population_draws_the_arm() -> None:
    """And the first of a population is the arm that is drawn alone."""
    first = true_arm(plant="coarse:ur5e")
    np.testing.assert_array_equal(first, true_arm(plant="coarse:ur5e", population_seed=0))
    assert (first[:6] != true_arm(plant="coarse:ur5e", population_seed=1)[:6]).all()
    task = gym.make("pickenv/Reach-v0", plant="coarse:ur5e", arms="per_env", population=3).unwrapped.task
    np.testing.assert_array_equal(task.plant.geometry.alpha[0], first[:6])


@pytest.mark.parametrize(("arm", "tilt"), [("qiao2026", 30.0), ("ur5", 30.0), ("li2016_master", 120.0)])
def test_goals_point_upwards_as_far_as_the_arm_can(arm: str, tilt: float) -> None:
    assert np.degrees(np.arccos(make_task(f"ideal:{arm}").min_upright)) == pytest.approx(tilt, abs=1e-6)


def test_files_of_ones_own_are_environments(data_folder: Path) -> None:
    for file in ("so101_new_calib.urdf#gripper_frame_link", "so101_new_calib.xml"):
        path = data_folder / "so101" / file
        if not Path(str(path).partition("#")[0]).is_file():
            pytest.skip(f"no {path}")
        env = gym.make("pickenv/Reach-v0", plant=f"coarse:{path}")
        assert env.reset(seed=0)[1]["position_error_mm"] > 0 and env.action_space.shape == (5,)
