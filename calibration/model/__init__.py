"""Measurements of every kind, the arm's error model, and the parameters that data tell of."""
