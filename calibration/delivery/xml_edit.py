"""Editing XML as text: attributes of start tags are replaced, and every other byte stays as it is.

Nothing is parsed and written again, so comments, order, spaces, quotes and line ends are kept.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from xml.parsers import expat

ATTRIBUTE = re.compile(rb"""\s+([^\s=/>]+)\s*=\s*("[^"]*"|'[^']*')""")


@dataclass(frozen=True)
class StartTag:
    """Where an element starts in a text.

    Attributes:
        name: Of the element.
        attributes: By name.
        start: First byte, its ``<``.
        end: The byte after its ``>``.
        parent: Place of the element around it in `start_tags`; None for the root.
    """

    name: str
    attributes: Mapping[str, str]
    start: int
    end: int
    parent: int | None


@dataclass(frozen=True)
class Edit:
    """Bytes ``start`` to ``end`` are replaced by ``new``."""

    start: int
    end: int
    new: bytes


def start_tags(data: bytes) -> list[StartTag]:
    """Every element of an XML text in UTF-8, in its order.

    Raises:
        xml.parsers.expat.ExpatError: If it is no XML.
    """
    found: list[StartTag] = []
    around: list[int] = []
    parser = expat.ParserCreate("utf-8")

    def start(name: str, attributes: dict[str, str]) -> None:
        first = parser.CurrentByteIndex
        found.append(StartTag(name, attributes, first, _end(data, first), around[-1] if around else None))
        around.append(len(found) - 1)

    parser.StartElementHandler = start
    parser.EndElementHandler = lambda _: around.pop()
    parser.Parse(data, True)
    return found


def _end(data: bytes, start: int) -> int:
    """The byte after the ``>`` of a tag; one within quotes is none."""
    quote = b""
    for place in range(start, len(data)):
        byte = data[place : place + 1]
        if quote:
            quote = b"" if byte == quote else quote
        elif byte in (b'"', b"'"):
            quote = byte
        elif byte == b">":
            return place + 1
    return len(data)


def attribute_spans(data: bytes, tag: StartTag) -> tuple[dict[str, tuple[int, int, int]], int]:
    """Where each attribute of a tag starts, its value starts and ends; and where the last one ends."""
    after = tag.start + 1 + len(tag.name.encode())
    spans: dict[str, tuple[int, int, int]] = {}
    while (one := ATTRIBUTE.match(data, after)) is not None:
        spans[one[1].decode()] = (one.start(1), one.start(2) + 1, one.end(2) - 1)
        after = one.end()
    return spans, after


def attribute_edits(data: bytes, tag: StartTag, values: Mapping[str, str]) -> list[Edit]:
    """What gives attributes of a tag new values; one that it lacks is added behind its others."""
    spans, after = attribute_spans(data, tag)
    new = "".join(f' {name}="{value}"' for name, value in values.items() if name not in spans)
    found = [Edit(*spans[name][1:], value.encode()) for name, value in values.items() if name in spans]
    return [*found, Edit(after, after, new.encode())] if new else found


def inserted_first(data: bytes, tag: StartTag, element: str) -> Edit:
    """What puts an element right behind a start tag, on a line as the next one has it."""
    rest = data[tag.end :]
    return Edit(tag.end, tag.end, rest[: len(rest) - len(rest.lstrip())] + element.encode())


def edited(data: bytes, edits: Iterable[Edit]) -> bytes:
    """The text with all its edits."""
    parts, after = [], 0
    for edit in sorted(edits, key=lambda edit: edit.start):
        parts += [data[after : edit.start], edit.new]
        after = edit.end
    return b"".join([*parts, data[after:]])
