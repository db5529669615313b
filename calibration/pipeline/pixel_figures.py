"""How well pictures are explained, in pixels: of all views together, and of each view by a fit without it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from pickenv.calibration.assessment.metrics import ErrorStatistics, error_statistics
from pickenv.calibration.assessment.screen import Block, figure
from pickenv.calibration.identification.rows import unknowns_of
from pickenv.calibration.model.lens import LENS_NAMES, Lens
from pickenv.calibration.model.observations import Observations, origins_of
from pickenv.calibration.model.pixels import PixelObservations
from pickenv.calibration.pipeline.fitting import Fit
from pickenv.calibration.pipeline.held_out import GEOMETRIC, HeldOut
from pickenv.errors import InputError
from pickenv.intervals import Ends, mean_interval


@dataclass(frozen=True, eq=False)
class PixelFigures:
    """Reprojection errors.

    Attributes:
        views: Pictures.
        corners: Corners in all of them.
        rms_px: RMS of the distance between corner and prediction, of the fit to all views.
        leave_one_out_px: The same in views that the fit never saw: each by itself, or its block where they are many.
        view_rms_px: Of each of them ``(V,)``.
        board_mm: The same errors at the board.
        lens: The lens, by the names of its numbers.
        names: Of the views.
    """

    views: int
    corners: int
    rms_px: float
    leave_one_out_px: float
    view_rms_px: tuple[float, ...]
    board_mm: ErrorStatistics
    lens: dict[str, float]
    names: tuple[str, ...]

    @property
    def interval(self) -> Ends | None:
        """95 % interval of the mean over views of a view's RMS, px."""
        return mean_interval(self.view_rms_px)

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "views": self.views,
            "corners": self.corners,
            "rms_px": self.rms_px,
            "leave_one_out_px": self.leave_one_out_px,
            "leave_one_out_view_rms_px": list(self.view_rms_px),
            "leave_one_out_mean_ci95_px": self.interval,
            "leave_one_out_mm": self.board_mm.as_dict(),
            "lens": self.lens,
        }

    def block(self) -> Block:
        """For screens."""
        worst = int(np.argmax(self.view_rms_px))
        between = "no interval: too few views"
        if self.interval is not None:
            between = f"95 % between views {figure(self.interval[0])} to {figure(self.interval[1])}"
        rows = [
            ("views, corners", f"{self.views}, {self.corners}"),
            ("RMS of the fit to all views", f"{figure(self.rms_px)} px"),
            ("RMS in each view, fitted without it", f"{figure(self.leave_one_out_px)} px ({between})"),
            ("the same at the board", f"{figure(self.board_mm.rms)} mm"),
            ("worst view", f"{self.names[worst]}: {figure(self.view_rms_px[worst])} px"),
        ]
        return Block("Pictures", (), tuple(rows), "distance of the corners from where they are predicted")


def pixel_figures(fit: Fit, data: PixelObservations, test: PixelObservations, held_out: HeldOut) -> PixelFigures:
    """Judge a fit of views, and what fits left of views that they never saw.

    Args:
        fit: The fit of all these views, of geometry alone.
        data: The views.
        test: The views held out, in the order of their errors.
        held_out: Those errors.
    """
    found = fit.identification
    metres, views = (
        held_out.errors[GEOMETRIC],
        np.repeat(np.arange(len(test.joints)), [len(e) for e in held_out.pixels]),
    )
    return PixelFigures(
        views=len(data.joints),
        corners=int(data.seen.sum()),
        rms_px=_rms(data.pixel_errors(found.arm_model, unknowns_of(found, data))),
        leave_one_out_px=_rms(np.concatenate(held_out.pixels)),
        view_rms_px=tuple(_rms(view) for view in held_out.pixels),
        board_mm=error_statistics(1e3 * metres, views),
        lens=dict(zip(LENS_NAMES, data.lens_values(unknowns_of(found, data)).tolist(), strict=True)),
        names=view_names(test),
    )


def view_names(views: PixelObservations) -> tuple[str, ...]:
    """The views' names: their pictures', or where their corners stand in a file."""
    if views.pictures is not None:
        return tuple(Path(path).name for path in views.pictures)
    return tuple(
        f"{Path(file).name}: row {line}" for file, line in map(origins_of(views).place, range(len(views.joints)))
    )


def _rms(errors: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.sum(errors**2, axis=1))))


def lens_of(fit: Fit, data: Observations) -> Lens:
    """The lens that a fit of pictures ended at.

    Raises:
        InputError: If there are no pictures.
    """
    if not isinstance(data, PixelObservations):
        raise InputError(f"{data.source} holds {data.kind}, no pictures, so there is no lens to write")
    return replace(data.camera, values=data.lens_values(unknowns_of(fit.identification, data)))
