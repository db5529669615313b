"""Every bad measurement file gets one sentence that names the file, and the row, column or unit at fault."""

import csv

import numpy as np
import pytest

from pickenv.arm import load_plant
from pickenv.base import InputError
from pickenv.calibration import fit, random_joints, read_measurements, read_observations, simulated_tracker

COLUMNS = [
    "q1_deg",
    "q2_mm",
    "q3_mm",
    "q4_deg",
    "q5_mm",
    "q6_deg",
    "x_mm",
    "y_mm",
    "z_mm",
    "rx_deg",
    "ry_deg",
    "rz_deg",
]


@pytest.fixture(scope="module")
def table(table_1):
    """Sixty good poses: header and rows of text."""
    rng = np.random.default_rng(0)
    names, values = simulated_tracker(table_1, random_joints(table_1.geometry, 60, rng), rng).table()
    assert names == COLUMNS
    return [names, *([repr(v) for v in row] for row in values.tolist())]


def cell(row, column, text):
    def spoil(table):
        table[row - 1][COLUMNS.index(column)] = text
        return table

    return spoil


def renamed(old, new):
    return lambda table: [[name.replace(old, new) for name in table[0]], *table[1:]]


def without(column):
    return lambda table: [[c for i, c in enumerate(row) if i != COLUMNS.index(column)] for row in table]


def scaled(ending, factor):
    """Values in another unit under the same name."""
    at = [i for i, name in enumerate(COLUMNS) if name.endswith(ending) and not (ending == "_deg" and name[0] == "r")]
    return lambda table: [
        table[0],
        *([repr(float(c) * factor) if i in at else c for i, c in enumerate(r)] for r in table[1:]),
    ]


READING = {
    "empty": (lambda t: [], r"is empty"),
    "blank lines only": (lambda t: [[""], [" ", ""]], r"is empty"),
    "header only": (lambda t: t[:1], r"has a header but no rows"),
    "a joint is missing": (without("q3_mm"), r"joint column 'q3_mm' is missing"),
    "a coordinate is missing": (without("y_mm"), r"column 'y_mm' is missing; the file has q1_deg"),
    "an attitude is missing": (without("ry_deg"), r"column 'ry_deg' is missing"),
    "unknown joint unit": (renamed("q1_deg", "q1_gon"), r"'q1_deg' has the unknown unit 'gon'"),
    "a length for an angle": (renamed("q1_deg", "q1_mm"), r"joint 1 is revolute, but its unit is 'mm'"),
    "an angle for a length": (renamed("q2_mm", "q2_deg"), r"joint 2 is prismatic, but its unit is 'deg'"),
    "unknown position unit": (renamed("x_mm", "x_inch"), r"column 'x_mm' is missing; the file has .*x_inch"),
    "a column twice": (renamed("y_mm", "x_mm"), r"column 'x_mm' occurs 2 times"),
    "a joint twice": (renamed("q2_mm", "q1_deg"), r"joint column 'q1_deg' is given twice"),
    "NaN": (cell(9, "x_mm", "nan"), r"row 9, column 'x_mm' is nan; correct or remove the row"),
    "infinity": (cell(9, "q2_mm", "-inf"), r"row 9, column 'q2_mm' is -inf"),
    "a word": (cell(5, "rz_deg", "lost"), r"row 5, column 'rz_deg' holds 'lost', which is not a number"),
    "an empty cell": (cell(7, "z_mm", ""), r"row 7, column 'z_mm' is empty"),
    "a short row": (lambda t: [*t[:3], t[3][:10], *t[4:]], r"row 4, column 'ry_deg' is empty"),
    "a long row": (lambda t: [*t[:3], [*t[3], "1"], *t[4:]], r"row 4 has 13 cells, but there are 12 columns"),
    "row numbers count blank lines": (lambda t: [t[0], [], [], *cell(4, "x_mm", "?")(t)[1:]], r"row 6, column 'x_mm'"),
    "degrees called radians": (renamed("_deg", "_rad"), r"row \d+, column 'q1_rad' is .* its unit is probably deg"),
    "attitudes in degrees called radians": (
        lambda t: [[n.replace("deg", "rad") if n[0] == "r" else n for n in t[0]], *t[1:]],
        r"row \d+, column 'r._rad' is \d+ rad, .* its unit is probably deg",
    ),
    "joint millimetres called metres": (renamed("q2_mm", "q2_m"), r"column 'q2_m' is .*its unit is probably mm"),
}


@pytest.mark.parametrize("case", READING)
def test_refused_when_read(tmp_path, qiao, table, case):
    spoil, said = READING[case]
    path = tmp_path / "tracker.csv"
    with path.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows(spoil([list(row) for row in table]))
    with pytest.raises(InputError, match=said) as caught:
        read_measurements(path, qiao.nominal)
    assert str(caught.value).startswith(str(path)) and "\n" not in str(caught.value)


FITTING = {
    "radians called degrees": (scaled("_deg", np.pi / 180), r"units|angle unit"),
    "position metres called millimetres": (
        lambda t: [t[0], *([repr(float(c) / 1e3) if 6 <= i < 9 else c for i, c in enumerate(r)] for r in t[1:])],
        r"another length unit",
    ),
    "position millimetres called metres": (
        lambda t: [[n.replace("_mm", "_m") if n[0] in "xyz" else n for n in t[0]], *t[1:]],
        r"another length unit",
    ),
    "too few poses": (lambda t: t[:3], r"2 poses give 12 equations, too few for the \d+ parameters"),
    "attitudes turned round": (
        lambda t: [t[0], *([repr(-float(c)) if i >= 9 else c for i, c in enumerate(r)] for r in t[1:])],
        r"attitude convention",
    ),
}


@pytest.mark.parametrize("known_frames", [False, True])
@pytest.mark.parametrize("case", FITTING)
def test_refused_when_fitted(tmp_path, qiao, table, case, known_frames):
    """What no single cell betrays: the data do not fit the arm."""
    spoil, said = FITTING[case]
    path = tmp_path / "tracker.csv"
    with path.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows(spoil([list(row) for row in table]))
    measurements = read_measurements(path, qiao.nominal)
    with pytest.raises(InputError, match=said) as caught:
        fit(qiao, measurements, known_frames=known_frames)
    assert str(caught.value).startswith(str(path)) and "\n" not in str(caught.value)


def test_a_missing_file_is_named(tmp_path, qiao):
    with pytest.raises(InputError, match=r"nowhere\.csv does not exist"):
        read_measurements(tmp_path / "nowhere.csv", qiao.nominal)


@pytest.mark.parametrize("content", [b"\x89PNG\r\n\x1a\n\xff\xd8\x00", "q1_deg,größe\n1,2\n".encode("latin-1")])
def test_a_file_that_is_no_text_is_named(tmp_path, qiao, content):
    path = tmp_path / "picture.csv"
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"cannot read .*picture\.csv.*UTF-8"):
        read_measurements(path, qiao.nominal)


def test_the_good_table_is_good(tmp_path, qiao, table):
    path = tmp_path / "tracker.csv"
    with path.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows(table)
    for known_frames in (False, True):
        found = fit(qiao, read_measurements(path, qiao.nominal), known_frames=known_frames)
        assert found.identification.converged


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_files_of_poses_and_of_positions_are_not_one_data_set(tmp_path, qiao, order):
    rng = np.random.default_rng(0)
    some = [simulated_tracker(load_plant("qiao2026"), random_joints(qiao.nominal, 5, rng), rng) for _ in range(2)]
    paths = [some[0].write_csv(tmp_path / "poses.csv"), some[1].positions_only().write_csv(tmp_path / "points.csv")]
    with pytest.raises(InputError, match=r"points\.csv holds positions alone, .*poses\.csv attitudes too"):
        read_observations([paths[i] for i in order], qiao.nominal)
