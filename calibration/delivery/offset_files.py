"""Joint offsets as files: a table with encoder counts, and ros2_control parameters.

The arm stands at a joint's reading plus its offset (`joint_offsets`). Tables are in degrees and mm; ros2_control's
parameters in rad and m. Written against dynamixel_hardware of July 2026, whose joints take
``<param name="offset">`` and report raw minus offset.
"""

from __future__ import annotations

import csv
import io
import json
from pathlib import Path
from typing import Any

import numpy as np

from pickenv.calibration.delivery.joint_offsets import JointOffsets
from pickenv.calibration.delivery.origin_lines import Document, provenance
from pickenv.calibration.delivery.xml_edit import Edit, StartTag, edited, inserted_first, start_tags
from pickenv.calibration.pipeline.calibration import Calibration
from pickenv.errors import InputError
from pickenv.texts import decimal_number, one_line, parsed, read_text, shortened

TABLE_FORMAT = "pickenv joint offsets 1"


def offset_table(calibration: Calibration, found: JointOffsets, out: Path, counts_per_turn: int | None) -> Document:
    """The offsets as CSV, or as JSON where ``out`` ends so: what to add to each joint's reading.

    Args:
        calibration: The calibration.
        found: Its offsets.
        out: Where it will be written.
        counts_per_turn: Encoder counts per turn of a joint; gives turning joints a column of whole counts.
    """
    rows: list[dict[str, Any]] = []
    for name, slides, value, deviation in zip(found.names, found.slides, found.offsets, found.deviation, strict=True):
        scale = 1e3 if slides else float(np.degrees(1.0))
        row: dict[str, Any] = {
            "joint": name,
            "unit": "mm" if slides else "deg",
            "add_to_reading": float(value * scale),
            "standard_deviation": None if np.isnan(deviation) else float(deviation * scale),
        }
        if counts_per_turn is not None:
            row["counts"] = None if slides else round(value * counts_per_turn / (2.0 * np.pi))
        rows.append(row)
    return Document(table_bytes(rows, out, TABLE_FORMAT, (*provenance(calibration), found.note())), (found.note(),))


def table_bytes(rows: list[dict[str, Any]], out: Path, written: str, words: tuple[str, ...]) -> bytes:
    """Rows as CSV with comment lines above, or as JSON where ``out`` ends so; None is an empty cell."""
    if out.suffix.lower() == ".json":
        return (json.dumps({"format": written, "origin": list(words), "rows": rows}, indent=2) + "\n").encode()
    text = io.StringIO()
    for line in (written, *words):
        text.write(f"# {one_line(line)}\n")
    writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue().encode()


def ros2_offsets(calibration: Calibration, found: JointOffsets, onto: Path | None) -> Document:
    """The offsets as ros2_control parameters: a fragment, or within the robot's own description.

    A joint reports raw minus offset and shall report as much more as the calibration found, so that is taken off the
    offset that it has.

    Args:
        calibration: The calibration.
        found: Its offsets.
        onto: The robot's description with its ``<ros2_control>``; None writes the joints alone, without ids.

    Raises:
        InputError: If a joint is not in the description.
    """
    notes = (found.note(),)
    if onto is None:
        lines = ["<!--", *(one_line(line).replace("--", "- -") for line in provenance(calibration))]
        lines += [
            "for dynamixel_hardware of July 2026: reported = raw - offset, rad and m; take each off the offset that "
        ]
        lines[-1] += "your joint has, if any"
        lines += ["-->", "<ros2_control>"]
        for name, value in zip(found.names, found.offsets, strict=True):
            lines += [
                f'  <joint name="{_escaped(name)}">',
                f'    <param name="offset">{0.0 - float(value)!r}</param>',
                "  </joint>",
            ]
        return Document(("\n".join([*lines, "</ros2_control>"]) + "\n").encode(), notes)
    data, tags = _description(onto)
    joints = _control_joints(tags)
    edits: list[Edit] = []
    for name, value in zip(found.names, found.offsets, strict=True):
        if name not in joints:
            named = "no <ros2_control> joint at all" if not joints else f"only {', '.join(map(shortened, joints))}"
            raise InputError(
                f"{onto} has no <ros2_control> joint '{shortened(name)}', {named}; name its joints as the arm's"
            )
        place = joints[name]
        param = _offset_of(tags, place)
        if param is None:
            edits.append(inserted_first(data, tags[place], f'<param name="offset">{0.0 - float(value)!r}</param>'))
        else:
            end = data.index(b"<", param.end)
            edits.append(Edit(param.end, end, repr(_value(data[param.end : end], name, onto) - float(value)).encode()))
    return Document(edited(data, edits), notes)


def read_ros2_offsets(path: Path) -> dict[str, float]:
    """Offsets (rad, m) of the ``<ros2_control>`` joints of a robot description; 0 where a joint has none.

    Raises:
        InputError: If the file is unusable.
    """
    data, tags = _description(path)
    found = {}
    for name, place in _control_joints(tags).items():
        param = _offset_of(tags, place)
        found[name] = 0.0 if param is None else _value(data[param.end : data.index(b"<", param.end)], name, path)
    return found


def _description(path: Path) -> tuple[bytes, list[StartTag]]:
    """Bytes and elements of a robot description."""
    read_text(path, "a robot description")
    data = path.read_bytes()
    return data, parsed(lambda: start_tags(data), path, "XML")


def _control_joints(tags: list[StartTag]) -> dict[str, int]:
    """Places of the joints within ``<ros2_control>``, by name."""
    controls = {i for i, tag in enumerate(tags) if tag.name == "ros2_control"}
    return {
        tag.attributes.get("name", ""): i
        for i, tag in enumerate(tags)
        if tag.name == "joint" and tag.parent in controls
    }


def _offset_of(tags: list[StartTag], joint: int) -> StartTag | None:
    own = (tag for tag in tags if tag.parent == joint and tag.name == "param")
    return next((tag for tag in own if tag.attributes.get("name") == "offset"), None)


def _value(text: bytes, name: str, path: Path) -> float:
    value = decimal_number(text.decode().strip())
    if value is None or not np.isfinite(value):
        raise InputError(f"{path}: the offset of joint '{shortened(name)}' is no number; write one, in rad or m")
    return value


def _escaped(name: str) -> str:
    return one_line(name).replace("&", "&amp;").replace("<", "&lt;").replace('"', "&quot;")
