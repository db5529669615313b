"""Printed boards: their kinds, the positions of their corners, their pictures, and a page to print at true scale.

A board is a TOML table. Its corners are in the plane z = 0 and are numbered as in OpenCV. From the upper left, x points
along the columns and y along the rows, m. OpenCV (extra ``pickenv[camera]``) is needed only to detect corners and to
draw markers.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pickenv.arm import Array
from pickenv.base import InputError, listed, read_text, require, toml_tables, write_text, write_whole, yaml_content
from pickenv.calibration.model.pixels import Lens

# A camera's lens in the files that others write: ROS camera_info YAML, in and out, and OpenCV's own YAML. Written
# against ROS 2's camera_calibration_parsers (plumb_bob) and OpenCV's FileStorage, YAML 1.0.

MATRIX = ("camera_matrix", "cameraMatrix", "K")
DISTORTION = ("distortion_coefficients", "distCoeffs", "D")
MODELS = ("plumb_bob", "opencv5")
"""Names in ROS of the distortion model that `pickenv.calibration.model.pixels` implements."""
COEFFICIENTS = 5


def read_lens(path: str | Path) -> Lens:
    """Read a lens from a ROS camera_info file or an OpenCV file (.yaml, .yml).

    Raises:
        InputError: If the file is missing, is of neither kind, or has another distortion model.
    """
    path = Path(path)
    text = read_text(path, "a ROS camera_info or OpenCV file (.yaml)")
    # OpenCV's header is no YAML, and its matrices are mappings.
    content = yaml_content(text.replace("%YAML:1.0", "#", 1).replace("!!opencv-matrix", ""), path)
    if not isinstance(content, dict):
        raise InputError(f"{path}: holds no camera; give a ROS camera_info or OpenCV YAML file")
    model = content.get("distortion_model", "plumb_bob")
    if model not in MODELS:
        raise InputError(f"{path}: distortion_model '{model}' is not known; give a camera calibrated with plumb_bob")
    matrix, distortion = _numbers(path, content, MATRIX), _numbers(path, content, DISTORTION)
    if matrix.size != 9:
        raise InputError(f"{path}: the camera matrix has {matrix.size} numbers; it needs 9")
    if distortion.size < 4 or np.any(distortion[COEFFICIENTS:]):
        raise InputError(f"{path}: distortion has {distortion.size} coefficients; give k1, k2, p1, p2 and, if any, k3")
    matrix = matrix.reshape(3, 3)
    if np.any(matrix[[0, 1, 2, 2], [1, 0, 0, 1]]):
        raise InputError(
            f"{path}: the camera matrix has a skew or is written column by column; give fx 0 cx, 0 fy cy, 0 0 1"
        )
    if not (matrix[0, 0] > 0 and matrix[1, 1] > 0 and matrix[2, 2] == 1.0):
        raise InputError(f"{path}: the camera matrix is none: focal lengths must be above zero, and its last number 1")
    values = np.array([*matrix[[0, 1, 0, 1], [0, 1, 2, 2]], *np.resize(np.append(distortion, 0.0), COEFFICIENTS)])
    size = _size(path, content, "width"), _size(path, content, "height")
    return Lens(values, size, str(content.get("camera_name", path.stem)))


def write_lens(lens: Lens, path: str | Path) -> Path:
    """Write a lens as ROS camera_info YAML with all digits; the file is written whole or not at all."""
    import yaml

    fx, fy, cx, cy, *distortion = lens.values.tolist()
    content: dict[str, Any] = {
        "image_width": lens.size[0],
        "image_height": lens.size[1],
        "camera_name": lens.name,
        "camera_matrix": {"rows": 3, "cols": 3, "data": [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0]},
        "distortion_model": "plumb_bob",
        "distortion_coefficients": {"rows": 1, "cols": COEFFICIENTS, "data": distortion},
        "rectification_matrix": {"rows": 3, "cols": 3, "data": np.eye(3).ravel().tolist()},
        "projection_matrix": {"rows": 3, "cols": 4, "data": [fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0]},
    }
    return write_text(Path(path), yaml.safe_dump(content, sort_keys=False, default_flow_style=None))


def _numbers(path: Path, found: dict[str, Any], names: tuple[str, ...]) -> Array:
    """Return the numbers of a matrix in a lens file as a flat array.

    Args:
        path: The file, for messages.
        found: The file's content.
        names: Names that the matrix can have; the first that the file has is read.

    Raises:
        InputError: If the matrix is missing or holds no numbers.
    """
    entry = next((found[name] for name in names if name in found), None)
    values = entry.get("data") if isinstance(entry, dict) else entry
    try:
        numbers = np.asarray(values, dtype=float).ravel()
    except (TypeError, ValueError):
        numbers = np.array([np.nan])
    if entry is None or not np.isfinite(numbers).all():
        raise InputError(f"{path}: '{names[0]}' is missing or holds no numbers; give a ROS camera_info or OpenCV file")
    return numbers


def _size(path: Path, found: dict[str, Any], side: str) -> int:
    """Return the width or height of the lens' pictures, px, from a file's content; ``side`` is "width" or "height"."""
    value = found.get(f"image_{side}")
    if not isinstance(value, int) or value < 1:
        raise InputError(f"{path}: 'image_{side}' is missing; give the size of the pictures that the lens is for")
    return value


Grey = NDArray[np.uint8]

KINDS_OF_BOARD = ("charuco", "chessboard", "apriltags")
DICTIONARIES: Mapping[str, str] = {
    **{f"{n}x{n}_{count}": f"DICT_{n}X{n}_{count}" for n in (4, 5, 6, 7) for count in (50, 100, 250, 1000)},
    "aruco_original": "DICT_ARUCO_ORIGINAL",
    **{f"apriltag_{size}": f"DICT_APRILTAG_{size}" for size in ("16h5", "25h9", "36h10", "36h11")},
}
"""Dictionaries of markers by name, and OpenCV's name for each."""

SHIPPED = Path(__file__).parent / "shipped_boards"

PIXELS_PER_SQUARE = 120
"""Pixels per square in a board's picture, which the page shows without smoothing, so that edges keep their place."""


def one_of(names: Iterable[str]) -> toml_tables.Check:
    """Return a check that a value is one of ``names``."""
    allowed = tuple(names)
    return toml_tables.Check(allowed.__contains__, f"one of {', '.join(allowed)}")


_COUNT = toml_tables.WHOLE.within(1, 100)


@toml_tables.toml_table
class Board:
    """A printed board, the table [board]: squares of a ChArUco board or chessboard, or a grid of AprilTags.

    Attributes:
        kind: One of `KINDS_OF_BOARD`.
        columns: Number of squares or tags along x.
        rows: Number of squares or tags along y.
        square: Side of a square or of a tag, m.
        marker: Side of a ChArUco board's markers, m.
        gap: Gap between two tags, m.
        dictionary: Dictionary of the markers, a key of `DICTIONARIES`.
        legacy: Whether a ChArUco board was made by OpenCV before 4.6. If the number of rows is even, such a board
            begins with the other colour.
    """

    kind: Annotated[str, one_of(KINDS_OF_BOARD)]
    columns: Annotated[int, _COUNT]
    rows: Annotated[int, _COUNT]
    square: Annotated[float, toml_tables.MM.positive]
    marker: Annotated[float, toml_tables.MM.positive] | None = None
    gap: Annotated[float, toml_tables.MM.positive] | None = None
    dictionary: Annotated[str, one_of(DICTIONARIES)] | None = None
    legacy: bool = False

    def __post_init__(self) -> None:
        if self.kind != "chessboard" and self.dictionary is None:
            raise InputError(f"dictionary of [board] is missing; give one of {', '.join(DICTIONARIES)}")
        if self.kind == "charuco" and (self.marker is None or not self.marker < self.square):
            raise InputError("marker_mm of [board] must be given, and smaller than square_mm")
        if self.kind == "apriltags" and self.gap is None:
            raise InputError("gap_mm of [board] is missing; give the space between two tags")
        if self.kind != "apriltags" and self.gap is not None:
            raise InputError(f"gap_mm of [board] is for apriltags, and a {self.kind} has no gaps; leave it out")
        if self.kind != "charuco" and self.marker is not None:
            side = "square_mm is the side of its tags" if self.kind == "apriltags" else "it has no markers"
            raise InputError(
                f"marker_mm of [board] is for charuco; of a board of kind {self.kind} {side}; leave it out"
            )
        if self.kind != "apriltags" and min(self.columns, self.rows) < 3:
            raise InputError(f"[board] has {self.columns} x {self.rows} squares; give at least 3 x 3")
        if self.kind == "chessboard" and (self.columns + self.rows) % 2 == 0:
            raise InputError(
                f"a chessboard of {self.columns} x {self.rows} squares looks the same upside down; give one with an "
                "even number of columns and an odd one of rows, or the other way round"
            )

    @property
    def corners(self) -> Array:
        """Positions ``(K, 3)``, m, of the squares' inner corners row by row, or of each tag's corners clockwise."""
        first, around = (0, [[0, 0], [1, 0], [1, 1], [0, 1]]) if self.kind == "apriltags" else (1, [[0, 0]])
        x, y = np.meshgrid(np.arange(first, self.columns), np.arange(first, self.rows))
        places = (self.square + (self.gap or 0.0)) * np.stack([x.ravel(), y.ravel()], axis=1)
        flat = (places[:, None] + self.square * np.array(around)).reshape(-1, 2)
        return np.column_stack([flat, np.zeros(len(flat))])

    @property
    def title(self) -> str:
        """Description of the board in words: kind, size, markers, gaps and dictionary."""
        marker = f", markers {1e3 * self.marker:g} mm" if self.marker else ""
        gap = f", gaps {1e3 * self.gap:g} mm" if self.gap else ""
        names = f", {self.dictionary}" if self.dictionary else ""
        return f"{self.kind} {self.columns} x {self.rows}{marker}{gap}{names}"

    @property
    def size(self) -> tuple[float, float]:
        """Width and height of the printed board, m, without a margin."""
        gap = self.gap or 0.0
        return self.columns * (self.square + gap) - gap, self.rows * (self.square + gap) - gap


def load_board(name: str | Path) -> Board:
    """Read a shipped board by its name, or a board from a TOML file with a table [board].

    Raises:
        InputError: If the board is unknown or malformed; the message names the file and key.
    """
    return toml_tables.read_toml(Board, toml_tables.file_named("board", name, SHIPPED), section="board")


def opencv() -> Any:
    """Return the module of OpenCV; if it is missing, the error says how to install it."""
    require("cv2")
    import cv2

    return cv2


def _dictionary(name: str) -> Any:
    """Return OpenCV's dictionary of markers for a key of `DICTIONARIES`."""
    aruco = opencv().aruco
    return aruco.getPredefinedDictionary(getattr(aruco, DICTIONARIES[name]))


def opencv_board(board: Board) -> Any:
    """Return a board with markers (ChArUco or AprilTags) as an OpenCV object.

    Raises:
        InputError: If the dictionary has too few markers for the board.
    """
    cv2 = opencv()
    assert board.dictionary is not None
    markers = _dictionary(board.dictionary)
    needed = board.columns * board.rows // (1 if board.kind == "apriltags" else 2)
    if needed > len(markers.bytesList):
        raise InputError(
            f"dictionary {board.dictionary} has {len(markers.bytesList)} markers, too few for {board.columns} x "
            f"{board.rows}; give a larger one"
        )
    size = (board.columns, board.rows)
    if board.kind == "apriltags":
        return cv2.aruco.GridBoard(size, board.square, board.gap, markers)
    charuco = cv2.aruco.CharucoBoard(size, board.square, board.marker, markers)
    charuco.setLegacyPattern(board.legacy)
    return charuco


def board_picture(board: Board, pixels_per_square: int = PIXELS_PER_SQUARE) -> Grey:
    """Return a picture of the printed board without a margin: grey values ``(h, w)``, black 0 and white 255."""
    width, height = (round(side * (pixels_per_square / board.square)) for side in board.size)
    if board.kind == "chessboard":
        squares = np.indices((height, width)) // pixels_per_square
        return np.asarray(squares.sum(axis=0) % 2 * 255, dtype=np.uint8)
    picture = opencv_board(board).generateImage((width, height), marginSize=0, borderBits=1)
    return np.asarray(picture, dtype=np.uint8)


def write_board(board: Board, path: str | Path, margin: float = 0.01) -> Path:
    """Write a page with the board at true scale, and with a line of known length to check the print.

    Args:
        board: The board.
        path: The file (.pdf or .svg), written whole or not at all.
        margin: Width of the white margin around the board, m.

    Raises:
        InputError: If the file's name ends in neither .pdf nor .svg, or the file cannot be written.
    """
    require("matplotlib")
    from matplotlib.backends.backend_pdf import FigureCanvasPdf
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure

    path = Path(path)
    canvas = {".pdf": FigureCanvasPdf, ".svg": FigureCanvasSVG}.get(path.suffix)
    if canvas is None:
        raise InputError(f"cannot write {path}: give a file name that ends in .pdf or .svg, which keep the scale")
    inch, below = 0.0254, 0.012
    width, height = board.size
    page = (width + 2 * margin, height + 2 * margin + below)
    figure = Figure(figsize=(page[0] / inch, page[1] / inch))
    canvas(figure)
    axes = figure.add_axes((margin / page[0], (margin + below) / page[1], width / page[0], height / page[1]))
    axes.imshow(board_picture(board), cmap="gray", interpolation="none", aspect="auto")
    axes.set_axis_off()
    rule = figure.add_axes((0.0, 0.0, 1.0, (margin + below) / page[1]))
    rule.set(xlim=(0.0, page[0]), ylim=(0.0, margin + below))
    rule.set_axis_off()
    length = 0.1 if width >= 0.1 else 0.05
    rule.plot([margin, margin + length], [0.011, 0.011], color="black", linewidth=0.8)
    for end in (margin, margin + length):
        rule.plot([end, end], [0.009, 0.013], color="black", linewidth=0.8)
    label = f"{1e3 * length:g} mm when printed at 100 %; squares {1e3 * board.square:g} mm; {board.title}"
    rule.text(margin, 0.004, label, fontsize=6, va="center")
    return write_whole(path, lambda temporary: figure.savefig(temporary, format=path.suffix[1:]))


# Finding a board's corners in a picture: where they are, how sure that is, and why a picture shows none. A corner's
# uncertainty follows from the picture itself: noise against the gradients around it (Foerstner 1987). OpenCV finds;
# the figures are ours.


FEW_MARKERS = 4
"""Limit on the number of markers in a picture without corners. Up to this number, the message says that too few markers
are in the picture. With more markers, or with a marker that the board does not have, it says that they are of another
board."""

WINDOW = 5
"""Half width, px, of the square around a corner whose gradients determine the corner's uncertainty."""

LEAST_STD = {"charuco": 0.05, "chessboard": 0.05, "apriltags": 0.3}
"""Least standard uncertainty of a corner, px, by kind of board. On a chessboard, corners are crossings of edges.
The outer corners of tags are less accurate, because blur shifts them. Both were measured on rendered pictures."""


Corners = tuple[Array, NDArray[np.bool_], Array]
"""The K corners of a board in one picture, as three arrays. The first holds the pixels ``(K, 2)``. The second is a mask
``(K,)`` of the corners that were found. The third holds the standard uncertainty of a corner's coordinates ``(K,)``,
px. A corner that was not found has the pixel 0, 0 and the uncertainty 1."""


def find_corners(board: Board, picture: Grey, where: str) -> Corners:
    """Detect the board's corners in a picture.

    Args:
        board: The board.
        picture: Grey values ``(h, w)``.
        where: The picture's name, for messages.

    Raises:
        InputError: If no corner is found; the message says what the picture shows instead.
    """
    numbers, places = _found(board, picture)
    if not len(numbers):
        raise InputError(f"{where}: no corner of the board was found; {_reason(board, picture)}")
    return corners_at(len(board.corners), numbers, places, corner_std(picture, places, LEAST_STD[board.kind]))


def find_tags(dictionary: str, numbers: Sequence[int], picture: Grey, where: str) -> Corners:
    """Detect points of a body with tags in a picture, such as the corners of a cube's tags.

    Args:
        dictionary: Dictionary of the tags, a key of `DICTIONARIES`.
        numbers: Number of each point: the corners of tag k, clockwise as OpenCV finds them, are 4 k to 4 k + 3.
        picture: Grey values ``(h, w)``.
        where: The picture's name, for messages.

    Raises:
        InputError: If no point is found; the message says which tags the picture shows instead.
    """
    seen, places = _tag_corners(dictionary, picture)
    of_body = np.isin(seen, numbers)
    if not of_body.any():
        tags = listed(map(str, np.unique(seen // 4))) if len(seen) else "none"
        raise InputError(f"{where}: no tag of the target was found; of {dictionary} it shows {tags}; check [target]")
    rows, places = [numbers.index(number) for number in seen[of_body]], places[of_body]
    return corners_at(len(numbers), rows, places, corner_std(picture, places, LEAST_STD["apriltags"]))


def corners_at(count: int, numbers: ArrayLike, places: ArrayLike, std: ArrayLike) -> Corners:
    """Return `Corners` of a board or another target, from the corners that a picture shows.

    Args:
        count: Number of all corners of the board, or points of the target.
        numbers: Indices of the corners that the picture shows ``(N,)``, from 0.
        places: Pixels of these corners ``(N, 2)``.
        std: Standard uncertainty of each corner's coordinates, px: ``(N,)`` or one number for all.
    """
    pixels, seen, stds = np.zeros((count, 2)), np.zeros(count, dtype=bool), np.ones(count)
    numbers = np.asarray(numbers, dtype=np.int64)
    pixels[numbers], seen[numbers], stds[numbers] = places, True, std
    return pixels, seen, stds


def corner_std(picture: Grey, corners: Array, least: float) -> Array:
    """Compute the standard uncertainty of each corner ``(N,)``, px, in the direction in which it is largest.

    The covariance of a corner is s^2 (sum g g^T)^-1. Here s is the standard deviation of the picture's noise, and g are
    the gradients around the corner. The square of ``least`` is added to the variance.

    Args:
        picture: Grey values ``(h, w)``.
        corners: Pixels of the corners ``(N, 2)``.
        least: Least standard uncertainty, px.
    """
    grey = picture.astype(float)
    down, across = np.gradient(grey)
    sharpness = []
    for x, y in np.rint(corners).astype(int):
        window = tuple(slice(max(i - WINDOW, 0), i + WINDOW + 1) for i in (y, x))
        g = np.stack([across[window].ravel(), down[window].ravel()])
        sharpness.append(max(float(np.linalg.eigvalsh(g @ g.T)[0]), 1e-9))
    return np.hypot(picture_noise(grey) / np.sqrt(sharpness), least)


def picture_noise(grey: Array) -> float:
    """Compute the standard deviation of a picture's noise, in grey values (Immerkaer 1996).

    It is computed from a median, which edges hardly change.
    """
    twice = np.diff(np.diff(grey, 2, axis=0), 2, axis=1)
    return max(float(np.median(np.abs(twice))) / 0.6745 / 6.0, 0.3)  # no less than rounding to whole grey values


def _found(board: Board, picture: Grey) -> tuple[NDArray[np.int64], Array]:
    """Detect a board's corners in a picture: return their indices ``(N,)``, from 0, and their pixels ``(N, 2)``.

    Both arrays are empty if no corner is found.
    """
    cv2 = opencv()
    none = np.zeros(0, dtype=np.int64), np.zeros((0, 2))
    if board.kind == "chessboard":
        inner = (board.columns - 1, board.rows - 1)
        complete, places = cv2.findChessboardCornersSB(picture, inner, flags=cv2.CALIB_CB_ACCURACY)
        return (np.arange(inner[0] * inner[1]), _upright(picture, places.reshape(-1, 2), inner)) if complete else none
    if board.kind == "charuco":
        places, numbers, _, _ = cv2.aruco.CharucoDetector(opencv_board(board)).detectBoard(picture)
        if numbers is None:
            return none
        return numbers.ravel().astype(np.int64), places.reshape(-1, 2).astype(float)
    opencv_board(board)  # refused if the dictionary has too few markers
    numbers, places = _tag_corners(str(board.dictionary), picture)
    of_board = numbers < 4 * board.columns * board.rows
    return numbers[of_board], places[of_board]


def _upright(picture: Grey, places: Array, inner: tuple[int, int]) -> Array:
    """Return a chessboard's corners ``(K, 2)``, px, in the order that begins at the board's black outer square.

    If the outer square at OpenCV's first corner is white, OpenCV's order is reversed.

    Args:
        picture: Grey values ``(h, w)``.
        places: Pixels of the inner corners in OpenCV's order ``(K, 2)``.
        inner: Number of inner corners along x and along y.
    """
    grid = places.reshape(inner[1], inner[0], 2).astype(float)
    right, down = grid[0, 1] - grid[0, 0], grid[1, 0] - grid[0, 0]
    # The outer square, and the one beside it, which has the other colour.
    outer, beside = (_grey_at(picture, grid[0, 0] + 0.5 * (x * right - down)) for x in (-1.0, 1.0))
    return (grid if outer < beside else grid[::-1, ::-1]).reshape(-1, 2)


def _grey_at(picture: Grey, place: Array) -> float:
    """Return the grey value of a picture at the pixel nearest to ``place`` (x, y), px."""
    x, y = np.clip(np.rint(place).astype(int), 0, np.array(picture.shape)[::-1] - 1)
    return float(picture[y, x])


def _tag_corners(dictionary: str, picture: Grey) -> tuple[NDArray[np.int64], Array]:
    """Detect the markers of a dictionary in a picture: return their corners' numbers ``(N,)`` and pixels ``(N, 2)``.

    The corners of marker k (from 0), clockwise as OpenCV finds them, have the numbers 4 k to 4 k + 3.
    """
    cv2 = opencv()
    how = cv2.aruco.DetectorParameters()
    how.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    corners, tags, _ = cv2.aruco.ArucoDetector(_dictionary(dictionary), how).detectMarkers(picture)
    numbers = np.zeros(0, dtype=np.int64) if tags is None else tags.ravel().astype(np.int64)
    return (4 * numbers[:, None] + np.arange(4)).ravel(), np.reshape(corners, (-1, 2)).astype(float)


def _reason(board: Board, picture: Grey) -> str:
    """Return the likely reason why no corner was found in a picture."""
    if len(_found(board, np.ascontiguousarray(picture[:, ::-1]))[0]):
        return "it is mirrored; give pictures as the camera makes them, not as a mirror shows them"
    if board.kind == "chessboard":
        return f"all {board.columns} x {board.rows} squares must be in it; check [board], light and focus"
    tags = (_tag_corners(str(board.dictionary), picture)[0][::4] // 4).tolist()
    if tags and len(tags) <= FEW_MARKERS and max(tags) < board.columns * board.rows // 2:
        return f"it shows {len(tags)} of its markers, too few to tell a corner; have more of the board in it"
    if tags:
        numbers = ", ".join(map(str, sorted(tags)[:5]))
        return f"it shows markers of {board.dictionary} (numbers {numbers}), but of another board; check [board]"
    return f"it shows no marker of {board.dictionary}; check [board], light and focus"
