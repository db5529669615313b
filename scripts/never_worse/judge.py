"""Judge a calibrated arm against the true one: the error of its flange with base and tool aligned, and its stated 95 %.

Three points go with the flange, at the corners of an even triangle `REACH` ahead of it and `REACH` around its axis, as
a tool's are. Where the instrument stood and what it measured on the flange is nobody's error, so six freedoms at the
base and six at the flange are fitted before anything is counted. Units: m and rad inside.
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from pickenv.arm import Array, Geometry, Pose, forward, identity_pose
from pickenv.base import read_text, yaml_content
from pickenv.calibration import Calibration
from pickenv.calibration.pipeline.calibration import uncertainty_from

REACH = 0.1
"""How far the three points are ahead of the flange, and from its axis, m."""

AROUND = np.radians([0.0, 120.0, 240.0])

POINTS = REACH * np.stack([np.cos(AROUND), np.sin(AROUND), np.ones(3)], axis=-1)
"""The three points in the flange's frame ``(3, 3)``, m."""

BESIDE = 0.15
"""How far beside a measured pose is beside: standard deviation of each joint, rad."""

VECTORS = 400
"""So many joint vectors are drawn in a region."""

PoseOf = Callable[[Array], Pose]
"""Flange poses at joints ``(N, n)``."""


def flange_of(geometry: Geometry) -> PoseOf:
    """Flange of a geometry, without its base and tool."""
    bare = replace(geometry, base=identity_pose(), tool=identity_pose())
    return lambda joints: forward(bare, joints)


def calibrated_flange(calibration: Calibration) -> PoseOf:
    """Flange that a calibration predicts, with its terms and residual, without the base and tool that it found."""
    base, tool = calibration.identified.base, calibration.identified.tool

    def flange(joints: Array) -> Pose:
        pose = calibration.predict(joints)
        rotation = pose.rotation @ tool.rotation.T
        position = pose.position - rotation @ tool.position
        return Pose((position - base.position) @ base.rotation, base.rotation.T @ rotation)

    return flange


def chain_of_origins(path: Path) -> PoseOf:
    """Flange of a kinematics file as ur_calibration writes it: each joint's origin, then a turn about its own z."""
    content = yaml_content(read_text(path, "a UR kinematics file (.yaml)"), path)
    links: Any = content["kinematics"]
    origins = [links[name] for name in ("shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3")]

    def flange(joints: Array) -> Pose:
        position, rotation = np.zeros((len(joints), 3)), np.broadcast_to(np.eye(3), (len(joints), 3, 3))
        for origin, angles in zip(origins, joints.T, strict=True):
            position = position + rotation @ np.array([origin[key] for key in "xyz"], dtype=float)
            placed = Rotation.from_euler("xyz", [float(origin[key]) for key in ("roll", "pitch", "yaw")])
            rotation = rotation @ placed.as_matrix() @ Rotation.from_euler("z", angles[:, None]).as_matrix()
        return Pose(position, rotation)

    return flange


def points_of(pose: Pose) -> Array:
    """The three points ``(N, 3, 3)`` at flange poses, m."""
    return np.asarray(pose.position[:, None, :] + POINTS @ np.swapaxes(pose.rotation, -1, -2))


def alignment_columns(pose: Pose) -> Array:
    """How base and tool move the points ``(9 N, 12)``, per m and rad: base along and about x, y, z, then the flange."""
    points = points_of(pose)
    unit = np.eye(3)
    base_turn = np.cross(unit[:, None, None, :], points[None])  # (3, N, 3, 3)
    base_move = np.broadcast_to(unit[:, None, None, :], base_turn.shape)
    tool_move = np.broadcast_to(np.moveaxis(pose.rotation, -1, 0)[:, :, None, :], base_turn.shape)
    turned = np.cross(unit[:, None, :], POINTS[None])  # (3, 3, 3): axis, point, in the flange's frame
    tool_turn = np.einsum("nij,apj->anpi", pose.rotation, turned)
    return np.concatenate([base_move, base_turn, tool_move, tool_turn]).reshape(12, -1).T


def aligned_errors(model: PoseOf, truth: PoseOf, joints: Array, iterations: int = 10) -> Array:
    """What the points still miss ``(N, 3, 3)``, m, after base and tool were fitted by least squares on these joints."""
    target, pose = points_of(truth(joints)), model(joints)
    for _ in range(iterations):
        miss = (target - points_of(pose)).reshape(-1)
        step = np.asarray(np.linalg.lstsq(alignment_columns(pose), miss, rcond=1e-10)[0], dtype=float)
        pose = _moved(pose, step)
        if np.abs(step).max() < 1e-12:
            break
    return np.asarray(target - points_of(pose))


def _moved(pose: Pose, step: Array) -> Pose:
    """Poses behind a moved base and with a moved flange."""
    base_turn, tool_turn = Rotation.from_rotvec(step[3:6]).as_matrix(), Rotation.from_rotvec(step[9:]).as_matrix()
    position = pose.position + pose.rotation @ step[6:9]
    return Pose(position @ base_turn.T + step[:3], base_turn @ pose.rotation @ tool_turn)


def rms(errors: Array) -> float:
    """Root mean square length of errors ``(..., 3)``, in their unit."""
    return float(np.sqrt(np.mean(np.sum(errors**2, axis=-1))))


def stated_radii(calibration: Calibration, joints: Array) -> Array | None:
    """What holds 95 of 100 errors by the calibration's own covariance ``(N,)``, m, of `aligned_errors` at these joints.

    The error of a pose is the RMS over its three points. Its square is a sum of nine squares that are not alike, so
    its distribution is taken as a chi-square of the same mean and variance (Satterthwaite). None without covariance.
    """
    sure = uncertainty_from(calibration.without_residual().record)
    if sure is None:
        return None
    model = calibration.model
    columns = [model.parameter_names.index(name) for name in sure.names]
    jacobian, flange = model.jacobian(joints)[..., columns], calibrated_flange(calibration)(joints)
    base = calibration.identified.base
    points = points_of(flange) @ base.rotation.T + base.position
    arms = points - model.pose(joints).position[:, None, :]  # (N, 3, 3): from the tool to the points, world axes
    turned = np.cross(np.swapaxes(jacobian[:, 3:], 1, 2)[:, :, None, :], arms[:, None])  # (N, p, 3, 3)
    moved = np.swapaxes(jacobian[:, :3], 1, 2)[:, :, None, :] + turned
    rows = np.moveaxis(moved, 1, -1).reshape(-1, len(columns))
    world = Pose(flange.position @ base.rotation.T + base.position, base.rotation @ flange.rotation)
    freedoms = np.linalg.svd(alignment_columns(world), full_matrices=False)
    kept = freedoms.U[:, freedoms.S / freedoms.S[0] > 1e-10]
    rest = (rows - kept @ (kept.T @ rows)).reshape(len(joints), 9, -1)
    covariance = rest @ sure.covariance @ np.swapaxes(rest, 1, 2) / len(POINTS)
    mean = np.trace(covariance, axis1=1, axis2=2)
    squares = np.sum(covariance * np.swapaxes(covariance, 1, 2), axis=(1, 2))
    freedom = np.divide(mean**2, squares, out=np.ones_like(mean), where=squares > 0)
    return np.asarray(np.sqrt(mean / freedom * chi2.ppf(0.95, freedom)))


def covered(calibration: Calibration, truth: PoseOf, joints: Array) -> float | None:
    """Share of the joint vectors whose true error is within what the calibration states for 95 of 100."""
    radii = stated_radii(calibration, joints)
    if radii is None:
        return None
    squares = np.sum(aligned_errors(calibrated_flange(calibration), truth, joints) ** 2, axis=-1)
    return float(np.mean(np.sqrt(np.mean(squares, axis=-1)) <= radii))


def regions(measured: Array, lower: Array, upper: Array, seed: int = 0) -> dict[str, Array]:
    """Joint vectors ``(N, n)`` of the four regions in which a calibration is judged."""
    rng = np.random.default_rng(seed)
    chosen = measured[rng.integers(len(measured), size=VECTORS)]
    beside = chosen + rng.normal(0.0, BESIDE, chosen.shape)
    box = rng.uniform(measured.min(axis=0), measured.max(axis=0), (VECTORS, measured.shape[1]))
    everywhere = rng.uniform(lower, upper, (VECTORS, measured.shape[1]))
    return {"at the poses": measured, "0.15 rad beside": beside, "box of ranges": box, "all joints": everywhere}
