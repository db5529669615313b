"""What measured arms leave is taken apart as the page says, and the plant `field` is made of the same parts."""

from pathlib import Path

import numpy as np
import pytest

from pickenv.arm import draw_plants, load_plant, load_tolerances, plant_at, shipped_effects
from pickenv.calibration import fit, random_joints, simulated_tracker
from pickenv.experiments import Rows, load_experiment

STUDIES = Path(__file__).parents[2] / "scripts/studies"
EFFECTS = shipped_effects()
MODELS = ("LS + gravity", "LS + harmonics", "LS + terms", "LS + BPNN", "LS + GP")


def numbers(file, rows):
    """Each table's estimates by its levels."""
    tables = file.estimates(Rows.of(rows))
    return {
        number.title: {tuple(row[name] for name in number.by): row["estimate"] for row in table["rows"]}
        for number, table in zip(file.numbers, tables, strict=True)
    }


def test_decay_and_variances_are_those_of_the_sets():
    """Sets whose waves fall with the order exactly, on joints 1 and 2, and a slow one that counts nowhere."""
    file = load_experiment(STUDIES / "remainder.toml")
    parts_of = file.functions["remainder.py:remainder"].__globals__["parts_of"]
    rows = []
    for name in file.experiment.units["set"]:
        ur5 = name == "ur5"
        constant = 0.1 if ur5 else 0.5
        waves = [(joint, order, constant * order**-0.7) for joint in (0, 1) for order in (4.0, 8.0, 16.0)]
        geometry, gravity, rest = (0.1, 0.08, 0.06) if ur5 else (0.5, 0.5, 0.1)
        left = {"geometry": geometry, "gravity": gravity, "periodic": rest, "best": 2 * rest}
        one = parts_of(left, [*waves, (0, 1.0, 50.0)], float("nan") if ur5 else 0.02)
        rows += [{"set": name} | row for row in one]
    found = numbers(file, rows)

    def value(begin, *levels):
        (title,) = (title for title in found if title.startswith(begin))
        return found[title][levels].value

    assert value("Decay") == pytest.approx(0.7) and value("Standard deviation") == pytest.approx(0.0, abs=1e-7)
    assert value("Left by geometry of the UR10") == pytest.approx(0.5) and value("Repeats") == pytest.approx(0.02)
    assert value("Share of variance: gravity") == pytest.approx(0.36 / 5)
    assert value("Share of variance: waves") == pytest.approx((0.28 + 4 * 0.96) / 5)
    assert value("Share of variance: the rest") == pytest.approx((0.36 + 4 * 0.04) / 5)
    assert value("Share of the waves' energy", 1) == pytest.approx(0.5)
    assert value("Waves of the first three joints") == 6 and value("Highest order") == 16.0


def test_sets_of_one_arm_count_once_and_fewer_than_eight_arms_have_no_interval():
    file = load_experiment(STUDIES / "residual_gains.toml")

    def rows(left):
        common = {"plant": "field", "protocol": "grid"}
        return [
            common | {"arm": arm, "set": number, "model": model, "left_mm": mm, "removed": 1.0 - mm}
            for (arm, number), mm in left.items()
            for model in MODELS
        ]

    title = "Removed of what least squares leaves (%), over arms"
    few = numbers(file, rows({(0, 0): 0.5, (0, 1): 0.7, (1, 0): 0.9, (1, 1): 0.9}))[title]
    assert few["field", "grid", "LS + BPNN"].value == pytest.approx(0.25) and list(few) == [
        ("field", "grid", model) for model in MODELS
    ]
    assert few["field", "grid", "LS + BPNN"].ci95 is None
    many = numbers(file, rows({(arm, 0): 0.8 + 0.01 * arm for arm in range(8)}))[title]["field", "grid", "LS + GP"]
    low, high = many.ci95
    assert many.value == pytest.approx(0.165) and low < 0.165 < high


@pytest.mark.parametrize("protocol", [pytest.param("grid", marks=pytest.mark.slow), "random"])
def test_two_tenths_of_a_set_are_judged_and_every_set_has_its_own_pair(protocol, monkeypatch):
    """Fits whose errors are made up: streams are those of the seed, the protocol, the arm and the set."""
    seen = []

    def left(arm, train, test, rng, **models):
        seen.append((train, test, models))
        return {"LS": np.full(len(test), 4.0), "LS + GP": np.full(len(test), 1.0)}, None

    monkeypatch.setattr("pickenv.experiments.gains.left_by_models", left)
    left_on_sets = load_experiment(STUDIES / "residual_gains.toml").functions["residual_gains.py:left_on_sets"]
    for seed, number in ((1, 0), (1, 1), (1, 0), (2, 0)):
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(5, 5)))
        ls, gp = left_on_sets(rng, "field", protocol, 3, number, 500)
        assert (ls["removed"], gp["removed"], gp["left_mm"]) == (0.0, 0.5, 1e3)
    one, other, again, elsewhere = seen
    assert [len(rows) for rows in one[:2]] == [320, 80] and list(one[2]["terms"]) == list(MODELS[:3])
    np.testing.assert_array_equal(one[1].position, again[1].position)
    for another in (other, elsewhere):
        assert np.abs(one[1].position - another[1].position).max() > 1e-3


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
