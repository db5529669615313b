"""Documents that hold a corrected arm: bytes, and what they do not hold of a calibration; XML edited as text."""

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
from pickenv.calibration.pipeline.calibration import Calibration

# What every file that holds a corrected arm says of where it comes from, and of what it does not hold.


@dataclass(frozen=True, eq=False)
class Document:
    """A file to be written.

    Attributes:
        data: Its bytes.
        notes: What it holds of a calibration, and what it does not, a sentence each.
        beside: Bytes of files that are written with it.
        path: Where it was written; empty before.
    """

    data: bytes
    notes: tuple[str, ...] = ()
    beside: Mapping[Path, bytes] = field(default_factory=dict)
    path: Path = Path()


@dataclass(frozen=True, eq=False)
class Order:
    """An order to an exporter, beside the calibration.

    Attributes:
        out: The file to write.
        onto: The robot's own file, in which only what the calibration corrects is changed; None for a new file.
        tip: The link named behind it.
        arm: The arm, where it was given.
        counts_per_turn: Encoder counts per turn, for tables of offsets.
        sample: Arms that the data allow, written beside a new MJCF.
        seed: Of the sample.
    """

    out: Path
    onto: Path | None = None
    tip: str | None = None
    arm: Arm | None = None
    counts_per_turn: int | None = None
    sample: int = 0
    seed: int = 0

    def arm_of(self, calibration: Calibration) -> Arm:
        """The calibration's arm, whose joint speeds no calibration holds; a shipped one is found by its name.

        Raises:
            InputError: If it is no shipped arm and none was given, or another one was.
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
    """The origin of a corrected arm, one fact per line."""
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
    """Parts of a calibration that files of rigid links cannot hold, terms and residual, named behind ``words``."""
    names = [type(term).__name__ for term in calibration.model.terms]
    if calibration.learnt is not None:
        names.append(f"learnt residual '{calibration.learnt.kind}'")
    return [f"{words}: {', '.join(names)}"] if names else []


def xml_comment(lines: Iterable[str]) -> list[str]:
    """Lines of a comment in XML."""
    return ["<!--", *(one_line(line).replace("--", "- -") for line in lines), "-->"]


# Editing XML as text: attributes of start tags are replaced, and every other byte stays as it is. Nothing is parsed
# and written again, so comments, order, spaces, quotes and line ends are kept.


TO_TAG_END = re.compile(rb"""(?:[^>"']|"[^"]*"|'[^']*')*>""")
"""To the ``>`` of a tag; one within quotes is none."""
ATTRIBUTE = re.compile(rb"""\s+([^\s=/>]+)\s*=\s*("[^"]*"|'[^']*')""")


@dataclass(frozen=True)
class StartTag:
    """The start of an element in a text.

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

    def is_named(self, kind: str, name: str) -> bool:
        """Whether it is an element of this kind with this ``name``."""
        return self.name == kind and self.attributes.get("name") == name


Edit = tuple[int, int, bytes]
"""Bytes from the first to the second place are replaced by the third."""


def start_tags(data: bytes) -> list[StartTag]:
    """Every element of an XML text in UTF-8, in its order.

    Raises:
        xml.parsers.expat.ExpatError: If it is no XML.
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
    """Starts of each attribute of a tag and of its value, and the value's end; and the end of the last one."""
    after = tag.start + 1 + len(tag.name.encode())
    spans: dict[str, tuple[int, int, int]] = {}
    while (match := ATTRIBUTE.match(data, after)) is not None:
        spans[match[1].decode()] = (match.start(1), match.start(2) + 1, match.end(2) - 1)
        after = match.end()
    return spans, after


def attribute_edits(data: bytes, tag: StartTag, values: Mapping[str, str]) -> list[Edit]:
    """Edits that give attributes of a tag new values; one that it lacks is added behind its others."""
    spans, after = attribute_spans(data, tag)
    new = "".join(f' {name}="{value}"' for name, value in values.items() if name not in spans)
    edits = [(*spans[name][1:], value.encode()) for name, value in values.items() if name in spans]
    return [*edits, (after, after, new.encode())] if new else edits


def inserted_first(data: bytes, tag: StartTag, element: str) -> Edit:
    """An edit that puts an element right behind a start tag, on a line as the next one has it."""
    after = data[tag.end :]
    return tag.end, tag.end, after[: len(after) - len(after.lstrip())] + element.encode()


def inserted_before(data: bytes, tag: StartTag, *elements: str) -> Edit:
    """An edit that puts elements before a start tag, on lines as its own."""
    before = data[: tag.start]
    gap = before[len(before.rstrip()) :]
    return tag.start, tag.start, b"".join(element.encode() + gap for element in elements)


def edited(data: bytes, edits: Iterable[Edit]) -> bytes:
    """The text with all its edits."""
    parts, after = [], 0
    for start, end, new in sorted(edits, key=itemgetter(0)):
        parts += [data[after:start], new]
        after = end
    return b"".join([*parts, data[after:]])
