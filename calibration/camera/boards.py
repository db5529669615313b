"""Printed boards: which there are, where their corners lie, how they look, and their page at true scale.

A board is a TOML table. Corners lie in the board's plane z = 0, x along its columns and y along its rows, from the
upper left, in m, as OpenCV numbers them. Only what finds or draws markers needs OpenCV (extra ``pickenv[camera]``).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import KW_ONLY
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from pickenv.arm.kinematics.geometry import Array
from pickenv.errors import InputError
from pickenv.extras import require
from pickenv.files import write_whole
from pickenv.texts import is_file, shortened
from pickenv.toml_tables import MM, WHOLE, Check, read, toml_table

Grey = NDArray[np.uint8]

KINDS_OF_BOARD = ("charuco", "chessboard", "apriltags")
DICTIONARIES: Mapping[str, str] = MappingProxyType(
    {
        **{f"{n}x{n}_{count}": f"DICT_{n}X{n}_{count}" for n in (4, 5, 6, 7) for count in (50, 100, 250, 1000)},
        "aruco_original": "DICT_ARUCO_ORIGINAL",
        "apriltag_16h5": "DICT_APRILTAG_16h5",
        "apriltag_25h9": "DICT_APRILTAG_25h9",
        "apriltag_36h10": "DICT_APRILTAG_36h10",
        "apriltag_36h11": "DICT_APRILTAG_36h11",
    }
)
"""Markers by name, and OpenCV's name for them."""

SHIPPED = Path(__file__).parent / "shipped_boards"

PIXELS_PER_SQUARE = 120
"""Of a board's picture; its page is drawn from it without smoothing, so that edges stay where they are."""

_KIND = Check(lambda value: value in KINDS_OF_BOARD, f"one of {', '.join(KINDS_OF_BOARD)}")
_DICTIONARY = Check(lambda value: value in DICTIONARIES, f"one of {', '.join(DICTIONARIES)}")
_COUNT = WHOLE.within(1, 100)


@toml_table
class Board:
    """[board]: squares of a ChArUco or chessboard, or a grid of AprilTags.

    Attributes:
        kind: One of `KINDS_OF_BOARD`.
        columns: Squares, or tags, along x.
        rows: Along y.
        square: Side of a square, or of a tag, m.
        marker: Side of a ChArUco board's markers, m.
        gap: Between two tags, m.
        dictionary: Which markers, a key of `DICTIONARIES`.
        legacy: ChArUco boards of OpenCV before 4.6, which begin with another colour where rows are even.
    """

    _: KW_ONLY
    kind: Annotated[str, _KIND]
    columns: Annotated[int, _COUNT]
    rows: Annotated[int, _COUNT]
    square: Annotated[float, MM.positive]
    marker: Annotated[float, MM.positive] | None = None
    gap: Annotated[float, MM.positive] | None = None
    dictionary: Annotated[str, _DICTIONARY] | None = None
    legacy: bool = False

    def __post_init__(self) -> None:
        if self.kind != "chessboard" and self.dictionary is None:
            raise InputError(f"dictionary of [board] is missing; give one of {', '.join(DICTIONARIES)}")
        if self.kind == "charuco" and (self.marker is None or not self.marker < self.square):
            raise InputError("marker_mm of [board] must be given, and smaller than square_mm")
        if self.kind == "apriltags" and self.gap is None:
            raise InputError("gap_mm of [board] is missing; give the space between two tags")
        if self.kind != "apriltags" and min(self.columns, self.rows) < 3:
            raise InputError(f"[board] has {self.columns} x {self.rows} squares; give at least 3 x 3")
        if self.kind == "chessboard" and (self.columns + self.rows) % 2 == 0:
            raise InputError(
                f"a chessboard of {self.columns} x {self.rows} squares looks the same upside down; give one with an "
                "even number of columns and an odd one of rows, or the other way round"
            )

    @property
    def corners(self) -> Array:
        """Where the corners are ``(K, 3)``, m: between squares, row by row; or four of each tag, clockwise."""
        if self.kind != "apriltags":
            x, y = np.meshgrid(np.arange(1, self.columns), np.arange(1, self.rows))
            return self.square * np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1).astype(float)
        assert self.gap is not None
        x, y = np.meshgrid(np.arange(self.columns), np.arange(self.rows))
        first = (self.square + self.gap) * np.stack([x.ravel(), y.ravel()], axis=1)
        tag = self.square * np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
        flat = (first[:, None] + tag).reshape(-1, 2)
        return np.column_stack([flat, np.zeros(len(flat))])

    @property
    def title(self) -> str:
        """What it is, in words."""
        marker = f", markers {1e3 * self.marker:g} mm" if self.marker else ""
        gap = f", gaps {1e3 * self.gap:g} mm" if self.gap else ""
        names = f", {self.dictionary}" if self.dictionary else ""
        return f"{self.kind} {self.columns} x {self.rows}{marker}{gap}{names}"

    @property
    def size(self) -> tuple[float, float]:
        """Width and height of what is printed, m."""
        step = self.square + (self.gap or 0.0)
        return self.columns * step - (self.gap or 0.0), self.rows * step - (self.gap or 0.0)


def load_board(name: str | Path) -> Board:
    """Read a board by name (a shipped one) or from a TOML file with a table [board].

    Raises:
        InputError: If it is unknown or malformed; the message names the file and key.
    """
    path = Path(name)
    if path.suffix != ".toml":
        path = SHIPPED / f"{name}.toml"
    if not is_file(path):
        known = ", ".join(sorted(each.stem for each in SHIPPED.glob("*.toml")))
        raise InputError(f"unknown board '{shortened(name)}'; give one of {known}, or a path (.toml)")
    return read(Board, path, section="board")


def opencv() -> Any:
    """OpenCV, or a sentence that says how to get it."""
    require("cv2")
    import cv2

    return cv2


def opencv_board(board: Board) -> Any:
    """OpenCV's board of markers; not for plain chessboards."""
    cv2 = opencv()
    assert board.dictionary is not None
    markers = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, DICTIONARIES[board.dictionary]))
    needed = board.columns * board.rows // (1 if board.kind == "apriltags" else 2)
    if needed > len(markers.bytesList):
        raise InputError(
            f"dictionary {board.dictionary} has {len(markers.bytesList)} markers, too few for {board.columns} x "
            f"{board.rows}; give a larger one"
        )
    size = (board.columns, board.rows)
    if board.kind == "apriltags":
        return cv2.aruco.GridBoard(size, board.square, board.gap, markers)
    made = cv2.aruco.CharucoBoard(size, board.square, board.marker, markers)
    made.setLegacyPattern(board.legacy)
    return made


def board_picture(board: Board, pixels_per_square: int = PIXELS_PER_SQUARE) -> Grey:
    """The board as it is printed, without a margin ``(h, w)``, black 0 and white 255."""
    scale = pixels_per_square / board.square
    width, height = (round(side * scale) for side in board.size)
    if board.kind == "chessboard":
        x, y = np.meshgrid(np.arange(width), np.arange(height))
        return np.where((x // pixels_per_square + y // pixels_per_square) % 2 == 0, 0, 255).astype(np.uint8)
    drawn = opencv_board(board).generateImage((width, height), marginSize=0, borderBits=1)
    return np.asarray(drawn, dtype=np.uint8)


def write_board(board: Board, path: str | Path, margin: float = 0.01) -> Path:
    """Write the board's page at true scale, with a rule to check the printer by.

    Args:
        board: The board.
        path: The file (.pdf or .svg), written whole or not at all.
        margin: White around it, m.

    Raises:
        InputError: If the suffix is another or the file cannot be written.
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
    place = (margin / page[0], (margin + below) / page[1], width / page[0], height / page[1])
    axes = figure.add_axes(place)
    axes.imshow(board_picture(board), cmap="gray", vmin=0, vmax=255, interpolation="none", aspect="auto")
    axes.set_axis_off()
    rule = figure.add_axes((0.0, 0.0, 1.0, (margin + below) / page[1]))
    rule.set(xlim=(0.0, page[0]), ylim=(0.0, margin + below))
    rule.set_axis_off()
    length = 0.1 if width >= 0.1 else 0.05
    rule.plot([margin, margin + length], [0.011, 0.011], color="black", linewidth=0.8)
    for end in (margin, margin + length):
        rule.plot([end, end], [0.009, 0.013], color="black", linewidth=0.8)
    side = f"{1e3 * board.square:g} mm"
    rule.text(
        margin,
        0.004,
        f"{1e3 * length:g} mm when printed at 100 %; squares {side}; {board.title}",
        fontsize=6,
        va="center",
    )
    return write_whole(path, lambda temporary: figure.savefig(temporary, format=path.suffix[1:]))
