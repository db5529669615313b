"""The report says what the rows say, verdict first, and needs nothing from outside; figures and recording go along."""

import json
import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pyarrow as pa
import pyarrow.dataset as ds
import pytest

from pickenv.arm import forward
from pickenv.arm.plant.populations import random_columns
from pickenv.base import InputError, share_interval
from pickenv.experiments import (
    gather,
    load_study,
    prepared_study,
    read_rows,
    record_study,
    run_study,
    study_of,
    write_outputs,
)
from pickenv.experiments.study_findings import ranked, specified, study_drawings, study_verdict
from pickenv.experiments.study_report import _failures, arms_compared, page, study_page
from pickenv.experiments.study_rows import read_sobol, write_record, write_sobol
from pickenv.experiments.study_variance import sobol_of, tolerance_groups
from pickenv.inspect import read_run

STUDY = """
plant = "qiao2026"
seed = 3
arms = 480
chunk = 160
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
poses = [12]
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A finished study of 480 arms."""
    path = tmp_path_factory.mktemp("study")
    (path / "config.toml").write_text(STUDY, encoding="utf-8")
    run_study(load_study(path / "config.toml"), path / "out", executor="batched")
    return path / "out"


@pytest.fixture(scope="module")
def found(folder):
    return gather(folder)


@pytest.fixture(scope="module")
def html(folder, found):
    return study_page(folder, found)


class Parsed(HTMLParser):
    """Ids, links and open elements of a page."""

    VOID = ("meta", "link", "br", "path", "use", "img", "input", "hr")

    def __init__(self, html):
        super().__init__()
        self.ids, self.links, self.open, self.text = [], [], [], ""
        self.feed(html)

    def handle_starttag(self, tag, attributes):
        given = dict(attributes)
        self.ids += [given["id"]] if "id" in given else []
        self.links += [given[key] for key in ("href", "xlink:href", "src") if key in given]
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        if tag not in self.VOID:
            assert self.open.pop() == tag

    def handle_data(self, data):
        self.text += data


def test_the_page_is_whole_and_needs_nothing_from_outside(html):
    page = Parsed(html)
    assert page.open == [] and len(set(page.ids)) == len(page.ids)
    assert all(link.startswith(("#", "data:")) for link in page.links)
    assert all(link[1:] in page.ids for link in page.links if link.startswith("#"))
    sections = re.findall(r'<section id="([^"]+)"', html)
    assert len(sections) > 3 and {f"#{section}" for section in sections} <= set(page.links)  # the contents
    assert not re.search(r"https?://(?!www\.w3\.org)", html)


def test_the_verdict_comes_first_and_every_yield_is_in_the_table(html, found):
    text = Parsed(html).text
    rows = found.yields
    assert html.index('class="verdict') < html.index("<table")
    for row in rows:
        assert f"{100 * row['yield_low']:.1f} to {100 * row['yield_high']:.1f}" in text
    assert study_verdict(found.protocol.config, rows).headline in text


def test_the_page_names_seed_hashes_and_versions(html, folder):
    summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    for value in (summary["config_sha256"], summary["table_sha256"], summary["pickenv"], np.__version__):
        assert value in html


@pytest.mark.slow
def test_equal_studies_give_equal_pages(html, folder):
    assert study_page(folder, gather(folder)) == html


def rows_with(within, arms=400, **changes):
    low, high = share_interval(within, arms)
    base = {"tolerances": "medium", "it_grade": 9, "method": "ls", "poses": 30, "noise_mm": 0.015, "noise_deg": 0.012}
    base |= {"payload_kg": 0.0, "setting": 0, "yield": within / arms, "yield_low": low, "yield_high": high}
    return base | changes


def test_the_verdict_names_the_least_demanding_way_that_suffices(found):
    rows = [rows_with(398), rows_with(396, it_grade=12, setting=1), rows_with(300, it_grade=14, setting=2)]
    said = study_verdict(found.protocol.config, rows)
    assert said.tone == "good" and said.headline.startswith("IT12 (medium) and 30 poses")
    assert "99.0 %" in said.text and specified(found.protocol.config) in said.text
    fewer = [rows_with(398), rows_with(396, poses=15, setting=1), rows_with(397, poses=60, setting=2)]
    assert study_verdict(found.protocol.config, fewer).headline.startswith("IT9 (medium) and 15 poses")
    noisy = [rows_with(398), rows_with(396, noise_mm=0.1, setting=1)]
    assert "tracker of 0.1 mm" in study_verdict(found.protocol.config, noisy).headline


def test_a_way_must_suffice_at_every_payload_and_the_headline_names_it(found):
    rows = [rows_with(398), rows_with(200, payload_kg=0.25, setting=1)]
    said = study_verdict(found.protocol.config, rows)
    assert said.tone == "bad" and said.headline.endswith("gives a yield of 95 %, carrying 0.25 kg")
    assert "50.0 %" in said.text and "Without payload the best is IT9 (medium)" in said.text and "99.5 %" in said.text
    unloaded = study_verdict(found.protocol.config, rows[:1])
    assert unloaded.tone == "good" and "payload" not in unloaded.headline + unloaded.text
    both = study_verdict(found.protocol.config, [rows_with(398), rows_with(396, payload_kg=0.25, setting=1)])
    assert both.headline.endswith("is enough for a yield of 95 % at every payload")
    assert "Without payload it is 99.5 %" in both.text and "carrying 0.25 kg" in both.text


def test_too_few_arms_to_tell_is_said(found):
    said = study_verdict(replace(found.protocol.config, arms=20), [rows_with(19, arms=20)])
    assert said.tone == "care" and "too few arms to tell" in said.headline
    low, high = share_interval(10, 20)
    assert f"within about ± {50 * (high - low):.0f} points only" in said.text
    assert "points only" not in study_verdict(found.protocol.config, [rows_with(398)]).text


def test_the_page_says_what_the_differences_come_from(html, folder):
    summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    text = Parsed(html).text
    for setting, causes in zip(summary["components"], (2, 4), strict=True):
        assert [row["group"] for row in setting["shares"]] == ["arms", "fruit", "poses", "tracker"][:causes]
        for row in setting["shares"]:
            assert f"{100 * row['total']:.1f}" in text
            assert row["total"] >= row["first_order"] and row["arms"] == 256
            for key in ("first_order", "total"):
                assert row[f"{key}_low"] <= row[key] <= row[f"{key}_high"]
    raw, calibrated = ({row["group"]: row for row in setting["shares"]} for setting in summary["components"])
    assert raw["arms"]["total_low"] > 0.0 and raw["fruit"]["total_low"] > 0.0  # eight fruit are few
    assert calibrated["poses"]["total"] > calibrated["tracker"]["total_high"]  # 0.015 mm is nothing beside 12 poses


def test_figures_that_the_study_does_not_allow_are_named(found):
    drawings = study_drawings(found)
    left_out = {d.name: d.caption for d in drawings if d.draw is None}
    assert left_out == {
        "yield_by_poses": "the study does not vary the number of calibration poses",
        "yield_by_noise_mm": "the study does not vary the tracker's noise",
    }
    names = {d.name for d in drawings if d.draw is not None}
    assert names >= {"yield_by_it_grade", "error_distribution", "sensitivity_raw", "sensitivity_ls"}


def test_the_sensitivities_of_the_raw_arm_are_those_of_its_geometry(found):
    """Before calibration the drawn geometry explains most; after it, what least squares cannot identify."""
    kinds = {"angles", "lengths", "joint stiffness", "transmission error"}
    for table, chief in zip(found.sensitivities.values(), ("angles", "joint stiffness"), strict=True):
        share = {row["parameter"]: row for row in table}
        assert all(share[chief]["share_low"] > share[kind]["share_high"] for kind in kinds - {chief})


def test_each_share_of_the_page_is_named_for_what_it_is_of(html, found):
    """Kinds of tolerance as a whole first, in order of size; then single parameters, the largest."""
    words = " ".join(re.sub(r"<[^>]+>", " ", html).split())
    for table in found.sensitivities.values():
        every = table
        for level, before in (("kind", "all "), ("parameter", "")):
            row = next(row for row in every if row["level"] == level)
            ends = f"{100 * row['share_low']:.1f} to {100 * row['share_high']:.1f}"
            said = f"{before}{row['parameter']} {100 * row['share']:.1f} {ends}"
            assert f" {said} " in words, said


def test_arms_without_a_result_are_counted_by_reason(found):
    status = ["ok"] * 5 + ["too few poses"] * 2 + ["did not converge"] * 3
    told = pa.table({"status": status})
    (table,) = [_failures(replace(found, rows=ds.dataset(told)))]
    assert list(table.rows) == [("did not converge", "3"), ("too few poses", "2")]
    whole = _failures(replace(found, rows=ds.dataset(told.slice(0, 5))))
    assert whole == "Every arm has a result in every setting."


def test_the_recorded_arms_reach_for_the_worst_arms_fruit(folder):
    comparison = arms_compared(folder, 3)  # calibrated, and carrying half a kilogram
    places, protocol = ranked(read_rows(folder), 3), prepared_study(study_of(folder))
    assert [policy.key for policy in comparison.policies] == ["worst", "median", "best"]
    for policy in comparison.policies:
        assert policy.label == f"{policy.key} arm (number {places[policy.key][0]})"
    arm, error = places["worst"]
    assert comparison.policies[0].position_error_mm.mean() == pytest.approx(error, rel=1e-6)
    assert comparison.policies[0].position_error_mm.mean() > comparison.policies[2].position_error_mm.mean()
    wanted = forward(protocol.nominal, protocol.circumstances(arm).fruit).position
    np.testing.assert_allclose(comparison.fruit, wanted)
    assert len(comparison.grid.points) == len(comparison.policies[0].field_errors) > 100


@pytest.mark.slow
def test_sobol_indices_agree_with_the_regression_and_are_in_the_page(folder, found, tmp_path, unwritten):
    """Angles explain the raw arms, stiffness the calibrated ones, whichever way it is found."""
    protocol, settings = prepared_study(found.protocol.config), list(found.sensitivities)
    path = write_sobol(folder, settings, 256)
    try:
        raw, calibrated = read_sobol(folder).values()
        with unwritten():
            text = Parsed(study_page(folder, found)).text
    finally:
        path.unlink()
    names = [row["group"] for row in raw]
    assert names == ["angles", "lengths", "joint stiffness", "flexural rigidity", "transmission error"]
    for rows, number, chief in ((raw, settings[0], "angles"), (calibrated, settings[1], "joint stiffness")):
        total = {row["group"]: row for row in rows}
        assert max(total, key=lambda name: total[name]["total"]) == chief
        (regressed,) = (row for row in found.sensitivities[number] if row["parameter"] == chief)
        assert regressed["share_low"] < total[chief]["total_high"]
        assert all(row["total"] >= row["first_order"] for row in rows)
    assert "Sobol indices, medium, IT8, raw" in text and f"{100 * raw[0]['total']:.1f}" in text
    assert raw[0]["arms"] == 256 * 7
    assert raw == sobol_of(protocol, protocol.settings[settings[0]], 256)


def test_groups_name_each_random_number_of_the_effects_that_are_on(found):
    groups = tolerance_groups(prepared_study(found.protocol.config).design)
    columns = random_columns(prepared_study(found.protocol.config).design)
    used = ("geometry", "joint_stiffness", "flexural_rigidity", "lead", "transmission_error", "phase")
    assert sorted(i for group in groups.values() for i in group) == sorted(i for key in used for i in columns[key])


def test_a_damaged_edited_or_foreign_file_of_indices_is_named(folder, tmp_path):
    (tmp_path / "study.toml").write_bytes((folder / "study.toml").read_bytes())
    path, sha256 = tmp_path / "sobol.json", study_of(folder).sha256()
    path.write_text("[1, 2", encoding="utf-8")
    with pytest.raises(InputError, match=r"sobol\.json is not a record of a study or is damaged .*with `sobol` again"):
        read_sobol(tmp_path)
    write_record(path, {"config_sha256": sha256, "indices": {"0": [{"total": 0.5}]}})
    assert read_sobol(tmp_path) == {0: [{"total": 0.5}]}
    path.write_text(path.read_text(encoding="utf-8").replace("0.5", "0.6"), encoding="utf-8")
    with pytest.raises(InputError, match=r"sobol\.json is not a record of a study or is damaged \(it was edited"):
        read_sobol(tmp_path)
    write_record(path, {"config_sha256": "0" * 64, "indices": {}})
    with pytest.raises(InputError, match=r"sobol\.json is about another study \(hash 000000000000"):
        read_sobol(tmp_path)
    assert read_sobol(tmp_path / "nowhere") == {}


@pytest.mark.slow
def test_figures_report_and_recording_are_written(folder):
    written = {path.relative_to(folder).as_posix() for path in write_outputs(folder)}
    assert written >= {"report.html", "arms.rrd", "figures/yield_by_it_grade.svg", "figures/sensitivity_raw.png"}
    assert all((folder / name).stat().st_size > 1000 for name in written)


def test_an_unfinished_study_and_an_unknown_setting_are_refused(folder, tmp_path):
    (tmp_path / "study.toml").write_bytes((folder / "study.toml").read_bytes())
    with pytest.raises(InputError, match=r"rows holds no results; run `pickenv study` first"):
        page(read_run(tmp_path))
    (tmp_path / "rows").symlink_to(folder / "rows")
    with pytest.raises(InputError, match=r"summary\.json is missing.*again to go on"):
        page(read_run(tmp_path))
    with pytest.raises(InputError, match="no setting 99; give a number from 0 to 7"):
        record_study(folder, 99, tmp_path / "arms.rrd")


def test_too_few_arms_for_sensitivities_are_told_and_the_rest_is_drawn(folder, tmp_path, unwritten):
    config = replace(load_study(folder / "study.toml"), arms=6, chunk=6)
    run_study(config, tmp_path / "few", executor="batched")
    few = gather(tmp_path / "few")
    assert all("6 arms with a result" in str(reason) for reason in few.sensitivities.values())
    with unwritten():
        assert "6 arms with a result" in study_page(tmp_path / "few", few)
