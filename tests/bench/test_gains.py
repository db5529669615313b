"""Gains are shares of what was left before, of rows never fitted; their intervals hold what they are intervals of."""

from dataclasses import replace

import numpy as np
import pytest
from pickenv.bench import gains
from pickenv.bench.gains import (
    BEFORE,
    LS,
    NOMINAL,
    TERMS,
    Fold,
    agreement,
    folds_of,
    gains_of,
    judged_fold,
    predicted_gain,
)
from pickenv.bench.real_sets import SETS, learnable
from scipy import stats

from pickenv.arm import forward, load_arm
from pickenv.calibration import Measurements
from pickenv.errors import InputError
from pickenv.intervals import statistic_interval

MODELS = (NOMINAL, *BEFORE)


@pytest.mark.parametrize("split", ["random", "blocks"])
def test_every_row_is_held_out_once(split, rng):
    folds = folds_of(np.arange(23), split, 5, rng)
    assert sorted(np.concatenate([held for _, held in folds]).tolist()) == list(range(23))
    for fitted, held in folds:
        assert sorted([*fitted.tolist(), *held.tolist()]) == list(range(23))
        assert split == "random" or np.ptp(held) == len(held) - 1


def made_folds(rng, rows=120, draws=3):
    """Folds whose squared errors are known."""
    scale = dict(zip(MODELS, (9.0, 4.0, 1.0, 3.0, 2.0), strict=True))

    def squares(count):
        return {name: size * 1e-6 * rng.chisquare(3, count) for name, size in scale.items()}

    order = rng.permutation(rows)
    parts = np.array_split(order, 5)
    return [Fold(np.sort(part), squares(len(part)), tuple(squares(len(part)) for _ in range(draws))) for part in parts]


@pytest.mark.parametrize("split", ["random", "blocks"])
def test_gains_are_shares_of_the_rms_before_over_all_folds(split, rng):
    folds = made_folds(rng)
    rms = {name: np.sqrt(np.mean(np.concatenate([fold.measured[name] for fold in folds]))) for name in MODELS}
    drawn = [
        {name: np.sqrt(np.mean(np.concatenate([fold.predicted[i][name] for fold in folds]))) for name in MODELS}
        for i in range(3)
    ]
    for gain in gains_of(folds, split):
        before = BEFORE[gain.model]
        assert gain.measured == pytest.approx(1.0 - rms[gain.model] / rms[before])
        assert gain.predicted == pytest.approx(np.mean([1.0 - each[gain.model] / each[before] for each in drawn]))
        assert (gain.nominal_mm, gain.before_mm) == pytest.approx((1e3 * rms[NOMINAL], 1e3 * rms[before]))
        assert gain.measured_ci95[0] < gain.measured < gain.measured_ci95[1]
        assert gain.predicted_ci95[0] < gain.predicted < gain.predicted_ci95[1]


@pytest.mark.parametrize("split", ["random", "blocks"])
def test_intervals_are_of_rows_or_of_ten_blocks_in_file_order_and_of_one_more_arm_by_its_folds(split, rng):
    folds = made_folds(rng)
    folds = [replace(fold, refused=k) for k, fold in enumerate(folds)]
    at = np.concatenate([fold.held for fold in folds])
    for gain in gains_of(folds, split):
        names = gain.model, BEFORE[gain.model]
        rows = np.stack([np.concatenate([fold.measured[name] for fold in folds]) for name in names], axis=1)
        rows = rows[np.argsort(at)]
        if split == "blocks":
            rows = np.add.reduceat(rows, np.arange(0, 120, 12))
        low, high = statistic_interval(rows, lambda part: 0.5 * np.log(part[:, 0].sum() / part[:, 1].sum()))
        assert gain.measured_ci95 == pytest.approx((1.0 - np.exp(high), 1.0 - np.exp(low)))
        after, before = (np.array([[arm[name].sum() for arm in fold.predicted] for fold in folds]) for name in names)
        effect = 0.5 * (1.0 - gain.predicted) * (after / after.sum(0).mean() - before / before.sum(0).mean())
        deviation = np.sqrt(np.sum(effect.std(axis=1, ddof=1) ** 2) * 4 / 3)
        half = stats.t.ppf(0.975, 10) * deviation
        assert gain.predicted_ci95 == pytest.approx((gain.predicted - half, gain.predicted + half))
        assert gain.predicted_mm == pytest.approx(1e3 * np.sqrt(after.sum() / 3 / 120))
        assert gain.held_out_mm == pytest.approx(
            1e3 * np.sqrt(np.mean(np.concatenate([f.measured[names[0]] for f in folds])))
        )
        assert gain.refused == 10


def test_folds_in_another_order_give_the_same_gains(rng):
    folds = made_folds(rng)
    one, other = (gains_of(each, "blocks") for each in (folds, folds[::-1]))
    for first, second in zip(one, other, strict=True):
        assert (first.model, first.measured) == (second.model, pytest.approx(second.measured))
        assert first.predicted == pytest.approx(second.predicted)
        assert first.predicted_ci95 == pytest.approx(second.predicted_ci95)
        assert first.measured_ci95 == pytest.approx(second.measured_ci95)


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
    gains = gains_of(made_folds(rng), "blocks")
    said = agreement({("a", "blocks"): gains, ("a", "random"): gains})
    apart = [100.0 * abs(gain.predicted - gain.measured) for gain in gains]
    assert said["median_absolute_difference_points"] == pytest.approx(np.median(apart))
    assert (said["sets"], said["gains"], said["learnt_on_blocks"], said["sign_right"]) == (1, 2 * len(gains), 2, 1.0)


def test_a_fold_reads_back_what_it_was(rng):
    fold = made_folds(rng)[0]
    again = Fold.from_dict(fold.as_dict())
    assert again.held.tolist() == fold.held.tolist()
    for one, other in zip((again.measured, *again.predicted), (fold.measured, *fold.predicted), strict=True):
        assert {name: values.tolist() for name, values in one.items()} == {
            name: values.tolist() for name, values in other.items()
        }


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
    monkeypatch.setattr(gains, "LEARNT", {})
    data = positions(48, rng, 2e-4)
    rows = folds_of(np.arange(48), "blocks", 5, rng)[1]
    other = data.position.copy()
    other[rows[1]] += rng.normal(0.0, 1e-4, (len(rows[1]), 3))
    moved = Measurements(data.joints, other, None, data.prismatic, 2e-5, std_stated=True)
    one, two = (judged_fold(load_arm("ur5"), each, rows, 2, np.random.SeedSequence(5)) for each in (data, moved))
    for first, second in zip(one.predicted, two.predicted, strict=True):
        assert {name: values.tolist() for name, values in first.items()} == {
            name: values.tolist() for name, values in second.items()
        }
    assert one.measured[LS].sum() < two.measured[LS].sum()
    assert one.predicted[0][TERMS].tolist() != one.predicted[1][TERMS].tolist()  # two arms


def test_arms_that_cannot_be_calibrated_are_counted_and_drawn_anew(rng, monkeypatch):
    data, calls = positions(48, rng), []
    monkeypatch.setattr(gains, "LEARNT", {})
    judged = gains.left_by_models

    def left(arm, train, test, rng):
        calls.append(train.position)
        if len(calls) in refuses:
            raise InputError("it does not converge")
        return judged(arm, train, test, rng)

    monkeypatch.setattr(gains, "left_by_models", left)
    rows, refuses = folds_of(np.arange(48), "blocks", 5, rng)[0], (2,)
    fold = judged_fold(load_arm("ur5"), data, rows, 1, np.random.SeedSequence(5))
    assert (fold.refused, len(fold.predicted), len(calls)) == (1, 1, 3)
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
