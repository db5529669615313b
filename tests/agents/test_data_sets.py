"""Data sets: Minari reads them, their environment replays them; whole or not there, kept and not made again."""

import gc
import json
import shutil

import gymnasium as gym
import numpy as np
import pytest

from pickenv.agents import datasets
from pickenv.base import InputError
from pickenv.cli import main
from tests.drawing import where_mujoco_draws

# Minari leaves its temporary folders to the garbage collector.
pytestmark = pytest.mark.filterwarnings("ignore:Implicitly cleaning up:ResourceWarning")
NAME = "pickenv/reach/expert-v0"


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    out = tmp_path_factory.mktemp("sets")
    yield out, datasets(out, episodes=3, seed=5)
    gc.collect()


def read(out, name):
    minari = pytest.importorskip("minari")
    return minari.MinariDataset(out / name / "data")


def test_what_was_recorded_is_what_the_environment_does_again(made):
    out, cards = made
    assert [card["name"].split("/")[-1] for card in cards] == ["expert-v0", "medium-v0", "random-v0"]
    for card in cards:
        data = read(out, card["name"])
        env = data.recover_environment(executor="numpy")  # to the bit what many at once are
        assert env.spec.id == card["environment"] == "pickenv/ReachScaled-v0"
        assert (data.total_episodes, data.total_steps) == (3, card["steps"]) == (3, 180)
        for episode, seed in zip(data, card["seeds"], strict=True):
            again = [env.reset(seed=seed)[0]]
            rewards = []
            for action in episode.actions:
                seen, reward, *_ = env.step(action)
                again.append(seen)
                rewards.append(reward)
            np.testing.assert_array_equal(episode.observations, again)
            np.testing.assert_array_equal(episode.rewards, rewards)
            assert episode.truncations[-1] and not episode.terminations.any()


def test_cards_say_what_is_in_them_and_that_it_is_simulated(made):
    out, cards = made
    assert all(json.loads((out / card["name"] / "card.json").read_text("utf-8")) == card for card in cards)
    assert {card["licence"] for card in cards} == {"MIT"} and all(card["simulated"] for card in cards)
    assert len({seed for card in cards for seed in card["seeds"]}) == 9
    errors = [card["final_error_mm"] for card in cards]
    assert errors[0] < 3.0 < errors[2] and cards[0]["mean_return"] > cards[1]["mean_return"] > cards[2]["mean_return"]


def test_equal_seeds_give_equal_numbers_and_what_is_there_is_kept(made, tmp_path):
    out, cards = made
    again = datasets(tmp_path, qualities=["expert"], episodes=3, seed=5)
    other = datasets(tmp_path / "other", qualities=["expert"], episodes=3, seed=6)
    assert again[0]["content_sha256"] == cards[0]["content_sha256"] != other[0]["content_sha256"]
    before = {path: path.stat().st_mtime_ns for path in (out / "pickenv").rglob("*")}
    assert datasets(out, episodes=3, seed=5) == cards
    assert before == {path: path.stat().st_mtime_ns for path in (out / "pickenv").rglob("*")}


def test_demonstrations_to_see_are_small_and_hold_pictures_joints_and_both_arms(tmp_path):
    pytest.importorskip("mujoco")
    with where_mujoco_draws():
        (card,) = datasets(tmp_path, ["sight"], ["medium"], episodes=1, seed=3)
    assert card["success"] == 1.0 and card["arguments"]["error_mm"] == 5.0
    assert card["arms"]["believed"] != card["arms"]["true"]
    data = read(tmp_path, card["name"])
    env = data.recover_environment()
    for episode, seed in zip(data, card["seeds"], strict=True):
        first = env.reset(seed=seed)[0]
        for action in episode.actions:
            last = env.step(action)[0]
        for place, seen, other in ((0, first, last), (-1, last, first)):
            recorded = episode.observations["pixels"]["wrist"][place].astype(float)  # Minari keeps them as JPEG
            off, apart = (np.abs(recorded - view["pixels"]["wrist"]).mean() for view in (seen, other))
            assert off < 0.5 * apart
            np.testing.assert_array_equal(episode.observations["agent_pos"][place], seen["agent_pos"])
    bytes_of_an_episode = sum(file.stat().st_size for file in (tmp_path / card["name"]).rglob("*.hdf5"))
    assert bytes_of_an_episode < 5e6 / 50
    assert (
        datasets(tmp_path / "again", ["sight"], ["medium"], episodes=1, seed=3)[0]["content_sha256"]
        == (card["content_sha256"])
    )


def test_what_was_changed_or_made_otherwise_is_refused(made, tmp_path):
    out, _ = made
    with pytest.raises(InputError, match=r"expert-v0 was made with seed 5, not 6 and episodes 3, not 4; take it away"):
        datasets(out, episodes=4, seed=6)
    shutil.copytree(out / "pickenv", tmp_path / "pickenv")
    with (tmp_path / NAME / "data" / "metadata.json").open("a", encoding="utf-8") as file:
        file.write(" ")
    with pytest.raises(InputError, match="expert-v0 was changed since it was written; take it away"):
        datasets(tmp_path, episodes=3, seed=5)
    (tmp_path / NAME / "card.json").unlink()
    with pytest.raises(InputError, match="expert-v0 has no card of a data set"):
        datasets(tmp_path, episodes=3, seed=5)
    with pytest.raises(InputError, match="quality is 'good'; give one of expert, medium, random"):
        datasets(tmp_path, qualities=["good"])


def test_what_was_cut_off_leaves_no_data_set(tmp_path):
    def interrupt(name, done, total):
        if done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        datasets(tmp_path, episodes=2, progress=interrupt)
    assert not [path for path in tmp_path.rglob("*") if path.name != ".lock"]


def test_the_command_says_what_it_recorded(tmp_path, monkeypatch, capsys):
    told = tmp_path / "cards.json"
    monkeypatch.chdir(tmp_path)
    words = ["--quality", "random", "--episodes", "2", "--out", "sets", "--json", str(told)]
    monkeypatch.setattr("sys.argv", ["pickenv", "datasets", *words])
    with pytest.raises(SystemExit) as ended:
        main()
    said = capsys.readouterr().out
    assert ended.value.code == 0 and "pickenv/reach/random-v0" in said and "MINARI_DATASETS_PATH" in said
    (card,) = json.loads(told.read_text("utf-8"))
    assert f"{card['final_error_mm']:.2f}" in said


@pytest.mark.slow
def test_canopies_are_recorded_too(tmp_path):
    cards = datasets(tmp_path, ["pick"], ["expert", "random"], episodes=1)
    assert cards[0]["collected"] > cards[1]["collected"] == 0.0
    for card in cards:
        data = read(tmp_path, card["name"])
        env = data.recover_environment()
        assert env.spec.id == "pickenv/Pick-v0" == gym.spec("pickenv/Pick-v0").id
        (episode,) = data
        np.testing.assert_array_equal(env.reset(seed=card["seeds"][0])[0], episode.observations[0])
        for i, action in enumerate(episode.actions[:40]):
            np.testing.assert_array_equal(env.step(action)[0], episode.observations[i + 1])


def test_scenes_are_recorded_with_the_arm_that_they_are_of(tmp_path):
    good, bad = datasets(tmp_path, ("scene",), ("expert", "medium"), episodes=1, seed=3)
    assert good["arguments"] == {"plant": "ideal:so101"} and bad["arguments"]["error_mm"] == 5.0
    assert 0.0 <= bad["success"] <= good["success"] <= 1.0
    data = read(tmp_path, "pickenv/scene/medium-v0")
    episode = data[0]
    env = data.recover_environment()
    observation, _ = env.reset(seed=bad["seeds"][0])
    for step, action in enumerate(episode.actions):
        np.testing.assert_array_equal(observation, episode.observations[step])
        observation, *_ = env.step(action)
