"""The measured robots of docs/results.md are what `pickenv bench calibration` prints, with what it was given."""

import json
from pathlib import Path

import numpy as np
import pytest
from pickenv.bench.real_sets import SETS
from pickenv.bench.run_bench import BenchSettings, run_bench
from pickenv.bench.spread_rows import HEADS, NOTE, SPREAD, judged_split, spread_figures, spread_table

from pickenv.errors import InputError

RESULTS = (Path(__file__).parents[2] / "docs/results.md").read_text(encoding="utf-8")


def test_every_row_is_in_the_results_in_its_order() -> None:
    lines = RESULTS.splitlines()
    begin = lines.index(f"| {' | '.join(HEADS)} |") + 2
    shown = [line.split("|")[1].strip() for line in lines[begin : begin + len(SPREAD)]]
    figures = {"models": {key: [1.0, 0.5, 2.0] for key in ("nominal", "geometry", "best")}, "used": ["geometry"]}
    table = spread_table(dict.fromkeys(SPREAD, figures)).splitlines()[2:]
    assert shown == [line.split("|")[1].strip() for line in table]
    assert [line.split("|")[5].strip() for line in table] == [
        line.split("|")[5].strip() for line in lines[begin : begin + len(SPREAD)]
    ]
    assert not lines[begin + len(table)].startswith("|")
    assert NOTE in RESULTS


def test_the_table_shows_value_spread_model_and_remark() -> None:
    models = {"nominal": [12.344, 11.0, 13.0], "geometry": [0.45678, 0.4, 0.5], "best": [0.4, None, None]}
    line = spread_table({"wam_poses": {"models": models, "used": ["geometry+gravity"]}}).splitlines()[2]
    assert "| 12.34 (11.00 to 13.00) | 0.457 (0.400 to 0.500) | 0.400: gravity; the rule" in line
    assert line.endswith("| 2.92 |")


def test_without_the_data_one_sentence_says_so(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="name the folder of the data sets in PICKENV_DATA"):
        SETS["ur5"].found(tmp_path)


def test_random_splits_are_stated_by_their_mean_and_range(data_folder: Path) -> None:
    """The positioner's ten splits, drawn here with the same seeds."""
    row = SPREAD["positioner_random"]
    if not list(data_folder.glob(row.real.files)):
        pytest.skip(f"no {row.real.files} in {data_folder}")
    found = spread_figures(row, data_folder, 10, 0)["models"]["geometry"]
    arm, rows, _ = row.real.load(data_folder)
    seeds = np.random.SeedSequence(0).generate_state(10)
    means = [judged_split(arm, rows, row, int(seed)).position["geometric"].mean for seed in seeds]
    assert len(set(means)) == 10
    assert found == pytest.approx([np.mean(means), min(means), max(means)])


@pytest.mark.slow
def test_the_results_rows_are_what_the_command_prints(data_folder: Path, tmp_path: Path) -> None:
    """The rows without learnt models, anew; all of them take more than half an hour, by the command itself."""
    names = ["ur5_random", "ur10_b_random", "ur10_d_random", "positioner_random", "positioner_blocks"]
    found = run_bench(names, BenchSettings(), data_folder, tmp_path, tmp_path)
    rows = spread_table(found.spread).splitlines()[2:]
    assert len(rows) == len(names)
    assert [row for row in rows if row not in RESULTS] == []
    json.dumps(dict(found.spread))
