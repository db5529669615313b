"""Calibrate simulated arms by a method, given by name; each arm is measured in its own simulated tracker run.

"raw" is no calibration, and "ls" is least squares. "ls+MODEL" adds any registered residual model to least squares. Two
such methods have short names: "ls_bpnn" adds the network of Qiao 2026, "best" a Gaussian process.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import ArrayLike

from pickenv.agents import episode_seeds
from pickenv.arm import Plant, load_instrument, plant_at
from pickenv.arm.plant.campaign import TRACKER
from pickenv.arm.plant.plant import plant_count
from pickenv.base import InputError, stream
from pickenv.base.registry import names, origin
from pickenv.calibration import BpnnSettings, Calibration, fit
from pickenv.envs.shared.task import check_count
from pickenv.experiments.engine import input_key
from pickenv.experiments.gains import random_sets
from pickenv.inspect.runs.recorded_episodes import Reaches, reaches_of
from pickenv.wrappers import Compensate, CompensationVectorWrapper

METHODS: tuple[str, ...] = ("raw", "ls", "ls_bpnn", "best")
"""Methods that are compared by default."""

RESIDUALS = {"ls": None, "ls_bpnn": "bpnn", "best": "gp"}
"""Residual model that each of these methods adds to least squares; None if it adds none."""

ORIGIN = "evaluated_arm_sha256"
"""Key in the record of a stored calibration, whose value is a hash of the arm and of how it was calibrated."""


@dataclass(frozen=True)
class CalibrationPlan:
    """Settings with which each simulated arm is measured and fitted.

    Attributes:
        identification_poses: Number of poses for least squares (Qiao 2026: 100).
        residual_poses: Number of poses for the residual model (Qiao 2026: 200).
        epochs: Training epochs of the network (Qiao 2026: 500).
        seed: Seed of poses, noise and networks; every arm has its own random stream.
        instrument: Instrument that measures the poses; a name of `pickenv.arm.load_instrument`, or a path.
    """

    identification_poses: int = 100
    residual_poses: int = 200
    epochs: int = 100
    seed: int = 0
    instrument: str = TRACKER


def check_method(method: str) -> None:
    """Raise an error if a calibration method is unknown.

    Raises:
        InputError: If the method is neither in `METHODS` nor "ls+" with the name of a registered residual model.
    """
    if method not in METHODS and not (method.startswith("ls+") and method[3:] in names("residual")):
        models = ", ".join(names("residual"))
        raise InputError(
            f"unknown compensation '{method}'; give one of {', '.join(METHODS)}, or ls+ and a residual model: {models}"
        )


def calibrate_arm(plant: Plant, method: str, plan: CalibrationPlan | None = None, number: int = 0) -> Calibration:
    """Measure a simulated arm with a simulated tracker and calibrate it; equal arguments give equal calibrations.

    Args:
        plant: The plant, that is the true arm with its errors.
        method: "ls", "ls_bpnn", "best", or "ls+" and the name of a registered residual model, such as "ls+rbf".
        plan: Settings of measurement and fit; a default `CalibrationPlan` if left out.
        number: The arm's index in a population, from 0; every index has its own poses and noise.

    Raises:
        InputError: If there is no such method, or the method is "raw".
    """
    check_method(method)
    if method == "raw":
        raise InputError("compensation raw calibrates nothing; give ls, ls_bpnn, best, or ls+ and a residual model")
    plan = plan or CalibrationPlan()
    poses, learning = (np.random.default_rng(part) for part in stream(plan.seed, "calibration", number).spawn(2))
    first, second = random_sets(plant, (plan.identification_poses, plan.residual_poses), poses, plan.instrument)
    residual = residual_of(method)
    settings = BpnnSettings(epochs=plan.epochs) if residual == "bpnn" else None
    how: dict[str, Any] = {"known_frames": True, "residual": residual or "bpnn", "rng": learning, "settings": settings}
    return fit(plant.arm, first, second if residual else None, **how).calibration


def residual_of(method: str) -> str | None:
    """Return the name of the residual model that a method adds to least squares; None for "raw" and "ls"."""
    return RESIDUALS.get(method, method.partition("+")[2] or None)


def sources_of(method: str, plan: CalibrationPlan) -> tuple[Any, ...]:
    """Return what results depend on besides the names of method and instrument, for hashes of inputs.

    These are two values: package and version of the method's residual model (None without one), and the instrument.
    """
    residual = residual_of(method)
    return None if residual is None else str(origin("residual", residual)), load_instrument(plan.instrument)


# Calibrations that are kept: made once per arm, method and plan.


def kept_calibration(folder: Path, plant: Plant, method: str, plan: CalibrationPlan, number: int) -> Calibration:
    """Return an arm's calibration from a folder; if the folder lacks it, calibrate the arm and store the result there.

    The arguments after ``folder`` are as for `calibrate_arm`. The file name contains one hash over the arm's
    parameters, the method, the plan, the arm's number and the code. The record in the file contains the same hash.

    Raises:
        InputError: If the file is damaged, or the hash in its record differs from the hash in its name.
    """
    key = input_key(plant, method, sources_of(method, plan), plan, number)
    path = folder / f"{re.sub(r'[^A-Za-z0-9_.-]', '_', plant.name)}-{method}-{key[:16]}.npz"
    if not path.is_file():
        calibration = calibrate_arm(plant, method, plan, number)
        calibration = replace(calibration, record={**calibration.record, ORIGIN: key})
        calibration.save(path)
        return calibration
    calibration = Calibration.load(path, plant.arm)
    if calibration.record.get(ORIGIN) != key:
        raise InputError(
            f"{path} is the calibration of another arm or protocol than its name says; delete it, or give another "
            "`cache`"
        )
    return calibration


def compensators(
    plants: Plant, method: str, plan: CalibrationPlan, folder: Path | None = None
) -> list[Compensate] | None:
    """Return one compensator for each arm of a population, or for a single arm; None for the method "raw".

    Args:
        plants: A single arm, or a population, that is a plant whose parameters are arrays over arms.
        method: Method as for `calibrate_arm`, or "raw".
        plan: How each arm is measured and fitted.
        folder: Folder in which calibrations are stored, as for `kept_calibration`; None stores none.

    Raises:
        InputError: If there is no such method, or a stored calibration is damaged or belongs to another arm or plan.
    """
    if method == "raw":
        return None
    arms = [plants] if (count := plant_count(plants)) is None else [plant_at(plants, i) for i in range(count)]
    make = calibrate_arm if folder is None else partial(kept_calibration, folder)
    return [make(arm, method, plan, number).compensator() for number, arm in enumerate(arms)]


# Any client's policy, judged raw and behind calibrations of the same arm, on the same fruit.


def reaches_behind(
    act: Callable[[Any], ArrayLike],
    compensations: Sequence[str] = METHODS[:3],
    *,
    id: str = "pickenv/ReachScaled-v0",
    plant: str = "qiao2026",
    episodes: int = 100,
    seed: int = 0,
    **arguments: Any,
) -> dict[str, Reaches]:
    """Let a policy reach for the same fruit once for each compensation: with the arm raw, or calibrated by a method.

    Args:
        act: Function that maps the observations of all episodes, ``(N, ...)`` or a dict of such arrays, to actions
            ``(N, n)``.
        compensations: "raw", and methods as for `calibrate_arm`; each method calibrates the arm from new simulated
            tracker measurements.
        id: Id of a reach environment that has a vectorised implementation of its own.
        plant: Plant preset or plant file, which describes the true arm with its errors.
        episodes: Number of episodes N, each with its own fruit.
        seed: Seed of fruit and calibrations; different seeds give different fruit and calibrations.
        arguments: Further arguments of the environment.

    Returns:
        The final states of the episodes, by compensation.

    Raises:
        InputError: If a compensation or an argument is unknown, or the environment has no vectorised implementation.
    """
    check_count("episodes", episodes)
    for name in compensations:
        check_method(name)
    if id not in gym.registry or gym.spec(id).vector_entry_point is None:
        raise InputError(f"'{id}' is no environment with a native vector; give one such as pickenv/ReachScaled-v0")
    seeds = episode_seeds(seed, episodes)
    ends = {}
    for name in compensations:
        envs: Any = gym.make_vec(id, num_envs=episodes, autoreset_mode="Disabled", plant=plant, **arguments)
        inner = envs.unwrapped
        for calibration in compensators(inner.task.plant, name, CalibrationPlan(seed=seed)) or ():
            envs = CompensationVectorWrapper(envs, calibration)
        observations, infos = envs.reset(seed=list(seeds))
        for _ in range(inner.max_episode_steps):
            observations, _, _, _, infos = envs.step(act(observations))
        ends[name] = reaches_of(inner.plant.geometry, seeds, infos)
    return ends
