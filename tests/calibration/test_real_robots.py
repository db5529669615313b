"""Two real arms measured by a laser tracker (Jacobi 2025): positions only, base and tool unknown."""

import numpy as np
import pytest

from calibration import Measurements, fit, read_measurements
from calibration.error_model import residual
from pickenv.arm import load_arm


@pytest.fixture(scope="module")
def tracker(data_folder):
    """``tracker("ur5", "grid")``: one file of the data set."""
    folder = data_folder / "ur5_wam_jacobi2025"
    if not folder.is_dir():
        pytest.skip(f"no data set in {folder}")

    def read(arm: str, poses: str) -> Measurements:
        path = folder / arm.upper() / f"3D_{arm.upper()}_uncalibrated_{poses}_cleaned.csv"
        return read_measurements(path, load_arm(arm).nominal, f"{arm}_jacobi2025")

    return read


def left_mm(geometry, data):
    return np.linalg.norm(residual(geometry, data), axis=1) * 1e3


@pytest.fixture(scope="module")
def ur5(tracker):
    """800 poses of a seeded shuffle for the fit, the other 200 held out."""
    grid = tracker("ur5", "grid")
    assert (len(grid), grid.kind) == (1000, "position")
    order = np.random.default_rng(0).permutation(1000)
    return fit(load_arm("ur5"), grid.select(order[:800])), grid.select(order[800:])


def test_ur5_held_out(ur5):
    """0.113 mm RMS on held-out grid poses, of 0.71 mm with base and tool fitted alone."""
    found, test = ur5
    assert np.sqrt(np.mean(left_mm(found.calibration.nominal, test) ** 2)) == pytest.approx(0.712, abs=0.01)
    assert np.sqrt(np.mean(left_mm(found.calibration.identified, test) ** 2)) == pytest.approx(0.113, abs=0.001)


def test_ur5_random_poses(ur5, tracker):
    """The 20 random poses: 0.101 mm mean; published 0.1549."""
    random = tracker("ur5", "random")
    assert len(random) == 20
    assert left_mm(ur5[0].calibration.identified, random).mean() <= 0.102


def test_ur5_tells_25_parameters(ur5):
    """4 R + 6 less three tool attitudes and two more that a reflector near the last axis hides."""
    found = ur5[0].identification
    assert found.converged and found.identifiability.rank == 25
    assert {"tool_rx", "tool_ry", "tool_rz"} <= {item.name for item in found.identifiability.dropped}
    assert found.identifiability.condition < 1000
    assert found.solve_seconds < 2.0  # 0.02 s on one quiet core; this machine may be busy


def test_wam(tracker):
    """A cable-driven arm: geometry takes a good part of its error, not most of it."""
    grid, random = tracker("wam", "grid"), tracker("wam", "random")
    found = fit(load_arm("wam"), grid)
    assert found.identification.converged
    before, after = (left_mm(g, random).mean() for g in (found.calibration.nominal, found.calibration.identified))
    assert before == pytest.approx(4.05, abs=0.1)
    assert after == pytest.approx(3.08, abs=0.1)
