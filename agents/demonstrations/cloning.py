"""Behaviour cloning: a small network that picks fruit in `pickenv/PickScene-v0` from the wrist camera's images.

The network learns from recorded demonstrations of any policy. Inputs are an image, joint values and the gripper's
state. The output is a step of the tool and the gripper. The network reduces an image to feature points (the spatial
softmax of Levine et al. 2016). Steps are given in the tool's own frame, where they look the same at any joint values.
The module needs torch.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from pickenv.agents.policies.policy import ReachController
from pickenv.arm import Array, Geometry, content_sha256, forward, joint_jacobian, truncated_inverse
from pickenv.base import InputError, check_limit, npz_path, read_container, refusing_damage, require, write_container
from pickenv.base.files import Progress
from pickenv.envs import check_count

require("torch")
import torch as th  # noqa: E402
from torch import nn  # noqa: E402

KIND, REMAKE = "clone", "clone the demonstrations anew"
CAMERA = "wrist"

POINTS, HIDDEN = 16, 256
"""Number of feature points in the image, and width of the hidden layers."""

BATCH, RATE, DECAY, PASSES = 64, 2e-3, 1e-4, 12


class Clone(nn.Module):
    """Network that predicts the tool's next step from an image, the joint values and the gripper's state.

    Args:
        numbers: Count n + 1 of the numbers in an input besides the image: n joint values and the gripper's state.
        task: Hash of the nominal arm, its joint increments per control period, and the scale of the scene.
        pixels: Width and height of the images, px.

    Attributes:
        middle: Means over the demonstrations of joint values and gripper state ``(n + 1,)``.
        spread: Standard deviations over the demonstrations of joint values and gripper state ``(n + 1,)``.
        unit: Mean absolute step over the demonstrations ``(7,)``: of the tool, m and rad, and of the gripper.
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
        """Return steps ``(b, 7)`` of the tool, in the tool's frame, and of the gripper, divided by `unit`.

        Args:
            pictures: Images, uint8 ``(b, 3, h, w)``.
            numbers: Joint values and gripper state ``(b, n + 1)``.
        """
        seen = self.see(pictures.float() / 255.0 - 0.5)
        rows, columns = (th.linspace(-1.0, 1.0, size) for size in seen.shape[2:])
        places = th.stack([rows[:, None].expand(seen.shape[2:]), columns.expand(seen.shape[2:])]).flatten(1)
        share = seen.flatten(2).softmax(-1)
        mean, square = (th.einsum("bpm,cm->bpc", share, values).flatten(1) for values in (places, places**2))
        scaled = (numbers - self.middle) / self.spread
        return cast(th.Tensor, self.think(th.cat([mean, 5.0 * (square - mean**2), scaled], dim=1)))

    def save(self, path: str | Path) -> Path:
        """Write the network to one file with a checksum, completely or not at all; ``.npz`` is appended if missing."""
        arrays = {name: value.numpy() for name, value in self.state_dict().items()}
        return write_container(npz_path(path), KIND, {"task": self.task, "pixels": self.pixels}, arrays)

    @classmethod
    def load(cls, path: str | Path) -> Clone:
        """Read a network from a file that `save` wrote; nothing in the file is executed.

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
    progress: Progress | None = None,
) -> Clone:
    """Train a network to imitate demonstrations.

    Args:
        demonstrations: Observations and actions ``(steps, n + 1)`` of each episode. If there is one observation more
            than actions, the last is ignored. The entries ``["pixels"]["wrist"]`` and ``["agent_pos"]`` of the
            observations are used.
        env: A `pickenv/PickScene-v0` with the nominal arm of the demonstrations.
        seed: Seed of initial weights and of the order of batches; the same seed gives the same network.
        passes: Number of epochs.
        progress: Called with (name, epochs done, total).

    Raises:
        InputError: If there are no demonstrations, or they have no images of the wrist camera or do not fit the arm.
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
    network: Clone, pictures: th.Tensor, numbers: th.Tensor, wanted: th.Tensor, passes: int, progress: Progress | None
) -> None:
    """Train a network in place, with the mean absolute error as its loss.

    The optimiser is AdamW with batches of `BATCH` rows, the weight decay `DECAY`, and one cycle of learning rates up to
    `RATE`.

    Args:
        network: The network.
        pictures: Images, uint8 ``(k, 3, h, w)``.
        numbers: Joint values and gripper state ``(k, n + 1)``.
        wanted: The steps that the network should return ``(k, 7)``, as `Clone.forward` explains them.
        passes: Number of epochs.
        progress: Called with (name, epochs done, total), or None.
    """
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
    """Policy that runs a `Clone` and converts its tool steps to joint steps by the nominal arm's Jacobian.

    Args:
        env: A `pickenv/PickScene-v0` with the wrist camera's images and "agent_pos".
        network: Trained network.

    Raises:
        InputError: If the network was trained for another arm, control period or scale.
    """

    def __init__(self, env: Any, network: Clone) -> None:
        super().__init__(env)
        if network.task != _task_of(env):
            name = env.unwrapped.plant.arm.name
            raise InputError(f"the clone is of another arm, period or scale than this {name}; clone one of this")
        self.network = network

    def act(self, observation: Any) -> NDArray[np.float32]:
        """Return the next action ``(n + 1,)``.

        Raises:
            InputError: If the observation has no image, or its image has another size than the images of the training.
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
    """Return the wrist camera's images, and joint values with gripper state, from one observation or many.

    Raises:
        InputError: If the observation has no images, or no joint values.
    """
    try:
        return np.asarray(observation["pixels"][CAMERA]), np.asarray(observation["agent_pos"], dtype=float)
    except (KeyError, TypeError, IndexError) as error:
        raise InputError(
            "an observation holds no picture of the wrist camera or no agent_pos; give obs_type='pixels_agent_pos'"
        ) from error


def _task_of(env: Any) -> str:
    """Return a hash of all that a network's step depends on: nominal arm, joint increments, and the scene's scale."""
    inner = env.unwrapped
    return content_sha256(inner.plant.arm.fingerprint(), np.array(inner.increment).tolist(), inner.scene.around.scale)


def _tool_steps(geometry: Geometry, joints: Array, moves: Array) -> Array:
    """Convert joint steps to tool steps.

    Args:
        geometry: Nominal geometry of the arm.
        joints: Joint values before the steps ``(k, n)``, rad or m.
        moves: Joint steps, rad or m, and then the gripper's command ``(k, n + 1)``.

    Returns:
        Steps of position (m) and attitude (rad) in the tool's frame, and then the gripper's command ``(k, 7)``.
    """
    steps = np.einsum("kij,kj->ki", joint_jacobian(geometry, joints), moves[:, :-1]).reshape(-1, 2, 3)
    within = np.einsum("kji,kpj->kpi", forward(geometry, joints).rotation, steps).reshape(-1, 6)
    return np.concatenate([within, moves[:, -1:]], axis=1)


def _tensor(values: Array) -> th.Tensor:
    return th.as_tensor(values, dtype=th.float32)
