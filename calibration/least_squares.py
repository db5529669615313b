"""Rank-aware iterated least squares, Qiao 2026 eqs (11)-(12): identify a geometry from measurements.

The redundant parameters are found once, at the start, and stay out; eq (11)'s normal equations are replaced by a QR
solution, so that a redundant model gives the same geometry as its base set instead of metres (digest, fact 3).
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.error_model import ErrorModel, residual, stacked_jacobian, weighted_residual
from calibration.identifiability import Identifiability, identifiability
from calibration.measurements import Measurements, random_joints
from pickenv.arm import Geometry, Pose, forward, rotation_vector
from pickenv.arm.geometry import Array
from pickenv.errors import InputError

MISFIT = 0.2
"""Errors above this share of the positions' spread, or this many rad, are no arm's: the data mean something else."""


@dataclass(frozen=True, eq=False)
class Identification:
    """A geometry identified from measurements, with its evidence.

    Attributes:
        geometry: The identified geometry.
        identifiability: What could be identified, what was dropped, and what absorbed it.
        delta: Identified minus starting parameters, m or rad, per model parameter (0 for dropped ones).
        standard_deviation: Of the kept parameters, from the residual's own scatter, m or rad; NaN for dropped ones.
        converged: Whether the last step was negligible.
        residual_rms: Weighted residual RMS before each iteration and after the last.
        iterates: Geometry before each iteration and after the last.
        solve_seconds: Time of the solution alone.
        poses: Number of poses used.
        kind: What was measured: "pose" or "position".
    """

    geometry: Geometry
    identifiability: Identifiability
    delta: Array
    standard_deviation: Array
    converged: bool
    residual_rms: tuple[float, ...]
    iterates: tuple[Geometry, ...]
    solve_seconds: float
    poses: int
    kind: str

    def report(self) -> str:
        """A short report for people: rank, condition, what was dropped, and the parameters in mm and degrees."""
        found = self.identifiability
        state = "converged" if self.converged else "NOT CONVERGED"
        lines = [
            f"{state} after {len(self.residual_rms) - 1} iterations on {self.poses} poses ({self.kind})",
            f"identifiable: {found.rank} of {len(found.names)} parameters, condition {found.condition:.1f}",
        ]
        for dropped in found.dropped:
            lines.append(f"  dropped {dropped.name}: {describe_absorption(dropped.absorbed_by)}")
        lines.append(f"{'parameter':>10}  {'change':>12}  {'± 1 sigma':>12}")
        for k in found.kept:
            name = found.names[k]
            angle = is_angle(name)
            scale, unit = (np.degrees(1.0), "deg") if angle else (1e3, "mm")
            lines.append(
                f"{name:>10}  {self.delta[k] * scale:>12.5f}  {self.standard_deviation[k] * scale:>12.5f} {unit}"
            )
        return "\n".join(lines)


def is_angle(name: str) -> bool:
    """Whether a parameter's name is that of an angle."""
    return name.startswith(("alpha", "theta", "beta")) or name.partition("_")[2].startswith("r")


def describe_absorption(absorbed_by: dict[str, float]) -> str:
    """Say in words what absorbs a dropped parameter."""
    if not absorbed_by:
        return "has no effect on these measurements"
    parts = sorted(absorbed_by.items(), key=lambda item: -abs(item[1]))
    shown = " ".join(f"{value:+.4g} {name}" for name, value in parts[:4])
    return f"absorbed by {shown}" + (f" and {len(parts) - 4} more" if len(parts) > 4 else "")


def identify(
    model: ErrorModel, start: Geometry, measurements: Measurements, *, max_iterations: int = 20
) -> Identification:
    """Identify the model's parameters by rank-aware, weighted Gauss-Newton.

    Args:
        model: The parameters.
        start: Geometry to start from; it must lie near the measurements (see `align`).
        measurements: The data.
        max_iterations: Steps at most; three or four are usual.

    Returns:
        The identification; ``converged`` is False if the last step was not negligible.

    Raises:
        InputError: If there are too few poses for the model's rank.
    """
    begin = time.perf_counter()
    matrix = stacked_jacobian(model, start, measurements)
    found = identifiability(matrix, model.names, model.tolerance, len(measurements))
    _enough_poses(model, start, measurements, found)
    geometry = start
    kept, scale = found.kept, model.tolerance[found.kept]
    history = [_rms(weighted_residual(geometry, measurements))]
    iterates = [start]
    converged, damping = False, 0.0
    for _ in range(max_iterations):
        weighted = weighted_residual(geometry, measurements)
        step = _solve(matrix[:, kept], weighted, damping)
        candidate = _moved(geometry, model, kept, step * scale)
        rms = _rms(weighted_residual(candidate, measurements))
        negligible = damping == 0.0 and np.max(np.abs(step), initial=0.0) < 1e-5
        if rms > history[-1] * (1 + 1e-9):
            if negligible:  # worse by rounding alone: this is the minimum
                converged = True
                break
            # Levenberg: a step that makes it worse is shortened until it helps.
            damping = max(damping * 10.0, 1e-3)
            if damping > 1e9:
                break
            continue
        geometry = candidate
        history.append(rms)
        iterates.append(geometry)
        matrix = stacked_jacobian(model, geometry, measurements)
        if negligible or (damping == 0.0 and history[-2] - rms < 1e-7 * rms):  # a shortened step proves nothing
            converged = True
            break
        damping = damping / 10.0 if damping > 1e-6 else 0.0
    return Identification(
        geometry=geometry,
        identifiability=found,
        delta=start.difference(geometry)[model.columns],
        standard_deviation=_standard_deviation(matrix, geometry, measurements, found, model.tolerance),
        converged=converged,
        residual_rms=tuple(history),
        iterates=tuple(iterates),
        solve_seconds=time.perf_counter() - begin,
        poses=len(measurements),
        kind=measurements.kind,
    )


def _solve(matrix: Array, right: Array, damping: float) -> Array:
    """Least-squares step through QR; ``damping`` adds Levenberg's ridge relative to the mean column norm."""
    if damping:
        ridge = np.sqrt(damping) * np.linalg.norm(matrix) / np.sqrt(matrix.shape[1])
        matrix = np.vstack([matrix, ridge * np.eye(matrix.shape[1])])
        right = np.concatenate([right, np.zeros(matrix.shape[1])])
    q, r = np.linalg.qr(matrix)
    return np.asarray(np.linalg.solve(r, q.T @ right))


def _moved(geometry: Geometry, model: ErrorModel, kept: NDArray[np.int64], step: Array) -> Geometry:
    delta = np.zeros(len(geometry.parameter_names))
    delta[model.columns[kept]] = step
    return geometry.displaced(delta)


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _standard_deviation(
    matrix: Array, geometry: Geometry, measurements: Measurements, found: Identifiability, tolerance: Array
) -> Array:
    """Standard deviation of each kept parameter, with the residual's own scatter as the noise (GUM type A)."""
    std = np.full(len(found.names), np.nan)
    rows = matrix.shape[0]
    if rows > found.rank:
        scatter = np.sum(weighted_residual(geometry, measurements) ** 2) / (rows - found.rank)
        inverse_r = np.linalg.inv(np.linalg.qr(matrix[:, found.kept], mode="r"))
        std[found.kept] = np.sqrt(scatter * np.sum(inverse_r**2, axis=1)) * tolerance[found.kept]
    return std


def _enough_poses(model: ErrorModel, start: Geometry, measurements: Measurements, found: Identifiability) -> None:
    """Refuse data sets with fewer observations than identifiable parameters."""
    rng = np.random.default_rng(0)
    probe = Measurements(
        joints=random_joints(start, 200, rng),
        position=np.zeros((200, 3)),
        rotation=None if measurements.rotation is None else np.broadcast_to(np.eye(3), (200, 3, 3)),
        prismatic=measurements.prismatic,
        position_std=measurements.position_std,
        attitude_std=measurements.attitude_std,
    )
    full = identifiability(stacked_jacobian(model, start, probe), model.names, model.tolerance, 200).rank
    rows = len(measurements) * measurements.rows_per_pose
    if rows <= full or (found.rank < full and rows < 2 * full):
        needed = -(-2 * full // measurements.rows_per_pose)
        raise InputError(
            f"{measurements.source}: {len(measurements)} poses give {rows} equations, too few for the {full} "
            f"parameters that {measurements.kind} measurements identify; measure at least {needed} poses"
        )


def align(geometry: Geometry, measurements: Measurements, frames: ErrorModel) -> Identification:
    """Fit base and tool pose, from anywhere: a closed-form start (Kabsch), then least squares.

    Raises:
        InputError: If the data do not fit the arm at all, which means wrong units, joint signs or conventions.
    """
    _refuse_other_units(geometry, measurements)
    start = geometry.displaced(_registration(geometry, measurements))
    fitted = identify(frames, start, measurements, max_iterations=100)
    refuse_another_arm(fitted.geometry, measurements, "after fitting base and tool")
    return fitted


def refuse_another_arm(geometry: Geometry, measurements: Measurements, state: str) -> None:
    """Refuse measurements that lie so far from ``geometry`` that units, joint signs or conventions must be wrong.

    Args:
        geometry: The arm, with base and tool as they are known or fitted.
        measurements: The data.
        state: What was done about base and tool, as the message says it.

    Raises:
        InputError: If positions miss by more than `MISFIT` of their spread, or attitudes by more than `MISFIT` rad.
    """
    if len(measurements) < 3:
        return  # no spread to speak of; `identify` says how many poses are needed
    _refuse_other_units(geometry, measurements)
    left = residual(geometry, measurements)
    spread = np.linalg.norm(measurements.position.std(axis=0))
    rms = np.sqrt(np.mean(np.sum(left[:, :3] ** 2, axis=1)))
    if rms > MISFIT * spread:
        raise InputError(
            f"{measurements.source}: {state} the arm still misses by {rms * 1e3:.0f} mm RMS, of a spread of "
            f"{spread * 1e3:.0f} mm; check the arm, the units, the joint order and signs, and the attitude convention"
        )
    turn = np.sqrt(np.mean(np.sum(left[:, 3:] ** 2, axis=1)))
    if turn > MISFIT:
        raise InputError(
            f"{measurements.source}: {state} attitudes still miss by {np.degrees(turn):.0f} deg RMS; "
            "check the attitude convention and its unit, and the joint signs"
        )


def _refuse_other_units(geometry: Geometry, measurements: Measurements) -> None:
    """Refuse lengths or angles in another unit: nominal and measured positions must spread alike."""
    if len(measurements) < 3:
        return  # no spread to speak of; `identify` says how many poses are needed
    nominal = forward(geometry, measurements.joints).position
    measured = measurements.position
    ratio = np.linalg.norm(measured.std(axis=0)) / max(float(np.linalg.norm(nominal.std(axis=0))), 1e-12)
    if not 0.05 < ratio < 20:
        raise InputError(
            f"{measurements.source}: measured positions spread {ratio:.3g} times as far as the arm's own; positions "
            "are probably in another length unit, or joints in another angle unit; correct the units"
        )


def _registration(geometry: Geometry, measurements: Measurements) -> Array:
    """Move the base so that nominal positions lie on measured ones (Kabsch 1976); the change of all parameters."""
    nominal, measured = forward(geometry, measurements.joints).position, measurements.position
    u, _, vt = np.linalg.svd((nominal - nominal.mean(0)).T @ (measured - measured.mean(0)))
    turn = vt.T @ np.diag([1.0, 1.0, np.sign(np.linalg.det(vt.T @ u.T))]) @ u.T
    base = geometry.base
    moved = Pose(turn @ (base.position - nominal.mean(0)) + measured.mean(0), turn @ base.rotation)
    delta = np.zeros(len(geometry.parameter_names))
    delta[-12:-9] = moved.position - base.position
    delta[-9:-6] = rotation_vector(moved.rotation @ base.rotation.T)
    return delta
