"""Reports of runs that are tables and figures, such as a harvester's or a comparison of policies."""

from __future__ import annotations

from collections.abc import Sequence

from pickenv.inspect.figures.run_drawings import Drawing, Drawings
from pickenv.inspect.reports.report_page import Page, PageTable, PageVerdict, Section, html_of
from pickenv.inspect.reports.report_words import named_values
from pickenv.inspect.runs.run_folder import Run


def plain_report(
    run: Run, title: str, subtitle: str, verdict: PageVerdict, tables: Sequence[PageTable], drawings: Drawings
) -> str:
    """A page of a verdict, tables, figures and the run's origin.

    Args:
        run: The run.
        title: Heading.
        subtitle: What was run, in a line.
        verdict: Goes first.
        tables: Its numbers.
        drawings: Figures; those left out are named with their reason.
    """
    left_out = "; ".join(f"{d.name}: {d.reason}" for d in drawings if not isinstance(d, Drawing))
    sections = (
        Section("Numbers", tables),
        Section("Figures", [d for d in drawings if isinstance(d, Drawing)]),
        Section("Left out", [left_out]),
    )
    origin = {"Reproduce": run.command, "Seed": str(run.seed), "Versions": named_values(run.versions)}
    return html_of(Page(title, subtitle, verdict, sections, origin))
