"""The file that LeRobot's EnvHub looks for; put it at the top of a repository on the Hugging Face Hub."""

from typing import Any

from lerobot_env_pickenv import PickenvEnv


def make_env(n_envs: int = 1, use_async_envs: bool = False, cfg: Any = None) -> Any:
    """The environments as LeRobot wants them, ``{"pickenv": {0: vector}}``.

    Args:
        n_envs: Number of environments in the vector.
        use_async_envs: Whether each of several environments has its own process.
        cfg: A `PickenvEnv`, or None for its defaults.
    """
    return (cfg or PickenvEnv()).create_envs(n_envs, use_async_envs)
