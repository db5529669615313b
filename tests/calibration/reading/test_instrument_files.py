"""Files of wires, bars, contacts and inclinometers: read as described, or refused in one sentence."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pickenv.arm import Geometry, forward, load_arm
from pickenv.base import InputError
from pickenv.calibration import (
    DistanceObservations,
    Observations,
    ReflectorObservations,
    SocketObservations,
    TiltObservations,
    random_joints,
    read_observations,
)

NAMES = ["A1", "A2", "A3", "A4", "A5", "A6"]
JOINTS = f'joints = {{ columns = {NAMES}, unit = "deg" }}\n'.replace("'", '"')
ANCHOR = np.array([1.0, 2.0, 0.5])

Reader = Callable[..., Observations]


@pytest.fixture(scope="module")
def ur5() -> Geometry:
    return load_arm("ur5").nominal


@pytest.fixture
def read(tmp_path: Path, ur5: Geometry) -> Reader:
    """``read(description, columns)``: joints of 30 poses, and these columns beside them."""

    def reader(description: str, joints: np.ndarray | None = None, **columns: Sequence[Any]) -> Observations:
        if joints is None:
            joints = random_joints(ur5, 30, np.random.default_rng(0))
        lines = [",".join([*NAMES, *columns])]
        lines += [
            ",".join(str(value) for value in (*np.degrees(q), *row))
            for q, row in zip(
                joints, zip(*columns.values(), strict=True) if columns else [()] * len(joints), strict=True
            )
        ]
        (tmp_path / "data.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
        (tmp_path / "mine.toml").write_text(JOINTS + description, encoding="utf-8")
        return read_observations([tmp_path / "data.csv"], ur5, tmp_path / "mine.toml")

    return reader


@pytest.fixture(scope="module")
def lengths(ur5: Geometry) -> np.ndarray:
    position = forward(ur5, random_joints(ur5, 30, np.random.default_rng(0))).position
    return np.asarray(np.linalg.norm(position - ANCHOR, axis=1))


def test_a_wire_says_what_of_it_is_known(read: Reader, lengths: np.ndarray) -> None:
    usual = read('wire = { columns = ["L"], unit = "mm", std_mm = 0.2 }', L=lengths * 1e3)
    assert isinstance(usual, DistanceObservations)
    np.testing.assert_allclose(usual.length, lengths)
    assert (usual.surface, usual.std, usual.zero_std, usual.scale_std) == ("point", pytest.approx(2e-4), np.inf, 0.0)
    assert usual.tip == (0.0, 0.0, 0.0) and usual.tip_std == 0.0
    said = 'zero = "known", zero_mm = 4.0, scale = "fitted", tool = "fitted", tool_mm = [10, -20, 30]'
    other = read(f'wire = {{ columns = ["L"], unit = "m", {said} }}', L=lengths)
    assert isinstance(other, DistanceObservations)
    assert (other.zero, other.zero_std, other.scale_std, other.tip_std) == (pytest.approx(4e-3), 0.0, np.inf, np.inf)
    np.testing.assert_allclose(other.tip, (0.01, -0.02, 0.03))
    near = read('wire = { columns = ["L"], unit = "m", tool_mm = [1, 2, 3], tool_std_mm = 0.5 }', L=lengths)
    assert isinstance(near, DistanceObservations) and near.tip_std == pytest.approx(5e-4)


@pytest.mark.parametrize(
    ("table", "surface", "reading", "zero_std"),
    [
        ("bar = { length_mm = 300 }", "point", 0.3, 0.0),
        ("bar = { length_mm = 300, length_std_mm = 0.05 }", "point", 0.3, 5e-5),
        ("bar = {}", "point", 0.0, np.inf),
        ("sphere = { radius_mm = 30 }", "point", 0.03, 0.0),
        ("sphere = {}", "point", 0.0, np.inf),
        ("plane = { std_mm = 0.05 }", "plane", 0.0, 0.0),
    ],
)
def test_what_merely_touches_has_no_column(
    read: Reader, table: str, surface: str, reading: float, zero_std: float
) -> None:
    data = read(table)
    assert isinstance(data, DistanceObservations)
    assert (data.surface, data.kind) == (surface, table.split()[0])
    np.testing.assert_allclose(data.length, reading)
    assert data.zero_std == pytest.approx(zero_std)
    assert data.sized == ("_mm = " in table and surface != "plane")


def test_a_dial_reads_along_a_plane(read: Reader) -> None:
    readings = np.linspace(0.1, 9.0, 30)
    data = read('dial = { columns = ["mm"], unit = "mm" }', mm=readings)
    assert isinstance(data, DistanceObservations) and data.surface == "plane" and data.kind == "dial"
    np.testing.assert_allclose(data.length, readings * 1e-3)


def test_touches_of_one_point_need_no_column(read: Reader) -> None:
    data = read('touches = { std_mm = 0.2, tool = "fitted", contact = "hit" }', hit=[1] * 30)
    assert isinstance(data, SocketObservations) and not data.sized
    assert data.unknowns() == ("point_x", "point_y", "point_z", "tip_x", "tip_y", "tip_z")
    assert data.std == pytest.approx(2e-4)


def test_sockets_are_called_by_their_numbers(read: Reader) -> None:
    data = read('sockets = { column = "hole" }', hole=[3 + i % 2 for i in range(30)])
    assert data.unknowns()[:4] == ("socket3_x", "socket3_y", "socket3_z", "socket4_x")


def test_reflectors_may_be_known_on_the_tool(read: Reader, ur5: Geometry) -> None:
    pose = forward(ur5, random_joints(ur5, 30, np.random.default_rng(0)))
    table = 'reflectors = { columns = ["x", "y", "z"], unit = "m", places_mm = [0, 0, 50], places_std_mm = 0.1 }'
    points = (pose.position + pose.rotation @ [0.0, 0.0, 0.05]).T
    data = read(table, x=points[0], y=points[1], z=points[2])
    assert isinstance(data, ReflectorObservations) and data.places is not None
    np.testing.assert_allclose(data.places, [[0.0, 0.0, 0.05]])
    assert data.places_std == pytest.approx(1e-4)


@pytest.mark.parametrize("unit", ["deg", "rad", "g"])
def test_inclinations_become_components_of_down(read: Reader, unit: str) -> None:
    angles = np.random.default_rng(1).uniform(-0.6, 0.6, (2, 30))
    written = {"deg": np.degrees(angles), "rad": angles, "g": np.sin(angles)}[unit]
    data = read(f'tilt = {{ columns = ["x", "y"], unit = "{unit}", std_deg = 0.01 }}', x=written[0], y=written[1])
    assert isinstance(data, TiltObservations)
    np.testing.assert_allclose(data.components, np.sin(angles.T), atol=1e-12)
    wanted = np.radians(0.01) * (1.0 if unit == "g" else np.cos(angles.T))
    np.testing.assert_allclose(data.std, np.broadcast_to(wanted, (30, 2)))


ONES = [1.0] * 30
BAD: dict[str, tuple[str, dict[str, Any], str]] = {
    "a touch without contact": (
        'touches = { contact = "hit" }',
        {"hit": [1, 1, 0, *[1] * 27]},
        r"row 4, column 'hit' says that nothing was touched; remove the row",
    ),
    "a contact left blank": (
        'plane = { contact = "hit" }',
        {"hit": [1, "", *[1] * 28]},
        r"row 3, column 'hit' says that nothing was touched",
    ),
    "a dial in the air": (
        'dial = { columns = ["mm"], unit = "mm" }',
        {"mm": [1.5, 2.5, 3.5, 0.0, *np.linspace(4, 5, 26)]},
        r"row 5: the dial reads 0 mm, as one that touches nothing; .*free_mm",
    ),
    "a dial in the air that reads otherwise": (
        'dial = { columns = ["mm"], unit = "mm", free_mm = -1.5 }',
        {"mm": [-1.5, 2.5, 3.5, 0.0, *np.linspace(4, 5, 26)]},
        r"row 2: the dial reads -1.5 mm",
    ),
    "a blank reading": (
        'dial = { columns = ["mm"], unit = "mm" }',
        {"mm": [1.5, "", *np.linspace(4, 5, 28)]},
        r"row 3, column 'mm' is empty",
    ),
    "a wire of no length": (
        'wire = { columns = ["L"], unit = "mm" }',
        {"L": [500.0, -3.0, *np.linspace(400, 500, 28)]},
        r"row 3: a length of -3 mm is not above zero",
    ),
    "a direction that is none": (
        'tilt = { columns = ["x", "y", "z"], unit = "g" }',
        {"x": [0.0] * 30, "y": [0.6] * 30, "z": [*[0.8] * 9, 0.9, *[0.8] * 20]},
        r"row 11: the components of down have length 1\.082, not 1; divide them by gravity",
    ),
    "an accelerometer in motion": (
        'tilt = { columns = ["x", "y", "z"], unit = "g" }',
        {"x": [0.0] * 30, "y": [0.6] * 30, "z": [*[0.8] * 9, 0.7, *[0.8] * 20]},
        r"row 11: the components of down have length 0\.922, not 1",
    ),
    "m/s^2 for g": (
        'tilt = { columns = ["x", "y"], unit = "g" }',
        {"x": [3.0] * 30, "y": [2.0] * 30},
        r"row 2: the components of down have length 3\.606",
    ),
    "an inclination beyond 90 deg": (
        'tilt = { columns = ["x"], unit = "rad" }',
        {"x": [30.0] * 30},
        r"row 2: an inclination of 1719 deg is beyond 90; correct the row, or the unit",
    ),
    "five components": ('tilt = { columns = ["a", "b", "c", "d"], unit = "g" }', {}, r"one to three columns"),
    "a tilt in mm": ('tilt = { columns = ["a"], unit = "mm" }', {}, r"unit of \[tilt\] is 'mm'; give one of deg"),
    "a column of a plane": ('plane = { columns = ["d"] }', {}, r"unknown key 'columns' in \[plane\]"),
    "places of other reflectors": (
        'reflectors = { columns = ["x", "y", "z"], unit = "mm", places_mm = [1, 2] }',
        {},
        r"places_mm of \[reflectors\] has 2 numbers for 3 columns",
    ),
    "a word for the zero": (
        'wire = { columns = ["L"], unit = "mm", zero = "free" }',
        {},
        r"zero of \[wire\] is 'free'; give one of known, fitted",
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_what_no_instrument_reads_is_refused_in_one_sentence(read: Reader, case: str) -> None:
    table, columns, said = BAD[case]
    with pytest.raises(InputError, match=said) as caught:
        read(table, **columns)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("written", "factor"), [("mm", 1.0), ("m", 1e3)])
def test_a_wire_in_another_unit_is_refused(read: Reader, lengths: np.ndarray, written: str, factor: float) -> None:
    other = {"mm": "m", "m": "mm"}[written]
    with pytest.raises(InputError, match=rf"lengths of .* {written} \(median\) fit no anchor, but as {other} they do"):
        read(f'wire = {{ columns = ["L"], unit = "{written}" }}', L=lengths * factor)


@pytest.mark.parametrize("table", ["touches = {}", "sphere = {}", 'sockets = { column = "hole" }'])
def test_touches_in_one_pose_are_refused(read: Reader, ur5: Geometry, table: str) -> None:
    rng = np.random.default_rng(0)
    joints = np.repeat(random_joints(ur5, 2, rng), 15, axis=0) + 1e-4 * rng.normal(size=(30, 6))
    columns = {"hole": [1] * 15 + [2] * 15} if "hole" in table else {}
    if not columns:
        joints = joints[:15]
    with pytest.raises(InputError, match=r"all 15 rows of one place are in one pose, to a degree; turn the tool"):
        read(table, joints=joints, **columns)


def test_touches_in_poses_near_each_other_are_read(read: Reader, ur5: Geometry) -> None:
    joints = random_joints(ur5, 1, np.random.default_rng(0)) + np.radians(np.linspace(0.0, 3.0, 15))[:, None]
    assert len(read("touches = {}", joints=joints).joints) == 15


def test_lengths_that_fit_no_anchor_in_any_unit_are_not_blamed_on_it(read: Reader) -> None:
    noise = np.random.default_rng(1).uniform(500.0, 1500.0, 30)
    assert len(read('wire = { columns = ["L"], unit = "mm" }', L=noise).joints) == 30


@pytest.mark.parametrize("count", [1, 3, 6])
def test_a_few_lengths_say_nothing_of_their_unit(read: Reader, ur5: Geometry, lengths: np.ndarray, count: int) -> None:
    joints = random_joints(ur5, 30, np.random.default_rng(0))[:count]
    assert len(read('wire = { columns = ["L"], unit = "mm" }', joints=joints, L=lengths[:count] * 1e3).joints) == count
