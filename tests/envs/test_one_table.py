"""Referee: single environments, native ones on NumPy and torch, and the study say the same about one table of inputs.

The table: each of a few true arms comes to each of a few fruit, with and without a compensator; cups come to fruit of
several sizes, ever farther off.
"""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import torch

from pickenv.arm import chain_of, forward, plant_at, pose_error, tree_map
from pickenv.calibration import Compensator
from pickenv.calibration.compensation.compensator import corrected
from pickenv.envs import PickEnv, ReachEnv, ReachGoalEnv, ReachGoalVectorEnv, ReachVectorEnv
from pickenv.envs.harvesting import harvest_task
from pickenv.envs.harvesting.harvest_task import make_harvest_task
from pickenv.envs.picking.pick_scene import PickScene
from pickenv.experiments import Noise, StudyConfig, prepared_study
from pickenv.experiments.study import RAW, evaluate_arm, evaluate_chunk
from pickenv.experiments.study_batched import judge_batch
from pickenv.harvester import attempt, draw_luck
from pickenv.orchard import capture_probability

ARMS, FRUIT = 3, 5
TOLERANCE_MM, TOLERANCE_DEG = 1.0, 10.0
CORNER = np.log10(1 + TOLERANCE_MM) + 0.5 * np.log10(1 + TOLERANCE_DEG)
"""What the capture region's farthest corner costs: every failure is lower by it."""
POPULATION = {"arms": "per_episode", "population": ARMS, "tolerances": "medium"}
JUDGED = {"tolerance_mm": TOLERANCE_MM, "angle_tolerance_deg": TOLERANCE_DEG}
ROWS = [(arm, fruit) for arm in range(ARMS) for fruit in range(FRUIT)]
KINDS = ["floats", "numpy", "native", "torch"]


@pytest.fixture(scope="module")
def protocol():
    """A study of arms as they are, each reaching for the table's fruit."""
    nothing = {"noise": (Noise(0.0, 0.0),), "it_grades": None, "residual_poses": 1, "payload_kg": (0.0,)}
    judged = {"radius_mm": TOLERANCE_MM, "share": 0.9, "tolerances": ("medium",), "methods": (RAW,)}
    counts = {"poses": (10,), "seed": 0, "arms": ARMS, "chunk": ARMS, "fruit": FRUIT}
    return prepared_study(StudyConfig(plant="qiao2026", **counts, **judged, **nothing))


@pytest.fixture(scope="module")
def given(protocol):
    """What every arm of the table meets: the fruit of arm 0."""
    return protocol.circumstances(0)


@pytest.fixture(scope="module")
def plants():
    return ReachVectorEnv(1, **POPULATION).task.plant


@pytest.fixture(scope="module")
def compensator(plants):
    """It knows the geometry of arm 0."""
    return Compensator(plants.arm.nominal, plant_at(plants, 0).geometry)


def shown(kind, given, compensator=None, goal=False, **arguments):
    """What an environment says of each row after a step in which nothing moves: numbers by their name, and rewards."""
    joints = given.fruit
    arguments = {**POPULATION, **JUDGED, **arguments}
    if kind in ("floats", "numpy"):
        env = (ReachGoalEnv if goal else ReachEnv)(executor=kind, **arguments)
        env.compensator = compensator
        infos, rewards = [], []
        for arm, fruit in ROWS:
            env.reset(seed=0, options={"arm": arm, "goal_joints": joints[fruit], "start_joints": joints[fruit]})
            _, reward, _, _, info = env.step(np.zeros(6))
            infos.append(info)
            rewards.append(reward)
        return {key: np.array([info[key] for info in infos]) for key in infos[0]}, np.array(rewards)
    executor = {"executor": "torch", "compiled": False} if kind == "torch" else {}
    envs = (ReachGoalVectorEnv if goal else ReachVectorEnv)(len(ROWS), **executor, **arguments)
    envs.compensator = compensator
    arms, fruit = (np.array(column) for column in zip(*ROWS, strict=True))
    envs.reset(seed=0, options={"arm": arms, "goal_joints": joints[fruit], "start_joints": joints[fruit]})
    _, rewards, _, _, infos = envs.step(np.zeros((len(ROWS), 6)))
    return {key: np.asarray(value) for key, value in infos.items() if key[0] != "_"}, np.asarray(rewards)


def reference(protocol, given, plants, commands):
    """Pose errors (rows, 6) by the study's formula, for joint commands ``(fruit, 6)``."""
    wanted = forward(protocol.nominal, given.fruit)
    errors = [pose_error(wanted, plant_at(plants, arm).tool_pose(commands)) for arm in range(ARMS)]
    return np.concatenate(errors)


@pytest.mark.parametrize("kind", KINDS)
def test_pose_error_reward_and_success_are_the_studys(kind, protocol, given, plants):
    (setting,) = protocol.settings
    alone = [evaluate_arm(protocol, [setting], plant_at(plants, arm), given)[0] for arm in range(ARMS)]
    together = judge_batch(protocol, [setting], plants, [given] * ARMS)[0]
    position, attitude = (np.concatenate([part[name][0] for part in alone]) for name in ("position", "attitude"))
    np.testing.assert_allclose(together["position"].ravel(), position, rtol=0, atol=1e-12)
    np.testing.assert_allclose(together["attitude"].ravel(), attitude, rtol=0, atol=1e-12)
    error = reference(protocol, given, plants, given.fruit)
    info, rewards = shown(kind, given)
    np.testing.assert_allclose(info["pose_error"], error, rtol=0, atol=1e-12)
    np.testing.assert_allclose(info["position_error_mm"], 1e3 * position, rtol=0, atol=1e-9)
    np.testing.assert_allclose(info["attitude_error_deg"], np.degrees(attitude), rtol=0, atol=1e-9)
    success = (1e3 * position <= TOLERANCE_MM) & (np.degrees(attitude) <= TOLERANCE_DEG)
    wanted = -np.log10(1 + 1e3 * position) - 0.5 * np.log10(1 + np.degrees(attitude)) - np.where(success, 0.0, CORNER)
    np.testing.assert_allclose(rewards, wanted, rtol=0, atol=1e-12)
    assert info["is_success"].tolist() == success.tolist()
    assert 0 < success.sum() < len(ROWS)
    table = evaluate_chunk(protocol, 0, judge=lambda *batch: [together])
    np.testing.assert_allclose(table["share_within"], success.reshape(ARMS, FRUIT).mean(axis=1))
    _, sparse = shown(kind, given, reward="sparse")
    assert sparse.tolist() == np.where(success, 0.0, -1.0).tolist()


@pytest.mark.parametrize("kind", KINDS)
def test_rewards_of_goals_are_those_of_the_goals_that_are_returned(kind, given):
    """With encoders alone a tool that is believed to be at the fruit has its full reward, whatever the truth."""
    for reward in ("dense", "sparse"):
        _, rewards = shown(kind, given, goal=True, reward=reward)
        np.testing.assert_allclose(rewards, 0.0, atol=1e-4)
    _, rewards = shown(kind, given, goal=True, reward="dense", feedback="camera")
    error = shown(kind, given)[0]["position_error_mm"]
    wanted = -np.log10(1 + error) - np.where(error <= TOLERANCE_MM, 0.0, CORNER)
    np.testing.assert_allclose(rewards, wanted, rtol=0, atol=1e-4)  # goals are in single precision


@pytest.mark.parametrize("kind", KINDS)
def test_compensated_commands_and_what_they_leave_are_the_studys(kind, protocol, given, plants, compensator):
    nominal, targets = protocol.nominal, given.fruit
    commands = compensator(targets)
    np.testing.assert_allclose([compensator(one) for one in targets], commands, rtol=0, atol=1e-9)
    place = partial(torch.as_tensor, dtype=torch.float64)
    chains = chain_of(nominal), tree_map(place, chain_of(plants.geometry, np))  # the study's: all arms at once
    columns = [place(column[:, None].copy()) for column in targets.T]
    studied = np.stack([v.numpy() for v in corrected(torch, nominal, chains, columns, Compensator.iterations)], axis=-1)
    np.testing.assert_allclose(studied[:, 0], commands, rtol=0, atol=1e-9)
    info, _ = shown(kind, given, compensator)
    np.testing.assert_allclose(info["joint_command"], np.tile(commands, (ARMS, 1)), rtol=0, atol=1e-9)
    np.testing.assert_allclose(info["pose_error"], reference(protocol, given, plants, commands), rtol=0, atol=1e-9)
    assert not np.allclose(commands, targets, rtol=0, atol=1e-6)


LATERAL_MM = (0.0, 4.9, 5.1, 7.4, 9.9, 10.1, 20.0)
AXIAL_MM = (0.0, 14.0, -14.0)
DIAMETERS_MM = (60.0, 66.0, 70.0, 71.0)


@pytest.mark.parametrize("diameter_mm", DIAMETERS_MM)
@pytest.mark.parametrize("axial_mm", AXIAL_MM)
@pytest.mark.parametrize("grasp", [0.001, 0.25, 0.6, 0.999])
def test_a_cup_this_far_off_does_the_same_in_the_experiment_in_one_machine_and_in_many(
    axial_mm, diameter_mm, grasp, monkeypatch
):
    task = make_harvest_task(slaves=1, fruit=1, vision="ideal")
    task = replace(task, model=replace(task.model, cut_success=1.0, undamaged=1.0))
    luck = draw_luck(np.random.default_rng(0), 1)._replace(grasp=np.array([grasp]))
    monkeypatch.setattr(harvest_task, "draw_luck", lambda *_: luck)
    rngs = [np.random.default_rng(i) for i in range(len(LATERAL_MM))]
    miss = np.array([[lateral * 1e-3, 0.0, axial_mm * 1e-3] for lateral in LATERAL_MM])
    many = harvest_task.begin_zones(task, rngs)
    many.diameters[:] = diameter_mm * 1e-3
    fruit = many.fruit[:, 0].copy()
    still, none = np.zeros((1, 3)), np.zeros((0, 3))
    expected = [
        bool(attempt(task.model, at[None] + off, at[None], still, many.diameters[0], none, luck)[2][0])
        for at, off in zip(fruit, miss, strict=True)
    ]
    clearance = (task.model.cup.opening - diameter_mm * 1e-3) / 2
    formula = clearance >= 0, 1.0 - (np.array(LATERAL_MM) * 1e-3 - clearance) / task.model.gather
    assert expected == (formula[0] & (grasp < formula[1])).tolist()
    harvest_task.attempts(task, many, (fruit + miss)[:, None], rngs)
    assert (many.status[:, 0] == harvest_task.COLLECTED).tolist() == expected
    for i in range(len(LATERAL_MM)):
        one = harvest_task.begin_zones(task, [np.random.default_rng(i)])
        one.diameters[:] = diameter_mm * 1e-3
        harvest_task.attempts(task, one, (one.fruit[0, 0] + miss[i])[None, None], rngs[:1])
        assert (one.status[0, 0] == harvest_task.COLLECTED) == expected[i]


@pytest.mark.parametrize("gripper", ["li_cup", "compliant_hand"])
def test_a_picking_arm_takes_a_fruit_exactly_where_its_gripper_does(gripper):
    env = PickEnv(gripper=gripper, camera="perfect")
    env.reset(seed=0, options={"fruit": [[0.6, -0.7, 0.4]]})
    scene = env.scene
    for lateral_mm in LATERAL_MM:
        for axial_mm in AXIAL_MM:
            point = scene.positions[0] - np.array([lateral_mm, 0.0, axial_mm]) * 1e-3
            probability = float(
                capture_probability(scene.orchard.gripper, lateral_mm * 1e-3, axial_mm * 1e-3, 0.0, scene.diameters[0])
            )
            for chance in (0.0, 0.3, 0.7, 0.9, 1.0 - 1e-9):
                again = PickScene(scene.orchard, scene.fruit.copy())
                again.chance[:] = chance
                again.grasp(0, (*np.eye(3).ravel(), *point))
                assert again.attached[0] == (chance < probability)
