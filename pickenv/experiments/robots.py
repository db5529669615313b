"""Errors that calibrations leave on measured robots: beside twins' predictions, in the table of results, beside peers.

Three experiments, each in a folder of its own. "gains" are of folds of a robot's rows: squared errors of the rows held
out, measured, and on arms drawn from the twin of the other rows. "models" are rows of the table of measured robots,
each model with its spread. "peers" are errors of other people's packages on the UR5's rows. Every piece has a random
stream of its own, so that figures are the same whatever is run beside it. SI units; mm where names say so.
"""

from __future__ import annotations

import json
import os
import shlex
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np

import pickenv
from pickenv.arm import Arm, Array, Geometry, Pose, draw_plants, load_arm, load_tolerances, plant_at
from pickenv.arm.files.urdf import urdf_text
from pickenv.base import Ends, InputError, command_line, file_sha256, statistic_interval
from pickenv.calibration import (
    Choices,
    Measurements,
    Observations,
    Result,
    align,
    calibrate,
    complete_model,
    frames_model,
    identify,
    read_observations,
)
from pickenv.calibration.identification.diagnosis import checked_rows
from pickenv.calibration.model.observations import (
    BLOCKS,
    Rows as RowNumbers,
    contiguous_folds,
    equally_spaced,
    random_split,
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
        """The arm, the rows and the other poses.

        Raises:
            InputError: If there are no such files, or they cannot be read.
        """
        arm = load_arm(self.arm.format(data))
        rows, poses = (
            read_observations(files, arm.nominal, self.columns) if files else None for files in self.paths(data)
        )
        assert rows is not None
        return arm, rows, poses


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


# Other people's calibrations of the UR5 on the same rows, each in its own process and Python environment: 800 positions
# of a seeded shuffle for the fit, 200 held out, and the data set's own 20 random poses (Jacobi 2025). Base and tool are
# fitted already for those that cannot do it. What drives each package lies in scripts/peers of a checkout.

OURS, PEER_SET = "pickenv", "ur5"
"""Name of this package among the peers, and the set that they are judged on."""

WORKERS = Path(pickenv.__file__).parents[1] / "scripts" / "peers"
HELD_OUT = 200
LIMIT = 900.0
"""Seconds that one peer may take."""


@dataclass(frozen=True)
class Peer:
    """A package from PyPI that is compared with pickenv.

    Attributes:
        name: Its name on PyPI.
        version: The pinned version.
        method: Its method in words, for the table.
        poses: Poses that it is given, or None for all of the training rows.
        runs: How often it is repeated.
    """

    name: str
    version: str
    method: str
    poses: int | None = None
    runs: int = 3


PEERS = tuple(Peer(**entry) for entry in TABLES["peers"])


@dataclass(frozen=True, eq=False)
class PeerTask:
    """The data that peers are compared on.

    Attributes:
        nominal: The arm as its maker describes it.
        train: Rows for the fit.
        held_out: Rows held out.
        random: The data set's random poses.
    """

    nominal: Geometry
    train: Measurements
    held_out: Measurements
    random: Measurements

    def first(self, poses: int | None) -> PeerTask:
        """The task with only the first ``poses`` training rows; all of them for None."""
        return self if poses is None else replace(self, train=self.train.select(np.arange(poses)))


def read_peer_task(data: Path, seed: int) -> PeerTask:
    """Read the UR5 set and split it."""
    arm, grid, random = SETS[PEER_SET].load(data)
    assert isinstance(grid, Measurements) and isinstance(random, Measurements)
    train, held_out = random_split(same_poses(grid.joints), HELD_OUT, np.random.default_rng(seed))
    return PeerTask(arm.nominal, grid.select(train), grid.select(held_out), random)


def accuracy_on(geometry: Geometry, task: PeerTask) -> dict[str, float]:
    """Errors on the rows that the fit has not seen, mm."""
    held_out, random = (
        np.linalg.norm(rows.difference(geometry), axis=1) * 1e3 for rows in (task.held_out, task.random)
    )
    return {"held_out_rms_mm": float(np.sqrt(np.mean(held_out**2))), "random_poses_mean_mm": float(np.mean(random))}


def peer_problem(task: PeerTask, start: Geometry, runs: int) -> dict[str, Any]:
    """The problem that a peer's worker process reads; see scripts/peers/problem.py."""
    names = tuple(f"joint_{i + 1}" for i in range(start.joints))
    descriptions = [urdf_text(replace(arm, joint_names=names), "arm") for arm in (start, task.nominal)]
    rows = {"": task.train, "held_out_": task.held_out, "random_": task.random}
    problem: dict[str, Any] = {name: getattr(start, name).tolist() for name in ("alpha", "a", "theta", "d")}
    problem |= {"base": homogeneous(start.base), "tool": homogeneous(start.tool), "runs": runs}
    problem |= dict(zip(("urdf", "nominal_urdf"), descriptions, strict=True))
    for prefix, part in rows.items():
        problem |= {f"{prefix}joints": part.joints.tolist(), f"{prefix}position": part.position.tolist()}
    return problem


def homogeneous(pose: Pose) -> list[list[float]]:
    """A pose as a homogeneous matrix."""
    upper = np.concatenate([pose.rotation, pose.position[:, None]], axis=1)
    return [*upper.tolist(), [0.0, 0.0, 0.0, 1.0]]


def peer_python(peer: Peer, folder: Path, install: bool) -> Path:
    """The Python of the peer's own environment, which is made if it is missing and ``install`` is true.

    Raises:
        InputError: If the environment is missing, or cannot be made; then with the installer's last words.
    """
    home = folder.resolve() / f"{peer.name}-{peer.version}"
    python = home / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
    done = home / "installed"
    if done.is_file():
        return python
    if not install:
        how = "python scripts/benchmark_calibration.py installs it there"
        raise InputError(f"{peer.name} {peer.version} is not installed in {folder}; {how}")
    install_line = command_line(
        python, "-m", "pip", "install", f"{peer.name}=={peer.version}", quiet=True, disable_pip_version_check=True
    )
    for command in (command_line(sys.executable, "-m", "venv", home, clear=True), install_line):
        ended = subprocess.run(shlex.split(command), capture_output=True, text=True)
        if ended.returncode:
            raise InputError(f"cannot be installed: {last_words(ended.stderr or ended.stdout)}")
    done.touch()
    return python


def run_peer(
    peer: Peer, task: PeerTask, start: Geometry, folder: Path, *, limit: float = LIMIT, install: bool = False
) -> dict[str, Any]:
    """Run a peer in its own process.

    Args:
        peer: The peer.
        task: The data; the peer is given as many rows as it can take.
        start: The arm with base and tool fitted.
        folder: Where the peers' environments are kept.
        limit: Seconds that it may take.
        install: Whether to install the peer there if it is not installed yet.

    Raises:
        InputError: If it cannot be installed, fails, or takes longer than ``limit`` seconds.
    """
    python = peer_python(peer, folder, install)
    with tempfile.TemporaryDirectory() as scratch:
        problem, answer = Path(scratch) / "problem.json", Path(scratch) / "result.json"
        problem.write_text(json.dumps(peer_problem(task, start, peer.runs)), encoding="utf-8")
        command = [python, WORKERS / f"run_{peer.name}.py", problem, answer]
        clean = {key: value for key, value in os.environ.items() if not key.startswith("PYTHON")}
        try:
            ended = subprocess.run(command, capture_output=True, text=True, timeout=limit, cwd=scratch, env=clean)
        except subprocess.TimeoutExpired:
            raise InputError(f"not done after {limit:g} s") from None
        if ended.returncode or not answer.is_file():
            raise InputError(f"failed: {last_words(ended.stderr)}")
        result: dict[str, Any] = json.loads(answer.read_text(encoding="utf-8"))
    remark = result.pop("remark")
    return result | {"version": peer.version, "note": peer.method + (f"; {remark}" if remark else "")}


def last_words(text: str) -> str:
    """The last line of a text that mentions an error, or else its last line that is not blank."""
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    errors = [line for line in lines if "error" in line.lower()]
    return (errors or lines or ["without a word"])[-1]


def judged_peer(peer: Peer | None, data: Path, folder: Path) -> dict[str, Any]:
    """Errors of a peer, or of our own least squares where it is None, on the same rows, mm.

    "nominal" names the errors with only base and tool fitted.

    Raises:
        InputError: If the data are missing, or the peer is not installed, fails, or takes too long.
    """
    task = read_peer_task(data, 0).first(None if peer is None else peer.poses)
    start = align(task.nominal, task.train, frames_model(task.nominal)).geometry
    if peer is None:
        fitted = identify(complete_model(task.nominal), start, task.train).geometry
        errors: dict[str, Any] = {**accuracy_on(fitted, task), "note": "least squares"}
    else:
        errors = run_peer(peer, task, start, folder)
    return {**errors, "nominal": accuracy_on(start, task)}


PEER_ROWS = {f"peer_{name}": name for name in (OURS, *(peer.name for peer in PEERS))}


def peer_errors(rng: np.random.Generator, row: str, data: Path, peers: Path) -> list[dict[str, Any]]:
    """Errors of a peer, or of our least squares, on the held-out rows (RMS) and on the other poses (mean), mm."""
    errors = judged_peer(next((peer for peer in PEERS if peer.name == PEER_ROWS[row]), None), data, peers)
    keys = {"random": "held_out_rms_mm", "poses": "random_poses_mean_mm"}
    return [
        {"split": split, "nominal_mm": errors["nominal"][key], "held_out_mm": errors[key], "note": errors["note"]}
        for split, key in keys.items()
    ]


# All of them.

ROWS = (*GAINS, *SPREAD, *PEER_ROWS)
"""Every row that can be asked for."""

QUICK = ("gain_ur5_random", "gain_ur5_blocks", "ur5_random")


@dataclass(frozen=True, eq=False)
class Bench:
    """The results of a bench: errors that calibrations leave.

    Attributes:
        settings: How much was computed.
        gains: Predicted beside measured gains, as rows of the JSON file.
        models: Rows of measured robots: row, model, value and ends of each.
        peers: Errors of peers on the UR5's rows: row, split, and errors before (nominal) and after (left).
        skipped: Rows that were not made, and why.
    """

    settings: BenchSettings
    gains: list[dict[str, Any]]
    models: Rows
    peers: Rows
    skipped: Mapping[str, str]


def run_bench(
    rows: Sequence[str],
    settings: BenchSettings,
    data: Path,
    out: Path,
    peers: Path,
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
        peers: Folder of the peers' environments.
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
    others = made("peers", PEER_ROWS, partial(peer_errors, data=data, peers=peers))
    return Bench(settings, gains, models, others, skipped)


def _set_of(row: str) -> RealSet:
    return SETS[SPREAD[row].name if row in SPREAD else GAINS[row][0] if row in GAINS else PEER_SET]


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
            bench_row("gains", SETS[name].robot, split, model, rms[NOMINAL], rms[before], rms[model])
            | {"before": before, "ci95": _interval(pairs, split), "statistic": "rms", **counts}
            | {"predicted_reduction": predicted, "predicted_ci95": ends, "predicted_mm": predicted_mm}
        )
    return gains


def bench_row(
    table: str, robot: str, split: str, model: str, nominal: float, before: float, left: float
) -> dict[str, Any]:
    """The keys that every row of the JSON file has; errors in mm, of the nominal arm, the step before and the model."""
    names = {"table": table, "robot": robot, "split": split, "model": model, "before": NOMINAL}
    sizes = {"nominal_mm": nominal, "before_mm": before, "held_out_mm": left, "measured_reduction": 1.0 - left / before}
    return names | sizes | dict.fromkeys(("published_mm", "predicted_reduction", "ci95"))


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
