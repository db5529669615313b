"""A calibration onto the robot's own URDF: joint origins change, everything else is the maker's, and it is exact."""

import difflib
import os
import re
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from pickenv.arm import Pose, behind, forward, inverse_pose, load_arm, rotation_matrix, write_urdf
from pickenv.arm.files.urdf import roll_pitch_yaw, urdf_text
from pickenv.base import InputError
from pickenv.calibration import ArmModel, Calibration, export, random_joints
from pickenv.calibration.delivery.corrected_chain import same_chain

CHAIN = """<?xml version='1.0'?>
<!-- a comment with <origin xyz="9 9 9"/> and 'quotes' -->
<robot name="hand_made">\r
  <link name="base"/> <link name="one"/> <link name="two"/> <link name="hand"/> <link name="side"/>
  <transmission name="t"><joint name="turn"><hardwareInterface>x</hardwareInterface></joint></transmission>
  <joint name='turn' type="revolute">
\t<parent link="base"/><child link="one"/>
    <axis xyz="0 0 2"/><limit lower="-2" upper="2" velocity="1" effort="5"/>
  </joint>
  <joint name="lean" type="revolute"><origin rpy='1.5 0 0'/><parent link="one"/><child link="two"/>
    <axis xyz="0 0 1"/><limit lower="-2" upper="2" velocity="1" effort="5"/></joint>
  <joint name="camera" type="fixed"><parent link="one"/><child link="side"/><origin xyz="1 2 3"/></joint>
  <joint name="nod" type="revolute"><parent link="two"/><child link="hand"/><origin
      rpy="0 1.5707963267948966 0" xyz="0.3 0 0"  /><axis xyz="1 0 0"/>
    <limit lower="-2" upper="2" velocity="1" effort="5"/></joint>
</robot>
"""

GONE = '<visual><geometry><mesh filename="gone.stl"/></geometry></visual>'


def numbers(path: Path) -> dict[str, object]:
    """What must not change: how many there are of each, and every name."""
    root = ElementTree.parse(path).getroot()
    count = {
        tag: len(list(root.iter(tag))) for tag in ("link", "joint", "mesh", "inertial", "visual", "collision", "limit")
    }
    return count | {"names": [element.get("name") for element in root.iter()]}


def changed(old: str, new: str) -> list[str]:
    """Lines that differ, old and new."""
    lines = difflib.unified_diff(old.splitlines(), new.splitlines(), n=0, lineterm="")
    return [line for line in lines if line[0] in "+-" and not line.startswith(("+++", "---"))]


def without_origins(text: str) -> str:
    """The text with the numbers of joint origins taken out."""
    values = re.compile(r"""(xyz|rpy)\s*=\s*("[^"]*"|'[^']*')""")

    def joint(found: re.Match[str]) -> str:
        return re.sub(r"<origin[^>]*>", lambda origin: values.sub(r"\1", origin[0]), found[0])

    return re.sub(r"<joint\b.*?</joint>", joint, text, flags=re.DOTALL)


def test_the_makers_file_is_kept_and_moves_as_calibrated(own_urdf, measured, in_mujoco, meshes_of, rigid, tmp_path):
    """Calibrated from simulated poses, exported in place, loaded by MuJoCo, over 200 poses."""
    rng = np.random.default_rng(20)
    arm = load_arm(own_urdf)
    calibration = measured(arm, rng)
    out = tmp_path / own_urdf.name
    if own_urdf.name.startswith("so101"):
        shutil.copytree(own_urdf.parent / "assets", tmp_path / "assets")
    done = export(calibration, out, onto=own_urdf)
    assert any("base and tool were fitted" in note for note in done.notes)
    old, new = own_urdf.read_text(), out.read_text()
    assert old != new and without_origins(old) == without_origins(new)
    assert all("<origin" in line for line in changed(old, new))
    assert numbers(own_urdf) == numbers(out)
    joints = random_joints(arm.nominal, 200, rng)
    tip = arm.source.rpartition(" tip ")[2]
    seen = in_mujoco(out, arm.nominal.joint_names, tip, joints, meshes_of(own_urdf))
    found = forward(calibration.identified, joints)
    stands = behind(arm.nominal.base, inverse_pose(calibration.identified.base))  # the instrument, seen from the root
    there = Pose(stands.position + found.position @ stands.rotation.T, stands.rotation @ found.rotation)
    assert rigid(seen, there) < 1e-8
    before = in_mujoco(own_urdf, arm.nominal.joint_names, tip, joints, meshes_of(own_urdf))
    assert rigid(before, there) > 1e-3
    read = load_arm(out)
    np.testing.assert_allclose(forward(read.nominal, joints).position, seen.position, atol=1e-8)


@pytest.mark.parametrize("ending", ["urdf", "yaml"])
def test_where_a_fitted_target_hangs_moves_no_link(made, tmp_path, ending):
    """Targets anywhere on the flange, turned at will, leave the same file of the robot."""
    arm, rng = load_arm("ur5e"), np.random.default_rng(24)
    own = write_urdf(arm.nominal, tmp_path / "own.urdf") if ending == "urdf" else None
    onto, tip, calibration = own and f"{own}#tool", "#tool" * (ending == "urdf"), made(arm, rng, "fitted")
    joints, places = random_joints(arm.nominal, 20, rng), []
    for name in ("near", "far"):
        tool = Pose(rng.normal(size=3), rotation_matrix(rng.normal(size=3)))
        moved = replace(calibration, model=ArmModel.of(replace(calibration.identified, tool=tool)))
        out = export(moved, tmp_path / f"{name}.{ending}", kind=None if own else "kinematics-yaml", onto=onto).path
        places.append(forward(load_arm(f"{out}{tip}").nominal, joints))
    near, far = places
    np.testing.assert_allclose(near.position, far.position, atol=1e-9)
    np.testing.assert_allclose(near.rotation, far.rotation, atol=1e-9)


def test_other_readers_agree(own_urdf, made, rigid, tmp_path):
    pinocchio = pytest.importorskip("pinocchio", reason="Pinocchio is a second referee: pip install pin")
    rng = np.random.default_rng(21)
    arm = load_arm(own_urdf)
    calibration = made(arm, rng)
    if own_urdf.name.startswith("so101"):
        shutil.copytree(own_urdf.parent / "assets", tmp_path / "assets")
    out = export(calibration, tmp_path / "patched.urdf", onto=own_urdf).path
    model = pinocchio.buildModelFromUrdf(str(out))
    data = model.createData()
    tip = model.getFrameId(arm.source.rpartition(" tip ")[2])
    places = [model.joints[model.getJointId(name)].idx_q for name in arm.nominal.joint_names]
    joints, found = random_joints(arm.nominal, 200, rng), []
    for row in joints:
        q = pinocchio.neutral(model)
        q[places] = row
        pinocchio.framesForwardKinematics(model, data, q)
        found.append((data.oMf[tip].translation.copy(), data.oMf[tip].rotation.copy()))
    wanted = forward(calibration.identified, joints)
    np.testing.assert_allclose(np.array([position for position, _ in found]), wanted.position, atol=1e-8)
    np.testing.assert_allclose(np.array([rotation for _, rotation in found]), wanted.rotation, atol=1e-8)


def test_urdfdoms_own_check_passes(own_urdf, made, tmp_path):
    beside = str(Path(sys.executable).parent)
    check = shutil.which("check_urdf", path=os.pathsep.join([beside, os.environ["PATH"]]))
    if check is None:
        pytest.skip("check_urdf is absent: apt-get install liburdfdom-tools, or pip install cmeel-urdfdom")
    if own_urdf.name.startswith("so101"):
        shutil.copytree(own_urdf.parent / "assets", tmp_path / "assets")
    out = export(made(load_arm(own_urdf), np.random.default_rng(22)), tmp_path / "patched.urdf", onto=own_urdf).path
    checked = subprocess.run([check, out], capture_output=True, text=True)
    assert checked.returncode == 0 and "Successfully Parsed XML" in checked.stdout, checked.stdout + checked.stderr


@pytest.mark.parametrize(
    ("name", "own"),
    [
        ("ur5", "ur_description/urdf/ur5_robot.urdf"),
        ("ur10", "ur_description/urdf/ur10_robot.urdf"),
        ("tiago", "tiago_description/robots/tiago.urdf#arm_tool_link"),
        ("panda", "panda_description/urdf/panda.urdf"),
    ],
)
def test_an_arm_known_by_its_dh_table_is_found_in_a_vendors_file(robots, made, rigid, tmp_path, name, own):
    """A shipped table against the maker's URDF: other root, link frames and places of the parallel axes."""
    rng, arm, onto = np.random.default_rng(23), load_arm(name), f"{robots / 'robots' / own}"
    vendor, tip = load_arm(onto).nominal, own.partition("#")[1:]
    for frames in ("known", "fitted"):
        calibration = made(arm, rng, frames)
        out = export(calibration, tmp_path / f"{frames}.urdf", onto=onto).path
        joints = random_joints(arm.nominal, 200, rng)
        root, sign, zero = same_chain(arm.nominal, vendor, own, name)
        assert (sign == 1).all() and (zero == 0).all()
        standing = replace(calibration.identified, base=behind(root, arm.nominal.base))
        assert rigid(forward(standing, joints), forward(load_arm("".join((str(out), *tip))).nominal, joints)) < 1e-12
        assert rigid(forward(standing, joints), forward(vendor, joints)) > 1e-3


@given(seed=st.integers(0, 2**32 - 1), name=st.sampled_from(["ur5", "so101", "panda"]))
@settings(max_examples=20)
def test_a_file_with_other_zeros_signs_and_root_keeps_its_own_reading(
    tmp_path_factory, made, told_otherwise, seed, name
):
    """The file's joints read s q + z of the table's; what they read before they read after, at the corrected arm."""
    folder, rng, arm = tmp_path_factory.mktemp("vendor"), np.random.default_rng(seed), load_arm(name)
    own = write_urdf(told_otherwise(arm.nominal, rng, False), folder / "vendor.urdf")
    calibration = made(arm, rng, "fitted")
    done = export(calibration, folder / "out.urdf", onto=f"{own}#tool")
    root, sign, zero = same_chain(arm.nominal, load_arm(f"{own}#tool").nominal, "vendor.urdf", name)
    q = rng.uniform(-2.0, 2.0, (40, arm.nominal.joints))
    standing = replace(calibration.identified, base=behind(root, arm.nominal.base))
    wanted, seen = forward(standing, q * sign + zero), forward(load_arm(f"{done.path}#tool").nominal, q)
    hand = np.einsum("nji,nj->ni", wanted.rotation, seen.position - wanted.position)
    np.testing.assert_allclose(hand, np.broadcast_to(hand[0], hand.shape), atol=1e-8)
    turn = np.swapaxes(wanted.rotation, 1, 2) @ seen.rotation
    np.testing.assert_allclose(turn, np.broadcast_to(turn[0], turn.shape), atol=1e-8)
    joint = next(i for i in range(arm.nominal.joints) if sign[i] != 1 or zero[i] != 0)
    reading = f"{arm.nominal.joint_names[joint]} = {sign[joint]:+.0f} x {arm.nominal.joint_names[joint]}"
    assert any("joints read otherwise in the file" in note and reading in note for note in done.notes)


@pytest.fixture
def hand_made(tmp_path):
    path = tmp_path / "hand_made.urdf"
    path.write_bytes(b"\xef\xbb\xbf" + CHAIN.encode())
    return path


def test_bytes_that_are_no_origin_stay(hand_made, made, tmp_path):
    """A byte order mark, mixed line ends, quotes of both kinds, tabs, comments; an absent origin is put in."""
    arm = load_arm(hand_made)
    calibration = made(arm, np.random.default_rng(24))
    out = export(calibration, tmp_path / "out.urdf", onto=hand_made).path
    old, new = hand_made.read_bytes(), out.read_bytes()
    assert new.startswith(b"\xef\xbb\xbf<?xml version='1.0'?>\n<!--") and new.count(b"\r\n") == old.count(b"\r\n")
    inserted = re.search(rb"\n\t<origin xyz=\"[^\"]+\" rpy=\"[^\"]+\"/>(?=\n\t<parent link=\"base\"/>)", new)
    assert inserted is not None
    kept = new.replace(inserted[0], b"", 1)
    values = re.compile(rb"""(?:\s+(?:xyz|rpy)\s*=\s*(?:"[^"]*"|'[^']*'))+""")
    origins = re.compile(rb"<origin[^>]*>")
    taken = [origins.sub(lambda tag: values.sub(b"", tag[0]), text) for text in (old, kept)]
    assert taken[0] == taken[1]
    assert b'<origin xyz="1 2 3"/>' in new and b'<origin xyz="9 9 9"/>' in new and b"<origin rpy='" in new
    joints = random_joints(arm.nominal, 50, np.random.default_rng(0))
    np.testing.assert_allclose(
        forward(load_arm(out).nominal, joints).position, forward(calibration.identified, joints).position, atol=1e-12
    )


def test_nothing_found_changes_nothing(hand_made, made, tmp_path):
    arm = load_arm(hand_made)
    calibration = replace(made(arm, np.random.default_rng(0)), model=ArmModel.of(arm.nominal))
    done = export(calibration, tmp_path / "out.urdf", onto=hand_made)
    assert done.path.read_bytes() == hand_made.read_bytes()
    assert done.notes == ("no joint origin differs from what the file has; nothing is changed",)


@pytest.mark.parametrize("digits", [5, 6, 10, 17])
@pytest.mark.parametrize("joint", [None, 2, 5])
def test_origins_that_only_lose_the_files_rounding_count_as_they_were(digits, joint, made, tmp_path):
    """One joint is a millimetre off; the others' right angles have as many digits as the file gives them."""

    def rounded(found: re.Match[str]) -> str:
        return f'{found[1]}="{" ".join(f"{float(value):.{digits}g}" for value in found[2].split())}"'

    arm, own = load_arm("ur5"), tmp_path / "own.urdf"
    own.write_text(re.sub(r'(xyz|rpy)="([^"]*)"', rounded, urdf_text(arm.nominal, "ur5")))
    longer = arm.nominal.a + (0.0 if joint is None else 1e-3) * (np.arange(6) == (joint or 0))
    found = ArmModel.of(replace(arm.nominal, a=longer))
    done = export(replace(made(arm, np.random.default_rng(0)), model=found), tmp_path / "out.urdf", onto=own)
    if joint is None:
        assert done.notes[0].startswith("no joint origin differs from what the file has")
        assert done.notes[0].endswith("nothing is changed") == (done.path.read_bytes() == own.read_bytes())
    else:
        assert done.notes[0].startswith("1 of 6 joint origins corrected: by up to 1 mm ("), done.notes[0]
        assert done.notes[0].endswith("the file's rounding") == (digits < 17)


def test_an_origin_that_moves_by_nanometres_is_not_counted(made, tmp_path):
    """A prior leaves such crumbs at the first joint, which a fitted base makes up for."""
    arm, own = load_arm("ur5"), tmp_path / "own.urdf"
    own.write_text(urdf_text(arm.nominal, "ur5"))
    longer = arm.nominal.a + np.array([0.0, 2e-9, 1e-3, 0.0, 0.0, 0.0])
    found = ArmModel.of(replace(arm.nominal, a=longer))
    done = export(replace(made(arm, np.random.default_rng(0)), model=found), tmp_path / "out.urdf", onto=own)
    assert done.notes[0].startswith("1 of 6 joint origins corrected: by up to 1 mm ("), done.notes[0]


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=20)
def test_what_was_written_is_the_same_arm_again(tmp_path_factory, made, seed):
    """Round trip: a generated URDF of an arm with slides, patched and read, is the calibrated arm to 1e-9."""
    folder, rng = tmp_path_factory.mktemp("round"), np.random.default_rng(seed)
    plain = load_arm("qiao2026")
    own = write_urdf(plain.nominal, folder / "own.urdf")
    arm = load_arm(f"{own}#tool")
    calibration = made(arm, rng)
    out = export(calibration, folder / "out.urdf", onto=f"{own}#tool").path
    joints = random_joints(arm.nominal, 30, rng)
    again, wanted = forward(load_arm(f"{out}#tool").nominal, joints), forward(calibration.identified, joints)
    np.testing.assert_allclose(again.position, wanted.position, atol=1e-9)
    np.testing.assert_allclose(again.rotation, wanted.rotation, atol=1e-9)


def test_a_two_stage_lift_and_what_mimics_it_are_one_joint(made, tmp_path):
    """Slides in a row that one joint moves are one link; a parallelogram's second joint follows with ratio -1."""
    body = """<joint name="{name}" type="{kind}"><parent link="{a}"/><child link="{b}"/>
      <origin xyz="{xyz}" rpy="0.1 0 0.2"/><axis xyz="{axis}"/>
      <limit lower="-1" upper="1" velocity="1" effort="1"/>{mimic}</joint>"""
    rows = [
        ("mast", "revolute", "0 0 0.1", "0 0 1", ""),
        ("lift", "prismatic", "0 0 0.2", "0 0 1", ""),
        ("lift2", "prismatic", "0.1 0 0.2", "0 1 1", '<mimic joint="lift" multiplier="0.5" offset="0.05"/>'),
        ("still", "revolute", "0.1 0 0", "0 1 0", '<mimic joint="lift" multiplier="0" offset="0.2"/>'),
        ("elbow", "revolute", "0.3 0 0", "0 1 0", ""),
        ("level", "revolute", "0.3 0 0", "0 1 0", '<mimic joint="elbow" multiplier="-1" offset="0.1"/>'),
        ("roll", "revolute", "0.1 0 0", "1 0 0", ""),
    ]
    links = "".join(f'<link name="l{i}"/>' for i in range(len(rows) + 1))
    joints = "".join(
        body.format(name=name, kind=kind, a=f"l{i}", b=f"l{i + 1}", xyz=xyz, axis=axis, mimic=mimic)
        for i, (name, kind, xyz, axis, mimic) in enumerate(rows)
    )
    own = tmp_path / "lift.urdf"
    own.write_text(f'<robot name="lift">{links}{joints}</robot>')
    arm, rng = load_arm(f"{own}#l7"), np.random.default_rng(5)
    assert arm.nominal.coupling is not None and arm.nominal.links == 5
    calibration = made(arm, rng)
    out = export(calibration, tmp_path / "out.urdf", onto=f"{own}#l7").path
    assert len(re.findall("<mimic[^>]*>", out.read_text())) == 3
    q = random_joints(arm.nominal, 50, rng)
    again, wanted = forward(load_arm(f"{out}#l7").nominal, q), forward(calibration.identified, q)
    np.testing.assert_allclose(again.position, wanted.position, atol=1e-9)
    np.testing.assert_allclose(again.rotation, wanted.rotation, atol=1e-9)


def test_a_tools_correction_goes_to_the_fixed_joint_before_the_tip_only_where_frames_were_known(so101, made, tmp_path):
    shutil.copytree(so101 / "assets", tmp_path / "assets")
    own = f"{so101 / 'so101_new_calib.urdf'}#gripper_frame_link"
    arm, rng = load_arm(own), np.random.default_rng(6)
    known = made(arm, rng)
    tool = Pose(arm.nominal.tool.position + np.array([1e-3, 2e-3, 0.0]), arm.nominal.tool.rotation)
    known = replace(known, model=ArmModel.of(replace(known.identified, tool=tool)))
    done = export(known, tmp_path / "known.urdf", onto=own)
    assert any("in the fixed joint 'gripper_frame_joint'" in note for note in done.notes)
    q = random_joints(arm.nominal, 20, rng)
    wanted = forward(known.identified, q)
    again = forward(load_arm(f"{done.path}#gripper_frame_link").nominal, q)
    np.testing.assert_allclose(again.position, wanted.position, atol=1e-9)
    lines = changed(Path(own.partition("#")[0]).read_text(), done.path.read_text())
    assert len(lines) == 2 * 6  # not the gripper's own joint, which hangs on the link and not on the tip
    elsewhere = export(known, tmp_path / "flange.urdf", onto=so101 / "so101_new_calib.urdf")
    assert any("of the tool's correction 2.24 mm and 0 deg are left out" in note for note in elsewhere.notes)
    fitted = replace(known, record={"frames": "fitted"})
    kept = export(fitted, tmp_path / "fitted.urdf", onto=own).path.read_text()
    assert 'xyz="-0.0079 -0.000218121 -0.0981274" rpy="0 3.14159 0"' in kept


def test_a_tool_beside_the_last_axis_is_a_link_behind_the_tip(so101, made, in_mujoco, meshes_of, tmp_path):
    """The tip is the last joint's own link: every other byte stays, and the next calibration moves the same link."""
    shutil.copytree(so101 / "assets", tmp_path / "assets")
    own, onto = so101 / "so101_new_calib.urdf", so101 / "so101_new_calib.urdf"
    arm, rng, link = load_arm(own), np.random.default_rng(60), "gripper_link_calibrated"
    q = random_joints(arm.nominal, 50, rng)
    for name in ("first.urdf", "again.urdf"):
        calibration = made(arm, rng)
        tool = Pose(
            arm.nominal.tool.position + rng.normal(size=3) * 1e-3,
            arm.nominal.tool.rotation @ rotation_matrix(rng.normal(size=3) * 1e-3),
        )
        calibration = replace(calibration, model=ArmModel.of(replace(calibration.identified, tool=tool)))
        done = export(calibration, tmp_path / name, onto=f"{onto}#gripper_link")
        assert any(f"the new frame '{link}', fixed to the tip gripper_link" in note for note in done.notes)
        wanted, seen = forward(calibration.identified, q), forward(load_arm(f"{done.path}#{link}").nominal, q)
        np.testing.assert_allclose(seen.position, wanted.position, atol=1e-9)
        np.testing.assert_allclose(seen.rotation, wanted.rotation, atol=1e-9)
        referee = in_mujoco(done.path, arm.nominal.joint_names, link, q, meshes_of(own))
        np.testing.assert_allclose(referee.position, wanted.position, atol=1e-8)
        text = done.path.read_text()
        assert text.count(f'"{link}"') == 2
        assert load_arm(done.path).source.endswith("tip gripper_link")  # a gripper's link hangs on the tip as well
        if onto == own:
            added = re.compile(rf'<link name="{link}"/>\s*<joint name="{link}_joint".*?</joint>\s*')
            assert without_origins(added.sub("", text)) == without_origins(own.read_text())
            onto, arm = done.path, load_arm(done.path)
            text = text.replace('<parent link="gripper_link"/><child', '<parent link="base_link"/><child')
            (tmp_path / "theirs.urdf").write_text(text)
    with pytest.raises(InputError, match=rf"has a link '{link}' of its own"):
        export(calibration, tmp_path / "out.urdf", onto=f"{tmp_path / 'theirs.urdf'}#gripper_link")


@given(st.floats(-4, 4), st.sampled_from([-np.pi / 2, np.pi / 2, 0.3]), st.floats(-1e-6, 1e-6), st.floats(-4, 4))
def test_angles_are_exact_where_the_pitch_is_upright(roll, pitch, near, yaw):
    from scipy.spatial.transform import Rotation

    rotation = Rotation.from_euler("xyz", [roll, pitch + near, yaw]).as_matrix()
    again = Rotation.from_euler("xyz", roll_pitch_yaw(rotation)).as_matrix()
    np.testing.assert_allclose(again, rotation, atol=1e-14)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('<child link="hand"/>', '<child link="paw"/>', "hand_made.urdf.*'hand'"),
        ('<parent link="base"/>', '<parent link="hand"/>', "closes a loop"),
        ('xyz="0.3 0 0"', 'xyz="0.31 0 0"', r"is of another arm than 'hand_made': nod lies 10 mm"),
        ('<link name="side"/>', f'<link name="side">{GONE}</link>', "names 'gone.stl', which is not there"),
        ('type="revolute"><origin', 'type="floating"><origin', "only serial R and P chains"),
    ],
    ids=["missing link", "loop", "another arm", "mesh gone", "other joint"],
)
def test_a_bad_file_is_one_sentence(hand_made, made, tmp_path, old, new, said):
    calibration = made(load_arm(hand_made), np.random.default_rng(0))
    text = CHAIN.replace(old, new)
    assert text != CHAIN
    hand_made.write_text(text)
    with pytest.raises(InputError, match=said) as found:
        export(calibration, tmp_path / "out.urdf", onto=f"{hand_made}#hand")
    assert "\n" not in str(found.value) and not (tmp_path / "out.urdf").exists()


def test_a_file_written_elsewhere_must_find_its_meshes(so101, made, tmp_path):
    own = so101 / "so101_new_calib.urdf"
    with pytest.raises(InputError, match=r"would not find 'assets/.*' from where it stands; write it beside"):
        export(made(load_arm(own), np.random.default_rng(0)), tmp_path / "out.urdf", onto=own)


def test_where_no_pose_tells_links_stay_as_they_are_drawn(robots, tmp_path):
    """Three parallel axes: 40 mm on one link and off another is the same arm, and no mesh is drawn elsewhere."""
    arm = load_arm("ur5")
    own = robots / "robots/ur_description/urdf/ur5_robot.urdf"
    shift = np.array([0.0, 0.04, 0.01, -0.05, 0.0, 0.0])
    found = replace(arm.nominal, d=arm.nominal.d + shift)
    calibration = Calibration("ur5", arm.nominal, arm.nominal, ArmModel.of(found), None, {"frames": "known"})
    out = export(calibration, tmp_path / "out.urdf", onto=own).path
    old, new = (re.findall(r'<origin[^>]*xyz="([^"]*)"', path.read_text()) for path in (own, out))
    apart = np.array([line.split() for line in new], float) - np.array([line.split() for line in old], float)
    assert np.abs(apart).max() < 1e-9
    q = random_joints(arm.nominal, 20, np.random.default_rng(0))
    root, _, _ = same_chain(arm.nominal, load_arm(own).nominal, "", "")
    standing = forward(replace(found, base=behind(root, arm.nominal.base)), q)
    hand = np.einsum("nji,nj->ni", standing.rotation, forward(load_arm(out).nominal, q).position - standing.position)
    np.testing.assert_allclose(hand, np.broadcast_to(hand[0], hand.shape), atol=1e-9)
