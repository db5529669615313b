"""The leaderboard: policies × feedback × compensations on reaching tasks, over seeds that share neither arms nor fruit.

Every seed and policy is one comparison of `grid`, kept in a run folder of its own, so that a run that was cut off goes
on, and another policy joins without the others being run again; every seed of the picking task (`pick_board`) is one
file. Who works on them changes no number. Arms count once each: their interquartile mean leaves
out the best and the worst quarter (Agarwal et al. 2021), with a bootstrap interval over arms.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np

from pickenv.agents.evaluation.calibrated import COMPENSATIONS, CalibrationPlan, kept_calibration
from pickenv.agents.evaluation.compared_policies import kind_of, maker_of
from pickenv.agents.evaluation.grid import GridSettings, PolicyGrid, population, run_grid
from pickenv.agents.evaluation.grid_tables import interval_words, read_grid, with_interval, write_grid
from pickenv.agents.evaluation.pick_board import PICK_PLANT, PickTally, pick_rows, pick_tallies
from pickenv.agents.policies.learned import BASELINES, shipped_baselines
from pickenv.arm.files.arm import content_sha256
from pickenv.arm.plant.plant_batch import plant_at
from pickenv.container import refusing_damage
from pickenv.envs.reaching.vector import ReachVectorEnv
from pickenv.errors import InputError
from pickenv.files import write_json
from pickenv.inspect.colours import policy_label
from pickenv.inspect.runs.run_folder import RECORD, read_run
from pickenv.intervals import interquartile_estimate
from pickenv.provenance import code_fingerprint, file_sha256
from pickenv.seeds import stream

LEAST_SEEDS = 5
"""Fewest seeds of a leaderboard."""

GRIPPERS = ("li_cup", "compliant_hand")
"""Who takes the fruit; success is the first one's."""

WORDS = ("policy", "feedback", "compensation")

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
        canopies: Canopies for each arm of the picking task; 0 leaves the task out.
    """

    policies: tuple[str, ...] = ("scripted", "servo", "adaptive", *shipped_baselines())
    plants: tuple[str, ...] = ("qiao2026", "field")
    seeds: tuple[int, ...] = tuple(range(LEAST_SEEDS))
    arms: int = 2
    episodes: int = 16
    epochs: int = 100
    canopies: int = 2

    def __post_init__(self) -> None:
        if len(set(self.seeds)) < max(LEAST_SEEDS, len(self.seeds)):
            raise InputError(f"seeds are {list(self.seeds)}; give at least {LEAST_SEEDS}, each once")

    @staticmethod
    def quick() -> LeaderboardSettings:
        """Minutes less, to try things out."""
        policies = ("scripted", "servo", "ppo_encoders")
        return LeaderboardSettings(policies, ("qiao2026",), arms=1, episodes=4, epochs=20, canopies=0)

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


Work = Callable[[int], Any]
Runner = Callable[[Sequence[int], Work], Iterator[tuple[int, Any]]]
"""Does the work for each number, in any order and anywhere, as `pickenv.experiments.engine.spread` does."""


def in_turn(numbers: Sequence[int], work: Work) -> Iterator[tuple[int, Any]]:
    """One after the other, in this process."""
    for number in numbers:
        yield number, work(number)


def run_leaderboard(
    settings: LeaderboardSettings,
    out: Path,
    progress: Callable[[str, int, int], None] | None = None,
    runner: Runner = in_turn,
) -> list[dict[str, Any]]:
    """Run what was not run yet, and give the rows.

    Args:
        settings: What is run.
        out: Folder that keeps calibrations and comparisons.
        progress: Called with (stage, done, in all).
        runner: Who works; the rows are the same whoever does.

    Raises:
        InputError: If a policy is unknown or cannot be run, or a kept file was edited.
    """
    report = progress or (lambda stage, done, total: None)
    feedback = {policy: fitting_feedback(policy) for policy in settings.policies}
    grids = [settings.grid(policy, feedback[policy], seed) for policy in settings.policies for seed in settings.seeds]
    reaching = [_grid_folder(each, out) for each in grids]
    picking = [_tally_file(settings, seed, out) for seed in settings.seeds] if settings.canopies else []
    todo_reach = [i for i, folder in enumerate(reaching) if not (folder / RECORD).is_file()]
    todo_pick = [i for i, file in enumerate(picking) if not file.is_file()]

    # Calibrations first, arm by arm: every policy of a seed stands behind the same ones.
    seeds = {grids[i].seed for i in todo_reach} | {settings.seeds[i] for i in todo_pick}
    plants = dict.fromkeys((*settings.plants, *([PICK_PLANT] if todo_pick else ())))
    arms = [
        (seed, plant, compensation, arm)
        for seed in sorted(seeds)
        for plant in plants
        for compensation in COMPENSATIONS
        if compensation != "raw"
        for arm in range(settings.arms)
    ]
    kept = out / "calibrations"
    for done, _ in enumerate(runner(range(len(arms)), partial(_calibrate, settings, tuple(arms), kept))):
        report("calibrations", done + 1, len(arms))
    total = len(reaching) + len(picking)
    done = total - len(todo_reach) - len(todo_pick)
    for number, grid in runner(todo_reach, partial(_reach, tuple(grids), kept)):
        write_grid(grid, reaching[number])
        done += 1
        report("policies and seeds", done, total)
    for number, tallies in runner(todo_pick, partial(_pick, settings, kept)):
        write_json(picking[number], {key: [asdict(tally) for tally in each] for key, each in tallies.items()})
        done += 1
        report("policies and seeds", done, total)
    rows = leaderboard_rows(
        [replace(read_grid(read_run(folder)), settings=grid) for folder, grid in zip(reaching, grids, strict=True)]
    )
    return rows + (pick_rows(settings.seeds, [_read_tallies(file) for file in picking]) if picking else [])


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
        middle = interquartile_estimate(errors.mean(axis=(1, 2)), stream(0, "leaderboard"))
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


def leaderboard_heads(row: Mapping[str, Any]) -> list[str]:
    """Heads of the table that a row belongs to: `WORDS`, then numbers."""
    if "picks_per_hour" not in row:
        return [*WORDS, *HEADS]
    mean, middle, attitude, *success = HEADS
    rates = (f"picks per hour, {name}" for name in row["picks_per_hour"])
    return [*WORDS, f"{mean} at the grasp", middle, attitude, *success, *rates]


def leaderboard_cells(row: Mapping[str, Any]) -> list[str]:
    """What people are shown of a row, in the order of its heads."""
    rates, ends = row.get("picks_per_hour", {}), row.get("picks_per_hour_ci95", {})
    return [
        row["policy"],
        row["feedback"],
        policy_label(row["compensation"]),
        f"{row['mean_mm']:.3f}",
        f"{row['iqm_mm']:.3f} ({interval_words(row['ci95_mm'], 3) or 'no interval'})",
        f"{row['attitude_deg']:.3f}",
        *(f"{100 * row['success_by_gripper'][name]:.0f} %" for name in GRIPPERS),
        *(with_interval(rate, ends[name], 0) for name, rate in rates.items()),
    ]


def leaderboard_tables(rows: Sequence[Mapping[str, Any]]) -> str:
    """The tables in Markdown, one per task."""
    parts = []
    for task, each in groupby(rows, lambda row: row["task"]):
        some = list(each)
        first, heads = some[0], leaderboard_heads(some[0])
        each_arm = f"{first['fruit_per_arm']} fruit each" if "fruit_per_arm" in first else f"{first['attempts']} grasps"
        lines = [
            " | ".join(heads),
            "|".join(["---"] * len(heads)),
            *(" | ".join(leaderboard_cells(row)) for row in some),
        ]
        parts += [
            f"{task}: {first['arms']} arms over seeds {', '.join(map(str, first['seeds']))}, {each_arm}",
            "",
            *(f"| {line} |" for line in lines),
            "",
        ]
    return "\n".join(parts)


def _calibrate(settings: LeaderboardSettings, arms: Sequence[Any], kept: Path, number: int) -> None:
    """Fit one arm and keep it, where it is not kept yet."""
    seed, plant, compensation, arm = arms[number]
    grid = settings.grid("scripted", ("encoders",), seed)
    kept_calibration(kept, plant_at(population(grid, plant), arm), compensation, grid.protocol, arm)


def _reach(grids: Sequence[GridSettings], kept: Path, number: int) -> PolicyGrid:
    """One comparison."""
    return run_grid(grids[number], kept)


def _pick(settings: LeaderboardSettings, kept: Path, number: int) -> dict[str, list[PickTally]]:
    """The picking task of one seed."""
    grid = settings.grid("scripted", ("encoders",), settings.seeds[number])
    return pick_tallies(grid, settings.canopies, kept)


def _grid_folder(settings: GridSettings, out: Path) -> Path:
    """Where a comparison is kept; a changed policy or program has another place."""
    names = [file for name in settings.policies for file in kind_of(name).files]
    paths = [path for name in names for path in (Path(name), BASELINES / f"{name}.npz") if path.is_file()]
    files = [file_sha256(path) for path in paths]
    key = content_sha256(settings, files, code_fingerprint())
    return out / f"{Path(settings.policies[0]).stem}-{settings.seed}-{key[:12]}"


def _tally_file(settings: LeaderboardSettings, seed: int, out: Path) -> Path:
    """Where the picking task of a seed is kept."""
    grid = settings.grid("scripted", ("encoders",), seed)
    key = content_sha256(grid, settings.canopies, PICK_PLANT, code_fingerprint())
    return out / f"picking-{seed}-{key[:12]}.json"


def _read_tallies(file: Path) -> dict[str, list[PickTally]]:
    with refusing_damage(file, "a tally of picks", "delete it, and it is made anew"):
        content = json.loads(file.read_text(encoding="utf-8"))
        return {key: [PickTally(**each) for each in some] for key, some in content.items()}
