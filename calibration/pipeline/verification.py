"""Verify an old calibration on new rows.

It answers three questions. Is the calibrated arm better than the nominal arm? Are its errors as small as its
uncertainty promises? Was the region of the new rows measured for the calibration? If errors are larger than promised,
the verdict names the cause: frames that moved, joint zeros that changed, a region that was not measured, or another
arm. mm and degrees in outputs, SI inside.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from pickenv.arm import Array, Geometry, identity_pose, rotation_matrix
from pickenv.base import DO_NOT_USE, InputError
from pickenv.calibration.assessment.quality import no_gain
from pickenv.calibration.assessment.screen import Block, ErrorStatistics, error_cells, error_statistics, figure
from pickenv.calibration.identification.diagnosis import MANY_FAR, LeftOut
from pickenv.calibration.identification.least_squares import identify
from pickenv.calibration.identification.robust import OUTLIER_SIGMA, align, apart, registered, sizes_of
from pickenv.calibration.model.arm_model import ArmModel, ErrorModel, frames_model, joint_zeros_model
from pickenv.calibration.model.measurements import OWN, Measurements
from pickenv.calibration.model.noise_and_priors import Prior, never_told
from pickenv.calibration.model.observations import BLOCKS, Observations, Rows, equally_spaced, origins_of, same_poses
from pickenv.calibration.pipeline.calibration import Calibration, uncertainty_from
from pickenv.calibration.planning.plan import exchange
from pickenv.calibration.residuals.residual_models import position_rms

# A calibrated arm seen from another station: base and tool found anew from a few rows, the arm left as it is. An
# instrument that is set up again stands elsewhere and sees another target. What was found of the arm itself holds on;
# the frames take six numbers each, and a few rows that tell them well. SI units.

REFIT_ROWS = 6
"""Default number of rows to which base and tool are refitted."""

CHANGE_STD = (1.0, np.pi / 6)
"""Prior standard deviations of the change of a refitted frame (base or tool): shift, m, and turn, rad. In directions
that the rows do not determine, the frame does not change."""

NO_RANK = 1e-12
"""Rank tolerance of the refit, so small that no parameter counts as redundant, since each has a prior."""

TOLD = 0.1
"""The rows determine a direction of a frame's shift or turn if the posterior standard deviation in this direction is at
most this share of the prior standard deviation (`CHANGE_STD`)."""

CANDIDATES = 1000
"""Largest number of rows, taken at equal steps, from which the rows for the refit are chosen."""


Moves = dict[str, tuple[float, float, int, int]]
"""For each refitted frame by name: its shift, m; its turn, rad; the number of the three directions in which the rows do
not determine the shift; and this number for the turn."""


def frames_and_rows(text: str | None, rows: int | None) -> tuple[tuple[str, ...], int]:
    """Parse the options for a refit: return the names of the frames, and the number of rows to fit them to.

    Args:
        text: Names of frames joined by commas, such as "base,tool"; None for no refit.
        rows: Number of rows; `REFIT_ROWS` if None.

    Raises:
        InputError: If the list names other frames, or a number of rows is given without frames.
    """
    if text is None:
        if rows is not None:
            raise InputError(f"`refit_rows={rows}` is for `refit`; say which frames: `refit='base,tool'`")
        return (), REFIT_ROWS
    frames = tuple(part.strip() for part in text.split(","))
    if not set(frames) <= set(OWN) or len(set(frames)) != len(frames):
        raise InputError(f"refit is '{text}'; give base, tool, or base,tool")
    return frames, REFIT_ROWS if rows is None else rows


def restationed(
    calibration: Calibration,
    data: Measurements,
    own: Collection[str],
    count: int = REFIT_ROWS,
    used: Rows | None = None,
) -> tuple[Calibration, Rows, Rows, Array, Moves]:
    """Refit base, tool or both of a calibrated arm to a few rows of another station.

    A station is one placement of the instrument and its target. The prior of the frames is their old place with the
    standard deviations `CHANGE_STD`. This prior hardly matters in directions that the rows determine. In other
    directions the frames do not change.

    The learnt residual is a function of the joints. It stays with the arm, and its axes turn with the base. The
    residual is subtracted from the rows before the frames are fitted. Otherwise the frames would absorb its mean over
    these few rows. The residual holds for the old tool's point. A learnt rotation also moves a new tool's point; this
    motion is neglected.

    Args:
        calibration: The calibration.
        data: Poses or positions measured at the other station.
        own: Which of "base" and "tool" are refitted.
        count: Number of rows to fit to. The rows are chosen by their joints alone, so that positions at other rows are
            predicted best (I-optimal design).
        used: Indices, from 0, of the rows to fit to, if they were chosen before.

    Returns:
        Five values. The first is the calibration with the base and tool of the other station. The second holds the
        indices of the rows to which the frames were fitted. The third holds the indices of the R rows of other poses.
        The fourth holds the expected mean square position errors of these R rows ``(R,)``, m^2. They come from the
        scatter of a single motion to a pose and from the uncertainty of the frames. The fifth says how far the frames
        moved.

    Raises:
        InputError: If there are too few rows.
    """
    least = 3 * len(tuple(own))
    if count < least or len(data) < count + 3:
        raise InputError(
            f"{data.source}: {' and '.join(own)} are to be found from {count} of {len(data)} rows; give {least} rows "
            "or more, and measure at least 3 others to judge by"
        )
    data = weighed_by_reach(calibration, data)
    model = own_frames_model(calibration.identified, own)
    used = _telling(calibration.model, data, model, count) if used is None else used
    few = data.select(used)
    std = np.tile(np.repeat(CHANGE_STD, 3), len(model.names) // 6)
    before = Prior(calibration.model, model.columns, std)
    refit = partial(identify, model, max_iterations=100, rank_tolerance=NO_RANK)
    fits = [refit(start, [few, before]) for start in _starts(calibration.model, few, own)]
    near = min(fits, key=lambda fit: fit.chi_square).arm_model
    few = _less(few, errors_there(replace(calibration, model=near), calibration, few) - few.difference(near))
    # Expected where they were found, what rows tell is pulled by nothing, and what they do not tell still stays.
    model_there = refit(near, [few, replace(before, reference=near)]).arm_model
    poses = same_poses(data.joints)
    others = np.flatnonzero(~np.isin(poses, poses[used]))
    jacobian = model_there.jacobian(data.joints[others], data.conditions.select(others))
    elsewhere = jacobian[:, :3][..., model.columns] * std
    whitened = few.jacobian(model_there, np.zeros(0))[0][:, model.columns] * std
    # In shares of the standard deviations before, with rows in standard uncertainties.
    covariance = np.linalg.inv(whitened.T @ whitened + np.eye(len(std)))
    expected = np.einsum("rip,pq,riq->r", elsewhere, covariance, elsewhere) + expected_square(data)
    parts = [covariance[first : first + 3, first : first + 3] for first in range(0, len(std), 3)]
    lost = [int(np.sum(np.linalg.eigvalsh(part) > TOLD**2)) for part in parts]
    moves: Moves = {}
    for i, name in enumerate(name for name in OWN if name in own):
        shift, turn = apart(getattr(calibration.identified, name), getattr(model_there.geometry, name))
        moves[name] = shift, turn, lost[2 * i], lost[2 * i + 1]
    return replace(calibration, model=model_there), used, others, expected, moves


def own_frames_model(geometry: Geometry, own: Collection[str]) -> ErrorModel:
    """Return an error model with the parameters of the base, the tool or both, as ``own`` names them."""
    frames = frames_model(geometry)
    return frames.some(np.array([name.startswith(tuple(own)) for name in frames.names]))


def expected_square(data: Measurements) -> float:
    """Return the mean square position error, m^2, that the standard uncertainty of the rows alone causes."""
    return 3.0 * data.position_std**2


def weighed_by_reach(calibration: Calibration, data: Measurements) -> Measurements:
    """Return the data with their standard uncertainties raised to the scatter in the calibration's record, if smaller.

    This is the scatter of a single motion to a pose (``position_repeat`` and ``attitude_repeat`` of `PoseUncertainty`).
    """
    uncertainty = calibration.record.get("uncertainty") or {}
    position = max(float(uncertainty.get("position_repeat_m") or 0.0), data.position_std)
    attitude = max(float(uncertainty.get("attitude_repeat_rad") or 0.0), data.attitude_std)
    return replace(data, position_std=position, attitude_std=attitude)


def _telling(model: ArmModel, data: Measurements, frames: ErrorModel, count: int) -> Rows:
    """Return the indices, from 0, of the rows that determine the refitted frames best.

    The best rows give the smallest error of predicted positions at all rows.

    Args:
        model: The calibrated arm.
        data: The rows.
        frames: The parameters of base, tool or both.
        count: Number of rows to return.
    """
    pool = equally_spaced(len(data), CANDIDATES)
    jacobian = model.jacobian(data.joints[pool], data.conditions.select(pool))[..., frames.columns] * frames.tolerance
    rows = jacobian[:, : data.rows_per_pose] * data.row_weights[:, None]
    weight = np.einsum("nip,niq->pq", jacobian[:, :3], jacobian[:, :3]) / len(pool)
    rows_chosen, _ = exchange(rows, count, np.random.default_rng(0), weight)
    return np.sort(pool[rows_chosen])


def _starts(model: ArmModel, few: Measurements, own: Collection[str]) -> Iterator[ArmModel]:
    """Yield starting points for the refit of frames: the model with its old frames, then with estimates of new ones.

    Args:
        model: The calibrated arm.
        few: The rows to which the frames are refitted.
        own: Which of "base" and "tool" are refitted.
    """
    geometry = model.geometry
    yield model
    if set(own) == {"tool"}:
        return
    chain = ArmModel.of(replace(geometry, base=identity_pose(), tool=identity_pose())).pose(few.joints, few.conditions)
    yield replace(model, geometry=registered(geometry, geometry.tool, chain, few))
    if set(own) == set(OWN):
        yield replace(model, geometry=align(geometry, few, frames_model(geometry), judge=False).geometry)


def errors_there(there: Calibration, before: Calibration, data: Measurements) -> Array:
    """Compute measured minus predicted poses ``(R, 6)`` or positions ``(R, 3)`` of rows of another station, m and rad.

    The learnt residual turns with the base, since it was learnt in the axes of the base.

    Args:
        there: The calibration with the other station's frames.
        before: The calibration with its old frames.
        data: The rows of the other station.
    """
    return there.errors(data, there.identified.base.rotation @ before.identified.base.rotation.T)


def near_rows(
    calibration: Calibration, data: Measurements, refit: Collection[str], count: int
) -> tuple[Measurements, tuple[LeftOut, ...]]:
    """Remove outlier rows; return the rows that are kept, and the outliers.

    If many rows would be outliers, this indicates a change of the arm, and all rows are kept.

    Args:
        calibration: The calibration.
        data: Measured rows, possibly of another station (placement of the instrument and its target).
        refit: Which of "base" and "tool" differ in that station. They are refitted before outliers are searched.
        count: Number of rows to which `verify` refits these frames after the outliers are removed.
    """
    model = calibration.model
    if refit:
        model = restationed(calibration, data, refit, max(count, min(len(data) - 3, 4 * count)))[0].model
    sigma, *_ = sizes_of(model, np.zeros(0), data)
    far = np.flatnonzero(~(sigma <= OUTLIER_SIGMA))
    if len(far) > max(1.0, MANY_FAR * len(data)):
        return data, ()
    sizes = np.linalg.norm(data.difference(model)[:, :3], axis=1)
    left_out = [
        LeftOut(*origins_of(data).place(row), held_out=True, position=float(sizes[row]), sigma=float(sigma[row]))
        for row in far.tolist()
    ]
    return data.select(np.setdiff1d(np.arange(len(data)), far)), tuple(left_out)


GROWN = 1.5
"""Ratio of the RMS error to the promised one above which a calibration is no longer as good as promised. On four data
sets of one robot, the RMS error in another region of the workspace is up to 1.3 times larger."""

ELSEWHERE = 20.0
"""Ratio of the RMS error to the promised one above which another region of the workspace cannot be the cause."""

MOSTLY = 5.0
"""If errors are above `ELSEWHERE`, and refitting base and tool divides them by more than this, frames have moved."""

ALIKE = 0.75
"""If errors have no known cause, and the calibrated arm's RMS error is at least this share of the nominal arm's RMS
error, the rows are of another arm."""

Status = Literal[
    "still good",
    "worse than nominal",
    "no better than nominal",
    "drifted",
    "outside what was measured",
    "another station",
    "another arm",
]


@dataclass(frozen=True, eq=False)
class Verification:
    """The verdict on an old calibration from new rows.

    Attributes:
        status: The verdict.
        reason: The reason for the verdict, as a sentence.
        calibrated: Position errors of the calibrated arm, mm.
        nominal: Position errors of the nominal arm, mm. If frames were refitted for the calibrated arm, they were also
            refitted for the nominal arm, to the same rows.
        expected: RMS position error that the calibration promises, mm.
        rows: Number of rows judged.
        refitted: Number of rows to which base and tool were refitted; 0 if they were not.
        moved: How far the refitted base and tool moved.
        since: Text that names the row from which on every block of rows has too large errors; None if there is no
            such row.
        left_out: Outlier rows that were left out.
        no_gain: The reason why the rows do not show that the calibrated arm is better than the nominal arm; None if
            they show it.
        measured: Share of the rows that lie in the region measured for the calibration; None if it is not known.
        reservation: The sentence about the calibration's own verdict "do not use"; None if it has another verdict.
    """

    status: Status
    reason: str
    calibrated: ErrorStatistics
    nominal: ErrorStatistics
    expected: float
    rows: int
    refitted: int
    moved: Moves
    since: str | None
    left_out: tuple[LeftOut, ...]
    no_gain: str | None = None
    measured: float | None = None
    reservation: str | None = None

    @property
    def ratio(self) -> float:
        """Ratio of the RMS position error to the promised one."""
        return self.calibrated.rms / self.expected

    @property
    def as_promised(self) -> bool:
        """Whether errors are as small as promised, and do not grow from some row on."""
        return self.ratio <= GROWN and self.since is None

    def text(self) -> str:
        """Return the report for the terminal, which begins with the verdict."""
        heads = ("arm", "RMS (mm)", "mean (mm)", "95 % interval (mm)", "p95 (mm)", "max (mm)")
        rows = [(name, *error_cells(s)) for name, s in (("nominal", self.nominal), ("calibrated", self.calibrated))]
        anew = f"{' and '.join(self.moved)} found from {self.refitted} other rows, of both arms"
        frames = anew if self.refitted else "base and tool as they were"
        how = f"{frames}; expected of the calibrated arm: {figure(self.expected)} mm RMS"
        gain = f"{'no' if self.no_gain else 'yes'}: {figure(self.calibrated.rms)} of {figure(self.nominal.rms)} mm RMS"
        promise = f"{'yes' if self.ratio <= GROWN else 'no'}: {figure(self.ratio)} times the RMS expected"
        region = "not known" if self.measured is None else f"{100 * self.measured:.0f} % of the rows lie where it was"
        titles = ("does it beat the nominal arm", "is it as good as promised", "was this region measured")
        questions = Block("Three questions", (), tuple(zip(titles, (gain, promise, region), strict=True)))
        blocks = [questions, Block(f"Errors on {self.rows} rows", heads, tuple(rows), how)]
        if self.moved:
            moves = tuple((name, *self._moved(name)) for name in self.moved)
            blocks.append(Block("Moved since the calibration", ("frame", "by (mm)", "turned (deg)"), moves, ""))
        if self.left_out:
            far = tuple((item.text(),) for item in self.left_out)
            blocks.append(Block("Rows left out", (), far, "too far off to be measurements of these poses"))
        heading = [f"verdict: {self.status.upper()}: {self.reason}"]
        heading += [] if self.reservation is None else [f"reservation: {self.reservation}"]
        return "\n".join(heading + [block.text() for block in blocks])

    def _moved(self, name: str) -> Iterator[str]:
        """Yield a frame's shift (mm) and turn (deg) as texts that name the number of undetermined directions."""
        shift, turn, *untold = self.moved[name]
        for size, count in zip((shift * 1e3, float(np.degrees(turn))), untold, strict=True):
            some = f"{figure(size)}; {count} of 3 directions not told by these rows" if count else figure(size)
            yield "not told by these rows" if count == 3 else some

    def as_dict(self) -> dict[str, Any]:
        """Return the verification as values for JSON."""
        return {
            "status": self.status,
            "reason": self.reason,
            "reservation": self.reservation,
            "rows": self.rows,
            "refit_rows": self.refitted,
            "calibrated_mm": self.calibrated.as_dict(),
            "nominal_mm": self.nominal.as_dict(),
            "expected_rms_mm": self.expected,
            "beats_nominal": self.no_gain is None,
            "no_gain": self.no_gain,
            "times_expected": self.ratio,
            "measured_share": self.measured,
            "moved": {
                name: {
                    "mm": None if untold[0] == 3 else shift * 1e3,
                    "deg": None if untold[1] == 3 else float(np.degrees(turn)),
                    "untold_directions": untold,
                }
                for name, (shift, turn, *untold) in self.moved.items()
            },
            "since": self.since,
            "left_out_rows": [vars(item) for item in self.left_out],
        }


def verify(
    calibration: Calibration, data: Observations, refit: Collection[str] = (), refit_rows: int = REFIT_ROWS
) -> Verification:
    """Judge an old calibration on new rows.

    Args:
        calibration: The calibration.
        data: New poses or positions of the same robot.
        refit: Which of "base" and "tool" are refitted first, because the instrument or its target was moved. For a
            whole robot (a tree of links) both are always refitted, because its calibration does not hold the
            places of sensors and targets.
        refit_rows: Number of rows to which these frames are refitted. The calibration is judged on the other rows.

    Raises:
        InputError: If the data are not poses or positions, or too few. Also if one frame of a whole robot is named, or
            if ``refit`` lacks a frame that the calibration's own rows did not determine.
    """
    if calibration.arm.tree is not None:
        if len(refit) == 1:
            raise InputError("the place of sensor and target on a whole robot is always found anew; leave `refit` out")
        refit = OWN
    poses: Measurements | None = data.poses
    if poses is None:
        raise InputError(f"{data.source} holds {data.kind}; a calibration is verified on poses or positions")
    if len(poses) < 3:
        raise InputError(f"{data.source}: {len(poses)} rows judge nothing; measure at least 3")
    if untold := [frame for frame in _untold(calibration) if frame not in refit]:
        raise InputError(
            f"{data.source}: the place of {' and '.join(untold)} is not known for these rows, since "
            f"{calibration.record['source']}, from which the arm was calibrated, does not tell it; give "
            "`refit='base,tool'`"
        )
    nominal = replace(calibration, model=ArmModel.of(calibration.nominal), learnt=None)
    poses, left_out = near_rows(calibration, poses, refit, refit_rows)
    if refit:
        there, used, others, expected, moves = restationed(calibration, poses, refit, refit_rows)
        # The nominal arm sees the same rows: nobody is blamed for where the instrument stands.
        nominal_there, *_ = restationed(nominal, poses, refit, refit_rows, used)
        judging = poses.select(others)
        errors, before = errors_there(there, calibration, judging), errors_there(nominal_there, nominal, judging)
    else:
        there, used, others, moves = calibration, np.arange(0), np.arange(len(poses)), {}
        judging, expected = poses, promised(calibration, poses)
        errors, before = calibration.errors(poses), nominal.errors(poses)
    blocks = np.arange(len(others)) * BLOCKS // len(others) if len(others) >= 4 * BLOCKS else None
    mine, theirs = (error_statistics(e[:, :3] * 1e3, blocks) for e in (errors, before))
    inside = calibration.measured_there(judging.joints, judging.conditions)
    measured = None if inside is None else float(inside.mean())
    region_known = measured is None or measured >= 0.5  # elsewhere errors grow with the region, and not with the day
    count, rms = len(others), float(np.sqrt(expected.mean())) * 1e3
    late = _since(errors, expected) if region_known else None
    since = None if late is None else "from {}, row {}, on".format(*origins_of(poses).place(int(others[late])))
    gain = next(no_gain(before, errors, np.arange(count), "mm", count, "rows"), None)
    draft = Verification("still good", "", mine, theirs, rms, count, len(used), moves, since, left_out, gain, measured)
    cause: Cause | None = None
    if not draft.as_promised:
        far = np.arange(late or 0, count)  # rows before the change say nothing of its cause
        places = inside if late is None else None
        cause = _cause(there, judging.select(far), errors[far], expected[far], places, refit)
    status, reason = _verdict(draft, cause)
    return replace(draft, status=status, reason=reason, reservation=calibration.reservations().get(DO_NOT_USE))


def _untold(calibration: Calibration) -> list[str]:
    """Return which of "base" and "tool" were fitted to rows that do not determine them, such as a wire's rows."""
    sure = uncertainty_from(calibration.record)
    if sure is None or calibration.record.get("frames") != "fitted":
        return []
    wide = never_told(sure.names, sure.covariance)
    lost = {name.partition("_")[0] for name in wide if not name.startswith("tool_r")}  # a turn there moves no point
    return [frame for frame in OWN if frame in lost or not any(name.startswith(frame) for name in sure.names)]


def promised(calibration: Calibration, data: Measurements) -> Array:
    """Compute the mean square position error ``(N,)``, m^2, that the calibration's uncertainty promises at each row."""
    (position, _), _ = calibration.uncertainty(data.joints, data.conditions)
    if position is None:
        return np.full(len(data), expected_square(weighed_by_reach(calibration, data)))
    return np.asarray(np.maximum(position**2, expected_square(data)))


def _since(errors: Array, expected: Array) -> int | None:
    """Return the index, from 0, of the judged row from which on every block of rows has too large errors.

    The result is None if there is no such row, or if all blocks have too large errors.

    Args:
        errors: Errors of the R judged rows ``(R, 3 or 6)``, m and rad.
        expected: Expected mean square position error of each row ``(R,)``, m^2.
    """
    if len(errors) < 4 * BLOCKS:
        return None
    parts = np.array_split(np.arange(len(errors)), BLOCKS)
    large = np.array([position_rms(errors[part]) > GROWN * np.sqrt(expected[part].mean()) for part in parts])
    if not large[-1] or large.all():
        return None
    return int(parts[np.flatnonzero(~large)[-1] + 1][0])


Cause = Literal["frames", "elsewhere", "joints", "unknown"]


def _cause(
    there: Calibration,
    data: Measurements,
    errors: Array,
    expected: Array,
    inside: NDArray[np.bool_] | None,
    refit: Collection[str],
) -> Cause:
    """Find the cause of errors larger than promised: moved frames, a region not measured, or changed joint zeros.

    Args:
        there: The calibration, with the frames in ``refit`` refitted.
        data: The R rows.
        errors: Errors of the rows under ``there`` ``(R, 3 or 6)``, m and rad.
        expected: Expected mean square position error of each row ``(R,)``, m^2.
        inside: Mask ``(R,)`` of the rows in the measured region; None if the region is not known.
        refit: Which of "base" and "tool" were refitted.
    """
    most, size = GROWN * float(np.sqrt(expected.mean())), position_rms(errors)
    far, all_found = size > ELSEWHERE * most / GROWN, set(refit) == set(OWN)
    if far and not all_found and _left(there, data, errors, own_frames_model(there.identified, OWN)) < size / MOSTLY:
        return "frames"
    if inside is not None and not inside.all() and not far:
        as_promised = inside.any() and position_rms(errors[inside]) ** 2 <= GROWN**2 * np.mean(expected[inside])
        if as_promised or inside.mean() < 0.5:
            return "elsewhere"
    zeros = joint_zeros_model(there.identified)
    inner = ErrorModel(zeros.columns[1:-1], zeros.names[1:-1], zeros.tolerance[1:-1])  # base and tool turn the others
    if _left(there, data, errors, inner.joined(own_frames_model(there.identified, refit))) <= most:
        return "joints"
    if not all_found and _left(there, data, errors, own_frames_model(there.identified, OWN)) <= most:
        return "frames"
    return "unknown"


def _left(there: Calibration, data: Measurements, errors: Array, model: ErrorModel) -> float:
    """Compute the RMS position error, m, that remains after some parameters are fitted to the rows.

    The result is corrected for the degrees of freedom, and infinite if the fit fails.

    Args:
        there: The calibration to start from.
        data: The R rows.
        errors: Errors of the rows under ``there`` ``(R, 3 or 6)``, m and rad.
        model: The parameters to fit.
    """
    if len(data) < len(model.names):
        return np.inf
    learnt = errors - data.difference(there.model)  # in the axes of the other station's base
    try:
        solution = identify(model, there.model, _less(data, learnt), max_iterations=60)
    except InputError:
        return np.inf
    unexplained = data.difference(solution.arm_model) + learnt
    spare = 1.0 - solution.identifiability.rank / (len(data) * data.rows_per_pose)
    return position_rms(unexplained) / float(np.sqrt(spare))


def _less(data: Measurements, learnt: Array) -> Measurements:
    """Subtract the residual model's prediction from the rows; ``learnt`` ``(N, 3 or 6)`` is the prediction times -1."""
    position = data.position + learnt[:, :3]
    if data.rotation is None or learnt.shape[1] < 6:
        return replace(data, position=position)
    return replace(data, position=position, rotation=rotation_matrix(learnt[:, 3:]) @ data.rotation)


def _verdict(found: Verification, cause: Cause | None) -> tuple[Status, str]:
    """Return the verdict and its reason as a sentence.

    Args:
        found: The verification so far, with errors but without a verdict.
        cause: The cause of errors that are larger than promised.
    """
    mine, theirs, since = found.calibrated.rms, found.nominal.rms, found.since
    sizes = f"{figure(mine)} mm RMS where {figure(found.expected)} mm are expected"
    if found.as_promised:
        if found.no_gain is not None:
            return "worse than nominal" if mine >= theirs else "no better than nominal", f"{sizes}, but {found.no_gain}"
        place = "" if found.measured is None or found.measured >= 0.5 else "; it was not measured here before"
        return "still good", f"{sizes}, and {figure(theirs)} mm with the nominal arm{place}"
    if cause == "frames":
        begin, alone = ("", "") if since is None else (f"{since} ", "those rows alone, and ")
        explained = f"{begin}base and tool elsewhere explain it; give {alone}`refit='base,tool'`"
        return "another station", f"{sizes}, and {explained}"
    if cause == "elsewhere":
        worse = f", worse than the nominal arm's {figure(theirs)} mm" if found.no_gain is not None else ""
        return "outside what was measured", (
            f"{sizes}{worse}: only {100 * (found.measured or 0.0):.0f} % of the rows lie where it was measured; "
            "measure there too, and calibrate with all rows"
        )
    if cause == "unknown" and mine >= (ALIKE if since is None else 1.0) * theirs:
        return "another arm", (
            f"{sizes}, where the nominal arm misses by {figure(theirs)} mm, and no place of base and tool and no zeros "
            "of the joints explain it: it is of another arm; calibrate anew"
        )
    grown = float(np.sqrt(max(mine**2 - found.expected**2, 0.0)))
    when = f" {since}" if since else " since the calibration"
    how = "the joints' zeros explain it" if cause == "joints" else "by a change of the arm"
    return "drifted", (
        f"{sizes}: it is this arm's, for the nominal one misses by {figure(theirs)} mm, but {figure(grown)} mm RMS "
        f"have come{when}, {how}; calibrate anew"
    )
