"""Wires, bars, spheres, planes, dials, touches, tilts: derivatives, and what each finds of arm and itself."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from pickenv.arm import Geometry, Pose, load_arm, rotation_matrix
from pickenv.calibration import (
    ArmModel,
    DistanceObservations,
    ReflectorObservations,
    SocketObservations,
    TiltObservations,
    complete_model,
    identify,
)
from pickenv.calibration.identification.least_squares import unknowns_of
from pickenv.calibration.model.kinds import SURFACES, steady_solution
from pickenv.calibration.model.observations import Stated
from tests.calibration.simulated_instruments import HERE, KINDS, other_way_round, start_and_truth, truth_of


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


@pytest.fixture(scope="module")
def ur5() -> Geometry:
    return load_arm("ur5").nominal


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
        assert value == pytest.approx(truth[name], abs=1e-3 if kind == "touches" else 0.03), name


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


SIZED = {"wire": True, "bar": True, "sphere": False, "plane": False, "dial": True, "touches": False}


@pytest.mark.parametrize(("kind", "sized"), SIZED.items())
def test_an_arm_of_unknown_size_is_not_told_from_one_twice_as_large(kind: str, sized: bool, ur5: Geometry) -> None:
    """Unless a known length takes part: all misses double with the arm, its places and its tool point."""
    data = KINDS[kind](ur5, 20, np.random.default_rng(8))
    assert isinstance(data, DistanceObservations | SocketObservations)
    assert data.sized == sized
    large = replace(ur5, a=2 * ur5.a, d=2 * ur5.d, base=twice_as_large(ur5.base), tool=twice_as_large(ur5.tool))
    unknowns = data.start(ArmModel.of(ur5)) + 1e-3
    same = [name.startswith(("normal", "scale")) for name in data.unknowns()]
    misses = data.misses(ArmModel.of(ur5), unknowns)
    tip = tuple(2.0 * np.array(data.tip))
    doubled = replace(data, tip=tip).misses(ArmModel.of(large), np.where(same, 1.0, 2.0) * unknowns)
    assert np.allclose(doubled, 2.0 * misses, rtol=1e-6, atol=1e-12) != sized


@pytest.mark.parametrize("kind", ["sphere", "plane", "touches"])
def test_where_no_length_is_known_one_link_is_held(kind: str, ur5: Geometry) -> None:
    found = identify(complete_model(ur5), ur5, [KINDS[kind](ur5, 60, np.random.default_rng(8), 1.0)])
    assert found.converged
    held = found.identifiability.dropped
    assert held["a2"]["a3"] == pytest.approx(-ur5.a[3] / ur5.a[2])  # UR5's longest link is its upper arm


@pytest.mark.parametrize("kind", ["tilt of three", "tilt of one"])
def test_gravity_tells_no_length(kind: str, ur5: Geometry) -> None:
    data = KINDS[kind](ur5, 60, np.random.default_rng(8))
    assert not data.sized and data.miss_unit == "deg"
    found = identify(complete_model(ur5), ur5, [data])
    assert not {name for name in found.identifiability.kept_names if name[0] in "ad" and name[1].isdigit()}


def test_what_is_known_of_a_number_is_one_equation_and_nothing_else_is() -> None:
    values, std = np.array([1.0, 2.0, 3.0, 4.0]), np.array([0.0, 0.5, np.inf, 0.1])
    numbers = Stated(("a", "b", "c", "d"), values, std, np.ones(4))
    assert numbers.unknowns() == ("b", "c", "d")
    np.testing.assert_array_equal(numbers.whole(np.array([7.0, 8.0, 9.0])), [1.0, 7.0, 8.0, 9.0])
    np.testing.assert_allclose(numbers.residual(np.array([3.0, 8.0, 4.2])), [-2.0, -2.0])
    np.testing.assert_allclose(numbers.jacobian(), [[2.0, 0.0, 0.0], [0.0, 0.0, 10.0]])


def test_a_tenth_of_the_points_elsewhere_does_not_turn_a_plane() -> None:
    """The others lie on it exactly, and so does what is found."""
    rng = np.random.default_rng(2)
    turn = rotation_matrix(rng.normal(size=3))
    local = rng.uniform(-0.5, 0.5, (80, 3)) * (1.0, 1.0, 0.0)
    local[::10] += [0.0, 0.3, 0.4]
    points = local @ turn.T + [0.3, -0.2, 0.6]
    values, _ = SURFACES["plane"].start(points, np.zeros(80), 0.0, False)
    near = 1e-9
    assert abs(values[:3] @ turn[:, 2]) == pytest.approx(1.0, abs=near**2)
    gaps = SURFACES["plane"].gap(values, points)[0]
    assert np.median(np.abs(gaps)) < near
