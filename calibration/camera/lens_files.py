"""A camera's lens in the files that others write: ROS camera_info YAML and OpenCV's own YAML, in and out.

Written against ROS 2's camera_calibration_parsers (plumb_bob) and OpenCV's FileStorage, YAML 1.0.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

import numpy as np

from pickenv.arm.kinematics.geometry import Array
from pickenv.calibration.model.lens import Lens
from pickenv.errors import InputError
from pickenv.files import write_text
from pickenv.texts import is_file, read_text

LensFormat = Literal["ros", "opencv"]
MATRIX = ("camera_matrix", "cameraMatrix", "K")
DISTORTION = ("distortion_coefficients", "distCoeffs", "D")
MODELS = ("plumb_bob", "opencv5")
"""What ROS calls the distortion of `pickenv.calibration.model.lens`."""
COEFFICIENTS = 5


def read_lens(path: str | Path) -> Lens:
    """Read a lens from a ROS camera_info file or an OpenCV file (.yaml, .yml).

    Raises:
        InputError: If the file is missing, is neither, or has another kind of distortion.
    """
    path = Path(path)
    if not is_file(path):
        raise InputError(f"camera file {path} does not exist; give a ROS camera_info or OpenCV YAML file")
    text = read_text(path, "a camera file")
    if text.startswith("%YAML:1.0"):  # OpenCV's header is no YAML
        text = text.partition("\n")[2]
    found = _content(text, path)
    if not isinstance(found, dict):
        raise InputError(f"{path}: holds no camera; give a ROS camera_info or OpenCV YAML file")
    model = found.get("distortion_model", "plumb_bob")
    if model not in MODELS:
        raise InputError(f"{path}: distortion_model '{model}' is not known; give a camera calibrated with plumb_bob")
    matrix, distortion = _numbers(path, found, MATRIX), _numbers(path, found, DISTORTION)
    if matrix.size != 9:
        raise InputError(f"{path}: the camera matrix has {matrix.size} numbers; it needs 9")
    if distortion.size < 4 or np.any(distortion[COEFFICIENTS:]):
        raise InputError(f"{path}: distortion has {distortion.size} coefficients; give k1, k2, p1, p2 and, if any, k3")
    matrix = matrix.reshape(3, 3)
    if not (matrix[0, 0] > 0 and matrix[1, 1] > 0 and matrix[2, 2] == 1.0):
        raise InputError(f"{path}: the camera matrix is none: focal lengths must be above zero, and its last number 1")
    values = np.array([matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2], *np.resize(distortion, 4), 0.0])
    if distortion.size >= COEFFICIENTS:
        values[8] = distortion[4]
    return Lens(
        values, (_size(path, found, "width"), _size(path, found, "height")), str(found.get("camera_name", path.stem))
    )


def write_lens(lens: Lens, path: str | Path, form: LensFormat = "ros") -> Path:
    """Write a lens as ROS camera_info YAML, or as OpenCV's, whole or not at all; all digits are kept."""
    import yaml

    fx, fy, cx, cy, *distortion = (float(value) for value in lens.values)
    matrix = [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0]
    width, height = lens.size
    if form == "opencv":
        lines = ["%YAML:1.0", "---", f"image_width: {width}", f"image_height: {height}"]
        for name, rows, values in (("camera_matrix", 3, matrix), ("distortion_coefficients", 1, distortion)):
            lines += [f"{name}: !!opencv-matrix", f"   rows: {rows}", f"   cols: {len(values) // rows}", "   dt: d"]
            lines.append(f"   data: {values!r}")
        return write_text(Path(path), "\n".join(lines) + "\n")
    projection = [fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0]
    content: dict[str, Any] = {
        "image_width": width,
        "image_height": height,
        "camera_name": lens.name,
        "camera_matrix": {"rows": 3, "cols": 3, "data": matrix},
        "distortion_model": "plumb_bob",
        "distortion_coefficients": {"rows": 1, "cols": COEFFICIENTS, "data": distortion},
        "rectification_matrix": {"rows": 3, "cols": 3, "data": np.eye(3).ravel().tolist()},
        "projection_matrix": {"rows": 3, "cols": 4, "data": projection},
    }
    return write_text(Path(path), yaml.safe_dump(content, sort_keys=False, default_flow_style=None))


def _content(text: str, path: Path) -> Any:
    """What YAML holds that also knows OpenCV's matrices."""
    import yaml  # late: a camera file is read once

    class Loader(yaml.SafeLoader):
        """A safe loader, with one harmless tag more."""

    def matrix(loader: yaml.SafeLoader, node: yaml.MappingNode) -> Any:
        return loader.construct_mapping(node, deep=True)

    Loader.add_constructor("tag:yaml.org,2002:opencv-matrix", matrix)
    try:
        return yaml.load(text, Loader)
    except yaml.YAMLError as error:
        place = getattr(error, "problem_mark", None)
        where = f", line {place.line + 1}" if place is not None else ""
        raise InputError(f"{path}{where}: is not YAML; give a ROS camera_info or OpenCV YAML file") from error


def _numbers(path: Path, found: dict[str, Any], names: tuple[str, ...]) -> Array:
    """The numbers of a matrix under one of its names."""
    given = next((found[name] for name in names if name in found), None)
    values = given.get("data") if isinstance(given, dict) else given
    try:
        numbers = np.asarray(values, dtype=float).ravel()
    except (TypeError, ValueError):
        numbers = np.array([np.nan])
    if given is None or not np.isfinite(numbers).all():
        raise InputError(f"{path}: '{names[0]}' is missing or holds no numbers; give a ROS camera_info or OpenCV file")
    return numbers


def _size(path: Path, found: dict[str, Any], side: str) -> int:
    value = found.get(f"image_{side}")
    if not isinstance(value, int) or value < 1:
        raise InputError(f"{path}: 'image_{side}' is missing; give the size of the pictures that the lens is for")
    return value
