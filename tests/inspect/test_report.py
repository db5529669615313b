"""The report of a run stands alone, says its verdict first, and every number in it comes from the run's data."""

import base64
import json
import re
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pickenv.base import share_interval
from pickenv.calibration import error_statistics
from pickenv.inspect import (
    CalibrationTrace,
    Comparison,
    Drawing,
    PageTable,
    PageVerdict,
    Run,
    Section,
    html_of,
    load_part,
    new_figure,
    trace_drawings,
)
from pickenv.inspect.colours import WORDS as SHORT_NAMES, in_words
from pickenv.inspect.reports.demo_report import demo_verdict, field_spec, page as demo_report, pose_spec
from pickenv.inspect.reports.report_page import Part, library

VOID = {"meta", "link", "img", "br"}


class Page(HTMLParser):
    """Balanced tags, attributes and text of a page."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.words: list[str] = []
        self.scripts: dict[str | None, str] = {}
        self.rows: list[list[str]] = []
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag == "tr":
            self.rows.append([])
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag, tag

    def handle_data(self, data: str) -> None:
        if self.open[-1:] == ["script"]:
            self.scripts[self.tags[-1][1].get("id")] = data
        elif "style" not in self.open:
            self.words.append(data)
        if self.open[-1:] in (["td"], ["th"]):
            self.rows[-1].append(data)

    def values(self, name: str) -> list[str]:
        return [value for _, attributes in self.tags if (value := attributes.get(name)) is not None]

    @property
    def text(self) -> str:
        return " ".join(" ".join(self.words).split())


@pytest.fixture(scope="module")
def html(demo_run: Run) -> str:
    return demo_report(demo_run)


@pytest.fixture(scope="module")
def page(html: str) -> Page:
    return Page(html)


def test_it_is_balanced_and_needs_nothing_from_outside(html: str, page: Page) -> None:
    assert html.startswith("<!DOCTYPE html>")
    for name in ("src", "href", "xlink:href", "data", "action", "poster", "srcset"):
        assert [value[:60] for value in page.values(name) if not value.startswith(("#", "data:"))] == []
    shown = re.sub(r"<script.*?</script>", "", html, flags=re.S)
    outside = set(re.findall(r"\w+://[^\s\"'<>)]+", shown)) - {"http://www.w3.org/2000/svg"}
    assert {url for url in outside if not url.startswith("http://www.w3.org/")} == set()
    assert "@import" not in shown
    assert re.findall(r"url\((?!#)", shown) == []


def test_ids_are_unique_and_every_reference_resolves(page: Page) -> None:
    ids = page.values("id")
    assert len(ids) == len(set(ids)) > 20
    references = [v[1:] for name in ("href", "xlink:href") for v in page.values(name) if v.startswith("#")]
    styles = " ".join(page.values("style") + page.values("clip-path"))
    references += re.findall(r"url\(#([^)]+)\)", styles) + page.values("data-spec")
    assert set(references) - set(ids) == set()
    assert len(references) > 20


def test_every_picture_has_words_and_every_table_has_heads(page: Page) -> None:
    for tag, attributes in page.tags:
        if tag == "img":
            assert attributes["alt"]
        if attributes.get("role") == "img":
            assert attributes["aria-label"]
        if tag == "th":
            assert attributes["scope"] in ("col", "row")
    tags = [tag for tag, _ in page.tags]
    assert tags.count("caption") == tags.count("table") == 2
    assert page.tags[0] == ("html", {"lang": "en"})
    assert "viewport" in page.values("name")


def test_the_verdict_comes_first_and_its_numbers_are_the_datas(page: Page, comparison: Comparison) -> None:
    raw, last = (policy.ends.position_error_mm for policy in (comparison.policies[0], comparison.policies[-1]))
    words = page.text
    assert words.index("tolerance of 1 mm") < words.index("Reaches, by policy")
    assert f"removes {(raw - last).mean():.2f} mm" in words
    assert f"of a mean position error of {raw.mean():.2f} mm" in words
    low, high = error_statistics(last).mean_ci95
    assert f"What remains is {last.mean():.2f} ({low:.2f} to {high:.2f}) mm in the mean" in words
    assert f"at most {last.max():.2f} mm" in words
    assert f"{int((last <= 1.0).sum())} of {len(last)} simulated reaches end within 1 mm" in words


def test_the_tables_are_the_datas(page: Page, comparison: Comparison, demo_run: Run) -> None:
    rows = {row[0]: row[1:] for row in page.rows}
    for policy in comparison.policies:
        mm, cells = policy.ends.position_error_mm, rows[in_words(policy.label)]
        assert cells[0].startswith(f"{100 * np.mean(mm <= comparison.tolerance_mm):.0f} (")
        assert cells[3].startswith(f"{mm.mean():.3f} (")
        assert cells[4:7] == [f"{v:.3f}" for v in (np.sqrt(np.mean(mm**2)), np.percentile(mm, 95), mm.max())]
        assert cells[7].startswith(f"{policy.ends.attitude_error_deg.mean():.3f} (")
    errors = load_part(demo_run, CalibrationTrace).errors
    for i, axis in enumerate(("x (mm)", "y (mm)", "z (mm)", "rx (deg)", "ry (deg)", "rz (deg)")):
        columns = [error[:, i] * (1e3 if i < 3 else 180.0 / np.pi) for error in errors.values()]
        assert rows[axis] == [
            text
            for v in columns
            for text in (f"{v.mean():+.3f}", f"{v.std():.3f}", f"{np.sqrt(np.mean(v**2)):.3f}", f"{abs(v).max():.3f}")
        ]


@pytest.fixture(scope="module")
def other(
    comparison: Comparison,
    write_demo_run: Callable[[Path, Comparison], Run],
    tmp_path_factory: pytest.TempPathFactory,
    unwritten: Callable[[], AbstractContextManager[None]],
) -> Page:
    """The page of other data, with a picture of the recording."""
    policies = tuple(replace(p, position_error_mm=1.37 * p.position_error_mm) for p in comparison.policies)
    changed = replace(comparison, policies=policies, tolerance_mm=2.0)
    run = write_demo_run(tmp_path_factory.mktemp("other"), changed)
    (run.folder / "errors.rrd").touch()
    with unwritten():
        return Page(demo_report(run, lambda recording: recording.name.encode()))


def test_other_data_give_other_numbers(comparison: Comparison, page: Page, other: Page) -> None:
    raw = comparison.policies[0].ends.position_error_mm
    for found, scale in ((page, 1.0), (other, 1.37)):
        assert f"error of {scale * raw.mean():.2f} mm" in found.text
        assert f"{scale * raw.max():.3f}" in found.text
    assert "tolerance of 2 mm" in other.text
    assert "tolerance of 1 mm" not in other.text


@pytest.mark.parametrize(
    ("successes", "tone", "words"),
    [(100, "good", "suffices"), (97, "care", "may suffice"), (80, "bad", "does not suffice")],
)
def test_the_verdict_follows_the_share_and_its_interval(
    comparison: Comparison, successes: int, tone: str, words: str
) -> None:
    last = comparison.policies[-1]
    missed = np.where(np.arange(len(last.moments)) < round(successes / 100 * len(last.moments)), 0.3, 1.1)
    found = demo_verdict(
        replace(comparison, policies=(comparison.policies[0], replace(last, position_error_mm=missed[:, None])))
    )
    assert found.tone == tone
    assert words in found.headline


def test_a_calibration_that_does_not_help_is_said_not_to(comparison: Comparison) -> None:
    raw, *_, last = comparison.policies
    same = replace(last, position_error_mm=raw.position_error_mm + 0.1)
    found = demo_verdict(replace(comparison, policies=(raw, same)))
    assert "does not lower the mean position error" in found.text
    assert "+0.10 mm" in found.text


def test_wilsons_interval_is_the_published_one() -> None:
    low, high = share_interval(46, 56)  # Li et al. 2016; Newcombe 1998, method 3
    assert (round(low, 3), round(high, 3)) == (0.702, 0.900)
    assert share_interval(0, 20)[0] == 0.0


def test_arrows_and_their_hover_texts_are_the_errors(comparison: Comparison) -> None:
    spec = field_spec(comparison)
    for policy, (shafts, ends) in zip(comparison.policies, zip(*[iter(spec["data"])] * 2, strict=True), strict=True):
        told = np.array(ends["customdata"])
        np.testing.assert_allclose(told[:, 0], 1e3 * np.linalg.norm(policy.field_errors, axis=1), atol=1e-4)
        np.testing.assert_allclose(told[:, 1:4], 1e3 * policy.field_errors, atol=1e-4)
        np.testing.assert_allclose(told[:, 4:], comparison.grid.points, atol=1e-4)
        assert shafts["x"][2::3] == [None] * len(told)
        assert ends["x"] == shafts["x"][0::3]  # the dots are where the tool should be
        drawn = np.array(shafts["x"][1::3], dtype=float) - np.array(shafts["x"][0::3], dtype=float)
        gain = float(spec["layout"]["annotations"][0]["text"].split("×")[1].split(":")[0])
        np.testing.assert_allclose(drawn, gain * policy.field_errors[:, 0], atol=2e-4)


def test_interactive_figures_carry_their_data_and_a_still_twin(page: Page, demo_run: Run) -> None:
    trace = load_part(demo_run, CalibrationTrace)
    specs = page.values("data-spec")
    assert specs == ["error_fields-spec", "error_per_test_pose-spec"]
    content = json.loads(page.scripts["error_per_test_pose-spec"])
    assert content == json.loads(
        json.dumps(pose_spec({k: 1e3 * np.linalg.norm(e[:, :3], axis=1) for k, e in trace.errors.items()}))
    )
    assert page.values("class").count("still") == 2


@pytest.mark.slow
def test_equal_runs_give_equal_pages_and_the_library_is_packed(demo_run: Run, html: str) -> None:
    assert demo_report(demo_run) == html
    assert 1e6 < len(library()) < 2.5e6
    assert len(html) < 4e6


def test_the_recordings_picture_is_shown_and_its_lack_is_no_section(page: Page, other: Page) -> None:
    assert "The recording" in other.text and "The recording" not in page.text
    assert all("which `pickenv inspect" in each.text for each in (page, other))
    (picture,) = other.values("src")
    assert base64.b64decode(picture.removeprefix("data:image/webp;base64,")) == b"errors.rrd"


def test_figures_that_the_data_do_not_allow_are_left_out_with_a_reason(demo_run: Run) -> None:
    trace = load_part(demo_run, CalibrationTrace)

    def left(found: CalibrationTrace) -> dict[str, str]:
        return {d.name: d.caption for d in trace_drawings(found) if d.draw is None}

    reasons = left(trace)
    assert set(reasons) == {"error_against_payload", "error_against_temperature", "network_convergence"}
    assert "no payload was recorded" in reasons["error_against_payload"]
    same = left(replace(trace, payload=np.full(12, 0.25)))
    assert "every held-out pose had the same payload, 0.25 kg; vary it" in same["error_against_payload"]
    assert "error_against_payload" not in left(replace(trace, payload=np.linspace(0, 1, 12)))


HOSTILE = "</title><script>alert('& LS+GP')</script>"


def hostile_drawing() -> Drawing:
    def draw() -> Any:
        with new_figure(2.0, 2.0) as figure:
            figure.suptitle(HOSTILE)
        return figure

    return Drawing("name", HOSTILE, draw)


BLOCKS: dict[str, tuple[Part, int]] = {
    "paragraph": (HOSTILE, 1),
    "facts": ({HOSTILE: HOSTILE}, 2),
    "table": (PageTable(HOSTILE, [HOSTILE, HOSTILE], [[HOSTILE, HOSTILE]]), 6),
    "figure": (hostile_drawing(), 3),
    "interactive figure": (replace(hostile_drawing(), spec={HOSTILE: HOSTILE}, hint=HOSTILE), 5),
    "pair": ((HOSTILE, HOSTILE), 2),
}


@pytest.mark.parametrize("name", BLOCKS)
def test_names_and_values_are_text_wherever_they_stand_in_a_block(name: str) -> None:
    part, count = BLOCKS[name]
    plain = report(Section("plain", ["text"]))
    page = report(Section("plain", ["text", part])).replace(library(), "")
    assert page.count("&amp; LS+GP") - plain.count("&amp; LS+GP") == count
    assert "<script>alert" not in page
    Page(page)


def test_names_and_values_are_text_in_every_part_of_a_page() -> None:
    verdict = PageVerdict("good", HOSTILE, HOSTILE, [("note", HOSTILE)])
    section = Section(HOSTILE, ["text", b"webp"], HOSTILE)
    page = html_of(HOSTILE, HOSTILE, verdict, [section], {}, {HOSTILE: HOSTILE}, contents=True)
    assert "<script" not in page
    # title, subtitle, verdict, tiles, contents, section and picture
    assert page.count("&amp; LS+GP") == 2 + 1 + 3 + 2 + 1 + 3
    assert "script" not in {name for name, _ in Page(page).tags}


def test_pictures_and_the_library_reach_a_page_byte_for_byte() -> None:
    """Short names of policies are spelled out in texts only, and "+LS/" may stand in a picture's base64."""
    names = [name for name in SHORT_NAMES if name.isalnum()]
    pictures = [base64.b64decode(f"AAA/{name}/{'A' * (-len(name) % 4)}+++") for name in names]
    page = Page(report(Section("pictures", [*pictures, replace(hostile_drawing(), spec={"data": []}, hint="")])))
    prefix = "data:image/webp;base64,"
    shown = [base64.b64decode(source.removeprefix(prefix), validate=True) for source in page.values("src")]
    assert shown == pictures
    assert page.scripts["plotly"] == library()
    base64.b64decode(library(), validate=True)


@pytest.mark.parametrize("name", ["LS.csv", "runs/LS+GP/cal-LS.npz", "li_cup.toml", "my+arm.urdf", "LS+GP.py"])
def test_names_of_files_are_not_spelled_out(name: str) -> None:
    assert in_words(f"LS of {name}, GP") == f"least squares of {name}, Gaussian process"
    assert in_words("LS. csv of LS+BPNN.") == "least squares. csv of least squares + neural network."


@pytest.mark.parametrize(
    ("model", "words"),
    [
        ("geometry+gravity", "geometry + gravity"),
        ("geometry+gravity+periodic", "geometry + gravity + drive harmonics"),
        ("geometry+gravity+bpnn", "geometry + gravity + neural network"),
        ("LS+BPNN", "least squares + neural network"),
    ],
)
def test_a_model_of_several_parts_is_spelled_part_by_part(model: str, words: str) -> None:
    """With spaces, at which figures break the line."""
    assert in_words(model) == words and in_words(f"{model} (60)") == f"{words} (60)"


def report(section: Section) -> str:
    return html_of("title", "", PageVerdict("note", "", ""), [section], {})


def test_what_is_empty_is_left_out() -> None:
    nothing = [Section("Nothing", ["", None])]
    page = html_of("t", "", PageVerdict("note", "", ""), nothing, {"a": "b"}, contents=True)
    assert "Nothing" not in page
    assert Page(page).values("href") == ["#origin"]


def test_columns_of_numbers_are_set_to_the_right() -> None:
    rows = [
        ["a", "1.0", "no gain", "-"],
        ["b", "unknown", "", "+0.2"],
        ["c", "3.0", "2 of 3", "-0.1"],
        ["d", "4", "x", "1"],
    ]
    table = PageTable("", "abcd", rows)
    assert [table.in_words(column) for column in range(4)] == [True, False, True, False]
