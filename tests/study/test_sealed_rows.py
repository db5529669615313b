"""A study folder is read only as what it is: what was edited, renamed or brought from elsewhere is refused by name."""

import json
import os
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from pickenv.study.analysis.study_drawings import gather
from pickenv.study.design.config import load_study
from pickenv.study.results.row_table import Study, chunk_path, read_chunk, write_chunk
from pickenv.study.results.study_folder import (
    check_folder,
    missing_chunks,
    read_rows,
    read_summary,
    study_at,
    table_sha256,
    write_record,
)
from pickenv.study.running.run_study import run_study

from pickenv.errors import InputError

ROOT = Path(__file__).parents[2]

STUDY = """
plant = "qiao2026"
seed = 3
arms = 6
chunk = 2
[picking]
fruit = 8
[specification]
radius_mm = 1.0
share = 0.75
[tolerances]
classes = ["medium"]
it_grades = [8, 14]
[calibration]
methods = ["raw", "ls"]
poses = [12]
"""


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """Two studies that differ in their seed alone."""
    path = tmp_path_factory.mktemp("studies")
    (path / "config.toml").write_text(STUDY, encoding="utf-8")
    config = load_study(path / "config.toml")
    run_study(config, path / "one", executor="batched")
    run_study(replace(config, seed=4), path / "other", executor="batched")
    return path


@pytest.fixture
def folder(finished, tmp_path):
    return Path(shutil.copytree(finished / "one", tmp_path / "study"))


def again(folder):
    return run_study(study_at(folder).config, folder, executor="batched")


def foreign(folder, finished):
    shutil.copy(chunk_path(finished / "other", 1), chunk_path(folder, 1))
    return chunk_path(folder, 1), "belongs to another study"


def doubled(folder, finished):
    shutil.copy(chunk_path(folder, 0), chunk_path(folder, 1))
    return chunk_path(folder, 1), "holds chunk 0 under the name of chunk 1"


def stray(folder, finished):
    shutil.copy(chunk_path(finished / "other", 0), chunk_path(folder, 7))
    return chunk_path(folder, 7), "is no part of this study, whose rows are 3 chunks"


def copied(folder, finished):
    path = folder / "rows" / "chunk-00001 (copy).parquet"
    shutil.copy(chunk_path(folder, 1), path)
    return path, "is no part of this study"


def otherwise_computed(folder, finished):
    study = study_at(folder)
    write_chunk(folder, 1, read_chunk(folder, 1, study), replace(study, arithmetic="arm by arm"))
    return chunk_path(folder, 1), "was computed arm by arm, this study is computed batched on cpu"


def resealed(change):
    """Rows that somebody changed, and then sealed anew."""

    def fault(folder, finished):
        study = study_at(folder)
        write_chunk(folder, 1, change(read_chunk(folder, 1, study)), study)
        return chunk_path(folder, 1), SAID[change]

    fault.__name__ = change.__name__
    return fault


def with_values(table, name, values):
    return table.set_column(table.column_names.index(name), name, pa.array(values, table.schema.field(name).type))


def a_column_less(table):
    return table.drop_columns(["error_mean_mm"])


def a_column_more(table):
    return table.append_column("delta_luck_mm", table["noise_mm"])


def another_type(table):
    return table.set_column(0, "setting", table["setting"].cast(pa.int64()))


def a_row_less(table):
    return table.slice(0, table.num_rows - 1)


def an_empty_cell(table):
    return with_values(table, "error_mean_mm", [None, *table["error_mean_mm"].to_pylist()[1:]])


def a_zeroed_error(table):
    return with_values(table, "error_mean_mm", np.zeros(table.num_rows))


def a_negative_error(table):
    return with_values(table, "error_p50_mm", -table["error_p50_mm"].to_numpy())


def an_infinite_error(table):
    return with_values(table, "error_max_mm", np.full(table.num_rows, np.inf))


def no_error_at_all(table):
    return with_values(table, "error_rms_mm", np.full(table.num_rows, np.nan))


def all_fruit_within(table):
    return with_values(table, "share_within", np.ones(table.num_rows))


def more_than_all_fruit_within(table):
    return with_values(table, "share_within", np.full(table.num_rows, 1.5))


def errors_of_an_arm_that_failed(table):
    return with_values(table, "status", ["least squares did not converge", *table["status"].to_pylist()[1:]])


def another_grade(table):
    return with_values(table, "it_grade", np.full(table.num_rows, 9))


def other_arms(table):
    return with_values(table, "arm", table["arm"].to_numpy() + 1)


def an_endless_deviation(table):
    name = table.column_names[-1]
    return with_values(table, name, np.full(table.num_rows, np.inf))


IMPOSSIBLE = r"has errors that no arm can have \(arm 2, setting 0\)"
SAID = {
    a_column_less: "has no column error_mean_mm",
    a_column_more: "has a column delta_luck_mm that no study writes",
    another_type: "has columns of other types",
    a_row_less: "has 7 rows, this chunk has 8",
    an_empty_cell: "has empty cells",
    a_zeroed_error: IMPOSSIBLE,
    a_negative_error: IMPOSSIBLE,
    an_infinite_error: IMPOSSIBLE,
    no_error_at_all: IMPOSSIBLE,
    all_fruit_within: "has errors that no arm can have",
    more_than_all_fruit_within: IMPOSSIBLE,
    errors_of_an_arm_that_failed: "has errors of arms that were not judged",
    another_grade: "has other values of it_grade than its arms and settings",
    other_arms: "has other values of arm than its arms and settings",
    an_endless_deviation: "has deviations that are no finite numbers",
}
FAULTS = [foreign, doubled, stray, copied, otherwise_computed, *(resealed(change) for change in SAID)]


@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault.__name__)
def test_rows_that_are_not_the_studys_are_refused_by_name_wherever_they_are_read(folder, finished, fault):
    before = chunk_path(folder, 0).read_bytes()
    path, said = fault(folder, finished)
    names = rf"^\S.*{path.name.replace('(', '.').replace(')', '.')} {said}"
    for read in (read_rows, table_sha256, read_summary, gather, again):
        with pytest.raises(InputError, match=names) as caught:
            read(folder)
        assert "\n" not in str(caught.value)
    assert dict(check_folder(folder))[path] is not None
    assert next(path for path, reason in check_folder(folder) if reason is None) == folder / "study.toml"
    assert chunk_path(folder, 0).read_bytes() == before


def test_a_sound_folder_is_sound_from_end_to_end(folder):
    names = ["study.toml", *(f"chunk-{number:05d}.parquet" for number in range(3)), "summary.json"]
    assert [(path.name, reason) for path, reason in check_folder(folder)] == [(name, None) for name in names]


def test_a_file_of_no_seal_is_damaged_and_computed_again(folder):
    """As an older program, or another one, would write the same rows."""
    path, before = chunk_path(folder, 1), table_sha256(folder)
    pq.write_table(pq.read_table(path), path)
    assert missing_chunks(folder, study_at(folder)) == ([1], [path])
    with pytest.raises(InputError, match=r"chunk-00001\.parquet is damaged .*which computes it anew"):
        read_rows(folder)
    assert again(folder)["table_sha256"] == before


def test_a_missing_chunk_is_named(folder):
    chunk_path(folder, 2).unlink()
    with pytest.raises(InputError, match=r"chunk-00002\.parquet cannot be read .*run `pickenv study` again"):
        gather(folder)


def test_what_an_interrupted_write_left_behind_is_named_and_disturbs_nobody(folder):
    rest = folder / "rows" / ".chunk-00001-abc.parquet"
    rest.write_bytes(b"PAR1")
    assert read_rows(folder).count_rows() == 24 and again(folder)["chunks_reused"] == 3
    assert "left behind by an interrupted write" in dict(check_folder(folder))[rest]


def edited(path, *changes):
    text = path.read_text(encoding="utf-8")
    for old, new in changes:
        assert old in text, old
        text = text.replace(old, new, 1)
    path.write_text(text, encoding="utf-8")


@pytest.mark.parametrize("change", [("radius_mm = 1.0", "radius_mm = 5.0"), ("seed = 3", "seed = 4")])
def test_an_edited_study_is_refused_wherever_the_folder_is_opened(folder, tmp_path, change):
    config = study_at(folder).config
    edited(folder / "study.toml", change)
    said = r"study\.toml was edited, or .* put it back as it was"
    for read in (study_at, read_rows, read_summary, gather, again):
        with pytest.raises(InputError, match=said):
            read(folder)
    with pytest.raises(InputError, match=said):
        run_study(config, folder, executor="batched")
    reasons = dict(check_folder(folder))
    assert "was edited" in reasons[folder / "study.toml"] and all(reasons.values()) and len(reasons) == 5
    command = [sys.executable, "-m", "pickenv.cli", "report", str(folder), "--out", str(tmp_path / "page.html")]
    ran = subprocess.run(command, capture_output=True, text=True, env=os.environ | {"PYTHONPATH": str(ROOT)})
    assert ran.returncode == 2 and "was edited" in ran.stderr and not (tmp_path / "page.html").exists()


def test_a_study_that_was_edited_together_with_its_hash_does_not_fit_its_rows(folder):
    old = study_at(folder)
    new = Study(replace(old.config, radius_mm=5.0), old.arithmetic)
    edited(folder / "study.toml", (old.sha256, new.sha256), ("radius_mm = 1.0", "radius_mm = 5.0"))
    with pytest.raises(InputError, match=r"chunk-00000\.parquet belongs to another study"):
        gather(folder)


def test_words_that_mean_the_same_may_be_written_otherwise(folder):
    edited(folder / "study.toml", ("seed = 3", "seed = 3 # the third"))
    assert study_at(folder).config.seed == 3


def test_an_edited_summary_is_refused(folder):
    path = folder / "summary.json"
    edited(path, ('"arms": 6', '"arms": 7'))
    with pytest.raises(InputError, match=r"summary\.json was edited or damaged after it was written"):
        read_summary(folder)
    assert "was edited" in dict(check_folder(folder))[path]


def test_a_summary_of_other_rows_or_another_study_is_refused(folder, finished):
    summary = read_summary(folder)
    write_record(folder / "summary.json", summary | {"table_sha256": "0" * 64})
    with pytest.raises(InputError, match=r"summary\.json was made from other rows"):
        read_summary(folder)
    shutil.copy(finished / "other" / "summary.json", folder)
    with pytest.raises(InputError, match=r"summary\.json is about another study"):
        read_summary(folder)


@pytest.mark.parametrize("text", ["", "[]", "{}", "null", '{"sha256": 1}', "[" * 100_000, "\x00"])
def test_a_damaged_summary_ends_with_one_sentence(folder, text):
    (folder / "summary.json").write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=r"summary\.json is missing or damaged"):
        read_summary(folder)


def test_a_chunk_is_put_in_place_whole(folder):
    """Whoever holds the old file keeps it: the new one is another file with its name, never written into."""
    study, path = study_at(folder), chunk_path(folder, 1)
    held = path.with_name("held")
    os.link(path, held)
    before = held.read_bytes()
    write_chunk(folder, 1, read_chunk(folder, 1, study).slice(1), study)
    assert held.read_bytes() == before != path.read_bytes()


@pytest.mark.parametrize("flips", [60, pytest.param(500, marks=pytest.mark.slow)])
def test_one_bit_flipped_anywhere_in_a_chunk_is_refused(folder, flips):
    path, study = chunk_path(folder, 1), study_at(folder)
    content, rng = path.read_bytes(), np.random.default_rng(0)
    for bit in rng.choice(8 * len(content), flips, replace=False).tolist():
        damaged = bytearray(content)
        damaged[bit // 8] ^= 1 << bit % 8
        path.write_bytes(damaged)
        with pytest.raises(InputError, match=r"chunk-00001\.parquet is damaged"):
            read_chunk(folder, 1, study)
        assert missing_chunks(folder, study) == ([1], [path])


@pytest.mark.parametrize("cuts", [20, pytest.param(200, marks=pytest.mark.slow)])
def test_a_truncated_chunk_is_refused(folder, cuts):
    path, study = chunk_path(folder, 1), study_at(folder)
    content, rng = path.read_bytes(), np.random.default_rng(0)
    for length in [0, 1, 4, 8, 11, 12, *rng.integers(len(content), size=cuts).tolist()]:
        path.write_bytes(content[:length])
        with pytest.raises(InputError, match=r"chunk-00001\.parquet is damaged"):
            read_chunk(folder, 1, study)


def test_the_summary_states_the_hashes_of_study_and_rows(folder):
    summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    assert summary["config_sha256"] == study_at(folder).sha256 and summary["table_sha256"] == table_sha256(folder)
