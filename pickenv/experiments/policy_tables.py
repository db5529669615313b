"""Tables, pages, figures and run folders of compared policies, all made from the rows of `run_policies`."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import combinations, groupby
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from pickenv.agents import Training
from pickenv.agents.evaluation.contenders import kind_of
from pickenv.base import Estimate, InputError, command_line, count_of, estimate, listed, refusing_damage, write_json
from pickenv.envs.shared.difficulty import LADDER
from pickenv.envs.shared.situation import CONTROL_PERIOD
from pickenv.experiments.engine import Experiment, Rows, piece_table, pivot, run, write_piece
from pickenv.experiments.methods import CalibrationPlan
from pickenv.experiments.policies import RUNG, PolicySettings, run_policies
from pickenv.inspect import Run
from pickenv.inspect.colours import as_sentence, between, policy_label, said, unmarked
from pickenv.inspect.figures import plot_policies
from pickenv.inspect.figures.plot_errors import error_by_method, error_cumulative
from pickenv.inspect.figures.run_drawings import Drawing, Drawings
from pickenv.inspect.reports.report_page import PageTable, PageVerdict, plain_report
from pickenv.inspect.runs.comparison_summary import gripper_curves
from pickenv.inspect.runs.run_folder import TakePicture, recorded_run, unedited

EPISODES = "episodes.parquet"
"""File in an evaluation's run folder that contains its episodes, one row each."""

ROWS = "rows.json"
"""File in an evaluation's run folder that contains its table, for people and other programs."""

CELL = ("policy", "compensation", "feedback", "plant")
"""Columns whose levels identify a cell, that is the episodes behind one number of the table."""

KEYS = (*CELL, "gripper")

HEADS = ("mean (mm)", "95 % interval (mm)", "median arm (mm)", "95th arm (mm)", "success (%)", "cycle (s)")
"""Heads of the columns that follow the columns `KEYS`. The interval of the mean has a column. All other intervals stand
in brackets behind their numbers."""

STATISTICS: Mapping[str, str | float] = {"mean": "mean", "median arm": 0.5, "95th percentile arm": 0.95}


def estimates(rows: Rows, value: str, of: str | float = "mean", by: Sequence[str] = CELL) -> dict[Any, Estimate]:
    """Estimate a number for each combination of values of the columns ``by``.

    The intervals are over arms, and over trainings if there are several.

    Args:
        rows: The rows, from `run_policies`.
        value: Column that the numbers are estimated from.
        of: "mean", "share", or a probability for its quantile over arms (`pickenv.base.intervals.estimate`).
        by: Columns that identify a number.

    Returns:
        The estimates, by the tuple of values of ``by``.
    """
    over = ("arm", "training") if "training" in rows.columns else ("arm",)
    lines = estimate(rows.columns, value, by=by, over=over, of=of)
    return {tuple(line[name] for name in by): line["estimate"] for line in lines}


def cell_of(rows: Rows, key: Sequence[Any]) -> Rows:
    """Return the rows of a cell, whose levels of the columns `CELL` are ``key``."""
    return rows.where(**dict(zip(CELL, key, strict=True)))


# Evaluations: one row per policy × compensation × feedback × plant × gripper, and pairs of compensations.


def evaluation_content(settings: PolicySettings, rows: Rows) -> dict[str, Any]:
    """Return an evaluation's numbers, for JSON.

    "rows" has the table of `evaluation_rows`. "comparisons" has the differences that
    `compensations_compared` returns.

    Args:
        settings: What was compared.
        rows: The episodes, from `run_policies`.
    """
    return {"rows": evaluation_rows(settings, rows), "comparisons": compensations_compared(rows)}


def evaluation_rows(settings: PolicySettings, rows: Rows) -> list[dict[str, Any]]:
    """Return one dictionary of numbers for each combination of policy, compensation, feedback, plant and gripper.

    Args:
        settings: What was compared.
        rows: The episodes, from `run_policies`.
    """
    means, medians, worst = (estimates(rows, "error_mm", of) for of in STATISTICS.values())
    successes = {name: estimates(rows, f"chance_{name}", "share") for name in settings.grippers}
    table: list[dict[str, Any]] = []
    for key, mean in means.items():
        cell = cell_of(rows, key)
        steps = cell["cycle_steps"][np.isfinite(cell["cycle_steps"])]
        learned, trainings = bool(cell["learned"][0]), len(cell.levels("training"))
        of_trainings = "arms, of this one training" if trainings == 1 else f"arms and {trainings} trainings"
        world = settings.world(key[3], settings.seeds[0], key[2])  # a rung fixes its own arms and noise
        of_cell = {
            "no_interval": mean.missing,
            "interval_over": of_trainings if learned else "arms",
            "cycle_s": float(np.median(steps) * CONTROL_PERIOD) if len(steps) else None,
            "within_tolerance": len(steps) / len(cell),
            "episodes": len(cell),
            "arms": len(cell.levels("arm")),
            "trainings": trainings if learned else None,
            "seeds": list(settings.seeds),
            **{name: world[name] for name in ("population_seed", "tolerances", "camera_noise_mm", "fruit_noise_mm")},
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
    """Compare every two compensations, pair by pair on the same arms and fruit.

    Args:
        rows: The episodes, from `run_policies`.

    Returns:
        One dictionary for each policy, feedback, plant and pair of compensations. The compensation that appears first
        in ``rows`` is "from", and the other one is "to". "difference_mm" is the mean error with "to" minus the mean
        error with "from". "ci95" is the 95 % interval of the difference. "significant" says whether the difference
        differs significantly from zero. "no_interval" says why there is no interval.
    """
    steps, names = [behind for (behind,) in rows.levels("compensation")], ("policy", "feedback", "plant")
    pairs = {
        (*(line[name] for name in names), base, line["compensation"]): line["estimate"]
        for number, base in enumerate(steps)
        for later in [rows.where(compensation=tuple(steps[number:])).columns]
        for line in estimate(later, "error_mm", CELL, ("arm", "training"), against={"compensation": base})
    }
    return [
        dict(zip((*names, "from", "to"), (*key, base, later), strict=True))
        | {"difference_mm": difference.value, "ci95": difference.ends}
        | {"significant": difference.significant, "no_interval": difference.missing}
        for key in rows.levels(*names)
        for base, later in combinations(steps, 2)
        if (difference := pairs.get((*key, base, later))) is not None
    ]


def cells_of(row: Mapping[str, Any]) -> list[str]:
    """Return the cells of a row of `evaluation_rows` as text, in the order of `KEYS` and `HEADS`."""
    trained = {None: "", 1: " (one training)"}.get(row["trainings"], f" ({row['trainings']} trainings)")
    return [
        f"{row['policy']}{trained}",
        *(row[key] for key in KEYS[1:]),
        f"{row['mean_mm']:.3f}",
        _interval(row),
        said(row["median_arm_mm"], row["median_arm_ci95"], 3),
        said(row["p95_arm_mm"], row["p95_arm_ci95"], 3),
        _percent(row["success_rate"], row["success_ci95"]),
        "never" if row["cycle_s"] is None else f"{row['cycle_s']:.1f}",
    ]


def nearest_words(rows: Sequence[Mapping[str, Any]], comparisons: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return a sentence per plant: which policy and compensation end nearest to the fruit, and the gain over raw.

    The oracle, which knows the true arm, is left out.

    Args:
        rows: Rows of `evaluation_rows`.
        comparisons: Rows of `compensations_compared`.
    """
    sentences = []
    for plant in dict.fromkeys(row["plant"] for row in rows):
        mine = [row for row in rows if row["plant"] == plant]
        best = min([row for row in mine if row["policy"] != "oracle"] or mine, key=lambda row: float(row["mean_mm"]))
        error = said(best["mean_mm"], best["ci95"], 2, unit=" mm")
        text = f"{plant}: {best['policy']} with {best['compensation']} ends nearest, {error} from the fruit"
        for line in comparisons:
            alike = all(line[name] == best[name] for name in ("policy", "feedback", "plant"))
            if alike and line["from"] == "raw" and line["to"] == best["compensation"]:
                text += f"; {said(line['difference_mm'], line['ci95'], 2, sign='+', unit=' mm')} against raw"
        sentences.append(text)
    return sentences


def pivoted(rows: Sequence[Mapping[str, Any]], shares: bool = False) -> tuple[list[str], list[list[str]]]:
    """Return the column heads and the lines of cells (texts) of a table that has a column for each compensation.

    Args:
        rows: Rows of `evaluation_rows`.
        shares: True: the cells are the percentages of fruit that each gripper takes. False: they are mean errors, mm.
    """
    keys = ["policy", "feedback", "plant", *(["gripper"] if shares else [])]

    def cell(row: Mapping[str, Any]) -> str:
        return _percent(row["success_rate"], row["success_ci95"]) if shares else said(row["mean_mm"], row["ci95"], 2)

    return pivot(rows, keys, "compensation", cell)


def _interval(row: Mapping[str, Any], sign: str = "") -> str:
    """Return a row's 95 % interval as text, mm, or the reason why the row has none.

    With ``sign`` "+", positive numbers have a sign too.
    """
    return between(row["ci95"][0], row["ci95"][1], 3, sign) if row["ci95"] else f"none: {row['no_interval']}"


def gain_words(line: Mapping[str, Any]) -> tuple[str, str, str]:
    """Return difference, interval and significance as texts, from a row ``line`` of `compensations_compared`."""
    return (
        f"{line['difference_mm']:+.3f}",
        _interval(line, "+"),
        {True: "yes", False: "no", None: "not known"}[line["significant"]],
    )


# The run folder.


def write_evaluation(settings: PolicySettings, rows: Rows, folder: Path) -> list[Path]:
    """Write the run folder of an evaluation: every episode, and the table as JSON. Return the files."""
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
    """Read and verify the episodes in an evaluation's run folder, one row each.

    Raises:
        InputError: If the file of episodes was edited or replaced by another.
    """
    return Rows.of_arrow(piece_table(unedited(run, EPISODES), run.command))


# The page and the figures of an evaluation's run folder.


def page(run: Run, picture: TakePicture | None = None) -> str:
    """Return the HTML page of an evaluation: the compensations compared, all numbers with intervals, and figures.

    Args:
        run: Run folder of the evaluation.
        picture: Not used; an evaluation's page has no picture of its recording.
    """
    path = unedited(run, ROWS)
    with refusing_damage(path, "an evaluation's table", f"`{run.made_by}` makes it anew"):
        content = json.loads(path.read_text(encoding="utf-8"))
        rows, worth = _labelled(content["rows"]), _labelled(content["comparisons"])
    nearest, *others = nearest_words(rows, worth)
    first, text = rows[0], [f"{sentence}." for sentence in others]
    reaches = count_of(first["episodes"] // (first["trainings"] or 1), "reach", "reaches")
    over = f"Intervals are at 95 % over {first['interval_over']}."
    text.append(over if first["ci95"] else f"No intervals: {first['no_interval']}.")
    verdict = PageVerdict("note", as_sentence(nearest), as_sentence(" ".join(text)))
    names = ("policy", "feedback", "plant")
    tables = (
        PageTable(
            f"Final position errors; {reaches} on {count_of(first['arms'], 'arm')}, "
            "the same for all. Mean, median and 95th percentile are over arms, in brackets and beside the mean 95 % "
            "intervals; those of one training say nothing of another one",
            ("policy", "calibration", *KEYS[2:], *HEADS),
            [cells_of(row) for row in rows],
        ).spelled(),
        PageTable(
            "What each calibration changes on the same arms and fruit, pair by pair; 95 % intervals over arms, and "
            "over trainings where there are several",
            (*names, "from", "to", "difference (mm)", "95 % (mm)", "significant"),
            [(*(line[name] for name in (*names, "from", "to")), *gain_words(line)) for line in worth],
        ).spelled(),
    )
    about = f"Simulated; arms of tolerance class {first['tolerances']} that no policy was trained on, seed {run.seed}"
    return plain_report(run, "Comparison of policies", about, verdict, tables, drawings(run))


def _labelled(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the rows with the keys of compensations replaced by their labels for readers, such as LS for ``ls``."""
    keys = ("compensation", "from", "to")
    return [row | {key: policy_label(row[key]) for key in keys if key in row} for row in rows]


def drawings(run: Run) -> Drawings:
    """Return the figures of an evaluation's run folder."""
    return evaluation_drawings(read_episodes(run))


def evaluation_drawings(rows: Rows) -> Drawings:
    """Return every figure of an evaluation, drawn from its episodes."""
    figures: list[Drawing] = []

    def add(name: str, caption: str, draw: Callable[..., Figure], *data: Any, **options: Any) -> None:
        figures.append(Drawing(name, caption, partial(draw, *data, **options)))

    caption = "Final position errors of every policy over arms, with 95 % intervals; an arrow is an open end."
    add("aggregates", caption, aggregate_figure, rows)
    for (plant,) in rows.levels("plant"):
        name, scripted = Path(plant).stem, rows.where(plant=plant, policy="scripted")
        caption = f"Mean position error on {plant} if the pick were made after each step."
        add(f"accuracy_against_cycle_time_{name}", caption, cycle_figure, rows, plant)
        if errors := {
            policy_label(behind): scripted.where(compensation=behind)["error_mm"]
            for (behind,) in scripted.levels("compensation")
        }:
            caption = f"What each gripper forgives, and where the scripted policy on {plant} lies on its curve."
            add(f"success_against_misalignment_{name}", caption, success_curves, rows, plant)
            caption = f"Final position errors of the scripted policy on {plant}."
            add(f"error_by_compensation_{name}", caption, error_by_method, errors, counted="reaches")
            caption = f"Share of the scripted policy's reaches on {plant} whose error is at most x."
            add(f"error_cumulative_{name}", caption, error_cumulative, errors, counted="reaches")
    return figures


def aggregate_figure(rows: Rows) -> Figure:
    """Draw the position errors of each policy, feedback and compensation, in a row of panels for each plant.

    The panels show the mean, the median and the 95th percentile over arms, with 95 % intervals.
    """
    panels: dict[str, dict[str, dict[str, dict[str, plot_policies.Estimated]]]] = {}
    for title, of in STATISTICS.items():
        for (policy, compensation, feedback, plant), number in estimates(rows, "error_mm", of).items():
            policies = panels.setdefault(plant, {}).setdefault(title, {})
            behind = policies.setdefault(f"{policy}\n{feedback}", {})
            behind[policy_label(compensation)] = (number.value, number.ci95)
    return plot_policies.aggregates(panels)


def success_curves(rows: Rows, plant: str) -> Figure:
    """Draw the success of each gripper against lateral error, and the scripted policy as points on these curves.

    The points are the scripted policy's mean error and share of successes on ``plant``, one for each compensation.
    """
    scripted = rows.where(policy="scripted", plant=plant)
    errors = estimates(scripted, "error_mm")
    grippers = tuple(name.removeprefix("chance_") for name in rows.columns if name.startswith("chance_"))
    points: dict[str, dict[str, tuple[float, plot_policies.Estimated]]] = {}
    for name in grippers:
        for key, success in estimates(scripted, f"chance_{name}", "share").items():
            place = (errors[key].value, (success.value, success.ci95))
            points.setdefault(policy_label(key[1]), {})[name] = place
    return plot_policies.success_against_misalignment(gripper_curves(grippers), points)


def cycle_figure(rows: Rows, plant: str) -> Figure:
    """Draw each policy's mean error after every step against time, on one plant, with the Pareto front of all policies.

    The error after a step is the error of a pick that ends at this step. Policies with a camera are shown on raw arms
    only, since compensations hardly change their errors.
    """
    curves = {}
    for key in rows.where(plant=plant).levels(*CELL):
        policy, compensation, feedback, _ = key
        if policy != "random" and (feedback != "camera" or compensation == "raw"):
            way = cell_of(rows, key)["way_mm"].mean(axis=0)
            curves[policy, policy_label(compensation)] = way[np.isfinite(way)]
    return plot_policies.accuracy_against_cycle_time(curves, CONTROL_PERIOD, title=plant)


# The leaderboard: every policy on every rung of the ladder, on arms that no two seeds share.

LEAST_SEEDS = 5
"""Smallest number of seeds of a leaderboard."""

_CAMERA = {"feedback": "camera", "camera_noise_mm": 1.0}
RECIPES: Mapping[str, Training] = {
    "ppo": Training("ppo", arguments={"plant": "ideal"}),
    "ppo_camera": Training("ppo", arguments=_CAMERA),
    "her_camera": Training("tqc", "pickenv/ReachGoal-v0", arguments=_CAMERA),
    "window_camera": Training("ppo_history"),
    "recurrent_camera": Training("ppo_lstm"),
    "ppo_pick": Training("ppo", "pickenv/Pick-v0"),
}
"""Trainings of the leaderboard's learned policies, by their names on it; each is repeated with several seeds. "ppo"
learns to reach on the ideal arm. The policies with a memory ("window_camera", "recurrent_camera") learn on many arms
like the smooth one. All other policies learn on the smooth arm. No training has a delay."""

LEADERBOARD = PolicySettings(
    policies=("scripted", "servo", "adaptive", "oracle"), compensations=("raw", "ls", "best"), arms=12, episodes=10,
    plants=tuple(f"{RUNG}{name}" for name in LADDER)[1:], seeds=tuple(range(LEAST_SEEDS)), canopies=5,
)  # fmt: skip
QUICK = replace(
    LEADERBOARD, policies=("scripted", "servo", "ppo_encoders"), plants=(f"{RUNG}orchard",), arms=1, episodes=4,
    plan=CalibrationPlan(epochs=20), canopies=0,
)  # fmt: skip
"""Settings of a small leaderboard for trying things out; it takes minutes instead of hours."""

PICK_BEHIND = ("raw", "ls")
"""Compensations with which picks are counted; a residual model would hardly change the picks."""


def rungs(names: Sequence[str]) -> tuple[str, ...]:
    """Return the names of rungs (difficulties of the ladder) with the prefix `RUNG`; "all" stands for every rung."""
    return tuple(plant for name in names for plant in (LEADERBOARD.plants if name == "all" else [f"{RUNG}{name}"]))


def trained(folder: Path, seeds: range, recipes: Sequence[str], **how: Any) -> tuple[str, ...]:
    """Train the policies of `RECIPES` that the folder lacks, and return one folder per recipe.

    Args:
        folder: Folder in which trainings are stored.
        seeds: Seeds of the trainings of each recipe.
        recipes: Names of the recipes.
        how: Further arguments of `pickenv.experiments.run`, such as the backend.

    Raises:
        InputError: If the folder holds trainings of seeds that are not in ``seeds``, since they would be judged too.
    """
    for name in recipes:
        others = {path.parent.name for path in (folder / name).glob("*/policy.npz")} - set(map(str, seeds))
        if others:
            raise InputError(
                f"{folder / name} holds trainings of the seeds {listed(sorted(others))}, which were not asked for; ask "
                "for as many trainings from the same first seed, or give another folder"
            )
    pieces = Experiment("trainings", {"training": seeds}, {"policy": tuple(recipes)}, partial(_train, folder))
    run(pieces, **how)
    return tuple(str(folder / name) for name in recipes)


def _train(folder: Path, *, rng: np.random.Generator, policy: str, training: int) -> dict[str, NDArray[Any]]:
    from pickenv.agents.training.training import CHECKPOINT, train

    out = folder / policy / str(training)
    if not (out / "policy.npz").is_file():
        train(replace(RECIPES[policy], seed=training), out, resume=(out / CHECKPOINT).is_file())
    return {"file": np.array([str(out)])}


def run_leaderboard(
    settings: PolicySettings, folder: Path, trainings: int = 0, learned: Sequence[str] = (), **how: Any
) -> dict[str, Any]:
    """Run the parts of a leaderboard that the folder lacks, and return the rows of its tables.

    Args:
        settings: The policies, compensations, plants and sizes of the leaderboard.
        folder: Folder in which trainings, calibrations and rows are stored.
        trainings: Number of trainings of each recipe; 0 trains none. The trained policies are judged besides the
            policies of ``settings``. The seeds of the trainings are consecutive and begin with the first seed of
            ``settings``.
        learned: Names of the `RECIPES` that are trained; all if empty. Without canopies no policy is trained to pick.
        how: Further arguments of `run_policies`, such as the backend.

    Returns:
        "reach": rows of `evaluation_rows` with some more numbers. "pick": rows of `picking_rows`, empty without
        canopies.

    Raises:
        InputError: If there are fewer than `LEAST_SEEDS` seeds or a seed twice, a policy picks but there are no
            canopies, a name is unknown, a stored file is damaged, or the folder holds other trainings.
    """
    if len(set(settings.seeds)) < max(LEAST_SEEDS, len(settings.seeds)):
        raise InputError(f"seeds are {list(settings.seeds)}; give at least {LEAST_SEEDS}, each once")
    pickers = [name for name in settings.policies if kind_of(name).picks]
    if pickers and not settings.canopies:
        raise InputError(f"{pickers[0]} picks, but no canopy is picked; give at least one of `canopies`")
    usual = [name for name, recipe in RECIPES.items() if settings.canopies or recipe.env_id != "pickenv/Pick-v0"]
    if unknown := sorted(set(learned) - set(usual)):
        picks = "" if settings.canopies else "; one that picks needs at least one of `canopies`"
        raise InputError(f"'{unknown[0]}' is not trained for this leaderboard; give {listed(usual)}{picks}")
    if trainings:
        recipes, first = [name for name in usual if name in (learned or usual)], settings.seeds[0]
        folders = trained(folder / "trainings", range(first, first + trainings), recipes, **how)
        settings = replace(settings, policies=(*settings.policies, *folders))
    reaching = tuple(name for name in settings.policies if not kind_of(name).picks)
    reached = run_policies(replace(settings, policies=reaching), folder, fits=_worth_judging, **how)
    reach = evaluation_rows(settings, reached)
    for row in reach:
        cell = cell_of(reached, [row[name] for name in CELL])
        for name, share in (("half", 0.5), ("nine_of_ten", 0.9)):
            within = distance_within(cell, share)
            row |= {f"{name}_mm": within.value, f"{name}_ci95": within.ends}
        row["training_mm"] = [float(cell.where(training=of)["error_mm"].mean()) for (of,) in cell.levels("training")]
    if not settings.canopies:
        return {"reach": reach, "pick": []}
    counted = tuple(behind for behind in PICK_BEHIND if behind in settings.compensations)
    asked = replace(settings, grippers=settings.grippers[:1], compensations=counted)
    return {"reach": reach, "pick": picking_rows(run_policies(asked, folder, task="picking", **how))}


def _worth_judging(compensation: str, feedback: str, **levels: Any) -> bool:
    """Return whether policies with this feedback are judged with this compensation.

    With a camera, only raw arms are judged, because the camera measures the gap from the true tool.
    """
    return compensation == "raw" or feedback == "encoders"


def distance_within(cell: Rows, share: float) -> Estimate:
    """Estimate the distance from the fruit within which a share of the reaches end, mm.

    The distance is computed for each arm with each training, and averaged over arms and trainings.

    Args:
        cell: Episodes of one policy with one compensation, feedback and plant.
        share: The share, from 0 to 1.
    """
    order, fruit = np.lexsort((cell["training"], cell["arm"])), len(cell) // len(cell.levels("arm", "training"))
    units = {name: cell[name][order][::fruit] for name in ("arm", "training")}
    distance = np.quantile(cell["error_mm"][order].reshape(-1, fruit), share, axis=1)
    return next(iter(estimates(Rows(units | {"error_mm": distance}), "error_mm", by=()).values()))


def picking_rows(rows: Rows) -> list[dict[str, Any]]:
    """Return one dictionary of numbers per picking policy, compensation, plant and gripper.

    Intervals are over arms, each with one training.

    Args:
        rows: Rows of `run_policies` for picking.
    """
    by = ("plant", "policy", "compensation", "gripper")
    numbers = {
        "error_mm": estimate(rows.columns, ("error_sum_mm", "attempted"), by, of="ratio"),
        "success": estimate(rows.columns, ("collected", "attempted"), by, of="share"),
        "picks_per_second": estimate(rows.columns, ("collected", "duration_s"), by, of="ratio"),
    }
    table = []
    for lines in zip(*numbers.values(), strict=True):
        key = {name: lines[0][name] for name in by}
        cell = rows.where(**key)
        trainings = [cell.where(training=training) for (training,) in cell.levels("training")]
        error, success, rate = (line["estimate"] for line in lines)
        hourly = None if rate.ends is None else [3600.0 * end for end in rate.ends]
        table.append(
            {**key, "arms": len(cell.levels("arm"))}
            | {"training_success": [float(one["collected"].sum() / one["attempted"].sum()) for one in trainings]}
            | {name: int(cell[name].sum()) for name in ("attempted", "collected")}
            | {"error_mm": error.value, "error_ci95": error.ends}
            | {"success": success.value, "success_ci95": success.ends}
            | {"picks_per_hour": 3600.0 * rate.value, "picks_per_hour_ci95": hourly}
        )
    return table


def leaderboard_tables(board: Mapping[str, Any]) -> dict[str, tuple[list[str], list[list[str]]]]:
    """Return the column heads and the lines of cells of each table of the leaderboard, by its title.

    Each plant has a table for each task. For policies with several trainings, two further tables list every training.

    Args:
        board: Result of `run_leaderboard`.
    """
    tables: dict[str, tuple[list[str], list[list[str]]]] = {}
    for plant, group in groupby(board["reach"], lambda row: row["plant"]):
        rows = [row for row in group if row["gripper"] == board["reach"][0]["gripper"]]
        behind = list(dict.fromkeys(row["compensation"] for row in rows))
        cells = []
        for mine in _by_policy(rows):
            first, last = mine["raw"], mine.get(behind[-1])
            half, most = (said(first[f"{name}_mm"], first[f"{name}_ci95"], 2) for name in ("half", "nine_of_ten"))
            errors = (said(mine[n]["mean_mm"], mine[n]["ci95"], 2) if n in mine else "" for n in behind)
            taken = ("" if row is None else _percent(row["success_rate"], row["success_ci95"]) for row in (first, last))
            cells.append([first["policy"], first["feedback"], *errors, half, most, *taken])
        named = [policy_label(name) for name in behind]
        heads = ["policy", "feedback", *named, "half within, raw", "nine of ten within, raw"]
        tables[f"Reach, {plant}"] = [*heads, "taken, raw (%)", f"taken, {named[-1]} (%)"], cells
    for plant, group in groupby(board["pick"], lambda row: row["plant"]):
        cells = [
            [
                *(row["policy"], policy_label(row["compensation"]), str(row["attempted"])),
                said(row["error_mm"], row["error_ci95"], 2),
                _percent(row["success"], row["success_ci95"]),
                said(row["picks_per_hour"], row["picks_per_hour_ci95"], 0),
            ]
            for row in sorted(group, key=lambda row: float(-row["success"]))
        ]
        heads = ["policy", "calibration", "grasps", "error at the grasp (mm)", "success (%)", "picks per hour"]
        tables[f"Pick, {plant}"] = heads, cells
    trained = (row for row in board["reach"] if row["trainings"] not in (None, 1))
    if several := [row for row in trained if row["compensation"] == "raw"]:
        tables["Mean error of each training on raw arms (mm)"] = pivot(
            several, ["policy"], "plant", lambda row: " ".join(f"{mm:.2f}" for mm in row["training_mm"])
        )
    raw = (row for row in board["pick"] if row["compensation"] == "raw")
    if several := [row for row in raw if len(row["training_success"]) > 1]:
        tables["Grasps of each training that succeed on raw arms (%)"] = pivot(
            several, ["policy"], "plant", lambda row: " ".join(f"{100.0 * one:.1f}" for one in row["training_success"])
        )
    return tables


def _by_policy(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Mapping[str, Any]]]:
    """Return one mapping per policy and feedback, from the name of a compensation to the row with this compensation.

    The ``rows`` come from `evaluation_rows`. The mappings are sorted by the mean error on raw arms.
    """
    policies: dict[tuple[str, str], dict[str, Mapping[str, Any]]] = {}
    for row in rows:
        policies.setdefault((row["policy"], row["feedback"]), {})[row["compensation"]] = row
    return sorted(policies.values(), key=lambda mine: float(mine["raw"]["mean_mm"]))


def _percent(share: float, ends: Sequence[float | None] | None) -> str:
    return said(share, ends, 1, 100.0)


def leaderboard_summary(board: Mapping[str, Any]) -> tuple[list[str], list[list[str]]]:
    """Return the column heads and the lines of cells of a short table: one line per policy, one column per rung.

    A cell has two mean errors, mm: on raw arms, and after a slash with the last compensation in the policy's rows.

    Args:
        board: Result of `run_leaderboard`.
    """
    rows = []
    for plant, group in groupby(board["reach"], lambda row: row["plant"]):
        for mine in _by_policy(list(group)):
            *_, last = mine.values()
            words = f"{mine['raw']['mean_mm']:.2f}" + (f" / {last['mean_mm']:.2f}" if len(mine) > 1 else "")
            rows.append({**mine["raw"], "rung": plant.removeprefix(RUNG), "words": words})
    return pivot(rows, ["policy", "feedback"], "rung", lambda row: row["words"])


def leaderboard_page(board: Mapping[str, Any]) -> str:
    """Return the leaderboard's tables as Markdown text."""
    parts = []
    for title, (heads, cells) in leaderboard_tables(board).items():
        lines = (f"| {' | '.join(map(unmarked, line))} |" for line in (heads, ["---"] * len(heads), *cells))
        parts += [f"### {title}", "", *lines, ""]
    return "\n".join(parts)
