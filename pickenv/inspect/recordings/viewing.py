"""Show recordings, live or finished: in a new or running viewer, in a browser, or by a server on this machine."""

from __future__ import annotations

import io
import os
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext, suppress
from http.client import HTTPConnection
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.parse import quote, urlsplit

import rerun as rr
import rerun.blueprint as rrb
from rerun.chunk import RrdReader

from pickenv.base import InputError, command_line, command_words

VIEWER_PORT = 9876
"""Port at which rerun's viewer listens by default."""
VIEWER_MEMORY = "2GiB"
"""Memory limit of a viewer, beyond which it forgets the oldest steps."""
PATIENCE = 5.0
"""Time to wait for an answer from a running viewer, and for its end after a request to end, s."""
START_PATIENCE = 30.0
"""Time to wait for a viewer or its server to start, s."""
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


# The viewer's page for a browser on this machine, which may ask nobody else: no telemetry, no fonts, no news. rerun
# serves the page; what stands here hands it on with a content security policy that names the recording's own server
# and no other, and only to who asks for this machine by name, so that no foreign site can reach it by a name of its
# own.


@contextmanager
def quiet_page(host: str, viewer: int, data: int) -> Iterator[int]:
    """Return a context that serves a viewer's web page again at a new port, with a content security policy.

    The value of the context is the new port.

    Args:
        host: This machine's own address, 127.0.0.1.
        viewer: Port at which rerun serves its page.
        data: Port at which rerun serves the recording.
    """
    policy = (
        "default-src 'self' 'unsafe-inline' 'unsafe-eval' 'wasm-unsafe-eval' blob: data:; "
        f"connect-src 'self' blob: data: http://{host}:{data}"
    )

    class Page(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def do_GET(self) -> None:
            if self.headers.get("Host") not in (f"{host}:{port}", f"localhost:{port}"):
                self.send_error(403)
                return
            headers = {name: self.headers[name] for name in ("Accept", "Accept-Encoding") if name in self.headers}
            connection = HTTPConnection(host, viewer, timeout=START_PATIENCE)
            try:
                connection.request("GET", self.path, headers=headers)
                response = connection.getresponse()
                content = response.read()
            except OSError:
                self.send_error(502)
                return
            finally:
                connection.close()
            self.send_response(response.status)
            for name, value in response.getheaders():
                if name.lower() in ("content-type", "content-encoding", "cache-control"):
                    self.send_header(name, value)
            self.send_header("Content-Length", str(len(content)))
            self.send_header("Content-Security-Policy", policy)
            self.end_headers()
            self.wfile.write(content)

        def log_message(self, format: str, *args: object) -> None:
            """Log nothing about requests."""

    with ThreadingHTTPServer((host, 0), Page) as server:
        port = server.server_address[1]
        threading.Thread(target=server.serve_forever, daemon=True).start()
        try:
            yield port
        finally:
            server.shutdown()


# A picture of a recording as rerun's own viewer shows it, without a screen; needs a graphics adapter.


WINDOW = "1600x900"
STARTING, VIEWER_PICTURE_PATIENCE = 20.0, 60.0
"""Longest times to wait for the viewer's first answer, and for its picture to stop changing, s."""

LOOK_AGAIN = 1.0
"""Time between two screenshots that are compared, s. It is long because messages fade and shaders are loaded late."""


def viewer_picture(recording: Path) -> bytes | None:
    """Return a picture of a recording in its default layout as lossless WebP; None if this computer cannot draw it.

    Args:
        recording: The .rrd file.
    """
    with headless_viewer() as viewer:
        if viewer is None:
            return None
        try:
            viewer.open(str(recording.resolve()))
            last, deadline = b"", time.monotonic() + VIEWER_PICTURE_PATIENCE
            while time.monotonic() < deadline:
                time.sleep(LOOK_AGAIN)
                look = viewer.take_screenshot(max_size=256)
                if look == last and not viewer.get_state().loading:
                    break
                last = look
            return _packed(viewer.take_screenshot())
        except (OSError, RuntimeError):  # the viewer ended: Mesa's processor driver is known to crash it now and then
            return None


@contextmanager
def headless_viewer() -> Iterator[Any]:
    """Return a context with a client of a viewer without a window, or with None if there is no graphics adapter."""
    from rerun.experimental import ViewerClient

    port = _free_port()
    quiet: dict[str, Any] = {"headless": True, "hide_welcome_screen": True, "window_size": WINDOW}
    with tempfile.TemporaryDirectory() as folder:
        command = rerun_command(**quiet, bind=LOCAL, port=port)
        # With these variables it neither asks nor leaves files.
        process = started(command, RERUN_APP_ONLY="true", XDG_RUNTIME_DIR=folder)
        client, deadline = None, time.monotonic() + STARTING
        try:
            while client is None and process.poll() is None and time.monotonic() < deadline:
                try:
                    client = ViewerClient.connect(f"rerun+http://127.0.0.1:{port}/proxy")
                    client.get_state()
                except (OSError, RuntimeError):
                    client = None
                    time.sleep(0.2)
            yield client
        finally:
            with suppress(ProcessLookupError):  # it has ended
                os.killpg(process.pid, signal.SIGKILL)  # the command only starts the viewer, which would outlive it
            process.wait()


def _packed(png: bytes) -> bytes:
    """Return a PNG picture as lossless WebP, which is about a third of the size."""
    from PIL import Image

    buffer = io.BytesIO()
    Image.open(io.BytesIO(png)).convert("RGB").save(buffer, "WEBP", lossless=True)
    return buffer.getvalue()


def check_recording(path: str | Path) -> None:
    """Raise an error if the installed rerun viewer cannot show a file.

    Raises:
        InputError: If the file is missing, is no recording, or is damaged. Also if it was written by a newer rerun than
            the installed one, or by a rerun that is older by more than one minor version. Rerun does not promise to
            read older files.
    """
    path = Path(path)
    try:
        with path.open("rb") as file:
            head = file.read(8)
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror}; give a recording (.rrd) or a run folder") from error
    if len(head) < 8 or not head.startswith(b"RRF"):  # a digit and the writer's version follow
        raise InputError(f"{path} is not a Rerun recording; give a recording (.rrd) or a run folder")
    written = (head[4], head[5])
    major, minor = (int(part) for part in rr.__version__.split(".")[:2])
    if not (major, minor - 1) <= written <= (major, minor):
        raise InputError(
            f"{path} was written by rerun {written[0]}.{written[1]}, and {major}.{minor} is installed, which reads its "
            "own recordings and those of the minor version before; make the recording again"
        )
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", message="RRD file has no footer")  # a killed writer's rows can be read
            recordings = RrdReader(path).recordings()
    except RuntimeError as error:
        raise InputError(f"{path} is damaged ({error}); make the recording again") from error
    if not recordings:
        raise InputError(f"{path} holds no recording; make it again")


def open_native(paths: Sequence[Path]) -> None:
    """Show recordings (.rrd) in a window of rerun, new or already open, and return when rerun ends.

    Raises:
        InputError: If there is no screen.
    """
    check_screen()
    _run(*paths, bind=LOCAL, port=VIEWER_PORT, memory_limit=VIEWER_MEMORY)


def open_web(paths: Sequence[Path]) -> None:
    """Serve recordings to a browser on this machine until interrupted, and print the address to open."""
    web, data = _free_port(), _free_port()
    source = quote(f"rerun+http://{LOCAL}:{data}/proxy", safe="")
    with nullcontext(web) if telemetry_wanted() else quiet_page(LOCAL, web, data) as page:
        print(f"open http://{LOCAL}:{page}/?url={source} in a browser; Ctrl-C ends", flush=True)
        _serve(*paths, serve_web=True, bind=LOCAL, port=data, web_viewer_port=web)


def serve(paths: Sequence[Path], port: int) -> None:
    """Serve recordings to viewers that connect to ``port`` of this machine, until interrupted."""
    client = command_line("rerun", connect=f"rerun+http://{LOCAL}:{port}/proxy")
    print(f"connect with: {client}; Ctrl-C ends", flush=True)
    _serve(*paths, serve_grpc=True, bind=LOCAL, port=port)


def send(paths: Sequence[Path], url: str) -> None:
    """Send recordings to a running viewer at the address ``url``, such as `rerun+http://127.0.0.1:9876/proxy`.

    Raises:
        InputError: If no viewer answers at ``url``, or the viewer does not receive everything.
    """
    check_answers(url)
    for path in paths:
        (entry, *_) = RrdReader(path).recordings()
        stream = rr.RecordingStream(entry.application_id, recording_id=entry.recording_id, send_properties=False)
        stream.set_sinks(rr.GrpcSink(url))
        stream.log_file_from_path(path)
        try:
            stream.flush(timeout_sec=PATIENCE)
        except RuntimeError as error:
            raise InputError(f"the viewer at {url} did not take {path} within {PATIENCE:g} s: {error}") from error


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind((LOCAL, 0))
        return int(probe.getsockname()[1])


def _serve(*paths: Path, **options: object) -> None:
    """Run the installed rerun until it is interrupted, which is the normal end of serving."""
    try:
        _run(*paths, **options)
    except KeyboardInterrupt:
        print("ended: the recording is no longer served", file=sys.stderr)
        raise SystemExit(130) from None  # as shells have it after Ctrl-C


def _run(*paths: Path, **options: object) -> None:
    """Run the installed rerun; when this program ends, end rerun and the programs that it started."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # ended from outside is ended as by Ctrl-C
    process = started(rerun_command(*paths, **options))
    try:
        code = process.wait()
    except BaseException:
        _end(process)
        raise
    if code != 0:
        shown = command_line("rerun", *paths, **options)
        raise InputError(f"rerun ended with code {code}; what it says is shown by: {shown}")


def _end(process: subprocess.Popen[bytes]) -> None:
    """End a program; on POSIX also its process group, because `rerun` is a script that starts the actual program.

    A viewer that takes longer than `PATIENCE` to end is killed.
    """
    if sys.platform == "win32":
        process.terminate()
        process.wait()
        return
    with suppress(ProcessLookupError, subprocess.TimeoutExpired):
        os.killpg(process.pid, signal.SIGTERM)
        process.wait(PATIENCE)
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()
