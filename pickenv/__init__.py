"""pickenv: closed-loop picking accuracy as a Gymnasium environment, and the calibration that makes an arm accurate.

    result = pickenv.calibrate("ur5", "tracker.csv", columns="my_tracker.toml")    # measurements in, judged result out
    plant = pickenv.load_plant("qiao2026")                                         # a simulated true arm
    env = gymnasium.make("pickenv/Reach-v0", plant="qiao2026")                     # and an environment around it
    env = pickenv.wrappers.CompensationWrapper(env, result.compensator())          # corrected between policy and arm

Importing it registers the environments. Everything else, torch, stable-baselines3 and rerun above all, is loaded when
it is first asked for.
"""

from importlib import metadata as _metadata

import gymnasium as _gymnasium

from pickenv.base import InputError as InputError
from pickenv.base.faces import offered as _offered

__getattr__, __dir__, __all__ = _offered("pickenv", __file__)


def _register() -> None:
    """Tell Gymnasium of the environments; their modules are loaded when one is made."""
    for name in ("Reach", "ReachGoal", "ReachIdeal"):
        _gymnasium.register(
            id=f"pickenv/{name}-v0",
            entry_point=f"pickenv.envs.reaching.reach:{name}Env",
            vector_entry_point=f"pickenv.envs.reaching.vector:{name}VectorEnv",
            max_episode_steps=60,
        )
    _gymnasium.register(
        id="pickenv/ReachScaled-v0",
        entry_point="pickenv.wrappers.gap:scaled_reach",
        vector_entry_point="pickenv.wrappers.gap:scaled_reach_vector",
        max_episode_steps=60,
    )
    _gymnasium.register(
        id="pickenv/Harvest-v0",
        entry_point="pickenv.envs.harvesting.harvest_env:HarvestEnv",
        vector_entry_point="pickenv.envs.harvesting.harvest_env:HarvestVectorEnv",
        max_episode_steps=600,
    )
    _gymnasium.register(
        id="pickenv/Pick-v0",
        entry_point="pickenv.envs.picking.pick:PickEnv",
        vector_entry_point="pickenv.envs.picking.pick_vector:PickVectorEnv",
        max_episode_steps=400,
    )


try:
    __version__ = _metadata.version("pickenv")
except _metadata.PackageNotFoundError:  # a checkout that was never installed
    __version__ = "0.0.0"

_register()
