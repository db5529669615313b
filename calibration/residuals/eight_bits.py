"""A network's inner layers in eight bits: whole-number weights, rounded one after the other.

What rounding a weight adds to the outputs is taken back by the weights that are rounded after it, as far as their
inputs vary together (Frantar et al. 2023, GPTQ, algorithm 1): half the error of rounding each for itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from pickenv.arm.kinematics.geometry import Array

STEPS, MOST = 255, 127
"""Steps from zero to a pose's largest value, and the largest weight."""

DAMPING = 1e-3
"""Added to the inputs' covariance, as a share of its mean diagonal, so that it can be inverted."""


class Layer(NamedTuple):
    """One layer.

    Attributes:
        weights: Matrix ``(in, out)``; whole numbers up to `MOST` where there is a scale.
        bias: What is added to its product ``(out,)``.
        scale: What the product is multiplied by before ``(out,)``, or None.
    """

    weights: Array
    bias: Array
    scale: Array | None = None


def rounded_layers(layers: Sequence[Layer], sample: Array) -> list[Layer]:
    """The layers, all but the first and the last with whole-number weights.

    Args:
        layers: In double precision; negative outputs of all but the last are cut off.
        sample: Inputs ``(N, in)`` like those to come.
    """
    found, values = [layers[0]], sample
    for before, layer in pairwise(layers[:-1]):
        values = _stepped(np.maximum(values @ before.weights + before.bias, 0.0))
        found.append(_rounded(layer, values))
    return [*found, *layers[1:][-1:]]


def _stepped(values: Array) -> Array:
    """Values ``(N, in)``, none negative, as whole steps of each row's largest."""
    step = np.maximum(values.max(axis=1, keepdims=True), np.finfo(np.float32).tiny) / STEPS
    return np.asarray(np.round(values / step) * step)


def _rounded(layer: Layer, values: Array) -> Layer:
    """A layer rounded for inputs like ``values`` ``(N, in)``."""
    mean, count = values.mean(axis=0), len(layer.weights)
    covariance = np.cov(values, rowvar=False, bias=True).reshape(count, count)
    covariance += DAMPING * (covariance.diagonal().mean() or 1.0) * np.eye(count)
    order = np.argsort(-covariance.diagonal(), kind="stable")
    upper = np.linalg.cholesky(np.linalg.inv(covariance[np.ix_(order, order)])).T
    scale = np.maximum(np.abs(layer.weights).max(axis=0), np.finfo(np.float32).tiny) / MOST
    left, whole = layer.weights[order] / scale, np.empty_like(layer.weights)
    for i, row in enumerate(order):
        whole[row] = np.clip(np.round(left[i]), -MOST, MOST)
        left[i + 1 :] -= np.outer(upper[i, i + 1 :] / upper[i, i], left[i] - whole[row])
    return Layer(whole, layer.bias + mean @ (layer.weights - whole * scale), scale)
