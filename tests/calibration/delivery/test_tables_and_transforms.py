"""Plain tables and transforms hold the same arm as the calibration, each by its own reader's rules."""

import csv
import json
import shlex
import shutil
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.spatial.transform import Rotation

from pickenv.arm import Pose, forward, from_standard_dh, load_arm, rotation_matrix
from pickenv.base import InputError
from pickenv.calibration import export, random_joints


def matrix(rotation: np.ndarray, position: np.ndarray) -> np.ndarray:
    found = np.eye(4)
    found[:3, :3], found[:3, 3] = rotation, position
    return found


def about(axis: str, angle: float) -> np.ndarray:
    return matrix(Rotation.from_euler(axis, angle).as_matrix(), np.zeros(3))


def along(axis: str, length: float) -> np.ndarray:
    return matrix(np.eye(3), length * np.eye(3)["xyz".index(axis)])


def of(rows: list[dict], table: str, row: int) -> dict[str, float]:
    """Corrected parameters of a row, m and rad."""
    scale = {"deg": np.pi / 180.0, "mm": 1e-3}
    found = [r for r in rows if r["table"] == table and int(r["row"]) == row]
    return {r["parameter"]: float(r["corrected"]) * scale[r["unit"]] for r in found}


def frame(rows: list[dict], which: str) -> np.ndarray:
    values = of(rows, which, 0)
    numbers = [values[f"{which}_{axis}"] for axis in ("x", "y", "z", "rx", "ry", "rz")]
    return matrix(rotation_matrix(np.array(numbers[3:])), np.array(numbers[:3]))


@given(seed=st.integers(0, 2**32 - 1), name=st.sampled_from(["ur5", "panda", "qiao2026"]))
@settings(max_examples=15)
def test_both_tables_are_the_calibrated_arm(tmp_path_factory, made, seed, name):
    """By 4 x 4 matrices in each table's own order of factors."""
    folder, rng, arm = tmp_path_factory.mktemp("dh"), np.random.default_rng(seed), load_arm(name)
    calibration = made(arm, rng, "fitted")
    lines = export(calibration, folder / "t.csv", kind="table").path.read_text().splitlines()
    rows = list(csv.DictReader(line for line in lines if not line.startswith("#")))
    again = json.loads(export(calibration, folder / "t.json", kind="table").path.read_text())["rows"]
    assert [row["corrected"] for row in again] == [float(row["corrected"]) for row in rows]
    joints = random_joints(arm.nominal, 3, rng)
    wanted = forward(calibration.identified, joints)
    for q, position, rotation in zip(joints, wanted.position, wanted.rotation, strict=True):
        modified, standard = frame(rows, "base"), frame(rows, "base")
        first = of(rows, "standard", 0)
        standard = standard @ about("x", first["alpha"]) @ along("x", first["a"]) @ about("y", first["beta"])
        for i, value in enumerate(q):
            turn, slide = (0.0, value) if arm.nominal.prismatic[i] else (value, 0.0)
            m, s = of(rows, "modified", i + 1), of(rows, "standard", i + 1)
            modified = modified @ about("x", m["alpha"]) @ along("x", m["a"]) @ about("y", m["beta"])
            modified = modified @ about("z", m["theta"] + turn) @ along("z", m["d"] + slide)
            standard = standard @ about("z", s["theta"] + turn) @ along("z", s["d"] + slide)
            standard = standard @ along("x", s["a"]) @ about("x", s["alpha"]) @ about("y", s["beta"])
        for found in (modified @ frame(rows, "tool"), standard @ frame(rows, "tool")):
            np.testing.assert_allclose(found, matrix(rotation, position), atol=1e-9)


def test_a_standard_table_of_a_standard_arm_is_its_makers(made, tmp_path):
    """Where no beta was found, the standard rows feed `from_standard_dh` and give the same arm to 1e-9."""
    rng, arm = np.random.default_rng(60), load_arm("ur5")
    calibration = made(arm, rng, beta=False)
    rows = json.loads(export(calibration, tmp_path / "t.json", kind="table").path.read_text())["rows"]
    table = [of(rows, "standard", i + 1) for i in range(6)]
    first = of(rows, "standard", 0)
    before = about("x", first["alpha"]) @ along("x", first["a"])
    own = arm.nominal
    base = matrix(own.base.rotation, own.base.position) @ before
    built = from_standard_dh(
        own.joint_names,
        own.prismatic,
        **{key: [row[key] for row in table] for key in ("theta", "d", "a", "alpha")},
        lower=own.lower,
        upper=own.upper,
        base=Pose(base[:3, 3], base[:3, :3]),
        tool=calibration.identified.tool,
    )
    joints = random_joints(own, 50, rng)
    np.testing.assert_allclose(
        forward(built, joints).position, forward(calibration.identified, joints).position, atol=1e-9
    )


def test_identified_parameters_carry_their_deviation_and_others_none(measured, tmp_path):
    calibration = measured(load_arm("so101"), np.random.default_rng(61))
    rows = json.loads(export(calibration, tmp_path / "t.json", kind="table").path.read_text())["rows"]
    sure = calibration.record["uncertainty"]
    deviation = dict(zip(sure["parameters"], np.sqrt(np.diag(sure["covariance"])), strict=True))
    early = ("alpha", "a", "beta")
    own = [row for row in rows if row["table"] == "modified"]
    modified = {f"{row['parameter']}{row['row'] - (row['parameter'] in early)}": row for row in own}
    assert set(deviation) - set(modified) == {n for n in deviation if n.startswith(("base_", "tool_"))}
    for name, row in modified.items():
        scale = 1e3 if row["unit"] == "mm" else np.degrees(1.0)
        if name in deviation:
            assert row["standard_deviation"] == pytest.approx(deviation[name] * scale)
        else:
            assert row["standard_deviation"] is None and row["change"] == 0.0


def transforms(text: str) -> dict[tuple[str, str], np.ndarray]:
    """The transforms that a script publishes, by parent and child."""
    found = {}
    for line in text.splitlines():
        if line.startswith("ros2 run tf2_ros static_transform_publisher "):
            words = shlex.split(line.removesuffix(" &"))[4:]
            values = dict(zip(words[::2], words[1::2], strict=True))
            numbers = [float(values[f"--{key}"]) for key in ("x", "y", "z", "qx", "qy", "qz", "qw")]
            key = values["--frame-id"], values["--child-frame-id"]
            found[key] = matrix(Rotation.from_quat(numbers[3:]).as_matrix(), np.array(numbers[:3]))
    return found


def test_instrument_robot_and_tool_close_the_loop(so101, made, tmp_path):
    """Root to tip by the patched file, tip to tool and root to instrument by the lines: what the instrument sees."""
    rng, own = np.random.default_rng(62), so101 / "so101_new_calib.urdf"
    arm = load_arm(own)
    calibration = made(arm, rng, "fitted")
    shutil.copytree(so101 / "assets", tmp_path / "assets")
    patched = export(calibration, tmp_path / "patched.urdf", onto=f"{own}#gripper_frame_link").path
    script = export(
        calibration, tmp_path / "t.sh", kind="transforms", onto=f"{own}#gripper_frame_link"
    ).path.read_text()
    assert "ROS 2 Humble" in script
    lines = transforms(script)
    camera, hand = lines["base_link", "measurement_frame"], lines["gripper_frame_link", "calibrated_tool"]
    joints = random_joints(arm.nominal, 30, rng)
    tip = forward(load_arm(f"{patched}#gripper_frame_link").nominal, joints)
    wanted = forward(calibration.identified, joints)
    for i in range(len(joints)):
        seen = np.linalg.inv(camera) @ matrix(tip.rotation[i], tip.position[i]) @ hand
        np.testing.assert_allclose(seen, matrix(wanted.rotation[i], wanted.position[i]), atol=1e-9)


def test_without_a_file_the_frames_are_the_tables(made, tmp_path):
    arm = load_arm("ur5")
    calibration = made(arm, np.random.default_rng(63), "fitted")
    lines = transforms(export(calibration, tmp_path / "t.sh", kind="transforms").path.read_text())
    (base, tool), (stood, held) = (
        [matrix(pose.rotation, pose.position) for pose in (geometry.base, geometry.tool)]
        for geometry in (arm.nominal, calibration.identified)
    )
    np.testing.assert_allclose(lines["base_link", "measurement_frame"], base @ np.linalg.inv(stood), atol=1e-12)
    np.testing.assert_allclose(lines["tool0", "calibrated_tool"], np.linalg.inv(tool) @ held, atol=1e-12)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ({"kind": "dxf"}, "there is no exporter 'dxf'; give one of toml, urdf"),
        ({}, "does not tell what to write; give `kind`, one of"),
        ({"kind": "lerobot"}, "give `onto`, the one that lerobot-calibrate wrote"),
        ({"kind": "table", "sample": 2}, "`sample` goes with a new MJCF"),
        ({"kind": "table", "onto": "robot.urdf"}, "is written anew; leave `onto` out"),
        ({"kind": "table", "counts_per_turn": 4096}, "belong to `kind='offsets'`"),
        ({"onto": "robot.stl"}, "does not tell what to write"),
        ({"kind": "transforms", "onto": "k.yaml"}, "has no named frames"),
        ({"kind": "onnx"}, "no learnt residual"),
        ({"kind": "urdf", "onto": "gone.urdf"}, "gone.urdf does not exist"),
    ],
)
def test_what_cannot_be_written_is_one_sentence(made, tmp_path, words, said):
    calibration = made(load_arm("ur5"), np.random.default_rng(0))
    with pytest.raises(InputError, match=said) as found:
        export(calibration, tmp_path / "out.file", **words)
    assert "\n" not in str(found.value)


def test_an_arm_file_needs_the_arms_speeds(made, tmp_path, so101):
    own = load_arm(so101 / "so101_new_calib.urdf")
    calibration = replace(made(own, np.random.default_rng(0)), arm_name="mine")
    with pytest.raises(InputError, match="tells joint speeds too; give `arm`, the file of 'mine'"):
        export(calibration, tmp_path / "a.toml")
    again = load_arm(export(calibration, tmp_path / "a.toml", arm=own).path)
    np.testing.assert_allclose(again.speed, own.speed)
    shipped = load_arm(export(made(load_arm("ur5"), np.random.default_rng(0)), tmp_path / "b.toml").path)
    np.testing.assert_allclose(shipped.speed, load_arm("ur5").speed)
