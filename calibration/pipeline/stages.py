"""The calibration pipeline: from measured rows of any kind to a calibration result.

Its stages are, in order: check the rows, identify base, tool and geometry, add terms, and learn the errors that remain.
Reading comes before these stages, judgement after them. "Nominal" errors are those of the nominal arm after base and
tool were fitted, so that they do not contain the instrument's placement. Terms and residual model are chosen within the
training rows. Held-out errors therefore come from rows that no choice has used.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pickenv.arm import Arm, Array, Geometry, load_arm
from pickenv.base import InputError
from pickenv.base.registry import names
from pickenv.calibration.identification.diagnosis import LeftOut, checked_rows, refuse_trained, without_blind_views
from pickenv.calibration.identification.robust import by_set_up, placed, scene_of, stations_of
from pickenv.calibration.identification.solve import solve
from pickenv.calibration.identification.term_choice import TermChoice, choose_terms, identify_terms, terms_of
from pickenv.calibration.model import observations
from pickenv.calibration.model.arm_model import CARRIER, ArmModel, pose_carrier
from pickenv.calibration.model.measurements import FRAMES, OWN, Frames, InstrumentStation, Measurements, Stacked
from pickenv.calibration.model.noise_and_priors import FIT_WORDS, noise_of, prior_model
from pickenv.calibration.model.observations import Observations, Rows, origins_of, pose_count
from pickenv.calibration.model.terms import kind_of_term
from pickenv.calibration.pipeline import fitting
from pickenv.calibration.pipeline.result import Result, assess, workspace_joints
from pickenv.calibration.reading.description import load_description
from pickenv.calibration.reading.read import joints_of, read_observations, read_scene, read_targets
from pickenv.calibration.residuals import residual_models
from pickenv.calibration.residuals.bpnn import BpnnSettings

# What a calibration may be asked for, and what does not go with what was measured.


@dataclass(frozen=True)
class Choices:
    """Options of a calibration: which terms, residual model, frames and priors it uses, and how it treats outliers.

    Attributes:
        terms: Parametric effects that are not geometric: "auto", names joined by "+" such as "gravity+periodic", or
            "none".
        residual: "auto", the name of a residual model such as "gp", or "none".
        force: Whether a named residual model is used although it does not improve held-out errors, or cannot be judged
            because there are fewer than 40 poses.
        robust: Whether outlier rows are left out. They are listed in either case.
        seed: Seed of all random draws.
        frames: Whether base and tool are "known" or "fitted". None takes the choice that the data state.
        learn_from: Poses from which the named residual model learns; it is then always used, as in the paper. If None,
            the model learns from the training rows, and is used if it improves errors there.
        settings: Settings of the network "bpnn" that learns from ``learn_from``; None takes the paper's settings.
        fit: One of `pickenv.calibration.model.noise_and_priors.FIT_WORDS`. "auto" fits all parameters with priors.
            "offsets" fits the joint zeros, and base and tool if unknown. "full" fits all parameters without priors, as
            the papers do.
        tolerances: Name or path of the tolerance class that sets the priors of the arm's parts. None takes the arm's
            own class; for an arm without a class, the class of a cobot.
        prior_scale: Factor on the standard deviations of the parts' priors. None estimates factors from the rows.
        workspace: The region for which the verdict holds (`pickenv.calibration.pipeline.result.workspace_joints`).
            None takes all poses within the joint limits.
    """

    terms: str = "auto"
    residual: str = "auto"
    force: bool = False
    robust: bool = True
    seed: int = 0
    frames: Frames | None = None
    learn_from: Measurements | None = None
    settings: BpnnSettings | None = None
    fit: str = "auto"
    tolerances: str | None = None
    prior_scale: float | None = None
    workspace: str | None = None


def refuse_options(train: Observations, choices: Choices) -> None:
    """Refuse options that do not apply to the kind of measurement that the rows hold.

    Args:
        train: The training rows, of another kind than poses or positions of one station.
        choices: The options.

    Raises:
        InputError: If such an option is set; the message names it.
    """
    learnt = choices.residual not in ("auto", "none")
    tracked = all(part.poses is not None for part in train.parts)
    known = choices.frames == "known"
    if known or (learnt and not tracked):
        option = "`frames='known'`" if known else f"`residual='{choices.residual}'`"
        single, several = (" of one station", " of several") if tracked else ("", "")
        raise InputError(
            f"{option} is for poses and positions{single}, but {train.source} holds {train.kind}{several}; leave it out"
        )


def _refuse_idle(choices: Choices, arm: Arm) -> None:
    """Refuse options that have no effect, because another option or the use of tool poses rules them out.

    Raises:
        InputError: If such an option is set; the message names it.
    """
    by_priors = [name for name in ("tolerances", "prior_scale", "workspace") if getattr(choices, name) is not None]
    if by_priors and choices.fit == "full":
        raise InputError(f"`fit='full'` expects nothing of the parts, so `{by_priors[0]}` says nothing; leave one out")
    of_parts = [f"fit='{choices.fit}'"] * (choices.fit != "auto") + by_priors
    if of_parts and arm.name == CARRIER:
        raise InputError(f"`{of_parts[0]}` is of an arm's parts, and finished poses have none; leave it out")
    if choices.force and choices.residual in ("auto", "none"):
        raise InputError("`force` is for a named residual model; name one as `residual`, or leave `force` out")


Data = Observations | str | Path | Sequence[str | Path] | Sequence[Observations]
"""Measured rows: one data set (`Observations`, such as `Measurements`) or several, or the paths of files with them."""

Columns = str | Path | Sequence[str | Path] | None
"""Name or path of a description of the files' columns, or one for each file; None means pickenv's own columns."""

STATIONS: dict[str, tuple[str, ...]] = {"none": (), "base": ("base",), "tool": ("tool",), "base,tool": OWN}
"""Values of the option ``stations``, each with the frames that then differ from station to station."""


def given_arm(arm: Arm | str | Path | None, columns: Columns) -> Arm:
    """Return the arm itself, or load it by its name or file.

    If the files hold tool poses in place of joint values, return `pose_carrier`: an arm whose six joints are a pose.

    Args:
        arm: The arm, its name or its file; None if the files hold tool poses.
        columns: Description of the files' columns.

    Raises:
        InputError: If an arm is given although the files hold tool poses, or if none is given although they hold
            joint values.
    """
    described = [load_description(description) for description in _each(columns)]
    if any(description.poses for description in described):
        if arm is not None:
            raise InputError("finished poses have no joints to calibrate; leave the arm out, or describe its [joints]")
        return pose_carrier()
    if arm is None:
        raise InputError("no arm is given; name one, or its file, as `arm`")
    return load_arm(arm, whole=True) if isinstance(arm, str | Path) else arm


def given_rows(
    arm: Arm,
    data: Data,
    columns: Columns = None,
    stations: str | None = None,
    *,
    known: bool = False,
    like: Observations | None = None,
) -> Observations:
    """Read measured rows, and join several files or data sets as stations of one arm.

    A station, or set-up, is one placement of the instrument and its target.

    Args:
        arm: The arm.
        data: The rows, or their files.
        columns: Description of the files' columns; if several are given, one for each file.
        stations: Which frames (base, tool) differ between files or data sets, a key of `STATIONS`. If None, files of
            poses or positions are grouped into stations by their rows. For other kinds of measurement, files that share
            a description are then one data set, and each data set has its own base and tool.
        known: Whether base and tool are known; then all files belong to one station.
        like: The training rows, if ``data`` are test rows. The test rows are then assigned to the training rows'
            stations.

    Raises:
        InputError: Names the file, row, column or unit at fault.
    """
    if stations is not None and stations not in STATIONS:
        raise InputError(f"stations is '{stations}'; give {', '.join(STATIONS)}")
    items: list[Any] = list(data) if isinstance(data, Sequence) and not isinstance(data, str) else [data]
    if not all(isinstance(item, str | Path) for item in items):
        if columns is not None:
            raise InputError("columns describe files, but rows are given; leave them out")
        for item in items:
            _refuse_no_numbers(arm, item)
        return _joined(arm, items, stations, known, like)
    layouts: list[str | Path | None] = [*_each(columns)] or [None]
    if len(layouts) > 1 and len(layouts) != len(items):
        raise InputError(
            f"{len(layouts)} column descriptions are given for {len(items)} files; give one, or one per file"
        )
    sets = [items] if len(layouts) == 1 and stations is None else [[file] for file in items]
    layouts = layouts if len(layouts) > 1 else layouts * len(sets)
    pairs = zip(sets, layouts, strict=True)
    rows = [data_set for part, layout in pairs for data_set in read_scene(part, arm.nominal, layout)]
    if stations is not None:
        rows = [series for data_set in rows for series in _files(data_set)]
    return _joined(arm, rows, stations, known, like)


def pool_of(path: str | Path, geometry: Geometry, columns: str | Path | None = None) -> tuple[Array, NDArray[np.int64]]:
    """Read candidate poses from a file: joints ``(N, n)``, rad or m, and the line of each pose in the file ``(N,)``.

    Args:
        path: Without ``columns``, a file of joint targets or tool poses in pickenv's columns; else a measurement file.
        geometry: The arm's nominal geometry.
        columns: Description of the measurement file's columns.

    Raises:
        InputError: Names the file, row, column or unit at fault, or a pose that cannot be reached.
    """
    if columns is None:
        targets = read_targets(path, geometry)
        return joints_of(targets, geometry), np.array(targets.lines, dtype=np.int64)
    data = read_observations([path], geometry, columns)
    return data.joints, origins_of(data).line


def _each(columns: Columns) -> list[str | Path]:
    """Return the descriptions of files' columns as a list; it is empty for None."""
    if columns is None:
        return []
    return [columns] if isinstance(columns, str | Path) else list(columns)


def _joined(
    arm: Arm, sets: list[Observations], stations: str | None, known: bool, like: Observations | None
) -> Observations:
    """Join several data sets as stations of one arm, by ``stations`` or by their rows; a single one is unchanged.

    Without ``stations``, files of poses or positions within a set are grouped by their rows, too. The arguments are
    those of `given_rows`, with ``sets`` in place of the files.
    """
    named = any(any(origins_of(part).scene) for part in sets)
    trees = any(part.conditions.between is not None for part in sets)
    if stations is not None and (named or trees):
        raise InputError("[scene] says which files share a base or a tool; leave `stations` out")
    if named:
        if like is not None and like.stations:
            return Stacked(tuple(_same_scene(like, part) for part in sets))
        return scene_of(arm, sets) if len(sets) > 1 else sets[0]
    if stations is None:
        tracked = [file for part in sets if part.poses is not None for file in _files(part.poses)]
        if isinstance(like, Stacked) and tracked:
            return placed(arm, like, tracked)
        free = not known and like is None and not trees and all(part.frames == "fitted" for part in tracked)
        if len(tracked) > 1 and free and all(part.poses is not None for part in sets):
            several = by_set_up(arm, tracked)
            return sets[0] if len(sets) == 1 and several.poses is not None else several
    return sets[0] if len(sets) == 1 else stations_of(arm, sets, STATIONS[stations or "base,tool"])


def _same_scene(like: Observations, data: Observations) -> InstrumentStation:
    """Return the station of ``like`` that has the sensor, target and kind of ``data``, with ``data`` as its rows.

    Raises:
        InputError: If there is no such station.
    """
    scene = origins_of(data).scene
    for station in like.stations:
        if (origins_of(station.data).scene, station.data.kind) == (scene, data.kind):
            same: InstrumentStation = replace(station, data=data)
            return same
    named = " and ".join(f"'{name}'" for name in scene if name)
    raise InputError(f"{data.source}: [scene] names {named}, as no fitted file of this kind does; name the same ones")


def _files(data: Any) -> list[Any]:
    """Return measurements (`Observations`) as one data set for each file, and for each series of a file."""
    origins = origins_of(data)
    numbers = np.unique(origins.file)
    return [replace(data.select(origins.file == i), source=origins.files[i]) for i in numbers.tolist()]


def _refuse_no_numbers(arm: Arm, data: Observations) -> None:
    """Refuse measurements that are of no known kind, do not fit the arm's joints or are not finite."""
    if not hasattr(data, "joints"):
        kinds = ", ".join(names("observation"))
        raise InputError(f"{type(data).__name__} are no measurements; give files, or observations ({kinds})")
    shape, joint_count = data.joints.shape, arm.nominal.joints
    if shape != (len(data.joints), joint_count):
        raise InputError(f"{data.source}: joints have shape {shape}, but arm '{arm.name}' has {joint_count} joints")
    if (data.conditions.between is None) != (arm.nominal.tree is None):
        raise InputError(f"{data.source}: `between` of the conditions is for a whole robot, and needed there")
    named_values = {name: getattr(data, name, None) for name in ("joints", "position", "rotation", "length")}
    for name, values in {**named_values, "what was read": data.readings()}.items():
        if values is not None and not np.isfinite(values).all():
            rows = np.flatnonzero(~np.isfinite(values).reshape(len(values), -1).all(axis=1)).tolist()
            places = observations.named([origins_of(data).place(row) for row in rows])
            raise InputError(f"{places}: {name} is no finite number; correct or remove it")


# The stages.


GATE_ROWS = 3000
"""Largest number of training rows on which residual models are judged; of more rows, equally spaced ones are taken."""

ENOUGH_FOR_BLOCKS = 40
"""Smallest number of training poses with which blocks of rows can be held out."""

GEOMETRY = "geometry"

SPLITS = ("random", "blocked")

FEW_VIEWS, FEW_ROWS = 60, 20
"""Largest number of pictures, and largest number of poses, that are held out one by one. A fit to all others judges
each."""


@dataclass(frozen=True, eq=False)
class Draft:
    """The state of a calibration between two of its stages; each stage returns a new one.

    Attributes:
        arm: The arm.
        choices: The options.
        train: Rows to fit, in the order measured.
        test: Rows to judge by.
        rng: Random generator of the residual model that is used in the end.
        progress: Function that is called with the name of the work, the number of steps done and the total number.
        left_out: Outlier rows that were left out; with ``choices.robust`` off, they were kept and are only listed.
        fits: The fits so far, by name, in order. The last one is used.
        term_choice: The terms that were chosen, and the errors of each candidate; None if they were not chosen.
        gate: The verdicts on the residual models.
    """

    arm: Arm
    choices: Choices
    train: Observations
    test: Observations
    rng: np.random.Generator
    progress: Callable[[str, int, int], None] | None = None
    left_out: tuple[LeftOut, ...] = ()
    fits: Mapping[str, fitting.Fit] = field(default_factory=dict)
    term_choice: TermChoice | None = None
    gate: tuple[residual_models.GateVerdict, ...] = ()

    @property
    def tracked(self) -> Measurements | None:
        """The training poses or positions, transformed into the first station's frames.

        None for other kinds of measurement, and for a whole robot.
        """
        whole = self.arm.nominal.tree is not None  # one residual is not for the motion between any two links
        return None if whole else fitting.tracked_rows(self.best[1].identification, self.train)

    @property
    def best(self) -> tuple[str, fitting.Fit]:
        """The last fit: its name and the `Fit` itself."""
        return list(self.fits.items())[-1]

    def with_fit(self, name: str, fit: fitting.Fit) -> Draft:
        """Return a copy of the draft with one more fit, which becomes the last."""
        return replace(self, fits={**self.fits, name: fit})


def calibrate(
    arm: Arm | str | Path | None,
    data: Data,
    *,
    columns: Columns = None,
    stations: str | None = None,
    test: Data | None = None,
    split: str = "random",
    test_rows: int | None = None,
    choices: Choices | None = None,
    unit: str | None = None,
    rng: np.random.Generator | None = None,
    progress: Callable[[str, int, int], None] | None = None,
) -> Result:
    """Calibrate an arm from measurements of any kind, and judge the result on held-out rows.

        result = pickenv.calibrate("ur5", "tracker.csv", columns="my_tracker.toml")
        print(result)
        result.save("ur5.npz")

    Args:
        arm: The arm, its name, or its file (`pickenv.arm.load_arm`); None if the files hold tool poses in place of
            joint values.
        data: One data set of any kind or several, or the files that hold them (CSV or YAML).
        columns: Name or path of a description of the files' columns, or one for each file. None for pickenv's own.
        stations: Which frames differ between files or data sets: "base", "tool", "base,tool" or "none". If None, files
            of poses or positions are grouped into set-ups by their rows. For other kinds of measurement, files that
            share a description are then one data set, and each data set has its own base and tool.
        test: Rows to judge by; if None, some rows of ``data`` are held out.
        split: How rows of ``data`` are held out. "random" holds some rows out and fits to all other rows.
            "blocked" holds out each of ten contiguous blocks of rows in turn. Each block is judged by a model that is
            fitted and chosen without it. The calibration itself is fitted to all rows. Pictures are always held out
            by blocks, and so are fewer than 40 poses unless ``test_rows`` is given. Up to 60 pictures, or 20 poses, are
            held out one by one.
        test_rows: Number of rows that are held out at random; a fifth if None.
        choices: Terms, residual model, frames, robustness and seed. The defaults choose by the data.
        unit: Serial number of the robot; the calibration keeps it.
        rng: Random generator of the residual model; if None, it is made from the seed.
        progress: Function that is called with the name of the work, the number of steps done and the total number.
            Steps are residual models or blocks judged, and epochs of a network that learns from ``choices.learn_from``.

    Returns:
        The calibration with its verdict, held-out errors and parameters.

    Raises:
        InputError: If a file, a row or an option cannot be used, or if test rows are training rows. Also if the data do
            not fit the arm or determine too few parameters, or if the identification does not converge. The message
            names the file, row, column, unit or joint at fault.
    """
    choices = choices or Choices()
    arm = given_arm(arm, columns)
    if split not in SPLITS:
        raise InputError(f"split is '{split}'; give {' or '.join(SPLITS)}")
    if test is not None and (split != "random" or test_rows is not None):
        option = f"`split='{split}'`" if split != "random" else f"`test_rows={test_rows}`"
        raise InputError(f"{option} holds rows of the data out, but `test` gives other rows to judge by; leave one out")
    _refuse_idle(choices, arm)
    known_frames = choices.frames == "known"
    train = given_rows(arm, data, columns, stations, known=known_frames)
    if (between := train.parts[0].conditions.between) is not None:
        if known_frames:
            raise InputError("`frames='known'` is for a single arm; leave it out for a whole robot")
        if choices.residual not in ("auto", "none"):
            raise InputError(f"`residual='{choices.residual}'` is for a single arm; leave it out for a whole robot")
        arm = replace(arm, nominal=arm.nominal.between(*between[0].tolist()))
    if choices.workspace is not None:
        workspace_joints(choices.workspace, arm.nominal, choices.frames)  # refused now, and not after the work
    rng = rng or np.random.default_rng(choices.seed)
    few = test_rows is None and train.poses is not None and pose_count(train.joints) < ENOUGH_FOR_BLOCKS
    if test is None and (split == "blocked" or few or train.kind == "pixels"):
        if test_rows is not None:
            raise InputError("`test_rows` is for the random split; here every row, or picture, is held out once")
        result = _judged_by_blocks(Draft(arm, choices, train, train.select(np.arange(0)), rng, progress))
    else:
        if test is None:
            rows = observations.choose(train, test_rows, np.random.default_rng(choices.seed))
            train, held_out = (train.select(np.sort(part)) for part in rows)
        else:
            held_out = given_rows(arm, test, columns, stations, known=known_frames, like=train)
            refuse_trained(train, held_out)
        draft = _fitted(_check(Draft(arm, choices, train, held_out, rng, progress)))
        result = _assessed(draft, fitting.held_out_of(draft.fits, draft.test))
    return replace(result, unit=unit, stations=stations)


def _assessed(draft: Draft, held_out: fitting.HeldOut) -> Result:
    """Return the result of a draft that went through all stages, judged by its errors on held-out rows."""
    arm, fit = draft.arm, draft.best[1]
    region = workspace_joints(draft.choices.workspace, arm.nominal, draft.choices.frames)
    result = assess(
        arm, fit, draft.train, draft.test, fits=draft.fits, held_out=held_out, left_out=draft.left_out, workspace=region
    )
    return replace(result, terms=draft.term_choice, gate=draft.gate)


def _judged_by_blocks(draft: Draft) -> Result:
    """Calibrate with all rows, and judge each block of rows by a calibration that is made from the other blocks alone.

    Terms are chosen anew without each block. A choice of residual model for each block would take too long. So the
    model is chosen only twice, on the odd and on the even blocks. Each block takes the choice that was made without it.
    ``draft`` has all rows for training and has gone through no stage.
    """
    checked = _check(draft)
    complete = _fitted(checked)
    if len(checked.train.joints) < 2:
        raise InputError(f"{checked.train.source} holds one row, and none to judge by; measure more, or give `test`")
    folds = _folds(checked.train)
    halves = [np.sort(np.concatenate([rows_out for _, rows_out in folds[1 - i :: 2]])) for i in range(2)]
    residuals = [_chosen(checked, rows) for rows in halves]
    seeds = np.random.SeedSequence(draft.choices.seed).spawn(len(folds))
    parts = []
    for number, ((rows, rows_out), seed) in enumerate(zip(folds, seeds, strict=True)):
        training, testing = checked.train.select(rows), checked.train.select(rows_out)
        fold = replace(checked, train=training, test=testing, rng=np.random.default_rng(seed), progress=None)
        try:
            fold = _add_terms(_identify(fold))
            if fold.choices.learn_from is not None:
                fold = _learn(fold)
            elif (residual := residuals[number % 2]) is not None and fold.tracked is not None:
                fold = _with_residual(fold, residual, fold.tracked, None)
        except InputError as error:
            raise InputError(f"without block {number + 1} of {len(folds)}: {error}") from None
        parts.append(fitting.held_out_of(fold.fits, testing))
        if draft.progress is not None:
            draft.progress("judging blocks", number + 1, len(folds))
    final = replace(complete, test=checked.train.select(np.concatenate([rows_out for _, rows_out in folds])))
    return _assessed(final, fitting.by_station(fitting.pooled(list(complete.fits), parts), checked.train, folds))


def _folds(train: Observations) -> list[tuple[Rows, Rows]]:
    """Return, for each block of rows, the indices (from 0) of the rows to fit and of the rows held out.

    There are `observations.BLOCKS` blocks of neighbouring poses. With at most `FEW_VIEWS` pictures or `FEW_ROWS`
    poses, a block is a single picture or pose of every group (see `observations.contiguous_folds`).
    """
    poses, count = observations.same_poses(train.joints), pose_count(train.joints)
    few = count <= (FEW_VIEWS if train.kind == "pixels" else FEW_ROWS)
    return observations.contiguous_folds(train.groups, poses, count if few else observations.BLOCKS)


def _chosen(checked: Draft, rows: Rows) -> str | None:
    """Return the name of the residual model that the stages choose on some training rows (indices from 0).

    The result is None if the stages choose no model or fail.
    """
    choices, train = checked.choices, checked.train.select(rows)
    if choices.residual == "none" or choices.learn_from is not None:
        return None
    try:
        trial = _fitted(replace(checked, train=train, rng=np.random.default_rng(choices.seed)))
    except InputError:
        return None
    learnt = trial.best[1].calibration.learnt
    return None if learnt is None else learnt.kind


def _check(draft: Draft) -> Draft:
    """Return the draft without outlier rows; refuse options that do not apply.

    A named residual model that is not forced is refused if too few rows are left to judge it.
    """
    choices, train, test = draft.choices, draft.train, draft.test
    if choices.frames is not None and choices.frames not in FRAMES:
        raise InputError(f"frames is '{choices.frames}'; give {' or '.join(FRAMES)}")
    if choices.fit not in FIT_WORDS:
        raise InputError(f"fit is '{choices.fit}'; give {', '.join(FIT_WORDS[:-1])} or {FIT_WORDS[-1]}")
    if choices.residual not in ("auto", "none"):  # said now, and not after the work
        residual_models.require_residual(choices.residual)
    if type(train) is not type(test):
        raise InputError(
            f"{train.source} holds {train.kind}, but {test.source}, to judge by, {test.kind}; give rows of one kind"
        )
    left_out: tuple[LeftOut, ...] = ()
    if train.poses is not None and test.poses is not None:
        stated, others = train.poses.frames, test.poses.frames
        if choices.frames is None and stated != others:
            raise InputError(
                f"{train.source} says that base and tool are {stated}, {test.source} that they are {others}; give "
                "`frames`"
            )
        choices = replace(choices, frames=choices.frames or stated)
    else:
        refuse_options(train, choices)
        train, left_out = without_blind_views(train)
    train, test, far = checked_rows(draft.arm, train, test, known=choices.frames == "known", robust=choices.robust)
    needs_rows = choices.residual not in ("auto", "none") and choices.learn_from is None and not choices.force
    if needs_rows and (count := pose_count(train.joints)) < ENOUGH_FOR_BLOCKS:
        raise InputError(
            f"{train.source}: `residual='{choices.residual}'` cannot be judged on {count} fitted poses; measure "
            f"{ENOUGH_FOR_BLOCKS} or more, or use it unjudged with `force`"
        )
    return replace(draft, choices=choices, train=train, test=test, left_out=(*left_out, *far))


def _fitted(draft: Draft) -> Draft:
    """Return a checked draft after all further stages: geometry, terms and learnt residual."""
    return _learn(_add_terms(_identify(draft)))


def _identify(draft: Draft) -> Draft:
    """Return the draft with its first fit: of base and tool, if they are not known, and then of the geometry."""
    arm, choices = draft.arm, draft.choices
    aligned = fitting.fit_frames(arm, draft.train, choices.frames == "known")
    start = arm.nominal if aligned is None else aligned.geometry
    tolerances, scale = choices.tolerances or arm.tolerance_class, choices.prior_scale
    model = prior_model(arm.name, start, known=aligned is None, fit=choices.fit, tolerances=tolerances, scale=scale)
    return draft.with_fit(GEOMETRY, fitting.fit_geometry(arm, draft.train, aligned, model))


def _add_terms(draft: Draft) -> Draft:
    """Return the draft with a fit that has the terms of ``choices.terms``; "auto" chooses them on the training rows.

    While the fit does not converge, the last term is dropped. Without terms no fit is added.
    """
    (name, geometric), choice = draft.best, None
    bare, known_frames = geometric.identification, geometric.aligned is None
    if draft.choices.terms != "auto":
        terms = terms_of(draft.choices.terms, draft.arm, bare, draft.train)
    else:
        if pose_count(draft.train.joints) >= ENOUGH_FOR_BLOCKS and draft.arm.name != CARRIER:
            choice = choose_terms(draft.arm, bare, draft.train)
        terms = () if choice is None else choice[2]
    while terms:
        solution = identify_terms(terms, bare, draft.train, known_frames)
        if solution.converged:
            kinds = [kind_of_term(term) for term in terms]
            record = {**geometric.calibration.record, "terms": sorted(kinds)}
            calibration = replace(geometric.calibration, model=solution.arm_model, record=record)
            draft = draft.with_fit(f"{name}+{'+'.join(kinds)}", fitting.Fit(calibration, solution, geometric.aligned))
            break
        terms = terms[:-1]
    return replace(draft, term_choice=choice)


def _learn(draft: Draft) -> Draft:
    """Return the draft with a fit that has a learnt residual model, or the draft itself if no model is to be learnt.

    If ``choices.learn_from`` is given, the named model learns from these poses. Otherwise residual models are judged
    within the training rows. The model that wins, or that ``choices.force`` demands, learns from the training rows.
    """
    choices = draft.choices
    if choices.learn_from is not None:
        settings = (choices.settings or BpnnSettings()) if choices.residual == "bpnn" else None
        return _with_residual(draft, choices.residual, choices.learn_from, settings)
    train = draft.tracked
    if train is None or choices.residual == "none":
        return draft
    kind: str | None = None
    if pose_count(train.joints) >= ENOUGH_FOR_BLOCKS:
        names = residual_models.AUTO if choices.residual == "auto" else (choices.residual,)
        draft = replace(draft, gate=_verdicts(draft, train, names))
        kind = residual_models.selected(draft.gate)
    if choices.force and choices.residual != "auto":
        kind = choices.residual
    return draft if kind is None else _with_residual(draft, kind, train, None)


def _with_residual(draft: Draft, kind: str, data: Measurements, settings: BpnnSettings | None) -> Draft:
    """Return the draft with a fit that adds the residual model ``kind``, learnt from ``data``.

    ``settings`` are the settings of the paper's network, or None, as in `fitting.fit_remainder`.
    """
    name, best = draft.best
    report = None if draft.progress is None else partial(draft.progress, "training network")
    return draft.with_fit(f"{name}+{kind}", fitting.fit_remainder(best, kind, data, draft.rng, settings, report))


def _verdicts(draft: Draft, train: Measurements, names: tuple[str, ...]) -> tuple[residual_models.GateVerdict, ...]:
    """Judge the residual models ``names`` within the training poses or positions ``train``; return their verdicts."""
    data = train.at_most(GATE_ROWS)
    name, best = draft.best
    expected, fitted = best.identification.prior, best.identification.arm_model
    assert expected is not None

    def refit(rows: Measurements) -> ArmModel:
        """Fit the arm to some of the rows; their scatter is taken from the fit to all rows."""
        none, unused = np.zeros(0), np.zeros(rows.rows_per_pose * len(rows))
        return solve(expected, rows, noise_of(rows, fitted, none, unused)).arm_model

    report = None
    if draft.progress is not None:
        rms = 1e3 * residual_models.position_rms(train.misses(fitted, np.zeros(0)))
        report = partial(draft.progress, f"{name} leaves {rms:.4g} mm of the rows fitted; judging residual models")
    rng = np.random.default_rng(draft.choices.seed)
    fitters = residual_models.TRIAL_FITTERS
    return residual_models.gate_residuals(data, refit, rng, models=names, fitters=fitters, progress=report)
