"""Figures and page of a finished run, whatever its kind: its module is named by the registered kind."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from pickenv.inspect.figures.run_drawings import Drawings
from pickenv.inspect.runs.run_folder import Run, TakePicture, run_kind


def drawings_of(run: Run) -> Drawings:
    """Every figure of a run, drawable or left out."""
    found: Drawings = _pages(run).drawings(run)
    return found


def page_of(run: Run, picture: TakePicture | None = None) -> str:
    """A run's report as HTML.

    Args:
        run: The run.
        picture: Takes a picture of its recording, such as `viewer_picture`; none is shown when left out.
    """
    html: str = _pages(run).page(run, picture)
    return html


def _pages(run: Run) -> Any:
    """The module that draws and writes about this kind of run."""
    return import_module(run_kind(run.kind).pages)
