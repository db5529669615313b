"""Files are written whole or not at all: write beside, then rename, so that an interrupt never leaves half a file."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from pickenv.errors import InputError

Named = str | Path | Iterable[str | Path] | None
"""What an option names: a file, several, or none."""


def write_whole(path: str | Path, write: Callable[[Path], Any]) -> Path:
    """Let ``write`` fill a temporary file beside ``path``, then rename it into place.

    Args:
        path: Where the finished file shall stand; missing folders are made.
        write: Called with the temporary path (same suffix as ``path``); it writes the content.

    Returns:
        The path written.

    Raises:
        InputError: If the folder cannot be written.
    """
    path = Path(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(prefix=f".{path.stem}-", suffix=path.suffix, dir=path.parent)
    except OSError as error:
        reason = error.strerror or error
        raise InputError(f"cannot write {path}: {reason}; choose a folder that can be written") from error
    temporary = Path(name)
    try:
        os.close(handle)
        umask = os.umask(0)
        os.umask(umask)
        temporary.chmod(0o666 & ~umask)  # mkstemp makes private files; a result is to be shared like any other file
        write(temporary)
        os.replace(temporary, path)
    except OSError as error:
        raise InputError(f"cannot write {path}: {error.strerror or error}") from error
    finally:
        temporary.unlink(missing_ok=True)
    return path


def write_text(path: str | Path, text: str) -> Path:
    """Write ``text`` to ``path`` as UTF-8, whole or not at all."""
    return write_whole(path, lambda temporary: temporary.write_text(text, encoding="utf-8"))


def separate(inputs: Mapping[str, Named], outputs: Mapping[str, Named]) -> None:
    """Refuse to write over what is read, or two results into one file; call it before anything is computed.

    Links, hard links and different spellings of one file are seen through. Devices may be named twice. Several files of
    one option, such as those of a run folder, are compared with other options' files, not with one another.

    Args:
        inputs: What is read, by the option's name; names that are no files, such as an arm's "ur5", are passed over,
            and of "arm.urdf#tip" the part before "#" counts.
        outputs: What will be written, by the option's name.

    Raises:
        InputError: If an output is an input or another option's output; the message names both options.
    """
    taken = [(f"{name} reads", path) for name, named in inputs.items() for path in _paths(named) if path.exists()]
    for output, named in outputs.items():
        paths = list(_paths(named))
        for path in paths:
            for use, other in taken:
                if not _is_device(path) and _same(path, other):
                    raise InputError(f"{output} would write over {path}, which {use}; give {output} another file")
        taken += [(f"{output} writes too", path) for path in paths]


def _paths(named: Named) -> Iterator[Path]:
    """The files that an option names."""
    names = () if named is None else (named,) if isinstance(named, str | Path) else named
    for name in names:
        path, _, tip = str(name).rpartition("#")
        yield Path(path) if path.endswith(".urdf") and tip else Path(name)


def _same(one: Path, other: Path) -> bool:
    """Whether two paths lead to one file, be it there already or not."""
    if one.exists() and other.exists():
        return one.samefile(other)
    return os.path.normcase(os.path.realpath(one)) == os.path.normcase(os.path.realpath(other))


def _is_device(path: Path) -> bool:
    """Whether ``path`` leads to something that is neither file nor folder: a device, a pipe."""
    return path.exists() and not path.is_file() and not path.is_dir()
