"""The script's numbers do what they say, alone and in a vector; learning starts at the script, and gains."""

import gymnasium as gym
import numpy as np
import pytest

from pickenv.agents import HASTY, ScriptedPick, pick_canopies
from pickenv.base import seed_words, stream
from pickenv.envs import PickVectorEnv
from scripts.studies.policy_search import KNOBS, arguments_of, search

ONE = {"fruit": np.array([[0.6, -0.72, 0.6]])}
EXACT = {"plant": "ideal", "camera": "perfect"}
LATE = {"latency": 1, "action_delay": 1}
FEW = {"candidates": 8, "canopies": 1}


def ways(steps, policy=None, **arguments):
    """Observations of one fruit's episode, ``(steps + 1, k)``, and the last information."""
    env = gym.make("pickenv/Pick-v0", **(EXACT | arguments))
    driver = ScriptedPick(env, **(policy or {}))
    seen = [env.reset(seed=0, options=ONE)[0]]
    for _ in range(steps):
        observation, _, over, _, info = env.step(driver.act(seen[-1]))
        seen.append(observation)
        if over:
            break
    return np.array(seen), info


def test_a_vector_of_scripts_acts_as_each_of_them_alone():
    each = [{}, HASTY, {"settle": 0.2, "gain": 0.4, "aim": (0.0, 0.01, 0.0), "approach": 0.08, "arrived": 1e-3}]
    usual = {"settle": 0.5, "approach": 0.1, "tool_speed": 0.3, "gain": 1.0, "arrived": 2e-4, "aim": (0.0, 0.0, 0.0)}
    envs = PickVectorEnv(len(each), **EXACT)
    many = ScriptedPick(envs, **{name: [one.get(name, usual[name]) for one in each] for name in usual})
    alone = [ScriptedPick(envs, **one) for one in each]
    (seen, _), held = envs.reset(seed=0, options=ONE), np.zeros(len(each), dtype=np.bool_)
    for _ in range(24):
        actions = many.act(seen)
        apart = [one.act(row) for one, row in zip(alone, seen, strict=True)]
        np.testing.assert_allclose(actions, apart, atol=1e-4)
        seen, *_ = envs.step(actions)
        held |= seen[:, 20] > 0.5
    assert held.any()


@pytest.mark.parametrize("late", [{}, LATE, {"latency": 3}, {"action_delay": [0, 4]}], ids=str)
def test_the_script_takes_a_fruit_however_late_readings_and_actions_are(late):
    _, info = ways(60, **late)
    assert (info["attempted"], info["collected"]) == (1, 1)


def test_the_tool_stops_as_far_beside_the_fruit_as_it_aims():
    aim = np.array([0.004, -0.003, 0.002])
    seen, _ = ways(30, {"aim": aim, "settle": 1.0})
    stands = seen[5:][seen[5:, 18] > 0.3]
    np.testing.assert_allclose(stands[0, 12:15], -aim, atol=3e-4)


def test_who_has_no_patience_closes_on_the_way():
    (_, calm), (_, rash) = (ways(12, {"patience": patience}) for patience in (40.0, 0.6))
    assert calm["attempted"] == 0 and rash["attempted"] == 1


def test_the_search_begins_at_the_script_and_stays_within_bounds():
    given = arguments_of(np.zeros((2, len(KNOBS))))
    envs = PickVectorEnv(2, **EXACT)
    script, start = ScriptedPick(envs), ScriptedPick(envs, **given)
    seen, _ = envs.reset(seed=1)
    for _ in range(5):
        np.testing.assert_allclose(script.act(seen), start.act(seen), atol=1e-6)
        seen, *_ = envs.step(script.act(seen))
    far = arguments_of(np.random.default_rng(0).normal(scale=50.0, size=(200, len(KNOBS))))
    for name, knob in KNOBS.items():
        values = far["aim"][:, "xyz".index(name[-1])] if name.startswith("aim") else far[name]
        assert knob.low == values.min() and values.max() == knob.high


def test_a_seed_finds_the_same_whatever_others_search_beside_it():
    short = {"fruit": 3.0, "max_episode_steps": 12}
    both, one = search(short, (4, 5), 2, **FEW), search(short, (5,), 2, **FEW)
    assert both.learnt.shape == (2, len(KNOBS)) and not both.means[0].any()
    for name in ("steps", "means"):
        np.testing.assert_array_equal(getattr(both, name)[:, 1:], getattr(one, name))
    assert not np.array_equal(both.means[-1, 0], both.means[-1, 1])
    assert both.steps[-1].max() <= 2 * 8 * 12


@pytest.mark.slow
def test_learning_gains_on_its_training_canopies():
    """Where there is little time, and waiting costs fruit."""
    haste = {"max_episode_steps": 100}
    found = search(haste, (0,), 8, candidates=32, canopies=2)
    points = np.repeat([np.zeros(len(KNOBS)), found.learnt[0]], 8, axis=0)
    canopies = [word for number in range(4) for word in seed_words(stream(0, "training", number), 2)]
    envs = PickVectorEnv(16, **haste)
    script, learnt = pick_canopies(ScriptedPick(envs, **arguments_of(points)), envs, canopies * 2)["reward"].reshape(
        2, 8
    )
    assert (learnt - script).mean() > 0.25
    assert arguments_of(found.learnt)["settle"] < 0.5
