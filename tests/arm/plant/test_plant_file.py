"""Plant files: impossible numbers and misspelt names get one sentence that names file and key."""

import math

import numpy as np
import pytest

from pickenv.arm import forward, load_plant
from pickenv.base import InputError

SOUND = """
name = "sound"
arm = "qiao2026"

[load]
mass_kg = [4.0, 3.0, 2.4, 0.9, 0.6, 0.5]
centre_mm = [[60, 0, 0], [0, 0, -80], [0, 0, -350], [0, 0, -30], [0, 0, -40], [0, 0, -60]]
payload_kg = 0.25

[joint_compliance]
stiffness = [9.0e3, 4.0e5, 4.0e5, 2.5e3, 3.0e5, 2.0e3]

[boom_bending]
joint = 3
length_mm = 400.0
flexural_rigidity_N_m2 = 1.2e4
end_mass_kg = 2.0
mass_per_length_kg_per_m = 1.8

[transmission_error]
lead = [0.0, 1.0e-4, 1.5e-4, 0.0, 1.0e-4, 0.0]
harmonics = [
  { joint = 1, amplitude_arcmin = 0.5, period_deg = 90.0, phase_deg = -20.0 },
  { joint = 2, amplitude_mm = 0.05, period_mm = 400.0, phase_deg = 10.0 },
]

[measurement_noise]
position_std_mm = 0.015
attitude_std_deg = 0.012
"""

MISTAKES = {
    "negative stiffness": ("9.0e3", "-9.0e3", ["stiffness", "[joint_compliance]", "above zero"]),
    "stiffness zero": ("9.0e3", "0", ["stiffness", "[joint_compliance]", "above zero"]),
    "stiffness of five joints": ("9.0e3, ", "", ["stiffness", "6 entries, one per joint"]),
    "stiffness not a list": ("[9.0e3, 4.0e5, 4.0e5, 2.5e3, 3.0e5, 2.0e3]", "9e3", ["stiffness", "list of numbers"]),
    "negative mass": ("[4.0,", "[-4.0,", ["mass_kg", "[load]"]),
    "mass as text": ("[4.0,", '["4",', ["mass_kg", "'4'"]),
    "a payload of a ship": ("payload_kg = 0.25", "payload_kg = 1e300", ["payload_kg", "1e+300", "at most 10000"]),
    "a link of a ship": ("mass_kg = [4.0", "mass_kg = [4e9", ["mass_kg", "at most 10000"]),
    "a boom of a thousand kilometres": ("length_mm = 400.0", "length_mm = 1e9", ["length_mm", "at most 100000"]),
    "a name that is a list": ('name = "sound"', 'name = ["sound"]', ["name is ['sound']"]),
    "negative payload": ("payload_kg = 0.25", "payload_kg = -0.1", ["payload_kg", "[load]"]),
    "payload misspelt": ("payload_kg = 0.25", "payload = 0.25", ["'payload'", "[load]"]),
    "centre of two numbers": ("[60, 0, 0]", "[60, 0]", ["centre_mm", "3 numbers"]),
    "five centres": ("[60, 0, 0], ", "", ["centre_mm", "6 entries, one per joint"]),
    "boom on a revolute joint": ("joint = 3\nlength", "joint = 4\nlength", ["joint", "[boom_bending]", "revolute"]),
    "boom on no joint": ("joint = 3\nlength", "joint = 7\nlength", ["joint", "[boom_bending]", "1 to 6"]),
    "boom between joints": ("joint = 3\nlength", "joint = 2.5\nlength", ["joint", "[boom_bending]", "whole number"]),
    "no rigidity": ("flexural_rigidity_N_m2 = 1.2e4\n", "", ["flexural_rigidity_N_m2", "missing"]),
    "rigidity not finite": ("1.2e4", "inf", ["flexural_rigidity_N_m2", "inf"]),
    "no period": ("period_deg = 90.0", "period_deg = 0.0", ["period_deg", "harmonics", "above zero"]),
    "harmonic in the wrong unit": ("joint = 1, amplitude_arcmin", "joint = 2, amplitude_arcmin", ["amplitude_mm"]),
    "harmonics not a list": (
        SOUND[SOUND.index("harmonics") : SOUND.index("]\n\n[meas") + 1],
        "harmonics = 3",
        ["harmonics"],
    ),
    "lead not a number": ("lead = [0.0", "lead = [nan", ["lead", "[transmission_error]"]),
    "negative noise": ("position_std_mm = 0.015", "position_std_mm = -1", ["position_std_mm", "[measurement_noise]"]),
    "effect unknown": ("[measurement_noise]", "[mesurement_noise]", ["'mesurement_noise'", "measurement_noise"]),
    "load missing": (SOUND[SOUND.index("[load]") : SOUND.index("[joint_c")], "", ["joint_compliance", "[load]"]),
    "arm unknown": ('arm = "qiao2026"', 'arm = "qiao"', ["unknown arm 'qiao'"]),
    "arm missing": ('arm = "qiao2026"\n', "", ["arm is missing"]),
}


@pytest.fixture
def write(tmp_path):
    def text(content):
        path = tmp_path / "plant.toml"
        path.write_text(content, encoding="utf-8")
        return path

    return text


def test_units_are_si_inside(write):
    plant = load_plant(write(SOUND))
    assert plant.name == "sound"
    assert plant.load.centre[2] == pytest.approx((0, 0, -0.35))
    assert plant.load.payload == 0.25
    assert plant.effect("joint_compliance").stiffness == (9e3, 4e5, 4e5, 2.5e3, 3e5, 2e3)
    assert (plant.effect("boom_bending").joint, plant.effect("boom_bending").length) == (2, 0.4)
    turn, slide = plant.effect("transmission_error").harmonics
    assert (turn.joint, slide.joint) == (0, 1)
    assert (turn.amplitude, turn.period) == pytest.approx((math.radians(0.5 / 60), math.pi / 2))
    assert (slide.amplitude, slide.period, slide.phase) == pytest.approx((5e-5, 0.4, math.radians(10)))
    assert plant.effect("measurement_noise").position_std == pytest.approx(15e-6)
    assert plant.effect("measurement_noise").attitude_std == pytest.approx(math.radians(0.012))


@pytest.mark.parametrize(("old", "new", "named"), MISTAKES.values(), ids=MISTAKES)
def test_a_mistake_is_named_with_file_and_key(write, old, new, named):
    assert old in SOUND
    path = write(SOUND.replace(old, new, 1))
    with pytest.raises(InputError) as caught:
        load_plant(path)
    message = str(caught.value)
    assert "\n" not in message
    for word in (str(path), *named):
        assert word in message


def test_an_arm_without_true_values_is_built_as_its_controller_believes(write):
    """Its effects are the file's all the same."""
    text = SOUND[: SOUND.index("[boom_bending]")].replace("qiao2026", "ur5")
    plant = load_plant(write(text + SOUND[SOUND.index("[measurement_noise]") :]))
    assert plant.geometry is plant.arm.nominal and plant.effect("joint_compliance").stiffness[0] == 9e3
    q = np.array([0.3, -1.0, 1.0, 0.2, 0.4, 0.5])
    sagged = forward(plant.arm.nominal, q).position - plant.tool_pose(q).position
    assert sagged[2] > 0


def test_an_effect_that_is_no_table_is_refused(write):
    path = write('arm = "qiao2026"\nmeasurement_noise = 3\n')
    with pytest.raises(InputError, match=r"\[measurement_noise\] must be a table"):
        load_plant(path)


def test_switching_off_an_unknown_effect_is_answered_with_the_known_ones():
    with pytest.raises(InputError, match=r"unknown effect 'backlahs'.*boom_bending"):
        load_plant("qiao2026", without=["backlahs"])


@pytest.mark.parametrize("name", ["orchrad", "nowhere/plant.toml"])
def test_an_unknown_plant_is_answered_with_the_known_ones(name):
    with pytest.raises(InputError, match=r"(unknown plant|plant file).*'geometry_only'"):
        load_plant(name)


@pytest.mark.parametrize(("joint", "slides"), [(1, True), (2, False), (3, True)])
def test_sizes_of_a_joint_are_in_the_unit_of_its_kind_from_the_first_joint_to_the_last(tmp_path, joint, slides):
    path = tmp_path / "plant.toml"
    for unit, right in (("mm", slides), ("arcmin", not slides)):
        path.write_text(
            f'arm = "li2016_slave"\n[stick_band]\n'
            f"joints = [{{ joint = {joint}, forward_{unit} = 2.0, backward_{unit} = 1.0 }}]\n"
        )
        if right:
            band = load_plant(path).effect("stick_band")
            size = 2e-3 if slides else 2.0 / 60 * math.pi / 180
            expected = [size if i + 1 == joint else 0.0 for i in range(3)]
            assert list(band.forward) == pytest.approx(expected)
        else:
            with pytest.raises(InputError, match=f"forward_{unit}"):
                load_plant(path)


LIFT = """
name = "lift"
joint_count = 2
[[joints]]
number = 1
type = "R"
alpha_deg = -90.0
a_mm = 0.0
theta_deg = 0.0
d_mm = 0.0
lower_deg = -90.0
upper_deg = 90.0
speed_deg_per_s = 10.0
[[joints]]
number = 2
type = "P"
alpha_deg = 0.0
a_mm = 0.0
theta_deg = 0.0
d_mm = 500.0
lower_mm = -400.0
upper_mm = 400.0
speed_mm_per_s = 10.0
"""
SAGGING = """
name = "sagging"
arm = "lift.toml"
source = "a test"
[load]
mass_kg = [1.0, 1.0]
centre_mm = [[0, 0, 0], [0, 0, 0]]
payload_kg = 5.0
[boom_bending]
joint = 2
length_mm = 0.0
flexural_rigidity_N_m2 = 1.0e3
end_mass_kg = 2.0
mass_per_length_kg_per_m = 1.0
"""


def test_a_boom_shorter_than_nothing_is_refused(tmp_path):
    (tmp_path / "lift.toml").write_text(LIFT, encoding="utf-8")
    path = tmp_path / "plant.toml"
    path.write_text(SAGGING.replace("lift.toml", f"{tmp_path}/lift.toml"), encoding="utf-8")
    with pytest.raises(InputError, match=r"length_mm of \[boom_bending\] is 0; give at least the 400 mm that joint 2"):
        load_plant(path)
