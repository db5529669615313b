"""Picking canopy after canopy with one unknown arm: what the gripper feels, the hours of a day, and what is learnt."""

import gymnasium as gym
import numpy as np
import pytest

from pickenv.agents import AdaptiveReach, FeelingPick, RememberingReach, ScriptedPick, load_remembering, pick_canopies
from pickenv.arm import forward
from pickenv.base import InputError
from pickenv.envs import PickVectorEnv
from pickenv.wrappers import ManyCanopies, ToolStepping

FELT = slice(23, 26)


def picking(**given) -> gym.Env:
    return gym.make("pickenv/Pick-v0", **{"feedback": "gripper", "arms": "per_episode"} | given)


def picked(env: gym.Env, policy, most: int = 400, **how):
    """Observations and infos of an episode, from the reset on."""
    policy.reset()
    observation, info = env.reset(**how)
    moments = [(observation, info)]
    for _ in range(most):
        observation, _, over, cut, info = env.step(policy.act(observation))
        moments.append((observation, info))
        if over or cut:
            break
    return moments


def test_a_gripper_without_noise_feels_what_the_grasp_was_off_by_and_an_empty_one_nothing() -> None:
    env = picking(grip_noise_mm=0.0)
    moments = picked(env, ScriptedPick(env), 140, seed=4)
    held = [moment for moment in moments if moment[0][20] + moment[0][21] > 0.5]
    assert len({info["attached"] for _, info in held}) > 2
    for seen, info in held:
        off = np.hypot(info["grasp_lateral_mm"], info["grasp_axial_mm"])
        assert np.linalg.norm(seen[FELT]) * 1e3 == pytest.approx(off, abs=1e-4)
    assert not any(seen[FELT].any() for seen, _ in moments if seen[20] + seen[21] < 0.5)


def test_what_the_gripper_feels_has_the_noise_that_is_given_on_every_axis() -> None:
    """The same arms, fruit and luck with and without noise, but for draws after the fruit."""
    felt = {}
    for noise in (0.0, 2.0):
        envs = PickVectorEnv(30, plant="ideal", vision="ideal", feedback="gripper", grip_noise_mm=noise)
        policy, rows = ScriptedPick(envs), []
        seen, _ = envs.reset(seed=1)
        for _ in range(60):
            before = seen[:, 20] > 0.5
            seen, *_ = envs.step(policy.act(seen))
            rows.extend(seen[(seen[:, 20] > 0.5) & ~before, FELT])
        felt[noise] = 1e3 * np.array(rows)
    assert len(felt[2.0]) > 60 and len(felt[0.0]) == len(felt[2.0])
    np.testing.assert_allclose((felt[2.0] - felt[0.0]).std(axis=0), 2.0, rtol=0.25)


def test_the_feeling_gripper_changes_nothing_else() -> None:
    plain, feeling = (gym.make("pickenv/Pick-v0", feedback=kind) for kind in ("encoders", "gripper"))
    policy = ScriptedPick(plain)
    one, two = plain.reset(seed=2)[0], feeling.reset(seed=2)[0]
    for _ in range(120):
        np.testing.assert_array_equal(one, two[:23])
        action = policy.act(one)
        one, two = plain.step(action)[0], feeling.step(action)[0]


@pytest.mark.parametrize("hours", [0.0, 3.0])
def test_the_option_hours_is_the_argument_hours_on_for_one_episode(hours: float) -> None:
    made, asked = picking(hours_on=hours), picking()
    envs = PickVectorEnv(2, feedback="gripper", arms="per_episode")
    places = [
        env.reset(seed=1, options={"arm": 3, "start_joints": made.unwrapped.joint_target, **options})[1][
            "tool_position"
        ]
        for env, options in ((made, {}), (asked, {"hours": hours}), (asked, {}))
    ]
    np.testing.assert_array_equal(places[0], places[1])
    assert (np.abs(places[1] - places[2]).max() > 1e-5) == (hours > 0)
    each = envs.reset(seed=1, options={"arm": 3, "hours": [hours, 7.0]})[1]["tool_position"]
    np.testing.assert_allclose(each[0], places[0], atol=1e-9)
    assert np.abs(each[1] - each[0]).max() > 1e-5


@pytest.mark.parametrize("hours", [-0.1, 1001.0, float("nan"), [1.0, 2.0], "noon"])
def test_impossible_hours_are_refused(hours) -> None:
    with pytest.raises(InputError, match="option hours"):
        picking().reset(seed=0, options={"hours": hours})


def test_a_run_is_one_arm_through_the_day_and_its_canopies_add_up(monkeypatch) -> None:
    env = picking(fruit=4.0)
    inner, begun, counts = env.unwrapped, [], [0]
    reset, step = inner.reset, inner.step

    def noted_reset(*, seed=None, options=None):
        begun.append(options)
        counts.append(0)
        return reset(seed=seed, options=options)

    def noted_step(action):
        result = step(action)
        counts[-1] = result[4]["attempted"]
        return result

    monkeypatch.setattr(inner, "reset", noted_reset)
    monkeypatch.setattr(inner, "step", noted_step)
    run = ManyCanopies(env, canopies=3, hours=(1.0, 5.0))
    policy = ScriptedPick(run)
    seen, info = run.reset(seed=3)
    arm, rewards, steps, cut = info["arm"], 0.0, 0, False
    while not cut:
        seen, reward, over, cut, info = run.step(policy.act(seen))
        rewards, steps = rewards + reward, steps + 1
        assert not over and info["arm"] == arm and run.observation_space.contains(seen)
        assert info["run_attempted"] == sum(counts)
    assert info["canopy"] == 3 and [options["hours"] for options in begun] == [1.0, 3.0, 5.0]
    assert all(options["arm"] == arm for options in begun[1:])
    assert rewards == pytest.approx(info["run_collected"] - 0.002 * steps)  # this policy damages no fruit
    assert len({run.reset()[1]["arm"] for _ in range(4)}) > 1


def test_a_bruise_that_no_arm_can_measure_costs_nothing_unless_the_reward_is_the_true_one() -> None:
    rewards = {}
    for kind in ("measured", "true"):
        run = ManyCanopies(picking(arms="fixed"), canopies=1, reward=kind)
        hasty = ScriptedPick(run, settle=0.0, tool_speed=np.inf)
        seen, _ = run.reset(seed=6)
        total, cut, damaged = 0.0, False, 0
        while not cut:
            seen, reward, _, cut, info = run.step(hasty.act(seen))
            total, damaged = total + reward, info["damaged"]
        rewards[kind] = total
    assert damaged > 0 and rewards["measured"] > rewards["true"] + 0.2


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: ManyCanopies(gym.make("pickenv/Reach-v0")), "wrap a pickenv/Pick-v0"),
        (lambda: ManyCanopies(picking(), canopies=0), "canopies"),
        (lambda: ManyCanopies(picking(), hours=(0.0, -1.0)), "option hours"),
        (lambda: ManyCanopies(picking(), reward="guess"), "reward"),
        (lambda: picking(feedback="smell"), "feedback"),
        (lambda: ToolStepping(picking()), "what the gripper feels"),
        (lambda: picking(grip_noise_mm=-1.0), "grip_noise_mm"),
        (lambda: FeelingPick(env := gym.make("pickenv/Pick-v0"), AdaptiveReach(env)), "feedback='gripper'"),
    ],
)
def test_what_cannot_be_is_refused(make, said: str) -> None:
    with pytest.raises(InputError, match=said):
        make()


class Notes:
    """A memory that corrects nothing and notes what it is taught."""

    def __init__(self) -> None:
        self.taught = []

    def meet(self, arms: int) -> None:
        self.arms = arms

    def corrected(self, rows, joints):
        return joints

    def learn(self, rows, joints, seen, looks) -> None:
        self.taught.append((joints, seen))


def test_each_fruit_that_the_gripper_took_is_learnt_from_once_and_none_that_it_missed() -> None:
    """Where camera and gripper have no noise, what is taught is where the true tool stood."""
    env, notes = picking(grip_noise_mm=0.0, vision="ideal"), Notes()
    policy = FeelingPick(env, notes)
    moments = picked(env, policy, seed=4, options={"arm": 1})
    assert moments[-1][1]["attempted"] >= moments[-1][1]["attached"] == len(notes.taught) > 2
    stood = [info["tool_position"] for seen, info in moments if seen[20] > 0.5]
    for (joints, seen), tool in zip(notes.taught, stood[: len(notes.taught)], strict=False):
        assert np.linalg.norm(seen[0] - tool) < 5e-3  # swing and stem, not the whole arm's error
        assert np.linalg.norm(forward(policy.geometry, joints[0]).position - seen[0]) < 0.03
    assert np.linalg.norm(notes.taught[0][1][0] - stood[0]) < 1e-6


LATER = [pytest.param(name, marks=pytest.mark.slow) for name in ("history_camera", "recurrent_camera")]


@pytest.mark.parametrize("name", ["filter", *LATER])
def test_who_remembers_is_nearer_to_the_fruit_of_later_canopies(name: str) -> None:
    errors = []
    envs = PickVectorEnv(3, arms="per_episode", tolerances="coarse", vision="ideal", feedback="gripper", fruit=5.0)
    memory = AdaptiveReach(envs) if name == "filter" else RememberingReach(envs, load_remembering(name))
    feeling, canopies = FeelingPick(envs, memory), [range(3 * k, 3 * k + 3) for k in range(2)]
    for policy, seeds in (*((feeling, seeds) for seeds in canopies), (ScriptedPick(envs), canopies[-1])):
        run = pick_canopies(policy, envs, seeds, {"arm": np.arange(3)})
        errors.append(run["error_sum_mm"].sum() / run["attempted"].sum())
    assert errors[-2] < 0.75 * errors[-1]


def test_an_arm_learns_the_same_alone_and_beside_others() -> None:
    envs = PickVectorEnv(2, feedback="gripper", arms="per_episode")
    env = picking(executor="numpy")
    together, alone = FeelingPick(envs, AdaptiveReach(envs)), FeelingPick(env, AdaptiveReach(env))
    for canopy in range(2):
        seen, one = (
            envs.reset(seed=9 + canopy, options={"arm": 2})[0],
            env.reset(seed=9 + canopy, options={"arm": 2})[0],
        )
        together.reset(), alone.reset()
        for _ in range(60):
            actions, action = together.act(seen), alone.act(one)
            np.testing.assert_allclose(actions[0], action, atol=1e-6)
            seen, one = envs.step(np.stack([action, actions[1]]))[0], env.step(action)[0]
            np.testing.assert_array_equal(seen[0], one)
