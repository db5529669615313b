"""A calibrated arm for MuJoCo: as the controller has it, as it was found, and arms that the data allow."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pickenv.arm import Arm, draw_plants, load_tolerances, plant_at
from pickenv.arm.files.mjcf_text import write_mjcf
from pickenv.calibration.pipeline.calibration import Calibration
from pickenv.calibration.pipeline.twin import twin

NOTE = (
    "Arm '{arm}', {which}, in its own base frame. Geometry alone: no model of links holds terms and residual. Masses "
    "and inertias are those of rods, not measured."
)


def export_mjcf(
    calibration: Calibration, arm: Arm, path: str | Path, *, sample: int = 0, seed: int = 0, tolerances: str = "medium"
) -> list[Path]:
    """Write ``path`` (identified), and beside it ``…_nominal`` and ``…_1`` to ``…_n``, arms that the data allow.

    Returns:
        The files written, the identified arm's first.

    Raises:
        InputError: If it is another arm's calibration, or a file cannot be written.
    """
    plant = twin(calibration, arm, geometry_only=True)
    models = [("as calibrated", plant.geometry), ("nominal", arm.nominal)]
    if sample:
        arms = draw_plants(plant, load_tolerances(tolerances), sample, np.random.default_rng(seed))
        models += [(f"one that the data allow, number {i + 1}", plant_at(arms, i).geometry) for i in range(sample)]
    return [
        write_mjcf(geometry, place, f"{arm.name}: {which}", NOTE.format(arm=arm.name, which=which))
        for place, (which, geometry) in zip(mjcf_files(path, sample), models, strict=True)
    ]


def mjcf_files(path: str | Path, sample: int) -> list[Path]:
    """The files that `export_mjcf` writes; "/" or "..", which name none, as they are."""
    path = Path(path)
    if path.name in ("", ".."):
        return [path]
    endings = ["", "_nominal", *(f"_{i + 1}" for i in range(sample))]
    return [path.with_name(f"{path.stem}{ending}{path.suffix or '.xml'}") for ending in endings]
