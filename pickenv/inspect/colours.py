"""Colours and labels of policies, the same in all figures, and the colours of errors (Viridis) and misses (red).

Policy colours are Okabe and Ito's, which people with colour vision deficiency can tell apart. RGB is in 0..255.
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
"""Colour of text in 3D views. The viewer puts text on dark plates in its dark theme, and on light grey ones in its
light theme."""
FRUIT: Rgb = (222, 202, 160)

BY_KEY: dict[str, Rgb] = {
    "raw": ORANGE,
    "nominal": ORANGE,
    "ls": BLUE,
    "calibrated": BLUE,
    "calibrated_geometry": BLUE,
    "ls_bpnn": GREEN,
    "with_residual": GREEN,
    "model_used": GREEN,
    "ls_gp": PURPLE,
    "best": PURPLE,
}
OTHERS: tuple[Rgb, ...] = (PURPLE, (86, 180, 233), (150, 140, 20), (150, 150, 150))
NAMES = {"ls": "LS", "ls_bpnn": "LS+BPNN", "ls_gp": "LS+GP", "best": "LS+GP"}
TEXTS: Mapping[str, Mapping[str, str]] = tomllib.loads((Path(__file__).parent / "words.toml").read_text("utf-8"))
"""Texts that readers see, by table, and within a table by the short names that files and commands use."""
WORDS, ADDED, PLANTS = (TEXTS[table] for table in ("names", "added", "plants"))
SPELLED = {**ADDED, **WORDS}
SHORT = re.compile(
    rf"(?<![\w./+-])(?:geometry(?=\+)|\w+(?: ?\+ ?\w+)*?(?= ?\+ ?(?:{'|'.join(SPELLED)})\b)|"
    rf"^(?:{'|'.join(ADDED)})(?! [a-z])|{'|'.join(WORDS)})(?: ?\+ ?[A-Za-z]\w*)*(?![\w/+-]|\.\w)"
)
"""A short name that stands alone, or is a part of a chain of names with plus signs; not a part of a file's name."""
ORDER = (("raw", "nominal"), ("ls", "calibrated", "calibrated_geometry"), ("ls_bpnn", "with_residual", "model_used"))
"""Keys of policies in the order in which figures and recordings list them. All other policies follow."""

ARMS: tuple[Rgb, ...] = (BLUE, ORANGE, GREEN, *OTHERS)
"""Colours of a harvester's arms, used in turn."""


def policy_key(name: str) -> str:
    """Return the key of a policy (its name in files and entity paths), given its key, its label or its description.

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
    of longer names, such as those of files, are not changed.
    """
    if text in PLANTS:
        return f"{text} ({PLANTS[text]})"
    return SHORT.sub(lambda short: " + ".join(SPELLED.get(n, n) for n in re.split(r" ?\+ ?", short[0])), text)


def as_sentence(text: str) -> str:
    """Return sentences with short names spelled out (`in_words`) and capitalised where they begin a sentence."""
    return re.sub(r"(^|\. |# |\n)(least|neural)", lambda match: match[1] + match[2].capitalize(), in_words(text))


def lane(name: str) -> str:
    """Return the part of an entity path that names a policy, given its key or label, such as ``2_ls`` or ``4_ppo``.

    The part begins with the `policy_rank`, by which entity paths are sorted. Anything after a slash in the name, such
    as an environment's number, is kept.
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
