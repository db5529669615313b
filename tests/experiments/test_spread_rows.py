"""The measured robots of docs/results.md are what `pickenv bench calibration` prints, with what it was given."""

import csv
from pathlib import Path

import numpy as np
import pytest

from pickenv.base import InputError
from pickenv.calibration import Choices, calibrate
from pickenv.experiments import SETS, BenchSettings, Rows, robot_tables, robots, run_bench

DOCS = Path(__file__).parents[2] / "docs"
RESULTS = (DOCS / "results.md").read_text(encoding="utf-8")
TABLE = f"_static/{robot_tables.ROBOTS_FILE}"


def shown_rows() -> list[list[str]]:
    """Cells of the page's table, a file that the command writes."""
    assert f":file: {TABLE}\n" in RESULTS and f"({TABLE})" in RESULTS
    with (DOCS / TABLE).open(newline="", encoding="utf-8") as file:
        heads, *rows = csv.reader(file)
    assert tuple(heads) == robot_tables.SPREAD_HEADS
    return rows


def made_rows(row: str, models: list[tuple[float, float, float]], used: str) -> list[dict[str, object]]:
    """Nominal arm, geometry and best model, each with its spread."""
    names = ("value_mm", "low_mm", "high_mm")
    return [{"row": row, "model": "", "used": used, **dict(zip(names, model, strict=True))} for model in models]


def test_every_row_is_in_the_results_in_its_order() -> None:
    rows = [row for name in robots.SPREAD for row in made_rows(name, 3 * [(1.0, 0.5, 2.0)], "nothing added")]
    made = robot_tables.spread_cells(Rows.of(rows))
    assert [(row[0], row[4]) for row in shown_rows()] == [(row[0], row[4]) for row in made]
    assert robot_tables.NOTE in RESULTS


def test_a_table_is_written_as_the_page_reads_it() -> None:
    models = Rows.of(made_rows("wam_poses", 3 * [(1.0, 0.5, 2.0)], "gravity"))
    files = robot_tables.csv_files([], models, 5)
    assert list(files) == [robot_tables.ROBOTS_FILE]
    heads, row = csv.reader(files[robot_tables.ROBOTS_FILE].splitlines())
    assert heads == list(robot_tables.SPREAD_HEADS) and row == list(robot_tables.spread_cells(models)[0])


def test_the_table_shows_value_spread_model_and_remark() -> None:
    models = [(12.344, 11.0, 13.0), (0.45678, 0.4, 0.5), (0.4, np.nan, np.nan)]
    ((_, *errors, best, published),) = robot_tables.spread_cells(Rows.of(made_rows("wam_poses", models, "gravity")))
    assert errors == ["12.34 (11.00 to 13.00)", "0.457 (0.400 to 0.500)"]
    assert best.startswith("0.400: gravity; the rule") and published == "2.92"


def test_without_the_data_one_sentence_says_so(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="name the folder of the data sets in PICKENV_DATA"):
        SETS["ur5"].paths(tmp_path)


def test_random_splits_are_stated_by_their_mean_and_range(data_folder: Path) -> None:
    """Three splits of the positioner, drawn here with the same seeds."""
    row = robots.SPREAD["positioner_random"]
    if not list(data_folder.glob(row.real.files)):
        pytest.skip(f"no {row.real.files} in {data_folder}")
    _, ls, _ = robots.model_errors(np.random.default_rng(), "positioner_random", BenchSettings(splits=3), data_folder)
    arm, rows, _ = row.real.load(data_folder)
    splits = [Choices("none", "none", seed=int(seed)) for seed in np.random.SeedSequence(0).generate_state(3)]
    means = [calibrate(arm, rows, choices=split).position["geometric"].mean for split in splits]
    assert len(set(means)) == 3
    assert [ls["value_mm"], ls["low_mm"], ls["high_mm"]] == pytest.approx([np.mean(means), min(means), max(means)])


@pytest.mark.slow
def test_the_results_rows_are_what_the_command_prints(data_folder: Path, tmp_path: Path) -> None:
    """The rows without learnt models, anew; all of them take more than half an hour, by the command itself."""
    names = ["ur5_random", "ur10_b_random", "ur10_d_random", "positioner_random", "positioner_blocks"]
    _, models, _ = run_bench(names, BenchSettings(), data_folder, tmp_path)
    rows = [list(row) for row in robot_tables.spread_cells(models)]
    assert len(rows) == len(names)
    assert [row for row in rows if row not in shown_rows()] == []
