"""Screens: at most 25 lines of 100 characters, the verdict with its number first; the rest in details and JSON."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from functools import cache, partial, wraps
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console
from typer.testing import CliRunner

import pickenv
from pickenv.cli import app
from tests.conftest import unwritten_figures

LINES, WIDTH = 25, 100
UR5 = "ur5_wam_jacobi2025/UR5/3D_UR5_uncalibrated_{}_cleaned.csv"
SETS = {
    "ur5": (["--arm", "ur5", "--columns", "ur5_jacobi2025"], UR5.format("grid")),
    "ur10": (
        ["--arm", "ur10", "--columns", "ur10_landgraf2021_repeats"],
        "ur10_ipa_landgraf2021/Series_D/measurements_iso_cubes.csv",
    ),
    "panda": (
        ["--arm", "{}/mukca_sockets/urdf/panda.urdf#ball_link", "--columns", "mukca_sockets"],
        "mukca_sockets/data/panda_1/*/hole_*.csv",
    ),
    "ur10e": (["--arm", "ur10e", "--columns", "{}/ur10e_realsense/columns.toml"], "ur10e_realsense/views.csv"),
}


@pytest.fixture(scope="module", autouse=True)
def folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A folder for the files of all tests, which are named apart."""
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder := tmp_path_factory.mktemp("screens"))
        yield folder


@cache
def screen(*words: object) -> list[str]:
    """The lines that a command prints on a screen of this width; nothing changes them, and a command runs once."""
    done = CliRunner().invoke(app, [str(word) for word in words], env={"COLUMNS": str(WIDTH)})
    assert done.exit_code == 0, done.output
    return done.stdout.rstrip("\n").splitlines()


def check(lines: list[str]) -> None:
    assert len(lines) <= LINES, "\n".join(lines)
    assert max(len(line) for line in lines if not line.startswith("next: ")) <= WIDTH  # a command is copied whole
    assert re.search(r"\d", " ".join(lines[:2]))
    assert any(line.startswith("next: ") for line in lines)


def calibration(data: Path, name: str) -> list[str]:
    """The command that calibrates a measured robot."""
    options, pattern = SETS[name]
    return ["calibrate", *map(str, sorted(data.glob(pattern))), *(word.format(data) for word in options)]


def figure(number: float) -> str:
    """A number as screens show it: four significant digits."""
    if number == 0 or 1e-3 <= abs(number) < 1e4:
        return f"{number:#.4g}".rstrip(".")
    return f"{number:.0f}" if 1e4 <= abs(number) < 1e9 else f"{number:.3e}"


def leaves(told: Any) -> Iterator[Any]:
    if isinstance(told, dict | list):
        for part in told.values() if isinstance(told, dict) else told:
            yield from leaves(part)
    else:
        yield told


@cache
def calibrated(data: Path, name: str) -> tuple[list[str], pickenv.Result]:
    """What `pickenv calibrate` prints where it saves {name}.npz, {name}.json and {name}.html, and its result."""
    results, calibrate = [], pickenv.calibrate

    @wraps(calibrate)
    def noted(*arguments: Any, **options: Any) -> pickenv.Result:
        results.append(calibrate(*arguments, **options))
        return results[-1]

    with pytest.MonkeyPatch.context() as patch, unwritten_figures():
        patch.setattr(pickenv, "calibrate", noted)
        saves = ["--out", f"{name}.npz", "--json", f"{name}.json", "--report", f"{name}.html"]
        return screen(*calibration(data, name), *saves), results[-1]


SLOW = [pytest.param(name, marks=pytest.mark.slow) for name in ("ur10", "panda", "ur10e")]
"""A camera's calibration fits a screen in `test_camera`, too."""


@pytest.mark.slow
@pytest.mark.parametrize("name", ["ur5", *SLOW])
def test_a_measured_robots_calibration_fits_a_screen_and_its_verdict_names_the_error(
    data_folder: Path, name: str
) -> None:
    lines, _ = calibrated(data_folder, name)
    check(lines)
    held_out = json.loads(Path(f"{name}.json").read_text(encoding="utf-8"))["held_out"]
    assert figure(held_out["best_rms_mm"]) in lines[0] and figure(held_out["nominal_rms_mm"]) in lines[0]
    (step,) = [line for line in lines if line.startswith("next: ")]
    assert f"pickenv apply {name}.npz targets.csv" in step and lines[-1].startswith("more: --details")


@pytest.mark.slow
@pytest.mark.parametrize("name", ["ur5", "ur10e"])
def test_every_number_of_the_details_is_in_the_json_and_on_the_page(data_folder: Path, name: str) -> None:
    _, result = calibrated(data_folder, name)
    told = list(leaves(json.loads(json.dumps(result.as_dict()))))
    words = " ".join(leaf for leaf in told if isinstance(leaf, str))
    shown = {"95", "100"}  # of intervals
    for number in (leaf for leaf in told if isinstance(leaf, int | float)):
        shown |= {f"{number:.2f}", f"{number:.5f}", f"{100 * number:.0f}", f"{100 * number:.1f}", f"{number:g}"}
        shown |= {figure(number), figure(1e3 * number)}
    page = re.sub(r"\s+", " ", Path(f"{name}.html").read_text(encoding="utf-8"))
    for block in result.blocks():
        for cell in (cell for row in block.rows for cell in row):
            numbers = re.findall(r"(?<![\w.])[-+]?\d+\.?\d*(?:e-\d+)?(?!\w)", cell)
            assert [n for n in numbers if n not in shown and n not in words] == [], f"{block.title}: {cell}"
            assert all(n in page for n in numbers)
    assert all(line in result.report().replace("  ", " ") for line in result.summary().splitlines()[:1])


PLAIN = ("--terms", "none", "--residual", "none", "--out", "a.npz")
VERIFY = ("verify", "a.npz", "--columns", "ur5_jacobi2025")
CONDITIONS = ("conditions", "qiao2026", "--arms", 2, "--poses", 20, "--sessions", 2)
EVALUATE = ("evaluate", "--policy", "scripted", "--compensation", "raw", "--compensation", "ls", "--arms", 2,
            "--episodes", 2, "--json", "rows.json")  # fmt: skip


def test_a_calibration_is_verified_on_a_screen(data_folder: Path) -> None:
    screen(*calibration(data_folder, "ur5"), *PLAIN)
    check(lines := screen(*VERIFY, data_folder / UR5.format("random")))
    assert "next: correct targets: pickenv apply a.npz targets.csv --arm ur5 --out commands.csv" in lines


EDGES = "╭─╮│╰╯"


@pytest.mark.slow
def test_on_a_terminal_the_verdict_stands_in_a_panel_and_in_a_pipe_it_is_plain_text(
    data_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    commands: list[tuple[object, ...]] = [(*calibration(data_folder, "ur5"), *PLAIN)]
    commands += [(*VERIFY, data_folder / UR5.format("random"))]
    commands += [("effects", "--reaches", 20), (*CONDITIONS, "--json", "c.json"), EVALUATE]
    for words in commands:
        plain = screen(*words)
        with monkeypatch.context() as patch:
            patch.setattr("rich.console.Console", partial(Console, force_terminal=True, width=WIDTH))
            lines = [re.sub(r"\x1b\[[0-9;]*m", "", line) for line in screen.__wrapped__(*words)]
        assert not set(EDGES) & set("".join(plain)) - {"─"}  # which rich rules tables with
        ends = [i for i, line in enumerate(lines) if line.startswith("╰")]
        assert lines[0].startswith("╭") and len(ends) == 1
        check(lines)  # the border counts
        text = [line.strip(f" {EDGES}") for line in lines[1 : ends[0]]]
        assert (
            re.search(r"\d", " ".join(text[:2])) and lines[0].endswith("╮") and len({*map(len, lines[: ends[0]])}) == 1
        )
        said = " ".join(" ".join(plain).split())
        assert said.startswith(" ".join(" ".join(text).split()))
        assert lines[ends[0] + 1 :] == plain[-(len(lines) - ends[0] - 1) :]


@pytest.mark.slow
def test_simulations_fit_a_screen(folder: Path) -> None:
    check(screen("effects", "--plant", "orchard", "--reaches", 20))
    check(lines := screen(*CONDITIONS, "--json", "c.json"))
    more = screen(*CONDITIONS, "--details")
    assert len(more) > len(lines) and any(line.startswith("Mean error (mm) by payload") for line in more)
    told = json.loads(Path("c.json").read_text(encoding="utf-8"))
    numbers = {f"{leaf:.3f}" for leaf in leaves(told) if isinstance(leaf, float)}
    assert set(re.findall(r"\b\d\.\d{3}\b", " ".join(more))) <= numbers


@pytest.mark.slow
def test_policies_are_compared_on_a_screen_and_each_has_a_line(folder: Path) -> None:
    out = Path("run")
    lines = screen("compare", "scripted", "random", "--episodes", 3, "--grid-step", 0.5, "--out", out)
    check(lines)
    assert "scripted" in lines[0] and f"next: see it: pickenv inspect {out}" in lines
    (wrote,) = [line for line in lines if line.startswith("wrote")]
    assert "report.html" in wrote and all(
        (out / name).exists() for name in re.findall(r"[\w/]+\.\w+", wrote[len(f"wrote {out}: ") :])
    )
    more = screen("compare", "scripted", "random", "--episodes", 3, "--grid-step", 0.5, "--details")
    assert any("median (mm)" in line for line in more) and any(line.startswith("Fruit by fruit") for line in more)


@pytest.mark.slow
def test_one_arm_and_one_reach_are_singular(folder: Path) -> None:
    command = ("evaluate", "--policy", "scripted", "--compensation", "raw", "--arms", 1, "--episodes", 1)
    lines = screen(*command, "--out", "one")
    assert any("1 reach per cell on 1 arm, seed 0" in line for line in lines), lines
    screen("report", "one")
    assert "Final position errors; 1 reach on 1 arm, the same for all" in Path("one/report.html").read_text("utf-8")
    lines = screen("compare", "scripted", "--episodes", 1, "--out", "compared")
    assert any(line.strip().startswith("1 episode of pickenv/") for line in lines), lines


@pytest.mark.slow
def test_many_arms_fit_a_screen(folder: Path) -> None:
    check(screen("evaluate", "--arms", 2, "--episodes", 4))
    root = Path(pickenv.__file__).parents[1]
    lines = screen("study", root / "scripts/tolerance_study.toml", "--quick", "--out", "study")
    check(lines)
    assert any("rows more: --details" in line for line in lines)


def test_an_evaluations_table_has_a_line_for_each_policy_and_plant(folder: Path) -> None:
    lines = screen(*EVALUATE)
    check(lines)
    rows = json.loads(Path("rows.json").read_text(encoding="utf-8"))["rows"]
    for plant in {row["plant"] for row in rows}:
        means = [
            f"{row['mean_mm']:.2f}" for row in rows if row["plant"] == plant and row["gripper"] == rows[0]["gripper"]
        ]
        assert any(re.search(rf"scripted +encoders +{plant} +{' +'.join(means)}", line) for line in lines)
        assert any(line.startswith(f"{plant}: scripted with ls ends nearest, {means[1]} mm") for line in lines)
