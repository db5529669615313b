"""Two logs, each with its own clock, give the rows that a person would have typed in, and say how sure they are."""

import re
from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

import pickenv
from pickenv.arm import Geometry, forward, load_arm, rotation_vector
from pickenv.base import InputError
from pickenv.calibration import read_observations
from pickenv.calibration.model.observations import Clocks, Observations

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
NOISE, ENCODER = 2e-5, 2e-6


def moving(rng: np.random.Generator, seconds: float) -> CubicSpline:
    """Joints that never rest: a smooth way through random places, one a second."""
    count = int(seconds) + 12
    return CubicSpline(np.arange(count) - 5.0, rng.uniform(-0.9, 0.9, (count, 6)) + [0.0, -1.2, 1.2, 0.0, 0.9, 0.0])


def resting(rng: np.random.Generator, stops: int, seconds: float = 1.5) -> CubicSpline:
    """Joints that rest at ``stops`` places for 1.5 s, and drive a second in between."""
    places = rng.uniform(-0.9, 0.9, (stops, 6)) + [0.0, -1.2, 1.2, 0.0, 0.9, 0.0]
    period = seconds + 1.0

    def joints(times: np.ndarray) -> np.ndarray:
        stop = np.clip((times // period).astype(int), 0, stops - 1)
        share = np.clip(times - stop * period - seconds, 0.0, 1.0)
        smooth = share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
        return places[stop] + smooth[:, None] * (places[np.minimum(stop + 1, stops - 1)] - places[stop])

    return joints  # type: ignore[return-value]


def written(
    folder: Path,
    joints: CubicSpline,
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
    point = pose.position + pose.rotation @ [0.03, -0.02, 0.09] + NOISE * rng.normal(size=pose.position.shape)
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
    rows = read_observations([file], UR5, file.parent / "columns.toml").observations
    assert rows.origins is not None
    return rows, rows.origins.clocks[0]


def erring(rng: np.random.Generator) -> Geometry:
    """An arm that misses by millimetres, as real ones do."""
    lengths = ~UR5.parameter_is_angle
    return UR5.displaced(rng.normal(size=len(UR5.parameter_names)) * np.where(lengths, 5e-4, 1e-3))


@pytest.mark.parametrize("section", [POSITION, POSITION + ROTATION, WIRE], ids=["position", "pose", "wire"])
@pytest.mark.parametrize("offset", [0.083, -37.2, 1.7e9])
def test_the_offset_lies_within_its_uncertainty(
    tmp_path: Path, section: str, offset: float
) -> None:
    rng = np.random.default_rng(3)
    file = written(tmp_path, moving(rng, 60.0), 60.0, rng, geometry=erring(rng), offset=offset, section=section)
    _, clocks = read(file)
    assert abs(clocks.offset - offset) < 4.0 * clocks.offset_std + 3e-7
    assert clocks.offset_std < 1e-3
