"""Rerun's own viewer without a screen: it draws with the graphics adapter that Mesa computes on the processor."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from tests.browser.layout import Blueprint
from tests.browser.processes import LOCALHOST, free_port, rerun

WINDOW = "1600x900"
Result = TypeVar("Result")
PATIENCE = 60.0
"""s; for a viewer to start and to load, far more than either takes on an idle machine."""


@dataclass(frozen=True)
class Viewer:
    """A viewer that shows one recording."""

    client: Any
    store: str
    blueprint: Blueprint

    def show(self, blueprint: Blueprint) -> None:
        self.client.set_blueprint(blueprint, store_id=self.store)

    def reports(self) -> list[str]:
        """What any view complains of, and what the viewer logged as an error."""
        views = self.client.get_state().views
        said = [f"{view.name}: {report}" for view in views for report in view.reports if report.severity == "error"]
        return said + [entry.message for entry in self.client.get_logs() if entry.level == "ERROR"]


def look(recording: Path, log: Path, at: Callable[[Viewer], Result]) -> Result:
    """Show ``recording``, its output going to ``log``, and return what ``at`` finds.

    Mesa's processor driver is known to crash rerun now and then; a viewer that died is started once more.

    Raises:
        RuntimeError: If the viewer does not answer; what it said is quoted.
    """
    for again in (True, False):
        port = free_port()
        options = ("--headless", "--hide-welcome-screen", "--window-size", WINDOW, "--port", str(port))
        with rerun(*options, log=log) as process:
            try:
                return at(_opened(recording, port, log))
            except Exception:
                if process.poll() is None or not again:
                    raise
    raise AssertionError("the second attempt returns or raises")


def _opened(recording: Path, port: int, log: Path) -> Viewer:
    client = _connected(port, log)
    store = client.open(str(recording.resolve())).store_ids[0]
    while client.get_state().loading:
        time.sleep(0.1)
    client.take_screenshot(max_size=64)  # the first picture compiles the shaders
    return Viewer(client, store, client.get_blueprint(store_id=store).blueprint)


def _connected(port: int, log: Path) -> Any:
    from rerun.experimental import ViewerClient

    end = time.monotonic() + PATIENCE
    while True:
        try:
            client = ViewerClient.connect(f"rerun+http://{LOCALHOST}:{port}/proxy")
            client.get_state()
            return client
        except (ConnectionError, RuntimeError) as error:
            if time.monotonic() > end:
                raise RuntimeError(f"the viewer did not answer; it said:\n{log.read_text()[-2000:]}") from error
            time.sleep(0.1)
