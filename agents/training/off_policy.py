"""SAC and TQC policies that scale inside their networks, so that hindsight may exchange goals in the replay buffer.

The buffer holds unscaled observations and actions; the actor multiplies its output by the scaling's share for the goal
that it sees, and the critics divide actions by this share again. The entropy is that of the actor's own output.
"""

from __future__ import annotations

from typing import Any, cast

import torch as th
from gymnasium import spaces
from sb3_contrib.tqc import policies as tqc
from stable_baselines3.common.policies import ContinuousCritic
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.sac import policies as sac

from pickenv.wrappers import Scaling, joined_observation

MOST = 3.0
"""Critics see actions up to this multiple of the share; hindsight puts goals beside the tool, and shares near zero."""


class ScaledFeatures(BaseFeaturesExtractor):
    """An observation as the networks see it; nothing in it is learnt."""

    def __init__(self, observation_space: spaces.Dict, actions: bool = True) -> None:
        """See a goal observation; ``actions`` as in `pickenv.wrappers.GapScaling`."""
        joints = observation_space["observation"].shape[0] - 3  # type: ignore[index]  # and the believed position
        scaling = Scaling(joints, goal=True, actions=actions)
        super().__init__(observation_space, scaling.features)
        self.scaling = scaling

    def forward(self, observations: Any) -> th.Tensor:
        """Features ``(N, features)``."""
        return cast(th.Tensor, self.scaling.observe(joined_observation(observations, th), th))

    def share(self, observations: Any) -> th.Tensor:
        """The scaling's share ``(N, 1)``."""
        return cast(th.Tensor, self.scaling.share(joined_observation(observations, th), th))


def _scaling(module: Any) -> ScaledFeatures:
    return cast(ScaledFeatures, module.features_extractor)


class _ScaledActions:
    """Mixin for actors, whose outputs are multiplied by the share."""

    def forward(self, obs: Any, deterministic: bool = False) -> th.Tensor:
        """Actions."""
        return super().forward(obs, deterministic) * _scaling(self).share(obs)  # type: ignore[misc, no-any-return]

    def action_log_prob(self, obs: Any) -> tuple[th.Tensor, th.Tensor]:
        """Actions, and the logarithm of the probability of the actor's own output."""
        action, log_prob = super().action_log_prob(obs)  # type: ignore[misc]
        return action * _scaling(self).share(obs), log_prob


class _ScaledValues:
    """Mixin for critics, for which actions are divided by the share."""

    def forward(self, obs: Any, actions: th.Tensor) -> Any:
        """Values."""
        return super().forward(obs, (actions / _scaling(self).share(obs)).clamp(-MOST, MOST))  # type: ignore[misc]


class SacActor(_ScaledActions, sac.Actor):
    """SAC's actor with scaled actions."""


class SacCritic(_ScaledValues, ContinuousCritic):
    """SAC's critics with scaled actions."""


class TqcActor(_ScaledActions, tqc.Actor):
    """TQC's actor with scaled actions."""


class TqcCritic(_ScaledValues, tqc.Critic):
    """TQC's critics with scaled actions."""


class _ScaledNetworks:
    """Mixin for policies, which are made of `actor_kind` and `critic_kind`."""

    actor_kind: type[Any]
    critic_kind: type[Any]

    def __init__(self, *arguments: Any, **named: Any) -> None:
        super().__init__(*arguments, **{"features_extractor_class": ScaledFeatures, **named})

    def make_actor(self: Any, features_extractor: BaseFeaturesExtractor | None = None) -> Any:
        """The actor."""
        return self.actor_kind(**self._update_features_extractor(self.actor_kwargs, features_extractor)).to(self.device)

    def make_critic(self: Any, features_extractor: BaseFeaturesExtractor | None = None) -> Any:
        """The critics."""
        arguments = self._update_features_extractor(self.critic_kwargs, features_extractor)
        return self.critic_kind(**arguments).to(self.device)


class SacPolicy(_ScaledNetworks, sac.SACPolicy):
    """SAC's policy with scaled networks."""

    actor_kind, critic_kind = SacActor, SacCritic


class TqcPolicy(_ScaledNetworks, tqc.TQCPolicy):
    """TQC's policy with scaled networks."""

    actor_kind, critic_kind = TqcActor, TqcCritic
