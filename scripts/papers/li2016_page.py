"""The page of `reproduce_li2016.py`: paper and ours side by side, each table and figure with its verdict."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from papers.verdicts import headline, said

from pickenv.files import write_text
from pickenv.inspect.figures.run_drawings import Drawing
from pickenv.inspect.reports.report_page import Page, PageTable, PageVerdict, Section, html_of
from pickenv.inspect.reports.report_words import named_values
from pickenv.provenance import versions

NOTES = (
    "An apple machine: a master arm that carries three slave arms with cups. All of ours is simulated.",
    "Table 2 is exact for a slave spacing of 450 mm, while text and Table 1 say 350 and the start points imply 300.",
    "Eq (6) with a principal arctangent lands on the wrong branch for all three of the targets; ours is wrapped.",
    "Table 1's d2 is the height of frame 3, and its d4 a displacement; read so, the work height is that of the text.",
)
TITLES = {
    "tables": {
        "1": "Table 1, work height (mm)",
        "2": "Table 2, joint displacements (rad, mm)",
        "3": "Table 3, tip errors (mm)",
    },
    "equations": {"7-12": "Equations (7)-(12), pick points"},
    "figures": {"8": "Figure 8, workspace (mm)", "9": "Figure 9, ends of the joint curves (rad, mm)"},
    "experiments": {"46 of 56": "The experiment, apples recovered"},
}


def cell(value: Any) -> str:
    """A number, a span, or words."""
    if value is None:
        return "none"
    if isinstance(value, (list, tuple)):
        return ", ".join(cell(each) for each in value)
    return f"{value:.5g}" if isinstance(value, float) else str(value)


def tables(result: Mapping[str, Any]) -> list[PageTable]:
    """Every table, equation, figure and experiment with its rows."""
    found = []
    for kind, titles in TITLES.items():
        for name, title in titles.items():
            part = result[kind][name]
            heads = [key.replace("_", " ") for key in part["rows"][0]]
            found.append(PageTable(said(title, part), heads, [[cell(v) for v in row.values()] for row in part["rows"]]))
    return found


def write_li_page(result: Mapping[str, Any], drawings: Sequence[Drawing], command: str, path: Path) -> Path:
    """Write the page; of the run's figures it shows those that the paper has."""
    shown = [drawing for drawing in drawings if drawing.name in ("workspace", "joint_curves")]
    page = Page(
        "Li et al. 2016, reproduced in simulation",
        "The paper's tables beside ours, and why they differ",
        PageVerdict("note", headline(result), "\n".join(NOTES)),
        (Section("Tables", tables(result)), Section("Figures", shown)),
        {"Reproduce": command, "Versions": named_values(versions())},
    )
    return write_text(path, html_of(page))
