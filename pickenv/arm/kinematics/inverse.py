"""Rank-aware inverse kinematics for batches of targets.

Gauss-Newton steps through the truncated pseudo-inverse, a pull to mid-range in the null space (Liegeois 1977), joint
limits by locking joints that push outwards, and restarts from evenly spread joints. What is still not reached is tried
by damped steps (Levenberg 1944, Marquardt 1963), which never lose ground at joint limits, from those of many poses that
stand nearest. Targets that cannot be reached are said to be so, with the error that remains. Metres and radians.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import partial

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree
from scipy.stats import qmc

from pickenv.arm.kinematics.forward import forward
from pickenv.arm.kinematics.geometry import Array, Geometry, Pose
from pickenv.arm.kinematics.pose_error import pose_error
from pickenv.arm.kinematics.task_space import (
    DIRECTION_TOLERANCE,
    joint_jacobian,
    noncompensable_error,
    truncated_inverse,
)

STEP_LIMIT = 0.4
"""Largest Gauss-Newton step, in half-ranges of a joint or 0.4 rad, so that a step stays where the Jacobian holds."""

NUMERIC_TOLERANCE = 1e-6
"""Relative singular value below which a direction is lost in any case."""


POOL, NEAREST, DAMPED_STEPS = 2**13, 8, 40
"""Poses among which starts are sought, starts per restart, and steps from each."""

WHOLE = slice(0, 6)
"""Which components of a pose error are to vanish: position and attitude."""

TURN = 0.5
"""What the entries of a rotation matrix count against a position, as a share of the tool's spread, in "nearest"."""


@dataclass(frozen=True, eq=False)
class InverseSolution:
    """Joints found for targets, and how well they reach them.

    Attributes:
        joints: ``(..., n)`` rad or m, within the joint limits.
        reached: ``(...)``, whether position and compensable attitude are met within the tolerances asked for.
        position_error: Remaining position error ``(...)``, m.
        attitude_error: Remaining attitude error ``(...)``, rad, compensable or not.
        noncompensable_attitude: The part of it that no joint motion removes ``(...)``, rad.
    """

    joints: Array
    reached: NDArray[np.bool_]
    position_error: Array
    attitude_error: Array
    noncompensable_attitude: Array


def inverse(
    geometry: Geometry,
    target: Pose,
    start: ArrayLike | None = None,
    *,
    position_tolerance: float = 1e-5,
    attitude_tolerance: float = 1e-5,
    rank_tolerance: float = DIRECTION_TOLERANCE,
    max_iterations: int = 100,
    restarts: int = 4,
    position_only: bool = False,
) -> InverseSolution:
    """Joints that bring the tool to ``target``, as far as rank and joint limits allow.

    Args:
        geometry: A single arm.
        target: Tool poses, position ``(..., 3)`` and rotation ``(..., 3, 3)``, world frame.
        start: Joints ``(..., n)`` to start from; mid-range when left out.
        position_tolerance: m; a larger remaining position error counts as not reached.
        attitude_tolerance: rad; for the compensable part of the attitude error.
        rank_tolerance: Relative singular value below which a direction is left alone.
        max_iterations: Gauss-Newton steps per start.
        restarts: Further starts, spread evenly over the joint ranges, for targets not reached, and then `NEAREST` times
            as many from poses near the target; with 0 there are none of either.
        position_only: Whether the attitude is free: an arm of few joints reaches few places with a given one.

    Returns:
        An `InverseSolution`; unreachable targets have ``reached`` False and the closest joints found.

    Raises:
        ValueError: If the target or the start is not finite.
    """
    position, rotation = np.asarray(target.position, dtype=float), np.asarray(target.rotation, dtype=float)
    if not (np.isfinite(position).all() and np.isfinite(rotation).all()):
        raise ValueError("the target pose is not finite; give finite positions (m) and rotation matrices")
    shape = np.broadcast_shapes(position.shape[:-1], rotation.shape[:-2])
    goals = Pose(
        np.broadcast_to(position, (*shape, 3)).reshape(-1, 3),
        np.broadcast_to(rotation, (*shape, 3, 3)).reshape(-1, 3, 3),
    )
    n, count = geometry.joints, goals.position.shape[0]
    middle, half = (geometry.lower + geometry.upper) / 2, (geometry.upper - geometry.lower) / 2
    first = middle if start is None else np.asarray(start, dtype=float)
    if not np.isfinite(first).all():
        raise ValueError("the start is not finite; give finite joints (rad or m)")
    best = np.broadcast_to(first, (*shape, n)).reshape(-1, n).clip(geometry.lower, geometry.upper)
    spread = qmc.Halton(n, scramble=False).random(restarts + 1)[1:] * 2 - 1 if restarts else np.empty((0, n))
    descend, descend_damped = _descend, _descend_damped
    if position_only:
        attitude_tolerance, first_three = np.inf, slice(0, 3)
        descend, descend_damped = partial(descend, parts=first_three), partial(descend_damped, parts=first_three)
    best = descend(geometry, goals, best, middle, half, rank_tolerance, max_iterations)
    state = _judge(geometry, goals, best, position_tolerance, attitude_tolerance, rank_tolerance)
    # None: from the best joints so far, using the directions near a singular pose that the truncation left alone.
    for offset in (None, *spread, None):
        open_ = np.flatnonzero(~state.reached)
        if not open_.size:
            break
        some = Pose(goals.position[open_], goals.rotation[open_])
        begin = best[open_] if offset is None else np.broadcast_to(middle + 0.9 * half * offset, (open_.size, n))
        tolerance = rank_tolerance if offset is not None else min(rank_tolerance, NUMERIC_TOLERANCE)
        tried = descend(geometry, some, begin, middle, half, tolerance, max_iterations)
        new = _judge(geometry, some, tried, position_tolerance, attitude_tolerance, rank_tolerance)
        better = new.reached | ((_cost(new) < _cost(state)[open_]) & (offset is not None))
        best[open_[better]] = tried[better]
        state = _judge(geometry, goals, best, position_tolerance, attitude_tolerance, rank_tolerance)
    if restarts and (open_ := np.flatnonzero(~state.reached)).size:
        count_each = NEAREST * restarts
        some = Pose(*(np.repeat(part[open_], count_each, axis=0) for part in goals))
        tried = _descend_damped(
            geometry, some, _near(geometry, goals.position[open_], goals.rotation[open_], count_each)
        )
        new = _judge(geometry, some, tried, position_tolerance, attitude_tolerance, rank_tolerance)
        cost = np.where(new.reached, -1.0, _cost(new)).reshape(open_.size, count_each)
        first = cost.argmin(axis=-1)
        better = cost.min(axis=-1) < _cost(state)[open_]
        best[open_[better]] = tried.reshape(open_.size, count_each, n)[better, first[better]]
        state = _judge(geometry, goals, best, position_tolerance, attitude_tolerance, rank_tolerance)
    assert state.joints.shape == (count, n)
    joints, *judged = (getattr(state, part.name) for part in fields(state))
    return InverseSolution(joints.reshape(*shape, n), *(values.reshape(shape) for values in judged))


def _cost(solution: InverseSolution) -> Array:
    """What remains and a joint motion might remove, m and rad as one."""
    return solution.position_error + solution.attitude_error - solution.noncompensable_attitude


def _near(geometry: Geometry, position: Array, rotation: Array, count: int) -> Array:
    """Joints of the ``count`` poses of an even spread that stand nearest to each target (targets * count, n)."""
    shares = qmc.Halton(geometry.joints, scramble=False).random(POOL)
    joints = geometry.lower + (geometry.upper - geometry.lower) * shares
    pool = forward(geometry, joints)
    size = max(float(pool.position.std(axis=0).max()), 1e-6)

    def features(place: Array, turn: Array) -> Array:
        return np.concatenate([place / size, TURN * turn.reshape(-1, 9)], axis=-1)

    _, nearest = cKDTree(features(*pool)).query(features(position, rotation), k=range(1, count + 1))
    return np.asarray(joints[np.asarray(nearest).reshape(-1)])


def _descend_damped(geometry: Geometry, goals: Pose, q: Array, parts: slice = WHOLE) -> Array:
    """Damped steps within the joint limits; one that does not come nearer is not taken, and damped more next time."""
    damping = np.full(len(q), 1e-3)
    error = pose_error(forward(geometry, q), goals)[:, parts]
    for _ in range(DAMPED_STEPS):
        jacobian = joint_jacobian(geometry, q)[:, parts]
        downhill = np.einsum("kij,ki->kj", jacobian, error)
        held = ((q <= geometry.lower) & (downhill < 0)) | ((q >= geometry.upper) & (downhill > 0))
        free = jacobian * ~held[:, None, :]
        normal = np.einsum("kij,kil->kjl", free, free)
        weights = damping[:, None] * (np.einsum("kjj->kj", normal) + 1e-3) + held
        normal = normal + weights[:, :, None] * np.eye(q.shape[-1])
        step = np.linalg.solve(normal, (downhill * ~held)[..., None])[..., 0]
        tried = (q + step).clip(geometry.lower, geometry.upper)
        left = pose_error(forward(geometry, tried), goals)[:, parts]
        nearer = np.sum(left**2, axis=-1) < np.sum(error**2, axis=-1)
        q, error = np.where(nearer[:, None], tried, q), np.where(nearer[:, None], left, error)
        damping = np.where(nearer, 0.2 * damping, 5.0 * damping).clip(1e-12, 1e6)
    return q


def _judge(
    geometry: Geometry,
    goals: Pose,
    q: Array,
    position_tolerance: float,
    attitude_tolerance: float,
    rank_tolerance: float,
) -> InverseSolution:
    error = pose_error(forward(geometry, q), goals)
    impossible = noncompensable_error(geometry, q, error, rank_tolerance)
    position = np.linalg.norm(error[:, :3], axis=-1)
    possible = np.linalg.norm((error - impossible)[:, 3:], axis=-1)
    return InverseSolution(
        joints=q,
        reached=(position <= position_tolerance) & (possible <= attitude_tolerance),
        position_error=position,
        attitude_error=np.linalg.norm(error[:, 3:], axis=-1),
        noncompensable_attitude=np.linalg.norm(impossible[:, 3:], axis=-1),
    )


def _descend(
    geometry: Geometry,
    goals: Pose,
    q: Array,
    middle: Array,
    half: Array,
    rank_tolerance: float,
    max_iterations: int,
    parts: slice = WHOLE,
) -> Array:
    """Damped-step Gauss-Newton with null-space pull; rows that have settled are left alone."""
    q = q.copy()
    active = np.arange(len(q))
    for _ in range(max_iterations):
        here, some = q[active], Pose(goals.position[active], goals.rotation[active])
        error = pose_error(forward(geometry, here), some)[:, parts]
        jacobian = joint_jacobian(geometry, here)[:, parts]
        step = _step(jacobian, error, (middle - here) / half**2, half, rank_tolerance)
        # A joint at its limit that would be pushed outwards is locked, and the others take over its share.
        outward = ((here <= geometry.lower) & (step < 0)) | ((here >= geometry.upper) & (step > 0))
        if outward.any():
            rows = np.flatnonzero(outward.any(axis=-1))
            held = jacobian[rows] * ~outward[rows, None, :]
            pull = (middle - here[rows]) / half**2 * ~outward[rows]
            step[rows] = _step(held, error[rows], pull, half, rank_tolerance) * ~outward[rows]
        moved = (here + step).clip(geometry.lower, geometry.upper)
        q[active] = moved
        active = active[np.max(np.abs(moved - here), axis=-1) > 1e-11]
        if not active.size:
            break
    return q


def _step(jacobian: Array, error: Array, pull: Array, half: Array, rank_tolerance: float) -> Array:
    """One Gauss-Newton step plus the null-space pull along the gradient of the mid-range cost."""
    back = truncated_inverse(jacobian, rank_tolerance)
    step = np.einsum("...ij,...j->...i", back, error)
    null = np.eye(jacobian.shape[-1]) - back @ jacobian
    toward = np.einsum("...ij,...j->...i", null, pull)
    # Exact minimiser of sum(((q - middle) / half)^2) along that direction, were the null space straight.
    curvature = np.sum((toward / half) ** 2, axis=-1)
    along = np.sum(toward * pull, axis=-1)
    step = step + toward * np.divide(along, curvature, out=np.zeros_like(along), where=curvature > 1e-18)[..., None]
    largest = np.max(np.abs(step) / np.minimum(half, 1.0), axis=-1, keepdims=True)
    return np.asarray(step * np.minimum(1.0, STEP_LIMIT / np.maximum(largest, 1e-12)))
