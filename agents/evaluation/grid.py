"""The comparison: policies × compensations × feedback × plants, on the same arms and fruit, judged by every gripper.

Arms are drawn from a population that no policy was trained on. Fruit, arms and pictures depend on the seed alone, so
that any two cells of one plant can be compared pair by pair.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from pickenv.agents.evaluation.calibrated import CalibrationPlan, check_compensation, compensators
from pickenv.agents.evaluation.rollout import PolicyMaker, Rollout, roll_out
from pickenv.agents.evaluation.statistics import Paired, interquartile_mean, interval, paired
from pickenv.agents.policies.adaptive import AdaptiveReach, AdaptiveSettings
from pickenv.agents.policies.learned import load_policy
from pickenv.agents.policies.oracle import OracleReach
from pickenv.agents.policies.policy import Policy
from pickenv.agents.policies.scripted import RandomReach, ScriptedReach
from pickenv.agents.policies.servo import ServoReach
from pickenv.arm.kinematics.geometry import Array
from pickenv.arm.plant.tolerances import draw_plants, load_tolerances
from pickenv.envs.shared.task import CONTROL_PERIOD, FEEDBACK, check_choice, check_number, load_true_arm
from pickenv.errors import InputError
from pickenv.limits import check_limit
from pickenv.orchard.gripper import Gripper, load_gripper

NEW_ARMS = 1_000_003
"""Seed of the population of evaluation; the environments' own default, 0, is for training."""

CALIBRATED_PRIOR = 0.2
"""Share of the parameters' tolerances that an adaptive policy expects to be left behind a calibration."""


SEQUENTIAL_STEPS = 30
"""Steps of an episode of a policy that learns from pick to pick: the longest way takes 20."""


@dataclass(frozen=True)
class Kind:
    """A kind of policy.

    Attributes:
        feedback: What it can use: "encoders", "camera".
        sequential: Whether it learns from episode to episode.
        raw_only: Whether a compensator would only stand in its way.
    """

    feedback: tuple[str, ...] = FEEDBACK
    sequential: bool = False
    raw_only: bool = False


PLAIN: Mapping[str, Callable[[Any], Policy]] = {"scripted": ScriptedReach, "oracle": OracleReach, "servo": ServoReach}

KINDS: Mapping[str, Kind] = {
    "random": Kind(("encoders",)),
    "scripted": Kind(("encoders",)),
    "oracle": Kind(("encoders",), raw_only=True),
    "servo": Kind(("camera",)),
    "adaptive": Kind(("camera",), sequential=True),
}


@dataclass(frozen=True)
class GridSettings:
    """What is compared.

    Attributes:
        policies: Names of `KINDS`, of shipped baselines, or policy files.
        compensations: Of `pickenv.agents.evaluation.calibrated.COMPENSATIONS`.
        feedback: "encoders" (open loop) and "camera".
        plants: Plant presets.
        grippers: Names of grippers.
        arms: Arms drawn for each plant.
        episodes: Fruits per arm.
        seed: Seed of fruit, pictures and calibrations.
        tolerances: Class of the arms' tolerances.
        population_seed: Seed of the arms.
        camera_noise_mm: Standard deviation per axis of the camera's view of the gap.
        fruit_noise_mm: The same for the fruit's position.
        tolerance_mm: Radius within which a cycle is over, for the cycle time.
        protocol: How arms are calibrated.
    """

    policies: tuple[str, ...] = ("scripted", "oracle", "servo", "adaptive")
    compensations: tuple[str, ...] = ("raw", "ls", "ls_bpnn", "best")
    feedback: tuple[str, ...] = FEEDBACK
    plants: tuple[str, ...] = ("qiao2026", "orchard")
    grippers: tuple[str, ...] = ("li_cup", "compliant_hand")
    arms: int = 8
    episodes: int = 64
    seed: int = 0
    tolerances: str = "coarse"
    population_seed: int = NEW_ARMS
    camera_noise_mm: float = 1.0
    fruit_noise_mm: float = 0.0
    tolerance_mm: float = 2.0
    protocol: CalibrationPlan = field(default_factory=CalibrationPlan)

    def __post_init__(self) -> None:
        for compensation in self.compensations:
            check_compensation(compensation)
        for feedback in self.feedback:
            check_choice("feedback", feedback, FEEDBACK)
        for name in ("camera_noise_mm", "fruit_noise_mm", "tolerance_mm"):
            check_number(name, getattr(self, name))
        check_limit("arms", self.arms, "compared arms")
        check_limit("episodes", self.episodes, "episodes")
        check_limit("epochs", self.protocol.epochs, "epochs")


@dataclass(frozen=True, eq=False)
class Cell:
    """One policy with one compensation and feedback on one plant.

    Attributes:
        policy: Its name.
        compensation: Compensation.
        feedback: "encoders" or "camera".
        plant: Plant preset.
        rollout: The episodes, arms varying fastest.
    """

    policy: str
    compensation: str
    feedback: str
    plant: str
    rollout: Rollout

    @property
    def errors_mm(self) -> Array:
        """Final errors ``(arms, episodes)``."""
        return self.per_arm(self.rollout.reaches.position_error_mm)

    def per_arm(self, values: Array) -> Array:
        """Values of all episodes as ``(arms, episodes)``."""
        arms = int(self.rollout.arm.max()) + 1
        return np.asarray(values).reshape(-1, arms).T


@dataclass(frozen=True, eq=False)
class PolicyGrid:
    """All cells.

    Attributes:
        settings: What was compared.
        cells: The cells.
        grippers: The grippers by name.
    """

    settings: GridSettings
    cells: tuple[Cell, ...]
    grippers: dict[str, Gripper]

    def rows(self) -> list[dict[str, Any]]:
        """One row per policy × compensation × feedback × plant × gripper."""
        return [_row(self.settings, cell, name, self.grippers[name]) for cell in self.cells for name in self.grippers]

    def comparisons(self) -> list[dict[str, Any]]:
        """Every compensation against raw, and each against the one before, pair by pair."""
        found = []
        steps = list(self.settings.compensations)
        for key, cells in _by_policy(self.cells).items():
            for one, other in [(a, b) for i, a in enumerate(steps) for b in steps[i + 1 :]]:
                if one not in cells or other not in cells:
                    continue
                rng = np.random.default_rng(self.settings.seed)
                result: Paired = paired(cells[one].errors_mm, cells[other].errors_mm, rng)
                found.append(
                    dict(zip(("policy", "feedback", "plant"), key, strict=True))
                    | {"from": one, "to": other, "difference_mm": result.difference, "ci95": list(result.ci95)}
                    | {"significant": result.significant}
                )
        return found

    def cell(self, policy: str, compensation: str, feedback: str, plant: str) -> Cell:
        """A cell by its keys; raises `KeyError` if it was not run."""
        for cell in self.cells:
            if (cell.policy, cell.compensation, cell.feedback, cell.plant) == (policy, compensation, feedback, plant):
                return cell
        raise KeyError((policy, compensation, feedback, plant))


def kind_of(name: str) -> Kind:
    """What kind of policy a name stands for.

    Raises:
        InputError: If it is neither a kind nor a policy file.
    """
    if name in KINDS:
        return KINDS[name]
    try:
        policy = load_policy(name)
    except InputError as error:
        if name.endswith(".npz"):
            raise
        raise InputError(f"unknown policy '{name}'; give {', '.join(KINDS)}, a shipped baseline or a file") from error
    return Kind(("camera",) if policy.scaling.camera else ("encoders",))


def maker_of(name: str, settings: GridSettings, compensation: str = "raw") -> PolicyMaker:
    """How a policy is made for an environment, from a seed."""

    def make(env: Any, seed: int) -> Policy:
        if name == "random":
            return RandomReach(env, np.random.default_rng(seed))
        if name in PLAIN:
            return PLAIN[name](env)
        if name == "adaptive":
            noise = np.hypot(settings.camera_noise_mm, settings.fruit_noise_mm) * 1e-3
            prior = 1.0 if compensation == "raw" else CALIBRATED_PRIOR
            return AdaptiveReach(env, AdaptiveSettings(camera_std=float(noise), prior=prior))
        return load_policy(name, env.task.plant.arm)

    return make


def run_grid(
    settings: GridSettings,
    folder: Path | None = None,
    progress: Callable[[str, int, int], None] | None = None,
) -> PolicyGrid:
    """Run every cell.

    Args:
        settings: What is compared.
        folder: Where calibrations are kept for the next time, or None.
        progress: Called with (stage, done, in all).

    Raises:
        InputError: If a name is unknown, or no policy can be run as asked.
    """
    report = progress or (lambda stage, done, total: None)
    grippers = {name: load_gripper(name) for name in settings.grippers}
    kinds = {name: kind_of(name) for name in settings.policies}
    jobs = [
        (plant, compensation, feedback, name)
        for plant in settings.plants
        for compensation in settings.compensations
        for feedback in settings.feedback
        for name, kind in kinds.items()
        if feedback in kind.feedback and not (kind.raw_only and compensation != "raw")
    ]
    if not jobs:
        raise InputError(_nothing_fits(settings, kinds))
    cells: list[Cell] = []
    fitted: dict[tuple[str, str], Any] = {}
    for done, (plant, compensation, feedback, name) in enumerate(jobs):
        if (plant, compensation) not in fitted:
            stage = f"calibrating, {plant}, {compensation}"
            fitted[plant, compensation] = compensators(
                population(settings, plant), compensation, settings.protocol, folder, partial(report, stage)
            )
        rollout = roll_out(
            maker_of(name, settings, compensation),
            settings.arms,
            settings.episodes,
            settings.seed,
            compensators=fitted[plant, compensation],
            sequential=kinds[name].sequential,
            steps=SEQUENTIAL_STEPS if kinds[name].sequential else 60,
            plant=plant,
            feedback=feedback,
            camera_noise_mm=settings.camera_noise_mm if feedback == "camera" else 0.0,
            fruit_noise_mm=settings.fruit_noise_mm,
            tolerances=settings.tolerances,
            population_seed=settings.population_seed,
        )
        cells.append(Cell(policy_name(name), compensation, feedback, plant, rollout))
        report("evaluating", done + 1, len(jobs))
    return PolicyGrid(settings, tuple(cells), grippers)


def population(settings: GridSettings, plant: str) -> Any:
    """The arms of a plant, as the environments draw them."""
    rng = np.random.default_rng(settings.population_seed)
    return draw_plants(load_true_arm(plant), load_tolerances(settings.tolerances), settings.arms, rng)


def policy_name(name: str) -> str:
    """How a policy is called in tables: files by the end of their path."""
    return "/".join(Path(name).with_suffix("").parts[-3:]) if name.endswith(".npz") else name


def _nothing_fits(settings: GridSettings, kinds: Mapping[str, Kind]) -> str:
    """Why there is nothing to compare."""
    able = (
        f"{name} needs feedback {' or '.join(kind.feedback)}{' and compensation raw' if kind.raw_only else ''}"
        for name, kind in kinds.items()
    )
    return (
        f"no policy can be run with feedback {' or '.join(settings.feedback)} and compensation "
        f"{' or '.join(settings.compensations)}: {', '.join(able)}; change one of them"
    )


def _row(settings: GridSettings, cell: Cell, name: str, gripper: Gripper) -> dict[str, Any]:
    errors = cell.errors_mm
    success = cell.per_arm(cell.rollout.capture(gripper))
    rng = np.random.default_rng(settings.seed)
    steps = cell.rollout.cycle_steps(settings.tolerance_mm)
    inside = np.isfinite(steps)
    return {
        "policy": cell.policy,
        "compensation": cell.compensation,
        "feedback": cell.feedback,
        "plant": cell.plant,
        "gripper": name,
        "mean_mm": float(errors.mean()),
        "ci95": list(interval(errors, rng)),
        "iqm_mm": float(interquartile_mean(errors.ravel())),
        "iqm_ci95": list(interval(errors, rng, interquartile_mean, arms_too=False)),
        "p95_mm": float(np.percentile(errors, 95)),
        "success_rate": float(success.mean()),
        "success_ci95": list(interval(success, rng)),
        "cycle_s": float(np.median(steps[inside]) * CONTROL_PERIOD) if inside.any() else None,
        "within_tolerance": float(inside.mean()),
        "episodes": int(errors.size),
        "arms": int(errors.shape[0]),
        "seeds": [settings.seed],
        "population_seed": settings.population_seed,
        "tolerances": settings.tolerances,
        "camera_noise_mm": settings.camera_noise_mm if cell.feedback == "camera" else 0.0,
        "fruit_noise_mm": settings.fruit_noise_mm,
    }


def _by_policy(cells: Sequence[Cell]) -> dict[tuple[str, str, str], dict[str, Cell]]:
    found: dict[tuple[str, str, str], dict[str, Cell]] = {}
    for cell in cells:
        found.setdefault((cell.policy, cell.feedback, cell.plant), {})[cell.compensation] = cell
    return found
