"""Calibrate and judge thousands of arms at once, in torch: the arms are the last axis of every component.

The same physics, least squares and compensation as `pickenv.study.running.arm_by_arm`, so that the rows agree; arms
whose least squares does not run straight to its minimum are handed to it. Components are ``(M, N)``: fruit first,
arms last. SI.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from operator import itemgetter
from typing import Any

import numpy as np
import pyarrow as pa
import torch
from numpy.typing import NDArray
from torch import Tensor

from pickenv.arm.kinematics.forward import Frame, chain_of, tool_frame
from pickenv.arm.kinematics.geometry import Array
from pickenv.arm.kinematics.pose_error import frame_error
from pickenv.arm.plant.campaign import Place, in_components
from pickenv.arm.plant.plant import Plant
from pickenv.arm.plant.plant_batch import plant_at, plants_on
from pickenv.arm.plant.tree import tree_map
from pickenv.calibration.compensation.compensator import Compensator, corrected
from pickenv.errors import InputError
from pickenv.study.design.config import RAW, Setting
from pickenv.study.design.protocol import Circumstances, Protocol, carrying
from pickenv.study.results.outcomes import Outcomes, chunk_table, gathered, reach_status
from pickenv.study.running.arm_by_arm import evaluate_arm
from pickenv.study.running.batched_identification import identify_batch, visited_frames
from pickenv.threads import torch_on_one_thread

BLOCKS = {"cpu": 2**14, "cuda": 2**22}
"""Poses worked on together on each device: what a core's caches hold, or what keeps a GPU busy."""

IN_TIME = 8
"""Times as many where the arms are measured in time."""


@dataclass(frozen=True, eq=False)
class _Commands:
    """What N arms are told.

    Attributes:
        joints: Components ``(M, N)``, rad or m.
        missed: Fruit out of each arm's reach ``(N,)``, as far as its calibration can say.
        steps: Least-squares steps ``(N,)``.
        converged: Whether the arm was calibrated here ``(N,)``; the others are handed over.
    """

    joints: Sequence[Tensor]
    missed: NDArray[np.int64]
    steps: NDArray[np.int64]
    converged: NDArray[np.bool_]


def evaluate_batch(protocol: Protocol, chunk: int, device: str = "cpu") -> pa.Table:
    """The rows of a chunk of arms."""
    place = partial(torch.as_tensor, dtype=torch.float64, device=device)
    arms = protocol.config.arms_of(chunk)
    size = _block_size(protocol, device)
    blocks = [range(first, min(first + size, arms.stop)) for first in range(arms.start, arms.stop, size)]
    with torch_on_one_thread():
        return pa.concat_tables([_evaluate_block(protocol, block, place) for block in blocks])


def judge_batch(protocol: Protocol, setting: Setting, plants: Plant, given: Sequence[Circumstances]) -> Outcomes:
    """Any batch of arms in one setting, each in the circumstances that are given for it, on this processor."""
    place = partial(torch.as_tensor, dtype=torch.float64, device="cpu")
    size, parts = _block_size(protocol, "cpu"), []
    with torch_on_one_thread():
        for first in range(0, len(given), size):
            part = slice(first, first + size)
            parts += _outcomes(protocol, [setting], plants_on(plants, itemgetter(part)), given[part], place)
    return gathered(parts)


def check_device(device: str) -> None:
    """Refuse a device that this machine lacks.

    Raises:
        InputError: If it is not "cpu" or "cuda", or there is no such GPU.
    """
    if device not in BLOCKS:
        raise InputError(f"unknown device '{device}'; give one of {', '.join(BLOCKS)}")
    if device == "cuda" and not torch.cuda.is_available():
        raise InputError("torch sees no CUDA device on this machine; give --device cpu")


def _block_size(protocol: Protocol, device: str) -> int:
    """Arms worked on together; of arms measured in time more, as each step of each move then is for all of them."""
    poses = BLOCKS[device] * (IN_TIME if protocol.design.has_state else 1)
    return max(1, poses // max(protocol.config.fruit, *(setting.poses for setting in protocol.settings)))


def _evaluate_block(protocol: Protocol, arms: range, place: Place) -> pa.Table:
    given = [protocol.circumstances(arm) for arm in arms]
    populations = []
    for settings in protocol.populations():
        plants = protocol.draw(settings[0], arms)
        populations.append((plants, _outcomes(protocol, settings, plants, given, place)))
    return chunk_table(protocol, arms, populations)


def _outcomes(
    protocol: Protocol, settings: Sequence[Setting], plants: Plant, given: Sequence[Circumstances], place: Place
) -> list[Outcomes]:
    """Outcomes of all arms of one population in each of its settings."""
    placed = plants_on(plants, place)
    targets = in_components(torch, np.stack([one.fruit for one in given], axis=1), place)
    seen = visited_frames(protocol, placed, given, place)
    wanted = tool_frame(torch, chain_of(protocol.nominal), targets)
    known: dict[tuple[Any, ...], _Commands] = {}
    found = []
    for setting in settings:
        key = (setting.method, setting.poses, setting.noise)
        if key not in known:
            known[key] = _commands(protocol, setting, seen, given, (targets, wanted), place)
        told = known[key]
        error = frame_error(torch, wanted, carrying(placed, setting.payload_kg).tool_frame(torch, told.joints))
        position, attitude = (_norms(part, len(given)) for part in (error[:3], error[3:]))
        status = [reach_status(int(missed), protocol.config) for missed in told.missed]
        steps = told.steps.tolist()
        for i in np.flatnonzero(~told.converged).tolist():
            (alone,) = evaluate_arm(protocol, [setting], plant_at(plants, i), given[i])
            status[i], steps[i] = alone.status[0], alone.iterations[0]
            position[i], attitude[i] = alone.position[0], alone.attitude[0]
        found.append(Outcomes(setting, status, steps, position, attitude))
    return found


def _commands(
    protocol: Protocol,
    setting: Setting,
    seen: Sequence[Tensor],
    given: Sequence[Circumstances],
    fruit: tuple[list[Tensor], Frame],
    place: Place,
) -> _Commands:
    """Calibrate all arms, as they were seen, as the setting says; correct their commands for targets, wanted frames."""
    count, (targets, wanted) = len(given), fruit
    if setting.method == RAW:
        none = np.zeros(count, dtype=np.int64)
        return _Commands(targets, none, none, np.ones(count, dtype=bool))
    found = identify_batch(protocol, setting, seen, given, place)
    chain = tree_map(place, chain_of(found.geometry, np))
    chains = (chain_of(protocol.nominal), chain)
    joints = corrected(torch, protocol.nominal, chains, targets, Compensator.iterations)
    gap = [a - b for a, b in zip(tool_frame(torch, chain, joints)[9:], wanted[9:], strict=True)]
    missed = np.sum(_norms(gap, count) > 1e-3 * protocol.config.radius_mm, axis=1)
    return _Commands(joints, missed, found.steps, found.converged)


def _norms(components: Sequence[Tensor], count: int) -> Array:
    """Norms of vectors of three components ``(M, N)``, as an array ``(N, M)``."""
    x, y, z = components
    norms = torch.sqrt(x * x + y * y + z * z)
    return np.ascontiguousarray(norms.expand(-1, count).cpu().numpy().T)
