"""`pickenv board` prints what it says, or refuses in one sentence."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

from pickenv import calibration
from pickenv.base import InputError
from pickenv.calibration import load_board
from pickenv.cli import app

A4 = (0.210, 0.297)
SHIPPED = Path(calibration.__file__).parent / "camera" / "shipped_boards"


@pytest.mark.parametrize("path", sorted(SHIPPED.glob("*.toml")), ids=lambda path: path.stem)
def test_shipped_boards_fit_a_page(path: Path, tmp_path: Path) -> None:
    board = load_board(path.stem)
    assert board == load_board(path)
    assert all(side + 0.03 <= page for side, page in zip(board.size, A4, strict=True))
    done = CliRunner().invoke(app, ["board", path.stem, "--out", str(tmp_path / "board.pdf")], catch_exceptions=False)
    assert done.exit_code == 0 and board.title in done.output and "Print at 100 %" in done.output
    assert (tmp_path / "board.pdf").read_bytes().startswith(b"%PDF")


def test_what_is_no_board_is_refused(tmp_path: Path) -> None:
    (tmp_path / "none.toml").write_text("[camera]\nfx = 1\n")
    for name, words in (
        ("charuco_a3", "unknown board 'charuco_a3'"),
        (str(tmp_path / "none.toml"), r"section \[board\]"),
    ):
        with pytest.raises(InputError, match=words):
            CliRunner().invoke(app, ["board", name, "--out", str(tmp_path / "b.pdf")], catch_exceptions=False)
    assert not (tmp_path / "b.pdf").exists()
