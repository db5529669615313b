"""Matplotlib figures as parts of a page: one SVG that takes the page's colours and font, light, dark or printed."""

from __future__ import annotations

import io
import re
from html import escape
from typing import TYPE_CHECKING

from pickenv.inspect.colours import BLUE, GREEN, RED
from pickenv.inspect.figures.style import INK, PAPER, RULE, SOFT, style

if TYPE_CHECKING:
    from matplotlib.figure import Figure

THEME = {INK: "--ink", SOFT: "--soft", RULE: "--rule", PAPER: "--paper"} | {
    "#{:02x}{:02x}{:02x}".format(*colour): variable
    for colour, variable in ((BLUE, "--after"), (GREEN, "--best"), (RED, "--bad"))
}
"""Colours of figures that the page's style sheet replaces; all others are legible on both backgrounds."""

PIXELS_PER_POINT, LEAST_PIXELS_PER_POINT = 1.75, 1.1
"""Sizes at which a figure's text is as large as the page's, and still legible: a small screen scrolls then."""


def inline_svg(figure: Figure, name: str, label: str) -> str:
    """The figure as an SVG element for an HTML page.

    Args:
        figure: The figure, drawn in the house's style.
        name: Goes before its ids, so that several figures share a page.
        label: What it shows, for those who do not see it.
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
    width = float(re.search(r'viewBox="0 0 ([\d.]+)', text)[1])  # type: ignore[index]
    viewbox = re.search(r'viewBox="[^"]+"', text)[0]  # type: ignore[index]
    content = text[text.index(">") + 1 :].strip()
    sizes = f"max-width:{width * PIXELS_PER_POINT:.0f}px;min-width:{width * LEAST_PIXELS_PER_POINT:.0f}px"
    return f'<svg class="drawn" role="img" aria-label="{escape(label)}" {viewbox} style="{sizes}">{content}'
