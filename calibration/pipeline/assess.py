"""A calibration judged on rows that it never saw: everything that a result says is worked out here."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from pickenv.arm import Arm
from pickenv.arm.kinematics.geometry import Array
from pickenv.calibration.assessment.base_frame import base_frame_error
from pickenv.calibration.assessment.contradictions import said_against
from pickenv.calibration.assessment.expected_errors import workspace_error
from pickenv.calibration.assessment.instrument import said_of_conditions, said_of_instruments
from pickenv.calibration.assessment.quality import grade_quality
from pickenv.calibration.identification.diagnosis import LeftOut, said_of_files, said_of_rows, said_of_stations
from pickenv.calibration.identification.rows import said_of_repeats
from pickenv.calibration.identification.starts import fitted_model
from pickenv.calibration.identification.term_choice import TermChoice
from pickenv.calibration.model.finished_poses import CARRIER
from pickenv.calibration.model.measurements import Measurements
from pickenv.calibration.model.observations import Observations
from pickenv.calibration.model.pixels import PixelObservations
from pickenv.calibration.model.stacked import Stacked
from pickenv.calibration.pipeline.fitting import Fit
from pickenv.calibration.pipeline.given import workspace_joints
from pickenv.calibration.pipeline.held_out import (
    GEOMETRIC,
    NOMINAL,
    HeldOut,
    held_out_of,
    tracked_rows,
    what_is_left,
    without_residual,
)
from pickenv.calibration.pipeline.pixel_figures import PixelFigures, pixel_figures
from pickenv.calibration.pipeline.result import Result
from pickenv.calibration.pipeline.uncertainty import pose_uncertainty
from pickenv.calibration.residuals.gate import GateReport


def _pixels(fit: Fit, train: Observations, test: Observations, held_out: HeldOut) -> PixelFigures | None:
    """Reprojection errors, where there are pictures."""
    if isinstance(train, PixelObservations) and isinstance(test, PixelObservations):
        return pixel_figures(fit, train, test, held_out)
    return None


def assess(
    arm: Arm,
    fit: Fit,
    train: Observations,
    test: Observations,
    *,
    fits: Mapping[str, Fit] | None = None,
    held_out: HeldOut | None = None,
    terms: TermChoice | None = None,
    gate: GateReport | None = None,
    left_out: tuple[LeftOut, ...] = (),
    workspace: tuple[str, Array] | None = None,
) -> Result:
    """Judge a calibration on rows that it never saw.

    Args:
        arm: The arm.
        fit: The calibration that will be used.
        train: Rows it was fitted to.
        test: Rows held out.
        fits: The calibration of the geometry alone and what was added to it, step by step, by name; the last is
            ``fit``. When left out ``fit`` without and with its learnt residual.
        held_out: Errors on the rows held out; what the fits leave there when left out.
        terms: How terms were chosen.
        gate: The residual models' verdicts.
        left_out: Rows left out.
        workspace: Where the arm will work: what that is called, and joints ``(M, n)`` all over it.
    """
    unlearnt = without_residual(fit)
    learnt = fit.calibration.learnt
    if fits is None:
        fits = {GEOMETRIC: unlearnt} if learnt is None else {GEOMETRIC: unlearnt, f"geometry+{learnt.kind}": fit}
    bare = next(iter(fits.values()))
    aligned = bare.aligned
    held_out = held_out or held_out_of(fits, train, test)
    after = list(held_out.errors.values())[-1]
    before = None if arm.name == CARRIER else held_out.errors[NOMINAL]
    if isinstance(test, Measurements) and isinstance(train, Measurements):
        said = "stated noise" if train.std_stated else "noise assumed, since none is stated,"
        noise = f"{said} of {train.position_std * 1e3:.4g} mm"
    else:
        stated = isinstance(train, Stacked) and all(getattr(part, "std_stated", False) for part in train.parts)
        noise = "stated noise" if stated else "noise stated or assumed"
    rows_of = test.rows_of_misses
    joints, conditions = test.joints[rows_of], test.conditions.select(rows_of)
    uncertainty = pose_uncertainty(fit.identification, after, joints, held_out.blocks, conditions, train.miss_unit)
    base_frame = None
    rows = len(train.joints) + (held_out.blocks is None) * len(test.joints)
    if aligned is not None:
        left, tracked = after, tracked_rows(fit.identification, test) is not None
        if not tracked:  # then the misses are not one per row: any may go with any pose
            drawn = np.random.default_rng(0).integers(0, len(after), len(test.joints))
            left = np.pad(after, ((0, 0), (0, 3 - min(after.shape[1], 3))))[drawn]
        if train.miss_unit != "mm":
            left = np.full_like(left, np.nan)
        base_frame = base_frame_error(arm.nominal, bare.calibration.nominal, test.joints, left, tracked)
    name, region = workspace or workspace_joints(None, arm.nominal)
    remains = float(np.sqrt(np.mean(np.sum(after[:, :3] ** 2, axis=1)))) if train.miss_unit == "mm" else 0.0
    over = workspace_error(fit.identification, bare.calibration.nominal, train.joints, region, name, remains)
    model = fitted_model(arm.name, bare.calibration.nominal, aligned is None)
    return Result(
        arm=arm,
        fit=fit,
        geometric=bare,
        train=train,
        test=test,
        held_out=held_out,
        quality=grade_quality(
            fit.identification,
            what_is_left(unlearnt, train),
            before,
            after,
            over,
            geometric=bare.identification,
            parametric=held_out.parametric,
            blocks=test.rows_of_misses if held_out.blocks is None else held_out.blocks,
            noise=noise,
            said=(
                *said_against(bare.identification, train),
                *said_of_repeats(train, test if held_out.blocks is None else test.select(np.arange(0))),
                *said_of_rows(left_out, rows + sum(not item.kept for item in left_out)),
                *said_of_files(left_out, (train, test)),
                *said_of_stations(bare.identification, train),
                *said_of_instruments(model, bare.identification, train),
                *said_of_conditions(fit.calibration.model, learnt is not None and learnt.inputs.conditions > 0, train),
            ),
            unit=train.miss_unit,
            rows=(len(test.joints), held_out.rows),
        ),
        uncertainty=uncertainty,
        base_frame=base_frame,
        terms=terms,
        gate=gate,
        left_out=left_out,
        pixels=_pixels(bare, train, test, held_out),
    )
