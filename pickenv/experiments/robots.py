"""Errors that calibrations leave on measured robots: beside twins' predictions, and in the table of results.

Two experiments, each in a folder of its own. "gains" are of folds of a robot's rows: squared errors of the rows held
out, measured, and on arms drawn from the twin of the other rows. "models" are rows of the table of measured robots,
each model with its spread. Every piece has a random stream of its own, so that figures are the same whatever is run
beside it. SI units; mm where names say so.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np

from pickenv.arm import Arm, Array, draw_plants, load_arm, load_tolerances, plant_at
from pickenv.base import Ends, InputError, file_sha256, statistic_interval
from pickenv.calibration import Choices, Measurements, Observations, Result, calibrate, read_observations
from pickenv.calibration.identification.diagnosis import checked_rows
from pickenv.calibration.model.observations import (
    BLOCKS,
    Rows as RowNumbers,
    contiguous_folds,
    equally_spaced,
    origins_of,
    same_poses,
)
from pickenv.calibration.pipeline.fitting import GEOMETRIC
from pickenv.experiments.engine import Experiment, Progress, Rows, run
from pickenv.experiments.gains import LEARNT, LS, NOMINAL, TERMS, Squares, as_measured, left_by_models


@dataclass(frozen=True)
class RealSet:
    """The data files of one robot.

    Attributes:
        robot: Name of the robot in tables.
        arm: Arm name or file; {} is the folder of the data sets.
        columns: Column description.
        files: Rows, as a pattern below the folder of the data sets.
        poses: Files with rows of other poses to judge by, as such a pattern; empty where there are none.
        published: Mean error that others published for these poses, or for the rows where there are no such poses, mm.
        twinned: Whether twins are made of the set and residuals learnt; it then has poses or positions for five folds.
    """

    robot: str
    arm: str
    columns: str
    files: str
    poses: str = ""
    published: float | None = None
    twinned: bool = False

    def paths(self, data: Path) -> tuple[list[Path], list[Path]]:
        """The files of the rows, and the files of the other poses.

        Raises:
            InputError: If there are none.
        """
        both = [sorted(data.glob(pattern)) if pattern else [] for pattern in (self.files, self.poses)]
        for pattern, files in zip((self.files, self.poses), both, strict=True):
            if pattern and not files:
                raise InputError(f"no {pattern} in {data}; name the folder of the data sets in PICKENV_DATA")
        return both[0], both[1]

    def load(self, data: Path) -> tuple[Arm, Observations, Observations | None]:
        """The arm, the rows and the other poses; no twin knows what a file says of its repeats, as most say nothing.

        Raises:
            InputError: If there are no such files, or they cannot be read.
        """
        arm = load_arm(self.arm.format(data))
        rows, poses = (
            read_observations(files, arm.nominal, self.columns) if files else None for files in self.paths(data)
        )
        assert rows is not None
        return arm, replace(rows, origins=replace(origins_of(rows), repeat=None)), poses  # type: ignore[type-var]


TABLES: dict[str, Any] = tomllib.loads(Path(__file__).with_name("robots.toml").read_text(encoding="utf-8"))
SETS = {name: RealSet(**entry) for name, entry in TABLES["sets"].items()}
"""Every measured robot, by name."""


# Folds of a set, and arms drawn from the twin of each.

SPLITS = ("random", "blocks")
GAINS = {f"gain_{name}_{split}": (name, split) for name in SETS if SETS[name].twinned for split in SPLITS}
"""Rows of predicted beside measured gains: each name with the robot's set and the split."""

BEFORE = {LS: NOMINAL, TERMS: LS, **dict.fromkeys(LEARNT, LS)}
"""For each model, the model whose error its reduction is a share of."""

BATCHES = 4
"""Largest ratio of arms drawn to arms wanted, where some cannot be calibrated."""


@dataclass(frozen=True)
class BenchSettings:
    """Settings that say how much is computed.

    Attributes:
        rows: Most rows of a set for predicted and measured gains, equally spaced in its file.
        folds: Parts of these rows that are held out in turn.
        draws: Arms drawn from each fold's twin.
        splits: Random splits of those rows.
        seed: Seed of everything random.
    """

    rows: int = 600
    folds: int = 5
    draws: int = 2
    splits: int = 10
    seed: int = 0

    @staticmethod
    def quick() -> BenchSettings:
        """Settings with which the UR5 takes about a minute."""
        return BenchSettings(rows=160, folds=2)


def fold_errors(
    rng: np.random.Generator, row: str, fold: int, settings: BenchSettings, data: Path
) -> Mapping[str, Any]:
    """Squared errors of one fold's held-out rows, by model: as measured ("drawn" is 0), and of each drawn arm."""
    name, split = GAINS[row]
    arm, rows, _ = SETS[name].load(data)
    used = learnable(arm, rows, settings.rows)
    place = (list(SETS).index(name), SPLITS.index(split))
    shuffle, *seeds = np.random.SeedSequence(settings.seed, spawn_key=place).spawn(1 + settings.folds)
    folds = folds_of(same_poses(used.joints), split, settings.folds, np.random.default_rng(shuffle))
    arms, refused = judged_fold(arm, used, folds[fold], settings.draws, seeds[fold])
    columns = {"drawn": np.repeat(np.arange(len(arms)), len(folds[fold][1])), "at": np.tile(folds[fold][1], len(arms))}
    columns |= {model: np.concatenate([squares[model] for squares in arms]) for model in arms[0]}
    counts = {"refused": refused, "rows": len(used), "rows_in_file": len(rows.joints)}
    return columns | {count: np.full(len(columns["at"]), value) for count, value in counts.items()}


def learnable(arm: Arm, rows: Observations, most: int) -> Measurements:
    """Poses or positions for a comparison of models: at most so many, equally spaced, without those that are far off.

    Raises:
        InputError: If something else was measured, from which no residual is learnt and no twin is made.
    """
    if not isinstance(rows, Measurements):
        raise InputError(f"{rows.source} holds {rows.kind}: only of poses and positions a twin is made")
    few = rows.select(equally_spaced(len(rows), most)) if len(rows) > most else rows
    return checked_rows(arm, few, few.select(np.arange(0)), known=few.frames == "known", robust=True)[0]


def folds_of(
    poses: RowNumbers, split: str, folds: int, rng: np.random.Generator
) -> list[tuple[RowNumbers, RowNumbers]]:
    """Rows to fit and held-out rows of each fold: random parts of a file, or contiguous ones, as ``split`` says."""
    count = int(poses.max()) + 1
    place = np.argsort(rng.permutation(count)) if split == "random" else np.arange(count)
    return contiguous_folds(np.zeros_like(poses), place[poses], folds)


def judged_fold(
    arm: Arm, data: Measurements, rows: tuple[RowNumbers, RowNumbers], draws: int, seed: np.random.SeedSequence
) -> tuple[list[Squares], int]:
    """Calibrate the measured arm and arms drawn from its twin on ``rows[0]``, and judge them on ``rows[1]``.

    The twin is made of the fitted rows alone. Its arms are draws from the posterior of geometry, terms and remainder,
    with the arm's own scatter, measured at the same joints with the instrument's scatter; a mean of the posterior
    would flatter every model.

    Returns:
        A list of squared errors, of the measured rows and then of each drawn arm; and the number of arms for which no
        calibration was found, and which other draws replaced.

    Raises:
        InputError: If the measured rows cannot be calibrated, or too many of the arms drawn.
    """
    first, drawing, *others = seed.spawn(2 + draws)
    fitted, held_out = (data.select(part) for part in rows)
    measured, result = left_by_models(arm, fitted, held_out, np.random.default_rng(first))
    plant, refused, arms = result.plant(), 0, [measured]
    for _ in range(BATCHES):
        population = draw_plants(plant, load_tolerances("medium"), draws, np.random.default_rng(drawing))
        for number, seed_of_arm in enumerate(others[: draws + 1 - len(arms)]):
            rng = np.random.default_rng(seed_of_arm)
            train, test = (as_measured(plant_at(population, number), part, rng) for part in (fitted, held_out))
            try:
                arms.append(left_by_models(arm, train, test, rng)[0])
            except InputError:
                refused += 1
        if len(arms) == draws + 1:
            return arms, refused
        drawing, *others = seed.spawn(1 + draws)
    raise InputError(f"{data.source}: {refused} arms drawn from the twin could not be calibrated")


# Rows of the table of measured robots, each with its spread: over random splits, between blocks, or over other poses.


@dataclass(frozen=True)
class SpreadRow:
    """One row of the table of measured robots.

    Attributes:
        name: Name of the set.
        how: Which rows judge: "random", "blocks", or "poses" of files of their own.
        terms: Terms, as `Choices` has them.
        residual: Residual model, as `Choices` has it.
        statistic: "rms" or "mean".
        remark: Remark beside the best model.
    """

    name: str
    how: Literal["random", "blocks", "poses"]
    terms: str = "none"
    residual: str = "none"
    statistic: Literal["rms", "mean"] = "rms"
    remark: str = ""

    @property
    def real(self) -> RealSet:
        """The robot's set that the row is about."""
        return SETS[self.name]

    @property
    def published(self) -> float | None:
        """What others published of these rows, mean in mm: of the other poses, where there are such."""
        return self.real.published if self.how == ("poses" if self.real.poses else "random") else None


SPREAD = {name: SpreadRow(**entry) for name, entry in TABLES["rows"].items()}
"""The rows of the table of measured robots by name, in its order."""


def model_errors(rng: np.random.Generator, row: str, settings: BenchSettings, data: Path) -> list[dict[str, Any]]:
    """Errors that nominal, geometric and best model leave, mm, with the ends of their spread; NaN for missing ones."""
    spread = SPREAD[row]
    arm, rows, poses = spread.real.load(data)
    choices = Choices(terms=spread.terms, residual=spread.residual)
    if spread.how == "random":
        seeds = np.random.SeedSequence(settings.seed).generate_state(settings.splits)
        results = [calibrate(arm, rows, choices=replace(choices, seed=int(seed))) for seed in seeds]
        values = np.array([_stated(spread.statistic, result)[:, 0] for result in results])
        table = np.stack([values.mean(axis=0), values.min(axis=0), values.max(axis=0)], axis=1)
        used = [result.best_model for result in results]
    else:
        judges = poses if spread.how == "poses" else None
        result = calibrate(arm, rows, test=judges, split="blocked", choices=choices)
        table, used = _stated(spread.statistic, result), list(result.held_out.used)
    models = "; ".join(
        name.removeprefix("geometry").replace("+", ", ").strip(", ") or "nothing added" for name in dict.fromkeys(used)
    )
    names = ("value_mm", "low_mm", "high_mm")
    return [
        {"model": model, **dict(zip(names, ends.tolist(), strict=True)), "used": models, "rows": len(rows.joints)}
        for model, ends in zip((NOMINAL, LS, "best"), table, strict=True)
    ]


def _stated(statistic: str, result: Result) -> Array:
    """Errors of nominal, geometric and best model, each with its 95 % interval ``(3, 3)``, mm."""
    models = [result.position[name] for name in (NOMINAL, GEOMETRIC, list(result.position)[-1])]
    return np.array(
        [[getattr(model, statistic), *(getattr(model, f"{statistic}_ci95") or (np.nan, np.nan))] for model in models]
    )


# All of them.

ROWS = (*GAINS, *SPREAD)
"""Every row that can be asked for."""

QUICK = ("gain_ur5_random", "gain_ur5_blocks", "ur5_random")


@dataclass(frozen=True, eq=False)
class Bench:
    """The results of a bench: errors that calibrations leave.

    Attributes:
        settings: How much was computed.
        gains: Predicted beside measured gains, as rows of the JSON file.
        models: Rows of measured robots: row, model, value and ends of each.
        skipped: Rows that were not made, and why.
    """

    settings: BenchSettings
    gains: list[dict[str, Any]]
    models: Rows
    skipped: Mapping[str, str]


def run_bench(
    rows: Sequence[str],
    settings: BenchSettings,
    data: Path,
    out: Path,
    *,
    workers: int = 1,
    progress: Progress | None = None,
) -> Bench:
    """Make the given rows, or go on making them.

    Args:
        rows: Some of `ROWS`.
        settings: How much is computed.
        data: Folder of the data sets.
        out: Folder for results.
        workers: Processes.
        progress: Called with (experiment, pieces done, pieces in all).

    Raises:
        InputError: If a row has no such name, or none has data.
    """
    skipped: dict[str, str] = {}
    for name in rows:
        if name not in ROWS:
            raise InputError(f"unknown row '{name}'; give some of {', '.join(ROWS)}")
        try:
            _set_of(name).paths(data)
        except InputError as error:
            skipped[name] = str(error)
    if len(skipped) == len(rows):
        raise InputError(next(iter(skipped.values()), "no rows were asked for"))

    def refuse(levels: Mapping[str, Any], error: InputError) -> None:
        skipped[levels["row"]] = str(error)

    def made(title: str, kinds: Mapping[str, object], measure: Any, **units: Sequence[int]) -> Rows:
        names = [name for name in rows if name in kinds and name not in skipped]
        if not names:
            return Rows({})
        inputs = partial(_inputs, settings=settings, data=data)
        experiment = Experiment(title, units, {"row": names}, measure, settings.seed, inputs)
        backend = "serial" if workers == 1 else "loky"
        return run(experiment, out / title, backend=backend, workers=workers, progress=progress, refused=refuse)

    folds = made("gains", GAINS, partial(fold_errors, settings=settings, data=data), fold=range(settings.folds))
    gains = [gain for (row,) in folds.levels("row") if row not in skipped for gain in gains_of(folds.where(row=row))]
    models = made("models", SPREAD, partial(model_errors, settings=settings, data=data))
    return Bench(settings, gains, models, skipped)


def _set_of(row: str) -> RealSet:
    return SETS[SPREAD[row].name if row in SPREAD else GAINS[row][0]]


def _inputs(row: str, settings: BenchSettings, data: Path, **_: int) -> tuple[Any, ...]:
    """The inputs that a row's figures depend on beside the code."""
    files = [file_sha256(path) for paths in _set_of(row).paths(data) for path in paths]
    return (settings, _set_of(row), SPREAD.get(row), files)


def gains_of(folds: Rows) -> list[dict[str, Any]]:
    """The gain of every model over all folds of one set and split, as rows of the JSON file.

    All intervals are at 95 %. That of the measured gain is over rows for random folds, or over ten blocks of the file,
    since neighbours in a block are alike; that of the predicted gain is for one more drawn arm.

    Args:
        folds: Rows of `fold_errors`.
    """
    name, split = GAINS[folds["row"][0]]
    measured, arm_numbers = folds.where(drawn=0), range(1, int(folds["drawn"].max()) + 1)
    order = np.argsort(measured["at"])
    squares = {model: measured[model][order] for model in (NOMINAL, *BEFORE) if model in measured.columns}
    parts = [[folds.where(fold=fold, drawn=arm) for arm in arm_numbers] for (fold,) in folds.levels("fold")]
    sums = {model: np.array([[part[model].sum() for part in fold] for fold in parts]) for model in squares}
    rms = {model: float(1e3 * np.sqrt(values.mean())) for model, values in squares.items()}
    counts = {name: int(folds[name][0]) for name in ("rows", "rows_in_file")}
    counts["refused_draws"] = sum(int(fold[0]["refused"][0]) for fold in parts)
    gains = []
    for model, before in BEFORE.items():
        pairs = np.stack([squares[model], squares[before]], axis=-1)
        if split != "random":
            pairs = np.array([part.sum(axis=0) for part in np.array_split(pairs, min(BLOCKS, len(pairs)))])
        predicted, ends = predicted_gain(sums[model], sums[before])
        predicted_mm = float(1e3 * np.sqrt(sums[model].sum() / len(arm_numbers) / len(order)))
        gains.append(
            {"robot": SETS[name].robot, "split": split, "model": model, "before": before, "statistic": "rms", **counts}
            | {"nominal_mm": rms[NOMINAL], "before_mm": rms[before], "held_out_mm": rms[model]}
            | {"measured_reduction": 1.0 - rms[model] / rms[before], "ci95": _interval(pairs, split)}
            | {"predicted_reduction": predicted, "predicted_ci95": ends, "predicted_mm": predicted_mm}
        )
    return gains


def _interval(pairs: Array, split: str) -> Ends | None:
    """The interval of the removed share of the RMS, from squares after and before ``(n, 2)`` of rows or ordered blocks.

    It is computed on the logarithm of the share left, which is less skewed.
    """
    ends = statistic_interval(pairs, lambda some: 0.5 * np.log(np.divide(*some.sum(axis=0))), ordered=split == "blocks")
    return None if ends is None else (float(-np.expm1(ends[1])), float(-np.expm1(ends[0])))


def predicted_gain(after: Array, before: Array) -> tuple[float, Ends | None]:
    """The mean gain of drawn arms, and the interval in which one more arm's gain would lie.

    The twins of the folds differ and their arms are drawn apart, so the gain of one arm varies by the sum of what it
    varies by from arm to arm of each fold's twin (first order in the squares), with folds (draws - 1) degrees of
    freedom.

    Args:
        after: Sums of squared errors that the model leaves ``(folds, draws)``.
        before: Sums of squared errors that the step before leaves.
    """
    folds, draws = after.shape
    gain = float(np.mean(1.0 - np.sqrt(after.sum(axis=0) / before.sum(axis=0))))
    if draws < 2:
        return gain, None
    from scipy.special import stdtrit

    slope = 0.5 * (1.0 - gain) * (after / after.sum(axis=0).mean() - before / before.sum(axis=0).mean())
    deviation = float(np.sqrt(slope.var(axis=1, ddof=1).sum() * (1.0 + 1.0 / draws)))
    half = float(stdtrit(folds * (draws - 1), 0.975)) * deviation
    return gain, (gain - half, gain + half)
