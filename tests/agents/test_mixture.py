"""Training over several plants: each row is what it is alone, and a training goes on to the bit."""

import shutil

import numpy as np
import pytest
from typer import Typer
from typer.testing import CliRunner

from pickenv.agents import Training, actor_of, make_model, resumed, train
from pickenv.agents.training import training as module
from pickenv.agents.training.training_setup import check_inputs, inputs_of, make_environment, make_runs
from pickenv.arm import PLANTS, load_arm
from pickenv.base import InputError
from pickenv.commands import learning as commands
from pickenv.wrappers import SameArmMixture, SameArmVector

PAIR = ["qiao2026", "orchard"]
FEW = {"n_envs": 5, "n_steps": 20, "batch_size": 50, "n_epochs": 1}


def mixed(algorithm: str = "ppo_history", plant=None, **changes) -> Training:
    arguments = {"population": 6, "plant": PAIR if plant is None else plant}
    return Training(algorithm, **({"seed": 1, "parameters": FEW, "arguments": arguments} | changes))


def rows_of(infos: dict, rows: slice) -> dict:
    """Some rows of infos, plain arrays."""
    parts = {key: rows_of(each, rows) if isinstance(each, dict) else each[rows] for key, each in infos.items()}
    return {key: np.stack(each) if key == "final_obs" else each for key, each in parts.items()}


def test_a_row_is_what_it_is_alone_whatever_the_number_of_plants() -> None:
    envs, rng, seeds = make_runs(mixed(), 5, "SameStep"), np.random.default_rng(0), [11, 7, 5, 3, 2]
    assert isinstance(envs, SameArmMixture)
    one = make_runs(mixed(plant="qiao2026"), 3, "SameStep")
    other = SameArmVector(make_environment(mixed(), 2, "SameStep", 1), **(mixed().remembering or {}))
    assert other.run.task.plant.name == "orchard"
    parts = [(slice(0, 3), one), (slice(3, 5), other)]
    seen, infos = envs.reset(seed=seeds)
    assert envs.observation_space.contains(seen)
    for rows, part in parts:
        mine, told = part.reset(seed=seeds[rows])
        np.testing.assert_array_equal(seen[rows], mine)
        np.testing.assert_equal(rows_of(infos, rows), told)
    for _ in range(envs.run.picks + 1):
        actions = rng.uniform(-1, 1, (5, 3))
        done = envs.step(actions)
        for rows, part in parts:
            *alone, told = part.step(actions[rows])
            for column, mine in zip(done[:4], alone, strict=True):
                np.testing.assert_array_equal(column[rows], mine)
            np.testing.assert_equal(rows_of(done[4], rows), rows_of(told, slice(None)))
    with pytest.raises(InputError):
        envs.step(np.zeros((6, 3)))
    with pytest.raises(InputError, match="arm"):
        envs.reset(options={"arm": 0})


def test_no_two_plants_draw_their_arms_from_one_stream() -> None:
    """The same plant twice is two populations, and the first is the one that it is alone."""
    numbers = inputs_of(mixed(plant=["orchard", "orchard"]))["arms"].split()
    assert numbers[0] != numbers[1] and numbers[0] == inputs_of(mixed(plant="orchard"))["arms"]
    assert inputs_of(mixed(plant=["orchard"]))["arms"] == numbers[0]


class Killed(Exception):
    """Stands for whatever ends a program."""


@pytest.mark.parametrize("algorithm", ["ppo_lstm", pytest.param("ppo_history", marks=pytest.mark.slow)])
def test_a_mixture_is_learnt_and_goes_on_to_the_bit(algorithm: str, tmp_path, monkeypatch) -> None:
    """Checkpoints fall between the picks of runs, for the recurrent policy, and between runs."""
    how = FEW | {"n_steps": 8 if algorithm == "ppo_lstm" else 20}
    training = mixed(algorithm, steps=2 * 5 * how["n_steps"], checkpoint_every=5 * how["n_steps"], parameters=how)
    monkeypatch.setattr(module.training_setup, "judge", lambda policy, training: {"mean_mm": 0.0})
    whole = train(training, tmp_path / "whole").policy
    save = module.save_checkpoint

    def killed(*arguments):
        save(*arguments)
        raise Killed

    with monkeypatch.context() as patch, pytest.raises(Killed):
        patch.setattr(module, "save_checkpoint", killed)
        train(training, tmp_path / "broken")
    assert resumed(tmp_path / "broken") == training
    again = train(training, tmp_path / "broken", resume=True).policy
    model, env = make_model(training)
    untrained = actor_of(model, training, env)
    for one, other, before in zip(whole.weights, again.weights, untrained.weights, strict=True):
        np.testing.assert_array_equal(one, other)
        assert not np.array_equal(one, before)
    np.testing.assert_equal(dict(whole.arrays), dict(again.arrays))


def test_a_policy_is_judged_on_the_arms_of_every_plant(monkeypatch) -> None:
    judged, real = [], module.training_setup.make_runs

    def few(training, count, mode):
        judged.append(real(training, 4, mode))
        return judged[-1]

    monkeypatch.setattr(module.training_setup, "make_runs", few)
    model, env = make_model(mixed())
    policy = actor_of(model, mixed(), env)
    assert policy.arm_fingerprint == load_arm("qiao2026").fingerprint()
    numbers = module.training_setup.judge(policy, mixed())
    assert 0.0 < numbers["mean_mm"] < numbers["p95_mm"]
    assert [part.run.task.plant.name for part in judged[-1].parts] == PAIR


def test_a_plant_of_several_must_not_change_and_is_named(tmp_path) -> None:
    shutil.copy(PLANTS / "orchard.toml", tmp_path / "mine.toml")
    training = mixed(plant=["qiao2026", str(tmp_path / "mine.toml")])
    begun = inputs_of(training)
    check_inputs(training, begun)
    text = (tmp_path / "mine.toml").read_text(encoding="utf-8")
    (tmp_path / "mine.toml").write_text(text.replace("length_mm = 400.0", "length_mm = 410.0"), encoding="utf-8")
    with pytest.raises(InputError, match=r"plant \S+mine\.toml \(`plant`, or its tolerances\) has other numbers"):
        check_inputs(training, begun)
    (tmp_path / "mine.toml").unlink()
    with pytest.raises(InputError, match=r"plant \S+mine\.toml \(`plant`\) is missing; put back"):
        check_inputs(training, begun)


@pytest.mark.parametrize(
    ("training", "said"),
    [
        (mixed("ppo", parameters={}), r"ppo was given 2 plants .* give one, or several to an algorithm that remembers"),
        (mixed(plant=[]), "ppo_history was given 0 plants"),
        (mixed(plant=["qiao2026", "so101"]), "needs plants of one nominal arm, and runs alike; .* qiao2026, so101"),
        (mixed(parameters=FEW | {"n_envs": 1}), "n_envs is 1; give at least 2, one environment per plant"),
        (mixed(plant=["qiao2026", "apple"]), "apple"),
    ],
)
def test_the_impossible_is_refused_in_one_sentence(training: Training, said: str) -> None:
    with pytest.raises(InputError, match=said) as caught:
        make_model(training)
    assert "\n" not in str(caught.value)


def test_the_shell_repeats_the_option(tmp_path, monkeypatch) -> None:
    app, begun = Typer(), []

    def begin(training, out, **_):
        begun.append(training)
        raise Killed

    app.command()(commands.train)
    app.command("other")(commands.evaluate)
    monkeypatch.setattr(commands.pickenv.agents, "train", begin)
    for plants in (PAIR, PAIR[:1], []):
        words = [word for plant in plants for word in ("--plant", plant)]
        CliRunner().invoke(app, ["train", "--algo", "ppo_history", *words, "--out", str(tmp_path)])
    assert [training.arguments.get("plant") for training in begun] == [PAIR, "qiao2026", None]
    monkeypatch.setattr("pickenv.agents.training.training.resumed", lambda out: begun[0])
    resume = ["train", "--resume", "--out", str(tmp_path), "--plant", "qiao2026", "--plant"]
    said = CliRunner().invoke(app, [*resume, "field"]).exception
    assert "was begun with --plant qiao2026 --plant orchard, not qiao2026 --plant field;" in str(said)
    assert isinstance(CliRunner().invoke(app, [*resume, "orchard"]).exception, Killed)
