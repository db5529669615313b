"""Rerun's own viewer without a screen: it draws with the graphics adapter that Mesa computes on the processor."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from pickenv.inspect.recordings.viewing import headless_viewer
from tests.browser.layout import Blueprint

Result = TypeVar("Result")


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


def look(recording: Path, at: Callable[[Viewer], Result]) -> Result:
    """Show ``recording`` and return what ``at`` finds.

    Mesa's processor driver is known to crash rerun now and then; a viewer that is gone is started once more.

    Raises:
        RuntimeError: If there is no graphics adapter.
    """
    try:
        return _look(recording, at)
    except (ConnectionError, RuntimeError):
        return _look(recording, at)


def _look(recording: Path, at: Callable[[Viewer], Result]) -> Result:
    with headless_viewer() as client:
        if client is None:
            raise RuntimeError("rerun's viewer did not start; is Mesa's Vulkan driver installed?")
        store = client.open(str(recording.resolve())).store_ids[0]
        while client.get_state().loading:
            time.sleep(0.1)
        client.take_screenshot(max_size=64)  # the first picture compiles the shaders
        return at(Viewer(client, store, client.get_blueprint(store_id=store).blueprint))
