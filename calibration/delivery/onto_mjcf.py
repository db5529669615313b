"""A calibration onto a robot's own MJCF: pos and quat of the bodies that joints move change, and no other byte.

Written against MJCF as MuJoCo 3 reads it. An orientation told otherwise (euler, axisangle, xyaxes, zaxis) becomes a
quat in the same place. What a file includes is not changed: the bodies must stand in the file itself. Metres.
"""

from __future__ import annotations

from pathlib import Path, PurePosixPath

import numpy as np
from scipy.spatial.transform import Rotation

from pickenv.arm.files.mjcf import mjcf_row
from pickenv.arm.files.mjcf_values import ORIENTATIONS, MjcfValues, truth
from pickenv.arm.files.xml_values import numbers_text, xml_root
from pickenv.arm.kinematics.geometry import Pose, behind, inverse_pose
from pickenv.calibration.delivery.origin_lines import Document
from pickenv.calibration.delivery.patched import correction, is_moved, own_origin, refuse_lost_files
from pickenv.calibration.delivery.xml_edit import (
    Edit,
    StartTag,
    attribute_edits,
    attribute_spans,
    edited,
    start_tags,
)
from pickenv.calibration.pipeline.calibration import Calibration
from pickenv.errors import InputError
from pickenv.texts import shortened


def onto_mjcf(calibration: Calibration, path: Path, tip: str | None, out: Path) -> Document:
    """The text of an MJCF with its bodies where the calibration found them.

    Args:
        calibration: Of the same arm, whatever frames its table has.
        path: The file.
        tip: Last body or site; the flange when left out.
        out: Where it will be written, from where its meshes must be found.

    Raises:
        InputError: If the file is unusable, of another arm, its bodies stand elsewhere, or its meshes would be lost.
    """
    row = mjcf_row(path, tip)
    found = correction(calibration, row, path)
    values = MjcfValues.of(xml_root(path, "MJCF (.xml)"))
    data = path.read_bytes()
    tags = start_tags(data)
    refuse_lost_files(path, out, _files(tags))
    edits: list[Edit] = []
    taken: set[str] = set()
    for joint, new in zip(row.joints, found.chain.origins, strict=True):
        if not any(is_moved(joint.origin, new)):
            continue
        if joint.body in taken:
            raise InputError(
                f"{path}: joint '{shortened(joint.name)}' is the second of body '{shortened(joint.body)}', whose place "
                "cannot hold corrections of both; give each joint a body of its own"
            )
        tag, place = _named(tags, "body", joint.body, path), Pose(joint.within, np.eye(3))
        corrected = own_origin(behind(values.pose(tag.attributes), place), joint.origin, new)
        edits += _moved(data, tag, values, behind(corrected, inverse_pose(place)))
        taken.add(joint.body)
    if found.mount is not None and row.mount is not None:
        kind, _, name = row.mount.rpartition(" ") if row.mount.startswith("site ") else ("body", "", row.mount)
        tag = _named(tags, kind, name, path)
        edits += _moved(data, tag, values, own_origin(values.pose(tag.attributes), row.tool, found.mount))
    return Document(edited(data, edits), found.notes)


def _named(tags: list[StartTag], kind: str, name: str, path: Path) -> StartTag:
    """The body or site of that name in the file itself."""
    found = [tag for tag in tags if tag.name == kind and tag.attributes.get("name") == name]
    if found:
        return found[0]
    if any(tag.name == "include" for tag in tags):
        raise InputError(
            f"{path}: {kind} '{shortened(name)}' stands in a file that it includes, and only {path.name} would be "
            "written; give --onto a model in one file, as MuJoCo saves it"
        )
    raise InputError(f"{path}: {shortened(name)} has no name of its own to be found by; name every body of the arm")


def _moved(data: bytes, tag: StartTag, values: MjcfValues, new: Pose) -> list[Edit]:
    """What gives a body a new place; what does not change keeps its text."""
    position, turned = is_moved(values.pose(tag.attributes), new)
    written = {"pos": numbers_text(new.position)} if position else {}
    told = next((key for key in ORIENTATIONS if key in tag.attributes), "quat")
    edits: list[Edit] = []
    if turned:
        *xyz, w = Rotation.from_matrix(np.asarray(new.rotation)).as_quat(canonical=True)
        quat = numbers_text([w, *xyz])
        if told == "quat":
            written["quat"] = quat
        else:
            start, _, end = attribute_spans(data, tag)[0][told]
            edits.append(Edit(start, end + 1, f'quat="{quat}"'.encode()))
    return edits + attribute_edits(data, tag, written)


def _files(tags: list[StartTag]) -> list[str]:
    """Meshes and included files that a model names, from its own folder."""
    compiler: dict[str, str] = {}
    for tag in tags:
        if tag.name == "compiler":
            compiler |= tag.attributes
    folder = compiler.get("meshdir", compiler.get("assetdir", ""))
    strips = truth(compiler.get("strippath", "false"))
    found = []
    for tag in tags:
        name = tag.attributes.get("file", "")
        if tag.name == "mesh" and name:
            found.append(str(PurePosixPath(folder) / (PurePosixPath(name).name if strips else name)))
        elif tag.name == "include":
            found.append(name)
    return found
