"""However few rows there are, a calibration ends with a verdict or with one sentence."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from hypothesis import example, given, settings, strategies as st
from typer.testing import CliRunner

from pickenv.arm import Arm, Plant
from pickenv.base import InputError
from pickenv.calibration import Choices, Measurements, calibrate, random_joints, simulated_tracker
from pickenv.cli import app


def tracked(plant: Plant, rows: int, seed: int) -> Measurements:
    rng = np.random.default_rng(seed)
    return simulated_tracker(plant, random_joints(plant.arm.nominal, rows, rng), rng)


@settings(max_examples=2)
@given(
    rows=st.integers(1, 14),
    seed=st.integers(0, 50),
    frames=st.sampled_from(["known", "fitted"]),
    turned=st.booleans(),
    split=st.sampled_from(["random", "random", "blocked"]),
    robust=st.booleans(),
)
@example(rows=5, seed=0, frames="known", turned=True, split="random", robust=True)
@example(rows=9, seed=3, frames="fitted", turned=True, split="random", robust=True)
@example(rows=7, seed=0, frames="known", turned=False, split="random", robust=True)
def test_few_rows_end_in_a_verdict_or_in_a_sentence(
    dynamic: Plant, rows: int, seed: int, frames: Literal["known", "fitted"], turned: bool, split: str, robust: bool
) -> None:
    """Also where every held-out row is far off from what the others told, as in one of eight of these."""
    data = tracked(dynamic, rows, seed)
    choices = Choices(frames=frames, robust=robust, seed=seed)
    try:
        result = calibrate(dynamic.arm, data if turned else data.positions_only(), split=split, choices=choices)
    except InputError as error:
        assert len(str(error).splitlines()) == 1
        return
    assert len(result.test.joints) > 0
    assert result.quality.grade == "do not use" or len(result.test.joints) > 2


@pytest.mark.parametrize("rows", [5, *(pytest.param(rows, marks=pytest.mark.slow) for rows in (6, 7))])
def test_five_to_seven_rows_end_in_a_verdict_that_is_not_good(
    rows: int, qiao: Arm, dynamic: Plant, tmp_path: Path
) -> None:
    """Each is judged by a fit to the others; by seven the priors and the rows together tell a gain."""
    path = tracked(dynamic, rows, 0).write_csv(tmp_path / "few.csv")
    ended = CliRunner().invoke(app, ["calibrate", str(path), "--arm", qiao.name, "--frames", "known"])
    assert ended.exit_code == (3 if ended.stdout.startswith("verdict: DO NOT USE") else 0), ended.output
    assert not ended.stdout.startswith("verdict: GOOD") and "each judged without its block" in ended.stdout
