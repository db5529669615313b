"""Pick-v0, one event at a time: what each step's reward, funnel and success must be is worked out here by hand."""

import math
import re
from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest

from pickenv.arm import forward
from pickenv.envs import PickEnv
from pickenv.envs.picking.canopies import Canopies
from pickenv.envs.picking.pick_arm import TOOL
from pickenv.envs.picking.pick_scene import FRUIT, PickScene

STAGES = ("present", "visible", "reachable", "attempted", "attached", "detached", "collected", "damaged")
START = np.array([0.0, 0.3, 0.4, 0.0, 0.2, 0.0])
"""The tool stands upright, for the two pitches are zero; the rail moves it across, the end slide up and down."""
STAY, CLOSE, TWIST, OPEN = ([0.0] * 6 + [gripper] for gripper in (0.0, 0.6, 1.0, -0.6))
DOWN = [0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0]
"""The end slide's largest increment: 50 mm."""
FAR = [0.5, -0.5, 0.4]
"""From the tool to a fruit that nothing here comes near."""


@pytest.fixture(scope="module")
def env():
    return PickEnv(plant="ideal", camera="perfect")


def scene_of(orchard, rest, **changes):
    """Fruit of 60 mm and 100 g at rest, seen where it hangs, all in reach, which a twist of 0.3 N m or 5 N take off."""
    rest = np.atleast_2d(np.asarray(rest, dtype=float))
    usual = {
        "diameters": 0.06,
        "masses": 0.1,
        "pull_limit": 5.0,
        "twist_limit": 0.3,
        "visible": True,
        "reachable": True,
    }
    fruit = np.zeros(len(rest), FRUIT)
    for name, values in {"rest": rest, "seen": rest, **usual, **changes}.items():
        fruit[name] = values
    return PickScene(orchard, fruit)


def before(env, *offsets, start=START, **changes):
    """The fruit of an episode that begins, at ``offsets`` from the tool; the first is the next to pick."""
    tool = forward(env.plant.arm.nominal, start).position
    env.reset(seed=0, options={"fruit": [[0.6, -0.7, 0.5]], "start_joints": start})
    env.scene = scene_of(env.orchard, tool + np.array(offsets), **changes)
    env.canopies.adopt(0, env.scene)
    return env.scene


def advance(env, scene, before, tool, number=0):
    """A tenth of a second in which the true tool, after fruit ``number``, gets from one frame to another."""
    canopies = Canopies(env.task, scene.orchard, 1)
    canopies.adopt(0, scene)
    canopies.sight[TOOL, 0], canopies.number[0] = tool, number
    canopies.meet(np.array([True]), np.array([before[9:]]), np.array([0.1]))


def act(env, action):
    """Reward, counters in the order of `STAGES`, whether it is a success, and whether the episode is over."""
    _, reward, over, late, info = env.step(np.array(action))
    assert not late
    return reward, tuple(info[stage] for stage in STAGES), info["is_success"], over


def test_the_reward_is_made_of_the_numbers_that_the_class_states():
    said = re.search(r"Per step: (\S+) x \(fruit collected undamaged\) - (\S+) x \(fruit newly damaged\) - (\S+?)\. ",
                     PickEnv.__doc__)  # fmt: skip
    assert [float(number) for number in said.groups()] == [1.0, 0.25, 0.002]


def test_a_step_without_an_event_costs_its_time(env):
    before(env, [0.0, 0.0, 0.3], FAR, FAR, reachable=np.array([True, True, False]))
    assert act(env, STAY) == (-0.002, (3, 3, 2, 0, 0, 0, 0, 0), False, False)
    *_, info = env.step(np.array(STAY))
    assert (info["grasp_lateral_mm"], info["grasp_axial_mm"]) == (0.0, 0.0)  # no grasp yet


def test_one_fruit_goes_all_the_way_down_the_funnel(env):
    """Closed on, twisted off with 1 x 0.5 N m of the 0.3 that it takes, 50 and then 100 mm down of the 80 asked."""
    before(env, [0.0, 0.0, 0.0])
    assert act(env, CLOSE) == (-0.002, (1, 1, 1, 1, 1, 0, 0, 0), False, False)
    assert act(env, TWIST) == (-0.002, (1, 1, 1, 1, 1, 1, 0, 0), False, False)
    assert act(env, DOWN) == (-0.002, (1, 1, 1, 1, 1, 1, 0, 0), False, False)
    assert act(env, DOWN) == (1.0 - 0.002, (1, 1, 1, 1, 1, 1, 1, 0), True, True)


def test_a_picks_duration_has_the_parts_that_are_not_simulated(env):
    """0.1 s a step; 1.0 s for a grasp, whatever becomes of it; 2.5 s more for a fruit that goes to the bin."""
    before(env, [0.0, 0.0, 0.0], [0.0, 0.0, 0.2], [0.3, 0.0, 0.0])
    passed = [env.step(np.array(action))[-1]["duration_s"] for action in (STAY, CLOSE, TWIST, DOWN, DOWN)]
    assert passed == pytest.approx([0.1, 1.2, 1.3, 1.4, 4.0])
    before(env, [0.006, 0.0, 0.0], FAR)
    assert env.step(np.array(CLOSE))[-1]["duration_s"] == pytest.approx(1.1)  # a miss
    before(env, [0.0, 0.0, 0.0])
    for action in (CLOSE, TWIST, OPEN):
        *_, info = env.step(np.array(action))
    assert info["damaged"] == 1 and info["duration_s"] == pytest.approx(1.3)  # it fell, and goes nowhere


def test_a_fruit_is_unloaded_at_the_very_height_and_not_above_it():
    """Heights that have no rounding: it came off at 0.5 m, 0.125 m below it is collected."""
    station = replace(PickEnv().orchard.station, collected_below=0.125)
    scene = scene_of(replace(PickEnv().orchard, station=station), [0.0, 0.0, 0.0])
    scene.attached[0] = scene.detached[0] = True
    scene.held, scene.detached_at = 0, 0.5
    for height, collected in ((np.nextafter(0.375, 1.0), False), (0.375, True)):
        scene.work_gripper(0.0, 0, upright([0.0, 0.0, height]), upright([0.0, 0.0, 9.0]))
        assert scene.collected[0] == collected and (scene.held is None) == collected


@pytest.mark.parametrize(("down", "collected"), [(0.79, 0), (0.81, 1)])
def test_a_fruit_is_unloaded_80_mm_below_where_it_came_off(env, down, collected):
    before(env, [0.0, 0.0, 0.0])
    act(env, CLOSE)
    act(env, TWIST)
    half = [down * share for share in DOWN]  # two steps of 50 mm at the most: 79 mm, then 81
    act(env, half)
    reward, counters, success, over = act(env, half)
    assert reward == collected - 0.002
    assert counters[-2:] == (collected, 0) and success == over == bool(collected)


def test_a_miss_is_the_fruits_one_attempt(env):
    """6 mm off, where a cup of 70 mm around a fruit of 60 forgives 5; the other fruit becomes the next."""
    scene = before(env, [0.006, 0.0, 0.004], FAR)
    *_, info = env.step(np.array(CLOSE))
    assert info["grasp_lateral_mm"] == pytest.approx(6.0) and info["grasp_axial_mm"] == pytest.approx(4.0)
    assert info["fruit_number"] == 1 and scene.held is None
    assert act(env, CLOSE) == (-0.002, (2, 2, 2, 1, 0, 0, 0, 0), False, False)


def test_a_miss_of_the_last_fruit_ends_the_episode_without_success(env):
    before(env, [0.006, 0.0, 0.0])
    assert act(env, CLOSE) == (-0.002, (1, 1, 1, 1, 0, 0, 0, 0), False, True)


def test_a_miss_pushes_its_fruit_20_mm_and_neighbours_less_and_no_fruit_beyond_150(env):
    """A neighbour 150 mm off is moved by exp(-150/150) of it; one pushed before goes no farther than 150 mm."""
    scene = scene_of(env.orchard, [[0.0, 0.0, 0.0], [0.0, 0.15, 0.0], [0.0, 0.0, 0.001]])
    scene.displacement[2] = [0.149, 0.0, 0.0]
    scene.grasp(0, upright([-0.03, 0.0, 0.0]))  # 30 mm off: a miss
    assert scene.displacement[0] == pytest.approx([0.02, 0.0, 0.0])
    assert scene.displacement[1] == pytest.approx([0.02 / math.e, 0.0, 0.0])
    assert scene.displacement[2] == pytest.approx([0.15, 0.0, 0.0], rel=1e-4)


@pytest.mark.parametrize(("gripper", "taken"), [(0.5, 0), (0.51, 1)])
def test_the_gripper_closes_above_a_half(env, gripper, taken):
    before(env, [0.0, 0.0, 0.0])
    assert act(env, [*[0.0] * 6, gripper])[1][3] == taken


@pytest.mark.parametrize(("away", "tried"), [(0.059, 1), (0.061, 0)])
def test_the_gripper_closes_only_where_the_fruit_is_believed_within_60_mm(env, away, tried):
    scene = before(env, [0.0, 0.0, 0.0])
    scene.seen[0] += [away, 0.0, 0.0]
    assert act(env, CLOSE)[1][3:5] == (tried, tried)


@pytest.mark.parametrize(("gripper", "off"), [(0.59, 0), (0.61, 1), (-0.4, 0)])
def test_a_twist_is_half_a_newton_metre_at_full_command(env, gripper, off):
    """0.59 x 0.5 = 0.295 N m leave a fruit on its stem that holds 0.3; 0.61 x 0.5 = 0.305 take it."""
    before(env, [0.0, 0.0, 0.0])
    act(env, CLOSE)
    assert act(env, [*[0.0] * 6, gripper]) == (-0.002, (1, 1, 1, 1, 1, off, 0, 0), False, False)


def test_opening_around_a_hanging_fruit_harms_nothing(env):
    scene = before(env, [0.0, 0.0, 0.0], FAR)
    act(env, CLOSE)
    assert act(env, OPEN) == (-0.002, (2, 2, 2, 1, 1, 0, 0, 0), False, False)
    assert scene.held is None


def test_a_detached_fruit_that_is_dropped_is_damaged(env):
    before(env, [0.0, 0.0, 0.0], FAR)
    act(env, CLOSE)
    act(env, TWIST)
    assert act(env, [*[0.0] * 6, -0.5])[1][-1] == 0  # not yet beyond the command that opens
    assert act(env, OPEN) == (-0.25 - 0.002, (2, 2, 2, 1, 1, 1, 0, 1), False, False)


@pytest.mark.parametrize(("limit", "torn"), [(6.12, 1), (6.14, 0)])
def test_a_fruit_pulled_off_untwisted_is_damaged_and_never_counts_as_collected(env, limit, torn):
    """50 mm down and 50 across against 120 and 25 N/m: sqrt(6^2 + 1.25^2) = 6.1288 N."""
    scene = before(env, [0.0, 0.0, 0.0], pull_limit=limit)
    act(env, CLOSE)
    pulled = [0.0, 1.0, 0.0, 0.0, -1.0, 0.0, 0.0]
    assert act(env, pulled) == (-0.25 * torn - 0.002, (1, 1, 1, 1, 1, torn, 0, torn), False, False)
    if torn:
        act(env, DOWN)
        assert act(env, DOWN) == (-0.002, (1, 1, 1, 1, 1, 1, 0, 1), False, True)
        assert scene.collected.tolist() == [True]


@pytest.mark.parametrize(("pull", "twist", "off", "torn"), [
    (7.5, 0.3, True, True), (7.6, 0.3, False, False), (9.0, 0.25, True, False), (7.5, 0.25, True, False)
])  # fmt: skip
def test_a_limit_that_is_just_met_takes_the_fruit_off(env, pull, twist, off, torn):
    """62.5 mm upwards against 120 N/m are 7.5 N, and half of the gripper's twist 0.25 N m, exactly."""
    scene = scene_of(env.orchard, [[0.0, 0.0, 0.0]], pull_limit=pull, twist_limit=twist)
    scene.grasp(0, upright(np.zeros(3)))
    scene.displacement[0] = [0.0, 0.0, 0.0625]
    scene.twist(0.5)
    assert (scene.detached.tolist(), scene.damaged.tolist()) == ([off], [torn])


def test_a_fruit_in_the_gripper_goes_with_the_tool_and_is_let_go_at_rest(env):
    """50 mm aside; its neighbour, 150 mm off, is pulled along by exp(-1) of that."""
    scene = scene_of(env.orchard, [[0.0, 0.0, 0.0], [-0.15, 0.0, 0.0]])
    scene.grasp(0, upright([0.002, 0.0, 0.0]))
    advance(env, scene, upright([0.002, 0.0, 0.0]), upright([0.002, 0.05, 0.0]))
    assert scene.displacement[0] == pytest.approx([0.0, 0.05, 0.0]) and not scene.velocity[0].any()
    assert scene.displacement[1] == pytest.approx([0.0, 0.05 / math.e, 0.0])
    scene.let_go()
    assert scene.held is None and not scene.damaged.any()


def test_a_fruit_that_is_pulled_and_twisted_off_at_once_is_whole(env):
    before(env, [0.0, 0.0, 0.0])
    act(env, CLOSE)
    assert act(env, [0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 1.0]) == (-0.002, (1, 1, 1, 1, 1, 1, 0, 0), False, False)


@pytest.mark.parametrize(("share", "bruised"), [(1.0, 1), (0.7, 0)])
def test_a_tool_that_runs_into_a_fruit_at_half_a_metre_a_second_damages_it(env, share, bruised):
    """The rail moves 50 mm in 0.1 s at the most: 0.5 m/s bruise, 0.35 do not. Damaged fruit can still be taken."""
    rail = forward(env.plant.arm.nominal, START + np.array([0.0, 0.05, 0.0, 0.0, 0.0, 0.0])).position
    way = (rail - forward(env.plant.arm.nominal, START).position) / 0.05
    scene = before(env, [0.0, 0.0, 0.3], way * (0.05 * share + 0.06))
    assert act(env, [0.0, share, *[0.0] * 5]) == (
        -0.25 * bruised - 0.002,
        (2, 2, 2, 0, 0, 0, 0, bruised),
        False,
        False,
    )
    # tool 37.5 and fruit 30 mm wide: at 60 mm it is pushed 7.5 aside
    assert scene.displacement[1] == pytest.approx(0.0075 * way, abs=1e-9)
    assert act(env, STAY)[0] == -0.002  # what is damaged is damaged once


@pytest.mark.parametrize(
    ("place", "touched"),
    [
        ([0.067, 0.0, 0.0], True),  # 37.5 mm of tool and 30 mm of fruit are 67.5
        ([0.068, 0.0, 0.0], False),
        ([0.0, 0.067, -0.299], True),  # the tool is 300 mm long
        ([0.0, 0.067, -0.301], False),
        ([0.0, 0.059, 0.02], True),  # 20 mm above it a fruit is sqrt(30^2 - 20^2) = 22.4 mm wide: 59.9
        ([0.0, 0.061, 0.02], False),
        ([0.0, 0.03, 0.029], True),
        ([0.0, 0.03, 0.031], False),
    ],
)
def test_the_tool_is_a_cylinder_that_touches_fruit_beside_and_below_its_point(env, place, touched):
    scene = scene_of(env.orchard, [[5.0, 5.0, 5.0], place, place])
    scene.detached[2] = True  # in another's hands
    advance(env, scene, upright(np.zeros(3)), upright(np.zeros(3)))
    assert scene.displacement[1].any() == touched and not scene.damaged.any()


@pytest.mark.parametrize(("aside", "goes_in"), [(0.037, True), (0.0375, True), (0.038, False)])
def test_what_stands_above_the_opening_of_the_tool_goes_in(env, aside, goes_in):
    scene = scene_of(env.orchard, [[aside, 0.0, 0.0], [-0.3, 0.0, 0.0]])
    advance(env, scene, upright([0.0, 0.0, -0.001]), upright(np.zeros(3)))
    assert scene.displacement[0].any() != goes_in
    scene = scene_of(env.orchard, [[aside, 0.0, 0.0], [-0.3, 0.0, 0.0]])
    advance(env, scene, upright([0.0, 0.0, -0.001]), upright(np.zeros(3)), 1)  # after another fruit it pushes this one
    assert scene.displacement[0].any()


def test_success_is_all_fruit_in_reach_whole_whatever_hangs_beyond(env):
    for reachable, success in (([True, False], True), ([True, True], False)):
        before(env, [0.0, 0.0, 0.0], FAR, reachable=np.array(reachable))
        for action in (CLOSE, TWIST, DOWN):
            assert act(env, action)[2] is False
        assert act(env, DOWN) == (1.0 - 0.002, (2, 2, sum(reachable), 1, 1, 1, 1, 0), success, success)


def upright(point):
    """Frame of an upright tool."""
    return (*np.eye(3).ravel(), *map(float, point))


def test_each_fruit_has_its_own_diameter_in_the_cup(env):
    """At 3 mm beside the axis a fruit of 63 mm fits into the cup of 70, one of 65 does not."""
    for number, taken in ((0, True), (1, False)):
        scene = scene_of(env.orchard, [[0.0, 0.0, 0.0], [0.5, 0.0, 0.0]], diameters=np.array([0.063, 0.065]))
        scene.grasp(number, upright(scene.rest[number] + [0.003, 0.0, 0.0]))
        assert (scene.held == number) == bool(scene.attached[number]) == taken


def test_a_fruit_is_taken_where_it_swings_not_where_it_hangs(env):
    for tool, taken in (([0.04, 0.0, 0.0], True), ([0.0, 0.0, 0.0], False)):
        scene = scene_of(env.orchard, [[0.0, 0.0, 0.0]])
        scene.displacement[0] = [0.04, 0.0, 0.0]
        scene.grasp(0, upright(tool))
        assert (scene.held == 0) == taken
        assert scene.miss == pytest.approx((0.0 if taken else 0.04, 0.0))


@pytest.mark.parametrize(("chance", "taken"), [(0.55, True), (0.57, False)])
def test_the_hand_takes_by_chance(chance, taken):
    """20 mm across and 10 along: logit 2.29 - 2 x 0.84 - 0.36 = 0.25, a chance of 1/(1 + exp(-0.25)) = 0.562."""
    env = PickEnv(plant="ideal", camera="perfect", gripper="compliant_hand")
    before(env, [0.02, 0.0, 0.01], chance=np.array([chance]))
    assert act(env, CLOSE) == (-0.002, (1, 1, 1, 1, int(taken), 0, 0, 0), False, not taken)


@pytest.mark.parametrize("pitch", [0.1, -0.25, 0.4])
def test_the_tilt_is_the_angle_from_the_vertical_that_was_commanded(env, pitch):
    start = START + np.array([0.0, 0.0, 0.0, pitch, 0.0, 0.5])
    before(env, [0.0, 0.0, 0.3], start=start)
    *_, info = env.step(np.array(STAY))
    assert info["tilt_deg"] == pytest.approx(math.degrees(abs(pitch)), abs=1e-6)
    assert info["position_error_mm"] == pytest.approx(300.0)


def test_time_runs_out_and_the_observation_counts_400_steps_down():
    env = gym.make("pickenv/Pick-v0", plant="ideal", camera="perfect", max_episode_steps=4)
    seen, _ = env.reset(seed=0, options={"fruit": [[0.6, -0.7, 0.5]]})
    left, late = [seen[19]], False
    while not late:
        seen, reward, over, late, info = env.step(np.zeros(7))
        left.append(seen[19])
        assert reward == -0.002 and not over and not info["is_success"]
    assert left == pytest.approx([1.0, 399 / 400, 398 / 400, 397 / 400, 396 / 400])
    assert gym.spec("pickenv/Pick-v0").max_episode_steps == 400


def test_the_observation_says_what_is_in_the_gripper_how_long_the_arm_stood_and_how_many_wait(env):
    before(env, [0.0, 0.0, 0.0], FAR, FAR)
    env.step(np.array([0.0, 0.0, 0.0, 0.0, -1e-3, 0.0, 0.0]))  # 0.05 mm: it moved
    for action, wanted in (
        (STAY, [0.1, 399 - 1, 0.0, 0.0, 3]),
        (CLOSE, [0.2, 399 - 2, 1.0, 0.0, 2]),
        (TWIST, [0.3, 399 - 3, 0.0, 1.0, 2]),
        (OPEN, [0.4, 399 - 4, 0.0, 0.0, 2]),
    ):
        seen = env.step(np.array(action))[0][18:]
        still, steps, hanging, off, waiting = wanted
        assert seen == pytest.approx([still, steps / 400, hanging, off, waiting / 50], abs=1e-6)
