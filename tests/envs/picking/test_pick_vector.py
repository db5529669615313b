"""Many picking arms at once give what each gives alone, to the bit, whatever the arguments and the autoreset mode."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from stable_baselines3.common.env_checker import check_env as check_env_for_sb3

from pickenv.base import InputError
from pickenv.envs import PickVectorEnv
from pickenv.wrappers import ToolStepping, ToolSteppingVector
from tests.envs.same import assert_same

ABOVE = np.array([[[0.6, -0.767, 0.549]], [[0.62, -0.78, 0.57]], [[0.6, -0.77, 0.6]]])
"""A fruit near each tool, so that episodes with one of them end after some fifteen steps, at different times."""
LONGEST = 16
VARIANTS = {
    "plain": {"camera": "perfect", "gripper": "compliant_hand"},
    "arm per episode": {"arms": "per_episode", "population": 8, "without": ["backlash"]},
    "arm per environment, clumps": {"arms": "per_env", "fruit_map": "v_trellis", "fruit": 25.0, "looks": 4},
    "late, noisy and warm, from anywhere": {
        "control_period_s": 0.05,
        "latency": 2,
        "action_delay": 1,
        "joint_noise": 0.3,
        "hours_on": 2.0,
        "start_spread": 0.4,
    },
    "the same, drawn": {
        "arms": "per_episode",
        "control_period_s": [0.05, 0.2],
        "latency": [0, 3],
        "action_delay": [1, 2],
        "joint_noise": [0.0, 0.5],
        "hours_on": [0.0, 8.0],
        "start_spread": 0.5,
    },
    "own eyes": {"difficulty": "own_eyes", "split": "test", "feedback": "gripper"},
    "ideal": {"plant": "ideal", "vision": "ideal", "fruit_size": "apple", "out_of_range": "refuse"},
}
CASES = list(zip(list(VARIANTS)[2:5], AutoresetMode, strict=True))
MODES = list(AutoresetMode)
REST = [(name, MODES[(i + turn) % 3]) for turn in (0, 1) for i, name in enumerate(VARIANTS)]  # two of each one's three
REST = [case for case in REST if case not in CASES]


def towards(raw):
    """Straight to each fruit, a grasp there, a twist, and down."""
    far, hanging, off = np.linalg.norm(raw[:, 12:15], axis=1), raw[:, 20] > 0.5, raw[:, 21] > 0.5
    zero = np.zeros(len(raw))
    return np.column_stack([zero, np.where(off, -1.0, zero), np.where((far < 1e-3) | hanging, 1.0, 0.0)])


@pytest.mark.parametrize(("name", "mode"), [*CASES, *(pytest.param(*case, marks=pytest.mark.slow) for case in REST)])
def test_native_single_and_synchronous_are_equal_to_the_bit_when_episodes_end_at_different_times(name, mode):
    given, count = {"max_episode_steps": LONGEST, **VARIANTS[name]}, len(ABOVE)

    def alone():
        return gym.make("pickenv/Pick-v0", disable_env_checker=True, executor="numpy", **given)

    sync = SyncVectorEnv([alone] * count, autoreset_mode=mode)
    native = gym.make_vec("pickenv/Pick-v0", count, autoreset_mode=mode, **given)
    plain = {key: value for key, value in given.items() if key != "feedback"}
    steps = ToolSteppingVector(gym.make_vec("pickenv/Pick-v0", count, autoreset_mode=mode, **plain))
    singles, rng = {i: alone() for i in range(count)}, np.random.default_rng(0)
    for one, other in zip(sync.reset(seed=11), native.reset(seed=11), strict=True):
        assert_same(one, other)
    for i, env in singles.items():
        env.reset(seed=11 + i)
    options = {"fruit": ABOVE[0]}
    seen = native.reset(options=options)[0]
    assert_same(sync.reset(options=options)[0], seen)
    assert_same(np.array([env.reset(options=options)[0] for env in singles.values()]), seen)
    ended, ends = np.zeros(count, bool), set()
    for step in range(LONGEST + 10):
        mask = np.arange(count) == step - 4  # two of them begin anew, one after the other
        mask |= ended & (mode is AutoresetMode.DISABLED)
        if (mask.any() and step < 6) or (mode is AutoresetMode.DISABLED and ended.any()):
            both = (env.reset(options={"reset_mask": mask.copy()}) for env in (sync, native))
            for one, other in zip(*both, strict=True):
                assert_same(one, other)
            seen = native._observation()
        faster = np.linspace(0.0, 0.3, count)[:, None] * [1.0, 0.0, 0.0]
        actions = steps.scaling.act(seen[:, :23], towards(seen) + faster + rng.normal(0.0, 0.02, (count, 3)))
        actions = actions.clip(-1.0, 1.0)
        found = sync.step(actions), native.step(actions)
        for one, other in zip(*found, strict=True):
            assert_same(one, other, f"step {step}")
        seen, ended = found[1][0], found[1][2] | found[1][3]
        for i, env in list(singles.items()) if step < 4 else ():
            observation, reward, *_ = env.step(actions[i])
            last = ended[i] and mode is AutoresetMode.SAME_STEP
            np.testing.assert_array_equal(observation, found[1][4]["final_obs"][i] if last else seen[i])
            assert reward == found[1][1][i]
            if ended[i]:
                del singles[i]
        ends |= {step for _ in range(ended.sum())}
    assert len(ends) > 1


def test_an_environment_does_not_depend_on_its_neighbours():
    few, many = (PickVectorEnv(count, difficulty="orchard") for count in (1, 20))
    one, other = few.reset(seed=5), many.reset(seed=5)
    np.testing.assert_array_equal(one[0], other[0][:1])
    many.action_space.seed(0)
    for _ in range(4):
        actions = many.action_space.sample()
        one, other = few.step(actions[:1]), many.step(actions)
        np.testing.assert_array_equal(one[0], other[0][:1])
        np.testing.assert_array_equal(one[4]["tool_position"], other[4]["tool_position"][:1])


def test_canopies_that_were_drawn_ahead_are_forgotten_where_something_else_is_asked_for():
    envs, single = PickVectorEnv(2, arms="per_episode"), gym.make("pickenv/Pick-v0", arms="per_episode").unwrapped
    envs.reset(seed=3), single.reset(seed=4)
    envs.reset(options={"reset_mask": np.array([True, False])})  # draws the next canopy of the second, too
    fruit = {"fruit": ABOVE, "arm": 7}
    with pytest.raises(InputError, match="option fruit was given 3 times; give it once, or 2 times"):
        envs.reset(options=fruit)
    mask = {"reset_mask": np.array([False, True])}
    for options in ({"fruit": ABOVE[1], "arm": 7}, {}):
        _, infos = envs.reset(options=options | mask)
        _, info = single.reset(options=options)
        assert infos["present"].tolist() == [0, info["present"]]
        np.testing.assert_array_equal(infos["fruit_position"][1], info["fruit_position"])
        assert envs.batch.arm[1] == single.arm


def test_a_mask_leaves_seeds_alone_that_it_leaves_out():
    envs, other = (PickVectorEnv(2, plant="ideal") for _ in range(2))
    envs.reset(seed=1), other.reset(seed=1)
    envs.reset(seed=[8, 9], options={"reset_mask": np.array([True, False])})
    np.testing.assert_array_equal(envs.reset()[0][1], other.reset()[0][1])


def test_starts_and_fruit_are_given_once_or_for_each():
    envs = PickVectorEnv(3, plant="ideal", camera="perfect")
    joints = np.add(envs.task.middle, [[0.0] * 6, [0.01] * 6, [0.02] * 6])
    _, infos = envs.reset(seed=0, options={"fruit": ABOVE, "start_joints": joints})
    np.testing.assert_array_equal(infos["fruit_position"], ABOVE[:, 0])
    np.testing.assert_array_equal(infos["joint_command"], joints)


def test_a_state_goes_on_where_it_was_taken():
    one, other = (PickVectorEnv(3, arms="per_episode", latency=1, autoreset_mode="SameStep") for _ in range(2))
    one.reset(seed=0), one.reset(options={"fruit": ABOVE}), other.reset(seed=9)
    rng = np.random.default_rng(0)

    def act(envs, steps):
        for _ in range(steps):
            actions = rng.uniform(-0.2, 0.2, (3, 7))
            actions[:, 6] = 1.0
            out = envs.step(actions)
        return out

    act(one, 6)
    other.take_state_arrays(one.state_arrays())
    rng = np.random.default_rng(1)
    first = act(one, 12)
    rng = np.random.default_rng(1)
    for mine, its in zip(first, act(other, 12), strict=True):
        assert_same(mine, its)
    for mine, its in zip(one.reset(), other.reset(), strict=True):
        assert_same(mine, its)


def test_steps_of_the_tool_keep_it_upright_and_bring_it_where_they_say():
    envs = ToolSteppingVector(gym.make_vec("pickenv/Pick-v0", 3, plant="ideal", camera="perfect"))
    envs.reset(seed=0, options={"fruit": np.add(ABOVE, [0.0, 0.0, 0.05])})
    for _ in range(40):
        _, _, _, _, infos = envs.step(np.zeros((3, 3)))
    assert infos["position_error_mm"].max() < 0.3 and infos["tilt_deg"].max() < 0.5
    assert envs.raw[:, 18].min() > 0.0  # it stands still


@pytest.mark.parametrize("mode", list(AutoresetMode), ids=str)
def test_steps_of_the_tool_are_the_same_alone_and_shaping_adds_up_to_nothing(mode):
    """Rewards of an episode sum to those without shaping, less the potential at its beginning."""
    given = {"plant": "ideal", "camera": "perfect", "max_episode_steps": 30}
    envs = ToolSteppingVector(gym.make_vec("pickenv/Pick-v0", 2, autoreset_mode=mode, **given), shaping=1.0)
    alone = ToolStepping(gym.make("pickenv/Pick-v0", executor="numpy", **given), shaping=1.0)
    plain = ToolStepping(gym.make("pickenv/Pick-v0", executor="numpy", **given))
    options = {"fruit": ABOVE[1]}
    seen = envs.reset(seed=4, options=options)[0]
    assert seen.dtype == np.float32 and envs.observation_space.contains(seen)
    np.testing.assert_array_equal(seen[1], alone.reset(seed=5, options=options)[0])
    plain.reset(seed=5, options=options)
    begin, sums = alone.scaling.potential(alone.raw), np.zeros(2)
    for _ in range(30):
        action = towards(envs.raw).astype(np.float32)
        observation, reward, terminated, truncated, _ = alone.step(action[1])
        _, bare, *_ = plain.step(action[1])
        found = envs.step(action)
        assert found[1][1] == pytest.approx(reward, abs=1e-12)
        sums += reward, bare
        if terminated or truncated:
            break
        np.testing.assert_array_equal(found[0][1], observation)
    assert terminated and not alone.unwrapped.scene.waiting.any()
    assert sums[0] == pytest.approx(sums[1] - begin)
    if mode is AutoresetMode.NEXT_STEP:
        assert envs.step(action)[1][1] == 0.0


def test_the_tool_wrapper_keeps_the_rules_and_says_what_it_cannot_wrap():
    check_env_for_sb3(ToolStepping(gym.make("pickenv/Pick-v0", plant="ideal")))
    with pytest.raises(InputError, match="wrap a pickenv/Pick-v0"):
        ToolStepping(gym.make("pickenv/Reach-v0"))
    with pytest.raises(InputError, match="shaping is 2"):
        ToolStepping(gym.make("pickenv/Pick-v0"), shaping=2.0)
    for out_of_range, action in (("refuse", [2.0, 0.0, 0.0]), ("clip", [np.nan, 0.0, 0.0])):
        env = ToolStepping(gym.make("pickenv/Pick-v0", out_of_range=out_of_range))
        env.reset(seed=0)
        with pytest.raises(InputError, match="finite numbers"):
            env.step(np.array(action))


def test_a_masked_reset_shapes_no_step_that_only_begins_an_episode():
    made = gym.make_vec("pickenv/Pick-v0", 2, plant="ideal", camera="perfect", max_episode_steps=2)
    envs = ToolSteppingVector(made, shaping=1.0)
    envs.reset(seed=0)
    envs.step(np.zeros((2, 3)))
    envs.step(np.zeros((2, 3)))
    envs.reset(options={"reset_mask": np.array([True, False])})
    assert envs.step(np.zeros((2, 3)))[1][1] == 0.0


def test_the_number_of_an_arm_is_whole():
    with pytest.raises(InputError, match=r"arm is 0\.9"):
        PickVectorEnv(2, arms="per_episode", population=8).reset(seed=0, options={"arm": [0.9, 1.9]})
