"""Files are written whole or not at all."""

import os
import stat

import pytest

from pickenv.errors import InputError
from pickenv.files import write_text, write_whole


def test_the_file_holds_what_was_written_and_nothing_stands_beside_it(tmp_path):
    path = tmp_path / "new" / "folder" / "result.csv"
    assert write_text(path, "α, mm\n") == path
    assert path.read_text(encoding="utf-8") == "α, mm\n"
    assert list(path.parent.iterdir()) == [path]


def test_the_writer_sees_the_suffix_it_will_have(tmp_path):
    seen = []
    write_whole(tmp_path / "weights.npz", lambda temporary: seen.append((temporary.suffix, temporary.parent)))
    assert seen == [(".npz", tmp_path)]


@pytest.mark.parametrize("interruption", [RuntimeError, KeyboardInterrupt, SystemExit])
def test_an_interruption_leaves_nothing_behind(tmp_path, interruption):
    def half(temporary):
        temporary.write_text("half a fi")
        raise interruption

    with pytest.raises(interruption):
        write_whole(tmp_path / "result.csv", half)
    assert list(tmp_path.iterdir()) == []


def test_an_interruption_leaves_the_old_file_as_it_was(tmp_path):
    path = write_text(tmp_path / "result.csv", "old")

    def half(temporary):
        temporary.write_text("ne")
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_whole(path, half)
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_folder_that_cannot_be_made_is_named(tmp_path):
    (tmp_path / "taken").write_text("a file, not a folder")
    with pytest.raises(InputError, match=r"cannot write .*result\.csv: .*folder that can be written"):
        write_text(tmp_path / "taken" / "result.csv", "")


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="an administrator may write anywhere")
def test_a_folder_that_may_not_be_written_is_named(tmp_path):
    tmp_path.chmod(0o500)
    try:
        with pytest.raises(InputError, match=r"cannot write .*result\.csv"):
            write_text(tmp_path / "result.csv", "")
    finally:
        tmp_path.chmod(0o700)


def test_a_full_disk_is_said_in_one_sentence(tmp_path):
    def fail(_):
        raise OSError(28, "No space left on device")

    with pytest.raises(InputError, match=r"cannot write .*result\.csv: No space left on device"):
        write_whole(tmp_path / "result.csv", fail)
    assert list(tmp_path.iterdir()) == []


def test_a_folder_in_the_files_place_is_refused(tmp_path):
    (tmp_path / "result.csv").mkdir()
    with pytest.raises(InputError, match="cannot write"):
        write_text(tmp_path / "result.csv", "")
    assert [path.name for path in tmp_path.iterdir()] == ["result.csv"]


@pytest.mark.skipif(os.name == "nt", reason="POSIX permissions")
def test_a_result_may_be_read_like_any_other_file(tmp_path):
    ordinary = tmp_path / "ordinary"
    ordinary.touch()
    written = write_text(tmp_path / "written", "")
    assert stat.S_IMODE(written.stat().st_mode) == stat.S_IMODE(ordinary.stat().st_mode)
