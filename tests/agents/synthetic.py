"""Comparisons of known truth: errors that are a product of what is drawn for each arm and a fixed pattern of fruit."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from pickenv.agents.evaluation.grid import Cell, GridSettings, PolicyGrid
from pickenv.agents.evaluation.rollout import Rollout
from pickenv.inspect.runs.episode_summary import Reaches
from pickenv.orchard.gripper import load_gripper

FRUIT = np.linspace(0.5, 1.5, 8)
"""Errors on an arm's fruit, in means of the arm."""


def rollout_of(errors_mm: ArrayLike) -> Rollout:
    """Episodes that end ``errors_mm`` ``(arms, fruit)`` beside the fruit, across the tool's axis."""
    errors = np.asarray(errors_mm, dtype=float).T.ravel()  # arms vary fastest
    count, arms = len(errors), len(np.asarray(errors_mm))
    aside = np.zeros((count, 3))
    aside[:, 0] = 1e-3 * errors
    reaches = Reaches(
        seeds=tuple(range(count)),
        pose_error=np.concatenate([aside, np.zeros((count, 3))], axis=1),
        noncompensable=np.zeros((count, 6)),
        success=errors <= 5.0,
        joint_command=np.zeros((count, 6)),
        tool_position=aside,
        fruit_position=np.zeros((count, 3)),
    )
    way = np.concatenate([np.full((1, count), 50.0), errors[None]])
    return Rollout(reaches, np.tile(np.arange(arms), count // arms), np.tile(np.eye(3), (count, 1, 1)), way)


def grid_of(*errors_mm: ArrayLike, learned: bool = False) -> PolicyGrid:
    """A comparison whose compensations leave errors ``(arms, trainings, fruit)``."""
    cells = [
        Cell("some", compensation, "encoders", "qiao2026", learned, tuple(map(rollout_of, np.moveaxis(errors, 1, 0))))
        for compensation, errors in zip(("raw", "ls", "best"), map(np.asarray, errors_mm), strict=False)
    ]
    return PolicyGrid(GridSettings(), tuple(cells), {"compliant_hand": load_gripper("compliant_hand")})
