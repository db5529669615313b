"""Live viewers: one that is started here, one that runs already, or whoever asks a server here."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import urlsplit

import rerun as rr
import rerun.blueprint as rrb

from pickenv.errors import InputError

VIEWER_PORT = 9876
"""Where rerun's viewer listens unless told otherwise."""
VIEWER_MEMORY = "2GiB"
"""A viewer that is left open all day forgets the oldest steps beyond this."""
PATIENCE = 5.0
"""How long to wait for a viewer that runs, s."""
START_PATIENCE = 30.0
"""How long to wait for one that is being started, s."""
LOCAL = "127.0.0.1"


@dataclass(frozen=True)
class Live:
    """Where a recording is shown while it grows; all three at once are possible.

    Attributes:
        spawn: Start a viewer on this machine, or use the one that runs.
        connect: Address of a viewer or proxy, as `rerun` prints it: `rerun+http://127.0.0.1:9876/proxy`.
        serve: Port of a server on this machine, for viewers that connect later; None for no server.
    """

    spawn: bool = False
    connect: str | None = None
    serve: int | None = None

    def __bool__(self) -> bool:
        """Whether there is anyone to show it to."""
        return self.spawn or self.connect is not None or self.serve is not None


def open_live(live: Live, recording_id: str, blueprint: rrb.Blueprint) -> rr.RecordingStream:
    """A stream to everyone that ``live`` names.

    Raises:
        InputError: If there is no screen for a viewer, or no viewer answers at the address.
    """
    from pickenv.inspect.recordings.scribe import APPLICATION_ID

    stream = rr.RecordingStream(APPLICATION_ID, recording_id=recording_id, send_properties=False)
    sinks: list[rr.GrpcSink | rr.GrpcServerSink] = []
    if live.spawn:
        _start_viewer()
        sinks.append(rr.GrpcSink(f"rerun+http://{LOCAL}:{VIEWER_PORT}/proxy"))
    if live.connect is not None:
        check_answers(live.connect)
        sinks.append(rr.GrpcSink(live.connect))
    if live.serve is not None:
        sinks.append(rr.GrpcServerSink(bind_ip=LOCAL, port=live.serve))
    stream.set_sinks(*sinks, default_blueprint=blueprint)
    return stream


def _start_viewer() -> None:
    """Start a viewer that outlives this process, unless one runs; rerun's own `spawn` would listen to the network.

    Raises:
        InputError: If there is no screen, or the viewer does not come up.
    """
    if _listens(LOCAL, VIEWER_PORT):
        return
    check_screen()
    command = [str(rerun_program()), "--bind", LOCAL, "--port", str(VIEWER_PORT), "--memory-limit", VIEWER_MEMORY]
    quiet = subprocess.DEVNULL
    subprocess.Popen(
        [*command, "--hide-welcome-screen", "--expect-data-soon"], stdout=quiet, stderr=quiet, start_new_session=True
    )
    deadline = time.monotonic() + START_PATIENCE
    while not _listens(LOCAL, VIEWER_PORT):
        if time.monotonic() > deadline:
            raise InputError(f"no viewer came up within {START_PATIENCE:g} s; try it by hand: {' '.join(command)}")
        time.sleep(0.1)


def _listens(host: str, port: int) -> bool:
    try:
        socket.create_connection((host, port), timeout=PATIENCE).close()
    except OSError:
        return False
    return True


def rerun_program() -> Path:
    """The program `rerun` of the same installation, whose version fits the recordings."""
    return Path(sys.executable).with_name("rerun.exe" if sys.platform == "win32" else "rerun")


def check_screen() -> None:
    """Refuse to open a window where there is no screen, with a sentence instead of a panic.

    Raises:
        InputError: If there is none.
    """
    if sys.platform.startswith("linux") and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise InputError(
            "there is no screen to open a viewer on (DISPLAY and WAYLAND_DISPLAY are not set); use a web viewer"
        )


def check_answers(url: str) -> None:
    """Refuse an address where nobody listens; rerun itself would go on trying.

    Raises:
        InputError: If it is no such address, or nothing listens there.
    """
    form = f"rerun+http://{LOCAL}:{VIEWER_PORT}/proxy"
    try:
        parts = urlsplit(url)
        host, port = parts.hostname, parts.port
    except ValueError as error:
        raise InputError(f"'{url}' is not the address of a viewer ({error}); it looks like {form}") from error
    if parts.scheme not in ("rerun", "rerun+http", "rerun+https") or not host or parts.path != "/proxy":
        raise InputError(f"'{url}' is not the address of a viewer; it looks like {form}")
    try:
        socket.create_connection((host, port or VIEWER_PORT), timeout=PATIENCE).close()
    except OSError as error:
        reason = error.strerror or str(error)
        raise InputError(f"no viewer answers at {url} ({reason}); start one with `rerun`") from error
