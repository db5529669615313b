"""Harvest-v0, one event at a time: what each period's reward, counters and rate must be is worked out here by hand."""

import math
import re
from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest

from pickenv.base import InputError
from pickenv.envs import HarvestEnv, HarvestVectorEnv
from pickenv.envs.harvesting import harvest_task as batch
from pickenv.envs.harvesting.harvest_task import distances, harvest_spaces, make_harvest_task
from pickenv.harvester import Luck
from pickenv.orchard import depth_behind_face

MIDDLE, SIDE, LEFT = 1, 2, 0
UP, SWING, STRETCH = range(3)
"""A slave's joints; those of slave i stand at 3 + 3 i."""
FAR = [0.0, 9.0, 0.0]
"""From a cup to a fruit that no cup comes near."""
JOINTS = np.array([-1.3, 0.9, 0.7] + 3 * [0.0, 0.0, 0.5])
"""Slaves straight ahead, 350 mm apart, with room in every joint."""
TAKEN = {"grasp": 0.0, "cluster": 0.0, "cut": 0.0, "whole": 0.0, "push": 0.0, "heading": 0.0}


@pytest.fixture
def begin(monkeypatch):
    """``begin(offsets, joints, luck, **state)``: a zone with fruit of 60 mm at ``offsets`` from the middle cup."""

    def build(offsets, joints=JOINTS, luck=None, machines=1, **changes):
        env = HarvestEnv(ideal=True, fruit=len(offsets), vision="ideal")
        env.task = replace(env.task, model=replace(env.task.model, push=0.0))
        env.reset(seed=0)
        fate = TAKEN | (luck or {})
        monkeypatch.setattr(batch, "draw_luck", lambda _, count: Luck(*(np.full(count, fate[k]) for k in Luck._fields)))
        joints = np.array(joints, dtype=float)
        middle = env.task.machine.tips(joints[:3], joints[3:].reshape(-1, 3))[MIDDLE]
        fruit = (middle + np.array(offsets))[None]
        usual = {
            "joints": joints[None],
            "fruit": fruit,
            "believed": fruit.copy(),
            "diameters": np.full((1, len(offsets)), 0.06),
            "masses": np.full((1, len(offsets)), 0.1),
            "reachable": np.ones((1, len(offsets)), dtype=bool),
        }
        env.state = replace(env.state, **(usual | {key: np.array([value]) for key, value in changes.items()}))
        env.state.left = batch.work_left(env.task, env.state)
        return env

    return build


def action(moves=None):
    """An action of given shares, by joint."""
    shares = np.zeros(12)
    for joint, share in (moves or {}).items():
        shares[joint] = share
    return shares


def joint(arm, which):
    return 3 + 3 * arm + which


def counters(info):
    return tuple(info[key] for key in ("collected", "lost", "attempts", "held", "is_success"))


def test_the_reward_is_made_of_the_numbers_that_the_class_states():
    words = " ".join(HarvestEnv.__doc__.split())
    said = re.search(
        r"Per period: (\S+) x \(fruit collected whole\) - (\S+) x \(fruit damaged\) \+ \(progress in m\) - (\S+) x "
        r"\(arms that the guard holds\) - (\S+) - (\S+) x \(mean size",
        words,
    )
    assert [float(number) for number in said.groups()] == [1.0, 1.0, 0.05, 0.005, 0.005]


def test_a_period_without_an_event_costs_its_time(begin):
    env = begin([[0.0, 0.0, 0.3], FAR], reachable=[True, False])
    _, reward, over, late, info = env.step(action())
    assert reward == pytest.approx(-0.005) and not over and not late
    assert counters(info) == (0, 0, 0, 0, False) and info["picks_per_hour"] == 0.0
    assert info["reachable"] == 1 and info["closest_mm"] == pytest.approx(350.0)


@pytest.mark.parametrize("share", [1.0, -0.5])
def test_progress_is_metres_nearer_shared_by_the_fruit_of_the_zone_and_motion_has_its_price(begin, share):
    """The middle cup rises 40 mm at the most towards a fruit 300 mm above; of four fruit one more is out of reach."""
    env = begin([[0.0, 0.0, 0.3], FAR, FAR, FAR], reachable=[True, False, False, False])
    _, reward, *_, info = env.step(action({joint(MIDDLE, UP): share}))
    assert reward == pytest.approx(0.04 * share / 4 - 0.005 - 0.005 * abs(share) / 12, abs=1e-12)
    assert counters(info) == (0, 0, 0, 0, False)


def test_all_joints_at_their_fastest_cost_twice_the_time_even_where_they_are_held(begin):
    env = begin([FAR], reachable=[False], busy=[3, 3, 3])
    assert env.step(np.ones(12))[1] == pytest.approx(-0.005 - 0.005)


def test_a_collected_fruit_is_worth_one(begin):
    env = begin([[0.0, 0.0, 0.0], FAR], reachable=[True, False])
    _, reward, over, _, info = env.step(action())
    assert reward == pytest.approx(1.0 - 0.005)
    assert counters(info) == (1, 0, 1, 0, True)
    assert info["picks_per_hour"] == pytest.approx(1 / 0.1 * 3600)  # one fruit in one period of 0.1 s
    assert not over  # the blade is still at work


def test_a_collected_fruit_also_takes_away_what_was_left_of_its_way(begin):
    """3 mm off, within the 5 that the cup forgives: progress is 3 mm, shared by two fruit."""
    env = begin([[0.003, 0.0, 0.0], FAR], reachable=[True, False])
    assert env.step(action())[1] == pytest.approx(1.0 + 0.003 / 2 - 0.005)


def test_a_damaged_fruit_costs_one_and_is_no_success(begin):
    env = begin([[0.0, 0.0, 0.0]], luck={"whole": 0.999})
    _, reward, _, _, info = env.step(action())
    assert reward == pytest.approx(-1.0 - 0.005)
    assert counters(info) == (0, 1, 1, 0, False) and info["picks_per_hour"] == 0.0


@pytest.mark.parametrize("luck", [{"grasp": 0.9}, {"cut": 0.999}])
def test_an_empty_cup_has_tried_and_looks_again(begin, luck):
    """The fruit hangs 7 mm off, where the gatherer takes 1 - (7 - 5)/5 = 0.6 of them; it was believed at 30 mm."""
    env = begin([[0.007, 0.0, 0.0], FAR], luck=luck, reachable=[True, False])
    env.state.believed[0, 0, 0] += 0.023
    env.state.left = batch.work_left(env.task, env.state)
    _, reward, over, _, info = env.step(action())
    assert reward == pytest.approx((0.030 - 0.007) / 2 - 0.005)
    assert counters(info) == (0, 0, 1, 0, False) and not over
    assert env.state.believed[0, 0] == pytest.approx(env.state.fruit[0, 0])


@pytest.mark.parametrize(("grasp", "taken"), [(0.59, 1), (0.61, 0)])
def test_beyond_its_clearance_the_cup_takes_ever_fewer(begin, grasp, taken):
    env = begin([[0.007, 0.0, 0.0]], luck={"grasp": grasp})
    assert counters(env.step(action())[-1])[0] == taken


@pytest.mark.parametrize(("offset", "tries"), [
    ([0.039, 0.0, 0.0], 1), ([0.041, 0.0, 0.0], 0), ([0.0, 0.0, 0.014], 1), ([0.0, 0.0, -0.016], 0)
])  # fmt: skip
def test_a_cup_tries_what_is_inside_its_40_mm_wall_and_its_sensors_15(begin, offset, tries):
    env = begin([offset], luck={"grasp": 1.0})
    assert counters(env.step(action())[-1])[2] == tries


def test_a_cup_tries_again_only_after_going_50_mm_away(begin):
    """40 mm down and back again is not enough; 80 mm is."""
    env = begin([[0.0, 0.0, 0.0]], luck={"grasp": 1.0})
    env.step(action())
    env.state.busy[:] = 0
    down, up = (action({joint(MIDDLE, UP): share}) for share in (-1.0, 1.0))
    for moves, attempts in (([down, up], 1), ([down, down, up, up], 2)):
        for move in moves:
            *_, info = env.step(move)
        assert info["attempts"] == attempts


def test_sensing_and_cutting_take_a_second_in_which_arm_and_master_stand(begin):
    env = begin([[0.0, 0.0, 0.0], [0.0, 0.0, 0.5]])
    env.step(action())
    assert env.state.busy[0].tolist() == [0, 10, 0]  # 0.2 s to sense and 0.8 s to cut, of 0.1 s each
    before = env.state.joints[0].copy()
    for left in range(9, -1, -1):
        seen = env.step(action({0: 1.0, 1: 1.0, 2: -1.0, joint(MIDDLE, UP): 1.0, joint(SIDE, UP): 0.1}))[0]
        assert seen[12:15] == pytest.approx([0.0, left / 10, 0.0])
    moved = env.state.joints[0] - before
    wanted = np.zeros(12)
    wanted[joint(SIDE, UP)] = 10 * 0.1 * 0.04
    assert moved == pytest.approx(wanted)
    env.step(action({1: 1.0, joint(MIDDLE, UP): -1.0}))
    assert env.state.joints[0, [1, joint(MIDDLE, UP)]] - before[[1, joint(MIDDLE, UP)]] == pytest.approx([0.04, -0.04])


def test_a_blade_stops_its_own_master_alone():
    """Three machines side by side: nobody cuts, one arm does, and all three are in their last period."""
    envs = HarvestVectorEnv(3, fruit=2)
    envs.reset(seed=0)
    envs.state.busy[:] = [[0, 0, 0], [0, 5, 0], [1, 1, 1]]
    before = envs.state.joints.copy()
    inwards = np.where(before[:, :3] > (envs.task.machine.lower + envs.task.machine.upper)[:3] / 2, -0.5, 0.5)
    envs.step(np.hstack([inwards, np.zeros((3, 9))]).astype(np.float32))
    moved = envs.state.joints[:, :3] - before[:, :3]
    assert moved[0] == pytest.approx(inwards[0] * envs.task.increment[:3])
    assert not moved[1:].any()


def test_the_end_waits_for_the_blade(begin):
    env = begin([[0.0, 0.0, 0.0]])
    overs = [env.step(action())[2] for _ in range(11)]
    assert overs == [False] * 10 + [True]


@pytest.mark.parametrize(("cluster", "taken"), [(0.49, 1), (0.51, 0)])
def test_in_a_cluster_half_of_the_attempts_fail(begin, cluster, taken):
    """A fruit 65 mm beside: nearer than the cup's wall, 40 mm, and half a fruit, 30 mm."""
    env = begin([[0.0, 0.0, 0.0], [0.065, 0.0, 0.0], FAR], luck={"cluster": cluster}, reachable=[True, True, False])
    _, reward, *_, info = env.step(action())
    assert counters(info) == (taken, 0, 1, 0, False)
    assert reward == pytest.approx(taken - 0.005)


@pytest.mark.parametrize(
    ("offset", "status"), [([0.075, 0.0, 0.0], batch.HANGING), ([0.065, 0.0, 0.0], batch.COLLECTED)]
)
def test_fruit_beyond_the_wall_or_picked_before_is_in_no_cups_way(begin, offset, status):
    env = begin([[0.0, 0.0, 0.0], offset], luck={"cluster": 1.0}, status=[batch.HANGING, status])
    assert env.step(action())[-1]["collected"] == 1 + (status == batch.COLLECTED)


def test_a_cup_that_goes_in_pushes_the_neighbours_and_a_share_of_it_stays(begin):
    """16 mm, at 150 mm exp(-1) of it: 35 % for good, and 65 % swings; what the cup takes does not move."""
    env = begin([[0.0, 0.0, 0.0], [0.0, 0.15, 0.0]], luck={"heading": math.pi / 2})
    env.task = replace(env.task, model=replace(env.task.model, push=0.016))
    env.step(action())
    push = 0.016 / math.e
    assert env.state.shift[0, 1] == pytest.approx([0.0, 0.35 * push, 0.0], abs=1e-12)
    assert env.state.swing[0, 1] == pytest.approx([0.0, 0.65 * push, 0.0], abs=1e-12)
    assert not env.state.moved[0, 0].any()


def test_an_empty_cup_sees_where_its_own_push_has_left_the_fruit(begin):
    env = begin([[0.0, 0.0, 0.0]], luck={"grasp": 1.0})
    env.task = replace(env.task, model=replace(env.task.model, push=0.016))
    env.step(action())
    assert env.state.believed[0, 0] - env.state.fruit[0, 0] == pytest.approx([0.35 * 0.016, 0.0, 0.0])


def test_a_cup_finds_a_fruit_where_it_was_pushed_to(begin):
    """The cup is where a fruit hangs since it was pushed 30 mm; one 60 mm away is still 30 short, and is not taken."""
    env = begin([[-0.03, 0.0, 0.0], FAR], reachable=[True, False])
    env.state.shift[0, 0, 0] = 0.03
    assert counters(env.step(action())[-1])[:3] == (1, 0, 1)
    env = begin([[-0.06, 0.0, 0.0], FAR], reachable=[True, False])
    env.state.shift[0, 0, 0] = 0.03
    assert counters(env.step(action())[-1])[:3] == (0, 0, 1)


def side_by_side(level):
    """The left arm swung until its cup is ``level`` m beside the line of the middle arm, and both straight lengths."""
    joints = JOINTS.copy()
    joints[joint(LEFT, STRETCH)] = 0.8
    joints[joint(LEFT, SWING)] = -math.asin((0.35 - level) / 0.8)
    joints[joint(MIDDLE, STRETCH)] = 0.86
    return joints


def test_the_guard_holds_both_arms_that_would_come_too_near(begin):
    """101 mm apart, of the 2 x 40 + 20 that are kept; 3 degrees more would be some 40 mm nearer. Each costs 0.05."""
    env = begin([FAR], side_by_side(0.101), reachable=[False])
    before = env.state.joints.copy()
    moves = {joint(LEFT, SWING): -0.5, joint(MIDDLE, UP): 0.2, joint(SIDE, UP): 0.5}
    _, reward, _, _, info = env.step(action(moves))
    assert reward == pytest.approx(-2 * 0.05 - 0.005 - 0.005 * 1.2 / 12)
    assert counters(info)[3] == 2 and info["closest_mm"] == pytest.approx(101.0)
    wanted = before[0].copy()
    wanted[joint(SIDE, UP)] += 0.5 * 0.04
    assert env.state.joints[0] == pytest.approx(wanted)


def test_the_guard_also_looks_half_way(begin):
    """95 mm apart in plan, one rises past the other: sqrt(95^2 + 40^2) = 103 mm at both ends, 95 mm between."""
    joints = side_by_side(0.095)
    joints[[joint(LEFT, UP), joint(MIDDLE, UP)]] = [-0.02, 0.02]
    for share, held in ((1.0, 2), (0.1, 0)):
        env = begin([FAR], joints, reachable=[False])
        *_, info = env.step(action({joint(LEFT, UP): share, joint(MIDDLE, UP): -share}))
        assert info["held"] == held
    assert info["closest_mm"] == pytest.approx(math.hypot(95.0, 40.0 - 2 * 4.0))


def test_arms_that_pass_each_other_were_nearest_half_way(begin):
    """101 mm apart in plan, one rises past the other: 40 mm of height between them at both ends, none between."""
    joints = side_by_side(0.101)
    joints[[joint(LEFT, UP), joint(MIDDLE, UP)]] = [-0.02, 0.02]
    env = begin([FAR], joints, reachable=[False], closest=math.hypot(0.101, 0.04))
    *_, info = env.step(action({joint(LEFT, UP): 1.0, joint(MIDDLE, UP): -1.0}))
    assert info["held"] == 0 and info["closest_mm"] == pytest.approx(101.0)


def test_success_is_all_fruit_in_reach_and_the_rate_counts_what_is_collected(begin):
    status = [batch.COLLECTED, batch.COLLECTED, batch.HANGING, batch.LOST]
    for reachable, success in (([True, True, False, False], True), ([True, True, True, False], False)):
        env = begin([FAR, FAR, FAR, FAR], status=status, reachable=reachable, periods=19)
        *_, info = env.step(action())
        assert counters(info) == (2, 1, 0, 0, success)
        assert info["picks_per_hour"] == pytest.approx(2 / (20 * 0.1 / 3600))  # 3600 an hour


def test_time_runs_out_after_the_periods_that_are_given():
    env = gym.make("pickenv/Harvest-v0", max_episode_steps=3)
    env.reset(seed=0)
    ends = [env.step(np.zeros(12))[1:4] for _ in range(3)]
    assert [late for *_, late in ends] == [False, False, True]
    assert [reward for reward, *_ in ends] == pytest.approx([-0.005] * 3)
    assert gym.spec("pickenv/Harvest-v0").max_episode_steps == 600


def test_the_observation_is_right_of_ahead_of_and_above_frame_3(begin):
    """The master heads along -y (turn -90 degrees): right is -x, and frame 3 stands where `Machine.frame3` says."""
    joints = JOINTS.copy()
    joints[0] = -math.pi / 2
    env = begin([[0.1, -0.2, 0.3], FAR, [0.0, 0.0, 0.4]], joints, reachable=[True, True, False], busy=[0, 5, 10])
    machine, seen = env.task.machine, batch.observe(env.task, env.state)[0]
    away = env.state.believed[0] - machine.frame3(joints[:3])
    assert seen[:12] == pytest.approx(2 * (joints - machine.lower) / (machine.upper - machine.lower) - 1, abs=1e-6)
    assert seen[12:15] == pytest.approx([0.0, 0.5, 1.0])
    assert seen[15:19] == pytest.approx([-away[0, 0], -away[0, 1], away[0, 2], 1.0], abs=1e-6)
    assert seen[19:23] == pytest.approx([-away[1, 0], -2.0, away[1, 2], 1.0], abs=1e-6)  # 2 m at the most are shown
    assert seen[23:].tolist() == [0.0, 0.0, 0.0, 0.0]


def test_a_zone_is_drawn_where_the_class_says():
    """0.7 x 0.4 x 0.55 m on the tree's side, 1.0 to 1.4 m away; the master at its pick point, the slaves at rest."""
    task = make_harvest_task(fruit=40)
    state = batch.begin_zones(task, [np.random.default_rng(seed) for seed in range(60)])
    size = state.fruit.max(axis=1) - state.fruit.min(axis=1)
    assert (size <= [0.7, 0.4, 0.55]).all() and (size.mean(axis=0) > 0.9 * np.array([0.7, 0.4, 0.55])).all()
    canopy, height = task.orchard.canopy, state.fruit[..., 2] + task.machine.base_height
    assert -canopy.standoff - 0.4 <= state.fruit[..., 1].min() and state.fruit[..., 1].max() <= -canopy.standoff
    assert np.abs(state.fruit[..., 0]).max() <= canopy.width / 2
    assert canopy.bottom <= height.min() < canopy.bottom + 0.1 and canopy.top - 0.1 < height.max() <= canopy.top
    assert np.abs(state.fruit[..., 0]).max() > canopy.width / 2 - 0.1
    assert state.error == pytest.approx(state.believed - state.fruit) and 0.5 < state.located.mean() < 1.0
    assert (state.joints[:, 3:].reshape(60, 3, 3) == task.machine.slave_home).all()
    reached = [task.machine.reach(joints[:3], seen).any(axis=0) & found for joints, seen, found in
               zip(state.joints, state.believed, state.located, strict=True)]  # fmt: skip
    assert np.array_equal(state.reachable, reached)
    assert not state.status.any() and not state.busy.any() and (state.tried == -1).all() and not state.periods.any()
    assert (state.closest == pytest.approx(0.35)) and len(np.unique(state.fruit[:, 0, 0])) == 60


def test_what_is_made_of_nothing_said_is_li_s_machine_as_built_before_eight_fruit():
    task = make_harvest_task()
    machine = task.machine
    assert (machine.arms, task.fruit, task.lead) == (3, 8, 10) and machine.spacing == pytest.approx(0.35)
    slaves = JOINTS[3:].reshape(1, 3, 3)
    ideal = make_harvest_task(ideal=True)
    for made, off in ((task, True), (HarvestEnv().task, True), (ideal, False), (HarvestEnv(ideal=True).task, False)):
        error = made.true.tips(JOINTS[None, :3], slaves)[0] - machine.tips(JOINTS[:3], slaves[0])
        assert (np.linalg.norm(error, axis=1) > 1e-3).all() == off and (np.abs(error).max() > 1e-9) == off


@pytest.mark.parametrize("slaves", [2, 3, 4])
def test_the_guard_watches_every_pair_of_neighbours(slaves):
    """All arms swing towards the last two's gap: what would meet is held, and one arm alone is never."""
    env = HarvestEnv(slaves=slaves, fruit=1)
    env.reset(seed=0)
    held, closest = 0, np.inf
    for _ in range(12):
        moves = np.zeros(3 + 3 * slaves)
        moves[5::3], moves[4::3] = 1.0, np.where(np.arange(slaves) == slaves - 1, 1.0, -1.0)
        *_, info = env.step(moves)
        held, closest = held + info["held"], min(closest, info["closest_mm"])
    assert held > 0 and closest >= 100.0 - 1e-6
    alone = HarvestEnv(slaves=1, fruit=1)
    alone.reset(seed=0)
    assert alone.step(np.ones(6))[-1]["held"] == 0


def test_the_spaces_have_room_for_joints_blades_fruit_and_what_else_is_asked():
    seen, acted = harvest_spaces(make_harvest_task(slaves=2, fruit=2), extra=3)
    assert seen.high.tolist() == [1.0] * 11 + [2.0, 2.0, 2.0, 1.0] * 2 + [1.0] * 3
    assert seen.low.tolist() == [-1.0] * 9 + [0.0] * 2 + [-2.0, -2.0, -2.0, 0.0] * 2 + [0.0] * 3
    assert acted.high.tolist() == [1.0] * 9 and acted.low.tolist() == [-1.0] * 9


@pytest.mark.parametrize("slaves", [1, 2])
def test_one_arm_alone_is_as_clear_as_can_be_shown(slaves):
    env = HarvestEnv(slaves=slaves, fruit=1)
    assert env.reset(seed=0)[1]["closest_mm"] == pytest.approx(2000.0 if slaves == 1 else 350.0)


def test_a_zone_has_one_to_forty_fruit():
    for fruit in (1, 40):
        assert HarvestEnv(fruit=fruit).observation_space.shape == (12 + 3 + 4 * fruit,)
    for fruit in (0, 41, 2.0, True):
        with pytest.raises(InputError, match="whole number from 1 to 40"):
            HarvestEnv(fruit=fruit)


def test_fruit_and_joints_are_as_asked_for_alone_and_among_many():
    env, several = HarvestEnv(fruit=3), HarvestVectorEnv(2, fruit=3)
    env.reset(seed=0)
    fruit, start = env.state.fruit[0] + [0.02, 0.0, 0.01], env.state.joints[0].copy()
    start[0] += 0.05
    options = {"fruit": fruit, "start_joints": start}
    seen, _ = env.reset(seed=7, options=options)
    many, _ = several.reset(seed=7, options=options)
    np.testing.assert_array_equal(many[0], seen)
    np.testing.assert_array_equal(several.state.fruit, np.stack([fruit, fruit]))
    np.testing.assert_array_equal(several.state.joints, np.stack([start, start]))
    each = np.stack([fruit, fruit + 0.01])
    several.reset(options={"fruit": each, "reset_mask": np.array([False, True])})
    np.testing.assert_array_equal(several.state.fruit, each)
    still = np.zeros((2, env.task.machine.joints))
    np.testing.assert_array_equal(several.step(still)[0][0], env.step(still[0])[0])


@pytest.mark.parametrize(("swing", "apart"), [(0.11, 0.160), (0.164, 0.066)])
def test_arms_may_not_begin_nearer_than_the_guard_lets_them(swing, apart):
    """Two long slaves swung towards one another; the guard keeps 0.1 m between their centre lines."""
    env = HarvestEnv(fruit=3)
    env.reset(seed=0)
    start = env.state.joints[0].copy()
    start[4:6], start[7:9] = (-swing, 0.868), (swing, 0.868)
    assert distances(env.task, start[None])[0] == pytest.approx(apart, abs=1e-3)
    if apart > 0.1:
        env.reset(seed=0, options={"start_joints": start})
        np.testing.assert_array_equal(env.state.joints[0], start)
    else:
        with pytest.raises(InputError, match="start_joints brings two arms nearer than the guard lets them"):
            env.reset(seed=0, options={"start_joints": start})


def test_fruit_in_reach_is_that_of_the_pick_point_wherever_the_machine_begins():
    """As it is carried, the machine reaches nothing: that is no zone picked empty."""
    env = HarvestEnv(ideal=True, vision="ideal")
    machine = env.task.machine
    *_, usual = env.reset(seed=0)
    start = np.concatenate([machine.master_start, *[machine.slave_home] * machine.arms])
    *_, info = env.reset(seed=0, options={"start_joints": start})
    assert not machine.reach(start[:3], env.state.fruit[0]).any()
    assert info["reachable"] == usual["reachable"] > 0 and not info["is_success"]
    assert not env.step(np.zeros(machine.joints))[2]


def test_a_zone_without_fruit_in_reach_is_drawn_anew_and_refused_where_it_is_given():
    """One fruit in 150 is nowhere near where the single slave stands; 5 m away or behind the cameras none is."""
    state = batch.begin_zones(
        make_harvest_task(slaves=1, fruit=1), [np.random.default_rng(seed) for seed in range(150)]
    )
    assert state.reachable.any(axis=1).all()
    for y in (-5.0, 1.0):
        with pytest.raises(InputError, match="no fruit in reach in 100 zones; move the fruit of the option"):
            HarvestEnv(fruit=1).reset(seed=0, options={"fruit": [[0.0, y, 1.0]]})


def test_fruit_hangs_in_a_canopy_that_leans():
    task = make_harvest_task(canopy="v_trellis", vision="ideal", fruit=40)
    canopy = task.orchard.canopy
    fruit = batch.begin_zones(task, [np.random.default_rng(seed) for seed in range(5)]).fruit
    turned = fruit * [-1.0, -1.0, 1.0] + [0.0, -canopy.standoff, task.machine.base_height]
    depth = depth_behind_face(canopy, turned)
    assert canopy.lean < 0.0 and 0.0 <= depth.min() < 0.02 and canopy.depth - 0.02 < depth.max() <= canopy.depth


def test_a_number_of_fruit_may_come_from_numpy():
    assert HarvestEnv(fruit=np.int64(4)).observation_space.shape == (12 + 3 + 4 * 4,)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"fruit": np.zeros((2, 3))}, r"fruit has shape \(2, 3\); give finite numbers of shape \(3, 3\)"),
        (
            {"fruit": np.full((3, 3), np.nan)},
            r"^option fruit is \[\[nan, nan.*; give finite numbers of shape \(3, 3\)$",
        ),
        ({"start_joints": "home"}, "start_joints is 'home'; give numbers"),
        ({"start_joints": [99.0] * 12}, "outside the joint limits"),
    ],
)
def test_zones_that_cannot_be_are_refused(options, said):
    with pytest.raises(InputError, match=said):
        HarvestEnv(fruit=3).reset(seed=0, options=options)
