"""Verdicts on what a paper states, and the page that shows them: paper, ours, why they differ, and a verdict.

``reproduced``: what the paper states comes out of our run; ``fitted``: a constant of ours was chosen so that it does;
``not reproduced``: it does not, or nobody could say. A reason with figures stands beside each.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from pickenv.base import versions, write_text
from pickenv.commands.showing import print_table
from pickenv.inspect.colours import as_sentence, named_values
from pickenv.inspect.reports.report_page import PageTable, PageVerdict, Part, Section, html_of

REPRODUCED, NOT, FITTED = "reproduced", "not reproduced", "fitted"
KINDS = ("tables", "equations", "claims", "figures", "experiments")
Columns = Mapping[str, str | Callable[[Any], str]]
"""Columns of a table by their heads: the key of a row's value, or a function that makes the cell of a row."""


def word(holds: bool) -> str:
    """The verdict on what holds or does not."""
    return REPRODUCED if holds else NOT


def judged(verdict: str | bool, reason: str, rows: Sequence[Mapping[str, Any]], **more: Any) -> dict[str, Any]:
    """A table with its verdict, as it goes into JSON."""
    return {
        "verdict": verdict if isinstance(verdict, str) else word(verdict),
        "reason": reason,
        "rows": list(rows),
    } | more


def said(name: str, part: Mapping[str, Any]) -> str:
    """A title with its verdict."""
    return f"{name}: {part['verdict'].upper()}. {part['reason']}"


def titled(result: Mapping[str, Any], number: str, text: str) -> str:
    """The caption of a figure with its verdict."""
    return f"Figure {number} ({result['figures'][number]['verdict']}): {text}"


def headline(result: Mapping[str, Any]) -> str:
    """How many of tables, equations and figures came out again."""
    kinds = [kind for kind in KINDS if kind in result]
    verdicts = [part["verdict"] for kind in kinds for part in result[kind].values()]
    return (
        f"Of {len(verdicts)} {', '.join(kinds[:-1])} and {kinds[-1]} {verdicts.count(REPRODUCED)} are reproduced, "
        f"{verdicts.count(FITTED)} fitted, {verdicts.count(NOT)} not reproduced"
    )


def cell(value: Any, form: str = ".5g") -> str:
    """A number, a span, or words."""
    if isinstance(value, list | tuple):
        return ", ".join(cell(part, form) for part in value)
    return "–" if value is None else format(value, form) if isinstance(value, float) else str(value)


def table(caption: str, rows: Sequence[Any], columns: Columns | None = None, form: str = ".5g") -> PageTable:
    """A table of rows: every value of theirs unless ``columns`` says which; numbers in ``form``."""
    columns = columns or {key.replace("_", " "): key for key in rows[0]}
    cells = [
        [cell(row[part], form) if isinstance(part, str) else part(row) for part in columns.values()] for row in rows
    ]
    return PageTable(caption, list(columns), cells, "dense" if len(columns) > 8 else "")


def print_tables(parts: Sequence[Part]) -> None:
    """Print every table."""
    for part in parts:
        assert isinstance(part, PageTable)
        words = [head for i, head in enumerate(part.heads) if part.in_words(i)]
        print_table(part.caption, part.heads, [map(str, row) for row in part.rows], words=words)


def write_page(
    path: Path,
    title: str,
    lead: str,
    result: Mapping[str, Any],
    notes: Sequence[str],
    sections: Sequence[Section],
    made_by: Mapping[str, str],
) -> Path:
    """Write the page of a paper: the headline with its notes, the sections, and how to make it again."""
    verdict = PageVerdict("note", headline(result), as_sentence("\n".join(notes)))
    facts = {**made_by, "Versions": named_values(versions())}
    sections = [replace(s, parts=[p.spelled() if isinstance(p, PageTable) else p for p in s.parts]) for s in sections]
    return write_text(path, html_of(title, lead, verdict, sections, facts, contents=True))
