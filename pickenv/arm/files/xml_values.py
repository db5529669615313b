"""Functions that the URDF and MJCF readers and writers share: parse the file, and read numbers in its attributes."""

from __future__ import annotations

import codecs
import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from pickenv.arm.kinematics.forward import PARALLEL
from pickenv.arm.kinematics.geometry import Array
from pickenv.base import KG, InputError, decimal_number, read_text, shortened
from pickenv.base.texts import parsed

Element = ElementTree.Element


def xml_root(path: Path, ending: str) -> Element:
    """Return the root element of an XML file; entities are refused, because they can expand without limit.

    Args:
        path: The file.
        ending: Kind of the file in error messages, such as ".urdf".

    Raises:
        InputError: If the file cannot be read, is no XML, or declares entities.
    """
    text = read_text(path, f"a {ending} file")
    if declared := re.match(r"""<\?xml[^>]*?encoding\s*=\s*["']([^"']*)""", text):
        encoding = parsed(lambda: codecs.lookup(declared[1]).name, path, "XML")
        if encoding != "utf-8" and not text.isascii():
            raise InputError(f"{path} says its encoding is '{declared[1]}', but it is UTF-8; correct its first line")
    if "<!ENTITY" in text:
        raise InputError(f"{path} declares XML entities, which no arm needs; write their text out")
    return parsed(lambda: ElementTree.fromstring(text), path, "XML")


def xml_numbers(text: str, key: str, most: float, count: int = 3) -> Array:
    """Return the numbers that an attribute's text lists, ``(count,)``.

    Args:
        text: The attribute's text.
        key: Name of the attribute in error messages.
        most: Largest absolute value allowed.
        count: How many numbers the text must have: 2, 3, 4 or 6.

    Raises:
        InputError: If the text is not ``count`` finite numbers, or one of them is too large.
    """
    values = np.array([decimal_number(part) for part in text.split()], dtype=float)  # not a number where it is none
    if values.shape != (count,) or not np.isfinite(values).all():
        counted = {2: "two", 3: "three", 4: "four", 6: "six"}[count]
        raise InputError(f"'{shortened(text)}' is not {counted} numbers ({key})")
    if np.abs(values).max() > most:
        raise InputError(f"{key} '{shortened(text)}' has a number above {most:g}, which no arm has")
    return values


def xml_number(text: str, owner: str, most: float) -> float:
    """Return the number in an attribute's text.

    Args:
        text: The attribute's text.
        owner: What the number is, for error messages: "offset of joint 'J1'".
        most: Largest absolute value allowed.

    Raises:
        InputError: If the text is no number, or the number is too large.
    """
    value = decimal_number(text)
    if value is None or not np.isfinite(value):
        raise InputError(f"the {owner} is '{shortened(text)}'; give a finite number")
    if abs(value) > most:
        raise InputError(f"the {owner} is {value:g}; no arm has more than {most:g} there")
    return value


def xml_mass(text: str, owner: str) -> float:
    """Return the mass of a link or body, kg, from an attribute's text; ``owner`` is the link or body in messages.

    Raises:
        InputError: If the text is no number, or the number is negative or too large.
    """
    kg = xml_number(text, f"mass of {owner}", KG.most)
    if kg < 0.0:
        raise InputError(f"{owner} has a mass of {kg:g} kg; give one from 0")
    return kg


def unit_vector(values: Array, what: str) -> Array:
    """Return the unit vector in the direction of ``values``; ``what`` names the vector in error messages.

    Raises:
        InputError: If ``values`` is the zero vector.
    """
    if (length := float(np.linalg.norm(values))) < PARALLEL:
        raise InputError(f"{what} has no direction; give a unit vector")
    return values / length


def numbers_text(numbers: ArrayLike) -> str:
    """Return numbers as the text of an attribute, separated by spaces, with all their digits."""
    return " ".join(repr(float(number)) for number in np.atleast_1d(numbers))
