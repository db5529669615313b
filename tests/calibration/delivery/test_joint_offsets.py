"""Joint offsets alone: exact where nothing else is off, honest in mm where more is, in each controller's own sign."""

import csv
import json
import re
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.optimize import least_squares
from scipy.stats import qmc

from pickenv.arm import Pose, forward, load_arm, pose_error
from pickenv.base import InputError
from pickenv.calibration import (
    ArmModel,
    Calibration,
    Measurements,
    export,
    fit,
    joint_offsets,
    random_joints,
)

LEROBOT = """{
    "shoulder_pan": {
        "id": 1,
        "drive_mode": 0,
        "homing_offset": -1276,
        "range_min": 974,
        "range_max": 3369
    },
    "shoulder_lift": {"id": 2, "drive_mode": 0, "homing_offset": -1609, "range_min": 820, "range_max": 3231},
    "elbow_flex": {"id": 3, "drive_mode": 0, "homing_offset": 1951, "range_min": 910, "range_max": 3122},
    "wrist_flex": {"id": 4, "drive_mode": 0, "homing_offset": -1413, "range_min": 920, "range_max": 3228},
    "wrist_roll": {"id": 5, "drive_mode": 0, "homing_offset": -1110, "range_min": 0, "range_max": 4095},
    "gripper": {"id": 6, "drive_mode": 0, "homing_offset": 1133, "range_min": 2015, "range_max": 3522}
}
"""
CONTROL = """<?xml version="1.0"?>
<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">
  <ros2_control name="arm" type="system">
    <hardware><plugin>dynamixel_hardware/DynamixelHardware</plugin></hardware>
    <joint name="shoulder_pan"><param name="id">1</param><param name="offset"> 0.25 </param></joint>
    <joint name="shoulder_lift">
      <param name="id">2</param>
    </joint>
    <joint name="elbow_flex"><param name="id">3</param></joint>
    <joint name="wrist_flex"><param name="id">4</param></joint>
    <joint name="wrist_roll"><param name="id">5</param></joint>
    <joint name="gripper"><param name="id">6</param><param name="offset">0.5</param></joint>
  </ros2_control>
</robot>
"""


def zeros_off(name: str, offsets: np.ndarray, frames: str = "known", base: Pose | None = None) -> Calibration:
    """A calibration that found the joints' zeros off, and nothing else."""
    arm = load_arm(name)
    shift = np.where(arm.nominal.prismatic, 0.0, offsets)
    nominal = arm.nominal if base is None else replace(arm.nominal, base=base)
    found = replace(nominal, theta=nominal.theta + shift, d=nominal.d + np.where(arm.nominal.prismatic, offsets, 0.0))
    return Calibration(arm.name, arm.nominal, nominal, ArmModel.of(found), None, {"frames": frames})


@given(seed=st.integers(0, 2**32 - 1), name=st.sampled_from(["so101", "ur5", "qiao2026", "panda"]))
@settings(max_examples=20)
def test_offsets_are_exact_where_nothing_else_is_off(seed, name):
    rng = np.random.default_rng(seed)
    offsets = rng.normal(size=load_arm(name).nominal.joints) * 0.02
    found = joint_offsets(zeros_off(name, offsets))
    np.testing.assert_allclose(found.offsets, offsets, atol=1e-9)
    assert found.left < 1e-9 < found.without and found.left_turn < 1e-9


def test_with_fitted_frames_the_first_and_the_last_zero_are_left_to_them(so101):
    """A base that turns about the first axis does what its zero does; so with the tool and the last."""
    offsets = np.array([0.05, 0.01, -0.02, 0.03, 0.04])
    found = joint_offsets(zeros_off("so101", offsets, "fitted"))
    assert found.offsets[0] == 0.0 and found.offsets[-1] == 0.0
    np.testing.assert_allclose(found.offsets[1:-1], offsets[1:-1], atol=1e-6)
    assert found.left < 1e-6
    assert found.note().endswith("of shoulder_pan, wrist_roll these data tell none")


@pytest.mark.parametrize("apart", [0.0, 1e-9])
def test_two_joints_on_one_axis_share_what_only_their_sum_tells(apart):
    """Axes a nanoradian apart are one axis: offsets that tell them apart would be thousands of turns."""
    arm = load_arm("so101").nominal
    tilted, reach = np.array([0.0, apart, np.pi / 2, 0.0, 0.5]), np.array([0.0, 0.0, 0.0, 0.3, 0.2])
    coaxial = replace(arm, alpha=tilted, a=reach, theta=np.zeros(5), d=np.array([0.1, 0.2, 0.0, 0.0, 0.1]))
    found = replace(coaxial, theta=np.array([0.03, -0.01, 0.02, 0.0, 0.0]))
    calibration = Calibration("coaxial", coaxial, coaxial, ArmModel.of(found), None, {"frames": "known"})
    offsets = joint_offsets(calibration)
    np.testing.assert_allclose(offsets.offsets, [0.01, 0.01, 0.02, 0.0, 0.0], atol=1e-6)
    assert offsets.left < 1e-6


def test_where_positions_alone_were_measured_positions_alone_count(made):
    """An attitude that no row told is not followed: the millimetres left are as few as offsets can make them."""
    rng, arm = np.random.default_rng(54), load_arm("so101")
    calibration, joints = made(arm, rng), random_joints(arm.nominal, 100, rng)
    positions = replace(calibration, record={**calibration.record, "kind": "position"})
    found, poses = joint_offsets(positions, joints), joint_offsets(calibration, joints)
    wanted = forward(calibration.identified, joints).position

    def missed(offsets: np.ndarray) -> np.ndarray:
        return (forward(arm.nominal, joints + offsets).position - wanted).ravel()

    best = least_squares(missed, np.zeros(5), xtol=1e-14, ftol=1e-14, gtol=1e-14)
    assert np.sum(missed(found.offsets) ** 2) == pytest.approx(np.sum(best.fun**2), rel=1e-6)
    assert found.left_turn is None and " deg" not in found.note() and " deg" in poses.note()
    assert found.left < poses.left


@pytest.mark.parametrize(
    ("name", "ranges", "said"),
    [
        ("ur5", None, "within the joint limits"),
        ("so101", [[-0.5, -0.2, 0.0, 0.1, -1.0], [0.5, 0.2, 0.4, 1.1, 1.0]], "within the ranges measured"),
    ],
)
def test_offsets_are_those_of_the_region_measured(made, name, ranges, said):
    """Filled by Halton's sequence, the same every time; of joints that turn on, half a turn to either side."""
    arm = load_arm(name)
    calibration = made(arm, np.random.default_rng(55))
    record = calibration.record if ranges is None else {**calibration.record, "joint_ranges": ranges}
    found = joint_offsets(replace(calibration, record=record))
    low, high = (-np.pi, np.pi) if ranges is None else np.array(ranges)
    unit = qmc.Halton(arm.nominal.joints, scramble=False).random(257)[1:]
    again = joint_offsets(calibration, low + (high - low) * unit)
    np.testing.assert_allclose(found.offsets, again.offsets, atol=1e-12)
    assert found.left == pytest.approx(again.left) and said in found.note() and found.poses == 256


def test_what_offsets_leave_out_is_what_no_other_offsets_avoid(made):
    """The millimetres stated are those of the best offsets, as SciPy finds them from the same poses."""
    rng, arm = np.random.default_rng(50), load_arm("so101")
    calibration = made(arm, rng)
    joints = random_joints(arm.nominal, 120, rng)
    found = joint_offsets(calibration, joints)
    wanted = forward(calibration.identified, joints)

    def missed(offsets: np.ndarray) -> np.ndarray:
        return pose_error(forward(arm.nominal, joints + offsets), wanted).ravel()

    best = least_squares(missed, np.zeros(5), xtol=1e-14, ftol=1e-14, gtol=1e-14)
    np.testing.assert_allclose(found.offsets, best.x, atol=1e-7)
    left = np.linalg.norm(best.fun.reshape(-1, 6)[:, :3], axis=1).mean()
    raw = np.linalg.norm(forward(arm.nominal, joints).position - wanted.position, axis=1).mean()
    assert found.left == pytest.approx(left, rel=1e-6) and found.without == pytest.approx(raw) and 1e-4 < left < raw
    assert found.note().endswith("the rest of the calibration is left out")
    assert f"with these offsets {left * 1e3:.3g} mm" in found.note()


@pytest.mark.slow
def test_deviations_are_those_of_repeated_measurements():
    """Calibrated again and again from fresh noise, offsets scatter as the calibration says; 60 runs tell it to 9 %."""
    arm, rng = load_arm("so101"), np.random.default_rng(51)
    true = replace(arm.nominal, theta=arm.nominal.theta + rng.normal(size=5) * 0.02)
    joints = random_joints(arm.nominal, 40, rng)
    pose, region, found = forward(true, joints), random_joints(arm.nominal, 60, rng), []
    for _ in range(60):
        position = pose.position + rng.normal(size=pose.position.shape) * 3e-4
        turn = [np.eye(3) + 1e-3 * np.cross(np.eye(3), rng.normal(size=3)) for _ in joints]
        data = Measurements(joints, position, np.array(turn) @ pose.rotation, arm.nominal.prismatic, 3e-4, 1e-3)
        result = fit(arm, data, known_frames=True)
        record = {
            **result.calibration.record,
            "uncertainty": {
                "parameters": list(result.identification.identifiability.kept_names),
                "covariance": result.identification.covariance.tolist(),
                "position_repeat_m": 0.0,
                "attitude_repeat_rad": None,
            },
        }
        found.append(joint_offsets(replace(result.calibration, record=record), region))
    scatter = np.std([one.offsets for one in found], axis=0, ddof=1)
    said = np.sqrt(np.mean([one.deviation**2 for one in found], axis=0))
    np.testing.assert_allclose(scatter, said, rtol=0.35)


def test_tables_hold_degrees_millimetres_and_counts(tmp_path):
    offsets = np.array([0.01, -0.02, 0.003, 0.0, 0.05])
    calibration = zeros_off("so101", offsets)
    done = export(calibration, tmp_path / "o.csv", kind="offsets", counts_per_turn=4096)
    lines = done.path.read_text().splitlines()
    assert lines[0] == "# pickenv joint offsets 1" and any("joint offsets alone" in line for line in lines)
    rows = list(csv.DictReader(line for line in lines if not line.startswith("#")))
    np.testing.assert_allclose([float(row["add_to_reading"]) for row in rows], np.degrees(offsets), atol=1e-9)
    assert [int(row["counts"]) for row in rows] == [7, -13, 2, 0, 33]
    again = json.loads(export(calibration, tmp_path / "o.json", kind="offsets").path.read_text())
    assert again["format"] == "pickenv joint offsets 1" and "counts" not in again["rows"][0]
    assert [row["unit"] for row in again["rows"]] == ["deg"] * 5
    assert [row["standard_deviation"] for row in again["rows"]] == [None] * 5  # not known: null, for JSON has no NaN
    slides = export(zeros_off("qiao2026", np.full(6, 1e-3)), tmp_path / "q.json", kind="offsets", counts_per_turn=4096)
    rows = json.loads(slides.path.read_text())["rows"]
    assert rows[1]["unit"] == "mm" and rows[1]["add_to_reading"] == pytest.approx(1.0) and rows[1]["counts"] is None


def reported(raw: np.ndarray, offsets: dict[str, float], names: tuple[str, ...]) -> np.ndarray:
    """What dynamixel_hardware reports: raw - offset."""
    return raw - np.array([offsets[name] for name in names])


def ros2_offsets_in(path):
    """Offsets of a description's ros2_control joints, as another program reads them."""
    joints = ElementTree.parse(path).getroot().iter("ros2_control")
    found = {joint.get("name"): joint.find("param[@name='offset']") for part in joints for joint in part.iter("joint")}
    return {name: 0.0 if param is None else float(param.text) for name, param in found.items()}


@pytest.mark.parametrize("onto", [False, True])
def test_ros2_control_reports_where_the_arm_stands(tmp_path, onto):
    """With the new parameters the nominal arm at what is reported is the true arm; existing offsets are kept in it."""
    rng, arm = np.random.default_rng(52), load_arm("so101")
    offsets = rng.normal(size=5) * 0.02
    calibration = zeros_off("so101", offsets)
    own = tmp_path / "robot.urdf.xacro"
    own.write_text(CONTROL)
    out = tmp_path / "out.xml"
    done = export(calibration, out, kind="ros2-control", onto=own if onto else None)
    before = ros2_offsets_in(own) if onto else dict.fromkeys(arm.nominal.joint_names, 0.0)
    after = ros2_offsets_in(out)
    raw = random_joints(arm.nominal, 50, rng)
    was, now = (reported(raw, values, arm.nominal.joint_names) for values in (before, after))
    true = forward(calibration.identified, was)  # what was reported is what the calibration was told
    np.testing.assert_allclose(pose_error(forward(arm.nominal, now), true), 0.0, atol=1e-9)
    assert "joint offsets alone" in done.notes[0]
    if onto:
        assert before["shoulder_pan"] == 0.25 and after["gripper"] == 0.5
        kept = re.sub(r'\s*<param name="offset">[^<]*</param>', "", out.read_text())
        assert kept == re.sub(r'\s*<param name="offset">[^<]*</param>', "", CONTROL)


def test_a_joint_whose_tag_closes_itself_gets_its_offset_too(tmp_path):
    own, out = tmp_path / "robot.urdf", tmp_path / "out.urdf"
    own.write_text(
        CONTROL.replace('<joint name="elbow_flex"><param name="id">3</param></joint>', '<joint name="elbow_flex" />')
    )
    export(zeros_off("so101", np.full(5, 0.02)), out, kind="ros2-control", onto=own)
    assert ros2_offsets_in(out)["elbow_flex"] == pytest.approx(-0.02)
    assert all(part.find("param") is None for part in ElementTree.parse(out).getroot().iter("ros2_control"))


def test_a_description_without_the_joint_is_refused(tmp_path):
    own = tmp_path / "robot.urdf"
    own.write_text(CONTROL.replace('"wrist_flex"', '"wrist"'))
    with pytest.raises(InputError, match="has no <ros2_control> joint 'wrist_flex', only shoulder_pan"):
        export(zeros_off("so101", np.zeros(5)), tmp_path / "o.xml", kind="ros2-control", onto=own)
    own.write_text(CONTROL.replace("ros2_control", "control"))
    with pytest.raises(InputError, match="no <ros2_control> joint at all"):
        export(zeros_off("so101", np.zeros(5)), tmp_path / "o.xml", kind="ros2-control", onto=own)


@pytest.fixture
def follower(tmp_path):
    path = tmp_path / "follower.json"
    path.write_text(LEROBOT)
    return path


def degrees_read(servo, actual: np.ndarray) -> np.ndarray:
    """What LeRobot gives as degrees at an actual position: Present = Actual - Homing, centred on the range."""
    present = actual - servo["homing_offset"]
    return (present - (servo["range_min"] + servo["range_max"]) / 2) * 360 / 4095


def test_lerobot_reads_where_the_arm_stands(follower, tmp_path):
    """To half a count per joint, the rounding of a homing offset."""
    rng, arm = np.random.default_rng(53), load_arm("so101")
    offsets = rng.normal(size=5) * 0.03
    follower.write_bytes(b"\xef\xbb\xbf" + LEROBOT.replace("\n", "\r\n").encode())
    done = export(zeros_off("so101", offsets), tmp_path / "new.json", onto=follower)
    before, after = (json.loads(path.read_text(encoding="utf-8-sig")) for path in (follower, done.path))
    assert list(before) == list(after) and before["gripper"] == after["gripper"]
    for name, offset in zip(arm.nominal.joint_names, offsets, strict=True):
        assert after[name] | {"homing_offset": before[name]["homing_offset"]} == before[name]
        actual = np.arange(0, 4096, 37)
        gained = degrees_read(after[name], actual) - degrees_read(before[name], actual)
        np.testing.assert_allclose(gained, np.degrees(offset), atol=0.5 * 360 / 4095 + 1e-9)
    old, new = (re.sub(rb'"homing_offset": -?\d+', b"", path.read_bytes()) for path in (follower, done.path))
    assert old == new
    assert any("rounding to whole counts" in note for note in done.notes)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (
            '{"homing_offset": [1, 2], "drive_mode": [0, 0], "motor_names": ["a", "b"]}',
            "before its redesign of June 2025",
        ),
        ("[]", "names no motors"),
        (
            LEROBOT.replace('"range_max": 3231', '"range": 3231'),
            "motor 'shoulder_lift' has no whole number 'range_max'",
        ),
        (LEROBOT.replace('"wrist_flex"', '"wrist"'), "has no motor 'wrist_flex', only shoulder_pan"),
        (LEROBOT.replace('"drive_mode": 0', '"drive_mode": 1'), "has drive_mode 1"),
        (LEROBOT.replace("1951", "2040"), "would need a homing offset of 2073 counts"),
        ("{", "is not valid JSON"),
        (LEROBOT.replace('"elbow_flex": {', '"elbow_flex": {"note": {},'), "is not where LeRobot writes it"),
    ],
    ids=["old", "list", "field", "motor", "drive mode", "too far", "no JSON", "nested"],
)
def test_a_lerobot_file_that_will_not_do_is_one_sentence(tmp_path, text, said):
    path = tmp_path / "follower.json"
    path.write_text(text)
    with pytest.raises(InputError, match=said) as found:
        export(zeros_off("so101", np.array([0.0, 0.0, -0.05, 0.0, 0.0])), tmp_path / "o.json", onto=path)
    assert "\n" not in str(found.value) and not (tmp_path / "o.json").exists()


def test_terms_that_need_conditions_are_no_offsets(made, qiao):
    from pickenv.calibration import ThermalTerm

    calibration = made(qiao, np.random.default_rng(0))
    heated = replace(calibration, model=ArmModel.of(calibration.identified, (ThermalTerm(),)))
    with pytest.raises(InputError, match="offsets cannot follow this calibration's terms: thermal expansion"):
        joint_offsets(heated)
