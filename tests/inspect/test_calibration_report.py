"""The page of a calibration stands alone, says its verdict first, and shows what the numbers rest on."""

import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest

from pickenv.arm import load_instrument, load_plant
from pickenv.calibration import (
    GEOMETRIC,
    Choices,
    GateVerdict,
    assess,
    calibrate,
    fit,
    random_joints,
    simulated_tracker,
)
from pickenv.calibration.assessment.quality import axis_errors
from pickenv.calibration.assessment.screen import figure, unit_of
from pickenv.calibration.identification.diagnosis import LeftOut
from pickenv.calibration.identification.least_squares import is_angle
from pickenv.inspect import PageTable, PageVerdict, Section, calibration_page, html_of, write_calibration_report
from pickenv.inspect.colours import parameter_words

VOID = {"meta"}


def verdict(model, accepted, blocked, reason):
    return GateVerdict(model, blocked, 7e-4, None, None, None, None, accepted, reason)


GATE = (verdict("gp", True, 2.5e-4, "cuts the blocked RMS by 60%"), verdict("rbf", False, 7e-4, "no gain: raises <it>"))


class Page(HTMLParser):
    """Balanced tags, attributes and text of a page."""

    def __init__(self, text):
        super().__init__()
        self.open, self.attributes, self.words = [], [], []
        self.feed(text)
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        self.attributes += attrs
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.attributes += attrs

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if "style" not in self.open:
            self.words.append(data)

    @property
    def text(self):
        return " ".join(" ".join(self.words).split())


@pytest.fixture(scope="module")
def plant():
    return load_plant("qiao2026")


@pytest.fixture(scope="module")
def sets(plant):
    rng = np.random.default_rng(0)
    return [simulated_tracker(plant, random_joints(plant.arm.nominal, n, rng), rng) for n in (60, 40)]


@pytest.fixture(scope="module")
def evidence(plant, sets):
    train = replace(sets[0], source="folder/<b>tracker, LS + GP & co.csv")
    choices = Choices(terms="none", residual="none", frames="fitted")
    return replace(calibrate(plant.arm, train, test=sets[1], choices=choices), gate=GATE)


@pytest.fixture(scope="module")
def page(evidence):
    return calibration_page(evidence, {"seed": 7, "split": "random"})


def test_it_is_whole_and_needs_nothing_from_outside(page):
    found = Page(page)
    assert page.startswith("<!DOCTYPE html>") and page.rstrip().endswith("</html>")
    assert not re.search(r"https?:|url\((?!#)|<script|<link|<img|@import", page)
    links = [value for name, value in found.attributes if name in ("src", "href", "xlink:href", "srcset")]
    assert [value[:40] for value in links if not value.startswith(("#", "data:image/png"))] == []
    assert "prefers-color-scheme: dark" in page and "@media print" in page and len(page) < 300_000


def test_the_verdict_comes_first_and_in_words(page, evidence, plant, sets):
    text = Page(page).text
    mean = evidence.best.mean
    assert text.index("Good: the calibration can be used") < text.index("Errors on held-out rows")
    assert f"the tool stood {figure(mean)} mm" in text and "40 measured poses that the fit never saw" in text
    away = np.linalg.norm(sets[0].position - load_instrument("laser_tracker").stand, axis=1).mean()
    stated = plant.effect("measurement_noise").position_std + plant.effect("measurement_noise").range_std * away
    assert f"times the stated noise of {figure(1e3 * stated)} mm" in text


def test_the_stated_noise_is_the_instruments_in_mm_and_of_poses_in_degrees(page, sets, plant, unwritten):
    stated = f"{1e3 * sets[0].position_std:.4g} mm, {np.rad2deg(sets[0].attitude_std):.4g} deg per coordinate"
    assert stated in Page(page).text
    bare = [part.positions_only() for part in sets]
    with unwritten():
        found = Page(calibration_page(assess(plant.arm, fit(plant.arm, bare[0]), *bare))).text
    assert f"{1e3 * sets[0].position_std:.4g} mm per coordinate" in found and " deg per coordinate" not in found


def test_text_from_files_is_no_markup_and_names_stay_as_they_are(page):
    assert (
        "<b>tracker" not in page
        and page.count("&lt;b&gt;tracker, LS + GP &amp; co.csv") == 2
        and "raises &lt;it&gt;" in page
    )


def test_every_parameter_is_there_with_its_uncertainty_and_what_the_rows_told_of_it(page, evidence):
    """Nothing is dropped or lost: what the rows do not tell stands there with 0 %, and its prior as uncertainty."""
    text, found = Page(page).text, evidence.fit.identification
    shown = text.split("What moved")[1]
    nominal = evidence.calibration.nominal
    moved = nominal.difference(found.geometry)
    assert len(found.identifiability.kept) == len(found.identifiability.names) == 38
    for k, name in enumerate(found.identifiability.names):
        scale, unit = (np.degrees(1.0), "deg") if is_angle(name) else (1e3, "mm")
        change, std = moved[nominal.parameter_names.index(name)] * scale, found.standard_deviation[k] * scale
        assert f"{figure(change)} ± {figure(std)} {unit}" in shown
        told = 100 * (1 - found.standard_deviation[k] / found.prior_std[k])
        assert re.search(rf"{re.escape(figure(std))} {unit} {max(told, 0.0):.0f} %", shown)
    assert evidence.prior_text[1:] in text and "tolerance class cobot" in text


def test_without_priors_the_page_says_that_nothing_was_expected(plant, sets, unwritten):
    with unwritten():
        text = Page(calibration_page(assess(plant.arm, fit(plant.arm, sets[0]), *sets))).text
    assert "Nothing was expected of them beforehand." in text
    assert " over nominal (mm) calibrated (mm)" not in text


def test_axes_gate_poses_and_origin_are_there(page, evidence):
    text = Page(page).text
    for axis, (_, _, rms, _) in axis_errors(evidence.errors[GEOMETRIC]).items():
        assert axis in text and figure(rms) in text
    assert "'gp' is used" in text and "no gain: raises" in text and "0.2500" in text
    for region in (evidence.quality.workspace.measured, evidence.quality.workspace.declared):
        low, high = (figure(1e3 * end) for end in region.calibrated_ends)
        assert f"{region.region} {figure(1e3 * region.nominal)} (" in text
        assert f"{figure(1e3 * region.calibrated)} ({low} to {high}) {100 * region.gain:.0f} %" in text
    assert figure(evidence.quality.observability["condition"]) in text
    record = evidence.fit.calibration.record
    assert record["data_fingerprint"] in text and "seed 7" in text and record["versions"]["numpy"] in text


def test_positions_only_and_a_residual_have_their_page(plant, sets, tmp_path, unwritten):
    positions = [data.positions_only() for data in sets]
    first = assess(plant.arm, fit(plant.arm, positions[0]), *positions)
    with unwritten():
        text = Page(write_calibration_report(tmp_path / "p.html", first).read_text(encoding="utf-8")).text
    assert "rx (deg)" not in text and "attitude error" not in text and "Learnt residual models" not in text
    rng = np.random.default_rng(1)
    more = simulated_tracker(plant, random_joints(plant.arm.nominal, 150, rng), rng)
    learnt = assess(plant.arm, fit(plant.arm, sets[0], more, residual="rbf", rng=rng), *sets)
    with unwritten():
        text = Page(calibration_page(learnt)).text
    assert "geometry + radial basis functions" in text
    assert learnt.best.mean < 0.6 * learnt.position["geometric"].mean
    assert f"the tool stood {figure(learnt.best.mean)} mm" in text


def test_a_bad_calibration_says_do_not_use(evidence, unwritten):
    worse = replace(evidence, quality=replace(evidence.quality, grade="do not use"))
    with unwritten():
        page = calibration_page(worse)
    assert 'class="verdict bad"' in page and "Do not use" in page


def test_poses_in_a_corner_make_the_page_name_what_to_move(plant, unwritten):
    """Of 70 poses within a thousandth of the joints' ranges, fitted frames take up whatever is off."""
    rng = np.random.default_rng(0)
    nominal = plant.arm.nominal
    middle = (nominal.lower + nominal.upper) / 2
    joints = middle + 1e-3 * (random_joints(nominal, 100, rng) - middle)
    data = simulated_tracker(plant, joints, rng)
    choices = Choices(terms="none", residual="none", frames="fitted")
    result = calibrate(plant.arm, data.select(range(70)), test=data.select(range(70, 100)), choices=choices)
    said = result.quality.workspace.reservation
    assert said is not None and "move J1 pitch, J2 horizontal" in said and result.quality.grade != "good"
    with unwritten():
        text = Page(calibration_page(result)).text
    assert said.replace("`", "")[1:] in text and said[1:] in " ".join(result.report().split())


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("alpha0", "twist between the axes of the base and J1"),
        ("a2", "distance between the axes of J2 and J3"),
        ("theta1", "angle offset of J1"),
        ("d3", "offset along the axis of J3"),
        ("base_rx", "base of the arm in the instrument's frame: turn about x"),
        ("tool_z", "target on the last link: position along z"),
        ("compliance2", "yielding of J2 under load"),
        ("thermal", "growth with temperature"),
        ("theta9", ""),
        ("zeta", ""),
    ],
)
def test_parameters_have_a_meaning(name, words):
    assert parameter_words(name, ("J1", "J2", "J3")) == words


def test_units_of_parameters():
    geometric = ("alpha0", "d1", "base_rx", "base_x")
    assert [unit_of(name, geometric)[0] for name in (*geometric, "thermal", "anchor_x")] == [
        "deg", "mm", "deg", "mm", "SI", "mm",
    ]  # fmt: skip


@pytest.mark.parametrize(("value", "sigma"), [(5.0, 1.0), (-0.5, 0.25), (1.0, 40.0), (0.0, 0.0)])
def test_a_bar_goes_from_zero_to_its_value_and_stays_in_its_cell(value, sigma):
    table = PageTable("caption", ("name", "drawn"), [("a1", (value, sigma, 2.0))])
    drawn = html_of("title", "", PageVerdict("note", "", ""), [Section("Bars", [table])], {})
    left, width = (float(number) for number in re.search(r'x="([\d.]+)" y="3" width="([\d.]+)"', drawn).groups())
    low, high = (float(number) for number in re.search(r'd="M([\d.]+) 7H([\d.]+)M', drawn).groups())
    end = left if value < 0.0 else left + width
    assert 4.0 <= low <= end <= high <= 116.0 and 60.0 in (left, left + width)
    assert (end - 60.0) / 56.0 == pytest.approx(np.clip(value / 2.0, -1.0, 1.0), abs=1e-3)


def test_bars_are_drawn_in_the_cells_of_what_moved(page, evidence):
    measured = evidence.parameters()
    told = [abs(row["change"]) > 2.0 * row["std"] for row in measured]
    moved = [row for row, yes in zip(measured, told, strict=True) if yes]
    moved += [row for row, yes in zip(measured, told, strict=True) if not yes]  # folded, below the others
    drawn = re.findall(r'<svg class="inline".*?aria-label="([^"]+)".*?x="([\d.]+)" y="3" width="([\d.]+)"', page, re.S)
    assert [label for label, _, _ in drawn] == [f"{row['change']:.3g}" for row in moved]
    for row, (_, x, width) in zip(moved, drawn, strict=True):
        assert float(width) > 0.0 or abs(row["change"]) < 0.1
        assert float(x) == pytest.approx(60.0 if row["change"] > 0.0 else 60.0 - float(width), abs=0.11)


def test_the_arms_and_joints_names_are_no_markup(evidence):
    hostile = "</title><script>alert('&')</script>"
    nominal = replace(evidence.arm.nominal, joint_names=tuple(f"{hostile}{i}" for i in range(6)))
    text = calibration_page(replace(evidence, arm=replace(evidence.arm, name=hostile, nominal=nominal)))
    Page(text)
    assert "<script" not in text and text.count("</title>") == 1
    assert text.count("&lt;script&gt;") >= 2  # the title and the heading


def test_names_of_files_arms_and_joints_stand_as_typed_beside_models_in_words(evidence):
    """A short name of a model in them is no model: whoever looks for the file must find it."""
    nominal = replace(evidence.arm.nominal, joint_names=tuple(f"GP+LS {i}" for i in range(6)))
    file = "LS+GP day+1.csv"
    named = replace(
        evidence,
        arm=replace(evidence.arm, name="my LS {arm}", nominal=nominal),
        train=replace(evidence.train, source=file),
        left_out=(LeftOut(file, 7, False, 1e-3),),
        quality=replace(evidence.quality, reason=f"{file} tells little", findings=[("note", "rows of " + file)] * 2),
    )
    text = Page(calibration_page(named)).text
    for words in ("Calibration of my LS {arm}", f"from {file};", f"{file}: row 7", f"{file} tells", f"Rows of {file}."):
        assert words in text
    assert "(my LS {arm})" in text and "offset along the axis of GP+LS 5" in text
    assert "Gaussian process + least" not in text and "radial basis functions" in text
