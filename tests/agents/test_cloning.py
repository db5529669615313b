"""Clones: the servo demonstrates, a network learns it from pictures, the same again for a seed, whole in its file."""

import gymnasium as gym
import numpy as np
import pytest

from pickenv.agents import SIGHT, Clone, ClonedScene, ScriptedScene, ServoScene, clone, recorded_episode
from pickenv.base import InputError
from tests.drawing import where_mujoco_draws

pytest.importorskip("mujoco")
pytest.importorskip("torch")
SCENE = "pickenv/PickScene-v0"


def picked(env, policy, seeds):
    """Number of fruit that a policy takes."""
    return sum(recorded_episode(env, policy, seed)[1]["is_success"] for seed in seeds)


def demonstrated(env, seeds):
    """Observations and actions of the servo."""
    policy = ServoScene(env)
    rows = [recorded_episode(env, policy, seed)[0] for seed in seeds]
    return [(row["observations"], row["actions"]) for row in rows]


@pytest.fixture(scope="module")
def sees():
    """An exact arm whose wrist camera sees, or a skip where nothing draws."""
    env = gym.make(SCENE, plant="ideal:ur5e", max_episode_steps=120, **SIGHT)
    with where_mujoco_draws():
        env.reset(seed=0)
    yield env
    env.close()


@pytest.fixture(scope="module")
def few(sees):
    """Three demonstrations."""
    return demonstrated(sees, range(3))


@pytest.mark.parametrize(
    ("error_mm", "robot"),
    [(0.0, "ur5e"), (0.0, "panda"), (10.0, "ur5e"), pytest.param(10.0, "panda", marks=pytest.mark.slow)],
)
def test_the_servo_takes_fruit_however_the_arm_errs(robot, error_mm):
    place = {"within_mm": 60.0, "feedback": "camera", "max_episode_steps": 120}
    env = gym.make(SCENE, plant=f"coarse:{robot}", error_mm=error_mm, **place)
    assert picked(env, ServoScene(env), range(4)) == 4
    if error_mm:
        blind = gym.make(SCENE, plant=f"coarse:{robot}", error_mm=error_mm, within_mm=60.0)
        assert picked(blind, ScriptedScene(blind), range(2)) == 0


def test_the_servo_needs_a_camera():
    env = gym.make(SCENE)
    with pytest.raises(InputError, match="needs a camera; make the environment with feedback='camera'"):
        ServoScene(env).act(env.reset(seed=0)[0])


def test_observations_of_another_type_are_refused_in_one_sentence(sees, few):
    joints = {"agent_pos": few[0][0]["agent_pos"][0]}
    with pytest.raises(InputError, match="holds no picture of the wrist camera or no agent_pos; give obs_type="):
        ClonedScene(sees, clone(few, sees, seed=0, passes=1)).act(joints)
    for script in (ServoScene, ScriptedScene):
        with pytest.raises(InputError, match="observation holds no state; make the environment with obs_type"):
            script(sees).act(joints)


def test_the_same_seed_learns_the_same_and_its_file_holds_all_of_it(sees, few, tmp_path):
    first, again, other = (clone(few, sees, seed=seed, passes=2) for seed in (0, 0, 1))
    read = Clone.load(first.save(tmp_path / "mine"))
    seen = sees.reset(seed=9)[0]
    acts = [ClonedScene(sees, network).act(seen) for network in (first, again, read, other)]
    np.testing.assert_array_equal(acts[0], acts[1])
    np.testing.assert_array_equal(acts[0], acts[2])
    assert np.abs(acts[0] - acts[3]).max() > 1e-3 and sees.action_space.contains(acts[0])
    path = tmp_path / "mine.npz"
    path.write_bytes(path.read_bytes()[:-9] + b"x" + path.read_bytes()[-8:])
    with pytest.raises(InputError, match=r"mine\.npz .*clone the demonstrations anew"):
        Clone.load(path)


def test_what_cannot_be_cloned_is_refused_in_one_sentence(sees, few):
    (seen, actions), *_ = few
    with pytest.raises(InputError, match="there are no demonstrations; give one at least"):
        clone([], sees, seed=0)
    with pytest.raises(InputError, match="holds no picture of the wrist camera or no agent_pos; give obs_type="):
        clone([(seen["agent_pos"], actions)], sees, seed=0)
    views, joints = seen["pixels"]["wrist"], seen["agent_pos"]
    for pictures, numbers, moves in (
        (views, joints, actions[:, 1:]),
        (views[:, ::2], joints, actions),
        (views / 255.0, joints, actions),
        (views[:3], joints, actions),
        (views, joints[:3], actions),
        (views, joints, actions[:0]),
        (views, joints[:, 0], actions),
        (np.moveaxis(views, -1, 1), joints, actions),
    ):
        with pytest.raises(InputError, match=r"^demonstration 1 has pictures .*; give uint8 .*, and \(k, 7\) of both$"):
            clone([(seen, actions), ({"pixels": {"wrist": pictures}, "agent_pos": numbers}, moves)], sees, seed=0)
    with pytest.raises(InputError, match="demonstration 0 has numbers that are not finite; leave it out"):
        clone([(seen | {"agent_pos": joints * np.nan}, actions)], sees, seed=0)
    with pytest.raises(InputError, match="passes is 0"):
        clone(few, sees, seed=0, passes=0)
    network = clone(few, sees, seed=0, passes=1)
    for robot, how in (("panda", {}), ("ur10e", {}), ("ur5e", {"control_period_s": 0.08}), ("ur5e", {"scale": 0.5})):
        other = gym.make(SCENE, plant=f"ideal:{robot}", **how)
        with pytest.raises(InputError, match=rf"another arm, period or scale than this {robot}; clone one of this$"):
            ClonedScene(other, network)
    with pytest.raises(InputError, match="the picture has 32 px, the clone saw 64; make the environment with 64"):
        ClonedScene(sees, network).act(sees.reset(seed=0)[0] | {"pixels": {"wrist": views[0, ::2, ::2]}})


@pytest.mark.slow
def test_a_clone_takes_fruit_that_it_never_saw_by_its_picture_with_arms_that_it_never_had(sees):
    network = clone(demonstrated(sees, range(80)), sees, seed=0)
    for error_mm in (0.0, 10.0):
        place = SIGHT | {"feedback": "encoders", "max_episode_steps": 120}
        env = gym.make(SCENE, plant="coarse:ur5e", error_mm=error_mm, **place)
        assert picked(env, ClonedScene(env, network), range(1000, 1010)) >= 7
    policy, seen = ClonedScene(sees, network), sees.reset(seed=9)[0]
    act = policy.act(seen)
    np.testing.assert_array_equal(policy.act(seen | {"environment_state": np.zeros(23, np.float32)}), act)
    shifted = {"wrist": np.roll(seen["pixels"]["wrist"], 12, axis=1)}
    assert np.abs(policy.act(seen | {"pixels": shifted}) - act).max() > 0.01  # it goes by the picture
