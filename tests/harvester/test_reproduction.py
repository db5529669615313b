"""The reproduction script runs from end to end and gives the numbers it promises."""

import html
import json
import subprocess
import sys
from pathlib import Path

import pytest

from pickenv.inspect.reports.harvest_report import page
from pickenv.inspect.runs.harvest_trace import HarvestTrace
from pickenv.inspect.runs.run_folder import load_part, read_run

ROOT = Path(__file__).parents[2]


@pytest.mark.slow
def test_the_script_gives_tables_figures_recording_and_json(tmp_path):
    command = [
        sys.executable,
        "scripts/reproduce_li2016.py",
        "--quick",
        "--json",
        tmp_path / "li.json",
        "--out",
        tmp_path,
    ]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True)
    found = json.loads((tmp_path / "li.json").read_text(encoding="utf-8"))
    assert {"raw", "calibrated", "optimised"} <= set(found["recovery"])
    for way in found["recovery"].values():
        assert {"rate", "ci95", "picks_per_hour", "collisions"} <= set(way)
        assert way["collisions"] == 0
        assert way["ci95"][0] <= way["rate"] <= way["ci95"][1]
    assert 0.70 <= found["recovery"]["raw"]["rate"] <= 0.90
    assert found["recovery"]["circles"]["rate"] >= 0.95 > found["recovery"]["raw"]["rate"]
    assert found["recovery"]["optimised"]["rate"] > found["recovery"]["raw"]["rate"]
    for way in found["recovery"].values():
        shares = [share[0] for share in way["funnel_shares"].values()]
        assert shares == sorted(shares, reverse=True) and shares[0] == 1.0
    speed = {name: way["picks_per_hour"] for name, way in found["recovery"].items()}
    assert speed["optimised"] >= 1.5 * speed["raw"]
    tables = found["tables"]
    assert list(tables) == ["1", "2", "3"] and list(found["figures"]) == ["8", "9"]
    for kind in ("tables", "equations", "figures", "experiments"):
        for part in found[kind].values():
            assert part["verdict"] in ("reproduced", "not reproduced", "fitted")
            assert len(part["reason"]) > 40 and part["rows"]
    assert [row["arm"] for row in tables["2"]["rows"]] == ["master", "left", "middle", "right"]
    assert tables["2"]["exact_for_spacing_mm"] == [450] and tables["3"]["verdict"] == "fitted"
    assert found["figures"]["9"]["verdict"] == "reproduced"
    for row in found["figures"]["9"]["rows"]:
        assert row["ours"] == pytest.approx(row["paper"], rel=2e-3)
    shown = (tmp_path / "reproduction.html").read_text(encoding="utf-8")
    for kind in ("tables", "equations", "figures", "experiments"):
        for part in found[kind].values():
            assert f"{part['verdict'].upper()}. {part['reason'][:30]}" in html.unescape(shown)
    assert shown.count("<figure>") == 2 and "46, 56" in shown
    figures = {path.stem for path in (tmp_path / "figures").glob("*.png")}
    assert figures == {"gantt", "pick_map", "funnel", "throughput", "workspace", "joint_curves"}
    assert (tmp_path / "zone.rrd").stat().st_size > 10_000
    run = read_run(tmp_path)
    trace = load_part(run, HarvestTrace)
    assert trace.funnels["raw"] == found["recovery"]["raw"]["funnel"]
    assert trace.tree_count == found["trees"] == 12
    assert page(run) == (tmp_path / "report.html").read_text(encoding="utf-8")
