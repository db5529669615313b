"""Instruments of every kind on a simulated arm: what each reads, and what it is in truth.

The readings come from points and directions written out here, not from the kinds' own predictions.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from pickenv.arm import Geometry, forward, rotation_matrix
from pickenv.calibration import (
    DistanceObservations,
    Observations,
    ReflectorObservations,
    SocketObservations,
    TiltObservations,
    complete_model,
    identify,
    random_joints,
)

TIP = np.array([0.03, -0.02, 0.06])
ANCHOR, PLACE = np.array([0.5, -0.9, 0.3]), np.array([0.35, 0.2, 0.3])
NORMAL, OFFSET = np.array([0.36, 0.48, 0.8]), 0.3
DOWN = np.array([0.02, -0.01, -1.0]) / np.linalg.norm([0.02, -0.01, -1.0])
MOUNT = rotation_matrix(np.array([0.4, -0.3, 0.9]))
HERE = (0.03, -0.02, 0.06)
PLACES = np.array([[50.0, 0.0, 20.0], [-40.0, 60.0, 0.0], [-30.0, -50.0, 35.0]]) * 1e-3
STD, ANGLE_STD = 5e-5, 1e-4


def points_at(geometry: Geometry, joints: np.ndarray) -> np.ndarray:
    pose = forward(geometry, joints)
    return pose.position + pose.rotation @ TIP


def from_anchor(points: np.ndarray) -> np.ndarray:
    return np.linalg.norm(points - ANCHOR, axis=-1, keepdims=True)


def from_plane(points: np.ndarray) -> np.ndarray:
    return (points @ NORMAL - OFFSET)[:, None]


def held(
    geometry: Geometry, place: Callable[[np.ndarray], np.ndarray], wanted: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    """Joints ``(N, n)`` at which ``place`` of the tool point is as wanted ``(N, m)``: Newton steps from anywhere."""
    found = np.full((len(wanted), geometry.joints), np.nan)
    for _ in range(200):
        left = np.isnan(found[:, 0])
        if not left.any():
            return found
        q, target = random_joints(geometry, int(left.sum()), rng), wanted[left]
        for _ in range(15):
            now = place(points_at(geometry, q))
            steps = np.eye(geometry.joints) * 1e-7
            slope = np.stack([(place(points_at(geometry, q + s)) - now) / 1e-7 for s in steps], -1)
            q = q + np.clip(np.einsum("nij,nj->ni", np.linalg.pinv(slope, rcond=1e-3), target - now), -0.5, 0.5)
        good = np.abs(target - place(points_at(geometry, q))).max(axis=1) < 1e-9
        good &= np.all((q > geometry.lower - 1) & (q < geometry.upper + 1), axis=1)
        found[np.flatnonzero(left)[good]] = q[good]
    raise AssertionError("the arm does not reach the place")


def wire(geometry: Geometry, count: int, rng: np.random.Generator, noise: float = 0.0) -> DistanceObservations:
    """Zero 4 mm, scale 2 per mille, both to be found, and where it is hooked."""
    joints = random_joints(geometry, count, rng)
    length = from_anchor(points_at(geometry, joints))[:, 0] * 1.002 + 4e-3 + noise * STD * rng.normal(size=count)
    return DistanceObservations(joints, length, STD, zero_std=np.inf, scale_std=1e-3, tip_std=np.inf)


def bar(geometry: Geometry, count: int, rng: np.random.Generator, noise: float = 0.0) -> DistanceObservations:
    """A ball bar of 700 mm, whose length is known."""
    joints = held(geometry, from_anchor, 0.7 + noise * STD * rng.normal(size=(count, 1)), rng)
    return DistanceObservations(joints, np.full(count, 0.7), STD, tip=HERE, kind="bar")


def sphere(geometry: Geometry, count: int, rng: np.random.Generator, noise: float = 0.0) -> DistanceObservations:
    """A sphere of 700 mm, whose radius is to be found."""
    return replace(bar(geometry, count, rng, noise), length=np.zeros(count), zero_std=np.inf, kind="sphere")


def plane(geometry: Geometry, count: int, rng: np.random.Generator, noise: float = 0.0) -> DistanceObservations:
    joints = held(geometry, from_plane, noise * STD * rng.normal(size=(count, 1)), rng)
    return DistanceObservations(joints, np.zeros(count), STD, "plane", tip=HERE, kind="plane")


def dial(geometry: Geometry, count: int, rng: np.random.Generator, noise: float = 0.0) -> DistanceObservations:
    """Readings over 10 mm along the normal of a plane."""
    readings = rng.uniform(0.0, 0.01, (count, 1))
    joints = held(geometry, from_plane, readings + noise * STD * rng.normal(size=(count, 1)) - 0.1, rng)
    return DistanceObservations(joints, readings[:, 0], STD, "plane", tip=HERE, scale_std=1e-4, kind="dial")


def touches(geometry: Geometry, count: int, rng: np.random.Generator, noise: float = 0.0) -> SocketObservations:
    """One point of the tool, not known, in one place."""
    joints = held(geometry, lambda p: p, PLACE + noise * STD * rng.normal(size=(count, 3)), rng)
    none, socket = np.zeros((0, 2), dtype=np.int64), np.zeros(count, dtype=np.int64)
    return SocketObservations(joints, socket, none, np.zeros(0), STD, places=("point",), tip_std=np.inf)


def tilt(components: int, **known: float) -> Callable[..., TiltObservations]:
    def simulated(geometry: Geometry, count: int, rng: np.random.Generator, noise: float = 0.0) -> TiltObservations:
        joints = random_joints(geometry, count, rng)
        axes = np.eye(3) if known.get("axes_std") == 0.0 else MOUNT
        down = np.array([0.0, 0.0, -1.0]) if known.get("down_std") == 0.0 else DOWN
        local = np.swapaxes(forward(geometry, joints).rotation, 1, 2) @ down
        values = (local @ axes.T)[:, :components]
        values = values + noise * ANGLE_STD * rng.normal(size=values.shape)
        return TiltObservations(joints, values, np.full(values.shape, ANGLE_STD), **known)

    return simulated


def placed_reflectors(
    geometry: Geometry, count: int, rng: np.random.Generator, noise: float = 0.0
) -> ReflectorObservations:
    """Three reflectors whose places on the tool are known to 0.1 mm."""
    joints = random_joints(geometry, count, rng)
    pose = forward(geometry, joints)
    points = pose.position[:, None] + np.einsum("nij,kj->nki", pose.rotation, PLACES)
    points = points + noise * STD * rng.normal(size=points.shape)
    seen = rng.uniform(size=points.shape[:2]) > 0.2
    stated = PLACES + noise * 1e-4 * rng.normal(size=PLACES.shape)
    return ReflectorObservations(joints, points, seen, STD, places=stated, places_std=1e-4)


KINDS: dict[str, Callable[..., Observations]] = {
    "wire": wire,
    "bar": bar,
    "sphere": sphere,
    "plane": plane,
    "dial": dial,
    "touches": touches,
    "tilt of three": tilt(3),
    "tilt of two": tilt(2),
    "tilt of one": tilt(1),
    "tilt, mount known": tilt(2, axes_std=0.0),
    "tilt, level": tilt(3, down_std=0.0),
    "placed reflectors": placed_reflectors,
}


DIRECTIONS = ("normal",)
"""What may come out the other way round where nothing tells its sense."""


def truth_of(data: Observations, names: tuple[str, ...]) -> dict[str, float]:
    """What was simulated, by the names of the unknowns."""
    vectors = {"tip": TIP, "anchor": ANCHOR, "normal": NORMAL, "point": PLACE}
    vectors |= {"down": DOWN} | {f"axis{k + 1}": MOUNT[k] for k in range(3)}
    vectors |= {f"reflector{k + 1}": place for k, place in enumerate(PLACES)}
    parts = [(name, zip("xyz", vector, strict=True)) for name, vector in vectors.items()]
    found = {f"{name}_{axis}": float(value) for name, pairs in parts for axis, value in pairs}
    found |= {"zero": 4e-3, "scale": 2e-3, "plane_offset": OFFSET}
    if data.kind == "sphere":
        found["zero"] = -0.7
    if data.kind == "dial":
        found |= {"plane_offset": OFFSET - 0.1, "scale": 0.0}
    if isinstance(data, TiltObservations) and data.axes_std == 0.0:
        found |= {f"axis{k + 1}_{axis}": float(k == i) for k in range(3) for i, axis in enumerate("xyz")}
    return found


def other_way_round(found: dict[str, float], truth: dict[str, float]) -> dict[str, float]:
    """The truth with a direction, and what is counted along it, as the fit has them."""
    turned = dict(truth)
    for name in DIRECTIONS:
        parts = [f"{name}_{axis}" for axis in "xyz"]
        if parts[0] in found and sum(found[part] * truth[part] for part in parts) < 0.0:
            turned |= {part: -truth[part] for part in parts}
            turned["plane_offset"] = -truth["plane_offset"]
    return turned


def start_and_truth(kind: str, ur5: Geometry, count: int, rng: np.random.Generator) -> tuple[Geometry, Observations]:
    """A true arm that differs from UR5 where this kind can see it, and what is read on it."""
    kept = identify(complete_model(ur5), ur5, [KINDS[kind](ur5, count, rng)]).identifiability.kept_names
    true = ur5.displaced(np.array([1e-3 * rng.normal() if name in kept else 0.0 for name in ur5.parameter_names]))
    return true, KINDS[kind](true, count, rng, 1.0)
