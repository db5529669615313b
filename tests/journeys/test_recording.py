"""An owner's logs of a moving arm → calibrated arm: the planted offset of the clocks is on the screen."""

import json
import os
import re
import subprocess
import sys
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from pickenv.arm import forward, load_plant

ROOT = Path(__file__).parents[2]
FORMATS = (ROOT / "docs/column-descriptions.md").read_text(encoding="utf-8")
OFFSET, NOISE = 0.083, 3e-5

pytestmark = pytest.mark.slow


def write_csv(folder: Path, log: np.ndarray, joints: np.ndarray, seen: np.ndarray, position: np.ndarray) -> str:
    """Both logs as CSV files, and the page's description of them; returns the instrument's file."""
    header = "stamp,j1,j2,j3,j4,j5,j6"
    np.savetxt(folder / "joints.csv", np.c_[log * 1e3, np.degrees(joints)], "%.7f", ",", header=header, comments="")
    np.savetxt(folder / "tracker.csv", np.c_[seen, position * 1e3], "%.7f", ",", header="t,x,y,z", comments="")
    joint_columns = '[joints]\ncolumns = ["j1", "j2", "j3", "j4", "j5", "j6"]\nunit = "deg"\n'
    (folder / "recording.toml").write_text(example("recording.toml") + joint_columns, encoding="utf-8")
    return "tracker.csv"


def write_bag(folder: Path, log: np.ndarray, joints: np.ndarray, seen: np.ndarray, position: np.ndarray) -> str:
    """Both logs as topics of a bag, and the page's description of them; returns the bag."""
    pytest.importorskip("rosbags", reason="rosbags of the extra `recordings` is not installed")
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    (folder / "recording.toml").write_text(example("bag.toml"), encoding="utf-8")
    told = tomllib.loads(example("bag.toml"))
    store = get_typestore(Stores.ROS2_HUMBLE)
    made = store.types

    def header(time: float) -> Any:
        stamp = made["builtin_interfaces/msg/Time"](int(time), int(time % 1 * 1e9))
        return made["std_msgs/msg/Header"](stamp, "base")

    empty, names = np.array([]), told["joints"]["columns"]
    messages = [
        ("joints_topic", time, made["sensor_msgs/msg/JointState"](header(time), names, values, empty, empty))
        for time, values in zip(log, joints, strict=True)
    ] + [
        ("topic", time, made["geometry_msgs/msg/PointStamped"](header(time), made["geometry_msgs/msg/Point"](*values)))
        for time, values in zip(seen, position, strict=True)
    ]
    with Writer(folder / "run1", version=9, storage_plugin=StoragePlugin.MCAP) as bag:
        publishers = {
            key: bag.add_connection(told["recording"][key], kind, typestore=store)
            for key, kind in {key: message.__msgtype__ for key, _, message in messages}.items()
        }
        for key, time, message in messages:
            bag.write(publishers[key], int(time * 1e9) + 10**6, store.serialize_cdr(message, message.__msgtype__))
    return "run1"


def example(name: str) -> str:
    """A description that stands on the page."""
    text = re.search(rf"^```toml {name}\n(.*?)^```$", FORMATS, re.MULTILINE | re.DOTALL)
    assert text is not None
    return text[1]


@pytest.mark.parametrize("write", [write_csv, write_bag])
def test_two_logs_calibrate_an_arm(tmp_path: Path, write: Callable[..., str]) -> None:
    rng = np.random.default_rng(8)
    plant = load_plant("cobot:ur5e")
    places = rng.uniform(-0.8, 0.8, (72, 6)) + np.array([0.0, -1.2, 1.2, 0.0, 0.9, 0.0])
    way = CubicSpline(np.arange(72) - 5.0, places)
    log, seen = np.arange(0.0, 60.0, 0.008), np.arange(0.5, 59.5, 0.031)
    # Not `simulated_tracker`: its arm stops for each reading, not quite arrived, which looks like a later clock.
    position = forward(plant.geometry, way(seen)).position + NOISE * rng.normal(size=(len(seen), 3))
    file = write(tmp_path, log, way(log), seen + OFFSET, position)
    words = f"calibrate --arm ur5e --columns recording.toml {file} --out my_arm.npz --json my_arm.json"
    environment = os.environ | {"PYTHONPATH": str(ROOT), "MPLBACKEND": "Agg"}
    command = [sys.executable, "-m", "pickenv.cli", *words.split()]
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.startswith(("verdict: GOOD", "verdict: WITH CARE"))
    screen = " ".join(done.stdout.split())
    said = re.search(r"from \d+ rows of motion; its clock is ([\d.]+) ± ([\d.]+) ms ahead", screen)
    assert said is not None, done.stdout
    offset, std = map(float, said.groups())
    (recorded,) = json.loads((tmp_path / "my_arm.json").read_text(encoding="utf-8"))["recordings"]
    assert recorded["offset_ms"] == pytest.approx(offset, abs=std)
    assert recorded["rows_from"] == "motion"
    assert abs(recorded["offset_ms"] - 1e3 * OFFSET) < 3.0 * recorded["offset_std_ms"]
    assert recorded["offset_std_ms"] < 2.0
