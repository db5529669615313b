"""What geometry leaves of one measured set, taken apart: `pickenv experiment scripts/studies/remainder.toml`.

UR5 (Jacobi 2025) and UR10, series A to D (Landgraf et al. 2021), from the folder that PICKENV_DATA names.
"""

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from pickenv.arm import Array, joint_jacobian
from pickenv.calibration import Choices, calibrate
from pickenv.calibration.identification.term_choice import harmonics_of
from pickenv.experiments.robots import SETS

ROWS = 1500
"""Files with more rows are thinned to about so many, at equal steps."""

JOINTS, FIRST = 6, 3
"""The waves of so many first joints make the spectrum; the wrist's are counted apart."""

LOWEST = 3.0
"""Slower waves than this, cycles per turn, cannot be told from one another, nor from geometry, over a joint's range."""


def remainder(rng: np.random.Generator, set: str) -> list[dict[str, Any]]:
    """What is left of one set on blocks held out, mm RMS, and the waves of all its rows; a row for each joint."""
    data = Path(os.environ.get("PICKENV_DATA", "../shared/data"))
    arm, rows, _ = SETS[set].load(data)
    rows = rows.select(np.arange(0, len(rows.joints), max(1, round(len(rows.joints) / ROWS))))
    left: dict[str, float] = {}
    for name, terms in (("gravity", "gravity"), ("periodic", "periodic"), ("best", "auto")):
        result = calibrate(arm, rows, split="blocked", choices=Choices(terms=terms, residual="none"))
        for model, errors in (("geometry", result.errors["geometric"]), (name, list(result.errors.values())[-1])):
            left[model] = float(1e3 * np.sqrt(np.mean(np.sum(errors[:, :3] ** 2, axis=1))))
    fitted = result.fit.identification
    reach = np.sqrt(np.mean(np.sum(joint_jacobian(fitted.geometry, rows.joints)[:, :3] ** 2, axis=1), axis=0))
    waves = [(joint, order, 1e3 * size * float(reach[joint])) for joint, order, _, size, _ in harmonics_of(fitted)]
    return parts_of(left, waves, repeats(SETS[set].paths(data)[0][0]))


def repeats(path: Path) -> float:
    """Standard deviation of repeated measurements, mm: median over poses, along three axes; NaN if none is stated."""
    table = pd.read_csv(path, sep=";", decimal=",", float_precision="round_trip")
    names = [f"measurement_std_{axis}" for axis in "xyz"]
    if not {*names} <= {*table}:
        return float("nan")
    return float(np.median(np.sqrt(np.sum(table[names].to_numpy() ** 2, axis=1))))


def parts_of(
    left: Mapping[str, float], waves: Sequence[tuple[int, float, float]], repeats_mm: float
) -> list[dict[str, Any]]:
    """The numbers to size a plant by, of one set: shares of variance, and sums for the spectrum of its waves.

    Args:
        left: What "geometry", "gravity", "periodic" and "best" leave, mm RMS.
        waves: Joint from 0, order and amplitude in mm of each.
        repeats_mm: As `repeats` says.
    """
    whole = left["geometry"] ** 2
    gravity = max(1.0 - left["gravity"] ** 2 / whole, 0.0)
    rest = min(left["periodic"], left["best"]) ** 2 / whole
    joint, order, size = np.array([wave for wave in waves if wave[1] >= LOWEST]).reshape(-1, 3).T
    energy = np.array([np.sum(size[joint == number] ** 2) for number in range(JOINTS)])
    # log size = a constant of the set - decay * log order
    x, y = (np.log(values[joint < FIRST]) for values in (order, size))
    x, y = (values - values.mean() if len(values) else values for values in (x, y))
    numbers = {f"{name}_mm": value for name, value in left.items()} | {"repeats_mm": repeats_mm}
    numbers |= {"gravity": gravity, "waves": max(1.0 - gravity - rest, 0.0), "rest": rest}
    numbers |= {"falling": -float(x @ y), "orders": float(x @ x), "sizes": float(y @ y), "first_waves": len(x)}
    numbers |= {"highest": float(order.max(initial=0.0)), "whole_mm2": float(energy.sum())}
    return [{"joint": number + 1, "energy_mm2": float(energy[number])} | numbers for number in range(JOINTS)]


def decay_std(sets: Array) -> float:
    """Standard deviation of the decay: slope, orders and sizes as in `parts_of`, each set with its own constant."""
    falling, orders, sizes, waves = sets.sum(axis=0)
    return float(np.sqrt((sizes - falling**2 / orders) / (waves - np.sum(sets[:, 3] > 0) - 1.0) / orders))


def largest(sets: Array) -> float:
    """The largest of any set."""
    return float(sets.max())
