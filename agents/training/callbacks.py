"""What happens during a training: checkpoints between rollouts, and evaluations in millimetres."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from stable_baselines3.common.callbacks import BaseCallback

from pickenv.agents.policies.learned import LearnedPolicy
from pickenv.agents.policies.remembering import RememberingPolicy
from pickenv.agents.training.checkpoints import save_checkpoint
from pickenv.agents.training.training_setup import Inputs, Training, actor_of, check_inputs, judge, write_evaluations
from pickenv.wrappers.sb3 import Sb3Vec


class EverySoOften(BaseCallback):
    """Do something every so many steps, between an update and the next rollout, when nothing is half done."""

    def __init__(self, steps: int, act: Callable[[BaseCallback], object]) -> None:
        super().__init__()
        self.steps, self.act = steps, act
        self._next = 0

    def _on_training_start(self) -> None:
        self._next = self._following()

    def _on_rollout_start(self) -> None:
        if self.model.num_timesteps >= self._next:
            self.act(self)
            self._next = self._following()

    def _on_step(self) -> bool:
        return True

    def _following(self) -> int:
        """The multiple that comes after the present step, so that a resumed training keeps the beat."""
        return (self.model.num_timesteps // self.steps + 1) * self.steps


def checkpoints(
    training: Training, inputs: Inputs, path: Path, env: Sb3Vec, evaluations: list[dict[str, float]]
) -> EverySoOften:
    """Write a checkpoint every so many steps."""
    return EverySoOften(
        training.checkpoint_every,
        lambda at: save_checkpoint(path, at.model, env, training, inputs, evaluations),
    )


def evaluations(training: Training, inputs: Inputs, out: Path, rows: list[dict[str, float]]) -> EverySoOften:
    """Judge the policy on held-out episodes every so many steps; draws nothing that the training draws from."""

    def evaluate(at: BaseCallback) -> None:
        env: Any = at.training_env
        row = judged(training, inputs, out, rows, actor_of(at.model, training, env), at.model.num_timesteps)
        for key, value in row.items():
            at.logger.record(f"eval/{key}", value)

    return EverySoOften(training.evaluate_every, evaluate)


def judged(
    training: Training,
    inputs: Inputs,
    out: Path,
    rows: list[dict[str, float]],
    policy: LearnedPolicy | RememberingPolicy,
    steps: int,
) -> dict[str, float]:
    """Judge a policy, and add its row to those of the training and of its folder.

    Raises:
        InputError: If the files that the training was begun with have changed.
    """
    check_inputs(training, inputs)
    rows[:] = [row for row in rows if row["steps"] < steps]
    rows.append({"steps": float(steps)} | judge(policy, training))
    write_evaluations(out, rows)
    return rows[-1]
