"""`pickenv board`: a calibration board to print."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pickenv.base import separate
from pickenv.commands.handing_over import deliver


def board(
    file: Annotated[
        str,
        typer.Argument(
            help="Board file (.toml, or a description with [board]), or charuco_a4, chessboard_a4, apriltags_a4.",
            show_default=False,
        ),
    ],
    out: Annotated[Path, typer.Option(help="Write the page to this file (.pdf, .svg).")] = Path("board.pdf"),
) -> None:
    """Print a calibration board to true scale, with a rule to check the printer by."""
    from pickenv.calibration.camera.boards import load_board, write_board

    separate({"FILE": file}, {"--out": out})
    made = load_board(file)
    width, height = made.size
    deliver(
        [(out, lambda path: write_board(made, path))],
        lambda: print(
            f"{made.title}: {1e3 * width:g} x {1e3 * height:g} mm. Print at 100 %, glue it onto something flat, and "
            "measure the rule below it"
        ),
    )
