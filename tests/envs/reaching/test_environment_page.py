"""The page of the environments says what the registry, the ladder and the signatures say."""

import inspect
import re
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

import pickenv  # noqa: F401, registers the environments
from pickenv.envs import EYES, LADDER, LADDER_VERSION
from pickenv.envs.shared.difficulty import POPULATION
from pickenv.envs.shared.situation import make_situation
from pickenv.orchard import load_sight_errors

PAGE = (Path(__file__).parents[3] / "docs" / "environments.md").read_text(encoding="utf-8")


def table(first):
    """Rows of the table whose head begins with a word, without their marks of code."""
    lines = PAGE[PAGE.index(f"| {first} |") :].split("\n\n")[0].splitlines()
    rows = [[cell.strip().replace("`", "") for cell in line.strip("| ").split("|")] for line in lines]
    return rows[0], [row + [""] * (len(rows[0]) - len(row)) for row in rows[2:]]


def width(space):
    spaces = list(space.values()) if isinstance(space, gym.spaces.Dict) else [space]
    return " + ".join(str(part.shape[0]) for part in spaces)


def test_every_environment_has_its_row():
    _, rows = table("id")
    assert sorted(row[0] for row in rows) == sorted(name for name in gym.registry if name.startswith("pickenv/"))
    for name, _, observation, actions, native, steps in rows:
        env, spec = gym.make(name), gym.spec(name)
        assert (observation, actions) == (width(env.observation_space), width(env.action_space))
        assert (native == "yes") == bool(spec.vector_entry_point)
        assert int(steps) == spec.max_episode_steps


def test_every_argument_of_a_situation_has_its_row():
    _, rows = table("argument")
    wanted = inspect.signature(make_situation).parameters
    assert {row[0]: row[1] for row in rows} == {name: str(given.default) for name, given in wanted.items()}
    for card in (gym.spec(name).entry_point for name in ("pickenv/Reach-v0", "pickenv/Pick-v0")):
        module, _, attribute = card.partition(":")
        text = inspect.getdoc(getattr(__import__(module, fromlist=[attribute]), attribute))
        assert all(f"`{name}`" in text for name in wanted)


def test_the_ladder_is_the_one_that_environments_climb():
    head, rows = table("`difficulty`")
    assert [row[0] for row in rows] == list(LADDER)
    for name, *cells in rows:
        said = dict(zip(head[1:], cells, strict=True))
        assert {key: text for key, text in said.items() if text} == {key: str(v) for key, v in LADDER[name].items()}
    sentence = PAGE[PAGE.index("`own_eyes` adds") :].split("\n")[0]
    assert set(re.findall(r"`(\w+=[^`]+)`", sentence)) == {
        f'{key}="{value}"' if isinstance(value, str) else f"{key}={value}"
        for eyes in EYES.values()
        for key, value in eyes.items()
    }
    assert all(f"{count} " in PAGE for count in POPULATION.values())


def test_the_eyes_of_reach_are_those_of_the_pictures():
    """Root mean squares over axes and ranges of the tables that were read off rendered pictures."""
    for name, table in (("fruit_noise_mm", "li2016-li2016"), ("camera_noise_mm", "li2016_bare-circles")):
        errors = load_sight_errors(table)
        square = (np.square(errors.bias) + np.square(errors.spread)).mean(axis=1)
        whole = 1e3 * np.sqrt(np.average(square, weights=errors.recall))
        assert EYES["Reach"][name] == round(whole, 1)
    assert f"now {LADDER_VERSION};" in PAGE


@pytest.mark.parametrize("number", range(4))
def test_examples_run(number):
    blocks = re.findall(r"```python\n(.*?)```", PAGE, flags=re.S)
    assert len(blocks) == 4
    exec(blocks[0].split("env =")[0] + blocks[number], {})
