"""Gains are shares of what was left before, of rows never fitted; their intervals hold what they are intervals of."""

from functools import partial

import numpy as np
import pytest
from scipy import stats

from pickenv.arm import forward, load_arm
from pickenv.base import InputError, statistic_interval
from pickenv.calibration import Measurements
from pickenv.experiments import SETS, Rows, robots
from pickenv.experiments.gains import LS, NOMINAL, TERMS, left_by_models
from pickenv.experiments.robot_tables import agreement
from pickenv.experiments.robots import BEFORE, folds_of, gains_of, judged_fold, learnable, predicted_gain

MODELS = (NOMINAL, *BEFORE)


@pytest.mark.parametrize("split", ["random", "blocks"])
def test_every_row_is_held_out_once(split, rng):
    folds = folds_of(np.arange(23), split, 5, rng)
    assert sorted(np.concatenate([held for _, held in folds]).tolist()) == list(range(23))
    for fitted, held in folds:
        assert sorted([*fitted.tolist(), *held.tolist()]) == list(range(23))
        assert split == "random" or np.ptp(held) == len(held) - 1


def made_folds(rng, split="blocks", rows=120, draws=3):
    """Rows of folds whose squared errors are known."""
    scale, order = dict(zip(MODELS, (9.0, 4.0, 1.0, 3.0, 2.0), strict=True)), rng.permutation(rows)
    parts = []
    for fold, held in enumerate(np.array_split(order, 5)):
        count = len(held) * (1 + draws)
        columns = {"fold": fold, "refused": fold, "rows": rows, "rows_in_file": 2 * rows, "row": f"gain_ur5_{split}"}
        parts.append(
            {name: np.full(count, value) for name, value in columns.items()}
            | {"drawn": np.repeat(np.arange(1 + draws), len(held)), "at": np.tile(np.sort(held), 1 + draws)}
            | {name: size * 1e-6 * rng.chisquare(3, count) for name, size in scale.items()}
        )
    return Rows({name: np.concatenate([part[name] for part in parts]) for name in parts[0]})


@pytest.mark.parametrize("split", ["random", "blocks"])
def test_gains_are_shares_of_the_rms_before_over_all_folds(split, rng):
    folds = made_folds(rng, split)
    rms, *drawn = ({name: np.sqrt(np.mean(folds.where(drawn=arm)[name])) for name in MODELS} for arm in range(4))
    for gain in gains_of(folds):
        model, before = gain["model"], BEFORE[gain["model"]]
        assert (gain["before"], gain["split"], gain["rows"], gain["rows_in_file"]) == (before, split, 120, 240)
        assert gain["measured_reduction"] == pytest.approx(1.0 - rms[model] / rms[before])
        predicted = np.mean([1.0 - arm[model] / arm[before] for arm in drawn])
        assert gain["predicted_reduction"] == pytest.approx(predicted)
        assert (gain["nominal_mm"], gain["before_mm"]) == pytest.approx((1e3 * rms[NOMINAL], 1e3 * rms[before]))
        assert gain["ci95"][0] < gain["measured_reduction"] < gain["ci95"][1]
        assert gain["predicted_ci95"][0] < gain["predicted_reduction"] < gain["predicted_ci95"][1]


@pytest.mark.parametrize("split", ["random", "blocks"])
def test_intervals_are_of_rows_or_of_ten_blocks_in_file_order_and_of_one_more_arm_by_its_folds(split, rng):
    folds = made_folds(rng, split)
    for gain in gains_of(folds):
        names, measured = (gain["model"], BEFORE[gain["model"]]), folds.where(drawn=0)
        rows = np.stack([measured[name] for name in names], axis=1)[np.argsort(measured["at"])]
        if split == "blocks":
            rows = np.add.reduceat(rows, np.arange(0, 120, 12))
        share = partial(statistic_interval, rows, lambda part: 0.5 * np.log(np.divide(*part.sum(axis=0))))
        low, high = share(ordered=split == "blocks")
        assert gain["ci95"] == pytest.approx((1.0 - np.exp(high), 1.0 - np.exp(low)))
        after, before = (
            np.array([[folds.where(fold=f, drawn=k)[name].sum() for k in (1, 2, 3)] for f in range(5)])
            for name in names
        )
        effect = 0.5 * (1.0 - gain["predicted_reduction"])
        effect = effect * (after / after.sum(0).mean() - before / before.sum(0).mean())
        deviation = np.sqrt(np.sum(effect.std(axis=1, ddof=1) ** 2) * 4 / 3)
        half = stats.t.ppf(0.975, 10) * deviation
        middle = gain["predicted_reduction"]
        assert gain["predicted_ci95"] == pytest.approx((middle - half, middle + half))
        assert gain["predicted_mm"] == pytest.approx(1e3 * np.sqrt(after.sum() / 3 / 120))
        assert gain["held_out_mm"] == pytest.approx(1e3 * np.sqrt(np.mean(measured[names[0]])))
        assert gain["refused_draws"] == 10


def test_folds_in_another_order_give_the_same_gains(rng):
    folds = made_folds(rng)
    order = np.argsort(-folds["fold"], kind="stable")
    other = Rows({name: values[order] for name, values in folds.columns.items()})
    for first, second in zip(gains_of(folds), gains_of(other), strict=True):
        for name in ("measured_reduction", "predicted_reduction", "predicted_ci95", "ci95"):
            assert first[name] == pytest.approx(second[name])
        assert first["model"] == second["model"]


def test_where_one_more_arm_would_lie_holds_it_in_nineteen_of_twenty_cases(rng):
    """Arms whose sums of squares vary by a tenth from fold to fold."""
    trials, inside = 600, 0
    for _ in range(trials):
        after, before = (size * (1.0 + 0.1 * rng.standard_normal((5, 3))) for size in (2.0, 5.0))
        _, (low, high) = predicted_gain(after[:, :2], before[:, :2])
        one_more = 1.0 - np.sqrt(after[:, 2].sum() / before[:, 2].sum())
        inside += low < one_more < high
    assert 0.92 < inside / trials < 0.98
    assert predicted_gain(after[:, :1], before[:, :1])[1] is None


def test_agreement_counts_points_and_signs(rng):
    folds = made_folds(rng)
    random = Rows({**folds.columns, "row": np.full(len(folds), "gain_wam_random")})
    gains = gains_of(folds)
    said = agreement([*gains, *gains_of(random)])
    apart = [100.0 * abs(gain["predicted_reduction"] - gain["measured_reduction"]) for gain in gains]
    assert [row["worst_points"] for row in said["models"]] == pytest.approx(apart)
    assert (said["sets"], said["gains"], said["learnt_on_blocks"], said["sign_right"]) == (1, len(gains), 2, 1.0)


def positions(count, rng, lift=0.0):
    """Few positions of a UR5 whose second joint is off, and whose tool is lifted by a wave of the first."""
    geometry = load_arm("ur5").nominal
    joints = rng.uniform(-1.0, 1.0, (count, 6))
    moved = joints + np.array([0.0, 1e-3, 0.0, 0.0, 0.0, 0.0])
    position = forward(geometry, moved).position + rng.normal(0.0, 2e-5, (count, 3))
    position[:, 2] += lift * np.sin(3.0 * joints[:, 0])
    return Measurements(joints, position, None, geometry.prismatic, 2e-5, std_stated=True)


def test_the_twin_never_sees_the_rows_held_out(rng, monkeypatch):
    """Held-out rows are measured otherwise: the arms drawn, and what is left of them, stay the same to the bit."""
    monkeypatch.setattr(robots, "left_by_models", partial(left_by_models, learnt={}))
    data = positions(48, rng, 2e-4)
    rows = folds_of(np.arange(48), "blocks", 5, rng)[1]
    other = data.position.copy()
    other[rows[1]] += rng.normal(0.0, 1e-4, (len(rows[1]), 3))
    moved = Measurements(data.joints, other, None, data.prismatic, 2e-5, std_stated=True)
    (one, *drawn), (two, *same) = (
        judged_fold(load_arm("ur5"), rows_of, rows, 2, np.random.SeedSequence(5))[0] for rows_of in (data, moved)
    )
    for first, second in zip(drawn, same, strict=True):
        assert {name: values.tolist() for name, values in first.items()} == {
            name: values.tolist() for name, values in second.items()
        }
    assert one[LS].sum() < two[LS].sum()
    assert drawn[0][TERMS].tolist() != drawn[1][TERMS].tolist()  # two arms


def test_arms_that_cannot_be_calibrated_are_counted_and_drawn_anew(rng, monkeypatch):
    data, calls = positions(48, rng), []

    def left(arm, train, test, rng):
        calls.append(train.position)
        if len(calls) in refuses:
            raise InputError("it does not converge")
        return left_by_models(arm, train, test, rng, learnt={})

    monkeypatch.setattr(robots, "left_by_models", left)
    rows, refuses = folds_of(np.arange(48), "blocks", 5, rng)[0], (2,)
    arms, refused = judged_fold(load_arm("ur5"), data, rows, 1, np.random.SeedSequence(5))
    assert (refused, len(arms), len(calls)) == (1, 2, 3)
    assert np.abs(calls[1] - calls[2]).max() > 1e-6  # another arm, not the same once more
    refuses = range(len(calls) + 2, 100)
    with pytest.raises(InputError, match="4 arms drawn from the twin could not be calibrated"):
        judged_fold(load_arm("ur5"), data, rows, 1, np.random.SeedSequence(5))


def test_few_rows_are_taken_evenly_and_other_kinds_are_refused(rng, data_folder):
    data = positions(100, rng)
    assert learnable(load_arm("ur5"), data, 1000).joints.tolist() == data.joints.tolist()
    some = learnable(load_arm("ur5"), data, 40)
    assert len(some) == 40 and some.joints[0].tolist() == data.joints[0].tolist()
    if not list(data_folder.glob(SETS["panda"].files)):
        pytest.skip(f"no {SETS['panda'].files} in {data_folder}")
    arm, rows, _ = SETS["panda"].load(data_folder)
    with pytest.raises(InputError, match="holds sockets: only of poses and positions a twin is made"):
        learnable(arm, rows, 100)
