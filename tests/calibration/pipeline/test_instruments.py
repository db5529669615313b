"""Wires, contacts and inclinometers all the way: verdict, units, rows left out; a draw wire as one was published."""

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from pickenv.arm import Arm, Geometry, Pose, forward, load_arm, load_plant, rotation_matrix
from pickenv.base import InputError
from pickenv.calibration import (
    ArmModel,
    Choices,
    DistanceObservations,
    ReflectorObservations,
    Result,
    SocketObservations,
    TiltObservations,
    calibrate,
    complete_model,
    frames_model,
    given_rows,
    identify,
    random_joints,
    simulated_tracker,
)
from pickenv.calibration.assessment.instrument import said_of_instruments, with_zeros_fitted
from pickenv.calibration.identification.robust import rough_start, stations_of
from pickenv.commands.corrections import write_run
from pickenv.inspect import drawings_of, read_run
from tests.calibration.simulated_instruments import (
    ANGLE_STD,
    HERE,
    KINDS,
    PLACE,
    STD,
    held,
    start_and_truth,
    touches,
    wire,
)

SEEDS = [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2))]
PLAIN = Choices(terms="none", residual="none")


@pytest.fixture(scope="module")
def arm() -> Arm:
    return load_arm("ur5")


def rms(errors: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.sum(errors**2, axis=1))))


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_is_calibrated_and_judged_by_one_call(arm: Arm, kind: str) -> None:
    """Held-out errors come down to the noise, in the unit of the kind, and no row is taken for a gross one."""
    _, data = start_and_truth(kind, arm.nominal, 200, np.random.default_rng(21))
    result = calibrate(arm, data, choices=PLAIN)
    assert result.quality.grade in ("good", "with care") and not result.left_out
    unit, scale = ("deg", np.degrees(1.0)) if kind.startswith("tilt") else ("mm", 1e3)
    assert result.miss_unit == unit
    noise = (ANGLE_STD if unit == "deg" else STD) * np.sqrt(result.errors["geometric"].shape[1])
    assert 0.75 * noise < rms(result.errors["geometric"]) < 1.3 * noise < 0.3 * rms(result.errors["nominal"])
    told = result.as_dict()["held_out"]
    assert told[f"best_rms_{unit}"] == pytest.approx(scale * rms(result.errors["geometric"]))
    assert f"RMS ({unit})" in str(result) and f"{told[f'best_rms_{unit}']:#.4g}" in str(result)
    assert result.calibration.record["held_out"][f"mean_{unit}"] == result.best.mean


UNSIZED = {"sphere": "longest link", "plane": "longest link", "touches": "longest link", "tilt of two": "all lengths"}


@pytest.mark.parametrize("kind", [*UNSIZED, "bar"])
def test_an_arm_of_unknown_size_is_said_to_be_one(arm: Arm, kind: str) -> None:
    _, data = start_and_truth(kind, arm.nominal, 80, np.random.default_rng(4))
    result = calibrate(arm, data, choices=PLAIN)
    said = [text for weight, text in result.quality.findings if weight == "caution"]
    assert any(UNSIZED.get(kind, "no such words") in text for text in said) == (kind in UNSIZED)
    assert kind not in UNSIZED or result.quality.grade == "with care"


@pytest.mark.slow
def test_an_inclinometer_says_nothing_of_positions(arm: Arm, tmp_path: Path) -> None:
    _, data = start_and_truth("tilt of two", arm.nominal, 80, np.random.default_rng(4))
    result = calibrate(arm, data, choices=PLAIN)
    assert result.base_frame is not None and result.as_dict()["base_frame"]["mean_ci95_mm"] is None
    assert "nor where its tool is" in result.report()
    assert result.uncertainty.position_repeat == 0.0
    assert result.uncertainty.attitude_repeat == pytest.approx(np.sqrt(np.mean(result.errors["geometric"] ** 2)))
    page = result.write_page(tmp_path / "tilt.html").read_text(encoding="utf-8")
    assert "mean angular error" in page and "mean position error" not in page
    write_run(tmp_path / "run", "pickenv calibrate tilt.csv", 0, result, {})
    drawn = {drawing.name for drawing in drawings_of(read_run(tmp_path / "run")) if drawing.draw is not None}
    assert "joint_coverage" in drawn and not any(name.startswith(("error_", "least_squares")) for name in drawn)


def test_a_row_far_from_what_was_touched_is_left_out_by_name(arm: Arm) -> None:
    """A touch that missed by 30 mm, in one of eighty rows."""
    _, data = start_and_truth("plane", arm.nominal, 80, np.random.default_rng(6))
    joints = data.joints.copy()
    joints[7, 1] += 0.06
    result = calibrate(arm, replace(data, joints=joints), choices=PLAIN)
    assert [item.line for item in result.left_out] == [8]
    assert "row 8" in str(result)


@pytest.mark.parametrize("kind", KINDS)
def test_gross_rows_of_every_kind_are_left_out_and_no_others(arm: Arm, kind: str) -> None:
    """Four rows of 160 are off by what a slip of the hand makes: 50 mm of reading, 3 deg of a joint, 6 deg of tilt."""
    _, data = start_and_truth(kind, arm.nominal, 160, np.random.default_rng(31))
    bad = np.array([5, 50, 90, 130])
    if isinstance(data, DistanceObservations) and np.ptp(data.length) > 0.0:
        length = data.length.copy()
        length[bad] += [0.05, -0.05, 0.05, -0.05]
        data = replace(data, length=length)
    elif isinstance(data, TiltObservations):
        components = data.components.copy()
        components[bad] += 0.1
        data = replace(data, components=components)
    else:
        joints = data.joints.copy()
        joints[bad, 1] += 0.05
        data = replace(data, joints=joints)
    result = calibrate(arm, data, choices=PLAIN)
    assert {item.line - 1 for item in result.left_out} == set(bad.tolist())
    noise = ANGLE_STD if result.miss_unit == "deg" else STD
    assert rms(result.errors["geometric"]) < 1.4 * noise * np.sqrt(result.errors["geometric"].shape[1])


def test_reflectors_of_known_places_find_a_tool_that_is_turned(arm: Arm) -> None:
    """Their plate sits on the flange as it was screwed on: turned by 150 deg, 80 mm away."""
    turned = Pose(np.array([0.05, -0.04, 0.11]), rotation_matrix(np.array([1.5, -2.0, 0.7])))
    true = replace(arm.nominal, tool=turned)
    data = KINDS["placed reflectors"](true, 60, np.random.default_rng(14), 1.0)
    result = calibrate(arm, data, choices=PLAIN)
    tool = result.geometric.calibration.nominal.tool
    np.testing.assert_allclose(tool.position, turned.position, atol=5e-4)
    np.testing.assert_allclose(tool.rotation, turned.rotation, atol=5e-3)


def test_reflectors_that_do_not_fit_the_arm_are_refused_with_the_one_tried(arm: Arm) -> None:
    """The one seen most often is tried alone; joints in another order of rows fit no place of it."""
    data = KINDS["placed reflectors"](arm.nominal, 60, np.random.default_rng(16), 1.0)
    most = int(np.argmax(np.sum(data.seen, axis=0))) + 1
    with pytest.raises(InputError, match=f"after fitting base and reflector {most} the arm still misses"):
        rough_start(arm.nominal, replace(data, joints=data.joints[::-1]))


def test_reflectors_of_known_places_start_base_and_tool_where_they_are_seen(arm: Arm) -> None:
    """A tool mounted turned and a decimetre aside of its place, on a base elsewhere; without noise."""
    tool = Pose(arm.nominal.tool.position + np.array([0.1, -0.05, 0.08]), rotation_matrix([0.9, -0.4, 0.7]))
    base = Pose(np.array([1.0, -2.0, 0.5]), rotation_matrix([0.1, 0.2, 2.0]))
    data = KINDS["placed reflectors"](replace(arm.nominal, base=base, tool=tool), 40, np.random.default_rng(5), 0.0)
    found = rough_start(arm.nominal, data)
    for start, true in ((found.tool, tool), (found.base, base)):
        np.testing.assert_allclose(start.position, true.position, atol=1e-6)
        np.testing.assert_allclose(start.rotation, true.rotation, atol=1e-6)


@pytest.mark.parametrize("known", [0, 1, 2])
def test_fewer_than_three_known_places_say_nothing_of_how_the_tool_is_turned(arm: Arm, known: int) -> None:
    """The base is found by the reflector that is seen most often, whose place the tool then is."""
    base = Pose(np.array([1.0, -2.0, 0.5]), rotation_matrix([0.1, 0.2, 2.0]))
    data = KINDS["placed reflectors"](replace(arm.nominal, base=base), 40, np.random.default_rng(5), 0.0)
    assert data.places is not None
    if known:
        data = replace(data, points=data.points[:, :known], seen=data.seen[:, :known], places=data.places[:known])
    else:
        data = replace(data, places=None)
    found = rough_start(arm.nominal, data)
    np.testing.assert_allclose(found.base.rotation, base.rotation, atol=1e-6)
    np.testing.assert_array_equal(found.tool.rotation, arm.nominal.tool.rotation)


def test_several_column_descriptions_are_one_for_each_file(arm: Arm) -> None:
    for count in (2, 4):
        with pytest.raises(InputError, match=f"{count} column descriptions are given for 3 files; give one, or one"):
            given_rows(arm, ["a.csv", "b.csv", "c.csv"], ["ur5_jacobi2025"] * count)


def test_a_socket_that_was_never_fitted_cannot_be_judged(arm: Arm) -> None:
    data = touches(arm.nominal, 40, np.random.default_rng(7), 1.0)
    there = held(arm.nominal, lambda p: p, np.tile(PLACE + 0.1, (8, 1)), np.random.default_rng(8))
    other = replace(data, joints=there, socket=np.zeros(8, dtype=np.int64), places=("socket9",), source="new.csv")
    with pytest.raises(InputError, match=r"new\.csv: socket9 occurs in no row that was fitted; give rows of it"):
        calibrate(arm, data, test=other, choices=PLAIN)


@pytest.mark.parametrize("kind", ["wire", "plane"])
def test_too_few_rows_are_refused_with_their_number(arm: Arm, kind: str) -> None:
    data = KINDS[kind](arm.nominal, 6, np.random.default_rng(9), 1.0)
    with pytest.raises(InputError, match=r"\d poses give \d+ equations, too few for the \d+ parameters"):
        calibrate(arm, data, test=KINDS[kind](arm.nominal, 6, np.random.default_rng(10), 1.0), choices=PLAIN)


@pytest.mark.parametrize(("kind", "count"), [("wire", 12), ("plane", 8), ("touches", 6), ("tilt of two", 8)])
def test_a_few_rows_of_an_arm_that_is_its_drawing_are_said_to_be_too_few(arm: Arm, kind: str, count: int) -> None:
    """Enough for the frames, and the priors bear the rest: the fit is made, and the verdict keeps the drawing."""
    train, test = (KINDS[kind](arm.nominal, rows, np.random.default_rng(9 + rows), 1.0) for rows in (count, 30))
    quality = calibrate(arm, train, test=test, choices=PLAIN).quality
    assert quality.grade == "do not use"
    assert "the rows are too few to say more than the drawing; measure more" in quality.reason


def test_touches_of_one_point_and_a_wire_are_one_fit(arm: Arm) -> None:
    """The wire knows lengths, the touches know all three directions: no caution about size is left."""
    rng = np.random.default_rng(12)
    true, point = start_and_truth("touches", arm.nominal, 60, rng)
    length = wire(true, 60, rng, 1.0)
    together = calibrate(arm, [replace(length, scale_std=0.0), point], choices=PLAIN)
    assert together.train.sized and together.miss_unit == "mm"
    assert not any("known length" in text for _, text in together.quality.findings)


@pytest.mark.parametrize("seed", range(4))
def test_a_zero_that_is_what_it_is_said_to_be_raises_no_alarm(arm: Arm, seed: int) -> None:
    rng = np.random.default_rng(seed)
    data = wire(arm.nominal, 120, rng, 1.0)
    exact = replace(data, length=data.length / 1.002, zero=4e-3 / 1.002, zero_std=0.0, scale_std=0.0, tip=HERE)
    (name, _, other), *more = with_zeros_fitted(exact)
    assert name == "zero" and not more and other.unknowns()[3] == "zero"
    result = calibrate(arm, exact, choices=PLAIN)
    assert not any("zero" in text for _, text in result.quality.findings)


def test_a_wrong_zero_is_found_in_one_of_two_instruments(arm: Arm) -> None:
    rng = np.random.default_rng(3)
    true, point = start_and_truth("touches", arm.nominal, 60, rng)
    assert isinstance(point, SocketObservations)
    length = replace(wire(true, 120, rng, 1.0), scale_std=0.0, zero_std=0.0)
    ((name, _, _),) = with_zeros_fitted(stations_of(arm, [point, length], ("tool",)))
    assert name == "zero_2"
    result = calibrate(arm, [point, length], choices=PLAIN)
    assert result.quality.grade == "do not use" and "the wire's zero is taken as 0 mm" in result.quality.reason


@pytest.mark.parametrize(("rows", "off", "alarmed"), [(300, 12.0, True), (60, 3.0, False), (2000, 7.0, False)])
def test_an_alarm_needs_a_zero_that_is_surely_off_and_matters(arm: Arm, rows: int, off: float, alarmed: bool) -> None:
    """So many standard deviations off: surely, and 18 % of what is left; not surely; surely, but 1 % of it."""
    data = replace(wire(arm.nominal, rows, np.random.default_rng(15), 1.0), scale_std=0.0, tip=HERE, tip_std=0.0)
    data = replace(data, length=data.length / 1.002)
    model = frames_model(arm.nominal)
    freed = identify(model, arm.nominal, [data])
    std = freed.standard_deviation[freed.identifiability.names.index("zero")]
    stated = replace(data, zero=freed.unknowns["zero"] - off * std, zero_std=0.0)
    said = said_of_instruments(model, identify(model, arm.nominal, [stated]), stated)
    assert any(weight == "fail" for weight, _ in said) == alarmed


def test_a_zero_beside_a_fitted_scale_is_not_tried() -> None:
    data = DistanceObservations(np.zeros((3, 6)), np.array([1.0, 2.0, 3.0]), STD, scale_std=1e-3)
    assert not list(with_zeros_fitted(data))
    assert list(with_zeros_fitted(replace(data, scale_std=0.0)))


def test_directions_of_another_arm_are_refused_in_degrees(arm: Arm) -> None:
    """Readings in the wrong order belong to no pose."""
    data = KINDS["tilt of two"](arm.nominal, 60, np.random.default_rng(16), 1.0)
    assert isinstance(data, TiltObservations)
    mixed = replace(data, components=np.roll(data.components, 7, axis=0))
    with pytest.raises(InputError, match=r"after fitting the frames the arm still misses by \d+ deg RMS"):
        calibrate(arm, mixed, choices=PLAIN)


@pytest.mark.parametrize(("surface", "known"), [("plane", 0.0), ("point", np.inf)])
def test_what_has_no_zero_of_its_own_is_not_tried(surface: str, known: float) -> None:
    data = DistanceObservations(np.zeros((3, 6)), np.array([1.0, 2.0, 3.0]), STD, surface, zero_std=known)
    assert not list(with_zeros_fitted(data))
    kept = replace(data, length=np.ones(3), surface="point", zero_std=0.0)
    assert not list(with_zeros_fitted(kept))  # a bar's length and its zero are one number


SEEN_BY_A_WIRE = (
    *("alpha1", "alpha2", "alpha3", "alpha4", "alpha5", "a1", "a2", "a3", "a4", "a5", "d2"),
    *("d5", "theta2", "theta3", "theta4", "theta5", "beta2", "beta3"),
)
"""What of a UR5 one length sees; the rest is the same arm written otherwise, and stays nominal in the true one."""

WIRE_ANCHOR, WIRE_ZERO = np.array([1.1, -0.9, 0.4]), 4e-3


def published_wire(arm: Arm, seed: int) -> tuple[Geometry, DistanceObservations, np.ndarray]:
    """A true arm, 1000 rows in 40 sweeps, and which of them are gross (3 %, 20 to 200 mm off either way).

    Links are off by 1 mm and 0.3 deg, joints are rounded to 0.1 deg, the wire has 0.2 mm noise and a zero of 4 mm.
    """
    rng, nominal, rows, each = np.random.default_rng(seed), arm.nominal, 1000, 25
    sizes = np.where(nominal.parameter_is_angle, np.radians(0.3), 1e-3)
    seen = np.isin(nominal.parameter_names, SEEN_BY_A_WIRE)
    true = nominal.displaced(np.where(seen, sizes * rng.normal(size=len(sizes)), 0.0))
    low, high = np.maximum(nominal.lower, -2.5), np.minimum(nominal.upper, 2.5)
    ends = rng.uniform(low, high, (rows // each + 1, nominal.joints))
    part = (np.arange(each) / each)[:, None]
    joints = np.concatenate([a + part * (b - a) for a, b in pairwise(ends)])
    pose = forward(true, joints)
    length = np.linalg.norm(pose.position + pose.rotation @ np.array(HERE) - WIRE_ANCHOR, axis=1)
    length = length + WIRE_ZERO + 2e-4 * rng.normal(size=rows)
    gross = rng.uniform(size=rows) < 0.03
    length = length + gross * rng.choice([-1.0, 1.0], rows) * rng.uniform(0.02, 0.2, rows)
    step = np.radians(0.1)
    rounded = np.round(joints / step) * step
    return true, DistanceObservations(rounded, length, 2e-4, zero_std=np.inf, tip_std=np.inf), gross


def judged_by_blocks(arm: Arm, data: DistanceObservations) -> Result:
    return calibrate(arm, data, split="blocked", choices=PLAIN)


@pytest.mark.slow
@pytest.mark.parametrize("seed", SEEDS)
def test_a_draw_wire_as_published_finds_the_arm(arm: Arm, seed: int) -> None:
    """Blocked held-out errors are those of the true parameters, which rounded joints make larger than the noise."""
    true, data, gross = published_wire(arm, seed)
    result = judged_by_blocks(arm, data)
    assert {item.line - 1 for item in result.left_out} == set(np.flatnonzero(gross).tolist())
    truth = np.concatenate([WIRE_ANCHOR, [WIRE_ZERO], HERE])
    best = data.select(np.flatnonzero(~gross)).misses(ArmModel.of(true), truth)
    assert result.best.rms <= 1.1 * 1e3 * rms(best)
    assert result.quality.grade == "good"
    found = result.geometric.identification
    assert set(SEEN_BY_A_WIRE) < set(found.identifiability.kept_names)
    values = dict(zip(true.parameter_names, true.difference(found.geometry), strict=True))
    values |= {name: found.unknowns[name] - value for name, value in zip(data.unknowns(), truth, strict=True)}
    kept = found.identifiability.kept_names
    z = np.array([values[name] for name in kept]) / np.sqrt(np.diag(found.covariance))
    assert np.abs(z).max() < 4.0, dict(zip(kept, z.round(2), strict=True))


@pytest.mark.parametrize("seed", SEEDS)
def test_without_its_zero_the_verdict_on_a_draw_wire_is_do_not_use(arm: Arm, seed: int) -> None:
    _, data, _ = published_wire(arm, seed)
    result = calibrate(arm, replace(data, zero_std=0.0), choices=PLAIN)
    assert result.quality.grade == "do not use"
    assert 'say zero = "fitted" in [wire]' in result.quality.reason


def test_the_simulated_wire_sees_what_it_is_said_to_see(arm: Arm) -> None:
    """The list above is what the arm and its poses make of it, and no choice."""
    joints = random_joints(arm.nominal, 200, np.random.default_rng(0))
    data = DistanceObservations(joints, np.ones(200), 2e-4, zero_std=np.inf, tip_std=np.inf)
    pose = forward(arm.nominal, joints)
    length = np.linalg.norm(pose.position + pose.rotation @ np.array(HERE) - WIRE_ANCHOR, axis=1)
    found = identify(complete_model(arm.nominal), arm.nominal, [replace(data, length=length)])
    assert {name for name in found.identifiability.kept_names if name in arm.nominal.parameter_names} == set(
        SEEN_BY_A_WIRE
    )


@pytest.mark.parametrize("held_out", [7, 20])
def test_reflectors_of_one_row_are_not_rows(held_out: int) -> None:
    plant = load_plant("qiao2026")

    def seen(count: int, seed: int) -> ReflectorObservations:
        rng = np.random.default_rng(seed)
        data = simulated_tracker(plant, random_joints(plant.arm.nominal, count, rng), rng)
        points = data.position[:, None] + np.einsum("nij,kj->nki", data.rotation, np.eye(3) * 0.05)
        return ReflectorObservations(data.joints, points, np.ones((count, 3), dtype=bool), 2e-5)

    choices = Choices(terms="none", residual="none")
    result = calibrate(plant.arm, seen(60, 0), test=seen(held_out, 1), choices=choices)
    assert result.best.count == 3 * held_out
    if held_out == 7:
        assert result.best.mean_ci95 is None
        assert result.held_out.no_interval == "no interval: 7 rows are fewer than 20"
    else:  # the three errors of a row are alike, so the interval is that of 20 means
        alone = 1e3 * np.linalg.norm(list(result.errors.values())[-1], axis=1)
        low, high = result.best.mean_ci95
        assert high - low > 2 * 1.96 * 0.9 * alone.reshape(20, 3).mean(axis=1).std(ddof=1) / np.sqrt(20)
