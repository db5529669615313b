"""What to fit where poses show little: joint offsets, compliance with them, a reduced geometry, or all of it.

In a small workspace most of a geometry cannot be told apart, and what is fitted freely there fits the noise. A rung of
the ladder fits fewer parameters, each expected within what such parts are made to. The highest rung that helps on
contiguous blocks of the training rows is taken. SI units.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from pickenv.arm import Arm, Geometry
from pickenv.arm.kinematics.geometry import Array
from pickenv.calibration.identification.least_squares import Identification, identify
from pickenv.calibration.identification.rows import unknowns_of
from pickenv.calibration.identification.term_choice import FOLDS, MARGIN, plain_term
from pickenv.calibration.model.arm_model import ArmModel
from pickenv.calibration.model.error_model import (
    ErrorModel,
    frames_model,
    geometric_model,
    joint_zeros_model,
    with_terms,
)
from pickenv.calibration.model.observations import Observations
from pickenv.calibration.model.prior import Prior, expected_sizes
from pickenv.calibration.model.splits import contiguous_folds, same_poses
from pickenv.errors import InputError

NOTHING = "nominal"
FULL = "full"
RUNGS = ("offsets", "compliance", "reduced", FULL)
"""The rungs, from the lowest."""

MEANING = {
    "offsets": "joint offsets",
    "compliance": "joint offsets and compliance",
    "reduced": "geometry reduced to what priors leave free",
    FULL: "full geometry",
}
"""What each fits, in words."""

ZERO_CLASS = 5.0
"""Joint zeros are expected within so many tolerances (5 mrad, 5 mm): they are set in the field."""

PART_CLASS = 1.0
"""Other parameters within so many (1 mm, 1 mrad): parts are made to them."""

WORTH = 0.1
"""What is fitted must leave so much less on blocks than the nominal arm: by chance alone a few per cent are usual."""

PASSES = 3
"""Fits of a rung: each weighs its priors by what the one before left."""


@dataclass(frozen=True, eq=False)
class Rung:
    """What is fitted.

    Attributes:
        name: One of `RUNGS`.
        model: The parameters, coefficients of terms among them.
        start: Where they start, and where they are expected.
        std: How far they are expected from there ``(P,)``, m, rad or a coefficient's unit; infinite where anywhere.
    """

    name: str
    model: ErrorModel
    start: ArmModel
    std: Array

    def identify(self, data: Observations) -> Identification:
        """Least squares with the priors, weighed against what the data are really worth."""
        held, scatter = np.isfinite(self.std), 1.0
        if not held.any():
            return identify(self.model, self.start, [data], max_iterations=60)
        for _ in range(PASSES):
            prior = Prior(self.start, self.model.columns[held], self.std[held] / max(scatter, 1e-9))
            found = identify(self.model, self.start, [data, prior], max_iterations=60)
            scatter = found.scatter
        return found


@dataclass(frozen=True)
class LadderChoice:
    """The rung that was taken.

    Attributes:
        chosen: Its name.
        blocked_rms: What each leaves of blocks of the training rows, m, "nominal" first; empty where one was asked for.
    """

    chosen: str
    blocked_rms: Mapping[str, float]

    def text(self) -> str:
        """In words."""
        how = "highest rung that helps on blocks of the training rows" if self.blocked_rms else "as asked for"
        return (
            f"{MEANING[self.chosen]} (--fit {self.chosen}), {how}; expected within {ZERO_CLASS:g} mm or mrad "
            f"(joint zeros) and {PART_CLASS:g} mm or mrad (parts)"
        )

    def as_dict(self, unit: str, scale: float) -> dict[str, Any]:
        """For JSON, in a unit of screens."""
        tried = {name: rms * scale for name, rms in self.blocked_rms.items() if np.isfinite(rms)}
        return {"chosen": self.chosen, f"blocked_rms_{unit}": tried}


def rung_of(name: str, arm: Arm, geometry: Geometry, data: Observations, known: bool) -> Rung:
    """One rung.

    Args:
        name: One of `RUNGS`.
        arm: The arm.
        geometry: Its nominal geometry, with base and tool as fitted.
        data: The rows; where torques were measured compliance is theirs, else the arm's own weight's.
        known: Whether base and tool are known.
    """
    bare = ArmModel.of(geometry)
    if name == FULL:
        model = geometric_model(geometry, known)
        return Rung(name, model, bare, np.full(len(model.names), np.inf))
    zeros = joint_zeros_model(geometry)
    links = zeros if name != "reduced" else geometric_model(geometry, True)
    if not known:
        frames = frames_model(geometry)
        links = geometric_model(geometry, False) if name == "reduced" else frames.joined(zeros)
    free = np.array([part.startswith(("base_", "tool_")) for part in links.names])
    size = np.where(np.isin(links.columns, zeros.columns), ZERO_CLASS, PART_CLASS)
    std = np.where(free, np.inf, size * links.tolerance)
    if name != "compliance":
        return Rung(name, links, bare, std)
    torques = data.conditions.torque is not None
    start = ArmModel.of(geometry, (plain_term("compliance" if torques else "gravity", arm, data),))
    return Rung(name, with_terms(links, start), start, np.r_[std, expected_sizes(start) * start.term_tolerances])


def climb(arm: Arm, geometry: Geometry, data: Observations, known: bool) -> LadderChoice:
    """The highest rung that helps: that leaves less of blocks left out than every rung below it, by `MARGIN`.

    Args:
        arm: The arm.
        geometry: Its nominal geometry, with base and tool as fitted.
        data: Training rows, in the order measured.
        known: Whether base and tool are known.

    Raises:
        InputError: If none leaves less than the nominal arm, by `WORTH`.
    """
    blocks = contiguous_folds(data.groups, same_poses(data.joints), FOLDS)
    folds = [(data.select(rows), data.select(held)) for rows, held in blocks]

    def nominal(rows: Observations) -> Identification | None:
        return None if known else identify(frames_model(geometry), geometry, [rows], max_iterations=60)

    scores = {NOTHING: _blocked(nominal, geometry, folds)}
    chosen = NOTHING
    for name in RUNGS:
        rung = rung_of(name, arm, geometry, data, known)
        try:
            scores[name] = _blocked(rung.identify, geometry, folds)
        except InputError:
            continue
        if scores[name] < (1.0 - (WORTH if chosen == NOTHING else MARGIN)) * scores[chosen]:
            chosen = name
    if chosen == NOTHING:
        raise InputError(
            f"{data.source}: on blocks of these rows nothing that can be fitted ({', '.join(RUNGS)}) is better than "
            "the nominal arm; measure more rows, and poses that move every joint"
        )
    return LadderChoice(chosen, scores)


def _blocked(
    fitted: Callable[[Observations], Identification | None],
    geometry: Geometry,
    folds: list[tuple[Observations, Observations]],
) -> float:
    """RMS that fits leave on blocks, each made without its block, m; infinite where one does not converge."""
    missed = []
    for rows, held in folds:
        found = fitted(rows)
        if found is not None and not found.converged:
            return np.inf
        arm = ArmModel.of(geometry) if found is None else found.arm_model
        missed.append(held.misses(arm, np.zeros(0) if found is None else unknowns_of(found, held)))
    return float(np.sqrt(np.mean(np.sum(np.concatenate(missed) ** 2, axis=1))))
