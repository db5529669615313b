"""The machine of Li 2016: closed forms against the generic kinematics, and what its tables really say."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from papers.li2016.comparison import joint_curves, workspace
from pickenv import harvester
from pickenv.arm import forward, load_arm
from pickenv.base import InputError
from pickenv.harvester import load_machine, profile, travel_time

TARGETS = np.array([[420, -1400, 1000], [96, -1450, 1280], [-500, -1386, 1500]]) * 1e-3
PICK_POINT = np.array([-80, -660, 1220]) * 1e-3
TABLE2_450 = np.array([[80, -0.05123, 273.328], [360, 0.11168, 289.6709], [580, -0.08083, 155.204]])


def random_joints(machine, rng, count=500):
    q = rng.uniform(machine.lower, machine.upper, (count, machine.joints))
    return q[:, :3], q[:, 3:].reshape(count, machine.arms, 3)


def whole_arm(machine, i):
    """The serial chain of the master and slave ``i``: six joints from base to cup."""
    master, slave = machine.master.nominal, machine.slaves[i].nominal
    tables = ("alpha", "a", "theta", "d", "beta", "lower", "upper")
    numbers = {name: np.concatenate([getattr(master, name), getattr(slave, name)]) for name in tables}
    names, kinds = master.joint_names + slave.joint_names, master.prismatic + slave.prismatic
    return replace(master, joint_names=names, prismatic=kinds, tool=slave.tool, **numbers)


def generic_tips(machine, master, slaves):
    """What `Machine.tips` gives, by the project's generic forward kinematics."""
    joints = (np.concatenate([master, slaves[:, i]], axis=-1) for i in range(machine.arms))
    return np.stack([forward(whole_arm(machine, i), q).position for i, q in enumerate(joints)], axis=-2)


@pytest.mark.parametrize("arms", range(1, 7))
def test_closed_forms_equal_the_generic_kinematics_for_one_to_six_arms(arms):
    machine = load_machine(slaves=arms)
    master, slaves = random_joints(machine, np.random.default_rng(arms))
    tips = machine.tips(master, slaves)
    assert np.abs(tips - generic_tips(machine, master, slaves)).max() < 1e-9
    assert np.abs(machine.frame3(master) - forward(machine.master.nominal, master).position).max() < 1e-9
    assert np.abs(machine.master_inverse(machine.frame3(master)) - master).max() < 1e-9
    found = machine.slave_inverse(master, tips)
    assert np.abs(found[:, range(arms), range(arms)] - slaves).max() < 1e-9
    assert machine.reach(master, tips)[:, range(arms), range(arms)].all()


def test_the_chain_is_equation_2_to_4(machine):
    theta1, d2, d3 = -1.1, 0.9, 0.6
    rotation = forward(machine.master.nominal, [theta1, d2, d3]).rotation
    sin, cos = np.sin(theta1), np.cos(theta1)
    assert rotation == pytest.approx(np.array([[sin, 0, cos], [-cos, 0, sin], [0, -1, 0]]), abs=1e-12)
    middle = whole_arm(machine, 1)
    swing = 0.2
    rotation = forward(middle, [theta1, d2, d3, 0.1, swing, 0.5]).rotation
    turn = theta1 + swing - np.pi / 2  # theta5 counts from -pi/2; o_z is printed as 1, which makes no rotation
    wanted = [[np.cos(turn), 0, -np.sin(turn)], [np.sin(turn), 0, np.cos(turn)], [0, -1, 0]]
    assert rotation == pytest.approx(np.array(wanted), abs=1e-12)


def test_the_master_row_of_table_2_is_exact(machine):
    moved = machine.master_inverse(PICK_POINT) - machine.master_start
    assert moved * (1, 1e3, 1e3) == pytest.approx([-1.456112, 500, 381.50986], abs=1e-5)


def test_a_slave_spacing_of_450_mm_reproduces_table_2():
    machine = load_machine(spacing=0.45)
    joints = machine.slave_inverse(machine.master_inverse(PICK_POINT), TARGETS)[range(3), range(3)]
    assert (joints - machine.slave_home) * (1e3, 1, 1e3) == pytest.approx(TABLE2_450, abs=1e-4, rel=1e-6)


def test_a_spacing_of_350_mm_misses_the_targets_of_table_2_by_100_mm(machine):
    moves = TABLE2_450 * (1e-3, 1, 1e-3)
    tips = machine.tips(machine.master_inverse(PICK_POINT), machine.slave_home + moves)
    miss = np.linalg.norm(tips - TARGETS, axis=-1)
    assert miss == pytest.approx([0.1, 0.0, 0.1], abs=2e-4)


def test_the_start_points_imply_a_spacing_of_300_mm():
    machine = load_machine(spacing=0.3)
    tips = machine.tips(machine.master_start, np.array([machine.slave_home] * 3))
    assert tips * 1e3 == pytest.approx(np.array([[785, 145, 420], [785, -155, 420], [785, -455, 420]]))


def test_a_principal_arctangent_in_equation_6_lands_on_the_wrong_branch(machine):
    master = machine.master_inverse(PICK_POINT)
    right = machine.slave_inverse(master, TARGETS)[range(3), range(3)]
    heading = master[0]
    side, ahead = machine.a2 + machine.offsets, machine.a4 + master[2]
    a = TARGETS[:, 0] - ahead * np.cos(heading) - side * np.sin(heading)
    b = TARGETS[:, 1] - ahead * np.sin(heading) + side * np.cos(heading)
    printed = right.copy()
    printed[:, 1] = -heading - np.arctan(a / b) + np.pi / 2
    miss = np.linalg.norm(machine.tips(master, printed) - TARGETS, axis=-1)
    assert ((miss > 1.2) & (miss < 1.6)).all()
    assert machine.tips(master, right) == pytest.approx(TARGETS, abs=1e-12)


def test_equation_5_as_printed_holds_at_negative_y_only(machine):
    def printed(x, y):
        r = np.hypot(x, y)
        return np.pi / 2 - np.arccos(x / r) - np.arccos(machine.a2 / r)

    for y, same in ((-0.66, True), (0.66, False)):
        ours = machine.master_inverse([0.3, y, 1.0])[0]
        turn = (printed(0.3, y) - ours + np.pi) % (2 * np.pi) - np.pi
        assert (abs(turn) < 1e-9) == same


def test_corrected_ranges_give_the_stated_work_height_of_800_to_2900_mm(machine):
    low = machine.d1 + machine.lower[1] + machine.lower[3] + machine.base_height
    high = machine.d1 + machine.upper[1] + machine.upper[3] + machine.base_height
    assert (low, high) == pytest.approx((0.8, 2.9))
    literal = (0.72 + 0.0, 2.22 + 0.6)  # Table 1 to the letter contradicts Fig. 8
    assert (literal[0] + machine.d1, literal[1] + machine.d1) == pytest.approx((1.01, 3.11), abs=0.01)


def test_neighbouring_arms_overlap_by_up_to_300_mm(machine):
    assert machine.slave.upper[1] == pytest.approx(np.arcsin(325 / 868), abs=1e-5)
    side = machine.slave.upper[2] * np.sin(machine.slave.upper[1])
    assert 2 * side - machine.spacing == pytest.approx(0.3, abs=1e-3)


def test_the_workspace_is_that_of_figure_8(machine):
    cloud = workspace(machine, 4000, np.random.default_rng(0)).reshape(-1, 3)
    assert cloud[:, 2].min() >= 0.42 - 1e-9 and cloud[:, 2].max() <= 2.52 + 1e-9
    dense = np.quantile(cloud, [0.1, 0.9], axis=0)
    assert dense[0, 0] < -1.2 and dense[1, 0] > 1.2 and dense[0, 1] < -1.4


def test_joint_curves_end_at_table_2_and_keep_the_speed_limits():
    machine = load_machine(spacing=0.45)
    master = machine.master_inverse(PICK_POINT)
    goal = machine.slave_inverse(master, TARGETS)[range(3), range(3)]
    start = np.concatenate([machine.master_start, *[machine.slave_home] * 3])
    time, moved = joint_curves(machine, start, np.concatenate([master, goal.ravel()]), 2001)
    assert moved[0] == pytest.approx(np.zeros(12))
    assert moved[-1, 3:].reshape(3, 3) * (1e3, 1, 1e3) == pytest.approx(TABLE2_450, abs=1e-3)
    speed = np.abs(np.diff(moved, axis=0)) / np.diff(time)[:, None]
    assert (speed.max(axis=0) <= machine.speed * 1.001).all()


@pytest.mark.parametrize("distance", [0.0, 1e-4, 0.05, 0.4, -0.4])
def test_trapezoidal_profiles_end_when_they_say(distance):
    total = float(travel_time(distance, 0.5, 2.0))
    assert profile(total, distance, 0.5, 2.0) == pytest.approx(distance, abs=1e-12)
    time = np.linspace(0, total, 400)
    way = profile(time, distance, 0.5, 2.0)
    assert (np.diff(np.abs(way)) >= -1e-12).all()
    assert np.abs(np.diff(way)).max(initial=0) <= 0.5 * (time[1] - time[0]) * 1.001 + 1e-12


def test_six_arms_stand_side_by_side_at_equal_distances():
    machine = load_machine(slaves=6, spacing=0.3)
    assert np.diff(machine.offsets) == pytest.approx(np.full(5, 0.3))
    assert machine.offsets.sum() == pytest.approx(0)


@pytest.mark.parametrize("count", [0, 7, 2.5, float("nan"), "three"])
def test_an_impossible_number_of_arms_is_refused(count):
    with pytest.raises(InputError, match="slave arms"):
        load_machine(slaves=count)


def test_a_spacing_at_which_arms_meet_at_rest_is_refused():
    with pytest.raises(InputError, match=r"meet at rest.*at least \d+ mm"):
        load_machine(spacing=0.15)
    assert load_machine(slaves=1, spacing=0.15).arms == 1
    for spacing in (0.3, 0.35, 0.45):
        assert load_machine(spacing=spacing).spacing == spacing


@pytest.mark.parametrize("spacing", [0.0, -1.0, float("nan")])
def test_an_impossible_spacing_is_refused(spacing):
    with pytest.raises(InputError, match="spacing"):
        load_machine(spacing=spacing)


def test_the_arms_are_shipped_with_the_arm_room():
    assert load_arm("li2016_master").nominal.prismatic == (False, True, True)
    assert load_arm("li2016_slave").nominal.prismatic == (True, False, True)


def test_slaves_rest_within_their_slide(tmp_path):
    text = Path(harvester.__file__).with_name("li2016.toml").read_text(encoding="utf-8")
    for height, fits in ((-300.0, True), (300.0, True), (-301.0, False), (900.0, False)):
        own = tmp_path / "own.toml"
        own.write_text(text.replace("slave_home_mm = -300.0", f"slave_home_mm = {height}"), encoding="utf-8")
        if fits:
            assert load_machine(own).slave_home[0] == pytest.approx(height * 1e-3)
        else:
            with pytest.raises(InputError, match=rf"slave_home_mm of \[machine\] is {height:g}; .* -300 to 300$"):
                load_machine(own)
