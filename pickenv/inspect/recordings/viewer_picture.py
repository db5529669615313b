"""A picture of a recording as rerun's own viewer shows it, without a screen; needs a graphics adapter."""

from __future__ import annotations

import io
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from pickenv.inspect.recordings.live import viewer_environment

WINDOW = "1600x900"
STARTING, PATIENCE = 20.0, 60.0
"""Longest times to wait for the viewer's first answer, and until its picture stands still, s."""

LOOK_AGAIN = 1.0
"""Time between two looks, s: messages fade and shaders come in late."""


def viewer_picture(recording: Path) -> bytes | None:
    """The recording in its default layout as lossless WebP; None where this computer cannot draw it.

    Args:
        recording: The .rrd file.
    """
    with headless_viewer() as viewer:
        if viewer is None:
            return None
        try:
            viewer.open(str(recording.resolve()))
            last, deadline = b"", time.monotonic() + PATIENCE
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
    """A client of a viewer that has no window; None where there is no graphics adapter for it."""
    from rerun.experimental import ViewerClient

    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    options = ["--headless", "--hide-welcome-screen", "--window-size", WINDOW, "--bind", "127.0.0.1"]
    with tempfile.TemporaryDirectory() as folder:
        process = subprocess.Popen(
            [sys.executable, "-m", "rerun_cli", *options, "--port", str(port)],
            env=viewer_environment()
            | {"RERUN_APP_ONLY": "true", "XDG_RUNTIME_DIR": folder},  # it neither asks nor leaves files
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
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
    """The same picture at a third of the size."""
    from PIL import Image

    buffer = io.BytesIO()
    Image.open(io.BytesIO(png)).convert("RGB").save(buffer, "WEBP", lossless=True)
    return buffer.getvalue()
