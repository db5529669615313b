"""Picking is learnt: parameters as shipped bring fruit in soon, a run goes on where it was cut off, a file keeps it."""

from dataclasses import replace

import numpy as np
import pytest

from pickenv.agents import Training, load_policy, train, words_of
from pickenv.arm import load_arm
from pickenv.envs import PickVectorEnv

pytestmark = pytest.mark.slow

EASY = {"plant": "ideal", "vision": "ideal", "fruit": 4.0}
SHORT = {"n_envs": 4, "n_steps": 16, "batch_size": 32, "n_epochs": 1}


def test_a_short_training_picks_fruit(tmp_path):
    training = Training("ppo", "pickenv/Pick-v0", 24_576, seed=0, arguments=EASY, evaluate_every=10**6)
    trained = train(training, tmp_path)
    (row,) = trained.evaluations
    (unlearned,) = train(replace(training, steps=1), tmp_path / "unlearned").evaluations
    assert row["collected"] > unlearned["collected"] and row["reachable"] == unlearned["reachable"]
    assert words_of(row).endswith("reachable fruit per held-out canopy")
    again = load_policy(tmp_path / "policy.npz", load_arm("qiao2026"))
    envs = PickVectorEnv(2, **EASY)
    observations, _ = envs.reset(seed=1)
    np.testing.assert_allclose(again.act(observations), trained.policy.act(observations), atol=1e-6)
    np.testing.assert_array_equal(again.act(observations)[0], again.act(observations[0]))


def test_a_training_that_was_cut_off_ends_with_the_same_weights(tmp_path, monkeypatch):
    monkeypatch.setattr("pickenv.agents.training.training_setup.judge", lambda *_: {"collected": 0.0, "reachable": 1.0})
    given = {"arguments": EASY | {"arms": "per_episode"}, "parameters": SHORT, "checkpoint_every": 64}
    whole = train(Training("ppo", "pickenv/Pick-v0", 256, **given), tmp_path / "whole")

    def cut(*_):
        raise KeyboardInterrupt

    training = Training("ppo", "pickenv/Pick-v0", 256, evaluate_every=192, **given)
    with monkeypatch.context() as patch:
        patch.setattr("pickenv.agents.training.training_setup.judge", cut)
        with pytest.raises(KeyboardInterrupt):
            train(training, tmp_path / "cut")
    ended = train(training, tmp_path / "cut", resume=True)
    for one, other in zip(whole.policy.weights, ended.policy.weights, strict=True):
        np.testing.assert_array_equal(one, other)
