"""What a network gains where it has not been: on a grid of poses of which two tenths are held out of all fitting.

A network interpolates between neighbours, so poses beside those it learnt from flatter it. On measured arms it removes
little or nothing of what least squares leaves of such blocks; on a smooth simulated arm most of it. Units: m, rad; mm
where names say so.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pickenv.arm.kinematics.geometry import Array, Geometry
from pickenv.arm.plant.plant import Plant
from pickenv.arm.plant.plant_batch import plant_at
from pickenv.arm.plant.tolerances import draw_plants, load_tolerances
from pickenv.calibration import BpnnSettings, Measurements, simulated_tracker
from pickenv.calibration.model.observations import BLOCKS
from pickenv.calibration.pipeline.fitting import fit
from pickenv.errors import InputError
from pickenv.inspect.runs.field_grid import field_grid

ROWS, STEP, SEED = 400, 0.093, 20260
"""Points of the grid, their distance in m, and the seed of the joints that find the workspace's extent."""

WRIST = 0.3
"""At each point of the grid, joints that turn are moved by up to this, rad, and slides stay."""

ARMS = 5
"""Arms of a design: they differ much in what a network gains on them."""

EPOCHS = 50
"""Passes of the network's training: with 200 it removes the same to within two points of per cent."""

FIELD = "field"
"""The plant whose remainder is made as that of measured arms is."""


@dataclass(frozen=True)
class BlockedGain:
    """What is left of rows far from those fitted, and how much of it a network removes.

    Attributes:
        arm: Name of the arms.
        ls_mm: What least squares leaves, mm RMS, mean.
        removed: Share of it that a model removes, mean over arms, or over all rows of a measured one.
        lowest: The least of any arm, or the lower 95 % end over ten blocks of a measured one; None where there is none.
        highest: The largest, or the upper end.
    """

    arm: str
    ls_mm: float
    removed: float
    lowest: float | None = None
    highest: float | None = None


MEASURED = Path(__file__).with_name("measured_gains.json")
"""What `pickenv bench calibration` found, as it writes it: arms, rows, folds and date."""


def measured_gains(model: str = "LS + BPNN") -> tuple[BlockedGain, ...]:
    """What a model removes of measured arms' rows, each contiguous fifth of the file held out of all fitting in turn.

    UR5 and WAM: Jacobi 2025; UR10: Landgraf et al. 2021. The models are not gated.

    Args:
        model: Also "LS + GP" or "LS + terms".
    """
    found = json.loads(MEASURED.read_text(encoding="utf-8"))
    return tuple(BlockedGain(each["arm"], each["ls_mm"], *each["removed"][model]) for each in found["arms"])


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
    held = np.isin(np.arange(len(rows)) * BLOCKS // len(rows), pair)
    return rows.select(np.flatnonzero(~held)), rows.select(np.flatnonzero(held))


def blocked_gain(plant: Plant, joints: Array, rng: np.random.Generator, arms: int = ARMS) -> BlockedGain:
    """Draw arms, measure each; identify and learn on eight tenths of its rows and judge by two, another pair for each.

    Args:
        plant: The design.
        joints: Joint commands in the order in which they are measured ``(N, n)``, as from `grid_joints`.
        rng: Of arms, noise and networks.
        arms: How many.
    """
    drawn = draw_plants(plant, load_tolerances("medium"), arms, rng)
    left = []
    for k in range(arms):
        measured = simulated_tracker(plant_at(drawn, k), joints, rng)
        train, test = blocks_apart(measured, (k % BLOCKS, (k + BLOCKS // 2) % BLOCKS))
        found = fit(plant.arm, train, train, rng=rng, settings=BpnnSettings(epochs=EPOCHS)).calibration
        both = (found.without_residual().errors(test), found.errors(test))
        left.append([1e3 * float(np.sqrt(np.mean(np.sum(errors[:, :3] ** 2, axis=1)))) for errors in both])
    ls_mm, network_mm = np.array(left).T
    removed = 1.0 - network_mm / ls_mm
    return BlockedGain(
        plant.name, float(ls_mm.mean()), float(removed.mean()), float(removed.min()), float(removed.max())
    )
