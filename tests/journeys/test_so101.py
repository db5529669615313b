"""The way of an SO-101's owner, as docs/so101.md prints it: a printed board, pictures, offsets, commands.

The owner's arm is drawn: a printed SO-101 with the free play and friction that its users measured. What a servo gives
under load its encoder shows, and LeRobot reads encoders, so the readings here lack the plant's compliance.
"""

import csv
import json
import re
import shlex
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.main import get_command

from pickenv.arm import Geometry, Pace, Plant, Pose, draw_arms, forward, load_arm, moved, plant_at, pose_of, switched_on
from pickenv.calibration import Calibration
from pickenv.cli import app
from pickenv.experiments import load_study
from tests.calibration.camera.conftest import render
from tests.journeys.test_camera import BOARD, DIM, LENS, after, back, call, set_up, views_of

PAGE = (Path(__file__).parents[2] / "docs/so101.md").read_text(encoding="utf-8")
BLOCK = re.compile(r"^```(\w+)(?: +(\S+))?\n(.*?)^```$", re.MULTILINE | re.DOTALL)
LINES = [line for kind, _, text in BLOCK.findall(PAGE) if kind == "sh" for line in text.splitlines()]
VIEWS = 60
MOTORS = {
    name: {"id": i + 1, "drive_mode": 0, "homing_offset": 10 * i, "range_min": 900, "range_max": 3200}
    for i, name in enumerate((*load_arm("so101").nominal.joint_names, "gripper"))
}
"""What LeRobot keeps of the owner's arm."""


def owned(seed: int) -> Plant:
    """An arm as its owner built it."""
    arms = draw_arms("printed:so101", "printed", 1, np.random.default_rng(seed), without=["joint_compliance"])
    return plant_at(arms, 0)


def reached(plant: Plant, joints: np.ndarray, before: np.ndarray) -> Pose:
    """Where the tool stands at joint commands, each driven to from others."""
    state = switched_on(plant, np, before, 0.0)
    return pose_of(moved(plant, np, state, before, joints, Pace(period=0.1, dwell=1.0))[1])


def same_side(joints: np.ndarray) -> np.ndarray:
    """Every joint comes from 5 degrees below, as the page says."""
    return joints - np.radians(5.0)


def photographed(plant: Plant, folder: Path, rng: np.random.Generator) -> tuple[Plant, Pose]:
    """Photograph the board on the table and note the joints: the arm with its camera, and where the board lies."""
    import cv2

    arm, there = plant.arm, set_up(plant.arm, plant.geometry, "hand")
    board = after(plant.geometry.base, back(there.base))  # in the arm's own base frame
    joints = views_of(there, "hand", VIEWS, rng).joints
    eye = replace(plant, geometry=replace(plant.geometry, tool=there.tool))
    pose = reached(eye, joints, same_side(joints))
    (folder / "views").mkdir()
    with (folder / "views.csv").open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        writer.writerow([*arm.nominal.joint_names, "image"])
        for view, read in enumerate(np.degrees(joints)):
            camera = after(back(board), Pose(pose.position[view], pose.rotation[view]))
            cv2.imwrite(str(folder / f"views/{view}.png"), render(BOARD, LENS, back(camera), rng, *DIM))
            writer.writerow([*np.round(read, 3), f"views/{view}.png"])
    return eye, board


def test_every_command_and_option_of_the_page_exists() -> None:
    commands = get_command(app).commands
    for line in LINES:
        program, command, *words = shlex.split(line)
        assert program == "pickenv" and command in commands
        options = {option for parameter in commands[command].params for option in parameter.opts}
        assert {word for word in words if word.startswith("--")} <= options
    assert {shlex.split(line)[1] for line in LINES} >= {"board", "calibrate", "apply", "export", "iso9283", "study"}


@pytest.fixture(scope="module")
def walked(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Plant, Pose, str]:
    """The page's commands, run in order in a folder with the owner's pictures; the study is run elsewhere."""
    pytest.importorskip("cv2")
    folder, plant = tmp_path_factory.mktemp("owner"), owned(0)
    (folder / "follower.json").write_text(json.dumps(MOTORS), encoding="utf-8")
    eye, board = photographed(plant, folder, np.random.default_rng(1))
    said = ""
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for kind, name, text in BLOCK.findall(PAGE):
            if name:
                (folder / name).write_text(text, encoding="utf-8")
            for line in text.splitlines() if kind == "sh" else ():
                if shlex.split(line)[1] != "study":
                    said += call(*shlex.split(line)[1:])
    return folder, eye, board, said


def missed(believed: Geometry, eye: Plant, board: Pose, before: str) -> float:
    """RMS distance of the camera from where it is believed, at joints where no picture was taken, mm."""
    rng = np.random.default_rng(7)
    there = set_up(eye.arm, replace(eye.geometry, tool=eye.arm.nominal.tool), "hand")
    joints = views_of(there, "hand", VIEWS, rng).joints
    start = same_side(joints) if before == "same side" else joints + np.radians(rng.uniform(-5, 5, joints.shape))
    true = (reached(eye, joints, start).position - board.position) @ board.rotation
    away = forward(believed, joints).position - true
    return 1e3 * float(np.sqrt(np.mean(np.sum(away**2, axis=-1))))


def stated(pattern: str) -> list[float]:
    """Numbers on the page."""
    found = re.search(pattern, PAGE)
    assert found is not None, pattern
    return [float(number) for number in found.groups()]


@pytest.mark.slow
def test_an_owner_gets_from_a_printed_board_to_a_corrected_arm(walked: tuple[Path, Plant, Pose, str]) -> None:
    """What the page prints is what its commands give; another machine's pictures may differ by a tenth."""
    folder, eye, board, _ = walked
    assert (folder / "board.pdf").stat().st_size > 1000 and (folder / "so101.html").is_file()
    calibration = Calibration.load(folder / "so101.npz")
    after_it, before_it = stated(r"to ([\d.]+) mm \(RMS\), the nominal arm to ([\d.]+) mm")
    assert missed(calibration.identified, eye, board, "same side") == pytest.approx(after_it, rel=0.1)
    assert missed(calibration.nominal, eye, board, "same side") == pytest.approx(before_it, rel=0.1)
    (careless,) = stated(r"the calibrated arm misses by ([\d.]+) mm")
    assert missed(calibration.identified, eye, board, "anywhere") == pytest.approx(careless, rel=0.1)
    assert after_it < before_it / 3 and careless > 1.5 * after_it
    shown = json.loads((folder / "so101.json").read_text(encoding="utf-8"))
    assert shown["verdict"]["grade"] == "good" and shown["views"] > 50
    assert shown["leave_one_out_px"] == pytest.approx(stated(r"\| calibrated \| [\d.]+ mm \| ([\d.]+) px")[0], rel=0.1)


@pytest.mark.slow
def test_commands_and_the_corrected_arm_say_the_same(walked: tuple[Path, Plant, Pose, str]) -> None:
    """Where commands.csv sends it, the exported arm stands nearly where the nominal arm was meant to."""
    folder, _, _, said = walked
    assert "3 of 3 targets can be reached" in said
    with (folder / "commands.csv").open(encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    assert all(float(row["predicted_error_mm"]) < 0.1 * float(row["uncorrected_error_mm"]) for row in rows)
    assert load_arm(folder / "my_so101.toml").nominal.joint_names == load_arm("so101").nominal.joint_names
    with (folder / "offsets.csv").open(encoding="utf-8") as stream:
        counts = [float(row["counts"]) for row in csv.DictReader(line for line in stream if line[0] != "#")]
    kept = json.loads((folder / "corrected.json").read_text(encoding="utf-8"))
    moved = {name: kept[name]["homing_offset"] - motor["homing_offset"] for name, motor in MOTORS.items()}
    assert moved.pop("gripper") == 0
    assert list(moved.values()) == pytest.approx([-each for each in counts], abs=1.0)
    assert max(map(abs, counts)) > 1.0


@pytest.mark.slow
def test_the_figures_of_repeatability_are_those_of_the_command(walked: tuple[Path, Plant, Pose, str]) -> None:
    said = walked[3]
    poses = re.findall(r"^P\d +([\d.]+) +([\d.]+) +[\d.]+ to [\d.]+ +[\d.]+ +[\d.]+ *([\d.]*)$", said, re.MULTILINE)
    columns = [[float(row[i]) for row in poses if row[i]] for i in range(3)]
    names = ("accuracy AP", "repeatability RP", "variation vAP")
    ranges = [stated(rf"\| {name}[^|]*\| ([\d.]+) to ([\d.]+) mm") for name in names]
    for column, ends in zip(columns, ranges, strict=True):
        assert [min(column), max(column)] == pytest.approx(ends, abs=0.06)
    assert max(columns[1]) < min(columns[2]) < max(columns[0])


def test_the_pages_study_is_of_this_arm_and_class() -> None:
    config = load_study(Path(__file__).parents[2] / "scripts/so101_study.toml")
    assert config.load_plant().arm.fingerprint() == load_arm("so101").fingerprint()
    arms, places = config.arms, config.fruit
    assert (
        arms == 60 and f"each calibrated and sent to {places} places" in PAGE and list(config.tolerances) == ["printed"]
    )
