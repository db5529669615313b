"""Checkpoints from which training goes on as if it had never stopped: weights, optimisers, randomness, environments.

A checkpoint is a container (`pickenv.base.container`): every byte is sealed, and the state inside it, tensors and plain
values only, is read without executing code. Its header names its training, and that training's files.
"""

from __future__ import annotations

import io
import json
from dataclasses import asdict
from pathlib import Path
from types import UnionType
from typing import Any, get_args, get_origin, get_type_hints

import numpy as np
import torch

from pickenv.agents.training.training_setup import Inputs, Training
from pickenv.base import InputError, read_container, refusing_damage, write_container
from pickenv.wrappers import Sb3Vec

KIND, FORMAT = "checkpoint", 3
STATE = "state.pt"
AGAIN = "start the training again"

LIMIT = 1 << 35
"""Most bytes that a checkpoint may have (32 GiB); it includes the replay buffer."""

EPISODES = "_current_ep_start"
SEEN = ("observations", "next_observations")
BUFFER = ("actions", "rewards", "dones", "timeouts", "ep_start", "ep_length", EPISODES, *SEEN)
"""Arrays that a replay buffer may have, as long as the buffer except `EPISODES`."""

COUNTS = ("num_timesteps", "_n_updates", "_episode_num")
PARTS = {
    *("parameters", "variables", "counts", "torch_random", "numpy_random", "action_random"),
    *("last", "starts", "env", "buffer", "memory"),
}
"""Names of the parts of a checkpoint's state."""


Evaluations = list[dict[str, float]]
State = dict[str, Any]
"""Everything that the rest of a training depends on, by `PARTS`."""


def save_checkpoint(
    path: Path, model: Any, env: Sb3Vec, training: Training, inputs: Inputs, evaluations: Evaluations
) -> Path:
    """Write everything that the rest of a training depends on, whole or not at all.

    Args:
        path: The file.
        model: The algorithm, between an update and the next rollout.
        env: Its environments.
        training: What is trained.
        inputs: The calibration and the arms that the training was begun with.
        evaluations: The evaluations so far.
    """
    name, keys, position, has_gauss, gauss = np.random.get_state(legacy=True)
    memory = getattr(model, "_last_lstm_states", None) or ()  # of a recurrent policy's actor and critic
    state = {
        "parameters": model.get_parameters(),
        "variables": {key: getattr(model, key).detach().clone() for key in model._get_torch_save_params()[1]},
        "counts": {key: getattr(model, key) for key in COUNTS},
        "torch_random": torch.get_rng_state(),
        "numpy_random": [name, _tensor(keys), int(position), int(has_gauss), float(gauss)],
        "action_random": json.dumps(model.action_space.np_random.bit_generator.state),
        "last": _tensors(model._last_obs),
        "starts": _tensor(model._last_episode_starts),
        "env": _tensors(env.state()),
        "buffer": _buffer(model),
        "memory": [[part.detach().clone() for part in parts] for parts in memory],
    }
    stored = io.BytesIO()
    torch.save(state, stored)
    header = {"training": asdict(training), "inputs": inputs, "evaluations": evaluations}
    return write_container(path, KIND, header, {}, {STATE: stored.getvalue()}, version=FORMAT)


def read_checkpoint(path: Path) -> tuple[Training, Inputs, Evaluations, State]:
    """The training in a checkpoint, the calibration and arms it was begun with, its evaluations so far, and its state.

    Nothing in the file is executed.

    Raises:
        InputError: If it is missing, damaged in any byte, or of another version.
    """
    if not path.exists():
        raise InputError(f"there is no checkpoint {path} to go on from; start the training without `resume`")
    container = read_container(path, KIND, remake=AGAIN, version=FORMAT, limit=LIMIT)
    with refusing_damage(path, "a checkpoint", AGAIN):
        header, settings = container.header, container.header["training"]
        kinds = get_type_hints(Training)
        if set(settings) != set(kinds) or not all(_is_a(value, kinds[name]) for name, value in settings.items()):
            raise ValueError("its settings are not those of a training")
        state = torch.load(io.BytesIO(container.blobs[STATE]), weights_only=True)
        if set(state) != PARTS:
            raise ValueError("its state is not that of a training")
        rows = [{str(key): float(value) for key, value in row.items()} for row in header["evaluations"]]
        inputs = {name: header["inputs"][name] for name in ("arms", "calibration")}
        return Training(**settings), inputs, rows, state


def _is_a(value: Any, kind: Any) -> bool:
    """Whether a value has an annotated type, such as int | None; the contents of a list or a dict are not checked."""
    kinds = get_args(kind) if isinstance(kind, UnionType) else (kind,)
    return type(value) in {get_origin(option) or option for option in kinds}


def take_checkpoint(path: Path, content: State, model: Any, env: Sb3Vec) -> None:
    """Bring a freshly made training to where the checkpoint ``path``, with the state ``content``, was written.

    Raises:
        InputError: If the state does not fit the training.
    """
    with refusing_damage(path, "a checkpoint of this training", AGAIN):
        model.set_parameters(content["parameters"], exact_match=True)
        for key, value in content["variables"].items():
            getattr(model, key).data.copy_(value)
        for key in COUNTS:
            setattr(model, key, content["counts"][key])
        model._last_obs = _arrays(content["last"])
        model._last_episode_starts = content["starts"].numpy().copy()
        env.take_state(_arrays(content["env"]))
        _take_buffer(model, content["buffer"])
        if content["memory"]:
            model._last_lstm_states = type(model._last_lstm_states)(*(tuple(part) for part in content["memory"]))
        model.action_space.np_random.bit_generator.state = json.loads(content["action_random"])
        name, keys, position, has_gauss, gauss = content["numpy_random"]
        np.random.set_state((name, keys.numpy(), position, has_gauss, gauss))
        torch.set_rng_state(content["torch_random"])


def _buffer(model: Any) -> dict[str, Any]:
    if (buffer := getattr(model, "replay_buffer", None)) is None:
        return {}
    filled = buffer.buffer_size if buffer.full else buffer.pos
    parts: dict[str, Any] = {"pos": int(buffer.pos), "full": bool(buffer.full)}
    for key in BUFFER:
        if hasattr(buffer, key):
            parts[key] = _tensors(getattr(buffer, key), None if key == EPISODES else filled)
    return parts


def _take_buffer(model: Any, parts: dict[str, Any]) -> None:
    if (buffer := getattr(model, "replay_buffer", None)) is None:
        return
    buffer.pos, buffer.full = parts["pos"], parts["full"]
    for key, value in parts.items():
        if isinstance(value, dict):
            for name, part in value.items():
                getattr(buffer, key)[name][: len(part)] = part.numpy()
        elif isinstance(value, torch.Tensor):
            getattr(buffer, key)[: len(value)] = value.numpy()


def _tensor(values: Any) -> torch.Tensor:
    return torch.from_numpy(np.array(values))


def _tensors(values: Any, rows: int | None = None) -> Any:
    """Tensors of an array's first rows, or of those of a mapping of arrays."""
    if isinstance(values, dict):
        return {key: _tensors(value, rows) for key, value in values.items()}
    return _tensor(values if rows is None else values[:rows])


def _arrays(values: Any) -> Any:
    if isinstance(values, dict):
        return {key: value.numpy().copy() for key, value in values.items()}
    return values.numpy().copy()
