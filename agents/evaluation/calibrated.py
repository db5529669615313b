"""Calibrations of a population of simulated arms, each measured by its own tracker run, as in the demo."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import cast

import numpy as np

from pickenv.arm.files.arm import Arm, content_sha256
from pickenv.arm.plant.campaign import TRACKER, load_instrument
from pickenv.arm.plant.plant import Plant
from pickenv.arm.plant.plant_batch import plant_at, plant_count
from pickenv.calibration import BpnnSettings, Calibration, fit, random_joints, simulated_tracker
from pickenv.errors import InputError
from pickenv.extras import require
from pickenv.provenance import code_fingerprint
from pickenv.reservations import obey
from pickenv.seeds import stream
from pickenv.wrappers import Compensate

COMPENSATIONS = ("raw", "ls", "ls_bpnn", "best")
"""No calibration; least squares; with the paper's network; with the best residual model (Gaussian process)."""

RESIDUALS = {"ls_bpnn": "bpnn", "best": "gp"}

ORIGIN = "evaluated_arm_sha256"
"""In a kept calibration's record: hash of the arm and of how it was calibrated."""


@dataclass(frozen=True)
class CalibrationPlan:
    """How each arm is measured and fitted.

    Attributes:
        identification_poses: Poses for least squares (the paper: 100).
        residual_poses: Poses for the residual model (the paper: 200).
        epochs: Passes of the network's training (the paper: 500).
        seed: Seed of poses, noise and networks; every arm has its own stream.
        instrument: What measures them; one of `pickenv.arm.shipped_instruments`, or a path.
    """

    identification_poses: int = 100
    residual_poses: int = 200
    epochs: int = 100
    seed: int = 0
    instrument: str = TRACKER


def calibrate_arm(
    plant: Plant, compensation: str, protocol: CalibrationPlan | None = None, number: int = 0
) -> Calibration:
    """Measure a simulated arm with a simulated tracker and calibrate it; equal arguments give equal calibrations.

    Args:
        plant: The arm.
        compensation: "ls", "ls_bpnn" or "best", of `COMPENSATIONS`.
        protocol: How it is measured and fitted; a `CalibrationPlan` as it is by itself if left out.
        number: The arm's number in a population; every arm has its own poses and noise.

    Raises:
        InputError: If the compensation is not one of `COMPENSATIONS` that calibrate.
    """
    check_compensation(compensation)
    protocol = protocol or CalibrationPlan()
    poses, learning = (np.random.default_rng(part) for part in stream(protocol.seed, "calibration", number).spawn(2))
    counts = (protocol.identification_poses, protocol.residual_poses)
    first, second = (
        simulated_tracker(plant, random_joints(plant.arm.nominal, count, poses), poses, protocol.instrument)
        for count in counts
    )
    residual = RESIDUALS.get(compensation)
    return fit(
        plant.arm,
        first,
        second if residual else None,
        known_frames=True,
        residual=residual or "bpnn",
        rng=learning,
        settings=BpnnSettings(epochs=protocol.epochs) if residual == "bpnn" else None,
    ).calibration


def compensators(
    plants: Plant,
    compensation: str,
    protocol: CalibrationPlan,
    folder: Path | None = None,
    progress: Callable[[int, int], None] | None = None,
    workers: int = 1,
) -> list[Compensate] | None:
    """One compensator per arm of a population, or None for "raw".

    Args:
        plants: The population, or a single arm.
        compensation: One of `COMPENSATIONS`.
        protocol: How they are measured and fitted.
        folder: Where calibrations are kept for the next time, or None.
        progress: Told how many are done, and how many there are.
        workers: Processes that fit residual models, one arm at a time each.

    Raises:
        InputError: If a kept calibration is damaged, or of another arm or protocol than its name says.
    """
    check_compensation(compensation)
    if compensation == "raw":
        return None
    count = plant_count(plants) or 1
    work = partial(_calibrated, plants, compensation, protocol, folder)
    found: list[Compensate] = []
    for number, calibration in enumerate(_in_turn(work, count, workers if compensation in RESIDUALS else 1)):
        found.append(calibration.compensator())
        if progress is not None:
            progress(number + 1, count)
    return found


def _in_turn(work: Callable[[int], Calibration], count: int, workers: int) -> Iterable[Calibration]:
    """The calibrations of ``count`` arms in their order."""
    if min(workers, count) == 1:
        return map(work, range(count))
    require("joblib")
    from joblib import Parallel, delayed

    return cast(Iterable[Calibration], Parallel(workers, return_as="generator")(delayed(work)(i) for i in range(count)))


def _calibrated(
    plants: Plant, compensation: str, protocol: CalibrationPlan, folder: Path | None, number: int
) -> Calibration:
    """The calibration of one arm of a population, from the folder if it is there."""
    plant = plants if plant_count(plants) is None else plant_at(plants, number)
    if folder is None:
        return calibrate_arm(plant, compensation, protocol, number)
    return kept_calibration(folder, plant, compensation, protocol, number)


def check_compensation(compensation: str) -> None:
    """Refuse an unknown compensation.

    Raises:
        InputError: If it is not one of `COMPENSATIONS`.
    """
    if compensation not in COMPENSATIONS:
        raise InputError(f"unknown compensation '{compensation}'; give one of {', '.join(COMPENSATIONS)}")


def load_compensator(path: str | Path, arm: Arm, allow: Collection[str] = ()) -> Compensate:
    """The compensator of a calibration file, for environments whose fruit stand in the arm's own base frame.

    Raises:
        InputError: If the file is missing, damaged or of another arm, or if something stands against its calibration
            that ``allow`` does not name (`pickenv.reservations`).
    """
    calibration = Calibration.load(path, arm)
    obey(calibration.reservations(), allow)
    return calibration.compensator()


def kept_calibration(
    folder: Path, plant: Plant, compensation: str, protocol: CalibrationPlan, number: int
) -> Calibration:
    """The calibration of an arm from a folder, where it is made if it is not there.

    A file belongs to the arm's own numbers, to the protocol and to the code that fits; its record says so as well.

    Args:
        folder: The folder.
        plant: The arm.
        compensation: As in `calibrate_arm`.
        protocol: How it is measured and fitted.
        number: The arm's number in its population.

    Raises:
        InputError: If the kept file is damaged, or of another arm or protocol than its name says.
    """
    instrument = load_instrument(protocol.instrument)
    origin = content_sha256(plant, compensation, protocol, instrument, number, code_fingerprint())
    path = folder / f"{re.sub(r'[^A-Za-z0-9_.-]', '_', plant.name)}-{compensation}-{origin[:16]}.npz"
    if not path.is_file():
        calibration = calibrate_arm(plant, compensation, protocol, number)
        calibration = replace(calibration, record={**calibration.record, ORIGIN: origin})
        calibration.save(path)
        return calibration
    calibration = Calibration.load(path, plant.arm)
    if calibration.record.get(ORIGIN) != origin:
        raise InputError(
            f"{path} is the calibration of another arm or protocol than its name says; delete it, or give another "
            "--cache"
        )
    return calibration
