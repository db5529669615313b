"""Arm files: what they may hold, and the one sentence each mistake gets."""

import os

import numpy as np
import pytest

from pickenv.arm import ARMS, load_arm, load_plant, shipped_arms
from pickenv.base import InputError

SHIPPED = (ARMS / "qiao2026.toml").read_text(encoding="utf-8")


@pytest.fixture
def write(tmp_path):
    """``write(old, new)``: path of a copy of the shipped picking arm with one text replaced."""

    def changed(old="", new=""):
        assert old in SHIPPED
        path = tmp_path / "arm.toml"
        path.write_text(SHIPPED.replace(old, new, 1), encoding="utf-8")
        return path

    return changed


def joint(number):
    """The text of one joint's table."""
    return "[[joints]]" + SHIPPED.split("[[joints]]")[number]


def following(number, leader):
    """The same where the joint has no limits of its own, but follows another."""
    lines = joint(number).splitlines(keepends=True)
    return (
        "".join(line for line in lines if not line.startswith(("lower", "upper", "speed"))) + f"follows = {leader}\n\n"
    )


def test_shipped_arms_load_under_their_own_names():
    assert [load_arm(name).name for name in shipped_arms()] == shipped_arms()
    assert {"qiao2026", "ur5", "wam"} <= set(shipped_arms())


def test_units_are_metres_and_radians_inside(qiao):
    g = qiao.nominal
    np.testing.assert_allclose(g.alpha, np.pi / 2 * np.array([1, 0, 1, -1, 1, 0]))
    np.testing.assert_allclose(g.d, [0, 0.3, 0.1, 0.16667, 0.10312, 0.12663])
    np.testing.assert_allclose(g.upper, [np.pi / 4, 0.6, 0.8, np.radians(75), 0.2, np.pi])
    np.testing.assert_allclose(qiao.speed, [np.pi / 3, 0.5, 0.5, np.pi / 3, 0.5, np.pi])


def test_table_1_as_printed(qiao):
    true = qiao.true
    np.testing.assert_allclose(np.degrees(true.alpha), [90.011, 0.029, 90.040, -89.983, 90.023, -0.006])
    np.testing.assert_allclose(true.a * 1e3, [122.520, 138.380, 0.230, 0.780, 0.560, 0.450])
    np.testing.assert_allclose(np.degrees(true.theta), [90.017, 0.029, 0.017, 90.046, 0.040, 0.034])
    np.testing.assert_allclose(true.d * 1e3, [0.500, 300.000, 100.600, 166.682, 103.620, 126.830])


def test_a_file_may_order_its_joints_as_it_likes(write, qiao):
    swapped = load_arm(write(joint(1) + joint(2), joint(2) + joint(1)))
    assert swapped.fingerprint() == qiao.fingerprint()


def test_the_fingerprint_tells_arms_apart(write, qiao):
    assert load_arm(write("d_mm = 100.0", "d_mm = 100.001")).fingerprint() != qiao.fingerprint()
    assert len({load_arm(name).fingerprint() for name in shipped_arms()}) == len(shipped_arms())


def test_base_and_tool_are_read(write):
    text = "\n[base]\nposition_mm = [0, 0, 900]\n[tool]\nrotation_vector_deg = [0, 0, 90.0]\n"
    path = write()
    path.write_text(SHIPPED + text, encoding="utf-8")
    g = load_arm(path).nominal
    np.testing.assert_allclose(g.base.position, [0, 0, 0.9])
    np.testing.assert_allclose(g.tool.rotation, [[0, -1, 0], [1, 0, 0], [0, 0, 1]], rtol=0, atol=1e-15)
    np.testing.assert_array_equal(g.base.rotation, np.eye(3))  # what is left out moves nothing
    np.testing.assert_array_equal(g.tool.position, np.zeros(3))


def test_an_edited_file_is_read_again(write):
    path = write()
    load_arm(path)
    path.write_text(SHIPPED.replace("d_mm = 100.0", "d_mm = 250.0", 1), encoding="utf-8")
    os.utime(path, ns=(1, 1))
    assert load_arm(path).nominal.d[2] == 0.25


MISTAKES = {
    "joint missing": (joint(3), "", ["joint 3 is missing"]),
    "joint twice": ("number = 4", "number = 3", ["joint 3 is given twice"]),
    "joint beyond the count": ("joint_count = 6", "joint_count = 5", ["joint number 6"]),
    "no count": ("joint_count = 6", "", ["joint_count is missing"]),
    "count not a number": ("joint_count = 6", 'joint_count = "six"', ["joint_count is 'six'"]),
    "key missing": ("a_mm = 138.0\n", "", ["a_mm", "joint 2", "missing"]),
    "true key missing": ("true_a_mm = 138.38\n", "", ["true_a_mm", "joint 2", "missing"]),
    "not finite": ("d_mm = 166.67", "d_mm = nan", ["d_mm", "joint 4", "nan"]),
    "not a number": ("theta_deg = 90.0", 'theta_deg = "90"', ["theta_deg", "joint 1", "'90'"]),
    "a truth value": ("a_mm = 138.0", "a_mm = true", ["a_mm", "joint 2", "True"]),
    "type unknown": ('type = "P"', 'type = "S"', ["joint 2", "'S'"]),
    "joint key misspelt": ("alpha_deg = 0.0", "aplha_deg = 0.0", ["aplha_deg", "joint 2"]),
    "limit in the wrong unit": ("upper_mm = 800.0", "upper_deg = 800.0", ["upper_deg", "joint 3"]),
    "limits swapped": ("lower_deg = -75.0", "lower_deg = 80.0", ["joint 4", "lower limit"]),
    "no range": ("upper_mm = 200.0", "upper_mm = 0.0", ["joint 5", "lower limit"]),
    "speed zero": ("speed_deg_per_s = 180.0", "speed_deg_per_s = 0", ["speed", "joint 6"]),
    "file key unknown": ('name = "qiao2026"', 'nmae = "qiao2026"', ["'nmae'"]),
    "convention unknown": ('"modified"', '"craig"', ["convention", "'craig'"]),
    "true values in standard DH": ('"modified"', '"standard"', ["true_", "modified"]),
    "base not a table": ("joint_count = 6", "joint_count = 6\nbase = 3", ["[base]"]),
    "base key misspelt": (
        "joint_count = 6",
        "joint_count = 6\nbase = { position = [0, 0, 1] }",
        ["'position'", "[base]"],
    ),
    "base of two numbers": (
        "joint_count = 6",
        "joint_count = 6\nbase = { position_mm = [0, 0] }",
        ["position_mm", "[base]"],
    ),
    "tool not finite": (
        "joint_count = 6",
        "joint_count = 6\ntool = { position_mm = [0, inf, 0] }",
        ["position_mm[1]", "[tool]"],
    ),
    "a link of a thousand kilometres": ("a_mm = 138.0", "a_mm = 1e12", ["a_mm of joint 2 is 1e+12", "100000"]),
    "a speed of light": ("speed_deg_per_s = 180.0", "speed_deg_per_s = 1e9", ["speed_deg_per_s of joint 6", "36000"]),
    "a name that is a list": ('name = "qiao2026"', 'name = ["a"]', ["name is ['a']", "text of one line"]),
    "a name of two lines": ('name = "qiao2026"', 'name = "a\\nb"', ["name is 'a\\nb'", "text of one line"]),
    "a joint's name that is a number": ('number = 2\nname = "', 'number = 2\nname = 3 # "', ["name of joint 2 is 3"]),
    "400 digits": ("a_mm = 138.0", f"a_mm = {'7' * 400}", ["a_mm is an integer of more than 64 bits"]),
    "5000 digits": ("a_mm = 138.0", f"a_mm = {'7' * 5000}", ["not valid TOML", "digits"]),
    "a date that is none": ("a_mm = 138.0", "a_mm = 2024-13-45", ["not valid TOML"]),
    "a date": ("a_mm = 138.0", "a_mm = 2024-12-24", ["a_mm of joint 2 is datetime.date(2024, 12, 24)"]),
    "depth": ("joint_count = 6", f"joint_count = {'[' * 5000}{']' * 5000}", ["nested too deeply"]),
    "a joint that follows none": (joint(2), following(2, 9), ["joint 2 follows 9"]),
    "a joint that follows itself": (joint(2), following(2, 2), ["joint 2 follows 2"]),
    "a joint that follows and has limits": (
        'type = "P"',
        'type = "P"\nfollows = 1',
        ["unknown key 'lower_mm'", "follows"],
    ),
    "a ratio of zero": ('type = "P"', 'type = "P"\nratio = 0', ["ratio of joint 2 is 0"]),
    "no TOML": ("joint_count = 6", "joint_count = = 6", ["not valid TOML"]),
}


@pytest.mark.parametrize(("old", "new", "named"), MISTAKES.values(), ids=MISTAKES)
def test_a_mistake_is_named_with_file_and_joint_or_key(write, old, new, named):
    path = write(old, new)
    with pytest.raises(InputError) as caught:
        load_arm(path)
    message = str(caught.value)
    assert "\n" not in message
    for word in (str(path), *named):
        assert word in message


def test_a_byte_order_mark_is_left_out(write, qiao):
    path = write("joint_count = 6", "joint_count = 6")
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes())
    assert load_arm(path).fingerprint() == qiao.fingerprint()


@pytest.mark.parametrize(
    "name", ["x" * 300, "x" * 300 + ".toml", "x" * 300 + ".urdf", "a\0b.toml", "a\0b.urdf", "/tmp.urdf"]
)
def test_a_name_that_no_file_can_have_is_refused(name):
    with pytest.raises(InputError) as caught:
        load_arm(name)
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 600


def test_a_plant_of_a_coupled_arm_is_refused(write, tmp_path):
    lines = SHIPPED.split("[[joints]]")
    lines[3] = (
        "\n".join(line for line in lines[3].splitlines() if not line.startswith(("lower", "upper", "speed")))
        + "\nfollows = 2\nratio = 0.5\n\n"
    )
    (tmp_path / "coupled.toml").write_text("[[joints]]".join(lines), encoding="utf-8")
    arm = load_arm(tmp_path / "coupled.toml")
    assert arm.nominal.joints == 5 and arm.nominal.coupling.joint == (0, 1, 1, 2, 3, 4)
    assert arm.true.coupling == arm.nominal.coupling
    plant = tmp_path / "plant.toml"
    plant.write_text(f'arm = "{tmp_path / "coupled.toml"}"\n')
    with pytest.raises(InputError, match="moves several links"):
        load_plant(plant)


def test_no_joints_at_all(tmp_path):
    path = tmp_path / "arm.toml"
    path.write_text("joint_count = 2\n")
    with pytest.raises(InputError, match=r"joints is missing; give one \[\[joints\]\] table per joint"):
        load_arm(path)


def test_an_unknown_arm_is_answered_with_the_known_ones():
    with pytest.raises(InputError, match=r"unknown arm 'ur50'.*'ur5'"):
        load_arm("ur50")


def test_an_arm_file_that_is_not_there_is_named(tmp_path):
    with pytest.raises(InputError, match=r"nowhere\.toml does not exist"):
        load_arm(tmp_path / "nowhere.toml")


def test_a_file_that_is_not_text_is_named(tmp_path):
    path = tmp_path / "arm.toml"
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match=r"arm\.toml is written in UTF-16"):
        load_arm(path)
