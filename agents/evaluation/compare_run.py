"""A comparison of policies as a run folder: every episode, the table, one recording, one page, its figures."""

from __future__ import annotations

from pathlib import Path

from pickenv.agents.evaluation.compare import PolicyComparison
from pickenv.files import write_json, write_text
from pickenv.inspect.runs.episode_summary import content_of_comparison
from pickenv.inspect.runs.run_folder import REPORT, recorded_run, save_part

SUMMARY, RECORDING = "comparison.json", "comparison.rrd"


def write_comparison(found: PolicyComparison, folder: Path) -> list[Path]:
    """Write the run folder, for `pickenv inspect`, `report`, `figures` and for further comparisons.

    Raises:
        InputError: If it cannot be written.
    """
    from pickenv.inspect.figures.run_drawings import write_drawings
    from pickenv.inspect.recordings.policy_recording import record_policies
    from pickenv.inspect.reports.comparison_report import page, policy_drawings

    episodes, comparison = found.episodes, found.comparison
    with recorded_run(folder, "comparison", found.command, episodes.seed) as run:
        written = [save_part(folder, episodes, episodes.seed)]
        if comparison is not None:
            written.append(save_part(folder, comparison, episodes.seed))
        written.append(write_json(folder / SUMMARY, content_of_comparison(episodes)))
        written += write_drawings(policy_drawings(episodes, comparison), folder / "figures", ("png",))
        written.append(record_policies(episodes, comparison, folder / RECORDING))
        written.append(write_text(folder / REPORT, page(run)))
    return written
