"""Compared policies on screens and in files: tables, pages, figures, run folders, all made of rows by `estimate`."""

from __future__ import annotations

import csv
import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import combinations, groupby
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from pickenv.agents.policies.learned import shipped_baselines
from pickenv.container import refusing_damage
from pickenv.envs.shared.situation import CONTROL_PERIOD
from pickenv.errors import InputError
from pickenv.experiments.engine import Progress, Rows, read_piece, write_piece
from pickenv.experiments.methods import CalibrationPlan
from pickenv.experiments.policies import PolicySettings, population_seed, run_picks, run_policies
from pickenv.extras import require
from pickenv.files import write_json, write_whole
from pickenv.inspect.colours import policy_label
from pickenv.inspect.figures import plot_policies
from pickenv.inspect.figures.plot_errors import error_by_method, error_cumulative
from pickenv.inspect.figures.run_drawings import Drawing, Drawings
from pickenv.inspect.reports.plain_report import plain_report
from pickenv.inspect.reports.report_page import PageTable, PageVerdict
from pickenv.inspect.runs.matters import gripper_curves
from pickenv.inspect.runs.run_folder import Run, TakePicture, recorded_run, unedited
from pickenv.intervals import Estimate, estimate, interquartile_estimate
from pickenv.provenance import command_line

EPISODES = "episodes.parquet"
"""An evaluation's episodes in its run folder, a row each."""

ROWS = "rows.json"
"""Its table there, for people and other programs."""

CELL = ("policy", "compensation", "feedback", "plant")
"""What a number is of."""

OVER = ("arm", "training")
"""What its interval is over."""

KEYS = (*CELL, "gripper")

HEADS = ("mean (mm)", "95 % interval (mm)", "median arm (mm)", "95th arm (mm)", "success (%)", "cycle (s)")
"""What stands beside `KEYS`; an interval where the number has none of its own column follows in brackets."""

STATISTICS: Mapping[str, str | float] = {"mean": "mean", "median arm": 0.5, "95th percentile arm": 0.95}


# Evaluations: one row per policy × compensation × feedback × plant × gripper, and pairs.


def evaluation_content(settings: PolicySettings, rows: Rows) -> dict[str, Any]:
    """The table of an evaluation and what each compensation is worth, for JSON."""
    return {"rows": evaluation_rows(settings, rows), "comparisons": compensations_compared(rows)}


def evaluation_rows(settings: PolicySettings, rows: Rows) -> list[dict[str, Any]]:
    """One row per policy × compensation × feedback × plant × gripper."""
    numbers = [_estimates(rows, "error_mm", of) for of in STATISTICS.values()]
    successes = {name: _estimates(rows, f"chance_{name}", "share") for name in settings.grippers}
    table = []
    for key in rows.levels(*CELL):
        cell = rows.where(**dict(zip(CELL, key, strict=True)))
        mean, median, worst = (each[key] for each in numbers)
        inside, learned = np.isfinite(cell["cycle_steps"]), bool(cell["learned"][0])
        trainings = len(cell.levels("training"))
        for name, success in successes.items():
            table.append(
                dict(zip(KEYS, (*key, name), strict=True))
                | {
                    "mean_mm": mean.value,
                    "ci95": mean.ends,
                    "median_arm_mm": median.value,
                    "median_arm_ci95": median.ends,
                    "p95_arm_mm": worst.value,
                    "p95_arm_ci95": worst.ends,
                    "success_rate": success[key].value,
                    "success_ci95": success[key].ends,
                    "no_interval": mean.missing,
                    "interval_over": _interval_over(learned, trainings),
                    "cycle_s": float(np.median(cell["cycle_steps"][inside]) * CONTROL_PERIOD) if inside.any() else None,
                    "within_tolerance": float(inside.mean()),
                    "episodes": len(cell),
                    "arms": len(cell.levels("arm")),
                    "trainings": trainings if learned else None,
                    "seeds": list(settings.seeds),
                    "population_seed": population_seed(settings.seeds[0]),
                    "tolerances": settings.tolerances,
                    "camera_noise_mm": settings.camera_noise_mm if cell["feedback"][0] == "camera" else 0.0,
                    "fruit_noise_mm": settings.fruit_noise_mm,
                }
            )
    return table


def _estimates(rows: Rows, value: str, of: str | float) -> dict[tuple[Any, ...], Estimate]:
    """An estimate of each cell."""
    lines = estimate(rows.columns, value, by=CELL, over=OVER, of=of)
    return {tuple(line[name] for name in CELL): line["estimate"] for line in lines}


def _grippers(rows: Rows) -> tuple[str, ...]:
    return tuple(name.removeprefix("chance_") for name in rows.columns if name.startswith("chance_"))


def _interval_over(learned: bool, trainings: int) -> str:
    """What another draw of the intervals' data would have anew."""
    if not learned:
        return "arms"
    return "arms, of this one training" if trainings == 1 else f"arms and {trainings} trainings"


def compensations_compared(rows: Rows) -> list[dict[str, Any]]:
    """Every compensation against each before it, pair by pair."""
    steps = [compensation for (compensation,) in rows.levels("compensation")]
    pairs = {}
    for number, one in enumerate(steps):
        later = rows.where(compensation=tuple(steps[number:]))
        for line in estimate(later.columns, "error_mm", by=CELL, over=OVER, against={"compensation": one}):
            pairs[line["policy"], line["feedback"], line["plant"], one, line["compensation"]] = line["estimate"]
    names = ("policy", "feedback", "plant")
    return [
        dict(zip((*names, "from", "to"), (*key, one, other), strict=True))
        | {"difference_mm": difference.value, "ci95": difference.ends}
        | {"significant": difference.significant, "no_interval": difference.missing}
        for key in rows.levels(*names)
        for one, other in combinations(steps, 2)
        if (difference := pairs.get((*key, one, other))) is not None
    ]


def cells_of(row: Mapping[str, Any]) -> list[str]:
    """What people are shown of a row: `KEYS` and `HEADS`."""
    trained = {None: "", 1: " (one training)"}.get(row["trainings"], f" ({row['trainings']} trainings)")
    return [
        f"{row['policy']}{trained}",
        *(row[key] for key in KEYS[1:]),
        f"{row['mean_mm']:.3f}",
        interval_words(row["ci95"], 3) or f"none: {row['no_interval']}",
        with_interval(row["median_arm_mm"], row["median_arm_ci95"], 3),
        with_interval(row["p95_arm_mm"], row["p95_arm_ci95"], 3),
        with_interval(row["success_rate"], row["success_ci95"], 1, 100.0),
        "never" if row["cycle_s"] is None else f"{row['cycle_s']:.1f}",
    ]


def gain_words(line: Mapping[str, Any]) -> tuple[str, str, str]:
    """A comparison's difference, its interval, and whether it is significant."""
    ends = interval_words(line["ci95"], 3, sign="+") or f"none: {line['no_interval']}"
    return f"{line['difference_mm']:+.3f}", ends, {True: "yes", False: "no", None: "not known"}[line["significant"]]


def interval_words(ends: Sequence[float | None] | None, digits: int, scale: float = 1.0, sign: str = "") -> str:
    """An interval: 0.12 to 0.34; an end that the arms cannot bound is open; empty where there is no interval."""
    if ends is None:
        return ""
    return " to ".join("open" if end is None else f"{scale * end:{sign}.{digits}f}" for end in ends)


def with_interval(
    value: float, ends: Sequence[float | None] | None, digits: int, scale: float = 1.0, unit: str = ""
) -> str:
    """A number with its interval in brackets, if it has one: 0.23 (0.12 to 0.34)."""
    words = interval_words(ends, digits, scale)
    return f"{scale * value:.{digits}f}{unit}" + (f" ({words})" if words else "")


# Files: CSV, Parquet, run folders.


def write_rows(path: Path, rows: Sequence[dict[str, Any]]) -> Path:
    """Write an evaluation's table as .csv or .parquet, whole or not at all; intervals get columns of their own.

    Raises:
        InputError: If the suffix is another.
    """
    flat = [_flat(row) for row in rows]
    if path.suffix == ".csv":

        def write(temporary: Path) -> None:
            with temporary.open("w", newline="", encoding="utf-8") as file:
                writer = csv.DictWriter(file, list(flat[0]) if flat else [])
                writer.writeheader()
                writer.writerows(flat)

        return write_whole(path, write)
    if path.suffix != ".parquet":
        raise InputError(f"cannot write {path}: give a file name that ends in .csv or .parquet")
    require("pyarrow")
    import pyarrow as pa
    import pyarrow.parquet as pq

    return write_whole(path, lambda temporary: pq.write_table(pa.Table.from_pylist(flat), temporary))


def _flat(row: Mapping[str, Any]) -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for key, value in row.items():
        if key == "seeds":
            flat[key] = " ".join(map(str, value))
        elif key.endswith("ci95"):
            flat[f"{key}_low"], flat[f"{key}_high"] = value or (None, None)
        else:
            flat[key] = value
    return flat


def write_evaluation(settings: PolicySettings, rows: Rows, folder: Path) -> list[Path]:
    """Write the run folder of an evaluation: every episode, and the table as JSON."""
    command = command_line(
        "pickenv",
        "evaluate",
        policy=settings.policies,
        compensation=settings.compensations,
        feedback=settings.feedback,
        plant=settings.plants,
        gripper=settings.grippers,
        arms=settings.arms,
        episodes=settings.episodes,
        tolerances=settings.tolerances,
        camera_noise=f"{settings.camera_noise_mm:g}",
        fruit_noise=f"{settings.fruit_noise_mm:g}",
        epochs=settings.plan.epochs,
        seed=settings.seeds[0],
    )
    with recorded_run(folder, "evaluation", command, settings.seeds[0]):
        write_piece(folder / EPISODES, rows, "evaluation", command)
        return [folder / EPISODES, write_json(folder / ROWS, evaluation_content(settings, rows))]


def read_episodes(run: Run) -> Rows:
    """The episodes of an evaluation, to the bit; raises `InputError` if they were edited or exchanged."""
    return read_piece(unedited(run, EPISODES), run.command)


# The page and the figures of an evaluation's run folder.


def page(run: Run, picture: TakePicture | None = None) -> str:
    """The page of an evaluation: what each compensation is worth, every cell with its interval, figures."""
    path = unedited(run, ROWS)
    with refusing_damage(path, "an evaluation's table", f"`{run.made_by}` makes it anew"):
        content = json.loads(path.read_text(encoding="utf-8"))
        rows, worth = content["rows"], content["comparisons"]
    first, best = rows[0], min(rows, key=lambda row: row["mean_mm"])
    raw = [line for line in worth if line["from"] == "raw"]
    helped = [line for line in raw if line["significant"] and line["difference_mm"] < 0.0]
    ends = interval_words(best["ci95"], 3)
    evidence = f"95 % interval over {best['interval_over']}: {ends}" if ends else f"no interval: {best['no_interval']}"
    verdict = PageVerdict(
        "note",
        f"Best: {best['policy']} with {policy_label(best['compensation'])}, {best['mean_mm']:.2f} mm",
        f"{best['policy']} with {best['feedback']} and {policy_label(best['compensation'])} on {best['plant']} ends "
        f"{best['mean_mm']:.3f} mm from the fruit in the mean ({evidence}). "
        f"Of {len(raw)} comparisons of a calibration with the raw arm, {len(helped)} show a gain that is significant.",
    )
    tables = (
        PageTable(
            f"Final position errors; {first['episodes'] // (first['trainings'] or 1)} reaches on {first['arms']} arms, "
            "the same for all. Mean, median and 95th percentile are over arms, in brackets and beside the mean 95 % "
            "intervals; those of one training say nothing of another one",
            ("policy", "calibration", *KEYS[2:], *HEADS),
            [cells_of(row | {"compensation": policy_label(row["compensation"])}) for row in rows],
        ),
        PageTable(
            "What each calibration changes on the same arms and fruit, pair by pair; 95 % intervals over arms, and "
            "over trainings where there are several",
            ("policy", "feedback", "plant", "from", "to", "difference (mm)", "95 % (mm)", "significant"),
            [
                (
                    *(line["policy"], line["feedback"], line["plant"]),
                    *(policy_label(line[name]) for name in ("from", "to")),
                    *gain_words(line),
                )
                for line in worth
            ],
        ),
    )
    subtitle = (
        f"Simulated; arms of tolerance class {first['tolerances']} that no policy was trained on, seed {run.seed}"
    )
    return plain_report(run, "Comparison of policies", subtitle, verdict, tables, drawings(run))


def drawings(run: Run) -> Drawings:
    """The figures of an evaluation's run folder."""
    return evaluation_drawings(read_episodes(run))


def evaluation_drawings(rows: Rows) -> Drawings:
    """Every figure of an evaluation."""
    figures = [
        Drawing(
            "aggregates",
            "Final position errors of every policy over arms, with 95 % intervals; an arrow is an open end.",
            partial(aggregate_figure, rows),
        )
    ]
    for (plant,) in rows.levels("plant"):
        name, there = Path(plant).stem, rows.where(plant=plant)
        figures.append(
            Drawing(
                f"accuracy_against_cycle_time_{name}",
                f"Mean position error on {plant} if the pick were made after each step.",
                partial(cycle_figure, there, plant),
            )
        )
        scripted = there.where(policy="scripted")
        errors = {
            policy_label(c): scripted.where(compensation=c)["error_mm"] for (c,) in scripted.levels("compensation")
        }
        if errors:
            figures += [
                Drawing(
                    f"success_against_misalignment_{name}",
                    f"What each gripper forgives, and where the scripted policy on {plant} lies on its curve.",
                    partial(success_curves, rows, plant),
                ),
                Drawing(
                    f"error_by_compensation_{name}",
                    f"Final position errors of the scripted policy on {plant}.",
                    partial(error_by_method, errors, counted="reaches"),
                ),
                Drawing(
                    f"error_cumulative_{name}",
                    f"Share of the scripted policy's reaches on {plant} whose error is at most x.",
                    partial(error_cumulative, errors, counted="reaches"),
                ),
            ]
    return figures


def aggregate_figure(rows: Rows) -> Figure:
    """Mean, median and 95th percentile over arms of every cell with 95 % intervals, one panel row per plant."""
    panels: dict[str, dict[str, dict[str, dict[str, plot_policies.Estimated]]]] = {}
    for title, of in STATISTICS.items():
        for (policy, compensation, feedback, plant), number in _estimates(rows, "error_mm", of).items():
            policies = panels.setdefault(plant, {}).setdefault(title, {})
            behind = policies.setdefault(f"{policy}\n{feedback}", {})
            behind[policy_label(compensation)] = (number.value, number.ci95)
    return plot_policies.aggregates(panels)


def success_curves(rows: Rows, plant: str) -> Figure:
    """Success against lateral error for each gripper, and where the scripted policy lies on it, with its interval."""
    scripted = rows.where(policy="scripted", plant=plant)
    errors = _estimates(scripted, "error_mm", "mean")
    grippers = _grippers(rows)
    points: dict[str, dict[str, tuple[float, plot_policies.Estimated]]] = {}
    for name in grippers:
        for key, success in _estimates(scripted, f"chance_{name}", "share").items():
            place = (errors[key].value, (success.value, success.ci95))
            points.setdefault(policy_label(key[1]), {})[name] = place
    return plot_policies.success_against_misalignment(gripper_curves(grippers), points)


def cycle_figure(rows: Rows, plant: str) -> Figure:
    """Accuracy against cycle time: mean error if the pick were made after each step, and the Pareto front of all.

    Policies with a camera are shown on raw arms only, for there all compensations look alike.
    """
    curves = []
    for policy, compensation, feedback, _ in rows.where(plant=plant).levels(*CELL):
        if policy != "random" and (feedback != "camera" or compensation == "raw"):
            cell = rows.where(policy=policy, compensation=compensation, feedback=feedback, plant=plant)
            way = cell["way_mm"].mean(axis=0)
            curves.append(plot_policies.CycleCurve(policy, policy_label(compensation), way[np.isfinite(way)]))
    return plot_policies.accuracy_against_cycle_time(curves, CONTROL_PERIOD, title=plant)


# The leaderboard: interquartile means over the arms of several seeds (Agarwal et al. 2021), a table for each task.

LEAST_SEEDS = 5
"""Fewest seeds of a leaderboard."""

LEADERBOARD = PolicySettings(
    policies=("scripted", "servo", "adaptive", *shipped_baselines()),
    plants=("qiao2026", "field"),
    arms=2,
    episodes=16,
    seeds=tuple(range(LEAST_SEEDS)),
    canopies=2,
)
QUICK = replace(
    LEADERBOARD,
    policies=("scripted", "servo", "ppo_encoders"),
    plants=("qiao2026",),
    arms=1,
    episodes=4,
    plan=CalibrationPlan(epochs=20),
    canopies=0,
)
"""Minutes less, to try things out."""

WORDS = ("policy", "feedback", "compensation")


def run_leaderboard(
    settings: PolicySettings,
    folder: Path,
    *,
    backend: str = "serial",
    workers: int | None = None,
    progress: Progress | None = None,
) -> list[dict[str, Any]]:
    """Run what was not run yet, and give the rows of all tasks; arguments as of `run_policies`.

    Raises:
        InputError: If there are too few seeds, or as `run_policies` does.
    """
    if len(set(settings.seeds)) < max(LEAST_SEEDS, len(settings.seeds)):
        raise InputError(f"seeds are {list(settings.seeds)}; give at least {LEAST_SEEDS}, each once")
    rows = reaching_rows(run_policies(settings, folder, backend=backend, workers=workers, progress=progress))
    if settings.canopies:
        rows += picking_rows(run_picks(settings, folder, backend=backend, workers=workers, progress=progress))
    return rows


def reaching_rows(rows: Rows) -> list[dict[str, Any]]:
    """One row per task, policy, feedback and compensation, over all seeds; best interquartile mean of a task first."""
    names, grippers = ("plant", *WORDS), _grippers(rows)
    table = []
    for line in estimate(rows.columns, "error_mm", by=names, over=("arm",), of="interquartile"):
        cell = rows.where(**{name: line[name] for name in names})
        success = {name: float(cell[f"chance_{name}"].mean()) for name in grippers}
        arms = len(cell.levels("arm"))
        numbers = {"arms": arms, "fruit_per_arm": len(cell.levels("arm", "episode")) // arms}
        means = float(cell["error_mm"].mean()), float(cell["attitude_deg"].mean())
        table.append(_board_row("Reach-v0", cell, means, line["estimate"], success, {}, numbers))
    return sorted(table, key=lambda row: (row["task"], row["iqm_mm"], *(row[word] for word in WORDS)))


def picking_rows(rows: Rows) -> list[dict[str, Any]]:
    """One row per picker and compensation, best picks per hour with the first gripper first."""
    rates = estimate(rows.columns, "picks_per_hour", by=("policy", "compensation", "gripper"), over=("arm",))
    table = []
    for policy, compensation in rows.levels("policy", "compensation"):
        cell = rows.where(policy=policy, compensation=compensation)
        arms = np.unique(cell["arm"], return_inverse=True)[1]
        grasps, error = (np.bincount(arms, cell[name]) for name in ("attempted", "error_sum_mm"))
        errors = error[grasps > 0.0] / grasps[grasps > 0.0]
        success = {
            name: float(own["collected"].sum() / max(1, own["attempted"].sum()))
            for (name,) in cell.levels("gripper")
            for own in [cell.where(gripper=name)]
        }
        own_rates = {
            line["gripper"]: line["estimate"]
            for line in rates
            if (line["policy"], line["compensation"]) == (policy, compensation)
        }
        per_hour = {
            "picks_per_hour": {name: rate.value for name, rate in own_rates.items()},
            "picks_per_hour_ci95": {name: rate.ends for name, rate in own_rates.items()},
        }
        numbers = {"arms": len(grasps), "attempts": int(grasps.sum())}
        means = float(errors.mean()), float(cell["tilt_sum_deg"].sum() / grasps.sum())
        middle = interquartile_estimate(errors)
        table.append(_board_row("Pick-v0", cell, means, middle, success, per_hour, numbers))
    return sorted(table, key=lambda row: -next(iter(row["picks_per_hour"].values())))


def _board_row(
    task: str,
    cell: Rows,
    means: tuple[float, float],
    middle: Estimate,
    success: Mapping[str, float],
    further: Mapping[str, Any],
    numbers: Mapping[str, int],
) -> dict[str, Any]:
    """A row of the leaderboard; ``means`` are of error and attitude."""
    return {
        "task": f"pickenv/{task}, {cell['plant'][0]}",
        "policy": str(cell["policy"][0]),
        "feedback": str(cell["feedback"][0]) if "feedback" in cell.columns else "encoders",
        "compensation": str(cell["compensation"][0]),
        "mean_mm": means[0],
        "iqm_mm": middle.value,
        "attitude_deg": means[1],
        "success": next(iter(success.values())),
        "success_by_gripper": success,
        "ci95_mm": middle.ends,
        **further,
        "seeds": sorted(seed for (seed,) in cell.levels("seed")),
        **numbers,
    }


def leaderboard_heads(row: Mapping[str, Any]) -> list[str]:
    """Heads of the table that a row belongs to: `WORDS`, then numbers."""
    rates = [f"picks per hour, {name}" for name in row.get("picks_per_hour", {})]
    success = (f"success, {name}" for name in row["success_by_gripper"])
    mean = "mean (mm) at the grasp" if rates else "mean (mm)"
    return [*WORDS, mean, "interquartile mean (mm)", "attitude (deg)", *success, *rates]


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
        *(f"{100 * share:.0f} %" for share in row["success_by_gripper"].values()),
        *(with_interval(rate, ends[name], 0) for name, rate in rates.items()),
    ]


def leaderboard_tables(rows: Sequence[Mapping[str, Any]]) -> str:
    """The tables in Markdown, one per task."""
    parts = []
    for task, group in groupby(rows, lambda row: row["task"]):
        table = list(group)
        first, heads = table[0], leaderboard_heads(table[0])
        each_arm = f"{first['fruit_per_arm']} fruit each" if "fruit_per_arm" in first else f"{first['attempts']} grasps"
        lines = [
            " | ".join(heads),
            "|".join(["---"] * len(heads)),
            *(" | ".join(leaderboard_cells(row)) for row in table),
        ]
        parts += [
            f"{task}: {first['arms']} arms over seeds {', '.join(map(str, first['seeds']))}, {each_arm}",
            "",
            *(f"| {line} |" for line in lines),
            "",
        ]
    return "\n".join(parts)
