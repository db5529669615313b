"""Splits: every row is used once, blocks are blocks, and impossible wishes are refused."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pickenv.calibration.model.splits import blocked_split, contiguous_folds, random_split
from pickenv.errors import InputError


@given(st.integers(2, 500), st.data())
def test_a_random_split_uses_every_row_once(rows: int, data: st.DataObject) -> None:
    test_rows = data.draw(st.integers(1, rows - 1))
    train, test = random_split(np.arange(rows), test_rows, np.random.default_rng(0))
    assert len(test) == test_rows
    assert sorted([*train, *test]) == list(range(rows))


def test_a_random_split_repeats_with_its_seed() -> None:
    first, second = (random_split(np.arange(100), 20, np.random.default_rng(5)) for _ in range(2))
    np.testing.assert_array_equal(first[1], second[1])


@given(st.integers(5, 500), st.data())
def test_a_blocked_split_holds_out_two_runs(rows: int, data: st.DataObject) -> None:
    test_rows = data.draw(st.integers(2, max(2, rows // 5)))
    train, test = blocked_split(np.arange(rows), test_rows)
    assert len(test) == test_rows
    assert sorted([*train, *test]) == list(range(rows))
    assert np.count_nonzero(np.diff(test) > 1) == 1


@pytest.mark.parametrize("rows", [10, 100, 1000, 2770])
def test_by_default_blocks_3_and_7_of_ten_are_held_out(rows: int) -> None:
    blocks = np.arange(rows).reshape(10, -1)
    np.testing.assert_array_equal(blocked_split(np.arange(rows))[1], np.concatenate([blocks[3], blocks[7]]))


@pytest.mark.parametrize("test_rows", [0, -1, 10, 11])
def test_a_split_that_leaves_nothing_is_refused(test_rows: int) -> None:
    with pytest.raises(InputError, match="leave nothing"):
        random_split(np.arange(10), test_rows, np.random.default_rng(0))
    with pytest.raises(InputError, match="leave nothing"):
        blocked_split(np.arange(10), test_rows)


@pytest.mark.parametrize("rows", [0, 1])
def test_one_row_is_said_to_be_one_row(rows: int) -> None:
    with pytest.raises(InputError, match=f"there is {rows} row, and none can be both trained on and held out"):
        random_split(np.arange(rows), 1, np.random.default_rng(0))
    with pytest.raises(InputError, match="measure more poses"):
        blocked_split(np.arange(rows))


def test_blocks_that_would_meet_are_refused() -> None:
    with pytest.raises(InputError, match="two separate blocks"):
        blocked_split(np.arange(100), 95)


@given(st.integers(2, 200), st.data())
def test_folds_hold_out_every_row_once(rows: int, data: st.DataObject) -> None:
    folds = contiguous_folds(np.zeros(rows, dtype=int), np.arange(rows), data.draw(st.integers(2, rows)))
    np.testing.assert_array_equal(np.concatenate([held for _, held in folds]), np.arange(rows))
    for train, held in folds:
        assert not set(train) & set(held)
        assert len(train) + len(held) == rows


def test_folds_that_cannot_be_are_refused() -> None:
    with pytest.raises(InputError, match="cannot be cut"):
        contiguous_folds(np.zeros(3, dtype=int), np.arange(3), 4)
