"""`pickenv/PickScene-v0`: the true arm in MuJoCo, fruit that holds until it is pulled, a cup that forgives 5 mm."""

import copy
import math
import os
from pathlib import Path

import gymnasium as gym
import mujoco
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from pickenv.agents import ScriptedScene, SeeingScene, ServoScene
from pickenv.arm import forward, joint_jacobian, load_arm, mjcf_text, pose_error, truncated_inverse
from pickenv.base import InputError
from pickenv.wrappers import CompensationWrapper
from tests.drawing import where_mujoco_draws

NAME = "pickenv/PickScene-v0"
DATA = Path(os.environ.get("PICKENV_DATA", "../shared/data"))
MAKERS = DATA / "so101/so101_new_calib.xml"
GIVING = {"ur5e": "coarse:ur5e", "panda": "coarse:panda", "qiao2026": "qiao2026"}


def made(**arguments):
    return gym.make(NAME, **arguments).unwrapped


def still(env, steps):
    """Stand for some steps; the last observation and information."""
    for _ in range(steps):
        observation, *_, info = env.step(np.zeros(env.action_space.shape))
    return observation, info


def played(env, seed, script=ScriptedScene, until="is_success", steps=230):
    """An episode of the script: the information at its end, or once it says what is asked for."""
    policy = script(env)
    observation, info = env.reset(seed=seed)
    policy.reset()
    for _ in range(steps):
        observation, _, _, _, info = env.step(policy.act(observation))
        if info[until]:
            break
    return info


def test_with_a_perfect_arm_states_are_those_of_the_plain_model_to_the_bit():
    env = made(plant="ideal:ur5e", leaves=2)
    env.reset(seed=3)
    scene, rng = env.scene, np.random.default_rng(0)
    model = copy.deepcopy(scene.model)
    data = mujoco.MjData(model)
    for name in ("qpos", "ctrl", "eq_active"):
        getattr(data, name)[:] = getattr(scene.data, name)
    sent = scene.data.ctrl.copy()
    for _ in range(1000):
        env.step(np.append(rng.uniform(-1.0, 1.0, 6), -1.0))
        for part in (0.5, 1.0):
            data.ctrl[:] = sent + (scene.data.ctrl - sent) * part
            mujoco.mj_step(model, data, 5)
        data.eq_active[:] = scene.data.eq_active  # a stem that broke
        sent = scene.data.ctrl.copy()
        assert_array_equal(data.qpos, scene.data.qpos)
        assert_array_equal(data.qvel, scene.data.qvel)


@pytest.mark.slow
def test_mjx_moves_the_true_arm_as_mujoco_does():
    mjx = pytest.importorskip("mujoco.mjx", reason="MJX is not installed; pip install mujoco-mjx")
    jax = pytest.importorskip("jax")
    env = made(plant="coarse:ur5e")
    env.reset(seed=0)
    model, data, rng = env.scene.model, env.scene.data, np.random.default_rng(0)
    jax.config.update("jax_enable_x64", True)
    on_device, step = mjx.put_model(model), jax.jit(mjx.step)
    moved, start = mjx.put_data(model, data), data.qpos.copy()
    for _ in range(50):
        data.ctrl[:6] += rng.uniform(-0.02, 0.02, 6)
        moved = step(on_device, moved.replace(ctrl=np.array(data.ctrl)))
        mujoco.mj_step(model, data)
    assert np.abs(data.qpos - start).max() > 0.02
    assert_allclose(np.asarray(moved.qpos), data.qpos, rtol=0, atol=1e-10)


def rest_gaps(name, plant, poses, **arguments):
    """How far the tool of an arm at rest is from where the plant has it, at drawn poses, m."""
    env = made(plant=plant, **arguments)
    rng, gaps = np.random.default_rng(1), []
    nominal = env.task.plant.arm.nominal
    for _ in range(poses):
        start = nominal.lower + rng.uniform(0.1, 0.9, nominal.joints) * (nominal.upper - nominal.lower)
        env.reset(seed=0, options={"start_joints": start, "goal_joints": nominal.lower * 0.3 + nominal.upper * 0.7})
        still(env, 12)
        expected = env.plant.stands(math, env._state.plant, start.tolist())[1]
        gaps.append(np.linalg.norm(np.array(env.scene.tool[9:]) - expected[9:]))
        if not env.plant.effects:
            assert_allclose(env.scene.tool[9:], forward(env.plant.geometry, start).position, rtol=0, atol=1e-5)
    return np.array(gaps)


@pytest.mark.parametrize("name", GIVING)
@pytest.mark.parametrize("poses", [5, pytest.param(200, marks=pytest.mark.slow)])
def test_at_rest_the_true_tool_is_where_our_kinematics_have_it(name, poses):
    assert rest_gaps(name, f"coarse:{name}", poses, error_mm=5.0).max() < 1e-5
    assert rest_gaps(name, GIVING[name], poses).max() < 5e-5


@pytest.mark.parametrize("size", [0.0, 3.0])
def test_the_arm_errs_by_what_is_asked_for(size):
    env = made(plant="coarse:panda", error_mm=size, arms="per_episode", population=3)
    nominal = env.task.plant.arm.nominal
    joints = np.random.default_rng(0).uniform(nominal.lower, nominal.upper, (2000, nominal.joints))
    geometries = []
    for arm in range(3):
        env.reset(seed=0, options={"arm": arm})
        gaps = forward(env.plant.geometry, joints).position - forward(nominal, joints).position
        assert np.linalg.norm(gaps, axis=1).mean() == pytest.approx(size * 1e-3, rel=0.1)
        geometries.append(env.plant.geometry.theta)
    assert (np.ptp(geometries, axis=0) > 0.0).any() == (size > 0.0)


def test_fruit_hangs_where_it_was_wanted_and_stays():
    env = made(fruit=3, leaves=3)
    env.reset(seed=2)
    before = env.scene.fruit.copy()
    _, info = still(env, 50)
    assert_allclose(env.scene.fruit, before, rtol=0, atol=2e-4)
    assert not info["detached"] and not info["attached"] and not info["is_success"]
    apart = np.linalg.norm(before[1:] - before[0], axis=1)
    assert (apart > 2.0 * env.scene.around.radius).all()


def test_a_stem_breaks_at_its_strength_and_not_before():
    env = made()
    env.reset(seed=0)
    scene, body = env.scene, env.scene.model.body("fruit 0").id
    weight = scene.around.mass * 9.81
    for share, held in ((0.9, True), (1.1, False)):
        for pull in np.linspace(0.0, share, 60):
            scene.data.xfrc_applied[body, 2] = -(pull * scene.strength[0] - weight)
            still(env, 1)
        still(env, 10)
        assert scene.held[0] == held


@pytest.mark.parametrize(("aside", "taken"), [(3.0, True), (8.0, False)])
def test_the_cup_takes_what_lies_within_its_clearance(aside, taken):
    env = made()
    observation, _ = env.reset(seed=4)
    policy = ScriptedScene(env)
    n, tool = 6, env.task.plant.arm.nominal
    goal = policy.wanted_joints(policy.present(observation[:-2]))
    across = forward(tool, goal).rotation[:, 0]
    for _ in range(200):
        wrong = observation.copy()
        wrong[n + 3 : n + 6] += 1e-3 * aside * across
        wrong[n + 6 : n + 9] += 1e-3 * aside * across
        observation, _, terminated, _, info = env.step(policy.act(wrong))
        if terminated:
            break
    assert info["grasp_lateral_mm"] == pytest.approx(aside, abs=0.7)
    assert info["is_success"] == info["attached"] == taken


def test_the_script_picks_with_a_good_arm_and_misses_with_a_bad_one_until_it_is_corrected():
    good = [played(made(), seed)["is_success"] for seed in range(2)]
    bad = made(plant="coarse:ur5e", error_mm=20.0)
    raw = [played(bad, seed, steps=160) for seed in range(2)]
    believed, true = bad.task.plant.arm.nominal, bad.plant.geometry

    def corrected(joints):
        back, wanted = joints, forward(believed, joints)
        for _ in range(6):
            back = back + truncated_inverse(joint_jacobian(true, back)) @ pose_error(forward(true, back), wanted)
        return back

    wrapped = CompensationWrapper(bad, corrected)
    good_again = [played(wrapped, seed) for seed in range(2)]
    assert sum(good) == 2
    assert sum(info["is_success"] for info in raw) < 2
    assert all(info["grasp_lateral_mm"] < 6.0 for info in raw if info["is_success"])
    assert sum(info["is_success"] for info in good_again) == 2
    assert max(info["grasp_lateral_mm"] for info in good_again) < 2.0


def test_many_are_what_each_is_alone_in_every_mode():
    for mode in gym.vector.AutoresetMode:
        envs = gym.vector.SyncVectorEnv([lambda: gym.make(NAME, max_episode_steps=4)] * 2, autoreset_mode=mode)
        single = gym.make(NAME, max_episode_steps=4)
        together, _ = envs.reset(seed=[5, 6])
        assert_array_equal(together[1], single.reset(seed=6)[0])
        for step in range(4):
            action = np.full((2, 7), 0.1 * step, dtype=np.float32)
            together, _, _, truncated, _ = envs.step(action)
            alone, *_ = single.step(action[1])
            if mode is not gym.vector.AutoresetMode.SAME_STEP or step < 3:
                assert_array_equal(together[1], alone)
        assert truncated.all()


def test_pictures_are_of_the_true_cameras_and_the_same_for_a_seed():
    one, other = (made(obs_type="pixels_agent_pos", pixels=48, camera_mm=mm, leaves=2) for mm in (0.0, 30.0))
    try:
        (first, _), (moved, _) = one.reset(seed=1), other.reset(seed=1)
    except InputError as error:
        pytest.skip(f"no pictures on this machine: {error}")
    again, _ = one.reset(seed=1)
    assert set(first) == {"agent_pos", "pixels"} and set(first["pixels"]) == {"world", "wrist"}
    for camera, picture in first["pixels"].items():
        assert picture.shape == (48, 48, 3) and picture.std() > 5.0
        assert_array_equal(picture, again["pixels"][camera])
        assert (picture != moved["pixels"][camera]).any()
    assert_array_equal(first["agent_pos"], moved["agent_pos"])
    assert first in one.observation_space
    assert (first["pixels"]["world"][..., 0] > 2 * first["pixels"]["world"][..., 1].astype(int)).any()  # red fruit
    for env in (one, other):
        env.close()


@pytest.mark.skipif(not MAKERS.exists(), reason="the SO-101 of its makers is not there (PICKENV_DATA)")
def test_a_makers_arm_picks_too_and_stands_where_ours_does():
    env = made(plant="ideal:so101", model=str(MAKERS))
    assert played(env, 0)["is_success"]
    assert rest_gaps("so101", "coarse:so101", 4, model=str(MAKERS), error_mm=5.0).max() < 1e-5
    with pytest.raises(InputError, match="no joint 'J1"):
        made(plant="ideal:ur5e", model=str(MAKERS))


def test_a_makers_arm_is_seen_also_if_all_of_it_is_in_the_group_of_what_only_looks_like_it(tmp_path):
    """Group 2, in which makers keep the look of an arm, is drawn where the arm has nothing in a group that is drawn."""
    drawn, text = {}, mjcf_text(load_arm("ur5e").nominal, "ur5e")
    for group in (2, 3, 5):
        path = tmp_path / f"maker{group}.xml"
        path.write_text(text.replace("<geom ", f'<geom group="{group}" '))
        env = made(plant="ideal:ur5e", model=str(path), obs_type="pixels_agent_pos", pixels=128)
        try:
            drawn[group] = env.reset(seed=1)[0]["pixels"]["world"]
        except InputError as error:
            pytest.skip(f"no pictures on this machine: {error}")
        env.close()
    assert_array_equal(drawn[2], drawn[3])
    assert (drawn[2] != drawn[5]).any(axis=-1).sum() > 50


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda text: "", "is no MJCF"),
        (
            lambda text: text.replace("<position", "<motor").replace(' kp="2000.0" kv="200.0"', ""),
            "no position actuator",
        ),
        (lambda text: text.replace("<worldbody>", '<asset><mesh file="no.stl"/></asset><worldbody>'), "no.stl"),
        (lambda text: text.replace("<actuator>", "<!-- ").replace("</actuator>", " -->"), "no drive for joint"),
    ],
)
def test_a_makers_file_that_cannot_be_driven_is_refused_in_one_sentence(tmp_path, change, words):
    path = tmp_path / "maker.xml"
    path.write_text(change(mjcf_text(load_arm("ur5e").nominal, "ur5e")))
    with pytest.raises(InputError, match=words) as caught:
        made(plant="ideal:ur5e", model=str(path))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"obs_type": "rgb"}, "state, pixels"),
        ({"pixels": 4}, "at least 16"),
        ({"pixels": 5000}, "at most 1024"),
        ({"cameras": ["head"]}, "give a list of world, wrist"),
        ({"cameras": "wrist"}, "give a list of world, wrist"),
        ({"cameras": True}, "give a list of world, wrist"),
        ({"camera_mm": None}, "camera_mm is None"),
        ({"model": True}, "model is True"),
        ({"fruit_size": 3}, "unknown fruit_size '3'"),
        ({"error_mm": -1.0}, "error_mm is -1.0"),
        ({"error_mm": 1.0}, "no error of its parts"),
        ({"scale": 0.0}, "scale is 0"),
        ({"model": "nowhere.xml"}, "does not exist"),
        ({"plant": "nobody"}, "nobody"),
    ],
)
def test_impossible_arguments_are_refused_in_one_sentence(arguments, words):
    with pytest.raises(InputError, match=words) as caught:
        made(**arguments)
    assert "\n" not in str(caught.value)


@pytest.mark.slow
def test_a_policy_that_sees_makes_up_for_the_arm_but_not_for_its_own_camera():
    def lateral(script, obs_type, camera_mm, **where):
        env = made(plant="coarse:so101", obs_type=obs_type, camera_mm=camera_mm, cameras=["wrist"], pixels=96, **where)
        with where_mujoco_draws():
            ends = [played(env, seed, script, "grasp_lateral_mm") for seed in range(8)]
        return np.median([info["grasp_lateral_mm"] for info in ends])

    sees = SeeingScene, "pixels_environment_state_agent_pos"
    blind = lateral(ScriptedScene, "state", 0.0, error_mm=8.0)
    assert blind > 4.0
    assert lateral(*sees, 0.0, error_mm=8.0) < 0.5 * blind
    assert lateral(*sees, 0.0, error_mm=0.0) < 1.0
    assert lateral(*sees, 8.0, error_mm=0.0) > 3.0


@pytest.mark.parametrize(("robot", "within"), [("ur5e", 40.0), ("panda", 40.0), ("so101", 40.0), ("panda", 300.0)])
def test_fruit_within_a_place_hangs_there_before_the_tool(robot, within):
    env = gym.make("pickenv/PickScene-v0", plant=f"ideal:{robot}", within_mm=within, feedback="camera")
    scale, seen, fruit, ahead = env.unwrapped.scene.around.scale, [], [], []
    for seed in range(12):
        observation, info = env.reset(seed=seed)
        tool = forward(env.unwrapped.plant.arm.nominal, info["joint_command"])
        gap = tool.rotation.T @ (info["fruit_position"] - tool.position) / scale
        fruit.append(info["fruit_position"])
        ahead.append(gap)
        seen.append(observation)
    for seed in range(2):
        assert_array_equal(env.reset(seed=seed)[0], seen[seed])
    spread = np.ptp(fruit, axis=0)
    assert (spread > 0.5e-3 * within).all() and (spread < 2e-3 * within + 1e-3).all()
    away = np.linalg.norm(ahead, axis=1)
    assert away.min() > 0.06 - 1e-3 and away.max() < np.hypot(0.3, np.sqrt(2.0) * 0.125) + 1e-3
    elsewhere = [
        0.5 * (low + high) for low, high in zip(env.unwrapped.task.lower, env.unwrapped.task.upper, strict=True)
    ]
    _, info = env.reset(seed=0, options={"goal_joints": elsewhere})
    at = forward(env.unwrapped.plant.arm.nominal, elsewhere).position
    assert_allclose(info["fruit_position"], at, atol=2e-3)


def test_the_gripper_says_in_its_reading_whether_it_holds():
    place = {"obs_type": "pixels_environment_state_agent_pos", "cameras": ["wrist"], "pixels": 16}
    env = gym.make("pickenv/PickScene-v0", within_mm=40.0, feedback="camera", **place)
    with where_mujoco_draws():
        observation, _ = env.reset(seed=0)
    policy, ended, readings = ServoScene(env), False, {float(observation["agent_pos"][-1])}
    while not ended:
        observation, _, ended, cut, info = env.step(policy.act(observation))
        ended |= cut
        readings.add(float(observation["agent_pos"][-1]))
    assert info["is_success"] and readings == {0.0, 0.5, 1.0}


def test_a_place_that_the_arm_does_not_reach_is_refused():
    env = gym.make("pickenv/PickScene-v0", within_mm=20_000.0)
    with pytest.raises(InputError, match="within_mm is 20000; the arm reaches too little of that, give less"):
        env.reset(seed=0)


@pytest.mark.parametrize("given", [{"reward": "sparse"}, {"tolerance_mm": 9.0}, {"end_on_success": True}], ids=str)
def test_what_would_have_no_effect_is_refused(given):
    with pytest.raises(InputError, match=f"^{next(iter(given))} has no effect"):
        made(**given)


def test_another_executor_is_refused_in_one_sentence():
    assert made(executor="floats").action_space.shape == (7,)
    with pytest.raises(InputError, match="executor is 'numpy'; give one of floats"):
        made(executor="numpy")


@pytest.mark.parametrize("row", ["Contacts, grasps, forces", "Pictures in the observation"])
def test_the_page_beside_other_packages_knows_the_scene(row):
    page = (Path(__file__).parents[3] / "docs/peers.md").read_text(encoding="utf-8")
    (ours,) = [line.split("|")[2] for line in page.splitlines() if line.startswith(f"| {row} |")]
    assert f"`{NAME}`" in ours
