"""A file is written whole or not at all."""

import stat
from pathlib import Path

import pytest

from pickenv.errors import InputError
from pickenv.files import write_text, write_whole


def test_text_arrives_and_folders_are_made(tmp_path: Path) -> None:
    path = write_text(tmp_path / "a" / "b" / "summary.json", "α\n")
    assert path.read_text(encoding="utf-8") == "α\n"
    assert stat.S_IMODE(path.stat().st_mode) & stat.S_IRUSR
    assert [p.name for p in path.parent.iterdir()] == ["summary.json"]


@pytest.mark.parametrize("interruption", [KeyboardInterrupt, SystemExit, RuntimeError])
def test_an_interrupt_leaves_the_old_file_and_no_half_of_the_new(
    tmp_path: Path, interruption: type[BaseException]
) -> None:
    path = write_text(tmp_path / "measurements.csv", "old")

    def half(temporary: Path) -> None:
        temporary.write_text("ne", encoding="utf-8")
        raise interruption

    with pytest.raises(interruption):
        write_whole(path, half)
    assert path.read_text(encoding="utf-8") == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_folder_that_is_a_file_is_named(tmp_path: Path) -> None:
    (tmp_path / "runs").write_text("in the way", encoding="utf-8")
    with pytest.raises(InputError, match=r"cannot write .*runs"):
        write_text(tmp_path / "runs" / "summary.json", "{}")


def test_a_file_that_is_a_folder_is_named_and_left_alone(tmp_path: Path) -> None:
    (tmp_path / "summary.json").mkdir()
    with pytest.raises(InputError, match=r"cannot write .*summary\.json"):
        write_text(tmp_path / "summary.json", "{}")
    assert [p.name for p in tmp_path.iterdir()] == ["summary.json"]
