"""Measurements of every kind, the arm's error model and its priors, and the noise of the measurements."""
