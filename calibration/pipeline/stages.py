"""The one way from measured rows to a calibration result, for every kind of measurement and every caller.

`STAGES` lists its steps in order: check, align, identify, add terms, learn what remains; reading comes before them,
judgement after them. "Nominal" errors are taken after base and tool were fitted: an uncalibrated arm is not blamed for
where the instrument stood. Terms and residual model are chosen within the training rows, so that the held-out figures
come from rows that no choice has used.
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
from pickenv.calibration.identification.least_squares import Identification
from pickenv.calibration.identification.robust import by_set_up, placed, scene_of, stations_of
from pickenv.calibration.identification.solve import solve
from pickenv.calibration.identification.term_choice import TermChoice, choose_terms, identify_terms, terms_of
from pickenv.calibration.model import observations
from pickenv.calibration.model.arm_model import CARRIER, ArmModel, kind_of_term, pose_carrier
from pickenv.calibration.model.measurements import FRAMES, OWN, Frames, InstrumentStation, Measurements, Stacked
from pickenv.calibration.model.noise import noise_of
from pickenv.calibration.model.observations import Observations, Rows, origins_of, pose_count
from pickenv.calibration.model.prior import FIT_WORDS, prior_model
from pickenv.calibration.pipeline import fitting
from pickenv.calibration.pipeline.result import Result, assess, workspace_joints
from pickenv.calibration.reading.description import load_description
from pickenv.calibration.reading.read import joints_of, read_observations, read_targets
from pickenv.calibration.residuals.bpnn import BpnnSettings
from pickenv.calibration.residuals.gate import AUTO, GateVerdict, gate_residuals, position_rms, selected
from pickenv.calibration.residuals.residual_models import TRIAL_FITTERS, require_residual

# What a calibration may be asked for, and what does not go with what was measured.


@dataclass(frozen=True)
class Choices:
    """The options of a calibration beyond its geometry.

    Attributes:
        terms: "auto", or names of terms joined by "+", or "none".
        residual: "auto", a residual model's name, or "none".
        force: Whether a named residual model is used even if it does not win.
        robust: Whether rows far off are left out; they are listed in either case.
        seed: Seeds everything random.
        frames: Whether base and tool are "known" or "fitted"; when None, what the data say of them.
        learn_from: Poses for the named residual model, which is then used as it is, as the paper does; when None it
            learns from the training rows, if it wins there.
        settings: Settings of the network that learns from ``learn_from``; the paper's when None.
        fit: One of `pickenv.calibration.model.prior.FIT_WORDS`: "auto", all parameters by their priors; "offsets", the
            joints' zeros alone; "full", all parameters without priors, as the papers do.
        tolerances: The tolerance class that parts are expected to be made to, by name or path; when None, the arm's own
            class, or else the class of a cobot.
        prior_scale: Factor on the widths of the priors; found from the rows when None.
        workspace: The region that the verdict is about (`pickenv.calibration.pipeline.result.workspace_joints`); the
            joint limits when None.
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
    """Refuse options that apply only to another kind of measurement than the rows hold.

    Raises:
        InputError: Names the option.
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


Data = Observations | str | Path | Sequence[str | Path] | Sequence[Observations]
"""Rows: measurements, observations of any kind or several of them, or the files that hold them."""

Columns = str | Path | Sequence[str | Path] | None
"""Description of the files' columns, by name or path; or several, one for each file."""

STATIONS: dict[str, tuple[str, ...]] = {"none": (), "base": ("base",), "tool": ("tool",), "base,tool": OWN}
"""Frames that each station can have of its own, by the word that names them."""


def given_arm(arm: Arm | str | Path | None, columns: Columns) -> Arm:
    """Load the arm; where the files hold finished poses, a carrier that only reproduces them takes its place.

    Raises:
        InputError: If an arm is given with finished poses, or none is given without them.
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
    """Read the rows.

    Args:
        arm: The arm.
        data: The rows, or their files.
        columns: How the files are laid out; several descriptions are for one file each.
        stations: What each file, or data set, has of its own, of `STATIONS`. When left out, the rows tell which files
            of poses or positions are of one set-up, and other kinds have both frames of their own.
        known: Whether base and tool are known; then all files are of one set-up.
        like: The training rows, where ``data`` judge them and come from the set-ups in which they were measured.

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
    together = len(layouts) == 1 and stations is None
    sets = [items] if together else [[file] for file in items]
    layouts = layouts if len(layouts) > 1 else layouts * len(sets)
    rows = [read_observations(part, arm.nominal, layout) for part, layout in zip(sets, layouts, strict=True)]
    return _joined(arm, rows, stations, known, like)


def pool_of(path: str | Path, geometry: Geometry, columns: str | Path | None = None) -> tuple[Array, NDArray[np.int64]]:
    """Read the joints ``(N, n)`` of a file of poses to choose from, and the line of each pose in the file ``(N,)``.

    Args:
        path: Joint targets or tool poses in our own columns; or measurements, where they are described.
        geometry: The arm.
        columns: Description of the columns of measurements.

    Raises:
        InputError: Names the file, row, column or unit at fault, or a pose that cannot be reached.
    """
    if columns is None:
        targets = read_targets(path, geometry)
        return joints_of(targets, geometry), np.array(targets.lines, dtype=np.int64)
    data = read_observations([path], geometry, columns)
    return data.joints, origins_of(data).line


def _each(columns: Columns) -> list[str | Path]:
    if columns is None:
        return []
    return [columns] if isinstance(columns, str | Path) else list(columns)


def _joined(
    arm: Arm, sets: list[Observations], stations: str | None, known: bool, like: Observations | None
) -> Observations:
    """Join several data sets as stations of one arm, as asked or as poses and positions show; leave one as it is."""
    named = any(any(origins_of(part).scene) or part.conditions.between is not None for part in sets)
    if stations is not None and named:
        raise InputError("[scene] says which files share a base or a tool; leave `stations` out")
    if any(any(origins_of(part).scene) for part in sets):
        if like is not None and like.stations:
            return Stacked(tuple(_same_scene(like, part) for part in sets))
        return scene_of(arm, sets) if len(sets) > 1 else sets[0]
    if stations is None:
        tracked = [file for part in sets if part.poses is not None for file in _files(part.poses)]
        if isinstance(like, Stacked) and tracked:
            return placed(arm, like, tracked)
        free = not known and like is None and all(part.frames == "fitted" for part in tracked)
        free = free and not any(part.conditions.between is not None for part in sets)
        if len(tracked) > 1 and free and all(part.poses is not None for part in sets):
            several = by_set_up(arm, tracked)
            return sets[0] if len(sets) == 1 and several.poses is not None else several
    return sets[0] if len(sets) == 1 else stations_of(arm, sets, STATIONS[stations or "base,tool"])


def _same_scene(like: Observations, data: Observations) -> InstrumentStation:
    """Other rows of the sensor and the target of a station.

    Raises:
        InputError: If no station has them.
    """
    scene = origins_of(data).scene
    for station in like.stations:
        if (origins_of(station.data).scene, station.data.kind) == (scene, data.kind):
            same: InstrumentStation = replace(station, data=data)
            return same
    named = " and ".join(f"'{name}'" for name in scene if name)
    raise InputError(f"{data.source}: [scene] names {named}, as no fitted file of this kind does; name the same ones")


def _files(data: Measurements) -> list[Measurements]:
    """The rows of each file as measurements of their own."""
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
"""Most training rows, taken evenly, that residual models are judged on."""

ENOUGH_FOR_BLOCKS = 40
"""Fewest training poses from which blocks can be held out."""

GEOMETRY = "geometry"

SPLITS = ("random", "blocked")

FEW_VIEWS, FEW_ROWS = 60, 20
"""Up to this many pictures, or poses, are judged one by one, each by a fit to the rows of all other poses."""


@dataclass(frozen=True, eq=False)
class Draft:
    """A calibration on its way through the stages.

    Attributes:
        arm: The arm.
        choices: What was asked for.
        train: Rows to fit, in the order measured.
        test: Rows to judge by.
        rng: Random generator of the residual model that will be used.
        progress: Called with (what is done, how many are done, how many there are).
        left_out: Rows far off that were left out.
        aligned: Evidence of the base and tool fit; None where they are known.
        fits: The fits so far, by name, in order; the last will be used.
        term_choice: How terms were chosen.
        gate: The residual models' verdicts.
    """

    arm: Arm
    choices: Choices
    train: Observations
    test: Observations
    rng: np.random.Generator
    progress: Callable[[str, int, int], None] | None = None
    left_out: tuple[LeftOut, ...] = ()
    aligned: Identification | None = None
    fits: Mapping[str, fitting.Fit] = field(default_factory=dict)
    term_choice: TermChoice | None = None
    gate: tuple[GateVerdict, ...] = ()

    @property
    def tracked(self) -> Measurements | None:
        """Training poses or positions, all as the first station would have measured them; None for other kinds."""
        whole = self.arm.nominal.tree is not None  # one residual is not for the motion between any two links
        return None if whole else fitting.tracked_rows(self.best[1].identification, self.train)

    @property
    def best(self) -> tuple[str, fitting.Fit]:
        """The name of the last fit, and the fit."""
        return list(self.fits.items())[-1]

    def with_fit(self, name: str, fit: fitting.Fit) -> Draft:
        """The draft with one more fit."""
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
    """Calibrate an arm from measurements of any kind, and judge the result on rows that it never saw.

        result = pickenv.calibrate("ur5", "tracker.csv", columns="my_tracker.toml")
        print(result)
        result.save("ur5.npz")

    Args:
        arm: The arm, its name, or its file (`pickenv.arm.load_arm`); None where files hold finished poses.
        data: Measurements, observations of any kind or several of them, or files that hold them (CSV or YAML).
        columns: Description of the files' columns, by name or path; our own columns when left out. Several: one for
            each file.
        stations: What each file, or data set, has of its own: "base", "tool", "base,tool" or "none". When left out,
            the rows tell which files of poses or positions share a set-up; other kinds have both of their own.
        test: Rows to judge by; some of ``data`` when left out.
        split: How rows of ``data`` are held out: "random", and the calibration is fitted to the others; or "blocked",
            all ten contiguous tenths in turn, each judged by a model fitted and chosen without it, while the
            calibration itself is fitted to all rows. Fewer than 40 poses are always judged so, and up to 20 one by one.
        test_rows: How many rows are held out at random; a fifth when left out.
        choices: Terms, residual model, frames, robustness and seed; the defaults choose by the data.
        unit: Serial number of the robot, kept in the calibration.
        rng: Random generator of the residual model; made from the seed when left out.
        progress: Called with (what is done, how many are done, how many there are): residual models or blocks judged,
            epochs of the network that learns from poses of its own.

    Raises:
        InputError: Names the file, row, column, unit or joint at fault: if a file cannot be read, rows are not numbers
            or not of one kind, rows to judge by were trained on, the data do not fit the arm, rows are far off, held
            out or not, or show too few parameters, a name is unknown, an option does not apply to this kind of
            measurement, or the identification does not converge.
    """
    choices = choices or Choices()
    arm = given_arm(arm, columns)
    if split not in SPLITS:
        raise InputError(f"split is '{split}'; give {' or '.join(SPLITS)}")
    known_frames = choices.frames == "known"
    train = given_rows(arm, data, columns, stations, known=known_frames)
    if (between := train.parts[0].conditions.between) is not None:
        if known_frames:
            raise InputError("`frames='known'` is for a single arm; leave it out for a whole robot")
        arm = replace(arm, nominal=arm.nominal.between(*between[0].tolist()))
    rng = rng or np.random.default_rng(choices.seed)
    few = test is None and test_rows is None and train.poses is not None
    few = few and pose_count(train.joints) < ENOUGH_FOR_BLOCKS
    if test is None and (split == "blocked" or few or train.kind == "pixels"):
        if test_rows is not None:
            raise InputError("`test_rows` is for the random split; here every row, or picture, is held out once")
        result = _judged_by_blocks(Draft(arm, choices, train, train.select(np.arange(0)), rng, progress))
    elif test is None:
        rows = observations.choose(train, test_rows, np.random.default_rng(choices.seed))
        train, held_out = (train.select(np.sort(part)) for part in rows)
        result = _judged_once(Draft(arm, choices, train, held_out, rng, progress))
    else:
        held_out = given_rows(arm, test, columns, stations, known=known_frames, like=train)
        refuse_trained(train, held_out)
        result = _judged_once(Draft(arm, choices, train, held_out, rng, progress))
    return replace(result, unit=unit, stations=stations)


def _through(stages: Sequence[Callable[[Draft], Draft]], draft: Draft) -> Draft:
    for stage in stages:
        draft = stage(draft)
    return draft


def _assessed(draft: Draft, held_out: fitting.HeldOut) -> Result:
    arm, fit, region = draft.arm, draft.best[1], workspace_joints(draft.choices.workspace, draft.arm.nominal)
    result = assess(
        arm, fit, draft.train, draft.test, fits=draft.fits, held_out=held_out, left_out=draft.left_out, workspace=region
    )
    return replace(result, terms=draft.term_choice, gate=draft.gate)


def _judged_once(draft: Draft) -> Result:
    """Judge the calibration on its held-out rows."""
    draft = _through(STAGES, draft)
    return _assessed(draft, fitting.held_out_of(draft.fits, draft.test))


def _judged_by_blocks(draft: Draft) -> Result:
    """Calibrate with all rows, and judge each block by a calibration that the same stages make from the other blocks.

    Terms are chosen anew without each block. Residual models are chosen only twice, on the odd and on the even blocks,
    since to choose one for every block would take ten times as long; a block takes the choice that it had no part in.
    """
    checked = _check(draft)
    complete = _through(STAGES[1:], checked)
    if len(checked.train.joints) < 2:
        raise InputError(f"{checked.train.source} holds one row, and none to judge by; measure more, or give `test`")
    folds = _folds(checked.train)
    residuals = [
        _chosen(checked, np.sort(np.concatenate([rows_out for _, rows_out in folds[1 - i :: 2]]))) for i in range(2)
    ]
    seeds = np.random.SeedSequence(draft.choices.seed).spawn(len(folds))
    parts = []
    for number, ((rows, rows_out), seed) in enumerate(zip(folds, seeds, strict=True)):
        training, testing = checked.train.select(rows), checked.train.select(rows_out)
        fold = replace(checked, train=training, test=testing, rng=np.random.default_rng(seed), progress=None)
        try:
            fold = _through((_align, _identify, _add_terms), fold)
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
    """The rows to fit and the rows held out, block by block; each of few pictures, or very few poses, is a block."""
    poses, count = observations.same_poses(train.joints), pose_count(train.joints)
    few = count <= (FEW_VIEWS if train.kind == "pixels" else FEW_ROWS)
    return observations.contiguous_folds(train.groups, poses, count if few else observations.BLOCKS)


def _chosen(checked: Draft, rows: Rows) -> str | None:
    """Name of the residual model that the stages choose on these rows; None if they choose none or fail."""
    choices, train = checked.choices, checked.train.select(rows)
    if choices.residual == "none" or choices.learn_from is not None:
        return None
    try:
        trial = _through(STAGES[1:], replace(checked, train=train, rng=np.random.default_rng(choices.seed)))
    except InputError:
        return None
    learnt = trial.best[1].calibration.learnt
    return None if learnt is None else learnt.kind


def _check(draft: Draft) -> Draft:
    """Refuse options that do not apply; leave out rows that are far off."""
    choices, train, test = draft.choices, draft.train, draft.test
    if choices.frames is not None and choices.frames not in FRAMES:
        raise InputError(f"frames is '{choices.frames}'; give {' or '.join(FRAMES)}")
    if choices.fit not in FIT_WORDS:
        raise InputError(f"fit is '{choices.fit}'; give {', '.join(FIT_WORDS[:-1])} or {FIT_WORDS[-1]}")
    if choices.residual not in ("auto", "none"):  # said now, and not after the work
        require_residual(choices.residual)
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
    known_frames = choices.frames == "known"
    train, test, far = checked_rows(draft.arm, train, test, known=known_frames, robust=choices.robust)
    return replace(draft, choices=choices, train=train, test=test, left_out=(*left_out, *far))


def _align(draft: Draft) -> Draft:
    """Fit base and tool, where they are not known."""
    return replace(draft, aligned=fitting.fit_frames(draft.arm, draft.train, draft.choices.frames == "known"))


def _identify(draft: Draft) -> Draft:
    """Identify the geometry from its priors and the rows."""
    choices, known_frames = draft.choices, draft.aligned is None
    start = draft.arm.nominal if draft.aligned is None else draft.aligned.geometry
    tolerances, scale = choices.tolerances or draft.arm.tolerance_class, choices.prior_scale
    model = prior_model(draft.arm.name, start, known=known_frames, fit=choices.fit, tolerances=tolerances, scale=scale)
    return draft.with_fit(GEOMETRY, fitting.fit_geometry(draft.arm, draft.train, draft.aligned, model))


def _add_terms(draft: Draft) -> Draft:
    """Add the wanted terms, dropping the last one until the fit converges; "auto" chooses within the training rows."""
    (name, geometric), choice = draft.best, None
    bare, known_frames = geometric.identification, draft.aligned is None
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
    """Learn a residual model: the named one from poses of its own, or one that wins within the training rows."""
    choices = draft.choices
    if choices.learn_from is not None:
        settings = (choices.settings or BpnnSettings()) if choices.residual == "bpnn" else None
        return _with_residual(draft, choices.residual, choices.learn_from, settings)
    train = draft.tracked
    if train is None or choices.residual == "none":
        return draft
    kind: str | None = None
    if pose_count(train.joints) >= ENOUGH_FOR_BLOCKS:
        names = AUTO if choices.residual == "auto" else (choices.residual,)
        draft = replace(draft, gate=_verdicts(draft, train, names))
        kind = selected(draft.gate)
    if choices.force and choices.residual != "auto":
        kind = choices.residual
    return draft if kind is None else _with_residual(draft, kind, train, None)


def _with_residual(draft: Draft, kind: str, data: Measurements, settings: BpnnSettings | None) -> Draft:
    name, best = draft.best
    report = None if draft.progress is None else partial(draft.progress, "training network")
    return draft.with_fit(f"{name}+{kind}", fitting.fit_remainder(best, kind, data, draft.rng, settings, report))


def _verdicts(draft: Draft, train: Measurements, names: tuple[str, ...]) -> tuple[GateVerdict, ...]:
    """The verdicts on residual models, judged within the training rows."""
    data = train.select(observations.equally_spaced(len(train), GATE_ROWS))
    name, best = draft.best
    expected, fitted = best.identification.prior, best.identification.arm_model
    assert expected is not None

    def refit(rows: Measurements) -> ArmModel:
        """Fit the arm to some of the rows, whose scatter is taken from the fit to all of them."""
        none, unused = np.zeros(0), np.zeros(rows.rows_per_pose * len(rows))
        return solve(expected, rows, noise_of(rows, fitted, none, unused)).arm_model

    report = None
    if draft.progress is not None:
        rms = 1e3 * position_rms(train.misses(fitted, np.zeros(0)))
        report = partial(draft.progress, f"{name} leaves {rms:.4g} mm of the rows fitted; judging residual models")
    rng = np.random.default_rng(draft.choices.seed)
    return gate_residuals(data, refit, rng, models=names, fitters=TRIAL_FITTERS, progress=report)


STAGES: tuple[Callable[[Draft], Draft], ...] = (_check, _align, _identify, _add_terms, _learn)
"""The stages between reading and judgement, in order."""
