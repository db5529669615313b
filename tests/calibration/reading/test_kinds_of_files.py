"""Files of every kind, written from a simulated arm and read back through a column description."""

import numpy as np
import pytest

from pickenv.arm import forward, load_arm
from pickenv.base import InputError
from pickenv.calibration import (
    DistanceObservations,
    Measurements,
    ReflectorObservations,
    SocketObservations,
    contiguous_folds,
    random_joints,
    read_observations,
    same_poses,
)

JOINTS = 'joints.columns = ["A1", "A2", "A3", "A4", "A5", "A6"]\njoints.unit = "deg"\n'
TRIAD = np.array([[50.0, 0.0, 20.0], [-40.0, 60.0, 0.0], [-30.0, -50.0, 35.0]]) * 1e-3


@pytest.fixture(scope="module")
def ur5():
    return load_arm("ur5").nominal


@pytest.fixture
def read(tmp_path, ur5):
    """``read(description, rows, names)``: what a file with those columns holds."""

    def reader(description, rows, names, files=("data.csv",), geometry=ur5):
        (tmp_path / "mine.toml").write_text(description, encoding="utf-8")
        paths = []
        for name, part in zip(files, np.array_split(np.array(rows, dtype=object), len(files)), strict=True):
            path = tmp_path / name
            path.parent.mkdir(exist_ok=True)
            lines = [",".join(names)] if names else []
            path.write_text("\n".join(lines + [",".join(str(v) for v in row) for row in part]) + "\n")
            paths.append(path)
        return read_observations(paths, geometry, tmp_path / "mine.toml")

    return reader


@pytest.fixture(scope="module")
def moved(ur5):
    joints = random_joints(ur5, 30, np.random.default_rng(0))
    return joints, forward(ur5, joints)


NAMES = ["A1", "A2", "A3", "A4", "A5", "A6"]
TRIPLES = [f"{axis}{i}" for i in (1, 2, 3) for axis in "xyz"]
REFLECTORS = f"reflectors.columns = {TRIPLES}\n".replace("'", '"') + 'reflectors.unit = "mm"\n'


def reflector_rows(moved):
    joints, pose = moved
    points = pose.position[:, None] + np.einsum("nij,kj->nki", pose.rotation, TRIAD)
    return [[*np.degrees(q), *(p * 1e3).ravel()] for q, p in zip(joints, points, strict=True)], points


@pytest.mark.parametrize("mark", ["zeros", "empty", "nan"])
def test_reflectors_with_some_lost(read, moved, mark):
    rows, points = reflector_rows(moved)
    for row, which in ((3, 1), (7, 0), (7, 2)):
        rows[row][6 + 3 * which : 9 + 3 * which] = {"zeros": [0, 0, 0], "empty": [""] * 3, "nan": ["NaN"] * 3}[mark]
    lost = "zeros" if mark == "zeros" else "empty"
    data = read(JOINTS + REFLECTORS + f'reflectors.lost = "{lost}"\nreflectors.std_mm = 0.02\n', rows, NAMES + TRIPLES)
    assert isinstance(data, ReflectorObservations) and data.seen.sum() == 87
    assert not data.seen[3, 1] and not data.seen[7, 0] and not data.seen[7, 2] and data.seen[7, 1]
    np.testing.assert_allclose(data.points[data.seen], points[data.seen], atol=1e-12)
    assert data.std == pytest.approx(2e-5)


def test_a_lost_reflector_that_nobody_announced_is_refused(read, moved):
    rows, _ = reflector_rows(moved)
    rows[3][9:12] = [0, 0, 0]
    with pytest.raises(InputError, match=r"row 5: reflector 2 lies at 0, 0, 0.*lost = 'zeros'"):
        read(JOINTS + REFLECTORS, rows, NAMES + TRIPLES)
    rows[3][9:12] = ["", "", ""]
    with pytest.raises(InputError, match=r"row 5, column 'x2' is empty"):
        read(JOINTS + REFLECTORS, rows, NAMES + TRIPLES)


def test_a_lost_reflector_in_a_file_of_positions_is_refused(read, moved):
    joints, pose = moved
    rows = [[*np.degrees(q), *p] for q, p in zip(joints, pose.position, strict=True)]
    rows[4][6:] = [0, 0, 0]
    description = JOINTS + 'position.columns = ["x", "y", "z"]\nposition.unit = "m"\n'
    with pytest.raises(InputError, match=r"row 6 holds the position 0, 0, 0, .*lost the reflector"):
        read(description, rows, [*NAMES, "x", "y", "z"])


def test_draw_wire_lengths(read, moved):
    joints, pose = moved
    length = np.linalg.norm(pose.position - [1.0, 2.0, 0.5], axis=1) * 1e3
    rows = [[*np.degrees(q), value] for q, value in zip(joints, length, strict=True)]
    description = JOINTS + 'wire.columns = ["L"]\nwire.unit = "mm"\nwire.std_mm = 0.1\n'
    data = read(description, rows, [*NAMES, "L"])
    assert isinstance(data, DistanceObservations) and data.std == pytest.approx(1e-4)
    np.testing.assert_allclose(data.length, length / 1e3)


SPACED = "[sockets]\nspacing_mm = 50.0\n"


def test_sockets_by_file_and_folder(read, moved):
    """Files without a header, one socket each; the two files of a folder make a pair."""
    joints, _ = moved
    files = ("left/hole_0.csv", "left/hole_1.csv", "right/hole_0.csv", "right/hole_1.csv")
    names = f"names = {NAMES}\n".replace("'", '"')
    data = read(names + JOINTS + SPACED, np.degrees(joints), None, files)
    assert isinstance(data, SocketObservations)
    np.testing.assert_array_equal(data.pairs, [[0, 1], [2, 3]])
    np.testing.assert_allclose(data.spacing, 0.05)
    assert data.origins is not None
    np.testing.assert_array_equal(data.socket, data.origins.file)
    with pytest.raises(InputError, match=r"'.*right' holds 1; give two files per folder"):
        read(names + JOINTS + SPACED, np.degrees(joints), None, files[:3])


def test_sockets_by_column(read, moved):
    joints, _ = moved
    rows = [[*np.degrees(q), 10 + i % 4] for i, q in enumerate(joints)]
    description = JOINTS + '[sockets]\ncolumn = "hole"\nspacing_mm = 50.0\n'
    data = read(description, rows, [*NAMES, "hole"])
    np.testing.assert_array_equal(data.pairs, [[0, 1], [2, 3]])
    np.testing.assert_array_equal(data.socket, np.arange(30) % 4)
    for train, test in contiguous_folds(data.groups, same_poses(data.joints), 3):
        assert set(data.socket[train]) == set(data.socket[test]) == {0, 1, 2, 3}


CONDITIONS = """
[conditions]
temperature = { column = "T", unit = "degC", reference = 22.0 }
payload = { column = "m", unit = "g" }
torques = { columns = ["-t1", "-t2", "-t3", "-t4", "-t5", "-t6"] }
"""


def test_conditions_and_repeat_sigma(read, moved):
    joints, pose = moved
    rng = np.random.default_rng(1)
    extra = rng.uniform(1, 9, (30, 11))
    rows = [[*np.degrees(q), *p, *e] for q, p, e in zip(joints, pose.position, extra, strict=True)]
    names = [*NAMES, "x", "y", "z", "T", "m", *(f"t{i}" for i in range(1, 7)), "sx", "sy", "sz"]
    description = JOINTS + 'position.columns = ["x", "y", "z"]\nposition.unit = "m"\n'
    description += 'position.std_columns = ["sx", "sy", "sz"]\n' + CONDITIONS
    found = read(description, rows, names)
    conditions = found.conditions
    np.testing.assert_allclose(conditions.temperature, extra[:, 0] - 22.0)
    np.testing.assert_allclose(conditions.payload, extra[:, 1] * 1e-3)
    np.testing.assert_allclose(conditions.torque, -extra[:, 2:8])
    assert found.origins.repeat == pytest.approx(np.sqrt(np.mean(np.sum(extra[:, 8:] ** 2, axis=1))))
    half = found.select(np.arange(15))
    np.testing.assert_allclose(half.conditions.torque, conditions.torque[:15])


def test_yaml_entries_by_dotted_paths(tmp_path, ur5, moved):
    joints, pose = moved
    entries = [
        f"- joints: [{', '.join(repr(float(v)) for v in q)}]\n  tool: {{x: {p[0]!r}, y: {p[1]!r}, z: {p[2]!r}}}\n"
        for q, p in zip(joints, pose.position.tolist(), strict=True)
    ]
    (tmp_path / "data.yaml").write_text("".join(entries))
    names = [f"joints.{i}" for i in range(6)]
    description = f"joints.columns = {names}\njoints.unit = 'rad'\nposition.columns = ['tool.x', 'tool.y', 'tool.z']\n"
    (tmp_path / "mine.toml").write_text(description.replace("'", '"') + 'position.unit = "m"\n')
    data = read_observations([tmp_path / "data.yaml"], ur5, tmp_path / "mine.toml")
    np.testing.assert_allclose(data.joints, joints)
    np.testing.assert_allclose(data.position, pose.position)
    (tmp_path / "data.yaml").write_text("a: [1, 2\n")
    with pytest.raises(InputError, match=r"data\.yaml is not valid YAML") as caught:
        read_observations([tmp_path / "data.yaml"], ur5, tmp_path / "mine.toml")
    assert "\n" not in str(caught.value)


def test_a_convention_that_is_not_named_is_asked_for_with_a_table(read, moved):
    """The right one leaves rounding; the others leave degrees; the table says so, best first."""
    from scipy.spatial.transform import Rotation

    joints, pose = moved
    angles = Rotation.from_matrix(pose.rotation).as_euler("ZYX", degrees=True)
    rows = [[*np.degrees(q), *p, *a] for q, p, a in zip(joints, pose.position, angles, strict=True)]
    description = JOINTS + 'position.columns = ["x", "y", "z"]\nposition.unit = "m"\n'
    description += 'rotation.columns = ["a", "b", "c"]\nrotation.unit = "deg"\n'
    names = [*NAMES, "x", "y", "z", "a", "b", "c"]
    with pytest.raises(InputError, match=r"names no convention, and none is guessed") as caught:
        read(description, rows, names)
    table = str(caught.value).splitlines()[1:-1]
    assert "euler_zyx_intrinsic (kuka_abc)" in table[0] and "0.00 mm" in table[0] and len(table) == 6
    named = read(description + 'rotation.convention = "kuka_abc"\n', rows, names)
    assert isinstance(named, Measurements)
    np.testing.assert_allclose(named.rotation, pose.rotation, atol=1e-12)


def test_repeated_rows_are_refused(read, moved):
    joints, pose = moved
    rows = [[*np.degrees(q), *p] for q, p in zip(joints, pose.position, strict=True)]
    description = JOINTS + 'position.columns = ["x", "y", "z"]\nposition.unit = "m"\n'
    with pytest.raises(InputError, match=r"row 32 repeats row 6 to the last digit \(2 repeated rows in all\)"):
        read(description, [*rows, rows[4], rows[9]], [*NAMES, "x", "y", "z"])
    rows[5][:6] = rows[4][:6]  # the same pose measured twice is no repetition
    assert len(read(description, rows, [*NAMES, "x", "y", "z"]).joints) == 30


BAD = {
    "two kinds": (
        REFLECTORS + 'wire = { columns = ["L"], unit = "mm" }\n',
        r"\[reflectors\] and \[wire\] are both",
    ),
    "two columns of a length": ('wire = { columns = ["L", "M"], unit = "mm" }\n', r"\[wire\] needs one column"),
    "five columns of reflectors": (
        'reflectors = { columns = ["a", "b", "c", "d", "e"], unit = "mm" }\n',
        r"\[reflectors\] needs three columns per reflector",
    ),
    "unknown mark": (
        REFLECTORS + 'reflectors.lost = "minus one"\n',
        r"lost of \[reflectors\] is 'minus one'; give how",
    ),
    "attitudes of a wire": (
        'wire = { columns = ["L"], unit = "mm" }\nrotation.columns = ["a"]\n',
        r"belongs to \[pos",
    ),
    "torques of three joints": (
        'wire = { columns = ["L"], unit = "mm" }\nconditions.torques.columns = ["a", "b", "c"]\n',
        r"one column, and one unit, per joint",
    ),
    "temperature in Fahrenheit": (
        'wire = { columns = ["L"], unit = "mm" }\nconditions.temperature = { column = "T", unit = "degF" }\n',
        r"unit of \[conditions.temperature\] is 'degF'; give one of degC, K",
    ),
    "negative spacing": (
        "[sockets]\nspacing_mm = -50.0\n",
        r"spacing_mm of \[sockets\] is -50; give a number above zero",
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_descriptions_get_one_sentence(read, moved, case):
    description, said = BAD[case]
    with pytest.raises(InputError, match=said) as caught:
        read(JOINTS + description, np.degrees(moved[0]), NAMES)
    assert "\n" not in str(caught.value)


def test_misses_are_in_metres_whatever_the_kind(read, moved, ur5):
    from pickenv.calibration import ArmModel

    rows, _ = reflector_rows(moved)
    data = read(JOINTS + REFLECTORS, rows, NAMES + TRIPLES)
    shifted = TRIAD.ravel() + np.array([1e-3, 0, 0, 0, 0, 0, 0, 0, 0])
    left = np.linalg.norm(data.misses(ArmModel.of(ur5), shifted), axis=1).reshape(30, 3)
    np.testing.assert_allclose(left, np.broadcast_to([1e-3, 0, 0], (30, 3)), atol=1e-9)
