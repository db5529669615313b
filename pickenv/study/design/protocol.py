"""What a study draws: each arm, and what it meets: fruit, calibration poses, and how the tracker errs. SI units.

Everything follows from the study's seed and the arm's own number alone, never from chunks, workers or settings: arm 17
deviates in the same direction in every grade, reaches for the same fruit and is measured at the same poses. No two arms
share anything, so that they are independent, and a yield is that of the design over its workspace.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import qmc

from pickenv.arm.effects.drives import MeasurementNoise
from pickenv.arm.kinematics.forward import forward
from pickenv.arm.kinematics.geometry import Array, Geometry
from pickenv.arm.plant.campaign import Instrument, NormalDraws, normal_draws
from pickenv.arm.plant.plant import Plant
from pickenv.arm.plant.tolerances import Tolerances, draw_plants
from pickenv.calibration.identification.least_squares import identify
from pickenv.calibration.model.arm_model import ErrorModel, link_model
from pickenv.calibration.model.measurements import Measurements, random_joints, tracked
from pickenv.envs.shared.task import GOAL_MARGIN
from pickenv.errors import InputError
from pickenv.study.design.config import Setting, StudyConfig

ARMS, TRACKER, FRUIT, POSES, RESIDUAL = range(5)
"""First part of the key of each random stream."""

MAX_TILT = math.radians(30.0)
"""Fruit are reached for with the tool this near to the vertical, as in `pickenv/Reach-v0`."""

DRAWS = 1000
"""Joints drawn for every fruit before an arm counts as unable to hold its tool upright."""

AT_ONCE = 4
"""Joints drawn for every fruit at a time; of the shipped arms two in five or more are upright."""

TRIED = 5
"""Arms for which a study's numbers of poses are tried before it begins."""


@dataclass(frozen=True, eq=False)
class Circumstances:
    """What one arm meets, whatever the setting.

    Attributes:
        number: The arm's number.
        fruit: Nominal joints that bring the tool to each of its fruit ``(M, n)``, rad or m.
        poses: Calibration poses ``(P, n)``, spread evenly; a setting with fewer uses the first ones.
        tracker: How the tracker errs there, and what the arm's friction does, in standard deviations.
    """

    number: int
    fruit: Array
    poses: Array
    tracker: NormalDraws

    @property
    def perfect(self) -> Circumstances:
        """The same with nothing left to chance: neither in the tracker nor in the friction."""
        return replace(self, tracker=NormalDraws(*(np.zeros_like(part) for part in self.tracker)))


@dataclass(frozen=True, eq=False)
class Protocol:
    """A study made ready.

    Attributes:
        config: What is studied.
        settings: Its cells.
        design: The plant that arms are drawn from.
        tolerances: Tolerance classes by name.
        model: What least squares identifies.
        tracker: What measures the arms, but for how it errs.
    """

    config: StudyConfig
    settings: tuple[Setting, ...]
    design: Plant
    tolerances: Mapping[str, Tolerances]
    model: ErrorModel
    tracker: Instrument

    @property
    def nominal(self) -> Geometry:
        """What the controller believes."""
        return self.design.arm.nominal

    def populations(self) -> list[list[Setting]]:
        """The settings by population: those that draw the same arms."""
        groups: dict[tuple[str, int], list[Setting]] = {}
        for setting in self.settings:
            groups.setdefault((setting.tolerances, setting.it_grade), []).append(setting)
        return list(groups.values())

    def draw(self, setting: Setting, arms: range) -> Plant:
        """These arms of a setting's population, as a batch."""
        parent = np.random.SeedSequence(self.config.seed, spawn_key=(ARMS,), n_children_spawned=arms.start)
        tolerances = replace(self.tolerances[setting.tolerances], it_grade=setting.it_grade)
        return draw_plants(self.design, tolerances, len(arms), np.random.default_rng(parent))

    def circumstances(self, arm: int) -> Circumstances:
        """What an arm meets, by its number.

        Raises:
            InputError: If no joints are found that hold the tool upright.
        """
        count = max((setting.poses for setting in self.settings), default=0)
        return Circumstances(
            number=arm,
            fruit=_upright_joints(self.nominal, self.config.fruit, self.stream(FRUIT, arm)),
            poses=spread_joints(self.nominal, count, self.stream(POSES, arm)),
            tracker=normal_draws(self.design, count, self.stream(TRACKER, arm)),
        )

    def instrument(self, setting: Setting) -> Instrument:
        """What measures the arms of a setting."""
        noise = MeasurementNoise(setting.noise.position_mm * 1e-3, math.radians(setting.noise.attitude_deg))
        return replace(self.tracker, noise=noise)

    def stream(self, purpose: int, arm: int) -> np.random.Generator:
        """The random numbers of an arm for a purpose: `TRACKER`, `FRUIT`, `POSES` or `RESIDUAL`."""
        return np.random.default_rng(np.random.SeedSequence(self.config.seed, spawn_key=(purpose, arm)))


def prepared_study(config: StudyConfig) -> Protocol:
    """Load what a study needs, and try its first arms.

    Raises:
        InputError: If plant or tolerance class are unknown, poses are too few to calibrate with, or no fruit is found.
    """
    design = config.load_plant()
    protocol = Protocol(
        config,
        config.settings(),
        design,
        config.load_tolerances(),
        link_model(design.arm.nominal),
        config.load_instrument(),
    )
    ideal = Plant(design.name, design.arm, design.arm.nominal)
    calibrated = {setting.poses: setting for setting in protocol.settings if setting.poses}
    for arm in range(TRIED if calibrated else 1):
        given = protocol.circumstances(arm)
        for setting in calibrated.values():  # of an arm as its controller believes, by a tracker that does not err
            identify(protocol.model, protocol.nominal, measured(protocol, ideal, setting, given.perfect))
    return protocol


def measured(protocol: Protocol, arm: Plant, setting: Setting, given: Circumstances) -> Measurements:
    """What the setting's tracker sees of an arm at its calibration poses."""
    instrument, poses = protocol.instrument(setting), setting.poses
    return tracked(arm, instrument, given.poses[:poses], given.tracker.first(poses))


def carrying(plant: Plant, payload_kg: float) -> Plant:
    """The plant with a mass held at its tool; a plant without masses stays as it is."""
    return plant if plant.load is None else replace(plant, load=replace(plant.load, payload=payload_kg))


def spread_joints(nominal: Geometry, count: int, rng: np.random.Generator) -> Array:
    """Joints ``(count, n)`` spread evenly over the joint ranges (scrambled Halton): so is every first part of them."""
    if not count:
        return np.empty((0, nominal.joints))
    return np.asarray(qmc.scale(qmc.Halton(nominal.joints, rng=rng).random(count), nominal.lower, nominal.upper))


def _upright_joints(nominal: Geometry, count: int, rng: np.random.Generator) -> Array:
    """Joints ``(count, n)`` away from their limits that hold the tool upright, drawn evenly among such joints."""
    margin = GOAL_MARGIN * (nominal.upper - nominal.lower)
    inner = replace(nominal, lower=nominal.lower + margin, upper=nominal.upper - margin)
    found = np.empty((0, nominal.joints))
    for _ in range(DRAWS // AT_ONCE):
        joints = random_joints(inner, AT_ONCE * count, rng)
        upright = forward(nominal, joints).rotation[:, 2, 2] >= math.cos(MAX_TILT)
        found = np.concatenate([found, joints[upright]])
        if len(found) >= count:
            return found[:count]
    raise InputError(
        f"of {DRAWS * count} joint poses only {len(found)} hold the tool within {math.degrees(MAX_TILT):.0f} deg of "
        f"the vertical, too few for {count} fruit; give another arm"
    )
