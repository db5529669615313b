"""Policy files: loaded without executing code, and refused where they do not fit."""

import io
import json
import re
from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest

import pickenv  # noqa: F401
from pickenv.agents import BASELINES, load_policy, shipped_baselines
from pickenv.agents.evaluation.contenders import load_any
from pickenv.agents.policies.learned import FORMAT
from pickenv.arm import load_arm
from pickenv.base import InputError, read_container, seal, write_container
from pickenv.experiments import PolicySettings, evaluation_rows, run_policies
from pickenv.wrappers import GapScaling, Scaling


@pytest.fixture
def policy(trained):
    return load_policy(trained / "policy.npz")


def test_a_policy_acts_on_one_observation_as_on_many(policy):
    envs = gym.make_vec("pickenv/Reach-v0", num_envs=5)
    observations, _ = envs.reset(seed=0)
    actions = policy.act(observations)
    assert actions.shape == (5, 6) and actions.dtype == np.float32
    np.testing.assert_allclose(policy.act(observations[3]), actions[3], atol=1e-6)


def test_a_saved_policy_is_the_same(policy, tmp_path):
    again = load_policy(policy.save(tmp_path / "copy"))
    observation = np.linspace(-1, 1, 18, dtype=np.float32)
    assert np.array_equal(again.act(observation), policy.act(observation))
    assert again.record == policy.record


def test_another_observation_space_is_refused(policy):
    with pytest.raises(InputError, match="trained on observations of 18 numbers, but the environment gives 21"):
        policy.act(np.zeros(21, dtype=np.float32))


def test_another_arm_is_refused(trained):
    with pytest.raises(InputError, match="was trained for arm 'qiao2026', not for 'ur5'"):
        load_policy(trained / "policy.npz", load_arm("ur5"))


def test_damaged_files_are_refused(trained, tmp_path):
    whole = (trained / "policy.npz").read_bytes()
    broken = {"cut": whole[: len(whole) // 2], "empty": b"", "text": b"hello"}
    for name, content in broken.items():
        path = tmp_path / f"{name}.npz"
        path.write_bytes(content)
        with pytest.raises(InputError, match="is not a policy file or is damaged"):
            load_policy(path)
    with pytest.raises(InputError, match="unknown policy 'nobody'; give one of"):
        load_policy("nobody")


def rewritten(path, version=FORMAT, arrays=None, **header):
    """The file under a seal that holds, with some of its header and arrays replaced."""
    found = read_container(path, "policy", remake="")
    kept = {**found.arrays, **(arrays or {})}
    kept = {name: value for name, value in kept.items() if value is not None}
    return write_container(path, "policy", {**found.header, **header}, kept, version=version)


@pytest.fixture
def path(trained, tmp_path):
    path = tmp_path / "policy.npz"
    path.write_bytes((trained / "policy.npz").read_bytes())
    return path


def refused(path):
    with pytest.raises(InputError) as caught:
        load_policy(path)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_other_formats_are_refused(path):
    assert "has format 99, this program reads up to 2; update pickenv" in refused(rewritten(path, 99))
    assert "has the earlier format 1, this program reads 2; run `pickenv train`" in refused(rewritten(path, 1))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"arrays": {"weight0": np.full((13, 64), np.nan, np.float32)}}, "layer 1 does not fit|layer 1 holds numbers"),
        ({"arrays": {"bias1": None}}, "is damaged"),
        ({"arrays": {"more": np.zeros(3)}}, "its layers have"),
        ({"arrays": {"weight0": np.zeros((3, 3), np.float32)}}, "its layer 1 does not fit"),
        ({"activation": "exec"}, "its activation is 'exec'"),
        ({"activation": ["tanh"]}, "is damaged"),
        ({"scaling": {"joints": 2}}, "its layers have"),
        ({"scaling": None}, "is damaged"),
        ({"record": 3}, "is damaged"),
    ],
)
def test_what_is_no_policy_is_refused_under_a_seal_that_holds(path, change, words):
    assert re.search(words, refused(rewritten(path, **change)))


@pytest.mark.parametrize("layer", [0, 1])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_weights_that_are_not_finite_are_refused_by_layer(path, layer, value):
    weight = read_container(path, "policy", remake="").arrays[f"weight{layer}"].copy()
    weight[0, 0] = value
    rewritten(path, arrays={f"weight{layer}": weight})
    assert f"its layer {layer + 1} holds numbers that are not finite" in refused(path)


@pytest.mark.parametrize("count", [20, pytest.param(500, marks=pytest.mark.slow)])
def test_one_flipped_bit_anywhere_is_refused(path, count):
    whole = path.read_bytes()
    for number in range(count):
        rng, content = np.random.default_rng([4, number]), bytearray(whole)
        content[rng.integers(len(content))] ^= 1 << rng.integers(8)
        path.write_bytes(content)
        refused(path)


class Trap:
    """Pickles to code that runs when it is read."""

    def __reduce__(self):
        return (exec, ("raise SystemExit('code was executed')",))


def test_no_code_in_a_file_is_executed(path):
    """Neither as NumPy writes it, nor under a seal, nor in the place of a layer of a sealed file."""
    evil = io.BytesIO()
    np.save(evil, np.array([Trap()], dtype=object), allow_pickle=True)
    whole = path.read_bytes()
    np.savez(path, header=np.array([Trap()], dtype=object))
    refused(path)
    start = whole.index(b"\x93NUMPY")
    for content in (path.read_bytes(), evil.getvalue(), whole[:start] + evil.getvalue() + whole[start:]):
        path.write_bytes(content + seal(content))
        refused(path)


@pytest.mark.parametrize("goal", [False, True])
def test_scaling_is_the_same_on_numpy_and_torch(goal):
    import torch

    scaling = Scaling(6, camera=True, goal=goal)
    values = np.random.default_rng(0).normal(size=(7, scaling.inputs))
    for method in ("observe", "share"):
        on_numpy = getattr(scaling, method)(values, np)
        on_torch = getattr(scaling, method)(torch.as_tensor(values), torch).numpy()
        np.testing.assert_allclose(on_numpy, on_torch, rtol=1e-12)
    assert scaling.observe(values, np).shape == (7, scaling.features)


def test_near_the_fruit_actions_are_shares_of_the_gap():
    scaling = Scaling(6)
    observation = np.zeros(18)
    for gap, share in ((1.0, 1.0), (0.1, 1.0), (1e-3, 1e-2), (1e-4, 1e-3)):
        observation[12] = gap
        assert scaling.share(observation, np)[0] == pytest.approx(share)
    assert replace(scaling, actions=False).share(observation, np)[0] == 1.0


def test_shipped_baselines_are_small_and_have_cards():
    names = shipped_baselines()
    assert {"ppo_encoders", "ppo_camera", "sac_her_encoders"} <= set(names)
    assert sum(path.stat().st_size for path in BASELINES.glob("*.npz")) < 5e6
    for name in names:
        policy = load_any(name)
        assert policy.arm_fingerprint == load_arm(policy.arm).fingerprint(), "a file that was shipped stays readable"
        card = (BASELINES / f"{name}.md").read_text(encoding="utf-8")
        assert policy.algorithm.upper() in card and "95 %" in card
        json.dumps(dict(policy.record))


def test_the_wrapper_shows_what_the_vector_environment_shows(policy):
    with GapScaling(gym.make("pickenv/Reach-v0")) as env:
        seen, _ = env.reset(seed=2)
        assert env.observation_space.contains(seen)
        raw = env.raw
        layer = seen.astype(float)
        for i, (weight, bias) in enumerate(zip(policy.weights, policy.biases, strict=True)):
            layer = layer @ weight + bias
            layer = np.tanh(layer) if i + 1 < len(policy.weights) else layer.clip(-1, 1)
        np.testing.assert_allclose(layer * policy.scaling.share(raw, np), policy.act(raw), atol=1e-5)
        _, reward, *_, info = env.step(layer)
        assert reward < 0 and info["position_error_mm"] > 0
    with pytest.raises(InputError, match="reads flat observations"), gym.make("pickenv/ReachGoal-v0") as goal:
        GapScaling(goal)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["ppo_encoders", "ppo_camera", "sac_her_encoders", "sac_her_camera"])
def test_a_shipped_baseline_meets_its_card(name):
    """The row on raw arms, made again."""
    feedback = "camera" if name.endswith("camera") else "encoders"
    settings = PolicySettings((name,), ("raw",), (feedback,), ("qiao2026",))
    found = evaluation_rows(settings, run_policies(settings))[0]
    card = (BASELINES / f"{name}.md").read_text(encoding="utf-8")
    row = [cell.strip() for cell in next(line for line in card.splitlines() if line.startswith("| raw |")).split("|")]
    assert f"{found['arms']} arms" in card and found["interval_over"] in card
    assert float(row[2]) == pytest.approx(found["mean_mm"], abs=0.001)
    assert [float(end) for end in row[3].split(" to ")] == pytest.approx(found["ci95"], abs=0.001)
    assert found["ci95"][1] <= 3.0
