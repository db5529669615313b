"""The true arm: what a joint command really does to the tool.

Motor (counts, lag) -> drive error -> friction -> backlash -> compliance -> swing -> warm chain -> slides and boom ->
ground -> local structure -> what a calibration found beside them: each is an effect in a list, and with none of them
the plant is exactly the true geometry. Some effects depend on the joints alone; the others remember, in components
that run on floats, arrays and tensors. Numbers may be arrays: one entry per arm, many arms at once.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from types import ModuleType
from typing import Annotated, Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pickenv.arm.effects.effect import BESIDE, DRIVE, Components, Effect, Load, Passage
from pickenv.arm.effects.residual_field import ResidualField
from pickenv.arm.files.arm import Arm
from pickenv.arm.kinematics.forward import Chain, Frame, Scalar, chain_of, pose_of, split_joints
from pickenv.arm.kinematics.geometry import Array, Geometry, Pose
from pickenv.base import registry, toml_tables

CONSTANTS = toml_tables.Check(
    lambda names: isinstance(names, list) and all(isinstance(name, str) and "." in name for name in names),
    'a list of "EFFECT.NUMBER", such as "base_tilt.stiffness"',
)


@toml_tables.toml_table
class Unmeasured:
    """Constants of a plant that nobody measured, which are larger or smaller together: [[unmeasured]] of a plant file.

    Attributes:
        name: What they are.
        constants: Attributes of effects, such as "base_tilt.stiffness".
        times: Least and largest multiple of the plant's own numbers that is as likely as any between.
        source: Why so far.
    """

    name: Annotated[str, toml_tables.LINE]
    constants: Annotated[tuple[str, ...], CONSTANTS]
    times: Annotated[tuple[float, float], toml_tables.NUMBER.positive, toml_tables.IN_ORDER]
    source: str


# What a calibration knows of one arm, and how surely: numbers of which `pickenv.arm.plant.twin_file` makes plants. The
# arm's numbers are linear in standard normal ones, plus what was not identified: a parameter that the data cannot tell
# from others may lie anywhere in its tolerance, as long as the others give way so that what was measured stays.


@dataclass(frozen=True)
class Layout:
    """The meaning of each coefficient beside the geometry, in order: leads, harmonics, moments, then the boom's two.

    Attributes:
        leads: The joint of each lead error, from 0.
        harmonics: Joint and order (1/rad, 1/m) of each periodic error, which has a sine and a cosine coefficient.
        moments: As `pickenv.arm.effects.drives.GravityYield` has them.
        up: Direction against gravity in the axes of frame 0.
        boom: Joint of a boom that bends and its free length in m, or None; tip load and own weight over EI.
    """

    leads: tuple[int, ...] = ()
    harmonics: tuple[tuple[int, float], ...] = ()
    moments: tuple[tuple[int, int, str], ...] = ()
    up: tuple[float, float, float] = (0.0, 0.0, 1.0)
    boom: tuple[int, float] | None = None

    @property
    def sizes(self) -> tuple[int, int, int, int]:
        """Number of coefficients of each kind."""
        return len(self.leads), 2 * len(self.harmonics), len(self.moments), 2 * (self.boom is not None)


@dataclass(frozen=True, eq=False)
class Posterior:
    """An arm as it was found; P = 5L + 12 + k parameters: the geometry's, then the coefficients.

    Attributes:
        identified: Geometry found, base and tool in the instrument's frame.
        aligned: Base and tool of the nominal arm in that frame.
        layout: What the coefficients are.
        coefficients: The coefficients found ``(k,)``.
        factor: Parameters per standard normal number ``(P, p)``.
        unseen: Places of the parameters that were not identified ``(d,)``.
        traces: Parameters per unit of each of them ``(P, d)``: itself, and what gives way.
        field: The residual's mean, or None.
        field_factor: Weights of each output's smooth waves, cosines then sines, per standard normal number
            ``(O, 2 K, 2 K)``.
        rough: Standard deviation of each output's rough waves together ``(O,)``, m and rad.
        notes: What was told apart and how, one sentence each.
    """

    identified: Geometry
    aligned: tuple[Pose, Pose]
    layout: Layout
    coefficients: Array
    factor: Array
    unseen: NDArray[np.int64]
    traces: Array
    field: ResidualField | None
    field_factor: Array
    rough: Array
    notes: tuple[str, ...] = ()


PlantState = tuple[Components, ...]
"""A plant's memory from one moment to the next: the memory of each effect that has one, in the plant's order."""


_Step: TypeAlias = tuple[tuple[Callable[..., Components], ...], Callable[[Passage, Components], None]]
"""Methods that an effect has for its memory (`Effect.begin`, `rest`, `carry`; nothing where it has none), and its
`Effect.act`: looked up once, for in steps of one arm that costs as much as they do."""

BEGIN, REST, CARRY = range(3)


@dataclass(frozen=True, eq=False)
class Plant:
    """An arm as its controller knows it, and everything that makes the real one differ.

    Attributes:
        name: Name of the preset.
        arm: The arm; its nominal geometry is what the controller believes in.
        geometry: True geometry.
        load: Masses for gravity; without them some effects do nothing.
        effects: What else makes it differ, in the order in which it acts from the motors to the tool.
        posterior: How surely a calibration knows all this, where the plant was made of one; else None.
        unmeasured: Which of its effects' numbers nobody measured.
        ready: A geometry and its chain where its numbers were moved or picked (`plant_batch.plants_on`), or None to
            compute it; of another geometry than the plant's it is passed over.

    Raises:
        ValueError: If two effects have one name.
    """

    name: str
    arm: Arm
    geometry: Geometry
    load: Load | None = None
    effects: tuple[Effect, ...] = ()
    posterior: Posterior | None = None
    unmeasured: tuple[Unmeasured, ...] = ()
    ready: tuple[Geometry, Chain] | None = None

    def __post_init__(self) -> None:
        names = [effect.name for effect in self.effects]
        if len(set(names)) < len(names):
            raise ValueError(f"plant '{self.name}' has effects {', '.join(names)}; give each once")
        object.__setattr__(self, "effects", tuple(sorted(self.effects, key=lambda effect: effect.place)))

    @cached_property
    def chain(self) -> Chain:
        """The true geometry made ready for the executors, at the temperature at which it holds."""
        if self.ready is not None and self.ready[0] is self.geometry:
            return self.ready[1]
        return chain_of(self.geometry, math if self.geometry.alpha.ndim == 1 else np)

    @property
    def names(self) -> list[str]:
        """The names of its effects, in the order of tables: what ships first."""
        names = {effect.name: None for effect in self.effects}
        return list(dict.fromkeys([*(name for name in registry.names("effect") if name in names), *names]))

    def effect(self, name: str) -> Any:
        """The effect of this name, or None where it is switched off."""
        return next((effect for effect in self.effects if effect.name == name), None)

    def with_effect(self, *effects: Effect) -> Plant:
        """This plant with effects added, or put in the place of those of their names."""
        names = {effect.name for effect in effects}
        return replace(self, effects=(*(effect for effect in self.effects if effect.name not in names), *effects))

    def without(self, effects: str | Iterable[str]) -> Plant:
        """This plant with an effect, or several, switched off, by name.

        Raises:
            ValueError: If there is no such effect, in this plant or another.
        """
        off, registered = {effects} if isinstance(effects, str) else set(effects), registry.names("effect")
        for name in sorted(off - {*registered, *(effect.name for effect in self.effects)}):
            raise ValueError(f"unknown effect '{name}'; a plant has {', '.join(registered)}")
        return replace(self, effects=tuple(effect for effect in self.effects if effect.name not in off))

    @cached_property
    def _steps(self) -> tuple[list[_Step], list[_Step], list[_Step]]:
        """The effects that act, in order: those before the last that remembers, that one, and those after it."""
        on_arm = [effect for effect in self.effects if effect.place < BESIDE]
        acting = [effect for effect in on_arm if self.load is not None or not effect.needs_load]
        steps: list[_Step] = [
            ((effect.begin, effect.rest, effect.carry) if effect.remembers else (), effect.act) for effect in acting
        ]
        end = max((i for i, (memory, _) in enumerate(steps, 1) if memory), default=0)
        return steps[: max(end - 1, 0)], steps[max(end - 1, 0) : end], steps[end:]

    @cached_property
    def _motors(self) -> list[tuple[Effect, int]]:
        """The effects on the motors and the places of their memories, from the drive's side: counts are read last."""
        motors = [effect for effect in self.effects if effect.place < DRIVE]
        return [(effect, sum(before.remembers for before in motors[:i])) for i, effect in enumerate(motors)][::-1]

    @cached_property
    def has_state(self) -> bool:
        """Whether where the tool stands depends on more than the present command."""
        return bool(self._steps[1])

    def tool_frame(self, m: ModuleType, q: Sequence[Scalar]) -> Frame:
        """True tool frame in components, for the joint command ``q``; ``m`` is math, numpy or torch.

        It is the settled, history-free pose: where the tool ends when ``q`` is held for ever. Gaps that gravity does
        not close, and the friction band, are in their middle.
        """
        return self._ended(*self._passage(m, q, REST))

    def initial_state(self, m: ModuleType, q: Sequence[Scalar]) -> PlantState:
        """State at rest at the command ``q``, just switched on: cold, and not yet sunk. See `advance`."""
        return self._passage(m, q, BEGIN)[0]

    def advance(self, m: ModuleType, state: PlantState, q: Sequence[Scalar], dt: Scalar) -> tuple[PlantState, Frame]:
        """Hold the joint command ``q`` for ``dt`` seconds.

        Friction and backlash see the motor's way from where it was to where it is in the end, which is right as long as
        it does not turn back within ``dt``; all else is exact for a held command.

        Args:
            m: ``math``, ``numpy`` or ``torch``.
            state: From `initial_state` or an earlier call.
            q: Joint command, n components, rad or m.
            dt: s, one number or one per arm.

        Returns:
            The new state, and the true tool frame at the end; with no effect that has a state, that is `tool_frame`.
        """
        new, at = self._passage(m, q, CARRY, state, dt)
        return new, self._ended(new, at)

    def carried(self, m: ModuleType, state: PlantState, q: Sequence[Scalar], dt: Scalar) -> PlantState:
        """The state of `advance`, where nobody asks for the tool."""
        return self._passage(m, q, CARRY, state, dt)[0]

    def _passage(
        self, m: ModuleType, q: Sequence[Scalar], how: int, state: PlantState = (), dt: Scalar = 0.0
    ) -> tuple[PlantState, Passage]:
        """Memories of the effects (`Effect.carry`, ...), and the passage up to where the last that has one will act."""
        at = Passage(m, self.chain, self.load, q)
        memories: list[Components] = []
        before, last, _ = self._steps
        for ways, act in before:
            memory: Components = ()
            if ways:
                memory = ways[how](at, state[len(memories)], dt) if how == CARRY else ways[how](at)
                memories.append(memory)
            act(at, memory)
        for ways, _ in last:
            memories.append(ways[how](at, state[len(memories)], dt) if how == CARRY else ways[how](at))
        return tuple(memories), at

    def _ended(self, state: PlantState, at: Passage) -> Frame:
        """The tool at the end of a passage."""
        _, last, after = self._steps
        for _, act in last:
            act(at, state[-1])
        for _, act in after:
            act(at, ())
        return at.frame

    def readings(self, m: ModuleType, state: PlantState, q: Sequence[Scalar]) -> list[Scalar]:
        """The report of the motor encoders after `advance` to ``state`` at the command ``q``, rad or m.

        The motor in whole counts, with its following error: they see neither drive errors nor friction, backlash,
        deflection or swing.
        """
        at = Passage(m, self.chain, self.load, q)
        for effect, i in self._motors:
            effect.act(at, state[i] if effect.remembers else ())
        return list(at.motor)

    def tool_pose(self, q: ArrayLike) -> Pose:
        """True tool pose, free of measurement noise, for joint commands ``(..., n)`` in rad and m."""
        return pose_of(self.tool_frame(np, split_joints(self.geometry.joints, q)))
