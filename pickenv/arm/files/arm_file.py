"""Arms are TOML files: nominal link table, limits, base and tool, and, for simulated arms, the true deviations.

Files give degrees and millimetres and say so in every key; inside, everything is radians and metres. The shipped arms
lie in `pickenv/arm/files/arms`. A joint table with ``follows`` is a link that another joint moves, ``ratio`` times
as far.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from pickenv.arm.files.plausible import largest
from pickenv.arm.kinematics.geometry import Array, Coupling, Geometry, Pose, from_standard_dh, geometry_fingerprint
from pickenv.arm.kinematics.pose_error import rotation_matrix
from pickenv.errors import InputError
from pickenv.texts import is_file, shortened
from pickenv.texts import read_toml as read_toml

ARMS = Path(__file__).parent / "arms"

UNITS = {"alpha": "deg", "a": "mm", "theta": "deg", "d": "mm", "beta": "deg"}
MOST_RATIO = 1e3
TO_SI = {"deg": np.pi / 180.0, "mm": 1e-3, "rad": 1.0, "m": 1.0}


@dataclass(frozen=True, eq=False)
class Arm:
    """A named arm.

    Attributes:
        name: As in its file.
        source: Where its numbers come from.
        nominal: The geometry that the controller believes in.
        true: The geometry as built, where the file gives one (simulated arms), else None.
        speed: Largest joint speeds, rad/s or m/s, shape (n,).
    """

    name: str
    source: str
    nominal: Geometry
    true: Geometry | None
    speed: Array

    def fingerprint(self) -> str:
        """Hash of the nominal geometry: a calibration fitted to one arm is refused on another."""
        return geometry_fingerprint(self.nominal)


def shipped_arms() -> list[str]:
    """Names of the arms that come with pickenv."""
    return sorted(path.stem for path in ARMS.glob("*.toml"))


def load_arm(name: str | Path) -> Arm:
    """Read an arm by name (a shipped one), or from a path to a TOML or URDF file ("arm.urdf#tip_link").

    Raises:
        InputError: If the arm is unknown, or its file is malformed; the message names the file and the joint or key.
    """
    stem, _, tip = str(name).partition("#")
    if stem.endswith(".urdf"):
        from pickenv.arm.files.urdf import load_urdf

        return load_urdf(stem, tip or None)
    path = Path(name)
    if path.suffix == ".toml":
        if not is_file(path):
            raise InputError(
                f"arm file {shortened(path, 300)} does not exist; give a path to a TOML file or one of {shipped_arms()}"
            )
    else:
        path = ARMS / f"{name}.toml"
        if not is_file(path):
            raise InputError(
                f"unknown arm '{shortened(name)}'; give one of {shipped_arms()} or a path to an arm file (.toml, .urdf)"
            )
    return _read(path, path.stat().st_mtime_ns)


@lru_cache(maxsize=32)
def _read(path: Path, _modified: int) -> Arm:
    return parse_arm(read_toml(path), str(path))


def parse_arm(content: Mapping[str, Any], where: str) -> Arm:
    """Turn the parsed content of an arm file into an `Arm`; ``where`` names the file in error messages."""
    refuse_unknown(
        content, ("name", "source", "convention", "joint_count", "joints", "base", "tool"), where, "an arm file"
    )
    joints = _numbered_joints(content, where)
    names = tuple(word(joint, "name", f"J{i + 1}", where) for i, joint in enumerate(joints))
    types = [joint.get("type") for joint in joints]
    for i, kind in enumerate(types):
        if kind not in ("R", "P"):
            raise InputError(
                f"{where}: joint {i + 1} has type {shortened(repr(kind))}; give 'R' (revolute) or 'P' (prismatic)"
            )
    prismatic = tuple(kind == "P" for kind in types)
    leaders = [i for i, joint in enumerate(joints) if "follows" not in joint]
    coupling = _coupling(joints, prismatic, leaders, where)
    for i, (joint, slides) in enumerate(zip(joints, prismatic, strict=True)):
        refuse_unknown(joint, _joint_keys(slides, "follows" in joint), where, f"joint {i + 1} ({types[i]})")
    limits: dict[str, Any] = {key: _per_leader(joints, prismatic, leaders, key, where) for key in ("lower", "upper")}
    if np.any(limits["lower"] >= limits["upper"]):
        worst = leaders[int(np.argmax(limits["lower"] >= limits["upper"]))]
        raise InputError(f"{where}: joint {worst + 1} has a lower limit that is not below its upper limit")
    table: dict[str, Any] = {key: _column(joints, key, where) for key in ("alpha", "a", "theta", "d")}
    beta = _column([{"beta_deg": 0.0, **joint} for joint in joints], "beta", where)
    base, tool = _pose(content, "base", where), _pose(content, "tool", where)
    convention = content.get("convention", "modified")
    if convention == "modified":
        nominal = Geometry(names, prismatic, **table, beta=beta, **limits, base=base, tool=tool)
    elif convention == "standard":
        if beta.any():
            raise InputError(f"{where}: beta_deg needs convention = 'modified'")
        nominal = from_standard_dh(names, prismatic, **table, **limits, base=base, tool=tool)
    else:
        raise InputError(
            f"{where}: convention {shortened(repr(convention))} is unknown; give 'modified' or 'standard' (DH)"
        )
    nominal = replace(
        nominal,
        joint_names=tuple(names[i] for i in leaders),
        prismatic=tuple(prismatic[i] for i in leaders),
        coupling=coupling,
    )
    true = None
    if any(any(str(key).startswith("true_") for key in joint) for joint in joints):
        if convention != "modified":
            raise InputError(f"{where}: true_… values need convention = 'modified'")
        built: dict[str, Any] = {key: _column(joints, key, where, "true_") for key in table}
        true = replace(nominal, **built)
    speed = _per_leader(joints, prismatic, leaders, "speed", where)
    if np.any(speed <= 0):
        raise InputError(f"{where}: the speed of joint {leaders[int(np.argmax(speed <= 0))] + 1} is not above zero")
    return Arm(
        name=word(content, "name", Path(where).stem, where),
        source=word(content, "source", "", where),
        nominal=nominal,
        true=true,
        speed=speed,
    )


def word(table: Mapping[str, Any], key: str, default: str, where: str) -> str:
    """A text of one line, or ``default`` where the key is left out."""
    value = table.get(key, default)
    if not isinstance(value, str) or not (value.isprintable() or key not in table):
        raise InputError(f"{where}: {key} is {shortened(repr(value))}; give a text of one line")
    return value


def refuse_unknown(table: Mapping[str, Any], allowed: Iterable[str], where: str, owner: str) -> None:
    """A key that nobody reads is a misspelt one: refuse it and say which keys ``owner`` has."""
    unknown = sorted(str(key) for key in set(table) - set(allowed))
    if unknown:
        raise InputError(f"{where}: unknown key '{shortened(unknown[0])}'; {owner} has {', '.join(sorted(allowed))}")


def _joint_keys(slides: bool, follows: bool) -> list[str]:
    unit = "mm" if slides else "deg"
    columns = [f"{key}_{UNITS[key]}" for key in ("alpha", "a", "theta", "d")]
    limits = ["follows"] if follows else [f"lower_{unit}", f"upper_{unit}", f"speed_{unit}_per_s"]
    return ["number", "name", "type", "ratio", "beta_deg", *columns, *(f"true_{key}" for key in columns), *limits]


def _coupling(
    joints: list[Mapping[str, Any]], prismatic: tuple[bool, ...], leaders: list[int], where: str
) -> Coupling | None:
    """Which joint moves each link, from ``follows`` and ``ratio``; None where each joint moves its own alone."""
    owners, ratios = [], []
    for i, joint in enumerate(joints):
        leader = joint.get("follows", i + 1)
        if isinstance(leader, bool) or not isinstance(leader, int) or leader - 1 not in leaders:
            given = shortened(repr(leader))
            raise InputError(
                f"{where}: joint {i + 1} follows {given}; give the number of a joint that does not follow another"
            )
        ratios.append(_number({"ratio": 1.0, **joint}, "ratio", where, f"joint {i + 1}"))
        if not 0 < abs(ratios[-1]) <= MOST_RATIO:
            raise InputError(f"{where}: ratio of joint {i + 1} is {ratios[-1]:g}; give one up to {MOST_RATIO:g}, not 0")
        owners.append(leaders.index(leader - 1))
    if len(leaders) == len(joints) and all(ratio == 1.0 for ratio in ratios):
        return None
    return Coupling(tuple(owners), tuple(ratios), prismatic)


def _numbered_joints(content: Mapping[str, Any], where: str) -> list[Mapping[str, Any]]:
    """The joint tables in order 1..joint_count; a gap or a duplicate is an error that names the joint."""
    joints, count = content.get("joints"), content.get("joint_count")
    if not isinstance(count, int) or isinstance(count, bool) or count < 1:
        given = "is missing" if count is None else f"is {shortened(repr(count))}"
        raise InputError(f"{where}: joint_count {given}; state the number of joints so that a lost one is noticed")
    if not isinstance(joints, list) or not all(isinstance(joint, Mapping) for joint in joints):
        raise InputError(f"{where}: there are no [[joints]] tables; give one per joint")
    numbers = [joint.get("number") for joint in joints]
    for number in range(1, count + 1):
        if numbers.count(number) != 1:
            fault = "is missing" if number not in numbers else "is given twice"
            raise InputError(
                f"{where}: joint {number} {fault}; joint_count = {count} asks for joints 1 to {count}, once each"
            )
    if len(joints) != count:
        extra = next(number for number in numbers if number not in range(1, count + 1))
        raise InputError(
            f"{where}: joint number {shortened(repr(extra))} is not in 1..{count}; correct it or joint_count"
        )
    return sorted(joints, key=lambda joint: int(joint["number"]))


def _number(table: Mapping[str, Any], key: str, where: str, owner: str) -> float:
    value = table.get(key)
    if isinstance(value, bool) or not isinstance(value, int | float):
        given = "is missing" if key not in table else f"is {shortened(repr(value))}"
        raise InputError(f"{where}: {key} of {owner} {given}; give a number")
    if not np.isfinite(value):
        raise InputError(f"{where}: {key} of {owner} is {value}; give a finite number")
    if abs(value) > largest(key):
        raise InputError(f"{where}: {key} of {owner} is {value:g}; no arm has more than {largest(key):g} there")
    return float(value)


def _column(joints: list[Mapping[str, Any]], key: str, where: str, prefix: str = "") -> Array:
    name = f"{prefix}{key}_{UNITS[key]}"
    values = [_number(joint, name, where, f"joint {i + 1}") for i, joint in enumerate(joints)]
    return np.array(values) * TO_SI[UNITS[key]]


def _per_leader(
    joints: list[Mapping[str, Any]], prismatic: tuple[bool, ...], leaders: list[int], key: str, where: str
) -> Array:
    """Limits or speeds of the joints that do not follow: degrees for revolute ones, millimetres for prismatic ones."""
    values = []
    for i in leaders:
        unit = "mm" if prismatic[i] else "deg"
        suffix = "_per_s" if key == "speed" else ""
        values.append(_number(joints[i], f"{key}_{unit}{suffix}", where, f"joint {i + 1}") * TO_SI[unit])
    return np.array(values)


def _pose(content: Mapping[str, Any], key: str, where: str) -> Pose:
    table = content.get(key, {})
    if not isinstance(table, Mapping):
        raise InputError(f"{where}: [{key}] must be a table with position_mm and rotation_vector_deg")
    refuse_unknown(table, ("position_mm", "rotation_vector_deg"), where, f"[{key}]")
    vectors = []
    for name, unit in (("position_mm", "mm"), ("rotation_vector_deg", "deg")):
        value = table.get(name, [0.0, 0.0, 0.0])
        if not isinstance(value, list) or len(value) != 3:
            raise InputError(f"{where}: {name} of [{key}] must be three numbers")
        numbers = {f"{name}[{i}]": v for i, v in enumerate(value)}
        vectors.append(np.array([_number(numbers, k, where, f"[{key}]") for k in numbers]) * TO_SI[unit])
    return Pose(vectors[0], rotation_matrix(vectors[1]))
