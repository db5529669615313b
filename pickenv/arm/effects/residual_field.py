"""Errors that no link table can express: the tool's displacement as a random function of the joints, a sum of waves.

The waves are random features of a Gaussian process (Rahimi and Recht 2007). An output is the sum over k of
a_k cos(w_k x) + b_k sin(w_k x). Here x are the joints minus a centre. Joints with a wide range enter by sine and
cosine. Arms share the frequencies w_k and differ in the weights a_k and b_k. Each output has smooth waves first, then
rough waves. A calibration learns the weights of the smooth waves. Rough waves have such a short length
scale that measurements cannot distinguish them from scatter. Waves are computed in single precision, because they are
most of the cost; this is exact to nanometres. The module also has periodic errors of drives that differ from arm to
arm. Units: m and rad.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property, partial
from types import ModuleType
from typing import Annotated, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from pickenv.arm.effects.effect import (
    DRIVE,
    LENGTH,
    TOOL,
    TRAVEL,
    ByJoint,
    Components,
    Draws,
    Effect,
    Passage,
    numbers_per_joint,
    standard_normal_of,
)
from pickenv.arm.effects.structure import Harmonic, with_waves
from pickenv.arm.kinematics.forward import Scalar, Scalars, outside
from pickenv.arm.kinematics.geometry import Array
from pickenv.arm.kinematics.task_space import displaced_frame
from pickenv.base import MM, NUMBER, WHOLE, InputError, Then, register, toml_table

CHUNK = 64
"""Number of arms or poses that NumPy computes together, so that their waves fit into a core's cache."""

Single = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Features:
    """The frequencies of a field's waves, which all arms share.

    Attributes:
        frequency: Angular frequencies of the waves ``(F, O K)``, 1/rad or 1/m. There is one row for each of the F
            inputs, and there are K columns for each of the O outputs.
        centre: Value that is subtracted from each input, F numbers.
        periodic: For each joint, whether its sine and cosine are inputs instead of the joint itself.
        outputs: Number of outputs O: 3 (position) or 6 (pose).
    """

    shared: ClassVar[bool] = True  # `pickenv.arm.plant.plant` leaves it as it is

    frequency: Single
    centre: tuple[float, ...]
    periodic: tuple[bool, ...]
    outputs: int

    @property
    def count(self) -> int:
        """Number K of waves per output."""
        return int(self.frequency.shape[1]) // self.outputs

    def inputs(self, m: ModuleType, q: Scalars) -> list[Scalar]:
        """Return the F inputs at joints ``q``, minus the centre.

        The joints that are not periodic come first, then the sines of the periodic joints, then their cosines.

        Args:
            m: The namespace of the functions: ``math``, ``numpy`` or ``torch``.
            q: Joints, n components, rad or m.
        """
        turning = [value for value, far in zip(q, self.periodic, strict=True) if far]
        direct = [value for value, far in zip(q, self.periodic, strict=True) if not far]
        raw = [*direct, *(m.sin(value) for value in turning), *(m.cos(value) for value in turning)]
        return [value - centre for value, centre in zip(raw, self.centre, strict=True)]

    def angles(self, inputs: Array) -> Single:
        """Return the phase angles w_k x of the waves ``(..., O, K)`` at inputs ``(F, ...)``."""
        total: Any = np.float32(0.0)
        for value, row in zip(inputs.astype(np.float32), self.frequency, strict=True):
            total = total + value[..., None] * row  # one after the other, so that sums repeat to the bit
        return np.asarray(total.reshape(*total.shape[:-1], self.outputs, self.count))

    @cached_property
    def tensors(self) -> dict[Any, Any]:
        """Cache of the frequencies as torch tensors, by dtype and device."""
        return {}


@register("effect", "residual")
@dataclass(frozen=True, eq=False)
class ResidualField(Effect, place=TOOL + 0.5, name="residual"):
    """Displacement of the tool as a sum of waves of the motor positions, for one arm or many.

    Attributes:
        features: The frequencies of the waves.
        weight: Weights of the cosines and sines, m and rad: ``(O, 2, K)`` for one arm, ``(N, O, 2, K)`` for N arms.
        offset: Constant part of each output, O numbers, m and rad.
        turn: Rotation matrix (3, 3) from the frame in which the field was learnt into the arm's world frame.
    """

    features: Features
    weight: Scalar
    offset: tuple[Scalar, ...]
    turn: tuple[tuple[float, float, float], ...]

    def act(self, at: Passage, memory: Components) -> None:
        """Displace the tool's frame of the passage ``at``, in place, by the field's outputs; ``memory`` is not used."""
        m, frame = at.m, at.frame
        parts = [part + constant for part, constant in zip(_outputs(m, self, at.motor), self.offset, strict=True)]
        triples = (parts[first : first + 3] for first in range(0, self.features.outputs, 3))
        turned = [a * x + b * y + c * z for x, y, z in triples for a, b, c in self.turn]
        if len(turned) == 6:
            at.frame = displaced_frame(m, frame, turned)
        else:
            at.frame = (*frame[:9], *(value + part for value, part in zip(frame[9:], turned, strict=True)))

    @cached_property
    def tensors(self) -> dict[Any, Any]:
        """Cache of the weights of a single arm as torch tensors, by dtype and device."""
        return {}


def _outputs(m: ModuleType, field: ResidualField, q: Scalars) -> list[Scalar]:
    """Return the outputs of the field at joints ``q``: displacements of the tool, m and rad, one component each.

    ``m`` is the namespace of the functions: ``math``, ``numpy`` or ``torch``. ``q`` has n components, rad or m.
    """
    features = field.features
    if m.__name__ == "torch":
        return _tensor_outputs(m, field, q)
    components = features.inputs(m, q)
    if (traced := outside(m, partial(_fill, field), components, features.outputs)) is not None:
        return list(traced)
    inputs = np.stack(np.broadcast_arrays(*(np.asarray(value, dtype=float) for value in components)))
    if inputs.ndim == 1 and field.weight.ndim == 3:
        parts = _weighed(features, inputs, field.weight)
        return list(parts) if m is np else list(parts.tolist())
    shape = np.broadcast_shapes(inputs.shape[1:], field.weight.shape[:-3])
    ones = (1,) * (1 + len(shape) - inputs.ndim)  # one pose, many arms
    inputs = np.broadcast_to(inputs.reshape(len(inputs), *ones, *inputs.shape[1:]), (len(inputs), *shape))
    outputs = np.empty((features.outputs, *shape))
    _fill(field, inputs, outputs)
    return list(outputs)


def _fill(field: ResidualField, inputs: Array, outputs: Array) -> None:
    """Write the field's outputs at ``inputs`` ``(F, ...)`` (joints minus the centre) into ``outputs`` ``(O, ...)``."""
    weight = np.broadcast_to(field.weight, (outputs.shape[-1], *field.weight.shape[-3:]))
    for first in range(0, outputs.shape[-1], CHUNK):
        some = slice(first, first + CHUNK)
        outputs[..., some] = np.moveaxis(_weighed(field.features, inputs[..., some], weight[some]), -1, 0)


def _weighed(features: Features, inputs: Array, weight: Single) -> Array:
    """Return the weighted sums of the waves ``(..., O)``.

    Args:
        features: The frequencies of the waves.
        inputs: Joints minus the centre, as inputs ``(F, ...)`` of the waves.
        weight: Weights of cosines and sines ``(O, 2, K)``, or ``(N, O, 2, K)`` for N arms.
    """
    angle = features.angles(inputs)
    cosines, sines = (np.cos(angle) * weight[..., 0, :]).sum(-1), (np.sin(angle) * weight[..., 1, :]).sum(-1)
    return np.asarray(cosines + sines, dtype=float)


def _tensor_outputs(m: ModuleType, field: ResidualField, q: Scalars) -> list[Scalar]:
    features, key = field.features, (q[0].dtype, q[0].device)

    def tensor(cache: dict[Any, Any], array: NDArray[Any]) -> Any:
        if key not in cache:
            cache[key] = m.as_tensor(array, dtype=key[0], device=key[1])
        return cache[key]

    single = isinstance(field.weight, np.ndarray)  # of one arm, which stays on NumPy
    weight = tensor(field.tensors, field.weight) if single else field.weight
    angle = m.stack(features.inputs(m, q), -1) @ tensor(features.tensors, features.frequency)
    angle = angle.unflatten(-1, (features.outputs, features.count))
    return list((m.cos(angle) * weight[..., 0, :] + m.sin(angle) * weight[..., 1, :]).sum(-1).unbind(-1))


# What no two arms of one design share, and no data sheet tells: waves of the drives, and structure finer than a grid.
# A plant file says how such waves are spread; a design has one draw of them, by the file's seed, and every arm drawn
# from it has its own. Drives: a sin + b cos of each period, whose order (cycles per turn, or per length) lies evenly
# between two bounds, with a and b normal and falling with the order. Structure: random features of a Gaussian process
# of the joints (`pickenv.arm.effects.residual_field`), which displaces the tool. Units: m, rad.


SEED = WHOLE.not_negative


@toml_table
class WavesTable:
    """The table [drive_harmonics] of a plant file, which says how periodic errors of drives are distributed over arms.

    Attributes:
        seed: Seed of the periodic errors of the plant (the simulated true arm). Arms that are drawn from the plant have
            other periodic errors.
        decay: Exponent by which shorter periods have smaller coefficients. At a period, the standard deviation of a
            coefficient is its value at the longest period times (longest period / period) ** -decay.
        joints: For each joint four numbers: the number of waves, the standard deviation of a coefficient at the longest
            period, the longest period, and the shortest period.
    """

    seed: Annotated[int, SEED]
    decay: Annotated[float, NUMBER.not_negative]
    joints: Annotated[
        tuple[Any, ...], ByJoint(waves=(WHOLE.at_least(1),) * 2, amplitude=TRAVEL, longest=LENGTH, shortest=LENGTH)
    ]


@dataclass(frozen=True)
class WaveSpread:
    """The distribution of one periodic error of a drive over arms.

    The order (1 / period) is uniform between its bounds. The sine and cosine coefficients are normal.

    Attributes:
        joint: Index of the joint (from 0).
        std: Standard deviation of a coefficient at the longest period, rad or m.
        longest: Longest period, rad or m.
        shortest: Shortest period, rad or m.
        decay: Exponent by which the standard deviation falls: it is std * (longest / period) ** -decay.
    """

    joint: int
    std: float
    longest: float
    shortest: float
    decay: float


@register("effect", "drive_harmonics")
@dataclass(frozen=True)
class DriveHarmonics(Effect, place=DRIVE + 0.5):
    """Periodic errors of the drives that differ from arm to arm.

    Attributes:
        spread: Distribution of each periodic error over arms.
        harmonics: The periodic errors of this arm, or of many arms.
    """

    table = Annotated[Any, Then(lambda table, _: drive_harmonics_of(table), WavesTable)]

    spread: tuple[WaveSpread, ...]
    harmonics: tuple[Harmonic, ...]

    def act(self, at: Passage, memory: Components) -> None:
        """Add the periodic errors to the driven positions of the passage ``at``, in place; ``memory`` is not used."""
        at.drive(with_waves(at.m, self.harmonics, at.motor, at.driven))

    def drawn(self, draws: Draws) -> DriveHarmonics:
        """Return the drives of many arms, whose periodic errors follow from the random numbers in ``draws``."""
        return self.of_numbers(draws.even[self.name])

    def of_numbers(self, even: Array) -> DriveHarmonics:
        """Return the drives whose periodic errors follow from uniform random numbers.

        Args:
            even: Uniform random numbers from 0 to 1 ``(..., 3 W)`` for W periodic errors. Each has one number for its
                order (1 / period), one for its sine coefficient and one for its cosine coefficient.
        """
        order, sine, cosine = np.moveaxis(even.reshape(*even.shape[:-1], len(self.spread), 3), -1, 0)
        harmonics = []
        for k, wave in enumerate(self.spread):
            first, last = 1.0 / wave.longest, 1.0 / wave.shortest
            per = first + (last - first) * order[..., k]
            std = wave.std * (first / per) ** wave.decay
            a, b = std * standard_normal_of(sine[..., k]), std * standard_normal_of(cosine[..., k])
            sizes = (np.hypot(a, b), 1.0 / per, np.arctan2(b, a))
            harmonics.append(Harmonic(wave.joint, *(size if size.ndim else float(size) for size in sizes)))
        return replace(self, harmonics=tuple(harmonics))


def drive_harmonics_of(table: WavesTable) -> DriveHarmonics:
    """Return the effect that a plant file's table describes, with periodic errors drawn from the table's seed.

    Raises:
        InputError: If a shortest period is not below the longest.
    """
    spread: list[WaveSpread] = []
    for entry in table.joints:
        if entry.shortest >= entry.longest:
            where = f"joint {entry.joint + 1} in [drive_harmonics]"
            raise InputError(f"the shortest period of {where} is not below its longest; give a shorter one")
        spread += [WaveSpread(entry.joint, entry.amplitude, entry.longest, entry.shortest, table.decay)] * entry.waves
    return DriveHarmonics(tuple(spread), ()).of_numbers(np.random.default_rng(table.seed).random(3 * len(spread)))


@toml_table
class StructureTable:
    """The table [local_structure] of a plant file, which describes a random tool displacement of short length scale.

    Attributes:
        seed: Seed of the frequencies, which all arms share, and of the weights of the plant itself.
        position: Standard deviation of the tool's displacement along each axis, m.
        waves: Number of waves per axis.
        joints: Length scale of each joint on which the displacement depends, rad or m.
    """

    seed: Annotated[int, SEED]
    position: Annotated[float, MM.not_negative]
    waves: Annotated[int, WHOLE.within(1, 1000)]
    joints: Annotated[tuple[Any, ...], ByJoint(length=LENGTH)]


@register("effect", "local_structure")
@dataclass(frozen=True, eq=False)
class LocalStructure(Effect, place=TOOL):
    """Displacement of the tool that varies over short distances in the joints, for one arm or many.

    Attributes:
        std: Standard deviation of a wave's weight over arms, m.
        field: The waves and their weights.
    """

    table = Annotated[Any, Then(lambda table, context: local_structure_of(table, context), StructureTable)]

    std: float
    field: ResidualField

    def act(self, at: Passage, memory: Components) -> None:
        """Displace the tool's frame of the passage ``at``, in place, by the field's outputs; ``memory`` is not used."""
        self.field.act(at, memory)

    def drawn(self, draws: Draws) -> LocalStructure:
        """Return the local structure of many arms, whose weights follow from the random numbers in ``draws``."""
        return self.of_numbers(draws.even[self.name])

    def of_numbers(self, even: Array) -> LocalStructure:
        """Return the local structure whose weights follow from uniform random numbers.

        ``even`` has these numbers from 0 to 1, ``(..., weights)``, one for each weight.
        """
        features = self.field.features
        weight = self.std * standard_normal_of(even).reshape(*even.shape[:-1], features.outputs, 2, features.count)
        return replace(self, field=replace(self.field, weight=weight.astype(np.float32)))

    @property
    def weights(self) -> int:
        """Number of weights per arm, 2 O K: K cosines and K sines for each of the O outputs."""
        return 2 * self.field.features.outputs * self.field.features.count


def local_structure_of(table: StructureTable, context: Any) -> LocalStructure:
    """Return the effect that a plant file's table describes, with frequencies and weights drawn from its seed.

    Args:
        table: The table.
        context: Context of the plant file that is being read; it holds the arm.
    """
    lengths = np.array(numbers_per_joint(table, context, "length")[0])
    joints = len(lengths)
    per_length = np.divide(1.0, lengths, out=np.zeros(joints), where=lengths > 0)
    rng = np.random.default_rng(table.seed)
    frequency = (rng.standard_normal((joints, 3 * table.waves)) * per_length[:, None]).astype(np.float32)
    features = Features(frequency, (0.0,) * joints, (False,) * joints, 3)
    upright = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    blank = ResidualField(features, np.zeros((3, 2, table.waves), np.float32), (0.0, 0.0, 0.0), upright)
    structure = LocalStructure(table.position / math.sqrt(table.waves), blank)
    return structure.of_numbers(rng.random(structure.weights))
