"""Fit an arm to data of any kind: base and tool, then geometry and terms, then a residual model.

This is the middle part of `calibrate`, for callers who need neither a check of the rows nor a verdict.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from pickenv.arm import Arm, Array, Geometry
from pickenv.base import LEAST, InputError, mean_interval, versions
from pickenv.calibration.assessment.screen import LEAST_ROWS, Block, error_statistics, figure
from pickenv.calibration.identification import robust
from pickenv.calibration.identification.least_squares import Identification, identify, unknowns_of
from pickenv.calibration.identification.solve import covariance_at, solve
from pickenv.calibration.model.arm_model import ArmModel, Term, frames_model
from pickenv.calibration.model.measurements import Measurements
from pickenv.calibration.model.noise_and_priors import PriorModel, prior_model
from pickenv.calibration.model.observations import MISS_UNITS, Observations, Rows, origins_of
from pickenv.calibration.model.pixels import LENS_NAMES, Lens, PixelObservations
from pickenv.calibration.model.terms import kind_of_term
from pickenv.calibration.pipeline.calibration import Calibration, PoseUncertainty, variance_by_station
from pickenv.calibration.residuals.bpnn import BpnnSettings, train_bpnn
from pickenv.calibration.residuals.residual_models import PERIODIC_SPAN, fit_residual, position_rms


@dataclass(frozen=True, eq=False)
class Fit:
    """A calibration with the least-squares solutions that it comes from.

    Attributes:
        calibration: The calibration.
        identification: The least-squares solution for geometry and terms.
        aligned: The least-squares solution for base and tool alone; None if base and tool were known.
    """

    calibration: Calibration
    identification: Identification
    aligned: Identification | None


def fit(
    arm: Arm,
    data: Observations,
    residual_measurements: Measurements | None = None,
    *,
    known_frames: bool = False,
    terms: tuple[Term, ...] = (),
    residual: str = "bpnn",
    rng: np.random.Generator | None = None,
    settings: BpnnSettings | None = None,
) -> Fit:
    """Fit an arm as Qiao 2026 does: least squares without priors, then a residual model of the remaining errors.

    Args:
        arm: The arm.
        data: Rows for the identification, of any kind; the paper takes 100.
        residual_measurements: Poses from which the residual model learns, or None for no residual model; the paper
            takes 200.
        known_frames: True if the instrument measures the arm's own tool in the arm's own base frame, because it is
            registered or simulated. Then the paper's 24 parameters are identified. Else base, tool and Hayati's beta
            are fitted too, and the arm's errors in its own base frame stay unknown.
        terms: Parametric effects that are not geometric, to be identified with the geometry.
        residual: Name of the residual model: "bpnn", "rbf" or "gp".
        rng: Random generator of the residual model; needed with ``residual_measurements``.
        settings: Settings of the network "bpnn"; if None, the paper's.

    Raises:
        InputError: If there are too few rows, the data do not fit the arm, or the identification does not converge.
        ValueError: If ``rng`` is missing although ``residual_measurements`` are given.
    """
    aligned = fit_frames(arm, data, known_frames)
    start = arm.nominal if aligned is None else aligned.geometry
    model = prior_model(arm.name, start, known=known_frames, fit="full").with_terms(terms)
    model = replace(model, std=np.full(len(model.std), np.inf))  # coefficients of terms among them
    bare = fit_geometry(arm, data, aligned, model)
    if residual_measurements is None:
        return bare
    if rng is None:
        raise ValueError("give rng, which seeds the residual model")
    settings = (settings or BpnnSettings()) if residual == "bpnn" else None
    return fit_remainder(bare, residual, residual_measurements, rng, settings)


def fit_frames(arm: Arm, data: Observations, known: bool) -> Identification | None:
    """Fit base, tool and the data's own unknowns without a first guess.

    Args:
        arm: The arm.
        data: The rows.
        known: Whether base and tool are known. Poses and positions are then only checked against the arm.

    Returns:
        The least-squares solution; None for poses or positions with known base and tool.

    Raises:
        InputError: If the data do not fit the arm.
    """
    nominal = arm.nominal
    if data.poses is not None:
        if not known:
            return robust.align(nominal, data.poses, frames_model(nominal))
        try:
            robust.refuse_another_arm(nominal, data.poses, "with base and tool taken as known")
        except InputError as fault:
            _refuse_unregistered(nominal, data.poses, fault)
            raise
        return None
    solution = identify(frames_model(nominal), robust.rough_start(nominal, data), [data], max_iterations=100)
    _refuse_misfit(solution, data)
    return solution


def _refuse_unregistered(nominal: Geometry, poses: Measurements, fault: InputError) -> None:
    """Raise an error if rows do not fit the arm with known base and tool, but fit it with fitted base and tool.

    Args:
        nominal: The arm's nominal geometry, with the known base and tool.
        poses: The rows.
        fault: The error that says that the rows do not fit; it becomes the cause of the raised error.
    """
    before = sum(robust.misfit(nominal, poses))
    try:
        after = sum(robust.misfit(robust.align(nominal, poses, frames_model(nominal)).geometry, poses))
    except InputError:
        return  # too few rows, or another arm in any frames
    if after < min(robust.SUSPECT, before / robust.BETTER):
        raise InputError(
            f"{poses.source}: with base and tool taken as known the arm fits {before / max(after, 1e-3):.0f} times "
            "worse than with fitted ones; give `frames='fitted'`, or correct base and tool in the arm's file"
        ) from fault


def fit_geometry(arm: Arm, data: Observations, aligned: Identification | None, model: PriorModel) -> Fit:
    """Fit geometry and terms, starting from the base and tool that `fit_frames` found.

    Args:
        arm: The arm.
        data: The rows.
        aligned: The result of `fit_frames`; None if base and tool are known.
        model: The parameters to fit, with their priors (`pickenv.calibration.model.noise_and_priors.prior_model`).

    Raises:
        InputError: If there are too few rows for parameters without priors, or the fit does not converge.
    """
    solution = solve(model, data)
    if not solution.converged:
        raise InputError(f"{data.source}: the identification did not converge; measure more varied poses")
    record = {
        "source": data.source,
        "poses": len(data.joints),
        "data_fingerprint": data.fingerprint(),
        "kind": data.kind,
        "joint_ranges": [data.joints.min(axis=0).tolist(), data.joints.max(axis=0).tolist()],
        "frames": "known" if aligned is None else "fitted",
        "rank": solution.identifiability.rank,
        "dropped": solution.identifiability.dropped,
        "prior": model.source,
        "terms": sorted(kind_of_term(term) for term in model.start.terms),
        "residual": None,
        "versions": versions("scipy"),
    }
    if solution.unknowns:
        record["unknowns"] = solution.unknowns
    calibration = Calibration(arm.name, arm.nominal, model.start.geometry, solution.arm_model, None, record)
    return Fit(calibration, solution, aligned)


def fit_remainder(
    found: Fit,
    kind: str,
    data: Measurements,
    rng: np.random.Generator,
    settings: BpnnSettings | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Fit:
    """Add a learnt residual model to a fit: it predicts the errors that the fit leaves (Qiao 2026 eq (17)).

    The model's inputs are the joints and the recorded conditions.

    Args:
        found: The fit.
        kind: Name of the residual model: "bpnn", "rbf" or "gp".
        data: Poses or positions from which the model learns.
        rng: Random generator of the model.
        settings: If given, the paper's network with these settings is trained, with the joints themselves as inputs.
            Else the inputs are sine and cosine of joints that turn far, and very many rows are thinned.
        progress: Function that is called with the number of epochs done and the total number.

    Returns:
        The fit whose calibration has the learnt residual.
    """
    record = {
        "kind": kind,
        "data_fingerprint": data.fingerprint(),
        "poses": len(data),
        "conditions": list(data.conditions.input_names()),
        "settings": None if settings is None else asdict(settings),
        # The generator's state as it stands, in plain numbers: what reproduces the network to the bit.
        "generator": json.loads(json.dumps(rng.bit_generator.state, default=lambda value: value.tolist())),
    }
    paper = None if settings is None else partial(train_bpnn, settings=settings, progress=progress)
    model = fit_residual(
        kind,
        data.joints,
        data.difference(found.calibration.model),
        data.prismatic,
        rng,
        conditions=data.conditions.inputs(),
        fitter=paper,
        periodic_span=PERIODIC_SPAN if paper is None else np.inf,
    )
    full_record = {**found.calibration.record, "residual": record, "versions": versions("scipy", "torch")}
    return replace(found, calibration=replace(found.calibration, learnt=model, record=full_record))


def _refuse_misfit(found: Identification, data: Observations) -> None:
    """Refuse rows of wires, sockets and other kinds if errors after the fit are a large share of the tool's motion."""
    misses = data.misses(found.arm_model, unknowns_of(found, data))
    rms = float(np.sqrt(np.mean(np.sum(misses**2, axis=1))))
    span = data.span(ArmModel.of(found.geometry).pose(data.joints, data.conditions).position)
    if rms > robust.MISFIT * max(span, robust.SPAN):
        missed = f"{rms * MISS_UNITS[data.miss_unit]:.0f} {data.miss_unit}"
        raise InputError(
            f"{data.source}: after fitting the frames the arm still misses by {missed} RMS; check the arm, the units, "
            "the joint order and signs, and which row belongs to what"
        )


# Errors on rows that no fit saw: of rows held out once, or of all blocks of a file, each judged without itself. Rows
# of a block are alike, and so are their errors. What a calibration leaves on one block says little of the next, so an
# interval over rows of few blocks is far too narrow; between ten blocks it holds. SI units.


NOMINAL = "nominal"
GEOMETRIC = "geometric"
AS_CHOSEN = "as chosen without each block"


@dataclass(frozen=True, eq=False)
class HeldOut:
    """Errors of rows that were held out of the fit, as arrays ``(M, 6)``, ``(M, 3)`` or ``(M, 1)``, m and rad.

    Attributes:
        errors: Errors by the name of the model: "nominal", "geometric", then models with terms or a learnt residual.
            The last model is the one that the calibration uses.
        parametric: Errors of the last model without its learnt residual.
        used: Name of the model that judged the rows; if rows were held out block by block, one name per block.
        blocks: Index, from 0, of each error's block of rows ``(M,)``; None if rows were held out once.
        pixels: For pictures, the errors of the fit of geometry alone, px, one array ``(R, 2)`` per view; else empty.
        row: Index, from 0, of each error's row ``(M,)``. A row can have several errors, such as one error per reflector
            or per corner of a board. None if rows have one error each, or were held out block by block.
    """

    errors: dict[str, Array]
    parametric: Array
    used: tuple[str, ...]
    blocks: Rows | None = None
    pixels: tuple[Array, ...] = ()
    row: Rows | None = None

    @property
    def together(self) -> Rows | None:
        """Index, from 0, of each error's block or row ``(M,)``; errors of one block or row count as correlated.

        None if rows were held out once and each row has one error. Fewer than `LEAST_ROWS` rows with several errors
        each count as one group, for which there is no interval.
        """
        if self.blocks is not None or self.row is None or self._values >= LEAST_ROWS:
            return self.row if self.blocks is None else self.blocks
        return np.zeros_like(self.row)

    def text(self, rows: int, fitted: int) -> str:
        """Return a sentence that says how the rows were held out.

        Args:
            rows: Number of rows judged.
            fitted: Number of rows that the calibration was fitted to.
        """
        reason = f" ({self.no_interval})" if self.no_interval else ""
        if self.blocks is None:
            return f"{rows} {self.rows} held out, {fitted} fitted; interval over rows{reason}"
        counts = Counter(self.used).most_common()
        models = ", ".join(name if len(counts) == 1 else f"{name} ({count})" for name, count in counts)
        return (
            f"{rows} {self.rows}, each judged without its block: mean over {self._values} contiguous blocks, "
            f"between-block interval{reason}; fitted without each block, and chosen on others: {models}; the "
            f"calibration is fitted to all {fitted}"
        )

    @property
    def rows(self) -> str:
        """Word for the rows in sentences: "views" for pictures, else "rows"."""
        return "views" if self.pixels else "rows"

    @property
    def no_interval(self) -> str:
        """The reason why the mean error has no 95 % interval; empty if it has one."""
        least, units = (LEAST_ROWS, "rows") if self.blocks is None else (LEAST, "blocks")
        return "" if self._values >= least else f"no interval: {self._values} {units} are fewer than {least}"

    @property
    def _values(self) -> int:
        """Number of independent values that an interval rests on: rows, or blocks of them."""
        numbers = self.row if self.blocks is None else self.blocks
        return len(self.parametric) if numbers is None else len(np.unique(numbers))


def held_out_of(fits: Mapping[str, Fit], test: Observations) -> HeldOut:
    """Compute the errors of the nominal arm and of each fit of a calibration on rows that were held out once.

    Args:
        fits: The fits by name, in order. The first fits the geometry alone; each further one adds one part (terms or a
            residual model).
        test: The held-out rows.
    """
    bare, (used, best) = next(iter(fits.values())), list(fits.items())[-1]
    if test.poses is not None:
        before = test.poses.difference(ArmModel.of(bare.calibration.nominal))
    else:
        assert bare.aligned is not None
        before = missed_by(bare.aligned, test)
    solution, views = bare.identification, test.views
    single = () if views is None else (views.select(np.array([i])) for i in range(len(test.joints)))
    pixels = tuple(view.pixel_errors(solution.arm_model, unknowns_of(solution, view)) for view in single)
    steps = zip((GEOMETRIC, *list(fits)[1:]), fits.values(), strict=True)
    errors = {NOMINAL: before} | {name: what_is_left(fit, test) for name, fit in steps}
    rows = test.rows_of_misses
    row = rows if len(np.unique(rows)) < len(rows) else None
    return HeldOut(errors, missed_by(best.identification, test), (used,), pixels=pixels, row=row)


def by_station(held_out: HeldOut, train: Observations, folds: Sequence[tuple[Rows, Rows]]) -> HeldOut:
    """Return held-out errors sorted by the station (placement of the instrument and its target) of their rows.

    Args:
        held_out: The errors, ordered by the block of rows that was held out.
        train: The rows of all stations.
        folds: For each block, the indices, from 0, of the fitted rows and of the held-out rows.
    """
    rows = np.concatenate([rows_out[train.select(rows_out).rows_of_misses] for _, rows_out in folds])
    places = np.repeat(np.arange(len(train.parts)), [len(part.joints) for part in train.parts])
    order = np.argsort(places[rows], kind="stable")
    errors = {name: values[order] for name, values in held_out.errors.items()}
    blocks = None if held_out.blocks is None else held_out.blocks[order]
    return replace(held_out, errors=errors, parametric=held_out.parametric[order], blocks=blocks)


def pooled(names: Sequence[str], parts: Sequence[HeldOut]) -> HeldOut:
    """Concatenate the held-out errors of all blocks.

    Each block of rows was judged by a model that was chosen without it. These models can differ in their terms and
    residual model, from block to block and from the model of the calibration. Under the last of the ``names``, the
    result holds each block's errors by the model that was chosen without the block. Under each name between
    "geometric" and the last, it holds the errors of these models without their learnt residuals.

    Args:
        names: Names of the models of the calibration of all rows: the geometry alone, then each with one part more.
        parts: The held-out errors of each block.
    """
    added = list(names[1:]) or [AS_CHOSEN] * any(len(part.errors) > 2 for part in parts)
    errors = {name: np.concatenate([part.errors[name] for part in parts]) for name in (NOMINAL, GEOMETRIC)}
    parametric = np.concatenate([part.parametric for part in parts])
    errors |= dict.fromkeys(added[:-1], parametric)
    if added:
        errors[added[-1]] = np.concatenate([list(part.errors.values())[-1] for part in parts])
    blocks = np.repeat(np.arange(len(parts)), [len(part.parametric) for part in parts])
    used = tuple(name for part in parts for name in part.used)
    return HeldOut(errors, parametric, used, blocks, pixels=tuple(view for part in parts for view in part.pixels))


def pose_uncertainties(
    fit: Fit, held_out: HeldOut, train: Observations, test: Observations
) -> tuple[PoseUncertainty, PoseUncertainty | None]:
    """Compute the uncertainty of predicted poses, and their uncertainty without the learnt residual.

    The second one is None if no residual was learnt. The covariance of a fit counts all remaining errors as
    noise. A learnt residual removes a part of these errors, and with it a part of the parameters' error. With a
    residual, the covariance is therefore computed for rows that scatter no more than held-out errors do
    (`covariance_at`). The mean square of these errors depends on a few large ones, so its standard error is added.

    Args:
        fit: The fit whose calibration is used.
        held_out: Its errors on held-out rows.
        train: The rows that it was fitted to.
        test: The held-out rows.
    """
    solution, after, rows = fit.identification, list(held_out.errors.values())[-1], test.rows_of_misses
    of = partial(
        PoseUncertainty.of,
        joints=test.joints[rows],
        blocks=held_out.blocks,
        conditions=test.conditions.select(rows),
        unit=train.miss_unit,
        variance=None if fit.calibration.arm.tree is None else variance_by_station(solution, test)[rows],
    )
    if fit.calibration.learnt is None:
        return of(solution, after), None
    beside, share = solution, (position_rms(after) / position_rms(held_out.parametric)) ** 2
    if np.isfinite(solution.covariance).all():
        beside = replace(solution, covariance=covariance_at(solution, train, float(np.clip(share, 1e-9, 1.0))))
    growth = _growth(after[:, :3], held_out.blocks), _growth(after[:, 3:], held_out.blocks)
    return replace(of(beside, after), growth=growth), of(solution, held_out.parametric)


def _growth(errors: Array, blocks: Rows | None) -> float:
    """Return a factor on the RMS of errors. It raises the mean square of the errors by one standard error.

    Args:
        errors: The errors ``(M, k)``.
        blocks: One integer per error ``(M,)``, equal for all errors of one block of rows. Errors of one block are
            correlated. None if all errors are independent.
    """
    if not errors.any():
        return 1.0
    squares = np.sum(errors**2, axis=1)
    if blocks is not None:
        squares = np.bincount(blocks, squares) / np.bincount(blocks)
    return float(np.sqrt(1.0 + squares.std() / (squares.mean() * np.sqrt(len(squares)))))


def what_is_left(fit: Fit, data: Observations) -> Array:
    """Compute a calibration's errors on data: ``(N, 6)``, ``(N, 3)`` or ``(N, 1)``, m and rad.

    Terms and learnt residual are included. Errors of several stations are in the first station's axes.
    """
    tracked = tracked_rows(fit.identification, data)
    return missed_by(fit.identification, data) if tracked is None else fit.calibration.errors(tracked)


def missed_by(found: Identification, data: Observations) -> Array:
    """Compute an identified arm's errors on data, ``(N, 6)``, ``(N, 3)`` or ``(N, 1)``, m and rad.

    The prediction includes terms, but no learnt residual.
    """
    model, tracked = found.arm_model, tracked_rows(found, data)
    return data.misses(model, unknowns_of(found, data)) if tracked is None else tracked.difference(model)


def tracked_rows(found: Identification, data: Observations) -> Measurements | None:
    """Return the data as poses or positions, all in the frames of the first station.

    A station is one placement of the instrument and its target. The result is None for other kinds of measurement.
    """
    rows: Measurements | None = data.from_the_first(found.arm_model, unknowns_of(found, data))
    return rows


# How well pictures are explained, in pixels: of all views together, and of each view by a fit without it.


def pixel_figures(fit: Fit, data: PixelObservations, held_out: HeldOut) -> dict[str, Any]:
    """Return reprojection errors as values for JSON: of the fit to all views, and of fits that left the view out.

    Args:
        fit: The fit of geometry alone to all views in ``data``.
        data: The views, that is pictures of a board.
        held_out: Errors of held-out views. Views were held out one by one, or in blocks if they are many.
    """
    solution = fit.identification
    by_view = [position_rms(view) for view in held_out.pixels]
    numbers = np.repeat(np.arange(len(by_view)), [len(errors) for errors in held_out.pixels])
    return {
        "views": len(data.joints),
        "corners": int(data.seen.sum()),
        "rms_px": position_rms(data.pixel_errors(solution.arm_model, unknowns_of(solution, data))),
        "leave_one_out_px": position_rms(np.concatenate(held_out.pixels)),
        "leave_one_out_view_rms_px": by_view,
        "leave_one_out_mean_ci95_px": mean_interval(by_view),
        "leave_one_out_mm": error_statistics(1e3 * held_out.errors[GEOMETRIC], numbers).as_dict(),
        "lens": dict(zip(LENS_NAMES, data.numbers.whole(unknowns_of(solution, data)).tolist(), strict=True)),
    }


def pixel_block(figures: Mapping[str, Any], names: Sequence[str]) -> Block:
    """Return the values of `pixel_figures` as a table; ``names`` are the held-out views' names, in the same order."""
    by_view, ends = figures["leave_one_out_view_rms_px"], figures["leave_one_out_mean_ci95_px"]
    worst = int(np.argmax(by_view))
    between = f"95 % between views {figure(ends[0])} to {figure(ends[1])}" if ends else "no interval: too few views"
    rows = [
        ("views, corners", f"{figures['views']}, {figures['corners']}"),
        ("RMS of the fit to all views", f"{figure(figures['rms_px'])} px"),
        ("RMS in each view, fitted without it", f"{figure(figures['leave_one_out_px'])} px ({between})"),
        ("the same at the board", f"{figure(figures['leave_one_out_mm']['rms'])} mm"),
        ("worst view", f"{names[worst]}: {figure(by_view[worst])} px"),
    ]
    return Block("Pictures", (), tuple(rows), "distance of the corners from where they are predicted", "pictures")


def view_names(views: PixelObservations) -> tuple[str, ...]:
    """Return each view's name: the file name of its picture, or else the file and row where its corners begin."""
    if views.pictures is not None:
        return tuple(Path(path).name for path in views.pictures)
    places = map(origins_of(views).place, range(len(views.joints)))
    return tuple(f"{Path(file).name}: row {line}" for file, line in places)


def lens_of(fit: Fit, data: Observations) -> Lens:
    """Return the camera's lens with the values that a fit to pictures identified.

    Args:
        fit: The fit.
        data: The pictures that it was fitted to.

    Raises:
        InputError: If the data are no pictures.
    """
    if data.views is None:
        raise InputError(f"{data.source} holds {data.kind}, no pictures, so there is no lens to write")
    lens: Lens = data.views.camera
    return replace(lens, values=data.views.numbers.whole(unknowns_of(fit.identification, data)))
