"""Parts of a training: settings, environments, algorithms, actors, and the evaluation of actors."""

from __future__ import annotations

import ast
import json
from copy import deepcopy
from dataclasses import asdict, dataclass, field
from pathlib import Path
from pkgutil import resolve_name
from typing import Any

import numpy as np

from pickenv.agents.evaluation.contenders import FRUIT, load_compensator, pick_canopies
from pickenv.agents.policies.adaptive import LSTM, RememberingPolicy
from pickenv.agents.policies.learned import LearnedPolicy
from pickenv.arm.files.arm import content_sha256
from pickenv.base import InputError, check_limit, file_sha256, is_there, npz_path, seed_words, shown, stream, versions
from pickenv.base.errors import check_known
from pickenv.envs import PickVectorEnv, ReachGoalVectorEnv, ReachIdealVectorEnv, ReachToolVectorEnv, ReachVectorEnv
from pickenv.envs.shared.task import check_count
from pickenv.wrappers import GapScalingVector, SameArmMixture, SameArmVector, Scaling, ToolSteppingVector, tool_steps_of

Native = ReachVectorEnv | PickVectorEnv
ENVIRONMENTS: dict[str, type[Native]] = {
    "pickenv/Reach-v0": ReachVectorEnv,
    "pickenv/ReachIdeal-v0": ReachIdealVectorEnv,
    "pickenv/ReachGoal-v0": ReachGoalVectorEnv,
    "pickenv/ReachTool-v0": ReachToolVectorEnv,
    "pickenv/Pick-v0": PickVectorEnv,
}
HELD_OUT = 2**62
"""First seed of evaluation episodes; seeds of training are smaller."""


@dataclass(frozen=True)
class Training:
    """Settings of a training, in the form that its checkpoints give back: paths are text, and sequences are lists.

    Attributes:
        algorithm: One of `pickenv.agents.training.training_setup.ALGORITHMS`; "ppo_lstm" and "ppo_history" learn on
            `pickenv.wrappers.SameArmVector`.
        env_id: Id of the environment.
        steps: Number of environment steps; None for the tuned number.
        seed: Seed of all random numbers.
        arguments: Keyword arguments of the environment. For an algorithm that remembers past picks, "plant" may be a
            list of plants (a plant is the true arm with its errors). The environments are then divided among the
            plants, and each plant has its own population of arms.
        compensate: Calibration file whose compensator corrects the commands during training, or None.
        allow: Reservations of the calibration to accept, by name: "fitted-frames", "do-not-use" (`pickenv.base.obey`).
        checkpoint_every: Environment steps between checkpoints.
        evaluate_every: Environment steps between evaluations.
        scaled_actions: Whether actions are scaled with the gap to the fruit (`pickenv.wrappers.GapScaling`).
        parameters: Hyperparameters of the algorithm that replace the tuned ones.
    """

    algorithm: str
    env_id: str = "pickenv/Reach-v0"
    steps: int | None = None
    seed: int = 0
    arguments: dict[str, Any] = field(default_factory=dict)
    compensate: str | None = None
    allow: list[str] = field(default_factory=list)
    checkpoint_every: int = 50_000
    evaluate_every: int = 50_000
    scaled_actions: bool = True
    parameters: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check_known("algorithm", self.algorithm, ALGORITHMS)
        if self.env_id not in ENVIRONMENTS:
            raise InputError(
                f"environment '{self.env_id}' cannot be trained on here; give one of {', '.join(ENVIRONMENTS)}"
            )
        check_limit("seed", self.seed, "seed of training")
        for name, least in (("seed", 0), ("steps", 1), ("checkpoint_every", 1), ("evaluate_every", 1)):
            if name != "steps" or self.steps is not None:
                check_count(name, getattr(self, name), least)
                object.__setattr__(self, name, int(getattr(self, name)))
        for name in ("compensate", "allow", "arguments", "parameters"):
            object.__setattr__(self, name, _stored(name, getattr(self, name)))

    @property
    def chosen(self) -> dict[str, Any]:
        """Tuned hyperparameters of the algorithm, overridden by the attribute ``parameters``."""
        return tuned(self.algorithm, self.env_id) | deepcopy(self.parameters)  # stable-baselines3 adds to them

    @property
    def wrapper(self) -> tuple[str | None, dict[str, Any]]:
        """Name (None without a wrapper) and keyword arguments of the wrapper on which the algorithm learns.

        The name is the dotted path of the wrapper, as in RL Zoo's notation.
        """
        entry = self.chosen.get("env_wrapper")
        ((name, settings),) = entry.items() if isinstance(entry, dict) else [(entry, {})]
        return name, settings

    @property
    def remembering(self) -> dict[str, Any] | None:
        """Arguments of the `pickenv.wrappers.SameArmVector` on which the algorithm learns; None if it needs none."""
        name, settings = self.wrapper
        return settings if name == "pickenv.wrappers.SameArm" else None

    @property
    def total(self) -> int:
        """Total number of environment steps of the training."""
        return self.steps or int(self.chosen["n_timesteps"])


def _stored(name: str, value: Any) -> Any:
    """Return a setting as a checkpoint gives it back.

    Raises:
        InputError: If a checkpoint cannot store the value.
    """

    def plain(part: Any) -> Any:
        if isinstance(part, np.generic | np.ndarray):
            return part.tolist()
        if isinstance(part, Path):
            return str(part)
        raise InputError(f"{name} of a training holds {shown(part)}; give text, numbers, lists and dictionaries")

    return json.loads(json.dumps(value, default=plain))


Inputs = dict[str, str | None]


def arguments_of(training: Training) -> list[dict[str, Any]]:
    """Return the environment arguments of a training, one dict per plant (the true arm with its errors).

    Each plant draws its arms from a random stream of its own.

    Raises:
        InputError: If the list of plants is empty, or the algorithm does not remember past picks and a list is given.
    """
    arguments = training.chosen.get("env_kwargs", {}) | training.arguments
    plants = arguments.get("plant")
    if not isinstance(plants, list):
        return [arguments]
    if not plants or training.remembering is None:
        raise InputError(
            f"{training.algorithm} was given {len(plants)} plants (`plant`); give one, or several to an algorithm that "
            "remembers past picks (ppo_lstm, ppo_history)"
        )
    seed = arguments.get("population_seed", 0)
    others = [seed_words(stream(seed, "training", k), 1)[0] for k in range(1, len(plants))]
    chosen = zip(plants, [seed, *others], strict=True)
    return [arguments | {"plant": plant, "population_seed": seed} for plant, seed in chosen]


def make_environment(training: Training, count: int, mode: str, number: int = 0) -> Native:
    """Make a training's environments with one of its plants, and install the compensator of its calibration.

    A plant is the true arm with its errors.

    Args:
        training: Settings of the training.
        count: Number of environments.
        mode: Autoreset mode: "SameStep", "NextStep" or "Disabled".
        number: Index of the plant in the training's list of plants, from 0.

    Raises:
        InputError: If the environment refuses an argument, or the calibration is missing or of another arm.
    """
    env = ENVIRONMENTS[training.env_id](count, autoreset_mode=mode, **arguments_of(training)[number])
    if training.compensate is not None:
        env.compensator = load_compensator(training.compensate, env.task.plant.arm, training.allow)
    return env


def make_runs(training: Training, count: int, mode: str) -> SameArmVector | SameArmMixture:
    """Make the environments for a policy with a memory, divided among the plants of its training.

    A plant is the true arm with its errors.

    Args:
        training: Settings of the training.
        count: Number of environments.
        mode: Autoreset mode: "SameStep", "NextStep" or "Disabled".

    Raises:
        InputError: If the environment refuses an argument, there are more plants than environments, or the plants'
            nominal arms differ.
    """
    plants = len(arguments_of(training))
    if count < plants:
        raise InputError(f"n_envs is {count}; give at least {plants}, one environment per plant")
    counts = [len(share) for share in np.array_split(np.arange(count), plants)]
    made = [make_environment(training, some, mode, k) for k, some in enumerate(counts)]
    parts = [SameArmVector(env, **(training.remembering or {})) for env in made]
    return parts[0] if plants == 1 else SameArmMixture(parts)


def inputs_of(training: Training) -> Inputs:
    """Compute the hashes of a training's inputs besides its settings, in their present state.

    Returns:
        "arms" holds one hash per plant (the true arm with its errors), separated by spaces. Each hash is over the
        parameters of plant, arm and tolerance class. "calibration" is the SHA-256 of the calibration file, or None.

    Raises:
        InputError: If the calibration is missing or of another arm, or the file of a plant (true arm) is refused.
    """
    made = [make_environment(training, 1, "Disabled", k) for k in range(len(arguments_of(training)))]
    calibration = None if training.compensate is None else file_sha256(npz_path(training.compensate))
    return {"arms": " ".join(content_sha256(env.task.plant) for env in made), "calibration": calibration}


def check_inputs(training: Training, begun: Inputs) -> None:
    """Raise an error if the calibration or a plant (true arm) of a training has changed since the training began.

    Args:
        training: Settings of the training.
        begun: Hashes of the inputs with which the training began.

    Raises:
        InputError: If the calibration or a plant has changed or is missing; the message names the changed input.
    """
    restore = "put back what the training was begun with, or begin another in another folder (`out`)"
    if training.compensate is not None:
        path = npz_path(training.compensate)
        if not path.is_file():
            raise InputError(f"calibration {path} (`compensate`) is missing; {restore}")
        if file_sha256(path) != begun["calibration"]:
            raise InputError(f"calibration {path} (`compensate`) is another file than it was; {restore}")
    plants = [str(arguments.get("plant", "of the environment")) for arguments in arguments_of(training)]
    for plant in plants:
        if plant.endswith(".toml") and not Path(plant).is_file():
            raise InputError(f"plant {plant} (`plant`) is missing; {restore}")
    hashes = [str(inputs["arms"]).split() for inputs in (inputs_of(training), begun)]
    for plant, now, then in zip(plants, *hashes, strict=True):
        if now != then:
            raise InputError(f"plant {plant} (`plant`, or its tolerances) has other numbers than it had; {restore}")


def make_model(training: Training, out: Path | None = None) -> tuple[Any, Any]:
    """Make the environments of a training, and the seeded Stable-Baselines3 model that learns in them.

    Args:
        training: Settings of the training.
        out: Folder of the run, for TensorBoard's logs; None to write no logs.

    Returns:
        The Stable-Baselines3 model and its environments.

    Raises:
        InputError: If the algorithm is "ppo" and the observations are goal observations. Also if the LSTM of
            "ppo_lstm" has several layers, because a policy file stores only one.
    """
    from sb3_contrib import TQC, RecurrentPPO
    from stable_baselines3 import PPO, SAC, HerReplayBuffer

    from pickenv.wrappers import Sb3Vec

    parameters, remembering, settings = training.chosen, training.remembering, training.wrapper[1]
    for key in ("n_timesteps", "env_kwargs", "env_wrapper"):
        parameters.pop(key, None)
    if (layers := parameters["policy_kwargs"].get("n_lstm_layers", 1)) != 1:
        raise InputError(f"n_lstm_layers is {layers}; give 1, as a policy's file holds one layer of its memory")
    count, make = int(parameters.pop("n_envs")), make_environment if remembering is None else make_runs
    inner: Any = make(training, count, "SameStep")
    logs = str(out / "logs") if out is not None and is_there("tensorboard") else None
    common: dict[str, Any] = {"seed": training.seed, "device": "cpu", "tensorboard_log": logs, "verbose": 0}
    goals = isinstance(inner, ReachVectorEnv) and inner.goal_dict
    if goals and training.algorithm == "ppo":
        raise InputError("ppo has no use for goal observations; train it on pickenv/Reach-v0")
    if isinstance(inner, PickVectorEnv):
        inner = ToolSteppingVector(inner, **settings)
    elif remembering is None and not goals and not isinstance(inner, ReachToolVectorEnv):
        inner = GapScalingVector(inner, training.scaled_actions)
    env = Sb3Vec(inner)
    if goals:
        parameters["policy_kwargs"] |= {"features_extractor_kwargs": {"actions": training.scaled_actions}}
        parameters["replay_buffer_class"] = HerReplayBuffer
    kinds: dict[str, Any] = {"ppo": PPO, "sac": SAC, "tqc": TQC, "ppo_lstm": RecurrentPPO, "ppo_history": PPO}
    policy = parameters.pop("policy")
    actor = resolve_name(policy) if "." in policy else policy  # a class by its dotted name, or one of its algorithm's
    return kinds[training.algorithm](actor, env, **parameters, **common), env


def actor_of(model: Any, training: Training, env: Any) -> LearnedPolicy | RememberingPolicy:
    """Return the actor of a Stable-Baselines3 model as a policy that runs on NumPy.

    Args:
        model: The model.
        training: Settings of its training.
        env: Environments of the model, from `make_model`.
    """
    import torch

    on_policy = training.algorithm.startswith("ppo")
    hidden = model.policy.mlp_extractor.policy_net if on_policy else model.actor.latent_pi
    last = model.policy.action_net if on_policy else model.actor.mu
    layers = [layer for layer in (*hidden, last) if isinstance(layer, torch.nn.Linear)]
    inner = env.envs.unwrapped
    arm = inner.task.plant.arm
    written_by = versions("gymnasium", "stable-baselines3", "torch")
    common: dict[str, Any] = {
        **{"algorithm": training.algorithm, "arm": arm.name, "arm_fingerprint": arm.fingerprint()},
        "record": {"training": asdict(training), "steps": int(model.num_timesteps), "versions": written_by},
        "weights": tuple(layer.weight.detach().numpy().T.astype(float) for layer in layers),
        "biases": tuple(layer.bias.detach().numpy().astype(float) for layer in layers),
    }
    if training.remembering is not None:
        return RememberingPolicy(memory=env.envs.run.memory, arrays=memory_arrays(model.policy), **common)
    common |= {"activation": "tanh" if on_policy else "relu", "squashed": not on_policy}
    if isinstance(inner, PickVectorEnv):
        return LearnedPolicy(scaling=tool_steps_of(inner), **common)
    if isinstance(inner, ReachToolVectorEnv):
        return LearnedPolicy(scaling=inner.scaling, **common)
    scaling = Scaling(inner.task.joints, inner.task.camera, inner.goal_dict, training.scaled_actions)
    return LearnedPolicy(scaling=scaling, **common)


def memory_arrays(policy: Any) -> dict[str, Any]:
    """Return the weight arrays of a torch policy's memory by name, for the attribute `RememberingPolicy.arrays`."""
    if (lstm := getattr(policy, "lstm_actor", None)) is None:
        return {name: value.detach().numpy().astype(float) for name, value in policy.features_extractor.given.items()}
    parts = (lstm.weight_ih_l0.T, lstm.bias_ih_l0, lstm.weight_hh_l0.T, lstm.bias_hh_l0)
    return {name: part.detach().numpy().astype(float) for name, part in zip(LSTM, parts, strict=True)}


def judge(policy: LearnedPolicy | RememberingPolicy, training: Training) -> dict[str, float]:
    """Evaluate a policy, acting deterministically, on held-out episodes of the training's environment.

    Returns:
        For reaching: "mean_mm" and "p95_mm", mean and 95th percentile of the final position error, and "success_rate".
        They are taken over 256 episodes, which have 60 steps if the environment sets no limit. For a policy with a
        memory, they are taken over all picks of 256 arms. For picking: mean numbers of fruit per canopy, over 16
        canopies, under the names "collected", "damaged", "attempted" and "reachable".
    """
    if training.env_id == "pickenv/Pick-v0" and isinstance(policy, LearnedPolicy):
        envs: Any = make_environment(training, 16, "NextStep")
        outcome = pick_canopies(policy, envs, HELD_OUT)
        return {name: float(outcome[name].mean()) for name in FRUIT}
    if isinstance(policy, RememberingPolicy):
        outcome = _picked(policy, make_runs(training, 256, "Disabled"))
        error, success = outcome["position_error_mm"], outcome["is_success"]
    else:
        env: Any = make_environment(training, 256, "NextStep")
        observation, infos = env.reset(seed=HELD_OUT)
        error, success, over = np.zeros(256), np.zeros(256), np.zeros(256, dtype=np.bool_)
        for _ in range(env.max_episode_steps or 60):
            observation, _, terminated, truncated, infos = env.step(policy.act(observation))
            error = np.where(over, error, infos["position_error_mm"])
            success = np.where(over, success, infos["is_success"])
            over |= terminated | truncated
    p95 = float(np.percentile(error, 95))
    return {"mean_mm": float(error.mean()), "p95_mm": p95, "success_rate": float(success.mean())}


def _picked(policy: RememberingPolicy, envs: SameArmVector | SameArmMixture) -> dict[str, Any]:
    """Run a policy with a memory on every arm of ``envs`` for all its picks; return the infos as ``(picks, arms)``."""
    observations, _ = envs.reset(seed=HELD_OUT)
    state, rows = policy.begin(envs.num_envs), []
    for _ in range(envs.run.picks):
        action, state = policy.aim(observations, state)
        observations, _, _, _, infos = envs.step(action)
        rows.append(infos.get("final_info", infos))
    return {key: np.array([row[key] for row in rows]) for key in ("position_error_mm", "is_success")}


def words_of(row: dict[str, float]) -> str:
    """Return a line of text that summarises an evaluation; ``row`` has the numbers that `judge` returned."""
    if "mean_mm" in row:
        return f"{row['mean_mm']:.3f} mm mean, {row['p95_mm']:.3f} mm p95 on held-out fruit"
    return f"{row['collected']:.2f} of {row['reachable']:.2f} reachable fruit per held-out canopy"


# Tuned parameters read from `pickenv.zoo.hyperparams`, strings in the notation of RL Zoo included; nothing is run.


ALGORITHMS = ("ppo", "sac", "tqc", "ppo_lstm", "ppo_history")


def tuned(algorithm: str, env_id: str) -> dict[str, Any]:
    """Return the tuned hyperparameters of an algorithm on an environment.

    Raises:
        InputError: If the algorithm is unknown, or has no tuned hyperparameters for the environment.
    """
    check_known("algorithm", algorithm, ALGORITHMS)
    parameters: dict[str, dict[str, Any]] = resolve_name(f"pickenv.zoo.hyperparams.{algorithm}:hyperparams")
    if env_id not in parameters:
        raise InputError(f"{algorithm} has no tuned parameters for '{env_id}'; give one of {', '.join(parameters)}")
    return {key: _value(value) for key, value in parameters[env_id].items()}


def _value(value: Any) -> Any:
    text = value if isinstance(value, str) else ""
    if text.startswith("lin_"):
        start = float(text[4:])
        return lambda remaining: remaining * start  # a schedule that falls evenly to zero
    if text.startswith("dict("):
        call = ast.parse(text, mode="eval").body
        assert isinstance(call, ast.Call)
        return {word.arg: ast.literal_eval(word.value) for word in call.keywords}
    return value
