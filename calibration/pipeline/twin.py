"""Turn a calibrated arm into a plant, that is a simulated true arm; further arms are drawn from the posterior.

Geometry and terms have the posterior covariance of their parameters. Parameters that were dropped as redundant are
drawn from their tolerances. Errors that no term describes are modelled by a Gaussian process. If the calibration learnt
a Gaussian process, this process is used. Else a process is fitted to the errors that geometry and terms leave on the
rows, since networks have no posterior. Errors that are no smooth function of the joints are called scatter. The
instrument's share of the scatter is subtracted, and the rest is attributed to the arm. SI units.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from operator import itemgetter
from typing import Any

import numpy as np
from scipy.linalg import block_diag

from pickenv.arm import Arm, Array, Geometry, MeasurementNoise, Plant
from pickenv.arm.effects.residual_field import Features, ResidualField
from pickenv.arm.plant.plant import Layout, Posterior
from pickenv.arm.plant.populations import twin_plant
from pickenv.base import InputError
from pickenv.calibration.model.arm_model import ArmModel, Term
from pickenv.calibration.model.measurements import ATTITUDE_STD, POSITION_STD, Measurements
from pickenv.calibration.model.noise_and_priors import never_told
from pickenv.calibration.model.terms import BendingTerm, ComplianceTerm, GravityTerm, PeriodicTerm, ThermalTerm
from pickenv.calibration.pipeline.calibration import Calibration, uncertainty_from
from pickenv.calibration.residuals.gaussian_process import GaussianProcess, feature_process
from pickenv.calibration.residuals.residual_models import JointInputs, fit_residual

SMOOTH, ROUGH = 256, 8
"""Number of waves that represent one output of the Gaussian process, and number of waves that represent one coordinate
of the arm's own scatter. A wave is a cosine and a sine."""

ROUGH_LENGTH = 1e-2
"""Distance between joint vectors, rad or m, beyond which the arm's own scatter is independent."""

SCATTER, SCATTER_PARTS = "scatter", ("position_std", "attitude_std", "source")
"""Entry of a calibration's record with the instrument's share of the scatter (`Scatter`), and this entry's keys."""

Scatter = tuple[float, float, str]
"""The instrument's share of a measurement's scatter: the standard deviation of a position coordinate, m, the standard
deviation of an attitude coordinate, rad, and the source of both in words."""

ASSUMED: Scatter = (POSITION_STD, ATTITUDE_STD, "what is assumed of an instrument of which nothing is stated")


def scatter_of(data: Measurements, repeat: float | None = None) -> Scatter:
    """Estimate the instrument's share of the scatter of measured rows.

    It is the instrument's stated or assumed uncertainty. If repeated measurements at one command scatter less, it is
    their scatter. Repeats contain the arm's repeatability too, so their scatter is an upper bound.

    Args:
        data: The rows.
        repeat: RMS of the position's scatter between repeats, m, if the file states it.
    """
    said = f"the instrument's {'stated' if data.std_stated else 'assumed'} uncertainty"
    repeated = repeated_std(data) if repeat is None else repeat / np.sqrt(3.0)
    if repeated is not None and repeated < data.position_std:
        return repeated, data.attitude_std, "repeats, which scatter less than the instrument is said to"
    more = ": no repeats"
    if repeated is not None:
        more = f"; repeats scatter by {repeated * 1e3:.4f} mm, the arm's share among it"
    return data.position_std, data.attitude_std, said + more


def repeated_std(data: Measurements) -> float | None:
    """Compute the standard deviation, m, of a position coordinate in repeats at equal joints; None without repeats."""
    _, group = np.unique(np.round(data.joints, 9), axis=0, return_inverse=True)
    group = group.ravel()
    counts = np.bincount(group)
    spare = len(group) - len(counts)
    if spare == 0:
        return None
    means = np.stack([np.bincount(group, data.position[:, i]) / counts for i in range(3)], -1)
    return float(np.sqrt(np.sum((data.position - means[group]) ** 2) / (3 * spare)))


def twin(
    calibration: Calibration,
    arm: Arm,
    rows: Measurements | None = None,
    *,
    name: str | None = None,
    seed: int = 0,
    geometry_only: bool = False,
) -> Plant:
    """Make the plant, that is the simulated true arm, of a calibrated arm.

    The plant itself is the best estimate of the arm. `draw_plants` draws further arms from the posterior.

    Args:
        calibration: The calibration.
        arm: The arm that was calibrated.
        rows: Poses or positions that the calibration was fitted to. They are needed if its learnt residual is no
            Gaussian process.
        name: Name of the plant; the arm's name with "_twin" if None.
        seed: Seed of the waves that represent the Gaussian process, and of the process if one is fitted.
        geometry_only: Whether terms and learnt residual are left out.

    Raises:
        InputError: If the calibration is of another arm or holds no covariance, or if ``rows`` are needed and missing.
            Also if a term needs measured torques, or if a joint moves several links and ``geometry_only`` is False.
    """
    calibration.refuse_another(arm)
    if geometry_only:
        calibration = replace(calibration.without_residual(), model=ArmModel(calibration.identified))
    elif calibration.arm.coupling is not None:
        raise InputError(f"a joint of arm '{arm.name}' moves several links, which no effect of a plant knows yet")
    sure = uncertainty_from(calibration.record)
    if sure is None:
        raise InputError("the calibration does not say how surely its parameters are known; measure more rows")
    rng = np.random.default_rng(seed)
    layout, carry = _layout(calibration.model.terms, calibration.identified)
    names = calibration.model.parameter_names
    matrix = block_diag(np.eye(len(calibration.identified.parameter_names)), carry)
    places = [i for i, parameter in enumerate(sure.names) if parameter in names]
    factor = np.zeros((len(names), len(places)))
    values, vectors = np.linalg.eigh(sure.covariance[np.ix_(places, places)])  # which may be singular
    factor[[names.index(sure.names[i]) for i in places]] = vectors * np.sqrt(np.maximum(values, 0.0))
    never = never_told(sure.names, sure.covariance)  # parameters of base and tool, which no twin varies
    factor[[names.index(parameter) for parameter in never]] = 0.0
    unseen, traces = _unseen(calibration, names)
    scatter = ASSUMED if rows is None else scatter_of(rows)
    if SCATTER in calibration.record:
        scatter = itemgetter(*SCATTER_PARTS)(calibration.record[SCATTER])
    process, inputs, process_note = _process(calibration, rows, rng)
    if process is None:
        frequency, mean, spread = np.zeros((3, len(inputs.mean), 0)), np.zeros((3, 0)), np.zeros((3, 0, 0))
        offset, rest = np.zeros(3), np.full(3, sure.position_repeat)
    else:
        frequency, mean, spread = feature_process(process, SMOOTH, rng)
        offset, rest = process.output_mean, process.noise * process.output_std
    position_std, attitude_std, source = _no_more_than(rest, scatter)
    instrument = np.repeat([position_std, attitude_std], 3)[: len(rest)]
    rough = np.sqrt(np.maximum(rest**2 - instrument**2, 0.0))
    arms_own = np.sqrt(np.mean(rough[:3] ** 2)) * 1e3
    scatter_note = (
        f"of the scatter {position_std * 1e3:.4f} mm per coordinate are the instrument's, by {source}; "
        f"the arm's own is {arms_own:.4f} mm: it stays the same where a command is repeated to the bit, and no smooth "
        "function tells it"
    )
    posterior = Posterior(
        identified=calibration.identified,
        aligned=(calibration.nominal.base, calibration.nominal.tool),
        layout=layout,
        coefficients=carry @ calibration.model.coefficients,
        factor=matrix @ factor,
        unseen=unseen,
        traces=matrix @ traces,
        field=_field(frequency, mean, offset, inputs, arm.nominal.base.rotation @ calibration.nominal.base.rotation.T),
        field_factor=spread,
        rough=rough,
        notes=(process_note, scatter_note, *_missing(calibration, never)),
    )
    return twin_plant(name or f"{arm.name}_twin", arm, posterior, MeasurementNoise(position_std, attitude_std))


def _unseen(calibration: Calibration, names: Sequence[str]) -> tuple[Any, Array]:
    """Return the parameters that were left out of the fit, and the changes of others that cancel their effect on poses.

    Args:
        calibration: The calibration.
        names: Names of the model's p parameters.

    Returns:
        The indices, from 0, of the d left-out parameters among those of the geometry, and a matrix ``(p, d)``. In each
        column one left-out parameter changes by 1, and other parameters change so that all poses stay the same.
    """
    parameters = calibration.identified.parameter_names
    dropped: Mapping[str, Mapping[str, float]] = calibration.record.get("dropped", {})
    lost = [name for name in dropped if name in parameters]
    traces = np.zeros((len(names), len(lost)))
    for column, name in enumerate(lost):
        traces[names.index(name), column] = 1.0
        for absorber, share in dropped[name].items():
            if absorber in names:
                traces[names.index(absorber), column] -= share
    return np.array([parameters.index(name) for name in lost], dtype=np.int64), traces


def _layout(terms: Sequence[Term], geometry: Geometry) -> tuple[Layout, Array]:
    """Return the layout of a plant's k coefficients, and a matrix ``(k, t)``.

    The matrix maps the t coefficients of the terms to the plant's coefficients.
    """
    sizes = [len(term.names(geometry)) for term in terms]
    units = np.split(np.eye(sum(sizes)), np.cumsum(sizes, dtype=int))  # the last part is empty
    harmonics, moments, up = [], [], (0.0, 0.0, 1.0)
    waves, weights = units[-1], units[-1]
    for term, unit in zip(terms, units, strict=False):
        if isinstance(term, PeriodicTerm):
            harmonics += list(zip(term.joints, term.orders, strict=True))
            waves = np.vstack([waves, unit])
        elif isinstance(term, GravityTerm | ComplianceTerm):
            entries, by_term, up = _moments(term, geometry)
            moments += entries
            weights = np.vstack([weights, by_term @ unit])
    return Layout(harmonics=tuple(harmonics), moments=tuple(moments), up=up), np.vstack([waves, weights])


def _moments(
    term: GravityTerm | ComplianceTerm, geometry: Geometry
) -> tuple[list[tuple[int, int, str]], Array, tuple[float, float, float]]:
    """Return the moments by which a term bends the joints.

    Returns:
        The k moments, a matrix ``(k, t)``, and the direction up. A moment is a joint, a link (both from 0) and a
        letter, as in `GravityTerm.moments`. The matrix maps the term's t coefficients to the sizes of the moments. The
        direction up is a unit vector in the axes of frame 0.

    Raises:
        InputError: If the term needs measured torques.
    """
    if isinstance(term, GravityTerm):
        all_ = term.moments(geometry)
        indices = [i for i, (_, _, moment) in enumerate(all_) if moment != "p"]  # no payload is held
        return [all_[i] for i in indices], np.eye(len(all_))[indices], term.up
    if term.weight is None:
        raise InputError("the calibration's compliance needs measured torques, which a plant does not have")
    moments, by_weight, up = _moments(term.weight, geometry)
    joint_of = np.array([joint for joint, _, _ in moments])[:, None]
    return moments, by_weight @ np.array(term.moments)[:, None] * (joint_of == np.array(term.joints)), up


def _missing(calibration: Calibration, never: Sequence[str]) -> Iterator[str]:
    """Yield sentences on the parts of the calibration that the plant leaves out, and on the plant's base frame.

    ``never`` are the parameters of base and tool that the rows do not determine.
    """
    if any(isinstance(term, ThermalTerm) for term in calibration.model.terms):
        yield "the arm stays at its reference temperature: of its growth only the coefficient is known"
    if any(isinstance(term, BendingTerm) for term in calibration.model.terms):
        yield "its joints do not bend across their axes"
    if calibration.record.get("frames") == "fitted":
        yield "base and tool were fitted, so it errs in its own base as it did against the aligned nominal arm"
    if never:
        yield f"the rows say nothing of {', '.join(never)}: there all arms that are drawn are the same"


def _no_more_than(noise: Array, scatter: Scatter) -> Scatter:
    """Limit the instrument's share of the scatter to the whole scatter of the rows.

    If the positions show that the instrument is better than stated, its attitudes are limited by the rows too.

    Args:
        noise: Standard deviation of the rows' scatter in each coordinate ``(3,)`` or ``(6,)``, m and rad.
        scatter: The instrument's share as stated or assumed.
    """
    position, attitude = (float(np.sqrt(np.mean(part**2))) if len(part) else np.inf for part in (noise[:3], noise[3:]))
    position_std, attitude_std, source = scatter
    if position >= position_std:
        return scatter
    origin = f"the rows, which scatter less than {position_std * 1e3:.4f} mm, which is {source}"
    return position, min(attitude, attitude_std), origin


def _process(
    calibration: Calibration, rows: Measurements | None, rng: np.random.Generator
) -> tuple[GaussianProcess | None, JointInputs, str]:
    """Return the Gaussian process of the errors that geometry and terms leave, its inputs, and a note on its origin.

    Without rows and without a learnt residual, the process is None, and all these errors count as scatter.

    Args:
        calibration: The calibration.
        rows: Poses or positions that the calibration was fitted to, or None.
        rng: Random generator of a process that is fitted to the rows.

    Raises:
        InputError: If there are no rows, and the learnt residual is no Gaussian process.
    """
    learnt = calibration.learnt
    if learnt is not None and isinstance(learnt.model, GaussianProcess):
        return learnt.model, learnt.inputs, "the residual is the calibration's own Gaussian process"
    if rows is None and learnt is not None:
        raise InputError(
            f"the residual model '{learnt.kind}' of the calibration does not know how sure it is; give the rows that "
            "it was fitted to (`rows`), or calibrate with `residual='gp'`"
        )
    if rows is None:
        joints = calibration.identified.joints
        inputs = JointInputs(0, np.zeros(joints, dtype=bool), np.zeros(joints), np.ones(joints))
        return None, inputs, "no residual was learnt: what geometry and terms leave is taken as scatter"
    fitted = fit_residual("gp", rows.joints, rows.difference(calibration.model), rows.prismatic, rng)
    assert isinstance(fitted.model, GaussianProcess)
    note = "the residual is a Gaussian process on what geometry and terms leave of the rows"
    return fitted.model, fitted.inputs, note


def _field(frequency: Array, mean: Array, offset: Array, inputs: JointInputs, turn: Array) -> ResidualField:
    """Make the residual field: the process's mean over the joints, and waves of zero mean for the arm's own scatter.

    Args:
        frequency: Frequencies of the process's waves ``(O, F, K)``, by output, input and wave.
        mean: Mean weights of the waves' cosines, then sines ``(O, 2 K)``, m and rad.
        offset: Constant part of each output ``(O,)``, m and rad.
        inputs: How joints become the process's inputs.
        turn: Rotation matrix ``(3, 3)`` from the frame in which the residual was learnt into the arm's own base frame.
    """
    joints = len(inputs.periodic) + int(inputs.periodic.sum())  # conditions come after them, and stay at their mean
    scaled = frequency[:, :joints] / inputs.std[:joints, None]
    outputs = len(scaled)
    rough = np.random.default_rng(0).standard_normal((outputs, joints, ROUGH)) / ROUGH_LENGTH
    waves = np.concatenate([scaled, rough], axis=-1).transpose(1, 0, 2).reshape(joints, -1)
    weight = np.zeros((outputs, 2, scaled.shape[-1] + ROUGH))
    weight[..., : scaled.shape[-1]] = mean.reshape(outputs, 2, -1)
    middle, periodic = tuple(inputs.mean[:joints].tolist()), tuple(inputs.periodic.tolist())
    features = Features(np.ascontiguousarray(waves, dtype=np.float32), middle, periodic, outputs)
    return ResidualField(features, weight.astype(np.float32), tuple(offset.tolist()), tuple(map(tuple, turn.tolist())))
