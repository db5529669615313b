"""RecurrentPPO (sb3-contrib) on many fruit of one arm: it observes the last pick and remembers the earlier ones.

In training, which is simulated, rewards use the tool's true position. The trained policy runs without rewards.
"""

SAME_ARM = {
    "feedback": "camera",
    "camera_noise_mm": 1.0,
    "fruit_noise_mm": 0.0,
    "arms": "per_episode",
    "tolerances": "coarse",
    "population": 4096,
}

hyperparams = {
    "pickenv/Reach-v0": {
        "env_wrapper": {"pickenv.wrappers.SameArm": {"reward": "true"}},
        "env_kwargs": SAME_ARM,
        "n_envs": 256,
        "n_timesteps": 1e5,
        "policy": "MlpLstmPolicy",
        "n_steps": 10,
        "batch_size": 640,
        "n_epochs": 5,
        "learning_rate": "lin_1e-3",
        "gamma": 0.0,
        "gae_lambda": 1.0,
        "ent_coef": 0.0,
        "policy_kwargs": "dict(net_arch=[64], lstm_hidden_size=64, shared_lstm=True, "
        "enable_critic_lstm=False, log_std_init=-2.0)",
    }
}
