"""What a network gains where it has not been: on a grid of poses of which two tenths are held out of all fitting.

A network interpolates between neighbours, so poses beside those it learnt from flatter it. On measured arms it removes
a seventh of what least squares leaves of such blocks; on a smooth simulated arm most of it. Units: m, rad; mm where
names say so.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pickenv.arm.kinematics.geometry import Array, Geometry
from pickenv.arm.plant.plant import Plant
from pickenv.calibration import BpnnSettings, Measurements, simulated_tracker
from pickenv.calibration.model.splits import BLOCKS, Rows
from pickenv.calibration.pipeline.fitting import fit
from pickenv.errors import InputError
from pickenv.inspect.runs.field_grid import field_grid
from pickenv.intervals import Ends, statistic_interval

ROWS, STEP, SEED = 400, 0.093, 20260
"""Points of the grid, their distance in m, and the seed of the joints that find the workspace's extent."""

WRIST = 0.3
"""At each point of the grid, joints that turn are moved by up to this, rad, and slides stay."""

EPOCHS = 50
"""Passes of the network's training: with 200 it removes the same to within two points of per cent."""

FIELD = "field"
"""The plant whose remainder is made as that of measured arms is."""


@dataclass(frozen=True)
class BlockedGain:
    """What is left of ten blocks, two by two without anything fitted to them, mm RMS.

    Attributes:
        plant: Name of the arm.
        ls_mm: By least squares.
        network_mm: By least squares and network.
        removed: Share of what least squares leaves that the network removes.
        removed_ci95: Its interval between blocks.
    """

    plant: str
    ls_mm: float
    network_mm: float
    removed: float
    removed_ci95: Ends | None


@dataclass(frozen=True)
class MeasuredGain:
    """The same of a measured arm, from pairs of blocks.

    Attributes:
        robot: Its name.
        ls_mm: What least squares leaves, mm RMS, mean over pairs.
        removed: Share of it that a network removes, mean over pairs.
        lowest: Lowest over pairs, None where there were too few.
        highest: Highest.
    """

    robot: str
    ls_mm: float
    removed: float
    lowest: float | None = None
    highest: float | None = None


MEASURED = (
    MeasuredGain("UR5", 0.121, 0.14, 0.07, 0.22),
    MeasuredGain("UR10, series A", 0.459, 0.08),
    MeasuredGain("UR10, series B", 0.463, 0.16, 0.08, 0.20),
    MeasuredGain("UR10, series D", 0.424, 0.20),
    MeasuredGain("WAM", 2.49, -0.05, -0.17, 0.04),
)
"""UR5 and WAM: Jacobi 2025; UR10: Landgraf et al. 2021. The paper's network, not gated; 1 to 8 pairs of blocks each."""


def grid_joints(nominal: Geometry, rows: int, rng: np.random.Generator) -> Array:
    """Joints ``(rows, n)`` of a grid of tool positions, line by line as a measuring run visits it, turned at each.

    Raises:
        InputError: If the grid has fewer points.
    """
    joints = field_grid(nominal, STEP, SEED).joints
    first = (len(joints) - rows) // 2
    if first < 0:
        raise InputError(f"the grid has {len(joints)} points that the arm reaches; ask for no more than that")
    joints = joints[first : first + rows]
    turned = rng.uniform(-WRIST, WRIST, joints.shape) * ~np.array(nominal.prismatic)
    return np.asarray(np.clip(joints + turned, nominal.lower, nominal.upper))


def blocks_apart(rows: Measurements, pair: tuple[int, int]) -> tuple[Measurements, Measurements]:
    """Rows to fit and rows of two of ten contiguous blocks, which are held out."""
    held = np.isin(_blocks(len(rows)), pair)
    return rows.select(np.flatnonzero(~held)), rows.select(np.flatnonzero(held))


def blocked_gain(plant: Plant, joints: Array, rng: np.random.Generator) -> BlockedGain:
    """Measure an arm; identify and learn on eight tenths of the rows and judge by the other two, five times.

    Args:
        plant: The arm.
        joints: Joint commands in the order in which they are measured ``(N, n)``, as from `grid_joints`.
        rng: Of noise and networks.
    """
    measured, blocks = simulated_tracker(plant, joints, rng), _blocks(len(joints))
    squares = np.empty((BLOCKS, 2))
    for first in range(BLOCKS // 2):
        pair = (first, first + BLOCKS // 2)
        train, test = blocks_apart(measured, pair)
        found = fit(plant.arm, train, train, rng=rng, settings=BpnnSettings(epochs=EPOCHS)).calibration
        for k, calibration in enumerate((found.without_residual(), found)):
            each = np.sum(calibration.errors(test)[:, :3] ** 2, axis=1)
            squares[pair, k] = [part.mean() for part in np.split(each, [int(np.sum(blocks == first))])]
    ls_mm, network_mm = (1e3 * np.sqrt(squares.mean(axis=0))).tolist()
    return BlockedGain(plant.name, ls_mm, network_mm, _removed(squares), statistic_interval(squares, _removed))


def _removed(squares: Array) -> float:
    ls, network = squares.mean(axis=0)
    return float(1.0 - np.sqrt(network / ls))


def _blocks(rows: int) -> Rows:
    """The block of each row."""
    return np.arange(rows) * BLOCKS // rows
