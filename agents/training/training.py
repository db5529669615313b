"""Seeded and resumable training with stable-baselines3 on pickenv's native vector environments.

A run's folder holds `checkpoint.pt` (everything needed to resume: weights, optimisers, random states, environments),
`policy.npz` (the actor alone, see `pickenv.agents.policies.learned`), `evaluations.json` and TensorBoard's logs. One
seed gives one set of weights, whether the training was interrupted or not.

A checkpoint is a container file (`pickenv.base.container`) in which damage to any byte is detected. Its state holds
tensors and plain values only, and is read without executing code. Its header holds the settings of the training and
hashes of its input files.
"""

from __future__ import annotations

import io
import json
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from types import UnionType
from typing import Any, get_args, get_origin, get_type_hints

import numpy as np
import torch
from stable_baselines3.common.callbacks import BaseCallback

from pickenv.agents.policies.adaptive import RememberingPolicy
from pickenv.agents.policies.learned import LearnedPolicy
from pickenv.agents.training import training_setup
from pickenv.agents.training.training_setup import Inputs, Training
from pickenv.base import InputError, locked, torch_on_one_thread, write_json
from pickenv.base.container import read_container, refusing_damage, write_container
from pickenv.wrappers import Sb3Vec

KIND, FORMAT = "checkpoint", 3
STATE = "state.pt"
AGAIN = "start the training again"

LIMIT = 1 << 35

EPISODES = "_current_ep_start"
SEEN = ("observations", "next_observations")
BUFFER = ("actions", "rewards", "dones", "timeouts", "ep_start", "ep_length", EPISODES, *SEEN)

COUNTS = ("num_timesteps", "_n_updates", "_episode_num")
PARTS = {
    *("parameters", "variables", "counts", "torch_random", "numpy_random", "action_random"),
    *("last", "starts", "env", "buffer", "memory"),
}
"""Names of the parts of a checkpoint's state. The continuation of a training depends on these parts."""


Evaluations = list[dict[str, float]]
State = dict[str, Any]


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

    Nothing in the file is executed. A checkpoint has at most `LIMIT` bytes (32 GiB), the replay buffer included.

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
        return Training(**settings), {name: header["inputs"][name] for name in ("arms", "calibration")}, rows, state


def _is_a(value: Any, kind: Any) -> bool:
    """Return whether a value has the type ``kind``, such as int | None; contents of lists are not checked."""
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
    """Return the filled part of a model's replay buffer, empty without a buffer.

    `BUFFER` names the arrays that a replay buffer may have. All arrays but `EPISODES` are as long as the buffer.
    """
    if (buffer := getattr(model, "replay_buffer", None)) is None:
        return {}
    filled = buffer.buffer_size if buffer.full else buffer.pos
    rows = {key: None if key == EPISODES else filled for key in BUFFER if hasattr(buffer, key)}
    arrays = {key: _tensors(getattr(buffer, key), count) for key, count in rows.items()}
    return {"pos": int(buffer.pos), "full": bool(buffer.full), **arrays}


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
    """Convert the first ``rows`` rows (all if None) of an array, or of each array of a mapping, to tensors."""
    if isinstance(values, dict):
        return {key: _tensors(value, rows) for key, value in values.items()}
    return _tensor(values if rows is None else values[:rows])


def _arrays(values: Any) -> Any:
    if isinstance(values, dict):
        return {key: value.numpy().copy() for key, value in values.items()}
    return values.numpy().copy()


# What happens during a training: checkpoints between rollouts, and evaluations in millimetres.


class EverySoOften(BaseCallback):
    """Callback that calls ``act(callback)`` every ``steps`` environment steps, between an update and a rollout."""

    def __init__(self, steps: int, act: Callable[[BaseCallback], object]) -> None:
        super().__init__()
        self.steps, self.act, self._passed = steps, act, 0

    def _on_training_start(self) -> None:
        self._passed = self.model.num_timesteps // self.steps  # so that a resumed training keeps the beat

    def _on_rollout_start(self) -> None:
        if self.model.num_timesteps // self.steps > self._passed:
            self.act(self)
            self._passed = self.model.num_timesteps // self.steps

    def _on_step(self) -> bool:
        return True


CHECKPOINT = "checkpoint.pt"


@dataclass(frozen=True, eq=False)
class Trained:
    """Result of a training.

    Attributes:
        policy: Trained actor.
        evaluations: One dict per evaluation: "steps" and the numbers that `judge` returns.
        steps_per_second: Environment steps per second, updates and evaluations included.
        out: Folder of the run.
    """

    policy: LearnedPolicy | RememberingPolicy
    evaluations: tuple[dict[str, float], ...]
    steps_per_second: float
    out: Path


def train(training: Training, out: str | Path, *, resume: bool = False, progress: bool = False) -> Trained:
    """Train a policy, or resume its training, and write the run's folder.

    Args:
        training: Settings of the training; when resuming, they must equal the settings in the checkpoint.
        out: Folder of the run.
        resume: Whether to continue from the folder's checkpoint.
        progress: Whether to draw a progress bar.

    Raises:
        InputError: If the environment or the algorithm refuses a setting, or there is no intact checkpoint to resume
            from. Also if an input file has changed since the training began, or another process works in the folder.
    """
    out = Path(out)
    path = out / CHECKPOINT
    with locked(out), torch_on_one_thread():
        rows: Evaluations = []
        if resume:
            begun, inputs, rows, state = read_checkpoint(path)
            if begun != training:
                raise InputError(f"checkpoint {path} is of another training; resume with the options it began with")
            training_setup.check_inputs(training, inputs)
        else:
            inputs = training_setup.inputs_of(training)
        model, env = training_setup.make_model(training, out)
        if resume:
            take_checkpoint(path, state, model, env)

        def judged(policy: LearnedPolicy | RememberingPolicy, steps: int) -> dict[str, float]:
            """Evaluate a policy after ``steps`` steps; the result replaces results after as many steps or more."""
            training_setup.check_inputs(training, inputs)
            rows[:] = [row for row in rows if row["steps"] < steps]
            rows.append({"steps": float(steps)} | training_setup.judge(policy, training))
            write_json(out / "evaluations.json", rows)
            return rows[-1]

        def evaluate(at: BaseCallback) -> None:
            policy = training_setup.actor_of(at.model, training, env)
            for key, value in judged(policy, at.model.num_timesteps).items():
                at.logger.record(f"eval/{key}", value)

        def keep(at: BaseCallback) -> None:
            save_checkpoint(path, at.model, env, training, inputs, rows)

        # a checkpoint follows its evaluation
        callbacks = [EverySoOften(training.evaluate_every, evaluate), EverySoOften(training.checkpoint_every, keep)]
        begin, first = time.perf_counter(), model.num_timesteps
        if model.num_timesteps < training.total:
            settings = {"reset_num_timesteps": not resume, "tb_log_name": training.algorithm, "progress_bar": progress}
            model.learn(training.total - model.num_timesteps, callback=callbacks, **settings)
            save_checkpoint(path, model, env, training, inputs, rows)
        rate = (model.num_timesteps - first) / max(time.perf_counter() - begin, 1e-9)
        policy = training_setup.actor_of(model, training, env)
        policy.save(out / "policy.npz")
        judged(policy, model.num_timesteps)
        env.close()
    return Trained(policy, tuple(rows), rate, out)


def resumed(out: str | Path) -> Training:
    """Return the settings of the training to which a folder's checkpoint belongs.

    Raises:
        InputError: If there is no intact checkpoint.
    """
    return read_checkpoint(Path(out) / CHECKPOINT)[0]
