"""LeRobot finds the environment, evaluates its own policies on it, and corrects targets as the calibration does."""

import json
import os
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

pytest.importorskip("lerobot", reason="LeRobot is not installed; make test-lerobot has an environment with it")
torch = pytest.importorskip("torch")

import lerobot_env_pickenv as plugin  # noqa: E402
from lerobot.configs import FeatureType  # noqa: E402
from lerobot.datasets.lerobot_dataset import LeRobotDataset  # noqa: E402
from lerobot.envs import env_to_policy_features, make_env, preprocess_observation  # noqa: E402
from lerobot.envs.utils import _call_make_env, _import_hub_module, _normalize_hub_result  # noqa: E402
from lerobot.policies import make_pre_post_processors  # noqa: E402
from lerobot.policies.act.configuration_act import ACTConfig  # noqa: E402
from lerobot.policies.act.modeling_act import ACTPolicy  # noqa: E402
from lerobot.policies.diffusion.configuration_diffusion import DiffusionConfig  # noqa: E402
from lerobot.policies.diffusion.modeling_diffusion import DiffusionPolicy  # noqa: E402
from lerobot.processor import PolicyProcessorPipeline, RobotProcessorPipeline  # noqa: E402
from lerobot.processor.converters import (  # noqa: E402
    policy_action_to_transition,
    robot_action_observation_to_transition,
    transition_to_policy_action,
    transition_to_robot_action,
)
from lerobot.utils.constants import ACTION  # noqa: E402

import pickenv  # noqa: E402
from pickenv.agents import SIGHT, ScriptedReach, ScriptedScene, ServoScene  # noqa: E402
from pickenv.calibration import ArmModel, Calibration  # noqa: E402

ROOT = Path(__file__).parents[2]
EVAL = Path(sys.executable).parent / "lerobot-eval"
ALONE = os.environ | {"HF_HUB_OFFLINE": "1", "OMP_NUM_THREADS": "1"}
"""No hub is asked."""

SMALL = {"device": "cpu", "push_to_hub": False, "pretrained_backbone_weights": None}
ACT = {
    "chunk_size": 4,
    "n_action_steps": 4,
    "dim_model": 32,
    "n_heads": 2,
    "dim_feedforward": 32,
    "n_encoder_layers": 1,
    "use_vae": False,
}
DIFFUSION = {
    "horizon": 8,
    "n_action_steps": 4,
    "down_dims": (16, 32),
    "num_inference_steps": 2,
    "diffusion_step_embed_dim": 16,
    "spatial_softmax_num_keypoints": 4,
}
POLICIES: dict[str, tuple[Any, Any, dict[str, Any]]] = {
    "act": (ACTConfig, ACTPolicy, ACT),
    "diffusion": (DiffusionConfig, DiffusionPolicy, DIFFUSION),
}


@pytest.fixture(scope="module")
def calibration(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A calibration of an SO-101 that is a few milliradians off in every joint."""
    arm, rng = pickenv.load_arm("so101"), np.random.default_rng(1)
    found = replace(arm.nominal, theta=arm.nominal.theta + rng.normal(size=arm.nominal.links) * 0.02)
    record = {"frames": "known"}
    return Calibration(arm.name, arm.nominal, arm.nominal, ArmModel.of(found), None, record).save(
        tmp_path_factory.mktemp("calibration") / "so101.npz"
    )


def saved(name: str, folder: Path) -> Path:
    """The folder of an untrained policy, as LeRobot saves one."""
    config_of, policy_of, sizes = POLICIES[name]
    features = env_to_policy_features(plugin.PickenvEnv())
    outputs = {ACTION: features.pop(ACTION)}
    torch.manual_seed(0)
    config = config_of(input_features=features, output_features=outputs, **SMALL, **sizes)
    shapes = {
        key: (3, 1, 1) if feature.type is FeatureType.VISUAL else feature.shape
        for key, feature in (features | outputs).items()
    }
    sizes_of = {"mean": torch.zeros, "std": torch.ones, "min": lambda shape: -torch.ones(shape), "max": torch.ones}
    stats = {key: {of: make(shape) for of, make in sizes_of.items()} for key, shape in shapes.items()}
    for part in (policy_of(config), *make_pre_post_processors(config, dataset_stats=stats)):
        part.save_pretrained(folder)
    return folder


def test_lerobot_finds_the_environment_when_it_starts() -> None:
    code = (
        "from lerobot.envs import EnvConfig\n"
        "from lerobot.utils.import_utils import register_third_party_plugins\n"
        "assert 'pickenv' not in EnvConfig.get_known_choices()\n"
        "register_third_party_plugins()\n"
        "print('pickenv' in EnvConfig.get_known_choices())"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=ALONE)
    assert done.stdout.split() == ["True"], done.stderr


@pytest.mark.parametrize(("name", "batch"), [("act", 1), ("diffusion", 2)])
def test_lerobot_eval_as_it_stands_prints_success_and_errors(
    name: str, batch: int, tmp_path: Path, calibration: Path
) -> None:
    command = [
        str(EVAL),
        "--env.type=pickenv",
        "--env.pixels=64",
        "--env.episode_length=10",
        "--env.error_mm=8.0",
        f"--env.calibration={calibration}",
        f"--env.errors_to={tmp_path / 'errors.jsonl'}",
        f"--policy.path={saved(name, tmp_path / name)}",
        "--policy.device=cpu",
        "--eval.n_episodes=2",
        f"--eval.batch_size={batch}",
        f"--output_dir={tmp_path / 'out'}",
    ]
    done = subprocess.run(command, capture_output=True, text=True, env=ALONE, cwd=tmp_path)
    said = done.stdout + done.stderr
    assert done.returncode == 0, said
    assert re.search(r"'pc_success': \d+\.\d+, 'n_episodes': 2", said)
    ends = [json.loads(line) for line in (tmp_path / "errors.jsonl").read_text().splitlines()]
    assert [end["seed"] for end in sorted(ends, key=lambda end: end["seed"])] == [1000, 1001]
    errors = [end["position_error_mm"] for end in ends]
    median, largest = f"{np.median(errors):.1f}", f"{max(errors):.1f}"
    assert f"position_error_mm at the end of 2 episodes: median {median}, largest {largest}" in said
    metrics = json.loads((tmp_path / "out/eval_info.json").read_text())
    successes = [end["is_success"] for end in sorted(ends, key=lambda end: end["seed"])]
    assert metrics["per_task"][0]["metrics"]["successes"] == successes
    assert metrics["overall"]["pc_success"] == 100.0 * np.mean(successes)


@pytest.mark.parametrize("obs_type", plugin.OBSERVATIONS)
def test_what_the_config_describes_is_what_the_environment_shows(obs_type: str) -> None:
    config = plugin.PickenvEnv(obs_type=obs_type, pixels=32, cameras=["wrist"], episode_length=3)
    vector = make_env(config, n_envs=2)["pickenv"][0]
    seen, _ = vector.reset(seed=[0, 1])
    features = env_to_policy_features(config)
    assert vector.single_action_space.shape == features.pop(ACTION).shape
    shown = {key: tuple(value.shape[1:]) for key, value in preprocess_observation(seen).items()}
    assert shown == {key: feature.shape for key, feature in features.items()}
    assert vector.call("_max_episode_steps") == (3, 3)
    assert all(vector.call("task_description"))
    for _ in range(5):  # the second episodes are not LeRobot's
        vector.step(np.zeros(vector.action_space.shape, dtype=np.float32))
    assert [end["seed"] for end in vector.noted] == [0, 1]
    vector.close()


def test_the_simulated_arm_is_commanded_as_the_step_would_command_a_real_one(calibration: Path) -> None:
    commands = []
    for path in (None, str(calibration)):
        env = plugin.PickenvEnv(calibration=path, cameras=["wrist"], pixels=16).make_one()
        env.reset(seed=3)
        for _ in range(3):
            *_, info = env.step(np.full(env.action_space.shape, 0.5, dtype=np.float32))
        commands.append(info["joint_command"])
        env.close()
    target, command = commands
    step = plugin.CompensationStep(str(calibration), unit="rad")
    names = [f"{name}.pos" for name in step.joints]
    corrected = step.action(dict(zip(names, target.tolist(), strict=True)))
    np.testing.assert_allclose([corrected[name] for name in names], command, rtol=0.0, atol=1e-9)
    assert np.abs(command - target).max() > 1e-3


def test_demonstrations_are_a_data_set_that_lerobot_reads(tmp_path: Path) -> None:
    place = SIGHT | {"pixels": 32}
    env = gym.make("pickenv/PickScene-v0", plant="coarse:ur5e", error_mm=4.0, **place)
    made = plugin.record(env, ServoScene(env), tmp_path / "set", episodes=3, seed=5)
    about = json.loads((tmp_path / "set/meta/pickenv.json").read_text())
    seeds = [episode["seed"] for episode in about["episodes"]]
    assert about["arguments"]["error_mm"] == 4.0 and set(seeds) <= {5, 6, 7} and not about["compensated"]
    assert all(episode["true"] != episode["believed"] for episode in about["episodes"])
    read = LeRobotDataset(made.repo_id, root=tmp_path / "set")
    assert read.num_episodes == len(seeds) and read.fps == 25
    seen, _ = env.reset(seed=seeds[0])
    first = read[0]
    np.testing.assert_array_equal(first["observation.state"], seen["agent_pos"])
    picture = np.moveaxis(first["observation.images.wrist"].numpy(), 0, -1)
    np.testing.assert_allclose(picture * 255.0, seen["pixels"]["wrist"], atol=1e-3)
    for row in range(read.meta.episodes[0]["length"]):
        *_, info = env.step(read[row]["action"].numpy())
    assert info["is_success"]
    with pytest.raises(pickenv.InputError, match="set is there already; take it away, or name another folder"):
        plugin.record(env, ServoScene(env), tmp_path / "set")
    env.close()


def test_every_task_that_has_one_arm_can_be_recorded(tmp_path: Path) -> None:
    env = gym.make("pickenv/Reach-v0", plant="medium:ur5e", arms="per_episode")
    made = plugin.record(env, ScriptedReach(env), tmp_path / "set", episodes=2)
    read = LeRobotDataset(made.repo_id, root=tmp_path / "set")
    assert (read.num_episodes, len(read)) == (2, 120)
    np.testing.assert_array_equal(read[60]["observation.state"], env.reset(seed=1)[0])
    first, second = json.loads((tmp_path / "set/meta/pickenv.json").read_text())["episodes"]
    assert first["believed"] == second["believed"] and first["true"] != second["true"]


@pytest.mark.parametrize(
    ("name", "arguments", "words"),
    [
        ("Reach", {"control_period_s": 0.03}, "has 33.33 steps a second; LeRobot takes whole numbers"),
        ("ReachGoal", {}, "shows neither plain numbers nor agent_pos of one arm; record another"),
        ("PickScene", {"obs_type": "pixels"}, "shows neither plain numbers nor agent_pos of one arm; record another"),
    ],
)
def test_what_lerobot_cannot_hold_is_refused_before_the_first_episode(
    name: str, arguments: dict[str, Any], words: str, tmp_path: Path
) -> None:
    env = gym.make(f"pickenv/{name}-v0", **arguments)
    with pytest.raises(pickenv.InputError, match=words):
        plugin.record(env, ScriptedReach(env), tmp_path / "set")


def test_no_success_no_data_set(tmp_path: Path) -> None:
    env = gym.make("pickenv/PickScene-v0", max_episode_steps=2)
    with pytest.raises(pickenv.InputError, match="none of 2 episodes succeeded; record more, or another policy"):
        plugin.record(env, ScriptedScene(env), tmp_path / "set", episodes=2)
    assert not (tmp_path / "set").exists()


def test_the_hub_finds_the_environment_in_its_file() -> None:
    module = _import_hub_module(str(ROOT / "scripts/lerobot_env_pickenv/env.py"), "someone/pickenv")
    made = _normalize_hub_result(_call_make_env(module, n_envs=1, use_async_envs=False, cfg=None))
    assert made["pickenv"][0].num_envs == 1
    made["pickenv"][0].close()


def robot_pipeline(step: Any) -> Any:
    """The pipeline that LeRobot puts before a robot."""
    return RobotProcessorPipeline(
        steps=[step],
        to_transition=robot_action_observation_to_transition,
        to_output=transition_to_robot_action,
    )


def test_a_target_comes_out_as_the_compensator_gives_it(calibration: Path) -> None:
    names = pickenv.load_arm("so101").nominal.joint_names
    targets = np.random.default_rng(0).uniform(-40.0, 40.0, size=5)
    action = {f"{name}.pos": value for name, value in zip(names, targets.tolist(), strict=True)} | {"gripper.pos": 33.3}
    corrected = robot_pipeline(plugin.CompensationStep(str(calibration)))((action, {}))
    expected = np.degrees(Calibration.load(calibration).compensate(np.radians(targets)))
    assert list(corrected) == list(action)
    assert corrected["gripper.pos"] == 33.3
    np.testing.assert_allclose([corrected[f"{name}.pos"] for name in names], expected, rtol=0.0, atol=1e-9)
    assert np.abs(expected - targets).max() > 0.1  # degrees; a correction that does nothing would prove nothing


def test_a_policys_tensor_is_corrected_in_its_first_columns(calibration: Path) -> None:
    targets = torch.as_tensor(np.random.default_rng(0).uniform(-0.7, 0.7, size=(3, 6)), dtype=torch.float32)
    step = plugin.CompensationStep(str(calibration), unit="rad")
    corrected = step.action(targets)
    assert corrected.dtype == targets.dtype
    assert torch.equal(corrected[:, 5], targets[:, 5])
    expected = Calibration.load(calibration).compensate(targets[:, :5].double().numpy())
    np.testing.assert_allclose(corrected[:, :5].numpy(), expected, rtol=0.0, atol=1e-6)


def test_a_step_comes_back_from_the_files_of_a_policy(calibration: Path, tmp_path: Path) -> None:
    folder, file = saved("act", tmp_path / "act"), "policy_postprocessor.json"
    pipeline = PolicyProcessorPipeline.from_pretrained(folder, config_filename=file)
    step = plugin.CompensationStep(str(calibration), unit="deg", allow=["do-not-use"])
    pipeline.steps.append(step)
    pipeline.save_pretrained(folder)
    config = json.loads((folder / file).read_text())["steps"][-1]
    assert config == {"registry_name": "pickenv_compensation", "config": step.get_config()}
    again = PolicyProcessorPipeline.from_pretrained(
        folder, file, to_transition=policy_action_to_transition, to_output=transition_to_policy_action
    )
    assert again.steps[-1].get_config() == step.get_config()
    action = torch.full((1, 6), 0.25)
    assert torch.equal(again(action), step.action(pipeline.steps[0](policy_action_to_transition(action))["action"]))


def test_mistakes_are_told_in_a_sentence(calibration: Path, tmp_path: Path) -> None:
    step = plugin.CompensationStep(str(calibration))
    arm = pickenv.load_arm("so101")
    record = {"frames": "known", "verdict": {"grade": "do not use", "reason": "too few rows"}}
    Calibration(arm.name, arm.nominal, arm.nominal, ArmModel.of(arm.nominal), None, record).save(tmp_path / "bad.npz")
    mistakes = {
        "the action has no shoulder_pan.pos; it has pan.pos": lambda: step.action({"pan.pos": 1.0}),
        "the unit is 'range'; give one of deg, rad": lambda: plugin.CompensationStep(str(calibration), unit="range"),
        "is of 5 joints, not 2": lambda: plugin.CompensationStep(str(calibration), joints=["pan", "lift"]),
        "do not use (too few rows)": lambda: plugin.CompensationStep(str(tmp_path / "bad.npz")),
        "belongs to arm 'so101'": plugin.PickenvEnv(plant="ideal:ur5e", calibration=str(calibration)).make_one,
        "none.npz does not exist": lambda: plugin.CompensationStep(str(tmp_path / "none.npz")),
        "obs_type is 'state'; LeRobot takes one of pixels_agent_pos, pixels": lambda: plugin.PickenvEnv(
            obs_type="state"
        ),
    }
    for sentence, mistake in mistakes.items():
        with pytest.raises(pickenv.InputError, match=re.escape(sentence)) as told:
            mistake()
        assert "\n" not in str(told.value)
