"""Tables, pages, figures and run folders of compared policies, all made from rows by `estimate`."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import combinations, groupby
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from pickenv.agents import shipped_baselines
from pickenv.base import (
    Estimate,
    InputError,
    command_line,
    estimate,
    interquartile_estimate,
    refusing_damage,
    write_json,
)
from pickenv.envs.shared.difficulty import LADDER
from pickenv.envs.shared.situation import CONTROL_PERIOD
from pickenv.experiments.engine import Rows, interval_words, read_piece, with_interval, write_piece
from pickenv.experiments.methods import CalibrationPlan
from pickenv.experiments.policies import RUNG, PolicySettings, population_seed, run_policies
from pickenv.inspect import Run
from pickenv.inspect.colours import policy_label
from pickenv.inspect.figures import plot_policies
from pickenv.inspect.figures.plot_errors import error_by_method, error_cumulative
from pickenv.inspect.figures.run_drawings import Drawing, Drawings
from pickenv.inspect.reports.report_page import PageTable, PageVerdict, plain_report
from pickenv.inspect.runs.matters import gripper_curves
from pickenv.inspect.runs.run_folder import TakePicture, recorded_run, unedited

EPISODES = "episodes.parquet"
"""File in an evaluation's run folder that holds its episodes, one row each."""

ROWS = "rows.json"
"""File in an evaluation's run folder that holds its table, for people and other programs."""

CELL = ("policy", "compensation", "feedback", "plant")
"""Columns whose levels say what a number of the table belongs to."""

KEYS = (*CELL, "gripper")

HEADS = ("mean (mm)", "95 % interval (mm)", "median arm (mm)", "95th arm (mm)", "success (%)", "cycle (s)")
"""Heads of the columns beside `KEYS`; an interval without a column of its own follows its number in brackets."""

STATISTICS: Mapping[str, str | float] = {"mean": "mean", "median arm": 0.5, "95th percentile arm": 0.95}


def estimates(rows: Rows, value: str, of: str | float = "mean", by: Sequence[str] = CELL) -> dict[Any, Estimate]:
    """Estimates over arms, and over trainings where there are several, by the levels of the columns ``by``."""
    over = ("arm", "training") if "training" in rows.columns and of != "interquartile" else ("arm",)
    lines = estimate(rows.columns, value, by=by, over=over, of=of)
    return {tuple(line[name] for name in by): line["estimate"] for line in lines}


def cell_of(rows: Rows, key: Sequence[Any], by: Sequence[str] = CELL) -> Rows:
    """The rows whose columns ``by`` are at the levels ``key``."""
    return rows.where(**dict(zip(by, key, strict=True)))


def grippers_of(rows: Rows) -> tuple[str, ...]:
    """Names of the grippers for which the rows have chances of taking the fruit."""
    return tuple(name.removeprefix("chance_") for name in rows.columns if name.startswith("chance_"))


# Evaluations: one row per policy × compensation × feedback × plant × gripper, and pairs of compensations.


def evaluation_content(settings: PolicySettings, rows: Rows) -> dict[str, Any]:
    """The table of an evaluation and the comparison of its compensations, for JSON."""
    return {"rows": evaluation_rows(settings, rows), "comparisons": compensations_compared(rows)}


def evaluation_rows(settings: PolicySettings, rows: Rows) -> list[dict[str, Any]]:
    """One row per policy × compensation × feedback × plant × gripper."""
    means, medians, worst = (estimates(rows, "error_mm", of) for of in STATISTICS.values())
    successes = {name: estimates(rows, f"chance_{name}", "share") for name in settings.grippers}
    table = []
    for key, mean in means.items():
        cell = cell_of(rows, key)
        steps = cell["cycle_steps"][np.isfinite(cell["cycle_steps"])]
        learned, trainings = bool(cell["learned"][0]), len(cell.levels("training"))
        of_trainings = "arms, of this one training" if trainings == 1 else f"arms and {trainings} trainings"
        of_cell = {
            "no_interval": mean.missing,
            "interval_over": of_trainings if learned else "arms",
            "cycle_s": float(np.median(steps) * CONTROL_PERIOD) if len(steps) else None,
            "within_tolerance": len(steps) / len(cell),
            "episodes": len(cell),
            "arms": len(cell.levels("arm")),
            "trainings": trainings if learned else None,
            "seeds": list(settings.seeds),
            "population_seed": population_seed(settings.seeds[0]),
            "tolerances": settings.tolerances,
            "camera_noise_mm": settings.camera_noise_mm if "camera" in key else 0.0,
            "fruit_noise_mm": settings.fruit_noise_mm,
        }
        table += [
            dict(zip(KEYS, (*key, name), strict=True))
            | {"mean_mm": mean.value, "ci95": mean.ends}
            | {"median_arm_mm": medians[key].value, "median_arm_ci95": medians[key].ends}
            | {"p95_arm_mm": worst[key].value, "p95_arm_ci95": worst[key].ends}
            | {"success_rate": success[key].value, "success_ci95": success[key].ends}
            | of_cell
            for name, success in successes.items()
        ]
    return table


def compensations_compared(rows: Rows) -> list[dict[str, Any]]:
    """Comparisons of every compensation with each one listed before it, pair by pair."""
    steps, names = [behind for (behind,) in rows.levels("compensation")], ("policy", "feedback", "plant")
    pairs = {}
    for number, base in enumerate(steps):
        later = rows.where(compensation=tuple(steps[number:])).columns
        for line in estimate(later, "error_mm", CELL, ("arm", "training"), against={"compensation": base}):
            pairs[*(line[name] for name in names), base, line["compensation"]] = line["estimate"]
    return [
        dict(zip((*names, "from", "to"), (*key, base, later), strict=True))
        | {"difference_mm": difference.value, "ci95": difference.ends}
        | {"significant": difference.significant, "no_interval": difference.missing}
        for key in rows.levels(*names)
        for base, later in combinations(steps, 2)
        if (difference := pairs.get((*key, base, later))) is not None
    ]


def cells_of(row: Mapping[str, Any]) -> list[str]:
    """The cells of a row as people are shown them: those of `KEYS` and of `HEADS`."""
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


def nearest_words(rows: Sequence[Mapping[str, Any]], comparisons: Sequence[Mapping[str, Any]]) -> list[str]:
    """A sentence for each plant: which policy ends nearest, and by how much nearer than the same on the raw arm.

    The oracle, which knows the true arm, is passed over.

    Args:
        rows: Those of `evaluation_rows`.
        comparisons: Those of `compensations_compared`.
    """
    sentences = []
    for plant in dict.fromkeys(row["plant"] for row in rows):
        mine = [row for row in rows if row["plant"] == plant]
        best = min([row for row in mine if row["policy"] != "oracle"] or mine, key=lambda row: float(row["mean_mm"]))
        error = with_interval(best["mean_mm"], best["ci95"], 2, unit=" mm")
        text = f"{plant}: {best['policy']} with {best['compensation']} ends nearest, {error} from the fruit"
        for line in comparisons:
            alike = all(line[name] == best[name] for name in ("policy", "feedback", "plant"))
            if alike and line["from"] == "raw" and line["to"] == best["compensation"]:
                text += f"; {with_interval(line['difference_mm'], line['ci95'], 2, sign='+', unit=' mm')} against raw"
        sentences.append(text)
    return sentences


def pivoted(rows: Sequence[Mapping[str, Any]], shares: bool = False) -> tuple[list[str], list[list[str]]]:
    """Heads and cells of a table with a column for each compensation.

    Args:
        rows: Those of `evaluation_rows`.
        shares: The shares of fruit taken, in percent, with a line for each gripper; if not, mean errors in mm.
    """
    keys = ["policy", "feedback", "plant", *(["gripper"] if shares else [])]
    columns = list(dict.fromkeys(row["compensation"] for row in rows))
    lines: dict[tuple[str, ...], dict[str, str]] = {}
    for row in rows:
        share = with_interval(row["success_rate"], row["success_ci95"], 1, 100.0)
        cell = share if shares else with_interval(row["mean_mm"], row["ci95"], 2)
        lines.setdefault(tuple(row[key] for key in keys), {})[row["compensation"]] = cell
    cells = [[*key, *(line.get(column, "") for column in columns)] for key, line in lines.items()]
    return [*keys, *columns], cells


def gain_words(line: Mapping[str, Any]) -> tuple[str, str, str]:
    """A comparison's difference, its interval, and whether it is significant."""
    ends = interval_words(line["ci95"], 3, sign="+") or f"none: {line['no_interval']}"
    return f"{line['difference_mm']:+.3f}", ends, {True: "yes", False: "no", None: "not known"}[line["significant"]]


# Files: CSV, Parquet, run folders.


def flat_rows(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """The rows of an evaluation's table with intervals and seeds in columns of their own."""
    flat: list[dict[str, Any]] = [{} for _ in rows]
    for line, (key, value) in ((line, cell) for line, row in zip(flat, rows, strict=True) for cell in row.items()):
        if key.endswith("ci95"):
            line[f"{key}_low"], line[f"{key}_high"] = value or (None, None)
        else:
            line[key] = " ".join(map(str, value)) if key == "seeds" else value
    return flat


def write_evaluation(settings: PolicySettings, rows: Rows, folder: Path) -> list[Path]:
    """Write the run folder of an evaluation: every episode, and the table as JSON."""
    names = {"policy": settings.policies, "compensation": settings.compensations, "feedback": settings.feedback}
    names |= {"plant": settings.plants, "gripper": settings.grippers}
    sizes = {"arms": settings.arms, "episodes": settings.episodes, "tolerances": settings.tolerances}
    noises = {"camera_noise": f"{settings.camera_noise_mm:g}", "fruit_noise": f"{settings.fruit_noise_mm:g}"}
    (seed,), epochs = settings.seeds, settings.plan.epochs
    command = command_line("pickenv", "evaluate", **names, **sizes, **noises, epochs=epochs, seed=seed)
    with recorded_run(folder, "evaluation", command, seed):
        write_piece(folder / EPISODES, rows, "evaluation", command)
        return [folder / EPISODES, write_json(folder / ROWS, evaluation_content(settings, rows))]


def read_episodes(run: Run) -> Rows:
    """The episodes of an evaluation, to the bit; raises `InputError` if they were edited or exchanged."""
    return read_piece(unedited(run, EPISODES), run.command)


# The page and the figures of an evaluation's run folder.


def page(run: Run, picture: TakePicture | None = None) -> str:
    """The page of an evaluation: its compensations compared, every cell with its interval, and figures."""
    path = unedited(run, ROWS)
    with refusing_damage(path, "an evaluation's table", f"`{run.made_by}` makes it anew"):
        content = json.loads(path.read_text(encoding="utf-8"))
        rows, worth = content["rows"], content["comparisons"]
    first, best = rows[0], min(rows, key=lambda row: row["mean_mm"])
    raw = [line for line in worth if line["from"] == "raw"]
    helped = [line for line in raw if line["significant"] and line["difference_mm"] < 0.0]
    ends, behind = interval_words(best["ci95"], 3), policy_label(best["compensation"])
    evidence = f"95 % interval over {best['interval_over']}: {ends}" if ends else f"no interval: {best['no_interval']}"
    verdict = PageVerdict(
        "note",
        f"Best: {best['policy']} with {behind}, {best['mean_mm']:.2f} mm",
        f"{best['policy']} with {best['feedback']} and {behind} on {best['plant']} ends {best['mean_mm']:.3f} mm from "
        f"the fruit in the mean ({evidence}). Of {len(raw)} comparisons of a calibration with the raw arm, "
        f"{len(helped)} show a gain that is significant.",
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
            (*(names := ("policy", "feedback", "plant")), "from", "to", "difference (mm)", "95 % (mm)", "significant"),
            [
                (*(line[n] for n in names), policy_label(line["from"]), policy_label(line["to"]), *gain_words(line))
                for line in worth
            ],
        ),
    )
    arms = f"arms of tolerance class {first['tolerances']} that no policy was trained on"
    return plain_report(
        run, "Comparison of policies", f"Simulated; {arms}, seed {run.seed}", verdict, tables, drawings(run)
    )


def drawings(run: Run) -> Drawings:
    """The figures of an evaluation's run folder."""
    return evaluation_drawings(read_episodes(run))


def evaluation_drawings(rows: Rows) -> Drawings:
    """Every figure of an evaluation."""
    caption = "Final position errors of every policy over arms, with 95 % intervals; an arrow is an open end."
    figures = [Drawing("aggregates", caption, partial(aggregate_figure, rows))]
    for (plant,) in rows.levels("plant"):
        name, scripted = Path(plant).stem, rows.where(plant=plant, policy="scripted")
        caption = f"Mean position error on {plant} if the pick were made after each step."
        figures.append(Drawing(f"accuracy_against_cycle_time_{name}", caption, partial(cycle_figure, rows, plant)))
        if errors := {
            policy_label(behind): scripted.where(compensation=behind)["error_mm"]
            for (behind,) in scripted.levels("compensation")
        }:
            caption = f"What each gripper forgives, and where the scripted policy on {plant} lies on its curve."
            curves = partial(success_curves, rows, plant)
            figures.append(Drawing(f"success_against_misalignment_{name}", caption, curves))
            caption = f"Final position errors of the scripted policy on {plant}."
            by_method = partial(error_by_method, errors, counted="reaches")
            figures.append(Drawing(f"error_by_compensation_{name}", caption, by_method))
            caption = f"Share of the scripted policy's reaches on {plant} whose error is at most x."
            shares = partial(error_cumulative, errors, counted="reaches")
            figures.append(Drawing(f"error_cumulative_{name}", caption, shares))
    return figures


def aggregate_figure(rows: Rows) -> Figure:
    """Mean, median and 95th percentile over arms of every cell with 95 % intervals, one panel row per plant."""
    panels: dict[str, dict[str, dict[str, dict[str, plot_policies.Estimated]]]] = {}
    for title, of in STATISTICS.items():
        for (policy, compensation, feedback, plant), number in estimates(rows, "error_mm", of).items():
            policies = panels.setdefault(plant, {}).setdefault(title, {})
            behind = policies.setdefault(f"{policy}\n{feedback}", {})
            behind[policy_label(compensation)] = (number.value, number.ci95)
    return plot_policies.aggregates(panels)


def success_curves(rows: Rows, plant: str) -> Figure:
    """Success against lateral error for each gripper, and where the scripted policy lies on it, with its interval."""
    scripted = rows.where(policy="scripted", plant=plant)
    errors, grippers = estimates(scripted, "error_mm"), grippers_of(rows)
    points: dict[str, dict[str, tuple[float, plot_policies.Estimated]]] = {}
    for name in grippers:
        for key, success in estimates(scripted, f"chance_{name}", "share").items():
            place = (errors[key].value, (success.value, success.ci95))
            points.setdefault(policy_label(key[1]), {})[name] = place
    return plot_policies.success_against_misalignment(gripper_curves(grippers), points)


def cycle_figure(rows: Rows, plant: str) -> Figure:
    """Accuracy against cycle time: mean error if the pick were made after each step, and the Pareto front of all.

    Policies with a camera are shown on raw arms only, for there all compensations look alike.
    """
    curves = {}
    for key in rows.where(plant=plant).levels(*CELL):
        policy, compensation, feedback, _ = key
        if policy != "random" and (feedback != "camera" or compensation == "raw"):
            way = cell_of(rows, key)["way_mm"].mean(axis=0)
            curves[policy, policy_label(compensation)] = way[np.isfinite(way)]
    return plot_policies.accuracy_against_cycle_time(curves, CONTROL_PERIOD, title=plant)


# The leaderboard: interquartile means over the arms of several seeds (Agarwal et al. 2021), a table for each task.

LEAST_SEEDS = 5
"""Fewest seeds that a leaderboard may have."""

ARMS_OF_RUNGS = 16
"""Number of arms of a rung; all seeds share them."""

LEADERBOARD = PolicySettings(
    policies=("scripted", "servo", "adaptive", *shipped_baselines()), plants=("qiao2026", "field"), arms=2, episodes=16,
    seeds=tuple(range(LEAST_SEEDS)), canopies=2,
)  # fmt: skip
QUICK = replace(
    LEADERBOARD, policies=("scripted", "servo", "ppo_encoders"), plants=("qiao2026",), arms=1, episodes=4,
    plan=CalibrationPlan(epochs=20), canopies=0,
)  # fmt: skip
"""Minutes less, to try things out."""

WORDS = ("policy", "feedback", "compensation")


def rungs(names: Sequence[str]) -> tuple[str, ...]:
    """Rungs of the ladder as `PolicySettings.plants` has them; "all" for each that has more than one arm."""
    every = [name for name, fixed in LADDER.items() if "arms" in fixed]
    return tuple(f"{RUNG}{name}" for given in names for name in (every if given == "all" else [given]))


def run_leaderboard(settings: PolicySettings, folder: Path, **how: Any) -> list[dict[str, Any]]:
    """Run the parts that were not run yet, and return the rows of all tasks; arguments as for `run_policies`.

    Raises:
        InputError: If there are too few seeds, or as `run_policies` does.
    """
    if len(set(settings.seeds)) < max(LEAST_SEEDS, len(settings.seeds)):
        raise InputError(f"seeds are {list(settings.seeds)}; give at least {LEAST_SEEDS}, each once")
    rows = reaching_rows(run_policies(settings, folder, **how))
    return rows + (picking_rows(run_policies(settings, folder, task="picking", **how)) if settings.canopies else [])


def reaching_rows(rows: Rows) -> list[dict[str, Any]]:
    """One row per task, policy, feedback and compensation, over all seeds; best interquartile mean of a task first."""
    table = []
    for key, middle in estimates(rows, "error_mm", "interquartile").items():
        cell = cell_of(rows, key)
        mean, attitude = (float(cell[name].mean()) for name in ("error_mm", "attitude_deg"))
        success = {name: float(cell[f"chance_{name}"].mean()) for name in grippers_of(rows)}
        fruit = {"fruit_per_arm": len(cell.levels("arm", "episode")) // len(cell.levels("arm"))}
        table.append(_board_row("Reach-v0", cell, mean, attitude, middle, success, {}, fruit))
    return sorted(table, key=lambda row: (row["task"], row["iqm_mm"], *(row[word] for word in WORDS)))


def picking_rows(rows: Rows) -> list[dict[str, Any]]:
    """One row per picker and compensation, ordered by picks per hour with the first gripper, the most first."""
    by = ("policy", "compensation", "gripper")
    rates = estimates(rows, "picks_per_hour", by=by)
    table = []
    for key in rows.levels(*by[:2]):
        cell = cell_of(rows, key, by[:2])
        arms = np.unique(cell["arm"], return_inverse=True)[1]
        grasps, sums = (np.bincount(arms, cell[name]) for name in ("attempted", "error_sum_mm"))
        errors: NDArray[np.float64] = sums[grasps > 0.0] / grasps[grasps > 0.0]
        success, per_hour = {}, {}
        for (name,) in cell.levels("gripper"):
            with_gripper, per_hour[name] = cell.where(gripper=name), rates[*key, name]
            success[name] = float(with_gripper["collected"].sum() / max(1, with_gripper["attempted"].sum()))
        hourly: dict[str, Any] = {"picks_per_hour": {name: rate.value for name, rate in per_hour.items()}}
        hourly["picks_per_hour_ci95"] = {name: rate.ends for name, rate in per_hour.items()}
        tilt, attempts = float(cell["tilt_sum_deg"].sum() / grasps.sum()), {"attempts": int(grasps.sum())}
        middle = interquartile_estimate(errors)
        table.append(_board_row("Pick-v0", cell, float(errors.mean()), tilt, middle, success, hourly, attempts))
    return sorted(table, key=lambda row: -next(iter(row["picks_per_hour"].values())))


def _board_row(
    task: str, cell: Rows, mean: float, attitude: float, middle: Estimate, success: Mapping[str, float],
    hourly: Mapping[str, Any], counted: Mapping[str, int],
) -> dict[str, Any]:  # fmt: skip
    """A row of the leaderboard."""
    words = {name: str(cell[name][0]) if name in cell.columns else "encoders" for name in WORDS}
    numbers = {"mean_mm": mean, "iqm_mm": middle.value, "attitude_deg": attitude}
    shares = {"success": next(iter(success.values())), "success_by_gripper": success, "ci95_mm": middle.ends}
    sample = {"seeds": sorted(seed for (seed,) in cell.levels("seed")), "arms": len(cell.levels("arm"))}
    return {"task": f"pickenv/{task}, {cell['plant'][0]}", **words, **numbers, **shares, **hourly, **sample, **counted}


def leaderboard_heads(row: Mapping[str, Any]) -> list[str]:
    """Column heads of the table that a row belongs to: `WORDS`, then the numbers."""
    rates = [f"picks per hour, {name}" for name in row.get("picks_per_hour", {})]
    success = (f"success, {name}" for name in row["success_by_gripper"])
    mean = "mean (mm) at the grasp" if rates else "mean (mm)"
    return [*WORDS, mean, "interquartile mean (mm)", "attitude (deg)", *success, *rates]


def leaderboard_cells(row: Mapping[str, Any]) -> list[str]:
    """The cells of a row as people are shown them, in the order of its heads."""
    rates, ends = row.get("picks_per_hour", {}), row.get("picks_per_hour_ci95", {})
    return [
        *(row["policy"], row["feedback"], policy_label(row["compensation"]), f"{row['mean_mm']:.3f}"),
        f"{row['iqm_mm']:.3f} ({interval_words(row['ci95_mm'], 3) or 'no interval'})",
        f"{row['attitude_deg']:.3f}",
        *(f"{100 * share:.0f} %" for share in row["success_by_gripper"].values()),
        *(with_interval(rate, ends[name], 0) for name, rate in rates.items()),
    ]


def leaderboard_tables(rows: Sequence[Mapping[str, Any]]) -> str:
    """The leaderboard's tables in Markdown, one per task."""
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
        seeds = ", ".join(map(str, first["seeds"]))
        parts += [
            f"{task}: {first['arms']} arms over seeds {seeds}, {each_arm}",
            "",
            *(f"| {line} |" for line in lines),
            "",
        ]
    return "\n".join(parts)
