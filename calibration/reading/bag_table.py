"""Read topics of ROS 2 bags (rosbag2 folders or .mcap files) as tables with one row per message.

Messages are decoded by the definitions of ROS 2. Definitions within a bag are not used, because rosbags would run code
that it generates from them.
"""

from __future__ import annotations

import warnings
from operator import attrgetter
from pathlib import Path
from typing import Any

from pickenv.base import InputError, is_file, listed, require
from pickenv.base.texts import parsed
from pickenv.calibration.reading import csv_table
from pickenv.calibration.reading.csv_table import Table

JOINTS = "sensor_msgs/msg/JointState"
FIELDS: dict[str, tuple[str, ...]] = {
    JOINTS: (),
    "geometry_msgs/msg/PointStamped": ("point.x", "point.y", "point.z"),
    "geometry_msgs/msg/PoseStamped": (
        *("pose.position.x", "pose.position.y", "pose.position.z"),
        *("pose.orientation.x", "pose.orientation.y", "pose.orientation.z", "pose.orientation.w"),
    ),
    "geometry_msgs/msg/TransformStamped": (
        *("transform.translation.x", "transform.translation.y", "transform.translation.z"),
        *("transform.rotation.x", "transform.rotation.y", "transform.rotation.z", "transform.rotation.w"),
    ),
}
"""Types of messages that are read, and the fields of each that become columns.

The columns of a JointState are named after its joints. All types have a header with a stamp.
"""


def read_log(
    path: Path, topic: str | None, separator: str = ",", decimal: str = ".", names: tuple[str, ...] | None = None
) -> Table:
    """Read a topic of a ROS 2 bag as a table; without a topic, read a file as `read_table` does.

    Columns of a topic are ``time`` and ``log_time``, s, and the fields of its messages. A JointState gives one column
    per joint with the joint's name, and its efforts as ``effort.NAME``.

    Args:
        path: The bag or the file.
        topic: Name of the topic; None for a file.
        separator: Character between columns of a file.
        decimal: Decimal sign of a file, "." or ",".
        names: Column names of a file without a header, or None.

    Raises:
        InputError: If the file or topic is missing, unreadable or empty, or if its type is not read.
    """
    is_bag = is_file(path / "metadata.yaml") or (path.suffix in (".mcap", ".db3") and is_file(path))
    if topic is not None and not is_bag:
        raise InputError(f"{path} is no rosbag2 folder and no .mcap file; give one, or do not name its topic")
    if topic is None and is_bag:
        raise InputError(f"{path} is a ROS bag; name its topic in [recording] of `columns`: topic, or joints_topic")
    return csv_table.read_table(path, separator, decimal, names) if topic is None else _bag_table(path, topic)


def _bag_table(path: Path, topic: str) -> Table:
    """Read one topic as a table; if its messages have no stamps, the times at which they were logged are taken."""
    require("rosbags")
    kinds, messages = parsed(lambda: _messages(path, topic), path, "rosbag2 or MCAP of ROS 2")
    if topic not in kinds:
        topics = (f"{name} ({kind})" for name, kind in sorted(kinds.items()))
        raise InputError(f"{path} has no topic '{topic}'; it has {listed(topics) or 'none'}")
    where, kind = f"topic {topic} of {path}", kinds[topic]
    if kind not in FIELDS:
        raise InputError(f"{where} holds messages of {kind}; give one of {', '.join(FIELDS)}")
    if not messages:
        raise InputError(f"{where} has no messages; record it again")
    logged, found = zip(*messages, strict=True)
    stamps = tuple(message.header.stamp.sec * 10**9 + message.header.stamp.nanosec for message in found)
    if not any(stamps):
        warnings.warn(f"{where} has no stamps; the times at which it was logged are taken", stacklevel=2)
        stamps = logged
    entries = []
    for stamp, time, message in zip(stamps, logged, found, strict=True):
        cells = {field: attrgetter(field)(message) for field in FIELDS[kind]}
        if kind == JOINTS:
            cells |= zip(message.name, message.position.tolist(), strict=False)
            cells |= {f"effort.{name}": part for name, part in zip(message.name, message.effort.tolist(), strict=False)}
        texts = {name: repr(cell) for name, cell in cells.items()}
        entries.append({"time": _seconds(stamp), "log_time": _seconds(time)} | texts)
    return csv_table.table_of_entries(where, entries)


def _messages(path: Path, topic: str) -> tuple[dict[str, str], list[tuple[int, Any]]]:
    """Return the message type of each topic of a bag, and the messages of ``topic`` with their log times, ns.

    There are no messages if the topic's type is not one of `FIELDS`.
    """
    from rosbags.rosbag2 import Reader
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    with Reader(path) as bag:
        kinds = {connection.topic: connection.msgtype for connection in bag.connections}
        publishers = [each for each in bag.connections if each.topic == topic and each.msgtype in FIELDS]
        found = bag.messages(publishers) if publishers else ()
        return kinds, [(time, store.deserialize_cdr(data, kinds[topic])) for _, time, data in found]


def _seconds(time: int) -> str:
    """Return a time in ns as decimal text in s, with all its digits."""
    return f"{time // 10**9}.{time % 10**9:09d}"
