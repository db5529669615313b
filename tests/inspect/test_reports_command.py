"""`pickenv figures` and `pickenv report` do for every kind of run what its numbers allow, or refuse in a sentence."""

import json
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from pickenv.arm import load_plant
from pickenv.base import InputError, registry
from pickenv.calibration import random_joints, simulated_tracker
from pickenv.cli import app
from pickenv.harvester import Measure
from pickenv.inspect import (
    Comparison,
    HarvestTrace,
    PickedTree,
    Run,
    drawings_of,
    page_of,
    read_run,
    recorded_run,
    run_kind,
    save_part,
)

LITERATURE = {
    "error_per_test_pose",
    "error_by_stage",
    "position_error_by_policy",
    "error_histogram",
    "error_cumulative",
    "least_squares_convergence",
    "network_convergence",
    "error_slices",
    "parameter_spectrum",
    "singular_values",
    "error_against_extension",
    "error_against_payload",
    "error_against_temperature",
    "success_against_misalignment",
}
HARVESTING = {"workspace", "joint_curves", "gantt", "pick_map", "funnel", "throughput"}


def call(*arguments: object) -> str:
    """What a command prints; its errors are raised."""
    result = CliRunner().invoke(app, [str(argument) for argument in arguments], catch_exceptions=False)
    assert result.exit_code == 0
    return result.output


def controller(scale: float) -> dict[str, object]:
    pose = {"name": "P1", "accuracy_mm": 2.345 * scale, "repeatability_mm": 0.0625, "accuracy_deg": 0.1}
    pose |= {"repeatability_ci95_mm": None}
    return {
        "poses": [pose | {"repeatability_deg": [0.01, 0.02, 0.03]}],
        "variation_mm": {"P1": 0.3},
        "drift_mm": 0.4 * scale,
        "drift_hours": [0.0, 4.0, 8.0],
        "drift_accuracy_mm": [scale, scale, 1.4 * scale],
        "worst_accuracy_mm": 2.345 * scale,
        "worst_repeatability_mm": 0.0625,
    }


@pytest.fixture
def iso(tmp_path: Path) -> Run:
    settings = {"cycles": 30, "speed_share": 1.0, "dwell_s": 2.0}
    result = {"plant": "orchard", "standard": "ISO 9283:1998", "settings": settings}
    with recorded_run(tmp_path / "iso", "iso9283", "pickenv iso9283 --seed 3", 3) as run:
        run.folder.mkdir(parents=True, exist_ok=True)
        (run.folder / "iso9283.json").write_text(
            json.dumps(result | {"raw": controller(1.0), "calibrated": controller(0.1)})
        )
    return run


@pytest.fixture
def harvest(tmp_path: Path) -> Run:
    rng = np.random.default_rng(0)
    tree = PickedTree(
        seconds=20.0,
        fruit=rng.uniform(-1.0, 1.0, size=(2, 3)),
        collected=np.array([True, False]),
        by_arm=np.array([0, -1]),
        zones=np.array([[-1.0, 1.0, 0.5, 1.5]]),
        stands=np.array([[2.0, 8.0]]),
        arm=np.array([0]),
        start=np.array([2.0]),
        end=np.array([5.0]),
        held=np.array([0.0]),
        got=np.array([True]),
    )
    measures = {"harvested": Measure(0.7431, 0.7, 0.8), "picks_per_hour": Measure(513.0, 500.0, 530.0)}
    time = np.linspace(0.0, 1.0, 5)
    trace = HarvestTrace(
        trees={"raw": tree, "best": tree},
        funnels={"raw": {"present": 731, "collected": 543}, "best": {"present": 731, "collected": 700}},
        measures={"raw": measures, "best": measures | {"harvested": Measure(0.957, 0.9, 0.99)}},
        throughput={"thin": {1: Measure(500.0, 450.0, 540.0)}},
        cloud=rng.uniform(size=(20, 3, 3)),
        curves=(time, {"master d2": time}, ()),
        tree_count=12,
    )
    with recorded_run(tmp_path / "harvest", "harvest", "python -m papers.li2016 --quick", 2016) as run:
        save_part(run.folder, trace, 2016)
    return run


@pytest.mark.parametrize("kind", registry.names("report"))
def test_every_kind_of_run_has_a_module_with_its_figures_and_its_page(kind: str) -> None:
    module = import_module(run_kind(kind).pages)
    assert callable(module.drawings)
    assert callable(module.page)


@pytest.mark.slow
def test_a_report_enters_the_page_of_its_kind_and_no_other() -> None:
    code = "import sys, pickenv.inspect.reports.iso9283_report; print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout.split()
    pages = {run_kind(name).pages for name in registry.names("report")}
    assert set(loaded) & pages == {"pickenv.inspect.reports.iso9283_report"}


@pytest.mark.slow
def test_figures_are_written_in_each_format_and_named(iso: Run) -> None:
    printed = call("figures", iso.folder)
    written = sorted(path.name for path in (iso.folder / "figures").iterdir())
    assert written == ["drift.png", "drift.svg", "pose_accuracy.png", "pose_accuracy.svg"]
    assert printed.count("wrote ") == 4
    before = (iso.folder / "figures" / "drift.svg").read_bytes()
    call("figures", iso.folder, "--format", "svg", "--out", iso.folder / "again")
    assert (iso.folder / "again" / "drift.svg").read_bytes() == before


def test_every_figure_of_the_literature_is_drawn_or_left_out_with_a_reason(demo_run: Run, harvest: Run) -> None:
    found = {d.name: d for d in drawings_of(demo_run)}
    assert set(found) >= LITERATURE
    assert {d.name for d in drawings_of(harvest)} == HARVESTING
    left_out = {name for name, drawing in found.items() if drawing.draw is None}
    assert left_out == {"error_against_payload", "error_against_temperature", "network_convergence"}


def test_the_documentation_names_every_figure_and_every_option(demo_run: Run, harvest: Run, iso: Run) -> None:
    text = (Path(__file__).parents[2] / "docs/figures-and-reports.md").read_text(encoding="utf-8")
    rows = text[text.index("| figure | shows |") :].splitlines()[2:]
    named = {name for row in rows for name in re.findall(r"`(\w+)`", row.split("|")[1])}
    drawn = {drawing.name for run in (demo_run, harvest, iso) for drawing in drawings_of(run)}
    assert named == drawn | {
        "aggregates",
        "corner_errors",  # of pictures
        "view_errors",
        *(f"{name}_PLANT" for name in ("accuracy_against_cycle_time", "success_against_misalignment")),
        *(f"{name}_PLANT" for name in ("error_by_compensation", "error_cumulative")),
    }
    lines = re.findall(r"^pickenv .*$", text, re.M) + re.findall(r"`(pickenv [^`]*)`", text)
    assert len(lines) > 8
    for line in lines:
        _, command, *words = line.split()
        known = {name for option in click_command(command).params for name in option.opts + option.secondary_opts}
        assert {word for word in words if word.startswith("--")} <= known, line


def click_command(name: str) -> Any:
    """The command of that name, with its options."""
    return typer.main.get_command(app).commands[name]  # type: ignore[attr-defined]


@pytest.mark.slow
def test_every_drawing_can_be_drawn(demo_run: Run, harvest: Run, tmp_path: Path) -> None:
    for run in (demo_run, harvest):
        call("figures", run.folder, "--format", "svg", "--out", tmp_path / "drawn" / run.kind)
        drawable = {d.name for d in drawings_of(run) if d.draw is not None}
        assert {path.stem for path in (tmp_path / "drawn" / run.kind).iterdir()} == drawable


def test_reports_of_iso_9283_say_what_was_found(iso: Run) -> None:
    call("report", iso.folder)
    page = (iso.folder / "report.html").read_text(encoding="utf-8")
    for number in ("AP 0.23 mm", "2.345", "0.235", "0.062", "0.300", "pickenv iso9283 --seed 3", "ISO 9283:1998"):
        assert number in page


def test_reports_of_a_harvest_say_what_was_found(harvest: Run) -> None:
    page = page_of(read_run(harvest.folder))
    for number in (
        "74 to 96 % of the fruit",
        "74.3 % (70.0 to 80.0)",
        "513 (500 to 530)",
        "731",
        "543",
        "12 simulated",
    ):
        assert number in page


@pytest.mark.slow
def test_a_calibrations_run_folder_keeps_its_report_and_its_figures(tmp_path: Path) -> None:
    plant, rng = load_plant("geometry_only"), np.random.default_rng(0)
    poses = simulated_tracker(plant, random_joints(plant.geometry, 60, rng), rng)
    poses.write_csv(tmp_path / "tracker.csv")
    folder = tmp_path / "run"
    options = ["--terms", "none", "--residual", "none"]
    call("calibrate", tmp_path / "tracker.csv", "--arm", "qiao2026", *options, "--run", folder)
    run = read_run(folder)
    assert run.kind == "calibration"
    assert run.command.endswith("--split random --seed 0 --fit auto --terms none --residual none")
    assert {d.name for d in drawings_of(run)} >= {"error_per_test_pose", "parameter_spectrum"}
    call("report", folder, "--out", tmp_path / "copy.html")
    assert (tmp_path / "copy.html").read_text() == (folder / "report.html").read_text()
    (folder / "report.html").unlink()
    with pytest.raises(InputError, match=r"report\.html does not exist"):
        call("report", folder)


def test_bad_folders_are_refused_in_one_sentence_and_nothing_is_written(
    comparison: Comparison, demo_run: Run, iso: Run, tmp_path: Path
) -> None:
    def refused(change: Callable[[Path], object], *words: str, run: Run = demo_run) -> None:
        folder = tmp_path / "changed"
        shutil.copytree(run.folder, folder)
        change(folder)
        before = sorted(folder.iterdir())
        for command in ("figures", "report"):
            with pytest.raises(InputError) as caught:
                call(command, folder)
            sentence = str(caught.value)
            assert all(word in sentence for word in words), sentence
            assert "\n" not in sentence
        assert sorted(folder.iterdir()) == before
        shutil.rmtree(folder)

    refused(lambda f: (f / "run.json").unlink(), "no run.json", "no complete run", "pickenv demo")
    refused(lambda f: (f / "comparison.npz").unlink(), "comparison.npz does not exist", "pickenv demo --out")
    refused(lambda f: (f / "comparison.npz").write_bytes(b"PK"), "comparison.npz is not what the run wrote")
    refused(lambda f: (f / "calibration_trace.npz").unlink(), "calibration_trace.npz does not exist")
    refused(lambda f: (f / "iso9283.json").write_text("{}"), "iso9283.json is not what the run wrote", run=iso)
    refused(lambda f: (f / "iso9283.json").unlink(), "iso9283.json does not exist", "pickenv iso9283 --out", run=iso)
    with pytest.raises(InputError, match="nowhere is no folder"):
        call("figures", tmp_path / "nowhere")
    with pytest.raises(InputError, match=r"'docx' is no picture format; give one of .*png"):
        call("figures", iso.folder, "--format", "svg,docx")
    assert not (iso.folder / "figures").exists()
