"""Checkpoints from which a training continues exactly: weights, optimisers, random states, environments.

A checkpoint is a container file (`pickenv.base.container`) in which damage to any byte is detected. Its state holds
tensors and plain values only, and is read without executing code. Its header holds the settings of the training and
hashes of its input files.
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
"""Largest size of a checkpoint, in bytes (32 GiB); it includes the replay buffer."""

EPISODES = "_current_ep_start"
SEEN = ("observations", "next_observations")
BUFFER = ("actions", "rewards", "dones", "timeouts", "ep_start", "ep_length", EPISODES, *SEEN)
"""Names of the arrays that a replay buffer may have. All arrays but `EPISODES` are as long as the buffer."""

COUNTS = ("num_timesteps", "_n_updates", "_episode_num")
PARTS = {
    *("parameters", "variables", "counts", "torch_random", "numpy_random", "action_random"),
    *("last", "starts", "env", "buffer", "memory"),
}
"""Names of the parts of a checkpoint's state."""


Evaluations = list[dict[str, float]]
State = dict[str, Any]
"""State of a training, by the names in `PARTS`: everything on which its continuation depends."""


def save_checkpoint(
    path: Path, model: Any, env: Sb3Vec, training: Training, inputs: Inputs, evaluations: Evaluations
) -> Path:
    """Write a checkpoint, completely or not at all: everything on which the continuation of a training depends.

    Args:
        path: File to write.
        model: Stable-Baselines3 model, between an update and the next rollout.
        env: Environments of the model.
        training: Settings of the training.
        inputs: Hashes of the calibration and the arms with which the training began.
        evaluations: Evaluations so far.
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
    """Return the settings, input hashes, evaluations so far and state of the training in a checkpoint.

    Nothing in the file is executed.

    Raises:
        InputError: If the file is missing, damaged in any byte, or of another version.
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
    """Whether a value has the type ``kind`` of an annotation, such as int | None; contents of lists are not checked."""
    kinds = get_args(kind) if isinstance(kind, UnionType) else (kind,)
    return type(value) in {get_origin(option) or option for option in kinds}


def take_checkpoint(path: Path, content: State, model: Any, env: Sb3Vec) -> None:
    """Restore a training's model and environments from the state in a checkpoint.

    Args:
        path: Checkpoint file, named in error messages.
        content: State that `read_checkpoint` returned.
        model: Model just made by `make_model`, changed in place.
        env: Environments of the model, changed in place.

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
    """Convert an array's first ``rows`` rows, or those of each array of a mapping, to tensors."""
    if isinstance(values, dict):
        return {key: _tensors(value, rows) for key, value in values.items()}
    return _tensor(values if rows is None else values[:rows])


def _arrays(values: Any) -> Any:
    if isinstance(values, dict):
        return {key: value.numpy().copy() for key, value in values.items()}
    return values.numpy().copy()
