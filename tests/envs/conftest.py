"""What the tests of the environments share."""

from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import pickenv  # noqa: F401  (registers the environments)
from pickenv.arm import load_plant
from pickenv.calibration import Compensator


@pytest.fixture
def make() -> Any:
    """``make(**arguments)``: a Reach-v0 environment, closed after the test."""
    opened: list[gym.Env[Any, Any]] = []

    def build(**arguments: Any) -> gym.Env[Any, Any]:
        opened.append(gym.make("pickenv/Reach-v0", **arguments))
        return opened[-1]

    yield build
    for env in opened:
        env.close()


@pytest.fixture(scope="session")
def compensator() -> Callable[..., np.ndarray]:
    """A perfect calibration of Table 1's geometry."""
    plant = load_plant("geometry_only")
    return Compensator(plant.arm.nominal, plant.geometry)
