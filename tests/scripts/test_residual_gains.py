"""What measured arms leave is taken apart as the page says, and the plant `field` is made of the same parts."""

import sys
from pathlib import Path

import numpy as np
import pytest

from pickenv.arm import draw_plants, load_plant, load_tolerances, plant_at
from pickenv.arm.plant.plant_file import shipped_effects
from pickenv.calibration import random_joints, simulated_tracker
from pickenv.calibration.pipeline.fitting import fit

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "scripts/studies"))

from remainder import spectrum  # noqa: E402
from residual_gains import gains, table_of  # noqa: E402

EFFECTS = shipped_effects()

MODELS = ("gravity", "harmonics", "terms", "BPNN", "GP")


def measured_set(constant, decay, left, repeats):
    """A set whose waves fall with the order exactly, on joints 1 and 2, and one of the wrist of a tenth of it."""
    orders = [4.0, 8.0, 16.0]
    waves = [
        {"joint": joint, "order": order, "amplitude_mm": constant * order**-decay}
        for joint in (1, 2)
        for order in orders
    ]
    slow = {"joint": 1, "order": 1.0, "amplitude_mm": 50.0}
    geometry, gravity, rest = left
    held = {"geometry": geometry, "gravity": gravity, "periodic": rest, "best": 2 * rest}
    return {"left_mm": held, "waves": [*waves, slow], "repeats_mm": repeats}


def test_decay_and_variances_are_those_of_the_sets():
    sets = {
        "UR5": measured_set(0.1, 0.7, (0.1, 0.08, 0.06), None),
        "UR10 A": measured_set(0.5, 0.7, (0.5, 0.5, 0.1), 0.02),
    }
    found = spectrum(sets)
    assert found["decay"] == pytest.approx(0.7) and found["decay_std"] == pytest.approx(0.0, abs=1e-9)
    assert found["geometry_mm"] == 0.5 and found["repeats_mm"] == 0.02
    assert found["variance_of_each"]["gravity"] == pytest.approx([0.36, 0.0])
    assert found["variance_of_each"]["rest"] == pytest.approx([0.36, 0.04])
    assert found["variance_of_each"]["waves"] == pytest.approx([0.28, 0.96])
    assert found["wave_energy_by_joint"]["1"] == pytest.approx(0.5)  # the slow wave counts nowhere
    assert found["waves_each"] == 6 and found["highest_order"] == 16.0


def test_sets_of_one_arm_count_once_and_fewer_than_eight_arms_have_no_interval():
    def one(left):
        return {"LS": 1.0} | dict.fromkeys(MODELS, left)

    sets = {"0/0": one(0.5), "0/1": one(0.7), "1/0": one(0.9)}
    found = gains(sets)
    assert found["BPNN"]["each"] == pytest.approx([0.4, 0.1])
    assert found["BPNN"]["mean"] == pytest.approx(0.25) and found["BPNN"]["ci95"] is None
    many = gains({f"{arm}/0": one(0.8 + 0.01 * arm) for arm in range(8)})
    low, high = many["GP"]["ci95"]
    assert many["GP"]["mean"] == pytest.approx(0.165) and low < 0.165 < high
    assert f"| field, grid, simulated | 1.00 | 16 ({100 * low:.0f} to {100 * high:.0f}) |" in table_of(
        {"field, grid": many}
    )


@pytest.mark.slow
def test_what_least_squares_leaves_of_field_has_the_parts_that_measured_arms_have():
    """Variance of weight, waves and the rest within the ranges of the five measured sets, and the UR10's size."""
    plant = load_plant("field")
    own = ("drive_harmonics", "local_structure")
    yields = [name for name in EFFECTS if name not in (*own, "measurement_noise")]
    arms = draw_plants(plant, load_tolerances("medium"), 8, np.random.default_rng(42))

    def left(off):
        squares = []
        for k in range(8):
            arm, rng = plant_at(arms, k).without(off), np.random.default_rng(k)
            train, test = (simulated_tracker(arm, random_joints(arm.arm.nominal, 300, rng), rng) for _ in range(2))
            squares.append(np.sum(fit(arm.arm, train).calibration.errors(test)[:, :3] ** 2, axis=1).mean())
        return 1e6 * np.mean(squares)

    whole = left([])
    assert 0.41 < np.sqrt(whole) < 0.51  # UR10 A to D: 0.44 to 0.49 mm
    for off, low, high in (
        (own, 0.03, 0.33),
        ([*yields, own[1]], 0.33, 0.89),
        ([*yields, own[0]], 0.07, 0.34),
    ):
        assert low < left(off) / whole < high
