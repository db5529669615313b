"""What is wrong with a data set as a whole: rows far off, units mixed within a column, rows of another set-up.

No single cell betrays these. A robust fit, always made, finds the poses that agree with each other; whatever the others
have in common (one column that fits in another unit) is said. Held-out rows pass the same checks before they judge.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pickenv.arm import Arm, Pose, rotation_matrix, rotation_vector
from pickenv.arm.kinematics.geometry import Array
from pickenv.calibration.identification.alignment import align
from pickenv.calibration.identification.robust import (
    OUTLIER_SIGMA,
    RobustIdentification,
    Sizes,
    robust_align,
    robust_identify,
    sizes_of,
)
from pickenv.calibration.model.error_model import frames_model, geometric_model
from pickenv.calibration.model.measurements import Measurements
from pickenv.calibration.model.observations import Observations, origins_of
from pickenv.calibration.model.origins import named
from pickenv.calibration.model.pixels import PixelObservations
from pickenv.calibration.model.splits import Rows, equally_spaced
from pickenv.errors import InputError

EXPLAINED = 8.0
"""A unit explains an outlier when it brings it within this many robust standard deviations."""

ROBUST_ROWS = 2000
"""The robust fit is made on so many rows at most, taken evenly; all rows are judged by it."""

FEW = 4
"""Fewer held-out rows than this are named one by one, and never taken for another set-up."""


LEAST_CORNERS = 6
"""A view with fewer corners says too little of where its board is."""

LEAST_SPREAD = 0.05
"""A view's corners must spread so far across their longest line, as a share of the spread along it."""

LEAST_VIEWS = 4
"""Views that a fit of camera and board needs: two frames of six numbers, with some to spare."""


@dataclass(frozen=True)
class LeftOut:
    """A row that does not fit the others and was left out.

    Attributes:
        file: Its file.
        line: Its line there, from 1.
        held_out: Whether it was among the held-out rows.
        position: Size of its position error, m; None where that is not the reason.
        attitude: Size of its attitude error, rad; None where only positions were measured.
        sigma: The larger of both in robust standard deviations of one coordinate.
        why: The reason in words, where it is not the size of its error.
    """

    file: str
    line: int
    held_out: bool
    position: float | None = None
    attitude: float | None = None
    sigma: float | None = None
    why: str | None = None

    def text(self) -> str:
        """For people."""
        if self.position is None or self.sigma is None:
            return f"{self.file}: row {self.line}: {self.why}"
        turned = "" if self.attitude is None else f", {np.degrees(self.attitude):.3g} deg"
        part = "held out" if self.held_out else "training"
        return f"{self.file}: row {self.line} ({part}): {self.position * 1e3:.3g} mm{turned}, {self.sigma:.0f} sigma"


def _robust_fit(arm: Arm, measurements: Measurements, known: bool = False) -> RobustIdentification:
    """Geometry from the poses that agree with each other, with base and tool unless known; the same every time.

    Raises:
        InputError: If there are too few poses, or no majority agrees.
    """
    data = measurements.select(equally_spaced(len(measurements), ROBUST_ROWS))
    model = geometric_model(arm.nominal, known)
    start = arm.nominal
    if not known:
        start = robust_align(arm.nominal, data, frames_model(arm.nominal), np.random.default_rng(0)).geometry
    return robust_identify(model, start, data)


def checked_rows(
    arm: Arm, train: Measurements, test: Measurements, *, known: bool, robust: bool
) -> tuple[Measurements, Measurements, tuple[LeftOut, ...]]:
    """Training and held-out rows without those that are far off.

    Args:
        arm: The arm.
        train: Rows to fit; the robust fit to them is the measure for both.
        test: Rows to judge by.
        known: Whether base and tool are known.
        robust: Whether rows far off are left out; else they are refused.

    Returns:
        Both sets, and what was left out.

    Raises:
        InputError: Names file and line of rows that are far off and the column and unit if one explains them; or says
            that the held-out rows come from another set-up.
    """
    try:
        found = _robust_fit(arm, train, known)
    except InputError:
        return train, test, ()  # too few rows, or no majority: the fit itself says what is wrong
    sizes = (found.sizes_of(train), found.sizes_of(test))
    far = tuple(np.flatnonzero(~(size.sigma <= OUTLIER_SIGMA)) for size in sizes)
    if 2 * len(far[0]) >= len(train):
        return train, test, ()
    if len(test) >= FEW and 2 * len(far[1]) > len(test):
        raise InputError(_other_set_up(arm, found, test, sizes[1]))
    if not robust:
        _refuse(arm, found, (train, test), sizes, far)
    left_out = [
        _left_out(data, size, int(row), data is test)
        for data, size, rows in zip((train, test), sizes, far, strict=True)
        for row in rows
    ]
    kept = [
        data.select(np.setdiff1d(np.arange(len(data)), rows)) for data, rows in zip((train, test), far, strict=True)
    ]
    return kept[0], kept[1], tuple(sorted(left_out, key=lambda item: -(item.sigma or 0.0)))


def _left_out(data: Measurements, sizes: Sizes, row: int, held_out: bool) -> LeftOut:
    file, line = origins_of(data).place(row)
    attitude = None if sizes.attitude is None else float(sizes.attitude[row])
    return LeftOut(file, line, held_out, float(sizes.position[row]), attitude, float(sizes.sigma[row]))


def _refuse(
    arm: Arm,
    found: RobustIdentification,
    sets: tuple[Measurements, Measurements],
    sizes: tuple[Sizes, Sizes],
    far: Sequence[Rows],
) -> None:
    """Refuse rows that are far off, and say what they have in common."""
    places = [origins_of(data).place(int(row)) for data, rows in zip(sets, far, strict=True) for row in rows]
    if not places:
        return
    one = len(places) == 1
    for data, rows in zip(sets, far, strict=True):
        unit = mixed_unit(arm, found, data, rows) if len(rows) else None
        if unit is not None:
            raise InputError(
                f"{named(places)} {'fits' if one else 'fit'} only if {unit}: units are mixed in one column; write all "
                "its rows in one unit"
            )
    them = "it" if one else "them"
    worst = max(float(size.position[rows].max(initial=0.0)) for size, rows in zip(sizes, far, strict=True))
    raise InputError(
        f"{named(places)} {'is' if one else 'are'} off by {'' if one else 'up to '}{worst * 1e3:.3g} mm where the "
        f"others agree within {3 * found.sizes.position_scale * 1e3:.2g} mm; remove {them}, or fit with --robust, "
        f"which leaves {them} out"
    )


def _other_set_up(arm: Arm, found: RobustIdentification, test: Measurements, sizes: Sizes) -> str:
    """Why most held-out rows miss: another unit, another place of base or tool, or something else."""
    files = ", ".join(dict.fromkeys(origins_of(test).place(row)[0] for row in range(len(test))))
    unit = mixed_unit(arm, found, test, np.arange(len(test)))
    if unit is not None:
        return f"{files}: the held-out rows fit the training rows only if {unit}; write both in one unit"
    away = f"{np.median(sizes.position) * 1e3:.3g} mm"
    geometry = found.geometry
    try:
        moved = align(geometry, test, frames_model(geometry)).geometry
    except InputError:
        moved = geometry
    there = sizes_of(replace(found.identification.arm_model, geometry=moved), test, found.sizes)
    if float(np.median(there.sigma)) <= OUTLIER_SIGMA / 2:
        base, tool = _apart(geometry.base, moved.base), _apart(geometry.tool, moved.tool)
        return (
            f"{files}: the held-out rows were measured in another set-up (they miss by {away}, median): with the base "
            f"moved by {base} and the tool by {tool} they fit; hold out rows of the training rows' own set-up, or "
            "calibrate this file by itself"
        )
    return (
        f"{files}: most held-out rows miss by {away} (median), where the training rows agree within "
        f"{3 * found.sizes.position_scale * 1e3:.2g} mm, and no other place of base or tool explains it; check that "
        "they are of this arm, with the same units, joint signs and order of rows"
    )


def _apart(one: Pose, other: Pose) -> str:
    angle = np.degrees(np.arccos(np.clip((np.trace(one.rotation.T @ other.rotation) - 1) / 2, -1, 1)))
    return f"{np.linalg.norm(one.position - other.position) * 1e3:.3g} mm and {angle:.3g} deg"


def refuse_misses(train: Observations, test: Observations, misses: tuple[Array, Array]) -> None:
    """Refuse rows of reflectors, wires or sockets that miss by far more than the median training row.

    Args:
        train: Rows fitted.
        test: Held-out rows.
        misses: What the fitted model misses each by (`pickenv.calibration.identification.rows.misses`), m.

    Raises:
        InputError: Names file and line.
    """
    sizes = [np.linalg.norm(part, axis=1) for part in misses]
    limit = 2.0 * OUTLIER_SIGMA * float(np.median(sizes[0]))
    places, worst = [], 0.0
    for data, size in zip((train, test), sizes, strict=True):
        far = size > limit
        worst = max(worst, float(size[far].max(initial=0.0)))
        places += [origins_of(data).place(int(row)) for row in np.unique(data.rows_of_misses[far])]
    if places:
        raise InputError(
            f"{named(places)} {'misses' if len(places) == 1 else 'miss'} by up to {worst * 1e3:.3g} mm where half of "
            f"the training rows miss by less than {limit / 2 / OUTLIER_SIGMA * 1e3:.2g} mm; check and remove"
        )


def mixed_unit(
    arm: Arm, found: RobustIdentification, measurements: Measurements, rows: NDArray[np.int64]
) -> str | None:
    """The column and unit that explain most of the outliers, in words; None if none does."""
    outliers = measurements.select(rows)
    explained = {
        words: float(np.mean(found.sizes_of(other).sigma < EXPLAINED)) for words, other in _readings(arm, outliers)
    }
    best = max(explained, key=lambda words: explained[words])
    return best if explained[best] >= 0.8 else None


def _readings(arm: Arm, data: Measurements) -> Iterator[tuple[str, Measurements]]:
    """The same rows with one joint column, a position or the attitude read in another unit, and which in words."""
    length, angle = ("mm", "m", 1e-3), ("deg", "rad", np.pi / 180)
    values = {"joints": data.joints, "position": data.position}
    columns = [
        (f"joint {i + 1} ({arm.nominal.joint_names[i]})", "joints", [i], length if slides else angle)
        for i, slides in enumerate(arm.nominal.prismatic)
    ]
    for axes, label in (([0, 1, 2], "the position"), ([0], "x"), ([1], "y"), ([2], "z")):
        columns.append((label, "position", axes, length))
    if data.rotation is not None:
        values["rotation"] = rotation_vector(data.rotation)
        columns.append(("the attitude", "rotation", [0, 1, 2], angle))
    for label, name, axes, (small, large, factor) in columns:
        for here, elsewhere, scale in ((small, large, factor), (large, small, 1 / factor)):
            changed = values[name].copy()
            changed[:, axes] *= scale
            rows = replace(data, **{name: rotation_matrix(changed) if name == "rotation" else changed})  # type: ignore[arg-type]
            yield f"{label} is read in {here} there and in {elsewhere} elsewhere", rows


def telling_views(views: PixelObservations) -> tuple[PixelObservations, tuple[LeftOut, ...]]:
    """The views that tell where their board is, and those left out: too few corners, or all near one line."""
    left: list[LeftOut] = []
    kept = []
    for row, seen in enumerate(views.seen):
        count, why = int(seen.sum()), None
        if count < LEAST_CORNERS:
            why = f"{count} {'corner' if count == 1 else 'corners'} found; a view needs {LEAST_CORNERS}"
        elif _thinness(views.corners[row][seen]) < LEAST_SPREAD:
            why = f"its {count} corners lie near one line, and do not tell how the board is turned"
        if why is None:
            kept.append(row)
        else:
            left.append(LeftOut(*origins_of(views).place(row), held_out=False, why=why))
    if len(kept) < LEAST_VIEWS:
        raise InputError(
            f"{views.source}: {len(kept)} of {len(views.joints)} views show enough of the board, of which "
            f"{LEAST_VIEWS} are needed; take more pictures, with the board larger in them"
        )
    return views.select(np.array(kept)), tuple(left)


def _thinness(places: Array) -> float:
    """Spread of points ``(N, 2)`` across their longest line, as a share of that along it."""
    along, across = np.linalg.svd(places - places.mean(axis=0))[1]
    return float(across / along)
