"""Every registered environment keeps the rules of Gymnasium and Stable-Baselines3; any warning is an error."""

import copy
import doctest
import itertools
import pickle
import warnings
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils.env_checker import check_env
from gymnasium.utils.env_match import check_environments_match
from stable_baselines3.common.env_checker import check_env as check_env_for_sb3

import pickenv
import pickenv.envs.reaching.reach
import pickenv.envs.reaching.scaled
import pickenv.wrappers.compensation
from pickenv.base import InputError

PLANTS = Path(pickenv.__file__).parent / "arm/plant/plants"

IDS = sorted(name for name in gym.registry if name.startswith("pickenv/"))
VARIANTS = [
    {},
    {"plant": "geometry_only"},
    {"plant": "field"},
    {"feedback": "camera", "camera_noise_mm": 3.0},
    {"reward": "sparse", "tolerance_mm": 1.0, "without": ["boom_bending"]},
]

CAMERA = {"feedback": "camera", "camera_noise_mm": 2.0}
DRAWN = {
    "pickenv/Reach-v0": (CAMERA, lambda seen, info, _: {"seen": seen[9:], "fruit": info["fruit_position"]}),
    "pickenv/ReachGoal-v0": (
        CAMERA,
        lambda seen, info, _: {
            "goal": seen["desired_goal"],
            "camera": seen["achieved_goal"][:3],
            "fruit": info["fruit_position"],
        },
    ),
    "pickenv/ReachScaled-v0": (
        CAMERA,
        lambda seen, info, env: {"seen": seen[6:], "fruit": info["fruit_position"]},
    ),
    "pickenv/ReachTool-v0": (CAMERA, lambda seen, info, env: {"seen": seen, "fruit": info["fruit_position"]}),
    "pickenv/PickScene-v0": (
        {"camera_mm": 1.0},
        lambda seen, info, env: {
            "seen": seen[9:18],
            "fruit": info["fruit_position"],
            "pull": np.array([env.scene.strength]),
            "cameras": env.scene.model.cam_pos.flatten(),
        },
    ),
    "pickenv/ReachIdeal-v0": ({}, lambda seen, info, _: {"seen": seen[9:], "fruit": info["fruit_position"]}),
    "pickenv/Pick-v0": (
        {"fruit_size": "apple"},
        lambda _, info, env: {
            "place": env.scene.rest[:, 0],
            "seen": env.scene.seen.ravel(),
            "diameter": env.scene.diameters,
            "mass": env.scene.masses,
            "pull": env.scene.pull_limit,
            "twist": env.scene.twist_limit,
            "chance": env.scene.chance,
            "fruit": info["fruit_position"],
        },
    ),
    "pickenv/Harvest-v0": (
        {},
        lambda _seen, _info, env: {"seen": env.state.believed.ravel(), "fruit": env.state.fruit.ravel()},
    ),
}
"""For each environment, arguments and the numbers that a reset draws, from observation, information and environment."""

every_id = pytest.mark.parametrize("name", IDS)
every_native_id = pytest.mark.parametrize("name", [name for name in IDS if gym.spec(name).vector_entry_point])
every_variant = pytest.mark.parametrize("arguments", VARIANTS, ids=str)


@pytest.fixture(autouse=True)
def strict(monkeypatch):
    monkeypatch.setenv("MPLBACKEND", "agg")  # windows without a screen
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield


def rollout(env, seed, steps=30):
    env.action_space.seed(seed)
    taken = [env.reset(seed=seed)]
    for _ in range(steps):
        taken.append(env.step(env.action_space.sample()))
    return taken


def alike(one, other):
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(alike(one[key], other[key]) for key in one)
    if isinstance(one, tuple | list):
        return len(one) == len(other) and all(map(alike, one, other))
    return type(one) is type(other) and np.array_equal(one, other)


def arrays_in(value):
    if isinstance(value, np.ndarray):
        return [value]
    values = value.values() if isinstance(value, dict) else value if isinstance(value, tuple | list) else ()
    return [array for item in values for array in arrays_in(item)]


def test_reach_is_registered():
    assert "pickenv/Reach-v0" in IDS


@every_id
def test_gymnasiums_checker(name):
    check_env(gym.make(name).unwrapped)


@every_id
def test_stable_baselines3s_checker(name):
    check_env_for_sb3(gym.make(name).unwrapped)


@every_variant
def test_checkers_on_every_kind_of_reach(arguments):
    env = gym.make("pickenv/Reach-v0", **arguments).unwrapped
    check_env(env)
    check_env_for_sb3(env)


@every_id
def test_two_copies_agree_to_the_bit(name):
    assert alike(rollout(gym.make(name), 7), rollout(gym.make(name), 7))
    check_environments_match(gym.make(name), gym.make(name), num_steps=70, seed=3)


@every_id
def test_resets_chain_after_one_seed(name):
    one, other = gym.make(name), gym.make(name)
    first = [one.reset(seed=5), *(one.reset() for _ in range(4))]
    again = [other.reset(seed=5), *(other.reset() for _ in range(4))]
    assert alike(first, again)
    observations = [observation for observation, _ in first]
    assert not any(alike(a, b) for i, a in enumerate(observations) for b in observations[:i])


@every_id
def test_information_has_the_same_keys_after_reset_and_step(name):
    env = gym.make(name)
    _, after_reset = env.reset(seed=0)
    *_, after_step = env.step(env.action_space.sample())
    assert after_reset.keys() == after_step.keys()
    assert {k: type(v) for k, v in after_reset.items()} == {k: type(v) for k, v in after_step.items()}


@every_id
def test_nothing_returned_shares_memory(name):
    returned = [arrays_in(step) for step in rollout(gym.make(name), 1, 5)]
    flat = [array for arrays in returned for array in arrays]
    assert flat
    assert not any(np.shares_memory(a, b) for i, a in enumerate(flat) for b in flat[:i])


@every_id
def test_nothing_that_a_vector_returns_shares_memory(name):
    envs = gym.make_vec(name, num_envs=2)
    returned = [arrays_in(envs.reset(seed=0)), *(arrays_in(envs.step(envs.action_space.sample())) for _ in range(3))]
    for i, arrays in enumerate(returned):
        for other in returned[:i]:
            assert not any(np.shares_memory(a, b) for a in arrays for b in other)


@every_id
def test_other_seeds_change_every_number_that_is_drawn(name):
    arguments, drawn = DRAWN[name]
    env = gym.make(name, **arguments)
    fields = [drawn(*env.reset(seed=seed), env.unwrapped) for seed in range(8)]
    for one, other in itertools.combinations(fields, 2):
        for key, numbers in one.items():
            count = min(len(numbers), len(other[key]))
            assert count and (numbers[:count] != other[key][:count]).all(), key


@every_id
@pytest.mark.parametrize("size", [1.001, 7.0, 1e30])
def test_actions_out_of_range_are_cut_to_it_as_elsewhere(name, size):
    env, other = (gym.make(name).unwrapped for _ in range(2))
    action = np.where(np.arange(env.action_space.shape[0]) % 2, -size, size)
    for each in (env, other):
        each.reset(seed=0)
    assert alike(env.step(action), other.step(np.sign(action)))


@every_native_id
def test_native_environments_cut_actions_out_of_range_too(name):
    envs, others = (gym.make_vec(name, num_envs=2) for _ in range(2))
    actions = np.where(np.indices(envs.action_space.shape).sum(axis=0) % 2, -7.0, 1.5)
    for each in (envs, others):
        each.reset(seed=0)
    assert alike(envs.step(actions), others.step(np.sign(actions)))


@every_native_id
@pytest.mark.parametrize("wrong", [np.nan, np.inf, 1.001], ids=str)
def test_native_environments_refuse_impossible_actions(name, wrong):
    envs = gym.make_vec(name, num_envs=3, out_of_range="refuse")
    envs.reset(seed=0)
    actions = np.zeros(envs.action_space.shape)
    actions[1, 2] = wrong
    with pytest.raises(InputError, match=r"finite numbers.* between -1 and 1"):
        envs.step(actions)


@every_id
@pytest.mark.parametrize("wrong", [np.nan, np.inf, 1.001, -7.0, "shape"], ids=str)
def test_impossible_actions_are_refused_in_one_sentence(name, wrong):
    env = gym.make(name, out_of_range="refuse").unwrapped
    action = np.zeros(env.action_space.shape)
    with pytest.raises(InputError, match="call reset first"):
        env.step(action)
    env.reset(seed=0)
    if wrong == "shape":
        action = action[:-1]
    else:
        action[1] = wrong
    before = copy.deepcopy(env)
    with pytest.raises(InputError, match="finite numbers") as refused:
        env.step(action)
    assert "between -1 and 1" in str(refused.value)
    assert alike(env.step(np.zeros(env.action_space.shape)), before.step(np.zeros(env.action_space.shape)))


@every_native_id
@pytest.mark.parametrize("count", [0, -3])
def test_no_environments_make_no_vector(name, count):
    with pytest.raises(InputError, match=str(count)) as refused:
        gym.make_vec(name, num_envs=count)
    assert len(str(refused.value).splitlines()) == 1


@every_id
def test_unknown_options_are_refused(name):
    with pytest.raises(InputError, match=r"unknown .*option 'gaol'"):
        gym.make(name).reset(options={"gaol": 1})


@every_native_id
def test_masks_of_the_wrong_length_or_kind_are_refused(name):
    envs = gym.make_vec(name, num_envs=2)
    envs.reset(seed=0)
    for mask in (np.ones(3, bool), np.zeros(2, bool), np.ones(2)):
        with pytest.raises(InputError, match="reset_mask") as refused:
            envs.reset(options={"reset_mask": mask})
        assert "2 truth values" in str(refused.value)


@pytest.mark.parametrize("name", [name for name in IDS if "Harvest" not in name])
def test_unknown_and_impossible_plants_are_refused_in_one_sentence(name, tmp_path):
    with pytest.raises(InputError, match="unknown plant 'peach'"):
        gym.make(name, plant="peach")
    file = tmp_path / "soft.toml"
    file.write_text((PLANTS / "qiao2026.toml").read_text(encoding="utf-8").replace("1.4e4,", "-1.4e4,"), "utf-8")
    with pytest.raises(InputError, match="above zero") as refused:
        gym.make(name, plant=str(file))
    assert all(word in str(refused.value) for word in (str(file), "stiffness", "[joint_compliance]"))


@every_id
def test_observations_stay_in_the_space_and_rewards_are_floats(name):
    env = gym.make(name)
    for step in rollout(env, 2, 59)[1:]:
        observation, reward, terminated, truncated, _ = step
        assert env.observation_space.contains(observation)
        assert type(reward) is float and type(terminated) is bool and type(truncated) is bool


@every_id
def test_the_specification_survives_json_pickle_and_copy(name):
    env = gym.make(name)
    again = gym.make(EnvSpec.from_json(env.spec.to_json()))
    assert alike(rollout(env, 4), rollout(again, 4))
    env.reset(seed=9)
    env.step(env.action_space.sample())
    for twin in (pickle.loads(pickle.dumps(env)), copy.deepcopy(env)):
        assert twin is not env
        action = env.action_space.sample()
        assert alike(copy.deepcopy(env).step(action), twin.step(action))


@every_variant
def test_arguments_survive_json(arguments):
    env = gym.make("pickenv/Reach-v0", **arguments)
    again = gym.make(EnvSpec.from_json(env.spec.to_json()))
    assert again.spec.kwargs == arguments
    assert alike(rollout(env, 4), rollout(again, 4))


@pytest.mark.parametrize("name", [name for name in IDS if "Harvest" not in name and "Ideal" not in name])
def test_a_plant_by_path_stands_in_the_specification(name):
    """Where paths are taken, `pathlib.Path` is one, and what it makes can be written down and made again."""
    plant = PLANTS / "qiao2026.toml"
    env = gym.make(name, plant=plant)
    again = gym.make(EnvSpec.from_json(env.spec.to_json()))
    assert again.spec.kwargs == {"plant": str(plant)}
    assert alike(env.reset(seed=1), again.reset(seed=1))
    if gym.spec(name).vector_entry_point:
        assert str(plant) in gym.make_vec(name, num_envs=2, plant=plant).spec.to_json()


FILES = [
    ("pickenv/Reach-v0", "tolerances", "arm/plant/tolerance_classes/coarse.toml", {"arms": "per_episode"}),
    ("pickenv/Pick-v0", "gripper", "orchard/presets/gripper.toml", {}),
    ("pickenv/Pick-v0", "canopy", "orchard/presets/canopy.toml", {}),
    ("pickenv/Harvest-v0", "canopy", "orchard/presets/canopy.toml", {"vision": "ideal"}),
]
"""Environments, their arguments that may be files, and files with a table, or several, of that kind."""


@pytest.mark.parametrize(("name", "argument", "file", "others"), FILES, ids=str)
def test_other_files_by_path_stand_in_it_too(name, argument, file, others, tmp_path):
    text = (Path(pickenv.__file__).parent / file).read_text(encoding="utf-8")
    if "presets" in file:  # the first table, without its head
        text = text.split("\n[")[1].partition("]\n")[2]
    path = tmp_path / "mine.toml"
    path.write_text(text, encoding="utf-8")
    env = gym.make(name, **{argument: path}, **others)
    again = gym.make(EnvSpec.from_json(env.spec.to_json()))
    assert alike(env.reset(seed=1), again.reset(seed=1))


MODULES = [pickenv.envs.reaching.reach, pickenv.envs.reaching.scaled, pickenv.wrappers.compensation]


@pytest.mark.parametrize("module", MODULES)
def test_examples_in_docstrings_run(module):
    result = doctest.testmod(module)
    assert result.attempted > 0 and result.failed == 0


@pytest.mark.parametrize("make", [gym.make, gym.make_vec])
@pytest.mark.parametrize("given", [{"plant": "qiao2026"}, {"arms": "per_episode"}], ids=str)
def test_the_ideal_task_takes_no_arm_with_errors(make, given):
    with pytest.raises(InputError, match="have errors; take pickenv/Reach-v0"):
        make("pickenv/ReachIdeal-v0", **given)
    make("pickenv/ReachIdeal-v0", plant="ideal:ur5e").close()
