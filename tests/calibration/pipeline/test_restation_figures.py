"""What a few rows of another station tell, and what is said of a calibration, worked out once more."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pickenv.arm import Arm, Array, Pose, forward, load_arm, move_pose, rotation_matrix, rotation_vector
from pickenv.base import InputError
from pickenv.calibration import (
    ArmModel,
    Calibration,
    ErrorStatistics,
    Measurements,
    error_statistics,
    frames_and_rows,
    random_joints,
    verify,
)
from pickenv.calibration.model.observations import equally_spaced
from pickenv.calibration.pipeline import verification
from pickenv.calibration.pipeline.verification import (
    Verification,
    _since,
    _starts,
    _verdict,
    expected_square,
    near_rows,
    restationed,
    weighed_by_reach,
)

HERE = Pose(np.array([2.0, 0.5, -0.3]), rotation_matrix(np.array([0.1, 0.2, -0.7])))
TARGET = Pose(np.array([0.02, -0.01, 0.1]), rotation_matrix(np.array([0.2, -0.1, 0.4])))
THERE = Pose(np.array([-1.0, 2.5, 0.4]), rotation_matrix(np.array([0.3, -0.1, 2.0])))
FRAMES = ("base", "tool")


@pytest.fixture(scope="module")
def ur5() -> Arm:
    return load_arm("ur5")


def calibration_of(arm: Arm, **record: Any) -> Calibration:
    """A calibration that found the arm as it is, at a station."""
    geometry = replace(arm.nominal, base=HERE, tool=TARGET)
    nominal = replace(arm.nominal.displaced(1e-3 * np.ones(5 * arm.nominal.links + 12)), base=HERE, tool=TARGET)
    return Calibration(arm.name, arm.nominal, nominal, ArmModel.of(geometry), None, record)


def seen(arm: Arm, rows: int, poses: bool, base: Pose = HERE, tool: Pose = TARGET, noise: float = 1e-4) -> Measurements:
    rng = np.random.default_rng(rows)
    geometry = replace(arm.nominal, base=base, tool=tool)
    joints = random_joints(geometry, rows, rng)
    pose = forward(geometry, joints)
    turned = rotation_matrix(2.0 * noise * rng.normal(size=(rows, 3))) @ pose.rotation if poses else None
    position = pose.position + noise * rng.normal(size=(rows, 3))
    return Measurements(joints, position, turned, geometry.prismatic, 1e-4, 3e-4, source="there.csv")


def slopes(model: ArmModel, data: Measurements, own: tuple[str, ...]) -> Array:
    """Derivatives ``(R, 3 or 6, 6 or 12)`` of predicted poses by a frame's steps, by differences."""
    columns = []
    for frame in own:
        for step in 1e-6 * np.eye(6):
            ends = [
                replace(model.geometry, **{frame: move_pose(getattr(model.geometry, frame), sign * step)})
                for sign in (1.0, -1.0)
            ]
            ahead, behind = (forward(geometry, data.joints) for geometry in ends)
            turned = rotation_vector(ahead.rotation @ np.swapaxes(behind.rotation, 1, 2))
            both = np.concatenate([ahead.position - behind.position, turned], axis=1)
            columns.append(both[:, : data.rows_per_pose] / 2e-6)
    return np.stack(columns, axis=-1)


@pytest.mark.parametrize("poses", [False, True], ids=["positions", "poses"])
@pytest.mark.parametrize("own", [("base",), ("tool",), FRAMES], ids="+".join)
def test_errors_are_expected_by_what_a_reach_scatters_and_the_frames_uncertainty(
    ur5: Arm, own: tuple[str, ...], poses: bool
) -> None:
    """Of a position the trace of J C J^T, with the frames' covariance C from the rows they were found from."""
    base, tool = THERE if "base" in own else HERE, Pose(TARGET.position + 0.02, TARGET.rotation)
    data = seen(ur5, 30, poses, base, tool if "tool" in own else TARGET)
    there, used, rest, expected, moved = restationed(calibration_of(ur5), data, own, 8)
    assert len(used) == 8 and sorted([*used, *rest]) == list(range(30))
    jacobian = slopes(there.model, data, own)
    sigma = np.repeat([1e-4, 3e-4], 3)[: data.rows_per_pose]
    told = (jacobian[used] / sigma[:, None]).reshape(-1, 6 * len(own))
    unit = np.repeat([1.0, 10.0], 3).tolist() * len(own)  # so that nothing told is lost beside what is told best
    covariance = np.linalg.pinv((told * unit).T @ (told * unit), rcond=1e-10) * np.outer(unit, unit)
    spread = np.einsum("nip,pq,niq->n", jacobian[rest][:, :3], covariance, jacobian[rest][:, :3])
    assert expected == pytest.approx(spread + 3.0 * 1e-4**2, rel=1e-3)
    assert set(moved) == set(own)
    for name, old, new in (("base", HERE, THERE), ("tool", TARGET, tool)):
        if name in own:
            assert moved[name][0] == pytest.approx(np.linalg.norm(new.position - old.position), abs=2e-3)


@pytest.mark.parametrize("poses", [False, True], ids=["positions", "poses"])
def test_the_rows_that_are_taken_tell_positions_best(ur5: Arm, poses: bool) -> None:
    """Of all sixes of twelve rows; those found are within a twentieth of the best."""
    data = replace(seen(ur5, 12, poses, THERE), position_std=1e-4, attitude_std=2e-3)
    calibration = calibration_of(ur5)
    _, used, *_ = restationed(calibration, data, ("base",), 6)
    jacobian = slopes(calibration.model, data, ("base",))
    weighed = jacobian / np.repeat([1e-4, 2e-3], 3)[: data.rows_per_pose, None]
    weight = np.einsum("nip,niq->pq", jacobian[:, :3], jacobian[:, :3])
    each = np.einsum("nip,niq->npq", weighed, weighed)

    def spread(rows: Any) -> float:
        return float(np.trace(np.linalg.solve(each[list(rows)].sum(axis=0), weight)))

    every = sorted(spread(rows) for rows in combinations(range(12), 6))
    assert used.tolist() == sorted(used) and spread(used) < min(1.05 * every[0], every[20])


def test_rows_are_chosen_among_a_thousand_at_even_distances(ur5: Arm) -> None:
    data = seen(ur5, 1700, False, THERE)
    _, used, *_ = restationed(calibration_of(ur5), data, ("base",), 40)
    assert set(used.tolist()) <= set(equally_spaced(1700, 1000).tolist())
    assert not set(used.tolist()) <= set(equally_spaced(1700, 1001).tolist())


def test_given_rows_are_used_and_nine_are_enough_for_six(ur5: Arm) -> None:
    data = seen(ur5, 9, False, THERE)
    _, used, rest, *_ = restationed(calibration_of(ur5), data, FRAMES, used=np.array([0, 1, 3, 5, 6, 8]))
    assert used.tolist() == [0, 1, 3, 5, 6, 8] and rest.tolist() == [2, 4, 7]
    assert len(restationed(calibration_of(ur5), data, FRAMES)[1]) == 6
    for rows, own, count in ((8, FRAMES, 6), (9, FRAMES, 5), (9, ("tool",), 2), (6, ("tool",), 4)):
        with pytest.raises(InputError, match="or more, and measure at least 3 others"):
            restationed(calibration_of(ur5), data.select(np.arange(rows)), own, count)
    assert len(restationed(calibration_of(ur5), data, ("tool",), 3)[1]) == 3
    for text in ("base,base", "base,arm"):
        with pytest.raises(InputError, match=f"refit is '{text}'"):
            frames_and_rows(text, None)


def test_a_reach_scatters_by_what_the_calibration_knows_or_the_rows_say(ur5: Arm) -> None:
    data = seen(ur5, 9, True)
    for record, position, attitude in (
        ({}, 1e-4, 3e-4),
        ({"uncertainty": None}, 1e-4, 3e-4),
        ({"uncertainty": {"position_repeat_m": None, "attitude_repeat_rad": None}}, 1e-4, 3e-4),
        ({"uncertainty": {"position_repeat_m": 5e-4, "attitude_repeat_rad": 1e-4}}, 5e-4, 3e-4),
        ({"uncertainty": {"position_repeat_m": 5e-5, "attitude_repeat_rad": 4e-3}}, 1e-4, 4e-3),
    ):
        found = weighed_by_reach(calibration_of(ur5, **record), data)
        assert (found.position_std, found.attitude_std) == (position, attitude)
        assert expected_square(found) == pytest.approx(3.0 * position**2)


@pytest.mark.parametrize("own", [("tool",), ("base",), FRAMES], ids="+".join)
def test_a_search_for_frames_starts_in_them_where_only_the_base_has_moved(ur5: Arm, own: tuple[str, ...]) -> None:
    """To rounding: the closed form is exact there; the first start is where the frames were."""
    model = calibration_of(ur5).model
    few = seen(ur5, 7, False, THERE, noise=0.0)
    first, *others = _starts(model, few, own)
    assert first is model and len(others) == {("tool",): 0, ("base",): 1, FRAMES: 2}[own]
    if others:
        assert np.abs(few.difference(others[0])).max() < 1e-13
        np.testing.assert_allclose(others[0].geometry.base.position, THERE.position, atol=1e-12)


@pytest.mark.parametrize(("rows", "count", "taken"), [(12, 6, 9), (40, 6, 24), (30, 8, 27), (31, 7, 28), (10, 9, 9)])
def test_rows_far_off_are_told_by_more_rows_than_the_frames_are_found_from(
    ur5: Arm, rows: int, count: int, taken: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Four times as many, but three are left to judge."""
    asked = []

    def noted(calibration: Calibration, data: Measurements, own: Any, count: int) -> Any:
        asked.append(count)
        return (calibration,)

    monkeypatch.setattr(verification, "restationed", noted)
    near_rows(calibration_of(ur5), seen(ur5, rows, False), FRAMES, count)
    near_rows(calibration_of(ur5), seen(ur5, rows, False), (), count)
    assert asked == [taken]


@pytest.mark.parametrize(("rows", "far", "left_out"), [(12, 1, 1), (12, 2, 0), (39, 2, 0), (40, 2, 2), (60, 4, 0)])
def test_one_row_or_one_in_twenty_may_be_far_off(ur5: Arm, rows: int, far: int, left_out: int) -> None:
    data = seen(ur5, rows, True)
    data.position[2 : 2 + far] += [0.02, 0.0, 0.03]
    kept, found = near_rows(calibration_of(ur5), data, (), 6)
    assert len(kept) == rows - left_out and [item.line for item in found] == [3, 4][:left_out]
    for item in found:
        assert item.file == "there.csv" and item.held_out and item.position == pytest.approx(0.036, abs=1e-3)
        assert item.sigma is not None and item.sigma > 50.0


def constant(size: float) -> ErrorStatistics:
    return error_statistics(np.full((30, 1), size))


@pytest.mark.parametrize(
    ("mine", "theirs", "since", "gain", "cause", "status", "said"),
    [
        (3.0, 9.0, None, None, "joints", "still good", "3.000 mm RMS where 2.000 mm are expected"),
        (3.0, 2.0, None, "it is worse", "unknown", "worse than nominal", "are expected, but it is worse"),
        (2.9, 3.0, None, "it is chance", "unknown", "no better than nominal", "are expected, but it is chance"),
        (3.1, 9.0, None, None, "joints", "drifted", "2.369 mm RMS have come since the calibration, the joints' zeros"),
        (2.0, 9.0, "from a, row 3, on", None, "unknown", "drifted", "0.000 mm RMS have come from a, row 3, on"),
        (2.0, 9.0, "from a, row 3, on", None, "frames", "another station", "from a, row 3, on base and tool elsewhere"),
        (40.0, 90.0, None, None, "frames", "another station", "40.00 mm RMS where"),
        (40.0, 90.0, None, None, "elsewhere", "outside what was measured", "only 25 % of the rows"),
        (9.1, 9.0, None, "it is worse", "elsewhere", "outside what was measured", "worse than the nominal arm's 9.000"),
        (9.0, 9.0, "from a, row 3, on", "it is worse", "unknown", "another arm", "nominal arm misses by 9.000 mm"),
        (6.8, 9.0, None, None, "unknown", "another arm", "no zeros of the joints explain it"),
        (6.7, 9.0, None, None, "unknown", "drifted", "6.395 mm RMS have come since the calibration, by a change"),
        (8.9, 9.0, "from a, row 3, on", None, "unknown", "drifted", "8.672 mm RMS"),
    ],
)
def test_verdicts_and_what_is_said_of_them(
    mine: float, theirs: float, since: str | None, gain: str | None, cause: Any, status: str, said: str
) -> None:
    """Up to half as much again is as promised; what has come adds in squares; a move midway has its own rows."""
    found = Verification(
        "still good", "", constant(mine), constant(theirs), 2.0, 30, 0, {}, since, (), no_gain=gain, measured=0.25
    )
    verdict = _verdict(found, cause)
    assert verdict[0] == status and said in verdict[1]


@pytest.mark.parametrize(
    ("blocks", "said"),
    [
        ([1.0] * 10, None),
        ([1.0] * 9 + [1.6], 37),
        ([1.0] * 9 + [1.5], None),
        ([1.6] + [1.0] * 6 + [2.0] * 3, 29),
        ([1.0] * 4 + [2.0] + [1.0] * 3 + [1.51] * 2, 33),
        ([1.0] + [2.0] * 9, 5),
        ([2.0] * 10, None),
        ([2.0] * 9 + [1.0], None),
    ],
)
def test_since_when_is_the_first_block_from_which_on_all_are_large(blocks: list[float], said: int | None) -> None:
    """Forty rows of which four make a block; large is more than half as much again as what is expected there."""
    errors = np.column_stack([np.zeros((40, 2)), np.repeat(blocks, 4), np.full((40, 3), 7.0)])
    there = None if said is None else said - 1
    assert _since(errors, np.ones(40)) == there
    assert _since(3.0 * errors, np.full(40, 9.0)) == there
    assert _since(errors[:39], np.ones(39)) is None


@pytest.mark.parametrize("poses", [False, True], ids=["positions", "poses"])
def test_three_rows_are_judged_by_their_positions_in_millimetres(ur5: Arm, poses: bool) -> None:
    calibration, data = calibration_of(ur5), seen(ur5, 3, poses)
    found = verify(calibration, data)
    assert (found.rows, found.refitted, found.moved, found.left_out) == (3, 0, {}, ())
    for told, geometry in ((found.calibrated, calibration.identified), (found.nominal, calibration.nominal)):
        missed = data.position - forward(geometry, data.joints).position
        assert told.rms == pytest.approx(1e3 * np.sqrt((missed**2).sum(axis=1).mean()))
    assert found.expected == pytest.approx(0.1 * np.sqrt(3.0))
    text = found.text()
    assert "none" in text and "Rows left out" not in text


def test_the_nominal_arm_has_learnt_nothing(ur5: Arm) -> None:
    class Lifted:
        """A learnt residual that adds a millimetre to every height."""

        inputs = SimpleNamespace(conditions=False)

        def predict(self, joints: Array, conditions: Array | None) -> Array:
            return np.tile([0.0, 0.0, 1e-3], (len(joints), 1))

    plain = calibration_of(ur5)
    learnt = replace(plain, learnt=Lifted())  # type: ignore[arg-type]
    data = seen(ur5, 30, False, noise=1e-6)
    found, without = verify(learnt, data), verify(plain, data)
    assert found.calibrated.rms == pytest.approx(1.0, rel=0.01) and without.calibrated.rms < 0.01
    assert found.nominal == without.nominal


def test_of_left_out_rows_the_screen_tells_file_and_size(ur5: Arm, tmp_path: Path) -> None:
    data = seen(ur5, 30, False)
    data.position[4] += 0.03
    found = verify(calibration_of(ur5), data)
    assert found.rows == 29 and [vars(item) for item in found.left_out] == found.as_dict()["left_out_rows"]
    assert "Rows left out" in found.text() and "row 5" in found.text()
