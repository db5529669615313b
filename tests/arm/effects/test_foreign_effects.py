"""An effect of another package: in plant files, draws, tables and environments, and in files that must find it."""

import json
import sys
from dataclasses import replace
from typing import Annotated

import gymnasium as gym
import numpy as np
import pytest

import pickenv
from pickenv.arm import (
    GEAR,
    PER_JOINT,
    PLANTS,
    TOOL,
    Components,
    Effect,
    Passage,
    Plant,
    Scalar,
    draw_plants,
    effect_shares,
    load_plant,
    load_tolerances,
    plant_at,
)
from pickenv.base import ARCMIN, MM, SECONDS, InputError, registry, toml_table
from pickenv.calibration import random_joints
from pickenv.commands.plants import effects as effects_command
from pickenv.experiments.study import deviations
from pickenv.experiments.study_variance import tolerance_groups
from pickenv.inspect.runs.run_folder import load_numbers, save_numbers

MEDIUM = load_tolerances("medium")


@pickenv.register("effect", "belt_creep")
@toml_table
class BeltCreep(Effect, place=GEAR + 0.7, spreads={"time": 0.3}):
    """Belts that follow a move in part at once, and the rest of it exponentially.

    Attributes:
        stretch: How far each joint stays behind at first, as a share of its way.
        time: Time constant, s.
        slack: Constant lag, rad or m.
    """

    stretch: Annotated[tuple[Scalar, ...], PER_JOINT]
    time: Annotated[Scalar, SECONDS.positive]
    slack: Annotated[Scalar, ARCMIN.not_negative] = 0.0

    def act(self, at: Passage, memory: Components) -> None:
        """Put the joints where the belts hold them."""
        numbers = zip(at.joints, memory, self.stretch, strict=True)
        at.joints = [value + share * (belt - value) - self.slack for value, belt, share in numbers]

    def begin(self, at: Passage) -> Components:
        """Belts at rest."""
        return tuple(at.joints)

    def carry(self, at: Passage, memory: Components, dt: Scalar) -> Components:
        """Belts that creep."""
        faded = at.m.exp(at.command[0] * 0.0 - dt / self.time)
        return tuple(value + (belt - value) * faded for value, belt in zip(at.joints, memory, strict=True))


@pickenv.register("effect", "tool_wobble")
@toml_table
class ToolWobble(Effect, place=TOOL + 0.2):
    """A tool that wobbles by NumPy's own functions, which neither torch nor a compiler can follow."""

    size: Annotated[Scalar, MM]

    def act(self, at: Passage, memory: Components) -> None:
        """Displace the tool."""
        *axes, x, y, z = at.frame
        turn = np.hypot(np.asarray(at.joints[0]), 1.0)
        at.frame = (*axes, x + self.size * turn, y, z)


@pytest.fixture
def path(tmp_path):
    text = (PLANTS / "orchard.toml").read_text(encoding="utf-8")
    path = tmp_path / "belts.toml"
    path.write_text(text + "\n[belt_creep]\nstretch = [0.1, 0.1, 0, 0, 0.1, 0.1]\ntime_s = 0.2\n", encoding="utf-8")
    return path


def test_its_table_in_a_plant_file_is_checked_like_every_other(path):
    plant = load_plant(path)
    assert plant.effect("belt_creep") == BeltCreep((0.1, 0.1, 0.0, 0.0, 0.1, 0.1), 0.2)
    assert plant.without("belt_creep").names == load_plant("orchard").names
    assert plant.names == [*load_plant("orchard").names, "belt_creep"]
    order = [effect.name for effect in plant.effects]
    assert order.index("backlash") < order.index("belt_creep") < order.index("joint_compliance")
    sound = path.read_text(encoding="utf-8")
    for old, new, words in (
        ("time_s = 0.2", "time_s = 0.0", ["time_s", "[belt_creep]", "above zero"]),
        ("stretch = [0.1, ", "stretch = [", ["stretch", "6 entries"]),
        ("[belt_creep]", "[belt_creeps]", ["unknown key 'belt_creeps'"]),
    ):
        path.write_text(sound.replace(old, new), encoding="utf-8")
        with pytest.raises(InputError) as caught:
            load_plant(path)
        assert all(word in str(caught.value) for word in (str(path), *words))


def test_arms_are_drawn_with_its_spread_and_as_without_it(path):
    plant = load_plant(path)
    arms = draw_plants(plant, MEDIUM, 3000, np.random.default_rng(0))
    sizes = np.log(arms.effect("belt_creep").time / 0.2)
    assert sizes.std() == pytest.approx(0.3, rel=0.05) and abs(sizes.mean()) < 0.02
    bare = draw_plants(plant.without("belt_creep"), MEDIUM, 3, np.random.default_rng(0))
    for i in range(3):
        assert plant_at(arms, i).without("belt_creep").effects == plant_at(bare, i).effects
        np.testing.assert_array_equal(arms.geometry.a[i], bare.geometry.a[i])
    few = draw_plants(plant, MEDIUM, 3, np.random.default_rng(0))
    columns = deviations(plant, few)
    np.testing.assert_allclose(columns["size_belt_creep"], few.effect("belt_creep").time / 0.2)
    assert len(tolerance_groups(plant)["belt creep"]) == 1


def test_it_has_its_row_in_tables(path, tmp_path, capsys):
    plant = load_plant(path)
    shares = effect_shares(plant, random_joints(plant.arm.nominal, 5, np.random.default_rng(0)))
    assert (
        shares["alone"]["belt_creep"]["mean"] > 1e-3
        and shares["without"]["belt_creep"]["mean"] != shares["all"]["mean"]
    )
    effects_command(str(path), reaches=2, json_file=tmp_path / "effects.json")
    assert "belt creep" in capsys.readouterr().out
    assert "belt_creep" in json.loads((tmp_path / "effects.json").read_text())["alone"]


def rolled(envs, steps=6):
    observation, _ = envs.reset(seed=1)
    seen, rng = [observation], np.random.default_rng(0)
    for _ in range(steps):
        observation, reward, *_ = envs.step(rng.uniform(-1, 1, envs.action_space.shape).astype(np.float32))
        seen += [observation, reward]
    return seen


@pytest.mark.parametrize("arms", ["fixed", "per_env"])
def test_native_environments_of_arms_that_have_it_are_the_single_ones(path, arms):
    name, given = "pickenv/Reach-v0", {"plant": str(path), "feedback": "camera"}
    arrays, compiled = (
        rolled(gym.make_vec(name, num_envs=3, executor=kind, arms=arms, **given)) for kind in ("numpy", "compiled")
    )
    for one, other in zip(arrays, compiled, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-6, atol=1e-9)
    if arms == "fixed":
        alone = gym.make_vec(name, num_envs=3, vectorization_mode="sync", **given)
        for one, other in zip(arrays, rolled(alone), strict=True):
            np.testing.assert_allclose(one, other, atol=1e-6)
        tensors = gym.make_vec(name, num_envs=3, executor="torch", compiled=False, **given)
        for one, other in zip(arrays, rolled(tensors), strict=True):
            np.testing.assert_allclose(one, np.asarray(other), atol=1e-6)


def test_what_torch_or_a_compiler_cannot_follow_is_told_in_one_sentence(tmp_path):
    path, name = tmp_path / "wobbling.toml", "pickenv/Reach-v0"
    path.write_text('arm = "qiao2026"\n[tool_wobble]\nsize_mm = 1.0\n', encoding="utf-8")
    given = {"num_envs": 3, "plant": str(path)}
    assert np.isfinite(rolled(gym.make_vec(name, executor="numpy", **given))[-1]).all()
    wanted = r"'{}' cannot compute the plant with the effect tool_wobble \(.*give executor='numpy', or let"
    with pytest.raises(InputError, match=wanted.format("compiled")):
        rolled(gym.make_vec(name, executor="compiled", **given))
    with pytest.raises(InputError, match=wanted.format("torch")):
        gym.make_vec(name, executor="torch", device="meta", **given)


SAG = """
from dataclasses import dataclass
from pickenv.arm import Effect
from pickenv.arm.effects.effect import TOOL

@dataclass(frozen=True)
class Part:
    size: float

@dataclass(frozen=True)
class LabSag(Effect, place=TOOL):
    part: Part

    def act(self, at, memory):
        at.frame = (*at.frame[:11], at.frame[11] - self.part.size)
"""


def test_a_run_s_file_names_the_package_whose_effect_it_needs(tmp_path, monkeypatch):
    """It is read where the package is installed, and refused with its name and version where it is not."""
    folder = tmp_path / "site"
    info = folder / "lab_effects-1.2.dist-info"
    info.mkdir(parents=True)
    (folder / "lab_sag_module.py").write_text(SAG)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: lab-effects\nVersion: 1.2\n")
    (info / "entry_points.txt").write_text("[pickenv.effect]\nlab_sag = lab_sag_module:LabSag\n")
    (info / "top_level.txt").write_text("lab_sag_module\n")
    monkeypatch.setattr(registry, "_entries", {kind: dict(own) for kind, own in registry._entries.items()})
    with monkeypatch.context() as there:
        there.syspath_prepend(folder)
        import lab_sag_module

        plant = load_plant("qiao2026").with_effect(lab_sag_module.LabSag(lab_sag_module.Part(0.002)))
        path = save_numbers(tmp_path / "run.npz", plant)
        back = load_numbers(path, Plant, "pickenv demo")
        assert back.effects == plant.effects and back.names[-1] == "lab_sag"
    registry._entries["effect"].pop("lab_sag", None)
    monkeypatch.delitem(sys.modules, "lab_sag_module")
    wanted = r"run\.npz: effect 'lab_sag' comes from the package lab-effects 1\.2, which is not installed: pip install"
    with pytest.raises(InputError, match=wanted):
        load_numbers(path, Plant, "pickenv demo")


def test_a_name_stands_for_one_effect():
    wobble = ToolWobble(1e-3)
    with pytest.raises(ValueError, match="give each once"):
        replace(load_plant("qiao2026"), effects=(wobble, replace(wobble, size=2e-3)))
    plant = load_plant("qiao2026").with_effect(wobble).with_effect(replace(wobble, size=2e-3))
    assert plant.effect("tool_wobble").size == 2e-3
    with pytest.raises(ValueError, match="unknown effect 'wobble'"):
        plant.without("wobble")


def test_an_effect_that_is_none_is_refused_where_a_plant_file_names_it(tmp_path, monkeypatch):
    monkeypatch.setattr(registry, "_entries", {kind: dict(own) for kind, own in registry._entries.items()})
    pickenv.register("effect", "nothing")(dict)
    path = tmp_path / "plant.toml"
    path.write_text('arm = "qiao2026"\n[nothing]\n', encoding="utf-8")
    with pytest.raises(InputError, match=r"effect 'nothing' is registered, but is no class of pickenv\.arm\.Effect"):
        load_plant(path)
