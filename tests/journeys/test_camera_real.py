"""23 pictures of a real UR10e → calibrate → judged by its maker, as the tutorial of the printed board prints it.

From a folder that is empty, with the data sets beside. The last number on the screen is what the calibrated arm misses
by over all joints, mm, against the maker's factory calibration of the same arm, which no fit ever reads.
"""

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from pickenv.arm import load_arm
from pickenv.calibration import Calibration, read_observations

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "scripts"))

from never_worse.judge import (  # noqa: E402
    aligned_errors,
    calibrated_flange,
    chain_of_origins,
    flange_of,
    regions,
    rms,
)

PAGE = (ROOT / "docs/tutorials/calibrate-with-a-printed-board.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```(sh|python)\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)
ROW = re.compile(r"^\| (nominal|calibrated) \| (.*) \|$", re.MULTILINE)
REGIONS = ("at the poses", "0.15 rad beside", "box of ranges", "all joints")

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def walked(data_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """The folder in which the page's commands ran, and what the last of them printed."""
    if not (data_folder / "ur10e_realsense").is_dir():
        pytest.skip(f"no data set ur10e_realsense in {data_folder}")
    folder, said = tmp_path_factory.mktemp("camera"), ""
    environment = os.environ | {"PICKENV_DATA": str(data_folder), "PYTHONPATH": str(ROOT), "MPLBACKEND": "Agg"}
    assert [language for language, _ in BLOCKS] == ["sh", "python"]
    for language, text in BLOCKS:
        line = text.replace("$PICKENV_DATA", str(data_folder))
        command = ["-c", text] if language == "python" else ["-m", "pickenv.cli", *shlex.split(line)[1:]]
        done = subprocess.run([sys.executable, *command], cwd=folder, env=environment, capture_output=True, text=True)
        assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
        said = done.stdout
    return folder, said


@pytest.fixture(scope="module")
def errors(walked: tuple[Path, str], data_folder: Path) -> dict[str, dict[str, float]]:
    """Error of the nominal and of the calibrated arm against the factory's in each region, mm."""
    data, arm = data_folder / "ur10e_realsense", load_arm("ur10e")
    truth = chain_of_origins(data / "factory_kinematics.yaml")
    measured = read_observations([data / "views.csv"], arm.nominal, data / "columns.toml").joints
    every = np.full(6, np.pi)
    arms = {
        "nominal": flange_of(arm.nominal),
        "calibrated": calibrated_flange(Calibration.load(walked[0] / "ur10e.npz")),
    }
    where = regions(measured, -every, every)
    assert tuple(where) == REGIONS
    return {
        name: {region: 1e3 * rms(aligned_errors(flange, truth, joints)) for region, joints in where.items()}
        for name, flange in arms.items()
    }


@pytest.mark.parametrize("region", REGIONS)
def test_a_camera_never_makes_the_arm_worse_than_the_drawing(errors: dict[str, dict[str, float]], region: str) -> None:
    assert errors["calibrated"][region] <= errors["nominal"][region]


def test_the_last_numbers_on_the_screen_say_so(walked: tuple[Path, str]) -> None:
    figures = dict(re.findall(r"(\w+): ([\d.]+) mm RMS over all joints", walked[1]))
    assert float(figures["nominal"]) == pytest.approx(1.9, abs=0.1)
    assert float(figures["calibrated"]) <= float(figures["nominal"])


def test_the_table_of_the_page_is_the_judges(errors: dict[str, dict[str, float]]) -> None:
    page = re.sub(r"<!--.*?-->| \([^()]+ to [^()]+\)", "", PAGE)
    table = {name: [float(cell) for cell in cells.split(" | ")] for name, cells in ROW.findall(page)}
    for name, figures in table.items():
        assert figures == pytest.approx(list(errors[name].values()), rel=0.03)
    assert set(table) == {"nominal", "calibrated"}
