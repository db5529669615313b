"""What stands against what was said before measuring: another arm, frames that are not known, a region of its own.

Priors make such a fit say so: it is near the rows, and many standard deviations from what the drawing and the statement
allow. SI units; mm and degrees in sentences.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

import numpy as np
from scipy import stats

from pickenv.arm.kinematics.geometry import Array
from pickenv.calibration.identification.least_squares import Identification, is_angle
from pickenv.calibration.identification.rows import unknowns_of
from pickenv.calibration.model.arm_model import ArmModel
from pickenv.calibration.model.measurements import Measurements, random_joints
from pickenv.calibration.model.observations import Observations
from pickenv.calibration.model.prior import ANGLES, FRAMES, LENGTHS, TERMS, ZEROS, PriorModel
from pickenv.calibration.model.stacked import frame_columns

PART_OFF = 8.0
"""A link farther from its drawing than so many standard deviations of its class is none of that class. Eight measured
series of six arms keep below 6.1; a UR5e's rows given as a UR5's have 20."""

FRAME_OFF = 1e-5
"""A frame that is said to be known is off where parts of the class would move the whole arm so far this rarely."""

ZEROS_OFF = 10.0
"""Joints' zeros are set in the field, and may be off by so many times what parts are."""

SURE_BY = 2.0
"""A link is surely so far where that many of its own standard deviations are taken off."""

ONE_STEP = 0.5
"""One step at a joint's angle may explain this share of what remains: eight measured series keep below 0.16."""

STEPS = np.linspace(0.1, 0.9, 17)
"""Quantiles of a joint at which a step is looked for."""

POSES = 200
"""Joint vectors over which the arm is moved as a whole."""


def said_against(found: Identification, data: Observations) -> Iterator[tuple[Literal["caution"], str]]:
    """What a reader must know of it, as cautions.

    Args:
        found: The identification of the geometry.
        data: The rows that it was made from.
    """
    prior = found.prior
    if prior is None or not prior.proper:
        return
    frames = [text for which in ("base", "tool") if FRAMES not in prior.group for text in _frame(found, prior, which)]
    for text in (*(frames or _link(found, prior)), *_region(found, data)):
        yield "caution", text


def _link(found: Identification, prior: PriorModel) -> Iterator[str]:
    names, change = prior.parameters.names, prior.start.difference(found.arm_model)[prior.parameters.columns]
    known = dict(zip(found.identifiability.names, np.nan_to_num(found.standard_deviation), strict=True))
    least = np.abs(change) - SURE_BY * np.array([known[name] for name in names])
    links = np.array([not name.startswith(("base_", "tool_")) for name in names])
    sizes = np.where(links & np.isin(prior.group, (LENGTHS, ANGLES)), least / prior.std, 0.0)
    worst = int(np.argmax(sizes))
    if sizes[worst] > PART_OFF:
        name = names[worst]
        shown = f"{np.degrees(change[worst]):.3g} deg" if is_angle(name) else f"{change[worst] * 1e3:.3g} mm"
        yield (
            f"{name} lies {shown} from its drawing, {sizes[worst]:.0f} times what parts of {prior.source} differ by: "
            "these rows may be of another arm than the one named; check the arm, or name its class with --tolerances"
        )


def _frame(found: Identification, prior: PriorModel, which: str) -> Iterator[str]:
    """How the arm was moved as a whole, by base or tool, against how arms of the class are."""
    geometry, links = found.geometry, prior.group != TERMS
    columns = prior.parameters.columns[links]
    joints = random_joints(geometry, POSES, np.random.default_rng(0))
    jacobian = ArmModel.of(geometry).jacobian(joints).reshape(6 * POSES, -1)
    whole = np.linalg.pinv(jacobian[:, frame_columns(geometry, which)]) @ jacobian[:, columns]
    moved = whole @ prior.start.difference(found.arm_model)[columns]
    std = np.where(prior.group == ZEROS, ZEROS_OFF, 1.0)[links] * prior.std[links]
    covariance = (whole * std**2) @ whole.T
    if stats.chi2.sf(moved @ np.linalg.solve(covariance, moved), len(moved)) < FRAME_OFF:
        yield (
            f"the {which} is said to be known, but by these rows it is off by {np.linalg.norm(moved[:3]) * 1e3:.3g} mm "
            f"and {np.degrees(np.linalg.norm(moved[3:])):.2g} deg, more than arms of {prior.source} can be; give "
            "--frames fitted, or correct it in the arm's file"
        )


def _region(found: Identification, data: Observations) -> Iterator[str]:
    """Whether one step at a joint's angle explains most of what remains."""
    if not isinstance(data, Measurements) or len(data) < len(STEPS):
        return
    misses = data.misses(found.arm_model, unknowns_of(found, data))
    steps = [(*_step(data.joints[:, joint], misses), joint) for joint in range(data.joints.shape[1])]
    share, at, size, joint = max(steps)
    if share > ONE_STEP:
        unit, scale = ("mm", 1e3) if data.prismatic[joint] else ("deg", float(np.degrees(1.0)))
        yield (
            f"where {found.geometry.joint_names[joint]} is above {at * scale:.3g} {unit} the arm behaves otherwise: "
            f"rows there lie {size * 1e3:.3g} mm from those below, beyond what any geometry explains; look for what "
            "sags, touches or slips there, or leave these rows out"
        )


def _step(values: Array, misses: Array) -> tuple[float, float, float]:
    """Largest share of the misses' squares that one step explains, where it is, and its size, m."""
    best = (0.0, 0.0, 0.0)
    for at in np.quantile(values, STEPS).tolist():
        above = values > at
        high, low = (misses[side].mean(axis=0) if side.any() else np.zeros(3) for side in (above, ~above))
        explained = above.sum() * high @ high + (~above).sum() * low @ low
        share = float(explained / max(np.sum(misses**2), 1e-300))
        best = max(best, (share, at, float(np.linalg.norm(high - low))))
    return best
