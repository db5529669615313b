"""Open finished recordings in the native viewer, a browser or a running viewer, or serve them to other viewers."""

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
from urllib.parse import quote

import rerun as rr
from rerun.chunk import RrdReader

from pickenv.base import InputError, command_line
from pickenv.inspect.recordings import live

# The viewer's page for a browser on this machine, which may ask nobody else: no telemetry, no fonts, no news. rerun
# serves the page; what stands here hands it on with a content security policy that names the recording's own server
# and no other, and only to who asks for this machine by name, so that no foreign site can reach it by a name of its
# own.


HANDED_ON = ("content-type", "content-encoding", "cache-control")
PATIENCE = 30.0
"""Time to wait for the viewer's own server, s."""


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
            connection = HTTPConnection(host, viewer, timeout=PATIENCE)
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
                if name.lower() in HANDED_ON:
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
        command = live.rerun_command(**quiet, bind=live.LOCAL, port=port)
        # With these variables it neither asks nor leaves files.
        process = live.started(command, RERUN_APP_ONLY="true", XDG_RUNTIME_DIR=folder)
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


BY_CTRL_C = 130
"""Exit code of a program that Ctrl-C ended, as in shells."""
HEADER = b"RRF"
"""First bytes of every recording; a digit and the writer's version follow."""


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
    if len(head) < 8 or not head.startswith(HEADER):
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
    live.check_screen()
    _run(*paths, bind=live.LOCAL, port=live.VIEWER_PORT, memory_limit=live.VIEWER_MEMORY)


def open_web(paths: Sequence[Path]) -> None:
    """Serve recordings to a browser on this machine until interrupted, and print the address to open."""
    web, data = _free_port(), _free_port()
    source = quote(f"rerun+http://{live.LOCAL}:{data}/proxy", safe="")
    with nullcontext(web) if live.telemetry_wanted() else quiet_page(live.LOCAL, web, data) as page:
        print(f"open http://{live.LOCAL}:{page}/?url={source} in a browser; Ctrl-C ends", flush=True)
        _serve(*paths, serve_web=True, bind=live.LOCAL, port=data, web_viewer_port=web)


def serve(paths: Sequence[Path], port: int) -> None:
    """Serve recordings to viewers that connect to ``port`` of this machine, until interrupted."""
    client = command_line("rerun", connect=f"rerun+http://{live.LOCAL}:{port}/proxy")
    print(f"connect with: {client}; Ctrl-C ends", flush=True)
    _serve(*paths, serve_grpc=True, bind=live.LOCAL, port=port)


def send(paths: Sequence[Path], url: str) -> None:
    """Send recordings to a running viewer at the address ``url``, such as `rerun+http://127.0.0.1:9876/proxy`.

    Raises:
        InputError: If no viewer answers at ``url``, or the viewer does not receive everything.
    """
    live.check_answers(url)
    for path in paths:
        (entry, *_) = RrdReader(path).recordings()
        stream = rr.RecordingStream(entry.application_id, recording_id=entry.recording_id, send_properties=False)
        stream.set_sinks(rr.GrpcSink(url))
        stream.log_file_from_path(path)
        try:
            stream.flush(timeout_sec=live.PATIENCE)
        except RuntimeError as error:
            raise InputError(f"the viewer at {url} did not take {path} within {live.PATIENCE:g} s: {error}") from error


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind((live.LOCAL, 0))
        return int(probe.getsockname()[1])


def _serve(*paths: Path, **options: object) -> None:
    """Run the installed rerun until it is interrupted, which is the normal end of serving."""
    try:
        _run(*paths, **options)
    except KeyboardInterrupt:
        print("ended: the recording is no longer served", file=sys.stderr)
        raise SystemExit(BY_CTRL_C) from None


def _run(*paths: Path, **options: object) -> None:
    """Run the installed rerun; when this program ends, end rerun and the programs that it started."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # ended from outside is ended as by Ctrl-C
    process = live.started(live.rerun_command(*paths, **options))
    try:
        code = process.wait()
    except BaseException:
        _end(process)
        raise
    if code != 0:
        shown = command_line("rerun", *paths, **options)
        raise InputError(f"rerun ended with code {code}; what it says is shown by: {shown}")


LEAVING = 5.0
"""Longest time that a viewer may take to end after a request to end, s."""


def _end(process: subprocess.Popen[bytes]) -> None:
    """End a program; on POSIX also its process group, because `rerun` is a script that starts the actual program.

    A viewer that takes longer than `LEAVING` to end is killed.
    """
    if sys.platform == "win32":
        process.terminate()
        process.wait()
        return
    with suppress(ProcessLookupError, subprocess.TimeoutExpired):
        os.killpg(process.pid, signal.SIGTERM)
        process.wait(LEAVING)
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()
