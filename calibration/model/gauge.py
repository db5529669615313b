"""Measurements without a frame (wires, sockets) cannot see where arm and anchors stand together: hold the base still.

Left free, that common motion is seen through the residuals alone: enough to pass for an identifiable parameter at the
start, and nothing at all at the minimum. What the base could do as well (alpha0, a0, theta1, d1) is held with it. Where
no length is known either (one point touched, a plane), an arm that shrinks to nothing explains all: hold its longest
link, and so its size.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pickenv.arm.kinematics.geometry import FRAME_PARAMETERS, Array
from pickenv.calibration.model.arm_model import ArmModel
from pickenv.calibration.model.error_model import ANGLE_TOLERANCE, LENGTH_TOLERANCE, ErrorModel
from pickenv.calibration.model.identifiability import REDUNDANCY_TOLERANCE, Dropped, Identifiability, identifiability
from pickenv.calibration.model.observations import Equations

BASE = tuple(f"base_{name}" for name in FRAME_PARAMETERS)


def identifiable_parameters(
    model: ErrorModel,
    sets: Sequence[Equations],
    arm: ArmModel,
    unknowns: Sequence[Array],
    matrix: Array,
    names: tuple[str, ...],
    tolerance: Array,
    rank_tolerance: float = REDUNDANCY_TOLERANCE,
) -> Identifiability:
    """`identifiability` of the stacked system; base and size are held where no instrument has a frame or a length.

    Args:
        model: The parameters.
        sets: The data.
        arm: Where the Jacobian was taken.
        unknowns: The data's own unknowns there.
        matrix: Stacked, scaled Jacobian ``(rows, own + P)``, the data's own unknowns first.
        names: Names of its columns.
        tolerance: Their scale, m or rad.
        rank_tolerance: See `pickenv.calibration.model.identifiability.REDUNDANCY_TOLERANCE`.
    """
    poses = sum(len(part.joints) for part in sets)
    held = (
        {}
        if any(part.framed for part in sets)
        else _held_with_base(model, sets, arm, unknowns, matrix, names, poses, rank_tolerance)
    )
    left = matrix.copy()
    left[:, [k for k, name in enumerate(names) if name in held]] = 0.0
    found = identifiability(left, names, tolerance, poses, rank_tolerance)
    if not any(part.sized for part in sets):
        size = _held_size(arm, found)
        left[:, [k for k, name in enumerate(names) if name in size]] = 0.0
        found, held = identifiability(left, names, tolerance, poses, rank_tolerance), held | size
    return replace(found, dropped=tuple(held.get(item.name, item) for item in found.dropped))


def _held_size(arm: ArmModel, found: Identifiability) -> dict[str, Dropped]:
    """The longest link that can be seen, and how the other lengths would grow with it."""
    geometry, count = arm.geometry, arm.geometry.links
    lengths = dict(zip((f"a{i}" for i in range(count)), geometry.a, strict=True))
    lengths |= zip((f"d{i + 1}" for i in range(count)), geometry.d, strict=True)
    seen = {name: float(lengths[name]) for name in found.kept_names if abs(lengths.get(name, 0.0)) > 0.0}
    if not seen:
        return {}
    longest = max(seen, key=lambda name: abs(seen[name]))
    others = {name: -value / seen[longest] for name, value in seen.items() if name != longest}
    return {longest: Dropped(longest, others)}


def _held_with_base(
    model: ErrorModel,
    sets: Sequence[Equations],
    arm: ArmModel,
    unknowns: Sequence[Array],
    matrix: Array,
    names: tuple[str, ...],
    poses: int,
    rank_tolerance: float,
) -> dict[str, Dropped]:
    """The base's parameters, and those that do what the base could do."""
    own, first = len(names) - len(model.names), 5 * arm.geometry.links
    by_arm = np.concatenate([part.jacobian(arm, values)[0] for part, values in zip(sets, unknowns, strict=True)])
    scale = np.where(arm.geometry.parameter_is_angle[first : first + 6], ANGLE_TOLERANCE, LENGTH_TOLERANCE)
    others = [k for k, name in enumerate(model.names) if name not in BASE]
    columns = np.concatenate([by_arm[:, first : first + 6] * scale, matrix[:, own:][:, others]], axis=1)
    chain_names = (*BASE, *(model.names[k] for k in others))
    chain = identifiability(
        columns, chain_names, np.concatenate([scale, model.tolerance[others]]), poses, rank_tolerance
    )
    return {item.name: item for item in chain.dropped} | {name: Dropped(name, {}) for name in BASE}
