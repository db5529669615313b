"""Base and tool pose from anywhere: closed-form starts, then least squares, and the refusal of what is no such arm.

Positions p = t + R (o + Q u), with the chain's own o and Q, are linear in R^T, R^T t and the tool offset u once read
backwards; full poses give R and the tool's attitude T as the null vector of A T^T = R Q (AX = YB; Dornaika and Horaud
1998). Where the motion leaves these undetermined, the nominal tool and a few others are tried. SI units.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from pickenv.arm import Geometry, Pose, forward, rotation_matrix, rotation_vector
from pickenv.arm.kinematics.geometry import Array, identity_pose
from pickenv.calibration.identification.least_squares import Identification, identify
from pickenv.calibration.model.error_model import ErrorModel
from pickenv.calibration.model.measurements import Measurements
from pickenv.calibration.model.observations import nearest_rotation
from pickenv.errors import InputError
from pickenv.threads import single_threaded

MISFIT = 0.2
"""Errors above this share of the positions' spread, or this many rad, are no arm's: the data mean something else."""

SPAN = 0.1
"""Positions that spread less than this, m, are judged as if they did: few and close ones are still of the arm."""

GOOD = 0.05
"""A fit that misses by less than this share of the spread needs no further starts."""

STARTS = 24
"""Tools tried where neither the closed form nor the nominal tool leads anywhere."""


@single_threaded()
def align(geometry: Geometry, measurements: Measurements, frames: ErrorModel, *, judge: bool = True) -> Identification:
    """Fit base and tool pose, from anywhere.

    Args:
        geometry: The arm; its base and tool are one of the starts.
        measurements: Poses or positions.
        frames: Base and tool parameters (`frames_model`).
        judge: Whether to refuse data that do not fit the arm.

    Raises:
        InputError: If the data do not fit the arm at all, which means wrong units, joint signs or conventions.
    """
    best: Identification | None = None
    for start in _starts(geometry, measurements):
        found = identify(frames, start, measurements, max_iterations=100)
        if best is None or found.chi_square < best.chi_square:
            best = found
        if max(misfit(best.geometry, measurements)) < GOOD:
            break
    assert best is not None
    if judge:
        refuse_another_arm(best.geometry, measurements, "after fitting base and tool", geometry)
    return best


def misfit(geometry: Geometry, measurements: Measurements) -> tuple[float, float]:
    """RMS position error as a share of the measured positions' spread, and RMS attitude error in rad (0 without)."""
    left = measurements.difference(geometry)
    spread = max(float(np.linalg.norm(measurements.position.std(axis=0))), 1e-12)
    turn = np.sqrt(np.mean(np.sum(left[:, 3:] ** 2, axis=1)))
    return float(np.sqrt(np.mean(np.sum(left[:, :3] ** 2, axis=1)))) / spread, float(turn)


def _starts(geometry: Geometry, measurements: Measurements) -> Iterator[Geometry]:
    """Starting geometries, the best first: closed form and nominal tool, then other tools (the same every time)."""
    chain = forward(replace(geometry, base=identity_pose(), tool=identity_pose()), measurements.joints)
    tools = [geometry.tool, _closed_form_tool(chain, measurements, geometry.tool)]
    first = [registered(geometry, tool, chain, measurements) for tool in tools]
    yield from sorted(first, key=lambda start: _cost(start, measurements))
    rng = np.random.default_rng(0)
    reach = max(float(np.linalg.norm(measurements.position.std(axis=0))), 1e-3)
    others = []
    for _ in range(STARTS * 8):
        tool = Pose(rng.normal(size=3) * reach, rotation_matrix(rng.normal(size=3) * 2.0))
        others.append(registered(geometry, tool, chain, measurements))
    yield from sorted(others, key=lambda start: _cost(start, measurements))[: STARTS // 4]


def _cost(geometry: Geometry, measurements: Measurements) -> float:
    position, turn = misfit(geometry, measurements)
    return position + turn


def registered(geometry: Geometry, tool: Pose, chain: Pose, measurements: Measurements) -> Geometry:
    """The geometry with this tool, and with the base that lays its poses best onto the measured ones.

    Rotations by the attitudes where measured, else by the positions (Kabsch 1976).
    """
    nominal = chain.position + chain.rotation @ tool.position
    measured = measurements.position
    if measurements.rotation is None:
        turn = nearest_rotation((measured - measured.mean(0)).T @ (nominal - nominal.mean(0)))
    else:
        turn = nearest_rotation(np.einsum("nij,nkj->ik", measurements.rotation, chain.rotation @ tool.rotation))
    base = Pose(measured.mean(0) - turn @ nominal.mean(0), turn)
    return replace(geometry, base=base, tool=tool)


def _closed_form_tool(chain: Pose, measurements: Measurements, nominal: Pose) -> Pose:
    """The tool's pose in the last link, linearly."""
    if measurements.rotation is None:
        return Pose(_offset_from_positions(chain, measurements.position), nominal.rotation)
    turn, tool_turn = _turns_from_attitudes(chain.rotation, measurements.rotation)
    # p = t + R o + R Q u is linear in t and u.
    count = len(measurements)
    matrix = np.concatenate([np.broadcast_to(np.eye(3), (count, 3, 3)), turn @ chain.rotation], axis=2)
    right = measurements.position - chain.position @ turn.T
    solution = np.linalg.lstsq(matrix.reshape(-1, 6), right.ravel(), rcond=1e-9)[0]
    return Pose(solution[3:], tool_turn)


def _offset_from_positions(chain: Pose, position: Array) -> Array:
    """The offset u of M p - s - Q u = o, linear in M = R^T, s = R^T t and u."""
    count, middle = len(position), position.mean(axis=0)
    by_rotation = np.einsum("ik,nj->nikj", np.eye(3), position - middle).reshape(count, 3, 9)
    by_shift = np.broadcast_to(-np.eye(3), (count, 3, 3))
    matrix = np.concatenate([by_rotation, by_shift, -chain.rotation], axis=2)
    solution = np.linalg.lstsq(matrix.reshape(-1, 15), chain.position.ravel(), rcond=1e-6)[0]
    return np.asarray(solution[12:])


def _turns_from_attitudes(chain: Array, measured: Array) -> tuple[Array, Array]:
    """Base and tool rotation of measured = R chain T: the null vector of measured T^T - R chain = 0."""
    rows = []
    for mine, theirs in zip(chain, measured, strict=True):
        # Row-major vec: vec(A X) = (A kron 1) vec X, vec(Y B) = (1 kron B^T) vec Y.
        rows.append(np.concatenate([np.kron(theirs, np.eye(3)), -np.kron(np.eye(3), mine.T)], axis=1))
    gram = sum(row.T @ row for row in rows)
    vector = np.linalg.eigh(gram)[1][:, 0]
    first, second = vector[:9].reshape(3, 3), vector[9:].reshape(3, 3)
    sign = np.sign(np.linalg.det(second)) or 1.0
    turn = nearest_rotation(second * sign)
    tool = nearest_rotation(first * sign).T
    return turn, tool


def apart(one: Pose, other: Pose) -> tuple[float, float]:
    """How far two poses lie apart, m, and the angle between them, rad."""
    turn = rotation_vector(one.rotation.T @ other.rotation)
    return float(np.linalg.norm(one.position - other.position)), float(np.linalg.norm(turn))


def refuse_another_arm(
    geometry: Geometry, measurements: Measurements, state: str, nominal: Geometry | None = None
) -> None:
    """Refuse measurements that lie so far from ``geometry`` that units, joint signs or conventions must be wrong.

    Args:
        geometry: The arm, with base and tool as they are known or fitted.
        measurements: The data.
        state: What was done about base and tool, as the message says it.
        nominal: The arm with its own tool, where ``geometry`` has a fitted one.

    Raises:
        InputError: If positions miss by more than `MISFIT` of their spread, `SPAN` at least, or attitudes by more than
            `MISFIT` rad.
    """
    if len(measurements) < 3:
        return  # no spread to speak of; `identify` says how many poses are needed
    position, turn = misfit(geometry, measurements)
    spread = float(np.linalg.norm(measurements.position.std(axis=0)))
    if position * spread > MISFIT * max(spread, SPAN):
        own = float(np.linalg.norm(forward(nominal or geometry, measurements.joints).position.std(axis=0)))
        ratio = spread / max(own, 1e-12)
        if not 0.05 < ratio < 20:
            raise InputError(
                f"{measurements.source}: positions spread {ratio:.3g} times as far as the "
                "arm's own; positions are probably in another length unit, or joints in another angle unit"
            )
        raise InputError(
            f"{measurements.source}: {state} the arm still misses by {position * spread * 1e3:.0f} mm RMS, of a spread "
            f"of {spread * 1e3:.0f} mm; check the arm, the units, joint order and signs, and the attitude convention"
        )
    if turn > MISFIT:
        raise InputError(
            f"{measurements.source}: {state} attitudes still miss by {np.degrees(turn):.0f} deg RMS; "
            "check the attitude convention and its unit, and the joint signs"
        )
