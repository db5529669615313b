"""How a command ends: with an exit code, and with one sentence if something went wrong.

Exit codes: 0 done, 2 bad input, 70 a fault of this program, 74 output cannot be printed, 130 interrupted. The last
three are as in sysexits.h and in shells.
"""

from __future__ import annotations

import errno
import os
import shlex
import sys
import tempfile
import traceback
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from pickenv import __version__
from pickenv.base import InputError, extra_of, shortened
from pickenv.base.extras import missing

BAD_INPUT, FAULT, NOT_PRINTED, INTERRUPTED = 2, 70, 74, 130

UNHEARD = (errno.EPIPE, errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)
"""Error numbers of failed printing: nobody reads the output any more, or the disk for the output is full or broken."""

SHOWN = 300
"""Largest number of characters that are printed of an unexpected error's message."""


def guarded(command: Callable[[], Any]) -> int:
    """Call ``command``, and return the exit code; catch errors, and print one sentence on each to standard error.

    Args:
        command: Function that parses and runs the command line; it returns an exit code, or None for 0.

    Returns:
        The exit code.
    """
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):  # a terminal that cannot show a character, such as ±, shows its number
            stream.reconfigure(errors="backslashreplace")
    try:
        code = command()
        if sys.stdout is not None:
            sys.stdout.flush()  # what cannot be printed is found now, and not when Python ends
        return code if isinstance(code, int) else 0
    except InputError as error:
        return _end(BAD_INPUT, f"error: {error}")
    except ModuleNotFoundError as error:
        if error.name is None or extra_of(error.name) is None:
            return _fault(error)
        return _end(BAD_INPUT, f"error: {missing(error.name)}")
    except KeyboardInterrupt:
        return _end(INTERRUPTED, "interrupted; files are written whole or not at all, so nothing is left half-written")
    except SystemExit as error:
        if isinstance(error.__context__, BrokenPipeError):  # rich ends so, without a word
            return _unheard(error.__context__)
        raise
    except OSError as error:
        if error.filename is not None:
            return _end(BAD_INPUT, f"error: cannot use {shortened(error.filename, SHOWN)}: {error.strerror}")
        return _unheard(error) if error.errno in UNHEARD else _fault(error)
    except Exception as error:
        return _fault(error)


def _unheard(error: OSError) -> int:
    code = _end(
        NOT_PRINTED,
        f"error: cannot print: {error.strerror}; the files that were asked for stand, the rest of the words is lost",
    )
    if sys.stdout is not None:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # else Python tries once more as it ends
    return code


def _fault(error: Exception) -> int:
    """Print that this program is at fault, write the details of ``error`` to a file, and return the exit code."""
    words = f"error: pickenv met a fault of its own ({shortened(f'{type(error).__name__}: {error}', SHOWN)})"
    details = f"pickenv {__version__}, Python {sys.version}\n{shlex.join(sys.argv)}\n\n"
    details += "".join(traceback.format_exception(error))
    for folder in (tempfile.gettempdir, os.getcwd):
        try:
            handle, name = tempfile.mkstemp(prefix="pickenv-fault-", suffix=".txt", dir=folder())
            with os.fdopen(handle, "w", encoding="utf-8", errors="backslashreplace") as file:
                file.write(details)
        except OSError:
            continue
        return _end(FAULT, f"{words}; please report it with {Path(name)}, which says where")
    return _end(FAULT, f"{details}\n{words}; please report it with the lines above, which no folder could take")


def _end(code: int, words: str) -> int:
    with suppress(OSError):  # where nobody hears that either, the exit code says it
        print(words, file=sys.stderr, flush=True)
    return code
