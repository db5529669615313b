"""Checkpoints: every byte is verified, nothing in them is executed, and a training goes on only as it was begun."""

import io
import os
import pickle
import shutil
from pathlib import Path

import numpy as np
import pytest
import torch
from typer import Typer
from typer.testing import CliRunner

import pickenv.agents
from pickenv.agents import Training, make_model, resumed, train
from pickenv.agents.training.training import read_checkpoint, save_checkpoint
from pickenv.agents.training.training_setup import arguments_of, check_inputs, inputs_of
from pickenv.arm import PLANTS, load_plant
from pickenv.base import InputError, read_container, write_container
from pickenv.calibration import fit, random_joints, simulated_tracker
from pickenv.cli import app
from pickenv.commands import learning as commands


@pytest.fixture
def checkpoint(trained, tmp_path):
    return Path(shutil.copy(trained / "checkpoint.pt", tmp_path))


def rewritten(path, *, training=None, blobs=None, version=None, kind=None, **header):
    """The checkpoint with other content, its seal made anew."""
    found = read_container(path, None, remake="")
    changed = {**found.header, **header}
    changed |= {"training": {**found.header["training"], **training}} if training else {}
    blobs = found.blobs if blobs is None else blobs
    write_container(path, kind or found.kind, changed, {}, blobs, version=found.version if version is None else version)


def refused(path, said=None):
    with pytest.raises(InputError, match=said) as caught:
        read_checkpoint(path)
    sentence = str(caught.value)
    assert "\n" not in sentence and str(path) in sentence and len(sentence) < 500


def test_a_sound_checkpoint_says_what_it_is_of(checkpoint, trained):
    training, inputs, _, _ = read_checkpoint(checkpoint)
    assert training == resumed(trained) and inputs == inputs_of(training)


class Code:
    """Its pickle makes a folder when it is loaded."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return os.mkdir, (str(self.path),)


@pytest.mark.parametrize("save", [torch.save, lambda thing, file: pickle.dump(thing, file)], ids=["torch", "pickle"])
def test_code_in_a_checkpoint_is_refused_and_not_run(checkpoint, tmp_path, save):
    mark, sound = tmp_path / "was-here", checkpoint.read_bytes()
    for thing in (Code(mark), {"parameters": Code(mark)}):
        stored = io.BytesIO()
        save(thing, stored)
        checkpoint.write_bytes(sound)
        rewritten(checkpoint, blobs={"state.pt": stored.getvalue()})
        refused(checkpoint, "is not a checkpoint or is damaged")
        checkpoint.write_bytes(stored.getvalue())
        refused(checkpoint)
    assert not mark.exists()
    pickle.loads(pickle.dumps(Code(mark)))  # it would have been
    assert mark.exists()


@pytest.mark.parametrize("flips", [40, pytest.param(500, marks=pytest.mark.slow)])
def test_one_bit_flipped_anywhere_in_a_checkpoint_is_refused(checkpoint, flips):
    content, rng = checkpoint.read_bytes(), np.random.default_rng(0)
    for bit in rng.choice(8 * len(content), flips, replace=False).tolist():
        damaged = bytearray(content)
        damaged[bit // 8] ^= 1 << bit % 8
        checkpoint.write_bytes(damaged)
        refused(checkpoint)


def test_a_truncated_checkpoint_is_refused(checkpoint):
    content, rng = checkpoint.read_bytes(), np.random.default_rng(0)
    for length in [0, 1, 4, 21, 22, 23, *rng.integers(len(content), size=20).tolist()]:
        checkpoint.write_bytes(content[:length])
        refused(checkpoint)


@pytest.mark.parametrize(
    "changes",
    [
        {"training": {"seed": "0"}},
        {"training": {"seed": True}},
        {"training": {"steps": 1.5}},
        {"training": {"steps": 0}},
        {"training": {"algorithm": "dqn"}},
        {"training": {"luck": 1}},
        {"training": {"arguments": None}},
        {"inputs": {}},
        {"inputs": None},
        {"evaluations": None},
        {"evaluations": [1]},
        {"evaluations": [{"steps": "many"}]},
        {"blobs": {}},
        {"blobs": {"state.pt": b""}},
        {"blobs": {"state.pt": b"PK\x03\x04 half a file"}},
        {"kind": "policy"},
        {"version": 4},
        {"version": 1},
    ],
    ids=str,
)
def test_a_checkpoint_of_other_content_is_refused_with_one_sentence(checkpoint, changes):
    rewritten(checkpoint, **changes)
    refused(checkpoint)


@pytest.mark.parametrize("settings", [{}, None, [], "text", 1])
def test_settings_that_are_none_are_refused_with_one_sentence(checkpoint, settings):
    found = read_container(checkpoint, None, remake="")
    write_container(checkpoint, found.kind, {**found.header, "training": settings}, {}, found.blobs, version=3)
    refused(checkpoint, "is not a checkpoint or is damaged")


def test_a_state_without_one_of_its_parts_is_refused(checkpoint):
    state = torch.load(io.BytesIO(read_container(checkpoint, None, remake="").blobs["state.pt"]), weights_only=True)
    for part in state:
        stored = io.BytesIO()
        torch.save({key: value for key, value in state.items() if key != part}, stored)
        rewritten(checkpoint, blobs={"state.pt": stored.getvalue()})
        refused(checkpoint, "its state is not that of a training")


def test_a_state_of_another_network_is_refused(trained, tmp_path):
    shutil.copytree(trained, tmp_path / "run")
    path = tmp_path / "run" / "checkpoint.pt"
    settings = read_checkpoint(path)[0].parameters | {"policy_kwargs": {"net_arch": [8]}}
    rewritten(path, training={"parameters": settings})
    with pytest.raises(InputError, match=r"checkpoint\.pt is not a checkpoint of this training or is damaged"):
        train(resumed(tmp_path / "run"), tmp_path / "run", resume=True)


def test_a_checkpoint_of_an_earlier_version_is_refused(checkpoint):
    torch.save({"format": 1, "settings": "{}"}, checkpoint)
    refused(checkpoint, "start the training again")


def test_a_checkpoint_is_put_in_place_whole(tmp_path):
    """Whoever holds the old file keeps it: the new one is another file with its name, never written into."""
    training = Training("ppo", arguments={"plant": "geometry_only"}, parameters={"n_envs": 16})
    model, env = make_model(training)
    model._setup_learn(1)
    path, held = tmp_path / "checkpoint.pt", tmp_path / "held"
    save_checkpoint(path, model, env, training, inputs_of(training), [])
    os.link(path, held)
    before = held.read_bytes()
    save_checkpoint(path, model, env, training, inputs_of(training), [{"steps": 1.0}])
    assert held.read_bytes() == before != path.read_bytes()


@pytest.fixture(scope="module")
def calibrations(tmp_path_factory):
    """Two calibrations of the same arm."""
    folder, plant = tmp_path_factory.mktemp("calibrations"), load_plant("geometry_only")
    for seed in range(2):
        rng = np.random.default_rng(seed)
        data = simulated_tracker(plant, random_joints(plant.arm.nominal, 40, rng), rng)
        fit(plant.arm, data, known_frames=True).calibration.save(folder / f"{seed}.npz")
    return folder


@pytest.fixture
def files(calibrations, tmp_path):
    """A calibration and a plant file that a training may be begun with."""
    shutil.copy(calibrations / "0.npz", tmp_path / "cal.npz")
    shutil.copy(PLANTS / "geometry_only.toml", tmp_path / "arm.toml")
    return tmp_path


EFFECT = "\n[measurement_noise]\nposition_std_mm = 1.0\nattitude_std_deg = 0.1\n"


def edited(path):
    path.write_text(path.read_text(encoding="utf-8") + EFFECT, encoding="utf-8")


FAULTS = {
    "another calibration": (
        lambda files, more: shutil.copy(more / "1.npz", files / "cal.npz"),
        r"cal\.npz \(`compensate`\) is another file than it was; put back",
    ),
    "no calibration": (lambda files, more: (files / "cal.npz").unlink(), r"cal\.npz \(`compensate`\) is missing"),
    "another plant": (lambda files, more: edited(files / "arm.toml"), r"arm\.toml \(`plant`.*\) has other numbers"),
    "no plant": (lambda files, more: (files / "arm.toml").unlink(), r"arm\.toml \(`plant`\) is missing; put back"),
}


@pytest.mark.parametrize(
    ("moment", "fault"),
    [*(("between", fault) for fault in FAULTS), ("within", "another plant"), ("within", "no plant")],
)
def test_a_training_refuses_files_that_have_changed_since_it_was_begun(files, calibrations, monkeypatch, fault, moment):
    change, said = FAULTS[fault]
    training = Training(
        "ppo",
        steps=1440,
        arguments={"plant": str(files / "arm.toml")},
        compensate=str(files / "cal"),
        checkpoint_every=480,
        evaluate_every=480,
        parameters={"n_envs": 8},
    )
    out, real, count = files / "run", save_checkpoint, [0]

    class Stopped(Exception):
        pass

    def save(*arguments):
        real(*arguments)
        count[0] += 1
        if count[0] == 1:
            change(files, calibrations)
            if moment == "between":
                raise Stopped

    monkeypatch.setattr("pickenv.agents.training.training.save_checkpoint", save)
    monkeypatch.setattr("pickenv.agents.training.training_setup.judge", lambda policy, training: {"mean_mm": 0.0})
    with pytest.raises(Stopped if moment == "between" else InputError, match=None if moment == "between" else said):
        train(training, out)
    with pytest.raises(InputError, match=said) as caught:
        train(resumed(out), out, resume=True)
    assert "\n" not in str(caught.value) and count[0] == 1 and not (out / "policy.npz").exists()
    shutil.copy(calibrations / "0.npz", files / "cal.npz")
    shutil.copy(PLANTS / "geometry_only.toml", files / "arm.toml")
    assert len(train(resumed(out), out, resume=True).evaluations) == 3


def test_a_tolerance_class_is_among_what_must_not_change(tmp_path):
    arguments = {"arms": "per_episode", "tolerances": "coarse"}
    begun = inputs_of(Training("ppo", arguments=arguments))
    assert begun != inputs_of(Training("ppo", arguments=arguments | {"tolerances": "fine"}))
    with pytest.raises(InputError, match="has other numbers than it had"):
        check_inputs(Training("ppo", arguments=arguments), {"arms": "0" * 64, "calibration": None})


OPTIONS = {
    "--algo sac": "with --algo ppo, not sac",
    "--seed 77 --steps 5": "with --steps 480, not 5, with --seed 0, not 77",
    "--env pickenv/ReachGoal-v0": "with --env pickenv/Reach-v0, not pickenv/ReachGoal-v0",
    "--compensate cal.npz": "without --compensate",
    "--plant orchard": "with --plant geometry_only, not orchard",
    "--feedback camera": "with --feedback encoders, not camera",
    "--fruit-noise 1": "with --fruit-noise 0.0, not 1.0",
    "--randomise fine": "without --randomise",
    "--checkpoint-every 7": "with --checkpoint-every 50000, not 7",
    "--evaluate-every 7": "with --evaluate-every 50000, not 7",
}


@pytest.mark.parametrize("options", OPTIONS)
def test_options_that_say_something_else_than_the_training_are_named(trained, options):
    ran = command("train", "--resume", *options.split(), "--out", str(trained))
    assert isinstance(ran.exception, InputError)
    assert f"was begun {OPTIONS[options]}; leave out what was not said then" in str(ran.exception)


def test_options_that_say_the_same_may_be_repeated(trained, tmp_path):
    out = shutil.copytree(trained, tmp_path / "run")
    options = "--algo ppo --plant geometry_only --steps 480 --seed 0"
    assert command("train", "--resume", *options.split(), "--out", str(out)).exit_code == 0


def command(*words):
    app = Typer()
    app.command()(commands.train)
    app.command()(commands.evaluate)
    return CliRunner().invoke(app, [*words])


NO_CAMERA = "--camera-noise changes nothing without a camera"


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("train --camera-noise 2", NO_CAMERA),
        ("evaluate --feedback encoders --camera-noise 2", NO_CAMERA),
        ("evaluate --policy scripted --camera-noise 2", NO_CAMERA),
        ("evaluate --policy servo --camera-noise nan", "camera_noise_mm is nan; give a finite number"),
        ("evaluate --policy servo --camera-noise -1", "camera_noise_mm is -1.0; give a finite number"),
        ("evaluate --fruit-noise inf", "fruit_noise_mm is inf; give a finite number"),
        (
            "evaluate --policy scripted --feedback camera",
            "no policy can be run with feedback camera and .*: scripted needs feedback encoders; change one of them",
        ),
        ("evaluate --policy oracle --compensation ls", "oracle needs feedback encoders and compensation raw"),
    ],
)
def test_what_cannot_be_compared_is_said_before_anything_is_run(tmp_path, line, said):
    ran = command(*line.split(), *(["--json", str(tmp_path / "rows.json")] if "evaluate" in line else []))
    assert isinstance(ran.exception, InputError), ran.output
    with pytest.raises(InputError, match=said):
        raise ran.exception
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("words", "how"),
    [
        ("ls --workers 3", "loky, 3"),
        ("ls --workers 1", "serial, 1"),
        ("ls", "serial, None"),  # processes would take longer to start than to work
        ("ls_bpnn", "loky, None"),
        ("ls_bpnn --workers 1", "serial, 1"),
    ],
)
def test_workers_that_are_asked_for_work(words, how, monkeypatch):
    def told(settings, *, backend, workers, **_):
        raise InputError(f"{backend}, {workers}")

    monkeypatch.setattr(pickenv.experiments, "run_policies", told)
    assert str(command("evaluate", "--compensation", *words.split()).exception) == how


@pytest.mark.parametrize(
    ("words", "wanted"),
    [
        ("--feedback encoders", {"feedback": "encoders"}),
        ("--camera-noise 0", {"feedback": "camera", "camera_noise_mm": 0.0}),
        ("--camera-noise 2", {"feedback": "camera", "camera_noise_mm": 2.0}),
    ],
)
def test_what_is_typed_counts_before_what_an_algorithm_usually_has(words, wanted, tmp_path, monkeypatch):
    found = {}

    def told(training, out, **_):
        found.update(arguments_of(training)[0])
        raise InputError("enough")

    monkeypatch.setattr(pickenv.agents, "train", told)
    ran = CliRunner().invoke(app, ["train", "--algo", "ppo_lstm", *words.split(), "--out", str(tmp_path)])
    assert "enough" in str(ran.exception) + ran.output
    assert wanted.items() <= found.items()
