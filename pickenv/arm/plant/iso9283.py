"""Test of the simulated arm by ISO 9283:1998, uncalibrated and calibrated.

Results are pose accuracy AP, repeatability RP, multi-directional accuracy variation vAP and drift dAP. The arm runs
thirty cycles over five poses of the inclined plane of the largest cube in the workspace, at full speed. It is warm,
except in the drift test. AP = |mean - command|. RP = mean distance from the mean + 3 standard deviations.
`pose_performance` and `pose_drift` also compute these values from measurements of a real arm. Units: mm and deg.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from typing import Any

import numpy as np

from pickenv.arm import Array, Geometry, Plant, PlantState, Pose, forward, inverse, load_instrument, pose_error
from pickenv.arm.effects.drives import read_frame
from pickenv.arm.kinematics.forward import pose_of
from pickenv.arm.kinematics.inverse import Cube, largest_cube
from pickenv.arm.plant.campaign import TRACKER, Instrument, Pace, move_time, moved, switched_on
from pickenv.base import Ends, InputError, mean_interval, norm_interval, statistic_interval

Compensate = Callable[[Array], Array]
"""A function from joint targets ``(..., n)`` of the nominal arm to joint commands ``(..., n)`` for the true arm."""

CYCLES = 30
"""Number of cycles in the standard; with fewer, no confidence interval of RP is given."""

ORDER = (4, 3, 2, 1, 0)
"""Indices of the poses in the order of one cycle: P5, P4, P3, P2, P1."""

VARIATION_POSES = (0, 1, 3)
"""Indices of the poses at which vAP is measured: P1, P2 and P4."""

FEWEST_CYCLES = 3
"""Least number of measurements for RP. Two measurements lie equally far from their mean, so their distances do not
scatter."""

NORM_OF_NOISE = 2.0 * math.sqrt(2.0 / math.pi) + 3.0 * math.sqrt(3.0 - 8.0 / math.pi)
"""RP_l of normal noise with standard deviation 1 in each of three axes. The noise's norm has a Maxwell distribution."""


@dataclass(frozen=True)
class Iso9283Settings:
    """Settings of the test by ISO 9283; the defaults are the standard's values if the standard gives them.

    Attributes:
        cycles: Number of measurements per pose.
        pace: Speed, control period and waiting time before each measurement.
        warm_up: Time for which the arm is on before the tests of the warm arm, s.
        approach: Length of the approaches to a pose from three directions, for vAP, m.
        drift_time: Duration of the drift test, s.
        drift_interval: Time between two measurements of the mean pose in the drift test, s.
        drift_cycles: Number of cycles over which each mean pose of the drift test is taken.

    Raises:
        InputError: If a number is out of range.
    """

    cycles: int = CYCLES
    pace: Pace = field(default_factory=lambda: Pace(dwell=2.0))
    warm_up: float = 4 * 3600.0
    approach: float = 0.05
    drift_time: float = 8 * 3600.0
    drift_interval: float = 600.0
    drift_cycles: int = 10

    def __post_init__(self) -> None:
        if self.cycles < 2 or self.drift_cycles < 2:
            raise InputError(f"cycles is {min(self.cycles, self.drift_cycles)}; repeatability needs at least two")
        if not (self.approach > 0 and self.drift_interval > 0 and self.drift_time >= 0 and self.warm_up >= 0):
            raise InputError("approach and drift interval must be above zero, drift time and warm-up not below it")


Performance = dict[str, Any]
"""Test results of the arm under one controller (uncalibrated or calibrated), as a mapping for JSON.

- poses: AP and RP at P1 to P5, each a result of `pose_performance`.
- variation_mm, variation_deg: vAP at P1, P2 and P4: the largest difference between the mean poses of three approach
  directions.
- drift_mm, drift_deg: dAP: the largest change of AP at P1 since the start of the drift test.
- wander_mm: the largest distance of the mean position at P1 from the mean position at the start of the drift test.
- drift_hours, drift_accuracy_mm: the times of the drift measurements, and AP_P at P1 at these times.
- worst_accuracy_mm, worst_repeatability_mm: the largest AP_P and RP_l of the five poses.
"""


@dataclass(frozen=True, eq=False)
class Iso9283Result:
    """Result of a test by ISO 9283.

    Attributes:
        plant: Name of the plant, that is the simulated true arm.
        cube: The cube that contains the test poses.
        settings: Settings of the test.
        instrument_mm: Repeatability RP_l that the laser tracker's noise alone causes at the mean measuring range, mm.
        raw: Results with joint commands for the nominal arm.
        calibrated: Results with compensated joint commands, or None.
    """

    plant: str
    cube: Cube
    settings: Iso9283Settings
    instrument_mm: float
    raw: Performance
    calibrated: Performance | None

    def performances(self) -> dict[str, Performance]:
        """Return the results by name: "raw", and "calibrated" if it was tested."""
        return {"raw": self.raw} | ({"calibrated": self.calibrated} if self.calibrated is not None else {})

    def as_dict(self) -> dict[str, Any]:
        """Return the result as a mapping for JSON; each key ends in the number's unit."""
        s, cube = self.settings, {"centre_mm": (1e3 * self.cube.centre).tolist(), "edge_mm": 1e3 * self.cube.edge}
        settings = {"cycles": s.cycles, "speed_share": s.pace.speed, "dwell_s": s.pace.dwell}
        settings |= {"warm_up_h": s.warm_up / 3600.0, "drift_h": s.drift_time / 3600.0}
        parts = {"standard": "ISO 9283:1998", "plant": self.plant, "settings": settings, "cube": cube}
        return {**parts, "instrument_repeatability_mm": self.instrument_mm, **self.performances()}

    def report(self) -> str:
        """Return the test report as text."""
        s, centre = self.settings, ", ".join(f"{1e3 * value:.0f}" for value in self.cube.centre)
        lines = [
            f"ISO 9283 on the simulated arm {self.plant}: {s.cycles} cycles at {100 * s.pace.speed:.0f} % speed, "
            f"measured {s.pace.dwell:g} s after arrival, on for {s.warm_up / 3600:g} h",
            f"cube of {1e3 * self.cube.edge:.0f} mm about ({centre}) mm"
            + (", its places with any attitude: the arm cannot hold one" if self.cube.free else ""),
            f"the instrument's noise alone would show RP {self.instrument_mm:.3f} mm",
            "figures are of this one simulated arm; intervals of RP are over its cycles"
            + ("" if s.cycles >= CYCLES else f", and need {CYCLES} of them"),
        ]
        for name, performance in self.performances().items():
            lines += [
                "",
                f"{name + ':':<12}{'AP [mm]':>9}{'RP [mm]':>9}  {'95 % of RP':<14}{'AP [deg]':>10}{'RP [deg]':>10}"
                f"{'vAP [mm]':>10}",
            ]
            for pose in performance["poses"]:
                ends, variation = pose["repeatability_ci95_mm"], performance["variation_mm"].get(pose["name"])
                interval = "-" if ends is None else f"{ends[0]:.3f} to {ends[1]:.3f}"
                lines.append(
                    f"{pose['name']:<12}{pose['accuracy_mm']:9.3f}{pose['repeatability_mm']:9.3f}  {interval:<14}"
                    f"{pose['accuracy_deg']:10.4f}{max(pose['repeatability_deg']):10.4f}"
                    + ("" if variation is None else f"{variation:10.3f}")
                )
            lines.append(
                f"drift dAP over {s.drift_time / 3600:g} h: {performance['drift_mm']:.3f} mm, "
                f"{performance['drift_deg']:.4f} deg; the mean position wanders by {performance['wander_mm']:.3f} mm"
            )
        return "\n".join(lines)


def iso9283(
    plant: Plant,
    compensate: Compensate | None = None,
    *,
    rng: np.random.Generator,
    settings: Iso9283Settings | None = None,
    cube: Cube | None = None,
    reference: Geometry | None = None,
) -> Iso9283Result:
    """Test the simulated arm by ISO 9283.

    Args:
        plant: The simulated true arm, a single one.
        compensate: Function from joint targets to joint commands, such as a calibration's compensator. With None, only
            the uncalibrated arm is tested.
        rng: Random generator for the friction of each stop and the instrument's noise. The uncalibrated and the
            calibrated arm get the same random numbers.
        settings: Settings of the test; the standard's settings by default.
        cube: The cube that contains the test poses; the largest cube in the workspace by default.
        reference: The geometry whose forward kinematics turn joint targets into commanded poses; by default the arm's
            nominal geometry. After a calibration that fitted base and tool, give that calibration's nominal geometry.
            The errors of the uncalibrated and of the calibrated arm are both computed against these poses.

    Raises:
        InputError: If a test pose cannot be reached.
    """
    settings, cube = settings or Iso9283Settings(), cube or _largest_cube(plant.arm.nominal)
    seed = int(rng.integers(2**63))
    targets = _joints_for(plant, cube.inclined_plane(), None, cube.free)
    approaches = _approaches(plant, cube.inclined_plane(), targets, settings.approach, cube.free)
    goals = forward(reference or plant.arm.nominal, targets)
    instrument = load_instrument(TRACKER)
    noise, ranges = instrument.noise_on(plant), np.linalg.norm(goals.position - instrument.stand, axis=-1)

    def performance(change: Compensate) -> Performance:
        same = np.random.default_rng(seed)
        return _performance(plant, settings, instrument, change(targets), change(approaches), goals, same)

    scatter = NORM_OF_NOISE * 1e3 * (0.0 if noise is None else float(noise.position_std_at(ranges).mean()))
    raw = performance(lambda joints: joints)
    calibrated = None if compensate is None else performance(compensate)
    return Iso9283Result(plant.name, cube, settings, scatter, raw, calibrated)


def _largest_cube(geometry: Geometry) -> Cube:
    """Return the largest cube that the tool reaches.

    If an arm of fewer than six joints cannot keep one attitude throughout a cube, any attitudes are allowed.
    """
    try:
        return largest_cube(geometry)
    except InputError:
        if geometry.joints >= 6:
            raise
        return largest_cube(geometry, free=True)


def _joints_for(plant: Plant, poses: Pose, start: Array | None, free: bool) -> Array:
    solution = inverse(plant.arm.nominal, poses, start, position_only=free)
    if not solution.reached.all():
        raise InputError(f"arm '{plant.arm.name}' does not reach all test poses of this cube; give another cube")
    return solution.joints


def _approaches(plant: Plant, poses: Pose, targets: Array, length: float, free: bool) -> Array:
    """Return the joints ``(3 poses, 3 directions, n)`` from which P1, P2 and P4 are approached along x, y and z.

    An approach starts on the side of the cube's centre. For P1, which is the centre, it starts at +x, +y or +z.

    Args:
        plant: The simulated true arm.
        poses: The poses P1 to P5.
        targets: Joints at these poses ``(5, n)``, rad or m.
        length: Distance between the start of an approach and the pose, m.
        free: Whether to ignore the attitude.
    """
    some = list(VARIATION_POSES)
    inwards = np.where(poses.position[some] - poses.position[0] > 0, -1.0, 1.0)
    before = poses.position[some][:, None, :] + length * inwards[:, :, None] * np.eye(3)
    rotation = np.broadcast_to(poses.rotation[some][:, None], (*before.shape[:-1], 3, 3))
    start = np.broadcast_to(targets[some][:, None, :], (*before.shape[:-1], targets.shape[-1]))
    return _joints_for(plant, Pose(before, rotation), start, free)


def _performance(
    plant: Plant,
    settings: Iso9283Settings,
    instrument: Instrument,
    commands: Array,
    approaches: Array,
    goals: Pose,
    rng: np.random.Generator,
) -> Performance:
    """Run one controller through all parts of the test, and return the results.

    Args:
        plant: The simulated true arm.
        settings: Numbers of the test.
        instrument: The instrument that measures the poses.
        commands: Joint commands ``(5, n)`` of the poses P1 to P5, rad or m.
        approaches: Joint commands ``(3, 3, n)``, rad or m, at which the three motions to each of three poses start.
        goals: The commanded poses P1 to P5, in world axes.
        rng: Generator of all random draws.
    """
    cycles, pace, home, away = settings.cycles, settings.pace, commands[0], commands[1]
    mounting, noise = rng.spawn(1)[0].normal(size=3).tolist(), instrument.noise_on(plant)

    def measured(state: PlantState, stops: Sequence[tuple[Array, int | None]]) -> tuple[PlantState, Array]:
        """Move from P1 through stops; return the state at the end, and the errors at the measured stops.

        A stop is a joint command and the index, from 0, of the pose to measure there; None to measure nothing. The
        errors are ``(measured stops, 6)``, m and rad.
        """
        errors, start = [], home
        for target, i in stops:
            state, frame = moved(plant, math, state, start, target, pace, normal=rng.normal(size=(2, len(target))))
            start = target
            if i is None:
                continue
            if noise is not None:
                frame = read_frame(math, noise, instrument.stand, frame, rng.normal(size=6).tolist(), mounting)
            errors.append(pose_error(Pose(goals.position[i], goals.rotation[i]), pose_of(frame)))
        return state, np.array(errors)

    warm = switched_on(plant, math, home, settings.warm_up)
    variation_mm, variation_deg = {}, {}
    for pose, starts in zip(VARIATION_POSES, approaches, strict=True):
        stops = [stop for start in starts for stop in ((start, None), (commands[pose], pose)) * cycles]
        _, errors = measured(warm, stops)
        pairs = list(combinations(errors.reshape(len(starts), cycles, 6).mean(axis=1), 2))
        gaps = [max(float(np.linalg.norm((a - b)[part])) for a, b in pairs) for part in (slice(3), slice(3, 6))]
        variation_mm[f"P{pose + 1}"], variation_deg[f"P{pose + 1}"] = 1e3 * gaps[0], math.degrees(gaps[1])

    # The drift at P1, from switching the cold arm on.
    visit = float(move_time(plant, home, away, pace)) + pace.dwell
    state, clock = switched_on(plant, math, home, 0.0), 0.0
    hours, means = [], []
    for k in range(round(settings.drift_time / settings.drift_interval) + 1):
        wait = max(k * settings.drift_interval - clock, 0.0)
        state, clock = plant.carried(math, state, home.tolist(), wait), clock + wait
        hours.append(clock / 3600.0)
        state, errors = measured(state, [(away, None), (home, 0)] * settings.drift_cycles)
        clock += 2.0 * settings.drift_cycles * visit
        means.append(errors.mean(axis=0))
    mean = np.array(means)
    parts = mean[:, :3], mean[:, 3:], mean[:, :3] - mean[0, :3]
    accuracy, turn, wander = (np.linalg.norm(part, axis=-1) for part in parts)

    _, errors = measured(warm, [(commands[i], i) for _ in range(cycles) for i in ORDER])
    errors = errors.reshape(cycles, len(ORDER), 6)
    poses = [pose_performance(f"P{i + 1}", errors[:, ORDER.index(i)]) for i in sorted(ORDER)]
    return {
        **{"poses": poses, "variation_mm": variation_mm, "variation_deg": variation_deg},
        "drift_mm": 1e3 * float(np.abs(accuracy - accuracy[0]).max()),
        "drift_deg": math.degrees(float(np.abs(turn - turn[0]).max())),
        "wander_mm": 1e3 * float(wander.max()),
        **{"drift_hours": hours, "drift_accuracy_mm": (1e3 * accuracy).tolist()},
        "worst_accuracy_mm": max(pose["accuracy_mm"] for pose in poses),
        "worst_repeatability_mm": max(pose["repeatability_mm"] for pose in poses),
    }


def pose_performance(name: str, errors: Array) -> dict[str, Any]:
    """Compute accuracy and repeatability of one pose from its errors.

    Confidence intervals are of 95 % over cycles. An interval is None with fewer than 10 cycles (for RP, fewer than
    `CYCLES`), or if the cycles do not differ.

    Args:
        name: Name of the pose.
        errors: Errors of the cycles ``(cycles, 6)`` in world axes: position, m, then rotation vector, rad, from
            `pose_error`. ``(cycles, 3)`` for positions only.

    Returns:
        A mapping. ``name`` and ``cycles``, the number of cycles. ``accuracy_mm``: AP_P, the distance between the mean
        attained position and the command. ``mean_error_mm``: mean error along x, y, z of the world.
        ``repeatability_mm``: RP_l. With attitudes also ``accuracy_deg``: the angle of the mean rotation vector.
        ``mean_error_deg``: AP_a, AP_b, AP_c, the mean rotation vector in world axes. ``repeatability_deg``: RP_a, RP_b,
        RP_c, three standard deviations about each world axis. The key of an interval has ``ci95`` before the unit.
    """
    figures: dict[str, Any] = {"name": name, "cycles": len(errors)}
    for unit, scale, part in (("mm", 1e3, errors[:, :3]), ("deg", math.degrees(1.0), errors[:, 3:])):
        if part.shape[1]:
            figures[f"accuracy_{unit}"] = scale * _size_of_mean(part)
            figures[f"accuracy_ci95_{unit}"] = norm_interval(scale * part)
            figures[f"mean_error_{unit}"] = (scale * part.mean(axis=0)).tolist()
            figures[f"mean_error_ci95_{unit}"] = [mean_interval(column) for column in scale * part.T]
    figures["repeatability_mm"] = 1e3 * _repeatability(errors)
    figures["repeatability_ci95_mm"] = _interval_of_scatter(errors[:, :3], lambda some: 1e3 * _repeatability(some))
    if errors.shape[1] > 3:
        turns = np.degrees(errors[:, 3:])
        figures["repeatability_deg"] = [_three_deviations(column) for column in turns.T]
        figures["repeatability_ci95_deg"] = [_interval_of_scatter(column, _three_deviations) for column in turns.T]
    return figures


def pose_drift(errors: Array) -> dict[str, Any] | None:
    """Compute the drift of one pose between the first and the last third of its cycles.

    Confidence intervals are of 95 %, over pairs of cycles. Each pair has a cycle of the first third and a cycle of the
    last third. The intervals are None with fewer than ten pairs.

    Args:
        errors: Errors of the cycles in their order ``(cycles, 3 or 6)``, m and rad.

    Returns:
        None with fewer than `FEWEST_CYCLES` cycles per third. Else a mapping. ``cycles``: number of cycles per third.
        ``accuracy_change_mm``: dAP_P, the change of AP_P. ``wander_mm``: distance between the mean positions of the two
        thirds; its interval begins at zero without significant drift. ``repeatability_change_mm``: dRP, the change
        of RP_l; it has no interval, because 10 to 30 distances are too few for a reliable one. The key of an interval
        has ``ci95`` before the unit.
    """
    third = len(errors) // 3
    if third < FEWEST_CYCLES:
        return None
    pairs = 1e3 * np.stack([errors[:third, :3], errors[-third:, :3]], axis=1)
    shift = pairs[:, 1] - pairs[:, 0]

    def change(some: Array) -> float:
        return _size_of_mean(some[:, 1]) - _size_of_mean(some[:, 0])

    return {
        "cycles": third,
        "accuracy_change_mm": change(pairs),
        "accuracy_change_ci95_mm": statistic_interval(pairs, change),
        "wander_mm": _size_of_mean(shift),
        "wander_ci95_mm": norm_interval(shift),
        "repeatability_change_mm": _repeatability(pairs[:, 1]) - _repeatability(pairs[:, 0]),
    }


def _repeatability(errors: Array) -> float:
    """Return RP_l of errors ``(cycles, 3 or 6)``, m: mean distance from the mean position + 3 standard deviations."""
    distance = np.linalg.norm(errors[:, :3] - errors[:, :3].mean(axis=0), axis=-1)
    return float(distance.mean() + 3.0 * distance.std(ddof=1))


def _three_deviations(values: Array) -> float:
    return 3.0 * float(values.std(ddof=1))


def _size_of_mean(vectors: Array) -> float:
    return float(np.linalg.norm(vectors.mean(axis=0)))


def _interval_of_scatter(values: Array, scatter: Callable[[Array], float]) -> Ends | None:
    """Return the 95 % interval of ``scatter(values)``, a measure of scatter such as a standard deviation.

    The interval is computed for the measure's logarithm. It is None with fewer than `CYCLES` values, or if the values
    hardly differ.
    """

    def logarithm(some: Array) -> float:
        size = scatter(some)
        return math.log(size) if size > 1e-9 else math.nan  # less is rounding, of positions and of attitudes

    ends = statistic_interval(values, logarithm, CYCLES)
    return None if ends is None else (math.exp(ends[0]), math.exp(ends[1]))
