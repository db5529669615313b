"""Lists of a run's figures, each with a caption; a figure that cannot be drawn has the reason in its place."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from pickenv.arm import Array
from pickenv.base import clustered_share_interval
from pickenv.calibration.identification.least_squares import REDUNDANCY_TOLERANCE
from pickenv.inspect.colours import TEXTS
from pickenv.inspect.figures import plot_calibration, plot_errors, plot_policies
from pickenv.inspect.figures.style import check_format, save_figure
from pickenv.inspect.runs.comparison_summary import gripped, gripper_curves
from pickenv.inspect.runs.recorded_episodes import Comparison
from pickenv.inspect.runs.traces import CalibrationTrace, ViewErrors

OF_LENGTHS = ("error_", "least_squares_convergence")
"""Beginnings of the names of figures that show errors in mm."""
ANGLES = "the rows tell angles, not positions; the report has their errors in degrees"
CONDITIONS = {"payload": "kg", "temperature": "K above the reference"}


@dataclass(frozen=True)
class Drawing:
    """A figure of a run, or the reason why it cannot be drawn.

    Attributes:
        name: File name without suffix.
        caption: What the figure shows, in a sentence. If it cannot be drawn: why, and what would allow it.
        draw: Function that draws the figure; None if it cannot be drawn.
        spec: Plotly's data and layout, if the figure is interactive in a browser; ``draw`` then makes its printed form.
        hint: What a reader can do with the interactive figure.
    """

    name: str
    caption: str
    draw: Callable[[], Figure] | None = None
    spec: Mapping[str, Any] | None = None
    hint: str = ""


Drawings = Sequence[Drawing]


def write_drawings(
    drawings: Drawings,
    folder: Path,
    formats: Sequence[str] = ("svg", "png"),
    progress: Callable[[str, int, int], None] | None = None,
) -> list[Path]:
    """Write all figures that can be drawn into ``folder``, each in every format, and return the files' paths.

    Args:
        drawings: The figures.
        folder: The folder.
        formats: Suffixes of the files, such as "svg", without a dot.
        progress: Function that is called with the name of the work, the number of figures done, and the number of all
            figures.

    Raises:
        InputError: If a format is unknown or the folder cannot be written.
    """
    for suffix in formats:
        check_format(suffix, folder)
    todo = {drawing.name: drawing.draw for drawing in drawings if drawing.draw is not None}
    paths = []
    for number, (name, draw) in enumerate(todo.items(), start=1):
        figure = draw()
        paths += [save_figure(figure, folder / f"{name}.{suffix}") for suffix in formats]
        if progress is not None:
            progress("drawing", number, len(todo))
    return paths


def norms_mm(errors: Mapping[str, Array]) -> dict[str, Array]:
    """Return the lengths of position errors ``(M,)``, mm, by label.

    Args:
        errors: Pose errors ``(M, 6)``, m and rad, or position errors ``(M, 3)``, m, by label.
    """
    return {label: np.asarray(np.linalg.norm(error[:, :3], axis=1) * 1e3) for label, error in errors.items()}


def captioned(name: str, draw: Callable[..., Figure], /, *data: Any, **options: Any) -> Drawing:
    """Return a drawing with the caption that `TEXTS` has for ``name``.

    Args:
        name: Name of the figure.
        draw: Function that draws the figure from ``data`` and ``options``.
        data: Positional arguments of ``draw``.
        options: Keyword arguments of ``draw``.
    """
    return Drawing(name, TEXTS["captions"][name], partial(draw, *data, **options))


def comparison_drawings(comparison: Comparison) -> Drawings:
    """Return the figures of policies on one arm: error fields, slices, and distributions of the reaches' errors."""
    fields = {policy.label: policy.field_errors for policy in comparison.policies}
    mm = {policy.label: policy.ends.position_error_mm for policy in comparison.policies}
    degrees = {policy.label: policy.ends.attitude_error_deg for policy in comparison.policies}
    attitude = {"quantity": "attitude error", "unit": "deg", "counted": "reaches"}
    within = {"tolerance": comparison.tolerance_mm, "counted": "reaches"}
    drawings = [
        captioned("error_fields", plot_errors.error_fields, comparison),
        captioned("error_slices", plot_errors.error_slices, comparison.grid.points, fields, step=comparison.grid.step),
    ]
    if not len(comparison.grid.points):
        drawings = [Drawing("error_fields", "the comparison has no field points; take a finer grid")]
    if not len(comparison.fruit):
        return [*drawings, Drawing("reach_errors", "the comparison has no reaches; run some")]
    return [
        *drawings,
        captioned("position_error_by_policy", plot_errors.error_by_method, mm, counted="reaches"),
        captioned("attitude_error_by_policy", plot_errors.error_by_method, degrees, **attitude),
        captioned("reach_errors_cumulative", plot_errors.error_cumulative, mm, **within),
        captioned("success_against_misalignment", _success, comparison),
    ]


def _success(comparison: Comparison) -> Figure:
    points = {}
    for label, (lateral_mm, success) in gripped(comparison).items():
        shares = {name: (float(p.mean()), clustered_share_interval(p, 1)) for name, p in success.items()}
        points[label] = {name: (float(lateral_mm.mean()), share) for name, share in shares.items()}
    return plot_policies.success_against_misalignment(gripper_curves(), points)


def trace_drawings(trace: CalibrationTrace) -> Drawings:
    """Return the figures of a calibration: held-out errors and their causes, convergence, identifiability, coverage."""
    mm, threshold = norms_mm(trace.errors), REDUNDANCY_TOLERANCE * float(trace.r_diagonal.max())
    attitude = None if trace.attitude_rms is None else np.degrees(trace.attitude_rms)
    diagonal: dict[str, Any] = {"names": trace.names, "threshold": threshold}
    every, rms_mm = np.ones(len(trace.singular_values), dtype=bool), trace.position_rms * 1e3
    drawings = [
        captioned("error_per_test_pose", plot_errors.error_per_pose, mm),
        captioned("error_by_stage", plot_errors.error_by_method, mm),
        captioned("error_histogram", plot_errors.error_histogram, mm),
        captioned("error_cumulative", plot_errors.error_cumulative, mm),
        _against("extension", "m", trace.extension, mm),
        *(_against(name, unit, getattr(trace, name), mm) for name, unit in CONDITIONS.items()),
        captioned("least_squares_convergence", plot_calibration.least_squares_convergence, rms_mm, attitude),
        Drawing("network_convergence", "no network was trained")
        if trace.loss is None
        else captioned("network_convergence", plot_calibration.network_convergence, trace.loss),
        captioned("parameter_spectrum", plot_calibration.parameter_spectrum, trace.r_diagonal, trace.kept, **diagonal),
        captioned("singular_values", plot_calibration.parameter_spectrum, trace.singular_values, every),
        captioned("joint_coverage", plot_calibration.joint_coverage, trace.nominal, trace.sets),
        *view_drawings(trace.views),
    ]
    if trace.miss_unit == "mm":
        return drawings
    return [Drawing(d.name, ANGLES) if d.name.startswith(OF_LENGTHS) else d for d in drawings]


def view_drawings(views: Sequence[ViewErrors]) -> list[Drawing]:
    """Return the figures of views (pictures of a board) with their reprojection errors; an empty list without views."""
    figures = {"corner_errors": plot_errors.corner_errors, "view_errors": plot_errors.view_errors}
    return [captioned(name, draw, views) for name, draw in figures.items()] if views else []


def _against(name: str, unit: str, values: Array | None, errors_mm: Mapping[str, Array]) -> Drawing:
    """Return the figure of errors against a condition, or the reason why there is none.

    There is no figure if the condition was not recorded or never changed.

    Args:
        name: Name of the condition.
        unit: Unit of the condition.
        values: The condition at each held-out pose ``(M,)``, in ``unit``; None if it was not recorded.
        errors_mm: Errors of each model ``(M,)``, mm, by label.
    """
    drawing = f"error_against_{name}"
    if values is None:
        return Drawing(drawing, f"no {name} was recorded with the held-out poses; measure it with them")
    if name in CONDITIONS and not np.ptp(values) > 0.0:
        return Drawing(drawing, f"every held-out pose had the same {name}, {values[0]:g} {unit}; vary it")
    return captioned(drawing, plot_errors.error_against, values, errors_mm, name=name, unit=unit)
