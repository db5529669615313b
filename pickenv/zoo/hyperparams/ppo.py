"""PPO on the flat environments: parameters tuned on the ideal picking arm, for all its plants and kinds of feedback.

The gap between tool and fruit (position and attitude) is scaled (`pickenv.wrappers.GapScaling`). Without that wrapper
no network of this size resolves millimetres. `pickenv/ReachScaled-v0` and `pickenv/ReachTool-v0` scale it themselves;
on the latter the parameters suit any arm. Picking is learnt with steps of the tool (`pickenv.wrappers.ToolStepping`).
Its reward is shaped so that the sum of rewards has the same optimum.
"""

_SCALED = {
    "n_envs": 64,
    "n_timesteps": 2.5e5,
    "policy": "MlpPolicy",
    "n_steps": 60,
    "batch_size": 960,
    "n_epochs": 5,
    "learning_rate": "lin_1e-3",
    "gamma": 0.9,
    "gae_lambda": 0.9,
    "ent_coef": 0.0,
    "policy_kwargs": "dict(net_arch=[64, 64], log_std_init=-1.0)",
}

_REACH = _SCALED | {"env_wrapper": "pickenv.wrappers.GapScaling"}

_PICK = _SCALED | {
    "n_steps": 32,
    "batch_size": 512,
    "gamma": 0.99,
    "gae_lambda": 0.95,
    "policy_kwargs": "dict(net_arch=[64, 64], log_std_init=-0.7)",
    "env_wrapper": {"pickenv.wrappers.ToolStepping": {"shaping": 1.0}},
}

hyperparams = {
    "pickenv/Reach-v0": _REACH,
    "pickenv/ReachIdeal-v0": _REACH,
    "pickenv/ReachScaled-v0": _SCALED,
    "pickenv/ReachTool-v0": _SCALED,
    "pickenv/Pick-v0": _PICK,
}
