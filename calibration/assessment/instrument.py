"""Check what was stated about instruments, frames and arm against the measured rows.

A wire whose zero is wrong by millimetres still leaves small residuals, because the fit of anchor and links absorbs the
error. The arm is then wrong at other poses. Each number that was stated as known is therefore fitted afterwards, to see
whether the residuals shrink.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy import stats

from pickenv.arm import Array, Geometry, forward, parameter_jacobian
from pickenv.calibration.assessment.screen import Block, figure
from pickenv.calibration.identification.diagnosis import Said
from pickenv.calibration.identification.least_squares import Identification, identify, is_angle, unknowns_of
from pickenv.calibration.identification.robust import apart
from pickenv.calibration.model import measurements
from pickenv.calibration.model.arm_model import ANGLE_TOLERANCE, LENGTH_TOLERANCE, ArmModel, ErrorModel, frames_model
from pickenv.calibration.model.kinds import DistanceObservations
from pickenv.calibration.model.noise_and_priors import ANGLES, FRAMES, LENGTHS, TERMS, ZEROS, PriorModel
from pickenv.calibration.model.observations import Observations, origins_of
from pickenv.calibration.model.pixels import LENS_NAMES

# What a calibration with fitted base and tool leaves open: the error in the robot's own base frame. An instrument
# that stood anywhere cannot tell a base that lies elsewhere from links that shift or turn everything alike. The
# commands then put the tool where the *fitted* base and tool want it. How far that is from where the robot's own base
# frame wants it depends on how far both lie from where the controller has them, which these data do not show; an
# interval follows from an assumption that is printed with it. SI units.

DRAWS = 400
"""Number of random bases and tools from which the interval of a `BaseFrameError` is computed."""

SCALES = (0.2, 1.0)
"""Smallest and largest standard deviation by which the true base and tool differ from the controller's, in mm and mrad
per axis. Each draw takes a standard deviation between the two, whose logarithm is uniformly distributed."""

NEAR = 0.05
"""Limit on `BaseFrameError.moved`, m, below which the instrument was probably registered to the robot's base."""


@dataclass(frozen=True)
class BaseFrameError:
    """Interval of the mean position error in the robot's own base frame, over the judged poses.

    Attributes:
        low: Lower end of the 95 % interval, m; NaN if no position was measured.
        high: Upper end of the 95 % interval, m; NaN if no position was measured.
        moved: Mean shift of the nominal arm's tool over these poses, m, if the controller's base and tool are replaced
            by the fitted ones. It is small if the instrument was registered to the base.
        tracked: Whether the instrument measures positions in its own frame, which may be the base frame.
    """

    low: float
    high: float
    moved: float
    tracked: bool

    def as_dict(self) -> dict[str, Any]:
        """Return the interval and its assumptions as values for JSON and a calibration's record, mm and mrad."""
        return {
            "mean_ci95_mm": None if np.isnan(self.low) else [self.low * 1e3, self.high * 1e3],
            "assumed_std_mm": [scale * LENGTH_TOLERANCE * 1e3 for scale in SCALES],
            "assumed_std_mrad": [scale * ANGLE_TOLERANCE * 1e3 for scale in SCALES],
            "frames_moved_mm": self.moved * 1e3,
        }

    def brief(self) -> str:
        """Return one sentence that gives the interval."""
        if np.isnan(self.low):
            return "the error in the robot's own base frame is unknown, for only directions were measured"
        return (
            f"base and tool were fitted: in the robot's own base frame the mean error is "
            f"{self.low * 1e3:#.3g} to {self.high * 1e3:#.3g} mm"
        )

    def sentences(self) -> str:
        """Return text that gives the interval and its assumptions."""
        unseen = "base and tool were fitted, so the instrument cannot tell where the robot's base stands"
        if np.isnan(self.low):
            return f"{unseen}, nor where its tool is, for it sees directions and no positions"
        text = (
            f"{unseen}; in the robot's own base frame the mean error is {self.low * 1e3:#.3g} to "
            f"{self.high * 1e3:#.3g} mm (95 % interval, if base and tool lie {SCALES[0]:g} to {SCALES[1]:g} mm and "
            "mrad, one standard deviation per axis, from where the controller has them)"
        )
        if self.tracked and self.moved < NEAR:
            text += (
                f"; the fitted frames move the tool by {self.moved * 1e3:#.3g} mm: if the instrument is registered to "
                "the base and sees the controller's own tool, calibrate with `frames='known'`"
            )
        return text


def base_frame_error(
    nominal: Geometry, fitted: Geometry, joints: ArrayLike, left: Array, tracked: bool = True
) -> BaseFrameError:
    """Compute the interval of the mean position error in the robot's own base frame.

    The interval is needed if base and tool were fitted: the data then do not show where the robot's own base stands.
    Random bases and tools are drawn with a fixed seed, so equal inputs give equal intervals.

    Args:
        nominal: The nominal geometry with the controller's own base and tool.
        fitted: The nominal geometry with the fitted base and tool.
        joints: Joints of the judged poses ``(N, n)``, rad or m.
        left: Errors of the calibrated arm at these poses in the instrument's frame ``(N, 3 or more)``; the first three
            columns are position errors, m.
        tracked: Whether the instrument measures positions in its own frame.
    """
    joints = np.asarray(joints, dtype=float)
    model = frames_model(nominal)
    jacobian = parameter_jacobian(nominal, joints)[:, :3][..., model.columns]
    rng = np.random.default_rng(0)
    sizes = np.exp(rng.uniform(np.log(SCALES[0]), np.log(SCALES[1]), (DRAWS, 1)))
    draws = sizes * rng.normal(size=(DRAWS, len(model.columns))) * model.tolerance
    missed = np.einsum("nip,dp->dni", jacobian, draws) + left[:, :3]
    low, high = np.percentile(np.linalg.norm(missed, axis=2).mean(axis=1), [2.5, 97.5])
    shift = np.linalg.norm(forward(nominal, joints).position - forward(fitted, joints).position, axis=1).mean()
    return BaseFrameError(float(low), float(high), float(shift), tracked)


CONTRADICTED = 5.0
"""Distance of a fitted number from its stated value, in standard deviations, above which the rows contradict it."""

MATTERS = 0.03
"""Share by which the residuals must shrink, once the stated number is fitted, for a contradiction to matter."""

LENS_MATTERS = 0.2
"""Share by which a fitted lens must shrink the residuals, px, to matter. Its nine numbers always absorb some."""


def with_zeros_fitted(data: Observations) -> Iterator[tuple[str, DistanceObservations, Observations]]:
    """Find each wire whose zero (offset of its length) is stated as known, and make that zero an unknown.

    Args:
        data: The measured rows.

    Yields:
        For each such wire: the name of its zero as an unknown, the wire's rows, and a copy of ``data`` in which this
        one zero is unknown.
    """
    if isinstance(data, DistanceObservations):
        known = data.zero_std == data.scale_std == 0.0 and data.surface != "plane"
        if known and np.ptp(data.length) > 0.0:
            yield "zero", data, replace(data, zero_std=np.inf)
    for i, station in enumerate(data.stations):
        for name, part, free in with_zeros_fitted(station.data):
            stations = (*data.stations[:i], replace(station, data=free), *data.stations[i + 1 :])
            yield name + station.suffix, part, measurements.Stacked(stations)


def said_of_instruments(model: ErrorModel, found: Identification, data: Observations) -> Said:
    """Yield findings on the instruments, each a weight and a sentence.

    Findings concern stated numbers that the rows contradict, and lengths that were not measured.

    Args:
        model: The geometric parameters that were identified.
        found: The identification of the geometry.
        data: The rows that were fitted.
    """
    for name, wire, free in with_zeros_fitted(data):
        freed = identify(model, found.arm_model, [free])
        names = freed.identifiability.kept_names
        if name not in names:
            continue
        value, std = freed.unknowns[name], float(np.sqrt(freed.covariance[names.index(name), names.index(name)]))
        less = 1.0 - np.sqrt(freed.chi_square / max(found.chi_square, 1e-300))
        if abs(value - wire.zero) > CONTRADICTED * std and less > MATTERS:
            yield (
                "fail",
                f"{wire.source}: the wire's zero is taken as {wire.zero * 1e3:.4g} mm, but the rows say "
                f"{value * 1e3:.4g} ± {std * 1e3:.2g} mm, and the links have taken up the difference; say zero = "
                '"fitted" in [wire]',
            )
    if data.views is not None and not data.views.lens_std.any():
        free = replace(data.views, lens_std=np.full(len(LENS_NAMES), np.inf))
        freed = identify(model, found.arm_model, [free])
        stated, fitted = (
            np.sqrt(np.mean(views.pixel_errors(fit.arm_model, np.array(list(fit.unknowns.values()))) ** 2))
            for views, fit in ((data.views, found), (free, freed))
        )
        if freed.converged and fitted < (1.0 - LENS_MATTERS) * stated:
            yield (
                "caution",
                f"the lens as given leaves {stated:.3g} px per coordinate, a fitted one {fitted:.3g} px: give "
                'lens = "free" in [camera], or calibrate the camera anew',
            )
    if data.miss_unit == "deg":
        yield (
            "caution",
            "directions tell no length: all lengths of the arm are nominal; add an instrument that sees some",
        )
    elif not data.sized:
        yield (
            "caution",
            "no known length takes part, so the arm's size is that of its nominal longest link; add a known spacing, "
            "radius or length, or another instrument",
        )


def set_ups_of(found: Identification, data: Observations) -> list[dict[str, Any]]:
    """Describe the set-ups of the data; a set-up is one placement of the instrument and its target.

    Args:
        found: The identification.
        data: The rows that were fitted.

    Returns:
        For each set-up: its number from 1, its files, its count of rows, and which of its frames ("base", "tool")
        differ from the first set-up's. Such a frame comes with its distance from the first set-up's frame, in mm and
        deg. The list is empty if there is only one file.
    """
    rows: list[dict[str, Any]] = []
    for station in data.stations or (measurements.InstrumentStation(data),):
        unknowns = np.array([found.unknowns[name] for name in station.unknowns()])
        frame, origins = station.seen(found.arm_model, unknowns)[0].geometry, origins_of(station.data)
        shifts = {name: apart(getattr(found.geometry, name), getattr(frame, name)) for name in station.frames}
        files = [origins.files[i] for i in np.unique(origins.file).tolist()]
        own = {name: {"mm": m * 1e3, "deg": float(np.degrees(angle))} for name, (m, angle) in shifts.items()}
        rows.append({"number": station.number, "files": files, "rows": len(station.data.joints), "own": own})
    return rows if sum(len(row["files"]) for row in rows) > 1 else []


def set_up_block(set_ups: Sequence[Mapping[str, Any]], asked: str | None) -> Block:
    """Return the set-ups as a table.

    Args:
        set_ups: The set-ups as `set_ups_of` gives them.
        asked: Which frames differ from file to file, as the caller stated, such as "base,tool". None if this was
            decided from the rows.
    """
    rows = []
    for set_up in set_ups:
        shifts = [set_up["own"].get(name) for name in measurements.OWN]
        cells = [f"{figure(shift['mm'])} mm, {figure(shift['deg'])} deg" if shift else "" for shift in shifts]
        rows.append((str(set_up["number"]), ", ".join(set_up["files"]), str(set_up["rows"]), *cells))
    note = "as the rows tell" if asked is None else f"as asked by `stations='{asked}'`"
    heads = ("set-up", "files", "rows fitted", "its own base, away by", "its own tool, away by")
    return Block("Set-ups", heads, tuple(rows), note, "set_ups")


def said_of_conditions(model: ArmModel, learnt: bool, data: Observations) -> Said:
    """Yield a note if payloads, temperatures or torques were recorded that do not change the model's predictions.

    Args:
        model: The calibrated arm.
        learnt: Whether a learnt residual has payload and temperature as inputs.
        data: The rows that the arm was fitted to.
    """

    def position(**changed: Any) -> Array:
        return model.pose(data.joints, replace(data.conditions, **changed)).position

    conditions = {name: values for name, values in vars(data.conditions).items() if name != "between"}
    recorded = {name: values for name, values in conditions.items() if values is not None and len(values)}
    unused = [
        name
        for name, values in recorded.items()
        if not (learnt and name != "torque") and np.array_equal(position(**{name: values + 1.0}), position())
    ]
    if unused:
        yield "note", f"nothing that was fitted depends on what was recorded of {' and '.join(unused)} (see `terms`)"


# What stands against what was said before measuring: another arm, frames that are not known, a region of its own.
# Priors make such a fit say so: it is near the rows, and many standard deviations from what the drawing and the
# statement allow. SI units; mm and degrees in sentences.


PART_OFF = 8.0
"""Deviation of a link parameter, in standard deviations of the tolerance class, above which arm or class is wrong.
Eight measured series of six arms stay below 6.1. Rows of a UR5e that were declared as rows of a UR5 reach 20."""

FRAME_OFF = 1e-5
"""Significance level of the test of a base or tool that is stated as known. The p-value is the probability that parts
of the tolerance class displace the frame as far as the fit did, or farther."""

ZEROS_OFF = 10.0
"""Factor on the standard deviations of joint zeros in the test of a known frame, since zeros are set in the field."""

SURE_BY = 2.0
"""Number of standard deviations that are subtracted from a link parameter's change before it is judged."""

ONE_STEP = 0.5
"""Largest share of squared residuals that a joint's step may explain; eight measured series stay below 0.16."""

STEPS = np.linspace(0.1, 0.9, 17)
"""Quantiles of a joint's values at which a step of the errors is tried."""

POSES = 200
"""Number of random joint vectors at which parameter changes are projected onto a motion of the base or the tool."""


def said_against(found: Identification, data: Observations) -> Said:
    """Yield cautions on statements made before measuring (nominal geometry, frames) that the rows contradict.

    Args:
        found: The identification of the geometry.
        data: The rows that were fitted.
    """
    prior = found.prior
    if prior is None or not prior.proper:
        return
    frames = [text for which in ("base", "tool") if FRAMES not in prior.group for text in _frame(found, prior, which)]
    for text in (*(frames or _link(found, prior)), *_region(found, data)):
        yield "caution", text


def _link(found: Identification, prior: PriorModel) -> Iterator[str]:
    """Yield a caution if a link parameter lies more than `PART_OFF` tolerance widths from its nominal value."""
    names, change = prior.parameters.names, prior.start.difference(found.arm_model)[prior.parameters.columns]
    std = dict(zip(found.identifiability.names, np.nan_to_num(found.standard_deviation), strict=True))
    least = np.abs(change) - SURE_BY * np.array([std[name] for name in names])
    links = np.array([not name.startswith(("base_", "tool_")) for name in names])
    sizes = np.where(links & np.isin(prior.group, (LENGTHS, ANGLES)), least / prior.std, 0.0)
    worst = int(np.argmax(sizes))
    if sizes[worst] > PART_OFF:
        name = names[worst]
        size = f"{np.degrees(change[worst]):.3g} deg" if is_angle(name) else f"{change[worst] * 1e3:.3g} mm"
        yield (
            f"{name} lies {size} from its drawing, {sizes[worst]:.0f} times what parts of {prior.source} differ by: "
            "these rows may be of another arm than the one named; check the arm, or name its class with `tolerances`"
        )


def _frame(found: Identification, prior: PriorModel, which: str) -> Iterator[str]:
    """Yield a caution if the fit moved the arm's base or tool (``which``) more than the arm's tolerances allow."""
    geometry, links = found.geometry, prior.group != TERMS
    columns = prior.parameters.columns[links]
    joints = measurements.random_joints(geometry, POSES, np.random.default_rng(0))
    jacobian = ArmModel.of(geometry).jacobian(joints).reshape(6 * POSES, -1)
    projection = np.linalg.pinv(jacobian[:, measurements.frame_columns(geometry, which)]) @ jacobian[:, columns]
    shift = projection @ prior.start.difference(found.arm_model)[columns]
    std = np.where(prior.group == ZEROS, ZEROS_OFF, 1.0)[links] * prior.std[links]
    covariance = (projection * std**2) @ projection.T
    if stats.chi2.sf(shift @ np.linalg.solve(covariance, shift), len(shift)) < FRAME_OFF:
        yield (
            f"the {which} is said to be known, but by these rows it is off by {np.linalg.norm(shift[:3]) * 1e3:.3g} mm "
            f"and {np.degrees(np.linalg.norm(shift[3:])):.2g} deg, more than arms of {prior.source} can be; give "
            "`frames='fitted'`, or correct it in the arm's file"
        )


def _region(found: Identification, data: Observations) -> Iterator[str]:
    """Yield a caution if a step of the errors at some value of one joint explains most of the squared residuals."""
    if len(data.joints) < len(STEPS) or data.poses is None:
        return
    misses = data.misses(found.arm_model, unknowns_of(found, data))
    steps = [(*_step(data.joints[:, joint], misses), joint) for joint in range(data.joints.shape[1])]
    share, at, size, joint = max(steps)
    if share > ONE_STEP:
        unit, scale = measurements.screen_unit(data.poses.prismatic[joint])
        yield (
            f"where {found.geometry.joint_names[joint]} is above {at * scale:.3g} {unit} the arm behaves otherwise: "
            f"rows there lie {size * 1e3:.3g} mm from those below, beyond what any geometry explains; look for what "
            "sags, touches or slips there, or leave these rows out"
        )


def _step(values: Array, misses: Array) -> tuple[float, float, float]:
    """Find the joint value at which the mean error changes most.

    The errors below such a value have one mean, and the errors above have another.

    Args:
        values: Values of one joint ``(N,)``, rad or m.
        misses: Errors ``(N, 3)``, measured minus predicted positions, m.

    Returns:
        Three values. The first is the share of the summed squared errors that the two means explain. The second is the
        joint value, rad or m. The third is the distance between the two means, m.
    """
    best = (0.0, 0.0, 0.0)
    for at in np.quantile(values, STEPS).tolist():
        above = values > at
        high, low = (misses[side].mean(axis=0) if side.any() else np.zeros(3) for side in (above, ~above))
        explained = above.sum() * high @ high + (~above).sum() * low @ low
        share = float(explained / max(np.sum(misses**2), 1e-300))
        best = max(best, (share, at, float(np.linalg.norm(high - low))))
    return best
