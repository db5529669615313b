"""Figures and page of a comparison of harvesting strategies."""

from __future__ import annotations

from pickenv.base import count_of
from pickenv.base.intervals import LEAST
from pickenv.harvester import Measure
from pickenv.harvester.machine import dense_workspace
from pickenv.inspect.colours import TEXTS, said
from pickenv.inspect.figures import plot_harvest
from pickenv.inspect.figures.run_drawings import Drawing, Drawings, captioned
from pickenv.inspect.reports.report_page import PageTable, PageVerdict, plain_report
from pickenv.inspect.runs.run_folder import Run, TakePicture, load_part
from pickenv.inspect.runs.traces import HarvestTrace

MEASURES = TEXTS["measures"]
"""Description and unit of each measure, by the measure's key."""


def drawings(run: Run) -> Drawings:
    """Return the figures of a harvester's run: the arms' work on a tree, fates of fruit, throughput, workspace."""
    trace = load_part(run, HarvestTrace)
    caption = f"From fruit present to fruit collected, over {trace.tree_count} simulated trees."
    trees = {name: trace.trees[name] for name in (next(iter(trace.trees)), list(trace.trees)[-1])}
    return [
        captioned("gantt", plot_harvest.gantt, trees, trace.cloud.shape[1]),
        captioned("pick_map", plot_harvest.pick_map, trees),
        Drawing("funnel", caption, lambda: plot_harvest.funnel_bars(trace.funnels)),
        captioned("throughput", plot_harvest.throughput_by_arms, trace.throughput),
        captioned("workspace", plot_harvest.workspace_cloud, trace.cloud, (dense_workspace(),)),
        captioned("joint_curves", plot_harvest.joint_displacements, *trace.curves),
    ]


def page(run: Run, picture: TakePicture | None = None) -> str:
    """Return the page of a harvester's run as HTML; ``picture`` is not used."""
    trace = load_part(run, HarvestTrace)
    names = list(trace.measures)
    before, after = (trace.measures[name] for name in (names[0], names[-1]))
    shares = [_words(measures["harvested"], 1, 100.0, " %") for measures in (before, after)]
    verdict = PageVerdict(
        "note",
        f"From {names[0]} to {names[-1]}: {100 * before['harvested'].value:.0f} to "
        f"{100 * after['harvested'].value:.0f} % of the fruit",
        f"On {trace.tree_count} simulated trees, {names[0]} collects {shares[0]} of the fruit present at "
        f"{_words(before['picks_per_hour'], 0)} picks per hour, {names[-1]} {shares[1]} at "
        f"{_words(after['picks_per_hour'], 0)}. {_intervals(trace)}",
    )
    looks = {key: (1, 100.0) if "(%)" in MEASURES.get(key, "") else (3, 1.0) for key in before}
    rows = [
        (MEASURES.get(key, key), *(_words(measures[key], *looks[key]) for measures in trace.measures.values()))
        for key in before
    ]
    measures = PageTable(f"Measures of each strategy. {_intervals(trace)}", ("measure", *trace.measures), rows)
    funnels = trace.funnels
    counts = [(stage, *(str(numbers[stage]) for numbers in funnels.values())) for stage in funnels[names[0]]]
    funnel = PageTable("Fruit at each stage, over all trees", ("stage", *funnels), counts)
    subtitle = f"Simulated; {count_of(trace.cloud.shape[1], 'picking arm')}, {len(names)} strategies on the same trees"
    return plain_report(run, "Harvesting", subtitle, verdict, (measures, funnel), drawings(run))


def _intervals(trace: HarvestTrace) -> str:
    if trace.tree_count < LEAST:
        return f"No intervals: {trace.tree_count} trees are fewer than {LEAST}."
    return "In brackets: 95 % intervals over trees."


def _words(measure: Measure, digits: int, scale: float = 1.0, unit: str = "") -> str:
    return said(measure.value, (measure.low, measure.high), digits, scale, unit=unit)
