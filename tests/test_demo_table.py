"""The demonstration's table on the terminal: every cell is the summary's, and it says what it is of."""

import numpy as np
import pytest

from pickenv.calibration import error_statistics
from pickenv.cli import _print_demo
from pickenv.commands.showing import print_table
from pickenv.intervals import share_interval


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
        "reaches": reaches,
        "plant": "qiao2026",
        "seed": 0,
        "tolerance_mm": 1.0,
        "attitude_tolerance_deg": 10.0,
    }


@pytest.mark.parametrize("reaches", [100, 19])
def test_every_cell_is_the_summarys(capsys, reaches):
    told = summary(reaches)
    _print_demo(told, [])
    text = capsys.readouterr().out
    rows = {
        cells[1].strip(): [c.strip() for c in cells[2:-1]]
        for line in text.splitlines()
        if len(cells := line.split("│")) > 3
    }
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
            f"{100 * found['success_rate']:.0f} % ({100 * low:.0f} to {100 * high:.0f})",
        ]
        assert low < high
    words = " ".join(text.split())
    assert "all of this one calibration: intervals are over fruit" in words and "within 1 mm and 10 deg" in words
    assert ("means have none with fewer than 20" in words) == (reaches < 20)


def test_units_in_brackets_stand_in_heads_cells_title_and_caption(capsys: pytest.CaptureFixture[str]) -> None:
    print_table("errors [mm]", ("arm", "mean [mm]"), [("a[0]", "[bold]1.5")], words=("arm",), caption="p95 [deg]")
    said = capsys.readouterr().out
    for words in ("errors [mm]", "mean [mm]", "a[0]", "[bold]1.5", "p95 [deg]"):
        assert words in said
