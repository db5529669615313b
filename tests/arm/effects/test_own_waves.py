"""Waves that an arm has for itself: spread as the plant file says, others in every arm, alike on all executors."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from scipy import stats

from pickenv.arm import PLANTS, draw_plants, forward, load_plant, load_tolerances, plant_at, shipped_effects
from pickenv.arm.effects.residual_field import StructureTable, local_structure_of, standard_normal_of
from pickenv.base import InputError

EFFECTS = shipped_effects()

FIELD = load_plant("field")
MEDIUM = load_tolerances("medium")


def only(effect):
    return FIELD.without([name for name in EFFECTS if name != effect])


@pytest.fixture(scope="module")
def arms():
    return draw_plants(FIELD, MEDIUM, 300, np.random.default_rng(11))


def test_even_numbers_become_normal_ones_by_their_quantiles_and_their_ends_are_finite():
    even = np.linspace(0.0, 1.0, 21)
    found = standard_normal_of(even)
    np.testing.assert_allclose(stats.norm.cdf(found), even, rtol=0, atol=1e-9)
    np.testing.assert_allclose(found, -found[::-1], rtol=1e-6, atol=1e-12)
    assert 7.0 < found[-1] < 8.0


def test_every_arm_has_orders_amplitudes_and_phases_of_its_own(arms):
    for harmonic in arms.effect("drive_harmonics").harmonics:
        for sizes in (harmonic.amplitude, harmonic.period, harmonic.phase):
            assert len(np.unique(sizes)) == 300


def test_orders_lie_evenly_between_their_bounds_and_coefficients_fall_with_them(arms):
    spread = arms.effect("drive_harmonics").spread
    for wave, harmonic in zip(spread, arms.effect("drive_harmonics").harmonics, strict=True):
        place = (1 / harmonic.period - 1 / wave.longest) / (1 / wave.shortest - 1 / wave.longest)
        assert place.min() >= 0 and place.max() <= 1
        assert place.mean() == pytest.approx(0.5, abs=0.07) and place.std() == pytest.approx(12**-0.5, abs=0.04)
        std = wave.std * (harmonic.period / wave.longest) ** wave.decay
        # two normal coefficients: the square of their length over the variance has mean 2 and variance 4
        assert np.mean((harmonic.amplitude / std) ** 2) == pytest.approx(2.0, abs=0.5)
        assert abs(np.exp(1j * harmonic.phase).mean()) < 0.25


def test_a_wave_is_its_two_coefficients():
    drives = FIELD.effect("drive_harmonics")
    spread = drives.spread[:1]
    found = replace(drives, spread=spread).of_numbers(np.array([0.25, 0.9, 0.2])).harmonics[0]
    per = 0.75 / spread[0].longest + 0.25 / spread[0].shortest
    assert found.period == pytest.approx(1 / per)
    std = spread[0].std / (per * spread[0].longest) ** spread[0].decay
    sine, cosine = std * 1.2815515655446004, std * -0.8416212335729143  # normal quantiles of 0.9 and 0.2
    for x in (0.0, 0.4):
        angle = 2 * math.pi * per * x
        expected = sine * math.sin(angle) + cosine * math.cos(angle)
        assert found.amplitude * math.sin(angle + found.phase) == pytest.approx(expected, abs=1e-15)


def test_a_wave_of_one_arm_is_plain_numbers_and_those_of_many_lie_along_an_axis():
    drives = FIELD.effect("drive_harmonics")
    even = np.random.default_rng(0).random((4, 3 * len(drives.spread)))
    many = drives.of_numbers(even).harmonics
    for i in range(4):
        for wave, alone in zip(many, drives.of_numbers(even[i]).harmonics, strict=True):
            assert all(type(size) is float for size in (alone.amplitude, alone.period, alone.phase))
            assert (wave.amplitude[i], wave.period[i], wave.phase[i]) == (alone.amplitude, alone.period, alone.phase)


def test_the_structure_is_a_sum_of_waves_whose_draws_are_the_files_seed_after_seed():
    """Frequencies are normal numbers over the lengths of the file's joints, weights normal over arms; none is left."""
    lengths = np.array([np.radians(1.5), 0.04, np.inf, np.radians(3.0), np.inf, np.inf])
    joints = tuple(SimpleNamespace(joint=j, length=lengths[j]) for j in (0, 1, 3))
    table = StructureTable(seed=7, position=3e-4, waves=5, joints=joints)
    found = local_structure_of(table, {"arm": FIELD.arm})
    rng = np.random.default_rng(7)
    frequency = (rng.standard_normal((6, 15)) / lengths[:, None]).astype(np.float32)
    np.testing.assert_allclose(found.field.features.frequency, frequency, rtol=1e-6)
    assert not found.field.features.frequency[[2, 4, 5]].any()
    even = rng.random(30)
    weight = (3e-4 / math.sqrt(5) * stats.norm.ppf(even)).reshape(3, 2, 5)
    np.testing.assert_allclose(found.field.weight, weight, rtol=1e-6)
    assert found.weights == 30 and found.std == pytest.approx(3e-4 / math.sqrt(5))
    others = np.random.default_rng(1).random((2, 30))
    drawn = found.of_numbers(others)
    np.testing.assert_allclose(drawn.field.weight[1], found.std * stats.norm.ppf(others[1]).reshape(3, 2, 5), rtol=1e-6)
    q = [0.3, 0.2, 0.5, -0.4, 0.1, 1.0]
    waves = (np.array(q) @ frequency).reshape(3, 5)
    expected = (weight[:, 0] * np.cos(waves) + weight[:, 1] * np.sin(waves)).sum(axis=1)
    plant = FIELD.without(EFFECTS).with_effect(found)
    moved = plant.tool_pose(q).position - forward(FIELD.geometry, q).position
    np.testing.assert_allclose(moved, expected, rtol=0, atol=2e-9)


def test_the_structure_has_its_size_and_length_in_every_direction(arms):
    """Over arms the displacement is normal with the kernel exp(-r^2 / 2) of a Gaussian process, as far as waves go."""
    plant = only("local_structure")
    drawn = draw_plants(plant, MEDIUM, 4000, np.random.default_rng(5))
    straight = drawn.without(["local_structure"])
    nominal = plant.arm.nominal
    q = (nominal.lower + nominal.upper) / 2

    def moved(at):
        return drawn.tool_pose(at).position - straight.tool_pose(at).position

    here = moved(q)
    size = plant.effect("local_structure").std * math.sqrt(plant.effect("local_structure").field.features.count)
    np.testing.assert_allclose(here.std(axis=0), size, rtol=0.05)
    np.testing.assert_allclose(np.corrcoef(here.T)[np.triu_indices(3, 1)], 0, atol=0.06)
    lengths = 1 / np.abs(plant.effect("local_structure").field.features.frequency).max(axis=1, initial=1e-30)
    for joint in np.flatnonzero(lengths < 1e3):
        near, far = (moved(q + np.eye(6)[joint] * steps * lengths[joint]) for steps in (0.05, 20.0))
        assert np.corrcoef(here[:, 0], near[:, 0])[0, 1] > 0.9
        assert abs(np.corrcoef(here[:, 0], far[:, 0])[0, 1]) < 0.6
    for joint in np.flatnonzero(lengths > 1e3):
        np.testing.assert_allclose(moved(q + 0.05 * np.eye(6)[joint]), here, rtol=0, atol=1e-9)


@pytest.mark.parametrize("effect", ["drive_harmonics", "local_structure"])
def test_floats_arrays_and_tensors_agree(effect, draw):
    plant, q = only(effect), draw(FIELD.geometry, 20)
    arrays = plant.tool_pose(q).position
    assert 1e-5 < np.abs(arrays - forward(FIELD.geometry, q).position).max() < 3e-3
    floats = np.array([plant.tool_frame(math, row)[9:] for row in q.tolist()])
    tensors = torch.stack(plant.tool_frame(torch, torch.tensor(q).unbind(-1))[9:], -1).numpy()
    np.testing.assert_allclose(arrays, floats, rtol=0, atol=2e-9)  # waves are taken in single precision
    np.testing.assert_allclose(tensors, floats, rtol=0, atol=2e-8)


def test_an_arm_alone_is_that_arm_of_the_batch(arms, draw):
    q = draw(FIELD.geometry, 3)
    for i in (0, 7):
        many = arms.tool_pose(q[:, None]).position[:, i]
        np.testing.assert_allclose(plant_at(arms, i).tool_pose(q).position, many, rtol=0, atol=1e-9)


@pytest.mark.parametrize("effect", ["transmission_error", "drive_harmonics", "slide_compliance"])
def test_without_an_effect_an_arm_keeps_its_own_waves(effect):
    whole, rest = (draw_plants(p, MEDIUM, 3, np.random.default_rng(1)) for p in (FIELD, FIELD.without([effect])))
    np.testing.assert_array_equal(
        whole.effect("local_structure").field.weight, rest.effect("local_structure").field.weight
    )
    if effect != "drive_harmonics":
        for a, b in zip(
            whole.effect("drive_harmonics").harmonics, rest.effect("drive_harmonics").harmonics, strict=True
        ):
            np.testing.assert_array_equal(a.amplitude, b.amplitude)


MISTAKES = {
    "negative seed": ("seed = 2026", "seed = -1", ["seed", "[drive_harmonics]"]),
    "rising with the order": ("decay = 0.31", "decay = -0.31", ["decay", "[drive_harmonics]"]),
    "half a wave": ("waves = 5,", "waves = 2.5,", ["waves", "whole number"]),
    "periods the wrong way round": ("shortest_deg = 12.0", "shortest_deg = 150.0", ["shortest period of joint 1"]),
    "periods alike": ("shortest_deg = 12.0", "shortest_deg = 120.0", ["shortest period of joint 1"]),
    "no structure": ("waves = 32", "waves = 0", ["waves", "[local_structure]"]),
    "no length": ("length_mm = 42.0", "length_mm = 0.0", ["length_mm", "[local_structure.joints]"]),
    "a length twice": ("joint = 2, length_mm = 42.0", "joint = 1, length_deg = 3.0", ["joint 1", "each joint once"]),
}


@pytest.mark.parametrize(("old", "new", "named"), MISTAKES.values(), ids=MISTAKES)
def test_a_mistake_is_named_with_file_and_key(tmp_path, old, new, named):
    path, text = tmp_path / "plant.toml", (PLANTS / "field.toml").read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(InputError) as caught:
        load_plant(path)
    for word in (str(path), *named):
        assert word in str(caught.value)


def test_the_design_is_one_draw_and_always_the_same():
    again = load_plant("field")
    assert again.effect("drive_harmonics") == FIELD.effect("drive_harmonics")
    np.testing.assert_array_equal(
        again.effect("local_structure").field.weight, FIELD.effect("local_structure").field.weight
    )
