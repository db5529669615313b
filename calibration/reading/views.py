"""Views of a board: pictures with the arm's joints or finished poses beside them, or a table of corners found in them.

Every view is named by its picture, or by the line where its corners begin. What a picture shows is found when it is
read (`pickenv.calibration.camera.corners`), and a picture that shows nothing is refused by name.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pickenv.arm import Geometry, Pose
from pickenv.arm.kinematics.geometry import Array
from pickenv.calibration.camera.boards import Board, Grey, opencv
from pickenv.calibration.camera.corners import FoundCorners, find_corners, no_corners
from pickenv.calibration.camera.lens_files import read_lens
from pickenv.calibration.model.finished_poses import joints_of_finished_poses
from pickenv.calibration.model.lens import LENS_NAMES, Lens
from pickenv.calibration.model.observations import origins_of
from pickenv.calibration.model.origins import Origins
from pickenv.calibration.model.pixels import PixelObservations
from pickenv.calibration.reading.conventions import rotations
from pickenv.calibration.reading.csv_table import Table, read_table
from pickenv.calibration.reading.description import ColumnDescription, joint_scales
from pickenv.calibration.reading.description_file import LensTable, PixelsTable
from pickenv.calibration.reading.row_checks import (
    refuse_duplicates,
    refuse_implausible_joints,
    refuse_repeated_joints,
)
from pickenv.errors import InputError
from pickenv.texts import read_text, yaml_content
from pickenv.toml_tables import TO_SI

STEM = "{file}"
"""In the pattern of a picture's path: the name of the file that the view's pose stands in, without its ending."""

MANY_BLIND = 0.25
"""If more pictures than this share show no corner, something is wrong with all of them."""

DEFAULT_STD = 0.3
"""px; of corners in a table that states none."""


def read_views(paths: Sequence[str | Path], geometry: Geometry, description: ColumnDescription) -> PixelObservations:
    """Read views of a board.

    Args:
        paths: CSV or YAML files, or one folder, whose files are found by the description's ``files``.
        geometry: The arm's nominal geometry, for joint count and types; finished poses bring their own.
        description: The description, with [pixels], [board] and [camera].

    Raises:
        InputError: Names the file, row, column or picture at fault.
    """
    whole = description.views
    assert whole is not None and whole.pixels is not None and whole.board is not None and whole.camera is not None
    if len(paths) != 1:
        raise InputError(f"views of a board are given as one file or folder, not as {len(paths)}; give one")
    path = Path(paths[0])
    table, home = _table(path, whole.pixels, description)
    camera = _lens(whole.camera, home)
    joints = _joints(table, geometry, description)
    pictures: list[Path] = []
    if whole.pixels.position:
        rows, found = _found_in_table(table, whole.pixels, whole.board, camera)
        joints = joints[rows]
    else:
        pictures = _pictures(table, whole.pixels, home)
        rows, found = list(range(len(table.lines))), _found_in_pictures(table, whole.board, pictures)
    if whole.poses is None:
        refuse_repeated_joints([description], joints, geometry)
    for row, view in zip(rows, found, strict=True):
        if view.size != camera.size:
            raise InputError(
                f"{table.where}: row {table.lines[row]}: the picture has {view.size[0]} x {view.size[1]} px, but the "
                f"lens is for {camera.size[0]} x {camera.size[1]}; give the camera's numbers at this resolution"
            )
    found_views = PixelObservations(
        joints=joints,
        corners=np.stack([view.pixels for view in found]),
        seen=np.stack([view.seen for view in found]),
        board=whole.board.corners,
        camera=camera,
        lens_std=_lens_std(whole.camera),
        std=np.stack(
            [view.std if whole.pixels.std_px is None else np.full_like(view.std, whole.pixels.std_px) for view in found]
        ),
        mount=whole.pixels.mount,
        source=table.where,
        remarks=np.array([view.remark for view in found]),
        pictures=np.array([str(path) for path in pictures]) if pictures else None,
        origins=Origins(
            (table.where,), np.zeros(len(rows), dtype=np.int64), np.array(table.lines, dtype=np.int64)[rows]
        ),
    )
    refuse_duplicates(joints, found_views, origins_of(found_views))
    return found_views


def _table(path: Path, pixels: PixelsTable, description: ColumnDescription) -> tuple[Table, Path]:
    """The views as rows, and the folder that pictures' paths start from."""
    if not path.is_dir():
        return read_table(path, description.separator, description.decimal, description.names), path.parent
    if pixels.files is None:
        raise InputError(f"{path} is a folder; give a file, or say in [pixels] which files it holds (files)")
    files = sorted(path.glob(pixels.files), key=_by_number)
    if not files:
        raise InputError(f"{path} holds no file {pixels.files}; give another folder, or correct files of [pixels]")
    entries = [_entry(file) for file in files]
    header = [*dict.fromkeys(name for entry in entries for name in entry)]
    rows = [[entry.get(name, "") for name in header] for entry in entries]
    return Table(str(path), header, rows, list(range(1, len(rows) + 1)), "."), path


def _entry(file: Path) -> dict[str, str]:
    """A small YAML file of one view's numbers, and its name as column "file"."""
    found = yaml_content(read_text(file, "a YAML file"), file)
    entry = {str(key): str(value) for key, value in found.items()} if isinstance(found, dict) else {}
    if not entry:
        raise InputError(f"{file} holds no numbers by name; give one file per view with the pose in it")
    return entry | {"file": file.stem}


def _by_number(file: Path) -> list[tuple[int, str]]:
    """2.yaml before 10.yaml."""
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", file.name)]


def _joints(table: Table, geometry: Geometry, description: ColumnDescription) -> Array:
    """Joints of every row, or those of the arm that carries finished poses."""
    poses = description.views.poses if description.views else None
    if poses is None:
        columns = []
        for i, scale in enumerate(joint_scales(description, geometry)):
            columns.append(table.value(description.joints[i]) * scale)
            refuse_implausible_joints(
                table, geometry, i, columns[-1], description.joints[i], description.joint_units[i]
            )
        return np.stack(columns, -1)
    turned = rotations(poses.convention, table.values(poses.rotation) * TO_SI[poses.rotation_unit])
    return joints_of_finished_poses(Pose(table.values(poses.position) * TO_SI[poses.unit], turned))


def _pictures(table: Table, pixels: PixelsTable, home: Path) -> list[Path]:
    """The path of each row's picture."""
    assert pixels.picture is not None
    if STEM in pixels.picture:
        return [home / pixels.picture.replace(STEM, stem) for stem in table.texts("file")]
    return [home / name for name in table.texts(pixels.picture)]


def _found_in_pictures(table: Table, board: Board, pictures: Sequence[Path]) -> list[FoundCorners]:
    """The corners in each row's picture.

    A few pictures that show no corner are kept, with the reason, to be listed; many mean another board.
    """
    found, blind = [], []
    for path, line in zip(pictures, table.lines, strict=True):
        if not path.is_file():
            raise InputError(f"{table.where}: row {line}: picture {path} does not exist; correct or remove the row")
        picture = _grey(path)
        try:
            found.append(find_corners(board, picture, str(path)))
        except InputError as error:
            blind.append(error)
            height, width = picture.shape
            found.append(no_corners(board, (width, height), str(error)))
    if len(blind) > MANY_BLIND * len(found):
        raise blind[0]
    return found


def _grey(path: Path) -> Grey:
    """A picture's grey values ``(h, w)``."""
    picture = opencv().imread(str(path), opencv().IMREAD_GRAYSCALE)
    if picture is None:
        raise InputError(f"{path} is no picture that OpenCV can read; give a JPEG or PNG file")
    return np.asarray(picture, dtype=np.uint8)


def _found_in_table(
    table: Table, pixels: PixelsTable, board: Board, camera: Lens
) -> tuple[list[int], list[FoundCorners]]:
    """First row and corners of each view."""
    assert pixels.view is not None and pixels.corner is not None
    views, numbers, places = table.texts(pixels.view), table.value(pixels.corner), table.values(pixels.position)
    count, rows, found = len(board.corners), [], []
    wrong = (numbers < 0) | (numbers >= count) | (numbers != np.rint(numbers))
    if wrong.any():
        row = int(np.argmax(wrong))
        raise InputError(
            f"{table.where}: row {table.lines[row]}: corner {numbers[row]:g} is none of the board's {count} (from 0); "
            "correct it or [board]"
        )
    for name in dict.fromkeys(views):
        mine = np.array([i for i, view in enumerate(views) if view == name])
        chosen = numbers[mine].astype(np.int64)
        if len(np.unique(chosen)) < len(chosen):
            raise InputError(f"{table.where}: view '{name}' has a corner twice; remove one")
        pixel, seen = np.zeros((count, 2)), np.zeros(count, dtype=bool)
        pixel[chosen], seen[chosen] = places[mine], True
        rows.append(int(mine[0]))
        found.append(FoundCorners(pixel, seen, np.full(count, DEFAULT_STD), camera.size))
    return rows, found


def _lens(given: LensTable, home: Path) -> Lens:
    if given.file is not None:
        return read_lens(home / given.file)
    values = np.zeros(len(LENS_NAMES))
    values[:4] = [value or 0.0 for value in (given.fx, given.fy, given.cx, given.cy)]
    values[4 : 4 + len(given.distortion)] = given.distortion
    return Lens(values, (given.width or 0, given.height or 0))


def _lens_std(given: LensTable) -> Array:
    """Standard uncertainty of each number of the lens: nothing, infinite, or as stated."""
    if given.lens == "prior":
        return np.array([given.prior_px] * 4 + [given.prior_distortion] * 5)
    return np.full(len(LENS_NAMES), 0.0 if given.lens == "fixed" else np.inf)
