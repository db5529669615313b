"""The demonstration's tables on the terminal: every cell is the summary's; what a network gains on blocks held out."""

import re
from pathlib import Path

import numpy as np
import pytest

from pickenv.arm import load_plant
from pickenv.base import InputError, share_interval
from pickenv.calibration import BpnnSettings, error_statistics, fit, random_joints, simulated_tracker
from pickenv.cli import _print_demo
from pickenv.commands.showing import deliver, print_table, progress_bars
from pickenv.experiments.gains import (
    NETWORK,
    ROWS,
    blocked_gains,
    blocks_apart,
    grid_joints,
    left_by_models,
    random_sets,
)
from pickenv.inspect import field_grid

SMOOTH = load_plant("qiao2026")


@pytest.fixture
def grid(monkeypatch):
    """The demonstration's grid, worked out once."""
    found = field_grid(SMOOTH.arm.nominal, 0.093, 20260)
    grids = {(SMOOTH.arm.nominal, 0.093, 20260): found}
    monkeypatch.setattr("pickenv.experiments.gains.field_grid", lambda *asked: grids[asked])
    return found


def summary(reaches):
    rng = np.random.default_rng(0)

    def policy(scale, hits):
        return {
            "position_mm": error_statistics(scale * rng.gamma(4.0, 0.5, reaches)).as_dict(),
            "attitude_deg": error_statistics(0.1 * scale * rng.gamma(4.0, 0.5, reaches)).as_dict(),
            "noncompensable_deg": 0.0312,
            "success_rate": hits / reaches,
            "success_ci95": share_interval(hits, reaches),
        }

    return {
        "policies": {"raw": policy(2.0, 0), "ls": policy(0.5, reaches - 1), "ls_bpnn": policy(0.1, reaches)},
        "identifiability": {"rank": 16, "parameters": 24, "dropped": ["a2"]},
        "blocked": {
            "simulated": [{"arm": "smooth", "ls_mm": 0.5, "removed": 0.75, "lowest": 0.6, "highest": 0.87}],
            "measured": [
                {"arm": "A", "ls_mm": 0.2, "removed": 0.25, "lowest": None, "highest": None},
                {"arm": "B", "ls_mm": 2.0, "removed": -0.05, "lowest": -0.2, "highest": 0.04},
            ],
        },
        "reaches": reaches,
        "plant": "qiao2026",
        "seed": 0,
        "tolerance_mm": 1.0,
        "attitude_tolerance_deg": 10.0,
        "quick": False,
        "matters": ["On qiao2026 this changes no pick.", "On orchard it does."],
    }


@pytest.mark.parametrize("reaches", [100, 19])
def test_every_cell_is_the_summarys(capsys, reaches):
    told = summary(reaches)
    _print_demo(told)
    text = capsys.readouterr().out
    rows = {cells[0]: cells[1:] for line in text.splitlines() if len(cells := re.split(" {3,}", line.strip())) > 1}
    for key, label in (("raw", "raw"), ("ls", "LS"), ("ls_bpnn", "LS+BPNN")):
        found = told["policies"][key]
        mm, (low, high) = found["position_mm"], found["success_ci95"]
        ends = mm["mean_ci95"]
        assert rows[label] == [
            f"{mm['mean']:.3f}",
            "none" if reaches < 20 else f"{ends[0]:.3f} to {ends[1]:.3f}",
            f"{mm['rms']:.3f}",
            f"{mm['p95']:.3f}",
            f"{found['attitude_deg']['mean']:.3f}",
            "0.031",
            f"{100 * found['success_rate']:.0f} ({100 * low:.0f} to {100 * high:.0f})",
        ]
        assert low < high
    words = " ".join(text.split())
    assert "all of this one calibration: intervals are over fruit" in words and "within 1 mm and 10 deg" in words
    for label, cells in {
        "smooth, simulated": ["0.50", "75 (60 to 87)"],
        "A, measured": ["0.20", "25"],
        "B, measured": ["2.00", "-5 (-20 to 4)"],
    }.items():
        assert rows[label] == cells
    assert ("means have none with fewer than 20" in words) == (reaches < 20)


def test_units_in_brackets_stand_in_heads_cells_title_and_caption(capsys: pytest.CaptureFixture[str]) -> None:
    print_table("errors [mm]", ("arm", "mean [mm]"), [("a[0]", "[bold]1.5")], words=("arm",), caption="p95 [deg]")
    said = capsys.readouterr().out
    for words in ("errors [mm]", "mean [mm]", "a[0]", "[bold]1.5", "p95 [deg]"):
        assert words in said


def test_blocks_held_out_are_two_tenths_of_the_file_and_the_rest_is_all_else():
    rng = np.random.default_rng(0)
    joints = random_joints(SMOOTH.arm.nominal, 50, rng)
    rows = simulated_tracker(SMOOTH, joints, rng)
    train, test = blocks_apart(rows, (2, 7))
    held = [10, 11, 12, 13, 14, 35, 36, 37, 38, 39]
    np.testing.assert_array_equal(test.joints, joints[held])
    np.testing.assert_array_equal(train.joints, np.delete(joints, held, axis=0))


def test_the_grid_is_visited_line_by_line_within_the_joints_ranges(grid):
    nominal = SMOOTH.arm.nominal
    joints = grid_joints(nominal, ROWS, np.random.default_rng(0))
    assert joints.shape == (ROWS, 6)
    assert np.all((joints >= nominal.lower) & (joints <= nominal.upper))
    turned = joints - grid.joints[(len(grid.joints) - ROWS) // 2 :][:ROWS]  # the middle of the run
    assert 0.29 < np.abs(turned).max() <= 0.3 + 1e-12 and not turned[:, np.array(nominal.prismatic)].any()
    steps = np.linalg.norm(np.diff(joints[:, [1, 2]], axis=0), axis=1)
    shuffled = np.linalg.norm(np.diff(np.random.default_rng(1).permutation(joints)[:, [1, 2]], axis=0), axis=1)
    assert steps.mean() < 0.5 * shuffled.mean()
    assert len(grid_joints(nominal, len(grid.joints), np.random.default_rng(0))) == len(grid.joints)
    with pytest.raises(InputError, match="ask for no more"):
        grid_joints(nominal, len(grid.joints) + 1, np.random.default_rng(0))


def test_what_a_network_removes_is_of_the_rms_and_of_another_pair_of_blocks_of_each_arm(monkeypatch):
    """Fits whose errors are made up: of arm k the network leaves k / 10 of what least squares does."""
    joints, seen = random_joints(SMOOTH.arm.nominal, 50, np.random.default_rng(0)), []

    def left(arm, train, test, rng, **models):
        seen.append((train, models))
        squares = np.sum((1e-4 * np.sin(np.arange(6.0 * len(test)).reshape(-1, 6)[:, :3])) ** 2, axis=1)
        arms = len(seen)
        return {"LS": squares * arms**2, "LS + BPNN": squares * (0.1 * arms**2) ** 2}, None

    monkeypatch.setattr("pickenv.experiments.gains.left_by_models", left)
    monkeypatch.setattr("pickenv.experiments.gains.ARMS", 7)
    (gain,) = blocked_gains({SMOOTH.name: np.random.SeedSequence(1)}, joints)
    one = 1e3 * np.sqrt(np.mean(np.sum((1e-4 * np.sin(np.arange(60.0).reshape(-1, 6)[:, :3])) ** 2, axis=1)))
    assert (gain.arm, gain.ls_mm) == (SMOOTH.name, pytest.approx(one * 4.0))
    assert (gain.removed, gain.lowest, gain.highest) == pytest.approx((0.6, 0.3, 0.9))
    for k, (train, models) in enumerate(seen):
        held = np.repeat([k % 10, (k + 5) % 10], 5) * 5 + np.tile(range(5), 2)
        np.testing.assert_array_equal(train.joints, np.delete(joints, held, axis=0))
        assert models["learnt"] == {"LS + BPNN": "bpnn"} and models["epochs"] == 50
    assert np.abs(seen[0][0].position[5] - seen[1][0].position[0]).max() > 1e-5  # the same joints of another arm


@pytest.mark.parametrize("network", [True, False])
def test_what_models_leave_is_what_the_papers_calibration_leaves(network):
    """The demonstration's models, fitted by the one function of papers."""
    if network:
        pytest.importorskip("torch")
    rows = random_sets(SMOOTH, (60, 20), np.random.default_rng(3))
    settings = BpnnSettings(epochs=2) if network else None
    models = NETWORK | {"epochs": 2} | ({} if network else {"learnt": {}})
    squares, _ = left_by_models(SMOOTH.arm, *rows, np.random.default_rng(4), **models)
    rng = np.random.default_rng(4)
    found = fit(SMOOTH.arm, rows[0], rows[0] if network else None, rng=rng, settings=settings).calibration
    for name, calibration in {"LS": found.without_residual(), "LS + BPNN": found}.items():
        if name in squares:
            np.testing.assert_array_equal(squares[name], np.sum(calibration.errors(rows[1])[:, :3] ** 2, axis=1))


@pytest.mark.slow
def test_a_smooth_arm_flatters_a_network_and_one_like_measured_arms_does_not():
    pytest.importorskip("torch")
    joints = grid_joints(SMOOTH.arm.nominal, ROWS, np.random.default_rng(0))
    smooth, rough = blocked_gains(dict.fromkeys(("qiao2026", "field"), np.random.SeedSequence(1)), joints)
    for gain in (smooth, rough):
        assert gain.lowest < gain.removed < gain.highest
    assert smooth.removed > rough.removed + 0.2


def test_a_log_file_gets_a_line_as_a_long_stage_begins_now_and_then_and_as_it_ends(capsys, monkeypatch):
    now = [0.0]
    monkeypatch.setattr("pickenv.commands.showing.time.monotonic", lambda: now[0])
    with progress_bars() as report:
        report("drawing", 1, 2)  # nothing for what is over at once
        for second in range(3, 31):
            now[0] = float(second)
            report("fitting", second, 30)
        report("fitting", 30, 30)
    assert capsys.readouterr().err.splitlines() == [f"fitting: {done}/30" for done in (3, 13, 23, 30)]


def test_many_files_of_a_folder_are_one_line_wherever_the_others_are(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    elsewhere = tmp_path / "away.json"
    many = [Path("run/figures") / f"{i}.png" for i in range(9)] + [Path("run/report.html")]
    deliver([(elsewhere, {"a": 1}), (Path("run"), lambda _: many), (Path("few"), lambda _: many[:2])], "good: 1 mm")
    assert capsys.readouterr().out.splitlines() == [
        "good: 1 mm",
        f"wrote {elsewhere}",
        "wrote run: report.html, figures/0.png, figures/1.png, figures/2.png and 6 more",
        "wrote run/figures/0.png",
        "wrote run/figures/1.png",
    ]
