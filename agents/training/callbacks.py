"""What happens during a training: checkpoints between rollouts, and evaluations in millimetres."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from stable_baselines3.common.callbacks import BaseCallback

from pickenv.agents.policies.learned import LearnedPolicy
from pickenv.agents.training.checkpoints import save_checkpoint
from pickenv.agents.training.training_setup import Inputs, Training, actor_of, check_inputs, judge, write_evaluations
from pickenv.wrappers.sb3 import Sb3Vec


def following(steps: int, every: int) -> int:
    """The multiple of ``every`` that comes after ``steps``, so that a resumed training keeps the beat."""
    return (steps // every + 1) * every


class Checkpoints(BaseCallback):
    """Write a checkpoint every so many steps, between an update and the next rollout, when nothing is half done."""

    def __init__(
        self, training: Training, inputs: Inputs, path: Path, env: Sb3Vec, evaluations: list[dict[str, float]]
    ) -> None:
        super().__init__()
        self.what, self.inputs, self.path, self.env, self.evaluations = training, inputs, path, env, evaluations
        self._next = 0

    def _on_training_start(self) -> None:
        self._next = following(self.model.num_timesteps, self.what.checkpoint_every)

    def _on_rollout_start(self) -> None:
        if self.model.num_timesteps >= self._next:
            save_checkpoint(self.path, self.model, self.env, self.what, self.inputs, self.evaluations)
            self._next = following(self.model.num_timesteps, self.what.checkpoint_every)

    def _on_step(self) -> bool:
        return True


class Evaluations(BaseCallback):
    """Judge the policy on held-out episodes every so many steps; draws nothing that the training draws from."""

    def __init__(self, training: Training, inputs: Inputs, out: Path, rows: list[dict[str, float]]) -> None:
        super().__init__()
        self.what, self.inputs, self.out, self.rows = training, inputs, out, rows
        self._next = 0

    def _on_training_start(self) -> None:
        self._next = following(self.model.num_timesteps, self.what.evaluate_every)

    def _on_rollout_start(self) -> None:
        if self.model.num_timesteps >= self._next:
            env: Any = self.training_env
            row = self.judge(actor_of(self.model, self.what, env), self.model.num_timesteps)
            for key in ("mean_mm", "p95_mm", "success_rate"):
                self.logger.record(f"eval/{key}", row[key])
            self._next = following(self.model.num_timesteps, self.what.evaluate_every)

    def _on_step(self) -> bool:
        return True

    def judge(self, policy: LearnedPolicy, steps: int) -> dict[str, float]:
        """Judge a policy and add a row.

        Raises:
            InputError: If the files that the training was begun with have changed.
        """
        check_inputs(self.what, self.inputs)
        self.rows[:] = [row for row in self.rows if row["steps"] < steps]
        self.rows.append({"steps": float(steps)} | judge(policy, self.what))
        write_evaluations(self.out, self.rows)
        return self.rows[-1]
