"""An HTML report in a page of Chromium: what it asks for, what it says, and whether all of it can be read."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

READY = """() => !document.querySelector(".interactive") || document.documentElement.dataset.interactive === "ready" """
PATIENCE_MS = 120_000.0
PAPER = {"width": 710, "height": 1040}
"""A4 without the margins of 11 mm, CSS pixels."""

# What reaches beyond the right edge, other than what scrolls inside a frame of its own.
SIDEWAYS = """() => [...document.querySelectorAll("body, body *")]
    .filter(e => e.getClientRects().length && !e.closest("svg, .interactive"))
    .filter(e => e.getBoundingClientRect().right > document.documentElement.clientWidth + 1)
    .filter(e => !e.parentElement.closest(".scroll, figure"))
    .map(e => e.outerHTML.slice(0, 120))"""
# What is cut off, or would have to be scrolled.
CLIPPED = """() => [...document.querySelectorAll(".scroll, figure, table, dl, pre")]
    .filter(e => e.getClientRects().length)
    .filter(e => e.scrollWidth > e.clientWidth + 1
        || e.getBoundingClientRect().right > document.documentElement.clientWidth + 1)
    .map(e => e.outerHTML.slice(0, 120))"""
BROKEN_IMAGES = """() => [...document.images].filter(i => !i.complete || !i.naturalWidth).map(i => i.alt)"""
# Text with less contrast than WCAG 2 asks at level AA: 4.5, or 3 where it is large.
FAINT = """() => {
  const parse = c => (c.match(/[\\d.]+/g) || []).map(Number);
  const light = c => { const [r, g, b] = parse(c).map(v => v / 255)
    .map(v => v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4); return 0.2126 * r + 0.7152 * g + 0.0722 * b; };
  const ground = e => { for (; e; e = e.parentElement) { const c = getComputedStyle(e).backgroundColor;
    if (parse(c).length && parse(c)[3] !== 0) return c; } return "rgb(255, 255, 255)"; };
  const found = [];
  for (const e of document.querySelectorAll("body *")) {
    const own = [...e.childNodes].some(n => n.nodeType === 3 && n.textContent.trim());
    if (!own || !e.getClientRects().length || e.closest("script, style, .interactive")) continue;
    const ink = getComputedStyle(e)[e.ownerSVGElement ? "fill" : "color"];
    if (parse(ink).length < 3) continue;
    const [a, b] = [light(ink), light(ground(e))].sort((x, y) => y - x), contrast = (a + 0.05) / (b + 0.05);
    const style = getComputedStyle(e), large = parseFloat(style.fontSize) >= (style.fontWeight >= 600 ? 18.66 : 24);
    if (contrast < (large ? 3.0 : 4.5)) found.push(`${e.textContent.trim().slice(0, 40)}: ${contrast.toFixed(1)}`);
  }
  return found; }"""


@dataclass(frozen=True)
class Report:
    """A report as a reader sees it.

    Attributes:
        page: Playwright's page.
        asked: Every address that the page asked for.
        complaints: Errors of its scripts and of its console.
    """

    page: Any
    asked: list[str] = field(default_factory=list)
    complaints: list[str] = field(default_factory=list)

    def hovered(self) -> str:
        """What the label under the pointer says, lines joined; empty where there is none."""
        return " ".join(self.page.locator(".hovertext text").all_text_contents())


@contextmanager
def open_report(browser: Any, path: Path, **options: Any) -> Iterator[Report]:
    """Open the file ``path`` and wait until its figures have come alive, or something has failed.

    Args:
        browser: Playwright's browser.
        path: The report.
        options: Of playwright's `Browser.new_context`: viewport, color_scheme.
    """
    context = browser.new_context(**options)
    report = Report(context.new_page())
    report.page.on("request", lambda request: report.asked.append(request.url))
    report.page.on("pageerror", lambda error: report.complaints.append(str(error)))
    report.page.on(
        "console", lambda message: report.complaints.append(message.text) if message.type == "error" else None
    )
    try:
        report.page.goto(path.resolve().as_uri(), timeout=PATIENCE_MS)
        end = time.monotonic() + PATIENCE_MS / 1e3
        while not (report.page.evaluate(READY) or report.complaints):
            assert time.monotonic() < end, "the figures did not come alive"
            report.page.wait_for_timeout(200.0)
        yield report
    finally:
        context.close()
