"""Policies: the oracle leaves nothing, the servo converges, the adaptive policy gets better from pick to pick."""

from dataclasses import replace
from types import SimpleNamespace

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.spaces import Box
from scipy.spatial.transform import Rotation

import pickenv  # noqa: F401
from pickenv.agents import (
    AdaptiveReach,
    OracleReach,
    RandomReach,
    Rollout,
    ScriptedPick,
    ScriptedReach,
    ServoReach,
    read_observation,
    roll_out,
    run_reaches,
)
from pickenv.agents.evaluation.contenders import MOST_ROWS
from pickenv.arm import InverseSolution, forward, inverse, joint_jacobian, load_arm
from pickenv.base import InputError
from pickenv.calibration import link_model, random_joints
from pickenv.calibration.identification import solve
from pickenv.envs.shared.situation import make_situation
from pickenv.inspect import Reaches
from pickenv.orchard import load_gripper
from pickenv.wrappers import Scaling, joined_observation

CAMERA = {"feedback": "camera", "camera_noise_mm": 1.0, "fruit_noise_mm": 0.0}


def errors(make, arms=4, episodes=8, **arguments):
    return roll_out(lambda env, seed: make(env), arms, episodes, 5, **arguments).reaches.position_error_mm


@pytest.mark.parametrize("plant", ["geometry_only", "qiao2026"])
def test_the_oracle_leaves_nothing_of_what_the_joints_decide(plant):
    found = errors(OracleReach, plant=plant, tolerances="coarse", steps=40)
    assert np.percentile(found, 95) < 0.01
    assert found.mean() < 0.1 * errors(ScriptedReach, plant=plant, tolerances="coarse", steps=40).mean()


def test_the_servo_sees_away_what_the_arm_does_wrong():
    scripted = errors(ScriptedReach, plant="orchard", feedback="camera", tolerances="coarse")
    servo = errors(ServoReach, plant="orchard", feedback="camera", tolerances="coarse")
    assert servo.mean() < 0.1 < scripted.mean()


@pytest.mark.parametrize("gain", [0.1, 0.5, 1.0])
def test_a_gain_averages_noise_as_a_first_order_filter_does(gain):
    def make(env, seed):
        return ServoReach(env, gain=gain)

    found = roll_out(make, 4, 64, 5, plant="ideal:qiao2026", tolerances="fine", **CAMERA)
    rms = np.sqrt(np.mean(found.reaches.position_error_mm**2))
    assert rms == pytest.approx(np.sqrt(3 * gain / (2 - gain)), rel=0.15)


def test_an_impossible_gain_is_refused():
    with gym.make("pickenv/Reach-v0") as env, pytest.raises(InputError, match=r"gain is 0\.0"):
        ServoReach(env, gain=0.0)


@pytest.mark.parametrize("policy", [ServoReach, AdaptiveReach])
def test_a_camera_is_asked_for(policy):
    with gym.make("pickenv/Reach-v0") as env:
        observation, _ = env.reset(seed=0)
        with pytest.raises(InputError, match="needs a camera; make the environment with feedback='camera'"):
            policy(env).act(observation)


def test_the_adaptive_policy_gets_better_from_pick_to_pick():
    found = roll_out(
        lambda env, seed: AdaptiveReach(env), 4, 16, 5, sequential=True, plant="geometry_only", steps=30,
        tolerances="coarse", **CAMERA,
    )  # fmt: skip
    by_pick = found.reaches.position_error_mm.reshape(16, 4).mean(axis=1)
    assert by_pick[8:].mean() < 0.5 * by_pick[0]


def test_policies_run_in_single_environments_too():
    with gym.make("pickenv/Reach-v0", plant="geometry_only", feedback="camera") as env:
        rng = np.random.default_rng(0)
        policies = (OracleReach(env), ServoReach(env), AdaptiveReach(env), RandomReach(env, rng))
        oracle, servo, adaptive, random = (
            run_reaches(env, policy, [1, 2]).position_error_mm.max() for policy in policies
        )
    assert oracle < 0.01 and servo < 0.1 and adaptive < 10 < random


def test_a_batch_acts_like_its_single_rows():
    envs = gym.make_vec("pickenv/Reach-v0", num_envs=3, feedback="camera")
    observations, _ = envs.reset(seed=3)
    for policy in (ScriptedReach, ServoReach, OracleReach):
        together = policy(envs).act(observations)
        for i in range(3):
            np.testing.assert_allclose(policy(envs).act(observations[i]), together[i], atol=1e-5)


# Policies and what becomes of their episodes, number by number: filters, scalings, captures and counted steps.
ARM = load_arm("qiao2026").nominal
GOAL = inverse(ARM, forward(ARM, ARM.lower + 0.4 * (ARM.upper - ARM.lower)), attitude_tolerance=1e-4).joints
"""Of the joints that give one pose, those that the nominal inverse gives."""


def far_reaching():
    """What policies read of an environment, with increments that no step here is cut to."""
    inner = SimpleNamespace(plant=SimpleNamespace(arm=SimpleNamespace(nominal=ARM)), increment=np.full(6, 10.0))
    inner.task = SimpleNamespace(situation=make_situation())
    return SimpleNamespace(unwrapped=inner)


def seen_at(joints, camera=None, goal=GOAL):
    """The observation of an arm that believes to stand at ``joints``, before a fruit at the pose of ``goal``."""
    here, there = forward(ARM, joints), forward(ARM, goal)
    turn = Rotation.from_matrix(there.rotation @ here.rotation.T).as_rotvec()
    scaled = 2 * (joints - ARM.lower) / (ARM.upper - ARM.lower) - 1
    parts = [scaled, here.position, there.position, there.position - here.position, turn]
    return np.concatenate(parts if camera is None else [*parts, camera])


def step_of(action):
    """The joint step that an action asks for, with the increments of `far_reaching`."""
    return np.asarray(action, dtype=float) * 10.0


def test_an_observation_is_read_by_its_parts():
    joints = ARM.lower + np.linspace(0.1, 0.9, 6) * (ARM.upper - ARM.lower)
    reading = read_observation(ARM, seen_at(joints, camera=[7.0, 8.0, 9.0]))
    assert reading.joints == pytest.approx(joints) and reading.camera.tolist() == [7.0, 8.0, 9.0]
    assert reading.believed == pytest.approx(forward(ARM, joints).position)
    assert reading.seen == pytest.approx(forward(ARM, GOAL).position)
    assert reading.offset == pytest.approx(reading.seen - reading.believed)
    assert read_observation(ARM, np.zeros(18)).camera is None
    with pytest.raises(InputError, match="has 19 numbers; a policy for 6 joints reads 18, or 21"):
        read_observation(ARM, np.zeros(19))


def test_the_scripted_policy_goes_to_the_fruits_joints_by_the_largest_increments():
    env = far_reaching()
    env.unwrapped.increment = np.array([0.1, 0.05, 0.05, 0.1, 0.05, 0.3])
    start = GOAL + np.array([0.05, -0.01, 0.2, 0.0, -0.025, -0.6])
    action = ScriptedReach(env).act(seen_at(start))
    assert action == pytest.approx([-0.5, 0.2, -1.0, 0.0, 0.5, 1.0], abs=1e-4)


def test_the_scripted_policy_turns_to_every_fruit_that_joints_can_be_turned_to():
    """Of random poses; for one of them the first joints that come to the place are 15 degrees off its attitude."""
    wanted = forward(ARM, random_joints(ARM, 100, np.random.default_rng(0)))
    here = np.tile((ARM.lower + ARM.upper) / 2, (100, 1))
    turn = Rotation.from_matrix(wanted.rotation @ np.swapaxes(forward(ARM, here).rotation, 1, 2)).as_rotvec()
    reading = SimpleNamespace(joints=here, seen=wanted.position, turn=turn)
    found = forward(ARM, ScriptedReach(far_reaching()).wanted_joints(reading))
    np.testing.assert_allclose(found.position, wanted.position, atol=1e-4)
    np.testing.assert_allclose(found.rotation, wanted.rotation, atol=1e-3)


@pytest.mark.parametrize(("short", "reached", "lost"), [(0.09, False, False), (0.11, False, True), (0.11, True, False)])
def test_the_nearest_joints_are_taken_for_a_fruit_up_to_a_decimetre_out_of_reach(short, reached, lost, monkeypatch):
    """A camera's error may put it there; of several fruit the first that is farther out is named."""
    shortfall = np.array([0.0, short])
    found = InverseSolution(np.tile(GOAL, (2, 1)), np.array([True, reached]), shortfall, shortfall * 0.1, shortfall)
    monkeypatch.setattr("pickenv.agents.policies.scripted.inverse", lambda *_, **__: found)
    act, observation = ScriptedReach(far_reaching()).act, np.stack([seen_at(GOAL), seen_at(GOAL)])
    if lost:
        with pytest.raises(InputError, match=r"cannot be reached: 110.0 mm and 0.63 deg remain"):
            act(observation)
    else:
        assert act(observation) == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("gain", [1.0, 0.3, 0.25])
def test_the_servo_adds_the_filtered_pictures_through_the_jacobian_at_the_goal(gain):
    """First picture whole, later ones by the gain; the Jacobian's inverse has its rank 5."""
    rng = np.random.default_rng(0)
    policy = ServoReach(far_reaching(), gain=gain)
    back = np.linalg.pinv(joint_jacobian(ARM, GOAL), rcond=5e-3)[:, :3]
    for _ in range(2):  # a second episode knows nothing of the first
        policy.reset()
        pictures = rng.normal(0.0, 2e-3, (6, 3))
        known = None
        for picture in pictures:
            joints = GOAL + rng.uniform(-1e-3, 1e-3, 6)
            observation = seen_at(joints)
            camera = observation[12:15] + picture
            known = picture if known is None else (1 - gain) * known + gain * picture
            wanted = GOAL + back @ known
            step = step_of(policy.act(np.concatenate([observation, camera])))
            assert joints + step == pytest.approx(wanted, abs=2e-6)


def test_a_correction_stays_within_the_joints_limits():
    edge = np.array([0.0, ARM.lower[1], 0.4, 0.0, 0.1, 0.0])
    rail = joint_jacobian(ARM, edge)[:3, 1]
    for sign, moved in ((-1.0, 0.0), (1.0, 0.01)):
        observation = seen_at(edge, goal=edge)
        camera = observation[12:15] + sign * 0.01 * rail
        step = step_of(ServoReach(far_reaching(), gain=1.0).act(np.concatenate([observation, camera])))
        assert step[1] == pytest.approx(moved, abs=1e-4)


def test_gains_up_to_one_are_possible():
    ServoReach(far_reaching(), gain=1.0)
    for gain in (1.001, 0.0):
        with pytest.raises(InputError, match="give a number"):
            ServoReach(far_reaching(), gain=gain)


def test_what_an_episode_showed_is_one_observation_of_the_place_where_the_arm_stood(monkeypatch):
    """Three pictures while it stood, none before: their mean, with sqrt(1.2^2 (1 + 1/3) + 0.5^2) mm of noise."""
    asked = []
    monkeypatch.setattr(solve, "update", lambda state, *given: asked.append(given) or state)
    policy = AdaptiveReach(far_reaching(), camera_std=1.2e-3, unmodelled_std=0.5e-3)
    pictures = np.random.default_rng(1).normal(0.0, 1e-2, (4, 3))
    policy.increment = np.full(6, 0.05)
    for turn, picture in enumerate(pictures):
        joints = GOAL + (0.05 if turn == 0 else 0.0)  # an increment away, then there
        policy.act(seen_at(joints, camera=picture))
    assert not asked
    policy.reset()
    ((joints, place, std),) = asked
    assert joints == pytest.approx(GOAL, abs=1e-6)
    assert place == pytest.approx(forward(ARM, GOAL).position - pictures[1:].mean(axis=0), abs=1e-9)
    assert std.position_std == pytest.approx(1e-3 * np.sqrt(1.44 * 4 / 3 + 0.25)) and std.attitude_std == 0.0
    asked.clear()
    policy.reset()  # nothing was seen since
    assert not asked


def test_settings_of_which_nothing_is_said_are_a_camera_of_a_millimetre_and_half_of_one_unmodelled(monkeypatch):
    asked = []
    monkeypatch.setattr(solve, "update", lambda state, *given: asked.append(given) or state)
    policy = AdaptiveReach(far_reaching())
    policy.act(seen_at(GOAL, camera=np.zeros(3)))
    policy.reset()
    ((_, _, noise),) = asked
    assert noise.position_std == pytest.approx(1e-3 * np.sqrt(2 + 0.25))


def test_the_filters_begin_with_the_prior_that_is_given_in_tolerances():
    for prior in (1.0, 0.2):
        start = AdaptiveReach(far_reaching(), prior=prior).start
        np.testing.assert_allclose(np.sqrt(np.diag(start.covariance)), prior * start.tolerance)
    assert np.array_equal(AdaptiveReach(far_reaching()).start.covariance, np.diag(start.tolerance**2))


def test_the_filters_know_only_what_positions_can_tell():
    """The tool's turns are among what a full pose would tell besides."""
    policy, typical = AdaptiveReach(far_reaching()), random_joints(ARM, 200, np.random.default_rng(0))
    full, part = (solve.start_filter(link_model(ARM), ARM, typical, full_pose=pose) for pose in (True, False))
    assert policy.start.columns.tolist() == part.columns.tolist() and len(part.columns) < len(full.columns)


def test_each_arm_of_a_batch_notes_its_own_pictures_and_goes_to_its_own_joints(monkeypatch):
    """Of two arms the second has not arrived: only the first one's filter learns."""
    asked = []
    monkeypatch.setattr(solve, "update", lambda state, *given: asked.append(given) or state)
    policy = AdaptiveReach(far_reaching())
    policy.increment = np.full(6, 0.05)
    pictures = np.array([[0.01, 0.0, 0.0], [0.0, 0.02, 0.0]])
    action = policy.act(np.stack([seen_at(GOAL, pictures[0]), seen_at(GOAL + 0.05, pictures[1])]))
    assert action.shape == (2, 6) and np.abs(action[0]).max() < 1e-4 and action[1] == pytest.approx(-1.0, abs=1e-3)
    policy.reset()
    ((joints, place, _),) = asked
    assert joints == pytest.approx(GOAL, abs=1e-6)
    assert place == pytest.approx(forward(ARM, GOAL).position - pictures[0], abs=1e-9)


def test_random_actions_are_even_from_minus_one_to_one():
    env = SimpleNamespace(action_space=Box(-1.0, 1.0, (4,)))
    actions = RandomReach(env, np.random.default_rng(0)).act(np.zeros((5000, 16)))
    assert actions.shape == (5000, 4) and actions.dtype == np.float32
    assert np.abs(actions).max() <= 1.0 and actions.min() < -0.999 and actions.max() > 0.999
    assert abs(actions.mean()) < 4 / np.sqrt(3 * 20_000) and actions.var() == pytest.approx(1 / 3, rel=0.03)
    assert RandomReach(env, np.random.default_rng(0)).act(np.zeros(16)).shape == (4,)


@pytest.mark.parametrize(
    ("kind", "gap", "turn", "inputs"),
    [({}, slice(8, 11), slice(11, 14), 14), ({"camera": True}, slice(14, 17), slice(11, 14), 17)],
)
def test_a_scaling_shows_a_gap_as_direction_and_logarithm(kind, gap, turn, inputs):
    """40 mm of a near gap of 100, and 0.15 of 0.2 rad: the turn is the larger share, 0.75."""
    scaling, values = Scaling(2, **kind), np.zeros((3, inputs))
    assert (scaling.inputs, scaling.features) == (inputs, 9)
    values[:, :2], values[:, gap] = [0.3, -0.4], [[0.0, 0.04, 0.0], [0.0, 0.0, 0.5], [0.0, 0.0, 0.0]]
    values[:, turn] = [[0.15, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]]
    for size, row in zip((0.75, 5.0, 1e-6), range(3), strict=True):
        wanted = [0.3, -0.4, *(values[row, gap] / 0.1 / size), *(values[row, turn] / 0.2 / size), np.log10(size) / 2]
        assert scaling.observe(values[row], np) == pytest.approx(wanted)
        assert scaling.share(values[row], np) == pytest.approx([min(size, 1.0)])
    assert (replace(scaling, actions=False).share(values, np) == 1.0).all()
    assert scaling.observe(values, np).shape == (3, 9) and scaling.share(values, np).shape == (3, 1)
    scaling.check(inputs)
    with pytest.raises(InputError, match=f"observations of {inputs} numbers, but the environment gives 9"):
        scaling.check(9)


def test_a_goal_scaling_reads_the_gap_from_the_goals():
    """Observation (joints, believed), achieved and desired goal, one after the other; attitudes by z and x axes."""
    scaling, rng = Scaling(2, goal=True), np.random.default_rng(0)
    here, turn = Rotation.random(rng=rng), rng.normal(size=3)
    attitudes = [rotation.as_matrix() for rotation in (here, Rotation.from_rotvec(turn) * here)]
    goals = [[*place, *axes[:, 2], *axes[:, 0]] for place, axes in zip(([1, 2, 3], [7, 7, 7]), attitudes, strict=True)]
    parts = {"observation": np.arange(5.0), "achieved_goal": np.array(goals[0]), "desired_goal": np.array(goals[1])}
    joined = joined_observation(parts)
    assert joined.tolist() == [*range(5), *goals[0], *goals[1]] and scaling.inputs == len(joined) == 23
    gap, left = scaling.gap(joined, np)
    assert gap.tolist() == [6.0, 5.0, 4.0] and left == pytest.approx(turn)
    assert joined_observation(joined) is joined


def ends(pose_error, tool, fruit):
    """The ends of episodes with nothing else to them."""
    n = len(pose_error)
    rest = {"noncompensable": np.zeros((n, 6)), "success": np.zeros(n, bool), "joint_command": np.zeros((n, 6))}
    return Reaches(tuple(range(n)), pose_error=pose_error, tool_position=tool, fruit_position=fruit, **rest)


def test_a_capture_is_asked_where_the_fruit_lies_in_the_true_tool():
    """Wanted straight up; the second tool leans 9 degrees to x, so a fruit straight above it lies aside by its sine."""
    lean = np.radians(9.0)
    error = np.zeros((4, 6))
    error[1:, 4] = [lean, lean, np.radians(11.0)]
    error[0, :3] = [0.5, 0.5, 0.5]  # the place is taken from tool and fruit, not from here
    offsets = np.array([[0.0049, 0, 0], [0, 0, 0.028], [0, 0, 0.033], [0, 0, 0.0]])
    found = Rollout(ends(error, np.zeros((4, 3)), offsets), np.zeros(4, int), np.tile(np.eye(3), (4, 1, 1)), None)
    assert 0.028 * np.sin(lean) < 0.005 < 0.033 * np.sin(lean)
    assert found.capture(load_gripper("li_cup")).tolist() == [1.0, 1.0, 0.0, 0.0]
    hand = found.capture(load_gripper("compliant_hand"))
    logit = 2.29 - 84 * 0.028 * np.sin(lean) - 36 * 0.028 * np.cos(lean) - 0.05 * 0.9
    assert hand[1] == pytest.approx(1 / (1 + np.exp(-logit)), abs=1e-6)


def test_a_cycle_is_over_where_the_tool_stays():
    """One passes the fruit in step 2 and stays from step 4 on, one was there from the start, one leaves at last."""
    error = np.array([[9.0, 0.9, 2.0, 0.8, 0.7], [1.0, 0.5, 0.4, 0.3, 0.2], [0.1, 0.1, 0.1, 0.1, 1.1]]).T
    found = Rollout(None, np.zeros(3, int), None, error)
    np.testing.assert_array_equal(found.cycle_steps(1.0), [4.0, 1.0, np.nan])


class Still:
    """A policy that stays, and says how often it was asked."""

    def __init__(self, env, seed, log):
        self.rows, self.log = env.num_envs, log
        log.append(("made", env.num_envs, seed))

    def reset(self):
        self.log.append(("reset",))

    def act(self, observation):
        self.log.append(("act", len(observation)))
        return np.zeros((self.rows, 6), dtype=np.float32)


@pytest.mark.parametrize("sequential", [True, False])
def test_rows_are_every_arm_in_turn_whatever_runs_side_by_side(sequential, monkeypatch):
    """Three arms and five fruit: one round after the other, or as many as seven rows hold, two of three rows."""
    monkeypatch.setattr("pickenv.agents.evaluation.contenders.MOST_ROWS", 7)
    log = []
    found = roll_out(lambda env, seed: Still(env, seed, log), 3, 5, 11, steps=2, sequential=sequential)
    assert found.arm.tolist() == [0, 1, 2] * 5 and found.error_mm.shape == (2, 15) and len(found.reaches.seeds) == 15
    widths = [width for kind, *rest in log if kind == "act" for width in rest]
    assert widths == ([3] * 10 if sequential else [6] * 4 + [3] * 2)
    made = [entry[1:] for entry in log if entry[0] == "made"]
    assert [rows for rows, _ in made] == ([3] if sequential else [6, 3])
    assert len({seed for _, seed in made}) == len(made)
    whole = roll_out(lambda env, seed: Still(env, seed, []), 3, 5, 11, steps=2)
    assert np.array_equal(whole.reaches.fruit_position, found.reaches.fruit_position)
    np.testing.assert_array_equal(whole.error_mm[-1], found.error_mm[-1])
    np.testing.assert_allclose(found.error_mm[-1], found.reaches.position_error_mm)
    assert MOST_ROWS == 2048 and len(set(found.reaches.seeds)) == 15


def test_one_fruit_on_one_arm_is_enough_and_none_of_either_is_not():
    found = roll_out(lambda env, seed: Still(env, seed, []), 1, 1, 11, steps=1)
    assert found.error_mm.shape == (1, 1) and found.arm.tolist() == [0]
    for arms, episodes in ((0, 1), (1, 0)):
        with pytest.raises(InputError, match=r"1 (arm|episode).* are too few; give one of each"):
            roll_out(lambda env, seed: Still(env, seed, []), arms, episodes, 11, steps=1)


def test_unless_told_otherwise_a_rollout_has_the_steps_of_an_episode():
    found = roll_out(lambda env, seed: Still(env, seed, []), 1, 1, 11)
    assert len(found.error_mm) == gym.spec("pickenv/Reach-v0").max_episode_steps == 60


def test_each_arm_has_its_own_compensator_and_what_was_wanted_is_the_goals_attitude():
    shift = np.array([0.0, 0.01, 0.0, 0.0, 0.0, 0.0])
    compensators = [lambda joints: joints, lambda joints: joints + shift]
    found = roll_out(
        lambda env, seed: Still(env, seed, []), 2, 3, 0, steps=1, compensators=compensators, plant="ideal:qiao2026",
        tolerances="fine",
    )  # fmt: skip
    sent = found.reaches.joint_command[:, 1] - found.reaches.joint_command[0, 1]
    assert sent == pytest.approx([0.0, 0.01] * 3)
    upright = found.wanted_rotation[:, 2, 2]
    assert (upright >= np.cos(np.radians(30.0)) - 1e-6).all() and len(np.unique(upright.round(6))) == 6


@pytest.mark.parametrize(
    ("arms", "episodes", "said"), [(0, 3, "0 arms and 3 episodes"), (1, 0, "1 arm and 0 episodes")]
)
def test_impossible_rollouts_are_refused(arms, episodes, said):
    with pytest.raises(InputError, match=said):
        roll_out(lambda env, seed: Still(env, seed, []), arms, episodes, 0)


@pytest.mark.parametrize("period", [0.05, 0.2])
def test_a_picking_script_keeps_its_speed_whatever_the_period(period):
    env = gym.make("pickenv/Pick-v0", control_period_s=period)
    script = ScriptedPick(env, tool_speed=0.2)
    geometry, (seen, _) = script.geometry, env.reset(seed=3)

    def tool(seen):
        share = (seen[: geometry.joints].astype(float) + 1) / 2
        return forward(geometry, geometry.lower + share * (geometry.upper - geometry.lower)).position

    tools = [tool(seen)]
    for _ in range(12):
        seen, *_ = env.step(script.act(seen))
        tools.append(tool(seen))
    assert np.linalg.norm(np.diff(tools, axis=0), axis=1).max() / period == pytest.approx(0.2, rel=0.05)
