"""What no table of links holds: the tool's displacement as a random function of the joints, a sum of waves.

Random features of a Gaussian process (Rahimi and Recht 2007): an output is the sum over k of a_k cos(w_k x) + b_k
sin(w_k x), where x are the joints less a centre, those that turn far by sine and cosine. Arms share the frequencies and
differ in their weights. Of one output's frequencies the smooth ones (what a calibration learnt) come first, then rough
ones, whose length scale is so short that no measurement tells them from scatter. Waves are taken in single precision,
which is exact to nanometres, for they are most of the cost. Units: m and rad.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from types import ModuleType
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from pickenv.arm.kinematics.forward import Frame, Scalar
from pickenv.arm.kinematics.geometry import Array
from pickenv.arm.kinematics.pose_error import displaced_frame
from pickenv.arm.kinematics.tracing import outside

CHUNK = 64
"""Arms or poses worked on together in NumPy: their waves then stay in a core's cache."""

Single = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Features:
    """The waves, the same for all arms.

    Attributes:
        frequency: Of each output's K waves, side by side, by each input ``(F, O K)``, 1/rad or 1/m.
        centre: What is taken off each input, F numbers.
        periodic: For each joint, whether it enters by sine and cosine.
        outputs: Number of outputs O: 3 (position) or 6 (pose).
    """

    shared: ClassVar[bool] = True  # `pickenv.arm.plant.tree` leaves it as it is

    frequency: Single
    centre: tuple[float, ...]
    periodic: tuple[bool, ...]
    outputs: int

    @property
    def count(self) -> int:
        """Number of waves K of one output."""
        return int(self.frequency.shape[1]) // self.outputs

    def inputs(self, m: ModuleType, q: Sequence[Scalar]) -> list[Scalar]:
        """Inputs of joints, less the centre: those that enter directly, then sines, then cosines."""
        turning = [value for value, far in zip(q, self.periodic, strict=True) if far]
        direct = [value for value, far in zip(q, self.periodic, strict=True) if not far]
        raw = [*direct, *(m.sin(value) for value in turning), *(m.cos(value) for value in turning)]
        return [value - centre for value, centre in zip(raw, self.centre, strict=True)]

    def angles(self, inputs: Array) -> Single:
        """The waves' angles ``(..., O, K)`` at inputs ``(F, ...)``."""
        total: Any = np.float32(0.0)
        for value, row in zip(inputs.astype(np.float32), self.frequency, strict=True):
            total = total + value[..., None] * row  # one after the other, so that sums repeat to the bit
        return np.asarray(total.reshape(*total.shape[:-1], self.outputs, self.count))

    @cached_property
    def tensors(self) -> dict[Any, Any]:
        """Frequencies as a tensor, by number type and device."""
        return {}


@dataclass(frozen=True, eq=False)
class ResidualField:
    """Displacement of the tool, of one arm or of many.

    Attributes:
        features: The waves.
        weight: Weights of their cosines and sines ``(O, 2, K)``, or of each arm ``(N, O, 2, K)``, m and rad.
        offset: Constant part of each output, O numbers.
        turn: Rotation of the frame in which it was learnt into the arm's own, row by row.
    """

    features: Features
    weight: Scalar
    offset: tuple[Scalar, ...]
    turn: tuple[tuple[float, float, float], ...]

    @cached_property
    def tensors(self) -> dict[Any, Any]:
        """Weights of a single arm as a tensor, by number type and device."""
        return {}


def strayed(m: ModuleType, field: ResidualField, q: Sequence[Scalar], frame: Frame) -> Frame:
    """A tool's frame, displaced by the field at the joint command ``q``."""
    parts = [part + constant for part, constant in zip(_outputs(m, field, q), field.offset, strict=True)]
    turned = []
    for first in range(0, field.features.outputs, 3):
        x, y, z = parts[first : first + 3]
        turned += [a * x + b * y + c * z for a, b, c in field.turn]
    if len(turned) == 6:
        return displaced_frame(m, frame, turned)
    return (*frame[:9], *(value + part for value, part in zip(frame[9:], turned, strict=True)))


def _outputs(m: ModuleType, field: ResidualField, q: Sequence[Scalar]) -> list[Scalar]:
    """The outputs, component by component."""
    features = field.features
    if m.__name__ == "torch":
        return _tensor_outputs(m, field, q)
    given = features.inputs(m, q)
    noted = outside(partial(_fill, field), given, features.outputs)
    if noted is not None:
        return list(noted)
    inputs = np.stack(np.broadcast_arrays(*(np.asarray(value, dtype=float) for value in given)))
    if inputs.ndim == 1 and field.weight.ndim == 3:
        parts = _weighed(features, inputs, field.weight)
        return list(parts) if m is np else list(parts.tolist())
    shape = np.broadcast_shapes(inputs.shape[1:], field.weight.shape[:-3])
    ones = (1,) * (1 + len(shape) - inputs.ndim)  # one pose, many arms
    inputs = np.broadcast_to(inputs.reshape(len(inputs), *ones, *inputs.shape[1:]), (len(inputs), *shape))
    found = np.empty((features.outputs, *shape))
    _fill(field, inputs, found, slice(None))
    return list(found)


def _fill(field: ResidualField, inputs: Array, found: Array, part: slice) -> None:
    """Write outputs ``(O, ...)`` at inputs ``(F, ...)``, those of the arms ``part`` where each has its own weights."""
    weight = field.weight if field.weight.ndim == 3 else field.weight[part]
    weight = np.broadcast_to(weight, (found.shape[-1], *weight.shape[-3:]))
    for first in range(0, found.shape[-1], CHUNK):
        some = slice(first, first + CHUNK)
        found[..., some] = np.moveaxis(_weighed(field.features, inputs[..., some], weight[some]), -1, 0)


def _weighed(features: Features, inputs: Array, weight: Single) -> Array:
    """Sums of waves ``(..., O)`` at inputs ``(F, ...)``, each with its weight."""
    angle = features.angles(inputs)
    cosines, sines = (np.cos(angle) * weight[..., 0, :]).sum(-1), (np.sin(angle) * weight[..., 1, :]).sum(-1)
    return np.asarray(cosines + sines, dtype=float)


def _tensor_outputs(m: ModuleType, field: ResidualField, q: Sequence[Scalar]) -> list[Scalar]:
    features, like, weight = field.features, q[0], field.weight
    key = (like.dtype, like.device)
    if key not in features.tensors:
        features.tensors[key] = m.as_tensor(features.frequency, dtype=like.dtype, device=like.device)
    if isinstance(weight, np.ndarray):  # of a single arm, which stays on NumPy
        if key not in field.tensors:
            field.tensors[key] = m.as_tensor(weight, dtype=like.dtype, device=like.device)
        weight = field.tensors[key]
    angle = m.stack(features.inputs(m, q), -1) @ features.tensors[key]
    angle = angle.unflatten(-1, (features.outputs, features.count))
    waves = m.cos(angle) * weight[..., 0, :] + m.sin(angle) * weight[..., 1, :]
    return list(waves.sum(-1).unbind(-1))
