"""What every test may ask for."""

import os
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

# A busy machine is slow, and nothing that a test says is about time.
settings.register_profile("pickenv", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("pickenv")

# A terminal so wide that sentences and tables stand on one line; what narrow ones do is asked where it matters.
os.environ["COLUMNS"] = "400"

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="session")
def data_folder() -> Path:
    """The folder of measured data sets: PICKENV_DATA, or ../shared/data beside the checkout."""
    folder = Path(os.environ.get("PICKENV_DATA") or ROOT / "../shared/data").resolve()
    if not folder.is_dir():
        pytest.skip(f"no measured data in {folder}; set PICKENV_DATA to the folder that holds the data sets")
    return folder
