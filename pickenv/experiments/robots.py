"""Errors that calibrations leave on measured robots, beside the errors that twins (arms fitted to the data) predict.

There are two experiments, each in a folder of its own. "gains" splits a robot's rows into folds, each held out in turn.
It computes squared errors of the held-out rows, as measured and on arms drawn from a twin of the other rows. "models"
computes the table of measured robots: the errors of several models for each row of the table, with their spread. Every
piece of an experiment has a random stream of its own, so its results do not depend on what else is run. SI units; mm
where names say so.
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
from pickenv.calibration.model import observations
from pickenv.calibration.model.observations import Rows as RowNumbers
from pickenv.calibration.pipeline.fitting import GEOMETRIC
from pickenv.experiments.engine import Experiment, Progress, Rows, run
from pickenv.experiments.gains import LEARNT, LS, NOMINAL, TERMS, Squares, as_measured, left_by_models


@dataclass(frozen=True)
class RealSet:
    """The data files of one measured robot.

    Attributes:
        robot: Name of the robot in tables.
        arm: Arm name or file; {} stands for the folder of the data sets.
        columns: Description of the files' columns: a name, or a path.
        files: Glob pattern of the files of measured rows, below the folder of the data sets.
        poses: Glob pattern of the files of separate test poses; empty if there are none.
        published: Mean error that others published, mm: at the test poses, or at the rows if there are no test poses.
        twinned: Whether twins and learnt residuals are computed from this set. The set needs poses or positions for
            this, and enough rows for five folds.
    """

    robot: str
    arm: str
    columns: str
    files: str
    poses: str = ""
    published: float | None = None
    twinned: bool = False

    def paths(self, data: Path) -> tuple[list[Path], list[Path]]:
        """Return the files of the rows, and the files of the test poses.

        Raises:
            InputError: If a pattern matches no file.
        """
        both = [sorted(data.glob(pattern)) if pattern else [] for pattern in (self.files, self.poses)]
        for pattern, files in zip((self.files, self.poses), both, strict=True):
            if pattern and not files:
                raise InputError(f"no {pattern} in {data}; name the folder of the data sets in PICKENV_DATA")
        return both[0], both[1]

    def load(self, data: Path) -> tuple[Arm, Observations, Observations | None]:
        """Read the arm, the rows and the test poses (None if there are none).

        Marks of repeated measurements in a file are discarded, since most files have none.

        Args:
            data: Folder of the data sets.

        Raises:
            InputError: If there are no such files, or they cannot be read.
        """
        arm = load_arm(self.arm.format(data))
        rows, poses = (
            read_observations(files, arm.nominal, self.columns) if files else None for files in self.paths(data)
        )
        assert rows is not None
        return arm, replace(rows, origins=replace(observations.origins_of(rows), repeat=None)), poses  # type: ignore[type-var]


TABLES: dict[str, Any] = tomllib.loads(Path(__file__).with_name("robots.toml").read_text(encoding="utf-8"))
SETS = {name: RealSet(**entry) for name, entry in TABLES["sets"].items()}
"""The data files of every measured robot, by name."""


# Folds of a set, and arms drawn from the twin of each.

SPLITS = ("random", "blocks")
GAINS = {f"gain_{name}_{split}": (name, split) for name in SETS if SETS[name].twinned for split in SPLITS}
"""Rows that compare predicted with measured gains: for each row's name, the data set and how it is split."""

BEFORE = {LS: NOMINAL, TERMS: LS, **dict.fromkeys(LEARNT, LS)}
"""For each model, the reference model: a reduction of the error is relative to the reference model's error."""

BATCHES = 4
"""Largest number of batches of arms drawn from a twin; later batches replace arms that cannot be calibrated."""


@dataclass(frozen=True)
class BenchSettings:
    """Sizes of the computations of the bench, and its seed.

    Attributes:
        rows: Largest number of rows of a data set that gains are computed from, equally spaced in the set.
        folds: Number of folds, that is parts of these rows, each of which is held out in turn.
        draws: Number of arms drawn from each fold's twin.
        splits: Number of random splits of a data set in the table of measured robots.
        seed: Seed of all random numbers.
    """

    rows: int = 600
    folds: int = 5
    draws: int = 2
    splits: int = 10
    seed: int = 0

    @staticmethod
    def quick() -> BenchSettings:
        """Return settings of a small bench, which takes about a minute for the rows of the UR5."""
        return BenchSettings(rows=160, folds=2)


def fold_errors(
    rng: np.random.Generator, row: str, fold: int, settings: BenchSettings, data: Path
) -> Mapping[str, Any]:
    """Compute squared errors of one fold's held-out rows, for the measured arm and for arms drawn from the fold's twin.

    Args:
        rng: Not used; random numbers depend on the seed in ``settings``, on ``row`` and on ``fold``.
        row: Name of a row of the bench's table, a key of `GAINS`. It selects a data set and a kind of split.
        fold: Index of the fold (the part of the rows that is held out), from 0.
        settings: Sizes of the computation, and its seed.
        data: Folder of the data sets.

    Returns:
        Columns with one entry per arm and held-out row. "drawn" is 0 for the measured arm, else the number of the drawn
        arm, from 1. "at" is the index of the held-out row, from 0. Each model has a column of its squared errors, m^2.
        Three columns have the same number everywhere: "refused" (drawn arms that could not be calibrated), "rows" (rows
        of all folds) and "rows_in_file".
    """
    name, split = GAINS[row]
    arm, rows, _ = SETS[name].load(data)
    used = learnable(arm, rows, settings.rows)
    place = (list(SETS).index(name), SPLITS.index(split))
    shuffle, *seeds = np.random.SeedSequence(settings.seed, spawn_key=place).spawn(1 + settings.folds)
    folds = folds_of(observations.same_poses(used.joints), split, settings.folds, np.random.default_rng(shuffle))
    arms, refused = judged_fold(arm, used, folds[fold], settings.draws, seeds[fold])
    columns = {"drawn": np.repeat(np.arange(len(arms)), len(folds[fold][1])), "at": np.tile(folds[fold][1], len(arms))}
    columns |= {model: np.concatenate([squares[model] for squares in arms]) for model in arms[0]}
    counts = {"refused": refused, "rows": len(used), "rows_in_file": len(rows.joints)}
    return columns | {count: np.full(len(columns["at"]), value) for count, value in counts.items()}


def learnable(arm: Arm, rows: Observations, most: int) -> Measurements:
    """Return at most ``most`` equally spaced rows without outliers, from which residuals and twins can be computed.

    Raises:
        InputError: If the rows are neither poses nor positions.
    """
    if not isinstance(rows, Measurements):
        raise InputError(f"{rows.source} holds {rows.kind}: only of poses and positions a twin is made")
    few = rows.select(observations.equally_spaced(len(rows), most)) if len(rows) > most else rows
    return checked_rows(arm, few, few.select(np.arange(0)), known=few.frames == "known", robust=True)[0]


def folds_of(
    poses: RowNumbers, split: str, folds: int, rng: np.random.Generator
) -> list[tuple[RowNumbers, RowNumbers]]:
    """Split rows into folds; return for each fold the indices, from 0, of the rows to fit, and of the held-out rows.

    Args:
        poses: Index of the pose of each row ``(N,)``; rows of one pose stay in one fold.
        split: "random": the folds are random poses. "blocks": each fold is a contiguous part of the rows.
        folds: Number of folds.
        rng: Random numbers for the split.
    """
    count = int(poses.max()) + 1
    place = np.argsort(rng.permutation(count)) if split == "random" else np.arange(count)
    return observations.contiguous_folds(np.zeros_like(poses), place[poses], folds)


def judged_fold(
    arm: Arm, data: Measurements, rows: tuple[RowNumbers, RowNumbers], draws: int, seed: np.random.SeedSequence
) -> tuple[list[Squares], int]:
    """Calibrate the measured arm, and arms drawn from its twin, on the fitted rows; judge them on the held-out rows.

    The twin is made from the fitted rows alone. Arms are drawn from the posterior of the twin's geometry, parametric
    terms and remaining errors, with the scatter of the measured arm. The drawn arms are measured at the same joints
    with the instrument's scatter. An arm at the posterior mean would make every model look too good.

    Args:
        arm: The arm.
        data: The measured rows of the arm.
        rows: Indices, from 0, of the fitted rows, and of the held-out rows.
        draws: Number of arms drawn from the twin.
        seed: Seed of all random numbers.

    Returns:
        Two values. The first is a list of the squared errors of the held-out rows: of the measured arm, then of each
        drawn arm. The second is the number of drawn arms that were replaced because they could not be calibrated.

    Raises:
        InputError: If the measured rows, or too many of the drawn arms, cannot be calibrated.
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
    """Definition of one row of the table of measured robots.

    Attributes:
        name: Name of the robot's data set in `SETS`.
        how: Held-out rows: "random" (of random splits), "blocks" (each contiguous part of the rows in turn), or "poses"
            (separate test poses).
        terms: Parametric terms of the best model, "none" or as for `Choices`.
        residual: Residual model of the best model, "none" or as for `Choices`.
        statistic: Statistic of the position errors: "rms" or "mean".
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
        """Data files of the robot."""
        return SETS[self.name]

    @property
    def published(self) -> float | None:
        """Published mean error, mm; None if no error was published for the held-out rows of ``how``.

        A published error is for the separate test poses if the data set has some, else for random splits of the rows.
        """
        return self.real.published if self.how == ("poses" if self.real.poses else "random") else None


SPREAD = {name: SpreadRow(**entry) for name, entry in TABLES["rows"].items()}
"""The rows of the table of measured robots by name, in the table's order."""


def model_errors(rng: np.random.Generator, row: str, settings: BenchSettings, data: Path) -> list[dict[str, Any]]:
    """Return the errors of nominal arm, least squares and best model, mm, as one mapping per model.

    Over random splits, "value_mm" is the mean error, and "low_mm" and "high_mm" are the smallest and the largest.
    Otherwise "low_mm" and "high_mm" are the ends of the 95 % interval, NaN if there is none.

    Args:
        rng: Not used; random numbers depend on the seed of ``settings`` alone.
        row: Name of the row in `SPREAD`.
        settings: Sizes of the computation, and its seed.
        data: Folder of the data sets.
    """
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
        result = calibrate(arm, rows, test=judges, split="random" if judges is not None else "blocked", choices=choices)
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
    """Return the errors of nominal, geometric and best model, mm, each with the ends of its 95 % interval.

    The result ``(3, 3)`` has one row per model: error, lower and upper end. Ends are NaN if there is no interval. The
    ``statistic`` of the position errors is "rms" or "mean".
    """
    models = [result.position[name] for name in (NOMINAL, GEOMETRIC, list(result.position)[-1])]
    return np.array(
        [[getattr(model, statistic), *(getattr(model, f"{statistic}_ci95") or (np.nan, np.nan))] for model in models]
    )


# All of them.

ROWS = (*GAINS, *SPREAD)
"""Names of all rows that the bench can compute."""

QUICK = ("gain_ur5_random", "gain_ur5_blocks", "ur5_random")


def run_bench(
    rows: Sequence[str],
    settings: BenchSettings,
    data: Path,
    out: Path,
    *,
    workers: int = 1,
    progress: Progress | None = None,
) -> tuple[list[dict[str, Any]], Rows, dict[str, str]]:
    """Compute rows of the bench's tables; an interrupted run continues.

    Args:
        rows: Names of rows of the bench's tables, from `ROWS`.
        settings: Sizes of the computations, and the seed.
        data: Folder of the data sets.
        out: Folder for results, with a subfolder for each of the two experiments.
        workers: Number of processes.
        progress: Called with (name of the experiment, pieces done, total number of pieces).

    Returns:
        Three values. The first has the predicted and measured gains, from `gains_of`. The second has the numbers of the
        table of measured robots, from `model_errors`, with the column "row". The third has the reasons why rows were
        not computed, by the name of the row.

    Raises:
        InputError: If a name is unknown, or none of the rows has data.
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
    return gains, made("models", SPREAD, partial(model_errors, settings=settings, data=data)), skipped


def _set_of(row: str) -> RealSet:
    return SETS[SPREAD[row].name if row in SPREAD else GAINS[row][0]]


def _inputs(row: str, settings: BenchSettings, data: Path, **_: int) -> tuple[Any, ...]:
    """Return the inputs, besides the code, that the results for ``row`` (a name in `ROWS`) depend on."""
    files = [file_sha256(path) for paths in _set_of(row).paths(data) for path in paths]
    return (settings, _set_of(row), SPREAD.get(row), files)


def gains_of(folds: Rows) -> list[dict[str, Any]]:
    """Compute the predicted and the measured gain of every model, as rows of the JSON file (see `bench_json`).

    A gain is the share of the RMS error that a model removes. All intervals are at 95 %. With random folds, the
    interval of a measured gain is over rows. With contiguous folds, it is over ten contiguous parts of the rows, since
    neighbouring rows are alike. The interval of a predicted gain is for the gain of one more drawn arm.

    Args:
        folds: Rows of `fold_errors` for all folds of one data set, split in one way.
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
            pairs = np.array([part.sum(axis=0) for part in np.array_split(pairs, min(observations.BLOCKS, len(pairs)))])
        predicted, ends = predicted_gain(sums[model], sums[before])
        predicted_mm = float(1e3 * np.sqrt(sums[model].sum() / len(arm_numbers) / len(order)))
        gains.append(
            {"row": str(folds["row"][0]), "robot": SETS[name].robot, "split": split, "model": model, "before": before}
            | {"statistic": "rms", **counts}
            | {"nominal_mm": rms[NOMINAL], "before_mm": rms[before], "held_out_mm": rms[model]}
            | {"measured_reduction": 1.0 - rms[model] / rms[before], "ci95": _interval(pairs, split)}
            | {"predicted_reduction": predicted, "predicted_ci95": ends, "predicted_mm": predicted_mm}
        )
    return gains


def _interval(pairs: Array, split: str) -> Ends | None:
    """Return the 95 % interval of the share of the RMS error that a model removes; None with too few rows.

    The interval is computed for the logarithm of the remaining share, which is less skewed than the share.

    Args:
        pairs: Squared errors ``(n, 2)``, m^2, of random rows, or of contiguous parts in order. The first column is for
            the model, the second for the reference model.
        split: "random" or "blocks".
    """
    ends = statistic_interval(pairs, lambda some: 0.5 * np.log(np.divide(*some.sum(axis=0))), ordered=split == "blocks")
    return None if ends is None else (float(-np.expm1(ends[1])), float(-np.expm1(ends[0])))


def predicted_gain(after: Array, before: Array) -> tuple[float, Ends | None]:
    """Compute the mean gain of drawn arms, and the 95 % prediction interval for the gain of one more drawn arm.

    Each fold has a twin of its own, from which arms are drawn independently. To first order in the squared errors, the
    variance of the gain is therefore the sum, over folds, of the variance between the arms of a fold's twin. This
    variance has folds * (draws - 1) degrees of freedom.

    Args:
        after: Sums of squared errors that the model leaves ``(folds, draws)``, m^2.
        before: Sums of squared errors of the reference model ``(folds, draws)``, m^2.

    Returns:
        Two values. The first is the gain, a share of at most 1, which is below 0 for a loss. The second is the ends of
        the gain's interval, None with fewer than two draws.
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
