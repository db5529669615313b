"""The report of a comparison of policies: who is better, by how much and where, and whether it matters."""

from __future__ import annotations

from pickenv.inspect.figures import plot_policies
from pickenv.inspect.figures.field_figure import error_fields
from pickenv.inspect.figures.run_drawings import Drawing, Drawings, NotDrawn
from pickenv.inspect.reports.plain_report import plain_report
from pickenv.inspect.reports.report_page import PageTable, PageVerdict
from pickenv.inspect.runs import episode_summary
from pickenv.inspect.runs.comparison_summary import Comparison
from pickenv.inspect.runs.recorded_episodes import RecordedEpisodes
from pickenv.inspect.runs.run_folder import Run, TakePicture, load_comparison

MISSING = "the environment takes no goals in options, so a policy cannot be asked for a grid of them"


def drawings(run: Run) -> Drawings:
    """The figures of a comparison's run folder."""
    return policy_drawings(*load_comparison(run))


def policy_drawings(episodes: RecordedEpisodes, comparison: Comparison | None) -> Drawings:
    """Every figure of a comparison of policies."""
    found: list[Drawing | NotDrawn] = [
        Drawing(
            "distance_over_time",
            "Distance between tool and fruit in every episode, and what the gripper forgives.",
            lambda: plot_policies.distance_over_time(episodes),
        ),
        Drawing(
            "misses_by_fruit",
            "Where the gripper closed, how far each policy was from the fruit; the same fruit for all.",
            lambda: plot_policies.misses_by_fruit(episodes),
        ),
    ]
    if comparison is None:
        return [*found, NotDrawn("error_fields", MISSING)]
    found.append(
        Drawing(
            "error_fields",
            "Where each policy misses, and which way: its final miss for a grid of goals, drawn larger than true.",
            lambda: error_fields(comparison),
        )
    )
    if len(comparison.policies) > 1:
        found.append(
            Drawing(
                "difference_map",
                "Which of two policies misses less at each goal, in layers of the workspace seen from above.",
                lambda: plot_policies.difference_map(comparison),
            )
        )
    return found


def page(run: Run, picture: TakePicture | None = None) -> str:
    """The page of a comparison's run folder."""
    episodes, comparison = load_comparison(run)
    rows, lines = episode_summary.policy_rows(episodes), episode_summary.policy_differences(episodes)
    enough = any(row["ci95_mm"] is not None for row in rows)
    said = episode_summary.INTERVALS if enough else episode_summary.NO_INTERVAL
    tables = [
        PageTable(
            f"Miss where the gripper closed, attitude at the end, and fruit picked by {episodes.gripper}; {said}",
            episode_summary.HEADS,
            [episode_summary.row_cells(row) for row in rows],
        )
    ]
    if lines:
        tables.append(
            PageTable(
                "Fruit by fruit, the later policy minus the earlier one; of shares picked Newcombe's paired interval",
                episode_summary.DIFFERENCES,
                [episode_summary.difference_cells(line) for line in lines],
            )
        )
    if changed := episode_summary.change_table(episodes):
        tables.append(
            PageTable(
                "Share of fruit taken, by gripper and by how well the fruit is seen (standard deviation)", *changed
            )
        )
    verdict = PageVerdict("note", episode_summary.outcome_sentence(episodes), episode_summary.explanation(episodes))
    plant = f" on the plant {episodes.plant}" if episodes.plant else ""
    subtitle = f"Simulated; {len(episodes.seeds)} episodes of {episodes.env_id}{plant}, the same for all policies"
    return plain_report(run, "Comparison of policies", subtitle, verdict, tables, policy_drawings(episodes, comparison))
