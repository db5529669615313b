"""A calibration onto the robot's own MJCF: places of bodies change, everything else is the maker's, and it is exact."""

import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pickenv.arm import Pose, forward, load_arm
from pickenv.base import InputError
from pickenv.calibration import ArmModel, export, random_joints

MODEL = """<mujoco model="arm">
  <compiler angle="degree" eulerseq="zyx"/> <!-- pos="1 2 3" in a comment -->
  <default>
    <joint damping="1" range="-90 90"/>
    <default class="second"><joint axis="0 1 0" pos="0.01 0 0" ref="10"/></default>
  </default>
  <worldbody>
    <body name="pillar" pos='0 0 0.4'>
      <geom type="box" size=".1 .1 .1" pos="0 0 0.1"/>
      <body name="upper" euler="0 20 0"><joint name="pan"/><geom type="sphere" size=".1"/>
        <body name="lower" pos="0.3 0 0" axisangle="0 0 1 30" childclass="second">
          <joint name="lift"/><geom type="sphere" size=".1"/>
          <frame pos="0.1 0 0" euler="0 0 15">
            <body name="reach"><joint name="out" type="slide" axis="1 0 0" range="0 0.3" class="main"/>
              <geom type="sphere" size=".1"/>
              <body name="plate" pos="0.1 0 0"><site name="end" pos="0 0 0.05" quat="0.5 0.5 0.5 0.5"/></body>
            </body>
          </frame>
          <body name="lamp" pos="0 0.1 0"><geom type="sphere" size=".02"/></body>
        </body>
      </body>
    </body>
  </worldbody>
</mujoco>
"""
LIFT = '<joint name="lift"/>'
TWIST = LIFT + '<joint name="twist" axis="1 0 0" class="main"/>'
GONE = '<asset><mesh name="m" file="gone.stl"/></asset>'


@pytest.fixture
def model(tmp_path):
    path = tmp_path / "arm.xml"
    path.write_text(MODEL)
    return path


def compared(text: str) -> str:
    """The text without the places of bodies and the orientations that they are told by."""
    values = re.compile(r"""\s+(?:pos|quat|euler|axisangle)\s*=\s*(?:"[^"]*"|'[^']*')""")
    return re.sub(r"<body\b[^>]*>", lambda body: values.sub("", body[0]), text)


@pytest.mark.parametrize("tip", ["gripper", pytest.param("gripperframe", marks=pytest.mark.slow)])
def test_the_makers_model_is_kept_and_moves_as_calibrated(so101, measured, in_mujoco, meshes_of, rigid, tmp_path, tip):
    """SO-101: calibrated from simulated poses, exported in place, loaded by MuJoCo, over 200 poses."""
    rng, own = np.random.default_rng(30), so101 / "so101_new_calib.xml"
    shutil.copytree(so101 / "assets", tmp_path / "assets")
    arm = load_arm(f"{own}#{tip}")
    calibration = measured(arm, rng)
    out = export(calibration, tmp_path / "patched.xml", onto=f"{own}#{tip}").path
    old, new = own.read_text(), out.read_text()
    assert old != new and compared(old) == compared(new)
    joints = random_joints(arm.nominal, 200, rng)
    seen = in_mujoco(out, arm.nominal.joint_names, tip, joints, meshes_of(own))
    found = forward(calibration.identified, joints)
    base, stood = arm.nominal.base, calibration.identified.base
    turn = base.rotation @ stood.rotation.T
    there = Pose(base.position + (found.position - stood.position) @ turn.T, turn @ found.rotation)
    assert rigid(seen, there) < 1e-8
    assert rigid(in_mujoco(own, arm.nominal.joint_names, tip, joints, meshes_of(own)), there) > 1e-3


def test_a_calibration_from_the_urdf_goes_onto_the_mjcf(so101, made, in_mujoco, meshes_of, rigid, tmp_path):
    """Both are the maker's; their last digits differ, which the patched model does not inherit."""
    rng = np.random.default_rng(31)
    arm = load_arm(so101 / "so101_new_calib.urdf")
    shutil.copytree(so101 / "assets", tmp_path / "assets")
    calibration = made(arm, rng)
    out = export(calibration, tmp_path / "patched.xml", onto=so101 / "so101_new_calib.xml").path
    joints = random_joints(arm.nominal, 200, rng)
    seen = in_mujoco(out, arm.nominal.joint_names, "gripper", joints, meshes_of(out))
    assert rigid(seen, forward(calibration.identified, joints)) < 1e-8


def test_references_places_of_joints_classes_and_frames_are_kept(model, made, in_mujoco, tmp_path):
    """euler and axisangle become quat in the same place; joint ref, pos and class stay; so does what hangs beside."""
    rng, arm = np.random.default_rng(32), load_arm(f"{model}#end")
    calibration = made(arm, rng)
    out = export(calibration, tmp_path / "out.xml", onto=f"{model}#end").path
    text = out.read_text()
    assert compared(text) == compared(MODEL)
    kept_bodies = ("name=\"pillar\" pos='0 0 0.4'", 'name="lamp" pos="0 0.1 0"', 'name="plate" pos="0.1 0 0"')
    for kept in kept_bodies:
        assert kept in text
    assert re.search(r'<body name="upper" quat="[^"]+" pos="[^"]+">', text) and 'euler="0 20 0"' not in text
    joints = random_joints(arm.nominal, 100, rng)
    seen, wanted = in_mujoco(out, arm.nominal.joint_names, "end", joints, {}), forward(calibration.identified, joints)
    np.testing.assert_allclose(seen.position, wanted.position, atol=1e-8)
    np.testing.assert_allclose(seen.rotation, wanted.rotation, atol=1e-8)
    again = forward(load_arm(f"{out}#end").nominal, joints)
    np.testing.assert_allclose(again.position, wanted.position, atol=1e-9)


def test_a_known_tools_correction_moves_the_site(model, made, tmp_path):
    arm, rng = load_arm(f"{model}#end"), np.random.default_rng(33)
    calibration = made(arm, rng)
    tool = Pose(arm.nominal.tool.position + np.array([0.0, 1e-3, 0.0]), arm.nominal.tool.rotation)
    calibration = replace(calibration, model=ArmModel.of(replace(calibration.identified, tool=tool)))
    out = export(calibration, tmp_path / "out.xml", onto=f"{model}#end").path
    joints = random_joints(arm.nominal, 20, rng)
    again, wanted = forward(load_arm(f"{out}#end").nominal, joints), forward(calibration.identified, joints)
    np.testing.assert_allclose(again.position, wanted.position, atol=1e-9)


def test_a_tool_beside_the_last_axis_is_a_site_on_the_tip(so101, made, in_mujoco, meshes_of, tmp_path):
    shutil.copytree(so101 / "assets", tmp_path / "assets")
    own = onto = so101 / "so101_new_calib.xml"
    arm, rng = load_arm(own), np.random.default_rng(34)
    joints = random_joints(arm.nominal, 50, rng)
    for name in ("first.xml", "again.xml"):  # the next calibration moves the same site
        calibration = made(arm, rng)
        tool = Pose(arm.nominal.tool.position + rng.normal(size=3) * 1e-3, arm.nominal.tool.rotation)
        calibration = replace(calibration, model=ArmModel.of(replace(calibration.identified, tool=tool)))
        done = export(calibration, tmp_path / name, onto=onto)
        assert any("the new frame 'gripper_calibrated'" in note for note in done.notes)
        assert done.path.read_text().count("gripper_calibrated") == 1
        wanted = forward(calibration.identified, joints)
        seen = in_mujoco(done.path, arm.nominal.joint_names, "gripper_calibrated", joints, meshes_of(own))
        np.testing.assert_allclose(seen.position, wanted.position, atol=1e-8)
        np.testing.assert_allclose(seen.rotation, wanted.rotation, atol=1e-8)
        onto, arm = done.path, load_arm(done.path)


def test_bodies_of_an_included_file_are_not_written(so101, made, tmp_path):
    arm = load_arm(so101 / "so101_new_calib.xml")
    with pytest.raises(InputError, match="body 'shoulder' stands in a file that it includes"):
        export(made(arm, np.random.default_rng(0)), so101 / "never.xml", onto=so101 / "scene.xml")
    assert not Path(so101 / "never.xml").exists()


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('<body name="reach">', "<body>", "name every body"),
        (LIFT, TWIST, "RRRP"),
        ('pos="0.3 0 0"', 'pos="0.3 0.002 0"', "is of another arm than 'arm'"),
        ("</worldbody>", f"</worldbody>{GONE}", "names 'gone.stl', which is not there"),
    ],
    ids=["no name", "another chain", "another arm", "mesh gone"],
)
def test_a_bad_model_is_one_sentence(model, made, tmp_path, old, new, said):
    calibration = made(load_arm(f"{model}#end"), np.random.default_rng(0))
    model.write_text(MODEL.replace(old, new))
    assert model.read_text() != MODEL
    with pytest.raises(InputError, match=said) as found:
        export(calibration, tmp_path / "out.xml", onto=f"{model}#end")
    assert "\n" not in str(found.value) and not (tmp_path / "out.xml").exists()


@pytest.mark.parametrize(
    ("compiler", "wanted"),
    [
        ('meshdir="parts"', "parts/a/m.stl"),
        ('assetdir="parts"', "parts/a/m.stl"),
        ('meshdir="parts" assetdir="other" strippath="true"', "parts/m.stl"),
        ('meshdir="parts" strippath="false"', "parts/a/m.stl"),
        ("", "a/m.stl"),
    ],
)
def test_meshes_are_looked_for_where_mujoco_finds_them(model, made, tmp_path, compiler, wanted):
    calibration = made(load_arm(f"{model}#end"), np.random.default_rng(0))
    asset = '<asset><mesh name="m" file="a/m.stl"/></asset>'
    model.write_text(MODEL.replace("</worldbody>", f"</worldbody><compiler {compiler}/>{asset}"))
    with pytest.raises(InputError, match=re.escape(f"names '{wanted}', which is not there")):
        export(calibration, tmp_path / "out.xml", onto=f"{model}#end")
    (tmp_path / wanted).parent.mkdir(parents=True, exist_ok=True)
    (tmp_path / wanted).write_bytes(b"")
    export(calibration, tmp_path / "out.xml", onto=f"{model}#end")


def test_what_is_no_file_beside_the_model_is_let_be(model, made, tmp_path):
    """Of a URDF, whose meshes have addresses: of a package, of a site, of a folder, or none."""
    calibration = made(load_arm(f"{model}#end"), np.random.default_rng(0))
    own, out = export(calibration, tmp_path / "arm.urdf", arm=load_arm(f"{model}#end")).path, tmp_path / "out.urdf"
    addresses = ["", "package://robot/arm.stl", "http://site/arm.stl", str(tmp_path / "gone.stl")]
    meshes = "".join(f'<visual><geometry><mesh filename="{each}"/></geometry></visual>' for each in addresses)
    plain = replace(calibration, arm=calibration.in_own_base)
    own.write_text(own.read_text().replace("</robot>", f'<link name="shell">{meshes}</link></robot>'))
    export(plain, out, onto=f"{own}#tool")
    own.write_text(own.read_text().replace("package://robot/arm.stl", "gone.stl"))
    with pytest.raises(InputError, match="names 'gone"):
        export(plain, out, onto=f"{own}#tool")


def test_a_file_that_includes_one_is_not_written_where_that_is_not(model, made, tmp_path):
    calibration = made(load_arm(f"{model}#end"), np.random.default_rng(0))
    (tmp_path / "more.xml").write_text("<mujoco/>")
    model.write_text(MODEL.replace("</worldbody>", '</worldbody><include file="more.xml"/>'))
    (tmp_path / "elsewhere").mkdir()
    with pytest.raises(InputError, match=r"would not find 'more\.xml' from where it stands"):
        export(calibration, tmp_path / "elsewhere" / "out.xml", onto=f"{model}#end")
    export(calibration, tmp_path / "out.xml", onto=f"{model}#end")


def test_two_joints_of_one_body_cannot_both_be_corrected(tmp_path, made):
    path = tmp_path / "arm.xml"
    path.write_text(MODEL.replace(LIFT, TWIST))
    calibration = made(load_arm(f"{path}#end"), np.random.default_rng(0))
    with pytest.raises(InputError, match="joint 'twist' is the second of body 'lower'"):
        export(calibration, tmp_path / "out.xml", onto=f"{path}#end")
