"""Wires, bars, spheres, edges, planes, dials, touches, tilts: derivatives, and what each finds of arm and instrument.

The simulated readings come from points and directions written out here, not from the kinds' own predictions.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from pickenv.arm import Geometry, Pose, forward, load_arm, rotation_matrix
from pickenv.calibration import (
    DistanceObservations,
    ReflectorObservations,
    SocketObservations,
    TiltObservations,
    complete_model,
    identify,
    random_joints,
)
from pickenv.calibration.identification.rows import unknowns_of
from pickenv.calibration.model.arm_model import ArmModel
from pickenv.calibration.model.kinds.surfaces import steady_solution
from pickenv.calibration.model.observations import Observations

TIP = np.array([0.03, -0.02, 0.06])
ANCHOR, LINE_POINT, ALONG = np.array([0.5, -0.9, 0.3]), np.array([0.35, 0.2, 0.3]), np.array([0.6, -0.64, 0.48])
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


def from_line(points: np.ndarray) -> np.ndarray:
    return np.linalg.norm(np.cross(points - LINE_POINT, ALONG), axis=-1, keepdims=True)


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


def edge(geometry: Geometry, count: int, rng: np.random.Generator, noise: float = 0.0) -> DistanceObservations:
    """A ball of 20 mm radius on an edge."""
    joints = held(geometry, from_line, 0.02 + noise * STD * rng.normal(size=(count, 1)), rng)
    return DistanceObservations(joints, np.full(count, 0.02), STD, "line", tip=HERE, tip_std=2e-4, kind="edge")


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
    joints = held(geometry, lambda p: p, LINE_POINT + noise * STD * rng.normal(size=(count, 3)), rng)
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
    return ReflectorObservations(joints, points, seen, np.eye(3) * STD**2, places=stated, places_std=1e-4)


KINDS: dict[str, Callable[..., Observations]] = {
    "wire": wire,
    "bar": bar,
    "sphere": sphere,
    "edge": edge,
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


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("arm", ["qiao2026", "ur5"])
@pytest.mark.parametrize("seed", range(2))
def test_derivatives_are_differences(arm: str, kind: str, seed: int) -> None:
    """Of every equation by every parameter of a random arm and by every unknown, near and off the truth."""
    rng = np.random.default_rng(seed)
    nominal = load_arm(arm).nominal
    data = KINDS[kind](nominal, 9, rng)
    turned = Pose(rng.normal(size=3), rotation_matrix(rng.normal(size=3)))
    model = ArmModel.of(replace(nominal, base=turned)).displaced(rng.normal(size=len(nominal.parameter_names)) * 0.02)
    unknowns = data.start(ArmModel.of(nominal))
    unknowns = unknowns + rng.normal(size=len(unknowns)) * 0.1
    by_model, by_unknown = data.jacobian(model, unknowns)
    step = 1e-6

    def slope(moved: Callable[[float], np.ndarray]) -> np.ndarray:
        return (moved(-step) - moved(step)) / (2.0 * step)  # the residual is measured minus predicted

    for k, name in enumerate(model.parameter_names):
        one = np.eye(len(model.parameter_names))[k]
        found = slope(lambda s: data.residual(model.displaced(s * one), unknowns))  # noqa: B023
        np.testing.assert_allclose(found, by_model[:, k], atol=1e-6 * np.abs(by_model).max(), err_msg=name)
    for k, name in enumerate(data.unknowns()):
        one = np.eye(len(unknowns))[k]
        found = slope(lambda s: data.residual(model, unknowns + s * one))  # noqa: B023
        np.testing.assert_allclose(found, by_unknown[:, k], atol=1e-6 * np.abs(by_unknown).max(), err_msg=name)


DIRECTIONS = ("along", "normal")
"""What may come out the other way round where nothing tells its sense."""


def truth_of(data: Observations, names: tuple[str, ...]) -> dict[str, float]:
    """What was simulated, by the names of the unknowns."""
    foot = LINE_POINT - ALONG * (LINE_POINT @ ALONG)
    vectors = {"tip": TIP, "anchor": ANCHOR, "edge": foot, "along": ALONG, "normal": NORMAL, "point": LINE_POINT}
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


@pytest.fixture(scope="module")
def ur5() -> Geometry:
    return load_arm("ur5").nominal


def start_and_truth(kind: str, ur5: Geometry, count: int, rng: np.random.Generator) -> tuple[Geometry, Observations]:
    """A true arm that differs from UR5 where this kind can see it, and what is read on it."""
    kept = identify(complete_model(ur5), ur5, [KINDS[kind](ur5, count, rng)]).identifiability.kept_names
    true = ur5.displaced(np.array([1e-3 * rng.normal() if name in kept else 0.0 for name in ur5.parameter_names]))
    return true, KINDS[kind](true, count, rng, 1.0)


@pytest.mark.parametrize("kind", KINDS)
def test_arm_and_instrument_are_found_within_their_uncertainty(kind: str, ur5: Geometry) -> None:
    """All of them together: the squared distance from the truth follows chi^2, and so does what remains."""
    true, data = start_and_truth(kind, ur5, 120, np.random.default_rng(11))
    found = identify(complete_model(ur5), ur5, [data])
    assert found.converged
    kept = found.identifiability.kept_names
    values = dict(zip(ur5.parameter_names, ur5.difference(found.geometry), strict=True)) | found.unknowns
    truth = dict(zip(ur5.parameter_names, ur5.difference(true), strict=True))
    truth = other_way_round(found.unknowns, truth | truth_of(data, data.unknowns()))
    off = np.array([values[name] - truth[name] for name in kept])
    assert chi2.ppf(1e-4, len(kept)) < off @ np.linalg.solve(found.covariance, off) < chi2.ppf(1 - 1e-4, len(kept))
    freedom = found.degrees_of_freedom
    assert chi2.ppf(1e-4, freedom) < found.chi_square < chi2.ppf(1 - 1e-4, freedom)


@pytest.mark.parametrize("kind", KINDS)
def test_where_the_world_is_changes_nothing_that_is_found(kind: str, ur5: Geometry) -> None:
    """Started from an arm whose base stands elsewhere, upright where the world is level: same links, same misses."""
    _, data = start_and_truth(kind, ur5, 120, np.random.default_rng(12))
    turn = rotation_matrix(np.array([0.0, 0.0, 0.7] if data.framed else [0.3, -0.4, 0.7]))
    shift = np.array([0.4, -1.3, 0.6])
    moved = replace(ur5, base=Pose(turn @ ur5.base.position + shift, turn @ ur5.base.rotation))
    there = data
    if isinstance(data, ReflectorObservations):
        there = replace(data, points=data.points @ turn.T + shift)
    here, elsewhere = identify(complete_model(ur5), ur5, [data]), identify(complete_model(ur5), moved, [there])
    assert elsewhere.chi_square == pytest.approx(here.chi_square, rel=1e-6)
    links = slice(0, 5 * ur5.links)
    off = ur5.difference(here.geometry)[links] - moved.difference(elsewhere.geometry)[links]
    named = dict(zip(here.identifiability.names, here.standard_deviation, strict=True))
    std = np.array([named.get(name, np.nan) for name in ur5.parameter_names[links]])
    assert np.nanmax(np.abs(off) / np.where(np.isnan(std), 1e-6, std)) < 1e-2
    one, other = (f.arm_model for f in (here, elsewhere))
    np.testing.assert_allclose(
        np.linalg.norm(data.misses(one, unknowns_of(here, data)), axis=1),
        np.linalg.norm(there.misses(other, unknowns_of(elsewhere, there)), axis=1),
        atol=1e-8,
    )


@pytest.mark.parametrize("kind", KINDS)
def test_equations_are_counted_as_they_stand(kind: str, ur5: Geometry) -> None:
    """Whoever weighs rows needs to know whose each equation is; those of a chosen row are its own."""
    data = KINDS[kind](ur5, 12, np.random.default_rng(3), 1.0)
    model = ArmModel.of(ur5)
    unknowns = data.start(model)
    rows, channels = data.equations()
    whole = data.residual(model, unknowns)
    assert rows.shape == channels.shape == whole.shape
    kept = np.array([1, 4, 5, 9])
    some = data.select(kept)
    assert some.unknowns() == data.unknowns()
    for new, old in enumerate(kept):
        part = some.residual(model, unknowns)[some.equations()[0] == new]
        np.testing.assert_array_equal(part, whole[rows == old])


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "placed reflectors"])
def test_unknowns_start_near_the_truth_although_rows_are_gross(kind: str, ur5: Geometry) -> None:
    """With the true arm and its tool point, and three rows of forty far off: within a centimetre or a degree or so."""
    rng = np.random.default_rng(5)
    data = KINDS[kind](ur5, 40, rng, 1.0)
    bad = [3, 17, 30]
    if isinstance(data, DistanceObservations):
        data = replace(data, tip=HERE, tip_std=0.0, scale_std=0.0)
    elif isinstance(data, SocketObservations):
        data = replace(data, tip=HERE, tip_std=0.0)
    elif isinstance(data, TiltObservations):
        components = data.components.copy()
        components[bad] *= -1.0
        data = replace(data, components=components)
    joints = data.joints.copy()
    joints[bad, 1] += 0.2
    data = replace(data, joints=joints)
    start = dict(zip(data.unknowns(), data.start(ArmModel.of(ur5)), strict=True))
    truth = other_way_round(start, truth_of(data, data.unknowns()))
    for name, value in start.items():
        assert value == pytest.approx(truth[name], abs=0.03), name


def test_a_solution_of_least_absolute_errors_ignores_gross_rows() -> None:
    rng = np.random.default_rng(0)
    matrix, wanted = rng.normal(size=(60, 4)), rng.normal(size=4)
    right = matrix @ wanted + 1e-3 * rng.normal(size=60)
    right[::7] += 50.0
    found = steady_solution(matrix, right)
    np.testing.assert_allclose(found, wanted, atol=2e-3)
    least_squares = np.linalg.lstsq(matrix, right, rcond=None)[0]
    assert np.abs(least_squares - wanted).max() > 1.0


def twice_as_large(pose: Pose) -> Pose:
    return Pose(2.0 * pose.position, pose.rotation)


SIZED = {"wire": True, "bar": True, "sphere": False, "edge": True, "plane": False, "dial": True, "touches": False}


@pytest.mark.parametrize(("kind", "sized"), SIZED.items())
def test_an_arm_of_unknown_size_is_not_told_from_one_twice_as_large(kind: str, sized: bool, ur5: Geometry) -> None:
    """Unless a known length takes part: all misses double with the arm, its places and its tool point."""
    data = KINDS[kind](ur5, 20, np.random.default_rng(8))
    assert isinstance(data, DistanceObservations | SocketObservations)
    assert data.sized == sized
    large = replace(ur5, a=2 * ur5.a, d=2 * ur5.d, base=twice_as_large(ur5.base), tool=twice_as_large(ur5.tool))
    unknowns = data.start(ArmModel.of(ur5)) + 1e-3
    same = [name.startswith(("normal", "along", "scale")) for name in data.unknowns()]
    misses = data.misses(ArmModel.of(ur5), unknowns)
    tip = tuple(2.0 * np.array(data.tip))
    doubled = replace(data, tip=tip).misses(ArmModel.of(large), np.where(same, 1.0, 2.0) * unknowns)
    assert np.allclose(doubled, 2.0 * misses, rtol=1e-6, atol=1e-12) != sized


@pytest.mark.parametrize("kind", ["sphere", "plane", "touches"])
def test_where_no_length_is_known_one_link_is_held(kind: str, ur5: Geometry) -> None:
    found = identify(complete_model(ur5), ur5, [KINDS[kind](ur5, 60, np.random.default_rng(8), 1.0)])
    assert found.converged
    held = {item.name: item.absorbed_by for item in found.identifiability.dropped}
    assert held["a2"]["a3"] == pytest.approx(-ur5.a[3] / ur5.a[2])  # UR5's longest link is its upper arm


@pytest.mark.parametrize("kind", ["tilt of three", "tilt of one"])
def test_gravity_tells_no_length(kind: str, ur5: Geometry) -> None:
    data = KINDS[kind](ur5, 60, np.random.default_rng(8))
    assert not data.sized and data.miss_unit == "deg"
    found = identify(complete_model(ur5), ur5, [data])
    assert not {name for name in found.identifiability.kept_names if name[0] in "ad" and name[1].isdigit()}
