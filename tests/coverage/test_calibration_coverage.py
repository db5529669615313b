"""What `pickenv calibrate` prints with an interval holds the truth, on a simulated arm whose truth is known."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.special import stdtrit

from pickenv.arm import load_plant
from pickenv.calibration import assess, fit, identify, link_model, random_joints, simulated_tracker

pytestmark = pytest.mark.slow
DYNAMIC = load_plant("qiao2026")
CENTRED = replace(DYNAMIC.effect("measurement_noise"), centring_std=0.0)
GEOMETRY = load_plant("geometry_only").with_effect(CENTRED)
"""With a target that is mounted truly: what all readings have alike no interval over readings can hold."""


@pytest.mark.parametrize("held_out", [20, 100])
def test_the_arms_own_mean_error(repeats: Any, held_out: int) -> None:
    """Noise is a thirtieth of what least squares leave here, so the interval is neither too wide nor too narrow."""
    arm = DYNAMIC.arm

    def draw(rng: np.random.Generator) -> Any:
        joints = random_joints(arm.nominal, 60 + held_out, rng)
        data = simulated_tracker(DYNAMIC, joints, rng)
        train, test = data.select(np.arange(60)), data.select(np.arange(60, 60 + held_out))
        result = assess(arm, fit(arm, train, known_frames=True), train, test)
        there = simulated_tracker(DYNAMIC.without(["measurement_noise"]), random_joints(arm.nominal, 1000, rng), rng)
        truth = 1e3 * np.linalg.norm(result.fit.calibration.errors(there)[:, :3], axis=1).mean()
        ends = result.own_mean_ci95
        assert ends is not None
        return ends[0] - truth, ends[1] - truth

    repeats.check(draw, 0.0, share=0.05)


@pytest.mark.parametrize("poses", [10, 100])
def test_a_parameters_standard_deviation(repeats: Any, poses: int) -> None:
    """Times Student's t, it holds what exact measurements of the same poses would give."""
    nominal = GEOMETRY.arm.nominal
    model = link_model(nominal)
    exact = GEOMETRY.without(["measurement_noise"])

    def draw(rng: np.random.Generator) -> Any:
        joints = random_joints(nominal, poses, rng)
        found = identify(model, nominal, simulated_tracker(GEOMETRY, joints, rng))
        truth = identify(model, nominal, simulated_tracker(exact, joints, rng))
        assert found.identifiability.kept_names == truth.identifiability.kept_names
        place = int(rng.choice(found.identifiability.kept))
        half = stdtrit(found.degrees_of_freedom, 0.975) * found.standard_deviation[place]
        off = found.delta[place] - truth.delta[place]
        return off - half, off + half

    repeats.check(draw, 0.0, share=0.05)
