"""No collision is ever accepted: distances against brute force, and a thousand zones without one."""

import numpy as np
import pytest

from pickenv.harvester import (
    arm_distances,
    assign,
    load_machine,
    pick_point,
    slave_joints_at,
    timetable,
    ultrasonic_hold,
    zone_work,
)
from pickenv.harvester.work import closest_approach, excursion_distances, segment_distance


def zone(machine, rng, count):
    corner = np.array([rng.uniform(-0.9, 0.9) - 0.35, -1.4, rng.uniform(0.42, 1.87)])
    fruit = corner + np.array([0.7, 0.4, 0.55]) * rng.random((count, 3))
    return zone_work(machine, pick_point(machine, fruit), fruit)


def test_segment_distances_equal_those_of_many_points_along_them():
    rng, share = np.random.default_rng(0), np.linspace(0, 1, 201)[:, None]
    for _ in range(50):
        p, q, r, s = rng.uniform(-1, 1, (4, 2))
        one, other = p + share * (q - p), r + share * (s - r)
        brute = np.linalg.norm(one[:, None] - other[None], axis=-1).min()
        assert segment_distance(p, q, r, s) <= brute + 1e-9
        assert segment_distance(p, q, r, s) == pytest.approx(brute, abs=0.02)


def test_crossing_segments_touch_and_points_are_segments_too():
    assert segment_distance([0, 0], [1, 1], [0, 1], [1, 0]) == 0.0
    assert segment_distance([0, 0], [0, 0], [3, 4], [3, 4]) == 5.0


def test_arm_distances_equal_capsules_in_space(machine):
    rng, share = np.random.default_rng(1), np.linspace(0, 1, 101)
    for _ in range(20):
        slaves = rng.uniform(machine.slave.lower, machine.slave.upper, (3, 3))
        pivots = slaves.copy()
        pivots[:, 2] = 0.0
        tips, roots = machine.tips(machine.master_start, slaves), machine.tips(machine.master_start, pivots)
        points = roots[:, None] + share[:, None] * (tips - roots)[:, None]
        brute = [
            np.linalg.norm(points[a][:, None] - points[b][None], axis=-1).min() for a, b in ((0, 1), (0, 2), (1, 2))
        ]
        assert arm_distances(machine, slaves) == pytest.approx(brute, abs=0.01)


def test_excursions_that_may_overlap_keep_their_clearance_at_every_moment(machine):
    """Both arms anywhere on their ways out, at any time: never nearer than the excursions' distance says."""
    rng, share = np.random.default_rng(2), np.linspace(0, 1, 25)
    for _ in range(10):
        work = zone(machine, rng, 2)
        joints = np.clip(work.joints, machine.slave.lower, machine.slave.upper)
        least = excursion_distances(machine, joints, work.approach)[0, 0, 1, 1]
        pose = np.broadcast_to(machine.slave_home, (25, 25, 3, 3)).copy()
        pose[..., 2, 0] = 9.0  # the third arm is out of the way
        for arm, along in ((0, share[:, None]), (1, share[None, :])):
            goal = joints[arm, arm]
            pose[..., arm, 0] = goal[0]
            pose[..., arm, 1:] = machine.slave_home[1:] + along[..., None] * (goal[1:] - machine.slave_home[1:])
        assert arm_distances(machine, pose)[..., 0].min() >= least - 0.012


def test_an_arm_at_rest_is_safe_from_any_neighbour(machine):
    for spacing in (0.3, 0.35, 0.45):
        machine = load_machine(spacing=spacing)
        rng = np.random.default_rng(3)
        slaves = rng.uniform(machine.slave.lower, machine.slave.upper, (3000, 3, 3))
        slaves[..., 0] = 0.0
        slaves[:, 1, 1:] = machine.slave_home[1:]
        assert arm_distances(machine, slaves)[:, [0, 2]].min() >= machine.body.clearance


@pytest.mark.parametrize(
    ("method", "guard"), [("li", True), ("nearest", False), pytest.param("search", False, marks=pytest.mark.slow)]
)
def test_no_collision_in_a_hundred_zones(machine, method, guard):
    rng = np.random.default_rng(4)
    for _ in range(100):
        work = zone(machine, rng, int(rng.integers(1, 12)))
        hold = ultrasonic_hold(machine, work, rng) if guard else None
        times = timetable(work, assign(work, method), hold=hold)
        assert closest_approach(machine, work, times) >= machine.body.clearance - 0.012


@pytest.mark.thorough
@pytest.mark.parametrize(("arms", "spacing"), [(3, 0.35), (6, 0.3)])
def test_no_collision_in_a_thousand_zones(arms, spacing):
    machine, rng, nearest = load_machine(slaves=arms, spacing=spacing), np.random.default_rng(5), np.inf
    for _ in range(1000):
        work = zone(machine, rng, int(rng.integers(2, 15)))
        times = timetable(work, assign(work, "search"))
        nearest = min(nearest, closest_approach(machine, work, times))
    assert nearest > 2 * machine.body.radius


def test_arms_move_within_their_limits_and_end_at_rest(machine):
    work = zone(machine, np.random.default_rng(6), 8)
    times = timetable(work, assign(work, "search"))
    at = np.arange(0, times.makespan + 0.5, 0.01)
    joints = slave_joints_at(machine, work, times, at)
    assert (joints >= machine.slave.lower - 1e-9).all() and (joints <= machine.slave.upper + 1e-9).all()
    assert joints[-1, :, 1:] == pytest.approx(np.broadcast_to(machine.slave_home[1:], (3, 2)))
    speed = np.abs(np.diff(joints, axis=0)) / 0.01
    assert (speed.max(axis=(0, 1)) <= machine.slaves[0].speed * 1.01).all()
    for pick in range(len(times.arm)):  # the cup is at its fruit when the blade cuts
        arm, fruit = times.arm[pick], times.fruit[pick]
        moment = times.start[pick] + work.out[arm, fruit]
        there = slave_joints_at(machine, work, times, np.array([moment]))[0, arm]
        assert there == pytest.approx(work.joints[arm, fruit], abs=1e-6)
