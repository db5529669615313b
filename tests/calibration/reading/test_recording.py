"""Two logs, each with its own clock, give the rows that a person would have typed in, and say how sure they are."""

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

import pickenv
from pickenv.arm import Geometry, forward, load_arm, rotation_vector
from pickenv.base import InputError
from pickenv.calibration import Clocks, Observations, read_observations

TOML = """
[recording]
time = "t"
unit = "s"
joints = "{file}_joints.csv"
joints_time = "stamp"
joints_unit = "ms"

[joints]
columns = ["j1", "j2", "j3", "j4", "j5", "j6"]
unit = "rad"

"""
POSITION = '[position]\ncolumns = ["x", "y", "z"]\nunit = "mm"\nstd_mm = 0.03\n'
WIRE = '[wire]\ncolumns = ["length"]\nunit = "mm"\nstd_mm = 0.1\n'
ROTATION = '[rotation]\ncolumns = ["rx", "ry", "rz"]\nconvention = "rotation_vector"\nunit = "deg"\n'
UR5 = load_arm("ur5").nominal
TARGET, HOME = np.array([0.03, -0.02, 0.09]), np.array([0.0, -1.2, 1.2, 0.0, 0.9, 0.0])
NOISE, ENCODER = 2e-5, 2e-6


def moving(rng: np.random.Generator, seconds: float) -> CubicSpline:
    """Joints that never rest: a smooth way through random places, one a second."""
    count = int(seconds) + 12
    return CubicSpline(np.arange(count) - 5.0, rng.uniform(-0.9, 0.9, (count, 6)) + HOME)


def resting(rng: np.random.Generator, stops: int, seconds: float = 1.5) -> Callable[[np.ndarray], np.ndarray]:
    """Joints that rest at ``stops`` places for 1.5 s, and drive a second in between."""
    places = rng.uniform(-0.9, 0.9, (stops, 6)) + HOME
    period = seconds + 1.0

    def joints(times: np.ndarray) -> np.ndarray:
        stop = np.clip((times // period).astype(int), 0, stops - 1)
        share = np.clip(times - stop * period - seconds, 0.0, 1.0)
        smooth = share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
        here: np.ndarray = places[stop] + smooth[:, None] * (places[np.minimum(stop + 1, stops - 1)] - places[stop])
        return here

    return joints


def written(
    folder: Path,
    joints: Callable[[np.ndarray], np.ndarray],
    seconds: float,
    rng: np.random.Generator,
    *,
    geometry: Geometry,
    offset: float = 0.083,
    rate: float = 0.0,
    section: str = POSITION,
    hertz: float = 40.0,
) -> Path:
    """Write both logs of one motion; the instrument's clock is ``offset`` ahead in the middle, and faster by ``rate``.

    Returns:
        The instrument's file; its description is columns.toml beside it.
    """
    log = np.arange(0.0, seconds, 0.008)
    entries = joints(log) + ENCODER * rng.normal(size=(len(log), 6))
    names = "stamp,j1,j2,j3,j4,j5,j6"
    np.savetxt(folder / "tracker_joints.csv", np.c_[log * 1e3, entries], "%.9f", ",", header=names, comments="")
    seen = np.sort(rng.uniform(0.2, seconds - 0.2, int(seconds * hertz)))
    seen = seen[np.diff(seen, prepend=-1.0) > 1e-4]
    pose, middle = forward(geometry, joints(seen)), seconds / 2
    stamps = (seen - middle) * (1.0 + rate) + middle + offset
    point = pose.position + pose.rotation @ TARGET + NOISE * rng.normal(size=pose.position.shape)
    if section == WIRE:
        values, header = 1e3 * np.linalg.norm(point - [0.9, -0.9, 0.1], axis=1)[:, None], "t,length"
    else:
        values, header = 1e3 * point, "t,x,y,z"
    if ROTATION in section:
        values = np.c_[values, np.degrees(rotation_vector(pose.rotation) + 1e-4 * rng.normal(size=point.shape))]
        header += ",rx,ry,rz"
    np.savetxt(folder / "tracker.csv", np.c_[stamps, values], "%.9f", ",", header=header, comments="")
    (folder / "columns.toml").write_text(TOML + section, encoding="utf-8")
    return folder / "tracker.csv"


def read(file: Path) -> tuple[Observations, Clocks]:
    rows = read_observations([file], UR5, file.parent / "columns.toml")
    assert rows.origins is not None
    return rows, rows.origins.clocks[0]


def erring(rng: np.random.Generator) -> Geometry:
    """An arm that misses by millimetres, as real ones do."""
    lengths = ~UR5.parameter_is_angle
    return UR5.displaced(rng.normal(size=len(UR5.parameter_names)) * np.where(lengths, 5e-4, 1e-3))


@pytest.mark.parametrize(
    ("section", "offset"),
    [
        pytest.param(POSITION, 0.083, marks=pytest.mark.slow),
        (POSITION, -37.2),
        pytest.param(POSITION, 1.7e9, marks=pytest.mark.slow),
        pytest.param(POSITION + ROTATION, -37.2, marks=pytest.mark.slow),
        (WIRE, 1.7e9),
    ],
    ids=["position, 0.083", "position, -37.2", "position, 1.7e9", "pose, -37.2", "wire, 1.7e9"],
)
def test_the_offset_lies_within_its_uncertainty(tmp_path: Path, section: str, offset: float) -> None:
    rng = np.random.default_rng(3)
    file = written(tmp_path, moving(rng, 30.0), 30.0, rng, geometry=erring(rng), offset=offset, section=section)
    _, clocks = read(file)
    assert abs(clocks.offset - offset) < 4.0 * clocks.offset_std + 3e-7
    assert clocks.offset_std < 1e-3


def test_a_shifted_clock_shifts_the_offset_and_nothing_else(tmp_path: Path) -> None:
    read_at = []
    for offset in (0.0, 12.5):
        rng = np.random.default_rng(5)
        file = written(tmp_path, moving(rng, 30.0), 30.0, rng, geometry=UR5, offset=offset)
        read_at.append(read(file))
    (rows, clocks), (later, shifted) = read_at
    assert shifted.offset - clocks.offset == pytest.approx(12.5, abs=1e-7)
    np.testing.assert_allclose(later.joints, rows.joints, atol=1e-6)
    np.testing.assert_array_equal(later.readings(), rows.readings())


@pytest.mark.slow
def test_intervals_hold_of_offset_and_rate(tmp_path: Path) -> None:
    deviations = []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        rate = 5e-5 * rng.normal()
        file = written(tmp_path, moving(rng, 30.0), 30.0, rng, geometry=erring(rng), rate=rate, hertz=20.0)
        clocks = read(file)[1]
        assert clocks.rate_told
        here = 0.083 + rate * (clocks.moment - 0.083 - 15.0) / (1.0 + rate)
        deviations += [(clocks.offset - here) / clocks.offset_std, (clocks.rate - rate) / clocks.rate_std]
    size = np.abs(deviations)
    assert np.mean(size < 2.0) >= 0.8 and size.max() < 5.0
    assert size.max() > 0.5  # the uncertainties are not just large


@pytest.mark.slow
def test_rests_are_the_rows_that_a_person_would_write(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    true, way = erring(rng), resting(rng, 40)
    rows, clocks = read(written(tmp_path, way, 100.0, rng, geometry=true))
    assert clocks.still and clocks.rows == len(rows.joints) == 40
    places = way(np.arange(40) * 2.5 + 0.7)
    np.testing.assert_allclose(rows.joints, places, atol=6 * ENCODER)
    pose = forward(true, places)
    np.testing.assert_allclose(rows.readings(), pose.position + pose.rotation @ TARGET, atol=5 * NOISE)


@pytest.mark.slow
def test_motion_calibrates_about_as_well_as_rests(tmp_path: Path) -> None:
    ratios = []
    for seed in range(3):
        rng = np.random.default_rng(100 + seed)
        true, errors = erring(rng), {}
        targets = resting(rng, 100)(np.arange(100) * 2.5 + 0.5)
        pose = forward(true, targets)
        for name, way in (("rests", resting(rng, 40)), ("motion", moving(rng, 100.0))):
            file = written(tmp_path, way, 100.0, rng, geometry=true)
            choices = pickenv.Choices(terms="none", residual="none")
            result = pickenv.calibrate("ur5", file, columns=tmp_path / "columns.toml", choices=choices)
            assert result.clocks[0].still == (name == "rests")
            missed = result.calibration.model.pose(targets).position
            missed = missed - pose.position - pose.rotation @ TARGET
            errors[name] = float(np.sqrt(np.mean(np.sum(missed**2, axis=1))))
        ratios.append(errors["motion"] / errors["rests"])
    assert max(ratios) < 1.5


def changed(file: Path, row: int, column: int, text: str) -> None:
    lines = [line.split(",") for line in file.read_text(encoding="utf-8").splitlines()]
    lines[row - 1][column] = text
    file.write_text("\n".join(map(",".join, lines)) + "\n", encoding="utf-8")


@pytest.mark.parametrize(
    ("name", "row", "column", "text", "words"),
    [
        ("tracker.csv", 9, 0, "0.0", "tracker.csv: row 9, column 't' lies before the time above it"),
        ("tracker_joints.csv", 9, 0, "48.0", "tracker_joints.csv: row 9, column 'stamp' repeats the time before it"),
        ("tracker_joints.csv", 9, 0, "nan", "tracker_joints.csv: row 9, column 'stamp' is nan"),
        ("tracker_joints.csv", 9, 2, "3.3", "tracker_joints.csv: row 9, column 'j2' jumps by more than half a turn"),
    ],
)
def test_faults_are_named_by_file_and_row(
    tmp_path: Path, name: str, row: int, column: int, text: str, words: str
) -> None:
    rng = np.random.default_rng(2)
    file = written(tmp_path, moving(rng, 10.0), 10.0, rng, geometry=UR5)
    changed(tmp_path / name, row, column, text)
    with pytest.raises(InputError, match=re.escape(words)):
        read(file)


def test_lost_samples_are_left_out(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    file = written(tmp_path, moving(rng, 20.0), 20.0, rng, geometry=UR5)
    for row, text in ((30, ""), (31, "nan")):
        changed(file, row, 2, text)
    for column in (1, 2, 3):
        changed(file, 60, column, "0.0")
    rows, _ = read(file)
    assert rows.origins is not None and not set(rows.origins.line.tolist()) & {30, 31, 60}


def test_logs_that_tell_no_offset_are_refused(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    file = written(tmp_path, lambda times: np.tile(UR5.lower * 0.1, (len(times), 1)), 20.0, rng, geometry=UR5)
    with pytest.raises(InputError, match=r"tracker.csv: .*(nothing moves|at no offset)"):
        read(file)
    file = written(tmp_path, moving(rng, 20.0), 20.0, rng, geometry=UR5)
    readings = file.read_bytes()
    written(tmp_path, moving(rng, 20.0), 20.0, rng, geometry=UR5)
    file.write_bytes(readings)
    with pytest.raises(InputError, match=r"tracker.csv: (at no offset|at the best offset|two offsets)"):
        read(file)
    way = moving(rng, 5.0)
    file = written(tmp_path, lambda times: way(2.0 + np.sin(2.0 * times)), 30.0, rng, geometry=UR5)
    with pytest.raises(InputError, match="two offsets"):
        read(file)


def test_contacts_have_no_recording(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    file = written(tmp_path, moving(rng, 10.0), 10.0, rng, geometry=UR5, section="[touches]\n")
    with pytest.raises(InputError, match=re.escape("[recording] is not for [touches]")):
        read(file)


@pytest.mark.slow
def test_parquet_reads_as_csv(tmp_path: Path) -> None:
    pyarrow, parquet = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    rng = np.random.default_rng(2)
    file = written(tmp_path, moving(rng, 20.0), 20.0, rng, geometry=UR5)
    rows, clocks = read(file)
    names, *_ = file.read_text(encoding="utf-8").splitlines()
    columns = dict(zip(names.split(","), np.loadtxt(file, delimiter=",", skiprows=1).T, strict=True))
    parquet.write_table(pyarrow.table(columns), tmp_path / "tracker.parquet")
    again, same = read(tmp_path / "tracker.parquet")
    assert same.offset == clocks.offset
    np.testing.assert_array_equal(again.readings(), rows.readings())
    (tmp_path / "tracker.parquet").write_bytes(b"PAR1 is all there is")
    with pytest.raises(InputError, match="give a Parquet file"):
        read(tmp_path / "tracker.parquet")
