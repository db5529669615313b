"""Rows to judge by that were trained on are refused with their lines; poses measured anew may judge."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from typer.testing import CliRunner

from pickenv.arm import Plant, load_arm, load_plant
from pickenv.base import InputError
from pickenv.calibration import Choices, Measurements, calibrate, random_joints, simulated_tracker
from pickenv.calibration.identification.diagnosis import refuse_trained
from pickenv.calibration.model.observations import SAME_POSE
from pickenv.cli import app
from tests.calibration.simulated_instruments import KINDS

PLANT = load_plant("qiao2026")


def tracked(rng: np.random.Generator, rows: int, joints: np.ndarray | None = None) -> Measurements:
    joints = random_joints(PLANT.arm.nominal, rows, rng) if joints is None else joints
    return simulated_tracker(PLANT, joints, rng)


def rounded(data: Measurements, digits: int) -> Measurements:
    """As a file with so many decimals of mm, and joints with three of deg, would hold it."""
    return replace(
        data,
        joints=np.radians(np.round(np.degrees(data.joints), 3)),
        position=np.round(data.position * 1e3, digits) / 1e3,
    )


SPOILT: dict[str, Callable[[Measurements, np.random.Generator], Measurements]] = {
    "as they stand": lambda data, rng: data,
    "reversed": lambda data, rng: data.select(np.arange(len(data))[::-1]),
    "rounded to 0.001 mm": lambda data, rng: rounded(data, 3),
    "rounded to 0.01 mm": lambda data, rng: rounded(data, 2),
    "jittered": lambda data, rng: replace(
        data, joints=data.joints + rng.uniform(-0.9, 0.9, data.joints.shape) * SAME_POSE
    ),
}


@settings(max_examples=60)
@given(st.sampled_from(sorted(SPOILT)), st.integers(0, 1000), st.integers(2, 30), st.integers(0, 60))
def test_training_rows_do_not_judge_however_they_are_written(how: str, seed: int, copied: int, others: int) -> None:
    """Also among rows of other poses, and whichever of the two files is the one that was rounded."""
    rng = np.random.default_rng(seed)
    train = tracked(rng, 40).positions_only()
    copy, new = SPOILT[how](train, rng).select(rng.choice(40, copied, replace=False)), tracked(rng, others)
    test = replace(
        copy, joints=np.r_[copy.joints, new.joints], position=np.r_[copy.position, new.position], origins=None
    )
    for one, other in ((train, test), (test, train)):
        with pytest.raises(InputError, match=r"rows to judge by: trained on too \(.*give rows that were measured"):
            refuse_trained(one, other)


@settings(max_examples=60)
@given(seed=st.integers(0, 10_000), digits=st.sampled_from([1, 2, 3, 9]), rows=st.integers(1, 200))
def test_the_same_poses_measured_anew_may_judge(seed: int, digits: int, rows: int) -> None:
    """A tracker scatters by 0.015 mm; read to 0.1 mm a quarter of the readings come again to the last digit."""
    rng = np.random.default_rng(seed)
    train = tracked(rng, rows)
    refuse_trained(rounded(train, digits), rounded(tracked(rng, rows, train.joints), digits))


@pytest.mark.parametrize("kind", KINDS)
def test_rows_of_every_kind_of_instrument_are_known_again(kind: str) -> None:
    data = KINDS[kind](load_arm("ur5").nominal, 30, np.random.default_rng(3), 1.0)
    refuse_trained(data.select(np.arange(20)), data.select(np.arange(20, 30)))
    with pytest.raises(InputError, match="trained on too"):
        refuse_trained(data, data.select(np.arange(10, 20)))


def test_the_sentence_names_file_and_lines_of_both(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    data = tracked(rng, 60)
    files = [data.write_csv(tmp_path / "all.csv"), data.select([3, 8]).write_csv(tmp_path / "some.csv")]
    ended = CliRunner().invoke(app, ["calibrate", str(files[0]), "--arm", "qiao2026", "--test", str(files[1])])
    assert isinstance(ended.exception, InputError)
    assert str(ended.exception) == (
        f"{files[1]}: rows 2, 3 of the rows to judge by: trained on too ({files[0]}: rows 5, 10), with the same joints "
        "and, but for rounding, the same reading; give rows that were measured by themselves"
    )


@pytest.mark.parametrize(("again", "weight"), [(30, "caution"), (10, "note"), (0, None)])
def test_held_out_rows_at_trained_poses_are_counted(dynamic: Plant, again: int, weight: str | None) -> None:
    rng = np.random.default_rng(1)
    train, test = tracked(rng, 60), random_joints(PLANT.arm.nominal, 40, rng)
    test[:again] = train.joints[:again]
    choices = Choices(terms="none", residual="none")
    result = calibrate(dynamic.arm, train, test=tracked(rng, 40, test), choices=choices)
    said = [finding for finding in result.quality.findings if "at poses that were trained on" in finding[1]]
    assert [weight for weight, _ in said] == ([] if weight is None else [weight])
    assert all(text.startswith(f"{again} of 40 held-out rows") for _, text in said)
