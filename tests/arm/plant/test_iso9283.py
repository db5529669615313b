"""ISO 9283 on the simulated arm: its formulas, what each figure can see, and what calibration can and cannot mend."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats
from scipy.spatial import cKDTree

from pickenv.arm import (
    Iso9283Settings,
    Pace,
    iso9283,
    largest_cube,
    load_arm,
    load_instrument,
    load_plant,
    shipped_effects,
)
from pickenv.arm.plant.iso9283 import NORM_OF_NOISE, pose_performance
from pickenv.base import InputError
from pickenv.calibration import random_joints, read_measurements, simulated_tracker

EFFECTS = shipped_effects()

SHORT = Iso9283Settings(cycles=5, pace=Pace(period=0.1, dwell=2.0), drift_cycles=2, drift_interval=3600.0)
CUBE = largest_cube(load_plant("orchard").arm.nominal, steps=12)


def only(*effects):
    return load_plant("orchard", without=[name for name in EFFECTS if name not in effects])


def judged(plant, compensate=None, settings=SHORT, seed=0, **more):
    return iso9283(plant, compensate, rng=np.random.default_rng(seed), settings=settings, cube=CUBE, **more)


@pytest.fixture(scope="module")
def orchard():
    return judged(load_plant("orchard"))


def test_figures_are_the_formulas_of_the_standard():
    rng = np.random.default_rng(0)
    errors = rng.normal([1e-3, -2e-3, 5e-4, 1e-3, 0, 0], 1e-4, (30, 6))
    found = pose_performance("P1", errors)
    mean = errors.mean(axis=0)
    distances = np.sqrt(((errors - mean)[:, :3] ** 2).sum(axis=1))
    spread = np.sqrt(((distances - distances.mean()) ** 2).sum() / 29)
    assert found["accuracy_mm"] == pytest.approx(1e3 * np.sqrt((mean[:3] ** 2).sum()))
    assert found["repeatability_mm"] == pytest.approx(1e3 * (distances.mean() + 3 * spread))
    low, high = found["repeatability_ci95_mm"]
    assert low < found["repeatability_mm"] < high
    assert pose_performance("P1", errors[:29])["repeatability_ci95_mm"] is None  # the standard's thirty, or none
    assert pose_performance("P1", errors[:2])["repeatability_ci95_mm"] is None  # and no warning that one has no scatter
    assert pose_performance("P1", np.tile(errors[0], (30, 1)))["repeatability_ci95_mm"] is None
    coarse = np.tile(errors[0], (30, 1))
    coarse[7, 0] += 1e-4  # an instrument that prints tenths of a millimetre
    assert pose_performance("P1", coarse)["repeatability_ci95_mm"] is None
    turn = 3 * np.degrees(np.sqrt(((errors - mean)[:, 3:] ** 2).sum(axis=0) / 29))
    assert found["repeatability_deg"] == pytest.approx(tuple(turn))
    assert found["mean_error_mm"] == pytest.approx(tuple(1e3 * mean[:3]))


def test_an_arm_without_effects_repeats_exactly_and_misses_by_its_geometry():
    plant = load_plant("geometry_only")
    found = judged(plant).raw
    poses = CUBE.inclined_plane()
    assert found["worst_repeatability_mm"] < 1e-9
    assert max(found["variation_mm"].values()) < 1e-9
    assert found["drift_mm"] < 1e-9
    assert len(found["poses"]) == len(poses.position) == 5
    assert 0.5 < found["worst_accuracy_mm"] < 8


def test_the_instruments_noise_shows_in_repeatability():
    found = judged(only("measurement_noise"), settings=replace(SHORT, cycles=60))
    # The norm of three normal components has mean 1.596 sigma and standard deviation 0.673 sigma.
    distance = np.linalg.norm(CUBE.inclined_plane().position - load_instrument("laser_tracker").stand, axis=1).mean()
    expected = (15e-3 + 0.7e-3 * distance) * (1.596 + 3 * 0.673)
    assert [pose["repeatability_mm"] for pose in found.raw["poses"]] == pytest.approx([expected] * 5, rel=0.25)
    assert found.instrument_mm == pytest.approx(expected, rel=1e-3)


def test_friction_that_scatters_from_stop_to_stop_shows_in_repeatability():
    """And hardly in vAP, whose means even it out."""
    plant = only("stick_band")
    steady, scattered, twice = (
        judged(
            plant.with_effect(replace(plant.effect("stick_band"), scatter=share)), settings=replace(SHORT, cycles=30)
        )
        for share in (0.0, 0.2, 0.4)
    )
    assert steady.raw["worst_repeatability_mm"] < 1e-6
    for pose, again in zip(scattered.raw["poses"], twice.raw["poses"], strict=True):
        assert 0.02 < pose["repeatability_mm"] < 0.1
        assert again["repeatability_mm"] == pytest.approx(2 * pose["repeatability_mm"], rel=0.1)
    for pose, variation in steady.raw["variation_mm"].items():
        assert scattered.raw["variation_mm"][pose] == pytest.approx(variation, abs=0.03)


def test_the_simulated_arm_comes_back_about_as_a_measured_one_does(data_folder):
    """A UR10 that returned to 255 poses, with other poses between (Landgraf et al. 2021, series B); mm per axis."""
    path = data_folder / "ur10_ipa_landgraf2021" / "Series_B" / "measurements_joint_configurations.csv"
    rows = read_measurements(path, load_arm("ur10").nominal, "ur10_landgraf2021_repeats")
    once, again = cKDTree(rows.joints).query_pairs(1e-4, p=np.inf, output_type="ndarray").T
    assert len(once) == 255 and (np.abs(once - again) > 1).all()
    change = 1e3 * np.linalg.norm(rows.position[once] - rows.position[again], axis=-1)
    measured = np.median(change) / np.sqrt(2) / stats.chi(3).median()  # some poses moved further: the base did not hold
    settings = replace(SHORT, cycles=30)
    poses = judged(load_plant("orchard", without=["measurement_noise"]), settings=settings).raw["poses"]
    simulated = np.mean([pose["repeatability_mm"] for pose in poses]) / NORM_OF_NOISE
    assert measured == pytest.approx(0.010, abs=0.001)
    assert measured / 2 < simulated < 2 * measured


def test_backlash_shows_in_vap_and_not_in_repeatability():
    found = judged(only("backlash")).raw
    assert max(found["variation_mm"].values()) > 0.1
    assert found["worst_repeatability_mm"] < 1e-6


@pytest.mark.parametrize("effect", ["thermal_growth", "base_tilt"])
def test_warm_up_and_sinkage_show_in_drift(effect):
    found = judged(only(effect)).raw
    assert found["wander_mm"] > 0.2
    assert found["drift_mm"] > 0.05
    assert found["drift_hours"][0] == 0.0
    assert found["drift_hours"][-1] == pytest.approx(8.0)
    assert len(found["drift_hours"]) == len(found["drift_accuracy_mm"]) == 9


def test_effects_of_the_joints_alone_drift_and_vary_no_further_than_the_noise():
    found = judged(load_plant("qiao2026")).raw
    assert max(found["variation_mm"].values()) < 0.05
    assert found["wander_mm"] < 0.05


def test_the_orchard_arm_is_as_poor_as_field_arms_are(orchard):
    raw = orchard.raw
    assert 2 < raw["worst_accuracy_mm"] < 12
    assert 0.02 < raw["worst_repeatability_mm"] < 0.2
    assert 0.1 < max(raw["variation_mm"].values()) < 2
    assert 0.5 < raw["drift_mm"] <= raw["wander_mm"] < 5


def test_calibration_mends_accuracy_and_neither_repeatability_nor_variation():
    from pickenv.calibration import fit

    plant = load_plant("qiao2026")
    rng = np.random.default_rng(1)
    measurements = simulated_tracker(plant, random_joints(plant.arm.nominal, 60, rng), rng)
    compensate = fit(plant.arm, measurements, known_frames=True).calibration.compensator()
    found = judged(plant, compensate)
    assert found.calibrated["worst_accuracy_mm"] < 0.5 * found.raw["worst_accuracy_mm"]
    for before, after in zip(found.raw["poses"], found.calibrated["poses"], strict=True):
        assert after["repeatability_mm"] == pytest.approx(before["repeatability_mm"], rel=0.1)


def test_any_callable_compensates():
    plant = load_plant("qiao2026")
    found = judged(plant, lambda joints: joints)
    assert found.calibrated == found.raw


def test_a_reference_frame_moves_what_targets_mean():
    plant = only()
    moved = plant.arm.nominal.displaced(np.array([0.0] * 30 + [0, 0, 1.0] + [0.0] * 9))
    found = judged(plant, reference=moved).raw
    assert found["worst_accuracy_mm"] == pytest.approx(1000, abs=10)


def test_one_seed_repeats_the_test_to_the_bit(orchard):
    assert judged(load_plant("orchard")).as_dict() == orchard.as_dict()
    assert judged(load_plant("orchard"), seed=1).raw != orchard.raw


def test_the_report_is_readable_and_the_dictionary_is_json(orchard):
    text = orchard.report()
    for word in (
        "ISO 9283",
        "AP [mm]",
        "RP [mm]",
        "noise alone would show RP 0.061 mm",
        "vAP [mm]",
        "dAP over 8 h",
        "P5",
        "orchard",
    ):
        assert word in text
    again = json.loads(json.dumps(orchard.as_dict()))
    assert again["standard"] == "ISO 9283:1998"
    assert again["cube"]["edge_mm"] == pytest.approx(1e3 * CUBE.edge)
    assert len(again["raw"]["poses"]) == 5
    assert "calibrated" not in again


@pytest.mark.parametrize(("wrong", "named"), [({"cycles": 1}, "cycles is 1"), ({"approach": 0.0}, "approach")])
def test_impossible_settings_are_refused(wrong, named):
    with pytest.raises(InputError, match=named):
        replace(SHORT, **wrong)


def test_a_cube_out_of_reach_is_refused():
    far = replace(CUBE, centre=CUBE.centre + np.array([5.0, 0.0, 0.0]))
    with pytest.raises(InputError, match="does not reach all test poses"):
        iso9283(load_plant("qiao2026"), rng=np.random.default_rng(0), settings=SHORT, cube=far)
