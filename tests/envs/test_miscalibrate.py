"""A real arm's error in somebody else's task: success is the true tool's, or what its fingers did; nobody sees it."""

import re
import sys
from dataclasses import replace
from typing import Any

import gymnasium as gym
import mujoco
import numpy as np
import pytest

from pickenv.arm import (
    Arm,
    Plant,
    Pose,
    behind,
    forward,
    geometry_in_mujoco,
    inverse_pose,
    joints_in_mujoco,
    load_arm,
    load_plant,
    mjcf_text,
)
from pickenv.base import InputError
from pickenv.calibration import fit, simulated_tracker
from pickenv.wrappers import Miscalibrate

ARMS = ("ur5", "panda", "so101")


class JointReach(gym.Env[Any, Any]):
    """A foreign task: bring the site "tool" to a goal by joint targets; a reach counts within 5 mm."""

    def __init__(self, name: str, within: float = 5e-3) -> None:
        nominal = load_arm(name).nominal
        self.model = mujoco.MjModel.from_xml_string(mjcf_text(nominal, name))
        self.data, self.within, self.nominal = mujoco.MjData(self.model), within, nominal
        self.model.opt.gravity[:] = 0.0
        box = gym.spaces.Box(-10.0, 10.0, (3,))
        self.observation_space = gym.spaces.Dict({"observation": box, "achieved_goal": box, "desired_goal": box})
        self.action_space = gym.spaces.Box(nominal.lower, nominal.upper, dtype=np.float64)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.asked, g = options, self.nominal
        self.wanted = g.lower + self.np_random.uniform(0.3, 0.7, g.joints) * (g.upper - g.lower)
        self.goal = forward(g, self.wanted).position
        self.data.qpos[:] = self.data.ctrl[:] = (g.lower + g.upper) / 2
        mujoco.mj_forward(self.model, self.data)
        return self._seen(), {}

    def step(self, action):
        self.data.ctrl[:], self.data.qpos[:], self.data.qvel[:] = action, action, 0.0
        mujoco.mj_step(self.model, self.data)
        mujoco.mj_kinematics(self.model, self.data)
        seen = self._seen()
        success = self._is_success(seen["achieved_goal"], self.goal)
        return seen, self.compute_reward(seen["achieved_goal"], self.goal, {}), False, False, {"is_success": success}

    def _seen(self):
        here = self.data.site("tool").xpos.copy()
        return {"observation": here, "achieved_goal": here, "desired_goal": self.goal}

    def _is_success(self, achieved, desired):
        return float(np.linalg.norm(achieved - desired) < self.within)

    def compute_reward(self, achieved, desired, info):
        return -float(np.linalg.norm(achieved - desired) >= self.within)


class Touch(gym.Env[Any, Any]):
    """A foreign task without goals: touch a ball with a palm of two boxes, or with the finger that it carries."""

    observation_space = gym.spaces.Box(-10.0, 10.0, (3,))

    def __init__(self, name: str = "ur5", links: str = "") -> None:
        nominal = load_arm(name).nominal
        site = r'<site name="tool" size="0.01" (pos="[^"]*" quat="[^"]*") />'
        hand = rf"""<body name="hand" \1>{links}<site name="tool" size="0.01"/>
            <camera name="eye" pos="0 0.02 0" euler="1 0 0"/>
            <geom name="palm" type="box" size="0.005 0.005 0.005" mass="0.1"/>
            <geom name="heel" type="box" size="0.005 0.005 0.005" pos="0 0.1 0" euler="0.3 0 0" mass="0.1"/>
            <body name="finger" pos="0.1 0 0.02" euler="0 0.4 0"><joint name="grasp" type="slide" axis="1 0 0"/>
            <geom name="finger" type="box" size="0.005 0.005 0.005" pos="0 0 0.05" mass="0.1"/></body></body>"""
        text = re.sub(site, hand, mjcf_text(nominal, name))
        ball = '<body name="ball"><freejoint/><geom name="ball" type="sphere" size="0.002" mass="0.001"/></body>'
        self.model = mujoco.MjModel.from_xml_string(text.replace("</worldbody>", f"{ball}</worldbody>"))
        self.data, self.n = mujoco.MjData(self.model), nominal.joints
        self.model.opt.gravity[:] = 0.0
        self.action_space = gym.spaces.Box(nominal.lower, nominal.upper, dtype=np.float64)
        self.nominal = geometry_in_mujoco(self.model, "tool", nominal.joint_names)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[self.n] = 0.02  # the finger is away from where the model was made
        self.data.qpos[self.n + 1 : self.n + 4] = (options or {}).get("ball", [5.0, 5.0, 5.0])
        mujoco.mj_forward(self.model, self.data)
        return self.data.site("tool").xpos.copy(), {}

    def step(self, action):
        self.data.ctrl[:], self.data.qpos[: self.n], self.data.qvel[:] = action, action, 0.0
        mujoco.mj_step(self.model, self.data)
        touched = self.data.ncon > 0
        mujoco.mj_kinematics(self.model, self.data)
        return self.data.site("tool").xpos.copy(), float(touched), False, False, {}


class Held:
    """What holds another object, as robosuite's binding holds MuJoCo's."""

    def __init__(self, **held: Any) -> None:
        vars(self).update(held)


class SimulatorTouch(gym.Wrapper[Any, Any, Any, Any]):
    """The same task as robosuite would have it: ``model`` is a description, MuJoCo's own are in the simulator."""

    def __init__(self) -> None:
        super().__init__(Touch())
        self.model = "a description of the table and the robot"
        self.sim = Held(model=Held(_model=self.env.model), data=Held(_data=self.env.data))

    @property
    def unwrapped(self):
        return self


PARTS = (("geom", "palm"), ("geom", "heel"), ("geom", "finger"), ("cam", "eye"), ("body", "finger"))


def places(env, parts=PARTS):
    """Where the parts stand now in the model and where they stood if it was unedited, as its data show them."""
    data = mujoco.MjData(env.model)
    data.qpos[:], data.mocap_pos[:], data.mocap_quat[:] = env.data.qpos, env.data.mocap_pos, env.data.mocap_quat
    mujoco.mj_kinematics(env.model, data)
    mujoco.mj_camlight(env.model, data)
    views = [getattr(data, kind)(name) for kind, name in parts]
    return [Pose(view.xpos.copy(), view.xmat.reshape(3, 3).copy()) for view in views]


def check_displaced(wrapped, bare, nominal, true, command, parts):
    """The parts stand where the true arm has them: the world moved by what takes the believed tool to the true one."""
    joints = joints_in_mujoco(bare.model, bare.data, nominal)
    np.testing.assert_array_equal(joints, joints_in_mujoco(wrapped.model, wrapped.data, nominal))
    moved = behind(forward(true, command(joints)), inverse_pose(forward(nominal, joints)))
    for there, here in zip(places(wrapped, parts), places(bare, parts), strict=True):
        expected = behind(moved, here)
        np.testing.assert_allclose(there.position, expected.position, rtol=0, atol=1e-9)
        np.testing.assert_allclose(there.rotation, expected.rotation, rtol=0, atol=1e-9)
    return moved


def edited(model):
    """All of a model that the wrapper writes."""
    names = ("body_pos", "body_quat", "geom_pos", "geom_quat", "geom_sameframe", "cam_pos", "cam_quat", "bvh_aabb")
    return [getattr(model, name).copy() for name in names]


def erring(geometry, millimetres, seed=0):
    """A plant whose joints' zeros are off so far that its tool errs by some millimetres."""
    rng = np.random.default_rng(seed)
    joints = rng.uniform(geometry.lower, geometry.upper, (100, geometry.joints))
    turned = rng.standard_normal(geometry.links) * 1e-3
    error = np.linalg.norm(
        forward(replace(geometry, theta=geometry.theta + turned), joints).position - forward(geometry, joints).position,
        axis=1,
    ).mean()
    true = replace(geometry, theta=geometry.theta + turned * (millimetres * 1e-3 / error))
    return Plant("erring", Arm("arm", "", geometry, None, np.ones(geometry.joints)), true)


@pytest.mark.parametrize("name", ARMS)
def test_the_arm_in_the_model_is_found(name):
    env, nominal = JointReach(name), load_arm(name).nominal
    found = geometry_in_mujoco(env.model, "tool")
    assert found.joint_names == nominal.joint_names and found.prismatic == nominal.prismatic
    env.reset(seed=0)
    env.data.qpos[:] = joints = env.wanted
    np.testing.assert_array_equal(joints_in_mujoco(env.model, env.data, found), joints)
    one, other = forward(found, joints), forward(nominal, joints)
    np.testing.assert_allclose(one.position, other.position, rtol=0, atol=1e-9)
    np.testing.assert_allclose(one.rotation, other.rotation, rtol=0, atol=1e-9)
    some = geometry_in_mujoco(env.model, "tool", nominal.joint_names[2:], env.data)  # the first two stay where they are
    np.testing.assert_allclose(forward(some, joints[2:]).position, one.position, rtol=0, atol=1e-9)


@pytest.mark.parametrize("name", ARMS)
def test_success_is_where_the_true_tool_is(name):
    bare, env = JointReach(name), JointReach(name)
    nominal = geometry_in_mujoco(env.model, "tool")
    plant = erring(nominal, 8.0)
    wrapped = Miscalibrate(env, nominal, plant)
    succeeded = []
    for seed in range(6):
        (seen, info), (believed, _) = wrapped.reset(seed=seed), bare.reset(seed=seed)
        np.testing.assert_array_equal(seen["achieved_goal"], believed["achieved_goal"])
        seen, reward, _, _, info = wrapped.step(env.wanted)
        believed, perfect, _, _, known = bare.step(bare.wanted)
        for key in seen:
            np.testing.assert_allclose(seen[key], believed[key], rtol=0, atol=1e-12)
        assert perfect == 0.0 and known["is_success"] == 1.0
        joints = joints_in_mujoco(env.model, env.data, nominal)
        true = forward(plant.geometry, joints).position
        assert info["true_distance_mm"] == pytest.approx(1e3 * np.linalg.norm(true - env.goal), abs=1e-6)
        moved = np.linalg.norm(true - forward(nominal, joints).position)
        assert info["tool_error_mm"] == pytest.approx(1e3 * moved, abs=1e-6)
        assert info["is_success"] == float(info["true_distance_mm"] < 5.0) == 1.0 + reward
        succeeded.append(info["is_success"])
        *_, info = wrapped.step(env.wanted + 0.01)  # beside the goal, where it matters to which side the tool errs
        true = forward(plant.geometry, joints_in_mujoco(env.model, env.data, nominal)).position
        assert info["true_distance_mm"] == pytest.approx(1e3 * np.linalg.norm(true - env.goal), abs=1e-6)
    assert np.mean(succeeded) < 1.0


def test_a_calibration_brings_the_success_back():
    env = JointReach("ur5", within=1e-3)
    nominal = geometry_in_mujoco(env.model, "tool")
    plant = erring(nominal, 3.0)
    rng = np.random.default_rng(0)
    data = simulated_tracker(plant, rng.uniform(nominal.lower, nominal.upper, (40, 6)), rng)
    compensator = fit(plant.arm, data, known_frames=True).calibration.compensator()
    distances = {}
    for name, correct in (("raw", None), ("calibrated", compensator)):
        wrapped = Miscalibrate(JointReach("ur5", within=1e-3), nominal, plant, correct)
        distances[name] = []
        for seed in range(6):
            wrapped.reset(seed=seed)
            distances[name].append(wrapped.step(wrapped.unwrapped.wanted)[4]["true_distance_mm"])
    assert np.mean(distances["raw"]) > 1.0 and max(distances["calibrated"]) < 0.1


def test_a_geometry_will_do_for_the_truth():
    env = JointReach("ur5")
    nominal = geometry_in_mujoco(env.model, "tool")
    moved = replace(nominal, base=nominal.base._replace(position=nominal.base.position + np.array([0.0, 0.003, 0.0])))
    wrapped = Miscalibrate(env, nominal, moved)
    asked = {"goal": "any"}
    assert wrapped.reset(seed=0, options=asked)[1]["tool_error_mm"] == pytest.approx(3.0, abs=1e-9)
    assert env.asked is asked
    np.testing.assert_allclose(wrapped.tool_error(), [0.0, 0.003, 0.0], rtol=0, atol=1e-12)


def test_what_cannot_be_wrapped_is_refused_in_a_sentence(monkeypatch):
    env = JointReach("ur5")
    nominal = geometry_in_mujoco(env.model, "tool")
    with pytest.raises(
        InputError, match="CartPoleEnv has no achieved_goal and compute_reward; wrap a goal environment"
    ):
        Miscalibrate(gym.make("CartPole-v1"), nominal, nominal)
    with pytest.raises(InputError, match="ReachGoalEnv has no MuJoCo model and data"):
        Miscalibrate(gym.make("pickenv/ReachGoal-v0"), nominal, nominal)
    with pytest.raises(InputError, match="the true arm has 7 joints, the nominal one 6"):
        Miscalibrate(env, nominal, load_arm("panda").nominal)
    with pytest.raises(InputError, match="has effects with a memory; switch them off"):
        Miscalibrate(env, load_plant("orchard").arm.nominal, load_plant("orchard"))
    with pytest.raises(InputError, match="no site 'hand'"):
        geometry_in_mujoco(env.model, "hand")
    with pytest.raises(InputError, match="joint 'finger' does not move site 'tool'"):
        geometry_in_mujoco(env.model, "tool", ["finger"])
    elsewhere = replace(nominal, base=nominal.base._replace(position=nominal.base.position + 0.1))
    with pytest.raises(InputError, match="is not the position of the nominal arm's tool"):
        Miscalibrate(env, elsewhere, elsewhere).reset(seed=0)
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(InputError, match=r"pip install .pickenv.scene"):
        geometry_in_mujoco(env.model, "tool")


@pytest.mark.parametrize("name", ARMS)
def test_what_hangs_on_the_tool_stands_where_the_true_arm_has_it(name):
    bare, env = Touch(name), Touch(name)
    true = erring(bare.nominal, 20.0)
    before, wrapped = edited(env.model), Miscalibrate(env, bare.nominal, true, contact=True)
    rng = np.random.default_rng(3)
    for seed in range(3):
        wrapped.reset(seed=seed), bare.reset(seed=seed)
        for _ in range(5):
            action = rng.uniform(env.action_space.low, env.action_space.high)
            believed, reward, *_, info = wrapped.step(action)
            seen, *_ = bare.step(action)
            np.testing.assert_array_equal(believed, seen)
            assert reward == 0.0 and set(info) == {"tool_error_mm"}
            moved = check_displaced(env, bare, bare.nominal, true.geometry, lambda joints: joints, PARTS)
            assert info["tool_error_mm"] == pytest.approx(1e3 * np.linalg.norm(wrapped.tool_error()), rel=1e-12)
            assert np.linalg.norm(moved.rotation - np.eye(3)) > 1e-3
    wrapped.close()
    for was, now in zip(before, edited(env.model), strict=True):
        np.testing.assert_array_equal(was, now)


@pytest.mark.parametrize("part", ["palm", "heel", "finger"])
def test_a_contact_happens_where_the_true_finger_is(part):
    bare = Touch()
    true, action = erring(bare.nominal, 30.0), np.array([0.3, -1.2, 1.0, -0.5, 0.4, 0.2])
    wrapped = Miscalibrate(Touch(), bare.nominal, true, contact=True)
    wrapped.reset(), bare.reset()
    wrapped.step(action), bare.step(action)
    asked = [("geom", part)]
    (there,), (here,) = places(wrapped.unwrapped, asked), places(bare, asked)
    assert np.linalg.norm(there.position - here.position) > 0.02
    for place, touched in ((there, (1.0, 0.0)), (here, (0.0, 1.0))):
        options = {"ball": place.position + 0.004}
        wrapped.reset(options=options), bare.reset(options=options)
        wrapped.step(action), bare.step(action)  # the error is taken at the joints before a step
        for env in (wrapped.unwrapped, bare):
            env.data.qpos[env.n + 1 : env.n + 4], env.data.qvel[:] = place.position + 0.004, 0.0
        assert (wrapped.step(action)[1], bare.step(action)[1]) == touched


def test_a_model_within_a_simulator_is_displaced_as_the_environments_own_is():
    own, held = Touch(), SimulatorTouch()
    true = erring(own.nominal, 20.0)
    action = np.random.default_rng(4).uniform(own.nominal.lower, own.nominal.upper)
    for env in (own, held):
        wrapped = Miscalibrate(env, own.nominal, true, contact=True)
        wrapped.reset(seed=0)
        wrapped.step(action)
    for one, other in zip(edited(own.model), edited(held.env.model), strict=True):
        np.testing.assert_array_equal(one, other)
    assert not np.array_equal(own.model.geom_pos, Touch().model.geom_pos)


def test_a_calibration_puts_the_finger_back():
    bare = Touch()
    nominal, rng = bare.nominal, np.random.default_rng(0)
    plant = erring(nominal, 20.0)
    data = simulated_tracker(plant, rng.uniform(nominal.lower, nominal.upper, (40, 6)), rng)
    distances = {}
    for name, correct in (("raw", None), ("mended", fit(plant.arm, data, known_frames=True).calibration.compensator())):
        wrapped = Miscalibrate(Touch(), nominal, plant, correct, contact=True)
        wrapped.reset(), bare.reset()
        distances[name] = []
        for action in np.random.default_rng(1).uniform(nominal.lower, nominal.upper, (10, 6)):
            wrapped.step(action), bare.step(action)
            pairs = zip(places(wrapped.unwrapped), places(bare), strict=True)
            distances[name].append([np.linalg.norm(there.position - here.position) for there, here in pairs])
    assert np.mean(distances["mended"]) < 0.1 * np.mean(distances["raw"])


def test_another_wrapper_of_the_same_task_starts_from_the_model_as_it_was():
    env, before = Touch(), edited(Touch().model)
    for seed in (0, 1):
        Miscalibrate(env, env.nominal, erring(env.nominal, 20.0, seed), contact=True).reset(seed=0)
        assert not np.array_equal(env.model.geom_pos, before[2])
    Miscalibrate(env, env.nominal, env.nominal, contact=True).reset(seed=0)
    for was, now in zip(before, edited(env.model), strict=True):
        np.testing.assert_array_equal(was, now)


def same_bits(one, other, parts):
    for part in parts:
        np.testing.assert_array_equal(getattr(one.data, part), getattr(other.data, part))


def test_a_perfect_arm_changes_no_bit_of_a_task_with_contact():
    bare, env = Touch(), Touch()
    same = Plant("same", Arm("arm", "", bare.nominal, None, np.ones(6)), bare.nominal)
    before = edited(env.model)
    for true in (bare.nominal, same):
        wrapped, rng = Miscalibrate(env, bare.nominal, true, contact=True), np.random.default_rng(0)
        ball = {"ball": forward(bare.nominal, np.zeros(6)).position}
        wrapped.reset(options=ball), bare.reset(options=ball)
        for _ in range(200):
            action = rng.uniform(-0.05, 0.05, 6)
            (seen, reward, *_, info), (known, own, *_) = wrapped.step(action), bare.step(action)
            np.testing.assert_array_equal(seen, known)
            assert reward == own and info["tool_error_mm"] == 0.0
            same_bits(env, bare, ("qpos", "qvel", "xpos", "geom_xpos"))
    for was, now in zip(before, edited(env.model), strict=True):
        np.testing.assert_array_equal(was, now)


def test_a_tool_that_is_not_the_models_is_refused():
    env = Touch()
    elsewhere = replace(env.nominal, base=env.nominal.base._replace(position=env.nominal.base.position + 0.1))
    with pytest.raises(InputError, match="no site of the last link is the nominal arm's tool; read the arm with"):
        Miscalibrate(env, elsewhere, elsewhere, contact=True).reset()
    jointed = Touch(links='<joint name="more" type="hinge" axis="1 0 0"/>')
    with pytest.raises(InputError, match="no site of the last link"):
        Miscalibrate(jointed, jointed.nominal, jointed.nominal, contact=True).reset()
    with pytest.raises(InputError, match="has effects with a memory"):
        Miscalibrate(env, load_plant("orchard").arm.nominal, load_plant("orchard"), contact=True)
    with pytest.raises(InputError, match=r"Touch has no achieved_goal and compute_reward; .*, or give contact=True"):
        Miscalibrate(env, env.nominal, env.nominal)


FINGERS = [
    *(("geom", f"robot0:{side}_gripper_finger_link") for side in "lr"),
    *(("geom", f"robot0:{name}_link") for name in ("gripper", "wrist_roll")),
    ("cam", "gripper_camera_rgb"),
]


@pytest.fixture
def pick():
    gymnasium_robotics = pytest.importorskip("gymnasium_robotics", reason="pip install gymnasium-robotics")
    gym.register_envs(gymnasium_robotics)
    return lambda: gym.make("FetchPickAndPlace-v4", max_episode_steps=500)


def test_a_perfect_fetch_picks_with_the_same_bits(pick):
    bare, env = pick(), pick()
    parts = ("qpos", "qvel", "xpos", "geom_xpos", "mocap_pos", "ctrl")
    nominal = geometry_in_mujoco(env.unwrapped.model, "robot0:grip", None, env.unwrapped.data)
    wrapped = Miscalibrate(env, nominal, nominal, contact=True)
    wrapped.reset(seed=4), bare.reset(seed=4)
    rng = np.random.default_rng(0)
    for _ in range(200):
        action = rng.uniform(-1.0, 1.0, 4).astype(np.float32)
        (seen, reward, *_, info), (known, own, *_, told) = wrapped.step(action), bare.step(action)
        for key in seen:
            np.testing.assert_array_equal(seen[key], known[key])
        assert reward == own and info == {**told, "tool_error_mm": 0.0}
        same_bits(env.unwrapped, bare.unwrapped, parts)


def test_fetchs_fingers_are_the_true_arms_and_a_reset_forgets_them(pick):
    env, bare = pick(), pick()
    nominal = geometry_in_mujoco(env.unwrapped.model, "robot0:grip", None, env.unwrapped.data)
    plant = erring(nominal, 10.0)
    wrapped = Miscalibrate(env, nominal, plant, contact=True)
    with pytest.raises(InputError, match=r"is not the position of the nominal arm's tool; .*give contact=True"):
        Miscalibrate(pick(), nominal, plant).reset(seed=0)
    ends = []
    for _ in range(2):
        wrapped.reset(seed=7), bare.reset(seed=7)
        for action in np.random.default_rng(0).uniform(-1.0, 1.0, (20, 4)).astype(np.float32):
            observation = wrapped.step(action)[0]
            bare.unwrapped.data.qpos[:] = env.unwrapped.data.qpos
            bare.unwrapped.data.mocap_pos[:] = env.unwrapped.data.mocap_pos
            check_displaced(env.unwrapped, bare.unwrapped, nominal, plant.geometry, lambda joints: joints, FINGERS)
        ends.append(observation["observation"])
    np.testing.assert_array_equal(*ends)
