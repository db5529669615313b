"""Rank-aware inverse kinematics for batches of targets, and measures of the workspace.

The solver takes Gauss-Newton steps through the truncated pseudo-inverse, with a pull to mid-range in the null space
(Liegeois 1977). A joint at its limit that a step would move outwards is locked. Targets not reached are tried again
from other joints, spread by a Halton sequence. Targets still not reached are tried by damped steps (Levenberg 1944,
Marquardt 1963) from the nearest of many sample poses. A damped step that increases the error is rejected. The result
says which targets were not reached, and the error that remains. Metres and radians.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import binary_erosion
from scipy.optimize import minimize
from scipy.spatial import cKDTree
from scipy.stats import qmc

from pickenv.arm.kinematics import task_space
from pickenv.arm.kinematics.forward import forward
from pickenv.arm.kinematics.geometry import Array, Geometry, Pose
from pickenv.arm.kinematics.task_space import pose_error
from pickenv.base import InputError

STEP_LIMIT = 0.4
"""Largest Gauss-Newton step of a joint, as a share of its half-range, or of 1 rad or 1 m if that is less. Within this
limit the linearisation by the Jacobian is valid."""

NUMERIC_TOLERANCE = 1e-6
"""Smallest relative singular value that is used; directions with smaller singular values are always cut off."""


POOL, NEAREST, DAMPED_STEPS = 2**13, 8, 40
"""Number of sample poses to choose starts from, number of starts per restart, and number of damped steps per start."""

TURN = 0.5
"""Weight of a rotation matrix's entries in the search for the nearest sample poses. Positions, divided by the largest
standard deviation of the sampled tool positions, have the weight 1."""


@dataclass(frozen=True, eq=False)
class InverseSolution:
    """Result of `inverse`: joints for the targets, and the errors that remain.

    Attributes:
        joints: The joints ``(..., n)``, rad or m, within the joint limits.
        reached: Whether position error and compensable attitude error are within the tolerances ``(...)``.
        position_error: Remaining position error ``(...)``, m.
        attitude_error: Remaining attitude error ``(...)``, rad, compensable or not.
        noncompensable_attitude: The part of the attitude error that no joint motion removes ``(...)``, rad.
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
    rank_tolerance: float = task_space.DIRECTION_TOLERANCE,
    max_iterations: int = 100,
    restarts: int = 4,
    position_only: bool = False,
) -> InverseSolution:
    """Find joints that bring the tool to ``target``, as far as the Jacobian's rank and the joint limits allow.

    Args:
        geometry: A single arm.
        target: Tool poses, position ``(..., 3)`` and rotation ``(..., 3, 3)``, world frame.
        start: Joints ``(..., n)`` to start from, rad or m; mid-range by default.
        position_tolerance: Largest remaining position error that counts as reached, m.
        attitude_tolerance: Largest remaining compensable attitude error that counts as reached, rad.
        rank_tolerance: Relative singular value below which a direction of tool motion is not corrected.
        max_iterations: Largest number of Gauss-Newton steps per start.
        restarts: Number of further starts for targets not reached, spread over the joint ranges by a Halton sequence.
            After them come `NEAREST` times as many starts from poses near the target. With 0 there are no further
            starts of either kind.
        position_only: Whether to ignore the attitude. An arm of few joints reaches few positions with a given attitude.

    Returns:
        An `InverseSolution`. If a target is not reached, ``reached`` is False, and the joints are from the start that
        leaves the smallest error.

    Raises:
        ValueError: If the target or the start is not finite.
    """
    position, rotation = np.asarray(target.position, dtype=float), np.asarray(target.rotation, dtype=float)
    if not (np.isfinite(position).all() and np.isfinite(rotation).all()):
        raise ValueError("the target pose is not finite; give finite positions (m) and rotation matrices")
    shape = np.broadcast_shapes(position.shape[:-1], rotation.shape[:-2])
    places, turns = np.broadcast_to(position, (*shape, 3)), np.broadcast_to(rotation, (*shape, 3, 3))
    goals = Pose(places.reshape(-1, 3), turns.reshape(-1, 3, 3))
    n = geometry.joints
    middle, half = (geometry.lower + geometry.upper) / 2, (geometry.upper - geometry.lower) / 2
    first = middle if start is None else np.asarray(start, dtype=float)
    if not np.isfinite(first).all():
        raise ValueError("the start is not finite; give finite joints (rad or m)")
    first = np.broadcast_to(first, (*shape, n)).reshape(-1, n).clip(geometry.lower, geometry.upper)
    spread = qmc.Halton(n, scramble=False).random(restarts + 1)[1:] * 2 - 1 if restarts else np.empty((0, n))
    parts = slice(0, 3 if position_only else 6)  # the components of the pose error that are reduced to zero

    def judge(goals: Pose, q: Array) -> InverseSolution:
        """Return joints ``(K, n)`` as an `InverseSolution` for K goals, with the errors that they leave."""
        error = pose_error(forward(geometry, q), goals)
        impossible = task_space.noncompensable_error(geometry, q, error, rank_tolerance)
        parts = error[:, :3], error[:, 3:], impossible[:, 3:], (error - impossible)[:, 3:]
        distance, attitude, lost, possible = (np.linalg.norm(part, axis=-1) for part in parts)
        reached = (distance <= position_tolerance) & (position_only | (possible <= attitude_tolerance))
        return InverseSolution(q, reached, distance, attitude, lost)

    solution = judge(goals, _descend(geometry, goals, first, rank_tolerance, max_iterations, parts))
    # None: from the best joints so far, using the directions near a singular pose that the truncation left alone.
    for offset in (None, *spread, None):
        open_ = np.flatnonzero(~solution.reached)
        if not open_.size:
            break
        some = Pose(goals.position[open_], goals.rotation[open_])
        begin, tolerance = solution.joints[open_], min(rank_tolerance, NUMERIC_TOLERANCE)
        if offset is not None:
            begin, tolerance = np.broadcast_to(middle + 0.9 * half * offset, begin.shape), rank_tolerance
        new = judge(some, _descend(geometry, some, begin, tolerance, max_iterations, parts))
        better = new.reached | ((_cost(new) < _cost(solution)[open_]) & (offset is not None))
        solution.joints[open_[better]] = new.joints[better]
        solution = judge(goals, solution.joints)
    if restarts and (open_ := np.flatnonzero(~solution.reached)).size:
        count = NEAREST * restarts
        some = Pose(*(np.repeat(part[open_], count, axis=0) for part in goals))
        near = _near(geometry, goals.position[open_], goals.rotation[open_], count)
        new = judge(some, _descend_damped(geometry, some, near, parts))
        cost = np.where(new.reached, -1.0, _cost(new)).reshape(open_.size, count)
        best = new.joints.reshape(open_.size, count, n)[range(open_.size), cost.argmin(axis=-1)]
        better = cost.min(axis=-1) < _cost(solution)[open_]
        solution.joints[open_[better]] = best[better]
        solution = judge(goals, solution.joints)
    joints, *figures = (getattr(solution, part.name) for part in fields(solution))
    return InverseSolution(joints.reshape(*shape, n), *(values.reshape(shape) for values in figures))


def _cost(solution: InverseSolution) -> Array:
    """Return for each target the error that joint motion might still remove, metres and radians added up."""
    return solution.position_error + solution.attitude_error - solution.noncompensable_attitude


def _near(geometry: Geometry, position: Array, rotation: Array, count: int) -> Array:
    """Find the sample poses nearest to each target, and return their joints ``(targets * count, n)``, rad or m.

    Args:
        geometry: The arm.
        position: Positions of the targets ``(targets, 3)``, m.
        rotation: Attitudes of the targets ``(targets, 3, 3)``.
        count: Number of sample poses for each target, among `POOL`.
    """
    joints = halton_joints(geometry, POOL)
    pool = forward(geometry, joints)
    size = max(float(pool.position.std(axis=0).max()), 1e-6)

    def features(place: Array, turn: Array) -> Array:
        return np.concatenate([place / size, TURN * turn.reshape(-1, 9)], axis=-1)

    _, nearest = cKDTree(features(*pool)).query(features(position, rotation), k=range(1, count + 1))
    return np.asarray(joints[np.asarray(nearest).reshape(-1)])


def _descend_damped(geometry: Geometry, goals: Pose, q: Array, parts: slice) -> Array:
    """Return joints ``(K, n)`` after `DAMPED_STEPS` damped steps from ``q`` towards K goals, within the joint limits.

    A step that does not reduce the error is rejected, and the damping increased.

    Args:
        geometry: The arm.
        goals: The K goals.
        q: Joints to start from ``(K, n)``, rad or m.
        parts: Components of the pose error to reduce: 0 to 2 position, 3 to 5 attitude.
    """
    damping = np.full(len(q), 1e-3)
    pose, jacobian = task_space.pose_and_jacobian(geometry, q)
    error, jacobian = pose_error(pose, goals)[:, parts], jacobian[:, parts]
    for _ in range(DAMPED_STEPS):
        downhill = np.einsum("kij,ki->kj", jacobian, error)
        locked = ((q <= geometry.lower) & (downhill < 0)) | ((q >= geometry.upper) & (downhill > 0))
        free = jacobian * ~locked[:, None, :]
        normal = np.einsum("kij,kil->kjl", free, free)
        weights = damping[:, None] * (np.einsum("kjj->kj", normal) + 1e-3) + locked
        normal = normal + weights[:, :, None] * np.eye(q.shape[-1])
        step = np.linalg.solve(normal, (downhill * ~locked)[..., None])[..., 0]
        trial = (q + step).clip(geometry.lower, geometry.upper)
        pose, moved = task_space.pose_and_jacobian(geometry, trial)
        trial_error = pose_error(pose, goals)[:, parts]
        nearer = np.sum(trial_error**2, axis=-1) < np.sum(error**2, axis=-1)
        q, error = np.where(nearer[:, None], trial, q), np.where(nearer[:, None], trial_error, error)
        jacobian = np.where(nearer[:, None, None], moved[:, parts], jacobian)
        damping = np.where(nearer, 0.2 * damping, 5.0 * damping).clip(1e-12, 1e6)
    return q


def _descend(geometry: Geometry, goals: Pose, q: Array, tolerance: float, max_iterations: int, parts: slice) -> Array:
    """Return joints ``(K, n)`` after Gauss-Newton steps from ``q`` towards K goals, with a pull in the null space.

    The pull is towards mid-range. Once all joints of a goal make negligible steps, they do not change any more.

    Args:
        geometry: The arm.
        goals: The K goals.
        q: Joints to start from ``(K, n)``, rad or m.
        tolerance: Relative singular value below which a direction of tool motion is not corrected.
        max_iterations: Largest number of steps.
        parts: Components of the pose error to reduce: 0 to 2 position, 3 to 5 attitude.
    """
    middle, half = (geometry.lower + geometry.upper) / 2, (geometry.upper - geometry.lower) / 2
    q = q.copy()
    active = np.arange(len(q))
    for _ in range(max_iterations):
        joints, some = q[active], Pose(goals.position[active], goals.rotation[active])
        pose, jacobian = task_space.pose_and_jacobian(geometry, joints)
        error, jacobian = pose_error(pose, some)[:, parts], jacobian[:, parts]
        step = _step(jacobian, error, (middle - joints) / half**2, half, tolerance)
        # A joint at its limit that would be pushed outwards is locked, and the others take over its share.
        outward = ((joints <= geometry.lower) & (step < 0)) | ((joints >= geometry.upper) & (step > 0))
        if outward.any():
            rows = np.flatnonzero(outward.any(axis=-1))
            free = jacobian[rows] * ~outward[rows, None, :]
            pull = (middle - joints[rows]) / half**2 * ~outward[rows]
            step[rows] = _step(free, error[rows], pull, half, tolerance) * ~outward[rows]
        q[active] = (joints + step).clip(geometry.lower, geometry.upper)
        active = active[np.max(np.abs(q[active] - joints), axis=-1) > 1e-11]
        if not active.size:
            break
    return q


def _step(jacobian: Array, error: Array, pull: Array, half: Array, rank_tolerance: float) -> Array:
    """Return one Gauss-Newton step plus the null-space motion along ``pull``: ``(..., n)``, rad or m.

    If a joint would exceed `STEP_LIMIT`, the whole step is shortened.

    Args:
        jacobian: Jacobians ``(..., k, n)`` of the k components of the pose error.
        error: Pose errors to remove ``(..., k)``.
        pull: Gradient towards mid-range ``(..., n)``.
        half: Half the range of each joint ``(n,)``, rad or m.
        rank_tolerance: Relative singular value below which a direction of tool motion is not corrected.
    """
    back = task_space.truncated_inverse(jacobian, rank_tolerance)
    step = np.einsum("...ij,...j->...i", back, error)
    null = np.eye(jacobian.shape[-1]) - back @ jacobian
    toward = np.einsum("...ij,...j->...i", null, pull)
    # Exact minimiser of sum(((q - middle) / half)^2) along that direction, were the null space straight.
    curvature, along = np.sum((toward / half) ** 2, axis=-1), np.sum(toward * pull, axis=-1)
    step = step + toward * np.divide(along, curvature, out=np.zeros_like(along), where=curvature > 1e-18)[..., None]
    largest = np.max(np.abs(step) / np.minimum(half, 1.0), axis=-1, keepdims=True)
    return np.asarray(step * np.minimum(1.0, STEP_LIMIT / np.maximum(largest, 1e-12)))


# How far an arm reaches, and the largest cube that it reaches with one tool attitude. The cube's edges are parallel to
# the world axes (ISO 9283, 6.8.3). The workspace is sampled on a grid, so the cube is the largest to within one grid
# step. Metres.


SAMPLES = 2**14
"""Number of joint samples, from a Halton sequence, that approximate the workspace."""

ITERATIONS = 10
"""Gauss-Newton steps of the inverse kinematics from the nearest sample; they converge quadratically."""


@dataclass(frozen=True, eq=False)
class Cube:
    """A cube in the workspace, which here is all that the tool reaches within the joint limits.

    Attributes:
        centre: The cube's centre (3,), m, world frame.
        edge: Length of its edges, m; they are parallel to the world axes.
        rotation: Tool attitude with which the cube is reached (3, 3).
        free: Whether the cube is reached with any attitudes, so that ``rotation`` does not matter.
    """

    centre: Array
    edge: float
    rotation: Array
    free: bool = False

    def inclined_plane(self) -> Pose:
        """Return the five test poses of ISO 9283 as a batch: P1 in the centre, P2 to P5 near the plane's corners.

        P2 to P5 lie on the plane's diagonals, a tenth of a diagonal from the corners. The plane contains the cube's
        upper edge at -x and its lower edge at +x: corners C1, C2, C7, C8 of the standard's figure.
        """
        signs = np.array([[0, 0], [-1, -1], [-1, 1], [1, 1], [1, -1]])
        offsets = np.stack([signs[:, 0], signs[:, 1], -signs[:, 0]], axis=-1) * 0.8 * self.edge / 2.0
        return Pose(self.centre + offsets, np.broadcast_to(self.rotation, (5, 3, 3)))


def largest_cube(geometry: Geometry, rotation: Array | None = None, *, steps: int = 20, free: bool = False) -> Cube:
    """Find the largest cube in the workspace (all that the tool reaches), with edges parallel to the world axes.

    Args:
        geometry: The arm.
        rotation: Tool attitude (3, 3), world frame; by default the attitude in the middle of all joint ranges. An
            attitude error that no joint motion removes is ignored.
        steps: Number of grid steps along the longest side of the workspace.
        free: Whether to ignore the attitude, for an arm that cannot keep one attitude throughout a cube.

    Raises:
        InputError: If the arm does not reach all corners of any cube of one grid step.
    """
    if rotation is None:
        rotation = forward(geometry, (geometry.lower + geometry.upper) / 2.0).rotation
    joints = halton_joints(geometry, SAMPLES)
    points = forward(geometry, joints).position
    low, high = points.min(axis=0), points.max(axis=0)
    step = float((high - low).max()) / steps
    axes = [np.arange(a, b + 1e-9, step) for a, b in zip(low, high, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    targets = grid.reshape(-1, 3)
    distance, nearest = cKDTree(points).query(targets)
    near = np.flatnonzero(distance < step)
    goals = Pose(targets[near], np.broadcast_to(rotation, (near.size, 3, 3)))
    start = joints[np.asarray(nearest)[near]]
    solution = inverse(geometry, goals, start, max_iterations=ITERATIONS, restarts=0, position_only=free)
    within = np.zeros(len(targets), dtype=bool)
    within[near] = solution.reached
    corner, size = _largest_filled(within.reshape(grid.shape[:-1]))
    if size == 0:
        raise InputError(f"this arm reaches no cube of {1e3 * step:.0f} mm with one tool attitude; give another one")
    edge = size * step
    return Cube(grid[corner] + edge / 2.0, edge, np.asarray(rotation, dtype=float), free)


def farthest(geometry: Geometry) -> float:
    """Compute the largest distance of the tool from the origin of frame 0 within the joint limits, m.

    A local maximisation starts from the farthest of `SAMPLES` samples.
    """
    joints = halton_joints(geometry, SAMPLES)
    foot = geometry.base.position

    def nearness(q: Array) -> float:
        return -float(np.linalg.norm(forward(geometry, q).position - foot))

    first = joints[np.argmax(np.linalg.norm(forward(geometry, joints).position - foot, axis=-1))]
    return -float(minimize(nearness, first, bounds=list(zip(geometry.lower, geometry.upper, strict=True))).fun)


def halton_joints(geometry: Geometry, count: int) -> Array:
    """Return joints ``(count, n)``, rad or m, from a Halton sequence scaled to the joint limits."""
    shares = qmc.Halton(geometry.joints, scramble=False).random(count)
    return np.asarray(geometry.lower + (geometry.upper - geometry.lower) * shares)


def _largest_filled(filled: NDArray[np.bool_]) -> tuple[tuple[int, ...], int]:
    """Find the largest cube of filled grid points; return the indices (from 0) of its lower corner, and its edge.

    The edge is in grid steps. ``filled`` says for each point of a three-dimensional grid whether the point is filled
    (reached).
    """
    size, grown = -1, filled
    while grown.any():
        size, corners = size + 1, grown  # the points that are the lower corner of a filled cube of this size
        grown = binary_erosion(corners, np.ones((2, 2, 2), dtype=bool), origin=-1)
    if size < 0:
        return (0, 0, 0), 0
    choices = np.argwhere(corners)
    return tuple(choices[len(choices) // 2].tolist()), size
