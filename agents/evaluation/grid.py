"""The comparison: policies × compensations × feedback × plants, on the same arms and fruit, judged by every gripper.

Arms are drawn from a population that no policy was trained on. Fruit, arms and pictures depend on the seed alone, so
that any two cells of one plant can be compared pair by pair; another seed shares nothing with it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from pickenv.agents.evaluation.calibrated import CalibrationPlan, check_compensation, compensators
from pickenv.agents.evaluation.compared_policies import Kind, kind_of, maker_of, policy_name
from pickenv.agents.evaluation.rollout import Rollout, roll_out
from pickenv.arm.kinematics.geometry import Array
from pickenv.arm.plant.named_plants import draw_arms
from pickenv.envs.shared.situation import CONTROL_PERIOD
from pickenv.envs.shared.task import FEEDBACK, check_choice, check_number
from pickenv.errors import InputError
from pickenv.intervals import Estimate, mean_estimate, quantile_estimate, share_estimate
from pickenv.limits import check_limit
from pickenv.orchard.gripper import Gripper, load_gripper
from pickenv.seeds import seed_words, stream


@dataclass(frozen=True)
class GridSettings:
    """What is compared.

    Attributes:
        policies: Names of registered policies or of shipped baselines, policy files, or folders of one
            training with several seeds.
        compensations: Of `pickenv.agents.evaluation.calibrated.COMPENSATIONS`.
        feedback: "encoders" (open loop) and "camera".
        plants: Plant presets.
        grippers: Names of grippers.
        arms: Arms drawn for each plant.
        episodes: Fruits per arm.
        seed: Seed of arms, fruit and pictures.
        tolerances: Class of the arms' tolerances.
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
    arms: int = 64
    episodes: int = 32
    seed: int = 0
    tolerances: str = "coarse"
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

    @property
    def population_seed(self) -> int:
        """Seed of the arms."""
        return seed_words(stream(self.seed, "arms"), 1)[0]


@dataclass(frozen=True, eq=False)
class Cell:
    """One policy with one compensation and feedback on one plant.

    Attributes:
        policy: Its name.
        compensation: Compensation.
        feedback: "encoders" or "camera".
        plant: Plant preset.
        learned: Whether it was trained: then an interval is of these trainings, or of this one.
        rollouts: The episodes, arms varying fastest, of each training; of a policy that was not trained, one.
    """

    policy: str
    compensation: str
    feedback: str
    plant: str
    learned: bool
    rollouts: tuple[Rollout, ...]

    @property
    def rollout(self) -> Rollout:
        """The episodes of the first training."""
        return self.rollouts[0]

    @property
    def errors_mm(self) -> Array:
        """Final errors ``(arms, trainings, episodes)``."""
        return self.per_arm(lambda rollout: rollout.reaches.position_error_mm)

    def chances(self, gripper: Gripper) -> Array:
        """Probability ``(arms, trainings, episodes)`` that the gripper takes each fruit."""
        return self.per_arm(lambda rollout: rollout.capture(gripper))

    def per_arm(self, values_of: Callable[[Rollout], Array]) -> Array:
        """What a function makes of each training's episodes, as ``(arms, trainings, episodes)``."""
        arms = int(self.rollout.arm.max()) + 1
        return np.stack([np.asarray(values_of(rollout)).reshape(-1, arms).T for rollout in self.rollouts], axis=1)


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
                result = mean_estimate(cells[other].errors_mm - cells[one].errors_mm)
                found.append(
                    dict(zip(("policy", "feedback", "plant"), key, strict=True))
                    | {"from": one, "to": other, "difference_mm": result.value, "ci95": _ends(result)}
                    | {"significant": result.significant, "no_interval": result.missing}
                )
        return found

    def cell(self, policy: str, compensation: str, feedback: str, plant: str) -> Cell:
        """A cell by its keys; raises `KeyError` if it was not run."""
        for cell in self.cells:
            if (cell.policy, cell.compensation, cell.feedback, cell.plant) == (policy, compensation, feedback, plant):
                return cell
        raise KeyError((policy, compensation, feedback, plant))


def run_grid(
    settings: GridSettings,
    folder: Path | None = None,
    progress: Callable[[str, int, int], None] | None = None,
    workers: int = 1,
) -> PolicyGrid:
    """Run every cell.

    Args:
        settings: What is compared.
        folder: Where calibrations are kept for the next time, or None.
        progress: Called with (stage, done, in all).
        workers: Processes that fit residual models, one arm at a time each.

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
                population(settings, plant), compensation, settings.protocol, folder, partial(report, stage), workers
            )
        rollouts = tuple(
            roll_out(
                maker_of(file, float(np.hypot(settings.camera_noise_mm, settings.fruit_noise_mm)), compensation),
                settings.arms,
                settings.episodes,
                settings.seed,
                compensators=fitted[plant, compensation],
                sequential=kinds[name].sequential,
                steps=kinds[name].steps,
                plant=plant,
                feedback=feedback,
                camera_noise_mm=settings.camera_noise_mm if feedback == "camera" else 0.0,
                fruit_noise_mm=settings.fruit_noise_mm,
                tolerances=settings.tolerances,
                population_seed=settings.population_seed,
            )
            for file in kinds[name].files or (name,)
        )
        cells.append(Cell(policy_name(name), compensation, feedback, plant, bool(kinds[name].files), rollouts))
        report("evaluating", done + 1, len(jobs))
    return PolicyGrid(settings, tuple(cells), grippers)


def population(settings: GridSettings, plant: str) -> Any:
    """The arms of a plant, as the environments draw them."""
    rng = np.random.default_rng(settings.population_seed)
    return draw_arms(plant, settings.tolerances, settings.arms, rng)


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
    mean, success = mean_estimate(errors), share_estimate(cell.chances(gripper))
    median, worst = quantile_estimate(errors, 0.5), quantile_estimate(errors, 0.95)
    steps = np.concatenate([rollout.cycle_steps(settings.tolerance_mm) for rollout in cell.rollouts])
    inside = np.isfinite(steps)
    arms, trainings, _ = errors.shape
    return {
        "policy": cell.policy,
        "compensation": cell.compensation,
        "feedback": cell.feedback,
        "plant": cell.plant,
        "gripper": name,
        "mean_mm": mean.value,
        "ci95": _ends(mean),
        "median_arm_mm": median.value,
        "median_arm_ci95": _ends(median),
        "p95_arm_mm": worst.value,
        "p95_arm_ci95": _ends(worst),
        "success_rate": success.value,
        "success_ci95": _ends(success),
        "no_interval": mean.missing,
        "interval_over": _interval_over(cell.learned, trainings),
        "cycle_s": float(np.median(steps[inside]) * CONTROL_PERIOD) if inside.any() else None,
        "within_tolerance": float(inside.mean()),
        "episodes": int(errors.size),
        "arms": arms,
        "trainings": trainings if cell.learned else None,
        "seeds": [settings.seed],
        "population_seed": settings.population_seed,
        "tolerances": settings.tolerances,
        "camera_noise_mm": settings.camera_noise_mm if cell.feedback == "camera" else 0.0,
        "fruit_noise_mm": settings.fruit_noise_mm,
    }


def _ends(found: Estimate) -> list[float | None] | None:
    return None if found.ci95 is None else list(found.ci95)


def _interval_over(learned: bool, trainings: int) -> str:
    """What another draw of the intervals' data would have anew."""
    if not learned:
        return "arms"
    return "arms, of this one training" if trainings == 1 else f"arms and {trainings} trainings"


def _by_policy(cells: Sequence[Cell]) -> dict[tuple[str, str, str], dict[str, Cell]]:
    found: dict[tuple[str, str, str], dict[str, Cell]] = {}
    for cell in cells:
        found.setdefault((cell.policy, cell.feedback, cell.plant), {})[cell.compensation] = cell
    return found
