"""Rerun's programs as child processes on this machine only, and all of them gone afterwards."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

RERUN = Path(sys.executable).with_name("rerun")
LOCALHOST = "127.0.0.1"


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind((LOCALHOST, 0))
        return int(probe.getsockname()[1])


@contextmanager
def rerun(*arguments: str | Path, log: Path) -> Iterator[subprocess.Popen[bytes]]:
    """Run `rerun` bound to this machine, its output in the file ``log``.

    The command only starts the viewer, which outlives it: the whole group is ended.
    """
    command = [str(RERUN), *map(str, arguments), "--bind", LOCALHOST]
    environment = os.environ | {"RERUN_APP_ONLY": "true", "XDG_RUNTIME_DIR": str(log.parent)}  # neither asks nor writes
    with log.open("wb") as output:
        process = subprocess.Popen(
            command, env=environment, stdout=output, stderr=subprocess.STDOUT, start_new_session=True
        )
    try:
        yield process
    finally:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait(timeout=30)
