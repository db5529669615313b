"""The content of reports as data, and their rendering by templates as one HTML file without outside resources.

The templates escape every text, and change nothing else in it. A page is light or dark like the reader's screen, and
fit for print.
"""

from __future__ import annotations

import base64
import gzip
import io
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from importlib import import_module
from importlib.resources import files
from pathlib import Path
from typing import Any, TypeAlias

from jinja2 import Environment, FileSystemLoader, StrictUndefined, Template
from markupsafe import Markup
from matplotlib.figure import Figure

from pickenv.calibration.assessment.screen import is_number
from pickenv.inspect.colours import in_words, named_values
from pickenv.inspect.figures.run_drawings import Drawing, Drawings
from pickenv.inspect.figures.style import THEME, style
from pickenv.inspect.runs.run_folder import Run, TakePicture, run_kind

PIXELS_PER_POINT, LEAST_PIXELS_PER_POINT = 1.75, 1.1
"""Largest and smallest scale of a figure, px per point. At the largest scale, its text is as large as the page's. At
the smallest scale, its text is just legible. If there is less room than for this scale, the figure scrolls."""
HERE = Path(__file__).parent / "templates"


@dataclass(frozen=True)
class PageVerdict:
    """The verdict at the top of a page.

    Attributes:
        tone: Colour of the verdict: ``good``, ``care`` or ``bad``; ``note`` for runs without a stated requirement.
        headline: The verdict in a few words.
        text: Reasons for the verdict, in sentences with numbers; a paragraph per line.
        findings: Further findings: the weight of each (fail, caution or note), and a sentence.
    """

    tone: str
    headline: str
    text: str
    findings: Sequence[tuple[str, str]] = ()


Bar: TypeAlias = tuple[float, float, float]
"""A bar with a whisker of two standard deviations: value, standard deviation, and the limit (±) of the scale."""


def bar_place(value: float, limit: float) -> float:
    """Return the horizontal position of a value on a bar's drawing, which is 120 units wide.

    Zero is at 60, ``limit`` at 116, and minus ``limit`` at 4. Values beyond these limits are drawn at the limits.
    """
    return 60.0 + 56.0 * min(max(value / limit, -1.0), 1.0)


@dataclass(frozen=True)
class PageTable:
    """A table whose first column names the rows. Columns of numbers are aligned to the right.

    Attributes:
        caption: What the table shows, with units.
        heads: Column names with units; empty for a table without a head.
        rows: Cells of each row: words, numbers as text, or bars.
        look: CSS class of the table. ``code`` if the first column holds names of parameters. ``wide`` if the second
            holds sentences. ``close`` or ``dense`` if there are many or very many columns. Empty for none.
    """

    caption: str
    heads: Sequence[str]
    rows: Sequence[Sequence[str | Bar]]
    look: str = ""

    def in_words(self, column: int) -> bool:
        """Return whether the column with the index ``column``, from 0, holds words.

        The first column counts as words, and so does any column whose cells are mostly not numbers.
        """
        cells = [cell for row in self.rows if (cell := row[column])]
        return column == 0 or 2 * sum(not isinstance(cell, str) or is_number(cell) for cell in cells) < len(cells)

    def spelled(self) -> PageTable:
        """Return the table with the short names of models and grippers in all its texts spelled out (`in_words`)."""
        rows = [[in_words(cell) if isinstance(cell, str) else cell for cell in row] for row in self.rows]
        return replace(self, caption=in_words(self.caption), heads=[*map(in_words, self.heads)], rows=rows)


Part: TypeAlias = "str | PageTable | Drawing | bytes | Section | tuple[Part, ...] | Mapping[str, str] | None"
"""A part of a section: paragraph, table, figure, picture (WebP), section that opens on demand (and is open on paper),
parts side by side where there is room, or names with values. Empty parts are left out."""


@dataclass(frozen=True)
class Section:
    """A part of a page with a heading.

    Attributes:
        title: Heading.
        parts: The parts below the heading.
        explain: How to read the section; shown below the heading.
    """

    title: str
    parts: Sequence[Part]
    explain: str = ""

    @property
    def anchor(self) -> str:
        """Anchor (HTML id) of the section on the page."""
        return "-".join("".join(c if c.isalnum() else " " for c in self.title.lower()).split())


def html_of(
    title: str,
    subtitle: str,
    verdict: PageVerdict,
    sections: Sequence[Section],
    origin: Mapping[str, str],
    tiles: Mapping[str, str] | None = None,
    *,
    contents: bool = False,
) -> str:
    """Return a report as HTML.

    Args:
        title: Heading, and title of the browser's tab.
        subtitle: One line that says what was run or measured.
        verdict: The verdict, at the top of the page.
        sections: The evidence; an empty section is left out.
        origin: Facts needed to make the report again, by name.
        tiles: Numbers that are shown large in a row, as text, by their description.
        contents: Whether links to the sections follow below the large numbers.
    """
    return _template().render(
        title=title,
        subtitle=subtitle,
        verdict=verdict,
        tiles=tiles,
        contents=contents,
        shown=[section for section in (*sections, Section("Origin", (dict(origin),))) if any(section.parts)],
        live=any(isinstance(part, Drawing) and part.spec for section in sections for part in section.parts),
    )


@cache
def _template() -> Template:
    environment = Environment(
        loader=FileSystemLoader(HERE), autoescape=True, trim_blocks=True, lstrip_blocks=True, undefined=StrictUndefined
    )
    environment.policies["json.dumps_kwargs"] = {"separators": (",", ":"), "allow_nan": False}
    scales = {"largest": PIXELS_PER_POINT, "least": LEAST_PIXELS_PER_POINT}
    environment.globals.update(library=library, bar_place=bar_place, **scales)
    environment.filters.update(
        base64=lambda content: base64.b64encode(content).decode(),
        drawn=lambda drawing: inline_svg(drawing.draw(), drawing.name),
        kind=lambda part: type(part).__name__,
        source=lambda name: Markup((HERE / name).read_text(encoding="utf-8")),
    )
    return environment.get_template("page.html")


def inline_svg(figure: Figure, name: str) -> tuple[Markup, float, float]:
    """Return a figure for an HTML page: the inside of an SVG element, its width and its height in points.

    The figure's colours are replaced by CSS variables of the page.

    Args:
        figure: The figure, drawn in pickenv's style.
        name: Prefix of the figure's ids, so that several figures can share a page.
    """
    buffer = io.StringIO()
    undated = dict.fromkeys(("Date", "Creator", "Format", "Type"))
    with style(**{"svg.fonttype": "none"}):
        figure.savefig(buffer, format="svg", transparent=True, metadata=undated)
    text = buffer.getvalue()
    text = re.sub(r"<metadata>.*?</metadata>|<style.*?</style>|<!--.*?-->", "", text[text.index("<svg") :], flags=re.S)
    text = re.sub(r'\bid="', f'id="{name}-', text)
    text = re.sub(r'href="#', f'href="#{name}-', text)
    text = text.replace("url(#", f"url(#{name}-")
    for colour, variable in THEME.items():
        text = text.replace(colour, f"var(--{variable})")
    text = re.sub(r"\s*\n\s*", "\n", text)
    width, height = re.search(r'viewBox="0 0 ([\d.]+) ([\d.]+)"', text).groups()  # type: ignore[union-attr]
    return Markup(text[text.index(">") + 1 : text.rindex("</svg>")].strip()), float(width), float(height)


@cache
def library() -> str:
    """Return Plotly's library as gzip in base64, for pages with interactive figures."""
    plotly = (files("plotly") / "package_data" / "plotly.min.js").read_bytes()
    return base64.b64encode(gzip.compress(plotly, 9, mtime=0)).decode()


def plain_report(
    run: Run, title: str, subtitle: str, verdict: PageVerdict, tables: Sequence[PageTable], drawings: Drawings
) -> str:
    """Return a page with a verdict, tables, figures and the run's origin, as HTML.

    Args:
        run: The run.
        title: Heading.
        subtitle: One line that says what was run.
        verdict: The verdict, at the top of the page.
        tables: The numbers.
        drawings: Figures. A figure that cannot be drawn is named with the reason.
    """
    sections = (
        Section("Numbers", tables),
        Section("Figures", [d for d in drawings if d.draw is not None]),
        Section("Left out", ["; ".join(f"{d.name}: {d.caption}" for d in drawings if d.draw is None)]),
    )
    origin = {"Reproduce": run.command, "Seed": str(run.seed), "Versions": named_values(run.versions)}
    return html_of(title, subtitle, verdict, sections, origin)


def drawings_of(run: Run) -> Drawings:
    """Return all figures of a run; a figure that cannot be drawn has the reason instead."""
    return list(_pages(run).drawings(run))


def page_of(run: Run, picture: TakePicture | None = None) -> str:
    """Return a run's report as HTML.

    Args:
        run: The run.
        picture: Function that draws the run's recording, such as `viewer_picture`; no picture is shown when left out.
    """
    return str(_pages(run).page(run, picture))


def _pages(run: Run) -> Any:
    """Return the module with the figures and the page of a run's kind."""
    return import_module(run_kind(run.kind).pages)


def axis_table(
    caption: str, stages: Mapping[str, Mapping[str, tuple[float, ...]]], say: Callable[[float], str]
) -> PageTable:
    """Return a table of errors per axis (degree of freedom), with four columns for each stage of calibration.

    Args:
        caption: Caption of the table.
        stages: For each stage (raw, LS and so on), by label, the mean, standard deviation, RMS and maximum of its
            errors, by the axis's name.
        say: Function that formats a number as text.
    """
    heads = ["axis", *(f"{label} {statistic}" for label in stages for statistic in ("mean", "std", "RMSE", "max"))]
    rows = []
    for axis in next(iter(stages.values())):
        rows.append([axis])
        for axes in stages.values():
            mean, *others = axes[axis]
            rows[-1] += ["+" * (mean >= 0.0) + say(mean), *map(say, others)]
    return PageTable(caption, heads, rows, "dense")
