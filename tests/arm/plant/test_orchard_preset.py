"""The preset with every effect on: plausible sizes, switches, executors, and refusal of impossible numbers."""

import json
import math
import re

import numpy as np
import pytest
import torch

from pickenv.arm import (
    PLANTS,
    Pace,
    causes_of,
    effect_shares,
    forward,
    load_plant,
    pose_of,
    shares_report,
    shipped_effects,
)
from pickenv.base import InputError
from pickenv.calibration import random_joints

EFFECTS = shipped_effects()

OWN = ("drive_harmonics", "local_structure")
"""Waves that only measured arms tell of: the preset `field` has them."""
ON = [name for name in EFFECTS if name not in (*OWN, "gravity_yield", "residual")]
MEMORIES = {"servo": 6, "stick_band": 6, "backlash": 6, "settling": 18, "thermal_growth": 1, "base_tilt": 3}
"""Numbers that each effect with a memory remembers."""
MEMORYLESS = [name for name in EFFECTS if name not in MEMORIES]


@pytest.fixture(scope="module")
def orchard():
    return load_plant("orchard")


@pytest.fixture(scope="module")
def shares(orchard):
    return effect_shares(orchard, random_joints(orchard.arm.nominal, 150, np.random.default_rng(4)))


def only(*effects):
    return load_plant("orchard", without=[name for name in EFFECTS if name not in effects])


def walk(plant, m, ways, times):
    """States and frames along joint commands, each held for a time."""
    state = plant.initial_state(m, ways[0])
    seen = []
    for q, dt in zip(ways[1:], times, strict=True):
        state, frame = plant.advance(m, state, q, dt)
        seen.append((state, frame, plant.readings(m, state, q)))
    return seen


def test_every_effect_is_on(orchard):
    assert orchard.names == ON
    assert orchard.has_state


@pytest.mark.parametrize("effect", ON)
def test_every_effect_has_its_switch(orchard, effect):
    off = orchard.without([effect])
    assert [name for name in ON if off.effect(name) is None] == [effect]


def test_with_all_effects_off_it_is_exactly_the_true_geometry(orchard, draw):
    q = draw(orchard.geometry, 50)
    bare = orchard.without(EFFECTS)
    pose, true = bare.tool_pose(q), forward(orchard.arm.true, q)
    np.testing.assert_array_equal(pose.position, true.position)
    np.testing.assert_array_equal(pose.rotation, true.rotation)


@pytest.mark.parametrize("name", ["geometry_only", "qiao2026", "memoryless"])
def test_without_memory_advance_is_the_settled_pose_to_the_bit(name, draw):
    plant = only(*MEMORYLESS) if name == "memoryless" else load_plant(name)
    assert not plant.has_state
    for q in draw(plant.geometry, 20).tolist():
        state = plant.initial_state(math, q)
        assert state == ()
        assert plant.advance(math, state, q, 0.1) == (state, plant.tool_frame(math, q))


@pytest.mark.parametrize("effect", MEMORIES)
def test_the_state_holds_what_is_on_and_nothing_else(effect):
    plant = only(effect)
    assert plant.has_state
    state = plant.initial_state(math, [0.1, 0.3, 0.4, 0.0, 0.1, 0.2])
    assert [len(part) for part in state] == [MEMORIES[effect]]
    after, _ = plant.advance(math, state, [0.2, 0.3, 0.4, 0.0, 0.1, 0.2], 0.1)
    assert [len(part) for part in after] == [len(part) for part in state]


def test_held_for_ever_the_arm_comes_to_its_settled_pose(orchard, draw):
    """But for gaps and friction bands, where history decides."""
    plant = orchard.without(["backlash", "stick_band"])
    for q in draw(plant.geometry, 10).tolist():
        state = plant.initial_state(math, [0.1, 0.3, 0.4, 0.0, 0.1, 0.2])
        _, frame = plant.advance(math, state, q, 1e7)
        np.testing.assert_allclose(frame, plant.tool_frame(math, q), atol=1e-12)


def test_three_executors_walk_the_same_way(orchard, draw):
    ways, times = draw(orchard.geometry, 12, 20), np.random.default_rng(1).uniform(0.01, 0.5, 11).tolist()
    arrays = walk(orchard, np, [list(q.T) for q in ways], times)
    tensors = walk(orchard, torch, [torch.from_numpy(q).unbind(-1) for q in ways], times)
    for arm in range(20):
        floats = walk(orchard, math, ways[:, arm].tolist(), times)
        for one, many, torched in zip(floats, arrays, tensors, strict=True):
            assert all(type(value) is float for value in one[1])
            np.testing.assert_allclose(one[1], np.array(many[1])[:, arm], rtol=0, atol=1e-12)
            np.testing.assert_allclose(one[1], [float(value[arm]) for value in torched[1]], rtol=0, atol=1e-12)
            np.testing.assert_allclose(one[2], np.array(many[2])[:, arm], rtol=0, atol=1e-12)
            for mine, theirs in zip(one[0], many[0], strict=True):
                np.testing.assert_allclose(mine, [value[arm] for value in theirs], rtol=0, atol=1e-12)
    settled = orchard.tool_pose(ways[0])
    torched = pose_of(orchard.tool_frame(torch, torch.from_numpy(ways[0]).unbind(-1)))
    np.testing.assert_allclose(torched.position, settled.position, rtol=0, atol=1e-12)
    floats = [orchard.tool_frame(math, q)[9:] for q in ways[0].tolist()]
    np.testing.assert_allclose(floats, settled.position, rtol=0, atol=1e-12)


def test_each_arm_of_many_may_have_its_own_time_step(orchard, draw):
    start, target = draw(orchard.geometry, 2, 5)
    times = np.linspace(0.0, 1.0, 5)
    state = orchard.initial_state(np, list(start.T))
    _, frame = orchard.advance(np, state, list(target.T), times)
    for i in range(5):
        one = orchard.initial_state(math, start[i].tolist())
        _, alone = orchard.advance(math, one, target[i].tolist(), float(times[i]))
        np.testing.assert_allclose(np.array(frame)[:, i], alone, atol=1e-12)


def test_a_walk_repeats_to_the_bit(orchard, draw):
    ways = draw(orchard.geometry, 6).tolist()
    assert walk(orchard, math, ways, [0.1] * 5) == walk(orchard, math, ways, [0.1] * 5)


def test_torch_differentiates_through_time(orchard):
    plant = orchard.without(["encoder"])
    start = [torch.tensor([v], dtype=torch.float64) for v in (0.1, 0.3, 0.4, 0.0, 0.1, 0.2)]
    target = torch.tensor([[0.2, 0.4, 0.5, 0.1, 0.15, 0.3]], dtype=torch.float64, requires_grad=True)
    _, frame = plant.advance(torch, plant.initial_state(torch, start), target.unbind(-1), 0.1)
    (slope,) = torch.autograd.grad(frame[9].sum(), target)
    assert torch.isfinite(slope).all()
    assert slope.abs().max() > 0.1


def test_the_shares_are_of_the_size_that_the_field_reports(shares):
    """Bands from the plant table of the design, in mm."""
    bands = {
        "geometry": (1.0, 7.0),
        "joint_compliance": (0.2, 3.0),
        "boom_bending": (0.2, 2.0),
        "transmission_error": (0.05, 0.5),
        "boom_couple": (0.01, 0.3),
        "boom_torsion": (0.01, 0.2),
        "slide_compliance": (0.01, 0.3),
        "roller_play": (0.05, 0.5),
        "backlash": (0.1, 2.0),
        "stick_band": (0.05, 0.5),
        "thermal_growth": (0.1, 0.8),
        "base_tilt": (1.0, 5.0),
        "settling": (0.05, 2.0),
        "encoder": (0.0, 0.1),
        "servo": (0.0, 0.1),
    }
    assert tuple(shares["alone"]) == tuple(shares["without"]) == causes_of(load_plant("orchard"))
    assert set(shares["alone"]) == set(bands)
    for name, (low, high) in bands.items():
        assert low <= shares["alone"][name]["mean"] <= high, name


def test_base_tilt_is_the_largest_effect_and_the_sum_is_plausible(shares):
    assert max(shares["alone"], key=lambda name: shares["alone"][name]["mean"]) == "base_tilt"
    assert shares["root_sum_square"] / 1.5 < shares["all"]["mean"] < shares["sum_of_means"]


def test_without_an_effect_the_others_error_remains(orchard):
    """Of two effects each is what remains without the other; without the largest of many the least remains."""
    joints = random_joints(orchard.arm.nominal, 40, np.random.default_rng(4))
    two = effect_shares(orchard.without(set(EFFECTS) - {"base_tilt"}), joints)
    assert set(two["alone"]) == {"geometry", "base_tilt"}
    assert two["without"] == {"geometry": two["alone"]["base_tilt"], "base_tilt": two["alone"]["geometry"]}
    many = effect_shares(orchard, joints)
    least = min(many["without"], key=lambda name: many["without"][name]["mean"])
    assert least == "base_tilt" and many["without"][least]["mean"] < 0.75 * many["all"]["mean"]


def test_waiting_longer_leaves_less_vibration(orchard):
    joints = random_joints(orchard.arm.nominal, 40, np.random.default_rng(4))
    swinging = orchard.without(set(EFFECTS) - {"settling"})
    left = [
        effect_shares(swinging, joints, pace=Pace(dwell=wait))["alone"]["settling"]["mean"] for wait in (0.2, 1.0, 3.0)
    ]
    assert left[0] > 2 * left[1] > 4 * left[2]


def test_the_table_prints_and_is_json(shares):
    lines = shares_report(shares).splitlines()
    assert (
        len([line for line in lines if line.startswith(tuple(name.replace("_", " ") for name in shares["alone"]))])
        == 15
    )
    largest, mean = re.search(r"; (.+) alone would make ([\d.]+) mm", lines[0]).groups()
    assert float(mean) == pytest.approx(max(share["mean"] for share in shares["alone"].values()), abs=0.005)
    assert float(mean) == pytest.approx(shares["alone"][largest.replace(" ", "_")]["mean"], abs=0.005)
    again = json.loads(json.dumps(shares))
    assert again["unit"] == "mm"
    assert again["alone"]["base_tilt"]["mean"] == shares["alone"]["base_tilt"]["mean"]


def test_a_plant_without_effects_has_only_its_geometry(draw):
    plant = load_plant("geometry_only")
    shares = effect_shares(plant, draw(plant.geometry, 5))
    assert list(shares["alone"]) == ["geometry"]
    assert shares["alone"]["geometry"] == shares["all"]


@pytest.mark.parametrize("joints", [np.zeros(6), np.zeros((1, 6))])
def test_one_reach_is_no_table(orchard, joints):
    with pytest.raises(ValueError, match="at least two rows"):
        effect_shares(orchard, joints)


SOUND = (PLANTS / "orchard.toml").read_text(encoding="utf-8")
ENCODERS = SOUND[SOUND.index("[encoder]") : SOUND.index("[servo]")]
MISTAKES = {
    "overlap shorter than the way": ("overlap_mm = 1200.0", "overlap_mm = 800.0", ["overlap_mm", "800"]),
    "negative clearance": ("clearance_mm = 0.1", "clearance_mm = -0.1", ["clearance_mm", "[roller_play]"]),
    "rollers on a revolute joint": ("joint = 3\nlength_mm = 400.0\nclear", "joint = 1\nclear", ["revolute"]),
    "negative backlash": ("width_arcmin = 2.0", "width_arcmin = -2.0", ["width_arcmin", "[backlash.joints]"]),
    "backlash in the wrong unit": (
        "width_mm = 0.10",
        "width_arcmin = 0.10",
        ["perhaps width_mm is meant"],
    ),
    "preload missing": (", preload_N_m = 4.0", "", ["preload_N_m", "missing"]),
    "joint named twice": ("joint = 2, width_mm", "joint = 3, width_mm", ["joint", "each joint once"]),
    "negative scatter": ("scatter = 0.2", "scatter = -0.2", ["scatter", "[stick_band]"]),
    "negative friction": ("forward_mm = 0.06", "forward_mm = -0.06", ["forward_mm", "[stick_band.joints]"]),
    "five expansions": (
        "[23.0, 23.0, 23.0, 23.0, 23.0, 23.0]",
        "[23.0]",
        ["expansion_um_per_m_K", "6 entries, one per joint"],
    ),
    "no warm-up time": ("time_constant_h = 1.2", "time_constant_h = 0", ["time_constant_h", "[thermal_growth]"]),
    "rise not finite": ("final_rise_K = 20.0", "final_rise_K = nan", ["final_rise_K", "finite"]),
    "ground of no stiffness": ("[3.0e4, 3.0e4]", "[0.0, 3.0e4]", ["stiffness_N_m_per_rad", "above zero"]),
    "pivot in a plane": ("[0.0, 0.0, -600.0]", "[0.0, -600.0]", ["pivot_mm", "3 numbers"]),
    "rising ground": ("settlement_mm = 1.0", "settlement_mm = -1.0", ["settlement_mm", "[base_tilt]"]),
    "overdamped": ("damping = [0.03", "damping = [1.0", ["damping", "[settling]", "below 1"]),
    "frequency zero": ("frequency_Hz = [4.0", "frequency_Hz = [0.0", ["frequency_Hz", "above zero"]),
    "no rise time": ("rise_time_ms = 50.0", "rise_time_ms = 0.0", ["rise_time_ms", "above zero"]),
    "a joint without encoder": ("  { joint = 6, resolution_arcsec = 6.3 },\n", "", ["[encoder]", "joint 6"]),
    "counts of no size": ("resolution_um = 10.0", "resolution_um = 0.0", ["resolution_um", "above zero"]),
    "encoders not a list": (ENCODERS, "[encoder]\njoints = 3\n\n", ["joints", "give a list"]),
    "servo too fast": ("time_constant_ms = [20.0", "time_constant_ms = [0.0", ["time_constant_ms", "above zero"]),
    "bearings too close": ("span_mm = 1200.0", "span_mm = 700.0", ["span_mm", "[slide_compliance]", "800"]),
    "a bearing on a gear": ("joint = 3, stiffness_N", "joint = 4, stiffness_N", ["revolute", "slide_compliance"]),
    "bearings named twice": ("joint = 5, stiffness_N", "joint = 3, stiffness_N", ["bearings", "each joint once"]),
    "bearing without stiffness": ("stiffness_N_per_um = 20.0", "stiffness_N_per_um = 0.0", ["stiffness_N_per_um"]),
    "no torsional rigidity": ("torsional_rigidity_N_m2 = 1.44e4", "torsional_rigidity_N_m2 = 0", ["[boom_torsion]"]),
    "effect misspelt": ("[servo]", "[servos]", ["'servos'", "servo"]),
    "load missing": (SOUND[SOUND.index("[load]") : SOUND.index("[roller_play]")], "", ["base_tilt", "[load]"]),
}


@pytest.mark.parametrize(("old", "new", "named"), MISTAKES.values(), ids=MISTAKES)
def test_a_mistake_is_named_with_file_and_key(tmp_path, old, new, named):
    assert old in SOUND
    path = tmp_path / "plant.toml"
    path.write_text(SOUND.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(InputError) as caught:
        load_plant(path)
    message = str(caught.value)
    assert "\n" not in message
    for word in (str(path), *named):
        assert word in message
