"""Text for numbers with their intervals, and for the meanings of parameters."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

from pickenv.inspect.colours import TEXTS


def between(low: float | None, high: float | None, digits: int, sign: str = "") -> str:
    """Return an interval as text, such as 0.12 to 0.34.

    Args:
        low: Lower end; None for an open end.
        high: Upper end; None for an open end.
        digits: Number of decimals.
        sign: "+" to write a sign before positive numbers too.
    """
    ends = ["" if end is None else estimated(end, None, None, digits, sign=sign) for end in (low, high)]
    if all(ends):
        return f"{ends[0]} to {ends[1]}"
    return f"{ends[0]} or more" if ends[0] else f"up to {ends[1]}" if ends[1] else "no interval"


def estimated(value: float, low: float | None, high: float | None, digits: int, unit: str = "", sign: str = "") -> str:
    """Return an estimate with its 95 % interval in brackets as text, such as 0.23 mm (0.12 to 0.34).

    Args:
        value: The estimate.
        low: Lower end of the interval; None for an open end.
        high: Upper end of the interval; None for an open end. If both ends are None, no interval is written.
        digits: Number of decimals.
        unit: Text directly behind the estimate, such as " mm".
        sign: "+" to write a sign before positive numbers too.
    """
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
    """Return an estimate and its interval as text, as `estimated` does; a dash if the estimate is unknown.

    Args:
        value: The estimate; None if it is unknown.
        ends: Both ends of the interval, None for an open end; None without an interval.
        digits: Number of decimals.
        scale: Factor on the estimate and its interval.
        sign: "+" to write a sign before positive numbers too.
        unit: Text directly behind the estimate, such as " mm".
    """
    if value is None:
        return "–"
    low, high = (None if end is None else scale * end for end in ends or (None, None))
    return estimated(scale * value, low, high, digits, unit, sign)


def percent(share: float, low: float | None, high: float | None, digits: int = 0) -> str:
    """Return a share with its 95 % interval as text in percent, such as 93 % (88 to 97).

    The share and the ends are in 0..1. If both ends are None, no interval is written.
    """
    return said(share, (low, high), digits, 100.0, unit=" %")


def named_values(values: Mapping[str, object]) -> str:
    """Return names and values as text in one line, such as numpy 2.0, scipy 1.15."""
    return ", ".join(f"{name} {value}" for name, value in values.items())


def parameter_words(name: str, joint_names: Sequence[str], link_names: Sequence[str] | None = None) -> str:
    """Return the meaning of a parameter in words; an empty string for an unknown name.

    Args:
        name: Name of the parameter, such as alpha0, theta1, base_x, compliance4. The number in the name is that of a
            link, from 0 for alpha, a and beta, from 1 for theta and d.
        joint_names: Names of the joints.
        link_names: Names of the links, if a joint moves several links; the joints' names when None.
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


def unmarked(text: str) -> str:
    """Return a text that Markdown shows as it is: a backslash stands before each sign that would mark something."""
    return re.sub(r"[\\`*<\[|]", r"\\\g<0>", text)
