"""Networks for stable-baselines3: SAC and TQC with scaled observations, and PPO with attention over past picks."""

from __future__ import annotations

from typing import Any, cast

import numpy as np
import torch as th
from gymnasium import spaces
from sb3_contrib.tqc import policies as tqc
from stable_baselines3.common.policies import ActorCriticPolicy, ContinuousCritic
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.sac import policies as sac

from pickenv.agents.policies.adaptive import HEADS, attended
from pickenv.wrappers import MOST_SEEN, PickMemory, Scaling, joined_observation

# SAC and TQC policies that scale observations and actions inside their networks. The replay buffer therefore holds
# unscaled observations and actions, in which hindsight experience replay may replace goals. The actor multiplies its
# output by a share that depends on the gap to the goal (`Scaling.share`). The critics divide the actions by the same
# share. The entropy is that of the actor's output before the multiplication.


class ScaledFeatures(BaseFeaturesExtractor):
    """Feature extractor that scales observations; it has no trained parameters."""

    def __init__(self, observation_space: spaces.Dict, actions: bool = True) -> None:
        """Make the extractor for a goal observation space.

        Args:
            observation_space: The space of goal observations.
            actions: Whether the factor `share` on actions shrinks with the gap between tool and goal.
        """
        joints = observation_space["observation"].shape[0] - 3  # type: ignore[index]  # and the believed position
        scaling = Scaling(joints, goal=True, actions=actions)
        super().__init__(observation_space, scaling.features)
        self.scaling = scaling

    def forward(self, observations: Any) -> th.Tensor:
        """Return the scaled features ``(N, features)`` of goal observations."""
        return cast(th.Tensor, self.scaling.observe(joined_observation(observations, th), th))

    def share(self, observations: Any) -> th.Tensor:
        """Return the factor ``(N, 1)``, at most 1, that multiplies actions; it shrinks with the gap to the goal."""
        return cast(th.Tensor, self.scaling.share(joined_observation(observations, th), th))


def _scaling(module: Any) -> ScaledFeatures:
    return cast(ScaledFeatures, module.features_extractor)


class _ScaledActions:
    """Mixin for actors that multiplies their outputs by the factor `ScaledFeatures.share`."""

    def forward(self, obs: Any, deterministic: bool = False) -> th.Tensor:
        """Return actions, multiplied by the factor `ScaledFeatures.share`."""
        return super().forward(obs, deterministic) * _scaling(self).share(obs)  # type: ignore[misc, no-any-return]

    def action_log_prob(self, obs: Any) -> tuple[th.Tensor, th.Tensor]:
        """Return actions, multiplied by `ScaledFeatures.share`, and the log-probability of the unmultiplied actions."""
        action, log_prob = super().action_log_prob(obs)  # type: ignore[misc]
        return action * _scaling(self).share(obs), log_prob


class _ScaledValues:
    """Mixin for critics that divides the actions that they read by the factor `ScaledFeatures.share`.

    Attributes:
        MOST: Bound on the absolute value of the divided actions. It matters for hindsight goals. These goals lie near
            the tool, and the factor is near zero there.
    """

    MOST = 3.0

    def forward(self, obs: Any, actions: th.Tensor) -> Any:
        """Return each critic's value of actions at observations ``obs``."""
        return super().forward(obs, (actions / _scaling(self).share(obs)).clamp(-self.MOST, self.MOST))  # type: ignore[misc]


class SacActor(_ScaledActions, sac.Actor):
    """SAC actor that multiplies its output by `ScaledFeatures.share`."""


class SacCritic(_ScaledValues, ContinuousCritic):
    """SAC critics that divide actions by `ScaledFeatures.share`."""


class TqcActor(_ScaledActions, tqc.Actor):
    """TQC actor that multiplies its output by `ScaledFeatures.share`."""


class TqcCritic(_ScaledValues, tqc.Critic):
    """TQC critics that divide actions by `ScaledFeatures.share`."""


class _ScaledNetworks:
    """Mixin for policies that makes the actor of `actor_kind` and the critics of `critic_kind`."""

    actor_kind: type[Any]
    critic_kind: type[Any]

    def __init__(self, *arguments: Any, **named: Any) -> None:
        super().__init__(*arguments, **{"features_extractor_class": ScaledFeatures, **named})

    def make_actor(self: Any, features_extractor: BaseFeaturesExtractor | None = None) -> Any:
        """Make the actor."""
        return self.actor_kind(**self._update_features_extractor(self.actor_kwargs, features_extractor)).to(self.device)

    def make_critic(self: Any, features_extractor: BaseFeaturesExtractor | None = None) -> Any:
        """Make the critics."""
        arguments = self._update_features_extractor(self.critic_kwargs, features_extractor)
        return self.critic_kind(**arguments).to(self.device)


class SacPolicy(_ScaledNetworks, sac.SACPolicy):
    """SAC policy whose networks scale observations and actions."""

    actor_kind, critic_kind = SacActor, SacCritic


class TqcPolicy(_ScaledNetworks, tqc.TQCPolicy):
    """TQC policy whose networks scale observations and actions."""

    actor_kind, critic_kind = TqcActor, TqcCritic


# PPO policy with attention over a window of past picks; training learns how to weigh the picks. It learns on
# `pickenv.wrappers.SameArm` with a window. Its encoder is `pickenv.agents.policies.adaptive.attended`, run by torch.


class HistoryFeatures(BaseFeaturesExtractor):
    """Feature extractor for the next pick that weighs a window of past picks by attention.

    Attributes:
        WIDTH: Size of keys and queries, a multiple of `HEADS`.
        MADE: Number of learnt features of each pick, which are used beside its measured error.
    """

    WIDTH, MADE = 32, 16

    def __init__(self, observation_space: spaces.Box) -> None:
        """Make the extractor for the observation space of `pickenv.wrappers.SameArm` with a window of past picks."""
        window = int((observation_space.high == MOST_SEEN).sum()) // 3
        memory = PickMemory((observation_space.shape[0] - 4 * window) // (1 + window), window)
        super().__init__(observation_space, memory.joints + HEADS * (3 + self.MADE) + 1)
        self.memory = memory
        sizes = dict.fromkeys(("near", "query", "key", "value"), (self.WIDTH, self.WIDTH))
        sizes |= {"near": (memory.joints, self.WIDTH), "value": (self.WIDTH + 3, self.MADE)}
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
