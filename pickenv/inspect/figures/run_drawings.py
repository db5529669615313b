"""Which figures a run's numbers allow, each with a caption, and which are left out and why."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pickenv.arm.kinematics.geometry import Array
from pickenv.calibration.model.identifiability import RANK_TOLERANCE
from pickenv.harvester.joint_motion import dense_workspace
from pickenv.inspect.figures import plot_calibration, plot_errors, plot_harvest, plot_policies
from pickenv.inspect.figures.field_figure import error_fields
from pickenv.inspect.figures.plot_slices import error_slices
from pickenv.inspect.figures.style import check_format, save_figure
from pickenv.inspect.runs.calibration_trace import CalibrationTrace
from pickenv.inspect.runs.comparison import Comparison
from pickenv.inspect.runs.gripping import gripped, gripper_curves
from pickenv.inspect.runs.harvest_trace import HarvestTrace

if TYPE_CHECKING:
    from matplotlib.figure import Figure

CONDITIONS = {"payload": "kg", "temperature": "K above the reference"}


@dataclass(frozen=True)
class Drawing:
    """A figure that can be drawn.

    Attributes:
        name: File name without suffix.
        caption: What it shows, in a sentence.
        draw: Draws it.
    """

    name: str
    caption: str
    draw: Callable[[], Figure]


@dataclass(frozen=True)
class LeftOut:
    """A figure that the run's numbers do not allow.

    Attributes:
        name: File name that it would have.
        reason: Why, and what would allow it.
    """

    name: str
    reason: str


Drawings = Sequence[Drawing | LeftOut]


def write_drawings(
    drawings: Drawings,
    folder: Path,
    formats: Sequence[str] = ("svg", "png"),
    progress: Callable[[str, int, int], None] | None = None,
) -> list[Path]:
    """Draw all that can be drawn into ``folder``, each in every format.

    Raises:
        InputError: If a format is unknown or the folder cannot be written.
    """
    for suffix in formats:
        check_format(suffix, folder)
    todo = [drawing for drawing in drawings if isinstance(drawing, Drawing)]
    written = []
    for done, drawing in enumerate(todo, start=1):
        figure = drawing.draw()
        written += [save_figure(figure, folder / f"{drawing.name}.{suffix}") for suffix in formats]
        if progress is not None:
            progress("drawing", done, len(todo))
    return written


def norms_mm(errors: Mapping[str, Array]) -> dict[str, Array]:
    """Lengths of position errors ``(M,)``, mm, from pose errors ``(M, 6)`` or positions' ``(M, 3)``, m."""
    return {label: np.asarray(np.linalg.norm(error[:, :3], axis=1) * 1e3) for label, error in errors.items()}


def comparison_drawings(comparison: Comparison) -> Drawings:
    """Figures of policies on one arm: error fields, slices, boxes of the reaches."""
    fields = {policy.label: policy.field_errors for policy in comparison.policies}
    reach_mm = {policy.label: policy.position_error_mm for policy in comparison.policies}
    reach_deg = {policy.label: policy.attitude_error_deg for policy in comparison.policies}
    tolerance = comparison.tolerance_mm
    found: list[Drawing | LeftOut] = []
    if len(comparison.field_points):
        found += [
            Drawing(
                "error_fields",
                "Where in the workspace the tool misses, and which way: one arrow per wanted position, drawn larger "
                "than true and coloured by its true length.",
                lambda: error_fields(comparison),
            ),
            Drawing(
                "error_slices",
                "The same errors within slices of the workspace.",
                lambda: error_slices(comparison.field_points, fields, step=comparison.grid_step),
            ),
        ]
    else:
        found.append(LeftOut("error_fields", "the comparison has no field points; take a finer grid"))
    if not len(comparison.fruit):
        return [*found, LeftOut("reach_errors", "the comparison has no reaches; run some")]
    return [
        *found,
        Drawing(
            "position_error_by_policy",
            "Final position errors of the reaches: quartiles, whiskers, outliers, mean and median.",
            lambda: plot_errors.error_by_method(reach_mm, counted="reaches"),
        ),
        Drawing(
            "attitude_error_by_policy",
            "Final attitude errors of the reaches, likewise.",
            lambda: plot_errors.error_by_method(reach_deg, quantity="attitude error", unit="deg", counted="reaches"),
        ),
        Drawing(
            "reach_errors_cumulative",
            "Share of reaches whose final position error is at most x.",
            lambda: plot_errors.error_cumulative(reach_mm, tolerance=tolerance, counted="reaches"),
        ),
        Drawing(
            "success_against_misalignment",
            "What each gripper forgives, and where the policies' reaches lie on its curve.",
            lambda: _success(comparison),
        ),
    ]


def _success(comparison: Comparison) -> Figure:
    points = {
        label: {name: (float(held.lateral_mm.mean()), float(p.mean())) for name, p in held.success.items()}
        for label, held in gripped(comparison).items()
    }
    return plot_policies.success_against_misalignment(gripper_curves(), points)


def trace_drawings(trace: CalibrationTrace) -> Drawings:
    """Figures of a calibration: held-out errors, what they depend on, convergence, identifiability, coverage."""
    mm = norms_mm(trace.errors)
    attitude = None if trace.attitude_rms is None else np.degrees(trace.attitude_rms)
    threshold = RANK_TOLERANCE * float(trace.r_diagonal.max())
    found: list[Drawing | LeftOut] = [
        Drawing(
            "error_per_test_pose",
            "Position error at each held-out pose, before and after calibration.",
            lambda: plot_errors.error_per_pose(mm),
        ),
        Drawing(
            "error_by_stage",
            "Position errors at the held-out poses by stage: quartiles, whiskers, outliers, mean and median.",
            lambda: plot_errors.error_by_method(mm),
        ),
        Drawing(
            "error_histogram",
            "How the position errors at the held-out poses are distributed.",
            lambda: plot_errors.error_histogram(mm),
        ),
        Drawing(
            "error_cumulative",
            "Share of held-out poses whose position error is at most x.",
            lambda: plot_errors.error_cumulative(mm),
        ),
        Drawing(
            "error_against_extension",
            "Position error against the distance of the tool from the base.",
            lambda: plot_errors.error_against(trace.extension, mm, name="extension", unit="m"),
        ),
    ]
    for name, unit in CONDITIONS.items():
        values = getattr(trace, name)
        if values is None:
            reason = f"no {name} was recorded with the held-out poses; measure it with them"
            found.append(LeftOut(f"error_against_{name}", reason))
        elif not np.ptp(values) > 0.0:
            reason = f"every held-out pose had the same {name}, {values[0]:g} {unit}; vary it"
            found.append(LeftOut(f"error_against_{name}", reason))
        else:
            found.append(_against(name, unit, values, mm))
    found.append(
        Drawing(
            "least_squares_convergence",
            "What the identified arm leaves unexplained after each iteration of the least squares.",
            lambda: plot_calibration.least_squares_convergence(trace.position_rms * 1e3, attitude),
        )
    )
    loss = trace.loss
    found.append(
        LeftOut("network_convergence", "no network was trained")
        if loss is None
        else Drawing(
            "network_convergence",
            "Training loss of the network that learns what the identified arm leaves.",
            lambda: plot_calibration.network_convergence(loss),
        )
    )
    return [
        *found,
        Drawing(
            "parameter_spectrum",
            "What the poses tell about each parameter; those below the threshold cannot be told from others.",
            lambda: plot_calibration.parameter_spectrum(
                trace.r_diagonal, trace.kept, names=trace.names, threshold=threshold
            ),
        ),
        Drawing(
            "singular_values",
            "Singular values of the scaled Jacobian of the identified parameters.",
            lambda: plot_calibration.parameter_spectrum(
                trace.singular_values, np.ones(len(trace.singular_values), dtype=bool)
            ),
        ),
        Drawing(
            "joint_coverage",
            "How the poses fill the joint ranges: each joint's distribution, and each pair of joints.",
            lambda: plot_calibration.joint_coverage(trace.nominal, trace.sets),
        ),
    ]


def _against(name: str, unit: str, values: Array, errors_mm: Mapping[str, Array]) -> Drawing:
    return Drawing(
        f"error_against_{name}",
        f"Position error against {name}.",
        lambda: plot_errors.error_against(values, errors_mm, name=name, unit=unit),
    )


def harvest_drawings(trace: HarvestTrace) -> Drawings:
    """Figures of a harvester: what the arms did on a tree, what came of the fruit, throughput, reach."""
    arms = trace.cloud.shape[1]
    shown = {name: trace.trees[name] for name in (next(iter(trace.trees)), list(trace.trees)[-1])}
    return [
        Drawing("gantt", "What each arm did on one tree.", lambda: plot_harvest.gantt(shown, arms)),
        Drawing(
            "pick_map",
            "The fruit of one tree by the arm that collected it, and the zones from which they were picked.",
            lambda: plot_harvest.pick_map(shown),
        ),
        Drawing(
            "funnel",
            f"From fruit present to fruit collected, over {trace.tree_count} simulated trees.",
            lambda: plot_harvest.funnel_bars(trace.funnels),
        ),
        Drawing(
            "throughput",
            "Picks per hour against the number of arms, the machine perfectly known, with 95 % intervals.",
            lambda: plot_harvest.throughput_by_arms(trace.throughput),
        ),
        Drawing(
            "workspace",
            "Where the cups get to, at joints drawn evenly within the limits.",
            lambda: plot_harvest.workspace_cloud(trace.cloud, (dense_workspace(),)),
        ),
        Drawing(
            "joint_curves",
            "How the joints move from the start to a pick point and on to three fruit.",
            lambda: plot_harvest.joint_curves(trace.curves),
        ),
    ]


def iso9283_drawings(result: Mapping[str, Any]) -> Drawings:
    """Figures of a test by ISO 9283.

    Args:
        result: As `pickenv.arm.plant.iso9283.Iso9283Result.as_dict` gives it.
    """
    controllers = {name: result[name] for name in ("raw", "calibrated") if name in result}
    accuracy, repeatability = (
        {name: [pose[key] for pose in found["poses"]] for name, found in controllers.items()}
        for key in ("accuracy_mm", "repeatability_mm")
    )
    drift = {name: found["drift_accuracy_mm"] for name, found in controllers.items()}
    return [
        Drawing(
            "pose_accuracy",
            "Pose accuracy AP and repeatability RP at the five poses of ISO 9283.",
            lambda: plot_policies.accuracy_by_pose(accuracy, repeatability),
        ),
        Drawing(
            "drift",
            "Pose accuracy at P1 over the hours after the cold arm was switched on.",
            lambda: plot_policies.accuracy_drift(result["raw"]["drift_hours"], drift),
        ),
    ]
