"""Any calibration and any evaluation as a recording: what is drawn is what the calibration or the episodes say."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import pickenv  # noqa: F401  (registers the environments)
from pickenv.agents import Reaches, ScriptedReach, episode_seeds, run_reaches
from pickenv.arm import Plant, forward, load_arm, load_plant
from pickenv.base import InputError
from pickenv.calibration import (
    BpnnSettings,
    Calibration,
    Fit,
    Measurements,
    assess,
    fit,
    random_joints,
    simulated_tracker,
)
from pickenv.inspect import colours, inspect_calibration, inspect_evaluation
from pickenv.wrappers import CompensationWrapper

RERUN = Path(sys.executable).with_name("rerun")


@pytest.fixture(scope="module")
def plant() -> Plant:
    return load_plant("qiao2026")


@pytest.fixture(scope="module")
def poses(plant: Plant) -> tuple[Measurements, Measurements]:
    rng = np.random.default_rng(1)
    joints = random_joints(plant.arm.nominal, 160, rng)
    measured = simulated_tracker(plant, joints, rng)
    return measured.select(np.arange(120)), measured.select(np.arange(120, 160))


@pytest.fixture(scope="module")
def fitted(plant: Plant, poses: tuple[Measurements, Measurements]) -> Fit:
    train = poses[0]
    settings = BpnnSettings(epochs=20)
    return fit(plant.arm, train, train, known_frames=True, rng=np.random.default_rng(2), settings=settings)


@pytest.fixture(scope="module")
def calibration(fitted: Fit, poses: tuple[Measurements, Measurements], plant: Plant) -> Calibration:
    return assess(plant.arm, fitted, *poses).calibration


def arrows(reading: Any, key: str) -> np.ndarray:
    return np.asarray(reading.values(f"/world/field/{key}/vectors", "PickError:xyz_mm")) / 1e3


def test_a_calibration_of_a_simulated_arm(
    calibration: Calibration, plant: Plant, reader: Callable[[Path], Any], tmp_path: Path
) -> None:
    reading = reader(inspect_calibration(calibration, plant, tmp_path / "calibration.rrd", grid_step=0.2))
    assert reading.unmatched_rules() == []
    points = reading.values("/world/field/raw/vectors", "Arrows3D:origins")
    assert len(points) > 20
    raw, ls, best = (np.linalg.norm(arrows(reading, key), axis=1).mean() for key in ("raw", "ls", "ls_bpnn"))
    assert best < raw
    assert ls < 0.5 * raw
    assert "/world/uncertainty/predicted" in reading.entities()
    assert "/world/effect/joint_compliance" in reading.entities()
    assert not any(entity.startswith(("/metrics", "/day")) for entity in reading.entities())


def test_a_calibration_at_measured_poses(
    calibration: Calibration,
    poses: tuple[Measurements, Measurements],
    reader: Callable[[Path], Any],
    tmp_path: Path,
) -> None:
    held_out = poses[1]
    reading = reader(inspect_calibration(calibration, held_out, tmp_path / "calibration.rrd"))
    assert reading.unmatched_rules() == []
    for key, model in (("raw", calibration.nominal), ("ls", calibration.identified)):
        missed = held_out.position - forward(model, held_out.joints).position
        np.testing.assert_allclose(arrows(reading, key), missed, atol=1e-8)
    predicted = calibration.predict(held_out.joints).position
    np.testing.assert_allclose(arrows(reading, "ls_bpnn"), held_out.position - predicted, atol=1e-6)
    index, values = (
        reading.values("/world/field/raw/voxels", f"VoxelGridMap:{name}") for name in ("voxel_indices", "values")
    )
    assert len(np.unique(index, axis=0)) == len(index) <= len(held_out)
    missed = 1e3 * np.linalg.norm(arrows(reading, "raw"), axis=1)
    rounding = 1.0 + 1e-6  # both are of single precision
    assert missed.min() / rounding <= values.min() <= values.max() <= missed.max() * rounding


def test_positions_alone_are_shown_without_attitudes(
    calibration: Calibration,
    poses: tuple[Measurements, Measurements],
    reader: Callable[[Path], Any],
    tmp_path: Path,
) -> None:
    positions = replace(poses[1], rotation=None)
    plain = replace(calibration.without_residual(), record={})
    reading = reader(inspect_calibration(plain, positions, tmp_path / "calibration.rrd"))
    assert reading.unmatched_rules() == []
    entities = reading.entities()
    assert not any(entity.startswith(("/world/attitude", "/world/uncertainty")) for entity in entities)
    assert "/world/field/ls/vectors" in entities
    assert "/world/field/ls_bpnn/vectors" not in entities


def test_another_arms_calibration_and_too_few_poses_are_refused(
    calibration: Calibration, plant: Plant, poses: tuple[Measurements, Measurements], tmp_path: Path
) -> None:
    other = replace(plant, arm=load_arm("ur5"))
    with pytest.raises(InputError, match="not of 'ur5'"):
        inspect_calibration(calibration, other, tmp_path / "calibration.rrd")
    with pytest.raises(InputError, match="1 poses are too few"):
        inspect_calibration(calibration, poses[1].select([0]), tmp_path / "calibration.rrd")
    assert list(tmp_path.iterdir()) == []


@pytest.fixture(scope="module")
def runs(calibration: Calibration) -> dict[str, Reaches]:
    found = {}
    for label, compensator in (("raw", None), ("LS", calibration.compensator(with_residual=False))):
        env: gym.Env[Any, Any] = gym.make("pickenv/Reach-v0", max_episode_steps=40)
        if compensator is not None:
            env = CompensationWrapper(env, compensator)
        found[label] = run_reaches(env, ScriptedReach(env), episode_seeds(3, 6))
        env.close()
    return found


def test_an_evaluation_shows_how_its_episodes_ended(
    runs: dict[str, Reaches], plant: Plant, reader: Callable[[Path], Any], tmp_path: Path
) -> None:
    reading = reader(inspect_evaluation(runs, plant, tmp_path / "evaluation.rrd", seed=3))
    assert reading.unmatched_rules() == []
    for key, ends in (("raw", runs["raw"]), ("ls", runs["LS"])):
        errors = reading.values(f"/metrics/error_mm/{colours.lane(key)}", "Scalars:scalars")
        np.testing.assert_allclose(errors, ends.position_error_mm, rtol=6e-4)
        degrees = reading.values(f"/metrics/attitude_deg/{colours.lane(key)}", "Scalars:scalars")
        np.testing.assert_allclose(degrees, ends.attitude_error_deg, rtol=6e-4)
        miss = 1e3 * (ends.tool_position - ends.fruit_position)
        np.testing.assert_allclose(reading.values(f"/world/miss/{key}", "PickError:xyz_mm"), miss, rtol=1e-5, atol=1e-6)
        states = reading.values(f"/outcome/{colours.lane(key)}", "StateChange:state")
        np.testing.assert_array_equal(states == "pick", ends.success)


def test_policies_of_one_scene_and_seed_merge_into_one_recording(
    runs: dict[str, Reaches], plant: Plant, tmp_path: Path
) -> None:
    from rerun.chunk import RrdReader

    paths = [
        inspect_evaluation({label: ends}, plant, tmp_path / f"{label}.rrd", seed=3) for label, ends in runs.items()
    ]
    both = tmp_path / "both.rrd"
    subprocess.run([RERUN, "rrd", "merge", *paths, "-o", both], check=True, capture_output=True)
    (entry,) = RrdReader(both).recordings()
    assert entry.recording_id == "qiao2026:seed3"
    entities = {column.entity_path for column in RrdReader(both).stream().collect().schema().component_columns()}
    assert {"/world/field/raw/vectors", "/world/field/ls/vectors", "/metrics/error_mm/2_ls"} <= entities


def test_runs_on_other_fruit_are_not_compared(runs: dict[str, Reaches], plant: Plant, tmp_path: Path) -> None:
    moved = replace(runs["LS"], fruit_position=runs["LS"].fruit_position + 0.1)
    with pytest.raises(InputError, match="'LS' did not reach for the same fruit as 'raw'"):
        inspect_evaluation({**runs, "LS": moved}, plant, tmp_path / "evaluation.rrd")
    with pytest.raises(InputError, match="no episodes"):
        inspect_evaluation({}, plant, tmp_path / "evaluation.rrd")
