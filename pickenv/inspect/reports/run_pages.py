"""Figures and page of a finished run, whatever its kind: its module is named in `run_folder.KINDS`."""

from __future__ import annotations

from importlib import import_module
from typing import Protocol, cast

from pickenv.inspect.figures.run_drawings import Drawings
from pickenv.inspect.runs.run_folder import KINDS, Run, TakePicture


class Pages(Protocol):
    """What a kind of run offers to look at."""

    def drawings(self, run: Run) -> Drawings:
        """Every figure, drawable or left out."""

    def page(self, run: Run, picture: TakePicture | None) -> str:
        """The report as HTML, with a picture of the recording where it has one."""


def drawings_of(run: Run) -> Drawings:
    """Every figure of a run, drawable or left out."""
    return _pages(run).drawings(run)


def page_of(run: Run, picture: TakePicture | None = None) -> str:
    """A run's report as HTML.

    Args:
        run: The run.
        picture: Takes a picture of its recording, such as `viewer_picture`; none is shown when left out.
    """
    return _pages(run).page(run, picture)


def _pages(run: Run) -> Pages:
    """The module that draws and writes about this kind of run."""
    return cast("Pages", import_module(KINDS[run.kind].pages))
