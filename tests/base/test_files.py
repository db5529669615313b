"""Files are written whole or not at all."""

import os
import stat
import subprocess
import sys
from pathlib import Path

import pytest

from pickenv.base import InputError, count_of, separate, write_text, write_whole

ENVIRONMENT = os.environ | {"PYTHONPATH": str(Path(__file__).parents[2]), "PYTHONUNBUFFERED": ""}
POSIX = pytest.mark.skipif(os.name == "nt", reason="as POSIX has it")


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


def test_a_writer_that_answers_a_full_disk_with_an_error_of_its_own_gives_the_same_sentence(tmp_path):
    def fail(_):
        try:
            raise OSError(28, "No space left on device")
        except OSError:
            raise RuntimeError("unexpected pos 704 vs 598")  # noqa: B904, as torch does it

    with pytest.raises(InputError, match=r"cannot write .*result\.pt: No space left on device"):
        write_whole(tmp_path / "result.pt", fail)
    assert list(tmp_path.iterdir()) == []


def test_what_a_writer_does_wrong_is_not_blamed_on_the_disk(tmp_path):
    def fail(_):
        raise RuntimeError("no such array")

    with pytest.raises(RuntimeError, match="no such array"):
        write_whole(tmp_path / "result.npz", fail)
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


def test_the_old_file_is_replaced_and_never_written_in(tmp_path):
    path = write_text(tmp_path / "result.csv", "old")
    os.link(path, tmp_path / "kept.csv")  # another name of the old file: it would show a write into it

    def write(temporary):
        temporary.write_text("new")
        assert path.read_text() == "old"

    write_whole(path, write)
    assert path.read_text() == "new"
    assert (tmp_path / "kept.csv").read_text() == "old"


@POSIX
def test_content_is_on_the_disk_before_the_name_and_the_name_before_we_say_so(tmp_path, monkeypatch):
    done = []

    def fsync(handle):
        status = os.fstat(handle)
        done.append("folder" if stat.S_ISDIR(status.st_mode) else f"file of {status.st_size} bytes")

    replace = os.replace
    monkeypatch.setattr(os, "fsync", fsync)
    monkeypatch.setattr(os, "replace", lambda *paths: done.append("rename") or replace(*paths))
    write_text(tmp_path / "result.csv", "four")
    assert done == ["file of 4 bytes", "rename", "folder"]


@POSIX
def test_no_moment_leaves_files_of_other_threads_open_to_all(tmp_path, monkeypatch):
    monkeypatch.setattr(os, "umask", lambda _: pytest.fail("the umask is the whole process's"))
    write_text(tmp_path / "result.csv", "")


@POSIX
@pytest.mark.parametrize("there", [True, False])
def test_a_link_stays_and_what_it_leads_to_is_written(tmp_path, there):
    target = tmp_path / "elsewhere" / "target.csv"
    target.parent.mkdir()
    if there:
        target.write_text("old")
    (tmp_path / "second.csv").symlink_to(Path("elsewhere") / "target.csv")
    link = tmp_path / "link.csv"
    link.symlink_to("second.csv")
    assert write_text(link, "new") == link
    assert link.is_symlink() and (tmp_path / "second.csv").is_symlink()
    assert target.read_text() == "new" and not target.is_symlink()
    assert [path.name for path in target.parent.iterdir()] == ["target.csv"]


@POSIX
def test_a_link_to_itself_is_refused_and_stays(tmp_path):
    link = tmp_path / "link.csv"
    link.symlink_to(link)
    with pytest.raises(InputError, match=r"cannot write .*link\.csv: Too many levels of symbolic links"):
        write_text(link, "")
    assert link.is_symlink()


@POSIX
def test_a_pipe_is_written_into(tmp_path):
    pipe = tmp_path / "pipe.csv"
    os.mkfifo(pipe)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    try:
        write_text(pipe, "α, mm")
        assert os.read(reader, 100).decode() == "α, mm"
    finally:
        os.close(reader)
    assert stat.S_ISFIFO(pipe.stat().st_mode)
    assert list(tmp_path.iterdir()) == [pipe]


NULL, FULL_DISK = (1, 3), (1, 7)


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() != 0, reason="only an administrator makes devices")
@pytest.mark.parametrize("number", [NULL, FULL_DISK])
@pytest.mark.parametrize("linked", [False, True])
def test_a_device_is_written_into_and_stays(tmp_path, number, linked):
    device = path = tmp_path / "device.csv"  # our own: a fault here must not cost the machine its /dev/null
    os.mknod(device, stat.S_IFCHR | 0o666, os.makedev(*number))
    if linked:
        path = tmp_path / "link.csv"
        path.symlink_to(device)
    try:
        if number == FULL_DISK:
            with pytest.raises(InputError, match=r"cannot write .*csv: No space left on device"):
                write_text(path, "content")
        else:
            write_text(path, "content")
        assert stat.S_ISCHR(device.stat().st_mode) and device.stat().st_rdev == os.makedev(*number)
        assert path.is_symlink() == linked
    finally:
        device.unlink()


@POSIX
@pytest.mark.parametrize("redirected", ["pipe", "file"])
def test_standard_output_by_its_name_is_written_into_in_order(tmp_path, redirected):
    code = (
        "from pickenv.base.files import write_text\n"
        "print('before'); write_text('/dev/fd/1', 'written\\n'); print('after')"  # fd/1: a fault cannot replace it
    )
    log = tmp_path / "log.txt"
    with log.open("wb") as file:
        stdout = file if redirected == "file" else subprocess.PIPE
        done = subprocess.run([sys.executable, "-c", code], stdout=stdout, env=ENVIRONMENT, check=True)
    said = log.read_text() if redirected == "file" else done.stdout.decode()
    assert said == "before\nwritten\nafter\n"
    assert list(tmp_path.iterdir()) == [log]


KILLED = """
import os, signal
from pickenv.base import write_whole
write_whole("result.csv", lambda temporary: os.kill(os.getpid(), signal.SIGKILL))
"""


@POSIX
def test_what_a_killed_run_left_is_swept_and_nothing_else(tmp_path):
    subprocess.run([sys.executable, "-c", KILLED], cwd=tmp_path, env=ENVIRONMENT, check=False)
    (left,) = tmp_path.iterdir()
    assert left.name.startswith(".pickenv-")
    gone, there = left.name.split("-")[2], str(os.getpid())
    others = [
        left.name.replace(gone, there),  # of a living process
        left.name.replace(left.name.split("-")[1], "0123abcd"),  # of another machine: its processes cannot be asked
        f".result-{gone}.csv",
        left.name.removeprefix("."),
        "result.csv",
    ]
    for name in others:
        (tmp_path / name).touch()
    write_text(tmp_path / "other.csv", "")
    assert {path.name for path in tmp_path.iterdir()} == {"other.csv", *others}


def test_a_name_too_long_for_a_file_is_one_sentence_and_the_longest_name_is_not(tmp_path):
    longest = tmp_path / ("n" * 251 + ".csv")
    assert write_text(longest, "whole").read_text() == "whole"
    with pytest.raises(InputError, match=r"cannot write .*: File name too long"):
        write_text(tmp_path / ("n" * 252 + ".csv"), "")


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


def test_a_count_of_one_is_singular():
    assert [count_of(n, "arm") for n in (0, 1, 2)] == ["0 arms", "1 arm", "2 arms"]
    assert [count_of(n, "reach", "reaches") for n in (1, 3)] == ["1 reach", "3 reaches"]
