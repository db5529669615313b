"""Study how a calibration's accuracy changes with payload, temperature and hour of day (future work of Qiao 2026).

Measurements are made in two ways: at the reference (no payload, usual temperature, start of work), and in sessions
under other conditions, which are recorded. The recorded conditions can be inputs of parametric terms (payload: weight;
temperature: thermal growth) and of a learnt residual (payload, temperature, hour). All calibrations are judged at poses
and under conditions that no fit has used.

The arm moves to every pose from another pose, and stays there for a minute. The measurements thus include friction and
backlash.
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
from pickenv.inspect.colours import in_words
from pickenv.inspect.reports.conditions_report import HELD_OUT

HELD = 60.0
"""Time for which the arm stays at a pose before it is measured, s."""
LEVELS = 5
"""Number of values of each condition at which a calibration is judged."""
REFERENCE, BLIND, TOLD, TERMS, BOTH = (
    "calibrated at the reference",
    "over sessions, not told",
    "network told",
    "terms told",
    "terms and network told",
)
NETWORKS = ("bpnn", "rbf")
"""Residual models that method names call "network". Any other residual model appears by its own name."""


RANGES = ("payload", "weather", "hours")
"""Names of the settings that bound the ranges of the conditions."""


@dataclass(frozen=True)
class ConditionsSettings:
    """Settings of the study: arms, the conditions that they may meet at work, and numbers of measurements.

    Attributes:
        payload: Largest mass held at the tool, kg.
        weather: Largest deviation of a day's temperature from the usual one, K, in either direction.
        hours: Length of a working day, h.
        arms: Number of arms drawn from the tolerance class.
        tolerances: Name of the tolerance class.
        sessions: Number of training sessions. In each session the conditions are constant and differ from other
            sessions.
        poses: Number of poses of a session. At the reference an arm is measured at ``sessions * poses`` poses.
        residual: Name of the residual model.
        seed: Seed of all random numbers.
    """

    payload: float = 0.5
    weather: float = 10.0
    hours: float = 8.0
    arms: int = 10
    tolerances: str = "medium"
    sessions: int = 12
    poses: int = 25
    residual: str = "rbf"
    seed: int = 0


@dataclass(frozen=True, eq=False)
class State:
    """Conditions at N poses; each attribute has shape ``(N,)``.

    Attributes:
        payload: Mass held at the tool, kg.
        weather: Temperature of the day minus the usual one, K.
        hour: Time since the start of work, h.
    """

    payload: Array
    weather: Array
    hour: Array

    @staticmethod
    def same(count: int, **known: float) -> State:
        """Return the same conditions at ``count`` poses: the values in ``known``, and 0 (the reference) for all others.

        The conditions are "payload" in kg, "temperature" (the day's deviation) in K and "hour" in h.
        """
        return State(*(np.full(count, known.get(name, 0.0)) for name in ("payload", "temperature", "hour")))

    @staticmethod
    def drawn(settings: ConditionsSettings, rng: np.random.Generator) -> State:
        """Draw constant conditions for each session, and return the conditions at all poses, session by session.

        The result has ``sessions * poses`` entries. The sessions are a Latin hypercube over the ranges in ``settings``.
        """
        count = settings.sessions
        share = (np.array([rng.permutation(count) for _ in range(3)]) + rng.random((3, count))) / count
        low = np.array([0.0, -settings.weather, 0.0])[:, None]
        high = np.array([settings.payload, settings.weather, settings.hours])[:, None]
        return State(*np.repeat(low + (high - low) * share, settings.poses, axis=1))


def warming(plant: Plant) -> Plant:
    """Return a plant (the true arm with its errors) that has thermal growth.

    A plant without thermal growth gets the growth of the tolerance class "medium"; any other plant is returned
    unchanged.
    """
    if plant.effect("thermal_growth") is not None:
        return plant
    usual = load_tolerances("medium")
    assert usual.sizes is not None
    expansion = (usual.sizes.expansion,) * plant.geometry.joints
    return plant.with_effect(ThermalGrowth(expansion, 0.0, usual.temperature_rise[1], usual.sizes.warm_up))


def rises(plant: Plant, state: State) -> Array:
    """Return how much warmer a plant's links are than at the reference ``(N,)``, K.

    This is the sum of the warm-up since the start of work and of the day's deviation from the usual temperature.
    """
    thermal = plant.effect("thermal_growth")
    return np.asarray(warmed(np, thermal, thermal.initial_rise, 3600.0 * state.hour) + state.weather)


def under(plant: Plant, state: State) -> Plant:
    """Return a plant (the true arm) under the conditions of N poses.

    Parameters that depend on payload, temperature or hour become arrays ``(N,)``, with one entry per pose.
    """
    rise, tilt = rises(plant, state), plant.effect("base_tilt")
    changed = [replace(plant.effect("thermal_growth"), initial_rise=rise, final_rise=rise)]
    if tilt is not None:  # sunk as far as it is by then, and no further while a pose is measured
        sunk = 1.0 - np.exp(-3600.0 * state.hour / tilt.time_constant)
        creep, settlement = tilt.creep * sunk, tilt.settlement * sunk
        changed.append(replace(tilt, creep=creep, settlement=settlement, time_constant=1e-3 * HELD))
    load = None if plant.load is None else replace(plant.load, payload=state.payload)
    return replace(plant.with_effect(*changed), load=load)


def measured_under(plant: Plant, state: State, rng: np.random.Generator) -> Measurements:
    """Simulate tracker readings of a plant (the true arm) at random poses, one for each entry of ``state``.

    The arm moves to each pose from another random pose. The measurements include payload and temperature, but not the
    hour.
    """
    nominal, count = plant.arm.nominal, len(state.payload)
    joints, before = random_joints(nominal, count, rng), random_joints(nominal, count, rng)
    machine = under(plant, state)
    at_rest = machine.initial_state(np, split_joints(nominal.joints, before))
    _, frame = machine.advance(np, at_rest, split_joints(nominal.joints, joints), HELD)
    spread = np.repeat([POSITION_STD, ATTITUDE_STD], 3) if plant.effect("measurement_noise") else np.zeros(6)
    pose = displace_pose(pose_of(frame), rng.normal(size=(count, 6)) * spread)
    source = f"simulated tracker on plant {plant.name}"
    conditions = Conditions(payload=state.payload, temperature=rises(plant, state))
    seen = joints, pose.position, pose.rotation, nominal.prismatic
    return Measurements(*seen, source=source, conditions=conditions, frames="known")


Left: TypeAlias = Callable[[Measurements, State], Array]
"""Function of N measurements and their conditions; it returns the pose errors that a calibration leaves ``(N, 6)``, m
and rad."""


def left_by(
    data: Measurements, state: State, *, model: ArmModel, learnt: LearntResidual | None = None, inputs: bool = False
) -> Array:
    """Return measured minus predicted poses ``(N, 6)``, m and rad, for a model with or without a learnt residual.

    Args:
        data: The measurements.
        state: Conditions of the measurements.
        model: Identified geometry and parametric terms.
        learnt: The learnt residual, or None.
        inputs: Whether the residual takes payload, temperature and hour as inputs.
    """
    missed = data.difference(model)
    return missed if learnt is None else missed - learnt.predict(data.joints, told(data, state) if inputs else None)


def told(data: Measurements, state: State) -> Array:
    """Return inputs of a learnt residual as columns ``(N, 3)``: payload, kg, temperature rise, K, and hour, h."""
    inputs = data.conditions.inputs()
    assert inputs is not None
    return np.column_stack([inputs, state.hour])


def calibrated(plant: Plant, settings: ConditionsSettings, rng: np.random.Generator) -> dict[str, Left]:
    """Calibrate a true arm by every method, each from the same number of poses.

    Returns:
        For each method and for "raw" (the uncalibrated arm), by name, a function of measurements and their conditions
        that returns the remaining pose errors (`Left`).
    """
    arm, nominal = plant.arm, plant.arm.nominal
    apart = State.drawn(settings, rng)
    varied, usual = measured_under(plant, apart, rng), measured_under(plant, State.same(len(apart.hour)), rng)
    model = link_model(nominal)
    cold, bare = (identify_converged(model, ArmModel.of(nominal), [data]) for data in (usual, varied))
    terms = tuple(plain_term(name, arm, varied) for name in ("gravity", "thermal"))
    knowing = identify_terms(terms, bare, varied, known=True).arm_model

    def learning(model: ArmModel, data: Measurements, inputs: Array | None = None) -> Left:
        """Learn a residual of ``model`` from ``data``, and return the errors that both together leave, as a `Left`.

        ``inputs`` are the residual's inputs besides the joints, from `told`; None for none.
        """
        errors = data.difference(model)
        learnt = fit_residual(settings.residual, data.joints, errors, data.prismatic, rng, conditions=inputs)
        return partial(left_by, model=model, learnt=learnt, inputs=inputs is not None)

    inputs = told(varied, apart)
    learner = "network" if settings.residual in NETWORKS else in_words(settings.residual)
    return {
        "raw": partial(left_by, model=ArmModel.of(nominal)),
        REFERENCE: learning(cold.arm_model, usual),
        BLIND: learning(bare.arm_model, varied),
        TOLD.replace("network", learner): learning(bare.arm_model, varied, inputs),
        TERMS: partial(left_by, model=knowing),
        BOTH.replace("network", learner): learning(knowing, varied, inputs),
    }


def levels_of(settings: ConditionsSettings) -> dict[str, Array]:
    """Return the values of each condition at which calibrations are judged, by "payload", "temperature" and "hour".

    The units are kg, K above the usual temperature, and h. A condition whose range is a single value is left out.
    """
    weather = settings.weather
    ends = {"payload": (0.0, settings.payload), "temperature": (-weather, weather), "hour": (0.0, settings.hours)}
    return {name: np.linspace(low, high, LEVELS) for name, (low, high) in ends.items() if high > low}


def judged_on(
    plant: Plant, calibrations: Mapping[str, Left], settings: ConditionsSettings, rng: np.random.Generator
) -> Rows:
    """Compute the position errors that calibrations leave at poses and conditions that no fit has used.

    A sweep sets one condition to each of the values of `levels_of`, with the other conditions at the reference. A
    further sweep, `HELD_OUT`, draws all conditions at random.

    Args:
        plant: The true arm.
        calibrations: For each method, by name, the function from `calibrated`.
        settings: Settings of the study.
        rng: Random numbers for conditions, poses and tracker.

    Returns:
        One row for each sweep, value of its condition, method and pose, with "error_mm". "level" is the index of the
        value, from 0.
    """
    states = [
        (name, number, State.same(2 * settings.poses, **{name: level}))
        for name, levels in levels_of(settings).items()
        for number, level in enumerate(levels)
    ]
    parts = []
    for sweep, level, state in [*states, (HELD_OUT, 0, None)]:
        state = state or State.drawn(settings, rng)
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
    """Return the rows of `judged_on` for one arm: with all methods of calibration, or with one given calibration.

    Args:
        rng: Not used; every arm has a random stream from the study's seed and the arm's index.
        arm: Index of the arm among the drawn ones, from 0.
        plants: The drawn true arms, as one plant with arrays over arms; with ``calibration``, the true arm that the
            calibration belongs to.
        settings: Settings of the study.
        calibration: If given, only this calibration and the raw arm are judged.
    """
    if calibration is not None:
        raw = partial(left_by, model=ArmModel.of(plants.arm.nominal))
        both: dict[str, Left] = {"raw": raw, "this calibration": lambda data, state: calibration.errors(data)}
        return judged_on(plants, both, settings, _stream(settings.seed))
    rng_of_arm, plant = _stream(settings.seed, 1 + arm), plant_at(plants, arm)
    return judged_on(plant, calibrated(plant, settings, rng_of_arm), settings, rng_of_arm)


def _stream(seed: int, *place: int) -> np.random.Generator:
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=place))


def conditions_study(
    plant: Plant, settings: ConditionsSettings, calibration: Calibration | None = None, progress: Progress | None = None
) -> dict[str, Any]:
    """Compute how accuracy changes with payload, temperature and hour, as numbers for table, figure and page.

    Args:
        plant: The plant that arms are drawn from; with ``calibration``, the true arm that the calibration belongs to.
        settings: Settings of the study.
        calibration: If given, only this calibration and the raw arm are judged, and no arms are drawn.
        progress: Called with (name of the experiment, arms done, total number of arms).

    Returns:
        A mapping for JSON: ``{"plant", "settings", "interval_over", "sweeps": {name: {"levels", "methods": {method:
        [{"mean_mm", "ci95_mm"}]}}}}`` and further keys. A method has one entry per level of the sweep.

    Raises:
        InputError: If the plant has no link masses for a payload to act on, the residual model is unknown, or the
            calibration belongs to another arm.
    """
    if plant.load is None and settings.payload > 0.0:
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
    levels = {name: values.tolist() for name, values in levels_of(settings).items()} | {HELD_OUT: [0.0]}
    sweeps: dict[str, Any] = {name: {"levels": levels[name], "methods": {}} for name in levels}
    for number in estimate(rows.columns, "error_mm", by=("sweep", "method", "level"), over=(over,)):
        mean = number["estimate"]
        by_level = sweeps[number["sweep"]]["methods"].setdefault(number["method"], [])
        by_level.append({"mean_mm": mean.value, "ci95_mm": mean.ci95})
    few = f"none: {arms} of at least {LEAST} arms"
    asked = asdict(settings)
    return {
        "plant": plant.name,
        "simulated": True,
        "settings": {"ranges": {name: asked.pop(name) for name in RANGES}, **asked},
        "growth": "the plant's own" if plant.effect("thermal_growth") else "as in the tolerance class medium",
        "interval_over": "arms" if calibration is None else "poses of one arm",
        "no_interval": few if calibration is None and arms < LEAST else "",
        "sweeps": sweeps,
    }
