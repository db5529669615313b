"""Plants by the name of an arm: without error, or of a tolerance class that sizes what the arm does not bring."""

from dataclasses import replace

import numpy as np
import pytest

from pickenv.arm import (
    Pose,
    class_of,
    draw_arms,
    forward,
    load_arm,
    load_plant,
    load_tolerances,
    plant_at,
    plant_count,
    shipped_arms,
    shipped_plants,
)
from pickenv.base import GRAVITY, InputError

BARE = sorted(set(shipped_arms()) - set(shipped_plants()))


def test_a_class_without_an_arm_is_of_the_first_arm() -> None:
    assert load_plant("coarse:").arm.name == load_plant("ideal").arm.name == "qiao2026"


@pytest.mark.parametrize("arm", shipped_arms())
def test_without_error_the_arm_is_its_nominal_self(arm: str) -> None:
    plant, nominal = load_plant(f"ideal:{arm}"), load_arm(arm).nominal
    q = np.random.default_rng(0).uniform(nominal.lower, nominal.upper, (20, nominal.joints))
    np.testing.assert_allclose(plant.tool_pose(q).position, forward(nominal, q).position, atol=1e-12)


@pytest.mark.parametrize("arm", shipped_plants())
def test_an_arm_that_comes_with_a_plant_keeps_that_plants_effects(arm: str) -> None:
    own, classed = load_plant(arm), load_plant(f"coarse:{arm}")
    assert classed.name == f"coarse:{arm}" and classed.arm.fingerprint() == own.arm.fingerprint()
    assert classed.load == own.load and classed.names == own.names
    for mine, theirs in zip(own.effects, classed.effects, strict=True):
        if mine.name == "local_structure":
            np.testing.assert_array_equal(theirs.field.weight, mine.field.weight)
        else:
            assert theirs == mine
    assert class_of(f"coarse:{arm}") == load_tolerances("coarse") and class_of(arm) is None


def gravity_energy(geometry, mass, centre, q) -> float:
    """Potential energy of the rods, by their centres' heights."""
    height = 0.0
    for i in range(geometry.joints):
        part = slice(0, i + 1)
        shown = replace(
            geometry,
            joint_names=geometry.joint_names[part],
            prismatic=geometry.prismatic[part],
            **{key: getattr(geometry, key)[part] for key in ("alpha", "a", "theta", "d", "beta", "lower", "upper")},
            tool=Pose(np.array(centre[i]), np.eye(3)),
        )
        height += mass[i] * forward(shown, q[part]).position[2]
    return GRAVITY * height


@pytest.mark.parametrize("arm", BARE)
def test_no_joint_of_a_bare_arm_sags_more_than_its_class_says_and_one_nearly_as_much(arm: str) -> None:
    """Torques are recomputed as slopes of the rods' potential energy."""
    plant, sizes = load_plant(f"coarse:{arm}"), load_tolerances("coarse").sizes
    geometry = plant.arm.nominal
    poses = np.random.default_rng(1).uniform(geometry.lower, geometry.upper, (20, geometry.joints))
    step, sag = 1e-5, np.zeros((len(poses), geometry.joints))
    for k, q in enumerate(poses):
        for j in range(geometry.joints):
            ends = [q + sign * step * np.eye(geometry.joints)[j] for sign in (1, -1)]
            high, low = (gravity_energy(geometry, plant.load.mass, plant.load.centre, end) for end in ends)
            sag[k, j] = abs(high - low) / (2 * step) / plant.effect("joint_compliance").stiffness[j]
    most = np.where(geometry.prismatic, sizes.sliding_sag, sizes.turning_sag)
    assert (sag <= 1.05 * most).all()
    assert (sag.max(axis=0) / most).max() > 0.7 or arm == "positioner"  # gravity loads neither of its joints
    assert list(plant.effect("backlash").width) == list(
        np.where(geometry.prismatic, sizes.sliding_gap, sizes.turning_gap)
    )
    preload = np.array(plant.effect("joint_compliance").stiffness) * most * sizes.preload_share
    np.testing.assert_allclose(plant.effect("backlash").preload, preload)


@pytest.mark.parametrize("arm", BARE)
def test_the_rods_run_from_joint_to_joint(arm: str) -> None:
    """Twice a rod's centre is where the next frame stands, with slides half run out."""
    geometry = load_arm(arm).nominal
    load = load_plant(f"coarse:{arm}").load
    q = np.where(geometry.prismatic, (geometry.lower + geometry.upper) / 2, 0.0)
    chains = []
    for count in range(1, geometry.joints + 1):
        part = slice(0, count)
        numbers = {key: getattr(geometry, key)[part] for key in ("alpha", "a", "theta", "d", "beta", "lower", "upper")}
        still = Pose(np.zeros(3), np.eye(3))
        tool = geometry.tool if count == geometry.joints else still
        here = replace(geometry, joint_names=geometry.joint_names[part], prismatic=geometry.prismatic[part], **numbers)
        chains.append((forward(replace(here, tool=still), q[part]), forward(replace(here, tool=tool), q[part])))
    for i, (start, own_tool) in enumerate(chains):
        end = own_tool.position if i + 1 == len(chains) else chains[i + 1][0].position
        centre = start.position + start.rotation @ load.centre[i]
        np.testing.assert_allclose(centre, (start.position + end) / 2, atol=1e-12)
        assert load.mass[i] == pytest.approx(np.linalg.norm(end - start.position))


def test_arms_of_a_class_are_drawn_from_it_whatever_else_is_asked_for() -> None:
    def draw(name: str, other: str):
        return draw_arms(name, other, 3, np.random.default_rng(5))

    one, same, other = draw("coarse:ur5e", "fine"), draw("coarse:ur5e", "coarse"), draw("fine:ur5e", "coarse")
    np.testing.assert_array_equal(one.geometry.alpha, same.geometry.alpha)
    assert plant_count(one) == 3
    spread = [np.ptp(arms.geometry.alpha, axis=0).min() for arms in (one, other)]
    assert spread[0] > 2 * spread[1] > 0
    low, high = load_tolerances("coarse").temperature_rise
    assert ((one.effect("thermal_growth").final_rise >= low) & (one.effect("thermal_growth").final_rise <= high)).all()
    first = plant_at(one, 0)
    assert first.effect("joint_compliance").stiffness != plant_at(one, 1).effect("joint_compliance").stiffness
    assert first.effect("backlash").width[0] != plant_at(one, 1).effect("backlash").width[0]


def test_effects_are_switched_off_by_name() -> None:
    plant = load_plant("coarse:ur5e", without=["backlash", "thermal_growth"])
    assert (
        plant.effect("backlash") is None
        and plant.effect("thermal_growth") is None
        and plant.effect("joint_compliance") is not None
    )


def test_files_may_stand_on_either_side_of_the_colon(tmp_path) -> None:
    arm, plant, bare = tmp_path / "arm.toml", tmp_path / "plant.toml", tmp_path / "own.toml"
    arm.write_text(ARM, encoding="utf-8")
    plant.write_text(f'arm = "{arm}"\n[encoder]\njoints = [{{ joint = 1, resolution_arcsec = 60.0 }}]\n')
    assert load_plant(f"fine:{arm}").effect("backlash") is not None
    assert (
        load_plant(f"fine:{plant}").effect("backlash") is None
        and load_plant(f"fine:{plant}").effect("encoder") is not None
    )
    bare.write_text(CLASS, encoding="utf-8")
    assert load_plant(f"{bare}:{plant}").effect("encoder") is not None
    with pytest.raises(InputError, match=r"tolerance class 'own' has no \[sizes\], which arm 'ur5e' needs"):
        load_plant(f"{bare}:ur5e")


ARM = """joint_count = 1
[[joints]]
number = 1
type = "R"
alpha_deg = 90.0
a_mm = 0.0
theta_deg = 0.0
d_mm = 100.0
lower_deg = -90.0
upper_deg = 90.0
speed_deg_per_s = 90.0
[tool]
position_mm = [200.0, 0.0, 0.0]
"""
CLASS = """[lengths]
it_grade = 9
least_length_mm = 50.0
distribution = "uniform"
[angles]
half_width_deg = 0.01
[spread]
[temperature]
rise_K = [0.0, 1.0]
"""


def test_names_that_mean_nothing_get_one_sentence() -> None:
    cases = [
        (
            "corse:ur5e",
            "unknown tolerance class 'corse'; give one of ideal, coarse, cobot, fine, medium, printed, or a path",
        ),
        ("coarse:ur55", "unknown arm 'ur55'"),
        ("ideal:ur55", "unknown arm 'ur55'"),
        ("nothing.toml:ur5e", "tolerance class file nothing.toml does not exist"),
        ("corse:ur55", "unknown plant 'corse:ur55'"),
    ]
    for name, said in cases:
        with pytest.raises(InputError, match=said):
            load_plant(name)


def test_an_ideal_arm_moves_one_link_per_joint_as_every_other_plant(tmp_path):
    path = tmp_path / "lift.toml"
    joints = [
        f'[[joints]]\nnumber = {i}\ntype = "P"\nalpha_deg = 0.0\na_mm = 0.0\ntheta_deg = 0.0\nd_mm = 0.0\n{rest}\n'
        for i, rest in enumerate(
            ("lower_mm = 0.0\nupper_mm = 400.0\nspeed_mm_per_s = 10.0", "follows = 1\nratio = 0.5"), 1
        )
    ]
    path.write_text('name = "lift"\njoint_count = 2\n' + "".join(joints), encoding="utf-8")
    with pytest.raises(InputError, match="moves several links"):
        load_plant(f"ideal:{path}")
