"""Does a policy carry over to other arms, and can randomised arms replace calibration? Part of `findings.py`.

The policies here have neither memory nor camera; `calibrating_while_picking.py` asks those that have both.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from train_baselines import calibration_file

from pickenv.agents.evaluation.grid import GridSettings, PolicyGrid, run_grid
from pickenv.agents.evaluation.grid_tables import interval_words, with_interval
from pickenv.agents.policies.learned import load_policy
from pickenv.agents.training.training import train
from pickenv.agents.training.training_setup import Training
from pickenv.inspect.colours import policy_label
from pickenv.inspect.figures.style import WIDTH, new_figure
from pickenv.intervals import MARGIN_MM, Estimate, mean_estimate

if TYPE_CHECKING:
    from matplotlib.figure import Figure

TRAININGS: dict[str, dict[str, Any]] = {
    "calibrated": {"compensate": "calibration.npz"},
    "raw": {},
    "randomised": {"arguments": {"arms": "per_episode", "tolerances": "coarse"}},
}
"""Trainings; the first is the shipped baseline's."""
COMPENSATIONS = ("raw", "best")
"""Least squares is left out for its cost."""


def trained_policies(runs: Path, seeds: int, steps: int) -> tuple[str, ...]:
    """Folders of the trainings, one per kind of arm; what is there already is not trained again."""
    for seed in range(seeds):
        for name, given in TRAININGS.items():
            what = dict(given)
            if "compensate" in what:
                what["compensate"] = str(calibration_file(runs))
            out = runs / "transfer" / name / str(seed)
            if not (out / "policy.npz").is_file():
                print(f"training on {name} arms, seed {seed}", flush=True)
                training = Training("ppo", seed=seed, steps=steps, **what)
                train(training, out, resume=(out / "checkpoint.pt").is_file())
    return tuple(str(runs / "transfer" / name) for name in TRAININGS)


def run_transfer(settings: GridSettings, runs: Path, workers: int) -> PolicyGrid:
    """The trained policies and the scripted one on new arms; ``settings`` name the policies."""
    return run_grid(settings, runs / "calibrations", workers=workers)


def differences(grid: PolicyGrid) -> dict[tuple[str, str], Estimate]:
    """By (trained on, compensation): error less that of training on calibrated arms; same seed, arm and fruit."""
    base, *others = TRAININGS
    found = {}
    for name in others:
        for key in grid.settings.compensations:
            one, other = (grid.cell(each, key, "encoders", "qiao2026").errors_mm for each in (base, name))
            found[name, key] = mean_estimate(other - one)
    return found


def transfer_figure(grid: PolicyGrid) -> Figure:
    """The differences with their intervals, and the margin."""
    found = differences(grid)
    with new_figure(WIDTH, 2.4) as figure:
        axes = figure.add_subplot(xlabel="mean error less that of training on calibrated arms (mm)")
        axes.axvspan(-MARGIN_MM, MARGIN_MM, color="0.92", zorder=0, label=f"margin of {MARGIN_MM:g} mm")
        for y, each in enumerate(found.values()):
            whisker(axes, y, each, "0.2")
        axes.set_yticks(range(len(found)), [f"{name} arms, used on {policy_label(key)}" for name, key in found])
        axes.set_ylim(len(found) - 0.5, -0.5)
        figure.legend(loc="outside lower center")
    return figure


def whisker(axes: Any, y: float, found: Estimate, colour: Any, scale: float = 1.0) -> None:
    """A number at height ``y``, and its interval if it has one."""
    if found.ci95 is not None:
        ends = [scale * (found.value if end is None else end) for end in found.ci95]
        axes.plot(ends, [y, y], color=colour, linewidth=3.0, alpha=0.55)
    axes.plot([scale * found.value], [y], "|", color=colour, markersize=8, mew=1.6)


def transfer_sentence(grid: PolicyGrid) -> str:
    """What the figure says."""
    said = [
        f"one trained on {name} arms is {_change(each)} mm from it there ({each.verdict()})"
        for (name, key), each in differences(grid).items()
        if key == COMPENSATIONS[-1]
    ]
    raw = mean_estimate(grid.cell("randomised", "raw", "encoders", "qiao2026").errors_mm)
    best = mean_estimate(grid.cell("calibrated", COMPENSATIONS[-1], "encoders", "qiao2026").errors_mm)
    return (
        f"A policy trained on calibrated arms leaves {_of(best)} mm behind {policy_label(COMPENSATIONS[-1])}; "
        f"{', '.join(said)}; randomised arms without a calibration leave {_of(raw)} mm, all of policies "
        "without memory and camera, whom nothing tells which arm they have: one that "
        "sees and remembers its past picks calibrates its arm by itself: [how](learning.md"
        "#learning-to-calibrate-while-picking)."
    )


def transfer_tables(grid: PolicyGrid, folder: str) -> list[str]:
    """Errors and differences; ``folder`` holds trainings, whose files say how long they were."""
    steps = load_policy(next(Path(folder).glob("*/policy.npz"))).record["steps"]
    cells = list(dict.fromkeys(cell.policy for cell in grid.cells))
    seeds = max(len(cell.rollouts) for cell in grid.cells)
    lines = [
        f"PPO without a camera, {steps} steps, training seeds 0 to {seeds - 1}, on {grid.settings.arms} new arms of "
        f"`qiao2026`, {grid.settings.episodes} fruit each: mean final error (mm), 95 % interval over arms and training "
        "seeds, two crossed factors; least squares is left out for its cost.",
        "",
        "| trained on | " + " | ".join(policy_label(key) for key in grid.settings.compensations) + " |",
        "|---|" + "---|" * len(grid.settings.compensations),
    ]
    for name in cells:
        found = [
            _of(mean_estimate(grid.cell(name, key, "encoders", "qiao2026").errors_mm))
            for key in grid.settings.compensations
        ]
        label = "(scripted, for comparison)" if name == "scripted" else f"{name} arms"
        lines.append(f"| {label} | " + " | ".join(found) + " |")
    lines += [
        "",
        "Difference from training on calibrated arms (mm). It carries over where the whole interval lies within "
        f"{MARGIN_MM:g} mm of zero, differs where the interval leaves out zero, and else is not settled.",
        "",
        "| trained on | used on | difference | verdict |",
        "|---|---|---|---|",
    ]
    for (name, key), each in differences(grid).items():
        lines.append(f"| {name} arms | {policy_label(key)} | {_change(each)} | {each.verdict()} |")
    return [*lines, ""]


def _of(found: Estimate) -> str:
    return with_interval(found.value, found.ci95, 2)


def _change(found: Estimate) -> str:
    ends = interval_words(found.ci95, 3, sign="+")
    return f"{found.value:+.3f}" + (f" ({ends})" if ends else "")
