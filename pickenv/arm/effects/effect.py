"""Effects, and what they act on: a joint command on its way from the motors to the tool.

Formulas run on Python floats, NumPy arrays or torch tensors, like `pickenv.arm.kinematics.forward`; the numbers of an
effect may be arrays too, one entry per arm. Gravity points along -z of the world. Units: m, rad, N, kg, s.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from types import ModuleType
from typing import Annotated, Any, ClassVar, Self, cast

import numpy as np
from scipy.special import ndtri

from pickenv.arm.files.arm import Arm
from pickenv.arm.files.joint_keys import PER_JOINT
from pickenv.arm.kinematics.forward import Chain, Flexure, Frame, Scalar, attach, frames, tool_frame
from pickenv.arm.kinematics.geometry import Array
from pickenv.base import GRAVITY, KG, MM, InputError, registry, toml_table

MOTOR, DRIVE, GEAR, JOINT, BEND, BASE, TOOL, BESIDE = (float(place) for place in range(8))
"""Places where an effect acts, from the motors to the tool: on the motors (`Passage.turn`), in the drives
(`Passage.drive`), in the gears and at the joints (``joints``, ``chain``), along the links (``bends``), under the base
and at the tool (``frame``); an effect beside the arm (`BESIDE`) never moves it. Effects of one place act in the order
of its fractions."""

Components = tuple[Scalar, ...]

Weight = tuple[Scalar, Scalar, Scalar]
"""Everything that hangs on a link: its mass in kg, and mass times horizontal position (x, y) in the world, kg*m."""


@toml_table
class Load:
    """The masses that gravity pulls at.

    Attributes:
        mass: Mass of each link, kg.
        centre: Centre of mass of each link in the link's frame, m.
        payload: Mass held at the tool's origin, kg.
    """

    mass: Annotated[tuple[Scalar, ...], KG.not_negative, PER_JOINT]
    centre: Annotated[tuple[tuple[float, float, float], ...], MM, PER_JOINT]
    payload: Annotated[Scalar, KG.not_negative] = 0.0


class Passage:
    """A joint command on its way to the tool; the effects change it, one after the other.

    Attributes:
        m: The namespace of the formulas: ``math``, ``numpy`` or ``torch``.
        command: The joint command, n components, rad or m.
        motor: Positions of the motors, n components.
        driven: Positions at which the drives hold the joints, n components.
        joints: Positions of the joints, n components.
        cold: The true geometry as it was measured.
        chain: The true geometry as it is now.
        load: The masses, or None.
        bends: The effects that bend the links; each is asked for its `Effect.flexure` when all joints are known.
    """

    __slots__ = ("_frame", "_pull", "bends", "chain", "cold", "command", "driven", "joints", "load", "m", "motor")

    def __init__(self, m: ModuleType, chain: Chain, load: Load | None, command: Sequence[Scalar]) -> None:
        self.m, self.command, self.load = m, command, load
        self.motor = self.driven = self.joints = command
        self.cold = self.chain = chain
        self.bends: list[Effect] = []
        self._pull: tuple[list[Weight], list[Scalar]] | None = None
        self._frame: Frame | None = None

    def turn(self, motor: Sequence[Scalar]) -> None:
        """Move the motors, and with them the drives and the joints."""
        self.motor = self.driven = self.joints = motor

    def drive(self, driven: Sequence[Scalar]) -> None:
        """Move the drives, and with them the joints; the motors stay."""
        self.driven = self.joints = driven

    @property
    def pull(self) -> tuple[list[Weight], list[Scalar]]:
        """Gravity's pull on the straight, cold arm at its driven joints, as two lists; the plant must have masses.

        The first list has the weight on each link (the link and all behind it), and last what the tool holds; the
        second has the torques or forces on the joints, N*m or N. What bending and growth would change is small.
        """
        if self._pull is None:
            straight = frames(self.m, self.cold, self.driven)  # not kept: NumPy uses its memory again
            weights = weights_behind(self.cold, straight, cast(Load, self.load))
            self._pull = weights, weights_torques(self.cold, straight, weights)
        return self._pull

    @property
    def frame(self) -> Frame:
        """The tool's frame; once it was asked for, later changes of joints and links do not count."""
        if self._frame is None:
            bends = [effect.flexure(self) for effect in self.bends]
            bend = (
                bends[0] if len(bends) == 1 else lambda i, frame: reduce(lambda bent, one: one(i, bent), bends, frame)
            )
            self._frame = tool_frame(self.m, self.chain, self.joints, bend if bends else None)
        return self._frame

    @frame.setter
    def frame(self, frame: Frame) -> None:
        self._frame = frame


@dataclass(frozen=True, eq=False)
class Draws:
    """Evenly distributed random numbers of N arms, and how far their tolerance class lets the arms differ.

    Attributes:
        even: Numbers from 0 to 1 ``(N, k)`` by what they are for; those of one effect alone are under "own NAME".
        spread: Standard deviations of the logarithm of sizes, by the entries of [spread].
        temperature_rise: Range of the warm arm's temperature rise, K.
    """

    even: Mapping[str, Array]
    spread: Any
    temperature_rise: tuple[float, float]

    def scaled(self, values: Sequence[float], key: str, first: int = 0, spread: str | float = "") -> tuple[Array, ...]:
        """Each value times N factors about 1, which follow from its own column ``(N,)`` of the numbers ``key``.

        Args:
            values: The values.
            key: What the numbers are for.
            first: Column of the first value.
            spread: The entry of [spread], where its name is not ``key``; or the standard deviation itself.
        """
        size = spread if isinstance(spread, float) else getattr(self.spread, spread or key)
        factors = np.exp(size * standard_normal_of(self.even[key]))
        return tuple(value * factors[:, first + i] for i, value in enumerate(values))


def standard_normal_of(even: Array) -> Array:
    """The standard normal numbers that correspond to even numbers from 0 to 1."""
    return np.asarray(ndtri(np.clip(even, 1e-12, 1.0 - 1e-12)))


class Effect:
    """One cause of an arm's error: the base class of frozen dataclasses of numbers, for one arm or many.

    A class of effects says ``place``: where the effect acts, `MOTOR` to `BESIDE` and fractions. It may say ``spreads``:
    which of its numbers differ from arm to arm. Each such number has an entry in a tolerance class's [spread], whose
    random numbers it then shares, or else a standard deviation of its logarithm and random numbers of its own. It may
    say ``needs_load``: whether the effect does nothing without masses. It may say ``name``: what the effect and its
    table in plant files are called, where that is not the class's name in lower case with ``_`` between words.

    An effect that remembers has `begin` and `carry` (and `rest`, where the memory at rest differs from that at the
    beginning); its memory is a tuple of components of the joints' shape.

    Attributes:
        table: The type that a plant file's table is read as, where that is not the class itself as `toml_table` makes
            it.
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
        """Keep the place, spreads, need of masses and name that a class of effects gives."""
        cls.name = name or re.sub(r"(?<!^)(?=[A-Z])", "_", cls.__name__).lower()
        cls.place, cls.spreads, cls.needs_load = place, spreads or {}, needs_load
        cls.remembers = cls.carry is not Effect.carry

    def act(self, at: Passage, memory: Components) -> None:
        """Change the command's passage; by default, the effect joins its bends. No memory is ``()``."""
        at.bends.append(self)

    def flexure(self, at: Passage) -> Flexure:
        """How the links bend; an effect that only bends links defines this instead of `act`."""
        raise NotImplementedError(f"effect '{self.name}' has neither act nor flexure")

    def begin(self, at: Passage) -> Components:
        """The effect's memory when the arm was just switched on and rests at a command."""
        return ()

    def rest(self, at: Passage) -> Components:
        """The effect's memory once a command has been held for ever, whatever was before."""
        return self.begin(at)

    def carry(self, at: Passage, memory: Components, dt: Scalar) -> Components:
        """The effect's memory after a command has been held for ``dt`` seconds."""
        return memory

    def fault(self, arm: Arm) -> str:
        """A message's words: what is impossible about this effect on ``arm``, and what to give; empty if nothing is."""
        return ""

    def own_sizes(self) -> tuple[Scalar, ...]:
        """The numbers that differ from arm to arm and have random numbers of the effect's own."""
        names = (name for name, spread in self.spreads.items() if isinstance(spread, float))
        return tuple(number for name in names for number in _numbers(getattr(self, name)))

    def drawn(self, draws: Draws) -> Self:
        """The effect of many arms, whose numbers in ``spreads`` are drawn about this effect's own."""
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
    """The type that a registered effect's table in a plant file is read as; None if no file can hold the effect.

    Raises:
        InputError: If there is no such effect, its package cannot be loaded, or it is no effect of that name.
    """
    kind = registry.get("effect", name)
    if not (isinstance(kind, type) and issubclass(kind, Effect) and kind.name == name):
        raise InputError(f"effect '{name}' is registered, but is no class of pickenv.arm.Effect with that name")
    return kind if kind.table is None and "__pydantic_config__" in vars(kind) else kind.table


def weights_behind(chain: Chain, frames: Sequence[Frame], load: Load) -> list[Weight]:
    """For each link, the weight of the link and all links behind it; last, the weight of what the tool holds.

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
    """Generalised gravity forces on the joints: N*m for revolute, N for prismatic ones, positive along the joint.

    Args:
        chain: The chain.
        frames: The frames of the chain, from `pickenv.arm.kinematics.forward.frames`.
        load: The masses.
    """
    return weights_torques(chain, frames, weights_behind(chain, frames, load))


def weights_torques(chain: Chain, frames: Sequence[Frame], weights: Sequence[Weight]) -> list[Scalar]:
    """The `gravity_torques` for weights that are known: one entry per link, as `weights_behind` gives them."""
    torques: list[Scalar] = []
    for link, frame, (mass, moment_x, moment_y) in zip(chain.links, frames[1:], weights, strict=False):
        zx, zy, zz, px, py, _ = frame[6:]
        if link.prismatic:
            torques.append(-GRAVITY * mass * zz)
        else:
            torques.append(GRAVITY * (zy * (moment_x - mass * px) - zx * (moment_y - mass * py)))
    return torques
