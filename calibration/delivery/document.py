"""Documents that exporters write, with notes on parts of a calibration that they leave out; edits of XML as text."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from operator import itemgetter
from pathlib import Path
from typing import Any
from xml.parsers import expat

from pickenv.arm import Arm, load_arm, shipped_arms
from pickenv.base import InputError, one_line
from pickenv.calibration.model.terms import kind_of_term
from pickenv.calibration.pipeline.calibration import Calibration

# What every file that holds a corrected arm says of where it comes from, and of what it does not hold.


@dataclass(frozen=True, eq=False)
class Document:
    """The content of an exported file.

    Attributes:
        data: Content of the file.
        notes: Sentences that say which parts of the calibration the file holds, and which it does not.
        beside: Contents, by path, of further files that are written with it.
        path: Path of the written file; empty before it is written.
    """

    data: bytes
    notes: tuple[str, ...] = ()
    beside: Mapping[Path, bytes] = field(default_factory=dict)
    path: Path = Path()


@dataclass(frozen=True, eq=False)
class Order:
    """Options of an export, which an exporter gets besides the calibration.

    Attributes:
        out: The file to write.
        onto: The robot's own file; a corrected copy of it is written, in which other entries stay. None for a new file.
        tip: Name of the link at the tip, if the caller named it, as in "robot.urdf#link"; else None.
        arm: The nominal arm, if the caller gave it; else None.
        counts_per_turn: Encoder counts per turn, for tables of offsets.
        sample: Number of arms that are drawn from the calibration's posterior and written beside a new MJCF.
        seed: Seed of these draws.
    """

    out: Path
    onto: Path | None = None
    tip: str | None = None
    arm: Arm | None = None
    counts_per_turn: int | None = None
    sample: int = 0
    seed: int = 0

    def arm_of(self, calibration: Calibration) -> Arm:
        """Return the calibration's arm with its joint speeds, which a calibration does not hold.

        This is `arm`. If `arm` is None, it is the shipped arm with the calibration's name.

        Raises:
            InputError: If another arm was given, or if none was given and no shipped arm equals the calibration's arm.
        """
        arm = self.arm
        if arm is None and calibration.arm_name in shipped_arms():
            shipped = load_arm(calibration.arm_name)
            arm = shipped if shipped.fingerprint() == calibration.arm_fingerprint else None
        if arm is None:
            raise InputError(f"a new arm file tells joint speeds too; give `arm`, the file of '{calibration.arm_name}'")
        calibration.refuse_another(arm)
        return arm


def provenance(calibration: Calibration) -> tuple[str, ...]:
    """Return lines of text on the origin of a corrected arm: arm, data, identified parameters and versions."""
    record = calibration.record
    lines = [
        f"Arm '{calibration.arm_name}' as calibrated by pickenv; do not edit, calibrate again.",
        f"nominal geometry: fingerprint {calibration.arm_fingerprint}",
        f"data: {record.get('source', 'unknown')}, {record.get('poses', '?')} poses ({record.get('kind', '?')}), "
        f"fingerprint {record.get('data_fingerprint', 'unknown')}",
        f"identified parameters: {record.get('rank', '?')}; redundant ones keep their nominal values: "
        + (", ".join(record.get("dropped", {})) or "none"),
    ]
    versions: Mapping[str, Any] = record.get("versions", {})
    if versions:
        lines.append("versions: " + ", ".join(f"{name} {value}" for name, value in versions.items()))
    return (*lines, *left_out(calibration, "not in this file, because no geometry can hold it"))


def left_out(calibration: Calibration, words: str = "not in the file, because no geometry can hold it") -> list[str]:
    """Return a sentence that names the terms and the learnt residual, which files of rigid links cannot hold.

    The sentence is the only item of a list. The list is empty if the calibration has neither.

    Args:
        calibration: The calibration.
        words: Beginning of the sentence.
    """
    names = [kind_of_term(term) for term in calibration.model.terms]
    if calibration.learnt is not None:
        names.append(f"learnt residual '{calibration.learnt.kind}'")
    return [f"{words}: {', '.join(names)}"] if names else []


def xml_comment(lines: Iterable[str]) -> list[str]:
    """Return the lines of an XML comment that holds ``lines``."""
    return ["<!--", *(re.sub("-(?=-)", "- ", one_line(line)) for line in lines), "-->"]


# Editing XML as text: attributes of start tags are replaced, and every other byte stays as it is. Nothing is parsed
# and written again, so comments, order, spaces, quotes and line ends are kept.


TO_TAG_END = re.compile(rb"""(?:[^>"']|"[^"]*"|'[^']*')*>""")
"""Pattern that matches up to the ``>`` that ends a tag, past any ``>`` within quotes."""
ATTRIBUTE = re.compile(rb"""\s+([^\s=/>]+)\s*=\s*("[^"]*"|'[^']*')""")


@dataclass(frozen=True)
class StartTag:
    """The start tag of an element in an XML text.

    Attributes:
        name: Name of the element.
        attributes: Values of its attributes by name.
        start: Index in the text of the tag's first byte, its ``<``.
        end: Index of the byte after its ``>``.
        parent: Index, in the list of `start_tags`, of the enclosing element; None for the root.
    """

    name: str
    attributes: Mapping[str, str]
    start: int
    end: int
    parent: int | None

    def is_named(self, kind: str, name: str) -> bool:
        """Return whether the element's tag is ``kind`` and its attribute "name" equals ``name``."""
        return self.name == kind and self.attributes.get("name") == name


Edit = tuple[int, int, bytes]
"""A change of a text: start and end of the bytes that are replaced, and the bytes that replace them."""


def start_tags(data: bytes) -> list[StartTag]:
    """Return the start tag of every element of an XML text in UTF-8, in the text's order.

    Raises:
        xml.parsers.expat.ExpatError: If the text is no XML.
    """
    tags: list[StartTag] = []
    around: list[int] = []
    parser = expat.ParserCreate("utf-8")

    def start(name: str, attributes: dict[str, str]) -> None:
        first = parser.CurrentByteIndex
        text = TO_TAG_END.match(data, first)
        end = len(data) if text is None else text.end()
        tags.append(StartTag(name, attributes, first, end, around[-1] if around else None))
        around.append(len(tags) - 1)

    parser.StartElementHandler = start
    parser.EndElementHandler = lambda _: around.pop()
    parser.Parse(data, True)
    return tags


def attribute_spans(data: bytes, tag: StartTag) -> tuple[dict[str, tuple[int, int, int]], int]:
    """Find the attributes of a start tag in an XML text.

    Args:
        data: The text.
        tag: The tag.

    Returns:
        A dictionary and an index. The dictionary holds for each attribute's name three indices in the text: the start
        of the attribute, and start and end of its value within the quotes. The index is the end of the last
        attribute.
    """
    after = tag.start + 1 + len(tag.name.encode())
    spans: dict[str, tuple[int, int, int]] = {}
    while (match := ATTRIBUTE.match(data, after)) is not None:
        spans[match[1].decode()] = (match.start(1), match.start(2) + 1, match.end(2) - 1)
        after = match.end()
    return spans, after


def attribute_edits(data: bytes, tag: StartTag, values: Mapping[str, str]) -> list[Edit]:
    """Return the edits that set attributes of a start tag; attributes that the tag lacks are added at the tag's end.

    Args:
        data: The text.
        tag: The tag.
        values: The new values by the attributes' names.
    """
    spans, after = attribute_spans(data, tag)
    new = "".join(f' {name}="{value}"' for name, value in values.items() if name not in spans)
    edits = [(*spans[name][1:], value.encode()) for name, value in values.items() if name in spans]
    return [*edits, (after, after, new.encode())] if new else edits


def inserted_first(data: bytes, tag: StartTag, element: str) -> Edit:
    """Return the edit that inserts an element after a start tag, with the line break and indent that follow the tag.

    A tag that closes itself is opened, and an end tag follows the element.
    """
    if data[: tag.end].endswith(b"/>"):
        return tag.end - 2, tag.end, f">{element}</{tag.name}>".encode()
    after = data[tag.end :]
    return tag.end, tag.end, after[: len(after) - len(after.lstrip())] + element.encode()


def inserted_before(data: bytes, tag: StartTag, *elements: str) -> Edit:
    """Return the edit that inserts elements before a start tag, each on a line with the tag's indent."""
    before = data[: tag.start]
    gap = before[len(before.rstrip()) :]
    return tag.start, tag.start, b"".join(element.encode() + gap for element in elements)


def edited(data: bytes, edits: Iterable[Edit]) -> bytes:
    """Apply edits to a text, and return the new text."""
    parts, after = [], 0
    for start, end, new in sorted(edits, key=itemgetter(0)):
        parts += [data[after:start], new]
        after = end
    return b"".join([*parts, data[after:]])
