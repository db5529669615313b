"""Checkpoints from which training goes on as if it had never stopped: weights, optimisers, randomness, environments.

Tensors and plain values only, so that a checkpoint is read without executing code; written whole or not at all.
"""

from __future__ import annotations

import json
import pickle
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import torch

from pickenv.errors import InputError
from pickenv.files import write_whole
from pickenv.wrappers.sb3 import Sb3Vec

FORMAT = 1

BUFFER = ("actions", "rewards", "dones", "timeouts", "ep_start", "ep_length", "_current_ep_start")
"""Arrays of a replay buffer, where it has them; observations come in one or two more."""


def save_checkpoint(path: Path, model: Any, env: Sb3Vec, settings: dict[str, Any]) -> Path:
    """Write everything that the rest of a training depends on.

    Args:
        path: The file.
        model: The algorithm, between an update and the next rollout.
        env: Its environments.
        settings: JSON that describes the training.
    """
    name, keys, position, has_gauss, gauss = np.random.get_state(legacy=True)
    content = {
        "format": FORMAT,
        "settings": json.dumps(settings),
        "parameters": model.get_parameters(),
        "variables": {key: getattr(model, key).detach().clone() for key in model._get_torch_save_params()[1]},
        "counts": {key: getattr(model, key) for key in ("num_timesteps", "_n_updates", "_episode_num")},
        "torch_random": torch.get_rng_state(),
        "numpy_random": [name, _tensor(keys), int(position), int(has_gauss), float(gauss)],
        "action_random": json.dumps(model.action_space.np_random.bit_generator.state),
        "last": _tensors(model._last_obs),
        "starts": _tensor(model._last_episode_starts),
        "env": _tensors(env.state()),
        "buffer": _buffer(model),
    }
    return write_whole(path, lambda temporary: torch.save(content, temporary))


def read_checkpoint(path: Path) -> dict[str, Any]:
    """The content of a checkpoint.

    Raises:
        InputError: If it is missing, damaged, or newer than this program.
    """
    if not path.is_file():
        raise InputError(f"there is no checkpoint {path} to go on from; start the training without --resume")
    try:
        content: dict[str, Any] = torch.load(path, weights_only=True)
        json.loads(content["settings"])
        newer = int(content["format"]) > FORMAT
    except (OSError, EOFError, ValueError, KeyError, TypeError, RuntimeError) as error:
        raise InputError(f"checkpoint {path} is damaged ({_short(error)}); start the training again") from error
    except (zipfile.BadZipFile, pickle.UnpicklingError) as error:
        raise InputError(f"{path} is not a checkpoint of pickenv ({_short(error)}); start again") from error
    if newer:
        raise InputError(f"checkpoint {path} has format {content['format']}, we read {FORMAT}; update pickenv")
    return content


def take_checkpoint(content: dict[str, Any], model: Any, env: Sb3Vec) -> None:
    """Bring a freshly made training to where the checkpoint was written."""
    model.set_parameters(content["parameters"], exact_match=True)
    for key, value in content["variables"].items():
        getattr(model, key).data.copy_(value)
    for key, value in content["counts"].items():
        setattr(model, key, value)
    model._last_obs = _arrays(content["last"])
    model._last_episode_starts = content["starts"].numpy().copy()
    env.take_state(_arrays(content["env"]))
    _take_buffer(model, content["buffer"])
    model.action_space.np_random.bit_generator.state = json.loads(content["action_random"])
    name, keys, position, has_gauss, gauss = content["numpy_random"]
    np.random.set_state((name, keys.numpy(), position, has_gauss, gauss))
    torch.set_rng_state(content["torch_random"])


def _buffer(model: Any) -> dict[str, Any]:
    buffer = getattr(model, "replay_buffer", None)
    if buffer is None:
        return {}
    filled = buffer.buffer_size if buffer.full else buffer.pos
    parts: dict[str, Any] = {"pos": int(buffer.pos), "full": bool(buffer.full)}
    for key in BUFFER:
        if hasattr(buffer, key):
            values = getattr(buffer, key)
            parts[key] = _tensor(values if key == "_current_ep_start" else values[:filled])
    for key in ("observations", "next_observations"):
        values = getattr(buffer, key)
        some = {k: v[:filled] for k, v in values.items()} if isinstance(values, dict) else values[:filled]
        parts[key] = _tensors(some)
    return parts


def _take_buffer(model: Any, parts: dict[str, Any]) -> None:
    buffer = getattr(model, "replay_buffer", None)
    if buffer is None:
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


def _tensors(values: Any) -> Any:
    return {key: _tensor(value) for key, value in values.items()} if isinstance(values, dict) else _tensor(values)


def _arrays(values: Any) -> Any:
    if isinstance(values, dict):
        return {key: value.numpy().copy() for key, value in values.items()}
    return values.numpy().copy()


def _short(error: Exception) -> str:
    return (str(error).strip().splitlines() or [type(error).__name__])[0][:100]
