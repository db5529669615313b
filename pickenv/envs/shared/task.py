"""The task of a reach environment: arm, goal, camera, capture region and reward, as validated constants.

SI units, except where a name says otherwise.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from inspect import signature
from numbers import Real
from pathlib import Path
from typing import Any

import numpy as np

from pickenv.arm import Array, Geometry, Plant, draw_plants, forward, joint_jacobian, load_plant, plant_at, plant_count
from pickenv.arm.kinematics.forward import Chain, Frame, Scalar, chain_of, frames
from pickenv.arm.kinematics.inverse import halton_joints
from pickenv.arm.kinematics.task_space import DIRECTION_TOLERANCE
from pickenv.arm.plant.plant_file import class_of, draw_arms
from pickenv.base import InputError, check_limit, shown
from pickenv.base.files import unknown
from pickenv.envs.shared.situation import Components, Situation, make_situation

# Zeros and ones that cost nothing: an arm's table is full of right angles, and arrays need not be multiplied by them.
# A chain with `Exact` entries gives `pickenv.arm.kinematics.forward.frames` on NumPy arrays a third of its work.
# Sines and cosines within 1e-15 of 0, 1 and -1 count as exact, which is within the rounding of the others.


ROUNDING = 1e-15
FACTORS = ("cos_alpha", "sin_alpha", "a", "d", "cos_theta", "sin_theta")


class Exact:
    """A constant 0, 1 or -1. Its products and sums with arrays are formed without array arithmetic if possible."""

    __slots__ = ("value",)
    __array_ufunc__ = None  # arrays leave the arithmetic to this class

    def __init__(self, value: float) -> None:
        self.value = value

    def __mul__(self, other: Any) -> Any:
        if self.value == 0.0:
            return self
        return other if self.value == 1.0 else -other

    __rmul__ = __mul__

    def __add__(self, other: Any) -> Any:
        return other if self.value == 0.0 else other + self.value

    __radd__ = __add__

    def __sub__(self, other: Any) -> Any:
        return -other if self.value == 0.0 else self.value - other

    def __rsub__(self, other: Any) -> Any:
        return other if self.value == 0.0 else other - self.value

    def __neg__(self) -> Exact:
        return Exact(-self.value)


def exact(value: Scalar) -> Any:
    """Return a float near 0, 1 or -1 as an `Exact`, which saves work on arrays; return any other value unchanged."""
    for number in (0.0, 1.0, -1.0) if isinstance(value, float) else ():
        if abs(value - number) < ROUNDING:
            return Exact(number)
    return value


def exact_plant(plant: Plant) -> Plant:
    """Return ``plant`` (the true arm) with `Exact` numbers for the zeros and ones of its base frame and payload.

    `Exact` numbers save operations on arrays, which need not be multiplied by 0 or 1.
    """
    load = plant.load
    if load is not None and isinstance(load.payload, float):
        centre = tuple(tuple(exact(value) for value in point) for point in load.centre)
        load = replace(load, centre=centre, payload=exact(load.payload))
    chain = plant.chain._replace(base=tuple(exact(value) for value in plant.chain.base))
    return replace(plant, load=load, ready=(plant.geometry, chain))


def inexact(frame: Frame) -> tuple[Scalar, ...]:
    """Return ``frame`` with plain floats in place of `Exact` numbers."""
    return tuple([value.value if type(value) is Exact else value for value in frame])


MOST_ACTION = {"clip": float(np.finfo(np.float32).max), "refuse": 1.0 + 1e-6}
"""Largest magnitude that is accepted for an action's numbers, for each value of `out_of_range`. "clip" accepts all
finite numbers and clips them to -1 to 1. "refuse" accepts 1, with a margin for rounding to single precision."""

MOST_CAMERA_NOISE_MM = 100.0
"""Largest camera noise that is accepted. Ten such standard deviations stay within the metre that observation bounds
leave for errors."""

MOST_NUMBER = 1e6

FEEDBACK = ("encoders", "camera")
REWARDS = ("dense", "sparse")
ARMS = ("fixed", "per_env", "per_episode")
GOAL_MARGIN = 0.05
"""Share of each joint's range by which goals keep away from both limits."""

GOAL_ATTEMPTS = 10_000

USUAL_TILT = 30.0
"""Largest tilt of goals if `max_tilt_deg` is not given, deg."""

UPRIGHT, TILTED_POSES = 0.01, 2**10

Compensate = Callable[[Array], Array]
"""A function that maps the nominal arm's joint targets to the real arm's joint commands, ``(..., n)`` each (rad, m)."""

Compensators = Compensate | Sequence[Compensate]


def commanded(compensate: Compensators, joints: Array, where: Any = slice(None)) -> Array:
    """Return the joint commands ``(N, n)`` for the joint targets ``(N, n)`` of N environments, rad or m.

    Args:
        compensate: One compensator, or a sequence with one for each environment of the vector. Environments with the
            same compensator are corrected together.
        joints: The joint targets.
        where: Indices (from 0) or slice that select the N environments in the vector.
    """
    if callable(compensate):
        return np.asarray(compensate(joints))
    some = [compensate[i] for i in np.arange(len(compensate))[where].tolist()]
    names, command = np.array([id(compensator) for compensator in some]), np.empty_like(joints)
    for first in np.unique(names, return_index=True)[1].tolist():
        rows = names == names[first]
        command[rows] = some[first](joints[rows])
    return command


@dataclass(frozen=True, eq=False)
class Task:
    """Constants of a reach task; the same for single and vector environments.

    Attributes:
        plant: The true arm, or the population that true arms are taken from.
        arms: How true arms are taken from the population: one of `ARMS`.
        nominal: The nominal arm as a chain of links.
        lower: Lower joint limits, rad or m.
        upper: Upper joint limits, rad or m.
        increment: Largest increment of each joint in one action, rad or m.
        camera: Whether the camera's tool-to-fruit offset is part of observations.
        camera_noise: Standard deviation per axis of the tool-to-fruit offset that the camera measures, m.
        fruit_noise: Standard deviation per axis of the fruit's position as the camera saw it, m.
        tolerance_mm: Radius of the capture region.
        angle_tolerance_deg: Attitude tolerance of the capture region.
        sparse: Whether the reward is sparse.
        end_on_success: Whether reaching the fruit ends the episode.
        min_upright: Smallest z component of the wanted tool axis.
        lost_axes: Two links, counted from 0; no joint turns the tool about the normal to both their z axes. None if
            there are no such links.
        most_action: Largest magnitude that is accepted for an action's numbers.
        region: Two opposite corners of the box that goals are drawn from, m, or None for the arm's whole workspace.
        situation: Delays, noise and start of episodes.
        box: Lower and upper bounds of the joints at which episodes start and goals are drawn, rad or m.
        tool: Largest increments of the tool's position and attitude in one action, m and rad, or of its position alone;
            empty if actions move joints.
        gripper: Count of the gripper's numbers, which follow the arm's numbers in an action.
    """

    plant: Plant
    arms: str
    nominal: Chain
    lower: tuple[float, ...]
    upper: tuple[float, ...]
    increment: tuple[float, ...]
    camera: bool
    camera_noise: float
    fruit_noise: float
    tolerance_mm: float
    angle_tolerance_deg: float
    sparse: bool
    end_on_success: bool
    min_upright: float
    lost_axes: tuple[int, int] | None
    most_action: float
    region: tuple[Components, Components] | None
    situation: Situation
    box: tuple[Components, Components]
    tool: Components = ()
    gripper: int = 0

    @property
    def joints(self) -> int:
        """Number of joints."""
        return len(self.lower)

    @property
    def moves(self) -> int:
        """Count of the numbers in an action that move the arm."""
        return len(self.tool) or self.joints

    @cached_property
    def actions(self) -> int:
        """Count of the numbers in an action."""
        return self.moves + self.gripper

    @property
    def attitude(self) -> bool:
        """Whether the goal includes an attitude of the tool."""
        return len(self.tool) != 3

    @cached_property
    def edge_cost(self) -> float:
        """Cost of errors that equal both tolerances; the dense reward subtracts it outside the capture region."""
        angle_cost = 0.5 * math.log10(1.0 + self.angle_tolerance_deg) if self.attitude else 0.0
        return math.log10(1.0 + self.tolerance_mm) + angle_cost

    @cached_property
    def exact(self) -> Chain:
        """The nominal arm's chain of links with `Exact` numbers for zeros and ones, which save operations on arrays."""
        chain = self.nominal
        links = [link._replace(**{name: exact(getattr(link, name)) for name in FACTORS}) for link in chain.links]
        tool = None if chain.tool is None else tuple(map(exact, chain.tool))
        return chain._replace(base=tuple(map(exact, chain.base)), links=tuple(links), tool=tool)

    @cached_property
    def middle(self) -> tuple[float, ...]:
        """Joints in the middle of `box`, rad or m; this is mid-range unless actions move the tool."""
        return tuple((low + high) / 2 for low, high in zip(*self.box, strict=True))

    @cached_property
    def reach(self) -> float:
        """Upper bound of the tool's distance from the base frame's origin, m.

        It is the sum of all lengths of the nominal arm, plus 1 m for errors and noise.
        """
        g = self.plant.arm.nominal
        slides = np.array(g.prismatic) * np.maximum(np.abs(g.lower), np.abs(g.upper))
        lengths = np.abs(g.a).sum() + np.abs(g.d).sum() + slides.sum()
        return float(lengths + np.linalg.norm(g.base.position) + np.linalg.norm(g.tool.position) + 1.0)

    @property
    def population(self) -> int:
        """Number of arms in the population from which true arms are taken; 1 without a population."""
        return plant_count(self.plant) or 1

    def given_joints(self, name: str, joints: Sequence[float] | Array, count: int | None = None) -> Array:
        """Check the joints in an option of `reset`, and return them as an array.

        Args:
            name: Name of the option, for error messages.
            joints: Joints ``(n,)``, or ``(count, n)`` if ``count`` is given, rad or m.
            count: Number of environments, or None for a single one.

        Returns:
            The joints ``(n,)``, or ``(count, n)`` if ``count`` is given.

        Raises:
            InputError: If the shape is wrong or joints lie outside the joint limits.
        """
        values, lower, upper = as_numbers(name, joints), np.array(self.lower), np.array(self.upper)
        shapes = [(self.joints,)] if count is None else [(self.joints,), (count, self.joints)]
        if values.shape not in shapes or not np.all((values >= lower) & (values <= upper)):
            raise InputError(
                f"{name} must be {' or '.join(map(str, shapes))} joints (rad, m) inside the arm's workspace, the joint "
                f"limits {np.round(lower, 4).tolist()} to {np.round(upper, 4).tolist()}"
            )
        return values if count is None else np.broadcast_to(values, (count, self.joints))

    def given_arm(self, number: int) -> int:
        """Check the index (from 0) of an arm of the population, and return it.

        Raises:
            InputError: If the population has no arm with this index, or there is no population.
        """
        if self.arms == "fixed":
            raise InputError("option arm needs a population; make the environment with arms='per_episode'")
        if not isinstance(number, int | np.integer) or not 0 <= number < self.population:
            raise InputError(f"arm is {number!r}; the population has arms 0 to {self.population - 1}")
        return int(number)

    def no_goal(self) -> InputError:
        """Return the error to raise when no pose was found that meets `min_upright` and, if given, `region`."""
        tilt = math.degrees(math.acos(self.min_upright))
        place, advice = (" in goal_region", " or move goal_region") if self.region else ("", "")
        return InputError(
            f"arm '{self.plant.arm.name}' found no pose{place} with its tool within {tilt:.0f} deg of the vertical; "
            f"raise max_tilt_deg{advice}"
        )


def make_task(
    plant: str = "qiao2026",
    without: Sequence[str] = (),
    feedback: str = "encoders",
    camera_noise_mm: float = 0.0,
    tolerance_mm: float = 5.0,
    angle_tolerance_deg: float = 10.0,
    reward: str = "dense",
    max_tilt_deg: float | None = None,
    end_on_success: bool = False,
    arms: str = "fixed",
    tolerances: str = "medium",
    population: int = 256,
    population_seed: int = 0,
    fruit_noise_mm: float | None = None,
    out_of_range: str = "clip",
    goal_region: Sequence[Sequence[float]] | None = None,
    **situation: Any,
) -> Task:
    """Check the arguments of a reach environment, which `pickenv/Reach-v0` explains, and return its task.

    Raises:
        InputError: If an argument has a value that is not allowed. The message names the argument.
    """
    setting = make_situation(**situation)
    check_choice("feedback", feedback, FEEDBACK)
    check_choice("reward", reward, REWARDS)
    check_choice("out_of_range", out_of_range, tuple(MOST_ACTION))
    check_number("tolerance_mm", tolerance_mm, positive=True)
    check_number("angle_tolerance_deg", angle_tolerance_deg, positive=True)
    fruit_noise_mm = camera_noise_mm if fruit_noise_mm is None else fruit_noise_mm
    for name, noise in (("camera_noise_mm", camera_noise_mm), ("fruit_noise_mm", fruit_noise_mm)):
        check_number(name, noise)
        if noise > MOST_CAMERA_NOISE_MM:
            raise InputError(f"{name} is {noise}; give at most {MOST_CAMERA_NOISE_MM:.0f}")
    if max_tilt_deg is not None:
        check_number("max_tilt_deg", max_tilt_deg, positive=True)
    check_choice("arms", arms, ARMS)
    check_flag("end_on_success", end_on_success)
    check_count("population_seed", population_seed, least=0)
    check_count("population", population)
    check_limit("population", int(population), "population")
    check_name("tolerances", tolerances, "a tolerance class, or a path to its file (.toml)")
    if arms == "fixed":
        idle: dict[str, Any] = {"tolerances": tolerances, "population": population}
        idle |= {"population_seed": population_seed} if class_of(plant) is None else {}
        refuse_idle(make_task, idle, "on the plant's own arm; give arms='per_episode' or 'per_env' with it")
    true_arm = load_true_arm(plant, without, population_seed)
    if arms != "fixed":
        true_arm = draw_arms(plant, tolerances, population, np.random.default_rng(population_seed), without=without)
    geometry = true_arm.arm.nominal
    tilt = usual_tilt(geometry) if max_tilt_deg is None else float(max_tilt_deg)
    limits = tuple(geometry.lower.tolist()), tuple(geometry.upper.tolist())
    return Task(
        plant=true_arm,
        arms=arms,
        nominal=chain_of(geometry),
        lower=limits[0],
        upper=limits[1],
        increment=tuple((true_arm.arm.speed * setting.period.high).tolist()),
        camera=feedback == "camera",
        camera_noise=camera_noise_mm * 1e-3,
        fruit_noise=fruit_noise_mm * 1e-3,
        tolerance_mm=float(tolerance_mm),
        angle_tolerance_deg=float(angle_tolerance_deg),
        sparse=reward == "sparse",
        end_on_success=bool(end_on_success),
        min_upright=math.cos(math.radians(min(tilt, 180.0))),
        lost_axes=lost_axes(geometry),
        most_action=MOST_ACTION[out_of_range],
        region=None if goal_region is None else checked_region(goal_region),
        situation=setting,
        box=limits,
    )


def refuse_unknown(env: Any, arguments: Iterable[str], *makers: Callable[..., Any]) -> None:
    """Raise an `InputError` that names an argument of an environment if nothing takes it.

    Args:
        env: The environment, whose classes name some arguments.
        arguments: Names of the arguments.
        makers: Functions that take further arguments.
    """
    takers = (*(vars(kind)["__init__"] for kind in type(env).__mro__ if "__init__" in vars(kind)), *makers)
    parameters = [parameter for taker in takers for parameter in signature(taker).parameters.values()]
    named = {p.name for p in parameters if p.kind in (p.POSITIONAL_OR_KEYWORD, p.KEYWORD_ONLY)}
    taken = sorted(named - {"self", "task"})  # which classes and the ladder have beside arguments of environments
    for name in arguments:
        if name not in taken:
            raise InputError(unknown("argument", name, taken))


def refuse_idle(maker: Callable[..., Any], values: Mapping[str, Any], where: str) -> None:
    """Raise an `InputError` if an argument without effect has another value than its default.

    Args:
        maker: Function whose signature has the defaults.
        values: Values of the arguments without effect, by name.
        where: End of the message: in which case the argument has no effect, and what to do.
    """
    for name, value in values.items():
        if value != signature(maker).parameters[name].default:
            raise InputError(f"{name} has no effect {where}")


OF_TASKS = (make_task, make_situation)
"""Functions that take the arguments of tasks of all arms."""


def checked_region(given: Any) -> tuple[Components, Components]:
    """Check the two corners of a goal region, m, and return them as floats: least coordinates, then largest ones.

    Raises:
        InputError: If ``given`` is not two corners, or the first is not below the second in every coordinate.
    """
    corners = as_numbers("goal_region", given)
    if corners.shape != (2, 3) or not np.isfinite(corners).all() or not (corners[0] < corners[1]).all():
        raise InputError(
            f"goal_region is {shown(given)}; give the corners of a box, [[x, y, z], [x, y, z]] in m, least ones first"
        )
    low, high = corners.tolist()
    return tuple(low), tuple(high)


def load_true_arm(plant: str, without: Sequence[str] = (), seed: int = 0) -> Plant:
    """Load the plant that describes the true arm.

    Args:
        plant: Preset or path of a plant file, or "ideal:ARM", as `pickenv.arm.load_plant` takes them. "CLASS:ARM" (for
            example "coarse:ur5e") draws one arm from a tolerance class.
        without: Names of effects to switch off.
        seed: Seed of the draw from a tolerance class.

    Raises:
        InputError: If a plant, arm, tolerance class or effect is unknown, or an argument has another type.
    """
    check_name("plant", plant, 'a plant preset or a path to a plant file (.toml), "ideal:ARM" or "CLASS:ARM"')
    if isinstance(without, str) or not isinstance(without, Sequence) or not all(isinstance(e, str) for e in without):
        raise InputError(f"without is {without!r}; give a list of names of effects")
    tolerances = class_of(plant)
    if tolerances is None:
        return load_plant(plant, without=without)
    return plant_at(draw_plants(load_plant(plant, without=without), tolerances, 1, np.random.default_rng(seed)), 0)


def usual_tilt(geometry: Geometry) -> float:
    """Compute the largest tilt of goals for an arm if `max_tilt_deg` is not given, deg.

    The tilt is the angle between the tool's axis and the vertical. The result is the smallest multiple of `USUAL_TILT`
    below which at least a share `UPRIGHT` of `TILTED_POSES` sampled poses of the arm lies.
    """
    middle = (geometry.lower + geometry.upper) / 2.0
    joints = middle + (1.0 - 2.0 * GOAL_MARGIN) * (halton_joints(geometry, TILTED_POSES) - middle)
    upright = forward(geometry, joints).rotation[:, 2, 2]
    least = math.degrees(math.acos(np.clip(np.quantile(upright, 1.0 - UPRIGHT), -1.0, 1.0)))
    return USUAL_TILT * max(1.0, math.ceil(least / USUAL_TILT + 1e-6))  # not at the edge, where rounding decides


def check_choice(name: str, value: str, allowed: tuple[str, ...]) -> None:
    """Raise an `InputError`, which names the argument ``name``, if ``value`` is not one of ``allowed``."""
    if value not in allowed:
        raise InputError(f"{name} is {value!r}; give one of {', '.join(allowed)}")


def check_number(name: str, value: float, *, positive: bool = False) -> None:
    """Raise an `InputError` unless ``value`` is a number from 0 to `MOST_NUMBER`, and above zero if ``positive``.

    The bound is for all numeric arguments of environments, whatever their unit.
    """
    number: Any = value
    is_number = isinstance(number, Real) and not isinstance(number, bool)
    if not is_number or not 0 <= value <= MOST_NUMBER or (positive and value == 0):
        raise InputError(
            f"{name} is {shown(value)}; give a finite number {'above' if positive else 'not below'} zero, at most "
            f"{MOST_NUMBER:.0f}"
        )


def check_count(name: str, value: int, least: int = 1) -> None:
    """Raise an `InputError` unless ``value`` is a whole number of at least ``least``."""
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < least:
        raise InputError(f"{name} is {value!r}; give a whole number of at least {least}")


def check_flag(name: str, value: bool) -> None:
    """Raise an `InputError`, which names the argument ``name``, unless ``value`` is True or False."""
    if not isinstance(value, bool | np.bool_):
        raise InputError(f"{name} is {shown(value)}; give True or False")


def check_name(name: str, value: str | Path, wanted: str) -> None:
    """Raise an `InputError` unless ``value`` is a string or a path.

    Args:
        name: Name of the argument, for the message.
        value: Value of the argument.
        wanted: Description of what has such a name, for the message.
    """
    if not isinstance(value, str | Path):
        raise InputError(f"{name} is {value!r}; give the name of {wanted}")


def as_numbers(name: str, given: Any) -> Array:
    """Convert ``given`` to an array of floats.

    Raises:
        InputError: If ``given`` cannot be converted, for example text, or rows of different lengths. The message uses
            ``name``.
    """
    try:
        return np.asarray(given, dtype=float)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(f"{name} is {shown(given)}; give numbers") from error


def checked_action(action: Any, shape: tuple[int, ...], most: float) -> Array:
    """Check the actions of one environment or of several, and return them clipped to -1 to 1.

    Args:
        action: The action, or actions, as the user gave them.
        shape: The shape that ``action`` must have.
        most: Largest magnitude of a number that is accepted, from `MOST_ACTION`.

    Raises:
        InputError: If ``action`` has another shape, or numbers that are not finite or too large.
    """
    values = as_numbers("action", action)
    low, high = (values.min(), values.max()) if values.size else (0.0, 0.0)
    if values.shape != shape or not (-most <= low and high <= most):
        form = f"{shape[0]} finite numbers" if len(shape) == 1 else f"finite numbers of shape {shape}"
        raise InputError(f"action {shown(values.tolist())} is not {form}{bounds_of(most)}")
    return values if low >= -1.0 and high <= 1.0 else np.clip(values, -1.0, 1.0)


def bounds_of(most: float) -> str:
    """Return the range of actions as the end of an error message; empty if larger actions are clipped.

    ``most`` is the largest magnitude that is accepted, a value of `MOST_ACTION`.
    """
    return " between -1 and 1" if most == MOST_ACTION["refuse"] else ""


def lost_axes(geometry: Geometry) -> tuple[int, int] | None:
    """Find two links, counted from 0, such that no joint turns the tool about the normal to both their z axes.

    There are such links if all revolute axes have one of two directions. This is so on the picking arm, where J1, J2
    and J4 are parallel, and so are J5 and J6 (Qiao 2026 digest, fact 4).

    Returns:
        The indices (from 0) of the two links, or None if there are no such links.
    """
    poses = np.random.default_rng(0).uniform(geometry.lower, geometry.upper, (16, geometry.joints))
    links = frames(np, chain_of(geometry), list(np.ascontiguousarray(poses.T)))[1:]
    axes = {
        i: np.stack([np.broadcast_to(part, len(poses)) for part in link[6:9]], axis=1)
        for i, link in enumerate(links)
        if not geometry.prismatic[i]
    }
    first: list[int] = []
    for i in axes:
        if not any(np.abs(np.cross(axes[i], axes[j])).max() < 1e-9 for j in first):  # parallel to none of them
            first.append(i)
    return (first[0], first[1]) if len(first) == 2 else None


# Tasks whose actions are increments of the tool instead of the joints, near a pose far from singularities.


ACTIONS = {"pose": 6, "position": 3}
"""Count of the numbers in an action, for each value of the argument `actions`."""

PLACES = 2**10


def make_tool_task(
    actions: str = "pose",
    tool_step_mm: float = 25.0,
    tool_turn_deg: float = 10.0,
    goal_spread: float = 0.25,
    **arguments: Any,
) -> Task:
    """Check the arguments of an environment, which `pickenv/ReachTool-v0` explains, and return its task.

    Raises:
        InputError: If an argument has a value that is not allowed, or the arm has fewer joints than an action has
            numbers.
    """
    check_choice("actions", actions, tuple(ACTIONS))
    for name, size in (("tool_step_mm", tool_step_mm), ("tool_turn_deg", tool_turn_deg), ("goal_spread", goal_spread)):
        check_number(name, size, positive=True)
    if goal_spread > 1:
        raise InputError(f"goal_spread is {goal_spread}; give a share of the joints' ranges, above 0 and at most 1")
    task, count = make_task(**arguments), ACTIONS[actions]
    if actions == "position":
        without_attitude = "where no attitude is asked for; leave it out, or give actions='pose'"
        refuse_idle(make_tool_task, {"tool_turn_deg": tool_turn_deg}, without_attitude)
        refuse_idle(make_task, {"angle_tolerance_deg": task.angle_tolerance_deg}, without_attitude)
    if task.joints < count:
        other = "; give actions='position'" if 3 <= task.joints < count else ""
        raise InputError(
            f"arm '{task.plant.arm.name}' has {task.joints} joints, too few for the {count} increments of "
            f"its tool that actions='{actions}' are{other}"
        )
    tool = (*[tool_step_mm * 1e-3] * 3, *[math.radians(tool_turn_deg)] * 3)[:count]
    low, high = free_box(task.plant.arm.nominal, np.array(task.increment), tool, task.min_upright, goal_spread)
    return replace(task, tool=tool, box=(tuple(low.tolist()), tuple(high.tolist())))


def free_box(
    geometry: Geometry, increment: Array, tool: tuple[float, ...], min_upright: float, spread: float
) -> tuple[Array, Array]:
    """Find a box of joints around a pose from which the tool moves well in every direction.

    The middle of the box is one of the upright poses among `PLACES` poses from a Halton sequence. It is the pose where
    the smallest singular value of the scaled Jacobian is largest. Directions in which the arm cannot move anywhere do
    not count. The box lies inside the joint limits and inside a whole turn of each joint.

    Args:
        geometry: The arm.
        increment: Largest increments of the joints, rad or m.
        tool: Largest increments of the tool, m and rad.
        min_upright: Smallest z component of the tool's axis.
        spread: Edges of the box, as shares of the joints' ranges. A range above a whole turn counts as a whole turn.

    Returns:
        The lower and the upper bounds of the box ``(n,)``, rad or m.
    """
    middle, span = (geometry.lower + geometry.upper) / 2.0, geometry.upper - geometry.lower
    span = np.where(geometry.prismatic, span, np.minimum(span, math.tau))
    shares = (halton_joints(geometry, PLACES) - geometry.lower) / (geometry.upper - geometry.lower)
    places = middle + span * (1.0 - spread) * (shares - 0.5)
    upright = forward(geometry, places).rotation[:, 2, 2] >= min_upright
    places = places[upright] if upright.any() else places
    jacobian = joint_jacobian(geometry, places)[:, : len(tool)] * increment / np.array(tool)[:, None]
    sizes = np.linalg.svd(jacobian, compute_uv=False)
    rank = int((sizes > DIRECTION_TOLERANCE * sizes[:, :1]).sum(axis=1).max())
    best = places[np.argmax(sizes[:, rank - 1])]
    return best - span * spread / 2.0, best + span * spread / 2.0
