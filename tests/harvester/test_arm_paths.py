"""A side arm's ultrasonic ranger hears where its neighbour is, as far as its cone and range go, and no timetable."""

import math
from dataclasses import replace

import numpy as np
import pytest

from pickenv.harvester import assign, pick_point, slave_joints_at, timetable, ultrasonic_hold, zone_work
from pickenv.harvester.work import echoes

MIDDLE = 1
RADIUS = 0.04
READY = 1.4
"""When the left arm is, s: the middle arm is up at its fruit by then."""


@pytest.fixture
def quiet(machine):
    """The machine with a ranger that has no noise."""
    return replace(machine, ranger=replace(machine.ranger, noise=0.0))


def at_rest(machine):
    return np.broadcast_to(machine.slave_home, (machine.arms, 3)).copy()


def test_straight_arms_hear_each_other_across_their_spacing(quiet):
    for arm in (0, 2):
        assert echoes(quiet, at_rest(quiet), arm) == pytest.approx(quiet.spacing - 2 * RADIUS, abs=2e-3)


@pytest.mark.parametrize("swing_deg", [5.0, 10.0, 15.0, 20.0])
def test_a_neighbour_that_swings_nearer_is_heard_nearer(quiet, swing_deg):
    """Against the plane: the nearest point of its centre line in a cone of 15 degrees that is widened by its body."""
    joints = at_rest(quiet)
    joints[MIDDLE] = [joints[MIDDLE, 0], math.radians(swing_deg), 0.8]  # to the left
    eye = np.array([0.0, joints[0, 2]])
    line = np.array([quiet.spacing, 0.0]) + np.linspace(0, 0.8, 20_001)[:, None] * [
        -math.sin(math.radians(swing_deg)),
        math.cos(math.radians(swing_deg)),
    ]
    away = line - eye
    inside = np.abs(away[:, 1]) - RADIUS <= away[:, 0] * math.tan(math.radians(15.0))
    assert echoes(quiet, joints, 0) == pytest.approx(np.hypot(*away[inside].T).min() - 2 * RADIUS, abs=4e-3)
    assert echoes(quiet, joints, 0) < quiet.spacing - 2 * RADIUS - 1e-3


def test_what_stands_above_its_cone_or_beyond_its_range_sends_no_echo(quiet):
    reach = (quiet.spacing * math.tan(math.radians(15.0)) + RADIUS) * 1e3
    for up_mm, heard in ((reach - 1, True), (reach + 1, False)):
        joints = at_rest(quiet)
        joints[MIDDLE, 0] += up_mm * 1e-3
        assert np.isfinite(echoes(quiet, joints, 0)) == heard
    for farthest, heard in ((0.28, True), (0.26, False)):
        short = replace(quiet, ranger=replace(quiet.ranger, farthest=farthest))
        assert np.isfinite(echoes(short, at_rest(short), 0)) == heard


def duet(machine, late=0.0, beam=None, farthest=None, noise=0.0):
    """Start of the left arm's one pick, and the timetable; the middle arm picks on the left arm's side before it.

    The middle arm's fruit hangs 0.1 m lower, where the left arm waits below its own: it hears the other's whole stay.
    """
    changes = {k: v for k, v in (("beam", beam), ("farthest", farthest), ("noise", noise)) if v is not None}
    machine = replace(machine, ranger=replace(machine.ranger, **changes))
    master = pick_point(machine, np.array([[0.2, -1.2, 1.2], [-0.2, -1.2, 1.2]]))
    joints = np.array(
        [[[0.0, 0.3, 0.6], [0.0, -0.1, 0.6]], [[-0.1, 0.35, 0.85], [0.0, 0.0, 0.6]], [[0.0, 0.0, 0.6]] * 2]
    )
    fruit = np.array([machine.tips(master, joints[:, 0])[1], machine.tips(master, joints[:, 1])[0]])
    work = zone_work(machine, master, fruit)
    assert work.reached[1, 0] and work.reached[0, 1]
    delays = np.zeros((3, 2))
    delays[1, 0] = late
    free = np.zeros_like(work.conflict)
    work = replace(work, first=np.array([0.0, READY]), conflict=free, duration=work.duration + delays)
    times = timetable(work, ((1,), (0,), ()), hold=ultrasonic_hold(machine, work, np.random.default_rng(0)))
    return float(times.start[times.arm == 0][0]), times, work, machine


def test_a_side_arm_sets_out_once_its_neighbour_is_heard_far_enough_away(quiet):
    start, times, work, machine = duet(quiet)
    assert start > READY
    joints = slave_joints_at(machine, work, times, np.array([start - machine.ranger.period, start]))
    joints[:, 0] = machine.slave_home
    joints[:, 0, 0] = work.joints[0, 1, 0] - work.approach[1]
    before, now = echoes(machine, joints, 0)
    assert before < machine.body.guard <= now


@pytest.mark.parametrize("late", [1.0, 3.0])
def test_a_late_neighbour_is_noticed(quiet, late):
    on_time, waiting = duet(quiet)[0], duet(quiet, late=late)[0]
    assert waiting - on_time == pytest.approx(late, abs=quiet.ranger.period + 1e-9)


@pytest.mark.parametrize("deaf", [{"farthest": 0.05}, {"beam": 0.0}])
def test_what_it_does_not_hear_it_does_not_wait_for(quiet, deaf):
    """The swinging arm stands 0.1 m away and more, and crosses no narrow cone at the cup while it is stretched."""
    if "beam" in deaf:
        lifted = duet(quiet, late=3.0)[0]
        start = duet(quiet, late=3.0, **deaf)[0]
        assert start <= lifted
    else:
        assert duet(quiet, late=3.0, **deaf)[0] == pytest.approx(READY)


def test_noise_is_drawn_from_the_generator_that_is_given(machine):
    starts = {duet(machine, noise=0.05)[0] for _ in range(3)}
    assert len(starts) == 1


def test_middle_arms_have_no_ranger(quiet):
    _, times, work, machine = duet(quiet)
    hold = ultrasonic_hold(machine, work, np.random.default_rng(0))
    assert hold(MIDDLE, 0, 0.3, times) == 0.3


def test_a_plan_of_lis_holds_side_arms_where_fruit_hangs_level_and_never_the_middle_arm(machine):
    """His order keeps the arms at different heights: in a zone of 0.2 m some still hear each other."""
    rng, held, picks = np.random.default_rng(1), 0, 0
    for _ in range(30):
        corner = np.array([rng.uniform(-0.9, 0.9) - 0.35, -1.4, rng.uniform(0.42, 1.87)])
        fruit = corner + np.array([0.7, 0.4, 0.2]) * rng.random((10, 3))
        work = zone_work(machine, pick_point(machine, fruit), fruit)
        work = replace(work, conflict=np.zeros_like(work.conflict), first=rng.uniform(0.0, 4.0, 10))
        times = timetable(work, assign(work, "li"), hold=ultrasonic_hold(machine, work, rng))
        assert (times.held[times.arm == MIDDLE] < 1e-9).all()
        held, picks = held + int((times.held > 1e-9).sum()), picks + len(times.arm)
    assert 0 < held < picks / 2
