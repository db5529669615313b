"""Rerun's web viewer in a page: it draws on a canvas, so what stands on screen is read from its accessibility tree.

The page offers that tree as answers of egui's inspection protocol, MessagePack both ways. Boxes are in CSS pixels.
"""

from __future__ import annotations

import base64
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal
from urllib.parse import SplitResult, urlsplit

import numpy as np
from numpy.typing import NDArray

from tests.browser.chromium import SIZE
from tests.browser.pictures import Box, Picture, crop, decode, settled

FIELD_OF_VIEW = np.radians(55.0)
"""Vertical, of rerun's orbiting eye."""
PATIENCE_MS = 120_000.0
STATE = "new TextDecoder().decode(window._handle.viewer_state())"


@dataclass(frozen=True)
class Widget:
    """Something on screen.

    Attributes:
        role: As AccessKit names it: pane, button, label.
        text: What it says; empty for pictures.
        box: Where it stands.
        toggled: Whether it can be switched on and off, as tabs can.
    """

    role: str
    text: str
    box: Box
    toggled: bool

    @property
    def middle(self) -> tuple[float, float]:
        left, top, right, bottom = self.box
        return (left + right) / 2.0, (top + bottom) / 2.0


@contextmanager
def serve(run: Path) -> Iterator[str]:
    """Serve a run's recording with `pickenv inspect --web`, and end it with Ctrl-C; yields the address it prints."""
    command = [sys.executable, "-m", "pickenv.cli", "inspect", str(run), "--web"]
    # A process that was started in the background ignores Ctrl-C, and would hand that on.
    heed = partial(signal.signal, signal.SIGINT, signal.SIG_DFL)
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, text=True, start_new_session=True, preexec_fn=heed
    ) as server:
        assert server.stdout is not None
        address = re.search(r"http://127\.0\.0\.1\S+", server.stdout.readline())
        assert address is not None
        try:
            _wait_for(urlsplit(address[0]))
            yield f"{address[0]}&persist=0&hide_welcome_screen"
        finally:
            server.send_signal(signal.SIGINT)
            server.wait(timeout=600)


def _wait_for(address: SplitResult) -> None:
    """The address is printed when the server starts, a moment before it answers."""
    end = time.monotonic() + PATIENCE_MS / 1e3
    while True:
        try:
            socket.create_connection((address.hostname, address.port), timeout=5.0).close()
            return
        except ConnectionRefusedError:
            assert time.monotonic() < end, "the server did not answer"
            time.sleep(0.1)


@dataclass(frozen=True)
class WebViewer:
    """A page with the viewer in it.

    Attributes:
        page: Playwright's page.
        devtools: The page's connection to Chromium's own protocol.
        said: What the page's console says.
    """

    page: Any
    devtools: Any
    said: list[str]

    @classmethod
    def within(cls, context: Any) -> WebViewer:
        """An empty page of a playwright context."""
        page = context.new_page()
        return cls(page, context.new_cdp_session(page), [])

    def open(self, address: str, theme: Literal["light", "dark"], expected: list[str]) -> None:
        """Load the page and wait until the viewer knows every one of the ``expected`` names."""
        # The viewer logs some 18 000 debug lines; carrying them out of the browser costs more than drawing.
        self.page.add_init_script("console.debug = () => {}")
        self.page.on("console", lambda message: self.said.append(message.text))
        self.page.goto(f"{address}&theme={theme}", wait_until="commit", timeout=PATIENCE_MS)
        self.page.wait_for_function(
            f"names => !!window._handle && names.every(name => {STATE}.includes(name))",
            arg=expected,
            timeout=PATIENCE_MS,
        )

    def complaints(self) -> list[str]:
        """Panics, and what the viewer itself logged as an error; a fetch that fails without a network is none."""
        panic = self.page.evaluate("() => window._handle.has_panicked() ? window._handle.panic_message() : ''")
        return [panic] * bool(panic) + [text for text in self.said if text.lstrip().startswith("ERROR")]

    def shoot(self) -> bytes:
        """The page as PNG, packed loosely: packing it well takes ten times as long as drawing it."""
        shot = self.devtools.send("Page.captureScreenshot", {"format": "png", "optimizeForSpeed": True})
        return base64.b64decode(shot["data"])

    def settle(self) -> Picture:
        return decode(settled(self.shoot))

    def widgets(self) -> list[Widget]:
        import msgpack

        ask = "async request => (await window._handle.inspect(new Uint8Array(request))).toBase64()"
        answer = base64.b64decode(self.page.evaluate(ask, list(msgpack.packb("GetTree"))))
        nodes = msgpack.unpackb(answer, strict_map_key=False)["Tree"][2][0]
        return [
            Widget(node[0], text, tuple(has["bounds"]), "toggled" in has)
            for _, node in nodes
            for has in node[-1:]
            if "bounds" in has
            for text in [str(has.get("label") or has.get("value") or "")]
        ]

    def pane(self, title: str) -> Box:
        """Where a view stands, without its title; a view that is only coming is waited for."""
        end = time.monotonic() + PATIENCE_MS / 1e3
        while time.monotonic() < end:
            for widget in self.widgets():
                if widget.role == "pane" and widget.text == title:
                    return widget.box
        raise TimeoutError(f"the viewer shows no pane '{title}'")

    def tab_buttons(self) -> list[Widget]:
        """The uppermost row of tabs, from left to right."""
        top = self.pane("Viewport")[1]
        row = [w for w in self.widgets() if w.toggled and top <= w.box[1] and w.box[3] <= top + 30.0]
        return sorted(row, key=lambda w: w.box[0])

    def front(self, tab: int) -> Picture:
        """Click a tab of the uppermost row and wait until the screen has come to rest."""
        self.page.mouse.click(*self.tab_buttons()[tab].middle)
        self.page.mouse.move(*SIZE.values())  # nothing under the pointer lights up
        return self.settle()

    def select(self, x: float, y: float, path: str) -> dict[str, str]:
        """Click on a point until the selection panel names ``path``: what lies under a pointer is known frames later.

        Returns:
            What the panel says then, or at last.
        """
        for _ in range(5):
            self.page.mouse.move(x, y)
            self.page.wait_for_timeout(1000.0)
            self.page.mouse.click(x, y)
            for _ in range(5):
                self.page.wait_for_timeout(500.0)
                said = self.selection()
                if said["path"].endswith(path):
                    return said
        return said

    def selection(self) -> dict[str, str]:
        """What the selection panel says: the value beside each name, and the path of what is selected as `path`."""
        left, top, _, _ = self.pane("Selection panel")
        panel = [w for w in self.widgets() if w.text and w.box[0] > left and w.box[1] > top]
        panel.sort(key=lambda w: (w.box[1], w.box[0]))
        names, values = ([w for w in panel if w.role == role] for role in ("button", "label"))
        said = {n.text: v.text for n in names for v in values if n.box[1] <= v.middle[1] <= n.box[3]}
        head = next((w.box[1] for w in names if w.text == "Instance"), top)
        return said | {"path": "/".join(w.text for w in names if w.box[3] <= head)}


def number(text: str) -> float:
    """A number as the viewer writes it: a true minus sign, thin spaces between groups of digits."""
    return float("".join(text.split()).replace("\u2009", "").replace("−", "-"))


def project(points: NDArray[Any], eye: NDArray[Any], target: NDArray[Any], box: Box) -> NDArray[np.float64]:
    """Where ``points`` ``(N, 3)`` appear in a view at ``box`` whose eye looks at ``target``, up being z: ``(N, 2)``."""
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    up = np.cross(right, forward)
    seen = points - eye
    left, top, end, bottom = box
    scale = (bottom - top) / 2.0 / np.tan(FIELD_OF_VIEW / 2.0) / (seen @ forward)
    return np.stack([(left + end) / 2.0 + scale * (seen @ right), (top + bottom) / 2.0 - scale * (seen @ up)], axis=-1)


def view_of(picture: Picture, box: Box) -> Picture:
    """The part of a screen that a view covers, without the pixels at its rim."""
    left, top, right, bottom = box
    return crop(picture, (left + 2.0, top + 2.0, right - 2.0, bottom - 2.0))
