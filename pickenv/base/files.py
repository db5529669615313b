"""Read text files, and write files atomically, so that an interrupt never leaves half a file.

Readers of CSV, TOML, YAML, URDF and MJCF call `read_text` and `parsed`. Each error is an `InputError` that names the
file. `shortened` cuts quotations in messages to one line. `decimal_number` decides which text is a number.

A file is written under a temporary name, and then renamed. Only one process at a time writes into a run folder, so
results of two runs are never mixed in it. The lock is an operating-system lock on the file `.lock` in the folder. It
ends with its process, however the process ends. The file contains the id of that process. On a file system without
locks, runs proceed without a lock.
"""

from __future__ import annotations

import codecs
import difflib
import errno
import hashlib
import json
import os
import platform
import re
import secrets
import shutil
import stat
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from textwrap import wrap
from typing import Any, TypeVar

from pickenv.base.errors import InputError

Thing = TypeVar("Thing")
Progress = Callable[[str, int, int], None]
"""A function that is called with the name of a stage, its number of finished parts, and its number of all parts."""

LARGEST = 1 << 30
"""Largest size of a text file that is read, bytes. The files of pickenv are much smaller."""

MARKS = {"UTF-32": (codecs.BOM_UTF32_LE, codecs.BOM_UTF32_BE), "UTF-16": (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)}
"""Byte order marks of encodings that are refused, by encoding, the longest first."""


def read_text(path: str | Path, kind: str) -> str:
    """Return the text of a UTF-8 file, a pipe, or /dev/stdin.

    A byte order mark is removed. Line ends are kept as they are.

    Args:
        path: The file.
        kind: What the file should be, for messages: "a CSV file".

    Raises:
        InputError: If the file is missing, a folder, a device, too large, or not UTF-8 text. The message says which.
    """
    name, other, data = shortened(path, 300), "", b""
    try:
        mode = Path(path).stat().st_mode
        other = "" if stat.S_ISREG(mode) or stat.S_ISFIFO(mode) else "a folder" if stat.S_ISDIR(mode) else "a device"
        if not other:
            with Path(path).open("rb") as file:
                while len(data) <= LARGEST and (more := file.read(1 << 20)):
                    data += more
    except FileNotFoundError as error:
        raise InputError(f"{name} does not exist; give a path to {kind}") from error
    except (OSError, ValueError) as error:  # a path of 300 characters, or with a zero byte in it
        raise InputError(f"cannot read {name}: {reason_of(error)}; give a path to {kind}") from error
    if other:
        raise InputError(f"{name} is {other}, not a file; give a path to {kind}")
    if len(data) > LARGEST:
        raise InputError(f"{path} holds more than {LARGEST >> 20} MiB; give a path to {kind}")
    return _decoded(data, path, kind)


def _decoded(data: bytes, path: str | Path, kind: str) -> str:
    if data.startswith(b"PK\x03\x04"):
        raise InputError(f"{path} is a zip archive, such as a spreadsheet; export it as {kind}")
    for encoding, marks in MARKS.items():
        if data.startswith(marks):
            raise InputError(f"{path} is written in {encoding}; save it as UTF-8")
    if b"\0" in data:
        raise InputError(f"cannot read {path}: it holds zero bytes, so it is UTF-16 or no text; give {kind} in UTF-8")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        place = f"byte 0x{data[error.start]:02x} in line {line}"
        raise InputError(f"cannot read {path}: {place} is Latin-1 (cp1252) or no text; give {kind} in UTF-8") from error


def parsed(parse: Callable[[], Thing], path: str | Path, kind: str) -> Thing:
    """Return the result of ``parse()``, and turn every exception into an `InputError`.

    Args:
        parse: Function that parses the file's text.
        path: The file, for the message.
        kind: Format of the file, for the message: "TOML".

    Raises:
        InputError: If ``parse`` raises. The message says that ``path`` is not valid ``kind``, and why.
    """
    try:
        return parse()
    except RecursionError as error:
        raise InputError(f"{path} is not valid {kind}: it is nested too deeply; give tables of a few levels") from error
    except Exception as error:
        raise InputError(f"{path} is not valid {kind}: {reason_of(error)}") from error


@contextmanager
def in_file(path: str | Path) -> Iterator[None]:
    """Return a context that puts the file's name before the message of every `InputError`.

    Raises:
        InputError: For every `InputError` in the context.
    """
    try:
        yield
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def yaml_content(text: str, path: str | Path) -> Any:
    """Return the content of a YAML text as plain mappings, lists, numbers and strings.

    Aliases and Python tags are refused.

    Args:
        text: The YAML text.
        path: The file that has the text, for messages.

    Raises:
        InputError: If the text is not valid YAML, or has an alias or a Python tag.
    """
    import yaml  # late: most files are none

    class Plain(yaml.SafeLoader):
        """A YAML loader that refuses aliases, with which a few lines can expand without limit."""

        def compose_node(self, parent: Any, index: Any) -> Any:
            if self.check_event(yaml.AliasEvent):
                raise ValueError("it uses an alias (*name); write the values out")
            return super().compose_node(parent, index)

    return parsed(lambda: yaml.load(text, Plain), path, "YAML")  # a safe loader


def decimal_number(text: str) -> float | None:
    """Return the number that ``text`` spells in ASCII, possibly nan or infinite; None if it is not a number."""
    try:
        return float(text) if text.isascii() and "_" not in text else None  # no 1_000, and no digits of any script
    except ValueError:
        return None


def one_line(text: str) -> str:
    """Return ``text`` with every unprintable character, such as a line end, replaced by a space."""
    return "".join(c if c.isprintable() else " " for c in text)


def shortened(value: object, length: int = 60) -> str:
    """Return ``value`` as text on one line, cut to at most ``length`` characters, to be quoted in a message."""
    try:
        text = str(value) if not isinstance(value, str) else value
    except ValueError:  # an integer of more than 4300 digits
        return "a number of thousands of digits"
    text = one_line(text[: 4 * length])
    return text if len(text) <= length else f"{text[: length - 2].rstrip()} …"


def screen_width(otherwise: int = 100_000) -> int:
    """Return the width of a line in characters.

    It is the environment variable COLUMNS if set, else the terminal's width, or ``otherwise`` without a terminal.
    """
    return shutil.get_terminal_size((otherwise, 24)).columns


def folded(text: str, width: int) -> list[str]:
    """Return a text's lines, wrapped at ``width`` characters; all lines but the first are indented by four spaces."""
    return wrap(text, width, subsequent_indent="    ", break_long_words=False, break_on_hyphens=False) or [""]


def side_by_side(sizes: Sequence[int], repeated: int, width: int) -> list[list[int]]:
    """Split a wide table into several tables that fit ``width``, and return the column indices (from 0) of each table.

    Args:
        sizes: Width of each column, including the space between columns, characters.
        repeated: Number of leading columns that every table repeats.
        width: Width of a line, characters.
    """
    tables = [list(range(repeated))]
    for column in range(repeated, len(sizes)):
        if len(tables[-1]) > repeated and sum(sizes[i] for i in (*tables[-1], column)) > width:
            tables.append(list(range(repeated)))
        tables[-1].append(column)
    return tables


def listed(names: Iterable[str], length: int = 600) -> str:
    """Return names joined with commas for a message, each shortened, in at most ``length`` characters."""
    return shortened(", ".join(shortened(name) for name in names), length)


def count_of(count: float, noun: str, plural: str = "") -> str:
    """Return a count with its noun: "1 arm", "2 arms"; the plural is ``plural``, or the noun and an s."""
    return f"{count} {noun if count == 1 else plural or noun + 's'}"


def unknown(what: str, name: str, known: Sequence[str], where: str = "") -> str:
    """Return a message on a name that is not known, with the known name that is most like it, and all of them.

    Args:
        what: What is named: "key".
        name: The name.
        known: The known names.
        where: Words after the name, such as " in [load]".
    """
    near = difflib.get_close_matches(name, known, 1, 0.5)
    perhaps = f"perhaps {near[0]} is meant: " if near else ""
    return f"unknown {what} '{shortened(name)}'{where}; {perhaps}known are {listed(known)}"


def is_file(path: str | Path) -> bool:
    """Return whether ``path`` is a file; False for a path that no file can have (too long, with a zero byte)."""
    with suppress(OSError, ValueError):
        return Path(path).is_file()
    return False


def reason_of(error: Exception) -> str:
    """Return an exception's message on one line, without Python's hint about ``sys.set_int_max_str_digits``."""
    text = getattr(error, "strerror", None) or str(error) or type(error).__name__
    return shortened(re.sub(r"\s+", " ", re.sub(r"; use sys\.set_int_max_str_digits\(\).*", "", text)), 200)


Named = str | Path | Iterable[str | Path] | None
"""The files that an option names: one file, several files, or none."""

FULL = (errno.ENOSPC, errno.EFBIG, errno.EDQUOT)
"""Error numbers of a full disk, an exceeded quota, and a file that is too large."""


def write_whole(path: str | Path, write: Callable[[Path], Any]) -> Path:
    """Call ``write`` to fill a temporary file beside ``path``, then rename that file to ``path``.

    File and folder are flushed to the disk, so that a power cut leaves either the old file or the new one. If ``path``
    is a symbolic link, its target is replaced. Devices, pipes and the standard streams are written into directly.
    If an earlier process of this machine was killed while it wrote, its temporary file in the folder is removed.

    Args:
        path: Path of the finished file. Missing folders are made.
        write: Function that writes the content to the path that it is called with. This temporary path has the suffix
            of ``path``.

    Returns:
        The path written.

    Raises:
        InputError: If the file cannot be written: no permission, no space, or a folder in its place.
    """
    path = Path(path)
    try:
        if _is_device(path) or _stream(path) is not None:
            _write_into(path, write)
            return path
        target = Path(os.path.realpath(path))
        if wrong := errno.EISDIR if target.is_dir() else errno.ELOOP if target.is_symlink() else 0:
            raise OSError(wrong, os.strerror(wrong))
        target.parent.mkdir(parents=True, exist_ok=True)
        _sweep(target.parent)
        temporary = _temporary(target)
    except OSError as error:
        raise _unwritable(path, error) from error
    try:
        write(temporary)
        with temporary.open("rb+") as file:
            os.fsync(file.fileno())
        os.replace(temporary, target)
        _flush_folder(target.parent)
    except Exception as error:
        if (fault := _fault_of_the_disk(error)) is None:
            raise
        raise InputError(f"cannot write {path}: {fault.strerror or fault}") from error
    finally:
        temporary.unlink(missing_ok=True)
    return path


def _unwritable(path: Path, error: OSError) -> InputError:
    return InputError(f"cannot write {path}: {error.strerror or error}; choose a folder that can be written")


def _fault_of_the_disk(error: BaseException | None) -> OSError | None:
    """Return ``error`` if it is an OSError.

    Else return the error of a full disk (`FULL`) that was being handled when ``error`` was raised; None without one.
    """
    if isinstance(error, OSError):
        return error
    before = None if error is None else error.__context__
    return before if isinstance(before, OSError) and before.errno in FULL else None


def _temporary(target: Path) -> Path:
    """Make an empty file beside ``target``, named after this process, with the permissions of any other new file."""
    temporary = target.with_name(f".pickenv-{_machine()}-{os.getpid()}-{secrets.token_hex(4)}{target.suffix}")
    os.close(os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))  # less what the umask takes away
    return temporary


@cache
def _machine() -> str:
    """Return a short name for the machine or container within which process ids are unique."""
    processes = Path("/proc/self/ns/pid")
    space = os.readlink(processes) if processes.is_symlink() else ""
    return hashlib.sha256(f"{platform.node()} {space}".encode()).hexdigest()[:8]


@cache
def _sweep(folder: Path) -> None:
    """Remove from a folder the temporary files of this machine's ended processes; later calls for it do nothing."""
    if not os.access(folder, os.R_OK):
        return
    ours = re.compile(rf"\.pickenv-{_machine()}-(\d+)-[0-9a-f]{{8}}(\..*)?")
    for entry in os.scandir(folder):
        if (match := ours.fullmatch(entry.name)) and not _is_running(int(match[1])):
            with suppress(OSError):  # another user's, in a folder for all
                os.unlink(entry.path)


def _is_running(process: int) -> bool:
    """Return whether the process with this id is running; always True on Windows, where `os.kill` would end it."""
    try:
        if sys.platform != "win32":
            os.kill(process, 0)
    except PermissionError:  # of another user
        return True
    except (ProcessLookupError, OverflowError):
        return False
    return True


def _flush_folder(folder: Path) -> None:
    """Flush a folder's entries to the disk if possible; Windows and some file servers do not support it."""
    if sys.platform == "win32" or not os.access(folder, os.R_OK):
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.ENOTSUP):
            raise
    finally:
        os.close(handle)


def _write_into(path: Path, write: Callable[[Path], Any]) -> None:
    """Let ``write`` fill a temporary file, then write the content to the device, pipe or stream at ``path``."""
    with tempfile.TemporaryDirectory() as folder:
        temporary = Path(folder) / f"content{path.suffix}"
        write(temporary)
        content = temporary.read_bytes()
    stream = _stream(path)
    if sys.stdout is not None:
        sys.stdout.flush()
    with path.open("wb") if stream is None else os.fdopen(os.dup(stream), "wb") as file:
        file.write(content)


def _stream(path: Path) -> int | None:
    """Return the descriptor of the stream that ``path`` is: 1 for standard output, 2 for standard error; else None."""
    for number in (1, 2):
        with suppress(OSError):  # a closed stream, a file that is not there yet
            if os.path.samestat(os.fstat(number), path.stat()):
                return number
    return None


def write_text(path: str | Path, text: str) -> Path:
    """Write ``text`` to ``path`` as UTF-8, atomically, and return the path."""
    return write_whole(path, lambda temporary: temporary.write_text(text, encoding="utf-8"))


def write_json(path: str | Path, content: Any) -> Path:
    """Write ``content`` to ``path`` as indented JSON, atomically, and return the path."""
    return write_text(path, json.dumps(content, indent=2) + "\n")


def separate(inputs: Mapping[str, Named], outputs: Mapping[str, Named]) -> None:
    """Raise an error if an output is also an input or another output; to be called before anything is computed.

    Symbolic links, hard links and different spellings of one file are recognised. A device may be named twice. Several
    files of one option, such as the files of a run folder, are compared only with other options' files.

    Args:
        inputs: Files that are read, by the name of the option that names them, such as "--arm". Names that are not
            files, such as an arm's "ur5", are ignored. Of "arm.urdf#tip" only "arm.urdf" counts.
        outputs: Files that will be written, by the name of the option that names them, such as "--out".

    Raises:
        InputError: If an output is an input or another option's output. The message names both options. Also if an
            output's name is too long for a file, or is the name of a folder.
    """
    taken = [(f"{name} reads", path) for name, names in inputs.items() for path in _paths(names) if path.exists()]
    for output, names in outputs.items():
        paths = list(_paths(names))
        for path in paths:
            _check_name(path)
            for use, written in taken:
                if not _is_device(path) and _same(path, written):
                    raise InputError(f"{output} would write over {path}, which {use}; give {output} another file")
        taken += [(f"{output} writes too", path) for path in paths]


def _paths(named: Named) -> Iterator[Path]:
    """Yield the paths of the files that an option names: none for None, one for a path, else several."""
    for name in () if named is None else (named,) if isinstance(named, str | Path) else named:
        path, _, tip = str(name).rpartition("#")
        yield Path(path) if path.endswith((".urdf", ".xml")) and tip else Path(name)


def _check_name(path: Path) -> None:
    """Raise an error if an output's name is too long or names a folder; to be called before hours of computing."""
    try:
        if path.exists() and path.is_dir():
            raise InputError(f"cannot write {path}: it is a folder; give the name of a file")
    except OSError as error:
        raise InputError(f"cannot write {path}: {error.strerror}; give another name") from error


def _same(one: Path, other: Path) -> bool:
    """Return whether two paths lead to the same file, which need not exist yet."""
    if one.exists() and other.exists():
        return one.samefile(other)
    return os.path.normcase(os.path.realpath(one)) == os.path.normcase(os.path.realpath(other))


def _is_device(path: Path) -> bool:
    """Return whether ``path`` leads to a device or a pipe, so to neither a file nor a folder."""
    return path.exists() and not path.is_file() and not path.is_dir()


# Locks.

LOCK = ".lock"

_held: set[str] = set()
"""Folders that this process has locked. If `locked` is called again for one of these folders, it does nothing."""


@contextmanager
def locked(folder: str | Path, wait: bool = False) -> Iterator[None]:
    """Return a context in which only this process, with its child processes, may write into a run folder.

    Args:
        folder: The folder. Missing folders are made, and removed again if they stay empty.
        wait: Whether to wait until no other process is at work in the folder.

    Raises:
        InputError: If another process is at work in the folder and ``wait`` is False, or if the folder cannot be
            written.
    """
    name = os.path.realpath(folder)
    if name in _held:
        yield
        return
    path = Path(folder)
    new = [parent for parent in (path, *path.parents) if not parent.exists()]
    handle = _take(path, wait)
    _held.add(name)
    try:
        yield
    finally:
        _held.discard(name)
        if sys.platform != "win32":  # where an open file cannot be taken away
            (path / LOCK).unlink(missing_ok=True)
        os.close(handle)
        with suppress(OSError):  # the first that is not empty stays, and those above it
            for parent in new:
                parent.rmdir()


def _take(folder: Path, wait: bool) -> int:
    """Lock ``folder``, write this process's id into the lock file, and return the open file's descriptor."""
    path = folder / LOCK
    try:
        folder.mkdir(parents=True, exist_ok=True)
        while True:
            handle = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
            if not _lock(handle):
                if wait:
                    os.close(handle)
                    time.sleep(0.2)
                    continue
                owner = os.read(handle, 20).decode("ascii", "replace") or "unknown"
                os.close(handle)
                busy = f"another run (process {owner}) is at work in {folder}"
                raise InputError(f"{busy}; wait for its end, or give another folder")
            if _is_still(path, handle):
                break
            os.close(handle)  # its owner took the file away as we came
        os.truncate(handle, 0)
        os.write(handle, str(os.getpid()).encode())
    except OSError as error:
        raise _unwritable(folder, error) from error
    return handle


def _is_still(path: Path, handle: int) -> bool:
    """Return whether ``path`` still leads to the open file with the descriptor ``handle``."""
    with suppress(FileNotFoundError):
        return os.path.samestat(os.fstat(handle), path.stat())
    return False


if sys.platform == "win32":
    import msvcrt

    FAR = 2**30
    """The byte that is locked: beyond the process id, which others are to read."""

    def _lock(handle: int) -> bool:
        os.lseek(handle, FAR, os.SEEK_SET)
        try:
            msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)
        except OSError:
            return False
        finally:
            os.lseek(handle, 0, os.SEEK_SET)
        return True

else:
    import fcntl

    def _lock(handle: int) -> bool:
        """Lock an open file for this process; False if another process has locked it."""
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        except OSError:  # a file system without locks
            return True
        return True
