"""Situations and rungs by their numbers: limits, units, what a name of the ladder fixes, and where given goals lie."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pickenv.arm import forward
from pickenv.base import InputError
from pickenv.envs import LADDER_VERSION, ReachEnv
from pickenv.envs.shared.difficulty import on_ladder
from pickenv.envs.shared.situation import make_situation
from pickenv.envs.shared.spaces import given_goals

LIMITS = {
    "control_period_s": (1e-3, 10.0),
    "latency": (0, 20),
    "action_delay": (0, 20),
    "joint_noise": (0.0, 100.0),
    "hours_on": (0.0, 1000.0),
    "start_spread": (0.0, 1.0),
}
ARMS = {"plant": "qiao2026", "arms": "per_episode"}
SEEDS = {"train": (256, 658768154745144193), "test": (64, 3724514641198283372)}
LATE = {"joint_noise": 0.05, "latency": [0, 1], "action_delay": [0, 1], "start_spread": 0.5}
ORCHARD = {**ARMS, "plant": "orchard", "tolerances": "medium", **LATE}
DAY = ORCHARD | {"hours_on": [0.0, 8.0]}
RUNGS = {
    "ideal": {"plant": "ideal"},
    "fine": ARMS | {"tolerances": "fine"},
    "coarse": ARMS | {"tolerances": "coarse"},
    "orchard": ORCHARD,
    "day": DAY,
}
EYES = {
    "Reach": {"feedback": "camera", "camera_noise_mm": 1.6, "fruit_noise_mm": 6.3},
    "Pick": {"vision": "measured_errors"},
}


@pytest.mark.parametrize("name", LIMITS)
def test_a_number_is_taken_from_its_least_to_its_largest(name):
    least, most = LIMITS[name]
    step = 1 if isinstance(least, int) else 1e-9
    for given in (least, most):
        make_situation(**{name: given})
    if name != "start_spread":
        make_situation(**{name: [least, most]})
    for wrong in (least - step, most + max(step, most * 1e-9)):
        with pytest.raises(InputError, match=f"^{name} is "):
            make_situation(**{name: type(least)(wrong)})


def test_a_situation_is_kept_in_si_units():
    given = make_situation([0.04, 0.08], [1, 3], 2, [0.5, 2.0], [1.0, 5.0], 0.25)
    assert (given.period, given.latency, given.delay) == ((0.04, 0.08), (1, 3), (2, 2))
    assert given.joint_noise == pytest.approx((5e-4, 2e-3)) and given.hours == (1.0, 5.0) and given.spread == 0.25
    assert given.drawn == ("period", "latency", "joint_noise", "hours")
    assert given.frames_per_second == 12.5 and not given.plain
    assert given.widths(6, 9) == (4, 12, 27)
    assert given.value("latency", (0.06, 2.5, 1e-3, 4.0)) == 2.5 and given.value("delay", ()) == 2
    usual = make_situation()
    assert usual.period == (0.1, 0.1) and usual.plain and usual.drawn == ()
    assert make_situation(hours_on=3.0).plain
    assert not any(make_situation(**some).plain for some in ({"joint_noise": 0.1}, {"start_spread": 0.1}))
    assert make_situation(3 / 7).frames_per_second == 2.333333


@pytest.mark.parametrize("task", EYES)
@pytest.mark.parametrize("split", SEEDS)
def test_what_a_rung_fixes_never_changes_within_a_version(task, split):
    assert LADDER_VERSION == 2
    size, seed = SEEDS[split]
    for name, fixed in (RUNGS | {"own_eyes": DAY | EYES[task]}).items():
        drawn = {"population": size, "population_seed": seed} if "arms" in fixed else {}
        assert on_ladder(task, difficulty=name, split=split, tolerance_mm=3.0) == fixed | drawn | {"tolerance_mm": 3.0}


def test_given_goals_are_met_to_the_last_digits_and_stand_upright_enough():
    env = ReachEnv(plant="ideal", max_tilt_deg=20.0)
    task, nominal = env.task, env.plant.arm.nominal
    rng = np.random.default_rng(3)
    joints = np.array(task.lower) + rng.uniform(0.35, 0.65, (40, 6)) * (np.array(task.upper) - task.lower)
    poses = forward(nominal, joints)
    upright = np.flatnonzero(poses.rotation[:, 2, 2] > math.cos(math.radians(15.0)))[:4]
    places = poses.position[upright]
    assert len(places) > 0
    found = forward(nominal, given_goals(task, {"goal_position": places}, len(places))[0])
    np.testing.assert_allclose(found.position, places, atol=1e-8)
    assert (found.rotation[:, 2, 2] >= math.cos(math.radians(20.0))).all()
    turn = np.array([0.2, -0.1, 0.4])
    wanted = [*places[0], *turn]
    frames = given_goals(task, {"goal_pose": wanted}, 3)[1]
    axes = Rotation.from_rotvec(turn).as_matrix().T.ravel()
    np.testing.assert_allclose(frames, [[*axes, *places[0]]] * 3, atol=1e-12)
    assert given_goals(task, {"goal_joints": None}) == (None, None)
