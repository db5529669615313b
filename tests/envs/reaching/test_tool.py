"""Reaches by increments of the tool: what closes the believed gap on one arm closes it on every arm."""

from __future__ import annotations

import math

import gymnasium as gym
import numpy as np
import pytest

from pickenv.arm import forward, inverse, load_arm, load_plant, pose_of, shipped_arms
from pickenv.base import InputError
from pickenv.calibration import Compensator
from pickenv.envs import ReachToolVectorEnv, ReachVectorEnv
from tests.envs.same import assert_same

NAME = "pickenv/ReachTool-v0"
ARMS = {
    **dict.fromkeys(("panda", "qiao2026", "tiago", "ur10", "ur10e", "ur5", "ur5e", "wam"), "pose"),
    **dict.fromkeys(("li2016_master", "li2016_slave", "so101"), "position"),
}
"""Every shipped arm that can move its tool in three directions, and what an action moves of it."""
VARIANTS = {
    "five joints, with a camera": {"plant": "coarse:so101", "actions": "position", "feedback": "camera"},
    "late, noisy and warm, from anywhere": {
        "plant": "orchard",
        "arms": "per_episode",
        "control_period_s": [0.05, 0.2],
        "latency": [0, 2],
        "action_delay": [0, 2],
        "joint_noise": 0.05,
        "hours_on": 2.0,
        "start_spread": 0.5,
    },
    "seven joints": {"plant": "coarse:panda"},
}
every_variant = pytest.mark.parametrize("arguments", VARIANTS.values(), ids=VARIANTS)


def closed(envs, steps=60):
    """The last information, where every action is the gap as it is shown."""
    observations, infos = envs.reset(seed=0)
    for _ in range(steps):
        observations, _, _, _, infos = envs.step(observations[..., :-1])
    return infos


def test_every_shipped_arm_is_named():
    assert set(ARMS) == {name for name in shipped_arms() if load_arm(name).nominal.joints >= 3}


@pytest.mark.parametrize("arm", ARMS)
def test_the_gap_as_it_is_shown_closes_itself(arm):
    infos = closed(gym.make_vec(NAME, num_envs=64, plant=f"ideal:{arm}", actions=ARMS[arm]))
    assert infos["position_error_mm"].max() < 1e-3 and infos["is_success"].all()
    if ARMS[arm] == "pose":
        assert infos["attitude_error_deg"].max() < 1e-3


def test_a_strangers_urdf_needs_nothing_else(data_folder):
    infos = closed(gym.make_vec(NAME, num_envs=64, plant=f"ideal:{data_folder / 'mukca_sockets/urdf/iiwa14.urdf'}"))
    assert infos["position_error_mm"].max() < 1e-3 and infos["is_success"].all()


@pytest.mark.parametrize("arm", ARMS)
def test_goals_are_upright_poses_that_joints_inside_the_limits_have(arm):
    env = gym.make(NAME, plant=f"ideal:{arm}", actions=ARMS[arm]).unwrapped
    task, geometry = env.task, env.plant.arm.nominal
    low, high = map(np.array, task.box)
    assert (low > geometry.lower).all() and (high < geometry.upper).all()
    assert (high - low <= 0.25 * np.where(geometry.prismatic, np.inf, math.tau) + 1e-12).all()
    for seed in range(8):
        env.reset(seed=seed)
        assert (env.joint_target == (low + high) / 2.0).all()
        goal = pose_of(env._state.goal)
        assert goal.rotation[2, 2] >= task.min_upright and inverse(geometry, goal, env.joint_target).reached


@pytest.mark.parametrize("number", range(6))
def test_an_increment_moves_the_tool_along_or_about_its_axis_of_the_base_alone(number):
    env = gym.make("pickenv/ReachTool-v0", plant="ideal:ur5e", tool_step_mm=1.0, tool_turn_deg=0.1).unwrapped
    env.reset(seed=1)
    before = forward(env.plant.arm.nominal, env.joint_target)
    env.step(np.eye(6)[number])
    after = forward(env.plant.arm.nominal, env.joint_target)
    turn = (after.rotation @ before.rotation.T - np.eye(3))[[2, 0, 1], [1, 2, 0]]
    moved = np.concatenate([(after.position - before.position) / 1e-3, turn / math.radians(0.1)])
    np.testing.assert_allclose(moved, np.eye(6)[number], atol=0.01)


def test_joints_are_no_faster_than_they_can_be_and_the_tool_keeps_its_direction():
    env = gym.make(NAME, plant="ideal:ur5e", tool_step_mm=5000.0, control_period_s=[0.02, 0.1]).unwrapped
    env.reset(seed=3)
    before = env.joint_target
    tool = forward(env.plant.arm.nominal, before).position
    env.step([1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    way = np.abs(env.joint_target - before) / env.increment
    period = env.task.situation.value("period", env._state.drawn)
    assert way.max() == pytest.approx(period / 0.1)
    along = forward(env.plant.arm.nominal, env.joint_target).position - tool
    assert along[0] > 0.95 * np.linalg.norm(along)


def run(env, actions, seed):
    """What an environment, or a vector of them, returns: observations and every number of the infos."""
    results = [env.reset(seed=seed), *(env.step(action) for action in actions)]
    return [
        {"seen": result[0], **{key: np.asarray(value) for key, value in result[-1].items() if key[0] != "_"}}
        for result in results
    ]


@every_variant
def test_it_is_the_same_alone_on_floats_and_as_machine_code(arguments):
    """To the bit on NumPy, which `test_autoreset` asks of the plain one; else up to roundings."""
    native, compiled = (gym.make_vec(NAME, num_envs=3, executor=kind, **arguments) for kind in ("numpy", "compiled"))
    actions = np.random.default_rng(0).uniform(-1.3, 1.3, (12, *native.action_space.shape))
    results = run(native, actions, 5)
    for one, other in zip(results, run(compiled, actions, 5), strict=True):
        assert_same(one, other, apart=1e-9)
    for executor, apart in (("numpy", 0.0), ("floats", 1e-9)):
        for i in range(3):
            alone = run(gym.make(NAME, executor=executor, **arguments), actions[:, i], 5 + i)
            for one, other in zip(results, alone, strict=True):
                assert_same({key: np.asarray(part[i]) for key, part in one.items()}, other, apart=apart)


class Plain(ReachVectorEnv):
    """Tool increments without scaling, which torch's tensors can have too."""

    task_of = staticmethod(ReachToolVectorEnv.task_of)


def test_torch_moves_the_tool_by_the_same_formula():
    torch = pytest.importorskip("torch")
    one = Plain(5, plant="coarse:panda", executor="numpy")
    other = Plain(5, plant="coarse:panda", executor="torch", compiled=False)
    for envs in (one, other):
        envs.reset(seed=0)
    for action in np.random.default_rng(0).uniform(-1.0, 1.0, (3, 5, 6)):
        infos = one.step(action)[-1], other.step(torch.as_tensor(action))[-1]
        np.testing.assert_allclose(infos[0]["joint_command"], infos[1]["joint_command"].numpy(), atol=1e-9)


def test_a_calibration_stands_between_tool_and_drives_as_elsewhere():
    """The policy sees the same, and the true tool comes to the fruit."""
    plant = load_plant("geometry_only")
    raw, corrected = (gym.make_vec(NAME, num_envs=16, plant="geometry_only") for _ in range(2))
    corrected.unwrapped.compensator = Compensator(plant.arm.nominal, plant.geometry)
    left = [closed(envs)["position_error_mm"].mean() for envs in (raw, corrected)]
    assert left[0] > 1.0 and left[1] < 1e-3


def test_where_no_attitude_is_asked_for_none_counts():
    env = gym.make(NAME, plant="ideal:ur5e", actions="position")
    observation, info = env.reset(seed=0)
    assert observation.shape == env.observation_space.shape == (4,) and env.action_space.shape == (3,)
    rewards = []
    for _ in range(40):
        outside = 0.0 if info["is_success"] else math.log10(1.0 + 5.0)
        assert info["is_success"] == (info["position_error_mm"] <= 5.0)
        observation, reward, _, _, info = env.step(observation[:3])
        outside = 0.0 if info["is_success"] else math.log10(1.0 + 5.0)
        rewards.append(reward + math.log10(1.0 + info["position_error_mm"]) + outside)
    np.testing.assert_allclose(rewards, 0.0, atol=1e-12)
    assert info["is_success"] and info["attitude_error_deg"] > 1.0


@pytest.mark.parametrize("actions", ["pose", "position"])
def test_what_is_shown_is_the_gap_by_direction_and_logarithm(actions):
    env = gym.make(NAME, plant="ideal:ur5e", actions=actions, tool_step_mm=40.0)
    seen, _ = env.reset(seed=4)
    gap, turn = env.unwrapped.raw[12:15] / 0.04, env.unwrapped.raw[15:18] / math.radians(10.0)
    sizes = [np.linalg.norm(part) for part in (gap, turn)][: len(seen) // 3]
    size = max(sizes)
    whole = [*gap, *turn][: len(seen) - 1]
    np.testing.assert_allclose(seen, [*(np.array(whole) / size), math.log10(size) / 2.0], rtol=1e-5)


@pytest.mark.parametrize("name", ["ReachTool", "ReachScaled"])
def test_it_is_an_environment_of_its_own_and_no_wrapped_one(name):
    """Clients that go by `unwrapped` get the spaces that they act in."""
    env, envs = gym.make(f"pickenv/{name}-v0"), gym.make_vec(f"pickenv/{name}-v0", num_envs=2)
    assert env.unwrapped.observation_space == env.observation_space == envs.unwrapped.single_observation_space
    assert env.observation_space.shape == env.reset(seed=0)[0].shape == envs.reset(seed=0)[0][0].shape


REFUSED = {
    "arm 'so101' has 5 joints, too few for the 6 increments .* give actions='position'": {"plant": "ideal:so101"},
    "arm 'positioner' has 2 joints, too few for the 3 increments of its tool that actions='position' are$": {
        "plant": "ideal:positioner",
        "actions": "position",
    },
    "arm 'positioner' has 2 joints, too few for the 6 increments of its tool that actions='pose' are$": {
        "plant": "ideal:positioner"
    },
    "actions is 'joints'; give one of pose, position": {"actions": "joints"},
    "tool_step_mm is 0; give a finite number above zero": {"tool_step_mm": 0},
    "tool_turn_deg is 'x'; give a finite number above zero": {"tool_turn_deg": "x"},
    "tool_turn_deg is nan; give a finite number above zero": {"tool_turn_deg": math.nan},
    "goal_spread is 0.0; give a finite number above zero": {"goal_spread": 0.0},
    "goal_spread is 1.5; give a share": {"goal_spread": 1.5},
}


@pytest.mark.parametrize("words", REFUSED)
def test_what_cannot_be_is_refused_in_one_sentence(words):
    for make in (gym.make, lambda name, **arguments: gym.make_vec(name, num_envs=2, **arguments)):
        with pytest.raises(InputError, match=words) as refused:
            make(NAME, **REFUSED[words])
        assert len(str(refused.value).splitlines()) == 1


def test_where_no_pose_is_upright_enough_it_is_said():
    env = gym.make(NAME, plant="ideal:ur5e", max_tilt_deg=0.001)
    with pytest.raises(InputError, match=r"found no pose with its tool within 0 deg .* raise max_tilt_deg"):
        env.reset(seed=0)


def test_the_box_may_be_all_of_the_joints_ranges():
    task = gym.make(NAME, plant="ideal:panda", goal_spread=1.0).unwrapped.task
    np.testing.assert_allclose(task.box, [task.lower, task.upper])


def test_tensors_and_actions_of_joints_are_refused():
    pytest.importorskip("torch")
    with pytest.raises(InputError, match="give executor='numpy'"):
        ReachToolVectorEnv(2, executor="torch", compiled=False)
    env = gym.make(NAME, plant="ideal:panda")
    env.reset(seed=0)
    with pytest.raises(InputError, match="is not 6 finite numbers"):
        env.unwrapped.step(np.zeros(7))
