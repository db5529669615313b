"""A study's yield and its interval are those of independent arms: seeds differ by as much as it says, and no more."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from pickenv.base import share_interval
from pickenv.experiments import load_study, prepared_study, study, study_batched

STUDY = Path(__file__).parents[2] / "scripts/tolerance_grades.toml"


def test_the_interval_of_a_yield_holds_what_all_seeds_give(repeats: Any) -> None:
    """At the grade where yields are near a half, seeds would show most of what their arms have in common."""
    seeds, arms = (300, 100) if repeats.full else (20, 40)
    config = replace(load_study(STUDY), tolerances=("fine",), it_grades=(14,), arms=arms, chunk=arms)
    within = []
    for seed in range(5000, 5000 + seeds):
        rows = study.evaluate_chunk(prepared_study(replace(config, seed=seed)), 0, judge=study_batched.judge_batch)
        within.append(int(np.sum(rows["share_within"] >= config.share)))
    share = np.mean(within) / arms
    dispersion = np.var(np.array(within) / arms, ddof=1) / (share * (1.0 - share) / arms)
    assert abs(dispersion - 1.0) < 3.0 * np.sqrt(2.0 / (seeds - 1)), f"yields vary {dispersion:.2f} times too much"
    ends = [share_interval(k, arms) for k in within]
    held = np.mean([low <= share <= high for low, high in ends])
    assert abs(held - 0.95) < 0.02 + 3.0 * np.sqrt(0.05 * 0.95 / seeds) * (not repeats.full)
