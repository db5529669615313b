"""Stations of one arm in one fit: derivatives, frames of their own, and what one instrument adds to another."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from pickenv.arm import Arm, Geometry, Pose, forward, load_arm, rotation_matrix
from pickenv.calibration import Measurements, random_joints
from pickenv.calibration.identification.starts import stations_of
from pickenv.calibration.model.arm_model import ArmModel
from pickenv.calibration.model.kinds.distances import DistanceObservations
from pickenv.calibration.model.observations import Observations
from pickenv.calibration.model.stacked import InstrumentStation, Stacked
from pickenv.calibration.pipeline.choices import Choices
from pickenv.calibration.pipeline.stages import calibrate
from pickenv.errors import InputError
from tests.calibration.simulated_instruments import touches

PLAIN = Choices(terms="none", residual="none")
ANCHOR = np.array([1.5, -2.0, 0.3])
FAR = Pose(np.array([3.0, -1.0, 0.5]), rotation_matrix(np.array([0.3, -0.2, 1.4])))
TARGET = Pose(np.array([0.03, -0.05, 0.08]), np.eye(3))


def bent(arm: Arm, seed: int = 0) -> Geometry:
    """An arm a millimetre and a milliradian off."""
    rng, nominal = np.random.default_rng(seed), arm.nominal
    off = rng.normal(size=5 * nominal.links + 12) * 1e-3
    off[-12:] = 0.0
    off[4 * nominal.links : 5 * nominal.links] = 0.0
    return nominal.displaced(off)


def tracked(
    geometry: Geometry, count: int, rng: np.random.Generator, base: Pose = FAR, tool: Pose = TARGET, noise: float = 5e-5
) -> Measurements:
    """Positions of a target on the tool, from a tracker anywhere."""
    joints = random_joints(geometry, count, rng)
    position = forward(replace(geometry, base=base, tool=tool), joints).position
    source = f"tracker {count}"
    moved = position + noise * rng.normal(size=position.shape)
    return Measurements(joints, moved, None, geometry.prismatic, position_std=noise, source=source)


def wired(geometry: Geometry, count: int, rng: np.random.Generator, noise: float = 1e-4) -> DistanceObservations:
    joints = random_joints(geometry, count, rng)
    length = np.linalg.norm(forward(geometry, joints).position - ANCHOR, axis=1)
    return DistanceObservations(joints, length + noise * rng.normal(size=count), noise, source="wire")


def touched(geometry: Geometry, count: int, rng: np.random.Generator) -> Observations:
    return touches(geometry, count, rng, 2.0)  # 0.1 mm


@pytest.fixture(scope="module")
def ur5() -> Arm:
    return load_arm("ur5")


@pytest.mark.parametrize("own", [(), ("base",), ("tool",), ("base", "tool")], ids="+".join)
def test_derivatives_are_the_residuals_differences(ur5: Arm, own: tuple[str, ...]) -> None:
    rng = np.random.default_rng(2)
    true = bent(ur5)
    frames = {name: {"base": FAR, "tool": TARGET}[name] for name in own}
    data = Stacked(
        (InstrumentStation(tracked(true, 5, rng)), InstrumentStation(wired(true, 4, rng), 2, **frames, scale=2.0))
    )
    model = ArmModel.of(true)
    unknowns = data.start(model)
    by_arm, by_own = data.jacobian(model, unknowns)
    step = 1e-6
    for column in range(by_arm.shape[1]):
        delta = np.zeros(by_arm.shape[1])
        delta[column] = step
        ahead, behind = (data.residual(model.displaced(sign * delta), unknowns) for sign in (1.0, -1.0))
        np.testing.assert_allclose(by_arm[:, column], (behind - ahead) / (2 * step), rtol=1e-5, atol=1e-2)
    for column, delta in enumerate(np.eye(len(unknowns)) * step):
        ahead, behind = data.residual(model, unknowns + delta), data.residual(model, unknowns - delta)
        np.testing.assert_allclose(by_own[:, column], (behind - ahead) / (2 * step), rtol=1e-5, atol=1e-2)
    assert len(data.unknowns()) == len(unknowns) == by_own.shape[1] == 3 + 6 * len(own)


def test_rows_of_stations_keep_their_places(ur5: Arm) -> None:
    rng = np.random.default_rng(0)
    first, second = tracked(ur5.nominal, 6, rng), wired(ur5.nominal, 5, rng)
    data = Stacked((InstrumentStation(first), InstrumentStation(second, 2)))
    np.testing.assert_array_equal(data.joints, np.concatenate([first.joints, second.joints]))
    assert (
        data.origins.place(7) == ("wire", 2)
        and data.kind == "position+distance"
        and data.source == "tracker 6 and 1 more"
    )
    rows, channels = data.equations()
    np.testing.assert_array_equal(rows, np.concatenate([np.repeat(np.arange(6), 3), np.arange(6, 11)]))
    np.testing.assert_array_equal(channels, np.repeat([0, 1], [18, 5]))
    np.testing.assert_array_equal(data.groups, np.repeat([0, 1], [6, 5]))
    some = data.select(np.array([1, 4, 8]))
    np.testing.assert_array_equal(some.joints, data.joints[[1, 4, 8]])
    np.testing.assert_array_equal(data.select(np.isin(np.arange(11), [1, 4, 8])).joints, some.joints)
    assert len(data.select(np.array([9, 10])).stations) == 1 and data.select(np.array([9])).unknowns() == (
        "anchor_x_2",
        "anchor_y_2",
        "anchor_z_2",
    )
    assert len(data.select(np.arange(0)).joints) == 0
    model = ArmModel.of(ur5.nominal)
    missed = data.misses(model, data.start(model))
    assert missed.shape == (11, 3) and not missed[6:, 1:].any()
    assert data.fingerprint() != some.fingerprint()


def calibrated(
    arm: Arm, data: Observations | list[Observations], judge: Measurements, stations: str | None = None
) -> float:
    """Error of the calibrated arm (mm RMS) as a far tracker sees it, that was not there for the fit."""
    found = calibrate(arm, data, stations=stations, choices=PLAIN).calibration.model
    return float(calibrate(replace(arm, nominal=found.geometry), judge, choices=PLAIN).position["nominal"].rms)


def test_a_second_station_has_a_base_and_a_tool_of_its_own(ur5: Arm) -> None:
    """Half of the rows are of another day, when tracker and target stood elsewhere."""
    rng = np.random.default_rng(4)
    true = bent(ur5)
    other = Pose(np.array([-1.0, 2.0, 0.1]), rotation_matrix(np.array([0.0, 0.1, -2.0])))
    tool = Pose(np.array([-0.02, 0.04, 0.12]), np.eye(3))
    days: list[Observations] = [tracked(true, 60, rng), tracked(true, 60, rng, other, tool)]
    found = calibrate(ur5, days, choices=PLAIN)
    assert found.position["geometric"].rms < 0.13 < 0.5 < found.position["nominal"].rms
    names = [row["name"] for row in found.parameters()]
    assert {"base_x", "base2_x", "tool2_z"} <= set(names)
    units = {row["name"]: row["unit"] for row in found.parameters()}
    assert units["base2_rz"] == "deg" and units["tool2_x"] == "mm"
    with pytest.raises(InputError, match="stations is 'both'; give none, base, tool, base,tool"):
        calibrate(ur5, days, stations="both", choices=PLAIN)


def test_tool_and_base_are_shared_where_asked(ur5: Arm) -> None:
    rng = np.random.default_rng(4)
    true = bent(ur5)
    data = stations_of(ur5, [tracked(true, 40, rng), tracked(true, 40, rng)], ())
    assert data.unknowns() == ()
    assert stations_of(ur5, [wired(true, 40, rng), tracked(true, 40, rng)], ("tool",)).unknowns()[:3] == (
        "anchor_x_2",
        "anchor_y_2",
        "anchor_z_2",
    )


@pytest.mark.parametrize("other", [wired, touched], ids=["wire", "touches"])
def test_two_instruments_are_better_than_either_alone(ur5: Arm, other: Callable[..., Observations]) -> None:
    """Few tracker positions, and a wire or touches of one point: mean and worst of three arms are nearer than alone."""
    alone, second, both = [], [], []
    for seed in range(3):
        rng = np.random.default_rng(10 + seed)
        true = bent(ur5, seed)
        judge = tracked(true, 300, rng, noise=1e-6)
        few, more = tracked(true, 16, rng, noise=2e-4), other(true, 120, rng)
        alone.append(calibrated(ur5, few, judge))
        second.append(calibrated(ur5, more, judge))
        both.append(calibrated(ur5, [few, more], judge))
    assert np.mean(both) < 0.8 * min(np.mean(alone), np.mean(second)) and max(both) < min(max(alone), max(second))
