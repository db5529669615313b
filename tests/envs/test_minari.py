"""Minari records every environment, gives the environment back from its data set, and there replays the episodes."""

import gc
import warnings

import gymnasium as gym
import numpy as np
import pytest

EPISODES = {3: 4, 8: 6}
"""Seed and number of steps of each recorded episode."""
ARGUMENTS = {"pickenv/Reach-v0": {"plant": "orchard", "feedback": "camera", "arms": "per_episode"}}
IDS = sorted(name for name in gym.registry if name.startswith("pickenv/"))

# Minari leaves its temporary folders to the garbage collector.
pytestmark = pytest.mark.filterwarnings("ignore:Implicitly cleaning up:ResourceWarning")


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    yield
    gc.collect()  # while the mark above holds


def flat(value):
    """Numbers of an observation, or of one step's information."""
    values = [value[key] for key in sorted(value)] if isinstance(value, dict) else [value]
    return np.concatenate([np.asarray(part, dtype=float).ravel() for part in values])


@pytest.mark.parametrize("name", IDS)
def test_what_minari_recorded_is_what_the_recovered_environment_does(name):
    import minari

    arguments = ARGUMENTS.get(name, {})
    env = minari.DataCollector(gym.make(name, **arguments), record_infos=True)
    env.action_space.seed(0)
    seen = []
    for seed, steps in EPISODES.items():
        observation, info = env.reset(seed=seed)
        seen.append([(observation, None, info)])
        for _ in range(steps):
            observation, reward, _, _, info = env.step(env.action_space.sample())
            seen[-1].append((observation, reward, info))
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*is set to None.*")  # who wrote the data set, and from what code
        env.create_dataset(f"{name.lower().replace('-v0', '')}/random-v0")
    env.close()

    dataset = minari.load_dataset(f"{name.lower().replace('-v0', '')}/random-v0")
    assert dataset.total_episodes == len(EPISODES) and dataset.total_steps == sum(EPISODES.values())
    recovered = dataset.recover_environment()
    assert recovered.spec.id == name and recovered.spec.kwargs == arguments
    assert recovered.observation_space == dataset.observation_space
    for episode, (seed, steps), wanted in zip(dataset, EPISODES.items(), seen, strict=True):
        again = [(*recovered.reset(seed=seed), None)]
        for action in episode.actions:
            observation, reward, _, _, info = recovered.step(action)
            again.append((observation, info, reward))
        assert len(again) == steps + 1
        for i, (observation, info, reward) in enumerate(again):
            assert np.array_equal(flat(observation), flat(wanted[i][0]))
            assert np.array_equal(flat(info), flat(wanted[i][2]))
            assert reward == wanted[i][1]
            recorded = episode.observations
            step = {k: v[i] for k, v in recorded.items()} if isinstance(recorded, dict) else recorded[i]
            assert np.array_equal(flat(step), flat(observation))
            assert np.array_equal(flat({key: episode.infos[key][i] for key in info}), flat(info))
        assert episode.rewards.tolist() == [reward for *_, reward in again[1:]]
