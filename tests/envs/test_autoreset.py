"""Every registered environment as a vector does what its environments do alone, whatever their number and the mode.

Episodes end at different times, by termination and by truncation; masks reset environments that have not ended, too.
"""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

EARLY = {"end_on_success": True, "tolerance_mm": 400.0, "angle_tolerance_deg": 100.0, "arms": "per_episode"}
"""A capture region so large that random actions reach it, at different times."""
ARGUMENTS = {
    "pickenv/Reach-v0": {**EARLY, "plant": "orchard", "feedback": "camera", "camera_noise_mm": 3.0},
    "pickenv/ReachGoal-v0": EARLY,
    "pickenv/ReachScaled-v0": {**EARLY, "plant": "orchard"},
    "pickenv/ReachTool-v0": {**EARLY, "tolerance_mm": 80.0, "plant": "orchard", "latency": 1},
    "pickenv/ReachIdeal-v0": {key: EARLY[key] for key in list(EARLY)[:3]},
    "pickenv/Pick-v0": {"arms": "per_episode", "population": 8, "camera": "perfect"},
    "pickenv/Harvest-v0": {"fruit": 1},
}
IDS = sorted(ARGUMENTS)
"""Every environment that has a native vector."""
OPTIONS = {"pickenv/Pick-v0": {"fruit": [[0.6, -0.767, 0.549]]}}
"""A fruit beside the tool, so that the first grasp misses and is the last."""
LONGEST, STEPS = 6, 15
ONLY_TRUNCATED = ("pickenv/Harvest-v0",)
"""Random actions do not pick all its fruit in so short a time."""


def test_every_native_vector_is_tried():
    assert sorted(n for n in gym.registry if n.startswith("pickenv/") and gym.spec(n).vector_entry_point) == IDS


def vector(name, count, mode):
    arguments = {"max_episode_steps": LONGEST, **ARGUMENTS[name]}
    executor = {"executor": "numpy"} if "Reach" in name else {}
    return gym.make_vec(name, num_envs=count, autoreset_mode=mode, **executor, **arguments)


def alone(name):
    """Arms give the same bits only where they calculate with the same library."""
    executor = {} if "Harvest" in name else {"executor": "numpy"}
    return gym.make(name, max_episode_steps=LONGEST, disable_env_checker=True, **executor, **ARGUMENTS[name])


def row(batch, i):
    return {key: values[i] for key, values in batch.items()} if isinstance(batch, dict) else batch[i]


def assert_same(one, other):
    if isinstance(one, dict):
        assert one.keys() == other.keys()
        for key in one:
            assert_same(one[key], other[key])
    else:
        np.testing.assert_array_equal(one, other)


def assert_information(infos, i, info):
    for key, value in info.items():
        assert infos[f"_{key}"][i]
        np.testing.assert_array_equal(infos[key][i], value, err_msg=key)


@pytest.mark.parametrize(
    "count",
    [
        1,
        3,
        pytest.param(7, marks=pytest.mark.slow),
        pytest.param(2, marks=pytest.mark.thorough),
        pytest.param(64, marks=pytest.mark.thorough),
    ],
)
@pytest.mark.parametrize("mode", list(AutoresetMode), ids=str)
@pytest.mark.parametrize("name", IDS)
def test_a_vector_is_its_environments_alone(name, mode, count):
    envs, singles = vector(name, count, mode), [alone(name) for _ in range(count)]
    options, rng = OPTIONS.get(name), np.random.default_rng(count)
    observations, infos = envs.reset(seed=11, options=options)
    for i, env in enumerate(singles):
        observation, info = env.reset(seed=11 + i, options=options)
        assert_same(row(observations, i), observation)
        assert_information(infos, i, info)
    envs.action_space.seed(0)
    over, ends = np.zeros(count, bool), set()
    for step in range(STEPS):
        masked = over | (rng.random(count) < 0.15)
        if mode is AutoresetMode.DISABLED and masked.any():
            observations, infos = envs.reset(options={"reset_mask": masked.copy()})
            for i in np.flatnonzero(masked):
                observation, info = singles[i].reset()
                assert_same(row(observations, i), observation)
                assert_information(infos, i, info)
        actions = envs.action_space.sample()
        actions[:, :6] *= 0.3  # near the first fruit for some steps
        observations, rewards, terminations, truncations, infos = envs.step(actions)
        for i, env in enumerate(singles):
            if mode is AutoresetMode.NEXT_STEP and over[i]:
                (observation, info), reward, ended = env.reset(), 0.0, (False, False)
            else:
                observation, reward, *ended, info = env.step(actions[i])
                ends |= {(step, kind) for kind, so in zip(("terminated", "truncated"), ended, strict=True) if so}
                if mode is AutoresetMode.SAME_STEP and any(ended):
                    assert_same(row(infos["final_obs"], i), observation)
                    assert_information(infos["final_info"], i, info)
                    observation, info = env.reset()
            assert_same(row(observations, i), observation)
            assert_information(infos, i, info)
            assert rewards[i] == reward
            assert (terminations[i], truncations[i]) == tuple(ended)
        over = terminations | truncations
    kinds = {kind for _, kind in ends}
    assert "truncated" in kinds
    if count > 2 and name not in ONLY_TRUNCATED:
        assert "terminated" in kinds and len({when for when, _ in ends}) > 3
