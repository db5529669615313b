"""Training: one seed gives one set of weights, interrupted or not; bad input ends with one sentence."""

import dataclasses
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from pickenv.agents import Training, actor_of, load_policy, make_model, read_checkpoint, resumed, train, tuned
from pickenv.arm import load_plant
from pickenv.base import InputError
from pickenv.calibration import Calibration, fit, random_joints, simulated_tracker

ROOT = Path(__file__).parents[2]
TQC = pytest.param("tqc", marks=pytest.mark.slow)  # shares sac's lines


def weights(out: Path) -> list[np.ndarray]:
    policy = load_policy(out / "policy.npz")
    return [*policy.weights, *policy.biases]


def same(one: Path, other: Path) -> bool:
    pairs = zip(weights(one), weights(other), strict=True)
    return all(np.array_equal(a, b) for a, b in pairs)


class Killed(Exception):
    """Stands for whatever ends a program."""


def stop_after(monkeypatch, writes: int) -> None:
    """Let the training end right after its n-th checkpoint was written."""
    import pickenv.agents.training.training

    real, count = pickenv.agents.training.training.save_checkpoint, [0]

    def save(*arguments):
        real(*arguments)
        count[0] += 1
        if count[0] == writes:
            raise Killed

    monkeypatch.setattr("pickenv.agents.training.training.save_checkpoint", save)


@pytest.mark.parametrize("algorithm", ["ppo", pytest.param("sac", marks=pytest.mark.slow), TQC])
def test_two_runs_of_one_seed_give_equal_weights(short, tmp_path, algorithm):
    for name in ("one", "other"):
        train(short(algorithm), tmp_path / name)
    assert same(tmp_path / "one", tmp_path / "other")
    train(short(algorithm, seed=1), tmp_path / "third")
    assert not same(tmp_path / "one", tmp_path / "third")


@pytest.mark.parametrize("algorithm", ["ppo", "sac", TQC])
def test_a_resumed_run_ends_like_an_uninterrupted_one(short, tmp_path, monkeypatch, algorithm):
    steps = 160 if algorithm != "ppo" else 1440
    training = short(algorithm, steps=steps, checkpoint_every=steps // 3, evaluate_every=steps // 3)
    train(training, tmp_path / "whole")
    with monkeypatch.context() as patch:
        stop_after(patch, 2)
        with pytest.raises(Killed):
            train(training, tmp_path / "broken")
    assert not (tmp_path / "broken" / "policy.npz").exists()
    train(training, tmp_path / "broken", resume=True)
    assert same(tmp_path / "whole", tmp_path / "broken")
    evaluations = [(tmp_path / name / "evaluations.json").read_text() for name in ("whole", "broken")]
    assert evaluations[0] == evaluations[1]


def test_a_population_of_arms_is_resumed_too(short, tmp_path, monkeypatch):
    arguments = {"plant": "orchard", "arms": "per_episode", "population": 5, "camera_noise_mm": 1.0}
    training = short("ppo", checkpoint_every=480, arguments=arguments | {"feedback": "camera"})
    train(training, tmp_path / "whole")
    with monkeypatch.context() as patch:
        stop_after(patch, 1)
        with pytest.raises(Killed):
            train(training, tmp_path / "broken")
    train(training, tmp_path / "broken", resume=True)
    assert same(tmp_path / "whole", tmp_path / "broken")


@pytest.mark.slow
@pytest.mark.parametrize("hows", [[signal.SIGKILL], [signal.SIGINT], [signal.SIGTERM, signal.SIGKILL, signal.SIGKILL]])
def test_a_killed_training_goes_on(tmp_path, hows):
    code = (
        "import signal, sys; from pickenv.agents.training.training import train;"
        "signal.signal(signal.SIGINT, signal.default_int_handler);"  # a shell starts what runs behind it deaf to it
        "from pickenv.agents.training.training_setup import Training;"
        "train(Training('ppo', steps=60000, arguments={'plant': 'geometry_only'}, checkpoint_every=3840,"
        " evaluate_every=30000, parameters={'n_envs': 64}), sys.argv[1], resume=len(sys.argv) > 2)"
    )

    def start(name: str, *more: str) -> subprocess.Popen:
        command = [sys.executable, "-W", "ignore", "-c", code, str(tmp_path / name), *more]
        return subprocess.Popen(command, cwd=ROOT, env=os.environ | {"OMP_NUM_THREADS": "1"}, stderr=subprocess.PIPE)

    checkpoint, before, rng = tmp_path / "broken" / "checkpoint.pt", b"", np.random.default_rng(0)
    for how in hows:
        process = start("broken", *(["again"] if before else []))
        deadline = time.monotonic() + 600
        while process.poll() is None and time.monotonic() < deadline:
            if checkpoint.exists() and checkpoint.read_bytes() != before:
                break
            time.sleep(0.05)
        time.sleep(rng.uniform(0.0, 0.2))
        process.send_signal(how)
        assert process.wait(600) != 0
        process.stderr.close()
        read_checkpoint(checkpoint)
        before = checkpoint.read_bytes()
    for name, more in (("broken", ("again",)), ("whole", ())):
        process = start(name, *more)
        assert process.wait(1800) == 0, process.stderr.read().decode()
        process.stderr.close()
    assert same(tmp_path / "broken", tmp_path / "whole")
    evaluations = [(tmp_path / name / "evaluations.json").read_text() for name in ("whole", "broken")]
    assert evaluations[0] == evaluations[1]


def test_sac_learns_from_joined_observations_too(tmp_path):
    parameters = {"n_envs": 4, "learning_starts": 100, "gradient_steps": 1}
    done = train(Training("sac", steps=160, arguments={"plant": "ideal"}, parameters=parameters), tmp_path)
    assert np.isfinite(done.evaluations[-1]["mean_mm"]) and not done.policy.scaling.goal


def test_the_folder_says_how_it_was_trained(short, tmp_path):
    training = short("ppo", checkpoint_every=480)
    done = train(training, tmp_path)
    assert resumed(tmp_path) == training
    assert set(done.evaluations[-1]) == {"steps", "mean_mm", "p95_mm", "success_rate"}
    assert done.policy.record["training"] == dataclasses.asdict(training)


def test_a_finished_training_may_be_resumed_and_stays_as_it_is(short, tmp_path):
    train(short(), tmp_path)
    before = weights(tmp_path)
    train(short(), tmp_path, resume=True)
    assert all(np.array_equal(a, b) for a, b in zip(before, weights(tmp_path), strict=True))


def test_parameters_are_read_in_the_notation_of_the_zoo():
    parameters = tuned("ppo", "pickenv/Reach-v0")
    assert parameters["policy_kwargs"]["net_arch"] == [64, 64]
    assert parameters["learning_rate"](0.5) == pytest.approx(5e-4)


def test_what_the_native_environment_shows_is_what_the_policy_file_sees(short):
    training = short()
    model, env = make_model(training)
    shown = env.reset()

    policy = actor_of(model, training, env)
    predicted, _ = model.predict(shown, deterministic=True)
    raw = env.envs.raw
    np.testing.assert_allclose(policy.act(raw), env.envs.scaling.act(raw, predicted), atol=1e-5)


def refusals(short, tmp_path):
    (tmp_path / "half").mkdir()
    (tmp_path / "half" / "checkpoint.pt").write_bytes(b"PK\x03\x04 half a file")
    (tmp_path / "text").mkdir()
    (tmp_path / "text" / "checkpoint.pt").write_text("not a checkpoint")
    yield (lambda: Training("dqn"), "unknown algorithm 'dqn'; give one of ppo, sac, tqc")
    for name in ("CartPole-v1", "Harvest", "pickenv/Harvest-v0"):  # these are environments all the same
        yield (lambda name=name: Training("ppo", name), f"^environment '{name}' cannot be trained on here; give one of")
    yield (lambda: Training("ppo", steps=0), "steps is 0; give a whole number of at least 1")
    yield (lambda: Training("ppo", steps=1e5), "steps is 100000.0; give a whole number")
    yield (lambda: Training("ppo", evaluate_every=0), "evaluate_every is 0; give a whole number of at least 1")
    yield (lambda: Training("ppo", parameters={"learning_rate": abs}), "parameters of a training holds <built-in")
    yield (lambda: train(short(), tmp_path / "none", resume=True), "no checkpoint .* without `resume`")
    yield (lambda: train(short(), tmp_path / "half", resume=True), "checkpoint .* is (damaged|not a checkpoint)")
    yield (lambda: train(short(), tmp_path / "text", resume=True), "checkpoint")
    yield (lambda: train(short("ppo", env_id="pickenv/ReachGoal-v0"), tmp_path / "goal"), "no tuned parameters")
    yield (lambda: train(short(arguments={"feedback": "sonar"}), tmp_path / "sonar"), "feedback is 'sonar'")


def test_bad_input_ends_with_one_sentence(short, tmp_path):
    for attempt, message in refusals(short, tmp_path):
        with pytest.raises(InputError, match=message) as caught:
            attempt()
        assert "\n" not in str(caught.value)


def test_a_training_is_what_its_checkpoint_gives_back():
    given = {"joint_noise": (0.0, 0.1), "latency": np.int64(1), "without": ()}
    kwargs = {"net_arch": (8,)}
    training = Training(
        "sac",
        "pickenv/ReachGoal-v0",
        np.int64(9),
        compensate=Path("arm.npz"),
        arguments=given,
        parameters={"policy_kwargs": kwargs},
    )
    before = dataclasses.asdict(training)
    assert before == json.loads(json.dumps(before)) and before["compensate"] == "arm.npz"
    make_model(dataclasses.replace(training, compensate=None))
    assert dataclasses.asdict(training) == before and kwargs == {"net_arch": (8,)}


@pytest.mark.parametrize(
    "limits", [{"max_episode_steps": 3}, {"end_on_success": True, "tolerance_mm": 1e4, "angle_tolerance_deg": 180.0}]
)
def test_a_policy_is_judged_where_its_episodes_end(short, limits, tmp_path):
    train(short(arguments={"plant": "ideal"} | limits), tmp_path)
    (judged, *_) = json.loads((tmp_path / "evaluations.json").read_text(encoding="utf-8"))
    assert judged["success_rate"] == float("end_on_success" in limits)
    assert judged["mean_mm"] > 100.0  # after so few steps


def test_a_cut_checkpoint_is_refused(short, tmp_path):
    train(short(), tmp_path)
    path = tmp_path / "checkpoint.pt"
    path.write_bytes(path.read_bytes()[:-2000])
    with pytest.raises(InputError, match=r"start the training again|not a checkpoint"):
        train(short(), tmp_path, resume=True)


def test_a_checkpoint_of_another_training_is_refused(short, tmp_path):
    train(short(), tmp_path)
    with pytest.raises(InputError, match="is of another training"):
        train(short(seed=5), tmp_path, resume=True)


def test_a_calibration_of_another_arm_is_refused(short, tmp_path):
    plant = load_plant("li2016_slave")
    rng = np.random.default_rng(0)
    data = simulated_tracker(plant, random_joints(plant.arm.nominal, 60, rng), rng)
    calibration: Calibration = fit(plant.arm, data, known_frames=True).calibration
    path = calibration.save(tmp_path / "other.npz")
    with pytest.raises(InputError, match="belongs to arm 'li2016_slave'"):
        train(short(compensate=str(path)), tmp_path / "run")


def test_a_calibration_with_fitted_frames_is_refused_until_it_is_named_and_resumed_so(short, tmp_path):
    plant, rng = load_plant("qiao2026"), np.random.default_rng(0)
    data = simulated_tracker(plant, random_joints(plant.arm.nominal, 30, rng), rng)
    file = fit(plant.arm, data).calibration.save(tmp_path / "fitted.npz")
    with pytest.raises(InputError, match="base and tool of this calibration were fitted"):
        make_model(short("ppo", compensate=str(file)))
    named = short("ppo", compensate=str(file), allow=["fitted-frames"])
    train(named, tmp_path / "run")
    assert resumed(tmp_path / "run") == named
