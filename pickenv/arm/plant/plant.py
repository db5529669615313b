"""The true arm: what a joint command really does to the tool.

Motor (counts, lag) -> drive error -> friction -> backlash -> compliance -> swing -> warm chain -> slides and boom ->
ground -> local structure -> what a calibration found beside these: each is an effect in a list, and without effects the
plant is exactly the true geometry. Some effects depend on the joints alone; the others have a memory, in components
that may be floats, arrays or tensors. Numbers may be arrays: one entry per arm, many arms at once.
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
from pickenv.base import InputError, registry, toml_tables

CONSTANTS = toml_tables.Check(
    lambda names: isinstance(names, list) and all(isinstance(name, str) and "." in name for name in names),
    'a list of "EFFECT.NUMBER", such as "base_tilt.stiffness"',
)


@toml_tables.toml_table
class Unmeasured:
    """Constants of a plant that nobody measured and that vary together: an entry of [[unmeasured]] in a plant file.

    Attributes:
        name: What the constants are.
        constants: Attributes of effects, such as "base_tilt.stiffness".
        times: Least and largest multiple of the plant's own numbers; all multiples between them are equally likely.
        source: Why the multiples reach so far.
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
    """The meaning of a calibration's coefficients beside the geometry, in order: harmonics, then moments.

    Attributes:
        harmonics: Joint and order (1/rad, 1/m) of each periodic error, which has a sine and a cosine coefficient.
        moments: The moments as in `pickenv.arm.effects.drives.GravityYield`.
        up: Direction against gravity in the axes of frame 0.
    """

    harmonics: tuple[tuple[int, float], ...] = ()
    moments: tuple[tuple[int, int, str], ...] = ()
    up: tuple[float, float, float] = (0.0, 0.0, 1.0)

    @property
    def sizes(self) -> tuple[int, int]:
        """Numbers of coefficients: of harmonics and of moments."""
        return 2 * len(self.harmonics), len(self.moments)


@dataclass(frozen=True, eq=False)
class Posterior:
    """An arm as a calibration found it, in P = 5L + 12 + k parameters: those of the geometry, then k coefficients.

    Attributes:
        identified: The geometry found, whose base and tool belong to the instrument's frame.
        aligned: Base and tool of the nominal arm, aligned to the instrument's frame.
        layout: What the coefficients mean.
        coefficients: The coefficients found ``(k,)``.
        factor: Change of the parameters per standard normal number ``(P, p)``.
        unseen: Places of the parameters that were not identified ``(d,)``.
        traces: Change of the parameters per unit of each unidentified one ``(P, d)``: itself, and what makes up for it.
        field: The residual field with its mean weights, or None.
        field_factor: Change of the weights of each output's smooth waves, cosines then sines, per standard normal
            number ``(O, 2 K, 2 K)``.
        rough: Standard deviation of each output's rough waves together ``(O,)``, m and rad.
        notes: What could be told apart and how, one sentence each.
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
"""An effect's methods for its memory (`Effect.begin`, `rest`, `carry`; an empty tuple without a memory), and its
`Effect.act`. They are looked up once, because for a single arm a look-up costs as much as a step."""

BEGIN, REST, CARRY = range(3)


@dataclass(frozen=True, eq=False)
class Plant:
    """An arm as its controller knows it, and everything that makes the real arm differ.

    Attributes:
        name: Name of the preset.
        arm: The arm; its nominal geometry is what the controller believes in.
        geometry: True geometry.
        load: Masses for gravity; without them some effects do nothing.
        effects: What else makes the real arm differ, in the order of action from the motors to the tool.
        posterior: How well a calibration knows all this, where the plant was made from one; else None.
        unmeasured: Which numbers of the effects nobody measured.
        ready: A geometry and its prepared chain, where numbers were moved or picked (`plant_batch.plants_on`); None to
            compute the chain. It is ignored if its geometry is not the plant's.

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
        """The true geometry made ready for the executors, at the temperature at which it was measured."""
        if self.ready is not None and self.ready[0] is self.geometry:
            return self.ready[1]
        return chain_of(self.geometry, math if self.geometry.alpha.ndim == 1 else np)

    @property
    def names(self) -> list[str]:
        """The names of the plant's effects in the order of tables: those that ship with pickenv first."""
        names = {effect.name: None for effect in self.effects}
        return list(dict.fromkeys([*(name for name in registry.names("effect") if name in names), *names]))

    def effect(self, name: str) -> Any:
        """The effect of this name, or None where it is switched off."""
        return next((effect for effect in self.effects if effect.name == name), None)

    def with_effect(self, *effects: Effect) -> Plant:
        """This plant with effects added; an effect replaces the one that has its name."""
        names = {effect.name for effect in effects}
        return replace(self, effects=(*(effect for effect in self.effects if effect.name not in names), *effects))

    def without(self, effects: str | Iterable[str]) -> Plant:
        """This plant with an effect, or several, switched off, by name.

        Raises:
            InputError: If there is no such effect, in this plant or another.
        """
        off, registered = {effects} if isinstance(effects, str) else set(effects), registry.names("effect")
        for name in sorted(off - {*registered, *(effect.name for effect in self.effects)}):
            raise InputError(f"unknown effect '{name}'; a plant has {', '.join(registered)}")
        return replace(self, effects=tuple(effect for effect in self.effects if effect.name not in off))

    @cached_property
    def _steps(self) -> tuple[list[_Step], list[_Step], list[_Step]]:
        """The effects that act, in three lists: before the last one with a memory, that one, and after it."""
        on_arm = [effect for effect in self.effects if effect.place < BESIDE]
        acting = [effect for effect in on_arm if self.load is not None or not effect.needs_load]
        steps: list[_Step] = [
            ((effect.begin, effect.rest, effect.carry) if effect.remembers else (), effect.act) for effect in acting
        ]
        end = max((i for i, (memory, _) in enumerate(steps, 1) if memory), default=0)
        return steps[: max(end - 1, 0)], steps[max(end - 1, 0) : end], steps[end:]

    @cached_property
    def _motors(self) -> list[tuple[Effect, int]]:
        """The effects on the motors, each with its memory's place in the state, in reverse order: counts come last."""
        motors = [effect for effect in self.effects if effect.place < DRIVE]
        return [(effect, sum(before.remembers for before in motors[:i])) for i, effect in enumerate(motors)][::-1]

    @cached_property
    def has_state(self) -> bool:
        """Whether the tool's pose depends on more than the present command, because an effect has a memory."""
        return bool(self._steps[1])

    def tool_frame(self, m: ModuleType, q: Sequence[Scalar]) -> Frame:
        """The true tool frame, in components, for the joint command ``q``; ``m`` is math, numpy or torch.

        The frame is settled and free of history: where the tool ends when ``q`` is held for ever. Gaps that gravity
        does not close, and the friction bands, are in their middle.
        """
        return self._ended(*self._passage(m, q, REST))

    def initial_state(self, m: ModuleType, q: Sequence[Scalar]) -> PlantState:
        """The state of an arm at rest at the command ``q``, just switched on: cold, and not yet sunk. See `advance`."""
        return self._passage(m, q, BEGIN)[0]

    def advance(self, m: ModuleType, state: PlantState, q: Sequence[Scalar], dt: Scalar) -> tuple[PlantState, Frame]:
        """Hold the joint command ``q`` for ``dt`` seconds.

        Friction and backlash see only where the motor was before and where it is in the end, which is right as long as
        the motor does not turn back within ``dt``; all else is exact for a held command.

        Args:
            m: ``math``, ``numpy`` or ``torch``.
            state: From `initial_state` or an earlier call.
            q: Joint command, n components, rad or m.
            dt: Time, s; one number, or one per arm.

        Returns:
            The new state, and the true tool frame at the end, which is `tool_frame` if no effect has a memory.
        """
        new, at = self._passage(m, q, CARRY, state, dt)
        return new, self._ended(new, at)

    def carried(self, m: ModuleType, state: PlantState, q: Sequence[Scalar], dt: Scalar) -> PlantState:
        """The new state as in `advance`, without the tool frame."""
        return self._passage(m, q, CARRY, state, dt)[0]

    def _passage(
        self, m: ModuleType, q: Sequence[Scalar], how: int, state: PlantState = (), dt: Scalar = 0.0
    ) -> tuple[PlantState, Passage]:
        """The new memories of the effects, and the passage up to where the last effect with a memory will act.

        ``how`` is the place of the method that makes the memories in `_Step` (`Effect.begin`, `rest` or `carry`).
        """
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
        """The tool frame after the remaining effects have acted on the passage."""
        _, last, after = self._steps
        for _, act in last:
            act(at, state[-1])
        for _, act in after:
            act(at, ())
        return at.frame

    def stands(self, m: ModuleType, state: PlantState, q: Sequence[Scalar]) -> tuple[list[Scalar], Frame]:
        """Positions of the joints ``(n,)``, rad or m, and the tool's frame, after `advance` to ``state`` at ``q``."""
        at, memories = Passage(m, self.chain, self.load, q), iter(state)
        for ways, act in (step for part in self._steps for step in part):
            act(at, next(memories) if ways else ())
        return list(at.joints), at.frame

    def readings(self, m: ModuleType, state: PlantState, q: Sequence[Scalar]) -> list[Scalar]:
        """What the motor encoders report after `advance` to ``state`` at the command ``q``, rad or m.

        Encoders report the motors in whole counts, with their following error: they see neither drive errors nor
        friction, backlash, deflection or swing.
        """
        at = Passage(m, self.chain, self.load, q)
        for effect, i in self._motors:
            effect.act(at, state[i] if effect.remembers else ())
        return list(at.motor)

    def tool_pose(self, q: ArrayLike) -> Pose:
        """The settled true tool pose, free of measurement noise, for joint commands ``(..., n)`` in rad and m."""
        return pose_of(self.tool_frame(np, split_joints(self.geometry.joints, q)))
