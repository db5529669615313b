"""Equations of Qiao 2026 to the letter, beside what they should be: (9)-(10) phi, (11) solvers, (13)-(15) J_a^-1."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from pickenv.arm import Array, Geometry, forward, joint_jacobian, pose_error
from pickenv.calibration import (
    Compensator,
    ErrorStatistics,
    Measurements,
    error_statistics,
    identify,
    link_model,
    random_joints,
)
from pickenv.calibration.model.arm_model import ArmModel, ErrorModel

PAPER: Mapping[str, Any] = tomllib.loads((Path(__file__).parent / "paper.toml").read_text(encoding="utf-8"))
REMOVED_BY_PAPER = ("a2", "a3", "a5", "d3", "d4", "theta2", "d6")
RANK_AWARE_24, RANK_AWARE_17 = "24, rank-aware", "17 of the paper, rank-aware (rank 15)"
SMALL_STEP_M = 0.1
"""A correction of millimetres that commands a joint further than this, m or rad, is of no use."""


def paper_eta(identified: ArrayLike, true: ArrayLike) -> float:
    """The paper's mean identification accuracy in percent, as its Table 2 implies it (digest, fact 7).

    Mean over parameters of 1 - |identified - true| / |true| on absolute values; parameters whose true value is zero
    have none and are left out. Dominated by near-zero parameters: rank methods by base-parameter error instead.
    """
    identified, true = np.asarray(identified, dtype=float), np.asarray(true, dtype=float)
    rated = (true != 0) & np.isfinite(identified)
    return float(100.0 * np.mean(1.0 - np.abs(identified[rated] - true[rated]) / np.abs(true[rated])))


def parameter_vector(geometry: Geometry) -> Array:
    """The 24 parameters in the model's order, degrees and millimetres as in Table 2."""
    return np.concatenate([np.degrees(geometry.alpha), geometry.a * 1e3, geometry.d * 1e3, np.degrees(geometry.theta)])


def mean_mm(errors: Array) -> float:
    """Mean position error of pose errors ``(N, 6)`` in m and rad, mm."""
    return float(1e3 * np.linalg.norm(errors[:, :3], axis=1).mean())


def statistics(errors: Array) -> tuple[ErrorStatistics, ErrorStatistics]:
    """Statistics of pose errors ``(N, 6)`` in m and rad: of position in mm, of attitude in degrees."""
    return error_statistics(errors[:, :3] * 1e3), error_statistics(np.degrees(errors[:, 3:]))


def paper_model(geometry: Geometry) -> ErrorModel:
    """The paper's 17 parameters: it removes both d3 and theta2 and keeps collinear pairs, so its rank is 15."""
    full = link_model(geometry)
    keep = np.array([name not in REMOVED_BY_PAPER for name in full.names])
    names = tuple(name for name in full.names if name not in REMOVED_BY_PAPER)
    return ErrorModel(full.columns[keep], names, full.tolerance[keep])


def linearised(model: ErrorModel, geometry: Geometry, data: Measurements) -> tuple[Array, Array]:
    """Eq (8) stacked, whitened and in tolerances, and what it shall explain."""
    arm, none = ArmModel.of(geometry), np.zeros(0)
    return data.jacobian(arm, none)[0][:, model.columns] * model.tolerance, data.residual(arm, none)


def naive_normal_equations(
    model: ErrorModel, start: Geometry, data: Measurements, iterations: int = 5
) -> Geometry | None:
    """Eq (11) as printed, (J^T J)^-1 J^T dP, iterated, without any truncation; None where J^T J is singular."""
    geometry = start
    for _ in range(iterations):
        jacobian, residual = linearised(model, geometry, data)
        try:
            step = np.linalg.solve(jacobian.T @ jacobian, jacobian.T @ residual)
        except np.linalg.LinAlgError:
            return None
        geometry = moved(model, geometry, step)
    return geometry


def minimum_norm(model: ErrorModel, start: Geometry, data: Measurements, iterations: int = 5) -> Geometry:
    """All parameters by the truncated pseudo-inverse: the minimum-norm solution, which Table 2's 24 column is."""
    geometry = start
    for _ in range(iterations):
        geometry = moved(model, geometry, np.linalg.lstsq(*linearised(model, geometry, data), rcond=1e-4)[0])
    return geometry


def moved(model: ErrorModel, geometry: Geometry, step: Array) -> Geometry:
    """The geometry after a step in tolerances."""
    delta = np.zeros(len(geometry.parameter_names))
    delta[model.columns] = step * model.tolerance
    return geometry.displaced(delta)


def solutions(
    nominal: Geometry, true: Geometry, identification: Measurements, test: Measurements
) -> tuple[dict[str, Any], dict[str, Array]]:
    """The 24, 17 and 16 parameter models by both solvers: figures, and errors at the test poses ``(N, 6)``."""
    full, theirs = link_model(nominal), paper_model(nominal)
    base = identify(full, nominal, identification)
    solved = {
        "24, normal equations": naive_normal_equations(full, nominal, identification),
        RANK_AWARE_24: minimum_norm(full, nominal, identification),
        "17 of the paper, normal equations": naive_normal_equations(theirs, nominal, identification),
        RANK_AWARE_17: identify(theirs, nominal, identification).geometry,
        "base 16, rank-aware": base.geometry,
    }
    rows: dict[str, Any] = {}
    errors = {"raw": test.difference(nominal)}
    for name, geometry in solved.items():
        rows[name] = None
        if geometry is None:
            continue
        values, errors[name] = parameter_vector(geometry), test.difference(geometry)
        position, attitude = statistics(errors[name])
        rows[name] = {
            "parameters": dict(zip(full.names, values.tolist(), strict=True)),
            "largest_change_mm": float(np.abs((geometry.d - nominal.d) * 1e3).max()),
            "position_mm": position.as_dict(),
            "attitude_deg": attitude.as_dict(),
            "eta_percent": paper_eta(values, parameter_vector(true)),
        }
    dropped = {name: list(absorbed) for name, absorbed in base.identifiability.dropped.items()}
    return {"rows": rows, "rank": base.identifiability.rank, "dropped": dropped}, errors


def paper_phi(geometry: Geometry, poses: int, rng: np.random.Generator) -> dict[str, dict[str, float]]:
    """Eqs (9)-(10) to the letter, QR of the stacked J_q over ``poses``: phi by parameter, in three systems of units."""
    model = link_model(geometry)
    joints = random_joints(geometry, poses, rng)
    jacobian = ArmModel.of(geometry).jacobian(joints)[..., model.columns]  # (N, 6, 24): m and rad per m and rad
    stacked = jacobian.reshape(6 * poses, -1)
    rows, columns = np.tile(np.repeat([1e3, 1.0], 3), poses), np.where(geometry.parameter_is_angle, 1.0, 1e-3)
    in_mm = stacked * rows[:, None] * columns[model.columns]
    phi = {}
    for unit, matrix in (("mm and rad", in_mm), ("m and rad", stacked), ("tolerances", stacked * model.tolerance)):
        diagonal = np.abs(np.diag(np.linalg.qr(matrix, mode="r")))
        phi[unit] = dict(zip(model.names, (diagonal / diagonal.mean()).tolist(), strict=True))
    return phi


def literal_correction(nominal: Geometry, geometry: Geometry, joints: Array) -> dict[str, float]:
    """Eqs (13)-(15) as printed beside the truncated inverse: one step by J_a^-1 at each pose, and where it leads.

    ``geometry`` is taken for the true arm, so that all that is left is the correction's own.
    """
    wanted, there = forward(nominal, joints), forward(geometry, joints)
    jacobian = joint_jacobian(geometry, joints)
    step = np.linalg.solve(jacobian, pose_error(there, wanted)[..., None])[..., 0]
    slides = np.array(nominal.prismatic)
    command = Compensator(nominal, geometry, None)(joints)
    return {
        "poses": len(joints),
        "condition": float(np.linalg.cond(jacobian).max()),
        "corrected_mm": mean_mm(pose_error(there, wanted)),
        "largest_step_m": float(np.abs(step[:, slides]).max()),
        "largest_step_rad": float(np.abs(step[:, ~slides]).max()),
        "share_of_useless_steps": float(np.mean(np.abs(step).max(axis=1) > SMALL_STEP_M)),
        "mean_mm": mean_mm(pose_error(wanted, forward(geometry, joints + step))),
        "truncated_largest_step_m": float(np.abs(command - joints)[:, slides].max()),
        "truncated_mean_mm": mean_mm(pose_error(wanted, forward(geometry, command))),
    }
