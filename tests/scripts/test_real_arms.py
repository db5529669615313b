"""README's table of measured robots is what `scripts/real_arms.py` prints, and the script says what it was given."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pickenv.errors import InputError

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "scripts"))

import real_arms  # noqa: E402

README = (ROOT / "README.md").read_text(encoding="utf-8")


def test_every_row_of_the_script_is_in_the_readme_in_its_order() -> None:
    lines = README.splitlines()
    begin = lines.index(f"| {' | '.join(real_arms.HEADS)} |") + 2
    shown = [line.split("|")[1].strip() for line in lines[begin : begin + len(real_arms.ROWS)]]
    figures = {"models": {key: [1.0, 0.5, 2.0] for key in ("nominal", "geometry", "best")}, "used": ["geometry"]}
    table = real_arms.table_of(dict.fromkeys(real_arms.ROWS, figures)).splitlines()[2:]
    assert shown == [line.split("|")[1].strip() for line in table]
    assert not lines[begin + len(table)].startswith("|")
    assert real_arms.NOTE in README


def test_the_table_shows_value_spread_model_and_remark() -> None:
    models = {"nominal": [12.344, 11.0, 13.0], "geometry": [0.45678, 0.4, 0.5], "best": [0.4, None, None]}
    found = {"wam_poses": {"models": models, "used": ["geometry+gravity"]}}
    line = real_arms.table_of(found).splitlines()[2]
    assert "| 12.34 (11.00 to 13.00) | 0.457 (0.400 to 0.500) | 0.400: gravity; the rule" in line
    assert line.endswith("| 2.92 |")


def test_a_row_is_done_anew_when_data_or_settings_change(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("1")
    row, files = real_arms.ROWS["ur5_random"], [tmp_path / "a.csv"]
    first = real_arms.key_of(row, files)
    assert first == real_arms.key_of(row, files) != real_arms.key_of(replace(row, terms="auto"), files)
    (tmp_path / "a.csv").write_text("2")
    assert real_arms.key_of(row, files) != first
    with pytest.raises(InputError, match="name the folder of the data sets"):
        real_arms.files_of(row, tmp_path)


def test_random_splits_are_stated_by_their_mean_and_range(data_folder: Path) -> None:
    """The positioner's ten splits, drawn here with the same seeds."""
    row = real_arms.ROWS["positioner_random"]
    if not list(data_folder.glob(row.files)):
        pytest.skip(f"no {row.files} in {data_folder}")
    found = real_arms.figures_of(row, data_folder)["models"]["geometry"]
    files, _ = real_arms.files_of(row, data_folder)
    arm = real_arms.load_arm(row.arm)
    rows = real_arms.read_observations(files, arm.nominal, row.columns).observations
    seeds = np.random.SeedSequence(0).generate_state(10)
    means = [real_arms.judged(arm, rows, row, int(seed)).position["geometric"].mean for seed in seeds]
    assert len(set(means)) == 10
    assert found == pytest.approx([np.mean(means), min(means), max(means)])


@pytest.mark.slow
def test_the_readmes_table_is_what_the_script_prints(data_folder: Path, tmp_path: Path) -> None:
    """All rows anew; some minutes."""
    command = [sys.executable, ROOT / "scripts/real_arms.py", "--data", data_folder, "--out", tmp_path]
    subprocess.run(command, check=True, capture_output=True)
    assert (tmp_path / "real_arms.md").read_text(encoding="utf-8") in README
    assert json.loads((tmp_path / "real_arms.json").read_text(encoding="utf-8"))["splits"] == 10
