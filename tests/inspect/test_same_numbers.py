"""One quantity has one number and one unit: in the terminal, in JSON and on the page; and tables fit the terminal."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from contextlib import AbstractContextManager
from html import unescape
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pickenv.arm import load_plant
from pickenv.calibration import Choices, Result, calibrate, random_joints, simulated_tracker
from pickenv.calibration.assessment.screen import figure
from pickenv.cli import _print_demo
from pickenv.commands.showing import print_table
from pickenv.demo import DemoSettings, run_demo, summarise, write_run
from pickenv.inspect import calibration_page
from pickenv.inspect.colours import in_words


@pytest.fixture(scope="module")
def result() -> Result:
    plant, rng = load_plant("qiao2026"), np.random.default_rng(3)
    poses = simulated_tracker(plant, random_joints(plant.arm.nominal, 60, rng), rng)
    return calibrate(plant.arm, poses, choices=Choices(terms="none", residual="none"))


@pytest.fixture(scope="module")
def page(result: Result, unwritten: Callable[[], AbstractContextManager[None]]) -> str:
    """The page of the calibration, with empty figures."""
    with unwritten():
        return calibration_page(result)


def rows_of(page: str) -> dict[str, list[str]]:
    """Cells of every table's rows, by the first one; the first row of a name counts."""
    found: dict[str, list[str]] = {}
    for row in re.findall(r"<tr>(.*?)</tr>", page, flags=re.S):
        cells = [
            unescape(re.sub(r"<.*?>", "", cell, flags=re.S)).strip()
            for cell in re.findall(r"<t[hd].*?</t[hd]>", row, flags=re.S)
        ]
        found.setdefault(cells[0], cells[1:])
    return found


def test_a_calibrations_numbers_are_the_same_everywhere(
    result: Result, page: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("COLUMNS", raising=False)
    said, told, cells_of = result.report(), json.loads(json.dumps(result.as_dict())), rows_of(page)
    lines = {line.split("  ")[1].strip(): line for line in said.splitlines() if line.startswith("  ")}
    for model, label in (("nominal", "nominal"), ("geometric", "geometry")):
        held = told["held_out"][f"{model}_mm"]
        numbers = [figure(held[key]) for key in ("rms", "mean", "p95", "max")]
        attitude = figure(told["held_out"][f"{model}_deg"]["mean"])
        assert [cells_of[label][i] for i in (0, 1, 3, 4, 5)] == [*numbers, attitude]
        assert all(number in lines[label] for number in (*numbers, attitude))
    moved = [row for row in told["changes"] if abs(row["change"]) > 2.0 * row["std"]]
    assert 0 < len(moved) < len(told["changes"])
    for row in told["changes"]:
        change, std = figure(row["change"]), figure(row["std"])
        narrowed = f"{100 * row['narrowed']:.0f} %"
        assert cells_of[row["name"]][1] == f"{change} ± {std} {row['unit']}" and cells_of[row["name"]][3] == narrowed
        assert row["narrowed"] == pytest.approx(max(0.0, 1.0 - row["std"] / row["prior_std"]))
        shown = lines.get(row["name"], "")
        cells = [row["name"], change, std, row["unit"], *narrowed.split()]
        assert shown.split() == (cells if row in moved else [])
    assert f"those of {len(told['changes'])} that moved by more than 2 sigma; {result.prior_text}" in " ".join(
        said.split()
    )
    for region in (told["workspace"]["measured"], told["workspace"]["declared"]):
        cells = [
            f"{figure(region[f'{name}_rms_mm'])} ({' to '.join(map(figure, region[f'{name}_ci95_mm']))})"
            for name in ("nominal", "calibrated")
        ]
        cells += [f"{100 * region[name]:.0f} %" for name in ("gain", "narrowed")]
        assert cells_of[region["region"]] == cells and all(cell in lines[region["region"]] for cell in cells)


def test_a_page_says_in_its_second_sentence_whether_picks_change(page: str) -> None:
    text = re.search(r'class="verdict.*?<p>(.*?)</p>', page, flags=re.S)
    assert text is not None
    assert re.split(r"(?<=\.) (?=[A-Z])", unescape(text[1]))[1].startswith(
        "On an arm with these errors (qiao2026) this"
    )


@pytest.mark.parametrize("columns", [80, 100])
def test_tables_fit_the_terminal_and_lose_nothing(
    columns: int, result: Result, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    heads = ("policy", "compensation", "mean (mm)", "95 % interval (mm)", "median arm (mm)", "success (%)", "cycle (s)")
    cells = (
        "scripted (3 trainings)",
        "ls_bpnn",
        "1.234",
        "0.987 to 1.512",
        "1.100 (0.876 to 1.345)",
        "95.0 (90.1 to 98.2)",
        "1.1",
    )
    said = {}
    for width in (1000, columns):
        monkeypatch.setenv("COLUMNS", str(width))
        print_table("a title of the table", heads, [cells], words=heads[:2], caption="what it all means")
        said[width] = f"{result.report()}\n{capsys.readouterr().out}"
    assert max(map(len, said[columns].splitlines())) <= columns < max(map(len, said[1000].splitlines()))
    assert set(re.findall(r"[\w.%()±+-]+", said[columns])) == set(re.findall(r"[\w.%()±+-]+", said[1000]))
    assert "…" not in said[columns]


@pytest.mark.slow
def test_a_demonstrations_numbers_are_the_same_everywhere(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found = run_demo(DemoSettings(seed=1, reaches=20, epochs=20, grid_step=0.3, gain_poses=0))
    assert found.calibrated.terms is None, "the paper adds a network to geometry, and nothing else"
    write_run(found, tmp_path / "run")
    summary: dict[str, Any] = json.loads((tmp_path / "run/summary.json").read_text(encoding="utf-8"))
    assert summary == json.loads(json.dumps(summarise(found)))
    page = (tmp_path / "run/report.html").read_text(encoding="utf-8")
    _print_demo(summary)
    lines = [re.split(" {3,}", line.strip()) for line in capsys.readouterr().out.splitlines()]
    terminal, rows = {line[0]: line[1:] for line in reversed(lines) if line}, rows_of(page)
    for key, label in (("raw", "raw"), ("ls", "LS"), ("ls_bpnn", "LS+BPNN")):
        mm = summary["policies"][key]["position_mm"]
        mean, rms, p95 = (f"{mm[name]:.3f}" for name in ("mean", "rms", "p95"))
        assert (
            [terminal[label][i] for i in (0, 2, 3)]
            == [mean, rms, p95]
            == [rows[in_words(label)][i].split()[0] for i in (3, 4, 5)]
        )
        assert terminal[label][1] in rows[in_words(label)][3]  # the interval
        assert (
            terminal[label][4]
            == rows[in_words(label)][7].split()[0]
            == f"{summary['policies'][key]['attitude_deg']['mean']:.3f}"
        )
    assert len(summary["matters"]) == 2
    for sentences in summary["matters"]:
        assert in_words(sentences).partition(" this ")[2] in unescape(page)
    no, yes = summary["matters"]
    assert "changes no more than" in no and "changes picks" in yes
