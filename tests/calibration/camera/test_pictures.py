"""Pictures through the command: a real camera and board, and what is wrong with a folder, in one sentence each."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from pickenv.base import InputError
from pickenv.calibration import load_board, pose_carrier, read_lens, read_observations
from pickenv.calibration.identification.diagnosis import without_blind_views
from pickenv.calibration.reading.description import DESCRIPTIONS
from pickenv.cli import app


def call(*words: object) -> str:
    done = CliRunner().invoke(app, [str(word) for word in words], catch_exceptions=False)
    assert done.exit_code == 0, done.output
    return done.output


@pytest.fixture(scope="module")
def ical(data_folder: Path) -> Path:
    folder = data_folder / "ical_charuco"
    if not folder.is_dir():
        pytest.skip(f"no pictures in {folder}")
    return folder


@pytest.mark.slow
@pytest.mark.parametrize(
    ("lens", "rms", "left_out"),
    [
        pytest.param("fixed", 2.62, 3.3, id="as given", marks=pytest.mark.slow),
        pytest.param("free", 1.10, 1.6, id="fitted"),
    ],
)
def test_a_real_camera(lens: str, rms: float, left_out: float, ical: Path, tmp_path: Path) -> None:
    """Bounds: a plain bundle adjustment of the same pictures, 2.61 and 3.28 px, 1.09 and 1.58 px."""
    file, columns = tmp_path / "found.json", tmp_path / "mine.toml"
    text = (DESCRIPTIONS / "ical_charuco.toml").read_text(encoding="utf-8")
    columns.write_text(text.replace("[camera]", f'[camera]\nlens = "{lens}"'), encoding="utf-8")
    said = call("calibrate", ical, "--columns", columns, "--json", file, "--lens-out", tmp_path / "a.yaml")
    found = json.loads(file.read_text())
    assert found["kind"] == "pixels" and found["views"] == 15 and found["corners"] == 309
    assert 0.9 * rms < found["rms_px"] <= rms
    assert found["leave_one_out_px"] <= left_out
    assert f"{found['leave_one_out_px']:#.4g} px" in said
    (gone,) = found["left_out_rows"]
    assert gone["position"] is None and gone["line"] == 3
    assert "NaN" not in file.read_text()
    assert "1 corner found; a view needs 6" in said  # the third picture
    assert (found["lens"]["k1"] != 0.0) == (lens == "free")
    assert read_lens(tmp_path / "a.yaml").values.tolist() == list(found["lens"].values())
    by_view = np.array(found["leave_one_out_view_rms_px"])
    low, high = found["leave_one_out_mean_ci95_px"]
    assert len(by_view) == 15 and low < by_view.mean() < high


def test_a_lens_that_is_roughly_known_keeps_what_it_is_told(ical: Path, tmp_path: Path) -> None:
    """Focal lengths and centre to so many px, and the distortion to a number of its own."""
    prior = '[camera]\nlens = "prior"\nprior_px = 3.0\nprior_distortion = 0.02'
    folder, columns = views_folder(tmp_path, ical, ("[camera]", prior))
    lens = read_observations([folder], pose_carrier().nominal, columns).numbers
    assert lens.std.tolist() == [3.0] * 4 + [0.02] * 5 and lens.names[:5] == ("fx", "fy", "cx", "cy", "k1")


def views_folder(tmp_path: Path, ical: Path, change: tuple[str, str] | None = None) -> tuple[Path, Path]:
    """A few of the real views, and their description, changed."""
    folder = tmp_path / "views"
    for kind in ("images", "poses"):
        (folder / kind).mkdir(parents=True)
    for i in range(6):
        shutil.copyfile(ical / f"images/{i}.jpg", folder / f"images/{i}.jpg")
        shutil.copyfile(ical / f"poses/{i}.yaml", folder / f"poses/{i}.yaml")
    text = (DESCRIPTIONS / "ical_charuco.toml").read_text(encoding="utf-8")
    if change is not None:
        assert change[0] in text
        text = text.replace(*change)
    (tmp_path / "mine.toml").write_text(text)
    return folder, tmp_path / "mine.toml"


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("width = 1600", "width = 800"), r"row 1: the picture has 1600 x 1200 px, but the lens is for 800 x 1200"),
        (('dictionary = "6x6_250"', 'dictionary = "4x4_50"'), r"0\.jpg: no corner of the board was found; it shows"),
        (('picture = "images/{file}.jpg"', 'picture = "images/{file}.png"'), r"picture .*0\.png does not exist"),
        (('files = "poses/*.yaml"', 'files = "poses/*.txt"'), r"holds no file poses/\*\.txt"),
        (('convention = "quaternion_xyzw"', ""), r"convention of \[poses\] is missing|'convention'"),
        (("[camera]", "[conditions.payload]\ncolumn = 'm'\nunit = 'kg'\n\n[camera]"), r"\[conditions\] is not read"),
        (("[camera]", "[lens]"), r"\[camera\]|lens"),
        (("fx = 1352.02747\n", ""), r"\[camera\] needs file, or fx"),
    ],
)
def test_what_is_wrong_with_pictures(change: tuple[str, str], words: str, ical: Path, tmp_path: Path) -> None:
    folder, description = views_folder(tmp_path, ical, change)
    with pytest.raises(InputError, match=words) as caught:
        read_observations([folder], pose_carrier().nominal, description)
    assert "\n" not in str(caught.value)


def test_views_come_in_the_order_of_their_numbers(tmp_path: Path) -> None:
    (tmp_path / "poses").mkdir()
    for number in (10, 9, 2):
        pose = f"{{x: 0.{number}, y: 0, z: 1, qx: 0, qy: 0, qz: 0, qw: 1}}"
        (tmp_path / f"poses/{number}.yaml").write_text(pose, encoding="utf-8")
    with pytest.raises(InputError, match=r"row 1: picture .*images/2\.jpg does not exist"):
        read_observations([tmp_path], pose_carrier().nominal, "ical_charuco")


def test_a_mirrored_picture_is_named(ical: Path, tmp_path: Path) -> None:
    folder, description = views_folder(tmp_path, ical)
    picture = cv2.imread(str(folder / "images/3.jpg"))
    cv2.imwrite(str(folder / "images/3.jpg"), picture[:, ::-1])
    views = read_observations([folder], pose_carrier().nominal, description)
    _, left = without_blind_views(views)
    (said,) = [item.why for item in left if item.line == 4]
    assert re.search(r"3\.jpg: no corner of the board was found; it is mirrored", said)
    for other in (1, 4):  # three of six: no longer a slip
        mirrored = cv2.imread(str(folder / f"images/{other}.jpg"))[:, ::-1]
        cv2.imwrite(str(folder / f"images/{other}.jpg"), mirrored)
    with pytest.raises(InputError, match=r"1\.jpg: no corner of the board was found; it is mirrored"):
        read_observations([folder], pose_carrier().nominal, description)
    (folder / "images/3.jpg").write_text("no picture")
    with pytest.raises(InputError, match=r"3\.jpg is no picture that OpenCV can read"):
        read_observations([folder], pose_carrier().nominal, description)


def test_the_same_view_twice_is_refused(ical: Path, tmp_path: Path) -> None:
    folder, description = views_folder(tmp_path, ical)
    shutil.copyfile(folder / "images/2.jpg", folder / "images/6.jpg")
    shutil.copyfile(folder / "poses/2.yaml", folder / "poses/6.yaml")
    with pytest.raises(InputError, match="row 7 repeats row 3 to the last digit"):
        read_observations([folder], pose_carrier().nominal, description)


def test_an_arm_beside_finished_poses_and_a_lens_without_pictures_are_refused(ical: Path, tmp_path: Path) -> None:
    folder, _ = views_folder(tmp_path, ical)
    for words, said in (
        (["calibrate", folder, "--columns", "ical_charuco", "--arm", "ur5"], "leave the arm out"),
        (["calibrate", folder, "--columns", "ical_charuco", "--test-rows", "3"], "every row, or picture, is held out"),
        (["calibrate", tmp_path / "x.csv"], "no arm is given"),
    ):
        with pytest.raises(InputError, match=said):
            call(*words)


def test_a_table_of_corners_is_the_pictures(ical: Path, tmp_path: Path) -> None:
    """The same corners from a table: the same views."""
    folder, _ = views_folder(tmp_path, ical)
    whole = read_observations([folder], pose_carrier().nominal, "ical_charuco")
    lines = ["view,corner,u,v,x,y,z,qx,qy,qz,qw"]
    poses = [json.loads(json.dumps(_pose(folder / f"poses/{i}.yaml"))) for i in range(6)]
    for view, (pose, seen, corners) in enumerate(zip(poses, whole.seen, whole.corners, strict=True)):  # type: ignore[attr-defined]
        for number in np.flatnonzero(seen):
            u, v = corners[number].tolist()
            lines.append(",".join(map(repr, [view, int(number), u, v, *pose])))
    (tmp_path / "corners.csv").write_text("\n".join(lines) + "\n")
    text = (DESCRIPTIONS / "ical_charuco.toml").read_text(encoding="utf-8")
    text = text.replace(
        'files = "poses/*.yaml"\npicture = "images/{file}.jpg"\n',
        'columns = ["u", "v"]\nview = "view"\ncorner = "corner"\n',
    )
    (tmp_path / "corners.toml").write_text(text)
    table, layout = [tmp_path / "corners.csv"], tmp_path / "corners.toml"
    found = read_observations(table, pose_carrier().nominal, layout)
    np.testing.assert_array_equal(found.seen, whole.seen)  # type: ignore[attr-defined]
    np.testing.assert_allclose(found.joints, whole.joints, atol=1e-12)
    np.testing.assert_allclose(found.corners[found.seen], whole.corners[whole.seen], atol=1e-9)  # type: ignore[attr-defined]
    broken = (tmp_path / "corners.csv").read_text().replace("\n0,0,", "\n0,99,", 1)
    (tmp_path / "corners.csv").write_text(broken)
    with pytest.raises(InputError, match=r"row 2: corner 99 is none of the board's 24"):
        read_observations(table, pose_carrier().nominal, layout)


FINISHED = """
[pixels]
mount = "hand"
columns = ["u", "v"]
view = "view"
corner = "corner"
[poses]
columns = ["x", "y", "z"]
unit = "mm"
rotation_columns = ["a", "b", "c"]
rotation_unit = "deg"
convention = "kuka_abc"
[board]
kind = "chessboard"
columns = 4
rows = 3
square_mm = 30
[camera]
fx = 600.0
fy = 600.0
cx = 320.0
cy = 240.0
width = 640
height = 480
"""


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('rotation_unit = "deg"\n', "", r"rotation_unit of \[poses\] is missing; give one of deg, rad"),
        ('"deg"', '"rad"', r"row 2, column 'a' is 40 rad, which no rotation needs; its unit is probably deg"),
        ('["x", "y", "z"]', '["x", "y"]', r"\[poses\] has 2 columns; give three"),
        ('["x", "y", "z"]', '["x", "y", "y"]', r"'y' is given for column 2 of \[poses\] and for column 3"),
        ('["a", "b", "c"]', '["a", "b"]', r"convention 'kuka_abc' needs 3 columns, but \[poses\] has 2"),
        (
            '"c"]\nrotation_unit = "deg"\nconvention = "kuka_abc"',
            '"c", "w"]\nrotation_unit = "deg"\nconvention = "abb_quaternion"',
            r"rotation_unit of \[poses\] is 'deg', but 'a' begins a quaternion",
        ),
        ("kuka_abc", "abb_quaternion", r"convention 'abb_quaternion' needs 4 columns, but \[poses\] has 3"),
        (
            '"c"]\nrotation_unit = "deg"\nconvention = "kuka_abc"',
            '"c", "x"]\nconvention = "abb_quaternion"',
            "'x' is given",
        ),
        (
            '"c"]\nrotation_unit = "deg"\nconvention = "kuka_abc"',
            '"c", "w"]\nconvention = "abb_quaternion"',
            "not of unit",
        ),
    ],
)
def test_finished_poses_are_checked_as_measured_ones_are(old: str, new: str, words: str, tmp_path: Path) -> None:
    (tmp_path / "views.csv").write_text("view,corner,u,v,x,y,z,a,b,c,w\n0,0,1,2,300,400,500,40,-20,30,1\n")
    assert old in FINISHED
    (tmp_path / "mine.toml").write_text(FINISHED.replace(old, new))
    with pytest.raises(InputError, match=words):
        read_observations([tmp_path / "views.csv"], pose_carrier().nominal, tmp_path / "mine.toml")


def _pose(path: Path) -> list[float]:
    pairs = dict(line.split(": ") for line in path.read_text().split("\n") if line.strip())
    return [float(pairs[name]) for name in ("x", "y", "z", "qx", "qy", "qz", "qw")]


def test_the_shipped_description_is_of_its_board() -> None:
    from pickenv.calibration import load_description

    views = load_description("ical_charuco")
    assert views is not None and views.board is not None
    assert len(views.board.corners) == 24 and views.board != load_board("charuco_a4")
