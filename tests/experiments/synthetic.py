"""Evaluations of known truth: errors that are a product of what is drawn for each arm and a fixed pattern of fruit."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from pickenv.experiments import PolicySettings, Rows, joined
from pickenv.orchard import capture_probability, load_gripper

FRUIT = np.linspace(0.5, 1.5, 8)
"""Errors on an arm's fruit, in means of the arm."""

SETTINGS = PolicySettings(grippers=("compliant_hand",))


def rows_of(*errors_mm: ArrayLike, learned: bool = False) -> Rows:
    """Episodes of one policy whose compensations leave errors ``(arms, trainings, fruit)`` across the tool's axis."""
    return joined(
        [
            _behind(compensation, np.asarray(errors, dtype=float), learned)
            for compensation, errors in zip(("raw", "ls", "best"), errors_mm, strict=False)
        ]
    )


def _behind(compensation: str, errors: np.ndarray, learned: bool) -> Rows:
    arm, training, fruit = np.indices(errors.shape)
    words = {"policy": "some", "compensation": compensation, "feedback": "encoders", "plant": "qiao2026"}
    numbers = {"seed": 0, "learned": learned, "cycle_steps": np.nan}
    flat = errors.ravel()
    return Rows(
        {name: np.full(errors.size, value) for name, value in (words | numbers).items()}
        | {"arm": arm.ravel(), "training": training.ravel(), "episode": fruit.ravel(), "error_mm": flat}
        | {"way_mm": np.stack([np.full(errors.size, 50.0), flat], axis=1)}
        | {"chance_compliant_hand": capture_probability(load_gripper("compliant_hand"), 1e-3 * flat, 0.0, 0.0)}
    )
