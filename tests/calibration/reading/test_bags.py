"""A topic of a ROS 2 bag reads like a CSV file of the same numbers, and what cannot be read is named in a sentence."""

import re
import sys
from collections.abc import Callable, Sequence
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from pickenv.arm import forward, load_arm
from pickenv.base import InputError
from pickenv.calibration import Clocks, Observations, read_observations

pytest.importorskip("rosbags", reason="rosbags of the extra `recordings` is not installed")

from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

UR5 = load_arm("ur5").nominal
NAMES = ["pan", "lift", "elbow", "wrist-1", "wrist/2", "wrist 3"]
HOME = np.array([0.0, -1.2, 1.2, 0.0, 0.9, 0.0])
STORE = get_typestore(Stores.ROS2_HUMBLE)

COLUMNS = """
[recording]
time = "{time}"
unit = "s"
joints = "{joints}"
joints_time = "{joints_time}"
joints_unit = "s"
{topics}
[joints]
columns = {names}
unit = "rad"

[position]
columns = {places}
unit = "m"
std_mm = 0.03

[rotation]
columns = {turns}
convention = "quaternion_xyzw"

[conditions.torques]
columns = {torques}
"""
TOPICS = 'topic = "/tracker/pose"\njoints_topic = "/joint_states"\n'
POSE, TRANSFORM = (
    [*(f"{place}.{axis}" for axis in "xyz"), *(f"{turn}.{axis}" for axis in "xyzw")]
    for place, turn in (("pose.position", "pose.orientation"), ("transform.translation", "transform.rotation"))
)
POINT = ["point.x", "point.y", "point.z"]
CSV = ["x", "y", "z", "a", "b", "c", "d"]
Message = tuple[int, Any]


def nanoseconds(seconds: np.ndarray) -> list[int]:
    return [int(time) for time in np.rint(seconds * 1e9)]


def typed(name: str, *values: Any) -> Any:
    return STORE.types[name](*values)


def header(stamp: int) -> Any:
    time = typed("builtin_interfaces/msg/Time", stamp // 10**9, stamp % 10**9)
    return typed("std_msgs/msg/Header", time, "base")


def joint_state(stamp: int, names: Sequence[str], position: Sequence[float], effort: Sequence[float] = ()) -> Any:
    numbers = [np.array(part, dtype=float) for part in (position, (), effort)]
    return typed("sensor_msgs/msg/JointState", header(stamp), list(names), *numbers)


def pose(stamp: int, values: Sequence[float]) -> Any:
    place, turn = typed("geometry_msgs/msg/Point", *values[:3]), typed("geometry_msgs/msg/Quaternion", *values[3:])
    return typed("geometry_msgs/msg/PoseStamped", header(stamp), typed("geometry_msgs/msg/Pose", place, turn))


def transform(stamp: int, values: Sequence[float]) -> Any:
    place, turn = typed("geometry_msgs/msg/Vector3", *values[:3]), typed("geometry_msgs/msg/Quaternion", *values[3:])
    content = typed("geometry_msgs/msg/Transform", place, turn)
    return typed("geometry_msgs/msg/TransformStamped", header(stamp), "tool", content)


def point(stamp: int, values: Sequence[float]) -> Any:
    return typed("geometry_msgs/msg/PointStamped", header(stamp), typed("geometry_msgs/msg/Point", *values[:3]))


def write_bag(path: Path, plugin: StoragePlugin, topics: dict[str, list[Message]]) -> Path:
    """A bag of topics, each with the log time, ns, and content of its messages."""
    with Writer(path, version=9, storage_plugin=plugin) as bag:
        for topic, messages in topics.items():
            kind = messages[0][1].__msgtype__
            publisher = bag.add_connection(topic, kind, typestore=STORE)
            for time, message in messages:
                bag.write(publisher, time, STORE.serialize_cdr(message, kind))
    return path


class Motion:
    """A tracker's log and a joint log, the tracker's clock ahead by 0.083 s, both in the year 2023."""

    def __init__(self) -> None:
        rng = np.random.default_rng(4)
        way = CubicSpline(np.arange(22) - 5.0, rng.uniform(-0.9, 0.9, (22, 6)) + HOME)
        self.log, self.seen = np.arange(0.0, 10.0, 0.02), np.arange(0.4, 9.6, 0.1)
        self.joints, self.torques = way(self.log), rng.normal(size=(len(self.log), 6))
        tool = forward(UR5, way(self.seen))
        position = tool.position + 2e-5 * rng.normal(size=(len(self.seen), 3))
        self.readings = np.c_[position, Rotation.from_matrix(tool.rotation).as_quat()]
        self.stamps = [1_700_000_000 * 10**9 + time for time in nanoseconds(self.log)]
        self.sampled = [1_700_000_000 * 10**9 + 83_000_000 + time for time in nanoseconds(self.seen)]

    def joint_states(self, rng: np.random.Generator) -> list[Message]:
        """Joints in any order, and a gripper's messages among them."""
        messages = []
        for stamp, joints, torques in zip(self.stamps, self.joints, self.torques, strict=True):
            order = rng.permutation(6)
            names = [NAMES[i] for i in order]
            messages.append((stamp + 700_000, joint_state(stamp, names, joints[order], torques[order])))
            messages.append((stamp + 800_000, joint_state(stamp + 5, ["finger"], [0.02])))
        return messages

    def instrument(self, message: Callable[[int, Sequence[float]], Any] = pose) -> list[Message]:
        pairs = zip(self.sampled, self.readings.tolist(), strict=True)
        return [(stamp + 3_000_000, message(stamp, values)) for stamp, values in pairs]

    def topics(self, message: Callable[[int, Sequence[float]], Any] = pose) -> dict[str, list[Message]]:
        return {
            "/joint_states": self.joint_states(np.random.default_rng(1)),
            "/tracker/pose": self.instrument(message),
        }

    def as_csv(self, folder: Path) -> Path:
        logs = {
            "tracker.csv": ("t,x,y,z,a,b,c,d", self.sampled, self.readings),
            "joints.csv": (
                ",".join(["t", *NAMES, *(f"effort.{name}" for name in NAMES)]),
                self.stamps,
                np.c_[self.joints, self.torques],
            ),
        }
        for name, (head, stamps, values) in logs.items():
            rows = [
                ",".join([f"{stamp // 10**9}.{stamp % 10**9:09d}", *map(repr, row)])
                for stamp, row in zip(stamps, values.tolist(), strict=True)
            ]
            (folder / name).write_text("\n".join([head, *rows]), encoding="utf-8")
        return folder / "tracker.csv"


MOTION = Motion()


def described(folder: Path, columns: Sequence[str] = POSE, **changes: Any) -> Path:
    words = {"time": "time", "joints": "{file}", "joints_time": "time", "topics": TOPICS, "names": NAMES}
    words |= {"places": list(columns[:3]), "turns": list(columns[3:]), "torques": [f"effort.{name}" for name in NAMES]}
    text = COLUMNS.format(**words | changes)
    if len(columns) == 3:
        text = re.sub(r"\[rotation\].*?\n\n", "", text, flags=re.DOTALL)
    (folder / "columns.toml").write_text(text, encoding="utf-8")
    return folder / "columns.toml"


def read(path: Path, columns: Path) -> tuple[Observations, Clocks]:
    rows = read_observations([path], UR5, columns)
    assert rows.origins is not None
    return rows, rows.origins.clocks[0]


@lru_cache
def from_csv(count: int) -> tuple[Observations, Clocks]:
    """The rows of the same numbers in CSV, with so many columns of the tracker."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        columns = described(folder, CSV[:count], time="t", joints="joints.csv", joints_time="t", topics="")
        return read(MOTION.as_csv(folder), columns)


def assert_same(one: tuple[Observations, Clocks], other: tuple[Observations, Clocks]) -> None:
    (rows, clocks), (expected, wanted) = one, other
    np.testing.assert_array_equal(rows.joints, expected.joints)
    np.testing.assert_array_equal(rows.readings(), expected.readings())
    np.testing.assert_array_equal(rows.conditions.torque, expected.conditions.torque)
    found, told = ({k: v for k, v in each.as_dict().items() if k != "file"} for each in (clocks, wanted))
    assert found == told


@pytest.mark.parametrize(
    ("plugin", "message", "columns"),
    [
        (StoragePlugin.SQLITE3, pose, POSE),
        (StoragePlugin.MCAP, pose, POSE),
        (StoragePlugin.MCAP, transform, TRANSFORM),
        (StoragePlugin.SQLITE3, point, POINT),
    ],
    ids=["pose-sqlite3", "pose-mcap", "transform-mcap", "point-sqlite3"],
)
def test_a_bag_reads_as_csv(
    tmp_path: Path, plugin: StoragePlugin, message: Callable[[int, Sequence[float]], Any], columns: list[str]
) -> None:
    bag = write_bag(tmp_path / "run.2026", plugin, MOTION.topics(message))
    assert_same(read(bag, described(tmp_path, columns)), from_csv(len(columns)))


def test_two_mcap_files_read_as_csv(tmp_path: Path) -> None:
    for name, topic in (("laser_joints", "/joint_states"), ("laser", "/tracker/pose")):
        folder = write_bag(tmp_path / name, StoragePlugin.MCAP, {topic: MOTION.topics()[topic]})
        (folder / f"{name}.mcap").rename(tmp_path / f"{name}.mcap")
    rows = read(tmp_path / "laser.mcap", described(tmp_path, joints="{file}_joints.mcap"))
    assert_same(rows, from_csv(7))


def test_a_bag_goes_with_a_csv_file(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "run", StoragePlugin.MCAP, MOTION.topics())
    MOTION.as_csv(tmp_path)
    columns = described(tmp_path, joints="joints.csv", joints_time="t", topics='topic = "/tracker/pose"\n')
    assert_same(read(bag, columns), from_csv(7))


def test_where_no_stamp_is_set_the_log_tells_the_time(tmp_path: Path) -> None:
    unset = [(time, pose(0, values)) for time, values in zip(MOTION.sampled, MOTION.readings.tolist(), strict=True)]
    bag = write_bag(tmp_path / "run", StoragePlugin.MCAP, MOTION.topics() | {"/tracker/pose": unset})
    with pytest.warns(UserWarning, match=r"^topic /tracker/pose of .*run has no stamps; .* logged are taken$"):
        rows = read(bag, described(tmp_path))
    assert_same(rows, from_csv(7))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (
            {"topics": TOPICS.replace("/tracker/pose", "/laser")},
            "run has no topic '/laser'; it has /ball (geometry_msgs/msg/PointStamped), /joint_states "
            "(sensor_msgs/msg/JointState), "
            "/status (std_msgs/msg/String), /tracker/pose (geometry_msgs/msg/PoseStamped)",
        ),
        (
            {"topics": TOPICS.replace("/tracker/pose", "/status")},
            "topic /status of run holds messages of std_msgs/msg/String; give one of sensor_msgs/msg/JointState, "
            "geometry_msgs/msg/PointStamped, geometry_msgs/msg/PoseStamped, geometry_msgs/msg/TransformStamped",
        ),
        (
            {"topics": TOPICS.replace("/tracker/pose", "/ball")},
            "topic /ball of run: cannot compute 'pose.position.x': there is no column 'pose.position.x', but "
            "time, log_time, point.x, point.y, point.z",
        ),
        (
            {"topics": TOPICS.replace("/joint_states", "/tracker/pose")},
            "topic /tracker/pose of run: column 'pan' is missing; the file has time, log_time, " + ", ".join(POSE),
        ),
        (
            {"names": [*NAMES[:5], "finger"]},
            "no message of topic /joint_states of run has all of pan, lift, elbow, wrist-1, wrist/2, finger, "
            "effort.pan, effort.lift, effort.elbow, effort.wrist-1, effort.wrist/2, effort.wrist 3; "
            "record a topic where one has them all",
        ),
        (
            {"topics": ""},
            "run is a ROS bag; name its topic in [recording] of `columns`: topic, or joints_topic",
        ),
        (
            {"joints": "joints.csv"},
            "joints.csv is no rosbag2 folder and no .mcap file; give one, or do not name its topic",
        ),
        (
            {"joints": "{file}.mcap"},
            "run.mcap is no rosbag2 folder and no .mcap file; give one, or do not name its topic",
        ),
    ],
    ids=[
        "no such topic",
        "text",
        "no attitudes",
        "no joints",
        "never together",
        "no topic named",
        "CSV",
        "no such file",
    ],
)
def test_what_cannot_be_read_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, changes: dict[str, Any], words: str
) -> None:
    topics = MOTION.topics() | {
        "/ball": MOTION.instrument(point),
        "/status": [(stamp, typed("std_msgs/msg/String", "ready")) for stamp in MOTION.sampled],
    }
    write_bag(tmp_path / "run", StoragePlugin.SQLITE3, topics)
    MOTION.as_csv(tmp_path)
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError) as refused:
        read(Path("run"), described(tmp_path, **changes))
    assert str(refused.value) == words


def test_damaged_bags_are_refused(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    joints = {"/joint_states": MOTION.joint_states(rng)[:40], "/tracker/pose": MOTION.instrument()[:20]}
    for plugin, ending in ((StoragePlugin.MCAP, "mcap"), (StoragePlugin.SQLITE3, "db3")):
        file = write_bag(tmp_path / ending, plugin, joints) / f"{ending}.{ending}"
        whole = file.read_bytes()
        for _ in range(60):
            damaged = bytearray(whole)
            for place in rng.integers(0, len(whole), 20):
                damaged[place] = rng.integers(256)
            file.write_bytes(damaged[: rng.integers(1, len(whole) + 1)] if rng.random() < 0.3 else damaged)
            with pytest.raises(InputError):  # 20 samples are too few, if all of them can be read
                read(tmp_path / ending, described(tmp_path))


def test_without_the_package_its_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bag = write_bag(tmp_path / "run", StoragePlugin.MCAP, MOTION.topics())
    monkeypatch.setitem(sys.modules, "rosbags", None)
    with pytest.raises(InputError, match=re.escape("pip install 'pickenv[recordings]'")):
        read(bag, described(tmp_path))
