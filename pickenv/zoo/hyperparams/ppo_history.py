"""PPO on many fruit of one arm; the observation contains all earlier picks of a run."""

from pickenv.zoo.hyperparams.ppo_lstm import hyperparams as _recurrent

hyperparams = {
    name: parameters
    | {
        "env_wrapper": {"pickenv.wrappers.SameArm": {"window": 20, "reward": "true"}},
        "n_envs": 128,
        "n_steps": 20,
        "policy": "pickenv.agents.training.networks.HistoryPolicy",
        "policy_kwargs": "dict(net_arch=[64, 64], log_std_init=-2.0)",
    }
    for name, parameters in _recurrent.items()
}
