"""Screens: at most 25 lines of 100 characters, the verdict with its number first; the rest in details and JSON."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console
from typer.testing import CliRunner

import pickenv
from pickenv.cli import app

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


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder to work in."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def screen(*words: object, width: int = WIDTH) -> list[str]:
    """The lines that a command prints where COLUMNS is this width."""
    done = CliRunner().invoke(app, [str(word) for word in words], env={"COLUMNS": str(width)})
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


@pytest.mark.parametrize("name", ["ur5", "ur10", pytest.param("panda", marks=pytest.mark.slow), "ur10e"])
def test_a_measured_robots_calibration_fits_a_screen_and_its_verdict_names_the_error(
    data_folder: Path, name: str
) -> None:
    saves = ["--out", "arm.npz", "--json", "arm.json", "--report", "page.html"]
    lines = screen(*calibration(data_folder, name), *saves)
    check(lines)
    held_out = json.loads(Path("arm.json").read_text(encoding="utf-8"))["held_out"]
    assert figure(held_out["best_rms_mm"]) in lines[0] and figure(held_out["nominal_rms_mm"]) in lines[0]
    (step,) = [line for line in lines if line.startswith("next: ")]
    assert "pickenv apply arm.npz targets.csv" in step and lines[-1].startswith("more: --details")


@pytest.mark.parametrize("name", ["ur5", pytest.param("ur10e", marks=pytest.mark.slow)])
def test_every_number_of_the_details_is_in_the_json_and_on_the_page(data_folder: Path, name: str) -> None:
    options, pattern = SETS[name]
    (file,) = data_folder.glob(pattern)
    result = pickenv.calibrate(options[1], [file], columns=[options[3].format(data_folder)])
    told = list(leaves(json.loads(json.dumps(result.as_dict()))))
    words = " ".join(leaf for leaf in told if isinstance(leaf, str))
    shown = {"95", "100"}  # of intervals
    for number in (leaf for leaf in told if isinstance(leaf, int | float)):
        shown |= {f"{number:.2f}", f"{number:.5f}", f"{100 * number:.0f}", f"{100 * number:.1f}", f"{number:g}"}
        shown |= {figure(number), figure(1e3 * number)}
    page = re.sub(r"\s+", " ", result.write_page("page.html").read_text(encoding="utf-8"))
    for block in result.blocks():
        for cell in (cell for row in block.rows for cell in row):
            numbers = re.findall(r"(?<![\w.])[-+]?\d+\.?\d*(?:e-\d+)?(?!\w)", cell)
            assert [n for n in numbers if n not in shown and n not in words] == [], f"{block.title}: {cell}"
            assert all(n in page for n in numbers)
    assert all(line in result.report().replace("  ", " ") for line in result.summary().splitlines()[:1])


def test_a_calibration_is_verified_on_a_screen(data_folder: Path) -> None:
    screen(*calibration(data_folder, "ur5"), "--terms", "none", "--residual", "none", "--out", "a.npz")
    file = data_folder / UR5.format("random")
    check(lines := screen("verify", "a.npz", file, "--columns", "ur5_jacobi2025"))
    assert "next: correct targets: pickenv apply a.npz targets.csv --arm ur5 --out commands.csv" in lines


EDGES = "╭─╮│╰╯"


def test_on_a_terminal_the_verdict_stands_in_a_panel_and_in_a_pipe_it_is_plain_text(
    data_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    saves = ["--terms", "none", "--residual", "none", "--out", "arm.npz"]
    verify = ["verify", "arm.npz", data_folder / UR5.format("random"), "--columns", "ur5_jacobi2025"]
    sizes = ("--arms", 2, "--poses", 20, "--sessions", 2)
    few = ("--policy", "scripted", "--compensation", "raw", "--compensation", "ls", "--arms", 2, "--episodes", 2)
    commands: list[list[object]] = [[*calibration(data_folder, "ur5"), *saves], verify]
    commands += [["effects", "--reaches", 20], ["conditions", "qiao2026", *sizes], ["evaluate", *few]]
    for words in commands:
        plain = screen(*words)
        with monkeypatch.context() as patch:
            patch.setattr("rich.console.Console", partial(Console, force_terminal=True, width=WIDTH))
            lines = [re.sub(r"\x1b\[[0-9;]*m", "", line) for line in screen(*words)]
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


def test_simulations_fit_a_screen(folder: Path) -> None:
    check(screen("effects", "--plant", "orchard", "--reaches", 20))
    sizes = ("--arms", 2, "--poses", 20, "--sessions", 2)
    check(lines := screen("conditions", "qiao2026", *sizes, "--json", "c.json"))
    more = screen("conditions", "qiao2026", *sizes, "--details")
    assert len(more) > len(lines) and any(line.startswith("Mean error (mm) by payload") for line in more)
    told = json.loads(Path("c.json").read_text(encoding="utf-8"))
    numbers = {f"{leaf:.3f}" for leaf in leaves(told) if isinstance(leaf, float)}
    assert set(re.findall(r"\b\d\.\d{3}\b", " ".join(more))) <= numbers


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
def test_many_arms_fit_a_screen(folder: Path) -> None:
    check(screen("evaluate", "--arms", 2, "--episodes", 4))
    root = Path(pickenv.__file__).parents[1]
    lines = screen("study", root / "scripts/tolerance_study.toml", "--quick", "--out", "study")
    check(lines)
    assert any("rows more: --details" in line for line in lines)


def test_an_evaluations_table_has_a_line_for_each_policy_and_plant(folder: Path) -> None:
    few = ("--policy", "scripted", "--compensation", "raw", "--compensation", "ls", "--arms", 2, "--episodes", 2)
    lines = screen("evaluate", *few, "--json", "rows.json")
    check(lines)
    rows = json.loads(Path("rows.json").read_text(encoding="utf-8"))["rows"]
    for plant in {row["plant"] for row in rows}:
        means = [
            f"{row['mean_mm']:.2f}" for row in rows if row["plant"] == plant and row["gripper"] == rows[0]["gripper"]
        ]
        assert any(re.search(rf"scripted +encoders +{plant} +{' +'.join(means)}", line) for line in lines)
        assert any(line.startswith(f"{plant}: scripted with ls ends nearest, {means[1]} mm") for line in lines)
