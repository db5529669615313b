"""Native vector environments: equal to single ones, whatever their number, mode and executor."""

import copy
import itertools
import pickle
import subprocess
import sys

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv

import pickenv
from pickenv import InputError
from pickenv.envs import ReachGoalVectorEnv, ReachVectorEnv
from tests.envs.same import assert_same

EARLY = {"end_on_success": True, "tolerance_mm": 400.0, "angle_tolerance_deg": 100.0}
"""A capture region so large that random actions end episodes at different times."""
VARIANTS = {
    "plain": {},
    "camera, arm per episode": {"feedback": "camera", "camera_noise_mm": 3.0, "arms": "per_episode"},
    "orchard, arm per environment": {"plant": "orchard", "arms": "per_env"},
    "field, arm per episode": {"plant": "field", "arms": "per_episode"},
    "late, noisy and warm, from anywhere": {
        "plant": "orchard",
        "feedback": "camera",
        "control_period_s": 0.05,
        "latency": 2,
        "action_delay": 1,
        "joint_noise": 0.3,
        "hours_on": 2.0,
        "start_spread": 0.4,
        "goal_region": [[-0.6, -1.2, 0.2], [0.6, 1.2, 1.4]],
    },
    "the same, drawn": {
        "plant": "orchard",
        "arms": "per_episode",
        "control_period_s": [0.05, 0.2],
        "latency": [0, 3],
        "action_delay": [1, 2],
        "joint_noise": [0.0, 0.5],
        "hours_on": [0.0, 8.0],
        "start_spread": 0.9,
    },
}
SINGLE = {"field, arm per episode": 1e-6}
"""Waves of a field are single precision in NumPy and double in torch: they agree to a nanometre (in mm here)."""
ROUNDED = 1e-12
"""How far apart a compiled step may be from NumPy's."""
STEPS = 9
MODES = list(AutoresetMode)
QUICK = [("Reach", 3, MODES[i % 3], variant) for i, variant in enumerate(VARIANTS)]
SIZES = (("Reach", 3), ("Reach", 1), ("Reach", 7), ("ReachGoal", 2))
REST = [case for size in SIZES for mode in MODES for name in VARIANTS if (case := (*size, mode, name)) not in QUICK]


def native(count, name="Reach", executor="numpy", **arguments):
    return gym.make_vec(f"pickenv/{name}-v0", num_envs=count, executor=executor, **arguments)


def synchronous(count, mode, name="Reach", max_episode_steps=STEPS, **arguments):
    def single():
        # The checker warns of what other tests check.
        return gym.make(
            f"pickenv/{name}-v0",
            max_episode_steps=max_episode_steps,
            disable_env_checker=True,
            executor="numpy",
            **arguments,
        )

    return SyncVectorEnv([single] * count, autoreset_mode=mode)


@pytest.mark.parametrize(
    ("name", "count", "mode", "variant"), [*QUICK, *(pytest.param(*case, marks=pytest.mark.slow) for case in REST)]
)
def test_native_and_synchronous_are_equal_to_the_bit_when_episodes_end_at_different_times(name, count, mode, variant):
    arguments = EARLY | VARIANTS[variant]
    sync = synchronous(count, mode, name, **arguments)
    envs = native(count, name, max_episode_steps=STEPS, autoreset_mode=mode, **arguments)
    for one, other in zip(sync.reset(seed=11), envs.reset(seed=11), strict=True):
        assert_same(one, other)
    envs.action_space.seed(0)
    rng, ended, ends = np.random.default_rng(0), np.zeros(count, bool), []
    for step in range(25):
        if mode is AutoresetMode.DISABLED and ended.any():
            mask = ended | (rng.random(count) < 0.2)
            both = (env.reset(options={"reset_mask": mask.copy()}) for env in (sync, envs))
            for one, other in zip(*both, strict=True):
                assert_same(one, other)
        actions = envs.action_space.sample()
        taken = [env.step(actions) for env in (sync, envs)]
        for one, other in zip(*taken, strict=True):
            assert_same(one, other)
        ended = taken[1][2] | taken[1][3]
        ends += [step] * ended.sum()
    assert len(set(ends)) > 1


@pytest.mark.parametrize(
    "variant",
    [pytest.param(name, marks=pytest.mark.slow) if name.startswith("orchard, ") else name for name in VARIANTS],
)
def test_the_compiled_step_is_numpys_up_to_roundings(variant):
    pytest.importorskip("llvmlite")
    arguments = EARLY | VARIANTS[variant] | {"max_episode_steps": STEPS}
    for name, count in (("Reach", 70), ("ReachGoal", 5)):
        one, other = (native(count, name, executor=executor, **arguments) for executor in ("numpy", "compiled"))
        assert type(one.unwrapped.batch) is not type(other.unwrapped.batch)
        for a, b in zip(one.reset(seed=8), other.reset(seed=8), strict=True):
            assert_same(a, b)
        one.action_space.seed(0)
        for _ in range(12):
            actions = one.action_space.sample()
            for a, b in zip(one.step(actions), other.step(actions), strict=True):
                assert_same(a, b, apart=ROUNDED)


@pytest.mark.parametrize("plant", ["ideal:ur5e", "coarse:panda", "geometry_only", "so101"])
def test_every_arm_is_compiled_up_to_roundings(plant):
    pytest.importorskip("llvmlite")
    one, other = (native(5, plant=plant, reward="sparse", executor=executor) for executor in ("numpy", "compiled"))
    one.reset(seed=1), other.reset(seed=1)
    actions = one.action_space.sample()
    for a, b in zip(one.step(actions), other.step(actions), strict=True):
        assert_same(a, b, apart=ROUNDED)


def test_sixty_four_environments_are_as_equal_as_seven():
    sync, envs = synchronous(64, AutoresetMode.SAME_STEP, **EARLY), native(64, autoreset_mode="SameStep", **EARLY)
    for one, other in zip(sync.reset(seed=3), envs.reset(seed=3), strict=True):
        assert_same(one, other)
    envs.action_space.seed(0)
    for _ in range(3):
        actions = envs.action_space.sample()
        for one, other in zip(sync.step(actions), envs.step(actions), strict=True):
            assert_same(one, other)


def test_an_environment_does_not_depend_on_its_neighbours():
    few, many = native(3, arms="per_episode"), native(3000, arms="per_episode")
    one, other = few.reset(seed=5), many.reset(seed=5)
    np.testing.assert_array_equal(one[0], other[0][:3])
    actions = many.action_space.sample()
    one, other = few.step(actions[:3]), many.step(actions)
    np.testing.assert_array_equal(one[0], other[0][:3])
    np.testing.assert_array_equal(one[4]["pose_error"], other[4]["pose_error"][:3])


def test_floats_and_numpy_agree():
    one, other = (gym.make("pickenv/Reach-v0", executor=executor) for executor in ("floats", "numpy"))
    for seed in range(5):
        one.reset(seed=seed), other.reset(seed=seed)
        one.action_space.seed(seed)
        for _ in range(5):
            action = one.action_space.sample()
            a, b = one.step(action), other.step(action)
            assert a[1] == pytest.approx(b[1], abs=1e-9)
            np.testing.assert_allclose(a[4]["pose_error"], b[4]["pose_error"], rtol=0, atol=1e-9)


def test_resets_without_a_seed_go_on_through_its_episodes():
    one, other = native(4), native(4)
    chains = [[env.reset(seed=9)[0], env.reset()[0], env.reset()[0]] for env in (one, other)]
    np.testing.assert_array_equal(*chains)
    assert not np.array_equal(chains[0][0], chains[0][1])
    single = gym.make("pickenv/Reach-v0", executor="numpy")
    single.reset(seed=11), single.reset()
    np.testing.assert_array_equal(single.reset()[0], chains[0][2][2])


def test_seeds_are_one_for_all_or_one_each():
    envs = native(3)
    one, _ = envs.reset(seed=4)
    other, _ = envs.reset(seed=[4, 5, 6])
    np.testing.assert_array_equal(one, other)
    third, _ = envs.reset(seed=[4, None, 6])
    assert np.array_equal(third[[0, 2]], one[[0, 2]])
    assert not np.array_equal(third[1], one[1])


def test_seeds_differ_in_every_randomised_field():
    envs = native(40, feedback="camera", camera_noise_mm=2.0, arms="per_episode")
    observations, infos = envs.reset(seed=0)
    for column in range(9, 21):  # fruit, offsets, attitude and camera
        assert len(set(observations[:, column].tolist())) == 40
    assert len({tuple(row) for row in infos["pose_error"]}) == 40
    assert len(set(envs.unwrapped.batch.arm.tolist())) > 20


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
def test_the_last_observation_of_an_episode_is_not_lost(mode):
    envs, quiet = native(2, max_episode_steps=3, autoreset_mode=mode), native(2, max_episode_steps=None)
    envs.reset(seed=1), quiet.reset(seed=1)
    for _ in range(3):
        actions = envs.action_space.sample()
        taken, wanted = envs.step(actions), quiet.step(actions)
    assert taken[3].all() and not taken[2].any()
    last = taken[0] if mode == "NextStep" else np.stack(taken[4]["final_obs"])
    np.testing.assert_array_equal(last, wanted[0])
    if mode == "SameStep":
        np.testing.assert_array_equal(taken[4]["final_info"]["pose_error"], wanted[4]["pose_error"])
    else:
        after = envs.step(actions)
        assert not after[1].any() and not after[3].any()


def test_nothing_returned_shares_memory():
    for mode in AutoresetMode:
        envs = native(3, autoreset_mode=mode)
        calls = [envs.reset(seed=0), *(envs.step(envs.action_space.sample()) for _ in range(3))]
        found = [
            [value for part in call for value in (part.values() if isinstance(part, dict) else [part])]
            for call in calls
        ]
        for one, other in itertools.combinations(found, 2):
            assert not any(np.shares_memory(a, b) for a in one for b in other)


def test_a_mask_resets_those_it_names():
    envs = native(5, autoreset_mode="Disabled")
    first, _ = envs.reset(seed=0)
    moved, *_ = envs.step(np.ones((5, 6)))
    mask = np.array([True, False, False, True, False])
    observations, infos = envs.reset(options={"reset_mask": mask})
    np.testing.assert_array_equal(observations[~mask], moved[~mask])
    assert not np.any(np.all(observations[mask] == first[mask], axis=1))
    np.testing.assert_array_equal(infos["_pose_error"], mask)


def test_starts_goals_and_arms_can_be_given_for_each():
    envs = native(3, arms="per_episode")
    task = envs.unwrapped.task
    goals = np.linspace(task.lower, task.upper, 5)[1:4]
    _, infos = envs.reset(seed=0, options={"start_joints": goals, "goal_joints": goals, "arm": [7, 8, 8]})
    assert np.all(infos["position_error_mm"] < 5)
    assert envs.unwrapped.batch.arm.tolist() == [7, 8, 8]


def test_what_no_joint_can_remove_is_reported_apart():
    envs = native(20)
    envs.reset(seed=0)
    *_, infos = envs.step(envs.action_space.sample())
    from pickenv.arm import noncompensable_error

    nominal = envs.unwrapped.plant.arm.nominal
    lost = noncompensable_error(nominal, infos["joint_command"], infos["pose_error"])
    np.testing.assert_allclose(infos["noncompensable_deg"], np.degrees(np.linalg.norm(lost[:, 3:], axis=1)), atol=1e-9)
    whole = np.hypot(infos["noncompensable_deg"], infos["compensable_deg"])
    np.testing.assert_allclose(whole, infos["attitude_error_deg"])


def test_the_ideal_arm_has_no_error():
    envs = native(10, "ReachIdeal")
    goals = np.random.default_rng(0).uniform(envs.unwrapped.task.lower, envs.unwrapped.task.upper, (10, 6))
    _, infos = envs.reset(seed=0, options={"start_joints": goals, "goal_joints": goals})
    assert infos["position_error_mm"].max() < 1e-9


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize(
    "mode", ["NextStep", *(pytest.param(mode, marks=pytest.mark.slow) for mode in ("SameStep", "Disabled"))]
)
def test_numpy_and_torch_agree(mode, variant):
    torch = pytest.importorskip("torch")
    arguments = EARLY | VARIANTS[variant] | {"max_episode_steps": STEPS, "autoreset_mode": mode}
    one, other = native(5, **arguments), native(5, executor="torch", compiled=False, **arguments)

    def close(a, b):
        if isinstance(a, dict):
            for key in a.keys() - {"final_obs"}:
                close(a[key], b[key])
        else:
            assert isinstance(b, torch.Tensor)
            atol = 1e-6 if a.dtype == np.float32 else SINGLE.get(variant, 1e-8)
            np.testing.assert_allclose(np.asarray(a, float), b.double().numpy(), rtol=0, atol=atol)

    for a, b in zip(one.reset(seed=3), other.reset(seed=3), strict=True):
        close(a, b)
    one.action_space.seed(0)
    ended = np.zeros(5, bool)
    for _ in range(12):
        if mode == "Disabled" and ended.any():
            for env in (one, other):
                env.reset(options={"reset_mask": ended})
        actions = one.action_space.sample()
        taken = one.step(actions), other.step(torch.as_tensor(actions))
        for a, b in zip(*taken, strict=True):
            close(a, b)
        ended = taken[0][2] | taken[0][3]


def test_single_precision_keeps_positions_to_a_micrometre():
    pytest.importorskip("torch")
    one, other = native(500), native(500, executor="torch", compiled=False, dtype="float32")
    one.reset(seed=0), other.reset(seed=0)
    actions = one.action_space.sample()
    a, b = one.step(actions)[4], other.step(actions)[4]
    assert np.abs(a["tool_position"] - b["tool_position"].double().numpy()).max() < 1e-6


@pytest.mark.slow
def test_the_compiled_step_gives_what_the_eager_one_gives():
    pytest.importorskip("torch")
    one, other = (native(100, executor="torch", compiled=compiled, max_episode_steps=3) for compiled in (True, False))
    one.reset(seed=0), other.reset(seed=0)
    for _ in range(5):
        actions = one.action_space.sample()
        a, b = one.step(actions), other.step(actions)
        np.testing.assert_allclose(a[0], b[0], rtol=0, atol=1e-6)
        np.testing.assert_allclose(a[1], b[1], rtol=0, atol=1e-9)


def test_no_torch_is_needed_on_numpy():
    code = (
        "import sys, gymnasium as gym, pickenv; "
        "envs = gym.make_vec('pickenv/ReachGoal-v0', num_envs=3); "
        "envs.reset(seed=0); envs.step(envs.action_space.sample()); "
        "gym.make('pickenv/Reach-v0').reset(seed=0); assert 'torch' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.parametrize("executor", ["numpy", "torch"])
def test_copies_and_pickles_go_on_alike(executor, monkeypatch):
    if executor == "torch":  # whose compiled functions cannot be pickled, and take a minute to make
        monkeypatch.setattr(pytest.importorskip("torch"), "compile", lambda step, **_: lambda *values: step(*values))
    envs = native(4, arms="per_episode", plant="orchard", executor=executor, max_episode_steps=2)
    envs.reset(seed=0)
    actions = envs.action_space.sample()
    envs.step(actions)
    copies = [copy.deepcopy(envs), pickle.loads(pickle.dumps(envs))]
    for _ in range(3):  # the third step is of the next episode, with another arm
        wanted = envs.step(actions)
        for other in copies:
            again = other.step(actions)
            assert_same(np.asarray(wanted[0]), np.asarray(again[0]))
            assert_same(np.asarray(wanted[4]["tool_position"]), np.asarray(again[4]["tool_position"]))


def test_torch_begins_with_the_arms_and_joints_asked_for_as_numpy_does():
    pytest.importorskip("torch")
    envs = [native(3, arms="per_episode", population=4, executor=x, compiled=False) for x in ("numpy", "torch")]
    box = np.random.default_rng(0).uniform(envs[0].unwrapped.task.lower, envs[0].unwrapped.task.upper, (2, 3, 6))
    asked = {"arm": [3, 0, 2], "start_joints": box[0], "goal_joints": box[1]}
    a, b = (env.reset(seed=0, options=asked)[1] for env in envs)
    np.testing.assert_allclose(a["position_error_mm"], b["position_error_mm"].numpy(), rtol=0, atol=1e-8)
    assert all(env.unwrapped.batch.arm.tolist() == asked["arm"] for env in envs)


def test_memory_per_environment_is_below_two_kibibytes():
    import tracemalloc

    tracemalloc.start()
    envs = native(20_000)
    envs.reset(seed=0)
    envs.step(envs.action_space.sample())
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak / 20_000 < 2048


BAD = {
    "num_envs is 0": lambda: native(0),
    "num_envs is -1": lambda: native(-1),
    "unknown plant": lambda: native(2, plant="peach"),
    "unknown tolerance class": lambda: native(2, arms="per_env", tolerances="sloppy"),
    "population is 0": lambda: native(2, arms="per_env", population=0),
    "autoreset_mode": lambda: native(2, autoreset_mode="Never"),
    "executor": lambda: native(2, executor="abacus"),
    "dtype": lambda: native(2, executor="torch", dtype="float16"),
    "device": lambda: native(2, executor="torch", device="cuda:77"),
    "max_episode_steps": lambda: native(2, max_episode_steps=0),
    "actions have shape": lambda: stepped(np.zeros((3, 6))),
    "action of environment 1": lambda: stepped(np.array([[0.0] * 6, [np.nan] * 6])),
    "environment 1 is": lambda: stepped(np.array([[0.0] * 6, [np.inf, -np.inf, 0, 0, 0, 0]])),
    "the action of environment 0": lambda: stepped(np.full((2, 6), 1.01), out_of_range="refuse"),
    "environment 1 is [0.0, -1.01": lambda: stepped(
        np.array([[0.0] * 6, [0.0, -1.01, 0, 0, 0, 0]]), executor="torch", compiled=False, out_of_range="refuse"
    ),
    "environment 1 is [nan": lambda: stepped(
        np.array([[0.0] * 6, [np.nan, 0, 0, 0, 0, 0]]), executor="torch", compiled=False
    ),
    "reset_mask has shape (3,)": lambda: native(2).reset(options={"reset_mask": np.ones(3, bool)}),
    "reset_mask": lambda: native(2).reset(options={"reset_mask": np.zeros(2, bool)}),
    "seeds were given": lambda: native(2).reset(seed=[1, 2, 3]),
    "seed is -2": lambda: native(2).reset(seed=[1, -2]),
    "seed is 1.5": lambda: native(2).reset(seed=[1.5, 2]),
    "1 seeds were given for 2": lambda: native(2).reset(seed=1.9),
    "workspace": lambda: native(2).reset(options={"goal_joints": [9.0] * 6}),
    "arm is 400": lambda: native(2, arms="per_env").reset(options={"arm": 400}),
    "population": lambda: native(2).reset(options={"arm": 4}),
    "unknown reset option": lambda: native(2).reset(options={"gaol": 4}),
    "call reset first": lambda: native(2).step(np.zeros((2, 6))),
    "has ended": lambda: stepped(np.zeros((2, 6)), 3, autoreset_mode="Disabled", max_episode_steps=2),
}


def stepped(actions, steps=1, **arguments):
    envs = native(2, **arguments)
    envs.reset(seed=0)
    for _ in range(steps):
        envs.step(actions)


@pytest.mark.filterwarnings("ignore:.*negative.*")
@pytest.mark.parametrize("said", BAD)
def test_bad_input_is_refused_in_one_sentence(said):
    with pytest.raises(InputError) as caught:
        BAD[said]()
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


def test_rounding_to_single_precision_takes_no_action_out_of_its_range():
    one, other = native(2), native(2)
    one.reset(seed=0), other.reset(seed=0)
    most = np.full((2, 6), np.nextafter(np.float32(1), np.float32(2)))
    np.testing.assert_array_equal(one.step(most)[0], other.step(np.ones((2, 6)))[0])


@pytest.mark.parametrize("arms", ["per_env", "fixed"])
def test_pictures_of_all(arms):
    envs = native(2, render_mode="rgb_array", arms=arms)
    envs.reset(seed=0)
    pictures = envs.render()
    assert [picture.shape for picture in pictures] == [(360, 480, 3)] * 2
    assert not np.array_equal(*pictures)


@pytest.mark.parametrize("kind", [ReachVectorEnv, ReachGoalVectorEnv])
def test_one_environment_is_made_where_no_number_is_said(kind):
    assert kind().num_envs == 1


def test_the_package_is_named():
    assert pickenv.__version__
