"""Tuned training parameters, beside the environments, in the format of RL Baselines3 Zoo."""
