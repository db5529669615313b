"""Whatever an environment is given in place of what it asks for, it answers with one sentence."""

import re

import gymnasium as gym
import numpy as np
import pytest

import pickenv  # noqa: F401, registers the environments
from pickenv.base import InputError
from pickenv.envs import HarvestEnv, HarvestVectorEnv, PickEnv, ReachEnv, ReachVectorEnv, make_task

MAKERS = {
    "Reach": ReachEnv,
    "Reach, vector": lambda **given: ReachVectorEnv(2, **given),
    "Pick": PickEnv,
    "Harvest": HarvestEnv,
    "Harvest, vector": lambda **given: HarvestVectorEnv(2, **given),
}
NO_ACTIONS = ["left", None, {"joints": 1}, ["a"] * 6, [[1], [1, 2]], object(), [1j] * 6, [10**5000] * 6]


@pytest.fixture(scope="module", params=MAKERS)
def env(request):
    made = MAKERS[request.param]()
    made.reset(seed=0)
    yield made
    made.close()


@pytest.mark.parametrize("action", NO_ACTIONS, ids=lambda action: type(action).__name__)
def test_an_action_that_is_no_numbers_is_refused(env, action):
    with pytest.raises(InputError, match=r"^(an )?action") as said:
        env.step(action)
    assert "\n" not in str(said.value) and len(str(said.value)) < 200


@pytest.mark.parametrize("options", [5, "seed", [1], True])
def test_options_that_are_no_mapping_are_refused(env, options):
    with pytest.raises(InputError, match=re.escape(f"options is {options!r}; give a dict")):
        env.reset(options=options)


def test_an_option_that_nobody_reads_is_refused(env):
    with pytest.raises(InputError, match="unknown reset option '3'; "):
        env.reset(options={3: 1})


@pytest.mark.parametrize("name", ["Reach", "Reach, vector", "Pick"])
@pytest.mark.parametrize("plant", [3, None, ["orchard"], b"orchard", "n" * 300])
def test_a_plant_that_is_no_name_is_refused(name, plant):
    with pytest.raises((InputError, OSError), match=r"plant is .*; give the name|unknown plant|File name too long"):
        MAKERS[name](plant=plant)


@pytest.mark.parametrize(
    "arguments",
    [
        {"without": 3},
        {"without": "gravity"},
        {"without": [3]},
        {"tolerance_mm": "5"},
        {"tolerance_mm": None},
        {"tolerance_mm": 1e300},
        {"tolerance_mm": 10**5000},
        {"camera_noise_mm": True},
        {"arms": "per_episode", "population": 10**12},
        {"arms": "per_episode", "population_seed": -1},
        {"arms": "per_episode", "population_seed": "a"},
        {"arms": "per_episode", "tolerances": 3},
        {"tolerances": 3},
        {"population": "many"},
        {"end_on_success": "no"},
        {"end_on_success": 1.5},
    ],
    ids=lambda given: list(given)[-1],
)
def test_an_impossible_argument_is_named(arguments):
    with pytest.raises(InputError, match=f"^{list(arguments)[-1]} is .*; give "):
        ReachEnv(**arguments)


@pytest.mark.parametrize(
    ("name", "arguments", "said"),
    [
        ("Harvest", {"spacing_mm": "wide"}, "spacing_mm is 'wide'; give a finite number above zero"),
        *(("Harvest", {"ideal": value}, f"ideal is {value!r}; give True or False") for value in ("no", 1.5, 1, None)),
        ("Harvest, vector", {"ideal": "no"}, "ideal is 'no'; give True or False"),
        ("Harvest", {"slaves": True}, "a machine cannot have True slave arms; give a whole number"),
        ("Harvest", {"canopy": True}, "unknown canopy 'True'; give one of"),
        *(
            ("Pick", {name: 3}, f"unknown {name} '3'; give one of")
            for name in ("gripper", "camera", "canopy", "detector")
        ),
        *(("Pick", {f"fruit_{name}": 3}, "unknown fruit.* '3'; give one of") for name in ("map", "size")),
    ],
    ids=str,
)
def test_an_argument_of_another_kind_is_refused_in_a_sentence(name, arguments, said):
    with pytest.raises(InputError, match=f"^{said}"):
        MAKERS[name](**arguments)


@pytest.mark.parametrize("make", [gym.make, gym.make_vec], ids=["one", "vector"])
@pytest.mark.parametrize(
    ("name", "wrong", "meant"),
    [
        ("Reach", "tolerence_mm", "tolerance_mm"),
        ("ReachGoal", "latecy", "latency"),
        ("ReachIdeal", "max_tilt", "max_tilt_deg"),
        ("ReachScaled", "difficultee", "difficulty"),
        ("ReachTool", "tool_step", "tool_step_mm"),
        ("Harvest", "slave", "slaves"),
        ("PickScene", "leafs", "leaves"),
        ("Pick", "griper", "gripper"),
    ],
)
def test_an_argument_that_nothing_takes_is_named_with_the_one_like_it(make, name, wrong, meant):
    with pytest.raises(InputError, match=f"^unknown argument '{wrong}'; perhaps {meant} is meant: known are .*{meant}"):
        make(f"pickenv/{name}-v0", **{wrong: 1})
    with pytest.raises(InputError, match=f"^unknown argument 'qwertz'; known are .*{meant}"):
        make(f"pickenv/{name}-v0", qwertz=1)


def test_an_argument_that_a_task_of_ones_own_requires_is_taken():
    class Weighed(ReachEnv):
        task_of = staticmethod(lambda weight, **others: make_task(tolerance_mm=weight, **others))

    assert Weighed(weight=3.0, latency=1).task.tolerance_mm == 3.0
    with pytest.raises(InputError, match=r"^unknown argument 'weigt'; perhaps weight is meant: known are .*weight"):
        Weighed(weight=3.0, weigt=3.0)
    with pytest.raises(InputError, match=r"^unknown argument 'task'; "):
        ReachEnv(task="Pick")


@pytest.mark.parametrize("make", [gym.make, gym.make_vec], ids=["one", "vector"])
@pytest.mark.parametrize("name", ["Reach", "ReachTool", "Pick", "PickScene"])
@pytest.mark.parametrize("idle", [{"tolerances": "coarse"}, {"population": 8}, {"population_seed": 1}], ids=str)
def test_what_draws_a_population_is_refused_where_there_is_none(make, name, idle):
    (argument,) = idle
    with pytest.raises(InputError, match=f"^{argument} has no effect on the plant's own arm; give arms="):
        make(f"pickenv/{name}-v0", **idle)
    make(f"pickenv/{name}-v0", arms="per_env", **idle).close()


BY_POSITION = {"actions": "position"}
WITHOUT_EFFECT = [
    ("Pick", {"grip_noise_mm": 2.0}, {}, {"feedback": "gripper"}),
    ("Pick", {"detector": "circles"}, {}, {"vision": "measured_errors"}),
    ("Pick", {"detector": "circles"}, {"vision": "ideal"}, {"vision": "measured_errors"}),
    ("Pick", {"camera": "perfect"}, {"difficulty": "own_eyes"}, {}),
    ("Pick", {"looks": 4}, {"vision": "ideal"}, {"vision": "measured_errors"}),
    ("PickScene", {"without": ["backlash"]}, {"plant": "orchard", "error_mm": 0.0}, {"plant": "orchard"}),
    ("PickScene", {"start_spread": 0.2}, {"within_mm": 40.0}, {}),
    ("Harvest", {"detector": "circles"}, {"vision": "ideal"}, {}),
    ("Harvest", {"spacing_mm": 400.0}, {"slaves": 1}, {"slaves": 2}),
    ("ReachTool", {"tool_turn_deg": 5.0}, BY_POSITION, {}),
    ("ReachTool", {"angle_tolerance_deg": 1.0}, BY_POSITION, {}),
]
"""Environments, and an argument of each; others beside which it changes nothing, and others beside which it counts."""


@pytest.mark.parametrize("make", [gym.make, gym.make_vec], ids=["one", "vector"])
@pytest.mark.parametrize(("name", "idle", "beside", "needed"), WITHOUT_EFFECT, ids=str)
def test_an_argument_without_effect_is_refused_and_its_default_is_not(make, name, idle, beside, needed):
    (argument,) = idle
    with pytest.raises(InputError, match=f"^{argument} has no effect .*; (leave it out|give that with it)"):
        make(f"pickenv/{name}-v0", **idle, **beside)
    make(f"pickenv/{name}-v0", **beside).close()
    make(f"pickenv/{name}-v0", **idle, **needed).close()


@pytest.mark.parametrize("name", ["Reach", "ReachGoal", "ReachIdeal", "ReachScaled", "ReachTool", "Pick", "Harvest"])
def test_every_native_vector_takes_the_executor_with_which_it_is_what_one_is_alone(name):
    one = gym.make(f"pickenv/{name}-v0", executor="numpy")
    several = gym.make_vec(f"pickenv/{name}-v0", num_envs=2, executor="numpy")
    alone, together = one.reset(seed=4)[0], several.reset(seed=3)[0]
    for key in alone if isinstance(alone, dict) else [...]:
        np.testing.assert_array_equal(together[key][1], alone[key])
    with pytest.raises(InputError, match=r"^executor is 'gpu'; give one of auto, "):
        gym.make_vec(f"pickenv/{name}-v0", num_envs=2, executor="gpu")


def test_one_arm_of_a_class_is_drawn_with_the_seed():
    first, second = (ReachEnv(plant="coarse:ur5e", population_seed=seed).plant.geometry for seed in (1, 2))
    assert not np.array_equal(first.a, second.a)


def test_joints_and_arms_asked_for_are_numbers():
    env = ReachEnv(arms="per_episode", population=4)
    several = ReachVectorEnv(2, arms="per_episode", population=4)
    with pytest.raises(InputError, match=r"^start_joints is 'home'; give numbers"):
        env.reset(options={"start_joints": "home"})
    for asked in ("a", 1.5, 4, -1):
        with pytest.raises(InputError, match=re.escape(f"arm is {asked!r}; the population has arms 0 to 3")):
            env.reset(options={"arm": asked})
        with pytest.raises(InputError, match=r"arm is .*; the population has arms 0 to 3"):
            several.reset(options={"arm": asked})
    with pytest.raises(InputError, match=r"arm has shape \(3,\)"):
        several.reset(options={"arm": [1, 2, 3]})
    several.reset(seed=0, options={"arm": [1, 2]})
    assert several.batch.arm.tolist() == [1, 2]


def test_what_gymnasium_makes_says_the_same():
    with pytest.raises(InputError, match="plant is 3; give the name"):
        gym.make("pickenv/Reach-v0", plant=3)


def test_actions_of_every_number_type_move_alike():
    moved = []
    for kind in (np.float32, np.float64, int, list):
        env = ReachVectorEnv(2, plant="ideal")
        env.reset(seed=0)
        action = np.ones((2, env.single_action_space.shape[0]))
        moved.append(env.step(action.tolist() if kind is list else action.astype(kind))[0])
    for other in moved[1:]:
        np.testing.assert_array_equal(moved[0], other)
