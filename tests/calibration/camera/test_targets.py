"""Targets of points in space: where they stand in a view, and what a description may say of them."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

import pickenv
from pickenv.arm import Array, forward, load_arm, rotation_matrix
from pickenv.base import InputError
from pickenv.calibration import Choices, Lens, PixelObservations, load_description, projected, read_observations
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
            "stands in place of .board.; leave one of them out",
        ),
        (POINTS + 'dictionary = "apriltag_36h11"', "dictionary of .target. belongs to pictures; leave it out"),
        (POINTS + 'dictionary = "qr"', "dictionary of .target. is 'qr'; give one of 4x4_50"),
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


FACES = [
    rotation_matrix(np.array(turn) * np.pi / 2) for turn in ([0, 0, 0], [0, 1, 0], [0, -1, 0], [1, 0, 0], [-1, 0, 0])
]
"""Attitude of each face of a cube; its tag's picture has x and y of the face, and z points into the cube."""
SIDE, TAG = 0.06, 0.045
WIDE = Lens(np.array([700.0, 700.0, 320.0, 240.0, 0.0, 0.0, 0.0, 0.0, 0.0]), (640, 480))


def corners_of_face(turn: Array, side: float) -> Array:
    """The corners ``(4, 3)`` of a square in the middle of a face, clockwise from its upper left, m."""
    flat = 0.5 * np.array([[-side, -side, -SIDE], [side, -side, -SIDE], [side, side, -SIDE], [-side, side, -SIDE]])
    return np.asarray(flat @ turn.T)


def picture_of_cube(position: Array, rotation: Array) -> Array:
    """A picture of a cube with one tag on each face, in the camera's frame, four samples along each side of a pixel."""
    fine, tags = 4, cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    picture = np.full((480 * fine, 640 * fine), 120, dtype=np.uint8)
    for number, turn in enumerate(FACES):
        face = corners_of_face(turn, SIDE) @ rotation.T + position
        if face.mean(0) @ (rotation @ turn[:, 2]) < 0.0:  # seen from within
            continue
        size, margin = 320, round(320 * (SIDE / TAG - 1.0) / 2.0)
        drawn = np.pad(cv2.aruco.generateImageMarker(tags, 10 + number, size), margin, constant_values=255)
        ends = np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * len(drawn) - 0.5
        places = (projected(WIDE.values, face) + 0.5) * fine - 0.5
        warp = cv2.getPerspectiveTransform(ends.astype(np.float32), places.astype(np.float32))
        shape = picture.shape[::-1]
        cover = cv2.warpPerspective(np.full_like(drawn, 255), warp, shape, flags=cv2.INTER_NEAREST)
        picture = np.where(cover > 0, cv2.warpPerspective(drawn, warp, shape, flags=cv2.INTER_AREA), picture)
    return np.asarray(cv2.resize(picture, (640, 480), interpolation=cv2.INTER_AREA))


@pytest.fixture(scope="module")
def cube_taken(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Pictures of a cube on a UR5's flange, as a camera in the world takes them, with the joints beside them."""
    folder = tmp_path_factory.mktemp("cube")
    rng, nominal = np.random.default_rng(4), load_arm("ur5").nominal
    joints, rows = np.array([0.3, -1.2, 1.4, -0.6, 1.2, 0.2]), ["picture," + ",".join(f"a{i}" for i in range(1, 7))]
    middle = forward(nominal, joints).position
    camera = rotation_matrix(np.array([1.9, 0.4, 0.3]))  # its axes in the world, as columns
    for view in range(25):
        row = joints + rng.uniform(-1.0, 1.0, 6) * (0.1, 0.1, 0.1, 0.5, 0.5, 0.5)
        hand = forward(nominal, row)
        place = (hand.position - middle) @ camera + (0.0, 0.0, 0.55)
        cv2.imwrite(str(folder / f"{view}.png"), picture_of_cube(place, camera.T @ hand.rotation))
        rows.append(f"{view}.png," + ",".join(f"{np.degrees(angle):.9f}" for angle in row))
    (folder / "views.csv").write_text("\n".join(rows), encoding="utf-8")
    points = np.concatenate([corners_of_face(turn, TAG) for turn in FACES])
    lens = dict(zip(("fx", "fy", "cx", "cy", "width", "height"), [*WIDE.values[:4], *WIDE.size], strict=True))
    sections = {
        "joints": {"columns": [f"a{i}" for i in range(1, 7)], "unit": "deg"},
        "pixels": {"mount": "world", "picture": "picture"},
        "target": {
            "points_mm": (1e3 * points).round(6).ravel().tolist(),
            "numbers": list(range(40, 40 + len(points))),
            "dictionary": "apriltag_36h11",
        },
        "camera": lens,
    }
    lines = [
        f"[{name}]\n" + "".join(f"{key} = {json.dumps(value)}\n" for key, value in table.items())
        for name, table in sections.items()
    ]
    (folder / "views.toml").write_text("\n".join(lines), encoding="utf-8")
    return folder


@pytest.fixture
def cube_in_hand(cube_taken: Path, tmp_path: Path) -> Path:
    """A copy of these pictures, to be changed."""
    return Path(shutil.copytree(cube_taken, tmp_path / "cube"))


def test_a_cube_of_tags_is_found_in_pictures(cube_in_hand: Path) -> None:
    """One tag makes a view; corners lie about as near as those of a board's tags, 0.3 px in each direction."""
    result = pickenv.calibrate(
        "ur5",
        cube_in_hand / "views.csv",
        columns=cube_in_hand / "views.toml",
        choices=Choices(fit="offsets", terms="none"),
    )
    counts = result.train.seen.sum(axis=1)
    assert (counts % 4 == 0).all() and set(counts) == {4, 8, 12} and len(result.left_out) == 0
    assert result.as_dict()["rms_px"] < 1.5 * 0.3 * np.sqrt(2.0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (('dictionary = "apriltag_36h11"', ""), "dictionary of .target. is missing; pictures need it"),
        (("[40, ", "[60, "), None),
        (
            ("apriltag_36h11", "4x4_50"),
            "0.png: no tag of the target was found; of 4x4_50 it shows none; check .target.",
        ),
    ],
)
def test_a_cube_that_is_not_in_the_pictures_is_refused(
    cube_in_hand: Path, change: tuple[str, str], message: str | None
) -> None:
    path = cube_in_hand / "views.toml"
    path.write_text(path.read_text(encoding="utf-8").replace(*change), encoding="utf-8")
    if message is None:  # one corner of a tag is not looked for
        rows = read_observations([cube_in_hand / "views.csv"], load_arm("ur5").nominal, path)
        assert rows.seen.shape[1] == 20 and not rows.seen[:, 0].any() and rows.seen[:, 1].any()
        return
    with pytest.raises(InputError, match=message):
        read_observations([cube_in_hand / "views.csv"], load_arm("ur5").nominal, path)
