"""The compensation seam of vector environments."""

import dataclasses
from types import SimpleNamespace

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import SyncVectorEnv, VectorWrapper

from pickenv import InputError
from pickenv.calibration import Compensator
from pickenv.wrappers import CompensationVectorWrapper, CompensationWrapper
from tests.calibration.compensation.networks import fast_network


def native(count=6, executor="numpy", **arguments):
    return gym.make_vec("pickenv/Reach-v0", num_envs=count, executor=executor, **arguments)


def taken(envs, steps=4):
    envs.reset(seed=2)
    envs.action_space.seed(1)
    return [envs.step(envs.action_space.sample()) for _ in range(steps)]


def test_observations_stay_and_the_true_error_shrinks(compensator):
    plain = taken(native(plant="geometry_only"))
    corrected = taken(CompensationVectorWrapper(native(plant="geometry_only"), compensator))
    for one, other in zip(plain, corrected, strict=True):
        np.testing.assert_array_equal(one[0], other[0])
        assert not np.array_equal(one[4]["joint_command"], other[4]["joint_command"])
    goal = {"goal_joints": [0.1, 0.2, 0.3, 0.2, 0.1, 0.3], "start_joints": [0.1, 0.2, 0.3, 0.2, 0.1, 0.3]}
    errors = [
        env.reset(seed=0, options=goal)[1]["position_error_mm"]
        for env in (
            native(plant="geometry_only"),
            CompensationVectorWrapper(native(plant="geometry_only"), compensator),
        )
    ]
    assert np.all(errors[0] > 0.5) and np.all(errors[1] < 1e-3)


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
@pytest.mark.parametrize("learnt", [False, True], ids=["geometry", "geometry and network"])
def test_native_and_synchronous_agree(compensator, mode, learnt):
    compensator = dataclasses.replace(compensator, residual=fast_network(6).predict if learnt else None)

    def single():
        return gym.make("pickenv/Reach-v0", max_episode_steps=3, executor="numpy", disable_env_checker=True)

    sync = SyncVectorEnv([single] * 3, autoreset_mode=gym.vector.AutoresetMode(mode))
    one = taken(CompensationVectorWrapper(sync, compensator), 7)
    other = taken(CompensationVectorWrapper(native(3, max_episode_steps=3, autoreset_mode=mode), compensator), 7)
    for a, b in zip(one, other, strict=True):
        np.testing.assert_array_equal(a[0], b[0])
        np.testing.assert_array_equal(a[4]["pose_error"], b[4]["pose_error"])


@pytest.mark.parametrize("plant", ["qiao2026", "ideal:ur5e"])
def test_the_compiled_step_with_a_compensator_is_numpys_up_to_roundings(plant):
    pytest.importorskip("llvmlite")
    g = native(1, plant=plant).unwrapped.task.plant.arm.nominal
    plain = Compensator(g, dataclasses.replace(g, a=g.a + 2e-4, theta=g.theta + 1e-3), fast_network(g.joints).predict)
    one, other = (
        taken(CompensationVectorWrapper(native(7, plant=plant, executor=executor), plain))
        for executor in ("numpy", "compiled")
    )
    for a, b in zip(one, other, strict=True):
        np.testing.assert_allclose(a[0], b[0], rtol=2e-7, atol=2e-7)
        np.testing.assert_allclose(a[4]["pose_error"], b[4]["pose_error"], rtol=0, atol=1e-12)


def test_torch_is_compensated_too(compensator):
    pytest.importorskip("torch")
    one = taken(CompensationVectorWrapper(native(), compensator))
    other = taken(CompensationVectorWrapper(native(executor="torch", compiled=False), compensator))
    np.testing.assert_allclose(one[-1][4]["pose_error"], other[-1][4]["pose_error"].numpy(), rtol=0, atol=1e-9)


@pytest.mark.parametrize(
    ("name", "executor"), [("Reach", "numpy"), ("Reach", "compiled"), ("Reach", "torch"), ("Pick", "numpy")]
)
def test_each_environment_may_have_a_compensator_of_its_own(compensator, name, executor):
    """Each goes as it would among environments that all have its compensator, from start to start."""
    options = {"max_episode_steps": 3}
    if name == "Reach":
        pytest.importorskip({"compiled": "llvmlite"}.get(executor, executor))
        options |= {"executor": executor, "autoreset_mode": "SameStep"}
        options |= {"compiled": False} if executor == "torch" else {}
    turned = dataclasses.replace(compensator, identified=compensator.nominal)
    pair = (compensator, turned)

    def run(compensators):
        envs = gym.make_vec(f"pickenv/{name}-v0", num_envs=4, **options).unwrapped
        envs.compensator = compensators
        return [np.asarray(step[4]["joint_command"]) for step in taken(envs, 5)]

    own = run([pair[row] for row in (1, 0, 0, 1)])
    for number, together in enumerate(map(run, pair)):
        rows = [row for row in range(4) if (1, 0, 0, 1)[row] == number]
        for one, other in zip(own, together, strict=True):
            np.testing.assert_allclose(one[rows], other[rows], rtol=0, atol=1e-12)
    assert not np.allclose(own[-1][0], run(compensator)[-1][0], atol=1e-9)


@pytest.mark.parametrize("count", [2, 5])
def test_as_many_compensators_as_environments_or_one(count):
    with pytest.raises(InputError, match=f"{count} compensators for 3 environments; give one, or one for each"):
        native(3).unwrapped.compensator = [lambda joints: joints] * count
    harvesters = gym.make_vec("pickenv/Harvest-v0", num_envs=2)
    harvesters.unwrapped.compensator = [lambda joints: joints] * 2
    harvesters.reset(seed=0)
    with pytest.raises(InputError, match="each harvester has several arms; give one compensator for all"):
        harvesters.step(harvesters.action_space.sample())


def test_it_is_installed_once_and_removed_on_closing(compensator):
    envs = native()
    wrapped = CompensationVectorWrapper(envs, compensator)
    with pytest.raises(InputError, match="wrap it once"):
        CompensationVectorWrapper(envs, compensator)
    wrapped.close()
    assert envs.unwrapped.compensator is None
    with pytest.raises(InputError, match="no compensation seam"):
        CompensationVectorWrapper(gym.make_vec("CartPole-v1", num_envs=1), compensator)
    with pytest.raises(InputError, match="set the attribute compensator of the environments"):
        CompensationVectorWrapper(native(), [compensator] * 6)


class Sure:
    """A compensator that changes nothing and knows how far reaches end: by the size of their commands."""

    def __call__(self, joints):
        return joints

    def within95(self, commands):
        assert commands.ndim <= 2
        return 1e-3 * np.abs(commands).sum(axis=-1), np.radians(np.abs(commands).max(axis=-1))


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
@pytest.mark.parametrize("executor", ["numpy", "torch"])
def test_ended_episodes_say_how_far_such_commands_end_as_single_ones_do(mode, executor):
    options = {"plant": "geometry_only", "max_episode_steps": 3, "autoreset_mode": mode, "executor": executor}
    if executor == "torch":
        pytest.importorskip("torch")
        options["compiled"] = False
    envs = CompensationVectorWrapper(native(3, **options), Sure())
    said = 0
    for *_, terminations, truncations, infos in taken(envs, 8):
        ended = np.asarray(terminations) | np.asarray(truncations)
        last = infos.get("final_info", infos)
        assert ("within95_mm" in last) == ended.any()
        if ended.any():
            said += 1
            command = np.asarray(last["joint_command"])
            np.testing.assert_array_equal(last["_within95_mm"], ended)
            assert last["_within95_mm"].dtype == last["_within95_deg"].dtype == bool
            np.testing.assert_allclose(last["within95_mm"][ended], np.abs(command).sum(axis=1)[ended])
            np.testing.assert_allclose(last["within95_deg"][ended], np.abs(command).max(axis=1)[ended])
    assert said >= 2
    single = CompensationWrapper(gym.make("pickenv/Reach-v0", plant="geometry_only", max_episode_steps=3), Sure())
    single.reset(seed=2)
    infos = [single.step(single.action_space.sample())[-1] for _ in range(3)]
    assert ["within95_mm" in info for info in infos] == [False, False, True]
    assert infos[-1]["within95_mm"] == pytest.approx(np.abs(infos[-1]["joint_command"]).sum())


def test_who_does_not_know_how_far_reaches_end_says_nothing_of_it():
    envs = CompensationVectorWrapper(native(2, plant="geometry_only", max_episode_steps=2), lambda joints: joints)
    single = CompensationWrapper(gym.make("pickenv/Reach-v0", plant="geometry_only", max_episode_steps=2), lambda q: q)
    single.reset(seed=0)
    alone = [single.step(single.action_space.sample()) for _ in range(2)]
    for *_, truncated, info in (taken(envs, 2)[-1], alone[-1]):
        assert np.all(truncated) and "joint_command" in info
        assert not any("within95" in key for key in info)


def test_what_vector_wrappers_were_made_with_is_recorded(compensator):
    envs = CompensationVectorWrapper(native(2), compensator, allow=("fitted-frames",))
    assert set(envs._saved_kwargs) == {"compensator", "allow"} and envs._saved_kwargs["allow"] == ("fitted-frames",)


def test_what_lies_on_a_device_is_fetched_from_it():
    class OnDevice(VectorWrapper):
        """Flags and commands that NumPy cannot read before they are fetched."""

        def step(self, actions):
            *seen, terminations, truncations, infos = self.env.step(actions)
            infos["joint_command"] = SimpleNamespace(cpu=lambda values=infos["joint_command"]: values)
            flags = (SimpleNamespace(cpu=lambda values=values: values) for values in (terminations, truncations))
            return *seen, *flags, infos

    envs = CompensationVectorWrapper(OnDevice(native(2, plant="geometry_only", max_episode_steps=1)), Sure())
    *_, infos = taken(envs, 1)[-1]
    np.testing.assert_allclose(infos["within95_mm"], np.abs(infos["joint_command"].cpu()).sum(axis=1))
