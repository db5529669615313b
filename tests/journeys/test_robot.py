"""A calibration → the robot's own files → MuJoCo, as docs/applying-a-calibration.md prints it, in an empty folder.

The last number on the screen is how far MuJoCo's flange is from the calibration's, mm (simulated SO-101).
"""

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pickenv.arm import Geometry, forward, load_arm
from pickenv.calibration import Calibration, Measurements, random_joints

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs/applying-a-calibration.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```(\w+)\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)
ENVIRONMENT = os.environ | {"PYTHONPATH": str(ROOT), "MPLBACKEND": "Agg"}
LINKS = re.compile(r"\]\(([^)\s#]+)(?:#[^)]*)?\)")

pytestmark = pytest.mark.slow


def run(words: list[str], folder: Path) -> str:
    done = subprocess.run(words, cwd=folder, env=ENVIRONMENT, capture_output=True, text=True)
    assert done.returncode == 0, f"{shlex.join(words)}\n{done.stdout}\n{done.stderr}"
    return done.stdout


def pickenv(line: str, folder: Path) -> str:
    return run([sys.executable, "-m", "pickenv.cli", *shlex.split(line)[1:]], folder)


def measure(arm: Geometry, rng: np.random.Generator, path: Path) -> None:
    """What a registered tracker sees of an arm whose zeros are a degree off and whose links are 0.5 mm off."""
    size = arm.links
    true = replace(
        arm,
        alpha=arm.alpha + rng.normal(size=size) * 2e-3,
        a=arm.a + rng.normal(size=size) * 5e-4,
        theta=arm.theta + rng.normal(size=size) * 0.02,
        d=arm.d + rng.normal(size=size) * 5e-4,
    )
    joints = random_joints(arm, 120, rng)
    pose = forward(true, joints)
    seen = pose.position + rng.normal(size=pose.position.shape) * 2e-4
    Measurements(joints, seen, pose.rotation, arm.prismatic, 2e-4, 1e-3, frames="known").write_csv(path)


def apart_in_mujoco(urdf: Path, tip: str, arm: Geometry) -> float:
    """How far MuJoCo's body lies from the arm's tool at most, mm."""
    import mujoco

    spec = mujoco.MjSpec.from_file(str(urdf))
    spec.compiler.fusestatic = False  # keeps links on fixed joints
    model = spec.compile()
    data = mujoco.MjData(model)
    joints = np.random.default_rng(0).uniform(arm.lower, arm.upper, (200, arm.joints))
    found = []
    for row in joints:
        for joint, value in zip(arm.joint_names, row, strict=True):
            data.joint(joint).qpos = value
        mujoco.mj_kinematics(model, data)
        found.append(data.body(tip).xpos.copy())
    return 1e3 * float(np.linalg.norm(found - forward(arm, joints).position, axis=1).max())


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, data_folder: Path) -> Path:
    """An empty folder with the files that an owner has: the makers' of the robot, the measurements, a UR's."""
    pytest.importorskip("mujoco", reason="MuJoCo is the referee: pip install mujoco")
    folder, rng = tmp_path_factory.mktemp("owner"), np.random.default_rng(7)
    own = data_folder / "so101"
    shutil.copytree(own / "assets", folder / "assets")
    shutil.copy(own / "so101_new_calib.urdf", folder / "robot.urdf")
    shutil.copy(own / "so101_new_calib.xml", folder / "robot.xml")
    arm, ur5 = load_arm(folder / "robot.urdf"), load_arm("ur5")
    measure(arm.nominal, rng, folder / "measured.csv")
    measure(ur5.nominal, rng, folder / "ur.csv")
    names = (*arm.nominal.joint_names, "gripper")
    motors = {
        name: {"id": i + 1, "drive_mode": 0, "homing_offset": 100 * i, "range_min": 800, "range_max": 3300}
        for i, name in enumerate(names)
    }
    (folder / "follower.json").write_text(json.dumps(motors, indent=4))
    joints = "".join(f'<joint name="{name}"><param name="id">{i + 1}</param></joint>' for i, name in enumerate(names))
    control = f'<robot name="r"><ros2_control name="arm" type="system">{joints}</ros2_control></robot>'
    (folder / "robot.ros2_control.xacro").write_text(control)
    pickenv("pickenv calibrate ur.csv --arm ur5 --frames known --terms none --residual none --out my_ur.npz", folder)
    rows, numbers = ("shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3"), ur5.nominal
    lines = ["kinematics:"]
    for i, row in enumerate(rows):  # modified DH rows are a UR's origins: Rx(alpha) Tx(a), then d along the new z
        y, z = -np.sin(numbers.alpha[i]) * numbers.d[i], np.cos(numbers.alpha[i]) * numbers.d[i]
        values = {"x": numbers.a[i], "y": y, "z": z, "roll": numbers.alpha[i], "pitch": 0.0, "yaw": 0.0}
        lines += [f"  {row}:", *(f"    {key}: {float(value):.17f}" for key, value in values.items())]
    (folder / "default_kinematics.yaml").write_text("\n".join([*lines, "  hash: calib_1"]) + "\n")
    return folder


def test_every_block_runs_and_the_robot_stands_where_the_calibration_says(folder: Path) -> None:
    assert {kind for kind, _ in BLOCKS} == {"sh"}
    for _, text in BLOCKS:
        for line in text.splitlines():
            assert shlex.split(line)[0] == "pickenv"
            told = pickenv(line, folder)
            out = re.search(r"--out (\S+)", line)[1]
            assert (folder / out).exists() and f"wrote {out}" in told
            if "offsets" in line or "ros2-control" in line or "follower" in line:
                assert re.search(r"with these offsets \d\.?\d* mm and \d\.?\d* deg", told)
    calibrated = Calibration.load(folder / "my_arm.npz").identified
    assert apart_in_mujoco(folder / "robot.urdf", "gripper_link", calibrated) > 3.0
    assert apart_in_mujoco(folder / "patched.urdf", "gripper_link_calibrated", calibrated) < 1e-5
    np.testing.assert_allclose(
        forward(load_arm(folder / "patched.xml").nominal, np.zeros(5)).position,
        forward(load_arm(folder / "patched.urdf").nominal, np.zeros(5)).position,
        atol=1e-5,  # the makers' two files differ in their last digits
    )


def test_files_linked_exist() -> None:
    assert [link for link in LINKS.findall(PAGE) if "://" not in link and not (ROOT / "docs" / link).exists()] == []
