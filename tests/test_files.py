"""Files are written whole or not at all."""

import os
import stat
from pathlib import Path

import pytest

from pickenv.errors import InputError
from pickenv.files import separate, write_text, write_whole


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


@pytest.fixture
def data(tmp_path, monkeypatch):
    """A folder that holds data.csv, and is the current one."""
    monkeypatch.chdir(tmp_path)
    write_text("data.csv", "x_mm\n1\n")
    return tmp_path / "data.csv"


SPELLINGS = ["data.csv", "./data.csv", "new/../data.csv", "link.csv", "hard.csv", "folder-link/data.csv", "{absolute}"]


@pytest.mark.parametrize("spelling", SPELLINGS)
def test_an_output_over_an_input_is_refused_however_it_is_spelt(data, spelling):
    Path("new").mkdir()
    Path("link.csv").symlink_to(data)
    os.link(data, "hard.csv")
    Path("folder-link").symlink_to(data.parent, target_is_directory=True)
    path = Path(spelling.format(absolute=data))
    with pytest.raises(InputError, match=r"--json would write over .*csv, which FILES reads; give --json another file"):
        separate({"FILES": ["other.csv", "data.csv"]}, {"--out": None, "--json": path})


@pytest.mark.parametrize("spelling", [spelling for spelling in SPELLINGS if spelling != "hard.csv"])
def test_two_outputs_into_one_file_are_refused_before_it_is_there(data, spelling):
    Path("new").mkdir()
    Path("link.csv").symlink_to(data)
    Path("folder-link").symlink_to(data.parent, target_is_directory=True)
    path = Path(spelling.format(absolute=data))
    data.unlink()
    with pytest.raises(InputError, match=r"--toml would write over .*csv, which --run writes too; give --toml another"):
        separate({}, {"--run": ["a.csv", "data.csv"], "--toml": path})


def test_of_a_robot_description_the_file_counts_and_not_the_link_named_behind_it(data):
    write_text("arm.urdf", "<robot/>")
    with pytest.raises(InputError, match=r"--urdf would write over arm\.urdf, which --arm reads"):
        separate({"--arm": "arm.urdf#flange"}, {"--urdf": Path("arm.urdf")})


def test_different_files_shipped_names_and_devices_are_no_conflict(data):
    fifo = data.with_name("pipe")
    os.mkfifo(fifo)
    separate({"--arm": "ur5", "FILES": [data]}, {"--out": Path("ur5"), "--json": data.with_suffix(".json")})
    separate({"FILES": fifo}, {"--out": fifo, "--json": fifo})
    separate({"--columns": None}, {"--run": ["report.html", "report.html"], "--report": None})
