"""The lens is OpenCV's, its derivatives are its own, and it survives its files."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from pickenv.base import InputError
from pickenv.calibration import Lens, projected, read_lens, write_lens
from pickenv.calibration.model.pixels import LENS_NAMES, by_point, by_values, undistorted
from pickenv.calibration.reading.description import LensTable

POINTS = np.random.default_rng(0).normal(size=(50, 3)) * (0.3, 0.3, 0.1) + (0.0, 0.0, 1.2)


def test_projection_is_opencvs(webcam: Lens) -> None:
    fx, fy, cx, cy, *distortion = webcam.values
    matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    wanted = cv2.projectPoints(POINTS, np.zeros(3), np.zeros(3), matrix, np.array(distortion))[0].reshape(-1, 2)
    np.testing.assert_allclose(projected(webcam.values, POINTS), wanted, atol=1e-9)
    np.testing.assert_allclose(undistorted(webcam.values, wanted), POINTS[:, :2] / POINTS[:, 2:], atol=1e-9)


def test_derivatives_are_those_of_the_projection(webcam: Lens) -> None:
    h = 1e-6
    for found, step, count in (
        (by_point, lambda e: (webcam.values, POINTS + e), 3),
        (by_values, lambda e: (webcam.values + e, POINTS), 9),
    ):
        ends = [[projected(*step(sign * h * e)) for e in np.eye(count)] for sign in (1, -1)]
        central = (np.stack(ends[0], -1) - np.stack(ends[1], -1)) / (2 * h)
        np.testing.assert_allclose(found(webcam.values, POINTS), central, atol=1e-5)


def test_files_keep_every_digit(webcam: Lens, tmp_path: Path) -> None:
    found = read_lens(write_lens(webcam, tmp_path / "webcam.yaml"))
    np.testing.assert_array_equal(found.values, webcam.values)
    assert found.size == webcam.size and found.name == "webcam"


def test_we_read_what_opencv_writes(tmp_path: Path) -> None:
    theirs = cv2.FileStorage(str(tmp_path / "theirs.yaml"), cv2.FILE_STORAGE_WRITE)
    theirs.write("image_width", 800)
    theirs.write("image_height", 600)
    theirs.write("camera_matrix", np.array([[500.25, 0, 400], [0, 501, 300], [0, 0, 1]]))
    theirs.write("distortion_coefficients", np.array([[0.1, 0.2, 0.3, 0.4]]))
    theirs.release()
    found = read_lens(tmp_path / "theirs.yaml")
    np.testing.assert_array_equal(found.values, [500.25, 501, 400, 300, 0.1, 0.2, 0.3, 0.4, 0.0])
    assert found.size == (800, 600)


def test_camera_info_is_ross(webcam: Lens, tmp_path: Path) -> None:
    content = yaml.safe_load(write_lens(webcam, tmp_path / "a.yaml").read_text())
    assert content["distortion_model"] == "plumb_bob" and content["image_width"] == 640
    assert len(content["projection_matrix"]["data"]) == 12 and content["camera_matrix"]["rows"] == 3
    assert content["distortion_coefficients"]["data"] == webcam.values[4:].tolist()
    assert LENS_NAMES[4:] == ("k1", "k2", "p1", "p2", "k3")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"distortion_model": "equidistant"}, "distortion_model 'equidistant' is not known"),
        ({"camera_matrix": None}, "'camera_matrix' is missing or holds no numbers"),
        ({"camera_matrix": {"data": [1, 2]}}, "has 2 numbers; it needs 9"),
        ({"camera_matrix": {"data": [0, 0, 1, 0, 1, 1, 0, 0, 1]}}, "focal lengths must be above zero"),
        ({"camera_matrix": {"data": [600, 0, 0, 0, 600, 0, 320, 240, 1]}}, "is written column by column"),
        ({"distortion_coefficients": {"data": [1, 2]}}, "distortion has 2 coefficients"),
        ({"distortion_coefficients": {"data": [0, 0, 0, 0, 0, 0.3, 0, 0]}}, "distortion has 8 coefficients"),
        ({"distortion_coefficients": {"data": ["x"] * 5}}, "'distortion_coefficients' is missing or holds no numbers"),
        ({"image_width": "wide"}, "'image_width' is missing"),
    ],
)
def test_bad_camera_files_are_refused(change: dict[str, object], words: str, webcam: Lens, tmp_path: Path) -> None:
    path = write_lens(webcam, tmp_path / "a.yaml")
    content = yaml.safe_load(path.read_text()) | change
    path.write_text(yaml.safe_dump(content))
    with pytest.raises(InputError, match=words):
        read_lens(path)


@pytest.mark.parametrize(("text", "words"), [("a: [1", "is not valid YAML: .* line 2"), ("[1, 2]", "holds no camera")])
def test_what_is_no_camera_file(text: str, words: str, tmp_path: Path) -> None:
    (tmp_path / "a.yaml").write_text(text + "\n")
    with pytest.raises(InputError, match=words):
        read_lens(tmp_path / "a.yaml")
    with pytest.raises(InputError, match="does not exist"):
        read_lens(tmp_path / "b.yaml")


def test_a_lens_from_a_file_has_its_own_distortion() -> None:
    with pytest.raises(InputError, match="a file and numbers as well"):
        LensTable(file="camera.yaml", distortion=(0.1, 0.0, 0.0, 0.0))
