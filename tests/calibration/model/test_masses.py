"""The masses in an arm's file: gravity loads the joints as MuJoCo says, whatever the file's frames are."""

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from pickenv.arm import Arm, Array, load_arm, mjcf_text, write_urdf
from pickenv.base import GRAVITY, InputError
from pickenv.calibration import ComplianceTerm, Conditions, random_joints, weight_of

TWO_ARMS = """<robot name="two arms"><link name="base"><inertial><mass value="9"/></inertial></link>
<link name="column"><inertial><origin xyz="0.02 0 0.3"/><mass value="4"/></inertial></link>
<link name="chest"><inertial><origin xyz="0 0.05 0.1" rpy="0 0 1"/><mass value="2.5"/></inertial></link>
<link name="box"><inertial><mass value="0.7"/></inertial></link>
<link name="upper"><inertial><origin xyz="0.1 0.02 0.05"/><mass value="1.5"/></inertial></link>
<link name="lower"><inertial><origin xyz="0.2 0 -0.03"/><mass value="0.8"/></inertial></link>
<link name="finger"><inertial><origin xyz="0 0.04 0"/><mass value="0.2"/></inertial></link>
<link name="other"><inertial><origin xyz="0 -0.1 0.02"/><mass value="1.1"/></inertial></link>
<link name="hand"/>
<joint name="lift" type="prismatic"><parent link="base"/><child link="column"/><origin xyz="0 0 0.4" rpy="0.1 0.2 0"/>
<axis xyz="0 0 1"/><limit lower="0" upper="0.5" velocity="1"/></joint>
<joint name="lean" type="revolute"><parent link="column"/><child link="chest"/><origin xyz="0 0 0.5"/>
<axis xyz="0 1 0"/><limit lower="-1" upper="1" velocity="1"/></joint>
<joint name="strap" type="fixed"><parent link="chest"/><child link="box"/><origin xyz="-0.1 0 0.2" rpy="0 1 0"/></joint>
<joint name="shoulder" type="revolute"><parent link="chest"/><child link="upper"/>
<origin xyz="0 0.2 0.3" rpy="1 0 0.3"/><axis xyz="0.6 0 0.8"/><limit lower="-2" upper="2" velocity="1"/></joint>
<joint name="elbow" type="revolute"><parent link="upper"/><child link="lower"/><origin xyz="0.3 0 0"/>
<axis xyz="0 0 -1"/><limit lower="-2" upper="2" velocity="1"/></joint>
<joint name="grip" type="prismatic"><parent link="lower"/><child link="finger"/><origin xyz="0.3 0 0"/>
<axis xyz="0 1 0"/><limit lower="0" upper="0.04" velocity="1"/></joint>
<joint name="wrist" type="fixed"><parent link="lower"/><child link="hand"/>
<origin xyz="0.35 0 0" rpy="0 0.5 0"/></joint>
<joint name="second" type="revolute"><parent link="chest"/><child link="other"/>
<origin xyz="0 -0.2 0.3" rpy="-1 0 0"/><axis xyz="0 1 0"/><limit lower="-2" upper="2" velocity="1"/></joint></robot>
"""
"""A lift that leans, a chest with a box strapped on, an arm of two joints with a gripper, and an arm of one."""


def in_mujoco(path: Path) -> Any:
    """The model as MuJoCo reads it, without shapes and contacts."""
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".urdf":
        text = re.sub(r"<(visual|collision)[ >].*?</\1>", "", text, flags=re.S)
        text = re.sub(r"(</?inertial>)", r"\1", re.sub(r"<inertia [^>]*/>", "", text))
        text = text.replace("</inertial>", '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>')
        options = '<mujoco><compiler fusestatic="false" discardvisual="true"/></mujoco>'
        return mujoco.MjModel.from_xml_string(re.sub(r"(<robot[^>]*>)", rf"\1{options}", text, count=1))
    return mujoco.MjModel.from_xml_path(str(path))


def torques_in_mujoco(model: Any, arm: Arm, joints: Array) -> Array:
    """What gravity does to the arm's joints ``(N, n)``, N*m or N, all others at zero."""
    model.opt.gravity[:] = 0.0, 0.0, -GRAVITY
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    data, names = mujoco.MjData(model), arm.nominal.joint_names
    places = [int(model.joint(name).qposadr[0]) for name in names]
    motions = [int(model.joint(name).dofadr[0]) for name in names]
    rows = []
    for row in joints:
        data.qpos[:] = 0.0
        data.qpos[places] = row
        mujoco.mj_forward(model, data)
        rows.append(-data.qfrc_bias[motions])
    return np.array(rows)


def torques_of(arm: Arm, joints: Array) -> Array:
    """What our own term says of the same ``(N, n)``."""
    assert arm.load is not None
    term: ComplianceTerm = weight_of(arm.nominal).with_masses(arm.nominal, arm.load)
    return term.torques(arm.nominal, joints, Conditions())


def agree(path: Path, links: str) -> None:
    arm = load_arm(f"{path}{links}", whole=True)
    joints = random_joints(arm.nominal, 30, np.random.default_rng(5))
    expected = torques_in_mujoco(in_mujoco(path), arm, joints)
    assert np.abs(torques_of(arm, joints) - expected).max() < 1e-9 * np.abs(expected).max()


@pytest.mark.parametrize("links", ["#hand", "#other", "#hand,other"])
def test_the_weight_of_a_whole_robot_is_on_every_joint_that_carries_it(tmp_path: Path, links: str) -> None:
    """Fixed links, the gripper's finger and, of a single arm, the other arm at zero hang on the joints before them."""
    path = tmp_path / "robot.urdf"
    path.write_text(TWO_ARMS, encoding="utf-8")
    agree(path, links)


@pytest.mark.parametrize(
    "name", ["mukca_sockets/urdf/vx300s.urdf", "mukca_sockets/urdf/gen3lite.urdf", "so101/so101_new_calib.xml"]
)
def test_the_masses_of_makers_files_load_the_joints_as_in_mujoco(data_folder: Path, name: str) -> None:
    if not (data_folder / name).is_file():
        pytest.skip(f"no {name} in {data_folder}")
    agree(data_folder / name, "")


HANGING = """<mujoco><compiler angle="radian"/><worldbody><body name="first" pos="0 0 1" euler="0.3 0 0">
<inertial pos="0.1 0.02 0" mass="2" diaginertia="1 1 1"/><joint name="a" axis="0 1 0" pos="0.05 0 0.1" ref="0.4"
range="-2 2"/><joint name="b" axis="1 0 0" range="-2 2"/><body name="second" pos="0.4 0 0" quat="1 0.2 0 0">
<inertial pos="0 0 0.1" mass="0.5" diaginertia="1 1 1"/><joint name="c" type="slide" axis="1 0 0" range="0 0.3"/>
<site name="end"/></body></body></worldbody></mujoco>
"""


def test_anchors_and_reference_positions_of_a_mujoco_model_move_its_masses(tmp_path: Path) -> None:
    path = tmp_path / "hanging.xml"
    path.write_text(HANGING, encoding="utf-8")
    agree(path, "#end")


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('<inertial pos="0 0 0.1" mass="0.5" diaginertia="1 1 1"/>', '<geom size="0.1"/>'),
        ('<compiler angle="radian"/>', '<compiler angle="radian" inertiafromgeom="true"/>'),
        ('mass="0.5"', 'mass="2"'),
    ],
    ids=["one by its shape", "all by shape", "all equal"],
)
def test_masses_that_a_file_does_not_say_are_unknown(tmp_path: Path, old: str, new: str) -> None:
    path = tmp_path / "hanging.xml"
    path.write_text(HANGING.replace(old, new), encoding="utf-8")
    assert load_arm(f"{path}#end").load is None


def test_the_placeholders_in_our_own_files_are_no_masses(tmp_path: Path) -> None:
    geometry = load_arm("qiao2026").nominal
    model = tmp_path / "arm.xml"
    model.write_text(mjcf_text(geometry, "arm"), encoding="utf-8")
    assert load_arm(write_urdf(geometry, tmp_path / "arm.urdf")).load is None
    assert load_arm(f"{model}#tool").load is None


@pytest.mark.parametrize("kg", ["-1", "heavy", "1e9", ""])
def test_a_mass_that_no_link_has_is_refused_by_its_name(tmp_path: Path, kg: str) -> None:
    path = tmp_path / "robot.urdf"
    path.write_text(TWO_ARMS.replace('<mass value="2.5"/>', f'<mass value="{kg}"/>'), encoding="utf-8")
    with pytest.raises(InputError, match="chest"):
        load_arm(f"{path}#hand")


def test_a_payload_weighs_as_a_link_of_its_own_does(tmp_path: Path) -> None:
    path = tmp_path / "robot.urdf"
    path.write_text(TWO_ARMS, encoding="utf-8")
    arm = load_arm(f"{path}#hand")
    joints = random_joints(arm.nominal, 20, np.random.default_rng(6))
    carried = '<link name="hand"><inertial><origin xyz="0.01 0.02 0.06"/><mass value="3"/></inertial></link>'
    path.write_text(TWO_ARMS.replace('<link name="hand"/>', carried), encoding="utf-8")
    expected = torques_of(load_arm(f"{path}#hand"), joints)
    assert torques_of(arm.holding(3.0, (0.01, 0.02, 0.06)), joints) == pytest.approx(expected, abs=1e-9)
    assert torques_of(arm.holding(0.0), joints) == pytest.approx(torques_of(arm, joints), abs=1e-12)


def test_a_payload_is_refused_where_it_says_nothing(tmp_path: Path) -> None:
    path = tmp_path / "robot.urdf"
    path.write_text(TWO_ARMS, encoding="utf-8")
    arm = load_arm(f"{path}#hand")
    for mass, centre in ((-1.0, (0, 0, 0)), (np.nan, (0, 0, 0)), (1.0, (0, 0)), (1.0, (0, np.inf, 0))):
        with pytest.raises(InputError, match="payload"):
            arm.holding(mass, centre)
    with pytest.raises(InputError, match="no masses"):
        replace(arm, load=None).holding(1.0)
    with pytest.raises(InputError, match="whole robot"):
        load_arm(f"{path}#hand,other", whole=True).holding(1.0)


TABLE = """joint_count = 2
[[joints]]
number = 1
type = "R"
alpha_deg = 0.0
a_mm = 0.0
theta_deg = 0.0
d_mm = 300.0
lower_deg = -90.0
upper_deg = 90.0
speed_deg_per_s = 90.0
mass_kg = 3.0
[[joints]]
number = 2
type = "R"
alpha_deg = 90.0
a_mm = 0.0
theta_deg = 0.0
d_mm = 0.0
lower_deg = -90.0
upper_deg = 90.0
speed_deg_per_s = 90.0
mass_kg = 1.5
centre_mm = [200.0, 0.0, 0.0]
"""


def test_a_table_of_links_may_have_masses(tmp_path: Path) -> None:
    """The second link lies level, its centre 0.2 m from the axis; the first joint's axis is upright."""
    path = tmp_path / "arm.toml"
    path.write_text(TABLE, encoding="utf-8")
    torques = torques_of(load_arm(path), np.zeros((1, 2)))
    assert torques == pytest.approx(np.array([[0.0, -1.5 * GRAVITY * 0.2]]), abs=1e-12)
    path.write_text(TABLE.replace("mass_kg = 3.0\n", ""), encoding="utf-8")
    with pytest.raises(InputError, match=r"mass_kg of joint 1 is missing"):
        load_arm(path)
    path.write_text('convention = "standard"\n' + TABLE, encoding="utf-8")
    with pytest.raises(InputError, match=r"mass_kg need convention"):
        load_arm(path)
