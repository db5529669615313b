"""Training with stable-baselines3, checkpoints, tuned parameters."""
