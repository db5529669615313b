"""The ground gives way: a spring at once, creep and settlement over hours."""

import math
from dataclasses import replace

import numpy as np
import pytest

from pickenv.arm import Load, chain_of, frames, load_plant, pose_of, rotation_matrix
from pickenv.base import GRAVITY, registry

PIVOT = (0.2, -0.1, -0.6)
BaseTilt, RollerPlay = (registry.get("effect", name) for name in ("base_tilt", "roller_play"))
GROUND = BaseTilt((4e4, 6e4), PIVOT, creep=0.5, settlement=2e-3, time_constant=5400.0)
LOAD = Load((4.0, 3.0, 2.4, 0.9, 0.6, 0.5), tuple((0.05, 0.01 * i, -0.1) for i in range(6)), 0.25)
BARE = load_plant("geometry_only")
FIELD = replace(BARE, load=LOAD).with_effect(GROUND)
Q = [0.1, 0.3, 0.6, 0.05, 0.1, 0.2]


def reach_moment(plant, q):
    """Moment of all weights about the pivot, written out as a sum of cross products, N*m."""
    links = [pose_of(frame) for frame in frames(np, chain_of(plant.geometry), [np.array(v) for v in q])[1:]]
    hanging = [
        (mass, link.position + link.rotation @ centre)
        for mass, centre, link in zip(LOAD.mass, LOAD.centre, links, strict=True)
    ]
    hanging.append((LOAD.payload, BARE.tool_pose(q).position))
    return sum(np.cross(point - PIVOT, [0, 0, -GRAVITY * mass]) for mass, point in hanging)


def tipped(q, share, drop):
    """The rigid machine turned about the pivot by ``share`` of the immediate tilt, and sunk by ``drop``."""
    moment = reach_moment(FIELD, q)
    turn = rotation_matrix(share * np.array([moment[0] / 4e4, moment[1] / 6e4, 0.0]))
    pose = BARE.tool_pose(q)
    return turn @ (pose.position - PIVOT) + PIVOT - [0, 0, drop], turn @ pose.rotation


def test_at_once_the_ground_is_a_spring():
    frame = FIELD.advance(np, FIELD.initial_state(np, np.array(Q)), np.array(Q), 0.0)[1]
    position, rotation = tipped(Q, 1.0, 0.0)
    pose = pose_of(frame)
    np.testing.assert_allclose(pose.position, position, atol=1e-13)
    np.testing.assert_allclose(pose.rotation, rotation, atol=1e-13)


def test_in_the_long_run_it_has_crept_and_settled():
    pose = FIELD.tool_pose(Q)
    position, rotation = tipped(Q, 1.5, 2e-3)
    np.testing.assert_allclose(pose.position, position, atol=1e-13)
    np.testing.assert_allclose(pose.rotation, rotation, atol=1e-13)


@pytest.mark.parametrize("hours", [0.2, 1.5, 6.0])
def test_creep_and_settlement_follow_the_time_constant(hours):
    gone = 1 - math.exp(-hours * 3600 / 5400)
    state = FIELD.initial_state(math, Q)
    for _ in range(10):
        state, frame = FIELD.advance(math, state, Q, hours * 360.0)
    position, _ = tipped(Q, 1 + 0.5 * gone, 2e-3 * gone)
    np.testing.assert_allclose(frame[9:], position, atol=1e-12)


def test_the_machine_remembers_where_it_leaned():
    """After hours of leaning to one side, the tool is not where it is after hours of leaning to the other."""
    near, far = [0.1, 0.0, 0.0, 0.05, 0.1, 0.2], [0.1, 0.6, 0.8, 0.05, 0.1, 0.2]
    ends = []
    for before in (near, far):
        state, _ = FIELD.advance(math, FIELD.initial_state(math, before), before, 3 * 3600.0)
        ends.append(np.array(FIELD.advance(math, state, Q, 1.0)[1][9:]))
    assert 0.1e-3 < np.linalg.norm(ends[0] - ends[1]) < 5e-3


def test_a_tenth_of_a_degree_is_4_mm_at_2500_mm():
    tilt = math.radians(0.1)
    assert 1e3 * 2.5 * tilt == pytest.approx(4.4, abs=0.05)
    moment = abs(reach_moment(FIELD, Q)[1])
    soft = FIELD.with_effect(BaseTilt((1e12, moment / tilt), PIVOT, 0.0, 0.0, 1.0))
    lowered = BARE.tool_pose(Q).position - soft.tool_pose(Q).position
    arm = BARE.tool_pose(Q).position - np.array(PIVOT)
    assert np.linalg.norm(lowered) == pytest.approx(tilt * math.hypot(arm[0], arm[2]), rel=1e-3)


def test_play_in_the_rollers_grows_as_the_overlap_shrinks():
    play = RollerPlay(joint=2, length=0.4, clearance=1e-4, overlap=1.2)
    loose = BARE.with_effect(play)
    drops = []
    for out in (0.0, 0.4, 0.8):
        q = [0.0, 0.3, out, 0.0, 0.1, 0.0]
        boom = pose_of(frames(np, chain_of(BARE.geometry), [np.array(v) for v in q])[3])
        angle = 1e-4 / (1.2 - out)
        turn = rotation_matrix(angle * np.cross(boom.rotation[:, 2], [0, 0, -1]))
        along = boom.rotation[:, 2]
        across = np.array([0, 0, -1.0]) + along * along[2]
        straight = BARE.tool_pose(q).position
        expected = boom.position + angle * (0.4 + out) * across + turn @ (straight - boom.position)
        np.testing.assert_allclose(loose.tool_pose(q).position, expected, atol=1e-13)
        drops.append(straight[2] - loose.tool_pose(q).position[2])
    assert 0 < drops[0] < drops[1] / 2 < drops[2] / 4


def test_boom_bending_and_roller_play_add_up():
    orchard = load_plant("orchard")
    q = [0.0, 0.3, 0.8, 0.0, 0.1, 0.0]
    bend, slack = (BARE.with_effect(orchard.effect(name)) for name in ("boom_bending", "roller_play"))
    both = bend.with_effect(orchard.effect("roller_play"))
    true = BARE.tool_pose(q).position
    apart = bend.tool_pose(q).position - true + slack.tool_pose(q).position - true
    np.testing.assert_allclose(both.tool_pose(q).position - true, apart, atol=2e-6)
