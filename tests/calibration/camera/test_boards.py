"""Boards are drawn where they say they are, printed at true scale, and found again; what is not found is explained."""

from __future__ import annotations

import re
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pickenv.arm import Pose
from pickenv.base import InputError
from pickenv.base.toml_tables import made
from pickenv.calibration import Board, Lens, board_picture, projected, write_board
from pickenv.calibration.camera.boards import (
    _grey_at,
    corner_std,
    find_corners,
    opencv_board,
    picture_noise,
)

BOARDS = {
    "charuco": Board(kind="charuco", columns=6, rows=8, square=0.03, marker=0.022, dictionary="5x5_100"),
    "chessboard": Board(kind="chessboard", columns=8, rows=5, square=0.03),
    "apriltags": Board(kind="apriltags", columns=4, rows=3, square=0.04, gap=0.012, dictionary="apriltag_36h11"),
}


def surrounded(board: Board, margin: int = 80) -> np.ndarray:
    return np.pad(board_picture(board), margin, constant_values=255)


@pytest.mark.parametrize("kind", BOARDS)
def test_corners_are_found_where_the_board_says(kind: str) -> None:
    board = BOARDS[kind]
    pixels, seen, _ = find_corners(board, surrounded(board), "x.png")
    wanted = board.corners[:, :2] * 120 / board.square + 80 - 0.5
    assert seen.all()
    assert np.abs(pixels - wanted).max() < 0.1


def test_corners_are_opencvs() -> None:
    np.testing.assert_allclose(
        opencv_board(BOARDS["charuco"]).getChessboardCorners(), BOARDS["charuco"].corners, atol=1e-7
    )
    tags = np.concatenate(opencv_board(BOARDS["apriltags"]).getObjPoints())
    np.testing.assert_allclose(tags, BOARDS["apriltags"].corners, atol=1e-7)


def test_a_chessboard_is_numbered_from_its_black_corner_however_it_is_held() -> None:
    board = BOARDS["chessboard"]
    picture = surrounded(board)
    upright, _, _ = find_corners(board, picture, "a.png")
    turned, _, _ = find_corners(board, np.ascontiguousarray(picture[::-1, ::-1]), "b.png")
    np.testing.assert_allclose(turned, np.array(picture.shape[::-1]) - 1 - upright, atol=0.1)


@pytest.mark.parametrize("kind", BOARDS)
def test_rendered_corners_are_found_as_surely_as_is_said(
    kind: str, rendered: Callable[..., np.ndarray], webcam: Lens
) -> None:
    """Errors over their stated uncertainty scatter by about one, whatever the view."""
    board, rng = BOARDS[kind], np.random.default_rng(5)
    sizes = []
    for turn in ([0.3, 0.2, 0.1], [-0.4, 0.35, -0.2]):
        rotation = Rotation.from_rotvec(turn).as_matrix()
        middle = np.append(np.array(board.size) / 2, 0.0)
        pose = Pose(np.array([0.01, -0.005, 0.42]) - rotation @ middle, rotation)
        pixels, seen, std = find_corners(board, rendered(board, webcam, pose, rng), "x.png")
        truth = projected(webcam.values, board.corners @ rotation.T + pose.position)
        assert seen.mean() > 0.8
        sizes.append(((pixels - truth) / std[:, None])[seen])
    errors = np.concatenate(sizes)
    assert np.sqrt(np.mean(errors**2)) < 2.0
    assert np.abs(errors).max() < 8.0


def test_a_corners_uncertainty_is_noise_against_gradients() -> None:
    """A tall edge cross of known slope: s^2 (sum g g^T)^-1, by hand."""
    rng = np.random.default_rng(0)
    y, x = np.mgrid[0:41, 0:41] - 20.0
    clean = 128 + 50 * np.clip(x / 2, -1, 1) * np.clip(y / 2, -1, 1)
    noisy = clean + rng.normal(0, 2.0, clean.shape)
    gradients = np.stack([part[15:26, 15:26].ravel() for part in np.gradient(noisy)[::-1]])
    worst = np.linalg.eigvalsh(gradients @ gradients.T)[0]
    wanted = np.hypot(picture_noise(noisy) / np.sqrt(worst), 0.07)
    assert corner_std(noisy, np.array([[20.0, 20.0]]), 0.07)[0] == pytest.approx(wanted)
    assert picture_noise(128 + rng.normal(0, 3.0, (200, 200))) == pytest.approx(3.0, rel=0.05)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda p: np.ascontiguousarray(p[:, ::-1]), "it is mirrored"),
        (lambda p: np.full_like(p, 200), "shows no marker of 5x5_100"),
    ],
)
def test_why_nothing_was_found(change: Callable[[Any], Any], words: str) -> None:
    board = BOARDS["charuco"]
    with pytest.raises(InputError, match=words) as caught:
        find_corners(board, change(surrounded(board)), "views/7.png")
    assert str(caught.value).startswith("views/7.png: no corner of the board was found; ")


@pytest.mark.parametrize("kind", BOARDS)
def test_a_wall_shows_no_board(kind: str) -> None:
    with pytest.raises(InputError, match=r"wall\.png: no corner of the board was found"):
        find_corners(BOARDS[kind], np.full((480, 640), 128, dtype=np.uint8), "wall.png")


def test_another_board_is_named_as_such() -> None:
    shown = Board(kind="apriltags", columns=3, rows=2, square=0.03, gap=0.01, dictionary="5x5_100")
    with pytest.raises(InputError, match=r"markers of 5x5_100 \(numbers 0, 1, 2, 3, 4\), but of another board"):
        find_corners(BOARDS["charuco"], surrounded(shown), "7.png")


@pytest.mark.parametrize(("number", "words"), [(23, "too few to tell a corner"), (24, "but of another board")])
def test_one_marker_is_of_the_board_if_the_board_has_its_number(number: int, words: str) -> None:
    """A board of 6 by 8 squares has the markers 0 to 23."""
    cv2 = pytest.importorskip("cv2")
    marker = cv2.aruco.generateImageMarker(opencv_board(BOARDS["charuco"]).getDictionary(), number, 120)
    with pytest.raises(InputError, match=words):
        find_corners(BOARDS["charuco"], np.pad(marker, 150, constant_values=255), "7.png")


def test_pages_keep_the_scale(tmp_path: Path) -> None:
    board = BOARDS["charuco"]
    path = write_board(board, tmp_path / "board.pdf", margin=0.015)
    content = path.read_bytes()
    box = re.search(rb"/MediaBox \[ ?0 0 ([\d.]+) ([\d.]+) ?\]", content)
    assert box is not None
    width, height = (float(side) / 72 * 25.4 for side in box.groups())  # points
    assert width == pytest.approx(180 + 30, abs=0.05) and height == pytest.approx(240 + 30 + 12, abs=0.05)
    streams = [zlib.decompress(part) for part in re.findall(rb"stream\r?\n(.*?)\r?\nendstream", content, re.S)]
    (placed,) = [m for s in streams for m in re.findall(rb"([\d.]+) 0 0\s+-?([\d.]+) 0 [\d.]+ cm /I1 Do", s)]
    assert [float(side) / 72 * 25.4 for side in placed] == pytest.approx([180, 240], abs=0.05)
    number = rb"([\d.]+) ([\d.]+)"
    lines = [m for stream in streams for m in re.findall(number + rb" m\s+" + number + rb" l", stream)]
    drawn = np.array(lines, dtype=float) / 72 * 25.4
    for line in ((15, 11, 115, 11), (15, 9, 15, 13), (115, 9, 115, 13)):  # a rule of 100 mm, and its ends
        assert (np.abs(drawn - line).max(axis=1) < 0.05).any(), line
    with pytest.raises(InputError, match=r"\.pdf or \.svg"):
        write_board(board, tmp_path / "board.png")


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ({"kind": "charuco", "columns": 5, "rows": 7, "square_mm": 30}, "dictionary of .board. is missing"),
        (
            {"kind": "charuco", "columns": 5, "rows": 7, "square_mm": 30, "marker_mm": 31, "dictionary": "4x4_50"},
            "smaller",
        ),
        ({"kind": "apriltags", "columns": 5, "rows": 7, "square_mm": 30, "dictionary": "apriltag_36h11"}, "gap_mm"),
        ({"kind": "chessboard", "columns": 7, "rows": 5, "square_mm": 30}, "looks the same upside down"),
        ({"kind": "chessboard", "columns": 2, "rows": 5, "square_mm": 30}, "at least 3 x 3"),
        ({"kind": "circles", "columns": 2, "rows": 5, "square_mm": 30}, "charuco, chessboard, apriltags"),
        ({"kind": "chessboard", "columns": 8, "rows": 5, "square": 30}, "square_mm"),
        ({"kind": "chessboard", "columns": 8, "rows": 5, "square_mm": 30, "gap_mm": 9}, "a chessboard has no gaps"),
        (
            {"kind": "apriltags", "columns": 5, "rows": 7, "square_mm": 40, "marker_mm": 30, "gap_mm": 10}
            | {"dictionary": "apriltag_36h11"},
            "square_mm is the side of its tags",
        ),
        ({"kind": "chessboard", "columns": 8, "rows": 5, "square_mm": 30, "marker_mm": 9}, "it has no markers"),
    ],
)
def test_bad_boards_are_refused(table: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=words):
        made(Board, {"board": table}, "board.toml", section="board")


def test_too_few_markers_are_named() -> None:
    board = Board(kind="charuco", columns=20, rows=20, square=0.01, marker=0.008, dictionary="4x4_50")
    with pytest.raises(InputError, match="has 50 markers, too few for 20 x 20"):
        board_picture(board)


def test_beyond_a_pictures_border_its_edge_goes_on() -> None:
    picture = np.arange(12, dtype=np.uint8).reshape(3, 4)
    for place, value in (((1.4, 1.6), 9), ((-3, 1), 4), ((9, 1), 7), ((2, -5), 2), ((2, 8), 10), ((-1, -1), 0)):
        assert _grey_at(picture, np.array(place, dtype=float)) == value
