"""Colours, labels and words, the same everywhere: of policies, errors, misses, numbers with intervals, and parameters.

Policy colours are Okabe and Ito's, which people with colour vision deficiency can tell apart. Errors are in Viridis,
misses in red. RGB is in 0..255.
"""

from __future__ import annotations

import re
import tomllib
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pickenv.base import InputError

Rgb = tuple[int, int, int]

ORANGE: Rgb = (230, 159, 0)
BLUE: Rgb = (0, 114, 178)
GREEN: Rgb = (0, 158, 115)
PURPLE: Rgb = (204, 121, 167)
RED: Rgb = (208, 32, 38)
"""Colour of the tolerance and of misses, used for nothing else."""
GREY: Rgb = (150, 150, 158)
STEEL: Rgb = (190, 194, 204)
WHITE: Rgb = (255, 255, 255)
"""Colour of text in 3D views, which the viewer puts on dark plates, or on light grey ones in its light theme."""
FRUIT: Rgb = (222, 202, 160)

ORDER = (("raw", "nominal"), ("ls", "calibrated", "calibrated_geometry"), ("ls_bpnn", "with_residual", "model_used"))
"""Keys of policies in the order in which figures and recordings list them. All other policies follow."""
BY_KEY: dict[str, Rgb] = {
    key: colour
    for keys, colour in zip((*ORDER, ("ls_gp", "best")), (ORANGE, BLUE, GREEN, PURPLE), strict=True)
    for key in keys
}
OTHERS: tuple[Rgb, ...] = (PURPLE, (86, 180, 233), (150, 140, 20), (150, 150, 150))
METHODS = (BLUE, GREEN, *OTHERS[:2], GREY)
"""Colours of methods other than raw, used in turn."""
NAMES = {"ls": "LS", "ls_bpnn": "LS+BPNN", "ls_gp": "LS+GP", "best": "LS+GP"}
TEXTS: Mapping[str, Mapping[str, str]] = tomllib.loads((Path(__file__).parent / "words.toml").read_text("utf-8"))
"""Texts that readers see, by table, and within a table by the short names that files and commands use."""
WORDS, ADDED, PLANTS = (TEXTS[table] for table in ("names", "added", "plants"))
SPELLED = {**ADDED, **WORDS}
SHORT = re.compile(
    rf"(?<![\w./+-])(?:geometry(?=\+)|\w+(?: ?\+ ?\w+)*?(?= ?\+ ?(?:{'|'.join(SPELLED)})\b)|"
    rf"^(?:{'|'.join(ADDED)})(?! [a-z])|{'|'.join(WORDS)})(?: ?\+ ?[A-Za-z]\w*)*(?![\w/+-]|\.\w)"
)
"""Pattern of a short name that stands alone or in a chain of names with plus signs, but not in the name of a file."""

ARMS: tuple[Rgb, ...] = (BLUE, ORANGE, GREEN, *OTHERS)
"""Colours of a harvester's arms, used in turn."""


def policy_key(name: str) -> str:
    """Return a policy's key, which names it in files and entity paths, given the key, the label or the description.

    For example, ``ls_bpnn``, ``LS + BPNN`` and ``least squares + neural network`` all give ``ls_bpnn``.
    """
    for short, words in WORDS.items():
        name = name.replace(words, short)
    return "_".join("".join(c if c.isalnum() else " " for c in name.lower()).split())


def check_key(name: str, what: str) -> None:
    """Raise an error if ``name`` cannot be a policy's key in an entity path; the message calls the name ``what``.

    A key has lower-case letters and digits, and single underscores between them.
    """
    if not name or name != policy_key(name):
        raise InputError(f"{what} '{name}' cannot name an entity; use lower-case letters, digits and underscores")


def policy_colours(names: Sequence[str]) -> list[Rgb]:
    """Return the colour of each policy, RGB in 0..255, given the policies' keys or labels.

    A colour depends on the policy's name alone, unless two policies would have the same colour. The keys of `BY_KEY`,
    such as ``raw`` and ``ls``, have fixed colours. A policy whose name ends in such a key (``ppo_raw``) prefers the
    key's colour, and any further policy prefers one of `OTHERS`. If the preferred colour is taken already, the policy
    gets the next free colour.
    """
    keys = [policy_key(name) for name in names]
    taken = {BY_KEY[key] for key in keys if key in BY_KEY}
    colours: list[Rgb] = []
    for key in keys:
        colour = _own_colour(key)
        if key not in BY_KEY:
            colour = next((free for free in (colour, *OTHERS, *BY_KEY.values()) if free not in taken), colour)
            taken.add(colour)
        colours.append(colour)
    return colours


def _own_colour(key: str) -> Rgb:
    words = key.split("_")
    ends = ("_".join(words[i:]) for i in range(len(words)))
    other = OTHERS[zlib.crc32(key.encode()) % len(OTHERS)]
    return next((BY_KEY[end] for end in ends if end in BY_KEY), other)


def policy_rank(name: str) -> int:
    """Return the rank of a policy in lists, given its key or label: 1 for raw, 2 for LS, 3 for LS+BPNN, else 4."""
    key = policy_key(name)
    return next((i for i, keys in enumerate(ORDER, start=1) if key in keys), len(ORDER) + 1)


def policy_label(key: str) -> str:
    """Return the label of a policy for readers, given its key or the name of a calibration's method.

    For example, LS+BPNN for ``ls_bpnn``, LS+RBF for ``ls+rbf``, and my policy for ``my_policy``.
    """
    words = key.replace("_", " ")
    return NAMES.get(key, words.upper() if key.startswith("ls+") else words)


def in_words(text: str) -> str:
    """Return a text with short names spelled out, such as "least squares + neural network" for "LS+BPNN".

    If the whole text is the name of a plant (a simulated true arm), the plant's description follows in brackets. Parts
    of longer names, such as file names, are not changed.
    """
    if text in PLANTS:
        return f"{text} ({PLANTS[text]})"
    return SHORT.sub(lambda short: " + ".join(SPELLED.get(n, n) for n in re.split(r" ?\+ ?", short[0])), text)


def as_sentence(text: str) -> str:
    """Return sentences with short names spelled out (`in_words`) and capitalised where they begin a sentence."""
    return re.sub(r"(^|\. |# |\n)(least|neural)", lambda match: match[1] + match[2].capitalize(), in_words(text))


def lane(name: str) -> str:
    """Return the part of an entity path that names a policy, such as ``2_ls`` or ``4_ppo``, given its key or label.

    The part begins with the policy's rank (`policy_rank`), so that entity paths are sorted by rank. Text after a slash
    in the name, such as an environment's number, is kept.
    """
    policy, *further = name.partition("/")
    return f"{policy_rank(policy)}_{policy_key(policy)}{''.join(further)}"


def arm_colour(arm: int) -> Rgb:
    """Return the colour of a harvester's arm, RGB in 0..255, given its index from 0."""
    return ARMS[arm % len(ARMS)]


def viridis(fraction: ArrayLike) -> NDArray[np.uint8]:
    """Return Viridis colours ``(..., 3)`` in 0..255 for fractions ``(...)``, which are clipped to 0..1."""
    from matplotlib import colormaps

    colours = colormaps["viridis"](np.clip(np.asarray(fraction, dtype=float), 0.0, 1.0), bytes=True)
    return np.asarray(colours, dtype=np.uint8)[..., :3]


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
        ends: Both ends of the interval, None for an open end; None if there is no interval.
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
        name: Name of the parameter, such as alpha0, theta1, base_x, compliance4. The number of a
            link counts from 0 in alpha, a and beta, and from 1 in theta and d.
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
    """Return a text with a backslash before each special character of Markdown, so that Markdown shows it as it is."""
    return re.sub(r"[\\`*<\[|]", r"\\\g<0>", text)
