"""What no table of links holds: the tool's displacement as a random function of the joints, a sum of cosines.

Random features of a Gaussian process (Rahimi and Recht 2007): output o is the sum of weight_k cos(w_k x + b_k), where x
are the joints, those that turn far by sine and cosine. Arms share the features and differ in their weights. Inside one
output's smooth features (what a calibration learnt) come first, then rough ones, whose length scale is so short that no
measurement tells them from scatter. Units: m and rad, world axes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from types import ModuleType
from typing import Any, ClassVar

import numpy as np

from pickenv.arm.kinematics.forward import Frame, Scalar
from pickenv.arm.kinematics.geometry import Array
from pickenv.arm.kinematics.pose_error import displaced_frame

CHUNK = 64
"""Arms or poses worked on together in NumPy: their features then stay in a core's cache."""


@dataclass(frozen=True, eq=False)
class Features:
    """The cosines, the same for all arms.

    Attributes:
        frequency: Of each feature by each input ``(F, O K)``, 1/rad or 1/m; the K features of an output side by side.
        phase: ``(O K,)``, rad.
        periodic: For each joint, whether it enters by sine and cosine ``(n,)``.
        outputs: Number of outputs O: 3 (position) or 6 (pose).
    """

    shared: ClassVar[bool] = True  # `pickenv.arm.plant.tree` leaves it as it is

    frequency: Array
    phase: Array
    periodic: tuple[bool, ...]
    outputs: int

    @property
    def count(self) -> int:
        """Number of features K of one output."""
        return len(self.phase) // self.outputs

    def inputs(self, m: ModuleType, q: Sequence[Scalar]) -> list[Scalar]:
        """Inputs of joints: those that enter directly, then sines, then cosines."""
        turning = [value for value, far in zip(q, self.periodic, strict=True) if far]
        direct = [value for value, far in zip(q, self.periodic, strict=True) if not far]
        return [*direct, *(m.sin(value) for value in turning), *(m.cos(value) for value in turning)]

    def waves(self, q: Array) -> Array:
        """The features ``(..., O K)`` at joints ``(..., n)``."""
        inputs = self.inputs(np, [q[..., i] for i in range(q.shape[-1])])
        angle = self.phase
        for value, row in zip(inputs, self.frequency, strict=True):  # in a fixed order, so that sums repeat to the bit
            angle = angle + value[..., None] * row
        return np.asarray(np.cos(angle))

    @cached_property
    def tensors(self) -> dict[Any, tuple[Any, Any]]:
        """Frequencies and phases as tensors, by number type and device."""
        return {}


@dataclass(frozen=True, eq=False)
class ResidualField:
    """Displacement of the tool, of one arm or of many.

    Attributes:
        features: The cosines.
        weight: Weight of each ``(O K,)``, or of each arm ``(N, O K)``, m and rad.
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
    features, shape = field.features, (field.features.outputs, field.features.count)
    if m.__name__ == "torch":
        return _tensor_outputs(m, field, q)
    joints = np.stack(np.broadcast_arrays(*(np.asarray(value, dtype=float) for value in q)), -1)
    if joints.ndim == 1 and np.ndim(field.weight) == 1:
        parts = (features.waves(joints) * field.weight).reshape(shape).sum(-1)
        return list(parts.tolist()) if m is not np else list(parts)
    lead = np.broadcast_shapes(joints.shape[:-1], np.shape(field.weight)[:-1])
    found = np.empty((*lead, shape[0]))
    joints = np.broadcast_to(joints, (*lead, joints.shape[-1]))
    weight = np.broadcast_to(field.weight, (lead[-1], features.count * features.outputs))
    for first in range(0, lead[-1], CHUNK):
        part = slice(first, first + CHUNK)
        waves = features.waves(joints[..., part, :]) * weight[part]
        found[..., part, :] = waves.reshape(*waves.shape[:-1], *shape).sum(-1)
    return list(np.ascontiguousarray(np.moveaxis(found, -1, 0)))


def _tensor_outputs(m: ModuleType, field: ResidualField, q: Sequence[Scalar]) -> list[Scalar]:
    features, like, weight = field.features, q[0], field.weight
    key = (like.dtype, like.device)
    if key not in features.tensors:
        parts = (m.as_tensor(part, dtype=like.dtype, device=like.device) for part in (features.frequency, features.phase))
        features.tensors[key] = tuple(parts)
    if isinstance(weight, np.ndarray):  # of a single arm, which stays on NumPy
        if key not in field.tensors:
            field.tensors[key] = m.as_tensor(weight, dtype=like.dtype, device=like.device)
        weight = field.tensors[key]
    frequency, phase = features.tensors[key]
    waves = m.cos(m.stack(features.inputs(m, q), -1) @ frequency + phase) * weight
    return list(waves.unflatten(-1, (features.outputs, features.count)).sum(-1).unbind(-1))
