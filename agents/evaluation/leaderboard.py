"""The leaderboard: policies × feedback × compensations on reaching tasks, over seeds that share neither arms nor fruit.

Every seed and policy is one comparison of `grid`, kept in a run folder of its own, so that a run that was cut off goes
on, and another policy joins without the others being run again. Arms count once each: their interquartile mean leaves
out the best and the worst quarter (Agarwal et al. 2021), with a bootstrap interval over arms.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np

from pickenv.agents.evaluation.calibrated import COMPENSATIONS, CalibrationPlan
from pickenv.agents.evaluation.compared_policies import kind_of, maker_of
from pickenv.agents.evaluation.grid import GridSettings, PolicyGrid, run_grid
from pickenv.agents.evaluation.grid_tables import interval_words, read_grid, write_grid
from pickenv.agents.evaluation.statistics import interquartile_mean
from pickenv.agents.policies.learned import BASELINES, shipped_baselines
from pickenv.arm.files.content import content_sha256
from pickenv.envs.reaching.vector import ReachVectorEnv
from pickenv.errors import InputError
from pickenv.inspect.colours import policy_label
from pickenv.inspect.runs.run_folder import RECORD, read_run
from pickenv.provenance import code_fingerprint, file_sha256
from pickenv.seeds import stream

LEAST_SEEDS = 5
"""Fewest seeds of a leaderboard."""

GRIPPERS = ("li_cup", "compliant_hand")
"""Who takes the fruit; success is the first one's."""

HEADS = ("mean (mm)", "interquartile mean (mm)", "attitude (deg)", *(f"success, {name}" for name in GRIPPERS))


@dataclass(frozen=True)
class LeaderboardSettings:
    """What is run.

    Attributes:
        policies: As `pickenv evaluate` takes them.
        plants: Plant presets, one task each.
        seeds: Seeds; each has arms, fruit, pictures and calibrations of its own.
        arms: Arms drawn for each seed and plant.
        episodes: Fruits per arm.
        epochs: Epochs of each arm's network.
    """

    policies: tuple[str, ...] = ("scripted", "servo", "adaptive", *shipped_baselines())
    plants: tuple[str, ...] = ("qiao2026", "field")
    seeds: tuple[int, ...] = tuple(range(LEAST_SEEDS))
    arms: int = 8
    episodes: int = 16
    epochs: int = 100

    def __post_init__(self) -> None:
        if len(set(self.seeds)) < max(LEAST_SEEDS, len(self.seeds)):
            raise InputError(f"seeds are {list(self.seeds)}; give at least {LEAST_SEEDS}, each once")

    @staticmethod
    def quick() -> LeaderboardSettings:
        """Minutes less, to try things out."""
        policies = ("scripted", "servo", "ppo_encoders")
        return LeaderboardSettings(policies, ("qiao2026",), arms=1, episodes=4, epochs=20)

    def grid(self, policy: str, feedback: tuple[str, ...], seed: int) -> GridSettings:
        """The comparison of one policy with one seed."""
        return GridSettings(
            policies=(policy,),
            compensations=COMPENSATIONS,
            feedback=feedback,
            plants=self.plants,
            grippers=GRIPPERS,
            arms=self.arms,
            episodes=self.episodes,
            seed=seed,
            protocol=CalibrationPlan(epochs=self.epochs, seed=seed),
        )


def run_leaderboard(
    settings: LeaderboardSettings,
    out: Path,
    progress: Callable[[str, int, int], None] | None = None,
    workers: int = 1,
) -> list[dict[str, Any]]:
    """Run what was not run yet, and give the rows.

    Args:
        settings: What is run.
        out: Folder that keeps calibrations and comparisons.
        progress: Called with (stage, done, in all).
        workers: Processes that fit residual models.

    Raises:
        InputError: If a policy is unknown or cannot be run, or a kept file was edited.
    """
    report = progress or (lambda stage, done, total: None)
    feedback = {policy: fitting_feedback(policy) for policy in settings.policies}
    jobs = [(policy, seed) for policy in settings.policies for seed in settings.seeds]
    grids = []
    for done, (policy, seed) in enumerate(jobs):
        grids.append(_kept_grid(settings.grid(policy, feedback[policy], seed), out, workers))
        report("policies and seeds", done + 1, len(jobs))
    return leaderboard_rows(grids)


def fitting_feedback(policy: str) -> tuple[str, ...]:
    """With what feedback a policy can be run; one of somebody else's making is tried.

    Raises:
        InputError: If it is unknown, or can be run with none.
    """
    kind, fits, refusal = kind_of(policy), [], ""
    for feedback in kind.feedback:
        env = ReachVectorEnv(1, feedback=feedback)
        try:
            maker_of(policy)(env, 0).act(env.reset(seed=0)[0])
        except InputError as error:
            refusal = str(error)
            continue
        fits.append(feedback)
    if not fits:
        raise InputError(refusal)
    return tuple(fits)


def leaderboard_rows(grids: Sequence[PolicyGrid]) -> list[dict[str, Any]]:
    """One row per task, policy, feedback and compensation, over all seeds; best interquartile mean of a task first."""
    cells = [(grid, cell) for grid in grids for cell in grid.cells]

    def key(found: tuple[PolicyGrid, Any]) -> tuple[str, ...]:
        cell = found[1]
        return cell.plant, cell.policy, cell.feedback, cell.compensation

    rows = []
    for (plant, policy, feedback, compensation), each in groupby(sorted(cells, key=key), key):
        some = list(each)
        errors = np.concatenate([cell.errors_mm for _, cell in some])  # (arms of all seeds, trainings, fruit)
        turned = [cell.per_arm(lambda rollout: rollout.reaches.attitude_error_deg) for _, cell in some]
        taken = {name: [cell.chances(grid.grippers[name]) for grid, cell in some] for name in GRIPPERS}
        success = {name: float(np.concatenate(chances).mean()) for name, chances in taken.items()}
        middle = interquartile_mean(errors.mean(axis=(1, 2)), stream(0, "leaderboard"))
        rows.append(
            {
                "task": f"pickenv/Reach-v0, {plant}",
                "policy": policy,
                "feedback": feedback,
                "compensation": compensation,
                "mean_mm": float(errors.mean()),
                "iqm_mm": middle.value,
                "attitude_deg": float(np.concatenate(turned).mean()),
                "success": success[GRIPPERS[0]],
                "success_by_gripper": success,
                "ci95_mm": None if middle.ci95 is None else list(middle.ci95),
                "seeds": sorted(grid.settings.seed for grid, _ in some),
                "arms": len(errors),
                "fruit_per_arm": errors.shape[2],
            }
        )
    return sorted(rows, key=lambda row: (row["task"], row["iqm_mm"]))


def leaderboard_cells(row: Mapping[str, Any]) -> list[str]:
    """What people are shown of a row: policy, feedback, compensation, then `HEADS`."""
    return [
        row["policy"],
        row["feedback"],
        policy_label(row["compensation"]),
        f"{row['mean_mm']:.3f}",
        f"{row['iqm_mm']:.3f} ({interval_words(row['ci95_mm'], 3) or 'no interval'})",
        f"{row['attitude_deg']:.3f}",
        *(f"{100 * row['success_by_gripper'][name]:.0f} %" for name in GRIPPERS),
    ]


def leaderboard_tables(rows: Sequence[Mapping[str, Any]]) -> str:
    """The tables in Markdown, one per task."""
    parts = []
    for task, each in groupby(rows, lambda row: row["task"]):
        some = list(each)
        arms, fruit, seeds = some[0]["arms"], some[0]["fruit_per_arm"], ", ".join(map(str, some[0]["seeds"]))
        heads = ("policy", "feedback", "compensation", *HEADS)
        lines = [
            " | ".join(heads),
            "|".join(["---"] * len(heads)),
            *(" | ".join(leaderboard_cells(row)) for row in some),
        ]
        parts += [
            f"{task}: {arms} arms over seeds {seeds}, {fruit} fruit each",
            "",
            *(f"| {line} |" for line in lines),
            "",
        ]
    return "\n".join(parts)


def _kept_grid(settings: GridSettings, out: Path, workers: int) -> PolicyGrid:
    """A comparison from its folder, where it is made if it is not there; a changed policy or program has another."""
    names = [file for name in settings.policies for file in kind_of(name).files]
    paths = [path for name in names for path in (Path(name), BASELINES / f"{name}.npz") if path.is_file()]
    files = [file_sha256(path) for path in paths]
    key = content_sha256(settings, files, code_fingerprint())
    folder = out / f"{Path(settings.policies[0]).stem}-{settings.seed}-{key[:12]}"
    if not (folder / RECORD).is_file():
        write_grid(run_grid(settings, out / "calibrations", None, workers), folder)
    grid = read_grid(read_run(folder))
    return replace(grid, settings=settings)
