"""Checks of a data set as a whole: outliers, held-out rows that were trained on, mixed units, rows of another set-up.

No single cell shows these faults. A robust fit, which is always made, identifies the poses that agree with each other.
If the errors of the other poses have a common cause, such as one column in another unit, the cause is reported.
Held-out rows pass the same checks. A set-up is one place of the instrument, and one place of its target on the tool.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

import numpy as np
from scipy.spatial import KDTree
from scipy.stats import binom

from pickenv.arm import Arm, Array, rotation_matrix, rotation_vector
from pickenv.base import InputError, count_of
from pickenv.calibration.identification.least_squares import Identification, unknowns_of
from pickenv.calibration.identification.robust import OUTLIER_SIGMA, align, apart, misses_of, robust_fit, sigma_of
from pickenv.calibration.model.arm_model import frames_model
from pickenv.calibration.model.measurements import Measurements
from pickenv.calibration.model.observations import MISS_UNITS, SAME_POSE, Kind, Observations, Rows, named, origins_of
from pickenv.calibration.model.pixels import STARTING, PixelObservations

# Rows to judge by that are rows trained on.

CHANCE, ROUGH = 0.2, 0.9
UNLIKELY = 1e-3
"""Probability below which equal readings of repeated poses are not attributed to chance. One reading is equal by chance
with the probability `CHANCE`, or `ROUGH` if both files are written in steps of more than twice
`Observations.rounding`."""

IDENTICAL = 1e-8
"""Largest difference of joint values that count as the same number, rad or m."""


Weight = Literal["fail", "caution", "note"]
Said = Iterator[tuple[Weight, str]]
"""Remarks for a verdict: the weight and the sentence of each."""


def refuse_trained(train: Observations, test: Observations) -> None:
    """Refuse held-out rows that are copies of training rows, also if they are rounded or in another order.

    A held-out row may be a repeated measurement at a training pose. Then its reading differs by the scatter of
    instrument and arm. A copy is at the same pose (`SAME_POSE`) and has the same reading, within
    `Observations.rounding` or within the last digit written. Copies are refused if there are more of them than
    repeated measurements would give by chance (binomial test, `UNLIKELY`). If readings are labels, such as a socket's
    number, the joint values are compared in their place.

    Raises:
        InputError: If there are copies; the message names the files and lines of these rows and of the training rows.
    """
    copies, originals = [], []
    for test_part in test.parts:
        for train_part in train.parts:
            rows, copied = _copies(train_part, test_part)
            copies += [origins_of(test_part).place(row) for row in rows.tolist()]
            originals += [origins_of(train_part).place(row) for row in copied.tolist()]
    if copies:
        raise InputError(
            f"{named(copies)} of the rows to judge by: trained on too ({named(originals)}), with the same joints and, "
            "but for rounding, the same reading; give rows that were measured by themselves"
        )


def said_of_repeats(train: Observations, test: Observations) -> Said:
    """Yield a remark if held-out rows are at poses of training rows: a caution if most rows are, else a note."""
    rows = len(test.joints)
    count = int(np.count_nonzero(_nearest(train.joints, test.joints, SAME_POSE) >= 0)) if rows else 0
    if count:
        sentence = f"{count} of {rows} held-out rows are at poses that were trained on, and say nothing of others"
        yield "caution" if 2 * count > rows else "note", sentence


def _copies(known: Observations, other: Observations) -> tuple[Rows, Rows]:
    """Return indices, from 0, of rows of ``other`` that copy rows of ``known``, and the indices of the copied rows.

    Both are empty if chance explains the equal readings, or if the data sets are of different kinds.
    """
    none = np.zeros(0, dtype=np.int64)
    mine, theirs = known.readings(), other.readings()
    if type(known) is not type(other) or mine.shape[1] != theirs.shape[1] or not len(mine) or not len(theirs):
        return none, none
    rounded, near = known.rounding, SAME_POSE
    if 2 * len(np.unique(mine, axis=0)) <= len(mine):  # labels
        mine, theirs, rounded, near = known.joints, other.joints, IDENTICAL, IDENTICAL
    poses = int(np.count_nonzero(_nearest(known.joints, other.joints, near) >= 0))
    digits = sorted((_digit(mine), _digit(theirs)))
    for size in (min(rounded, digits[1] / 2), rounded):
        chance = ROUGH if digits[0] > 2 * rounded else CHANCE * size / rounded
        size = size * (1.0 + 1e-6) + 1e-10  # but for the last bits
        ours, others = np.hstack([known.joints / near, mine / size]), np.hstack([other.joints / near, theirs / size])
        copied = _nearest(ours, others, 1.0)
        rows = np.flatnonzero(copied >= 0)
        if len(rows) and binom.sf(len(rows) - 1, poses, chance ** mine.shape[1]) < UNLIKELY:
            return rows, copied[rows]
    return none, none


def _nearest(known: Array, other: Array, within: float) -> Rows:
    """Return, for each row of ``other`` ``(M, k)``, the index from 0 of the nearest row of ``known`` ``(N, k)``.

    It is -1 if no row of ``known`` differs by at most ``within`` in every coordinate.
    """
    _, nearest = KDTree(known).query(other, p=np.inf, distance_upper_bound=within * (1.0 + 1e-6) + 1e-12)
    return np.where(nearest < len(known), nearest, -1)


def _digit(values: Array) -> float:
    """Return the largest decimal step (1, 0.1, …), at least 1e-9, of which all these numbers are multiples."""
    return next((10.0**-n for n in range(9) if np.allclose(values, np.round(values, n), rtol=0.0, atol=1e-10)), 1e-9)


# Rows far off, units mixed within a column, and rows of another set-up.

EXPLAINED = 8.0
"""Another unit explains an outlier if the row's error in that unit is below this many robust standard deviations."""

MANY_FAR = 0.05
"""Share of rows that are outliers above which the verdict gives a caution."""

ANOTHER_ARM = 5.0
"""A station whose median residual is more than this many times the others' median probably measured another arm."""

SIDE, MOVED = 8, 2.5
"""Least count of rows on either side of a move, and least ratio of two RMS errors: with one base, and with two."""

FEW = 4
"""Fewer held-out rows than this are listed one by one, and never taken for rows of another set-up."""


LEAST_CORNERS = 6
"""Least number of corners found in a picture for its view to be used; in a table of corners, one is enough."""

LEAST_VIEWS = 4
"""Least number of views for a fit of camera and board: two frames with six parameters each, and some redundancy."""


@dataclass(frozen=True)
class LeftOut:
    """A row that was left out, as an outlier or a view of too little of the board; or an outlier that was kept.

    Attributes:
        file: The row's file.
        line: The row's line in the file, from 1.
        held_out: Whether the row was among the held-out rows.
        position: Size of the row's largest miss, m, or rad if directions are measured; None if the row is not an
            outlier.
        attitude: Size of the row's attitude error, rad; None if no attitudes were measured.
        sigma: Size of the row's error in robust standard deviations of one coordinate.
        why: The reason in words, if one is known.
        kept: Whether the row was kept, although it is an outlier.
        unit: Unit in which the miss is shown, one of `MISS_UNITS`.
    """

    file: str
    line: int
    held_out: bool
    position: float | None = None
    attitude: float | None = None
    sigma: float | None = None
    why: str | None = None
    kept: bool = False
    unit: str = "mm"

    @property
    def miss(self) -> str:
        """Text of the row's largest miss, with its unit."""
        return f"{(self.position or 0.0) * MISS_UNITS[self.unit]:.3g} {self.unit}"

    def text(self) -> str:
        """Return a line that names the row, its error and the reason, for people."""
        if self.position is None or self.sigma is None:
            return f"{self.file}: row {self.line}: {self.why}"
        turned = "" if self.attitude is None else f", {np.degrees(self.attitude):.3g} deg"
        part = ("held out" if self.held_out else "training") + (", kept" if self.kept else "")
        why = "" if self.why is None else f"; fits only if {self.why}"
        return f"{self.file}: row {self.line} ({part}): {self.miss}{turned}, {self.sigma:.0f} sigma{why}"


def checked_rows(
    arm: Arm, train: Kind, test: Kind, *, known: bool, robust: bool
) -> tuple[Kind, Kind, tuple[LeftOut, ...]]:
    """Return training and held-out rows without outliers, which a robust fit to the training rows identifies.

    Args:
        arm: The arm.
        train: Rows to fit; the robust fit to them judges both sets.
        test: Held-out rows; there may be none.
        known: Whether base and tool are known.
        robust: Whether outliers are left out; otherwise they are only listed.

    Returns:
        Training rows, held-out rows, and the outliers, the largest error first. If all of a few held-out rows are
        outliers, they stay in the held-out rows. If the robust fit fails, or half of the training rows are outliers,
        both sets are unchanged and no outliers are returned.

    Raises:
        InputError: If most held-out rows are outliers, as rows of another set-up are.
    """
    try:
        found, (_, _, scales) = robust_fit(arm, train, known)
    except InputError:
        return train, test, ()  # too few rows, or no majority: the fit itself says what is wrong
    sets: tuple[Kind, ...] = (train, test) if len(test.joints) else (train,)
    of_test = scales[train.channels_of(test)]  # of held-out rows some stations may have none
    sizes = [sigma_of(found, data, of_test if data is test else scales) for data in sets]
    far = [np.flatnonzero(~(size <= OUTLIER_SIGMA)) for size in sizes]
    if 2 * len(far[0]) >= len(train.joints):
        return train, test, ()
    if len(test.joints) >= FEW and 2 * len(far[1]) > len(test.joints):
        raise InputError(_other_set_up(arm, found, scales, train, test))
    if len(sets) > 1 and len(far[1]) == len(test.joints):
        far[1] = far[1][:0]  # not these rows are far off, but what so few told; and nothing else is there to judge by
    listed: list[LeftOut] = []
    for data, size, rows in zip(sets, sizes, far, strict=True):
        if not len(rows):
            continue
        missed, turned, why = misses_of(found, data), None, None
        if data.poses is not None:
            why = mixed_unit(arm, partial(sigma_of, found, scales=scales), data.poses, rows)
            if data.poses.rotation is not None:
                turned = np.linalg.norm(data.poses.difference(found.arm_model)[:, 3:], axis=1)
        for row in rows.tolist():
            attitude, place = None if turned is None else float(turned[row]), origins_of(data).place(row)
            size_and_miss = float(missed[row]), attitude, float(size[row])
            listed.append(LeftOut(*place, data is test, *size_and_miss, why, not robust, data.miss_unit))
    sets = (train.weighed(scales), *sets[1:])
    if robust:
        near = [np.setdiff1d(np.arange(len(data.joints)), rows) for data, rows in zip(sets, far, strict=True)]
        sets = tuple(data.select(rows) for data, rows in zip(sets, near, strict=True))
    train, test = (*sets, test)[:2]
    return train, test, tuple(sorted(listed, key=lambda item: -(item.sigma or 0.0)))


def said_of_rows(listed: Sequence[LeftOut], rows: int) -> Said:
    """Yield a remark on outliers: a caution if they are kept, many, or of one cause, else a note.

    Args:
        listed: The outliers, and other rows left out.
        rows: Count of all rows, including the rows left out.
    """
    far = [item for item in listed if item.sigma is not None]
    if not far:
        return
    single, worst = len(far) == 1, max(far, key=lambda item: item.position or 0.0)
    many = len(far) > MANY_FAR * rows
    causes = dict.fromkeys(item.why for item in far if item.why is not None)
    them = f"{len(far)} of {rows} rows {'is' if single else 'are'} far off, by up to {worst.miss}"
    if any(item.kept for item in far):
        yield "caution", f"{them}, and {'was' if single else 'were'} kept all the same; a robust fit leaves them out"
    elif causes:
        yield "caution", f"{them}, and left out: they fit only if {'; '.join(causes)}; write all rows in one unit"
    else:
        yield "caution" if many else "note", f"{them}, and {'was' if single else 'were'} left out"


def said_of_files(listed: Sequence[LeftOut], kept: Sequence[Observations]) -> Said:
    """Yield a caution for each file of which all rows, or only first rows, or only last rows were left out.

    First or last rows count if at least `SIDE` of them are outliers.

    Args:
        listed: The rows left out.
        kept: The data sets that remain.
    """
    for file in dict.fromkeys(item.file for item in listed if not item.kept):
        count = sum(item.file == file for item in listed)
        far = [item.line for item in listed if item.file == file and item.sigma is not None]
        places = (origins_of(data).place(row) for data in kept for row in range(len(data.joints)))
        used = [line for name, line in places if name == file]
        if not used:
            yield (
                "caution",
                f"{file}: all {count} rows are far off from the other files', and left out: check that they are of "
                "this arm, with the same units, joint signs and order of rows, or leave the file out",
            )
        elif len(far) >= SIDE and (min(far) > max(used) or max(far) < min(used)):
            these = f"from row {min(far)} on" if min(far) > max(used) else f"up to row {max(far)}"
            yield (
                "caution",
                f"{file}: all rows {these} are far off, and left out: the instrument was probably moved there, so give "
                "these rows as a file of their own",
            )


def said_of_stations(found: Identification, data: Observations) -> Said:
    """Yield a caution for each station whose residuals are far larger than the residuals of the other stations.

    Base and tool of each station are fitted, so another set-up cannot be the cause.
    """
    if not data.stations or len({part.miss_unit for part in data.parts}) > 1:
        return
    sizes = np.linalg.norm(data.misses(found.arm_model, unknowns_of(found, data)), axis=1)
    ends = np.cumsum([len(part.rows_of_misses) for part in data.parts])
    usual = [float(np.median(misses)) for misses in np.split(sizes, ends[:-1])]
    for number, part in enumerate(data.parts):
        others = float(np.median(usual[:number] + usual[number + 1 :])) if len(usual) > 1 else usual[number]
        if usual[number] > ANOTHER_ARM * others:
            scale, unit = MISS_UNITS[part.miss_unit], part.miss_unit
            yield (
                "caution",
                f"{part.source}: wherever base and tool may be, its rows miss by {usual[number] * scale:.3g} {unit} "
                f"(median), the others by {others * scale:.2g} {unit}: it may be of another arm; calibrate it alone",
            )


def said_of_moves(found: Identification, data: Observations) -> Said:
    """Yield a caution for each file of poses or positions within which the instrument was moved.

    In such a file, a second base from some row on removes most of the errors. It would remove only half of the errors
    of a steady drift.
    """
    ends = np.cumsum([len(part.rows_of_misses) for part in data.parts])
    misses = np.split(data.misses(found.arm_model, unknowns_of(found, data)), ends[:-1])
    for part, missed in zip(data.parts, misses, strict=True):
        origins = origins_of(part)
        for file in np.unique(origins.file).tolist():
            rows = np.flatnonzero(origins.file == file)
            rows = rows[np.argsort(origins.line[rows], kind="stable")]
            if part.poses is None or len(rows) < 2 * SIDE:
                continue
            places = part.poses.position[rows] - part.poses.position[rows].mean(axis=0)
            turns = np.cross(places[:, None], np.eye(3)) / max(float(places.std()), 1e-6)
            shifts = np.broadcast_to(np.eye(3), turns.shape)
            terms = np.concatenate([shifts, turns, missed[rows, :3, None]], axis=2)
            before = np.cumsum(terms.swapaxes(1, 2) @ terms, axis=0)
            split = np.arange(SIDE, len(rows) - SIDE + 1)  # count of rows before the step
            two = _beside_base(before[split - 1]) + _beside_base(before[-1] - before[split - 1])
            first = int(np.argmin(two))
            one, two = (np.sqrt(max(left, 0.0) / len(rows)) for left in (_beside_base(before[-1]), two[first]))
            if one > MOVED * two and one > MOVED * part.poses.position_std:
                yield (
                    "caution",
                    f"{origins.files[file]}: from row {origins.line[rows[split[first]]]} on its rows fit another base: "
                    f"{two * 1e3:.2g} mm RMS remain with two bases, {one * 1e3:.2g} mm with one; the instrument was "
                    "probably moved, so give the rows from there as a file of their own",
                )


def _beside_base(sums: Array) -> Array:
    """Return the sum of squared errors ``(...)`` that remains with the best base.

    Args:
        sums: Sums of the products of seven columns ``(..., 7, 7)``: the base's six derivatives, then the errors.
    """
    slope = np.linalg.pinv(sums[..., :6, :6], 1e-9, True) @ sums[..., :6, 6:]
    return np.asarray(sums[..., 6, 6] - (sums[..., 6:, :6] @ slope)[..., 0, 0])


def _other_set_up(arm: Arm, found: Identification, scales: Array, train: Observations, test: Observations) -> str:
    """Return why most held-out rows do not fit: another unit, another place of base or tool, or something else.

    Args:
        arm: The arm.
        found: The robust fit to the training rows.
        scales: The fit's robust standard deviation of each channel ``(C,)``. A channel is the readings of one
            instrument in one unit.
        train: Training rows.
        test: Held-out rows.
    """
    files = ", ".join(dict.fromkeys(origins_of(test).place(row)[0] for row in range(len(test.joints))))
    scale = MISS_UNITS[test.miss_unit]
    away = f"{np.median(misses_of(found, test)) * scale:.3g} {test.miss_unit}"
    if test.poses is not None:
        unit = mixed_unit(arm, partial(sigma_of, found, scales=scales), test.poses, np.arange(len(test.joints)))
        if unit is not None:
            return f"{files}: the held-out rows fit the training rows only if {unit}; write both in one unit"
        geometry = found.geometry
        try:
            realigned = align(geometry, test.poses, frames_model(geometry)).geometry
        except InputError:
            realigned = geometry
        moved = replace(found, arm_model=replace(found.arm_model, geometry=realigned))
        if float(np.median(sigma_of(moved, test, scales))) <= OUTLIER_SIGMA / 2:
            base, tool = (
                f"{metres * 1e3:.3g} mm and {np.degrees(angle):.3g} deg"
                for metres, angle in (apart(geometry.base, realigned.base), apart(geometry.tool, realigned.tool))
            )
            return (
                f"{files}: the held-out rows were measured in another set-up (they miss by {away}, median): with the "
                f"base moved by {base} and the tool by {tool} they fit; hold out rows of the training rows' own "
                "set-up, or calibrate this file by itself"
            )
    usual = f"{np.median(misses_of(found, train)) * scale:.2g} {test.miss_unit}"
    return (
        f"{files}: most held-out rows miss by {away} (median), where half of the training rows miss by less than "
        f"{usual}, and no other place of base or tool explains it; check that they are of this arm, with the same "
        "units, joint signs and order of rows"
    )


def mixed_unit(arm: Arm, sigma: Callable[[Measurements], Array], measurements: Measurements, rows: Rows) -> str | None:
    """Return, in words, the column and unit that explain most of the outliers; None if none does.

    Args:
        arm: The arm.
        sigma: Function that returns the errors of rows ``(N,)``, in robust standard deviations.
        measurements: The rows.
        rows: Indices, from 0, of the outliers among the rows.
    """
    outliers = measurements.select(rows)
    explained = {words: float(np.mean(sigma(reading) < EXPLAINED)) for words, reading in _readings(arm, outliers)}
    best = max(explained, key=lambda words: explained[words])
    return best if explained[best] >= 0.8 else None


def _readings(arm: Arm, data: Measurements) -> Iterator[tuple[str, Measurements]]:
    """Yield copies of the rows in which one column is read in another unit.

    Each copy comes after words that name the column and the unit.
    """
    length, angle = ("mm", "m", 1e-3), ("deg", "rad", np.pi / 180)
    values = {"joints": data.joints, "position": data.position}
    columns = [
        (f"joint {i + 1} ({arm.nominal.joint_names[i]})", "joints", [i], length if slides else angle)
        for i, slides in enumerate(arm.nominal.prismatic)
    ]
    axes_of = {"the position": [0, 1, 2], "x": [0], "y": [1], "z": [2]}
    columns += [(label, "position", axes, length) for label, axes in axes_of.items()]
    if data.rotation is not None:
        values["rotation"] = rotation_vector(data.rotation)
        columns.append(("the attitude", "rotation", [0, 1, 2], angle))
    for label, name, axes, (small, large, factor) in columns:
        for unit, elsewhere, scale in ((small, large, factor), (large, small, 1 / factor)):
            changed = values[name].copy()
            changed[:, axes] *= scale
            rows = replace(data, **{name: rotation_matrix(changed) if name == "rotation" else changed})  # type: ignore[arg-type]
            yield f"{label} is read in {unit} there and in {elsewhere} elsewhere", rows


def without_blind_views(data: Observations) -> tuple[Observations, tuple[LeftOut, ...]]:
    """Return the data without views that show too little of the board, and the views left out.

    Data of other kinds are unchanged.

    Raises:
        InputError: If too few views show where their board is (`PixelObservations.starters`).
    """
    first, left_out = 0, []
    for part in data.parts:
        reasons = {} if part.views is None else _blind_views(part.views)
        left_out += [(first + row, why) for row, why in reasons.items()]
        first += len(part.joints)
    if not left_out:
        return data, ()
    origins, rows = origins_of(data), np.setdiff1d(np.arange(first), [row for row, _ in left_out])
    return data.select(rows), tuple(LeftOut(*origins.place(row), held_out=False, why=why) for row, why in left_out)


def _blind_views(views: PixelObservations) -> dict[int, str]:
    """Return the reasons why views are left out, by the view's index from 0: too few corners, or all near one line.

    In a table of corners, only views without corners are left out.

    Raises:
        InputError: If fewer than `LEAST_VIEWS` views show enough of the board.
    """
    counts, found = views.seen.sum(axis=1), views.pictures is not None and not views.board[:, 2].any()
    least, remarks, starts = LEAST_CORNERS if found else 1, views.remarks, views.starters()
    reasons = {}
    for row in np.flatnonzero(counts < least).tolist():
        few = f"{count_of(counts[row], 'corner')} found; a view needs {least}"
        reasons[row] = (str(remarks[row]) if remarks is not None else "") or few
    for row in np.flatnonzero(found & ~starts & (counts >= least)).tolist():
        reasons[row] = f"its {counts[row]} corners lie near one line, and do not tell how the board is turned"
    if (enough := int(np.sum(starts & (counts >= least)))) < LEAST_VIEWS:
        more = "take more pictures, with the board larger in them" if found else f"see {STARTING} points in more views"
        raise InputError(
            f"{views.source}: {enough} of {len(counts)} views show enough of the board, of which {LEAST_VIEWS} are "
            f"needed; {more}"
        )
    return reasons
