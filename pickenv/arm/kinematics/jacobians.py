"""Joint and parameter Jacobians of the tool pose, analytic: in components, with a NumPy face for batches of poses.

Rows are position (m) and rotation vector (rad) in world axes. The parameter Jacobian is Qiao 2026 eq (8) read as the
horizontal concatenation [J_1^6 V_1 ... J_6^6 V_6] (the paper prints a sum), turned from tool into world axes, and
extended by Hayati's beta, the base and the tool.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from pickenv.arm.kinematics.forward import Frame, Scalar, attach, chain_of, frames, split_joints
from pickenv.arm.kinematics.geometry import LINK_PARAMETERS, Array, Geometry

Column = tuple[Scalar, ...]
"""One column of a Jacobian, six components: position (m) and rotation vector (rad) in world axes."""


def link_column(
    kind: str, before: Sequence[Scalar], after: Sequence[Scalar], tool: Sequence[Scalar], twist: Sequence[Scalar]
) -> Column:
    """Derivative of the tool pose by a parameter of one link, or of links stacked along an axis of the components.

    Args:
        kind: Which of `LINK_PARAMETERS`.
        before: Frame of the link before, twelve components.
        after: The link's own frame.
        tool: Origin of the tool, three components.
        twist: Cosine and sine of the link's alpha, and its a; only beta asks for them.
    """
    x, y, z, px, py, pz = after[6:] if kind in ("theta", "d") else (*before[:3], *before[9:])
    if kind in ("a", "d"):
        return x, y, z, 0.0, 0.0, 0.0
    u, v, w = tool[0] - px, tool[1] - py, tool[2] - pz
    if kind == "beta":  # about y after Rot(x, alpha) and Trans(x, a)
        cosine, sine, a = twist
        u, v, w = u - a * x, v - a * y, w - a * z
        x, y, z = (cosine * along + sine * up for along, up in zip(before[3:6], before[6:9], strict=True))
    return y * w - z * v, z * u - x * w, x * v - y * u, x, y, z


def jacobian_columns(geometry: Geometry, links: Sequence[Frame], tool: Frame) -> list[Column]:
    """Columns of the joint Jacobian, one per joint, for the frames of base, links and tool in components."""
    hand = tool[9:]
    columns = [
        link_column("d" if slides else "theta", (), link, hand, ())
        for slides, link in zip(geometry.slides, links[1:], strict=True)
    ]
    if geometry.coupling is None:
        return columns
    gathered: list[Column] = [(0.0,) * 6] * geometry.joints
    for joint, ratio, column in zip(geometry.coupling.joint, geometry.coupling.ratio, columns, strict=True):
        gathered[joint] = tuple(total + ratio * part for total, part in zip(gathered[joint], column, strict=True))
    return gathered


def joint_jacobian(geometry: Geometry, q: ArrayLike) -> Array:
    """Derivative of the tool pose by the joints.

    Args:
        geometry: The arm.
        q: Joint displacements ``(..., n)``, rad or m.

    Returns:
        Array ``(..., 6, n)``: rows position (m) and rotation vector (rad) in world axes, per rad or m (eq (13)).
    """
    links, tool, shape = _frames(geometry, q)
    jacobian = np.empty((6, geometry.joints, *shape))
    for i, column in enumerate(jacobian_columns(geometry, links, tool)):
        for row, value in enumerate(column):
            jacobian[row, i] = value
    return np.moveaxis(jacobian, (0, 1), (-2, -1))


def parameter_jacobian(geometry: Geometry, q: ArrayLike) -> Array:
    """Derivative of the tool pose by every parameter of the geometry.

    Args:
        geometry: The arm.
        q: Joint displacements ``(..., n)``, rad or m.

    Returns:
        Array ``(..., 6, 5L + 12)``, columns in the order of ``geometry.parameter_names``; rows as in `joint_jacobian`.
        In memory the poses lie next to each other.
    """
    n = geometry.links
    found, tool_frame, shape = _frames(geometry, q)
    links, tool = np.empty((12, n + 1, *shape)), np.empty((3, *shape))  # components first
    for i, frame in enumerate(found):
        for component, value in enumerate(frame):
            links[component, i] = value
    for component, value in enumerate(tool_frame[9:]):
        tool[component] = value
    jacobian = np.zeros((6, 5 * n + 12, *shape))
    twist = [_per_link(values, shape) for values in (np.cos(geometry.alpha), np.sin(geometry.alpha), geometry.a)]
    before, after, origin = tuple(links[:, :-1]), tuple(links[:, 1:]), tuple(tool)
    for k, kind in enumerate(LINK_PARAMETERS):
        for row, value in enumerate(link_column(kind, before, after, origin, twist)):
            jacobian[row, k * n : (k + 1) * n] = value
    position, turn = jacobian[:3], jacobian[3:]
    base, hand = 5 * n, 5 * n + 6
    for k in range(3):
        i, j = (k + 1) % 3, (k + 2) % 3
        position[k, base + k] = 1.0
        turn[k, base + 3 + k] = 1.0
        position[i, base + 3 + k] = geometry.base.position[j] - tool[j]  # axis k crossed with the lever
        position[j, base + 3 + k] = tool[i] - geometry.base.position[i]
        position[:, hand + k] = turn[:, hand + 3 + k] = links[3 * k : 3 * k + 3, n]
    return np.moveaxis(jacobian, (0, 1), (-2, -1))


def _frames(geometry: Geometry, q: ArrayLike) -> tuple[list[Frame], Frame, tuple[int, ...]]:
    """Frames of base and links, of the tool, and the shape of poses; the frames of a single pose are floats."""
    joints = split_joints(geometry.joints, q)
    shape = np.broadcast_shapes(joints[0].shape, geometry.alpha.shape[:-1])
    m = np if shape else math
    chain = chain_of(geometry, math if geometry.alpha.ndim == 1 else np)
    links = frames(m, chain, joints if shape else [value.item() for value in joints])
    return links, attach(links[-1], chain.tool), shape


def _per_link(values: Array, shape: tuple[int, ...]) -> Array:
    """Link parameters ``(..., n)`` as ``(n, ...)``, for poses of this shape."""
    return np.moveaxis(np.broadcast_to(values, (*shape, values.shape[-1])), -1, 0)
