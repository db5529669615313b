"""What calibration buys a policy: `python scripts/findings.py` runs the studies and writes docs/findings.md.

Simulated arms of tolerance class coarse that nothing was trained on, each with its own calibration; 95 % intervals by
bootstrap over arms and fruit; comparisons on the same arms and fruit. Options: `--quick`, `--out`, `--runs`.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))
sys.path.insert(0, str(Path(__file__).parent))

from findings_day import Day, day_figure, day_section, run_day
from findings_noise import Noise, noise_figure, noise_section, run_noise
from train_baselines import calibration_file

from pickenv.agents.evaluation.calibrated import CalibrationPlan
from pickenv.agents.evaluation.grid import GridSettings, PolicyGrid, run_grid
from pickenv.agents.evaluation.grid_figures import LABELS, aggregate_figure, cycle_figure, success_curves
from pickenv.agents.evaluation.statistics import interval, paired
from pickenv.agents.training.training import train
from pickenv.agents.training.training_setup import Training
from pickenv.envs.shared.task import CONTROL_PERIOD
from pickenv.files import write_text
from pickenv.inspect.figures.style import save_figure

TRAININGS: dict[str, dict[str, Any]] = {
    "calibrated": {"compensate": "calibration.npz"},
    "raw": {},
    "randomised": {"arguments": {"arms": "per_episode", "tolerances": "coarse"}},
}
"""Trainings of the transfer study; the first is the shipped baseline's."""


@dataclass(frozen=True)
class Sizes:
    """How much is run.

    Attributes:
        arms: Arms per plant.
        episodes: Fruits per arm.
        epochs: Epochs of each arm's network.
        seeds: Training seeds of the transfer study.
        picks: Picks of a day.
    """

    arms: int = 8
    episodes: int = 64
    epochs: int = 100
    seeds: int = 3
    picks: int = 96


def settings_of(sizes: Sizes, **changes: Any) -> GridSettings:
    """Settings of a comparison."""
    plan = CalibrationPlan(epochs=sizes.epochs)
    return GridSettings(arms=sizes.arms, episodes=sizes.episodes, protocol=plan, **changes)


def policies_section(grid: PolicyGrid) -> list[str]:
    """The comparison in words and tables."""
    lines = [
        "## What calibration is worth to each policy",
        "",
        f"{grid.settings.arms} arms per plant, {grid.settings.episodes} fruits each; the camera sees the gap with "
        f"{grid.settings.camera_noise_mm:g} mm per axis, the fruit's position is known. Mean final error [mm] and its "
        "95 % interval.",
        "",
        "| plant | policy | feedback | " + " | ".join(LABELS[key] for key in grid.settings.compensations) + " |",
        "|---|---|---|" + "---|" * len(grid.settings.compensations),
    ]
    for key in dict.fromkeys((cell.plant, cell.policy, cell.feedback) for cell in grid.cells):
        found = []
        for compensation in grid.settings.compensations:
            try:
                errors = grid.cell(key[1], compensation, key[2], key[0]).errors_mm
            except KeyError:
                found.append("")
                continue
            low, high = interval(errors, np.random.default_rng(0))
            found.append(f"{errors.mean():.2f} ({low:.2f} to {high:.2f})")
        lines.append(f"| {' | '.join(key)} | " + " | ".join(found) + " |")
    lines += ["", "Paired differences [mm], on the same arms and fruit:", ""]
    lines += ["| plant | policy | feedback | from | to | difference | 95 % | |", "|---|---|---|---|---|---|---|---|"]
    chosen = {("raw", "ls"), ("ls", "ls_bpnn"), ("raw", "ls_bpnn"), ("ls_bpnn", "best")}
    for row in grid.comparisons():
        if (row["from"], row["to"]) in chosen:
            verdict = "significant" if row["significant"] else "not significant"
            lines.append(
                f"| {row['plant']} | {row['policy']} | {row['feedback']} | {LABELS[row['from']]} | "
                f"{LABELS[row['to']]} | "
                f"{row['difference_mm']:+.3f} | {row['ci95'][0]:+.3f} to {row['ci95'][1]:+.3f} | {verdict} |"
            )
    lines += [
        "",
        "Significant means that zero is outside the interval; the intervals are not corrected for their number, "
        "and a few "
        "micrometres in front of a camera, significant or not, are worth nothing to a picker.",
    ]
    lines += ["", "Success by gripper, scripted policy, open loop:", ""]
    lines += ["| plant | gripper | " + " | ".join(LABELS[key] for key in grid.settings.compensations) + " |"]
    lines += ["|---|---|" + "---|" * len(grid.settings.compensations)]
    for plant in grid.settings.plants:
        for name, gripper in grid.grippers.items():
            rates = [
                f"{100 * grid.cell('scripted', key, 'encoders', plant).rollout.capture(gripper).mean():.1f} %"
                for key in grid.settings.compensations
            ]
            lines.append(f"| {plant} | {name} | " + " | ".join(rates) + " |")
    return [
        *lines,
        "",
        "![Aggregates](images/findings-aggregates.png)",
        "",
        "![Success against error](images/findings-success.png)",
        "",
        "![Accuracy against cycle time](images/findings-cycle.png)",
        "",
    ]


def adaptive_section(sizes: Sizes, runs: Path) -> list[str]:
    """The policy that calibrates while it picks."""
    plants, compensations = ("qiao2026", "orchard"), ("raw", "ls")
    settings = settings_of(
        sizes, policies=("adaptive",), feedback=("camera",), plants=plants, compensations=compensations
    )
    grid = run_grid(settings, runs / "calibrations")
    lines = [
        "## Calibrating while picking",
        "",
        "The adaptive policy drives open loop and lets a Kalman filter learn from one look per pick "
        f"({settings.camera_noise_mm:g} mm per axis). Mean error [mm] over all arms, by the number of the pick; "
        f"in this "
        "study every pick on `orchard` starts cold, so there is no drift to follow (see the day below).",
        "",
        "| plant | starting from | first pick | picks 2 to 8 | second half |",
        "|---|---|---|---|---|",
    ]
    for cell in grid.cells:
        errors = cell.errors_mm
        parts = (errors[:, :1], errors[:, 1:8], errors[:, errors.shape[1] // 2 :])
        found = " | ".join(f"{part.mean():.2f}" for part in parts)
        lines.append(f"| {cell.plant} | {LABELS[cell.compensation]} | {found} |")
    return [*lines, ""]


def transfer_section(sizes: Sizes, runs: Path) -> list[str]:
    """Policies trained on raw, calibrated and randomised arms, each on raw and calibrated ones."""
    files: dict[str, list[str]] = {}
    for name, given in TRAININGS.items():
        what, files[name] = dict(given), []
        if "compensate" in what:
            what["compensate"] = str(calibration_file(runs))
        for seed in range(sizes.seeds):
            out = runs / f"transfer-{name}-{seed}"
            if not (out / "policy.npz").is_file():
                train(Training("ppo", seed=seed, **what), out)
            files[name].append(str(out / "policy.npz"))
    every = tuple(file for group in files.values() for file in group)
    compensations = ("raw", "ls", "best")
    settings = settings_of(
        sizes, policies=("scripted", *every), compensations=compensations, feedback=("encoders",), plants=("qiao2026",)
    )
    grid = run_grid(settings, runs / "calibrations")
    cells = {key: [cell for cell in grid.cells if cell.compensation == key] for key in compensations}
    index = {name: i for i, name in enumerate(("scripted", *every))}
    errors = {
        (name, key): np.concatenate([cells[key][index[file]].errors_mm for file in group], axis=1)
        for name, group in ({"scripted": ["scripted"]} | files).items()
        for key in compensations
    }
    lines = [
        "## Does a policy carry over, and can domain randomisation replace calibration?",
        "",
        "PPO without a camera, trained on the raw training arm, on that arm calibrated, or on another arm of "
        f"the class in every episode (domain randomisation); {sizes.seeds} seeds. Then on "
        "new arms of `qiao2026`. Mean final error [mm].",
        "",
        "| trained on | " + " | ".join(LABELS[key] for key in compensations) + " |",
        "|---|" + "---|" * len(compensations),
    ]
    for name in ("scripted", *files):
        found = []
        for key in compensations:
            values = errors[name, key]
            low, high = interval(values, np.random.default_rng(0))
            found.append(f"{values.mean():.2f} ({low:.2f} to {high:.2f})")
        label = "(scripted, for comparison)" if name == "scripted" else f"{name} arms"
        lines.append(f"| {label} | " + " | ".join(found) + " |")
    base = errors["calibrated", "best"]
    verdicts = []
    for name in list(TRAININGS)[1:]:
        # Seeds share their arms, so arms are what is resampled.
        found_ = paired(base, errors[name, "best"], np.random.default_rng(0))
        verdicts.append(
            f"On calibrated arms a policy trained on {name} ones is {found_.difference:+.3f} mm from one trained on "
            f"calibrated arms ({found_.ci95[0]:+.3f} to {found_.ci95[1]:+.3f}, "
            f"{'significant' if found_.significant else 'not significant'})."
        )
    random_raw, calibrated = errors["randomised", "raw"].mean(), errors["calibrated", "best"].mean()
    verdicts.append(
        f"Domain randomisation without a calibration leaves {random_raw:.2f} mm on raw arms, where the scripted policy "
        f"leaves {errors['scripted', 'raw'].mean():.2f} mm; calibration leaves {calibrated:.2f} mm. Without a camera "
        "nothing tells a policy which arm it has: what varies from arm to arm cannot be learnt away, only measured."
    )
    return [*lines, "", *(line for verdict in verdicts for line in (verdict, ""))]


def main() -> None:
    """Run everything and write the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("docs"))
    parser.add_argument("--runs", type=Path, default=Path("runs/findings"))
    parser.add_argument("--quick", action="store_true", help="Small sizes, to see that it runs.")
    options = parser.parse_args()
    sizes = Sizes(arms=3, episodes=6, epochs=10, seeds=1, picks=12) if options.quick else Sizes()
    images = options.out / "images"
    grid = run_grid(
        settings_of(sizes, policies=("scripted", "oracle", "servo", "ppo_encoders", "ppo_camera")),
        options.runs / "calibrations",
    )
    save_figure(aggregate_figure(grid), images / "findings-aggregates.png")
    save_figure(success_curves(grid, "qiao2026"), images / "findings-success.png")
    save_figure(cycle_figure(grid, CONTROL_PERIOD, "qiao2026"), images / "findings-cycle.png")
    print("policies done", flush=True)
    noise: Noise = run_noise(settings_of(sizes), grid)
    save_figure(noise_figure(noise), images / "findings-noise.png")
    print("noise done", flush=True)
    day: Day = run_day(settings_of(sizes), sizes.picks)
    save_figure(day_figure(day), images / "findings-day.png")
    print("day done", flush=True)
    lines = [
        "# Findings: what calibration buys a policy",
        "",
        "Made by `python scripts/findings.py`; simulated arms of tolerance class `coarse` that no policy was "
        "trained on, "
        f"calibrated one by one (100 poses for LS, 200 for what remains; networks of {sizes.epochs} epochs, where the "
        "paper has 500). LS+GP is the residual model that did best.",
        "",
        *policies_section(grid),
        *noise_section(noise),
        *transfer_section(sizes, options.runs),
        *adaptive_section(sizes, options.runs),
        *day_section(day),
    ]
    print(f"wrote {write_text(options.out / 'findings.md', chr(10).join(lines).rstrip() + chr(10))}")


if __name__ == "__main__":
    main()
