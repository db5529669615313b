"""A Universal Robots arm by its kinematics file: the product of its six frames, as ROS stacks them."""

from pathlib import Path

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from pickenv.arm import Pose, forward, load_arm, pose_error
from pickenv.arm.files.arm_file import UR_KEYS, UR_LINKS
from pickenv.base import InputError

HALF = 1.570796327
NOMINAL = {  # the frames that stand for the maker's DH table, with half a turn to ten digits as ur_description has it
    "shoulder": (0, 0, 0.1625, 0, 0, 0),
    "upper_arm": (0, 0, 0, HALF, 0, 0),
    "forearm": (-0.425, 0, 0, 0, 0, 0),
    "wrist_1": (-0.3922, 0, 0.1333, 0, 0, 0),
    "wrist_2": (0, -0.0997, 0, HALF, 0, 0),
    "wrist_3": (0, 0.0996, 0, HALF, 2 * HALF, 2 * HALF),
}


def frames(rows: dict[str, tuple[float, ...]]) -> dict:
    return {link: dict(zip(UR_KEYS, map(float, row), strict=True)) for link, row in rows.items()}


def written(folder: Path, content: object) -> Path:
    path = folder / "my_robot.yaml"
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    return path


def test_the_makers_table_by_file_is_the_shipped_arm(tmp_path: Path) -> None:
    arm, shipped = load_arm(written(tmp_path, {"kinematics": frames(NOMINAL)})), load_arm("ur5e")
    q = np.random.default_rng(0).uniform(shipped.nominal.lower, shipped.nominal.upper, (100, 6))
    np.testing.assert_allclose(pose_error(forward(shipped.nominal, q), forward(arm.nominal, q)), 0, atol=5e-9)


@pytest.mark.parametrize("seed", range(5))
def test_a_calibrated_robot_moves_as_its_frames_say(tmp_path: Path, seed: int) -> None:
    """Off by millimetres and tenths of a degree in all six numbers of every link."""
    rng = np.random.default_rng(seed)
    rows = {link: np.add(row, rng.normal(size=6) * 3e-3) for link, row in NOMINAL.items()}
    arm = load_arm(written(tmp_path, {"kinematics": {**frames(rows), "hash": "calib_123"}}))
    assert arm.name == "my_robot" and "calib_123" in arm.source and "limits and speeds are those of ur10e" in arm.source
    joints = rng.uniform(-np.pi, np.pi, (20, 6))
    positions, rotations = [], []
    for q in joints:
        whole = np.eye(4)
        for value, row in zip(q, rows.values(), strict=True):
            step = np.eye(4)
            step[:3, :3] = (Rotation.from_euler("xyz", row[3:]) * Rotation.from_euler("z", value)).as_matrix()
            step[:3, 3] = row[:3]
            whole = whole @ step
        positions.append(whole[:3, 3])
        rotations.append(whole[:3, :3])
    expected = Pose(np.array(positions), np.array(rotations))
    np.testing.assert_allclose(pose_error(expected, forward(arm.nominal, joints)), 0, atol=1e-9)


def test_what_is_no_such_file_gets_one_sentence(tmp_path: Path) -> None:
    whole = frames(NOMINAL)
    lacking = {**whole, "wrist_1": {"x": 0.0}}
    words = {**whole, "wrist_1": {**whole["wrist_1"], "yaw": "north"}}
    far = {**whole, "wrist_1": {**whole["wrist_1"], "x": 1e4}}
    cases = [
        ({"joints": 3}, "has no 'kinematics'; give a UR kinematics file"),
        ([1, 2], "has no 'kinematics'"),
        ({"kinematics": {link: whole[link] for link in UR_LINKS[:3]}}, "'wrist_1' of kinematics lacks one of x, y"),
        ({"kinematics": lacking}, "'wrist_1' of kinematics lacks one of"),
        ({"kinematics": words}, "the yaw of wrist_1 is 'north'"),
        ({"kinematics": far}, "the x of wrist_1 is 10000"),
    ]
    for content, said in cases:
        with pytest.raises(InputError, match=said) as caught:
            load_arm(written(tmp_path, content))
        assert "\n" not in str(caught.value)
