"""The way of a printed board and a webcam: pictures and joint readings of an SO-101, a calibrated arm, its commands.

The arm is simulated: the published SO-101 with links 0.7 mm and 1.2 deg off, a camera on its wrist or before it.
"""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from pickenv.arm import Arm, Geometry, Pose, forward, load_arm, rotation_matrix
from pickenv.calibration import (
    ArmModel,
    Board,
    Calibration,
    Lens,
    Measurements,
    PixelObservations,
    frames_model,
    identify,
    prior_model,
    projected,
    random_joints,
)
from pickenv.calibration.identification.solve import solve
from pickenv.cli import app
from tests.calibration.camera.conftest import render
from tests.conftest import unwritten_figures
from tests.journeys.test_screens import WIDTH, check

LENS = Lens(np.array([620.0, 622.0, 323.0, 238.0, -0.08, 0.05, 0.0008, -0.0005, 0.01]), (640, 480))
BOARD = Board(kind="charuco", columns=7, rows=5, square=0.025, marker=0.018, dictionary="5x5_100")
NOISE = 0.3
"""px."""

DIM = (25.0, 1.2)
"""Noise in grey values and blur in px of a cheap camera in dim light: corners lie 0.25 to 0.45 px off (measured)."""

DESCRIPTION = """
description = "SO-101 and a board"

[joints]
columns = ["shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll"]
unit = "deg"

[pixels]
mount = "{mount}"
{found}

[board]
kind = "charuco"
columns = 7
rows = 5
square_mm = 25.0
marker_mm = 18.0
dictionary = "5x5_100"

[camera]
fx = 620.0
fy = 622.0
cx = 323.0
cy = 238.0
distortion = [-0.08, 0.05, 0.0008, -0.0005, 0.01]
width = 640
height = 480
lens = "{lens}"
"""
TABLE = 'view = "view"\ncorner = "corner"\ncolumns = ["x", "y"]'


@pytest.fixture(scope="module")
def so101(data_folder: Path) -> str:
    file = data_folder / "so101/so101_new_calib.urdf"
    if not file.is_file():
        pytest.skip(f"no {file}")
    return f"{file}#gripper_frame_link"


def off(arm: Arm, rng: np.random.Generator) -> Geometry:
    """The arm as it was printed and put together."""
    count = arm.nominal.links
    length, angle = 0.7e-3, np.radians(1.2)
    sizes = np.concatenate([np.repeat([angle, length, angle, length], count), np.zeros(count + 12)])
    return arm.nominal.displaced(sizes * rng.normal(size=len(sizes)))


def after(first: Pose, second: Pose) -> Pose:
    return Pose(first.position + first.rotation @ second.position, first.rotation @ second.rotation)


def back(pose: Pose) -> Pose:
    return Pose(-pose.rotation.T @ pose.position, pose.rotation.T)


def axes(forwards: np.ndarray, right: np.ndarray) -> np.ndarray:
    """The axes of a camera that looks along ``forwards``."""
    z = forwards / np.linalg.norm(forwards)
    x = right - right @ z * z
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z], axis=1)


def set_up(arm: Arm, geometry: Geometry, mount: str) -> Geometry:
    """The arm with a camera beside its gripper over a board on the table, or a board in the gripper before a camera."""
    tip, right = arm.nominal.tool.position, np.array([0.0, 1.0, 0.0])
    look = axes(tip, right)
    if mount == "hand":
        board = Pose(np.array([0.20, 0.06, 0.01]), np.diag([1.0, -1.0, -1.0]))
        camera = Pose(0.3 * tip + 0.05 * look[:, 1], look @ rotation_matrix(np.array([0.35, 0.1, 0.05])))
        return replace(geometry, base=after(back(board), geometry.base), tool=camera)
    camera = Pose(np.array([0.5, 0.0, 0.25]), axes(np.array([-1.0, 0.0, -0.25]), right))
    board = Pose(0.8 * tip, look @ np.diag([1.0, -1.0, -1.0]))
    return replace(geometry, base=after(back(camera), geometry.base), tool=board)


def views_of(geometry: Geometry, mount: str, count: int, rng: np.random.Generator) -> PixelObservations:
    """Views with at least half of the board in the picture, not too slant."""
    joints, corners = random_joints(geometry, 60_000, rng), len(BOARD.corners)
    blank = np.zeros((len(joints), corners, 2))
    whole = PixelObservations(
        joints, blank, blank[..., 0] == 0.0, BOARD.corners, LENS, np.zeros(9), blank[..., 0] + NOISE, mount=mount
    )  # type: ignore[arg-type]
    there = whole.in_camera(ArmModel.of(geometry))
    near = (there[..., 2] > 0.07) & (there[..., 2] < 0.4) & (np.abs(there[..., :2]) < 0.7 * there[..., 2:]).all(-1)
    seen = projected(LENS.values, np.where(near[..., None], there, [0.0, 0.0, 1.0]))
    near &= ((seen > 5.0) & (seen < np.array(LENS.size) - 5.0)).all(-1)
    last = BOARD.columns - 2
    normal = np.cross(there[:, last] - there[:, 0], there[:, -1] - there[:, last])
    facing = normal[:, 2] > 0.6 * np.linalg.norm(normal, axis=1)
    rows = np.flatnonzero((near.mean(axis=1) > 0.5) & facing)[:count]
    return replace(whole.select(rows), corners=seen[rows], seen=near[rows])


def write_table(folder: Path, arm: Arm, data: PixelObservations, rng: np.random.Generator) -> Path:
    """A row for each corner found."""
    file = folder / "corners.csv"
    with file.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        writer.writerow([*arm.nominal.joint_names, "view", "corner", "x", "y"])
        for view, corner in np.argwhere(data.seen):
            x, y = data.corners[view, corner] + NOISE * rng.normal(size=2)
            writer.writerow([*np.degrees(data.joints[view]), view, corner, x, y])
    return file


def write_pictures(
    folder: Path, arm: Arm, geometry: Geometry, data: PixelObservations, rng: np.random.Generator
) -> Path:
    """A row for each picture, and the pictures."""
    import cv2

    pose, file = forward(geometry, data.joints), folder / "views.csv"
    with file.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        writer.writerow([*arm.nominal.joint_names, "image"])
        for view, joints in enumerate(data.joints):
            seen = Pose(pose.position[view], pose.rotation[view])
            picture = render(BOARD, LENS, back(seen) if data.mount == "hand" else seen, rng, *DIM)
            cv2.imwrite(str(folder / f"{view}.png"), picture)
            writer.writerow([*np.degrees(joints), f"{view}.png"])
    return file


def call(*words: object) -> str:
    done = CliRunner().invoke(app, [str(word) for word in words], catch_exceptions=False, env={"COLUMNS": str(WIDTH)})
    assert done.exit_code == 0, done.output
    return done.output


def walk(so101: str, folder: Path, mount: str, seed: int, pictures: bool, lens: str = "fixed") -> dict[str, Any]:
    """From views to a corrected arm; errors are against the true arm, where nothing was fitted."""
    rng, arm = np.random.default_rng(seed), load_arm(so101)
    true = set_up(arm, off(arm, rng), mount)
    data = views_of(true, mount, 80, rng)
    train, there = data.select(np.arange(40)), data.joints[40:]
    file = write_pictures(folder, arm, true, train, rng) if pictures else write_table(folder, arm, train, rng)
    description, saved, figures = folder / "views.toml", folder / "arm.npz", folder / "arm.json"
    found = 'picture = "image"' if pictures else TABLE
    description.write_text(DESCRIPTION.format(mount=mount, lens=lens, found=found), encoding="utf-8")
    options = ["--columns", description, "--out", saved, "--json", figures, "--report", folder / "arm.html"]
    with unwritten_figures():
        said = call("calibrate", file, "--arm", so101, *options)
    calibration, shown = Calibration.load(saved), json.loads(figures.read_text(encoding="utf-8"))
    missed = {
        name: float(np.sqrt(np.mean(np.sum((forward(g, there).position - forward(true, there).position) ** 2, axis=1))))
        for name, g in (("nominal", calibration.nominal), ("calibrated", calibration.identified))
    }
    return {"said": said, "shown": shown, "missed": missed, "true": arm.nominal.difference(true), "arm": arm}


def zeros_in_sigma(walked: dict[str, Any]) -> dict[str, float]:
    """How many standard deviations each joint zero lies from the true one; with priors none is dropped."""
    true = dict(zip(walked["arm"].nominal.parameter_names, walked["true"], strict=True))
    return {
        row["name"]: (row["change"] - np.degrees(true[row["name"]])) / row["std"]
        for row in walked["shown"]["changes"]
        if row["name"].startswith("theta")
    }


@pytest.mark.slow
@pytest.mark.parametrize("mount", ["hand", pytest.param("world", marks=pytest.mark.slow)])
def test_corners_and_joints_correct_an_arm(so101: str, tmp_path: Path, mount: str) -> None:
    """Joint zeros within three sigma, and the tool nearer than a third of the nominal miss, where no view was taken.

    What is printed fits a screen.
    """
    walked = walk(so101, tmp_path, mount, 0, pictures=False)
    shown = walked["shown"]
    assert shown["kind"] == "pixels" and shown["views"] == 40
    assert shown["rms_px"] == pytest.approx(NOISE * np.sqrt(2), rel=0.08)
    assert shown["rms_px"] < shown["leave_one_out_px"] < 1.1 * shown["rms_px"]
    zeros = zeros_in_sigma(walked)
    assert len(zeros) == 5 and max(map(abs, zeros.values())) < 3.0, zeros
    assert walked["missed"]["calibrated"] < walked["missed"]["nominal"] / 3
    assert walked["missed"]["calibrated"] < 0.15e-3 and walked["missed"]["nominal"] > 2e-3
    check(walked["said"].rstrip("\n").splitlines())
    assert f"{shown['rms_px']:#.4g} px" in " ".join(walked["said"].split()) and (tmp_path / "arm.html").is_file()
    commands = tmp_path / "commands.csv"
    targets = tmp_path / "targets.csv"
    joints = [f"q{i + 1}_deg" for i in range(5)]
    targets.write_text(",".join(joints) + "\n0,-40,50,30,0\n10,-30,40,45,-20\n", encoding="utf-8")
    call("apply", tmp_path / "arm.npz", targets, "--arm", so101, "--out", commands)
    with commands.open(encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    assert [row["reached"] for row in rows] == ["yes", "yes"]
    assert all(float(row["predicted_error_mm"]) < float(row["uncorrected_error_mm"]) for row in rows)


@pytest.mark.slow
def test_a_camera_on_the_hand_and_one_in_the_world_are_one_fit_and_better_than_either(
    so101: str, tmp_path: Path
) -> None:
    """Each with its own description, its own board and frames; the arm is one."""
    rng, arm = np.random.default_rng(5), load_arm(so101)
    printed = off(arm, rng)
    files, descriptions = [], []
    for mount in ("hand", "world"):
        folder = tmp_path / mount
        folder.mkdir()
        files.append(write_table(folder, arm, views_of(set_up(arm, printed, mount), mount, 14, rng), rng))
        descriptions.append(folder / "views.toml")
        descriptions[-1].write_text(DESCRIPTION.format(mount=mount, lens="fixed", found=TABLE), encoding="utf-8")
    there, sizes = random_joints(printed, 200, rng), {}
    for name, chosen in (("hand", [0]), ("world", [1]), ("both", [0, 1])):
        saved, figures = tmp_path / f"{name}.npz", tmp_path / f"{name}.json"
        columns = [word for i in chosen for word in ("--columns", descriptions[i])]
        call("calibrate", *(files[i] for i in chosen), "--arm", so101, *columns, "--out", saved, "--json", figures)
        sizes[name] = inner_error(Calibration.load(saved).identified, printed, there)
        shown = json.loads(figures.read_text(encoding="utf-8"))
        assert shown["kind"] == "pixels" and shown["rows"]["train"] >= 12 * len(chosen)
    nominal = inner_error(arm.nominal, printed, there)
    assert sizes["both"] < min(sizes["hand"], sizes["world"]) and sizes["both"] < nominal / 10


def inner_error(found: Geometry, true: Geometry, joints: np.ndarray) -> float:
    """What a geometry misses by, m RMS, where its own base and tool are laid onto the true ones as well as they can."""
    found = replace(found, base=true.base, tool=true.tool)
    model = frames_model(found)
    data = Measurements(joints, *forward(true, joints), found.prismatic)
    laid = identify(model, found, data, max_iterations=50).arm_model
    return float(np.sqrt(np.mean(np.sum(data.difference(laid)[:, :3] ** 2, axis=1))))


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("mount", ["hand", "world"])
def test_rendered_pictures_correct_an_arm(so101: str, tmp_path: Path, mount: str, seed: int) -> None:
    """The same from pictures, in which the corners have to be found."""
    pytest.importorskip("cv2")
    walked = walk(so101, tmp_path, mount, seed, pictures=True)
    zeros = zeros_in_sigma(walked)
    assert walked["shown"]["views"] >= 25 and 0.15 < walked["shown"]["rms_px"] < 0.5
    assert len(zeros) == 5 and max(map(abs, zeros.values())) < 3.0, zeros
    assert walked["missed"]["calibrated"] < walked["missed"]["nominal"] / 3


@pytest.mark.slow
@pytest.mark.parametrize(("scatter_deg", "noise"), [(0.0, 0.03), (0.02, 0.03), (0.02, NOISE)])
def test_what_is_printed_of_a_zero_holds_where_the_arm_scatters_under_sharp_pictures(
    so101: str, scatter_deg: float, noise: float
) -> None:
    """Twelve arms as printed: the pose behind a picture errs for all of its corners, and the zeros' sigmas know it."""
    arm, scores = load_arm(so101), []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        printed = off(arm, rng)
        true, start = (set_up(arm, g, "hand") for g in (printed, arm.nominal))
        clean = views_of(true, "hand", 40, rng)
        data = replace(
            clean,
            corners=clean.corners + noise * rng.normal(size=clean.corners.shape),
            joints=clean.joints + np.radians(scatter_deg) * rng.normal(size=clean.joints.shape),
        )
        found = solve(prior_model(arm.name, start, known=False, tolerances="printed"), data)
        change = dict(zip(start.parameter_names, start.difference(found.geometry), strict=True))
        wanted = dict(zip(start.parameter_names, arm.nominal.difference(printed), strict=True))
        known = dict(zip(found.identifiability.names, found.standard_deviation, strict=True))
        names = [f"theta{i + 1}" for i in range(5)]
        scores.append([(change[name] - wanted[name]) / known[name] for name in names])
    size = np.abs(np.array(scores))
    assert size.shape == (12, 5) and (size < 1.96).mean() > 0.85 and size.max() < 5.0
    assert 0.4 < np.sqrt(np.mean(size**2)) < 1.5
