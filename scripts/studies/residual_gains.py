"""What models leave of blocks of a simulated arm's rows: `pickenv experiment scripts/studies/residual_gains.toml`."""

from typing import Any

import numpy as np

from pickenv.arm import plant_at
from pickenv.arm.plant.plant_file import draw_arms
from pickenv.calibration import random_joints, simulated_tracker
from pickenv.experiments.gains import LS, ROWS, TERMS, grid_joints, left_of_blocks

PROTOCOLS = ("grid", "random")
TERMS_ALONE = {"LS + gravity": "gravity", "LS + harmonics": "periodic", TERMS: "auto"}


def left_on_sets(
    rng: np.random.Generator, plant: str, protocol: str, arm: int, set: int, epochs: int
) -> list[dict[str, Any]]:
    """What models leave of blocks held out of one calibration set of an arm: a row for each model.

    Args:
        rng: Its seed counts; streams are those of the protocol, the arm and the set, equal for every plant.
        plant: The design; arms are drawn from class medium.
        protocol: "grid", a grid of positions with another attitude at each (`grid_joints`); or "random" poses.
        arm: Number of the arm.
        set: Which of the arm's two calibration sets.
        epochs: Passes of the network's training.

    Returns:
        For each model "left_mm", RMS, and "removed", the share of what least squares leaves.
    """
    sequence = rng.bit_generator.seed_seq
    assert isinstance(sequence, np.random.SeedSequence)
    number = 2 * arm + set
    of_arms, own = (
        np.random.default_rng(np.random.SeedSequence(sequence.entropy, spawn_key=place))
        for place in ((0,), (1 + PROTOCOLS.index(protocol), number))
    )
    drawn = plant_at(draw_arms(plant, "medium", arm + 1, of_arms), arm)
    nominal = drawn.arm.nominal
    joints = grid_joints(nominal, ROWS, own) if protocol == "grid" else random_joints(nominal, ROWS, own)
    models: dict[str, Any] = {"terms": TERMS_ALONE, "epochs": epochs, "attitudes": True, "frames": "fitted"}
    left = left_of_blocks(drawn.arm, simulated_tracker(drawn, joints, own), number, 4, own, **models)
    return [{"model": name, "left_mm": mm, "removed": 1.0 - mm / left[LS]} for name, mm in left.items()]
