"""What the attributes of an MJCF element mean: default classes, units of angles, and the ways to tell an orientation.

As MuJoCo 3's compiler reads them. Metres and radians come out.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from scipy.spatial.transform import Rotation

from pickenv.arm.files.xml_values import xml_number, xml_numbers
from pickenv.arm.kinematics.axes import PARALLEL
from pickenv.arm.kinematics.geometry import Array, Pose
from pickenv.arm.kinematics.pose_error import rotation_matrix
from pickenv.errors import InputError
from pickenv.texts import decimal_number, shortened
from pickenv.toml_tables import DEG, RAD, M

Attributes: TypeAlias = Mapping[str, str]
Element = ElementTree.Element

ORIENTATIONS = ("quat", "axisangle", "euler", "xyaxes", "zaxis")


def truth(word: str) -> bool:
    """What "true" and "false" mean."""
    return word == "true"


@dataclass(frozen=True)
class MjcfValues:
    """How a file is to be read.

    Attributes:
        degrees: Whether its angles are degrees, which is MJCF's default.
        sequence: Order of its Euler angles; small letters turn about moving axes.
        autolimits: Whether a range alone limits a joint.
        defaults: Attributes of each class of defaults, by element and class.
    """

    degrees: bool
    sequence: str
    autolimits: bool
    defaults: Mapping[tuple[str, str], Attributes]

    @classmethod
    def of(cls, root: Element) -> MjcfValues:
        """The settings of a whole file.

        Raises:
            InputError: If a setting is unknown.
        """
        given: dict[str, str] = {}
        for compiler in root.iterfind("compiler"):
            given |= compiler.attrib
        unit, sequence = given.get("angle", "degree"), given.get("eulerseq", "xyz")
        if unit not in ("degree", "radian"):
            raise InputError(f"angle of <compiler> is '{shortened(unit)}'; give degree or radian")
        if len(sequence) != 3 or set(sequence) - set("xyzXYZ"):
            raise InputError(f"eulerseq of <compiler> is '{shortened(sequence)}'; give three of x, y, z, X, Y, Z")
        defaults: dict[tuple[str, str], Attributes] = {}
        waiting = [(part, "main", "") for part in reversed(root.findall("default"))]
        while waiting:
            part, name, above = waiting.pop()
            for tag in ("joint", "site"):
                found = dict(defaults.get((tag, name), defaults.get((tag, above), {})))
                for own in part.iterfind(tag):
                    found = _over(found, own.attrib)
                defaults[tag, name] = found
            inner = [(child, child.get("class", ""), name) for child in part.iterfind("default")]
            waiting += inner[::-1]
        return cls(unit == "degree", sequence, truth(given.get("autolimits", "true")), defaults)

    def merged(self, tag: str, element: Element, childclass: str) -> Attributes:
        """An element's attributes over those of its class.

        Raises:
            InputError: If there is no such class.
        """
        name = element.get("class", childclass) or "main"
        if name != "main" and (tag, name) not in self.defaults:
            raise InputError(f"there is no default class '{shortened(name)}'; name one of the file")
        return _over(self.defaults.get((tag, name), {}), element.attrib)

    def angle(self, value: float) -> float:
        """An angle of the file, rad."""
        return math.radians(value) if self.degrees else value

    def vector(self, given: Attributes, key: str, most: float) -> Array:
        """Three numbers, or zeros."""
        return xml_numbers(given.get(key, "0 0 0"), key, most)

    def direction(self, given: Attributes, owner: str) -> Array:
        """The unit vector of a joint's axis."""
        return _unit(xml_numbers(given.get("axis", "0 0 1"), "axis", M.most), f"axis of {owner}")

    def joint_number(self, given: Attributes, key: str, slides: bool, owner: str) -> float:
        """A joint's number, m or rad."""
        value = xml_number(given.get(key, "0"), owner, M.most if slides else self._most)
        return value if slides else self.angle(value)

    def limits(self, given: Attributes, slides: bool) -> tuple[float, float] | None:
        """Lower and upper end of a joint's range where it is limited."""
        word = given.get("limited", "auto")
        if word == "false" or "range" not in given:
            return None
        low, high = map(float, xml_numbers(given["range"], "range", M.most if slides else self._most, 2))
        if word != "true" and not (self.autolimits and low < high):
            return None
        return (low, high) if slides else (self.angle(low), self.angle(high))

    def pose(self, given: Attributes) -> Pose:
        """Where a body, frame or site stands in its parent."""
        return Pose(self.vector(given, "pos", M.most), self._rotation(given))

    def polynomial(self, text: str, owner: str, most: float) -> list[float]:
        """The five coefficients of a joint's tie; those left out are MuJoCo's."""
        parts = [decimal_number(part) for part in text.split()]
        good = [part for part in parts if part is not None and math.isfinite(part) and abs(part) <= most]
        if len(good) != len(parts) or len(parts) > 5:
            raise InputError(f"polycoef of joint '{shortened(owner)}' is '{shortened(text)}'; give up to five numbers")
        return [*good, *(0.0, 1.0, 0.0, 0.0, 0.0)[len(good) :]]

    @property
    def _most(self) -> float:
        return DEG.most if self.degrees else RAD.most

    def _rotation(self, given: Attributes) -> Array:
        ways = [key for key in ORIENTATIONS if key in given]
        if len(ways) > 1:
            raise InputError(f"an orientation is given by both {ways[0]} and {ways[1]}; leave one out")
        match ways:
            case ["quat"]:
                w, *xyz = _unit(xml_numbers(given["quat"], "quat", M.most, 4), "quat")
                return np.asarray(Rotation.from_quat([*xyz, w]).as_matrix())
            case ["axisangle"]:
                turn = xml_numbers(given["axisangle"], "axisangle", self._most, 4)
                return rotation_matrix(_unit(turn[:3], "axisangle") * self.angle(float(turn[3])))
            case ["euler"]:
                turned = np.eye(3)
                turns = xml_numbers(given["euler"], "euler", self._most).tolist()
                for letter, angle in zip(self.sequence, turns, strict=True):
                    step = rotation_matrix(np.eye(3)["xyz".index(letter.lower())] * self.angle(angle))
                    turned = turned @ step if letter.islower() else step @ turned
                return turned
            case ["xyaxes"]:
                numbers = xml_numbers(given["xyaxes"], "xyaxes", M.most, 6)
                x = _unit(numbers[:3], "xyaxes")
                y = _unit(numbers[3:] - x * (x @ numbers[3:]), "xyaxes")
                return np.column_stack([x, y, np.cross(x, y)])
            case ["zaxis"]:
                z = _unit(xml_numbers(given["zaxis"], "zaxis", M.most), "zaxis")
                across = np.array([-z[1], z[0], 0.0])  # the shortest turn from z to it
                sine = float(np.linalg.norm(across))
                axis = across / sine if sine > 1e-10 else np.array([1.0, 0.0, 0.0])
                return rotation_matrix(axis * math.atan2(sine, z[2]))
        return np.eye(3)


def _over(below: Attributes, own: Attributes) -> dict[str, str]:
    """Attributes over inherited ones; of orientations one remains, and any other way beats quat, as in MuJoCo."""
    ways = [key for key in ORIENTATIONS if key in own]
    inherited = [key for key in ORIENTATIONS[1:] if key in below]
    dropped = {"quat"} if ways == ["quat"] and inherited else set()
    kept = {key: value for key, value in below.items() if not ways or dropped or key not in ORIENTATIONS}
    return {**kept, **{key: value for key, value in own.items() if key not in dropped}}


def _unit(values: Array, what: str) -> Array:
    length = float(np.linalg.norm(values))
    if length < PARALLEL:
        raise InputError(f"{what} has no direction; give a unit vector")
    return values / length
