"""What calibration buys a policy: `python scripts/policies/findings.py` runs the studies and writes docs/findings.md.

Simulated arms of tolerance class coarse that nothing was trained on, each with its own calibration. 95 % intervals over
arms, and over training seeds where a policy was trained several times (`pickenv.intervals`). What an earlier run
left in `--runs` (calibrations, trainings) is not made again. `findings_seeds.py` beside it asks other seeds.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2]))
sys.path.insert(0, str(Path(__file__).parent))

from findings_day import day_figure, day_sentence, day_tables, run_day
from findings_noise import SWEPT, noise_figure, noise_sentence, noise_tables, run_noise
from findings_reality import IDEAL_ON, reality_figure, reality_sentence, reality_tables
from findings_transfer import (
    COMPENSATIONS,
    run_transfer,
    trained_policies,
    transfer_figure,
    transfer_sentence,
    transfer_tables,
)

from pickenv.agents.evaluation import calibrated
from pickenv.agents.evaluation.grid import GridSettings, PolicyGrid, run_grid
from pickenv.agents.evaluation.grid_figures import aggregate_figure, success_curves
from pickenv.agents.evaluation.grid_tables import gain_words, interval_words, with_interval
from pickenv.arm.kinematics.geometry import Array
from pickenv.files import write_text
from pickenv.inspect.colours import policy_colours, policy_label
from pickenv.inspect.figures.style import LINES, WIDTH, new_figure, plain_decades, rgb, save_figure
from pickenv.intervals import Estimate, mean_estimate, quantile_estimate, share_estimate

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SECTIONS = ("policies", "reality", "noise", "adaptive", "day", "transfer")
POLICIES = ("scripted", "oracle", "servo", "ppo_encoders", "ppo_camera")
MODELS = ("raw", "ls", "ls_bpnn", "best")
PLANTS = {"qiao2026": MODELS, "field": MODELS, "orchard": ("raw", "ls")}
"""Compensations by plant; on `orchard`, where drift is what is left, residual models are left out."""
ADAPTIVE = {"qiao2026": ("raw",), "field": ("raw",), "orchard": ("raw", "ls")}
"""Where the adaptive policy starts; behind least squares it has little to learn but on `orchard`."""


@dataclass(frozen=True)
class Sizes:
    """How much is run.

    Attributes:
        arms: Arms per plant.
        episodes: Fruits per arm.
        epochs: Epochs of each arm's network.
        trainings: Training seeds of the transfer study.
        steps: Environment steps of each of its trainings; the tuned number, 250 000, takes 2.5 times as long.
        picks: Picks of a day.
    """

    arms: int = 64
    episodes: int = 32
    epochs: int = 100
    trainings: int = 5
    steps: int = 100_000
    picks: int = 96


@dataclass(frozen=True, eq=False)
class Finding:
    """One section of the page.

    Attributes:
        title: Heading.
        sentence: What was found.
        image: Name of its figure.
        figure: The figure.
        tables: For the appendix.
    """

    title: str
    sentence: str
    image: str
    figure: Figure
    tables: list[str]


def settings_of(sizes: Sizes, seed: int = 0, **changes: Any) -> GridSettings:
    """Settings of a comparison."""
    plan = calibrated.CalibrationPlan(epochs=sizes.epochs, seed=seed)
    return GridSettings(arms=sizes.arms, episodes=sizes.episodes, seed=seed, protocol=plan, **changes)


def run_policies(sizes: Sizes, runs: Path, workers: int) -> PolicyGrid:
    """Every policy on every plant."""
    return by_plant(PLANTS, sizes, runs, workers, policies=POLICIES)


def by_plant(
    plants: Mapping[str, tuple[str, ...]], sizes: Sizes, runs: Path, workers: int, seed: int = 0, **what: Any
) -> PolicyGrid:
    """One comparison of plants that have compensations of their own."""
    grids = [
        run_grid(settings_of(sizes, seed, plants=(plant,), compensations=keys, **what), runs, workers=workers)
        for plant, keys in plants.items()
    ]
    settings = replace(grids[0].settings, plants=tuple(plants), compensations=MODELS)
    return PolicyGrid(settings, tuple(cell for grid in grids for cell in grid.cells), grids[0].grippers)


def run_ideal(sizes: Sizes, runs: Path, seed: int = 0) -> PolicyGrid:
    """Least squares from the ideal instrument, scripted policy."""
    settings = settings_of(
        sizes, seed, policies=("scripted",), feedback=("encoders",), plants=IDEAL_ON, compensations=("ls",)
    )
    return run_grid(replace(settings, protocol=replace(settings.protocol, instrument="ideal")), runs)


def policies_findings(grid: PolicyGrid) -> list[Finding]:
    """What calibration is worth to each policy, and to grippers."""
    means, servo = {}, {}
    for plant in ("qiao2026", "field"):
        errors = {key: grid.cell("scripted", key, "encoders", plant).errors_mm for key in PLANTS[plant]}
        means[plant] = ", ".join(f"{policy_label(key)} {_of(mean_estimate(each))}" for key, each in errors.items())
        servo[plant] = _of(mean_estimate(grid.cell("servo", "raw", "camera", plant).errors_mm))
    first = (
        f"The scripted policy, blind, ends this far from the fruit (mean over {grid.settings.arms} arms, mm): on "
        f"`qiao2026` {means['qiao2026']}; on `field` {means['field']}; a servo with a camera of 1 mm per axis leaves "
        f"{servo['qiao2026']} on raw arms of `qiao2026` and {servo['field']} on those of `field`."
    )
    taken = {
        (plant, key): grid.cell("scripted", key, "encoders", plant).chances(grid.grippers["li_cup"])
        for plant in PLANTS
        for key in ("raw", "ls")
    }
    change = mean_estimate(taken["orchard", "ls"] - taken["orchard", "raw"])
    rates = {where: with_interval(found.value, found.ci95, 1, 100.0, " %") for where, found in _shares(taken).items()}
    second = (
        f"On `qiao2026` Li's cup takes {rates['qiao2026', 'raw']} of the fruit from the raw arm, blind, and "
        f"{rates['qiao2026', 'ls']} behind least squares; on `orchard`, which also drifts, {rates['orchard', 'raw']} "
        "and "
        f"{rates['orchard', 'ls']}, a change on the same arms and fruit of {100 * change.value:+.1f} "
        f"({interval_words(change.ci95, 1, 100.0, '+') or change.missing}) points."
    )
    return [
        Finding(
            "What calibration is worth to each policy", first, "aggregates", aggregate_figure(grid), error_tables(grid)
        ),
        Finding("Whether it changes a pick", second, "success", success_curves(grid, "orchard"), success_table(grid)),
    ]


def _shares(taken: Mapping[tuple[str, str], Array]) -> dict[tuple[str, str], Estimate]:
    return {where: share_estimate(chances) for where, chances in taken.items()}


def error_tables(grid: PolicyGrid) -> list[str]:
    """Mean, median and 95th percentile over arms of every cell, and the paired differences."""
    lines = [
        f"Final position errors of {grid.settings.arms} arms per plant, {grid.settings.episodes} fruit each (mm); 95 % "
        "intervals over arms, an open end where so many arms bound none; those of ppo_encoders and ppo_camera are of "
        "one "
        "training each.",
        "",
        "| plant | policy | feedback | calibration | mean | median arm | 95th percentile arm | largest reach |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for cell in grid.cells:
        numbers = mean_estimate(cell.errors_mm), *(quantile_estimate(cell.errors_mm, p) for p in (0.5, 0.95))
        lines.append(
            f"| {cell.plant} | {cell.policy} | {cell.feedback} | {policy_label(cell.compensation)} | "
            f"{' | '.join(map(_of, numbers))} | {cell.errors_mm.max():.1f} |"
        )
    lines += ["", "Paired differences (mm), on the same arms and fruit, open loop:", ""]
    lines += ["| plant | policy | from | to | difference | 95 % | significant |", "|---|---|---|---|---|---|---|"]
    for row in grid.comparisons():
        if row["feedback"] == "encoders":
            labels = f"{policy_label(row['from'])} | {policy_label(row['to'])}"
            lines.append(f"| {row['plant']} | {row['policy']} | {labels} | {' | '.join(gain_words(row))} |")
    return [*lines, "", "The intervals are not corrected for their number.", ""]


def success_table(grid: PolicyGrid) -> list[str]:
    """Success by gripper with intervals."""
    keys = calibrated.COMPENSATIONS
    lines = [
        "Success by gripper, scripted policy, open loop: the chance that the gripper's model gives, 95 % intervals "
        "over arms.",
        "",
    ]
    lines += [
        f"| plant | gripper | {' | '.join(policy_label(key) for key in keys)} |",
        "|---|---|" + "---|" * len(keys),
    ]
    for plant, known in PLANTS.items():
        for name, gripper in grid.grippers.items():
            rates = []
            for key in keys:
                if key not in known:
                    rates.append("")
                    continue
                found = share_estimate(grid.cell("scripted", key, "encoders", plant).chances(gripper))
                rates.append(with_interval(found.value, found.ci95, 1, 100.0, " %"))
            lines.append(f"| {plant} | {name} | {' | '.join(rates)} |")
    return [*lines, ""]


def run_adaptive(sizes: Sizes, runs: Path, seed: int = 0) -> PolicyGrid:
    """The policy that calibrates while it picks."""
    return by_plant(ADAPTIVE, sizes, runs, 1, seed, policies=("adaptive",), feedback=("camera",))


def adapted(grid: PolicyGrid, plant: str) -> dict[str, Estimate]:
    """From raw arms of a plant: the first pick, the second half of the picks, and the change, mm."""
    errors = grid.cell("adaptive", "raw", "camera", plant).errors_mm
    later = errors[:, :, grid.settings.episodes // 2 :]
    change = later.mean(axis=2, keepdims=True) - errors[:, :, :1]
    return {
        "first pick": mean_estimate(errors[:, :, :1]),
        "second half": mean_estimate(later),
        "change": mean_estimate(change),
    }


def adaptive_finding(grid: PolicyGrid) -> Finding:
    """By the number of the pick."""
    settings = grid.settings
    half = settings.episodes // 2
    parts = {"first pick": slice(1), "picks 2 to 8": slice(1, 8), "second half": slice(half, None)}
    lines = [
        "The adaptive policy drives open loop, and a Kalman filter learns from one look per pick (1 mm per axis); "
        f"{settings.arms} arms, {settings.episodes} picks each. Every pick on `orchard` starts cold, so there is no "
        "drift "
        "to follow (see the day). Mean error (mm), 95 % interval over arms.",
        "",
        "| plant | starting from | " + " | ".join(parts) + " | largest |",
        "|---|---|" + "---|" * (len(parts) + 1),
    ]
    colours = dict(zip(MODELS, rgb(policy_colours(list(MODELS))), strict=True))
    lines_of = dict(zip(ADAPTIVE, LINES, strict=False))
    with new_figure(WIDTH, 3.0) as figure:
        axes = figure.add_subplot(
            xlabel="pick (number)", xlim=(1, settings.episodes), ylabel="mean position error (mm)", yscale="log"
        )
        for cell in grid.cells:
            errors = cell.errors_mm
            means = [_of(mean_estimate(errors[:, :, part])) for part in parts.values()]
            lines.append(
                f"| {cell.plant} | {policy_label(cell.compensation)} | {' | '.join(means)} | {errors.max():.1f} |"
            )
            axes.plot(
                np.arange(1, settings.episodes + 1),
                errors.mean(axis=(0, 1)),
                linestyle=lines_of[cell.plant],
                color=colours[cell.compensation],
                label=f"{cell.plant}, from {policy_label(cell.compensation)}",
            )
        plain_decades(axes.yaxis)
        figure.legend(loc="outside right center")
    said = []
    for plant in ADAPTIVE:
        found = adapted(grid, plant)
        gain = found["change"]
        said.append(
            f"on `{plant}` at {_of(found['first pick'])} mm and leaves {_of(found['second half'])} mm, "
            f"a change of {gain.value:+.2f} ({interval_words(gain.ci95, 2, sign='+') or gain.missing}) mm"
        )
    sentence = (
        "From raw arms, and with what it leaves in the second half of "
        f"{settings.episodes} picks, the adaptive policy starts {'; '.join(said)}."
    )
    return Finding("Calibrating while picking", sentence, "adaptive", figure, [*lines, ""])


def _of(found: Estimate) -> str:
    return with_interval(found.value, found.ci95, 2)


def page_lines(findings: list[Finding], sizes: Sizes) -> list[str]:
    """The page: one figure and one sentence each, then the tables."""
    lines = [
        "# Findings: what calibration buys a policy",
        "",
        "Made by `python scripts/policies/findings.py`; simulated arms of tolerance class `coarse` that no policy was "
        "trained on, calibrated one by one (100 poses for LS, 200 for what remains; networks of "
        f"{sizes.epochs} epochs, where the paper has 500) by a laser tracker that measures them in time. `qiao2026` is "
        "smooth, `field` leaves after least squares what measured arms leave, and `orchard` also drifts. Arms, fruit, "
        "pictures and calibrations come from seed 0. 95 % intervals are over arms, and over training seeds where a "
        "policy was trained several times; [other seeds](findings-seeds.md) say the same.",
        "",
    ]
    for each in findings:
        lines += [f"## {each.title}", "", each.sentence, "", f"![{each.title}](images/findings-{each.image}.png)", ""]
    lines += ["## Appendix: tables", ""]
    for each in findings:
        lines += [f"## {each.title}: numbers", "", *each.tables]
    return lines


def main() -> None:
    """Run everything and write the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("docs"))
    parser.add_argument("--runs", type=Path, default=Path("runs/findings"))
    parser.add_argument("--quick", action="store_true", help="Small sizes, to see that it runs.")
    parser.add_argument("--steps", type=int, default=Sizes().steps, help="Steps of each training.")
    parser.add_argument("--without", choices=SECTIONS, nargs="*", default=[], help="Sections to leave out.")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1, help="Processes that fit residual models.")
    options = parser.parse_args()
    sizes = Sizes(steps=options.steps)
    if options.quick:
        sizes = Sizes(arms=10, episodes=4, epochs=10, trainings=5, steps=3840, picks=12)
    calibrations = options.runs / "calibrations"
    findings: list[Finding] = []
    wanted = [name for name in SECTIONS if name not in options.without]
    grid = (
        run_policies(sizes, calibrations, options.workers) if {"policies", "reality", "noise"} & set(wanted) else None
    )
    for name in wanted:
        print(f"{name} ...", flush=True)
        if name == "policies" and grid is not None:
            findings += policies_findings(grid)
        elif name == "reality" and grid is not None:
            ideal = run_ideal(sizes, calibrations)
            title = "What changes when the simulation is as hard as reality"
            said = reality_sentence(grid, ideal)
            findings.append(Finding(title, said, "reality", reality_figure(grid, ideal), reality_tables(grid, ideal)))
        elif name == "noise" and grid is not None:
            noise = [run_noise(settings_of(sizes), grid, plant, gains) for plant, gains in SWEPT.items()]
            title = "Open loop calibrated against closed loop raw"
            findings.append(Finding(title, noise_sentence(noise), "noise", noise_figure(noise), noise_tables(noise)))
        elif name == "adaptive":
            findings.append(adaptive_finding(run_adaptive(sizes, calibrations)))
        elif name == "day":
            day = run_day(settings_of(sizes), sizes.picks)
            findings.append(Finding("A day in the orchard", day_sentence(day), "day", day_figure(day), day_tables(day)))
        elif name == "transfer":
            folders = trained_policies(options.runs, sizes.trainings, sizes.steps)
            settings = settings_of(
                sizes,
                policies=("scripted", *folders),
                compensations=COMPENSATIONS,
                feedback=("encoders",),
                plants=("qiao2026",),
            )
            carried = run_transfer(settings, options.runs, options.workers)
            title = "Does a policy carry over, and can randomised arms replace calibration without a memory?"
            tables = transfer_tables(carried, folders[0])
            findings.append(Finding(title, transfer_sentence(carried), "transfer", transfer_figure(carried), tables))
    for each in findings:
        save_figure(each.figure, options.out / "images" / f"findings-{each.image}.png")
    text = "\n".join(page_lines(findings, sizes)).rstrip() + "\n"
    print(f"wrote {write_text(options.out / 'findings.md', text)}")


if __name__ == "__main__":
    main()
