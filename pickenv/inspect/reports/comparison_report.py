"""Figures and page of a comparison of policies: which is better, by how much and where, and whether picks change."""

from __future__ import annotations

from functools import partial

from pickenv.base import count_of
from pickenv.inspect.colours import TEXTS, as_sentence, in_words
from pickenv.inspect.figures import plot_policies
from pickenv.inspect.figures.plot_errors import error_fields
from pickenv.inspect.figures.run_drawings import Drawing, Drawings, captioned
from pickenv.inspect.reports.report_page import PageTable, PageVerdict, plain_report
from pickenv.inspect.runs import comparison_summary as summary
from pickenv.inspect.runs.comparison_summary import change_cells
from pickenv.inspect.runs.recorded_episodes import Comparison, RecordedEpisodes
from pickenv.inspect.runs.run_folder import Run, TakePicture, load_part

MISSING = "the environment takes no goals in options, so a policy cannot be asked for a grid of them"


def drawings(run: Run) -> Drawings:
    """Return the figures of a comparison's run."""
    return policy_drawings(load_part(run, RecordedEpisodes))


def policy_drawings(episodes: RecordedEpisodes) -> Drawings:
    """Return the figures of a comparison of policies; a figure that cannot be drawn has the reason instead."""
    drawings = [captioned("distance_over_time", plot_policies.distance_over_time, episodes)]
    if not isinstance(episodes, Comparison):
        return [*drawings, Drawing("error_fields", MISSING)]
    drawings.append(Drawing("error_fields", TEXTS["captions"]["final_misses"], partial(error_fields, episodes)))
    if len(episodes.policies) > 1:
        drawings.append(captioned("difference_map", plot_policies.difference_map, episodes))
    return drawings


def page(run: Run, picture: TakePicture | None = None) -> str:
    """Return the page of a comparison's run as HTML; ``picture`` is not used."""
    episodes = load_part(run, RecordedEpisodes)
    enough = any(row["ci95_mm"] is not None for row in summary.policy_rows(episodes))
    intervals = summary.INTERVALS if enough else summary.NO_INTERVAL
    caption = f"Miss where the gripper closed, attitude at the end, and fruit picked by {episodes.gripper}; {intervals}"
    tables = [PageTable(caption, summary.HEADS, summary.policy_cells(episodes)).spelled()]
    if lines := summary.difference_cells(episodes):
        caption = "Fruit by fruit, the later policy minus the earlier one; of shares picked Newcombe's paired interval"
        tables.append(PageTable(caption, summary.DIFFERENCES, lines).spelled())
    if changed := summary.policy_changes(episodes):
        shares = f"taken, {changed['from']} (%)", f"{changed['to']} (%)"
        caption = "Share of fruit taken, by gripper and by how well the fruit is seen (standard deviation)"
        heads = ("gripper", "fruit seen to, per axis (mm)", *shares, "change (points of %)")
        tables.append(PageTable(caption, heads, [change_cells(change) for change in changed["changes"]]).spelled())
    headline, text = map(as_sentence, (summary.outcome_sentence(episodes), summary.explanation(episodes)))
    verdict = PageVerdict("note", headline, text)
    plant = f" on the plant {in_words(episodes.plant_name)}" if episodes.plant_name else ""
    subtitle = (
        f"Simulated; {count_of(len(episodes.seeds), 'episode')} of {episodes.env_id}{plant}, the same for all policies"
    )
    return plain_report(run, "Comparison of policies", subtitle, verdict, tables, policy_drawings(episodes))
