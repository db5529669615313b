"""The report of a comparison of policies: what each compensation is worth, every cell with its interval, figures."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pickenv.agents.evaluation.grid_figures import grid_drawings
from pickenv.agents.evaluation.grid_tables import HEADS, cells_of, gain_words, interval_words, read_grid
from pickenv.inspect.colours import policy_label
from pickenv.inspect.figures.run_drawings import Drawings
from pickenv.inspect.reports.plain_report import plain_report
from pickenv.inspect.reports.report_page import PageTable, PageVerdict
from pickenv.inspect.runs.run_folder import Run, TakePicture

CELLS = ("policy", "calibration", "feedback", "plant", "gripper", *HEADS)
GAINS = ("policy", "feedback", "plant", "from", "to", "difference (mm)", "95 % (mm)", "significant")


def drawings(run: Run) -> Drawings:
    """The figures of a comparison's run folder."""
    return grid_drawings(read_grid(run))


def page(run: Run, picture: TakePicture | None = None) -> str:
    """The page of a comparison's run folder."""
    grid = read_grid(run)
    rows, worth = grid.rows(), grid.comparisons()
    first, best = rows[0], min(rows, key=lambda row: row["mean_mm"])
    raw = [line for line in worth if line["from"] == "raw"]
    helped = [line for line in raw if line["significant"] and line["difference_mm"] < 0.0]
    verdict = PageVerdict(
        "note",
        f"Best: {best['policy']} with {policy_label(best['compensation'])}, {best['mean_mm']:.2f} mm",
        f"{best['policy']} with {best['feedback']} and {policy_label(best['compensation'])} on {best['plant']} ends "
        f"{best['mean_mm']:.3f} mm from the fruit in the mean ({_evidence(best)}). "
        f"Of {len(raw)} comparisons of a calibration with the raw arm, {len(helped)} show a gain that is significant.",
    )
    cells = [cells_of(row | {"compensation": policy_label(row["compensation"])}) for row in rows]
    gains = [
        (
            *(line["policy"], line["feedback"], line["plant"], policy_label(line["from"]), policy_label(line["to"])),
            *gain_words(line),
        )
        for line in worth
    ]
    tables = (
        PageTable(
            f"Final position errors; {first['episodes'] // (first['trainings'] or 1)} reaches on {first['arms']} arms, "
            "the same for all. Mean, median and 95th percentile are over arms, in brackets and beside the mean 95 % "
            "intervals; those of one training say nothing of another one",
            CELLS,
            cells,
        ),
        PageTable(
            "What each calibration changes on the same arms and fruit, pair by pair; 95 % intervals over arms, and "
            "over trainings where there are several",
            GAINS,
            gains,
        ),
    )
    subtitle = (
        f"Simulated; arms of tolerance class {grid.settings.tolerances} that no policy was trained on, seed "
        f"{grid.settings.seed}"
    )
    return plain_report(run, "Comparison of policies", subtitle, verdict, tables, grid_drawings(grid))


def _evidence(row: Mapping[str, Any]) -> str:
    said = interval_words(row["ci95"], 3)
    return f"95 % interval over {row['interval_over']}: {said}" if said else f"no interval: {row['no_interval']}"
