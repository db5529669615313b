"""Numbers with their intervals in words, and the meanings of parameters for readers who do not know the notation."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

from pickenv.inspect.colours import TEXTS


def between(low: float | None, high: float | None, digits: int, sign: str = "") -> str:
    """An interval in words: 0.12 to 0.34; ``sign`` "+" gives both ends a sign. An unknown end (None) is open."""
    ends = ["" if end is None else estimated(end, None, None, digits, sign=sign) for end in (low, high)]
    if all(ends):
        return f"{ends[0]} to {ends[1]}"
    return f"{ends[0]} or more" if ends[0] else f"up to {ends[1]}" if ends[1] else "no interval"


def estimated(value: float, low: float | None, high: float | None, digits: int, unit: str = "", sign: str = "") -> str:
    """A number with its 95 % interval in brackets: 0.23 mm (0.12 to 0.34); the number alone without an interval."""
    text = f"{round(value, digits) + 0.0:{sign}.{digits}f}{unit}"  # no minus before a zero
    return text if low is None and high is None else f"{text} ({between(low, high, digits, sign)})"


def said(
    value: float | None,
    ends: Sequence[float | None] | None,
    digits: int,
    scale: float = 1.0,
    sign: str = "",
    unit: str = "",
) -> str:
    """A number and its interval, both times ``scale``, as `estimated` writes them; a dash for an unknown number."""
    if value is None:
        return "–"
    low, high = (None if end is None else scale * end for end in ends or (None, None))
    return estimated(scale * value, low, high, digits, unit, sign)


def percent(share: float, low: float | None, high: float | None, digits: int = 0) -> str:
    """A share with its 95 % interval: 93 % (88 to 97); the share alone without an interval."""
    return said(share, (low, high), digits, 100.0, unit=" %")


def named_values(values: Mapping[str, object]) -> str:
    """Names and values in one line: numpy 2.0, scipy 1.15."""
    return ", ".join(f"{name} {value}" for name, value in values.items())


def parameter_words(name: str, joint_names: Sequence[str], link_names: Sequence[str] | None = None) -> str:
    """The meaning of a parameter; an empty string for a name that is not known.

    Args:
        name: Name of the parameter, such as alpha0, theta1, base_x, compliance4. Its number is that of a link, from 0
            for alpha, a and beta, from 1 for theta and d.
        joint_names: Names of the joints.
        link_names: Names of the links, where a joint moves several links; the joints' names when None.
    """
    links = link_names or joint_names
    match = re.fullmatch(r"(alpha|a|beta|theta|d)(\d+)", name)
    if match:
        kind, number = match[1], int(match[2])
        place = number if kind in ("alpha", "a", "beta") else number - 1
        if not 0 <= place < len(links):
            return ""
        before = "the base" if place == 0 else links[place - 1]
        return TEXTS["links"][kind].format(before=before, after=links[place])
    frame, _, axis = name.partition("_")
    kind = frame.rstrip("0123456789")
    if kind in TEXTS["frames"]:
        station = f", station {frame[len(kind) :]}" if frame != kind else ""
        motion = "turn about" if axis.startswith("r") else "position along"
        return f"{TEXTS['frames'][kind]}{station}: {motion} {axis[-1]}"
    match = re.match(r"([a-z]+)(\d*)", name)
    if match and match[1] in TEXTS["effects"]:
        place = int(match[2] or 1) - 1
        after = joint_names[place] if place < len(joint_names) else ""
        return TEXTS["effects"][match[1]].format(after=after)
    return ""
