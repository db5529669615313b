"""What share of arms is good enough: the measure of the study behind docs/tolerance-studies.md.

Both example studies, of which the page prints the grades of arms that were never calibrated, and what least squares
make of arms of grade IT12.
"""

import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from findings import world

from pickenv.experiments import StudyConfig, load_study, read_rows, run_study

CALIBRATED: dict[str, Any] = {"it_grades": (12,), "methods": ("ls",)}
"""What the page prints of the study of calibrated arms."""


def printed(name: str) -> StudyConfig:
    """An example study, with the settings that the page prints."""
    config = load_study(Path(__file__).parents[1] / f"{name}.toml")
    return replace(config, **CALIBRATED) if "ls" in config.methods else config


def judged_arms(rng: np.random.Generator, study: str, draw: int, arms: int, seed: int) -> dict[str, Any]:
    """Whether each arm is within specification in each setting: a row for each."""
    config = printed(study)
    plant, arms, seed = world(config.plant, draw, arms, seed)
    with tempfile.TemporaryDirectory() as folder:
        run_study(replace(config, plant=plant, arms=arms, seed=seed), Path(folder), executor="batched")
        rows = read_rows(folder).to_table().to_pydict()
    return {name: np.array(rows[name]) for name in ("arm", "tolerances", "payload_kg")} | {
        "tracker_noise_mm": np.array(rows["noise_mm"]),
        "grade": np.array([f"IT{grade}" for grade in rows["it_grade"]]),
        "poses": np.array([f"{poses} poses" for poses in rows["poses"]]),
        "good": (np.array(rows["share_within"]) >= config.share).astype(float),
    }
