"""Calibrate and judge thousands of arms of a study at once, in torch.

Physics, least squares and compensation are as in `pickenv.experiments.study`, so the rows agree. The least squares
of all arms start at the nominal geometry. The poses of an arm determine which parameters are redundant. In nearly all
arms these are the same parameters. `pickenv.experiments.study` computes the arms with other redundant parameters, and
the arms for which undamped steps do not suffice. Joints, vectors and frames are lists of components, whose last axis is
over arms: ``(M, N)`` at M fruit and ``(P, N)`` at P poses, for N arms. SI units.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache, partial
from operator import itemgetter
from typing import TypeAlias

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from pickenv.arm import Array, Frame, Geometry, Plant, plant_at, plants_on
from pickenv.arm.effects.drives import read_frame
from pickenv.arm.kinematics.forward import Chain, attach, chain_of, frames, tool_frame
from pickenv.arm.kinematics.geometry import LINK_PARAMETERS
from pickenv.arm.kinematics.task_space import frame_error, link_column
from pickenv.arm.plant.campaign import Place, in_components, visited
from pickenv.arm.plant.plant import tree_map, with_links
from pickenv.base import InputError, check_known, torch_on_one_thread
from pickenv.calibration import Compensator
from pickenv.calibration.compensation.compensator import corrected
from pickenv.calibration.identification.least_squares import REDUNDANCY_TOLERANCE, judged_step
from pickenv.calibration.model.arm_model import ErrorModel
from pickenv.experiments import study
from pickenv.experiments.engine import Rows, joined
from pickenv.experiments.study import measured

BLOCKS = {"cpu": 2**14, "cuda": 2**22}
"""Number of poses computed together on each device: as many as fit a core's caches, or as keep a GPU busy."""

IN_TIME = 8
"""Factor on the number of poses computed together for a plant with memory, whose measuring is simulated in time."""


Commands: TypeAlias = tuple[Sequence[Tensor], NDArray[np.int64], NDArray[np.int64], NDArray[np.bool_]]
"""Corrected commands of N arms for M fruit, as four values. The first is the joint commands, one array ``(M, N)`` per
joint, rad or m. The second is the number of fruit that each arm cannot reach, by its own calibration ``(N,)``. The
third is the number of least-squares steps ``(N,)``. The fourth says whether the batch could calibrate each arm
``(N,)``. All other arms are calibrated one by one."""


def judge_batch(
    protocol: study.Protocol,
    settings: Sequence[study.Setting],
    plants: Plant,
    around: Sequence[study.Circumstances],
    device: str = "cpu",
) -> list[Rows]:
    """Calibrate and judge a batch of arms in settings of one population.

    Args:
        protocol: The study.
        settings: The settings.
        plants: The true arms, as one plant whose parameters are arrays over arms.
        around: Fruit, calibration poses and tracker errors of each arm.
        device: "cpu" or "cuda".

    Returns:
        For each setting, the outcomes of all arms, from `outcomes_of`.
    """
    place = partial(torch.as_tensor, dtype=torch.float64, device=device)
    poses = BLOCKS[device] * (IN_TIME if protocol.design.has_state else 1)
    size = max(1, poses // max(protocol.config.fruit, *(setting.poses for setting in protocol.settings)))
    with torch_on_one_thread():
        parts = [
            _outcomes(protocol, settings, plants_on(plants, itemgetter(part)), around[part], place)
            for part in (slice(first, first + size) for first in range(0, len(around), size))
        ]
    return [joined(outcomes) for outcomes in zip(*parts, strict=True)]


def check_device(device: str) -> None:
    """Raise an error if torch cannot compute on a device here.

    Raises:
        InputError: If the device is neither "cpu" nor "cuda", or it is "cuda" and torch finds no GPU.
    """
    check_known("device", device, BLOCKS)
    if device == "cuda" and not torch.cuda.is_available():
        raise InputError("torch sees no CUDA device on this machine; give `device='cpu'`")


def _outcomes(
    protocol: study.Protocol,
    settings: Sequence[study.Setting],
    plants: Plant,
    around: Sequence[study.Circumstances],
    place: Place,
) -> list[Rows]:
    """Return the outcomes of all arms of one population, one table for each of ``settings``.

    The arguments are as for `judge_batch`. ``place`` moves an array to the device on which torch computes.
    """
    placed, count = plants_on(plants, place), len(around)
    targets = in_components(torch, np.stack([met.fruit for met in around], axis=1), place)
    read = visited_frames(protocol, placed, around, place)
    goals = tool_frame(torch, chain_of(protocol.nominal), targets)
    command = cache(lambda calibration: _commands(protocol, calibration, read, around, (targets, goals), place))
    outcomes = []
    for setting in settings:
        joints, missed, taken, converged = command(setting.calibration)
        error = frame_error(torch, goals, study.carrying(placed, setting.payload_kg).tool_frame(torch, joints))
        position, attitude = _norms(error[:3], count), _norms(error[3:], count)
        status = [study.reach_status(fruit, protocol.config) for fruit in missed.tolist()]
        steps = taken.tolist()
        for i in np.flatnonzero(~converged).tolist():
            (alone,) = study.evaluate_arm(protocol, [setting], plant_at(plants, i), around[i])
            status[i], steps[i] = alone["status"][0], alone["iterations"][0]
            position[i], attitude[i] = alone["position"][0], alone["attitude"][0]
        outcomes.append(study.outcomes_of(setting, status, steps, position, attitude))
    return outcomes


def _commands(
    protocol: study.Protocol,
    setting: study.Setting,
    read: Sequence[Tensor],
    around: Sequence[study.Circumstances],
    fruit: tuple[list[Tensor], Frame],
    place: Place,
) -> Commands:
    """Calibrate all arms by a setting's method, and return their corrected commands for the fruit, as `Commands`.

    Args:
        protocol: The study.
        setting: The setting.
        read: Frames from `visited_frames`.
        around: Fruit, calibration poses and tracker errors of each arm.
        fruit: Nominal joints at the fruit, one array ``(M, N)`` per joint, and the wanted frames of the tool.
        place: Function that moves an array to the device on which torch computes.
    """
    count, (targets, goals) = len(around), fruit
    if setting.method == study.RAW:
        none = np.zeros(count, dtype=np.int64)
        return targets, none, none, np.ones(count, dtype=bool)
    geometry, steps, converged = identify_batch(protocol, setting, read, around, place)
    chain = tree_map(place, chain_of(geometry, np))
    chains = (chain_of(protocol.nominal), chain)
    joints = corrected(torch, protocol.nominal, chains, targets, Compensator.iterations)
    gap = [a - b for a, b in zip(tool_frame(torch, chain, joints)[9:], goals[9:], strict=True)]
    missed = np.sum(_norms(gap, count) > 1e-3 * protocol.config.radius_mm, axis=1)
    return joints, missed, steps, converged


def _norms(components: Sequence[Tensor], count: int) -> Array:
    """Return the norms of vectors ``(N, M)``, with N = ``count``, given their three components ``(M, N)``."""
    x, y, z = components
    norms = torch.sqrt(x * x + y * y + z * z)
    return np.ascontiguousarray(norms.expand(-1, count).cpu().numpy().T)


# Rank-aware least squares of many arms, step by step as `least_squares` takes them.

STEPS = 10
"""Largest number of undamped steps for an arm in a batch; three or four are usual. An arm that needs more is calibrated
alone."""


def visited_frames(
    protocol: study.Protocol, plants: Plant, around: Sequence[study.Circumstances], place: Place
) -> list[Tensor]:
    """Return the true tool frames of N arms at all P calibration poses, at the times of the readings.

    The result is one frame, as a list of 12 components ``(P, N)``.

    Args:
        protocol: The study.
        plants: The true arms, as one plant whose parameters are arrays over arms.
        around: Fruit, calibration poses and tracker errors of each arm.
        place: Function that moves an array to the device on which torch computes.
    """
    visits = np.stack([met.poses for met in around], axis=1)
    stops = np.stack([met.tracker.stops for met in around], axis=-1)
    frame = visited(plants, torch, visits, protocol.tracker, stops, place)
    return [torch.as_tensor(value).broadcast_to(visits.shape[:2]) for value in frame]


def identify_batch(
    protocol: study.Protocol,
    setting: study.Setting,
    read: Sequence[Tensor],
    around: Sequence[study.Circumstances],
    place: Place,
) -> tuple[Geometry, NDArray[np.int64], NDArray[np.bool_]]:
    """Simulate the tracker's readings of many arms, and identify their geometries by least squares.

    Args:
        protocol: The study.
        setting: Setting that gives the number of poses and the tracker's noise.
        read: Frames from `visited_frames`; a setting with fewer poses takes the first ones.
        around: Fruit, calibration poses and tracker errors of each arm.
        place: Function that moves an array to the device on which torch computes.

    Returns:
        Three values. The first is the identified geometries, with link parameters ``(N, n)``. The second is the number
        of least-squares iterations ``(N,)``. The third says whether each arm's result is valid ``(N,)``. A result is
        invalid if the arm has other redundant parameters than most arms, or if undamped least-squares steps do not
        converge.
    """
    nominal, count, poses = protocol.nominal, len(around), setting.poses
    design, instrument = protocol.design, protocol.instrument(setting)
    assert instrument.noise is not None
    draws = [met.tracker.first(poses) for met in around]
    bare = Plant(design.name, design.arm, design.arm.nominal)  # for what the instrument says of itself: weights
    weights = place(measured(protocol, bare, setting, around[0]).row_weights)
    joints = in_components(torch, np.stack([met.poses[:poses] for met in around], axis=1), place)
    reading = in_components(torch, np.stack([met.reading for met in draws], axis=1), place)
    mounting = in_components(torch, np.stack([met.mounting for met in draws]), place)
    frame = tuple(value[:poses] for value in read)
    readings = read_frame(torch, instrument.noise, instrument.stand, frame, reading, mounting)
    links, tool = _links(chain_of(nominal), joints)
    weighted = _residual(weights, tool, readings)
    matrix = _jacobian(nominal, protocol.model, weights, links, tool)
    parameters, usual = _usual_parameters(matrix)
    matrix = matrix[:, :, torch.as_tensor(parameters)]
    names = tuple(protocol.model.names[k] for k in parameters)
    model = ErrorModel(protocol.model.columns[parameters], names, protocol.model.tolerance[parameters])
    geometry = _displaced_links(nominal, model, np.zeros((count, len(parameters))))
    history = _rms(weighted)
    running = torch.as_tensor(usual).to(history.device)
    converged, steps = torch.zeros_like(running), torch.zeros_like(running, dtype=torch.int64)
    for _ in range(STEPS):
        step, sound = _solve(matrix, weighted)
        stepped = _displaced_links(geometry, model, step.cpu().numpy() * model.tolerance)
        links, tool = _links(tree_map(place, chain_of(stepped, np)), joints)
        moved_weighted = _residual(weights, tool, readings)
        rms = _rms(moved_weighted)
        # From here on as in `least_squares`, arm by arm; what it would shorten is left to it.
        _, negligible, better, finished = judged_step(step, (matrix @ step[:, :, None])[..., 0], weighted, history, rms)
        accepted = running & sound & better
        converged |= running & sound & torch.where(better, finished, negligible)
        steps += accepted
        taken = accepted.cpu().numpy()[:, None]
        geometry = with_links(stepped, lambda yes, no, taken=taken: np.where(taken, yes, no), geometry)
        history = torch.where(accepted, rms, history)
        running = accepted & ~finished
        if not running.any():
            break
        weighted, matrix = moved_weighted, _jacobian(nominal, model, weights, links, tool)
    return geometry, steps.cpu().numpy(), converged.cpu().numpy()


def _usual_parameters(matrix: Tensor) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Return two arrays: the parameters that most arms can identify, and which arms can identify exactly these.

    The first array has the parameters' indices ``(K,)``, from 0. The second has a flag for each arm ``(N,)``.
    `identifiability` explains the rule.

    Args:
        matrix: Stacked, scaled Jacobians ``(N, rows, P)``, with the P parameters in order of preference.
    """
    rows, parameters = matrix.shape[1:]
    r = matrix if rows <= parameters else torch.linalg.qr(matrix, mode="r").R
    threshold = REDUNDANCY_TOLERANCE * torch.linalg.vector_norm(r, dim=1).amax(1)
    basis = torch.zeros_like(r)
    masks: list[Tensor] = []
    for k in range(parameters):
        residual = r[:, :, k, None]
        for _ in range(2):
            residual = residual - basis @ (basis.mT @ residual)
        size = torch.linalg.vector_norm(residual, dim=1)
        mask = (size[:, 0] > threshold) & (sum(masks, torch.zeros_like(threshold)) < r.shape[1])
        basis[:, :, k] = torch.where(mask[:, None], residual[..., 0] / size, 0.0)
        masks.append(mask)
    patterns, which, counts = np.unique(
        torch.stack(masks, dim=1).cpu().numpy(), axis=0, return_inverse=True, return_counts=True
    )
    most = int(np.argmax(counts))
    return np.flatnonzero(patterns[most]), np.ravel(which) == most


def _links(chain: Chain, joints: Sequence[Tensor]) -> tuple[list[Frame], Frame]:
    """Return the frames of the links, from the base on, and the frame of the tool.

    The arms ``chain`` are at ``joints``, one tensor per joint, rad or m.
    """
    links = frames(torch, chain, joints)
    return links, attach(links[-1], chain.tool)


def _residual(weights: Tensor, tool: Frame, measured: Frame) -> Tensor:
    """Return the weighted errors of poses, measured minus predicted, as rows ``(N, 6P)`` of N arms with P poses.

    Args:
        weights: Inverse of the noise of each component of a pose, 1/m and 1/rad, (6,).
        tool: Predicted frames of the tool.
        measured: Measured frames of the tool.
    """
    error = torch.stack(frame_error(torch, tool, measured))
    return (error * weights[:, None, None]).permute(2, 0, 1).flatten(1)


def _jacobian(nominal: Geometry, model: ErrorModel, weights: Tensor, links: Sequence[Frame], tool: Frame) -> Tensor:
    """Return the weighted derivatives of poses ``(N, 6P, K)`` by the K parameters, each in units of its tolerance.

    The result is for N arms at P poses.

    Args:
        nominal: Nominal geometry.
        model: Error model, which has the parameters and their tolerances.
        weights: Inverse of the noise of each component of a pose, 1/m and 1/rad, (6,).
        links: Frames of the links, from `_links`.
        tool: Frames of the tool, from `_links`.
    """
    shape = torch.broadcast_shapes(*(value.shape for value in tool[9:]))
    columns = torch.zeros((6, *shape, len(model.columns)), dtype=torch.float64, device=weights.device)
    for k, column in enumerate(model.columns.tolist()):
        kind, joint = divmod(column, nominal.joints)
        derivative = link_column(LINK_PARAMETERS[kind], links[joint], links[joint + 1], tool[9:], ())
        for row, value in enumerate(derivative):
            columns[row, ..., k] = value
    scaled = columns * weights[:, None, None, None] * torch.as_tensor(model.tolerance).to(columns)
    return scaled.permute(2, 0, 1, 3).flatten(1, 2)


def _solve(matrix: Tensor, weighted: Tensor) -> tuple[Tensor, Tensor]:
    """Return the least-squares step of each arm ``(N, K)``, in units of tolerances, and whether it exists ``(N,)``.

    The ``matrix`` ``(N, rows, K)`` comes from `_jacobian`, and the errors ``weighted`` ``(N, rows)`` from `_residual`.
    The normal equations are accurate enough, because each step corrects the rounding error of the step before.
    """
    turned = matrix.mT
    factor, failed = torch.linalg.cholesky_ex(turned @ matrix)
    right = turned @ weighted[..., None]
    return torch.cholesky_solve(right, factor)[..., 0], failed == 0


def _rms(weighted: Tensor) -> Tensor:
    return (weighted**2).mean(1).sqrt()


def _displaced_links(geometry: Geometry, model: ErrorModel, change: Array) -> Geometry:
    """Return the geometries of N arms: ``geometry`` with ``change`` added to the parameters of ``model``.

    The change ``(N, K)`` is in m and rad. The returned link parameters have shape ``(N, n)``.
    """
    shape = (len(change), geometry.joints)
    displaced = with_links(geometry, lambda values: np.broadcast_to(values, shape).copy())
    for k, column in enumerate(model.columns.tolist()):
        kind, joint = divmod(column, geometry.joints)
        getattr(displaced, LINK_PARAMETERS[kind])[:, joint] += change[:, k]
    return displaced
