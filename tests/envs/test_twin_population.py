"""A calibrated arm's plant in the environments: its arms are the population, alike alone, side by side and on torch."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import SyncVectorEnv

from pickenv.arm import draw_plants, load_arm, load_plant, load_tolerances, plant_at, write_twin
from pickenv.calibration import GravityTerm, PeriodicTerm, twin
from tests.calibration.twins import found_by_hand, learnt_by_hand

QIAO = load_arm("qiao2026")


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    """The file of a twin with terms, a residual and an uncertain tool."""
    rng = np.random.default_rng(0)
    terms = (GravityTerm((0, 3), (0.0, 0.0, 1.0)), PeriodicTerm((0,), (2.0,)))
    found = found_by_hand(
        QIAO, rng, terms=terms, learnt=learnt_by_hand(QIAO, rng), parameters=("base_rz", "a2", "tool_y"),
        covariance=np.diag([1e-4, 1e-4, 2e-4]) ** 2, dropped={"alpha1": {"tool_y": 0.2}},
    )  # fmt: skip
    return str(write_twin(twin(found, QIAO), tmp_path_factory.mktemp("twin") / "my_arm.npz"))


@pytest.mark.parametrize("arms", ["fixed", "per_env", "per_episode"])
def test_native_and_single_environments_are_equal_to_the_bit(path, arms):
    arguments = {"plant": path, "arms": arms, "executor": "numpy"} | ({} if arms == "fixed" else {"population": 9})
    single = SyncVectorEnv([lambda: gym.make("pickenv/Reach-v0", **arguments) for _ in range(5)])
    native = gym.make_vec("pickenv/Reach-v0", num_envs=5, **arguments)
    np.testing.assert_array_equal(single.reset(seed=3)[0], native.reset(seed=3)[0])
    native.action_space.seed(0)
    for _ in range(4):
        action = native.action_space.sample()
        one, other = single.step(action), native.step(action)
        np.testing.assert_array_equal(one[0], other[0])
        np.testing.assert_array_equal(one[1], other[1])
        np.testing.assert_array_equal(one[4]["pose_error"], other[4]["pose_error"])


@pytest.mark.parametrize("arms", ["fixed", "per_episode"])
def test_torch_agrees_within_nanometres(path, arms):
    arguments = {"plant": path, "arms": arms} | ({} if arms == "fixed" else {"population": 9})
    seen = []
    for executor in ({"executor": "numpy"}, {"executor": "torch", "compiled": False}):
        envs = gym.make_vec("pickenv/Reach-v0", num_envs=6, **executor, **arguments)
        envs.reset(seed=1)
        for step in range(3):
            *_, infos = envs.step(np.full((6, 6), 0.1 * step, dtype=np.float32))
        seen.append(np.asarray(infos["position_error_mm"], dtype=float))
    np.testing.assert_allclose(seen[1], seen[0], rtol=0, atol=2e-6)


@pytest.mark.slow
def test_a_compiled_step_agrees_too(path):
    seen = []
    for executor in ({"executor": "numpy"}, {"executor": "torch", "compiled": True}):
        envs = gym.make_vec("pickenv/Reach-v0", num_envs=6, plant=path, arms="per_episode", population=9, **executor)
        envs.reset(seed=1)
        *_, infos = envs.step(np.full((6, 6), 0.1, dtype=np.float32))
        seen.append(np.asarray(infos["position_error_mm"], dtype=float))
    np.testing.assert_allclose(seen[1], seen[0], rtol=0, atol=2e-6)


def test_an_episode_s_arm_is_the_one_of_that_number(path):
    env = gym.make("pickenv/Reach-v0", plant=path, arms="per_episode", population=6, population_seed=4)
    arms = draw_plants(load_plant(path), load_tolerances("medium"), 6, np.random.default_rng(4))
    joints = np.array(env.unwrapped.task.middle)
    apart = set()
    for number in range(6):
        _, info = env.reset(seed=0, options={"arm": number, "goal_joints": joints})
        wanted = plant_at(arms, number).tool_pose(joints).position
        np.testing.assert_allclose(info["tool_position"], wanted, rtol=0, atol=1e-9)
        apart.add(round(info["position_error_mm"], 9))
    assert len(apart) == 6


def test_effects_of_a_twin_can_be_switched_off(path):
    bare = gym.make("pickenv/Reach-v0", plant=path, without=["residual", "gravity_yield", "transmission_error"])
    known = bare.unwrapped.plant
    assert not {"residual", "gravity_yield", "transmission_error"} & set(known.names)


@pytest.mark.parametrize("name", ["Reach-v0", "ReachGoal-v0", "Pick-v0"])
def test_every_environment_of_one_arm_takes_it(path, name):
    env = gym.make(f"pickenv/{name}", plant=path)
    env.reset(seed=0)
    observation, *_ = env.step(env.action_space.sample())
    assert env.observation_space.contains(observation)
