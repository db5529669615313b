"""The reach task as pure functions on components: increments, joint target, plant, errors, observation and reward.

A component is one number of a vector: a Python float for one environment, or a NumPy array or torch tensor with one
entry per environment. `pickenv.envs.shared.backends` has the arithmetic for each. The plant is the model of the true
arm. A compensator, if there is one, turns joint targets into joint commands between `move` and `look`, and nowhere
else. Units: m, rad, s; millimetres and degrees only where a name ends in mm or deg.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import accumulate, chain
from types import ModuleType
from typing import Any, NamedTuple

from pickenv.arm import Frame, Plant, PlantState, Scalar, attach, chosen, clipped, frame_error, frames, rotation_between
from pickenv.arm.kinematics.forward import Scalars
from pickenv.arm.kinematics.task_space import damped_step, jacobian_columns
from pickenv.envs.shared import situation
from pickenv.envs.shared.backends import ARM, CAMERA, FRUIT, JOINTS, Executor, episode_key, normal, stream_key, uniform
from pickenv.envs.shared.task import GOAL_MARGIN, Task, inexact

DEGREES = 57.29577951308232
"""Degrees in one radian."""

DAMPING, GOAL_NUMBERS = 1e-5, 9

NUMBER_KEYS = ("position_error_mm", "attitude_error_deg", "noncompensable_deg", "compensable_deg")

Components = tuple[Scalar, ...]


class ArmState(NamedTuple):
    """All that an environment of one arm remembers between two actions.

    The number after a description, such as 12, is the count of its numbers; n is the number of joints.

    Attributes:
        target: Nominal joint target, the sum of the actions so far, n.
        goal: Frame of the fruit with the wanted attitude, 12; empty in `pickenv/Pick-v0`, which stores fruit elsewhere.
        seen: Fruit position as the camera saw it, 3; empty in `pickenv/Pick-v0`.
        drawn: Numbers drawn for the episode, in the order of `Situation.drawn`.
        sent: Delayed actions that have not taken effect yet, the latest first.
        sensed: Delayed readings that have not arrived yet, the latest first.
        plant: What the true arm remembers, such as its backlash and temperature.
    """

    target: Components
    goal: Frame
    seen: Components
    drawn: Components
    sent: Components
    sensed: Components
    plant: PlantState

    @classmethod
    def of(cls, columns: Scalars, widths: Sequence[int]) -> ArmState:
        """Return the state whose numbers are ``columns``; ``widths`` has the count of numbers in each attribute.

        The counts after the sixth are the counts of numbers in the parts of `plant`.
        """
        parts = [tuple(columns[end - width : end]) for end, width in zip(accumulate(widths), widths, strict=True)]
        target, goal, sighting, drawn, sent, late, *memory = parts
        return cls(target, goal, sighting, drawn, sent, late, tuple(memory))

    @property
    def columns(self) -> list[Scalar]:
        """All numbers of the state, concatenated."""
        return list(chain(*self[:-1], *self.plant))


class View(NamedTuple):
    """All measured and true quantities at one moment, from which observation and information are made.

    "Believed" means computed from the joint readings with the nominal arm. Vectors are in the base frame, m. The number
    at the end of a description is the count of its numbers; n is the number of joints.

    Attributes:
        readings: Joint readings scaled to the joint limits, n.
        believed: Believed tool position, 3.
        attitude: The believed tool's z and x axes, 6.
        wanted: The wanted tool's z and x axes, 6.
        seen: Fruit position as the camera saw it, 3.
        offset: Pose of the fruit as seen, with the wanted attitude, relative to the believed tool: m and rotation
            vector, 6.
        camera: Fruit position minus the tool's true position, as the camera measures it, 3; empty without camera
            feedback.
        command: Joint command that the drives got, n.
        tool: The tool's true position, 3.
        fruit: True fruit position, 3.
        error: The tool's true pose relative to the fruit: m and rotation vector, 6.
        numbers: Four sizes of the error in the order of `NUMBER_KEYS`: a distance, mm, then three angles, deg. The
            angles are the whole angle, its part that no joint motion removes, and its part that joints can remove.
        success: Whether the fruit is inside the capture region.
    """

    readings: Components
    believed: Components
    attitude: Components
    wanted: Components
    seen: Components
    offset: Components
    camera: Components
    command: Components
    tool: Components
    fruit: Components
    error: Components
    numbers: Components
    success: Scalar

    @property
    def vectors(self) -> Components:
        """Pose error (6), joint command (n), true tool position (3) and fruit position (3): 12 + n numbers."""
        return (*self.error, *self.command, *self.tool, *self.fruit)


def nominal_frames(x: Executor, task: Task, q: Scalars) -> tuple[list[Frame], Frame]:
    """Compute the frames of the nominal arm's links (base first), and the frame of its tool.

    They are in the base frame, at the joints ``q``: n components, rad or m.
    """
    chain = task.exact if x.spares_constants else task.nominal
    links = frames(x.m, chain, q)
    return links, inexact(attach(links[-1], chain.tool))


def goal_attempt(x: Executor, task: Task, key: Scalar, attempt: int) -> tuple[list[Scalar], Scalar]:
    """Draw joints for a wanted pose, and check whether the pose fits the task.

    A pose fits if the tool is in the task's region and points upwards within the largest tilt.

    Args:
        x: The executor.
        task: The task.
        key: Key of the random stream `GOAL` of the episode.
        attempt: Index of the attempt, from 0; the first pose that fits becomes the goal.

    Returns:
        The n joints, rad or m, and whether their pose fits.
    """
    joints = []
    for i, (low, high) in enumerate(zip(*task.box, strict=True)):
        margin = GOAL_MARGIN * (high - low)
        share = uniform(x, key, attempt * task.joints + i)
        joints.append((low + margin) + share * (high - low - 2.0 * margin))
    tool = nominal_frames(x, task, joints)[1]
    fits = tool[8] >= task.min_upright
    for low, value, high in zip(task.region[0], tool[9:], task.region[1], strict=True) if task.region else ():
        fits = fits & (low <= value) & (value <= high)
    return joints, fits


def drawn_arm(x: Executor, task: Task, seed: Scalar, key: Scalar) -> Scalar:
    """Draw the index (from 0) of an episode's true arm in the population, with a fraction that the caller cuts off.

    Args:
        x: The executor.
        task: The task, whose arms are a population.
        seed: Seed of the environment's stream. If each environment keeps one arm ("per_env"), only this seed counts.
        key: Key of the episode.
    """
    if task.arms == "per_env":
        key = episode_key(x, seed, x.times(seed, 0))
    return uniform(x, stream_key(x, key, ARM), 0) * task.population


def begin(
    x: Executor, task: Task, plant: Plant, key: Scalar, start: Scalars, goal: Frame, command: Scalars, hours: Any = None
) -> ArmState:
    """Return the state of an arm at the start of an episode.

    Args:
        x: The executor.
        task: The task.
        plant: The true arm, or arms.
        key: Key of the episode.
        start: Joint target to start from, n components, rad or m.
        goal: Frame of the fruit with the wanted attitude, or empty.
        command: Joint command that the drives get for ``start``.
        hours: Time for which the arm has been switched on, h; None for the time in the task's situation.
    """
    setting, sighting = task.situation, goal[9:]
    if task.fruit_noise:
        fruit = stream_key(x, key, FRUIT)
        sighting = tuple(v + task.fruit_noise * normal(x, fruit, i) for i, v in enumerate(sighting))
    values = situation.drawn_values(x, setting, key)
    _, sent, late = setting.widths(task.actions, task.joints + 3 * task.camera)
    zero = start[0] * 0.0
    memory = plant.initial_state(x.m, command)
    if hours is not None or setting.hours.high:
        hours = setting.value("hours", values) if hours is None else hours
        memory = plant.carried(x.m, memory, command, 3600.0 * hours)
    return ArmState(tuple(start), goal, sighting, values, (zero,) * sent, (zero,) * late, memory)


def move(x: Executor, task: Task, target: Scalars, action: Scalars) -> Components:
    """Return the nominal joint target after an action: n components, rad or m, within the joint limits.

    Args:
        x: The executor.
        task: The task.
        target: The joint target before the action.
        action: Shares of the largest increments, which are clipped to -1 to 1.
    """
    m, limits = x.m, zip(target, action, task.increment, task.lower, task.upper, strict=True)
    joints = [clipped(m, q + clipped(m, share, -1.0, 1.0) * most, low, high) for q, share, most, low, high in limits]
    return tuple(joints)


def act(x: Executor, task: Task, state: ArmState, action: Scalars) -> ArmState:
    """Return the state with its joint target moved by the action, or by an earlier action if actions are delayed.

    `move` explains actions that move joints, and `joint_shares` actions that move the tool.
    """
    setting, values = task.situation, state.drawn
    action, sent = situation.late(x, setting, "delay", values, state.sent, action)
    if task.tool:
        action = joint_shares(x, task, state.target, action)
    target = move(x, task, state.target, situation.in_period(x, setting, values, action))
    return state._replace(target=target, sent=sent)


def joint_shares(x: Executor, task: Task, target: Scalars, action: Scalars) -> list[Scalar]:
    """Compute the shares of the joints' largest increments that move the believed tool by an action.

    They come from damped least squares; the damping is the share `DAMPING` of the sum of the Jacobian's squared
    entries. If a joint would exceed its largest increment, all joints are slowed by one factor, so that the tool keeps
    its direction.

    Args:
        x: The executor.
        task: The task, whose actions move the tool.
        target: The nominal joint target, at which the believed tool is before the action.
        action: Shares of the tool's largest increments, base frame.
    """
    m, (links, tool) = x.m, nominal_frames(x, task, target)
    columns = jacobian_columns(task.plant.arm.nominal, [inexact(link) for link in links], tool)
    shared = [
        tuple([part * (most / step) for part, step in zip(column, task.tool, strict=False)])
        for column, most in zip(columns, task.increment, strict=True)
    ]
    shares = damped_step(m, shared, [clipped(m, share, -1.0, 1.0) for share in action], DAMPING)
    largest: Scalar = 1.0
    for share in shares:
        size = chosen(m, share < 0.0, -share, share)
        largest = chosen(m, size > largest, size, largest)
    return [share / largest for share in shares]


def look(
    x: Executor, task: Task, plant: Plant, state: ArmState, command: Scalars, key: Scalar, moment: Scalar, dt: Scalar
) -> tuple[ArmState, View]:
    """Hold the joint command for ``dt`` seconds, then measure the tool's true pose.

    Args:
        x: The executor.
        task: The task.
        plant: The true arm, or arms.
        state: The state, with its new joint target.
        command: Joint command that the drives get for this target, n components, rad or m.
        key: Key of the episode.
        moment: Number of steps in the episode so far, 0 at its start, a 64-bit word; used only for the noise of camera
            and joints.
        dt: Time, s: one number, or one per environment. At the start of an episode it is the plain number 0.0.

    Returns:
        The state afterwards, and all that is measured and true then.
    """
    plant_state, ended = plant.advance(x.m, state.plant, command, dt)
    read = nominal_readings(x, plant, plant_state, state.target, command)
    return viewed(x, task, state._replace(plant=plant_state), read, inexact(ended), command, key, moment, dt)


def viewed(
    x: Executor,
    task: Task,
    state: ArmState,
    read: Scalars,
    true: Frame,
    command: Scalars,
    key: Scalar,
    moment: Scalar,
    dt: Scalar,
) -> tuple[ArmState, View]:
    """Return what `look` returns, for encoder readings and a true tool that are known already.

    `look` explains all arguments but ``read`` and ``true``. ``read`` has the joint readings without noise, as n nominal
    joints, rad or m. ``true`` is the tool's true frame.
    """
    m, goal, sighting, setting = x.m, state.goal, state.seen, task.situation
    dx, dy, dz, *turn = error = frame_error(m, goal, true)
    camera: Components = ()
    if task.camera:
        camera = (-dx, -dy, -dz)
        if task.camera_noise:
            camera = tuple(noisy(x, stream_key(x, key, CAMERA), moment, camera, task.camera_noise))
    arrived, late = sensed(x, task, state, key, moment, read, camera, dt)
    readings, camera = list(arrived[: task.joints]), tuple(arrived[task.joints :])
    links, pose = nominal_frames(x, task, readings)
    lag = rotation_between(m, pose, goal)
    if setting.latency.high or setting.joint_noise.high:  # the truth has its own
        links, _ = nominal_frames(x, task, read)
    distance_mm = 1e3 * length(x, (dx, dy, dz))
    angle_deg = DEGREES * length(x, turn)
    noncompensable_deg = DEGREES * _lost_angle(x, task, links, turn)
    square = angle_deg * angle_deg - noncompensable_deg * noncompensable_deg
    compensable_deg = m.sqrt(clipped(m, square, 0.0, math.inf))
    return state._replace(sensed=late), View(
        readings=scaled(x, task, readings),
        believed=pose[9:],
        attitude=(*pose[6:9], *pose[:3]),
        wanted=(*goal[6:9], *goal[:3]),
        seen=sighting,
        offset=(sighting[0] - pose[9], sighting[1] - pose[10], sighting[2] - pose[11], *lag),
        camera=camera,
        command=tuple(command),
        tool=true[9:],
        fruit=goal[9:],
        error=error,
        numbers=(distance_mm, angle_deg, noncompensable_deg, compensable_deg),
        success=in_capture_region(task, distance_mm, angle_deg),
    )


def sensed(
    x: Executor, task: Task, state: ArmState, key: Scalar, moment: Scalar, read: Scalars, camera: Components, dt: Scalar
) -> tuple[Scalars, Components]:
    """Return the readings that arrive now, and the delayed readings that are still pending, latest first.

    Readings come from the joints, with the encoders' noise, and from the camera. At the start of an episode, all
    pending readings equal the first reading; ``dt`` is then the plain number 0.0.

    Args:
        x: The executor.
        task: The task.
        state: The state, with the readings that were pending before.
        key: Key of the episode.
        moment: Number of steps in the episode so far, a 64-bit word.
        read: Joint readings without noise, rad or m.
        camera: What the camera measures, m; empty without a camera.
        dt: Time that has passed, s.
    """
    setting, past = task.situation, state.sensed
    if setting.joint_noise.high:
        read = noisy(x, stream_key(x, key, JOINTS), moment, read, setting.value("joint_noise", state.drawn))
    fresh = (*read, *camera)
    if isinstance(dt, float) and dt == 0.0:
        past = fresh * int(setting.latency.high)
    return situation.late(x, setting, "latency", state.drawn, past, fresh)


def noisy(x: Executor, stream: Scalar, moment: Scalar, values: Scalars, std: Scalar) -> list[Scalar]:
    """Return ``values`` plus normal noise.

    Args:
        x: The executor.
        stream: Key of the random stream of the noise.
        moment: Number of steps in the episode so far, a 64-bit word.
        values: The values.
        std: Standard deviation of the noise, in the unit of the values.
    """
    first = x.times(moment, len(values))
    return [value + std * normal(x, stream, x.plus(first, x.word(i))) for i, value in enumerate(values)]


def nominal_readings(x: Executor, plant: Plant, state: PlantState, target: Scalars, command: Scalars) -> list[Scalar]:
    """Return the joint readings as nominal joints (n components, rad or m): joint target + reading - joint command.

    So the difference between target and command, which a compensator makes, does not appear in observations.

    Args:
        x: The executor.
        plant: The true arm, or arms.
        state: State of the true arm.
        target: The nominal joint target.
        command: The joint command that the drives get for this target.
    """
    readings = plant.readings(x.m, state, command)
    return [q + (reading - sent) for q, reading, sent in zip(target, readings, command, strict=True)]


def scaled(x: Executor, task: Task, joints: Scalars) -> Components:
    """Scale joints from their limits to -1 to 1, and clip them."""
    m, limits = x.m, zip(joints, task.lower, task.upper, strict=True)
    return tuple([clipped(m, (2.0 * q - (low + high)) / (high - low), -1.0, 1.0) for q, low, high in limits])


def length(x: Executor, vector: Scalars) -> Scalar:
    """Compute the length of a vector of three components."""
    along_x, along_y, along_z = vector
    return x.m.sqrt(along_x * along_x + along_y * along_y + along_z * along_z)


def in_capture_region(task: Task, distance_mm: Scalar, angle_deg: Scalar) -> Scalar:
    """Return whether distance and angle between tool and fruit are within the task's tolerances.

    For a task without attitude only the distance counts.
    """
    near = distance_mm <= task.tolerance_mm
    return near & (angle_deg <= task.angle_tolerance_deg) if task.attitude else near


def _lost_angle(x: Executor, task: Task, links: Sequence[Frame], turn: Scalars) -> Scalar:
    """Return the size, rad, of the part of a small rotation that no revolute axis can produce.

    Args:
        x: The executor.
        task: The task.
        links: Frames of the arm's links, base first.
        turn: Rotation vector of the rotation, rad.
    """
    if task.lost_axes is None:
        return 0.0 * sum(turn)
    ax, ay, az = inexact(links[task.lost_axes[0] + 1][6:9])
    bx, by, bz = inexact(links[task.lost_axes[1] + 1][6:9])
    nx, ny, nz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    along = turn[0] * nx + turn[1] * ny + turn[2] * nz
    return x.m.sqrt(along * along / (nx * nx + ny * ny + nz * nz + 1e-30))


def flat_observation(scene: View) -> Components:
    """Return the numbers of the observation that `pickenv/Reach-v0` gives, in its order."""
    return (*scene.readings, *scene.believed, *scene.seen, *scene.offset, *scene.camera)


def goal_observation(scene: View) -> tuple[Components, Components, Components]:
    """Return the numbers of observation, achieved goal and desired goal.

    A goal has `GOAL_NUMBERS` numbers: a position, then the z and x axes of an attitude. The attitude of the achieved
    goal is the believed tool's. Its position is the believed tool position; with camera feedback it is the fruit
    position as seen minus the offset that the camera measures. The desired goal has the fruit position as the camera
    saw it, and the wanted attitude.
    """
    place = scene.believed
    if scene.camera:
        place = tuple(fruit - offset for fruit, offset in zip(scene.seen, scene.camera, strict=True))
    return (*scene.readings, *scene.believed), (*place, *scene.attitude), (*scene.seen, *scene.wanted)


def goal_gap(m: ModuleType, achieved: Scalars, desired: Scalars) -> tuple[Scalar, ...]:
    """Compute the gap from an achieved to a desired goal: position (m) and rotation vector (rad), 6."""
    return frame_error(m, _frame(achieved), _frame(desired))


def _frame(goal: Scalars) -> Frame:
    """Return the frame of a goal, whose 9 numbers are its position, z axis and x axis."""
    px, py, pz, zx, zy, zz, xx, xy, xz = goal
    return xx, xy, xz, zy * xz - zz * xy, zz * xx - zx * xz, zx * xy - zy * xx, zx, zy, zz, px, py, pz


def true_reward(x: Executor, task: Task, scene: View) -> Scalar:
    """Compute the reward from the tool's true error, by the formulas of `pickenv/Reach-v0`."""
    return _reward(x, task, scene.success, *scene.numbers[:2])


def goal_reward(x: Executor, task: Task, achieved: Scalars, desired: Scalars) -> Scalar:
    """Compute the reward from an achieved and a desired goal, `GOAL_NUMBERS` each, as in `pickenv/ReachGoal-v0`."""
    dx, dy, dz, *turn = goal_gap(x.m, achieved, desired)
    return gap_reward(x, task, (dx, dy, dz), turn)


def gap_reward(x: Executor, task: Task, gap: Scalars, turn: Scalars) -> Scalar:
    """Compute the reward from the position gap ``gap``, m, and the attitude gap ``turn``, rad, of tool and fruit.

    Each has three components; ``turn`` is a rotation vector.
    """
    distance_mm, angle_deg = 1e3 * length(x, gap), DEGREES * length(x, turn)
    return _reward(x, task, in_capture_region(task, distance_mm, angle_deg), distance_mm, angle_deg)


def _reward(x: Executor, task: Task, success: Scalar, distance_mm: Scalar, angle_deg: Scalar) -> Scalar:
    if task.sparse:
        return chosen(x.m, success, 0.0, distance_mm * 0.0 - 1.0)
    outside = chosen(x.m, success, 0.0 * distance_mm, 0.0 * distance_mm + task.edge_cost)
    if not task.attitude:
        return -x.m.log10(1.0 + distance_mm) - outside
    return -x.m.log10(1.0 + distance_mm) - 0.5 * x.m.log10(1.0 + angle_deg) - outside
