"""Tuned training parameters for the environments, in the format of RL Baselines3 Zoo."""
