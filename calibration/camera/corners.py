"""Finding a board's corners in a picture: where they are, how sure that is, and why a picture shows none.

A corner's uncertainty follows from the picture itself: noise against the gradients around it (Foerstner 1987). OpenCV
finds; the figures are ours.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pickenv.arm.kinematics.geometry import Array
from pickenv.calibration.camera.boards import Board, Grey, opencv, opencv_board
from pickenv.errors import InputError

FEW_MARKERS = 4
"""So few markers of a board may be all that a picture shows of it."""

WINDOW = 5
"""px; a corner is refined, and judged, within a square of this half width."""

LEAST_STD = MappingProxyType({"charuco": 0.05, "chessboard": 0.05, "apriltags": 0.3})
"""px; no corner is surer, whatever its picture's noise: crossings of edges, and the outer corners of tags, which blur
shifts (both measured on rendered pictures)."""


@dataclass(frozen=True, eq=False)
class FoundCorners:
    """A board's corners in one picture.

    Attributes:
        pixels: ``(K, 2)``, px; nothing where a corner was not found.
        seen: Whether each was found ``(K,)``.
        std: Standard uncertainty of each coordinate ``(K,)``, px; 1 where not found.
        size: Width and height of the picture, px.
        remark: Why none was found; empty where some were.
    """

    pixels: Array
    seen: NDArray[np.bool_]
    std: Array
    size: tuple[int, int]
    remark: str = ""


def find_corners(board: Board, picture: Grey, where: str) -> FoundCorners:
    """Find the board's corners.

    Args:
        board: The board.
        picture: Grey values ``(h, w)``.
        where: The picture's name, for messages.

    Raises:
        InputError: If no corner is found; the message says what was seen instead.
    """
    count = len(board.corners)
    numbers, places = _found(board, picture)
    if not len(numbers):
        raise InputError(f"{where}: no corner of the board was found; {_reason(board, picture)}")
    pixels, seen, std = np.zeros((count, 2)), np.zeros(count, dtype=bool), np.ones(count)
    pixels[numbers], seen[numbers] = places, True
    std[numbers] = corner_std(picture, places, LEAST_STD[board.kind])
    height, width = picture.shape
    return FoundCorners(pixels, seen, std, (width, height))


def no_corners(board: Board, size: tuple[int, int], remark: str) -> FoundCorners:
    """A picture of ``size`` (px) that shows no corner, and why."""
    count = len(board.corners)
    return FoundCorners(np.zeros((count, 2)), np.zeros(count, dtype=bool), np.ones(count), size, remark)


def corner_std(picture: Grey, corners: Array, least: float, half: int = WINDOW) -> Array:
    """Standard uncertainty of corners ``(N, 2)`` along their worse direction ``(N,)``, px.

    Where the picture's noise of standard deviation s meets gradients g, the covariance is s^2 (sum g g^T)^-1.
    """
    grey = picture.astype(float)
    down, across = np.gradient(grey)
    noise = picture_noise(grey)
    found = np.empty(len(corners))
    for i, (x, y) in enumerate(np.rint(corners).astype(int)):
        window = (slice(max(y - half, 0), y + half + 1), slice(max(x - half, 0), x + half + 1))
        g = np.stack([across[window].ravel(), down[window].ravel()])
        found[i] = noise / np.sqrt(max(float(np.linalg.eigvalsh(g @ g.T)[0]), 1e-9))
    return np.hypot(found, least)


def picture_noise(grey: Array) -> float:
    """Standard deviation of a picture's noise in grey values (Immerkaer 1996), robustly: edges do not count."""
    inner = (
        grey[:-2, :-2]
        + grey[:-2, 2:]
        + grey[2:, :-2]
        + grey[2:, 2:]
        + 4.0 * grey[1:-1, 1:-1]
        - 2.0 * (grey[:-2, 1:-1] + grey[2:, 1:-1] + grey[1:-1, :-2] + grey[1:-1, 2:])
    )
    return max(float(np.median(np.abs(inner))) / 0.6745 / 6.0, 0.3)  # no less than rounding to whole grey values


def _found(board: Board, picture: Grey) -> tuple[NDArray[np.int64], Array]:
    """Numbers of the corners found and their places, px."""
    cv2 = opencv()
    none = np.zeros(0, dtype=np.int64), np.zeros((0, 2))
    if board.kind == "chessboard":
        inner = (board.columns - 1, board.rows - 1)
        found, places = cv2.findChessboardCornersSB(picture, inner, flags=cv2.CALIB_CB_ACCURACY)
        return (np.arange(inner[0] * inner[1]), _upright(picture, places.reshape(-1, 2), inner)) if found else none
    if board.kind == "charuco":
        places, numbers, _, _ = cv2.aruco.CharucoDetector(opencv_board(board)).detectBoard(picture)
        if numbers is None:
            return none
        return numbers.ravel().astype(np.int64), places.reshape(-1, 2).astype(float)
    corners, tags = _markers(board, picture)
    known = [i for i, tag in enumerate(tags) if tag < board.columns * board.rows]
    if not known:
        return none
    numbers = np.concatenate([4 * tags[i] + np.arange(4) for i in known])
    return numbers, np.concatenate([corners[i].reshape(-1, 2) for i in known]).astype(float)


def _upright(picture: Grey, places: Array, inner: tuple[int, int]) -> Array:
    """A chessboard's corners from its black outer square on; found from the other end, that square is white."""
    grid = places.reshape(inner[1], inner[0], 2).astype(float)
    right, down = grid[0, 1] - grid[0, 0], grid[1, 0] - grid[0, 0]
    first, second = (
        _grey_at(picture, grid[0, 0] + 0.5 * (x * right - down)) for x in (-1.0, 1.0)
    )  # the outer square, and the one beside it, which has the other colour
    return (grid if first < second else grid[::-1, ::-1]).reshape(-1, 2)


def _grey_at(picture: Grey, place: Array) -> float:
    x, y = np.rint(place).astype(int)
    height, width = picture.shape
    return float(picture[min(max(y, 0), height - 1), min(max(x, 0), width - 1)])


def _markers(board: Board, picture: Grey) -> tuple[list[Any], list[int]]:
    """Corners and numbers of all markers of the board's dictionary."""
    cv2 = opencv()
    how = cv2.aruco.DetectorParameters()
    how.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    corners, tags, _ = cv2.aruco.ArucoDetector(opencv_board(board).getDictionary(), how).detectMarkers(picture)
    return list(corners), [] if tags is None else tags.ravel().tolist()


def _reason(board: Board, picture: Grey) -> str:
    """Why a picture may show no corner."""
    if len(_found(board, np.ascontiguousarray(picture[:, ::-1]))[0]):
        return "it is mirrored; give pictures as the camera makes them, not as a mirror shows them"
    if board.kind == "chessboard":
        return f"all {board.columns} x {board.rows} squares must be in it; check [board], light and focus"
    tags = _markers(board, picture)[1]
    if tags and len(tags) <= FEW_MARKERS and max(tags) < board.columns * board.rows // 2:
        return f"it shows {len(tags)} of its markers, too few to tell a corner; have more of the board in it"
    if tags:
        shown = ", ".join(map(str, sorted(tags)[:5]))
        return f"it shows markers of {board.dictionary} (numbers {shown}), but of another board; check [board]"
    return f"it shows no marker of {board.dictionary}; check [board], light and focus"
