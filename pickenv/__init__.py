"""pickenv: closed-loop picking accuracy as a Gymnasium environment, and the calibration that makes an arm accurate.

    result = pickenv.calibrate("ur5", "tracker.csv", columns="my_tracker.toml")    # measurements in, judged result out
    plant = pickenv.load_plant("qiao2026")                                         # a simulated true arm
    env = gymnasium.make("pickenv/Reach-v0", plant="qiao2026")                     # and an environment around it
    env = pickenv.wrappers.CompensationWrapper(env, result.compensator())          # corrected between policy and arm

Importing it registers the environments. Everything else, torch, stable-baselines3 and rerun above all, is loaded when
it is first asked for.
"""

from importlib import metadata as _metadata
from typing import TYPE_CHECKING as _TYPE_CHECKING

import gymnasium as _gymnasium

from pickenv.errors import InputError as InputError
from pickenv.faces import offered as _offered

if _TYPE_CHECKING:
    from pickenv import agents, arm, calibration, envs, experiments, harvester, inspect, orchard, wrappers
    from pickenv.agents import compare, load_policy, run_reaches
    from pickenv.arm import Arm, Plant, load_arm, load_plant
    from pickenv.calibration import Calibration, Choices, Result, calibrate
    from pickenv.inspect import film
    from pickenv.registry import register

__all__ = ["Arm", "Calibration", "Choices", "InputError", "Plant", "Result", "__version__", "agents", "arm"]
__all__ += [
    "calibrate",
    "calibration",
    "compare",
    "envs",
    "experiments",
    "film",
    "harvester",
    "inspect",
    "load_arm",
    "load_plant",
    "load_policy",
]
__all__ += ["orchard", "register", "run_reaches", "wrappers"]

__getattr__ = _offered(__name__)[0]


def __dir__() -> list[str]:
    return __all__


def _register() -> None:
    """Tell Gymnasium of the environments; their modules are loaded when one is made."""
    for name, module in (("Reach", "reach"), ("ReachGoal", "reach_goal"), ("ReachIdeal", "reach_goal")):
        _gymnasium.register(
            id=f"pickenv/{name}-v0",
            entry_point=f"pickenv.envs.reaching.{module}:{name}Env",
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
        vector_entry_point="pickenv.envs.harvesting.harvest_vector:HarvestVectorEnv",
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
