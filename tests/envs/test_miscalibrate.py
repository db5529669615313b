"""A real arm's error in somebody else's reaching task: success is the true tool's, and the policy never sees it."""

import sys
from dataclasses import replace
from typing import Any

import gymnasium as gym
import mujoco
import numpy as np
import pytest

from pickenv.arm import Arm, Plant, forward, geometry_in_mujoco, joints_in_mujoco, load_arm, load_plant, mjcf_text
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
    with pytest.raises(InputError, match="pip install mujoco"):
        geometry_in_mujoco(env.model, "tool")
