"""What a study varies, read from a TOML file: populations, calibrations, payloads, and when an arm is good enough.

Files and columns are in mm, deg and kg, and every name says so.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

from pickenv.arm.files.arm_file import read_toml, refuse_unknown
from pickenv.arm.files.content import content_sha256
from pickenv.arm.files.tables import Table
from pickenv.arm.plant.plant import Plant
from pickenv.arm.plant.plant_file import load_plant
from pickenv.arm.plant.tolerances import GRADES, Tolerances, load_tolerances
from pickenv.calibration.model.measurements import ATTITUDE_STD, POSITION_STD
from pickenv.calibration.residuals.residual_models import FITTERS
from pickenv.errors import InputError
from pickenv.limits import LIMITS, check_limit

VERSION = 1
"""Raised whenever the same configuration gives other rows, so that old results are not mixed with new ones."""

RAW, LS = "raw", "ls"
METHODS = (RAW, LS, *(f"{LS}+{kind}" for kind in FITTERS))
"""No calibration; least squares; least squares and a learnt residual of that kind."""


QUANTITIES = {"residual_poses": "poses"}
"""Keys whose limits stand in `pickenv.limits` under another name."""


@dataclass(frozen=True)
class Noise:
    """Standard deviation of the tracker, per axis.

    Attributes:
        position_mm: Of a position, mm.
        attitude_deg: Of an attitude, deg.
    """

    position_mm: float
    attitude_deg: float


DEFAULT_NOISE = Noise(POSITION_STD * 1e3, math.degrees(ATTITUDE_STD))
"""The tracker of a study that names none."""


@dataclass(frozen=True)
class Setting:
    """One cell of a study: a population, how its arms are calibrated, and what they carry.

    Attributes:
        number: Position in the study's list, from 0.
        tolerances: Tolerance class.
        it_grade: ISO 286-1 grade of the lengths.
        poses: Calibration poses; 0 without calibration.
        noise: Of the tracker; zero without calibration.
        method: One of `METHODS`.
        payload_kg: Mass held at the tool while picking; calibrations are made with the plant's own.
    """

    number: int
    tolerances: str
    it_grade: int
    poses: int
    noise: Noise
    method: str
    payload_kg: float


@dataclass(frozen=True)
class StudyConfig:
    """A study; `load_study` reads it.

    Attributes:
        plant: Plant preset, or path to a plant file.
        seed: Seed of arms, noise, fruit and poses.
        arms: Arms N of every setting.
        chunk: Arms that are worked on and stored together.
        fruit: Fruit M that every arm reaches for.
        payload_kg: Payloads.
        radius_mm: An arm has a fruit when its tool ends this near.
        share: An arm is within specification when it has at least this share of the fruit.
        tolerances: Tolerance classes, by name or path.
        it_grades: ISO 286-1 grades, each instead of the class's own; None for the class's own.
        methods: Calibrations, of `METHODS`.
        poses: Numbers of calibration poses.
        noise: Trackers.
        residual_poses: Further poses for a learnt residual.
    """

    plant: str
    seed: int
    arms: int
    chunk: int
    fruit: int
    payload_kg: tuple[float, ...]
    radius_mm: float
    share: float
    tolerances: tuple[str, ...]
    it_grades: tuple[int, ...] | None
    methods: tuple[str, ...]
    poses: tuple[int, ...]
    noise: tuple[Noise, ...]
    residual_poses: int

    def settings(self) -> tuple[Setting, ...]:
        """All cells: populations first, payloads last; an arm without calibration has neither poses nor tracker."""
        classes = self.load_tolerances().items()
        populations = [(name, grade) for name, own in classes for grade in (self.it_grades or (own.it_grade,))]
        calibrations = [
            (method, poses, noise)
            for method in self.methods
            for poses, noise in ([(0, Noise(0.0, 0.0))] if method == RAW else product(self.poses, self.noise))
        ]
        cells = product(populations, calibrations, self.payload_kg)
        return tuple(
            Setting(number, name, grade, poses, noise, method, payload)
            for number, ((name, grade), (method, poses, noise), payload) in enumerate(cells)
        )

    def chunks(self) -> range:
        """Numbers of the chunks."""
        return range(-(-self.arms // self.chunk))

    def arms_of(self, chunk: int) -> range:
        """Numbers of the arms of a chunk."""
        return range(chunk * self.chunk, min((chunk + 1) * self.chunk, self.arms))

    def quick(self) -> StudyConfig:
        """A small version for trying things out: the same settings on 40 arms and 20 fruit at most."""
        return replace(self, arms=min(self.arms, 40), fruit=min(self.fruit, 20), chunk=min(self.chunk, 20))

    def load_plant(self) -> Plant:
        """The design that arms are drawn from.

        Raises:
            InputError: If the plant is unknown or impossible, or cannot carry the payloads.
        """
        plant = load_plant(self.plant)
        if plant.load is None and any(self.payload_kg):
            raise InputError(
                f"plant '{plant.name}' has no [load], so a payload changes nothing; leave payload_kg out or at 0"
            )
        return plant

    def load_tolerances(self) -> dict[str, Tolerances]:
        """The tolerance classes by name.

        Raises:
            InputError: If one is unknown or impossible.
        """
        return {name: load_tolerances(name) for name in self.tolerances}

    def sha256(self) -> str:
        """Hash of everything that the rows depend on, the numbers of plant and tolerance classes among it.

        Raises:
            InputError: If plant or tolerance class are unknown or impossible.
        """
        return content_sha256(VERSION, self, self.load_plant(), list(self.load_tolerances().values()))

    def toml(self) -> str:
        """This configuration as a TOML file that `load_study` reads."""
        noise = ", ".join(
            f"{{ position_mm = {n.position_mm!r}, attitude_deg = {n.attitude_deg!r} }}" for n in self.noise
        )
        grades = "" if self.it_grades is None else f"it_grades = {list(self.it_grades)}\n"
        return (
            f"plant = {json.dumps(self.plant)}\nseed = {self.seed}\narms = {self.arms}\nchunk = {self.chunk}\n\n"
            f"[picking]\nfruit = {self.fruit}\npayload_kg = {list(self.payload_kg)}\n\n"
            f"[specification]\nradius_mm = {self.radius_mm!r}\nshare = {self.share!r}\n\n"
            f"[tolerances]\nclasses = {json.dumps(self.tolerances)}\n{grades}\n"
            f"[calibration]\nmethods = {json.dumps(self.methods)}\nposes = {list(self.poses)}\nnoise = [{noise}]\n"
            f"residual_poses = {self.residual_poses}\n"
        )


def load_study(path: str | Path) -> StudyConfig:
    """Read a study from a TOML file (`scripts/tolerance_study.toml` shows every key).

    Raises:
        InputError: If the file is missing or an entry is impossible; the message names the file and the key.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"study {path} does not exist; give a path to a TOML file")
    content, where = read_toml(path), str(path)
    tables = ("picking", "specification", "tolerances", "calibration")
    top = ("plant", "seed", "arms", "chunk", "sha256", "arithmetic")  # the last two stand in results folders
    refuse_unknown(content, (*top, *tables), where, "a study")
    study = Table({key: content[key] for key in top if key in content}, "study", where, top)
    picking = Table(content.get("picking", {}), "picking", where, ("fruit", "payload_kg"))
    specification = Table(content.get("specification", {}), "specification", where, ("radius_mm", "share"))
    tolerances = Table(content.get("tolerances", {}), "tolerances", where, ("classes", "it_grades"))
    calibration = Table(
        content.get("calibration", {}), "calibration", where, ("methods", "poses", "noise", "residual_poses")
    )
    share = specification.number("share", positive=True)
    if share > 1.0:
        raise specification.fail("share", "a share of the fruit, above 0 and at most 1")
    plant = content.get("plant")
    if not isinstance(plant, str):
        raise study.fail("plant", "the name of a plant preset or a path to a plant file (.toml)")
    least, most = min(GRADES), max(GRADES)
    (_, heaviest, why), most_poses = LIMITS["payload_kg"], int(LIMITS["poses"][1])
    config = StudyConfig(
        plant=plant,
        seed=_whole(study, "seed", 0),
        arms=_whole(study, "arms"),
        chunk=_whole(study, "chunk", 250),
        fruit=_whole(picking, "fruit", 100),
        payload_kg=_several(
            picking, "payload_kg", _is_payload, f"masses from 0 to {heaviest:g} kg: {why}", [0.0], float
        ),
        radius_mm=_limited(specification, "radius_mm", positive=True),
        share=share,
        tolerances=_several(tolerances, "classes", lambda value: isinstance(value, str), "names of tolerance classes"),
        it_grades=_several(tolerances, "it_grades", _between(least, most), f"whole numbers from {least} to {most}")
        if "it_grades" in tolerances.table
        else None,
        methods=_several(calibration, "methods", METHODS.__contains__, f"some of {', '.join(METHODS)}", [LS]),
        poses=_several(calibration, "poses", _between(1, most_poses), f"whole numbers from 1 to {most_poses}", [30]),
        noise=_noise(calibration),
        residual_poses=_whole(calibration, "residual_poses", 100),
    )
    config.load_tolerances()  # what is unknown is refused now, not an hour later
    config.load_plant()
    return config


def _is_whole(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


def _between(low: int, high: int) -> Callable[[Any], bool]:
    return lambda value: _is_whole(value) and low <= value <= high


def _is_payload(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and 0 <= value <= LIMITS["payload_kg"][1]


def _whole(table: Table, key: str, default: int | None = None) -> int:
    least, most, why = LIMITS[QUANTITIES.get(key, key)]
    value = table.table.get(key, default)
    if not _is_whole(value) or not least <= value <= most:
        raise table.fail(key, f"a whole number from {least:.0f} to {most:.0f}: {why}")
    return int(value)


def _limited(table: Table, key: str, *, positive: bool = False) -> float:
    """A number within the limits of what its key names."""
    value = table.number(key, positive=positive)
    check_limit(f"{table.where}: {key} of [{table.name}]", value, key)
    return value


def _several(
    table: Table,
    key: str,
    valid: Callable[[Any], bool],
    wanted: str,
    default: list[Any] | None = None,
    convert: Callable[[Any], Any] = lambda value: value,
) -> tuple[Any, ...]:
    """The list under ``key``: not empty, every entry valid, none twice."""
    values = table.table.get(key, default)
    if not isinstance(values, list) or not values or not all(valid(value) for value in values):
        raise table.fail(key, f"a list of {wanted}")
    if len(set(values)) < len(values):
        raise table.fail(key, "each entry once")
    return tuple(convert(value) for value in values)


def _noise(table: Table) -> tuple[Noise, ...]:
    """The trackers; a laser tracker with a reflector triad when left out."""
    if "noise" not in table.table:
        return (DEFAULT_NOISE,)
    entries = table.entries("noise", ("position_mm", "attitude_deg"))
    found = tuple(Noise(_limited(entry, "position_mm"), _limited(entry, "attitude_deg")) for entry in entries)
    if not found or len(set(found)) < len(found):
        raise table.fail("noise", "a list of tables with position_mm and attitude_deg, each tracker once")
    return found
