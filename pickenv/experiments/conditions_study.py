"""How a calibration's accuracy changes with payload, temperature and hour of day: the future work of Qiao 2026.

An arm is calibrated in two ways: as usual, at the reference (empty, cool, in the morning), and over sessions under
other conditions, which are recorded. The records can be inputs of terms (payload: weight; temperature: growth) and of a
learnt residual (payload, temperature, hour). All calibrations are judged on poses and conditions that no fit has seen.

The arm is moved to every pose from another one and held for a minute, so friction and backlash are in what is measured.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any, TypeAlias

import numpy as np

from pickenv.arm import Array, Plant, displace_pose, draw_plants, load_tolerances, plant_at
from pickenv.arm.effects.drives import ThermalGrowth, warmed
from pickenv.arm.kinematics.forward import pose_of, split_joints
from pickenv.base import InputError, estimate
from pickenv.base.intervals import LEAST
from pickenv.calibration import Calibration, Measurements, random_joints
from pickenv.calibration.identification.least_squares import identify_converged
from pickenv.calibration.identification.term_choice import identify_terms, plain_term
from pickenv.calibration.model.arm_model import ArmModel, Conditions, link_model
from pickenv.calibration.model.measurements import ATTITUDE_STD, POSITION_STD
from pickenv.calibration.residuals.residual_models import LearntResidual, fit_residual, require_residual
from pickenv.experiments.engine import Experiment, Progress, Rows, joined, run
from pickenv.inspect.reports.conditions_report import HELD_OUT

HELD = 60.0
"""Time for which the arm stands at a pose before it is measured, s."""
LEVELS = 5
"""Number of levels of each condition at which a calibration is judged."""
REFERENCE, BLIND, TOLD, TERMS, BOTH = (
    "calibrated at the reference",
    "over sessions, not told",
    "network told",
    "terms told",
    "terms and network told",
)
METHODS = ("raw", REFERENCE, BLIND, TOLD, TERMS, BOTH)


@dataclass(frozen=True)
class ConditionRanges:
    """Ranges of the conditions that an arm may meet at work.

    Attributes:
        payload: Largest mass held at the tool, kg.
        weather: How much cooler or warmer than usual a day may be, K.
        hours: Length of a working day, h.
    """

    payload: float = 0.5
    weather: float = 10.0
    hours: float = 8.0


@dataclass(frozen=True)
class ConditionsSettings:
    """Settings of the study: conditions, arms and numbers of measurements.

    Attributes:
        ranges: Ranges of the conditions.
        arms: Arms drawn from the tolerance class.
        tolerances: Name of the tolerance class.
        sessions: Training sessions, each under conditions of its own.
        poses: Poses of a session; at the reference an arm is measured at as many as in all sessions together.
        residual: Residual model by name.
        seed: Seed of everything random.
    """

    ranges: ConditionRanges = ConditionRanges()
    arms: int = 10
    tolerances: str = "medium"
    sessions: int = 12
    poses: int = 25
    residual: str = "rbf"
    seed: int = 0


@dataclass(frozen=True, eq=False)
class State:
    """Conditions of poses, each ``(N,)``.

    Attributes:
        payload: Mass held at the tool, kg.
        weather: How much warmer than usual the day is, K.
        hour: Time since the start of work, h.
    """

    payload: Array
    weather: Array
    hour: Array

    @staticmethod
    def same(count: int, **known: float) -> State:
        """The reference conditions at ``count`` poses, except for the conditions given in ``known``."""
        return State(*(np.full(count, known.get(name, 0.0)) for name in ("payload", "weather", "hour")))

    @staticmethod
    def drawn(ranges: ConditionRanges, sessions: int, poses: int, rng: np.random.Generator) -> State:
        """The states of random sessions, pose by pose; sessions spread evenly over every range (a Latin hypercube)."""
        share = (np.array([rng.permutation(sessions) for _ in range(3)]) + rng.random((3, sessions))) / sessions
        low = np.array([0.0, -ranges.weather, 0.0])[:, None]
        high = np.array([ranges.payload, ranges.weather, ranges.hours])[:, None]
        return State(*np.repeat(low + (high - low) * share, poses, axis=1))


def warming(plant: Plant) -> Plant:
    """The plant, with the growth of its tolerance class "medium" where it has none of its own."""
    if plant.effect("thermal_growth") is not None:
        return plant
    usual = load_tolerances("medium")
    assert usual.sizes is not None
    expansion = (usual.sizes.expansion,) * plant.geometry.joints
    return plant.with_effect(ThermalGrowth(expansion, 0.0, usual.temperature_rise[1], usual.sizes.warm_up))


def rises(plant: Plant, state: State) -> Array:
    """Temperature of the links above the reference ``(N,)``, K: the day's warm-up plus the weather."""
    thermal = plant.effect("thermal_growth")
    return np.asarray(warmed(np, thermal, thermal.initial_rise, 3600.0 * state.hour) + state.weather)


def under(plant: Plant, state: State) -> Plant:
    """The plant in the state of each pose; what the state changes has one entry per pose."""
    rise, tilt = rises(plant, state), plant.effect("base_tilt")
    changed = [replace(plant.effect("thermal_growth"), initial_rise=rise, final_rise=rise)]
    if tilt is not None:  # sunk as far as it is by then, and no further while a pose is measured
        sunk = 1.0 - np.exp(-3600.0 * state.hour / tilt.time_constant)
        creep, settlement = tilt.creep * sunk, tilt.settlement * sunk
        changed.append(replace(tilt, creep=creep, settlement=settlement, time_constant=1e-3 * HELD))
    load = None if plant.load is None else replace(plant.load, payload=state.payload)
    return replace(plant.with_effect(*changed), load=load)


def measured_under(plant: Plant, state: State, rng: np.random.Generator) -> Measurements:
    """Tracker readings of the plant in these states, payload and heat recorded; each pose is reached from another."""
    nominal, count = plant.arm.nominal, len(state.payload)
    joints, before = random_joints(nominal, count, rng), random_joints(nominal, count, rng)
    machine = under(plant, state)
    at_rest = machine.initial_state(np, split_joints(nominal.joints, before))
    _, frame = machine.advance(np, at_rest, split_joints(nominal.joints, joints), HELD)
    spread = np.repeat([POSITION_STD, ATTITUDE_STD], 3) if plant.effect("measurement_noise") else np.zeros(6)
    pose = displace_pose(pose_of(frame), rng.normal(size=(count, 6)) * spread)
    return Measurements(
        joints,
        pose.position,
        pose.rotation,
        nominal.prismatic,
        source=f"simulated tracker on plant {plant.name}",
        conditions=Conditions(payload=state.payload, temperature=rises(plant, state)),
        frames="known",
    )


Left: TypeAlias = Callable[[Measurements, State], Array]
"""The pose errors ``(N, 6)`` that a calibration leaves of what was measured in these states, m and rad."""


def left_by(
    data: Measurements, state: State, *, model: ArmModel, learnt: LearntResidual | None = None, inputs: bool = False
) -> Array:
    """What geometry and terms leave, and a learnt residual, which may take payload, temperature and hour as inputs."""
    missed = data.difference(model)
    return missed if learnt is None else missed - learnt.predict(data.joints, told(data, state) if inputs else None)


def told(data: Measurements, state: State) -> Array:
    """Payload, temperature and hour as columns ``(N, 3)``."""
    inputs = data.conditions.inputs()
    assert inputs is not None
    return np.column_stack([inputs, state.hour])


def calibrated(plant: Plant, settings: ConditionsSettings, rng: np.random.Generator) -> dict[str, Left]:
    """The arm calibrated in every way, each from the same number of poses, by method."""
    arm, nominal = plant.arm, plant.arm.nominal
    apart = State.drawn(settings.ranges, settings.sessions, settings.poses, rng)
    varied, usual = measured_under(plant, apart, rng), measured_under(plant, State.same(len(apart.hour)), rng)
    model = link_model(nominal)
    cold, bare = (identify_converged(model, ArmModel.of(nominal), [data]) for data in (usual, varied))
    terms = tuple(plain_term(name, arm, varied) for name in ("gravity", "thermal"))
    knowing = identify_terms(terms, bare, varied, known=True).arm_model

    def learnt(believed: ArmModel, data: Measurements, inputs: Array | None = None) -> LearntResidual:
        errors = data.difference(believed)
        return fit_residual(settings.residual, data.joints, errors, data.prismatic, rng, conditions=inputs)

    inputs = told(varied, apart)
    return {
        "raw": partial(left_by, model=ArmModel.of(nominal)),
        REFERENCE: partial(left_by, model=cold.arm_model, learnt=learnt(cold.arm_model, usual)),
        BLIND: partial(left_by, model=bare.arm_model, learnt=learnt(bare.arm_model, varied)),
        TOLD: partial(left_by, model=bare.arm_model, learnt=learnt(bare.arm_model, varied, inputs), inputs=True),
        TERMS: partial(left_by, model=knowing),
        BOTH: partial(left_by, model=knowing, learnt=learnt(knowing, varied, inputs), inputs=True),
    }


def levels_of(ranges: ConditionRanges) -> dict[str, Array]:
    """Levels of each varied condition, by name; a condition whose range is zero is left out."""
    ends = {"payload": (0.0, ranges.payload), "temperature": (-ranges.weather, ranges.weather)}
    ends["hour"] = (0.0, ranges.hours)
    return {name: np.linspace(low, high, LEVELS) for name, (low, high) in ends.items() if high > low}


def state_at(condition: str, level: float, count: int) -> State:
    """The reference conditions at ``count`` poses, with one condition at ``level``."""
    return State.same(count, **{"weather" if condition == "temperature" else condition: level})


def judged_on(
    plant: Plant, calibrations: Mapping[str, Left], settings: ConditionsSettings, rng: np.random.Generator
) -> Rows:
    """Errors left at new poses under held-out conditions: a row for each sweep, level, method and pose."""
    levels, count = levels_of(settings.ranges), 2 * settings.poses
    states = [(name, k, state_at(name, level, count)) for name in levels for k, level in enumerate(levels[name])]
    parts = []
    for sweep, level, state in [*states, (HELD_OUT, 0, None)]:
        state = state or State.drawn(settings.ranges, settings.sessions, settings.poses, rng)
        data = measured_under(plant, state, rng)
        for method, errors in calibrations.items():
            place = {"sweep": sweep, "level": level, "method": method}
            error_mm = 1e3 * np.linalg.norm(errors(data, state)[:, :3], axis=1)
            columns = {name: np.full(len(error_mm), value) for name, value in place.items()}
            parts.append(Rows(columns | {"pose": np.arange(len(error_mm)), "error_mm": error_mm}))
    return joined(parts)


def judged_arm(
    rng: np.random.Generator, arm: int, plants: Plant, settings: ConditionsSettings, calibration: Calibration | None
) -> Rows:
    """Judge one drawn arm, calibrated in every way, or the very arm that a calibration is of.

    Args:
        rng: Not used: every arm has the stream of the study's seed and its number.
        arm: Its number.
        plants: The drawn arms, or the one arm of the calibration.
        settings: What is measured.
        calibration: Judged instead of the calibrations made here.
    """
    if calibration is not None:
        both: dict[str, Left] = {"raw": partial(left_by, model=ArmModel.of(plants.arm.nominal))}
        both["this calibration"] = lambda data, state: calibration.errors(data)
        return judged_on(plants, both, settings, _stream(settings.seed))
    rng_of_arm, plant = _stream(settings.seed, 1 + arm), plant_at(plants, arm)
    return judged_on(plant, calibrated(plant, settings, rng_of_arm), settings, rng_of_arm)


def _stream(seed: int, *place: int) -> np.random.Generator:
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=place))


def conditions_study(
    plant: Plant, settings: ConditionsSettings, calibration: Calibration | None = None, progress: Progress | None = None
) -> dict[str, Any]:
    """How accuracy changes with payload, temperature and hour, as numbers for table, figure and page.

    Args:
        plant: The design that arms are drawn from; with a calibration, the very arm that it is of.
        settings: What is measured.
        calibration: Judged instead of the calibrations made here.
        progress: Told the stage, how many arms are done, and of how many.

    Returns:
        ``{"plant", "settings", "interval_over", "sweeps": {name: {"levels", "methods": {method: [{"mean_mm",
        "ci95_mm"}]}}}}``.

    Raises:
        InputError: If the plant has no masses for a payload to join, the residual model is unknown, or the calibration
            is another arm's.
    """
    if plant.load is None and settings.ranges.payload > 0.0:
        raise InputError(
            f"plant '{plant.name}' has no link masses, so a payload changes nothing; give `payload=0`, or a plant with "
            "a [load]"
        )
    require_residual(settings.residual)
    plants, arms, over = warming(plant), 1, "pose"
    if calibration is not None:
        calibration.refuse_another(plant.arm)
    else:
        tolerances, arms, over = load_tolerances(settings.tolerances), settings.arms, "arm"
        plants = draw_plants(plants, tolerances, arms, _stream(settings.seed, 0))
    measure = partial(judged_arm, plants=plants, settings=settings, calibration=calibration)
    rows = run(Experiment("arms", {"arm": range(arms)}, {}, measure, settings.seed), progress=progress)
    levels = {name: values.tolist() for name, values in levels_of(settings.ranges).items()} | {HELD_OUT: [0.0]}
    sweeps: dict[str, Any] = {name: {"levels": levels[name], "methods": {}} for name in levels}
    for number in estimate(rows.columns, "error_mm", by=("sweep", "method", "level"), over=(over,)):
        mean = number["estimate"]
        by_level = sweeps[number["sweep"]]["methods"].setdefault(number["method"], [])
        by_level.append({"mean_mm": mean.value, "ci95_mm": mean.ci95})
    few = f"none: {arms} of at least {LEAST} arms"
    return {
        "plant": plant.name,
        "simulated": True,
        "settings": asdict(settings),
        "growth": "the plant's own" if plant.effect("thermal_growth") else "as in the tolerance class medium",
        "interval_over": "arms" if calibration is None else "poses of one arm",
        "no_interval": few if calibration is None and arms < LEAST else "",
        "sweeps": sweeps,
    }
