"""Small networks for tests of compensation."""

import itertools

import numpy as np

from pickenv.calibration import Bpnn


def fast_network(joints, seed=0):
    """A small one that says tenths of millimetres, in single precision."""
    rng, sizes = np.random.default_rng(seed), (joints, 24, 16, 8, 6)
    weights = tuple(rng.normal(size=(b, a)) / np.sqrt(a) for a, b in itertools.pairwise(sizes))
    scales = np.zeros(joints), np.ones(joints), weights, tuple(np.full(b, 0.1) for b in sizes[1:])
    return Bpnn(*scales, np.zeros(6), np.full(6, 1e-4), np.zeros(1), fast=True)
