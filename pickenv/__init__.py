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

for _name, _module, _class in (
    ("Reach", "reach", "Reach"),
    ("ReachGoal", "reach_goal", "ReachGoal"),
    ("ReachIdeal", "reach_ideal", "ReachIdeal"),
):
    gymnasium.register(
        id=f"pickenv/{_name}-v0",
        entry_point=f"pickenv.envs.{_module}:{_class}Env",
        vector_entry_point=f"pickenv.envs.reaching.vector:{_class}VectorEnv",
        max_episode_steps=60,
    )
gymnasium.register(
    id="pickenv/Harvest-v0",
    entry_point="pickenv.envs.harvesting.harvest_env:HarvestEnv",
    vector_entry_point="pickenv.envs.harvesting.harvest_vector:HarvestVectorEnv",
    max_episode_steps=600,
)
gymnasium.register(id="pickenv/Pick-v0", entry_point="pickenv.envs.picking.pick:PickEnv", max_episode_steps=400)

__all__ = ["InputError", "__version__"]
