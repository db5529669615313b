"""Every cell of a page, computed anew from the numbers in its run folder: values, labels, units, which row is whose."""

from __future__ import annotations

import json
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pickenv.harvester import Measure
from pickenv.inspect import (
    HarvestTrace,
    PickedTree,
    Run,
    drawings_of,
    page_of,
    recorded_run,
    save_part,
)
from pickenv.inspect.runs.run_folder import ISO9283

CONTROLLERS = ("raw", "calibrated")


class Tables(HTMLParser):
    """The tables of a page as rows of texts, by caption, and its running text."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.tables: dict[str, list[list[str]]] = {}
        self.words: list[str] = []
        self.tag = ""
        self.rows: list[list[str]] = []
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tag = "caption" if (self.tag, tag) == ("caption", "span") else tag
        if tag == "table":
            self.rows = []
        if tag == "tr":
            self.rows.append([])
        if tag in ("td", "th"):
            self.rows[-1].append("")

    def handle_endtag(self, tag: str) -> None:
        self.tag = ""

    def handle_data(self, data: str) -> None:
        if self.tag == "caption":
            self.tables[data] = self.rows
        elif self.tag in ("td", "th"):
            self.rows[-1][-1] += data
        if self.tag not in ("style", "script"):
            self.words.append(data)

    @property
    def text(self) -> str:
        return " ".join(" ".join(self.words).split())


@pytest.fixture
def result() -> dict[str, Any]:
    """Numbers of a test by ISO 9283, no two alike."""
    rng = np.random.default_rng(11)

    def controller() -> dict[str, Any]:
        poses = [
            {
                "name": f"P{k}",
                "accuracy_mm": float(rng.uniform(0.1, 3)),
                "repeatability_mm": float(rng.uniform(0.01, 0.3)),
                "repeatability_ci95_mm": None if k == 2 else rng.uniform(0.01, 0.3, 2).tolist(),
                "accuracy_deg": float(rng.uniform(0.01, 0.3)),
                "repeatability_deg": rng.uniform(0.001, 0.03, 3).tolist(),
            }
            for k in range(1, 6)
        ]
        return {
            "poses": poses,
            "variation_mm": {name: float(rng.uniform(0.1, 1)) for name in ("P1", "P2", "P4")},
            "drift_mm": float(rng.uniform(0.1, 1)),
            "drift_hours": [0.0, 4.0, 8.0],
            "drift_accuracy_mm": rng.uniform(0.1, 1, 3).tolist(),
            "worst_accuracy_mm": max(pose["accuracy_mm"] for pose in poses),
            "worst_repeatability_mm": max(pose["repeatability_mm"] for pose in poses),
        }

    settings = {"cycles": 17, "speed_share": 0.4, "dwell_s": 2.5}
    about = {"plant": "orchard", "standard": "ISO 9283:1998", "settings": settings}
    return about | {name: controller() for name in CONTROLLERS}


@pytest.fixture
def iso(result: dict[str, Any], tmp_path: Path) -> Run:
    with recorded_run(tmp_path / "iso", "iso9283", "pickenv iso9283 --seed 3", 3) as run:
        (run.folder / ISO9283).write_text(json.dumps(result))
    return run


def test_iso_9283(iso: Run, result: dict[str, Any]) -> None:
    page = Tables(page_of(iso))
    (heads, *rows) = page.tables["Accuracy and repeatability of this one arm at each test pose"]
    assert heads == ["test pose", "AP (mm)", "RP (mm), 95 % interval over cycles", "AP (deg)", "RP (deg)", "vAP (mm)"]
    wanted = []
    for name in CONTROLLERS:
        for pose in result[name]["poses"]:
            variation = result[name]["variation_mm"].get(pose["name"])
            ends = pose["repeatability_ci95_mm"]
            interval = "" if ends is None else f" ({ends[0]:.3f} to {ends[1]:.3f})"
            wanted.append(
                [
                    f"{name} {pose['name']}",
                    f"{pose['accuracy_mm']:.3f}",
                    f"{pose['repeatability_mm']:.3f}{interval}",
                    f"{pose['accuracy_deg']:.4f}",
                    f"{sorted(pose['repeatability_deg'])[-1]:.4f}",
                    "–" if variation is None else f"{variation:.3f}",
                ]
            )
    assert rows == wanted
    for name in CONTROLLERS:
        found = result[name]
        worst = [max(pose[key] for pose in found["poses"]) for key in ("accuracy_mm", "repeatability_mm")]
        assert f"{name}: AP {worst[0]:.3f} mm, RP {worst[1]:.3f} mm, drift dAP {found['drift_mm']:.3f} mm" in page.text
    ap, rp = (result["calibrated"][f"worst_{key}_mm"] for key in ("accuracy", "repeatability"))
    assert f"Accuracy AP {ap:.2f} mm, repeatability RP {rp:.2f} mm" in page.text
    assert (
        "Simulated arm orchard (drifting arm); ISO 9283:1998, 17 cycles at 40 % speed, measured 2.5 s after arrival"
        in page.text
    )


def test_the_figures_of_iso_9283(iso: Run, result: dict[str, Any]) -> None:
    drawn = {drawing.name: drawing.draw() for drawing in drawings_of(iso) if drawing.draw is not None}
    for axes, key in zip(drawn["pose_accuracy"].axes, ("accuracy_mm", "repeatability_mm"), strict=True):
        bars = {group.get_label().split(":")[0]: [b.get_height() for b in group] for group in axes.containers}  # type: ignore[attr-defined]
        assert bars == {name: [pose[key] for pose in result[name]["poses"]] for name in CONTROLLERS}
    (axes,) = drawn["drift"].axes
    lines = {line.get_label(): np.asarray(line.get_xydata()).T.tolist() for line in axes.get_lines()}
    assert lines == {name: [result["raw"]["drift_hours"], result[name]["drift_accuracy_mm"]] for name in CONTROLLERS}


@pytest.fixture
def trace() -> HarvestTrace:
    rng = np.random.default_rng(12)
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

    def measures() -> dict[str, Measure]:
        share, rate, idle = rng.uniform(0.5, 0.9), rng.uniform(300, 900), rng.uniform(0.1, 0.4)
        return {
            "harvested": Measure(share, share - 0.04, share + 0.05),
            "picks_per_hour": Measure(rate, rate - 31, rate + 42),
            "idle_share": Measure(idle, idle - 0.02, idle + 0.03),
        }

    names = ("raw", "middle", "best")
    return HarvestTrace(
        trees=dict.fromkeys(names, tree),
        funnels={n: {"present": 731, "seen": 700 - i, "collected": 543 + i} for i, n in enumerate(names)},
        measures={name: measures() for name in names},
        throughput={"thin": {1: Measure(500.0, 450.0, 540.0)}},
        cloud=rng.uniform(size=(20, 3, 3)),
        curves=(np.linspace(0, 1, 5), {"master d2": np.linspace(0, 1, 5)}, ()),
        tree_count=12,
    )


def test_harvest(trace: HarvestTrace, tmp_path: Path) -> None:
    with recorded_run(tmp_path / "harvest", "harvest", "python -m papers.li2016 --quick", 2016) as run:
        save_part(run.folder, trace, 2016)
    page = Tables(page_of(run))
    (table,) = [rows for caption, rows in page.tables.items() if caption.startswith("Measures of each strategy")]
    assert table[0] == ["measure", "raw", "middle", "best"]
    wanted = {"harvested": (100.0, 1), "picks_per_hour": (1.0, 3), "idle_share": (100.0, 1)}
    for (name, *cells), (key, (scale, digits)) in zip(table[1:], wanted.items(), strict=True):
        assert name.endswith("(%)" if scale > 1.0 else "(1/h)")
        for cell, strategy in zip(cells, trace.measures, strict=True):
            m = trace.measures[strategy][key]
            numbers = [float(n) for n in cell.replace("(", "").replace(")", "").replace(" to", "").split()]
            assert numbers == [float(f"{scale * v:.{digits}f}") for v in (m.value, m.low, m.high)]
    funnel = page.tables["Fruit at each stage, over all trees"]
    assert funnel[0] == ["stage", "raw", "middle", "best"]
    assert funnel[1:] == [
        [stage, *(str(trace.funnels[name][stage]) for name in trace.funnels)]
        for stage in ("present", "seen", "collected")
    ]
    before, after = trace.measures["raw"], trace.measures["best"]
    shares = [f"{100 * found['harvested'].value:.0f}" for found in (before, after)]
    assert f"From raw to best: {shares[0]} to {shares[1]} % of the fruit" in page.text
    for name, found in (("raw", before), ("best", after)):
        share, rate = found["harvested"], found["picks_per_hour"]
        assert f"{100 * share.value:.1f} % ({100 * share.low:.1f} to {100 * share.high:.1f})" in page.text, name
        assert f"{rate.value:.0f} ({rate.low:.0f} to {rate.high:.0f})" in page.text, name
    assert "On 12 simulated trees" in page.text and "3 picking arms, 3 strategies" in page.text
