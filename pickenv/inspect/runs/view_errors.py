"""Reprojection errors of views of a board, as figures need them. Pixels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pickenv.arm import Array
from pickenv.calibration import Result
from pickenv.calibration.model.pixels import PixelObservations


@dataclass(frozen=True, eq=False)
class ViewErrors:
    """One view's corners.

    Attributes:
        name: Of the view.
        found: Where corners were found ``(C, 2)``, px.
        errors: Found minus predicted ``(C, 2)``, px.
        size: Width and height of the picture, px.
        picture: Its file; None where there is none.
    """

    name: str
    found: Array
    errors: Array
    size: tuple[int, int]
    picture: str | None = None

    @property
    def rms(self) -> float:
        """RMS length of the errors, px."""
        return float(np.sqrt(np.mean(np.sum(self.errors**2, axis=1))))


def views_of(result: Result) -> tuple[ViewErrors, ...]:
    """The views held out with the errors of their corners; none where no pictures were taken."""
    views = result.test
    if not isinstance(views, PixelObservations) or result.pixels is None:
        return ()
    paths = [None] * len(views.joints) if views.pictures is None else [str(path) for path in views.pictures]
    parts = zip(result.pixels.names, views.corners, views.seen, result.held_out.pixels, paths, strict=True)
    return tuple(ViewErrors(name, at[seen], left, views.camera.size, path) for name, at, seen, left, path in parts)
