"""What all arms of a study share: design, populations, fruit and calibration poses; and each arm's random numbers.

An arm's random numbers depend on the study's seed and the arm's own number alone, never on chunks, workers or settings:
arm 17 deviates in the same direction in every grade, and its tracker errs the same way. SI units.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.stats import qmc

from pickenv.arm.kinematics.forward import forward
from pickenv.arm.kinematics.geometry import Array, Geometry, Pose
from pickenv.arm.plant.plant import MeasurementNoise, Plant
from pickenv.arm.plant.tolerances import Tolerances, draw_plants
from pickenv.calibration.identification.least_squares import identify
from pickenv.calibration.model.error_model import ErrorModel, link_model
from pickenv.calibration.model.measurements import Measurements, random_joints, simulated_tracker
from pickenv.envs.shared.task import GOAL_MARGIN
from pickenv.errors import InputError
from pickenv.study.design.config import Noise, Setting, StudyConfig

ARMS, TRACKER, FRUIT, POSES, RESIDUAL = range(5)
"""First part of the key of each random stream."""

MAX_TILT = math.radians(30.0)
"""Fruit are reached for with the tool this near to the vertical, as in `pickenv/Reach-v0`."""

DRAWS = 1000
"""Joints drawn for every fruit before an arm counts as unable to hold its tool upright."""


@dataclass(frozen=True, eq=False)
class Protocol:
    """A study made ready.

    Attributes:
        config: What is studied.
        settings: Its cells.
        design: The plant that arms are drawn from.
        tolerances: Tolerance classes by name.
        model: What least squares identifies.
        fruit: Nominal joints that bring the tool to each fruit ``(M, n)``, rad or m.
        poses: Calibration poses ``(P, n)``, spread evenly; a setting with fewer uses the first ones.
        residual_poses: Poses for learnt residuals ``(R, n)``.
    """

    config: StudyConfig
    settings: tuple[Setting, ...]
    design: Plant
    tolerances: Mapping[str, Tolerances]
    model: ErrorModel
    fruit: Array
    poses: Array
    residual_poses: Array

    @property
    def nominal(self) -> Geometry:
        """What the controller believes."""
        return self.design.arm.nominal

    @cached_property
    def wanted(self) -> Pose:
        """Tool poses at the fruit ``(M,)``."""
        return forward(self.nominal, self.fruit)

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

    def perfect_measurements(self, poses: int, noise: Noise) -> Measurements:
        """What a tracker of this noise would see, if it did not err, of an arm that is as its controller believes."""
        joints = self.poses[:poses]
        pose, tracker = forward(self.nominal, joints), seen_by(self.design, noise)
        return replace(
            simulated_tracker(tracker, joints, np.random.default_rng(0)), position=pose.position, rotation=pose.rotation
        )

    def stream(self, purpose: int, arm: int) -> np.random.Generator:
        """The random numbers of an arm for a purpose: `TRACKER` or `RESIDUAL`."""
        return _stream(self.config, purpose, arm)


def prepared_study(config: StudyConfig) -> Protocol:
    """Load and draw what all arms share.

    Raises:
        InputError: If plant or tolerance class are unknown, poses are too few to calibrate with, or no fruit is found.
    """
    design = config.load_plant()
    nominal = design.arm.nominal
    protocol = Protocol(
        config=config,
        settings=config.settings(),
        design=design,
        tolerances=config.load_tolerances(),
        model=link_model(nominal),
        fruit=_upright_joints(nominal, config.fruit, _stream(config, FRUIT)),
        poses=_spread_joints(nominal, max(config.poses), _stream(config, POSES)),
        residual_poses=_spread_joints(nominal, config.residual_poses, _stream(config, RESIDUAL)),
    )
    for poses in {setting.poses for setting in protocol.settings if setting.poses}:
        identify(protocol.model, nominal, protocol.perfect_measurements(poses, Noise(0.0, 0.0)))  # refuses too few
    return protocol


def seen_by(plant: Plant, noise: Noise) -> Plant:
    """The plant measured by another tracker."""
    return replace(
        plant, measurement_noise=MeasurementNoise(noise.position_mm * 1e-3, math.radians(noise.attitude_deg))
    )


def carrying(plant: Plant, payload_kg: float) -> Plant:
    """The plant with a mass held at its tool; a plant without masses stays as it is."""
    return plant if plant.load is None else replace(plant, load=replace(plant.load, payload=payload_kg))


def _stream(config: StudyConfig, *key: int) -> np.random.Generator:
    return np.random.default_rng(np.random.SeedSequence(config.seed, spawn_key=key))


def _spread_joints(nominal: Geometry, count: int, rng: np.random.Generator) -> Array:
    """Joints ``(count, n)`` spread evenly over the joint ranges: so is every first part of them.

    All arms share them. Drawn at random, a few poses would bend all results of a study by their luck: what dynamic
    errors leave behind least squares depends on the poses more than what a tracker's noise leaves.
    """
    return np.asarray(qmc.scale(qmc.Halton(nominal.joints, rng=rng).random(count), nominal.lower, nominal.upper))


def _upright_joints(nominal: Geometry, count: int, rng: np.random.Generator) -> Array:
    """Joints ``(count, n)`` away from their limits that hold the tool upright, drawn evenly among such joints."""
    margin = GOAL_MARGIN * (nominal.upper - nominal.lower)
    inner = replace(nominal, lower=nominal.lower + margin, upper=nominal.upper - margin)
    found = np.empty((0, nominal.joints))
    for _ in range(DRAWS):
        joints = random_joints(inner, count, rng)
        upright = forward(nominal, joints).rotation[:, 2, 2] >= math.cos(MAX_TILT)
        found = np.concatenate([found, joints[upright]])
        if len(found) >= count:
            return found[:count]
    raise InputError(
        f"of {DRAWS * count} joint poses only {len(found)} hold the tool within {math.degrees(MAX_TILT):.0f} deg of "
        f"the vertical, too few for {count} fruit; give another arm"
    )
