"""Rank-aware least squares of many arms at once, step by step as `least_squares` takes them.

All arms start at the nominal geometry and share their poses and tracker, so the redundant parameters are the same for
all, and so is the first Jacobian. Only undamped steps are taken: an arm that needs more is said so. Components are
``(P, N)``: poses first, arms last. SI units.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from pickenv.arm.kinematics.forward import Chain, Frame, attach, chain_of, frames
from pickenv.arm.kinematics.geometry import LINK_PARAMETERS, Array, Geometry
from pickenv.arm.kinematics.jacobians import link_column
from pickenv.arm.kinematics.pose_error import displaced_frame, frame_error
from pickenv.arm.plant.plant import Plant
from pickenv.arm.plant.plant_batch import with_links
from pickenv.arm.plant.tree import tree_map
from pickenv.calibration.identification.least_squares import identify, judged_step
from pickenv.calibration.model.error_model import ErrorModel
from pickenv.study.design.config import Setting
from pickenv.study.design.protocol import Protocol, seen_by

STEPS = 10
"""Steps before an arm counts as one that needs more; three or four are usual."""

Place = Callable[[Array], Tensor]
"""Puts an array where torch computes."""


@dataclass(frozen=True, eq=False)
class BatchIdentification:
    """Geometries identified for N arms.

    Attributes:
        geometry: Link parameters ``(N, n)``.
        steps: Least-squares steps of each arm ``(N,)``.
        converged: Whether undamped steps led to the minimum ``(N,)``.
    """

    geometry: Geometry
    steps: NDArray[np.int64]
    converged: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class _Tracker:
    """Poses and weights that all arms share.

    Attributes:
        joints: Components ``(P, 1)``, rad or m.
        weights: One over the standard uncertainty of the six rows of a pose.
        model: The identifiable parameters.
    """

    joints: list[Tensor]
    weights: Tensor
    model: ErrorModel


def identify_batch(
    protocol: Protocol, setting: Setting, plants: Plant, noise: Array, place: Place
) -> BatchIdentification:
    """Measure and identify many arms.

    Args:
        protocol: The study.
        setting: Poses and tracker.
        plants: The true arms, where torch computes.
        noise: Standard normal numbers ``(N, P, 6)``: how the tracker errs.
        place: Puts arrays there.
    """
    tracker = _tracker(protocol, setting, place)
    std = seen_by(protocol.design, setting.noise).measurement_noise
    assert std is not None, "seen_by gives every plant a tracker"
    error = place(np.moveaxis(noise * np.repeat([std.position_std, std.attitude_std], 3), -1, 0).swapaxes(1, 2).copy())
    measured = displaced_frame(torch, plants.tool_frame(torch, tracker.joints), list(error))
    count, nominal = noise.shape[0], protocol.nominal
    geometry = _displaced_links(nominal, tracker.model, np.zeros((count, len(tracker.model.columns))))
    links, tool = _links(chain_of(nominal), tracker)
    weighted = _residual(tracker, tool, measured)
    matrix = _jacobian(protocol.nominal, tracker, links, tool)
    history = _rms(weighted)
    running = torch.ones_like(history, dtype=torch.bool)
    converged, steps = ~running, torch.zeros_like(history, dtype=torch.int64)
    for _ in range(STEPS):
        step, sound = _solve(matrix, weighted)
        moved = _displaced_links(geometry, tracker.model, step.cpu().numpy() * tracker.model.tolerance)
        links, tool = _links(tree_map(place, chain_of(moved, np)), tracker)
        moved_weighted = _residual(tracker, tool, measured)
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


def _tracker(protocol: Protocol, setting: Setting, place: Place) -> _Tracker:
    reference = protocol.perfect_measurements(setting.poses, setting.noise)
    model = protocol.model
    kept = identify(model, protocol.nominal, reference, max_iterations=1).identifiability.kept
    identifiable = ErrorModel(model.columns[kept], tuple(model.names[k] for k in kept), model.tolerance[kept])
    joints = [place(column[:, None].copy()) for column in reference.joints.T]
    return _Tracker(joints, place(reference.row_weights), identifiable)


def _links(chain: Chain, tracker: _Tracker) -> tuple[list[Frame], Frame]:
    """Frames of the links and of the tool."""
    links = frames(torch, chain, tracker.joints)
    return links, attach(links[-1], chain.tool)


def _residual(tracker: _Tracker, tool: Frame, measured: Frame) -> Tensor:
    """Whitened differences ``(N, 6P)`` of measured and predicted poses."""
    error = torch.stack(frame_error(torch, tool, measured))
    return (error * tracker.weights[:, None, None]).permute(2, 0, 1).flatten(1)


def _jacobian(nominal: Geometry, tracker: _Tracker, links: Sequence[Frame], tool: Frame) -> Tensor:
    """Whitened derivatives ``(N, 6P, K)`` by the identifiable parameters, in tolerances; one for all arms if N is 1."""
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
    step = torch.cholesky_solve(right, factor.expand(len(right), -1, -1))[..., 0]
    return step, (failed == 0).expand(len(right))


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
