"""Traces of a calibration and of a harvester's run: the data behind their figures and reports. Units: m, s."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pickenv.arm import Array, Geometry, forward
from pickenv.calibration import Bpnn, Fit, Measurements, Observations, Result
from pickenv.calibration.model.pixels import PixelObservations
from pickenv.calibration.pipeline.fitting import view_names
from pickenv.harvester import Harvest, Measure


@dataclass(frozen=True, eq=False)
class ViewErrors:
    """The corners of the board in one view (one picture), and their reprojection errors.

    Attributes:
        name: Name of the view.
        found: Detected positions of the corners ``(C, 2)``, px.
        errors: Detected minus predicted positions ``(C, 2)``, px.
        size: Width and height of the picture, px.
        picture: File of the picture, or None.
    """

    name: str
    found: Array
    errors: Array
    size: tuple[int, int]
    picture: str | None = None

    @property
    def rms(self) -> float:
        """RMS length of the errors, px."""
        return _rms(self.errors)


@dataclass(frozen=True, eq=False)
class CalibrationTrace:
    """Poses, held-out errors, convergence and identifiability of one calibration, as plain arrays.

    Attributes:
        nominal: Nominal geometry of the arm, which its controller uses.
        sets: Joint values ``(N, n)``, rad or m, of each pose set (identification, network, test). A pose with several
            measured errors is repeated for each of them.
        errors: Held-out pose errors ``(M, 6)``, or misses (measured minus predicted) ``(M, 1 to 3)``, m and rad, of
            each stage (raw, LS and so on), by label.
        payload: Payload at each held-out pose ``(M,)``, kg; None if it was not recorded.
        temperature: Temperature rise at each held-out pose ``(M,)``, K; None if it was not recorded.
        position_rms: Position residual RMS before each of I least-squares iterations and after the last ``(I + 1,)``,
            m.
        attitude_rms: Attitude residual RMS before each iteration and after the last ``(I + 1,)``, rad; None if only
            positions were measured.
        loss: Training loss of the network per epoch, MSE of normalised targets; None without a network.
        names: Names of the error model's P parameters.
        kept: Whether each of the P parameters was identified ``(P,)``.
        r_diagonal: |R_kk| of the QR decomposition of the scaled stacked Jacobian, for each parameter ``(P,)``.
        singular_values: Singular values of the scaled stacked Jacobian of the kept parameters.
        fingerprints: Hash of each data set, by the set's name.
        views: Held-out views with their reprojection errors; empty if no pictures were taken.
        miss_unit: Unit in which the errors are shown: "mm" for lengths, "deg" for the angles of an inclinometer.
    """

    nominal: Geometry
    sets: Mapping[str, Array]
    errors: Mapping[str, Array]
    payload: Array | None
    temperature: Array | None
    position_rms: Array
    attitude_rms: Array | None
    loss: Array | None
    names: tuple[str, ...]
    kept: NDArray[np.bool_]
    r_diagonal: Array
    singular_values: Array
    fingerprints: Mapping[str, str]
    views: tuple[ViewErrors, ...] = ()
    miss_unit: str = "mm"

    @property
    def extension(self) -> Array:
        """Distance of the tool from the base at each held-out pose ``(M,)``, m."""
        pose = forward(self.nominal, self.sets["test"])
        return np.asarray(np.linalg.norm(pose.position - self.nominal.base.position, axis=-1))


def trace_of(
    fit: Fit, sets: Mapping[str, Observations], errors: Mapping[str, Array], views: tuple[ViewErrors, ...] = ()
) -> CalibrationTrace:
    """Collect the trace of a fitted calibration.

    Args:
        fit: Result of `calibration.fit` on the first set.
        sets: Measurements by the name of the set. The first set was used for identification, and "test" was held out.
        errors: Held-out errors of each stage (raw, LS and so on), by label, as in `CalibrationTrace`.
        views: Held-out views; empty if no pictures were taken.
    """
    identification, calibration = fit.identification, fit.calibration
    identifiability, test = identification.identifiability, sets["test"]
    train = next(iter(sets.values()))
    attitude = None
    if isinstance(train, Measurements) and train.rotation is not None:
        attitude = np.array([_rms(train.difference(model)[:, 3:]) for model, _ in identification.iterates])
    conditions = test.conditions.select(test.rows_of_misses)
    learnt = calibration.learnt
    return CalibrationTrace(
        nominal=calibration.nominal,
        sets={name: data.joints[data.rows_of_misses] for name, data in sets.items()},
        errors=dict(errors),
        payload=conditions.payload,
        temperature=conditions.temperature,
        position_rms=np.array([_rms(train.misses(*step)) for step in identification.iterates]),
        attitude_rms=attitude,
        loss=learnt.model.loss if learnt is not None and isinstance(learnt.model, Bpnn) else None,
        names=identifiability.names,
        kept=np.isin(np.arange(len(identifiability.names)), identifiability.kept),
        r_diagonal=identifiability.r_diagonal,
        singular_values=identifiability.singular_values,
        fingerprints={name: data.fingerprint() for name, data in sets.items()},
        views=views,
        miss_unit=train.miss_unit,
    )


def _rms(errors: Array) -> float:
    """Return the RMS of the norms of error vectors ``(N, k)``."""
    return float(np.sqrt(np.mean(np.sum(errors**2, axis=1))))


def views_of(result: Result) -> tuple[ViewErrors, ...]:
    """Return the held-out views with the errors of their corners; empty if no pictures were taken."""
    views = result.test
    if not isinstance(views, PixelObservations) or result.pixels is None:
        return ()
    paths = [None] * len(views.joints) if views.pictures is None else [str(path) for path in views.pictures]
    parts = zip(view_names(views), views.corners, views.seen, result.held_out.pixels, paths, strict=True)
    return tuple(
        ViewErrors(name, at[visible], errors, views.camera.size, path) for name, at, visible, errors, path in parts
    )


@dataclass(frozen=True, eq=False)
class PickedTree:
    """The record of how one tree with F fruit was picked: P picks in Z rounds. Times count from the start of the tree.

    Attributes:
        seconds: Time spent on the tree, s.
        fruit: Positions of the fruit ``(F, 3)``, m, in the frame of the machine's base.
        collected: Whether each fruit was collected, that is put into a tube ``(F,)``.
        by_arm: Index, from 0, of the arm that last tried each fruit ``(F,)``; −1 if no arm did.
        zones: Left and right (x), bottom and top (z) of the zone pictured in each round ``(Z, 4)``, m.
        stands: Start and end of the time in each round when the master arm stands still ``(Z, 2)``, s.
        arm: Index, from 0, of the arm of each pick ``(P,)``.
        start: Time at which the arm leaves for the fruit, for each pick ``(P,)``, s.
        end: Time at which the arm is back, for each pick ``(P,)``, s.
        held: Time that the arm had to wait for a neighbour before each pick ``(P,)``, s.
        got: Whether the cup came back with the fruit, for each pick ``(P,)``.
    """

    seconds: float
    fruit: Array
    collected: NDArray[np.bool_]
    by_arm: NDArray[np.int64]
    zones: Array
    stands: Array
    arm: NDArray[np.int64]
    start: Array
    end: Array
    held: Array
    got: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class HarvestTrace:
    """Picks, measures and workspace from a comparison of picking strategies on the same trees.

    Attributes:
        trees: One tree of each strategy, by the strategy's name.
        funnels: For each strategy, number of fruit at each stage over all trees.
        measures: For each strategy, its measures with 95 % intervals over trees.
        throughput: For each density of fruit, picks per hour by number of arms.
        cloud: Positions of the suction cups ``(N, arms, 3)``, m, for joint values drawn uniformly within the limits.
        curves: The motion of joints over one stop of the machine: times ``(T,)``, s, displacements of each joint by
            name ``(T,)``, m or rad, and names of the joints that turn.
        tree_count: Number of trees behind funnels and measures.
    """

    trees: Mapping[str, PickedTree]
    funnels: Mapping[str, Mapping[str, int]]
    measures: Mapping[str, Mapping[str, Measure]]
    throughput: Mapping[str, Mapping[int, Measure]]
    cloud: Array
    curves: tuple[Array, Mapping[str, Array], tuple[str, ...]]
    tree_count: int


def picked_tree(harvest: Harvest) -> PickedTree:
    """Return the picks of a harvested tree as plain arrays."""
    rounds, nothing = harvest.rounds, np.zeros(0)
    return PickedTree(
        seconds=harvest.seconds,
        fruit=harvest.tree.fruit,
        collected=harvest.collected,
        by_arm=harvest.by_arm,
        zones=np.array([[r.zone.left, r.zone.right, r.zone.bottom, r.zone.top] for r in rounds]).reshape(-1, 4),
        stands=np.array([[r.begin, r.begin + r.times.makespan] for r in rounds]).reshape(-1, 2),
        arm=np.concatenate([nothing, *(r.times.arm for r in rounds)]).astype(np.int64),
        start=np.concatenate([nothing, *(r.begin + r.times.start for r in rounds)]),
        end=np.concatenate([nothing, *(r.begin + r.times.end for r in rounds)]),
        held=np.concatenate([nothing, *(r.times.held for r in rounds)]),
        got=np.concatenate([nothing, *(r.collected for r in rounds)]).astype(bool),
    )
