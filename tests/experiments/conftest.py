"""Made-up results of a study, with the columns of real ones: what is computed from them is known."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.dataset as ds
import pyarrow.parquet as pq
import pytest

GRADES = (7, 9, 12)


def made_up(arms: int, seed: int = 0, failed: float = 0.0, first: int = 0) -> pa.Table:
    """Rows of ``arms`` arms in three settings whose errors grow with the IT grade; some calibrations fail."""
    parts = []
    for setting, grade in enumerate(GRADES):
        rng = np.random.default_rng([seed, first, setting])
        deviation = rng.uniform(-1, 1, (arms, 3))
        mean = 0.1 * grade * rng.lognormal(0.0, 0.3, arms)
        good = rng.random(arms) >= failed
        errors = {name: np.where(good, mean * factor, np.nan) for name, factor in FACTORS.items()}
        parts.append(
            pa.table(
                {
                    "setting": pa.array(np.full(arms, setting), pa.int32()),
                    "arm": pa.array(np.arange(first, first + arms), pa.int64()),
                    "tolerances": ["medium"] * arms,
                    "it_grade": pa.array(np.full(arms, grade), pa.int32()),
                    "poses": pa.array(np.full(arms, 30), pa.int32()),
                    "noise_mm": np.full(arms, 0.015),
                    "noise_deg": np.full(arms, 0.012),
                    "payload_kg": np.zeros(arms),
                    "method": ["ls"] * arms,
                    "status": np.where(good, "ok", "least squares did not converge"),
                    "iterations": pa.array(np.full(arms, 4), pa.int32()),
                    **errors,
                    "share_within": np.where(good, np.clip(1.9 - mean, 0.0, 1.0), np.nan),
                    "delta_a0_mm": deviation[:, 0],
                    "delta_alpha1_deg": 0.03 * deviation[:, 1],
                    "size_joint_stiffness_1": 1.0 + 0.1 * deviation[:, 2],
                }
            )
        )
    return pa.concat_tables(parts)


FACTORS = {
    "error_mean_mm": 1.0,
    "error_rms_mm": 1.1,
    "error_p50_mm": 0.9,
    "error_p95_mm": 1.8,
    "error_max_mm": 2.5,
    "attitude_mean_deg": 0.05,
}


@pytest.fixture
def written(tmp_path) -> Callable[..., ds.Dataset]:
    """Writes made-up rows in chunks, as a study does, and opens them."""

    def write(chunks: int, arms: int, **options: float) -> ds.Dataset:
        folder = tmp_path / "rows"
        folder.mkdir()
        for chunk in range(chunks):
            pq.write_table(made_up(arms, first=chunk * arms, **options), folder / f"chunk-{chunk:05}.parquet")
        return ds.dataset(folder)

    return write


@pytest.fixture
def chunk_file() -> Callable[[Path, int], Path]:
    """The file of a chunk of a study's last run, by its number."""
    return lambda folder, chunk: next((folder / "rows").glob(f"study-*_{chunk}_*.parquet"), folder / "rows" / "none")


SMALL = """\
plant = "qiao2026"
seed = 3
arms = 12
chunk = 5

[picking]
fruit = 8
payload_kg = [0.0, 0.5]

[specification]
radius_mm = 1.0
share = 0.75

[tolerances]
classes = ["medium"]
it_grades = [8, 14]

[calibration]
methods = ["raw", "ls"]
poses = [12, 20]
noise = [{ position_mm = 0.015, attitude_deg = 0.012 }]
"""


@pytest.fixture
def study_file(tmp_path) -> Callable[..., Path]:
    """Writes a small study, with some of its text replaced."""

    def write(*changes: tuple[str, str]) -> Path:
        text = SMALL
        for old, new in changes:
            assert old in text, old
            text = text.replace(old, new, 1)
        path = tmp_path / "study.toml"
        path.write_text(text, encoding="utf-8")
        return path

    return write


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20)
