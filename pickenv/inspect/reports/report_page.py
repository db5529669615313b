"""Parts of a report page: verdict, tiles, tables, figures, facts; one HTML file that needs nothing from outside."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from html import escape

from pickenv.inspect.figures.run_drawings import Drawing
from pickenv.inspect.reports.report_style import STYLE
from pickenv.inspect.reports.report_svg import inline_svg

TONES = ("good", "care", "bad", "note")
"""The last for what is neither good nor bad: no requirement was stated."""


@dataclass(frozen=True)
class Verdict:
    """What a reader should take away.

    Attributes:
        tone: One of `TONES`.
        headline: The verdict in a few words.
        text: What it rests on, in sentences with numbers.
    """

    tone: str
    headline: str
    text: str


def page(title: str, sections: Iterable[str], scripts: str = "") -> str:
    """The page; empty sections are left out.

    Args:
        title: For the browser's tab.
        sections: HTML of each section.
        scripts: HTML that goes last.
    """
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)}</title>\n<style>{STYLE}</style>\n</head>\n<body>\n"
        "<main>\n" + "\n".join(section for section in sections if section) + f"\n</main>\n{scripts}</body>\n</html>\n"
    )


def verdict_box(verdict: Verdict, findings: Sequence[str] = ()) -> str:
    """The verdict, first on the page; further findings as a list."""
    listed = "".join(f"<li>{escape(finding)}</li>" for finding in findings)
    return (
        f'<div class="verdict {verdict.tone}"><strong>{escape(verdict.headline)}</strong><p>{escape(verdict.text)}</p>'
        + (f"<ul>{listed}</ul>" if listed else "")
        + "</div>"
    )


def tiles(values: Mapping[str, str]) -> str:
    """Large figures in a row; keys say what they are."""
    cells = "".join(f'<div class="tile"><b>{escape(v)}</b><span>{escape(k)}</span></div>' for k, v in values.items())
    return f'<div class="tiles">{cells}</div>'


def section(title: str, name: str, *parts: str, explain: str = "") -> str:
    """A section with a heading; ``name`` is its anchor."""
    said = f'<p class="explain">{escape(explain)}</p>' if explain else ""
    return f'<section id="{name}"><h2>{escape(title)}</h2>{said}' + "".join(parts) + "</section>"


def contents(sections: Mapping[str, str]) -> str:
    """Links to sections, by anchor."""
    links = "".join(f'<a href="#{name}">{escape(title)}</a>' for name, title in sections.items())
    return f'<nav aria-label="contents">{links}</nav>'


def table(caption: str, heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table whose first column names the rows.

    Args:
        caption: What it shows, with units.
        heads: Column names.
        rows: Cells, as text.
    """
    head = "".join(f'<th scope="col"{" class=words" if i == 0 else ""}>{escape(h)}</th>' for i, h in enumerate(heads))
    body = "".join(
        f'<tr><th scope="row" class=words>{escape(first)}</th>'
        + "".join(f"<td>{escape(c)}</td>" for c in rest)
        + "</tr>"
        for first, *rest in rows
    )
    return (
        f'<div class="scroll" tabindex="0" role="region" aria-label="{escape(caption)}"><table>'
        f"<caption>{escape(caption)}</caption><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>"
    )


def drawn(drawing: Drawing) -> str:
    """A figure with its caption."""
    picture = inline_svg(drawing.draw(), drawing.name, drawing.caption)
    return f"<figure>{picture}<figcaption>{escape(drawing.caption)}</figcaption></figure>"


def pair(*parts: str) -> str:
    """Parts side by side where there is room."""
    return f'<div class="pair">{"".join(parts)}</div>'


def facts(values: Mapping[str, str]) -> str:
    """A list of names and values."""
    lines = "".join(f"<dt>{escape(name)}</dt><dd>{escape(value)}</dd>" for name, value in values.items())
    return f"<dl>{lines}</dl>"
