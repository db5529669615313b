"""Fixtures of the tests of the arm: the arms, and joints drawn evenly within limits."""

from collections.abc import Callable

import numpy as np
import pytest

from pickenv.arm import Arm, Geometry, Pose, load_arm, rotation_matrix


@pytest.fixture(scope="session")
def qiao() -> Arm:
    return load_arm("qiao2026")


@pytest.fixture
def draw() -> Callable[..., np.ndarray]:
    """``draw(geometry, shape)``: joints within limits, the same on every run."""
    rng = np.random.default_rng(2026)

    def joints(geometry: Geometry, *shape: int) -> np.ndarray:
        return rng.uniform(geometry.lower, geometry.upper, size=(*shape, geometry.joints))

    return joints


@pytest.fixture
def general_chain() -> Geometry:
    """Seven joints of both types in general position, with every beta, the base and the tool away from zero."""
    rng = np.random.default_rng(7)
    n = 7
    links = {name: rng.uniform(-1.5, 1.5, n) for name in ("alpha", "a", "theta", "d", "beta")}
    base, tool = (Pose(rng.uniform(-1, 1, 3), rotation_matrix(rng.uniform(-2, 2, 3))) for _ in range(2))
    prismatic = (False, True, False, False, True, False, False)
    names = tuple(f"J{i + 1}" for i in range(n))
    return Geometry(names, prismatic, **links, lower=-np.ones(n), upper=np.ones(n), base=base, tool=tool)
