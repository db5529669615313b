"""Train, judge and ship the learned baselines: `python scripts/studies/train_baselines.py` writes the baselines again.

Five seeds each; the first is shipped. Judged on arms that no training saw, with calibrations of their own. Options:
`--out FOLDER` for the runs, `--only NAME`, `--seeds N`, and `--cards` to judge the shipped policies as they are.
"""

import argparse
from pathlib import Path
from typing import Any

from jinja2 import StrictUndefined, Template

from pickenv.agents import BASELINES, LearnedPolicy, RememberingPolicy, Training, train, tuned
from pickenv.agents.evaluation.contenders import load_any
from pickenv.arm import load_plant
from pickenv.base import write_text
from pickenv.experiments import CalibrationPlan, PolicySettings, calibrate_arm, evaluation_rows, run_policies
from pickenv.experiments.policy_tables import KEYS, cells_of

SEEDS = 5
CARD = Path(__file__).with_name("baseline_card.md.jinja")
CAMERA = {"feedback": "camera", "camera_noise_mm": 1.0, "fruit_noise_mm": 0.0}

BASELINES_BY_NAME: dict[str, dict[str, Any]] = {
    "ppo_encoders": {"algorithm": "ppo", "compensated": True},
    "ppo_camera": {"algorithm": "ppo", "arguments": CAMERA},
    "sac_her_encoders": {"algorithm": "sac", "env_id": "pickenv/ReachGoal-v0", "compensated": True},
    "sac_her_camera": {"algorithm": "sac", "env_id": "pickenv/ReachGoal-v0", "arguments": CAMERA},
    "tqc_her_encoders": {"algorithm": "tqc", "env_id": "pickenv/ReachGoal-v0", "compensated": True},
    "tqc_her_camera": {"algorithm": "tqc", "env_id": "pickenv/ReachGoal-v0", "arguments": CAMERA},
    "recurrent_camera": {"algorithm": "ppo_lstm"},
    "history_camera": {"algorithm": "ppo_history"},
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


def judged(name: str, policy: str, out: Path, compensations: tuple[str, ...]) -> list[dict[str, Any]]:
    """One row per compensation, of a folder of trainings or of one policy."""
    feedback = "camera" if name.endswith("camera") else "encoders"
    settings = PolicySettings((policy,), compensations, (feedback,), plants=("qiao2026",), grippers=("li_cup",))
    rows = run_policies(settings, cache=out / "calibrations", backend="loky")
    results = []
    for row in evaluation_rows(settings, rows):
        some = rows.where(compensation=row["compensation"])
        by_seed = [float(some.where(training=number)["error_mm"].mean()) for (number,) in some.levels("training")]
        results.append(row | {"by_seed": by_seed, "attitude_deg": float(some["attitude_deg"].mean())})
    return results


def cells(row: dict[str, Any]) -> list[str]:
    """A line of the card's table."""
    errors = cells_of(row)[len(KEYS) : len(KEYS) + 4]
    by_seed = ", ".join(f"{error:.3f}" for error in row["by_seed"])
    return [row["compensation"], *errors, by_seed, f"{row['attitude_deg']:.2f}"]


def card(name: str, policy: LearnedPolicy | RememberingPolicy, results: list[dict[str, Any]]) -> str:
    """The model card."""
    what = policy.record["training"]
    size = sum(weight.size + bias.size for weight, bias in zip(policy.weights, policy.biases, strict=True))
    if isinstance(policy, RememberingPolicy):
        size += sum(value.size for value in policy.arrays.values())
    return Template(CARD.read_text(encoding="utf-8"), undefined=StrictUndefined, keep_trailing_newline=True).render(
        name=name,
        policy=policy,
        what=what,
        remembering=isinstance(policy, RememberingPolicy),
        goal=isinstance(policy, LearnedPolicy) and policy.scaling.goal,
        size=size,
        arguments=tuned(policy.algorithm, what["env_id"]).get("env_kwargs", {}) | what["arguments"],
        first=results[0],
        lines="\n".join(f"| {' | '.join(cells(row))} |" for row in results),
        compensations=" ".join(row["compensation"] for row in results),
    )


def main() -> None:
    """Train and judge what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("runs/baselines"))
    parser.add_argument("--only", choices=tuple(BASELINES_BY_NAME))
    parser.add_argument("--seeds", type=int, default=SEEDS)
    parser.add_argument("--cards", action="store_true", help="Judge the shipped policies anew; train nothing.")
    parser.add_argument("--compensations", nargs="+", default=["raw", "ls"])
    options = parser.parse_args()
    for name in [options.only] if options.only else BASELINES_BY_NAME:
        if options.cards:
            policy, judged_policy = load_any(name), name
        else:
            trained = []
            for seed in range(options.seeds):
                out = options.out / name / str(seed)
                again = (out / "checkpoint.pt").is_file()  # goes on where it was interrupted
                trained.append(train(training_of(name, seed, calibration_file(options.out)), out, resume=again))
            policy, judged_policy = trained[0].policy, str(options.out / name)
            policy.save(BASELINES / f"{name}.npz")
        results = judged(name, judged_policy, options.out, tuple(options.compensations))
        write_text(BASELINES / f"{name}.md", card(name, policy, results))
        print(name, {row["compensation"]: (round(row["mean_mm"], 3), row["by_seed"]) for row in results}, flush=True)


if __name__ == "__main__":
    main()
