"""A run folder belongs to one process at a time: results of two runs are never mixed in it.

The lock is the operating system's own, on the file `.lock` in the folder, so that it ends with its process however that
ends; the file's content says whose it is. On a file system without locks, runs go on without.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from pickenv.base.errors import InputError

FILE = ".lock"

_held: set[str] = set()
"""Folders that this process has locked: what it calls may lock them again."""


@contextmanager
def locked(folder: str | Path) -> Iterator[None]:
    """Have a run folder for this process alone inside the context; child processes may write for it.

    Args:
        folder: The folder; made where it is missing, with those above it, and taken away again if it stays empty.

    Raises:
        InputError: If another process is at work in it, or it cannot be written.
    """
    name = os.path.realpath(folder)
    if name in _held:
        yield
        return
    path = Path(folder)
    new = [each for each in (path, *path.parents) if not each.exists()]
    handle = _take(path)
    _held.add(name)
    try:
        yield
    finally:
        _held.discard(name)
        _give_back(path, handle)
        with suppress(OSError):  # the first that is not empty stays, and those above it
            for each in new:
                each.rmdir()


def _take(folder: Path) -> int:
    """The open lock file of ``folder``, with our process id in it."""
    path = folder / FILE
    try:
        folder.mkdir(parents=True, exist_ok=True)
        while True:
            handle = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
            if not _lock(handle):
                owner = os.read(handle, 20).decode("ascii", "replace")
                os.close(handle)
                raise InputError(
                    f"another run (process {owner or 'unknown'}) is at work in {folder}; wait for its end, or give "
                    "another folder"
                )
            if _is_still(path, handle):
                break
            os.close(handle)  # its owner took the file away as we came
        os.truncate(handle, 0)
        os.write(handle, str(os.getpid()).encode())
    except OSError as error:
        raise InputError(
            f"cannot write {folder}: {error.strerror or error}; choose a folder that can be written"
        ) from error
    return handle


def _is_still(path: Path, handle: int) -> bool:
    """Whether ``path`` is the file that ``handle`` opened."""
    try:
        return os.path.samestat(os.fstat(handle), path.stat())
    except FileNotFoundError:
        return False


def _give_back(folder: Path, handle: int) -> None:
    if sys.platform != "win32":  # where an open file cannot be taken away
        (folder / FILE).unlink(missing_ok=True)
    os.close(handle)


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
        """Lock an open file for this process; False where another holds it."""
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        except OSError:  # a file system without locks
            return True
        return True
