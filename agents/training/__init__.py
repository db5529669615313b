"""Training with stable-baselines3, checkpoints, tuned parameters."""

from pickenv.extras import require as _require

_require("stable_baselines3", "sb3_contrib", "torch")
