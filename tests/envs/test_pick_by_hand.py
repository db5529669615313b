"""Pick-v0, one event at a time: what each step's reward, funnel and success must be is worked out here by hand."""

import math
import re
from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pickenv.arm import forward
from pickenv.envs.picking.pick import PickEnv
from pickenv.envs.picking.pick_reach import reach_of
from pickenv.envs.picking.pick_scene import PickScene, make_setting, to_base, to_orchard, upright_turn
from pickenv.orchard import Strength, load_canopy, occlusion, sample_fruit, shipped

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
    n = len(rest)
    usual = {
        "diameters": np.full(n, 0.06),
        "masses": np.full(n, 0.1),
        "strength": Strength(np.full(n, 5.0), np.full(n, 0.3)),
        "chance": np.zeros(n),
        "seen": rest.copy(),
        "visible": np.ones(n, dtype=bool),
        "reachable": np.ones(n, dtype=bool),
    }
    return PickScene(orchard, rest, **(usual | changes))


def before(env, *offsets, start=START, **changes):
    """The fruit of an episode that begins, at ``offsets`` from the tool; the first is the next to pick."""
    tool = forward(env.plant.arm.nominal, start).position
    env.reset(seed=0, options={"fruit": [[0.6, -0.7, 0.5]], "start_joints": start})
    env.scene = scene_of(env.orchard, tool + np.array(offsets), **changes)
    return env.scene


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


def test_one_fruit_goes_all_the_way_down_the_funnel(env):
    """Closed on, twisted off with 1 x 0.5 N m of the 0.3 that it takes, 50 and then 100 mm down of the 80 asked."""
    before(env, [0.0, 0.0, 0.0])
    assert act(env, CLOSE) == (-0.002, (1, 1, 1, 1, 1, 0, 0, 0), False, False)
    assert act(env, TWIST) == (-0.002, (1, 1, 1, 1, 1, 1, 0, 0), False, False)
    assert act(env, DOWN) == (-0.002, (1, 1, 1, 1, 1, 1, 0, 0), False, False)
    assert act(env, DOWN) == (1.0 - 0.002, (1, 1, 1, 1, 1, 1, 1, 0), True, True)


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
    scene = before(env, [0.0, 0.0, 0.0], strength=Strength(np.array([limit]), np.array([0.3])))
    act(env, CLOSE)
    pulled = [0.0, 1.0, 0.0, 0.0, -1.0, 0.0, 0.0]
    assert act(env, pulled) == (-0.25 * torn - 0.002, (1, 1, 1, 1, 1, torn, 0, torn), False, False)
    if torn:
        act(env, DOWN)
        assert act(env, DOWN) == (-0.002, (1, 1, 1, 1, 1, 1, 0, 1), False, True)
        assert scene.collected.tolist() == [True]


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


def test_success_is_all_fruit_in_reach_whole_whatever_hangs_beyond(env):
    for reachable, success in (([True, False], True), ([True, True], False)):
        before(env, [0.0, 0.0, 0.0], FAR, reachable=np.array(reachable))
        for action in (CLOSE, TWIST, DOWN):
            assert act(env, action)[2] is False
        assert act(env, DOWN) == (1.0 - 0.002, (2, 2, sum(reachable), 1, 1, 1, 1, 0), success, success)


def test_a_fruit_that_is_blocked_from_below_is_not_in_reach_and_success_does_without_it():
    """A second fruit 70 mm below the first stands in the last 100 mm of the way to it, and has a free way itself."""
    env = PickEnv(plant="ideal", camera="perfect")
    upper = np.array([0.6, -0.7, 0.5])
    beside, below = upper + np.array([0.2, 0.0, 0.0]), upper - np.array([0.0, 0.0, 0.07])
    _, info = env.reset(seed=0, options={"fruit": [upper, beside, below]})
    assert (info["present"], info["visible"], info["reachable"]) == (3, 3, 2)
    assert env.scene.reachable.tolist() == [False, True, True]
    env.scene.collected[1:] = True
    *_, info = env.step(np.zeros(7))
    assert info["collected"] == 2 and info["is_success"]


def test_the_camera_finds_what_is_within_its_range_from_a_metre_before_the_canopy():
    """It stands at y = -0.53 + 1 m: 1.07 m from the first fruit, sqrt(0.3^2 + 1.27^2) = 1.305 m from the other."""
    env = PickEnv(plant="ideal", camera="perfect")
    fruit = {"fruit": [[0.6, -0.6, 0.55], [0.9, -0.8, 0.55]]}
    for nearest, farthest, found in ((1.0, 1.3, [True, False]), (1.0, 1.31, [True, True]), (1.1, 1.31, [False, True])):
        camera = replace(env.orchard.camera, nearest=nearest, farthest=farthest)
        env.orchard = replace(env.orchard, camera=camera)
        _, info = env.reset(seed=0, options=fruit)
        assert env.scene.visible.tolist() == env.scene.reachable.tolist() == found
        assert (info["present"], info["visible"]) == (2, sum(found))


@pytest.mark.parametrize("angle", [0.0, 1e-3, 0.5, math.pi / 2, 3.0])
def test_the_shortest_turn_brings_an_axis_upright(angle):
    heading = 0.7
    axis = np.array([math.sin(angle) * math.cos(heading), math.sin(angle) * math.sin(heading), math.cos(angle)])
    turn = upright_turn(axis)
    assert np.linalg.norm(turn) == pytest.approx(angle, abs=1e-12) and turn[2] == 0.0
    assert Rotation.from_rotvec(turn).apply(axis) == pytest.approx([0.0, 0.0, 1.0], abs=1e-12)


def test_what_hides_a_fruit_pulls_it_to_the_visible_side(env):
    """By up to the share of a radius that the camera gives, as much as fruit and leaves before it hide of it."""
    fruit = np.array([[0.6, -0.6, 0.55], [0.63, -0.75, 0.55]])
    here = PickEnv(plant="ideal", camera="perfect")
    here.orchard = replace(here.orchard, camera=replace(here.orchard.camera, occlusion_pull=0.5))
    here.reset(seed=0, options={"fruit": fruit})
    canopy, scene = here.orchard.canopy, here.scene
    there = np.column_stack([0.6 - fruit[:, 0], -0.53 - fruit[:, 1], fruit[:, 2] - 0.15 + canopy.bottom])
    viewpoint = [0.0, -canopy.standoff, (canopy.bottom + canopy.top) / 2]
    hidden = occlusion(canopy, there, scene.diameters, viewpoint)
    pull = 0.5 * (1.0 - hidden.visible) * scene.diameters / 2
    assert pull[1] > 0.005 and np.linalg.norm(hidden.visible_side[1]) == pytest.approx(1.0)
    np.testing.assert_allclose(np.linalg.norm(scene.seen - fruit, axis=1), pull, atol=1e-12)
    np.testing.assert_allclose(scene.seen[1] - fruit[1], pull[1] * hidden.visible_side[1] * [-1, -1, 1], atol=1e-12)


def test_the_orchard_is_turned_by_half_a_turn_to_stand_before_the_arm(env):
    """Its middle at x 0.6 m, its face at y -0.53 m, its lowest fruit at z 0.15 m; depth is away from the arm."""
    bottom = env.orchard.canopy.bottom
    there, here = [[0.0, 0.0, bottom], [0.1, 0.2, bottom + 0.3]], [[0.6, -0.53, 0.15], [0.5, -0.73, 0.45]]
    np.testing.assert_allclose(to_base(env.orchard, np.array(there)), here)
    np.testing.assert_allclose(to_orchard(env.orchard, np.array(here)), there)


@pytest.mark.parametrize("name", shipped("canopy"))
def test_the_section_is_what_of_the_canopy_the_arm_serves(name):
    """0.9 m wide, 0.8 m high, 0.4 m deep, where the canopy is as large; fruit by the metre of it."""
    whole = load_canopy(name)
    section = make_setting(name, "li2016_lab", "li2016", "perfect", "li_cup", 10.0, 16).canopy
    size = min(0.9, whole.width), min(0.4, whole.depth), min(0.8, whole.top - whole.bottom)
    assert (section.width, section.depth, section.top - section.bottom) == pytest.approx(size)
    assert section.bottom == whole.bottom


def test_the_mean_number_of_fruit_is_what_was_asked_for():
    setting = make_setting("li2016", "li2016_lab", "li2016", "perfect", "li_cup", 10.0, 16)
    rng = np.random.default_rng(0)
    counts = [len(sample_fruit(setting.fruit_map, setting.size, setting.canopy, rng)) for _ in range(400)]
    assert abs(np.mean(counts) - 10.0) < 4 * np.std(counts) / 20


def test_the_spaces_are_those_of_the_tables(env):
    most = env.task.reach
    high = [1.0] * 6 + [most] * 6 + [2 * most] * 3 + [math.pi] * 3 + [1.0] * 5
    assert env.observation_space.high == pytest.approx(high, rel=1e-6)
    assert env.observation_space.low == pytest.approx([*(-value for value in high[:18]), *[0.0] * 5], rel=1e-6)
    assert (env.action_space.low == -1.0).all() and (env.action_space.high == 1.0).all()
    assert env.action_space.shape == (7,) and env.observation_space.shape == (23,)


def test_reach_is_asked_with_tools_upright_in_the_yaw_of_the_poses_that_it_starts_from(env):
    """The nearest upright attitude keeps the heading of the tool's x axis; each start is within 30 degrees of it."""
    reach = reach_of(env.plant.arm.nominal, env.orchard.station.approach)
    rotation = forward(reach.geometry, reach.joints).rotation
    heading = np.arctan2(rotation[:, 1, 0], rotation[:, 0, 0])
    wanted = Rotation.from_rotvec(heading[:, None] * [0.0, 0.0, 1.0]).as_matrix()
    np.testing.assert_allclose(reach.rotations, wanted, atol=1e-12)
    assert (rotation[:, 2, 2] > math.cos(math.radians(30.0))).all() and len(rotation) > 1000


def test_a_tool_upside_down_is_half_a_turn_from_upright():
    assert upright_turn(np.array([0.0, 0.0, -1.0])) == pytest.approx([math.pi, 0.0, 0.0])
    assert not upright_turn(np.array([0.0, 0.0, 1.0])).any()


@pytest.mark.parametrize("looks", [4, 16, 100])
def test_a_second_look_averages_noise_and_nothing_else(looks):
    """The noise of n pictures' mean falls as 1/sqrt(n); bias and the pull of occlusion are what endless looks leave."""
    seen = {}
    for count in (1, looks, 10**12):
        env = PickEnv(plant="ideal", camera="azure_kinect", looks=count)
        env.reset(seed=3, options={"fruit": [[0.6, -0.7, 0.5], [0.75, -0.65, 0.6]]})
        seen[count] = env.scene.seen
    one, many = (np.abs(seen[count] - seen[10**12]) for count in (1, looks))
    assert one.min() > 1e-5
    np.testing.assert_allclose(many, one / math.sqrt(looks), rtol=1e-4, atol=1e-9)
    assert np.abs(seen[10**12] - env.scene.rest).max() > 1e-3


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
