"""The page of `reproduce_li2016.py`: paper and ours side by side, each table and figure with its verdict."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from papers.verdicts import headline, said
from rich.console import Console
from rich.table import Table

from pickenv.files import write_text
from pickenv.inspect.figures.run_drawings import Drawing
from pickenv.inspect.reports.report_page import Page, PageTable, PageVerdict, Section, html_of
from pickenv.inspect.reports.report_words import named_values
from pickenv.provenance import versions

NOTES = (
    "An apple machine: a master arm that carries three slave arms with cups. All of ours is simulated.",
    "Table 2 is exact for a slave spacing of 450 mm, while text and Table 1 say 350 and the start points imply 300.",
    "Table 1's d2 is the height of frame 3, and its d4 a displacement; read so, the work height is that of the text.",
    "The machine sees with stereo eyes of its own: what it misses and how far off it is are outputs, read off rendered "
    "pictures. Which leaves hung in the lab is not said; ours has none (canopy li2016_bare), which is assumed.",
    "The comparison of strategies (report.html) starts from the paper's rules with their misprints mended: as printed, "
    "eqs (7) to (12) leave most fruit out of reach.",
)
TITLES = {
    "tables": {"1": "work height (mm)", "2": "joint displacements (rad, mm)", "3": "tip errors (mm)"},
    "figures": {
        "2": "the area that the machine is made for",
        "5": "segmentation, step by step",
        "8": "workspace (mm)",
        "9": "ends of the joint curves (rad, mm)",
    },
}
"""What tables and figures show."""


def cell(value: Any) -> str:
    """A number, a span, or words."""
    if value is None:
        return "–"
    if isinstance(value, (list, tuple)):
        return ", ".join(cell(each) for each in value)
    return f"{value:.5g}" if isinstance(value, float) else str(value)


def rows_of(rows: Sequence[Mapping[str, Any]]) -> tuple[list[str], list[list[str]]]:
    """Heads and cells."""
    return [key.replace("_", " ") for key in rows[0]], [[cell(v) for v in row.values()] for row in rows]


def li_sections(result: Mapping[str, Any]) -> list[tuple[str, list[PageTable]]]:
    """Sections with their tables: every table, equation, figure and the experiment with its rows and verdict."""
    found = []
    for kind, titles in TITLES.items():
        named = f"{kind[:-1].capitalize()} "
        tables = [
            PageTable(said(f"{named}{name}, {title}", result[kind][name]), *rows_of(result[kind][name]["rows"]))
            for name, title in titles.items()
        ]
        found.append((kind.capitalize(), tables))
    every = {name: part for name, part in result["equations"].items() if name != "pick points"}
    heads = ["equation", "as printed it misses by (mm)", "corrected (mm)", "misprint, or what it holds for", "verdict"]
    rows = [[*(cell(v) for v in part["rows"][0].values()), part["verdict"]] for part in every.values()]
    points = result["equations"]["pick points"]
    equations = [
        PageTable("Equations (1) to (12) against the machine's own kinematics", heads, rows),
        PageTable(said("Pick points by eqs (7)-(12), as printed and corrected", points), *rows_of(points["rows"])),
    ]
    experiment, seen = (result["experiments"][name] for name in ("46 of 56", "own eyes"))
    prediction = [
        PageTable(said("Apples recovered of 56", experiment), *rows_of(experiment["rows"])),
        PageTable("The open constants, drawn anew for every session", *rows_of(experiment["constants"])),
        PageTable(said("Apples recovered with the machine's own eyes", seen), *rows_of(seen["rows"])),
    ]
    return [found[0], ("Equations", equations), ("The experiment", prediction), found[1]]


def print_li_tables(console: Console, result: Mapping[str, Any]) -> None:
    """Print every table."""
    for _, tables in li_sections(result):
        for part in tables:
            shown = Table(*part.heads, title=part.caption, title_justify="left")
            for row in part.rows:
                shown.add_row(*map(str, row))
            console.print(shown)
    console.print(headline(result))


def write_li_page(result: Mapping[str, Any], drawings: Sequence[Drawing], command: str, path: Path) -> Path:
    """Write the page with the paper's own figures."""
    sections = [Section(title, tables) for title, tables in li_sections(result)]
    sections[-1] = Section("Figures", [*sections[-1].parts, *drawings])
    page = Page(
        "Li et al. 2016, reproduced in simulation",
        "An apple machine with three slave arms: the paper beside ours, and why they differ",
        PageVerdict("note", headline(result), "\n".join(NOTES)),
        sections,
        {"Reproduce": command, "Versions": named_values(versions())},
        contents=True,
    )
    return write_text(path, html_of(page))
