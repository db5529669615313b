"""Effects (causes of an arm's error), and the joint command that they change on its way from the motors to the tool.

Formulas take Python floats, NumPy arrays or torch tensors, as in `pickenv.arm.kinematics.forward`. The numbers of an
effect may be arrays too, one entry per arm. Gravity points along -z of the world. Units: m, rad, N, kg, s.

In plant files, an effect's entries are joint numbers from 1, lists with one number per joint, or sizes by joint. A size
by joint has one unit for revolute joints and another for prismatic joints. While a plant file is read, a mapping called
the context is passed on; it holds the arm under the key ``arm``.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, make_dataclass, replace
from functools import reduce
from types import ModuleType
from typing import Annotated, Any, ClassVar, Self, cast

import numpy as np
from scipy.special import ndtri

from pickenv.arm.files.arm import Arm, Load, arm_in
from pickenv.arm.kinematics.forward import Chain, Flexure, Frame, Scalar, Scalars, attach, frames, tool_frame
from pickenv.arm.kinematics.geometry import Array
from pickenv.base import ARCMIN, DEG, GRAVITY, MM, WHOLE, InputError, Kinds, Then, Unit, fault, registry, toml_table


def joint_index(number: int, context: Any) -> int:
    """Convert a joint number (from 1) to an index (from 0); refuse a number that the arm in ``context`` lacks.

    ``context`` is the mapping that is passed on while a plant file is read; it holds the arm under the key ``arm``.
    """
    if (arm := arm_in(context)) is not None and not 1 <= number <= arm.nominal.joints:
        raise fault(f"a joint number from 1 to {arm.nominal.joints}")
    return number - 1


def _boom(number: int, context: Any) -> int:
    index, arm = joint_index(number, context), arm_in(context)
    if arm is not None and not arm.nominal.prismatic[index]:
        raise fault(f"a prismatic joint: joint {number} of {arm.name} is revolute")
    return index


BOOM = Then(_boom)
"""Annotation of the number, from 1, of a prismatic joint; reading converts it to an index from 0."""


TRAVEL = (ARCMIN.not_negative, MM.not_negative)
"""Units of a joint's backlash, lag or error: the first for a revolute joint, the second for a prismatic joint."""

LENGTH = (DEG.positive, MM.positive)
"""Units of a joint's period or length scale: the first for a revolute joint, the second for a prismatic joint."""


def numbers_per_joint(table: Any, context: Any, *keys: str) -> tuple[tuple[float, ...], ...]:
    """Return for each key a tuple with one number per joint.

    Args:
        table: A table whose attribute ``joints`` is a list of entries, each for one joint with the index ``joint``.
        context: Context of the plant file that is being read; it holds the arm.
        keys: Names of the sizes in the entries. The number of a joint without an entry is 0.

    Raises:
        InputError: If a joint has two entries.
    """
    entries: dict[int, Any] = {}
    for entry in table.joints:
        if entry.joint in entries:
            raise InputError(f"joint {entry.joint + 1} has two entries in one table; give each joint once")
        entries[entry.joint] = entry
    joints = () if (arm := arm_in(context)) is None else range(arm.nominal.joints)
    return tuple(tuple(getattr(entries.get(joint), key, 0.0) for joint in joints) for key in keys)


class Entry(dict[str, Any]):
    """One table of a list that has a table per joint; ``slides`` says whether the table's joint is prismatic."""

    slides = False


class ByJoint:
    """Annotation of a list of tables, each with a ``joint`` number and sizes.

    The arguments are the sizes by name. Each has two units: the first for revolute joints, the second for prismatic
    joints.
    """

    def __init__(self, **units: tuple[Unit, Unit]) -> None:
        self.units = units

    def __get_pydantic_core_schema__(self, _source: Any, handler: Any) -> Any:
        """Return the pydantic schema of the list.

        The type of an entry's joint decides the entry's units. If the joint is unknown, the units in the keys decide.
        """
        from pydantic_core import core_schema as core

        kinds = []
        for slides, name in enumerate(("Turning", "Sliding")):
            sizes = [(size, Annotated[float, pair[slides]]) for size, pair in self.units.items()]
            members = [("joint", Annotated[int, WHOLE, Then(joint_index)]), *sizes]
            kinds.append(toml_table(make_dataclass(name, members, frozen=True)))
        sliding = {f"{size}_{slide.name}" for size, (turn, slide) in self.units.items() if turn.name != slide.name}

        def placed(value: Any, info: Any) -> Any:
            if not isinstance(value, Mapping):
                return value
            entry, arm, number = Entry(value), arm_in(info.context), value.get("joint")
            entry.slides = bool(entry.keys() & sliding)
            if arm is not None and isinstance(number, int) and 1 <= number <= arm.nominal.joints:
                entry.slides = arm.nominal.prismatic[number - 1]
            return entry

        union: Any = cast(Any, kinds[0]) | kinds[1]
        schema = handler.generate_schema(Annotated[union, Kinds(lambda entry: kinds[getattr(entry, "slides", 0)])])
        return core.tuple_variable_schema(core.with_info_before_validator_function(placed, schema))


def joint_table(make: Callable[..., Any], **sizes: tuple[Unit, Unit] | Unit) -> Any:
    """Return the type of an effect's table with sizes by joint and with single numbers; missing values are zero.

    Args:
        make: Function that returns the effect. It takes one tuple of n numbers, one per joint, for each size by joint.
            The single numbers are its last arguments.
        sizes: Units by name: a pair (revolute, prismatic) for a size by joint, one unit for a single number.
    """
    pairs = {name: unit for name, unit in sizes.items() if isinstance(unit, tuple)}
    singles = {name: unit for name, unit in sizes.items() if isinstance(unit, Unit)}
    members: list[Any] = [("joints", Annotated[tuple[Any, ...], ByJoint(**pairs)], ())]
    members += [(name, Annotated[float, unit], 0.0) for name, unit in singles.items()]

    def effect(table: Any, context: Any) -> Any:
        return make(*numbers_per_joint(table, context, *pairs), *(getattr(table, name) for name in singles))

    return Annotated[Any, Then(effect, toml_table(make_dataclass("JointTable", members, frozen=True)))]


MOTOR, DRIVE, GEAR, JOINT, BEND, BASE, TOOL, BESIDE = (float(place) for place in range(8))
"""Places where an effect acts, in order from the motors to the tool. Each place has a part of the `Passage` that its
effects change. On the motors: `Passage.turn`. In the drives: `Passage.drive`. In the gears and at the joints:
``joints``, ``chain``. Along the links: ``bends``. Under the base and at the tool: ``frame``. An effect at `BESIDE`
never moves the arm (an instrument's noise). Add a fraction below 1 to order the effects of one place."""

Components = tuple[Scalar, ...]

Weight = tuple[Scalar, Scalar, Scalar]
"""Three numbers for a link, all later links and the payload together. The first is their mass, kg. The second is this
mass times the world's x of its centre, kg*m. The third is this mass times the world's y of its centre, kg*m."""


class Passage:
    """The state of one joint command on its way from the motors to the tool, which the effects change one by one.

    Attributes:
        m: The namespace of the formulas: ``math``, ``numpy`` or ``torch``.
        command: The joint command, n components, rad or m.
        motor: Positions of the motors, n components, rad or m of the joints that they drive.
        driven: Positions to which the drives bring the joints, n components, rad or m.
        joints: Positions of the joints, n components, rad or m.
        cold: The true geometry at the temperature at which it was measured.
        chain: The true geometry at the present temperature.
        load: The masses, or None.
        bends: The effects that bend the links. `Effect.flexure` of each is called after all joint positions are known.
    """

    __slots__ = ("_frame", "_pull", "bends", "chain", "cold", "command", "driven", "joints", "load", "m", "motor")

    def __init__(self, m: ModuleType, chain: Chain, load: Load | None, command: Scalars) -> None:
        self.m, self.command, self.load = m, command, load
        self.motor = self.driven = self.joints = command
        self.cold = self.chain = chain
        self.bends: list[Effect] = []
        self._pull: tuple[list[Weight], list[Scalar]] | None = None
        self._frame: Frame | None = None

    def turn(self, motor: Scalars) -> None:
        """Set the positions of the motors, n components, rad or m, and set drives and joints to the same positions."""
        self.motor = self.driven = self.joints = motor

    def drive(self, driven: Scalars) -> None:
        """Set the positions of the drives, n components, rad or m, and set the joints to the same positions.

        The positions of the motors stay unchanged.
        """
        self.driven = self.joints = driven

    @property
    def pull(self) -> tuple[list[Weight], list[Scalar]]:
        """Two lists: the `Weight` that each link carries, and the gravity torque or force on each joint, N*m or N.

        The first list is the result of `weights_behind`; its last entry is the payload's `Weight`. Both lists are
        computed at the joint positions ``driven``, and neglect the small changes by bending and thermal growth. The
        plant (the true arm with its errors) must have masses.
        """
        if self._pull is None:
            straight = frames(self.m, self.cold, self.driven)  # not kept: NumPy uses its memory again
            weights = weights_behind(self.cold, straight, cast(Load, self.load))
            self._pull = weights, weights_torques(self.cold, straight, weights)
        return self._pull

    @property
    def frame(self) -> Frame:
        """The tool's frame in world axes.

        It is computed at the first access. Later changes of joints and links do not change it.
        """
        if self._frame is None:
            bends = [effect.flexure(self) for effect in self.bends]
            bend = bends[0] if len(bends) == 1 else lambda i, end: reduce(lambda bent, one: one(i, bent), bends, end)
            self._frame = tool_frame(self.m, self.chain, self.joints, bend if bends else None)
        return self._frame

    @frame.setter
    def frame(self, frame: Frame) -> None:
        self._frame = frame


@dataclass(frozen=True, eq=False)
class Draws:
    """Uniform random numbers for N arms, and how widely their tolerance class lets the arms differ.

    Attributes:
        even: Arrays ``(N, k)`` of uniform random numbers from 0 to 1. Each key is the name of the quantity that the
            numbers determine. Numbers that only one effect uses have the key "own NAME", with the effect's name.
        spread: Standard deviations of the logarithm of each size: the table [spread] of a tolerance file, as an object.
        temperature_rise: Range of the warm arm's temperature rise, K.
    """

    even: Mapping[str, Array]
    spread: Any
    temperature_rise: tuple[float, float]

    def scaled(self, values: Sequence[float], key: str, first: int = 0, spread: str | float = "") -> tuple[Array, ...]:
        """Return each value times N log-normal factors of median 1, one per arm.

        Args:
            values: The k values.
            key: Key of the random numbers in ``even``.
            first: Column of ``even[key]``, from 0, for the first value; the later values take the columns after it.
            spread: Standard deviation of the logarithm, or the name of the entry of [spread] that holds it. If empty,
                the name is ``key``.

        Returns:
            For each value an array ``(N,)``.
        """
        size = spread if isinstance(spread, float) else getattr(self.spread, spread or key)
        factors = np.exp(size * standard_normal_of(self.even[key]))
        return tuple(value * factors[:, first + i] for i, value in enumerate(values))


def standard_normal_of(even: Array) -> Array:
    """Return the standard normal quantiles of uniform random numbers from 0 to 1, of any shape."""
    return np.asarray(ndtri(np.clip(even, 1e-12, 1.0 - 1e-12)))


class Effect:
    """Base class of effects. An effect is one cause of an arm's error.

    Each subclass is a frozen dataclass whose fields are the effect's numbers: of one arm, or arrays with one entry per
    arm. A subclass gives class arguments:

    - ``place``: where the effect acts, `MOTOR` to `BESIDE`, plus a fraction.
    - ``spreads``: the attributes that differ from arm to arm, with their spread (optional). A spread is the name of an
      entry in a tolerance class's [spread]; the attribute then uses the random numbers of that entry. Or a spread is
      the standard deviation of the attribute's logarithm; the effect then has random numbers of its own.
    - ``needs_load``: whether the effect does nothing without masses (optional).
    - ``name``: the name of the effect and of its table in plant files (optional). By default it is the class's name in
      lower case with ``_`` between words.

    An effect may have a memory: a tuple of components of the joints' shape. Such an effect defines `begin` and `carry`.
    It also defines `rest` if the memory after a long time differs from the memory at the beginning.

    Attributes:
        table: Type to which the effect's table in a plant file is converted. None if this type is the effect's class
            itself, made by `toml_table`.
        remembers: Whether the effect has a memory.
    """

    name: ClassVar[str]
    place: ClassVar[float]
    spreads: ClassVar[Mapping[str, str | float]]
    needs_load: ClassVar[bool]
    remembers: ClassVar[bool]
    table: ClassVar[Any] = None

    def __init_subclass__(
        cls, place: float, spreads: Mapping[str, str | float] | None = None, needs_load: bool = False, name: str = ""
    ) -> None:
        """Store the arguments place, spreads, needs_load and name of a subclass; `Effect` explains them."""
        cls.name = name or re.sub(r"(?<!^)(?=[A-Z])", "_", cls.__name__).lower()
        cls.place, cls.spreads, cls.needs_load = place, spreads or {}, needs_load
        cls.remembers = cls.carry is not Effect.carry

    def act(self, at: Passage, memory: Components) -> None:
        """Apply the effect to a command's passage, in place; by default, append the effect to ``at.bends``.

        Args:
            at: The command's passage, which is changed in place.
            memory: The effect's memory; ``()`` if it has none.
        """
        at.bends.append(self)

    def flexure(self, at: Passage) -> Flexure:
        """Return a function that bends the frames of the links.

        An effect that only bends links defines this method instead of `act`.

        Args:
            at: The command's passage, with all joint positions.
        """
        raise NotImplementedError(f"effect '{self.name}' has neither act nor flexure")

    def begin(self, at: Passage) -> Components:
        """Return the effect's memory right after the arm is switched on, at rest at the joint command of ``at``."""
        return ()

    def rest(self, at: Passage) -> Components:
        """Return the limit of the effect's memory if the joint command of ``at`` is held for ever.

        The limit does not depend on what happened before.
        """
        return self.begin(at)

    def carry(self, at: Passage, memory: Components, dt: Scalar) -> Components:
        """Return the effect's memory after ``dt`` seconds, in which the command of ``at`` is held.

        ``memory`` is the memory before.
        """
        return memory

    def fault(self, arm: Arm) -> str:
        """Return an empty string if ``arm`` can have this effect, else an error message that says what to give."""
        return ""

    def own_sizes(self) -> tuple[Scalar, ...]:
        """Return the values of the attributes in ``spreads`` that use the effect's own random numbers."""
        names = (name for name, spread in self.spreads.items() if isinstance(spread, float))
        return tuple(number for name in names for number in _numbers(getattr(self, name)))

    def drawn(self, draws: Draws) -> Self:
        """Return the effect of many arms, with random factors made from ``draws``.

        Each attribute in ``spreads`` is this effect's value times one factor per arm.
        """
        parts: dict[str, Any] = {}
        used: Counter[str] = Counter()
        for name, spread in self.spreads.items():  # sizes of one spread take its columns one after another
            value, key = getattr(self, name), spread if isinstance(spread, str) else f"own {self.name}"
            sizes = draws.scaled(_numbers(value), key, used[key], spread)
            used[key] += len(sizes)
            parts[name] = sizes if isinstance(value, tuple) else sizes[0]
        return replace(cast(Any, self), **parts) if parts else self


def _numbers(value: Any) -> tuple[Any, ...]:
    return value if isinstance(value, tuple) else (value,)


def table_of(name: str) -> Any:
    """Return the type to which an effect's table in a plant file is converted; None if the effect has no table.

    Args:
        name: Name of the effect.

    Raises:
        InputError: If there is no such effect, if its package cannot be loaded, or if the registered object is no
            `Effect` class of that name.
    """
    kind = registry.get("effect", name)
    if not (isinstance(kind, type) and issubclass(kind, Effect) and kind.name == name):
        raise InputError(f"effect '{name}' is registered, but is no class of pickenv.arm.Effect with that name")
    return kind if kind.table is None and "__pydantic_config__" in vars(kind) else kind.table


def weights_behind(chain: Chain, frames: Sequence[Frame], load: Load) -> list[Weight]:
    """Compute for each link the `Weight` (mass and first moments) of the link, all later links and the payload.

    The list has one more entry at its end: the `Weight` of the payload alone.

    Args:
        chain: The chain.
        frames: The frames of the chain, from `pickenv.arm.kinematics.forward.frames`.
        load: The masses.
    """
    mass: Scalar = load.payload
    tool = attach(frames[-1], chain.tool)
    moment_x, moment_y = mass * tool[9], mass * tool[10]
    weights: list[Weight] = [(mass, moment_x, moment_y)]
    for i in reversed(range(len(chain.links))):
        xx, xy, _, yx, yy, _, zx, zy, _, px, py, _ = frames[i + 1]
        link_mass, (cx, cy, cz) = load.mass[i], load.centre[i]
        mass = mass + link_mass
        moment_x = moment_x + link_mass * (px + cx * xx + cy * yx + cz * zx)
        moment_y = moment_y + link_mass * (py + cx * xy + cy * yy + cz * zy)
        weights.append((mass, moment_x, moment_y))
    return weights[::-1]


def gravity_torques(chain: Chain, frames: Sequence[Frame], load: Load) -> list[Scalar]:
    """Compute the gravity torque (revolute, N*m) or force (prismatic, N) on each joint, positive along its axis.

    Args:
        chain: The chain.
        frames: The frames of the chain, from `pickenv.arm.kinematics.forward.frames`.
        load: The masses.
    """
    return weights_torques(chain, frames, weights_behind(chain, frames, load))


def weights_torques(chain: Chain, frames: Sequence[Frame], weights: Sequence[Weight]) -> list[Scalar]:
    """Compute the `gravity_torques` from the weights that `weights_behind` returned.

    Args:
        chain: The chain.
        frames: The frames of the chain, from `pickenv.arm.kinematics.forward.frames`.
        weights: From `weights_behind`; the entry of the payload is not used.
    """
    torques: list[Scalar] = []
    for link, frame, (mass, moment_x, moment_y) in zip(chain.links, frames[1:], weights, strict=False):
        zx, zy, zz, px, py, _ = frame[6:]
        if link.prismatic:
            torques.append(-GRAVITY * mass * zz)
        else:
            torques.append(GRAVITY * (zy * (moment_x - mass * px) - zx * (moment_y - mass * py)))
    return torques
