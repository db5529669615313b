"""Rank-aware least squares of many arms at once, step by step as `least_squares` takes them.

All arms start at the nominal geometry. What is redundant follows from each arm's own poses, and is nearly always the
same; an arm with others, or one that needs more than undamped steps, is said so. Components are ``(P, N)``: poses
first, arms last. SI units.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from pickenv.arm.effects.drives import read_frame
from pickenv.arm.kinematics.forward import Chain, Frame, attach, chain_of, frames
from pickenv.arm.kinematics.geometry import LINK_PARAMETERS, Array, Geometry
from pickenv.arm.kinematics.pose_error import frame_error
from pickenv.arm.kinematics.task_space import link_column
from pickenv.arm.plant.campaign import Place, in_components, visited
from pickenv.arm.plant.plant import Plant
from pickenv.arm.plant.plant_batch import with_links
from pickenv.arm.plant.tree import tree_map
from pickenv.calibration.identification.least_squares import REDUNDANCY_TOLERANCE, judged_step
from pickenv.calibration.model.arm_model import ErrorModel
from pickenv.study.design.config import Setting
from pickenv.study.design.protocol import Circumstances, Protocol, measured

STEPS = 10
"""Steps before an arm counts as one that needs more; three or four are usual."""


@dataclass(frozen=True, eq=False)
class BatchIdentification:
    """Geometries identified for N arms.

    Attributes:
        geometry: Link parameters ``(N, n)``.
        steps: Least-squares steps of each arm ``(N,)``.
        converged: Whether the usual parameters and undamped steps led to the minimum ``(N,)``.
    """

    geometry: Geometry
    steps: NDArray[np.int64]
    converged: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class _Tracker:
    """Poses, and the weights and parameters that all arms share.

    Attributes:
        joints: Components ``(P, N)``, rad or m.
        weights: One over the standard uncertainty of the six rows of a pose.
        model: The parameters.
    """

    joints: list[Tensor]
    weights: Tensor
    model: ErrorModel


def visited_frames(protocol: Protocol, plants: Plant, given: Sequence[Circumstances], place: Place) -> list[Tensor]:
    """True tool frames ``(P, N)`` when the tracker reads them, at all calibration poses that the study has."""
    visits = np.stack([one.poses for one in given], axis=1)
    stops = np.stack([one.tracker.stops for one in given], axis=-1)
    frame = visited(plants, torch, visits, protocol.tracker, stops, place)
    return [torch.as_tensor(value).broadcast_to(visits.shape[:2]) for value in frame]


def identify_batch(
    protocol: Protocol, setting: Setting, frames_seen: Sequence[Tensor], given: Sequence[Circumstances], place: Place
) -> BatchIdentification:
    """Read and identify many arms.

    Args:
        protocol: The study.
        setting: Poses and tracker.
        frames_seen: From `visited_frames`; a setting of fewer poses takes the first.
        given: What each arm meets.
        place: Puts arrays where torch computes.
    """
    nominal, count, poses = protocol.nominal, len(given), setting.poses
    design, instrument = protocol.design, protocol.instrument(setting)
    assert instrument.noise is not None
    draws = [one.tracker.first(poses) for one in given]
    bare = Plant(design.name, design.arm, design.arm.nominal)  # for what the instrument says of itself: weights
    weights = place(measured(protocol, bare, setting, given[0]).row_weights)
    joints = in_components(torch, np.stack([one.poses[:poses] for one in given], axis=1), place)
    whole = _Tracker(joints, weights, protocol.model)
    reading = in_components(torch, np.stack([one.reading for one in draws], axis=1), place)
    mounting = in_components(torch, np.stack([one.mounting for one in draws]), place)
    frame = tuple(value[:poses] for value in frames_seen)
    seen = read_frame(torch, instrument.noise, instrument.stand, frame, reading, mounting)
    links, tool = _links(chain_of(nominal), whole)
    weighted = _residual(whole, tool, seen)
    matrix = _jacobian(nominal, whole, links, tool)
    kept, usual = _usual_parameters(matrix)
    matrix = matrix[:, :, torch.as_tensor(kept)]
    columns, names = whole.model.columns[kept], tuple(whole.model.names[k] for k in kept)
    tracker = replace(whole, model=ErrorModel(columns, names, whole.model.tolerance[kept]))
    geometry = _displaced_links(nominal, tracker.model, np.zeros((count, len(kept))))
    history = _rms(weighted)
    running = torch.as_tensor(usual).to(history.device)
    converged, steps = torch.zeros_like(running), torch.zeros_like(history, dtype=torch.int64)
    for _ in range(STEPS):
        step, sound = _solve(matrix, weighted)
        moved = _displaced_links(geometry, tracker.model, step.cpu().numpy() * tracker.model.tolerance)
        links, tool = _links(tree_map(place, chain_of(moved, np)), tracker)
        moved_weighted = _residual(tracker, tool, seen)
        rms = _rms(moved_weighted)
        # From here on as in `least_squares`, arm by arm; what it would shorten is left to it.
        _, negligible, better, finished = judged_step(step, (matrix @ step[:, :, None])[..., 0], weighted, history, rms)
        accepted = running & sound & better
        converged |= running & sound & torch.where(better, finished, negligible)
        steps += accepted
        chosen = accepted.cpu().numpy()[:, None]
        geometry = with_links(moved, lambda yes, no, chosen=chosen: np.where(chosen, yes, no), geometry)
        history = torch.where(accepted, rms, history)
        running = accepted & ~finished
        if not running.any():
            break
        weighted, matrix = moved_weighted, _jacobian(nominal, tracker, links, tool)
    return BatchIdentification(geometry, steps.cpu().numpy(), converged.cpu().numpy())


def _usual_parameters(matrix: Tensor) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """The parameters ``(K,)`` that most arms can identify, and which arms those are ``(N,)``; as `identifiability`.

    Args:
        matrix: Stacked, scaled Jacobians ``(N, rows, P)``, in order of preference.
    """
    rows, parameters = matrix.shape[1:]
    r = matrix if rows <= parameters else torch.linalg.qr(matrix, mode="r").R
    threshold = REDUNDANCY_TOLERANCE * torch.linalg.vector_norm(r, dim=1).amax(1)
    basis = torch.zeros_like(r)
    masks: list[Tensor] = []
    for k in range(parameters):
        rest = r[:, :, k, None]
        for _ in range(2):
            rest = rest - basis @ (basis.mT @ rest)
        size = torch.linalg.vector_norm(rest, dim=1)
        mask = (size[:, 0] > threshold) & (sum(masks, torch.zeros_like(threshold)) < r.shape[1])
        basis[:, :, k] = torch.where(mask[:, None], rest[..., 0] / size, 0.0)
        masks.append(mask)
    found = torch.stack(masks, dim=1).cpu().numpy()
    patterns, which, counts = np.unique(found, axis=0, return_inverse=True, return_counts=True)
    most = int(np.argmax(counts))
    return np.flatnonzero(patterns[most]), np.ravel(which) == most


def _links(chain: Chain, tracker: _Tracker) -> tuple[list[Frame], Frame]:
    """Frames of the links and of the tool."""
    links = frames(torch, chain, tracker.joints)
    return links, attach(links[-1], chain.tool)


def _residual(tracker: _Tracker, tool: Frame, measured: Frame) -> Tensor:
    """Whitened differences ``(N, 6P)`` of measured and predicted poses."""
    error = torch.stack(frame_error(torch, tool, measured))
    return (error * tracker.weights[:, None, None]).permute(2, 0, 1).flatten(1)


def _jacobian(nominal: Geometry, tracker: _Tracker, links: Sequence[Frame], tool: Frame) -> Tensor:
    """Whitened derivatives ``(N, 6P, K)`` by the parameters, in tolerances."""
    model = tracker.model
    shape = torch.broadcast_shapes(*(value.shape for value in tool[9:]))
    columns = torch.zeros((6, *shape, len(model.columns)), dtype=torch.float64, device=tracker.weights.device)
    for k, column in enumerate(model.columns.tolist()):
        kind, joint = divmod(column, nominal.joints)
        derivative = link_column(LINK_PARAMETERS[kind], links[joint], links[joint + 1], tool[9:], ())
        for row, value in enumerate(derivative):
            columns[row, ..., k] = value
    scaled = columns * tracker.weights[:, None, None, None] * torch.as_tensor(model.tolerance).to(columns)
    return scaled.permute(2, 0, 1, 3).flatten(1, 2)


def _solve(matrix: Tensor, weighted: Tensor) -> tuple[Tensor, Tensor]:
    """Least-squares steps ``(N, K)``, and whether the equations were sound ``(N,)``.

    The normal equations do: what they lose of a step, the next step makes good.
    """
    turned = matrix.mT
    factor, failed = torch.linalg.cholesky_ex(turned @ matrix)
    right = turned @ weighted[..., None]
    return torch.cholesky_solve(right, factor)[..., 0], failed == 0


def _rms(weighted: Tensor) -> Tensor:
    return (weighted**2).mean(1).sqrt()


def _displaced_links(geometry: Geometry, model: ErrorModel, change: Array) -> Geometry:
    """Geometries ``(N, n)`` with ``change`` ``(N, K)`` added to the model's link parameters."""
    shape = (len(change), geometry.joints)
    moved = with_links(geometry, lambda values: np.broadcast_to(values, shape).copy())
    for k, column in enumerate(model.columns.tolist()):
        kind, joint = divmod(column, geometry.joints)
        getattr(moved, LINK_PARAMETERS[kind])[:, joint] += change[:, k]
    return moved
