"""One fit of a whole robot: two arms on a torso that bends, a head camera that watches a wrist, and its own URDF."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pickenv
from pickenv.arm import (
    Array,
    Geometry,
    forward,
    identity_pose,
    load_arm,
    load_tolerances,
    rotation_matrix,
    standard_deviations,
)
from pickenv.base import InputError
from pickenv.calibration import (
    Calibration,
    Choices,
    Conditions,
    Result,
    bending_of,
    identify_terms,
    missed_by,
    prior_model,
    read_observations,
    verify,
    weight_of,
)
from tests.calibration.whole_robots import (
    Robot,
    apart,
    built,
    drawn_robot,
    head_watches,
    matrix,
    track,
    two_cameras_watch,
)

ARMS = ("left_tip", "right_tip")


def joints_of(robot: Robot, *branches: str) -> list[str]:
    return [name for branch in ("torso", *branches) for name in robot.moving if name.startswith(branch)]


def two_arms(folder: Path, seed: int, **chosen: tuple[float, float, float]) -> Robot:
    """Write the URDF of a drawn robot, and what a tracker sees of both arms of the robot that was built."""
    rng = np.random.default_rng(seed)
    robot = drawn_robot(rng)
    truth = replace(built(robot, rng), **chosen)
    (folder / "robot.urdf").write_text(robot.urdf(), encoding="utf-8")
    for link in ARMS:
        track(truth, joints_of(robot, "left", "right"), link, folder, rng, matrix((1.0, -0.5, 0.2)))
    return truth


def calibrated(folder: Path, files: Sequence[str], links: Sequence[str] = ARMS, **choices: str) -> Result:
    name = f"{folder / 'robot.urdf'}#{','.join(links)}"
    paths = [folder / f"{file}.csv" for file in files]
    columns = [folder / f"{file}.toml" for file in files]
    return pickenv.calibrate(name, paths, columns=columns, choices=Choices(**choices))


@pytest.fixture(scope="module")
def second(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Robot, Result]:
    """Folder, truth and calibration without terms of one robot; neither its files nor its result is changed."""
    folder = tmp_path_factory.mktemp("second")
    truth = two_arms(folder, 2)
    return folder, truth, calibrated(folder, ARMS, terms="none")


def motion(geometry: Geometry, joints: Array) -> Array:
    """Poses ``(N, 4, 4)`` of the target's link against the sensor's."""
    bare = replace(geometry, base=identity_pose(), tool=identity_pose())
    return np.stack([matrix(*pose) for pose in zip(*forward(bare, joints), strict=True)])


def held_out(result: Result) -> Array:
    """RMS error on held-out rows, nominal and as calibrated, mm."""
    errors = result.as_dict()["held_out"]
    return np.array([errors["nominal_rms_mm"], errors["best_rms_mm"]])


@pytest.mark.slow
def test_two_arms_on_one_torso_are_one_fit(tmp_path: Path) -> None:
    two_arms(tmp_path, 1)
    result = calibrated(tmp_path, ARMS)
    nominal, left = held_out(result)
    assert nominal > 0.5
    assert left < 1.25 * 0.03 * np.sqrt(3.0)
    assert str(result).startswith("verdict: GOOD")
    assert result.as_dict()["frames"] == result.calibration.record["frames"] == "fitted"
    names = result.fit.identification.unknowns
    assert [name for name in names if name.startswith("base")] == []  # one tracker, one base
    assert sum(name.startswith("tool2_") for name in names) == 6


@pytest.mark.slow
def test_other_rows_of_a_scene_are_judged_where_they_were_seen(tmp_path: Path) -> None:
    two_arms(tmp_path, 1)
    names, columns = [], [tmp_path / f"{link}.toml" for link in ARMS]
    for link in ARMS:
        header, *rows = (tmp_path / f"{link}.csv").read_text(encoding="utf-8").splitlines(keepends=True)
        for part, some in (("a", rows[:90]), ("b", rows[90:])):
            (tmp_path / f"{link}_{part}.csv").write_text(header + "".join(some), encoding="utf-8")
        names.append(f"{tmp_path / link}")
    files, others = ([f"{name}_{part}.csv" for name in names] for part in "ab")
    robot = f"{tmp_path / 'robot.urdf'}#{','.join(ARMS)}"
    result = pickenv.calibrate(robot, files, columns=columns, test=others, choices=Choices(terms="none"))
    assert len(result.test.joints) == 60
    assert held_out(result)[1] < 1.3 * 0.03 * np.sqrt(3.0)


def test_other_rows_of_another_target_are_refused(tmp_path: Path) -> None:
    two_arms(tmp_path, 1)
    (tmp_path / "other.csv").write_text((tmp_path / "right_tip.csv").read_text(encoding="utf-8"), encoding="utf-8")
    text = (tmp_path / "right_tip.toml").read_text(encoding="utf-8").replace("ball on right_tip", "prism")
    (tmp_path / "other.toml").write_text(text, encoding="utf-8")
    arm = load_arm(f"{tmp_path / 'robot.urdf'}#{','.join(ARMS)}", whole=True)
    left, right, other = (
        read_observations([tmp_path / f"{name}.csv"], arm.nominal, tmp_path / f"{name}.toml")
        for name in (*ARMS, "other")
    )
    with pytest.raises(InputError, match="names 'tracker' and 'prism', as no fitted file of this kind does"):
        pickenv.calibrate(arm, [left, right], test=[other])


@pytest.mark.slow
def test_one_table_says_row_by_row_what_saw_what(tmp_path: Path) -> None:
    """One table of both arms' balls ends where two files end, to the bit; rows of another sensor are not read."""
    two_arms(tmp_path, 1)
    by_file = calibrated(tmp_path, ARMS, terms="none")
    tables = [(tmp_path / f"{link}.csv").read_text(encoding="utf-8").split() for link in ARMS]
    rows = [f"tracker,{link},{row}" for link, (_, *some) in zip(ARMS, tables, strict=True) for row in some]
    rows[60:60] = [f"gauge,,{row}" for row in tables[0][1:9]]
    (tmp_path / "all.csv").write_text("\n".join([f"sensor,ball,{tables[0][0]}", *rows]), encoding="utf-8")
    head, _, _ = (tmp_path / "left_tip.toml").read_text(encoding="utf-8").partition("[scene]")
    links = "[scene.links]\n" + "".join(f'{link} = "{link}"\n' for link in ARMS)
    scene = f'{head}[scene]\nsensor = "tracker"\nsensor_column = "sensor"\ntarget_column = "ball"\n{links}'
    (tmp_path / "all.toml").write_text(scene, encoding="utf-8")
    by_row = calibrated(tmp_path, ["all"], terms="none")
    assert by_row.as_dict()["held_out"] == by_file.as_dict()["held_out"]
    joints, moved = np.random.default_rng(5).uniform(-1.2, 1.2, (10, 14)), []
    for result in (by_row, by_file):
        geometry = result.calibration.identified
        moved.append(forward(geometry.between(-1, load_left(geometry)), joints).position)
    np.testing.assert_array_equal(*moved)
    with pytest.raises(
        InputError, match="has rows of tracker of left_tip, tracker of right_tip, of which one is needed"
    ):
        read_observations([tmp_path / "all.csv"], by_row.arm.nominal, tmp_path / "all.toml")
    for change, message in (
        (('sensor = "tracker"', 'sensor = "trakcer"'), "no row names sensor 'trakcer' in column 'sensor'; correct "),
        (('sensor = "tracker"', 'sensor = "gauge"'), r"row 62, column 'ball' is empty; name the row's own, or remove"),
        (('"ball"', '"prism"'), "column 'prism' is missing; the file has sensor, ball"),
        (('right_tip = "right_tip"', 'right_tip = "tail"'), "names link 'tail', but the arm has left_tip, right_tip"),
        (
            ("\nright_tip = ", "\nrigth_tip = "),
            "has 'rigth_tip', but sensors and targets are gauge, left_tip, right_tip",
        ),
        ((links, 'links = "left_tip"'), "names of sensors and targets, each with the name of its link"),
    ):
        (tmp_path / "all.toml").write_text(scene.replace(*change), encoding="utf-8")
        with pytest.raises(InputError, match=message):
            calibrated(tmp_path, ["all"])


@pytest.mark.slow
def test_an_inclinometer_on_a_middle_link_is_one_more_file(tmp_path: Path) -> None:
    truth = two_arms(tmp_path, 8)
    rng, joints = np.random.default_rng(9), joints_of(truth, "left", "right")
    values = rng.uniform(-1.2, 1.2, (30, len(joints)))
    poses = [truth.poses(dict(zip(joints, row, strict=True)))["left4"] for row in values]
    down = np.array([pose[:3, :3].T @ (0.0, 0.0, -1.0) for pose in poses]) + 1e-4 * rng.normal(size=(30, 3))
    table = np.c_[values, down / np.linalg.norm(down, axis=1)[:, None]]
    np.savetxt(tmp_path / "tilt.csv", table, "%.9g", ",", header=",".join([*joints, "gx", "gy", "gz"]), comments="")
    head, _, _ = (tmp_path / "left_tip.toml").read_text(encoding="utf-8").partition("[position]")
    section = '[tilt]\ncolumns = ["gx", "gy", "gz"]\nunit = "g"\nstd_deg = 0.006\n[scene]\nsensor_link = "left4"\n'
    (tmp_path / "tilt.toml").write_text(head + section, encoding="utf-8")
    result = calibrated(tmp_path, [*ARMS, "tilt"], [*ARMS, "left4"], terms="none")
    tilted = next(station for station in result.train.stations if station.data.kind == "tilt")
    unknowns = np.array([result.fit.identification.unknowns[name] for name in tilted.unknowns()])
    by_arm, _ = tilted.jacobian(result.fit.calibration.model, unknowns)
    names = result.fit.calibration.model.parameter_names
    moved = {name for name, column in zip(names, by_arm.T, strict=True) if np.abs(column).max() > 1e-9}
    assert moved and not any(name in moved for name in ("theta7", "theta8", "theta10", "alpha12"))
    missed = tilted.data.misses(*tilted.seen(result.fit.calibration.model, unknowns))
    assert np.sqrt(np.mean(missed**2)) < 1.5e-4


@pytest.mark.parametrize("ending", ["urdf", pytest.param("xml", marks=pytest.mark.slow)])
def test_the_robots_own_file_moves_as_the_model(
    second: tuple[Path, Robot, Result], tmp_path: Path, ending: str
) -> None:
    folder, truth, result = second
    own, new = folder / "robot.urdf", tmp_path / f"new.{ending}"
    if ending == "xml":
        mujoco = pytest.importorskip("mujoco")
        text = own.read_text(encoding="utf-8")
        start = '<mujoco><compiler fusestatic="false"/></mujoco><link name="base"/>'
        model = mujoco.MjModel.from_xml_string(text.replace('<link name="base"/>', start, 1))
        own = tmp_path / "robot.xml"
        mujoco.mj_saveLastXML(str(own), model)
        files, columns = ([folder / f"{link}.{end}" for link in ARMS] for end in ("csv", "toml"))
        result = pickenv.calibrate(f"{own}#{','.join(ARMS)}", files, columns=columns, choices=Choices(terms="none"))
    saved = result.save(tmp_path / "robot.npz")
    found = Calibration.load(saved, whole=True)
    done = pickenv.calibration.export(found, new, onto=own)
    assert f"of {len(joints_of(truth, 'left', 'right'))} joint origins corrected" in done.notes[0]
    patched = load_arm(f"{new}#{','.join(ARMS)}", whole=True).nominal
    joints = np.random.default_rng(3).uniform(-1.2, 1.2, (10, patched.joints))
    assert found.arm.tree is not None
    left, right = found.arm.tree.carriers
    for ends in ((-1, left), (-1, right), (left, right)):
        assert apart(*(motion(arm.between(*ends), joints) for arm in (found.identified, patched))) < 1e-8


def test_a_whole_robot_compensates_no_tool(second: tuple[Path, Robot, Result], tmp_path: Path) -> None:
    _, _, result = second
    path = result.save(tmp_path / "robot.npz")
    with pytest.raises(InputError, match="is of a whole robot, which `export` writes onto its URDF"):
        Calibration.load(path)
    with pytest.raises(InputError, match="a whole robot has no one tool to compensate"):
        result.calibration.compensator()
    with pytest.raises(InputError, match="goes onto its own URDF or MJCF; give that file as `onto`"):
        pickenv.calibration.export(result.calibration, tmp_path / "new.toml")
    (tmp_path / "other.urdf").write_text(drawn_robot(np.random.default_rng(9)).urdf(), encoding="utf-8")
    with pytest.raises(InputError, match=r"urdf: the calibration belongs to arm 'torso' with another geometry"):
        pickenv.calibration.export(result.calibration, tmp_path / "new.urdf", onto=tmp_path / "other.urdf")


def test_parts_within_tolerance_are_expected_however_skew_the_axes_are(tmp_path: Path) -> None:
    """Arms built to their class: where axes meet at a small angle, tables still differ little more than parts."""
    tolerances, far = load_tolerances("cobot"), []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        drawing, path = drawn_robot(rng), tmp_path / "robot.urdf"
        path.write_text(drawing.urdf(), encoding="utf-8")
        nominal = load_arm(f"{path}#left_tip").nominal
        std = dict(zip(nominal.parameter_names, standard_deviations(tolerances, nominal), strict=True))
        path.write_text(built(drawing, rng, 1e3 * std["a1"], 1e3 * std["alpha1"]).urdf(), encoding="utf-8")
        prior = prior_model("drawn", nominal, known=False)
        change = nominal.difference(load_arm(f"{path}#left_tip").nominal)[prior.parameters.columns]
        far.append(np.abs(change / prior.std)[np.isin(prior.group, ("lengths", "angles"))].max() > 8.0)
    assert np.mean(far) <= 0.05


@pytest.mark.slow
def test_a_camera_that_was_mounted_anew_is_another_series_of_its_table(tmp_path: Path) -> None:
    """Few views in two series, whose views have equal numbers; each is held out once, and each has its own places."""
    rng = np.random.default_rng(3)
    robot = drawn_robot(rng)
    truth = built(robot, rng)
    joints = [*joints_of(truth, "left"), *(name for name in robot.moving if name.startswith("head"))]
    (tmp_path / "robot.urdf").write_text(robot.urdf(), encoding="utf-8")
    table: list[str] = []
    for series, views in (("first", 14), ("second", 10)):
        head_watches(truth, joints, "left_tip", tmp_path, rng, views)
        header, *rows = (tmp_path / "camera.csv").read_text(encoding="utf-8").split()
        table += [f"{series},{row}" for row in rows]
    (tmp_path / "camera.csv").write_text("\n".join([f"mounted,{header}", *table]), encoding="utf-8")
    text = (tmp_path / "camera.toml").read_text(encoding="utf-8")
    (tmp_path / "camera.toml").write_text(f'{text}series_column = "mounted"\n', encoding="utf-8")
    result = calibrated(tmp_path, ["camera"], ["left_tip", "head_tip"], terms="none")
    first, second = result.set_ups
    assert (first["rows"], second["rows"]) == (14, 10) == tuple(len(part.joints) for part in result.test.parts)
    assert set(second["own"]) == {"base", "tool"} and second["own"]["base"]["mm"] > 1.0
    nominal, left = held_out(result)
    assert left < 0.7 * nominal


def test_a_later_day_tells_which_part_of_a_robot_changed(
    second: tuple[Path, Robot, Result], tmp_path: Path, typed: Callable[..., Any]
) -> None:
    """Rows of either arm from another station, before and after a motor of the left arm was set 2 mrad off."""
    folder, truth, result = second
    saved, joints = result.save(tmp_path / "robot.npz"), joints_of(truth, "left", "right")
    third = next(joint for joint in truth.joints if joint.name == "left_j3")
    reset = replace(third, origin=third.origin @ matrix(rotation=rotation_matrix(2e-3 * third.axis)))
    changed = replace(truth, joints=tuple(reset if joint is third else joint for joint in truth.joints))
    screens = {}
    for when, robot in (("before", truth), ("after", changed)):
        for link in ARMS:
            track(robot, joints, link, tmp_path, np.random.default_rng(50), matrix((2.0, 0.4, 0.0)))
            done = typed("verify", saved, tmp_path / f"{link}.csv", "--columns", folder / f"{link}.toml")
            screens[when, link] = done.returncode, " ".join(done.stdout.split())
    for told, (code, screen) in screens.items():
        off = told == ("after", "left_tip")
        assert code == (3 if off else 0), screen
        assert screen.startswith("verdict: DRIFTED" if off else "verdict: STILL GOOD"), screen
    assert "the joints' zeros explain it" in screens["after", "left_tip"][1]
    rows = read_observations([tmp_path / "left_tip.csv"], result.arm.nominal, folder / "left_tip.toml")
    with pytest.raises(InputError, match="always found anew; leave `refit` out"):
        verify(result.calibration, rows, ("base",))


@pytest.mark.slow
def test_a_wrist_that_is_left_out_leaves_the_other_as_it_was(tmp_path: Path) -> None:
    two_arms(tmp_path, 4)
    both, one = (calibrated(tmp_path, files, fit="auto", terms="none") for files in (ARMS, ARMS[:1]))
    joints = np.random.default_rng(5).uniform(-1.2, 1.2, (200, 14))
    motions = []
    for result in (both, one):
        geometry = result.calibration.identified
        motions.append(forward(geometry.between(-1, load_left(geometry)), joints).position)
    sure = one.uncertainty
    assert sure is not None
    radius, _ = sure.within95(sure.standard(one.calibration.model, joints))
    assert radius is not None
    moved = np.linalg.norm(motions[0] - motions[1], axis=1)
    assert np.mean(moved <= radius) > 0.95


def load_left(geometry: Geometry) -> int:
    assert geometry.tree is not None
    return geometry.tree.carriers[0]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            ('target_link = "left_tip"', 'target_link = "tail"'),
            "names link 'tail', but the arm has left_tip, right_tip",
        ),
        (('target_link = "left_tip"', ""), "neither sensor nor target is on a link of this whole robot"),
        (
            ('target_link = "left_tip"', 'target_link = "left_tip"\nsensor_link = "left_tip"'),
            "do not move against each",
        ),
    ],
)
def test_links_of_a_scene_are_refused_by_name(tmp_path: Path, change: tuple[str, str], message: str) -> None:
    two_arms(tmp_path, 1)
    path = tmp_path / "left_tip.toml"
    path.write_text(path.read_text(encoding="utf-8").replace(*change), encoding="utf-8")
    with pytest.raises(InputError, match=message):
        calibrated(tmp_path, ARMS)


def test_what_a_scene_says_cannot_be_said_otherwise(tmp_path: Path) -> None:
    two_arms(tmp_path, 1)
    arm = f"{tmp_path / 'robot.urdf'}#{','.join(ARMS)}"
    files, columns = ([tmp_path / f"{link}.{end}" for link in ARMS] for end in ("csv", "toml"))
    with pytest.raises(InputError, match="says which files share a base or a tool; leave `stations` out"):
        pickenv.calibrate(arm, files, columns=columns, stations="base,tool")
    for given in ({"frames": "known"}, {"residual": "gp", "force": True}):
        with pytest.raises(InputError, match="is for a single arm; leave it out for a whole robot"):
            pickenv.calibrate(arm, files, columns=columns, choices=Choices(**given))
    poses = tmp_path / "poses.csv"
    poses.write_text("x_mm,y_mm,z_mm,rx_deg,ry_deg,rz_deg\n300,0,300,0,0,0\n", encoding="utf-8")
    with pytest.raises(InputError, match="a whole robot has no one tool to take them; give joints"):
        pickenv.calibrate(arm, files, columns=columns, choices=Choices(workspace=str(poses), terms="none"))


def test_links_of_a_single_chain_are_refused(tmp_path: Path) -> None:
    two_arms(tmp_path, 1)
    with pytest.raises(InputError, match="but the arm is a single chain; name all of "):
        pickenv.calibrate(
            f"{tmp_path / 'robot.urdf'}#left_tip", tmp_path / "left_tip.csv", columns=tmp_path / "left_tip.toml"
        )


@pytest.mark.slow
@pytest.mark.parametrize("cube", [False, True], ids=["a board", "a cube of tags"])
def test_a_head_camera_watches_the_wrist_of_its_own_robot(tmp_path: Path, cube: bool) -> None:
    rng = np.random.default_rng(6)
    robot = drawn_robot(rng)
    (tmp_path / "robot.urdf").write_text(robot.urdf(), encoding="utf-8")
    head_watches(built(robot, rng), joints_of(robot, "left", "head"), "left_tip", tmp_path, rng, cube=cube, views=24)
    result = calibrated(tmp_path, ["camera"], ("left_tip", "head_tip"))
    nominal, left = held_out(result)
    assert left < 0.4 * nominal
    assert result.as_dict()["rms_px"] < 1.1 * 0.15 * np.sqrt(2.0)


@pytest.mark.slow
def test_a_head_camera_and_a_tracker_are_one_fit(tmp_path: Path) -> None:
    rng = np.random.default_rng(10)
    robot = drawn_robot(rng)
    truth, joints = built(robot, rng), joints_of(robot, "left", "head")
    (tmp_path / "robot.urdf").write_text(robot.urdf(), encoding="utf-8")
    head_watches(truth, joints, "left_tip", tmp_path, rng)
    track(truth, joints, "left_tip", tmp_path, rng, matrix((1.0, -0.5, 0.2)), rows=40)
    result = calibrated(tmp_path, ["left_tip", "camera"], ["left_tip", "head_tip"], terms="none")
    values = rng.uniform(-0.9, 0.9, (40, len(joints)))
    poses = [truth.poses(dict(zip(joints, row, strict=True))) for row in values]
    assert result.arm.nominal.tree is not None
    left, head = result.arm.nominal.tree.carriers
    for sensor, name in ((-1, "base"), (head, "head_tip")):
        true = np.stack([np.linalg.inv(pose[name]) @ pose["left_tip"] for pose in poses])
        arms = (result.arm.nominal, result.calibration.identified)
        before, after = (apart(motion(arm.between(sensor, left), values), true) for arm in arms)
        assert after < before / 5.0, name


def two_cameras(folder: Path, seed: int, most: int) -> tuple[Result, float, float]:
    """One fit of two cameras and a tracker, and how far the arm's motion is from the truth, before it and after."""
    rng = np.random.default_rng(seed)
    robot = drawn_robot(rng)
    truth, joints = built(robot, rng), joints_of(robot, "left")
    (folder / "robot.urdf").write_text(robot.urdf(), encoding="utf-8")
    two_cameras_watch(truth, joints, "left_tip", folder, rng, most)
    track(truth, joints, "left_tip", folder, rng, matrix((1.0, -0.5, 0.2)), rows=40, whole=False)
    result = calibrated(folder, ["camera1", "camera2", "left_tip"], ["left_tip"])
    values = rng.uniform(-0.9, 0.9, (40, len(joints)))
    true = np.stack([truth.poses(dict(zip(joints, row, strict=True)))["left_tip"] for row in values])
    before, after = (apart(motion(arm, values), true) for arm in (result.arm.nominal, result.calibration.identified))
    return result, before, after


@pytest.mark.slow
@pytest.mark.parametrize("most", [0, 7], ids=["a board", "3 to 7 points of a dodecahedron"])
def test_two_cameras_and_a_tracker_are_one_fit(tmp_path: Path, most: int) -> None:
    result, before, after = two_cameras(tmp_path, 7, most)
    assert after < before / 5.0
    assert len(result.left_out) == 0
    own = result.fit.identification.unknowns
    assert sum(name.startswith("base") for name in own) == 12  # one more camera, one tracker
    assert sum(name.startswith("tool") for name in own) == 6  # the ball's; both cameras see the arm's own tool


@pytest.mark.slow
def test_the_payload_in_hand_belongs_to_the_weight_that_bends_the_torso(tmp_path: Path) -> None:
    """Told of 3 kg in the left hand, the torso's compliance comes out right; untold, it is too large for the weight."""
    rng, payload = np.random.default_rng(11), 3.0
    robot = drawn_robot(rng)
    (tmp_path / "robot.urdf").write_text(robot.urdf(), encoding="utf-8")
    truth = replace(built(robot, rng), yields=(0.0, 2e-5, 0.0), masses={**robot.masses, "left_tip": payload})
    track(truth, joints_of(robot, "left"), "left_tip", tmp_path, rng, matrix((1.0, -0.5, 0.2)), rows=160, whole=False)
    arm, off = load_arm(f"{tmp_path / 'robot.urdf'}#left_tip"), []
    for told in (arm.holding(payload), arm):
        result = pickenv.calibrate(told, tmp_path / "left_tip.csv", columns=tmp_path / "left_tip.toml")
        assert result.terms is not None
        assert result.terms[0] == "compliance"
        assert "the masses in the arm's file" in result.report()
        (lean,) = (row for row in result.as_dict()["stiffnesses"] if row["name"] == "torso_j2")
        off.append((lean["stiffness"] * 2e-5 - 1.0) / (lean["stiffness_std"] * 2e-5))
    assert abs(off[0]) < 3.0
    assert off[1] < -10.0


def test_a_joint_bends_across_its_axis_by_a_symmetric_matrix(tmp_path: Path) -> None:
    """Three numbers say how the lean yields across its axis, wherever x of its frame lies; trace and determinant tell.

    The robot bends by matrices of 4 x 4, and yields by 2 and 3 urad per N*m about its link's x and z, across y.
    """
    rng = np.random.default_rng(3)
    robot = drawn_robot(rng)
    (tmp_path / "robot.urdf").write_text(robot.urdf(), encoding="utf-8")
    bent = replace(robot, yields=(2e-6, 0.0, 3e-6))
    arm = load_arm(f"{tmp_path / 'robot.urdf'}#left_tip")
    values = rng.uniform(-1.0, 1.0, (30, arm.nominal.joints))
    poses = [
        [own.poses(dict(zip(arm.nominal.joint_names, row, strict=True)))["left_tip"] for row in values]
        for own in (robot, bent)
    ]
    moved = np.diff(np.array(poses)[..., :3, 3], axis=0)[0]
    columns = bending_of(arm, [1]).columns(arm.nominal, values, Conditions())[:, :3]
    (xx, yy, xy), *_ = np.linalg.lstsq(columns.reshape(-1, 3), moved.ravel(), rcond=None)
    assert np.abs(columns @ (xx, yy, xy) - moved).max() < 1e-3 * np.abs(moved).max()
    assert xx + yy == pytest.approx(5e-6, rel=1e-3)
    assert xx * yy - xy**2 == pytest.approx(6e-12, rel=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("yields", "robots"), [((0.0, 4e-5, 0.0), 10), ((2e-5, 4e-5, 3e-5), 4)], ids=["along", "along and across"]
)
def test_a_torso_that_bends_under_both_arms_costs_nothing(
    tmp_path: Path, yields: tuple[float, float, float], robots: int
) -> None:
    """At most 1.2 times what is left where the fit is told which joint yields, or where none does."""
    told, stiff, covered = [], [], []
    for seed in range(robots):
        left = []
        for name, own, terms in (("bent", yields, "auto"), ("stiff", (0.0, 0.0, 0.0), "none")):
            folder = tmp_path / f"{name}{seed}"
            folder.mkdir()
            two_arms(folder, 100 + seed, yields=own)
            result = calibrated(folder, ARMS, terms=terms)
            left.append(held_out(result)[1])
            if name == "bent":
                assert result.uncertainty is not None
                covered.append(result.uncertainty.factors["position"]["covered"])
                told.append(left[0] / torso_alone(folder, result, across=yields[0] > 0.0))
        stiff.append(left[0] / left[1])
    print("told", np.round(told, 3), "stiff", np.round(stiff, 3), "covered", np.round(covered, 3))
    assert max(told) < 1.2
    assert max(stiff) < 1.2
    assert 0.90 <= np.mean(covered) <= 0.98


def torso_alone(folder: Path, result: Result, across: bool) -> float:
    """RMS error on the same held-out rows, mm, of the fit that is told that the torso's second joint alone yields."""
    arm = load_arm(f"{folder / 'robot.urdf'}#{','.join(ARMS)}", whole=True)
    assert arm.load is not None
    bare = calibrated(folder, ARMS, terms="none").fit.identification
    geometry = bare.arm_model.geometry
    lean = geometry.joint_names.index("torso_j2")
    along = replace(weight_of(geometry), joints=(lean,)).with_masses(geometry, arm.load)
    bending = bending_of(arm, [geometry.links_of(lean)[0][0]])
    fitted = identify_terms((along, bending) if across else (along,), bare, result.train)
    return float(1e3 * np.sqrt(np.mean(np.sum(missed_by(fitted, result.test) ** 2, axis=1))))
