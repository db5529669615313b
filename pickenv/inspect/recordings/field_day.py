"""A day in the field: the arm warms up, the machine tilts and sinks, and the morning's calibration knows of neither.

Every policy gives the commands that it gave on firm ground. Beside the last one stands what a Kalman filter makes of
it that looks at the tool once per pick: what a machine has to do that wants to keep its accuracy. SI units.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from pickenv.arm import Array, Geometry, Plant, forward, joint_jacobian, load_plant
from pickenv.arm.effects.drives import MeasurementNoise
from pickenv.arm.kinematics.forward import split_joints
from pickenv.base import stream
from pickenv.calibration import complete_model, start_filter
from pickenv.calibration.compensation.compensator import aimed, taught
from pickenv.inspect.runs.recorded_episodes import Comparison

DRIFTS = ("thermal_growth", "base_tilt")
DRIFTING_PLANT = "orchard"
"""The preset that tells how an arm drifts, where the plant itself does not drift."""
DAY_HOURS = 8.0
CAMERA_STD = 1e-3
"""Of one look at the tool, per axis, m."""
LOOK = MeasurementNoise(float(np.hypot(CAMERA_STD, 0.5e-3)), 0.0)
"""What a filter is told of it: with half a millimetre that a geometry cannot explain."""
PRIOR, WALK = 0.2, 0.3
"""Of the filter: what a calibration leaves, in tolerances, and how far parameters wander per root hour."""
FILTERED = 10
"""Machines with a filter at most: it costs more than all the rest of a recording."""
FEWEST_LOOKS = 10
"""With fewer reaches a day is too short to learn from, and too few joints tell what a filter can know."""


ADAPTED = "adapted"
"""Key of the line with the filter."""


@dataclass(frozen=True, eq=False)
class Day:
    """A day in the field: the same reaches while the arm warms up and the machine tilts and sinks.

    Attributes:
        plant: Name of the preset whose drift it is.
        hours: Time of each reach since the machine was switched on ``(R,)``.
        errors_mm: By policy, position error of every reach at every time ``(R times, R reaches)``.
        adapted_mm: The same of the last policy's commands with a filter on top ``(R times, M machines)``, each of
            which begins with another reach; None where the reaches are too few.
    """

    plant: str
    hours: Array
    errors_mm: Mapping[str, Array]
    adapted_mm: Array | None = None

    def lines(self, labels: Mapping[str, str]) -> dict[str, tuple[str, Array]]:
        """Label and errors ``(R times, any)`` of each line that is drawn, by key, given the policies' labels."""
        drawn = {key: (labels[key], errors) for key, errors in self.errors_mm.items()}
        if self.adapted_mm is not None:
            drawn[ADAPTED] = (f"{list(labels.values())[-1]}, adapted", self.adapted_mm)
        return drawn

    def explanation(self, labels: Mapping[str, str]) -> str:
        """What happens here and why, in Markdown, with the mean errors of the day."""
        lines = self.lines(labels)
        rows = [f"| {label} | {errors.mean():.2f} |" for label, errors in lines.values()]
        first, last = (list(self.errors_mm)[i] for i in (0, -1))
        before, after = (float(lines[key][1].mean()) for key in (first, last))
        parts = [
            f"# {self.hours[-1]:g} hours without a new calibration",
            "The arm was calibrated cold and on firm ground. Then it warms up, and the machine tilts and sinks as in "
            f"`{self.plant}`. Each policy repeats the commands that it gave in the morning, without looking.",
            "\n".join(["| policy | mean of the day (mm) |", "|---|---|", *rows]),
        ]
        if first != last:
            worth = "no better than" if after >= before else f"{before - after:.2f} mm better than"
            parts.append(
                f"{labels[last]} ends {worth} {labels[first]}: the drift was in nobody's data, and it is larger than "
                "the errors that a calibration takes away."
            )
        if self.adapted_mm is not None:
            parts.append(
                f"**{lines[ADAPTED][0]}**: the same commands on {self.adapted_mm.shape[1]} machines with a Kalman "
                f"filter. It looks at the tool once per pick ({1e3 * CAMERA_STD:g} mm per axis) and corrects the next "
                "pick: in the field a calibration has to go on."
            )
        return "\n\n".join(parts)


def drifting_plant(plant: Plant) -> Plant | None:
    """The plant with its own drift or, where it has none, with that of the preset `orchard` if it is the same arm."""
    if any(plant.effect(name) is not None for name in DRIFTS):
        return plant
    preset = load_plant(DRIFTING_PLANT)
    if plant.arm.fingerprint() != preset.arm.fingerprint():
        return None
    drifting = plant.with_effect(*(preset.effect(name) for name in DRIFTS))
    return replace(drifting, name=preset.name, load=plant.load or preset.load)


def day_of(comparison: Comparison, hours: float = DAY_HOURS) -> Day | None:
    """Let the drifting plant make the comparison's reaches all day, with the commands that the policies gave.

    R machines start together, each with another fruit, and go through all fruit in the same order: so every fruit is
    reached at every time, by a machine that has been as busy as the others.
    """
    plant, count = drifting_plant(comparison.plant), len(comparison.fruit)
    if plant is None or not count:
        return None
    dt = 3600.0 * hours / count
    errors, machines = {}, np.arange(count)
    for policy in comparison.policies:
        rows, commands = np.empty((count, count)), policy.ends.joint_command
        state = plant.initial_state(np, split_joints(plant.geometry.joints, commands))
        for k in range(count):
            turn = (machines + k) % count
            state, tool = _driven(plant, state, commands[turn], dt)
            rows[k, turn] = 1e3 * np.linalg.norm(tool - comparison.fruit[turn], axis=-1)
        errors[policy.key] = rows
    adapted = _adapted(comparison, plant, dt) if count >= FEWEST_LOOKS else None
    return Day(plant.name, (machines + 1.0) * hours / count, errors, adapted)


def _driven(plant: Plant, state: Any, joints: Array, dt: float) -> tuple[Any, Array]:
    """States of machines after a pick, and where their tools stand ``(M, 3)``."""
    state, frame = plant.advance(np, state, split_joints(plant.geometry.joints, joints), dt)
    return state, np.stack(np.broadcast_arrays(*frame[9:12]), axis=-1)


def _adapted(comparison: Comparison, plant: Plant, dt: float) -> Array:
    """Position errors, mm, ``(R, M)`` of machines whose filters correct the last policy's commands.

    A filter takes the arm behind these commands for the nominal one (as `AdaptiveReach` does behind a compensator):
    its joints are those at which the nominal tool is at the fruit, and its correction is added to the command.
    """
    nominal, count = comparison.nominal, len(comparison.fruit)
    commands = comparison.policies[-1].ends.joint_command
    intended = joints_at(nominal, commands, comparison.fruit)
    starts = np.unique(np.linspace(0, count, FILTERED, endpoint=False).astype(np.int64))
    first = start_filter(complete_model(nominal), nominal, intended, full_pose=False, prior=PRIOR)
    filters = [first] * len(starts)
    rng = np.random.default_rng(stream(comparison.seed, "day"))
    state = plant.initial_state(np, split_joints(nominal.joints, commands[starts]))
    errors = np.empty((count, len(starts)))
    for k in range(count):
        turn = (starts + k) % count
        joints = aimed(nominal, filters, intended[turn])
        given = np.clip(commands[turn] + joints - intended[turn], nominal.lower, nominal.upper)
        state, tool = _driven(plant, state, given, dt)
        errors[k] = 1e3 * np.linalg.norm(tool - comparison.fruit[turn], axis=-1)
        seen = tool + CAMERA_STD * rng.standard_normal(tool.shape)
        filters = taught(filters, joints, seen, LOOK, WALK, dt)
    return errors


def joints_at(geometry: Geometry, joints: Array, points: Array) -> Array:
    """Joints ``(N, n)`` close to given ones at which the tool is at given points ``(N, 3)``, m: two Newton steps.

    From joints that err by millimetres these leave nanometres.
    """
    for _ in range(2):
        gap = points - forward(geometry, joints).position
        inverse = np.linalg.pinv(joint_jacobian(geometry, joints)[:, :3])
        joints = joints + np.einsum("nij,nj->ni", inverse, gap)
    return joints
