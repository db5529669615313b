"""Train, judge and ship the learned baselines: `python scripts/train_baselines.py` writes the baselines again.

Three seeds each; the first is shipped. Judged on 512 episodes on arms that no training saw, with calibrations of their
own. Options: `--out FOLDER` for the runs, `--only NAME`, `--seeds N`.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from pickenv.agents.evaluation.calibrated import CalibrationPlan, calibrate_arm
from pickenv.agents.evaluation.grid import GridSettings, run_grid
from pickenv.agents.evaluation.statistics import interval
from pickenv.agents.policies.learned import BASELINES
from pickenv.agents.training.training import Trained, train
from pickenv.agents.training.training_setup import Training
from pickenv.arm import load_plant
from pickenv.files import write_text

SEEDS = 3
CAMERA = {"feedback": "camera", "camera_noise_mm": 1.0, "fruit_noise_mm": 0.0}

BASELINES_BY_NAME: dict[str, dict[str, Any]] = {
    "ppo_encoders": {"algorithm": "ppo", "compensated": True},
    "ppo_camera": {"algorithm": "ppo", "arguments": CAMERA},
    "sac_her_encoders": {"algorithm": "sac", "env_id": "pickenv/ReachGoal-v0", "compensated": True},
    "sac_her_camera": {"algorithm": "sac", "env_id": "pickenv/ReachGoal-v0", "arguments": CAMERA},
    "tqc_her_encoders": {"algorithm": "tqc", "env_id": "pickenv/ReachGoal-v0", "compensated": True},
    "tqc_her_camera": {"algorithm": "tqc", "env_id": "pickenv/ReachGoal-v0", "arguments": CAMERA},
}


def training_of(name: str, seed: int, calibration: Path) -> Training:
    """The training of a baseline."""
    what = dict(BASELINES_BY_NAME[name])
    compensate = str(calibration) if what.pop("compensated", False) else None
    return Training(seed=seed, compensate=compensate, evaluate_every=100_000, **what)


def calibration_file(out: Path) -> Path:
    """A calibration of the training arm, fitted if it is not there."""
    path = out / "calibration.npz"
    if not path.is_file():
        calibrate_arm(load_plant("qiao2026"), "ls", CalibrationPlan(), 0).save(path)
    return path


def judged(name: str, files: list[str], out: Path) -> dict[str, Any]:
    """Final errors over all seeds: mean and interval by compensation."""
    feedback = "camera" if name.endswith("camera") else "encoders"
    settings = GridSettings(
        policies=tuple(files), compensations=("raw", "ls", "best"), feedback=(feedback,), plants=("qiao2026",)
    )
    grid = run_grid(settings, out / "calibrations")
    found: dict[str, Any] = {}
    for compensation in settings.compensations:
        cells = [cell for cell in grid.cells if cell.compensation == compensation]
        errors = np.concatenate([cell.errors_mm for cell in cells], axis=1)  # seeds share their arms
        found[compensation] = {
            "mean_mm": float(errors.mean()),
            "ci95": interval(errors, np.random.default_rng(0)),
            "p95_mm": float(np.percentile(errors, 95)),
            "by_seed": [round(float(cell.errors_mm.mean()), 3) for cell in cells],
            "attitude_deg": float(np.mean([cell.rollout.reaches.attitude_error_deg.mean() for cell in cells])),
            "episodes": int(errors.size),
        }
    return found


def card(name: str, trained: list[Trained], figures: dict[str, Any]) -> str:
    """The model card."""
    policy = trained[0].policy
    what = policy.record["training"]
    size = sum(weight.size + bias.size for weight, bias in zip(policy.weights, policy.biases, strict=True))
    behind = "behind a calibration (least squares)" if what["compensate"] else "on the raw arm"
    rows = [
        f"| {key} | {row['mean_mm']:.3f} | {row['ci95'][0]:.3f} to {row['ci95'][1]:.3f} | {row['p95_mm']:.3f} "
        f"| {', '.join(map(str, row['by_seed']))} | {row['attitude_deg']:.2f} | {row['episodes']} |"
        for key, row in figures.items()
    ]
    goal = policy.scaling.goal
    return "\n".join(
        [
            f"# {name}",
            "",
            f"{policy.algorithm.upper()}{' with HER' if goal else ''} on `{what['env_id']}`, arm `{policy.arm}`, plant "
            f"`{what['arguments'].get('plant', 'qiao2026')}`, trained {behind}; {policy.record['steps']} steps, "
            f"{size} weights, seed {what['seed']} of {len(trained)}.",
            f"Arguments of the environment: `{what['arguments']}`. Parameters: "
            f"`pickenv/zoo/hyperparams/{policy.algorithm}.py`.",
            "",
            "## Use",
            "",
            f"Feedback `{'camera' if policy.scaling.camera else 'encoders'}`. Observations and actions are scaled by "
            "the gap to the fruit (`agents/policies/gap.py`), so accuracy is limited by what the policy can see, not "
            "by its network.",
            "",
            "```python",
            "from pickenv.agents.policies.learned import load_policy",
            "",
            f'policy = load_policy("{name}")',
            "action = policy.act(observation)",
            "```",
            "",
            "## Results",
            "",
            "Mean final error over all training seeds, on arms drawn from tolerance class coarse that no training saw, "
            "each with its own calibration; 95 % interval over arms, seeds and fruit.",
            "",
            "| compensation | mean [mm] | 95 % | p95 [mm] | by seed [mm] | attitude [deg] | episodes |",
            "|---|---|---|---|---|---|---|",
            *rows,
            "",
            "## Limits",
            "",
            *(
                ["The goal environment does not reward the attitude: the tool arrives at the fruit, but from anywhere."]
                if goal
                else ["Trained for one arm's nominal geometry; it refuses other arms."]
            ),
            "No obstacles, no joint torques, one fruit at a time; a simulated arm, never a real one.",
            "",
            "Made by `python scripts/train_baselines.py`.",
            "",
        ]
    )


def main() -> None:
    """Train and judge what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("runs/baselines"))
    parser.add_argument("--only", choices=tuple(BASELINES_BY_NAME))
    parser.add_argument("--seeds", type=int, default=SEEDS)
    options = parser.parse_args()
    calibration = calibration_file(options.out)
    for name in [options.only] if options.only else BASELINES_BY_NAME:
        trained = []
        for seed in range(options.seeds):
            out = options.out / name / str(seed)
            again = (out / "checkpoint.pt").is_file()  # goes on where it was interrupted
            trained.append(train(training_of(name, seed, calibration), out, resume=again))
        figures = judged(name, [str(run.out / "policy.npz") for run in trained], options.out)
        trained[0].policy.save(BASELINES / f"{name}.npz")
        write_text(BASELINES / f"{name}.md", card(name, trained, figures))
        rates = ", ".join(f"{run.steps_per_second:.0f}" for run in trained)
        print(
            name, {key: (round(row["mean_mm"], 3), row["by_seed"]) for key, row in figures.items()}, rates, flush=True
        )


if __name__ == "__main__":
    main()
