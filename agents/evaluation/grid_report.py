"""The report of a comparison of policies: what each compensation is worth, every cell with its interval, figures."""

from __future__ import annotations

from pickenv.agents.evaluation.grid import Grid
from pickenv.agents.evaluation.grid_figures import LABELS, grid_drawings
from pickenv.inspect.reports import report_page as page
from pickenv.inspect.reports.plain_report import plain_report
from pickenv.inspect.reports.report_page import Verdict
from pickenv.inspect.runs.run_folder import Run


def grid_report(run: Run, grid: Grid) -> str:
    """The page of a comparison's run folder."""
    rows, worth = grid.rows(), grid.comparisons()
    best = min(rows, key=lambda row: row["mean_mm"])
    raw = [line for line in worth if line["from"] == "raw"]
    helped = [line for line in raw if line["significant"] and line["difference_mm"] < 0.0]
    verdict = Verdict(
        "note",
        f"Best: {best['policy']} with {LABELS[best['compensation']]}, {best['mean_mm']:.2f} mm",
        f"{best['policy']} with {best['feedback']} and {LABELS[best['compensation']]} on {best['plant']} ends "
        f"{best['mean_mm']:.3f} mm from the fruit in the mean (95 % interval over arms {best['ci95'][0]:.3f} to "
        f"{best['ci95'][1]:.3f}). Of {len(raw)} comparisons of a calibration with the raw arm, {len(helped)} show a "
        f"gain that is significant.",
    )
    heads = [
        "policy",
        "calibration",
        "feedback",
        "plant",
        "gripper",
        "mean (mm)",
        "95 %",
        "p95 (mm)",
        "success",
        "cycle (s)",
    ]
    cells = page.table(
        f"Final position errors; {rows[0]['episodes']} reaches per cell on {rows[0]['arms']} arms, the same for all",
        heads,
        [
            [
                row["policy"],
                LABELS[row["compensation"]],
                row["feedback"],
                row["plant"],
                row["gripper"],
                f"{row['mean_mm']:.3f}",
                f"{row['ci95'][0]:.3f} to {row['ci95'][1]:.3f}",
                f"{row['p95_mm']:.3f}",
                f"{100 * row['success_rate']:.1f} %",
                "never" if row["cycle_s"] is None else f"{row['cycle_s']:.1f}",
            ]
            for row in rows
        ],
    )
    gains = page.table(
        "What each calibration changes on the same arms and fruit, pair by pair; 95 % intervals over arms",
        ["policy", "feedback", "plant", "from", "to", "difference (mm)", "95 %", "significant"],
        [
            [
                line["policy"],
                line["feedback"],
                line["plant"],
                LABELS[line["from"]],
                LABELS[line["to"]],
                f"{line['difference_mm']:+.3f}",
                f"{line['ci95'][0]:+.3f} to {line['ci95'][1]:+.3f}",
                "yes" if line["significant"] else "no",
            ]
            for line in worth
        ],
    )
    subtitle = (
        f"Simulated; arms of tolerance class {grid.settings.tolerances} that no policy was trained on, seed "
        f"{grid.settings.seed}"
    )
    return plain_report(run, "Comparison of policies", subtitle, verdict, [cells, gains], grid_drawings(grid))
