"""Seeded and resumable training with stable-baselines3 on pickenv's native vector environments.

A run's folder holds `checkpoint.pt` (everything needed to resume), `policy.npz` (the actor alone, see
`pickenv.agents.policies.learned`), `evaluations.json` and TensorBoard's logs. One seed gives one set of weights,
whether the training was interrupted or not.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from stable_baselines3.common.callbacks import BaseCallback

from pickenv.agents.policies.learned import LearnedPolicy
from pickenv.agents.policies.remembering import RememberingPolicy
from pickenv.agents.training import training_setup
from pickenv.agents.training.checkpoints import Evaluations, read_checkpoint, save_checkpoint, take_checkpoint
from pickenv.agents.training.training_setup import Training
from pickenv.base import InputError, locked, torch_on_one_thread, write_json

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
        training: Settings of the training; when resuming, they must be those of the checkpoint.
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
