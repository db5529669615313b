"""What hangs before the picking arm, what the camera makes of it, and what of it is in reach, by geometry."""

import math
from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pickenv.arm import forward
from pickenv.base import InputError
from pickenv.envs import PickEnv
from pickenv.envs.picking.pick_arm import reach_of, upright_turn
from pickenv.envs.picking.pick_scene import draw_scenes, looked_at, make_pick, to_base, to_orchard
from pickenv.orchard import load_canopy, occlusion, sample_fruit, shipped


@pytest.fixture(scope="module")
def env():
    return PickEnv(plant="ideal", camera="perfect")


def test_a_fruit_that_is_blocked_from_below_is_not_in_reach_and_success_does_without_it():
    """A second fruit 70 mm below the first stands in the last 100 mm of the way to it, and has a free way itself."""
    env = PickEnv(plant="ideal", camera="perfect")
    upper = np.array([0.6, -0.7, 0.5])
    beside, below = upper + np.array([0.2, 0.0, 0.0]), upper - np.array([0.0, 0.0, 0.07])
    _, info = env.reset(seed=0, options={"fruit": [upper, beside, below]})
    assert (info["present"], info["visible"], info["reachable"]) == (3, 3, 2)
    assert env.scene.reachable.tolist() == [False, True, True]
    env.scene.collected[1:] = True
    env.canopies._note(0)
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
    turn = np.array(upright_turn(math, axis))
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
    visible, visible_side = occlusion(canopy, there, scene.diameters, viewpoint)
    pull = 0.5 * (1.0 - visible) * scene.diameters / 2
    assert pull[1] > 0.005 and np.linalg.norm(visible_side[1]) == pytest.approx(1.0)
    np.testing.assert_allclose(np.linalg.norm(scene.seen - fruit, axis=1), pull, atol=1e-12)
    np.testing.assert_allclose(scene.seen[1] - fruit[1], pull[1] * visible_side[1] * [-1, -1, 1], atol=1e-12)


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
    section = make_pick(canopy=name, camera="perfect")[1].canopy
    size = min(0.9, whole.width), min(0.4, whole.depth), min(0.8, whole.top - whole.bottom)
    assert (section.width, section.depth, section.top - section.bottom) == pytest.approx(size)
    assert section.bottom == whole.bottom


def test_the_mean_number_of_fruit_is_what_was_asked_for():
    setting = make_pick(camera="perfect")[1]
    rng = np.random.default_rng(0)
    counts = [len(sample_fruit(setting.fruit_map, setting.size, setting.canopy, rng)[1]) for _ in range(400)]
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
    assert upright_turn(math, (0.0, 0.0, -1.0)) == pytest.approx((math.pi, 0.0, 0.0))
    assert not any(upright_turn(math, (0.0, 0.0, 1.0)))


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


def test_an_environment_of_which_nothing_is_said_is_the_one_of_the_class():
    setting = PickEnv().orchard
    made = make_pick()[1]
    assert vars(setting) == vars(made) and setting.looks == 16
    assert PickEnv(arms="per_env").task.population == 256


@pytest.mark.parametrize(("given", "asked"), [([[0.6, -0.7, 0.5]], 10), (None, 200)])
def test_fruit_is_drawn_until_some_is_in_reach_but_not_for_ever(env, given, asked):
    calls = []
    with pytest.raises(InputError, match="within the arm's reach"):
        draw_scenes(
            env.orchard,
            lambda seen: calls.append(seen) or np.zeros(len(seen), bool),
            [np.random.default_rng(0)],
            [given],
        )
    assert len(calls) == asked


@pytest.mark.parametrize("vision", [pytest.param("rendered", marks=pytest.mark.slow), "measured_errors", "ideal"])
def test_an_arm_sees_with_lis_stereo_pair_alone_as_beside_another_to_the_bit(vision):
    given = {"vision": vision, "fruit": 6.0} | ({} if vision == "ideal" else {"detector": "circles"})
    together = gym.make_vec("pickenv/Pick-v0", num_envs=2, **given)
    alone = [PickEnv(executor="numpy", **given) for _ in range(2)]
    for seed in (5, None):
        seen, _ = together.reset(seed=seed)
        singles = [env.reset(seed=None if seed is None else seed + i)[0] for i, env in enumerate(alone)]
        assert np.array_equal(seen, singles)
    for env in alone:
        scene = env.scene
        miss = np.linalg.norm((scene.seen - scene.rest)[scene.visible], axis=1)
        assert (miss == 0).all() and scene.visible.all() if vision == "ideal" else (miss > 0).all()
        assert np.median(miss) < 0.02 and (scene.visible | ~scene.reachable).all()


def test_what_is_seen_of_fruit_follows_the_canopys_own_table():
    """Many draws of one fruit: located and misplaced as `pickenv.orchard.sighted` says at its depth."""
    setting = make_pick(looks=1, vision="measured_errors")[1]
    place = np.tile([0.0, 0.2, (setting.canopy.bottom + setting.canopy.top) / 2], (3000, 1))
    believed, visible = looked_at(setting, np.random.default_rng(0), place, np.full(3000, 0.06))
    found = np.column_stack([believed - place, visible])
    table = setting.eyes.errors
    row = int(np.searchsorted(table.edges, setting.canopy.standoff + 0.2))
    assert found[:, 3].mean() == pytest.approx(table.recall[row], abs=0.03)
    bias, spread = np.array(table.bias[row]), np.array(table.spread[row])
    wanted = bias[[0, 2, 1]] * [1, 1, -1]  # x right, z ahead and y down: x, y and -z of the orchard
    assert found[:, :3].mean(axis=0) == pytest.approx(wanted, abs=6e-4)
    assert found[:, :3].std(axis=0) == pytest.approx(spread[[0, 2, 1]], rel=0.15)


def test_an_unknown_vision_is_refused():
    with pytest.raises(InputError, match="unknown vision 'eagle'; give one of published, rendered"):
        PickEnv(vision="eagle")
