"""Foreign files, read through a description of their columns."""

import csv
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import expm

from pickenv import calibration
from pickenv.arm import load_arm
from pickenv.base import InputError, shipped_in
from pickenv.calibration import Measurements, load_description, random_joints, read_measurements, read_targets

JOINTS = 'joints.columns = ["A1", "A2", "A3", "A4", "A5", "A6"]\njoints.unit = "deg"\n'
HEADER = ["A1", "A2", "A3", "A4", "A5", "A6", "X", "Y", "Z"]


@pytest.fixture(scope="module")
def ur5():
    return load_arm("ur5").nominal


@pytest.fixture
def read(tmp_path, ur5):
    """``read(description, text)``: the measurements that a foreign file with that text holds."""

    def reader(description: str, text: str, geometry=ur5) -> Measurements:
        (tmp_path / "mine.toml").write_text(description, encoding="utf-8")
        (tmp_path / "tracker.csv").write_text(text, encoding="utf-8")
        return read_measurements(tmp_path / "tracker.csv", geometry, tmp_path / "mine.toml")

    return reader


@pytest.fixture(scope="module")
def table(ur5):
    """Ten poses in degrees and millimetres."""
    rng = np.random.default_rng(0)
    return np.concatenate([np.degrees(random_joints(ur5, 10, rng)), rng.uniform(-900, 900, (10, 3))], axis=1)


def text_of(values, header=HEADER, separator=",", decimal="."):
    lines = [separator.join(repr(float(v)).replace(".", decimal) for v in row) for row in values]
    return "\n".join(([separator.join(header)] if header else []) + lines) + "\n"


POSITION = 'position.columns = ["X", "Y", "Z"]\nposition.unit = "mm"\n'


def check(data, table):
    np.testing.assert_allclose(data.joints, np.radians(table[:, :6]), rtol=1e-15)
    np.testing.assert_allclose(data.position, table[:, 6:9] * 1e-3, rtol=1e-14)
    assert data.rotation is None


def test_semicolons_and_decimal_commas(read, table):
    text = text_of(table, separator=";", decimal=",")
    check(read('separator = ";"\ndecimal = ","\n' + JOINTS + POSITION, text), table)


def test_tabs_a_byte_order_mark_blank_lines_and_trailing_separators(read, table):
    lines = text_of(table, separator="\t").splitlines()
    text = "\ufeff" + "\t\n\n".join(lines) + "\n"
    check(read('separator = "\\t"\n' + JOINTS + POSITION, text), table)


def test_a_file_without_a_header_is_named_by_the_description(read, table):
    names = f"names = {HEADER}\n".replace("'", '"')
    check(read(names + JOINTS + POSITION, text_of(table, header=None)), table)


def test_position_is_target_plus_deviation(read, table):
    split = np.column_stack([table, np.full((10, 3), [0.5, -0.25, 0.125])])
    header = [*HEADER, "dX", "dY", "dZ"]
    position = 'position.columns = ["X + dX", "Y + dY", "Z + dZ"]\nposition.unit = "mm"\n'
    shifted = table.copy()
    shifted[:, 6:] += [0.5, -0.25, 0.125]
    check(read(JOINTS + position, text_of(split, header)), shifted)


def test_odd_names_stand_in_backticks_and_arithmetic_is_arithmetic(read, table):
    header = [*HEADER[:6], "pos x [mm]", "y-axis", "Z"]
    position = 'position.columns = ["2 * `pos x [mm]` / 4 + 1", "-(`y-axis` - 3)", "Z"]\nposition.unit = "mm"\n'
    expected = table.copy()
    expected[:, 6] = table[:, 6] / 2 + 1
    expected[:, 7] = 3 - table[:, 7]
    check(read(JOINTS + position, text_of(table, header)), expected)


def test_a_column_whose_name_looks_like_arithmetic_is_a_column(read, table):
    header = [*HEADER[:6], "X", "Y", "X - Y"]
    position = 'position.columns = ["X", "Y", "X - Y"]\nposition.unit = "mm"\n'
    check(read(JOINTS + position, text_of(table, header)), table)


def test_units_may_differ_by_joint(read, qiao):
    header = ["a", "b", "c", "d", "e", "f", "x", "y", "z"]
    row = [0.5, 300.0, 0.4, -30.0, 0.1, 1.5, 0.1, 0.2, 0.3]
    description = """
    joints.columns = ["a", "b", "c", "d", "e", "f"]
    joints.units = ["rad", "mm", "m", "deg", "m", "rad"]
    position = { columns = ["x", "y", "z"], unit = "m", std_mm = 0.05 }
    """
    data = read(description, text_of([row], header), qiao.nominal)
    np.testing.assert_allclose(data.joints, [[0.5, 0.3, 0.4, np.radians(-30), 0.1, 1.5]])
    np.testing.assert_allclose(data.position, [[0.1, 0.2, 0.3]])
    assert data.position_std == pytest.approx(5e-5)


def about(axis, angle):
    """Rotation matrix as the exponential of a skew matrix: no convention of SciPy's Rotation enters."""
    x, y, z = np.eye(3)["xyz".index(axis)] if isinstance(axis, str) else axis
    return expm(angle * np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]))


def quaternion(w, x, y, z):
    return about(np.array([x, y, z]) / np.sqrt(1 - w * w), 2 * np.arccos(w))


def vector(v):
    return about(np.array(v) / np.linalg.norm(v), np.linalg.norm(v))


REFEREE = {
    "rotation_vector": lambda a, b, c: vector([a, b, c]),
    "ur_rotation_vector": lambda a, b, c: vector([a, b, c]),
    "quaternion_wxyz": quaternion,
    "abb_quaternion": quaternion,
    "quaternion_xyzw": lambda x, y, z, w: quaternion(w, x, y, z),
    "euler_xyz_extrinsic": lambda a, b, c: about("z", c) @ about("y", b) @ about("x", a),
    "fanuc_wpr": lambda w, p, r: about("z", r) @ about("y", p) @ about("x", w),
    "euler_xyz_intrinsic": lambda a, b, c: about("x", a) @ about("y", b) @ about("z", c),
    "euler_zyx_intrinsic": lambda a, b, c: about("z", a) @ about("y", b) @ about("x", c),
    "euler_zyx_extrinsic": lambda a, b, c: about("x", c) @ about("y", b) @ about("z", a),
    "euler_zyz_intrinsic": lambda a, b, c: about("z", a) @ about("y", b) @ about("z", c),
    "kuka_abc": lambda a, b, c: about("z", a) @ about("y", b) @ about("x", c),
}


def test_every_convention_has_a_referee(read, table):
    """The refusal of another names them all."""
    rotation = 'rotation = { columns = ["X", "Y", "Z"], convention = "other", unit = "deg" }\n'
    with pytest.raises(InputError, match="give one of") as refusal:
        read(JOINTS + POSITION + rotation, text_of(table))
    assert set(REFEREE) == set(str(refusal.value).partition("give one of ")[2].split(", "))


@pytest.mark.parametrize(
    ("convention", "unit"),
    [(name, unit) for name in REFEREE for unit in ([""] if "quaternion" in name else ["deg", "rad"])],
)
def test_attitude_conventions(read, table, convention, unit):
    angles = bool(unit)
    values = np.random.default_rng(3).normal(size=(10, 3 if angles else 4))
    values = values if angles else values / np.linalg.norm(values, axis=1, keepdims=True)
    names = ["r1", "r2", "r3", "r4"][: values.shape[1]]
    said = f', unit = "{unit}"' if angles else ""
    rotation = f'rotation = {{ columns = {names}, convention = "{convention}"{said}, std_deg = 0.02 }}\n'
    written = np.degrees(values) if unit == "deg" else values
    data = read(
        JOINTS + POSITION + rotation.replace("'", '"'), text_of(np.column_stack([table, written]), HEADER + names)
    )
    for row, rotation_matrix in zip(values, data.rotation, strict=True):
        np.testing.assert_allclose(rotation_matrix, REFEREE[convention](*row), atol=1e-12)
    assert data.attitude_std == pytest.approx(np.radians(0.02))


def test_shipped_descriptions_are_sound():
    names = shipped_in(Path(calibration.__file__).parent / "reading" / "descriptions")
    assert {"ur5_jacobi2025", "wam_jacobi2025"} <= set(names)
    for name in names:
        description = load_description(name)
        counts = {"position": {3}, "reflectors": {3, 6, 9, 12}, "wire": {1}, "sockets": {0, 1}, "pixels": {0, 2}}
        assert len(description.columns) in counts[description.kind]


GOOD = JOINTS + POSITION
Z = 'rotation = { columns = ["2 * X", "2 * Y", "2 * Z"], convention = "kuka_abc", unit = "deg" }\n'
BAD_DESCRIPTIONS = {
    "misspelt key": ("seperator = ';'\n" + GOOD, r"unknown key 'seperator'"),
    "misspelt key of a section": (GOOD + "position.units = 'mm'\n", r"unknown key 'units' in \[position\]"),
    "no position": (JOINTS, r"section \[position\] is missing"),
    "position is no section": (JOINTS + "position = 3\n", r"line 3: \[position\] must be a table"),
    "rotation is no section": (GOOD + "rotation = 'kuka_abc'\n", r"\[rotation\] must be a table"),
    "no unit": (JOINTS + 'position.columns = ["X", "Y", "Z"]\n', r"unit of \[position\] is missing"),
    "unknown unit": (GOOD.replace('"mm"', '"inch"'), r"unit of \[position\] is 'inch'; give one of mm, m"),
    "an angle for a length": (GOOD.replace('"mm"', '"deg"'), r"unit of \[position\] is 'deg'; give one of mm, m"),
    "a length for a revolute joint": (GOOD.replace('"deg"', '"mm"'), r"joint 1 is revolute"),
    "five joints": (GOOD.replace('"A6"', '"A5"').replace('"A5", "A5"', '"A5"'), r"5 joint columns .* 6 joints"),
    "too few units": (GOOD.replace("unit =", "units =", 1).replace('"deg"', '["deg"]'), r"6 columns but 1 units"),
    "units that are no list": (GOOD.replace("unit =", "units =", 1), r"units of \[joints\] is 'deg'; give a list"),
    "columns that are no list": (
        JOINTS + 'position = { columns = "X", unit = "mm" }\n',
        r"columns of \[position\] is 'X'; give a list",
    ),
    "two positions": (GOOD.replace('"Y", ', ""), r"\[position\] needs three columns"),
    "unknown convention": (
        GOOD + Z.replace("kuka_abc", "zyz"),
        r"convention of \[rotation\] is 'zyz'; give one of .*kuka_abc",
    ),
    "two angles": (GOOD + Z.replace('"2 * Y", ', ""), r"convention 'kuka_abc' needs 3 columns"),
    "quaternion of three": (GOOD + Z.replace("kuka_abc", "abb_quaternion"), r"'abb_quaternion' needs 4 columns"),
    "unit of a quaternion": (
        GOOD + 'rotation = { columns = ["A", "B", "C", "D"], unit = "deg", convention = "abb_quaternion" }\n',
        r"mine.toml: unit of \[rotation\] is 'deg', but 'A' begins a quaternion; leave it out",
    ),
    "unit of a quaternion without convention": (
        GOOD + 'rotation = { columns = ["A", "B", "C", "D"], unit = "rad" }\n',
        r"unit of \[rotation\] is 'rad', but 'A' begins a quaternion",
    ),
    "separator of two characters": ("separator = ';;'\n" + GOOD, r"separator is ';;'"),
    "no separator": ("separator = ''\n" + GOOD, r"separator is ''"),
    "decimal sign": ("decimal = ':'\n" + GOOD, r"decimal is ':'"),
    "decimal sign that separates": ("decimal = ','\n" + GOOD, r"decimal is ','"),
    "uncertainty of zero": (GOOD + "position.std_mm = 0\n", r"std_mm of \[position\] is 0; give a number above zero"),
    "uncertainty in words": (GOOD + "position.std_mm = 'small'\n", r"std_mm of \[position\] is 'small'; give a number"),
    "a joint twice": (GOOD.replace('"A6"', '"A5"'), r"'A5' is given for joint 5 and for joint 6"),
    "a joint twice, written otherwise": (GOOD.replace('"A6"', '" ( `A5`)"'), r"is given for joint 5 and for joint 6"),
    "one computed column twice": (
        GOOD.replace('"A5"', '"A5 / 2 - 1"').replace('"A6"', '"A5/2-1"'),
        r"'A5/2-1' is given for joint 5 and for joint 6",
    ),
    "a joint for a position": (
        GOOD.replace('"Y"', '"A2"'),
        r"'A2' is given for joint 2 and for column 2 of \[position\]",
    ),
    "a position twice": (GOOD.replace('"Y"', '"X"'), r"'X' is given for column 1 of \[position\] and for column 2"),
    "a constant of 400 digits": (
        GOOD.replace('"X"', f'"X + {"9" * 400}"'),
        r"cannot compute 'X \+ 9+ …'",
    ),
    "a constant of 5000 digits": (GOOD.replace('"X"', f'"X + {"9" * 5000}"'), r"column 'X \+ 9+ …' is missing"),
    "100 000 minuses": (GOOD.replace('"X"', f'"{"-" * 100_000}X"'), r"column '-+ …' is missing"),
    "900 brackets": (GOOD.replace('"X"', f'"{"(" * 450}X{")" * 450}"'), r"column '\(+ …' is missing"),
    "a truth": (GOOD.replace('"X"', '"X + True"'), r"cannot compute 'X \+ True'"),
    "a separator that is a digit": ("separator = '1'\n" + GOOD, r"separator is '1'"),
    "a separator that nobody sees": ('separator = "\\u0000"\n' + GOOD, r"separator is '.x00'"),
    "a list for a convention": (
        GOOD + Z.replace('"kuka_abc"', "['kuka_abc']"),
        r"convention of \[rotation\] is \['kuka_abc'\]; give one",
    ),
    "a number of 5000 digits": (f"decimal = {'1' * 5000}\n" + GOOD, r"is not valid TOML: .*digits"),
    "a number of 400 digits": (f"decimal = {'1' * 400}\n" + GOOD, r"decimal is an integer of more than 64 bits"),
    "a function": (GOOD.replace('"X"', '"abs(X)"'), r"cannot compute 'abs\(X\)'"),
    "a power": (GOOD.replace('"X"', '"X ** 2"'), r"cannot compute 'X \*\* 2'"),
    "an attribute": (GOOD.replace('"X"', '"X.__class__"'), r"cannot compute"),
    "a text": (GOOD.replace('"X"', "\"'x'\""), r"cannot compute"),
    "a missing column": (GOOD.replace('"X"', '"W"'), r"column 'W' is missing; the file has A1, .*Z"),
    "a missing column in a sum": (GOOD.replace('"X"', '"X + W"'), r"column 'W' is missing"),
    "no arithmetic": (GOOD.replace('"X"', '"X +"'), r"column 'X \+' is missing"),
    "division by zero": (GOOD.replace('"X"', '"X / (Y - Y)"'), r"row 2, 'X / \(Y - Y\)' divides by zero"),
    "constants divided by zero": (GOOD.replace('"X"', '"1 / 0"'), r"divides by zero"),
    "no TOML": ("joints = [", r"not valid TOML"),
}


@pytest.mark.parametrize("case", BAD_DESCRIPTIONS)
def test_a_bad_description_gets_one_sentence(read, table, case):
    description, said = BAD_DESCRIPTIONS[case]
    with pytest.raises(InputError, match=said) as caught:
        read(description, text_of(table))
    assert "\n" not in str(caught.value)
    assert "mine.toml" in str(caught.value) or "tracker.csv" in str(caught.value)


def test_an_unknown_description_names_the_known_ones(tmp_path, ur5):
    (tmp_path / "tracker.csv").write_text("a\n1\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"unknown column description 'mine'.*ur5_jacobi2025"):
        read_measurements(tmp_path / "tracker.csv", ur5, "mine")


@pytest.mark.parametrize(
    ("cells", "said"),
    [
        ("0;0;0;0;0;0;1.234,5;2;3", r"row 3, column 'X' holds '1\.234,5'"),
        ("0;0;0;0;0;0;1.234;2;3", r"row 3, column 'X' holds '1\.234'"),
        ("0;0;0;0;0;0;1 234;2;3", r"row 3, column 'X' holds '1 234'"),
        ("0;0;0;0;0;0;1_234;2;3", r"row 3, column 'X' holds '1_234'"),
    ],
)
def test_thousands_are_not_guessed(read, cells, said):
    text = ";".join(HEADER) + "\n0;0;0;0;0;0;1;2;3\n" + cells + "\n"
    with pytest.raises(InputError, match=said):
        read('separator = ";"\ndecimal = ","\n' + GOOD, text)


def test_decimal_commas_between_commas_are_noticed(read):
    text = ",".join(HEADER) + "\n0,5,0,0,0,0,0,100,200,300\n"
    with pytest.raises(InputError, match=r"row 2 has 10 cells, but there are 9 columns; check the separator"):
        read(GOOD, text)


def test_a_quaternion_that_is_none_is_named_by_its_row(read, table):
    rotation = 'rotation = { columns = ["w", "x", "y", "z"], convention = "abb_quaternion" }\n'
    values = np.column_stack([table, np.tile([1.0, 0, 0, 0], (10, 1))])
    values[4, 9] = 0.9
    with pytest.raises(InputError, match=r"row 6 holds a quaternion that is not of unit length"):
        read(GOOD + rotation, text_of(values, [*HEADER, "w", "x", "y", "z"]))


def test_the_file_is_comma_separated_text_like_any_other(tmp_path, ur5, table):
    """Quoted cells, as spreadsheets write them."""
    path = tmp_path / "tracker.csv"
    with path.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file, quoting=csv.QUOTE_ALL).writerows([HEADER, *table.tolist()])
    (tmp_path / "mine.toml").write_text(GOOD, encoding="utf-8")
    check(read_measurements(path, ur5, tmp_path / "mine.toml"), table)


@pytest.mark.parametrize("column", ["q0_deg", "q7_deg", "q7_mm"])
def test_a_joint_column_beyond_the_arms_joints_is_refused(tmp_path, column):
    """A slide before the arm, or a mimic joint in the log, would number the other joints anew."""
    arm, rng = load_arm("ur5").nominal, np.random.default_rng(0)
    header = [*(f"q{i}_deg" for i in range(1, 7)), "x_mm", "y_mm", "z_mm", column]
    file = tmp_path / "log.csv"
    file.write_text("\n".join([",".join(header), *(",".join(map(str, row)) for row in rng.normal(size=(9, 10)))]))
    for read in (read_measurements, read_targets):
        with pytest.raises(InputError, match=rf"log\.csv: column '{column}' is of none of the arm's joints"):
            read(file, arm)
