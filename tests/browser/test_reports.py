"""Reports in a real browser: nothing is fetched, nothing fails, all of it can be read on screen, phone and paper."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pickenv.inspect import in_words
from tests.browser.chromium import PHONE, SIZE
from tests.browser.report_page import BROKEN_IMAGES, CLIPPED, FAINT, PAPER, SIDEWAYS, Report, open_report

STUDY = Path(__file__).parents[2] / "scripts/tolerance_study.toml"
NUMBER = r"([+\-−]?[\d.]+)"


@pytest.fixture(scope="module")
def reports(run_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """A page of each kind: the run's own, of its measurements, of policies with its calibration, and of a study."""
    made = tmp_path_factory.mktemp("reports")
    written = {"report": run_folder / "report.html", "calibration": run_folder / "calibration.html"}
    written |= {kind: made / kind / "report.html" for kind in ("comparison", "study")}
    arm, calibration = ["--arm", "qiao2026"], run_folder / "calibration.npz"
    policies = ["scripted", "--compensate", "none", calibration, "--episodes", "12", "--grid-step", "0.3"]
    for command in (
        ["report", run_folder],
        ["calibrate", run_folder / "measurements.csv", *arm, "--report", written["calibration"]],
        ["compare", *policies, "--out", written["comparison"].parent],
        ["study", STUDY, "--quick", "--out", written["study"].parent],
    ):
        done = subprocess.run([sys.executable, "-m", "pickenv.cli", *command], capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
    return written


@pytest.fixture(scope="module", params=["report", "calibration", "comparison", "study"])
def name(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_a_report_stands_alone_and_can_be_read(
    browser: Any, reports: dict[str, Path], name: str, theme: str, screenshots: Path
) -> None:
    with open_report(browser, reports[name], viewport=SIZE, color_scheme=theme) as report:
        assert report.complaints == []
        assert [url[:80] for url in report.asked if not url.startswith(("data:", "blob:"))] == [
            reports[name].resolve().as_uri()
        ]
        assert report.page.evaluate(BROKEN_IMAGES) == []
        assert report.page.evaluate(SIDEWAYS) == []
        assert report.page.evaluate(FAINT) == []
        report.page.screenshot(path=screenshots / f"{name}-{theme}.png")
        report.page.screenshot(path=screenshots / f"{name}-{theme}-whole.png", full_page=True)


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_a_report_breaks_no_rule_of_accessibility(
    browser: Any, reports: dict[str, Path], name: str, theme: str
) -> None:
    from axe_playwright_python.sync_playwright import Axe

    with open_report(browser, reports[name], viewport=SIZE, color_scheme=theme) as report:
        found = Axe().run(report.page).response
    assert len(found["passes"]) > 20
    assert [(rule["id"], node["html"][:120]) for rule in found["violations"] for node in rule["nodes"]] == []


def test_the_report_shows_the_recording(browser: Any, reports: dict[str, Path]) -> None:
    with open_report(browser, reports["report"], viewport=SIZE) as report:
        pictures = report.page.locator("img")
        assert [pictures.nth(i).evaluate("i => i.naturalWidth") for i in range(pictures.count())] == [SIZE["width"]]


def test_a_report_fits_a_phone(browser: Any, reports: dict[str, Path], name: str, screenshots: Path) -> None:
    with open_report(browser, reports[name], viewport=PHONE, color_scheme="light") as report:
        assert report.page.evaluate("() => document.documentElement.scrollWidth") == PHONE["width"]
        assert report.page.evaluate(SIDEWAYS) == []
        assert report.complaints == []
        report.page.screenshot(path=screenshots / f"{name}-phone.png")


def test_a_report_fits_paper(browser: Any, reports: dict[str, Path], name: str, screenshots: Path) -> None:
    with open_report(browser, reports[name], viewport=PAPER, color_scheme="dark") as report:
        paper = report.page.pdf(format="A4", print_background=True)
        (screenshots / f"{name}.pdf").write_bytes(paper)
        report.page.emulate_media(media="print")
        assert report.page.evaluate(CLIPPED) == []
        assert report.page.evaluate(FAINT) == []
        assert not report.page.locator(".interactive:visible").count()
        height = report.page.evaluate("() => document.documentElement.scrollHeight")
    pages = len(re.findall(rb"/Type\s*/Page\b", paper))
    assert height / PAPER["height"] <= pages <= 1.5 * height / PAPER["height"] + 1.0


def test_hovering_reads_a_poses_millimetres(browser: Any, reports: dict[str, Path], run_folder: Path) -> None:
    from pickenv.inspect import CalibrationTrace, load_part, read_run

    errors = load_part(read_run(run_folder), CalibrationTrace).errors
    with open_report(browser, reports["report"], viewport=SIZE) as report:
        plot = report.page.locator(".interactive:has(.cartesianlayer .trace)").last
        plot.scroll_into_view_if_needed()
        said = sweep(report, plot, r"pose (\d+): " + NUMBER + " mm")
    assert len(said) > 10
    for label, pose, value in said:
        of_stage = {key: 1e3 * np.linalg.norm(e[int(pose) - 1, :3]) for key, e in errors.items()}
        assert any(float(value) == pytest.approx(mm, abs=6e-4) for mm in of_stage.values()), (label, pose, value)


def test_hovering_reads_an_arrows_millimetres(browser: Any, reports: dict[str, Path], run_folder: Path) -> None:
    from pickenv.inspect import Comparison, load_part, read_run

    comparison = load_part(read_run(run_folder), Comparison)
    pattern = rf"{NUMBER} mm ?x {NUMBER}, y {NUMBER}, z {NUMBER} mm ?at x {NUMBER}, y {NUMBER}, z {NUMBER} m"
    with open_report(browser, reports["report"], viewport=SIZE) as report:
        plot = report.page.locator(".interactive:has(.gl-container canvas)").first
        plot.scroll_into_view_if_needed()
        said = sweep(report, plot, pattern)
    assert len(said) > 5
    for label, norm, *rest in said:
        (policy,) = (p for p in comparison.policies if in_words(p.label) == label)
        xyz, point = np.array(rest[:3], dtype=float), np.array(rest[3:], dtype=float)
        nearest = int(np.argmin(np.linalg.norm(comparison.grid.points - point, axis=1)))
        np.testing.assert_allclose(comparison.grid.points[nearest], point, atol=6e-4)
        np.testing.assert_allclose(1e3 * policy.field_errors[nearest], xyz, atol=6e-4)
        assert float(norm) == pytest.approx(1e3 * np.linalg.norm(policy.field_errors[nearest]), abs=6e-4)


def sweep(report: Report, plot: Any, pattern: str) -> set[tuple[str, ...]]:
    """Move the pointer over a plot; label and numbers of every hover text that has ``pattern`` in it."""
    box, found = plot.bounding_box(), set()
    for across in np.linspace(0.05, 0.95, 61):
        for down in (0.35, 0.5, 0.65):
            report.page.mouse.move(box["x"] + across * box["width"], box["y"] + down * box["height"])
            report.page.wait_for_timeout(60.0)  # what lies under the pointer is found some frames later
            said = report.hovered().replace("−", "-")
            if match := re.search(pattern, said):
                found.add((said.replace(match[0], "").strip(), *match.groups()))
    return found
