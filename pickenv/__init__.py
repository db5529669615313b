"""pickenv: closed-loop picking accuracy as a Gymnasium environment, and the calibration that makes an arm accurate.

Importing it registers the environments; torch, stable-baselines3 and rerun are loaded where they are used.
"""

from importlib.metadata import PackageNotFoundError, version

import gymnasium

from pickenv.errors import InputError

try:
    __version__ = version("pickenv")
except PackageNotFoundError:  # a checkout that was never installed
    __version__ = "0.0.0"

gymnasium.register(id="pickenv/Reach-v0", entry_point="pickenv.envs.reach:ReachEnv", max_episode_steps=60)

__all__ = ["InputError", "__version__"]
