"""Splits: every row is used once, blocks are blocks, rows of one pose stay together, the impossible is refused."""

import numpy as np
import pytest
from hypothesis import given, strategies as st

from pickenv.base import InputError
from pickenv.calibration import SocketObservations, blocked_split, contiguous_folds, same_poses
from pickenv.calibration.model.observations import PATH, SAME_POSE, choose, pose_count, random_split


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


@given(st.lists(st.integers(0, 5), min_size=2, max_size=40), st.data())
def test_no_fold_of_groups_is_empty(groups: list[int], data: st.DataObject) -> None:
    """However many groups there are and however small, and no fold holds out more of a group than its share."""
    folds = contiguous_folds(np.array(groups), np.arange(len(groups)), data.draw(st.integers(2, len(groups))))
    assert len(folds) >= 2 and sorted(np.concatenate([out for _, out in folds])) == list(range(len(groups)))
    sizes = np.bincount(groups)
    for train, out in folds:
        assert len(out) and sorted([*train, *out]) == list(range(len(groups)))
        if sizes.max() > 1:
            assert np.all(np.bincount(np.array(groups)[out], minlength=len(sizes)) <= np.ceil(sizes / len(folds)))


def test_folds_that_cannot_be_are_refused() -> None:
    with pytest.raises(InputError, match="cannot be cut"):
        contiguous_folds(np.zeros(3, dtype=int), np.arange(3), 4)


def spoilt(poses: int, copies: int, how: str, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Joints of poses that were each written down some times, and which pose each row is of."""
    joints = rng.uniform(-3.0, 3.0, (poses, 6))
    joints[0] = np.round(joints[0] / SAME_POSE) * SAME_POSE  # on the edge of whatever rows are counted by
    number = np.tile(np.arange(poses), copies)
    again = joints[number]
    later = np.arange(len(number)) >= poses
    if how == "rounded":
        again[later] = np.radians(np.round(np.degrees(again[later]), 2))
    if how == "jittered":
        again += rng.uniform(-0.5, 0.5, again.shape) * SAME_POSE
    order = {"reversed": np.arange(len(number))[::-1], "shuffled": rng.permutation(len(number))}
    places = order.get(how, np.arange(len(number)))
    return again[places], number[places]


@given(
    st.integers(3, 40),
    st.integers(1, 6),
    st.sampled_from(["repeated", "rounded", "reversed", "shuffled", "jittered"]),
    st.integers(0, 1000),
    st.data(),
)
def test_rows_of_one_pose_stay_on_one_side_of_every_split(
    count: int, copies: int, how: str, seed: int, data: st.DataObject
) -> None:
    rng = np.random.default_rng(seed)
    joints, pose = spoilt(count, copies, how, rng)
    poses, rows = same_poses(joints), len(joints)
    assert pose_count(joints) == count == len(set(zip(poses.tolist(), pose.tolist(), strict=True)))
    groups = pose % 2 if data.draw(st.booleans()) else rng.integers(0, 2, rows)
    wanted = data.draw(st.integers(1, rows - 1))
    splits = [random_split(poses, wanted, rng), *contiguous_folds(groups, poses, data.draw(st.integers(2, 3)))]
    if count >= 10:
        splits.append(blocked_split(poses))
    for train, test in splits:
        assert sorted([*train, *test]) == list(range(rows))
        assert not set(pose[train]) & set(pose[test])
    train, test = splits[0]
    assert len(train) and len(test)
    assert abs(len(test) - wanted) < copies, "as near to the rows asked for as whole poses allow"


def test_poses_are_numbered_as_they_first_come_and_none_is_merged_with_another() -> None:
    joints = np.random.default_rng(0).uniform(-3.0, 3.0, (16_000, 6))
    np.testing.assert_array_equal(same_poses(joints), np.arange(16_000))


def test_a_path_followed_slowly_is_not_one_pose() -> None:
    """Rows 0.001 deg apart hang together from end to end, and a split must cut them somewhere."""
    line = np.radians(np.arange(0.0, 30.0, 0.001))[:, None] * np.ones(6)
    assert pose_count(line) >= np.radians(30.0) / PATH
    assert pose_count(line[:9]) == 1


def test_rows_of_a_single_pose_cannot_be_split() -> None:
    with pytest.raises(InputError, match="there are 5 rows of one pose, and none can be both trained on and held out"):
        random_split(np.zeros(5, dtype=int), 1, np.random.default_rng(0))
    with pytest.raises(InputError, match="6 rows of 3 poses cannot be cut into 4 folds; measure at least 4"):
        contiguous_folds(np.zeros(6, dtype=int), np.repeat(np.arange(3), 2), 4)


def test_some_rows_of_every_socket_are_held_out() -> None:
    joints = np.random.default_rng(1).uniform(-1.0, 1.0, (30, 6))
    socket, pairs = np.arange(30) % 4, np.zeros((0, 2), dtype=np.int64)
    data = SocketObservations(joints, socket, pairs, np.zeros(0))
    train, test = choose(data, 8, np.random.default_rng(0))
    assert set(socket[train]) == set(socket[test]) == {0, 1, 2, 3}
    assert sorted([*train, *test]) == list(range(30))


@pytest.mark.parametrize("test_rows", [0, -3, 30, 31])
def test_a_split_by_sockets_that_leaves_nothing_is_refused(test_rows: int) -> None:
    joints = np.random.default_rng(1).uniform(-1.0, 1.0, (30, 6))
    data = SocketObservations(joints, np.arange(30) % 4, np.zeros((0, 2), dtype=np.int64), np.zeros(0))
    with pytest.raises(InputError, match="leave nothing to train on or to test"):
        choose(data, test_rows, np.random.default_rng(0))
