"""SAC: with hindsight experience replay (HER) on the goal environment, without it on the flat environments.

The gap between tool and fruit (position and attitude) is scaled. On the flat environments `pickenv.wrappers.GapScaling`
scales it. With hindsight the networks scale it (`pickenv.agents.training.networks`), since a goal may be replaced
after the action was taken.
"""

_SCALED = {
    "n_envs": 16,
    "n_timesteps": 1e4,
    "policy": "MlpPolicy",
    "learning_rate": "lin_1e-3",
    "buffer_size": 60_000,
    "learning_starts": 1_500,
    "batch_size": 256,
    "tau": 0.01,
    "gamma": 0.9,
    "train_freq": 1,
    "gradient_steps": 4,
    "ent_coef": "auto_0.1",
    "target_entropy": -12.0,
    "policy_kwargs": "dict(net_arch=[64, 64])",
}
_REACH = _SCALED | {"env_wrapper": "pickenv.wrappers.GapScaling"}
_GOAL = _SCALED | {
    "policy": "pickenv.agents.training.networks.SacPolicy",
    "env_kwargs": {"reward": "dense"},
    "replay_buffer_class": "HerReplayBuffer",
    "replay_buffer_kwargs": "dict(n_sampled_goal=2, goal_selection_strategy='future')",
}

hyperparams = {
    "pickenv/Reach-v0": _REACH,
    "pickenv/ReachIdeal-v0": _REACH,
    "pickenv/ReachScaled-v0": _SCALED,
    "pickenv/ReachGoal-v0": _GOAL,
}
