"""Targets of points in space: where they stand in a view, and what a description may say of them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pickenv.arm import Array, load_arm, rotation_matrix
from pickenv.base import InputError
from pickenv.calibration import Lens, PixelObservations, load_description, projected, read_observations
from tests.calibration.whole_robots import DODECAHEDRON

LENS = Lens(np.array([900.0, 900.0, 640.0, 480.0, -0.05, 0.01, 0.0, 0.0, 0.0]), (1280, 960))


def seen(points: Array, counts: int, views: int, rng: np.random.Generator) -> tuple[PixelObservations, Array, Array]:
    """Views of points at random poses, and these poses."""
    turn = rotation_matrix(rng.uniform(-2.0, 2.0, (views, 3)))
    place = rng.uniform((-0.2, -0.15, 0.4), (0.2, 0.15, 1.0), (views, 3))
    there = points @ np.swapaxes(turn, 1, 2) + place[:, None]
    mask = np.argsort(rng.random((views, len(points))), axis=1) < counts
    shape = mask.shape
    data = PixelObservations(
        np.zeros((views, 6)), projected(LENS.values, there), mask, points, LENS, np.zeros(9), np.ones(shape), "world"
    )
    return data, turn, place


@pytest.mark.parametrize("counts", [5, 7, 20])
def test_points_in_space_tell_where_they_stand(counts: int) -> None:
    data, turn, place = seen(DODECAHEDRON, counts, 60, np.random.default_rng(counts))
    found, starts = data.rough_poses((False,) * 6), data.starters()
    right = np.linalg.norm(found.position - place[starts], axis=1) < 1e-6
    assert right.mean() >= 0.9  # a start: of few points another pose may look alike
    assert found.rotation is not None
    assert np.abs(found.rotation[right] - turn[starts][right]).max() < 1e-5


def test_points_on_a_slanted_plane_tell_it_too() -> None:
    flat = np.random.default_rng(1).uniform(-0.1, 0.1, (12, 2))
    points = np.c_[flat, 0.3 * flat[:, 0] + 0.05]
    data, _, place = seen(points, 12, 40, np.random.default_rng(2))
    found = data.rough_poses((False,) * 6).position
    assert np.mean(np.linalg.norm(found - place[data.starters()], axis=1) < 1e-6) >= 0.9


def test_a_view_of_few_points_is_no_start_but_stays() -> None:
    data, *_ = seen(DODECAHEDRON, 3, 10, np.random.default_rng(3))
    assert not data.starters().any()
    more, *_ = seen(DODECAHEDRON, 5, 10, np.random.default_rng(3))
    mixed = replace(data, seen=np.where(np.arange(10)[:, None] < 4, more.seen, data.seen), corners=more.corners)
    np.testing.assert_array_equal(np.flatnonzero(mixed.starters()), np.arange(4))


SECTIONS = """
[joints]
columns = ["a"]
unit = "deg"
[pixels]
mount = "world"
columns = ["u", "v"]
view = "view"
corner = "id"
[camera]
fx = 900
fy = 900
cx = 640
cy = 480
width = 1280
height = 960
"""
POINTS = "points_mm = [0, 0, 0, 50, 0, 0, 0, 50, 0, 0, 0, 50]\n"


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ("points_mm = [0, 0, 0, 50, 0, 0]", "has 6 numbers; give x, y and z of four or more"),
        ("points_mm = [0, 0, 0, 1, 0, 0, 2, 0, 0, 3, 0, 0]", "lie in one line"),
        (POINTS + "numbers = [1, 2, 3]", "are not one for each of its 4 points"),
        (POINTS + "numbers = [1, 2, 3, 3]", "are not one for each of its 4 points"),
        (
            POINTS + '[board]\nkind = "chessboard"\ncolumns = 7\nrows = 6\nsquare_mm = 30',
            "in place of .board., for a table",
        ),
    ],
)
def test_a_target_is_refused_by_what_is_wrong_with_it(tmp_path: Path, table: str, message: str) -> None:
    path = tmp_path / "views.toml"
    path.write_text(f"{SECTIONS}[target]\n{table}\n", encoding="utf-8")
    with pytest.raises(InputError, match=message):
        load_description(path)


def test_points_have_the_numbers_that_they_are_given(tmp_path: Path) -> None:
    path = tmp_path / "views.toml"
    path.write_text(f"{SECTIONS}[target]\n{POINTS}numbers = [7, 5, 9, 11]\n", encoding="utf-8")
    points, numbers = load_description(path).target_points
    assert numbers == (7, 5, 9, 11)
    np.testing.assert_allclose(points[2], [0.0, 0.05, 0.0])


def test_corners_of_one_view_are_seen_at_the_same_joints(tmp_path: Path) -> None:
    (tmp_path / "v.toml").write_text(
        """[joints]
columns = ["a1", "a2", "a3", "a4", "a5", "a6"]
unit = "deg"
[pixels]
mount = "world"
columns = ["u", "v"]
view = "view"
corner = "c"
[target]
points_mm = [50, 50, 50, -50, -50, 50, -50, 50, -50, 50, -50, -50]
[camera]
fx = 900.0
fy = 900.0
cx = 640.0
cy = 480.0
width = 1280
height = 960
""",
        encoding="utf-8",
    )
    rows = ["view,c,u,v,a1,a2,a3,a4,a5,a6", "A,0,600,400,0,0,0,0,0,0", "A,1,620,410,0,0,0,0,0,0"]
    rows += ["A,2,640,420,90,-45,30,10,20,30", "A,3,660,430,90,-45,30,10,20,30"]
    (tmp_path / "v.csv").write_text("\n".join(rows), encoding="utf-8")
    with pytest.raises(InputError, match=r"v\.csv: rows 2 and 4 are of view 'A', but the arm stands otherwise in them"):
        read_observations([tmp_path / "v.csv"], load_arm("ur5").nominal, tmp_path / "v.toml")
