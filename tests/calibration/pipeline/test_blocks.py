"""Blocked judgement: every row once, by a model that did not see its block and was not chosen on it."""

from dataclasses import replace

import numpy as np
import pytest

from pickenv.arm import forward
from pickenv.base import InputError, ordered_interval
from pickenv.calibration import (
    Choices,
    DistanceObservations,
    GravityTerm,
    calibrate,
    prior_model,
    random_joints,
    simulated_tracker,
)
from pickenv.calibration.identification.solve import solve
from pickenv.calibration.model.observations import BLOCKS
from pickenv.calibration.pipeline import stages
from pickenv.calibration.pipeline.fitting import AS_CHOSEN, HeldOut, pooled
from pickenv.inspect import calibration_page

PLAIN = Choices(terms="none", residual="none")
FREE = Choices(terms="auto", residual="rbf")


@pytest.fixture(scope="module")
def data(dynamic):
    rng = np.random.default_rng(0)
    return simulated_tracker(dynamic, random_joints(dynamic.geometry, 123, rng), rng)


@pytest.fixture(scope="module")
def counted(dynamic, data):
    """A calibration judged in blocks, and the progress that was told."""
    told = []
    progress = lambda *step: told.append(step)  # noqa: E731
    return calibrate(dynamic.arm, data, split="blocked", choices=PLAIN, progress=progress), told


@pytest.fixture(scope="module")
def plain(counted):
    return counted[0]


def test_each_row_is_judged_once_by_a_fit_to_the_rows_of_the_other_blocks(dynamic, data, plain):
    left = np.full((123, 6), np.nan)
    for block in np.array_split(np.arange(123), BLOCKS):
        others = np.setdiff1d(np.arange(123), block)
        found = solve(prior_model(dynamic.arm.name, dynamic.arm.nominal, known=True), data.select(others))
        assert np.isnan(left[block]).all()
        left[block] = data.select(block).difference(found.arm_model)
    np.testing.assert_allclose(plain.errors["geometric"], left, atol=1e-12)
    np.testing.assert_array_equal(plain.test.joints, data.joints)
    np.testing.assert_array_equal(np.bincount(plain.held_out.blocks), [13] * 3 + [12] * 7)


@pytest.mark.parametrize(
    ("choices", "block"),
    [(PLAIN, 3), *(pytest.param(*other, marks=pytest.mark.slow) for other in ((PLAIN, 0), (FREE, 0), (FREE, 3)))],
    ids=["geometry, block 3", "geometry, block 0", "as chosen, block 0", "as chosen, block 3"],
)
def test_what_is_predicted_of_a_block_does_not_depend_on_what_was_measured_there(dynamic, data, plain, choices, block):
    """Neither the fit nor the choice of terms and residual model saw it."""
    rows = np.array_split(np.arange(123), BLOCKS)[block]
    moved = data.position.copy()
    moved[rows] += [2e-4, -1e-4, 3e-4]
    found = plain if choices is PLAIN else calibrate(dynamic.arm, data, split="blocked", choices=choices)
    other = calibrate(dynamic.arm, replace(data, position=moved), split="blocked", choices=choices)
    assert len(found.errors) == 2 if choices is PLAIN else len(found.errors) > 2
    assert found.held_out.used[block] == other.held_out.used[block]
    both = [name for name in list(found.errors)[1:] if name in other.errors]  # a model refused by all may be left out
    assert choices is PLAIN or found.held_out.used[block] in both
    for name in both:
        one, two = found.errors[name], other.errors[name]
        np.testing.assert_allclose(two[rows, :3] - one[rows, :3], moved[rows] - data.position[rows], atol=1e-12)
        assert np.abs(np.delete(two - one, rows, axis=0)).max() > 1e-7  # the others did see it


def test_what_a_block_is_judged_with_is_chosen_on_rows_of_other_blocks(dynamic, data, monkeypatch):
    """Terms on all of them, the residual model on every other."""
    learnt, chosen = [], {}
    weight = GravityTerm((1,), (0.0, 0.0, 1.0))

    def choosing(arm, bare, rows):
        seen = frozenset(np.flatnonzero((data.joints[:, None] == rows.joints).all(-1).any(-1)).tolist())
        chosen[seen] = "gravity" if 30 in seen else "none"
        return (chosen[seen], {}, (weight,) if 30 in seen else ())

    def learning(draft, rows):
        learnt.append(set(rows.tolist()))

    monkeypatch.setattr(stages, "choose_terms", choosing)
    monkeypatch.setattr(stages, "_chosen", learning)
    found = calibrate(dynamic.arm, data, split="blocked", choices=Choices(terms="auto", residual="none"))
    assert len(chosen) == 1 + BLOCKS and len(learnt) == 2
    for number, block in enumerate(np.array_split(np.arange(123), BLOCKS)):
        terms = chosen[frozenset(range(123)) - set(block.tolist())]
        assert found.held_out.used[number] == ("geometry" if terms == "none" else "geometry+gravity")
        assert not learnt[number % 2] & set(block.tolist()) and len(learnt[number % 2]) in (61, 62)


def test_the_calibration_itself_is_fitted_to_all_rows(dynamic, data, plain):
    found = solve(prior_model(dynamic.arm.name, dynamic.arm.nominal, known=True), data)
    np.testing.assert_array_equal(plain.calibration.identified.theta, found.geometry.theta)
    assert len(plain.train.joints) == len(plain.test.joints) == 123


def test_the_interval_is_one_between_blocks_and_every_screen_says_so(plain, data, unwritten):
    norms = 1e3 * np.linalg.norm(plain.errors["geometric"][:, :3], axis=1)
    parts = np.array_split(norms, BLOCKS)
    without = np.array([(norms.sum() - part.sum()) / (123 - len(part)) for part in parts])
    pseudo = 10 * norms.mean() - 9 * without
    assert plain.best.mean == pytest.approx(norms.mean())
    assert plain.best.mean_ci95 == pytest.approx(np.array(ordered_interval(pseudo)) + norms.mean() - pseudo.mean())
    how = "123 rows, each judged without its block: mean over 10 contiguous blocks, between-block interval"
    told = plain.as_dict()["held_out"]
    assert how in plain.report() and told["how"].startswith(how)
    assert told["best_mean_ci95_mm"] == plain.best.mean_ci95
    kept = plain.calibration.record["held_out"]
    assert kept == {"how": told["how"], "mean_mm": plain.best.mean, "mean_ci95_mm": plain.best.mean_ci95}
    with unwritten():
        page = calibration_page(plain)
    assert how in page and "each judged without its block of the rows" in page and "between blocks" in page


def test_progress_counts_the_blocks(counted):
    assert counted[1] == [("judging blocks", i + 1, BLOCKS) for i in range(BLOCKS)]


def test_other_kinds_of_measurement_are_judged_in_blocks_too(qiao):
    rng = np.random.default_rng(0)
    joints = random_joints(qiao.nominal, 120, rng)
    length = np.linalg.norm(forward(qiao.nominal, joints).position - [2.0, 1.0, 0.5], axis=1)
    wire = DistanceObservations(joints, length + 1e-4 * rng.normal(size=120), 1e-4)
    found = calibrate(qiao, wire, split="blocked", choices=PLAIN)
    assert found.errors["geometric"].shape == (120, 1) and found.best.mean_ci95 is not None
    assert 0.05 < found.best.mean < 0.5


def test_what_cannot_be_blocked_is_refused(dynamic, data):
    with pytest.raises(InputError, match="`test_rows` is for the random split"):
        calibrate(dynamic.arm, data, split="blocked", test_rows=20, choices=PLAIN)


@pytest.mark.parametrize(
    ("count", "blocks"),
    [(21, 10), *(pytest.param(*other, marks=pytest.mark.slow) for other in ((9, 9), (20, 20), (39, 10)))],
)
def test_few_rows_are_judged_in_blocks_unasked_and_up_to_twenty_one_by_one(dynamic, data, count, blocks):
    """And the calibration is fitted to all of them."""
    found = calibrate(dynamic.arm, data.select(np.arange(count)), choices=PLAIN)
    assert len(np.unique(found.held_out.blocks)) == blocks
    assert len(found.train.joints) == len(found.test.joints) == len(found.errors["geometric"]) == count


def part(value, *added):
    errors = {"nominal": np.full((2, 3), value), "geometric": np.full((2, 3), value + 1)}
    steps = {name: np.full((2, 3), value + 2 + i) for i, name in enumerate(added)}
    return HeldOut(errors | steps, np.full((2, 3), -value), (list(steps or ["geometry"])[-1],))


def test_steps_that_differ_from_block_to_block_are_pooled_by_their_place():
    """The last step is what each block used; one between is what it had before it learnt."""
    parts = [part(10, "geometry+gravity", "geometry+gravity+gp"), part(20, "geometry+rbf"), part(30)]
    found = pooled(["geometry", "geometry+gravity", "geometry+gravity+gp"], parts)
    assert [list(values[:, 0]) for values in found.errors.values()] == [
        [10, 10, 20, 20, 30, 30],
        [11, 11, 21, 21, 31, 31],
        [-10, -10, -20, -20, -30, -30],
        [13, 13, 22, 22, 31, 31],
    ]
    assert list(found.errors)[2:] == ["geometry+gravity", "geometry+gravity+gp"]
    assert found.blocks.tolist() == [0, 0, 1, 1, 2, 2]
    assert list(pooled(["geometry"], parts).errors)[2:] == [AS_CHOSEN]
    assert list(pooled(["geometry"], [part(1), part(2)]).errors) == ["nominal", "geometric"]
    assert "geometry+gravity+gp (1)" in found.text(6, 6) and "no interval: 3 blocks are fewer than 10" in found.text(
        6, 6
    )
