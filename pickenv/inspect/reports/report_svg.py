"""Matplotlib figures as parts of a page: one SVG that takes the page's colours and font, light, dark or printed."""

from __future__ import annotations

import io
import re
from dataclasses import dataclass

from markupsafe import Markup
from matplotlib.figure import Figure

from pickenv.inspect.figures.style import THEME, style

PIXELS_PER_POINT, LEAST_PIXELS_PER_POINT = 1.75, 1.1
"""Sizes at which a figure's text is as large as the page's, and still legible: a small screen scrolls then."""


@dataclass(frozen=True)
class InlineSvg:
    """The inside of an SVG element.

    Attributes:
        content: Markup within the element.
        width: Of its own coordinates, points.
        height: Likewise.
    """

    content: Markup
    width: float
    height: float

    @property
    def widest(self) -> int:
        """Width on a page that has room, pixels."""
        return round(self.width * PIXELS_PER_POINT)

    @property
    def narrowest(self) -> int:
        """Width at which its text is still legible, pixels."""
        return round(self.width * LEAST_PIXELS_PER_POINT)


def inline_svg(figure: Figure, name: str) -> InlineSvg:
    """The figure for an HTML page.

    Args:
        figure: The figure, drawn in the house's style.
        name: Goes before its ids, so that several figures share a page.
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
        text = text.replace(colour, f"var({variable})")
    text = re.sub(r"\s*\n\s*", "\n", text)
    width, height = re.search(r'viewBox="0 0 ([\d.]+) ([\d.]+)"', text).groups()  # type: ignore[union-attr]
    inside = text[text.index(">") + 1 : text.rindex("</svg>")].strip()
    return InlineSvg(Markup(inside), float(width), float(height))
