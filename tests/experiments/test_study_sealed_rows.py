"""A study folder is read only as what it is: what was edited, renamed or brought from elsewhere is refused by name."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from pickenv.base import InputError
from pickenv.experiments import (
    check_folder,
    gather,
    load_study,
    read_rows,
    read_summary,
    run_study,
    study_of,
    study_rows,
    table_sha256,
)

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
    return run_study(study_of(folder), folder, executor="batched")


def foreign(folder, finished, chunk_file):
    path = chunk_file(folder, 1)
    shutil.copy(chunk_file(finished / "other", 1), path)
    return path


def doubled(folder, finished, chunk_file):
    path = chunk_file(folder, 1)
    shutil.copy(chunk_file(folder, 0), path)
    return path


def otherwise_computed(folder, finished, chunk_file):
    run_study(study_of(folder), finished / "arm by arm", executor="serial")
    path = chunk_file(folder, 1)
    shutil.copy(chunk_file(finished / "arm by arm", 1), path)
    return path


@pytest.mark.parametrize("fault", [foreign, doubled, otherwise_computed])
def test_rows_that_are_not_the_studys_are_refused_by_name_wherever_they_are_read(folder, finished, chunk_file, fault):
    before = chunk_file(folder, 0).read_bytes()
    path = fault(folder, finished, chunk_file)
    for read in (read_rows, table_sha256, read_summary, gather, again):
        with pytest.raises(InputError, match=rf"^\S.*{path.name} holds another piece than its name says") as caught:
            read(folder)
        assert "\n" not in str(caught.value)
    assert dict(check_folder(folder))[path] is not None
    assert next(path for path, reason in check_folder(folder) if reason is None) == folder / "study.toml"
    assert chunk_file(folder, 0).read_bytes() == before


def test_strays_enter_no_row_and_are_named(folder, finished, chunk_file):
    before, chunk = table_sha256(folder), chunk_file(folder, 1)
    strays = [folder / "rows" / name for name in ("study.parquet", f"{chunk.stem} (copy).parquet")]
    shutil.copy(chunk_file(finished / "other", 0), strays[0])
    shutil.copy(chunk, strays[1])
    assert again(folder)["table_sha256"] == table_sha256(folder) == before
    assert read_rows(folder).count_rows() == 24
    faults = dict(check_folder(folder))
    assert all(f"{path} is no piece of this experiment; take it out" in faults[path] for path in strays)


def test_a_sound_folder_is_sound_from_end_to_end(folder, chunk_file):
    chunks = [chunk_file(folder, number).name for number in range(3)]
    names = ["study.toml", "experiment.json", *chunks, "summary.json"]
    assert [(path.name, reason) for path, reason in check_folder(folder)] == [(name, None) for name in names]


def test_a_file_of_no_seal_is_damaged_and_computed_again(folder, chunk_file):
    """As an older program, or another one, would write the same rows."""
    path, before = chunk_file(folder, 1), table_sha256(folder)
    pq.write_table(pq.read_table(path), path)
    with pytest.raises(InputError, match=rf"{path.name} is damaged .*which makes it anew"):
        read_rows(folder)
    with pytest.warns(UserWarning, match=rf"{path.name} is damaged and is made anew"):
        summary = again(folder)
    assert summary["table_sha256"] == before and summary["chunks_reused"] == 2


def test_a_missing_chunk_is_named(folder, chunk_file):
    path = chunk_file(folder, 2)
    path.unlink()
    with pytest.raises(InputError, match=rf"{path.name} is missing; run the experiment again"):
        gather(folder)
    assert "is missing" in dict(check_folder(folder))[path]


def test_an_edited_record_of_the_rows_is_refused(folder, chunk_file):
    path = folder / "rows" / "experiment.json"
    edited(path, (chunk_file(folder, 1).name, chunk_file(folder, 0).name))
    for read in (read_rows, table_sha256, read_summary, gather):
        with pytest.raises(InputError, match=r"experiment\.json .*; run the experiment again"):
            read(folder)
    assert dict(check_folder(folder))[path] is not None
    with pytest.warns(UserWarning, match=r"experiment\.json is damaged and is made anew"):
        assert again(folder)["chunks_reused"] == 3
    assert dict(check_folder(folder))[path] is None


def test_what_an_interrupted_write_left_behind_is_named_and_disturbs_nobody(folder):
    rest = folder / "rows" / ".study-1-abc.parquet"
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
def test_an_edited_study_is_refused_wherever_the_folder_is_opened(folder, tmp_path, change, typed):
    config = study_of(folder)
    edited(folder / "study.toml", change)
    said = r"study\.toml was edited, or .* put it back as it was"
    for read in (study_of, read_rows, read_summary, gather, again):
        with pytest.raises(InputError, match=said):
            read(folder)
    with pytest.raises(InputError, match=said):
        run_study(config, folder, executor="batched")
    reasons = dict(check_folder(folder))
    assert "was edited" in reasons[folder / "study.toml"] and all(reasons.values()) and len(reasons) == 6
    ran = typed("report", folder, "--out", tmp_path / "page.html")
    assert ran.returncode == 2 and "was edited" in ran.stderr and not (tmp_path / "page.html").exists()


def test_a_study_that_was_edited_together_with_its_hash_does_not_fit_its_rows(folder):
    old = study_of(folder)
    new = replace(old, radius_mm=5.0)
    edited(folder / "study.toml", (old.sha256(), new.sha256()), ("radius_mm = 1.0", "radius_mm = 5.0"))
    for read in (read_rows, gather, read_summary):
        with pytest.raises(InputError, match=r"\.parquet belongs to another study"):
            read(folder)
    assert "belongs to another study" in dict(check_folder(folder))[folder / "summary.json"]


def test_words_that_mean_the_same_may_be_written_otherwise(folder):
    edited(folder / "study.toml", ("seed = 3", "seed = 3 # the third"))
    assert study_of(folder).seed == 3


def test_an_edited_summary_is_refused(folder):
    path = folder / "summary.json"
    edited(path, ('"arms": 6', '"arms": 7'))
    with pytest.raises(InputError, match=r"summary\.json is not a record of a study or is damaged \(it was edited"):
        read_summary(folder)
    assert "was edited" in dict(check_folder(folder))[path]


def test_a_summary_of_other_rows_or_another_study_is_refused(folder, finished):
    summary = read_summary(folder)
    study_rows.write_record(folder / "summary.json", summary | {"table_sha256": "0" * 64})
    with pytest.raises(InputError, match=r"summary\.json was made from other rows"):
        read_summary(folder)
    shutil.copy(finished / "other" / "summary.json", folder)
    with pytest.raises(InputError, match=r"summary\.json is about another study"):
        read_summary(folder)


@pytest.mark.parametrize("text", ["", "[]", "{}", "null", '{"sha256": 1}', "[" * 100_000, "\x00"])
def test_a_damaged_summary_ends_with_one_sentence(folder, text):
    (folder / "summary.json").write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=r"summary\.json is not a record of a study or is damaged"):
        read_summary(folder)


@pytest.mark.parametrize("flips", [60, pytest.param(500, marks=pytest.mark.slow)])
def test_one_bit_flipped_anywhere_in_a_chunk_is_refused(folder, flips, chunk_file):
    path = chunk_file(folder, 1)
    content, rng = path.read_bytes(), np.random.default_rng(0)
    for bit in rng.choice(8 * len(content), flips, replace=False).tolist():
        damaged = bytearray(content)
        damaged[bit // 8] ^= 1 << bit % 8
        path.write_bytes(damaged)
        with pytest.raises(InputError, match=rf"{path.name} is damaged"):
            read_rows(folder)


@pytest.mark.parametrize("cuts", [20, pytest.param(200, marks=pytest.mark.slow)])
def test_a_truncated_chunk_is_refused(folder, cuts, chunk_file):
    path = chunk_file(folder, 1)
    content, rng = path.read_bytes(), np.random.default_rng(0)
    for length in [0, 1, 4, 8, 11, 12, *rng.integers(len(content), size=cuts).tolist()]:
        path.write_bytes(content[:length])
        with pytest.raises(InputError, match=rf"{path.name} is damaged"):
            read_rows(folder)


def test_the_summary_states_the_hashes_of_study_and_rows(folder):
    summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    assert summary["config_sha256"] == study_of(folder).sha256() and summary["table_sha256"] == table_sha256(folder)
