"""How well pictures are explained, in pixels: of all views together, and of each view by a fit without it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from pickenv.calibration.assessment.metrics import ErrorStatistics, error_statistics
from pickenv.calibration.assessment.screen import Block, figure
from pickenv.calibration.identification.least_squares import identify_converged
from pickenv.calibration.identification.rows import unknowns_of
from pickenv.calibration.identification.starts import fitted_model
from pickenv.calibration.model.lens import LENS_NAMES, Lens
from pickenv.calibration.model.observations import Observations, origins_of
from pickenv.calibration.model.pixels import PixelObservations
from pickenv.calibration.pipeline.fitting import Fit
from pickenv.errors import InputError
from pickenv.intervals import Ends, mean_interval


@dataclass(frozen=True, eq=False)
class PixelFigures:
    """Reprojection errors.

    Attributes:
        views: Pictures.
        corners: Corners in all of them.
        rms_px: RMS of the distance between corner and prediction, of the fit to all views.
        leave_one_out_px: The same in each view, by a fit to the others.
        view_rms_px: Of each view, by a fit to the others ``(V,)``.
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


def pixel_figures(fit: Fit, data: PixelObservations) -> PixelFigures:
    """Judge a fit of views, and fits without one view each, started from it.

    Args:
        fit: The fit of all these views, of geometry alone.
        data: The views.
    """
    found = fit.identification
    model = fitted_model(fit.calibration.arm_name, fit.calibration.nominal, fit.aligned is None)
    whole = data.pixel_errors(found.arm_model, unknowns_of(found, data))
    every = np.arange(len(data.joints))
    pixels, metres = [], []
    for view in every:
        rest, alone = data.select(np.delete(every, view)), data.select(every[[view]])
        without = identify_converged(model, found.arm_model, [rest])
        values = unknowns_of(without, alone)
        pixels.append(alone.pixel_errors(without.arm_model, values))
        metres.append(alone.misses(without.arm_model, values))
    blocks = np.repeat(every, [len(part) for part in metres])
    return PixelFigures(
        views=len(every),
        corners=int(data.seen.sum()),
        rms_px=_rms(whole),
        leave_one_out_px=_rms(np.concatenate(pixels)),
        view_rms_px=tuple(_rms(part) for part in pixels),
        board_mm=error_statistics(1e3 * np.concatenate(metres), blocks),
        lens=dict(zip(LENS_NAMES, data.lens_values(unknowns_of(found, data)).tolist(), strict=True)),
        names=tuple(f"{file}: row {line}" for file, line in (origins_of(data).place(int(view)) for view in every)),
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
