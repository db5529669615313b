"""Show recordings live: in a viewer started here, in a running viewer, or in viewers that connect to a server here."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import time
from contextlib import suppress
from urllib.parse import urlsplit

import rerun as rr
import rerun.blueprint as rrb

from pickenv.base import InputError, command_line, command_words

VIEWER_PORT = 9876
"""Port at which rerun's viewer listens by default."""
VIEWER_MEMORY = "2GiB"
"""Memory limit of a viewer, beyond which it forgets the oldest steps."""
PATIENCE = 5.0
"""Time to wait for an answer from a running viewer, s."""
START_PATIENCE = 30.0
"""Time to wait for a viewer to start, s."""
LOCAL = "127.0.0.1"


def open_live(
    recording_id: str,
    blueprint: rrb.Blueprint,
    *,
    spawn: bool = False,
    connect: str | None = None,
    serve: int | None = None,
) -> rr.RecordingStream:
    """Open a stream to viewers that show a recording while it grows.

    ``spawn``, ``connect`` and ``serve`` may be combined.

    Args:
        recording_id: Identity of the recording. A viewer shows recordings of one identity as one.
        blueprint: The layout.
        spawn: Whether to start a viewer on this machine, unless one runs already, and show the recording in it.
        connect: Address of a viewer or proxy, as `rerun` prints it: `rerun+http://127.0.0.1:9876/proxy`.
        serve: Port of a server on this machine, to which viewers can connect; None for no server.

    Raises:
        InputError: If there is no screen for a viewer, or no viewer answers at the address.
    """
    from pickenv.inspect.recordings.scribe import APPLICATION_ID

    stream = rr.RecordingStream(APPLICATION_ID, recording_id=recording_id, send_properties=False)
    sinks: list[rr.GrpcSink | rr.GrpcServerSink] = []
    if spawn:
        _start_viewer()
        sinks.append(rr.GrpcSink(f"rerun+http://{LOCAL}:{VIEWER_PORT}/proxy"))
    if connect is not None:
        check_answers(connect)
        sinks.append(rr.GrpcSink(connect))
    if serve is not None:
        sinks.append(rr.GrpcServerSink(bind_ip=LOCAL, port=serve))
    stream.set_sinks(*sinks, default_blueprint=blueprint)
    return stream


def _start_viewer() -> None:
    """Start a viewer that outlives this process, unless one runs already.

    The function does not use rerun's own `spawn`, whose viewer would listen to the network.

    Raises:
        InputError: If there is no screen, or the viewer does not answer in time.
    """
    if _listens():
        return
    check_screen()
    command = rerun_command(bind=LOCAL, port=VIEWER_PORT, memory_limit=VIEWER_MEMORY)
    started(command_words(*command, hide_welcome_screen=True, expect_data_soon=True))
    deadline = time.monotonic() + START_PATIENCE
    while not _listens():
        if time.monotonic() > deadline:
            raise InputError(f"no viewer came up within {START_PATIENCE:g} s; try it by hand: {' '.join(command)}")
        time.sleep(0.1)


def _listens() -> bool:
    """Return whether a viewer listens on this machine."""
    with suppress(OSError):
        socket.create_connection((LOCAL, VIEWER_PORT), timeout=PATIENCE).close()
        return True
    return False


def rerun_command(*words: object, **options: object) -> list[str]:
    """Return the command that starts the installed rerun, whose version fits the recordings.

    The command runs rerun as a module of this Python. A program called `rerun` may belong to another installation (pip
    --user, system site packages).

    Args:
        words: Arguments of the command.
        options: Options of the command by name: ``port=9876`` gives ``--port 9876``.
    """
    return command_words(sys.executable, "-m", "rerun_cli", *words, **options)


def started(command: list[str], **environment: str) -> subprocess.Popen[bytes]:
    """Start rerun as a process in a session of its own, and return the process.

    Rerun's log output is discarded, since it is long and would hide important messages.

    Args:
        command: The words of the command.
        environment: Additional environment variables.
    """
    quiet, variables = subprocess.DEVNULL, viewer_environment() | environment
    return subprocess.Popen(command, env=variables, stdout=quiet, stderr=quiet, start_new_session=True)


def telemetry_wanted() -> bool:
    """Return whether the viewer may send usage data to its makers: only if FORCE_RERUN_ANALYTICS is set."""
    return bool(os.environ.get("FORCE_RERUN_ANALYTICS"))


def viewer_environment() -> dict[str, str]:
    """Return this process's environment variables for a viewer, with CI set unless telemetry is wanted.

    CI switches the viewer's telemetry off.
    """
    return dict(os.environ) if telemetry_wanted() else {**os.environ, "CI": "1"}


def check_screen() -> None:
    """Raise an error if there is no screen for a window; rerun itself would crash.

    Raises:
        InputError: If there is no screen.
    """
    if sys.platform.startswith("linux") and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise InputError(
            "there is no screen to open a viewer on (DISPLAY and WAYLAND_DISPLAY are not set); show it in a browser "
            f"with `{command_line('pickenv', 'inspect', 'RUN', web=True)}`"
        )


def check_answers(url: str) -> None:
    """Raise an error if no viewer listens at an address; rerun itself would keep trying.

    Raises:
        InputError: If ``url`` is no address of a viewer, or nothing listens there.
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
