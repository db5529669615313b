"""CompensationWrapper: invisible to the policy, visible in the true error."""

import copy
from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.wrappers import RecordEpisodeStatistics, RescaleAction, TimeLimit

import pickenv
from pickenv.agents import ScriptedReach
from pickenv.arm import displace_pose
from pickenv.base import InputError
from pickenv.calibration import Calibration, Compensator, fit, random_joints, simulated_tracker
from pickenv.wrappers import CompensationVectorWrapper, CompensationWrapper


@pytest.fixture
def reach(make):
    def build(**arguments):
        return make(**{"plant": "geometry_only"} | arguments)

    return build


def run(env, seed=3, steps=60):
    """Observations, flags and informations of an episode of seeded random actions."""
    rng = np.random.default_rng(seed)
    observation, info = env.reset(seed=seed)
    seen, flags, infos = [observation], [], [info]
    for _ in range(steps):
        observation, _, terminated, truncated, info = env.step(rng.uniform(-1, 1, 6).astype(np.float32))
        seen.append(observation)
        flags.append((terminated, truncated))
        infos.append(info)
    return np.array(seen), flags, infos


def driven(env, policy, seed):
    """The last observation and information of an episode of the policy."""
    observation, info = env.reset(seed=seed)
    policy.reset()
    truncated = False
    while not truncated:
        observation, _, _, truncated, info = env.step(policy.act(observation))
    return observation, info


def test_observations_are_equal_to_the_bit_and_the_command_is_not(reach, compensator):
    bare, wrapped = reach(), CompensationWrapper(reach(), compensator)
    assert wrapped.observation_space == bare.observation_space and wrapped.action_space == bare.action_space
    seen, flags, infos = run(bare)
    seen_too, flags_too, infos_too = run(wrapped)
    assert np.array_equal(seen, seen_too) and flags == flags_too
    commands, corrected = (np.array([info["joint_command"] for info in i]) for i in (infos, infos_too))
    assert np.abs(corrected - commands).max(axis=0).min() > 1e-6
    assert infos[0].keys() == infos_too[0].keys()


@pytest.mark.parametrize("plant", ["geometry_only", "qiao2026"])
def test_the_believed_end_stays_and_the_true_error_shrinks(reach, compensator, plant):
    """Design: same believed end point with and without the wrapper, smaller true error with it."""
    bare, wrapped = reach(plant=plant), CompensationWrapper(reach(plant=plant), compensator)
    ends = [(driven(bare, ScriptedReach(bare), s), driven(wrapped, ScriptedReach(wrapped), s)) for s in range(6)]
    for (seen, _), (seen_too, _) in ends:
        assert np.array_equal(seen, seen_too)
        assert np.linalg.norm(seen[12:15]) < 1e-5  # the believed tool is at the fruit
    raw, better = (np.array([pair[i][1]["position_error_mm"] for pair in ends]) for i in (0, 1))
    assert raw.mean() > 1.0
    if plant == "geometry_only":
        assert better.max() < 0.02  # what single precision of the observation leaves
    else:
        assert better.mean() < raw.mean()


def test_its_place_in_the_stack_does_not_matter(reach, compensator):
    inside = RecordEpisodeStatistics(TimeLimit(CompensationWrapper(reach().unwrapped, compensator), 60))
    outside = CompensationWrapper(RecordEpisodeStatistics(TimeLimit(reach().unwrapped, 60)), compensator)
    between = RescaleAction(CompensationWrapper(reach(), compensator), np.float32(-1), np.float32(1))
    reference = run(inside)
    for env in (outside, between):
        seen, flags, infos = run(env)
        assert np.array_equal(seen, reference[0]) and flags == reference[1]
        np.testing.assert_array_equal(
            [info["pose_error"] for info in infos], [info["pose_error"] for info in reference[2]]
        )


def test_seeds_and_resets_are_left_alone(reach, compensator):
    bare, wrapped = reach(feedback="camera", camera_noise_mm=2.0), None
    wrapped = CompensationWrapper(reach(feedback="camera", camera_noise_mm=2.0), compensator)
    for seed in (1, None, None):
        one, other = bare.reset(seed=seed)[0], wrapped.reset(seed=seed)[0]
        assert np.array_equal(one[:18], other[:18])  # the camera's own offset is the true one, and moves
        action = np.full(6, 0.3, dtype=np.float32)
        assert np.array_equal(bare.step(action)[0][:18], wrapped.step(action)[0][:18])


@pytest.mark.parametrize("mm", [None, 2.5])
@pytest.mark.parametrize("deg", [None, 0.25])
def test_at_the_end_of_an_episode_it_says_how_far_its_commands_end_from_where_they_should(reach, mm, deg):
    """Beside all else that is said there, of the command that was sent, and in no other step."""

    class Known:
        def __call__(self, joints):
            return joints + 0.001

        def within95(self, command):
            self.asked = command
            return None if mm is None else mm * 1e-3, None if deg is None else np.radians(deg)

    known = Known()
    env = CompensationWrapper(reach(), known)
    *before, last = run(env)[2]
    assert not any("within95_mm" in info or "within95_deg" in info for info in before)
    assert last.get("within95_mm") == (None if mm is None else pytest.approx(mm))
    assert last.get("within95_deg") == (None if deg is None else pytest.approx(deg))
    assert set(before[-1]) <= set(last)
    np.testing.assert_array_equal(known.asked, last["joint_command"])


def test_what_it_was_made_with_is_recorded(reach, compensator):
    env = CompensationWrapper(reach(), compensator, allow=("fitted-frames",))
    kept = env.spec.additional_wrappers[-1].kwargs
    assert set(kept) == {"compensator", "allow"} and kept["allow"] == ("fitted-frames",)


def test_closing_removes_it(reach, compensator):
    env = reach()
    before = run(env)[2][-1]["pose_error"]
    wrapped = CompensationWrapper(env, compensator)
    assert not np.array_equal(run(wrapped)[2][-1]["pose_error"], before)
    wrapped.close()
    wrapped.close()
    assert np.array_equal(run(env)[2][-1]["pose_error"], before)
    CompensationWrapper(env, compensator)  # and another may take its place


def test_wrapping_twice_is_refused_and_leaves_the_first(reach, compensator):
    env = CompensationWrapper(reach(), compensator)
    with pytest.raises(InputError, match="already has a compensator; wrap it once"):
        CompensationWrapper(env, lambda joints: joints)
    assert env.unwrapped.compensator is compensator


def test_an_environment_without_a_seam_is_refused(compensator):
    with pytest.raises(InputError, match="has no compensation seam"):
        CompensationWrapper(gym.make("CartPole-v1"), compensator)


@pytest.mark.parametrize("other", ["ideal:ur5", "ideal:panda"])
def test_a_calibration_of_another_arm_is_refused(reach, other):
    arm = pickenv.load_plant("geometry_only").arm.nominal
    lifted = replace(arm, base=displace_pose(arm.base, np.array([0.0, 0.0, 0.5, 0.1, 0.0, 0.0])))
    CompensationWrapper(reach(), Compensator(lifted, lifted))  # base and tool may be fitted
    for env, wrap in (
        (reach(plant=other), CompensationWrapper),
        (gym.make_vec("pickenv/Reach-v0", 2, plant=other), CompensationVectorWrapper),
    ):
        with pytest.raises(
            InputError, match=f"of an arm with another geometry than '{other[6:]}'; give the file that it was made with"
        ):
            wrap(env, Compensator(arm, arm))


@pytest.mark.parametrize("known", [True, False])
def test_an_arm_with_another_tool_is_another_arm_for_wrapper_and_file_alike(reach, known, tmp_path):
    """The file's own base and tool count, and those that were fitted do not."""
    plant, rng = pickenv.load_plant("geometry_only"), np.random.default_rng(0)
    rows = simulated_tracker(plant, random_joints(plant.arm.nominal, 60, rng), rng)
    calibration = fit(plant.arm, rows, known_frames=known).calibration
    calibration.save(tmp_path / "arm.npz")
    longer = displace_pose(plant.arm.nominal.tool, np.array([0.0, 0.0, 0.1, 0.0, 0.0, 0.0]))
    other = replace(plant.arm, nominal=replace(plant.arm.nominal, tool=longer))
    env = reach()
    CompensationWrapper(env, calibration.compensator(), allow=("fitted-frames",)).close()
    env.unwrapped.plant = replace(plant, arm=other)
    for refused in (
        lambda: Calibration.load(tmp_path / "arm.npz", other),
        lambda: CompensationWrapper(env, calibration.compensator(), allow=("fitted-frames",)),
    ):
        with pytest.raises(InputError, match=f"with another geometry than '{other.name}'; give the file that it was"):
            refused()


def test_a_copy_has_its_own(reach, compensator):
    env = CompensationWrapper(reach(), compensator)
    twin = copy.deepcopy(env)
    reference = run(twin)[2][-1]["pose_error"]
    env.close()
    assert np.array_equal(run(twin)[2][-1]["pose_error"], reference)


def test_ppo_trains_through_it(reach, compensator):
    from stable_baselines3 import PPO

    def train():
        env = CompensationWrapper(reach(), compensator)
        model = PPO("MlpPolicy", env, n_steps=128, batch_size=64, n_epochs=2, seed=0, device="cpu")
        before = model.policy.state_dict()["action_net.weight"].clone()
        model.learn(256)
        return before, model.policy.state_dict()["action_net.weight"]

    before, after = train()
    assert np.isfinite(after.numpy()).all() and not np.array_equal(before.numpy(), after.numpy())
    assert np.array_equal(train()[1].numpy(), after.numpy())  # twice the same


def test_readings_of_real_encoders_are_mapped_back_to_nominal_joints(reach):
    """With counts and following errors too: the policy sees the joints it asked for, not the corrected ones."""
    shift = 0.01  # rad and m; a hundred counts and more
    bare, wrapped = reach(plant="orchard"), None
    wrapped = CompensationWrapper(reach(plant="orchard"), lambda joints: joints + shift)
    counts = np.array(bare.unwrapped.plant.effect("encoder").resolution)
    assert (counts < shift / 10).all()
    task = bare.unwrapped.task
    half = (np.array(task.upper) - task.lower) / 2
    still = np.zeros(6, dtype=np.float32)
    for env, sent in ((bare, 0.0), (wrapped, shift)):
        env.reset(seed=1)
        for _ in range(30):  # until the servo has arrived
            observation, *_, info = env.step(still)
        target = env.unwrapped.joint_target
        np.testing.assert_allclose(info["joint_command"], target + sent, atol=1e-12)
        read = (observation[:6] + 1.0) * half + task.lower
        assert (np.abs(read - target) <= counts + 1e-6).all()
