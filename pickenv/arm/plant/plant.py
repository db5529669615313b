"""The plant, that is the simulated true arm: it computes the true tool pose that a joint command leads to.

A plant has a true geometry and a list of effects. They act in this order: motor (encoder counts, lag), drive error,
friction, backlash, compliance, vibration, thermal growth, slides and boom, ground, local structure, residual. Without
effects the plant is exactly the true geometry. Some effects depend on the joints alone. The others have a memory, whose
components may be floats, arrays or tensors.

One plant can stand for many arms: its numbers may be arrays with one entry per arm. In a batch of N arms,
link parameters of the geometry are ``(N, n)`` and other numbers ``(N,)``. A number that all arms share stays a plain
number. Base and tool are shared, or have one entry per arm too.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import cached_property
from types import ModuleType
from typing import Annotated, Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pickenv.arm.effects.effect import BESIDE, DRIVE, Components, Effect, Passage
from pickenv.arm.effects.residual_field import ResidualField
from pickenv.arm.files.arm import Arm, Load
from pickenv.arm.kinematics.forward import Chain, Frame, Scalar, Scalars, chain_of, pose_of, split_joints
from pickenv.arm.kinematics.geometry import LINK_PARAMETERS, Array, Geometry, Pose
from pickenv.base import InputError, registry, toml_tables

CONSTANTS = toml_tables.Check(
    lambda names: isinstance(names, list) and all(isinstance(name, str) and "." in name for name in names),
    'a list of "EFFECT.NUMBER", such as "base_tilt.stiffness"',
)


@toml_tables.toml_table
class Unmeasured:
    """Constants of a plant (a simulated true arm) that were never measured: an entry of [[unmeasured]] in its file.

    The constants form a group: all are multiplied by one random factor.

    Attributes:
        name: Name of the group.
        constants: Attributes of effects, such as "base_tilt.stiffness".
        times: Least and largest factor; the factor is uniform between the two.
        source: Reason for this range.
    """

    name: Annotated[str, toml_tables.LINE]
    constants: Annotated[tuple[str, ...], CONSTANTS]
    times: Annotated[tuple[float, float], toml_tables.NUMBER.positive, toml_tables.IN_ORDER]
    source: str


# What a calibration knows of one arm, and how surely: numbers of which `pickenv.arm.plant.populations` makes plants.
# The arm's numbers are linear in standard normal ones, plus what was not identified: a parameter that the data cannot
# tell from others may lie anywhere in its tolerance, as long as the others give way so that what was measured stays.


@dataclass(frozen=True)
class Layout:
    """The meaning of a calibration's k coefficients, which follow the geometry's parameters.

    Two coefficients (sine, cosine) for each periodic error come first, then one for each gravity term.

    Attributes:
        harmonics: Joint index (from 0) and order (1/rad or 1/m) of each periodic error: the error is periodic in order
            times the joint's displacement.
        moments: The gravity terms, as in `pickenv.arm.effects.drives.GravityYield`.
        up: Direction against gravity in the axes of frame 0.
    """

    harmonics: tuple[tuple[int, float], ...] = ()
    moments: tuple[tuple[int, int, str], ...] = ()
    up: tuple[float, float, float] = (0.0, 0.0, 1.0)

    @property
    def sizes(self) -> tuple[int, int]:
        """Two numbers: how many coefficients belong to periodic errors, and how many to gravity terms."""
        return 2 * len(self.harmonics), len(self.moments)


@dataclass(frozen=True, eq=False)
class Posterior:
    """The posterior distribution of a calibrated arm with L links over P = 5L + 12 + k parameters.

    The parameters are the geometry's parameters, then the k coefficients of `Layout`. A sample is the identified value,
    plus ``factor`` times p standard normal numbers, plus ``traces`` times d deviations within tolerances.

    Attributes:
        identified: The identified geometry; its base and tool refer to the instrument's frame.
        aligned: Base and tool of the nominal arm, aligned to the instrument's frame.
        layout: The meaning of the coefficients.
        coefficients: The identified coefficients ``(k,)``.
        factor: Change of the parameters per standard normal number ``(P, p)``; a sample takes p numbers.
        unseen: Indices, from 0, of the d parameters that the data do not identify ``(d,)``.
        traces: Change of all P parameters per unit of each unidentified parameter ``(P, d)``, such that the tool keeps
            the measured poses.
        field: The residual field with its mean weights, or None.
        field_factor: Change of the field's weights per standard normal number ``(O, 2 K, 2 K)``, for O outputs. Here K
            counts only the smooth waves of an output. Weights of cosines come first, then weights of sines.
        rough: Standard deviation of the sum of each output's rough waves ``(O,)``, m and rad.
        notes: Sentences that say which causes the data can distinguish, and how.
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
"""The state of a plant: the memory of each effect that has one, in the order of the plant's effects."""


_Step: TypeAlias = tuple[tuple[Callable[..., Components], ...], Callable[[Passage, Components], None]]
"""An effect's methods for its memory (`Effect.begin`, `rest`, `carry`; an empty tuple without a memory), and its
`Effect.act`. They are looked up once, because for a single arm a look-up costs as much as a step."""

BEGIN, REST, CARRY = range(3)


@dataclass(frozen=True, eq=False)
class Plant:
    """A simulated true arm: the arm that its controller knows, and all causes of the difference.

    Attributes:
        name: Name of the plant.
        arm: The arm, with the nominal geometry that the controller uses.
        geometry: True geometry.
        load: Masses on which gravity acts, or None; without them some effects do nothing.
        effects: The effects, in the order in which they act, from the motors to the tool.
        posterior: Posterior distribution of the calibration from which the plant was made, else None.
        unmeasured: Groups of the effects' constants that were never measured.
        ready: A geometry and its `Chain`, from `plants_on`; None to compute the chain. The chain is ignored if this
            geometry is not the plant's.

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
        """The true geometry as a `Chain`, at the temperature at which it was measured."""
        if self.ready is not None and self.ready[0] is self.geometry:
            return self.ready[1]
        return chain_of(self.geometry, math if self.geometry.alpha.ndim == 1 else np)

    @property
    def names(self) -> list[str]:
        """The names of the plant's effects in the order of tables and reports: shipped effects come first."""
        names = {effect.name: None for effect in self.effects}
        return list(dict.fromkeys([*(name for name in registry.names("effect") if name in names), *names]))

    def effect(self, name: str) -> Any:
        """Return the effect of this name, or None if the plant does not have it."""
        return next((effect for effect in self.effects if effect.name == name), None)

    def with_effect(self, *effects: Effect) -> Plant:
        """Return this plant with effects added; an effect replaces an effect of the same name."""
        names = {effect.name for effect in effects}
        return replace(self, effects=(*(effect for effect in self.effects if effect.name not in names), *effects))

    def without(self, effects: str | Iterable[str]) -> Plant:
        """Return this plant without the effects of these names; effects that it does not have are ignored.

        Args:
            effects: One name, or several.

        Raises:
            InputError: If neither a registered effect nor an effect of this plant has one of the names.
        """
        off, registered = {effects} if isinstance(effects, str) else set(effects), registry.names("effect")
        for name in sorted(off - {*registered, *(effect.name for effect in self.effects)}):
            raise InputError(f"unknown effect '{name}'; a plant has {', '.join(registered)}")
        return replace(self, effects=tuple(effect for effect in self.effects if effect.name not in off))

    @cached_property
    def _steps(self) -> tuple[list[_Step], list[_Step], list[_Step]]:
        """The effects that move the arm, in three lists. The last effect that has a memory separates them.

        The first list has the effects that act before this effect. The second list has this effect alone. The third
        list has the effects that act after it. If no effect has a memory, all effects are in the third list.
        """
        on_arm = [effect for effect in self.effects if effect.place < BESIDE]
        acting = [effect for effect in on_arm if self.load is not None or not effect.needs_load]
        steps: list[_Step] = [
            ((effect.begin, effect.rest, effect.carry) if effect.remembers else (), effect.act) for effect in acting
        ]
        end = max((i for i, (memory, _) in enumerate(steps, 1) if memory), default=0)
        return steps[: max(end - 1, 0)], steps[max(end - 1, 0) : end], steps[end:]

    @cached_property
    def _motors(self) -> list[tuple[Effect, int]]:
        """The effects on the motors, each with the index (from 0) of its memory in a `PlantState`.

        The order is the reverse of `effects`. So the effect of the encoder counts, which is first there, is last here.
        """
        motors = [effect for effect in self.effects if effect.place < DRIVE]
        return [(effect, sum(before.remembers for before in motors[:i])) for i, effect in enumerate(motors)][::-1]

    @cached_property
    def has_state(self) -> bool:
        """Whether the tool's pose depends on more than the present command, because an effect has a memory."""
        return bool(self._steps[1])

    def tool_frame(self, m: ModuleType, q: Scalars) -> Frame:
        """Compute the settled true tool frame for a joint command, in world axes.

        The frame does not depend on the past: it is the limit if the command is held for ever. Friction, and backlash
        that gravity does not close, are in the middle of their bands.

        Args:
            m: The namespace of the functions: ``math``, ``numpy`` or ``torch``.
            q: Joint command, n components, rad or m.
        """
        return self._ended(*self._passage(m, q, REST))

    def initial_state(self, m: ModuleType, q: Scalars) -> PlantState:
        """Return the state of an arm right after it is switched on, at rest at a command.

        The arm is at its initial temperature, and the ground has not yet settled.

        Args:
            m: The namespace of the functions: ``math``, ``numpy`` or ``torch``.
            q: Joint command, n components, rad or m.
        """
        return self._passage(m, q, BEGIN)[0]

    def advance(self, m: ModuleType, state: PlantState, q: Scalars, dt: Scalar) -> tuple[PlantState, Frame]:
        """Simulate holding the joint command ``q`` for ``dt`` seconds.

        Friction and backlash depend only on the motor positions before and after ``dt``. This is correct as long as no
        motor reverses within ``dt``. All other effects are exact for a held command.

        Args:
            m: The namespace of the functions: ``math``, ``numpy`` or ``torch``.
            state: State from `initial_state` or an earlier call.
            q: Joint command, n components, rad or m.
            dt: Time, s; one number, or one per arm.

        Returns:
            The new state, and the true tool frame at the end in world axes. If no effect has a memory, the frame is
            the result of `tool_frame`.
        """
        new, at = self._passage(m, q, CARRY, state, dt)
        return new, self._ended(new, at)

    def carried(self, m: ModuleType, state: PlantState, q: Scalars, dt: Scalar) -> PlantState:
        """Return only the new state of `advance`, without computing the tool frame; the arguments are the same."""
        return self._passage(m, q, CARRY, state, dt)[0]

    def _passage(
        self, m: ModuleType, q: Scalars, how: int, state: PlantState = (), dt: Scalar = 0.0
    ) -> tuple[PlantState, Passage]:
        """Return the effects' new memories, and the command's passage just before the last effect with a memory acts.

        Args:
            m: The namespace of the functions: ``math``, ``numpy`` or ``torch``.
            q: Joint command, n components, rad or m.
            how: Index of the method that makes the memories: BEGIN, REST or CARRY.
            state: The memories before; only used by CARRY.
            dt: Time since ``state``, s; only used by CARRY.
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
        """Complete the passage ``at`` from `_passage`, and return the true tool frame in world axes.

        The effects that still have to act are the last effect with a memory, and all effects after it. ``state`` has
        the memory.
        """
        _, last, after = self._steps
        for _, act in last:
            act(at, state[-1])
        for _, act in after:
            act(at, ())
        return at.frame

    def stands(self, m: ModuleType, state: PlantState, q: Scalars) -> tuple[list[Scalar], Frame]:
        """Return the true joint positions and the true tool frame in the state ``state``.

        Args:
            m: The namespace of the functions: ``math``, ``numpy`` or ``torch``.
            state: The state that `advance` returned.
            q: The joint command of that call, n components, rad or m.

        Returns:
            Positions of the n joints, rad or m, and the tool frame in world axes.
        """
        at, memories = Passage(m, self.chain, self.load, q), iter(state)
        for ways, act in (step for part in self._steps for step in part):
            act(at, next(memories) if ways else ())
        return list(at.joints), at.frame

    def readings(self, m: ModuleType, state: PlantState, q: Scalars) -> list[Scalar]:
        """Return the readings of the motor encoders in the state ``state``: n components, rad or m.

        A reading is the motor position, with its following error, rounded to encoder counts. It does not contain drive
        errors, friction, backlash, deflection or vibration.

        Args:
            m: The namespace of the functions: ``math``, ``numpy`` or ``torch``.
            state: The state that `advance` returned.
            q: The joint command of that call, n components, rad or m.
        """
        at = Passage(m, self.chain, self.load, q)
        for effect, i in self._motors:
            effect.act(at, state[i] if effect.remembers else ())
        return list(at.motor)

    def tool_pose(self, q: ArrayLike) -> Pose:
        """Compute the settled true tool poses (see `tool_frame`) for joint commands ``(..., n)``, rad or m."""
        return pose_of(self.tool_frame(np, split_joints(self.geometry.joints, q)))


def plant_count(plants: Plant) -> int | None:
    """Return the number of arms in a batch, or None for a single arm."""
    return None if plants.geometry.alpha.ndim == 1 else len(plants.geometry.alpha)


def plant_at(plants: Plant, i: int) -> Plant:
    """Return the plant of arm ``i`` (from 0) of a batch, with plain numbers.

    Raises:
        IndexError: If there is no such arm.
    """
    count = plant_count(plants)
    if count is None or not -count <= i < count:
        raise IndexError(f"there is no arm {i} in this plant of {count or 1} arms")

    def own(values: Array) -> Any:
        return values[i] if values.ndim > 1 else float(values[i])

    load, effects = tree_map(own, (plants.load, plants.effects))
    geometry = with_links(plants.geometry, lambda values: values[i])
    return replace(plants, geometry=geometry, load=load, effects=effects, ready=None)


def plants_on(plants: Plant, change: Callable[[Array], Scalar]) -> Plant:
    """Return a batch of arms with a function applied to each of its arrays, for example to move it to a GPU.

    The sines and cosines of the link parameters are converted too, instead of being computed anew. Therefore an arm has
    the same numbers, bit by bit, in a batch of any size. A single arm is returned unchanged.

    Args:
        plants: A batch of arms.
        change: Function from an array to the new array, for example
            ``lambda values: torch.as_tensor(values, dtype=torch.float32, device="cuda")`` or, to select some arms,
            ``lambda values: values[rows]``.
    """
    if plant_count(plants) is None:
        return plants
    geometry = with_links(plants.geometry, change)
    load, effects, chain = tree_map(change, (plants.load, plants.effects, plants.chain))  # in `arrays_of`'s order
    return replace(plants, geometry=geometry, load=load, effects=effects, ready=(geometry, chain))


def arrays_of(plants: Plant) -> list[Any]:
    """Return all arrays of a batch of arms in a fixed order, so that other arms can be written into them.

    The list is empty for a single arm.
    """
    if plant_count(plants) is None:
        return []
    links = tuple(getattr(plants.geometry, name) for name in LINK_PARAMETERS)
    return leaves((links, plants.load, plants.effects, plants.chain))


def with_links(geometry: Geometry, change: Callable[..., Any], *others: Geometry) -> Geometry:
    """Return the geometry with a function applied to each of its link parameters.

    If the bases or tools of a batch of arms differ, the function is applied to bases or tools too.

    Args:
        geometry: The geometry.
        change: Function that returns the new array. Its arguments are the array of ``geometry`` and the
            arrays of ``others``.
        others: Geometries whose arrays the function needs too.
    """
    tables = (geometry, *others)
    values: dict[str, Any] = {name: change(*(getattr(table, name) for table in tables)) for name in LINK_PARAMETERS}
    for name in ("base", "tool"):
        if getattr(geometry, name).position.ndim > 1:
            values[name] = Pose(*map(change, *(getattr(table, name) for table in tables)))
    return replace(geometry, **values)


# Trees of numbers: tuples, named tuples and dataclasses, nested, whose leaves are arrays of NumPy or torch. An array
# with at least one axis is a leaf; numbers, words and None stay as they are, and so does a dataclass whose class says
# ``shared = True``: its arrays belong to all arms together, not one entry to each.


def tree_map(change: Callable[[Any], Any], tree: Any) -> Any:
    """Return a tree with ``change`` applied to each of its arrays.

    Args:
        change: Function from an array to the new array.
        tree: Nested tuples, named tuples and dataclasses, whose leaves are arrays or tensors. Other values, and
            dataclasses with the class attribute ``shared = True``, are unchanged.
    """
    if getattr(tree, "ndim", 0):
        return change(tree)
    if isinstance(tree, tuple):
        parts = (tree_map(change, part) for part in tree)
        return type(tree)(*parts) if hasattr(tree, "_fields") else tuple(parts)
    if _opens(tree):
        return replace(tree, **{field.name: tree_map(change, getattr(tree, field.name)) for field in fields(tree)})
    return tree


def leaves(tree: Any) -> list[Any]:
    """Return the arrays of a tree (see `tree_map`), in the order of its entries and fields, without copying them."""
    if getattr(tree, "ndim", 0):
        return [tree]
    if _opens(tree):
        tree = tuple(getattr(tree, field.name) for field in fields(tree))
    return [leaf for part in tree for leaf in leaves(part)] if isinstance(tree, tuple) else []


def _opens(tree: Any) -> bool:
    """Return whether ``tree`` is a dataclass whose fields may hold leaves; False if its class is marked as shared."""
    return is_dataclass(tree) and not isinstance(tree, type) and not getattr(tree, "shared", False)
