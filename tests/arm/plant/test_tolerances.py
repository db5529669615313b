"""Arms of one design differ: tolerance classes, draws that depend on the arm's index alone, and batches of arms."""

import math

import numpy as np
import pytest
import torch

from pickenv.arm import (
    LINK_PARAMETERS,
    TOLERANCES,
    draw_plants,
    forward,
    it_tolerance,
    load_plant,
    load_tolerances,
    plant_at,
    plant_count,
    plants_on,
    pose_of,
    shipped_effects,
    shipped_tolerances,
)
from pickenv.base import InputError

EFFECTS = shipped_effects()

ORCHARD = load_plant("orchard")
MEDIUM = load_tolerances("medium")


def drawn(count, seed=0, plant=ORCHARD, tolerances=MEDIUM):
    return draw_plants(plant, tolerances, count, np.random.default_rng(seed))


def numbers(plant):
    """Every number of an effect, by its place in the plant."""
    found = {}

    def visit(value, name):
        if isinstance(value, tuple):
            for i, entry in enumerate(value):
                visit(entry, f"{name}[{i}]")
        elif hasattr(value, "__dataclass_fields__"):
            for field in value.__dataclass_fields__:
                visit(getattr(value, field), f"{name}.{field}")
        elif value is not None:
            found[name] = value

    for effect in plant.effects:
        visit(effect, effect.name)
    return found


@pytest.mark.parametrize(
    ("grade", "millimetres", "micrometres"),
    [(6, 24, 13), (7, 40, 25), (9, 95, 87), (11, 210, 290), (12, 450, 630), (14, 280, 1300), (7, 565, 70)],
)
def test_tolerances_are_those_of_iso_286(grade, millimetres, micrometres):
    """Table 1 of the standard, for a size near the geometric mean of its range; the table itself is rounded."""
    assert 1e6 * it_tolerance(grade, millimetres * 1e-3) == pytest.approx(micrometres, rel=0.07)


def test_link_parameters_stay_in_their_tolerance_zone_and_fill_it():
    nominal, arms = ORCHARD.arm.nominal, drawn(2000)
    for name, half in {
        "alpha": np.full(6, MEDIUM.angle),
        "theta": np.full(6, MEDIUM.angle),
        "a": it_tolerance(12, np.maximum(np.abs(nominal.a), 0.05)) / 2,
        "d": it_tolerance(12, np.maximum(np.abs(nominal.d), 0.05)) / 2,
    }.items():
        deviation = (getattr(arms.geometry, name) - getattr(nominal, name)) / half
        assert np.all(np.abs(deviation) <= 1 + 1e-9)
        np.testing.assert_allclose(deviation.std(axis=0), 1 / math.sqrt(3), rtol=0.06)
        np.testing.assert_allclose(deviation.mean(axis=0), 0, atol=0.06)
    assert not arms.geometry.beta.any()


def test_sizes_spread_about_the_design_as_the_class_says():
    arms = drawn(4000)
    pairs = {
        "joint_stiffness": (
            ORCHARD.effect("joint_compliance").stiffness[0],
            arms.effect("joint_compliance").stiffness[0],
        ),
        "backlash": (ORCHARD.effect("backlash").width[3], arms.effect("backlash").width[3]),
        "friction": (ORCHARD.effect("stick_band").backward[1], arms.effect("stick_band").backward[1]),
        "ground_stiffness": (ORCHARD.effect("base_tilt").stiffness[1], arms.effect("base_tilt").stiffness[1]),
        "frequency": (ORCHARD.effect("settling").frequency[2], arms.effect("settling").frequency[2]),
        "flexural_rigidity": (
            ORCHARD.effect("boom_bending").flexural_rigidity,
            arms.effect("boom_bending").flexural_rigidity,
        ),
        "roller_clearance": (ORCHARD.effect("roller_play").clearance, arms.effect("roller_play").clearance),
        "warm_up_time": (ORCHARD.effect("thermal_growth").time_constant, arms.effect("thermal_growth").time_constant),
        "sinkage": (ORCHARD.effect("base_tilt").creep, arms.effect("base_tilt").creep),
    }
    for key, (design, sizes) in pairs.items():
        logarithm = np.log(sizes / design)
        assert logarithm.std() == pytest.approx(getattr(MEDIUM.spread, key), rel=0.05), key
        assert abs(logarithm.mean()) < 0.06 * getattr(MEDIUM.spread, key), key
    rise = arms.effect("thermal_growth").final_rise
    assert rise.min() > 0 and rise.max() < 25 and rise.mean() == pytest.approx(12.5, abs=0.4)


def test_arms_differ_in_everything_that_is_drawn():
    arms = drawn(50)
    for name in ("alpha", "a", "theta", "d"):
        assert np.all(np.ptp(getattr(arms.geometry, name), axis=0) > 0)
    batched = {name: value for name, value in numbers(arms).items() if isinstance(value, np.ndarray)}
    assert len(batched) > 40
    for name, value in batched.items():
        assert value.shape == (50,)
        design = numbers(ORCHARD)[name]
        assert np.ptp(value) > 0 or design == 0, name


def test_arm_i_does_not_depend_on_how_many_are_drawn():
    few, many = drawn(3), drawn(40)
    for i in range(3):
        one, same = plant_at(few, i), plant_at(many, i)
        assert numbers(one) == numbers(same)
        for name in LINK_PARAMETERS:
            np.testing.assert_array_equal(getattr(one.geometry, name), getattr(same.geometry, name))


@pytest.mark.parametrize(
    "effect", [name for name in EFFECTS if name != "measurement_noise" and ORCHARD.effect(name) is not None]
)
def test_switching_an_effect_off_leaves_the_other_draws_as_they_are(effect):
    whole, rest = numbers(drawn(4)), numbers(drawn(4, plant=ORCHARD.without([effect])))
    assert {name.split(".")[0] for name in whole} - {name.split(".")[0] for name in rest} == {effect}
    for name, value in rest.items():
        np.testing.assert_array_equal(value, whole[name])


def test_one_seed_repeats_and_another_differs():
    assert str(numbers(drawn(5, seed=1))) == str(numbers(drawn(5, seed=1)))
    assert str(numbers(drawn(5, seed=1))) != str(numbers(drawn(5, seed=2)))
    rng = np.random.default_rng(1)
    first, second = (draw_plants(ORCHARD, MEDIUM, 5, rng) for _ in range(2))
    assert not np.any(first.geometry.a == second.geometry.a)


def test_many_arms_at_once_are_the_arms_one_by_one(draw):
    arms, ways = drawn(12), draw(ORCHARD.geometry, 5, 12)
    tensors = plants_on(arms, torch.as_tensor)
    state = arms.initial_state(np, list(ways[0].T))
    torched = tensors.initial_state(torch, torch.from_numpy(ways[0]).unbind(-1))
    ones = [plant_at(arms, i) for i in range(12)]
    alone = [one.initial_state(math, ways[0, i].tolist()) for i, one in enumerate(ones)]
    for q in ways[1:]:
        state, frame = arms.advance(np, state, list(q.T), 0.1)
        torched, tensor_frame = tensors.advance(torch, torched, torch.from_numpy(q).unbind(-1), 0.1)
        np.testing.assert_allclose([v.numpy() for v in tensor_frame], frame, rtol=0, atol=1e-12)
        for i, one in enumerate(ones):
            alone[i], single = one.advance(math, alone[i], q[i].tolist(), 0.1)
            np.testing.assert_allclose(np.array(frame)[:, i], single, rtol=0, atol=1e-12)
    settled = arms.tool_pose(ways[0])
    torched_pose = pose_of(tensors.tool_frame(torch, torch.from_numpy(ways[0]).unbind(-1)))
    np.testing.assert_allclose(torched_pose.position, settled.position, rtol=0, atol=1e-12)
    for i, one in enumerate(ones):
        np.testing.assert_allclose(one.tool_pose(ways[0, i]).position, settled.position[i], rtol=0, atol=1e-12)
        assert one.tool_frame(math, ways[0, i].tolist())[9:] == pytest.approx(settled.position[i], abs=1e-12)


def test_several_poses_of_each_arm(draw):
    arms, q = drawn(3), draw(ORCHARD.geometry, 4, 3)
    poses = arms.tool_pose(q)
    for i in range(3):
        np.testing.assert_allclose(plant_at(arms, i).tool_pose(q[:, i]).position, poses.position[:, i], atol=1e-12)


def test_arms_without_effects_are_their_geometries(draw):
    arms, q = drawn(6, plant=load_plant("geometry_only")), draw(ORCHARD.geometry, 6)
    np.testing.assert_array_equal(arms.tool_pose(q).position, forward(arms.geometry, q).position)


def test_coarser_classes_make_worse_arms(draw):
    q = draw(ORCHARD.geometry, 300)
    believed = forward(ORCHARD.arm.nominal, q).position
    errors = [
        np.linalg.norm(drawn(300, plant=load_plant("qiao2026"), tolerances=load_tolerances(name)).tool_pose(q).position
                       - believed, axis=-1).mean()
        for name in ("fine", "medium", "coarse")
    ]  # fmt: skip
    assert errors[0] < errors[1] < errors[2]
    assert 0.5e-3 < errors[1] < 5e-3


def test_the_normal_distribution_keeps_three_standard_deviations_in_the_zone(tmp_path):
    path = tmp_path / "normal.toml"
    path.write_text((TOLERANCES / "medium.toml").read_text(encoding="utf-8").replace("uniform", "normal"))
    arms = drawn(3000, tolerances=load_tolerances(path))
    deviation = (arms.geometry.alpha - ORCHARD.arm.nominal.alpha) / MEDIUM.angle
    np.testing.assert_allclose(deviation.std(axis=0), 1 / 3, rtol=0.05)


def test_a_single_arm_is_no_batch():
    assert plant_count(ORCHARD) is None
    assert plant_count(drawn(3)) == 3
    for wrong in (3, -4):
        with pytest.raises(IndexError, match="no arm"):
            plant_at(drawn(3), wrong)
    with pytest.raises(IndexError, match="no arm"):
        plant_at(ORCHARD, 0)


def test_impossible_draws_are_refused():
    with pytest.raises(InputError, match="count is 0"):
        drawn(0)
    with pytest.raises(InputError, match="already a batch"):
        draw_plants(drawn(2), MEDIUM, 2, np.random.default_rng(0))


def test_shipped_classes_load_under_their_own_names():
    assert shipped_tolerances() == ["coarse", "cobot", "fine", "medium", "printed"]
    assert [load_tolerances(name).name for name in shipped_tolerances()] == shipped_tolerances()


SOUND = (TOLERANCES / "medium.toml").read_text(encoding="utf-8")
MISTAKES = {
    "grade between": ("it_grade = 12", "it_grade = 12.5", ["it_grade", "whole number"]),
    "grade unknown": ("it_grade = 12", "it_grade = 3", ["it_grade", "5 to 17"]),
    "length zero": ("least_length_mm = 50.0", "least_length_mm = 0", ["least_length_mm", "above zero"]),
    "distribution unknown": ('"uniform"', '"gauss"', ["distribution", "'uniform' or 'normal'"]),
    "negative angle": ("half_width_deg = 0.03", "half_width_deg = -1", ["half_width_deg", "[angles]"]),
    "negative spread": ("joint_stiffness = 0.15", "joint_stiffness = -0.1", ["joint_stiffness", "[spread]"]),
    "spread misspelt": ("joint_stiffness", "joint_stifness", ["'joint_stifness'", "joint_stiffness"]),
    "range upside down": ("rise_K = [0.0, 25.0]", "rise_K = [25.0, 0.0]", ["rise_K", "lower number first"]),
    "range of one": ("rise_K = [0.0, 25.0]", "rise_K = [25.0]", ["rise_K", "2 numbers"]),
    "table unknown": ("[angles]", "[angels]", ["'angels'", "angles"]),
}


@pytest.mark.parametrize(("old", "new", "named"), MISTAKES.values(), ids=MISTAKES)
def test_a_mistake_is_named_with_file_and_key(tmp_path, old, new, named):
    assert old in SOUND
    path = tmp_path / "class.toml"
    path.write_text(SOUND.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(InputError) as caught:
        load_tolerances(path)
    for word in (str(path), *named):
        assert word in str(caught.value)


def test_an_unknown_class_is_answered_with_the_known_ones():
    with pytest.raises(InputError, match=r"unknown tolerance class 'middling'.*'medium'"):
        load_tolerances("middling")
