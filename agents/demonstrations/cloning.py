"""Behaviour cloning: a small network that takes the fruit of `pickenv/PickScene-v0` by what its wrist camera shows.

It learns from demonstrations of any policy, without the environment: pictures, joints and gripper in, the tool's step
out. Between pictures and steps stand points in the picture (the spatial softmax of Levine et al. 2016), and steps are
those of the tool in its own frame, which look the same wherever the arm stands. Needs torch.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from pickenv.agents.policies.policy import ReachController
from pickenv.arm import Array, Geometry, content_sha256, forward, joint_jacobian, truncated_inverse
from pickenv.base import (
    InputError,
    check_limit,
    npz_path,
    read_container,
    refusing_damage,
    require,
    write_container,
)
from pickenv.envs import check_count

require("torch")
import torch as th  # noqa: E402
from torch import nn  # noqa: E402

KIND, REMAKE = "clone", "clone the demonstrations anew"
CAMERA = "wrist"

POINTS, HIDDEN = 16, 256
"""Points in the picture that it finds, and width of the layers behind them."""

BATCH, RATE, DECAY, PASSES = 64, 2e-3, 1e-4, 12
"""Steps in a batch, largest rate of learning and decay of weights (AdamW, one cycle), and passes through the steps."""


class Clone(nn.Module):
    """What was learnt: the tool's next step from a picture, joints and gripper.

    Args:
        numbers: Joints and gripper, n + 1.
        task: Hash of the nominal arm, its increments in a period and the scale of the scene that it is of.
        pixels: Width and height of the pictures that it saw.

    Attributes:
        middle: Means of joints and gripper.
        spread: Their standard deviations.
        unit: Mean sizes of the steps, m, rad.
    """

    middle: th.Tensor
    spread: th.Tensor
    unit: th.Tensor

    def __init__(self, numbers: int, task: str, pixels: int) -> None:
        super().__init__()
        self.task, self.pixels = task, pixels
        self.see = nn.Sequential(
            *(nn.Conv2d(3, POINTS, 5, 2, 2), nn.ReLU(), nn.Conv2d(POINTS, 2 * POINTS, 3, 2, 1), nn.ReLU()),
            nn.Conv2d(2 * POINTS, POINTS, 3, 1, 1),
        )
        layers = nn.Linear(4 * POINTS + numbers, HIDDEN), nn.ReLU(), nn.Linear(HIDDEN, HIDDEN), nn.ReLU()
        self.think = nn.Sequential(*layers, nn.Linear(HIDDEN, 7))
        for name, size in (("middle", numbers), ("spread", numbers), ("unit", 7)):
            self.register_buffer(name, th.ones(size))

    def forward(self, pictures: th.Tensor, numbers: th.Tensor) -> th.Tensor:
        """Steps ``(b, 7)`` of the tool in its frame and the gripper, in units of their mean sizes.

        Args:
            pictures: uint8 ``(b, 3, h, w)``.
            numbers: Joints and gripper ``(b, n + 1)``.
        """
        seen = self.see(pictures.float() / 255.0 - 0.5)
        rows, columns = (th.linspace(-1.0, 1.0, size) for size in seen.shape[2:])
        places = th.stack([rows[:, None].expand(seen.shape[2:]), columns.expand(seen.shape[2:])]).flatten(1)
        share = seen.flatten(2).softmax(-1)
        mean, square = (th.einsum("bpm,cm->bpc", share, values).flatten(1) for values in (places, places**2))
        scaled = (numbers - self.middle) / self.spread
        return cast(th.Tensor, self.think(th.cat([mean, 5.0 * (square - mean**2), scaled], dim=1)))

    def save(self, path: str | Path) -> Path:
        """Write one verified file, whole or not at all; ``.npz`` is appended if missing."""
        arrays = {name: value.numpy() for name, value in self.state_dict().items()}
        return write_container(npz_path(path), KIND, {"task": self.task, "pixels": self.pixels}, arrays)

    @classmethod
    def load(cls, path: str | Path) -> Clone:
        """Read what `save` wrote; nothing in it is executed.

        Raises:
            InputError: If the file is missing, damaged or of another kind.
        """
        container = read_container(path, KIND, remake=REMAKE)
        with refusing_damage(path, "a clone", REMAKE):
            header = container.header
            network = cls(len(container.arrays["middle"]), str(header["task"]), int(header["pixels"]))
            network.load_state_dict({name: th.as_tensor(np.array(value)) for name, value in container.arrays.items()})
            if not all(np.isfinite(value).all() for value in container.arrays.values()):
                raise ValueError("it holds numbers that are not finite")
        return network.eval()


def clone(
    demonstrations: Iterable[tuple[Mapping[str, Any], NDArray[Any]]],
    env: Any,
    *,
    seed: int,
    passes: int = PASSES,
    progress: Callable[[str, int, int], None] | None = None,
) -> Clone:
    """Learn to act as demonstrated.

    Args:
        demonstrations: Observations and actions ``(steps, n + 1)`` of each episode; an observation more than actions is
            the last one. Of the observations, ``["pixels"]["wrist"]`` and ``["agent_pos"]`` are used.
        env: The `pickenv/PickScene-v0` whose nominal arm they are of.
        seed: Of first weights and order; same seed, same clone.
        passes: How often it goes through all steps.
        progress: Called with (name, passes done, in all).

    Raises:
        InputError: If there are no demonstrations, or they hold no pictures of the wrist camera, or do not fit the arm.
    """
    check_count("passes", passes)
    check_limit("seed", seed, "seed")
    controller = ReachController(env)
    width = controller.geometry.joints + 1
    pictures, numbers, steps = list[NDArray[Any]](), list[Array](), list[Array]()
    for episode, (observations, actions) in enumerate(demonstrations):
        views, joints = _looked(observations)
        actions, count = np.asarray(actions, dtype=float), len(actions)
        size = (pictures[0] if pictures else views).shape[1:]
        sees = views.dtype == np.uint8 and views.shape[1:] == size == (*size[:1], *size[:1], 3)
        moves = joints.shape[1:] == actions.shape[1:] == (width,)
        if not (sees and moves and min(len(views), len(joints)) >= count > 0):
            shapes = f"pictures {views.dtype} {views.shape}, agent_pos {joints.shape} and actions {actions.shape}"
            give = f"uint8 (k, pixels, pixels, 3) of one size, and (k, {width}) of both"
            raise InputError(f"demonstration {episode} has {shapes}; give {give}")
        if not (np.isfinite(joints).all() and np.isfinite(actions).all()):
            raise InputError(f"demonstration {episode} has numbers that are not finite; leave it out")
        pictures.append(views[:count])
        numbers.append(joints[:count])
        steps.append(_tool_steps(controller.geometry, joints[:count, :-1], actions * [*controller.increment, 1.0]))
    if not steps:
        raise InputError("there are no demonstrations; give one at least")
    seen, target = np.concatenate(numbers), np.concatenate(steps)
    with th.random.fork_rng(devices=[]):
        th.manual_seed(seed % 2**63)
        network = Clone(width, _task_of(env), pictures[0].shape[1])
        network.middle, network.spread = _tensor(seen.mean(axis=0)), _tensor(seen.std(axis=0) + 1e-3)
        network.unit = _tensor(np.abs(target).mean(axis=0) + 1e-6)
        shown = th.as_tensor(np.concatenate(pictures)).permute(0, 3, 1, 2).contiguous()
        inputs, wanted = _tensor(seen), _tensor(target) / network.unit
        _fit(network, shown, inputs, wanted, passes, progress)
    return network.eval()


def _fit(
    network: Clone,
    pictures: th.Tensor,
    numbers: th.Tensor,
    wanted: th.Tensor,
    passes: int,
    progress: Callable[[str, int, int], None] | None,
) -> None:
    """Train a network to give what is wanted, by the mean absolute error."""
    batches = -(-len(wanted) // BATCH)
    optimiser = th.optim.AdamW(network.parameters(), RATE, weight_decay=DECAY)
    rates = th.optim.lr_scheduler.OneCycleLR(optimiser, RATE, passes * batches)
    for done in range(passes):
        for rows in th.randperm(len(wanted)).chunk(batches):
            loss = (network(pictures[rows], numbers[rows]) - wanted[rows]).abs().mean()
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            rates.step()
        if progress is not None:
            progress("clone", done + 1, passes)


class ClonedScene(ReachController):
    """A clone that drives an arm, by the nominal arm's Jacobian.

    Args:
        env: The `pickenv/PickScene-v0`, with the wrist's pictures and "agent_pos".
        network: What it learnt.
    """

    def __init__(self, env: Any, network: Clone) -> None:
        super().__init__(env)
        if network.task != _task_of(env):
            name = env.unwrapped.plant.arm.name
            raise InputError(f"the clone is of another arm, period or scale than this {name}; clone one of this")
        self.network = network

    def reset(self) -> None:
        """Nothing to forget."""

    def act(self, observation: Any) -> NDArray[np.float32]:
        """The next action ``(n + 1,)``.

        Raises:
            InputError: If there is no picture, or of another size than those that it learnt from.
        """
        shown, numbers = _looked(observation)
        if len(shown) != self.network.pixels:
            size = self.network.pixels
            raise InputError(f"the picture has {len(shown)} px, the clone saw {size}; make the environment with {size}")
        picture = th.as_tensor(shown.copy()).permute(2, 0, 1)[None]
        with th.no_grad():
            step = (self.network(picture, _tensor(numbers)[None]) * self.network.unit)[0].double().numpy()
        turn = forward(self.geometry, numbers[:-1]).rotation
        moves = np.concatenate([turn @ step[:3], turn @ step[3:6]])
        joints = truncated_inverse(joint_jacobian(self.geometry, numbers[:-1])) @ moves
        return np.append(self.action(joints), np.clip(step[6], -1.0, 1.0)).astype(np.float32)


def _looked(observation: Any) -> tuple[NDArray[Any], Array]:
    """The wrist's picture, and joints and gripper, of an observation, or those of many."""
    try:
        return np.asarray(observation["pixels"][CAMERA]), np.asarray(observation["agent_pos"], dtype=float)
    except (KeyError, TypeError, IndexError) as error:
        raise InputError(
            "an observation holds no picture of the wrist camera or no agent_pos; give obs_type='pixels_agent_pos'"
        ) from error


def _task_of(env: Any) -> str:
    """A hash of what gives a step its meaning: the nominal arm, its increments and the scale of the scene."""
    inner = env.unwrapped
    return content_sha256(inner.plant.arm.fingerprint(), np.array(inner.increment).tolist(), inner.scene.around.scale)


def _tool_steps(geometry: Geometry, joints: Array, moves: Array) -> Array:
    """Steps of the tool in its own frame ``(k, 7)``, m, rad, and the gripper's, of steps of joints ``(k, n + 1)``."""
    steps = np.einsum("kij,kj->ki", joint_jacobian(geometry, joints), moves[:, :-1]).reshape(-1, 2, 3)
    within = np.einsum("kji,kpj->kpi", forward(geometry, joints).rotation, steps).reshape(-1, 6)
    return np.concatenate([within, moves[:, -1:]], axis=1)


def _tensor(values: Array) -> th.Tensor:
    return th.as_tensor(values, dtype=th.float32)
