"""Training with stable-baselines3: checkpoints, evaluations and tuned hyperparameters."""

from pickenv.base import require as _require

_require("stable_baselines3", "sb3_contrib", "torch")
