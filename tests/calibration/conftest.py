"""What the tests of calibration share: arms, plants, and measurements free of noise."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from pickenv.arm import Arm, Geometry, Plant, forward, load_arm, load_plant
from pickenv.calibration import Fit, Measurements, fit, random_joints, read_measurements, simulated_tracker

Exact = Callable[..., Measurements]


@pytest.fixture(scope="session")
def qiao() -> Arm:
    return load_arm("qiao2026")


@pytest.fixture(scope="session")
def table_1() -> Plant:
    """The hybrid arm with Table 1's deviations and nothing else."""
    return load_plant("geometry_only")


@pytest.fixture(scope="session")
def dynamic() -> Plant:
    """The hybrid arm with compliance, bending, drive errors and a tracker's noise."""
    return load_plant("qiao2026")


@pytest.fixture(scope="session")
def exact() -> Exact:
    """``exact(geometry, count, seed)``: full poses of a geometry over its joint ranges, without noise."""

    def measure(geometry: Geometry, count: int = 60, seed: int = 0) -> Measurements:
        joints = random_joints(geometry, count, np.random.default_rng(seed))
        return Measurements(joints, *forward(geometry, joints), prismatic=geometry.prismatic)

    return measure


@pytest.fixture(scope="session", params=[0, pytest.param(1, marks=pytest.mark.slow)], ids=["seed 0", "seed 1"])
def protocol(request: pytest.FixtureRequest, dynamic: Plant) -> tuple[Fit, Measurements]:
    """The paper's protocol on the dynamic plant: 100 poses for geometry, 200 for the network; 1000 to judge by."""
    rng = np.random.default_rng(request.param)
    sets = [simulated_tracker(dynamic, random_joints(dynamic.arm.nominal, n, rng), rng) for n in (100, 200, 1000)]
    return fit(dynamic.arm, sets[0], sets[1], known_frames=True, rng=rng), sets[2]


@pytest.fixture(scope="session")
def measured_ur5(data_folder: Path) -> tuple[Geometry, Measurements]:
    """A real arm: nominal UR5, and 1000 positions of it on a grid, in the order in which they were measured."""
    geometry = load_arm("ur5").nominal
    file = data_folder / "ur5_wam_jacobi2025/UR5/3D_UR5_uncalibrated_grid_cleaned.csv"
    return geometry, read_measurements(file, geometry, "ur5_jacobi2025")
