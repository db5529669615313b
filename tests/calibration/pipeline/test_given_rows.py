"""What is given to a calibration: files of one layout or several, arrays, finished poses, and poses to choose from."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pickenv.arm import Arm, forward, load_arm
from pickenv.base import InputError
from pickenv.calibration import DistanceObservations, Measurements, given_arm, given_rows, pool_of, random_joints

NAMES = [f"A{k}" for k in range(1, 7)]
JOINTS = f'joints.columns = {NAMES}\njoints.unit = "deg"\n'.replace("'", '"')
POINTS = 'position.columns = ["x", "y", "z"]\nposition.unit = "mm"\n'
WIRE = 'wire.columns = ["L"]\nwire.unit = "mm"\nwire.std_mm = 0.1\n'


@pytest.fixture(scope="module")
def ur5() -> Arm:
    return load_arm("ur5")


@pytest.fixture
def files(ur5: Arm, tmp_path: Path) -> tuple[list[Path], list[Path], list[np.ndarray]]:
    """Positions to a hundredth of a millimetre, to a tenth, and lengths of a wire; descriptions of both; joints."""
    data, joints = [], []
    for number, (digits, heads) in enumerate(((2, "x,y,z"), (1, "x,y,z"), (2, "L"))):
        q = random_joints(ur5.nominal, 8, np.random.default_rng(number))
        position = 1e3 * forward(ur5.nominal, q).position
        values = position if heads != "L" else np.linalg.norm(position - 500.0, axis=1)[:, None]
        lines = [",".join([*NAMES, heads])]
        for row, read in zip(np.degrees(q).tolist(), values.tolist(), strict=True):
            lines.append(",".join([*map(str, row), *(f"{v:.{digits}f}" for v in read)]))
        data.append(tmp_path / f"day{number}.csv")
        data[-1].write_text("\n".join(lines) + "\n", encoding="utf-8")
        joints.append(q)
    layouts = []
    for name, text in (("points", JOINTS + POINTS), ("wire", JOINTS + WIRE)):
        layouts.append(tmp_path / f"{name}.toml")
        layouts[-1].write_text(text, encoding="utf-8")
    return data, layouts, joints


def test_one_layout_is_for_all_files_and_several_are_one_each(
    ur5: Arm, files: tuple[list[Path], list[Path], list[np.ndarray]]
) -> None:
    data, (points, wire), joints = files
    one = given_rows(ur5, data[0], points)
    assert isinstance(one, Measurements)
    np.testing.assert_allclose(one.joints, joints[0])
    both = given_rows(ur5, data[:2], [points])
    assert isinstance(both, Measurements) and len(both) == 16
    np.testing.assert_allclose(both.joints, np.concatenate(joints[:2]))
    apart = given_rows(ur5, data[1::-1], points, "tool")
    assert len(apart.stations) == 2
    assert {name.partition("_")[0] for name in apart.unknowns()} == {"tool2"}
    mixed = given_rows(ur5, data[1:], [points, wire])
    assert [type(part) for part in mixed.parts] == [Measurements, DistanceObservations]
    assert {name.partition("_")[0] for name in mixed.unknowns()} == {"anchor", "zero", "tool2"}
    np.testing.assert_allclose(mixed.joints, np.concatenate(joints[1:]))
    for wrong in ([points, points], [points, points, points, wire]):
        with pytest.raises(InputError, match=f"{len(wrong)} column descriptions are given for 3 files"):
            given_rows(ur5, data, wrong)


def test_arrays_are_taken_as_they_are_and_not_described(
    ur5: Arm, files: tuple[list[Path], list[Path], list[np.ndarray]]
) -> None:
    data, (points, _), _ = files
    one = given_rows(ur5, data[0], points)
    assert given_rows(ur5, one) is one and given_rows(ur5, [one]) is one
    both = given_rows(ur5, [one, one])
    assert isinstance(both, Measurements) and len(both) == 16
    apart = given_rows(ur5, [one, one], stations="base,tool")
    assert {name.partition("_")[0] for name in apart.unknowns()} == {"base2", "tool2"}
    shared = given_rows(ur5, [one, one], stations="none")
    assert len(shared.stations) == 2 and not shared.unknowns()
    with pytest.raises(InputError, match="columns describe files, but rows are given"):
        given_rows(ur5, one, points)
    with pytest.raises(InputError, match=r"joints have shape \(8, 5\), but arm 'ur5' has 6 joints"):
        given_rows(ur5, replace(one, joints=one.joints[:, :5]))
    for name in ("joints", "position"):
        values = getattr(one, name).copy()
        values[[2, 5], [1, 2]] = np.nan
        with pytest.raises(InputError, match=rf"rows 4, 7: {name} is no finite number"):
            given_rows(ur5, [one, replace(one, **{name: values})])


def test_finished_poses_need_no_arm_and_joints_do(
    ur5: Arm, files: tuple[list[Path], list[Path], list[np.ndarray]], tmp_path: Path
) -> None:
    points = files[1][0]
    assert given_arm(ur5, points) is ur5 and given_arm("ur5", None).fingerprint() == ur5.fingerprint()
    for columns in (None, points, [points, points]):
        with pytest.raises(InputError, match="no arm is given"):
            given_arm(None, columns)
    poses = "ical_charuco"  # a camera's pictures beside the poses that the controller said
    assert given_arm(None, poses).name == given_arm(None, [points, poses]).name == "finished_poses"
    with pytest.raises(InputError, match="finished poses have no joints"):
        given_arm(ur5, poses)


def test_poses_to_choose_from_are_joints_or_poses_of_ours_or_what_is_described(
    ur5: Arm, files: tuple[list[Path], list[Path], list[np.ndarray]], tmp_path: Path
) -> None:
    """With their lines in the file, whose first one is the header."""
    data, (points, _), joints = files
    found, lines = pool_of(data[0], ur5.nominal, points)
    np.testing.assert_allclose(found, joints[0])
    assert lines.dtype == np.int64 and lines.tolist() == list(range(2, 10))
    own = tmp_path / "own.csv"
    table = [",".join(f"q{k}_deg" for k in range(1, 7)), *(",".join(map(str, np.degrees(q))) for q in joints[1])]
    own.write_text("\n".join(table) + "\n", encoding="utf-8")
    found, lines = pool_of(own, ur5.nominal)
    np.testing.assert_allclose(found, joints[1])
    assert lines.dtype == np.int64 and lines.tolist() == list(range(2, 10))
