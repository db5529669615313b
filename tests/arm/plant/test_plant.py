"""What the true arm does with a command: every effect on its own, and all of them off."""

import math
from dataclasses import replace

import numpy as np
import pytest

from pickenv.arm import (
    Load,
    Passage,
    arrays_of,
    chain_of,
    draw_plants,
    forward,
    frames,
    load_plant,
    load_tolerances,
    plant_at,
    plants_on,
    pose_error,
    pose_of,
    rotation_matrix,
    shipped_effects,
    shipped_plants,
    tree_map,
    with_links,
)
from pickenv.base import registry

EFFECTS = shipped_effects()
BoomBending, JointCompliance = (registry.get("effect", name) for name in ("boom_bending", "joint_compliance"))

MOVING = ["joint_compliance", "boom_bending", "transmission_error"]


@pytest.fixture
def plant():
    return load_plant("qiao2026")


def only(effect):
    return load_plant("qiao2026", without=[name for name in EFFECTS if name != effect])


def driven_by(m, effect, q):
    """Where an effect's drives hold the joints of a command."""
    at = Passage(m, None, None, q)
    effect.act(at, ())
    return at.driven


def equal(pose, other):
    return np.array_equal(pose.position, other.position) and np.array_equal(pose.rotation, other.rotation)


@pytest.mark.parametrize("bare", [load_plant("geometry_only"), load_plant("qiao2026", without=EFFECTS)])
def test_with_all_effects_off_it_is_exactly_the_true_geometry(bare, qiao, draw):
    q = draw(qiao.true, 50)
    assert equal(bare.tool_pose(q), forward(qiao.true, q))


@pytest.mark.parametrize("effect", [*MOVING, "measurement_noise"])
def test_each_effect_can_be_switched_off_alone(plant, effect):
    assert set(plant.without([effect]).names) == set(plant.without(effect).names) == set(plant.names) - {effect}


@pytest.mark.parametrize("effect", MOVING)
def test_each_effect_moves_the_tool_by_tenths_of_a_millimetre_at_most_a_few(effect, qiao, draw):
    q = draw(qiao.true, 500)
    moved = pose_error(forward(qiao.true, q), only(effect).tool_pose(q))
    assert 0.02e-3 < np.linalg.norm(moved[:, :3], axis=-1).mean() < 5e-3


def test_a_soft_pitch_drive_droops_by_the_torque_of_all_it_carries(qiao):
    """The moment about J1 is written out from the links' masses; the rest of the arm is as stiff as can be."""
    masses, centres = (4.0, 3.0, 2.4, 0.9, 0.6, 0.5), tuple((0.05, 0.01 * i, -0.1) for i in range(6))
    loaded = replace(load_plant("geometry_only"), load=Load(masses, centres, payload=0.25))
    plant = loaded.with_effect(JointCompliance((9e3, *[1e30] * 5)))
    q = np.array([0.2, 0.3, 0.7, -0.1, 0.1, 0.5])
    links = [pose_of(frame) for frame in frames(np, chain_of(qiao.true), q)[1:]]
    axis, origin = links[0].rotation[:, 2], links[0].position
    hanging = [(mass, link.position + link.rotation @ c) for mass, c, link in zip(masses, centres, links, strict=True)]
    hanging.append((0.25, forward(qiao.true, q).position))
    torque = sum(axis @ np.cross(point - origin, [0, 0, -9.80665 * mass]) for mass, point in hanging)
    assert abs(torque) > 10
    expected = forward(qiao.true, q + np.array([torque / 9e3, 0, 0, 0, 0, 0]))
    np.testing.assert_allclose(plant.tool_pose(q).position, expected.position, rtol=0, atol=1e-12)


def test_boom_bending_lowers_and_swings_what_the_boom_carries(qiao, draw):
    """The pose behind the boom turns about the boom's tip by the slope and sinks by the sag, both across the boom."""
    rigidity, length = 1.2e4, 0.4
    plant = load_plant("geometry_only").with_effect(BoomBending(2, length, rigidity, 2.0, 1.8))
    for q in draw(qiao.true, 20):
        straight, reach = forward(qiao.true, q), length + q[2]
        tip = pose_of(frames(np, chain_of(qiao.true), q)[3])
        force, weight = 2.0 * 9.80665, 1.8 * 9.80665
        sag = force * reach**3 / (3 * rigidity) + weight * reach**4 / (8 * rigidity)
        slope = force * reach**2 / (2 * rigidity) + weight * reach**3 / (6 * rigidity)
        boom, down = tip.rotation[:, 2], np.array([0, 0, -1])
        turn = rotation_matrix(slope * np.cross(boom, down))
        across = down - (down @ boom) * boom
        bent = plant.tool_pose(q)
        expected = tip.position + sag * across + turn @ (straight.position - tip.position)
        np.testing.assert_allclose(bent.position, expected, rtol=0, atol=1e-14)
        np.testing.assert_allclose(bent.rotation, turn @ straight.rotation, rtol=0, atol=1e-14)


def test_transmission_error_acts_before_the_chain(plant, qiao, draw):
    q = draw(qiao.true, 10)
    driven = np.stack(driven_by(np, plant.effect("transmission_error"), list(q.T)), axis=-1)
    assert np.abs(driven - q).max() > 1e-5
    assert equal(only("transmission_error").tool_pose(q), forward(qiao.true, driven))


@pytest.mark.parametrize("effect", ["joint_compliance", "boom_bending"])
def test_a_heavier_fruit_lowers_the_arm_in_proportion(effect):
    plant, q = only(effect), np.array([0.1, 0.3, 0.7, 0.0, 0.1, 0.0])
    heights = [
        replace(plant, load=replace(plant.load, payload=payload)).tool_pose(q).position[2] for payload in (0, 0.25, 0.5)
    ]
    assert np.all(np.diff(heights) < -1e-5)
    np.testing.assert_allclose(np.diff(heights, 2), 0, rtol=0, atol=1e-7)


def test_shipped_plants_load_under_their_own_names():
    assert [load_plant(name).name for name in shipped_plants()] == shipped_plants()
    assert {"geometry_only", "qiao2026"} <= set(shipped_plants())


@pytest.mark.parametrize("name", ["qiao2026", "orchard"])
def test_drive_errors_come_before_everything_else(name):
    """An arm with drive errors stands, loads and all, where one without them stands at the joints that they drive."""
    plant = load_plant(name, without=["encoder"])
    rough = plant.with_effect(replace(plant.effect("transmission_error"), lead=(0.05,) * 6))
    assert rough.effect("joint_compliance") is not None and rough.effect("boom_bending") is not None
    q = [0.2, 0.3, 0.5, -0.1, 0.1, 0.5]
    driven = driven_by(math, rough.effect("transmission_error"), q)
    assert max(abs(a - b) for a, b in zip(q, driven, strict=True)) > 0.01
    smooth = rough.without(["transmission_error"])
    np.testing.assert_allclose(rough.tool_frame(math, q), smooth.tool_frame(math, driven), rtol=0, atol=1e-14)


def test_every_number_of_a_chain_is_changed_and_nothing_else():
    geometry = with_links(load_plant("geometry_only").geometry, lambda values: values[None])
    for beta in (0.0, 0.3):
        chain = chain_of(replace(geometry, beta=np.full((1, 6), beta)), np)
        changed = tree_map(lambda values: ("changed", float(values[0])), chain)
        assert (changed.base, changed.tool, changed.coupling) == (chain.base, chain.tool, chain.coupling)
        for link, moved in zip(chain.links, changed.links, strict=True):
            assert moved.prismatic == link.prismatic
            assert moved.beta == (None if beta == 0.0 else (("changed", np.cos(beta)), ("changed", np.sin(beta))))
            for name in ("cos_alpha", "sin_alpha", "a", "theta", "d", "cos_theta", "sin_theta"):
                assert getattr(moved, name) == ("changed", float(getattr(link, name)[0]))


def test_a_batch_of_arms_moved_elsewhere_gives_all_its_arrays_and_a_new_geometry_its_own_chain():
    arms = draw_plants(load_plant("orchard"), load_tolerances("medium"), 3, np.random.default_rng(0))
    doubled = plants_on(arms, lambda values: 2.0 * values)
    assert len(arrays_of(arms)) > 80 and arrays_of(plant_at(arms, 0)) == []
    for mine, other in zip(arrays_of(arms), arrays_of(doubled), strict=True):
        np.testing.assert_array_equal(other, 2.0 * mine)
    assert replace(doubled, load=None).chain is doubled.chain
    back = replace(doubled, geometry=arms.geometry)  # the chain that was made ready is of another geometry
    np.testing.assert_array_equal(back.chain.links[2].a, arms.chain.links[2].a)
