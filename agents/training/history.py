"""PPO policy with attention over a window of past picks; training learns how to weigh the picks.

It learns on `pickenv.wrappers.SameArm` with a window. Its encoder is `pickenv.agents.policies.remembering.attended`,
run by torch.
"""

from __future__ import annotations

from typing import Any, cast

import numpy as np
import torch as th
from gymnasium import spaces
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor

from pickenv.agents.policies.remembering import HEADS, attended
from pickenv.wrappers import MOST_SEEN, PickMemory

WIDTH, MADE = 32, 16
"""`WIDTH` is the size of keys and queries, a multiple of `HEADS`. `MADE` is the number of learnt features of each pick,
which add to its measured error."""


class HistoryFeatures(BaseFeaturesExtractor):
    """Feature extractor for the next pick that weighs a window of past picks by attention."""

    def __init__(self, observation_space: spaces.Box) -> None:
        """Make the encoder for the observation space of `pickenv.wrappers.SameArm` with a window."""
        window = int((observation_space.high == MOST_SEEN).sum()) // 3
        memory = PickMemory((observation_space.shape[0] - 4 * window) // (1 + window), window)
        super().__init__(observation_space, memory.joints + HEADS * (3 + MADE) + 1)
        self.memory = memory
        sizes = dict.fromkeys(("near", "query", "key", "value"), (WIDTH, WIDTH))
        sizes |= {"near": (memory.joints, WIDTH), "value": (WIDTH + 3, MADE)}
        arrays = {name: th.nn.Parameter(th.empty(size)) for name, size in sizes.items()}
        for value in arrays.values():
            th.nn.init.orthogonal_(value, 1.0 if value.shape[0] != value.shape[1] else np.sqrt(2.0))
        arrays |= {f"{name}_bias": th.nn.Parameter(th.zeros(sizes[name][1])) for name in ("near", "value")}
        self.given = th.nn.ParameterDict(arrays)

    def forward(self, observations: th.Tensor) -> th.Tensor:
        """Return features ``(N, features)`` of observations ``(N, inputs)``."""
        return cast(th.Tensor, attended(th, dict(self.given.items()), self.memory, observations))


class HistoryPolicy(ActorCriticPolicy):
    """PPO policy with `HistoryFeatures` as its feature extractor."""

    def __init__(self, *arguments: Any, **named: Any) -> None:
        super().__init__(*arguments, **{"features_extractor_class": HistoryFeatures, **named})
