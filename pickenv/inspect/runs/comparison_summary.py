"""The numbers beside the pictures: error statistics per policy, the colour scale, shared histogram bins, the table.

Millimetres and degrees, because these numbers are for people.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pickenv.arm import Array, Geometry, Plant
from pickenv.calibration import Calibration
from pickenv.inspect.colours import policy_key
from pickenv.inspect.runs.field_grid import FieldGrid

# What inspection looks at: errors of several policies on one arm, over a field of poses and over seeded reaches.


@dataclass(frozen=True, eq=False)
class PolicyErrors:
    """One policy's errors.

    Attributes:
        key: Short name as in entity paths and JSON: raw, ls, ls_bpnn.
        label: Name for people: raw, LS, LS + BPNN.
        field_errors: True minus wanted tool position at the field's points ``(F, 3)``, m, world axes.
        reach_joints: Final joint commands given to the drives ``(R, n)``, rad or m.
        reach_positions: Final true tool positions ``(R, 3)``, m.
        position_error_mm: Final distance between true tool and fruit ``(R,)``.
        attitude_error_deg: Final attitude error ``(R,)``.
        success: Whether the fruit was inside the gripper's capture region ``(R,)``.
        field_attitude: True against wanted attitude at the field's points ``(F, 3)``, rotation vectors in world axes,
            rad; None where only positions are known.
    """

    key: str
    label: str
    field_errors: Array
    reach_joints: Array
    reach_positions: Array
    position_error_mm: Array
    attitude_error_deg: Array
    success: NDArray[np.bool_]
    field_attitude: Array | None = None


@dataclass(frozen=True, eq=False)
class Comparison:
    """Several policies on the same arm, the same field and the same fruit.

    Attributes:
        plant: The true arm that was simulated.
        nominal: Geometry the controller believes in.
        identified: Geometry found by the calibration.
        seed: Seed of the run.
        tolerance_mm: Radius of the gripper's capture region.
        grid_shape: Shape (nx, ny, nz) of the regular grid that the field's points were taken from.
        grid_origin: Centre of the grid's first cell, m, ``(3,)``.
        grid_step: Cell size, m.
        field_index: Integer grid index of each field point ``(F, 3)``; unreachable cells are left out.
        field_points: Wanted tool positions ``(F, 3)``, m.
        field_joints: Joints that bring the nominal arm there ``(F, n)``, rad or m.
        fruit: Fruit positions of the reaches ``(R, 3)``, m.
        policies: One entry per policy, raw first.
        field_uncertainty: Standard uncertainty of the calibrated tool position that the calibration itself predicts
            ``(F,)``, m; None where the calibration carries none.
    """

    plant: Plant
    nominal: Geometry
    identified: Geometry
    seed: int
    tolerance_mm: float
    grid_shape: tuple[int, int, int]
    grid_origin: Array
    grid_step: float
    field_index: NDArray[np.int64]
    field_points: Array
    field_joints: Array
    fruit: Array
    policies: tuple[PolicyErrors, ...]
    field_uncertainty: Array | None = None


def policy_errors(
    label: str,
    field: Array,
    joints: Array,
    positions: Array,
    errors: Array,
    success: NDArray[np.bool_],
    key: str | None = None,
) -> PolicyErrors:
    """A policy's errors, from pose errors.

    Args:
        label: Its name for people.
        field: True against wanted pose at the field's points ``(F, 6)``, or positions alone ``(F, 3)``, m and rad.
        joints: Final joint commands of the reaches ``(R, n)``, rad or m.
        positions: Final true tool positions ``(R, 3)``, m.
        errors: Final pose errors ``(R, 6)``, m and rad.
        success: Whether the fruit was inside the capture region ``(R,)``.
        key: Its short name; made from the label when left out.
    """
    return PolicyErrors(
        key=key or policy_key(label),
        label=label,
        field_errors=field[:, :3],
        reach_joints=joints,
        reach_positions=positions,
        position_error_mm=1e3 * np.linalg.norm(errors[:, :3], axis=1),
        attitude_error_deg=np.degrees(np.linalg.norm(errors[:, 3:], axis=1)),
        success=success,
        field_attitude=field[:, 3:] if field.shape[1] == 6 else None,
    )


def stage_label(calibration: Calibration) -> str:
    """What a calibration is called among policies: LS, or LS+BPNN after what it learnt of the rest."""
    return "LS" if calibration.learnt is None else f"LS+{calibration.learnt.kind.replace('_', ' ').upper()}"


def compared(
    plant: Plant,
    grid: FieldGrid,
    policies: Iterable[PolicyErrors],
    *,
    seed: int,
    fruit: Array | None = None,
    tolerance_mm: float = 0.0,
    identified: Geometry | None = None,
    uncertainty: Array | None = None,
) -> Comparison:
    """A comparison over a grid; without fruit there are no reaches, and the nominal arm counts as identified."""
    return Comparison(
        plant=plant,
        nominal=plant.arm.nominal,
        identified=plant.arm.nominal if identified is None else identified,
        seed=seed,
        tolerance_mm=tolerance_mm,
        grid_shape=grid.shape,
        grid_origin=grid.origin,
        grid_step=grid.step,
        field_index=grid.index,
        field_points=grid.points,
        field_joints=grid.joints,
        fruit=np.empty((0, 3)) if fruit is None else fruit,
        policies=tuple(policies),
        field_uncertainty=uncertainty,
    )


GAIN = 20.0
"""How much longer than true size recordings draw errors, and figures where their arrows then fit."""
SCALE_PERCENTILE = 99.0
"""The colour scale ends at this percentile of the first (raw) policy's field, so that outliers do not flatten it."""


@dataclass(frozen=True)
class Spread:
    """Mean, root mean square, 95th percentile and maximum of some errors, in the errors' unit."""

    mean: float
    rms: float
    p95: float
    largest: float


def error_spread(values: ArrayLike) -> Spread:
    """The `Spread` of ``values`` ``(...)``; all of it is nan when there are none."""
    values = np.asarray(values, dtype=float).ravel()
    if not values.size:
        return Spread(math.nan, math.nan, math.nan, math.nan)
    return Spread(
        mean=float(values.mean()),
        rms=float(np.sqrt(np.mean(values**2))),
        p95=float(np.percentile(values, 95)),
        largest=float(values.max()),
    )


def field_mm(policy: PolicyErrors) -> Array:
    """Magnitude of a policy's field errors ``(F,)``, mm."""
    return np.asarray(np.linalg.norm(policy.field_errors, axis=-1) * 1e3)


def cell_means(index: NDArray[np.int64], values: Array) -> tuple[NDArray[np.int64], Array]:
    """Cells of a grid that hold points, ``(C, 3)`` in order, and the mean of their points' values ``(C,)``.

    Args:
        index: Cell of each point ``(F, 3)``.
        values: Value at each point ``(F,)``.
    """
    cells, cell = np.unique(index, axis=0, return_inverse=True)
    cell = cell.reshape(-1)
    return cells, np.bincount(cell, values, len(cells)) / np.bincount(cell, minlength=len(cells))


def colour_scale_mm(comparison: Comparison) -> float:
    """Upper end of the one colour scale that all fields share, mm."""
    return scale_end(field_mm(comparison.policies[0]))


def uncertainty_scale_mm(comparison: Comparison) -> float:
    """Upper end of the colour scale that predicted uncertainty and the last policy's field share, mm."""
    assert comparison.field_uncertainty is not None
    shown = np.concatenate([1e3 * comparison.field_uncertainty, field_mm(comparison.policies[-1])])
    return scale_end(shown)


def attitude_scale_deg(fields: Mapping[str, Array]) -> float:
    """Upper end of the colour scale that attitude errors ``(F, 3)`` in rad share, deg: that of the first of them."""
    return scale_end(np.degrees(np.linalg.norm(next(iter(fields.values())), axis=-1)))


def scale_end(values: Array) -> float:
    """Upper end of a colour scale for lengths ``(F,)``, in their unit."""
    top = float(np.percentile(values, SCALE_PERCENTILE)) if values.size else 0.0
    return top if top > 0.0 else 1.0


def histogram_edges_mm(comparison: Comparison, bins: int = 24) -> Array:
    """Edges ``(B + 1,)`` in mm of about ``bins`` bins of round width, which hold every policy's reach errors."""
    largest = max(
        (float(p.position_error_mm.max()) for p in comparison.policies if p.position_error_mm.size), default=0.0
    )
    width = round_step((largest or 1.0) / bins)
    return np.asarray(width * np.arange(int(largest / width) + 2))


def round_step(at_least: float) -> float:
    """The smallest of 1, 2, 2.5 and 5 times a power of ten that is not below ``at_least``."""
    power = 10.0 ** math.floor(math.log10(at_least))
    return next(float(m * power) for m in (1.0, 2.0, 2.5, 5.0, 10.0) if m * power >= at_least * (1.0 - 1e-9))


def ticks(top: float, count: int = 8) -> list[float]:
    """Round tick values from 0 up to ``top``, about ``count`` of them."""
    step = round_step(top / count)
    return [i * step for i in range(int(top / step + 1e-9) + 1)]


def summary_markdown(comparison: Comparison, gain: float) -> str:
    """The summary as a Markdown table, with a short legend: what is drawn, and how large."""
    top, has_reaches = colour_scale_mm(comparison), len(comparison.fruit) > 0
    heads = ["field mean", "field RMS", "field p95", "field max"]
    if has_reaches:
        heads = ["picked", "reach mean", "RMS", "p95", "max", "attitude mean", "field mean", "field RMS"]
    lines = [
        f"## {comparison.plant.name}, seed {comparison.seed}",
        "",
        f"| policy | {' | '.join(heads)} |",
        f"|:--|{'--:|' * len(heads)}",
    ]
    for policy in comparison.policies:
        cells = (_reach_cells if has_reaches else _field_cells)(policy)
        lines.append(f"| **{policy.label}** | {' | '.join(cells)} |")
    first = comparison.policies[0].label
    reaches = (
        f"{len(comparison.fruit)} reaches, of this one calibration; a pick if the fruit is inside the capture region, "
        f"radius {comparison.tolerance_mm:g} mm. "
    )
    lines += [
        "",
        f"{reaches if has_reaches else ''}{len(comparison.field_points)} field points, cells of "
        f"{comparison.grid_step * 1e3:g} mm.{_better(comparison)}",
        "",
        f"**Arrows**: true minus wanted tool position, drawn ×{gain:g}. **Colour**: its length, 0 to {top:.2f} mm in "
        f"every field (p{SCALE_PERCENTILE:g} of {first}; above that the colour saturates).",
    ]
    if has_reaches:
        lines += [
            "",
            f"**Picking**: wire arm = what the controller believes; solid arm = the true arm with the {first} "
            f"command, difference drawn ×{gain:g}; red ball = capture region ×{gain:g}: an arrow that ends inside it "
            "is a pick.",
        ]
    return "\n".join(lines)


def _better(comparison: Comparison) -> str:
    """At how many field points the last policy errs less than the one before it; nothing for one policy."""
    if len(comparison.policies) < 2:
        return ""
    before, last = comparison.policies[-2:]
    share = 100.0 * float(np.mean(field_mm(last) < field_mm(before)))
    return f" {last.label} errs less than {before.label} at {share:.0f} % of them."


def _reach_cells(policy: PolicyErrors) -> list[str]:
    reach, field, attitude = (
        error_spread(v) for v in (policy.position_error_mm, field_mm(policy), policy.attitude_error_deg)
    )
    return [
        f"{100.0 * float(np.mean(policy.success)):.0f} %",
        f"{reach.mean:.2f} mm",
        *(f"{value:.2f}" for value in (reach.rms, reach.p95, reach.largest)),
        f"{attitude.mean:.3f}°",
        f"{field.mean:.2f} mm",
        f"{field.rms:.2f}",
    ]


def _field_cells(policy: PolicyErrors) -> list[str]:
    field = error_spread(field_mm(policy))
    return [f"{field.mean:.2f} mm", *(f"{value:.2f}" for value in (field.rms, field.p95, field.largest))]
